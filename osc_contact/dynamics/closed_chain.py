"""Closed chain of arms that hold one object (section 6), and its equation of motion, eq. 13.

The object can make only the motions S that every arm permits (dual SCARA: five). For these

    Λ_S η̇ + μ_S + p_S + Sᵀf_c = G τ,        a = S η̇ + σ,        q̈ = W η̇ + w,

and Φ₀ = S Λ_S⁻¹ Sᵀ, a 6×6 matrix of rank d without damping, replaces Λ₀⁻¹.
Grasps may permit motions (`Grasp`), which have no mass and no motor.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

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
from osc_contact.dynamics.chain_records import GYRATION, chain_row
from osc_contact.dynamics.chain_results import chain_work, read_state, require_pinocchio_agrees
from osc_contact.dynamics.chain_state import ChainState, RigidObject
from osc_contact.dynamics.grasp import Grasp, locate
from osc_contact.dynamics.merged_model import merge, outboard_links
from osc_contact.errors import ModelError, as_tuple, require_kind
from osc_contact.law import records as at
from osc_contact.law.chain import OBJECT_UNKNOWN
from osc_contact.law.reasons import NO_REASON, SENTENCES
from osc_contact.law.records import Bytes
from osc_contact.robots.model import joint_names
from osc_contact.spatial import Array, as_array, carry_twist, columns_of


def columns_at(J_world: Array, O: Array) -> Array:  # noqa: E741 - the operational point
    """Jacobian columns (6, n) at O (3,), from those at the world's origin."""
    return carry_twist(columns_of(J_world), np.zeros(3), O)


#: Inertia that is used in rank decisions if the arms hold nothing: 1 kg, radius of gyration 0.1 m.
_REFERENCE_INERTIA = pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))

#: ε^(1/3) = 6e-6: for smaller values the rounding error of an arm's Λ, ε/tolerance², exceeds the
#: motion of the arm in the direction, ~tolerance.
RANK_TOLERANCE = float(np.cbrt(np.finfo(float).eps))


