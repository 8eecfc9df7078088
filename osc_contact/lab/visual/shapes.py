"""Shapes for meshcat: arrows of changing length, rods, tubes, URDF geometry with its colours.

three.js draws its cylinders along y; every shape here that has a direction therefore lies along
the y-axis of its node, and `along` gives the pose that turns y into the desired direction.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, norm

if TYPE_CHECKING:
    from meshcat import Visualizer

_Y_TO_Z = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3))


def at(point: ArrayLike) -> pin.SE3:
    """Pose at a point (m), not turned."""
    return pin.SE3(np.eye(3), np.asarray(point, dtype=float))


def on_y(y: float) -> pin.SE3:
    """Pose on the y-axis (m), not turned."""
    return at([0.0, y, 0.0])


def along(point: ArrayLike, direction: ArrayLike) -> pin.SE3:
    """Pose of a shape whose y-axis is its axis, such as a cylinder of meshcat.

    Args:
        point: (3,) origin of the pose (m).
        direction: (3,) direction of its y-axis, of any length > 0.

    Raises:
        InvalidInputError: the direction is zero or not finite.
    """
    direction = np.asarray(direction, dtype=float)
    length = norm(direction)
    if not np.isfinite(length) or length == 0.0:
        raise InvalidInputError(f"direction {direction.tolist()} has no finite length > 0")
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 1.0, 0.0]), direction / length)
    return pin.SE3(turn, np.asarray(point, dtype=float))


# --- Paint ------------------------------------------------------------------------------------


def rgb(colour: str | ArrayLike, share: float = 1.0) -> int:
    """A share of the colour ``#RRGGBB`` or (r, g, b, ...) in 0..1 as the number of three.js."""
    if isinstance(colour, str):
        channels = np.frombuffer(bytes.fromhex(colour[1:]), np.uint8) / 255
    else:
        channels = np.clip(np.asarray(colour)[:3], 0.0, 1.0)
    return int(np.round(255 * share * channels) @ [1 << 16, 1 << 8, 1])


def plain(colour: str | ArrayLike, opacity: float = 1.0) -> Any:
    """Material of exactly this colour, in any light."""
    from meshcat.geometry import MeshBasicMaterial

    return MeshBasicMaterial(color=rgb(colour), opacity=opacity, depthWrite=opacity == 1.0)


def material(colour: str | ArrayLike, opacity: float = 1.0, glow: float = 0.0) -> Any:
    """Lit material.

    Args:
        colour: ``#RRGGBB`` or (r, g, b, ...) in 0..1.
        opacity: 0 (invisible) … 1.
        glow: share of the colour that is seen in the dark (0 … 1).
    """
    from meshcat.geometry import MeshLambertMaterial

    return MeshLambertMaterial(
        color=rgb(colour), opacity=opacity, emissive=rgb(colour, glow), depthWrite=opacity == 1.0
    )


# --- Shapes along y ---------------------------------------------------------------------------


def cylinder(
    node: Visualizer, paint: Any, ends: tuple[float, float], radius: float, top: float | None = None
) -> None:
    """Cylinder or cone along the node's y-axis; the node itself moves to its middle.

    Args:
        node: that gets the cylinder.
        paint: its material.
        ends: its lower and upper end on the y-axis of the parent node (m).
        radius: at its lower end (m).
        top: radius at its upper end (m), default the same; 0 makes a cone.
    """
    from meshcat.geometry import Cylinder

    low, high = ends
    upper = radius if top is None else top
    node.set_object(Cylinder(high - low, radiusTop=upper, radiusBottom=radius), paint)
    node.set_transform(on_y(0.5 * (low + high)).homogeneous)


def tube(points: ArrayLike, radius: float, sides: int = 6) -> Any:
    """Mesh of a tube around a path (k, 3), k >= 2; repeated points are left out.

    Args:
        points: (k, 3) the path (m).
        radius: radius of the tube (m).
        sides: sides of its cross section.
    """
    from meshcat.geometry import TriangularMeshGeometry

    path = np.asarray(points, dtype=float)
    is_distinct = np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9
    path = path[np.concatenate([[True], is_distinct])]
    if len(path) < 2:
        path = np.vstack([path, path[-1] + [0.0, 0.0, 1e-4]])
    forward = np.gradient(path, axis=0)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    # a direction across the path, begun with the axis that is least parallel to it
    side = np.cross(forward[0], np.eye(3)[np.argmin(np.abs(forward[0]))])
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    circle = radius * np.array([np.cos(angles), np.sin(angles)]).T
    rings = []
    for point, ahead in zip(path, forward, strict=True):
        side = side - (side @ ahead) * ahead  # carried along without twisting
        side /= max(norm(side), 1e-12)
        rings.append(point + circle @ [side, np.cross(ahead, side)])
    # two triangles for each side between neighbouring rings, by the indices of their corners
    first = np.arange((len(path) - 1) * sides).reshape(-1, sides)
    second = np.roll(first, -1, axis=1)
    faces = [[first, second, first + sides], [second, second + sides, first + sides]]
    triangles = np.array(faces).transpose(0, 2, 3, 1).reshape(-1, 3)
    return TriangularMeshGeometry(np.vstack(rings).astype(np.float32), triangles.astype(np.uint32))


# --- Shapes of a URDF -------------------------------------------------------------------------


