"""Pairs given by T: N annihilates T by construction, n_γ = NᵀṪβ."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.law_pair import PairRow, shape
from osc_contact.contacts.pairs.pair import Bodies, read_geometry, store, triad
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.law.records import COUPLE, FORCE, SCREW, SLIDE, TANGENTS, THREAD, TURN
from osc_contact.spatial import Array

__all__ = [
    "TangentPair",
    "held_axes",
    "held_axis",
    "read_joint",
    "screw",
    "slide",
    "thread",
    "rotation",
]

_NONE = np.zeros((3, 0))


class TangentPair(PointsOnPlanes):
    """A pair whose T = [t₁ …] is known: n_γ = NᵀṪβ, V_rel = Tβ, ṫⱼ = V_b(j) × tⱼ (paper, sec. 3).

    b(j) is the body that carries the axis of tⱼ. N has explicit columns, smooth in the pose, that
    annihilate T and are the gradients of the gaps:

    * points pⱼ of A on planes of E with directions nⱼ: column [n; p × n], gap −n·(p − q);
    * directions aⱼ of A at right angles to directions uⱼ of E: column [0; a × u], gap −a·u.

    Unlike a magnitude of a face, these have either sign.
    """

    _arms: Array
    _marks: Array

    def _hold_tangents(
        self,
        point: Array,
        into: Array,
        on_plane: Array,
        right_angles: tuple[Array, Array] = (_NONE, _NONE),
        freedoms: tuple[Array, ...] = (),
        threads: tuple[Array, ...] = (),
    ) -> None:
        """Take the columns of N and the permitted motions.

        Args:
            point: (3,) of A. into: (3, k) unit directions of E. on_plane: (3,) a point of E.
            right_angles: arms (3, m) of A and marks (3, m) of E.
            freedoms: made by `rotation`, `slide`, `screw`. threads: columns made by `thread`.
        """
        points = np.tile(point[:, None], into.shape[1])
        (arms, marks) = right_angles
        store(self, _points=points, _into=into, _reach=on_plane @ into, _arms=arms, _marks=marks)
        forces = (shape(p, n, FORCE) for p, n in zip(points.T, into.T, strict=True))
        couples = (shape(a, u, COUPLE) for a, u in zip(arms.T, marks.T, strict=True))
        shapes = (*forces, *couples, *threads, *freedoms)
        self._hold(PairRow(TANGENTS, shapes, len(freedoms)), on_plane)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(r,) signed errors: m for the points, rad (to first order) for the directions."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        angles = -np.einsum("ij,ij->j", b.R_A @ self._arms, b.rotate_E(self._marks))
        return np.concatenate((super().gaps(X_WO, X_WE), angles))


def rotation(point: Array, axis: Array) -> Array:
    """Rotation about an axis of A through a point of A."""
    return shape(point, axis, TURN)


def slide(point: Array, axis: Array) -> Array:
    """Translation along an axis of E; its rate is read at a point of A."""
    return shape(point, axis, SLIDE)


def screw(point: Array, axis: Array, seat: Array, pitch: float) -> Array:
    """Rotation about an axis of A, and pitch (m/rad) times its rate along the seat's axis of E.

    Args:
        point, axis: (3,) in A (m, unit vector). seat: (3,) axis in E. pitch: m/rad.
    """
    return shape(point, axis, SCREW, seat, pitch)


def thread(point: Array, axis: Array, seat: Array, pitch: float) -> Array:
    """The column of N that holds a screw to its pitch.

    Args:
        point, axis, seat, pitch: as in `screw`.
    """
    return shape(point, seat, THREAD, axis, pitch)


def held_axis(axis: Array, seat: Array) -> tuple[Array, Array]:
    """Arms and marks (3, 2) that keep `axis` of A along `seat` of E; couples along triad(seat)."""
    x, y, _ = triad(seat).T
    return np.column_stack((axis, axis)), np.column_stack((-y, x))


def held_axes(R_EA: Array) -> tuple[Array, Array]:
    """Arms and marks (3, 3) that keep A's orientation in E at R_EA; couples along E's axes."""
    return R_EA.T[:, [1, 2, 0]], np.eye(3)[:, [2, 0, 1]]


def read_joint(pair: TangentPair) -> None:
    """Check point, axis and assembled pose of a joint that is being made."""
    read_geometry(pair, "point", axis="axis of the joint")
    store(pair, assembled=pin.SE3(pair.assembled))  # type: ignore[attr-defined]
