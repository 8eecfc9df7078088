"""Positions of arms and starts of runs: `pose`, postures, and scenarios for any arm by `new`."""

from functools import cache

import numpy as np
import pinocchio as pin
import yaml
from command_line import answered, call, done, refused
from complaints import invalid_input, model_error
from numpy.linalg import norm
from pytest import approx
from rigs import assert_near, placed, pose_at
from samples import chosen, parametrize
from scenario_runs import rig_of, verdict_of

import osc_contact as osc
from osc_contact import robots
from osc_contact.dynamics.assembly import close, outside_limits, reach
from osc_contact.lab.runs import poses
from osc_contact.lab.runs.poses import Press, _text

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
    return pose_at(model, np.append(q, np.zeros(model.nq - len(q))), "panda_hand_tcp")


def test_forward_kinematics_of_a_robot_by_name():
    posture = "10 deg, -45 deg, 0, -135 deg, 0.1, 90 deg, 45 deg"
    result, found = answered(f"{TIP} --posture", posture)
    assert "panda panda_hand_tcp: {xyz: [" in result.stdout
    q = np.deg2rad([10, -45, 0, -135, np.rad2deg(0.1), 90, 45])
    assert_near(list(found["posture"].values()), q, atol=1e-12)
    assert_near(found["tips"]["panda"], standing(q).homogeneous, atol=1e-9)


def test_inverse_kinematics_keep_the_limits_and_print_what_a_file_takes():
    for xyz in ("0.4, 10 cm, 0.3", "[-0.3, 0.4, 0.5]", "0.1, -0.5, 0.2"):
        result, found = answered(f"{TIP} --rpy '180 deg, 0, 0' --xyz='{xyz}'")
        q = np.array(list(found["posture"].values()))
        X = standing(q)
        assert_near(X.translation, poses.numbers("xyz", xyz), atol=1e-6)
        assert_near(X.rotation, np.diag([1, -1, -1]), atol=1e-5)
        assert_near(
            poses.numbers("posture", result.stdout.split("[")[1].split("]")[0]), q, atol=1e-6
        )
        assert not outside_limits(panda_chain(), q)


def test_what_is_out_of_reach_or_outside_the_limits_ends_with_exit_code_1():
    for words, message in (
        ("--xyz '3, 0, 0.5'", "not reached within the joints' limits"),
        (
            "--posture '0, 0, 0, 0, 0, 90 deg, 0'",
            "joint panda/panda_joint4 at 0 is outside its limits [-3.072, -0.0698]",
        ),
    ):
        result = call(f"{TIP} {words}")
        assert result.exit_code == 1 and message in result.stdout


def test_a_scenario_shows_where_its_postures_put_the_object_and_how_to_put_it_elsewhere():
    assert "object pose: {xyz: [" in done("pose two_contact_rod").stdout
    _, found = answered("pose two_contact_rod --xyz '0, 5 cm, 0.2'")
    assert_near(np.array(found["object"])[:3, 3], [0, 0.05, 0.2], atol=1e-6)
    tips = [np.array(found["tips"][arm])[:3, 3] for arm in ("left", "right")]
    assert_near(tips, [[-0.15, 0.05, 0.2], [0.15, 0.05, 0.2]], atol=1e-6)


@parametrize(
    "words, message",
    {
        "pose panda": "panda has 3 ends: ",
        f"{TIP} --posture '1, 2'": "2 numbers for 7 joints",
        f"{TIP} --xyz '1, 2'": "xyz '1, 2'",
        f"{TIP} --xyz '1 kg, 0, 0'": "a length",
        "pose two_contact_rod --tip tool": "a scenario names its own",
        "pose panda --set a=1": "give --posture",
        "pose pandaa": "no robot 'pandaa'",
        "pose arm.xml": "'arm.xml' is neither the file",
    },
)
def test_what_is_wrong_ends_with_exit_code_2(words, message):
    assert message in refused(words)


def test_numbers_in_other_units_are_refused_with_theirs():
    message = refused(f"{TIP} --xyz '600, 100, 300'")
    assert "plain numbers are metres" in message and "'600 mm, 100 mm, 300 mm'" in message
    result = call(f"{TIP} --posture '0, -45, 0, -135, 0, 90, 45'")
    assert result.exit_code == 1
    cure = "write '0 deg, -45 deg, 0 deg, -135 deg, 0 deg, 90 deg, 45 deg'"
    assert f"plain numbers are radians, and these look like degrees: {cure}" in result.stdout
    assert "degrees" not in call(f"{TIP} --posture '0, 0, 0, 0, 0, 0, 9'").stdout


