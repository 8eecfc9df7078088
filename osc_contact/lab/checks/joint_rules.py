"""Checks of a task before it runs: springs, dry friction and encoders of the joints."""

from __future__ import annotations

import numpy as np

from osc_contact.dynamics.chain_state import modes
from osc_contact.errors import OscContactError
from osc_contact.lab.checks.spring_poles import slowest_oscillation
from osc_contact.lab.rig import hardware
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.scenarios.bodies import CartSpec
from osc_contact.loop.rules import Values, doubt, rule
from osc_contact.spatial import Array

NOISY = 0.05  #: largest rms force by the noise of encoders without a warning, over the mean command
#: Largest force by friction that is not compensated without a warning, over the mean command.
MOST_FRICTION = 0.3
#: Least share of dry friction that no model compensates: at rest it is larger than in motion.
_UNCERTAIN = 0.4
_DECAY = 3.0  #: 1/s; oscillations of springs that decay more slowly are a finding

# --- Springs --------------------------------------------------------------------------------------


def _are_flexible(rig: Rig) -> bool:
    """Test whether joints have springs, and a joint torque loop, if there is one, can be made."""
    return not any(springs.findings(rig)) and rig.springs is not None


def _has_loop(rig: Rig) -> bool:
    """Test whether a joint torque loop produces the commanded torques."""
    return rig.scenario.control.joint_torque is not None


def _all_motors_have_friction(rig: Rig) -> bool:
    """Test whether the joints of all motors have dry friction."""
    chain = rig.chain
    has_friction = chain.model.upperDryFrictionLimit[chain.actuated] > 0.0
    return bool(has_friction.all()) or rig.scenario.plant.joint_friction > 0.0


@rule("{why}")
def springs(rig: Rig) -> Values:
    """Find springs of flexible joints, or a joint torque loop, that cannot be made."""
    try:
        hardware.torque_loop(rig.scenario, rig.chain, rig.springs)
    except OscContactError as error:
        yield 1.0, {"why": error}


@doubt(
    "the joint springs oscillate at {first:.3g} Hz (first mode, motors held), and no joint "
    "torque loop produces the commanded torques: below 100 Hz contact may be lost; set "
    "control.joint_torque={{rate: {rate:g} kHz}}",
    -100.0,
)
def swinging(rig: Rig) -> Values:
    """First natural frequency of flexible joints without a torque loop, negated (−Hz).

    It is negated because a low frequency is the finding, and rules compare with upper limits. For
    motors with dry friction see `slow_decay`.

    Args:
        rig: rig of the scenario.
    """
    if _are_flexible(rig) and not _has_loop(rig) and not _all_motors_have_friction(rig):
        assert rig.springs is not None
        frequencies = modes(rig.state, rig.chain.actuated, rig.springs.stiffness)
        first = frequencies[frequencies > 0.0].min(initial=np.inf)
        yield -first, {"first": first, "rate": 1e-3 / rig.scenario.plant.step}


@doubt(
    "an oscillation of the joint springs at {hertz:.3g} Hz decays at no more than {decay:.2g} 1/s "
    "(negative: it grows){where}: contact may be lost, or the arms stop; {cure}",
    -_DECAY,
)
def slow_decay(rig: Rig) -> Values:
    """Slowest decay of oscillations of flexible joints, negated (−1/s).

    It is negated because a slow decay is the finding, and rules compare with upper limits. Without
    a joint torque loop it is looked at where all motors have dry friction: without friction,
    contacts are lost at higher frequencies than these oscillations have (`swinging`).

    Args:
        rig: rig of the scenario.
    """
    if not _are_flexible(rig) or not (_has_loop(rig) or _all_motors_have_friction(rig)):
        return
    slowest = slowest_oscillation(rig)
    cures = []
    if not _has_loop(rig):
        rate = 1e-3 / rig.scenario.plant.step
        cures.append(f"set control.joint_torque={{rate: {rate:g} kHz}}")
    if slowest.approaching:
        cures.append("lower control.life.damping")
    cures.append("raise control.rate or lower gains.motion.frequency")
    yield (
        -slowest.decay,
        {
            "hertz": slowest.hertz,
            "decay": slowest.decay,
            "where": " as the arms approach their contacts" if slowest.approaching else "",
            "cure": ", ".join(cures),
        },
    )


# --- Dry friction ---------------------------------------------------------------------------------


@doubt(
    "dry friction of the joints that no model compensates can change force {name} by {force:.2g} N "
    "where joints stop, start or turn, {percent:.2g} % of its mean command of {command:.3g} N; "
    "command a larger force, change the posture, give the friction to the model, or control the "
    "joint torques (control.joint_torque)",
    MOST_FRICTION,
)
def uncompensated(rig: Rig) -> Values:
    """Force by dry friction of the joints that no model compensates, over the mean command.

    Torques δτ of the motors change the forces of rigid contacts by (NᵀΦN)⁻¹NᵀS Λ_S⁻¹G δτ. Of the
    friction of a joint whose model is wrong counts what the model lacks, and at least `_UNCERTAIN`
    of it. Signs of the joints are independent, so squares are added.

    Args:
        rig: rig of the scenario.

    Yields:
        The ratio of each force, with the words of the finding.
    """
    N = rig.contact.N
    if not rig.pairs or N.shape[1] != len(rig.force_names):  # dependent contacts share forces
        return
    friction = _uncompensated_torques(rig)
    if not friction.any():
        return
    state = rig.state
    by_motors = N.T @ state.S @ np.linalg.solve(state.Lambda_S, state.G)
    forces = np.linalg.norm(np.linalg.solve(N.T @ state.Phi @ N, by_motors * friction), axis=1)
    commands = np.abs(rig.references.overview[1].commands).mean(axis=0)
    for name, force, command in zip(rig.force_names, forces, commands, strict=True):
        value = force / command if command > 0.0 else 0.0
        yield value, {"name": name, "force": force, "percent": 100.0 * value, "command": command}


