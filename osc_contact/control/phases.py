"""Contact phases: which contacts are open, approached or closed; `law.phases` runs them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from osc_contact.control.monitor import MonitorLimits
from osc_contact.errors import InvalidInputError

__all__ = ["PhaseSettings", "Phase"]


class Phase(IntEnum):
    """Of one contact."""

    OPEN = 0  #: out of N: free motion
    APPROACHING = 1  #: in N, dragged towards the face at a set speed
    CLOSED = 2  #: in N, under force control


@dataclass(frozen=True)
class PhaseSettings:
    """How contacts are made and kept.

    Attributes:
        speed: v_a, m/s; of the approach along −N.
        damping: K_a, N s/m, of the approach; K_a v_a (N) is what it pushes with at most.
        travel: m; an approach that has gone on for longer than this at its speed stands still.
        rise: s in which the force rises from K_a v_a to its command once contact is made.
        least: α_min, N; least force command of a closed contact: it never pulls.
        torque_rate: 1/s; no motor torque changes faster than its limit times this.
        share: of the desired force; a closed contact with less is lost.
        lag: s; of the low-pass before the monitor, see `law.phases.low_pass`.
        limits: when contact counts as made and as lost.
    """

    speed: float = 0.01
    damping: float = 200.0
    travel: float = 0.05
    rise: float = 0.05
    least: float = 0.2
    torque_rate: float = 20.0
    share: float = 0.2
    lag: float = 0.006
    limits: MonitorLimits = field(
        default_factory=lambda: MonitorLimits(0.6, 0.3, power=0.004, dwell=0.002, leaving=0.03)
    )

    @property
    def push(self) -> float:
        """K_a v_a (N)."""
        return self.damping * self.speed

    def __post_init__(self) -> None:
        for key in ("speed", "damping", "travel", "rise", "least", "torque_rate", "lag", "share"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value > 0.0):
                raise InvalidInputError(f"contact phases: {key} = {value}; give a number > 0")
        if not self.push > self.limits.force_on:
            raise InvalidInputError(
                f"contact phases: an approach at {self.speed:g} m/s with {self.damping:g} N s/m "
                f"pushes with {self.push:g} N, which is not seen as contact below "
                f"force_on = {self.limits.force_on:g} N; raise speed or damping, or lower force_on"
            )
