"""Pairs made of points of the object, each held on a plane of the environment.

Each pair states its geometry in `_make`, which is called at the end of its construction, by
`_hold_points`: points (3, r) of the object, the normals (3, r) into the planes, a point of all
planes, and the radius of the surface about each point. `ends` are the two ends of a segment,
`triad(n)` (3, 3) has perpendicular unit vectors as columns, the last one along n.
"""

from __future__ import annotations

from math import pi
from typing import Annotated

import numpy as np
from pinocchio import SE3
from pydantic import Field

from osc_contact.contacts.pairs.keys import (
    BodyDirection,
    BodyPoint,
    Direction,
    Extent,
    FaceDirection,
    FacePoint,
    Point,
    Radius,
    store,
)
from osc_contact.contacts.pairs.law_pair import LawPair, shape
from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.pairs.register import register_pair
from osc_contact.errors import InvalidInputError
from osc_contact.law.records import POINTS
from osc_contact.settings.quantities import Angle
from osc_contact.spatial import Array, cross, norm


class PointsOnPlanes(LawPair):
    """Pair of r points pⱼ of A at the distance ρ from r planes of E with unit directions nⱼ inward.

    Nⱼ = [nⱼ; (pⱼ − O) × nⱼ]. nⱼ is fixed in the environment, pⱼ in the object: ṅ = ω_E × n,
    ṗ = v_O(p), so Ṅ = [ṅ; ṗ × n + (p − O) × ṅ] and n_γ = −ṄᵀV_rel
    = −ṅ · v_rel(p) − n · (ω_rel × ṗ). The gaps are the distances minus ρ. The formulas hold with
    open gaps, too.

    The line of force of a sphere or cylinder passes through its centre or axis: pⱼ is a point of
    these, and only the gap contains the radius ρ.
    """

    _points: Array
    _into: Array
    _reach: Array

    def _hold_points(
        self, points: Array, directions: Array, on_plane: Array, radius: float = 0.0
    ) -> None:
        """Set the points and planes of the pair.

        Args:
            points: (3,) or (3, r) points of A (m).
            directions: (3,) or (3, r) unit directions of E into the planes.
            on_plane: (3,) point of E in all planes (m).
            radius: ρ (m).
        """
        points = points.reshape(3, -1)
        directions = np.broadcast_to(directions.reshape(3, -1), points.shape)
        heights = (directions * on_plane[:, None]).sum(axis=0)
        store(self, _points=points, _into=directions, _reach=heights - radius)
        shapes = [
            shape(point, direction, height)
            for point, direction, height in zip(points.T, directions.T, heights, strict=True)
        ]
        self._store_geometry(on_plane, POINTS, tuple(shapes))

    @property
    def into(self) -> Array:
        """(3, r) unit directions into the planes, in the environment frame."""
        return self._into

    def _gaps(self, X_EA: SE3) -> Array:
        """Signed distances (r,) minus ρ (m), negative in an overlap.

        `_points` (3, r) are the points of the object in its frame, `_into` (3, r) the normals into
        the faces and `_reach` (r,) the heights of the faces along them less ρ, in the body's frame.

        Args:
            X_EA: pose of the object in the frame of the environment's body.
        """
        n = self._into
        points = X_EA.rotation @ self._points
        return self._reach - X_EA.translation @ n - np.einsum("ij,ij->j", points, n)


def ends(point: Array, direction: Array, length: float) -> Array:
    """Ends (3, 2) of a segment of a line.

    Args:
        point: (3,) middle of the segment (m).
        direction: (3,) unit direction of the line.
        length: length of the segment (m).
    """
    half = 0.5 * length * direction
    return np.column_stack((point - half, point + half))


# A vertex of the object on a face of the environment.


@register_pair(forces=1)
class VertexOnFace(PointsOnPlanes):
    """A rounded vertex of the object on a face of the environment, r = 1 (fig. 1).

    N = [n; (p − O) × n], n pointing into the face, p the vertex. A vertex rounded with a radius is
    a small sphere: its line of force passes through the centre, so `vertex` is that centre and only
    the gap contains the radius.

    Example:
        >>> table = osc.VertexOnFace([0, 0, 0], point=[0.5, 0, 0.2], normal=[0, 0, 1], radius=0.01)
        >>> print(table.gaps(pin.SE3(np.eye(3), np.array([0.4, 0.1, 0.26]))))
        [0.05]
    """

    vertex: Point
    """the centre of the rounded vertex [x, y, z] in the object frame"""
    point: FacePoint
    """a point of the face [x, y, z] in the environment frame"""
    normal: FaceDirection
    """the outward normal of the face [x, y, z] in the environment frame"""
    radius: Radius = 0.0
    """the radius of the rounding"""
    name: str = "vertex_on_face"
    pushes = True

    def _make(self) -> None:
        """Press the vertex into the face, against its normal."""
        self._hold_points(self.vertex, -self.normal, self.point, self.radius)


# A sphere of the object on a plane of the environment.