def _uncompensated_torques(rig: Rig) -> Array:
    """Dry friction (n_a,) of the motors that the controller does not compensate (N m, N).

    It is zero where the model's friction is exact. A joint torque loop reduces it. The friction of
    `plant.joint_friction` is in no model.

    Args:
        rig: rig of the scenario.
    """
    scenario = rig.scenario
    chain = rig.chain
    actuated = chain.actuated
    links = hardware.behind_torque_loop(scenario, chain).model
    true = links.upperDryFrictionLimit[actuated]
    modelled = rig.model.model.upperDryFrictionLimit[actuated]
    if not rig.joint_friction:
        modelled = np.zeros_like(modelled)
    missing = np.abs(true - modelled)
    is_wrong = missing > 1e-9 * true
    missing = np.where(is_wrong, np.maximum(missing, _UNCERTAIN * true), 0.0)
    of_drives = scenario.plant.joint_friction
    if of_drives == 0.0:  # and limits of torque may be infinite
        return missing
    loop = scenario.control.joint_torque
    share = 1.0 if loop is None or rig.springs is None else 1.0 / (1.0 + loop.gain)
    return missing + share * of_drives * chain.tau_max


# --- Encoders -------------------------------------------------------------------------------------


@doubt(
    "noise and steps of the encoders ({step:.2g} rad rms) let force {name} vary by {percent:.2g} % "
    "of {command:.3g} N, by the velocities that its brake is of; {enough:.2g} rad would do, or set "
    "control.estimate.joint_angular={angular:.2g} rad/s²",
    NOISY,
)
def encoders(rig: Rig) -> Values:
    """Rms force that the brake causes by the noise of the encoders, over the mean command.

    On unyielding faces a velocity error δV (6,) of the object, the mean of those of the arms,
    causes the forces δα = (NᵀΦN)⁻¹κ NᵀδV (N): (NᵀΦN)⁻¹ is the apparent mass along the columns N (6,
    r), κ (1/s) the gain of the brake. δV is J times the independent errors of the joints' estimated
    speeds.

    Args:
        rig: rig of the scenario.

    Yields:
        The ratio of each force, with the words of the finding.
    """
    brake = getattr(rig.gains.force, "brake", 0.0)
    if rig.scenario.sensors.encoder is None or not rig.pairs or not brake:
        return
    known = hardware.encoders(rig.scenario, rig.chain)
    error = known.error
    estimate = known.estimate(1.0 / rig.scenario.control.rate, learning=rig.measured_forces)
    N = rig.contact.N
    if N.shape[1] != len(rig.force_names):  # dependent contacts share their forces
        return
    apparent_mass = np.linalg.inv(N.T @ rig.state.Phi @ N)
    speed_errors = estimate.noise_gain * error  # (n,)
    by_joint = [
        apparent_mass @ N.T @ arm.J * speed_errors[joints]
        for arm, joints in zip(rig.state.arms, rig.chain.slices, strict=True)
    ]
    squares = np.hstack(by_joint) ** 2  # errors of the joints are independent
    forces = brake * np.sqrt(squares.sum(axis=1)) / len(rig.chain.arms)
    commands = np.abs(rig.references.overview[1].commands).mean(axis=0)
    for name, force, command in zip(rig.force_names, forces, commands, strict=True):
        value = force / command if command > 0.0 else 0.0
        reduction = min(NOISY / value, 1.0) if value > 0.0 else 1.0
        words = {
            "name": name,
            "step": error.max(),
            "percent": 100.0 * value,
            "command": command,
            "enough": error.max() * reduction**4,  # speed errors are as (error σ_a³)^¼
            "angular": rig.scenario.control.estimate.joint_angular * reduction ** (4.0 / 3.0),
        }
        yield value, words


@doubt(
    "contacts on the declared springs oscillate at up to {hertz:.3g} Hz, and velocities estimated "
    "from encoders of {step:.2g} rad rms alone follow too late for the brake to damp them; "
    "{enough:.2g} rad, read at {rate:.0f} Hz or more, would do, or leave "
    "control.estimate.measured_forces out",
    1.0,
)
def late_brake(rig: Rig) -> Values:
    """Bandwidth that the brake needs on declared springs, over that of the encoders alone.

    A contact on a spring oscillates at its natural frequency; speeds that encoders estimate more
    slowly reach the brake too late. It matters only where `control.estimate.measured_forces` is
    switched off.

    Args:
        rig: rig of the scenario.

    Yields:
        The ratio, with the words of the finding.
    """
    if rig.measured_forces or rig.scenario.sensors.encoder is None or not rig.gains.force.brake:
        return
    carts = [body.motion for body in rig.bodies if isinstance(body.motion, CartSpec)]
    if not any(cart.stiffness > 0.0 for cart in carts):
        return
    known = hardware.encoders(rig.scenario, rig.chain)
    needed = rig.needed_bandwidth
    words = {
        "hertz": rig.fastest_mode / (2.0 * np.pi),
        "step": known.error.max(),
        "enough": (known.unknown / needed**2).min(),
        "rate": needed,
    }
    yield needed / hardware.encoder_bandwidth(rig.scenario, rig.chain), words


#: Rules on the joints of a scenario.
JOINT_RULES = (springs, swinging, slow_decay, uncompensated, encoders, late_brake)
