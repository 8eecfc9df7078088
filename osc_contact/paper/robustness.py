"""Ours and the best selection law where plant and controller's model differ: the runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.paper.baselines.coupling import Instant
from osc_contact.paper.baselines.frames import best_frames
from osc_contact.paper.baselines.laws import BASELINES, Law, Ours, SelectionLaw
from osc_contact.runs.rig import build_rig
from osc_contact.spatial import Array
from osc_contact.sweeps.rows import make_rows, scenario_of
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
    candidates = _candidates(studies, seed)
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
    return Robustness(law, candidates, rows, _make(law, _nominal(studies[0]), [0])[0], changes)


def best_law(candidates: Sequence[tuple[SelectionLaw, float, float]]) -> SelectionLaw:
    """The candidate with the least product of force error and motion error.

    Args:
        candidates: (law, force error, motion error).
    """
    return min(candidates, key=lambda one: one[1] * one[2])[0]


def _candidates(
    studies: Sequence[SweepStudy], seed: int
) -> list[tuple[SelectionLaw, float, float]]:
    """Every selection of axes in every family, each with its best frame, judged by first samples.

    Those that fail one of them are left out.
    """
    nominal = _nominal(studies[0])
    jobs = [(nominal, 0), *((one, k) for one in studies for k in range(min(_FIRST, one.rows)))]
    rig = build_rig(scenario_of(nominal, nominal.sample(0)))
    instant, found = Instant(rig.state(), rig.contact()), []
    for baseline in BASELINES.values():
        for law in best_frames(instant, baseline, seed=seed):
            rows = [_judge(law, *job) for job in jobs]
            if not any(row["failed"] for row in rows):
                errors = [(row["force"], row["motion"]) for row in rows]
                force, motion = np.exp(np.mean(np.log(errors), axis=0))
                found.append((law, float(force), float(motion)))
    return found


def _nominal(study: SweepStudy) -> SweepStudy:
    """Where all is as the controllers believe."""
    return replace(study, vary=(), samples=1)


def _make(law: Law, study: SweepStudy, numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Rows of some samples: one run under each law."""
    rows = []
    for sample in map(study.sample, numbers):
        row: dict[str, Any] = {"row": sample.number, "seed": sample.seed, **sample.shown}
        for name, one in zip(LAWS, (Ours(), law), strict=True):
            verdict = _judge(one, study, sample.number)
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
