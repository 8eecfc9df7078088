"""Workers of a sweep: processes of this machine, or the workers of a dask cluster.

`Workers._executor` has the processes or the client of a cluster that run jobs.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context, parent_process
from multiprocessing.context import BaseContext
from typing import TYPE_CHECKING, Any

from osc_contact.errors import InvalidInputError, OscContactError
from osc_contact.lab.sweeps.rows import CRASHED, Row, first_columns
from osc_contact.lab.sweeps.study import SweepStudy
from osc_contact.law import compiled

if TYPE_CHECKING:
    import distributed

_JOBS_PER_WORKER = 2  #: jobs that are submitted for each worker

Job = tuple[SweepStudy, Sequence[int]]  #: a study, and the numbers of the rows to make
MakesRows = Callable[[SweepStudy, Sequence[int]], list[Row]]


@dataclass
class Workers:
    """Workers in other processes.

    Attributes:
        executor: function that makes an executor, and a new one if the death of a worker has broken
            the last.
        count: function that returns the present number of workers.
        deaths: error of a job that has ended its worker.
    """

    executor: Callable[[], Executor]
    count: Callable[[], int]
    deaths: type[Exception] = BrokenExecutor

    def __post_init__(self) -> None:
        """Make the first executor."""
        self._executor = self.executor()  #: processes or threads of the runs

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Submit a call to the workers; a broken executor is replaced before.

        Args:
            function: function that other processes import.
            arguments: its arguments, which are pickled.

        Returns:
            Future result of the call.
        """
        try:
            return self._executor.submit(function, *arguments)
        except BrokenExecutor:
            self.close()
            self._executor = self.executor()
            return self._executor.submit(function, *arguments)

    def close(self) -> None:
        """Wait for the calls in progress and end the workers."""
        self._executor.shutdown()


@contextmanager
def workers_of(
    workers: int | None, scheduler: str | distributed.Client | None, limit: int
) -> Iterator[Workers | None]:
    """Yield workers for the block; None: this process makes the rows.

    Args:
        workers: number of processes; None: one for each core.
        scheduler: dask cluster, see `sweep.sweep`; None: processes of this machine.
        limit: largest number of workers that have something to do.

    Raises:
        InvalidInputError: both are given; the cluster cannot be used, see `cluster.connect`.
    """
    if workers is not None and scheduler is not None:
        raise InvalidInputError(f"{workers} workers: a cluster has its own; leave workers out")
    count = min(available_cores() if workers is None else workers, limit)
    if scheduler is None and count <= 1:
        yield None
        return
    with ExitStack() as stack:
        if scheduler is None:
            crew = Workers(lambda: _processes(count), lambda: count)
            for _ in range(count):  # they begin while their work is prepared
                crew.submit(available_cores)
        else:
            from distributed.scheduler import KilledWorker

            from osc_contact.lab.sweeps.cluster import connect

            client = stack.enter_context(connect(scheduler))
            crew = Workers(
                client.get_executor, lambda: max(1, sum(client.nthreads().values())), KilledWorker
            )
        stack.callback(crew.close)
        compiled.rows()  # compiled here, so that the workers load the library
        yield crew


def _processes(count: int) -> ProcessPoolExecutor:
    """Executor of new processes; on Linux they are forked from one that has imported the package.

    This process itself is not forked, because its threads would not survive.

    Args:
        count: number of processes.
    """
    if sys.platform == "linux":
        context: BaseContext = get_context("forkserver")
        context.set_forkserver_preload([__name__, "mujoco"])
    else:
        context = get_context("spawn")
    return ProcessPoolExecutor(count, context, _begin_work, (dict(os.environ),))


def make_all(
    workers: Workers | None, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[SweepStudy, Row]]:
    """Rows of all jobs with their studies, in the order of their completion.

    The jobs of a worker whose process has died are repeated row by row; a row whose worker dies
    again becomes a row with this error.

    Args:
        workers: workers; None: this process.
        jobs: the jobs.
        make: function that makes the rows of a job, which other processes import.
    """
    if workers is None:
        for study, numbers in jobs:
            for number in numbers:
                yield (study, make(study, [number])[0])
        return
    repeated: list[Job] = []  # each with one row
    for (study, numbers), rows in _hand_out(workers, jobs, make):
        if rows is None:
            repeated += [(study, [number]) for number in numbers]
        else:
            for row in rows:
                yield (study, row)
    for job in repeated:  # one at a time, so that a crash concerns no other row
        for (study, numbers), rows in _hand_out(workers, [job], make):
            if rows:
                yield (study, rows[0])
            else:
                why = "its process died twice; run it alone to find the cause"
                yield (study, first_columns(study.sample(numbers[0]), CRASHED, why))


def available_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _hand_out(
    workers: Workers, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[Job, list[Row] | None]]:
    """Yield jobs with their rows, in the order of their completion.

    Only a few jobs for each worker are submitted at a time, so that little is lost if it ends.

    Args:
        workers: workers in other processes.
        jobs: jobs to be done.
        make: function that makes the rows of a job, which other processes import.

    Yields:
        Job, and its rows; None in place of the rows if the worker of the job has died.

    Raises:
        OscContactError: the cluster is lost.
    """
    job_iterator = iter(jobs)
    jobs_by_future: dict[Future[list[Row]], Job] = {}
    try:
        while True:
            # number of jobs that may be submitted now; workers may join or leave at any time
            free_places = max(0, workers.count() * _JOBS_PER_WORKER - len(jobs_by_future))
            for job in islice(job_iterator, free_places):
                jobs_by_future[workers.submit(make, *job)] = job
            if not jobs_by_future:
                return
            for future in wait(jobs_by_future, return_when=FIRST_COMPLETED).done:
                job = jobs_by_future.pop(future)
                try:
                    rows = future.result()
                except workers.deaths:
                    rows = None
                yield (job, rows)
    except CancelledError as error:
        raise OscContactError(
            "the cluster is lost; start it again, and the same call continues with what is done"
        ) from error
    finally:
        for future in jobs_by_future:
            future.cancel()


def end_with_parent() -> None:
    """Wait until the parent process has ended, however it ends, and end this process."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _begin_work(environment: dict[str, str]) -> None:
    """Initialise a worker process.

    Ctrl-C reaches all processes of a terminal and is ignored here; a worker ends when its parent
    ends. A signal ends it at once, without a recording, which would not be read.

    Args:
        environment: environment variables of the process that starts the worker.
    """
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        signal.signal(number, lambda number, frame: os._exit(128 + number))
    threading.Thread(target=end_with_parent, daemon=True).start()
    gc.freeze()  # modules stay in memory: collections need not visit them
