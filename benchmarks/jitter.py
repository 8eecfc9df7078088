"""The tick on the clock: absolute deadlines, compute time and wake-up jitter apart."""

import os
import platform
from pathlib import Path
from time import perf_counter_ns, sleep

import numpy as np

from benchmarks.cases import CASES
from benchmarks.measuring import Call, spread
from osc_contact.spatial import Array
from paper.study import Data

RATES_HZ = (1000, 2000, 5000)
BLOCKS = 8
SCHEDULERS = {getattr(os, name): name for name in ("SCHED_OTHER", "SCHED_FIFO", "SCHED_RR")}


def clocked(body: Call, rate_hz: int, periods: int) -> tuple[Array, Array, int]:
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


def measure(periods: int) -> Data:
    """{"rates": rows, "scheduler", "timer slack (µs)", "kernel"}: wake-ups, computing, misses.

    The loop with the tick of `two_contact_rod` and the same loop with an empty body take turns in
    blocks, so that both see the same machine; their wake-ups differ by what the tick does to them.

    Args:
        periods: of each loop at each rate.
    """
    tick, unwind = CASES["two_contact_rod"]().tick()

    def whole_tick() -> None:
        tick()
        unwind()

    bodies: dict[str, Call] = {"tick": whole_tick, "empty": lambda: None}
    blocks = min(BLOCKS, periods)
    rows = []
    for rate in RATES_HZ:
        found = [
            [clocked(body, rate, periods // blocks) for body in bodies.values()]
            for _ in range(blocks)
        ]
        for body, runs in zip(bodies, zip(*found, strict=True), strict=True):
            late, spent, missed = zip(*runs, strict=True)
            for what, times in (("wake-up", late), ("compute", spent)):
                row = {"rate (Hz)": rate, "body": body, "what (µs)": what}
                rows.append(row | spread(np.concatenate(times)) | {"missed": sum(missed)})
    file = Path("/proc/self/timerslack_ns")  # how much later the kernel may wake this process
    return {
        "rates": rows,
        "scheduler": SCHEDULERS.get(os.sched_getscheduler(0), "another"),
        "timer slack (µs)": int(file.read_text()) / 1e3 if file.is_file() else None,
        "kernel": platform.version(),
    }
