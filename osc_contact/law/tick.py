"""The control tick, in the order of docs/law.md: model, force, motion, decoupling, torques.

A tick has four parts, between which Python code may run; `rows` calls them:

    LOOK      input and its plausibility, phases of the contacts, the closed chain
    MEASURE   N and n_γ, motion of the bodies along N, the force filter of fig. 5, the pose error
    COMMAND   force law, motion law, motion filter (24), control structure (21), robot limits
    ALLOCATE  motor torques, verdict, memory

HAND_OVER, run alone, converts the motion integral into a constant wrench. Only MEMORY lasts beyond
a tick; WORK contains the intermediate results of the last row.
"""

from __future__ import annotations

from math import inf, isfinite

from osc_contact.law import phases
from osc_contact.law.active_set import keep_integrals, update_contacts
from osc_contact.law.agreement import check_arms, compare_speeds
from osc_contact.law.algebra import project_onto_columns
from osc_contact.law.allocation import (
    allocate_torques,
    command_object,
    limit_torques,
    predict_joints,
)
from osc_contact.law.bars import internal_forces
from osc_contact.law.ceilings import watch_ceilings
from osc_contact.law.chain import OBJECT_UNKNOWN, solve_chain
from osc_contact.law.columns import (
    choose_columns,
    compute_body_responses,
    keep_columns,
    project_bodies,
    spread_magnitudes,
)
from osc_contact.law.command_filter import (
    filter_motion,
    permit_error,
    reduce_motion,
    reflect_columns,
    require_reachable,
    set_metric,
)
from osc_contact.law.commands import (
    brake_contacts,
    command_motion,
    feedback_share,
    holds_at_zero,
    keep_steps,
    pose_error,
    shape_squeeze,
    shape_steps,
)
from osc_contact.law.contact import place_contacts, predict_friction
from osc_contact.law.contact_friction import learn_friction, oppose_friction
from osc_contact.law.force_law import command_force, contact_laws, last_integral
from osc_contact.law.friction_slope import limit_integrals
from osc_contact.law.hopping import watch_hops
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.joint_friction import compensate_friction
from osc_contact.law.levelling import level_approaches
from osc_contact.law.normals import load_normal_estimates
from osc_contact.law.plausibility import check_readings
from osc_contact.law.reading import (
    add_friction,
    measure_magnitudes,
    sum_readings,
    weigh_magnitudes,
)
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    COMMAND,
    DEGRADED,
    END,
    HAND_OVER,
    HELD,
    HOPPING,
    LEAST_SQUARES,
    LOOK,
    MEASURE,
    MOST_LOST,
    OK,
    SAFE_STOP,
    SATURATED,
    contact_of,
)
from osc_contact.law.safety import guard, watch_contacts, watch_joints
from osc_contact.law.sensors import check_sensors
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    clamped,
    copy_rows,
    dot6,
    fill,
    fill3,
    finiteness,
    motion_to_energy,
    plus,
    scaled,
    turned,
    turned_back,
    wrench_to_world,
)
from osc_contact.law.witness import measure_approached_forces

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

# Flags of a tick, from the caller:
MOVING = 1  #: motions of the touched bodies are measured
COMMANDED = 2  #: internal forces between three or more arms are commanded
OWN_FORCE = 4  #: the user's force law gives α_u
OWN_MOTION = 8  #: the user's motion law gives a_u
PARTIAL = 16  #: the number of columns of N is not known yet
# Flags of a tick, set by `rows`:
MISFIT = 64  #: an input has a wrong size
NO_FORCES = 128  #: alpha_d has a wrong size
#: Makes forces above 2 MN overflow; rounding errors would remain after them.
_OVERFLOW_FACTOR = 1e302

# --- Model ----------------------------------------------------------------------------------------


