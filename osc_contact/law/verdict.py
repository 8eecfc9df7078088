"""The end of a tick that could be computed: its verdict, its torques, and what is remembered."""

from __future__ import annotations

from math import isfinite

from osc_contact.law import phases
from osc_contact.law.allocation import limit_torques
from osc_contact.law.columns import spread_magnitudes
from osc_contact.law.jit import inner, integers
from osc_contact.law.steps import keep_steps
from osc_contact.law.tables import DEGRADED, NO_REASON, NOT_FINITE, OK, SATURATED

__all__ = ["finish", "remember"]


@inner
def finish(chain, table, work, memory, joints, columns, column_memory, owners, contacts, flat,
            last, tau, first):  # fmt: skip
    """The verdict, the torques and the memory of a tick that could be computed; a reason.

    Args:
        flat: (r_all,) goals (N). last: wrenches of the last tick.
        tau: torques of all rows (N m). first: element where those of this row begin.
    """
    excess, finite = limit_torques(chain, table, joints, tau, first)
    s = 0.0
    for i in range(6):
        s += 0.0 * work.motion_next[i]
    for a in range(work.rank):
        s += 0.0 * work.force_next[a]
    if not (finite and isfinite(s)):
        return NOT_FINITE
    if excess:
        work.status = SATURATED
    elif work.n_lost > 0:
        work.status = DEGRADED
    if not excess:
        if memory.ticked != 0:
            step = flat[5 * chain.n_columns :]
            rate = phases.torque_rate(chain, contacts, phases.haste(chain, table, joints))
            for j in range(chain.n_joints):
                if table[j].motor >= 0:
                    step[table[j].motor] = rate * chain.period * table[j].tau_max
            phases.slew(tau[first : first + chain.n_motors], last, step, chain.n_motors)
        for i in range(chain.n_motors):
            last[i] = tau[first + i]
    remember(chain, work, memory, columns, column_memory, owners, contacts, flat)
    return NO_REASON


@inner
def remember(chain, work, memory, columns, column_memory, table, contacts, flat):
    """The integrals move on; phases keep what was measured.

    Args:
        flat: (r_all,) goals (N).
    """
    r = work.rank
    memory.ticked, memory.fresh, memory.located = memory.ticked + 1, 1, 1
    memory.more_friction = work.more_friction
    for i in range(4):
        for j in range(4):
            memory.X_WO[i, j] = work.X_WO[i, j]
    if work.status != SATURATED:
        for a in range(r):
            memory.force_sum[a] = work.force_next[a]
        memory.force_rank = r
        if work.status == OK:
            for i in range(6):
                memory.motion_sum[i] = work.motion_next[i]
    n = chain.n_columns
    here, alpha, speed = flat[n : 2 * n], flat[2 * n : 3 * n], flat[3 * n : 4 * n]
    chosen = integers(flat, 4 * n, n)
    for j in range(n):
        here[j] = alpha[j] = speed[j] = 0.0
    spread_magnitudes(work, columns, alpha, speed)
    for j in range(n):
        column_memory[j].alpha, column_memory[j].speed = alpha[j], speed[j]
    for j in range(work.count):
        here[columns[j].chosen] = 1.0
        chosen[j] = columns[j].chosen
    keep_steps(chain, memory, column_memory, columns, work, flat, here, alpha, speed)
    if chain.phased == 0:
        return
    phases.low_pass(
        column_memory, n, here, alpha, speed, work.mobility, chosen, r,
        r == work.count and work.weightless == 0,
        work.dt, chain.lag, work.D, work.E,
    )  # fmt: skip
