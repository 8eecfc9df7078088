"""Pairs made of points of the object, each held on a plane of the environment."""

from typing import Literal

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.pairs.pair import (
    Bodies,
    Direction,
    Extent,
    ExtentKey,
    LawPair,
    PairRow,
    Point,
    Radius,
    RadiusKey,
    register_pair,
    shape,
    store,
    triad,
)
from osc_contact.law.records import POINTS
from osc_contact.scenarios.bodies import (
    BodyDirection,
    BodyPoint,
    OnBodySpec,
    OnFaceSpec,
    OnPlaneSpec,
)
from osc_contact.scenarios.quantities import UnitVec3, Vec3
from osc_contact.spatial import Array


class PointsOnPlanes(LawPair):
    """r points pⱼ of A at the distance ρ from r planes of E with unit directions nⱼ into them.

    Nⱼ = [nⱼ; (pⱼ − O) × nⱼ]. nⱼ is fixed in the environment, pⱼ in the object: ṅ = ω_E × n,
    ṗ = v_O(p), so Ṅ = [ṅ; ṗ × n + (p − O) × ṅ] and n_γ = −ṄᵀV_rel
    = −ṅ · v_rel(p) − n · (ω_rel × ṗ). The gaps are the distances minus ρ. All this holds with open
    gaps too.

    A sphere or cylinder touches where its surface meets the plane, but its line of force passes
    through the centre or axis: `points` are there and only the gap contains the radius ρ.
    """

    _points: Array
    _into: Array
    _reach: Array
    _heights: Array

    def _hold_points(
        self, points: Array, into: Array, on_plane: Array, radius: float = 0.0
    ) -> None:
        """Take points (3, r) of A, unit directions (3, 1 or r), and a point (3,) of all planes."""
        into = np.broadcast_to(into, points.shape)
        heights = (into * on_plane[:, None]).sum(axis=0)
        store(self, _points=points, _into=into, _reach=heights - radius, _heights=heights)
        shapes = map(shape, points.T, into.T, heights)
        self._hold(PairRow(POINTS, tuple(shapes)), on_plane)

    def _gaps(self, b: Bodies) -> Array:
        """(r,) signed distances (m), negative where the two overlap."""
        n = b.rotate_E(self._into)
        apart = (b.X_E.translation - b.X_A.translation) @ n
        return self._reach + apart - np.einsum("ij,ij->j", b.point_A(self._points), n)


def ends(point: Array, direction: Array, length: float) -> Array:
    """(3, 2) the two ends of a segment whose middle is `point`.

    Args:
        point, direction: (3,) middle (m) and unit vector. length: m.
    """
    half = 0.5 * length * direction
    return np.column_stack((point - half, point + half))


# A vertex of the object on a face of the environment.


class VertexOnFaceSpec(OnFaceSpec):
    """A rounded vertex of the object on a face of the environment."""

    forces = 1
    type: Literal["vertex_on_face"] = "vertex_on_face"
    vertex: Vec3
    """the centre of the rounded vertex [x, y, z] in the object frame"""
    radius: RadiusKey = 0.0
    """of the rounding"""


