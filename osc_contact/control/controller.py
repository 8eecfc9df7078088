"""Decoupled force/motion controller, fig. 4: tick, state, reports and copies."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.custom_laws import CustomParts, Laws
from osc_contact.control.inputs import (
    NO_FORCES,
    Freshness,
    read_joints,
    read_tick,
    require_shapes,
    require_sizes,
)
from osc_contact.control.reasons import explain, unbraked_joint
from osc_contact.control.records import (
    STILL,
    UNNAMED,
    Reading,
    Settings,
    TickRecords,
    pack_gains,
    pack_model,
    pack_safety,
)
from osc_contact.control.saving import controller_bytes
from osc_contact.control.signals import Signals, TickResult
from osc_contact.control.start_check import StartCheck
from osc_contact.control.status import LimitLoss, LostDirection, Phase, SafetyState, Status
from osc_contact.control.torque_limits import MotorLimits, relieve, scale_torques
from osc_contact.control.waiting import Idle, explained_approaches, standing_approaches
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Body
from osc_contact.dynamics.learned_friction import LearnedFriction, robot_identity
from osc_contact.errors import InvalidInputError, OscContactError, SolverError, require_kind
from osc_contact.files import write_whole
from osc_contact.interface import Measurement, Reference
from osc_contact.law.chain import OBJECT_UNKNOWN
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.records import DEGRADED, HAND_OVER, HISTORY, OK, Bytes
from osc_contact.robots.model import joint_names
from osc_contact.settings.control import (
    Friction,
    Gains,
    JointFriction,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.spatial import Array, as_array

_log = logging.getLogger(__name__)
# Members of enumerations by their numbers, for fast access in every tick.
_STATUS = tuple(Status)
_STATES = tuple(SafetyState)
_SETTABLE = ("f_tare", "f_bias", "engaged", "motion_integral", "force_integral")
#: Fields of MEMORY that `reset` sets to zero; below, fields of its tables (all if none is named).
FORGOTTEN = (
    "age",
    "faults",
    "lost",
    "overspeed",
    "powered",
    "ending",
    "compared",
    "frozen",
    "still",
    "wrench_age",
    "old_joints",
    "old_wrists",
    "balanced",
    "apart",
    "mixed",
    "tested",
    "above",
    "missed",
    "repeats",
    "fresh",
    "step_left",
    "squeeze_left",
    "motion_sum",
    "force_sum",
    "over_contact",
    "over_wrist",
    "over_tip",
    "centre_rate",
)
FORGOTTEN_TABLES: dict[str, tuple[str, ...]] = {
    "joints": (),
    "arms": (),
    "columns": ("underforce", "overforce", "time_since_loss", "has_desired", "integral"),
}


def _six_numbers(field: str, doc: str) -> property:
    """Settable property of a controller for a field of six numbers in MEMORY.

    Args:
        field: name in MEMORY. doc: docstring of the property.
    """

    def read(controller: Any) -> Array:
        return np.array(controller._memory[field])

    def write(controller: Any, value: Array) -> None:
        controller._memory[field][:] = as_array(field, value, (6,))

    return property(read, write, doc=doc)


class Controller:
    """Dynamically decoupled force/motion control of one held object (fig. 4).

    Settings are fixed at construction; `with_gains`, `with_safety` and `with_laws` make another
    controller that continues with the present state. Controllers share no mutable state: they can
    be copied, pickled, and used in separate threads.

    Attributes:
        settings: all settings. laws: custom laws.
        chain, contacts, gains, dt, B, bodies, posture, friction, life, reading: single settings
            (`reading` as chosen if it was None).

    Example:
        >>> rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
        >>> controller = osc.Controller(rig.chain, rig.pairs, dt=1e-3, posture=rig.q_start)
        >>> goal = osc.Reference(rig.state.X_WO, alpha_d=[5.0, 5.0])
        >>> tau = controller.tick(rig.plant().measure(), goal)
        >>> print(tau.shape, controller.status.name)
        (8,) OK
    """

    dt: float  #: control period of the settings (s)
    _limits: MotorLimits | None = None
    _given_up: LimitLoss | None = None
    _failure: Exception | None = None
    _inputs: tuple[Any, Any] = (None, None)  #: input of the last tick that did not end OK
    _result: TickResult | None = None

    def __init__(
        self,
        chain: ClosedChain,
        contacts: ContactPair | Sequence[ContactPair],
        gains: Gains | None = None,
        *,
        dt: float = 1e-3,
        B: ArrayLike | str = "object",
        bodies: Sequence[Body | None] | None = None,
        posture: ArrayLike | None = None,
        engaged: bool = True,
        in_contact: bool = True,
        friction: Friction | None = None,
        reading: Reading | None = None,
        life: PhaseSettings | None = None,
        laws: Laws | None = None,
        posture_task: PostureTask | None = None,
        safety: SafetySettings | None = None,
        joint_friction: JointFriction | bool = True,
    ) -> None:
        """Make a controller with zero integrals.

        Args:
            chain: model of arms and object.
            contacts: a pair, or several in the order of alpha_d.
            gains: gains of both loops.
            dt: control period (s).
            B: metric of the motion filter Ω_m(B), eq. 24: "object" (Λ_o⁻¹), "chain"
                ((ΣΛ_i + Λ_o)⁻¹ within the chain's motions) or a positive definite (6, 6).
            bodies: dynamics of the touched body at each contact; None: contact forces do not move
                it, though its motion may be measured. The same object twice: both contacts are on
                one body.
            posture: (n,) joint positions to which redundant arms return (default: neutral). This
                goal may be somewhat outside the joints' limits, since the posture task keeps the
                joints within them.
            engaged: whether the law includes the contacts from the start.
            in_contact: whether contacts that push are closed at the start; False: they are open,
                and approached once they are active, for which `life` is needed.
            friction: friction at the contacts that is taken into account; None: none.
            reading: method of computing contact forces from the wrist readings, 'filter' (fig. 5)
                or 'least_squares', which is not affected by friction and tilted faces; None: the
                latter if a contact pushes at a known point (see `law.reading`).
            life: settings of contact phases, by which contacts are opened, approached and closed
                one by one; None: all contacts are closed while they are engaged.
            laws: the user's laws in place of force law, motion law or control structure.
            posture_task: settings of the posture task of redundant arms.
            safety: limits of the robot, and conditions of a hold and a stop.
            joint_friction: settings for identification and compensation of joint friction; True:
                `JointFriction()`; False: no compensation.

        Raises:
            InvalidInputError: an argument of another class or unit, an unknown metric, contacts
                that begin open without `life`, or contacts and an arm without a wrist sensor, so
                that contact forces cannot be measured.
            ModelError: an arm that the law does not support.
        """
        settings = Settings(
            chain,
            (contacts,) if isinstance(contacts, ContactPair) else contacts,
            gains or Gains(),
            dt,
            cast("Array | str", B),  # settings make arrays of both
            () if bodies is None else bodies,
            cast("Array | None", posture),
            posture_task or PostureTask(),
            friction,
            life,
            safety or SafetySettings(),
            joint_friction,
            reading,
        )
        if laws is not None:
            require_kind(
                "laws=",
                laws,
                Laws,
                "osc.Laws(force=function), osc.Laws(motion=function) or "
                "osc.Laws(structure=function)",
            )
        if life is None and not in_contact:
            raise InvalidInputError(
                "in_contact=False begins with open contacts, and without life= none is ever "
                "approached: give life=osc.PhaseSettings() too"
            )
        chain.law_row(led=False)  # checks the arms
        self._begin(settings, laws or Laws(), StartCheck(), pack_model(settings, {}))
        memory = self._memory
        force = settings.gains.force
        memory.X_WO[:] = np.eye(4)
        memory.engaged = engaged
        contact = memory.contacts
        contact.active[:] = engaged
        contact.phase[:] = Phase.CLOSED
        contact.gain[:] = force.integral
        contact.damping[:] = force.damping
        contact.brake[:] = force.brake
        contact.least[:] = -np.inf
        contact.since[:] = np.inf
        memory.columns.closed[:] = 1
        if life is not None and not (engaged and in_contact):
            contact.phase[self._records.model.bodies.pushes != 0] = Phase.OPEN
            memory.columns.closed[:] = 0

    def _begin(self, settings: Settings, laws: Laws, start: StartCheck, model: Bytes) -> None:
        """Set settings and parts of a new controller, with the bytes of its MODEL."""
        self.__dict__.update(settings=settings, laws=laws)
        records = TickRecords(model)
        self._custom = CustomParts(settings, laws, records.model)
        self._freshness = Freshness()
        self._start = start
        self._idle = Idle()
        self._take_records(records)

    def _take_records(self, records: TickRecords) -> None:
        self._records = records
        self._memory = records.memory
        self._plan()

    def _plan(self) -> None:
        """Choose whether the next ticks are computed by one call of the law or part by part."""
        memory = self._memory
        special = self._custom.needed or not self._start.done or not memory.engaged
        self._tables = (
            self._records.rows.raw,
            memory.squeeze,
            memory.torques,
            law_rows(),
            len(memory.squeeze) == 1 and not special,
        )

    def __setattr__(self, name: str, value: object) -> None:
        if name not in _SETTABLE and not name.startswith("_"):
            raise InvalidInputError(
                f"controller.{name} is taken when a controller is made, and would be ignored "
                "afterwards. controller.with_gains(...) and controller.with_laws(...) make another "
                f"one that continues without a jump; settable are {', '.join(_SETTABLE)}"
            )
        object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        """Return a setting of the controller as an attribute."""
        if name in Settings.__dataclass_fields__ and "settings" in self.__dict__:
            return getattr(self.settings, name)
        raise AttributeError(f"'{type(self).__name__}' has no attribute '{name}'")

    # --- a tick ----------------------------------------------------------------------------------

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Compute the motor torques (n_a,) for one control period (N m, N).

        Raises only in the first tick, for arrays of wrong shapes (a programming error, not a sensor
        fault). Torques are always finite and within the limits: a tick that cannot be computed
        repeats the last torques, holds the posture or stops the arms, see `status` and `state`.
        """
        raw, squeeze, torques, call, plain = self._tables
        try:
            if (
                plain
                and measurement.touched is None
                and measurement.stamps is None
                and measurement.wrench_valid is None
                and measurement.sequence is None
                and not measurement.estimated
            ):
                squeeze[0] = reference.squeeze_d
                alpha_d = reference.alpha_d
                active = reference.active
                given = (
                    measurement.q,
                    measurement.v,
                    measurement.wrenches,
                    reference.X_WD.homogeneous,
                    reference.V_D,
                    reference.A_D,
                    alpha_d if alpha_d.size else NO_FORCES,
                    STILL,
                    UNNAMED if active is None else active,
                )
                done = call(raw, 0, given)
                return torques.copy() if done == 2 else self._end(measurement, reference)
            return self._tick(measurement, reference)
        except Exception as error:  # bad input must not end the control loop
            return self._refuse(measurement, reference, error)

    def _tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Compute a tick that needs more than one call of the law.

        Such ticks are the first ones, and those with moving bodies, time stamps, three or more
        arms, or custom code.
        """
        memory = self._memory
        if measurement.stamps is not None or measurement.sequence is not None:
            memory.repeated = self._freshness.look(measurement)
            if measurement.stamps is not None:
                memory.stamped = memory.stamped or memory.instant + 1
                late = measurement.stamps.encoders - measurement.stamps.wrists
                memory.late = min(max(0.0, late / self.dt + 0.5), HISTORY)
        given, flags = read_tick(self._records, measurement, reference)
        if not self._start.done and self._start.look(self, measurement):
            self._plan()
        error = None
        if self._custom.needed:
            error = self._custom.tick(self, measurement, reference, given, flags)
        else:
            self._records.run(given, flags)
        if not memory.engaged and self._idle.count(self.settings, reference.alpha_d):
            _log.warning("%s", self._idle.sentence(self.settings))
        return self._end(measurement, reference, error)

    def _refuse(self, measurement: Measurement, reference: Reference, error: Exception) -> Array:
        """Torques (n_a,) of a tick whose input cannot be read; `error` is that of the law."""
        if not self._memory.ticked:
            require_shapes(measurement, reference, self.settings)
        self._inputs = (measurement, reference)
        self._failure = error
        try:
            require_sizes(measurement, reference, self.settings)
        except Exception as why:  # a sentence that names the array
            self._failure = why
        return self._hold(measurement)

    def _hold(self, measurement: Measurement) -> Array:
        """Torques (n_a,) of a tick that failed outside of the law, as of one not computed."""
        n = self.chain.nq
        q, v = (read_joints(getattr(measurement, name, None), n) for name in "qv")
        self._records.hold(q, v)
        return self.last_torques()

    def _end(
        self, measurement: Measurement, reference: Reference, error: Exception | None = None
    ) -> Array:
        """Post-process a tick (pose of the object, motor limits), and return its torques.

        Args:
            measurement, reference: input of the tick. error: exception of custom code, or None.
        """
        code = int(self._memory.status)
        if code in (OK, DEGRADED):  # the law has completed the tick
            return self.last_torques()
        self._given_up = None
        self._inputs = (measurement, reference)
        self._failure = error
        if code == Status.HELD:
            if not self._memory.ticked:
                require_shapes(measurement, reference, self.settings)
            if self._records.work.reason == OBJECT_UNKNOWN and self._locate(measurement.q):
                return self.tick(replace(measurement, stamps=None, sequence=None), reference)
        elif code == Status.SATURATED:
            try:
                if self.laws.structure is not None:
                    self._given_up = scale_torques(self._records, self.chain)
                    return self.last_torques()
                if self._limits is None:
                    self._limits = MotorLimits(self.settings, self._records.model)
                relieve(self._limits.program, self._records)
            except SolverError as why:
                self._hold(measurement)
                self._failure = why
        return self.last_torques()

    def _locate(self, q: Array) -> bool:
        """Find the object's pose from the joints alone, as a start for the law; return success."""
        memory = self._memory
        if self.chain.leader is not None or memory.located == 2:  # 2: tried in this tick
            memory.located = 0
            return False
        try:
            X_WO = object_pose(self.chain, q, self.chain.model.createData())
        except OscContactError:
            return False
        memory.X_WO[:] = X_WO.homogeneous
        memory.located = 2
        return True

    def engage(self) -> None:
        """Include the contacts in the law, without a jump of the torques.

        The command of the motion integral in free space (by weight errors) is converted to a
        constant wrench, also along the contact directions (bumpless transfer). Both integrals are
        reset to zero.
        """
        if not self.engaged:
            self._require_tick()
            self._start.judge(self)
            self._plan()
            self._hand_over()
            self.force_integral = np.zeros(0)
            self.engaged = True

    # --- reports ----------------------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """Status of the last tick."""
        return _STATUS[self._memory.status]

    @property
    def reason(self) -> str:
        """Sentence on the cause of a status that is not OK, a stop or a missing contact force.

        It is empty without such a cause. In the tick that detects a sensor fault it is set already,
        although the torques of this tick are still those of the law. If a joint needs its
        mechanical brake (`unbraked`), the sentence ends with this joint.
        """
        if self.status is Status.HELD or self.state is SafetyState.SAFE_STOP:
            return explain(self._records, self.settings, *self._inputs, self._failure)
        lost = str(self.given_up or "; ".join(map(str, self.lost_directions)))
        if lost or not self._memory.ticked:
            return lost
        if not self.engaged:
            return self._idle.sentence(self.settings)
        waiting = (explained_approaches, standing_approaches)
        return "; ".join(filter(None, (why(self._records, self.settings) for why in waiting)))

    @property
    def state(self) -> SafetyState:
        """State of the controller: running, holding a posture or stopped; see `SafetyState`."""
        return _STATES[self._memory.state]

    @property
    def state_age(self) -> int:
        """Number of ticks since `state` last changed."""
        return int(self._memory.age)

    @property
    def faults(self) -> int:
        """Number of consecutive ticks, up to the last one, that could not be computed."""
        return int(self._memory.faults)

    @property
    def repeated(self) -> int:
        """Number of consecutive ticks, up to the last one, with repeated readings."""
        return self._freshness.repeated

    @property
    def unbraked(self) -> str | None:
        """Name of a joint without a sound reading, which cannot be braked reliably, or None.

        With such a joint the arms must be stopped by their mechanical brakes.
        """
        return unbraked_joint(self._records, self.settings)

    def reset(self) -> None:
        """Run again after a stop, with zero integrals; tare, bias and phases are retained."""
        memory = self._memory
        self._freshness.forget()
        if self._start.refused:
            self._start = StartCheck()
            self._plan()
        memory.state = SafetyState.RUN
        for name in FORGOTTEN:
            memory.head[name] = 0
        for table, names in FORGOTTEN_TABLES.items():
            rows = getattr(memory, table).view(np.ndarray)
            if not names:
                rows[:] = np.zeros(1, rows.dtype)
            for name in names:
                rows[name] = 0

    @property
    def given_up(self) -> LimitLoss | None:
        """Force and motion lost to motor limits in the last tick, or None."""
        if self.status is not Status.SATURATED:
            return None
        if self._given_up is None and self._limits is not None:
            self._given_up = self._limits.given_up(self._records)
        return self._given_up

    @property
    def lost_directions(self) -> tuple[LostDirection, ...]:
        """Directions in which motion commands were reduced near a singular posture."""
        if self.status is Status.HELD:
            return ()
        return self._records.lost_directions([arm.name for arm in self.chain.arms])

    @property
    def signals(self) -> Signals:
        """Signals of fig. 4 in the last computed tick.

        Raises:
            InvalidInputError: no tick has been computed.
        """
        self._require_tick()
        return Signals(self.settings, self._records)

    def result(self) -> TickResult:
        """Numbers of the last tick for recordings, which the next tick overwrites.

        Raises:
            InvalidInputError: no tick has been computed.
        """
        self._require_tick()
        if self._result is None or self._result.records is not self._records:
            self._result = TickResult(self._records)
        return self._result

    def _require_tick(self) -> None:
        if not self._memory.ticked:
            raise InvalidInputError(
                "no tick has been computed yet; call tick first"
                + (f" (the last one was held: {self.reason})" if self.status else "")
            )

    def last_torques(self) -> Array:
        """Motor torques (n_a,) of the last tick (N m, N)."""
        return self._memory.torques.copy()

    def joint_acceleration(self) -> Array:
        """Acceleration (n,) of all joints commanded by the last tick, q̈ = W η̇_c + w."""
        return np.array(self._records.work.joints.acceleration)

    def residual_wrench(self) -> Array:
        """(6,) wrist reading of the last tick minus what the model predicts at rest, untared.

        Its mean at rest without contact is the tare, to be stored in `f_tare`: weight errors
        cannot be distinguished from contact forces once contact is made.
        """
        result = self.result()
        return result.f_meas + self.f_tare - result.bias_out

    def phases(self) -> Array:
        """Phase (contacts,) of each contact in the last tick: open 0, approaching 1, closed 2."""
        contacts = self._memory.contacts
        phase = contacts.phase if self.life is not None else Phase.CLOSED
        return np.where(contacts.active != 0, phase, Phase.OPEN).astype(np.int64)

    @property
    def active(self) -> npt.NDArray[np.bool_]:
        """Mask (contacts,) of the contacts active in the last tick: approaching or closed, in N."""
        return np.array(self._memory.contacts.active != 0)

    f_tare = _six_numbers(
        "f_tare", "(6,) constant error of the wrist readings at O (N, N m), removed from each."
    )

    @property
    def joint_friction(self) -> Array:
        """Identified friction (n, 2) of the joints: Coulomb (N m; N), viscous (N m s/rad; N s/m).

        The columns are arguments of `Arm`, friction and damping, for the start of another session.
        """
        model = self.chain.model
        known = np.column_stack([model.upperDryFrictionLimit, model.damping])
        memory = self._memory
        learned = memory.friction_known != 0
        return np.where(learned[:, None], memory.friction.theta[:, :2], known)

    @property
    def missing_inertia(self) -> Array:
        """Identified inertia (n,) of the joints' rotors that the model lacks (kg m²; kg).

        It is negative if the model overestimates the inertia.
        """
        return np.array(self._memory.friction.theta[:, 2])

    @property
    def learned_friction(self) -> tuple[LearnedFriction, ...]:
        """Identified friction of the joints of each arm, with the identity of its robot.

        `LearnedFriction.save` and `load` store it in files; `put_on` adds it to the model of an
        arm.
        """
        found = []
        for arm, s in zip(self.chain.arms, self.chain.slices, strict=True):
            friction, damping = self.joint_friction[s].T
            found.append(
                LearnedFriction(
                    robot=robot_identity(arm.model),
                    joints=tuple(joint_names(arm.model)),
                    friction=tuple(friction.tolist()),
                    damping=tuple(damping.tolist()),
                    missing_inertia=tuple(self.missing_inertia[s].tolist()),
                )
            )
        return tuple(found)

    @property
    def normal_covariance(self) -> Array:
        """Covariance (r, 3, 3) of the estimated normal of each force magnitude (rad²).

        It is in the axes of the body that carries the normal; for crossed edges it is the variance
        of the body's edge along the normal. NaN: not estimated, or the contact is open.
        """
        P = np.array(self._memory.columns.covariance).reshape(-1, 3, 3)
        return np.where((self.normal_std > 0.0)[:, None, None], P, np.nan)

    @property
    def normal_std(self) -> Array:
        """Largest standard deviation (r,) of the estimated normals (rad); 0: not estimated."""
        return np.array(self._memory.columns.normal_std)

    f_bias = _six_numbers("f_bias", "(6,) constant wrench added to the command at O (N, N m).")

    @property
    def engaged(self) -> bool:
        """Whether the law includes the contacts; False: the object is controlled as free."""
        return bool(self._memory.engaged)

    @engaged.setter
    def engaged(self, engaged: bool) -> None:
        self._memory.engaged = engaged
        self._idle = Idle()
        self._plan()
        if self.life is None or not engaged:
            self._memory.contacts.active[:] = engaged

    motion_integral = _six_numbers("motion_sum", "(6,) ∫e dt of the motion law (m s, rad s).")

    @property
    def force_integral(self) -> Array:
        """Integral (r,) of the force law, K_i ∫(α_d − α_meas) dt (N)."""
        memory = self._memory
        return np.array(memory.force_sum[: int(memory.force_rank)])

    @force_integral.setter
    def force_integral(self, value: Array) -> None:
        memory = self._memory
        value = as_array("force integral", value, (None,))
        if len(value) > 6:
            raise InvalidInputError(f"force integral: {len(value)} values; N has 6 columns at most")
        memory.force_sum[: len(value)] = value
        memory.force_rank = len(value)
        memory.by_column = 0
        kept = self._records.kept()
        memory.columns.integral[:] = 0.0
        memory.columns.integral[kept] = value if len(value) == len(kept) else 0.0

    # --- copies -----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all numbers of this controller to a file, for C programs.

        Raises:
            InvalidInputError: pairs, bodies or laws of the controller can be evaluated by Python
                only.
        """
        write_whole(controller_bytes(self), path)

    def with_gains(self, gains: Gains) -> Self:
        """Another controller with new gains that continues with the present state (bumpless).

        The force integral, which is a force, does not change. The command of the motion integral
        does not change either: ∫e is scaled by the ratio of the old gain to the new one, or the
        command is added to `f_bias` if the new gain is 0.
        """
        settings = replace(self.settings, gains=gains)
        other = self._another(settings, self.laws)
        memory = other._memory
        model = other._records.model
        pack_gains(settings, model)
        before = self.gains.motion.integral
        after = gains.motion.integral
        if after > 0.0:
            memory.motion_sum *= before / after
        elif memory.ticked:
            other._records.work_bytes[:] = self._records.work_bytes
            model.integral = before
            other._hand_over()
            model.integral = 0.0
        if settings.life is None:
            memory.contacts.gain[:] = gains.force.integral
            memory.contacts.damping[:] = gains.force.damping
            memory.contacts.brake[:] = gains.force.brake
        return other

    def with_safety(self, safety: SafetySettings) -> Self:
        """Another controller with new limits of the robot that continues with the present state."""
        settings = replace(self.settings, safety=safety)
        other = self._another(settings, self.laws)
        pack_safety(settings, other._records.model)
        return other

    def with_laws(self, **laws: Callable[..., Any] | None) -> Self:
        """Another controller with custom laws (`Laws`) that continues with the present state."""
        return self._another(self.settings, replace(self.laws, **laws))

    def _another(self, settings: Settings, laws: Laws) -> Self:
        other = type(self).__new__(type(self))
        other._begin(settings, laws, deepcopy(self._start), self._records.model_bytes)
        other._records.memory_bytes[:] = self._records.memory_bytes
        other._memory.status = Status.OK
        other._plan()
        return other

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return copy(self)  # shares the immutable settings and laws

    def __getstate__(self) -> dict[str, Any]:
        r = self._records
        failure = None if self._failure is None else OscContactError(str(self._failure))
        return {
            "parts": (self.settings, self.laws, deepcopy(self._start)),
            "columns": self._custom.columns(r.model),
            "bytes": (r.memory_bytes, r.work_bytes),
            "ended": {"_given_up": self.given_up, "_inputs": self._inputs, "_failure": failure},
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        settings, laws, start = state["parts"]
        self._begin(settings, laws, start, pack_model(settings, state["columns"]))
        self._records.memory_bytes[:], self._records.work_bytes[:] = state["bytes"]
        self._plan()
        self.__dict__.update(state["ended"])

    def _hand_over(self) -> None:
        zeros = np.zeros(self.chain.nq)
        self._records.hold(zeros, zeros, reading=0.0, begin=HAND_OVER)
