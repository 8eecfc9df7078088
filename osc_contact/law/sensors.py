"""Sensor fault detection: before a tick, during it and after it.

Before: a rotation that is none, wrenches beyond what the sensors measure, joints that jump,
wrenches too old. Such a tick is not computed, see `safety`; the next one may be.
During: speeds of an approach, which may read too little; wrists that motor torques contradict;
arms whose encoders place the object they hold at different places.
After, computed or not: encoders that stand still though their joints are pushed, speeds that are
not those of the positions or do not add up to them, wrists and packets that repeat themselves. The
arms are stopped. Evidence counts the time since a reading, so that lost packets take none away.

A fault is also isolated: which of a joint's two readings is wrong decides with which it is braked,
see `estimate_joints`.
"""

from __future__ import annotations

from math import isfinite, sqrt

from osc_contact.law.arm_motion import place_point
from osc_contact.law.commands import pose_error
from osc_contact.law.jit import inner, leaf
from osc_contact.law.joint_friction import SPEED, V, observe_arm
from osc_contact.law.phases import APPROACHING, collect
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    FAULTY_POSITION,
    FAULTY_SPEED,
    JOINTS,
    OTHER,
    OUTDATED,
    SAFE_STOP,
    WRISTS,
    contact_of,
)
from osc_contact.law.vectors import (
    clamped,
    cross,
    dot3,
    dot6,
    fill,
    minus3,
    origin,
    scaled,
    transformed,
)

