"""Robots: the packaged ones, those of example-robot-data; every bad file is refused."""

import re

import numpy as np
import pinocchio as pin
from command_line import refused
from complaints import invalid_input, model_error
from pytest import approx, raises
from rigs import assert_near, placed
from samples import ROOT, aligned, parametrize
from second_reader import urdf_difference

import osc_contact as osc
from osc_contact import robots
from osc_contact.robots import JointLimits, loading
from osc_contact.robots.model import build_model

ARMS = ("scara_left.urdf", "scara_right.urdf")
MIRROR = np.diag([1.0, -1.0, 1.0])


def limits(model):
    """Limits of effort, speed, and lower and upper position."""
    position = (model.lowerPositionLimit, model.upperPositionLimit)
    return [x.tolist() for x in (model.effortLimit, model.velocityLimit, *position)]


# The packaged arms ------------------------------------------------------------------------------


@parametrize("name", ARMS)
def test_scara_has_the_announced_joints_and_limits(name):
    model = robots.load_model(robots.urdf_path(name))
    assert list(model.names)[1:] == ["joint1", "joint2", "joint3", "joint4", "hinge"]
    kinds = [joint.shortname()[-2:] for joint in model.joints[1:]]
    assert kinds == ["RZ", "RZ", "ed", "RZ", "RY"], "the third is prismatic, unaligned: downwards"
    assert limits(model) == [
        [60, 35, 200, 10, 1],
        [3, 4, 1, 8, 10],
        [-2.9, -2.7, 0, -3.1, -1.2],
        [2.9, 2.7, 0.26, 3.1, 1.2],
    ]
    assert not model.upperDryFrictionLimit.any() and not model.damping.any()
    masses = [inertia.mass for inertia in model.inertias]
    assert masses == approx([8.0, 4.0, 2.5, 0.9, 0.3 + 0.35, 0.15])
    _, solids, _ = robots.load_geometry(robots.urdf_path(name), pin.GeometryType.VISUAL)
    assert {one.parentJoint for one in solids.geometryObjects} == {*range(model.njoints)}


def test_right_arm_is_the_mirror_image_of_the_left():
    left, right = (robots.load_model(robots.urdf_path(name)) for name in ARMS)
    for one, other in aligned(left.inertias, right.inertias):
        assert_near(other.lever, MIRROR @ one.lever, atol=1e-9)
        assert_near(other.inertia, MIRROR @ one.inertia @ MIRROR, atol=1e-9)
    for a, b in aligned(left.jointPlacements, right.jointPlacements):
        assert a.isApprox(b, 1e-14)


# The packaged bodies ----------------------------------------------------------------------------


def test_rod_inertia_is_that_of_a_capsule():
    rod = robots.load_body(robots.urdf_path("rod.urdf"))
    turned = placed(rpy=(0, np.pi / 2, 0)).act(pin.Inertia.FromCapsule(1.5, 0.01, 0.58))
    assert_near(rod.matrix(), turned.matrix(), atol=1e-9, rtol=1e-6)


# Second readers ---------------------------------------------------------------------------------


@parametrize("name", [*ARMS, "rod.urdf", "face.urdf"])
def test_a_second_reader_places_every_link_alike(name):
    assert urdf_difference(robots.urdf_path(name)) < 1e-12


# Where files are found --------------------------------------------------------------------------


def test_urdf_path_knows_the_packaged_files():
    assert robots.urdf_path("rod.urdf") == robots.urdf_path("rod")
    assert robots.urdf_path("rod").is_file()
    assert toy().frames[robots.frame_id(toy(), "tool")].name == "tool"


