"""Tuning of keys of a scenario by Optuna, under limits, compared with the shipped values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.lab.sweeps.rows import Row, make_rows, require_long_enough
from osc_contact.lab.sweeps.study import SweepStudy, texts
from osc_contact.lab.sweeps.sweep import Progress
from osc_contact.lab.sweeps.workers import Workers, make_all, workers_of

if TYPE_CHECKING:
    import distributed
    import optuna

#: Keys that are tuned by default, if the scenario states them.
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
_LIMITED_BY_DEFAULT = {"overshoot_rel": 0.05, "status.saturated": 0.0}
"""Columns that are limited by default, and the lowest limit of each."""
_LIMIT_SLACK = 1.05  #: default limits over the shipped values
_WORST = 1e3  #: error of a run that was refused or diverged, larger than that of any other run


@dataclass(frozen=True)
class Tuned:
    """Result of tuning.

    Attributes:
        shipped, best: objective of the shipped values and of the best trial; that of the shipped
            values is 1 for "both".
        broken: limits that the best trial breaks, as texts; empty if some trial keeps all.
        values: values of the best trial by path.
        trials: number of trials so far.
        numbers: by column, the largest value over all samples of the shipped values and of the
            best trial.
    """

    shipped: float
    best: float
    broken: tuple[str, ...]
    values: dict[str, str]
    trials: int
    numbers: dict[str, tuple[float, float]]

    @property
    def better(self) -> bool:
        """True if the best trial keeps all limits and is better than the shipped values."""
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
    scheduler: str | distributed.Client | None = None,
    progress: Progress | None = None,
) -> Tuned:
    """Find values of keys that make a scenario's errors small, without breaking a limit.

    Args:
        scenario: packaged name or file.
        vary: path=distribution of the keys to tune; default: the gains, see `GAINS`.
        objective: "force" (largest relative rms error), "motion" (rms error of the position),
            "both" (mean of both, relative to the shipped ones), or a column of the table.
        limits: largest value by column; default: overshoot_rel and status.saturated of the shipped
            values. No task may fail.
        trials: number of all trials, with those in `out`.
        over: texts path=distribution of unknown quantities, such as masses: a trial is judged by
            the mean over `samples` of them, limits by the largest value.
        samples: number of samples of `over` for each trial.
        seed: seed of trials and samples.
        overrides: texts path=value of all runs.
        out: folder of the trials; a further call continues them.
        workers: number of processes, each of which runs a trial at a time; None: one for each core.
        scheduler: address or client of a dask cluster; None: processes of this machine.
        progress: function that is called with the number of trials so far and of all.

    Raises:
        ScenarioError, InvalidInputError: the study has errors, or the shipped values fail.
    """
    import optuna

    tuned = tuple(vary) if vary else _gains_in_scenario(scenario, overrides)
    # `keys` maps coordinates of a trial to values of the tuned keys; `base` has the samples of the
    # unknown quantities, with which each trial is run
    keys = SweepStudy.of(scenario, tuned, 1, "halton", seed, overrides)
    require_long_enough(keys)
    base = replace(keys, vary=tuple(over), samples=samples)
    shipped = _shipped_rows(base)
    judge = _Judge(objective, shipped, limits)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        study_name=f"{base.fingerprint}-{keys.fingerprint}-{objective}",
        storage=_storage(out),
        sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True),
        load_if_exists=True,
    )
    search = _Search(study, keys, base, judge)
    with workers_of(workers, scheduler, trials) as crew:
        while (remaining := trials - len(search.completed())) > 0:
            count = search.run(crew, remaining)
            if progress is not None:
                progress(trials - remaining + count, trials)
    return search.result(shipped)


def _shipped_rows(base: SweepStudy) -> list[Row]:
    """Rows of all samples with the scenario's own values.

    Args:
        base: study of the scenario with its own gains.

    Raises:
        InvalidInputError: a task fails.
    """
    rows = make_rows(base, range(base.samples))
    if any(row["failed"] for row in rows):
        raise InvalidInputError(
            f"the task fails with the values of the scenario: {rows[0]['why'] or 'see sweep'}; "
            "tuning begins where it does not"
        )
    return rows


@dataclass(frozen=True)
class _Search:
    """Trials of Optuna and the runs by which they are judged.

    Attributes:
        study: study of Optuna.
        keys: study of the keys that are tuned.
        base: study of the samples of each trial, without the tuned values.
        judge: objective and limits.
    """

    study: optuna.Study
    keys: SweepStudy
    base: SweepStudy
    judge: _Judge

    def completed(self) -> list[optuna.trial.FrozenTrial]:
        """Trials that are complete, earlier ones of the storage included."""
        from optuna.trial import TrialState

        return self.study.get_trials(states=(TrialState.COMPLETE,))

    def run(self, crew: Workers | None, limit: int) -> int:
        """Run a trial for each worker, at most `limit`; return their number.

        Args:
            crew: workers that run trials; None: this process runs them.
            limit: largest number of trials.
        """
        count = min(1 if crew is None else crew.count(), limit)
        trials = [self._draw() for _ in range(count)]
        samples = range(self.base.samples)
        results = list(make_all(crew, [(study, samples) for _, study in trials], make_rows))
        for trial, own_study in trials:
            rows = [row for study, row in results if study is own_study]
            for words, excess in self.judge.excess(rows).items():
                trial.set_constraint(words, excess)
            trial.set_user_attr("numbers", self.judge.worst(rows))
            self.study.tell(trial, self.judge.value(rows))
        return count

    def result(self, shipped: Sequence[Row]) -> Tuned:
        """Choose the best of all completed trials, and compare it with the shipped values.

        Args:
            shipped: rows of the runs with the shipped values.
        """
        # a trial that breaks limits less is better, for any value of its objective
        trials = self.completed()
        best_trial = min(trials, key=lambda trial: (sum(trial.constraints.values()), trial.value))
        after = best_trial.user_attrs["numbers"]
        before = self.judge.worst(shipped)
        return Tuned(
            shipped=self.judge.value(shipped),
            best=best_trial.values[0],
            broken=tuple(words for words, excess in best_trial.constraints.items() if excess),
            values=best_trial.user_attrs["values"],
            trials=len(trials),
            numbers={name: (value, after[name]) for name, value in before.items()},
        )

    def _draw(self) -> tuple[optuna.Trial, SweepStudy]:
        """Draw a trial.

        Returns:
            The trial, and the study of its samples, in which the tuned keys have its values.
        """
        # a distribution of several coordinates, such as a direction, is drawn by each of them
        trial = self.study.ask()
        coordinates = [
            trial.suggest_float(f"{path}:{i}", 0.0, 1.0)
            for path, distribution in self.keys.variations
            for i in range(distribution.dims)
        ]
        values, _ = self.keys.at(np.array(coordinates))
        trial.set_user_attr("values", values)
        return (trial, replace(self.base, overrides=(*self.base.overrides, *texts(values))))


def _gains_in_scenario(scenario: str | Path, overrides: Sequence[str]) -> tuple[str, ...]:
    """Entries path=distribution of `GAINS` whose keys a scenario states with a value other than 0.

    Args:
        scenario: packaged name or file.
        overrides: texts path=value.
    """
    some_variation = ["seed=integers(0, 1)"]  # a study needs one, only its template is used
    template = SweepStudy.of(scenario, some_variation, 1, overrides=overrides).template
    gains = []
    for gain in GAINS:
        path, _, _ = gain.partition("=")
        if template.value(path, overrides):
            gains.append(gain)
    return tuple(gains)


def _storage(out: str | Path | None) -> optuna.storages.JournalStorage | None:
    """Storage of the trials in a folder; None: in memory.

    Args:
        out: folder of the trials; None: they are kept in memory.
    """
    if out is None:
        return None
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    Path(out).mkdir(parents=True, exist_ok=True)
    return JournalStorage(JournalFileBackend(str(Path(out) / "trials.log")))


class _Judge:
    """Objective and limits of a trial, relative to the shipped values."""

    def __init__(
        self, objective: str, shipped: Sequence[Row], limits: Mapping[str, float] | None
    ) -> None:
        """Determine the quantities that are judged, and their limits.

        Args:
            objective: "force", "motion", "both" or a column of the table of runs, which is to be
                minimal.
            shipped: rows of the runs with the shipped values.
            limits: largest values by column; None: those of the shipped rows, with some slack, for
                overshoots and saturated ticks.

        Raises:
            InvalidInputError: unknown columns.
        """
        self._objective = objective  #: quantity that is to be minimal
        self._limits: Mapping[str, float] = limits or {}  #: largest values by column
        #: columns with the errors of the contact forces
        self._force_columns = [
            name for name in shipped[0] if re.fullmatch(r"force\..*\.rms_.*error_rel", name)
        ]
        #: mean errors with the shipped values
        self._shipped_means = {name: self._mean(shipped, name) for name in ("force", "motion")}
        if objective not in (*self._shipped_means, "both", *shipped[0]):
            columns = [name for name, value in shipped[0].items() if isinstance(value, float)]
            raise InvalidInputError(
                f"objective {objective!r}: give force, motion, both, or a column: {columns}"
            )
        unknown = [name for name in self._limits if name not in shipped[0]]
        if unknown:
            raise InvalidInputError(f"limits of {unknown}: no such columns")
        if not self._limits:
            values = self.worst(shipped)
            self._limits = {
                name: max(floor, _LIMIT_SLACK * values[name])
                for name, floor in _LIMITED_BY_DEFAULT.items()
            }

    def _mean(self, rows: Sequence[Row], name: str) -> float:
        """Mean of a quantity over rows.

        Args:
            rows: rows of runs.
            name: "force", "motion", "both" or a column of the table of runs.
        """
        return float(np.mean([self._quantity(row, name) for row in rows]))

    def _quantity(self, row: Row, name: str) -> float:
        """Quantity of a row; `_WORST` for a run that was refused or diverged.

        Args:
            row: row of a run.
            name: "force", "motion", "both" or a column of the table of runs.
        """
        if row.get("motion.rms_error_m") is None:
            return _WORST
        if name == "force":
            return max((row[column] or 0.0 for column in self._force_columns), default=0.0)
        if name == "both":
            ratios = [
                self._quantity(row, part) / shipped
                for part, shipped in self._shipped_means.items()
                if shipped > 0.0
            ]
            return float(np.mean(ratios))
        column = "motion.rms_error_m" if name == "motion" else name
        value = row[column]
        return _WORST if value is None else float(value)

    def value(self, rows: Sequence[Row]) -> float:
        """Mean of the objective over the rows of a trial."""
        return self._mean(rows, self._objective)

    def excess(self, rows: Sequence[Row]) -> dict[str, float]:
        """Share of failed tasks, and relative excess over each limit, by a text that names them.

        Args:
            rows: rows of the runs of a trial.
        """
        worst_values = self.worst(rows)
        excess = {"a task fails": float(np.mean([row["failed"] for row in rows]))}
        for name, limit in self._limits.items():
            relative_excess = (worst_values[name] - limit) / max(abs(limit), 1.0)
            excess[f"{name} > {limit:g}"] = max(0.0, relative_excess)
        return excess

    def worst(self, rows: Sequence[Row]) -> dict[str, float]:
        """Largest values of "force", "motion" and the limited columns over the rows of a trial."""
        largest = {
            name: max(self._quantity(row, name) for row in rows) for name in ("force", "motion")
        }
        for name in (*_LIMITED_BY_DEFAULT, *self._limits):
            largest[name] = max(float(row.get(name) or 0.0) for row in rows)
        return largest
