"""Detection of sensor faults in each tick, computed or not; a fault stops the arms.

Detected are encoders that are constant although their joints are driven, speeds that contradict the
positions or their changes, constant readings of whole packets, and of wrists (`wrist_readings`).
Evidence is measured in time between readings, so that lost packets do not reduce it.
`plausibility` checks readings before a tick, `agreement` during it; `isolation` determines the
faulty reading of a joint and the estimates with which the joint is braked.
"""

from __future__ import annotations

from math import isfinite

from osc_contact.law.isolation import BLIND_TIME, DEAD, is_constant, isolate_joint
from osc_contact.law.jit import inner, leaf
from osc_contact.law.plausibility import find_jumps
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    FAULTY_POSITION,
    FAULTY_SPEED,
    JOINTS,
    NOISY,
    NOT_BARRED,
    SAFE_STOP,
    SETTLED,
)
from osc_contact.law.vectors import clamped
from osc_contact.law.wrist_readings import check_wrists

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
DISAGREE = declare_reason(
    "DISAGREE",
    58,
    "the speed of joint {joint} is not that of its positions: they differ by more than "
    "{safety.speed_error:g} of its speed limit, or positions drift by more than "
    "{safety.position_drift:g} rad or m from what speeds add up to, or by a quarter of that while "
    "they are constant",
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
_OFFSET = 2e-3  #: rad/s, m/s, possible offset of a speed
_RESOLUTION = 4e-4  #: rad, m, resolution of a coarse encoder (14 bits)
_MODEL = 0.1  #: s, time constant of the predictions of speeds from commanded accelerations
_HELD = 0.05  #: share of a motor's torque limit that dry friction may hold
_LITTLE = 0.002  #: share of it that is added to twice the friction that a joint's motion has shown
_SLID = 0.1  #: s of motion after which a joint has shown its friction
_SHOWN = 0.4  #: share of the torques by the acceleration of a joint that others must show
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
_AGAIN = 0.0  #: `probed` of a joint whose test begins


@inner
def check_sensors(t):
    """Update the evidence of sensor faults by the readings of this tick; return a reason to stop.

    STUCK: a position is constant while the joint is commanded to gain more than a share of its
    speed limit by more torque than dry friction. DISAGREE: the speed error q̇ − Δq/Δt, low-passed,
    exceeds a share of the limit, or its integral d exceeds `position_drift` and the effects of a
    small error of scale and delay of q̇,

        d ← d + (q̇ − Δq/Δt − d/T) Δt

    with the position q, the speed q̇ that was read, and the time T = `_FORGET` of forgetting; or the
    position is constant while the joint moves by its speeds (`_creeps`). Neither is checked if
    speeds are estimated from positions, whose integral would contain lasting errors of the
    model. WRIST_FROZEN: a wrist in contact is constant for too long;
    WRIST_SATURATED: one of its six numbers is. FROZEN: the readings of all joints are, which were
    noisy before (`_check_packet`). MIXED: several joints jump in each packet for `BLIND_TIME`.

    A later reason replaces an earlier one: wrists, jumps, joints, packet. If a joint is at fault
    while all joints have read the same for `DEAD`, the packet is dead, and all joints are faulty.

    Δt is the time since the position was last read. Missing, repeated and implausible readings do
    not change the evidence. If positions of several joints jump in one packet, none of its readings
    is used; if speeds do, none of its speeds. Updates the fields of the functions called here;
    fills `culprit` of MEMORY (arm or joint), except in a stop, whose cause keeps its own.

    Args:
        t: Tick.
    """
    memory = t.memory
    work = t.work
    reason = NO_REASON
    culprit = memory.culprit
    if memory.derived == NOISY:
        _discard_marks(t)
    wrist_reason, arm, same_wrenches = check_wrists(t)
    if wrist_reason != NO_REASON:
        reason = wrist_reason
        culprit = arm
    jump_reason, jumped = _check_jumps(t)
    if jump_reason != NO_REASON:
        reason = jump_reason
        culprit = jumped
    positions_jump = work.jumps > 1
    is_new = memory.repeated & JOINTS == 0 and not positions_jump
    joint_reason, faulty_joint, is_complete = _check_joints(t, is_new, same_wrenches)
    if joint_reason != NO_REASON:
        reason = joint_reason
        culprit = faulty_joint
    if is_complete:
        packet_reason, faulty_joint = _check_packet(t)
        if packet_reason != NO_REASON:
            reason = packet_reason
        if faulty_joint >= 0:
            culprit = faulty_joint
    is_dead = reason in (STUCK, DISAGREE, FROZEN) and is_complete and memory.still > DEAD
    if is_dead or reason == MIXED:
        _mark_packet(t, is_dead or positions_jump)
    if memory.state != SAFE_STOP:  # the cause of a stop keeps its culprit
        memory.culprit = culprit
    return reason


@inner
def _check_jumps(t):
    """Return MIXED if readings of several joints have jumped in each packet for `BLIND_TIME`.

    Calls `find_jumps` if that was not called in this tick; sets `looked` of WORK to 0.

    Args:
        t: Tick.

    Returns:
        `MIXED`, and the index of a joint that jumps; or `NO_REASON`, and −1.
    """
    work = t.work
    if work.looked == 0:
        find_jumps(t)
    work.looked = 0
    if max(work.jumps, work.speed_jumps) > 1 and t.memory.mixed > BLIND_TIME:
        return MIXED, work.jumped if work.jumps > 1 else work.speed_jumped
    return NO_REASON, -1


@leaf
def _mark_packet(t, positions_too):
    """Mark the speeds of all joints as faulty, since their packet is dead or mixed.

    Args:
        t: Tick, of which `faulty` of the joints in MEMORY is changed.
        positions_too: whether positions are marked, too.
    """
    for j in range(t.model.n_joints):
        t.memory.joints[j].faulty |= FAULTY_SPEED
        if positions_too:
            t.memory.joints[j].faulty |= FAULTY_POSITION


@leaf
def _discard_marks(t):
    """Trust joints again that were marked as faulty just before encoders were found to be noisy.

    The noise itself has contradicted speeds that were estimated from it with the gains for quiet
    encoders; meanwhile these have been estimated again. Positions that are constant are no noise:
    marks of such a joint stay.

    Args:
        t: Tick, of which `state`, `cause` and `age` of MEMORY are read, and `faulty` of the joints
            in MEMORY is changed.
    """
    memory = t.memory
    is_recent = memory.age * t.model.period < _LAG
    if memory.state == SAFE_STOP and memory.cause == DISAGREE and is_recent:
        for j in range(t.model.n_joints):
            if not is_constant(t, memory.joints[j]):
                memory.joints[j].faulty = 0


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


@inner
def _check_joints(t, is_new, same_wrenches):
    """Update the evidence of faults of all joints by the readings of this tick.

    A position is used if it is finite and not barred by a jump, a speed if it is plausible and no
    speeds of several joints jump (`speed_jumps` of WORK), and if its position is used, too, where
    speeds are estimated from positions (`derived`). Reads q and v of INPUT, and in MEMORY
    `compared`, and `barred` and `acceleration` of the joints; updates their last speed `v`,
    `pending` (speed that was commanded since the position was read), the predictions `model_v` and
    `model_q` at the first reading, `unread_q` and `unread_v` (ticks), and the fields of
    `_check_position` and `_note_packet`.

    Args:
        t: Tick.
        is_new: whether the packet has new readings of joints that can be used.
        same_wrenches: whether the readings of all wrists equal those of the last tick.

    Returns:
        A reason to stop, of the last joint with a fault; the index of this joint, or −1; and
        whether all positions were read.
    """
    model = t.model
    memory = t.memory
    q = t.input.q
    v = t.input.v
    reason = NO_REASON
    faulty_joint = -1
    compared = memory.compared != 0
    speeds_jump = t.work.speed_jumps > 1
    is_complete = is_new
    all_same = compared
    elapsed = model.period
    shares = _shares(elapsed)
    changed = 0
    for j in range(model.n_joints):
        joint_memory = memory.joints[j]
        joint = model.joints[j]
        joint_memory.pending += joint_memory.acceleration * model.period
        # which of its readings can be used
        is_read = is_new and isfinite(q[j]) and joint_memory.barred == NOT_BARRED
        is_credible = is_new and abs(v[j]) <= model.plausible_speed * joint.rated
        # without a position, a speed that is estimated from positions is only a prediction
        is_credible = is_credible and not speeds_jump and (is_read or memory.derived == 0)
        is_complete = is_complete and is_read
        # the position: change since it was read last, and evidence of faults
        if is_read:
            if elapsed != model.period * (1 + joint_memory.unread_q):  # else as of the last joint
                elapsed = model.period * (1 + joint_memory.unread_q)
                shares = _shares(elapsed)
            step, joint_reason = _check_position(t, j, is_credible, elapsed, shares)
            changed += 1 if step != 0.0 else 0
            all_same = all_same and step == 0.0 and is_credible and v[j] == joint_memory.v
            if joint_reason != NO_REASON:
                reason = joint_reason
                faulty_joint = j
        if is_credible:
            joint_memory.v = v[j]
            if not compared:
                joint_memory.model_v = joint_memory.model_q = v[j]
        joint_memory.unread_q = 0 if is_read else joint_memory.unread_q + 1
        joint_memory.unread_v = 0 if is_credible else joint_memory.unread_v + 1
    if is_complete:
        _note_packet(t, all_same, same_wrenches, changed, elapsed)
    return reason, faulty_joint, is_complete


@inner
def _check_position(t, j, is_credible, dt, shares):
    """Check a new position of joint j, and store it as the last one.

    Updates of the joint in MEMORY `q` and `pending` (speed commanded since the position was read,
    0 now), and the fields of `_check_joint`; `faulty` of the joints if a fault is found.

    Args:
        t: Tick, of which q and v of INPUT are read.
        j: index of the joint.
        is_credible: whether its speed can be used, too; otherwise nothing is compared.
        dt: time since the position was last read (s).
        shares: shares of dt in the low-passes, from `_shares`.

    Returns:
        Change of the position since it was last read (rad, m); and the reason of `_check_joint`,
        or `NO_REASON`.
    """
    joint_memory = t.memory.joints[j]
    step = t.input.q[j] - joint_memory.q
    if t.memory.derived and 0.0 < abs(step) < _FINE:  # an estimate of a constant reading is rounded
        joint_memory.changes += 1
        step = 0.0
    reason = NO_REASON
    if t.memory.compared != 0 and is_credible:
        limit = t.model.joints[j].speed_max
        reason = _check_joint(t, joint_memory, limit, step, t.input.v[j], dt, shares)
        if reason != NO_REASON:
            isolate_joint(t, j)
    joint_memory.q = t.input.q[j]
    joint_memory.pending = 0.0
    return step, reason


@inner
def _note_packet(t, all_same, same_wrenches, changed, elapsed):
    """Update the evidence of a repeated packet after a tick in which all positions were read.

    Fills in MEMORY `compared` (1), `lively` (share of readings that change a position, low-passed
    with the time constant `_TURNING`; kept while none does), `still` and `frozen` (s of identical
    readings, of joints, and of joints and wrists). If the arms are stopped and held at rest, their
    encoders are tested by small motions (`_test_encoders`).

    Args:
        t: Tick.
        all_same: whether all positions and speeds equal those of the last packet.
        same_wrenches: whether the readings of all wrists equal those of the last tick.
        changed: number of positions that changed.
        elapsed: time since the last packet (s).
    """
    memory = t.memory
    memory.compared = 1
    if not all_same:  # the readings since the last change count together
        span = memory.still + elapsed
        share = changed * elapsed / (t.model.n_joints * span)
        memory.lively += span / (_TURNING + span) * (share - memory.lively)
    memory.still = memory.still + elapsed if all_same else 0.0
    memory.frozen = memory.frozen + elapsed if all_same and same_wrenches else 0.0
    if memory.state == SAFE_STOP and memory.settled == SETTLED:
        _test_encoders(t, elapsed)


@inner
def _check_packet(t):
    """Return a reason to stop if the readings of all joints have been identical for too long.

    Too long is more than `frozen_time`. DISAGREE: a joint has a speed (rad/s, m/s) by which its
    position would have changed by more than the resolution of encoders in this time. FROZEN, which
    replaces it: the positions of all joints were noisy before; and either the wrists have been
    identical for as long, too, or noise changed more than `_LIVELY` of the readings of joints.

    Args:
        t: Tick after `_note_packet`, of which `still` and `frozen` (s of identical readings of
            joints, and of joints and wrists) and `lively` (share of readings that changed before)
            of MEMORY are read.

    Returns:
        `NO_REASON`, `DISAGREE` or `FROZEN`; and the last joint that shows DISAGREE, or −1.
    """
    model = t.model
    memory = t.memory
    reason = NO_REASON
    faulty_joint = -1
    for j in range(model.n_joints if memory.still > model.frozen_time else 0):
        if abs(memory.joints[j].v) * memory.still > _RESOLUTION:
            reason = DISAGREE
            faulty_joint = j
    is_silent = memory.still > model.frozen_time and memory.lively > _LIVELY
    if (is_silent or memory.frozen > model.frozen_time) and _were_noisy(t):
        reason = FROZEN
    return reason, faulty_joint


@leaf
def _check_joint(t, joint_memory, limit, step, v, dt, shares):
    """Update the evidence of faults of a joint by a new reading of its position and speed.

    Fills of the joint in MEMORY `error` (speed less that of the positions, low-passed; rad/s, m/s),
    `drift` (its integral with forgetting, less the drift that a small error of the speed's scale
    explains; rad, m), `stuck`, and the fields of `_note_changes` and `_compare_with_predictions`.

    Args:
        t: Tick.
        joint_memory: JOINT_MEMORY, changed.
        limit: speed limit (rad/s, m/s).
        step: change of the position since it was last read (rad, m).
        v: speed read (rad/s, m/s).
        dt: time since the position was last read (s).
        shares: shares of dt in the low-passes, from `_shares`.

    Returns:
        `STUCK` if the joint does not follow commands, `DISAGREE` if position and speed contradict
        each other, else `NO_REASON`. It is always `NO_REASON` if speeds are estimated from
        positions that are noisier than expected.
    """
    model = t.model
    slope = step / dt
    _note_changes(t, joint_memory, limit, step, v, dt, shares[2])
    # difference of the speed read and that of the positions: low-passed, and its integral `drift`
    error = clamped(v - slope, 2.0 * limit)
    joint_memory.error += shares[1] * (error - joint_memory.error)
    forgetting = 1.0 - min(dt / _FORGET, 1.0)
    drift = (joint_memory.drift + error * dt) * forgetting
    explained = _SCALE * dt * abs(v)  # by a small error of the speed's scale
    drift = max(drift - explained, 0.0) if drift > 0.0 else min(drift + explained, 0.0)
    joint_memory.drift = drift
    _compare_with_predictions(joint_memory, slope, v, dt, shares, forgetting)
    if t.memory.derived == NOISY:
        return NO_REASON
    # reasons: stuck; constant readings with a speed after a stop; a large error, or drift of it
    joint_memory.stuck = joint_memory.gained > model.stuck_speed * limit
    if joint_memory.stuck:
        return STUCK
    constant = min(joint_memory.rested, joint_memory.same_speed)
    if t.memory.state == SAFE_STOP and constant > _SAME and abs(v) * constant > _RESOLUTION:
        joint_memory.stuck = 1
        return DISAGREE
    if abs(joint_memory.error) > model.speed_error * limit:
        return DISAGREE
    if t.memory.derived == 0 and abs(drift) > model.position_drift + _LATE * abs(v):
        return DISAGREE
    if t.memory.derived == 0 and _creeps(t, joint_memory):
        return DISAGREE
    return NO_REASON


@leaf
def _creeps(t, joint_memory):
    """Test whether a joint moves by its speeds, though its position is constant.

    Speeds since the position last changed add up to more than `is_constant` permits, and go on. A
    joint at rest may have such a sum by the offset `_OFFSET` of its speeds, by their noise, and by
    their delay or low-pass after a sudden stop, which has ended after five times `_LATE`: so their
    mean since then, and their present low-pass, must exceed the offset. `drift` does not find a
    slow joint whose encoder is dead, because it forgets.

    Args:
        t: Tick.
        joint_memory: JOINT_MEMORY, of which `rested` (s), `due` (rad, m) and `error` are read,
            which is the low-passed speed where the position is constant (rad/s, m/s).
    """
    rested = joint_memory.rested
    mean_speed = joint_memory.due / rested if rested > 5.0 * _LATE else 0.0
    if abs(mean_speed) <= _OFFSET or not is_constant(t, joint_memory):
        return False
    return abs(joint_memory.error) > _OFFSET and joint_memory.error / mean_speed > 0.5


@leaf
def _note_changes(t, joint_memory, limit, step, v, dt, share):
    """Update the evidence of a constant position or speed of a joint.

    Fills of the joint in MEMORY, since the speed last changed, the time `same_speed` (s) and the
    displacement `moved` (rad, m); since the position last changed, the time `rested` (s), the
    integral of the speed `due` (rad, m) and the speed `gained` that was commanded while friction
    could not hold the joint (`driven`; rad/s, m/s); the number of changes `changes`; `halted`, the
    deceleration of a change to a speed of 0 that lasts (rad/s², m/s²); of changes larger than
    `_FINE` the last one `step` (rad, m), and the low-passed share `turning` of those that reverse
    the one before.

    Args:
        t: Tick.
        joint_memory: JOINT_MEMORY with the last reading `v`, changed.
        limit: speed limit (rad/s, m/s).
        step: change of the position since it was last read (rad, m).
        v: speed read (rad/s, m/s).
        dt: time since the position was last read (s).
        share: share of dt in the low-pass of reversals.
    """
    same_v = v == joint_memory.v
    # times and displacements since the speed, and since the position, last changed
    joint_memory.same_speed = joint_memory.same_speed + dt if same_v else 0.0
    joint_memory.moved = joint_memory.moved + step if same_v else 0.0
    joint_memory.due = joint_memory.due + v * dt if step == 0.0 else 0.0
    joint_memory.rested = joint_memory.rested + dt if step == 0.0 else 0.0
    # speed that was commanded while the position is constant
    gained = min(abs(joint_memory.pending), _GAIN * t.model.stuck_speed * limit)
    if step != 0.0:
        joint_memory.gained = 0.0
        joint_memory.changes += 1
    elif joint_memory.driven:
        joint_memory.gained += gained
    # deceleration of a change to a speed of 0, and reversals of the position
    if v != 0.0 or (same_v and step != 0.0):
        joint_memory.halted = 0.0
    elif not same_v:
        joint_memory.halted = abs(joint_memory.v) / dt
    if abs(step) > _FINE:
        reversal = 1.0 if step * joint_memory.step < 0.0 else 0.0
        joint_memory.turning += share * (reversal - joint_memory.turning)
        joint_memory.step = step


@leaf
def _compare_with_predictions(joint_memory, slope, v, dt, shares, forgetting):
    """Compare the changes of a joint's readings with those that the commands predict.

    The speed that is read and that of the positions are predicted from commanded accelerations;
    both predictions (`model_v`, `model_q`) follow the readings with the time constant `_MODEL`.
    `surprise_v` and `surprise_q` are the low-passed errors of the predictions (all rad/s, m/s), and
    `blame` (rad, m) is the integral of |surprise_v| − |surprise_q| with forgetting: positive if the
    speed is predicted worse than the position. Fills these five fields of the joint.

    Args:
        joint_memory: JOINT_MEMORY, changed.
        slope: speed from positions (rad/s, m/s).
        v: speed read (rad/s, m/s).
        dt: time since the position was last read (s).
        shares: shares of dt in the low-passes, from `_shares`.
        forgetting: factor of `blame` in this step, ≤ 1.
    """
    joint_memory.model_v += joint_memory.pending
    joint_memory.model_q += joint_memory.pending
    joint_memory.surprise_v += shares[1] * (v - joint_memory.model_v - joint_memory.surprise_v)
    joint_memory.surprise_q += shares[1] * (slope - joint_memory.model_q - joint_memory.surprise_q)
    difference = abs(joint_memory.surprise_v) - abs(joint_memory.surprise_q)
    joint_memory.blame = (joint_memory.blame + difference * dt) * forgetting
    joint_memory.model_v += shares[0] * (v - joint_memory.model_v)
    joint_memory.model_q += shares[0] * (slope - joint_memory.model_q)


@leaf
def _were_noisy(t):
    """Determine whether the positions of all joints were noisy when they last changed.

    They were if more than the share `_NOISY` of changes reversed the one before (`turning`).

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
    joint at rest beside its hold. The holds of all joints are moved by `_MOVED` after each
    `_SETTLES`/`hold_rate` seconds. The encoder of a joint that has followed `_FOLLOWED` moves, and
    is constant during the next one, is dead. If only rounding has changed the estimate of its
    position, friction may hold it, too: then `probing` tests it. A joint that is blocked by
    friction or by a contact never follows; it remains at rest even if its encoder is dead.

    Updates in MEMORY `tested` (s since the last move), `above` (side of the holds), and of the
    joints `hold`, `begun`, `went`, `changes`, `followed`, `faulty` and `probed`.

    Args:
        t: Tick of stopped arms that are held at rest.
        dt: time since the last readings (s).
    """
    memory = t.memory
    memory.tested += dt
    if memory.tested * t.model.hold_rate < _SETTLES:
        return
    memory.above = 1 - memory.above
    for j in range(t.model.n_joints):
        joint_memory = memory.joints[j]
        displacement = joint_memory.q - joint_memory.begun
        # dead: constant during this move of its hold, although it followed several moves before
        if joint_memory.changes == 0 and joint_memory.followed >= _FOLLOWED:
            joint_memory.faulty |= FAULTY_POSITION
            if memory.derived or joint_memory.same_speed >= memory.tested:
                joint_memory.faulty |= FAULTY_SPEED
        elif joint_memory.rested >= memory.tested and joint_memory.followed >= _FOLLOWED:
            joint_memory.probed = _AGAIN
        # it follows if it has moved opposite to the move before, as its hold has
        follows = joint_memory.changes >= _CHANGES and displacement * joint_memory.went < 0.0
        joint_memory.followed = min(joint_memory.followed + 1, _FOLLOWED) if follows else 0
        joint_memory.went = displacement
        joint_memory.begun = joint_memory.q
        joint_memory.changes = 0
        joint_memory.hold += _MOVED if memory.above else -_MOVED
    memory.tested = 0.0


@inner
def stopped_abruptly(t):
    """Determine whether constant readings of all joints began with a stop no friction can cause.

    Readings are constant if they have been identical for more than `DEAD`. The deceleration of a
    joint with a motor, from the packet before them to their first, then needed more than twice the
    torque of dry friction: the bound of its known friction, and `_HELD` times the motor's limit. A
    joint that had come to rest before does not count: while others moved, its friction acted on
    much less inertia than M_jj.

    Args:
        t: Tick, of which M is read, and of MEMORY `still`, and `halted` and `same_speed` of the
            joints.
    """
    if t.memory.still <= DEAD:
        return False
    is_stopped = False
    for k in range(t.model.n_arms):
        arm = t.model.arms[k]
        for j in range(arm.first, arm.end):
            joint_memory = t.memory.joints[j]
            deceleration = joint_memory.halted
            is_last = joint_memory.same_speed < t.memory.still + 1.5 * t.model.period
            if is_last and deceleration > 0.0 and t.model.joints[j].motor >= 0:
                bound = 2.0 * (_dry_friction_bound(t, j) + _HELD * t.model.joints[j].tau_max)
                inertia = t.work.joints[j].M[j - arm.first]
                is_stopped = is_stopped or inertia * deceleration > bound
    return is_stopped


@leaf
def _dry_friction_bound(t, j):
    """Bound the dry friction of a joint from above by twice its known value.

    The known value is the larger one of the model's and the estimated one. It is doubled because it
    may also be compensated with the wrong sign.

    Args:
        t: Tick.
        j: index of the joint.

    Returns:
        Torque or force (N m, N).
    """
    return 2.0 * max(t.model.joints[j].theta[0], t.memory.joints[j].trusted[0])


@leaf
def must_move(t, arm, j):
    """Determine whether joint j of an arm has to move under its command, whatever its friction.

    The commanded acceleration takes more torque than dry friction may hold. Where speeds are
    estimated, the readings of a joint that rests are as constant as those of a dead encoder, and a
    contact that is not as expected may hold it: then the motors must show the motion, too
    (`_accelerates`).

    Args:
        t: Tick.
        arm: ARM row.
        j: index of the joint.
    """
    joint_work = t.work.joints[j]
    bound = _held_torque(t, j, t.memory.still > DEAD)
    if abs(joint_work.inertial - joint_work.h) <= bound:
        return False
    return t.memory.derived == 0 or j > arm.sensor_joint or _accelerates(t, arm, j)


@leaf
def _accelerates(t, arm, j):
    """Determine by the motors of an arm whether joint j accelerates, as its encoder does not show.

    Then its residual r_j, the torque that neither model nor wrist explains, exceeds dry friction,
    and those of the other joints are M_ij/M_jj r_j. A wedged object leaves no residuals, and a
    brake of the joint none of others.

    Args:
        t: Tick, of which `residual` of the joints in MEMORY (N m, N), and M, are read.
        arm: ARM row with a wrist sensor.
        j: index of the joint, which is not beyond the sensor.
    """
    residual = t.memory.joints[j].residual
    if abs(residual) <= _held_torque(t, j, False):
        return False
    row = t.work.joints[j].M
    shown = 0.0  # Σ p_i r_i over the other joints, p_i = M_ij/M_jj r_j
    expected = 0.0  # Σ p_i²
    for i in range(arm.first, arm.sensor_joint + 1):
        if i != j and t.model.joints[i].motor >= 0:
            torque = row[i - arm.first] / row[j - arm.first] * residual
            shown += torque * t.memory.joints[i].residual
            expected += torque * torque
    return shown >= _SHOWN * expected


@leaf
def dry_friction(t, j):
    """Bound the torque that dry friction of a joint may hold (N m, N), as far as it is known.

    Args:
        t: Tick.
        j: index of the joint.
    """
    return _held_torque(t, j, True)


@leaf
def _held_torque(t, j, trusts_motion):
    """Bound the torque that dry friction of a joint may hold (N m, N).

    It is that of `_dry_friction_bound` and, for a joint with a motor, unknown friction of `_HELD`
    times the motor's limit. What a motion has shown for `_SLID` bounds the unknown friction by
    twice its value (`rubbed`), and `_LITTLE` times the limit.

    Args:
        t: Tick.
        j: index of the joint.
        trusts_motion: whether this bound is taken: if the readings of all joints have been constant
            for `DEAD`, either friction holds the arm or the encoders are dead.
    """
    joint = t.model.joints[j]
    joint_memory = t.memory.joints[j]
    bound = _dry_friction_bound(t, j)
    if joint.motor >= 0:
        unknown = _HELD * joint.tau_max
        if trusts_motion and joint_memory.slid > _SLID:
            unknown = min(unknown, 2.0 * joint_memory.rubbed + _LITTLE * joint.tau_max)
        bound += unknown
    return bound
