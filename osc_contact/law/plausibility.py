"""Plausibility of readings and reference before a tick is computed.

A tick is not computed (see `safety`) if speeds are estimated from encoders far noisier than
expected, if the reference pose has no rotation matrix, if readings are too old or a wrench exceeds
the range of its sensor, if a packet arrives out of order, if the position of a joint jumps or is
exchanged with that of another joint, if a joint is read faster than possible, or if the speeds of
several joints jump or are exchanged.
"""

from __future__ import annotations

from math import isfinite

from osc_contact.law.jit import inner, leaf
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    EXCHANGED,
    JOINTS,
    JUMP,
    NOISY,
    NOT_BARRED,
    OUTDATED,
    WRISTS,
)
from osc_contact.law.vectors import cross, dot3

NO_ROTATION = declare_reason(
    "NO_ROTATION",
    14,
    "reference X_WD: its 3×3 part is not a rotation matrix (R Rᵀ = 1 and det R = 1 are missed by "
    "more than 1e-4)",
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
    "no new readings of joints or wrists were received for longer than "
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
    "{safety.speed_error:g} of their limits, or are exchanged",
)
NOISY_ENCODERS = declare_reason(
    "NOISY_ENCODERS",
    65,
    "encoders are far noisier than those for which speeds are estimated from them: the law cannot "
    "control forces with speeds as slow, or as noisy, as these. Check encoders, couplings and "
    "shields",
)

_ROUND = 1e-4  #: bound of the elements of R Rᵀ − 1
_NOISE = 0.02  #: rad, m, largest change of a position that never counts as a jump
_SLIGHT = 0.2  #: share of `speed_error` by which exchanged speeds differ at least
_EXCHANGED = 1e-3  #: rad, m, least difference of two positions whose exchange is detected
_SAME = 0.2  #: share of this difference within which a reading is attributed to the other joint


@inner
def check_readings(t):
    """Check the plausibility of readings and reference before a tick is computed.

    They are, in their order:

    1. NOISY_ENCODERS: speeds are estimated from encoders far noisier than expected.
    2. NO_ROTATION: the first 3×3 block of X_WD is not a rotation matrix.
    3. WRENCH_TIMEOUT: this tick has no wrench, and none was read for `wrench_timeout` (s) or ever;
       or OUT_OF_RANGE: a wrist reads more than its sensor's range.
    4. OUT_OF_ORDER: the packet is older than the last one.
    5. STALE: joints or wrists have no new readings for longer than `wrench_timeout`.
    6. JUMPED: a speed is above `plausible_speed` times the rated one, or a position jumps or is
       exchanged (`find_jumps`).
    7. SPEEDS_JUMPED: the speeds of several joints do.

    Reads INPUT, and in MEMORY `derived`, `wrench_missing`, `has_wrench`, `repeated` (flags of
    repeated readings) and ages of readings (ticks). Fills `culprit` (joint or arm), and `looked` of
    WORK (1 once `find_jumps` was called in this tick).

    Args:
        t: Tick.

    Returns:
        The first reason that applies, or `NO_REASON`.
    """
    model = t.model
    table = model.joints
    memory = t.memory
    if memory.derived == NOISY:
        return NOISY_ENCODERS
    if not _is_rotation(t.input.X_WD):
        return NO_ROTATION
    if memory.wrench_missing:
        if memory.has_wrench == 0 or (memory.wrench_age + 1) * model.period > model.wrench_timeout:
            return WRENCH_TIMEOUT
    else:
        for k in range(model.n_arms):
            if model.arms[k].sensor_joint >= 0 and exceeds_range(t, k):
                memory.culprit = k
                return OUT_OF_RANGE
    if memory.repeated & OUTDATED:
        return OUT_OF_ORDER
    for mark, age in ((JOINTS, memory.old_joints), (WRISTS, memory.old_wrists)):
        if memory.repeated & mark and (age + 1) * model.period > model.wrench_timeout:
            return STALE
    for j in range(model.n_joints):
        if abs(t.input.v[j]) > model.plausible_speed * table[j].rated:
            memory.culprit = j
            return JUMPED
    find_jumps(t)
    t.work.looked = 1
    if t.work.jumps > 0:
        memory.culprit = t.work.jumped
        return JUMPED
    if t.work.speed_jumps > 1:
        memory.culprit = t.work.speed_jumped
        return SPEEDS_JUMPED
    return NO_REASON


