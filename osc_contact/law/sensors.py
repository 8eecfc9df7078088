"""Detection of sensor faults after each tick, computed or not; a fault stops the arms.

Detected are encoders that are constant although their joints are driven, speeds that contradict the
positions or their changes, and constant readings of wrists or of whole packets. Evidence is
measured in time between readings, so that lost packets do not reduce it. `plausibility` checks
readings before a tick, `agreement` during it; `isolation` determines the faulty reading of a joint
and the estimates with which the joint is braked.
"""

from __future__ import annotations

from math import isfinite

from osc_contact.law.isolation import BLIND, DEAD, isolate_joint
from osc_contact.law.jit import inner, leaf
from osc_contact.law.plausibility import find_jumps, is_measurable
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    FAULTY_POSITION,
    FAULTY_SPEED,
    JOINTS,
    NOT_BARRED,
    SAFE_STOP,
    SETTLED,
    WRISTS,
)
from osc_contact.law.vectors import clamped

STUCK = declare_reason(
    "STUCK",
    55,
    "the encoder of joint {joint} reads the very same though it was commanded to gain "
    "{safety.stuck_speed:g} of its speed limit, by more torque than friction takes",
)
FROZEN = declare_reason(
    "FROZEN",
    56,
    "the readings of all joints are the very same for {safety.frozen_time:g} s, and were noisy "
    "before: a packet repeats itself",
)
WRIST_FROZEN = declare_reason(
    "WRIST_FROZEN",
    57,
    "the wrist of arm '{arm}' reads the very same for {safety.frozen_time:g} s: it is dead, or "
    "its last reading repeats itself. Sensors too coarse to show any noise take frozen_time = "
    "inf",
)
DISAGREE = declare_reason(
    "DISAGREE",
    58,
    "the speed of joint {joint} is not that of its positions: they differ by more than "
    "{safety.speed_error:g} of its speed limit, or positions drift by more than "
    "{safety.position_drift:g} rad or m from what speeds add up to",
)
MIXED = declare_reason(
    "MIXED",
    61,
    "joint {joint} and others jump in one packet and stay there: encoders of joints or arms are "
    "swapped, speeds are mirrored or dead, or the packet is that of another robot",
)

_GAIN = 0.21  #: largest evidence of one tick, as a share of `stuck_speed`: slow encoders repeat
_LAG = 0.02  #: s, time constant of the low-pass of errors of speeds
_FORGET = 0.5  #: s, time constant with which the drift between positions and speeds is forgotten
_SCALE = 0.05  #: possible error of a speed's scale
_LATE = 0.01  #: s, possible delay of speeds
_RESOLUTION = 4e-4  #: rad, m, resolution of a coarse encoder (14 bits)
_MODEL = 0.1  #: s, time constant of the predictions of speeds from commanded accelerations
_HELD = 0.05  #: share of a motor's torque limit that dry friction may hold
_LITTLE = 0.002  #: the same beside twice the friction that a joint's motion has shown
_SLID = 0.1  #: s of motion after which a joint has shown its friction
_FINE = 1e-9  #: rad, m, change of a position below which it is rounding
_TURNING = 0.1  #: s, time constant of the share of changes that reverse the one before
_NOISY = 0.2  #: share of reversals above which a position is noisy; pure noise has two thirds
# Share of readings that change a position, above which their noise cannot end. Positions that only
# change between two steps of coarse encoders change less and less as the arms come to rest.
_LIVELY = 0.5
_SAME = 0.03  #: s for which a stopped joint may have identical positions and a speed
# Holds of stopped joints are moved back and forth, each time for _SETTLES/ω, ω being the
# `hold_rate`. In this time a joint without friction moves 0.8 of the distance, which encoders of 17
# bits and more resolve.
_MOVED = 1.2e-4  #: rad, m, distance between both holds
_SETTLES = 3.0
_CHANGES = 2  #: least number of changes of a reading that follows the hold
_FOLLOWED = 4  #: number of consecutive moves after which a joint must follow the next one, too


