"""Shapes of MJCF arms and MuJoCo scenes for drawing, as JSON data for recordings.

A picture consists of joints, shapes and colours. It contains neither file names nor code.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import InvalidInputError
from osc_contact.files import Json
from osc_contact.robots.mjcf import bodies_of, compile_mjcf, joint_name, load_mjcf
from osc_contact.robots.model import joint_axis, joint_names, slides
from osc_contact.spatial import Array, norm

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

MOST_CORNERS = 200_000  #: largest number of corners, and of faces, of a mesh; else its box is drawn
_SPHERE, _CAPSULE, _CYLINDER, _BOX, _MESH = 2, 3, 5, 6, 7  #: MuJoCo's numbers of geom types


def mjcf_geometry(path: Path | str, tip: str | None) -> tuple[pin.Model, pin.GeometryModel]:
    """Load kinematics and shapes of the tip's kinematic tree in an MJCF file.

    Args:
        path: the MJCF file.
        tip: a body or site of the tree; None: all trees that do not begin with a free joint.
    """
    mj = compile_mjcf(path)
    import mujoco  # installed, as the file has been compiled

    model = load_mjcf(mj, tip)
    data = mujoco.MjData(mj)
    mujoco.mj_kinematics(mj, data)
    numbers = {joint_name(mj, j): j for j in range(mj.njnt)}
    joints = {numbers[name]: j for j, name in enumerate(joint_names(model), 1)}
    q = data.qpos[mj.jnt_qposadr[list(joints)]]
    return read_picture(scene_picture(mj, data, model, q, joints, bodies_of(mj, tip)))


def _geom_colour(mj: MjModel, g: int) -> Array:
    """Colour r, g, b, a (4,) of a geom, given by its number: its material's or else its own."""
    material = mj.geom_matid[g]
    return np.array(mj.mat_rgba[material] if material >= 0 else mj.geom_rgba[g], dtype=float)


def _solid_of_geom(kind: int, size: Iterable[float]) -> coal.CollisionGeometry | None:
    """Make the shape of a geom that is not a mesh; None for types that are not drawn.

    Args:
        kind: MuJoCo's number of the type.
        size: (3,) MuJoCo's `geom_size`: radius and half length, or half edges (m).
    """
    first, second, third = map(float, size)
    if kind == _SPHERE:
        return coal.Sphere(first)
    if kind == _CAPSULE:
        return coal.Capsule(first, 2.0 * second)
    if kind == _CYLINDER:
        return coal.Cylinder(first, 2.0 * second)
    if kind == _BOX:
        return coal.Box(2.0 * first, 2.0 * second, 2.0 * third)
    return None


def scene_picture(
    mj: MjModel,
    data: MjData,
    model: pin.Model,
    q: Array,
    joints: Mapping[int, int],
    only: Collection[int] = (),
) -> Json:
    """Describe a MuJoCo scene for drawing, as JSON data.

    A body of the arm is drawn by its geoms that cannot collide or, if it has none, by all of its
    geoms; other bodies are drawn by all of theirs. Planes, height fields, ellipsoids and
    transparent geoms are left out. Loose bodies are drawn at their present poses.

    Args:
        mj: compiled model.
        data: its state, with the placements at q.
        model: Pinocchio model of the arm, base included.
        q: (n,) joint positions of `model`.
        joints: by number of a joint in `mj`, its number in `model`.
        only: numbers of the arm's bodies, if nothing else is to be drawn.
    """
    pin_data = model.createData()
    pin.forwardKinematics(model, pin_data, q)
    joint_of_body = {mj.jnt_bodyid[j]: joint for j, joint in joints.items()}
    owner = [0] * mj.nbody  # for each body the joint of `model` that moves it; 0: none
    for b in range(1, mj.nbody):
        owner[b] = joint_of_body.get(b, owner[mj.body_parentid[b]])
    collides = (mj.geom_contype | mj.geom_conaffinity) != 0
    bodies_with_visuals = set(mj.geom_bodyid[~collides])
    shapes = []
    for g in range(mj.ngeom):
        body = mj.geom_bodyid[g]
        joint = owner[body]
        rgba = _geom_colour(mj, g)
        is_arm = body in only if only else joint > 0
        is_hidden = is_arm and body in bodies_with_visuals and collides[g]
        is_left_out = is_hidden or not rgba[3] or (only and not is_arm)
        shape = None if is_left_out else _geom_data(mj, g)
        if shape is not None:
            X = pin.SE3(np.array(data.geom_xmat[g]).reshape(3, 3), np.array(data.geom_xpos[g]))
            place = _pose_numbers(pin_data.oMi[joint].actInv(X))
            shapes.append({"joint": joint, "place": place, "rgba": _rounded(rgba)} | shape)
    return {"joints": [_joint_data(model, j) for j in range(1, model.njoints)], "shapes": shapes}


def _joint_data(model: pin.Model, j: int) -> Json:
    """Describe name, parent, placement and axis of a joint as JSON data.

    Args:
        model: model of the arm.
        j: number of the joint, from 1.
    """
    linear, angular = joint_axis(model, j).reshape(2, 3)
    is_slide = slides(model, j)
    return {
        "name": model.names[j].split("/")[-1],
        "parent": int(model.parents[j]),
        "place": _pose_numbers(model.jointPlacements[j]),
        "axis": _rounded(linear if is_slide else angular),
        "slides": is_slide,
    }


