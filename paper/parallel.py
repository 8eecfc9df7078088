"""Independent jobs on all cores, in as many processes.

What a job needs comes before it; what it makes possible is begun before what only waits. Without a
second core, or without a second job, this process does them one after another.
"""

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import Any, NamedTuple

from osc_contact.errors import OscContactError, missing
from osc_contact.lab.cli.console import err
from osc_contact.lab.sweeps.workers import available_cores, end_with_parent
from osc_contact.law import compiled
from paper.study import silent

Tell = Callable[[str], None]
#: A process for each core leaves no core to further threads of linear algebra.
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Job(NamedTuple):
    """A piece of work that other processes can import.

    Attributes:
        name: in progress and errors.
        work: takes a function that is called with the next step, and the results needed, by name.
        needs: names of the jobs whose results those are.
    """

    name: str
    work: Callable[[Tell, Mapping[str, Any]], Any]
    needs: tuple[str, ...] = ()


def done(
    jobs: Sequence[Job], first: Sequence[str] = (), cores: int | None = None
) -> Iterator[tuple[str, Any]]:
    """Names and results of all jobs, in the order in which they end.

    Args:
        jobs: jobs with different names, behind those that they need.
        first: names of jobs that take long: these begin first where there are several cores.
        cores: number of cores to be used; None: all that this process may use.

    Raises:
        OscContactError, ImportError, OSError: of the job that fails first, with its name; the
            others are ended. Also where a process was killed.
    """
    count = min(available_cores() if cores is None else cores, sum(not job.needs for job in jobs))
    if count <= 1:
        yield from _one_by_one(jobs)
        return
    rank = {name: place for place, name in enumerate(first)}
    waiting = sorted(jobs, key=lambda job: (not job.needs, rank.get(job.name, len(rank))))
    results: dict[str, Any] = {}
    under_way: dict[Future[Any], Job] = {}
    with err.status("") as status, _workers(count) as executor:
        while waiting or under_way:
            ready = [job for job in waiting if results.keys() >= set(job.needs)]
            for job in ready[: count - len(under_way)]:
                waiting.remove(job)
                needed = {name: results[name] for name in job.needs}
                under_way[executor.submit(_do, job.name, job.work, needed)] = job
            names = ", ".join(job.name for job in under_way.values())
            status.update(f"{len(results)} of {len(jobs)} done, under way: {names}")
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                name = under_way[future].name
                results[name] = _result(future, names)
                del under_way[future]
                yield name, results[name]


def _one_by_one(jobs: Sequence[Job]) -> Iterator[tuple[str, Any]]:
    """Do jobs in this process, in their order; yield name and result of each.

    Args:
        jobs: jobs, each after those whose results it needs.
    """
    results: dict[str, Any] = {}
    status = err.status("")
    for job in jobs:

        def tell(step: str, name: str = job.name) -> None:
            status.update(f"{name}: {step}" if step else name)
            status.start()

        try:
            needed = {name: results[name] for name in job.needs}
            with _named(job.name):
                results[job.name] = job.work(tell, needed)
        finally:
            status.stop()
        yield job.name, results[job.name]


def _result(future: Future[Any], names: str) -> Any:
    """The result of a job.

    Args:
        future: call of the job, which has ended.
        names: names of the jobs under way.
    """
    try:
        return future.result()
    except BrokenProcessPool as error:
        raise OscContactError(
            f"a process was killed, perhaps for want of memory, while these were under way: "
            f"{names}; make them one at a time: osc-contact reproduce NAME"
        ) from error


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Errors of the block have the name of its job."""
    try:
        yield
    except Exception as error:
        error.add_note(f"in {name}")
        raise


@contextmanager
def _workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes while the block lasts; after an error or Ctrl-C they are ended at once."""
    compiled.rows()  # compiled once if need be, not in every process
    added = {name: value for name, value in _ONE_THREAD.items() if name not in os.environ}
    os.environ.update(added)
    others = active_children()
    executor = ProcessPoolExecutor(count, get_context("spawn"), _begin)
    try:
        yield executor
    except BaseException:
        for process in active_children():
            if process not in others:
                process.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)
        for name in added:
            os.environ.pop(name, None)


def _begin() -> None:
    """A process begins: Ctrl-C is its parent's, whose SIGTERM ends it once files are tidied up."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    threading.Thread(target=end_with_parent, daemon=True).start()
    gc.freeze()


def _do(
    name: str, work: Callable[[Tell, Mapping[str, Any]], Any], needed: Mapping[str, Any]
) -> Any:
    """Do a job in another process.

    Args:
        name, work: name and work of the job.
        needed: results of others.
    """
    try:
        with _named(name):
            return work(silent, needed)
    except OscContactError as error:
        cause = error.__cause__
        if isinstance(cause, ImportError) and missing(cause):
            raise cause from None  # causes do not reach the parent
        if hasattr(error, "recording"):
            error.recording = None
        raise
    except (KeyboardInterrupt, SystemExit):  # ended on request: nobody takes the result
        os._exit(1)
