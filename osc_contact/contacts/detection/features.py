"""Collision shapes, their nearest points and features, and normals of contact."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from pinocchio import SE3

from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.surface import triangles_of
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.robots import load_geometry
from osc_contact.robots.elements import read_bytes
from osc_contact.robots.model import joint_names
from osc_contact.spatial import Array, cross, norm

# --- Solids of a collision geometry ---------------------------------------------------------------

_CONVEX_SLACK = 1e-6
"""Largest height of a corner of a convex mesh above a triangle, over the size of the mesh."""


@dataclass(frozen=True)
class Solid:
    """Convex solid: the hull of corners, rounded by a radius.

    A sphere has one corner and a capsule two, with a ball at each; a cylinder (with an `axis`) has
    two, with a disc across its axis at each.

    Attributes:
        corners: (k, 3) corners (m).
        radius: radius of the balls or discs (m).
        axis: (3,) unit axis of a cylinder; else None.
        normals: (m, 3) unit outward normals of the plane faces.
        edges: (e, 3) unit directions of the straight edges, and of a rounded side.
    """

    corners: Array
    radius: float = 0.0
    axis: Array | None = None
    normals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    edges: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def moved(self, X: SE3) -> Solid:
        """Solid in other coordinates, to which the pose X maps."""
        R = X.rotation
        t = X.translation
        axis = None if self.axis is None else R @ self.axis
        return Solid(
            self.corners @ R.T + t, self.radius, axis, self.normals @ R.T, self.edges @ R.T
        )

    def support(self, directions: Array) -> Array:
        """Support function of the solid (m) for unit `directions` (3,) or (m, 3)."""
        round_part: Array | float = self.radius
        if self.axis is not None:
            components = directions @ self.axis
            round_part = self.radius * np.sqrt(np.maximum(0.0, 1.0 - components**2))
        return np.max(directions @ self.corners.T, axis=-1) + round_part


@dataclass(frozen=True)
class CollisionShape:
    """Convex shape of a body.

    Attributes:
        name: name in messages and in the names of contacts.
        shape: coal Box, Sphere, Cylinder, Capsule or Convex.
        placement: pose of the shape in the frame of its body.
        solid: corners, faces and edges of the shape in that frame.

    Raises:
        InvalidInputError: another kind of shape, or a shape with a swept-sphere radius.
    """

    name: str
    shape: coal.ShapeBase
    placement: SE3 = field(default_factory=SE3.Identity)
    solid: Solid = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Compute the solid of the shape in the frame of its body.

        Raises:
            InvalidInputError: the shape has a swept-sphere radius, or is of an unknown kind.
        """
        swept = self.shape.getSweptSphereRadius()
        if swept > 0.0:
            raise InvalidInputError(
                f"{self.name}: swept-sphere radius {swept:g} m; set it to 0 and use a capsule or "
                "sphere for rounded parts"
            )
        object.__setattr__(
            self, "solid", _solid_of_shape(self.name, self.shape).moved(self.placement)
        )


def collision_shapes(path: Path | str) -> list[CollisionShape]:
    """Collision shapes of the single rigid body of a URDF, in the frame of its root link.

    The name of a shape is that of its <collision> element, if there is one and it is unique, else
    ``<link>_<number>``. Meshes must be convex.

    Args:
        path: path of the URDF.

    Raises:
        ModelError: no such file, a joint moves, no collision geometry, a mesh that is not convex.
    """
    file = Path(path)
    text = read_bytes(file)
    if b"<mesh" in text:  # the files of meshes may change: they are read every time
        return list(_read.__wrapped__(file, text))
    return list(_read(file, text))


