"""What happens when a tick cannot be computed: repeat, hold the posture, stop.

RUN       computed, nothing lost
DEGRADED  motors at their limits or a singular posture near; or not computed, for a tick or two:
          the last torques go on
HOLD      not computed: gravity compensation and damping at the last posture that was read
SAFE_STOP not computed for too long or too often, a limit of the robot is passed, see `watch`, or a
          sensor is faulty, see `sensors`: braked to rest, then held; ends by a reset only
"""

from __future__ import annotations

from math import isfinite

from osc_contact.law.algebra import cross
from osc_contact.law.arm_motion import move_arm, place_arm, place_point
from osc_contact.law.energy import carry_wrench
from osc_contact.law.jit import inner, leaf
from osc_contact.law.phases import slew
from osc_contact.law.sensors import check_sensors, estimate_joints
from osc_contact.law.tables import (
    DEGRADED_STATE,
    HOLD,
    NO_REASON,
    OK,
    OVERSPEED,
    RUN,
    SAFE_STOP,
    SATURATED,
)

__all__ = ["BRAKE_RATE", "count_computed", "guard"]

_AT_REST = 0.02  #: rad/s, m/s: below it a braked joint is held where it is
_BRAKING = 0.3  #: s; a joint that still moves then is held all the same
_LEAST = 0.1  #: share of the brakes that is left where motors can hardly carry the arm
BRAKE_RATE = 40.0  #: 1/s: torques of a hold move from the last ones by their limit times this
_HASTE = 4.0  #: times that, where a joint is above its speed limit


@inner
def guard(
    chain, arms, table, work, memory, joints, joint_memory, arm_memory, estimate, last_wrenches,
    step, q, v, wrenches, last, tau, first, reason,
):  # fmt: skip
    """The state after this tick, and the torques of one that was not computed; its reason.

    Args:
        chain, arms, table: CHAIN record, ARM and JOINT rows. work, memory: records.
        joints: JOINT_WORK rows; those of a tick that is held lose placements, h and M.
        joint_memory, arm_memory: JOINT_MEMORY and ARM_MEMORY rows.
        estimate: (2 n,) of MEMORY: joint positions and speeds, see `sensors.estimate_joints`.
        last_wrenches: (6 arms,) of MEMORY: wrenches last read.
        step: (motors,) scratch. q, v: (n,) and wrenches: (arms, 6) as they came in.
        last: (motors,) torques of the last tick, tau[first:] of this.
        reason: of the tick so far.
    """
    memory.wrench_age = memory.wrench_age + 1 if memory.wrench_missing != 0 else 0
    cause = check_sensors(
        chain, arms, table, memory, joint_memory, arm_memory, last_wrenches, q, v, wrenches
    )
    estimate_joints(chain, table, memory, joint_memory, estimate)
    if reason == NO_REASON:
        memory.gap = 0
        for j in range(chain.n_joints):
            joint_memory[j].acceleration = joints[j].acceleration
        memory.has_wrench = 1
        if work.status != SATURATED:  # then the motor limits still have to be met
            count_computed(memory)
        memory.repeats = chain.repeats if work.status != SATURATED else 0
        fine = work.status == OK and memory.wrench_missing == 0
        _enter(memory, RUN if fine else DEGRADED_STATE)
        if cause != NO_REASON:  # these torques still are good: the next tick stops
            memory.cause = cause
            _enter(memory, SAFE_STOP)
        return NO_REASON
    memory.gap += 1
    if memory.state == SAFE_STOP:
        _enter(memory, SAFE_STOP)
    else:
        memory.faults += 1
        memory.lost += 1
        memory.cause = reason if cause == NO_REASON else cause
        if memory.lost >= chain.fault_ticks or memory.cause >= OVERSPEED:
            _enter(memory, SAFE_STOP)
        elif memory.faults > memory.repeats:
            _enter(memory, HOLD)
        else:
            _enter(memory, DEGRADED_STATE)
    if memory.state == DEGRADED_STATE or memory.compared == 0:
        for i in range(chain.n_motors):
            tau[first + i] = last[i]
    else:
        _hold_posture(
            chain, arms, table, work, memory, joints, joint_memory, estimate, step, last, tau, first
        )
    return reason


