"""What became of a task: first contacts, steps of force and their overshoot, one word, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from osc_contact.recorder import Recording
from osc_contact.spatial import Array

__all__ = [
    "AWAY_FORCE", "AWAY_M", "AWAY_RAD", "HELD_SHARE", "LOST_S", "LOST_SHARE", "STEP_WINDOW_S",
    "Landings", "Openings", "judge_task", "step_answers",
]  # fmt: skip

STEP_WINDOW_S = 0.5  #: a step's overshoot is looked for this long, or until the next step
LOST_S = 0.05  #: a contact open for longer, while the controller took it as closed, was lost
LOST_SHARE = 0.05  #: … and so was one open in a larger share of the judged ticks
AWAY_M = 0.1  #: an object further from its reference has run away
AWAY_RAD = 0.3  #: … and so has one turned further
AWAY_FORCE = 0.9  #: times its mean command: a force further off in the rms is not followed
HELD_SHARE = 0.01  #: a larger share of ticks that were not computed fails a task
_CLOSED = 2  #: of channel `contact_phase`


class Openings:
    """How long each contact stayed open while the controller took it as closed."""

    def __init__(self, contacts: int) -> None:
        self._run = np.zeros(contacts, int)
        self.longest = np.zeros(contacts, int)
        self.ticks = np.zeros(contacts, int)

    def add(self, closed: Array, phase: Array) -> None:
        """Ticks (k, contacts) that follow one another."""
        opened = ~np.asarray(closed, dtype=bool) & (phase == _CLOSED)
        self.ticks += opened.sum(axis=0)
        if not opened.any():
            self._run[:] = 0
            return
        for row in opened:
            self._run = np.where(row, self._run + 1, 0)
            np.maximum(self.longest, self._run, out=self.longest)


class Landings:
    """The tick at which each contact first closed."""

    def __init__(self, contacts: int) -> None:
        self.ticks: list[int | None] = [None] * contacts
        self._seen = 0

    def add(self, closed: Array) -> None:
        """Ticks (k, contacts) that follow one another, from the first on."""
        for i in np.flatnonzero(np.any(closed, axis=0)):
            if self.ticks[i] is None:
                self.ticks[i] = self._seen + int(np.argmax(closed[:, i]))
        self._seen += len(closed)


def step_answers(recording: Recording, landings: Sequence[int | None]) -> list[dict[str, Any]]:
    """First contacts and steps of desired forces, each with the overshoot that it caused.

    overshoot = largest (true − desired force) in the direction of the step, within `STEP_WINDOW_S`.

    Args:
        recording: with a judge. landings: tick of each contact's first closing, None: never.

    Returns:
        In order of time, of each magnitude that stepped: t_s, force, what ("first contact" or
        "step"), from_N, to_N, overshoot_N, overshoot_rel (of the step), and where it is largest the
        true and the desired force, peak_N and asked_N.
    """
    rate = float(recording.meta["control_rate_hz"])
    owners = list(recording.meta.get("columns", range(len(recording.magnitude_names))))
    steps = sorted({round(t * rate) for t in recording.meta["force_steps_s"]})
    changes = []
    for column, owner in enumerate(owners):
        first = landings[owner]
        if first is not None:
            changes.append((first, column, True))
        changes += [(k, column, False) for k in steps if k > max(2, first or 0)]
    rows = [_answer(recording, rate, steps, *one) for one in sorted(changes)]
    return [row for row in rows if row is not None]


def _answer(
    recording: Recording, rate: float, steps: Sequence[int], k: int, column: int, first: bool
) -> dict[str, Any] | None:
    """What one magnitude does after tick k; None if it was not asked to step there."""
    later = [step for step in steps if step > k]
    stop = min([k + max(2, round(STEP_WINDOW_S * rate)), *later, len(recording)])
    some = recording.rows(max(0, k - 3), stop, "alpha_cmd", "alpha_true")
    command, truth = (some[name][:, column] for name in ("alpha_cmd", "alpha_true"))
    before = min(k, 3)
    after = np.flatnonzero(np.isfinite(command + truth) & (np.arange(len(command)) >= before))
    if not len(after):  # nothing there was computed
        return None
    if first:
        start, goal = 0.0, float(command[after[0]])
    else:
        start, goal = float(command[before - 1]), float(command[before])
        drift = start - float(command[before - 2])  # of signals that do not step
        if not abs(goal - start - drift) > 0.01 * np.abs(command[after]).max():
            return None
    if goal == start:
        return None
    way = float(np.sign(goal - start))
    worst = after[np.argmax(way * (truth - command)[after])]
    over = max(0.0, way * float(truth[worst] - command[worst]))
    return {
        "t_s": k / rate,
        "force": recording.magnitude_names[column],
        "what": "first contact" if first else "step",
        "from_N": start,
        "to_N": goal,
        "peak_N": float(truth[worst]),
        "asked_N": float(command[worst]),
        "overshoot_N": over,
        "overshoot_rel": over / abs(goal - start),
    }


def judge_task(recording: Recording, verdict: Mapping[str, Any], openings: Openings,
               away: tuple[float | None, float | None]) -> dict[str, Any]:  # fmt: skip
    """One word for a run, whether its task failed, and why.

    Args:
        recording: of it. verdict: what `metrics` found. openings: of the judged ticks.
        away: largest distance (m) and angle (rad) of the object from its reference, None: unknown.

    Returns:
        {"word": STOPPED, RUN AWAY, LOST, HELD, SATURATED or OK, "failed": bool, "why": sentences};
        the gravest word that applies.
    """
    verdicts = [
        *(("STOPPED", True, why) for why in _stopped(recording)),
        *(("RUN AWAY", True, why) for why in _ran_away(verdict, away)),
        *(("LOST", True, why) for why in _lost(recording, verdict, openings)),
    ]
    ticks, held, saturated = (verdict["ticks"], *map(verdict["status"].get, ("held", "saturated")))
    if held:
        failed = held > HELD_SHARE * ticks
        why = f"{held} of {ticks} ticks could not be computed ({held / ticks:.2%})"
        cure = f"; see docs/reliability.md. First reason, {_reason(recording)}" if failed else ""
        verdicts.append(("HELD", failed, why + cure))
    if saturated:
        motors = ", ".join(joint for joint, _ in verdict["at_limit"][:3]) or "some"
        why = f"{saturated} of {ticks} ticks were at a motor limit ({motors})"
        verdicts.append(("SATURATED", False, why))
    return {
        "word": verdicts[0][0] if verdicts else "OK",
        "failed": any(failed for _, failed, _ in verdicts),
        "why": [why for _, _, why in verdicts],
    }


def _stopped(recording: Recording) -> list[str]:
    if recording.meta.get("end_state") != "SAFE_STOP":
        return []
    return [f"it had stopped (SAFE_STOP) at the end; first reason, {_reason(recording)}"]


def _reason(recording: Recording) -> str:
    first, last = (recording.meta.get(key) for key in ("first_reason", "end_reason"))
    return str(first or last or "not recorded")


def _ran_away(verdict: Mapping[str, Any], away: tuple[float | None, float | None]) -> list[str]:
    reasons = []
    far, turned = (value or 0.0 for value in away)
    if far > AWAY_M or turned > AWAY_RAD:
        reasons.append(
            f"the object was {1e3 * far:.0f} mm and {turned:.2g} rad away from its reference "
            f"(task failed beyond {1e3 * AWAY_M:.0f} mm or {AWAY_RAD:g} rad); ask for a slower or "
            "smaller motion, or look at gains, model and friction"
        )
    for name, force in verdict["force"].items():
        if (force["rms_error_rel"] or 0.0) > AWAY_FORCE:
            reasons.append(
                f"force {name} was off by {force['rms_error_N']:.3g} N rms of "
                f"{force['mean_command_N']:.3g} N asked for (task failed beyond "
                f"{AWAY_FORCE:.0%}); look at gains, masses, friction and sensors"
            )
    return reasons


def _lost(recording: Recording, verdict: Mapping[str, Any], openings: Openings) -> list[str]:
    rate, reasons = float(recording.meta["control_rate_hz"]), []
    for i, (name, first) in enumerate(verdict["first_contact_s"].items()):
        longest, share = openings.longest[i] / rate, openings.ticks[i] / verdict["judged_ticks"]
        if first is None:
            reasons.append(
                f"contact '{name}' was never made; look at the start pose, and where the face is"
            )
        elif longest > LOST_S or share > LOST_SHARE:
            reasons.append(
                f"contact '{name}' was lost: open for up to {longest:.3g} s in a row and in "
                f"{share:.1%} of the judged time, while the controller took it as closed; ask for "
                "more force or a slower motion, or close contacts again with control.life"
            )
    return reasons
