"""`check_robot` accepts drivers that keep the contract, and reports the errors of others."""

import mujoco
import numpy as np
import pinocchio as pin
from complaints import invalid_input, plant_error
from rigs import largest, shift, vector
from samples import parametrize

import osc_contact as osc
from osc_contact.loop.commissioning import Commissioning
from osc_contact.testing import check_robot

SCENE = """
<mujoco>
  <option timestep="0.0005" cone="elliptic"/>
  <default>
    <joint armature="0.05" damping="0.5" frictionloss="0.3" range="-170 170"/>
    <geom contype="0" conaffinity="0" size="0.03"/>
    <motor ctrllimited="true" ctrlrange="-80 80"/>
  </default>
  <worldbody>
    <body pos="0 0 0.3">
      <joint name="base" axis="0 0 1"/> <geom type="capsule" fromto="0 0 0 0 0 0.2" mass="3"/>
      <body pos="0 0 0.2">
        <joint name="shoulder" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" mass="3"/>
        <body pos="0.4 0 0">
          <joint name="elbow" axis="0 1 0"/> <geom type="capsule" fromto="0 0 0 0.3 0 0" mass="2"/>
          <body pos="0.3 0 0">
            <site name="sensor"/> <site name="tip" pos="0.1 0 0"/>
            <geom size="0.02" pos="0.05 0 0.01" mass="1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator> <motor joint="base"/> <motor joint="shoulder"/> <motor joint="elbow"/> </actuator>
  <sensor> <force site="sensor"/> <torque site="sensor"/> </sensor>
</mujoco>"""
HOME = vector(0.2, -0.6, 1.1)


class Driver:
    """A driver with one thing wrong."""

    def __init__(self, fault=""):
        model = mujoco.MjModel.from_xml_string(SCENE)
        self.plant = osc.MujocoRobot.from_model(model, tip="tip", wrist_sensor="sensor")
        self.plant.reset(HOME)
        self.chain = self.plant.chain
        self.fault = fault
        self.stops = []
        self.ticks = 0
        weight = self.plant._tau.copy()
        self.added = {"twice the weight": weight, "no weight": -weight}.get(fault, 0.0)

    def measure(self):
        m = self.plant.measure()
        self.ticks += 1
        q = m.q
        v = m.v
        w = m.wrenches
        number = encoders = self.ticks
        match self.fault:
            case "swapped 1 2":
                q, v = np.array((q, v))[:, [1, 0, 2]]
            case "swapped 2 3":
                q, v = np.array((q, v))[:, [0, 2, 1]]
            case "degrees":
                q, v = np.rad2deg((q, v))
            case "speeds in degrees":
                v = np.rad2deg(v)
            case "mirrored wrench":
                w = -w
            case "mirrored joint":
                v = v * [1, 1, -1]
                q = (q - HOME) * [1, 1, -1] + HOME
            case "no gravity":
                state = self.chain.state(q)
                force = shift(state.X_WO.translation).act(pin.Force(state.bias_out))
                w = w - state.sensors[0].actInv(force).vector
            case "wrench of another frame":
                w = w[:, [1, 0, 2, 4, 3, 5]]
            case "stale sequence":
                number = min(number, 10)
            case "stale stamps":
                encoders = 1
        stamps = osc.Stamps(encoders=1e-3 * encoders, wrists=1e-3 * self.ticks)
        if self.fault == "one number" and self.ticks > 1:
            stamps = 0.25
        if self.fault == "text for a number" and self.ticks > 1:
            number = "packet 7"
        return osc.Measurement(q, v, w, sequence=number, stamps=stamps)

    def command(self, tau, duration):
        if self.fault != "blocked":
            self.plant.command(tau + self.added, duration)

    def stop(self, reason=""):
        self.stops.append(reason)


def test_drivers_that_keep_the_contract_pass():
    robot = Driver()
    assert check_robot(robot) == []
    assert robot.stops == ["the check has ended", ""]
    assert check_robot(Driver().plant) == [], "readings without stamps, too"
    assert largest(robot.plant.measure().q - HOME) < 0.03, "it is back where it was"


def test_a_robot_without_a_model_or_with_a_joint_without_motor_is_refused_with_a_cure():
    robot = Driver()
    chain = robot.chain
    del robot.chain
    with invalid_input(r"Driver has no attribute `chain`.*check_robot\(robot, osc.ClosedChain"):
        check_robot(robot)
    assert check_robot(robot, chain) == []
    model = mujoco.MjModel.from_xml_string(SCENE)
    how = {"tip": "tip", "wrist_sensor": "sensor", "passive_joints": ["elbow"], "name": "arm"}
    loose = osc.ClosedChain([osc.Arm.from_mjcf(model, **how)])
    with invalid_input("by its motor, and arm/elbow has none"):
        check_robot(robot, loose)


@parametrize(
    "fault, sentence",
    {
        "mirrored wrench": "the sign is reversed: give the wrench that the arm exerts",
        "no gravity": "without gravity, and Measurement.wrenches includes it: add the weight",
        "wrench of another frame": "the sign or the axes of the frame are others",
        "no weight": "their weight seems to be missing: the robot does not add it",
        "twice the weight": "their weight seems to come twice: the robot adds it",
        "swapped 2 3": "joints 'arm/shoulder' and 'arm/elbow' seem to be swapped",
        "swapped 1 2": "'arm/base' and 'arm/shoulder' seem to be swapped",
        "degrees": r"outside its limits \[-2.967, 2.967\].*look like degrees",
        "speeds in degrees": "in degrees|the unit of one",
        "mirrored joint": "reversed",
        "blocked": r"joint 'arm/base' does not move with .* brakes engaged",
        "stale stamps": r"stamps \(Stamps\(encoders=0.001, .* do not advance",
        "stale sequence": r"sequence \(10\) do not advance",
        "one number": r"stamps is 0.25; give osc.Stamps\(encoders=t, wrists=t\)",
        "text for a number": "sequence is 'packet 7'; give the number of the packet",
    },
)
def test_what_is_wrong_is_reported(fault, sentence):
    robot = Driver(fault)
    with plant_error(sentence):
        check_robot(robot)
    assert robot.stops, "it was stopped all the same"


@parametrize(
    "fault, sentence",
    {
        "no weight": "leaves its place though it is braked",
        "mirrored wrench": "the sign or the axes of the frame are others",
    },
)
def test_commissioning_of_any_robot_ends_where_a_step_fails(tmp_path, fault, sentence):
    """It is stopped before each question, held in between, and pushed at the tool in the second."""
    robot = Driver(fault)
    robot.added = 3.0 * robot.added
    asked = []

    def confirm(step):
        asked.append((step.split(":")[0], len(robot.stops)))
        body = robot.plant.model.site("tip").bodyid[0]
        robot.push = body if asked[-1][0] == "wrench" else None
        return True

    measure = robot.measure

    def pushed():
        if len(asked) == 2 and robot.ticks > 950:
            robot.plant.data.xfrc_applied[robot.push, 1] = 8.0
        return measure()

    robot.measure = pushed
    course = Commissioning(robot, tmp_path, 0.03, confirm, realtime=False)
    assert not course.run()
    report = (tmp_path / "report.md").read_text()
    assert "failed" in report and sentence in report, report
    assert [stops for _, stops in asked] == list(range(1, len(asked) + 1))
    assert robot.stops[-1] == ""
