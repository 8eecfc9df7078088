"""Steps of desired forces and the brake, on the law's own functions: α_s against its quintic."""

import numpy as np
from law_calls import commands, records, write
from pytest import approx
from rigs import assert_near
from samples import parametrize
from scipy.interpolate import BPoly

from osc_contact.law import records as at
from osc_contact.law.phases import APPROACHING, CLOSED

DT = 1e-3
RISE = 0.05


def eased(x):
    """The share of a step that is still to come: least jerk, from 1 to 0, at rest at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return 1.0 - 10.0 * x**3 + 15.0 * x**4 - 6.0 * x**5


def low_pass(x, share):
    return np.convolve(x, share * (1.0 - share) ** np.arange(len(x)))[: len(x)]


def before(x):
    return np.r_[0.0, x[:-1]]


def soft_brake(V, V_face, alpha, alpha_s, scale, kappa, K_i, w):
    """b and s of docs/tuning.md#soft-faces, as convolutions over all ticks; s₀ = 0.4 mm/N."""
    yielded = low_pass(V, w * DT) / w
    change = alpha_s - low_pass(alpha_s, w * DT)
    force_change = alpha - low_pass(alpha, w * DT)
    recalled = DT / 2.0
    correlation = before(2.0 * low_pass(change * yielded, recalled))
    excitation = before(2.0 * low_pass(change * force_change, recalled))
    weight = 0.002 * np.r_[scale[:1], scale[:-1]] ** 2
    s = np.clip((correlation + 4e-4 * weight) / (np.maximum(excitation, 0.0) + weight), 0.0, 8e-3)
    rate = np.diff(alpha_s, prepend=alpha_s[0]) / DT
    face = before(low_pass(V_face, w * DT))
    driven = face - w * s * (alpha - before(low_pass(alpha, w * DT))) if V_face.any() else 0.0 * V
    u = V - driven - s * rate
    acceleration = (rate - before(low_pass(rate, DT / (0.01 + DT)))) / 0.01
    deflection = before(low_pass(u, w * DT)) / w
    return (kappa * (u + (K_i - w) * deflection) - s * acceleration, s)


class Forces:
    """Columns of N, one contact each, in the order `chosen`; ticks from tick 1 on."""

    def __init__(self, n=1, chosen=None, **more):
        self.chosen = list(range(n)) if chosen is None else chosen
        given = {"period": DT, "step_time": RISE, "drift_share": 0.25, "rise": RISE}
        given |= {"approach_damping": 200.0, "approach_speed": 0.01, "phased": 1}
        self.t = t = records(contacts=n, columns=n, **given | more)
        t.model.columns.contact = range(n)
        t.model.bodies.pushes = 1
        t.memory.contacts.phase = CLOSED
        write(t.memory, step_time=RISE, ticked=1)
        write(t.work, dt=DT, step_time=RISE, status=at.OK)
        t.work.columns.shaped = 1
        self.kept = t.memory.columns
        self.work = t.work

    def tick(self, goal, measured=0.0, speed=0.0):
        """α_s of the columns in N."""
        t = self.t
        t.work.count = len(self.chosen)
        t.work.chosen[: t.work.count] = self.chosen
        t.work.goal[:] = goal
        t.work.alpha[:] = measured
        commands.shape_steps(t, False)
        t.work.here[:] = np.isin(range(len(t.work.here)), self.chosen)
        t.work.speeds[:] = speed
        commands.brake_contacts(t)
        commands.keep_steps(t)
        return t.work.columns.goal[self.chosen]

    def run(self, goal, ticks):
        return np.array([self.tick(goal) for _ in range(ticks)])