@leaf
def count_computed(memory):
    """Note that a tick was computed: no faults in a row, one less among the last ones."""
    memory.faults, memory.lost = 0, max(memory.lost - 1, 0)


@inner
def _enter(memory, state):
    if memory.state == state:
        memory.age += 1
        return
    if state >= HOLD and memory.state < HOLD:
        memory.settled = 0
    memory.state, memory.age = state, 1


@inner
def _hold_posture(
    chain, arms, table, work, memory, joints, joint_memory, estimate, step, last, tau, first
):
    """τ = h + M(−2ω q̇ − ω²(q − q_hold)) + Jᵀw, h and M with the arms' shares of the object in w.

    While joints are braked, q_hold moves with them; what moves on for longer creeps under a weight
    that is not quite known. Where motors cannot exert it the second part is scaled down as a whole;
    q_hold follows there, too, so that it takes energy from the joints. Torques move in a straight
    line from the last ones, no motor faster than `BRAKE_RATE` allows, or a joint that is above its
    speed limit, or needs all of its motor, makes necessary.
    """
    n = chain.n_joints
    q, speed = estimate[:n], estimate[n:]
    if memory.settled == 0:
        fast = False
        for j in range(n):
            fast = fast or abs(speed[j]) > _AT_REST
            joint_memory[j].hold = q[j]
        memory.settled = 0 if fast and memory.age * chain.period < _BRAKING else 1
    origin, V, gamma, bias = work.u, work.w, work.y, work.z
    for k in range(chain.n_arms):
        arm = arms[k]
        for i in range(6):
            origin[i] = bias[i] = 0.0
        place_arm(table, joints, arm.first, arm.end, q)
        move_arm(arm, table, joints, speed, origin, chain.gravity, work.s, work.t, V, gamma, bias)
    mass = _carry_weight(chain, arms, memory, joints, work)
    omega, fastest = chain.hold_rate, min(BRAKE_RATE, chain.torque_rate)
    for j in range(n):
        if abs(speed[j]) > table[j].speed_max:
            fastest = min(_HASTE * BRAKE_RATE, chain.torque_rate)
        back = omega * (q[j] - joint_memory[j].hold)
        joints[j].acceleration = -omega * (2.0 * speed[j] + back)
    for k in range(chain.n_arms):
        share = _split_torques(chain, arms[k], table, joints, work, mass)
        rate = fastest if share == 1.0 else min(_HASTE * BRAKE_RATE, chain.torque_rate)
        for j in range(arms[k].first, arms[k].end):
            joint_memory[j].acceleration = share * joints[j].acceleration
            if share < 1.0:
                joint_memory[j].hold = q[j]
            motor, most = table[j].motor, table[j].tau_max
            if motor >= 0:
                s = min(max(joints[j].tau + share * joints[j].rest, -most), most)
                tau[first + motor] = s if isfinite(s) else last[motor]
                step[motor] = rate * chain.period * most
    out = tau[first : first + chain.n_motors]
    if memory.ticked != 0:
        slew(out, last, step, chain.n_motors)
    for i in range(chain.n_motors):
        last[i] = out[i]


