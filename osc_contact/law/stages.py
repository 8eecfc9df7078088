"""The stages of a tick in the order of fig. 4; `tick` runs them on one controller's records."""

from __future__ import annotations

from math import inf, isfinite

from osc_contact.law import phases
from osc_contact.law.algebra import project_onto_constraint, solve_lower
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
from osc_contact.law.six import ZERO, add, dot6, fill, plus, reflect, reflect_back, scaled
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

#: flags of a tick: α_u, a_u are given
OWN_FORCE, OWN_MOTION = 4, 8
_BEYOND = 1e302  #: overflows with forces above 2 MN: a step back from there would leave rounding


@leaf
def is_finite(t, engaged, moving):
    """Whether what came in is finite; sums side by side do not wait for one another.

    Args:
        engaged: whether contacts are in force. moving: whether bodies were measured.
    """
    model = t.model
    a = b = c = d = e = 0.0
    for i in range(model.n_joints):
        a += t.input.q[i] * 0.0
        b += t.input.v[i] * 0.0
    for k in range(model.n_arms):
        for i in range(6):
            c += t.input.wrenches[k, i] * 0.0
    for i in range(4):
        for j in range(4):
            d += t.input.X_WD[i, j] * 0.0
    for i in range(6):
        e += t.input.V_D[i] * 0.0 + t.input.A_D[i] * 0.0
    for i in range(model.n_columns if engaged else 0):
        e += t.input.alpha_d[i] * _BEYOND * 0.0
    for i in range(max(model.n_bars, 1)):
        e += t.memory.squeeze[i] * 0.0
    for k in range(model.n_contacts if moving else 0):
        for i in range(28):
            c += t.input.touched[k, i] * 0.0
    return isfinite(a + b + c + d + e)


@leaf
def take_in(t, engaged, moving):
    """What came in, for whoever looks at the signals of the tick afterwards.

    Args:
        engaged, moving: as of `is_finite`.
    """
    model = t.model
    work = t.work
    joints = t.work.joints
    for i in range(4):
        for j in range(4):
            work.X_WD[i, j] = t.input.X_WD[i, j]
    for i in range(6):
        work.V_D[i], work.A_D[i] = t.input.V_D[i], t.input.A_D[i]
    for j in range(model.n_joints):
        joints[j].q = t.input.q[j]
        joints[j].v = t.input.v[j]
    for k in range(model.n_arms):
        fill(t.work.arms[k].reading, t.input.wrenches[k])
    for j in range(model.n_columns):
        t.work.columns[j].alpha_d = t.input.alpha_d[j] if engaged else 0.0
    for c in range(model.n_contacts if moving else 0):
        for i in range(28):
            t.work.bodies[c].motion[i] = t.input.touched[c, i]


@inner
def advance_contacts(t):
    """Open, approach and close contacts; desired forces become the goals of this tick.

    What a tick measured is judged once, by the next tick that is computed.
    """
    memory = t.memory
    if memory.fresh != 0:
        memory.fresh = 0
        changed = phases.advance_phases(t)
        if changed:
            memory.hand_over = 1
        phases.remap_force_sums(t)
    phases.set_goals(t)


@inner
def measure(t):
    """N, n_γ, the bodies along N, the force filter; returns a reason."""
    model = t.model
    work = t.work
    columns = t.work.columns
    moving = t.work.moving
    work.mu = max(model.mu + t.memory.more_friction, 0.0)
    work.more_friction = t.memory.more_friction
    if work.count > 0:
        take_turns(t)
        if not place_contacts(t):
            return DEGENERATE_PAIR
        if moving:
            answer_bodies(t)
    reason = keep_columns(t)
    if reason != NO_REASON:
        return reason
    add_friction(t)
    if moving:
        project_bodies(t)
    else:
        still_bodies(t)
    sum_readings(t)
    reflect_columns(t)
    f_c = work.f_c
    r = work.rank
    fill(f_c, ZERO)
    if r == 0:
        return NO_REASON
    if model.reading == LEAST_SQUARES:
        if not weigh_magnitudes(t):
            return BLIND
        learn_friction(t)
    elif not measure_magnitudes(t):
        return BLIND
    contact_laws(t)
    for a in range(r):
        N = columns[columns[int(work.keep[a])].chosen].N
        work.speed[a] = dot6(N, work.V_O) - work.V_N[a]
        fill(f_c, add(f_c, work.alpha_meas[a], N))
    if model.phased != 0:
        compare_speeds(t)
    return require_reachable(t)


