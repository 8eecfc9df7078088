"""Grasps of the object by an arm: rigid, a hinge, a ball joint, or any other lower pair.

A grasp is a contact state between tip and object: it permits the motions T of the object relative
to the tip and transmits the wrenches N, NᵀT = 0. It has no mass, no motor and no encoder. The
spaces of N and T are fixed in the tip and in the object, as the permitted motions form a group.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from pinocchio import SE3

from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.spatial import Array, as_array, carry_twist, carry_wrench, cross_twist, unit_vector

_LEAST_INDEPENDENT = 1e-9  #: least singular value of independent columns of unit length


@dataclass(frozen=True, eq=False)
class Grasp:
    """Grasp: pose X_TO of the object in the tip frame, and permitted motions T (default: none).

    Attributes:
        X_TO: pose of the object in the tip frame without a permitted displacement.
        T: (6, k) basis of the permitted motions of the object relative to the tip, in tip axes at
            the tip's origin (m/s, rad/s).
        N: (6, 6−k) basis of the transmitted wrenches in tip axes at the tip's origin.

    Raises:
        InvalidInputError: T is not a basis, or its motions do not form a group (as those of a
            hinge, a ball, a slide, a cylinder, a screw or a plane do).

    Example:
        >>> hand = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))  # the object, 0.1 m before the tip
        >>> print(osc.Grasp.rigid(hand).kind, osc.Grasp.hinge(hand, axis=[0, 1, 0]).kind)
        rigid hinge
    """

    X_TO: SE3
    T: Array = field(default_factory=lambda: np.zeros((6, 0)))
    N: Array = field(init=False)

    def __post_init__(self) -> None:
        """Check that T is a basis of a group of motions, and compute N, a basis of its complement.

        Raises:
            InvalidInputError: T is not (6, k) of rank k, or a motion followed by another leaves its
                span.
        """
        if not isinstance(self.X_TO, SE3):
            raise InvalidInputError(f"X_TO: expected a pin.SE3, got {type(self.X_TO).__name__}")
        T = as_array("T of the grasp", self.T, (6, None))
        size = np.linalg.norm(T, axis=0)
        if T.shape[1] and not size.min() > 0.0:
            raise InvalidInputError("T of the grasp: a column is zero; leave it out")
        values = np.linalg.svd(T / size, compute_uv=False)
        if T.shape[1] > 6 or values.min(initial=1.0) < _LEAST_INDEPENDENT:
            raise InvalidInputError(
                f"T of the grasp: its {T.shape[1]} columns are dependent (smallest singular value "
                f"{values.min():.2g}); give a basis"
            )
        object.__setattr__(self, "T", T)
        object.__setattr__(self, "N", _complement_wrenches(T))
        # motions form a group if the Lie bracket of each two is a combination of all: NᵀT_ij = 0
        for i, j in combinations(range(T.shape[1]), 2):
            bracket = cross_twist(T[:, i], T[:, j])
            if np.abs(self.N.T @ bracket).max(initial=0.0) > _LEAST_INDEPENDENT * size[i] * size[j]:
                raise InvalidInputError(
                    f"T of the grasp: after motion {i} motion {j} is another one (their bracket "
                    f"{np.round(bracket, 6)} is not in T). A grasp permits a group of motions: "
                    "hinge, ball, slide, cylinder, screw, plane; put other joints into the URDF."
                )

    @classmethod
    def rigid(cls, X_TO: SE3) -> Grasp:
        """Grasp in which the object does not move relative to the tip."""
        return cls(X_TO)

    @classmethod
    def hinge(cls, X_TO: SE3, axis: npt.ArrayLike) -> Grasp:
        """Grasp in which the object turns about an axis (3,) through the tip's origin, tip axes."""
        direction = unit_vector("axis of the hinge", axis)
        return cls(X_TO, np.append(np.zeros(3), direction)[:, None])

    @classmethod
    def ball(cls, X_TO: SE3) -> Grasp:
        """Grasp in which the object turns freely about the tip's origin."""
        return cls(X_TO, np.vstack((np.zeros((3, 3)), np.eye(3))))

    @property
    def is_rigid(self) -> bool:
        """True if no motion is permitted."""
        return self.N.shape[1] == 6

    @property
    def kind(self) -> str:
        """Kind of the grasp by the motions T (6, k) that it permits at the tip.

        "rigid": none; "hinge": one rotation about an axis through the tip's origin; "ball": three
        rotations about it; "other": any other group of motions, such as slides.
        """
        T = self.T
        if self.is_rigid:
            return "rigid"
        if T[:3].any() or T.shape[1] == 2:
            return "other"
        return "hinge" if T.shape[1] == 1 else "ball"

    def wrenches_at(self, X_WT: SE3, O: Array) -> Array:  # noqa: E741 - operational point
        """Wrenches N (6, 6−k) in world axes at O (3,), for the tip's pose X_WT."""
        return carry_wrench(_rotate_columns(X_WT, self.N), X_WT.translation, O)

    def motions_at(self, X_WT: SE3, O: Array) -> Array:  # noqa: E741
        """Motions T (6, k) in world axes at O (3,), for the tip's pose X_WT."""
        return carry_twist(_rotate_columns(X_WT, self.T), X_WT.translation, O)

    def miss(self, X_WT: SE3, X_WO: SE3) -> Array:
        """Error (6−k,) of the object's pose along N (m, rad), zero for a permitted displacement.

        Its rate at zero is N(O)ᵀ(V_O − V_tip): the permitted part of the displacement from tip to
        object is removed first.

        Args:
            X_WT: pose of the tip.
            X_WO: pose of the object.
        """
        X = X_WT.actInv(X_WO * self.X_TO.inverse())  # identity without a displacement
        displacement = self._displacement(X)
        for _ in range(50):  # remove the permitted part, until none is left
            coordinates = np.linalg.lstsq(self.T, displacement, rcond=None)[0]
            if np.abs(coordinates).max(initial=0.0) < 1e-14:
                break
            X = X * pin.exp6(pin.Motion(self.T @ coordinates)).inverse()
            displacement = self._displacement(X)
        return self.N.T @ displacement

    def whitened(self, X_WT: SE3, X_WO: SE3, L: Array) -> tuple[Array, Array]:
        """Compute an orthonormal basis Q (6, 6−k) of L⁻¹N, and the pose error (6−k,) along it.

        Args:
            X_WT: pose of the tip.
            X_WO: pose of the object.
            L: (6, 6) Cholesky factor of the object's inertia.
        """
        Q, R = np.linalg.qr(np.linalg.solve(L, self.wrenches_at(X_WT, X_WO.translation)))
        return (Q, np.linalg.solve(R.T, self.miss(X_WT, X_WO)))

    def _displacement(self, X: SE3) -> Array:
        """Displacement (6,) of a relative pose, linear before angular (m, rad).

        It is log₆ of the pose if a permitted motion T (6, k) has a linear part; if T consists of
        rotations, it is the translation and log₃ of the rotation.

        Args:
            X: pose in the tip frame at which the object would have the tip; the identity without an
                error.
        """
        if self.T[:3].any():
            return pin.log6(X).vector
        return np.concatenate((X.translation, pin.log3(X.rotation)))


