"""The verdict on a recording: the numbers of metrics.json, and the task in a word."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from osc_contact.control.status import Status
from osc_contact.errors import InvalidInputError, RecordingError
from osc_contact.files import Json
from osc_contact.lab.runs.limit_cycles import worst_cycles
from osc_contact.lab.runs.series import Series, WorstSecond
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import CLOSED, SETTLE_S, Flags, JudgedTicks
from osc_contact.settings.control import VerdictSpec
from osc_contact.spatial import Array

_LEAST_COMMAND_N = 1.0  #: least command that a force is divided by (N)
STEP_WINDOW_S = 0.5  #: longest time after a step in which its overshoot is searched (s)
#: Channels that are read.
_CHANNELS_READ = (
    "t",
    "alpha_cmd",
    "alpha_true",
    "alpha_meas",
    "power_total",
    "power_projected",
    "motion_error",
    "closed",
    "contact_phase",
    "contact_named",
    "status",
    "tau",
)
#: Names of the values of channel `status`.
_STATUS_NAMES = tuple(status.name.lower() for status in Status)


@dataclass(frozen=True)
class Rule:
    """Rule of the verdict: a quantity above its limit gives the run a word.

    Attributes:
        word: word for the run.
        subject: kind of subject that has the quantity: "run", "force", "contact" or "doubt".
        quantity: name of the number that is compared.
        limit: key of `VerdictSpec`, or a number that is the limit in every scenario.
        sentence: format of the reason, with values of the subject and {limit}; {mm} and {limit_mm}
            are a thousand times the quantity and its limit.
        fails: whether the task has failed if the rule applies.
    """

    word: str
    subject: str
    quantity: str
    limit: str | float
    sentence: str
    fails: bool = True


#: The gravest word that applies is that of the first row.
RULES = (
    Rule(
        "STOPPED",
        "run",
        "stopped",
        0.0,
        "it had stopped (SAFE_STOP) at the end; first reason, {reason}",
    ),
    Rule(
        "NOT DONE",
        "run",
        "plan_failed",
        0.0,
        "the plan is {plan_outcome}: {plan_reason}",
    ),
    Rule(
        "RUN AWAY",
        "run",
        "distance",
        "distance",
        "the object was {mm:.0f} mm away from its reference (limit {limit_mm:.0f} mm); "
        "command a slower or smaller motion, or check gains, model and friction",
    ),
    Rule(
        "RUN AWAY",
        "run",
        "angle",
        "angle",
        "the object was turned by {angle:.2g} rad from its reference (limit {limit:g} rad); "
        "command a slower or smaller motion, or check gains, model and friction",
    ),
    Rule(
        "LOST",
        "contact",
        "open_at_end",
        0.0,
        "contact '{name}' was never made{again}; check the start pose and the place of the face",
    ),
    Rule(
        "LOST",
        "contact",
        "longest_loss",
        "lost_time",
        "contact '{name}' was lost: open for up to {longest_loss:.3g} s in a row (limit "
        "{limit:g} s), while the controller took it as closed; command more force or a slower "
        "motion, or close contacts again with control.life",
    ),
    Rule(
        "POOR",
        "contact",
        "open_share",
        "open_share",
        "contact '{name}' was open in {open_share:.1%} of its judged time (limit {limit:.1%}), "
        "though a force was commanded; command more force or a slower motion",
    ),
    Rule(
        "POOR",
        "force",
        "rms_error_rel",
        "force_rms",
        "force {name} was off by {rms_error_N:.3g} N rms, {rms_error_rel:.1%} of its mean command "
        "{mean_command_N:.3g} N (limit {limit:.1%}); check gains, masses, friction and sensors",
    ),
    Rule(
        "POOR",
        "force",
        "worst_second_rel",
        "force_rms",
        "force {name} was off by {worst_second_rel:.1%} of its mean command {mean_command_N:.3g} "
        "N, rms within one second (limit {limit:.1%}); check gains, masses, friction and sensors",
    ),
    Rule(
        "POOR",
        "force",
        "peak_over_command",
        "force_peak",
        "force {name} was {peak_over_command:.3g} times its command (limit {limit:g}); command a "
        "slower motion, or check gains, masses, friction and sensors",
    ),
    Rule(
        "POOR",
        "run",
        "off",
        "path",
        "the object was {mm:.1f} mm off its reference (limit {limit_mm:.1f} mm); command a slower "
        "motion, raise gains.motion.frequency, or check friction and rotors of the joints",
    ),
    Rule(
        "POOR",
        "force",
        "limit_cycle_rel",
        "limit_cycle",
        "force {name} oscillates by ± {limit_cycle_N:.3g} N at {limit_cycle_Hz:.3g} Hz, "
        "{limit_cycle_rel:.1%} of its command (limit {limit:.1%}), uncommanded: a limit cycle; "
        "lower gains.force.bandwidth, or give a yielding face its compliance, limit_cycle_m_per_N",
    ),
    Rule(
        "POOR",
        "force",
        "unjudged",
        0.0,
        "force {name} was not judged: its contact closed too late; run it longer",
    ),
    Rule(
        "HELD",
        "run",
        "held_share",
        "held_share",
        "{held} of {ticks} ticks could not be computed ({held_share:.2%}, limit {limit:.1%}); see "
        "docs/reliability.md. First reason, {reason}",
    ),
    Rule("DOUBTFUL", "doubt", "counts", 0.0, "before it ran: {sentence}", fails=False),
    Rule(
        "HELD",
        "run",
        "held_share",
        0.0,
        "{held} of {ticks} ticks could not be computed ({held_share:.2%})",
        fails=False,
    ),
    Rule(
        "HOPPING",
        "run",
        "hopping",
        0.0,
        "a contact hopped in {hopping} of {ticks} ticks: its force fell below a fifth of its "
        "command again and again",
        fails=False,
    ),
    Rule(
        "SATURATED",
        "run",
        "saturated",
        0.0,
        "{saturated} of {ticks} ticks were at a motor limit ({motors})",
        fails=False,
    ),
)


def metrics(recording: Recording) -> Json:
    """Judge a run against the plant's truth.

    Keys of the result: scenario, plant, seed (None for a user's own loop), duration_s, ticks,
    real_time_factor;
    force {contact: rms_error_N, rms_error_rel, peak_error_N, peak_error_rel, worst_second_rel,
    peak_over_command, mean_command_N, sensing_rms_rel, limit_cycle_N, limit_cycle_Hz,
    limit_cycle_rel, limit_cycle_m_per_N}, of closed contacts, see `osc_contact.recorder.judged` and
    `limit_cycles`;
    motion {rms_error_m, rms_error_rad} along the free directions;
    contact_fraction {contact}; first_contact_s {contact} (null: never); steps, see
    `step_answers`; judged_ticks; task {word, failed, why}, see `judge_task`;
    power {total_rms_W, projected_rms_W, ratio};
    tick_us {p50, p99, p99_9, max}; loop, as `LoopReport.as_dict` (null: not in real time);
    status {name: ticks}; at_limit [[joint, ticks], …] of motors that were at their limit, in order
    of decreasing numbers of ticks; plan {outcome, reason, stages: [fields of `StageVerdict`, …]}
    (null: the scenario has none).

    Names under force are those of the contacts; the magnitudes of a contact with several are called
    contact.1, contact.2, … rms_error is the rms of true force minus command; sensing is the
    magnitude that fig. 5's filter computes from the wrist readings, minus true force; both relative
    to the mean command (null if it is 0).

    Args:
        recording: recording with a judge.

    Raises:
        InvalidInputError: the recording is not longer than the settling time.
        RecordingError: no judge took part in the run.
    """
    if "alpha_true" not in recording:
        raise RecordingError(
            "the recording does not hold the true contact forces: no judge took part in the run, "
            "as on hardware; compare alpha_meas with alpha_cmd instead"
        )
    limits = VerdictSpec.model_validate(recording.meta.get("scenario", {}).get("verdict", {}))
    sums = _Sums(recording, limits.limit_cycle)
    if not sums.count:
        raise InvalidInputError(
            f"a run of {len(recording)} ticks ends before t = {SETTLE_S:g} s, from where it is "
            "judged; run it longer"
        )
    verdict = _entries(recording, sums)
    return verdict | {"task": judge_task(_facts_of_subjects(recording, sums, verdict), limits)}


class _Sums:
    """Sums over the ticks of a recording.

    Attributes:
        ticks: ticks that are evaluated.
        count: their number, without regard to contacts.
        duration: duration of the run (s).
        judged: (contacts,) number of evaluated ticks of each contact.
        opened: (contacts,) number of these in which the contact is open.
        longest: (contacts,) longest sequence of ticks in which the contact is open but closed for
            the controller.
        cycles: largest limit cycle of each force.
        status: number of ticks of each status.
        at_limit: number of ticks in which each motor is at its limit.
        command, error, sensing, over: statistics of each force magnitude: desired force, true minus
            desired, measured minus true (N), true over desired force.
        seconds: worst second.
        away, off: statistics of the deviation from the reference.
        total, projected: of powers (W).
        closed: share of ticks in which each contact is closed.
    """

    def __init__(self, recording: Recording, least_cycle: float) -> None:
        """Evaluate a recording, piece after piece, so that memory stays small.

        Args:
            recording: recording with a judge.
            least_cycle: least amplitude of a limit cycle over the mean command.
        """
        meta = recording.meta
        self.ticks = JudgedTicks(recording)
        self.duration = len(recording) / meta["control_rate_hz"]
        contacts = len(meta["contact_names"])
        self.opened = np.zeros(contacts, int)
        self.judged = np.zeros(contacts, int)
        self.longest = np.zeros(contacts, int)
        # (contacts,) number of ticks for which each contact has been lost without interruption
        self._ticks_lost = np.zeros(contacts, int)
        self.command = Series()  # (N)
        self.error = Series()  # true minus desired force (N)
        self.sensing = Series()  # measured minus true force (N)
        self.over = Series()  # true over desired force
        self.seconds = WorstSecond()
        self.total = Series()  # power of the contact wrench (W)
        self.projected = Series()  # power of its part along N (W)
        self.away = Series()  # distance (m) and angle (rad) from the reference in all ticks
        self.off = Series()  # distance (m) from the reference while contacts are settled
        self.closed = Series()  # 1 in ticks in which a contact is closed
        limits = list(meta.get("effort_limits", {}).values())
        #: (n_a,) torque limits, inf without a limit (N m, N)
        self._effort = np.nan_to_num(np.array(limits, dtype=float), nan=np.inf)
        self.at_limit = np.zeros(len(limits), dtype=int)
        self.status = np.zeros(len(_STATUS_NAMES), dtype=int)
        self.count = 0
        judged_forces = [np.zeros((0, len(self.ticks.columns)), dtype=bool)]
        for piece in recording.pieces(*(name for name in _CHANNELS_READ if name in recording)):
            settled, force_flags, quiet = self.ticks.add(piece)
            judged_forces.append(self._add_forces(piece, force_flags))
            self._add_motion(piece, quiet)
            self._add_losses(piece, settled)
            self.status += np.bincount(piece["status"], minlength=len(_STATUS_NAMES))
            tau = np.abs(piece["tau"][:, : len(self._effort)])
            self.at_limit += (tau >= self._effort * (1.0 - 1e-9)).sum(axis=0)
        self.cycles = worst_cycles(recording, np.concatenate(judged_forces), least_cycle)

    def _add_forces(self, piece: Mapping[str, Array], flags: Flags) -> Flags:
        """Include desired, true and measured forces of a piece.

        Args:
            piece: channels of k ticks.
            flags: (k, r) judged ticks of each force magnitude.

        Returns:
            (k, r) flags of the ticks whose errors are known, too.
        """
        command = np.where(flags, piece["alpha_cmd"], np.nan)
        truth = np.where(flags, piece["alpha_true"], np.nan)
        measured = np.where(flags, piece["alpha_meas"], np.nan)
        error = truth - command
        self.command.add(command)
        self.error.add(error)
        self.over.add(truth / np.maximum(np.abs(command), _LEAST_COMMAND_N))
        self.seconds.add(piece["t"], error)
        self.sensing.add(measured - truth)
        return flags & np.isfinite(error)

    def _add_motion(self, piece: Mapping[str, Array], quiet: Flags) -> None:
        """Include deviations from the reference, powers and closed contacts of a piece.

        Args:
            piece: channels of k ticks.
            quiet: (k,) ticks in which no contact is made and no force steps.
        """
        judged = piece["t"] >= SETTLE_S - 1e-9
        self.count += int(judged.sum())
        self.off.add(np.linalg.norm(piece["motion_error"][quiet, :3], axis=1))
        self.total.add(piece["power_total"][quiet])
        self.projected.add(piece["power_projected"][quiet])
        self.away.add(np.linalg.norm(piece["motion_error"][judged].reshape(-1, 2, 3), axis=2))
        self.closed.add(piece["closed"][judged])

    def _add_losses(self, piece: Mapping[str, Array], settled: Flags) -> None:
        """Include the ticks of a piece in which contacts are open though they should be closed.

        A contact is lost where it is open but CLOSED for the controller. `_ticks_lost` (contacts,)
        counts its ticks without interruption, also from the piece before.

        Args:
            piece: channels of k ticks.
            settled: (k, contacts) judged ticks of each contact.
        """
        is_open = ~piece["closed"].astype(bool) & settled
        self.judged += settled.sum(axis=0)
        self.opened += is_open.sum(axis=0)
        is_lost = is_open & (piece["contact_phase"] == CLOSED)
        if not is_lost.any():
            self._ticks_lost[:] = 0
            return
        for row in is_lost:
            self._ticks_lost = (self._ticks_lost + 1) * row  # zero where the contact is not lost
            np.maximum(self.longest, self._ticks_lost, out=self.longest)


def _entries(recording: Recording, sums: _Sums) -> Json:
    """Entries of metrics.json, except the verdict on the task.

    Args:
        recording: recording of the run.
        sums: sums over its ticks.
    """
    meta = recording.meta
    contacts = meta["contact_names"]
    # sums that are needed in two places
    position, orientation = sums.away.rms()
    (total,) = sums.total.rms()
    (projected,) = sums.projected.rms()
    losses = meta.get("joint_losses", [])
    at_limit = [
        [joint, ticks]
        for joint, ticks in zip(meta.get("effort_limits", {}), sums.at_limit.tolist(), strict=True)
        if ticks
    ]
    return {
        "scenario": meta.get("scenario", {}).get("name"),
        "plant": meta.get("plant"),
        "seed": meta.get("seed"),
        "duration_s": sums.duration,
        "ticks": len(recording),
        "real_time_factor": _ratio(sums.duration, meta.get("wall_s")),
        "force": _force_metrics(recording.magnitude_names, sums),
        "motion": {"rms_error_m": position, "rms_error_rad": orientation},
        "contact_fraction": dict(zip(contacts, sums.closed.mean(), strict=False)),
        "first_contact_s": dict(zip(contacts, sums.ticks.landed, strict=True)),
        "steps": step_answers(recording, sums.ticks),
        "judged_ticks": sums.count,
        "power": {
            "total_rms_W": total,
            "projected_rms_W": projected,
            "ratio": _ratio(projected, total),
        },
        "tick_us": _tick_percentiles(recording),
        "loop": meta.get("loop"),
        "status": dict(zip(_STATUS_NAMES, sums.status.tolist(), strict=True)),
        "at_limit": sorted(at_limit, key=lambda entry: -entry[1]),
        "joint_losses": losses,
        "learned_friction": _learned_losses(losses, meta),
        "normals": dict(zip(recording.magnitude_names, meta.get("normal_std", []), strict=False)),
        "force_per_normal": meta.get("force_per_normal", 0.0),
        "plan": meta.get("plan"),
    }


def _learned_losses(losses: Sequence[Json], meta: Json) -> list[Json]:
    """Friction and rotor inertia of each joint as learned, rounded to the significant digits.

    Args:
        losses: losses of the model's joints.
        meta: meta data of the recording.

    Returns:
        For each joint its name, whether it slides, friction (N m, N), damping (N m s/rad, N s/m)
        and armature (kg m², kg).
    """
    friction = meta.get("joint_friction", [])
    missing = meta.get("missing_inertia", [0.0] * len(friction))
    return [
        {
            "joint": joint["joint"],
            "slides": joint["slides"],
            "friction": round(dry, 2),
            "damping": round(viscous, 2),
            "armature": round(joint["armature"] + inertia, 2),
        }
        for joint, (dry, viscous), inertia in zip(losses, friction, missing, strict=False)
    ]


def _force_metrics(names: Sequence[str], sums: _Sums) -> dict[str, dict[str, float | None]]:
    """Metrics of each contact force, by its name.

    They are errors of the true force (N, and relative to the mean command), the ratio of the true
    force to the command, errors of the measured force, and the limit cycle, None without one.

    Args:
        names: names of the forces.
        sums: sums over the judged ticks.
    """
    by_name = {}
    columns = (
        sums.command.mean(),
        sums.error.rms(),
        sums.error.peak(),
        sums.seconds.largest(),
        sums.over.peak(),
        sums.sensing.rms(),
        sums.cycles,
    )
    # `cycle` is None without a limit cycle, and then all of its entries are None
    for name, mean, rms, peak, largest_second, peak_ratio, sensing, cycle in zip(
        names, *columns, strict=True
    ):
        by_name[name] = {
            "rms_error_N": rms,
            "rms_error_rel": _ratio(rms, mean),
            "peak_error_N": peak,
            "peak_error_rel": _ratio(peak, mean),
            "worst_second_rel": _ratio(largest_second, mean),
            "peak_over_command": peak_ratio,
            "mean_command_N": mean,
            "sensing_rms_rel": _ratio(sensing, mean),
            "limit_cycle_N": cycle and cycle.amplitude,
            "limit_cycle_Hz": cycle and cycle.frequency,
            "limit_cycle_rel": cycle and cycle.relative,
            "limit_cycle_m_per_N": cycle and cycle.compliance,
        }
    return by_name


def _facts_of_subjects(recording: Recording, sums: _Sums, verdict: Json) -> dict[str, list[Json]]:
    """Values that `RULES` compare or name, for each subject.

    Args:
        recording: recording of the run.
        sums: sums over its ticks.
        verdict: metrics of the run.
    """
    meta = recording.meta
    landed = sums.ticks.landed
    plan = meta.get("plan", {})
    # of the run as a whole
    distance, angle = sums.away.peak()
    run = {
        **verdict["status"],
        "ticks": verdict["ticks"],
        "stopped": meta.get("end_state") == "SAFE_STOP",
        "plan_failed": plan.get("outcome", "done") != "done",
        "plan_outcome": plan.get("outcome"),
        "plan_reason": plan.get("reason"),
        "reason": meta.get("first_reason") or meta.get("end_reason") or "not recorded",
        "distance": distance,
        "off": sums.off.peak()[0],
        "angle": angle,
        "held_share": verdict["status"]["held"] / verdict["ticks"],
        "motors": ", ".join(joint for joint, _ in verdict["at_limit"][:3]) or "some",
    }
    contacts = [
        {
            "name": name,
            "open_at_end": sums.ticks.open[i],
            "again": "" if landed[i] is None else " again",
            "longest_loss": sums.longest[i] / meta["control_rate_hz"],
            "open_share": sums.opened[i] / max(sums.judged[i], 1),
        }
        for i, name in enumerate(verdict["first_contact_s"])
    ]
    forces = [
        {"name": name, "unjudged": not sums.judged[i] and landed[i] is not None, **force}
        for i, (name, force) in zip(sums.ticks.columns, verdict["force"].items(), strict=True)
    ]
    doubts = [{"counts": 1, "sentence": text} for text in meta.get("doubts", ())]
    return {"run": [run], "contact": contacts, "force": forces, "doubt": doubts}


def _tick_percentiles(recording: Recording) -> dict[str, float | None]:
    """Percentiles and maximum of the tick's computing time (µs); None if it was not recorded.

    Args:
        recording: recording of the run.
    """
    keys = ("p50", "p99", "p99_9", "max")
    if "tick_s" not in recording:  # the file of its times is missing
        return dict.fromkeys(keys)
    pieces = [piece["tick_s"].astype(np.float32) for piece in recording.pieces("tick_s")]
    seconds = np.concatenate(pieces)
    values = np.percentile(seconds, [50, 99, 99.9, 100], overwrite_input=True) * 1e6
    return dict(zip(keys, values.tolist(), strict=True))


def _ratio(part: float | None, whole: float | None) -> float | None:
    """Ratio of two numbers; None instead of NaN, which JSON lacks.

    Args:
        part: numerator; None: unknown.
        whole: denominator; None: unknown, or zero.
    """
    return part / whole if whole and part is not None else None


def step_answers(recording: Recording, ticks: JudgedTicks) -> list[Json]:
    """First contacts and steps of desired forces, each with the overshoot that it caused.

    overshoot = largest (true − desired force) in the direction of the step, within `STEP_WINDOW_S`.

    Args:
        recording: recording with a judge.
        ticks: selection of judged ticks, to which the whole recording was added.

    Returns:
        Steps of force magnitudes in order of time, with the keys t_s, force, what ("first contact"
        or "step"), from_N, to_N, overshoot_N, overshoot_rel (relative to the step), and true and
        desired force at the largest overshoot, peak_N and commanded_N.
    """
    rate = recording.meta["control_rate_hz"]
    steps = sorted({round(t * rate) for t in recording.meta["force_steps_s"]})
    changes = []
    for column, owner in enumerate(ticks.columns):
        first = ticks.landed[owner]
        if first is not None:
            changes.append((round(first * rate), column, True))
        begin = max(2, round((first or 0.0) * rate))
        changes += [(k, column, False) for k in steps if k > begin]
    answers = []
    for k, column, is_first_contact in sorted(changes):
        answer = _step_answer(recording, rate, steps, k, column, is_first_contact)
        if answer is not None:
            answers.append(answer)
    return answers


def _step_answer(
    recording: Recording, rate: float, steps: Sequence[int], k: int, column: int, first: bool
) -> Json | None:
    """Step response of one force after tick k; None without a commanded step.

    The response ends `STEP_WINDOW_S` later, at the next step of any force, or where the contact is
    released. The overshoot is the largest true force beyond the commanded one, in the direction of
    the step (N), and relative to the step.

    Args:
        recording: recording with a judge.
        rate: control rate (Hz).
        steps: ticks of all steps of desired forces.
        k: tick of the step.
        column: index of the force.
        first: True if the step is the first contact, from zero; False for a step of the desired
            force.
    """
    later_steps = [step for step in steps if step > k]
    stop = min([k + max(2, round(STEP_WINDOW_S * rate)), *later_steps, len(recording)])
    window = recording.rows(max(0, k - 3), stop, "alpha_cmd", "alpha_true")
    command = window["alpha_cmd"][:, column]
    truth = window["alpha_true"][:, column]
    before = min(k, 3)  # number of ticks of the window before the step
    is_known = np.isfinite(command + truth)
    after = np.flatnonzero(is_known & (np.arange(len(command)) >= before))
    if not len(after):
        return None
    if first:
        start = 0.0
        goal = command[after[0]]
    else:
        before_last, start, goal = command[before - 2 : before + 1]
        # a command that varies smoothly has changed as much in the tick before; a step is a change
        # beyond that of more than 1 % of the largest command that follows
        drift = start - before_last
        if not abs(goal - start - drift) > 0.01 * np.abs(command[after]).max():
            return None
    if goal == start:
        return None
    if goal != 0.0:  # the window ends where the contact is released
        released = np.flatnonzero(command[after] == 0.0)
        after = after[: released[0]] if len(released) else after
    excess = np.sign(goal - start) * (truth - command)
    peak = after[np.argmax(excess[after])]
    overshoot = max(0.0, excess[peak])
    numbers = {
        "from_N": start,
        "to_N": goal,
        "peak_N": truth[peak],
        "commanded_N": command[peak],
        "overshoot_N": overshoot,
        "overshoot_rel": overshoot / abs(goal - start),
    }
    return {
        "t_s": k / rate,
        "force": recording.magnitude_names[column],
        "what": "first contact" if first else "step",
        **{key: float(value) for key, value in numbers.items()},
    }


def judge_task(
    facts: Mapping[str, Sequence[Json]],
    limits: VerdictSpec,
    rules: Sequence[Rule] = RULES,
) -> Json:
    """Word for a run, whether its task failed, and the reasons.

    Args:
        facts: values of all subjects by kind of subject: the quantities of the rules, and values
            that their sentences name. A quantity that is None is not compared.
        limits: limits of the scenario.
        rules: rules to apply, in order of decreasing gravity.

    Returns:
        Dictionary with "word", the word of the first rule that applies, or OK; "failed"; "why",
        sentences. After a rule has applied to a quantity of a subject, later rules on the same
        quantity are not applied to this subject.
    """
    applied: dict[tuple[str, int, str], tuple[Rule, str]] = {}
    for rule in rules:
        limit = getattr(limits, rule.limit) if isinstance(rule.limit, str) else rule.limit
        for i, fact in enumerate(facts[rule.subject]):
            value = fact[rule.quantity]
            if value is not None and value > limit:
                text = rule.sentence.format(
                    **fact, limit=limit, mm=1e3 * value, limit_mm=1e3 * limit
                )
                applied.setdefault((rule.subject, i, rule.quantity), (rule, text))
    return {
        "word": next((rule.word for rule, _ in applied.values()), "OK"),
        "failed": any(rule.fails for rule, _ in applied.values()),
        "why": [text for _, text in applied.values()],
    }
