"""The whole control tick, fig. 4: measurement in, motor torques out.

`rows` runs any number of controllers, one a row of the tables: a single tick is one row, a batch
many, on as many threads as there are chunks [lo, hi). Nothing is kept but MEMORY; WORK holds what
the last row worked out. A tick has four parts, so that Python may step in between them:

    LOOK      what came in and whether it is believed, phases of the contacts, the closed chain
    MEASURE   N and n_γ, what the bodies do along N, the force filter of fig. 5, the pose error
    COMMAND   force law, motion law, motion filter (24), control structure (21), the robot's limits
    ALLOCATE  motor torques, verdict, memory

HAND_OVER by itself turns what the motion integral has learnt into a constant wrench.
"""

from __future__ import annotations

from math import nan

from osc_contact.law.allocation import allocate_torques, predict_joints
from osc_contact.law.chain import solve_chain
from osc_contact.law.columns import choose_columns
from osc_contact.law.energy import carry_motion
from osc_contact.law.internal import internal_forces
from osc_contact.law.jit import entry, inner, leaf, prefetch
from osc_contact.law.layout import row_of
from osc_contact.law.safety import guard
from osc_contact.law.sensors import check_arms, check_readings
from osc_contact.law.stages import (
    OWN_FORCE,
    OWN_MOTION,
    advance_contacts,
    command,
    compare_poses,
    hand_over,
    is_finite,
    measure,
    set_desired_forces,
    take_in,
)
from osc_contact.law.tables import (
    ALLOCATE,
    BAD_INPUT,
    COMMAND,
    END,
    HAND_OVER,
    HELD,
    JOB,
    LOOK,
    MEASURE,
    MODEL,
    MOST_LOST,
    NO_REASON,
    OBJECT_UNKNOWN,
    OK,
    SAFE_STOP,
    SATURATED,
    STOPPED,
)
from osc_contact.law.verdict import finish
from osc_contact.law.watch import watch_contacts, watch_joints

__all__ = [
    "ALLOCATE",
    "COMMAND",
    "COMMANDED",
    "END",
    "HAND_OVER",
    "LOOK",
    "MEASURE",
    "MISFIT",
    "MOVING",
    "OWN_FORCE",
    "OWN_MOTION",
    "PARTIAL",
    "rows",
]

#: flags: bodies move; internal forces of three arms and more are commanded; α_u, a_u are given;
#: how many columns N has is not known yet
MOVING, COMMANDED, PARTIAL = 1, 2, 16
MISFIT, NO_FORCES = 64, 128  # set inside: sizes of what came in; of alpha_d

_job, _model = JOB.at, MODEL.at


@inner
def _row(t, flags, begin, stop):
    """One controller; returns its status."""
    model = t.model
    memory = t.memory
    work = t.work
    reason = NO_REASON
    if begin == LOOK:
        reason = _look(t, flags)
    elif begin == HAND_OVER:
        hand_over(t)
        return work.status
    elif work.status == HELD:
        reason = work.reason
    if begin <= MEASURE < stop and reason == NO_REASON:
        reason = measure(t)
        if reason == NO_REASON:
            set_desired_forces(t, flags)
            reason = compare_poses(t)
    if begin <= COMMAND < stop and reason == NO_REASON:
        reason = command(t, flags)
        if reason == NO_REASON:
            reason = watch_joints(t)
        if reason == NO_REASON and model.guarded != 0:
            reason = check_arms(t)
        if reason == NO_REASON and work.rank > 0:
            reason = watch_contacts(t)
    if begin <= ALLOCATE < stop and reason == NO_REASON:
        predict_joints(t)
        reason = allocate_torques(t)
        if reason == NO_REASON:
            reason = finish(t)
            if model.n_arms > 2:
                internal_forces(t)
    if reason != NO_REASON or stop == END:
        reason = guard(t, reason)
        memory.wrench_missing = memory.repeated = memory.derived = 0
    work.reason = memory.reason = reason
    if reason != NO_REASON:
        work.status = HELD
    return work.status


