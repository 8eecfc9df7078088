"""Closed chain of arms that hold one object (section 6), and its equation of motion, eq. 13.

The object can make only the motions S that every arm permits (dual SCARA: five). For these

    Λ_S η̇ + μ_S + p_S + Sᵀf_c = G τ,        a = S η̇ + σ,        q̈ = W η̇ + w,

and Φ₀ = S Λ_S⁻¹ Sᵀ, a 6×6 matrix of rank d without damping, replaces Λ₀⁻¹.
Grasps may permit motions (`Grasp`), which have no mass and no motor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from pinocchio import SE3

from osc_contact import robots
from osc_contact.dynamics.arm import (
    Arm,
    effort_limits,
    heaviest_rotor,
)
from osc_contact.dynamics.chain_state import (
    ArmTerms,
    ChainState,
    ObjectTerms,
    RigidObject,
    SingularDirection,
)
from osc_contact.dynamics.grasp import Grasp, locate
from osc_contact.dynamics.merged_model import merge, outboard_links
from osc_contact.errors import ModelError, as_tuple, require_kind
from osc_contact.law import records as at
from osc_contact.law.chain import OBJECT_UNKNOWN
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.reasons import NO_REASON, SENTENCES
from osc_contact.law.records import Bytes, Rows, new_model, views
from osc_contact.law.vectors import motions, reflection, wrenches
from osc_contact.robots.model import joint_axis, joint_names, slides
from osc_contact.spatial import Array, as_array, carry_twist, columns_of, cross, norm


def columns_at(J_world: Array, O: Array) -> Array:  # noqa: E741 - the operational point
    """Jacobian columns (6, n) at O (3,), from those at the world's origin."""
    return carry_twist(columns_of(J_world), np.zeros(3), O)


GYRATION = 0.1  #: radius of gyration of the ball that represents the heaviest arm (m)
#: Inertia that is used in rank decisions if the arms hold nothing: 1 kg, radius of gyration 0.1 m.
_REFERENCE = pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))

#: ε^(1/3) = 6e-6: for smaller values the rounding error of an arm's Λ, ε/tolerance², exceeds the
#: motion of the arm in the direction, ~tolerance.
RANK_TOLERANCE = float(np.cbrt(np.finfo(float).eps))


_PAYLOAD = "osc.RigidObject(pin.Inertia(mass, lever, I)), in kg, m and kg m²"


