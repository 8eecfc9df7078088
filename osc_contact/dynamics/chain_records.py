"""Arms, grasps and object of a closed chain as records of the law, see `law.records`."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pinocchio as pin
from pinocchio import SE3

from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.chain_state import RigidObject
from osc_contact.dynamics.grasp import Grasp
from osc_contact.dynamics.merged_model import OutboardLink
from osc_contact.errors import ModelError
from osc_contact.law import records as at
from osc_contact.law.nested import Table
from osc_contact.law.records import Bytes, new_model
from osc_contact.robots.model import joint_axis, slides
from osc_contact.spatial import Array, cross, norm

GYRATION = 0.1  #: radius of gyration of the ball that represents the heaviest arm (m)
_KINDS = {"rigid": at.RIGID, "hinge": at.HINGE, "ball": at.BALL, "other": at.OTHER}


class ChainStructure(Protocol):
    """Structure of a closed chain, of which its records are made; see `ClosedChain`."""

    model: pin.Model
    arms: tuple[Arm, ...]
    grasps: tuple[Grasp, ...]
    slices: tuple[slice, ...]
    leader: int | None
    payload: RigidObject | None
    reference: RigidObject
    arm_mass: float
    tips: list[int]
    sensors: list[int | None]
    outboard: list[list[OutboardLink]]
    full_ranks: tuple[int, ...]
    rank_tolerance: float
    angle_tolerance: float

    @property
    def nq(self) -> int:
        """Number of joints of all arms."""


def chain_row(chain: ChainStructure, from_leader: bool) -> Bytes:
    """Make a row of MODEL for the chain, without contacts and motors.

    Args:
        chain: the arms.
        from_leader: True: the leader, if there is one, determines the object's pose; False: the
            pose is given in MEMORY.
    """
    raw = new_model(len(chain.arms), chain.nq, 0)
    pack_chain(chain, raw, chain.leader if from_leader else None)
    return raw


def pack_chain(chain: ChainStructure, raw: Bytes, leader: int | None) -> None:
    """Write the head, the arms and the joints of a row of MODEL, the bytes of a controller's model.

    Args:
        chain: the arms.
        raw: bytes of the row.
        leader: index of an arm that holds the object rigidly; None: no arm determines its pose.
    """
    head = at.MODEL.view(raw)
    _pack_arms(chain, head.arms)
    _pack_joints(chain, head.joints)
    head.held = chain.payload is not None
    head.rank_tolerance = chain.rank_tolerance
    head.angle_tolerance = chain.angle_tolerance
    head.slipping = not all(grasp.is_rigid for grasp in chain.grasps)
    head.leader = -1 if leader is None else leader
    head.gravity[:] = chain.model.gravity.linear
    body = chain.reference.inertia
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))  # right-handed principal axes
    head.principal[:] = (body.mass, *moments)
    head.roots[:] = np.sqrt(head.principal)
    # Λ_ref in energy coordinates: object plus a ball with the mass of the heaviest arm
    ball = np.repeat((chain.arm_mass, chain.arm_mass * GYRATION**2), 3)
    head.reference[:] = 1.0 + ball / head.principal[[0, 0, 0, 1, 2, 3]]
    head.lightness[:] = 1.0 / head.reference
    X_LO = SE3.Identity()  # without a leader: in the object's own frame
    if leader is not None:
        X_LO = _in_joint(chain.model, chain.tips[leader]) * chain.grasps[leader].X_TO
    head.X_LO[:] = _flat_pose(X_LO)
    head.X_LP[:] = _flat_pose(X_LO * SE3(axes, body.lever))


def _pack_arms(chain: ChainStructure, rows: Table) -> None:
    """Write the arms' rows of MODEL: joints, tips, sensors, outboard links and grasps.

    Args:
        chain: the arms.
        rows: table `arms` of MODEL, filled.

    Raises:
        ModelError: an arm has more joints than the law supports.
    """
    model = chain.model
    for i, (row, grasp, joints) in enumerate(zip(rows, chain.grasps, chain.slices, strict=True)):
        count = joints.stop - joints.start
        if count > at.MAX_JOINTS:
            raise ModelError(
                f"arm '{chain.arms[i].name}' has {count} joints; the control "
                f"law takes {at.MAX_JOINTS} at most. Lock those that need not move (locked=)"
            )
        row.first = joints.start
        row.end = joints.stop
        row.full_rank = chain.full_ranks[i]
        # poses in the z frames of joints; −1: there is no sensor, or nothing beyond it
        tip = chain.tips[i]
        sensor = chain.sensors[i]
        row.tip_joint = model.frames[tip].parentJoint - 1
        row.tip[:] = _flat_pose(_in_joint(model, tip))
        row.sensor_joint = row.outer_joint = -1
        if sensor is not None:
            row.sensor_joint = model.frames[sensor].parentJoint - 1
            row.sensor[:] = _flat_pose(_in_joint(model, sensor))
        if chain.outboard[i]:
            link = chain.outboard[i][0]
            row.outer_joint = link.joint - 1
            row.outer[:] = _flat_inertia(_z_frame(model, link.joint).actInv(link.inertia))
        # the grasp: N, then a basis of the permitted motions, point and axis in tip and object
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


def _pack_joints(chain: ChainStructure, rows: Table) -> None:
    """Write the joints' rows of MODEL: placements, link inertias and rotors, all without motors.

    Args:
        chain: the arms.
        rows: table `joints` of MODEL, filled.

    Raises:
        ModelError: the joints of an arm are not serial.
    """
    model = chain.model
    firsts = {part.start for part in chain.slices}
    rows.motor[:] = -1
    rows.armature[:] = model.armature
    # frame of the world, then z frames of the joints; Pinocchio's joint 0 is the universe
    frames = [SE3.Identity(), *(_z_frame(model, j + 1) for j in range(len(rows)))]
    for j, row in enumerate(rows):
        joint = model.joints[j + 1]
        parent = model.parents[j + 1]
        if joint.idx_v != j or parent != (0 if j in firsts else j):
            raise ModelError(f"joint '{model.names[j + 1]}' does not follow the one before it")
        row.slides = slides(model, j + 1)
        frame = frames[j + 1]
        before = frames[parent]
        row.placement[:] = _flat_pose(before.actInv(model.jointPlacements[j + 1]) * frame)
        row.link[:] = _flat_inertia(frame.actInv(model.inertias[j + 1]))


def _z_frame(model: pin.Model, joint: int) -> SE3:
    """Pose, in a joint's own frame, of a frame whose z axis is the joint's axis.

    Args:
        model: merged model.
        joint: number of the joint, from 1.
    """
    S = joint_axis(model, joint)
    axis = S[:3] if S[:3].any() else S[3:]
    if tuple(np.round(axis, 15)) == (0.0, 0.0, 1.0):
        return SE3.Identity()
    # any two axes across the joint's complete the frame; the start is the coordinate axis that is
    # farthest from the joint's, so that their product is far from zero
    start = np.eye(3)[np.abs(axis).argmin()]
    first = cross(start, axis)
    first /= norm(first)
    return SE3(np.column_stack((first, cross(axis, first), axis)), np.zeros(3))


def _in_joint(model: pin.Model, number: int) -> SE3:
    """Pose of a frame, given by its number, in the z frame of its joint, see `_z_frame`."""
    frame = model.frames[number]
    return _z_frame(model, frame.parentJoint).actInv(frame.placement)


def _flat_pose(X: SE3) -> Array:
    """Numbers (12,) of a pose: rotation matrix by rows, then position (m)."""
    return np.concatenate((X.rotation.ravel(), X.translation))


def _flat_inertia(inertia: pin.Inertia) -> Array:
    """Numbers (13,) of an inertia: mass (kg), centre of mass (m), moments about it (kg m²)."""
    return np.array([inertia.mass, *inertia.lever, *inertia.inertia.ravel()])
