"""Ours and the best selection laws where plant and controller's model differ: the runs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from rich.table import Table

import osc_contact as osc
from osc_contact.lab.sweeps.rows import make_rows
from osc_contact.lab.sweeps.study import SweepStudy
from osc_contact.lab.sweeps.sweep import run_rows
from osc_contact.spatial import Array
from paper.selection_laws import BASELINES, Baseline, Instant, Law, Ours, SelectionLaw, best_frames
from paper.study import Ask, Data, Study, table_of

SCENARIO = "two_contact_rod"
SAMPLES = 1000  #: of each case, unless another number is given
#: What is not as the controllers believe, by case.
VARIED: dict[str, tuple[str, ...]] = {
    "masses": (
        "model_error.object_mass=uniform(0.8, 1.2)",
        "model_error.arm_mass=uniform(0.8, 1.2)",
    ),
    "friction": ("plant.friction=uniform(0, 0.2)",),
    "delay": ("sensors.wrist.rate=choice(1 kHz)", "sensors.wrist.delay=uniform(0 ms, 10 ms)"),
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
LABELS = {"ours": "ours"} | {name: one.label for name, one in BASELINES.items()}
LAWS = tuple(LABELS)
QUANTITIES = {"force": "force error, rms (%)", "motion": "motion error, rms (mm)"}
SHARES = (0.5, 0.9, 0.99)
_SCALE = {"force": 100.0, "motion": 1e3}
#: A control rate at which a row is cheap; the task's slow first part is over after 1 s. Force
#: errors are what is compared: a task has failed by them only where next to no force arrives.
_AT = ("control.rate=250 Hz", "plant.step=0.5 ms", "duration=1.5 s", "verdict.force_rms=0.9")
Candidate = tuple[SelectionLaw, float]
_FIRST = 2  #: samples of each case by which the best selection laws are chosen


def errors(rows: Sequence[Data], law: str, quantity: str) -> Array:
    """(samples,) sorted, in the units of `QUANTITIES`; infinite where the task failed.

    Args:
        rows: rows of a case.
        law: name in `LAWS`.
        quantity: name in `QUANTITIES`.
    """
    found = [np.inf if r[f"{law}.failed"] else r[f"{law}.{quantity}"] for r in rows]
    return np.sort(_SCALE[quantity] * np.array(found, dtype=float))


def quantiles(rows: Sequence[Data], law: str) -> Data:
    """Share of tasks done, and the errors below which `SHARES` of the runs are.

    Args:
        rows: rows of a case.
        law: name in `LAWS`.
    """
    summary: Data = {"success_rate": sum(not row[f"{law}.failed"] for row in rows) / len(rows)}
    for quantity in QUANTITIES:
        values = np.quantile(errors(rows, law, quantity), SHARES, method="inverted_cdf")
        summary[quantity] = [float(x) if np.isfinite(x) else None for x in values]
    return summary


def run(ask: Ask, workers: int | None = None) -> Data:
    """Run every case: each sample once under each law, on the same plant with the same seed.

    The best law of a family is the one with the least product of force error and motion error.

    Args:
        ask: samples of each case; seed of the points, of the runs and of the search for frames;
            changes of the scenario in all runs; folder for the rows, of which those that are done
            are not run again.
        workers: see `sweep`.

    Returns:
        JSON-able: how the laws were chosen, the row without anything varied, quantiles of every
        case and all rows: one a sample, with `LAW.word`, `LAW.failed`, `LAW.force` (relative rms
        error of the worse contact) and `LAW.motion` (rms error of the position, m).

    Raises:
        ScenarioError, ContactError: the changes do not fit the comparison.
    """
    changes = (*_AT, *ask.all_changes())
    samples = ask.samples or SAMPLES
    seed = ask.seed
    studies = [
        SweepStudy.of(SCENARIO, vary, samples, seed=seed, overrides=changes)
        for vary in VARIED.values()
    ]
    ask.tell("best selection laws")
    candidates = {name: _candidates(studies, family, seed) for name, family in BASELINES.items()}
    best = {name: min(some, key=lambda x: x[1])[0] for name, some in candidates.items()}
    laws: dict[str, Law] = {"ours": Ours()} | best
    frames = {name: law.selection.as_dict() for name, law in best.items()}
    rows = {}
    for name, study in zip(VARIED, studies, strict=True):
        done = run_rows(
            study,
            ask.folder / f"robustness_{name}.jsonl",
            partial(_make, laws),
            laws=frames,
            workers=workers,
            progress=lambda done, all_: ask.tell(f"{done} of {all_} samples of a case"),
        )
        rows[name] = [done[k] for k in sorted(done)]
    return {
        "scenario": SCENARIO,
        "set_in_all_runs": list(changes),
        "selection": {
            name: {
                "law": law.label,
                "candidates": len(candidates[name]),
                **frames[name],
            }
            for name, law in best.items()
        },
        "nominal": _make(laws, _nominal(studies[0]), [0])[0],
        "cases": {
            varied: {
                "varied": list(VARIED[varied]),
                "samples": len(some),
                **{law: quantiles(some, law) for law in LAWS},
            }
            for varied, some in rows.items()
        },
        "rows": rows,
    }


def _candidates(studies: Sequence[SweepStudy], family: Baseline, seed: int) -> list[Candidate]:
    """Every selection of axes of a family, each with its best frame, judged by first samples.

    Those that fail one of them are left out.
    """
    nominal = _nominal(studies[0])
    jobs = [(nominal, 0), *((one, k) for one in studies for k in range(min(_FIRST, one.rows)))]
    rig = osc.build_rig(nominal.scenario(nominal.sample(0)))
    instant = Instant(rig.state, rig.contact)
    found = []
    for law in best_frames(instant, family, seed=seed):
        rows = [_judge(law, *job) for job in jobs]
        if not any(row["failed"] for row in rows):
            errors = [row["force"] * row["motion"] for row in rows]
            found.append((law, float(np.mean(np.log(errors)))))
    return found


def _nominal(study: SweepStudy) -> SweepStudy:
    """Study of a single run in which the controllers' models are exact."""
    return replace(study, vary=(), samples=1)


