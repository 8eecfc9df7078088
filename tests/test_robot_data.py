"""The robots of example-robot-data: which load, which need a hand, which are refused and why."""

import math
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
from complaints import invalid_input, model_error
from numpy.testing import assert_allclose
from pytest import mark, raises

import osc_contact as osc
from osc_contact import robots
from osc_contact.errors import ModelError
from osc_contact.robots import JointLimits, loading

SOUND = (
    # arms, and upper bodies with arms
    "TwoDofs",
    "alex_nub_hands",
    "alex_sake_hands",
    "baxter",
    "borinot_flying_arm_2",
    "finger_edu",
    "hextilt_flying_arm_5",
    "kinova",
    "panda",
    "panda_collision",
    "so100",
    "so101",
    "talos_left_arm",
    "tiago_pro",
    "ur10",
    "ur10_joint_limited",
    "ur3_gripper",
    "ur3_joint_limited",
    "ur3_robot",
    "ur5",
    "ur5_gripper",
    "ur5_joint_limited",
    "xarm",
    "z1",
    # legged and flying robots
    "a1",
    "alexander_v1.lowerBodyOnly",
    "g1_29dof_rev_1_0",
    "g1_29dof_with_hand_rev_1_0",
    "go2",
    "quadrotor_base",
    "human",
    "icub_reduced",
    "iris_simple",
    "laikago",
    "simple_humanoid",
    "simple_humanoid_classical",
    "solo",
    "solo12",
    "talos_full_v2",
    "talos_full_v2_box",
    "talos_reduced",
    "talos_reduced_box",
    "talos_reduced_corrected",
)
"""They load as they are."""
MOTOR = JointLimits(effort=5.0, velocity=5.0)
SWING = JointLimits(-math.inf, math.inf, 5.0, 5.0)
POSITIVE = ("inertia", {"inertias": "positive"})
HELPED = {
    "allegro_left_hand": POSITIVE,
    "allegro_right_hand": POSITIVE,
    "anymal-kinova": POSITIVE,
    "anymal_b_simple_description/anymal": POSITIVE,
    "anymal_c_simple_description/anymal": POSITIVE,
    "b1-z1": POSITIVE,
    "b1_description/b1": POSITIVE,
    "bolt": POSITIVE,
    "centauro": ("limit", {"limits": {"j_wheel_*": SWING}}),
    "double_pendulum": ("limit", {"limits": {"joint?": SWING}}),
    "double_pendulum_simple": ("limit", {"limits": {"*": SWING}}),
    "double_pendulum_continuous": ("limit", {"limits": {"*": MOTOR}}),
    "go1": POSITIVE,
    "hyq_no_sensors": POSITIVE,
    "iris": ("limit", {"limits": {"*": MOTOR}}),
    "pr2": POSITIVE,
    "quadruped": ("limit", {"limits": {"*": JointLimits(-3, 3)}}),
    "romeo_small": POSITIVE,
    "tiago": POSITIVE,
    "tiago_dual": ("limit", {"limits": {"caster*": MOTOR}, "inertias": "positive"}),
    "tiago_no_hand": POSITIVE,
}
"""What the file lacks, and what makes it usable."""
REFUSED = {
    "alex_psyonic_hands": "follows the joint 'index_q1', which does not exist",
    "icub": "joint 'neck_roll': the mass matrix is not positive definite",
    "romeo_description/romeo": "effort limit 0 N m must be > 0",
    "romeo_laas_small": "meshes of the type .mesh are not read",
    "ur_description/ur3": "the robot has no link",
}
"""Defects that no option mends."""


def test_every_robot_of_the_data_package_has_a_verdict():
    names = (*SOUND, *HELPED, *REFUSED)
    files = [robots.find_robot(name)[0] for name in names]
    assert len(set(files)) == len(files)
    assert set(files) == set(loading._robot_data_root().glob("*/*/*.urdf"))


