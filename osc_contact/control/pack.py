"""A controller's model as the arrays that `kernels.layout` names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from osc_contact.control.allocation import Allocation, effort_scale
from osc_contact.control.pack_pairs import PackedPairs
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.rail import Cart, Conveyor
from osc_contact.dynamics.singular import FULL, GYRATION
from osc_contact.errors import ModelError
from osc_contact.kernels import layout as at
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from osc_contact.control.controller import Controller

__all__ = ["Arrays", "pack"]

Arrays = dict[int, Array]


def pack(
    controller: Controller, data: pin.Data, columns: Mapping[int, int] | None = None
) -> tuple[Arrays, PackedPairs]:
    """The bound arrays, those of `data` among them as live views, and the contact pairs.

    `columns`: how many columns of N the pairs have that only Python code can evaluate, by number.
    """
    pairs = PackedPairs(controller.contacts, columns or {})
    arrays = {
        at.SIZES: _sizes(controller, pairs),
        at.HEAD: _head(controller),
        **_chain(controller.chain, controller.allocation),
        **_grasps(controller.chain),
        **_contacts(controller, pairs),
        **_live(data),
        **_scratch(controller.chain, pairs.r_all),
    }
    arrays[at.METRIC] = np.eye(6)
    if not isinstance(controller.B, str):
        arrays[at.METRIC][:] = np.linalg.inv(controller.B)
    return arrays, pairs


def _sizes(controller: Controller, pairs: PackedPairs) -> Array:
    chain, B = controller.chain, controller.B
    sizes = np.zeros((1, 16), dtype=np.int64)
    sizes[0, at.N_JOINTS], sizes[0, at.N_ARMS] = chain.nq, len(chain.arms)
    sizes[0, at.N_COLUMNS] = pairs.r_all
    sizes[0, at.N_PAIRS] = sizes[0, at.N_CONTACTS] = len(controller.contacts)
    sizes[0, at.HELD] = chain.payload is not None
    kinds = {"object": at.BY_OBJECT, "chain": at.BY_CHAIN}
    sizes[0, at.METRIC_KIND] = kinds[B] if isinstance(B, str) else at.BY_MATRIX
    sizes[0, at.SLIPPING] = not all(grasp.is_rigid for grasp in chain.grasps)
    sizes[0, at.LEADER] = -1 if chain.leader is None else chain.leader
    return sizes


def _head(controller: Controller) -> Array:
    chain, motion = controller.chain, controller.motion_law
    head = np.zeros(at.HEAD_SIZE)
    head[at.GRAVITY : at.GRAVITY + 3] = chain.model.gravity.linear
    body = chain.reference.inertia
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    head[at.PRINCIPAL : at.PRINCIPAL + 4] = body.mass, *moments
    head[at.ROOTS : at.ROOTS + 4] = np.sqrt(head[at.PRINCIPAL : at.PRINCIPAL + 4])
    X_JO = pin.SE3.Identity()  # without a leader: in the object's own frame
    if chain.leader is not None:
        lead = chain.leader
        X_JO = chain.model.frames[chain.tips[lead]].placement * chain.grasps[lead].X_TO
    for start, X in ((at.X_JO, X_JO), (at.X_JP, X_JO * pin.SE3(axes, body.lever))):
        head[start : start + 12] = *X.rotation.ravel(), *X.translation
    head[at.TOLERANCE] = chain.rank_tolerance
    head[at.STIFFNESS], head[at.DAMPING] = motion.gains.stiffness, motion.gains.damping
    head[at.INTEGRAL], head[at.PERIOD] = motion.gains.integral, motion.dt
    head[at.POSTURE_STIFFNESS] = controller.allocation.stiffness
    head[at.GYRATION], head[at.FADING] = GYRATION**2, 1.0 / FULL**4
    head[at.POSTURE_DAMPING] = controller.allocation.damping
    if controller.friction is not None:
        head[at.FRICTION], head[at.SLIP] = controller.friction.mu, controller.friction.slip
    return head


def _chain(chain: ClosedChain, allocation: Allocation) -> Arrays:
    model, n, k = chain.model, chain.nq, len(chain.arms)
    arms_i, joints_i = np.zeros((k, 4), dtype=np.int64), np.zeros((n, 2), dtype=np.int64)
    arms, joints = np.zeros((k, 17)), np.zeros((n, 27))
    effort = effort_scale(chain.tau_max)
    joints_i[:, 1] = -1
    joints_i[chain.actuated, 1] = np.arange(chain.n_a)
    joints[chain.actuated, 20], joints[chain.actuated, 21] = effort**2, 1.0 / effort**2
    limits = allocation.limits
    joints[:, 22] = allocation.posture
    joints[:, 23:27] = np.stack((limits.low, limits.high, limits.width, limits.most), axis=1)
    joints[:, :10] = [_flat(model.inertias[j + 1]) for j in range(n)]
    for i, (tip, sensor, s) in enumerate(zip(chain.tips, chain.sensors, chain.slices, strict=True)):
        at_tip = model.frames[tip]
        arms_i[i] = s.start, s.stop, at_tip.parentJoint, -1
        arms[i, :3], arms[i, 15] = at_tip.placement.translation, chain.arm_mass
        arms[i, 16] = chain.full_ranks[i]
        if sensor is not None:
            at_wrist = model.frames[sensor]
            X = at_wrist.placement
            arms_i[i, 3] = at_wrist.parentJoint
            arms[i, 3:15] = *X.rotation.ravel(), *X.translation
        for link in chain.outboard[i]:
            j = link.joint - 1
            joints[j, 10:20] = _flat(link.inertia)
            joints_i[j, 0] = 1 if np.array_equal(joints[j, 10:20], joints[j, :10]) else 2
    return {at.ARMS_I: arms_i, at.JOINTS_I: joints_i, at.ARMS: arms, at.JOINTS: joints}


def _grasps(chain: ClosedChain) -> Arrays:
    k = len(chain.arms)
    kinds, tables = np.zeros((k, 4), dtype=np.int64), np.zeros((k, 64))
    numbers = {"rigid": at.RIGID, "hinge": at.HINGE, "ball": at.BALL}
    for i, grasp in enumerate(chain.grasps):
        kinds[i, 0], kinds[i, 1] = grasp.N.shape[1], numbers[grasp.kind]
        kinds[i, 2] = not grasp.is_rigid and len(chain.outboard[i]) > 0
        placement, X_OT = chain.model.frames[chain.tips[i]].placement, grasp.X_TO.inverse()
        axis = grasp.T[3:, 0] if grasp.kind == "hinge" else np.zeros(3)
        tables[i, :12] = *placement.rotation.ravel(), *placement.translation
        tables[i, 12:48] = np.hstack((grasp.N, grasp.T)).T.ravel()
        tables[i, 48:57] = *X_OT.translation, *(X_OT.rotation @ axis), *axis
    return {at.GRASPS_I: kinds, at.GRASPS: tables}


def _contacts(controller: Controller, pairs: PackedPairs) -> Arrays:
    count = len(controller.contacts)
    kinds, bodies = np.zeros((count + 1, 2), dtype=np.int64), np.zeros((count + 1, 48))
    numbers: dict[Any, int] = {}
    for c, body in enumerate(controller.bodies):
        kinds[c] = at.ELSEWHERE, c
        if body is None:
            kinds[c, 0] = at.UNYIELDING
            continue
        kinds[c, 1] = numbers.setdefault(body, c)
        if type(body) is Conveyor:
            kinds[c, 0] = at.CONVEYOR
        elif type(body) is Cart:
            kinds[c, 0] = at.CART
            u = body.direction
            weight = float(u @ np.array(body.gravity))
            bodies[c, :8] = *u, body.mass, body.stiffness, body.damping, body.preload, weight
    touched = np.zeros((count + 1, 28))
    touched[:, :16] = np.eye(4).ravel()
    return {
        at.PAIRS_I: pairs.table, at.SHAPES: pairs.shapes, at.COLUMNS_I: pairs.owners,
        at.BODIES_I: kinds, at.BODIES: bodies, at.TOUCHED: touched,
        at.TOUCHED_BEFORE: touched.copy(), at.TERMS: np.zeros((count + 1, 4)),
        at.TERMS_BEFORE: np.zeros((count + 1, 4)),
    }  # fmt: skip


def _live(data: pin.Data) -> Arrays:
    """Pinocchio's own memory: joint inertia, Jacobian, placements (rotation by columns, point)."""
    first = data.oMi[0].rotation.T
    start = first.__array_interface__["data"][0]
    for j, placement in enumerate(data.oMi):
        here = [
            part.__array_interface__["data"][0] - start - 96 * j
            for part in (placement.rotation, placement.translation)
        ]
        if here != [0, 72]:
            raise ModelError(
                f"Pinocchio {pin.__version__} stores joint placements in a way the compiled tick "
                "does not know; use Controller(..., compiled=False)"
            )
    poses = np.lib.stride_tricks.as_strided(first.reshape(9), (len(data.oMi), 12), (96, 8))
    return {at.M: data.M, at.J: data.J.T, at.POSE: poses}


