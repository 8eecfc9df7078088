"""What a controller reports after a tick, and which numbers of it can be set between ticks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from osc_contact.control.controller_settings import Settings
from osc_contact.control.custom_laws import CustomParts
from osc_contact.control.ending import TickEnd
from osc_contact.control.inputs import Freshness
from osc_contact.control.reasons import explain, unbraked_joint
from osc_contact.control.records import TickRecords
from osc_contact.control.signals import Signals, TickResult
from osc_contact.control.status import LimitLoss, LostDirection, Phase, SafetyState, Status
from osc_contact.control.waiting import Idle, standing_approaches
from osc_contact.dynamics.learned_friction import LearnedFriction, robot_identity
from osc_contact.errors import InvalidInputError
from osc_contact.robots.model import joint_names
from osc_contact.spatial import Array, as_array

# The members of enumerations by their numbers: looked up in every tick.
_STATUS = tuple(Status)
_STATES = tuple(SafetyState)


def _six_numbers(field: str, doc: str) -> property:
    """Property of a controller: six numbers of MEMORY that can be set."""

    def read(controller: ControllerState) -> Array:
        return np.array(controller.records.memory[field])

    def write(controller: ControllerState, value: Array) -> None:
        controller.records.memory[field][:] = as_array(field, value, (6,))

    return property(read, write, doc=doc)


class ControllerState:
    """State of a controller: reports on the last tick, learned values, tare and integrals.

    Attributes:
        settings: arguments of the controller.
        records: all its numbers, MODEL, MEMORY and WORK (docs/design.md).
        custom: its code in Python, which is called within ticks.
        ended: end of the last tick that was not OK.
        freshness: newest packet and stamps of its readings.
        idle: ticks that desire forces of contacts that are not engaged.
    """

    settings: Settings
    records: TickRecords
    custom: CustomParts
    ended: TickEnd
    freshness: Freshness
    idle: Idle
    _result: TickResult | None = None

    @property
    def status(self) -> Status:
        """How the last tick ended."""
        return _STATUS[self.records.memory.status]

    @property
    def reason(self) -> str:
        """Why `status` is not OK, the arms stop, or a desired contact force is missing; else empty.

        In the tick of a stop, too, whose torques still are those of the law where a sensor is found
        faulty after it. Where a joint needs its mechanical brake (`unbraked`) it ends with that.
        """
        if self.status is Status.HELD or self.state is SafetyState.SAFE_STOP:
            return explain(self.records, self.settings, self.ended)
        lost = str(self.given_up or "; ".join(map(str, self.lost_directions)))
        if lost or not self.records.memory.ticked:
            return lost
        if not self.engaged:
            return self.idle.sentence(self.settings)
        return standing_approaches(self.records, self.settings)

    @property
    def state(self) -> SafetyState:
        """Whether the controller runs, holds a posture or has stopped; see `SafetyState`."""
        return _STATES[self.records.memory.state]

    @property
    def state_age(self) -> int:
        """Ticks since `state` last changed."""
        return int(self.records.memory.age)

    @property
    def faults(self) -> int:
        """Ticks in a row, up to the last one, that could not be computed."""
        return int(self.records.memory.faults)

    @property
    def repeated(self) -> int:
        """Ticks in a row, up to the last one, with readings that were there before."""
        return self.freshness.repeated

    @property
    def unbraked(self) -> str | None:
        """A joint without any sound reading, so that it cannot be braked reliably, or None.

        The arms are to be stopped by their mechanical brakes then.
        """
        return unbraked_joint(self.records, self.settings)

    @property
    def needs_python(self) -> bool:
        """Whether it has pairs, bodies or laws that only Python can evaluate."""
        return self.custom.needed

    @property
    def given_up(self) -> LimitLoss | None:
        """What motor limits cost in the last tick; None: nothing."""
        if self.status is not Status.SATURATED:
            return None
        return self.ended.limit_loss(self.records)

    @property
    def lost_directions(self) -> tuple[LostDirection, ...]:
        """In which motion commands were reduced near a singular posture."""
        if self.status is Status.HELD:
            return ()
        return self.records.lost_directions([arm.name for arm in self.settings.chain.arms])

    @property
    def signals(self) -> Signals:
        """The signals of fig. 4 as the last computed tick left them.

        Raises:
            InvalidInputError: there was none yet.
        """
        self.require_tick()
        return Signals(self.settings, self.records)

    def result(self) -> TickResult:
        """The numbers of the last tick that recordings keep; the next tick overwrites them.

        Raises:
            InvalidInputError: there was no tick yet.
        """
        self.require_tick()
        if self._result is None or self._result.records is not self.records:
            self._result = TickResult(self.records)
        return self._result

    def require_tick(self) -> None:
        """Refuse to go on before the first computed tick.

        Raises:
            InvalidInputError: there was no tick yet; with the reason of the last one held.
        """
        if not self.records.memory.ticked:
            raise InvalidInputError(
                "no tick has been computed yet; call tick first"
                + (f" (the last one was held: {self.reason})" if self.status else "")
            )

    def last_torques(self) -> Array:
        """(n_a,) what the last tick gave out."""
        return self.records.memory.torques.copy()

    def joint_acceleration(self) -> Array:
        """(n,) q̈ = W η̇_c + w of all joints, as commanded by the last tick."""
        return np.array(self.records.work.joints.acceleration)

    def residual_wrench(self) -> Array:
        """(6,) wrist reading of the last tick minus what the model predicts at rest, untared.

        Its mean at rest without contact is the tare, to be stored in `f_tare`: weight errors
        cannot be distinguished from contact forces once contact is made.
        """
        result = self.result()
        return result.f_meas + self.f_tare - result.bias_out

    def phases(self) -> Array:
        """(contacts,) open 0, approaching 1, closed 2 (`Phase`) as of the last tick."""
        contacts = self.records.memory.contacts
        phase = contacts.phase if self.settings.life is not None else Phase.CLOSED
        return np.where(contacts.active != 0, phase, Phase.OPEN).astype(np.int64)

    @property
    def active(self) -> npt.NDArray[np.bool_]:
        """(contacts,) which of them were active in the last tick: in N, approached or closed."""
        return np.array(self.records.memory.contacts.active != 0)

    f_tare = _six_numbers(
        "f_tare", "(6,) constant error of the wrist readings at O (N, N m), removed from each."
    )

    @property
    def joint_friction(self) -> Array:
        """(n, 2) Coulomb (N m; N) and viscous friction (N m s/rad; N s/m), as learned so far.

        Columns are what `Arm` takes as friction and damping, to start with next time.
        """
        model = self.settings.chain.model
        known = np.column_stack([model.upperDryFrictionLimit, model.damping])
        memory = self.records.memory
        learned = memory.friction_known != 0
        return np.where(learned[:, None], memory.friction.theta[:, :2], known)

    @property
    def missing_inertia(self) -> Array:
        """(n,) inertia of each joint's rotor that the model lacks, as learned so far (kg m²; kg).

        Below zero where the model has too much.
        """
        return np.array(self.records.memory.friction.theta[:, 2])

    @property
    def learned_friction(self) -> tuple[LearnedFriction, ...]:
        """Friction of the joints of each arm as learned so far, with the identity of its robot.

        `LearnedFriction.save` and `load` keep it, `put_on` gives it to an arm to start with.
        """
        found = []
        for arm, s in zip(self.settings.chain.arms, self.settings.chain.slices, strict=True):
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
        """(r, 3, 3) covariance of the assumed normal of each force magnitude (rad²).

        In the axes of the body that carries the normal; where edges cross, of the body's edge along
        the normal. NaN: not estimated, or the contact is open.
        """
        P = np.array(self.records.memory.columns.covariance).reshape(-1, 3, 3)
        return np.where((self.normal_std > 0.0)[:, None, None], P, np.nan)

    @property
    def normal_std(self) -> Array:
        """(r,) the same where each is least certain (rad); 0: not estimated."""
        return np.array(self.records.memory.columns.normal_std)

    f_bias = _six_numbers("f_bias", "(6,) constant wrench added to the command at O (N, N m).")

    @property
    def engaged(self) -> bool:
        """Whether the contacts are part of the model; False: the object counts as free."""
        return bool(self.records.memory.engaged)

    @engaged.setter
    def engaged(self, engaged: bool) -> None:
        self.records.memory.engaged = engaged
        self.idle.begin(waiting=not engaged)
        if self.settings.life is None or not engaged:
            self.records.memory.contacts.active[:] = engaged

    motion_integral = _six_numbers("motion_sum", "(6,) ∫e dt of the motion law (m s, rad s).")

    @property
    def force_integral(self) -> Array:
        """(r,) K_i ∫(α_d − α_meas) dt of the force law (N)."""
        memory = self.records.memory
        return np.array(memory.force_sum[: int(memory.force_rank)])

    @force_integral.setter
    def force_integral(self, value: Array) -> None:
        memory = self.records.memory
        value = as_array("force integral", value, (None,))
        if len(value) > 6:
            raise InvalidInputError(f"force integral: {len(value)} values; N has 6 columns at most")
        memory.force_sum[: len(value)] = value
        memory.force_rank = len(value)
        memory.by_column = 0
        kept = self.records.kept()
        memory.columns.integral[:] = 0.0
        memory.columns.integral[kept] = value if len(value) == len(kept) else 0.0
