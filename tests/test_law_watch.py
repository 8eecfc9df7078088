"""Limits of the robot and trust in its sensors, tick by tick, on the law's own functions.

Each limit is met from just below and from just above, in either sign, and timed to the tick. What
becomes of them in closed loop: tests/test_safety.py, tests/test_lying_sensors.py.
"""

from math import inf

import numpy as np
import pinocchio as pin
from law_calls import (
    agreement,
    holding,
    isolation,
    plausibility,
    records,
    safety,
    sensors,
    write,
)
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import any_rotation, assert_near, rotated, vector
from samples import parametrize

from osc_contact.law import records as at
from osc_contact.law.phases import APPROACHING, CLOSED
from osc_contact.law.plausibility import JUMPED, NO_ROTATION, OUT_OF_RANGE, WRENCH_TIMEOUT
from osc_contact.law.reasons import NO_REASON
from osc_contact.law.safety import CONTACT_LOST, NEAR_END, OVERFORCE, OVERSPEED, POWERED
from osc_contact.law.sensors import (
    DISAGREE,
    FROZEN,
    MIXED,
    STUCK,
)
from osc_contact.law.wrist_readings import WRIST_FROZEN, WRIST_SATURATED

DT = 1e-3
BOTH = parametrize("sign", [1.0, -1.0])


def joints(count=1, **settings):
    """Joints between ∓1 rad, at most 2 rad/s, which brake with 5 rad/s²."""
    t = records(arms=1, joints=count, **{"period": DT, "fast_ticks": 99} | settings)
    write(t.model.joints, lower=-1.0, upper=1.0, brake=0.1, speed_max=2.0, rated=2.0)
    t.model.joints.motor = range(count)
    t.memory.culprit = -1
    return t


def wide(fast_ticks, speeds=(2.0, 2.0)):
    """Two joints of such speed limits, far from their ends."""
    t = joints(2, fast_ticks=fast_ticks)
    write(t.model.joints, lower=-9.0, upper=9.0, speed_max=speeds)
    return t


def look(t, q, v):
    """The reason of one tick of the joints."""
    t.input.q[:] = q
    t.input.v[:] = v
    return safety.watch_joints(t)


def assert_at_last(found, reason):
    """This reason in the last tick, none before."""
    assert found == [NO_REASON] * (len(found) - 1) + [reason]


class Watched:
    """Something whose `tick` returns a reason."""

    def until(self, *given, most=400, **how):
        """Ticks until a reason is found, and the reason."""
        for k in range(1, most):
            reason = self.tick(*given, **how)
            if reason != NO_REASON:
                return (k, reason)
        return (0, NO_REASON)


# --- joints ---------------------------------------------------------------------------------------


@BOTH
def test_a_joint_may_be_too_fast_for_so_many_ticks(sign):
    t = wide(4)

    def after(speeds):
        return [look(t, 0.0, [0.1, sign * v]) for v in speeds]

    assert set(after([2.0] * 50)) == {NO_REASON}, "at the limit is not above it"
    assert_at_last(after([2.001] * 5), OVERSPEED)
    assert t.memory.culprit == 1
    # time below is taken off at the same rate, and no more than there is
    assert set(after([1.0] * 9)) == {NO_REASON} and t.memory.overspeed == 0
    assert_at_last(after([2.2] * 4 + [1.0] + [2.2] * 2), OVERSPEED)


@BOTH
def test_time_counts_once_more_for_each_eighth_of_a_limit_that_a_joint_is_too_fast(sign):
    for speed, ticks in {1.1: 22, 1.13: 11, 1.26: 8, 1.51: 5, 3.1: 2, 9.0: 1}.items():
        for j in range(2):
            t = wide(21, (2.0, 1.0))
            v = sign * speed * t.model.joints.speed_max * (np.arange(2) == j)
            assert_at_last([look(t, 0.0, v) for _ in range(ticks)], OVERSPEED)
            assert t.memory.culprit == j
    assert look(wide(21), 0.0, [1e150, 0.0]) == OVERSPEED
    t = wide(4, (2.0, 1.0))
    assert look(t, 0.0, [2.4, 1.6]) == OVERSPEED
    assert t.memory.culprit == 1, "the one that is further beyond its limit"


@BOTH
@parametrize("reaction", [0.0, 0.1])
def test_a_joint_is_stopped_where_it_can_just_be_braked_before_its_end(sign, reaction):
    """s = |q̇| t_r + q̇²/2a with a = 5 rad/s², found by steps of 10 µs."""
    speed = 1.5
    way = 1.5 * reaction
    dt = 1e-5
    v = speed
    while v > 0.0:
        way = way + (v - 0.5 * 5.0 * dt) * dt
        v = v - 5.0 * dt
    for gap, stops in ((way + 1e-3, False), (way - 1e-3, True), (-1e-3, False)):
        t = joints(reaction=reaction)
        q = sign * (1.0 - gap)
        found = [look(t, q, sign * speed) for _ in range(4)]
        # braking does not help beyond the end
        assert found == [NO_REASON] * 2 + [NEAR_END if stops else NO_REASON] * 2
        assert t.memory.culprit == (0 if stops else -1)
        assert look(joints(reaction=reaction), q, -sign * 0.01) == NO_REASON
    t = joints(reaction=reaction)
    found = [look(t, sign, sign * 0.1) for _ in range(3)]
    assert found[-1] == NEAR_END, "it still is within its range"


@parametrize("period, ticks", {0.3e-3: 9, 1e-3: 3, 2e-3: 2, 10e-3: 2})
def test_one_wrong_sample_stops_nothing_at_any_rate(period, ticks):
    """2.5 ms of evidence, and more than one tick."""
    t = joints(period=period)
    assert_at_last([look(t, 0.99, 1.0) for _ in range(ticks)], NEAR_END)


# --- contacts -------------------------------------------------------------------------------------


class Contacts(Watched):
    """Two columns of N, which are numbers 2 and 0 of the contacts' four."""

    def __init__(self, **more):
        limits = {"contact_power": 20.0, "contact_force": 30.0, "contact_loss_time": 0.0105}
        limits |= {"overforce_time": 0.0055, "integral_force": 15.0, "regain_time": 0.0305}
        self.t = records(contacts=3, columns=4, **{"period": DT} | limits | more)
        self.memory = self.t.memory
        self.kept = self.t.memory.columns
        write(self.memory, force_rank=2, state=at.RUN, culprit=-1)
        write(self.t.work, rank=2, kept=[2, 0])

    def tick(self, alpha, commanded, speed=(0.0, 0.0)):
        write(self.t.work, alpha_meas=alpha, alpha_d=commanded, speed=speed)
        return safety.watch_contacts(self.t)

    def ticks_until(self, reason, *given):
        """The first tick that ends with a reason, which is this one; 0: none does."""
        k, found = self.until(*given, most=40)
        assert found in (NO_REASON, reason)
        return k


def test_power_that_moves_into_faces_adds_up():
    commanded = (10.0, 10.0)
    for speed, ticks in {(1.0, 0.99): 0, (1.0, 1.01): 3, (2.5, -9.0): 3, (1.9, -9.0): 0}.items():
        assert Contacts().ticks_until(POWERED, (10.0, 10.0), commanded, speed) == ticks
    assert Contacts().ticks_until(POWERED, (10.0, -0.1), (10.0, 0.0), (1.9, -900.0)) == 0
    assert Contacts(period=10e-3).ticks_until(POWERED, (10.0, 10.0), commanded, (3.0, 0.0)) == 2
    contacts = Contacts()
    contacts.tick((10.0, 10.0), commanded, (3.0, 3.0))
    assert contacts.memory.powered == approx(DT)


@parametrize("column", [0, 1])
def test_a_contact_that_phases_have_lost_must_be_held_again_in_time(column):
    for since, reason in ((0.0304, NO_REASON), (0.0306, CONTACT_LOST)):
        contacts = Contacts(phased=1)
        contacts.kept[2 * (1 - column)].time_since_loss = since  # columns 2 and 0 of the contacts'
        assert contacts.tick((0.0, 0.0), (2.0, 2.0)) == reason
        assert contacts.memory.culprit == (2 * (1 - column) if reason else -1)


