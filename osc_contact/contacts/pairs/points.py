"""Pairs with one point: a vertex on a face, a face on a vertex, a sphere on a plane (r = 1)."""

from __future__ import annotations

from dataclasses import dataclass

import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import (
    Bodies,
    lines_of_force,
    lines_of_force_rate,
    read_geometry,
    require_length,
    triad,
    velocity,
)
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.spatial import Array, cross

__all__ = ["VertexOnFace", "FaceOnVertex", "SphereOnPlane"]


@dataclass(frozen=True, eq=False)
class VertexOnFace(PointsOnPlanes):
    """A vertex of the held object on a face of the environment (each contact of fig. 1, r = 1).

    N = [n; (p − O) × n], n pointing into the face, p the vertex. A vertex rounded with a radius is
    a small sphere: its line of force passes through the centre, so `vertex` is that centre and only
    the gap knows the radius.

    Attributes:
        vertex: (3,) vertex, or centre of the rounded vertex, in the object frame (m).
        point: (3,) a point of the face in the environment frame (m).
        normal: (3,) outward normal of the face in the environment frame; normalised on entry.
        radius: of the rounded vertex (m).
        name: used in messages and recordings.
    """

    vertex: Array
    point: Array
    normal: Array
    radius: float = 0.0
    name: str = "vertex_on_face"

    def __post_init__(self) -> None:
        read_geometry(self, "vertex", "point", normal="outward normal")
        require_length(f"{self.name}.radius", self.radius)
        self._hold(self.vertex[:, None], -self.normal[:, None], self.point[:, None], self.radius)

    def gap(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> float:
        """Distance between vertex surface and face (m), negative when they overlap."""
        return float(self.gaps(X_WO, X_WE)[0])

    def point_on_face(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(3,) where the line of force meets the face, world (m)."""
        normal, point = self._face(X_WE)
        p: Array = X_WO.act(self.vertex)
        on_face: Array = p - (normal @ (p - point)) * normal
        return on_face

    def direction(self, X_WE: pin.SE3 | None = None) -> Array:
        """(3,) unit vector into the face, world: the direction of a positive contact force."""
        return -self._face(X_WE)[0]

    def face_placement(self) -> pin.SE3:
        """Pose of the face's surface in the environment frame: z along the outward normal."""
        return pin.SE3(triad(self.normal), self.point)

    def _face(self, X_WE: pin.SE3 | None) -> tuple[Array, Array]:
        if X_WE is None:
            return self.normal, self.point
        return X_WE.rotation @ self.normal, X_WE.act(self.point)


@dataclass(frozen=True, eq=False)
class SphereOnPlane(PointsOnPlanes):
    """A sphere of the held object on a plane of the environment (r = 1).

    The same as a rounded vertex on a face: the line of force passes through the centre.

    Attributes:
        centre: (3,) of the sphere in the object frame (m).
        radius: of the sphere (m).
        point: (3,) a point of the plane in the environment frame (m).
        normal: (3,) outward normal of the plane in the environment frame; normalised on entry.
        name: used in messages and recordings.
    """

    centre: Array
    radius: float
    point: Array
    normal: Array
    name: str = "sphere_on_plane"

    def __post_init__(self) -> None:
        read_geometry(self, "centre", "point", normal="outward normal")
        require_length(f"{self.name}.radius", self.radius)
        self._hold(self.centre[:, None], -self.normal[:, None], self.point[:, None], self.radius)


@dataclass(frozen=True, eq=False)
class FaceOnVertex:
    """A face of the held object on a vertex of the environment (r = 1).

    N = [n; (p − O) × n] with n the *outward* normal of the object's face, which points into the
    environment, and p the vertex. Now the object carries n and the environment p: ṅ = ω_O × n,
    ṗ = v_E(p).

    Attributes:
        point: (3,) a point of the face in the object frame (m).
        normal: (3,) outward normal of the face in the object frame; normalised on entry.
        vertex: (3,) vertex, or centre of the rounded vertex, in the environment frame (m).
        radius: of the rounded vertex (m).
        name: used in messages and recordings.
    """

    point: Array
    normal: Array
    vertex: Array
    radius: float = 0.0
    name: str = "face_on_vertex"

    def __post_init__(self) -> None:
        read_geometry(self, "vertex", "point", normal="outward normal")
        require_length(f"{self.name}.radius", self.radius)

    def contact(
        self,
        X_WO: pin.SE3,
        V_O: Array,
        X_WE: pin.SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, 1) and n_γ (1,) at O, world axes (see `ContactPair.contact`)."""
        b = Bodies.at_O(X_WO, V_O, X_WE, V_E)
        n, p = b.R_A @ self.normal, b.point_E(self.vertex)
        N_dot = lines_of_force_rate(p, n, velocity(b.V_E, p), cross(b.V_A[3:], n))
        return Contact(lines_of_force(p, n)[:, None], [-N_dot @ b.V_rel], name=self.name)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(1,) distance between face and vertex surface (m), negative when they overlap."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        apart = b.point_E(self.vertex) - b.point_A(self.point)
        return (b.R_A @ self.normal @ apart - self.radius)[None]
