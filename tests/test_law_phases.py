"""Contact phases of the law: their rules, whatever happens, and the monitor behind them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from law_calls import active_set, records
from law_calls import phases as law
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import assert_near, vector
from samples import aligned, first, parametrize

from osc_contact.law.phases import APPROACHING, CLOSED, OPEN
from osc_contact.settings.control import MonitorLimits, PhaseSettings
from osc_contact.settings.gains import ForceGains

DT = 1e-3
GAINS = ForceGains(30.0, 100.0)


def drawn(count):
    """A test is judged on so many random seeds."""
    how = settings(max_examples=count, deadline=None)
    return lambda test: how(given(st.integers(0, 2**32 - 1))(test))


class Phases:
    """Tables for these contacts, and the stages of a tick that concern them."""

    def __init__(self, owners, pushing, k=None, dt=DT, phase=None):
        k = PhaseSettings() if k is None else k
        owners = np.asarray(owners)
        pushing = np.asarray(pushing, dtype=bool)
        self.owners = owners
        self.n = len(owners)
        values = {
            "period": dt,
            "force_gain": GAINS.integral,
            "force_damping": GAINS.damping,
            "approach_speed": k.speed,
            "approach_damping": k.damping,
            "least_force": k.least,
            "lost_share": k.share,
        }
        names = (*MonitorLimits.model_fields, "travel", "rise", "lag", "return_speed")
        values |= {name: getattr(k, name) for name in names}
        self.tick = records(1, 1, len(pushing), self.n, **values)
        self.chain, self.memory, self.work, _ = self.tick
        self.contacts = self.memory.contacts
        self.columns = self.memory.columns
        self.kept = self.work.here
        self.work.dt = dt
        self.chain.bodies.pushes = pushing
        self.chain.columns.contact = owners
        self.contacts.phase = np.where(pushing, OPEN, CLOSED) if phase is None else phase
        self.contacts.active = self.contacts.phase != OPEN
        self.contacts.since = np.inf
        self.columns.closed = (self.contacts.phase == CLOSED)[owners]

    @property
    def here(self):
        """(n,) which columns are in N."""
        return self.contacts.active[self.owners] != 0

    def begin(self, commanded, judge=True):
        """Start a tick; returns whether N has changed, and the goals."""
        self.work.goal[:] = commanded
        changed = judge and law.advance_phases(self.tick)
        if judge:
            active_set.separate_integrals(self.tick)
        law.set_goals(self.tick)
        return (changed, self.work.goal.copy())

    def end(self, alpha, speed, D=None, independent=False, chosen=None, limited=False):
        """End a tick with what was measured; D (r, r) is of the columns chosen, or all in N."""
        chosen = np.flatnonzero(self.here) if chosen is None else chosen
        D = np.eye(len(chosen)) if D is None else D
        self.work.rank = r = len(chosen)
        self.work.chosen[:r] = chosen
        self.work.mobility[:r, :r] = D
        self.work.here[:] = self.here
        self.columns.alpha = alpha
        self.columns.speed = speed
        self.work.speeds[:] = speed
        for column, here, goal in aligned(self.columns, self.here, self.work.goal):
            if here:
                law.predict_force(self.tick, column, goal, limited, self.chain.period)
            else:
                column.predicted = 0.0
        law.low_pass(self.tick, independent)

    @property
    def sums(self):
        """(r,) the force integrals, of the columns in N where these have changed."""
        if self.memory.by_column:
            return self.columns.integral[self.here].copy()
        return self.memory.force_sum[: self.memory.force_rank].copy()

    @sums.setter
    def sums(self, values):
        """As a tick leaves them, of the first columns in N."""
        kept = np.flatnonzero(self.here)[: len(values)]
        self.memory.force_rank = len(values)
        self.memory.force_sum[: len(values)] = values
        self.columns.integral = 0.0
        self.columns.integral[kept] = values[: len(kept)]
        self.memory.by_column = 0


# --- stories --------------------------------------------------------------------------------------


def steady(phases, alpha, ticks, commanded=10.0):
    for _ in range(ticks):
        phases.begin(np.full(4, commanded))
        phases.end(phases.here * np.array(alpha), np.zeros(4))
    return phases.contacts.phase.tolist()


def test_a_story_approach_contact_loss_and_contact_again():
    # one force, an edge with two, a hinge that never opens
    phases = Phases([0, 1, 1, 2], [True, True, False])
    assert steady(phases, np.zeros(4), 50) == [APPROACHING, APPROACHING, CLOSED]
    half = steady(phases, [2.0, 2.0, 0.0, 0.0], 40)
    assert half == [CLOSED, APPROACHING, CLOSED]  # half an edge is no contact
    assert steady(phases, [9.0, 5.0, 5.0, 0.0], 40) == [CLOSED, CLOSED, CLOSED]
    assert steady(phases, [9.0, 5.0, 0.0, 0.0], 40) == [CLOSED, APPROACHING, CLOSED]
    assert steady(phases, [9.0, 5.0, 0.0, 0.0], 1, commanded=0.0) == [OPEN, OPEN, CLOSED]


@parametrize("wrong", [-200.0, -1000.0])
def test_a_closed_contact_is_not_lost_by_a_single_wrong_reading(wrong):
    """Low-passed, one of -200 N lasted for 20 ms: the face of a free cart was left."""
    phases = Phases([0], [True])

    def pressed(alpha):
        phases.begin(np.array([10.0]))
        phases.end(np.array([alpha]), np.zeros(1))
        return phases.contacts.phase[0]

    assert [pressed(10.0) for _ in range(400)][-1] == CLOSED
    pressed(wrong)
    assert {pressed(10.0) for _ in range(50)} == {CLOSED}
    lost = [pressed(0.0) for _ in range(50)]
    assert lost.index(APPROACHING) < 20  # ms
    assert [pressed(10.0) for _ in range(400)][-1] == CLOSED
    mirrored = [pressed(-10.0) for _ in range(50)]
    assert mirrored.index(APPROACHING) < 20


@parametrize(
    "touch, inertia, phase",
    [
        (2.0, 0.0, APPROACHING),
        (3.9, 0.0, CLOSED),
        (3.3, -0.6, APPROACHING),  # only an inertial force, known with a lag, adds up to 3.9 N
        (3.9, 0.6, APPROACHING),
    ],
)
def test_what_friction_of_closed_contacts_explains_makes_no_contact(touch, inertia, phase):
    phases = Phases([0, 1], [True, True], phase=[CLOSED, APPROACHING])
    for _ in range(60):
        phases.begin(np.array([6.0, 2.0]))
        phases.work.columns.touch = (0.0, touch)
        phases.work.columns.touch_inertia = (0.0, inertia)
        phases.work.columns.explained = (0.0, 3.0)
        phases.end([6.0, touch], np.zeros(2))
    assert phases.contacts.phase.tolist() == [CLOSED, phase]


@parametrize("fastest", [0.02, 0.1, 0.3])
def test_the_way_back_to_a_lost_contact_is_no_faster_than_set(fastest):
    k = PhaseSettings(return_speed=fastest)
    phases = Phases([0], [True], k, phase=[APPROACHING])
    phases.contacts.since = 0.0
    phases.columns.gap = 1.0
    phases.columns.speed = phases.columns.filtered_speed = 1.0
    _, goal = phases.begin(np.array([5.0]), judge=False)
    assert_near(goal, [k.damping * fastest])


def test_an_approach_at_rest_beside_a_closed_contact_pushes_on_where_it_meets_force():
    """By twice what is certain of it, on all columns of a contact; alone it stays gentle."""
    k = PhaseSettings()

    def pushes(explained, noise=0.0, net=5.0, touch=(0.5, 0.4), read=None):
        phases = Phases([0, 1, 1], [True, True], phase=[CLOSED, APPROACHING])
        phases.contacts.since = 0.5  # the force of the closed contact has risen
        phases.columns.net = phases.columns.force = net
        phases.columns.noise = noise
        phases.columns.touch[1:] = touch
        phases.columns.touch_read[1:] = touch if read is None else read
        phases.columns.explained[1:] = explained
        _, goal = phases.begin(np.full(3, 6.0), judge=False)
        assert goal[0] == 6.0
        return goal[1:]

    gentle = 0.5 * k.force_on
    assert_near(pushes(0.1), [gentle + 2.0 * 0.3] * 2)  # of the column that meets less
    assert_near(pushes(0.1, noise=0.2, net=0.4), [gentle + 2.0 * 0.2] * 2)
    assert_near(pushes(0.1, touch=(3.0, 3.0)), [k.push] * 2)  # never more than an approach
    assert_near(pushes(0.1, touch=(3.0, 3.0), read=(0.5, 0.4)), pushes(0.1))
    for alike in (pushes(0.0), pushes(0.45), pushes(0.1, net=-1.0), pushes((0.1, 0.0))):
        assert_near(alike, [gentle] * 2)


def test_torques_go_gently_around_a_change_but_for_fast_joints():
    def rate(since, share=0.0, phased=1):
        t = records(contacts=2, torque_rate=200.0, phase_rate=20.0, phased=phased)
        t.memory.contacts.since = (9.0, since)
        return law.torque_rate(t, share)

    assert rate(0.099) == 20.0 and rate(0.101) == 200.0 and rate(0.0, phased=0) == 200.0
    assert rate(0.0, 0.5) == approx(45.0) and rate(0.101, 0.5) == 200.0
    assert rate(0.0, 0.25) == 20.0 < rate(0.0, 0.26)
    assert rate(0.0, 0.8) == 200.0 == rate(0.0, 1.0) == rate(0.0, 3.0)
    t = records(joints=3)
    t.model.joints.speed_max = (2.0, 0.5, np.inf)
    for v, most in {(1.0, 0.1, 9.0): 0.5, (-1.0, 0.4, 0.0): 0.8, (0.1, -0.4, 0.0): 0.8}.items():
        t.work.joints.v = v
        assert law.max_speed_ratio(t) == approx(most)


def test_torques_go_gently_while_a_contact_is_unloaded_but_not_while_one_is_approached():
    """A slow torque would make an object that sticks and slips swing."""
    t = records(contacts=2, torque_rate=200.0, phase_rate=20.0, phased=1)
    t.memory.contacts.phase = (CLOSED, APPROACHING)
    t.memory.contacts.since = 9.0
    t.memory.chosen_set = 1
    assert law.torque_rate(t, 0.0) == 200.0
    t.memory.contacts[0].unloading = 0.02
    assert law.torque_rate(t, 0.0) == approx(0.45 * 20.0)


def meet(alpha, speed, mass=0.5, k=None, ticks=700):
    """Tick at which an approach is over; 0: never. alpha (N), speed (m/s): a number, or of k."""
    phases = Phases([0], [True], k, phase=[APPROACHING])
    for tick in range(1, ticks):
        values = [x(tick) if callable(x) else x for x in (alpha, speed)]
        phases.end([values[0]], [values[1]], np.eye(1) / mass, independent=True)
        phases.begin([10.0])
        if phases.contacts[0].phase == CLOSED:
            return tick
    return 0


def test_what_flies_on_has_no_contact_for_half_a_second():
    assert meet(2.0, 0.0049) == 3 == meet(2.0, -0.01), "dwell: 2 ms"
    assert 500 < meet(2.0, 0.0051) < 505, "a soft face"
    assert meet(2.0, lambda k: 0.01 if k < 100 else 0.004) == 100
    fast = PhaseSettings(speed=0.02)
    assert meet(2.0, 0.0099, k=fast) == 3 and meet(2.0, 0.0101, k=fast) > 500


def test_speeds_alone_or_wrists_alone_make_no_contact():
    """A speed that drops to 0 in mid-air looks like 10 mm/s · 1 kg / 6 ms = 1.7 N of an impact."""
    stops = lambda k: 0.01 if k < 50 else 0.0  # noqa: E731
    assert meet(0.0, stops, mass=1.0) == 0
    assert meet(lambda k: 0.0 if k < 50 else 2.0, stops, mass=1.0) < 57
    for read, made in ((0.39, 0), (0.41, 1)):  # an impact counts for no more than 1.5 times that
        falls = lambda k: 0.004 - 1e-3 * k  # noqa: E731  1 N for each kg
        assert bool(meet(read, falls, mass=3.0, ticks=30)) == made


def test_a_contact_stands_out_of_the_noise_before_it():
    def noise(k):
        return 0.0 if k == 1 else 3.0 if k % 2 else -3.0

    assert meet(noise, 0.0, ticks=400) == 0
    later = meet(lambda k: noise(k) if k < 200 else 2.0, 0.0)
    clear = meet(lambda k: noise(k) if k < 200 else 5.0, 0.0)
    assert 200 < clear < later < 300, "what it was is forgotten in 50 ms or so"
    phases = Phases([0], [True], phase=[CLOSED])
    for k in range(400):
        phases.end([noise(k)], [0.0], independent=True)
    assert phases.columns[0].noise == approx(3.0, rel=0.1)


def test_a_lost_contact_counts_the_time_until_it_is_held_again():
    phases = Phases([0], [True], phase=[CLOSED])
    commanded = [10.0]
    seen = []
    for alpha, count in ((10.0, 100), (0.0, 300), (10.0, 30), (0.0, 100), (10.0, 100)):
        for _ in range(count):
            phases.end([alpha], [0.0], independent=True)
            phases.begin(commanded)
            seen.append(phases.columns[0].time_since_loss)
    seen = np.array(seen)
    first = np.flatnonzero(seen)[0]
    assert 100 < first < 200 and (seen[: first - 1] == 0.0).all()
    steady = seen[first:500]  # 30 ms of contact are not held: `rise` is 50 ms
    assert_near(steady, DT * np.arange(1, len(steady) + 1), atol=1e-9)
    assert seen[-1] == 0.0
    start = Phases([0], [True], phase=[OPEN])
    for _ in range(200):
        start.begin(commanded)
        start.end([0.0], [0.0], independent=True)
    assert start.columns[0].time_since_loss == 0.0, "it was never there"


@parametrize("face", [False, True])
def test_a_face_that_rests_on_one_corner_stays_closed(face):
    """And is made after half a second on it; it is lost where no corner bears anything."""
    phases = Phases([0, 0, 0, 1], [True] * 2, phase=[CLOSED] * 2)
    phases.chain.bodies.face = [face, False]
    seen = []
    for force, ticks in (([10.0, 10, 10, 10], 100), ([30.0, -5, 0, 0], 400)):
        for _ in range(ticks):
            phases.end(force, np.zeros(4), independent=True)
            phases.begin([10.0] * 4)
            seen.append(phases.contacts.phase.copy())
    seen = np.array(seen)
    assert (seen[:100] == CLOSED).all() and (seen[150:, 1] == APPROACHING).all()
    assert (seen[150:, 0] == (CLOSED if face else APPROACHING)).all()
    for _ in range(100):
        phases.end([0.0, -5, 0, 0], np.zeros(4), independent=True)
        phases.begin([10.0] * 4)
    assert phases.contacts.phase[0] == APPROACHING
    made = []
    for _ in range(700):
        phases.end([20.0, -1, 0, 0], np.zeros(4), independent=True)
        phases.begin([10.0] * 4)
        made.append(phases.contacts.phase[0] == CLOSED)
    assert not any(made[:490]) and all(made[540:]) == any(made) == face


@parametrize("total, rests", [(0.41, True), (0.39, False)])
def test_a_face_rests_on_some_corners_by_a_share_of_its_whole_force(total, rests):
    """A wrist that read zero left the weight of a pad, on which a face rested at 0.25 of it."""
    phases = Phases([0, 0], [True], phase=[CLOSED])
    phases.chain.bodies.face = [True]
    approach = phases.chain.approach_damping * phases.chain.approach_speed
    least = phases.chain.force_off
    for _ in range(300):
        phases.end([10.0, 10.0], np.zeros(2), independent=True)
        phases.begin([10.0, 10.0])
    phases.columns.predicted = 10.0
    force = least + total * 2.0 * (10.0 - approach)
    for _ in range(100):
        phases.end([force + 1.0, -1.0], np.zeros(2), independent=True)
        phases.begin([10.0, 10.0])
    assert (phases.contacts.phase[0] == CLOSED) == rests


@drawn(50)
def test_torques_go_straight_and_not_too_far(seed):
    rng = default_rng(seed)
    tau, last = rng.standard_normal((2, 8)) * 10
    step = rng.uniform(0.1, 5, 8)
    for begun in (False, True):
        out = tau.copy()
        given = last.copy()
        law.slew(out, given, step, begun)
        share = min(1.0, (step / np.abs(tau - last)).min()) if begun else 1.0
        assert_near(out, last + share * (tau - last), atol=1e-12, rtol=0)
        assert_array_equal(given, out)


#: three columns of two closed contacts that share two integrals; a third contact is open
SHARED = ([0, 0, 1, 2], [CLOSED, APPROACHING, OPEN], [1.5, -2.5])


@parametrize(
    "owners, phase, sums, commanded, after",
    [
        # contact 1 leaves, 0 comes in front and behind
        ([0, 1, 2, 2, 0], [OPEN, CLOSED, CLOSED], [1, 2, 3], [5, 0, 5, 5, 5], [0, 2, 3, 0]),
        # those that are not one for each column are left until a contact comes or goes
        *[([0, 1], [CLOSED] * 2, [7] * rank, [5, 5], [7] * rank) for rank in (0, 1, 3)],
        *[([0, 1], [CLOSED] * 2, [7] * rank, [5, 0], [7] * min(rank, 1)) for rank in (1, 3)],
        (*SHARED, [5, 5, 5, 0], [1.5, -2.5]),
        (*SHARED, [5, 5, 0, 0], [1.5, -2.5]),
        (*SHARED, [5, 5, 5, 5], [1.5, -2.5, 0, 0]),
        # more columns than are independent
        *[(range(n), [OPEN] * n, [], [5] * n, [0] * n) for n in (7, 9)],
        (range(8), [CLOSED] * 8, range(1, 7), [5, 0, *[5] * 6], [1, 3, 4, 5, 6, 0, 0]),
    ],
)
def test_force_integrals_follow_their_columns(owners, phase, sums, commanded, after):
    phases = Phases(owners, [True] * len(phase), phase=phase)
    phases.sums = np.array(sums, dtype=float)
    phases.begin(np.array(commanded, dtype=float))
    assert phases.sums.tolist() == after


def test_the_integral_of_a_contact_that_was_lost_starts_anew():
    """It is approached again, and stays in N."""
    phases = Phases([0, 1], [True] * 2, phase=[CLOSED, CLOSED])
    phases.columns.closed[0] = 0
    phases.sums = np.array([7.0, 8.0])
    phases.begin([5.0, 5.0])
    assert phases.sums.tolist() == [0.0, 8.0]


def test_contacts_that_come_back_as_closed_start_without_integrals():
    """Taken out of N from outside, `active` set to 0, they keep their phases."""
    phases = Phases([0, 1], [True] * 2, phase=[CLOSED, CLOSED])
    phases.sums = np.array([7.0, 7.0])
    phases.contacts.active = 0
    assert phases.begin([5.0, 5.0])[0]
    assert phases.sums.tolist() == [0.0, 0.0] and phases.kept.all()


# --- the monitor and the low-pass ----------------------------------------------------------------


def watched(state, alpha, speed, dt, limits, more):
    """The monitor's memory of one contact, one tick later."""
    closed, low_for, high_for, burst, armed_for, _ = state
    away = speed < -limits.leaving
    low_for = low_for + dt if away or alpha < limits.force_off + more else 0.0
    high_for = high_for + dt if not away and alpha > limits.force_on else 0.0
    armed_for = max(armed_for - dt, 0.0) if closed else limits.window
    closed = (closed or high_for > limits.dwell) and not (closed and low_for > limits.patience)
    burst = max(burst, abs(alpha * speed)) if closed or high_for > 0.0 else 0.0
    collision = closed and armed_for > 0.0 and burst > limits.power
    return (closed, low_for, high_for, burst, 0.0 if collision else armed_for, collision)


