"""Ours and the best selection laws where plant and controller's model differ: the runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.runs.rig import build_rig
from osc_contact.spatial import Array
from osc_contact.sweeps.rows import make_rows, scenario_of
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.table import RowFile
from osc_contact.sweeps.workers import make_all, workers_of
from paper.baselines.coupling import Instant
from paper.baselines.frames import best_frames
from paper.baselines.laws import BASELINES, Baseline, Law, Ours, SelectionLaw
from paper.baselines.selection import Selection

__all__ = [
    "LABELS", "LAWS", "QUANTITIES", "SAMPLES", "SHARES", "TITLES", "VARIED", "Robustness", "run",
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
        "model_error.face_tilt=uniform(0 deg, 5 deg)",
        "model_error.face_tilt_about=uniform(0 deg, 360 deg)",
    ),
}
TITLES = {
    "masses": "masses ± 20 %",
    "friction": "friction up to 0.2",
    "delay": "wrist delay up to 10 ms",
    "normals": "faces turned by up to 5°",
}
LAWS = ("ours", *BASELINES)
LABELS = {"ours": "ours"} | {name: one.label for name, one in BASELINES.items()}
QUANTITIES = {"force": "force error, rms (%)", "motion": "motion error, rms (mm)"}
SHARES = (0.5, 0.9, 0.99)
_SCALE = {"force": 100.0, "motion": 1e3}
#: A control rate at which a row is cheap; the task's slow first part is over after 1 s.
_AT = ("control.rate=250 Hz", "plant.step=0.5 ms", "duration=1.5 s")
Candidate = tuple[SelectionLaw, float, float]
_FIRST = 2  #: samples of each case by which the best selection laws are chosen


@dataclass(frozen=True)
class Robustness:
    """What the laws made of the same runs.

    Attributes:
        laws: the best of each family of selection laws, by the names of `BASELINES`.
        candidates: of each family (law, force error, motion error) of all that do the task:
            geometric means over the runs by which the best was chosen.
        rows: by what varies: one a sample, with `LAW.word`, `LAW.failed`, `LAW.force` (relative
            rms error of the worse contact) and `LAW.motion` (rms error of the position, m).
        nominal: the row without anything varied. changes: key=value of all runs.
    """

    laws: dict[str, SelectionLaw]
    candidates: dict[str, list[Candidate]]
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
        """JSON-able: how the laws were chosen, quantiles of every case and all rows."""
        return {
            "scenario": SCENARIO,
            "set_in_all_runs": list(self.changes),
            "selection": {
                name: {
                    "law": law.baseline.label,
                    "equation": law.baseline.equation,
                    "candidates": len(self.candidates[name]),
                    **_frame_of(law.selection),
                }
                for name, law in self.laws.items()
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

    The best law of a family is the one with the least product of force error and motion error.

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
    tell("best selection laws")
    candidates = {name: _candidates(studies, family, seed) for name, family in BASELINES.items()}
    best = {name: min(some, key=lambda x: x[1] * x[2])[0] for name, some in candidates.items()}
    laws: dict[str, Law] = {"ours": Ours()} | best
    frames = {name: _frame_of(law.selection) for name, law in best.items()}
    done: list[dict[int, dict[str, Any]]] = [{} for _ in studies]
    with ExitStack() as stack:
        files = []
        if folder is not None:
            for name, study in zip(VARIED, studies, strict=True):
                files.append(RowFile(folder / f"robustness_{name}.jsonl", study, frames))
                stack.callback(files[-1].close)
            done = [{k: row for k, row in file.done.items() if k < samples} for file in files]
        jobs = [
            (study, [number])
            for number in range(samples)
            for study, rows in zip(studies, done, strict=True)
            if number not in rows
        ]
        crew = stack.enter_context(workers_of(workers, None, len(jobs)))
        for study, row in make_all(crew, jobs, partial(_make, laws)):
            case = studies.index(study)
            done[case][row["row"]] = row
            if files:
                files[case].append([row])
            tell(f"{sum(map(len, done))} of {samples * len(studies)} samples")
    rows = {name: [one[k] for k in sorted(one)] for name, one in zip(VARIED, done, strict=True)}
    nominal = _make(laws, _nominal(studies[0]), [0])[0]
    return Robustness(best, candidates, rows, nominal, changes)


def _candidates(studies: Sequence[SweepStudy], family: Baseline, seed: int) -> list[Candidate]:
    """Every selection of axes of a family, each with its best frame, judged by first samples.

    Those that fail one of them are left out.
    """
    nominal = _nominal(studies[0])
    jobs = [(nominal, 0), *((one, k) for one in studies for k in range(min(_FIRST, one.rows)))]
    rig = build_rig(scenario_of(nominal, nominal.sample(0)))
    instant, found = Instant(rig.state(), rig.contact()), []
    for law in best_frames(instant, family, seed=seed):
        rows = [_judge(law, *job) for job in jobs]
        if not any(row["failed"] for row in rows):
            errors = [(row["force"], row["motion"]) for row in rows]
            force, motion = np.exp(np.mean(np.log(errors), axis=0))
            found.append((law, float(force), float(motion)))
    return found


def _frame_of(selection: Selection) -> dict[str, Any]:
    """Point (m) and axes of a selection, JSON-able."""
    return {
        "point_m": selection.linear.translation.tolist(),
        "force_axes": selection.linear.rotation[:, np.array(selection.forces)].T.tolist(),
        "couple_axes": selection.angular[:, np.array(selection.couples)].T.tolist(),
    }


def _nominal(study: SweepStudy) -> SweepStudy:
    """Where all is as the controllers believe."""
    return replace(study, vary=(), samples=1)


def _make(
    laws: Mapping[str, Law], study: SweepStudy, numbers: Sequence[int]
) -> list[dict[str, Any]]:
    """Rows of some samples: one run under each law."""
    rows = []
    for sample in map(study.sample, numbers):
        row: dict[str, Any] = {"row": sample.number, "seed": sample.seed, **sample.shown}
        for name, law in laws.items():
            verdict = _judge(law, study, sample.number)
            row |= {f"{name}.{key}": value for key, value in verdict.items()}
        rows.append(row)
    return rows


def _judge(law: Law, study: SweepStudy, number: int) -> dict[str, Any]:
    """One run: its word, whether the task failed, the force error of the worse contact, motion."""
    (row,) = make_rows(study, [number], law.install)
    forces = [x for key, x in row.items() if key.endswith(".rms_error_rel")]
    return {
        "word": row["word"],
        "failed": row["failed"],
        "force": max(forces, default=None),
        "motion": row.get("motion.rms_error_m"),
    }


def _quantile(errors: Array, share: float) -> float:
    """The error that this share of the sorted runs does not exceed."""
    return float(errors[max(0, int(np.ceil(share * len(errors))) - 1)])