@inner
def look(t, flags):
    """Check the input, advance the phases of contacts, solve the closed chain; return a reason.

    Contacts are part of the tick only while the controller is `engaged`. Readings are checked in a
    controller (`guarded`), not in a chain without control. Fills `status` (OK; the caller changes
    it after a reason), `dt` (s; with at most `MOST_LOST` lost ticks), `commanded` (1 for two arms,
    whose squeeze is 0 unless given, and if internal forces are given), `moving` (1 if bodies move),
    `rank` and `count` (0 until columns are chosen), and the fields of `check_readings`, `take_in`,
    `update_contacts`, `choose_columns` and `solve_chain`.

    Args:
        t: Tick.
        flags: sum of COMMANDED (internal forces are given), PARTIAL (the number of columns is not
            known yet), MISFIT (an input has a wrong size) and NO_FORCES (alpha_d has a wrong size).
    """
    model = t.model
    memory = t.memory
    work = t.work
    work.status = OK
    work.commanded = model.n_arms == 2 or flags & COMMANDED != 0
    work.moving = t.input.moving
    work.rank = 0
    work.count = 0
    # time since the last tick, and whether the tick has contacts with desired forces
    lost_ticks = memory.gap if memory.ticked else 0  # no time passes before the first tick
    work.dt = model.period * (1 + min(lost_ticks, MOST_LOST))
    has_contacts = memory.engaged != 0 and model.n_contacts > 0
    lacks_forces = has_contacts and flags & NO_FORCES != 0
    has_contacts = has_contacts and not lacks_forces
    # while the number of columns is not known (PARTIAL), alpha_d may have another size
    misfit = flags & MISFIT != 0 or (lacks_forces and flags & PARTIAL == 0)
    if misfit or not is_finite(t, has_contacts, work.moving):
        return BAD_INPUT
    if memory.state == SAFE_STOP:
        return STOPPED
    if model.guarded:
        reason = check_readings(t)
        if reason != NO_REASON:
            return reason
    if model.leader < 0 and memory.located == 0:
        return OBJECT_UNKNOWN
    take_in(t, has_contacts, work.moving != 0)
    if has_contacts and (model.phased or t.input.chosen_set or memory.chosen_set):
        update_contacts(t)
    choose_columns(t)
    return solve_chain(t)


@leaf
def is_finite(t, engaged, moving):
    """Test whether all values of INPUT and the desired squeeze are finite.

    Args:
        t: Tick.
        engaged: whether the law includes contacts; if not, alpha_d is not checked.
        moving: whether motions of the touched bodies are measured.
    """
    model = t.model
    row = t.input
    # a sum of products with 0, which is NaN if a value is not finite
    zero = finiteness(row.q, model.n_joints) + finiteness(row.v, model.n_joints)
    zero += finiteness(row.V_D, 6) + finiteness(row.A_D, 6)
    for c in range(max(model.n_bars, 1)):
        zero += t.memory.squeeze[c] * _OVERFLOW_FACTOR * 0.0
    for i in range(4):
        zero += finiteness(row.X_WD[i], 4)
    for k in range(model.n_arms):
        zero += finiteness(row.wrenches[k], 6)
    if moving:
        for c in range(model.n_contacts):
            zero += finiteness(row.touched[c], 28)
    if engaged:
        for j in range(model.n_columns):
            zero += row.alpha_d[j] * _OVERFLOW_FACTOR * 0.0
    if row.chosen_set:
        for c in range(model.n_contacts):
            zero += row.active[c] * 0.0
    return isfinite(zero)


@leaf
def take_in(t, engaged, moving):
    """Copy INPUT to WORK for logging; set the goals of the forces.

    Fills `X_WD`, `V_D`, `A_D`, `goal`, q and v of the joints, `reading` of the arms, `motion` of
    the bodies, `alpha_d` of the columns.

    Args:
        t: Tick.
        engaged: whether the law includes contacts; if not, the goals are zero.
        moving: whether motions of the touched bodies are measured: rows (28,) of `touched` with the
            pose X_WE (4, 4), twist V_E (6,) and acceleration A_E (6,) of each.
    """
    model = t.model
    work = t.work
    row = t.input
    copy_rows(row.X_WD, work.X_WD)
    fill(work.V_D, row.V_D)
    fill(work.A_D, row.A_D)
    for j in range(model.n_joints):
        work.joints[j].q = row.q[j]
        work.joints[j].v = row.v[j]
    for k in range(model.n_arms):
        fill(work.arms[k].reading, row.wrenches[k])
    for j in range(model.n_columns):
        work.goal[j] = work.columns[j].alpha_d = row.alpha_d[j] if engaged else 0.0
    if moving:
        for c in range(model.n_contacts):
            for i in range(28):
                work.bodies[c].motion[i] = row.touched[c, i]


