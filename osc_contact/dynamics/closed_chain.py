"""Arms that hold one object: the closed chain of section 6 and its equation of motion, eq. 13.

The object can make only the motions S that every arm permits (dual SCARA: five). In them

    Λ_S η̇ + μ_S + p_S + Sᵀf_c = G τ,        a = S η̇ + σ,        q̈ = W η̇ + w,

and Φ₀ = S Λ_S⁻¹ Sᵀ takes the place of Λ₀⁻¹: a 6×6 matrix of rank d, never a damped inverse.
Grasps may permit motions (`Grasp`); these have no mass and no motor drives them.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    """Jacobian columns (6, n) carried from the world origin to O."""
    return carry_twist(columns_of(J_world), np.zeros(3), O)


GYRATION = 0.1  #: m, of the ball that stands for the heaviest arm, see `law.operational`
#: Stands in for the object's inertia in rank decisions when the arms hold nothing:
#: 1 kg with a radius of gyration of 0.1 m.
_REFERENCE = pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))

#: Below it Λ of an arm, ~1/tolerance², loses more to rounding, ε/tolerance², than the arm still
#: moves in the direction, ~tolerance: ε^(1/3), 6e-6.
RANK_TOLERANCE = float(np.cbrt(np.finfo(float).eps))


_PAYLOAD = "osc.RigidObject(pin.Inertia(mass, lever, I)), in kg, m and kg m²"


class ClosedChain:
    """Several arms that hold one object (or one arm whose tip is the object).

    Attributes:
        model, data: the merged Pinocchio model, joints named "arm/joint", and its data.
        arms: as given. grasps: one for each arm. slices: each arm's part of q and v.
        leader: the first arm that holds the object rigidly and so determines its pose; None: the
            joints of all arms together do, if anything does.
        actuated: (n_a,) indices of the motor joints in v. tau_max: (n_a,) their effort limits, inf
            where a model names none.
        tips, sensors: frame of each arm's tip and wrist sensor (None: it has none).
        outboard: links beyond each sensor. arm_mass: of the heaviest arm, rotors included.
        reference: the object, or its stand-in for rank decisions. full_ranks: as in `ChainState`.

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
            arms: one, or several with different names.
            grasps: for each arm X_TO, pose of the object in its tip frame, held rigidly, or a
                `Grasp` that permits motions (default: the tip itself, rigidly).
            payload: the held object, or its inertia in the object's frame (kg, m); None: nothing
                but the last link.
            rank_tolerance: an arm direction counts as locked when the inertia of arm and object in
                it is more than 1/tolerance² times that in the direction where it is least. A
                matter of rounding only.
            angle_tolerance: two arms' locked directions count as the same when they differ by less
                than this angle (rad, in the object's energy metric), and so do wrenches of their
                grasps. A matter of calibration: of bases, joint axes and encoders.
            allow_unactuated: give the state also where no motor drives some motion of the object,
                to study how it moves by itself; a controller needs every motion driven.

        Raises:
            InvalidInputError: arms, grasps or a payload of other classes.
            ModelError: no arms, equal names, a grasp too few, or one that permits motions of an
                object without mass.
        """
        arms = (arms,) if isinstance(arms, Arm) else as_tuple("ClosedChain: arms", arms, "[arm]")
        for arm in arms:
            require_kind(
                "ClosedChain", arm, Arm, "osc.Arm.from_urdf('arm.urdf', name='arm', tip='tool0')"
            )
        if isinstance(grasps, SE3 | Grasp):
            grasps = (grasps,)
        if isinstance(payload, pin.Inertia):
            payload = RigidObject(payload)
        if payload is not None:
            require_kind("payload=", payload, RigidObject, _PAYLOAD)
        if not arms:
            raise ModelError("a closed chain needs at least one arm")
        names = [arm.name for arm in arms]
        if len(set(names)) != len(names):
            raise ModelError(f"arm names must differ, got {names}; pass name= to Arm.from_urdf")
        self.arms = tuple(arms)
        given = (
            [SE3.Identity() for _ in arms]
            if grasps is None
            else as_tuple("ClosedChain: grasps", grasps, "[pin.SE3(R, p)]")
        )
        self.grasps = tuple(g if isinstance(g, Grasp) else Grasp.rigid(g) for g in given)
        rigid = [i for i, grasp in enumerate(self.grasps) if grasp.is_rigid]
        self.leader = rigid[0] if rigid else None
        self.allow_unactuated = allow_unactuated
        if len(self.grasps) != len(arms):
            raise ModelError(f"{len(arms)} arms but {len(self.grasps)} grasps; give X_TO for each")
        if payload is None and len(rigid) < len(self.grasps):
            raise ModelError(
                "an object without mass cannot be held by grasps that permit motions: nothing "
                "resists these. Give a payload, or put the joint into the URDF, with a link"
            )
        self.payload = payload
        self.reference = payload or RigidObject(_REFERENCE)
        self.rank_tolerance = rank_tolerance
        self.angle_tolerance = angle_tolerance
        self.model = merge(self.arms)
        self.data = self.model.createData()
        ends = np.cumsum([0, *(arm.model.nv for arm in arms)]).tolist()
        self.slices = tuple(map(slice, ends, ends[1:]))
        passive = [f"{arm.name}/{joint}" for arm in arms for joint in arm.passive_joints]
        self.actuated = np.flatnonzero(~np.isin(self.joint_names, passive))
        self.tau_max = effort_limits(self.model, self.actuated)
        self.full_ranks = tuple(map(_full_rank, arms, self.grasps))
        self.arm_mass = max(
            sum(i.mass for i in arm.model.inertias) + heaviest_rotor(arm.model, GYRATION)
            for arm in arms
        )
        self.tips = [robots.frame_id(self.model, f"{a.name}/{a.tip}") for a in arms]
        self.sensors = [
            robots.frame_id(self.model, f"{a.name}/{a.wrist_sensor}") if a.wrist_sensor else None
            for a in arms
        ]
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
        """All joints in the order of q and v, "arm/joint"."""
        return joint_names(self.model)

    @property
    def moved_mass(self) -> float:
        """Mass (kg) of all links that the joints move, and of the held object."""
        return self._held_mass + sum(link.mass for link in list(self.model.inertias)[1:])

    @property
    def outboard_mass(self) -> float:
        """Mass (kg) beyond all wrist sensors, the held object included."""
        return self._held_mass + sum(x.inertia.mass for links in self.outboard for x in links)

    @property
    def _held_mass(self) -> float:
        return 0.0 if self.payload is None else float(self.payload.inertia.mass)

    def tip_poses(self, data: pin.Data | None = None) -> list[SE3]:
        """Pose of each arm's tip in the world, at the positions last given to `data`."""
        return [self._placement(f, data) for f in self.tips]

    def object_pose(self, data: pin.Data | None = None) -> SE3:
        """Pose of the object at the same positions.

        Raises:
            ModelError: the joints do not determine it.
        """
        if self.leader is not None:
            return self._placement(self.tips[self.leader], data) * self.grasps[self.leader].X_TO
        tips = self.tip_poses(data)
        return locate(self.grasps, tips, self.reference_inertia, self.angle_tolerance)

    def sensor_poses(self, data: pin.Data | None = None) -> tuple[SE3 | None, ...]:
        """Placement of each wrist sensor in the world, likewise; None: the arm has none."""
        return tuple(None if f is None else self._placement(f, data) for f in self.sensors)

    def reference_inertia(self, X_WO: SE3) -> Array:
        """(6, 6) inertia of the object at its own origin, or of its stand-in if nothing is held."""
        return self.reference.terms(X_WO, np.zeros(6), np.zeros(3)).Lambda

    def _placement(self, frame: int, data: pin.Data | None) -> SE3:
        at = self.model.frames[frame]
        return (data or self.data).oMi[at.parentJoint] * at.placement

    def unactuated_motions(self, G: Array, S: Array) -> Array:
        """(6, u) motions of the object in which GᵀU = 0; an error unless they are allowed."""
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
        """Everything the contact model needs to know of the chain at (q, v).

        Args:
            q: (n,) joint positions, arms in order, each in model order, passive joints included.
            v: (n,) joint velocities, consistent with the closed loop; None: at rest.
            X_WO, V_O: pose and twist (6,) of the object, where the joints do not determine them.
            data: to work in (threads need one each); default: the chain's own.

        Raises:
            InvalidInputError: wrong sizes or non-finite numbers.
            ModelError: the joints do not determine where the object is, or the motors cannot drive
                every motion the arms permit.
        """
        still = np.zeros(self.nq)
        q = as_array("q", q, (self.nq,))
        v = still if v is None else as_array("v", v, (self.nq,))
        data = data or self.data
        pin.forwardKinematics(self.model, data, q, v)
        led = X_WO is None and V_O is None and self.leader is not None
        row = self.law_row(led)
        V = None
        if not led:
            X_WO = X_WO or self.object_pose(data)
            V = self._twist(X_WO, data) if V_O is None else as_array("V_O", V_O, (6,))
        work = chain_work(row, q, v, X_WO, V)
        rest = chain_work(row, q, still, X_WO, np.zeros(6))
        reason = int(work.reason)
        if reason != NO_REASON:
            measured = ", or give the measured pose and twist: state(q, v, X_WO, V_O)"
            raise ModelError(SENTENCES[reason] + measured * (reason == OBJECT_UNKNOWN))
        return read_state(self, work, rest, data)

    def _twist(self, X_WO: pin.SE3, data: pin.Data) -> Array | None:
        """(6,) of the object from the leader's tip; None: the law finds it."""
        if self.leader is None:
            return None
        V = pin.getFrameVelocity(self.model, data, self.tips[self.leader], pin.WORLD).vector
        return carry_twist(V, np.zeros(3), X_WO.translation)

    def law_row(self, led: bool) -> Bytes:
        """The chain as the law's MODEL, see `chain_row`.

        Raises:
            ModelError: arms that the law does not know.
        """
        row = self._rows[led]
        at.MODEL.view(row).gravity = self.model.gravity.linear  # may have changed
        return row

    @cached_property
    def _rows(self) -> dict[bool, Bytes]:
        rows = {led: chain_row(self, led) for led in (False, True)}
        require_pinocchio_agrees(self, rows[False])
        return rows


def _full_rank(arm: Arm, grasp: Grasp) -> int:
    """Motions of the object that an arm makes in ordinary postures, according to its grasp.

    The largest rank of NᵀJ in a few random postures.
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
    """A row of MODEL of the chain alone: no contacts, no motors.

    Args:
        led: the leading arm, if there is one, determines the object's pose; else it
            is given (`MEMORY`).
    """
    raw = new_model(len(chain.arms), chain.nq, 0)
    pack_chain(chain, raw, chain.leader if led else None)
    return raw


def pack_chain(chain: ClosedChain, raw: Bytes, leader: int | None) -> None:
    """Fill in what of a row of MODEL comes from the chain: its head, arms and joints.

    Args:
        chain: to pack. raw: bytes of the row.
        leader: arm that holds the object rigidly; None: no arm does.
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
    """The joint's frame rotated so that it turns about, or slides along, its z axis."""
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
    """A frame's placement in its joint, whose z axis is the joint's."""
    frame = model.frames[number]
    return _z_frame(model, frame.parentJoint).actInv(frame.placement)


def _flat_pose(X: SE3) -> Array:
    """(12,) rotation by rows, then point."""
    return np.concatenate((X.rotation.ravel(), X.translation))


def _flat_inertia(inertia: pin.Inertia) -> Array:
    """(13,) mass, centre, inertia about it by rows."""
    return np.array([inertia.mass, *inertia.lever, *inertia.inertia.ravel()])


_NOTHING = ObjectTerms(np.zeros((6, 6)), np.zeros(6), np.zeros(6))

_NONE = np.zeros(0)


def chain_work(row: Bytes, q: Array, v: Array, X_WO: SE3 | None, V_O: Array | None) -> Any:
    """WORK in separate memory after the law's first part: the arms at (q, v), before any contact.

    Args:
        row: from `chain_row`; led, if no pose is given.
        q, v: (n,). X_WO, V_O: pose and twist (6,) of the object, if they are given.
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
    given = (q, v, np.zeros((len(head.arms), 6)), np.eye(4), six, six, _NONE, np.zeros((0, 28)))
    law_rows()(rows.raw, 0, given)
    return work


def mass_matrix(work: Any, arms: Sequence[slice]) -> Array:
    """M (n, n) of all arms, from WORK and each one's part of the joints."""
    n = len(work.joints)
    M = np.zeros((n, n))
    for s in arms:
        M[s, s] = work.joints.M[s, : s.stop - s.start]
    return M


def read_state(chain: ClosedChain, work: Any, rest: Any, data: pin.Data) -> ChainState:
    """The state of a chain.

    Args:
        work: WORK at (q, v). rest: at the same q and v = 0, where all forces are gravity's.
        data: with the placements at q.

    Raises:
        ModelError: the motors cannot drive every motion, and the chain does not allow that.
    """
    joints = work.joints
    motion = motions(work)
    wrench = wrenches(work)
    m = int(work.locked)
    locked, free = np.split(reflection(work).T, [m], axis=1)  # what η̇ moves, in energy coordinates
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
    payload = _NOTHING
    if chain.payload is not None:
        payload = chain.payload.terms(X_WO, V_O, chain.model.gravity.linear)
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
        payload=payload,
        metric=wrench @ wrench.T,
        grasp_points=np.array([tip.translation for tip in chain.tip_poses(data)]),
        sensors=chain.sensor_poses(data),
        filters=tuple(
            wrench @ own.filter @ motion.T if links and not grasp.is_rigid else None
            for grasp, links, own in zip(chain.grasps, chain.outboard, work.arms, strict=True)
        ),
        Lambda_out=wrench @ work.out_T.T @ wrench.T,
        bias_out=work.bias_out.copy(),
        unactuated=chain.unactuated_motions(G, S),
        reference=(wrench * reference) @ wrench.T,
        full_ranks=chain.full_ranks,
        singular_directions=tuple(
            _singular_directions(chain, work.arms, reference, motion, wrench)
        ),
    )


def _arm_terms(
    own: Any, grasp: Grasp, joints: Any, weight: Array, M: Array, motion: Array, wrench: Array
) -> ArmTerms:
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
) -> Any:
    """Every direction that the law found an arm to be losing."""
    for i, (own, s) in enumerate(zip(arms, chain.slices, strict=True)):
        for e in range(int(own.n_lost)):
            lost = own.lost[e]
            yield SingularDirection(
                i,
                float(own.chi[e]),
                float(own.share[e]),
                wrench @ lost,
                motion @ (lost / reference),
                own.mode[e, : s.stop - s.start].copy(),
                bool(own.gone[e]),
            )


STATES = 3
TOLERANCE = 1e-9


def require_pinocchio_agrees(chain: ClosedChain, row: Bytes) -> None:
    """Compare J, M and h = C v + g on a few random states.

    Args:
        chain: the arms. row: from `chain_row`, not led: where the object is does not matter.

    Raises:
        ModelError: a difference above 1e-9 of the largest element: a kind of joint or a property of
            the model that the law does not know.
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
