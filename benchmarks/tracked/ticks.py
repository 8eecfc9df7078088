"""The tick of every rig, and its floor, `pin.computeAllTerms` of the same arms."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # asv knows this folder only

from benchmarks.cases import CASES


class Tick:
    """Seconds of one tick at a fixed instant, the first one left out: it compiles."""

    params = tuple(CASES)
    param_names = ("case",)
    timeout = 600

    def setup(self, name: str) -> None:
        """Build the rig."""
        case = CASES[name]()
        self.tick, self.unwind = case.tick()
        self.floor = case.floor()
        self.time_tick(name)

    def time_tick(self, name: str) -> None:
        """The tick, and what puts the controller back to the instant."""
        self.tick()
        self.unwind()

    def time_floor(self, name: str) -> None:
        """Pinocchio alone."""
        self.floor()
