"""Sweep: all runs of a study, on all cores; an interrupted one can be continued.

A row holds the values, the verdict and the errors of a run; rows are written to a file and become
a table.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, OscContactError, PlantError, missing
from osc_contact.files import Json, hold, whole_file
from osc_contact.lab.checks.preflight import judge_rig, require_ready
from osc_contact.lab.rig.rig import Rig, build_chain, build_rig
from osc_contact.lab.runs.run import Install, run
from osc_contact.lab.runs.verdict import metrics
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.sweeps.study import Design, Sample, SweepStudy
from osc_contact.law import compiled
from osc_contact.loop.rules import Finding
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S
from osc_contact.settings.control import ModelErrorSpec

if TYPE_CHECKING:
    import distributed
    import pyarrow

#: Outcomes in addition to those of `lab.runs.verdict`: the scenario was rejected; the simulation
#: diverged; the process of the run died.
REFUSED = "REFUSED"
DIVERGED = "DIVERGED"
CRASHED = "CRASHED"
#: Fields of a verdict that rows leave out: timings, and values that other columns hold.
_LEFT_OUT = {
    "scenario",
    "plant",
    "seed",
    "real_time_factor",
    "tick_us",
    "task",
    "steps",
    "at_limit",
    "joint_losses",
    "learned_friction",
    "normals",
    "force_per_normal",
}

Row = Json  #: row of the table: values by the name of their column

# --- Making rows --------------------------------------------------------------------------------

#: Largest number of chains, and of robots, in a cache. Runs with their own masses never hit it.
_KEPT = 8
Made = TypeVar("Made")  #: type of the entries of a cache


@dataclass(frozen=True, eq=False)
class RobotAtTask:
    """Robot and task of runs that differ only in the controller's model of the robot.

    Attributes:
        rig: rig of the first run.
    """

    rig: Rig

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on the rig, see `judge_rig`."""
        return judge_rig(self.rig)


class RigBuilder(threading.local):
    """Builder of rigs with a cache of their equal parts.

    Chains of equal arms, object and factors are built once, see `build_chain`; rigs that differ
    only in the errors of the controller's model are built and judged once.

    Each thread has its own builder, as chains have working memory.

    Attributes:
        study: study whose rows this thread made last.
    """

    study: SweepStudy | None = None

    def __init__(self) -> None:
        """Make empty caches."""
        self._chains: dict[str, ClosedChain] = {}
        self._robots: dict[str, RobotAtTask] = {}

    def rig(self, scenario: Scenario) -> Rig:
        """Rig of a scenario, see `build_rig`.

        Args:
            scenario: scenario without laws and pairs written in Python.
        """
        robot = self._robot(scenario)
        if robot.rig.scenario is scenario:
            return robot.rig
        return robot.rig.with_error(scenario, self._chain)

    def require_ready(self, rig: Rig) -> list[str]:
        """Doubts about a rig of this builder, see `require_ready`.

        Raises:
            ScenarioError: the rig cannot run.
        """
        return require_ready(rig, self._robot(rig.scenario).findings)

    def _robot(self, scenario: Scenario) -> RobotAtTask:
        """Robot and task of a scenario, from the cache if possible."""
        key = robot_key(scenario)
        return _kept(self._robots, key, lambda: RobotAtTask(build_rig(scenario, self._chain)))

    def _chain(self, scenario: Scenario, error: ModelErrorSpec) -> ClosedChain:
        """Chain of a scenario with errors of its model, from the cache if possible.

        Args:
            scenario: scenario with arms, object and grasps. error: factors of masses and friction.
        """
        content = scenario.model_dump(mode="json", include={"arms", "object", "grasps"})
        key = _key(scenario, content, dict(error))
        return _kept(self._chains, key, lambda: build_chain(scenario, error))


def robot_key(scenario: Scenario) -> str:
    """Key of the robot and task of a scenario.

    It is independent of the errors of the controller's model and of the limits of the verdict, as
    are the true robot and the findings of `judge_rig`.
    """
    content = scenario.model_dump(mode="json", exclude={"model_error", "verdict"})
    return _key(scenario, content, scenario.model_error.hidden_mass)


