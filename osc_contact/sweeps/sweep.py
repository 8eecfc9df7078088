"""A sweep: every run of a study, on all cores, gone on with where it was interrupted."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from osc_contact.scenarios.schema import Scenario
from osc_contact.sweeps.rows import crashed_row, make_rows, require_long_enough, scenario_of
from osc_contact.sweeps.study import Design, SweepStudy
from osc_contact.sweeps.table import RowFile, make_table, write_table

__all__ = ["ROWS", "TABLE", "available_cores", "leave_signals_to_the_parent", "run_study", "sweep"]

ROWS, TABLE = "rows.jsonl", "table.parquet"  #: files of a sweep's folder
_CHUNK = 4  #: runs that a worker is handed at once
_AHEAD = 2  #: chunks that wait for each worker

Row = dict[str, Any]
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
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
) -> Any:
    """Run a scenario many times with other numbers; one table of all results.

    Row i depends on the study and i alone: not on how many workers there are, and not on whether
    the sweep was interrupted. It equals `osc.run` of its scenario with its seed.

    Args:
        scenario: packaged name, file, or a scenario made in Python, without Python laws and pairs.
        vary: {"path.to.key": "uniform(0.8, 1.2)"}, see `sweeps.distributions.WORDS`; the path
            "seed" is the seed of each run.
        samples: how many points; on a grid, how many values of each key that can have any.
        design: "halton" or "sobol" (quasi-random), "latin", "random" or "grid".
        seed: of the points, and of each run where it does not vary.
        out: a folder for rows and table; rows that are done there are not run again.
        workers: processes; None: one for each core; 1: none but this one.
        overrides: path=value, of all runs.
        progress: called with the rows done and all rows, now and then.

    Returns:
        A `pyarrow.Table` sorted by row: row, seed, what varied, word, failed, why, and the numbers
        of `metrics`. Runs that could not be built, diverged or crashed have a word and a reason.

    Raises:
        ScenarioError, InvalidInputError: the study is not understood; runs too short to be judged;
            the folder holds another study.
    """
    study = SweepStudy.of(scenario, vary, samples, design, seed, overrides)
    return run_study(study, out=out, workers=workers, progress=progress)


def run_study(
    study: SweepStudy,
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Any:
    """Run what is not done yet of a study, see `sweep`.

    Args:
        study: what to run.
        out, workers, progress: as of `sweep`.
    """
    import pyarrow  # noqa: F401 - refused before the runs, not after them

    require_long_enough(scenario_of(study, study.sample(0)))
    rows = None if out is None else RowFile(Path(out) / ROWS, study)
    done = {} if rows is None else rows.done
    done = {number: row for number, row in done.items() if number < study.rows}
    wanted = [number for number in range(study.rows) if number not in done]
    count = available_cores() if workers is None else workers
    try:
        for some in _run(study, wanted, min(count, len(wanted))):
            done.update((row["row"], row) for row in some)
            if rows is not None:
                rows.append(some)
            if progress is not None:
                progress(len(done), study.rows)
    finally:
        if rows is not None:
            rows.close()
    table = make_table(list(done.values()), study)
    if out is not None:
        write_table(table, Path(out) / TABLE)
    return table


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run(study: SweepStudy, wanted: Sequence[int], workers: int) -> Iterator[list[Row]]:
    if workers <= 1:
        for number in wanted:
            yield make_rows(study, [number])
        return
    chunks = [list(wanted[i : i + _CHUNK]) for i in range(0, len(wanted), _CHUNK)]
    lost: list[int] = []
    yield from _in_processes(study, chunks, workers, lost)
    for number in lost:  # those that may have ended a worker: each alone, in one of its own
        died: list[int] = []
        yield from _in_processes(study, [[number]], 1, died)
        if died:
            yield [crashed_row(study, number)]


def _in_processes(
    study: SweepStudy, chunks: Iterable[list[int]], workers: int, lost: list[int]
) -> Iterator[list[Row]]:
    """Rows as they come; `lost`: of chunks that were under way when a worker died."""
    waiting = iter(chunks)
    context = get_context("spawn")  # threads of this process would not survive a fork
    with ProcessPoolExecutor(workers, context, leave_signals_to_the_parent) as pool:
        under_way: dict[Future[list[Row]], list[int]] = {}
        broken = False
        try:
            while True:
                while not broken and len(under_way) < workers * _AHEAD:
                    chunk = next(waiting, None)
                    if chunk is None:
                        break
                    try:
                        under_way[pool.submit(make_rows, study, chunk)] = chunk
                    except BrokenProcessPool:
                        broken = True
                        lost.extend(chunk)
                if not under_way:
                    break
                ended, _ = wait(under_way, return_when=FIRST_COMPLETED)
                for future in ended:
                    chunk = under_way.pop(future)
                    try:
                        yield future.result()
                    except BrokenProcessPool:
                        broken = True
                        lost.extend(chunk)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    if broken:
        yield from _in_processes(study, waiting, workers, lost)


def leave_signals_to_the_parent() -> None:
    """Ctrl-C goes to all processes of a terminal; workers end when their parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