def urdf_geometry(node: Visualizer, shape: pin.GeometryObject) -> None:
    """Draw one geometry of a URDF (box, cylinder, sphere, capsule or mesh) at the node.

    The node's transform becomes the shape's placement in its parent joint.

    Args:
        node: node of the viewer's tree, for this geometry alone.
        shape: geometry with its colour and placement.

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
        body.set_object(mc.Box((2.0 * np.asarray(form.halfSide)).tolist()), paint)
    elif isinstance(form, coal.Sphere):
        body.set_object(mc.Sphere(form.radius), paint)
    elif isinstance(form, coal.Cylinder | coal.Capsule):
        # meshcat's cylinders have their axis along y, coal's along z; a capsule has two balls, too
        side = body if isinstance(form, coal.Cylinder) else body["side"]
        side.set_object(mc.Cylinder(2.0 * form.halfLength, form.radius), paint)
        side.set_transform(_Y_TO_Z.homogeneous)
        if isinstance(form, coal.Capsule):
            for name, z in (("top", form.halfLength), ("bottom", -form.halfLength)):
                body[name].set_object(mc.Sphere(form.radius), paint)
                body[name].set_transform(at([0.0, 0.0, z]).homogeneous)
    elif isinstance(form, coal.BVHModelBase):
        corners = np.asarray(form.vertices(), dtype=np.float32).reshape(-1, 3)
        faces = map(form.tri_indices, range(form.num_tris))
        triangles = np.array([[face[0], face[1], face[2]] for face in faces])
        mesh_file = None if shape.overrideMaterial else shape.meshPath
        colours = mesh_file and vertex_colours(mesh_file, triangles, len(corners))
        if colours is not None:
            paint = mc.MeshLambertMaterial(color=0xFFFFFF, vertexColors=True)
        body.set_object(mc.TriangularMeshGeometry(corners, triangles, colours), paint)
    else:
        raise InvalidInputError(
            f"geometry {shape.name!r} is a {type(form).__name__}, which cannot be drawn: "
            "use a box, cylinder, sphere, capsule or mesh"
        )
    node.set_transform(shape.placement.homogeneous)


SPACE = {"c": "http://www.collada.org/2005/11/COLLADASchema"}
GROUPS = ("triangles", "polylist", "polygons")
LOST_SHARE = 0.005
"""Readers drop triangles without area: a few may be missing."""


def vertex_colours(
    file: str | Path, triangles: NDArray[np.integer], vertices: int
) -> NDArray[np.float32] | None:
    """Colours (vertices, 3) in 0..1 of a mesh, which coal does not read; None without colours.

    Args:
        file: file of the mesh.
        triangles: (k, 3) indices of the vertices, in the order of the file.
        vertices: number of vertices.
    """
    of_triangles = triangle_colours(file, len(triangles))
    if of_triangles is None:
        return None
    colours = np.ones((vertices, 3), dtype=np.float32)
    colours[np.asarray(triangles)] = of_triangles[:, None]
    return colours


def triangle_colours(file: str | Path, count: int) -> Array | None:
    """Colours of the triangles of a COLLADA file.

    White is drawn at 0.88 and black at 0.14: their shapes are seen by light and shade.

    Args:
        file: path of the file; other formats have no colours.
        count: number of triangles of the mesh that was loaded from it.

    Returns:
        (count, 3) red, green and blue in 0 … 1; None if the file has no colours, or its
        number of triangles differs from `count` by more than degenerate triangles explain.
    """
    if Path(file).suffix.lower() != ".dae":
        return None
    try:
        shades, counts = zip(*_groups(ET.parse(file).getroot()), strict=True)
    except (OSError, ET.ParseError, ValueError):  # the last one: also of no groups at all
        return None
    colours = np.repeat(shades, counts, axis=0)
    if not len(colours) or abs(len(colours) - count) > LOST_SHARE * len(colours):
        return None
    # degenerate triangles are not loaded: the remaining ones take the colours at equal shares
    places = np.linspace(0, len(colours) - 1, count).round().astype(int)
    return 0.14 + 0.74 * np.clip(colours[places], 0.0, 1.0)


def _groups(root: ET.Element) -> Iterator[tuple[list[float], int]]:
    """Colour and number of the triangles of one material, in the order of the file.

    Args:
        root: root element of the COLLADA file.
    """
    geometries = {g.get("id"): g for g in root.findall(".//c:geometry", SPACE)}
    for instance in root.findall(".//c:visual_scene//c:instance_geometry", SPACE):
        bound = {
            binding.get("symbol"): binding.get("target", "")[1:]
            for binding in instance.findall(".//c:instance_material", SPACE)
        }
        for part in geometries[instance.get("url", "")[1:]].findall("c:mesh/*", SPACE):
            if part.tag.split("}")[-1] in GROUPS:
                yield (
                    _colour(root, bound.get(part.get("material"), "")),
                    int(part.get("count", 0)),
                )


def _colour(root: ET.Element, material: str) -> list[float]:
    """Diffuse colour r, g, b (0 … 1) of a material; light grey without one.

    Args:
        root: root of a COLLADA file.
        material: identifier of the material.
    """
    effect = root.find(f".//c:material[@id='{material}']/c:instance_effect", SPACE)
    if effect is None:
        return [0.8, 0.8, 0.8]
    name = effect.get("url", "").removeprefix("#")
    diffuse = root.findtext(f".//c:effect[@id='{name}']//c:diffuse/c:color", None, SPACE)
    if not diffuse:
        return [0.8, 0.8, 0.8]
    return [float(word) for word in diffuse.split()[:3]]