# --- Force ----------------------------------------------------------------------------------------


@inner
def measure(t):
    """Compute geometry and measured forces of the contacts.

    Reads the measured state and wrist readings of INPUT, and the active contacts (`chosen`,
    `count`). Without active columns no force is computed. Fills in WORK the coefficient of friction
    `mu`, `more_friction` and `slid` of MEMORY, `speed` (NᵀV_rel of the kept columns; m/s, rad/s)
    and `f_c` = N α_meas (at O, world axes; N, N m). The functions called here state the fields that
    they fill: N and n_γ of each column, the kept columns, motion of the touched bodies along N,
    readings, and α_meas.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`; `DEGENERATE_PAIR` if a pair has no N in this pose; `BLIND` if the wrists cannot
        measure a contact force; or the reason of `keep_columns` or `require_reachable`.
    """
    model = t.model
    work = t.work
    work.mu = max(model.mu + t.memory.more_friction, 0.0)
    work.more_friction = t.memory.more_friction
    work.slid = t.memory.slid
    # geometry: N and n_γ of the active columns, motion of the touched bodies, independent columns
    if work.count > 0:
        load_normal_estimates(t)
        if not place_contacts(t):
            return DEGENERATE_PAIR
        if work.moving:
            compute_body_responses(t)
    reason = keep_columns(t)
    if reason != NO_REASON:
        return reason
    # operands of the measured forces: N with friction, bodies along N, sum of the wrist readings
    predict_friction(t)
    add_friction(t)
    project_bodies(t)
    sum_readings(t)
    reflect_columns(t)
    fill(work.f_c, ZERO)
    if work.rank == 0:
        spread_magnitudes(t)
        return NO_REASON
    # measured forces α_meas, then their wrench N α_meas and the speeds along N
    if model.reading == LEAST_SQUARES:
        if not weigh_magnitudes(t):
            return BLIND
        learn_friction(t)
    elif not measure_magnitudes(t):
        return BLIND
    contact_laws(t)
    for a in range(work.rank):
        N = work.columns[work.kept[a]].N
        work.speed[a] = dot6(N, work.V_O) - work.V_N[a]
        accumulate(work.f_c, work.alpha_meas[a], N)
    if model.phased:
        compare_speeds(t)
        if model.reading == LEAST_SQUARES:
            measure_approached_forces(t)
    spread_magnitudes(t)
    return require_reachable(t)


