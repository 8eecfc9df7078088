"""The tick on the clock: absolute deadlines, compute time and wake-up jitter apart."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter_ns, sleep

import numpy as np

from benchmarks.cases import CASES
from benchmarks.measuring import SHARES, Call, Report, cells, spread
from osc_contact.spatial import Array
from paper.study import Data, table_of

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


def measure(periods: int) -> Report:
    """{"rates": {rate: {"tick" | "empty": {wake_up_us, compute_us, missed}}}}.

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
    rates = {}
    for rate in RATES_HZ:
        found = [
            [clocked(body, rate, periods // blocks) for body in bodies.values()]
            for _ in range(blocks)
        ]
        joined = map(_joined, zip(*found, strict=True))
        rates[str(rate)] = dict(zip(bodies, joined, strict=True))
    file = Path("/proc/self/timerslack_ns")  # how much later the kernel may wake this process
    slack = int(file.read_text()) / 1e3 if file.is_file() else None
    scheduler = SCHEDULERS.get(os.sched_getscheduler(0), "another")
    lines = [
        f"{rate / 1000:g} kHz; {name}; {loop['periods']}; {what}; {cells(loop[key])}; "
        f"{loop['missed']}"
        for rate in RATES_HZ
        for name, loop in rates[str(rate)].items()
        for what, key in (("wake-up", "wake_up_us"), ("compute", "compute_us"))
    ]
    data = {"scheduler": scheduler, "timer_slack_us": slack, "kernel": platform.version()}
    title = f"absolute deadlines, {scheduler}, timer slack {slack} µs"
    heads = f"rate; body; periods; what (µs); {'; '.join(SHARES)}; missed"
    return Report(data | {"rates": rates}, [table_of(title, heads, lines)])


def _joined(blocks: Sequence[tuple[Array, Array, int]]) -> Data:
    late, spent, missed = zip(*blocks, strict=True)
    wake_up = np.concatenate(late)
    return {
        "periods": len(wake_up),
        "wake_up_us": spread(wake_up),
        "compute_us": spread(np.concatenate(spent)),
        "missed": sum(missed),
    }
