"""Rows of a study's table: each run's numbers, verdict and errors."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from osc_contact.errors import Interrupted, InvalidInputError, OscContactError, PlantError
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S
from osc_contact.recorder.memory import MemoryJournal
from osc_contact.runs.metrics import metrics
from osc_contact.runs.run import Install, run_rig
from osc_contact.scenarios.schema import Scenario
from osc_contact.sweeps.study import Sample, SweepStudy
from osc_contact.sweeps.workshop import Workshop

__all__ = [
    "CRASHED",
    "DIVERGED",
    "REFUSED",
    "crashed_row",
    "make_rows",
    "record_sample",
    "require_long_enough",
    "scenario_of",
    "without_doubts_told",
]

#: Words beside those of `runs.outcome`: it could not be built or is not possible; the simulation
#: diverged; the process that ran it died.
REFUSED, DIVERGED, CRASHED = "REFUSED", "DIVERGED", "CRASHED"
#: Of a verdict: what a clock measured, and what the row says elsewhere.
_LEFT_OUT = frozenset({"scenario", "plant", "seed", "real_time_factor", "tick_us", "task", "steps",
                       "at_limit", "joint_losses"})  # fmt: skip

Row = dict[str, Any]
_mine = threading.local()  # workshops are not shared between threads


def make_rows(
    study: SweepStudy, numbers: Sequence[int], install: Install | None = None
) -> list[Row]:
    """Run some samples of a study, in this thread; a row for each.

    Rows do not depend on which of them are run together, or where.

    Args:
        study: of the rows. numbers: of them. install: puts another law into each controller.
    """
    if getattr(_mine, "fingerprint", None) != study.fingerprint:
        _mine.study, _mine.fingerprint = study, study.fingerprint
        _mine.workshop = getattr(_mine, "workshop", None) or Workshop()
    with without_doubts_told():
        rows = [_row(_mine.study, _mine.workshop, number, install) for number in numbers]
    return json.loads(json.dumps(rows))  # as they come out of a file


@contextmanager
def without_doubts_told() -> Iterator[None]:
    """Doubts that stand in rows are not told a thousand times."""
    logger = logging.getLogger("osc_contact.preflight")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def record_sample(
    study: SweepStudy,
    sample: Sample,
    workshop: Workshop | None = None,
    install: Install | None = None,
) -> Recording:
    """The recording of one run of a study.

    Args:
        study: which the sample belongs to.
        sample: its changes and its seed.
        workshop: keeps the parts that runs share (None: nothing is shared).
        install: puts another law into each controller.

    Raises:
        OscContactError: it cannot be built, is not possible, or diverges.
    """
    workshop = Workshop() if workshop is None else workshop
    rig = workshop.rig(scenario_of(study, sample))
    return run_rig(rig, sample.seed, install=install, journal=MemoryJournal())


def scenario_of(study: SweepStudy, sample: Sample) -> Scenario:
    """The scenario of one run."""
    changes = [*study.overrides, *(f"{k}={v}" for k, v in sample.overrides.items())]
    return study.template.make(changes)


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
    why = "the process that ran it died, twice; run it alone to see why"
    return _head(study.sample(number)) | {"word": CRASHED, "failed": True, "why": why}


def _row(study: SweepStudy, workshop: Workshop, number: int, install: Install | None = None) -> Row:
    sample = study.sample(number)
    row = _head(sample)
    try:
        recording = record_sample(study, sample, workshop, install)
        verdict = metrics(recording)
    except Interrupted:
        raise
    except PlantError as error:
        return row | {"word": DIVERGED, "failed": True, "why": str(error)}
    except OscContactError as error:
        return row | {"word": REFUSED, "failed": True, "why": str(error)}
    task = verdict["task"]
    row |= {"word": task["word"], "failed": task["failed"], "why": "\n".join(task["why"])}
    row["doubts"] = "\n".join(recording.meta["doubts"])
    row |= dict(_flat("", {k: v for k, v in verdict.items() if k not in _LEFT_OUT}))
    for name in ("overshoot_N", "overshoot_rel"):
        row[name] = max((step[name] for step in verdict["steps"]), default=None)
    return row


def _head(sample: Sample) -> Row:
    return {"row": sample.number, "seed": sample.seed, **sample.shown}


def _flat(path: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """{"a": {"b": 1}} → ("a.b", 1)"""
    for key, value in values.items():
        name = f"{path}.{key}" if path else str(key)
        if isinstance(value, Mapping):
            yield from _flat(name, value)
        else:
            yield name, value
