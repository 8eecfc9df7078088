"""How long a control tick takes, next to Pinocchio's own model evaluation of the same arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.experiments.benchmarks.measuring import require_count, spread
from osc_contact.experiments.rig import Rig, build_rig
from osc_contact.interface import Measurement, Reference
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
        inside: (rounds,) of the tick's two calls, `pin.crba` and the kernel.
        readable: (rounds or fewer,) of the tick's readable twin.
        parts: (rounds or fewer,) of each box of fig. 4 in that twin, by its name.
    """

    tick: Array
    floor: Array
    inside: dict[str, Array]
    readable: Array
    parts: dict[str, Array]

    @property
    def ratio(self) -> float:
        """Median tick over median floor."""
        return float(np.median(self.tick) / np.median(self.floor))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: p50, p99, p99.9 and max of tick, floor and every part (µs), and the ratio."""
        return {
            "rounds": len(self.tick),
            "tick_us": spread(self.tick),
            "floor_us": spread(self.floor),
            "ratio": self.ratio,
            "inside_us": {name: spread(times) for name, times in self.inside.items()},
            "readable_us": spread(self.readable),
            "parts_us": {name: spread(times) for name, times in self.parts.items()},
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
    """Time tick, floor and the tick's inner calls in turns, then the readable twin, box by box.

    Args:
        rig: at whose start the tick is repeated.
        rounds: how often; the twin, some hundred times slower, at most 500 times.
        parts: whether to time the twin and its boxes too.

    Raises:
        InvalidInputError: no rounds.
    """
    require_count(rounds, "rounds")
    measurement, reference = rig.plant().measure(), rig.references.at(0.0)
    tick, floor, inside = _time_tick(rig, measurement, reference, rounds)
    twin_rounds = min(rounds, 500) if parts else 0
    readable, boxes = _time_twin(rig, measurement, reference, twin_rounds)
    return TickTimes(tick, floor, inside, readable, boxes)


def _time_tick(
    rig: Rig, measurement: Measurement, reference: Reference, rounds: int
) -> tuple[Array, Array, dict[str, Array]]:
    controller, model = rig.controller(), rig.chain.model
    data = model.createData()
    kernel = controller.kernel_call(measurement, reference)
    times = np.zeros((rounds + _WARM_UP, 4))
    for row in times:
        start = perf_counter_ns()
        controller.tick(measurement, reference)
        after_tick = perf_counter_ns()
        pin.computeAllTerms(model, data, measurement.q, measurement.v)
        after_floor = perf_counter_ns()
        pin.crba(model, data, measurement.q, pin.Convention.WORLD)
        after_crba = perf_counter_ns()
        kernel()
        row[:] = np.diff((start, after_tick, after_floor, after_crba, perf_counter_ns()))
        controller.motion_law.integral = np.zeros(6)  # nothing answers: keep the loops from
        controller.force_law.integral = np.zeros(0)  # winding up
    tick, floor, crba, call = times[_WARM_UP:].T / 1e3
    return tick, floor, {"pin.crba": crba, "kernel": call}


def _time_twin(
    rig: Rig, measurement: Measurement, reference: Reference, rounds: int
) -> tuple[Array, dict[str, Array]]:
    twin = rig.controller(compiled=False)
    twin.tick(measurement, reference)  # its signals stay in place for the boxes
    stages = [(stage.block.name, stage) for stage in twin.STAGES]  # type: ignore[attr-defined]
    whole = np.zeros(rounds)
    spent = {name: np.zeros(rounds) for name, _ in stages}
    for k in range(rounds):
        start = perf_counter_ns()
        twin.tick(measurement, reference)
        whole[k] = perf_counter_ns() - start
        for name, stage in stages:
            start = perf_counter_ns()
            stage(twin, twin.signals)
            spent[name][k] = perf_counter_ns() - start
    return whole / 1e3, {name: t / 1e3 for name, t in spent.items()}
