"""What a run costs within a sweep, and by itself.

python -m benchmarks.many_runs
"""

from __future__ import annotations

from time import thread_time
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import osc_contact as osc
from osc_contact.sweeps.rows import make_rows, scenario_of, without_doubts_told
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.workers import available_cores

VARY = (
    "model_error.object_mass=uniform(0.8, 1.2)",
    "model_error.arm_mass=uniform(0.8, 1.2)",
    "contacts.left_end.face.normal=tilt(5 deg)",
    "contacts.right_end.face.normal=tilt(5 deg)",
)


def time_rows(runs: int, duration: float) -> tuple[float, float]:
    """Least processor time (s) of a row, and of the same run by itself, taken in turns."""
    study = SweepStudy.of("two_contact_rod", VARY, runs, overrides=(f"duration={duration!r}",))
    least = [np.inf, np.inf]
    for number in range(runs):
        sample = study.sample(number)
        start = thread_time()
        make_rows(study, [number])
        middle = thread_time()
        with without_doubts_told():
            changes = [*study.overrides, *(f"{k}={v}" for k, v in sample.overrides.items())]
            scenario = osc.load_scenario("two_contact_rod", changes)
            osc.metrics(osc.run(scenario, seed=sample.seed))
        took = middle - start, thread_time() - middle
        if number:  # the first finds nothing made
            least = [min(pair) for pair in zip(least, took, strict=True)]
    assert scenario_of(study, sample) == scenario
    return least[0], least[1]


def main(
    runs: Annotated[int, typer.Option(min=3, help="of the sweep, each also by itself")] = 20,
    duration: Annotated[float, typer.Option(help="of each run (s)")] = 2.0,
) -> None:
    """Print both, the least of all times."""
    row, single = time_rows(runs, duration)
    cores = available_cores()
    table = Table("quantity", "value")
    table.add_row(f"a row of a sweep, two_contact_rod, {duration:g} s", f"{1e3 * row:.0f} ms")
    table.add_row("the same run by itself", f"{1e3 * single:.0f} ms")
    table.add_row(f"1000 rows on {cores} cores, extrapolated", f"{1e3 * row / cores:.0f} s")
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
