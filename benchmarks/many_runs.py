"""What a run costs within a sweep and by itself, and how far more machines help: slopes, then sums.

Workers make rows side by side. One process hands them jobs, keeps their rows and writes the table;
what it spends on a row bounds how many workers have work.
"""

from __future__ import annotations

import pickle
import resource
import subprocess
import sys
import tracemalloc
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time, thread_time
from typing import Any

import numpy as np
from rich.table import Table

import osc_contact as osc
from benchmarks.measuring import bars, machine, new_axes, require_count
from osc_contact.sweeps import sweep as sweeps
from osc_contact.sweeps.rows import make_rows, scenario_of, without_doubts_told
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.table import RowFile, make_table, write_table
from osc_contact.sweeps.workers import Workers, make_all

__all__ = ["draw", "measure", "scaled", "tables", "time_rows"]

VARY = (
    "model_error.object_mass=uniform(0.8, 1.2)",
    "model_error.arm_mass=uniform(0.8, 1.2)",
    "contacts.left_end.face.normal=tilt(5 deg)",
    "contacts.right_end.face.normal=tilt(5 deg)",
)
DURATION = 2.0  #: s, of each run
MILLION = 1_000_000
_ROWS, _JOBS, _MANY, _LOOKS = 4000, 500, 1000, 50  #: rows, jobs, workers, looks that are timed
_ONE_ROW = """
from benchmarks.many_runs import study
from osc_contact.sweeps.rows import make_rows
make_rows(study(2), [0])
"""


def study(runs: int, duration: float = DURATION) -> SweepStudy:
    """The sweep that is timed."""
    return SweepStudy.of("two_contact_rod", VARY, runs, overrides=(f"duration={duration!r}",))


def measure(runs: int = 20) -> dict[str, Any]:
    """{"row_s", "single_s", "start_s", "job_s", "worker_s", "keep_s", "table_s", …}, per unit.

    Processor time, into which other programs do not count.

    Args:
        runs: of the sweep, each also by itself.

    Raises:
        InvalidInputError: no runs.
    """
    row_s, single_s = time_rows(require_count(runs, "runs") + 1, DURATION)
    some = make_rows(study(4), range(4))
    return {
        "machine": machine(),
        "duration_s": DURATION,
        "chunk": sweeps._CHUNK,
        "row_s": row_s,
        "single_s": single_s,
        "start_s": max(0.0, _time_a_start() - row_s),
        "job_s": _time_dask(len(some[0])),
        "worker_s": _time_waiting(),
        **_time_keeping(some),
    }


def time_rows(runs: int, duration: float) -> tuple[float, float]:
    """Least processor time (s) of a row, and of the same run by itself, taken in turns."""
    those = study(runs, duration)
    least = [np.inf, np.inf]
    for number in range(runs):
        sample = those.sample(number)
        start = thread_time()
        make_rows(those, [number])
        middle = thread_time()
        with without_doubts_told():
            changes = [*those.overrides, *(f"{k}={v}" for k, v in sample.overrides.items())]
            scenario = osc.load_scenario("two_contact_rod", changes)
            osc.metrics(osc.run(scenario, seed=sample.seed))
        took = middle - start, thread_time() - middle
        if number:  # the first finds nothing made
            least = [min(pair) for pair in zip(least, took, strict=True)]
    assert scenario_of(those, sample) == scenario
    return least[0], least[1]


def _time_a_start() -> float:
    """Of a process that makes one row, the law being compiled already."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", _ONE_ROW], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _time_waiting() -> float:
    """Of a job: that for each worker two more are looked at until one is found that is done."""
    jobs: list[Future[None]] = [Future() for _ in range(2 * _MANY)]
    jobs[-1].set_result(None)
    start = process_time()
    for _ in range(_LOOKS):
        wait(jobs, return_when=FIRST_COMPLETED)
    return (process_time() - start) / _LOOKS / _MANY


def _time_dask(numbers: int) -> float:
    """Of a job that does nothing: dask's client and scheduler, both in this process."""
    from osc_contact.sweeps.cluster import connect

    class Idle(Workers):
        def submit(self, make: Any, job: Any) -> Future[list[dict[str, Any]]]:
            return self._made.submit(make, *job, numbers)

    jobs = [(study(_JOBS), [i]) for i in range(_JOBS)]
    with connect("local", 1) as client:
        crew = Idle(client.get_executor, lambda: sum(client.nthreads().values()))
        list(make_all(crew, jobs[:50], _answer))
        start = process_time()
        made = list(make_all(crew, jobs, _answer))
        took = process_time() - start
        crew.close()
    assert len(made) == _JOBS * sweeps._CHUNK
    return took / _JOBS


def _answer(those: SweepStudy, rows: list[int], numbers: int) -> list[dict[str, Any]]:
    """As many rows as a job has, of as many numbers as a row has."""
    row = {f"force.some_contact.of_{i}": float(np.sqrt(i)) for i in range(numbers)}
    return [{**row, "row": rows[0]}] * sweeps._CHUNK


