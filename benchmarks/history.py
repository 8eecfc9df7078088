"""How fast tick and run have been, commit by commit: one line of JSON for each measurement.

python -m benchmarks.history [--ticks N] [--file FILE] [--figure FILE]

Measures, appends to benchmarks/history.jsonl and draws all its lines. Ratios to Pinocchio's own
evaluation, and how many times faster than real time a run is; compare lines of one machine.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks import simulation
from benchmarks import tick as bench_ticks
from benchmarks.measuring import machine, new_axes

__all__ = ["append", "draw", "measure"]

FILE = Path(__file__).parent / "history.jsonl"
CASES = ("two_contact_rod", "one_panda", "two_pandas")


def measure(ticks: int) -> dict[str, Any]:
    """One line: when, which commit (`-dirty` with changes), on what, and how fast."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=10"],
        cwd=FILE.parent, capture_output=True, text=True, check=True,
    ).stdout.strip()  # fmt: skip
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit,
        "cpu": machine()["cpu"],
        "tick_over_floor": {
            case: row["ratio"] for case, row in bench_ticks.measure(ticks, CASES).items()
        },
        "run_real_time_factor": simulation.measure(10 * ticks)["real_time_factor"],
    }


def append(line: dict[str, Any], file: Path) -> list[dict[str, Any]]:
    """Add a line to a file; returns all that it has then."""
    with file.open("a", encoding="utf-8") as history:
        history.write(json.dumps(line) + "\n")
    return [json.loads(text) for text in file.read_text(encoding="utf-8").splitlines()]


def draw(lines: list[dict[str, Any]], path: Path) -> None:
    """Ratios and real-time factor over the commits."""
    from osc_contact.visual.style import legend, save, style

    with style():
        figure, (above, below) = new_axes(2, height=2.4)
        commits = range(len(lines))
        for case in CASES:
            ratios = [line["tick_over_floor"].get(case) for line in lines]
            above.plot(commits, ratios, "o-", ms=3, label=case)
        below.plot(commits, [line["run_real_time_factor"] for line in lines], "o-", ms=3)
        above.set(ylabel="tick / floor", ylim=(0, None), xticks=[])
        below.set(ylabel="× real time", ylim=(0, None), xticks=commits)
        below.set_xticklabels([line["commit"] for line in lines], rotation=60, ha="right")
        legend(above)
        save(figure, path.with_suffix(""), (path.suffix,))


def main() -> None:
    """Measure, append, draw."""
    ask = argparse.ArgumentParser()
    ask.add_argument("--ticks", type=int, default=1000)
    ask.add_argument("--file", type=Path, default=FILE)
    ask.add_argument("--figure", type=Path)
    asked = ask.parse_args()
    line = measure(asked.ticks)
    print(json.dumps(line, indent=1))
    lines = append(line, asked.file)
    if asked.figure:
        draw(lines, asked.figure)


if __name__ == "__main__":
    main()
