"""Rotors and friction of joints; mimics, endless joints, a wrist that carries nothing."""

import numpy as np
import pinocchio as pin
from complaints import model_error, scenario_error
from numpy.linalg import inv
from numpy.testing import assert_array_equal
from pytest import approx, fixture, mark
from rigs import assert_near, holding_panda, panda_arm, ticked, vector
from robot_numbers import mass_matrix
from samples import aligned, parametrize
from scenario_runs import rig_of, verdict_of, worst_force

import osc_contact as osc
from osc_contact import robots
from osc_contact.lab.checks.inspection import inspect_rig
from osc_contact.lab.reports.report import verdict_table

ROTORS = vector(0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05)
DRY = vector(2.0, 1.5, 1.0, 1.0, 0.5, 0.4, 0.3)
VISCOUS = vector(3.0, 2.0, 1.0, 1.0, 0.5, 0.4, 0.3)
GAINS = osc.Gains(osc.MotionGains(400.0, 40.0, 0.0), osc.ForceGains(30.0))


def panda(**joints):
    return holding_panda(panda_arm(**joints))


def test_friction_damping_and_armature_are_shown_wherever_a_robot_is():
    """`check`, `inspect` and verdicts show values other than zero with their units."""
    checked = "\n".join(robots.check_robot(robots.find_robot("xarm7")[0]).lines())
    assert "joints: friction 1 N m (every joint); damping 10 N m s/rad (joint1, joint2)" in checked
    changes = ["arms.left.friction=[1, 1, 20, 0.5, 0]", "arms.right.armature=0.1"]
    scenario = osc.load_scenario("two_contact_rod", [*changes, "duration=1.1 s"])
    words = (
        "friction 1 N m (joint1, joint2), 20 N (joint3), 0.5 N m (joint4); no damping; no armature",
        "no friction; no damping; "
        "armature 0.1 kg m² (joint1, joint2, joint4, hinge), 0.1 kg (joint3)",
    )
    sides = ("left", "right")
    lines = inspect_rig(rig_of(scenario)).lines
    assert {f"joints of '{arm}': {own}" for arm, own in aligned(sides, words)} <= {*lines}
    (least,) = (line for line in lines if "observer unstable" in line)
    assert "joint4, 0.1 in the model" in least and "hinge" not in least
    verdict = verdict_of(scenario)
    assert verdict["joint_losses"][2] == {
        "joint": "left/joint3",
        "friction": 20.0,
        "damping": 0.0,
        "armature": 0.0,
        "slides": True,
    }
    rows = dict(aligned(*[list(column.cells) for column in verdict_table(verdict).columns]))
    assert [rows[f"joints {arm}, in the model"] for arm in ("left", "right")] == list(words)


def test_rotors_behind_gears_count_with_the_square_of_the_ratio():
    def armature():
        arm = osc.Arm.from_urdf(model, name="arm", tip="panda_hand_tcp")
        return osc.ClosedChain([arm]).model.armature

    model = robots.load_model(robots.find_robot("panda")[0])
    model.rotorInertia = np.full(model.nv, 2e-5)
    model.rotorGearRatio = np.arange(model.nv) * 10.0
    assert_near(armature(), 2e-5 * (np.arange(7) * 10.0) ** 2)
    model.armature = np.full(model.nv, 0.3)  # it is the inertia at the joint
    assert_array_equal(armature(), 0.3)


def test_a_transmission_states_rotor_and_gear(tmp_path):
    text = robots.urdf_path("scara_left").read_text()
    gear = (
        '<transmission name="t"><type>x</type><joint name="joint1"/><actuator name="m">'
        "<rotorInertia>0.0001</rotorInertia><mechanicalReduction>-100</mechanicalReduction>"
        "</actuator></transmission></robot>"
    )
    file = tmp_path / "geared.urdf"
    file.write_text(text.replace("</robot>", gear))
    arm = osc.Arm.from_urdf(file, name="a", tip="tool", passive_joints=["hinge"])
    assert_near(osc.ClosedChain([arm]).model.armature, [1.0, 0, 0, 0, 0])