@inner
def check_sensors(t):
    """Update the evidence of sensor faults by the readings of this tick; return a reason to stop.

    STUCK: a position is constant while the joint is commanded to gain more than a share of its
    speed limit by more torque than dry friction. DISAGREE: the speed error q̇ − Δq/Δt, low-passed,
    exceeds a share of the limit, or its integral d exceeds `position_drift` and the effects of a
    small error of scale and delay of q̇,

        d ← d + (q̇ − Δq/Δt − d/T) Δt.

    The integral is not checked if speeds are estimated from positions, because it would contain
    lasting errors of the model. WRIST_FROZEN: a wrist in contact is constant for too long. FROZEN:
    the readings of all joints are, which were noisy before; and those of the wrists are, too, or
    the noise was in most readings of the joints. MIXED: several joints jump in one packet.

    Δt is the time since the position was last read. Missing, repeated and implausible readings do
    not change the evidence. If positions of several joints jump in one packet, none of its readings
    is used; if speeds do, none of its speeds.

    Args:
        t: Tick.
    """
    model = t.model
    memory = t.memory
    work = t.work
    q = t.input.q
    v = t.input.v
    reason = NO_REASON
    compared = memory.compared != 0
    culprit = memory.culprit
    dead, same_wrenches = _check_wrists(t)
    if dead >= 0:
        reason = WRIST_FROZEN
        culprit = dead
    if work.looked == 0:  # `check_readings` has not called it
        find_jumps(t)
    work.looked = 0
    several = work.jumps > 1
    speeds_jump = work.speed_jumps > 1
    fresh = memory.repeated & JOINTS == 0 and not several
    if (several or speeds_jump) and memory.mixed > BLIND:
        reason = MIXED
        culprit = work.jumped if several else work.speed_jumped
    complete = fresh
    same_joints = compared
    elapsed = model.period
    shares = _shares(elapsed)
    changed = 0
    for j in range(model.n_joints):
        known = memory.joints[j]
        joint = model.joints[j]
        known.pending += known.acceleration * model.period
        read = fresh and isfinite(q[j]) and known.barred == NOT_BARRED
        credible = fresh and abs(v[j]) <= model.plausible_speed * joint.rated and not speeds_jump
        complete = complete and read
        if read:
            step = q[j] - known.q
            if elapsed != model.period * (1 + known.unread_q):
                elapsed = model.period * (1 + known.unread_q)
                shares = _shares(elapsed)
            changed += 1 if step != 0.0 else 0
            same_joints = same_joints and step == 0.0 and credible and v[j] == known.v
            if compared and credible:
                found = _check_joint(t, known, joint.speed_max, step, v[j], elapsed, shares)
                if found != NO_REASON:
                    reason = found
                    culprit = j
                    isolate_joint(t, j)
            known.q = q[j]
            known.pending = 0.0
        if credible:
            known.v = v[j]
            if not compared:
                known.model_v = known.model_q = v[j]
        known.unread_q = 0 if read else known.unread_q + 1
        known.unread_v = 0 if credible else known.unread_v + 1
    if complete:
        memory.compared = 1
        if not same_joints:
            span = memory.still + elapsed
            share = changed * elapsed / (model.n_joints * span)
            memory.lively += span / (_TURNING + span) * (share - memory.lively)
        memory.still = memory.still + elapsed if same_joints else 0.0
        memory.frozen = memory.frozen + elapsed if same_joints and same_wrenches else 0.0
        for j in range(model.n_joints if memory.still > model.frozen_time else 0):
            if abs(memory.joints[j].v) * memory.still > _RESOLUTION:
                reason = DISAGREE
                culprit = j
        silent = memory.still > model.frozen_time and memory.lively > _LIVELY
        if (silent or memory.frozen > model.frozen_time) and _were_noisy(t):
            reason = FROZEN
        if memory.state == SAFE_STOP and memory.settled == SETTLED:
            _test_encoders(t, elapsed)
    dead_packet = reason in (STUCK, DISAGREE, FROZEN) and complete and memory.still > DEAD
    for j in range(model.n_joints if dead_packet or reason == MIXED else 0):
        memory.joints[j].faulty |= FAULTY_SPEED
        if dead_packet or several:
            memory.joints[j].faulty |= FAULTY_POSITION
    if memory.state != SAFE_STOP:  # the cause of a stop keeps its culprit
        memory.culprit = culprit
    return reason


@leaf
def _shares(dt):
    """Compute the shares dt/(T + dt) of one step in the low-passes of a joint's evidence.

    Args:
        dt: step (s).

    Returns:
        Shares for predictions of speeds (T = `_MODEL`), errors of speeds (`_LAG`) and reversals
        (`_TURNING`).
    """
    return dt / (_MODEL + dt), dt / (_LAG + dt), dt / (_TURNING + dt)


