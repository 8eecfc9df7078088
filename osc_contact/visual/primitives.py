"""Shapes for meshcat: arrows of changing length, rods, tubes, URDF geometry.

three.js draws its cylinders along y; every shape here that has a direction therefore lies along
the y-axis of its node, and `along` gives the pose that turns y into the wanted direction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.visual.mesh_colours import vertex_colours

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = [
    "along", "arrow", "arrow_lengths", "cone", "material", "plain", "rgb", "rod", "tube",
    "urdf_geometry",
]  # fmt: skip

HEAD_LENGTH = 0.035
"""Length of an arrow's head in m; shorter arrows are all head, shrunk."""
_SHORTEST = 1e-6
Triple = tuple[float, float, float]
_Y_TO_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def along(point: ArrayLike, direction: ArrayLike) -> pin.SE3:
    """Pose whose origin is the point (m) and whose y-axis is the direction (any length > 0).

    Raises:
        InvalidInputError: the direction is zero or not finite.
    """
    direction = np.asarray(direction, dtype=float)
    length = float(np.linalg.norm(direction))
    if not np.isfinite(length) or length == 0.0:
        raise InvalidInputError(f"direction {direction.tolist()} has no finite length > 0")
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 1.0, 0.0]), direction / length)
    return pin.SE3(turn.matrix(), np.asarray(point, dtype=float))


def rgb(colour: str | ArrayLike) -> int:
    """Colour ``#RRGGBB`` or (r, g, b, ...) in 0..1 as the number that three.js wants."""
    if isinstance(colour, str):
        return int(colour.removeprefix("#"), 16)
    red, green, blue = (round(255 * float(np.clip(c, 0.0, 1.0))) for c in np.asarray(colour)[:3])
    return (red << 16) | (green << 8) | blue


def plain(colour: str | ArrayLike, opacity: float = 1.0) -> Any:
    """Material of exactly this colour, whatever the light."""
    from meshcat.geometry import MeshBasicMaterial

    return MeshBasicMaterial(color=rgb(colour), opacity=opacity, depthWrite=opacity == 1.0)


def material(colour: str | ArrayLike, opacity: float = 1.0, glow: float = 0.0) -> Any:
    """Lit material; ``glow`` in 0..1 is the share of its own colour that needs no light.

    Args:
        colour: ``#RRGGBB`` or (r, g, b, ...) in 0..1.
        opacity: 0 (not seen) … 1.
        glow: share of the colour that is seen in the dark (0 … 1).
    """
    from meshcat.geometry import MeshLambertMaterial

    number = rgb(colour)
    shares = [round(glow * (number >> shift & 255)) for shift in (16, 8, 0)]
    emissive = (shares[0] << 16) | (shares[1] << 8) | shares[2]
    return MeshLambertMaterial(
        color=number, opacity=opacity, emissive=emissive, depthWrite=opacity == 1.0
    )


def arrow(node: Visualizer, colour: str, radius: float = 0.006, opacity: float = 1.0) -> None:
    """Arrow whose TIP is the node's origin and that points along the node's y-axis.

    Its length is changed by the scales of the children ``shaft`` and ``head`` (see
    `arrow_lengths`), which an animation can do; freshly made it is 1 m + head long.

    Args:
        node: that gets the arrow.
        colour: ``#RRGGBB``.
        radius: of the shaft (m).
        opacity: 0 (not seen) … 1.
    """
    from meshcat.geometry import Cylinder

    paint = material(colour, opacity, glow=0.12)
    head = Cylinder(HEAD_LENGTH, radiusTop=0.0, radiusBottom=2.4 * radius)
    node["head/cone"].set_object(head, paint)
    node["head/cone"].set_transform(_shifted(-HEAD_LENGTH / 2))
    node["shaft/rod"].set_object(Cylinder(1.0, radius), paint)
    node["shaft/rod"].set_transform(_shifted(-0.5))


def arrow_lengths(length: float) -> tuple[Triple, float, Triple]:
    """What makes an arrow ``length`` m long: scale of the shaft, its y, scale of the head.

    The head keeps its size; an arrow shorter than its head is a smaller head without shaft.
    """
    length = max(length, _SHORTEST) if np.isfinite(length) else _SHORTEST
    head = min(1.0, length / HEAD_LENGTH)
    stretch = max(length - HEAD_LENGTH, _SHORTEST)
    return (head, stretch, head), -HEAD_LENGTH * head, (head, head, head)


def rod(node: Visualizer, paint: Any, length: float, radius: float = 0.002) -> None:
    """Thin cylinder along the node's y-axis, centred on the node's origin.

    Args:
        node: that gets the rod.
        paint: its material.
        length, radius: in m.
    """
    from meshcat.geometry import Cylinder

    node["rod"].set_object(Cylinder(length, radius), paint)


