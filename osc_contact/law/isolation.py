"""Isolation of faulty joint readings, and estimates of joint states from the sound ones.

If position and speed of a joint contradict each other, the reading whose changes the commanded
accelerations predict less is faulty. A packet that repeats itself or belongs to other joints has no
sound readings. Missing and faulty positions and speeds are estimated from sound readings.
"""

from __future__ import annotations

from osc_contact.law.agreement import APART, HEAVY, UNBALANCED_TIME, weight_share
from osc_contact.law.ceilings import carried_force
from osc_contact.law.jit import inner, leaf
from osc_contact.law.records import FAULTY_POSITION, FAULTY_SPEED, NOISY, SAFE_STOP
from osc_contact.law.vectors import angular, clamped, dot3, dot6, join, minus3

_DISTANCE = 0.25  #: share of `position_drift` by which a lasting speed must change the position
_SLOPE = 0.005  #: s, time constant of the speed estimate from positions
#: share of a wrist's reading by which it differs from its load if the posture is wrong: weight
#: turned by 15°
_TURNED = 0.25
_GIVES = 0.5  #: share of `closure_error` by which the gap between two stopped arms may change
_WEIGHED = 0.1  #: s after a stop in which the wrist of an arm shows that it has let go
_SPEED_SHARE = 0.2  #: share of the positions' error at which an estimated speed is faulty
#: share of the smaller of two errors by which their sum may differ from 0 if speeds are exchanged
_OPPOSITE = 0.3
#: shares of `position_drift` that both exceed, alone and where a speed is predicted worse, too
_APART = 0.5
_SLIGHTLY_APART = 0.2
DEAD = 0.01  #: s of identical readings of all joints after which the whole packet is dead
BLIND_TIME = 0.01  #: s without a sound reading after which a joint cannot be braked


@inner
def isolate_joint(t, j):
    """Mark the faulty reading of joint j, whose position and speed contradict each other.

    1. A reading that stays constant while the joint must have moved is faulty (`is_constant`, and
       for the speed `same_speed` and `moved`).
    2. Otherwise the reading is faulty whose changes the commanded accelerations predicted with the
       larger error: the speed if `blame` > 0, else the position. `blame` is the integral, with
       forgetting, of |`surprise_v`| − |`surprise_q`|: these are the errors of the predicted speed
       against the speed read and against that of the positions (rad/s, m/s; see `sensors`). If
       errors of two joints are opposite, their speeds are exchanged (`_mark_exchanged_speeds`).
    3. In place of rule 2, a speed that is estimated from positions (`derived`) is faulty if
       |`surprise_v`| exceeds `_SPEED_SHARE` times |`surprise_q`|, because it follows the
       predictions more closely than positions do; else the position is.

    If the position is constant, joint j alone is marked; a speed that is estimated from a constant
    position is faulty, too. Otherwise nothing is done if the joint has a mark already; and if its
    speed is faulty, the speeds of all joints without a mark are marked, because one driver or
    estimator returns them all.

    Args:
        t: Tick; `faulty` of the joints in MEMORY is changed.
        j: index of the joint.
    """
    joint = t.memory.joints[j]
    position_constant = is_constant(t, joint)
    has_changed = position_constant or abs(joint.moved) > _DISTANCE * t.model.position_drift
    speed_constant = joint.same_speed > DEAD and has_changed
    if position_constant:
        joint.faulty |= FAULTY_POSITION
        if speed_constant or t.memory.derived:
            joint.faulty |= FAULTY_SPEED
    elif joint.faulty == 0:
        speed_worse = joint.blame > 0.0
        if t.memory.derived:
            speed_worse = abs(joint.surprise_v) > _SPEED_SHARE * abs(joint.surprise_q)
        if speed_constant or speed_worse:
            _mark_speeds(t)
            _mark_exchanged_speeds(t, j, _SLIGHTLY_APART)
        else:
            joint.faulty = FAULTY_POSITION
            _mark_exchanged_speeds(t, j, _APART)


@leaf
def _mark_speeds(t):
    """Mark the speeds of all joints without a mark, as one driver or estimator returns them all.

    Args:
        t: Tick; `faulty` of the joints in MEMORY is changed.
    """
    for i in range(t.model.n_joints):
        if t.memory.joints[i].faulty == 0:
            t.memory.joints[i].faulty = FAULTY_SPEED


