"""A sweep: every run of a study, on all cores, continued where it was interrupted.

A row holds the numbers, the verdict and the errors of a run; rows go to a file, and to a table.
"""

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
from typing import Any, TypeVar

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, OscContactError, PlantError
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

#: Words beside those of `lab.runs.verdict`: it could not be built or is not possible; the
#: simulation diverged; the process that ran it died.
REFUSED = "REFUSED"
DIVERGED = "DIVERGED"
CRASHED = "CRASHED"
#: Of a verdict: what a clock measured, and what stands elsewhere in the row.
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

Row = Json

# --- Making rows --------------------------------------------------------------------------------

_KEPT = 8  #: chains, and robots; where each run has its own numbers they are not needed again
Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class RobotAtTask:
    """The robot and task that runs share when only the controller's model of the robot differs.

    Attributes:
        rig: of the first of them.
    """

    rig: Rig

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """See `judge_rig`."""
        return judge_rig(self.rig)


class RigBuilder(threading.local):
    """Builds and judges rigs; what is equal in several is built and judged once.

    Chains of the same arms, object and factors are the same chain, see `build_chain`; rigs that
    differ in what the controller's model has wrong only are built, and judged, as one robot.

    Each thread has its own: chains hold scratch memory.

    Attributes:
        study: whose rows this thread made last.
    """

    study: SweepStudy | None = None

    def __init__(self) -> None:
        """Nothing is built yet."""
        self._chains: dict[str, ClosedChain] = {}
        self._robots: dict[str, RobotAtTask] = {}

    def rig(self, scenario: Scenario) -> Rig:
        """See `build_rig`.

        Args:
            scenario: as a file gives it, without laws and pairs written in Python.
        """
        robot = self._robot(scenario)
        if robot.rig.scenario is scenario:
            return robot.rig
        return robot.rig.with_error(scenario, self._chain)

    def require_ready(self, rig: Rig) -> list[str]:
        """See `preflight.require_ready`; rig: of `RigBuilder.rig`."""
        return require_ready(rig, self._robot(rig.scenario).findings)

    def _robot(self, scenario: Scenario) -> RobotAtTask:
        key = robot_key(scenario)
        return _kept(self._robots, key, lambda: RobotAtTask(build_rig(scenario, self._chain)))

    def _chain(self, scenario: Scenario, error: ModelErrorSpec) -> ClosedChain:
        content = scenario.model_dump(mode="json", include={"arms", "object", "grasps"})
        key = _key(scenario, content, dict(error))
        return _kept(self._chains, key, lambda: build_chain(scenario, error))


def robot_key(scenario: Scenario) -> str:
    """Text that is equal for scenarios of the same robot at the same task.

    They may differ in what the controller's model has wrong, and in the limits of the verdict: the
    true robot, and what `judge_rig` looks at, do not depend on either.
    """
    content = scenario.model_dump(mode="json", exclude={"model_error", "verdict"})
    return _key(scenario, content, scenario.model_error.hidden_mass)


def _key(scenario: Scenario, *content: Any) -> str:
    """Text that is equal for equal content of scenarios whose files are looked for at one place."""
    return json.dumps([content, str(scenario.source)], sort_keys=True)


def _kept(store: dict[str, Made], key: str, make: Callable[[], Made]) -> Made:
    """The entry under a key, made if missing; the least recently used one is dropped."""
    made = store.pop(key) if key in store else make()
    store[key] = made  # behind those that were used before
    if len(store) > _KEPT:
        del store[next(iter(store))]
    return made


_rigs = RigBuilder()


def make_rows(
    study: SweepStudy, numbers: Sequence[int], install: Install | None = None
) -> list[Row]:
    """Run some samples of a study, in this thread; a row for each.

    Rows do not depend on which of them are run together, or where.

    Args:
        study: of the rows. numbers: of them. install: puts another law into each controller.
    """
    if _rigs.study is not None and _rigs.study.fingerprint == study.fingerprint:
        study = _rigs.study  # which is read already
    _rigs.study = study
    with without_logged_doubts():
        rows = [_row(study, study.sample(number), install) for number in numbers]
    return json.loads(json.dumps(rows))  # as they come out of a file


@contextmanager
def without_logged_doubts() -> Iterator[None]:
    """Doubts that stand in rows are not logged a thousand times."""
    logger = logging.getLogger("osc_contact.preflight")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def record_sample(study: SweepStudy, sample: Sample, install: Install | None = None) -> Recording:
    """The recording of one run of a study.

    Args:
        study: which the sample belongs to.
        sample: its changes and its seed.
        install: puts another law into each controller.

    Raises:
        OscContactError: it cannot be built, is not possible, or diverges.
    """
    return run(
        study.scenario(sample),
        seed=sample.seed,
        install=install,
        build=_rigs.rig,
        check=_rigs.require_ready,
    )


