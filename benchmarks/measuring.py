"""Times of calls that take turns in one process, the machine, and tables of the results."""

import logging
import os
import platform
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np
from rich.progress import track
from rich.table import Table

from osc_contact.lab.cli.console import err
from osc_contact.spatial import Array
from paper.study import Data, table_of

SHARES = {"p50": 50, "p99": 99, "p99_9": 99.9, "max": 100}  #: percentiles of times by name (%)
PACKAGES = ("osc-contact", "pin", "numpy", "numba", "mujoco")  #: packages whose versions are named
WARM_UP = 5  #: number of rounds before those that are timed
Call = Callable[[], object]
Rows = list[Data]  #: rows of a table, each with its numbers and words by the heads of the columns


@contextmanager
def without_log() -> Iterator[None]:
    """Log nothing while a function or block prints its table.

    Warnings of single runs, which the table counts, would stand between its rows. The log is as
    before at the end: other programs of the process may read it.
    """
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)


def machine() -> Data:
    """Describe this machine: processor, cores, system, versions of Python and packages."""
    packages = {}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    cpu = re.search("model name\\s*: (.+)", Path("/proc/cpuinfo").read_text())
    return {
        "cpu": cpu[1] if cpu else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        **packages,
    }


def table_from(title: str, rows: Rows) -> Table:
    """Table of the rows of a benchmark, for a terminal.

    Args:
        title: title of the table.
        rows: rows, at least one, all with the same keys; None becomes "–".
    """

    def cell(x: Any) -> str:
        """Text of an entry; two digits behind the point of a float."""
        return "–" if x is None else f"{x:.2f}" if isinstance(x, float) else str(x)

    return table_of(title, "; ".join(rows[0]), (map(cell, row.values()) for row in rows))


def side_by_side(
    task: Callable[..., Any], jobs: Collection[tuple[Any, ...]], workers: int
) -> Iterator[Any]:
    """Call a function for each of several jobs in parallel processes; yield results in their order.

    A terminal shows the progress.

    Args:
        task: function at the top level of a module, so that other processes can import it.
        jobs: arguments of each call.
        workers: number of processes.
    """
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        found = pool.map(task, *zip(*jobs, strict=True))
        hidden = not err.is_terminal
        yield from track(found, "", len(jobs), console=err, transient=True, disable=hidden)


def take_turns(
    calls: Mapping[str, Call],
    rounds: int,
    between: Call | None = None,
) -> dict[str, Array]:
    """Time functions in turns: in every round each is called once, one after the other.

    So slow changes of the processor's speed affect all of them alike.

    Args:
        calls: functions by name.
        rounds: number of rounds, after `WARM_UP` rounds that are not timed.
        between: function that is called after each round and not timed; None: none.

    Returns:
        Times (rounds,) of each function by name (µs).
    """
    times = np.zeros((rounds + WARM_UP, len(calls)))
    for row in times:
        for i, function in enumerate(calls.values()):
            start = perf_counter_ns()
            function()
            row[i] = perf_counter_ns() - start
        if between is not None:
            between()
    return dict(zip(calls, times[WARM_UP:].T / 1e3, strict=True))


def spread(times: Array) -> dict[str, float]:
    """Percentiles `SHARES` of times by name, in the unit of the times.

    Args:
        times: (n,) times.
    """
    return {name: float(np.percentile(times, share)) for name, share in SHARES.items()}
