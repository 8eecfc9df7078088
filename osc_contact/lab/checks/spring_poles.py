"""Oscillations of flexible joints under the sampled law: poles of the linear closed loop.

The loop is linearised at rest. Its state has links, motors, joint torque loop, estimated positions
and speeds, force integral and the torques that are held between two ticks. Between the readings of
the joint torque loop the arm moves by the exponential of its equations of motion; the product over
a period of the controller gives the poles. Motions of a frequency below `LOWEST` times that of the
motion loop are left out: gravity and the integral of the motion loop matter there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from osc_contact import projections
from osc_contact.control.accelerations import expected_acceleration
from osc_contact.control.controller import Controller
from osc_contact.control.joint_torque import JointTorqueLoop
from osc_contact.control.status import Phase
from osc_contact.interface import Measurement, Touched
from osc_contact.lab.rig import hardware
from osc_contact.lab.rig.rig import Rig
from osc_contact.spatial import Array

LOWEST = 2.0  #: lowest frequency that counts, over that of the motion loop
_STEPS = (1e-5, 1e-4)  #: changes of positions (rad, m) and speeds by which the law is linearised
_FORGOTTEN = 1e-9  #: size of the poles of states that are replaced in each period


@dataclass(frozen=True)
class Oscillation:
    """The slowest oscillation of a rig with flexible joints.

    Attributes:
        decay: rate of its decay (1/s); negative: it grows.
        hertz: frequency (Hz), below half of the controller's rate.
        approaching: whether it is one of the arms that approach their contacts; else these are
            closed.
    """

    decay: float
    hertz: float
    approaching: bool


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


def slowest_oscillation(rig: Rig) -> Oscillation:
    """Find the slowest oscillation with closed contacts, and where these are approached.

    Args:
        rig: rig of a scenario with flexible joints.
    """
    found = [_slowest(rig, approaching=False)]
    controller, measured = trial_controller(rig)
    for _ in range(2):
        controller.tick(measured, rig.references.at(0.0))
    if (controller.phases() == Phase.APPROACHING).any():
        found.append(_slowest(rig, approaching=True))
    return min(found, key=lambda one: one.decay)


def _slowest(rig: Rig, approaching: bool) -> Oscillation:
    lowest = 2.0 * np.pi * LOWEST * rig.gains.motion.frequency
    s = np.concatenate([poles(rig, approaching, share) for share in _shares(rig)])
    s = s[s.imag > lowest]
    if not len(s):
        return Oscillation(np.inf, 0.0, approaching)
    slowest = s[np.argmax(s.real)]
    return Oscillation(-float(slowest.real), float(slowest.imag) / (2.0 * np.pi), approaching)


def _shares(rig: Rig) -> tuple[float, ...]:
    """Shares of the expected acceleration that estimates of speeds may learn, the ends of them.

    Without encoders nothing is estimated.
    """
    return (1.0,) if rig.scenario.sensors.encoder is None else (0.0, 1.0)


def poles(rig: Rig, approaching: bool, share: float = 1.0) -> Array:
    """Poles (complex, 1/s) of the closed loop.

    Args:
        rig: rig of a scenario with flexible joints.
        approaching: whether the contacts are approached, and exert no force; else they are closed
            and rigid.
        share: share of the expected acceleration that the estimates of speeds count on.
    """
    period = 1.0 / rig.scenario.control.rate
    drive = Drive.of(rig, permitted_motions(rig, approaching), approaching)
    loop = hardware.torque_loop(rig.scenario, rig.chain, rig.springs)
    state = _State(drive, with_loop=loop is not None)
    step = period if loop is None else loop.dt
    held = np.linalg.matrix_power(_held(drive, state, loop, step), round(period / step))
    z = np.linalg.eigvals(held @ _tick(rig, drive, state, share)).astype(complex)
    return np.log(z[np.abs(z) > _FORGOTTEN]) / period


# --- Arms -----------------------------------------------------------------------------------------


def permitted_motions(rig: Rig, approaching: bool) -> Array:
    """Motions (n, m) of the joints that loops and closed contacts permit, of unit inertia.

    They are those of the object, W Y with YᵀΛ_S Y = 1, of which closed contacts permit NᵀS Y = 0,
    and those of each arm alone, with the object at rest.

    Args:
        rig: rig of the scenario.
        approaching: whether the contacts are open.
    """
    state = rig.state
    L = np.linalg.cholesky(state.Lambda_S)
    free = np.eye(state.d)
    if rig.pairs and not approaching:
        N = rig.contact.N
        _, _, G = projections.orthonormal(N, state.Phi, "contacts")
        # with (NᵀΦN)⁻¹ = GGᵀ the columns of L⁻¹SᵀN G are orthonormal
        columns = np.linalg.solve(L, state.S.T @ N @ G)
        free = np.linalg.svd(columns)[0][:, columns.shape[1] :]
    motions = [state.W @ np.linalg.solve(L.T, free)]
    for arm, joints in zip(state.arms, rig.chain.slices, strict=True):
        K = np.linalg.cholesky(arm.M)
        directions = np.linalg.svd(np.linalg.solve(K, arm.J.T @ arm.N).T)[2][arm.rank :].T
        own = np.zeros((rig.chain.nq, directions.shape[1]))
        own[joints] = np.linalg.solve(K.T, directions)
        motions.append(own)
    return np.hstack(motions)


@dataclass(frozen=True)
class Drive:
    """Links, springs, motors and closed contacts: ẏ = A y + B u, with the motor torques u.

    y has positions and speeds of the m motions and of the n_a motors, and for each of the r closed
    contact forces the reading of it, which is late, and its integral.

    Attributes:
        motions: (n, m) motions of the joints.
        A, B: matrices.
        springs: (n_a, ·) torques of the springs on the links, of y.
        pushes: (n_a, r) torques of commanded contact forces.
        m, n_a, r: counts.
    """

    motions: Array
    A: Array
    B: Array
    springs: Array
    pushes: Array
    m: int
    n_a: int
    r: int

    @classmethod
    def of(cls, rig: Rig, motions: Array, approaching: bool) -> Drive:
        """Make the equations of motion of a rig.

        Args:
            rig: rig with springs.
            motions: (n, m) motions of the joints, of unit inertia.
            approaching: whether the contacts exert no force.
        """
        joints = rig.springs
        assert joints is not None
        chain = rig.chain
        m, n_a = motions.shape[1], chain.n_a
        r = 0 if approaching else rig.contact.N.shape[1]
        of_motors = motions[chain.actuated]
        stretch = np.hstack([of_motors, -np.eye(n_a)])
        damping = np.zeros((m + n_a, m + n_a))
        damping[m:, m:] = np.diag(chain.model.damping[chain.actuated])
        springs = np.zeros((n_a, 2 * (m + n_a) + 2 * r))
        springs[:, : m + n_a] = -joints.stiffness[:, None] * stretch
        springs[:, m + n_a : 2 * (m + n_a)] = -joints.damping[:, None] * stretch
        inverse = np.concatenate([np.ones(m), 1.0 / joints.motor_inertia])
        A = np.zeros((springs.shape[1],) * 2)
        speeds = slice(m + n_a, 2 * (m + n_a))
        A[: m + n_a, speeds] = np.eye(m + n_a)
        A[speeds] = inverse[:, None] * (stretch.T @ springs)
        A[speeds, speeds] -= inverse[:, None] * damping
        B = np.zeros((len(A), n_a))
        B[m + n_a + m : 2 * (m + n_a)] = np.diag(1.0 / joints.motor_inertia)
        pushes = np.zeros((n_a, r))
        if r:
            forces, pushes = _contact_forces(rig)
            read, total = slice(-2 * r, -r), slice(-r, None)
            A[read] = forces @ springs / _age_of_forces(rig)
            A[read, read] -= np.eye(r) / _age_of_forces(rig)
            A[total, read] = -rig.gains.force.integral * np.eye(r)
        return cls(motions, A, B, springs, pushes, m, n_a, r)


def _contact_forces(rig: Rig) -> tuple[Array, Array]:
    """Forces α of closed contacts by torques on the links, and torques that command forces.

    α = (NᵀΦN)⁻¹NᵀS Λ_S⁻¹W_aᵀ τ.

    Args:
        rig: rig with contacts.

    Returns:
        Matrices (r, n_a) and (n_a, r).
    """
    state, chain, N = rig.state, rig.chain, rig.contact.N
    _, _, G = projections.orthonormal(N, state.Phi, "contacts")
    S_N = state.S.T @ N
    forces = G @ G.T @ np.linalg.solve(state.Lambda_S, S_N).T @ state.W[chain.actuated].T
    limits = np.minimum(chain.tau_max, 1e12)
    return forces, np.linalg.pinv(state.G * limits) * limits[:, None] @ S_N


def _age_of_forces(rig: Rig) -> float:
    """Mean age (s) of the forces that the law reads: delay, and half a period of the wrists."""
    wrist = rig.scenario.sensors.wrist
    period = 1.0 / rig.scenario.control.rate
    return period if wrist is None else max(wrist.delay + 0.5 / wrist.rate, period)


# --- Controller -----------------------------------------------------------------------------------


class _State:
    """State of the closed loop: the rows of the identity that select its parts.

    Attributes:
        size: its length.
        drive: y of `Drive`.
        loop: two states of each joint's estimated rate of the torque (none without the loop).
        q, v, a: estimated positions, speeds and unknown accelerations of the motions.
        tau, expected: torques (n_a,) and expected accelerations (m,) of the last tick.
    """

    def __init__(self, drive: Drive, with_loop: bool) -> None:
        """Lay out the state.

        Args:
            drive: the arms.
            with_loop: whether there is a joint torque loop.
        """
        m, n_a = drive.m, drive.n_a
        sizes = (len(drive.A), 2 * n_a if with_loop else 0, m, m, m, n_a, m)
        self.size = sum(sizes)
        parts = np.split(np.eye(self.size), np.cumsum(sizes)[:-1])
        self.drive, self.loop, self.q, self.v, self.a, self.tau, self.expected = parts


def _held(drive: Drive, state: _State, loop: JointTorqueLoop | None, step: float) -> Array:
    """Transition of the state over a period in which the motor torques are constant.

    Args:
        drive: the arms.
        state: the state.
        loop: the joint torque loop, or None.
        step: its period, or that of the controller (s).
    """
    from scipy.linalg import expm

    count = len(drive.A)
    rates = np.zeros((count + drive.n_a,) * 2)
    rates[:count] = np.hstack([drive.A, drive.B])
    moves = expm(step * rates)[:count]
    motors, rate = state.tau, state.loop
    if loop is not None:
        spring_torque = drive.springs @ state.drive
        estimate = loop.torque_rate
        guess, slope = np.split(state.loop, 2)
        innovation = spring_torque - guess - step * slope
        guess = guess + step * slope + estimate.alpha[:, None] * innovation
        slope = slope + (estimate.beta / step)[:, None] * innovation
        error = state.tau - spring_torque
        motors = state.tau + loop.gain * error - loop.rate_gain[:, None] * slope
        rate = np.vstack([guess, slope])
    moved = moves[:, :count] @ state.drive + moves[:, count:] @ motors
    return np.vstack([moved, rate, state.q, state.v, state.a, state.tau, state.expected])


def _tick(rig: Rig, drive: Drive, state: _State, share: float) -> Array:
    """Transition of the state by a tick of the controller.

    Estimates are those of `sensing.velocity_estimate` with the gains of the coarsest encoder.

    Args:
        rig: rig of the scenario.
        drive: the arms.
        state: the state.
        share: share of the expected acceleration that the estimates count on.
    """
    m = drive.m
    period = 1.0 / rig.scenario.control.rate
    q = state.drive[:m]
    v = state.drive[m + drive.n_a : 2 * m + drive.n_a]
    a = state.a
    if rig.scenario.sensors.encoder is not None:
        known = hardware.encoders(rig.scenario, rig.chain)
        estimate = replace(known, sample=period).estimate(period, learning=rig.measured_forces)
        total = share * state.expected + state.a
        guess = state.q + period * state.v + 0.5 * period**2 * total
        innovation = q - guess
        gains = [float(np.min(x)) for x in (estimate.alpha, estimate.beta, estimate.gamma)]
        q = guess + gains[0] * innovation
        v = state.v + period * total + gains[1] / period * innovation
        a = state.a + gains[2] / period**2 * innovation
    by_q, by_v = law_derivatives(rig, drive.motions)
    tau, expected = np.split(by_q @ q + by_v @ v, [drive.n_a])
    if drive.r:
        tau = tau + drive.pushes @ state.drive[-drive.r :]
    # accelerations of the joints are those of the motions, of which there are no more than joints
    acceleration = np.linalg.lstsq(drive.motions, expected, rcond=None)[0]
    return np.vstack([state.drive, state.loop, q, v, a, tau, acceleration])


def law_derivatives(rig: Rig, motions: Array) -> tuple[Array, Array]:
    """Derivatives (n_a + n, m) of the law's torques and expected accelerations, by differences.

    They are by positions and speeds along motions of the joints, at the second tick at rest: since
    the first one the contacts are approached or closed.

    Args:
        rig: rig of the scenario.
        motions: (n, m).
    """
    still = np.zeros(len(motions))

    def outputs(q: Array, v: Array) -> Array:
        controller, measured = trial_controller(rig)
        controller.tick(measured, rig.references.at(0.0))
        moved = replace(measured, q=measured.q + q, v=v)
        tau = controller.tick(moved, rig.references.at(0.0))
        if rig.measured_forces:
            return np.concatenate([tau, expected_acceleration(controller)])
        return np.concatenate([tau, controller.joint_acceleration()])

    by_q, by_v = [], []
    for direction in motions.T:
        position, speed = np.array(_STEPS) / np.abs(direction).max()
        change = outputs(position * direction, still) - outputs(-position * direction, still)
        by_q.append(change / (2.0 * position))
        change = outputs(still, speed * direction) - outputs(still, -speed * direction)
        by_v.append(change / (2.0 * speed))
    return np.array(by_q).T, np.array(by_v).T
