"""The verdict on a recording: the numbers of metrics.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError, RecordingError
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import CLOSED, SETTLE_S, JudgedTicks
from osc_contact.runs.limit_cycles import Cycle, CycleSearch
from osc_contact.runs.outcome import Openings, judge_task, step_answers
from osc_contact.scenarios.control_schema import VerdictSpec
from osc_contact.spatial import Array

__all__ = ["metrics"]

_READ = (
    "t",
    "alpha_cmd",
    "alpha_true",
    "alpha_meas",
    "power_total",
    "power_projected",
    "motion_error",
    "closed",
    "contact_phase",
    "status",
    "tau",
)
_MOVING = ("twist", "N")  #: read where they are recorded  # fmt: skip
_STATUS = ("ok", "saturated", "held", "degraded")


def metrics(recording: Recording) -> dict[str, Any]:
    """Judge a run against the plant's truth.

    Keys: scenario, plant, seed (None for a loop of the user's own), duration_s, ticks,
    real_time_factor;
    force {contact: rms_error_N, rms_error_rel, peak_error_N, peak_error_rel, mean_command_N,
    sensing_rms_rel, limit_cycle_N, limit_cycle_Hz, limit_cycle_rel}, of closed contacts, see
    `osc_contact.recorder.judged` and `limit_cycles`;
    motion {rms_error_m, rms_error_rad} along the free directions;
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
    meta = recording.meta
    names, contacts = recording.magnitude_names, meta["contact_names"]
    limits = VerdictSpec.model_validate(meta.get("scenario", {}).get("verdict", {}))
    force = {key: _Series() for key in ("command", "error", "sensing")}
    power = {key: _Series() for key in ("power_total", "power_projected")}
    error, closed, status, at_limit = _Series(), _Series(), np.zeros(4, int), np.zeros(0, int)
    effort = _limits(recording)
    ticks = JudgedTicks(meta, len(names))
    openings = Openings(len(contacts))
    cycles = CycleSearch(meta, ticks.columns, limits.limit_cycle)
    moving = tuple(name for name in _MOVING if name in recording)
    count = 0
    for piece in recording.pieces(*_READ, *moving):
        judged = piece["t"] >= SETTLE_S - 1e-9
        count += int(judged.sum())
        settled, counted, quiet = ticks.add(piece)
        command, truth, sensed = (
            np.where(counted, piece[f"alpha_{key}"], np.nan) for key in ("cmd", "true", "meas")
        )
        force["command"].add(command)
        force["error"].add(truth - command)
        force["sensing"].add(sensed - truth)
        cycles.add(piece, counted)
        for key, series in power.items():
            series.add(piece[key][quiet])
        parts = piece["motion_error"][judged].reshape(-1, 2, 3)
        error.add(np.sqrt(np.sum(parts**2, axis=2)))
        closed.add(piece["closed"][judged])
        openings.add(piece["closed"], piece["contact_phase"] == CLOSED, settled)
        status += np.bincount(piece["status"], minlength=4)[:4]
        here = np.abs(piece["tau"][:, : len(effort)]) >= effort * (1.0 - 1e-9)
        at_limit = at_limit + here.sum(axis=0) if at_limit.size else here.sum(axis=0)
    cycles.finish()
    if not count:
        raise InvalidInputError(
            f"a run of {len(recording)} ticks ends before t = {SETTLE_S:g} s, from where it is "
            "judged; run it longer"
        )
    duration = len(recording) / float(meta["control_rate_hz"])
    position, orientation = error.rms()
    verdict = {
        "scenario": meta.get("scenario", {}).get("name"),
        "plant": meta.get("plant"),
        "seed": meta.get("seed"),
        "duration_s": duration,
        "ticks": len(recording),
        "real_time_factor": _ratio(duration, meta.get("wall_s")),
        "force": _forces(names, force, cycles.worst),
        "motion": {"rms_error_m": position, "rms_error_rad": orientation},
        "contact_fraction": dict(zip(contacts, closed.mean(), strict=False)),
        "first_contact_s": dict(zip(contacts, ticks.landed, strict=True)),
        "steps": step_answers(recording, ticks.landed),
        "judged_ticks": count,
        "power": _power(*power.values()),
        "tick_us": _tick(recording),
        "status": dict(zip(_STATUS, map(int, status), strict=True)),
        "at_limit": _standing(recording, at_limit),
        "joint_losses": meta.get("joint_losses", []),
    }
    facts = {
        "run": [_run_facts(recording, verdict, error.peak())],
        "contact": _contact_facts(verdict, openings, ticks, float(meta["control_rate_hz"])),
        "force": _force_facts(verdict, openings.judged[ticks.columns] > 0, ticks),
        "doubt": [{"counts": 1, "sentence": text} for text in meta.get("doubts", ())],
    }
    return verdict | {"task": judge_task(facts, limits)}


def _run_facts(
    recording: Recording, verdict: Mapping[str, Any], away: Sequence[float | None]
) -> dict[str, Any]:
    """Of the run as a whole: what `outcome.RULES` compare and name.

    Args:
        recording: of it. verdict: so far.
        away: largest distance (m) and angle (rad) of the object from its reference.
    """
    meta, held = recording.meta, verdict["status"]["held"]
    distance, angle = away
    motors = [joint for joint, _ in verdict["at_limit"][:3]]
    return {
        "stopped": meta.get("end_state") == "SAFE_STOP",
        "reason": meta.get("first_reason") or meta.get("end_reason") or "not recorded",
        "distance": distance,
        "distance_mm": 1e3 * (distance or 0.0),
        "angle": angle,
        "ticks": verdict["ticks"],
        "held": held,
        "held_share": held / verdict["ticks"],
        "saturated": verdict["status"]["saturated"],
        "motors": ", ".join(motors) or "some",
    }


def _contact_facts(
    verdict: Mapping[str, Any], openings: Openings, ticks: JudgedTicks, rate: float
) -> list[dict[str, Any]]:
    """The same of each contact.

    Args:
        verdict: so far. openings, ticks: after the last tick. rate: of the ticks (Hz).
    """
    return [
        {
            "name": name,
            "open_at_end": ticks.open[i],
            "again": "" if first is None else " again",
            "longest_loss": openings.longest[i] / rate,
            "open_share": openings.ticks[i] / max(openings.judged[i], 1),
        }
        for i, (name, first) in enumerate(verdict["first_contact_s"].items())
    ]


def _force_facts(
    verdict: Mapping[str, Any], judged: Sequence[bool], ticks: JudgedTicks
) -> list[dict[str, Any]]:
    """The same of each force magnitude.

    Args:
        verdict: so far. judged: (r,) whether its contact was. ticks: after the last tick.
    """
    return [
        {
            "name": name,
            "rms": force["rms_error_rel"],
            "rms_N": force["rms_error_N"],
            "mean_N": force["mean_command_N"],
            "cycle": force["limit_cycle_rel"],
            "cycle_N": force["limit_cycle_N"],
            "cycle_Hz": force["limit_cycle_Hz"],
            "unjudged": not judged[j] and ticks.landed[ticks.columns[j]] is not None,
        }
        for j, (name, force) in enumerate(verdict["force"].items())
    ]


class _Series:
    """Sums over the ticks of one or several numbers, piece after piece.

    What is not finite was not computed, or is not judged, and is left out; None where all is.
    """

    def __init__(self) -> None:
        self._counts = self._sums = self._squares = self._peaks = np.zeros(0)

    def add(self, values: Array) -> None:
        """Ticks (k,) or (k, m)."""
        rows = np.array(values[:, None] if values.ndim == 1 else values, dtype=float).T
        if not self._counts.size:
            self._counts = self._sums = self._squares = self._peaks = np.zeros(len(rows))
        finite = np.isfinite(rows)
        rows = np.where(finite, rows, 0.0)
        self._counts = self._counts + finite.sum(axis=1)
        self._sums = self._sums + rows.sum(axis=1)
        self._squares = self._squares + (rows**2).sum(axis=1)
        self._peaks = np.maximum(self._peaks, np.abs(rows).max(axis=1, initial=0.0))

    def mean(self) -> list[float | None]:
        return self._where_counted(self._sums / np.maximum(self._counts, 1))

    def rms(self) -> list[float | None]:
        return self._where_counted(np.sqrt(self._squares / np.maximum(self._counts, 1)))

    def peak(self) -> list[float | None]:
        return self._where_counted(self._peaks)

    def _where_counted(self, values: Array) -> list[float | None]:
        pairs = zip(values, self._counts, strict=True)
        return [float(x) if count else None for x, count in pairs]


def _forces(
    names: Sequence[str], series: Mapping[str, _Series], cycles: Sequence[Cycle | None]
) -> dict[str, dict[str, float | None]]:
    """What `metrics` says of each force magnitude.

    Args:
        names: of them. series: "command", "error" and "sensing". cycles: the worst of each.
    """
    error = series["error"]
    values = (series["command"].mean(), error.rms(), error.peak(), series["sensing"].rms(), cycles)
    return {
        name: {
            "rms_error_N": rms,
            "rms_error_rel": _ratio(rms, mean),
            "peak_error_N": peak,
            "peak_error_rel": _ratio(peak, mean),
            "mean_command_N": mean,
            "sensing_rms_rel": _ratio(sensed, mean),
            "limit_cycle_N": cycle and cycle.amplitude,
            "limit_cycle_Hz": cycle and cycle.frequency,
            "limit_cycle_rel": cycle and cycle.relative,
        }
        for name, mean, rms, peak, sensed, cycle in zip(names, *values, strict=True)
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
