"""What a wrist sensor weighs besides the object, in NumPy (paper, fig. 5)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.outboard import OutboardLink
from osc_contact.spatial import Array, cross_wrench
from readable.drift import drift

__all__ = ["grasp_filter", "outboard_terms"]


def outboard_terms(
    links: list[OutboardLink],
    placements: list[pin.SE3],
    J: Array,
    qd: Array,
    columns: dict[int, int],
    J_bar: Array,
    gamma: Array,
    O: Array,  # noqa: E741 - the operational point
    gravity: Array,
) -> tuple[Array, Array, Array]:
    """(Λ, bias, P) of an arm's outboard links: their wrench at O is Λ a + bias, a the object's.

    Each link moves with q̈ = J̄ (a − γ), so Λ = Σ I_b J_b J̄, which is not symmetric, and
    bias = Σ I_b (γ_b − J_b J̄ γ − gravity) + V_b ×* I_b V_b. Joints that move the links but not the
    object (an arm that holds it by a ball) add P q̈, with P (6, n) = Σ I_b J_b.

    Args:
        links: from `outboard_links`.
        placements: pose of each joint in the world, by joint index (`data.oMi`).
        J: (6, n) the arm's Jacobian columns at O, in joint order.
        qd: (n,) joint velocities.
        columns: number of J's columns that move joint j (its position in the chain).
        J_bar, gamma: (n, 6), (6,) of the arm's tip.
        O: (3,) operational point in the world.
        gravity: (3,) m/s².
    """
    Lambda = np.zeros((6, 6))
    bias = np.zeros(6)
    P = np.zeros((6, J.shape[1]))
    for link in links:
        k = columns[link.joint]
        X = placements[link.joint]
        at_O = pin.SE3(X.rotation, X.translation - O)
        inertia: Array = at_O.act(link.inertia).matrix()
        V = J[:, :k] @ qd[:k]
        H = J[:, :k] @ J_bar[:k]
        a_bias = drift(J[:, :k], qd[:k]) - H @ gamma
        a_bias[:3] -= gravity
        Lambda += inertia @ H
        P[:, :k] += inertia @ J[:, :k]
        bias += inertia @ a_bias + cross_wrench(V, inertia @ V)
    return Lambda, bias, P


def grasp_filter(J: Array, N: Array, P: Array, L: Array) -> Array:
    """F (6, 6), which takes out of a wrist reading what only the gripper's own motion causes.

    A grasp that permits motions T leaves the gripper free to accelerate by Zν, NᵀJZ = 0, while the
    object does not. The reading holds PZν and a wrench in range(N), and nothing acts on the gripper
    along T, so the reading itself tells ν: F = 1 − PZ(TᵀPZ)⁺Tᵀ, with FN = N and FPZ = 0. For one
    body beyond the sensor that is Ω_f of its inertia and the state of contact N, fig. 5 once more.

    Args:
        J: (6, n) tip Jacobian at O. N: (6, m) wrenches of the grasp at O.
        P: (6, n) wrench of the outboard links for q̈, at O.
        L: (6, 6) Cholesky factor of the object's inertia: the metric in which rank is decided.
    """
    whitened = np.linalg.solve(L, N)
    Q, _ = np.linalg.qr(whitened, mode="complete")
    T = Q[:, N.shape[1] :]  # whitened: NᵀT = 0
    passed = (L @ Q[:, : N.shape[1]]).T @ J
    scale = np.linalg.norm(passed, axis=0).max(initial=0.0)
    _, s, Vh = np.linalg.svd(passed, full_matrices=True)
    Z = Vh[np.count_nonzero(s > 1e-9 * scale) :].T
    E = np.linalg.solve(L, P @ Z)
    U, s, Vh = np.linalg.svd(T.T @ E, full_matrices=False)
    keep = s > 1e-9 * np.abs(E).max(initial=0.0)
    inverse = (Vh[keep].T / s[keep]) @ U[:, keep].T
    F_white = np.eye(6) - E @ inverse @ T.T
    return np.asarray(L @ F_white @ np.linalg.inv(L))
