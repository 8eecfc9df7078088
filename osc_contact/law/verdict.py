"""The end of a tick that could be computed: its verdict, its torques, and what is remembered."""

from __future__ import annotations

from math import isfinite

from osc_contact.law import phases
from osc_contact.law.allocation import limit_torques
from osc_contact.law.columns import spread_magnitudes
from osc_contact.law.jit import inner
from osc_contact.law.six import fill
from osc_contact.law.steps import keep_steps
from osc_contact.law.tables import DEGRADED, NO_REASON, NOT_FINITE, OK, SATURATED


@inner
def finish(t):
    """The verdict, the torques and the memory of a tick that could be computed; a reason."""
    model = t.model
    work = t.work
    last = t.memory.torques
    tau = t.work.tau
    excess, finite = limit_torques(t)
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
        if t.memory.ticked != 0:
            phases.limit_changes(t)
        for i in range(model.n_motors):
            last[i] = tau[i]
    remember(t)
    return NO_REASON


@inner
def remember(t):
    """The integrals move on; phases keep what was measured."""
    work = t.work
    memory = t.memory
    columns = t.work.columns
    column_memory = t.memory.columns
    r = work.rank
    memory.ticked = memory.ticked + 1
    memory.fresh = 1
    memory.located = 1
    memory.more_friction = work.more_friction
    for i in range(4):
        for j in range(4):
            memory.X_WO[i, j] = work.X_WO[i, j]
    if work.status != SATURATED:
        for a in range(r):
            memory.force_sum[a] = work.force_next[a]
        memory.force_rank = r
        if work.status == OK:
            fill(memory.motion_sum, work.motion_next)
    n = t.model.n_columns
    here = work.here
    alpha = work.alpha
    speed = work.speeds
    for j in range(n):
        here[j] = alpha[j] = speed[j] = 0.0
    spread_magnitudes(t, work.alpha, work.speeds)
    for j in range(n):
        column_memory[j].alpha = alpha[j]
        column_memory[j].speed = speed[j]
    for j in range(work.count):
        here[columns[j].chosen] = 1.0
        work.chosen[j] = columns[j].chosen
    keep_steps(t)
    if t.model.phased == 0:
        return
    phases.low_pass(t, r == work.count and work.weightless == 0)
