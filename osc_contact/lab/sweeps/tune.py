"""Keys of a scenario tuned by Optuna: shipped values against found ones, under limits."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.lab.sweeps.study import SweepStudy, texts
from osc_contact.lab.sweeps.sweep import (
    Progress,
    Row,
    make_all,
    make_rows,
    require_long_enough,
    workers_of,
)

#: Keys that are tuned if none are named, where the scenario states them.
GAINS = (
    "gains.motion.stiffness=factor(0.25, 4)",
    "gains.motion.damping=factor(0.4, 2.5)",
    "gains.force.integral=factor(0.25, 4)",
    "gains.force.damping=factor(0.25, 4)",
    "gains.motion.frequency=factor(0.5, 2)",
    "gains.motion.damping_ratio=factor(0.4, 2.5)",
    "gains.force.bandwidth=factor(0.25, 4)",
    "gains.force.damping_ratio=factor(0.25, 4)",
)
_LIMITED = {"overshoot_rel": 0.05, "status.saturated": 0.0}
"""Columns that are limited if no limits are given, and what is permitted in any case."""
_SLACK = 1.05  #: limits that are not given are the shipped values times this
_WORST = 1e3  #: of a run that was refused or diverged: worse than all that ran


@dataclass(frozen=True)
class Tuned:
    """What tuning found.

    Attributes:
        shipped, best: of the objective; 1 is the shipped value of "both". broken: limits that the
            best of all trials breaks, in words; empty where some trial breaks none.
        values: path → value of the best. trials: done so far. numbers: columns of the shipped and
            of the best, the worst over all samples.
    """

    shipped: float
    best: float
    broken: tuple[str, ...]
    values: dict[str, str]
    trials: int
    numbers: dict[str, tuple[float, float]]

    @property
    def better(self) -> bool:
        """Whether the best breaks no limit and beats the shipped values."""
        return not self.broken and self.best < self.shipped


def tune(
    scenario: str | Path,
    vary: Sequence[str] = (),
    *,
    objective: str = "both",
    limits: Mapping[str, float] | None = None,
    trials: int = 60,
    over: Sequence[str] = (),
    samples: int = 1,
    seed: int = 0,
    overrides: Sequence[str] = (),
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: Any = None,
    progress: Progress | None = None,
) -> Tuned:
    """Find values of keys that make a scenario's errors small, without breaking a limit.

    Args:
        scenario: packaged name or file.
        vary: path=distribution of the keys to tune; default: the gains, see `GAINS`.
        objective: "force" (largest relative rms error), "motion" (rms error of the position),
            "both" (mean of both, relative to the shipped ones), or a column of the table.
        limits: column → the most it may be; default: overshoot_rel and status.saturated of the
            shipped values. No task may fail.
        trials: in all; those that were done in `out` count.
        over: path=distribution of what is not known, such as masses: a trial is judged by its mean
            over `samples` of them, limits by the worst.
        seed: of trials and samples. overrides: path=value, of all runs.
        out: folder of the trials, which the same call continues.
        workers, scheduler: see `sweep`; each runs a trial at a time.
        progress: called with the trials done and all of them.

    Raises:
        ScenarioError, InvalidInputError: the study is not understood, or the shipped values fail.
    """
    import optuna

    tuned = tuple(vary) or _stated(scenario, overrides)
    keys = SweepStudy.of(scenario, tuned, 1, "halton", seed, overrides)
    require_long_enough(keys)
    base = replace(keys, vary=tuple(over), samples=samples)
    shipped = make_rows(base, range(samples))
    if any(row["failed"] for row in shipped):
        raise InvalidInputError(
            f"the task fails with the values of the scenario: {shipped[0]['why'] or 'see sweep'}; "
            "tuning begins where it does not"
        )
    judge = _Judge(objective, shipped, limits)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        study_name=f"{base.fingerprint}-{keys.fingerprint}-{objective}",
        storage=_storage(out),
        sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True),
        load_if_exists=True,
    )
    names = [f"{path}:{i}" for path, d in keys.variations for i in range(d.dims)]

    def draw() -> tuple[Any, SweepStudy]:
        trial = study.ask()
        values = keys.at(np.array([trial.suggest_float(name, 0.0, 1.0) for name in names]))[0]
        trial.set_user_attr("values", values)
        return (trial, replace(base, overrides=(*base.overrides, *texts(values))))

    def ended() -> list[Any]:
        return study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))

    with workers_of(workers, scheduler, trials) as crew:
        while (left := trials - len(ended())) > 0:
            drawn = [draw() for _ in range(min(crew.count() if crew else 1, left))]
            made = list(make_all(crew, [(one, range(samples)) for _, one in drawn], make_rows))
            for trial, one in drawn:
                rows = [row for own, row in made if own is one]
                for words, excess in judge.excess(rows).items():
                    trial.set_constraint(words, excess)
                trial.set_user_attr("numbers", judge.worst(rows))
                study.tell(trial, judge.value(rows))
            if progress is not None:
                progress(trials - left + len(drawn), trials)
    every = ended()
    best = min(every, key=lambda trial: (sum(trial.constraints.values()), trial.value))
    after = best.user_attrs["numbers"]
    return Tuned(
        shipped=judge.value(shipped),
        best=best.value,
        broken=tuple(words for words, excess in best.constraints.items() if excess),
        values=best.user_attrs["values"],
        trials=len(every),
        numbers={name: (before, after[name]) for name, before in judge.worst(shipped).items()},
    )


def _stated(scenario: str | Path, overrides: Sequence[str]) -> tuple[str, ...]:
    """The gains that a scenario states and that are not 0."""
    probe = SweepStudy.of(scenario, ["seed=integers(0, 1)"], 1, overrides=overrides)
    return tuple(gain for gain in GAINS if probe.template.value(gain.partition("=")[0], overrides))


def _storage(out: str | Path | None) -> Any:
    if out is None:
        return None
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    Path(out).mkdir(parents=True, exist_ok=True)
    return JournalStorage(JournalFileBackend(str(Path(out) / "trials.log")))


class _Judge:
    """Objective and limits of the rows of a trial, beside those of the shipped values."""

    def __init__(
        self, objective: str, shipped: Sequence[Row], limits: Mapping[str, float] | None
    ) -> None:
        self._objective = objective
        self._limits: Mapping[str, float] = limits or {}
        self._forces = [
            name for name in shipped[0] if re.fullmatch(r"force\..*\.rms_.*error_rel", name)
        ]
        self._shipped = {name: self._mean(shipped, name) for name in ("force", "motion")}
        if objective not in (*self._shipped, "both", *shipped[0]):
            known = [n for n, value in shipped[0].items() if isinstance(value, float)]
            raise InvalidInputError(
                f"objective {objective!r}: give force, motion, both, or a column: {known}"
            )
        unknown = [name for name in self._limits if name not in shipped[0]]
        if unknown:
            raise InvalidInputError(f"limits of {unknown}: no such columns")
        if not self._limits:
            now = self.worst(shipped)
            self._limits = {n: max(least, _SLACK * now[n]) for n, least in _LIMITED.items()}

    def _mean(self, rows: Sequence[Row], name: str) -> float:
        return float(np.mean([self._one(row, name) for row in rows]))

    def _one(self, row: Row, name: str) -> float:
        if row.get("motion.rms_error_m") is None:
            return _WORST
        if name == "force":
            return max((row[n] or 0.0 for n in self._forces), default=0.0)
        if name == "both":
            parts = [self._one(row, n) / s for n, s in self._shipped.items() if s > 0.0]
            return float(np.mean(parts))
        value = row["motion.rms_error_m" if name == "motion" else name]
        return _WORST if value is None else float(value)

    def value(self, rows: Sequence[Row]) -> float:
        """The objective: its mean over the samples."""
        return self._mean(rows, self._objective)

    def excess(self, rows: Sequence[Row]) -> dict[str, float]:
        """Limit, in words → by how much of itself it is broken; first the share of failed tasks."""
        worst = self.worst(rows)
        found = {"a task fails": float(np.mean([row["failed"] for row in rows]))}
        for name, most in self._limits.items():
            found[f"{name} > {most:g}"] = max(0.0, (worst[name] - most) / max(abs(most), 1.0))
        return found

    def worst(self, rows: Sequence[Row]) -> dict[str, float]:
        """Objective's parts and limited columns, the worst over the samples."""
        found = {name: max(self._one(row, name) for row in rows) for name in ("force", "motion")}
        for name in (*_LIMITED, *self._limits):
            found[name] = max(float(row.get(name) or 0.0) for row in rows)
        return found
