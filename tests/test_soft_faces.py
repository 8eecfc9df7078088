"""Faces on unknown elastic supports: the brake of docs/tuning.md#soft-faces, measured or not."""

from dataclasses import replace
from functools import cache

import numpy as np
from rigs import refused, rig_of, vector
from samples import parametrize
from scenario_runs import run_of, verdict_of

import osc_contact as osc
from osc_contact.dynamics.environment import Yielding

DT = 1e-3
INTO = vector(-0.501104, -0.200441, -0.841854)  # the left face, along the contact's normal
WEIGHT = 9.81 * INTO[2]  #: N/kg along it, with the sign of what holds it


#: Encoders of 16 bits, wrists with 0.5 N of noise that are 3 ms late.
NOISY = (
    "sensors={encoder: {rate: 1 kHz, angle: {resolution: 0.0001}}, "
    "wrist: {rate: 1 kHz, delay: 3 ms, force: {noise: 0.5}, torque: {noise: 0.01}}}"
)


def soft_rig(stiffness, *more, mass=1.0, damping=5.0):
    """`moving_face` with its left face on a spring that carries the weight, default gains."""
    cart = (
        f"{{type: cart, direction: {INTO.tolist()}, mass: {mass} kg, stiffness: {stiffness}, "
        f"damping: {damping}, preload: {WEIGHT * mass} N}}"
    )
    return rig_of(
        "moving_face",
        f"contacts.left_end.face.motion={cart}",
        "gains={}",
        "model_error.environment=yielding",
        "duration=3 s",
        *more,
    )


def run(rig, measured, ticks=3000):
    """Relative force errors (ticks, 2) from 1 s on."""
    plant = rig.plant()
    controller = rig.controller()
    log = plant.log()
    commanded = []
    for k in range(ticks):
        measurement = plant.measure()
        reference = rig.references.at(DT * k)
        if not measured:
            measurement = replace(measurement, touched=None)
        plant.command(controller.tick(measurement, reference), DT)
        log.note()
        commanded.append(reference.alpha_d)
    alpha = log.truths(log.noted()).alpha
    assert (alpha[300:] > 0.0).all()
    assert controller.state is osc.SafetyState.RUN
    return alpha[1000:] / commanded[1000:] - 1.0


@parametrize("stiffness, most", {1e3: 0.03, 5e4: 0.02})
def test_sensors_of_real_arms_do(stiffness, most):
    found = verdict_of(soft_rig(stiffness, NOISY).scenario)
    assert found["task"]["word"] == "OK"
    assert found["force"]["left_end"]["rms_error_rel"] < most


@parametrize("seed", range(6))
def test_any_support_from_1_to_100_kN_per_m(seed):
    """Masses and dampings at random; nothing of it is known, its motion is measured or not."""
    rng = np.random.default_rng(seed)
    stiffness = 10 ** (3.0 + 0.4 * seed)
    rig = soft_rig(stiffness, mass=rng.uniform(0.3, 3.0), damping=rng.uniform(0.0, 20.0))
    assert (np.sqrt(np.mean(run(rig, bool(seed % 2)) ** 2, axis=0)) < 0.02).all()


GAINS = osc.Gains().force
K_I = GAINS.integral
KAPPA = GAINS.brake
W = GAINS.drift


def poles(ratio, passive):
    """Poles of σ v = −(1 + K_i/σ) e − b, e = k/m v/σ; b of a soft face, or κ σ/(σ + w) v."""
    brake = [KAPPA, KAPPA * K_I if passive else 0.0]
    own = np.polymul(np.polyadd([1.0, W, 0.0], brake), [1.0, 0.0, 0.0])
    return np.roots(np.polyadd(own, ratio * np.polymul([1.0, K_I], [1.0, W])))


