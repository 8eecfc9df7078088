"""A cylinder of the object on a plane of the environment."""

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

__all__ = ["CylinderOnPlane"]


class CylinderOnPlaneSpec(OnPlaneSpec):
    """A cylinder of the object on a face of a body: forces at two of its points, r = 2."""

    forces: ClassVar[int] = 2
    type: Literal["cylinder_on_plane"] = "cylinder_on_plane"
    point: Vec3
    """the middle of the axis [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the axis [x, y, z] in the object frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0
    """of the cylinder"""
    length: Annotated[Length, Field(gt=0)] = 0.1
    """between the two points of the axis at which forces are commanded"""


@register_pair(CylinderOnPlaneSpec)
@dataclass(frozen=True, eq=False)
class CylinderOnPlane(PointsOnPlanes):
    """A cylinder of the held object on a plane of the environment (r = 2).

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
        require_length(f"{self.name}.radius", self.radius)
        into = np.tile(-self.face_normal[:, None], 2)
        feet = ends(self.point, self.direction, self.length)
        self._hold_points(feet, into, self.face_point[:, None], self.radius)
