"""Shapes for meshcat: arrows of changing length, lines of force, URDF geometry.

three.js draws its cylinders along y; every shape here that has a direction therefore lies along
the y-axis of its node, and `along` gives the pose that turns y into the wanted direction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from osc_contact.errors import InvalidInputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from meshcat import Visualizer
    from meshcat.animation import Animation

__all__ = [
    "along", "arrow", "arrow_lengths", "line_of_force", "urdf_geometry", "rgb", "material",
    "move", "track",
]  # fmt: skip

HEAD_LENGTH = 0.035
"""Length of an arrow's head in m; shorter arrows are all head, shrunk."""
_SHORTEST = 1e-6
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


def material(colour: str | ArrayLike, opacity: float = 1.0, glow: float = 0.0) -> Any:
    """Lit material; ``glow`` in 0..1 is the share of its own colour that needs no light."""
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
    """
    from meshcat.geometry import Cylinder

    paint = material(colour, opacity, glow=0.35)
    head = Cylinder(HEAD_LENGTH, radiusTop=0.0, radiusBottom=2.4 * radius)
    node["head/cone"].set_object(head, paint)
    node["head/cone"].set_transform(_shifted(-HEAD_LENGTH / 2))
    node["shaft/rod"].set_object(Cylinder(1.0, radius), paint)
    node["shaft/rod"].set_transform(_shifted(-0.5))
    node["shaft"].set_transform(_shifted(-HEAD_LENGTH))


def arrow_lengths(length: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """What makes an arrow ``length`` (T,) m long: (shaft scale (T,3), shaft y (T,), head scale).

    The head keeps its size; an arrow shorter than its head is a smaller head without shaft.
    """
    length = np.maximum(np.nan_to_num(np.asarray(length, dtype=float)), _SHORTEST)
    head = np.minimum(1.0, length / HEAD_LENGTH)
    stretch = np.maximum(length - HEAD_LENGTH, _SHORTEST)
    shaft = np.column_stack([head, stretch, head])
    return shaft, -HEAD_LENGTH * head, np.repeat(head[:, None], 3, axis=1)


def line_of_force(node: Visualizer, colour: str, length: float, radius: float = 0.002) -> None:
    """Long thin cylinder along the node's y-axis, centred on the node's origin."""
    from meshcat.geometry import Cylinder

    node["line"].set_object(Cylinder(length, radius), material(colour, 0.75, glow=0.5))


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
        triangles = [[face[0], face[1], face[2]] for face in faces]
        body.set_object(mc.TriangularMeshGeometry(corners, triangles), paint)
    else:
        raise InvalidInputError(
            f"geometry {shape.name!r} is a {type(form).__name__}, which cannot be drawn: "
            "use a box, cylinder, sphere, capsule or mesh"
        )
    node.set_transform(shape.placement.homogeneous)


def move(node: Visualizer, animation: Animation, poses: Sequence[pin.SE3]) -> None:
    """Start the node at the first pose and animate it through all of them."""
    node.set_transform(poses[0].homogeneous)
    numbers = np.array([pin.SE3ToXYZQUAT(pose) for pose in poses])
    track(node, animation, "position", "vector3", numbers[:, :3])
    track(node, animation, "quaternion", "quaternion", numbers[:, 3:])


def track(
    node: Visualizer, animation: Animation, name: str, kind: str, values: NDArray[Any]
) -> None:
    """Key frames of one property; keys inside a stretch of equal values are left out."""
    from meshcat.animation import AnimationClip, AnimationTrack

    same = np.all(np.reshape(values[1:] == values[:-1], (len(values) - 1, -1)), axis=1)
    inner = np.zeros(len(values), dtype=bool)
    inner[1:-1] = same[:-1] & same[1:]
    frames = np.flatnonzero(~inner)
    clip = animation.clips.setdefault(node.path, AnimationClip(fps=animation.default_framerate))
    clip.tracks[name] = AnimationTrack(name, kind, frames.tolist(), values[frames].tolist())


def _shifted(y: float) -> NDArray[np.float64]:
    """Homogeneous transform that moves by y along the y-axis."""
    shift: NDArray[np.float64] = np.eye(4)
    shift[1, 3] = y
    return shift
