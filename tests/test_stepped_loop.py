"""Loops that others own: a controller stepped from outside, an arm in somebody's simulation."""

import logging

import mujoco
import numpy as np
import pinocchio as pin
from complaints import invalid_input, plant_error
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, raises
from samples import parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.lab.runs.run import start

TICKS = 40
RIGID = ("two_contact_rod", "plant.type=rigid", "plant.step=1 ms")
ACTUATORS = {
    "servos": '<position joint="shoulder" kp="90"/><position joint="elbow" kp="90"/>',
    "geared": '<motor joint="shoulder" gear="-5"/><motor joint="elbow" gear="10"/>',
}


def simulation(actuators="servos", sensors=True, step=0.0005, extra=""):
    """Model and data of a planar arm of two joints, with a finger, above a table."""
    both = '<force site="wrist"/><torque site="wrist"/>' if sensors else ""
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{step}" cone="elliptic"/>
  <default><joint axis="0 1 0" damping="0.4" armature="0.1"/></default>
  <worldbody>
    <geom name="table" type="box" size="0.3 0.3 0.02" pos="0.5 0 0.08" priority="1"
          solref="0.01 1" solimp="0.2 0.9 0.0005" friction="0.1"/>
    <body pos="0 0 0.4">
      <joint name="shoulder"/>
      <geom type="capsule" fromto="0.05 0 0 0.35 0 0" size="0.02" mass="2" {extra}/>
      <body pos="0.4 0 0">
        <joint name="elbow"/>
        <geom type="capsule" fromto="0.05 0 0 0.2 0 0" size="0.02" mass="1"/>
        <body name="hand" pos="0.3 0 0">
          <site name="wrist" pos="0.01 0 0.02" euler="0.3 0.1 0"/>
          <geom size="0.01" pos="0.05 0 0" mass="0.3"/>
          <site name="tip" pos="0.05 0 0" euler="0 0.4 0"/>
          <body pos="0 0.02 0">
            <joint name="finger" type="slide"/>
            <geom size="0.005" mass="0.02" contype="0" conaffinity="0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>{ACTUATORS[actuators]}<position joint="finger" kp="200"/></actuator>
  <sensor>{both}</sensor>
</mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[:] = [0.0, 0.927, 0.01]
    data.ctrl[2] = 0.01
    mujoco.mj_forward(model, data)
    return model, data


def arm_of(*given, **options):
    model, data = simulation(*given)
    return osc.MujocoArm(model, data, **{"tip": "tip", "wrist_sensor": "wrist", **options})


def loop_of(arm, force=6.0, dt=1e-3, top=0.1, **options):
    """A stepped loop that presses the arm's tip on the table, and its goals."""
    q = arm.measure().q
    X = arm.chain.state(q).X_WO
    place = [X.translation[0], 0.0, top]
    table = osc.VertexOnFace([0, 0, 0], point=place, normal=[0, 0, 1], radius=0.01, name="table")
    controller = osc.Controller(arm.chain, [table], dt=dt, posture=q, life=osc.PhaseSettings())
    goals = osc.GoalFollower([table], X, dt=dt)
    goals.aim(forces={"table": force})
    return osc.SteppedLoop(controller, **options), goals


def table_force(arm):
    """Sum of normal forces on the table (N)."""
    wrench, total = np.zeros(6), 0.0
    for k in range(arm.data.ncon):
        mujoco.mj_contactForce(arm.model, arm.data, k, wrench)
        total += wrench[0]
    return total


# --- the stepped loop ---------------------------------------------------------------------------


class Robot:
    """A robot's readings and torques, noted."""

    def __init__(self, plant):
        self.plant = plant
        self.sent = []

    def measure(self):
        return self.plant.measure()

    def command(self, tau, duration):
        self.sent.append(tau.copy())
        self.plant.command(tau, duration)

    def stop(self, reason=""):
        pass


@fixture
def rod():
    """A rig, its plant and its controller, of the paper's task on the rigid plant."""
    rig = rig_of(*RIGID)
    return (rig, *start(rig))


