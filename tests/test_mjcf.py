"""Arms from MJCF, held to MuJoCo's own numbers and to Pinocchio's reader; in scenarios, too."""

import mujoco
import numpy as np
from command_line import call, done
from complaints import invalid_input, model_error
from numpy.testing import assert_array_equal
from pytest import approx, fixture
from rigs import assert_near, largest, terms_at
from robot_numbers import mass_matrix
from samples import parametrize
from scenario_runs import rig_of, verdict_of
from second_reader import mjcf_difference

import osc_contact as osc
from osc_contact import robots

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <default><joint damping="0.5" armature="0.1" frictionloss="0.2"/></default>
  <worldbody>
    <body name="loose" pos="2 0 0"><freejoint/><geom size="0.1" mass="1"/></body>
    <body name="base" pos="0.1 0.2 0.3" euler="0.1 0.2 0.3">
      <geom size="0.1" mass="2"/>
      <body name="turn" pos="0 0 0.1">
        <joint name="turn" axis="0 0.6 0.8" range="-2 2" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 0.3" size="0.04" mass="3"/>
        <body name="two" pos="0.1 0 0.3" euler="0.3 0 0.2">
          <joint name="slide" type="slide" axis="1 0 0" pos="0.1 0 0" ref="0.05" armature="2"/>
          <joint name="bend" axis="0 1 0" pos="0.02 0.01 0" ref="0.3"/>
          <geom type="box" size="0.05 0.02 0.1" pos="0.05 0 0.1" mass="1"/>
          <body name="hand" pos="0 0 0.2" euler="0 0.4 0">
            <geom size="0.03" mass="0.4"/>
            <site name="wrist" pos="0 0 -0.02"/> <site name="tip" pos="0 0 0.1" euler="0.2 0 0"/>
            <body name="finger" pos="0.05 0 0.05">
              <joint name="grip" type="slide" axis="1 0 0"/> <geom size="0.01" mass="0.05"/>
              <body name="pad" pos="0 0 0.02"><geom size="0.01" mass="0.02"/></body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="turn" gear="50" ctrllimited="true" ctrlrange="-2 2"/>
    <motor joint="slide" gear="10" forcelimited="true" forcerange="-8 8"/>
    <position joint="bend" kp="100" forcelimited="true" forcerange="-30 30"/>
  </actuator>
