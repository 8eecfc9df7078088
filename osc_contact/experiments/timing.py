"""How long a control tick takes, next to Pinocchio's own model evaluation of the same arms."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter_ns

import numpy as np
import pinocchio as pin

from osc_contact.experiments.rig import build_rig
from osc_contact.scenarios import load_scenario

__all__ = ["time_tick"]


def time_tick(scenarios: Sequence[str], ticks: int = 1000) -> dict[str, dict[str, float]]:
    """Median and tail of the tick, and of the floor `pin.computeAllTerms`, interleaved (µs).

    Returns:
        {scenario: {tick_p50_us, floor_p50_us, ratio, p99_9_us}}.
    """
    result = {}
    for name in scenarios:
        rig = build_rig(load_scenario(name))
        controller, plant = rig.controller(), rig.plant()
        measurement, reference = plant.measure(), rig.references.at(0.0)
        model, data = rig.chain.model, rig.chain.model.createData()
        spent, floor = np.zeros(ticks), np.zeros(ticks)
        for _ in range(10):
            controller.tick(measurement, reference)
        for k in range(ticks):
            start = perf_counter_ns()
            controller.tick(measurement, reference)
            middle = perf_counter_ns()
            pin.computeAllTerms(model, data, measurement.q, measurement.v)
            spent[k], floor[k] = middle - start, perf_counter_ns() - middle
        tick, base = float(np.median(spent)) / 1e3, float(np.median(floor)) / 1e3
        result[name] = {
            "tick_p50_us": tick,
            "floor_p50_us": base,
            "ratio": tick / base,
            "p99_9_us": float(np.percentile(spent, 99.9)) / 1e3,
        }
    return result
