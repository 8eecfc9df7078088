"""Arms from MJCF, held to MuJoCo's own numbers and to Pinocchio's reader."""

import mujoco
import numpy as np
import pinocchio as pin
from complaints import invalid_input, model_error
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, mark
from robot_numbers import mass_matrix

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


@fixture
def mj():
    return mujoco.MjModel.from_xml_string(ARM)


def at(mj, q, v):
    """MuJoCo's data with the arm's joints at q, v, and their numbers in qvel."""
    data = mujoco.MjData(mj)
    data.qpos[[int(mj.joint(name).qposadr[0]) for name in JOINTS]] = q
    dofs = [int(mj.joint(name).dofadr[0]) for name in JOINTS]
    data.qvel[dofs] = v
    mujoco.mj_forward(mj, data)
    return data, dofs


def test_mass_matrix_forces_and_frames_are_mujocos(mj):
    model = robots.load_mjcf(mj, "tip")
    rng = np.random.default_rng(0)
    data = model.createData()
    assert list(model.names)[1:] == JOINTS
    for _ in range(5):
        q = rng.uniform(-1, 1, 4)
        v = rng.normal(size=4)
        truth, dofs = at(mj, q, v)
        pin.computeAllTerms(model, data, q, v)
        pin.updateFramePlacements(model, data)
        assert_allclose(data.M, mass_matrix(mj, truth)[np.ix_(dofs, dofs)], atol=1e-12)
        assert_allclose(data.nle, truth.qfrc_bias[dofs], atol=1e-12)
        for name in ("wrist", "tip"):
            X = data.oMf[model.getFrameId(name)]
            assert_allclose(X.translation, truth.site(name).xpos, atol=1e-12)
            assert_allclose(X.rotation.ravel(), truth.site(name).xmat, atol=1e-12)
        hand = data.oMf[robots.frame_id(model, "hand")]
        assert_allclose(hand.translation, truth.body("hand").xpos, atol=1e-12)


def test_joints_have_the_files_numbers(mj):
    model = robots.load_mjcf(mj, "tip")
    assert_array_equal(model.armature, [0.1, 2.0, 0.1, 0.1])
    assert_array_equal(model.damping, 0.5)
    assert_array_equal(model.upperDryFrictionLimit, 0.2)
    assert_allclose(model.upperEffortLimit[:3], [100.0, 80.0, 30.0])
    assert model.upperEffortLimit[3] > 1e12  # nobody names one
    assert (model.lowerPositionLimit[0], model.upperPositionLimit[1]) == (-2.0, np.inf)


def test_an_arm_has_its_rotors_and_a_link_may_be_called_as_its_joint(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    arm = osc.Arm.from_mjcf(file, name="a", tip="tip", wrist_sensor="wrist")
    chain = osc.ClosedChain([arm])
    assert chain.joint_names == ["a/turn", "a/slide", "a/bend"]  # the finger is locked
    assert_array_equal(chain.model.armature, [0.1, 2.0, 0.1])
    own = chain.outboard[0][0].inertia
    assert own.mass == approx(0.45)  # hand and finger, what MuJoCo's sensor there weighs
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
        chain = osc.ClosedChain([arm])
        assert chain.nq == 5 - len(locked)
    arm = osc.Arm.from_urdf(file, name="a", tip="joint2")
    assert osc.ClosedChain([arm]).nq == 2


@mark.parametrize(
    "old, new, says",
    [
        ('armature="2"', 'armature="2" stiffness="5"', "spring"),
        ('<body name="hand"', '<body name="hand" gravcomp="1"', "gravcomp"),
        ('<geom size="0.03" mass="0.4"/>', '<joint type="ball"/><geom size="0.03"/>', "ball joint"),
        ("<worldbody>", "<worldbody><nonsense/>", "MuJoCo refuses"),
    ],
)
def test_what_the_law_does_not_know_is_refused(tmp_path, old, new, says):
    assert ARM.count(old) == 1
    (tmp_path / "arm.xml").write_text(ARM.replace(old, new))
    with model_error(says):
        osc.Arm.from_mjcf(tmp_path / "arm.xml", name="a", tip="tip")


def test_names_that_are_not_there_are_told(mj):
    with model_error("no body or site 'tipp'"):
        osc.Arm.from_mjcf(mj, name="a", tip="tipp")
    with invalid_input("no moving joint matches"):
        robots.load_mjcf(mj, "tip", limits={"nobody": robots.JointLimits(effort=1.0)})
