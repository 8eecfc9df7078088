"""An arm and what stands about it as data: what a recording carries so that it can be drawn.

Joints, shapes and colours, and neither names of files nor anything that is executed.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError
from osc_contact.robots.mjcf_parts import mesh_of, mesh_rows, mjcf_shape
from osc_contact.spatial import Array

__all__ = ["read_picture", "scene_picture"]

MOST_CORNERS = 200_000  #: of one mesh; of a larger one its box is drawn
_MESH, _BOX = 7, 6  #: MuJoCo's numbers of these types


def scene_picture(
    mj: Any, data: Any, model: pin.Model, q: Array, joints: Mapping[int, int]
) -> dict[str, Any]:
    """What is seen of a MuJoCo scene, as JSON data.

    Of each body of the arm what touches nothing, or else everything; of the rest everything.
    Planes, height fields, ellipsoids and what is transparent are left out; loose bodies stay where
    they are now.

    Args:
        mj, data: MuJoCo's; the placements of `data` are those at q.
        model: of the arm, base included. q: (n,) its joint positions.
        joints: MuJoCo's joint → number of the joint in `model`.
    """
    at = model.createData()
    pin.forwardKinematics(model, at, q)
    moves = {int(mj.jnt_bodyid[j]): joint for j, joint in joints.items()}
    owner = [0] * mj.nbody
    for b in range(1, mj.nbody):
        owner[b] = moves.get(b, owner[int(mj.body_parentid[b])])
    of = [owner[int(b)] for b in mj.geom_bodyid]
    plain = [not (mj.geom_contype[g] or mj.geom_conaffinity[g]) for g in range(mj.ngeom)]
    dressed = {int(b) for b, only_seen in zip(mj.geom_bodyid, plain, strict=True) if only_seen}
    shapes = []
    for g, joint in enumerate(of):
        material = int(mj.geom_matid[g])
        rgba = np.array(mj.mat_rgba[material] if material >= 0 else mj.geom_rgba[g], dtype=float)
        hidden = joint and int(mj.geom_bodyid[g]) in dressed and not plain[g]
        shape = None if hidden or not rgba[3] else _describe(mj, g)
        if shape is not None:
            X = pin.SE3(np.array(data.geom_xmat[g]).reshape(3, 3), np.array(data.geom_xpos[g]))
            shapes.append(
                {"joint": joint, "place": _place(at.oMi[joint].actInv(X)), "rgba": _round(rgba)}
                | shape
            )
    return {"joints": [_joint(model, j) for j in range(1, model.njoints)], "shapes": shapes}


def _joint(model: pin.Model, j: int) -> dict[str, Any]:
    joint = model.joints[j]
    state = joint.createData()
    joint.calc(state, pin.neutral(model)[joint.idx_q : joint.idx_q + 1])
    S = np.asarray(state.S).ravel()
    slides = bool(np.abs(S[:3]).max() > 0.5)
    return {
        "name": model.names[j].split("/")[-1],
        "parent": int(model.parents[j]),
        "place": _place(model.jointPlacements[j]),
        "axis": _round(S[:3] if slides else S[3:]),
        "slides": slides,
    }


def _describe(mj: Any, g: int) -> dict[str, Any] | None:
    kind, size = int(mj.geom_type[g]), _round(mj.geom_size[g])
    if kind != _MESH:
        return {"kind": kind, "size": size} if mjcf_shape(kind, np.array(size)) else None
    corners, faces = mesh_rows(mj, g)
    if max(len(corners), len(faces)) > MOST_CORNERS:
        return {"kind": _BOX, "size": _round(np.abs(corners).max(axis=0))}
    return {"kind": _MESH, "corners": _packed(corners, "<f4"), "faces": _packed(faces, "<i4")}


def _packed(rows: Any, kind: str) -> str:
    return base64.b64encode(zlib.compress(np.array(rows, dtype=kind).tobytes(), 9)).decode()


def _unpacked(text: str, kind: str) -> Any:
    most = 12 * MOST_CORNERS
    raw = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), most)
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
    model, geometry = pin.Model(), pin.GeometryModel()
    for joint in picture["joints"]:
        kind = pin.JointModelPrismaticUnaligned if joint["slides"] else (
            pin.JointModelRevoluteUnaligned
        )  # fmt: skip
        axis = np.array(joint["axis"], dtype=float)
        model.addJoint(
            int(joint["parent"]), kind(axis / np.linalg.norm(axis)), _pose(joint["place"]),
            str(joint["name"]),
        )  # fmt: skip
    for i, shape in enumerate(picture["shapes"]):
        if not 0 <= int(shape["joint"]) < model.njoints:
            raise IndexError(f"shape {i} is on joint {shape['joint']} of {model.njoints - 1}")
        kind = int(shape["kind"])
        if kind == _MESH:
            made = mesh_of(_unpacked(shape["corners"], "<f4"), _unpacked(shape["faces"], "<i4"))
        else:
            made = mjcf_shape(kind, np.array(shape["size"], dtype=float))
        one = pin.GeometryObject(f"shape{i}", int(shape["joint"]), _pose(shape["place"]), made)
        one.meshColor, one.overrideMaterial = np.array(shape["rgba"], dtype=float), True
        geometry.addGeometryObject(one)
    return model, geometry


def _pose(place: Any) -> pin.SE3:
    X = np.array(place, dtype=float)
    if X.shape != (7,) or not np.isfinite(X).all() or abs(np.linalg.norm(X[3:]) - 1.0) > 1e-3:
        raise ValueError(f"{place} is no pose")
    X[3:] /= np.linalg.norm(X[3:])
    return pin.XYZQUATToSE3(X)
