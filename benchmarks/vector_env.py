"""How fast the rows of a vector environment advance, and what of it is control."""

from time import perf_counter

import numpy as np

import osc_contact as osc
from benchmarks.measuring import Rows
from benchmarks.simulation import Ledger
from osc_contact.sweeps.sweep import available_cores
from paper.study import Data

SCENARIO = "panda_edge"
ROWS = 64


def measure(steps: int) -> dict[str, Rows]:
    """{"rates": rows}, by threads.

    64 rows of `panda_edge`: 1 kHz control, four plant steps each, an action every 20 ticks. Of all
    steps the fastest on the clock gives the rate, and the share of it in which torques are
    computed.

    Args:
        steps: of the environment.
    """
    return {"rates": [_case(threads, steps) for threads in sorted({1, available_cores()})]}


def _case(threads: int, steps: int) -> Data:
    env = osc.make_vector_env(SCENARIO, ROWS, threads=threads)
    env.reset(seed=0)
    ledger = Ledger()
    clocks = []
    with ledger.watching([("control", env.fleet.control, "tick")]):
        for _ in range(steps):
            ledger.begin()
            start = perf_counter()
            env.step(np.zeros((ROWS, 7)))
            clocks.append((perf_counter() - start, ledger.spent["control"]))
    clock, control = min(clocks)
    ticks = ROWS * round(1.0 / (50.0 * env.fleet.dt))
    return {
        "threads": threads,
        "control ticks / s": ticks / clock,
        "control, of the clock": control / clock,
    }
