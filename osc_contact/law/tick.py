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

from osc_contact.law.allocation import allocate_torques, predict_joints
from osc_contact.law.chain import solve_chain
from osc_contact.law.columns import choose_columns
from osc_contact.law.energy import carry_motion
from osc_contact.law.internal import internal_forces
from osc_contact.law.jit import entry, inner, matrix, numbers, prefetch
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
    set_wishes,
    take_in,
)
from osc_contact.law.tables import (
    BAD_INPUT,
    HELD,
    MOST_LOST,
    NO_REASON,
    OBJECT_UNKNOWN,
    OK,
    SAFE_STOP,
    SATURATED,
    STOPPED,
    read_arm_memory,
    read_arm_work,
    read_arms,
    read_bodies,
    read_body_work,
    read_chain,
    read_column_memory,
    read_column_work,
    read_columns,
    read_contact_memory,
    read_joint_memory,
    read_joint_work,
    read_joints,
    read_memory,
    read_pairs,
    read_shapes,
    read_work,
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

LOOK, MEASURE, COMMAND, ALLOCATE, END, HAND_OVER = range(6)
#: flags: bodies move; internal forces of three arms and more are commanded; α_u, a_u are given;
#: how many columns N has is not known yet
MOVING, COMMANDED, PARTIAL = 1, 2, 16
MISFIT, NO_WISHES = 64, 128  # set inside: sizes of what came in; of alpha_d


@inner
def _row(
    model, at, memory_bytes, memory_at, work_bytes, q, v, wrenches, X_WD, V_D, A_D, alpha_d,
    squeeze, touched, flags, tau, first, begin, stop,
):  # fmt: skip
    """One controller; returns its status. `first`: of its torques in tau."""
    chain = read_chain(model, at, 1)[0]
    k, n, c, r_all = chain.n_arms, chain.n_joints, chain.n_contacts, chain.n_columns
    arms = read_arms(model, at + chain.arms_at, k)
    table = read_joints(model, at + chain.joints_at, n)
    pairs = read_pairs(model, at + chain.pairs_at, c)
    shapes = read_shapes(model, at + chain.shapes_at, chain.n_shapes)
    owners = read_columns(model, at + chain.columns_at, r_all)
    bodies = read_bodies(model, at + chain.bodies_at, c)
    memory = read_memory(memory_bytes, memory_at, 1)[0]
    contacts = read_contact_memory(memory_bytes, memory_at + chain.contact_memory_at, c)
    column_memory = read_column_memory(memory_bytes, memory_at + chain.column_memory_at, r_all)
    last = numbers(memory_bytes, memory_at + chain.torque_memory_at, chain.n_motors)
    joint_memory = read_joint_memory(memory_bytes, memory_at + chain.joint_memory_at, n)
    arm_memory = read_arm_memory(memory_bytes, memory_at + chain.arm_memory_at, k)
    estimate = numbers(memory_bytes, memory_at + chain.estimate_at, 2 * n)
    last_wrenches = numbers(memory_bytes, memory_at + chain.last_wrenches_at, 6 * k)
    if memory.wrench_missing != 0:
        wrenches = matrix(last_wrenches, 0, k, 6)
    work = read_work(work_bytes, 0, 1)[0]
    arm_work = read_arm_work(work_bytes, chain.arm_work_at, k)
    joints = read_joint_work(work_bytes, chain.joint_work_at, n)
    columns = read_column_work(work_bytes, chain.column_work_at, r_all)
    body_work = read_body_work(work_bytes, chain.body_work_at, c)
    locked = matrix(numbers(work_bytes, chain.locked_at, 42 * k), 0, 6 * k, 7)
    extra = numbers(work_bytes, chain.extra_at, (chain.link_at - chain.extra_at) // 8)
    link = numbers(work_bytes, chain.link_at, (chain.flat_at - chain.link_at) // 8)
    flat = numbers(work_bytes, chain.flat_at, (chain.jacobian_at - chain.flat_at) // 8)
    J_world = matrix(numbers(work_bytes, chain.jacobian_at, 6 * n), 0, n, 6)
    moving = flags & MOVING != 0
    reason = NO_REASON
    if begin == LOOK:
        work.status, work.commanded = OK, 1 if flags & COMMANDED != 0 else 0
        work.moving = 1 if moving else 0
        work.rank, work.count = 0, 0
        lost = memory.gap if memory.ticked != 0 else 0  # nothing passes before the first tick
        work.dt = chain.period * (1 + min(lost, MOST_LOST))
        engaged = memory.engaged != 0 and c > 0
        misfit = engaged and flags & NO_WISHES != 0
        engaged = engaged and not misfit
        if flags & MISFIT != 0 or (misfit and flags & PARTIAL == 0) or not is_finite(
            chain, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, touched, engaged, moving
        ):  # fmt: skip
            reason = BAD_INPUT
        elif memory.state == SAFE_STOP:
            reason = STOPPED
        elif chain.guarded != 0:
            reason = check_readings(chain, arms, table, memory, joint_memory, q, v, wrenches, X_WD)
        if reason != NO_REASON:
            pass
        elif chain.leader < 0 and memory.located == 0:
            reason = OBJECT_UNKNOWN
        else:
            take_in(
                chain, work, arm_work, joints, columns, body_work, q, v, wrenches, X_WD, V_D, A_D,
                alpha_d, touched, engaged, moving,
            )  # fmt: skip
            for j in range(r_all):
                flat[j] = alpha_d[j] if engaged else 0.0
            if chain.phased != 0 and engaged:
                advance_contacts(chain, bodies, owners, memory, contacts, column_memory, work, flat)
            choose_columns(chain, owners, contacts, columns, work)
            reason = solve_chain(chain, arms, table, memory, work, arm_work, joints, locked, q, v)
            for i in range(3):
                work.u[i] = 0.0
            for j in range(n):
                carry_motion(joints[j].column, work.C, work.u, J_world[j])
    elif begin == HAND_OVER:
        hand_over(chain, work, memory)
        return work.status
    elif work.status == HELD:
        reason = work.reason
    if begin <= MEASURE < stop and reason == NO_REASON:
        reason = measure(
            chain, arms, pairs, shapes, owners, bodies, contacts, work, arm_work, joints,
            columns, column_memory, body_work, memory, wrenches, touched, moving, flat,
        )  # fmt: skip
        if reason == NO_REASON:
            set_wishes(chain, owners, contacts, memory, column_memory, columns, work, flat, flags)
            reason = compare_poses(chain, work, X_WD)
    if begin <= COMMAND < stop and reason == NO_REASON:
        reason = command(chain, arms, table, work, arm_work, joints, memory, q, v, V_D, A_D, flags)
        if reason == NO_REASON:
            reason = watch_joints(chain, table, memory, q, v)
        if reason == NO_REASON and chain.guarded != 0:
            reason = check_arms(
                chain, arms, table, memory, work, arm_work, joints, joint_memory, last
            )
        if reason == NO_REASON and work.rank > 0:
            reason = watch_contacts(chain, work, memory, columns, column_memory)
    if begin <= ALLOCATE < stop and reason == NO_REASON:
        predict_joints(chain, arms, work, joints)
        reason = allocate_torques(
            chain, arms, table, work, arm_work, joints, extra, link, squeeze, q, v
        )
        if reason == NO_REASON:
            reason = finish(
                chain, table, work, memory, joints, columns, column_memory, owners, contacts,
                flat, last, tau, first,
            )  # fmt: skip
            if k > 2:
                internal_forces(
                    chain, work, joints, link, numbers(work_bytes, chain.bars_at, chain.n_bars)
                )
    if reason != NO_REASON or stop == END:
        reason = guard(
            chain, arms, table, work, memory, joints, joint_memory, arm_memory, estimate,
            last_wrenches, flat[5 * r_all :], q, v, wrenches, last, tau, first, reason,
        )  # fmt: skip
        memory.wrench_missing = memory.repeated = memory.derived = 0
    work.reason = memory.reason = reason
    if reason != NO_REASON:
        work.status = HELD
    return work.status


@entry
def rows(model, memory, work, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, touched,
         flags, tau, codes, begin, stop, lo, hi):  # fmt: skip
    """Controllers lo … hi − 1, each from part `begin` to before part `stop`.

    Returns after a tick that ends SATURATED: its `work` says what motor limits must know.

    Args:
        model, memory: bytes of all rows (one row of `model` serves all of them).
        work: bytes, scratch and what the last row worked out.
        q, v, V_D, A_D, alpha_d, squeeze: of all rows, one behind the other.
        wrenches: (rows · arms, 6). X_WD: (rows · 4, 4). touched: (rows · contacts, 28).
        flags: MOVING, COMMANDED, OWN_FORCE, OWN_MOTION.
        tau: (rows · motors,), filled. codes: (rows,) status, filled.
        begin, stop: the first part, and the one behind the last.
        lo, hi: the first row, and the one behind the last.

    Returns:
        Twice the row to go on with (hi when all are done), plus 1 if some row did not end OK.
    """
    amiss = 0
    head = read_chain(model, 0, 1)[0]
    step = head.row_bytes if model.size > head.row_bytes else 0
    n, k, c, r = head.n_joints, head.n_arms, head.n_contacts, head.n_columns
    s, a = max(head.n_bars, 1), head.n_motors
    count = codes.size
    fits = q.size == count * n and v.size == count * n and V_D.size == 6 * count
    fits = fits and wrenches.shape[0] == count * k and wrenches.shape[1] == 6
    fits = fits and X_WD.shape[0] == 4 * count and X_WD.shape[1] == 4
    fits = fits and A_D.size == 6 * count and squeeze.size == count * s
    fits = fits and touched.shape[0] == count * c and touched.shape[1] == 28
    n_q, n_v = n if q.size == count * n else 0, n if v.size == count * n else 0
    if not fits:
        flags |= MISFIT
    elif alpha_d.size != count * r:
        flags |= NO_WISHES
    for i in range(lo, hi):
        if i + 1 < hi:
            prefetch(model, (i + 1) * step, step)
            prefetch(memory, (i + 1) * head.memory_bytes, head.memory_bytes)
        codes[i] = _row(
            model, i * step, memory, i * head.memory_bytes, work,
            q[i * n_q : (i + 1) * n_q], v[i * n_v : (i + 1) * n_v],
            wrenches[i * k : (i + 1) * k],
            X_WD[4 * i : 4 * i + 4], V_D[6 * i : 6 * i + 6], A_D[6 * i : 6 * i + 6],
            alpha_d[i * r : (i + 1) * r], squeeze[i * s : (i + 1) * s],
            touched[i * c : (i + 1) * c], flags, tau, i * a, begin, stop,
        )  # fmt: skip
        amiss |= codes[i] != OK
        if codes[i] == SATURATED:
            return 2 * (i + 1) + 1
    return 2 * hi + amiss
