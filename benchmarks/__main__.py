"""Time the control tick beside its peers, by size, on the clock, and in a whole run.

python -m benchmarks peers | scaling | jitter | front_end | simulation | many_runs | vector_env |
soak
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from osc_contact.bench.program import IN_PACKAGE, run_benchmark
from osc_contact.errors import OscContactError

BENCHMARKS: dict[str, tuple[str, int]] = {
    **IN_PACKAGE,
    "peers": ("benchmarks.peers", 500),
    "scaling": ("benchmarks.scaling", 300),
    "jitter": ("benchmarks.jitter", 4000),
    "front_end": ("benchmarks.front_end", 2000),
    "simulation": ("benchmarks.simulation", 10000),
    "soak": ("benchmarks.soak", 1_800_000),
    "many_runs": ("benchmarks.many_runs", 20),
    "vector_env": ("benchmarks.vector_env", 60),
}


def main(
    what: Annotated[str, typer.Argument(help=" | ".join(BENCHMARKS), metavar="WHAT")],
    ticks: Annotated[int | None, typer.Option(min=1, help="timed ticks of each case")] = None,
    tsid_python: Annotated[Path | None, typer.Option(help="peers: TSID's interpreter")] = None,
    figure: Annotated[Path | None, typer.Option(help="also draw it (PNG, SVG)")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="also write the data")] = None,
) -> None:
    """Time the control tick beside its peers, by size, on the clock, and in a whole run."""
    try:
        report = run_benchmark(what, ticks, json_file, figure, tsid_python, BENCHMARKS)
    except OscContactError as error:
        sys.exit(f"error: {error}")
    console = Console()
    console.print("\n".join(report.lines), highlight=False, markup=False)
    for table in report.tables:
        console.print(table)


if __name__ == "__main__":
    typer.run(main)