@inner
def _split_torques(chain, arm, table, joints, work, mass):
    """`tau`: what carries a resting arm and its share of the object; `rest`: what accelerates both
    by q̈; how much of this the motors bear.

    Where they do not bear it all, `rest` is scaled as a whole, or cut off joint by joint if this
    takes more power, −restᵀq̇, from the joints: a motor that hardly carries its part of the weight
    then leaves the brakes of the others alone. q̈ is along −q̇ there: q_hold follows q.

    Args:
        mass: kg, the arm's share of the object's. work.y: (6,) wrench that carries it, work.A: its
            principal axes as columns, work.u: (3,) its centre.
    """
    lo, share, pull = arm.first, 1.0, work.z
    _accelerate_object(chain, arm, joints, work, mass, pull)
    for j in range(lo, arm.end):
        s, brake = joints[j].h, 0.0
        for i in range(lo, arm.end):
            brake += joints[j].M[i - lo] * joints[i].acceleration
        for i in range(6):
            s += joints[j].column[i] * work.y[i]
            brake += joints[j].column[i] * pull[i]
        joints[j].tau, joints[j].rest = s, brake
        if table[j].motor >= 0 and abs(brake) > 0.0:
            most = table[j].tau_max
            room = most - s if brake > 0.0 else most + s
            share = min(share, max(room, 0.0) / abs(brake))
    share, gain = max(share, _LEAST), 0.0
    for j in range(lo, arm.end if share < 1.0 else lo):
        if table[j].motor >= 0:
            change = _clip_brake(joints[j], table[j].tau_max) - share * joints[j].rest
            gain += change * joints[j].acceleration
    for j in range(lo, arm.end if gain > 0.0 else lo):
        joints[j].rest = _clip_brake(joints[j], table[j].tau_max) / share
    return share


@leaf
def _clip_brake(joint, most):
    """As much of `rest` as a motor of `most` N m (N) bears beside `tau`."""
    low, high = min(-most - joint.tau, 0.0), max(most - joint.tau, 0.0)
    return min(max(joint.rest, low), high)


@inner
def _accelerate_object(chain, arm, joints, work, mass, out):
    """out (6,): wrench at the world's origin that lets an arm's share of the object follow q̈."""
    a, c, R = work.w, work.u, work.A
    for i in range(6):
        a[i] = out[i] = 0.0
        for j in range(arm.first, arm.end):
            a[i] += joints[j].column[i] * joints[j].acceleration
    if mass == 0.0:
        return
    x, y, z = cross(a[3], a[4], a[5], c[0], c[1], c[2])
    out[0], out[1], out[2] = mass * (a[0] + x), mass * (a[1] + y), mass * (a[2] + z)
    for b in range(3):
        along = R[0, b] * a[3] + R[1, b] * a[4] + R[2, b] * a[5]
        for i in range(3):
            out[3 + i] += R[i, b] * chain.principal[1 + b] * along / chain.n_arms
    x, y, z = cross(c[0], c[1], c[2], out[0], out[1], out[2])
    out[3], out[4], out[5] = out[3] + x, out[4] + y, out[5] + z


@inner
def _carry_weight(chain, arms, memory, joints, work):
    """y (6,) = wrench at the world's origin with which each arm carries its share of the object.

    Its principal axes go to the columns of `work.A`, its centre to `work.u`; returns the share's
    mass (kg).
    """
    out, centre, R, own = work.y, work.u, work.A, chain.X_LP
    for i in range(6):
        out[i] = centre[i] = 0.0
    known = chain.leader >= 0 or memory.located != 0
    if chain.held == 0 or not known:
        return 0.0
    if chain.leader >= 0:
        joint = joints[arms[chain.leader].tip_joint]
        place_point(joint, own, 9, centre)
        for i in range(3):
            for b in range(3):
                R[i, b] = 0.0
                for j in range(3):
                    R[i, b] += joint.R[i, j] * own[3 * j + b]
    else:
        for i in range(3):
            centre[i] = memory.X_WO[i, 3]
            for j in range(3):
                centre[i] += memory.X_WO[i, j] * own[9 + j]
            for b in range(3):
                R[i, b] = 0.0
                for j in range(3):
                    R[i, b] += memory.X_WO[i, j] * own[3 * j + b]
    mass = chain.principal[0] / chain.n_arms
    for i in range(3):
        out[i] = -mass * chain.gravity[i]
        work.w[i] = 0.0
    carry_wrench(out, centre, work.w, out)
    return mass
