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

__all__ = ["Job", "Workers", "available_cores", "make_all", "workers_of"]

_AHEAD = 2  #: jobs that wait for each worker

Row = dict[str, Any]
Job = tuple[SweepStudy, Sequence[int]]  #: a study, and the numbers of the rows that are wanted
MakesRows = Callable[[SweepStudy, Sequence[int]], list[Row]]


class Workers:
    """Workers in other processes.

    Attributes:
        count: how many there are now.
        deaths: what a job raises that has ended its worker.
    """

    def __init__(
        self,
        executor: Callable[[], Executor],
        count: Callable[[], int],
        deaths: type[Exception] = BrokenExecutor,
    ) -> None:
        """Have an executor made.

        Args:
            executor: makes one, and another one where a worker's death broke the first.
            count, deaths: see above.
        """
        self._executor, self._made = executor, executor()
        self.count, self.deaths = count, deaths

    def submit(self, make: MakesRows, job: Job) -> Future[list[Row]]:
        """Have a job done.

        Args:
            make: makes its rows. job: what it is given.
        """
        return self._made.submit(make, *job)

    def wake(self, count: int) -> None:
        """Have processes start and import this package while their work is prepared."""
        for _ in range(count):
            self._made.submit(available_cores)

    def renew(self) -> None:
        """Go on after a worker's death."""
        self.close()
        self._made = self._executor()

    def close(self) -> None:
        """Wait for what is under way."""
        self._made.shutdown()


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
            made.wake(count)
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
    a row that says so.

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
    yield from _hand_out(workers, jobs, make, lost)
    for study, numbers in lost:
        for number in numbers:  # it may have ended a worker: now alone
            died: list[Job] = []
            yield from _hand_out(workers, [(study, [number])], make, died)
            if died:
                yield study, crashed_row(study, number)


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _hand_out(
    workers: Workers, jobs: Iterable[Job], make: MakesRows, lost: list[Job]
) -> Iterator[tuple[SweepStudy, Row]]:
    """Rows as they come; `lost`: jobs that were under way when a worker died."""
    waiting = iter(jobs)
    under_way: dict[Future[list[Row]], Job] = {}
    broken = False
    try:
        while True:
            ahead = 0 if broken else workers.count() * _AHEAD - len(under_way)
            for job in islice(waiting, max(0, ahead)):
                try:
                    under_way[workers.submit(make, job)] = job
                except workers.deaths:
                    broken = True
                    lost.append(job)
            if under_way:
                ended, _ = wait(under_way, return_when=FIRST_COMPLETED)
            elif broken:
                workers.renew()
                broken = False
                continue
            else:
                return
            for future in ended:
                job = under_way.pop(future)
                try:
                    rows = future.result()
                except workers.deaths:
                    broken = True
                    lost.append(job)
                else:
                    yield from ((job[0], row) for row in rows)
    except CancelledError as error:
        raise OscContactError(
            "the cluster has gone; start it again, and the same call goes on with what is done"
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