@BOTH
@parametrize("column", [0, 1])
def test_a_contact_is_lost_below_a_fifth_of_its_command(sign, column):
    def both(x, other):
        return (sign * x, sign * other) if column == 0 else (sign * other, sign * x)

    commanded = both(10.0, 5.0)
    fine = 5.0
    for alpha, ticks in {2.01: 0, 1.99: 11, -8.0: 11, 0.0: 11}.items():
        contacts = Contacts()
        assert contacts.ticks_until(CONTACT_LOST, both(alpha, fine), commanded) == ticks
        assert contacts.memory.culprit == (-1 if not ticks else (2, 0)[column])
    for command, ticks in ((1.0, 0), (1.01, 11)):  # too little to differ from nothing
        assert Contacts().ticks_until(CONTACT_LOST, (0.0, 0.0), both(command, 0.0)) == ticks
    contacts = Contacts(phased=1)  # contact phases see to it
    assert contacts.ticks_until(CONTACT_LOST, both(0.0, fine), commanded) == 0
    contacts = Contacts()
    contacts.memory.state = at.DEGRADED_STATE
    assert contacts.ticks_until(CONTACT_LOST, both(0.0, fine), commanded) == 0


@BOTH
def test_a_force_integral_at_its_bound_shows_that_nothing_is_measured(sign):
    """15 N, or one and a half times the command."""
    for command, room in ((4.0, 15.0), (40.0, 60.0)):
        for share, ticks in ((0.98, 0), (0.995, 11)):
            contacts = Contacts()
            contacts.memory.force_sum[1] = sign * share * room
            given = ((command, command), (command, command))
            assert contacts.ticks_until(CONTACT_LOST, *given) == ticks
            contacts.memory.force_rank = 1  # integrals of other columns
            contacts.kept[0].underforce = 0.0
            assert contacts.ticks_until(CONTACT_LOST, *given) == 0


@BOTH
def test_a_column_without_a_command_has_no_force_to_lose(sign):
    """Its integral is at its bound at a wedged peg, whose forces the overload limit judges."""
    contacts = Contacts()
    contacts.memory.force_sum[1] = sign * 15.0
    given = ((5.0, sign * 20.0), (5.0, 0.0))
    assert contacts.ticks_until(CONTACT_LOST, *given) == 0
    assert contacts.ticks_until(OVERFORCE, (5.0, sign * 30.1), (5.0, 0.0)) == 6


@BOTH
def test_a_contact_is_overloaded_above_three_times_its_command_or_30_newtons(sign):
    for command, alpha, ticks in ((5.0, 29.9, 0), (5.0, 30.1, 6), (20.0, 59.0, 0), (20.0, 61.0, 6)):
        contacts = Contacts()
        given = ((5.0, sign * alpha), (5.0, sign * command))
        assert contacts.ticks_until(OVERFORCE, *given) == ticks
        assert contacts.memory.culprit == (0 if ticks else -1)


# --- readings before a tick -----------------------------------------------------------------------


def readings():
    """Plausible arguments of `check_readings`."""
    t = joints(2, wrench_timeout=0.0205, force_range=100.0, torque_range=10.0, plausible_speed=3.0)
    t.model.joints.rated = t.model.joints.speed_max = [2.0, 4.0]
    write(t.memory, has_wrench=1, compared=1)
    t.memory.joints.q = t.input.q[:] = [0.1, 0.2]
    write(t.input, X_WD=np.eye(4))
    return t


def assert_read(t, reason, culprit):
    assert plausibility.check_readings(t) == reason
    assert t.memory.culprit == (-1 if reason == NO_REASON else culprit)


def test_a_rotation_is_one_but_for_a_ten_thousandth():
    rng = default_rng(2)

    def verdict(R):
        t = readings()
        write(t.input, X_WD=np.column_stack([R, rng.uniform(-9.0, 9.0, 3)]))
        return plausibility.check_readings(t)

    for _ in range(20):
        R = any_rotation(rng)
        assert verdict(R) == NO_REASON
        assert verdict(R @ np.diag([1, 1, -1])) == verdict(-R) == NO_ROTATION
        assert verdict(R[:, [1, 0, 2]]) == NO_ROTATION
        i, j = rng.choice(3, 2, replace=False)
        for way in (np.outer(np.eye(3)[i], R[j]), np.outer(np.eye(3)[i], 0.5 * R[i])):
            for size, reason in ((0.97e-4, NO_REASON), (1.03e-4, NO_ROTATION)):
                assert verdict(R + size * way) == reason


@BOTH
def test_wrenches_within_the_range_of_their_sensors(sign):
    for axis, most in enumerate([100.0] * 3 + [10.0] * 3):
        for size, reason in ((most, NO_REASON), (1.001 * most, OUT_OF_RANGE)):
            t = readings()
            t.input.wrenches[0, axis] = sign * size
            assert_read(t, reason, 0)
            t.model.arms.sensor_joint[0] = -1  # no sensor, no range
            assert plausibility.check_readings(t) == NO_REASON


@parametrize("age, has", {19: 1, 20: 1, 0: 0})
def test_a_tick_without_a_wrench_uses_one_that_is_young_enough(age, has):
    t = readings()
    t.input.wrenches[:] = np.nan
    write(t.memory, wrench_missing=1, wrench_age=age, has_wrench=has)
    assert plausibility.check_readings(t) == (NO_REASON if age == 19 else WRENCH_TIMEOUT)


@BOTH
@parametrize("unread", [0, 4])
def test_joints_move_no_further_than_they_can(sign, unread):
    """20 mrad, and three times the speed limit since the last reading that was accepted."""
    for j, limit in enumerate((2.0, 4.0)):
        most = 0.02 + 3.0 * limit * DT * (1 + unread)
        for way, reason in ((most - 1e-6, NO_REASON), (most + 1e-6, JUMPED)):
            t = readings()
            t.memory.joints.unread_q[j] = unread
            t.input.q[j] += sign * way
            assert_read(t, reason, j)
            t.memory.joints.barred[j] = 1  # after a jump: where it is predicted, without waiting
            t.memory.q[j] = t.input.q[j] - sign * (way - 3.0 * limit * DT * unread)
            assert_read(t, reason, j)
            t.memory.compared = 0  # nothing to compare with
            assert plausibility.check_readings(t) == NO_REASON
        for speed, reason in ((3.0 * limit, NO_REASON), (3.001 * limit, JUMPED)):
            t = readings()
            t.input.v[j] = sign * speed
            assert plausibility.check_readings(t) == reason


# --- speeds of an approach ------------------------------------------------------------------------


class Approach:
    """Columns 3 and 1 of N are kept; the object moves with the twist V, at O."""

    def __init__(self, seed, phase=APPROACHING):
        rng = default_rng(seed)
        self.t = t = records(contacts=2, columns=4, period=DT, approach_speed=0.02)
        self.memory = t.memory
        self.work = t.work
        self.kept = t.memory.columns
        write(t.memory, compared=1, X_WO=np.eye(4) + np.eye(4, k=3))
        write(t.work, rank=2, kept=[3, 1], V_N=0.01 * rng.standard_normal(2))
        t.model.columns.contact = [0, 0, 1, 1]
        t.memory.contacts.phase = phase
        t.work.columns.N[:] = rng.standard_normal((4, 6))
        self.kept.known = 1

    def true(self, V):
        """NᵀV_rel of the kept columns."""
        return self.work.columns.N[[3, 1]] @ V - self.work.V_N[:2]

    def tick(self, V, speed):
        """The object has moved by V; these speeds were read. What is used."""
        X = rotated(pin.exp3(V[3:] * DT)) * pin.SE3(self.memory.X_WO.copy())
        X.translation = self.memory.X_WO[:3, 3] + V[:3] * DT
        write(self.work, X_WO=X.homogeneous, speed=np.broadcast_to(speed, 2))
        agreement.compare_speeds(self.t)
        write(self.memory, X_WO=self.work.X_WO)
        return self.work.speed[:2].copy()