def _time_keeping(some: list[dict[str, Any]]) -> dict[str, float]:
    """Of a row: a line of the file, a row of the table; bytes of both, and of memory."""
    raw = pickle.dumps(some)
    tracemalloc.start()
    rows = [row for _ in range(_ROWS // len(some)) for row in pickle.loads(raw)]
    memory = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    draws = np.random.default_rng(0)
    for i, row in enumerate(rows):  # no two are alike
        row["row"] = i
        row |= {k: v * draws.uniform(0.9, 1.1) for k, v in row.items() if isinstance(v, float)}
    with TemporaryDirectory() as folder:
        lines, table = Path(folder) / "rows.jsonl", Path(folder) / "table.parquet"
        start = process_time()
        file = RowFile(lines, study(_ROWS))
        for row in rows:
            file.append([row])
        file.close()
        middle = process_time()
        write_table(make_table(rows, study(_ROWS)), table)
        end = process_time()
        sizes = [one.stat().st_size / len(rows) for one in (lines, table)]
    return {
        "keep_s": (middle - start) / len(rows), "table_s": (end - middle) / len(rows),
        "memory_B": memory / len(rows), "line_B": sizes[0], "parquet_B": sizes[1],
    }  # fmt: skip


def scaled(found: dict[str, Any], machines: int, cores: int, chunk: int) -> dict[str, float]:
    """A million rows on so many machines: from the slopes, by arithmetic.

    Returns:
        "hours" on the clock; "busy": of that, how long the process that hands out jobs is; "used":
        share of the workers' time that goes into rows; "most": workers that it can keep busy.
    """
    workers = machines * cores
    each = found["keep_s"] + found["job_s"] / chunk
    rows = MILLION * found["row_s"] / workers
    hand = MILLION * (each + workers * found["worker_s"] / chunk)
    whole = found["start_s"] + max(rows, hand) + MILLION * found["table_s"]
    a, b, c = found["worker_s"] / chunk, each, -found["row_s"]  # a W² + b W = row: both busy
    most = -2.0 * c / (b + np.sqrt(b * b - 4.0 * a * c))
    return {"hours": whole / 3600, "busy": hand / 3600, "used": rows / whole, "most": float(most)}


def tables(result: dict[str, Any]) -> list[Table]:
    """The slopes; what a million rows take on more and more machines."""
    run = f"two_contact_rod, {result['duration_s']:g} s"
    cores = result["machine"]["cores"]
    slopes = Table("processor time", "value", title="slopes")
    for name, value, unit, scale in (
        (f"a row of a sweep, {run}", result["row_s"], "ms", 1e3),
        ("the same run by itself", result["single_s"], "ms", 1e3),
        ("a worker until its first row", result["start_s"], "s", 1.0),
        ("dask's client and scheduler, a job", result["job_s"], "ms", 1e3),
        ("to hand out a job, for each worker", result["worker_s"], "µs", 1e6),
        ("to keep a row", result["keep_s"], "ms", 1e3),
        ("its place in the table", result["table_s"], "ms", 1e3),
        ("a row in memory", result["memory_B"], "kB", 1e-3),
        ("a row in rows.jsonl", result["line_B"], "kB", 1e-3),
        ("a row in the table", result["parquet_B"], "kB", 1e-3),
    ):
        slopes.add_row(name, f"{scale * value:.3g} {unit}")
    slopes.add_row(
        f"1000 rows on {cores} cores, extrapolated", f"{1e3 * result['row_s'] / cores:.0f} s"
    )
    sums = Table(
        f"machines of {cores} cores", "rows in a job", "on the clock", "the one process is busy",
        "used of the cores", title="a million rows, by arithmetic",
    )  # fmt: skip
    chunks = (result["chunk"], 64)
    for machines in (1, 10, 1000):
        for chunk in chunks:
            found = scaled(result, machines, cores, chunk)
            hours = (f"{found[name]:.2g} h" for name in ("hours", "busy"))
            sums.add_row(f"{machines}", f"{chunk}", *hours, f"{found['used']:.0%}")
    most = (f"{scaled(result, 1, cores, chunk)['most']:.0f} ({chunk} in a job)" for chunk in chunks)
    sums.caption = (
        f"{MILLION * result['row_s'] / 3600:.0f} core hours of rows, "
        f"{MILLION * result['memory_B'] / 1e9:.1f} GB of memory in the one process, "
        f"which can feed {', '.join(most)} workers"
    )
    return [slopes, sums]


def draw(result: dict[str, Any], path: Path) -> None:
    """Where the processor time of a row goes."""
    from osc_contact.visual.plots import save, style

    parts = {
        "the row, in a worker": result["row_s"],
        "dask, a row": result["job_s"] / result["chunk"],
        "to keep it": result["keep_s"],
        "its place in the table": result["table_s"],
    }
    with style():
        figure, (ax,) = new_axes(1)
        bars(ax, {k: 1e3 * v for k, v in parts.items()}, "ms of processor time per row", marked=())
        save(figure, path.with_suffix(""))