@parametrize(
    "find, name, words",
    [
        (robots.urdf_path, "scara_lft.urdf", r"did you mean 'scara_left\.urdf'"),
        (robots.urdf_path, "../urdf/rod.urdf", "no packaged URDF is called '../urdf/rod.urdf'"),
        (robots.find_robot, "pandda", "did you mean 'panda'"),
        (robots.find_robot, "anymal", r"ambiguous.*anymal_c_simple_description/anymal"),
        (robots.resolve_urdf, "fce.urdf", r"did you mean 'face\.urdf'"),
        (robots.load_model, "absent.urdf", "does not exist"),
        (robots.load_model, ".", "is not a file"),
        (lambda name: robots.frame_id(toy(), name), "tol", "no frame 'tol'; did you mean 'tool'"),
    ],
)
def test_names_of_nothing_are_refused(find, name, words):
    with model_error(words):
        find(name)


def toy():
    return robots.load_model(robots.urdf_path("scara_left"))


def test_urdf_path_finds_the_folder_of_an_installed_package(monkeypatch, tmp_path):
    monkeypatch.setattr(loading, "_PACKAGE", tmp_path.resolve() / "osc_contact")
    for folder in (tmp_path / "urdf", tmp_path / "osc_contact/urdf"):
        folder.mkdir(parents=True)
        (folder / "rod.urdf").touch()
        assert robots.urdf_path("rod") == folder.resolve() / "rod.urdf"


def test_robots_are_found_by_folder_too():
    path, _ = robots.find_robot("anymal_c_simple_description/anymal")
    assert path.parent.parent.name == "anymal_c_simple_description"
    assert robots.find_robot("xarm")[0].name == "xarm7.urdf"


def test_a_robot_that_is_not_known_is_refused_with_the_names_of_all():
    message = refused("check nosuchrobot")
    root = robots.find_robot("panda")[1] / "example-robot-data/robots"
    names = {path.stem.removesuffix("_robot") for path in root.glob("*/*/*.urdf")}
    assert len(names) > 60 and all(name in message for name in names)
    assert "scara_left" in message and "did you mean" not in message
    assert "did you mean 'panda'" in refused("check pandda")


def test_missing_robot_data_names_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(loading.pin, "__file__", f"{tmp_path}/lib/py/site/pinocchio/__init__.py")
    monkeypatch.setattr(loading, "ROBOT_DATA", "no-such-robot-data")
    with model_error("pip install no-such-robot-data"):
        robots.find_robot("panda")


def test_resolve_urdf_knows_three_places(tmp_path):
    own = tmp_path / "rod.urdf"
    own.write_text(robots.urdf_path("rod.urdf").read_text())
    assert robots.resolve_urdf("rod.urdf", tmp_path) == (robots.urdf_path("rod.urdf"), ())
    assert robots.resolve_urdf("./rod.urdf", tmp_path) == (own.resolve(), (tmp_path.resolve(),))
    assert robots.resolve_urdf(str(own)) == (own.resolve(), (tmp_path.resolve(),))
    panda, package_dir = robots.find_robot("panda")
    assert robots.resolve_urdf("example-robot-data:panda", tmp_path) == (panda, (package_dir,))


def test_frame_id_prefers_the_body_over_a_joint_of_the_same_name(tmp_path):
    model = robots.load_model(write(tmp_path, joint="tip"))
    assert model.frames[robots.frame_id(model, "tip")].type == pin.FrameType.BODY


# Files that are refused -------------------------------------------------------------------------


def inertial(mass, ixx, iyy, izz):
    moments = f'ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"'
    return f'<inertial><mass value="{mass}"/><inertia {moments}/></inertial>'


BALL = inertial(1, 0.1, 0.1, 0.1)
LIMIT = '<limit lower="-1" upper="1" effort="2" velocity="3"/>'


def write(folder, *changes, limit=LIMIT, joint="turn", kind="revolute", **links):
    """A chain base → link → … of joints of one kind, as a file; changes (old, new) of its text."""
    text = '<robot name="toy"><link name="base"/>'
    parent = "base"
    for i, (name, content) in enumerate((links or {"tip": BALL}).items()):
        label = f"next{i}" if i else joint
        text += (
            f'<link name="{name}">{content}</link><joint name="{label}" type="{kind}">'
            f'<parent link="{parent}"/><child link="{name}"/><origin xyz="0.1 0 0"/>'
            f'<axis xyz="0 0 1"/>{limit}</joint>'
        )
        parent = name
    for old, new in changes:
        text = text.replace(old, new)
    file = folder / "toy.urdf"
    file.write_text(f"{text}</robot>")
    return file


