"""The tick of some rigs beside the floor, `pin.computeAllTerms` of the same arms."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from osc_contact.experiments.benchmarks.cases import CASES
from osc_contact.experiments.benchmarks.measuring import bars, new_axes, take_turns
from osc_contact.experiments.tables import tick_table

__all__ = ["draw", "measure", "tables"]


def measure(rounds: int = 1000, cases: Iterable[str] = tuple(CASES)) -> dict[str, Any]:
    """{case: {tick_p50_us, floor_p50_us, ratio, p99_9_us}}; tick and floor take turns.

    Raises:
        InvalidInputError: no rounds.
    """
    result = {}
    for name in cases:
        case = CASES[name]()
        tick, unwind = case.tick()
        times = take_turns({"tick": tick, "floor": case.floor()}, rounds, between=unwind)
        p50, floor = float(np.median(times["tick"])), float(np.median(times["floor"]))
        result[name] = {
            "tick_p50_us": p50,
            "floor_p50_us": floor,
            "ratio": p50 / floor,
            "p99_9_us": float(np.percentile(times["tick"], 99.9)),
        }
    return result


def tables(result: dict[str, Any]) -> list[Table]:
    """All cases in one table."""
    return [tick_table(result)]


def draw(result: dict[str, Any], path: Path) -> None:
    """Tick and floor of each case as bars."""
    from osc_contact.visual.plots import save, style

    with style():
        figure, axes = new_axes(len(result), height=1.8)
        for ax, (name, row) in zip(axes, result.items(), strict=True):
            medians = {"tick": row["tick_p50_us"], "floor": row["floor_p50_us"]}
            bars(ax, medians, "median time (µs)", marked=("floor",))
            ax.set_title(f"{name}: {row['ratio']:.2f} × floor")
        save(figure, path.with_suffix(""))
