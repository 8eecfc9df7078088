"""What a run costs within a sweep, and how fast many plants advance together.

python -m benchmarks.many_runs
"""

from __future__ import annotations

from time import perf_counter, thread_time
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import osc_contact as osc
from osc_contact.sweeps.rows import make_rows, scenario_of, without_doubts_told
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.sweep import available_cores

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


def time_fleet(rows: int, threads: int, steps: int) -> tuple[float, float]:
    """Control ticks a second of a vector environment, and the share of time spent in control."""
    env = osc.make_vector_env("panda_edge", rows, threads=threads)
    env.reset(seed=0)
    spent, control = [0.0], env.fleet.control.tick

    def timed(*args: object) -> object:
        start = perf_counter()
        tau = control(*args)
        spent[0] += perf_counter() - start
        return tau

    env.fleet.control.tick = timed  # type: ignore[method-assign, assignment]
    hold = np.zeros(env.action_space.shape)
    best = (0.0, 1.0)
    for _ in range(steps):
        spent[0], start = 0.0, perf_counter()
        env.step(hold)
        took = perf_counter() - start
        best = max(best, (20 * rows / took, spent[0] / took))
    return best


def main(
    runs: Annotated[int, typer.Option(min=3, help="of the sweep, each also by itself")] = 20,
    duration: Annotated[float, typer.Option(help="of each run (s)")] = 2.0,
    rows: Annotated[int, typer.Option(min=1, help="of the vector environment")] = 64,
    steps: Annotated[int, typer.Option(min=1, help="of the vector environment")] = 40,
) -> None:
    """Print both, the least of all times."""
    row, single = time_rows(runs, duration)
    cores = available_cores()
    table = Table("quantity", "value")
    table.add_row(f"a row of a sweep, two_contact_rod, {duration:g} s", f"{1e3 * row:.0f} ms")
    table.add_row("the same run by itself", f"{1e3 * single:.0f} ms")
    table.add_row(f"1000 rows on {cores} cores, extrapolated", f"{1e3 * row / cores:.0f} s")
    for threads in sorted({1, cores}):
        rate, share = time_fleet(rows, threads, steps)
        table.add_row(f"control ticks of {rows} Pandas, {threads} threads", f"{rate:.0f} a second")
        table.add_row("… of which control", f"{share:.0%}")
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
