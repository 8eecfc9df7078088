"""A sweep: every run of a study, on all cores, continued where it was interrupted."""

import gc
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import ExitStack, closing, contextmanager
from itertools import islice
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

from osc_contact.errors import OscContactError
from osc_contact.files import whole_file
from osc_contact.law import compiled
from osc_contact.scenarios.schema import Scenario
from osc_contact.sweeps.rows import (
    Row,
    RowFile,
    crashed_row,
    make_rows,
    make_table,
    require_long_enough,
    scenario_of,
)
from osc_contact.sweeps.study import Design, SweepStudy

ROWS = "rows.jsonl"  #: file of a sweep's folder
TABLE = "table.parquet"  #: file of a sweep's folder
_CHUNK = 4  #: runs that a worker is handed at once

Progress = Callable[[int, int], None]
Job = tuple[SweepStudy, Sequence[int]]  #: a study, and the numbers of the rows to make
MakesRows = Callable[[SweepStudy, Sequence[int]], list[Row]]


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
    from pyarrow import parquet  # refused before the runs, not after them

    file = None if out is None else Path(out) / ROWS
    done = run_rows(study, file, workers=workers, scheduler=scheduler, progress=progress)
    table = make_table(list(done.values()), study)
    if out is not None:
        with whole_file(Path(out) / TABLE) as unfinished:
            parquet.write_table(table, unfinished)
    return table


def run_rows(
    study: SweepStudy,
    file: Path | None,
    make: MakesRows = make_rows,
    *,
    laws: Any = None,
    workers: int | None = None,
    scheduler: Any = None,
    progress: Progress | None = None,
) -> dict[int, Row]:
    """Rows of a study by number: those of a file, and what is not done yet.

    Args:
        study: what to run.
        file: for the rows; None: they are not kept.
        make: makes rows; other processes import it.
        laws: see `RowFile`.
        workers, scheduler, progress: as of `sweep`.
    """
    require_long_enough(scenario_of(study, study.sample(0)))
    with ExitStack() as stack:
        rows = None
        if file is not None:
            rows = stack.enter_context(closing(RowFile(file, study, laws)))
        done = {} if rows is None else rows.done
        left = [number for number in range(study.rows) if number not in done]
        ended = study.rows - len(left)
        jobs = [(study, left[i : i + _CHUNK]) for i in range(0, len(left), _CHUNK)]
        crew = stack.enter_context(workers_of(workers, scheduler, len(jobs)))
        for _, row in make_all(crew, jobs, make):
            done[row["row"]] = row
            ended += 1
            if rows is not None:
                rows.append([row])
            if progress is not None:
                progress(ended, study.rows)
    return {number: done[number] for number in range(study.rows)}


# Who makes rows: this process, processes of this machine, or the workers of a dask cluster.


_AHEAD = 2  #: jobs that wait for each worker


class Workers:
    """Workers in other processes.

    Args:
        executor: makes one, and another one where a worker's death broke the first.
        count: how many workers there are now.
        deaths: what a job raises that has ended its worker.
    """

    def __init__(
        self,
        executor: Callable[[], Executor],
        count: Callable[[], int],
        deaths: type[Exception] = BrokenExecutor,
    ) -> None:
        self._make = executor
        self._executor = executor()
        self.count = count
        self.deaths = deaths

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have a function called, by a new executor where a worker's death broke the last one."""
        try:
            return self._executor.submit(function, *arguments)
        except BrokenExecutor:
            self.close()
            self._executor = self._make()
            return self._executor.submit(function, *arguments)

    def close(self) -> None:
        """Wait for what is under way."""
        self._executor.shutdown()


@contextmanager
def workers_of(workers: int | None, scheduler: Any, most: int) -> Iterator[Workers | None]:
    """Workers while the block lasts; None: this process does it.

    Args:
        workers: processes; None: one for each core. scheduler: see `sweep`.
        most: how many can have work.

    Raises:
        InvalidInputError: the cluster cannot be used, see `cluster.connect`.
    """
    count = min(available_cores() if workers is None else workers, most)
    if scheduler is None and count <= 1:
        yield None
        return
    with ExitStack() as stack:
        if scheduler is None:
            context = get_context("spawn")  # threads of this process would not survive a fork
            made = Workers(lambda: ProcessPoolExecutor(count, context, _begin_work), lambda: count)
            for _ in range(count):  # they import this package while their work is prepared
                made.submit(available_cores)
        else:
            from distributed.scheduler import KilledWorker

            from osc_contact.sweeps.cluster import connect

            client = stack.enter_context(connect(scheduler, workers))
            made = Workers(
                client.get_executor, lambda: max(1, sum(client.nthreads().values())), KilledWorker
            )
        stack.callback(made.close)
        compiled.rows()  # compiled once if need be, not in every worker
        yield made


def make_all(
    workers: Workers | None, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[SweepStudy, Row]]:
    """All rows of all jobs, in the order in which they are done.

    Where a worker dies its jobs are done again, row by row; a row that ends its worker then too is
    a row that states it.

    Args:
        workers: see `workers_of`; None: this process. jobs: what is to be done.
        make: makes the rows of a job, such as `make_rows`; other processes import it.
    """
    if workers is None:
        for study, numbers in jobs:
            for number in numbers:
                yield study, make(study, [number])[0]
        return
    lost: list[Job] = []
    for (study, numbers), rows in _hand_out(workers, jobs, make):
        if rows is None:
            lost += [(study, [number]) for number in numbers]
        else:
            yield from ((study, row) for row in rows)
    for job in lost:  # it may have ended a worker: now alone
        for (study, numbers), rows in _hand_out(workers, [job], make):
            yield study, rows[0] if rows else crashed_row(study, numbers[0])


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _hand_out(
    workers: Workers, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[Job, list[Row] | None]]:
    """Jobs with their rows as they come; None: a worker died while the job was under way."""
    waiting = iter(jobs)
    under_way: dict[Future[list[Row]], Job] = {}
    try:
        while True:
            for job in islice(waiting, max(0, workers.count() * _AHEAD - len(under_way))):
                under_way[workers.submit(make, *job)] = job
            if not under_way:
                return
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                job = under_way.pop(future)
                try:
                    rows = future.result()
                except workers.deaths:
                    rows = None
                yield job, rows
    except CancelledError as error:
        raise OscContactError(
            "the cluster is lost; start it again, and the same call continues with what is done"
        ) from error
    finally:
        for future in under_way:
            future.cancel()


def _end_with_parent() -> None:
    """Wait until the parent process has ended, which a kill does not let it announce; then end."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _begin_work() -> None:
    """A worker process begins.

    Ctrl-C goes to all processes of a terminal; workers end when their parent does, however it ends.
    And at once, not in order as a run does by itself: nobody reads its recording any more.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        signal.signal(number, lambda number, frame: os._exit(128 + number))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    gc.freeze()  # what is imported stays; not looked through again with every run
