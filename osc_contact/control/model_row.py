"""A controller's chain, contacts and settings as the records of `law.tables`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.control.friction import Friction
from osc_contact.control.pair_rows import PairRows
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.motors import effort_scale
from osc_contact.dynamics.rail import Body, Cart, Conveyor
from osc_contact.dynamics.singular import GYRATION
from osc_contact.errors import ModelError
from osc_contact.law import tables as at
from osc_contact.law.linkage import scratch_size
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from osc_contact.control.settings import Settings

__all__ = ["Bytes", "ModelRow", "records"]

Bytes = NDArray[np.uint8]
#: Speed of a joint from which on its dry friction counts as fully developed (rad/s, m/s).
TURNING_SLIP, SLIDING_SLIP = 1e-3, 3e-4


def records(raw: Bytes, start: int, count: int, dtype: np.dtype[Any]) -> Any:
    """Records inside bytes, as a view with attributes."""
    return raw[start : start + count * dtype.itemsize].view(dtype).view(np.recarray)


class ModelRow:
    """The bytes of one controller's MODEL row, and how large its MEMORY and WORK are.

    Attributes:
        raw: the bytes. head: its CHAIN record. pairs: the contact pairs as rows.
    """

    def __init__(self, settings: Settings, columns: dict[int, int]) -> None:
        """Pack them; `columns`: numbers of columns of pairs that only Python can evaluate."""
        chain, pairs = settings.chain, PairRows(settings.contacts, columns)
        k, n, c, r = len(chain.arms), chain.nq, len(settings.contacts), pairs.r_all
        self.pairs = pairs
        bars = 1 if k == 2 else k * (k - 1) // 2
        extra = max(1, bars) + 6 * k
        wide = 6 + extra
        offsets, size = at.allocate({
            "head": at.CHAIN_BYTES, "arms": k * at.ARM_BYTES, "joints": n * at.JOINT_BYTES,
            "pairs": c * at.PAIR_BYTES, "shapes": len(pairs.shapes) * at.SHAPE_BYTES,
            "columns": r * at.COLUMN_BYTES, "bodies": c * at.BODY_BYTES,
        })  # fmt: skip
        self.raw: Bytes = np.zeros(size, dtype=np.uint8)
        memory, memory_size = at.allocate({
            "head": at.MEMORY_BYTES, "contact_memory": c * at.CONTACT_MEMORY_BYTES,
            "column_memory": r * at.COLUMN_MEMORY_BYTES, "torque_memory": 8 * chain.n_a,
            "kept": 8 * 3 * n,
        })  # fmt: skip
        work, work_size = at.allocate({
            "head": at.WORK_BYTES, "arm_work": k * at.ARM_WORK_BYTES,
            "joint_work": n * at.JOINT_WORK_BYTES, "column_work": r * at.COLUMN_WORK_BYTES,
            "body_work": c * at.BODY_WORK_BYTES, "locked": 8 * 7 * 6 * k,
            "extra": 8 * (2 * extra * n + wide * wide + wide),
            "link": 8 * (_linkage_size(k, n, bars) if k > 2 else 0),
            "flat": 8 * (5 * r + chain.n_a), "jacobian": 8 * 6 * n,
            "bars": 8 * bars,
        })  # fmt: skip
        self.head = head = records(self.raw, 0, 1, at.CHAIN)[0]
        for name, offset in (offsets | memory | work).items():
            if name != "head":
                setattr(head, f"{name}_at", offset)
        head.row_bytes, head.memory_bytes, head.work_bytes = size, memory_size, work_size
        head.n_arms, head.n_joints, head.n_motors = k, n, chain.n_a
        head.n_pairs = head.n_contacts = c
        head.n_shapes, head.n_columns = len(pairs.shapes), r
        head.n_bars, head.n_extra = bars, extra
        self._pack_chain(chain)
        self._pack_arms(chain)
        self._pack_joints(settings)
        self._pack_contacts(settings)
        self.set_gains(settings)

    def copy(self) -> ModelRow:
        """The same with bytes of its own."""
        other = ModelRow.__new__(ModelRow)
        other.pairs, other.raw = self.pairs, self.raw.copy()
        other.head = records(other.raw, 0, 1, at.CHAIN)[0]
        return other

    def table(self, name: str, count: int, dtype: np.dtype[Any]) -> Any:
        """Rows of one of its tables."""
        return records(self.raw, int(getattr(self.head, f"{name}_at")), count, dtype)

    def set_gains(self, settings: Settings) -> None:
        """What may differ between controllers of one structure."""
        head, gains = self.head, settings.gains
        head.stiffness, head.damping = gains.motion.stiffness, gains.motion.damping
        head.integral, head.period = gains.motion.integral, settings.dt
        head.force_gain, head.force_damping = gains.force.integral, gains.force.damping
        safety = settings.safety
        head.repeats, head.hold_rate = safety.repeats, safety.hold_rate
        head.fault_ticks = safety.stop_after
        head.fast_ticks = round(safety.too_fast_for / settings.dt)
        posture = settings.posture_task
        head.posture_stiffness, head.posture_damping = posture.stiffness, posture.damping
        head.retreat_damping = posture.retreat_damping
        friction = Friction(0.0) if settings.friction is None else settings.friction
        head.mu, head.slip, head.learning = friction.mu, friction.slip, friction.learning
        head.reading = at.LEAST_SQUARES if settings.reading == "least_squares" else at.FILTER
        B = settings.B
        kinds = {"object": at.BY_OBJECT, "chain": at.BY_CHAIN}
        head.metric = kinds[B] if isinstance(B, str) else at.BY_MATRIX
        head.B_inv[:] = np.eye(6) if isinstance(B, str) else np.linalg.inv(B)
        phases = settings.phases
        head.phased = phases is not None
        if phases is not None:
            limits = phases.limits
            head.approach_speed, head.approach_damping = phases.speed, phases.damping
            head.travel, head.rise, head.least_force = phases.travel, phases.rise, phases.least
            head.torque_rate, head.lost_share, head.lag = (
                phases.torque_rate, phases.share, phases.lag
            )  # fmt: skip
            for name in ("force_on", "force_off", "power", "patience", "window", "dwell"):
                setattr(head, name, getattr(limits, name))
            head.leaving = limits.leaving

    def _pack_chain(self, chain: ClosedChain) -> None:
        head = self.head
        head.held, head.tolerance = chain.payload is not None, chain.rank_tolerance
        head.slipping = not all(grasp.is_rigid for grasp in chain.grasps)
        head.leader = -1 if chain.leader is None else chain.leader
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
        if chain.leader is not None:
            tip = chain.model.frames[chain.tips[chain.leader]]
            X_LO = _in_joint(chain.model, tip) * chain.grasps[chain.leader].X_TO
        head.X_LO[:] = _flat_pose(X_LO)
        head.X_LP[:] = _flat_pose(X_LO * pin.SE3(axes, body.lever))

    def _pack_arms(self, chain: ClosedChain) -> None:
        model, rows = chain.model, self.table("arms", len(chain.arms), at.ARM)
        kinds = {"rigid": at.RIGID, "hinge": at.HINGE, "ball": at.BALL, "other": at.OTHER}
        for i, (row, grasp, part) in enumerate(zip(rows, chain.grasps, chain.slices, strict=True)):
            if part.stop - part.start > at.MAX_JOINTS:
                raise ModelError(
                    f"arm '{chain.arms[i].name}' has {part.stop - part.start} joints; the control "
                    f"law takes {at.MAX_JOINTS} at most. Lock those that need not move (locked=)"
                )
            row.first, row.end, row.full_rank = part.start, part.stop, chain.full_ranks[i]
            tip, sensor = model.frames[chain.tips[i]], chain.sensors[i]
            row.tip_joint, row.tip[:] = tip.parentJoint - 1, _flat_pose(_in_joint(model, tip))
            row.sensor_joint = row.outer_joint = -1
            if sensor is not None:
                frame = model.frames[sensor]
                row.sensor_joint = frame.parentJoint - 1
                row.sensor[:] = _flat_pose(_in_joint(model, frame))
            if chain.outboard[i]:
                link = chain.outboard[i][0]
                row.outer_joint = link.joint - 1
                row.outer[:] = _flat_inertia(_z_frame(model, link.joint).actInv(link.inertia))
            row.m, row.kind = grasp.N.shape[1], kinds[grasp.kind]
            row.filtered = not grasp.is_rigid and len(chain.outboard[i]) > 0
            basis = np.linalg.qr(grasp.T)[0] if grasp.kind == "other" else grasp.T
            row.grasp[:] = np.hstack((grasp.N, basis)).T
            X_OT = grasp.X_TO.inverse()
            axis = grasp.T[3:, 0] if grasp.kind == "hinge" else np.zeros(3)
            row.point[:], row.tip_axis[:] = X_OT.translation, axis
            row.axis[:] = X_OT.rotation @ axis
            row.X_TO[:] = _flat_pose(grasp.X_TO)

    def _pack_joints(self, settings: Settings) -> None:
        chain, posture = settings.chain, settings.posture_task
        model, rows = chain.model, self.table("joints", chain.nq, at.JOINT)
        limits = posture.limits(model)
        effort = effort_scale(chain.tau_max)
        rows.motor[:] = -1
        rows.motor[chain.actuated] = np.arange(chain.n_a)
        rows.effort[chain.actuated], rows.tau_max[chain.actuated] = effort**2, chain.tau_max
        rows.ease[chain.actuated] = 1.0 / effort**2
        speed = model.velocityLimit
        rows.speed_max[:] = np.where(np.isfinite(speed) & (speed > 0.0), speed, np.inf)
        rows.speed_max[rows.motor < 0] = np.inf
        rows.posture[:] = settings.posture
        for name in ("low", "high", "width", "most"):
            rows[name][:] = getattr(limits, name)
        rows.armature[:] = model.armature
        rows.viscous[:], rows.dry[:] = model.damping, model.upperDryFrictionLimit
        self.head.rubs = settings.joint_friction and bool(rows.viscous.any() or rows.dry.any())
        firsts = {part.start for part in chain.slices}
        for j, row in enumerate(rows):
            joint = model.joints[j + 1]
            parent = model.parents[j + 1]
            if joint.idx_v != j or parent != (0 if j in firsts else j):
                raise ModelError(f"joint '{model.names[j + 1]}' does not follow the one before it")
            row.slides = joint.shortname().startswith("JointModelP")
            row.slip = SLIDING_SLIP if row.slides else TURNING_SLIP
            before = pin.SE3.Identity() if parent == 0 else _z_frame(model, parent)
            X = before.actInv(model.jointPlacements[j + 1]) * _z_frame(model, j + 1)
            row.placement[:] = _flat_pose(X)
            row.link[:] = _flat_inertia(_z_frame(model, j + 1).actInv(model.inertias[j + 1]))

    def _pack_contacts(self, settings: Settings) -> None:
        from osc_contact.contacts.pairs.pair import pushes_only

        c, pairs = len(settings.contacts), self.pairs
        rows = self.table("pairs", c, at.PAIR)
        for row, values in zip(rows, pairs.table, strict=True):
            row.kind, row.first, row.count, row.shape_at, row.freedoms, row.drags = values
        shapes = self.table("shapes", len(pairs.shapes), at.SHAPE)
        for shape, numbers in zip(shapes, pairs.shapes, strict=True):
            shape.row[:] = numbers
        self.table("columns", pairs.r_all, at.COLUMN).contact[:] = pairs.owners
        bodies = self.table("bodies", c, at.BODY)
        for row, pair, kind in zip(
            bodies, settings.contacts, _body_kinds(settings.bodies), strict=True
        ):
            row.pushes = pushes_only(pair)
            row.kind, row.same, row.parameters[: len(kind[2])] = kind


def _body_kinds(bodies: Sequence[Body | None]) -> list[tuple[int, int, list[float]]]:
    """Kind, first contact on the same body, parameters."""
    out: list[tuple[int, int, list[float]]] = []
    numbers: dict[Any, int] = {}
    for c, body in enumerate(bodies):
        if body is None:
            out.append((at.UNYIELDING, c, []))
            continue
        same = numbers.setdefault(body, c)
        if type(body) is Conveyor:
            out.append((at.CONVEYOR, same, []))
        elif type(body) is Cart:
            u = body.direction
            weight = float(u @ np.array(body.gravity))
            numbers_of = [*u, body.mass, body.stiffness, body.damping, body.preload, weight]
            out.append((at.CART, same, [float(x) for x in numbers_of]))
        else:
            out.append((at.ELSEWHERE, same, []))
    return out


def _linkage_size(k: int, n: int, bars: int) -> int:
    """Numbers that `law.allocation` cuts out for three arms and more."""
    own = 3 * k + 2 * k + 3 * n + 6 * n + n + 18 * k + 6 * k + bars * n + bars * bars
    return own + scratch_size(k, n)


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
    first = np.cross(start, axis)
    first /= np.linalg.norm(first)
    return pin.SE3(np.column_stack((first, np.cross(axis, first), axis)), np.zeros(3))


def _in_joint(model: pin.Model, frame: pin.Frame) -> pin.SE3:
    """A frame's placement in its joint, whose z axis is the joint's."""
    return _z_frame(model, frame.parentJoint).actInv(frame.placement)


def _flat_pose(X: pin.SE3) -> Array:
    """(12,) rotation by rows, then point."""
    return np.concatenate((X.rotation.ravel(), X.translation))


def _flat_inertia(inertia: pin.Inertia) -> Array:
    """(10,) mass, centre, inertia about it (xx, xy, xz, yy, yz, zz)."""
    return np.array([inertia.mass, *inertia.lever, *inertia.inertia[np.triu_indices(3)]])
