"""Contact or no contact, from the paper's own signal: projected force and power (figs. 6, 7).

While a contact holds, the power of the projected force is zero: α_k (NᵀV_rel)_k = 0. A collision
is a burst of it, a lost contact a force that has gone. Both are told with hysteresis, per contact.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["ContactMonitor", "MonitorLimits", "MonitorState", "watched"]


@dataclass(frozen=True)
class MonitorLimits:
    """When contact counts as made, as lost, and as a collision.

    Attributes:
        force_on, force_off: N; made above the first, lost below the second.
        power_on, power_off: W; a collision begins above the first (in size), the next one can only
            begin once it has been below the second.
        patience: s that the force must stay low before contact counts as lost.
    """

    force_on: float = 1.0
    force_off: float = 0.4
    power_on: float = 0.1
    power_off: float = 0.03
    patience: float = 0.005

    def __post_init__(self) -> None:
        if not (
            self.force_on > self.force_off > 0.0
            and self.power_on > self.power_off > 0.0
            and self.patience >= 0.0
        ):
            raise InvalidInputError(
                f"contact monitor: {self}; each 'on' must lie above its 'off', 'off' above 0, "
                "patience ≥ 0"
            )


@dataclass(frozen=True)
class MonitorState:
    """What is remembered of each contact, (r,) each.

    Attributes:
        closed: whether contact is held to be made.
        low_for: s since the force went low. armed: whether a collision can be told.
        collision: whether one began at this tick.
    """

    closed: Array
    low_for: Array
    armed: Array
    collision: Array

    @classmethod
    def of(cls, closed: Array) -> MonitorState:
        """At the start: contacts (r,) made or not."""
        closed = np.asarray(closed, dtype=bool)
        return cls(closed, np.zeros(len(closed)), ~closed, np.zeros(len(closed), dtype=bool))


def watched(
    state: MonitorState, alpha: Array, speed: Array, dt: float, limits: MonitorLimits
) -> MonitorState:
    """The state one tick later.

    Args:
        state: before. alpha: (r,) measured magnitudes (N), from the wrist filter.
        speed: (r,) NᵀV_rel (m/s). dt: the tick (s). limits: thresholds.
    """
    power = np.abs(alpha * speed)
    low = alpha < limits.force_off
    low_for = np.where(low, state.low_for + dt, 0.0)
    lost = state.closed & (low_for > limits.patience)
    made = ~state.closed & (alpha > limits.force_on)
    collision = state.armed & (power > limits.power_on)
    armed = np.where(collision, False, state.armed | (power < limits.power_off))
    return MonitorState((state.closed | made) & ~lost, low_for, armed, collision)


@dataclass
class ContactMonitor:
    """`watched`, remembered from tick to tick."""

    contacts: int
    dt: float
    limits: MonitorLimits = field(default_factory=MonitorLimits)

    def __post_init__(self) -> None:
        self.state = MonitorState.of(np.zeros(self.contacts, dtype=bool))

    def update(self, alpha: Array, speed: Array) -> MonitorState:
        """Judge one tick; see `watched`."""
        self.state = watched(self.state, alpha, speed, self.dt, self.limits)
        return self.state