def test_thin_rods_and_massless_markers_are_accepted(tmp_path):
    bodies = {"marker": inertial(0, 0, 0, 0), "tip": inertial(1, 0, 0.1, 0.1)}
    fixed = ('name="turn" type="revolute"', 'name="turn" type="fixed"')
    assert robots.load_model(write(tmp_path, fixed, **bodies)).nv == 1


def test_parallel_joints_with_one_mass_between_them_are_named(tmp_path):
    file = write(tmp_path, ('<origin xyz="0.1 0 0"/>', ""), empty="", tip=BALL)
    with model_error("joint turn, next1 can move without moving mass"):
        robots.load_model(file)


def test_load_body_wants_one_rigid_link(tmp_path):
    with model_error("these joints move: turn"):
        robots.load_body(write(tmp_path))
    with model_error(r"found 2 \(tip, end\)"):
        robots.load_body(write(tmp_path, kind="fixed", tip=BALL, end=BALL))
    with model_error(r"found 0 \(none\)"):
        robots.load_body(write(tmp_path, kind="fixed", tip=""))
    assert_near(robots.load_body(write(tmp_path, kind="fixed")).lever, [0.1, 0, 0])


def test_the_second_reader_notices_a_joint_that_is_2_nm_off(tmp_path, monkeypatch):
    def crooked(document):
        model = build_model(document)
        model.jointPlacements[1].translation += [0, 2e-9, 0]
        return model

    monkeypatch.setattr(loading, "build_model", crooked)
    assert urdf_difference(write(tmp_path)) == approx(2e-9)


# Limits and inertias by choice -------------------------------------------------------------------


def test_limits_given_by_hand_stand_in_for_missing_ones(tmp_path):
    file = write(tmp_path, limit="", tip=BALL, end=BALL)
    with model_error(r"joint 'turn': has no <limit>.*JointLimits"):
        robots.load_model(file)
    given = JointLimits(lower=-1.5, upper=2.5, effort=7, velocity=3)
    free = JointLimits(-np.inf, np.inf, 4, 5)
    model = robots.load_model(file, limits={"next*": free, "turn": given})
    assert limits(model) == [[7, 4], [3, 5], [-1.5, -np.inf], [2.5, np.inf]]
    with invalid_input(r"no moving joint matches 'trun'; did you mean 'turn'"):
        robots.load_model(file, limits={"trun": given})


def test_limits_given_by_hand_win_over_those_of_the_file(tmp_path):
    file = write(tmp_path, limit=LIMIT.replace('effort="2"', 'effort="0"'))
    model = robots.load_model(file, limits={"turn": JointLimits(effort=9)})
    assert model.effortLimit[0] == 9 and model.velocityLimit[0] == 3
    with model_error("lower limit 5 is above the upper limit 1"):
        robots.load_model(file, limits={"turn": JointLimits(lower=5, effort=9)})


@parametrize(
    "wrong",
    [
        {"effort": 0.0},
        {"effort": np.inf},
        {"velocity": np.nan},
        {"velocity": -1.0},
        {"lower": 2.0, "upper": 1.0},
        {"lower": np.nan},
        {"upper": -np.inf},
    ],
)
def test_impossible_limits_cannot_be_given(wrong):
    with invalid_input("JointLimits"):
        JointLimits(**wrong)


