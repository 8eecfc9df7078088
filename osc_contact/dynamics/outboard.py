"""What a wrist sensor weighs besides the object: the links outboard of it (paper, fig. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array, carry_twist, cross, cross_wrench

__all__ = ["OutboardLink", "grasp_filter", "outboard_links", "outboard_terms"]


@dataclass(frozen=True)
class OutboardLink:
    """A rigid part beyond the sensor: the joint it moves with, its inertia in that frame."""

    joint: int
    inertia: pin.Inertia


def outboard_links(model: pin.Model, sensor: int, tip: int) -> list[OutboardLink]:
    """The parts between the sensor frame and the object, from the model's own link inertias.

    Links welded to the sensor's link share its joint; links beyond further joints carry the
    inertia of those joints.

    Args:
        model: merged model.
        sensor: frame index of the wrist sensor (the first link outboard of the sensing element).
        tip: frame index of the grasping frame, which tells the chain.
    """
    links = []
    joint = model.frames[sensor].parentJoint
    above = model.frames[sensor].parentFrame
    if model.frames[above].type == pin.FrameType.FIXED_JOINT:
        sensor = above  # Pinocchio stores a welded link's inertia with its fixed joint
    if model.frames[above].type == pin.FrameType.JOINT:
        own = model.inertias[joint].copy()  # the sensor sits at the joint: the whole link is beyond
    else:
        own = pin.Inertia.Zero()
        for f in range(model.nframes):
            frame = model.frames[f]
            if frame.parentJoint == joint and _hangs_on(model, f, sensor):
                own = own + frame.placement.act(frame.inertia)
    if own.mass > 0.0:
        links.append(OutboardLink(joint, own))
    path = list(model.supports[model.frames[tip].parentJoint])
    for j in path:
        if j > joint and joint in model.supports[j]:
            links.append(OutboardLink(j, model.inertias[j].copy()))
    return links


def _hangs_on(model: pin.Model, frame: int, ancestor: int) -> bool:
    while frame != 0:
        if frame == ancestor:
            return True
        frame = model.frames[frame].parentFrame
    return False


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
    white = np.linalg.solve(L, N)
    Q, _ = np.linalg.qr(white, mode="complete")
    T = Q[:, N.shape[1] :]  # white: NᵀT = 0
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


def drift(J: Array, qd: Array) -> Array:
    """Spatial acceleration γ = Σ_i V_{i−1} × J_i q̇_i (6,) of a serial chain at q̈ = 0.

    The columns J (6, n) may be written at any one point: the sum is a spatial vector there.
    """
    S = J * qd
    V = np.cumsum(S, axis=1) - S  # twist of the link before each joint
    linear = cross(V[3:], S[:3]) + cross(V[:3], S[3:])
    angular = cross(V[3:], S[3:])
    return np.concatenate((linear.sum(axis=1), angular.sum(axis=1)))


def columns_at(J_world: Array, O: Array) -> Array:  # noqa: E741 - the operational point
    """Jacobian columns carried from the world origin to O."""
    return carry_twist(J_world, np.zeros(3), O)