class ClosedChain:
    """Several arms that hold one object (or one arm whose tip is the object).

    Attributes:
        model: merged Pinocchio model, with joints named "arm/joint".
        data: data of the model.
        arms: the arms.
        grasps: grasp of each arm.
        slices: part of q and v of each arm.
        leader: index of the first arm that holds the object rigidly and so determines its pose;
            None: the joints of all arms together determine it, or nothing does.
        actuated: (n_a,) indices of the motor joints in v.
        tau_max: (n_a,) effort limits of the motors (N m, N), inf without a limit.
        tips, sensors: numbers of the frames of each arm's tip and wrist sensor (None: no sensor).
        outboard: links beyond each sensor.
        arm_mass: mass of the heaviest arm, rotors included (kg).
        reference: the object or, if nothing is held, a body for rank decisions.
        full_ranks: see `ChainState`.

    Example:
        >>> from osc_contact import robots
        >>> urdf = robots.find_robot("panda")[0]
        >>> arm = osc.Arm.from_urdf(
        ...     urdf, name="panda", tip="panda_hand_tcp", wrist_sensor="panda_link7"
        ... )
        >>> chain = osc.ClosedChain(arm, payload=pin.Inertia.FromSphere(0.3, 0.02))
        >>> at = chain.state(pin.neutral(chain.model)).X_WO.translation
        >>> print(f"{chain.n_a} motors, tip {at[2]:.3f} m above the base")
        7 motors, tip 0.823 m above the base
    """

    def __init__(
        self,
        arms: Arm | Sequence[Arm],
        grasps: SE3 | Grasp | Sequence[SE3 | Grasp] | None = None,
        payload: RigidObject | pin.Inertia | None = None,
        *,
        rank_tolerance: float = RANK_TOLERANCE,
        angle_tolerance: float = 1e-3,
        allow_unactuated: bool = False,
    ) -> None:
        """Merge the arms into one model.

        Args:
            arms: one arm, or several with different names.
            grasps: for each arm the pose X_TO of the object in its tip frame, held rigidly, or a
                `Grasp` that permits motions (default: the tip's own frame, rigidly).
            payload: the held object, or its inertia in the object's frame (kg, m); None: no object,
                the last link only.
            rank_tolerance: a direction of an arm counts as locked if the inertia of arm and object
                in it is more than 1/tolerance² times the least one of all directions. Its purpose
                is to tolerate rounding errors.
            angle_tolerance: locked directions of two arms count as equal if they differ by less
                than this angle (rad, in the object's energy metric), and so do wrenches of their
                grasps. Its purpose is to tolerate errors of calibration of bases, joint axes and
                encoders.
            allow_unactuated: permit motions of the object that no motor drives, to study passive
                motion; a controller needs motors for all of them.

        Raises:
            InvalidInputError: arms, grasps or a payload of other classes.
            ModelError: no arms, equal names, a grasp too few, or one that permits motions of an
                object without mass.
        """
        self.arms = _arms_of(arms)
        self.grasps = _grasps_of(grasps, len(self.arms))
        self.payload = _payload_of(payload)
        rigid = [i for i, grasp in enumerate(self.grasps) if grasp.is_rigid]
        self.leader = rigid[0] if rigid else None
        if self.payload is None:
            _require_rigid(self.grasps)
        self.reference = RigidObject(_REFERENCE) if self.payload is None else self.payload
        self.rank_tolerance = rank_tolerance
        self.angle_tolerance = angle_tolerance
        self.allow_unactuated = allow_unactuated
        self.model = merge(self.arms)
        self.data = self.model.createData()
        ends = np.cumsum([0, *(arm.model.nv for arm in self.arms)]).tolist()
        self.slices = tuple(map(slice, ends, ends[1:]))
        passive = [f"{arm.name}/{joint}" for arm in self.arms for joint in arm.passive_joints]
        self.actuated = np.flatnonzero(~np.isin(self.joint_names, passive))
        self.tau_max = effort_limits(self.model, self.actuated)
        self.full_ranks = tuple(map(_full_rank, self.arms, self.grasps))
        self.arm_mass = max(
            sum(i.mass for i in arm.model.inertias) + heaviest_rotor(arm.model, GYRATION)
            for arm in self.arms
        )
        self.tips = [robots.frame_id(self.model, f"{arm.name}/{arm.tip}") for arm in self.arms]
        self.sensors = [_sensor_frame(self.model, arm) for arm in self.arms]
        self.outboard = [
            [] if sensor is None else outboard_links(self.model, sensor, tip)
            for sensor, tip in zip(self.sensors, self.tips, strict=True)
        ]

    @property
    def nq(self) -> int:
        """Number of joint coordinates of all arms (= number of joint velocities)."""
        return int(self.model.nq)

    @property
    def n_a(self) -> int:
        """Number of motors."""
        return len(self.actuated)

    @property
    def joint_names(self) -> list[str]:
        """Names "arm/joint" of all joints in the order of q and v."""
        return joint_names(self.model)

    @property
    def moved_mass(self) -> float:
        """Mass of all links that the joints move, and of the held object (kg)."""
        return self._held_mass + sum(link.mass for link in list(self.model.inertias)[1:])

    @property
    def outboard_mass(self) -> float:
        """Mass beyond all wrist sensors, the held object included (kg)."""
        links = [link for of_arm in self.outboard for link in of_arm]
        return self._held_mass + sum(link.inertia.mass for link in links)

    @property
    def _held_mass(self) -> float:
        """Mass of the held object, 0 without one (kg)."""
        return 0.0 if self.payload is None else float(self.payload.inertia.mass)

    def tip_poses(self, data: pin.Data | None = None) -> list[SE3]:
        """Pose of each arm's tip in the world, at the joint positions last given to `data`."""
        return [self._placement(f, data) for f in self.tips]

    def object_pose(self, data: pin.Data | None = None) -> SE3:
        """Pose of the object in the world, at the joint positions last given to `data`.

        Raises:
            ModelError: the joints do not determine the pose.
        """
        if self.leader is not None:
            return self._placement(self.tips[self.leader], data) * self.grasps[self.leader].X_TO
        tips = self.tip_poses(data)
        return locate(self.grasps, tips, self.reference_inertia, self.angle_tolerance)

    def sensor_poses(self, data: pin.Data | None = None) -> tuple[SE3 | None, ...]:
        """Poses of the wrist sensors in the world, see `tip_poses`; None without a sensor."""
        return tuple(None if f is None else self._placement(f, data) for f in self.sensors)

    def reference_inertia(self, X_WO: SE3) -> Array:
        """Inertia (6, 6) of the object or, if nothing is held, of `reference`, at its origin."""
        return self.reference.terms(X_WO, np.zeros(6), np.zeros(3)).Lambda

    def _placement(self, number: int, data: pin.Data | None) -> SE3:
        """Pose of a frame, by its number, at the joint positions last given to `data`."""
        frame = self.model.frames[number]
        joints = (self.data if data is None else data).oMi
        return joints[frame.parentJoint] * frame.placement

    def unactuated_motions(self, G: Array, S: Array) -> Array:
        """Motions (6, u) of the object that no motor drives, S U with GᵀU = 0.

        Args:
            G: (d, n_a) generalised force on the object from motor torques.
            S: (6, d) basis of the object's motions.

        Raises:
            ModelError: there are such motions, and the chain does not permit them.
        """
        limits = np.where(np.isfinite(self.tau_max), self.tau_max, 1.0)
        U, s, _ = np.linalg.svd(G * limits)
        driven = np.count_nonzero(s > 1e-9 * s.max(initial=0.0))
        motions: Array = S @ U[:, driven:]
        if motions.shape[1] and not self.allow_unactuated:
            raise ModelError(
                f"the {self.n_a} motors cannot drive every one of the {G.shape[0]} motions of the "
                f"object: no motor drives the twist {np.array2string(motions[:, -1], precision=3)} "
                "(linear, angular; world axes at the object). Add a motor, or grasp so that the "
                "motion is blocked."
            )
        return motions

    def state(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike | None = None,
        X_WO: pin.SE3 | None = None,
        V_O: npt.ArrayLike | None = None,
        *,
        data: pin.Data | None = None,
    ) -> ChainState:
        """State of the chain at (q, v), with all terms of its equation of motion.

        Args:
            q: (n,) joint positions (rad, m), arms in order, each in model order, passive joints
                included.
            v: (n,) joint velocities (rad/s, m/s), consistent with the closed loop; None: at rest.
            X_WO: pose of the object, if the joints do not determine it.
            V_O: (6,) twist of the object, if the joints do not determine it (m/s, rad/s).
            data: memory of Pinocchio (each thread needs its own); None: the chain's own.

        Raises:
            InvalidInputError: wrong sizes or non-finite numbers.
            ModelError: the joints do not determine the object's pose, or the motors cannot drive
                every motion that the arms permit.
        """
        still = np.zeros(self.nq)
        q = as_array("q", q, (self.nq,))
        v = still if v is None else as_array("v", v, (self.nq,))
        data = self.data if data is None else data
        pin.forwardKinematics(self.model, data, q, v)
        led = X_WO is None and V_O is None and self.leader is not None
        row = self.law_row(led)
        V = None
        if not led:
            X_WO = self.object_pose(data) if X_WO is None else X_WO
            V = self._twist(X_WO, data) if V_O is None else as_array("V_O", V_O, (6,))
        work = chain_work(row, q, v, X_WO, V)
        rest = chain_work(row, q, still, X_WO, np.zeros(6))
        reason = int(work.reason)
        if reason != NO_REASON:
            cause = SENTENCES[reason]
            if reason == OBJECT_UNKNOWN:
                cause += ", or give the measured pose and twist: state(q, v, X_WO, V_O)"
            raise ModelError(cause)
        return read_state(self, work, rest, data)

    def _twist(self, X_WO: pin.SE3, data: pin.Data) -> Array | None:
        """Twist (6,) of the object from the leader's tip; None without a leader: the law finds it.

        Args:
            X_WO: pose of the object.
            data: data of Pinocchio with the velocities.
        """
        if self.leader is None:
            return None
        V = pin.getFrameVelocity(self.model, data, self.tips[self.leader], pin.WORLD).vector
        return carry_twist(V, np.zeros(3), X_WO.translation)

    def law_row(self, led: bool) -> Bytes:
        """Row of the law's MODEL for the chain, see `chain_row`.

        Raises:
            ModelError: arms that the law does not support.
        """
        row = self._rows[led]
        at.MODEL.view(row).gravity = self.model.gravity.linear  # may have changed
        return row

    @cached_property
    def _rows(self) -> dict[bool, Bytes]:
        """Rows of MODEL by `led`, made and compared with Pinocchio at the first use."""
        rows = {led: chain_row(self, led) for led in (False, True)}
        require_pinocchio_agrees(self, rows[False])
        return rows


