"""How long a control tick takes, next to Pinocchio's own model evaluation of the same arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError
from osc_contact.experiments.rig import Rig, build_rig
from osc_contact.scenarios import load_scenario
from osc_contact.spatial import Array

__all__ = ["TickTimes", "time_parts", "time_tick"]

_WARM_UP = 10


@dataclass(frozen=True)
class TickTimes:
    """Times measured in one process (µs); tick and floor take turns.

    Attributes:
        tick: (rounds,) of `Controller.tick`.
        floor: (rounds,) of `pin.computeAllTerms` on the same arms at the same q, v.
        parts: (rounds,) of each box of fig. 4, by its name.
    """

    tick: Array
    floor: Array
    parts: dict[str, Array]

    @property
    def ratio(self) -> float:
        """Median tick over median floor."""
        return float(np.median(self.tick) / np.median(self.floor))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: p50, p99, p99.9 and max of tick, floor and every part (µs), and the ratio."""
        return {
            "rounds": len(self.tick),
            "tick_us": _spread(self.tick),
            "floor_us": _spread(self.floor),
            "ratio": self.ratio,
            "parts_us": {name: _spread(times) for name, times in self.parts.items()},
        }


def time_tick(scenarios: Sequence[str], ticks: int = 1000) -> dict[str, dict[str, float]]:
    """Median and tail of the tick, and of the floor `pin.computeAllTerms`, interleaved (µs).

    Returns:
        {scenario: {tick_p50_us, floor_p50_us, ratio, p99_9_us}}.
    """
    result = {}
    for name in scenarios:
        times = time_parts(build_rig(load_scenario(name)), ticks, parts=False)
        result[name] = {
            "tick_p50_us": float(np.median(times.tick)),
            "floor_p50_us": float(np.median(times.floor)),
            "ratio": times.ratio,
            "p99_9_us": float(np.percentile(times.tick, 99.9)),
        }
    return result


def time_parts(rig: Rig, rounds: int, *, parts: bool = True) -> TickTimes:
    """Time tick and floor in turns, then, on a second controller, each box of fig. 4.

    Args:
        rig: at whose start the tick is repeated.
        rounds: how often.
        parts: whether to time the boxes too.

    Raises:
        InvalidInputError: no rounds.
    """
    if rounds < 1:
        raise InvalidInputError(f"{rounds} rounds tell no time; give 1 or more")
    controller, second = rig.controller(), rig.controller()
    measurement, reference = rig.plant().measure(), rig.references.at(0.0)
    model, data = rig.chain.model, rig.chain.model.createData()
    second.tick(measurement, reference)  # its signals stay in place for the boxes
    boxes = second.STAGES if parts else ()
    stages = [(stage.block.name, stage) for stage in boxes]  # type: ignore[attr-defined]
    tick, floor = np.zeros(rounds), np.zeros(rounds)
    spent = {name: np.zeros(rounds) for name, _ in stages}
    for k in range(-_WARM_UP, rounds):
        start = perf_counter_ns()
        controller.tick(measurement, reference)
        middle = perf_counter_ns()
        pin.computeAllTerms(model, data, measurement.q, measurement.v)
        end = perf_counter_ns()
        if k >= 0:
            tick[k], floor[k] = middle - start, end - middle
    for k in range(rounds):
        for name, stage in stages:
            start = perf_counter_ns()
            stage(second, second.signals)
            spent[name][k] = perf_counter_ns() - start
    return TickTimes(tick / 1e3, floor / 1e3, {name: t / 1e3 for name, t in spent.items()})


def _spread(times: Array) -> dict[str, float]:
    p50, p99, p99_9 = np.percentile(times, [50, 99, 99.9])
    return {
        "p50": float(p50),
        "p99": float(p99),
        "p99_9": float(p99_9),
        "max": float(times.max()),
    }