@lru_cache(maxsize=32)
def _read(file: Path, text: bytes) -> tuple[CollisionShape, ...]:
    """Read the collision shapes of a file; each content `text` is read once.

    A shape has the name of its <collision> element if that is unique in the file, else the name of
    its link and a number. Meshes become convex shapes.

    Args:
        file: URDF of one rigid body.
        text: content of the file, so that a changed file is read again.

    Returns:
        Shapes with names and placements in the frame of the body.

    Raises:
        ModelError: the file has joints that move, no shapes, or a mesh that is not convex.
    """
    model, geometry, document = load_geometry(file, pin.GeometryType.COLLISION)
    if model.nv > 0:
        joint_text = ", ".join(joint_names(model))
        raise ModelError(f"{file}: one rigid body is expected, but these joints move: {joint_text}")
    if len(geometry.geometryObjects) == 0:
        raise ModelError(f"{file}: no link has a <collision> element; nothing can touch")
    names_in_file = {
        f"{link.name}_{i}": collision.get("name")
        for link in document.links.values()
        for i, collision in enumerate(link.element.findall("collision"))
    }
    names = list(names_in_file.values())
    shapes = []
    for item in geometry.geometryObjects:
        name_in_file = names_in_file.get(item.name)
        name = name_in_file if name_in_file and names.count(name_in_file) == 1 else item.name
        shape = item.geometry
        if isinstance(shape, coal.BVHModelBase):
            shape = _convex_shape(f"{file}: {name}", shape)
        shapes.append(CollisionShape(name, shape, SE3(item.placement)))
    return tuple(shapes)


def _solid_of_shape(name: str, shape: coal.ShapeBase) -> Solid:
    """Corners, faces and edges of a coal shape in its own frame.

    Args:
        name: name of the shape, for messages.
        shape: the shape.

    Raises:
        InvalidInputError: another kind of shape.
    """
    eye = np.eye(3)
    z = eye[2:]
    if isinstance(shape, coal.Box):
        corners = np.array(list(product((-1.0, 1.0), repeat=3))) * shape.halfSide
        return Solid(corners, normals=np.vstack((eye, -eye)), edges=eye)
    if isinstance(shape, coal.Sphere):
        return Solid(np.zeros((1, 3)), shape.radius)
    if isinstance(shape, coal.Capsule):
        return Solid(np.vstack((-z, z)) * shape.halfLength, shape.radius, edges=z)
    if isinstance(shape, coal.Cylinder):
        ends = np.vstack((-z, z))
        return Solid(ends * shape.halfLength, shape.radius, eye[2], normals=ends, edges=z)
    if isinstance(shape, coal.Convex):
        corners = np.array(shape.points())
        triangles = triangles_of(shape.polygons, shape.num_polygons)
        return Solid(corners, 0.0, None, *_faces_and_edges(corners, triangles))
    raise InvalidInputError(
        f"{name}: contacts of a {type(shape).__name__} are not classified; use boxes, spheres, "
        "cylinders, capsules or convex meshes"
    )


def _faces_and_edges(corners: Array, triangles: Array) -> tuple[Array, Array]:
    """Unit outward normals (m, 3) and unit edge directions (e, 3), each direction once.

    Args:
        corners: (k, 3) corners of a convex solid (m).
        triangles: (t, 3) indices of the corners of its triangles.
    """
    a, b, c = corners[triangles].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    keep = area > 1e-12 * area.max()
    normals = normals[keep] / area[keep, None]
    outward = np.einsum("ij,ij->i", normals, a[keep] - corners.mean(axis=0))
    normals *= np.sign(outward)[:, None]
    edges = np.vstack((b - a, c - b, a - c))
    edges /= np.linalg.norm(edges, axis=1)[:, None]
    first = np.argmax(np.abs(edges) > 1e-9, axis=1)
    edges *= np.sign(edges[np.arange(len(edges)), first])[:, None]
    return (_distinct_directions(normals), _distinct_directions(edges))


def _distinct_directions(directions: Array) -> Array:
    """Unit vectors (m, 3) without repetitions, in their order."""
    _, index = np.unique(np.round(directions, 9) + 0.0, axis=0, return_index=True)
    return directions[np.sort(index)]


