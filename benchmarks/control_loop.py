"""Time the control tick, its twin's parts and Pinocchio's own model evaluation, side by side.

    python benchmarks/control_loop.py [--ticks N] [--scenario NAME] [--json FILE] [--figure FILE]

All are measured in one process; tick and floor take turns, so that a busy machine slows them
alike. The floor is `pin.computeAllTerms` on the model of the same arms at the same q, v.
"""

from __future__ import annotations

import argparse
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from osc_contact.errors import OscContactError
from osc_contact.experiments.report import write_json
from osc_contact.experiments.rig import build_rig
from osc_contact.experiments.timing import time_parts
from osc_contact.scenarios import load_scenario

PACKAGES = ("osc-contact", "pin", "numpy", "numba", "mujoco")
COLUMNS = ("p50", "p99", "p99_9", "max")


def machine() -> dict[str, Any]:
    """What the numbers were measured on."""
    return {
        "cpu": _cpu(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "packages": {name: found for name in PACKAGES if (found := _version(name))},
    }


def measure(scenarios: list[str], ticks: int) -> dict[str, Any]:
    """{"machine": …, "cases": {scenario: times}}, see `TickTimes.as_dict`."""
    cases = {
        name: time_parts(build_rig(load_scenario(name)), ticks).as_dict() for name in scenarios
    }
    return {"machine": machine(), "cases": cases}


def tables(result: dict[str, Any]) -> list[Table]:
    """One table a case: the tick, the floor, then every part."""
    found = []
    for name, case in result["cases"].items():
        title = f"{name}: {case['rounds']} ticks, tick / floor = {case['ratio']:.2f}"
        table = Table("µs", *COLUMNS, title=title)
        _add(table, "floor: computeAllTerms", case["floor_us"], style="bold")
        _add(table, "tick", case["tick_us"], style="bold")
        for label, times in case["inside_us"].items():
            _add(table, f"  of it {label}", times)
        table.add_section()
        _add(table, "readable twin", case["readable_us"], style="bold")
        for label, times in case["parts_us"].items():
            _add(table, label, times)
        found.append(table)
    return found


def _add(table: Table, label: str, times: dict[str, float], style: str = "") -> None:
    table.add_row(label, *(f"{times[key]:.1f}" for key in COLUMNS), style=style)


def draw(result: dict[str, Any], path: Path) -> None:
    """Medians of tick and inner calls as bars, the floor beside them (PNG and SVG)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from osc_contact.visual import OKABE_ITO
    from osc_contact.visual.plots import save, style

    with style():
        cases = result["cases"]
        figure = Figure(figsize=(8.0, 4.2 * len(cases)))
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(cases), 1, squeeze=False)[:, 0]
        for ax, (name, case) in zip(axes, cases.items(), strict=True):
            parts = {"floor: computeAllTerms": case["floor_us"], "tick": case["tick_us"]}
            parts |= {f"of it {name}": times for name, times in case["inside_us"].items()}
            medians = [times["p50"] for times in parts.values()]
            colours = [OKABE_ITO["vermillion"], *[OKABE_ITO["blue"]] * (len(parts) - 1)]
            bars = ax.barh(list(parts), medians, color=colours)
            ax.bar_label(bars, fmt="{:.1f}", padding=3, fontsize=8.5)
            ax.invert_yaxis()
            ax.grid(axis="y", visible=False)
            ax.margins(x=0.1)
            tick = case["tick_us"]
            ax.set(xlabel="median time (µs)", title=f"{name}: tick p50 {tick['p50']:.1f} µs, "
                   f"p99.9 {tick['p99_9']:.1f} µs, {case['ratio']:.1f} × floor")  # fmt: skip
        save(figure, path.with_suffix(""))


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


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
    about = result["machine"]
    packages = ", ".join(f"{name} {found}" for name, found in about["packages"].items())
    out.print(f"{about['cpu']}, {about['cores']} cores, {about['system']}", highlight=False)
    out.print(f"Python {about['python']}, {packages}", highlight=False)
    for table in tables(result):
        out.print(table)
    if chosen.json:
        write_json(result, chosen.json)
    if chosen.figure:
        draw(result, chosen.figure)


if __name__ == "__main__":
    main()