def test_the_loop_is_stable_on_every_spring_and_the_usual_one_above_a_bound():
    bound = K_I * W * (W + KAPPA) ** 2 / ((KAPPA - K_I) * (W + K_I))  # of k/m, Routh
    for ratio in 10.0 ** np.linspace(1, 7, 40):
        assert poles(ratio, True).real.max() < 0.0
        usual = poles(ratio, False).real.max()
        if abs(ratio / bound - 1.0) > 0.05:
            assert (usual < 0.0) == (ratio > bound)


def damped_poles(brake, ratio, damping):
    """Poles of a contact on a wall with a spring and a damper, both over the mass (1/s², 1/s)."""
    return np.roots([1.0, brake + damping, ratio + K_I * damping, K_I * ratio])


def test_the_loop_is_stable_on_every_wall_that_damps_where_kappa_exceeds_K_i():
    for ratio in 10.0 ** np.linspace(1, 7, 20):
        assert damped_poles(0.9 * K_I, ratio, 0.0).real.max() > 0.0
        for damping in (0.0, *10.0 ** np.linspace(-1, 5, 20)):
            assert damped_poles(KAPPA, ratio, damping).real.max() < 0.0
            routh = (0.9 * K_I + damping) * (ratio + K_I * damping) > K_I * ratio
            margin = abs((0.9 * K_I + damping) * (ratio + K_I * damping) / (K_I * ratio) - 1.0)
            if margin > 1e-3:
                assert (damped_poles(0.9 * K_I, ratio, damping).real.max() < 0.0) == routh


SHARE = 0.03  #: d of MuJoCo's `solimp`: with a small one, spring and damper act as given


@cache
def landed_on(damping_ratio, hertz=60.0):
    """Largest landing force (N) of the rod's ends, and rms errors of the forces held afterwards.

    Stiffness and damping of the faces are given directly, both over the mass behind the contact:
    ω² = 1/(d(1 − d)τ²ζ²), δ = 2/((1 − d)τ) of MuJoCo's solref (τ, ζ) and solimp d.
    """
    rate = 2.0 * np.pi * hertz
    time = 1.0 / ((1.0 - SHARE) * damping_ratio * rate)
    ratio = 1.0 / (rate * np.sqrt(SHARE * (1.0 - SHARE)) * time)
    recording = run_of(
        "approach_and_slide",
        f"plant.solref=[{time}, {ratio}]",
        f"plant.solimp=[{SHARE}, {SHARE}, 0.001]",
        "gains={force: {bandwidth: 5 Hz}}",
        "sensors={}",
        "model_error={}",
        "duration=2.6 s",
    )
    landing, errors = [], []
    for true, command in zip(recording["alpha_true"].T, recording["alpha_cmd"].T, strict=True):
        touch = np.flatnonzero(true > 0.02)[0]
        landing.append(true[touch : touch + 15].max())
        error = (true - command)[touch + 600 : 2500] / 10.0
        errors.append(np.sqrt(np.mean(error**2)))
        assert (true[touch + 600 : 2500] > 0.0).all()
    return max(landing), max(errors)


@parametrize("damping_ratio", [0.1, 2.0])
def test_a_wall_that_damps_makes_no_force_oscillate(damping_ratio):
    assert landed_on(damping_ratio)[1] < 0.005


def test_landing_forces_grow_with_the_damping_of_the_wall_that_damps():
    assert landed_on(2.0)[0] > 5.0 * landed_on(0.1)[0]


def test_the_arm_in_contact_is_passive():
    """Re Z(jω) > 0 of Z = −e/v: no passive face makes the loop unstable, whatever its mass."""
    s = 1j * 10.0 ** np.linspace(-3, 5, 400)
    Z = (s + KAPPA * (s + K_I) / (s + W)) / (1.0 + K_I / s)
    assert (Z.real > 0.0).all()
    Z = (s + KAPPA * s / (s + W)) / (1.0 + K_I / s)
    assert (Z.real < 0.0).any(), "the usual brake is not"


def test_what_is_no_compliance_is_refused():
    for value in (0.0, -1e-4, np.inf, np.nan):
        with refused("compliance"):
            Yielding(value)