@inner
def find_jumps(t):
    """Detect jumps of positions and speeds in this packet; must be called once in each tick.

    Fills `jumps` and `speed_jumps` of WORK (numbers of joints whose positions or speeds jump),
    `jumped` and `speed_jumped` (one of these joints), and in MEMORY `barred` of the joints
    (NOT_BARRED, JUMP or EXCHANGED) and `mixed`, the time (s) for which several joints have jumped,
    over packets in which no position was read, too. If the joints have no new readings, or were
    never read before, no jumps are counted and MEMORY remains unchanged. Exchanged readings are not
    detected where encoders are far noisier than expected. `sensors` discards the position of a
    joint that jumps alone, the whole packet if several positions jump, and all its speeds if
    several speeds do.

    Args:
        t: Tick.
    """
    memory = t.memory
    work = t.work
    work.jumps = work.speed_jumps = 0
    if memory.compared == 0 or memory.repeated & JOINTS:
        return
    n_read = 0
    n_deviating = 0
    n_speeds_deviating = 0
    for j in range(t.model.n_joints):
        position = t.input.q[j]
        if not isfinite(position):
            continue
        n_read += 1
        joint_memory = memory.joints[j]
        # jumps of its position and of its speed, and deviations from the predicted position
        if joint_memory.barred != NOT_BARRED or abs(position - joint_memory.q) > _NOISE:
            joint_memory.barred = _judge_position(t, j, position)
            if joint_memory.barred != NOT_BARRED:
                work.jumps += 1
                work.jumped = j
        if _changes_speed(t, j):
            n_speeds_deviating += 1
            if _speed_jumps(t, j):
                work.speed_jumps += 1
                work.speed_jumped = j
        if abs(position - _expected(t, j)) > _EXCHANGED:
            n_deviating += 1
    # without jumps of several joints, readings of pairs of joints may still be exchanged
    if memory.derived != NOISY:  # noise far beyond the expected one hides it, or looks like it
        if n_deviating > 1 and work.jumps < 2:
            _find_exchanged_positions(t, n_deviating)
        if n_speeds_deviating > 1 and work.speed_jumps < 2:
            _find_exchanged_speeds(t, n_speeds_deviating)
    several_jump = max(work.jumps, work.speed_jumps) > 1
    if several_jump or (n_read == 0 and memory.mixed > 0.0):
        memory.mixed += t.model.period
    else:
        memory.mixed = 0.0


@leaf
def _expected(t, j):
    """Predict the position of a joint from its estimated position and speed of the last tick.

    Args:
        t: Tick, of which `q`, `v` of MEMORY are read.
        j: index of the joint.

    Returns:
        Position (m, rad).
    """
    return t.memory.q[j] + t.memory.v[j] * t.model.period