@register_pair(VertexOnFaceSpec)
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

    vertex: Point
    point: Point
    normal: Direction
    radius: Radius = 0.0
    name: str = "vertex_on_face"
    pushes = True

    def _make(self) -> None:
        self._hold_points(self.vertex[:, None], -self.normal[:, None], self.point, self.radius)

    def row(self) -> PairRow:
        """The pair as the compiled law reads it."""
        return self._row

    def gap(self, X_WO: SE3, X_WE: SE3 | None = None) -> float:
        """Distance between vertex surface and face (m), negative when they overlap."""
        return float(self.gaps(X_WO, X_WE)[0])

    def point_on_face(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """(3,) where the line of force meets the face, world (m)."""
        return super().points_of_contact(X_WO, X_WE)[:, 0]

    def points_of_contact(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """(3, 1) the same as a column."""
        return self.point_on_face(X_WO, X_WE)[:, None]

    def direction(self, X_WE: SE3 | None = None) -> Array:
        """(3,) unit vector into the face, world: the direction of a positive contact force."""
        return -self.normal if X_WE is None else -X_WE.rotation @ self.normal

    def face_placement(self) -> SE3:
        """Pose of the face's surface in the environment frame: z along the outward normal."""
        return SE3(triad(self.normal), self.point)


# A sphere of the object on a plane of the environment.


class SphereOnPlaneSpec(OnPlaneSpec):
    """A sphere (or rounded vertex) of the object on a face of a body, r = 1."""

    forces = 1
    type: Literal["sphere_on_plane"] = "sphere_on_plane"
    centre: Vec3
    """the centre of the sphere [x, y, z] in the object frame"""
    radius: RadiusKey = 0.0
    """of the sphere"""


@register_pair(SphereOnPlaneSpec, face_point="point", face_normal="normal")
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

    centre: Point
    radius: Radius
    point: Point
    normal: Direction
    name: str = "sphere_on_plane"
    pushes = True

    def _make(self) -> None:
        self._hold_points(self.centre[:, None], -self.normal[:, None], self.point, self.radius)


# An edge of the object on a face of the environment.


class EdgeOnFaceSpec(OnPlaneSpec):
    """A straight edge of the object on a face of a body: forces at two of its points, r = 2."""

    forces = 2
    type: Literal["edge_on_face"] = "edge_on_face"
    point: Vec3
    """the middle of the edge [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the edge [x, y, z] in the object frame"""
    length: ExtentKey = 0.1
    """between the two points of the edge at which forces are commanded"""


@register_pair(EdgeOnFaceSpec)
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

    point: Point
    direction: Direction
    face_point: Point
    face_normal: Direction
    length: Extent = 0.1
    name: str = "edge_on_face"
    pushes = True

    def _make(self) -> None:
        feet = ends(self.point, self.direction, self.length)
        self._hold_points(feet, -self.face_normal[:, None], self.face_point)


# A cylinder of the object on a plane of the environment.


class CylinderOnPlaneSpec(OnPlaneSpec):
    """A cylinder of the object on a face of a body: forces at two of its points, r = 2."""

    forces = 2
    type: Literal["cylinder_on_plane"] = "cylinder_on_plane"
    point: Vec3
    """the middle of the axis [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the axis [x, y, z] in the object frame"""
    radius: RadiusKey = 0.0
    """of the cylinder"""
    length: ExtentKey = 0.1
    """between the two points of the axis at which forces are commanded"""


@register_pair(CylinderOnPlaneSpec)
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

    point: Point
    direction: Direction
    radius: Radius
    face_point: Point
    face_normal: Direction
    length: Extent = 0.1
    name: str = "cylinder_on_plane"
    pushes = True

    def _make(self) -> None:
        feet = ends(self.point, self.direction, self.length)
        self._hold_points(feet, -self.face_normal[:, None], self.face_point, self.radius)


# A flat face of the object on a flat face of the environment.


_CORNERS = np.deg2rad([90.0, 210.0, 330.0])


class FaceOnFaceSpec(OnPlaneSpec):
    """A face of the object on a face of a body: forces at three corners of a triangle, r = 3."""

    forces = 3
    type: Literal["face_on_face"] = "face_on_face"
    point: Vec3
    """the middle of the triangle [x, y, z] in the object frame"""
    normal: UnitVec3
    """the outward normal of the object's face [x, y, z] in the object frame"""
    size: ExtentKey = 0.1
    """from the middle of the face to the three corners at which forces are commanded"""


@register_pair(FaceOnFaceSpec)
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

    point: Point
    normal: Direction
    face_point: Point
    face_normal: Direction
    size: Extent = 0.1
    name: str = "face_on_face"
    pushes = True

    def _make(self) -> None:
        drawn = np.array((np.cos(_CORNERS), np.sin(_CORNERS)))
        corners = self.point[:, None] + self.size * triad(self.normal)[:, :2] @ drawn
        self._hold_points(corners, -self.face_normal[:, None], self.face_point)


# A cylinder of the object in a hole of the environment.


class CylinderInHoleSpec(OnBodySpec):
    """A cylinder of the object in a hole without play: two cross forces at two points, r = 4."""

    forces = 4
    type: Literal["cylinder_in_hole"] = "cylinder_in_hole"
    point: Vec3
    """the middle of the cylinder's axis [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the cylinder's axis [x, y, z] in the object frame"""
    hole_point: BodyPoint
    """a point of the hole's axis [x, y, z] in the body frame"""
    hole_direction: BodyDirection
    """along the hole's axis [x, y, z] in the body frame"""
    length: ExtentKey = 0.1
    """between the two points of the axis at which forces are commanded"""


@register_pair(CylinderInHoleSpec)
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

    point: Point
    direction: Direction
    hole_point: Point
    hole_direction: Direction
    length: Extent = 0.1
    name: str = "cylinder_in_hole"

    def _make(self) -> None:
        points = np.repeat(ends(self.point, self.direction, self.length), 2, axis=1)
        across = triad(self.hole_direction)[:, :2]
        self._hold_points(points, np.hstack((across, across)), self.hole_point)
