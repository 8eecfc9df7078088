"""Torques that test the encoders of stopped joints whose readings do not change."""

from math import pi

import numpy as np
from law_calls import probing, records, sensors, write
from pytest import approx
from rigs import vector
from samples import parametrize

from osc_contact.law import records as at

DT = 1e-3
MASS = 2.0  #: kg, of the joint
BEYOND = 0.5  #: kg of it beyond the wrist
STEP = 2.0 * pi / 2**17  #: m, of the encoder
WORLD = np.zeros(3)


class Stopped:
    """A joint that slides along z, with a wrist, held by a stop.

    Attributes:
        t: tick.
        joint: its MEMORY.
        z, v: true position and speed (m, m/s).
        largest: largest torque so far (N).
    """

    def __init__(self, friction=0.5, **settings):
        """Rest for long before the stop.

        Args:
            friction: what the joint has shown of its friction in motion (N).
            **settings: fields of MEMORY.
        """
        self.t = records(arms=1, joints=1, period=DT)
        arm = self.t.model.arms[0]
        write(arm, first=0, end=1, sensor_joint=0, sensor=np.eye(3).ravel())
        write(self.t.model.joints, motor=0, tau_max=100.0, slides=1)
        work = self.t.work.joints[0]
        write(work, R=np.eye(3), column=[0.0, 0.0, 1.0], outboard=[0.0, 0.0, BEYOND])
        write(work, M=[MASS])
        write(self.t.memory, state=at.SAFE_STOP, derived=at.ESTIMATED, **settings)
        self.joint = self.t.memory.joints[0]
        write(self.joint, rested=1.0, rubbed=friction, slid=1.0)
        self.z = self.v = self.largest = 0.0

    def tick(self, move, encoder):
        """Let the joint move for a tick, read it, and add the torque of the test.

        Args:
            move: function of the torque (N) that returns the acceleration (m/s²) and the change of
                the wrist's reading (N).
            encoder: function of the true position that returns the reading (m).
        """
        memory = self.t.memory
        memory.age += 1
        work = self.t.work.joints[0]
        work.tau = work.rest = 0.0
        before = encoder(self.z)
        probing.probe_joints(self.t, self.t.model.arms[0], 0, WORLD)
        self.largest = max(self.largest, abs(work.tau))
        rate, reading = move(work.tau)
        self.v += rate * DT
        self.z += self.v * DT
        memory.wrenches[0, 2] = 7.0 + 30.0 * memory.age * DT + reading
        changed = encoder(self.z) != before
        self.joint.rested = 0.0 if changed else self.joint.rested + DT

    def run(self, move, encoder=lambda z: 0.0, seconds=0.4):
        """Run for some time, and return whether the encoder is called dead."""
        for _ in range(round(seconds / DT)):
            self.tick(move, encoder)
        return self.joint.faulty == at.FAULTY_POSITION | at.FAULTY_SPEED


def free(torque):
    """Nothing but its inertia holds the joint; the wrist measures its outer share."""
    return (torque / MASS, BEYOND / MASS * torque)


def blocked(torque):
    """A contact beyond the wrist bears the torque."""
    return (0.0, torque)


def braked(torque):
    """Bears the torque before the wrist."""
    return (0.0, 0.0)


def counted(z):
    return round(z / STEP) * STEP


def test_an_encoder_that_reads_the_same_while_its_joint_moves_is_dead():
    """Though the wrist's load drifts by 30 N/s. The torque is at most 1.3 times friction."""
    stopped = Stopped()
    assert stopped.run(free)
    assert stopped.joint.probed == -1.0
    swing = MASS * 1.2e-4 * (2.0 * pi / 0.08) ** 2
    assert stopped.largest == approx(1.3 * (2.0 * 0.5 + 0.002 * 100.0) + swing, rel=0.01)


@parametrize("move, encoder", [(free, counted), (blocked, lambda z: 0.0), (braked, lambda z: 0.0)])
def test_an_encoder_is_not_dead(move, encoder):
    """It changes, or a contact or a brake holds its joint."""
    stopped = Stopped()
    assert not stopped.run(move, encoder)
    assert stopped.joint.faulty == 0 and stopped.joint.probed == -1.0


def test_a_test_ends_with_the_first_change_of_the_reading():
    """A joint without friction is moved by a step of its encoder, not more."""
    stopped = Stopped(friction=0.0)
    stopped.run(free, counted)
    assert abs(stopped.z) < 0.2, "nothing brakes it here"
    last = stopped.largest
    stopped.joint.rested = 1.0
    stopped.run(free)
    assert stopped.largest == last


@parametrize(
    "how",
    ["it has moved before the stop", "speeds are read", "no stop", "no motor", "no wrist", "weak"],
)
def test_a_joint_is_not_tested(how):
    stopped = Stopped()
    t = stopped.t
    if how == "it has moved before the stop":
        stopped.joint.rested = 0.01
    elif how == "speeds are read":
        t.memory.derived = 0
    elif how == "no stop":
        t.memory.state = at.HOLD
    elif how == "no motor":
        t.model.joints.motor[0] = -1
    elif how == "no wrist":
        t.model.arms.sensor_joint[0] = -1
    else:
        t.model.joints.tau_max[0] = 0.1
    assert not stopped.run(free)
    assert stopped.largest < 0.1


@parametrize("rested, followed, tested", [(1.0, 4, True), (0.1, 4, False), (1.0, 3, False)])
def test_an_encoder_that_no_longer_follows_its_hold_is_tested_again(rested, followed, tested):
    """The estimate of its position changes by rounding, as that of a joint that friction holds."""
    stopped = Stopped()
    t = stopped.t
    write(t.model, hold_rate=20.0)
    write(stopped.joint, probed=-1.0, rested=rested, followed=followed, changes=1)
    t.memory.tested = 0.15
    sensors._test_encoders(t, DT)
    assert stopped.joint.faulty == 0
    assert stopped.run(free) == tested


def test_the_wrists_of_lost_ticks_do_not_count():
    stopped = Stopped(wrench_age=1)
    assert not stopped.run(free)
    assert vector(stopped.joint.echo, stopped.joint.push).tolist() == [0.0, 0.0]
