"""What else is taken from a compiled MJCF model: its arm without shapes, and its shapes.

`mjcf` makes the Pinocchio model of the same file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.robots.mjcf import compile_mjcf, load_mjcf, place, trees_of
from osc_contact.robots.model import random_configurations
from osc_contact.spatial import Array

__all__ = [
    "mesh_of", "mesh_rows", "mjcf_geometry", "mjcf_shape", "mjcf_skeleton", "placement_difference",
]  # fmt: skip

_MESH = 7  #: MuJoCo's number of the type
_POSTURES = 6  #: at which placements are compared


def mjcf_skeleton(
    mujoco: Any, path: Path, tip: str, sensor: str | None, locked: Mapping[str, float]
) -> Any:
    """A `MjSpec` of the tip's kinematic tree: bodies, inertias and joints, nothing else.

    Joints carry neither losses nor springs; those in `locked` are welded where they are held. A
    tip that is a site becomes a body without mass; a sensor's site is called `wrist`, as is one in
    the body of that name.

    Args:
        mujoco: the module.
        path: the MJCF file.
        tip: body or site at the arm's end.
        sensor: site of the wrist sensor, if there is one.
        locked: positions (m, rad) of the joints that are held.

    Raises:
        ModelError: a locked joint moves its body after one that is not locked.
    """
    mj = compile_mjcf(path)
    spec = mujoco.MjSpec()
    spec.compiler.degree = spec.compiler.fusestatic = False
    made: dict[int, Any] = {0: spec.worldbody}
    sites = {mj.site(s).name: s for s in range(mj.nsite)}
    for b in range(1, mj.nbody):
        if int(mj.body_rootid[b]) not in trees_of(mj, tip):
            continue
        X, joints = _held(mj, b, locked)
        body = made[int(mj.body_parentid[b])].add_body(
            name=mj.body(b).name or f"body{b}", pos=X.translation, quat=_quaternion(X)
        )
        body.explicitinertial, body.mass = True, float(mj.body_mass[b])
        body.ipos, body.iquat, body.inertia = mj.body_ipos[b], mj.body_iquat[b], mj.body_inertia[b]
        for j in joints:
            body.add_joint(
                name=mj.joint(j).name or f"joint{j}",
                type=mujoco.mjtJoint(int(mj.jnt_type[j])),
                pos=mj.jnt_pos[j],
                axis=mj.jnt_axis[j],
                ref=float(mj.qpos0[int(mj.jnt_qposadr[j])]),
                range=mj.jnt_range[j],
                limited=int(bool(mj.jnt_limited[j])),
            )
        made[b] = body
    if tip in sites and tip not in [mj.body(b).name for b in made]:
        s = sites[tip]
        made[int(mj.site_bodyid[s])].add_body(name=tip, pos=mj.site_pos[s], quat=mj.site_quat[s])
    if sensor is not None:
        if sensor in [mj.body(b).name for b in made]:
            spec.body(sensor).add_site(name="wrist")
        else:
            at = mj.site(sensor)
            made[int(mj.site_bodyid[at.id])].add_site(name="wrist", pos=at.pos, quat=at.quat)
    return spec


def _held(mj: Any, b: int, locked: Mapping[str, float]) -> tuple[pin.SE3, list[int]]:
    """Where a body stands in its parent, locked joints held, and its other joints."""
    X, free = place(mj.body_pos[b], mj.body_quat[b]), []
    first = int(mj.body_jntadr[b])
    for j in range(first, first + int(mj.body_jntnum[b])):
        name = mj.joint(j).name or f"joint{j}"
        if name not in locked:
            free.append(j)
            continue
        if free:
            raise ModelError(
                f"joint {name!r} is locked, and moves its body after {mj.joint(free[-1]).name!r}, "
                "which is not: give each a body of its own"
            )
        by = locked[name] - float(mj.qpos0[int(mj.jnt_qposadr[j])])
        axis, anchor = np.array(mj.jnt_axis[j]), pin.SE3(np.eye(3), np.array(mj.jnt_pos[j]))
        slides = int(mj.jnt_type[j]) == 2
        turn = np.eye(3) if slides else pin.exp3(by * axis)
        shift = by * axis if slides else np.zeros(3)
        X = X * anchor * pin.SE3(turn, shift) * anchor.inverse()
    return X, free


def _quaternion(X: pin.SE3) -> list[float]:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return [w, x, y, z]


def mjcf_geometry(path: Path | str, tip: str | None) -> tuple[pin.Model, pin.GeometryModel]:
    """(kinematics, shapes to draw) of the tip's tree: what touches nothing, or else everything.

    Planes, height fields, ellipsoids and signed distance fields are left out.
    """
    mj = compile_mjcf(path)
    model = load_mjcf(mj, tip)
    geometry = pin.GeometryModel()
    seen = [
        g for g in range(mj.ngeom) if int(mj.body_rootid[mj.geom_bodyid[g]]) in trees_of(mj, tip)
    ]
    visual = [g for g in seen if not (mj.geom_contype[g] or mj.geom_conaffinity[g])]
    for g in visual or seen:
        shape = _shape(mj, g)
        if shape is None:
            continue
        b = int(mj.geom_bodyid[g])
        frame = model.frames[model.getFrameId(mj.body(b).name or f"body{b}", pin.FrameType.BODY)]
        X = frame.placement * place(mj.geom_pos[g], mj.geom_quat[g])
        one = pin.GeometryObject(f"geom{g}", frame.parentJoint, X, shape)
        material = int(mj.geom_matid[g])
        one.meshColor = np.array(mj.mat_rgba[material] if material >= 0 else mj.geom_rgba[g], float)
        one.overrideMaterial = True
        geometry.addGeometryObject(one)
    return model, geometry


def _shape(mj: Any, g: int) -> Any:
    """The coal shape of a geom, None if it has none."""
    if int(mj.geom_type[g]) != _MESH:
        return mjcf_shape(int(mj.geom_type[g]), np.array(mj.geom_size[g], dtype=float))
    return mesh_of(*mesh_rows(mj, g))


def mesh_rows(mj: Any, g: int) -> tuple[Any, Any]:
    """Corners (k, 3) in m and faces (m, 3) of the mesh of a geom."""
    m = int(mj.geom_dataid[g])
    v, f = int(mj.mesh_vertadr[m]), int(mj.mesh_faceadr[m])
    corners = mj.mesh_vert[v : v + int(mj.mesh_vertnum[m])]
    return corners, mj.mesh_face[f : f + int(mj.mesh_facenum[m])]


def mjcf_shape(kind: int, size: Array) -> Any:
    """The coal shape of a type of geom other than a mesh, None if it has none.

    Args:
        kind: MuJoCo's number of it. size: (3,) as MuJoCo means it.
    """
    if kind == 2:
        return coal.Sphere(size[0])
    if kind == 3:
        return coal.Capsule(size[0], 2.0 * size[1])
    if kind == 5:
        return coal.Cylinder(size[0], 2.0 * size[1])
    if kind == 6:
        return coal.Box(*(2.0 * size))
    return None


def mesh_of(corners: Any, faces: Any) -> coal.BVHModelOBBRSS:
    """A mesh.

    Args:
        corners: (k, 3) m. faces: (m, 3) numbers of corners.
    """
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(corners):
        raise ValueError(f"faces name corners beyond {len(corners)}")
    mesh, triangles, points = coal.BVHModelOBBRSS(), coal.StdVec_Triangle(), coal.StdVec_Vec3s()
    points.extend([np.array(corner, dtype=float) for corner in corners])
    triangles.extend([coal.Triangle(*(int(k) for k in face)) for face in faces])
    mesh.beginModel(len(faces), len(corners))
    mesh.addSubModel(points, triangles)
    mesh.endModel()
    return mesh


def placement_difference(mj: Any, model: pin.Model) -> float:
    """Largest difference of all body placements between Pinocchio and MuJoCo (m or without unit).

    At seeded random postures between the limits.
    """
    import mujoco

    data, sim, worst = model.createData(), mujoco.MjData(mj), 0.0
    joints = {mj.joint(j).name or f"joint{j}": j for j in range(mj.njnt)}
    for q in random_configurations(model, _POSTURES):
        for name, x in zip(list(model.names)[1:], q, strict=True):
            sim.qpos[int(mj.jnt_qposadr[joints[name]])] = x
        mujoco.mj_kinematics(mj, sim)
        pin.framesForwardKinematics(model, data, q)
        for b in range(1, mj.nbody):
            name = mj.body(b).name or f"body{b}"
            if not model.existBodyName(name):
                continue
            X: Array = data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous
            R = np.array(sim.xmat[b]).reshape(3, 3)
            away = max(np.abs(X[:3, :3] - R).max(), np.abs(X[:3, 3] - sim.xpos[b]).max())
            worst = max(worst, float(away))
    return worst