def random_contacts(rng):
    """Owners, which can only push, settings, period: up to 6 columns of up to 4 contacts."""
    count = rng.integers(1, 5)
    owners = np.sort(np.append(np.arange(count), rng.integers(0, count, 6 - count)))
    if rng.random() < 0.3:
        rng.shuffle(owners)
    off = rng.uniform(0.1, 0.5)
    k = PhaseSettings(
        force_on=off + rng.uniform(0.1, 0.6),
        force_off=off,
        power=10 ** rng.uniform(-3, -1),
        patience=rng.choice([0.0, 5e-3, 1e-2]),
        window=rng.choice([0.0, 0.02]),
        dwell=rng.choice([0.0, 2e-3]),
        leaving=rng.choice([0.03, np.inf]),
        speed=rng.uniform(0.01, 0.02),
        travel=rng.uniform(2e-4, 2e-3),
        rise=rng.uniform(0.01, 0.1),
        share=rng.uniform(0.05, 0.4),
        lag=rng.uniform(1e-4, 1e-2),
    )
    return (owners, rng.random(count) < 0.75, k, rng.choice([1e-3, 5e-4]))


def random_ticks(rng, n, ticks):
    """Commands, magnitudes (N) and speeds (m/s) that stay near one level for some ticks each."""
    out = np.zeros((3, ticks, n))
    levels = (
        [0.0, 0.25, 0.5, 5.0, 12.0, -3.0],
        [0.0, 0.4, 1.0, 4.0, 9.0, 20.0],
        [0.0, 0.01, -0.04],
    )
    weights = ([0.15, 0.1, 0.1, 0.3, 0.3, 0.05], [0.2, 0.1, 0.1, 0.2, 0.3, 0.1], [0.6, 0.3, 0.1])
    for values, level, weight, long in aligned(out, levels, weights, (150, 60, 40)):
        for j in range(n):
            k = 0
            while k < ticks:
                end = k + rng.integers(1, long)
                values[k:end, j] = rng.choice(level, p=weight)
                k = end
        if rng.random() < 0.5:  # all alike: contacts with several columns are made as one
            values[:] = values[:, :1]
    out[1:] += vector(0.05, 3e-4)[:, None, None] * rng.standard_normal((2, ticks, n))
    return out