def test_friction_in_a_urdf_arrives():
    urdf, _ = robots.find_robot("talos_left_arm")
    arm = osc.Arm.from_urdf(urdf, name="a", tip="gripper_left_base_link")
    model = osc.ClosedChain([arm]).model
    assert_array_equal(model.damping, 1.0)
    assert_array_equal(model.upperDryFrictionLimit, 1.0)


@parametrize("key", ["armature", "damping", "friction"])
@parametrize("value", [[1.0, 2.0], -0.1, np.nan])
def test_wrong_numbers_of_joints_are_refused_with_their_name(key, value):
    with model_error(key):
        panda(**{key: value})


# --- plants ---------------------------------------------------------------------------------------


def test_mujocos_mass_matrix_is_that_of_chain_and_object():
    rig = rig_of("ur5_wipe", "arms.ur5.armature=[1, 2, 3, 4, 5, 6]")
    plant = rig.plant()
    state = rig.state
    M = mass_matrix(plant.model, plant.data)
    J = state.arms[0].J
    assert_near(M[np.ix_(plant._v, plant._v)], state.M + J.T @ state.payload.Lambda @ J, atol=1e-6)


@parametrize("plant", ["mujoco", "rigid"])
def test_a_joint_that_nothing_drives_is_slowed_by_its_friction(plant):
    """Speed lost in 5 ms: (F + D v)/(M⁻¹)⁻¹ of the joint, others free, no gravity to speak of."""
    bare = (*(f"{key}=[]" for key in ("contacts", "environment", "motion")), "force={}")
    rubs = (
        f"arms.ur5.{key}=[0, 0, 0, 0, 0, {x}]" for key, x in (("friction", 0.3), ("damping", 0.2))
    )
    lost = []
    for extra in ((), rubs):
        rig = rig_of("ur5_wipe", f"plant.type={plant}", "control.rate=1 kHz", *bare, *extra)
        world = rig.plant()
        v = np.zeros(6)
        v[5] = 0.5
        if plant == "rigid":
            world.v = v
        else:
            world.data.qvel[world._v] = v
        world.command(np.zeros(6), 5e-3)
        lost.append(world.measure().v[5])
    state = rig.state
    J = state.arms[0].J
    rate = inv(state.M + J.T @ state.payload.Lambda @ J)[5, 5]
    assert lost[0] - lost[1] == approx(rate * (0.3 + 0.2 * 0.5) * 5e-3, rel=0.05)


def test_known_friction_is_made_up_for():
    """0.5 % of the effort limits: known at least five times as good as unknown."""
    friction = "arms.ur5.friction=[0.75, 0.75, 0.75, 0.14, 0.14, 0.14]"
    known, unknown = (
        worst_force(verdict_of("ur5_wipe", friction, *extra, duration=3.0))
        for extra in ((), ("control.joint_friction=false",))
    )
    assert known < 0.03 and unknown > 0.1


def test_joints_with_springs_have_their_rotors_in_the_springs():
    with scenario_error("motor_inertia"):
        rig_of(
            "two_contact_rod",
            *(f"arms.{side}.armature=0.1" for side in ("left", "right")),
            "plant.flexible_joints={frequency: 5 Hz}",
        ).plant()