def test_the_page_on_robots_has_these_verdicts():
    page = (Path(__file__).parent.parent / "docs" / "robots.md").read_text()
    told = re.search(
        r"Of its (\d+) files (\d+) load unchanged.*?(\d+) need.*?(\d+) are", page, re.S
    )
    counts = [len(group) for group in (SOUND, HELPED, REFUSED)]
    assert [int(n) for n in told.groups()] == [sum(counts), *counts]
    table = page.split("| robots | what is wrong")[1]
    for name in (*HELPED, *REFUSED):
        assert f"`{name.rpartition('/')[2]}`" in table, name


@mark.parametrize("name", SOUND)
def test_sound_robot_loads_and_both_readers_agree(name):
    file, package_dir = robots.find_robot(name)
    model = robots.load_model(file, package_dirs=[package_dir])
    assert model.nq == model.nv
    if model.nv < 20:
        assert robots.cross_check(file) < 1e-12


@mark.parametrize("name", HELPED)
def test_robot_with_defects_is_refused_and_usable_with_a_decision(name):
    file = robots.find_robot(name)[0]
    (check, options) = HELPED[name]
    with raises(ModelError) as caught:
        robots.load_model(file)
    assert caught.value.findings[0].check == check
    assert {finding.file for finding in caught.value.findings} == {file}
    assert robots.load_model(file, **options).nv > 0


@mark.parametrize("name", REFUSED)
def test_defect_robot_is_refused_with_its_reason(name):
    with model_error(REFUSED[name].replace(".", r"\.")):
        robots.load_model(robots.find_robot(name)[0], inertias="positive")
    if name == "romeo_description/romeo":
        with model_error("mass matrix is not positive definite"):
            robots.load_model(robots.find_robot(name)[0], limits={"*": MOTOR})


@mark.parametrize("name", ["panda", "ur5", "xarm", "solo12", "talos_left_arm"])
def test_the_model_is_the_one_pinocchio_reads_from_the_file(name):
    """Nothing is lost on the way through our own text: bodies, joints, frames, limits."""
    file = robots.find_robot(name)[0]
    ours = robots.load_model(file)
    theirs = pin.buildModelFromUrdf(str(file))
    assert ours == theirs and ours.name == theirs.name
    assert [(f.name, f.type) for f in ours.frames] == [(f.name, f.type) for f in theirs.frames]


# Continuous joints ------------------------------------------------------------------------------


@mark.parametrize("seed", range(5))
@mark.parametrize("name", ["kinova", "double_pendulum_continuous", "tiago_pro"])
def test_continuous_joint_is_a_revolute_joint_without_end_stops(name, seed):
    """Against Pinocchio's own (cos, sin) model at the same posture, velocity and acceleration."""
    file = robots.find_robot(name)[0]
    given = {"limits": {"*": MOTOR}} if name == "double_pendulum_continuous" else {}
    ours = robots.load_model(file, **given)
    theirs = pin.buildModelFromUrdf(str(file))
    assert theirs.nq > theirs.nv == ours.nv == ours.nq
    rng = np.random.default_rng(seed)
    q = rng.uniform(-9, 9, ours.nq)
    v, a = rng.normal(size=(2, ours.nv))
    x = []
    for angle, other in zip(q, list(theirs.joints)[1:], strict=True):
        x += [math.cos(angle), math.sin(angle)] if other.nq == 2 else [angle]
    endless = [joint.nq == 2 for joint in list(theirs.joints)[1:]]
    for limit in (ours.lowerPositionLimit, ours.upperPositionLimit):
        assert np.isinf(limit).tolist() == endless
    found = []
    for model, at in ((ours, q), (theirs, np.array(x))):
        data = model.createData()
        tau = pin.rnea(model, data, at, v, a)
        pin.framesForwardKinematics(model, data, at)
        found.append((tau, [X.homogeneous for X in data.oMf]))
    (tau, poses), (their_tau, their_poses) = found
    assert_allclose(tau, their_tau, atol=1e-10)
    assert_allclose(poses, their_poses, atol=1e-13)


