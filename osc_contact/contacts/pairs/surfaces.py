"""Pairs with a surface: a face on a face (r = 3), a cylinder in a hole (r = 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.contacts.pairs.lines import ends
from osc_contact.contacts.pairs.pair import read_geometry, require_length, triad
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.spatial import Array

__all__ = ["FaceOnFace", "CylinderInHole"]

_CORNERS = np.deg2rad([90.0, 210.0, 330.0])


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

    def __post_init__(self) -> None:
        read_geometry(
            self, "point", "face_point", normal="outward normal", face_normal="outward normal"
        )
        require_length(f"{self.name}.size", self.size, ">")
        drawn = np.array((np.cos(_CORNERS), np.sin(_CORNERS)))
        corners = self.point[:, None] + self.size * triad(self.normal)[:, :2] @ drawn
        into = np.tile(-self.face_normal[:, None], 3)
        self._hold(corners, into, self.face_point[:, None])


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
        self._hold(points, np.hstack((across, across)), self.hole_point[:, None])