def test_torques_and_recording_are_those_of_run_loop(rod):
    rig, plant, controller = rod
    robot = Robot(plant)
    references = list(rig.references.each(TICKS, controller.dt))
    recorder = osc.Recorder(controller)
    osc.run_loop(robot, controller, references, recorder=recorder)

    plant, controller = start(rig)
    recorder_here = osc.Recorder(controller)
    with osc.SteppedLoop(controller, recorder=recorder_here) as loop:
        for expected, reference in zip(robot.sent, references, strict=True):
            tau = loop.step(plant.measure(), reference)
            assert_array_equal(tau, expected)
            plant.command(tau, controller.dt)
    there, here = recorder.recording(), recorder_here.recording()
    assert_array_equal(here["alpha_meas"], there["alpha_meas"])
    kinds = [[event["event"] for event in one.events] for one in (there, here)]
    assert kinds[0] == kinds[1] and "stop" in kinds[0]


def test_a_safe_stop_is_reported_once_with_its_reason(rod):
    rig, plant, controller = rod
    reasons = []
    loop = osc.SteppedLoop(controller, stop=reasons.append)
    reference = next(iter(rig.references.each(1, controller.dt)))
    reading = plant.measure()
    loop.step(reading, reference)
    for _ in range(200):
        loop.step(osc.Measurement(reading.q, reading.v, np.full((2, 6), np.nan)), reference)
    assert controller.state is osc.SafetyState.SAFE_STOP
    assert len(reasons) == 1 and "wrenches: element (0, 0) is nan" in reasons[0]


def test_errors_and_ends_stop_the_robot_once_with_the_reason(rod):
    _, plant, controller = rod
    reasons = []
    with raises(ZeroDivisionError), osc.SteppedLoop(controller, stop=reasons.append) as loop:
        1 / 0  # noqa: B018
    loop.end("again")
    assert reasons == ["ZeroDivisionError: division by zero"]
    with invalid_input("has ended"):
        loop.step(plant.measure(), osc.pose_reference([0, 0, 0]))


def test_a_stop_that_fails_is_logged_and_its_error_recorded(rod, caplog):
    _, _, controller = rod
    recorder = osc.Recorder(controller)

    def stop(reason):
        raise OSError("no brake")

    osc.SteppedLoop(controller, stop=stop, recorder=recorder).end("done")
    assert "failed" in caplog.text
    [event] = [one for one in recorder.recording().events if one["event"] == "stop"]
    assert "no brake" in event["failure"]


def test_a_viewer_that_fails_is_dropped(rod, caplog):
    rig, plant, controller = rod

    class Viewer:
        shown = 0

        def show(self, tick):
            self.shown += 1
            raise ValueError("no screen")

    viewer = Viewer()
    loop = osc.SteppedLoop(controller, recorder=osc.Recorder(controller), viewer=viewer)
    for reference in rig.references.each(3, controller.dt):
        plant.command(loop.step(plant.measure(), reference), controller.dt)
    assert viewer.shown == 1 and "continues without it" in caplog.text


def test_what_cannot_be_a_loop_is_refused(rod):
    _, _, controller = rod
    with invalid_input("give the loop a recorder"):
        osc.SteppedLoop(controller, viewer=object())
    with invalid_input("no tick and no dt"):
        osc.SteppedLoop("controller")


def test_the_first_step_refuses_a_model_of_another_weight_or_another_scene():
    arm = arm_of()
    payload = osc.RigidObject(pin.Inertia(3.0, np.zeros(3), 0.01 * np.eye(3)))
    heavier = osc.MujocoArm(arm.model, arm.data, tip="tip", wrist_sensor="wrist", payload=payload)
    loop, goals = loop_of(heavier, scene=heavier.scene)
    with invalid_input("weighs|another load than it carries"):
        loop.step(heavier.measure(), goals.step())
    loop, goals = loop_of(arm, scene=arm.scene, top=0.13)
    with invalid_input("inside the nearest geom|before the nearest geom"):
        loop.step(arm.measure(), goals.step())
    loop, goals = loop_of(heavier, check=False)
    assert np.isfinite(loop.step(heavier.measure(), goals.step())).all()


# --- an arm in somebody's simulation ------------------------------------------------------------