</mujoco>"""
JOINTS = ["turn", "slide", "bend", "grip"]
_FACES = "132 234 567 687 125 265 374 478 153 357 246 486"
CUBE = "".join(
    [f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    + [f"f {' '.join(face)}\n" for face in _FACES.split()]
)


@fixture
def mj():
    return mujoco.MjModel.from_xml_string(ARM)


def test_mass_matrix_forces_and_frames_are_mujocos(mj):
    model = robots.load_mjcf(mj, "tip")
    rng = np.random.default_rng(0)
    assert list(model.names)[1:] == JOINTS
    truth = mujoco.MjData(mj)
    places = [mj.joint(name).qposadr[0] for name in JOINTS]
    dofs = [mj.joint(name).dofadr[0] for name in JOINTS]
    for _ in range(5):
        q = rng.uniform(-1, 1, 4)
        v = rng.standard_normal(4)
        truth.qpos[places] = q
        truth.qvel[dofs] = v
        mujoco.mj_forward(mj, truth)
        data = terms_at(model, q, v)
        assert_near(data.M, mass_matrix(mj, truth)[np.ix_(dofs, dofs)], atol=1e-12)
        assert_near(data.nle, truth.qfrc_bias[dofs], atol=1e-12)
        for name in ("wrist", "tip"):
            X = data.oMf[model.getFrameId(name)]
            assert_near(X.translation, truth.site(name).xpos, atol=1e-12)
            assert_near(X.rotation.ravel(), truth.site(name).xmat, atol=1e-12)
        hand = data.oMf[robots.frame_id(model, "hand")]
        assert_near(hand.translation, truth.body("hand").xpos, atol=1e-12)


def test_joints_have_the_files_numbers(mj):
    model = robots.load_mjcf(mj, "tip")
    assert_array_equal(model.armature, [0.1, 2.0, 0.1, 0.1])
    assert_array_equal(model.damping, 0.5)
    assert_array_equal(model.upperDryFrictionLimit, 0.2)
    assert_near(model.upperEffortLimit[:3], [100.0, 80.0, 30.0])
    assert model.upperEffortLimit[3] > 1e12  # nobody names one
    assert (model.lowerPositionLimit[0], model.upperPositionLimit[1]) == (-2.0, np.inf)


def test_an_arm_has_its_rotors_and_a_link_may_be_called_as_its_joint(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    chain = osc.ClosedChain([osc.Arm.from_mjcf(file, name="a", tip="tip", wrist_sensor="wrist")])
    assert chain.joint_names == ["a/turn", "a/slide", "a/bend"]  # the finger is locked
    assert_array_equal(chain.model.armature, [0.1, 2.0, 0.1])
    own = chain.outboard[0][0].inertia
    assert own.mass == approx(0.47)  # hand, finger and pad: what MuJoCo's sensor there weighs
    named = osc.Arm.from_mjcf(file, name="a", tip="turn")
    assert osc.ClosedChain([named]).joint_names == ["a/turn"]


def test_a_urdf_whose_links_are_called_as_its_joints(tmp_path):
    text = robots.urdf_path("scara_left").read_text()
    for name, link in (("joint1", "upper_arm"), ("joint2", "forearm")):
        assert f'"{link}"' in text
        text = text.replace(f'"{link}"', f'"{name}"')
    file = tmp_path / "same.urdf"
    file.write_text(text)
    for locked in ({}, {"joint1": 0.3}):
        arm = osc.Arm.from_urdf(
            file,
            name="a",
            tip="tool",
            passive_joints=["hinge"],
            locked=locked,
            wrist_sensor="wrist_sensor",
        )
        assert osc.ClosedChain([arm]).nq == 5 - len(locked)
    arm = osc.Arm.from_urdf(file, name="a", tip="joint2")
    assert osc.ClosedChain([arm]).nq == 2


@parametrize(
    "old, new, message",
    [
        ('armature="2"', 'armature="2" stiffness="5"', "spring"),
        ('<body name="hand"', '<body name="hand" gravcomp="1"', "gravcomp"),
        ('<geom size="0.03" mass="0.4"/>', '<joint type="ball"/><geom size="0.03"/>', "ball joint"),
        ("<worldbody>", "<worldbody><nonsense/>", "MuJoCo refuses"),
    ],
)
def test_what_the_law_does_not_model_is_refused(tmp_path, old, new, message):
    assert ARM.count(old) == 1
    (tmp_path / "arm.xml").write_text(ARM.replace(old, new))
    with model_error(message):
        osc.Arm.from_mjcf(tmp_path / "arm.xml", name="a", tip="tip")


def test_names_that_are_not_there_are_reported(mj):
    with invalid_input("no moving joint matches"):
        robots.load_mjcf(mj, "tip", limits={"nobody": robots.JointLimits(effort=1.0)})


# MJCF arms in scenarios: on both plants, drawn, checked, and refused where joints are coupled.


TASK = """
name: from_mjcf
arms:
  - {name: arm, urdf: arm.xml, tip: TIP, wrist_sensor: wrist,
     posture: [0.3, -0.8, 1.2, 0.4, -0.7, 0.2]}
object: {urdf: stylus.urdf}
grasps: {arm: {}}
contacts:
  - name: ball
    type: vertex_on_face
    vertex: [0, 0, 80 mm]
    radius: 8 mm
    face: {urdf: face.urdf, point: POINT, normal: NORMAL}
