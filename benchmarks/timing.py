"""How long a control tick takes, next to Pinocchio's own model evaluation of the same arms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.cases import repeatable, require_status
from benchmarks.measuring import require_count, spread
from osc_contact.control.controller import Controller
from osc_contact.interface import Measurement, Reference
from osc_contact.law import tick as law
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.scenarios import load_scenario
from osc_contact.spatial import Array

__all__ = ["TickTimes", "kernel_call", "time_parts", "time_tick"]

_WARM_UP = 10


@dataclass(frozen=True)
class TickTimes:
    """Times measured in one process (µs); tick and floor take turns.

    Attributes:
        tick: (rounds,) of `Controller.tick`.
        floor: (rounds,) of `pin.computeAllTerms` on the same arms at the same q, v.
        inside: (rounds,) of the tick's one call, the law.
    """

    tick: Array
    floor: Array
    inside: dict[str, Array]

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
        }


def time_tick(scenarios: Sequence[str], ticks: int = 1000) -> dict[str, dict[str, float]]:
    """Median and tail of the tick, and of the floor `pin.computeAllTerms`, interleaved (µs).

    Returns:
        {scenario: {tick_p50_us, floor_p50_us, ratio, p99_9_us}}.
    """
    result = {}
    for name in scenarios:
        times = time_parts(build_rig(load_scenario(name)), ticks)
        result[name] = {
            "tick_p50_us": float(np.median(times.tick)),
            "floor_p50_us": float(np.median(times.floor)),
            "ratio": times.ratio,
            "p99_9_us": float(np.percentile(times.tick, 99.9)),
        }
    return result


def time_parts(rig: Rig, rounds: int) -> TickTimes:
    """Time tick, floor and the law's call in turns.

    Args:
        rig: at whose start the tick is repeated. rounds: how often.

    Raises:
        InvalidInputError: no rounds, or a timed tick did not end OK.
    """
    require_count(rounds, "rounds")
    measurement, reference = rig.plant().measure(), rig.references.at(0.0)
    return TickTimes(*_time_tick(rig, measurement, reference, rounds))


def _time_tick(
    rig: Rig, measurement: Measurement, reference: Reference, rounds: int
) -> tuple[Array, Array, dict[str, Array]]:
    controller, model = repeatable(rig.controller()), rig.chain.model
    data = model.createData()
    kernel = kernel_call(controller, measurement, reference)
    times = np.zeros((rounds + _WARM_UP, 3))
    for row in times:
        start = perf_counter_ns()
        controller.tick(measurement, reference)
        after_tick = perf_counter_ns()
        pin.computeAllTerms(model, data, measurement.q, measurement.v)
        after_floor = perf_counter_ns()
        kernel()
        require_status(controller, rig.scenario.name)
        row[:] = np.diff((start, after_tick, after_floor, perf_counter_ns()))
        controller.motion_law.integral = np.zeros(6)  # nothing answers: keep the loops from
        controller.force_law.integral = np.zeros(0)  # winding up
    tick, floor, call = times[_WARM_UP:].T / 1e3
    return tick, floor, {"law": call}


def kernel_call(
    controller: Controller, measurement: Measurement, reference: Reference
) -> Callable[[], Any]:
    """The law's call of a tick by itself, to be timed; the state of the loops moves on.

    Args:
        controller: whose tick is timed. measurement, reference: of the tick.
    """
    controller.tick(measurement, reference)
    r, tau = controller._records, np.empty(controller._n_a)
    args = (
        r.row.raw, r.memory_bytes, r.work_bytes, measurement.q, measurement.v,
        measurement.wrenches, reference.X_WD.homogeneous, reference.V_D, reference.A_D,
        reference.alpha_d, controller._squeeze, controller._still, 0, tau, controller._codes, 0,
        law.END, 0, 1,
    )  # fmt: skip
    return lambda: controller._rows(*args)
