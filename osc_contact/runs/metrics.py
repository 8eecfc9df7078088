"""The verdict on a recording: the numbers of metrics.json."""

from __future__ import annotations

from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError, RecordingError
from osc_contact.recorder import Recording
from osc_contact.spatial import Array

__all__ = ["SETTLE_S", "STEP_BLANK_S", "metrics"]

SETTLE_S = 1.0  #: judged from here on
STEP_BLANK_S = 0.05  #: forces and power are not judged this long after a step of a desired force


def metrics(recording: Recording) -> dict[str, Any]:
    """Judge a run against the plant's truth.

    Keys: scenario, plant, seed, duration_s, ticks, real_time_factor;
    force {contact: rms_error_N, rms_error_rel, peak_error_N, peak_error_rel, mean_command_N,
    sensing_rms_rel}; motion {rms_error_m, rms_error_rad} along the free directions;
    contact_fraction {contact}; power {total_rms_W, projected_rms_W, ratio};
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
    t = recording["t"]
    judged = t >= SETTLE_S - 1e-9
    if not judged.any():
        raise InvalidInputError(
            f"a run of {len(t)} ticks ends before t = {SETTLE_S:g} s, from where it is judged; "
            "run it longer"
        )
    quiet = judged.copy()
    for step in recording.meta["force_steps_s"]:
        quiet &= ~((t >= step - 1e-9) & (t < step + STEP_BLANK_S - 1e-9))
    duration = len(t) / float(recording.meta["control_rate_hz"])
    return {
        "scenario": recording.meta["scenario"]["name"],
        "plant": recording.meta["plant"],
        "seed": recording.meta["seed"],
        "duration_s": duration,
        "ticks": len(t),
        "real_time_factor": duration / recording.meta["wall_s"],
        "force": _forces(recording, quiet),
        "motion": {
            "rms_error_m": _rms_norm(recording["motion_error"][judged, :3]),
            "rms_error_rad": _rms_norm(recording["motion_error"][judged, 3:]),
        },
        "contact_fraction": {
            name: float(recording["closed"][judged, i].mean())
            for i, name in enumerate(recording.meta["contact_names"])
        },
        "power": _power(recording, quiet),
        "tick_us": _tick(recording["tick_s"]),
        "status": _status(recording["status"]),
        "at_limit": _at_limit(recording),
    }


def _forces(recording: Recording, rows: Array) -> dict[str, dict[str, float | None]]:
    out = {}
    for i, name in enumerate(recording.magnitude_names):
        command = recording["alpha_cmd"][rows, i]
        truth = recording["alpha_true"][rows, i]
        sensed = recording["alpha_meas"][rows, i]
        mean = float(command.mean())
        rms, peak = _rms(truth - command), float(np.abs(truth - command).max())
        out[name] = {
            "rms_error_N": rms,
            "rms_error_rel": _ratio(rms, mean),
            "peak_error_N": peak,
            "peak_error_rel": _ratio(peak, mean),
            "mean_command_N": mean,
            "sensing_rms_rel": _ratio(_rms(sensed - truth), mean),
        }
    return out


def _power(recording: Recording, rows: Array) -> dict[str, float | None]:
    total = _rms(recording["power_total"][rows])
    projected = _rms(recording["power_projected"][rows])
    return {
        "total_rms_W": total,
        "projected_rms_W": projected,
        "ratio": _ratio(projected, total),
    }


def _tick(seconds: Array) -> dict[str, float]:
    p50, p99, p99_9 = np.percentile(seconds, [50, 99, 99.9]) * 1e6
    slowest = seconds.max() * 1e6
    return {"p50": float(p50), "p99": float(p99), "p99_9": float(p99_9), "max": float(slowest)}


def _status(status: Array) -> dict[str, int]:
    names = {0: "ok", 1: "saturated", 2: "held", 3: "degraded"}
    return {name: int((status == code).sum()) for code, name in names.items()}


def _at_limit(recording: Recording) -> list[list[str | int]]:
    limits = recording.meta.get("effort_limits", {})
    ticks = {
        joint: int((np.abs(recording["tau"][:, i]) >= limit * (1.0 - 1e-9)).sum())
        for i, (joint, limit) in enumerate(limits.items())
        if limit is not None
    }
    return [[joint, n] for joint, n in sorted(ticks.items(), key=lambda item: -item[1]) if n]


def _ratio(part: float, whole: float) -> float | None:
    """None where there is nothing to compare with: JSON has no NaN."""
    return part / whole if whole else None


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _rms_norm(x: Array) -> float:
    """Root mean square of the length of 3-vectors (one unit each: metres or radians)."""
    return float(np.sqrt(np.mean(np.sum(x**2, axis=1))))