@leaf
def _mark_exchanged_speeds(t, j, share):
    """Mark speeds in place of positions if the speeds of joint j and another one are exchanged.

    Speeds less those of the positions are opposite then, v_i − v_j and v_j − v_i, as are their
    integrals, by which positions and speeds drift apart. Joints with nearly the same axis move such
    that the exchanged speeds may be predicted better than the positions, and one or both positions
    are marked. Two encoders that drift by opposite amounts at the same time are far less likely.
    Noise of encoders may do so by chance, but hardly with low-passed errors that are opposite, too,
    and steps that the joints' speed limits permit. Speeds that are estimated from positions are not
    exchanged.

    Args:
        t: Tick; `faulty` of the joints in MEMORY is changed.
        j: index of the joint that was marked in this tick.
        share: share of `position_drift` that both drifts exceed.
    """
    joints = t.memory.joints
    for i in range(t.model.n_joints if t.memory.derived == 0 else 0):
        if i == j or joints[i].faulty & FAULTY_SPEED or is_constant(t, joints[i]):
            continue
        drifts_apart = _are_opposite(
            joints[i].drift, joints[j].drift, share * t.model.position_drift
        )
        goes_on = _are_opposite(joints[i].error, joints[j].error, 0.0)
        if drifts_apart and goes_on and _moves_smoothly(t, i) and _moves_smoothly(t, j):
            joints[i].faulty = joints[j].faulty = 0
            _mark_speeds(t)
            return


@leaf
def _are_opposite(x, y, least):
    """Test whether two numbers are nearly opposite, and both larger than a bound.

    Args:
        x, y: the numbers.
        least: bound of their magnitudes.
    """
    smallest = min(abs(x), abs(y))
    return smallest > least and abs(x + y) < _OPPOSITE * smallest


@leaf
def _moves_smoothly(t, j):
    """Test whether the last change of the position of joint j is one that its speed limit permits.

    Args:
        t: Tick, of which `step` (rad, m) and `unread_q` (ticks) of the joint in MEMORY are read.
        j: index of the joint.
    """
    joint_memory = t.memory.joints[j]
    ticks = 1 + joint_memory.unread_q
    return abs(joint_memory.step) <= t.model.joints[j].speed_max * ticks * t.model.period


@leaf
def is_constant(t, joint):
    """Test whether the position of a joint is constant although the joint must have moved.

    Args:
        t: Tick.
        joint: JOINT_MEMORY, of which `due` (rad, m) and `stuck` are read.
    """
    return abs(joint.due) > _DISTANCE * t.model.position_drift or joint.stuck != 0


@inner
def isolate_packet(t):
    """Mark all readings of joints as faulty if they are constant while motors contradict a wrist.

    The unexplained torque exceeds friction, so the joints must move although their readings have
    been identical for more than `UNBALANCED_TIME`.

    Args:
        t: Tick in which motor torques contradict a wrist (`UNBALANCED`); `still` (s of identical
            readings) of MEMORY is read, and `faulty` of the joints changed.
    """
    memory = t.memory
    for j in range(t.model.n_joints if memory.still > UNBALANCED_TIME else 0):
        memory.joints[j].faulty = FAULTY_POSITION | FAULTY_SPEED


@inner
def isolate_posture(t):
    """Mark all readings of a single arm as faulty if its encoders contradict motors and wrist.

    Weights and inertia at the posture that encoders read predict the torques of the motors and the
    load of the wrist. Where motors and wrist contradict each other, the wrist is wrong if torques
    are as predicted, and something drags at the arm inboard of the wrist if the load is. If neither
    is as predicted, the posture is wrong; which encoder has the error is not known. If speeds are
    estimated from encoders, no reading of the arm is sound then.

    The load of an arm in contact, or of one of several at an object, is not predicted: no reading
    of such arms is marked, nor any while speeds are not estimated from positions (`derived` = 0).
    Reads `column` of the joints in WORK, in MEMORY `residual` of the joints (torque that neither
    model nor wrist explains; N m, N) and `centre_rate` (acceleration of the object's centre, m/s²),
    `net` of the arm in WORK (its reading at C less weight and inertia beyond the sensor; N, N m),
    and its wrench in INPUT. Fills `faulty` of the joints in MEMORY.

    Args:
        t: Tick of a contradiction between motors and the wrist of an arm.
    """
    model = t.model
    memory = t.memory
    if memory.derived == 0 or model.n_arms != 1 or t.work.rank > 0:
        return
    arm = model.arms[0]
    net = t.work.arms[0].net
    reading = t.input.wrenches[0]
    # the wrist's load at C less the one by weight and inertia; a small difference is as predicted
    force = minus3(net, carried_force(t, memory.centre_rate))
    if dot3(force, force) < _TURNED**2 * dot3(reading, reading):
        return
    excess = join(force, angular(net))  # of the wrist's load over the predicted one
    # torques of the joints up to the sensor, less those predicted for the predicted load
    is_wrong = False
    for j in range(arm.first, arm.sensor_joint + 1):
        torque = memory.joints[j].residual + dot6(t.work.joints[j].column, excess)
        bound = 2.0 * model.wrist_error * model.joints[j].tau_max
        is_wrong = is_wrong or (model.joints[j].motor >= 0 and abs(torque) > bound)
    # then the posture is wrong: no reading of the arm is sound
    for j in range(arm.first, arm.end if is_wrong else arm.first):
        memory.joints[j].faulty = FAULTY_POSITION | FAULTY_SPEED