@inner
def _look(t, flags):
    """Whether what came in is believed, phases of the contacts, the closed chain; a reason."""
    model = t.model
    memory = t.memory
    work = t.work
    work.status = OK
    work.commanded = 1 if flags & COMMANDED != 0 else 0
    work.moving = t.input.moving
    work.rank = 0
    work.count = 0
    lost = memory.gap if memory.ticked != 0 else 0  # nothing passes before the first tick
    work.dt = model.period * (1 + min(lost, MOST_LOST))
    engaged = memory.engaged != 0 and model.n_contacts > 0
    misfit = engaged and flags & NO_FORCES != 0
    engaged = engaged and not misfit
    if (
        flags & MISFIT != 0
        or (misfit and flags & PARTIAL == 0)
        or not is_finite(t, engaged, work.moving != 0)
    ):
        return BAD_INPUT
    if memory.state == SAFE_STOP:
        return STOPPED
    if model.guarded != 0:
        reason = check_readings(t)
        if reason != NO_REASON:
            return reason
    if model.leader < 0 and memory.located == 0:
        return OBJECT_UNKNOWN
    take_in(t, engaged, work.moving != 0)
    for j in range(model.n_columns):
        work.goal[j] = t.input.alpha_d[j] if engaged else 0.0
    if model.phased != 0 and engaged:
        advance_contacts(t)
    choose_columns(t)
    reason = solve_chain(t)
    for i in range(3):
        work.u[i] = 0.0
    for j in range(model.n_joints):
        carry_motion(work.joints[j].column, work.C, work.u, work.J_world[j])
    return reason


@leaf
def _copy(x, start, count, out):
    """out[:count] = x[start : start + count]."""
    for i in range(count):
        out[i] = x[start + i]


@leaf
def _copy_rows(x, start, count, width, out):
    """The same with rows of a matrix."""
    for i in range(count):
        for j in range(width):
            out[i, j] = x[start + i, j]


@entry
def rows(raw, at, q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched):
    """Controllers `first` … `last` − 1 of a job, each from part `begin` to before part `stop`.

    Returns after a tick that ends SATURATED: its WORK says what motor limits must know. Torques are
    in MEMORY, and how each tick ended.

    Args:
        raw: bytes of `layout.Rows`. at: where its JOB is: `first`, `last`, `begin`, `stop`;
            `switches` MOVING, COMMANDED, OWN_FORCE, OWN_MOTION.
        q, v, V_D, A_D, alpha_d: of all rows, one behind the other.
        wrenches: (rows · arms, 6). X_WD: (rows · 4, 4). touched: (rows · contacts, 28), MOVING.

    Returns:
        Twice the row to go on with (`last` when all are done), plus 1 if some row did not end OK.
    """
    job = _job(raw, at)
    flags = job.switches
    count = job.count
    head = _model(raw, job.model)
    size = head.memory_bytes
    n = head.n_joints
    k = head.n_arms
    c = head.n_contacts
    r = head.n_columns
    moving = flags & MOVING != 0
    fits_q = q.size == count * n
    fits_v = v.size == count * n
    fits_wrenches = wrenches.shape[0] == count * k and wrenches.shape[1] == 6
    fits = fits_q and fits_v and fits_wrenches
    fits = fits and X_WD.shape[0] == 4 * count and X_WD.shape[1] == 4
    fits = fits and V_D.size == 6 * count and A_D.size == 6 * count
    if moving:
        fits = fits and touched.shape[0] == count * c and touched.shape[1] == 28
    has_desired = alpha_d.size == count * r
    if not fits:
        flags |= MISFIT
    elif not has_desired:
        flags |= NO_FORCES
    violated = 0
    for i in range(job.first, job.last):
        if i + 1 < job.last:
            prefetch(raw, job.model + (i + 1) * job.model_step, job.model_step)
            prefetch(raw, job.memory + (i + 1) * size, size)
        t = row_of(raw, at, i)
        memory = t.memory
        given = t.input
        if job.begin == LOOK:
            given.moving = 1 if moving else 0
            for j in range(n):
                given.q[j] = q[i * n + j] if fits_q else nan
                given.v[j] = v[i * n + j] if fits_v else nan
            for a in range(k):
                for j in range(6):
                    if memory.wrench_missing != 0:
                        given.wrenches[a, j] = memory.wrenches[a, j]
                    else:
                        given.wrenches[a, j] = wrenches[i * k + a, j] if fits_wrenches else nan
            if fits:
                _copy_rows(X_WD, 4 * i, 4, 4, given.X_WD)
                _copy(V_D, 6 * i, 6, given.V_D)
                _copy(A_D, 6 * i, 6, given.A_D)
                if has_desired:
                    _copy(alpha_d, i * r, r, given.alpha_d)
                if moving:
                    _copy_rows(touched, i * c, c, 28, given.touched)
        status = _row(t, flags, job.begin, job.stop)
        if job.begin != HAND_OVER:
            memory.status = status
        violated |= status != OK
        if status == SATURATED:
            return 2 * (i + 1) + 1
    return 2 * job.last + violated
