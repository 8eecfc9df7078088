"""A cylinder of the object in a hole of the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from osc_contact.contacts.pairs.pair import read_geometry, require_length, triad
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes, ends
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.scenarios.bodies import BodyDirection, BodyPoint, OnBodySpec
from osc_contact.scenarios.quantities import Length, UnitVec3, Vec3
from osc_contact.spatial import Array

__all__ = ["CylinderInHole"]


class CylinderInHoleSpec(OnBodySpec):
    """A cylinder of the object in a hole without play: two cross forces at two points, r = 4."""

    forces: ClassVar[int] = 4
    type: Literal["cylinder_in_hole"] = "cylinder_in_hole"
    point: Vec3
    """the middle of the cylinder's axis [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the cylinder's axis [x, y, z] in the object frame"""
    hole_point: BodyPoint
    """a point of the hole's axis [x, y, z] in the body frame"""
    hole_direction: BodyDirection
    """along the hole's axis [x, y, z] in the body frame"""
    length: Annotated[Length, Field(gt=0)] = 0.1
    """between the two points of the axis at which forces are commanded"""


@register_pair(CylinderInHoleSpec)
@dataclass(frozen=True, eq=False)
class CylinderInHole(PointsOnPlanes):
    """A cylinder of the held object in a hole of the environment without play (r = 4).

    Two points of the cylinder's axis, `length` apart, are each held on the axis of the hole by two
    perpendicular forces (N): a touch on any side of the wall, so the magnitudes have either sign.
    The cylinder may turn and slide. Any other length spans the same
    spaces N and T.

    Attributes:
        point: (3,) the middle of the cylinder's axis in the object frame (m).
        direction: (3,) along that axis in the object frame; normalised on entry.
        hole_point: (3,) a point of the hole's axis in the environment frame (m).
        hole_direction: (3,) along that axis in the environment frame; normalised on entry.
        length: between the two points (m).
        name: used in messages and recordings.
    """

    point: Array
    direction: Array
    hole_point: Array
    hole_direction: Array
    length: float = 0.1
    name: str = "cylinder_in_hole"

    def __post_init__(self) -> None:
        read_geometry(
            self, "point", "hole_point", direction="cylinder's axis", hole_direction="hole's axis"
        )
        require_length(f"{self.name}.length", self.length, ">")
        low, high = ends(self.point, self.direction, self.length).T
        across = triad(self.hole_direction)[:, :2]
        points = np.column_stack((low, low, high, high))
        self._hold_points(points, np.hstack((across, across)), self.hole_point[:, None])
