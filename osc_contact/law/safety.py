"""Limits of the robot; repeated torques, holds and stops when a tick cannot be computed."""

from __future__ import annotations

from osc_contact.law.agreement import UNBALANCED
from osc_contact.law.force_law import integral_room
from osc_contact.law.holding import hold_posture
from osc_contact.law.isolation import (
    estimate_joints,
    isolate_arms,
    isolate_packet,
    isolate_posture,
)
from osc_contact.law.jit import inner, leaf
from osc_contact.law.phases import SURE, collect
from osc_contact.law.reasons import LASTING, NO_REASON, declare_reason
from osc_contact.law.records import (
    DEGRADED_STATE,
    HOLD,
    HOPPING,
    JOINTS,
    OK,
    RUN,
    SAFE_STOP,
    SATURATED,
    WRISTS,
)
from osc_contact.law.sensors import must_move, stopped_abruptly

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
# Rules are evaluated in a tick that can be computed, before its torques. A reason that a rule
# returns stops the arms. Rules about forces and speeds accumulate the time for which they are
# violated, and subtract the time for which they are not, so that neither a knock nor a single wrong
# sample stops a robot, but repeated impacts do.

_FULL = 0.99  #: share of its bound from which on a force integral counts as saturated
_SHARE = 0.2  #: share of its command below which a contact is lost
_LIGHT = 1.0  #: N, command below which a loss of contact cannot be detected
# A tick above the speed limit has the weight 1 + _FASTER (|v|/v_max − 1), where the excess counts
# up to _MOST.
_FASTER = 8.0
_MOST = 10.0
_OVERFORCE = 3.0  #: multiple of its command above which a contact is overloaded


@leaf
def watch_joints(t):
    """Return a reason if a joint is too fast for too long, or can just be stopped before its end.

    The stopping distance of a joint with the speed q̇ is |q̇|(t_r + |q̇|/(2a)), where t_r =
    `reaction` is the time until the brakes act and a the deceleration of the stop (1/(2a) =
    `brake`). Joints beyond the end of their range are excluded, because braking cannot keep them in
    it. Reads q and v of INPUT. Updates in MEMORY `overspeed` (ticks above a speed limit, weighted
    with 1 + `_FASTER` (|q̇|/q̇_max − 1) of the fastest joint, less ticks below all limits) and
    `ending` (s in which a stopping distance exceeds the way to the end, less s in which none does);
    fills `culprit` (index of the joint) if a reason is returned.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`, `NEAR_END` or `OVERSPEED`.
    """
    model = t.model
    memory = t.memory
    fast_joint = -1
    ending_joint = -1
    largest_ratio = 1.0
    for j in range(model.n_joints):
        position = t.input.q[j]
        speed = t.input.v[j]
        row = model.joints[j]
        if abs(speed) > largest_ratio * row.speed_max:
            fast_joint = j
            largest_ratio = abs(speed) / row.speed_max
        stopping_position = position + speed * (model.reaction + row.brake * abs(speed))
        if (stopping_position > row.upper and position <= row.upper) or (
            stopping_position < row.lower and position >= row.lower
        ):
            ending_joint = j
    # evidence: ticks above the speed limit, weighted by the excess, and time before an end stop
    weight = 1 + int(_FASTER * min(largest_ratio - 1.0, _MOST))
    n_ticks = 1 + memory.gap
    change = weight if fast_joint >= 0 else -1
    memory.overspeed = max(memory.overspeed + n_ticks * change, 0)
    memory.ending = collect(memory.ending, n_ticks * model.period, ending_joint >= 0)
    if memory.ending > max(SURE, 1.5 * model.period):
        memory.culprit = ending_joint
        return NEAR_END
    if memory.overspeed > model.fast_ticks:
        memory.culprit = fast_joint
        return OVERSPEED
    return NO_REASON


@inner
def watch_contacts(t):
    """Return a reason if a contact is lost, is overloaded, or takes too much power.

    The first two are judged for each kept column of N (`_watch_column`). The power Σ α_k v_k is
    summed over the columns k that are pressed and move into their faces, with the measured force
    α_k (N) and the speed v_k = (NᵀV_rel)_k (m/s); more than `contact_power` stops the arms.

    Reads `alpha_meas` and `speed`. Updates in MEMORY `powered` (s with too much power, less s
    without), and the fields of `_watch_column`; fills `culprit` (index of the column) if a contact
    is lost or overloaded.

    Args:
        t: Tick.

    Returns:
        `CONTACT_LOST` or `OVERFORCE` of the first column with either, `POWERED`, or `NO_REASON`.
    """
    model = t.model
    work = t.work
    memory = t.memory
    power = 0.0
    dt = model.period * (1 + memory.gap)
    for a in range(work.rank):
        alpha = work.alpha_meas[a]
        speed = work.speed[a]
        if alpha > 0.0 and speed > 0.0:
            power += alpha * speed
        reason = _watch_column(t, a, dt)
        if reason != NO_REASON:
            memory.culprit = work.kept[a]
            return reason
    memory.powered = collect(memory.powered, dt, power > model.contact_power)
    if memory.powered > max(SURE, 1.5 * model.period):
        return POWERED
    return NO_REASON


