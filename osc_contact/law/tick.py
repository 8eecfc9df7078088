"""The control tick, fig. 4: its stages in their order, its verdict, the loop over rows."""

from __future__ import annotations

from math import inf, isfinite, nan

from osc_contact.law import phases
from osc_contact.law.algebra import project_onto_constraint, solve_lower
from osc_contact.law.allocation import (
    allocate_torques,
    command_object,
    limit_torques,
    predict_joints,
)
from osc_contact.law.bars import internal_forces
from osc_contact.law.chain import OBJECT_UNKNOWN, solve_chain
from osc_contact.law.columns import (
    answer_bodies,
    choose_columns,
    keep_columns,
    project_bodies,
    spread_magnitudes,
    still_bodies,
)
from osc_contact.law.command_filter import (
    BAD_METRIC,
    filter_motion,
    permit_error,
    reflect_columns,
    require_reachable,
    set_metric,
)
from osc_contact.law.commands import (
    brake_contacts,
    command_motion,
    keep_steps,
    pose_error,
    shape_steps,
)
from osc_contact.law.contact import place_contacts, take_turns
from osc_contact.law.jit import entry, inner, leaf, prefetch
from osc_contact.law.joint_friction import compensate_friction
from osc_contact.law.operational import reduce_motion
from osc_contact.law.reading import (
    add_friction,
    command_force,
    contact_laws,
    learn_friction,
    measure_magnitudes,
    sum_readings,
    weigh_magnitudes,
)
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    ALLOCATE,
    BY_OBJECT,
    COMMAND,
    DEGRADED,
    END,
    HAND_OVER,
    HELD,
    JOB,
    LEAST_SQUARES,
    LOOK,
    MEASURE,
    MEMORY,
    MODEL,
    MOST_LOST,
    OK,
    SAFE_STOP,
    SATURATED,
    row_of,
)
from osc_contact.law.safety import guard, watch_contacts, watch_joints
from osc_contact.law.sensors import check_arms, check_readings, compare_speeds
from osc_contact.law.vectors import (
    ZERO,
    add,
    carry_motion,
    carry_wrench,
    dot6,
    energy_motion,
    fill,
    plus,
    reflect,
    reflect_back,
    scaled,
    world_wrench,
)

BAD_INPUT = declare_reason("BAD_INPUT", 1, "")
DEGENERATE_PAIR = declare_reason(
    "DEGENERATE_PAIR",
    5,
    "a contact has no N in this posture: two edges in contact are parallel (give an edge on a "
    "face, or turn the object), no one place of a curved face is nearest, or a CompiledPair "
    "returned what is not finite",
)
NOT_FINITE = declare_reason(
    "NOT_FINITE",
    11,
    "the computed torques are not finite: the measured state or the integrals are out of any "
    "range. Check the sensors; reset the integrals",
)
BLIND = declare_reason(
    "BLIND",
    12,
    "the inertia beyond the wrist sensors is singular: the contact force cannot be determined "
    "from them. Check mass and inertia of gripper and object",
)
STOPPED = declare_reason("STOPPED", 13, "")

# --- The stages of a tick in the order of fig. 4 --------------------------------------------------

#: flags of a tick: α_u, a_u are given
OWN_FORCE = 4
OWN_MOTION = 8
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
        work.V_D[i] = t.input.V_D[i]
        work.A_D[i] = t.input.A_D[i]
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
        if own and not approached:  # a custom law
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
    """What the motion integral has learned in free directions becomes a constant wrench.

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


# --- The end of a tick that was computed: verdict, torques, memory --------------------------------


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


# --- The whole tick: measurement in, motor torques out --------------------------------------------
#
# `rows` runs any number of controllers, one a row of the tables: a single tick is one row, a batch
# many, on as many threads as there are chunks [lo, hi). Nothing is kept but MEMORY; WORK holds what
# the last row worked out. A tick has four parts, so that Python may step in between them:
#
#     LOOK      what came in and whether it is plausible, phases of the contacts, the closed chain
#     MEASURE   N and n_γ, what the bodies do along N, the force filter of fig. 5, the pose error
#     COMMAND   force law, motion law, motion filter (24), control structure (21), robot limits
#     ALLOCATE  motor torques, verdict, memory
#
# HAND_OVER by itself turns what the motion integral has learned into a constant wrench.

#: flags: bodies move; internal forces of three arms and more are commanded; α_u, a_u are given;
#: how many columns N has is not known yet
MOVING = 1
COMMANDED = 2
PARTIAL = 16
MISFIT, NO_FORCES = 64, 128  # set inside: sizes of what came in; of alpha_d

_job, _model, _memory = (kind.at for kind in (JOB, MODEL, MEMORY))
_PRIORS = MODEL.start("priors")
_FRICTION, _COLUMNS = (MEMORY.start(name) for name in ("friction", "columns"))


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
            if model.rubs != 0:
                compensate_friction(t)
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
    """Whether what came in is plausible, phases of the contacts, the closed chain; a reason."""
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
        Twice the next row (`last` when all are done), plus 1 if some row did not end OK.
    """
    job = _job(raw, at)
    flags = job.switches
    count = job.count
    head = _model(raw, job.model)
    size = head.memory_bytes
    used = head.layout[_PRIORS] if job.model_step != 0 else 0  # what a row is read of, as a rule
    layout = _memory(raw, job.memory).layout
    unused = layout[_FRICTION]
    columns = layout[_COLUMNS]
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
            prefetch(raw, job.model + (i + 1) * job.model_step, used)
            following = job.memory + (i + 1) * size
            prefetch(raw, following, unused)
            prefetch(raw, following + columns, size - columns)
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
