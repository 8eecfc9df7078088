"""The tick of some rigs beside the floor, `pin.computeAllTerms` of the same arms."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.cases import CASES, TickCase
from benchmarks.measuring import bars, new_axes, require_count, take_turns
from benchmarks.special_cases import BATCHES, SPECIAL_CASES, BatchCase
from osc_contact.runs.tables import tick_table

__all__ = ["ALL_CASES", "draw", "measure", "tables"]

ALL_CASES: dict[str, Callable[[], TickCase | BatchCase]] = {**CASES, **SPECIAL_CASES, **BATCHES}
FEWER = 20  #: a batch has so many times fewer rounds: each ticks thousands of rows


def measure(rounds: int = 1000, cases: Iterable[str] = tuple(ALL_CASES)) -> dict[str, Any]:
    """{case: {tick_p50_us, floor_p50_us, ratio, p99_9_us}}; tick and floor take turns.

    Every tick is checked to have ended as the case says. Times of a batch are those of one row:
    the whole tick, and the floor of all rows, over their number.

    Raises:
        InvalidInputError: no rounds, or a timed tick ended otherwise.
    """
    require_count(rounds, "rounds")
    result = {}
    for name in cases:
        case = ALL_CASES[name]()
        tick, unwind = case.tick()
        rows, count = 1, rounds
        if isinstance(case, BatchCase):
            rows, count = case.rows, max(1, rounds // FEWER)
        times = take_turns({"tick": tick, "floor": case.floor()}, count, between=unwind)
        ticks = times["tick"] / rows
        p50, floor = float(np.median(ticks)), float(np.median(times["floor"])) / rows
        result[name] = {
            "tick_p50_us": p50,
            "floor_p50_us": floor,
            "ratio": p50 / floor,
            "p99_9_us": float(np.percentile(ticks, 99.9)),
        }
    return result


def tables(result: dict[str, Any]) -> list[Table]:
    """All cases in one table; those of a batch for each row."""
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