class Squeeze:
    """Internal forces of two arms, or of more; ticks from tick 1 on."""

    def __init__(self, arms=2, ticked=1, **more):
        self.t = t = records(arms=arms, **{"period": DT, "step_time": RISE} | more)
        write(t.memory, ticked=ticked)
        write(t.work, dt=DT, status=at.OK)
        self.two = arms == 2
        self.kept = t.memory.internal
        self.work = t.work

    def tick(self, desired, commanded=True):
        """What is commanded between each two grasps."""
        t = self.t
        t.work.commanded = self.two or commanded
        t.memory.squeeze[:] = desired
        commands.shape_steps(t, False)
        commands.shape_squeeze(t)
        commands.keep_steps(t)
        t.memory.ticked += 1
        return t.work.internal.goal.copy()

    def run(self, desired, ticks):
        return np.array([self.tick(desired) for _ in range(ticks)])


def pressed():
    """A column that has had 10 N for long."""
    forces = Forces()
    forces.run([10.0], 200)
    return forces


def squeezed():
    """Two arms that have squeezed with 10 N for long."""
    forces = Squeeze()
    forces.run([10.0], 200)
    return forces


def test_a_step_is_let_in_along_the_quintic_of_least_jerk():
    forces = Forces(2)
    forces.run([10.0, 4.0], 200)
    found = forces.run([16.0, 3.0], 80)
    share = eased(np.arange(80) * DT / RISE)
    assert_near(found[:, 0], 16.0 - 6.0 * share, atol=1e-9)
    assert_near(found[:, 1], 3.0 + 1.0 * share, atol=1e-9)
    assert forces.work.step_left == 0.0 and (found[-1] == [16.0, 3.0]).all()


@parametrize("begin", [pressed, squeezed])
@parametrize("rises", [(RISE, RISE), (RISE, 0.08)])
def test_a_second_step_continues_value_slope_and_curvature(rises, begin):
    """Of either rise time: the path is a polynomial of degree 5 from there, at rest in its end."""
    forces = begin()
    forces.run([16.0], 21)
    forces.t.model.step_time = rises[1]
    found = forces.run([8.0], 100)[:, 0]
    T = rises[1]
    x = 21 * DT / RISE
    first = np.polynomial.Polynomial([1.0, 0.0, 0.0, -10.0, 15.0, -6.0])
    value = 16.0 - 6.0 * first(x)
    slope, bend = (-6.0 * first.deriv(k)(x) / RISE**k for k in (1, 2))
    path = BPoly.from_derivatives([0.0, T], [[value - 8.0, slope, bend], [0.0, 0.0, 0.0]])
    t = np.arange(100) * DT
    assert_near(found, 8.0 + np.where(t < T, path(t), 0.0), atol=1e-7)
    assert found.max() > value, "it continues upwards at first"


@parametrize("begin", [pressed, squeezed])
@parametrize("rate", [0.99, 1.01])
@parametrize("sign", [1.0, -1.0])
def test_only_what_changes_faster_than_its_size_is_a_step(rate, sign, begin):
    """20 times its size a second: 0.2 N in a tick for 10 N."""
    forces = begin()
    change = sign * rate * 20.0 * DT * 10.0
    size = max(10.0 + change, 10.0 * (1.0 - 0.5 * DT))  # of the new command, or what is remembered
    commanded = 10.0 + change
    stepped = abs(change) > 20.0 * DT * size
    assert forces.tick([commanded])[0] == approx(10.0 if stepped else commanded)
    left = forces.work.step_left + forces.work.squeeze_left
    assert left == (1.0 if stepped else 0.0)


def test_a_step_of_internal_forces_is_let_in_along_the_same_quintic():
    """Of three bars; contact forces have a clock of their own, and their integral does not rest."""
    forces = Squeeze(arms=3)
    forces.run([10.0, 4.0, 0.0], 200)
    found = forces.run([16.0, 3.0, 5.0], 80)
    share = eased(np.arange(80) * DT / RISE)[:, None]
    assert_near(found, [16.0, 3.0, 5.0] - [6.0, -1.0, 5.0] * share, atol=1e-9)
    assert (found[-1] == [16.0, 3.0, 5.0]).all() and forces.work.squeeze_left == 0.0
    assert forces.work.step_left == 0.0 and forces.work.integral_scale == 1.0