def _make(laws: Mapping[str, Law], study: SweepStudy, numbers: Sequence[int]) -> list[Data]:
    """Rows of some samples: one run under each law."""
    rows = []
    for sample in map(study.sample, numbers):
        row: Data = {"row": sample.number, "seed": sample.seed, **sample.shown}
        for name, law in laws.items():
            verdict = _judge(law, study, sample.number)
            row |= {f"{name}.{key}": value for key, value in verdict.items()}
        rows.append(row)
    return rows


def _judge(law: Law, study: SweepStudy, number: int) -> Data:
    """One run: its word, whether the task failed, the force error of the worse contact, motion."""
    (row,) = make_rows(study, [number], law.install)
    errors = [x for key, x in row.items() if key.endswith(".rms_error_rel")]
    forces = [x for x in errors if x is not None]  # None: its contact was never judged
    return {
        "word": row["word"],
        "failed": row["failed"],
        "force": max(forces, default=None),
        "motion": row.get("motion.rms_error_m"),
    }


def tabulate(found: Data) -> Table:
    """Tasks done and quantiles of both errors: a row for each case and law."""
    cases = found["cases"]
    samples = next(iter(cases.values()))["samples"]
    shares = " / ".join(f"{100 * share:g} %" for share in SHARES)
    rows = []
    for name, case in cases.items():
        for law in LAWS:
            summary = case[law]
            errors = [
                " / ".join("none" if x is None else f"{x:.3g}" for x in summary[k])
                for k in QUANTITIES
            ]
            rows.append((TITLES[name], LABELS[law], f"{summary['success_rate']:.1%}", *errors))
    title = f"two_contact_rod on mujoco, {samples} samples of each case: {shares} of runs below"
    return table_of(
        title, f"not as believed; law; tasks done; {'; '.join(QUANTITIES.values())}", rows
    )


def study(ask: Ask) -> Study:
    """All cases under all laws."""
    found = run(ask)
    return Study({}, tabulate(found), found)