def _key(scenario: Scenario, *content: Any) -> str:
    """Key of a cache for content of a scenario.

    Args:
        scenario: scenario, whose file is part of the key, because paths refer to its folder.
        content: JSON data.
    """
    return json.dumps([content, str(scenario.source)], sort_keys=True)


def _kept(store: dict[str, Made], key: str, make: Callable[[], Made]) -> Made:
    """Entry of a cache that is made if it is missing; the least recently used one is dropped.

    Args:
        store: the cache, the most recently used entry last.
        key: key of the entry.
        make: function that makes the entry.
    """
    made = store.pop(key) if key in store else make()
    store[key] = made  # becomes the last one
    if len(store) > _KEPT:
        del store[next(iter(store))]
    return made


_rigs = RigBuilder()


def make_rows(
    study: SweepStudy, numbers: Sequence[int], install: Install | None = None
) -> list[Row]:
    """Run some samples of a study in this thread; return a row for each.

    A row is independent of the samples that are run with it, and of the process.

    Args:
        study: study of the samples.
        numbers: numbers of the samples.
        install: function that installs another law in each controller.
    """
    if _rigs.study is not None and _rigs.study.fingerprint == study.fingerprint:
        study = _rigs.study  # its scenario is parsed already
    _rigs.study = study
    with without_logged_doubts():
        rows = [_row(study, study.sample(number), install) for number in numbers]
    return json.loads(json.dumps(rows))  # equal to rows that were read from a file


@contextmanager
def without_logged_doubts() -> Iterator[None]:
    """Suppress the log of doubts, which rows hold already, while the block runs."""
    logger = logging.getLogger("osc_contact.preflight")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def record_sample(study: SweepStudy, sample: Sample, install: Install | None = None) -> Recording:
    """Run a sample of a study and return the recording.

    Args:
        study: study of the sample.
        sample: changes of the scenario, and seed.
        install: function that installs another law in the controller.

    Raises:
        OscContactError: the scenario is rejected, or the simulation diverges.
    """
    return run(
        study.scenario(sample),
        seed=sample.seed,
        install=install,
        build=_rigs.rig,
        check=_rigs.require_ready,
    )


def require_long_enough(study: SweepStudy) -> None:
    """Refuse a study whose runs end before they are judged.

    Raises:
        InvalidInputError: the first run is too short.
    """
    duration = study.scenario(study.sample(0)).duration
    if duration <= SETTLE_S:
        raise InvalidInputError(
            f"runs of {duration:g} s end before t = {SETTLE_S:g} s, from where they are "
            "judged; give a longer --duration"
        )


def _row(study: SweepStudy, sample: Sample, install: Install | None) -> Row:
    """Run a sample and make its row; a run that is rejected or diverges has a word and a reason.

    Args:
        study: study of the sample. sample: changes of the scenario, and seed. install: function
            that installs another law in the controller; None: none.
    """
    try:
        recording = record_sample(study, sample, install)
        verdict = metrics(recording)
    except OscContactError as error:
        word = DIVERGED if isinstance(error, PlantError) else REFUSED
        return _head(sample, word, str(error))
    task = verdict["task"]
    row = _head(sample, task["word"], "\n".join(task["why"]), task["failed"])
    row["doubts"] = "\n".join(recording.meta["doubts"])
    row |= _flat({k: v for k, v in verdict.items() if k not in _LEFT_OUT})
    for name in ("overshoot_N", "overshoot_rel"):
        row[name] = max((step[name] for step in verdict["steps"]), default=None)
    return row