@inner
def set_desired_forces(t, flags):
    """Compute the desired forces of the kept columns from the goals of all columns.

    Steps of contact forces are shaped, and the brake decelerates contacts, except with a force law
    of the user. Steps of internal forces are always shaped, and `brake_contacts` is always called,
    because it also determines on which faces the normal is not turned.

    Gains K_i are multiplied by `integral_scale` and, except those of holds at zero force, by 1 −
    `integral_cut` of MEMORY. Of a contact that is being approached, while the active columns of N
    are independent, K_i is `APPROACH_GAIN` instead, and the integral compares the force K_a
    NᵀV_rel of its speed law with the desired force in place of the measured one.

    Reads `goal` (N) and `share` (r,; the wrench of a unit force as a combination of the kept
    columns) of the active columns, `alpha_meas` (r,; N), `speed` (r,; m/s), `integral_scale`, and
    `phase` of the contacts. Fills `alpha_d` (r,; N) and `felt` (r,; N), the force that the
    integral compares with it; changes `gain` (K_i, 1/s), `brake` (to m/s²; 0 with a force law of
    the user) and `damping` (K_v, N s/m; 0 with a force law of the user, except in approaches), and
    the fields that `shape_steps`, `shape_squeeze` and `brake_contacts` name.

    Args:
        t: Tick.
        flags: OWN_FORCE or 0.
    """
    work = t.work
    columns = work.columns
    users_own = flags & OWN_FORCE != 0
    shape_steps(t, users_own)
    shape_squeeze(t)
    brake_contacts(t)
    are_independent = work.rank == work.count  # else no column is that of one contact alone
    for a in range(work.rank):
        s = 0.0  # α_d of this column: Σ_j share_ja goal_j
        for j in range(work.count):
            column = columns[work.chosen[j]]
            s += column.share[a] * column.goal
        work.alpha_d[a] = s
        work.gain[a] *= work.integral_scale
        if not holds_at_zero(t, work.kept[a]):  # its gains have their own margin
            work.gain[a] *= 1.0 - t.memory.integral_cut
        work.brake[a] = 0.0 if users_own else work.brake[a]  # the user's law has its own brake
        is_approached = contact_of(t, work.kept[a]).phase == phases.APPROACHING
        work.felt[a] = work.alpha_meas[a]
        if is_approached and are_independent:  # its integral controls the speed of the approach
            work.gain[a] = phases.APPROACH_GAIN
            work.felt[a] = work.damping[a] * work.speed[a]
        if users_own and not is_approached:  # the user's force law includes its own damping
            work.damping[a] = 0.0


# --- Motion ---------------------------------------------------------------------------------------


@inner
def compare_poses(t):
    """Compute the pose error at O and the part of it that the contacts permit.

    Reads `X_WD` of INPUT and `X_WO`. Fills in WORK `error` (from measured to desired pose, at O in
    world axes; m, rad), the fields of `set_metric`, and `motion_next` and `free_error` of
    `permit_error`.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`, or `BAD_METRIC` if the metric is not positive definite.
    """
    work = t.work
    set_metric(t)
    fill(work.error, pose_error(t.input.X_WD, work.X_WO))
    return permit_error(t)


@inner
def transfer_integral(t):
    """Convert the motion integral along free directions into a constant wrench.

    The wrench S⁻ᵀΛ_S x is added to `f_bias`, so that weight errors stay balanced in directions that
    are no longer controlled by the motion law: x is K_i ∫e dt, with the gain K_i (1/s³) of the
    integral of the pose error e, without its components along motions that the arms lock, Λ_S the
    inertia along the others, and S⁻ᵀ leads from there to a wrench on the object. Components that
    are dropped do not change Nᵀx, which is zero as far as e was permitted by the contacts.

    Reads `Lambda`, `N_t` and its factors in WORK. Changes in MEMORY `f_bias` (at O in world axes;
    N, N m), and `motion_sum` (∫e dt), which is reset to zero.

    Args:
        t: Tick.
    """
    work = t.work
    memory = t.memory
    x = local(6)
    along_N = local(6)
    force = local(6)
    fill(x, motion_to_energy(work, scaled(t.model.integral, memory.motion_sum)))
    fill(x, turned(work, x))
    fill(memory.motion_sum, ZERO)
    for a in range(work.rank):  # keeps Nᵀx exactly, although locked components are dropped
        along_N[a] = dot6(work.N_t[a], x)
    project_onto_columns(work.N_factor_t, work.N_basis_t, work.rank, x, along_N)
    fill(force, ZERO)
    for i in range(work.locked, 6):
        for j in range(work.locked, 6):
            force[i] += work.Lambda[i, j] * x[j]
    f = wrench_to_world(work, turned_back(work, force))
    fill(memory.f_bias, plus(memory.f_bias, f))


# --- Decoupling -----------------------------------------------------------------------------------


