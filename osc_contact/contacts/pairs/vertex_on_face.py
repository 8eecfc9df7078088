"""A vertex of the object on a face of the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import pinocchio as pin
from pydantic import Field

from osc_contact.contacts.pairs.law_pair import PairRow
from osc_contact.contacts.pairs.pair import read_geometry, require_length, triad
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.scenarios.bodies import OnFaceSpec
from osc_contact.scenarios.quantities import Length, Vec3
from osc_contact.spatial import Array

__all__ = ["VertexOnFace"]


class VertexOnFaceSpec(OnFaceSpec):
    """A rounded vertex of the object on a face of the environment."""

    forces: ClassVar[int] = 1
    type: Literal["vertex_on_face"] = "vertex_on_face"
    vertex: Vec3
    """the centre of the rounded vertex [x, y, z] in the object frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0
    """of the rounding"""


@register_pair(VertexOnFaceSpec)
@dataclass(frozen=True, eq=False)
class VertexOnFace(PointsOnPlanes):
    """A vertex of the held object on a face of the environment (each contact of fig. 1, r = 1).

    N = [n; (p − O) × n], n pointing into the face, p the vertex. A vertex rounded with a radius is
    a small sphere: its line of force passes through the centre, so `vertex` is that centre and only
    the gap contains the radius.

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
    pushes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        read_geometry(self, "vertex", "point", normal="outward normal")
        require_length(f"{self.name}.radius", self.radius)
        self._hold_points(
            self.vertex[:, None], -self.normal[:, None], self.point[:, None], self.radius
        )

    def row(self) -> PairRow:
        """The pair as the compiled law reads it."""
        return self._row

    def gap(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> float:
        """Distance between vertex surface and face (m), negative when they overlap."""
        return float(self.gaps(X_WO, X_WE)[0])

    def point_on_face(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(3,) where the line of force meets the face, world (m)."""
        normal, point = self._face(X_WE)
        p: Array = X_WO.act(self.vertex)
        on_face: Array = p - (normal @ (p - point)) * normal
        return on_face

    def points_of_contact(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(3, 1) the same as a column."""
        return self.point_on_face(X_WO, X_WE)[:, None]

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
