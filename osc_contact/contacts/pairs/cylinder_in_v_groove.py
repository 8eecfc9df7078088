"""A cylinder of the object in a V-groove of the environment."""

from math import pi
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from osc_contact.contacts.pairs.pair import (
    Direction,
    Extent,
    ExtentKey,
    Point,
    Radius,
    RadiusKey,
    register_pair,
)
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes, ends
from osc_contact.errors import InvalidInputError
from osc_contact.scenarios.bodies import BodyDirection, BodyPoint, OnBodySpec
from osc_contact.scenarios.quantities import Angle, UnitVec3, Vec3
from osc_contact.spatial import cross, norm


class CylinderInVGrooveSpec(OnBodySpec):
    """A cylinder of the object in a V-groove: forces at two of its points on each wall, r = 4."""

    forces = 4
    type: Literal["cylinder_in_v_groove"] = "cylinder_in_v_groove"
    point: Vec3
    """the middle of the axis [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the axis [x, y, z] in the object frame"""
    radius: RadiusKey = 0.0
    """of the cylinder"""
    groove_point: BodyPoint
    """a point of the line in which the walls meet [x, y, z] in the body frame"""
    groove_direction: BodyDirection
    """along that line [x, y, z] in the body frame"""
    groove_outward: BodyDirection
    """roughly out of the groove, midway between its walls [x, y, z] in the body frame"""
    groove_angle: Annotated[Angle, Field(gt=0, lt=pi)] = pi / 2
    """from wall to wall"""
    length: ExtentKey = 0.1
    """between the two points of the axis at which forces are commanded"""


@register_pair(CylinderInVGrooveSpec)
class CylinderInVGroove(PointsOnPlanes):
    """A cylinder of the held object on both walls of a V-groove of the environment (r = 4).

    Two points of the axis, `length` apart, are each held at the distance of the radius from both
    walls, like spheres: the magnitudes are forces into the walls (N), at each point first into the
    wall on the side of direction × outward. The cylinder may slide along the groove and roll about
    its own axis. Any other length spans the same spaces N and T.

    Attributes:
        point: (3,) the middle of the axis in the object frame (m).
        direction: (3,) along the axis in the object frame; normalised on entry.
        radius: of the cylinder (m).
        groove_point: (3,) a point of the line in which the walls meet, environment frame (m).
        groove_direction: (3,) along that line, environment frame; normalised on entry.
        groove_outward: (3,) out of the groove, environment frame; its component across the groove
            lies midway between the walls.
        groove_angle: between the walls (rad), 0 … π.
        length: between the two points (m).
        name: used in messages and recordings.
    """

    point: Point
    direction: Direction
    radius: Radius
    groove_point: Point
    groove_direction: Direction
    groove_outward: Direction
    groove_angle: float = pi / 2
    length: Extent = 0.1
    name: str = "cylinder_in_v_groove"
    pushes = True

    def _make(self) -> None:
        side = cross(self.groove_direction, self.groove_outward)
        size = norm(side)
        if not (0.0 < self.groove_angle < pi and size > 1e-6):
            raise InvalidInputError(
                f"{self.name}: the walls enclose {self.groove_angle} rad and the way out of the "
                f"groove is {np.arcsin(min(size, 1.0)):.3g} rad off its direction; give an angle "
                "between 0 and π, and a way out that is not along the groove"
            )
        side = side / size
        across = np.cos(self.groove_angle / 2) * side
        along = np.sin(self.groove_angle / 2) * cross(side, self.groove_direction)
        into = np.column_stack((across - along, -across - along))
        points = np.repeat(ends(self.point, self.direction, self.length), 2, axis=1)
        self._hold_points(points, np.hstack((into, into)), self.groove_point, self.radius)