@parametrize("given", ["arms.ur5.damping=2", "tare={}"])
def test_inspect_names_what_limits_compensation_of_friction(given):
    """D/m > K = 100/s where the rotor is missing; the least rotor leaves m g/(1 + g) in all."""
    rig = rig_of("ur5_wipe", given, "arms.ur5.armature=0.3")
    lines = inspect_rig(rig).lines
    (least,) = (line for line in lines if "observer unstable" in line)
    M = rig.model.state(rig.q_contact).M
    for name, m in aligned(rig.model.arms[0].model.names[1:], 1.0 / np.diag(inv(M))):
        needed = 0.3 - m + m * 0.7 / 1.7
        assert (f"{needed:.2g} ({name}, 0.3 in the model)" in least) == (needed > 0.0)
    assert not any("damping over inertia" in line for line in lines)
    lines = inspect_rig(rig_of("ur5_wipe", "arms.ur5.damping=2")).lines
    (fast,) = (line for line in lines if "damping over inertia" in line)
    assert "118 1/s (wrist_3_joint)" in fast and not any("unstable" in line for line in lines)


def test_errors_of_rotors_are_in_the_model_alone():
    rig = rig_of("ur5_wipe", "arms.ur5.armature=0.5", "model_error.armature=0.6")
    assert_near(rig.chain.model.armature, 0.5)
    assert_near(rig.model.model.armature, 0.3)


# Joints and sensors out of the ordinary


LINK = (
    '<link name="{0}"><inertial><mass value="1"/><origin xyz="0 0 0.1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="0 0 0.2"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="3"/>{4}</joint>'
)


@fixture
def urdf(tmp_path):
    """A chain a, b, c, then a gripper g beside c; b and g follow a's joint; c has no end stops."""
    follows = '<mimic joint="ja" multiplier="-1"/>'
    parts = ['<link name="base"/>', *(LINK.format(name) for name in "abcg")]
    parts += [
        JOINT.format("ja", "revolute", "base", "a", ""),
        JOINT.format("jb", "revolute", "a", "b", follows),
        JOINT.format("jc", "continuous", "b", "c", ""),
        JOINT.format("jg", "revolute", "b", "g", follows),
    ]
    file = tmp_path / "mimic.urdf"
    file.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return file


def test_a_joint_that_follows_another_one_on_the_way_to_the_tip_is_refused_with_the_cure(urdf):
    for file in (urdf, pin.buildModelFromUrdf(str(urdf), mimic=True)):
        with model_error(r"'jb' on the way .* follows joint 'ja'.* Lock"):
            osc.Arm.from_urdf(file, name="arm", tip="c")


def test_before_it_or_with_both_locked_the_arm_is_there(urdf, caplog):
    """Followers that the tip does not need are held; masters that move the tip are reported."""
    assert list(osc.Arm.from_urdf(urdf, name="arm", tip="a").model.names)[1:] == ["ja"]
    assert "joint 'jg' follows 'ja', which moves the tip; it is locked at 0" in caplog.text
    caplog.clear()
    arm = osc.Arm.from_urdf(urdf, name="arm", tip="c", locked={"ja": 0.2, "jb": -0.2})
    assert not caplog.text
    assert list(arm.model.names)[1:] == ["jc"]
    assert np.isinf(arm.model.upperPositionLimit).all()


@mark.parametrize("reading", ["filter", "least_squares", None])
def test_a_wrist_sensor_with_nothing_beyond_it_reads_the_contact_wrench(reading):
    """7 N on the tip of a Panda, whose sensor sits in the massless frame of the tip."""
    chain = osc.ClosedChain([panda_arm(wrist_sensor="panda_hand_tcp")])
    q = vector(0.0, -0.7, 0.2, -2.2, 0.1, 1.6, 0.7)
    state = chain.state(q)
    p = state.X_WO.translation
    R = state.X_WO.rotation
    face = osc.VertexOnFace([0, 0, 0], p, [0, 0, 1], name="face")
    controller = osc.Controller(chain, [face], posture=q, reading=reading)
    wrench = np.append(R.T @ [0.0, 0.0, -7.0], np.zeros(3))  # of the arm on the surface
    reference = osc.pose_reference(p, R, alpha_d=[10.0])
    for _ in range(3):
        ticked(controller, osc.Measurement(q, np.zeros(7), wrench[None]), reference)
        assert_near(controller.result().alpha_meas, 7.0, atol=1e-9)