def test_internal_forces_begin_as_they_are_desired():
    """In the first tick of all: an object that grasps carry by friction does not fall."""
    assert (Squeeze(ticked=0).run([10.0], 5) == 10.0).all()
    assert Squeeze(ticked=1).tick([10.0])[0] == approx(0.0)


def test_three_arms_release_within_the_rise_time_before_their_effort_is_the_least():
    forces = Squeeze(arms=3)
    forces.run([10.0, 4.0, 2.0], 200)
    found = []
    for _ in range(60):
        found.append(forces.tick(0.0, commanded=False))
        if not forces.work.commanded:
            break
    assert len(found) == round(RISE / DT) + 1
    share = eased(np.arange(len(found)) * DT / RISE)[:, None]
    assert_near(found, [10.0, 4.0, 2.0] * share, atol=1e-9)


def test_the_size_of_a_force_that_has_gone_fades():
    """Half of it a second: after 1 s of no force, 0.6 of it are left, and are what a step is."""
    forces = pressed()
    forces.run([0.0], 1000)
    left = 10.0 * (1.0 - 0.5 * DT) ** 1000
    assert forces.kept[0].scale == approx(left, rel=1e-9)
    assert forces.tick([0.99 * 20.0 * DT * left])[0] == approx(0.99 * 20.0 * DT * left)
    assert forces.tick([2.1 * 20.0 * DT * left])[0] == approx(0.99 * 20.0 * DT * left)


def test_the_integral_rests_while_much_of_a_step_is_to_come():
    """A tenth of the size, or more: not at all; nothing: fully."""
    forces = pressed()
    assert forces.work.integral_scale == 1.0
    idle = Forces()
    idle.run([0.0], 3)
    assert idle.work.integral_scale == 1.0, "nothing was ever commanded"
    for left in eased(np.arange(60) * DT / RISE):
        forces.tick([14.0])
        expected = max(1.0 - 4.0 * left / 14.0 / 0.1, 0.0)
        assert forces.work.integral_scale == approx(expected, abs=1e-9)
    assert forces.work.integral_scale == 1.0


def test_a_contact_that_is_new_starts_from_what_is_measured_or_from_none():
    for ticked, start in ((1, 3.0), (0, 0.0)):
        forces = Forces()
        forces.t.memory.ticked = ticked
        assert forces.tick([10.0], measured=[3.0])[0] == approx(start)
        assert forces.run([10.0], 60)[-1, 0] == approx(10.0)


@parametrize("share, phase", [(0.29, CLOSED), (0.31, CLOSED), (-0.5, CLOSED), (0.31, APPROACHING)])
def test_a_face_shows_its_tilt_where_it_carries_three_tenths_of_its_force(share, phase):
    forces = pressed()
    forces.t.memory.contacts.phase = phase
    turned = [0.02, -0.01, 0.03]
    write(forces.work.columns[0], turned=turned, slides=1.0)
    forces.tick([10.0], measured=[10.0 * share], speed=[0.04])
    presses = share > 0.3 and phase == CLOSED
    assert_near(forces.kept[0].turn, turned if presses else 0.0)
    assert forces.kept[0].drift == approx(0.0 if presses else 0.01), "sliding or leaving"


def test_an_impact_is_not_held_where_phases_close_a_contact():
    """The force measured at the impact may be many times the desired one."""
    for phased, start in ((1, 2.0), (0, 40.0)):
        forces = Forces(phased=phased)
        assert forces.tick([2.0], measured=[40.0])[0] == approx(start)
        found = forces.run([10.0], 60)
        assert (found.max() > 11.0) == (phased == 0)
        assert found[-1, 0] == approx(10.0)
    forces = Forces()
    assert forces.tick([-2.0], measured=[-40.0])[0] == approx(-40.0), "it may be pulled"
    for pushes, start in ((1, 0.0), (0, -40.0)):
        forces = Forces()
        forces.t.model.bodies.pushes[0] = pushes
        assert forces.tick([2.0], measured=[-40.0])[0] == approx(start), "noise is no pull"


