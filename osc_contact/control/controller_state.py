"""What a controller remembers, and what its last tick said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from osc_contact.control.freshness import Freshness
from osc_contact.control.laws import Laws
from osc_contact.control.loops import ForceLoop, MotionLoop
from osc_contact.control.phases import Phase
from osc_contact.control.reasons import explain
from osc_contact.control.reports import LimitLoss, LostDirection, Status
from osc_contact.control.result import TickResult
from osc_contact.control.safety import SafetyState
from osc_contact.control.settings import Settings
from osc_contact.control.signals import BLOCKS, Block, Signals
from osc_contact.control.start_check import StartCheck
from osc_contact.control.tick_records import TickRecords
from osc_contact.control.torque_limits import MotorLimits
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.law.tables import SATURATED
from osc_contact.spatial import Array, as_array

__all__ = ["ControllerState"]

_STATUS = tuple(Status)
_STATES = tuple(SafetyState)


class ControllerState:
    """The readable side of `Controller`: everything here comes from its settings and records."""

    settings: Settings
    laws: Laws
    motion_law: MotionLoop
    force_law: ForceLoop
    _records: TickRecords
    _arms: int
    _codes: Array
    _squeeze: Array
    _freshness: Freshness
    _start: StartCheck
    _starting: bool
    _begin_start: Callable[[StartCheck, bool], None]
    _limits: MotorLimits | None
    _given_up: LimitLoss | None
    _failure: Exception | None
    _inputs: tuple[Measurement, Reference]

    def __getattr__(self, name: str) -> Any:
        settings = self.__dict__.get("settings")
        if settings is not None and name in ("chain", "contacts", "gains", "dt", "B", "bodies",
                                             "posture", "friction", "reading"):  # fmt: skip
            return getattr(settings, name)
        if settings is not None and name == "life":
            return settings.phases
        raise AttributeError(f"'{type(self).__name__}' has no attribute '{name}'")

    @property
    def status(self) -> Status:
        """How the last tick ended."""
        return _STATUS[self._codes[0]]

    @property
    def reason(self) -> str:
        """Why `status` is not OK; empty if it is."""
        if self.status is Status.HELD:
            return explain(self._records, self.settings, *self._inputs, self._failure)
        return str(self.given_up or "; ".join(map(str, self.lost_directions)))

    @property
    def state(self) -> SafetyState:
        """Whether the controller runs, holds a posture or has stopped; see `SafetyState`."""
        return _STATES[self._records.state[0]]

    @property
    def state_age(self) -> int:
        """Ticks since `state` last changed."""
        return int(self._records.memory.age)

    @property
    def faults(self) -> int:
        """Ticks in a row, up to the last one, that could not be computed."""
        return int(self._records.memory.faults)

    @property
    def repeated(self) -> int:
        """Ticks in a row, up to the last one, computed with readings that were there before."""
        return self._freshness.repeated

    @property
    def unbraked(self) -> str | None:
        """A joint without any sound reading, so that it cannot be braked reliably; None: none.

        The arms are to be stopped by their mechanical brakes then.
        """
        joint = int(self._records.memory.unbraked)
        stopped = self.state is SafetyState.SAFE_STOP
        return self.chain.joint_names[joint] if stopped and joint >= 0 else None

    def reset(self) -> None:
        """Run again after a stop: both integrals at zero, tare, bias and phases as they are."""
        memory = self._records.memory
        self._freshness.forget()
        if self._start.refused:
            self._begin_start(StartCheck(), True)
        memory.state = SafetyState.RUN
        for name in (
            "age", "faults", "lost", "overspeed", "powered", "ending", "compared", "frozen",
            "still", "wrench_age", "balanced", "apart",
        ):  # fmt: skip
            setattr(memory, name, 0)
        for rows in (self._records.joint_memory, self._records.arm_memory):
            rows.view(np.ndarray)[:] = np.zeros(1, rows.dtype)
        for name in ("underforce", "overforce", "time_since_loss"):
            self._records.column_memory[name][:] = 0.0
        memory.repeats, memory.fresh, memory.motion_sum[:], memory.force_sum[:] = 0, 0, 0.0, 0.0
        memory.step_left, self._records.column_memory.has_desired[:] = 0.0, 0

    @property
    def given_up(self) -> LimitLoss | None:
        """What motor limits cost in the last tick; None: nothing."""
        if self._codes[0] != SATURATED:
            return None
        if self._given_up is None and self._limits is not None:
            self._given_up = self._limits.given_up(self._records)
        return self._given_up

    @property
    def lost_directions(self) -> tuple[LostDirection, ...]:
        """In which motion commands were reduced near a singular posture."""
        if self.status is Status.HELD:
            return ()
        return self._records.lost_directions([arm.name for arm in self.chain.arms])

    @property
    def signals(self) -> Signals:
        """The signals of fig. 4 as the last computed tick left them.

        Raises:
            InvalidInputError: there was none yet.
        """
        self._require_tick()
        squeeze = float(self._squeeze[0]) if self._arms < 3 else self._squeeze.copy()
        return Signals(self.settings, self._records, squeeze, self._records.torques)

    def last_signals(self) -> Signals:
        """The same."""
        return self.signals

    def wiring(self, measurement: Measurement, reference: Reference) -> list[Block]:
        """The boxes of fig. 4 with the signals that each reads and writes."""
        return self.laws.boxes(BLOCKS)

    def result(self) -> TickResult:
        """The numbers of the last tick that recordings keep; the next tick overwrites them.

        Raises:
            InvalidInputError: there was no tick yet.
        """
        self._require_tick()
        result = self.__dict__.get("_result")
        if result is None or result.records is not self._records:
            result = self._result = TickResult.of(self._records)
        return result

    def _require_tick(self) -> None:
        if not self._records.ticked[0]:
            raise InvalidInputError(
                "no tick has been computed yet; call tick first"
                + (f" (the last one was held: {self.reason})" if self.status else "")
            )

    def last_torques(self) -> Array:
        """(n_a,) what the last tick gave out."""
        return self._records.torques.copy()

    def joint_acceleration(self) -> Array:
        """(n,) q̈ = W η̇_c + w of all joints, as commanded by the last tick."""
        return np.array(self._records.joints.acceleration)

    def residual_wrench(self) -> Array:
        """(6,) wrist reading of the last tick minus what the model predicts at rest, untared.

        Its mean at rest without contact is the tare, to be stored in `f_tare`: weight errors
        cannot be distinguished from contact forces once contact is made.
        """
        result = self.result()
        return np.asarray(result.f_meas + self.f_tare - result.bias_out)

    def phases(self) -> Array:
        """(contacts,) open 0, approaching 1, closed 2 (`Phase`) as of the last tick."""
        phase = self._records.phase if self.life is not None else Phase.CLOSED
        return np.where(self._records.active != 0, phase, Phase.OPEN).astype(np.int64)

    @property
    def f_tare(self) -> Array:
        """(6,) constant error of the wrist readings at O (N, N m), removed from each."""
        return np.array(self._records.memory.f_tare)

    @f_tare.setter
    def f_tare(self, wrench: Array) -> None:
        self._records.memory.f_tare[:] = as_array("f_tare", wrench, (6,))

    @property
    def f_bias(self) -> Array:
        """(6,) constant wrench added to the command at O (N, N m)."""
        return np.array(self._records.memory.f_bias)

    @f_bias.setter
    def f_bias(self, wrench: Array) -> None:
        self._records.memory.f_bias[:] = as_array("f_bias", wrench, (6,))

    @property
    def engaged(self) -> bool:
        """Whether the contacts are part of the model; False: the object counts as free."""
        return bool(self._records.engaged[0])

    @engaged.setter
    def engaged(self, engaged: bool) -> None:
        self._records.memory.engaged = engaged
        if self.life is None or not engaged:
            self._records.contacts.active[:] = engaged
