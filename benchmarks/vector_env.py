"""Benchmark of a vector environment: steps per second, and the share of control."""

from time import perf_counter
from typing import Any

import numpy as np

import osc_contact as osc
from benchmarks.measuring import Rows
from osc_contact.lab.sweeps.workers import available_cores
from paper.study import Data

SCENARIO = "panda_edge"
ROWS = 64


def measure(steps: int) -> dict[str, Rows]:
    """{"rates": rows}, by threads.

    64 rows of `panda_edge`: 1 kHz control, four plant steps each, an action every 20 ticks. Of all
    steps the fastest on the clock gives the rate, and the share of it in which torques are
    computed.

    Args:
        steps: number of steps of the environment.
    """
    return {"rates": [_case(threads, steps) for threads in sorted({1, available_cores()})]}


def _case(threads: int, steps: int) -> Data:
    env = osc.make_vector_env(SCENARIO, ROWS, threads=threads)
    env.reset(seed=0)
    control: Any = env.fleet.control
    tick = control.tick
    times: list[list[float]] = []  #: of each step: on the clock, and in control

    def timed(*args: Any, **kwargs: Any) -> Any:
        start = perf_counter()
        torques = tick(*args, **kwargs)
        times[-1][1] += perf_counter() - start
        return torques

    control.tick = timed
    for _ in range(steps):
        times.append([0.0, 0.0])
        start = perf_counter()
        env.step(np.zeros((ROWS, 7)))
        times[-1][0] = perf_counter() - start
    clock, spent = min(times)
    ticks = ROWS * round(1.0 / (50.0 * env.fleet.dt))
    return {
        "threads": threads,
        "control ticks / s": ticks / clock,
        "control, of the clock": spent / clock,
    }