@register_pair(forces=1)
class SphereOnPlane(PointsOnPlanes):
    """A sphere (or rounded vertex) of the object on a plane of the environment, r = 1.

    As for a rounded vertex on a face, the line of force passes through the centre.

    Example:
        >>> ball = osc.SphereOnPlane([0, 0, 0], 0.02, face_point=[0, 0, 0], face_normal=[0, 0, 1])
        >>> print(ball.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))).round(6))
        [0.03]
    """

    centre: Point
    """the centre of the sphere [x, y, z] in the object frame"""
    radius: Radius
    """the radius of the sphere"""
    face_point: BodyPoint
    """a point of the body's face [x, y, z] in the body frame"""
    face_normal: BodyDirection
    """the outward normal of that face [x, y, z] in the body frame"""
    name: str = "sphere_on_plane"
    pushes = True

    def _make(self) -> None:
        """Press the sphere's centre against the normal of the body's face."""
        self._hold_points(self.centre, -self.face_normal, self.face_point, self.radius)


# An edge of the object on a face of the environment.


@register_pair(forces=2)
class EdgeOnFace(PointsOnPlanes):
    """A straight edge of the object on a face of the environment, r = 2.

    The distributed force is represented by the forces at two points of the edge, `length` apart
    around `point`, each like a vertex on the face: both magnitudes are forces (N), positive while
    the centre of pressure is between them. Any other length spans the same spaces N and T.

    Example:
        >>> edge = osc.EdgeOnFace([0, 0, 0], [1, 0, 0], face_point=[0, 0, 0], face_normal=[0, 0, 1])
        >>> print(edge.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.02]))).round(6))
        [0.02 0.02]
    """

    point: Point
    """the middle of the edge [x, y, z] in the object frame"""
    direction: Direction
    """the direction of the edge [x, y, z] in the object frame"""
    face_point: BodyPoint
    """a point of the body's face [x, y, z] in the body frame"""
    face_normal: BodyDirection
    """the outward normal of that face [x, y, z] in the body frame"""
    length: Extent = 0.1
    """the distance between the two points of the edge at which forces are commanded"""
    name: str = "edge_on_face"
    pushes = True

    def _make(self) -> None:
        """Press both ends of the edge against the normal of the body's face."""
        feet = ends(self.point, self.direction, self.length)
        self._hold_points(feet, -self.face_normal, self.face_point)


# A cylinder of the object on a plane of the environment.


@register_pair(forces=2)
class CylinderOnPlane(PointsOnPlanes):
    """A cylinder of the object on a plane of the environment, r = 2.

    It is like an edge on a face, with the lines of force through two points of the *axis*, `length`
    apart; only the gaps contain the radius. Rolling is free: N is independent of the line on the
    cylinder's surface that touches.

    Example:
        >>> roll = osc.CylinderOnPlane(
        ...     [0, 0, 0], [1, 0, 0], radius=0.01, face_point=[0, 0, 0], face_normal=[0, 0, 1]
        ... )
        >>> print(roll.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.03]))).round(6))
        [0.02 0.02]
    """

    point: Point
    """the middle of the axis [x, y, z] in the object frame"""
    direction: Direction
    """the direction of the axis [x, y, z] in the object frame"""
    radius: Radius
    """the radius of the cylinder"""
    face_point: BodyPoint
    """a point of the body's face [x, y, z] in the body frame"""
    face_normal: BodyDirection
    """the outward normal of that face [x, y, z] in the body frame"""
    length: Extent = 0.1
    """the distance between the two points of the axis at which forces are commanded"""
    name: str = "cylinder_on_plane"
    pushes = True

    def _make(self) -> None:
        """Press both ends of the cylinder's axis against the normal of the body's face."""
        feet = ends(self.point, self.direction, self.length)
        self._hold_points(feet, -self.face_normal, self.face_point, self.radius)


# A flat face of the object on a flat face of the environment.


_CORNERS = np.deg2rad([90.0, 210.0, 330.0])


@register_pair(forces=3)
class FaceOnFace(PointsOnPlanes):
    """A flat face of the object on a flat face of the environment, r = 3.

    The distributed force is represented by the forces at the three corners of an equilateral
    triangle in the object's face around `point`, each like a vertex on the other face: all three
    magnitudes are forces (N), positive while the centre of pressure is in the triangle. Any other
    triangle spans the same spaces N and T.

    Example:
        >>> foot = osc.FaceOnFace([0, 0, 0], [0, 0, -1], [0, 0, 0], face_normal=[0, 0, 1])
        >>> print(foot.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.02]))).round(6))
        [0.02 0.02 0.02]
    """

    point: Point
    """the middle of the triangle [x, y, z] in the object frame"""
    normal: Direction
    """the outward normal of the object's face [x, y, z] in the object frame"""
    face_point: BodyPoint
    """a point of the body's face [x, y, z] in the body frame"""
    face_normal: BodyDirection
    """the outward normal of that face [x, y, z] in the body frame"""
    size: Extent = 0.1
    """the distance from the middle of the face to the corners at which forces are commanded, which
    [belong on what touches](contacts.md#the-size-of-a-face)"""
    name: str = "face_on_face"
    pushes = True

    def _make(self) -> None:
        """Press the corners of the face against the normal of the body's face."""
        circle = np.array((np.cos(_CORNERS), np.sin(_CORNERS)))
        corners = self.point[:, None] + self.size * triad(self.normal)[:, :2] @ circle
        self._hold_points(corners, -self.face_normal, self.face_point)


