"""How fast the rows of a vector environment advance, and what of it is control."""

from time import perf_counter, process_time

import numpy as np

import osc_contact as osc
from benchmarks.measuring import Rows
from benchmarks.simulation import Ledger, parts_of_ticks
from osc_contact.sweeps.sweep import available_cores
from paper.study import Data

SCENARIO = "panda_edge"
ROWS = 64
REST = "set points, observations, rewards"


def measure(steps: int) -> dict[str, Rows]:
    """{"rates": rows, "parts": rows}.

    64 rows of `panda_edge`: 1 kHz control, four plant steps each, an action every 20 ticks. Of all
    steps the fastest on the clock gives the rate, and the share of it in which torques are
    computed; the one that took least processor time the parts. That is of all threads: other work
    on the machine does not count, but MuJoCo's threads do, which wait awake for the torques.

    Args:
        steps: of the environment.
    """
    found = [_case(threads, steps) for threads in sorted({1, available_cores()})]
    return {
        "rates": [rates for rates, _ in found],
        "parts": [part for _, parts in found for part in parts],
    }


def _case(threads: int, steps: int) -> tuple[Data, Rows]:
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
    ticks = ROWS * round(1.0 / (50.0 * env.fleet.dt))
    rates = {
        "threads": threads,
        "control ticks / s": ticks / clock,
        "control, of the clock": control / clock,
    }
    least = min(spent, key=lambda spent: sum(spent.values()))
    return rates, parts_of_ticks(least, ticks, {"threads": threads})
