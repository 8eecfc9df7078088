"""When a controller holds the posture or stops, and the limits of the robot that it keeps.

`law.safety` and `law.watch` do it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.law.safety import BRAKE_RATE
from osc_contact.law.watch import SURE

__all__ = ["SafetySettings", "SafetyState"]

#: what may be infinite: no limit
_OPEN = (
    "overspeed_time", "torque_rate", "contact_power", "contact_force", "overforce_time",
    "contact_loss_time", "regain_time", "integral_force", "integral_motion", "force_range",
    "torque_range", "load_error", "plausible_speed", "wrench_timeout", "stuck_speed", "frozen_time",
    "speed_error", "position_drift", "wrist_error", "closure_error",
)  # fmt: skip


class SafetyState(IntEnum):
    """What the controller does."""

    RUN = 0  #: the last tick was computed and nothing was lost
    DEGRADED = 1  #: motors at their limits, near a singular posture, or a tick or two not computed
    HOLD = 2  #: not computed: gravity compensation and damping at the last posture that was read
    SAFE_STOP = 3  #: braked to rest and held, until `Controller.reset`


@dataclass(frozen=True)
class SafetySettings:
    """What happens to ticks that cannot be computed, and limits of the robot beside its motors'.

    Attributes:
        repeats: ticks in a row that repeat the last torques; later ones hold the posture. None
            repeats those of a tick whose motors were at their limits.
        stop_after: how many more such ticks than computed ones stop the controller.
        overspeed_time: s; a motor joint above its speed limit for longer stops the controller (time
            below it is taken off).
        hold_rate: ω, 1/s, of q̈ = −2ω q̇ − ω²(q − q_hold) in a hold and a stop.
        torque_rate: 1/s; no motor torque changes faster than its limit times this.
        brake_time: s in which a joint can be braked from its speed limit to rest. The controller
            stops as long as that still ends before the joint's position limit; 0: position limits
            are not watched.
        contact_power: W; more power into the contacts stops the controller.
        contact_force, overforce_time: N and s; a contact that reads more than that, and more than
            three times its command, for longer stops the controller.
        contact_loss_time: s; a contact that is wanted and reads less than a fifth of its command
            for longer stops the controller, unless contact phases see to it. regain_time: s; so
            does one that contact phases have lost and do not hold again for longer.
        integral_force: N; the force integral stays within that, or within 1.5 times the command
            where that is more. integral_motion: m/s², rad/s²; the same of the motion integral.
        force_range, torque_range: N, N m; wrist readings beyond that, and beyond three times the
            object's weight (on a lever of 1 m), are not believed.
        load_error: N; a controller whose wrists, before any contact is made, read more than that
            beside the weight they carry does not run (nor with that force on a lever of 0.2 m, or
            of the tool's length, as a torque).
        plausible_speed: times a joint's speed limit; faster ones, and positions that jump further,
            are not believed.
        wrench_timeout: s; ticks go on with the last wrenches as long as there are none
            (`Measurement.wrench_valid`), and stamps may stand still.
        stuck_speed: times a joint's speed limit; a joint that is commanded to gain more while its
            encoder reads the very same stops the controller.
        frozen_time: s; a wrist in contact that reads the very same for longer stops it, and so does
            a whole packet.
        speed_error: times a joint's speed limit; speeds that differ from those of the positions by
            more, for 20 ms or so, stop it. position_drift: rad, m; so do positions that drift away
            by more, within half a second, from what speeds add up to.
        wrist_error: times a joint's torque limit; motor torques that the model and the wrist's
            reading leave unexplained by more than is usual, or by twice that in all, stop it.
        closure_error: m; arms whose encoders place the object they hold further apart stop it.
    """

    repeats: int = 2
    stop_after: int = 20
    overspeed_time: float = 0.02
    hold_rate: float = 20.0
    torque_rate: float = 200.0
    brake_time: float = 0.1
    contact_power: float = 20.0
    contact_force: float = 30.0
    overforce_time: float = 0.15
    contact_loss_time: float = 0.2
    regain_time: float = 1.0
    integral_force: float = 15.0
    integral_motion: float = 50.0
    force_range: float = 1000.0
    torque_range: float = 200.0
    load_error: float = 2.0
    plausible_speed: float = 3.0
    wrench_timeout: float = 0.02
    stuck_speed: float = 0.1
    frozen_time: float = 0.25
    speed_error: float = 0.1
    position_drift: float = 0.02
    wrist_error: float = 0.05
    closure_error: float = 0.02

    @classmethod
    def motors_only(cls) -> SafetySettings:
        """No limits but those of the motors: for ticks that are not those of one motion."""
        most: dict[str, Any] = dict.fromkeys(_OPEN, np.inf)
        return cls(brake_time=0.0, **most)

    @property
    def reaction(self) -> float:
        """s from the decision to stop until the brakes are on, as far as stopping ways go."""
        return 0.5 / self.hold_rate + 0.5 / BRAKE_RATE + SURE

    def __post_init__(self) -> None:
        if not 0 <= self.repeats < self.stop_after:
            raise InvalidInputError(
                f"safety: repeats = {self.repeats}, stop_after = {self.stop_after}; give "
                "0 ≤ repeats < stop_after"
            )
        if not (np.isfinite(self.hold_rate) and self.hold_rate > 0.0):
            raise InvalidInputError(
                f"safety: hold_rate = {self.hold_rate}; give a finite number > 0"
            )
        if not (np.isfinite(self.brake_time) and self.brake_time >= 0.0):
            raise InvalidInputError(
                f"safety: brake_time = {self.brake_time} s; give a finite number ≥ 0"
            )
        for key in _OPEN:
            if not getattr(self, key) > 0.0:
                raise InvalidInputError(
                    f"safety: {key} = {getattr(self, key)}; give a number > 0, or inf for no limit"
                )