def _head(sample: Sample, word: str, why: str, failed: bool = True) -> Row:
    """First columns of a row.

    Args:
        sample: the sample.
        word: outcome of the run.
        why: reasons of a failure, as text.
        failed: True if the task failed.
    """
    return {
        "row": sample.number,
        "seed": sample.seed,
        **sample.shown,
        "word": word,
        "failed": failed,
        "why": why,
    }


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the items of nested mappings with joined keys: ("a.b", 1) of {"a": {"b": 1}}.

    Args:
        values: nested mappings. before: text before each key.
    """
    for key, value in values.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield (name, value)


# --- File and table -----------------------------------------------------------------------------


class RowFile:
    """File of completed rows, one in a line, which can be continued after a kill.

    Attributes:
        path: the file.
        done: completed rows by number.
    """

    def __init__(self, path: Path, study: SweepStudy, laws: object = None) -> None:
        """Open a file to continue it, or begin one.

        Args:
            path: the file.
            study: study of the rows, which the first line identifies.
            laws: JSON data that identify controllers other than the study's; None: the study's.

        Raises:
            InvalidInputError: another program writes to the file, or it holds another study.
        """
        self.path = path
        self.done: dict[int, Row] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("ab")
        try:
            hold(self._file.fileno(), path)
            self._continue(path.read_bytes(), study, laws)
        except BaseException:
            self._file.close()
            raise

    def _continue(self, text: bytes, study: SweepStudy, laws: object) -> None:
        """Read the rows of the file and remove an incomplete last line.

        Rows of damaged lines do not count as completed.

        Args:
            text: content of the file.
            study, laws: see the constructor.

        Raises:
            InvalidInputError: the file holds another study.
        """
        whole = text[: text.rfind(b"\n") + 1]
        if not whole:
            self._file.truncate(0)
            named = {"study": study.fingerprint, "vary": study.vary, "design": study.design}
            self._write(named if laws is None else named | {"laws": laws})
            return
        head, *rows = map(_parsed, whole.splitlines())
        if (head.get("study"), head.get("laws")) != (study.fingerprint, laws):
            raise InvalidInputError(
                f"{self.path} holds the rows of another study (another scenario, other "
                "distributions, another design, seed or law), or its first line is damaged; give "
                "another folder, or remove it"
            )
        self.done |= {row["row"]: row for row in rows if type(row.get("row")) is int}
        self._file.truncate(len(whole))  # once all of it is sound

    def append(self, row: Row) -> None:
        """Append a completed row to the file."""
        self.done[row["row"]] = row
        self._write(row)

    def _write(self, row: Row) -> None:
        """Write a line and hand it to the operating system."""
        self._file.write(json.dumps(row).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file after its content has reached the disk."""
        os.fsync(self._file.fileno())
        self._file.close()


def _parsed(line: bytes) -> Row:
    """JSON object of a line, an empty one for a damaged line."""
    try:
        return dict(json.loads(line))
    except (ValueError, TypeError, RecursionError):
        return {}


def make_table(rows: Iterable[Row], study: SweepStudy) -> pyarrow.Table:
    """Table of rows, sorted by number, with columns in the order of their first appearance.

    Args:
        rows: rows in any order.
        study: study of the rows, which the metadata of the table describe.

    Raises:
        InvalidInputError: a column with values of different types.
    """
    import pyarrow as pa

    ordered = sorted(rows, key=lambda row: row["row"])
    columns = {}
    for name in dict.fromkeys(name for row in ordered for name in row):
        values = [row.get(name) for row in ordered]
        try:
            columns[name] = pa.array([json.dumps(x) if isinstance(x, list) else x for x in values])
        except pa.ArrowException as error:
            raise InvalidInputError(
                f"the values of {name!r} are of several kinds ({error}): rows are damaged; remove "
                "their file, and run the study again"
            ) from error
    return pa.table(columns).replace_schema_metadata(
        {
            "study": study.fingerprint,
            "scenario": study.text,
            "vary": json.dumps(study.vary),
            "overrides": json.dumps(study.overrides),
            "design": json.dumps([study.design, study.samples, study.seed]),
        }
    )


ROWS = "rows.jsonl"  #: file of a sweep's folder
TABLE = "table.parquet"  #: file of a sweep's folder
_CHUNK = 4  #: runs of a job

Progress = Callable[[int, int], None]
Job = tuple[SweepStudy, Sequence[int]]  #: a study, and the numbers of the rows to make
MakesRows = Callable[[SweepStudy, Sequence[int]], list[Row]]