@parametrize("actuators", ["servos", "geared"])
@parametrize("sensors", [True, False])
def test_an_environment_that_hides_its_steps_presses_as_commanded(actuators, sensors):
    arm = arm_of(actuators, sensors)
    loop, goals = loop_of(arm, scene=arm.scene)
    with loop, arm.driven(lambda reading: loop.step(reading, goals.step()), dt=1e-3):
        mujoco.mj_step(arm.model, arm.data, nstep=4000)
    assert loop.controller.status is osc.Status.OK, loop.controller.reason
    assert table_force(arm) == approx(6.0, abs=0.05)
    assert arm.data.qpos[2] == approx(0.01, abs=1e-3)  # the finger's servo is its own affair


def test_a_computed_wrench_is_that_of_the_sensors():
    """While the arm swings and strikes, also amid a step: MuJoCo's sensors judge."""
    sensed, bare = arm_of(), arm_of("servos", False)
    judge = mujoco.MjData(sensed.model)
    rng = np.random.default_rng(5)
    largest = 0.0
    for _ in range(400):
        tau = rng.uniform(-15, 15, 2)
        for one in (sensed, bare):
            one.apply(tau)
            mujoco.mj_step(one.model, one.data)
        assert_array_equal(sensed.measure().wrenches[0], sensed.data.sensordata)
        mujoco.mj_copyData(judge, sensed.model, sensed.data)
        mujoco.mj_forward(sensed.model, judge)
        mujoco.mj_step1(bare.model, bare.data)  # contacts are new, their forces are not
        assert_allclose(bare.measure().wrenches[0], judge.sensordata, rtol=1e-9, atol=1e-9)
        largest = max(largest, np.abs(judge.sensordata).max())
    assert largest > 20.0


def test_a_body_can_be_the_wrist_and_a_point_beside_it_the_tip():
    arm = arm_of()
    offset = pin.SE3(pin.exp3(np.array([0.0, 0.4, 0.0])), np.array([0.05, 0.0, 0.0]))
    other = osc.MujocoArm(
        arm.model, arm.data, tip="hand", tip_offset=offset, wrist_sensor="hand", name="arm"
    )
    q = arm.measure().q
    assert other.chain.state(q).X_WO.isApprox(arm.chain.state(q).X_WO, 1e-12)
    hand = arm.data.body("hand")
    weight = other.measure().wrenches[0, :3]
    assert_allclose(hand.xmat.reshape(3, 3) @ weight, [0, 0, 9.81 * 0.32], atol=1e-9)


def test_the_arm_rests_until_torques_are_applied():
    arm = arm_of()
    assert np.abs(arm.data.qacc[:2]).max() < 1e-9
    assert arm.measure().joint_torques == approx(arm.data.qfrc_applied[:2])


def test_compensation_of_gravity_is_switched_off_for_the_arm_alone():
    model, data = simulation(extra="")
    model.body_gravcomp[1:] = 1.0
    osc.MujocoArm(model, data, tip="tip", wrist_sensor="wrist")
    assert not model.body_gravcomp[1:].any()


def test_torques_are_held_over_the_control_period_and_begin_anew_after_a_reset():
    arm = arm_of()
    times = []

    def law(reading):
        times.append(arm.data.time)
        return np.zeros(2)

    with arm.driven(law, dt=2e-3):
        mujoco.mj_step(arm.model, arm.data, nstep=10)
        mujoco.mj_resetData(arm.model, arm.data)
        mujoco.mj_step(arm.model, arm.data, nstep=4)
    assert times == approx([0.0, 2e-3, 4e-3, 0.0], abs=1e-12)


def test_an_error_of_the_law_reaches_the_caller_and_other_simulations_are_left_alone():
    arm, other = arm_of(), arm_of()
    calls = []

    def law(reading):
        calls.append(1)
        raise ZeroDivisionError("law")

    with raises(ZeroDivisionError, match="law"), arm.driven(law, dt=1e-3):
        mujoco.mj_step(other.model, other.data, nstep=10)
        assert not calls
        mujoco.mj_step(arm.model, arm.data, nstep=10)
    assert len(calls) == 1
    assert mujoco.get_mjcb_control() is None


