"""Where arms stand, and the postures that put them somewhere: `osc-contact pose`."""

import json
from functools import cache

import numpy as np
import pinocchio as pin
from complaints import invalid_input
from numpy.testing import assert_allclose
from pytest import mark
from typer.testing import CliRunner

import osc_contact as osc
from osc_contact import robots
from osc_contact.cli import app
from osc_contact.dynamics.assembly import outside_limits
from osc_contact.runs import poses

POSTURE = "10 deg, -45 deg, 0, -135 deg, 0.1, 90 deg, 45 deg"
TIP = ("panda", "--tip", "panda_hand_tcp")


def call(*words):
    result = CliRunner().invoke(app, ["pose", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@cache
def panda():
    """From the URDF as Pinocchio itself reads it."""
    return pin.buildModelFromUrdf(str(robots.find_robot("panda")[0]))


def standing(q):
    """Pose of the Panda's tip, fingers at 0."""
    model = panda()
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.concatenate((q, np.zeros(model.nq - len(q)))))
    return data.oMf[model.getFrameId("panda_hand_tcp")]


def test_forward_kinematics_of_a_robot_by_name(tmp_path):
    result = call(*TIP, "--posture", POSTURE, "--json", tmp_path / "pose.json")
    assert result.exit_code == 0 and "panda panda_hand_tcp: {xyz: [" in result.stdout
    found = json.loads((tmp_path / "pose.json").read_text())
    q = np.array([np.deg2rad(10), -np.pi / 4, 0, -0.75 * np.pi, 0.1, np.pi / 2, np.pi / 4])
    assert_allclose(list(found["posture"].values()), q, atol=1e-12)
    assert_allclose(found["tips"]["panda"], standing(q).homogeneous, atol=1e-9)


def test_inverse_kinematics_keep_the_limits_and_print_what_a_file_takes(tmp_path):
    file = tmp_path / "pose.json"
    for xyz in ("0.4, 10 cm, 0.3", "[-0.3, 0.4, 0.5]", "0.1, -0.5, 0.2"):
        result = call(*TIP, f"--xyz={xyz}", "--rpy", "180 deg, 0, 0", "--json", file)
        assert result.exit_code == 0, result.stdout
        q = np.array(list(json.loads(file.read_text())["posture"].values()))
        X = standing(q)
        assert_allclose(X.translation, poses.numbers("xyz", xyz), atol=1e-6)
        assert_allclose(X.rotation, np.diag([1, -1, -1]), atol=1e-5)
        typed = result.stdout.split("[")[1].split("]")[0]
        assert_allclose(poses.numbers("posture", typed), q, atol=1e-6)
        arm = poses.arm_of("panda", "panda_hand_tcp").model
        assert np.all(q >= arm.lowerPositionLimit) and np.all(q <= arm.upperPositionLimit)


def test_what_is_out_of_reach_or_outside_the_limits_is_told_with_exit_code_1():
    far = call(*TIP, "--xyz", "3, 0, 0.5")
    assert far.exit_code == 1 and "not reached within the joints' limits" in far.stdout
    bent = call(*TIP, "--posture", "0, 0, 0, 0, 0, 90 deg, 0")
    assert bent.exit_code == 1
    assert "joint panda/panda_joint4 at 0 is outside its limits [-3.072, -0.0698]" in bent.stdout


def test_a_scenario_tells_where_its_postures_put_the_object_and_how_to_put_it_elsewhere(tmp_path):
    result = call("two_contact_rod", "--json", tmp_path / "a.json")
    assert result.exit_code == 0 and "object pose: {xyz: [" in result.stdout
    moved = call("two_contact_rod", "--xyz", "0, 5 cm, 0.2", "--json", tmp_path / "b.json")
    assert moved.exit_code == 0
    found = json.loads((tmp_path / "b.json").read_text())
    assert_allclose(np.array(found["object"])[:3, 3], [0, 0.05, 0.2], atol=1e-6)
    tips = [np.array(found["tips"][arm])[:3, 3] for arm in ("left", "right")]
    assert_allclose(tips, [[-0.15, 0.05, 0.2], [0.15, 0.05, 0.2]], atol=1e-6)


@mark.parametrize(
    "words, said",
    [
        (("panda",), "panda has 3 ends: "),
        ((*TIP, "--posture", "1, 2"), "2 numbers for 7 joints"),
        ((*TIP, "--xyz", "1, 2"), "xyz '1, 2'"),
        ((*TIP, "--xyz", "1 kg, 0, 0"), "a length"),
        (("two_contact_rod", "--tip", "tool"), "a scenario names its own"),
        (("panda", "--set", "a=1"), "give --posture"),
        (("pandaa",), "no robot 'pandaa'"),
        (("arm.xml",), "'arm.xml' is neither the file"),
    ],
)
def test_what_is_wrong_is_told_with_exit_code_2(words, said):
    result = call(*words)
    assert result.exit_code == 2 and said in result.stderr


def test_numbers_are_those_of_scenario_files():
    assert_allclose(poses.numbers("rpy", "[180 deg, 0, 1]"), [np.pi, 0, 1])
    with invalid_input("posture"):
        poses.numbers("posture", "1, x")


def test_joints_outside_either_limit_are_named():
    chain = osc.ClosedChain([poses.arm_of("panda", "panda_hand_tcp")])
    low = chain.model.lowerPositionLimit
    high = chain.model.upperPositionLimit
    assert outside_limits(chain, low) == outside_limits(chain, high) == []
    assert_allclose(poses.rest(chain), (low + high) / 2, atol=1e-15)
    for k, name in enumerate(chain.joint_names):
        for q in (low - 1e-3 * np.eye(7)[k], high + 1e-3 * np.eye(7)[k]):
            (said,) = outside_limits(chain, q)
            assert said.startswith(f"joint {name} at ")


def test_of_poses_out_of_reach_the_nearest_is_given():
    """The arm points at it, as far as it goes: no farther off than any posture tried at random."""
    chain = osc.ClosedChain([poses.arm_of("panda", "panda_hand_tcp")])
    far = pin.SE3(np.eye(3), np.array([0.9, 0.9, 0.3]))
    found = poses.solve(chain, far, poses.rest(chain))
    assert not found.reached and not outside_limits(chain, found.q)
    reached = [standing(q).translation for q in robots.random_configurations(chain.model, 2000, 3)]
    nearest = min(np.linalg.norm(x - far.translation) for x in reached)
    assert np.linalg.norm(standing(found.q).translation - far.translation) < nearest + 0.05


def test_every_arm_must_get_there():
    """One of two arms reaches the object; what its hinge permits is no miss, what it forbids is."""
    chain, q, X = poses.chain_of(osc.load_scenario("two_contact_rod"))
    away = pin.SE3(X.rotation, X.translation + np.array([-0.45, -0.4, 0.0]))
    found = poses.solve(chain, away, q)
    assert not found.reached and found.miss[0] > 1e-2
    chain, q, X = poses.chain_of(osc.load_scenario("hinge_ball_rod"))
    near = pin.SE3(X.rotation, X.translation + np.array([0.0, 0.01, 0.01]))
    assert poses.solve(chain, near, q).reached
