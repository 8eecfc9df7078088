"""Reports of a controller after a tick, and numbers that can be set between ticks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from osc_contact.control.controller_settings import Settings
from osc_contact.control.custom_laws import CustomParts
from osc_contact.control.ending import TickEnd
from osc_contact.control.inputs import Freshness
from osc_contact.control.reasons import explain, hopping_contact, unbraked_joint
from osc_contact.control.records import TickRecords
from osc_contact.control.signals import Signals, TickResult
from osc_contact.control.status import LimitLoss, LostDirection, Phase, SafetyState, Status
from osc_contact.control.waiting import Idle, explained_approaches, standing_approaches
from osc_contact.dynamics.learned_friction import LearnedFriction, robot_identity
from osc_contact.errors import InvalidInputError
from osc_contact.law.agreement import UNBALANCED
from osc_contact.robots.model import joint_names
from osc_contact.spatial import Array, as_array

# Members of the enumerations by their numbers; indexing a tuple is faster than calling the class.
_STATUS = tuple(Status)
_STATES = tuple(SafetyState)


def _six_numbers(field: str, doc: str) -> property:
    """Make a property of a controller for a field of MEMORY with six numbers.

    Args:
        field: name of the field.
        doc: docstring of the property.
    """

    def read(controller: ControllerState) -> Array:
        """Copy (6,) of the field."""
        return np.array(controller.records.memory[field])

    def write(controller: ControllerState, value: Array) -> None:
        """Set the field to six finite numbers; InvalidInputError otherwise."""
        controller.records.memory[field][:] = as_array(field, value, (6,))

    return property(read, write, doc=doc)


class ControllerState:
    """State of a controller: reports on the last tick, learned values, tare and integrals.

    Attributes:
        settings: arguments of the controller.
        records: all numbers of the controller, MODEL, MEMORY and WORK (docs/design.md).
        custom: pairs, bodies and laws in Python, which are called within ticks.
        ended: cause and losses of the last tick that was not OK.
        freshness: newest packet number and stamps of the readings.
        idle: count of ticks that desire forces of contacts that are not engaged.
    """

    settings: Settings
    records: TickRecords
    custom: CustomParts
    ended: TickEnd
    freshness: Freshness
    idle: Idle
    _result: TickResult | None = None  #: views of the results in `records`; None: not made yet

    @property
    def status(self) -> Status:
        """Status of the last tick."""
        return _STATUS[self.records.memory.status]

    @property
    def reason(self) -> str:
        """Sentence on the cause of a status that is not OK, a stop or a missing contact force.

        It is empty without such a cause. A sensor fault is named in the tick that detects it, whose
        torques are those of a stop already. If a joint needs its mechanical brake (`unbraked`), the
        sentence ends with this joint.
        """
        if self.status is Status.HELD or self.state is SafetyState.SAFE_STOP:
            return explain(self.records, self.settings, self.ended)
        if self.status is Status.HOPPING:
            return hopping_contact(self.records, self.settings)
        losses = str(self.given_up or "; ".join(map(str, self.lost_directions)))
        if losses or not self.records.memory.ticked:
            return losses
        if not self.engaged:
            return self.idle.sentence(self.settings)
        explained = explained_approaches(self.records, self.settings)
        standing = standing_approaches(self.records, self.settings)
        return "; ".join(sentence for sentence in (explained, standing) if sentence)

    @property
    def state(self) -> SafetyState:
        """State of the controller: running, holding a posture or stopped; see `SafetyState`."""
        return _STATES[self.records.memory.state]

    @property
    def state_age(self) -> int:
        """Number of ticks since `state` last changed."""
        return int(self.records.memory.age)

    @property
    def released_for(self) -> float:
        """Time (s) since a stop that shows by the motion after it whether encoders are dead.

        Motors contradicted a wrist, and the stop has changed the torque of a motor by more than
        friction and a wrong wrist explain. It is 0.0 if there was no such stop, or none since the
        reset.
        """
        memory = self.records.memory
        is_stopped = self.state is SafetyState.SAFE_STOP and memory.cause == UNBALANCED
        is_released = is_stopped and memory.arms.released.any()
        return float(memory.age * self.records.model.period) if is_released else 0.0

    @property
    def faults(self) -> int:
        """Number of consecutive ticks, up to the last one, that could not be computed."""
        return int(self.records.memory.faults)

    @property
    def repeated(self) -> int:
        """Number of consecutive ticks, up to the last one, with repeated readings."""
        return self.freshness.repeated

    @property
    def unbraked(self) -> str | None:
        """Name of a joint without a sound reading, which cannot be braked reliably, or None.

        With such a joint the arms must be stopped by their mechanical brakes.
        """
        return unbraked_joint(self.records, self.settings)

    @property
    def needs_python(self) -> bool:
        """True if the controller has pairs, bodies or laws that only Python can evaluate."""
        return self.custom.needed

    @property
    def given_up(self) -> LimitLoss | None:
        """Force and motion lost to motor limits in the last tick, or None."""
        if self.status is not Status.SATURATED:
            return None
        return self.ended.limit_loss(self.records)

    @property
    def lost_directions(self) -> tuple[LostDirection, ...]:
        """Directions in which motion commands were reduced near a singular posture."""
        if self.status is Status.HELD:
            return ()
        return self.records.lost_directions([arm.name for arm in self.settings.chain.arms])

    @property
    def signals(self) -> Signals:
        """Signals of fig. 4 in the last computed tick.

        Raises:
            InvalidInputError: no tick has been computed.
        """
        self.require_tick()
        return Signals(self.settings, self.records)

    def result(self) -> TickResult:
        """Numbers of the last tick for recordings, which the next tick overwrites.

        Raises:
            InvalidInputError: no tick has been computed.
        """
        self.require_tick()
        if self._result is None or self._result.records is not self.records:
            self._result = TickResult(self.records)
        return self._result

    def require_tick(self) -> None:
        """Refuse a call that needs the results of a tick before any tick was computed.

        Raises:
            InvalidInputError: no tick was computed; the message has the reason if the last tick was
                held.
        """
        if not self.records.memory.ticked:
            raise InvalidInputError(
                "no tick has been computed yet; call tick first"
                + (f" (the last one was held: {self.reason})" if self.status else "")
            )

    def last_torques(self) -> Array:
        """Motor torques (n_a,) of the last tick (N m, N)."""
        return self.records.memory.torques.copy()

    def joint_acceleration(self) -> Array:
        """Acceleration (n,) of all joints commanded by the last tick, q̈ = W η̇_c + w."""
        return np.array(self.records.work.joints.acceleration)

    def residual_wrench(self) -> Array:
        """Wrist reading (6,) of the last tick, without tare, less `bias_out`.

        It is at O in world axes (N, N m); `bias_out` is what the model predicts without contact at
        zero acceleration of the object. Its mean at rest without contact is the tare, to be stored
        in `f_tare`: once contact is made, weight errors cannot be distinguished from contact
        forces.
        """
        result = self.result()
        return result.f_meas + self.f_tare - result.bias_out

    def phases(self) -> Array:
        """Phase (contacts,) of each contact in the last tick: open 0, approaching 1, closed 2."""
        contacts = self.records.memory.contacts
        phase = contacts.phase if self.settings.life is not None else Phase.CLOSED
        return np.where(contacts.active != 0, phase, Phase.OPEN).astype(np.int64)

    @property
    def active(self) -> npt.NDArray[np.bool_]:
        """Mask (contacts,) of the contacts active in the last tick: approaching or closed, in N."""
        return np.array(self.records.memory.contacts.active != 0)

    f_tare = _six_numbers(
        "f_tare", "(6,) constant error of the wrist readings at O (N, N m), removed from each."
    )

    @property
    def joint_friction(self) -> Array:
        """Coulomb (N m; N) and viscous friction (N m s/rad; N s/m) of joints, (n, 2).

        It is the identified friction, of a joint whose identification has not begun the model's.
        The columns are arguments of `Arm`, friction and damping, for the start of another session.
        """
        model = self.settings.chain.model
        model_values = np.column_stack([model.upperDryFrictionLimit, model.damping])
        memory = self.records.memory
        learned = memory.friction_known != 0
        return np.where(learned[:, None], memory.friction.theta[:, :2], model_values)

    @property
    def missing_inertia(self) -> Array:
        """Identified inertia (n,) of the joints' rotors that the model lacks (kg m²; kg).

        It is negative if the model overestimates the inertia.
        """
        return np.array(self.records.memory.friction.theta[:, 2])

    @property
    def learned_friction(self) -> tuple[LearnedFriction, ...]:
        """Identified friction of the joints of each arm, with the identity of its robot.

        `LearnedFriction.save` and `load` store it in files; `put_on` adds it to the model of an
        arm.
        """
        result = []
        for arm, joints in zip(self.settings.chain.arms, self.settings.chain.slices, strict=True):
            friction, damping = self.joint_friction[joints].T
            result.append(
                LearnedFriction(
                    robot=robot_identity(arm.model),
                    joints=tuple(joint_names(arm.model)),
                    friction=tuple(friction.tolist()),
                    damping=tuple(damping.tolist()),
                    missing_inertia=tuple(self.missing_inertia[joints].tolist()),
                )
            )
        return tuple(result)

    @property
    def normal_covariance(self) -> Array:
        """Covariance (r, 3, 3) of the estimated normal of each force magnitude (rad²).

        It is in the axes of the body that carries the normal; for crossed edges it is the variance
        of the body's edge along the normal. NaN: not estimated, or the contact is open.
        """
        P = np.array(self.records.memory.columns.covariance).reshape(-1, 3, 3)
        return np.where((self.normal_std > 0.0)[:, None, None], P, np.nan)

    @property
    def normal_std(self) -> Array:
        """Largest standard deviation (r,) of the estimated normals (rad); 0: not estimated."""
        return np.array(self.records.memory.columns.normal_std)

    f_bias = _six_numbers("f_bias", "(6,) constant wrench added to the command at O (N, N m).")

    @property
    def engaged(self) -> bool:
        """True if the law includes the contacts; False: the object is controlled as free."""
        return bool(self.records.memory.engaged)

    @engaged.setter
    def engaged(self, engaged: bool) -> None:
        """Include the contacts in the law, or not, without a transfer of the integrals.

        Without phases all contacts become active with it. `engage` does it without a jump.

        Args:
            engaged: True: contacts take part in the law.
        """
        self.records.memory.engaged = engaged
        self.idle.begin(waiting=not engaged)
        if self.settings.life is None or not engaged:
            self.records.memory.contacts.active[:] = engaged

    motion_integral = _six_numbers("motion_sum", "(6,) ∫e dt of the motion law (m s, rad s).")

    @property
    def force_integral(self) -> Array:
        """Integral (r,) of the force law, K_i ∫(α_d − α_meas) dt (N)."""
        memory = self.records.memory
        return np.array(memory.force_sum[: int(memory.force_rank)])

    @force_integral.setter
    def force_integral(self, value: Array) -> None:
        """Set the integral of each independent column of N (N).

        It is stored by column, too, if there are as many values as independent columns; otherwise
        the integrals of the columns are zero.

        Args:
            value: (k,) integrals of the independent columns, k ≤ 6 (N).

        Raises:
            InvalidInputError: more than six values, or a number that is not finite.
        """
        memory = self.records.memory
        value = as_array("force integral", value, (None,))
        if len(value) > 6:
            raise InvalidInputError(f"force integral: {len(value)} values; N has 6 columns at most")
        memory.force_sum[: len(value)] = value
        memory.force_rank = len(value)
        memory.by_column = 0
        columns = self.records.kept()
        memory.columns.integral[:] = 0.0
        memory.columns.integral[columns] = value if len(value) == len(columns) else 0.0