@inner
def set_desired_forces(t, flags):
    """α_d (r,) of the independent columns from the goals of all; `flags`: OWN_FORCE or not.

    Steps are smoothed and swinging contacts braked, but for a force law of the user's own.

    Args:
        flags: OWN_FORCE or 0.
    """
    columns = t.work.columns
    work = t.work
    n = t.model.n_columns
    own = flags & OWN_FORCE != 0
    if own:
        work.step_left = 0.0
        work.integral_scale = 1.0
        for j in range(n):
            columns[j].goal = work.goal[j]
            columns[j].scale = 0.0
            columns[j].shaped = 0
            columns[j].to_come[0] = columns[j].to_come[1] = columns[j].to_come[2] = 0.0
    else:
        if t.model.step_time > 0.0:
            spread_magnitudes(t, work.alpha, work.speeds)
        shape_steps(t)
    brake_contacts(t)
    r = work.rank
    count = work.count
    for a in range(r):
        s = 0.0
        if r == count:
            s = columns[columns[int(work.keep[a])].chosen].goal
        else:
            for j in range(count):
                s += columns[j].share[a] * columns[columns[j].chosen].goal
        work.alpha_d[a] = s
        work.gain[a] *= work.integral_scale
        work.brake[a] = 0.0 if own else work.brake[a]
        contact = t.memory.contacts[t.model.columns[columns[int(work.keep[a])].chosen].contact]
        approached = contact.phase == phases.APPROACHING
        work.felt[a] = work.alpha_meas[a]
        if approached and r == count:
            work.gain[a] = phases.APPROACH_GAIN
            work.felt[a] = work.damping[a] * work.speed[a]
        if own and not approached:  # a law of the user's own
            work.damping[a] = 0.0


@inner
def compare_poses(t):
    """Pose error, and the part of it that the contacts permit; a reason."""
    work = t.work
    set_metric(t)
    pose_error(t.input.X_WD, work.X_WO, work.error)
    permit_error(t, work.error, work.free_error, True)
    fill(work.motion_next, work.free_error)
    if t.model.metric != BY_OBJECT and not permit_error(t, work.error, work.motion_next, False):
        return BAD_METRIC
    return NO_REASON


@inner
def hand_over(t):
    """What the motion integral has learnt in free directions goes on as a constant wrench.

    That is S⁻ᵀΛ_S P_T K_i∫e, added to `f_bias`: weight errors stay balanced in directions that
    leave the motion law. The integral starts again from zero. `work` is of a tick of this chain.
    """
    work = t.work
    memory = t.memory
    m = work.locked
    x = work.y
    f = work.z
    fill(x, scaled(t.model.integral, memory.motion_sum))
    fill(memory.motion_sum, ZERO)
    carry_motion(x, work.O, work.C, x)
    energy_motion(work.axes, x, x)
    reflect(work.reflectors, work.beta, m, x)
    for a in range(work.rank):  # what the contacts see of a locked motion is not rounded away
        work.s[a] = dot6(work.N_t[a], x)
    solve_lower(work.L_t, work.rank, work.s)
    project_onto_constraint(work.Q_t, work.rank, x, work.s)
    held = 1.0 if t.model.held != 0 else 0.0
    for i in range(6):
        f[i] = 0.0
        if i >= m:
            f[i] = held * x[i]
            for j in range(m, 6):
                f[i] += work.Lambda[i, j] * x[j]
    reflect_back(work.reflectors, work.beta, m, f)
    world_wrench(work.axes, f, f)
    carry_wrench(f, work.C, work.O, f)
    fill(memory.f_bias, plus(memory.f_bias, f))


@inner
def command(t, flags):
    """Force law, motion law, filter and control structure; returns a reason.

    Args:
        flags: which laws are the user's own.
    """
    model = t.model
    work = t.work
    memory = t.memory
    r = work.rank
    if flags & OWN_FORCE == 0:
        for a in range(r if memory.wrench_missing != 0 else 0):
            work.gain[a] = 0.0
        for a in range(r):  # another number of columns: start again
            work.w[a] = memory.force_sum[a] if memory.force_rank == r else 0.0
        command_force(t)
    else:
        for a in range(r):
            work.force_next[a] = memory.force_sum[a] if memory.force_rank == r else 0.0
            if work.damping[a] > 0.0:  # approached
                work.alpha_u[a] = work.alpha_d[a] - work.damping[a] * work.speed[a]
    if memory.hand_over != 0:
        memory.hand_over = 0
        hand_over(t)
    most = model.integral_motion / model.integral if model.integral > 0.0 else inf
    for i in range(6):
        s = memory.motion_sum[i] + work.motion_next[i] * work.dt
        work.motion_next[i] = min(max(s, -most), most)
    if flags & OWN_MOTION == 0:
        command_motion(
            t,
        )
    reason = filter_motion(t)
    if reason != NO_REASON:
        return reason
    if work.n_lost > 0 and work.locked < 6:
        reduce_motion(t, r)
    command_object(t)
    return NO_REASON