def _rotate_columns(X: SE3, columns: Array) -> Array:
    """Rotate twists or wrenches to other axes, at the same point.

    Args:
        X: pose whose rotation is applied; its translation is not used.
        columns: (6, k) twists or wrenches in the axes from which X maps.
    """
    return (X.rotation @ columns.reshape(2, 3, -1)).reshape(6, -1)


def _complement_wrenches(T: Array) -> Array:
    """Basis N (6, 6−k) with NᵀT = 0; if T consists of rotations, forces come before couples."""
    k = T.shape[1]
    if T[:3].any():
        return np.linalg.svd(T / np.linalg.norm(T, axis=0))[0][:, k:]
    N = np.eye(6)[:, : 6 - k]
    N[3:, 3:] = np.linalg.svd(T[3:])[0][:, k:]
    return N


@dataclass(frozen=True)
class GraspKind:
    """Registered kind of grasp.

    Attributes:
        make: function of X_TO and, if `has_axis`, of an axis (3,) in the tip frame.
        has_axis: True if the grasp has an axis.
    """

    make: Callable[..., Grasp]
    has_axis: bool


#: Registered kinds of grasps by name.
GRASPS: dict[str, GraspKind] = {}


def register_grasp(name: str, make: Callable[..., Grasp], *, axis: bool) -> None:
    """Register a kind of grasp, for example for the `type` of a scenario's grasp.

    Args:
        name: name of the kind.
        make: function of X_TO and, if `axis`, of an axis (3,) in the tip frame.
        axis: True if the grasp has an axis.
    """
    GRASPS[name] = GraspKind(make, axis)


register_grasp("rigid", Grasp.rigid, axis=False)
register_grasp("hinge", Grasp.hinge, axis=True)
register_grasp("ball", Grasp.ball, axis=False)