def sweep(
    scenario: str | Path | Scenario,
    vary: Mapping[str, str] | Sequence[str],
    samples: int,
    *,
    design: Design = "halton",
    seed: int = 0,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | distributed.Client | None = None,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
) -> pyarrow.Table:
    """Run a scenario many times with other values; return a table of all results.

    Row i depends on the study and on i only: not on the number of workers, and not on an
    interruption of the sweep. It equals `osc.run` of its scenario with its seed.

    Args:
        scenario: packaged name, file, or a scenario made in Python, without Python laws and pairs.
        vary: {"path.to.key": "uniform(0.8, 1.2)"}, see `lab.sweeps.study.WORDS`; the path
            "seed" is the seed of each run.
        samples: number of points; of a grid, number of values of each key with infinitely many.
        design: "halton" or "sobol" (quasi-random), "random" or "grid"; "saltelli" for
            Sobol's indices, with keys + 2 runs of each of 2^m samples.
        seed: seed of the points, and of each run if it does not vary.
        out: folder for rows and table; completed rows in it are not run again.
        workers: number of processes; None: one for each core; 1: this process only.
        scheduler: address, or `distributed.Client`, of a dask cluster whose workers run the
            samples.
        overrides: texts path=value of all runs.
        progress: function that is called with the number of completed rows and of all rows.

    Returns:
        A table sorted by row: row, seed, varied values, word, failed, why, and the numbers of
        `metrics`. Runs that were rejected, diverged or crashed have a word and a reason only.

    Raises:
        ScenarioError, InvalidInputError: errors of the study; runs too short to be judged; a folder
            with another study; a cluster that does not answer or has another version.
    """
    study = SweepStudy.of(scenario, vary, samples, design, seed, overrides)
    return run_study(study, out=out, workers=workers, scheduler=scheduler, progress=progress)


def run_study(
    study: SweepStudy,
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | distributed.Client | None = None,
    progress: Progress | None = None,
) -> pyarrow.Table:
    """Run the missing rows of a study and return the table of all rows.

    Args:
        study: study to run.
        out, workers, scheduler, progress: see `sweep`.
    """
    try:
        from pyarrow import parquet  # a missing package is reported before the runs
    except ImportError as error:
        raise InvalidInputError(missing(error)) from error

    file = None if out is None else Path(out) / ROWS
    done = run_rows(study, file, workers=workers, scheduler=scheduler, progress=progress)
    table = make_table(done.values(), study)
    if out is not None:
        with whole_file(Path(out) / TABLE) as unfinished:
            parquet.write_table(table, unfinished)
    return table


def run_rows(
    study: SweepStudy,
    file: Path | None,
    make: MakesRows = make_rows,
    *,
    laws: object = None,
    workers: int | None = None,
    scheduler: str | distributed.Client | None = None,
    progress: Progress | None = None,
) -> dict[int, Row]:
    """Rows of a study by number, from a file and by running the missing ones.

    Args:
        study: study to run.
        file: file of the rows; None: they are not written.
        make: function that makes rows, which other processes import.
        laws: see `RowFile`.
        workers, scheduler, progress: see `sweep`.
    """
    require_long_enough(study)
    with ExitStack() as stack:
        rows = None
        if file is not None:
            rows = stack.enter_context(closing(RowFile(file, study, laws)))
        done = {} if rows is None else rows.done
        remaining = [number for number in range(study.rows) if number not in done]
        completed = study.rows - len(remaining)
        jobs = [(study, remaining[i : i + _CHUNK]) for i in range(0, len(remaining), _CHUNK)]
        crew = stack.enter_context(workers_of(workers, scheduler, len(jobs)))
        for _, row in make_all(crew, jobs, make):
            done[row["row"]] = row
            completed += 1
            if rows is not None:
                rows.append(row)
            if progress is not None:
                progress(completed, study.rows)
    return {number: done[number] for number in range(study.rows)}


# Workers: processes of this machine, or the workers of a dask cluster.


_AHEAD = 2  #: jobs that are submitted for each worker