def _arms_of(arms: Arm | Sequence[Arm]) -> tuple[Arm, ...]:
    """Arms as a tuple.

    Raises:
        InvalidInputError: objects of other classes.
        ModelError: no arms, or equal names.
    """
    arms = (arms,) if isinstance(arms, Arm) else as_tuple("ClosedChain: arms", arms, "[arm]")
    for arm in arms:
        require_kind(
            "ClosedChain", arm, Arm, "osc.Arm.from_urdf('arm.urdf', name='arm', tip='tool0')"
        )
    if not arms:
        raise ModelError("a closed chain needs at least one arm")
    names = [arm.name for arm in arms]
    if len(set(names)) != len(names):
        raise ModelError(f"arm names must differ, got {names}; pass name= to Arm.from_urdf")
    return arms


def _grasps_of(grasps: SE3 | Grasp | Sequence[SE3 | Grasp] | None, arms: int) -> tuple[Grasp, ...]:
    """Grasps of all arms; a pose X_TO is held rigidly, and so is the tip by default.

    Args:
        grasps: see `ClosedChain`.
        arms: number of arms.

    Raises:
        InvalidInputError: objects of other classes.
        ModelError: not one grasp for each arm.
    """
    if grasps is None:
        return tuple(Grasp.rigid(SE3.Identity()) for _ in range(arms))
    if isinstance(grasps, SE3 | Grasp):
        grasps = (grasps,)
    several = as_tuple("ClosedChain: grasps", grasps, "[pin.SE3(R, p)]")
    if len(several) != arms:
        raise ModelError(f"{arms} arms but {len(several)} grasps; give X_TO for each")
    return tuple(grasp if isinstance(grasp, Grasp) else Grasp.rigid(grasp) for grasp in several)


