"""How fast the rows of a vector environment advance, and what of it is control."""

from time import perf_counter, process_time

import numpy as np

import osc_contact as osc
from benchmarks.measuring import Report
from benchmarks.simulation import Ledger
from osc_contact.sweeps.sweep import available_cores
from paper.study import Data, table_of

SCENARIO = "panda_edge"
ROWS = 64
REST = "set points, observations, rewards"


def measure(steps: int) -> Report:
    """{"cases": [{"threads", "ticks_per_s", "cpu_us_per_tick": {part: …}, "shares",
    "control_of_the_clock"}], …}.

    64 rows of `panda_edge`: 1 kHz control, four plant steps each, an action every 20 ticks. Of all
    steps the fastest on the clock gives the rate, and the share of it in which torques are
    computed; the one that took least processor time the parts. That is of all threads: other work
    on the machine does not count, but MuJoCo's threads do, which wait awake for the torques.

    Args:
        steps: of the environment.
    """
    cases = [_case(threads, steps) for threads in sorted({1, available_cores()})]
    shown = {
        "control ticks a second": "{ticks_per_s:.0f}",
        "control, of the clock": "{control_of_the_clock:.0%}",
        "ticks a second of processor time": "{ticks_per_cpu_s:.0f}",
        **{
            name: f"{{cpu_us_per_tick[{name}]:.1f}} µs, {{shares[{name}]:.0%}}"
            for name in cases[0]["shares"]
        },
    }
    table = table_of(
        f"{ROWS} rows of {SCENARIO}, four plant steps a tick",
        "; ".join(("", *(f"{case['threads']} threads" for case in cases))),
        ((name, *(form.format(**case) for case in cases)) for name, form in shown.items()),
    )
    table.caption = "parts: processor time of a tick, of all threads"
    return Report({"scenario": SCENARIO, "rows": ROWS, "cases": cases}, [table])


def _case(threads: int, steps: int) -> Data:
    env = osc.make_vector_env(SCENARIO, ROWS, threads=threads)
    env.reset(seed=0)
    hold = np.zeros((ROWS, 7))
    ledger = Ledger(process_time)
    watch = Ledger()
    parts_of = [("control", env.fleet.control, "tick"), ("MuJoCo", env.fleet._plants, "step")]
    clocks = []
    spent = []
    with watch.watching(parts_of[:1]), ledger.watching([*parts_of, (REST, env, "step")]):
        for _ in range(steps):
            ledger.begin()
            watch.begin()
            start = perf_counter()
            env.step(hold)
            clocks.append((perf_counter() - start, watch.spent["control"]))
            spent.append(ledger.spent)
    clock, control = min(clocks)
    parts = min(spent, key=lambda spent: sum(spent.values()))
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
