"""Shapes to draw: of an MJCF arm, and of a MuJoCo scene as data that a recording carries.

A picture holds joints, shapes and colours, and neither names of files nor anything that is
executed.
"""

import base64
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError
from osc_contact.robots.mjcf import bodies_of, compile_mjcf, joint_name, load_mjcf
from osc_contact.robots.model import joint_axis, joint_names, slides
from osc_contact.spatial import Array, norm

MOST_CORNERS = 200_000  #: of one mesh; of a larger one its box is drawn
_MESH = 7  #: MuJoCo's number of the type
_BOX = 6


def mjcf_geometry(path: Path | str, tip: str | None) -> tuple[pin.Model, pin.GeometryModel]:
    """Kinematics and shapes of the tip's tree in an MJCF file, as of its picture."""
    mj = compile_mjcf(path)
    import mujoco  # it is there: the file has been compiled

    model = load_mjcf(mj, tip)
    data = mujoco.MjData(mj)
    mujoco.mj_kinematics(mj, data)
    numbers = {joint_name(mj, j): j for j in range(mj.njnt)}
    joints = {numbers[name]: j for j, name in enumerate(joint_names(model), 1)}
    q = data.qpos[mj.jnt_qposadr[list(joints)]]
    return read_picture(scene_picture(mj, data, model, q, joints, bodies_of(mj, tip)))


def _colour(mj: Any, g: int) -> Array:
    """(4,) of a geom's material, or its own."""
    material = mj.geom_matid[g]
    return np.array(mj.mat_rgba[material] if material >= 0 else mj.geom_rgba[g], dtype=float)


def _solid(kind: int, size: Any) -> Any:
    """The coal shape of a type of geom other than a mesh, None if it has none.

    Args:
        kind: MuJoCo's number of it. size: (3,) as MuJoCo means it.
    """
    radius, half, _ = map(float, size)
    makers = {
        2: lambda: coal.Sphere(radius),
        3: lambda: coal.Capsule(radius, 2.0 * half),
        5: lambda: coal.Cylinder(radius, 2.0 * half),
        _BOX: lambda: coal.Box(*(2.0 * np.array(size, dtype=float))),
    }
    return makers[kind]() if kind in makers else None


def scene_picture(
    mj: Any,
    data: Any,
    model: pin.Model,
    q: Array,
    joints: Mapping[int, int],
    only: Collection[int] = (),
) -> dict[str, Any]:
    """What is seen of a MuJoCo scene, as JSON data.

    Of each body of the arm what touches nothing, or else everything; of the rest everything.
    Planes, height fields, ellipsoids and what is transparent are left out; loose bodies stay where
    they are now.

    Args:
        mj, data: MuJoCo's; the placements of `data` are those at q.
        model: of the arm, base included. q: (n,) its joint positions.
        joints: MuJoCo's joint → number of the joint in `model`.
        only: numbers of the bodies of the arm, and nothing of the rest.
    """
    at = model.createData()
    pin.forwardKinematics(model, at, q)
    moves = {mj.jnt_bodyid[j]: joint for j, joint in joints.items()}
    owner = [0] * mj.nbody
    for b in range(1, mj.nbody):
        owner[b] = moves.get(b, owner[mj.body_parentid[b]])
    touches = (mj.geom_contype | mj.geom_conaffinity) != 0
    dressed = set(mj.geom_bodyid[~touches])
    shapes = []
    for g in range(mj.ngeom):
        body = mj.geom_bodyid[g]
        joint = owner[body]
        rgba = _colour(mj, g)
        of_arm = body in only if only else joint > 0
        hidden = of_arm and body in dressed and touches[g]
        left_out = hidden or not rgba[3] or (only and not of_arm)
        shape = None if left_out else _describe(mj, g)
        if shape is not None:
            X = pin.SE3(np.array(data.geom_xmat[g]).reshape(3, 3), np.array(data.geom_xpos[g]))
            place = _place(at.oMi[joint].actInv(X))
            shapes.append({"joint": joint, "place": place, "rgba": _round(rgba)} | shape)
    return {"joints": [_joint(model, j) for j in range(1, model.njoints)], "shapes": shapes}


