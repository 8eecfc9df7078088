"""Arms, grasps and object of a closed chain as records of the law, see `law.tables`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.chain_model import GYRATION, ChainModel
from osc_contact.errors import ModelError
from osc_contact.law import records as at
from osc_contact.law.records import Bytes, new_model
from osc_contact.spatial import Array, cross

_UPPER = np.triu_indices(3)
_KINDS = {"rigid": at.RIGID, "hinge": at.HINGE, "ball": at.BALL, "other": at.OTHER}


def chain_row(chain: ChainModel, led: bool) -> Bytes:
    """A row of MODEL of the chain alone: no contacts, no motors.

    Args:
        led: the leading arm, if there is one, determines the object's pose; else it
            is given (`MEMORY`).
    """
    raw = new_model(len(chain.arms), chain.nq, 0)
    pack_chain(chain, raw, chain.leader if led else None)
    return raw


def pack_chain(chain: ChainModel, raw: Bytes, leader: int | None) -> None:
    """Fill in what of a row of MODEL comes from the chain: its head, arms and joints.

    Args:
        chain: to pack. raw: bytes of the row.
        leader: arm that holds the object rigidly; None: no arm does.
    """
    model = at.MODEL.view(raw)
    _pack_object(chain, model, leader)
    _pack_arms(chain, model.arms)
    _pack_joints(chain, model.joints)


def _pack_object(chain: ChainModel, head: Any, leader: int | None) -> None:
    head.held = chain.payload is not None
    head.tolerance = chain.rank_tolerance
    head.slipping = not all(grasp.is_rigid for grasp in chain.grasps)
    head.leader = -1 if leader is None else leader
    head.gravity[:] = chain.model.gravity.linear
    body = chain.reference.inertia
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    head.principal[:] = body.mass, *moments
    head.roots[:] = np.sqrt(head.principal)
    ball = np.repeat((chain.arm_mass, chain.arm_mass * GYRATION**2), 3)
    head.reference[:] = 1.0 + ball / head.principal[[0, 0, 0, 1, 2, 3]]
    head.lightness[:] = 1.0 / head.reference
    X_LO = pin.SE3.Identity()  # without a leader: in the object's own frame
    if leader is not None:
        tip = chain.model.frames[chain.tips[leader]]
        X_LO = _in_joint(chain.model, tip) * chain.grasps[leader].X_TO
    head.X_LO[:] = _flat_pose(X_LO)
    head.X_LP[:] = _flat_pose(X_LO * pin.SE3(axes, body.lever))


def _pack_arms(chain: ChainModel, rows: Any) -> None:
    model = chain.model
    for i, (row, grasp, part) in enumerate(zip(rows, chain.grasps, chain.slices, strict=True)):
        if part.stop - part.start > at.MAX_JOINTS:
            raise ModelError(
                f"arm '{chain.arms[i].name}' has {part.stop - part.start} joints; the control "
                f"law takes {at.MAX_JOINTS} at most. Lock those that need not move (locked=)"
            )
        row.first = part.start
        row.end = part.stop
        row.full_rank = chain.full_ranks[i]
        tip = model.frames[chain.tips[i]]
        sensor = chain.sensors[i]
        row.tip_joint = tip.parentJoint - 1
        row.tip[:] = _flat_pose(_in_joint(model, tip))
        row.sensor_joint = row.outer_joint = -1
        if sensor is not None:
            frame = model.frames[sensor]
            row.sensor_joint = frame.parentJoint - 1
            row.sensor[:] = _flat_pose(_in_joint(model, frame))
        if chain.outboard[i]:
            link = chain.outboard[i][0]
            row.outer_joint = link.joint - 1
            row.outer[:] = _flat_inertia(_z_frame(model, link.joint).actInv(link.inertia))
        row.m = grasp.N.shape[1]
        row.kind = _KINDS[grasp.kind]
        row.filtered = not grasp.is_rigid and len(chain.outboard[i]) > 0
        basis = np.linalg.qr(grasp.T)[0] if grasp.kind == "other" else grasp.T
        row.grasp[:] = np.hstack((grasp.N, basis)).T
        X_OT = grasp.X_TO.inverse()
        axis = grasp.T[3:, 0] if grasp.kind == "hinge" else np.zeros(3)
        row.point[:] = X_OT.translation
        row.tip_axis[:] = axis
        row.axis[:] = X_OT.rotation @ axis
        row.X_TO[:] = _flat_pose(grasp.X_TO)


def _pack_joints(chain: ChainModel, rows: Any) -> None:
    model = chain.model
    firsts = {part.start for part in chain.slices}
    rows.motor[:] = -1
    rows.armature[:] = model.armature
    frames = [_z_frame(model, j + 1) for j in range(len(rows))]
    for j, row in enumerate(rows):
        joint = model.joints[j + 1]
        parent = model.parents[j + 1]
        if joint.idx_v != j or parent != (0 if j in firsts else j):
            raise ModelError(f"joint '{model.names[j + 1]}' does not follow the one before it")
        row.slides = joint.shortname().startswith("JointModelP")
        before = pin.SE3.Identity() if parent == 0 else frames[parent - 1]
        row.placement[:] = _flat_pose(before.actInv(model.jointPlacements[j + 1]) * frames[j])
        row.link[:] = _flat_inertia(frames[j].actInv(model.inertias[j + 1]))


def _z_frame(model: pin.Model, joint: int) -> pin.SE3:
    """The joint's frame rotated so that it turns about, or slides along, its z axis."""
    data = model.joints[joint].createData()
    q = np.zeros(1)
    model.joints[joint].calc(data, q, q)
    S = np.asarray(data.S).reshape(6)
    axis = S[:3] if S[:3].any() else S[3:]
    x, y, z = np.round(axis, 15)
    if (x, y, z) == (0.0, 0.0, 1.0):
        return pin.SE3.Identity()
    start = np.eye(3)[int(np.abs(axis).argmin())]
    first = cross(start, axis)
    first /= np.linalg.norm(first)
    return pin.SE3(np.column_stack((first, cross(axis, first), axis)), np.zeros(3))


def _in_joint(model: pin.Model, frame: pin.Frame) -> pin.SE3:
    """A frame's placement in its joint, whose z axis is the joint's."""
    return _z_frame(model, frame.parentJoint).actInv(frame.placement)


def _flat_pose(X: pin.SE3) -> Array:
    """(12,) rotation by rows, then point."""
    return np.concatenate((X.rotation.ravel(), X.translation))


def _flat_inertia(inertia: pin.Inertia) -> Array:
    """(10,) mass, centre, inertia about it (xx, xy, xz, yy, yz, zz)."""
    return np.array([inertia.mass, *inertia.lever, *inertia.inertia[_UPPER]])
