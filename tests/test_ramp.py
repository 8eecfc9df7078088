"""The benchmark of the ramp judges settling and path as it says, on the ramp that it says."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.ramp import (
    ACCELERATION,
    BALL,
    BEGIN,
    PIECES,
    foot_on_ramp,
    height,
    judged,
    path_points,
)

T = np.arange(0.0, 10.0, 0.002)


def test_settling_counts_from_the_first_contact_to_the_last_time_outside_the_band():
    force = np.where(T < 1.0, 0.0, 20.0 + 5.0 * np.exp(-(T - 1.0) / 0.5))
    found = judged(T, force, 20.0, 4.0, 9.0)
    assert found.settling == pytest.approx(0.5 * np.log(5.0), abs=0.003)  # 5 N fall to 1 N
    force[T > 3.99] = 30.0  # outside until the path begins
    assert np.isnan(judged(T, force, 20.0, 4.0, 9.0).settling)
    assert np.isnan(judged(T, np.where(T < 4.5, 0.0, 20.0), 20.0, 4.0, 9.0).settling)


def test_deviations_count_on_the_path_only():
    force = np.full(len(T), 20.0)
    force[T < 1.0] = 90.0
    force[T > 9.1] = 0.0
    on_path = np.flatnonzero((T >= 4.0) & (T <= 9.0))
    force[on_path[:1000]] = 26.0
    force[on_path[1500]] = 0.0
    found = judged(T, force, 20.0, 4.0, 9.0)
    assert found.largest == 20.0
    assert found.mean == pytest.approx((6.0 * 1000 + 20.0) / len(on_path))
    assert found.closed == pytest.approx(1.0 - 1.0 / len(on_path))


def test_the_ramp_goes_through_the_published_points():
    published = [
        (0.08457, -0.01071),
        (0.14222, -0.04169),
        (0.21429, -0.08042),
        (0.295, -0.0938),
        (0.3195, -0.09076),
        (0.3425, -0.0818),
        (0.39, -0.0698),
    ]
    assert_allclose([height(s) for s, _ in published], [h for _, h in published], atol=2e-5)


@pytest.mark.parametrize("piece", PIECES, ids=range(len(PIECES)))
def test_a_ball_on_the_ramp_has_its_foot_where_it_touches(piece):
    s = 0.5 * (piece.first + piece.last)
    point = np.array([s, height(s)])
    slope = (height(s + 1e-6) - height(s - 1e-6)) / 2e-6
    normal = np.array([-slope, 1.0]) / np.hypot(slope, 1.0)
    foot, n = foot_on_ramp(point + BALL * normal)
    assert_allclose(foot, point, atol=1e-9)
    assert_allclose(n, normal, atol=1e-8)


def test_the_contact_keeps_its_speed_along_the_ramp():
    rows = path_points(0.1)
    middle = rows[:, 1:3] + [BEGIN, BALL]
    feet = np.array([foot_on_ramp(p)[0] for p in middle])
    speed = np.hypot(*np.diff(feet, axis=0).T) / np.diff(rows[:, 0])
    even = slice(round(0.1 / ACCELERATION / 0.03) + 1, -6)
    assert_allclose(speed[even], 0.1, rtol=0.005)
