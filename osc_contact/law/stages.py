"""The stages of a tick in the order of fig. 4; `tick` runs them on one controller's records."""

from __future__ import annotations

from math import inf, isfinite

from osc_contact.law import phases
from osc_contact.law.algebra import meet, solve_lower
from osc_contact.law.allocation import command_object
from osc_contact.law.columns import keep_columns, spread_magnitudes
from osc_contact.law.command_filter import (
    filter_motion,
    permit_error,
    reflect_columns,
    require_reachable,
    set_metric,
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
from osc_contact.law.jit import inner, leaf
from osc_contact.law.least_squares import learn_friction, weigh_magnitudes
from osc_contact.law.motion import command_motion, pose_error
from osc_contact.law.sensors import compare_speeds
from osc_contact.law.singular import reduce_motion
from osc_contact.law.six import dot6, reflect, reflect_back
from osc_contact.law.steps import brake_contacts, shape_steps
from osc_contact.law.tables import (
    BAD_METRIC,
    BLIND,
    BY_OBJECT,
    DEGENERATE_PAIR,
    LEAST_SQUARES,
    NO_REASON,
)
from osc_contact.law.tilt import take_turns

__all__ = [
    "advance_contacts",
    "command",
    "compare_poses",
    "hand_over",
    "is_finite",
    "measure",
    "set_wishes",
    "take_in",
]

#: flags of a tick: α_u, a_u are given
OWN_FORCE, OWN_MOTION = 4, 8
_BEYOND = 1e302  #: overflows with forces above 2 MN: a step back from there would leave rounding


@leaf
def is_finite(chain, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, touched, engaged, moving):
    """Whether what came in is finite; sums side by side do not wait for one another.

    Args:
        q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, touched: as of `tick`.
        engaged: whether contacts are in force. moving: whether bodies were measured.
    """
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
        e += alpha_d[i] * _BEYOND * 0.0
    for i in range(max(chain.n_bars, 1)):
        e += squeeze[i] * 0.0
    for k in range(chain.n_contacts if moving else 0):
        for i in range(28):
            c += touched[k, i] * 0.0
    return isfinite(a + b + c + d + e)


@leaf
def take_in(chain, work, arm_work, joints, columns, body_work, q, v, wrenches, X_WD, V_D, A_D,
             alpha_d, touched, engaged, moving):  # fmt: skip
    """What came in, for whoever looks at the signals of the tick afterwards.

    Args:
        q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched, engaged, moving: as of `is_finite`.
    """
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
def advance_contacts(chain, bodies, table, memory, contacts, column_memory, work, flat):
    """Open, approach and close contacts; desired forces become the goals of this tick.

    What a tick measured is judged once, by the next tick that is computed.

    Args:
        flat: flat[:n] are the desired forces (N), then the goals.
    """
    n = chain.n_columns
    goal, kept, scratch = flat[:n], flat[n : 2 * n], flat[2 * n : 3 * n]
    if memory.fresh != 0:
        memory.fresh = 0
        changed = phases.advance_phases(
            chain, bodies, table, contacts, column_memory, goal, kept, work.dt
        )
        if changed:
            memory.hand_over = 1
        phases.remap_force_sums(chain, memory, table, contacts, kept, scratch)
    phases.set_goals(chain, bodies, table, contacts, column_memory, goal, goal)


@inner
def measure(chain, arms, pairs, shapes, table, bodies, contacts, work, arm_work, joints,
             columns, column_memory, body_work, memory, wrenches, touched, moving,
             goal):  # fmt: skip
    """N, n_γ, the bodies along N, the force filter; returns a reason.

    Args:
        wrenches, touched, moving: as of `is_finite`. goal: (r_all,) of the contact forces (N).
    """
    work.mu = max(chain.mu + memory.more_friction, 0.0)
    work.more_friction = memory.more_friction
    if work.count > 0:
        take_turns(chain, column_memory, columns)
        if not place_contacts(
            chain, pairs, shapes, columns, work.X_WO, work.V_O, touched, moving, work
        ):
            return DEGENERATE_PAIR
        if moving:
            answer_bodies(chain, bodies, touched, contacts, work.O, body_work, work.u)
    reason = keep_columns(table, bodies, columns, work, body_work)
    if reason != NO_REASON:
        return reason
    add_friction(columns, work)
    if moving:
        project_bodies(columns, table, bodies, body_work, work)
    else:
        still_bodies(work)
    sum_readings(chain, arms, arm_work, joints, work, wrenches, memory.f_tare)
    reflect_columns(work)
    f_c, r = work.f_c, work.rank
    for i in range(6):
        f_c[i] = 0.0
    if r == 0:
        return NO_REASON
    if chain.reading == LEAST_SQUARES:
        if not weigh_magnitudes(chain, table, bodies, columns, work, goal):
            return BLIND
        learn_friction(chain, table, bodies, columns, work, goal)
    elif not measure_magnitudes(chain, work):
        return BLIND
    contact_laws(table, contacts, columns, work)
    for a in range(r):
        N = columns[columns[int(work.keep[a])].chosen].N
        work.speed[a] = dot6(N, work.V_O) - work.V_N[a]
        for i in range(6):
            f_c[i] += work.alpha_meas[a] * N[i]
    if chain.phased != 0:
        compare_speeds(chain, memory, table, contacts, columns, column_memory, work)
    return require_reachable(chain, work)


@inner
def set_wishes(
    chain, owners, contacts, memory, column_memory, columns, work, flat, flags
):  # fmt: skip
    """α_d (r,) of the independent columns from the goals of all; `flags`: OWN_FORCE or not.

    Steps are smoothed and swinging contacts braked, but for a force law of the user's own.

    Args:
        flat: (r_all,) goals (N). flags: OWN_FORCE or 0.
    """
    n, own = chain.n_columns, flags & OWN_FORCE != 0
    alpha, speed = flat[n : 2 * n], flat[2 * n : 3 * n]
    if own:
        work.step_left, work.heed = 0.0, 1.0
        for j in range(n):
            columns[j].goal, columns[j].scale, columns[j].shaped = flat[j], 0.0, 0
            columns[j].to_come[0] = columns[j].to_come[1] = columns[j].to_come[2] = 0.0
    else:
        if chain.step_time > 0.0:
            spread_magnitudes(work, columns, alpha, speed)
        shape_steps(chain, owners, contacts, memory, column_memory, columns, work, flat, alpha)
    brake_contacts(column_memory, columns, work)
    r, count = work.rank, work.count
    for a in range(r):
        s = 0.0
        if r == count:
            s = columns[columns[int(work.keep[a])].chosen].goal
        else:
            for j in range(count):
                s += columns[j].share[a] * columns[columns[j].chosen].goal
        work.alpha_d[a] = s
        work.gain[a] *= work.heed
        work.brake[a] = 0.0 if own else work.brake[a]
        contact = contacts[owners[columns[int(work.keep[a])].chosen].contact]
        approached = contact.phase == phases.APPROACHING
        work.felt[a] = work.alpha_meas[a]
        if approached and r == count:
            work.gain[a] = phases.APPROACH_GAIN
            work.felt[a] = work.damping[a] * work.speed[a]
        if own and not approached:  # a law of the user's own
            work.damping[a] = 0.0


@inner
def compare_poses(chain, work, X_WD):
    """Pose error, and the part of it that the contacts permit; a reason.

    Args:
        X_WD: (4, 4) desired pose.
    """
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
    reflect(work.reflectors, work.beta, m, x)
    for a in range(work.rank):  # what the contacts see of a locked motion is not rounded away
        work.s[a] = dot6(work.N_t[a], x)
    solve_lower(work.L_t, work.rank, work.s)
    meet(work.Q_t, work.rank, x, work.s)
    held = 1.0 if chain.held != 0 else 0.0
    for i in range(6):
        f[i] = 0.0
        if i >= m:
            f[i] = held * x[i]
            for j in range(m, 6):
                f[i] += work.Lambda[i, j] * x[j]
    reflect_back(work.reflectors, work.beta, m, f)
    world_wrench(work.axes, f, f)
    carry_wrench(f, work.C, work.O, f)
    for i in range(6):
        memory.f_bias[i] += f[i]


@inner
def command(chain, arms, table, work, arm_work, joints, memory, q, v, V_D, A_D, flags):
    """Force law, motion law, filter and control structure; returns a reason.

    Args:
        q, v: (n,) positions and speeds. V_D, A_D: (6,) desired twist and classical acceleration.
        flags: which laws are the user's own.
    """
    r, dt = work.rank, work.dt
    if flags & OWN_FORCE == 0:
        for a in range(r if memory.wrench_missing != 0 else 0):
            work.gain[a] = 0.0
        for a in range(r):  # another number of columns: start again
            work.w[a] = memory.force_sum[a] if memory.force_rank == r else 0.0
        command_force(
            r, work.alpha_d, work.felt, work.speed, work.w, work.gain, work.damping,
            work.least, chain.integral_force, dt, work.force_next, work.alpha_u,
        )  # fmt: skip
    else:
        for a in range(r):
            work.force_next[a] = memory.force_sum[a] if memory.force_rank == r else 0.0
            if work.damping[a] > 0.0:  # approached
                work.alpha_u[a] = work.alpha_d[a] - work.damping[a] * work.speed[a]
    if memory.hand_over != 0:
        memory.hand_over = 0
        hand_over(chain, work, memory)
    most = chain.integral_motion / chain.integral if chain.integral > 0.0 else inf
    for i in range(6):
        s = memory.motion_sum[i] + work.motion_next[i] * dt
        work.motion_next[i] = min(max(s, -most), most)
    if flags & OWN_MOTION == 0:
        command_motion(
            work.error, work.motion_next, V_D, A_D, work.V_O, chain.stiffness, chain.damping,
            chain.integral, work.a_u,
        )  # fmt: skip
    reason = filter_motion(chain, work)
    if reason != NO_REASON:
        return reason
    if work.n_lost > 0 and work.locked < 6:
        reduce_motion(chain, arms, table, work, arm_work, joints, r, q, v)
    command_object(chain, work, memory.f_bias)
    return NO_REASON
