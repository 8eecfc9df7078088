"""A flat face of the object on a flat face of the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from osc_contact.contacts.pairs.pair import read_geometry, require_length, triad
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.scenarios.bodies import OnPlaneSpec
from osc_contact.scenarios.quantities import Length, UnitVec3, Vec3
from osc_contact.spatial import Array

__all__ = ["FaceOnFace"]

_CORNERS = np.deg2rad([90.0, 210.0, 330.0])


class FaceOnFaceSpec(OnPlaneSpec):
    """A face of the object on a face of a body: forces at three corners of a triangle, r = 3."""

    forces: ClassVar[int] = 3
    type: Literal["face_on_face"] = "face_on_face"
    point: Vec3
    """the middle of the triangle [x, y, z] in the object frame"""
    normal: UnitVec3
    """the outward normal of the object's face [x, y, z] in the object frame"""
    size: Annotated[Length, Field(gt=0)] = 0.1
    """from the middle of the face to the three corners at which forces are commanded"""


@register_pair(FaceOnFaceSpec)
@dataclass(frozen=True, eq=False)
class FaceOnFace(PointsOnPlanes):
    """A flat face of the held object on a flat face of the environment (r = 3).

    The distributed force is carried by the three corners of an equilateral triangle drawn in the
    object's face around `point`, each like a vertex on the other face: all three magnitudes are
    forces (N), positive while the centre of pressure lies in the triangle. Any other triangle
    spans the same spaces N and T.

    Attributes:
        point: (3,) the middle of the triangle on the object's face, in the object frame (m).
        normal: (3,) outward normal of that face in the object frame; normalised on entry.
        face_point: (3,) a point of the other face in the environment frame (m).
        face_normal: (3,) its outward normal in the environment frame; normalised on entry.
        size: distance of the corners from `point` (m).
        name: used in messages and recordings.
    """

    point: Array
    normal: Array
    face_point: Array
    face_normal: Array
    size: float = 0.1
    name: str = "face_on_face"
    pushes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        read_geometry(
            self, "point", "face_point", normal="outward normal", face_normal="outward normal"
        )
        require_length(f"{self.name}.size", self.size, ">")
        drawn = np.array((np.cos(_CORNERS), np.sin(_CORNERS)))
        corners = self.point[:, None] + self.size * triad(self.normal)[:, :2] @ drawn
        into = np.tile(-self.face_normal[:, None], 3)
        self._hold_points(corners, into, self.face_point[:, None])
