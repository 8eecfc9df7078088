"""The whole control tick, fig. 4: measurement in, motor torques out.

`rows` runs any number of controllers, one a row of the tables: a single tick is one row, a batch
many, on as many threads as there are chunks [lo, hi). Nothing is kept but MEMORY; WORK holds what
the last row worked out. A tick has four parts, so that Python may step in between them:

    LOOK      what came in, phases of the contacts, the closed chain
    MEASURE   N and n_γ, what the bodies do along N, the force filter of fig. 5, the pose error
    COMMAND   force law, motion law, motion filter (24), control structure (21)
    ALLOCATE  motor torques, verdict, memory

HAND_OVER by itself turns what the motion integral has learnt into a constant wrench.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from osc_contact.law import phases
from osc_contact.law.algebra import (
    dot6,
    lu_solve,
    meet,
    reflect,
    reflect_back,
    solve_lower,
)
from osc_contact.law.allocation import (
    allocate_torques,
    command_object,
    internal_forces,
    limit_torques,
    predict_joints,
)
from osc_contact.law.chain import solve_chain
from osc_contact.law.columns import choose_columns, keep_columns
from osc_contact.law.command_filter import (
    filter_motion,
    permit_error,
    require_reachable,
    set_metric,
    turn_columns,
)
from osc_contact.law.contact import place_contacts
from osc_contact.law.energy import carry_motion, carry_wrench, energy_motion, world_wrench
from osc_contact.law.environment import answer_bodies, project_bodies, still_bodies
from osc_contact.law.force import (
    add_friction,
    command_force,
    contact_laws,
    measure_magnitudes,
    sum_readings,
)
from osc_contact.law.jit import entry, inner, integers, leaf, matrix, numbers
from osc_contact.law.motion import command_motion, pose_error
from osc_contact.law.singular import fade_motion
from osc_contact.law.tables import (
    BAD_INPUT,
    BAD_METRIC,
    BLIND,
    BY_OBJECT,
    DEGENERATE_PAIR,
    DEGRADED,
    HELD,
    NO_REASON,
    NOT_FINITE,
    OBJECT_UNKNOWN,
    OK,
    SATURATED,
    read_arm_work,
    read_arms,
    read_bodies,
    read_body_work,
    read_chain,
    read_column_memory,
    read_column_work,
    read_columns,
    read_contact_memory,
    read_joint_work,
    read_joints,
    read_memory,
    read_pairs,
    read_shapes,
    read_work,
)

__all__ = [
    "ALLOCATE",
    "COMMAND",
    "COMMANDED",
    "END",
    "HAND_OVER",
    "LOOK",
    "MEASURE",
    "MOVING",
    "OWN_FORCE",
    "OWN_MOTION",
    "PARTIAL",
    "build",
]

LOOK, MEASURE, COMMAND, ALLOCATE, END, HAND_OVER = range(6)
#: flags: bodies move; internal forces of three arms and more are commanded; α_u, a_u are given;
#: how many columns N has is not known yet
MOVING, COMMANDED, OWN_FORCE, OWN_MOTION, PARTIAL = 1, 2, 4, 8, 16
MISFIT, NO_WISHES = 64, 128  # set inside: sizes of what came in; of alpha_d


@leaf
def _check(chain, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, touched, engaged, moving):
    """Whether what came in is finite; sums side by side do not wait for one another."""
    a = b = c = d = e = 0.0
    for i in range(chain.n_joints):
        a += q[i] * 0.0
        b += v[i] * 0.0
    for k in range(chain.n_arms):
        for i in range(6):
            c += wrenches[k, i] * 0.0
    for i in range(4):
        for j in range(4):
            d += X_WD[i, j] * 0.0
    for i in range(6):
        e += V_D[i] * 0.0 + A_D[i] * 0.0
    for i in range(chain.n_columns if engaged else 0):
        e += alpha_d[i] * 0.0
    for i in range(max(chain.n_bars, 1)):
        e += squeeze[i] * 0.0
    for k in range(chain.n_contacts if moving else 0):
        for i in range(28):
            c += touched[k, i] * 0.0
    return isfinite(a + b + c + d + e)


@leaf
def _take_in(chain, work, arm_work, joints, columns, body_work, q, v, wrenches, X_WD, V_D, A_D,
             alpha_d, touched, engaged, moving):  # fmt: skip
    """What came in, for whoever looks at the signals of the tick afterwards."""
    for i in range(4):
        for j in range(4):
            work.X_WD[i, j] = X_WD[i, j]
    for i in range(6):
        work.V_D[i], work.A_D[i] = V_D[i], A_D[i]
    for j in range(chain.n_joints):
        joints[j].q, joints[j].v = q[j], v[j]
    for k in range(chain.n_arms):
        for i in range(6):
            arm_work[k].reading[i] = wrenches[k, i]
    for j in range(chain.n_columns):
        columns[j].alpha_d = alpha_d[j] if engaged else 0.0
    for c in range(chain.n_contacts if moving else 0):
        for i in range(28):
            body_work[c].motion[i] = touched[c, i]


@inner
def _advance_phases(chain, bodies, table, memory, contacts, column_memory, flat, alpha_d):
    """Open, approach and close contacts; the goals of their forces go to flat[:n]."""
    n = chain.n_columns
    goal, kept, scratch = flat[:n], flat[n : 2 * n], flat[2 * n : 3 * n]
    if memory.fresh != 0:
        changed = phases.advance_phases(
            chain, bodies, table, contacts, column_memory, alpha_d, kept
        )
        if changed:
            memory.hand_over = 1
        phases.remap_force_sums(chain, memory, table, contacts, kept, scratch)
    phases.set_goals(chain, bodies, table, contacts, alpha_d, goal)


@inner
def _measure(chain, arms, pairs, shapes, table, bodies, contacts, work, arm_work, joints,
             columns, body_work, memory, wrenches, touched, moving):  # fmt: skip
    """N, n_γ, the bodies along N, the force filter; returns a reason."""
    if work.count > 0:
        if not place_contacts(
            chain, pairs, shapes, columns, work.X_WO, work.V_O, touched, moving, work
        ):
            return DEGENERATE_PAIR
        if moving:
            answer_bodies(chain, bodies, touched, contacts, work.O, body_work, work.u)
    reason = keep_columns(table, bodies, columns, work, body_work)
    if reason != NO_REASON:
        return reason
    add_friction(chain, columns, work)
    if moving:
        project_bodies(columns, table, bodies, body_work, work)
    else:
        still_bodies(work)
    sum_readings(chain, arms, arm_work, joints, work, wrenches, memory.f_tare)
    turn_columns(work)
    f_c, r = work.f_c, work.rank
    for i in range(6):
        f_c[i] = 0.0
    if r == 0:
        return NO_REASON
    if not measure_magnitudes(chain, work):
        return BLIND
    contact_laws(table, contacts, columns, work)
    for a in range(r):
        N = columns[columns[int(work.keep[a])].chosen].N
        work.speed[a] = dot6(N, work.V_O) - work.V_N[a]
        for i in range(6):
            f_c[i] += work.alpha_meas[a] * N[i]
    return require_reachable(chain, work)


@inner
def _desire(work, columns, goal):
    """α_d (r,) of the independent columns from the goals of all."""
    r, count = work.rank, work.count
    for a in range(r):
        s = 0.0
        if r == count:
            s = goal[columns[int(work.keep[a])].chosen]
        else:
            for j in range(count):
                s += columns[j].share[a] * goal[columns[j].chosen]
        work.alpha_d[a] = s


@inner
def _see_error(chain, work, X_WD):
    """Pose error, and the part of it that the contacts permit; a reason."""
    set_metric(chain, work)
    pose_error(X_WD, work.X_WO, work.error)
    permit_error(chain, work, work.error, work.free_error, True)
    for i in range(6):
        work.motion_next[i] = work.free_error[i]
    if chain.metric != BY_OBJECT and not permit_error(
        chain, work, work.error, work.motion_next, False
    ):
        return BAD_METRIC
    return NO_REASON


@inner
def hand_over(chain, work, memory):
    """What the motion integral has learnt in free directions goes on as a constant wrench.

    That is S⁻ᵀΛ_S P_T K_i∫e, added to `f_bias`: weight errors stay balanced in directions that
    leave the motion law. The integral starts again from zero. `work` is of a tick of this chain.
    """
    m, x, f = work.locked, work.y, work.z
    for i in range(6):
        x[i] = chain.integral * memory.motion_sum[i]
        memory.motion_sum[i] = 0.0
    carry_motion(x, work.O, work.C, x)
    energy_motion(work.axes, x, x)
    reflect(work.turn, work.beta, m, x)
    for a in range(work.rank):  # what the contacts see of a locked motion is not rounded away
        work.s[a] = dot6(work.N_t[a], x)
    solve_lower(work.L_t, work.rank, work.s)
    meet(work.Q_t, work.rank, m, x, work.s)
    held = 1.0 if chain.held != 0 else 0.0
    for i in range(6):
        f[i] = 0.0
        if i >= m:
            f[i] = held * x[i]
            for j in range(m, 6):
                f[i] += work.Lambda[i, j] * x[j]
    reflect_back(work.turn, work.beta, m, f)
    world_wrench(work.axes, f, f)
    carry_wrench(f, work.C, work.O, f)
    for i in range(6):
        memory.f_bias[i] += f[i]


@inner
def _command(chain, arms, table, work, arm_work, joints, memory, q, v, V_D, A_D, flags):
    """Force law, motion law, filter and control structure; returns a reason."""
    r, dt = work.rank, chain.period
    if flags & OWN_FORCE == 0:
        for a in range(r):  # another number of columns: start again
            work.w[a] = memory.force_sum[a] if memory.force_rank == r else 0.0
        command_force(
            r, work.alpha_d, work.alpha_meas, work.speed, work.w, work.gain, work.damping,
            work.least, dt, work.force_next, work.alpha_u,
        )  # fmt: skip
    else:
        for a in range(r):
            work.force_next[a] = memory.force_sum[a] if memory.force_rank == r else 0.0
    if memory.hand_over != 0:
        memory.hand_over = 0
        hand_over(chain, work, memory)
    for i in range(6):
        work.motion_next[i] = memory.motion_sum[i] + work.motion_next[i] * dt
    if flags & OWN_MOTION == 0:
        command_motion(
            work.error, work.motion_next, V_D, A_D, work.V_O, chain.stiffness, chain.damping,
            chain.integral, work.a_u,
        )  # fmt: skip
    reason = filter_motion(chain, work)
    if reason != NO_REASON:
        return reason
    if work.n_lost > 0 and work.locked < 6:
        fade_motion(chain, arms, table, work, arm_work, joints, r, q, v)
    command_object(chain, work, memory.f_bias)
    return NO_REASON


@inner
def _remember(chain, work, memory, columns, column_memory, table, contacts, flat):
    """The integrals move on; phases keep what was measured."""
    r = work.rank
    memory.ticked, memory.fresh, memory.located = memory.ticked + 1, 1, 1
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
    if chain.phased == 0:
        return
    for j in range(work.count):
        here[columns[j].chosen] = 1.0
        chosen[j] = columns[j].chosen
    phases.low_pass(
        column_memory, n, here, alpha, speed, work.mobility, chosen, r,
        r == work.count and work.weightless == 0,
        chain.period, chain.lag, work.D, work.E,
    )  # fmt: skip


@inner
def spread_magnitudes(work, columns, alpha, speed):
    """Measured magnitudes and speeds of the kept columns, to all columns in force.

    Where columns depend on others that is the split with the least sum of squares.
    """
    r, count = work.rank, work.count
    if r == count:
        for j in range(count):
            alpha[columns[j].chosen] = work.alpha_meas[j]
            speed[columns[j].chosen] = work.speed[j]
        return
    _spread_dependent(work, columns, alpha, speed)


@inner
def _spread_dependent(work, columns, alpha, speed):
    """α_all = Rᵀ(RRᵀ)⁻¹α and Rᵀ speed, R the shares."""
    r, count, G, x = work.rank, work.count, work.D, work.E
    for a in range(r):
        x[0, a] = work.alpha_meas[a]
        for b in range(r):
            G[a, b] = 0.0
            for j in range(count):
                G[a, b] += columns[j].share[a] * columns[j].share[b]
    lu_solve(G, r, x, 1)
    for j in range(count):
        s = t = 0.0
        for a in range(r):
            s += columns[j].share[a] * x[0, a]
            t += columns[j].share[a] * work.speed[a]
        alpha[columns[j].chosen], speed[columns[j].chosen] = s, t


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
        engaged = memory.engaged != 0 and c > 0
        misfit = engaged and flags & NO_WISHES != 0
        engaged = engaged and not misfit
        if flags & MISFIT != 0 or (misfit and flags & PARTIAL == 0) or not _check(
            chain, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, touched, engaged, moving
        ):  # fmt: skip
            reason = BAD_INPUT
        elif chain.leader < 0 and memory.located == 0:
            reason = OBJECT_UNKNOWN
        else:
            _take_in(
                chain, work, arm_work, joints, columns, body_work, q, v, wrenches, X_WD, V_D, A_D,
                alpha_d, touched, engaged, moving,
            )  # fmt: skip
            if chain.phased != 0 and engaged:
                _advance_phases(
                    chain, bodies, owners, memory, contacts, column_memory, flat, alpha_d
                )
            else:
                for j in range(r_all):
                    flat[j] = alpha_d[j] if engaged else 0.0
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
        reason = _measure(
            chain, arms, pairs, shapes, owners, bodies, contacts, work, arm_work, joints,
            columns, body_work, memory, wrenches, touched, moving,
        )  # fmt: skip
        if reason == NO_REASON:
            _desire(work, columns, flat)
            reason = _see_error(chain, work, X_WD)
    if begin <= COMMAND < stop and reason == NO_REASON:
        reason = _command(chain, arms, table, work, arm_work, joints, memory, q, v, V_D, A_D, flags)
    if begin <= ALLOCATE < stop and reason == NO_REASON:
        predict_joints(chain, arms, work, joints)
        reason = allocate_torques(
            chain, arms, table, work, arm_work, joints, extra, link, squeeze, q, v
        )
        if reason == NO_REASON:
            reason = _finish(
                chain, table, work, memory, joints, columns, column_memory, owners, contacts,
                flat, last, tau, first,
            )  # fmt: skip
            if k > 2:
                internal_forces(
                    chain, work, joints, link, numbers(work_bytes, chain.bars_at, chain.n_bars)
                )
    work.reason = memory.reason = reason
    if reason != NO_REASON:
        work.status, memory.fresh = HELD, 0
        for i in range(chain.n_motors):
            tau[first + i] = last[i]
    return work.status


@inner
def _finish(chain, table, work, memory, joints, columns, column_memory, owners, contacts, flat,
            last, tau, first):  # fmt: skip
    """The verdict, the torques and the memory of a tick that could be computed; a reason."""
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
        if chain.phased != 0 and memory.ticked != 0:
            step = flat[5 * chain.n_columns :]
            for j in range(chain.n_joints):
                if table[j].motor >= 0:
                    step[table[j].motor] = chain.torque_rate * chain.period * table[j].tau_max
            phases.slew(tau[first : first + chain.n_motors], last, step, chain.n_motors)
        for i in range(chain.n_motors):
            last[i] = tau[first + i]
    _remember(chain, work, memory, columns, column_memory, owners, contacts, flat)
    return NO_REASON


def build(stamp: int) -> Any:
    """The tick, to be compiled at its first call; `stamp` tells the cache of changed sources."""

    @entry
    def rows(model, memory, work, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, touched,
             flags, tau, codes, begin, stop, lo, hi):  # fmt: skip
        """Controllers lo … hi − 1, each from part `begin` to before part `stop`.

        Returns after a tick that ends SATURATED: its `work` says what motor limits must know.

        Args:
            model, memory: bytes of all rows (one row of `model` serves all of them). work: bytes,
                scratch and what the last row worked out.
            q, v, V_D, A_D, alpha_d, squeeze: of all rows, one behind the other; wrenches
                (rows · arms, 6), X_WD (rows · 4, 4), touched (rows · contacts, 28).
            flags: MOVING, COMMANDED, OWN_FORCE, OWN_MOTION.
            tau: (rows · motors,), codes: (rows,) status; filled.

        Returns:
            Twice the row to go on with (hi when all are done), plus 1 if some row did not end OK.
        """
        amiss = 0
        if stamp < 0:
            return 2 * hi
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
        if not fits:
            flags |= MISFIT
        elif alpha_d.size != count * r:
            flags |= NO_WISHES
        for i in range(lo, hi):
            codes[i] = _row(
                model, i * step, memory, i * head.memory_bytes, work,
                q[i * n : (i + 1) * n], v[i * n : (i + 1) * n], wrenches[i * k : (i + 1) * k],
                X_WD[4 * i : 4 * i + 4], V_D[6 * i : 6 * i + 6], A_D[6 * i : 6 * i + 6],
                alpha_d[i * r : (i + 1) * r], squeeze[i * s : (i + 1) * s],
                touched[i * c : (i + 1) * c], flags, tau, i * a, begin, stop,
            )  # fmt: skip
            amiss |= codes[i] != OK
            if codes[i] == SATURATED:
                return 2 * (i + 1) + 1
        return 2 * hi + amiss

    return rows