@leaf
def _judge_position(t, j, position):
    """Judge whether the position read of joint j is credible, a jump, or that of another joint.

    A credible joint jumps if it has moved farther since its position was last read than it can at
    `plausible_speed` times its rated speed. A joint that has jumped is compared with the estimated
    position of the last tick instead, with the distance of one period: its last reading would
    permit a larger distance with each tick without a reading, until any position were plausible. A
    joint whose reading `_find_exchanged_positions` has attributed to another one is credible again
    once the reading is within half of `_EXCHANGED` of its prediction.

    Args:
        t: Tick, of which `barred` (state of the joint in the last tick), `q` (position last read;
            m, rad) and `unread_q` (ticks without a reading) of the joint, and `q` (estimated
            positions) in MEMORY are read.
        j: index of the joint.
        position: position read in this tick (m, rad).

    Returns:
        NOT_BARRED (credible), JUMP, or EXCHANGED (the reading of another joint).
    """
    joint_memory = t.memory.joints[j]
    if joint_memory.barred == EXCHANGED:
        is_away = abs(position - _expected(t, j)) > 0.5 * _EXCHANGED
        return EXCHANGED if is_away else NOT_BARRED
    bound = _NOISE + t.model.plausible_speed * t.model.joints[j].rated * t.model.period
    if joint_memory.barred == JUMP:
        displacement = abs(position - t.memory.q[j])
    else:
        displacement = abs(position - joint_memory.q)
        # As far again for each tick without a reading; noise does not grow with time.
        bound += (bound - _NOISE) * joint_memory.unread_q
    return JUMP if displacement > bound else NOT_BARRED


@inner
def _find_exchanged_positions(t, n_deviating):
    """Detect pairs of joints whose position readings are exchanged (`_are_exchanged`).

    An exchange need not be a jump of either joint. Very noisy encoders may look exchanged by
    chance; then further joints deviate, and no exchange is reported. Fills `barred` (EXCHANGED) of
    the joints in MEMORY; of WORK `jumps` (2, also for several pairs) and `jumped` (one of the
    joints).

    Args:
        t: Tick.
        n_deviating: number of joints whose positions deviate from their predictions.
    """
    n = t.model.n_joints
    n_exchanged = 0  # number of joints in such pairs, compared with that of deviating joints
    for i in range(n):
        for j in range(i):
            if _are_exchanged(t, i, j):
                n_exchanged += 2
    if n_exchanged != n_deviating:
        return
    for i in range(n):
        for j in range(i):
            if _are_exchanged(t, i, j):
                t.memory.joints[i].barred = EXCHANGED
                t.memory.joints[j].barred = EXCHANGED
                t.work.jumps = 2
                t.work.jumped = i


@leaf
def _are_exchanged(t, i, j):
    """Determine whether the position readings of two joints are exchanged.

    Each is then near the position predicted for the other joint, and farther than `_EXCHANGED` from
    the one predicted for its own, and from where it would be if it had moved as before. Two joints
    that move in a mirror image pass their zeros at the same time: each is then where the other one
    was predicted if their estimated speeds lag, but goes on as before.

    Args:
        t: Tick, of which `q` and `step` (last reading and its change; rad, m) of the joints in
            MEMORY are read.
        i, j: indices of the joints.
    """
    q = t.input.q
    is_deviating = min(_deviation(t, i), _deviation(t, j)) > _EXCHANGED
    return is_deviating and _is_near_other(q[i], q[j], _expected(t, i), _expected(t, j))


@leaf
def _deviation(t, j):
    """Distance of the position read of joint j from the nearest one that its motion explains.

    Explained are the one by its estimated speed and the one by the last change of its reading.

    Args:
        t: Tick.
        j: index of the joint.

    Returns:
        Distance (m, rad).
    """
    position = t.input.q[j]
    joint_memory = t.memory.joints[j]
    going_on = joint_memory.q + joint_memory.step
    return min(abs(position - _expected(t, j)), abs(position - going_on))


@leaf
def _is_near_other(x, y, expected_x, expected_y):
    """Determine whether two readings are each near the prediction of the other, not near their own.

    Args:
        x, y: readings (rad, m).
        expected_x, expected_y: their predictions (rad, m).
    """
    tolerance = _SAME * abs(x - expected_x)
    return abs(x - expected_y) < tolerance and abs(y - expected_x) < tolerance


