"""Joint positions at which the loops are closed and the contacts touch: `reach`, then `close`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.outboard import columns_at
from osc_contact.errors import ModelError
from osc_contact.spatial import Array, pose_error

__all__ = ["Gaps", "close", "constraint_rows", "inverse_rows", "object_pose", "reach"]

#: Gaps (r,) and N (6, r) at a pose of the object: a gap closes as the object moves along N.
Gaps = Callable[[pin.SE3], tuple[Array, Array]]


def object_pose(chain: ClosedChain, q: Array) -> pin.SE3:
    """Pose of the object according to the first arm."""
    return _poses(chain, q)[0]


def reach(chain: ClosedChain, q: Array, X_WO: pin.SE3, tolerance: float = 1e-6) -> Array:
    """Bring every grasp as near to an object pose as the arms can (inverse kinematics).

    Levenberg–Marquardt on the energy-weighted pose errors, (object's inertia)½ × displacement.

    Args:
        chain: the arms. q: (n,) start. X_WO: wanted pose.
        tolerance: stop when a step moves no joint by more than this (m, rad).

    Raises:
        ModelError: no convergence; the pose is probably out of reach.
    """
    L = np.linalg.cholesky(chain.reference_inertia(X_WO))
    q = np.array(q, dtype=float)
    damping = 1e-3
    cost, step = _reach_step(chain, q, X_WO, L, damping)
    for _ in range(300):
        next_cost, next_step = _reach_step(chain, q + step, X_WO, L, 0.3 * damping)
        if next_cost <= cost:
            q = q + step
            if np.abs(step).max() < tolerance:
                return q
            damping = max(0.3 * damping, 1e-12)
            cost, step = next_cost, next_step
        else:
            damping *= 10.0
            cost, step = _reach_step(chain, q, X_WO, L, damping)
    raise ModelError(
        f"the arms do not reach the object at {np.round(X_WO.translation, 4)} m; energy-weighted "
        f"miss {np.sqrt(2 * cost):.3g}. Move the object, the bases, or give another posture."
    )


def close(
    chain: ClosedChain,
    q: Array,
    gaps: Gaps | None = None,
    tolerance: float = 1e-13,
    max_steps: int = 30,
) -> Array:
    """The nearest joint positions (in the arms' inertia metric) with closed loops and zero gaps.

    Args:
        chain: the arms. q: (n,) near solution.
        gaps: of the contacts at an object pose, and their N.
        tolerance: largest remaining error (m, rad).
        max_steps: Newton steps allowed.

    Raises:
        ModelError: the loops and contacts cannot be met together from here.
    """
    q = np.array(q, dtype=float)
    error = np.zeros(0)
    for _ in range(max_steps):
        pin.computeAllTerms(chain.model, chain.data, q, np.zeros(chain.nq))
        poses = _poses(chain, q, fresh=True)
        loops = [pose_error(poses[0], X) for X in poses[1:]]
        gap, N = gaps(poses[0]) if gaps is not None else (np.zeros(0), np.zeros((6, 0)))
        error = np.concatenate([*loops, gap])
        if np.abs(error).max(initial=0.0) <= tolerance:
            return q
        A = constraint_rows(chain, poses[0].translation, N)
        q = q - inverse_rows(A, chain.data.M, len(loops))[0] @ error
    if np.abs(error).max() <= 100 * tolerance:
        return q
    raise ModelError(
        f"the loops and contacts do not close: the largest error left is {np.abs(error).max():.3g} "
        "(m or rad). Start the object nearer to the contacts, or check grasps and faces."
    )


def constraint_rows(chain: ClosedChain, O: Array, N: Array) -> Array:  # noqa: E741
    """Rates of the loop errors (6 per further arm: arm 1 minus arm i) and of the gaps, times q̇.

    The rows match the errors of `close`: loop error i is the displacement from arm i's idea of the
    object to arm 1's, a gap shrinks as the object moves along N.
    """
    J = columns_at(chain.data.J, O)
    first = np.zeros((6, chain.nq))
    first[:, chain.slices[0]] = J[:, chain.slices[0]]
    rows = []
    for s in chain.slices[1:]:
        loop = first.copy()
        loop[:, s] -= J[:, s]
        rows.append(loop)
    rows.append(-N.T @ first)
    return np.vstack(rows)


def inverse_rows(A: Array, M: Array, loops: int) -> tuple[Array, Array]:
    """Right inverse and multipliers of redundant constraints A q̈ = b in the inertia metric.

    Args:
        A: (m, n) rows as `constraint_rows` orders them.
        M: (n, n) joint-space inertia.
        loops: number of closed loops; their 6 rows come first.

    Returns:
        (n, m) right inverse that solves A x = b with least xᵀM x, and the (m, m) map from b to
        multipliers λ with M x = Aᵀλ; of redundant rows the split is not unique, M x is.
    """
    white = np.linalg.solve(np.linalg.cholesky(M), A.T).T
    size = np.linalg.norm(white, axis=1)
    # the three rows of a vector share one scale: a locked direction has a zero row of its own
    vectors = size[: 6 * loops].reshape(-1, 3)
    size[: 6 * loops] = np.repeat(vectors.max(axis=1, initial=0.0), 3)
    U, s, Vh = np.linalg.svd(white / size[:, None], full_matrices=False)
    keep = s > 1e-8 * s.max(initial=0.0)
    U, s, Vh = U[:, keep] / size[:, None], s[keep], Vh[keep]
    right = np.linalg.solve(np.linalg.cholesky(M).T, (Vh.T / s) @ U.T)
    return right, (U / s**2) @ U.T


def _poses(chain: ClosedChain, q: Array, fresh: bool = False) -> list[pin.SE3]:
    if not fresh:
        pin.forwardKinematics(chain.model, chain.data, q)
    return chain.object_poses()


def _reach_step(
    chain: ClosedChain, q: Array, X_WO: pin.SE3, L: Array, damping: float
) -> tuple[float, Array]:
    pin.computeAllTerms(chain.model, chain.data, q, np.zeros(chain.nq))
    cost, step = 0.0, np.zeros(chain.nq)
    for X, s in zip(_poses(chain, q, fresh=True), chain.slices, strict=True):
        miss = L.T @ pose_error(X_WO, X)
        J = L.T @ columns_at(chain.data.J[:, s], X.translation)
        cost += 0.5 * float(miss @ miss)
        M = chain.data.M[s, s]
        step[s] = np.linalg.solve(J.T @ J + damping * M, J.T @ miss)
    return cost, step