def test_blocks_and_periods_that_cannot_be_are_refused():
    arm = arm_of()
    with plant_error("no whole number"), arm.driven(lambda reading: np.zeros(2), dt=0.0007):
        pass
    first, second = (arm.driven(lambda reading: np.zeros(2), dt=1e-3) for _ in range(2))
    with first, invalid_input("in use"), second:
        pass
    with invalid_input("tau"):
        arm.apply([np.nan, 0.0])
    with plant_error("no body or site for wrist_sensor 'wirst'; did you mean 'wrist'"):
        arm_of(wrist_sensor="wirst")
    with plant_error("no body or site for tip 'tap'"):
        arm_of(tip="tap")


# --- goals --------------------------------------------------------------------------------------


def test_references_keep_their_limits_however_goals_jump():
    table = osc.FaceOnFace(
        [0, 0, 0], [0, 0, -1], face_point=[0, 0, 0], face_normal=[0, 0, 1], size=0.02, name="table"
    )
    linear = osc.JerkLimits(velocity=0.2, acceleration=1.5, jerk=30.0)
    force = osc.JerkLimits(velocity=100.0, acceleration=2e3, jerk=1e5)
    rng = np.random.default_rng(3)
    goals = osc.GoalFollower([table], pin.SE3.Identity(), 1e-3, linear=linear, force=force)
    places, forces = [], []
    for k in range(2000):
        if k % 50 == 0:
            goals.aim(
                pin.SE3(pin.exp3(rng.uniform(-0.3, 0.3, 3)), rng.uniform(-0.1, 0.1, 3)),
                {"table": rng.uniform(0, 30)},
            )
        reference = goals.step()
        places.append(reference.X_WD.translation)
        forces.append(reference.alpha_d)
    for values, limits in ((places, linear), (forces, force)):
        rate = np.diff(values, axis=0) / 1e-3
        assert np.abs(rate).max() < 1.001 * limits.velocity
        assert np.abs(np.diff(rate, axis=0) / 1e-3).max() < 1.01 * limits.acceleration
    for _ in range(2000):
        reference = goals.step()
    assert np.ptp(reference.alpha_d) < 1e-9 and len(reference.alpha_d) == 3
    goals.reset(pin.SE3.Identity())
    assert goals.step().X_WD.isApprox(pin.SE3.Identity()) and not goals.step().alpha_d.any()


def test_goals_of_unknown_contacts_and_no_poses_are_refused_and_the_former_stay():
    table = osc.VertexOnFace([0, 0, 0], point=[0, 0, 0], normal=[0, 0, 1], name="table")
    goals = osc.GoalFollower([table], pin.SE3.Identity(), 1e-3)
    with invalid_input("no contact 'tabel'; did you mean 'table'"):
        goals.aim(pin.SE3.Random(), {"tabel": 3.0})
    with invalid_input("finite pin.SE3"):
        goals.aim(pin.SE3(np.eye(3), np.full(3, np.nan)), {"table": 3.0})
    with invalid_input("finite pin.SE3"):
        goals.aim(np.eye(4))
    for _ in range(500):
        reference = goals.step()
    assert reference.X_WD.isApprox(pin.SE3.Identity()) and not reference.alpha_d.any()


def test_goals_are_approached_below_the_speed_at_which_arms_are_stopped():
    goals = osc.GoalFollower([], pin.SE3.Identity(), 1e-3)
    goals.aim(pin.SE3(np.eye(3), np.ones(3)))  # along the diagonal every axis has its limit
    fastest = max(np.linalg.norm(goals.step().V_D[:3]) for _ in range(2000))
    assert fastest < 0.9 * osc.SafetySettings().speed_ceiling


def test_a_loop_without_contacts_moves_only(caplog):
    caplog.set_level(logging.WARNING)
    goals = osc.GoalFollower([], pin.SE3.Identity(), 1e-3)
    goals.aim(pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))
    for _ in range(2000):
        reference = goals.step()
    assert reference.X_WD.translation == approx([0.1, 0, 0]) and not len(reference.alpha_d)
