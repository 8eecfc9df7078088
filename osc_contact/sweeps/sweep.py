"""A sweep: every run of a study, on all cores, continued where it was interrupted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from osc_contact.scenarios.schema import Scenario
from osc_contact.sweeps.rows import (
    RowFile,
    make_rows,
    make_table,
    require_long_enough,
    scenario_of,
    write_table,
)
from osc_contact.sweeps.study import Design, SweepStudy
from osc_contact.sweeps.workers import make_all, workers_of

__all__ = ["ROWS", "TABLE", "run_study", "sweep"]

ROWS = "rows.jsonl"  #: file of a sweep's folder
TABLE = "table.parquet"  #: file of a sweep's folder
_CHUNK = 4  #: runs that a worker is handed at once

Progress = Callable[[int, int], None]


def sweep(
    scenario: str | Path | Scenario,
    vary: Mapping[str, str] | Sequence[str],
    samples: int,
    *,
    design: Design = "halton",
    seed: int = 0,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: Any = None,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
) -> Any:
    """Run a scenario many times with other numbers; one table of all results.

    Row i depends on the study and i alone: not on how many workers there are, and not on whether
    the sweep was interrupted. It equals `osc.run` of its scenario with its seed.

    Args:
        scenario: packaged name, file, or a scenario made in Python, without Python laws and pairs.
        vary: {"path.to.key": "uniform(0.8, 1.2)"}, see `sweeps.study.WORDS`; the path
            "seed" is the seed of each run.
        samples: how many points; on a grid, how many values of each key that can have any.
        design: "halton" or "sobol" (quasi-random), "latin", "random" or "grid"; "saltelli" for
            Sobol's indices, with keys + 2 runs of each of 2^m samples.
        seed: of the points, and of each run where it does not vary.
        out: a folder for rows and table; rows that are done there are not run again.
        workers: processes; None: one for each core; 1: none but this one.
        scheduler: of a dask cluster whose workers do it instead: its address, a
            `distributed.Client`, or "local" for a cluster of `workers` processes.
        overrides: path=value, of all runs.
        progress: called with the rows done and all rows, now and then.

    Returns:
        A `pyarrow.Table` sorted by row: row, seed, what varied, word, failed, why, and the numbers
        of `metrics`. Runs that could not be built, diverged or crashed have a word and a reason.

    Raises:
        ScenarioError, InvalidInputError: the study is not understood; runs too short to be judged;
            the folder holds another study; the cluster does not answer or does not fit.
    """
    study = SweepStudy.of(scenario, vary, samples, design, seed, overrides)
    return run_study(study, out=out, workers=workers, scheduler=scheduler, progress=progress)


def run_study(
    study: SweepStudy,
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: Any = None,
    progress: Progress | None = None,
) -> Any:
    """Run what is not done yet of a study, see `sweep`.

    Args:
        study: what to run.
        out, workers, scheduler, progress: as of `sweep`.
    """
    import pyarrow  # noqa: F401 - refused before the runs, not after them

    require_long_enough(scenario_of(study, study.sample(0)))
    rows = None if out is None else RowFile(Path(out) / ROWS, study)
    kept = {} if rows is None else rows.done
    done = {number: kept[number] for number in range(study.rows) if number in kept}
    left = [number for number in range(study.rows) if number not in done]
    jobs = [(study, left[i : i + _CHUNK]) for i in range(0, len(left), _CHUNK)]
    try:
        with workers_of(workers, scheduler, len(jobs)) as crew:
            for _, row in make_all(crew, jobs, make_rows):
                done[row["row"]] = row
                if rows is not None:
                    rows.append([row])
                if progress is not None:
                    progress(len(done), study.rows)
    finally:
        if rows is not None:
            rows.close()
    table = make_table(list(done.values()), study)
    if out is not None:
        write_table(table, Path(out) / TABLE)
    return table