def test_an_approach_uses_positions_where_speeds_read_too_little():
    for seed in range(4):
        approach = Approach(seed)
        V = 0.05 * default_rng(seed).standard_normal(6)
        true = np.array(approach.true(V))
        for _ in range(300):
            used = approach.tick(V, true - 0.0041)  # a fifth of v_a is 4 mm/s
        assert_near(used, true, atol=1e-6)
        assert_array_equal(used, approach.kept.velocity_from_positions[[3, 1]])
        for _ in range(300):
            approach.tick(V, true - 0.02)
        assert_array_equal(approach.tick(V, true + 0.05), true + 0.05)  # the low-pass lags behind
        for more in (-0.0039, 0.1):
            approach = Approach(seed)
            for _ in range(300):
                assert_array_equal(approach.tick(V, true + more), true + more)


TWIST = vector(0.3, -0.2, 0.1, 0.5, 0.4, -0.6)


def test_positions_are_low_passed_and_a_tick_that_was_missed_begins_anew():
    approach = Approach(1)
    true = np.array(approach.true(TWIST))
    for k in range(1, 60):
        approach.tick(TWIST, 0.0)
        share = 1.0 - (20.0 / 21.0) ** k  # 20 ms
        assert_near(approach.kept.velocity_from_positions[[3, 1]], true * share, rtol=1e-4)
        assert not approach.kept.velocity_from_encoders.any()
    approach.memory.compared = 0
    assert_array_equal(approach.tick(TWIST, 0.007), 0.007)
    for seen in (approach.kept.velocity_from_positions, approach.kept.velocity_from_encoders):
        assert_array_equal(seen, [0.0, 0.007, 0.0, 0.007])
    approach.memory.compared = 1
    approach.kept.known[3] = 0
    used = approach.tick(100.0 * TWIST * np.sign(true[0]), -9.0)
    encoders = approach.kept.velocity_from_encoders
    assert used[0] == -9.0 == encoders[3] and encoders[1] != -9.0


def test_closed_contacts_and_others_of_the_object_keep_their_speeds():
    approach = Approach(2, phase=CLOSED)
    for _ in range(100):
        assert_array_equal(approach.tick(TWIST, -1.0), -1.0)
    approach.t.memory.contacts.phase[1] = APPROACHING  # of column 3, the first that is kept
    used = approach.tick(TWIST, -1.0)
    positions = approach.kept.velocity_from_positions
    assert used[0] == positions[3] and used[1] == -1.0
    assert positions[0] == 0.0 == positions[2], "not in N"


# --- sensors after a tick -------------------------------------------------------------------------


class Sensors(Watched):
    """One arm of two joints with a wrist; readings differ from tick to tick if not given."""

    def __init__(self, force_rank=1, **more):
        limits = {"frozen_time": 0.0105, "stuck_speed": 0.1, "speed_error": 0.1}
        limits |= {"position_drift": 0.05, "plausible_speed": 10.0}
        limits |= {"force_range": 1e6, "torque_range": 1e6}
        self.t = joints(2, **limits | more)
        self.t.model.arms.sensor_joint[0] = 1
        self.memory = self.t.memory
        self.joints = self.t.memory.joints
        write(self.memory, engaged=1, force_rank=force_rank, state=at.RUN, culprit=0)
        self.joints.driven[:] = 1  # there is no friction
        self.count = 0
        self.q = np.zeros(2)

    def tick(self, v=(0.3, -0.4), wrench=None, q=None, true=None):
        """`v`: as read. `q`: as read, None: what true speeds make of it. `true`: those speeds."""
        self.q = self.q + DT * np.array(v if true is None else true) if q is None else q
        self.count += 1
        wrench = np.full((1, 6), float(self.count)) if wrench is None else wrench
        v = np.array(v) + (1e-9 * self.count if q is None else 0.0)
        reason = self._read(self.q, v, wrench)
        self.memory.has_wrench = 1
        self.memory.ticked += 1
        return reason

    def lose(self):
        """A tick in which nothing was read."""
        nothing = np.full(2, np.nan)
        self.q = self.q + DT * np.array((0.3, -0.4))
        return self._read(nothing, nothing, np.full((1, 6), np.nan))

    def _read(self, q, v, wrench):
        write(self.t.input, q=q, v=v, wrenches=wrench)
        reason = sensors.check_sensors(self.t)
        isolation.estimate_joints(self.t)
        return reason


def test_readings_that_agree_are_used():
    sensors = Sensors()
    assert sensors.until() == (0, NO_REASON)
    assert_array_equal(sensors.joints.q, sensors.q)
    assert_array_equal(sensors.memory.q, sensors.q)
    assert (sensors.memory.compared, sensors.memory.unbraked) == (1, -1)
    assert_array_equal(sensors.memory.wrenches, 399.0)


@parametrize("speed, found", [(0.02, 625), (-0.02, 625), (0.0019, 0)])
def test_an_encoder_that_dies_in_a_slow_joint_is_found(speed, found):
    """At a quarter of `position_drift`; an offset of 1.9 mrad/s is no motion."""
    sensors = Sensors(frozen_time=np.inf)
    assert sensors.tick(v=(0.3, speed)) == NO_REASON
    ticks, reason = sensors.until(v=(0.3, speed), true=(0.3, 0.0), most=8000)
    assert abs(ticks - found) <= 2 and reason == (DISAGREE if found else NO_REASON)
    assert sensors.joints.faulty.tolist() == [0, at.FAULTY_POSITION if found else 0]


@parametrize("offset", [0.0, 0.0019])
def test_noisy_speeds_of_a_joint_at_rest_are_no_motion(offset):
    """Their sum is 19 mrad after 10 s, nearly four times the bound of moving joints."""
    sensors = Sensors(frozen_time=np.inf, position_drift=0.02)
    sensors.joints.driven[:] = 0
    rng = np.random.default_rng(3)
    for _ in range(10_000):
        v = np.array([0.3, offset]) + 0.01 * rng.standard_normal(2)
        assert sensors.tick(v=v, true=(0.3, 0.0)) == NO_REASON


@BOTH
def test_speeds_of_a_constant_position_count_after_five_times_their_delay(sign):
    """The present speed must be near the mean of that time as well, here 0.2 rad/s."""
    t = records(joints=1, position_drift=0.01)
    row = t.memory.joints[0]
    for rested, present, found in ((0.0499, 0.2, 0), (0.0501, 0.2, 1), (0.0501, 0.09, 0)):
        write(row, rested=rested, due=sign * 0.2 * rested, error=sign * present)
        assert sensors._creeps(t, row) == found


@parametrize("late", ["low-pass", "delay"])
def test_late_speeds_of_a_joint_that_stops_suddenly_are_no_motion(late):
    sensors = Sensors(frozen_time=np.inf, position_drift=0.02, speed_error=1.0)
    sensors.joints.driven[:] = 0
    for _ in range(50):
        assert sensors.tick(v=(0.3, 0.9)) == NO_REASON
    for k in range(300):
        v = 0.9 * np.exp(-k / 10.0) if late == "low-pass" else 0.9 * (k < 10)
        assert sensors.tick(v=(0.3, v), true=(0.3, 0.0)) == NO_REASON