def assert_rules(phases, before, goal, commanded, pushing, k):
    """Check invariants after a tick: phases `before` it, and goals."""
    rows = phases.contacts
    columns = phases.columns
    assert_array_equal(rows.active, rows.phase != OPEN)
    for c, (was, now) in enumerate(aligned(before, rows.phase)):
        mine = c == phases.owners
        assert was == now or rows[c].since == 0.0
        if not pushing[c]:
            assert now == CLOSED
            # what cannot open gets what is commanded
            assert_array_equal(goal[mine], commanded[mine])
        elif not (commanded[mine] > 0.0).any():
            assert now == OPEN
        else:
            assert now == APPROACHING if was == OPEN else now != OPEN  # never at once from free
        if was == APPROACHING and now == CLOSED and pushing[c]:
            heavy = mine & (commanded > k.force_on)
            assert (columns.closed[heavy] != 0).all()  # several are one contact


def run_story(seed):
    """A random story; returns the transitions that happened."""
    rng = default_rng(seed)
    owners, pushing, k, dt = random_contacts(rng)
    n = len(owners)
    closed = rng.random() < 0.5
    phases = Phases(owners, pushing, k, dt, np.where(closed | ~pushing, CLOSED, OPEN))
    happened = set()
    held = False
    ticked = False
    loud = np.zeros(n)  # ticks in a row in which the force was above force_on, counted here
    felt = np.zeros(n, dtype=bool)  # whether these ever lasted, since the contact was opened
    for commanded, alpha, speed in np.swapaxes(random_ticks(rng, n, 400), 0, 1):
        before = phases.contacts.phase.copy()
        was_here = phases.contacts.active.copy()
        loud = np.where(phases.here & (phases.columns.net > k.force_on), loud + 1, 0)
        felt = phases.here & (felt | (loud * dt > k.dwell))
        judge = ticked and not held
        changed, goal = phases.begin(commanded, judge=judge)
        now = phases.contacts.phase
        happened |= set(aligned(before[pushing].tolist(), now[pushing].tolist()))
        happened |= {"collision"} if phases.columns.collision.any() else set()
        assert changed == ((now != OPEN) != (was_here != 0)).any() and np.isfinite(goal).all()
        if judge:
            assert_rules(phases, before, goal, commanded, pushing, k)
            made = pushing & (before == APPROACHING) & (now == CLOSED)
            assert all(felt[owners == c].any() for c in np.flatnonzero(made))
            assert_array_equal(phases.kept, (before[owners] != OPEN) & (before <= now)[owners])
        held = rng.random() < 0.03
        ticked = True
        here = phases.here
        seen = (phases.columns.closed != 0) | (phases.columns.collision != 0)
        assert not judge or not seen[was_here[owners] == 0].any()  # nothing is felt of these
        if held:
            continue
        count = np.count_nonzero(here)
        A = rng.standard_normal((count, count))
        D = 0.3 * A @ A.T + np.eye(count) + 0.2 * rng.standard_normal((count, count))
        independent = rng.random() < 0.95 or count < 2
        phases.end(alpha * here, speed * here, D, independent, limited=rng.random() < 0.05)
        rank = rng.integers(0, 7) if rng.random() < 0.05 else count
        phases.sums = rng.standard_normal(rank)
    return happened


