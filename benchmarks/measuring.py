"""Medians of calls that take turns in one process, and what machine they were taken on."""

import os
import platform
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter_ns
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from osc_contact.spatial import Array

SHARES = {"p50": 50, "p99": 99, "p99_9": 99.9, "max": 100}
PACKAGES = ("osc-contact", "pin", "numpy", "numba", "mujoco")
WARM_UP = 5
Call = Callable[[], object]


class Report(NamedTuple):
    """What a benchmark found: JSON-able data, tables."""

    data: dict[str, Any]
    tables: list[Table]


def machine() -> dict[str, Any]:
    """Processor, cores, system, Python, packages: what numbers were measured on."""
    packages = {}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    cpu = re.search("model name\\s*: (.+)", Path("/proc/cpuinfo").read_text())
    return {
        "cpu": cpu[1] if cpu else platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "packages": packages,
    }


def machine_lines(about: Mapping[str, Any]) -> tuple[str, str]:
    """The same in two lines."""
    packages = ", ".join(f"{name} {version}" for name, version in about["packages"].items())
    return (
        f"{about['cpu']}, {about['cores']} cores, {about['system']}",
        f"Python {about['python']}, {packages}",
    )


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


def joined(blocks: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """Times of several `take_turns` of the same calls, end to end."""
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def spread(times: Array) -> dict[str, float]:
    """p50, p99, p99.9 and largest of some times, in their unit."""
    return {name: float(np.percentile(times, share)) for name, share in SHARES.items()}


def cells(numbers: Mapping[str, float], form: str = ".1f") -> str:
    """Numbers as cells of `table_of`."""
    return "; ".join(format(x, form) for x in numbers.values())
