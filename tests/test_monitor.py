"""Contact or not, collision or not: the monitor on signals whose story is known."""

import numpy as np
from complaints import invalid_input
from numpy.testing import assert_array_equal
from pytest import mark
from scenario_runs import run_of

from osc_contact.control.monitor import ContactMonitor, watch_series
from osc_contact.scenarios.control_schema import MonitorLimits

DT = 1e-3


def told(alpha, speed, limits=None):
    monitor = ContactMonitor(1, DT, limits or MonitorLimits())
    states = [
        monitor.update(np.array([a]), np.array([s])) for a, s in zip(alpha, speed, strict=True)
    ]
    closed = np.array([s.closed[0] for s in states])
    return closed, np.flatnonzero([s.collision[0] for s in states])


def test_approach_contact_loss_and_contact_again():
    """300 ms free, 400 ms pressed, 200 ms lost, pressed again; 0.1 N and 1 mm/s of noise."""
    rng = np.random.default_rng(0)
    t = np.arange(1200)
    pressed = ((t >= 300) & (t < 700)) | (t >= 900)
    alpha = np.where(pressed, 8.0, 0.0) + 0.1 * rng.standard_normal(len(t))
    speed = 1e-3 * rng.standard_normal(len(t))
    for hit in (300, 900):
        alpha[hit : hit + 4] = [15.0, 20.0, 12.0, 9.0]
        speed[hit : hit + 4] = [0.03, 0.02, 0.01, 0.002]
    closed, collisions = told(alpha, speed)
    assert np.flatnonzero(np.diff(closed.astype(int))).tolist() == [299, 704, 899]
    assert len(collisions) == 2
    assert collisions[0] in range(300, 305) and collisions[1] in range(900, 905)


def test_forces_and_powers_between_the_thresholds_change_nothing():
    limits = MonitorLimits()
    between = 0.5 * (limits.force_on + limits.force_off)
    for start in (False, True):
        monitor = ContactMonitor(1, DT, limits)
        monitor.rows[0].closed = int(start)
        for _ in range(100):
            seen = monitor.update(np.array([between]), np.zeros(1))
            assert seen.closed[0] == start and not seen.collision[0]


def test_a_short_gap_is_not_a_lost_contact_and_a_long_one_is():
    for gap, still in ((4, True), (8, False)):
        alpha = np.full(60, 5.0)
        alpha[20 : 20 + gap] = 0.0
        closed, _ = told(alpha, np.zeros(60))
        assert closed[10:].all() == still


def test_one_long_burst_of_power_is_one_collision():
    alpha = np.zeros(100)
    speed = np.zeros(100)
    alpha[20:] = 10.0
    speed[20:60] = 0.02
    _, collisions = told(alpha, speed)
    assert collisions.tolist() == [20]


def test_power_is_no_collision_long_after_contact_was_made():
    speed = np.zeros(100)
    speed[50:60] = 0.05
    _, collisions = told(np.full(100, 10.0), speed)
    assert len(collisions) == 0


def test_thresholds_without_hysteresis_are_refused():
    with invalid_input("above force_off"):
        MonitorLimits(force_on=0.4, force_off=0.4)


@mark.parametrize("power", [0.0, -0.05])
def test_a_power_that_is_no_threshold_is_refused(power):
    with invalid_input("power: must be > 0"):
        MonitorLimits(power=power)


def test_a_run_with_closed_contacts_is_seen_as_such():
    recording = run_of(duration=0.3)
    assert recording["contact_seen"][20:].all()
    assert not recording["collision_seen"][20:].any()


@mark.parametrize("seed", range(4))
def test_a_series_is_watched_as_tick_by_tick(seed):
    """Ticks that are passed over tell nothing new: contacts lost and made again, with bursts."""
    rng = np.random.default_rng(seed)
    alpha = np.repeat(rng.choice([8.0, 0.0, 0.45, 3.0], (60, 2)), rng.integers(1, 40, 60), axis=0)
    alpha = alpha + 0.02 * rng.normal(size=alpha.shape)
    speed = 0.02 * rng.normal(size=alpha.shape)
    closed, collision = watch_series(ContactMonitor(2, DT), alpha, speed)
    other = ContactMonitor(2, DT)
    seen = [other.update(a, v) for a, v in zip(alpha, speed, strict=True)]
    assert_array_equal(closed, [one.closed for one in seen])
    assert_array_equal(collision, [one.collision for one in seen])
    assert collision.any() and not closed.all() and closed.any()