def test_an_approach_has_its_goal_at_once_and_the_others_their_own_steps():
    """In another order, too, and with a column out of N."""
    forces = Forces(3, chosen=[2, 0])
    forces.t.memory.contacts.phase[2] = APPROACHING
    forces.run([10.0, 7.0, 2.0], 200)
    found = forces.run([12.0, 9.0, 4.0], 60)
    assert_near(found[:, 0], 4.0)
    assert_near(found[:, 1], 12.0 - 2.0 * eased(np.arange(60) * DT / RISE), atol=1e-9)
    assert forces.kept.has_desired.tolist() == [1, 0, 0]
    assert forces.kept[1].scale == 0.0 and forces.kept[0].desired == 12.0
    assert forces.kept[2].desired == 4.0 == forces.kept[2].scale


def test_without_a_rise_time_forces_are_as_they_are_wanted():
    forces = Forces(step_time=0.0)
    inner = Squeeze(step_time=0.0)
    for goal in (10.0, -4.0, 60.0):
        assert forces.tick([goal])[0] == goal == inner.tick([goal])[0]
        assert forces.work.integral_scale == 1.0 and forces.work.step_left == 0.0
        assert forces.kept[0].scale == 0.0, "without steps nothing corrects a declared compliance"
    forces = pressed()
    forces.run([16.0], 60)
    assert forces.kept[0].to_come.all(), "a step was made"
    forces.t.model.step_time = 0.0
    forces.tick([16.0])
    assert not forces.kept[0].to_come.any()


def test_a_column_out_of_n_is_forgotten():
    forces = pressed()
    forces.tick([10.0], speed=[0.1])
    forces.run([16.0], 10)
    row = forces.kept[0]
    assert row.predicted > 0.0 and row.to_come.any() and row.drift > 0.0
    forces.chosen = []
    forces.tick([16.0])
    assert not any((row.has_desired, row.desired, row.scale, row.drift, row.predicted))
    assert not row.to_come.any()


def test_the_brake_leaves_out_the_speed_that_lasts():
    """v̄ follows NᵀV_rel by a share of a quarter each tick, and not while a step is made."""
    forces = pressed()
    drift = 0.0
    for speed in (0.02, 0.02, -0.01):
        forces.tick([10.0], speed=[speed])
        drift += 0.25 * (speed - drift)
        assert forces.kept[0].drift == approx(drift)
    forces.tick([20.0], speed=[5.0])
    assert forces.kept[0].drift == approx(drift), "the integral rests, and so does v̄"
    t = records(columns=3, contacts=1)
    t.model.bodies.pushes = 1
    t.memory.columns.drift = [0.5, 0.0, drift]
    write(t.work, rank=2, kept=[0, 2], speed=[0.3, 0.7], brake=[20.0, 10.0])
    commands.brake_contacts(t)
    assert_near(t.work.brake[:2], [20.0 * (0.3 - 0.5), 10.0 * (0.7 - drift)])


@parametrize("measured", [True, False], ids=["measured", "not measured"])
def test_the_brake_of_a_soft_face_is_that_of_the_tuning_page(measured):
    forces = Forces(drift_share=0.02, force_gain=30.0)
    forces.t.model.bodies.kind = at.YIELDING
    forces.t.model.bodies.parameters[:, 0] = 4e-4
    rng = np.random.default_rng(7)
    seen = []
    for k in range(300):
        V, face, noise = rng.standard_normal(3)
        V = 1e-3 * V + 0.06 * np.cos(0.1 * k)
        face *= 1e-2 * measured
        alpha = forces.work.columns[0].goal + noise
        write(forces.work, rank=1, speed=[V - face], V_N=[face], alpha_meas=[alpha], brake=[200.0])
        goal = forces.tick([10.0 + np.sin(0.1 * k)])[0]
        seen.append((V, face, alpha, goal, forces.kept[0].scale, forces.work.brake[0]))
    *series, brake = np.transpose(seen)
    assert_near(brake, soft_brake(*series, 200.0, 30.0, 20.0)[0], rtol=1e-6)
