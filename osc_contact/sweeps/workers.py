"""Who makes rows: this process, processes of this machine, or the workers of a dask cluster."""

from __future__ import annotations

import gc
import os
import signal
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
from itertools import islice
from multiprocessing import get_context, parent_process
from typing import Any

from osc_contact.errors import OscContactError
from osc_contact.law import compiled
from osc_contact.sweeps.rows import crashed_row
from osc_contact.sweeps.study import SweepStudy

__all__ = ["make_all", "workers_of"]

_AHEAD = 2  #: jobs that wait for each worker

Row = dict[str, Any]
Job = tuple[SweepStudy, Sequence[int]]  #: a study, and the numbers of the rows to make
MakesRows = Callable[[SweepStudy, Sequence[int]], list[Row]]


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
            from osc_contact.sweeps.cluster import KilledWorker, connect

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
