"""Ours and the best selection law where plant and controller's model differ: the runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.contacts.pairs import ContactPair
from osc_contact.errors import OscContactError, PlantError
from osc_contact.paper.baselines.coupling import Instant
from osc_contact.paper.baselines.frames import best_frames
from osc_contact.paper.baselines.laws import BASELINES, Law, Ours, SelectionLaw
from osc_contact.runs.metrics import metrics
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.spatial import Array
from osc_contact.sweeps.driven_run import record_run
from osc_contact.sweeps.rows import DIVERGED, REFUSED, scenario_of, without_doubts_told
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.table import RowFile
from osc_contact.sweeps.workers import make_all, workers_of

__all__ = [
    "LAWS", "QUANTITIES", "SAMPLES", "SHARES", "TITLES", "VARIED", "Robustness", "best_law", "run",
]  # fmt: skip

SCENARIO = "two_contact_rod"
SAMPLES = 1000  #: of each case, unless others are asked for
#: What is not as the controllers believe, by case.
VARIED: dict[str, tuple[str, ...]] = {
    "masses": (
        "model_error.object_mass=uniform(0.8, 1.2)",
        "model_error.arm_mass=uniform(0.8, 1.2)",
    ),
    "friction": ("plant.friction=uniform(0, 0.2)",),
    "delay": (
        "sensors.wrist.rate=choice(1 kHz)",
        "sensors.wrist.delay=uniform(0 ms, 10 ms)",
    ),
    "normals": (
        "contacts.left_end.face.normal=tilt(5 deg)",
        "contacts.right_end.face.normal=tilt(5 deg)",
    ),
}
TITLES = {
    "masses": "masses ± 20 %",
    "friction": "friction up to 0.2",
    "delay": "wrist delay up to 10 ms",
    "normals": "normals up to 5° off",
}
LAWS = ("ours", "selection")
QUANTITIES = {"force": "force error, rms (%)", "motion": "motion error, rms (mm)"}
SHARES = (0.5, 0.9, 0.99)
_SCALE = {"force": 100.0, "motion": 1e3}
#: A control rate at which a row is cheap; the task's slow first part is over after 1 s.
_AT = ("control.rate=250 Hz", "plant.step=0.5 ms", "duration=1.5 s")
_FIRST = 2  #: samples of each case by which the best selection law is chosen


@dataclass(frozen=True)
class Robustness:
    """What both laws made of the same runs.

    Attributes:
        law: the best selection law. candidates: (law, force error, motion error) of all that do
            the task: geometric means over the runs by which the best was chosen.
        rows: by what varies: one a sample, with `LAW.word`, `LAW.failed`, `LAW.force` (relative
            rms error of the worse contact) and `LAW.motion` (rms error of the position, m).
        nominal: the row without anything varied. changes: key=value of all runs.
    """

    law: SelectionLaw
    candidates: list[tuple[SelectionLaw, float, float]]
    rows: dict[str, list[dict[str, Any]]]
    nominal: dict[str, Any]
    changes: tuple[str, ...] = ()

    def errors(self, varied: str, law: str, quantity: str) -> Array:
        """(samples,) sorted, in the units of `QUANTITIES`; infinite where the task failed.

        Args:
            varied: of `VARIED`. law: of `LAWS`. quantity: of `QUANTITIES`.
        """
        rows = self.rows[varied]
        found = [np.inf if r[f"{law}.failed"] else r[f"{law}.{quantity}"] for r in rows]
        return np.sort(_SCALE[quantity] * np.array(found, dtype=float))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: how the law was chosen, quantiles of every case and all rows."""
        chosen = self.law.selection
        return {
            "scenario": SCENARIO,
            "set_in_all_runs": list(self.changes),
            "selection": {
                "law": self.law.baseline.label,
                "equation": self.law.baseline.equation,
                "candidates": len(self.candidates),
                "point_m": chosen.linear.translation.tolist(),
                "force_axes": chosen.linear.rotation[:, np.array(chosen.forces)].T.tolist(),
                "couple_axes": chosen.angular[:, np.array(chosen.couples)].T.tolist(),
            },
            "nominal": self.nominal,
            "cases": {
                varied: {
                    "varied": list(VARIED[varied]),
                    "samples": len(rows),
                    **{law: self._told(varied, law) for law in LAWS},
                }
                for varied, rows in self.rows.items()
            },
            "rows": self.rows,
        }

    def _told(self, varied: str, law: str) -> dict[str, Any]:
        rows = self.rows[varied]
        found: dict[str, Any] = {
            "success_rate": sum(not row[f"{law}.failed"] for row in rows) / len(rows)
        }
        for quantity in QUANTITIES:
            errors = self.errors(varied, law, quantity)
            values = [_quantile(errors, share) for share in SHARES]
            found[quantity] = [float(x) if np.isfinite(x) else None for x in values]
        return found