def _scratch(chain: ClosedChain, r_all: int) -> Arrays:
    n, k, columns = chain.nq, len(chain.arms), r_all + 6
    inputs = 2 * n + 6 * k + 31 + r_all + at.STATE_SIZE
    shapes: dict[int, tuple[int, ...]] = {
        at.STATE: (at.STATE_SIZE,), at.SIGNALS: (at.SIGNALS_SIZE,), at.TAU: (chain.n_a,),
        at.COLUMNS: (9, columns), at.N_O: (columns, 6), at.JOINT_ROWS: (5, n, 6),
        at.SQUARES: (14, 6, 6), at.ARM_SQUARES: (k, 6, 6), at.ROWS: (at.N_ROWS, 8),
        at.LOCKED: (6 * k + 1, 7), at.LINKS: (n + 1, 10), at.TRIANGLE: (10, 10),
        at.HOUSEHOLDER: (10, 20), at.Q_FACTOR: (10, 10), at.CONTACT_ROWS: (8, columns, 6),
        at.SHARE: (6, columns), at.AXES: (4, 3, 3), at.JOINT_VECTORS: (4, n),
        at.TIPS: (k, 4, 3), at.PASSED: (k, 6, 6), at.FILTERS: (k, 6, 6),
        at.ANSWERS: (r_all + 1, 48), at.INPUTS: (inputs,), at.STACK_Q: (10, 10), at.WIDE: (16,),
    }  # fmt: skip
    arrays = {row: np.zeros(shape) for row, shape in shapes.items()}
    arrays[at.SIGNALS][at.X_WO + 15] = 1.0
    return {
        at.KEEP: np.zeros((columns, 2), dtype=np.int64),
        at.TAU_MAX: chain.tau_max.copy(),
        **arrays,
    }


def _flat(inertia: pin.Inertia) -> Array:
    """(10,) mass, centre, inertia at the centre (xx, xy, xz, yy, yz, zz)."""
    return np.array([inertia.mass, *inertia.lever, *inertia.inertia[np.triu_indices(3)]])
