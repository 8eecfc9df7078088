"""A user's own MuJoCo scene as robot and judge, held to MuJoCo's own contact forces."""

from copy import copy

import mujoco
import numpy as np
import pinocchio as pin
from complaints import plant_error
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, raises
from scenario_runs import worst_force

import osc_contact as osc

MOTORS = """<motor joint="wrist_pitch" gear="-5" ctrllimited="true" ctrlrange="-20 20"/>
<motor joint="shoulder" gear="10"/><motor joint="elbow"/>"""
SERVOS = """<position joint="elbow" kp="300"/><motor joint="shoulder"/>
<velocity joint="wrist_pitch" kv="30"/>"""
NONE = ""
SENSORS = '<force site="wrist"/> <torque site="wrist"/>'
START = [0.3, 0.9, -1.2]


def scene(actuators=MOTORS, step=0.0005, sensors=SENSORS, wall=0.5):
    """A planar arm with a finger on its tool, behind a loose ball, before a wall."""
    return mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{step}"/>
  <default><joint axis="0 1 0" damping="0.4" armature="0.1" frictionloss="0.1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1" contype="2" conaffinity="2"/>
    <geom name="wall" type="box" size="0.05 1 1" pos="{wall + 0.05} 0 0.5" priority="1"
          solref="0.01 1" solimp="0.2 0.9 0.0005" friction="0.1"/>
    <body name="ball" pos="-1 0 0.1"> <freejoint/>
      <geom size="0.1" mass="1" contype="2" conaffinity="2"/>
    </body>
    <body name="base" pos="0 0 0.3">
      <geom size="0.05"/>
      <body>
        <joint name="shoulder"/>
        <geom name="upper" type="capsule" fromto="0 0 0.1 0 0 0.38" size="0.03" mass="3"/>
        <body pos="0 0 0.4">
          <joint name="elbow"/>
          <geom name="lower" type="capsule" fromto="0.05 0 0 0.28 0 0" size="0.03" mass="2"/>
          <body pos="0.3 0 0">
            <joint name="wrist_pitch"/>
            <geom size="0.02" mass="0.5"/>
            <body name="hand" pos="0.04 0 0" euler="0 0.2 0">
              <site name="wrist" euler="0.3 0.1 0"/>
              <geom name="tool" size="0.015" pos="0.1 0 0" mass="0.3"/>
              <site name="tip" pos="0.1 0 0" euler="0 0.4 0"/>
              <body name="finger" pos="0 0.05 0">
                <joint name="grip" type="slide"/>
                <geom size="0.01" mass="0.02" contype="0" conaffinity="0"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator> {actuators} <position joint="grip" kp="2000" ctrlrange="-1 1"/> </actuator>
  <sensor> {sensors} </sensor>
  <keyframe>
    <key name="ball_aside" qpos="-2 0 0.1 1 0 0 0 0 0 0 0.03" ctrl="{"0 " * 3 * bool(actuators)}0.03"/>
  </keyframe>
