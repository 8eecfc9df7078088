"""What a run costs within a sweep and by itself.

Workers make rows side by side. One process hands them jobs, keeps their rows and writes the table;
what it spends on a row bounds how many workers have work.
"""

import os
import subprocess
import sys
from time import thread_time

import numpy as np

import osc_contact as osc
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.sweep import make_rows, scenario_of, without_logged_doubts
from paper.study import Data

VARY = (
    "model_error.object_mass=uniform(0.8, 1.2)",
    "model_error.arm_mass=uniform(0.8, 1.2)",
    "contacts.left_end.face.normal=tilt(5 deg)",
    "contacts.right_end.face.normal=tilt(5 deg)",
)
DURATION = 2.0  #: s, of each run
_ONE_ROW = """
from benchmarks.many_runs import study
from osc_contact.sweeps.sweep import make_rows
make_rows(study(2), [0])
"""


def study(runs: int) -> SweepStudy:
    """The sweep that is timed."""
    return SweepStudy.of("two_contact_rod", VARY, runs, overrides=(f"duration={DURATION!r}",))


def measure(runs: int) -> Data:
    """What a row of a sweep costs, the same run by itself, and a worker until its first row.

    Processor time, into which other programs do not count.

    Args:
        runs: of the sweep, each also by itself.
    """
    row_s, single_s = time_rows(runs + 1)
    start_s = max(0.0, _time_a_start() - row_s)
    cores = len(os.sched_getaffinity(0))
    data = {"duration_s": DURATION, "row_s": row_s, "single_s": single_s, "start_s": start_s}
    return data | {f"1000 rows on {cores} cores, extrapolated (s)": 1e3 * row_s / cores}


def time_rows(runs: int) -> tuple[float, float]:
    """Least processor time (s) of a row, and of the same run by itself, taken in turns."""
    those = study(runs)
    times = []
    for number in range(runs):
        sample = those.sample(number)
        start = thread_time()
        make_rows(those, [number])
        middle = thread_time()
        with without_logged_doubts():
            changes = [*those.overrides, *(f"{k}={v}" for k, v in sample.overrides.items())]
            scenario = osc.load_scenario("two_contact_rod", changes)
            osc.metrics(osc.run(scenario, seed=sample.seed))
        times.append((middle - start, thread_time() - middle))
    assert scenario_of(those, sample) == scenario
    row, single = np.min(times[1:], axis=0)  # the first finds nothing made
    return float(row), float(single)


def _time_a_start() -> float:
    """Of a process that makes one row, the law being compiled already."""
    before = os.times()
    subprocess.run([sys.executable, "-c", _ONE_ROW], check=True)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])  # of children, user and system
