"""Rows of a sweep: values, verdict and errors of one run each, made with a cache of equal parts."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, OscContactError, PlantError
from osc_contact.files import Json
from osc_contact.lab.checks.preflight import judge_rig, require_ready
from osc_contact.lab.rig.rig import Rig, build_chain, build_rig
from osc_contact.lab.runs.run import Install, run
from osc_contact.lab.runs.verdict import metrics
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.sweeps.study import Sample, SweepStudy
from osc_contact.loop.rules import Finding
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S
from osc_contact.settings.control import ModelErrorSpec

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

#: Largest number of chains, and of robots, in a cache. Runs with their own masses never hit it.
_CACHE_SIZE = 8
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
        #: chains by the parts of a scenario on which they depend
        self._chains: dict[str, ClosedChain] = {}
        #: judged robots at their tasks, by the parts of a scenario on which they depend
        self._robots: dict[str, RobotAtTask] = {}

    def rig(self, scenario: Scenario) -> Rig:
        """Make the rig of a scenario from equal parts that were built before.

        A scenario that differs from one in the cache in its model error only gets that rig, with
        another model of the arms; `_chain` makes models, with a cache of their own.

        Args:
            scenario: scenario without laws and pairs written in Python.
        """
        robot = self._robot(scenario)
        if robot.rig.scenario is scenario:
            return robot.rig
        return robot.rig.with_error(scenario, self._chain)

    def require_ready(self, rig: Rig) -> list[str]:
        """Check a rig of this builder before its run; return sentences on doubts.

        Args:
            rig: rig made by `rig`.

        Raises:
            ScenarioError: the rig cannot run.
        """
        return require_ready(rig, self._robot(rig.scenario).findings)

    def _robot(self, scenario: Scenario) -> RobotAtTask:
        """Robot and task of a scenario, from the cache if possible."""
        key = robot_key(scenario)
        return _get_or_make(
            self._robots, key, lambda: RobotAtTask(build_rig(scenario, self._chain))
        )

    def _chain(self, scenario: Scenario, error: ModelErrorSpec) -> ClosedChain:
        """Chain of a scenario with errors of its model, from the cache if possible.

        Args:
            scenario: scenario with arms, object and grasps.
            error: factors of masses and friction.
        """
        content = scenario.model_dump(mode="json", include={"arms", "object", "grasps"})
        key = _key(scenario, content, dict(error))
        return _get_or_make(self._chains, key, lambda: build_chain(scenario, error))


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


def _get_or_make(store: dict[str, Made], key: str, make: Callable[[], Made]) -> Made:
    """Entry of a cache that is made if it is missing; the least recently used one is dropped.

    Args:
        store: the cache, the most recently used entry last.
        key: key of the entry.
        make: function that makes the entry.
    """
    value = store.pop(key) if key in store else make()
    store[key] = value  # becomes the last one
    if len(store) > _CACHE_SIZE:
        del store[next(iter(store))]
    return value


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
        study: study of the sample.
        sample: changes of the scenario, and seed.
        install: function that installs another law in the controller; None: none.
    """
    try:
        recording = record_sample(study, sample, install)
        verdict = metrics(recording)
    except OscContactError as error:
        word = DIVERGED if isinstance(error, PlantError) else REFUSED
        return first_columns(sample, word, str(error))
    task = verdict["task"]
    row = first_columns(sample, task["word"], "\n".join(task["why"]), task["failed"])
    row["doubts"] = "\n".join(recording.meta["doubts"])
    row |= _flatten({k: v for k, v in verdict.items() if k not in _LEFT_OUT})
    for name in ("overshoot_N", "overshoot_rel"):
        row[name] = max((step[name] for step in verdict["steps"]), default=None)
    return row


def first_columns(sample: Sample, word: str, why: str, failed: bool = True) -> Row:
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


def _flatten(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the items of nested mappings with joined keys: ("a.b", 1) of {"a": {"b": 1}}.

    Args:
        values: nested mappings.
        before: text before each key.
    """
    for key, value in values.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{name}.")
        else:
            yield (name, value)
