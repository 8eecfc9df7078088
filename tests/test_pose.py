"""Where arms stand, and the postures that put them somewhere: `osc-contact pose`."""

from functools import cache

import numpy as np
import pinocchio as pin
from command_line import answered, call, done, refused
from complaints import invalid_input
from numpy.testing import assert_allclose
from pytest import mark

import osc_contact as osc
from osc_contact import robots
from osc_contact.dynamics.assembly import outside_limits
from osc_contact.runs import poses

POSTURE = "10 deg, -45 deg, 0, -135 deg, 0.1, 90 deg, 45 deg"
TIP = "pose panda --tip panda_hand_tcp"


@cache
def panda():
    """From the URDF as Pinocchio itself reads it."""
    return pin.buildModelFromUrdf(str(robots.find_robot("panda")[0]))


@cache
def panda_chain():
    return osc.ClosedChain([poses.arm_of("panda", "panda_hand_tcp")])


def standing(q):
    """Pose of the Panda's tip, fingers at 0."""
    model = panda()
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.concatenate((q, np.zeros(model.nq - len(q)))))
    return data.oMf[model.getFrameId("panda_hand_tcp")]


def test_forward_kinematics_of_a_robot_by_name():
    result, found = answered(f"{TIP} --posture", POSTURE)
    assert "panda panda_hand_tcp: {xyz: [" in result.stdout
    q = np.array([np.deg2rad(10), -np.pi / 4, 0, -0.75 * np.pi, 0.1, np.pi / 2, np.pi / 4])
    assert_allclose(list(found["posture"].values()), q, atol=1e-12)
    assert_allclose(found["tips"]["panda"], standing(q).homogeneous, atol=1e-9)


def test_inverse_kinematics_keep_the_limits_and_print_what_a_file_takes():
    for xyz in ("0.4, 10 cm, 0.3", "[-0.3, 0.4, 0.5]", "0.1, -0.5, 0.2"):
        result, found = answered(f"{TIP} --rpy '180 deg, 0, 0' --xyz='{xyz}'")
        q = np.array(list(found["posture"].values()))
        X = standing(q)
        assert_allclose(X.translation, poses.numbers("xyz", xyz), atol=1e-6)
        assert_allclose(X.rotation, np.diag([1, -1, -1]), atol=1e-5)
        typed = result.stdout.split("[")[1].split("]")[0]
        assert_allclose(poses.numbers("posture", typed), q, atol=1e-6)
        assert not outside_limits(panda_chain(), q)


def test_what_is_out_of_reach_or_outside_the_limits_is_told_with_exit_code_1():
    for words, told in (
        ("--xyz '3, 0, 0.5'", "not reached within the joints' limits"),
        (
            "--posture '0, 0, 0, 0, 0, 90 deg, 0'",
            "joint panda/panda_joint4 at 0 is outside its limits [-3.072, -0.0698]",
        ),
    ):
        result = call(f"{TIP} {words}")
        assert result.exit_code == 1 and told in result.stdout


def test_a_scenario_tells_where_its_postures_put_the_object_and_how_to_put_it_elsewhere():
    assert "object pose: {xyz: [" in done("pose two_contact_rod").stdout
    _, found = answered("pose two_contact_rod --xyz '0, 5 cm, 0.2'")
    assert_allclose(np.array(found["object"])[:3, 3], [0, 0.05, 0.2], atol=1e-6)
    tips = [np.array(found["tips"][arm])[:3, 3] for arm in ("left", "right")]
    assert_allclose(tips, [[-0.15, 0.05, 0.2], [0.15, 0.05, 0.2]], atol=1e-6)


@mark.parametrize(
    "words, said",
    [
        ("pose panda", "panda has 3 ends: "),
        (f"{TIP} --posture '1, 2'", "2 numbers for 7 joints"),
        (f"{TIP} --xyz '1, 2'", "xyz '1, 2'"),
        (f"{TIP} --xyz '1 kg, 0, 0'", "a length"),
        ("pose two_contact_rod --tip tool", "a scenario names its own"),
        ("pose panda --set a=1", "give --posture"),
        ("pose pandaa", "no robot 'pandaa'"),
        ("pose arm.xml", "'arm.xml' is neither the file"),
    ],
)
def test_what_is_wrong_is_told_with_exit_code_2(words, said):
    assert said in refused(words)


def test_numbers_are_those_of_scenario_files():
    assert_allclose(poses.numbers("rpy", "[180 deg, 0, 1]"), [np.pi, 0, 1])
    with invalid_input("posture"):
        poses.numbers("posture", "1, x")


def test_joints_outside_either_limit_are_named():
    chain = panda_chain()
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
    chain = panda_chain()
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