def _convex_shape(name: str, mesh: coal.BVHModelBase) -> coal.Convex:
    """Convex shape of a mesh that is convex already; this coal has no hull algorithm.

    Args:
        name: name of the mesh, for messages.
        mesh: the mesh.

    Raises:
        ModelError: the mesh is not convex.
    """
    vertices = np.array(mesh.vertices())
    corners, index = np.unique(np.round(vertices, 12), axis=0, return_inverse=True)
    triangles = index.reshape(-1)[triangles_of(mesh.tri_indices, mesh.num_tris)]
    size = np.ptp(corners, axis=0).max()
    a, b, c = corners[triangles].swapaxes(0, 1)
    for normal, point in zip(np.cross(b - a, c - a), a, strict=True):
        height = (corners - point) @ normal / (norm(normal) or 1.0)
        if height.max() > _CONVEX_SLACK * size and height.min() < -_CONVEX_SLACK * size:
            raise ModelError(
                f"{name}: the mesh is not convex (corners lie up to {height.max():.3g} m outside "
                "of one of its faces); split it into convex parts"
            )
    points = coal.StdVec_Vec3s()
    faces = coal.StdVec_Triangle()
    points.extend(list(corners))
    faces.extend([coal.Triangle(*triangle) for triangle in triangles.tolist()])
    return coal.Convex(points, faces)


# --- Nearest points of two solids -----------------------------------------------------------------


@dataclass(frozen=True)
class Nearest:
    """Distance and nearest points of two shapes.

    Attributes:
        distance: distance (m), negative in an overlap; 0 if the solver fails.
        normal: (3,) unit vector from the second to the first, with an error of about 1e-2 near
            touch; zero if the solver fails.
        witness: (3,) nearest point of the second shape (m).
    """

    distance: float
    normal: Array
    witness: Array


def nearest(a: coal.ShapeBase, X_A: SE3, e: coal.ShapeBase, X_E: SE3) -> Nearest:
    """Distance and nearest points of two coal shapes.

    Args:
        a, e: the shapes.
        X_A, X_E: poses of the shapes in the world.
    """
    result = coal.DistanceResult()
    at_a = coal.Transform3s(X_A.rotation, X_A.translation)
    at_e = coal.Transform3s(X_E.rotation, X_E.translation)
    distance = coal.distance(a, at_a, e, at_e, coal.DistanceRequest(), result)
    normal = -np.array(result.normal)
    witness = np.array(result.getNearestPoint2())
    if not (abs(distance) < 1e6 and np.isfinite(normal).all() and np.isfinite(witness).all()):
        return Nearest(0.0, np.zeros(3), X_E.translation)
    return Nearest(float(distance), normal, witness)


# --- Faces, edges, rims and vertices --------------------------------------------------------------

_DISC_POINTS = 24  #: corners of the polygon that represents a disc


