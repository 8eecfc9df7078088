"""The tick on the clock: absolute deadlines, compute time and wake-up jitter apart."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from pathlib import Path
from time import perf_counter_ns, sleep

import numpy as np
from rich.table import Table

from benchmarks.cases import CASES
from benchmarks.measuring import machine, require_count, spread
from osc_contact.spatial import Array
from paper.study import Data, table_of

RATES_HZ = (1000, 2000, 5000)
BLOCKS = 8
SHARES = ("p50", "p99", "p99_9", "max")
TICK = "tick"
EMPTY = "empty"


def clocked(body: Callable[[], object], rate_hz: int, periods: int) -> tuple[Array, Array, int]:
    """Run a body at absolute deadlines k/rate; a late period is not made up for by a burst.

    Returns:
        (periods,) µs that each wake-up came after its deadline, (periods,) µs that the body took,
        and how many deadlines were missed: the body had not ended when the next one was due.
    """
    period = round(1e9 / rate_hz)
    late = np.zeros(periods)
    spent = np.zeros(periods)
    missed = 0
    due = perf_counter_ns() + period
    for k in range(periods):
        left = due - perf_counter_ns()
        if left > 0:
            sleep(1e-9 * left)
        awake = perf_counter_ns()
        body()
        end = perf_counter_ns()
        late[k] = awake - due
        spent[k] = end - awake
        skipped = max(0, (end - due) // period)
        missed += skipped
        due += (1 + skipped) * period
    return late / 1e3, spent / 1e3, missed


def measure(periods: int = 4000) -> Data:
    """{"machine": …, "rates": {rate: {"tick" | "empty": {wake_up_us, compute_us, missed}}}}.

    The loop with the tick of `two_contact_rod` and the same loop with an empty body take turns in
    blocks, so that both see the same machine; their wake-ups differ by what the tick does to them.

    Args:
        periods: of each loop at each rate.

    Raises:
        InvalidInputError: no periods.
    """
    require_count(periods, "periods")
    tick, unwind = CASES["two_contact_rod"]().tick()

    def whole_tick() -> None:
        tick()
        unwind()

    bodies: dict[str, Callable[[], object]] = {TICK: whole_tick, EMPTY: lambda: None}
    rates = {}
    for rate in RATES_HZ:
        blocks = min(BLOCKS, periods)
        found: dict[str, list[tuple[Array, Array, int]]] = {name: [] for name in bodies}
        for _ in range(blocks):
            for name, body in bodies.items():
                found[name].append(clocked(body, rate, max(1, periods // blocks)))
        rates[str(rate)] = {name: _joined(blocks_of) for name, blocks_of in found.items()}
    return {
        "machine": machine(),
        "scheduler": _scheduler(),
        "timer_slack_us": _timer_slack(),
        "kernel": platform.version(),
        "rates": rates,
    }


def _joined(blocks: list[tuple[Array, Array, int]]) -> Data:
    late, spent = (np.concatenate([block[i] for block in blocks]) for i in (0, 1))
    return {
        "periods": len(late),
        "wake_up_us": spread(late),
        "compute_us": spread(spent),
        "missed": sum(block[2] for block in blocks),
    }


def _scheduler() -> str:
    names = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}
    return names.get(os.sched_getscheduler(0), "another")


def _timer_slack() -> float | None:
    """How much later than requested the kernel may wake this process, µs (Linux: 50 by default)."""
    file = Path("/proc/self/timerslack_ns")
    return int(file.read_text()) / 1e3 if file.is_file() else None


def tables(result: Data) -> list[Table]:
    """Wake-up and compute time of both loops at each rate."""
    title = f"absolute deadlines, {result['scheduler']}, timer slack {result['timer_slack_us']} µs"
    rows = [
        (
            f"{int(rate) / 1000:g} kHz",
            name,
            loop["periods"],
            what,
            *(f"{loop[key][share]:.1f}" for share in SHARES),
            loop["missed"],
        )
        for rate, bodies in result["rates"].items()
        for name, loop in bodies.items()
        for what, key in (("wake-up", "wake_up_us"), ("compute", "compute_us"))
    ]
    return [table_of(title, f"rate; body; periods; what (µs); {'; '.join(SHARES)}; missed", rows)]
