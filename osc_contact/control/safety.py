"""When ticks that cannot be computed end in a hold, and in a stop; `law.safety` does it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from osc_contact.errors import InvalidInputError

__all__ = ["SafetySettings", "SafetyState"]


class SafetyState(IntEnum):
    """What the controller does."""

    RUN = 0  #: the last tick was computed and nothing was lost
    DEGRADED = 1  #: motors at their limits, near a singular posture, or a tick or two not computed
    HOLD = 2  #: not computed: gravity compensation and damping at the last posture that was read
    SAFE_STOP = 3  #: braked to rest and held, until `Controller.reset`


@dataclass(frozen=True)
class SafetySettings:
    """What happens to ticks that cannot be computed.

    Attributes:
        repeats: ticks in a row that repeat the last torques; later ones hold the posture. None
            repeats those of a tick whose motors were at their limits.
        stop_after: ticks in a row after which the controller stops.
        too_fast_for: s; a motor joint above its speed limit for longer stops the controller.
        hold_rate: ω, 1/s, of q̈ = −2ω q̇ − ω²(q − q_hold) in a hold and a stop.
    """

    repeats: int = 2
    stop_after: int = 20
    too_fast_for: float = 0.02
    hold_rate: float = 20.0

    def __post_init__(self) -> None:
        if not 0 <= self.repeats < self.stop_after:
            raise InvalidInputError(
                f"safety: repeats = {self.repeats}, stop_after = {self.stop_after}; give "
                "0 ≤ repeats < stop_after"
            )
        for key in ("too_fast_for", "hold_rate"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value > 0.0):
                raise InvalidInputError(f"safety: {key} = {value}; give a finite number > 0")