def test_an_arm_with_continuous_joints_makes_a_chain_any_number_of_turns_round():
    urdf = robots.find_robot("kinova")[0]
    arm = osc.Arm.from_urdf(urdf, name="k", tip="j2s6s200_end_effector")
    chain = osc.ClosedChain([arm])
    q = np.array([0.3, 2.9, 1.3, 4.2, 1.4, 0.2])
    turned = q + 2 * np.pi * np.array([3, 0, 0, -2, 0, 1])  # the continuous ones
    here, there = (chain.state(x, np.full(6, 0.1)) for x in (q, turned))
    assert_allclose(there.X_WO.homogeneous, here.X_WO.homogeneous, atol=1e-13)
    assert_allclose(there.metric, here.metric, rtol=1e-9, atol=1e-11)


def test_ready_models_are_judged_too():
    wrapped = pin.buildModelFromUrdf(str(robots.find_robot("kinova")[0]))
    with model_error(r"j2s6s200_joint_1.*nq = 2 but nv = 1; load the URDF by"):
        osc.Arm.from_urdf(wrapped, name="k", tip="j2s6s200_end_effector")
    panda = robots.load_model(robots.find_robot("panda")[0])
    for i in range(7, panda.njoints):
        panda.inertias[i] = pin.Inertia.Zero()
    with model_error("panda_joint7 can move without moving mass"):
        osc.Arm.from_urdf(panda, name="p", tip="panda_hand_tcp")


# Meshes -----------------------------------------------------------------------------------------


def mesh_robot(folder, address):
    file = folder / "arm.urdf"
    file.write_text(
        '<robot name="r"><link name="a"><visual><geometry>'
        f'<mesh filename="{address}"/></geometry></visual></link></robot>'
    )
    return file


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def test_meshes_are_read_from_the_folders_of_the_robot_only(tmp_path):
    inside = tmp_path / "robot"
    outside = tmp_path / "secret"
    for folder in (inside, outside):
        folder.mkdir()
        (folder / "m.obj").write_text(TRIANGLE)
    kind = pin.GeometryType.VISUAL
    _, geometry, _ = robots.load_geometry(mesh_robot(inside, "m.obj"), kind)
    assert geometry.ngeoms == 1
    absolute = mesh_robot(inside, str(outside / "m.obj"))
    with model_error("outside of the robot's folders"):
        robots.load_geometry(absolute, kind)
    assert robots.load_geometry(absolute, kind, [outside])[1].ngeoms == 1
    (inside / "link.obj").symlink_to(outside / "m.obj")
    with model_error(r"leads to .*/secret/m\.obj, outside"):
        robots.load_geometry(mesh_robot(inside, "link.obj"), kind)
    with model_error("the mesh is not there; looked for"):
        robots.load_geometry(mesh_robot(inside, "package://robot/m.obj"), kind)
    packaged = mesh_robot(inside, "package://robot/m.obj")
    assert robots.load_geometry(packaged, kind, [tmp_path])[1].ngeoms == 1


@mark.parametrize("texture", ["/etc/hostname", "file:///etc/hostname", "../../secret.png"])
def test_collada_files_that_take_textures_from_elsewhere_are_refused(tmp_path, texture):
    (tmp_path / "m.dae").write_text(f"<COLLADA><init_from> {texture} </init_from></COLLADA>")
    with model_error(r"m\.dae takes a texture from"):
        robots.load_geometry(mesh_robot(tmp_path, "m.dae"), pin.GeometryType.VISUAL)


def test_limits_as_words_of_the_command_line():
    assert JointLimits.parse("arm/j*:effort=5,velocity=2.5") == (
        "arm/j*",
        JointLimits(effort=5.0, velocity=2.5),
    )
    for wrong in ("j1", "effort=5", "j1:torque=3", "j1:effort=x", "j1:effort=-1", "j1:"):
        with invalid_input(r"j1|effort"):
            JointLimits.parse(wrong)