@parametrize("phase", [OPEN, APPROACHING, CLOSED])
def test_columns_of_a_contact_begin_without_a_past(phase):
    """They count as closed if it begins closed; those of other contacts keep theirs."""
    phases = Phases([0, 1, 1], [True, True])
    times = ("low_for", "high_for", "underforce", "overforce")
    for name in (*times, "collision", "closed"):
        setattr(phases.columns, name, [1, 1, 1])
    phases.work.here[:3] = 1.0
    active_set._begin_columns(phases.tick, 1, phase)
    for name in (*times, "collision"):
        assert phases.columns[name].tolist() == [1, 0, 0]
    assert phases.columns.closed.tolist() == [1, *[phase == CLOSED] * 2]
    assert phases.work.here[:3].tolist() == [1.0, 0.0, 0.0]


@parametrize("seeds", first([range(10), range(10, 24)], 1))
def test_whatever_happens_the_phases_keep_their_rules(seeds):
    """Random stories, with held ticks, dependent columns and integrals of other ranks.

    They make every transition but from open to closed.
    """
    every = {(a, b) for a in range(3) for b in range(3)} - {(OPEN, CLOSED)} | {"collision"}
    happened = set()
    for seed in seeds:
        happened |= run_story(seed)
    assert happened == every


@drawn(40)
def test_one_magnitude_is_judged_by_its_rules(seed):
    rng = default_rng(seed)
    limits = random_contacts(rng)[2]
    if rng.random() < 0.2:
        limits = limits.replaced(patience=0.0, leaving=1e-12)
    phases = Phases(range(4), [True] * 4, limits)
    rows = phases.columns
    rows.closed = rng.integers(0, 2, 4)
    states = [(bool(closed), 0.0, 0.0, 0.0, 0.0, False) for closed in rows.closed]
    names = ("closed", "low_for", "high_for", "burst", "armed_for", "collision")
    _, alphas, speeds = random_ticks(rng, 4, 150)
    for alpha, speed in aligned(alphas, speeds):
        more = np.where(rng.random(4) < 0.3, rng.uniform(0, 5, 4), 0.0)
        given = aligned(states, alpha, speed, more)
        states = [watched(one, a, v, DT, limits, extra) for one, a, v, extra in given]
        for j in range(4):
            law.monitor(phases.chain, rows[j], alpha[j], speed[j], DT, limits.dwell, more[j])
        for row, state in aligned(rows, states):
            assert tuple(row[name] for name in names) == state


