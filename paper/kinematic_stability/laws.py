"""The two position laws: joint torques, and the eigenvalues that decide about their stability."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.control.command_filter import command
from osc_contact.errors import InvalidInputError
from osc_contact.spans import left_inverse
from osc_contact.spatial import Array, as_array, classical_to_spatial, pose_error
from paper.kinematic_stability.arms import HybridArm

__all__ = [
    "DAMPING_S",
    "classic_eigenvalues",
    "classic_torque",
    "our_eigenvalues",
    "our_torque",
    "poles",
]

#: s: damping = this times stiffness, in both laws.
DAMPING_S = 0.08


def classic_eigenvalues(
    M: npt.ArrayLike, J: npt.ArrayLike, selection: npt.ArrayLike, K_q: npt.ArrayLike
) -> Array:
    """The s eigenvalues of M⁻¹K_q J⁻¹S J that position control owns, s = number selected.

    The n − s others are zero: nothing in this scheme stiffens the force-controlled directions.

    Args:
        M: (n, n) joint-space inertia. J: (n, n) Jacobian of the task coordinates.
        selection: (n,) flags, true where the coordinate is position-controlled.
        K_q: (n, n) joint stiffness (N m/rad).

    Returns:
        (s,) complex (1/s²), by ascending real part.

    Raises:
        InvalidInputError: wrong shapes, or a singular posture.
    """
    inertia = as_array("M", M, (None, None))
    n = len(inertia)
    jacobian, stiffness = as_array("J", J, (n, n)), as_array("K_q", K_q, (n, n))
    S = np.diag(as_array("selection", selection, (n,)))
    try:
        loop = np.linalg.solve(inertia, stiffness @ np.linalg.solve(jacobian, S @ jacobian))
    except np.linalg.LinAlgError as error:
        raise InvalidInputError("M or J is singular; the classic scheme needs J⁻¹") from error
    values = np.linalg.eigvals(loop).astype(complex)
    owned = np.argsort(np.abs(values))[n - int(np.count_nonzero(S)) :]
    return np.asarray(np.sort_complex(values[owned]))


def our_eigenvalues(T: npt.ArrayLike, B: npt.ArrayLike, K_prime: npt.ArrayLike) -> Array:
    """Eigenvalues of the stiffness seen along T, (TᵀB⁻¹T)⁻¹TᵀB⁻¹K T with K = B K′.

    Real and positive is what comes out, not what is put in: the matrix is not symmetric and is
    not treated as if it were similar to one.

    Args:
        T: (6, s) permitted motions.
        B: (6, 6) symmetric positive definite metric of eq. 24.
        K_prime: (6, 6) symmetric positive definite stiffness (N/m, N m/rad); scalar gains k are
            K′ = k B⁻¹.

    Returns:
        (s,) complex (1/s²), by ascending real part.

    Raises:
        InvalidInputError: wrong shapes, or B or K′ is not symmetric positive definite.
    """
    metric, K = _definite("B", B), _definite("K_prime", K_prime)
    tangents = as_array("T", T, (6, None))
    along = left_inverse(tangents, np.linalg.inv(metric), "stiffness along T")
    loop = along @ (metric @ K) @ tangents
    return np.asarray(np.sort_complex(np.linalg.eigvals(loop)).astype(complex))


def poles(eigenvalues: Array) -> Array:
    """Roots (2s,) of z² + DAMPING_S λ z + λ: the poles (1/s) that the eigenvalues λ (s,) give.

    The two roots of one λ add up to −DAMPING_S λ: Re λ < 0 is unstable for every such damping.
    """
    half = -0.5 * DAMPING_S * eigenvalues
    root = np.sqrt(half**2 - eigenvalues.astype(complex))
    return np.asarray(np.sort_complex(np.concatenate((half - root, half + root))))


def classic_torque(arm: HybridArm, q: Array, v: Array, goal: pin.SE3) -> Array:
    """τ = h − K_q J⁻¹S(x + DAMPING_S ẋ), x the tip's task coordinates from the goal, h exact.

    Args:
        arm: of the experiment.
        q, v: (n,) joint positions (rad) and velocities (rad/s).
        goal: pose that the tip is held at.

    Returns:
        (n,) joint torques (N m).
    """
    _, J_tip, tip = arm.terms(q)
    J = J_tip[list(arm.rows)]
    x = -pose_error(goal, tip)[list(arm.rows)]
    q_e = np.linalg.solve(J, arm.selection * (x + DAMPING_S * (J @ v)))
    bias = pin.nonLinearEffects(arm.plant, arm.data, q, v)
    return np.asarray(bias - arm.K_q @ q_e)


def our_torque(arm: HybridArm, q: Array, v: Array, goal: pin.SE3) -> Array:
    """The control law of this package (eqs. 21, 24), a_u = −B K′(x + DAMPING_S ẋ), force 0.

    Args:
        arm, q, v, goal: as of `classic_torque`.

    Returns:
        (n,) joint torques (N m).
    """
    state = arm.chain.state(q, v)
    contact = arm.pair.contact(state.X_WO, state.V_O)
    B = np.linalg.inv(state.metric)
    x = -pose_error(goal, state.X_WO)
    a_u = classical_to_spatial(-B @ arm.K_prime @ (x + DAMPING_S * state.V_O), state.V_O)
    _, f_S = command(state, contact, a_u, np.zeros(1))
    return np.asarray(np.linalg.solve(state.G, f_S))  # as many motors as motions


def _definite(name: str, value: npt.ArrayLike) -> Array:
    matrix = as_array(name, value, (6, 6))
    diagonal = np.diag(matrix)
    if diagonal.min() > 0.0:
        scaled = matrix / np.sqrt(np.outer(diagonal, diagonal))
        if np.abs(scaled - scaled.T).max() < 1e-9 and np.linalg.eigvalsh(scaled)[0] > 0.0:
            return matrix
    raise InvalidInputError(f"{name} must be symmetric positive definite; its diagonal: {diagonal}")
