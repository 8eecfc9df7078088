"""Knocks from outside: forces on the arms that no model knows of."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, as_array

__all__ = ["Push"]


@dataclass(frozen=True, eq=False)
class Push:
    """A half sine of force on an arm, where its wrist sensor is fastened.

    The force comes from the arm's side: the sensor feels what it does, not the force itself.

    Attributes:
        arm: its name. force: (3,) N, world axes, at its peak.
        start, duration: s; when it acts. every: s after which it comes again; 0: never.
    """

    arm: str
    force: Array
    start: float
    duration: float
    every: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", as_array("push force", self.force, (3,)))
        if not (self.duration > 0.0 and (self.every == 0.0 or self.every > self.duration)):
            raise InvalidInputError(
                f"push: duration = {self.duration} s, every = {self.every} s; give a duration > 0 "
                "and every longer than that, or 0"
            )

    def at(self, t: float) -> Array:
        """(3,) the force at time t (s)."""
        since = t - self.start
        if self.every > 0.0 and since >= 0.0:
            since %= self.every
        acts = 0.0 <= since < self.duration
        return self.force * math.sin(math.pi * since / self.duration) if acts else np.zeros(3)
