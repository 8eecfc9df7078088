"""Pose of the object, from arms of which none holds it rigidly."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.grasp import Grasp
from osc_contact.errors import ModelError
from osc_contact.spatial import Array

__all__ = ["locate", "moved"]


def locate(
    grasps: Sequence[Grasp],
    tips: Sequence[pin.SE3],
    inertia: Callable[[pin.SE3], Array],
    tolerance: float,
) -> pin.SE3:
    """The pose at which all grasps fit the tips; where none does, the nearest in energy.

    Begins with the rotation that best aligns points and axes (Kabsch 1976), then Gauss–Newton on
    the grasps' misses, weighted by the object's inertia.

    Args:
        grasps, tips: of each arm, and where its tip is in the world.
        inertia: (6, 6) of the object at its origin, in world axes, at a pose.
        tolerance: the object counts as free to move while the tips stand still when the grasps'
            wrenches come this near to leaving one of its motions (rad, in its energy metric).

    Raises:
        ModelError: the tips do not tell it: the object can move while they stand still.
    """
    X = _aligned(grasps, tips)
    for _ in range(50):
        L = np.linalg.cholesky(inertia(X))
        misses = [grasp.miss(tip, X) for grasp, tip in zip(grasps, tips, strict=True)]
        step = -_solved(grasps, tips, X.translation, L, misses, tolerance)
        X = moved(X, step)
        if np.abs(step).max() < 1e-15:
            break
    return X


def moved(X: pin.SE3, displacement: Array) -> pin.SE3:
    """A pose displaced by (6,) at its own origin, world axes (m, rad)."""
    return pin.SE3(pin.exp3(displacement[3:]) @ X.rotation, X.translation + displacement[:3])


def _solved(
    grasps: Sequence[Grasp],
    tips: Sequence[pin.SE3],
    O: Array,  # noqa: E741
    L: Array,
    along: Sequence[Array],
    tolerance: float,
) -> Array:
    """x (6,) with N_iᵀx = along_i, each grasp's rows made orthonormal in the metric LLᵀ."""
    rows, right = [], []
    for grasp, tip, value in zip(grasps, tips, along, strict=True):
        Q, R = np.linalg.qr(np.linalg.solve(L, grasp.wrenches_at(tip, O)))
        rows.append(Q.T)
        right.append(np.linalg.solve(R.T, value))
    U, s, Vh = np.linalg.svd(np.vstack(rows), full_matrices=False)
    if len(s) < 6 or s[5] < tolerance:
        _, _, whole = np.linalg.svd(np.vstack(rows), full_matrices=True)
        motion = np.linalg.solve(L.T, whole[5])
        motion = motion / np.abs(motion).max()
        raise ModelError(
            "the joints do not tell where the object is: its grasps let it make the motion "
            f"{np.array2string(motion, precision=3, suppress_small=True)} (linear, angular; world "
            "axes at the object) while every arm stands still. Grasp it so that this is blocked, "
            "or give the measured pose and twist: state(q, v, X_WO, V_O)."
        )
    return np.asarray(np.linalg.solve(L.T, Vh.T @ ((U.T @ np.concatenate(right)) / s)))


def _aligned(grasps: Sequence[Grasp], tips: Sequence[pin.SE3]) -> pin.SE3:
    """A start: the pose that best brings grasp points together and axes parallel."""
    own, seen = [], []  # pairs of points, in the object and in the world
    turns = np.zeros((3, 3))
    radius = 0.1  # a metre of axis counts as this much distance between points
    for grasp, tip in zip(grasps, tips, strict=True):
        T = grasp.T
        X_OT = grasp.X_TO.inverse()
        if not T[:3].any():
            own.append(X_OT.translation)
            seen.append(tip.translation)
        axes = _fixed_axes(T[3:])
        turns += radius**2 * (tip.rotation @ axes) @ (X_OT.rotation @ axes).T
    if own:
        p, x = np.array(own), np.array(seen)
        turns += (x - x.mean(axis=0)).T @ (p - p.mean(axis=0))
    U, _, Vh = np.linalg.svd(turns)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vh)]) @ Vh
    if own:
        return pin.SE3(R, x.mean(axis=0) - R @ p.mean(axis=0))
    return pin.SE3(R, (tips[0] * grasps[0].X_TO).translation)


def _fixed_axes(turning: Array) -> Array:
    """(3, k) directions that the permitted rotations (3, m) leave as they are."""
    U, s, _ = np.linalg.svd(np.hstack((turning, np.zeros((3, 1)))))
    rank = int(np.count_nonzero(s > 1e-9))
    return np.eye(3) if rank == 0 else U[:, :1] if rank == 1 else np.zeros((3, 0))
