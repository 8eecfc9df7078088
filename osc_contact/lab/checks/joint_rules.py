"""Checks of a task before it runs: springs, dry friction and encoders of the joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.dynamics.chain_state import modes
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Touched
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
_LATE = 1.5  #: periods of the controller between a reading and the middle of its torque
_STEPS = (1e-5, 1e-4)  #: changes of positions (rad, m) and speeds by which the law is linearised
_TURNS = 4  #: evaluations of a feedback with delays until its poles have converged
_NEAR = 0.2  #: largest change of a mode's frequency by feedback, as a share of it


def trial_controller(rig: Rig) -> tuple[Controller, Measurement]:
    """Controller of a scenario with its contacts engaged, and a measurement at rest in contact.

    Args:
        rig: rig of the scenario.
    """
    controller = rig.controller()
    controller.engaged = True
    count = len(rig.pairs)
    still = np.zeros((count, 6))
    return controller, Measurement(
        rig.q_contact,
        np.zeros(rig.chain.nq),
        np.zeros((len(rig.chain.arms), 6)),
        touched=Touched(np.tile(np.eye(4), (count, 1, 1)), still, still),
    )


# --- Springs --------------------------------------------------------------------------------------


def _are_open(rig: Rig) -> bool:
    """Test whether joints have springs, and no joint torque loop produces the commanded torques."""
    has_loop = rig.scenario.control.joint_torque is not None
    return not any(springs.findings(rig)) and not has_loop and rig.springs is not None


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
    if _are_open(rig) and not _all_motors_have_friction(rig):
        assert rig.springs is not None
        frequencies = modes(rig.state, rig.chain.actuated, rig.springs.stiffness)
        first = frequencies[frequencies > 0.0].min(initial=np.inf)
        yield -first, {"first": first, "rate": 1e-3 / rig.scenario.plant.step}


@doubt(
    "an oscillation of the joint springs at {hertz:.3g} Hz decays at no more than {decay:.2g} 1/s "
    "(negative: it grows), and no joint torque loop produces the commanded torques: contact may be "
    "lost; set control.joint_torque={{rate: {rate:g} kHz}}, or lower gains.motion.frequency",
    -_DECAY,
)
def slow_decay(rig: Rig) -> Values:
    """Slowest decay of oscillations of flexible joints without a torque loop, negated (−1/s).

    It is negated because a slow decay is the finding, and rules compare with upper limits. It is
    looked at where all motors have dry friction: without, contacts are lost at higher frequencies
    than the modes of `spring_decay` have (`swinging`).

    Args:
        rig: rig of the scenario.
    """
    if _are_open(rig) and _all_motors_have_friction(rig):
        decay, hertz = spring_decay(rig)
        yield -decay, {"hertz": hertz, "decay": decay, "rate": 1e-3 / rig.scenario.plant.step}


def spring_decay(rig: Rig) -> tuple[float, float]:
    """Compute the slowest decay (1/s) of oscillations of flexible joints, and its frequency (Hz).

    Links move by P η, the motions that rigid contacts permit, and motors by θ (n_a,), against
    springs with the deflection W_a P η − θ. With the masses M, stiffnesses K and dampings D of
    x = (η, θ), poles s are those of

        s² M x + s D x + K x = (0, F(s) x),

    where F(s) has the torques of the law, linearised at rest in contact: by readings of the links,
    later by the lag of estimated speeds, and by the integral of the contact forces α that the
    springs' forces f make, K_i/s of α = (NᵀΦN)⁻¹NᵀS Λ_S⁻¹W_aᵀf; all later by the delay of the
    controller. From each natural frequency of M and K on, F is evaluated at the last s, until s is
    a pole.

    Args:
        rig: rig of a scenario with flexible joints.

    Returns:
        Decay (negative: the oscillation grows) and frequency.
    """
    state = rig.state
    chain = rig.chain
    joint_springs = rig.springs
    assert joint_springs is not None
    N = rig.contact.N
    S_N = state.S.T @ N
    d = state.d
    W_a = state.W[chain.actuated]
    # inverse of NᵀΦN; where columns depend on each other, SᵀN α is unique all the same
    NPhiN_inv = np.linalg.pinv(N.T @ state.Phi @ N, hermitian=True)
    P = np.eye(d) - np.linalg.solve(state.Lambda_S, S_N @ NPhiN_inv @ S_N.T)
    deflection = np.hstack([W_a @ P, -np.eye(chain.n_a)])
    K = deflection.T @ (joint_springs.stiffness[:, None] * deflection)
    D = deflection.T @ (joint_springs.damping[:, None] * deflection)
    D[d:, d:] += np.diag(chain.model.damping[chain.actuated])
    M = np.diag(np.concatenate([np.zeros(d), joint_springs.motor_inertia]))
    M[:d, :d] = state.Lambda_S
    # contact forces of the springs' forces, and torques that command contact forces
    alpha_of_springs = NPhiN_inv @ np.linalg.solve(state.Lambda_S, S_N).T @ W_a.T
    limits = np.minimum(chain.tau_max, 1e12)
    tau_of_alpha = np.linalg.pinv(state.G * limits) * limits[:, None] @ S_N
    by_q, by_v = _torque_derivatives(rig)
    wrist = rig.scenario.sensors.wrist
    wrist_delay = 0.0 if wrist is None else wrist.delay
    late = _LATE / rig.scenario.control.rate

    def feedback(s: complex) -> Array:
        """F(s) (n_a, d + n_a)."""
        of_q, of_v = _encoder_transfer(rig, s)
        springs_of_x = (joint_springs.stiffness + s * joint_springs.damping)[:, None] * deflection
        integral = rig.gains.force.integral / s * np.exp(-s * wrist_delay)
        F = integral * (tau_of_alpha @ alpha_of_springs @ springs_of_x)
        F[:, :d] += (by_q * of_q + s * by_v * of_v) @ P
        return F * np.exp(-s * late)

    slowest = (np.inf, 0.0)
    for omega in _natural_frequencies(M, K):
        pole = _pole_near(1j * omega, M, D, K, feedback)
        slowest = min(slowest, (-float(pole.real), abs(float(pole.imag)) / (2.0 * np.pi)))
    return slowest


def _natural_frequencies(M: Array, K: Array) -> Array:
    """Natural frequencies (rad/s) of masses on springs, without those of motions without springs.

    Args:
        M, K: (m, m) masses and stiffnesses.
    """
    L_inv = np.linalg.inv(np.linalg.cholesky(M))
    squares = np.linalg.eigvalsh(L_inv @ K @ L_inv.T)
    # the others are of the whole rig, or locked by contacts
    return np.sqrt(squares[squares > 1e-9 * squares[-1]])


def _pole_near(
    s: complex, M: Array, D: Array, K: Array, feedback: Callable[[complex], Array]
) -> complex:
    """The pole of a mode with the feedback of its motors: of several near ones the least damped.

    Args:
        s: j times the natural frequency of the mode (rad/s).
        M, D, K: (m, m) masses, dampings and stiffnesses.
        feedback: function that returns F(s) (n_a, m) of the last n_a coordinates.
    """
    m = len(M)
    omega = abs(s)
    for turn in range(_TURNS):
        F = feedback(s)
        A = np.zeros((2 * m, 2 * m), complex)
        A[:m, m:] = np.eye(m)
        A[m:, :m] = -K
        A[2 * m - len(F) :, :m] += F
        A[m:, m:] = -D
        A[m:] = np.linalg.solve(M, A[m:])
        poles = np.linalg.eigvals(A)
        if turn == 0:
            near = poles[np.abs(poles.imag - omega) < _NEAR * omega]
            s = near[np.argmax(near.real)] if len(near) else s
        else:
            s = poles[np.argmin(np.abs(poles - s))]
    return s


def _torque_derivatives(rig: Rig) -> tuple[Array, Array]:
    """Derivatives (n_a, d) of the law's torques by position and speed along the motions η.

    They are central differences of the first tick at rest in contact.

    Args:
        rig: rig of the scenario.
    """
    W = rig.state.W
    still = np.zeros(len(W))

    def torques(q: Array, v: Array) -> Array:
        controller, measured = trial_controller(rig)
        moved = replace(measured, q=measured.q + q, v=v)
        return controller.tick(moved, rig.references.at(0.0))

    by_q, by_v = [], []
    for direction in W.T:
        position, speed = np.array(_STEPS) / np.abs(direction).max()
        change = torques(position * direction, still) - torques(-position * direction, still)
        by_q.append(change / (2.0 * position))
        change = torques(still, speed * direction) - torques(still, -speed * direction)
        by_v.append(change / (2.0 * speed))
    return np.array(by_q).T, np.array(by_v).T


def _encoder_transfer(rig: Rig, s: complex) -> tuple[complex, complex]:
    """Transfer functions at s (rad/s) of positions and speeds that are estimated from encoders.

    An α-β filter of bandwidth ω has (√2 ω s + ω²)/(s² + √2 ω s + ω²) and ω²/(s² + √2 ω s + ω²).

    Args:
        rig: rig of the scenario.
        s: complex frequency.
    """
    if rig.scenario.sensors.encoder is None:
        return 1.0, 1.0
    omega = hardware.encoder_bandwidth(rig.scenario, rig.chain)
    lag = np.sqrt(2.0) * omega * s
    common = s**2 + lag + omega**2
    return (lag + omega**2) / common, omega**2 / common


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
