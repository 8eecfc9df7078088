"""Pairs with a line: an edge on an edge (r = 1), an edge or a cylinder on a plane (r = 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import (
    Bodies,
    lines_of_force,
    lines_of_force_rate,
    read_geometry,
    require_length,
    velocity,
)
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.spatial import Array, cross

__all__ = ["EdgeOnEdge", "EdgeOnFace", "CylinderOnPlane", "ends"]

PARALLEL = 1e-6


def ends(point: Array, direction: Array, length: float) -> Array:
    """(3, 2) the two ends of a segment whose middle is `point`."""
    half = 0.5 * length * direction
    return np.column_stack((point - half, point + half))


@dataclass(frozen=True, eq=False)
class EdgeOnEdge:
    """An edge of the held object across an edge of the environment (r = 1).

    N = [n; (p − O) × n], n = ± e_A × e_E / |e_A × e_E| into the environment, p the crossing point,
    which neither body carries: it slides along both edges, ṗ = v_A(p) + ṡ e_A. With e_A, e_E unit,
    ṅ = ± (1 − nnᵀ)(ė_A × e_E + e_A × ė_E) / |e_A × e_E|. With the gap g open, p is the
    point of the object's edge nearest to the other one and
    ṫ e_E − ṡ e_A = v_A(p) − v_E(p + g n) + g ṅ in the plane ⟂ n, so N and n_γ stay exact.

    Attributes:
        point_A: (3,) a point of the object's edge, in the object frame (m).
        direction_A: (3,) along that edge; normalised on entry.
        point_E: (3,) a point of the environment's edge, in the environment frame (m).
        direction_E: (3,) along that edge; normalised on entry.
        side: which way n points: +1 along e_A × e_E, −1 against it, or an outward normal (3,) of
            the environment at its edge, in the environment frame; roughly is enough, its component
            along e_A × e_E decides.
        name: used in messages and recordings.
    """

    point_A: Array
    direction_A: Array
    point_E: Array
    direction_E: Array
    side: float | Array = 1.0
    name: str = "edge_on_edge"

    def __post_init__(self) -> None:
        edge = "direction of the edge"
        read_geometry(self, "point_A", "point_E", direction_A=edge, direction_E=edge)
        if np.ndim(self.side) > 0:
            read_geometry(self, side="environment's outward normal")
        elif self.side not in (1, -1):
            raise InvalidInputError(
                f"{self.name}.side = {self.side}; give +1 or −1 (times e_A × e_E), or a vector "
                "that points out of the environment, towards the object"
            )

    def contact(
        self,
        X_WO: pin.SE3,
        V_O: Array,
        X_WE: pin.SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, 1) and n_γ (1,) at O, world axes (see `ContactPair.contact`).

        Raises:
            ContactError: the edges are parallel.
        """
        b = Bodies.at_O(X_WO, V_O, X_WE, V_E)
        e_A, e_E = b.R_A @ self.direction_A, b.turn_E(self.direction_E)
        m, n = self._normal(b, e_A, e_E)
        apart = b.point_E(self.point_E) - b.point_A(self.point_A)
        p = b.point_A(self.point_A) + _along_first(apart, e_E, m) * e_A
        gap = n @ apart
        m_dot = cross(cross(b.V_A[3:], e_A), e_E) + cross(e_A, cross(b.V_E[3:], e_E))
        n_dot = (m_dot - (n @ m_dot) * n) / (n @ m)
        slip = velocity(b.V_A, p) - velocity(b.V_E, p + gap * n) + gap * n_dot
        p_dot = velocity(b.V_A, p) - _along_first(slip, e_E, m) * e_A
        N_dot = lines_of_force_rate(p, n, p_dot, n_dot)
        return Contact(lines_of_force(p, n)[:, None], [-N_dot @ b.V_rel], name=self.name)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(1,) distance between the two lines (m), negative when they have passed each other."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        _, n = self._normal(b, b.R_A @ self.direction_A, b.turn_E(self.direction_E))
        return (n @ (b.point_E(self.point_E) - b.point_A(self.point_A)))[None]

    def _normal(self, b: Bodies, e_A: Array, e_E: Array) -> tuple[Array, Array]:
        """m = e_A × e_E and the unit vector n = ± m/|m| into the environment."""
        m = cross(e_A, e_E)
        sine = float(np.linalg.norm(m))
        if sine < PARALLEL:
            raise ContactError(
                f"{self.name}: the edges are parallel (sine of their angle {sine:.2g}), so their "
                "common normal is undefined; model this contact as an edge on a face"
            )
        side = self.side if np.ndim(self.side) == 0 else -b.turn_E(np.asarray(self.side)) @ m
        return m, np.copysign(1.0 / sine, side) * m


def _along_first(apart: Array, e_E: Array, m: Array) -> float:
    """s with s e_A − t e_E = apart in the plane ⟂ m = e_A × e_E."""
    return float(cross(apart, e_E) @ m / (m @ m))


@dataclass(frozen=True, eq=False)
class EdgeOnFace(PointsOnPlanes):
    """A straight edge of the held object lying on a face of the environment (r = 2).

    Its distributed force is carried by two points of the edge, `length` apart around `point`, each
    like a vertex on the face: both magnitudes are forces (N), positive while the centre of pressure
    is between them. Any other length spans the same spaces N and T.

    Attributes:
        point: (3,) the middle of the edge in the object frame (m).
        direction: (3,) along the edge in the object frame; normalised on entry.
        face_point: (3,) a point of the face in the environment frame (m).
        face_normal: (3,) its outward normal in the environment frame; normalised on entry.
        length: between the two points (m).
        name: used in messages and recordings.
    """

    point: Array
    direction: Array
    face_point: Array
    face_normal: Array
    length: float = 0.1
    name: str = "edge_on_face"

    def __post_init__(self) -> None:
        _read_line_on_plane(self)
        feet = ends(self.point, self.direction, self.length)
        self._hold(feet, _twice(-self.face_normal), self.face_point[:, None])


@dataclass(frozen=True, eq=False)
class CylinderOnPlane(PointsOnPlanes):
    """A cylinder of the held object lying on a plane of the environment (r = 2).

    As an edge on a face, with the lines of force through two points of the *axis*, `length` apart;
    only the gaps know the radius. Rolling is free: where the surface touches does not matter.

    Attributes:
        point: (3,) the middle of the axis in the object frame (m).
        direction: (3,) along the axis in the object frame; normalised on entry.
        radius: of the cylinder (m).
        face_point: (3,) a point of the plane in the environment frame (m).
        face_normal: (3,) its outward normal in the environment frame; normalised on entry.
        length: between the two points (m).
        name: used in messages and recordings.
    """

    point: Array
    direction: Array
    radius: float
    face_point: Array
    face_normal: Array
    length: float = 0.1
    name: str = "cylinder_on_plane"

    def __post_init__(self) -> None:
        _read_line_on_plane(self)
        require_length(f"{self.name}.radius", self.radius)
        feet = ends(self.point, self.direction, self.length)
        self._hold(feet, _twice(-self.face_normal), self.face_point[:, None], self.radius)


def _twice(n: Array) -> Array:
    return np.column_stack((n, n))


def _read_line_on_plane(pair: EdgeOnFace | CylinderOnPlane) -> None:
    read_geometry(
        pair, "point", "face_point",
        direction="direction of the line", face_normal="outward normal",
    )  # fmt: skip
    require_length(f"{pair.name}.length", pair.length, ">")
