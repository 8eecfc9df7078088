"""References for loops of one's own: set points that move, poses, classical accelerations."""

import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.linalg import norm
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx, raises
from rigs import (
    assert_near,
    displacement,
    largest,
    placed,
    pose_of,
    refused,
    rotated,
    vector,
    within,
)
from samples import parametrize

import osc_contact as osc
from osc_contact import jerk_limits
from osc_contact.control.set_point import rotation_of
from osc_contact.jerk_limits import Trajectory
from osc_contact.lab.scenarios.signals import jerk_limited

DT = 1e-3
LINEAR = osc.JerkLimits(0.3, 2.0, 40.0)
ANGULAR = osc.JerkLimits(1.0, 8.0, 150.0)


def some_goal(rng, x, v, a, j, most):
    """Beside x by any distance up to `most`, or by one at which the shape of the way changes."""
    ways = [v, 2 * a**3 / j**2, v * v / a + v * a / j, 2 * v * (v / j) ** 0.5, v * v / (2 * a)]
    share = rng.choice([0.0, 1.0, -1.0, rng.uniform(-1.0, 1.0)], len(x))
    return x + share * np.minimum(ways[rng.integers(len(ways))], most)


@parametrize("ruckig", ["answers", "finds none"])
@parametrize("size", [1e-6, 1.0, 1e5])
def test_goals_that_change_at_any_time_are_followed_within_the_limits(monkeypatch, size, ruckig):
    """Without any answer of ruckig it stops and continues: the last resort by itself."""

    def fail(*args):
        raise osc.SolverError("none")

    if ruckig == "finds none":
        monkeypatch.setattr(jerk_limits, "_Fastest", fail)
    rng = default_rng(0)
    for n in (1, 3, 6):
        v, a, j = size * 10.0 ** rng.uniform(-1, 1.5, (3, n))
        point = osc.SetPoint(np.zeros(n), osc.JerkLimits(v, a, j), DT)
        states = [point.step()]
        for steps in rng.integers(0, 60, 60):
            goal = some_goal(rng, states[-1].value, v, a, j, size)
            states += [point.step(goal) for _ in range(steps + 1)]
        x, x_dot, x_ddot = np.swapaxes(states, 0, 1)
        tiny = 1e-9 * size
        assert within(x_dot, v + tiny) and within(x_ddot, a + tiny)
        assert within(np.diff(x_ddot, axis=0), j * DT + tiny)
        for path, rate, most in ((x, x_dot, DT / 6), (x_dot, x_ddot, 1 / 4)):
            drawn = np.diff(path, axis=0) - DT * (rate[1:] + rate[:-1]) / 2
            assert within(drawn, j * most * DT**2 + 1e-3 * tiny)
        due = point.remaining / DT + 2
        count = 0
        while point.remaining > 0.0:
            end = point.step()
            count += 1
        assert count <= due or ruckig == "finds none"
        assert_array_equal(end, [goal, np.zeros(n), np.zeros(n)])


@parametrize("way", [1e-300, 1e-12, 1e6, 1e300])
def test_no_finite_goal_raises(way):
    bounds = LINEAR.each(2)
    path = Trajectory.rest(np.zeros(2), bounds)
    for share in (1.0, 0.3, -1.0):
        goal = way * vector(share, 0.5)
        path = Trajectory(*path.state, goal, bounds)
        path.advance(0.1)
        assert np.isfinite(path.state).all()
    path.advance(2.0 * path.remaining)  # whatever its rounding
    assert_array_equal(path.state[0], goal)


def test_a_number_stays_a_number_and_several_arrive_together_on_a_line():
    state = osc.SetPoint(5.0, osc.JerkLimits(20, 200, 4000), DT).step(8.0)
    assert np.shape(state.value) == () and 5.0 < state.value < 8.0
    line = osc.SetPoint([1.0, 2.0, 3.0], LINEAR, DT)
    goal = vector(1.3, 1.9, 3.2)
    done = np.array([(line.step(goal).value - [1, 2, 3]) / (goal - [1, 2, 3]) for _ in range(800)])
    assert_near(done, done[:, :1] * np.ones(3), atol=1e-9)


@parametrize("size", [0.0, 1e-9, 1e-3, 0.31, 0.32, 1.0, 3.1, 5.0])
def test_angular_motion_is_the_derivative_of_the_rotation(size):
    rng = default_rng(1)
    h = 1e-5
    for _ in range(20):
        w, w_dot, w_ddot = rng.standard_normal((3, 3))
        w *= size / norm(w)

        def moved(t, w=w, w_dot=w_dot, w_ddot=w_ddot):
            return rotation_of(w + w_dot * t + w_ddot * t * t / 2, w_dot + w_ddot * t, w_ddot)

        R, omega, omega_dot = moved(0.0)
        assert_near(R, pin.exp3(w), atol=1e-12)
        assert_near(omega, pin.log3(moved(h)[0] @ moved(-h)[0].T) / (2 * h), atol=1e-8)
        assert_near(omega_dot, (moved(h)[1] - moved(-h)[1]) / (2 * h), atol=1e-8)