def _require_rigid(grasps: Sequence[Grasp]) -> None:
    """Refuse grasps that permit motions of an object without mass.

    Raises:
        ModelError: a grasp is not rigid.
    """
    if not all(grasp.is_rigid for grasp in grasps):
        raise ModelError(
            "an object without mass cannot be held by grasps that permit motions: nothing "
            "resists these. Give a payload, or put the joint into the URDF, with a link"
        )


def _sensor_frame(model: pin.Model, arm: Arm) -> int | None:
    """Number of the frame of an arm's wrist sensor in the merged model; None without a sensor."""
    if not arm.wrist_sensor:
        return None
    return robots.frame_id(model, f"{arm.name}/{arm.wrist_sensor}")


def _payload_of(payload: RigidObject | pin.Inertia | None) -> RigidObject | None:
    """Held object, of its inertia or as given.

    Raises:
        InvalidInputError: an object of another class.
    """
    if isinstance(payload, pin.Inertia):
        payload = RigidObject(payload)
    if payload is not None:
        require_kind("payload=", payload, RigidObject, _PAYLOAD)
    return payload


def _full_rank(arm: Arm, grasp: Grasp) -> int:
    """Number of motions of the object that an arm makes in regular postures.

    It is the largest rank of NᵀJ in a few random postures.
    """
    model = arm.model
    data = model.createData()
    frame = robots.frame_id(model, arm.tip)
    postures = np.random.default_rng(0).uniform(-1.0, 1.0, (4, model.nq))
    jacobians = (pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL) for q in postures)
    return max(int(np.linalg.matrix_rank(grasp.N.T @ columns_of(J), tol=1e-6)) for J in jacobians)


# Arms, grasps and object of a closed chain as records of the law, see `law.records`.


