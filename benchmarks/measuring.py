"""Medians of calls that take turns in one process, and what machine they were taken on."""

import os
import platform
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
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

SHARES = {"p50": 50, "p99": 99, "p99_9": 99.9, "max": 100}
PACKAGES = ("osc-contact", "pin", "numpy", "numba", "mujoco")
WARM_UP = 5
Call = Callable[[], object]
Rows = list[Data]  #: of a table: numbers and words by the heads of its columns


def machine() -> Data:
    """Processor, cores, system, Python, packages: what numbers were measured on."""
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
    """The rows of a benchmark as a table; "–" where there is no number."""

    def cell(x: Any) -> str:
        return "–" if x is None else f"{x:.2f}" if isinstance(x, float) else str(x)

    return table_of(title, "; ".join(rows[0]), (map(cell, row.values()) for row in rows))


def side_by_side(
    task: Callable[..., Any], jobs: Collection[tuple[Any, ...]], workers: int
) -> Iterator[Any]:
    """What a task gives for each of some arguments, in their order; a terminal shows how many.

    Args:
        task: a function of a module. jobs: its arguments, call by call. workers: processes.
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
    """Times (rounds,) in µs of each call; in every round all are called, one after the other.

    Args:
        calls: what to time, by name.
        rounds: how often, after a few that do not count.
        between: called after each round, untimed.

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
    """p50, p99, p99.9 and largest of some times, in their unit."""
    return {name: float(np.percentile(times, share)) for name, share in SHARES.items()}