@leaf
def _check_joint(t, known, limit, step, v, dt, shares):
    """Update the evidence of faults of a joint by a new reading of its position and speed.

    Args:
        t: Tick. known: JOINT_MEMORY, changed. limit: speed limit (rad/s, m/s). step: change of the
            position since it was last read (rad, m). v: speed read (rad/s, m/s). dt: time since the
            position was last read (s). shares: shares of dt in the low-passes of predictions,
            errors and reversals (dt/(T + dt), T their time constants).

    Returns:
        `STUCK` if the joint does not follow commands, `DISAGREE` if position and speed contradict
        each other, else `NO_REASON`.
    """
    model = t.model
    k, lag, turning = shares
    slope = step / dt
    same = v == known.v
    known.same_speed = known.same_speed + dt if same else 0.0
    known.moved = known.moved + step if same else 0.0
    known.due = known.due + v * dt if step == 0.0 else 0.0
    known.rested = known.rested + dt if step == 0.0 else 0.0
    gained = min(abs(known.pending), _GAIN * model.stuck_speed * limit)
    if step != 0.0:
        known.gained = 0.0
        known.changes += 1
    elif known.driven:
        known.gained += gained
    if v != 0.0 or (same and step != 0.0):
        known.halted = 0.0
    elif not same:
        known.halted = abs(known.v) / dt
    if abs(step) > _FINE:
        back = 1.0 if step * known.step < 0.0 else 0.0
        known.turning += turning * (back - known.turning)
        known.step = step
    error = clamped(v - slope, 2.0 * limit)
    known.error += lag * (error - known.error)
    kept = 1.0 - min(dt / _FORGET, 1.0)
    drift = (known.drift + error * dt) * kept
    explained = _SCALE * dt * abs(v)
    drift = max(drift - explained, 0.0) if drift > 0.0 else min(drift + explained, 0.0)
    known.drift = drift
    known.model_v += known.pending
    known.model_q += known.pending
    known.surprise_v += lag * (v - known.model_v - known.surprise_v)
    known.surprise_q += lag * (slope - known.model_q - known.surprise_q)
    more = abs(known.surprise_v) - abs(known.surprise_q)
    known.blame = (known.blame + more * dt) * kept
    known.model_v += k * (v - known.model_v)
    known.model_q += k * (slope - known.model_q)
    known.stuck = known.gained > model.stuck_speed * limit
    if known.stuck:
        return STUCK
    constant = min(known.rested, known.same_speed)
    if t.memory.state == SAFE_STOP and constant > _SAME and abs(v) * constant > _RESOLUTION:
        known.stuck = 1
        return DISAGREE
    if abs(known.error) > model.speed_error * limit:
        return DISAGREE
    if t.memory.derived == 0 and abs(drift) > model.position_drift + _LATE * abs(v):
        return DISAGREE
    return NO_REASON


@inner
def _check_wrists(t):
    """Detect wrist sensors whose readings repeat.

    Reads `wrenches` of INPUT; updates `same` and `unread` of the arms and `wrenches` in MEMORY.

    Args:
        t: Tick.

    Returns:
        Index of an arm in contact whose reading has been constant for `frozen_time`, or −1; and
        True if the readings of all wrists equal those of the last tick.
    """
    model = t.model
    memory = t.memory
    last_wrenches = memory.wrenches
    wrenches = t.input.wrenches
    all_same = True
    dead = -1
    fresh = memory.repeated & WRISTS == 0 and memory.wrench_missing == 0
    for k in range(model.n_arms):
        known = memory.arms[k]
        if not (fresh and is_measurable(t, k)):
            known.unread += 1
            all_same = all_same and not (fresh and _exceeds(t, k))
            continue
        same = memory.has_wrench != 0
        for i in range(6):
            same = same and last_wrenches[k, i] == wrenches[k, i]
            last_wrenches[k, i] = wrenches[k, i]
        known.same = known.same + model.period * (1 + known.unread) if same else 0.0
        known.unread = 0
        all_same = all_same and same
        pressed = model.arms[k].sensor_joint >= 0 and memory.engaged != 0 and memory.force_rank > 0
        if pressed and known.same > model.frozen_time:
            dead = k
    return dead, all_same