def _geom_data(mj: MjModel, g: int) -> Json | None:
    """Describe type and size, or corners and faces, of a geom as JSON data; None: it is not drawn.

    Args:
        mj: compiled model.
        g: number of the geom.
    """
    kind = int(mj.geom_type[g])
    size = _rounded(mj.geom_size[g])
    if kind != _MESH:
        return {"kind": kind, "size": size} if _solid_of_geom(kind, size) else None
    mesh = mj.mesh(mj.geom_dataid[g])
    v = mesh.vertadr[0]
    f = mesh.faceadr[0]
    corners = mj.mesh_vert[v : v + mesh.vertnum[0]]
    faces = mj.mesh_face[f : f + mesh.facenum[0]]
    if max(len(corners), len(faces)) > MOST_CORNERS:
        return {"kind": _BOX, "size": _rounded(np.abs(corners).max(axis=0))}
    return {"kind": _MESH, "corners": _packed(corners, "<f4"), "faces": _packed(faces, "<i4")}


def _packed(rows: ArrayLike, kind: str) -> str:
    """Compress numbers (k, 3) of the NumPy type `kind` to text, see `_unpacked`."""
    raw = np.array(rows, dtype=kind).tobytes()
    return base64.b64encode(zlib.compress(raw, 9)).decode()


def _unpacked(text: str, kind: str) -> Array:
    """Decompress numbers (k, 3) from a text by `_packed`.

    At most `MOST_CORNERS` rows are decompressed, so that a damaged text cannot fill the memory.

    Args:
        text: compressed numbers in base 64.
        kind: NumPy type of the numbers, of 4 bytes, such as "<f4".

    Raises:
        ValueError, zlib.error: the text is damaged.
    """
    raw = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), 12 * MOST_CORNERS)
    return np.frombuffer(raw, dtype=kind).reshape(-1, 3)


def _rounded(numbers: Iterable[float]) -> list[float]:
    """Numbers rounded to seven decimals, which keeps recordings small."""
    return [round(float(x), 7) for x in numbers]


def _pose_numbers(X: pin.SE3) -> list[float]:
    """List position (m) and quaternion x, y, z, w of a pose, seven numbers."""
    return _rounded(pin.SE3ToXYZQUAT(X))


def read_picture(picture: Mapping[str, Any]) -> tuple[pin.Model, pin.GeometryModel]:
    """Build kinematics and shapes from a picture by `scene_picture`.

    Raises:
        InvalidInputError: the picture is damaged.
    """
    try:
        return _read(picture)
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError, zlib.error) as error:
        raise InvalidInputError(f"the picture of the scene is damaged: {error!r}") from error


def _read(picture: Mapping[str, Any]) -> tuple[pin.Model, pin.GeometryModel]:
    """Build kinematics and shapes from a picture; a damaged picture raises errors of many kinds.

    Args:
        picture: the content of a picture: `joints`, each with parent, placement, axis and kind, in
            the order of their numbers from 1, and `shapes`, each with the number of its joint,
            placement, kind and size.
    """
    model = pin.Model()
    geometry = pin.GeometryModel()
    for joint in picture["joints"]:
        axis = np.array(joint["axis"], dtype=float)
        axis /= norm(axis)
        if joint["slides"]:
            joint_model = pin.JointModelPrismaticUnaligned(axis)
        else:
            joint_model = pin.JointModelRevoluteUnaligned(axis)
        model.addJoint(
            int(joint["parent"]), joint_model, _pose_of_numbers(joint["place"]), str(joint["name"])
        )
    # shapes of the joints' bodies; joint 0 is the world
    for i, shape in enumerate(picture["shapes"]):
        joint = int(shape["joint"])
        if not 0 <= joint < model.njoints:
            raise IndexError(f"shape {i} is on joint {joint} of {model.njoints - 1}")
        kind = int(shape["kind"])
        if kind == _MESH:
            solid = _mesh_of(_unpacked(shape["corners"], "<f4"), _unpacked(shape["faces"], "<i4"))
        else:
            solid = _solid_of_geom(kind, shape["size"])
        shape_object = pin.GeometryObject(
            f"shape{i}", joint, _pose_of_numbers(shape["place"]), solid
        )
        shape_object.meshColor = np.array(shape["rgba"], dtype=float)
        shape_object.overrideMaterial = True
        geometry.addGeometryObject(shape_object)
    return (model, geometry)


def _mesh_of(corners: Array, faces: Array) -> coal.BVHModelOBBRSS:
    """Make a mesh of triangles.

    Args:
        corners: (k, 3) positions of the corners (m).
        faces: (m, 3) indices of the corners of each triangle.

    Raises:
        ValueError: an index is out of range.
    """
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(corners):
        raise ValueError(f"faces name corners beyond {len(corners)}")
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(corners))
    mesh.addVertices(np.array(corners, dtype=float))
    mesh.addTriangles(np.array(faces, dtype=np.int32))
    mesh.endModel()
    return mesh


def _pose_of_numbers(place: Sequence[float]) -> pin.SE3:
    """Convert seven numbers to a pose.

    Args:
        place: position (m), then quaternion x, y, z, w.

    Raises:
        ValueError: another shape, numbers that are not finite, or not a unit quaternion.
    """
    X = np.array(place, dtype=float)
    if X.shape != (7,) or not np.isfinite(X).all() or abs(norm(X[3:]) - 1.0) > 1e-3:
        raise ValueError(f"{place} is no pose")
    X[3:] /= norm(X[3:])
    return pin.XYZQUATToSE3(X)