@leaf
def _watch_column(t, a, dt):
    """Update the evidence of too little and of too much force of a column; return a reason to stop.

    A contact is lost (or a sensor is faulty) after `contact_loss_time` in which less than `_SHARE`
    times a command above `_LIGHT` is measured (without contact phases), or in which the force
    integral is above the share `_FULL` of its bound. A column without a command, such as one of a
    hole that holds a peg at zero force, has no force to lose: its integral is at the bound where a
    force remains that the bound cannot cancel, for example at a wedged peg. The time counts only in
    the state RUN or while ticks are missing. With contact phases a contact is also lost if it is
    not regained within `regain_time`. It is overloaded after `overforce_time` above `_OVERFORCE`
    times its command or above `contact_force`, whichever is larger.

    The integral is judged only while the kept columns are those of the last tick (`force_rank`,
    `by_column`). Reads `alpha_meas`, `alpha_d`, and in MEMORY the force integral `force_sum`,
    `state`, `faults`, and `time_since_loss` of the column. Updates its `underforce` and `overforce`
    (s).

    Args:
        t: Tick.
        a: index of the column among the kept ones.
        dt: time since the last computed tick (s).

    Returns:
        `CONTACT_LOST`, `OVERFORCE` or `NO_REASON`.
    """
    model = t.model
    work = t.work
    memory = t.memory
    alpha = work.alpha_meas[a]
    desired = work.alpha_d[a]
    row = memory.columns[work.kept[a]]
    command = abs(desired)
    # too little force
    pressing = alpha if desired > 0.0 else -alpha  # measured force along the desired one
    is_missing = command > _LIGHT and pressing < _SHARE * command
    is_missing = is_missing and model.phased == 0
    if command > 0.0 and memory.force_rank == work.rank and memory.by_column == 0:
        integral_limit = _FULL * integral_room(model.integral_force, desired)
        is_missing = is_missing or abs(memory.force_sum[a]) > integral_limit
    is_judged = memory.state == RUN or memory.faults > 0
    row.underforce = collect(row.underforce, dt, is_missing and is_judged)
    # too much force
    force_limit = max(_OVERFORCE * command, model.contact_force)
    row.overforce = collect(row.overforce, dt, abs(alpha) > force_limit)
    if row.underforce > model.contact_loss_time or row.time_since_loss > model.regain_time:
        return CONTACT_LOST
    if row.overforce > model.overforce_time:
        return OVERFORCE
    return NO_REASON


# --- A tick that cannot be computed: repeat, hold the posture, stop -------------------------------
#
# RUN       computed without restrictions
# DEGRADED  computed with motors at their limits, near a singular posture or without wrenches; or
#           not computed for a tick or two, in which the last torques are repeated
# HOLD      not computed: gravity compensation and damping at the last measured posture
# SAFE_STOP not computed for too long or too often, or a limit of the robot is exceeded, or a sensor
#           is faulty (`sensors`): the arms are braked to rest, then held, until a reset

_RECENT = 0.5  #: s, time constant of the share of ticks that are not computed


@inner
def guard(t, reason, sensor_reason):
    """Update the controller's state, and compute torques if the law could not.

    Joint states are estimated from sound readings in every tick. Of a tick that was not computed
    the torques are those of the last tick, in the state DEGRADED or as long as joints were never
    read; else those of `hold_posture`. Updates in MEMORY the ages of readings `wrench_age`,
    `old_joints` and `old_wrists` (ticks), q and v, `missed` (share of ticks that were not
    computed), `gap` (ticks since the last computed one), and the fields of the functions called
    here, among them `state` and `cause`; fills `tau` of WORK in a tick that was not computed.

    Args:
        t: Tick after `check_sensors`.
        reason: reason why the tick was not computed; NO_REASON if it was.
        sensor_reason: reason of `check_sensors`, or NO_REASON.
    """
    model = t.model
    memory = t.memory
    memory.wrench_age = memory.wrench_age + 1 if memory.wrench_missing else 0
    memory.old_joints = memory.old_joints + 1 if memory.repeated & JOINTS else 0
    memory.old_wrists = memory.old_wrists + 1 if memory.repeated & WRISTS else 0
    # the state of the joints from sound readings
    if reason == UNBALANCED:
        isolate_packet(t)
        isolate_posture(t)
    isolate_arms(t)
    estimate_joints(t)
    not_computed = 0.0 if reason == NO_REASON else 1.0
    memory.missed += model.period / (_RECENT + model.period) * (not_computed - memory.missed)
    if reason == NO_REASON:
        _note_computed(t)
        return
    # not computed: torques of the last tick, or of a hold
    memory.gap += 1
    _enter(t, _choose_state(t, reason, sensor_reason))
    if memory.state == DEGRADED_STATE or memory.compared == 0:
        for i in range(model.n_motors):
            t.work.tau[i] = memory.torques[i]
    else:
        hold_posture(t)


