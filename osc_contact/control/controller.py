"""Decoupled force/motion controller, fig. 4: tick, state, reports and copies."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.controller_settings import Reading, Settings
from osc_contact.control.controller_state import ControllerState
from osc_contact.control.custom_laws import CustomParts, Laws, TickParts
from osc_contact.control.ending import TickEnd
from osc_contact.control.inputs import (
    Freshness,
    read_joints,
    read_tick,
    require_shapes,
    require_sizes,
)
from osc_contact.control.packing import pack_gains, pack_model, pack_safety
from osc_contact.control.records import TickRecords
from osc_contact.control.saving import controller_bytes
from osc_contact.control.start_check import StartCheck
from osc_contact.control.status import Phase, SafetyState, Status
from osc_contact.control.waiting import Idle
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Body
from osc_contact.errors import InvalidInputError, OscContactError, SolverError, require_kind
from osc_contact.files import write_whole
from osc_contact.interface import Measurement, Reference
from osc_contact.law.chain import OBJECT_UNKNOWN
from osc_contact.law.records import DEGRADED, HAND_OVER, HISTORY, HOPPING, OK, Bytes
from osc_contact.settings.control import (
    Friction,
    JointFriction,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.settings.gains import Gains
from osc_contact.spatial import Array

_log = logging.getLogger(__name__)
_SETTABLE = ("f_tare", "f_bias", "engaged", "motion_integral", "force_integral")


class Controller(ControllerState):
    """Dynamically decoupled force/motion control of one held object (fig. 4).

    Settings are fixed at construction; `with_gains`, `with_safety` and `with_laws` make another
    controller that continues with the present state. Controllers share no mutable state: they can
    be copied, pickled, and used in separate threads.

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

    Attributes:
        settings: all settings.
        laws: custom laws.
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

    # single settings, which `__getattr__` reads from `settings`
    chain: ClosedChain
    gains: Gains
    dt: float
    life: PhaseSettings | None
    laws: Laws
    start: StartCheck

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
        """Check the arguments, which the class's docstring describes, and zero all integrals.

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
        _require_beginning(laws, life, in_contact=in_contact)
        chain.law_row(from_leader=False)  # raises ModelError for arms that the law does not support
        self._initialise(settings, laws or Laws(), StartCheck(), pack_model(settings, {}))
        self._begin_contacts(engaged=engaged, in_contact=in_contact)

    def _begin_contacts(self, *, engaged: bool, in_contact: bool) -> None:
        """Set phases, gains and flags of the contacts in a new MEMORY.

        Args:
            engaged: True if the law includes the contacts from the first tick on.
            in_contact: False if the object begins in the air, with contacts that push not made.
                With contact phases such contacts are OPEN unless both are True.
        """
        memory = self.records.memory
        life = self.settings.life
        force = self.settings.gains.force
        memory.X_WO[:] = np.eye(4)
        memory.engaged = engaged
        self.idle.begin(waiting=not engaged)
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
            contact.phase[self.records.model.bodies.pushes != 0] = Phase.OPEN
            memory.columns.closed[:] = 0

    def _initialise(self, settings: Settings, laws: Laws, start: StartCheck, model: Bytes) -> None:
        """Set the attributes of a new controller, with a MEMORY of zeros.

        Args:
            settings: settings of the controller.
            laws: custom laws.
            start: check of the first ticks.
            model: bytes of MODEL, packed from the settings.
        """
        records = TickRecords(model)
        self.__dict__.update(
            settings=settings,
            laws=laws,
            records=records,
            custom=CustomParts(settings, laws, records.model),
            start=start,
            ended=TickEnd(),
            freshness=Freshness(),
            idle=Idle(waiting=False),
        )

    def _replace_records(self, records: TickRecords) -> None:
        """Use new records, in which a custom pair has another number of columns of N."""
        self.__dict__["records"] = records
        self.ended.forget_limits()

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute that may change after construction.

        Args:
            name: name in `_SETTABLE`, or a private name.
            value: value of the attribute.

        Raises:
            InvalidInputError: the attribute is fixed at construction.
        """
        if name not in _SETTABLE and not name.startswith("_"):
            raise InvalidInputError(
                f"controller.{name} is taken when a controller is made, and would be ignored "
                "afterwards. controller.with_gains(...) and controller.with_laws(...) make another "
                f"one that continues without a jump; settable are {', '.join(_SETTABLE)}"
            )
        object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        """Return a setting of `Settings` as an attribute of the controller."""
        if name in Settings.__dataclass_fields__ and "settings" in self.__dict__:
            return getattr(self.settings, name)
        raise AttributeError(f"'{type(self).__name__}' has no attribute '{name}'")

    # --- a tick ----------------------------------------------------------------------------------

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Compute the motor torques (n_a,) for one control period (N m, N).

        Raises only in the first tick, for arrays of wrong shapes (a programming error, not a sensor
        fault). Torques are always finite and within the limits: a tick that cannot be computed
        repeats the last torques, holds the posture or stops the arms, see `status` and `state`.

        Args:
            measurement: sensor readings of this tick.
            reference: commanded motion and forces of this tick.
        """
        try:
            if measurement.stamps is not None or measurement.sequence is not None:
                self._note_stamps(measurement)
            inputs, switches = read_tick(self.records, measurement, reference)
            if not self.start.done:
                self.start.look(self, measurement)
            error = None
            if self.custom.needed:
                parts = TickParts(self.records, inputs, switches)
                error = self.custom.tick(parts, measurement, reference, self._replace_records)
                if error is not None:
                    self._hold_arms(measurement)
            elif self.records.tick(inputs, switches) and not self.idle.waiting:
                return self.records.torques.copy()
            return self._complete_tick(measurement, reference, error)
        except Exception as error:  # no input may end the control loop
            return self._refuse_inputs(measurement, reference, error)

    def _note_stamps(self, measurement: Measurement) -> None:
        """Compare the stamps and the sequence number of a measurement with those before it.

        Fills `repeated` (readings that are not new), `stamped` and `late` (ticks by which the wrist
        readings are older than those of the encoders) of MEMORY.
        """
        memory = self.records.memory
        memory.repeated = self.freshness.compare(measurement)
        if measurement.stamps is not None:
            memory.stamped = memory.stamped or memory.instant + 1
            # rounded to whole ticks by the 0.5, as the field is a whole number
            late = measurement.stamps.encoders - measurement.stamps.wrists
            memory.late = min(max(0.0, late / self.dt + 0.5), HISTORY)

    def _refuse_inputs(
        self, measurement: Measurement, reference: Reference, error: Exception
    ) -> Array:
        """Compute the torques (n_a,) of a tick with unusable inputs by the safety layer (N m, N).

        Args:
            measurement, reference: inputs of the tick.
            error: exception that they raised.

        Raises:
            InvalidInputError: in the first tick, for arrays of wrong shapes.
        """
        if not self.records.memory.ticked:
            require_shapes(measurement, reference, self.settings)
        try:
            require_sizes(measurement, reference, self.settings)
        except Exception as size_error:  # its message names the input, unlike that of `error`
            error = size_error
        self.ended.note(measurement, reference, error)
        return self._hold_arms(measurement)

    def _hold_arms(self, measurement: Measurement) -> Array:
        """Compute the torques (n_a,) of a tick that failed outside of the law (N m, N).

        The law runs with wrenches of NaN, so that it ends the tick HELD: repeated torques, or a
        hold or stop by the joint readings, as far as these can be read.

        Args:
            measurement: readings of the tick, which may be unusable.
        """
        n = self.chain.nq
        q, v = (read_joints(getattr(measurement, name, None), n) for name in "qv")
        self.records.hold(q, v)
        return self.last_torques()

    def _complete_tick(
        self, measurement: Measurement, reference: Reference, error: Exception | None
    ) -> Array:
        """Complete a tick of the law according to its status; return its torques (n_a,) (N m, N).

        SATURATED: the torques are brought within the motor limits. HELD because the object's pose
        is unknown: it is computed from the joints, and the tick is repeated.

        Args:
            measurement, reference: inputs of the tick.
            error: exception of custom code in this tick, or None.

        Raises:
            InvalidInputError: in the first tick, for arrays of wrong shapes.
        """
        if self.idle.waiting and self.idle.count(self.settings, reference.alpha_d):
            _log.warning("%s", self.idle.sentence(self.settings))
        code = int(self.records.memory.status)
        if code in (OK, DEGRADED, HOPPING):  # the torques of the law are final
            return self.last_torques()
        self.ended.note(measurement, reference, error)
        if code == Status.HELD:
            if not self.records.memory.ticked:
                require_shapes(measurement, reference, self.settings)
            if self.records.work.reason == OBJECT_UNKNOWN and self._locate_object(measurement.q):
                return self.tick(replace(measurement, stamps=None, sequence=None), reference)
        elif code == Status.SATURATED:
            try:
                self.ended.limit_torques(
                    self.records, self.settings, custom_structure=self.laws.structure is not None
                )
            except SolverError as solver_error:
                self._hold_arms(measurement)
                self.ended.failure = solver_error
        return self.last_torques()

    def _locate_object(self, q: Array) -> bool:
        """Compute the object's pose from the joints, as an initial pose for the law.

        Args:
            q: (n,) joint positions (rad, m).

        Returns:
            True if X_WO and `located` of MEMORY were filled; False if an arm holds the object
            rigidly, the pose was computed in this tick before, or cannot be found.
        """
        memory = self.records.memory
        # 2: computed in this tick, which was repeated with it in vain
        if self.chain.leader is not None or memory.located == 2:
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
            self.require_tick()
            self.start.judge(self)
            self._hand_over()
            self.force_integral = np.zeros(0)
            self.engaged = True

    def reset(self) -> None:
        """Run again after a stop, with zero integrals; tare, bias and phases are retained."""
        self.freshness.forget()
        if self.start.refused:
            self.__dict__["start"] = StartCheck()
        self.records.memory.state = SafetyState.RUN
        self.records.forget()

    # --- copies -----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all numbers of this controller to a file, for C programs.

        Raises:
            InvalidInputError: pairs, bodies or laws of the controller can be evaluated by Python
                only.
        """
        write_whole(controller_bytes(self), path)

    def with_gains(self, gains: Gains) -> Self:
        """Make a controller with new gains that continues with the present state (bumpless).

        The force integral, which is a force, does not change. The command of the motion integral
        does not change either: ∫e is scaled by the ratio of the old gain to the new one, or the
        command is added to `f_bias` if the new gain is 0.

        Args:
            gains: gains of both loops.
        """
        settings = replace(self.settings, gains=gains)
        other = self._copy_with(settings, self.laws)
        memory = other.records.memory
        model = other.records.model
        pack_gains(settings, model)
        before = self.gains.motion.integral
        after = gains.motion.integral
        if after > 0.0:
            memory.motion_sum *= before / after
        elif memory.ticked:
            other.records.work_bytes[:] = self.records.work_bytes
            model.integral = before
            other._hand_over()
            model.integral = 0.0
        if settings.life is None:
            memory.contacts.gain[:] = gains.force.integral
            memory.contacts.damping[:] = gains.force.damping
            memory.contacts.brake[:] = gains.force.brake
        return other

    def with_safety(self, safety: SafetySettings) -> Self:
        """Make a controller with new safety limits that continues with the present state.

        Args:
            safety: limits of the robot, and conditions of a hold and a stop.
        """
        settings = replace(self.settings, safety=safety)
        other = self._copy_with(settings, self.laws)
        pack_safety(settings, other.records.model)
        return other

    def with_laws(self, **laws: Callable[..., Any] | None) -> Self:
        """Make a controller with custom laws that continues with the present state.

        Args:
            **laws: fields of `Laws` to change: force, motion or structure, a function or None.
        """
        return self._copy_with(self.settings, replace(self.laws, **laws))

    def _copy_with(self, settings: Settings, laws: Laws) -> Self:
        """Copy the controller with changed settings and laws; the copy continues from its memory.

        MODEL is copied, too; the caller packs changed settings into it.

        Args:
            settings: settings of the copy.
            laws: laws of the copy.
        """
        duplicate = type(self).__new__(type(self))
        duplicate._initialise(settings, laws, deepcopy(self.start), self.records.model_bytes)
        duplicate.records.memory_bytes[:] = self.records.memory_bytes
        duplicate.records.memory.status = Status.OK
        duplicate.idle.begin(waiting=not duplicate.engaged)
        return duplicate

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Copy the records; settings and laws are immutable and shared with the copy."""
        return copy(self)

    def __getstate__(self) -> dict[str, Any]:
        """State for `pickle` and `copy`: settings, laws, and bytes of the records."""
        records = self.records
        return {
            "parts": (self.settings, self.laws, deepcopy(self.start)),
            "columns": self.custom.columns(records.model),
            "bytes": (records.memory_bytes, records.work_bytes),
            "ended": self.ended.lasting(self.given_up),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a controller from its state: pack its model anew, and copy its records.

        Args:
            state: from `__getstate__`: "parts" (settings, laws, check of the start), "columns"
                (number of columns of N of each custom pair), "bytes" (of MEMORY and WORK) and
                "ended" (end of the last tick).
        """
        settings, laws, start = state["parts"]
        self._initialise(settings, laws, start, pack_model(settings, state["columns"]))
        self.records.memory_bytes[:], self.records.work_bytes[:] = state["bytes"]
        self.__dict__["ended"] = state["ended"]
        self.idle.begin(waiting=not self.engaged)

    def _hand_over(self) -> None:
        """Convert the command of the motion integral to the constant wrench `f_bias` of MEMORY.

        Runs part HAND_OVER of the law, which reads WORK of the last tick and no measurement: the
        positions and readings given to it are zeros that it does not use.
        """
        zeros = np.zeros(self.chain.nq)
        self.records.hold(zeros, zeros, reading=0.0, begin=HAND_OVER)


def _require_beginning(laws: Laws | None, life: PhaseSettings | None, *, in_contact: bool) -> None:
    """Refuse custom laws of another class, and open contacts that would never be approached.

    Args:
        laws: custom laws, or None.
        life: settings of the contact phases, or None.
        in_contact: False if contacts that push are open at the start.

    Raises:
        InvalidInputError: one of these.
    """
    if laws is not None:
        require_kind(
            "laws=",
            laws,
            Laws,
            "osc.Laws(force=function), osc.Laws(motion=function) or osc.Laws(structure=function)",
        )
    if life is None and not in_contact:
        raise InvalidInputError(
            "in_contact=False begins with open contacts, and without life= none is ever "
            "approached: give life=osc.PhaseSettings() too"
        )
