"""Collision shapes of a body: the coal geometry, and the corners, faces and edges it has."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.robots import load_geometry
from osc_contact.robots.xml_tree import read_bytes
from osc_contact.spatial import Array

__all__ = ["CollisionShape", "Solid", "collision_shapes"]

_CONVEX_SLACK = 1e-6
"""A mesh counts as convex if no corner rises higher above a triangle, relative to its size."""


@dataclass(frozen=True)
class Solid:
    """A convex solid: the hull of corners, rounded by a radius.

    Sphere and capsule are one and two corners with a ball at each; a cylinder (`axis` given) has a
    disc across its axis at each of its two ends instead.

    Attributes:
        corners: (k, 3) m. radius: m. axis: (3,) unit, only of a cylinder.
        normals: (m, 3) unit outward normals of the plane faces.
        edges: (e, 3) unit directions of the straight edges (and of the line a side can lie on).
    """

    corners: Array
    radius: float = 0.0
    axis: Array | None = None
    normals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    edges: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def moved(self, X: pin.SE3) -> Solid:
        """The same solid in the coordinates X maps to."""
        R, t = X.rotation, X.translation
        axis = None if self.axis is None else R @ self.axis
        return Solid(
            self.corners @ R.T + t, self.radius, axis, self.normals @ R.T, self.edges @ R.T
        )

    def support(self, directions: Array) -> Array:
        """(m,) how far the solid reaches along each of the unit `directions` (m, 3)."""
        round_part: Array | float = self.radius
        if self.axis is not None:
            along = directions @ self.axis
            round_part = self.radius * np.sqrt(np.maximum(0.0, 1.0 - along**2))
        return np.max(directions @ self.corners.T, axis=1) + round_part


@dataclass(frozen=True)
class CollisionShape:
    """One convex shape of a body.

    Attributes:
        name: used in messages and in the names of contacts.
        shape: coal Box, Sphere, Cylinder, Capsule or Convex.
        placement: of the shape in the frame of its body.
        solid: its corners, faces and edges in that frame.

    Raises:
        InvalidInputError: another kind of shape, or one blown up by a swept-sphere radius.
    """

    name: str
    shape: Any
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    solid: Solid = field(init=False, repr=False)

    def __post_init__(self) -> None:
        swept = self.shape.getSweptSphereRadius()
        if swept > 0.0:
            raise InvalidInputError(
                f"{self.name}: swept-sphere radius {swept:g} m; set it to 0 and use a capsule or "
                "sphere for rounded parts"
            )
        object.__setattr__(self, "solid", _solid(self.name, self.shape).moved(self.placement))


def collision_shapes(path: Path | str) -> list[CollisionShape]:
    """The collision shapes of the single rigid body of a URDF, in the frame of its root link.

    A shape is called by the name of its <collision> element where that is given and unique, else
    ``<link>_<number>``. Meshes must be convex.

    Raises:
        ModelError: no such file, a joint moves, no collision geometry, a mesh that is not convex.
    """
    file = Path(path)
    text = read_bytes(file)
    read = _read.__wrapped__ if b"<mesh" in text else _read  # whose files may change
    return list(read(file, text))


@lru_cache(maxsize=32)
def _read(file: Path, text: bytes) -> tuple[CollisionShape, ...]:
    """See `collision_shapes`; `text` is the file's, so that one that was read is not read again."""
    model, geometry, document = load_geometry(file, pin.GeometryType.COLLISION)
    if model.nv > 0:
        moving = ", ".join(list(model.names)[1:])
        raise ModelError(f"{file}: one rigid body is expected, but these joints move: {moving}")
    if len(geometry.geometryObjects) == 0:
        raise ModelError(f"{file}: no link has a <collision> element; nothing can touch")
    given = {
        f"{link.name}_{i}": collision.get("name")
        for link in document.links.values()
        for i, collision in enumerate(link.element.findall("collision"))
    }
    names = list(given.values())
    shapes = []
    for item in geometry.geometryObjects:
        own = given.get(item.name)
        name = own if own and names.count(own) == 1 else item.name
        shape = item.geometry
        if isinstance(shape, coal.BVHModelBase):
            shape = _convex(f"{file}: {name}", shape)
        shapes.append(CollisionShape(name, shape, pin.SE3(item.placement)))
    return tuple(shapes)


def _solid(name: str, shape: Any) -> Solid:
    """Corners, faces and edges in the frame of the coal shape."""
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
        triangles = np.array(
            [[shape.polygons(i)[k] for k in range(3)] for i in range(shape.num_polygons)]
        )
        return Solid(corners, 0.0, None, *_faces_and_edges(corners, triangles))
    raise InvalidInputError(
        f"{name}: contacts of a {type(shape).__name__} are not classified; use boxes, spheres, "
        "cylinders, capsules or convex meshes"
    )


def _faces_and_edges(corners: Array, triangles: Array) -> tuple[Array, Array]:
    """Unit outward normals and unit edge directions, each direction once."""
    a, b, c = (corners[triangles[:, i]] for i in range(3))
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
    return _distinct(normals), _distinct(edges)


def _distinct(directions: Array) -> Array:
    _, index = np.unique(np.round(directions, 9) + 0.0, axis=0, return_index=True)
    return directions[np.sort(index)]


def _convex(name: str, mesh: Any) -> Any:
    """coal.Convex of a mesh that already is convex (coal is built without a hull algorithm)."""
    vertices = np.array(mesh.vertices())
    corners, index = np.unique(np.round(vertices, 12), axis=0, return_inverse=True)
    index = index.reshape(-1)
    triangles = np.array(
        [[index[mesh.tri_indices(i)[k]] for k in range(3)] for i in range(mesh.num_tris)]
    )
    size = np.ptp(corners, axis=0).max()
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    for normal, point in zip(np.cross(b - a, c - a), a, strict=True):
        height = (corners - point) @ normal / (np.linalg.norm(normal) or 1.0)
        if height.max() > _CONVEX_SLACK * size and height.min() < -_CONVEX_SLACK * size:
            raise ModelError(
                f"{name}: the mesh is not convex (corners lie up to {height.max():.3g} m outside "
                "of one of its faces); split it into convex parts"
            )
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(corners))
    faces.extend([coal.Triangle(*(int(k) for k in triangle)) for triangle in triangles])
    return coal.Convex(points, faces)