@dataclass(frozen=True)
class Feature:
    """Part of a body that touches.

    Attributes:
        name: "vertex", "edge", "face", "sphere", "cylinder" (its side), or "rim" (of its end).
        dimension: 0 of a point, 1 of a line, 2 of a plane.
        points: (1, 3) the point, (2, 3) ends of the line, or (k, 3) corners of the face (m).
        radius: radius around `points` of sphere and cylinder (m).
        normal: (3,) outward unit normal of a face.
        centre: (3,) centre of a rim (m).
        axis: (3,) unit axis of a rim.
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
        """Unit direction (3,) of a line."""
        edge: Array = self.points[-1] - self.points[0]
        return edge / norm(edge)

    def moved(self, X: SE3) -> Feature:
        """Compute the same feature in other coordinates.

        Args:
            X: pose that maps the feature's coordinates to the new ones.
        """
        normal = None if self.normal is None else X.rotation @ self.normal
        centre = None if self.centre is None else X.act(self.centre)
        axis = None if self.axis is None else X.rotation @ self.axis
        points = self.points @ X.rotation.T + X.translation
        return Feature(self.name, self.dimension, points, self.radius, normal, centre, axis)

    def lift(self, point: Array, n: Array) -> Array:
        """Find the point of the feature that is nearest to a line along the contact's normal.

        An edge or a face counts as the whole line or plane through it.

        Args:
            point: (3,) point of the line, in the feature's coordinates (m).
            n: (3,) unit vector along the line.

        Returns:
            Point (3,) of the feature, in its coordinates (m).
        """
        if self.dimension == 0:
            return self.points[0]
        if self.normal is not None:  # the line intersects the plane of the face
            return point + n * (((self.points[0] - point) @ self.normal) / (n @ self.normal))
        # along n, edge and line must coincide: only the part of the edge across n counts
        axis = self.direction
        normal_part = axis - (axis @ n) * n
        start = self.points[0]
        return start + axis * (((point - start) @ normal_part) / (normal_part @ normal_part))

    def lowered(self, points: Array) -> Feature:
        """Reduce the feature to the part that touches: of an edge a vertex, of a face an edge, …

        Args:
            points: (k, 3) points of the feature that touch: one for a vertex, two for an edge,
                three or more for a face (m).

        Returns:
            The feature itself if it touches as a whole, else the vertex, edge, sphere or cylinder
            of these points.
        """
        dimension = min(len(points), 3) - 1
        if dimension == self.dimension:
            return self
        names = ("sphere", "cylinder") if self.radius > 0.0 else ("vertex", "edge")
        return Feature(names[dimension], dimension, points, self.radius)


def foremost(solid: Solid, d: Array, margin: float, angle: float) -> Feature:
    """Feature of a solid that is foremost along a direction.

    It consists of the corners that are behind the foremost one by at most `margin` and by at most
    `angle` times their distance from it. A single corner is a vertex, corners in line are an edge,
    others a face.

    Args:
        solid: convex solid.
        d: (3,) unit vector.
        margin: largest distance behind the foremost corner (m).
        angle: largest inclination (rad).
    """
    if solid.axis is not None:
        return _cylinder_feature(solid, solid.axis, d, margin, angle)
    # corners that are as far forward as the foremost one, within the tolerances
    heights = solid.corners @ d
    top = heights.argmax()
    drop = heights[top] - heights
    distance = np.linalg.norm(solid.corners - solid.corners[top], axis=1)
    active = np.flatnonzero(drop <= np.minimum(margin, angle * distance) + 1e-12)
    points = solid.corners[active]
    if len(points) > 2 and not _are_collinear(points):
        normal = solid.normals[(solid.normals @ d).argmax()]
        if norm(cross(normal, d)) <= angle:
            return Feature("face", 2, _round_trip(points, normal), 0.0, normal)
        # The face is inclined by more than `angle`, although each corner is within the tolerances:
        # only the flattest edge at the foremost corner touches.
        other_corners = active[active != top]
        flattest = other_corners[(drop[other_corners] / distance[other_corners]).argmin()]
        points = solid.corners[[top, flattest]]
    if len(points) == 1:
        return Feature("sphere" if solid.radius > 0.0 else "vertex", 0, points, solid.radius)
    # the outermost two of points in line
    positions = (points - points[0]) @ (points[-1] - points[0])
    ends = points[[positions.argmin(), positions.argmax()]]
    return Feature("cylinder" if solid.radius > 0.0 else "edge", 1, ends, solid.radius)


def _cylinder_feature(solid: Solid, axis: Array, d: Array, margin: float, angle: float) -> Feature:
    """Feature of a cylinder that lies foremost along a direction: end face, side line or rim point.

    Args:
        solid: the cylinder, whose two corners are the centres of its end faces (m).
        axis: (3,) unit vector along its axis.
        d: (3,) unit direction.
        margin: distance along d within which points count as foremost (m).
        angle: angle of a face or side from its ideal direction up to which it counts (rad).
    """
    component = float(axis @ d)
    radial = d - component * axis
    sine = norm(radial)
    end = solid.corners[(solid.corners @ d).argmax()]
    length = norm(solid.corners[1] - solid.corners[0])
    if sine <= min(margin / (2.0 * solid.radius), angle):
        normal = axis if component > 0.0 else -axis
        turn = 2.0 * np.pi * np.arange(_DISC_POINTS) / _DISC_POINTS
        disc = np.column_stack((np.cos(turn), np.sin(turn))) @ triad(normal)[:, :2].T
        return Feature("face", 2, end + solid.radius * disc, 0.0, normal)
    if abs(component) <= min(margin / length, angle):
        return Feature("cylinder", 1, solid.corners, solid.radius)
    low = end + solid.radius * radial / sine
    return Feature("rim", 0, low[None, :], centre=end, axis=axis)


def _are_collinear(points: Array) -> bool:
    """Return whether points (k, 3) are on a line."""
    spread = np.linalg.svd(points - points[0], compute_uv=False)
    return bool(spread[1] <= 1e-9 * spread[0])


def _round_trip(points: Array, normal: Array) -> Array:
    """Corners (k, 3) of a convex face in counterclockwise order about its normal (3,)."""
    plane_coordinates = (points - points.mean(axis=0)) @ triad(normal)[:, :2]
    return points[np.argsort(np.arctan2(plane_coordinates[:, 1], plane_coordinates[:, 0]))]


# --- The patch that two features share ------------------------------------------------------------


def shared_patch(
    a: Feature, e: Feature, n: Array, witness: Array, width: float, angle: float
) -> Array:
    """Points (k, 3) of the patch in which two features overlap, projected along the normal.

    A patch narrower than `width` is a line (k = 2), and a line shorter than `width` a point
    (k = 1). The components of the points along n are zero.

    Args:
        a, e: features of object and environment.
        n: (3,) unit normal.
        witness: (3,) point to be used if the features do not overlap (m).
        width: least width of a patch (m).
        angle: largest angle between parallel lines (rad).
    """
    axes = triad(n)[:, :2].T
    flat_a = a.points @ axes.T
    flat_e = e.points @ axes.T
    if a.dimension == 0:
        points = flat_a
    elif e.dimension == 0:
        points = flat_e
    elif a.dimension == e.dimension == 1:
        points = _of_lines(flat_a, flat_e, angle)
    elif e.dimension == 2:
        points = _clipped_polygon(flat_a, flat_e)
    else:
        points = _clipped_polygon(flat_e, flat_a[::-1])  # its normal is −n
    if len(points) == 0:
        points = (axes @ witness)[None]
    return _shrink_patch(points, width) @ axes


def _of_lines(a: Array, e: Array, angle: float) -> Array:
    """Intersection (1, 2) of two segments, or the common part (2, 2) of parallel ones.

    Args:
        a, e: (2, 2) ends of the segments (m).
        angle: largest angle between parallel segments (rad).
    """
    along_a = a[1] - a[0]
    along_e = e[1] - e[0]
    lengths = (norm(along_a), norm(along_e))
    sine = (along_a[0] * along_e[1] - along_a[1] * along_e[0]) / (lengths[0] * lengths[1])
    if abs(sine) > angle:
        s, _ = np.linalg.solve(np.column_stack((along_a, -along_e)), e[0] - a[0])
        return (a[0] + np.clip(s, 0.0, 1.0) * along_a)[None, :]
    where = np.clip((e - a[0]) @ along_a / lengths[0] ** 2, 0.0, 1.0)
    return a[0] + np.outer((where.min(), where.max()), along_a)


def _clipped_polygon(subject: Array, window: Array) -> Array:
    """Part (n, 2) of a convex polygon or segment inside a convex polygon (Sutherland-Hodgman).

    Args:
        subject: (k, 2) corners of the polygon, or ends of the segment (m).
        window: (m, 2) corners of the other polygon, counterclockwise (m).
    """
    points = list(subject)
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        inward = np.array((start[1] - end[1], end[0] - start[0]))
        depth = [float(inward @ (p - start)) for p in points]
        part_inside = []
        for i, (p, h) in enumerate(zip(points, depth, strict=True)):
            previous = points[i - 1]
            before = depth[i - 1]
            if (h < 0.0) != (before < 0.0):
                part_inside.append(previous + (p - previous) * (before / (before - h)))
            if h >= 0.0:
                part_inside.append(p)
        points = part_inside
    return np.array(points).reshape(-1, 2)


def _shrink_patch(points: Array, width: float) -> Array:
    """Points (k, 2) of a patch; of a narrow one its two ends, of a short one its middle.

    Args:
        points: (k, 2) corners of the patch (m).
        width: least width of a patch, and least length of a line (m).
    """
    if len(points) == 1:
        return points
    middle = points.mean(axis=0)
    directions = np.linalg.svd(points - middle)[2]
    lengthwise, crosswise = directions @ (points - middle).T
    if np.ptp(lengthwise) <= width:
        return middle[None, :]
    if np.ptp(crosswise) <= width:
        return middle + np.outer((lengthwise.min(), lengthwise.max()), directions[0])
    return points


# --- Normals of contact ---------------------------------------------------------------------------
#
# Near touch an iterative solver finds the normal with an error of at least 1e-5 rad, too coarse for
# N. Therefore the normal is selected among exact ones: for every direction n the support functions
# of the two shapes give a lower bound of their signed distance, and the contact normal is the
# direction of the largest bound. Candidates are the normals of faces and the cross products of
# edges (the environment's faces have priority among equal bounds), and the solver's normal only if
# there are round shapes.

_EQUAL_EXTENT = 1e-9
"""Largest difference of bounds that count as equal (m)."""


def separation(a: Solid, e: Solid, n: Array) -> Any:
    """Gap between two solids along a direction, a lower bound of their signed distance (m).

    Args:
        a, e: solids of object and environment in world axes.
        n: (3,) or (m, 3) unit vectors out of e.
    """
    return -a.support(-n) - e.support(n)


def best_direction(a: Solid, e: Solid, guess: Array | None = None) -> Array:
    """Unit vector (3,) out of e along which the gap between a and e is largest.

    Args:
        a, e: solids of object and environment in world axes.
        guess: (3,) a candidate in addition to the normals and the directions across two edges.
    """
    crosses = cross(a.edges.T[:, :, None], e.edges.T[:, None, :]).reshape(3, -1).T
    length = np.linalg.norm(crosses, axis=1)
    crosses = crosses[length > 1e-6] / length[length > 1e-6, None]
    directions = np.vstack((e.normals, -a.normals, crosses, -crosses))
    if guess is not None and norm(guess) > 0.5:
        directions = np.vstack((directions, guess / norm(guess)))
    if len(directions) == 0:
        directions = np.eye(3)[2:]
    distances = separation(a, e, directions)
    return directions[(distances >= distances.max() - _EQUAL_EXTENT).argmax()]


def exact_normal(a: Feature, e: Feature, n: Array, angle: float) -> Array:
    """Normal (3,) of a contact: that of a face, else across both edges, else between centres.

    Args:
        a, e: features of object and environment.
        n: (3,) unit vector near the normal, which is the result for parallel lines and rims.
        angle: largest angle between parallel lines (rad).
    """
    if e.normal is not None:
        return e.normal
    if a.normal is not None:
        return -a.normal
    if a.dimension == e.dimension == 1:
        normal = cross(a.direction, e.direction)
        if norm(normal) <= angle:
            return n
    elif a.axis is not None or e.axis is not None:
        return n  # that of the solver
    else:
        normal = _nearest_point(a, e) - _nearest_point(e, a)
    normal = normal / norm(normal)
    return normal if normal @ n > 0.0 else -normal


def _nearest_point(a: Feature, e: Feature) -> Array:
    """Point (3,) of feature a that is nearest to feature e, if one of the two is a point (m).

    Args:
        a, e: features in the same coordinates; the one that is no point is a line.
    """
    if a.dimension == 0:
        return a.points[0]
    axis = a.direction
    return a.points[0] + axis * (axis @ (e.points[0] - a.points[0]))
