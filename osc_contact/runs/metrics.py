"""The verdict on a recording: the numbers of metrics.json."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError, RecordingError
from osc_contact.recorder import Recording
from osc_contact.runs.outcome import Landings, Openings, judge_task, step_answers
from osc_contact.spatial import Array

__all__ = ["SETTLE_S", "STEP_BLANK_S", "metrics"]

SETTLE_S = 1.0  #: judged from here on
STEP_BLANK_S = 0.05  #: forces and power are not judged while a force rises, and this much longer
_READ = (
    "t", "alpha_cmd", "alpha_true", "alpha_meas", "power_total", "power_projected", "motion_error",
    "closed", "contact_phase", "status", "tau",
)  # fmt: skip
_STATUS = ("ok", "saturated", "held", "degraded")


def metrics(recording: Recording) -> dict[str, Any]:
    """Judge a run against the plant's truth.

    Keys: scenario, plant, seed (None for a loop of the user's own), duration_s, ticks,
    real_time_factor;
    force {contact: rms_error_N, rms_error_rel, peak_error_N, peak_error_rel, mean_command_N,
    sensing_rms_rel}; motion {rms_error_m, rms_error_rad} along the free directions;
    contact_fraction {contact}; first_contact_s {contact} (null: never); steps, see
    `step_answers`; judged_ticks; task {word, failed, why}, see `judge_task`;
    power {total_rms_W, projected_rms_W, ratio};
    tick_us {p50, p99, p99_9, max}; status {name: ticks}; at_limit [[joint, ticks], …] of motors
    that ever stood at their limit, the one that did longest first.

    Under force, the magnitudes of a contact with several are called contact.1, contact.2, …
    rms_error is true force minus command; sensing is what fig. 5's filter made of the wrist
    sensors, minus true force; both relative to the mean command (null where that is 0).

    Raises:
        InvalidInputError: the recording is not longer than the settling time.
        RecordingError: no judge took part in the run.
    """
    if "alpha_true" not in recording:
        raise RecordingError(
            "the recording does not hold the true contact forces: no judge took part in the run, "
            "as on hardware; compare alpha_meas with alpha_cmd instead"
        )
    steps = recording.meta["force_steps_s"]
    blank = STEP_BLANK_S + recording.meta.get("force_rise_s", 0.0)
    force = {key: _Series() for key in ("command", "error", "sensing")}
    power = {key: _Series() for key in ("power_total", "power_projected")}
    error, closed, status, at_limit = _Series(), _Series(), np.zeros(4, int), np.zeros(0, int)
    limits, contacts = _limits(recording), len(recording.meta["contact_names"])
    landings, openings = Landings(contacts), Openings(contacts)
    for piece in recording.pieces(*_READ):
        judged = piece["t"] >= SETTLE_S - 1e-9
        quiet = judged.copy()
        for step in steps:
            quiet &= ~((piece["t"] >= step - 1e-9) & (piece["t"] < step + blank - 1e-9))
        command, truth, sensed = (piece[f"alpha_{key}"][quiet] for key in ("cmd", "true", "meas"))
        force["command"].add(command)
        force["error"].add(truth - command)
        force["sensing"].add(sensed - truth)
        for key, series in power.items():
            series.add(piece[key][quiet])
        parts = piece["motion_error"][judged].reshape(-1, 2, 3)
        error.add(np.sqrt(np.sum(parts**2, axis=2)))
        closed.add(piece["closed"][judged])
        landings.add(piece["closed"])
        openings.add(piece["closed"][judged], piece["contact_phase"][judged])
        status += np.bincount(piece["status"], minlength=4)[:4]
        here = np.abs(piece["tau"][:, : len(limits)]) >= limits * (1.0 - 1e-9)
        at_limit = at_limit + here.sum(axis=0) if at_limit.size else here.sum(axis=0)
    if not closed.count:
        raise InvalidInputError(
            f"a run of {len(recording)} ticks ends before t = {SETTLE_S:g} s, from where it is "
            "judged; run it longer"
        )
    duration = len(recording) / float(recording.meta["control_rate_hz"])
    position, orientation = error.rms()
    first = [None if k is None else k * duration / len(recording) for k in landings.ticks]
    verdict = {
        "scenario": recording.meta.get("scenario", {}).get("name"),
        "plant": recording.meta.get("plant"),
        "seed": recording.meta.get("seed"),
        "duration_s": duration,
        "ticks": len(recording),
        "real_time_factor": _ratio(duration, recording.meta.get("wall_s")),
        "force": _forces(recording.magnitude_names, **force),
        "motion": {"rms_error_m": position, "rms_error_rad": orientation},
        "contact_fraction": dict(zip(recording.meta["contact_names"], closed.mean(), strict=False)),
        "first_contact_s": dict(zip(recording.meta["contact_names"], first, strict=True)),
        "steps": step_answers(recording, landings.ticks),
        "judged_ticks": closed.count,
        "power": _power(*power.values()),
        "tick_us": _tick(recording),
        "status": dict(zip(_STATUS, map(int, status), strict=True)),
        "at_limit": _standing(recording, at_limit),
    }
    away_m, away_rad = error.peak()
    verdict["task"] = judge_task(recording, verdict, openings, (away_m, away_rad))
    return verdict


class _Series:
    """Sums over the ticks of one or several numbers, piece after piece.

    Ticks that could not be computed hold no numbers and are left out; None where all are.
    """

    def __init__(self) -> None:
        self.count = 0
        self._sums = self._squares = self._peaks = np.zeros(0)

    def add(self, values: Array) -> None:
        """Ticks (k,) or (k, m)."""
        values = values[:, None] if values.ndim == 1 else values
        if not self.count:
            self._sums = self._squares = self._peaks = np.zeros(values.shape[1])
        values = values[np.isfinite(values).all(axis=1)]
        if not len(values):
            return
        rows = np.ascontiguousarray(values.T, dtype=float)
        self.count += len(values)
        self._sums = self._sums + rows.sum(axis=1)
        self._squares = self._squares + (rows**2).sum(axis=1)
        self._peaks = np.maximum(self._peaks, np.abs(rows).max(axis=1))

    def mean(self) -> list[float | None]:
        return self._told(lambda: self._sums / self.count)

    def rms(self) -> list[float | None]:
        return self._told(lambda: np.sqrt(self._squares / self.count))

    def peak(self) -> list[float | None]:
        return self._told(lambda: self._peaks)

    def _told(self, values: Callable[[], Array]) -> list[float | None]:
        return [float(x) for x in values()] if self.count else [None] * len(self._sums)


def _forces(
    names: Sequence[str], command: _Series, error: _Series, sensing: _Series
) -> dict[str, dict[str, float | None]]:
    values = (command.mean(), error.rms(), error.peak(), sensing.rms())
    return {
        name: {
            "rms_error_N": rms,
            "rms_error_rel": _ratio(rms, mean),
            "peak_error_N": peak,
            "peak_error_rel": _ratio(peak, mean),
            "mean_command_N": mean,
            "sensing_rms_rel": _ratio(sensed, mean),
        }
        for name, mean, rms, peak, sensed in zip(names, *values, strict=True)
    }


def _power(total: _Series, projected: _Series) -> dict[str, float | None]:
    (whole,), (part,) = total.rms(), projected.rms()
    return {"total_rms_W": whole, "projected_rms_W": part, "ratio": _ratio(part, whole)}


def _tick(recording: Recording) -> dict[str, float | None]:
    keys = ("p50", "p99", "p99_9", "max")
    if "tick_s" not in recording:  # its times were not kept beside it
        return dict.fromkeys(keys)
    seconds = np.empty(len(recording), dtype=np.float32)  # half the memory; a clock is no finer
    end = 0
    for piece in recording.pieces("tick_s"):
        start, end = end, end + len(piece["tick_s"])
        seconds[start:end] = piece["tick_s"]
    values = np.percentile(seconds, [50, 99, 99.9, 100], overwrite_input=True) * 1e6
    return dict(zip(keys, map(float, values), strict=True))


def _limits(recording: Recording) -> Array:
    """(m,) effort limits of the motors, ∞ where there is none."""
    limits = recording.meta.get("effort_limits", {}).values()
    return np.array([np.inf if limit is None else limit for limit in limits], dtype=float)


def _standing(recording: Recording, ticks: Array) -> list[list[str | int]]:
    joints = recording.meta.get("effort_limits", {})
    values = zip(joints, map(int, ticks), strict=False)
    return [[joint, n] for joint, n in sorted(values, key=lambda item: -item[1]) if n]


def _ratio(part: float | None, whole: float | None) -> float | None:
    """None where there is nothing to compare with: JSON has no NaN."""
    return part / whole if whole and part is not None else None