def cone(node: Visualizer, paint: Any, tip: float, length: float, radius: float) -> None:
    """Cone along the node's y-axis; its apex at y = tip, the base on the origin's side.

    Args:
        node: that gets the cone.
        paint: its material.
        tip: of the apex along y (m).
        length, radius: in m.
    """
    from meshcat.geometry import Cylinder

    ends = (0.0, radius) if tip >= 0.0 else (radius, 0.0)
    node.set_object(Cylinder(length, radiusTop=ends[0], radiusBottom=ends[1]), paint)
    node.set_transform(_shifted(tip - np.copysign(0.5 * length, tip)))


def tube(points: ArrayLike, radius: float, sides: int = 6) -> Any:
    """Mesh of a tube around a path (k, 3), k >= 2; repeated points are left out.

    Args:
        points: (k, 3) the path (m).
        radius: of the tube (m).
        sides: of its cross section.
    """
    from meshcat.geometry import TriangularMeshGeometry

    path = np.asarray(points, dtype=float)
    far = np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9
    path = path[np.concatenate([[True], far])]
    if len(path) < 2:
        path = np.vstack([path, path[-1] + [0.0, 0.0, 1e-4]])
    forward = np.gradient(path, axis=0)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    side = np.cross(forward[0], np.eye(3)[np.argmin(np.abs(forward[0]))])
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    rings = []
    for point, along_path in zip(path, forward, strict=True):
        side = side - (side @ along_path) * along_path  # carried along without twisting
        side /= max(float(np.linalg.norm(side)), 1e-12)
        other = np.cross(along_path, side)
        rings.append(point + radius * (np.outer(np.cos(angles), side)
                                       + np.outer(np.sin(angles), other)))  # fmt: skip
    first = np.arange((len(path) - 1) * sides).reshape(-1, sides)
    second = np.roll(first, -1, axis=1)
    faces = [(first, second, first + sides), (second, second + sides, first + sides)]
    triangles = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in faces])
    return TriangularMeshGeometry(np.vstack(rings).astype(np.float32), triangles.astype(np.uint32))


def urdf_geometry(node: Visualizer, shape: pin.GeometryObject) -> None:
    """Draw one geometry of a URDF (box, cylinder, sphere, capsule or mesh) at the node.

    The node's transform becomes the shape's placement in its parent joint.

    Raises:
        InvalidInputError: a kind of geometry that cannot be drawn.
    """
    import coal
    from meshcat import geometry as mc

    colour = np.asarray(shape.meshColor, dtype=float)
    paint = material(colour, float(colour[3]))
    form = shape.geometry
    body = node["shape"]
    if isinstance(form, coal.Box):
        body.set_object(mc.Box([float(2.0 * half) for half in form.halfSide]), paint)
    elif isinstance(form, coal.Sphere):
        body.set_object(mc.Sphere(float(form.radius)), paint)
    elif isinstance(form, coal.Cylinder):
        body.set_object(mc.Cylinder(2.0 * form.halfLength, form.radius), paint)
        body.set_transform(pin.SE3(_Y_TO_Z, np.zeros(3)).homogeneous)
    elif isinstance(form, coal.Capsule):
        body["side"].set_object(mc.Cylinder(2.0 * form.halfLength, form.radius), paint)
        body["side"].set_transform(pin.SE3(_Y_TO_Z, np.zeros(3)).homogeneous)
        for name, sign in (("top", 1.0), ("bottom", -1.0)):
            end = np.array([0.0, 0.0, sign * form.halfLength])
            body[name].set_object(mc.Sphere(float(form.radius)), paint)
            body[name].set_transform(pin.SE3(np.eye(3), end).homogeneous)
    elif isinstance(form, coal.BVHModelBase):
        corners = np.asarray(form.vertices(), dtype=np.float32).reshape(-1, 3)
        faces = (form.tri_indices(i) for i in range(form.num_tris))
        triangles = np.array([[face[0], face[1], face[2]] for face in faces])
        colours = (
            None
            if shape.overrideMaterial
            else vertex_colours(shape.meshPath, triangles, len(corners))
        )
        if colours is not None:
            paint = mc.MeshLambertMaterial(color=0xFFFFFF, vertexColors=True)
        body.set_object(mc.TriangularMeshGeometry(corners, triangles, colours), paint)
    else:
        raise InvalidInputError(
            f"geometry {shape.name!r} is a {type(form).__name__}, which cannot be drawn: "
            "use a box, cylinder, sphere, capsule or mesh"
        )
    node.set_transform(shape.placement.homogeneous)


def _shifted(y: float) -> NDArray[np.float64]:
    """Homogeneous transform that moves by y along the y-axis."""
    shift: NDArray[np.float64] = np.eye(4)
    shift[1, 3] = y
    return shift
