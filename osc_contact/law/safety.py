"""Limits of the robot, and what happens when a tick cannot be computed: repeat, hold, stop."""

from __future__ import annotations

from osc_contact.law.agreement import UNBALANCED
from osc_contact.law.holding import hold_posture
from osc_contact.law.isolation import estimate_joints, isolate_packet
from osc_contact.law.jit import inner, leaf
from osc_contact.law.phases import collect
from osc_contact.law.reading import integral_room
from osc_contact.law.reasons import LASTING, NO_REASON, declare_reason
from osc_contact.law.records import (
    DEGRADED_STATE,
    HOLD,
    JOINTS,
    OK,
    RUN,
    SAFE_STOP,
    SATURATED,
    WRISTS,
)
from osc_contact.law.sensors import check_sensors, must_move

OVERSPEED = declare_reason(
    "OVERSPEED",
    50,
    "joint {joint} stayed above its speed limit of {speed:.4g} rad/s or m/s for "
    "{safety.overspeed_time:g} s; the arms are braked",
)
NEAR_END = declare_reason(
    "NEAR_END",
    51,
    "joint {joint} came so near to the end of its range [{low:.4g}, {high:.4g}] that it could "
    "just be stopped before, braked from its speed limit in brake_time = "
    "{safety.brake_time:g} s",
)
POWERED = declare_reason(
    "POWERED", 52, "more than contact_power = {safety.contact_power:g} W went into the contacts"
)
CONTACT_LOST = declare_reason(
    "CONTACT_LOST",
    53,
    "{contact}: less than a fifth of its command was read for {safety.contact_loss_time:g} s, "
    "or its integral stood at its bound ({force:.3g} N when last computed), or it was not held "
    "again {safety.regain_time:g} s after it was lost. Contact is lost, or a wrist sensor is "
    "dead or wired with the wrong sign",
)
MISSED = declare_reason(
    "MISSED",
    62,
    "more than missed_share = {safety.missed_share:g} of the ticks of the last second could not be "
    "computed; check the sensors' rate and the network",
)
OVERFORCE = declare_reason(
    "OVERFORCE",
    54,
    "{contact}: more than {safety.contact_force:g} N and three times its command was read for "
    "{safety.overforce_time:g} s ({force:.3g} N when last computed)",
)

# --- Limits of the robot: speeds, ends of joint ranges, contact forces and power ------------------
#
# Each rule looks at a tick that could be computed, before its torques are worked out. A reason that
# it finds stops the arms, see `safety`. Rules about forces and speeds collect seconds of evidence:
# what contradicts them takes it away at the same rate, so that neither a knock nor one wrong
# sample stops a robot, and bouncing does.

_FULL = 0.99  #: share of its bound at which a force integral has reached it
_SHARE = 0.2  #: share of a command; a contact that reads less is lost
_LIGHT = 1.0  #: N; what is commanded less cannot be distinguished from nothing
SURE = 0.0025  #: s of evidence, at the least, that one wrong sample does not bring about
#: a joint's time above its limit counts once more for each eighth of it that it is beyond it
_FASTER = 8.0
_MOST = 10.0
_OVERFORCE = 3.0  #: times the command; a contact that reads more is overloaded


@leaf
def watch_joints(t):
    """Joints above their speed limits for too long, or about to run into an end stop; a reason.

    A joint can stop within |q̇|(t_r + |q̇|/(2a)), t_r the time until the brakes are on. One that is
    beyond its end already is left alone: no braking helps there.
    """
    model = t.model
    memory = t.memory
    fast = -1
    near = -1
    times = 1.0
    for j in range(model.n_joints):
        x = t.input.q[j]
        speed = t.input.v[j]
        row = model.joints[j]
        if abs(speed) > times * row.speed_max:
            fast = j
            times = abs(speed) / row.speed_max
        rest = x + speed * (model.reaction + row.brake * abs(speed))
        if (rest > row.upper and x <= row.upper) or (rest < row.lower and x >= row.lower):
            near = j
    weight = 1 + int(_FASTER * min(times - 1.0, _MOST))
    ticks = 1 + memory.gap
    memory.overspeed = max(memory.overspeed + ticks * (weight if fast >= 0 else -1), 0)
    memory.ending = collect(memory.ending, ticks * model.period, near >= 0)
    if memory.ending > max(SURE, 1.5 * model.period):
        memory.culprit = near
        return NEAR_END
    if memory.overspeed > model.fast_ticks:
        memory.culprit = fast
        return OVERSPEED
    return NO_REASON


