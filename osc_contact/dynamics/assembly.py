"""Joint positions that reach a pose, close the loops and contacts, or are within their limits."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pinocchio import SE3

from osc_contact.dynamics.closed_chain import ClosedChain, columns_at
from osc_contact.dynamics.grasp import moved
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.robots.model import position_limits
from osc_contact.spatial import Array, as_array, block_diagonal, pose_error

#: Function of the object's pose that returns the gaps (r,) (m, rad) of the contacts and a function
#: that returns the columns N (6, r) in that pose. A motion of the object along a column closes its
#: gap.
Gaps = Callable[[SE3], tuple[Array, Callable[[], Array]]]


def _no_gaps(X_WO: SE3) -> tuple[Array, Callable[[], Array]]:
    """Gaps () and columns (6, 0) of an object without contacts, as a function of type `Gaps`."""
    return (np.zeros(0), partial(np.zeros, (6, 0)))


def object_pose(chain: ClosedChain, q: Array, data: pin.Data | None = None) -> SE3:
    """Compute the pose of the object at joint positions q.

    Args:
        chain: the arms.
        q: (n,) joint positions (rad, m).
        data: memory of Pinocchio; None: the chain's own.

    Raises:
        ModelError: the joints do not determine the pose.
    """
    pin.forwardKinematics(chain.model, data or chain.data, q)
    return chain.object_pose(data)


def reach(chain: ClosedChain, q: ArrayLike, X_WO: SE3, tolerance: float = 1e-6) -> Array:
    """Compute joint positions (n,) whose grasps are nearest to an object pose (inverse kinematics).

    Levenberg–Marquardt on the energy-weighted pose errors, square root of the object's inertia
    times displacement, within the joints' limits: a joint at its end stop stays there if a step
    would pass it.

    Args:
        chain: the arms.
        q: (n,) start (rad, m); joints outside their limits start at the limits.
        X_WO: desired pose.
        tolerance: largest joint displacement of the last step (m, rad).

    Raises:
        InvalidInputError: q has another shape, or is not finite.
        ModelError: no convergence; the pose is probably out of reach.
    """
    L = np.linalg.cholesky(chain.reference_inertia(X_WO))
    limits = position_limits(chain.model)
    present: Array = np.clip(as_array("q", q, (chain.nq,)), *limits)
    damping = 1e-3
    cost, step = _reach_step(chain, present, X_WO, L, damping)
    for _ in range(300):
        following = np.clip(present + step, *limits)
        next_cost, next_step = _reach_step(chain, following, X_WO, L, 0.3 * damping)
        if next_cost <= cost:
            if np.abs(following - present).max() < tolerance:
                return following
            damping = max(0.3 * damping, 1e-12)
            present = following
            cost = next_cost
            step = next_step
        else:
            damping *= 10.0
            cost, step = _reach_step(chain, present, X_WO, L, damping)
    raise ModelError(
        f"the arms do not reach the object at {np.round(X_WO.translation, 4)} m; energy-weighted "
        f"miss {np.sqrt(2 * cost):.3g}. Move the object, the bases, or give another posture."
    )


CLOSED = 1e-13  #: largest remaining error of loops and contacts (m, rad)
MOST_STEPS = 30  #: largest number of steps of Newton's method


def close(chain: ClosedChain, q: ArrayLike, gaps: Gaps | None = None) -> Array:
    """Compute the nearest joint positions (n,) with closed loops of arms and zero gaps.

    Each step of Newton's method is the least step in the arms' inertia metric.

    Args:
        chain: the arms.
        q: (n,) approximate solution (rad, m).
        gaps: gaps of the contacts and their N at an object pose; None: no contacts.

    Raises:
        InvalidInputError: q has another shape, or is not finite.
        ModelError: Newton's method does not converge from here.
    """
    return closed(chain, as_array("q", q, (chain.nq,)), None, gaps)[0]


def closed(chain: ClosedChain, q: Array, X_WO: SE3 | None, gaps: Gaps | None) -> tuple[Array, SE3]:
    """Compute the nearest joint positions (n,) with closed loops and zero gaps, and the pose.

    Newton's method; if no arm holds the object rigidly, the object's pose is a further unknown.

    Args:
        chain: the arms.
        q: (n,) approximate solution (rad, m).
        gaps: function of the object's pose that returns gaps of the contacts (m) and a function for
            their N; None: no contacts.
        X_WO: initial pose of the object, if no arm determines it; None: that of the joints.

    Raises:
        ModelError: no convergence; or the joints do not determine the pose, and it is not given.
    """
    q = np.array(q, dtype=float)
    X = X_WO
    for _ in range(MOST_STEPS):
        pin.computeAllTerms(chain.model, chain.data, q, np.zeros(chain.nq))
        if X is None or chain.leader is not None:
            X = chain.object_pose()
        gap, normals = _no_gaps(X) if gaps is None else gaps(X)
        error = np.concatenate([*_loop_errors(chain, X), gap])
        if np.abs(error).max(initial=0.0) <= CLOSED:
            return (q, X)
        A = constraint_rows(chain, X.translation, normals())
        step = inverse_rows(chain, A, inertia_of(chain, X))[0] @ error
        q = q - step[: chain.nq]
        if chain.leader is None:
            X = moved(X, -step[chain.nq :])
    remaining = np.abs(error).max()
    if remaining <= 100 * CLOSED:  # the accuracy of this problem is worse, by rounding errors
        assert X is not None
        return (q, X)
    raise ModelError(
        f"the loops and contacts do not close: the largest error left is {remaining:.3g} "
        "(m or rad). Start the object nearer to the contacts, or check grasps and faces"
    )


def _loop_errors(chain: ClosedChain, X_WO: SE3) -> list[Array]:
    """Compute the pose error (m, rad) between each arm but the leader and the object.

    They are in the order of `constraint_rows`.

    Args:
        chain: the arms, at the positions last given to its data.
        X_WO: pose of the object.
    """
    tips = chain.tip_poses()
    errors = []
    for i, grasp in enumerate(chain.grasps):
        if i == chain.leader:
            continue
        if grasp.is_rigid:
            errors.append(pose_error(X_WO, tips[i] * grasp.X_TO))
        else:
            errors.append(grasp.miss(tips[i], X_WO))
    return errors


def object_columns(chain: ClosedChain, J: Array) -> Array:
    """Matrix that maps q̇ to V_O: (6, n) by the leader's joints or, without a leader, (6, n + 6).

    Without a leader V_O is part of the coordinates [q̇; V_O].

    Args:
        chain: the arms.
        J: (6, n) Jacobian columns of all arms at the object's origin.
    """
    if chain.leader is None:
        return np.hstack((np.zeros((6, chain.nq)), np.eye(6)))
    columns = np.zeros((6, chain.nq))
    joints = chain.slices[chain.leader]
    columns[:, joints] = J[:, joints]
    return columns


def inertia_of(chain: ClosedChain, X_WO: SE3) -> Array:
    """Inertia of the rates that close the chain: M (n, n) of q̇, or (n + 6, n + 6) of [q̇; V_O].

    The second is without a leader, an arm that holds the object rigidly: then the twist V_O of the
    object is a coordinate, too, with its inertia (6, 6) at its origin in world axes.

    Args:
        chain: the arms, with M in its data.
        X_WO: pose of the object.
    """
    M = np.asarray(chain.data.M)
    if chain.leader is not None:
        return M
    return block_diagonal([M, chain.reference_inertia(X_WO)])


def constraint_rows(
    chain: ClosedChain,
    O: Array,  # noqa: E741
    N: Array,
    data: pin.Data | None = None,
) -> Array:
    """Jacobian of the loop errors (of each arm but the leader) and of the gaps.

    The rows match the errors of `close`: the error of a loop is the displacement from the object's
    pose by arm i to its pose, as far as the grasp holds the object; a gap shrinks as the object
    moves along N. The columns belong to q̇ (n,) or, without a leader, to [q̇; V_O].

    Args:
        chain: the arms.
        O: (3,) operational point (m).
        N: (6, r) contact forces at O, world axes.
        data: data of Pinocchio with the Jacobians; None: the chain's own.
    """
    J = columns_at((chain.data if data is None else data).J, O)
    first = object_columns(chain, J)
    tips = chain.tip_poses(data)
    rows = []
    for i, grasp in enumerate(chain.grasps):
        if i != chain.leader:
            joints = chain.slices[i]
            loop = first.copy()
            loop[:, joints] -= J[:, joints]
            rows.append(loop if grasp.is_rigid else grasp.wrenches_at(tips[i], O).T @ loop)
    return np.vstack([*rows, -N.T @ first])


def _row_groups(chain: ClosedChain) -> list[int]:
    """Sizes of the groups of consecutive loop rows that share a unit and a scale.

    Rows of forces and of couples of a grasp are two groups; those of a grasp of kind "other", which
    mix both, are one group.

    Args:
        chain: chain of arms and object.
    """
    groups = []
    for i, grasp in enumerate(chain.grasps):
        if i == chain.leader:
            continue
        rows = grasp.N.shape[1]
        if grasp.kind == "other" or rows <= 3:
            groups.append(rows)
        else:
            groups += [3, rows - 3]
    return groups


def inverse_rows(chain: ClosedChain, A: Array, M: Array) -> tuple[Array, Array]:
    """Compute right inverse and multipliers of redundant constraints A q̈ = b in the inertia metric.

    Args:
        chain: the arms, whose loop rows come first.
        A: (m, n) rows in the order of `constraint_rows`.
        M: (n, n) joint-space inertia.

    Returns:
        The right inverse (n, m) that solves A x = b with least xᵀM x, and the matrix (m, m) that
        maps b to multipliers λ with M x = Aᵀλ. λ of redundant rows is not unique, M x is.
    """
    K = np.linalg.cholesky(M)
    whitened = np.linalg.solve(K, A.T).T
    size = np.linalg.norm(whitened, axis=1)
    # the rows of a group share one scale, so that the zero row of a locked direction stays zero
    start = 0
    for count in _row_groups(chain):
        size[start : start + count] = size[start : start + count].max()
        start += count
    U, s, Vh = np.linalg.svd(whitened / size[:, None], full_matrices=False)
    keep = s > 1e-8 * s.max(initial=0.0)
    s = s[keep]
    U = U[:, keep] / size[:, None]
    return (np.linalg.solve(K.T, (Vh[keep].T / s) @ U.T), (U / s**2) @ U.T)


def _reach_step(
    chain: ClosedChain, q: Array, X_WO: SE3, L: Array, damping: float
) -> tuple[float, Array]:
    """Compute cost and step of Levenberg–Marquardt at q, towards a desired pose of the object.

    Args:
        chain: the arms.
        q: (n,) joint positions within their limits (rad, m).
        X_WO: desired pose.
        L: (6, 6) Cholesky factor of the object's inertia at the desired pose.
        damping: factor of M, which is added to the Hessian.

    Returns:
        Half of the sum of squared energy-weighted errors (kg m²), and the step (n,), zero for
        joints at an end stop that it would pass.
    """
    pin.computeAllTerms(chain.model, chain.data, q, np.zeros(chain.nq))
    cost = 0.0
    step = np.zeros(chain.nq)
    for tip, grasp, joints in zip(chain.tip_poses(), chain.grasps, chain.slices, strict=True):
        if grasp.is_rigid:
            X = tip * grasp.X_TO
            miss = L.T @ pose_error(X_WO, X)
            J = L.T @ columns_at(chain.data.J, X.translation)[:, joints]
        else:  # only along N, orthonormal in the object's metric
            Q, miss = grasp.whitened(tip, X_WO, L)
            J = Q.T @ L.T @ columns_at(chain.data.J, X_WO.translation)[:, joints]
        cost += 0.5 * float(miss @ miss)
        slope = J.T @ miss
        low = chain.model.lowerPositionLimit[joints]
        high = chain.model.upperPositionLimit[joints]
        q_arm = q[joints]
        stopped = ((q_arm <= low) & (slope < 0.0)) | ((q_arm >= high) & (slope > 0.0))
        H = J.T @ J + damping * chain.data.M[joints, joints]
        free = np.flatnonzero(~stopped)
        step[joints][free] = np.linalg.solve(H[np.ix_(free, free)], slope[free])
    return (cost, step)


ROUNDING = 1e-6  #: largest rounding error of a number that was written to a file (m, rad)


def outside_limits(chain: ClosedChain, q: Array, tolerance: Array | float = 0.0) -> list[str]:
    """List a clause for each joint that is outside its limits.

    Args:
        chain: the arms.
        q: (n,) positions (rad, m). Numbers that are not finite are not compared.
        tolerance: (n,) or one number: accepted distance beyond the limits (rad, m).
    """
    lower, upper = position_limits(chain.model)
    return [
        f"joint {chain.joint_names[j]} at {q[j]:.4g} is outside its limits "
        f"[{lower[j]:.4g}, {upper[j]:.4g}]"
        for j in np.flatnonzero(np.maximum(lower - q, q - upper) > tolerance)
    ]


def require_in_range(
    name: str, chain: ClosedChain, q: Array, tolerance: Array | float = 0.0
) -> None:
    """Refuse joint positions outside the joints' limits.

    Args:
        name: name of the argument, for the message.
        chain: the arms.
        q: (n,) positions (rad, m).
        tolerance: (n,) or one number: accepted distance beyond the limits (rad, m).

    Raises:
        InvalidInputError: joints are further out; the message lists them, and the numbers in
            radians if they seem to be degrees.
    """
    clauses = outside_limits(chain, q, tolerance + ROUNDING)
    if not clauses:
        return
    advice = "give positions (rad or m) within the limits, or correct those in the robot's file"
    if np.abs(q).max() > np.pi and not outside_limits(chain, np.radians(q)):
        advice = f"the numbers look like degrees: give np.radians({np.round(q, 4).tolist()})"
    raise InvalidInputError(f"{name}: {', '.join(clauses)}; {advice}")