def test_a_wrist_in_contact_may_repeat_itself_for_so_long():
    still = np.arange(6.0)[None]
    sensors = Sensors()
    assert sensors.until(wrench=still) == (12, WRIST_FROZEN)
    assert sensors.memory.culprit == 0
    for axis in range(6):  # one number that moves is enough
        sensors = Sensors()
        for k in range(40):
            moving = still.copy()
            moving[0, axis] += k
            assert sensors.tick(wrench=moving) == NO_REASON
    sensors = Sensors(force_rank=0)  # free: gravity alone may well be constant
    assert sensors.until(wrench=still, most=60) == (0, NO_REASON)
    sensors = Sensors()
    sensors.t.model.arms.sensor_joint[0] = -1
    assert sensors.until(wrench=still, most=60) == (0, NO_REASON)
    sensors = Sensors()
    for k in range(100):  # what moves now and then begins anew
        assert sensors.tick(wrench=still + k // 10) == NO_REASON


@parametrize("axis", range(6))
def test_a_number_of_a_wrist_that_ends_to_change_is_at_the_end_of_its_range(axis):
    """Not that of a coarse sensor, whose numbers hardly changed before, nor one that is zero."""

    def wrench(k, value, coarse=1):
        moving = np.full((1, 6), float(k // coarse))
        moving[0, axis] = value
        return moving

    for coarse, value, found in ((1, 3.0, WRIST_SATURATED), (3, 3.0, 0), (1, 0.0, 0)):
        sensors = Sensors()
        for k in range(1, 200):
            assert sensors.tick(wrench=wrench(k, k // coarse, coarse)) == NO_REASON
        seen = [sensors.tick(wrench=wrench(k, value, coarse)) for k in range(200, 240)]
        assert seen[:10] == [NO_REASON] * 10 and seen[-1] == found
    sensors = Sensors(force_rank=0)  # free: gravity alone may well be constant
    for k in range(1, 200):
        assert sensors.tick(wrench=wrench(k, float(max(k, 100)))) == NO_REASON


def saturating(sensors, most=60):
    """Ticks until a number of the wrist that repeats stops the arms."""
    for k in range(1, most):
        moving = np.full((1, 6), float(sensors.count))
        moving[0, 2] = 3.0
        if sensors.tick(wrench=moving) != NO_REASON:
            return k
    return 0


def test_a_wrist_at_the_end_of_its_range_is_found_as_soon_after_a_reset():
    """Also after a long run: its readings are observed anew, not with the time of those before."""
    sensors = Sensors()
    assert saturating(sensors) == 12
    for name in sensors.memory.arms.dtype.names:  # as `Controller.reset` does
        sensors.memory.arms[name] = 0
    sensors.memory.ticked = 5000
    assert saturating(sensors) == 11


def test_a_number_that_repeats_in_the_air_is_no_evidence_at_the_first_contact():
    sensors = Sensors(force_rank=0)
    assert saturating(sensors) == 0
    sensors.memory.force_rank = 1
    assert saturating(sensors) == 11


STILL = {"wrench": np.ones((1, 6)), "q": np.ones(2), "v": (0.0, 0.0)}


def noisy(state=at.RUN, joints=(0, 1), **how):
    """After 100 readings at rest with noise in the positions of these joints."""
    sensors = Sensors(force_rank=0, **how)
    sensors.memory.state = state
    for k in range(100):
        q = np.ones(2)
        q[list(joints)] += 1e-5 * (-1) ** k
        assert sensors.tick(**STILL | {"q": q, "wrench": None}) == NO_REASON
    return sensors


@parametrize("state", [at.RUN, at.SAFE_STOP])
def test_a_packet_that_repeats_itself_is_distinguished_from_joints_at_rest(state):
    """Former noise of the readings distinguishes them; also during a stop."""
    sensors = noisy(state)
    assert sensors.until(**STILL) == (12, FROZEN)
    assert (sensors.joints.faulty == 3).all(), "no reading of it is sound"
    assert sensors.memory.unbraked == 1
    for joints in ((), (0,), (1,)):  # ideal or coarse sensors read the same at rest
        assert noisy(state, joints).until(**STILL, most=60) == (0, NO_REASON)
    for j in range(2):
        sensors = noisy(state)
        q = np.ones(2)
        for k in range(60):
            q[j] = 1.0 + 1e-12 * (k % 2)
            assert sensors.tick(**STILL | {"q": q.copy()}) == NO_REASON
    sensors = noisy(state)
    for k in range(60):
        assert sensors.tick(**STILL | {"v": (0.0, 1e-12 * (k % 2))}) == NO_REASON
    assert sensors.memory.frozen == 0


@parametrize("state", [at.RUN, at.SAFE_STOP])
def test_joints_whose_noise_ends_have_died_although_wrists_go_on(state):
    """Noise in most readings does not end; that between two steps of coarse encoders does."""
    sensors = noisy(state)
    assert sensors.until(**STILL | {"wrench": None}) == (12, FROZEN)
    assert (sensors.joints.faulty == 3).all() and sensors.memory.unbraked == 1
    for joints in ((), (0,), (1,)):
        assert noisy(state, joints).until(**STILL | {"wrench": None}, most=60) == (0, NO_REASON)
    sensors = noisy(state)
    q = np.ones(2)
    for k in range(300):  # one joint at a time, now and then
        q[k % 2] += 1e-5 * (-1) ** (k // 2) if k % 5 == 0 else 0.0
        assert sensors.tick(**STILL | {"q": q.copy(), "wrench": None}) == NO_REASON
    assert sensors.until(**STILL | {"q": q, "wrench": None}, most=60) == (0, NO_REASON)
    assert sensors.until(**STILL | {"q": q}) == (12, FROZEN)


def test_a_wrist_out_of_range_is_none_that_repeats_itself():
    """It reads something else than it did; one that is not read leaves the evidence as it is."""
    for beyond, ends in ((1e7, (0, NO_REASON)), (np.nan, (12, FROZEN))):
        sensors = noisy()
        sensors.memory.lively = 0.0  # else joints are evidence enough
        assert sensors.until(**STILL | {"wrench": np.full((1, 6), beyond)}, most=60) == ends


def stopped(**how):
    """A stopped arm at rest; its holds are moved every 15 ms."""
    sensors = Sensors(force_rank=0, hold_rate=200.0, frozen_time=inf, **how)
    write(sensors.memory, state=at.SAFE_STOP, settled=at.SETTLED)
    sensors.joints.driven[:] = 0
    return sensors


def follow(sensors, ticks, joints=(0, 1), steps=3):
    """Joints go where their holds stand, within so many readings."""
    q = sensors.joints.q.copy()
    for _ in range(ticks):
        for j in joints:
            q[j] += np.clip(sensors.joints.hold[j] - q[j], *(1.2e-4 / steps * vector(-1.0, 1.0)))
        sensors.tick(v=(0.0, 0.0), q=q.copy())


def test_holds_of_a_stop_go_to_and_fro():
    sensors = stopped()
    seen = []
    for _ in range(61):
        follow(sensors, 1)
        seen.append(sensors.joints.hold[0])
    assert_near(np.unique(seen), [0.0, 1.2e-4], atol=1e-12)
    assert np.count_nonzero(np.diff(seen)) == 4


@parametrize("j", [0, 1])
@parametrize("of_speed", [True, False])
def test_the_encoder_of_a_stopped_joint_that_follows_its_hold_no_more_is_dead(j, of_speed):
    sensors = stopped()
    follow(sensors, 100)
    assert (sensors.joints.faulty == 0).all() and (sensors.joints.followed == 4).all()
    sensors.memory.derived = of_speed
    sensors.joints.moved[j] = 0.0
    for k in range(31):
        assert sensors.joints.faulty[j] == 0
        q = sensors.joints.q.copy()
        q[1 - j] = sensors.joints.hold[1 - j] - 1e-5 * k
        sensors.memory.derived = of_speed
        sensors.tick(v=vector(0.0, 0.0) + (0.0 if of_speed else 1e-7 * k), q=q)
        if sensors.joints.faulty.any():
            break
    assert sensors.joints.faulty[j] == (3 if of_speed else at.FAULTY_POSITION)
    assert sensors.joints.faulty[1 - j] == 0
    assert sensors.memory.unbraked == (j if of_speed else -1)


def test_stopped_joints_that_never_followed_are_held_by_friction():
    for how in ({"joints": (1,)}, {"joints": (1,), "steps": 1}):
        sensors = stopped()
        follow(sensors, 300, **how)
        follow(sensors, 300, joints=())
        assert sensors.joints.faulty[0] == 0
    sensors = stopped()
    sensors.memory.settled = 0  # braked
    follow(sensors, 100)
    assert (sensors.joints.hold == 0.0).all()


@BOTH
def test_a_stopped_joint_does_not_read_one_position_and_a_speed(sign):
    """More than 0.4 mrad, for more than 30 ms."""
    for j in range(2):
        for speed, ticks in ((0.1, 31), (0.005, 81)):
            sensors = stopped(speed_error=inf)
            v = np.zeros(2)
            v[j] = sign * speed
            q = np.ones(2)
            sensors.tick(v=v, q=q)
            other = 1e-7 * np.eye(2)[1 - j]
            found = []
            while DISAGREE not in found and len(found) < 200:
                found.append(sensors.tick(v=v, q=q + other * len(found)))
            assert_at_last(found, DISAGREE)
            assert len(found) == approx(ticks, abs=1)
            assert sensors.memory.unbraked == j


def test_joints_that_jump_in_one_packet_discredit_all_of_it():
    """One that jumps alone has lost its position only."""
    sensors = Sensors()
    sensors.until(most=20)
    v = vector(0.3, -0.4)
    before = sensors.memory.v.copy()
    swapped = sensors.q[::-1] + vector(0.5, -0.5)
    found = []
    while len(found) < 20 and MIXED not in found:
        sensors.q = sensors.q + DT * v
        found.append(sensors._read(swapped, vector(9.0, 9.0), np.full((1, 6), 1e3 + len(found))))
        assert_near(sensors.memory.v, before, atol=1e-6)
        assert_near(sensors.memory.q, sensors.q, atol=1e-6)
    assert_at_last(found, MIXED)
    assert 10 <= len(found) <= 11
    assert (sensors.joints.faulty == 3).all() and sensors.memory.unbraked == 1
    sensors = Sensors()
    sensors.until(most=20)
    alone = sensors.q + vector(0.5, 0.0)
    for k in range(30):
        sensors.q = sensors.q + DT * v
        alone[1] = sensors.q[1]
        assert sensors._read(alone, v, np.full((1, 6), 1e3 + k)) == NO_REASON
    assert_near(sensors.memory.q, sensors.q, atol=1e-6)
    assert sensors.memory.unbraked == -1 and (sensors.joints.faulty == 0).all()


@BOTH
@parametrize("lost", [0, 2])
def test_joints_that_read_what_the_other_one_did_discredit_all_of_it(lost, sign):
    """Positions that are nearly the same jump by little; they are exchanged all the same."""
    sensors = Sensors()
    sensors.q = sign * vector(0.2, 0.204)
    sensors.until(most=20)
    for _ in range(lost):
        sensors.lose()
    v = vector(0.3, -0.4)
    found = []
    while len(found) < 20 and MIXED not in found:
        sensors.q = sensors.q + DT * v
        wrench = np.full((1, 6), 1e3 + len(found))
        found.append(sensors._read(sensors.q[::-1], v[::-1], wrench))
    assert_at_last(found, MIXED)
    assert 10 <= len(found) <= 11
    assert_near(sensors.memory.q, sensors.q, atol=1e-5)
    assert (sensors.joints.faulty == 3).all() and sensors.memory.unbraked == 1


def test_noise_far_beyond_the_expected_one_is_no_exchange_of_readings():
    """Positions that are nearly the same may read as exchanged by chance, and stayed so."""
    sensors = Sensors()
    sensors.q = vector(0.2, 0.204)
    sensors.until(most=20)
    v = vector(0.3, -0.4)
    for k in range(30):
        sensors.q = sensors.q + DT * v
        sensors.memory.derived = at.NOISY
        sensors._read(sensors.q[::-1] if k == 0 else sensors.q, v, np.full((1, 6), 1e3 + k))
        assert (sensors.joints.barred == at.NOT_BARRED).all()
    assert sensors.memory.unbraked == -1 and (sensors.joints.faulty == 0).all()


@BOTH
@parametrize("lost", [0, 2])
def test_speeds_that_are_those_of_one_another_are_exchanged(lost, sign):
    """They differ by more than 2 % of their limits, and jump by less than 10 %."""
    for gap, found in ((0.05, MIXED), (0.03 if not lost else 0.1, NO_REASON)):
        sensors = Sensors(speed_error=0.1)
        v = sign * vector(0.3, 0.3 - gap * (1 + lost if found else 1))
        sensors.until(v=v, most=20)
        for _ in range(lost):
            sensors.lose()
            sensors.q = sensors.q + DT * (v - vector(0.3, -0.4))  # as they move
        seen = [sensors.tick(v=v[::-1], true=v) for _ in range(12)]
        assert seen[-1] == found
        if found:
            assert_array_equal(sensors.joints.faulty, at.FAULTY_SPEED)
            assert sensors.memory.unbraked == -1, "positions are sound"
            assert_near(sensors.memory.v, v, atol=1e-6)
    sensors = Sensors()
    sensors.until(most=20)
    sensors.memory.derived = at.ESTIMATED
    assert sensors.tick(v=(-0.2, 0.1), true=(0.3, -0.4)) == NO_REASON


@parametrize("late", [0.0, 0.1])
def test_noisy_encoders_do_not_contradict_speeds_that_are_estimated_from_them(late):
    """Nor did they in the milliseconds before the noise was found; what is older stays."""
    sensors = Sensors()
    sensors.until(most=20)
    sensors.memory.derived = at.ESTIMATED
    assert sensors.until(v=(9.0, 0.0), true=(0.3, -0.4))[1] == DISAGREE
    marks = sensors.joints.faulty.copy()
    assert marks.any()
    write(sensors.memory, state=at.SAFE_STOP, cause=DISAGREE, age=late / DT, derived=at.NOISY)
    assert sensors.until(v=(9.0, 0.0), true=(0.3, -0.4), most=30) == (0, NO_REASON)
    assert_array_equal(sensors.joints.faulty, marks if late else 0)


@parametrize("j", [0, 1])
def test_marks_of_a_constant_position_stay_where_encoders_are_noisy(j):
    sensors = Sensors()
    sensors.until(most=20)
    sensors.joints.faulty[:] = 3
    sensors.joints.stuck[j] = 1
    write(sensors.memory, state=at.SAFE_STOP, cause=DISAGREE, age=1, derived=at.NOISY)
    sensors.tick()
    assert_array_equal(sensors.joints.faulty, [3 * (i == j) for i in range(2)])


def test_joints_that_pass_one_another_are_not_exchanged():
    for v in ((0.3, -0.4), (9.0, -9.0)):
        sensors = Sensors()
        sensors.q = vector(0.2, 0.2) - 10.5 * DT * np.array(v)
        assert sensors.until(v=v, most=20) == (0, NO_REASON)


@BOTH
def test_joints_that_pass_their_zeros_in_a_mirror_image_are_not_exchanged(sign):
    """Speeds that were estimated too slow: each is where the other one was expected."""
    sensors = Sensors()
    v = sign * vector(3.8, -3.8)
    sensors.q = -10.65 * DT * v  # 2.5 mrad before zero, then 1.3 mrad behind it, not before it
    for k in range(30):
        sensors.memory.v[:] = 0.3 * v
        sensors.memory.derived = at.ESTIMATED
        assert sensors.tick(v=v) == NO_REASON
        assert (sensors.joints.barred == at.NOT_BARRED).all(), k


@BOTH
def test_friction_may_hold_a_joint_against_a_share_of_its_torque(sign):
    """5 % of its limit, and twice the dry friction that is known of it."""
    t = joints(2)
    t.model.arms.end[0] = 2
    write(t.model.joints, tau_max=10.0)
    t.model.joints.theta[1, 0] = 0.25
    h = vector(3.0, -2.0)

    def driven(*pushes):
        write(t.work.joints, h=h, inertial=h + sign * np.array(pushes))
        return [bool(sensors.must_move(t, t.model.arms[0], j)) for j in range(2)]

    assert driven(0.501, 0.999) == [True, False]
    assert driven(0.499, 1.001) == [False, True]
    t.memory.joints.trusted[1, 0] = 0.4  # learned
    assert driven(0.0, 1.299) == [False, False] and driven(0.0, 1.301) == [False, True]
    t.model.joints.motor[0] = -1  # no friction of a motor
    assert driven(1e-6, 0.0) == [True, False]


@parametrize("j", [0, 1])
def test_readings_are_dead_where_a_joint_stops_by_more_than_twice_the_torque_of_friction(j):
    t = joints(2)
    t.model.arms.end[0] = 2
    write(t.model.joints, tau_max=10.0)
    t.model.joints.theta[j, 0] = 0.1
    for i in range(2):
        t.work.joints.M[i, i] = 0.5
    t.memory.still = 0.02
    t.memory.joints.halted[j] = 2.79  # 1.4 N m: twice 0.5 and twice 0.1
    assert not sensors.stopped_abruptly(t)
    t.memory.joints.halted[j] = 2.81
    assert sensors.stopped_abruptly(t)
    t.memory.still = 0.005  # joints read the same now and then
    assert not sensors.stopped_abruptly(t)
    t.memory.still = 0.02
    t.model.joints.motor[j] = -1
    assert not sensors.stopped_abruptly(t)


@parametrize("at_once", [True, False])
def test_what_halts_a_joint_is_known_until_it_moves(at_once):
    """The first packet that repeats itself may be a new one."""
    sensors = Sensors(frozen_time=inf)
    sensors.until(most=20)
    still = sensors.q + (0.0 if at_once else DT * vector(0.3, -0.4))
    for _ in range(3):
        sensors.tick(v=(0.0, -0.4), q=still)
        assert_near(sensors.joints.halted, [300.0, 0.0], rtol=1e-4)
    sensors.tick(v=(0.0, -0.4), q=still + vector(1e-6, 0.0))
    assert_array_equal(sensors.joints.halted, 0.0)
    sensors.tick(v=(0.3, -0.4), q=still)
    for _ in range(2):
        sensors.lose()
    sensors.tick(v=(0.0, -0.4), q=still)
    assert sensors.joints.halted[0] == approx(100.0, rel=1e-4)
    sensors.tick(v=(0.1, -0.4), q=still)
    assert_array_equal(sensors.joints.halted, 0.0)


@BOTH
def test_joints_that_all_read_the_same_are_held_by_twice_the_friction_that_they_have_shown(sign):
    """And 0.2 % of the limit; by 5 % of it at most, or where they have hardly moved."""
    t = joints(2)
    t.model.arms.end[0] = 2
    write(t.model.joints, tau_max=10.0)

    def driven(push):
        write(t.work.joints, h=0.0, inertial=sign * push)
        return [bool(sensors.must_move(t, t.model.arms[0], j)) for j in range(2)]

    t.memory.still = 0.02
    write(t.memory.joints, slid=[0.2, 0.05], rubbed=0.1)
    assert driven(0.221) == [True, False] and driven(0.219) == [False, False]
    assert driven(0.501) == [True, True]
    t.memory.joints.rubbed[0] = 0.3
    assert driven(0.499) == [False, False] and driven(0.501) == [True, True]
    t.memory.joints.rubbed[0] = 0.1
    t.memory.still = 0.005  # joints read the same now and then
    assert driven(0.499) == [False, False]


@BOTH
def test_motors_show_whether_a_joint_with_an_estimated_speed_moves(sign):
    """By torques that the wrist does not explain: its own, and 0.4 of what moves the others."""
    t = joints(2)
    write(t.model.arms, end=2, sensor_joint=1)
    write(t.model.joints, tau_max=10.0)
    write(t.work.joints, h=0.0, inertial=5.0, M=np.array([[1.0, 0.5], [0.5, 2.0]]))

    def moves(*residuals):
        t.memory.joints.residual = sign * np.array(residuals)
        return [bool(sensors.must_move(t, t.model.arms[0], j)) for j in range(2)]

    assert moves(0.0, 0.0) == [True, True], "speeds that are read apart show it"
    t.memory.derived = at.ESTIMATED
    assert moves(0.0, 0.0) == [False, False], "a contact may hold both"
    assert moves(0.501, 0.101) == [True, False] and moves(0.499, 0.2) == [False, False]
    assert moves(3.0, 0.59) == [False, True] and moves(3.0, -1.0) == [False, False]
    assert moves(0.0, 4.0) == [False, False], "a brake holds the second one"
    t.model.arms.sensor_joint[0] = -1
    assert moves(0.0, 0.0) == [True, True], "without a wrist nothing is known"


@BOTH
def test_rounding_of_an_estimate_is_no_motion(sign):
    """The estimate of a constant reading changed in its last digits, and seemed to be alive."""
    for derived, ticks in ((at.ESTIMATED, 50), (0, 0)):
        found = Sensors(frozen_time=inf)
        for k in range(50):
            write(found.memory, derived=derived)
            q = vector(1e-3 * k, sign * 9e-10 * (k % 2))
            found.tick(v=(1.0, 0.0), q=q)
        assert found.joints.rested[1] == approx(ticks * DT, abs=1.5 * DT)
        assert found.joints.rested[0] < DT


@BOTH
def test_joints_that_read_the_same_with_some_speed_for_long_are_faulty(sign):
    """Wrists are live: an encoder's card repeats itself."""
    still = np.ones(2)
    for j in range(2):
        for speed, ticks in ((1.3, 11), (0.03, 14)):  # rad/s; more than 0.4 mrad, after 10.5 ms
            sensors = Sensors(speed_error=inf, position_drift=0.05)
            v = np.zeros(2)
            v[j] = sign * speed
            sensors.tick(v=v, q=still)
            sensors.joints.drift[j] = -9.0 * v[j] * DT  # drift as such is far from its bound
            assert_at_last([sensors.tick(v=v, q=still) for _ in range(ticks)], DISAGREE)
            assert sensors.memory.culprit == j
            assert sensors.memory.still == approx(1e-3 * ticks)
        for other in ({"q": still + 1e-12}, {"v": v * (1.0 + 1e-12)}):
            sensors.tick(**{"v": v, "q": still} | other)
            assert sensors.memory.still == 0
    sensors = Sensors(speed_error=inf)
    assert sensors.until(v=(0.0, 0.0), q=still, most=90) == (0, NO_REASON), "at rest"


@BOTH
@parametrize("every", [0, 2, 3])
def test_an_encoder_is_stuck_when_its_joint_should_have_gained_a_tenth_of_its_limit(sign, every):
    """Also with every 2nd or 3rd tick lost: the evidence counts time."""
    for j in range(2):
        sensors = Sensors(speed_error=inf, position_drift=inf, frozen_time=inf)
        ticks = 0
        reason = NO_REASON
        sensors.tick(q=np.zeros(2))
        sensors.joints.acceleration[j] = sign * 10.3  # rad/s²; a tenth is 0.2 rad/s
        while reason == NO_REASON and ticks < 90:
            ticks += 1
            lost = every and ticks % every == every - 1
            reason = sensors.lose() if lost else sensors.tick(q=np.zeros(2))
        assert reason == STUCK and 20 <= ticks <= 22
        assert sensors.memory.culprit == j and sensors.joints[j].faulty & at.FAULTY_POSITION
        if not every:
            sensors.joints.acceleration[j] = sign * 1e6  # one tick shows no more than 0.21 of it
            sensors.tick(q=np.full(2, 0.01))
            assert sensors.until(q=np.full(2, 0.01)) == (5, STUCK)
            sensors.tick(q=np.zeros(2))
            sensors.joints.acceleration[j] = sign * 10.0
            for k in range(60):  # slow encoders repeat readings
                assert sensors.tick(q=np.full(2, 0.01 * (k // 15))) == NO_REASON


@BOTH
def test_speeds_are_those_of_the_positions_within_a_tenth_of_their_limit(sign):
    for j in range(2):
        for error, found in {0.199: False, 0.201: True, 1.0: True}.items():
            sensors = Sensors(position_drift=inf)
            v = vector(0.3, -0.4)
            wrong = v.copy()
            wrong[j] += sign * error
            sensors.tick(v=v)
            ticks, reason = sensors.until(v=wrong, true=v)
            assert (reason == DISAGREE) == found
            if found:
                assert sensors.memory.culprit == j
            if error == 1.0:  # 1 − exp(−t / 20 ms) = 0.2, a tick or two for the sampling
                assert ticks == approx(20.0 * np.log(1.25), abs=1.0)


@BOTH
@parametrize("every", [0, 2])
@parametrize("of_speed", [True, False])
def test_a_drift_is_blamed_on_the_reading_that_nothing_predicts(every, of_speed, sign):
    """It is found when the prediction has followed both readings and is wrong by 0.4 rad/s²."""
    for j in range(2):
        sensors = Sensors(position_drift=0.03, speed_error=inf)
        v = vector(0.3, -0.4)
        drift = 0.2 * sign * np.eye(2)[j]
        sensors.tick(v=v)
        reason = NO_REASON
        k = 0
        while reason == NO_REASON and k < 600:
            k += 1
            if every and k % every == every - 1:
                sensors.q = sensors.q + DT * (v if of_speed else v + drift)
                reason = sensors._read(np.full(2, np.nan), np.full(2, np.nan), np.ones((1, 6)) * k)
                continue
            v = v + 0.4 * DT * max(every, 1)
            wrong = v + drift
            reason = sensors.tick(v=wrong if of_speed else v, true=v if of_speed else wrong)
        assert reason == DISAGREE and k > 100
        expected = at.FAULTY_SPEED * np.ones(2) if of_speed else at.FAULTY_POSITION * np.eye(2)[j]
        assert_array_equal(sensors.joints.faulty, expected)


@parametrize("every", [2, 3, 10])
def test_lost_ticks_take_no_evidence_away(every):
    """Speeds mirrored, of one joint or of both, and every so many-th tick lost."""
    v = vector(0.3, -0.4)
    for signs, found in (((1.0, -1.0), DISAGREE), ((-1.0, -1.0), MIXED)):
        sensors = Sensors(position_drift=inf)
        sensors.tick(v=v)
        for k in range(1, 60):
            lost = k % every == every - 1
            reason = sensors.lose() if lost else sensors.tick(v=v * signs, true=v)
            if reason != NO_REASON:
                break
        assert reason == found and k < 16
        if found == MIXED:
            assert (sensors.joints.faulty == at.FAULTY_SPEED).all(), "positions are sound"


def test_a_joint_without_a_sound_reading_cannot_be_braked():
    sensors = Sensors()
    sensors.until(most=20)
    for _ in range(10):
        sensors.lose()
        assert sensors.memory.unbraked == -1, "one lost tick blinds nobody"
    sensors.lose()
    assert sensors.memory.unbraked == 1
    sensors.tick()
    assert sensors.memory.unbraked == -1


def test_what_is_not_read_follows_from_speeds_or_positions():
    """Positions as integrals, speeds by a low-pass of 5 ms."""
    sensors = Sensors()
    v = vector(0.3, -0.4)
    nothing = np.full(2, np.nan)
    sensors.tick(v)
    for k in range(1, 30):
        sensors.tick(nothing, true=2.0 * v)
        assert_near(sensors.memory.v, v * (2.0 - (5.0 / 6.0) ** k), rtol=1e-7)
    for k in range(1, 30):
        sensors.tick(v, q=nothing)
        assert_near(sensors.memory.q, v * (0.059 + k * DT), rtol=1e-7)


@BOTH
def test_speeds_and_positions_drift_apart_no_further_than_so_much(sign):
    """d' = e − d/T, T = 0.5 s, less 5 % of the speed: e (1 − exp(−t/T)) T = 50 mrad + 10 ms q̇."""
    j = int(sign > 0.0)
    for error, speed in ((0.09, 1e-3), (0.13, 1e-3), (0.18, 1.0), (0.19, 0.5)):
        sensors = Sensors()
        v = np.zeros(2)
        v[j] = sign * speed
        wrong = v.copy()
        wrong[j] += sign * error
        sensors.tick(v=v)
        gone = error - 0.05 * abs(wrong[j])
        most = 0.05 + 0.01 * abs(wrong[j])
        ticks, reason = sensors.until(v=wrong, true=v, most=3000)
        if gone * 0.5 > most * 1.02:
            expected = -500.0 * np.log(1.0 - most / (0.5 * gone))
            assert reason == DISAGREE and sensors.memory.culprit == j
            assert ticks == approx(expected, rel=0.03)
        else:
            assert reason == NO_REASON


# --- what becomes of it ---------------------------------------------------------------------------


def test_a_state_counts_its_ticks_and_a_hold_begins_unsettled():
    for before in range(4):
        for after in range(4):
            t = records()
            memory = t.memory
            write(memory, state=before, age=7, settled=1)
            safety._enter(t, after)
            assert (memory.state, memory.age) == (after, 8 if before == after else 1)
            begins = after >= at.HOLD > before
            assert memory.settled == (0 if begins else 1)


@parametrize("change, known, identified", [(6.0, 0.0, 0.0), (8.0, 2.0, 1.0), (8.0, 1.0, 2.0)])
@parametrize("sign", [-1.0, 1.0])
def test_a_hold_releases_a_motor_whose_torque_it_changes_by_more_than_friction(
    change, known, identified, sign
):
    """And by more than `wrist_error` of its limit, 5 N m here; joints without motors are none."""
    t = records(arms=2, joints=4, period=DT, wrist_error=0.05)
    write(t.model.arms, first=[0, 2], end=[2, 4])
    write(t.model.joints, motor=[0, -1, 1, 2], tau_max=100.0)
    t.model.joints.theta[:, 0] = known
    t.memory.joints.trusted[:, 0] = identified
    bound = 5.0 + max(known, identified)
    for size, released in ((0.99 * bound, 0), (1.01 * bound, 1), (change, change > bound)):
        for arm, motor in ((0, 0), (1, 2)):
            t.memory.torques[:3] = vector(10.0, -20.0, 30.0)
            t.work.tau[:3] = t.memory.torques[:3]
            t.work.tau[motor] += sign * size
            for k in range(2):
                holding._note_release(t, k)
            assert t.memory.arms.released.tolist() == [released if k == arm else 0 for k in (0, 1)]


@parametrize("light_for, gone", [(40, False), (60, True)])
def test_a_stopped_arm_has_let_go_once_its_load_is_light_for_20_ms(light_for, gone):
    """The low-pass of 20 ms falls below a quarter of the share after 28 ms without load."""
    t = records(arms=2, joints=2, period=DT, held=1, gravity=(0.0, 0.0, -9.81))
    t.model.principal[0] = 2.0  # kg
    t.memory.state = at.SAFE_STOP
    rigid = np.eye(3).ravel()
    write(t.work.joints, R=np.eye(3), p=np.zeros(3))
    write(t.model.arms, sensor_joint=[0, 1])
    t.model.arms.sensor[:, :9] = rigid
    share = vector(0.0, 0.0, 9.81)

    def weigh(force, ticks):
        t.memory.wrenches[0, :3] = force
        for _ in range(ticks):
            holding._weigh(t, 0, np.zeros(3))

    weigh(share, 5)
    weigh(np.zeros(3), light_for)
    weigh(share, 100)
    assert t.memory.arms[0].let_go == gone


def test_a_gripper_that_swings_bears_no_load():
    """Its own weight and inertia are in the reading: 1 kg that swings with 40 N, and 9.81 N."""
    t = records(arms=2, joints=2, period=DT, held=1, gravity=(0.0, 0.0, -9.81))
    t.model.principal[0] = 2.0  # kg
    t.memory.state = at.SAFE_STOP
    write(t.work.joints, R=np.eye(3), p=np.zeros(3))
    write(t.model.arms, sensor_joint=[0, 1], outer_joint=[0, 1], first=[0, 1], end=[1, 2])
    t.model.arms.sensor[:, :9] = np.eye(3).ravel()
    t.model.arms.outer[:, 0] = 1.0
    t.work.joints.outboard[0, 0] = 1.0  # kg m: along x
    omega, speed = 60.0, 40.0 / 60.0
    for k in range(400):
        t.memory.v[0] = speed * np.sin(omega * k * DT)
        t.memory.wrenches[0, :3] = (omega * speed * np.cos(omega * k * DT), 0.0, 9.81)
        holding._weigh(t, 0, np.zeros(3))
    assert np.linalg.norm(t.memory.arms[0].load) < 1.5  # N, with speeds that are half a tick late
    assert t.memory.arms[0].let_go == 1


def two_at_a_rod(turn=0.0, shift=0.0):
    """Two stopped arms that hold a rod at ∓0.15 m; the second is turned (rad) and shifted (m)."""
    t = records(arms=2, joints=2, period=DT, held=1, leader=0, closure_error=0.02)
    write(t.model, gravity=(0.0, 0.0, -9.81))
    t.model.principal[0] = 2.0  # kg
    t.memory.state = at.SAFE_STOP
    write(t.model.arms, tip_joint=[0, 1], sensor_joint=[0, 1], outer_joint=-1)
    write(t.model.arms, kind=at.RIGID, first=[0, 1], end=[1, 2])
    for frame in (t.model.arms.tip, t.model.arms.X_TO, t.model.arms.sensor):
        frame[:, :9] = np.eye(3).ravel()
    t.model.arms.point[:, 0] = (-0.15, 0.15)
    t.model.arms.X_TO[:, 9] = (0.15, -0.15)
    t.model.X_LO[:9] = np.eye(3).ravel()
    t.model.X_LO[9] = 0.15
    write(t.work.joints, R=np.eye(3))
    t.work.joints.p[:, 0] = (-0.15, 0.15)
    t.work.joints.p[1, 2] = shift
    t.work.joints.R[1] = pin.exp3(vector(0.0, 0.0, turn))
    return t


@parametrize(
    "turn, shift, apart",
    [(0.0, 0.0199, False), (0.0, 0.0201, True), (0.066, 0.0, False), (0.067, 0.0, True)],
)
def test_arms_are_apart_where_one_shifts_or_turns_the_object_by_20_mm(turn, shift, apart):
    """A turn by φ moves the grasp point of the other arm, at 0.3 m, by 0.6 m sin(φ/2)."""
    t = two_at_a_rod(turn, shift)
    for _ in range(3):
        holding._compare_places(t, np.full((4, 4), np.nan))
    assert_near(t.memory.apart, 3 * DT if apart else 0.0)


@parametrize("start, speed, found", [(0.0, 0.25, 12), (0.0, 0.05, 301), (0.015, -0.25, 0)])
def test_arms_that_part_are_apart_before_the_gap_is_20_mm(start, speed, found):
    """At 0.25 m/s 3 mm, and 17 mm that follow within 0.1 s; at 0.05 m/s 15 mm and 5 mm."""
    t = two_at_a_rod()
    seen = 0
    for k in range(1, 320 if speed > 0.0 else 60):
        t.work.joints.p[1, 2] = 1e-6 + start + speed * k * DT
        agreement.measure_gap(t, 1, np.eye(4), DT)
        if agreement.is_apart(t, 1):
            seen = k
            break
    assert seen == 0 if found == 0 else abs(seen - found) <= 1


@parametrize("turn, gone", [(0.0, False), (0.1, True)])
def test_an_arm_that_is_apart_from_the_object_has_let_go_below_half_of_its_share(turn, gone):
    """A wrist without a load may read as much as its bias, here 0.45 of the arm's share."""
    t = two_at_a_rod(turn)
    X = np.eye(4)
    t.memory.wrenches[1, :3] = (0.0, 0.0, 0.45 * 9.81)
    for _ in range(60):
        holding._compare_places(t, X)
        holding._weigh(t, 1, np.zeros(3))
    assert t.memory.arms[1].let_go == gone


@parametrize("share, leader, ticks", [(0.55, 0, 21), (0.45, 0, 0), (0.55, -1, 0)])
def test_an_arm_that_bears_a_load_beside_the_object_has_not_let_go(share, leader, ticks):
    """It was marked so when an encoder jumped and braking unloaded it; its gap must be measured."""
    t = two_at_a_rod(shift=0.01)
    write(t.model, leader=leader)
    t.memory.arms.weighed = 1
    t.memory.arms.let_go[1] = 1
    t.memory.wrenches[1, :3] = (0.0, 0.0, share * 9.81)
    t.memory.arms.weighing[1] = t.memory.wrenches[1, :3]
    found = 0
    for tick in range(1, 60):
        holding._compare_places(t, np.eye(4))
        holding._weigh(t, 1, np.zeros(3))
        if not t.memory.arms[1].let_go and not found:
            found = tick
    assert abs(found - ticks) <= 1


@parametrize("turn, period, ticks", [(0.1, 1e-3, 6), (0.1, 1e-2, 2), (0.0, 1e-3, 21)])
def test_an_arm_without_load_has_let_go_after_5_ms_where_it_is_apart(turn, period, ticks):
    """After two readings at least; where encoders agree, after 20 ms."""
    t = two_at_a_rod(turn)
    write(t.model, period=period)
    t.memory.apart = 0.05 if turn else 0.0
    found = 0
    for tick in range(1, 40):
        holding._compare_places(t, np.eye(4))
        holding._weigh(t, 1, np.zeros(3))
        if t.memory.arms[1].let_go and not found:
            found = tick
    assert abs(found - ticks) <= (1 if ticks > 2 else 0)


def test_torques_of_an_arm_that_has_let_go_fall_on_a_line_of_their_own():
    """At `torque_rate`, and neither they nor the others' limit the changes of the other ones."""
    t = records(arms=2, joints=4, period=DT, torque_rate=200.0)
    write(t.model.arms, first=[0, 2], end=[2, 4])
    write(t.model.joints, motor=[0, 1, 2, 3], tau_max=[50.0, 10.0, 50.0, 10.0])
    write(t.memory, torques=[40.0, 1.0, 40.0, 1.0])
    write(t.work, tau=[0.0, 0.0, 0.0, 0.9])
    holding._move_alone(t, t.model.arms[1])
    assert_near(t.work.tau, [0.0, 0.0, 30.0, 0.975])
    assert_near(t.memory.torques, [40.0, 1.0, 30.0, 0.975])


@parametrize(
    "rate, gone, omega",
    [(1e3, 0, 20.0), (1e3, 1, 40.0), (400.0, 1, 40.0), (250.0, 1, 25.0), (100.0, 1, 20.0)],
)
def test_an_arm_that_has_let_go_is_braked_twice_as_fast(rate, gone, omega):
    t = records(arms=2, joints=2, period=1.0 / rate, hold_rate=20.0)
    assert_near(holding._hold_rate(t, bool(gone)), omega)
    t.memory.derived = at.NOISY
    assert_near(holding._hold_rate(t, bool(gone)), 10.0)


@parametrize(
    "first, gap, brakes",
    [(0.005, 0.005, False), (0.0201, 0.0201, True), (0.017, 0.0071, False), (0.017, 0.0069, True)],
)
def test_encoders_are_sound_after_arms_were_only_about_to_be_apart(first, gap, brakes):
    """A short slip of a grasp stops the arms, which still hold the object: no encoder is faulty.

    The gap does not change any more then; if it does, one of them moves unseen.
    """
    t = two_at_a_rod()
    write(t.memory, derived=1, age=99, cause=agreement.APART)
    t.memory.arms.load[:, 2] = 9.81
    t.memory.arms[1].gap = first
    isolation.isolate_arms(t)
    assert not t.memory.joints.faulty.any()
    t.memory.arms[1].gap = gap
    t.memory.age = 5000
    isolation.isolate_arms(t)
    both = at.FAULTY_POSITION | at.FAULTY_SPEED
    assert (t.memory.joints.faulty == (both if brakes else 0)).all()


@parametrize(
    "apart, bears, derived, brakes",
    [
        (0.09, 0.6, at.ESTIMATED, False),
        (0.11, 0.6, at.ESTIMATED, True),
        (0.11, 0.4, at.ESTIMATED, False),
        (0.11, 0.6, at.NOISY, False),
    ],
)
def test_stopped_arms_that_fight_have_no_sound_estimated_speeds(apart, bears, derived, brakes):
    """Both bear a load at an object that encoders place apart, after a stop for another reason.

    Encoders far noisier than expected place arms apart that are not: brakes were requested.
    """
    t = two_at_a_rod(0.1)
    write(t.memory, derived=derived, apart=apart, age=5000, cause=WRIST_FROZEN)
    t.memory.arms.load[:, 2] = (9.81, bears * 9.81)
    isolation.isolate_arms(t)
    both = at.FAULTY_POSITION | at.FAULTY_SPEED
    assert (t.memory.joints.faulty == (both if brakes else 0)).all()