NO_ROTATION = declare_reason(
    "NO_ROTATION",
    14,
    "reference X_WD: its rotation is none (R Rᵀ = 1 and det R = 1 are missed by more than 1e-4)",
)
OUT_OF_RANGE = declare_reason(
    "OUT_OF_RANGE",
    15,
    "the wrist of arm '{arm}' reads more than it measures (force_range = {head.force_range:g} "
    "N, torque_range = {head.torque_range:g} N m)",
)
JUMPED = declare_reason(
    "JUMPED",
    16,
    "joint {joint} jumps: it reads faster than plausible_speed = {safety.plausible_speed:g} "
    "times its speed limit of {speed:.4g} rad/s or m/s",
)
WRENCH_TIMEOUT = declare_reason(
    "WRENCH_TIMEOUT",
    17,
    "no wrench was read for longer than wrench_timeout = {safety.wrench_timeout:g} s",
)
STALE = declare_reason(
    "STALE",
    18,
    "nothing newer than the last readings of joints or wrists came for longer than "
    "wrench_timeout = {safety.wrench_timeout:g} s; check the sensors' rate and the network",
)
OUT_OF_ORDER = declare_reason(
    "OUT_OF_ORDER",
    19,
    "a packet came after a newer one; it is not used. Read packets in the order of their numbers",
)
SPEEDS_JUMPED = declare_reason(
    "SPEEDS_JUMPED",
    20,
    "the speeds of joint {joint} and of others jump in one packet by more than speed_error = "
    "{safety.speed_error:g} of their limits",
)
STUCK = declare_reason(
    "STUCK",
    55,
    "the encoder of joint {joint} reads the very same though it was commanded to gain "
    "{safety.stuck_speed:g} of its speed limit, by more torque than friction takes",
)
FROZEN = declare_reason(
    "FROZEN",
    56,
    "all readings are the very same for {safety.frozen_time:g} s, and were noisy before: a packet "
    "repeats itself",
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
UNBALANCED = declare_reason(
    "UNBALANCED",
    59,
    "the motor torques of arm '{arm}' contradict its wrist by more than wrist_error = "
    "{safety.wrist_error:g} of their limits: the sensor's sign, scale, offset, frame or arm is "
    "wrong, or the masses of the links, or a joint rubs",
)
APART = declare_reason(
    "APART",
    60,
    "arm '{arm}' is more than closure_error = {closure_mm:g} mm away from where the others "
    "hold the object: an encoder is wrong, those of two arms are swapped, or a grasp has "
    "slipped",
)

MIXED = declare_reason(
    "MIXED",
    61,
    "joint {joint} and others jump in one packet and stay there: encoders of joints or arms are "
    "swapped, speeds are mirrored or dead, or the packet is that of another robot",
)

_ROUND = 1e-4  #: by how much the rows of a rotation may differ from orthonormal ones
_GAIN = 0.21  #: share of `stuck_speed` that one tick can show: slow encoders repeat readings
_LAG = 0.02  #: s, of the low-pass of speeds that disagree
_NOISE = 0.02  #: rad, m: joints may jump by as much, whatever their speed limits
_FORGET = 0.5  #: s in which a drift between positions and speeds is forgotten
_SCALE = 0.05  #: share of a speed by which it may be wrong
_LATE = 0.01  #: s by which speeds may be late
_GONE = 0.25  #: of `position_drift`; a joint must show so much of a speed that lasts
_RESOLUTION = 4e-4  #: rad, m: of a coarse encoder (14 bits); joints that read the same move less
_AGREE = 0.2  #: of the speed of an approach, by which speeds may read less than positions show
_MODEL = 0.1  #: s for which a speed is predicted from accelerations, to see what reading is wrong
_DEAD = 0.01  #: s of the very same readings after which a stuck joint is one of a dead packet
_SLOPE = 0.005  #: s, of the filter of a speed that only positions show
_BALANCE = 0.04  #: s, of the low-pass of torques that nothing explains
_USUAL = 1.0  #: s in which an unexplained torque becomes the usual one
_UNBALANCED = 0.1  #: s for which torques may be unexplained
_DOUBTFUL = 0.5  #: of their bound; nothing is learned of more, within the next
_DOUBTED = 0.2  #: s
_OUTLIER = 10.0  #: times their bound; no more of unexplained torques counts in one tick
_RUBBING = 2e-3  #: rad/s, m/s; joints that are faster than this rub
_RUBS = 0.5  #: of the friction that the model has, which may be wrong
_APART = 0.01  #: s for which arms may hold the object at different places
_BLIND = 0.01  #: s without a sound reading from which on a joint cannot be braked
_HELD = 0.05  #: of a motor's torque limit; dry friction may hold a joint against so much
_FINE = 1e-9  #: rad, m; smaller changes of a position are rounding, not noise
_TURNING = 0.1  #: s, of the low-pass of changes that turn back
_NOISY = 0.2  #: of the changes; where so many turn back a position is noisy: of noise 2 of 3 do
_SAME = 0.03  #: s for which a stopped joint may read the very same position and a speed
# Holds of stopped joints are moved to and fro, each time for _SETTLES/ω, ω the `hold_rate`: a
# joint without friction then has gone 0.8 of the way. Encoders of 17 bits and more show that.
_MOVED = 1.2e-4  #: rad, m
_SETTLES = 3.0
_CHANGES = 2  #: at the least, of a reading that follows
_FOLLOWED = 4  #: times; a joint that follows so often will follow again


@inner
def check_readings(t):
    """Whether readings and reference are credible; a reason."""
    model = t.model
    table = model.joints
    memory = t.memory
    if not _is_rotation(t.input.X_WD):
        return NO_ROTATION
    if memory.wrench_missing:
        if memory.has_wrench == 0 or (memory.wrench_age + 1) * model.period > model.wrench_timeout:
            return WRENCH_TIMEOUT
    else:
        for k in range(model.n_arms):
            if model.arms[k].sensor_joint >= 0 and not _measurable(t, k):
                memory.culprit = k
                return OUT_OF_RANGE
    if memory.repeated & OUTDATED:
        return OUT_OF_ORDER
    for mark, age in ((JOINTS, memory.old_joints), (WRISTS, memory.old_wrists)):
        if memory.repeated & mark and (age + 1) * model.period > model.wrench_timeout:
            return STALE
    count = 0
    last = 0
    for j in range(model.n_joints):
        fast = abs(t.input.v[j]) > model.plausible_speed * table[j].rated
        if fast or (memory.compared and jumped(t, j, t.input.q[j])):
            memory.culprit = j
            return JUMPED
        if memory.compared and speed_jumped(t, j):
            count += 1
            last = j
    if count > 1:
        memory.culprit = last
        return SPEEDS_JUMPED
    return NO_REASON


@leaf
def jumped(t, j, now):
    """Whether joint j has moved faster than it can since its position was read last.

    After a jump its readings are compared with its predicted position: they do not become
    plausible by waiting.

    Args:
        j: joint. now: its position as read at this tick (m, rad).
    """
    known = t.memory.joints[j]
    room = t.model.plausible_speed * t.model.joints[j].rated * t.model.period
    if known.barred:
        return abs(now - t.memory.q[j]) > _NOISE + room
    return abs(now - known.q) > _NOISE + room * (1 + known.unread_q)


@leaf
def speed_jumped(t, j):
    """Whether the speed of joint j lies neither at the last one nor on the way that is commanded.

    A joint that is held, or whose motor gives less than it should, changes less than commanded.
    Speeds that are estimated from positions jump with these.

    Args:
        j: joint.
    """
    known = t.memory.joints[j]
    room = t.model.speed_error * t.model.joints[j].speed_max * (1 + known.unread_q)
    last = t.memory.v[j]
    follows = last + known.acceleration * t.model.period
    now = t.input.v[j]
    jumps = now < min(last, follows) - room or now > max(last, follows) + room
    return t.memory.derived == 0 and jumps


@leaf
def _measurable(t, k):
    """Whether the reading of wrist k is finite and within the range of its sensor."""
    fits = True
    for i in range(6):
        fits = fits and abs(t.input.wrenches[k, i]) <= (
            t.model.force_range if i < 3 else t.model.torque_range
        )
    return fits


@leaf
def _exceeds(t, k):
    """Whether the reading of wrist k is there, and beyond the range of its sensor."""
    exceeds = False
    for i in range(6):
        most = t.model.force_range if i < 3 else t.model.torque_range
        exceeds = exceeds or abs(t.input.wrenches[k, i]) > most
    return exceeds


@leaf
def _is_rotation(X):
    """R Rᵀ = 1 and det R = 1, but for `_ROUND`."""
    worst = 0.0
    for i in range(3):
        for j in range(i + 1):
            worst = max(worst, abs(dot3(X[i], X[j]) - (1.0 if i == j else 0.0)))
    return worst < _ROUND and dot3(cross(X[0], X[1]), X[2]) > 0.0


@inner
def compare_speeds(t):
    """Approaches use speeds from positions, low-passed, where NᵀV_rel is less than they show.

    Speeds that read too little would drive an object into its face ever faster. The twist that
    positions show is that from the last tick's X_WO to this one's.
    """
    memory = t.memory
    work = t.work
    V = work.y
    dt = t.model.period * (1 + memory.gap)
    k = dt / (_LAG + dt)
    fill(V, scaled(1.0 / dt, pose_error(work.X_WO, memory.X_WO)))
    for a in range(work.rank):
        j = work.kept[a]
        row = memory.columns[j]
        speed = work.speed[a]
        if row.known == 0 or memory.compared == 0:
            row.velocity_from_positions = row.velocity_from_encoders = speed
            continue
        shown = dot6(work.columns[j].N, V) - work.V_N[a]
        row.velocity_from_positions += k * (shown - row.velocity_from_positions)
        row.velocity_from_encoders += k * (speed - row.velocity_from_encoders)
        short = row.velocity_from_positions - row.velocity_from_encoders
        approached = contact_of(t, j).phase == APPROACHING
        if approached and short > _AGREE * t.model.approach_speed:
            work.speed[a] = max(speed, row.velocity_from_positions)


@inner
def check_arms(t):
    """Whether motors, wrists and encoders of the arms fit together; a reason to stop.

    The residual of the motors less friction, of either sign, must stay within `wrist_error`
    of the torque limit, as far as it is not the usual one, and within twice that, see
    `joint_friction`.
    """
    model = t.model
    memory = t.memory
    dt = model.period * (1 + max(memory.gap, memory.wrench_age))
    apart = _find_apart(t)
    memory.apart = collect(memory.apart, dt, apart >= 0)
    if apart >= 0 and memory.apart > _APART:
        memory.culprit = apart
        return APART
    if memory.wrench_missing or memory.ticked == 0:
        return NO_REASON
    memory.balanced += 1
    memory.instant += int(dt / model.period + 0.5)
    for k in range(model.n_arms):
        if model.arms[k].sensor_joint >= 0 and _balance_arm(t, k, dt):
            memory.culprit = k
            return UNBALANCED
    return NO_REASON


@inner
def _balance_arm(t, k, dt):
    """Whether unexplained torques of arm k have been too large for too long, see `check_arms`.

    From half of their bound on they are doubtful: nothing is learned of them, until they have
    lasted for longer than a fault that is found.
    """
    arm = t.model.arms[k]
    own = t.memory.arms[k]
    found = False
    doubtful = False
    observe_arm(t, arm, t.work.arms[k], own.doubtful == 0.0 or own.doubtful > _DOUBTED, dt)
    first = 1.0 / t.memory.balanced  # low-passes begin as plain means
    fast = max(dt / (_BALANCE + dt), first)
    slow = max(dt / (_USUAL + dt), first)
    for j in range(arm.first, arm.sensor_joint + 1):
        known = t.memory.joints[j]
        joint = t.model.joints[j]
        if joint.motor < 0:
            continue
        most = t.model.wrist_error * joint.tau_max
        theta = joint.theta
        speed = abs(known.means[SPEED])
        most += _RUBS * (theta[0] + theta[1] * speed)  # this may be wrong
        if t.memory.friction_known[j]:
            theta = t.memory.friction[j].theta
        for i in range(3):  # slowly: a wrist that is wrong at once is not taken for friction
            known.trusted[i] += slow * (abs(theta[i]) - known.trusted[i])
        friction = known.trusted[0] + known.trusted[1] * speed + known.trusted[2] * abs(known.rate)
        least = _DOUBTFUL * most
        if known.means[V] * known.unexplained > _RUBBING * abs(known.unexplained):
            most *= 2.0  # it brakes the joint, as friction does that is not learned yet
        rest = known.residual - clamped(known.residual, friction)
        known.unexplained += fast * (clamped(rest, _OUTLIER * most) - known.unexplained)
        rest = known.unexplained
        known.usual += slow * (rest - known.usual)
        unusual = abs(rest - known.usual)
        doubtful = doubtful or unusual > least
        too_much = unusual > most or abs(rest) > 2.0 * most
        known.unbalanced = collect(known.unbalanced, dt, too_much)
        found = found or known.unbalanced > _UNBALANCED
    own.doubtful = collect(own.doubtful, dt, doubtful)
    return found


@leaf
def _find_apart(t):
    """An arm whose tip is further from where the object has it than `closure_error`, or −1."""
    model = t.model
    X = t.work.X_WO
    apart = -1
    for k in range(model.n_arms if model.n_arms > 1 else 0):
        arm = model.arms[k]
        tip = place_point(t.work.joints[arm.tip_joint], arm.tip[9:])
        gap = transformed(minus3(origin(X), tip), X, arm.point)
        if arm.kind != OTHER and sqrt(dot3(gap, gap)) > model.closure_error:
            apart = k
    return apart


@inner
def check_sensors(t):
    """What this tick's readings show of the sensors; a reason to stop.

    A joint whose encoder reads the very same while it is commanded to gain more than a share of
    its speed limit, by more torque than dry friction may take, is stuck. Speeds disagree with
    positions where q̇ − Δq/Δt, low-passed, is more than a share of the limit. Wrists in contact that
    read the same for too long are frozen; where all readings do that were noisy before, a packet
    repeats itself. What both add up to drifts apart,

        d ← d + (q̇ − Δq/Δt − d/T) Δt,

    where |d| is more than `position_drift` and what a small error of scale and delay of q̇ explain;
    not where speeds are estimated from positions, whose errors last as long as those of the model.
    Δt is the time since the position was read last; readings that are not there, repeated or not
    credible leave the evidence as it is. Where positions of several joints jump in one packet none
    of its readings is credible; where speeds do, none of its speeds.
    """
    model = t.model
    memory = t.memory
    q = t.input.q
    v = t.input.v
    reason = NO_REASON
    compared = memory.compared != 0
    culprit = memory.culprit
    dead, same_wrenches = _check_wrists(t)
    if dead >= 0:
        reason = WRIST_FROZEN
        culprit = dead
    fresh = memory.repeated & JOINTS == 0
    jumps, speeds_jump = _find_jumps(t) if fresh and compared else (-1, -1)
    fresh = fresh and jumps < 0
    if max(jumps, speeds_jump) >= 0 and memory.mixed > _BLIND:
        reason = MIXED
        culprit = max(jumps, speeds_jump)
    complete = fresh
    same_joints = compared
    elapsed = 0.0
    for j in range(model.n_joints):
        known = memory.joints[j]
        joint = model.joints[j]
        known.pending += known.acceleration * model.period
        read = fresh and isfinite(q[j]) and known.barred == 0
        credible = fresh and abs(v[j]) <= model.plausible_speed * joint.rated and speeds_jump < 0
        complete = complete and read
        if read:
            step = q[j] - known.q
            elapsed = model.period * (1 + known.unread_q)
            same_joints = same_joints and step == 0.0 and credible and v[j] == known.v
            if compared and credible:
                found = _check_joint(t, known, joint.speed_max, step, v[j], elapsed)
                if found != NO_REASON:
                    reason = found
                    culprit = j
                    _isolate(t, j)
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
        memory.still = memory.still + elapsed if same_joints else 0.0
        memory.frozen = memory.frozen + elapsed if same_joints and same_wrenches else 0.0
        for j in range(model.n_joints if memory.still > model.frozen_time else 0):
            if abs(memory.joints[j].v) * memory.still > _RESOLUTION:
                reason = DISAGREE
                culprit = j
        if memory.frozen > model.frozen_time and _were_noisy(t):
            reason = FROZEN
        if memory.state == SAFE_STOP and memory.settled:
            _test_encoders(t, elapsed)
    dead_packet = reason in (STUCK, DISAGREE, FROZEN) and complete and memory.still > _DEAD
    for j in range(model.n_joints if dead_packet or reason == MIXED else 0):
        memory.joints[j].faulty |= FAULTY_SPEED
        if dead_packet or jumps >= 0:
            memory.joints[j].faulty |= FAULTY_POSITION
    if memory.state != SAFE_STOP:  # the cause of a stop keeps what it is about
        memory.culprit = culprit
    return reason


@inner
def _find_jumps(t):
    """A joint whose position jumps in this packet as another's does, and one whose speed does; −1.

    Also for how long there was one. One that jumps alone has lost its own reading only.
    """
    memory = t.memory
    joint = -1
    speed = -1
    read = 0
    jumps = 0
    speeds_jump = 0
    for j in range(t.model.n_joints):
        if not isfinite(t.input.q[j]):
            continue
        read += 1
        jumps_here = jumped(t, j, t.input.q[j])
        memory.joints[j].barred = 1 if jumps_here else 0
        if jumps_here:
            jumps += 1
            joint = j
        if speed_jumped(t, j):
            speeds_jump += 1
            speed = j
    joint = joint if jumps > 1 else -1
    speed = speed if speeds_jump > 1 else -1
    if joint >= 0 or speed >= 0 or (read == 0 and memory.mixed > 0.0):
        memory.mixed += t.model.period
    else:
        memory.mixed = 0.0
    return joint, speed


@leaf
def _were_noisy(t):
    """Whether the positions of all joints have shown noise, as they last changed."""
    noisy = True
    for j in range(t.model.n_joints):
        noisy = noisy and t.memory.joints[j].turning > _NOISY
    return noisy


@inner
def _test_encoders(t, dt):
    """Move the holds of stopped joints, and note which encoder does not show it any more.

    What a hold commands is no evidence: wrong gravity and friction keep a joint at rest beside its
    hold for ever. A joint that has followed the hold to and fro, and does not change its reading
    now, is one whose encoder is dead. One that friction or a contact holds never follows; with
    its encoder dead it stays where it is.

    Args:
        dt: s since the last readings.
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


@leaf
def must_move(t, arm, j):
    """Whether the acceleration commanded to a joint takes more torque than dry friction may.

    Args:
        arm: ARM. j: of its joints.
    """
    joint = t.model.joints[j]
    known = t.memory.joints[j]
    push = 0.0
    for i in range(arm.first, arm.end):
        push += t.work.joints[j].M[i - arm.first] * t.work.joints[i].acceleration
    most = 2.0 * max(joint.theta[0], known.trusted[0])  # compensated along the wrong way, too
    most += _HELD * joint.tau_max if joint.motor >= 0 else 0.0
    return abs(push) > most


@inner
def _check_wrists(t):
    """The arm whose wrist has read the very same in contact for too long, or −1; whether all do."""
    model = t.model
    memory = t.memory
    last_wrenches = memory.wrenches
    wrenches = t.input.wrenches
    all_same = True
    dead = -1
    fresh = memory.repeated & WRISTS == 0 and memory.wrench_missing == 0
    for k in range(model.n_arms):
        known = memory.arms[k]
        if not (fresh and _measurable(t, k)):
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
def _check_joint(t, known, limit, step, v, dt):
    """Evidence from one reading of a joint; a reason.

    Args:
        known: JOINT_MEMORY. limit: of its speed. step: by how much the position differs
        from the last one read. v: speed read. dt: s since the position was read last.
    """
    model = t.model
    slope = step / dt
    same = v == known.v
    known.same_speed = known.same_speed + dt if same else 0.0
    known.moved = known.moved + step if same else 0.0
    known.due = known.due + v * dt if step == 0.0 else 0.0
    known.rested = known.rested + dt if step == 0.0 else 0.0
    gained = min(abs(known.pending), _GAIN * model.stuck_speed * limit)
    if step != 0.0:
        known.gained = 0.0
    elif known.driven:
        known.gained += gained
    if step != 0.0:
        known.changes += 1
    if abs(step) > _FINE:
        back = 1.0 if step * known.step < 0.0 else 0.0
        known.turning += dt / (_TURNING + dt) * (back - known.turning)
        known.step = step
    error = clamped(v - slope, 2.0 * limit)
    k = dt / (_MODEL + dt)
    lag = dt / (_LAG + dt)
    known.error += lag * (error - known.error)
    drift = (known.drift + error * dt) * (1.0 - min(dt / _FORGET, 1.0))
    explained = _SCALE * dt * abs(v)
    drift = max(drift - explained, 0.0) if drift > 0.0 else min(drift + explained, 0.0)
    known.drift = drift
    known.model_v += known.pending
    known.model_q += known.pending
    known.surprise_v += lag * (v - known.model_v - known.surprise_v)
    known.surprise_q += lag * (slope - known.model_q - known.surprise_q)
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
def _isolate(t, j):
    """Note which reading of joint j is faulty, where they were found to contradict one another.

    It is one that stands still while the other moves, or the one whose changes the commanded
    accelerations predict less. Speeds come from one estimator for all joints: where those of one
    are faulty, none is used any more.
    """
    joint_memory = t.memory.joints
    known = joint_memory[j]
    most = _GONE * t.model.position_drift
    stuck = abs(known.due) > most or known.stuck != 0
    dead = known.same_speed > _DEAD and (stuck or abs(known.moved) > most)
    if stuck:
        known.faulty |= FAULTY_POSITION
        if dead or t.memory.derived:
            known.faulty |= FAULTY_SPEED
    elif known.faulty == 0:
        if dead or abs(known.surprise_v) > abs(known.surprise_q):
            for i in range(t.model.n_joints):
                if joint_memory[i].faulty == 0:
                    joint_memory[i].faulty = FAULTY_SPEED
        else:
            known.faulty = FAULTY_POSITION


@inner
def isolate_packet(t):
    """Note that no joint is read, where motors contradict a wrist while all joints stand still.

    The torque is more than friction takes: joints that read the very same for as long must move.
    """
    memory = t.memory
    for j in range(t.model.n_joints if memory.still > _UNBALANCED else 0):
        memory.joints[j].faulty = FAULTY_POSITION | FAULTY_SPEED


@inner
def estimate_joints(t):
    """Positions and speeds of the joints from their sound readings, else by prediction.

    A position that is not read, or is faulty, is integrated from the speed; a speed that is not
    read, or is faulty, follows from positions and commanded accelerations. Without either both are
    predicted, and the joint cannot be braked reliably: `memory.unbraked`.
    """
    model = t.model
    table = model.joints
    memory = t.memory
    dt = model.period
    memory.unbraked = -1
    for j in range(model.n_joints):
        known = memory.joints[j]
        use_q = known.faulty & FAULTY_POSITION == 0
        use_v = known.faulty & FAULTY_SPEED == 0
        seen_q = use_q and known.unread_q == 0
        seen_v = use_v and known.unread_v == 0
        v = memory.v[j] + known.acceleration * dt
        if memory.ticked == 0:
            memory.q[j] = known.q
            v = 0.0
        if seen_v:
            v = known.v
        elif seen_q:
            slope = (known.q - memory.q[j]) / dt
            v += (slope - v) * dt / (_SLOPE + dt)
        v = clamped(v, model.plausible_speed * table[j].rated)
        memory.q[j] = known.q if seen_q else memory.q[j] + v * dt
        memory.v[j] = v
        blind_q = not use_q or known.unread_q * dt > _BLIND
        blind_v = not use_v or known.unread_v * dt > _BLIND
        if blind_q and blind_v and table[j].motor >= 0:
            memory.unbraked = j
