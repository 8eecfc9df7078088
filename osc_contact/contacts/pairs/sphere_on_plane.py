"""A sphere of the object on a plane of the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from osc_contact.contacts.pairs.pair import read_geometry, require_length
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.scenarios.bodies import OnPlaneSpec
from osc_contact.scenarios.quantities import Length, Vec3
from osc_contact.spatial import Array

__all__ = ["SphereOnPlane"]


class SphereOnPlaneSpec(OnPlaneSpec):
    """A sphere (or rounded vertex) of the object on a face of a body, r = 1."""

    forces: ClassVar[int] = 1
    type: Literal["sphere_on_plane"] = "sphere_on_plane"
    centre: Vec3
    """the centre of the sphere [x, y, z] in the object frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0
    """of the sphere"""


@register_pair(SphereOnPlaneSpec, face_point="point", face_normal="normal")
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
    pushes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        read_geometry(self, "centre", "point", normal="outward normal")
        require_length(f"{self.name}.radius", self.radius)
        self._hold_points(
            self.centre[:, None], -self.normal[:, None], self.point[:, None], self.radius
        )
