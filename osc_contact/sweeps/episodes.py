"""Episodes of a vector environment: where each begins, and what its scenario asks for."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact.scenarios.control_schema import VerdictSpec
from osc_contact.scenarios.loader import Template, read_text
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array
from osc_contact.sweeps.fleet import Start
from osc_contact.sweeps.rows import scenario_of, without_doubts_told
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.workshop import Workshop

__all__ = ["Episode", "Episodes"]


@dataclass(frozen=True)
class Episode:
    """One of them.

    Attributes:
        number: of the sample. start: of plant and controller.
        places: (steps + 1, 4, 4) poses that the scenario asks for, at the ends of the steps.
        forces: (steps + 1, r) contact forces (N) likewise. squeeze: internal force (N).
    """

    number: int
    start: Start
    places: Array
    forces: Array
    squeeze: float


class Episodes:
    """Makes episodes of a scenario, with other numbers each; those made last are kept.

    Attributes:
        count: how many different ones there are.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        vary: Mapping[str, str] | Sequence[str],
        overrides: Sequence[str],
        period: float,
        count: int,
    ) -> None:
        """Look at the first.

        Args:
            scenario, vary, overrides: see `sweep`; without `vary` all episodes are the same.
            period: of the steps (s). count: how many different episodes there are.
        """
        self._study = SweepStudy.of(scenario, vary, count, overrides=overrides) if vary else None
        self._scenario = _scenario(scenario, overrides)
        self._workshop, self._period = Workshop(), period
        self.count = count if vary else 1
        self._kept: OrderedDict[int, Episode] = OrderedDict()

    @property
    def limits(self) -> VerdictSpec:
        """How far an object may be from where the scenario wants it."""
        return self._scenario.verdict

    def __getitem__(self, number: int) -> Episode:
        if number not in self._kept:
            self._kept[number] = self._make(number)
            while len(self._kept) > self.count:
                self._kept.popitem(last=False)
        return self._kept[number]

    def _make(self, number: int) -> Episode:
        scenario = self._scenario
        if self._study is not None:
            scenario = scenario_of(self._study, self._study.sample(number))
        rig = self._workshop.rig(scenario)
        steps = int(np.floor(scenario.duration / self._period + 1e-9))
        plan = rig.references.over(np.arange(steps + 1) * self._period)
        places = np.array([pin.XYZQUATToSE3(x).homogeneous for x in plan.X_WD])
        with without_doubts_told():
            start = Start.of(rig)
        return Episode(number, start, places, plan.alpha_d, plan.squeeze_d)


def _scenario(scenario: str | Path | Scenario, overrides: Sequence[str]) -> Scenario:
    if isinstance(scenario, Scenario) and not overrides:
        return scenario
    if isinstance(scenario, Scenario):
        raise TypeError(
            "overrides change a scenario's file; change a scenario made in Python itself"
        )
    return Template(*read_text(scenario)).make(overrides)