force: {ball: [{type: constant, value: 5 N}]}
gains: {motion: {stiffness: 400, damping: 40}, force: {integral: 30, damping: 50}}
control: {rate: 1 kHz}
plant: {type: mujoco, step: 0.25 ms}
duration: 1.6 s
"""
SIX = """
<mujoco>
  <compiler angle="radian"/>
  <default>
    <joint armature="0.05" damping="0.3" frictionloss="0.1" limited="true" range="-3 3"/>
  </default>
  <worldbody>
    <body name="other" pos="3 0 0"><freejoint/><geom size="0.1" mass="1"/></body>
    <body name="base" pos="0 0.1 0.2">
      <geom size="0.1" mass="2"/>
      <body name="j1" pos="0 0 0.1">
        <joint name="j1" axis="0 0 1"/><geom type="cylinder" size="0.05 0.1" mass="3"/>
        <body name="j2" pos="0 0 0.1">
          <joint name="j2" axis="0 1 0" pos="0 0 0.02" ref="0.2"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04" mass="3"/>
          <body name="j3" pos="0.3 0 0">
            <joint name="j3" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.03" mass="2"/>
            <body name="j4" pos="0.25 0 0">
              <joint name="j4" axis="1 0 0"/><geom size="0.03" mass="0.6"/>
              <body name="j5">
                <joint name="j5" axis="0 1 0"/><geom size="0.03" pos="0.05 0 0" mass="0.5"/>
                <body name="hand" pos="0.08 0 0" euler="0 1.2 0">
                  <joint name="j6" axis="0 0 1"/>
                  <geom type="box" size="0.02 0.03 0.02" mass="0.3"/>
                  <site name="wrist" pos="0 0 0.01" euler="0 0 0.5"/>
                  <site name="tip" pos="0 0 0.03"/>
                  <body name="finger" pos="0 0.02 0.03">
                    <joint name="grip" type="slide" axis="0 1 0"/>
                    <geom size="0.01" mass="0.05"/>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="j1" ctrllimited="true" ctrlrange="-80 80"/></actuator>
  EQUALITY
