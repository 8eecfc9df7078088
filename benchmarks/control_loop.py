"""Time the control tick and Pinocchio's own model evaluation, side by side.

    python benchmarks/control_loop.py [--ticks N] [--scenario NAME] [--json FILE] [--figure FILE]

All are measured in one process; tick and floor take turns, so that a busy machine slows them
alike. The floor is `pin.computeAllTerms` on the model of the same arms at the same q, v.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.measuring import bars, machine, machine_lines, new_axes
from benchmarks.timing import time_parts
from osc_contact.errors import OscContactError
from osc_contact.runs.report import write_json
from osc_contact.runs.rig import build_rig
from osc_contact.scenarios import load_scenario

COLUMNS = ("p50", "p99", "p99_9", "max")


def measure(scenarios: list[str], ticks: int) -> dict[str, Any]:
    """{"machine": …, "cases": {scenario: times}}, see `TickTimes.as_dict`."""
    cases = {
        name: time_parts(build_rig(load_scenario(name)), ticks).as_dict() for name in scenarios
    }
    return {"machine": machine(), "cases": cases}


def tables(result: dict[str, Any]) -> list[Table]:
    """One table a case: the floor, the tick, what of it is the law."""
    found = []
    for name, case in result["cases"].items():
        title = f"{name}: {case['rounds']} ticks, tick / floor = {case['ratio']:.2f}"
        table = Table("µs", *COLUMNS, title=title)
        _add(table, "floor: computeAllTerms", case["floor_us"], style="bold")
        _add(table, "tick", case["tick_us"], style="bold")
        for label, times in case["inside_us"].items():
            _add(table, f"  of it {label}", times)
        found.append(table)
    return found


def _add(table: Table, label: str, times: dict[str, float], style: str = "") -> None:
    table.add_row(label, *(f"{times[key]:.1f}" for key in COLUMNS), style=style)


def draw(result: dict[str, Any], path: Path) -> None:
    """Medians of tick and inner calls as bars, the floor beside them (PNG and SVG)."""
    from osc_contact.visual.plots import save, style

    floor = "floor: computeAllTerms"
    with style():
        cases = result["cases"]
        figure, axes = new_axes(len(cases), height=4.2)
        for ax, (name, case) in zip(axes, cases.items(), strict=True):
            parts = {floor: case["floor_us"], "tick": case["tick_us"]}
            parts |= {f"of it {name}": times for name, times in case["inside_us"].items()}
            medians = {name: times["p50"] for name, times in parts.items()}
            bars(ax, medians, "median time (µs)", marked=[floor])
            tick = case["tick_us"]
            ax.set_title(f"{name}: tick p50 {tick['p50']:.1f} µs, p99.9 {tick['p99_9']:.1f} µs, "
                         f"{case['ratio']:.1f} × floor")  # fmt: skip
        save(figure, path.with_suffix(""))


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", action="append", help="default: two_contact_rod")
    parser.add_argument("--ticks", type=int, default=2000, help="rounds (default %(default)s)")
    parser.add_argument("--json", type=Path, help="write the result here")
    parser.add_argument("--figure", type=Path, help="draw the parts here (needs matplotlib)")
    chosen = parser.parse_args()
    try:
        result = measure(chosen.scenario or ["two_contact_rod"], chosen.ticks)
    except OscContactError as error:
        parser.error(str(error))
    out = Console(width=None if os.isatty(1) else 100)
    for line in machine_lines(result["machine"]):
        out.print(line, highlight=False)
    for table in tables(result):
        out.print(table)
    if chosen.json:
        write_json(result, chosen.json)
    if chosen.figure:
        draw(result, chosen.figure)


if __name__ == "__main__":
    main()