def require_long_enough(study: SweepStudy) -> None:
    """Refuse runs that end before they are judged.

    Raises:
        InvalidInputError: with the duration of the first.
    """
    duration = study.scenario(study.sample(0)).duration
    if duration <= SETTLE_S:
        raise InvalidInputError(
            f"runs of {duration:g} s end before t = {SETTLE_S:g} s, from where they are "
            "judged; give a longer --duration"
        )


def _row(study: SweepStudy, sample: Sample, install: Install | None) -> Row:
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
    return {
        "row": sample.number,
        "seed": sample.seed,
        **sample.shown,
        "word": word,
        "failed": failed,
        "why": why,
    }


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """{"a": {"b": 1}} → ("a.b", 1)"""
    for key, value in values.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield (name, value)


# --- File and table -----------------------------------------------------------------------------


class RowFile:
    """Rows that are done, one a line; what is written survives a kill, also amid a line.

    Attributes:
        path: of the file. done: rows by number.
    """

    def __init__(self, path: Path, study: SweepStudy, laws: Any = None) -> None:
        """Continue a file, or begin one.

        Args:
            path: of the file. study: that the rows belong to; its first line names it.
            laws: JSON-able, of the controllers that make the rows where they are not the study's.

        Raises:
            InvalidInputError: another program writes to it, or it holds another study.
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

    def _continue(self, text: bytes, study: SweepStudy, laws: Any) -> None:
        """Read the rows that the file holds, and make it end with a whole line.

        Those of damaged lines are not done: they are made again.
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
        """Keep a row, now."""
        self.done[row["row"]] = row
        self._write(row)

    def _write(self, row: Row) -> None:
        self._file.write(json.dumps(row).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Nothing more comes."""
        os.fsync(self._file.fileno())
        self._file.close()


def _parsed(line: bytes) -> Row:
    """The object of a line, an empty one where it is damaged."""
    try:
        return dict(json.loads(line))
    except (ValueError, TypeError, RecursionError):
        return {}


def make_table(rows: Iterable[Row], study: SweepStudy) -> Any:
    """A `pyarrow.Table`, sorted by row, columns in the order in which they first appear.

    Args:
        rows: of the study, in any order. study: kept in the table's metadata.
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
_CHUNK = 4  #: runs that a worker is handed at once

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
    scheduler: Any = None,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
) -> Any:
    """Run a scenario many times with other numbers; one table of all results.

    Row i depends on the study and i alone: not on how many workers there are, and not on whether
    the sweep was interrupted. It equals `osc.run` of its scenario with its seed.

    Args:
        scenario: packaged name, file, or a scenario made in Python, without Python laws and pairs.
        vary: {"path.to.key": "uniform(0.8, 1.2)"}, see `lab.sweeps.study.WORDS`; the path
            "seed" is the seed of each run.
        samples: how many points; on a grid, how many values of each key that can have any.
        design: "halton" or "sobol" (quasi-random), "random" or "grid"; "saltelli" for
            Sobol's indices, with keys + 2 runs of each of 2^m samples.
        seed: of the points, and of each run where it does not vary.
        out: a folder for rows and table; rows that are done there are not run again.
        workers: processes; None: one for each core; 1: none but this one.
        scheduler: of a dask cluster whose workers do it instead: its address, or a
            `distributed.Client`.
        overrides: path=value, of all runs.
        progress: called with the rows done and all rows, now and then.

    Returns:
        A `pyarrow.Table` sorted by row: row, seed, what varied, word, failed, why, and the numbers
        of `metrics`. Runs that could not be built, diverged or crashed have a word and a reason.

    Raises:
        ScenarioError, InvalidInputError: the study is not understood; runs too short to be judged;
            the folder holds another study; the cluster does not answer or does not fit.
    """
    study = SweepStudy.of(scenario, vary, samples, design, seed, overrides)
    return run_study(study, out=out, workers=workers, scheduler=scheduler, progress=progress)