</mujoco>"""


def arm(folder, old="", new="", equality=""):
    """The file of SIX, with a change and an equality."""
    file = folder / "arm.xml"
    file.write_text(SIX.replace("EQUALITY", equality).replace(old, new, 1))
    return file


def task(folder, tip="tip", *changes):
    """A scenario whose arm is SIX; the face lies where MuJoCo itself puts the stylus."""
    mj = mujoco.MjModel.from_xml_path(str(arm(folder)))
    data = mujoco.MjData(mj)
    for k, x in enumerate((0.3, -0.8, 1.2, 0.4, -0.7, 0.2), 1):
        data.joint(f"j{k}").qpos[:] = x
    mujoco.mj_kinematics(mj, data)
    at = data.site("tip") if tip == "tip" else data.body(tip)
    out = -at.xmat[2::3]
    text = TASK.replace("TIP", tip).replace("NORMAL", str(out.tolist()))
    file = folder / "task.yaml"
    file.write_text(text.replace("POINT", str((at.xpos - 0.088 * out).tolist())))
    return osc.load_scenario(file, changes)


@parametrize("tip", ["tip", "hand"])
def test_a_scenario_takes_an_mjcf_file(tmp_path, tip):
    scenario = task(tmp_path, tip)
    rig = rig_of(scenario)
    assert osc.preflight(rig) == ()
    assert np.linalg.norm(rig.state.X_WO.translation - rig.X_given.translation) < 1e-9
    verdict = verdict_of(scenario)
    assert verdict["task"]["word"] == "OK" and verdict["contact_fraction"] == {"ball": 1.0}
    assert verdict["force"]["ball"]["rms_error_rel"] < 0.01
    exact = osc.run(scenario.replaced(plant={"type": "rigid", "step": 1e-3}))
    assert_near(exact["alpha_true"][-1], 5.0, rtol=1e-3)


def test_both_plants_accelerate_an_arm_from_mjcf_alike(tmp_path):
    """Free fall from a posture, damping included, two joints and a finger locked."""
    scenario = task(
        tmp_path,
        "tip",
        "contacts=[]",
        "force={}",
        "arms.arm.locked_joints={grip: 4 mm, j2: -0.8, j4: 0.4}",
        "arms.arm.posture=[0.3, 1.2, -0.7, 0.2]",
        "arms.arm.friction=0 Nm",
        "plant.step=0.05 ms",
    )

    def fallen(scenario):
        rig = rig_of(scenario)
        plant = rig.plant()
        plant.command(np.zeros(4), 0.02)
        read = plant.measure()
        assert largest(read.q - rig.q_start) > 1e-3
        return read

    ours = fallen(scenario)
    theirs = fallen(scenario.replaced(plant={"type": "rigid", "step": 5e-5}))
    assert_near(ours.q, theirs.q, atol=1.5e-5)
    assert_near(ours.wrenches, theirs.wrenches, atol=0.05)


def test_check_describes_it_and_refuses_with_exit_code_1(tmp_path):
    file = arm(tmp_path)
    report = robots.check_robot(file)
    assert report.sound and mjcf_difference(file) < 1e-12
    assert report.summary.dof == 7 and report.summary.mass == approx(
        11.45
    )  # without the loose body
    assert [joint.kind for joint in report.summary.joints] == 6 * ["revolute"] + ["prismatic"]
    assert report.summary.joints[0].effort == 80.0 and np.isinf(report.summary.joints[1].effort)
    assert "sound" in done(f"check {file} --tip tip").stdout
    refused = call("check", arm(tmp_path, 'name="j3" axis', 'name="j3" stiffness="5" axis'))
    assert refused.exit_code == 1 and "spring of 5" in refused.stdout


def test_joints_that_follow_others_on_the_way_to_the_tip_are_refused(tmp_path):
    how = {"name": "a", "tip": "tip"}
    follows = '<equality><joint joint1="{}" joint2="j2"/></equality>'
    file = arm(tmp_path, equality=follows.format("j3"))
    with model_error("'j3' on the way to the tip follows joint 'j2'"):
        osc.Arm.from_mjcf(file, **how)
    assert osc.Arm.from_urdf(file, locked={"j2": 0.1, "j3": 0.1}, **how).model.nv == 4
    file = arm(tmp_path, equality=follows.format("grip"))
    assert osc.Arm.from_mjcf(file, **how).model.nv == 6


# What must not reach MuJoCo -----------------------------------------------------------------------


def test_an_mjcf_file_called_urdf_does_not_pass_by_the_checks_of_urdfs(tmp_path):
    """MuJoCo would read the mesh, which lies outside of the robot's folder."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/cube.obj").write_text(CUBE)
    folder = tmp_path / "robot"
    folder.mkdir()
    shape = '<geom type="mesh" mesh="cube" mass="0.4"/>'
    assets = '<asset><mesh name="cube" file="../elsewhere/cube.obj"/></asset><worldbody>'
    written = ARM.replace('<geom size="0.03" mass="0.4"/>', shape).replace("<worldbody>", assets)
    file = folder / "x.urdf"
    file.write_text(written)
    for load in (robots.load_robot, robots.compile_mjcf):
        with model_error(r"not called \.urdf"):
            load(file)
    with model_error(r"begins with <robot>.*not called \.urdf"):
        osc.Arm.from_urdf(file, name="a", tip="tip")
    assert call("check", file).exit_code == 1
    file.rename(folder / "x.xml")
    assert robots.load_robot(folder / "x.xml")[0].nq == 4


@parametrize("name", ["x.urdf", "x.xml"])
def test_a_file_larger_than_any_robots_is_refused_unread(tmp_path, monkeypatch, name):
    def parsed(*given):
        raise AssertionError("the file was parsed")

    file = tmp_path / name
    file.write_text("<mujoco>" + " " * 2**23 + "</mujoco>")
    monkeypatch.setattr(robots.mjcf, "iterparse", parsed)
    monkeypatch.setattr(mujoco.MjModel, "from_xml_path", parsed)
    for load in (robots.load_robot, robots.compile_mjcf):
        with model_error("larger than 8 MiB"):
            load(file)


def test_a_urdf_is_not_read_as_mjcf():
    with model_error("Arm.from_urdf reads URDFs"):
        osc.Arm.from_mjcf(robots.urdf_path("scara_left"), name="a", tip="tool")