@inner
def _note_computed(t):
    """Update counts and state after a computed tick: RUN, or DEGRADED.

    The state is RUN if the status is OK or HOPPING and the tick had wrenches. Fills in MEMORY `gap`
    (0), `has_wrench` (1), and `repeats`, the number of ticks for which torques may be repeated now
    (0 after a saturated tick), and the fields of the functions called here.

    Args:
        t: Tick.
    """
    work = t.work
    memory = t.memory
    memory.gap = 0
    _note_accelerations(t)
    memory.has_wrench = 1
    # a saturated tick is counted by `saturation.settle`; after it no torques are repeated
    if work.status != SATURATED:
        count_computed(t)
    memory.repeats = t.model.repeats if work.status != SATURATED else 0
    is_ok = work.status == OK or work.status == HOPPING
    is_ok = is_ok and memory.wrench_missing == 0
    _enter(t, RUN if is_ok else DEGRADED_STATE)


@inner
def _choose_state(t, reason, sensor_reason):
    """Choose the state of the controller after a tick that was not computed.

    It is DEGRADED for the first `repeats` ticks, in which torques are repeated; then HOLD. It is
    SAFE_STOP after `fault_ticks` such ticks, less computed ones since, or at once for a cause that
    cannot pass by itself (≥ `LASTING`). A stop lasts until a reset. The cause is the sensor fault
    if there is one, else MISSED if more than `missed_share` of the last ticks were not computed,
    else the reason of the tick. Updates `faults`, `lost` and `cause` of MEMORY, except while
    stopped.

    Args:
        t: Tick.
        reason: reason of the tick.
        sensor_reason: reason of `check_sensors`, or NO_REASON.

    Returns:
        `SAFE_STOP`, `HOLD` or `DEGRADED_STATE`.
    """
    memory = t.memory
    if memory.state == SAFE_STOP:
        return SAFE_STOP
    memory.faults += 1
    memory.lost += 1
    cause = sensor_reason
    if cause == NO_REASON:
        cause = MISSED if memory.missed > t.model.missed_share else reason
    memory.cause = cause
    if memory.lost < t.model.fault_ticks and cause < LASTING:
        return HOLD if memory.faults > memory.repeats else DEGRADED_STATE
    return SAFE_STOP


@inner
def _note_accelerations(t):
    """Store the commanded accelerations of a computed tick, and which joints must move by them.

    Fills of the joints in MEMORY `acceleration` (rad/s², m/s²) and `driven`: 1 if the position is
    constant although dry friction cannot hold the joint against the command.

    Args:
        t: Tick.
    """
    is_dead = stopped_abruptly(t)
    for k in range(t.model.n_arms):
        arm = t.model.arms[k]
        for j in range(arm.first, arm.end):
            joint_memory = t.memory.joints[j]
            joint_memory.acceleration = t.work.joints[j].acceleration
            is_driven = joint_memory.rested > 0.0 and (is_dead or must_move(t, arm, j))
            joint_memory.driven = 1 if is_driven else 0


@leaf
def count_computed(t):
    """Reset the count of consecutive ticks that were not computed, and reduce `lost` by one.

    `lost` counts ticks that were not computed less computed ones, at least 0.

    Args:
        t: Tick that was computed; `faults` and `lost` of MEMORY are changed.
    """
    memory = t.memory
    memory.faults = 0
    memory.lost = max(memory.lost - 1, 0)


@inner
def _enter(t, state):
    """Set the state of the safety layer, and reset what belongs to a change of state.

    `age` of MEMORY counts the ticks in the state. At a change from RUN or DEGRADED to HOLD or
    SAFE_STOP the holds are no longer settled, the load of each arm is weighed anew, and the gaps
    between arms count as not measured: their next change is not that of a single tick. Fills in
    MEMORY `state` and `age`; in this change `settled`, and `weighed` and `gap` of the arms, become
    0.

    Args:
        t: Tick.
        state: new state, such as `records.HOLD`.
    """
    memory = t.memory
    if memory.state == state:
        memory.age += 1
        return
    if state >= HOLD and memory.state < HOLD:
        memory.settled = 0
        for k in range(t.model.n_arms):
            memory.arms[k].weighed = 0
            memory.arms[k].gap = 0.0
    memory.state = state
    memory.age = 1