def locate(
    grasps: Sequence[Grasp],
    tips: Sequence[SE3],
    inertia: Callable[[SE3], Array],
    tolerance: float,
) -> SE3:
    """Pose of the object with least errors of all grasps, weighted by the object's inertia.

    Gauss–Newton from the pose that best aligns points and axes (Kabsch 1976). A step solves Nᵀx =
    miss of all grasps by least squares, for a displacement x (6,) of the object (m, rad) along the
    directions N that a grasp holds.

    Args:
        grasps: grasp of each arm.
        tips: pose of each arm's tip.
        inertia: function of the object's pose that returns its inertia (6, 6) at its origin, in
            world axes.
        tolerance: least singular value of all Nᵀ, each orthonormal in the metric of the inertia,
            below which the object is free to move while the tips are fixed.

    Raises:
        ModelError: the tips do not determine the pose.
    """
    X = _aligned_pose(grasps, tips)
    for _ in range(50):
        L = np.linalg.cholesky(inertia(X))
        step = -_solve_closure(grasps, tips, X, L, tolerance)
        X = moved(X, step)
        if np.abs(step).max() < 1e-15:
            break
    return X


def moved(X: SE3, displacement: Array) -> SE3:
    """Pose after a displacement (6,) at its own origin in world axes (m, rad)."""
    return SE3(pin.exp3(displacement[3:]) @ X.rotation, X.translation + displacement[:3])


def _solve_closure(
    grasps: Sequence[Grasp], tips: Sequence[SE3], X: SE3, L: Array, tolerance: float
) -> Array:
    """Solve N_iᵀx = miss_i of all grasps for a displacement x (6,) by least squares (m, rad).

    The metric is the object's inertia LLᵀ.

    Args:
        grasps: grasp of each arm.
        tips: pose of each arm's tip.
        X: pose of the object.
        L: (6, 6) Cholesky factor of the object's inertia.
        tolerance: least singular value of the grasps' wrenches in the object's energy metric; below
            it x is not unique.

    Raises:
        ModelError: x is not unique.
    """
    parts = [grasp.whitened(tip, X, L) for grasp, tip in zip(grasps, tips, strict=True)]
    rows = np.vstack([N.T for N, _ in parts])
    U, s, Vh = np.linalg.svd(rows, full_matrices=False)
    if len(s) < 6 or s[5] < tolerance:
        motion = np.linalg.solve(L.T, np.linalg.svd(rows)[2][5])
        motion /= np.abs(motion).max()
        raise ModelError(
            "the joints do not determine where the object is: its grasps let it make the motion "
            f"{np.array2string(motion, precision=3, suppress_small=True)} (linear, angular; world "
            "axes at the object) while every arm stands still. Grasp it so that this is blocked, "
            "or give the measured pose and twist: state(q, v, X_WO, V_O)."
        )
    right_side = np.concatenate([miss for _, miss in parts])
    return np.linalg.solve(L.T, Vh.T @ ((U.T @ right_side) / s))


def _aligned_pose(grasps: Sequence[Grasp], tips: Sequence[SE3]) -> SE3:
    """Compute the pose that best aligns the grasps' points and axes (Kabsch 1976).

    It is the initial pose of `locate`.

    Args:
        grasps: grasp of each arm.
        tips: pose of each arm's tip in the world.

    Returns:
        Pose of the object in the world.
    """
    points = []  # pairs of a point in the object and the same point in the world
    turns = np.zeros((3, 3))  # sum of (direction in the world)(direction in the object)ᵀ
    radius = 0.1  # weight of axes: as of points at this distance (m)
    for grasp, tip in zip(grasps, tips, strict=True):
        X_OT = grasp.X_TO.inverse()
        if not grasp.T[:3].any():
            points.append((X_OT.translation, tip.translation))
        axes = _fixed_axes(grasp.T[3:])
        turns += radius**2 * (tip.rotation @ axes) @ (X_OT.rotation @ axes).T
    if points:
        middle, target = np.mean(points, axis=0)  # of the points in the object and in the world
        p, x = np.swapaxes(points, 0, 1)
        turns += (x - target).T @ (p - middle)
    # R maximises trace(Rᵀ turns) among rotations: the determinant excludes a reflection
    U, _, Vh = np.linalg.svd(turns)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vh)]) @ Vh
    if points:
        return SE3(R, target - R @ middle)
    return SE3(R, (tips[0] * grasps[0].X_TO).translation)


def _fixed_axes(turning: Array) -> Array:
    """Directions (3, k) that permitted rotations about the axes `turning` (3, m) do not change.

    They are all directions without a rotation, the axis of a hinge, and none of a ball joint.
    """
    U, s, _ = np.linalg.svd(turning)
    rank = int(np.count_nonzero(s > 1e-9))
    if rank == 0:
        return np.eye(3)
    if rank == 1:
        return U[:, :1]
    return np.zeros((3, 0))
