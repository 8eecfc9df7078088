"""What happens when a tick cannot be computed: repeat, hold the posture, stop.

RUN       computed, nothing lost
DEGRADED  motors at their limits or a singular posture near; or not computed, for a tick or two:
          the last torques go on
HOLD      not computed: gravity compensation and damping at the last posture that was read
SAFE_STOP not computed for too long, or joints too fast for too long: braked to rest, then held;
          ends by a reset only
"""

from __future__ import annotations

from math import isfinite

from osc_contact.law.arm_motion import move_arm, place_arm, place_point
from osc_contact.law.energy import carry_wrench
from osc_contact.law.jit import inner
from osc_contact.law.tables import (
    DEGRADED_STATE,
    HOLD,
    NO_REASON,
    OK,
    RUN,
    SAFE_STOP,
    SATURATED,
    TOO_FAST,
)

__all__ = ["guard"]

_AT_REST = 0.02  #: rad/s, m/s: below it a braked joint is held where it is
_SLEW = 40.0  #: 1/s: torques of a hold move from the last ones by their limit times this


@inner
def guard(chain, arms, table, work, memory, joints, kept, q, v, last, tau, first, reason):
    """The state after this tick, and the torques of one that was not computed; its reason.

    Args:
        chain, arms, table: CHAIN record, ARM and JOINT rows. work, memory: records.
        joints: JOINT_WORK rows; those of a tick that is held lose placements, h and M.
        kept: (3 n,) of MEMORY: joint positions last read, those held, and speeds.
        q, v: (n,) as they came in. last: (motors,) torques of the last tick, tau[first:] of this.
    """
    n = chain.n_joints
    if reason == NO_REASON:
        fast = False
        for j in range(n):
            kept[j] = q[j]
            fast = fast or abs(v[j]) > table[j].speed_max
        if work.status != SATURATED:  # then the motor limits still have to be met
            memory.faults = 0
        memory.too_fast = memory.too_fast + 1 if fast else 0
        if memory.too_fast <= chain.fast_ticks:
            memory.read, memory.repeats = 1, chain.repeats if work.status != SATURATED else 0
            _enter(memory, RUN if work.status == OK else DEGRADED_STATE)
            return NO_REASON
        reason = memory.cause = TOO_FAST
        _enter(memory, SAFE_STOP)
    elif memory.state != SAFE_STOP:
        memory.faults += 1
        memory.cause = reason
        if memory.faults >= chain.fault_ticks:
            _enter(memory, SAFE_STOP)
        elif memory.faults > memory.repeats:
            _enter(memory, HOLD)
        else:
            _enter(memory, DEGRADED_STATE)
    else:
        _enter(memory, SAFE_STOP)
    read = _read_joints(chain, memory, kept, q, v)
    if memory.state == DEGRADED_STATE or not read:
        for i in range(chain.n_motors):
            tau[first + i] = last[i]
    else:
        _hold_posture(chain, arms, table, work, memory, joints, kept, last, tau, first)
    return reason


@inner
def _enter(memory, state):
    if memory.state == state:
        memory.age += 1
        return
    if state >= HOLD and memory.state < HOLD:
        memory.settled = 0
    memory.state, memory.age = state, 1


@inner
def _read_joints(chain, memory, kept, q, v):
    """Positions and speeds, as far as they can be read; whether positions ever could."""
    n, fine = chain.n_joints, True
    for j in range(n):
        fine = fine and isfinite(q[j])
    for j in range(n):
        speed = 0.0
        if isfinite(v[j]):
            speed = v[j]
        elif fine and memory.read != 0:
            speed = (q[j] - kept[j]) / chain.period
        kept[2 * n + j] = speed
    if fine:
        for j in range(n):
            kept[j] = q[j]
        memory.read = 1
    return memory.read != 0


@inner
def _hold_posture(chain, arms, table, work, memory, joints, kept, last, tau, first):
    """τ = h + M(−2ω q̇ − ω²(q − q_hold)) − the arms' shares of the object's weight.

    While joints move, q_hold moves with them. Torques within their limits, and not further from
    the last ones than `_SLEW` allows.
    """
    n = chain.n_joints
    q, goal, speed = kept[:n], kept[n : 2 * n], kept[2 * n :]
    moving = False
    for j in range(n):
        moving = moving or abs(speed[j]) > _AT_REST
    if moving and memory.settled == 0:
        for j in range(n):
            goal[j] = q[j]
    elif memory.settled == 0:
        memory.settled = 1
        for j in range(n):
            goal[j] = q[j]
    origin, V, gamma, bias = work.u, work.w, work.y, work.z
    for k in range(chain.n_arms):
        arm = arms[k]
        for i in range(6):
            origin[i] = bias[i] = 0.0
        place_arm(table, joints, arm.first, arm.end, q)
        move_arm(arm, table, joints, speed, origin, chain.gravity, work.s, work.t, V, gamma, bias)
    _carry_weight(chain, arms, memory, joints, work)
    rate = chain.hold_rate
    for k in range(chain.n_arms):
        lo, hi = arms[k].first, arms[k].end
        for j in range(lo, hi):
            motor = table[j].motor
            if motor < 0:
                continue
            s = joints[j].h
            for i in range(lo, hi):
                a = -rate * (2.0 * speed[i] + rate * (q[i] - goal[i]))
                s += joints[j].M[i - lo] * a
            for i in range(6):
                s += joints[j].column[i] * work.y[i]
            most = table[j].tau_max
            step = _SLEW * chain.period * most
            before = last[motor]
            if memory.ticked != 0:
                s = min(max(s, before - step), before + step)
            s = min(max(s, -most), most)
            tau[first + motor] = s if isfinite(s) else before
    for i in range(chain.n_motors):
        last[i] = tau[first + i]


@inner
def _carry_weight(chain, arms, memory, joints, work):
    """y (6,) = wrench at the world's origin with which each arm carries its share of the object."""
    out, centre = work.y, work.u
    for i in range(6):
        out[i] = centre[i] = 0.0
    if chain.held == 0:
        return
    if chain.leader >= 0:
        place_point(joints[arms[chain.leader].tip_joint], chain.X_LP, 9, centre)
    elif memory.located != 0:
        for i in range(3):
            centre[i] = memory.X_WO[i, 3]
            for j in range(3):
                centre[i] += memory.X_WO[i, j] * chain.X_LP[9 + j]
    else:
        return
    for i in range(3):
        out[i] = -chain.principal[0] * chain.gravity[i] / chain.n_arms
    for i in range(3):
        work.w[i] = 0.0
    carry_wrench(out, centre, work.w, out)