@inner
def watch_contacts(t):
    """Contacts that take too much power, that are lost, or overloaded; a reason.

    P = Σ α_k (NᵀV_rel)_k over what moves into its face. A contact is lost, or its sensor lies,
    where less than a fifth of its command is read (contact phases see to that where they are on,
    but it must be held again in time), or its force integral stands at its bound. It is overloaded
    above three times its command, or above `contact_force`, whichever is more.
    """
    model = t.model
    work = t.work
    memory = t.memory
    power = 0.0
    reason = NO_REASON
    dt = model.period * (1 + memory.gap)
    for a in range(work.rank):
        alpha = work.alpha_meas[a]
        desired = work.alpha_d[a]
        speed = work.speed[a]
        if alpha > 0.0 and speed > 0.0:
            power += alpha * speed
        row = memory.columns[work.kept[a]]
        size = abs(desired)
        missing = size > _LIGHT and (alpha if desired > 0.0 else -alpha) < _SHARE * size
        missing = missing and model.phased == 0
        if memory.force_rank == work.rank and memory.by_column == 0:
            room = _FULL * integral_room(model.integral_force, desired)
            missing = missing or abs(memory.force_sum[a]) > room
        fair = memory.state == RUN or memory.faults > 0
        row.underforce = collect(row.underforce, dt, missing and fair)
        most = max(_OVERFORCE * size, model.contact_force)
        row.overforce = collect(row.overforce, dt, abs(alpha) > most)
        if row.underforce > model.contact_loss_time or row.time_since_loss > model.regain_time:
            reason = CONTACT_LOST
        elif row.overforce > model.overforce_time:
            reason = OVERFORCE
        if reason != NO_REASON:
            memory.culprit = work.kept[a]
            return reason
    memory.powered = collect(memory.powered, dt, power > model.contact_power)
    if memory.powered > max(SURE, 1.5 * model.period):
        return POWERED
    return NO_REASON


# --- A tick that cannot be computed: repeat, hold the posture, stop -------------------------------
#
# RUN       computed, nothing lost
# DEGRADED  motors at their limits or a singular posture near; or not computed, for a tick or two:
#           the last torques continue
# HOLD      not computed: gravity compensation and damping at the last posture that was read
# SAFE_STOP not computed for too long or too often, a limit of the robot is passed, or a sensor is
#           faulty, see `sensors`: braked to rest, then held; ends by a reset only

_RECENT = 0.5  #: s, of the low-pass of ticks that are not computed: of those of the last second


@inner
def guard(t, reason):
    """The state after this tick, and the torques of one that was not computed; its reason.

    Args:
        reason: of the tick so far.
    """
    model = t.model
    work = t.work
    memory = t.memory
    memory.wrench_age = memory.wrench_age + 1 if memory.wrench_missing else 0
    memory.old_joints = memory.old_joints + 1 if memory.repeated & JOINTS else 0
    memory.old_wrists = memory.old_wrists + 1 if memory.repeated & WRISTS else 0
    cause = check_sensors(t)
    if reason == UNBALANCED:
        isolate_packet(t)
    estimate_joints(t)
    held = 0.0 if reason == NO_REASON else 1.0
    memory.missed += model.period / (_RECENT + model.period) * (held - memory.missed)
    if reason == NO_REASON:
        memory.gap = 0
        _note_accelerations(t)
        memory.has_wrench = 1
        if work.status != SATURATED:  # then the motor limits still have to be met
            count_computed(t)
        memory.repeats = model.repeats if work.status != SATURATED else 0
        fine = work.status == OK and memory.wrench_missing == 0
        _enter(t, RUN if fine else DEGRADED_STATE)
        if cause != NO_REASON:  # these torques still are good: the next tick stops
            memory.cause = cause
            _enter(t, SAFE_STOP)
        return NO_REASON
    memory.gap += 1
    state = SAFE_STOP
    if memory.state != SAFE_STOP:
        memory.faults += 1
        memory.lost += 1
        if cause == NO_REASON:
            cause = MISSED if memory.missed > model.missed_share else reason
        memory.cause = cause
        if memory.lost < model.fault_ticks and cause < LASTING:
            state = HOLD if memory.faults > memory.repeats else DEGRADED_STATE
    _enter(t, state)
    if memory.state == DEGRADED_STATE or memory.compared == 0:
        for i in range(model.n_motors):
            work.tau[i] = memory.torques[i]
    else:
        hold_posture(t)
    return reason


@inner
def _note_accelerations(t):
    """Keep what was commanded, and what of it must show in joints whose readings stand still."""
    for k in range(t.model.n_arms):
        arm = t.model.arms[k]
        for j in range(arm.first, arm.end):
            known = t.memory.joints[j]
            known.acceleration = t.work.joints[j].acceleration
            known.driven = 1 if known.rested > 0.0 and must_move(t, j) else 0


@leaf
def count_computed(t):
    """Note that a tick was computed: no faults in a row, one less among the last ones."""
    memory = t.memory
    memory.faults = 0
    memory.lost = max(memory.lost - 1, 0)


@inner
def _enter(t, state):
    memory = t.memory
    if memory.state == state:
        memory.age += 1
        return
    if state >= HOLD and memory.state < HOLD:
        memory.settled = 0
        for k in range(t.model.n_arms):
            memory.arms[k].weighed = 0
    memory.state = state
    memory.age = 1
