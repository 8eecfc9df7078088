"""The decoupled force/motion controller, fig. 4: one row of the law's tables, and its status."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.controller_copies import ControllerCopies
from osc_contact.control.freshness import Freshness
from osc_contact.control.laws import Laws
from osc_contact.control.loops import ForceLoop, MotionLoop, refuse
from osc_contact.control.outside import Outside
from osc_contact.control.phases import Phase
from osc_contact.control.reading import Reading
from osc_contact.control.reasons import (
    convert_arrays,
    converting,
    read_joints,
    require_shapes,
    require_sizes,
)
from osc_contact.control.reports import Status
from osc_contact.control.settings import Settings
from osc_contact.control.signals import Block, Signals
from osc_contact.control.start_check import StartCheck
from osc_contact.control.tick_records import TickRecords
from osc_contact.control.torque_limits import MotorLimits, scale_torques
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.rail import Body
from osc_contact.errors import InvalidInputError, OscContactError, SensorTimeout, SolverError
from osc_contact.interface import Measurement, Reference, Touched
from osc_contact.law import tick as law
from osc_contact.law.compiled import rows
from osc_contact.law.tables import DEGRADED, JOINTS, OBJECT_UNKNOWN, WRISTS
from osc_contact.scenarios.control_schema import (
    Friction,
    Gains,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.spatial import Array

__all__ = ["Block", "Controller", "Signals", "Status"]

_SETTABLE = ("f_tare", "f_bias", "engaged", "motion_law.integral", "force_law.integral")


class Controller(ControllerCopies):
    """Dynamically decoupled force/motion control of one held object (fig. 4).

    Everything is taken at construction and stays: `with_gains` and `with_laws` make another
    controller that goes on from where this one is. Controllers share nothing that changes, can be
    copied, pickled, and each used in a thread of its own.

    Attributes:
        chain, contacts, gains, dt, B, bodies, posture, friction, life: as given.
        reading: as given, or as chosen.
        f_tare: (6,) constant error of the wrist readings at O, removed from each.
        f_bias: (6,) constant wrench added to the command, learnt before contact.
        engaged: whether the contacts are part of the model; False treats the object as free.
        motion_law, force_law: gains and integrals of the two loops.
    """

    _converting: bool  #: arrays of other types came: the law's call converts
    _freshness: Freshness
    _rows: Any

    def __init__(
        self,
        chain: ClosedChain,
        contacts: Sequence[ContactPair],
        gains: Gains | None = None,
        *,
        dt: float = 1e-3,
        B: Array | str = "object",
        bodies: Sequence[Body | None] | None = None,
        posture: Array | None = None,
        engaged: bool = True,
        friction: Friction | None = None,
        reading: Reading | None = None,
        life: PhaseSettings | None = None,
        laws: Laws | None = None,
        posture_task: PostureTask | None = None,
        safety: SafetySettings | None = None,
        joint_friction: bool = True,
    ) -> None:
        """Assemble the loops.

        Args:
            chain: model of arms and object.
            contacts: pairs in the order of alpha_d.
            gains: of both loops.
            dt: control period (s).
            B: metric of the motion filter Ω_m(B), eq. 24: "object" (Λ_o⁻¹), "chain"
                ((ΣΛ_i + Λ_o)⁻¹ within the chain's motions) or a positive definite (6, 6).
            bodies: how the body at each contact answers forces; None: it does not, though it may
                be seen to move. The same object twice: both contacts are on one body.
            posture: (n,) where redundant arms return to (default: neutral). A goal, which may lie
                somewhat outside the joints' limits: the posture task keeps the joints inside.
            engaged: start in contact.
            friction: what is believed of the contacts' friction; None: nothing.
            reading: how contact forces are read off the wrists, 'filter' (fig. 5) or
                'least_squares', which friction and tilted faces do not fool; None: the latter
                where its answer is unique (see `control.reading`).
            life: opens, approaches and closes the contacts one by one; None: all of them are
                closed as long as they are engaged.
            laws: of the user's own, in place of force law, motion law or control structure.
            posture_task: what redundant arms do with joints they do not need.
            safety: when ticks that cannot be computed end in a hold, and in a stop.
            joint_friction: whether to make up for the friction and damping of the joints that the
                model names.

        Raises:
            InvalidInputError: dt not positive, unknown metric, or an arm without a wrist sensor
                although there are contacts: their forces could not be measured.
            ModelError: an arm that the law cannot take.
        """
        self._begin(
            Settings(
                chain,
                tuple(contacts),
                Gains() if gains is None else gains,
                dt,
                B,
                () if bodies is None else tuple(bodies),
                np.zeros(0) if posture is None else posture,
                PostureTask() if posture_task is None else posture_task,
                friction,
                life,
                SafetySettings() if safety is None else safety,
                joint_friction,
                reading,
            ),
            Laws() if laws is None else laws,
        )
        chain.law_row(led=False)  # judges the arms
        memory, contacts_memory = self._records.memory, self._records.contacts
        self._reset_contacts()
        memory.X_WO[:] = np.eye(4)
        memory.engaged = engaged
        if not engaged:
            contacts_memory.active[:] = 0
            if life is not None:
                pushes = self._records.row.head.bodies.pushes
                contacts_memory.phase[:] = np.where(pushes, Phase.OPEN, Phase.CLOSED)
                self._records.column_memory.closed[:] = 0

    def _begin(
        self,
        settings: Settings,
        laws: Laws,
        records: TickRecords | None = None,
        outside: Outside | None = None,
    ) -> None:
        if outside is None:
            outside = Outside(settings, laws)
        if records is None:
            records = TickRecords(outside.row)
        self.__dict__.update(
            settings=settings, laws=laws, _outside=outside,
            _rows=rows(), _still=np.zeros((0, 28)),
            _moving=np.zeros((len(settings.contacts), 28)),
            _arms=len(settings.chain.arms), _in_parts=outside.needed,
            _limits=None, _given_up=None, _failure=None, _inputs=None, _result=None,
            _converting=False, _freshness=Freshness(settings.dt, settings.safety.wrench_timeout),
            _start=StartCheck(), _starting=True,
            motion_law=MotionLoop(settings.gains.motion, settings.dt, records.memory),
            force_law=ForceLoop(settings.gains.force, settings.dt, records.memory),
        )  # fmt: skip
        self._take_records(records)

    def _begin_start(self, start: StartCheck, starting: bool) -> None:
        """Look at joints and wrists in the ticks to come, or look no more."""
        self._start, self._starting = start, starting
        self._take_records(self._records)

    def _take_records(self, records: TickRecords) -> None:
        self._records = records
        self.motion_law._memory = self.force_law._memory = records.memory
        self._codes, self._squeeze = records.status, records.squeeze
        self._tables = (
            records.rows.raw, records.squeeze, records.torques, self._still, self._rows,
            self._arms < 3 and not self._in_parts and not self._starting,
        )  # fmt: skip

    # --- what it is made of ----------------------------------------------------------------------

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _SETTABLE and not name.startswith("_"):
            raise refuse("controller", name, _SETTABLE)
        object.__setattr__(self, name, value)

    # --- a tick ----------------------------------------------------------------------------------

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Motor torques (n_a,) for one control period.

        Never raises on bad data, but for the first tick, which refuses arrays of wrong shapes: that
        is no fault of a sensor. Never returns a torque that is not finite or exceeds a limit: a
        tick that cannot be computed repeats the last good torques, see `status`.
        """
        raw, squeeze, torques, still, call, plain = self._tables
        try:
            if (
                plain and measurement.touched is None and measurement.stamps is None
                and measurement.wrench_valid is None and measurement.sequence is None
                and not measurement.estimated
            ):  # fmt: skip
                squeeze[0] = reference.squeeze_d
                done = call(
                    raw, 0, measurement.q, measurement.v, measurement.wrenches,
                    reference.X_WD.homogeneous, reference.V_D, reference.A_D, reference.alpha_d,
                    still,
                )  # fmt: skip
                return torques.copy() if done == 2 else self._end(measurement, reference)
            return self._tick(measurement, reference)
        except Exception as error:  # nothing that comes in may end the control loop
            return self._convert(measurement, reference, error)

    def _tick(self, measurement: Measurement, reference: Reference) -> Array:
        """At the start; with bodies that move, stamps, three arms, or code of the user's."""
        if measurement.stamps is not None or measurement.sequence is not None:
            self._records.memory.repeated = self._freshness.require(measurement)
        if measurement.estimated:
            self._records.memory.derived = 1
        if self._converting and self._in_parts:  # code of the user's takes arrays
            measurement, reference = convert_arrays(measurement, reference)
        if self._starting and self._start.is_done(self, measurement):
            self._begin_start(self._start, False)
        if measurement.wrench_valid is not None and not measurement.wrench_valid:
            self._records.memory.wrench_missing = 1
        touched, flags, table = measurement.touched, 0, self._still
        if touched is not None:
            table, flags = self._motions(touched), law.MOVING
        if self._arms < 3:
            self._squeeze[0] = reference.squeeze_d
        else:
            flags |= self._bar_forces(reference.squeeze_d)
        args = (
            measurement.q, measurement.v, measurement.wrenches, reference.X_WD.homogeneous,
            reference.V_D, reference.A_D, reference.alpha_d, table,
        )  # fmt: skip
        error = None
        if self._in_parts:
            error = self._outside.tick(self, measurement, reference, args, flags)
        elif self._run(args, flags) == 2:
            return self.last_torques()
        return self._end(measurement, reference, error)

    def _run(
        self, args: tuple[Any, ...], flags: int = 0, begin: int = law.LOOK, stop: int = law.END
    ) -> int:
        """Parts of a tick, which the law's call returns the end of."""
        raw, job = self._records.rows.raw, self._records.job
        if not flags and begin == law.LOOK and stop == law.END:
            return int(self._rows(raw, 0, *args))
        job[0], job[1], job[2] = flags, begin, stop
        try:
            return int(self._rows(raw, 0, *args))
        finally:
            job[0], job[1], job[2] = 0, law.LOOK, law.END

    def _convert(self, measurement: Measurement, reference: Reference, error: Exception) -> Array:
        """A tick whose arrays are of other types, or one to be held.

        That such arrays come is found out once: from then on every call of the law makes them what
        it takes. numba's refusal costs as much as many ticks.
        """
        try:
            if isinstance(error, SensorTimeout):
                raise error
            require_sizes(measurement, reference, self.settings)
            if self._converting:
                raise error
            self._rows = converting(self._rows, self.chain.nq, self._arms)
            self._converting = True
            self._take_records(self._records)
            return self.tick(replace(measurement, stamps=None, sequence=None), reference)
        except Exception as why:
            if isinstance(why, SensorTimeout):
                self._records.memory.repeated = JOINTS | WRISTS
            if not self._records.memory.ticked:
                require_shapes(measurement, reference, self.settings)
            self._inputs, self._failure = (measurement, reference), why
            return self._hold(measurement)

    def _hold(self, measurement: Measurement) -> Array:
        """Torques (n_a,) of a tick that failed outside of the law: one that is not computed."""
        n, six = self.chain.nq, np.zeros(6)
        q, v = (read_joints(getattr(measurement, name, None), n) for name in "qv")
        wrenches = np.full((self._arms, 6), np.nan)
        self._run((q, v, wrenches, np.eye(4), six, six, np.zeros(0), self._still))
        return self.last_torques()

    def _end(
        self,
        measurement: Measurement,
        reference: Reference,
        error: Exception | None = None,
    ) -> Array:
        """What is left to do after a tick that did not end OK; `error`: raised outside the law."""
        code = int(self._codes[0])
        if code == DEGRADED:  # the law did it all, and nothing of the controller's has changed
            return self.last_torques()
        self._given_up = None
        self._inputs, self._failure = (measurement, reference), error
        if code == Status.HELD:
            if not self._records.memory.ticked:
                require_shapes(measurement, reference, self.settings)
            work = self._records.work
            if work.reason == OBJECT_UNKNOWN and self._locate(measurement.q):
                return self.tick(replace(measurement, stamps=None, sequence=None), reference)
        elif code == Status.SATURATED:
            try:
                if self.laws.structure is not None:
                    self._given_up = scale_torques(self._records, self.chain)
                    return self.last_torques()
                if self._limits is None:
                    self._limits = MotorLimits(self.settings, self._records.row)
                self._limits.relieve(self._records)
            except SolverError as why:
                self._hold(measurement)
                self._failure = why
        return self.last_torques()

    def _motions(self, touched: Touched) -> Array:
        table, count = self._moving, len(self._moving)
        if len(touched.X_WE) != count or len(touched.V_E) != count or len(touched.A_E) != count:
            raise InvalidInputError(f"touched: {len(touched.X_WE)} motions for {count} contacts")
        table[:, :16] = np.reshape(touched.X_WE, (count, 16))
        table[:, 16:22], table[:, 22:] = touched.V_E, touched.A_E
        return table

    def _bar_forces(self, squeeze_d: float | Array) -> int:
        """Internal forces of three arms and more; the number 0 leaves them at least effort."""
        self._squeeze[:] = squeeze_d
        return 0 if np.ndim(squeeze_d) == 0 and squeeze_d == 0.0 else law.COMMANDED

    def _locate(self, q: Array) -> bool:
        """Find the object from the joints alone; from then on the law does, tick by tick."""
        import pinocchio as pin

        chain = self.chain
        memory = self._records.memory
        if chain.leader is not None or memory.located == 2:  # 2: tried at this tick already
            memory.located = 0
            return False
        data = chain.model.createData()
        pin.forwardKinematics(chain.model, data, q)
        try:
            X_WO = chain.object_pose(data)
        except OscContactError:
            return False
        memory.X_WO[:], memory.located = X_WO.homogeneous, 2
        return True

    def engage(self) -> None:
        """Take the contacts into the model, without a jump.

        What the motion integral has learnt in free space (weight errors, as a force) goes on as a
        constant wrench, in the contact directions too; the integrators start again from zero.
        """
        if not self.engaged:
            self._require_tick()
            self._start.judge(self)
            self._begin_start(self._start, self._starting or bool(self._start.refused))
            self._hand_over()
            self.force_law.integral = np.zeros(0)
            self.engaged = True

    def _reset_contacts(self) -> None:
        """All contacts closed, their terms those of the force law."""
        contacts, gains = self._records.contacts, self.gains.force
        contacts.active[:], contacts.phase[:] = 1, Phase.CLOSED
        contacts.gain[:], contacts.damping[:] = gains.integral, gains.damping
        contacts.brake[:] = gains.brake
        contacts.least[:] = -np.inf
        contacts.since[:] = np.inf  # as if for ever
        self._records.column_memory.closed[:] = 1
