"""A face of the object on a vertex of the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import pinocchio as pin
from pydantic import Field

from osc_contact.contacts.pairs.law_pair import LawPair, PairRow, shape
from osc_contact.contacts.pairs.pair import Bodies, read_geometry, require_length, store
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.law.records import FACE_ON_VERTEX
from osc_contact.scenarios.bodies import BodyPoint, OnBodySpec
from osc_contact.scenarios.quantities import Length, UnitVec3, Vec3
from osc_contact.spatial import Array

__all__ = ["FaceOnVertex"]


class FaceOnVertexSpec(OnBodySpec):
    """A face of the object on a (rounded) vertex of a body, r = 1."""

    forces: ClassVar[int] = 1
    type: Literal["face_on_vertex"] = "face_on_vertex"
    point: Vec3
    """a point of the object's face [x, y, z] in the object frame"""
    normal: UnitVec3
    """the outward normal of the object's face [x, y, z] in the object frame"""
    body_vertex: BodyPoint
    """the centre of the rounded vertex [x, y, z] in the body frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0
    """of the rounding"""


@register_pair(FaceOnVertexSpec, body_vertex="vertex")
@dataclass(frozen=True, eq=False)
class FaceOnVertex(LawPair):
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
    pushes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        read_geometry(self, "vertex", "point", normal="outward normal")
        require_length(f"{self.name}.radius", self.radius)
        self._hold(
            PairRow(FACE_ON_VERTEX, (shape(self.normal, self.vertex, self.radius),)), self.vertex
        )
        store(self, surface_radius=self.radius)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(1,) distance between face and vertex surface (m), negative when they overlap."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        apart = b.point_E(self.vertex) - b.point_A(self.point)
        return (b.R_A @ self.normal @ apart - self.radius)[None]