def run_study(study: SweepStudy, *, out: str | Path | None = None, **how: Any) -> Any:
    """Run what is not done yet of a study, see `sweep`.

    Args:
        study: what to run. out: as of `sweep`.
        how: workers, scheduler, progress of `run_rows`.
    """
    from pyarrow import parquet  # refused before the runs, not after them

    file = None if out is None else Path(out) / ROWS
    done = run_rows(study, file, **how)
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
    laws: Any = None,
    workers: int | None = None,
    scheduler: Any = None,
    progress: Progress | None = None,
) -> dict[int, Row]:
    """Rows of a study by number: those of a file, and what is not done yet.

    Args:
        study: what to run.
        file: for the rows; None: they are not kept.
        make: makes rows; other processes import it.
        laws: see `RowFile`.
        workers, scheduler, progress: as of `sweep`.
    """
    require_long_enough(study)
    with ExitStack() as stack:
        rows = None
        if file is not None:
            rows = stack.enter_context(closing(RowFile(file, study, laws)))
        done = {} if rows is None else rows.done
        left = [number for number in range(study.rows) if number not in done]
        ended = study.rows - len(left)
        jobs = [(study, left[i : i + _CHUNK]) for i in range(0, len(left), _CHUNK)]
        crew = stack.enter_context(workers_of(workers, scheduler, len(jobs)))
        for _, row in make_all(crew, jobs, make):
            done[row["row"]] = row
            ended += 1
            if rows is not None:
                rows.append(row)
            if progress is not None:
                progress(ended, study.rows)
    return {number: done[number] for number in range(study.rows)}


# Who makes rows: this process, processes of this machine, or the workers of a dask cluster.


_AHEAD = 2  #: jobs that wait for each worker


@dataclass
class Workers:
    """Workers in other processes.

    Attributes:
        executor: makes one, and another one where a worker's death broke the first.
        count: how many workers there are now.
        deaths: what a job raises that has ended its worker.
    """

    executor: Callable[[], Executor]
    count: Callable[[], int]
    deaths: type[Exception] = BrokenExecutor

    def __post_init__(self) -> None:
        self._executor = self.executor()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have a function called, by a new executor where a worker's death broke the last one."""
        try:
            return self._executor.submit(function, *arguments)
        except BrokenExecutor:
            self.close()
            self._executor = self.executor()
            return self._executor.submit(function, *arguments)

    def close(self) -> None:
        """Wait for what is under way."""
        self._executor.shutdown()


@contextmanager
def workers_of(workers: int | None, scheduler: Any, most: int) -> Iterator[Workers | None]:
    """Workers while the block lasts; None: this process does it.

    Args:
        workers: processes; None: one for each core. scheduler: see `sweep`.
        most: how many can have work.

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
            made = Workers(lambda: ProcessPoolExecutor(count, context, _begin_work), lambda: count)
            for _ in range(count):  # they import this package while their work is prepared
                made.submit(available_cores)
        else:
            from distributed.scheduler import KilledWorker

            from osc_contact.lab.sweeps.cluster import connect

            client = stack.enter_context(connect(scheduler))
            made = Workers(
                client.get_executor, lambda: max(1, sum(client.nthreads().values())), KilledWorker
            )
        stack.callback(made.close)
        compiled.rows()  # compiled once if need be, not in every worker
        yield made


def make_all(
    workers: Workers | None, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[SweepStudy, Row]]:
    """All rows of all jobs, in the order in which they are done.

    Where a worker's process ends, its jobs are done again, row by row; a row that ends its worker
    then, too, becomes a row with this error.

    Args:
        workers: see `workers_of`; None: this process. jobs: what is to be done.
        make: makes the rows of a job, such as `make_rows`; other processes import it.
    """
    if workers is None:
        for study, numbers in jobs:
            for number in numbers:
                yield (study, make(study, [number])[0])
        return
    lost: list[Job] = []
    for (study, numbers), rows in _hand_out(workers, jobs, make):
        if rows is None:
            lost += [(study, [number]) for number in numbers]
        else:
            yield from ((study, row) for row in rows)
    for job in lost:  # it may have ended a worker: now alone
        for (study, numbers), rows in _hand_out(workers, [job], make):
            why = "its process died twice; run it alone to find the cause"
            yield (study, rows[0] if rows else _head(study.sample(numbers[0]), CRASHED, why))


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _hand_out(
    workers: Workers, jobs: Iterable[Job], make: MakesRows
) -> Iterator[tuple[Job, list[Row] | None]]:
    """Jobs with their rows as they come; None: a worker died while the job was under way."""
    waiting = iter(jobs)
    under_way: dict[Future[list[Row]], Job] = {}
    try:
        while True:
            for job in islice(waiting, max(0, workers.count() * _AHEAD - len(under_way))):
                under_way[workers.submit(make, *job)] = job
            if not under_way:
                return
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                job = under_way.pop(future)
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
        for future in under_way:
            future.cancel()


def end_with_parent() -> None:
    """Wait until the parent process has ended, which a kill does not let it announce; then end."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _begin_work() -> None:
    """A worker process begins.

    Ctrl-C goes to all processes of a terminal; workers end when their parent does, however it ends.
    And at once, not in order as a run does by itself: nobody reads its recording any more.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        signal.signal(number, lambda number, frame: os._exit(128 + number))
    threading.Thread(target=end_with_parent, daemon=True).start()
    gc.freeze()  # what is imported stays; not looked through again with every run