def test_positive_is_content_with_moving_bodies_that_have_energy(tmp_path):
    slip = inertial(0.1, 1e-3, 1e-3, -1e-3)  # a link no body can be, fixed to a good one
    fixed = ('name="next1" type="revolute"', 'name="next0" type="fixed"')
    file = write(tmp_path, fixed, tip=BALL, flag=slip)
    with model_error("link 'flag' <inertia>: the inertia is not positive"):
        robots.load_model(file)
    assert robots.load_model(file, inertias="positive").nv == 1
    alone = write(tmp_path, tip=inertial(0.1, 1e-3, 1e-3, -9e-3))
    with model_error(r"joint 'turn': the body that it moves .* negative"):
        robots.load_model(alone, inertias="positive")
    flat = write(tmp_path, tip=inertial(1, 0.1, 0.1, 0.3))
    assert robots.load_model(flat, inertias="positive").nv == 1
    heavy = write(tmp_path, tip=inertial(-1, 0.1, 0.1, 0.1))
    with model_error("mass -1 kg is negative"):
        robots.load_model(heavy, inertias="positive")
    with invalid_input("there is: possible, positive"):
        robots.load_model(file, inertias="any")


@parametrize("length", [1e-3, 1.0, 1e3], ids=["mm", "m", "km"])
@parametrize("mass", [1e-3, 1.0, 1e3], ids=["g", "kg", "t"])
@parametrize("rotor", [0.0, 1e-9, 1e-15])
def test_the_verdict_on_the_mass_matrix_does_not_depend_on_units(tmp_path, length, mass, rotor):
    """A slide, a turn and a slim rod about its own axis: an inertia of 1e-15 kg m² is rounding."""
    moment = mass * length**2
    rod = inertial(mass, 0.1 * moment, 0.1 * moment, rotor * moment)
    slim = rod.replace("<inertial>", f'<inertial><origin xyz="0 0 {0.5 * length}"/>')
    scaled = ('xyz="0.1 0 0"', f'xyz="{0.3 * length} 0 0"')
    sliding = ('name="turn" type="revolute"', 'name="turn" type="prismatic"')
    file = write(tmp_path, scaled, sliding, car=rod, arm=rod, rod=slim)
    if rotor == 1e-9:
        assert robots.load_model(file).nv == 3
    else:
        with model_error("next2 can move without moving mass"):
            robots.load_model(file)


# The robots of example-robot-data: which load, which need a hand, which are refused and why.