@dataclass
class Workers:
    """Workers in other processes.

    Attributes:
        executor: function that makes an executor, and a new one if the death of a worker has broken
            the last.
        count: function that returns the present number of workers.
        deaths: error of a job that has ended its worker.
    """

    executor: Callable[[], Executor]
    count: Callable[[], int]
    deaths: type[Exception] = BrokenExecutor

    def __post_init__(self) -> None:
        """Make the first executor."""
        self._executor = self.executor()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Submit a call to the workers; a broken executor is replaced before.

        Args:
            function: function that other processes import. arguments: its arguments, which are
                pickled.

        Returns:
            Future result of the call.
        """
        try:
            return self._executor.submit(function, *arguments)
        except BrokenExecutor:
            self.close()
            self._executor = self.executor()
            return self._executor.submit(function, *arguments)

    def close(self) -> None:
        """Wait for the calls in progress and end the workers."""
        self._executor.shutdown()


@contextmanager
def workers_of(
    workers: int | None, scheduler: str | distributed.Client | None, most: int
) -> Iterator[Workers | None]:
    """Yield workers for the block; None: this process makes the rows.

    Args:
        workers: number of processes; None: one for each core.
        scheduler: dask cluster, see `sweep`; None: processes of this machine.
        most: largest number of workers that have something to do.

    Raises:
        InvalidInputError: both are given; the cluster cannot be used, see `cluster.connect`.
    """
    if workers is not None and scheduler is not None:
        raise InvalidInputError(f"{workers} workers: a cluster has its own; leave workers out")
    count = min(available_cores() if workers is None else workers, most)
    if scheduler is None and count <= 1:
        yield None
        return
    with ExitStack() as stack:
        if scheduler is None:
            context = get_context("spawn")  # threads of this process would not survive a fork
            crew = Workers(lambda: ProcessPoolExecutor(count, context, _begin_work), lambda: count)
            for _ in range(count):  # they import this package while their work is prepared
                crew.submit(available_cores)
        else:
            from distributed.scheduler import KilledWorker

            from osc_contact.lab.sweeps.cluster import connect

            client = stack.enter_context(connect(scheduler))
            crew = Workers(
                client.get_executor, lambda: max(1, sum(client.nthreads().values())), KilledWorker
            )
        stack.callback(crew.close)
        compiled.rows()  # compiled here, so that the workers load the library
        yield crew


def make_all(
    workers: Workers | None, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[SweepStudy, Row]]:
    """Rows of all jobs with their studies, in the order of their completion.

    The jobs of a worker whose process has died are repeated row by row; a row whose worker dies
    again becomes a row with this error.

    Args:
        workers: workers; None: this process.
        jobs: the jobs.
        make: function that makes the rows of a job, which other processes import.
    """
    if workers is None:
        for study, numbers in jobs:
            for number in numbers:
                yield (study, make(study, [number])[0])
        return
    repeated: list[Job] = []  # each with one row
    for (study, numbers), rows in _hand_out(workers, jobs, make):
        if rows is None:
            repeated += [(study, [number]) for number in numbers]
        else:
            for row in rows:
                yield (study, row)
    for job in repeated:  # one at a time, so that a crash concerns no other row
        for (study, numbers), rows in _hand_out(workers, [job], make):
            if rows:
                yield (study, rows[0])
            else:
                why = "its process died twice; run it alone to find the cause"
                yield (study, _head(study.sample(numbers[0]), CRASHED, why))


def available_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _hand_out(
    workers: Workers, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[Job, list[Row] | None]]:
    """Yield jobs with their rows, in the order of their completion.

    Only a few jobs for each worker are submitted at a time, so that little is lost if it ends.

    Args:
        workers: workers in other processes. jobs: jobs to be done. make: function that makes the
            rows of a job, which other processes import.

    Yields:
        Job, and its rows; None in place of the rows if the worker of the job has died.

    Raises:
        OscContactError: the cluster is lost.
    """
    job_iterator = iter(jobs)
    submitted: dict[Future[list[Row]], Job] = {}
    try:
        while True:
            free = max(0, workers.count() * _AHEAD - len(submitted))
            for job in islice(job_iterator, free):
                submitted[workers.submit(make, *job)] = job
            if not submitted:
                return
            for future in wait(submitted, return_when=FIRST_COMPLETED).done:
                job = submitted.pop(future)
                try:
                    rows = future.result()
                except workers.deaths:
                    rows = None
                yield (job, rows)
    except CancelledError as error:
        raise OscContactError(
            "the cluster is lost; start it again, and the same call continues with what is done"
        ) from error
    finally:
        for future in submitted:
            future.cancel()


def end_with_parent() -> None:
    """Wait until the parent process has ended, however it ends, and end this process."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _begin_work() -> None:
    """Initialise a worker process.

    Ctrl-C reaches all processes of a terminal and is ignored here; a worker ends when its parent
    ends. A signal ends it at once, without a recording, which would not be read.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        signal.signal(number, lambda number, frame: os._exit(128 + number))
    threading.Thread(target=end_with_parent, daemon=True).start()
    gc.freeze()  # modules stay in memory: collections need not visit them
