"""How fast the rows of a vector environment advance, and what of it is control."""

from __future__ import annotations

from time import perf_counter, process_time

import numpy as np
from rich.table import Table

import osc_contact as osc
from benchmarks.measuring import machine, require_count
from benchmarks.simulation import Ledger
from osc_contact.sweeps.workers import available_cores
from paper.study import Data

SCENARIO = "panda_edge"
ROWS = 64
REST = "set points, observations, rewards"


def measure(steps: int = 60) -> Data:
    """{"cases": [{"threads", "ticks_per_s", "cpu_us_per_tick": {part: …}, "shares",
    "control_of_the_clock"}], …}.

    64 rows of `panda_edge`: 1 kHz control, four plant steps each, an action every 20 ticks. Of all
    steps the fastest on the clock gives the rate, and the share of it in which torques are
    computed; the one that took least processor time the parts. That is of all threads: other work
    on the machine does not count, but MuJoCo's threads do, which wait awake for the torques.

    Args:
        steps: of the environment.

    Raises:
        InvalidInputError: no steps.
    """
    require_count(steps, "steps")
    counts = sorted({1, available_cores()})
    cases = [_case(threads, steps) for threads in counts]
    return {"machine": machine(), "scenario": SCENARIO, "rows": ROWS, "cases": cases}


def _case(threads: int, steps: int) -> Data:
    env = osc.make_vector_env(SCENARIO, ROWS, threads=threads)
    env.reset(seed=0)
    hold = np.zeros(env.action_space.shape)
    ledger = Ledger(process_time)
    watch = Ledger()
    parts_of = [("control", env.fleet.control, "tick"), ("MuJoCo", env.fleet._plants, "step")]
    clock = np.inf
    control = 0.0
    parts = {REST: np.inf}
    with watch.watching(parts_of[:1]), ledger.watching([*parts_of, (REST, env, "step")]):
        for _ in range(steps):
            ledger.spent = dict.fromkeys(ledger.spent, 0.0)
            watch.spent = dict.fromkeys(watch.spent, 0.0)
            start = perf_counter()
            env.step(hold)
            took = perf_counter() - start
            if took < clock:
                clock = took
                control = watch.spent["control"]
            parts = min(parts, dict(ledger.spent), key=lambda spent: sum(spent.values()))
    ticks = ROWS * round(1.0 / (50.0 * env.fleet.dt))
    whole = sum(parts.values())
    return {
        "threads": threads,
        "ticks_per_s": ticks / clock,
        "control_of_the_clock": control / clock,
        "cpu_us_per_tick": {name: spent / ticks * 1e6 for name, spent in parts.items()},
        "ticks_per_cpu_s": ticks / whole,
        "shares": {name: spent / whole for name, spent in parts.items()},
    }


def tables(result: Data) -> list[Table]:
    """Rates, and the parts of a tick."""
    cases = result["cases"]
    title = f"{result['rows']} rows of {result['scenario']}, four plant steps a tick"
    table = Table("", *(f"{case['threads']} threads" for case in cases), title=title)
    rows = {
        "control ticks a second": [f"{case['ticks_per_s']:.0f}" for case in cases],
        "control, of the clock": [f"{case['control_of_the_clock']:.0%}" for case in cases],
        "ticks a second of processor time": [f"{case['ticks_per_cpu_s']:.0f}" for case in cases],
    }
    for name in cases[0]["shares"]:
        rows[name] = [
            f"{c['cpu_us_per_tick'][name]:.1f} µs, {c['shares'][name]:.0%}" for c in cases
        ]
    for name, cells in rows.items():
        table.add_row(name, *cells)
    table.caption = "parts: processor time of a tick, of all threads"
    return [table]
