"""Elastic walls that the model takes as rigid: frequency of a contact, and its force integral."""

import numpy as np
from law_calls import contact_mode, friction_slope, records, write
from numpy.random import default_rng
from pytest import approx
from samples import parametrize

import osc_contact as osc
from benchmarks.random_tasks import Errors, RandomTask, draw, spring_wall
from osc_contact.law.records import YIELDING

DT = 1e-3
K_I = 30.0
FORCE = 20.0


def contact(locked=0):
    """Tick of one column whose mass is 1/(NᵀΛ⁻¹N) over the free axes, and this mass (kg)."""
    rng = default_rng(5)
    A = rng.normal(size=(6, 6))
    inertia = 2.0 * (A @ A.T + np.eye(6))
    N = rng.normal(size=6)
    gains = {"force_gain": K_I, "force_brake": 42.0, "brake_ratio": 4.0}
    t = records(1, 1, 1, 1, rubs=1, **gains)
    write(t.work, rank=1, Lambda=inertia, N_t=N[None], locked=locked, dt=DT)
    t.memory.columns.scale = FORCE
    free = slice(locked, None)
    return t, 1.0 / (N[free] @ np.linalg.solve(inertia[free, free], N[free]))


def follow(t, x, alpha):
    """Ticks with positions of the contact (m) and its forces (N)."""
    for speed, force in zip(np.gradient(x, DT), alpha, strict=True):
        t.work.speed[0] = speed
        t.work.alpha_meas[0] = force
        contact_mode.follow_compliance(t, 0, 0)
        t.memory.columns.has_desired = 1


def oscillation(frequency, amplitude, stiffness, noise=0.0):
    """Positions and forces (2, 3000) of a contact that swings on a spring about its force."""
    times = DT * np.arange(3000)
    change = amplitude * np.sin(2.0 * np.pi * frequency * times)
    readings = change + noise * default_rng(1).normal(size=3000)
    return change / stiffness, FORCE + readings


@parametrize("locked", [0, 2])
@parametrize("frequency", [3.0, 6.0])
@parametrize("stiffness", [1e4, 1e5])
def test_the_frequency_follows_from_the_stiffness_that_a_contact_shows(
    frequency, stiffness, locked
):
    t, mass = contact(locked)
    follow(t, *oscillation(frequency, 2.0, stiffness, noise=0.3))
    assert contact_mode.slowest_mode(t) == approx(np.sqrt(stiffness / mass), rel=0.2)


def test_what_shows_no_stiffness_leaves_the_frequency_high_or_unknown():
    x, alpha = oscillation(0.5, 2.0, 1e4)
    t, mass = contact()
    assert contact_mode.slowest_mode(t) == np.inf
    noise = 1e-5 * default_rng(2).normal(size=3000).cumsum() / 50.0  # of positions
    follow(t, noise, FORCE + 0.3 * default_rng(3).normal(size=3000))
    assert contact_mode.slowest_mode(t) > np.sqrt(3e5 / mass)
    # an approach: no force, though the position changes
    t, mass = contact()
    follow(t, 0.01 * DT * np.arange(3000), 0.1 * alpha)
    assert contact_mode.slowest_mode(t) == np.inf
    # sliding along a tilted face, by its motion along N alone
    t, mass = contact()
    follow(t, 1e2 * x, FORCE + 0.0 * alpha)
    assert contact_mode.slowest_mode(t) == np.inf


def test_faces_that_are_declared_as_yielding_are_left_out():
    t, _ = contact()
    follow(t, *oscillation(3.0, 2.0, 1e4))
    assert contact_mode.slowest_mode(t) < 100.0
    t.model.bodies.kind = YIELDING
    assert contact_mode.slowest_mode(t) == np.inf


@parametrize("ratio, left", {4.0: None, 2.0: 0.8, 1.0: 0.4, 0.5: 0.35})
def test_force_integrals_are_slower_than_the_slowest_contact(ratio, left):
    """ω/2.5, and at least κ/4; `ratio` is ω/K_i."""
    t, mass = contact()
    follow(t, *oscillation(4.0, 3.0, (ratio * K_I) ** 2 * mass))
    t.memory.ticked = 0
    friction_slope.limit_integrals(t)
    assert t.memory.integral_cut == approx(0.0 if left is None else 1.0 - left, abs=0.05)


def soft(stiffness, *more):
    """12 N of a UR5 on a wall that its model takes as rigid, a line of 18 mm; all else is right."""
    task = draw(880211, 29)
    changes = [*task.changes, "control.rate=1000", "duration=4 s", "tare=null", *more]
    task = RandomTask(0, 0, task.name, task.scenario, changes, {}, Errors(told=False))
    wall = {"wall": spring_wall(task.load(), stiffness)}
    return RandomTask(0, 0, task.name, task.scenario, changes, wall, Errors(told=False)).load()


@parametrize("stiffness", [1e4, 1.5e4])
def test_a_heavy_arm_does_not_bounce_on_a_soft_wall(stiffness):
    """21 kg on 10 kN/m: 3.5 Hz, which v̄ leaves undamped with the whole K_i."""
    recording = osc.run(soft(stiffness))
    judged = recording["t"] > 1.5
    error = recording["alpha_true"][judged, 0] - recording["alpha_cmd"][judged, 0]
    assert np.sqrt(np.mean(error**2)) < 0.02 * recording["alpha_cmd"][judged, 0].mean()