_KINDS = {"rigid": at.RIGID, "hinge": at.HINGE, "ball": at.BALL, "other": at.OTHER}


def chain_row(chain: ClosedChain, led: bool) -> Bytes:
    """Row of MODEL of the chain alone, without contacts and motors.

    Args:
        chain: the arms.
        led: True: the leader, if there is one, determines the object's pose; False: the pose is
            given in MEMORY.
    """
    raw = new_model(len(chain.arms), chain.nq, 0)
    pack_chain(chain, raw, chain.leader if led else None)
    return raw


def pack_chain(chain: ClosedChain, raw: Bytes, leader: int | None) -> None:
    """Write the head, the arms and the joints of a row of MODEL.

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
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    head.principal[:] = (body.mass, *moments)
    head.roots[:] = np.sqrt(head.principal)
    ball = np.repeat((chain.arm_mass, chain.arm_mass * GYRATION**2), 3)
    head.reference[:] = 1.0 + ball / head.principal[[0, 0, 0, 1, 2, 3]]
    head.lightness[:] = 1.0 / head.reference
    X_LO = SE3.Identity()  # without a leader: in the object's own frame
    if leader is not None:
        X_LO = _in_joint(chain.model, chain.tips[leader]) * chain.grasps[leader].X_TO
    head.X_LO[:] = _flat_pose(X_LO)
    head.X_LP[:] = _flat_pose(X_LO * SE3(axes, body.lever))


def _pack_arms(chain: ClosedChain, rows: Any) -> None:
    """Write the records of the arms.

    Args:
        chain: the arms.
        rows: `MODEL.arms`.

    Raises:
        ModelError: an arm has more joints than the law supports.
    """
    model = chain.model
    for i, (row, grasp, part) in enumerate(zip(rows, chain.grasps, chain.slices, strict=True)):
        joints = part.stop - part.start
        if joints > at.MAX_JOINTS:
            raise ModelError(
                f"arm '{chain.arms[i].name}' has {joints} joints; the control "
                f"law takes {at.MAX_JOINTS} at most. Lock those that need not move (locked=)"
            )
        row.first = part.start
        row.end = part.stop
        row.full_rank = chain.full_ranks[i]
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


def _pack_joints(chain: ClosedChain, rows: Any) -> None:
    """Write the records of the joints.

    Args:
        chain: the arms.
        rows: `MODEL.joints`.

    Raises:
        ModelError: the joints of an arm are not serial.
    """
    model = chain.model
    firsts = {part.start for part in chain.slices}
    rows.motor[:] = -1
    rows.armature[:] = model.armature
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
    """Frame with the joint's axis as its z axis, in the joint's own frame."""
    S = joint_axis(model, joint)
    axis = S[:3] if S[:3].any() else S[3:]
    x, y, z = np.round(axis, 15)
    if (x, y, z) == (0.0, 0.0, 1.0):
        return SE3.Identity()
    start = np.eye(3)[np.abs(axis).argmin()]
    first = cross(start, axis)
    first /= norm(first)
    return SE3(np.column_stack((first, cross(axis, first), axis)), np.zeros(3))


def _in_joint(model: pin.Model, number: int) -> SE3:
    """Placement of a frame, by its number, in the z frame of its joint, see `_z_frame`."""
    frame = model.frames[number]
    return _z_frame(model, frame.parentJoint).actInv(frame.placement)


def _flat_pose(X: SE3) -> Array:
    """Rotation by rows, then position, of a pose (12,)."""
    return np.concatenate((X.rotation.ravel(), X.translation))


def _flat_inertia(inertia: pin.Inertia) -> Array:
    """Mass, centre of mass and, by rows, inertia about it (13,)."""
    return np.array([inertia.mass, *inertia.lever, *inertia.inertia.ravel()])


_NOTHING = ObjectTerms(np.zeros((6, 6)), np.zeros(6), np.zeros(6))

_NONE = np.zeros(0)


def chain_work(row: Bytes, q: Array, v: Array, X_WO: SE3 | None, V_O: Array | None) -> Any:
    """Record WORK, in memory of its own, after the law's first part: the arms without contacts.

    Args:
        row: row of MODEL by `chain_row`; a led one, if no pose is given.
        q, v: (n,) joint positions and velocities (rad, m; rad/s, m/s).
        X_WO: pose of the object; None: the joints determine it.
        V_O: (6,) twist of the object; None: the joints determine it.
    """
    rows = Rows(row)
    head, memory, work, _ = views(rows)
    if X_WO is not None:
        memory.located = 1
        memory.X_WO = X_WO.homogeneous
        memory.given = at.GIVEN_POSE if V_O is None else at.GIVEN_TWIST
        memory.V_O = 0.0 if V_O is None else V_O
    rows.job.stop = at.MEASURE
    six = np.zeros(6)
    wrenches = np.zeros((len(head.arms), 6))
    given = (q, v, wrenches, np.eye(4), six, six, _NONE, np.zeros((0, 28)), _NONE)
    law_rows()(rows.raw, 0, given)
    return work


def mass_matrix(work: Any, arms: Sequence[slice]) -> Array:
    """Mass matrix M (n, n) of all arms.

    Args:
        work: record WORK.
        arms: part of the joints of each arm.
    """
    n = len(work.joints)
    M = np.zeros((n, n))
    for s in arms:
        M[s, s] = work.joints.M[s, : s.stop - s.start]
    return M


def read_state(chain: ClosedChain, work: Any, rest: Any, data: pin.Data) -> ChainState:
    """State of a chain from the results of the law.

    Args:
        chain: the arms.
        work: record WORK at (q, v).
        rest: record WORK at q and v = 0, in which all forces are those of gravity.
        data: data of Pinocchio with the placements at q.

    Raises:
        ModelError: the motors cannot drive every motion, and the chain does not permit that.
    """
    joints = work.joints
    motion = motions(work)
    wrench = wrenches(work)
    m = int(work.locked)
    locked, free = np.split(reflection(work).T, [m], axis=1)  # in energy coordinates
    S = motion @ free
    sigma = work.sigma[:m]
    sigma_e = locked @ sigma
    Lambda = work.Lambda[m:, m:].copy()
    p = rest.chain_bias[m:].copy()
    mu = work.chain_bias[m:] + work.Lambda[m:, :m] @ sigma - p
    W = joints.J_bar @ free
    G = W.T[:, chain.actuated]
    M = mass_matrix(work, chain.slices)
    reference = at.MODEL.view(chain.law_row(led=False)).reference
    X_WO = pin.SE3(work.X_WO)
    V_O = work.V_O.copy()
    return ChainState(
        X_WO=X_WO,
        V_O=V_O,
        S=S,
        C=wrench @ locked,
        Lambda_S=Lambda,
        Phi=S @ np.linalg.solve(Lambda, S.T),
        mu_S=mu,
        p_S=p,
        sigma=motion @ sigma_e,
        G=G,
        W=W,
        w=joints.offset + joints.J_bar @ sigma_e,
        h=joints.h.copy(),
        M=M,
        arms=tuple(
            _arm_terms(own, grasp, work.joints[s], rest.joints.h[s], M[s, s], motion, wrench)
            for own, grasp, s in zip(work.arms, chain.grasps, chain.slices, strict=True)
        ),
        payload=_payload_terms(chain, X_WO, V_O),
        metric=wrench @ wrench.T,
        grasp_points=np.array([tip.translation for tip in chain.tip_poses(data)]),
        sensors=chain.sensor_poses(data),
        filters=_filters(chain, work.arms, motion, wrench),
        Lambda_out=wrench @ work.out_T.T @ wrench.T,
        bias_out=work.bias_out.copy(),
        unactuated=chain.unactuated_motions(G, S),
        reference=(wrench * reference) @ wrench.T,
        full_ranks=chain.full_ranks,
        singular_directions=tuple(
            _singular_directions(chain, work.arms, reference, motion, wrench)
        ),
    )


def _payload_terms(chain: ClosedChain, X_WO: SE3, V_O: Array) -> ObjectTerms:
    """Terms of the held object at its pose and twist (6,); zero without an object."""
    if chain.payload is None:
        return _NOTHING
    return chain.payload.terms(X_WO, V_O, chain.model.gravity.linear)


def _filters(
    chain: ClosedChain, arms: Any, motion: Array, wrench: Array
) -> tuple[Array | None, ...]:
    """Factors (6, 6) of the wrist readings at O; None of a rigid grasp, or without a sensor.

    Args:
        chain: the arms.
        arms: `WORK.arms`.
        motion, wrench: (6, 6) bases of energy coordinates in world axes at O.
    """
    return tuple(
        wrench @ own.filter @ motion.T if links and not grasp.is_rigid else None
        for grasp, links, own in zip(chain.grasps, chain.outboard, arms, strict=True)
    )


def _arm_terms(
    own: Any, grasp: Grasp, joints: Any, weight: Array, M: Array, motion: Array, wrench: Array
) -> ArmTerms:
    """Operational-space terms of one arm from the results of the law.

    Args:
        own: record of the arm in `WORK.arms`.
        grasp: grasp of the arm.
        joints: records of its joints in `WORK.joints`.
        weight: (n,) torques of gravity (N m, N).
        M: (n, n) mass matrix of the arm.
        motion, wrench: (6, 6) bases of energy coordinates in world axes at O.
    """
    J = motion @ joints.J.T
    J_bar = joints.J_bar @ wrench.T
    gamma = motion @ own.gamma
    Lambda = wrench @ own.Lambda @ wrench.T
    p = J_bar.T @ weight
    rank = int(own.n_kept)
    return ArmTerms(
        J=J,
        gamma=gamma,
        M=M,
        Phi=J @ np.linalg.solve(M, J.T),
        Lambda=Lambda,
        J_bar=J_bar,
        mu=J_bar.T @ joints.h - p - Lambda @ gamma,
        p=p,
        C=wrench @ own.resisted[: int(own.n_locked)].T,
        N=np.eye(6) if grasp.is_rigid else wrench @ own.kept[:rank].T,
        rank=rank,
    )


def _singular_directions(
    chain: ClosedChain, arms: Any, reference: Array, motion: Array, wrench: Array
) -> Iterator[SingularDirection]:
    """Directions in which arms hardly move the object, from the results of the law.

    Args:
        chain: the arms.
        arms: `WORK.arms`.
        reference: (6,) diagonal of Λ_ref in energy coordinates.
        motion, wrench: (6, 6) bases of energy coordinates in world axes at O.
    """
    for i, (own, s) in enumerate(zip(arms, chain.slices, strict=True)):
        for e in range(int(own.n_lost)):
            lost = own.lost[e]
            yield SingularDirection(
                arm=i,
                chi=float(own.chi[e]),
                share=float(own.share[e]),
                wrench=wrench @ lost,
                twist=motion @ (lost / reference),
                mode=own.mode[e, : s.stop - s.start].copy(),
                locked=bool(own.gone[e]),
            )


STATES = 3  #: random states at which the law is compared with Pinocchio
TOLERANCE = 1e-9  #: largest difference over the largest element, or over 1


def require_pinocchio_agrees(chain: ClosedChain, row: Bytes) -> None:
    """Compare J, M and h = C v + g of the law with Pinocchio's on a few random states.

    Args:
        chain: the arms.
        row: row of MODEL by `chain_row`, not led, as the object's pose does not matter.

    Raises:
        ModelError: a difference above TOLERANCE: a kind of joint or a property of the model that
            the law does not support.
    """
    rng = np.random.default_rng(0)
    data = chain.model.createData()
    n = chain.nq
    for _ in range(STATES):
        q = rng.uniform(-1.0, 1.0, n)
        v = rng.normal(size=n)
        work = chain_work(row, q, v, SE3.Identity(), np.zeros(6))
        pin.computeAllTerms(chain.model, data, q, v)
        for name, ours, theirs in (
            ("J", carry_twist(work.joints.column.T, work.p_C, np.zeros(3)), columns_of(data.J)),
            ("M", mass_matrix(work, chain.slices), data.M),
            ("h", work.joints.h, data.nle),
        ):
            worst = float(np.abs(ours - theirs).max(initial=0.0))
            if not worst <= TOLERANCE * np.abs(theirs).max(initial=1.0):
                raise ModelError(
                    f"the control law's {name} differs from Pinocchio's by {worst:.3g} on a random "
                    "state: the model has a joint or a property that the law does not support. "
                    "Please report it with the model; a chain of plain revolute and prismatic "
                    "joints is supported"
                )