def run(
    samples: int,
    seed: int = 0,
    changes: Sequence[str] = (),
    folder: Path | None = None,
    workers: int | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Robustness:
    """Run every case: each sample once under each law, on the same plant with the same seed.

    Args:
        samples: of each case. seed: of the points, of the runs and of the search for frames.
        changes: key=value of the scenario, in all runs.
        folder: for the rows; those that are done there are not run again.
        workers: see `sweep`. tell: called with what is done.

    Raises:
        ScenarioError, ContactError: the changes do not fit the comparison.
    """
    changes = (*_AT, *changes)
    studies = [
        SweepStudy.of(SCENARIO, vary, samples, seed=seed, overrides=changes)
        for vary in VARIED.values()
    ]
    tell("best selection law")
    nominal = _nominal(studies[0])
    candidates = _candidates(nominal, studies, seed)
    law = best_law(candidates)
    done: list[dict[int, dict[str, Any]]] = [{} for _ in studies]
    with ExitStack() as stack:
        files = []
        if folder is not None:
            for name, study in zip(VARIED, studies, strict=True):
                files.append(RowFile(folder / f"robustness_{name}.jsonl", study))
                stack.callback(files[-1].close)
            done = [{k: row for k, row in file.done.items() if k < samples} for file in files]
        jobs = [
            (study, [number])
            for number in range(samples)
            for study, rows in zip(studies, done, strict=True)
            if number not in rows
        ]
        crew = stack.enter_context(workers_of(workers, None, len(jobs)))
        for study, row in make_all(crew, jobs, partial(_make, law)):
            case = studies.index(study)
            done[case][row["row"]] = row
            if files:
                files[case].append([row])
            tell(f"{sum(map(len, done))} of {samples * len(studies)} samples")
    rows = {name: [one[k] for k in sorted(one)] for name, one in zip(VARIED, done, strict=True)}
    return Robustness(law, candidates, rows, _both(nominal, nominal, law, seed), changes)


def best_law(candidates: Sequence[tuple[SelectionLaw, float, float]]) -> SelectionLaw:
    """The candidate with the least product of force error and motion error.

    Args:
        candidates: (law, force error, motion error).
    """
    return min(candidates, key=lambda one: one[1] * one[2])[0]


def _candidates(
    nominal: Rig, studies: Sequence[SweepStudy], seed: int
) -> list[tuple[SelectionLaw, float, float]]:
    """Every selection of axes in every family, each with its best frame, judged by first samples.

    Those that fail one of them are left out.
    """
    first = [(study, study.sample(k)) for study in studies for k in range(min(_FIRST, study.rows))]
    rigs = [(nominal, seed)]
    rigs += [(build_rig(scenario_of(study, sample)), sample.seed) for study, sample in first]
    instant, found = Instant(nominal.state(), nominal.contact()), []
    for baseline in BASELINES.values():
        for law in best_frames(instant, baseline, seed=seed):
            errors = []
            for rig, drawn in rigs:
                row = _judge(rig, nominal, law, drawn)
                if row["failed"]:
                    break
                errors.append((row["force"], row["motion"]))
            else:
                force, motion = np.exp(np.mean(np.log(errors), axis=0))
                found.append((law, float(force), float(motion)))
    return found


@lru_cache(1)
def _nominal(study: SweepStudy) -> Rig:
    """Where nothing varies."""
    return build_rig(study.template.make(list(study.overrides)))


def _make(law: Law, study: SweepStudy, numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Rows of some samples."""
    nominal = _nominal(replace(study, vary=(), samples=1))
    rows = []
    for sample in map(study.sample, numbers):
        rig = build_rig(scenario_of(study, sample))
        row = {"row": sample.number, "seed": sample.seed, **sample.shown}
        rows.append(row | _both(rig, nominal, law, sample.seed))
    return rows


def _both(rig: Rig, nominal: Rig, law: Law, seed: int) -> dict[str, Any]:
    """One run under each law."""
    return {
        f"{name}.{key}": value
        for name, one in zip(LAWS, (Ours(), law), strict=True)
        for key, value in _judge(rig, nominal, one, seed).items()
    }


@dataclass(frozen=True)
class _Misjudged(Rig):
    """A rig whose controller takes its contacts to be others."""

    believed: tuple[ContactPair, ...]

    def controlled_pairs(self) -> tuple[ContactPair, ...]:
        return self.believed


def _judge(rig: Rig, nominal: Rig, law: Law, seed: int) -> dict[str, Any]:
    """One run: on the faces of `rig`, for a task and a controller that know those of `nominal`."""
    parts = {one.name: getattr(rig, one.name) for one in fields(rig)}
    directions = nominal.references.directions
    parts["references"] = replace(rig.references, directions=directions)
    rig = _Misjudged(**parts, believed=nominal.pairs)
    failed = {"failed": True, "force": None, "motion": None}
    try:
        with without_doubts_told():
            verdict = metrics(record_run(rig, seed, law.install))
    except PlantError:
        return {"word": DIVERGED, **failed}
    except OscContactError:
        return {"word": REFUSED, **failed}
    task = verdict["task"]
    return {
        "word": task["word"],
        "failed": task["failed"],
        "force": max(one["rms_error_rel"] for one in verdict["force"].values()),
        "motion": verdict["motion"]["rms_error_m"],
    }


def _quantile(errors: Array, share: float) -> float:
    """The error that this share of the sorted runs does not exceed."""
    return float(errors[max(0, int(np.ceil(share * len(errors))) - 1)])
