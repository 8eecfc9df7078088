"""Faces on unknown elastic supports: the brake of docs/tuning.md#soft-faces, measured or not."""

from dataclasses import replace

import numpy as np
from rigs import refused, rig_of, vector
from samples import parametrize
from scenario_runs import verdict_of

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