def test_poses_with_goals_that_change_on_the_way():
    """Twist and classical acceleration are derivatives of the pose, also where goals change."""
    rng = default_rng(2)
    point = osc.PoseSetPoint(pose_of(rng), LINEAR, ANGULAR, DT)
    goals = [goal for goal in (pose_of(rng) for _ in range(12)) for _ in range(150)]
    path = [point.step(goal, [1.0]) for goal in goals]
    for before, after in pairwise(path):
        step = displacement(before.X_WD, after.X_WD)
        assert_near(step / DT, (before.V_D + after.V_D) / 2, atol=1e-4)
        assert_near((after.V_D - before.V_D) / DT, (before.A_D + after.A_D) / 2, atol=0.1)
        assert within(after.V_D[:3], 0.3 + 1e-9)
        assert within(after.A_D[:3], 2.0 + 1e-9)
        assert norm(after.V_D[3:]) <= 3**0.5 * 1.0 + 0.05
    while point.remaining > 0.0:
        last = point.step()
    assert last.X_WD.isApprox(goals[-1], 1e-12)
    assert_array_equal((last.V_D, last.A_D), np.zeros((2, 6)))
    assert_array_equal(path[0].alpha_d, [1.0])


def test_the_short_way_round_again_and_again():
    """Goals a third of a turn on, four turns in all: never back, always about z."""
    point = osc.PoseSetPoint(placed(), LINEAR, ANGULAR, DT)
    turned = 0.0
    for k in range(1, 13):
        goal = placed(rpy=(0.0, 0.0, k * 2 * np.pi / 3))
        for _ in range(2250):
            reference = point.step(goal)
            turned += reference.V_D[5] * DT
            assert reference.V_D[5] >= -1e-9 and largest(reference.V_D[3:5]) < 1e-9
    while point.remaining > 0.0:
        turned += point.step().V_D[5] * DT
    assert turned == approx(8 * np.pi, abs=1e-3)


@parametrize(
    "goal",
    [
        placed(0.0, np.nan),
        rotated(np.eye(3) + 0.1 * np.eye(3, k=1)),  # sheared
        np.eye(4),
        rotated(-np.eye(3)),
    ],
)
def test_a_goal_that_is_none_is_refused_and_the_former_is_kept(goal):
    ours, other = (osc.PoseSetPoint(placed(), LINEAR, ANGULAR, DT) for _ in range(2))
    good = pose_of(default_rng(3))
    for _ in range(50):
        ours.step(good), other.step(good)
    with refused("goal"):
        ours.step(goal)
    with refused("alpha_d"):
        ours.step(placed(), [np.inf])
    assert_array_equal(ours.step().V_D, other.step().V_D)


@parametrize("bad", [np.nan, np.inf, "far", None])
def test_bad_numbers_are_refused_at_the_door(bad):
    for make, numbers in (
        (osc.JerkLimits, ([1.0, bad], 1.0, 1.0)),
        (osc.SetPoint([0.0, 0.0, 0.0], LINEAR, DT).step, ([0.0, 0.0, bad],)),
        (osc.SetPoint, (0.0, LINEAR, bad)),
        (osc.SetPoint, ([0.0, bad], LINEAR, DT)),
    ):
        with raises(osc.InvalidInputError):
            make(*numbers)


@parametrize(
    "start, speed, dt, words",
    [
        ([], 1.0, DT, "start"),
        ([1, [2]], 1.0, DT, "start"),
        ([[1, 2]], 1.0, DT, "start"),
        ([0, 0], [1, 1, 1], DT, "2 coordinates"),
        (0.0, 1.0, 0.0, "dt = 0"),
        (0.0, [1.0, -2.0], DT, "> 0"),
    ],
)
def test_set_points_of_other_shapes_and_impossible_limits_are_refused(start, speed, dt, words):
    with refused(words):
        osc.SetPoint(start, osc.JerkLimits(speed, 1.0, 1.0), dt)


def test_ruckig_missing_is_reported_at_once(monkeypatch):
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with raises(osc.OscContactError, match=r"ruckig.*osc_contact\[sim\]"):
        osc.SetPoint(0.0, LINEAR, DT)


def test_a_reference_leaves_out_what_is_zero():
    X = pose_of(default_rng(4))
    short = osc.Reference(X)
    long = osc.pose_reference(X.translation, X.rotation)
    for reference in (short, long):
        assert_array_equal((reference.V_D, reference.A_D), np.zeros((2, 6)))
        assert len(reference.alpha_d) == 0 and reference.squeeze_d == 0.0
        with raises(ValueError, match="read-only"):  # it would count for nothing
            reference.alpha_d[:] = 5.0
        assert_array_equal(replace(reference, alpha_d=[5.0]).alpha_d, [5.0])
    assert long.X_WD == X and short.V_D is not osc.Reference(X).V_D
    for wrong in (
        {"velocity": [0, 0]},
        {"angular_acceleration": [0, np.nan, 0]},
        {"rotation": 2 * np.eye(3)},
        {"alpha_d": [[5.0]]},
    ):
        with raises(osc.InvalidInputError):
            osc.pose_reference(**({"position": np.zeros(3)} | wrong))


@parametrize("value", [0.005, 5.0, 1e-7, -0.3])
def test_a_scenario_s_signal_is_where_they_meet_too(value):
    """`jerk_limited` of 2a³/j², as a scenario loads it."""
    a = 1.0
    signal = jerk_limited((0.0, value), 0.5, 100.0, a, (2 * a**3 / abs(value)) ** 0.5)
    assert signal.at(vector(0.5))[0] == 0.0
    assert signal.at(vector(1e4))[0] == value