def _joint(model: pin.Model, j: int) -> dict[str, Any]:
    S = joint_axis(model, j).reshape(2, 3)
    along = slides(model, j)
    return {
        "name": model.names[j].split("/")[-1],
        "parent": int(model.parents[j]),
        "place": _place(model.jointPlacements[j]),
        "axis": _round(S[0 if along else 1]),
        "slides": along,
    }


def _describe(mj: Any, g: int) -> dict[str, Any] | None:
    kind = int(mj.geom_type[g])
    size = _round(mj.geom_size[g])
    if kind != _MESH:
        return {"kind": kind, "size": size} if _solid(kind, size) else None
    mesh = mj.mesh(mj.geom_dataid[g])
    v = mesh.vertadr[0]
    f = mesh.faceadr[0]
    corners = mj.mesh_vert[v : v + mesh.vertnum[0]]
    faces = mj.mesh_face[f : f + mesh.facenum[0]]
    if max(len(corners), len(faces)) > MOST_CORNERS:
        return {"kind": _BOX, "size": _round(np.abs(corners).max(axis=0))}
    return {"kind": _MESH, "corners": _packed(corners, "<f4"), "faces": _packed(faces, "<i4")}


def _packed(rows: Any, kind: str) -> str:
    return base64.b64encode(zlib.compress(np.array(rows, dtype=kind).tobytes(), 9)).decode()


def _unpacked(text: str, kind: str) -> Any:
    raw = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), 12 * MOST_CORNERS)
    return np.frombuffer(raw, dtype=kind).reshape(-1, 3)


def _round(numbers: Any) -> list[float]:
    return [round(float(x), 7) for x in numbers]


def _place(X: pin.SE3) -> list[float]:
    return _round(pin.SE3ToXYZQUAT(X))


def read_picture(picture: Mapping[str, Any]) -> tuple[pin.Model, pin.GeometryModel]:
    """Kinematics and shapes of a picture that `scene_picture` has made.

    Raises:
        InvalidInputError: it is damaged.
    """
    try:
        return _read(picture)
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError, zlib.error) as error:
        raise InvalidInputError(f"the picture of the scene is damaged: {error!r}") from error


def _read(picture: Mapping[str, Any]) -> tuple[pin.Model, pin.GeometryModel]:
    model = pin.Model()
    geometry = pin.GeometryModel()
    for joint in picture["joints"]:
        turning = pin.JointModelRevoluteUnaligned
        make = pin.JointModelPrismaticUnaligned if joint["slides"] else turning
        axis = np.array(joint["axis"], dtype=float)
        moving = make(axis / norm(axis))
        model.addJoint(int(joint["parent"]), moving, _pose(joint["place"]), str(joint["name"]))
    for i, shape in enumerate(picture["shapes"]):
        joint = int(shape["joint"])
        if not 0 <= joint < model.njoints:
            raise IndexError(f"shape {i} is on joint {joint} of {model.njoints - 1}")
        kind = int(shape["kind"])
        if kind == _MESH:
            made = _mesh_of(_unpacked(shape["corners"], "<f4"), _unpacked(shape["faces"], "<i4"))
        else:
            made = _solid(kind, shape["size"])
        one = pin.GeometryObject(f"shape{i}", joint, _pose(shape["place"]), made)
        one.meshColor = np.array(shape["rgba"], dtype=float)
        one.overrideMaterial = True
        geometry.addGeometryObject(one)
    return (model, geometry)


def _mesh_of(corners: Any, faces: Any) -> coal.BVHModelOBBRSS:
    """A mesh.

    Args:
        corners: (k, 3) m. faces: (m, 3) numbers of corners.
    """
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(corners):
        raise ValueError(f"faces name corners beyond {len(corners)}")
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(corners))
    mesh.addVertices(np.array(corners, dtype=float))
    mesh.addTriangles(np.array(faces, dtype=np.int32))
    mesh.endModel()
    return mesh


def _pose(place: Any) -> pin.SE3:
    X = np.array(place, dtype=float)
    if X.shape != (7,) or not np.isfinite(X).all() or abs(norm(X[3:]) - 1.0) > 1e-3:
        raise ValueError(f"{place} is no pose")
    X[3:] /= norm(X[3:])
    return pin.XYZQUATToSE3(X)