# A cylinder of the object in a hole of the environment.


@register_pair(forces=4)
class CylinderInHole(PointsOnPlanes):
    """A cylinder of the object in a hole of the environment without play, r = 4.

    Two points of the cylinder's axis, `length` apart, are each held on the axis of the hole by two
    perpendicular forces (N). The wall touches on any side, so the magnitudes have either sign. The
    cylinder can turn and slide. Any other length spans the same spaces N and T.

    Example:
        >>> peg = osc.CylinderInHole([0, 0, 0], [0, 0, 1], [0, 0, 0], hole_direction=[0, 0, 1])
        >>> peg.contact(pin.SE3.Identity(), np.zeros(6)).r
        4
    """

    point: Point
    """the middle of the cylinder's axis [x, y, z] in the object frame"""
    direction: Direction
    """the direction of the cylinder's axis [x, y, z] in the object frame"""
    hole_point: BodyPoint
    """a point of the hole's axis [x, y, z] in the body frame"""
    hole_direction: BodyDirection
    """the direction of the hole's axis [x, y, z] in the body frame"""
    length: Extent = 0.1
    """the distance between the two points of the axis at which forces are commanded"""
    name: str = "cylinder_in_hole"
    axes_are_chosen = True

    def _make(self) -> None:
        """Press both ends of the axis in two directions across the hole."""
        points = np.repeat(ends(self.point, self.direction, self.length), 2, axis=1)
        axes = triad(self.hole_direction)[:, :2]
        self._hold_points(points, np.hstack((axes, axes)), self.hole_point)


# A cylinder of the object in a V-groove of the environment.


@register_pair(forces=4)
class CylinderInVGroove(PointsOnPlanes):
    """A cylinder of the object on both walls of a V-groove of the environment, r = 4.

    Two points of the axis, `length` apart, are each held at the distance of the radius from both
    walls, like spheres: the magnitudes are forces into the walls (N), at each point first into the
    wall on the side of direction × outward. The cylinder may slide along the groove and roll about
    its own axis. Any other length spans the same spaces N and T.

    Example:
        >>> point, along, up = [0, 0, 0], [1, 0, 0], [0, 0, 1]
        >>> rod = osc.CylinderInVGroove(point, along, 0.01, point, along, groove_outward=up)
        >>> rod.contact(pin.SE3.Identity(), np.zeros(6)).r
        4
    """

    point: Point
    """the middle of the axis [x, y, z] in the object frame"""
    direction: Direction
    """the direction of the axis [x, y, z] in the object frame"""
    radius: Radius
    """the radius of the cylinder"""
    groove_point: BodyPoint
    """a point of the line in which the walls meet [x, y, z] in the body frame"""
    groove_direction: BodyDirection
    """the direction of that line [x, y, z] in the body frame"""
    groove_outward: BodyDirection
    """a direction out of the groove, about midway between its walls [x, y, z] in the body frame"""
    groove_angle: Annotated[float, "", Annotated[Angle, Field(gt=0, lt=pi)]] = pi / 2
    """the angle between the walls"""
    length: Extent = 0.1
    """the distance between the two points of the axis at which forces are commanded"""
    name: str = "cylinder_in_v_groove"
    pushes = True

    def _make(self) -> None:
        """Check the groove; press both ends of the cylinder's axis against each of its two walls.

        The four points are both ends of the axis, twice; each is pressed along the unit normal into
        a wall, ±cos(φ/2) side − sin(φ/2) out, with the angle φ between the walls, the direction
        `side` across the groove and the direction `out` of it. The points stay one radius away from
        the walls.

        Raises:
            InvalidInputError: φ is not between 0 and π, or the way out of the groove is along it.
        """
        side = cross(self.groove_direction, self.groove_outward)
        size = norm(side)
        if not (0.0 < self.groove_angle < pi and size > 1e-6):
            raise InvalidInputError(
                f"{self.name}: the walls enclose {self.groove_angle} rad and the way out of the "
                f"groove is {np.arcsin(min(size, 1.0)):.3g} rad off its direction; give an angle "
                "between 0 and π, and a way out that is not along the groove"
            )
        side = side / size
        axes = np.cos(self.groove_angle / 2) * side
        along = np.sin(self.groove_angle / 2) * cross(side, self.groove_direction)
        directions = np.column_stack((axes - along, -axes - along))
        points = np.repeat(ends(self.point, self.direction, self.length), 2, axis=1)
        self._hold_points(
            points, np.hstack((directions, directions)), self.groove_point, self.radius
        )
