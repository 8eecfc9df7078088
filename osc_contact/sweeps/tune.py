"""Keys of a scenario tuned by Optuna: shipped values against found ones, under limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.sweeps.rows import make_rows, require_long_enough, scenario_of
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.workers import make_all, workers_of

__all__ = ["GAINS", "Tuned", "tune"]

#: Keys that are tuned if none are named, where the scenario states them.
GAINS = tuple(
    f"gains.{loop}={words}"
    for loop, words in (
        ("motion.stiffness", "factor(0.25, 4)"), ("motion.damping", "factor(0.4, 2.5)"),
        ("force.integral", "factor(0.25, 4)"), ("force.damping", "factor(0.25, 4)"),
        ("motion.frequency", "factor(0.5, 2)"), ("motion.damping_ratio", "factor(0.4, 2.5)"),
        ("force.bandwidth", "factor(0.25, 4)"), ("force.damping_ratio", "factor(0.25, 4)"),
    )
)  # fmt: skip
_SLACK = 1.05  #: limits that are not given are the shipped values times this
_LEAST = 0.05  #: … and overshoots up to this are no matter

Row = dict[str, Any]


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
    progress: Callable[[int, int], None] | None = None,
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
        out: folder of the trials, which the same call goes on with.
        workers, scheduler: see `sweep`; each runs a trial at a time.
        progress: called with the trials done and all of them.

    Raises:
        ScenarioError, InvalidInputError: what is asked is not understood, or the shipped values
            fail.
    """
    import optuna

    keys = SweepStudy.of(scenario, tuple(vary) or _stated(scenario, overrides), 1, "halton", seed,
                    overrides)  # fmt: skip
    require_long_enough(scenario_of(keys, keys.sample(0)))
    base = replace(keys, vary=tuple(over), samples=samples)
    shipped = make_rows(base, range(samples))
    if any(row["failed"] for row in shipped):
        raise InvalidInputError(
            f"the task fails with the values of the scenario: {shipped[0]['why'] or 'see sweep'}; "
            "tuning begins where it does not"
        )
    judge = _Judge(objective, shipped, limits)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True)
    study = optuna.create_study(
        study_name=f"{base.fingerprint}-{keys.fingerprint}-{objective}", storage=_storage(out),
        sampler=sampler, load_if_exists=True,
    )  # fmt: skip
    names = [f"{path}:{i}" for path, d in keys.variations for i in range(d.dims)]

    def ask() -> tuple[Any, SweepStudy]:
        trial = study.ask()
        u = np.array([trial.suggest_float(name, 0.0, 1.0) for name in names])
        values = keys.values_at(u)
        trial.set_user_attr("values", values)
        changes = tuple(f"{path}={value}" for path, value in values.items())
        return trial, replace(base, overrides=(*base.overrides, *changes))

    done = len(study.get_trials(states=(optuna.trial.TrialState.COMPLETE,)))
    with workers_of(workers, scheduler, trials) as crew:
        while done < trials:
            count = 1 if crew is None else crew.count()
            asked = [ask() for _ in range(min(count, trials - done))]
            found: dict[int, list[Row]] = {id(one): [] for _, one in asked}
            jobs = [(one, range(samples)) for _, one in asked]
            for one, row in make_all(crew, jobs, make_rows):
                found[id(one)].append(row)
            for trial, one in asked:
                rows = sorted(found[id(one)], key=lambda row: int(row["row"]))
                broken = judge.excess(rows)
                for name, excess in enumerate(broken):
                    trial.set_constraint(str(name), excess)
                trial.set_user_attr("broken", broken)
                trial.set_user_attr("numbers", judge.worst(rows))
                study.tell(trial, judge.value(rows))
            done += len(asked)
            if progress is not None:
                progress(done, trials)
    ended = study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    best = min(ended, key=lambda t: (sum(max(0.0, x) for x in t.user_attrs["broken"]), t.value))
    before, after = judge.worst(shipped), best.user_attrs["numbers"]
    return Tuned(
        judge.value(shipped), float(best.value or 0.0), judge.words(best.user_attrs["broken"]),
        dict(best.user_attrs["values"]), len(ended), {k: (before[k], after[k]) for k in before},
    )  # fmt: skip


def _stated(scenario: str | Path, overrides: Sequence[str]) -> tuple[str, ...]:
    """The gains that a scenario states and that are not 0."""
    probe = SweepStudy.of(scenario, ["seed=integers(0, 1)"], 1, overrides=overrides)
    said = {one: probe.template.value(one.partition("=")[0], overrides) for one in GAINS}
    return tuple(one for one, value in said.items() if value not in (None, 0, 0.0))


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
        self._objective, self._limits = objective, dict(limits or {})
        self._forces = [n for n in shipped[0] if n.startswith("force.") and n.endswith("error_rel")
                        and ".rms_" in n]  # fmt: skip
        self._shipped = {"force": 1.0, "motion": 1.0}
        self._shipped = {name: self._mean(shipped, name) for name in ("force", "motion")}
        if objective not in ("force", "motion", "both") and objective not in shipped[0]:
            known = [n for n, value in shipped[0].items() if isinstance(value, float)]
            raise InvalidInputError(
                f"objective {objective!r}: give force, motion, both, or a column: {known}"
            )
        unknown = [name for name in self._limits if name not in shipped[0]]
        if unknown:
            raise InvalidInputError(f"limits of {unknown}: no such columns")
        if not self._limits:
            now = self.worst(shipped)
            self._limits = {
                "overshoot_rel": max(_LEAST, _SLACK * now["overshoot_rel"]),
                "status.saturated": _SLACK * now["status.saturated"],
            }

    def _mean(self, rows: Sequence[Row], name: str) -> float:
        values = [self._one(row, name) for row in rows]
        return float(np.mean(values))

    def _one(self, row: Row, name: str) -> float:
        if row.get("motion.rms_error_m") is None:
            return 1e3  # refused or diverged: worse than all that ran
        if name == "force":
            return max((row[n] or 0.0 for n in self._forces), default=0.0)
        if name == "motion":
            return float(row["motion.rms_error_m"])
        if name == "both":
            parts = [self._one(row, n) / s for n, s in self._shipped.items() if s > 0.0]
            return float(np.mean(parts))
        return float(row[name] if row[name] is not None else 1e3)

    def value(self, rows: Sequence[Row]) -> float:
        """The objective: its mean over the samples."""
        return self._mean(rows, self._objective)

    def excess(self, rows: Sequence[Row]) -> list[float]:
        """By how much of itself each limit is broken, > 0: it is; tasks that failed first."""
        worst = self.worst(rows)
        failed = float(np.mean([bool(row["failed"]) for row in rows]))
        return [failed, *((worst[n] - most) / max(abs(most), 1.0) if worst[n] > most else 0.0
                          for n, most in self._limits.items())]  # fmt: skip

    def worst(self, rows: Sequence[Row]) -> dict[str, float]:
        """Objective's parts and limited columns, the worst over the samples."""
        names = ("overshoot_rel", "status.saturated", *self._limits)
        found = {n: max(float(row.get(n) or 0.0) for row in rows) for n in dict.fromkeys(names)}
        return {n: max(self._one(row, n) for row in rows) for n in ("force", "motion")} | found

    def words(self, excess: Sequence[float]) -> tuple[str, ...]:
        """What is broken."""
        names = ["a task fails", *(f"{n} > {most:g}" for n, most in self._limits.items())]
        return tuple(name for name, x in zip(names, excess, strict=True) if x > 0.0)
