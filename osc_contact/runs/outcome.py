"""What became of a task: steps of force and their overshoot, one word, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from osc_contact.recorder import Recording
from osc_contact.scenarios.control_schema import VerdictSpec
from osc_contact.spatial import Array

__all__ = ["RULES", "STEP_WINDOW_S", "Openings", "Rule", "judge_task", "step_answers"]

STEP_WINDOW_S = 0.5  #: a step's overshoot is looked for this long, or until the next step


@dataclass(frozen=True)
class Rule:
    """One row of the verdict: beyond its limit a quantity gives the run a word.

    Attributes:
        word: for the run. fails: whether its task has failed.
        subject: "run", "force", "contact" or "doubt": of what the quantity is.
        quantity: name of the number that is compared.
        limit: key of `VerdictSpec`; a number: this one, whatever the scenario says.
        sentence: with the numbers of its subject, {limit} among them.
    """

    word: str
    fails: bool
    subject: str
    quantity: str
    limit: str | float
    sentence: str


#: The gravest word that applies is that of the first row.
RULES = (
    Rule(
        "STOPPED", True, "run", "stopped", 0.0,
        "it had stopped (SAFE_STOP) at the end; first reason, {reason}",
    ),
    Rule(
        "RUN AWAY", True, "run", "distance", "distance",
        "the object was {distance_mm:.0f} mm away from its reference (limit {limit_mm:.0f} mm); "
        "ask for a slower or smaller motion, or look at gains, model and friction",
    ),
    Rule(
        "RUN AWAY", True, "run", "angle", "angle",
        "the object was turned by {angle:.2g} rad from its reference (limit {limit:g} rad); ask "
        "for a slower or smaller motion, or look at gains, model and friction",
    ),
    Rule(
        "LOST", True, "contact", "open_at_end", 0.0,
        "contact '{name}' was never made{again}; look at the start pose, and where the face is",
    ),
    Rule(
        "LOST", True, "contact", "longest_loss", "lost_time",
        "contact '{name}' was lost: open for up to {longest_loss:.3g} s in a row (limit "
        "{limit:g} s), while the controller took it as closed; ask for more force or a slower "
        "motion, or close contacts again with control.life",
    ),
    Rule(
        "POOR", True, "contact", "open_share", "open_share",
        "contact '{name}' was open in {open_share:.1%} of its judged time (limit {limit:.1%}), "
        "though a force was commanded; ask for more force or a slower motion",
    ),
    Rule(
        "POOR", True, "force", "rms", "force_rms",
        "force {name} was off by {rms_N:.3g} N rms, {rms:.1%} of its mean command "
        "{mean_N:.3g} N (limit {limit:.1%}); look at gains, masses, friction and sensors",
    ),
    Rule(
        "POOR", True, "force", "cycle", "limit_cycle",
        "force {name} swings by ± {cycle_N:.3g} N at {cycle_Hz:.3g} Hz, {cycle:.1%} of its "
        "command (limit {limit:.1%}), and nothing commands that: a limit cycle; lower "
        "gains.force.bandwidth, or give faces that yield their stiffness and mass",
    ),
    Rule(
        "POOR", True, "force", "unjudged", 0.0,
        "force {name} was not judged: its contact closed too late; run it longer",
    ),
    Rule(
        "HELD", True, "run", "held_share", "held_share",
        "{held} of {ticks} ticks could not be computed ({held_share:.2%}, limit {limit:.1%}); see "
        "docs/reliability.md. First reason, {reason}",
    ),
    Rule("DOUBTFUL", False, "doubt", "counts", 0.0, "before it ran: {sentence}"),
    Rule(
        "HELD", False, "run", "held_share", 0.0,
        "{held} of {ticks} ticks could not be computed ({held_share:.2%})",
    ),
    Rule(
        "SATURATED", False, "run", "saturated", 0.0,
        "{saturated} of {ticks} ticks were at a motor limit ({motors})",
    ),
)  # fmt: skip


class Openings:
    """How long each contact was open while it was judged.

    Attributes:
        ticks: (c,) open, with a force commanded. judged: (c,) judged at all.
        longest: (c,) longest row of ticks that the controller took as closed beside.
    """

    def __init__(self, contacts: int) -> None:
        self._run = np.zeros(contacts, int)
        self.longest = np.zeros(contacts, int)
        self.ticks = np.zeros(contacts, int)
        self.judged = np.zeros(contacts, int)

    def add(self, closed: Array, believed: Array, judged: Array) -> None:
        """Ticks (k, contacts) that follow one another.

        Args:
            closed: plant's truth. believed: by the controller. judged: see `JudgedTicks`.
        """
        opened = ~np.asarray(closed, dtype=bool) & judged
        self.judged += judged.sum(axis=0)
        self.ticks += opened.sum(axis=0)
        lost = opened & believed
        if not lost.any():
            self._run[:] = 0
            return
        for row in lost:
            self._run = np.where(row, self._run + 1, 0)
            np.maximum(self.longest, self._run, out=self.longest)


def step_answers(recording: Recording, landings: Sequence[float | None]) -> list[dict[str, Any]]:
    """First contacts and steps of desired forces, each with the overshoot that it caused.

    overshoot = largest (true − desired force) in the direction of the step, within `STEP_WINDOW_S`.

    Args:
        recording: with a judge. landings: when each contact first closed (s), None: never.

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
            changes.append((round(first * rate), column, True))
        begin = max(2, round((first or 0.0) * rate))
        changes += [(k, column, False) for k in steps if k > begin]
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


def judge_task(
    facts: Mapping[str, Sequence[Mapping[str, Any]]],
    limits: VerdictSpec,
    rules: Sequence[Rule] = RULES,
) -> dict[str, Any]:
    """One word for a run, whether its task failed, and why.

    Args:
        facts: by subject, what is known of each: the quantities of `RULES` and what their
            sentences name. A quantity that is None is not compared.
        limits: of the scenario. rules: to apply, the gravest first.

    Returns:
        {"word": that of the first rule that applies, or OK, "failed": bool, "why":
        sentences}. A subject that a rule has applied to is not compared with later rules for the
        same quantity.
    """
    found: list[tuple[Rule, str]] = []
    seen = set()
    for rule in rules:
        limit = getattr(limits, rule.limit) if isinstance(rule.limit, str) else rule.limit
        for i, fact in enumerate(facts[rule.subject]):
            value, key = fact[rule.quantity], (rule.subject, i, rule.quantity)
            if value is None or not value > limit or key in seen:
                continue
            seen.add(key)
            words = {**fact, "limit": limit, "limit_mm": 1e3 * limit}
            found.append((rule, rule.sentence.format(**words)))
    return {
        "word": found[0][0].word if found else "OK",
        "failed": any(rule.fails for rule, _ in found),
        "why": [why for _, why in found],
    }