@inner
def isolate_arms(t):
    """Mark all readings of joints as faulty if stopped arms load each other by a wrong encoder.

    Encoders place stopped arms apart at one object: an encoder is wrong, or an arm has let go of
    the object, which its wrist shows within `_WEIGHED`. If all bear a load then, they hold an
    object that is rigid, and hold it apart. Which encoder is wrong is not known; if speeds are
    estimated from encoders, it contradicts none of them, and the arms follow its drift. Arms that
    were stopped for another reason, and are placed apart later, bear more than `HEAVY` times their
    shares of the weight then. After a stop in which arms were only about to be apart, as after a
    short slip, encoders are sound as long as no gap exceeds `closure_error`, or changes by more
    than `_GIVES` times that: arms that are held at a rigid object do not move against each other.

    Nothing is marked if an arm has no wrist sensor, which shows whether it holds the object, or if
    encoders are far noisier than expected.

    Args:
        t: Tick, of which `state`, `derived`, `cause`, `age` and `apart`, and `let_go`, `load` and
            `gap` of the arms in MEMORY are read; of the arms `first_gap` (m) follows `gap` until
            `_WEIGHED`, and `faulty` of the joints is changed.
    """
    model = t.model
    memory = t.memory
    if memory.state != SAFE_STOP or memory.derived == NOISY:
        return
    is_cause = memory.cause == APART  # else arms are placed apart only since a later time
    if (memory.age * model.period if is_cause else memory.apart) < _WEIGHED:
        for k in range(model.n_arms):
            memory.arms[k].first_gap = memory.arms[k].gap
        return
    if memory.derived == 0:
        return
    heavy = HEAVY * weight_share(t)
    gaps_are_small = True
    for k in range(model.n_arms):
        row = memory.arms[k]
        change = abs(row.gap - row.first_gap)
        is_small = row.gap <= model.closure_error and change <= _GIVES * model.closure_error
        gaps_are_small = gaps_are_small and is_small
        if model.arms[k].sensor_joint < 0 or row.let_go:
            return
        if not is_cause and dot3(row.load, row.load) < heavy * heavy:
            return
    # without a leader gaps of stopped arms are not measured
    if is_cause and model.leader >= 0 and gaps_are_small:
        return
    for j in range(model.n_joints):
        memory.joints[j].faulty = FAULTY_POSITION | FAULTY_SPEED


@inner
def estimate_joints(t):
    """Estimate positions and speeds of the joints (`q`, `v` of MEMORY) from sound readings.

    A missing or faulty position is integrated from the speed; a missing or faulty speed is
    estimated from positions and commanded accelerations. Without either reading both are predicted
    from the commands. A joint with a motor cannot be braked reliably if neither reading was sound
    for `BLIND_TIME`; `unbraked` of MEMORY is set to the last such joint, or −1. Before the first
    computed tick positions are those last read, and a missing or faulty speed counts as 0.

    Args:
        t: Tick, of which `faulty` (flags), `unread_q`, `unread_v` (ticks without a reading), `q`,
            `v` (last readings) and `acceleration` (commanded) of the joints in MEMORY are read.
    """
    model = t.model
    table = model.joints
    memory = t.memory
    dt = model.period
    memory.unbraked = -1
    for j in range(model.n_joints):
        joint = memory.joints[j]
        sound_q = joint.faulty & FAULTY_POSITION == 0
        sound_v = joint.faulty & FAULTY_SPEED == 0
        new_q = sound_q and joint.unread_q == 0
        new_v = sound_v and joint.unread_v == 0
        # speed: as read; or predicted by the command, corrected by the slope of the positions
        v = memory.v[j] + joint.acceleration * dt
        if memory.ticked == 0:
            memory.q[j] = joint.q
            v = 0.0
        if new_v:
            v = joint.v
        elif new_q:  # with the time constant `_SLOPE`
            slope = (joint.q - memory.q[j]) / dt
            v += (slope - v) * dt / (_SLOPE + dt)
        v = clamped(v, model.plausible_speed * table[j].rated)
        memory.q[j] = joint.q if new_q else memory.q[j] + v * dt
        memory.v[j] = v
        # without a sound reading of either for `BLIND_TIME` the joint cannot be braked
        blind_q = not sound_q or joint.unread_q * dt > BLIND_TIME
        blind_v = not sound_v or joint.unread_v * dt > BLIND_TIME
        if blind_q and blind_v and table[j].motor >= 0:
            memory.unbraked = j
