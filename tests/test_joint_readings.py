"""Joint positions and velocities from encoders: readings that jump, joints that are pushed."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, fixture

from osc_contact.interface import Measurement, Stamps
from osc_contact.sensing.joint_readings import Encoders, JointReadings

DT = 1e-3
STEP = 2.0 * np.pi / 2**18  # rad
LIMIT = 2.2  # rad/s
DEGREE = np.deg2rad(1.0)


def joint_readings(noise=0.0, sample=DT):
    encoders = Encoders(
        noise=np.full(2, noise),
        resolution=np.full(2, STEP),
        unknown=np.full(2, 30.0),
        sample=sample,
    )
    return JointReadings(encoders, np.full(2, 3.0 * LIMIT), 20.0, DT)


def measured(k, q):
    """Measurement of tick k with positions q (2,) rad."""
    rounded = STEP * np.round(np.array(q) / STEP)
    t = DT * k
    return Measurement(rounded, np.full(2, np.nan), np.zeros((1, 6)), stamps=Stamps(t, t, t, t))


def moved(readings, motion, ticks):
    """Completed measurements of a motion, a function of time (s) that returns positions (2,)."""
    return [readings.complete(measured(k, motion(DT * k))) for k in range(ticks)]


@fixture
def moving():
    """Readings of joints of which the second moves at 0.5 rad/s, up to tick 199."""
    readings = joint_readings()
    moved(readings, lambda t: [0.3, 0.5 * t], 200)
    return readings


def test_a_spike_is_not_believed_and_moves_nothing(moving):
    spike = moving.complete(measured(200, [1.3, 0.1]))
    assert np.isnan(spike.q).tolist() == [True, False]
    assert_allclose(spike.v, [0.0, 0.5], atol=0.02)
    after = moving.complete(measured(201, [0.3, 0.1005]))
    assert_allclose(after.q, [0.3, 0.1005], atol=STEP)
    assert_allclose(after.v, [0.0, 0.5], atol=0.02)


def test_the_velocity_of_a_jump_by_one_degree_is_taken_back(moving):
    """Taken for motion, 17 rad/s, it was braked by a stopped arm, which moved."""
    moving.complete(measured(200, [0.3, 0.1 + DEGREE]))
    for k in range(201, 260):
        now = moving.complete(measured(k, [0.3, 0.5 * DT * k + DEGREE]))
        assert now.q[1] == approx(0.5 * DT * k + DEGREE, abs=2.0 * STEP)
        assert now.v[1] == approx(0.5, abs=0.03)


def test_the_velocity_of_a_jump_is_taken_back_where_encoders_are_slower_than_the_loop():
    """With the next reading: in the periods between it is only predicted."""
    period = 2
    readings = joint_readings(sample=period * DT)
    for k in range(260):
        last = k - k % period
        jump = DEGREE if last >= 200 else 0.0
        now = readings.complete(measured(last, [0.3, 0.5 * DT * last + jump]))
        if k >= 100 and not 200 <= k < 200 + period:
            assert now.q[1] == approx(0.5 * DT * k + jump, abs=4.0 * STEP)
            assert now.v[1] == approx(0.5, abs=0.03)


def test_a_joint_that_is_struck_is_not_taken_for_an_encoder_that_jumps():
    """To twice its speed limit in one period; the estimate is that without any check."""
    readings, plain = joint_readings(), joint_readings()._estimate

    def struck(t):
        return [0.0, 2.0 * LIMIT * max(t - 0.1, 0.0)]

    for k in range(150):
        now = measured(k, struck(DT * k))
        q, v = plain.update(now.q)
        completed = readings.complete(now)
        assert_allclose(completed.q, q, rtol=0.0, atol=0.0)
        assert_allclose(completed.v, v if k else 0.0, rtol=0.0, atol=0.0)


def test_a_pause_of_the_packets_is_not_taken_for_a_jump():
    """A joint at half its speed limit, of which no reading comes for 20 ms."""
    readings = joint_readings()
    moved(readings, lambda t: [0.0, 0.0], 100)
    for k in range(100, 120):  # it begins to move meanwhile
        readings.complete(replace(measured(k, [0.0, 0.0]), stamps=Stamps(0.099, 0.099, 0.1, 0.1)))
    for k in range(120, 160):
        now = readings.complete(measured(k, [0.0, 0.5 * LIMIT * DT * (k - 100)]))
    assert now.v[1] == approx(0.5 * LIMIT, rel=0.02)


def test_a_joint_reads_nothing_until_all_encoders_have_read():
    readings = joint_readings()
    first = measured(0, [np.nan, 0.0])
    assert readings.complete(first) is first
    assert readings.complete(measured(1, [0.0, 0.0])).estimated