ONE_JOINT = """
<robot name="one">
  <link name="base"/>
  <link name="arm"><inertial>
    <origin xyz="0.1 0 0"/> <mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <link name="TIP"/>
  <joint name="JOINT" type="revolute">
    <parent link="base"/> <child link="arm"/> <axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="10" velocity="1"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="arm"/> <child link="TIP"/> <origin xyz="0.3 0 0"/>
  </joint>
</robot>"""


@parametrize("tip, joint", [("tip", "turn"), ("[/bold]tip", "[red]turn")])
def test_robots_of_one_joint_and_names_with_brackets(tmp_path, tip, joint):
    file = tmp_path / "one.urdf"
    file.write_text(ONE_JOINT.replace("TIP", tip).replace("JOINT", joint))
    text = done("check", file).stdout
    assert f"│ {joint}" in text and f"│ {tip}" in text
    place = f"{0.3 * np.cos(0.5)}, {0.3 * np.sin(0.5)}, 0"
    _, found = answered("pose", file, "--xyz", place, "--rpy", "0, 0, 0.5")
    assert found["posture"] == {f"one/{joint}": approx(0.5, abs=1e-6)}
    result = call("new", "--robot", file, "--press", "Y=3", "--out", tmp_path / "one.yaml")
    assert result.exit_code == 2 and "no posture of" in result.output
    assert "not valid YAML" not in result.output


def test_numbers_are_those_of_scenario_files():
    assert_near(poses.numbers("rpy", "[180 deg, 0, 1]"), [np.pi, 0, 1])
    with invalid_input("posture"):
        poses.numbers("posture", "1, x")


def test_joints_outside_either_limit_are_named():
    chain = panda_chain()
    low = chain.model.lowerPositionLimit
    high = chain.model.upperPositionLimit
    assert outside_limits(chain, low) == outside_limits(chain, high) == []
    assert_near(poses.rest(chain), (low + high) / 2, atol=1e-15)
    for k, name in enumerate(chain.joint_names):
        for q in (low - 1e-3 * np.eye(7)[k], high + 1e-3 * np.eye(7)[k]):
            (message,) = outside_limits(chain, q)
            assert message.startswith(f"joint {name} at ")


def test_of_poses_out_of_reach_the_nearest_is_given():
    """The arm points at it, as far as it goes: no farther off than any posture tried at random."""
    chain = panda_chain()
    far = placed(0.9, 0.9, 0.3)
    found = poses.solve(chain, far, poses.rest(chain))
    assert not found.reached and not outside_limits(chain, found.q)
    reached = [standing(q).translation for q in robots.random_configurations(chain.model, 2000, 3)]
    nearest = min(norm(x - far.translation) for x in reached)
    assert norm(standing(found.q).translation - far.translation) < nearest + 0.05


def test_every_arm_must_get_there():
    """One of two arms reaches the object; what its hinge permits is no miss, what it forbids is."""
    chain, q, X = poses.chain_of(osc.load_scenario("two_contact_rod"))
    found = poses.solve(chain, placed(-0.45, -0.4) * X, q)
    assert not found.reached and found.miss[0] > 1e-2
    chain, q, X = poses.chain_of(osc.load_scenario("hinge_ball_rod"))
    assert poses.solve(chain, placed(0.0, 0.01, 0.01) * X, q).reached


# Where runs start: inverse kinematics within limits, and the pose that the posture gives.


def test_inverse_kinematics_keeps_joint_limits_and_finds_postures_all_the_same():
    """A Panda is sent from one random posture to the pose of another, 60 times."""
    chain = rig_of("panda_edge").chain
    low = chain.model.lowerPositionLimit
    high = chain.model.upperPositionLimit
    rng = np.random.default_rng(3)
    missed = []
    for _ in range(60):
        start, goal = rng.uniform(low, high, (2, chain.nq))
        pin.framesForwardKinematics(chain.model, chain.data, goal)
        X = chain.object_pose()
        q = reach(chain, start, X)
        assert np.all(q >= low) and np.all(q <= high)
        pin.framesForwardKinematics(chain.model, chain.data, q)
        missed.append(norm(chain.object_pose().translation - X.translation))
    assert np.mean(np.array(missed) < 1e-4) > 0.3  # the rest would have to go round end stops


@parametrize("positions", [reach, close])
def test_a_guess_with_too_few_joints_is_refused_with_their_number(positions):
    rig = rig_of("panda_edge")
    more = (rig.state.X_WO,) if positions is reach else ()
    with invalid_input(r"q: expected shape \(7\), got \(3,\)"):
        positions(rig.chain, [0.0, 0.5, 0.0], *more)