@leaf
def _exceeds(t, k):
    """Determine whether the reading of a wrist is beyond the range of its sensor; false for NaN.

    Args:
        t: Tick, of which `wrenches` of INPUT are read. k: index of the arm.
    """
    exceeds = False
    for i in range(6):
        most = t.model.force_range if i < 3 else t.model.torque_range
        exceeds = exceeds or abs(t.input.wrenches[k, i]) > most
    return exceeds


@leaf
def _were_noisy(t):
    """Determine whether the positions of all joints were noisy when they last changed.

    Noise shows in the share of changes that reverse the one before (`turning`).

    Args:
        t: Tick.
    """
    noisy = True
    for j in range(t.model.n_joints):
        if t.memory.joints[j].turning <= _NOISY:
            noisy = False
            break
    return noisy


@inner
def _test_encoders(t, dt):
    """Move the holds of stopped joints back and forth, and mark encoders that stop following.

    A constant reading alone does not prove a fault, since errors of gravity and friction may keep a
    joint at rest beside its hold. The encoder of a joint that has followed several moves of the
    hold, and is constant during the next one, is dead. A joint that is blocked by friction or by a
    contact never follows; it remains at rest even if its encoder is dead.

    Args:
        t: Tick. dt: time since the last readings (s).
    """
    memory = t.memory
    memory.tested += dt
    if memory.tested * t.model.hold_rate < _SETTLES:
        return
    memory.above = 1 - memory.above
    for j in range(t.model.n_joints):
        known = memory.joints[j]
        went = known.q - known.begun
        if known.changes == 0 and known.followed >= _FOLLOWED:
            known.faulty |= FAULTY_POSITION
            if memory.derived or known.same_speed >= memory.tested:
                known.faulty |= FAULTY_SPEED
        follows = known.changes >= _CHANGES and went * known.went < 0.0
        known.followed = min(known.followed + 1, _FOLLOWED) if follows else 0
        known.went = went
        known.begun = known.q
        known.changes = 0
        known.hold += _MOVED if memory.above else -_MOVED
    memory.tested = 0.0


@inner
def stop_at_once(t):
    """Determine whether constant readings of all joints began with a stop no friction can cause.

    The deceleration of some joint from one packet to the next then needs more than twice the torque
    of unknown friction (`_HELD` times the motor limit, and its known friction).

    Args:
        t: Tick, of which `still`, and `halted` of the joints in MEMORY are read, and M.
    """
    if t.memory.still <= DEAD:
        return False
    found = False
    for k in range(t.model.n_arms):
        arm = t.model.arms[k]
        for j in range(arm.first, arm.end):
            halted = t.memory.joints[j].halted
            if halted > 0.0 and t.model.joints[j].motor >= 0:
                most = 2.0 * (_dry_friction_bound(t, j) + _HELD * t.model.joints[j].tau_max)
                found = found or t.work.joints[j].M[j - arm.first] * halted > most
    return found


@leaf
def _dry_friction_bound(t, j):
    """Bound the dry friction of a joint from above by twice its known value.

    The known value is the larger one of the model's and the estimated one. It is doubled because it
    may also be compensated with the wrong sign.

    Args:
        t: Tick. j: index of the joint.

    Returns:
        Torque or force (N m, N).
    """
    return 2.0 * max(t.model.joints[j].theta[0], t.memory.joints[j].trusted[0])


@leaf
def exceeds_dry_friction(t, j):
    """Whether the commanded acceleration of joint j needs more torque than dry friction holds.

    Unknown friction is assumed to hold `_HELD` times the motor's limit. If the readings of all
    joints have been constant for `DEAD`, either friction holds the arm or the encoders are dead;
    for a joint that has moved, friction is then limited to twice the value shown by that motion.

    Args:
        t: Tick. j: index of the joint.

    Returns:
        True if the joint has to move under the command, whatever its dry friction.
    """
    joint = t.model.joints[j]
    own = t.work.joints[j]
    known = t.memory.joints[j]
    most = _dry_friction_bound(t, j)
    if joint.motor >= 0:
        held = _HELD * joint.tau_max
        if t.memory.still > DEAD and known.slid > _SLID:
            held = min(held, 2.0 * known.rubbed + _LITTLE * joint.tau_max)
        most += held
    return abs(own.inertial - own.h) > most