@inner
def command(t, flags):
    """Evaluate force law, motion law, motion filter and control structure.

    Changes `motion_next` from the permitted error (m, rad) to the motion integral after this tick
    (m s, rad s), whose bound is `integral_motion` (m/s², rad/s²) divided by the gain. Without new
    wrenches (`wrench_missing`) the force integrals stay: K_i (`gain`) becomes 0. `hand_over` of
    MEMORY converts the motion integral once to a constant wrench. Fills `alpha_u` (N), `force_next`
    (N), `a_u`, `acceleration_t`, `reaction` (N; 0 except with least squares), `f_S` and the other
    fields that the functions called here fill.

    Args:
        t: Tick.
        flags: sum of OWN_FORCE, if α_u is already given in `alpha_u`, and of OWN_MOTION, if a_u is
            already given.

    Returns:
        `NO_REASON`, or the reason of `filter_motion`.
    """
    model = t.model
    work = t.work
    memory = t.memory
    # force law: α_u, or the user's own, which keeps the integral and brakes approaches only
    users_own = flags & OWN_FORCE != 0
    for a in range(work.rank):
        if users_own:
            work.force_next[a] = last_integral(t, a)
            if work.damping[a] > 0.0:  # the contact is being approached
                work.alpha_u[a] = work.alpha_d[a] - work.damping[a] * work.speed[a]
        elif memory.wrench_missing:
            work.gain[a] = 0.0
    if not users_own:
        command_force(t)
    if model.phased:
        level_approaches(t)
    if memory.hand_over:
        memory.hand_over = 0
        transfer_integral(t)
    # motion law: a_u, with the integral of the error within its bound (m s, rad s)
    bound = model.integral_motion / model.integral if model.integral > 0.0 else inf
    share = feedback_share(t) if flags & OWN_MOTION == 0 else 1.0
    for i in range(6):
        integral = memory.motion_sum[i] + share * work.motion_next[i] * work.dt
        work.motion_next[i] = clamped(integral, bound)
    if flags & OWN_MOTION == 0:
        command_motion(t, share)
    # motion filter, then the control structure
    reason = filter_motion(t)
    if reason != NO_REASON:
        return reason
    if work.n_lost > 0 and work.locked < 6:
        reduce_motion(t)
    work.reaction[:] = 0.0
    if model.reading == LEAST_SQUARES:
        oppose_friction(t)
    command_object(t)
    return NO_REASON


@inner
def watch(t):
    """Check limits of joints, arms and contacts, and sensors by means of the computed commands.

    Contacts may be lost, press more than commanded, exceed a ceiling or a power, or hop.

    Args:
        t: Tick after `command`.

    Returns:
        `NO_REASON`, or the reason of the first rule that is violated; it stops the arms.
    """
    reason = watch_joints(t)
    if reason == NO_REASON and t.model.guarded:
        reason = check_arms(t)
    if reason == NO_REASON and t.work.rank > 0:
        reason = watch_contacts(t)
    if reason == NO_REASON and t.model.guarded:
        reason = watch_ceilings(t)
    if reason == NO_REASON:
        reason = watch_hops(t)
    return reason


# --- Torques --------------------------------------------------------------------------------------


@inner
def finish(t):
    """Compute motor torques and status of a tick, and update MEMORY.

    Fills `tau` of the motors and `status`: SATURATED if torques were limited, else DEGRADED if
    directions of motion were lost near a singular posture, else HOPPING if a contact hops, else
    unchanged (OK). The functions called here state which fields they fill.

    Args:
        t: Tick after `command`.

    Returns:
        `NO_REASON`; the reason of `allocate_torques`; or `NOT_FINITE` if torques or integrals are
        not finite. Integrals and steps in MEMORY keep their values then.
    """
    model = t.model
    work = t.work
    predict_joints(t)
    reason = allocate_torques(t)
    if reason != NO_REASON:
        return reason
    if model.rubs:
        compensate_friction(t)
    internal_forces(t)
    excess, is_finite_result = limit_torques(t)
    # NaN if an integral is not finite
    s = finiteness(work.motion_next, 6) + finiteness(work.force_next, work.rank)
    if not (is_finite_result and isfinite(s)):
        return NOT_FINITE
    limit_integrals(t)
    if excess:  # a motor limit was reached
        work.status = SATURATED
    elif work.n_lost > 0:
        work.status = DEGRADED
    if not excess:
        phases.limit_changes(t, t.memory.ticked != 0)
    remember(t)
    if work.status == OK and t.memory.hopping > 0:  # the other statuses are more grave
        work.status = HOPPING
    return NO_REASON


