"""What a wrist sensor weighs besides the object: the links outboard of it (paper, fig. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array, carry_twist, cross, cross_wrench

__all__ = ["OutboardLink", "outboard_links", "outboard_terms"]


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
) -> tuple[Array, Array]:
    """(Λ, bias) of an arm's outboard links: their wrench at O is Λ a + bias, a the object's.

    Each link moves with q̈ = J̄ (a − γ), so Λ = Σ I_b J_b J̄, which is not symmetric, and
    bias = Σ I_b (γ_b − J_b J̄ γ − gravity) + V_b ×* I_b V_b.

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
        bias += inertia @ a_bias + cross_wrench(V, inertia @ V)
    return Lambda, bias


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