_PAYLOAD_EXAMPLE = "osc.RigidObject(pin.Inertia(mass, lever, I)), in kg, m and kg m²"


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
            grasps: for each arm the pose X_TO of the object in its tip frame, held rigidly,
                or a `Grasp` that permits motions (default: the tip's own frame, rigidly).
            payload: the held object, or its inertia in the object's frame (kg, m); None: no object,
                the last link only.
            rank_tolerance: a direction of an arm counts as locked if the inertia of arm and object
                in it is more than 1/tolerance² times the least inertia of all directions. Its
                purpose is to tolerate rounding errors.
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
        # the leading arm determines the object's pose from its joints, so its grasp must be rigid
        rigid = [i for i, grasp in enumerate(self.grasps) if grasp.is_rigid]
        self.leader = rigid[0] if rigid else None
        if self.payload is None:
            _require_rigid(self.grasps)
        self.reference = RigidObject(_REFERENCE_INERTIA) if self.payload is None else self.payload
        self.rank_tolerance = rank_tolerance
        self.angle_tolerance = angle_tolerance
        self.allow_unactuated = allow_unactuated
        self.model = merge(self.arms)
        self.data = self.model.createData()
        self._find_joints_and_frames()

    def _find_joints_and_frames(self) -> None:
        """Find joints, motors and frames of each arm in the merged model.

        Sets `slices` (joints of each arm in q), `actuated` (indices of joints with a motor),
        `tau_max` (their limits, N m or N), `full_ranks` (independent motions of each tip in regular
        postures), `arm_mass` (mass of the heaviest arm with its rotors, kg), `tips` and `sensors`
        (indices of frames; None: no sensor), and `outboard` (links of each arm beyond its wrist
        sensor).
        """
        # joints of each arm are adjacent in q; those without a motor are not in tau
        ends = np.cumsum([0, *(arm.model.nv for arm in self.arms)]).tolist()
        self.slices = tuple(map(slice, ends, ends[1:]))
        passive_joints = [
            f"{arm.name}/{joint}" for arm in self.arms for joint in arm.passive_joints
        ]
        self.actuated = np.flatnonzero(~np.isin(self.joint_names, passive_joints))
        self.tau_max = effort_limits(self.model, self.actuated)
        self.full_ranks = tuple(map(_full_rank, self.arms, self.grasps))
        self.arm_mass = max(map(_mass_with_rotors, self.arms))
        self.tips = [robots.frame_id(self.model, f"{arm.name}/{arm.tip}") for arm in self.arms]
        self.sensors = [_sensor_frame(self.model, arm) for arm in self.arms]
        # links beyond each wrist sensor, whose weight and inertia forces the sensor measures, too
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
        """Mass of the held object (kg); 0 without an object."""
        return 0.0 if self.payload is None else float(self.payload.inertia.mass)

    def tip_poses(self, data: pin.Data | None = None) -> list[SE3]:
        """Pose of each arm's tip in the world, at the joint positions last given to `data`."""
        return [self._frame_placement(f, data) for f in self.tips]

    def object_pose(self, data: pin.Data | None = None) -> SE3:
        """Pose of the object in the world, at the joint positions last given to `data`.

        Raises:
            ModelError: the joints do not determine the pose.
        """
        if self.leader is not None:
            return (
                self._frame_placement(self.tips[self.leader], data) * self.grasps[self.leader].X_TO
            )
        tips = self.tip_poses(data)
        return locate(self.grasps, tips, self.reference_inertia, self.angle_tolerance)

    def sensor_poses(self, data: pin.Data | None = None) -> tuple[SE3 | None, ...]:
        """Poses of the wrist sensors in the world, see `tip_poses`; None without a sensor."""
        return tuple(None if f is None else self._frame_placement(f, data) for f in self.sensors)

    def reference_inertia(self, X_WO: SE3) -> Array:
        """Inertia (6, 6) of the object or, if nothing is held, of `reference`, at its origin."""
        return self.reference.terms(X_WO, np.zeros(6), np.zeros(3)).Lambda

    def _frame_placement(self, number: int, data: pin.Data | None) -> SE3:
        """Pose of a frame, given by its number, in the world at the joint positions in `data`.

        Args:
            number: number of the frame.
            data: data of Pinocchio; None: the chain's own.
        """
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
        from_leader = X_WO is None and V_O is None and self.leader is not None
        row = self.law_row(from_leader)
        V = None
        if not from_leader:
            X_WO = self.object_pose(data) if X_WO is None else X_WO
            V = self._object_twist(X_WO, data) if V_O is None else as_array("V_O", V_O, (6,))
        work = chain_work(row, q, v, X_WO, V)
        static_work = chain_work(row, q, still, X_WO, np.zeros(6))
        reason = int(work.reason)
        if reason != NO_REASON:
            cause = SENTENCES[reason]
            if reason == OBJECT_UNKNOWN:
                cause += ", or give the measured pose and twist: state(q, v, X_WO, V_O)"
            raise ModelError(cause)
        return read_state(self, work, static_work, data)

    def _object_twist(self, X_WO: pin.SE3, data: pin.Data) -> Array | None:
        """Twist (6,) of the object at O from the leader's tip (m/s, rad/s).

        It is None without a leader; then the law computes the twist from all arms.

        Args:
            X_WO: pose of the object.
            data: data of Pinocchio with the velocities.
        """
        if self.leader is None:
            return None
        V = pin.getFrameVelocity(self.model, data, self.tips[self.leader], pin.WORLD).vector
        return carry_twist(V, np.zeros(3), X_WO.translation)

    def law_row(self, from_leader: bool) -> Bytes:
        """Row of the law's MODEL for the chain, see `chain_row`.

        Args:
            from_leader: True: the leader, if there is one, determines the object's pose; False: the
                pose is given in MEMORY.

        Raises:
            ModelError: arms that the law does not support.
        """
        row = self._model_rows[from_leader]  # made at first use
        at.MODEL.view(row).gravity = self.model.gravity.linear  # may have changed
        return row

    @cached_property
    def _model_rows(self) -> dict[bool, Bytes]:
        """Rows of MODEL for both values of `from_leader`, compared with Pinocchio at first use."""
        rows = {from_leader: chain_row(self, from_leader) for from_leader in (False, True)}
        require_pinocchio_agrees(self, rows[False])
        return rows


def _mass_with_rotors(arm: Arm) -> float:
    """Mass of an arm, with that of the ball that represents its heaviest rotor (kg)."""
    links = sum(inertia.mass for inertia in arm.model.inertias)
    return float(links + heaviest_rotor(arm.model, GYRATION))


def _arms_of(arms: Arm | Sequence[Arm]) -> tuple[Arm, ...]:
    """Check the arms of a chain; return them as a tuple.

    Args:
        arms: an arm, or several.

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
    """Check the grasps of all arms; return them as a tuple.

    A pose X_TO becomes a rigid grasp; without grasps the object's frame is the tip's, held rigidly.

    Args:
        grasps: for each arm the pose X_TO of the object in its tip frame, held rigidly, or a
            `Grasp`; one of them for a single arm; None: the tip's own frame.
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
    """Check the held object; an inertia becomes a `RigidObject`, None stays None.

    Args:
        payload: argument of `ClosedChain`.

    Raises:
        InvalidInputError: an object of another class.
    """
    if isinstance(payload, pin.Inertia):
        payload = RigidObject(payload)
    if payload is not None:
        require_kind("payload=", payload, RigidObject, _PAYLOAD_EXAMPLE)
    return payload


def _full_rank(arm: Arm, grasp: Grasp) -> int:
    """Number of independent motions of the object, along N, that an arm makes in regular postures.

    It is the largest rank of NᵀJ in a few random postures.

    Args:
        arm: the arm.
        grasp: grasp of the object by the arm.
    """
    model = arm.model
    data = model.createData()
    frame = robots.frame_id(model, arm.tip)
    postures = np.random.default_rng(0).uniform(-1.0, 1.0, (4, model.nq))
    jacobians = (pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL) for q in postures)
    return max(int(np.linalg.matrix_rank(grasp.N.T @ columns_of(J), tol=1e-6)) for J in jacobians)
