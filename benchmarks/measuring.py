"""Medians of calls that take turns in one process, and what machine they were taken on."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

PACKAGES = ("osc-contact", "pin", "numpy", "numba", "mujoco")
WARM_UP = 5


def machine() -> dict[str, Any]:
    """Processor, cores, system, Python, packages: what numbers were measured on."""
    return {
        "cpu": _cpu(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "packages": {name: found for name in PACKAGES if (found := _version(name))},
    }


def machine_lines(about: Mapping[str, Any]) -> tuple[str, str]:
    """The same in two lines."""
    packages = ", ".join(f"{name} {version}" for name, version in about["packages"].items())
    return (
        f"{about['cpu']}, {about['cores']} cores, {about['system']}",
        f"Python {about['python']}, {packages}",
    )


def require_count(count: int, what: str) -> int:
    """The count, if it is positive.

    Raises:
        InvalidInputError: it is not.
    """
    if count < 1:
        raise InvalidInputError(f"{count} {what} give no time; take 1 or more")
    return count


def take_turns(
    calls: Mapping[str, Callable[[], object]],
    rounds: int,
    between: Callable[[], None] | None = None,
) -> dict[str, Array]:
    """Times (rounds,) in µs of each call; in every round all are called, one after the other.

    Args:
        calls: what to time, by name.
        rounds: how often, after a few that do not count.
        between: called after each round, untimed.

    Raises:
        InvalidInputError: no rounds.
    """
    require_count(rounds, "rounds")
    functions = list(calls.values())
    times = np.zeros((rounds + WARM_UP, len(functions)))
    for row in times:
        for i, function in enumerate(functions):
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
    p50, p99, p99_9 = (float(x) for x in np.percentile(times, [50, 99, 99.9]))
    return {"p50": p50, "p99": p99, "p99_9": p99_9, "max": float(times.max())}


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