@parametrize("name", ["two_contact_rod", "ur5_wipe", "three_arm_plate"])
def test_the_object_is_where_the_posture_puts_it_unless_the_file_places_it(name):
    scenario = osc.load_scenario(name, ["object.pose=null"])
    rig = rig_of(scenario)
    arm = scenario.arms[0]
    one = rig.chain.arms[0]
    tip = pose_at(one.model, np.array(arm.posture), arm.tip)
    grasp = scenario.grasps[arm.name]
    assert_near(
        (one.base * tip * placed(*grasp.xyz, grasp.rpy)).homogeneous, rig.X_given, atol=1e-12
    )


def test_a_scenario_that_starts_in_its_posture_runs_without_a_doubt():
    rig = rig_of("two_contact_rod", "object.pose=null")
    assert osc.preflight(rig) == ()
    assert norm(rig_of().state.X_WO.translation - rig.state.X_WO.translation) < 1e-3


def test_where_no_arm_determines_the_pose_it_must_be_given():
    changes = ["object.pose=null", "grasps.left.type=ball", "grasps.left.axis=null"]
    with model_error("pose"):
        rig_of("hinge_ball_rod", *changes)


# `osc-contact new`: a scenario for any arm, which runs and is OK.


ARMS = {
    "ur10": ("tool0", "Z=15"),
    "panda": ("panda_hand_tcp", "Z=15"),
    "xarm": ("link_eef", "-X=10"),
    "so100": ("jaw", "Z=3"),
    "kinova": ("j2s6s200_end_effector", "Z=10"),
    "z1": ("gripperStator", "X=10"),
    "baxter": ("left_gripper", "Z=10"),
    "tiago_pro": ("arm_left_tool_link", "Z=10"),
    "talos_left_arm": ("wrist_left_ft_tool_link", "Z=10"),
}


@parametrize("robot", chosen(ARMS, "ur10", "xarm", "so100", "baxter"))
def test_what_it_writes_runs_and_is_ok(robot, tmp_path):
    tip, press = ARMS[robot]
    file = tmp_path / "my.yaml"
    done(f"new --robot {robot} --tip {tip} --press={press} --out", file)
    scenario = osc.load_scenario(file)
    rig = rig_of(scenario)
    assert osc.preflight(rig) == ()
    verdict = verdict_of(scenario, seed=1)
    assert verdict["task"]["word"] == "OK" and verdict["contact_fraction"] == {"ball": 1.0}
    commanded = Press.parse(press)
    assert verdict["force"]["ball"]["mean_command_N"] == approx(commanded.force)
    assert verdict["force"]["ball"]["rms_error_rel"] < 0.05
    chain = rig.chain
    chain.state(rig.q_contact)
    pressed = chain.tip_poses()[0].rotation @ commanded.axis
    assert_near(-pressed, scenario.contacts[0].face.normal, atol=1e-4)


def test_the_command_line_runs_what_it_wrote_and_keeps_files_of_others(tmp_path, no_figures):
    file = tmp_path / "arm.yaml"
    line = "new --robot ur10 --tip tool0 --posture '0, -90 deg, 90 deg, -90 deg, -90 deg, 0' --out"
    done(line, file)
    assert "exists; give another file" in refused(line, file)
    assert "verdict: OK" in done("run", file, "--out", tmp_path / "out").stdout


@parametrize(
    "words, message",
    {
        "ur10 --press W=3": "an axis of the tip and newtons, such as Z=15",
        "ur10 --press Z=-3": "an axis of the tip and newtons",
        "ur10 --press Z=5000": "times their limits",
        "ur10 --posture '1, 2'": "2 numbers for 6 joints",
        "ur11": "no robot 'ur11'",
        "panda": "has 3 ends",
    },
)
def test_what_cannot_be_is_refused_and_nothing_is_written(words, message, tmp_path):
    assert message in refused(f"new --robot {words} --out", tmp_path / "x.yaml")
    assert not list(tmp_path.iterdir())


def test_a_plane_wall_has_an_exact_normal():
    """Six digits of the posture turn the tip by 1e-6; on such a wall motions would be screws."""
    urdf, _ = robots.find_robot("ur10")
    arm = osc.Arm.from_urdf(urdf, name="ur10", tip="tool0")
    q = np.round(np.deg2rad([0.0, -30.0, -30.0, -30.0, -90.0, 0.0]), 6)

    def normal(q):
        data = yaml.safe_load(_text("ur10", arm, Press.parse("Z=15"), q))
        return data["contacts"][0]["face"]["normal"]

    assert sorted(np.abs(normal(q))) == [0.0, 0.0, 1.0]
    slanted = normal(q + 0.3)
    assert norm(slanted) == approx(1.0, abs=1e-6) and np.abs(slanted).min() > 1e-3
