"""Benchmark of the cost of a run within a sweep.

Workers make rows side by side. One process hands them jobs, keeps their rows and writes the table;
what it spends on a row bounds how many workers have work.
"""

from collections.abc import Sequence
from time import thread_time

from osc_contact.lab.sweeps.rows import make_rows
from osc_contact.lab.sweeps.study import SweepStudy
from osc_contact.lab.sweeps.workers import available_cores
from paper.study import Data

MASSES = (
    "model_error.object_mass=uniform(0.8, 1.2)",
    "model_error.arm_mass=uniform(0.8, 1.2)",
)  #: of the controller's model; the robot is the same in all runs
VARY = (
    *MASSES,
    "contacts.left_end.face.normal=tilt(5 deg)",
    "contacts.right_end.face.normal=tilt(5 deg)",
)
DURATION = 2.0  #: s, of each run


def measure(runs: int) -> Data:
    """Least processor time of a row of a sweep, into which other programs do not count.

    Args:
        runs: number of runs of the sweep, after a first run, for which nothing is compiled yet.
    """
    row_s = _row_s(VARY, runs)
    cores = available_cores()
    extrapolated = {f"1000 rows on {cores} cores, extrapolated (s)": 1e3 * row_s / cores}
    same_robot = {"row_s of the same robot": _row_s(MASSES, runs)}
    return {"duration_s": DURATION, "row_s": row_s, **same_robot, **extrapolated}


def _row_s(vary: Sequence[str], runs: int) -> float:
    """Least processor time (s) of a row.

    Args:
        vary: keys that vary.
        runs: beside the first.
    """
    changes = (f"duration={DURATION!r}",)
    study = SweepStudy.of("two_contact_rod", vary, runs + 1, overrides=changes)
    times = []
    for number in range(runs + 1):
        start = thread_time()
        make_rows(study, [number])
        times.append(thread_time() - start)
    return min(times[1:])