MOTOR = JointLimits(effort=5.0, velocity=5.0)
SWING = JointLimits(-np.inf, np.inf, 5.0, 5.0)
HELPED = {
    "centauro": {"limits": {"j_wheel_*": SWING}},
    "double_pendulum": {"limits": {"joint?": SWING}},
    "double_pendulum_simple": {"limits": {"*": SWING}},
    "double_pendulum_continuous": {"limits": {"*": MOTOR}},
    "iris": {"limits": {"*": MOTOR}},
    "quadruped": {"limits": {"*": JointLimits(-3, 3)}},
    "tiago_dual": {"limits": {"caster*": MOTOR}, "inertias": "positive"},
}
HELPED |= {
    name: {"inertias": "positive"}
    for name in (
        "allegro_left_hand",
        "allegro_right_hand",
        "anymal-kinova",
        "anymal_b_simple_description/anymal",
        "anymal_c_simple_description/anymal",
        "b1-z1",
        "b1_description/b1",
        "bolt",
        "go1",
        "hyq_no_sensors",
        "pr2",
        "romeo_small",
        "tiago",
        "tiago_no_hand",
    )
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


FILES = {file: file.stem for file in sorted(loading._robot_data_root().glob("*/*/*.urdf"))}
OTHERS = {robots.find_robot(name)[0]: name for name in (*HELPED, *REFUSED)}
SOUND = [name for file, name in FILES.items() if file not in OTHERS]
"""They load as they are, and are found by their names."""


def test_every_robot_of_the_data_package_has_a_verdict():
    found = {robots.find_robot(name)[0] for name in SOUND}
    assert len(OTHERS) == len(HELPED) + len(REFUSED) and found | {*OTHERS} == {*FILES}


def test_the_page_on_robots_has_these_verdicts():
    page = (ROOT / "docs/robots.md").read_text()
    stated = re.search(
        r"Of its (\d+) files (\d+) load unchanged.*?(\d+) need.*?(\d+) are", page, re.S
    )
    counts = [len(group) for group in (SOUND, HELPED, REFUSED)]
    assert [int(n) for n in stated.groups()] == [sum(counts), *counts]
    table = page.split("| robots | what is wrong")[1]
    for name in (*HELPED, *REFUSED):
        assert f"`{name.rpartition('/')[2]}`" in table, name


@parametrize("name", SOUND)
def test_sound_robot_loads_and_both_readers_agree(name):
    file, package_dir = robots.find_robot(name)
    model = robots.load_model(file, package_dirs=[package_dir])
    assert model.nq == model.nv
    if model.nv < 20:
        assert urdf_difference(file, package_dirs=[package_dir]) < 1e-12


@parametrize("name", HELPED)
def test_robot_with_defects_is_refused_and_usable_with_a_decision(name):
    file = robots.find_robot(name)[0]
    options = HELPED[name]
    with raises(osc.ModelError) as caught:
        robots.load_model(file)
    assert caught.value.findings[0].check == ("limit" if "limits" in options else "inertia")
    assert {finding.file for finding in caught.value.findings} == {file}
    assert robots.load_model(file, **options).nv > 0


@parametrize("name", REFUSED)
def test_defect_robot_is_refused_with_its_reason(name):
    with model_error(REFUSED[name].replace(".", r"\.")):
        robots.load_model(robots.find_robot(name)[0], inertias="positive")
    if name == "romeo_description/romeo":
        with model_error("mass matrix is not positive definite"):
            robots.load_model(robots.find_robot(name)[0], limits={"*": MOTOR})


@parametrize("name", ["panda", "ur5", "xarm", "solo12", "talos_left_arm", "scara_left"])
def test_the_model_is_the_one_pinocchio_reads_from_the_file(name):
    """Nothing is lost on the way through our own text: bodies, joints, frames, limits."""
    file = robots.urdf_path(name) if "scara" in name else robots.find_robot(name)[0]
    ours = robots.load_model(file)
    theirs = pin.buildModelFromUrdf(str(file))
    assert ours == theirs and ours.name == theirs.name
    assert [(f.name, f.type) for f in ours.frames] == [(f.name, f.type) for f in theirs.frames]


# Continuous joints ------------------------------------------------------------------------------


@parametrize("seed", range(5))
@parametrize("name", ["kinova", "double_pendulum_continuous", "tiago_pro"])
def test_continuous_joint_is_a_revolute_joint_without_end_stops(name, seed):
    """Against Pinocchio's own (cos, sin) model at the same posture, velocity and acceleration."""
    file = robots.find_robot(name)[0]
    ours = robots.load_model(file, **HELPED.get(name, {}))
    theirs = pin.buildModelFromUrdf(str(file))
    assert theirs.nq > theirs.nv == ours.nv == ours.nq
    rng = np.random.default_rng(seed)
    q = rng.uniform(-9, 9, ours.nq)
    v, a = rng.standard_normal((2, ours.nv))
    endless = [joint.nq == 2 for joint in list(theirs.joints)[1:]]
    x = []
    for angle, turns in aligned(q, endless):
        x += [np.cos(angle), np.sin(angle)] if turns else [angle]
    for limit in (ours.lowerPositionLimit, ours.upperPositionLimit):
        assert np.isinf(limit).tolist() == endless
    found = []
    for model, at in ((ours, q), (theirs, np.array(x))):
        data = model.createData()
        tau = pin.rnea(model, data, at, v, a)
        pin.framesForwardKinematics(model, data, at)
        found.append(np.concatenate((tau, *(X.homogeneous.ravel() for X in data.oMf))))
    assert_near(*found, atol=1e-10)


def test_ready_models_are_judged_too():
    wrapped = pin.buildModelFromUrdf(str(robots.find_robot("kinova")[0]))
    with model_error(r"j2s6s200_joint_1.*nq = 2 but nv = 1; load the URDF by its path"):
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


@parametrize("texture", ["/etc/hostname", "file:///etc/hostname", "../../secret.png"])
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