@inner
def remember(t):
    """Update MEMORY after a computed tick: integrals, steps, measured forces and phases.

    Integrals keep their values where motors are saturated; the motion integral also where commands
    are reduced.

    Changes in MEMORY `ticked` (number of computed ticks), `fresh` and `located` (1: a tick was
    computed, the pose is known), `more_friction` and `slid` of the identified coefficient, `X_WO`,
    `force_sum` and `motion_sum` (integrals: N; m s, rad s), of the columns `alpha` (N), `speed`
    (NᵀV_rel, m/s) and `tangential` (N), and the fields of `keep_integrals`, `keep_steps` and
    `phases.low_pass`.

    Args:
        t: Tick.
    """
    work = t.work
    memory = t.memory
    memory.ticked = memory.ticked + 1
    memory.fresh = 1
    memory.located = 1
    memory.more_friction = work.more_friction
    memory.slid = work.slid
    copy_rows(work.X_WO, memory.X_WO)
    if work.status != SATURATED:
        for a in range(work.rank):
            memory.force_sum[a] = work.force_next[a]
        keep_integrals(t)
        if work.status == OK:
            fill(memory.motion_sum, work.motion_next)
    for j in range(t.model.n_columns):
        memory.columns[j].alpha = work.alpha[j]
        memory.columns[j].speed = work.speeds[j]
        fill3(memory.columns[j].tangential, work.columns[j].tangential)
    keep_steps(t)
    if t.model.phased:
        phases.low_pass(t, work.rank == work.count and work.weightless == 0)


# --- All parts ------------------------------------------------------------------------------------


@inner
def run_parts(t, flags, begin, stop):
    """Run the parts of a tick from `begin` until before `stop` for one controller.

    The parts are LOOK (`look`: inputs, phases, closed chain, active columns), MEASURE (`measure`:
    geometry and measured forces; then the desired forces), COMMAND (`command`: force law, motion
    law and filter; then `watch`, limits and sensors) and ALLOCATE (`check_sensors`, then `finish`:
    torques, MEMORY). A part that fails ends the tick: the following parts are skipped, and `guard`
    computes torques that hold the arms. Sensors are checked in any case, by the readings of the
    tick, before the torques: those of a faulty reading are not sent. Between parts that are called
    one by one (custom laws in Python) the reason is kept in WORK. Fills `status` and `reason` of
    WORK, and `reason` of MEMORY; after a complete tick `wrench_missing`, `repeated` and `derived`
    of MEMORY, marks of its input, become 0.

    Args:
        t: Tick.
        flags: sum of MOVING, COMMANDED, OWN_FORCE, OWN_MOTION, PARTIAL, MISFIT and NO_FORCES.
        begin: first part, LOOK … ALLOCATE, or HAND_OVER.
        stop: part before which to stop, or END.

    Returns:
        Status of the tick: OK, SATURATED, HELD, DEGRADED or HOPPING.
    """
    memory = t.memory
    work = t.work
    if begin == HAND_OVER:
        transfer_integral(t)
        return work.status
    reason = work.reason if work.status == HELD else NO_REASON  # of the parts before
    if begin == LOOK:
        reason = look(t, flags)
    if begin <= MEASURE < stop and reason == NO_REASON:
        reason = measure(t)
        if reason == NO_REASON:
            set_desired_forces(t, flags)
            reason = compare_poses(t)
    if begin <= COMMAND < stop and reason == NO_REASON:
        reason = command(t, flags)
        if reason == NO_REASON:
            reason = watch(t)
    if reason != NO_REASON or stop == END:
        sensor_reason = check_sensors(t)
        if reason == NO_REASON:
            reason = sensor_reason  # the torques would follow from a faulty reading
        if reason == NO_REASON:
            reason = finish(t)
        guard(t, reason, sensor_reason)
        memory.wrench_missing = memory.repeated = memory.derived = 0
    work.reason = memory.reason = reason
    if reason != NO_REASON:
        work.status = HELD
    return work.status
