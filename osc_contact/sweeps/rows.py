"""Rows of a study: each run's numbers, verdict and errors; the file and the table they go to."""

import json
import logging
import os
import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, OscContactError, PlantError
from osc_contact.files import hold
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S
from osc_contact.runs.rig import Rig, build_chain, build_rig
from osc_contact.runs.run import Install, run
from osc_contact.runs.verdict import metrics
from osc_contact.scenarios.control_schema import ModelErrorSpec
from osc_contact.scenarios.schema import Scenario
from osc_contact.sweeps.study import Sample, SweepStudy, texts

#: Words beside those of `runs.verdict`: it could not be built or is not possible; the simulation
#: diverged; the process that ran it died.
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

Row = dict[str, Any]

# --- Making rows --------------------------------------------------------------------------------

_KEPT = 8  #: chains; where each run has its own masses they are not needed again


class RigBuilder(threading.local):
    """Builds rigs; chains of the same arms, object and factors are the same chain.

    Each thread has its own chains: they hold scratch memory.

    Attributes:
        study: whose rows this thread made last.
    """

    study: SweepStudy | None = None

    def __init__(self) -> None:
        """No chains."""
        self._chains: OrderedDict[str, ClosedChain] = OrderedDict()

    def rig(self, scenario: Scenario) -> Rig:
        """See `build_rig`."""
        return build_rig(scenario, self._chain)

    def _chain(self, scenario: Scenario, error: ModelErrorSpec) -> ClosedChain:
        content = scenario.model_dump(mode="json", include={"arms", "object", "grasps"})
        key = json.dumps([content, dict(error), str(scenario.source)], sort_keys=True)
        if key not in self._chains:
            self._chains[key] = build_chain(scenario, error)
            if len(self._chains) > _KEPT:
                self._chains.popitem(last=False)
        self._chains.move_to_end(key)
        return self._chains[key]


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
    scenario = scenario_of(study, sample)
    return run(scenario, seed=sample.seed, install=install, build=_rigs.rig)


def scenario_of(study: SweepStudy, sample: Sample) -> Scenario:
    """The scenario of one run."""
    return study.template.make([*study.overrides, *texts(sample.overrides)])


def require_long_enough(scenario: Scenario) -> None:
    """Refuse runs that end before they are judged.

    Raises:
        InvalidInputError: with the duration.
    """
    if scenario.duration <= SETTLE_S:
        raise InvalidInputError(
            f"runs of {scenario.duration:g} s end before t = {SETTLE_S:g} s, from where they are "
            "judged; give a longer --duration"
        )


def crashed_row(study: SweepStudy, number: int) -> Row:
    """The row of a run that ended its process, twice."""
    why = "its process died twice; run it alone to find the cause"
    return _head(study.sample(number), CRASHED, why)


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
    row |= _flat("", {k: v for k, v in verdict.items() if k not in _LEFT_OUT})
    for name in ("overshoot_N", "overshoot_rel"):
        row[name] = max((step[name] for step in verdict["steps"]), default=None)
    return row


def _head(sample: Sample, word: str, why: str, failed: bool = True) -> Row:
    about = {"word": word, "failed": failed, "why": why}
    return {"row": sample.number, "seed": sample.seed, **sample.shown, **about}


def _flat(path: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """{"a": {"b": 1}} → ("a.b", 1)"""
    for key, value in values.items():
        name = f"{path}.{key}" if path else str(key)
        if isinstance(value, Mapping):
            yield from _flat(name, value)
        else:
            yield name, value


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
            InvalidInputError: another program writes to it, it is damaged, or it holds another
                study.
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
        """Read the rows that the file holds, and make it end with a whole line."""
        whole = text[: text.rfind(b"\n") + 1]
        if not whole:
            self._file.truncate(0)
            named = {"study": study.fingerprint, "vary": study.vary, "design": study.design}
            self._write(named if laws is None else named | {"laws": laws})
            return
        head, *lines = whole.splitlines()
        of = self._read(1, head, "study", str)
        if (of["study"], of.get("laws")) != (study.fingerprint, laws):
            raise InvalidInputError(
                f"{self.path} holds the rows of another study: another scenario, other "
                "distributions, another design, seed or law; give another folder, or remove it"
            )
        for number, line in enumerate(lines, 2):
            row = self._read(number, line, "row", int)
            self.done[row["row"]] = row
        self._file.truncate(len(whole))  # once all of it is sound

    def _read(self, number: int, line: bytes, key: str, kind: type) -> Row:
        """A line as an object with a key of a kind.

        Raises:
            InvalidInputError: it is damaged.
        """
        try:
            row = json.loads(line)
            if type(row[key]) is kind:
                return row
            cause = f"its {key!r} is {row[key]!r}"
        except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
            cause = f"{type(error).__name__}: {error}"
        cure = (
            "remove it: its run is done again" if number > 1 else "remove the file, and begin anew"
        )
        raise InvalidInputError(f"{self.path}: line {number} is damaged ({cause}); {cure}")

    def append(self, rows: Iterable[Row]) -> None:
        """Keep rows, now."""
        for row in rows:
            self.done[row["row"]] = row
            self._write(row)

    def _write(self, row: Row) -> None:
        self._file.write(json.dumps(row).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Nothing more comes."""
        os.fsync(self._file.fileno())
        self._file.close()


def make_table(rows: Sequence[Row], study: SweepStudy) -> Any:
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
    about = {
        "study": study.fingerprint,
        "scenario": study.text,
        "vary": json.dumps(study.vary),
        "overrides": json.dumps(study.overrides),
        "design": json.dumps([study.design, study.samples, study.seed]),
    }
    return pa.table(columns).replace_schema_metadata(about)