@inner
def _find_exchanged_speeds(t, n_deviating):
    """Detect pairs of joints whose speed readings are exchanged.

    In such a pair each speed is near the one predicted for the other joint, and both have changed.
    If further joints deviate, the speeds are only noisy, and nothing is reported. Fills of WORK
    `speed_jumps` (2, also for several pairs) and `speed_jumped` (one of the joints).

    Args:
        t: Tick.
        n_deviating: number of joints whose speeds deviate from their predictions.
    """
    n_exchanged = 0
    last_found = 0
    for i in range(t.model.n_joints):
        for j in range(i):
            both_change = _changes_speed(t, i) and _changes_speed(t, j)
            x = t.input.v[i]
            y = t.input.v[j]
            if both_change and _is_near_other(x, y, _expected_speed(t, i), _expected_speed(t, j)):
                n_exchanged += 2
                last_found = j
    if n_exchanged == n_deviating:
        t.work.speed_jumps = 2
        t.work.speed_jumped = last_found


@leaf
def _expected_speed(t, j):
    """Predict the speed of a joint from its speed and its commanded acceleration of the last tick.

    Args:
        t: Tick, of which `v` of MEMORY is read, and `acceleration` of the joint.
        j: index of the joint.

    Returns:
        Speed (m/s, rad/s).
    """
    return t.memory.v[j] + t.memory.joints[j].acceleration * t.model.period


@leaf
def _speed_room(t, j):
    """Compute the largest change of a joint's speed that does not count as a jump.

    It is `speed_error` times the speed limit, and as much again for each tick without a position.

    Args:
        t: Tick.
        j: index of the joint.

    Returns:
        Change of speed (m/s, rad/s).
    """
    unread = t.memory.joints[j].unread_q
    return t.model.speed_error * t.model.joints[j].speed_max * (1 + unread)


@leaf
def _changes_speed(t, j):
    """Determine whether the speed of a joint differs from the last and from the predicted one.

    Differences up to `_SLIGHT` times `_speed_room` are attributed to noise. Speeds that are
    estimated from positions are not checked, because they jump together with the positions.

    Args:
        t: Tick.
        j: index of the joint.
    """
    if t.memory.derived:
        return False
    speed = t.input.v[j]
    room = _SLIGHT * _speed_room(t, j)
    return abs(speed - t.memory.v[j]) > room and abs(speed - _expected_speed(t, j)) > room


@leaf
def _speed_jumps(t, j):
    """Determine whether a joint's speed is far out of the range from last to predicted speed.

    It is so if it is outside by more than `_speed_room`. The last speed is in the range because a
    joint that is blocked, or whose motor is weak, changes its speed less than commanded.

    Args:
        t: Tick.
        j: index of the joint.
    """
    room = _speed_room(t, j)
    last_speed = t.memory.v[j]
    predicted_speed = _expected_speed(t, j)
    speed = t.input.v[j]
    return (
        speed < min(last_speed, predicted_speed) - room
        or speed > max(last_speed, predicted_speed) + room
    )


@leaf
def exceeds_range(t, k):
    """Determine whether a number of a wrist's reading is beyond its sensor's range; NaN is not.

    Args:
        t: Tick, of which `wrenches` of INPUT are read.
        k: index of the arm.
    """
    exceeds = False
    for i in range(6):
        limit = t.model.force_range if i < 3 else t.model.torque_range
        exceeds = exceeds or abs(t.input.wrenches[k, i]) > limit
    return exceeds


@leaf
def _is_rotation(X):
    """Determine whether the first 3×3 block R of X is a rotation matrix.

    Each element of R Rᵀ − 1 must be below `_ROUND`, and det R > 0. The rows of R are compared.

    Args:
        X: at least (3, 3), such as a pose.
    """
    deviation = 0.0  # largest element of R Rᵀ − 1
    for i in range(3):
        for j in range(i + 1):
            expected = 1.0 if i == j else 0.0
            deviation = max(deviation, abs(dot3(X[i], X[j]) - expected))
    return deviation < _ROUND and dot3(cross(X[0], X[1]), X[2]) > 0.0
