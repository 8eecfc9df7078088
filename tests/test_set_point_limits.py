"""Set points never raise for a finite goal and keep their limits, where ruckig finds none too."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from pytest import approx, mark

import osc_contact as osc
from osc_contact import jerk_limits
from osc_contact.errors import SolverError
from osc_contact.jerk_limits import Trajectory, follow, from_rest_to_rest
from osc_contact.scenarios.signals import jerk_limited

SIZES = st.floats(-3.0, 3.0).map(lambda x: 10.0**x)
SHARES = st.sampled_from([0.0, 1.0, -1.0]) | st.floats(-1.0, 1.0)
ROUND = 1e-9


def critical(v, a, j):
    """Distances at which the shape of the way changes, and others."""
    return [
        2 * a**3 / j**2,
        v * v / a + v * a / j,
        2 * v * (v / j) ** 0.5,
        v * v / (2 * a),
        1e-12,
        1.0,
        1e6,
        1e300,
    ]


@st.composite
def motions(draw):
    """Limits, start, and goals with the number of steps for which each is followed."""
    n = draw(st.integers(1, 3))
    limits = tuple(draw(SIZES) for _ in range(3))
    ways = st.sampled_from(critical(*limits))
    jumps = st.tuples(
        st.lists(st.tuples(ways, SHARES), min_size=n, max_size=n),
        st.integers(0, 12),
        st.floats(1e-3, 0.3),
    )
    return n, limits, draw(st.lists(jumps, min_size=1, max_size=5))


@settings(max_examples=300, deadline=None)
@given(motions())
def test_no_finite_goal_raises_and_limits_are_kept(motion):
    n, (v, a, j), jumps = motion
    bounds = osc.JerkLimits(v, a, j).each(n)
    unit = max(v / a, a / j)  # s
    trajectory = Trajectory.rest(np.zeros(n), bounds)
    goal = np.zeros(n)
    for ways, steps, step in jumps:
        x = trajectory.state[0]
        goal = np.array([here + way * share for here, (way, share) in zip(x, ways, strict=True)])
        before = trajectory.state
        trajectory = Trajectory(*before, goal, bounds)
        assert_same(trajectory.state, before, goal, (v, a, j))
        for _ in range(steps):
            trajectory.advance(step * unit)
            x, x_dot, x_ddot = trajectory.state
            assert np.isfinite(x).all()
            assert (np.abs(x_dot) <= v * (1 + ROUND)).all()
            assert (np.abs(x_ddot) <= a * (1 + ROUND)).all()
            before = trajectory.state
    trajectory.advance(2.0 * trajectory.remaining)  # whatever its rounding
    assert_array_equal(trajectory.state[0], goal)


def assert_same(state, before, goal, limits):
    """No jump, but for one that ends a way of no length."""
    v, a, j = limits
    for found, was, size in zip(state, before, (v * v / a + a**3 / j**2, v, a), strict=True):
        assert (np.abs(found - was) <= 1e-6 * size + 1e-12 * np.abs(goal).max()).all()


@mark.parametrize("start", [0.0, 0.3, -1.1])
@mark.parametrize("axis", [0, 1, 2])
def test_the_goal_where_the_cases_of_ruckig_meet(start, axis):
    """5 mm ahead, at rest, v = 0.2, a = 1, j = 20: 2a³/j²."""
    linear = osc.JerkLimits(0.2, 1.0, 20.0)
    angular = osc.JerkLimits(1.0, 8.0, 150.0)
    X = pin.SE3(np.eye(3), np.full(3, start))
    ahead = pin.SE3(np.eye(3), X.translation + 0.005 * np.eye(3)[axis])
    point = osc.PoseSetPoint(X, linear, angular, 1e-3)
    point.step(ahead)
    assert point.remaining == approx(0.2 - 1e-3, abs=1e-9)  # 4 a/j
    while point.remaining > 0.0:
        last = point.step()
    assert last.X_WD.isApprox(ahead, 0.0)


@mark.parametrize("value", [0.005, 5.0, 1e-7, -0.3])
def test_a_scenario_s_signal_is_where_they_meet_too(value):
    """`jerk_limited` of 2a³/j², as a scenario loads it."""
    a = 1.0
    signal = jerk_limited((0.0, value), 0.5, 100.0, a, (2 * a**3 / abs(value)) ** 0.5)
    assert signal.at(np.array([0.5]))[0] == 0.0
    assert signal.at(np.array([1e4]))[0] == value


@mark.parametrize("n", [1, 4])
def test_without_any_answer_of_ruckig_it_stops_and_goes_on(monkeypatch, n):
    """The last resort by itself: limits kept, no jump, at the goal in the end."""

    def fail(*args):
        raise SolverError("none")

    monkeypatch.setattr(jerk_limits, "_Fastest", fail)
    rng = np.random.default_rng(n)
    v, a, j = 10.0 ** rng.uniform(-1.0, 1.0, (3, n))
    dt = 1e-3
    point = osc.SetPoint(np.zeros(n), osc.JerkLimits(v, a, j), dt)
    goals = np.repeat(rng.normal(size=(25, n)), rng.integers(1, 400, 25), axis=0)
    _, x_dot, x_ddot = states = np.swapaxes([point.step(goal) for goal in goals], 0, 1)
    assert (np.abs(x_dot) <= v + ROUND).all() and (np.abs(x_ddot) <= a + ROUND).all()
    assert (np.abs(np.diff(x_ddot, axis=0)) <= j * dt + ROUND).all()
    for x, rate in pairwise(states):
        drawn = np.diff(x, axis=0) - dt * (rate[1:] + rate[:-1]) / 2
        assert (np.abs(drawn) <= j * dt**2 / 4 + ROUND).all()
    while point.remaining > 0.0:
        end = point.step()
    assert_array_equal(end, [goals[-1], np.zeros(n), np.zeros(n)])


@given(SIZES, SIZES, SIZES, SIZES)
@settings(max_examples=200, deadline=None)
def test_from_rest_to_rest_is_as_fast_as_ruckig_s(way, v, a, j):
    """Its length, its limits and, where ruckig answers, its duration."""
    pieces = from_rest_to_rest(way, v, a, j)
    duration = sum(t for t, _ in pieces)
    end = follow(pieces, duration)
    assert end[0] == approx(way, rel=1e-9)
    late = 1e-15 * duration  # s, of rounding
    assert abs(end[1]) <= ROUND * v + late * a and abs(end[2]) <= ROUND * a + late * j
    for t in np.linspace(0.0, duration, 50):
        _, x_dot, x_ddot = follow(pieces, t)
        assert abs(x_dot) <= v * (1 + ROUND) and abs(x_ddot) <= a * (1 + ROUND)
    zero = np.zeros(1)
    try:
        limits = np.array([[v], [a], [j]])
        fastest = jerk_limits._Fastest(zero, zero, zero, np.array([way]), limits).duration
    except SolverError:
        return
    assert duration == approx(fastest, rel=1e-6)
