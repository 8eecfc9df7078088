"""An edge of the object on a face of the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from osc_contact.contacts.pairs.pair import read_geometry, require_length
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes, ends
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.scenarios.bodies import OnPlaneSpec
from osc_contact.scenarios.quantities import Length, UnitVec3, Vec3
from osc_contact.spatial import Array

__all__ = ["EdgeOnFace"]


class EdgeOnFaceSpec(OnPlaneSpec):
    """A straight edge of the object on a face of a body: forces at two of its points, r = 2."""

    forces: ClassVar[int] = 2
    type: Literal["edge_on_face"] = "edge_on_face"
    point: Vec3
    """the middle of the edge [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the edge [x, y, z] in the object frame"""
    length: Annotated[Length, Field(gt=0)] = 0.1
    """between the two points of the edge at which forces are commanded"""


@register_pair(EdgeOnFaceSpec)
@dataclass(frozen=True, eq=False)
class EdgeOnFace(PointsOnPlanes):
    """A straight edge of the held object on a face of the environment (r = 2).

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
    pushes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        read_geometry(
            self,
            "point",
            "face_point",
            direction="direction of the line",
            face_normal="outward normal",
        )
        require_length(f"{self.name}.length", self.length, ">")
        into = np.tile(-self.face_normal[:, None], 2)
        feet = ends(self.point, self.direction, self.length)
        self._hold_points(feet, into, self.face_point[:, None])
