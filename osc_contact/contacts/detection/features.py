"""Which feature of a convex solid lies foremost in a direction: vertex, edge, face or round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.contacts.detection.shapes import Solid
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, cross

__all__ = ["Feature", "foremost", "plane_axes"]

_DISC_POINTS = 24


@dataclass(frozen=True)
class Feature:
    """The part of a body that touches.

    Attributes:
        name: vertex, edge, face, sphere, cylinder (its side), or rim (of a cylinder's end).
        dimension: 0 a point, 1 a line, 2 a plane.
        points: (1, 3) the point, (2, 3) ends of the line, or (k, 3) corners of the plane (m).
        radius: around `points`, of sphere and cylinder (m).
        normal: (3,) outward, of a face.
        centre, axis: (3,) of a rim (m); unit axis.
    """

    name: str
    dimension: int
    points: Array
    radius: float = 0.0
    normal: Array | None = None
    centre: Array | None = None
    axis: Array | None = None

    @property
    def direction(self) -> Array:
        """(3,) unit direction of a line."""
        along: Array = self.points[-1] - self.points[0]
        return along / np.linalg.norm(along)

    @property
    def disc(self) -> tuple[Array, Array, float]:
        """(centre, axis, radius) of a rim."""
        if self.centre is None or self.axis is None:
            raise InvalidInputError(f"a {self.name} is no rim and has no disc")
        return self.centre, self.axis, float(np.linalg.norm(self.points[0] - self.centre))

    def moved(self, X: pin.SE3) -> Feature:
        """The same feature in the coordinates X maps to."""
        normal = None if self.normal is None else X.rotation @ self.normal
        centre = None if self.centre is None else X.act(self.centre)
        axis = None if self.axis is None else X.rotation @ self.axis
        points = self.points @ X.rotation.T + X.translation
        return Feature(self.name, self.dimension, points, self.radius, normal, centre, axis)

    def lift(self, point: Array, n: Array) -> Array:
        """The point of the feature's line or plane that `point` meets when moved along n."""
        if self.dimension == 0:
            return self.points[0]
        if self.normal is not None:
            return point + n * (((self.points[0] - point) @ self.normal) / (n @ self.normal))
        along = self.direction
        across = along - (along @ n) * n
        start = self.points[0]
        return start + along * (((point - start) @ across) / (across @ across))

    def lowered(self, points: Array) -> Feature:
        """What is left of it where only `points` (k, 3), on the feature, touch."""
        dimension = min(len(points), 3) - 1
        if dimension == self.dimension:
            return self
        names = ("sphere", "cylinder") if self.radius > 0.0 else ("vertex", "edge")
        return Feature(names[dimension], dimension, points, self.radius)


def foremost(solid: Solid, d: Array, margin: float, angle: float) -> Feature:
    """The feature of `solid` that reaches farthest along the unit vector d.

    Corners belong to it that lie back, seen from the foremost one, by no more than `margin` (m)
    and by no more than `angle` (rad) times their distance from it. One such corner is a vertex,
    corners in line are an edge, others a face.

    Args:
        solid: a convex shape. d: (3,) unit vector. margin: m. angle: rad.
    """
    if solid.axis is not None:
        return _of_cylinder(solid, solid.axis, d, margin, angle)
    heights = solid.corners @ d
    top = int(heights.argmax())
    drop = heights[top] - heights
    distance = np.linalg.norm(solid.corners - solid.corners[top], axis=1)
    active = np.flatnonzero(drop <= np.minimum(margin, angle * distance) + 1e-12)
    points = solid.corners[active]
    if len(points) > 2 and not _collinear(points):
        normal = solid.normals[int((solid.normals @ d).argmax())]
        if np.linalg.norm(cross(normal, d)) <= angle:
            return Feature("face", 2, _round_trip(points, normal), 0.0, normal)
        others = active[active != top]  # steeper than `angle` across: the flattest edge is left
        flattest = others[int((drop[others] / distance[others]).argmin())]
        points = solid.corners[[top, flattest]]
    if len(points) == 1:
        return Feature("sphere" if solid.radius > 0.0 else "vertex", 0, points, solid.radius)
    along = (points - points[0]) @ (points[-1] - points[0])
    ends = points[[int(along.argmin()), int(along.argmax())]]
    return Feature("cylinder" if solid.radius > 0.0 else "edge", 1, ends, solid.radius)


def plane_axes(n: Array) -> Array:
    """(2, 3) two unit vectors that make a right-handed system with the unit vector n."""
    u = cross(n, np.eye(3)[int(np.abs(n).argmin())])
    u /= np.linalg.norm(u)
    return np.array((u, cross(n, u)))


def _of_cylinder(solid: Solid, axis: Array, d: Array, margin: float, angle: float) -> Feature:
    along = float(axis @ d)
    radial = d - along * axis
    sine = float(np.linalg.norm(radial))
    end = solid.corners[int((solid.corners @ d).argmax())]
    length = float(np.linalg.norm(solid.corners[1] - solid.corners[0]))
    if sine <= min(margin / (2.0 * solid.radius), angle):
        normal = axis if along > 0.0 else -axis
        turn = 2.0 * np.pi * np.arange(_DISC_POINTS) / _DISC_POINTS
        disc = np.column_stack((np.cos(turn), np.sin(turn))) @ plane_axes(normal)
        return Feature("face", 2, end + solid.radius * disc, 0.0, normal)
    if abs(along) <= min(margin / length, angle):
        return Feature("cylinder", 1, solid.corners, solid.radius)
    low = end + solid.radius * radial / sine
    return Feature("rim", 0, low[None, :], centre=end, axis=axis)


def _collinear(points: Array) -> bool:
    spread = np.linalg.svd(points - points[0], compute_uv=False)
    return bool(spread[1] <= 1e-9 * spread[0])


def _round_trip(points: Array, normal: Array) -> Array:
    """The corners of a convex face in counterclockwise order."""
    flat = (points - points.mean(axis=0)) @ plane_axes(normal).T
    return points[np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))]