</mujoco>""")  # noqa: E501


WALL = osc.VertexOnFace([0, 0, 0], [0.5, 0, 0.5], [-1, 0, 0], radius=0.015, name="wall")


def robot_of(model, **how):
    asked = {"tip": "tip", "wrist_sensor": "wrist", "contacts": [WALL], **how}
    return osc.MujocoRobot.from_model(model, **asked)


def wiping(X, amplitude=0.04, alpha=10.0):
    """References along a wall from X on, to and fro along z, as a function of time."""
    w = 3.0

    def along(t):
        along_z = 1 - np.cos(w * t), w * np.sin(w * t), w**2 * np.cos(w * t)
        p, v, a = np.outer(along_z, [0, 0, amplitude])
        return osc.pose_reference(X.translation + p, X.rotation, v, a, alpha_d=[alpha])

    return along


def pushes(robot, geoms):
    """(N) what MuJoCo says its contacts with these geoms of the robot carry, along the normal."""
    wanted = {robot.model.geom(name).id for name in geoms}
    force = np.zeros(6)
    total = 0.0
    for i, contact in enumerate(robot.data.contact):
        if wanted & {*contact.geom}:
            mujoco.mj_contactForce(robot.model, robot.data, i, force)
            total += force[0]
    return total


class Spy(osc.Recorder):
    """Also asks MuJoCo itself."""

    def __init__(self, controller, robot):
        super().__init__(controller, robot)
        self.robot = robot
        self.told = []

    def append(self, *tick):
        self.told.append(pushes(self.robot, ["tool"]))
        super().append(*tick)


@mark.parametrize("actuators", [MOTORS, SERVOS, NONE], ids=["motors", "servos", "none"])
def test_scene_is_robot_and_judge(actuators):
    robot = robot_of(scene(actuators), locked={"grip": 0.03}, keyframe="ball_aside")
    assert robot.chain.joint_names == ["arm/shoulder", "arm/elbow", "arm/wrist_pitch"]
    start = robot.touching(START)
    robot.reset(start)
    assert_allclose(robot.measure().q, start)
    controller = osc.Controller(robot.chain, [WALL], posture=start)
    X = robot.chain.state(start, np.zeros(3)).X_WO

    spy = Spy(controller, robot)
    osc.run_loop(robot, controller, map(wiping(X), np.arange(0, 2.5, 1e-3)), recorder=spy)
    recording = spy.recording()
    assert_allclose(recording["alpha_true"][:, 0], spy.told, atol=1e-9)
    verdict = osc.metrics(recording)
    assert worst_force(verdict) < 5e-3 and verdict["motion"]["rms_error_m"] < 1e-4
    assert verdict["contact_fraction"]["wall"] == 1.0
    assert verdict["task"]["word"] == "OK" and verdict["scenario"] is None
    assert np.ptp(recording["pose"][:, 2]) > 0.07  # it went there
    site = robot.data.site("tip")
    assert_allclose(robot.poses()[1, :3, 3], site.xpos, atol=1e-12)
    assert_allclose(robot.poses()[1, :3, :3].ravel(), site.xmat, atol=1e-12)
    assert robot.data.joint("grip").qpos[0] == approx(0.03, abs=1e-3)
    assert robot.data.body("ball").xpos[0] == approx(-2.0, abs=1e-3)


def test_wrench_is_what_the_hand_weighs():
    robot = robot_of(scene(wall=2.0), locked={"grip": 0.0})
    robot.reset(START)
    model = robot.chain.arms[0].model
    robot.hold(pin.computeGeneralizedGravity(model, model.createData(), np.array(START)))
    site = robot.data.site("wrist").xmat.reshape(3, 3)
    f = site @ robot.measure().wrenches[0][:3]  # the parent pushes the hand up
    assert f == approx([0, 0, 9.81 * 0.32], abs=1e-3)


def test_only_the_tool_touches():
    robot = robot_of(scene(wall=0.25))  # the elbow is through it
    robot.reset([0.6, 0.5, 0.0])
    assert pushes(robot, ["upper", "lower"]) > 1.0
    truth = robot.truth()
    assert pushes(robot, ["tool"]) == 0.0 and truth.alpha[0] == 0.0 and not truth.closed[0]


@mark.parametrize("friction, told", [(0.1, False), (0.6, True)])
def test_much_friction_is_told(caplog, friction, told):
    model = scene()
    model.geom("wall").friction[0] = friction
    robot_of(model)
    assert ("friction of tool and scene has a coefficient of 0.6" in caplog.text) == told


def test_the_model_given_stays_as_it_is():
    model = scene(SERVOS)
    before = copy(model)
    robot = robot_of(model)
    assert_array_equal(model.actuator_gainprm, before.actuator_gainprm)
    assert_array_equal(model.actuator_biasprm, before.actuator_biasprm)
    assert model.opt.cone == before.opt.cone != robot.model.opt.cone


@mark.parametrize(
    "how, told",
    [
        ({"tip": "tipp"}, "no body or site 'tipp'. Did you mean tip"),
        ({"wrist_sensor": "wirst"}, "no site 'wirst'. Did you mean wrist"),
        ({"keyframe": "ball_asid"}, "no keyframe 'ball_asid'. Did you mean ball_aside"),
        ({"locked": {"elbo": 0.0}}, "no moving joint called 'elbo'"),
    ],
)
def test_names_that_are_not_there(how, told):
    with raises(osc.OscContactError, match=told):
        robot_of(scene(), **how)


def test_a_site_without_sensors_is_told_with_the_line_to_add():
    with plant_error(r'no torque sensor; .*<torque site="wrist"/>'):
        robot_of(scene(sensors='<force site="wrist"/>'))


def test_a_step_that_does_not_fit_the_control_period_is_refused():
    robot = robot_of(scene(step=0.002))
    with plant_error(r"1 ms is no whole number .* steps of 2 ms"):
        robot.command(np.zeros(3), 1e-3)
    assert robot.time == 0.0