@drawn(40)
def test_measurements_are_low_passed_and_freed_of_inertia(seed):
    """α − D⁻¹ d(NᵀV)/dt, each by the same low-pass of first order; pulls count as noise.

    Those of closed columns count as the opposite of the expected force at most.
    """
    rng = default_rng(seed)
    n = rng.integers(1, 7)
    lag = rng.choice([1e-9, 1e-3, 1e-2])
    phases = Phases(np.arange(n), [True] * n, PhaseSettings(lag=lag))
    known = np.zeros(n, bool)
    share = DT / (lag + DT)
    force, filtered, noise, expected_force = np.zeros((4, n))
    for _ in range(60):
        phases.contacts.active = rng.random(n) < 0.8
        here = phases.here
        alpha, speed = here * rng.standard_normal((2, n)) * np.array([[9.0], [0.02]])
        chosen = rng.permutation(np.flatnonzero(here))
        count = len(chosen)
        inertia = np.zeros((n, n))
        D = rng.standard_normal((count, count)) * 0.2 + np.eye(count)
        independent = rng.random() < 0.8
        if singular := count > 1 and rng.random() < 0.2:
            D[:] = 1.0  # counts for nothing
        elif independent:
            inertia[np.ix_(chosen, chosen)] = np.linalg.inv(D)
        closed = phases.columns.closed = rng.random(n) < 0.5
        phases.work.goal[:] = goal = rng.uniform(-6.0, 12.0, n)
        lagging = expected_force + DT / (PhaseSettings().rise + DT) * (goal - expected_force)
        expected_force = here * np.minimum(goal, lagging)
        force = np.where(known, force, alpha)
        read = np.where(closed, np.maximum(alpha, -np.abs(expected_force)), alpha)
        force = force + share * (read - force)
        change = np.where(known, share * (speed - filtered), 0.0)
        filtered = np.where(known, filtered + change, speed)
        flying = inertia @ change / DT
        pulls = here * np.maximum(flying - alpha, 0.0)
        noise = noise + (2.0 * pulls - noise) / (1.0 + 0.05 / DT)
        known = here
        phases.end(alpha, speed, D, independent, chosen)
        size = 1e-12 * (np.linalg.cond(D) if count and not singular else 1.0)
        for name, expected in {
            "force": force,
            "filtered_speed": filtered,
            "known": known,
            "noise": noise,
            "alpha": alpha,
            "speed": speed,
            "net": here * (force - flying),
        }.items():
            assert_near(phases.columns[name], expected, atol=size, rtol=1e-12, name=name)
