"""Motor torques for a commanded object force and internal forces: the least within the limits."""

from __future__ import annotations

from math import isfinite, sqrt

from osc_contact.law.algebra import (
    add_scaled,
    backward,
    cholesky,
    cholesky_solve,
    dot,
    forward,
)
from osc_contact.law.bars import internal_rows
from osc_contact.law.chain import UNACTUATED
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.operational import null_motions, retreat
from osc_contact.law.reasons import NO_REASON
from osc_contact.law.records import MAX_JOINTS
from osc_contact.law.vectors import (
    ZERO,
    add,
    dot6,
    fill,
    plus,
    times6,
    turned,
    turned_back,
    wrench_to_energy,
)

# --- Rows of the allocation: Z = A R⁻¹Aᵀ of A = [G; E], its factor, row by row of E ---------------
#
# A row of E that depends on the rows before it (a squeeze that the grasps do not transmit) has a
# pivot of zero. Elimination leaves a rounding error there, as large as eps times the condition
# number of Z, and near a singular posture no threshold separates it from a true pivot. Therefore
# the remainder of a doubtful row is projected a second time, in joint space, as in Gram-Schmidt
# with reorthogonalisation (Björck, Numerical Methods for Least Squares Problems, 1996, section
# 2.4.5).

_LEAST_PIVOT = 1e-12  #: least relative pivot of Z
_INEXACT_PIVOT = 1e-6  #: relative pivot below which a pivot is computed a second time


@inner
def factor_effort(t):
    """Factorise the block G R⁻¹Gᵀ (d, d) of Z: fill the first d rows of `factor`.

    Z is the matrix of the torque allocation, G (d, n) maps torques to the wrench on the object
    along its d free axes, R is the metric of the motors' effort. `effort` (6, 6) of WORK is the
    inverse metric of the effort of wrenches in turned energy coordinates, whose block of the free
    axes is G R⁻¹Gᵀ. `factor` becomes its Cholesky factor, to which `add_row` appends rows.

    Args:
        t: Tick.

    Returns:
        False if the motors cannot drive all free motions of the object.
    """
    work = t.work
    Z = work.factor
    d = 6 - work.locked
    for i in range(d):
        for j in range(i + 1):
            Z[i, j] = work.effort[work.locked + i, work.locked + j]
    return cholesky(Z, 0, d, Z) > _LEAST_PIVOT


@inner
def add_row(t, e):
    """Append a condition on the torques to the Cholesky factor of Z = A R⁻¹Aᵀ.

    A has the rows of G (d, n), the wrench on the object per torque, and of E, further conditions; R
    is the metric of the motors' effort. Reads `extra` (E) and J̄ of the joints. Fills row e of
    `weighed` (R⁻¹ times the row of E) and row d + e of `factor`, with the reciprocal pivot on the
    diagonal; where it is small, `_refine_pivot` fills its fields.

    Args:
        t: Tick.
        e: index of the row of E.

    Returns:
        False if E[e] τ is determined by the rows before it; then the row is not appended.
    """
    work = t.work
    a = work.extra[e]
    size = 6 - work.locked + e
    row = work.factor[size]
    _multiply_metric(t, a, work.weighed[e])
    _multiply_constraints(t, work.weighed[e], e, row)
    square = row[size] = dot(work.weighed[e], a, t.model.n_joints)  # aᵀR⁻¹a
    forward(work.factor, size, row)
    # the square of the part of a that the rows before it leave out, the pivot
    remainder = square - dot(row, row, size)
    if remainder < _INEXACT_PIVOT * square:
        remainder = _refine_pivot(t, e)
    if not remainder > _LEAST_PIVOT * square:  # also if NaN
        return False
    row[size] = 1.0 / sqrt(remainder)
    return True


@inner
def _multiply_constraints(t, weighed, e, out):
    """Compute the products of a weighted row R⁻¹a with the rows of G and E[:e] before it.

    G (d, n) maps torques to the wrench on the object along its d free axes; its columns are the
    rows J̄ of the joints there. E are further conditions, in `extra`; R is the metric of the
    motors' effort.

    Args:
        t: Tick.
        weighed: (n,) R⁻¹a.
        e: number of rows of E in use.
        out: (d + e,), filled: d products with G, then e with E.
    """
    work = t.work
    m = work.locked
    x = ZERO
    for j in range(t.model.n_joints):
        x = add(x, weighed[j], work.joints[j].J_bar)
    driven = local(6)
    fill(driven, turned(work, x))
    for i in range(6 - m):
        out[i] = driven[m + i]
    for c in range(e):
        out[6 - m + c] = dot(weighed, work.extra[c], t.model.n_joints)


@inner
def _refine_pivot(t, e):
    """Compute the pivot of row e of E again, without cancellation, and correct its `factor` row.

    E are the conditions on the torques that are appended to G τ = f_S, the one on the object's
    force; a pivot is the square, in the metric R⁻¹, of the part of a condition that the conditions
    before it do not determine. This part (`rest`, n numbers) is computed itself, and projected once
    more on the conditions before it, so that the pivot is not a difference of large numbers. Fills
    `rest` of WORK; corrects row 6 − m + e of `factor`, with m `locked` axes; `multipliers` and
    `rest_weighed` are scratch.

    Args:
        t: Tick.
        e: index of the row of E, whose row of `factor` has been computed once.

    Returns:
        Pivot: the square of the remainder's norm in the metric R⁻¹.
    """
    work = t.work
    Z = work.factor
    n = t.model.n_joints
    m = work.locked
    size = 6 - m + e
    remainder = work.rest
    x = work.multipliers
    for i in range(size):
        x[i] = Z[size, i]
    backward(Z, size, x)  # multipliers of the rows of G and E before it
    y = _embed_free(work, x)
    # the remainder: row e less its combination of these rows
    for j in range(n):
        remainder[j] = work.extra[e, j] - dot6(work.joints[j].J_bar, y)
    for c in range(e):
        add_scaled(-x[6 - m + c], work.extra[c], n, remainder)
    # the part of the remainder that rounding left in the span of these rows
    _multiply_metric(t, remainder, work.rest_weighed)
    _multiply_constraints(t, work.rest_weighed, e, x)
    forward(Z, size, x)
    add_scaled(1.0, x, size, Z[size])
    return dot(work.rest_weighed, remainder, n) - dot(x, x, size)


@leaf
def _embed_free(work, x):
    """Embed components along the free axes in six numbers in energy coordinates, other axes zero.

    The free axes are the last d of the turned energy coordinates, behind the m = `locked` ones.

    Args:
        work: WORK, of which `locked`, `reflectors` and `beta` are read.
        x: (d,) or longer, components along the free axes first.
    """
    components = local(6)
    for i in range(6):
        components[i] = x[i - work.locked] if i >= work.locked else 0.0
    return turned_back(work, components)


@inner
def _multiply_metric(t, row, out):
    """Multiply a condition on the torques by R⁻¹, where R is the metric of the motors' effort.

    The effort Σ τ²/τ_max² of an arm without redundant joints has R⁻¹ = τ_max²; for an arm with them
    (`wide`) R⁻¹ = JᵀWJ, with the Jacobian J (6, n) and the inverse metric W (6, 6) of the wrenches
    (`effort` of the arm), so that only torques Jᵀf of wrenches f are used. Reads `wide` and
    `effort` of the arms, J of the joints, and `effort` of the joints in MODEL (τ_max²).

    Args:
        t: Tick.
        row: (n,) condition a on the torques, aᵀτ = const, one number for each joint.
        out: (n,) R⁻¹a, filled.
    """
    joints = t.work.joints
    for k in range(t.model.n_arms):
        arm_work = t.work.arms[k]
        lo = t.model.arms[k].first
        hi = t.model.arms[k].end
        if arm_work.wide == 0:
            for j in range(lo, hi):
                out[j] = t.model.joints[j].effort * row[j]
            continue
        x = ZERO  # J a, then W J a
        for j in range(lo, hi):
            x = add(x, row[j], joints[j].J)
        x = times6(arm_work.effort, x)
        for j in range(lo, hi):
            out[j] = dot6(joints[j].J, x)


# --- Motor torques for a commanded object force and internal forces -------------------------------
#
# The torques have the least weighted sum of squares (weight R = 1/τ_max²) with G τ = f_S, E τ = e:
#
#     τ = τ_0 + R⁻¹AᵀZ⁻¹(b − A τ_0),   A = [G; E],   Z = A R⁻¹Aᵀ
#
# E contains the settable bar forces, and motions of single arms that do not move the object
# because of the grasp or the posture, as far as motors drive them. Arms with more joints than their
# grasp transmits wrenches hold their posture in the dynamically consistent null space,
# τ_0 = (1 − JᵀJ̄ᵀ)(h + M(−k_d q̇ + k_p(q₀ − q)) + diag(M) a_l(q)). Passive joints have no torque.


@inner
def command_object(t):
    """Compute the commanded force of the control structure (21), in turned energy coordinates.

        f_S = Λ_S η̇_c + b_S + Sᵀ(N_μ(α_u + α_f) + f_bias)

    S (6, d) are the motions that the arms permit, Λ_S (d, d) the inertia of the chain along them,
    η̇_c the filtered acceleration, b_S the bias of velocity and weight, N_μ (6, r) the columns of
    contact forces with friction, α_u (r,; N) the commanded forces, α_f = `reaction` the contact
    force lost by tangential forces, f_bias a constant wrench. Reads `Lambda`, `acceleration_t`,
    `chain_bias`, `pushed_t`, `alpha_u`, `reaction` and `f_bias` of MEMORY; fills `f_S` (6,).

    Args:
        t: Tick.
    """
    work = t.work
    bias = turned(work, wrench_to_energy(work, t.memory.f_bias))
    f_S = plus(plus(work.chain_bias, bias), times6(work.Lambda, work.acceleration_t))
    for a in range(work.rank):
        f_S = add(f_S, work.alpha_u[a] + work.reaction[a], work.pushed_t[a])
    fill(work.f_S, f_S)


@leaf
def predict_joints(t):
    """Compute joint accelerations and torques for the commanded acceleration a of the object.

        q̈ = J̄a + offset,   τ = h + Mq̈

    J̄ (n, 6) is the inertia-weighted inverse of the Jacobian, `offset` the acceleration of the
    joints at a = 0, h (n,) the torque of velocities and gravity, M (n, n) the joint-space inertia
    of an arm. Reads `acceleration_t`, and J̄, `offset`, `h`, M of the joints; fills `acceleration`
    q̈ (rad/s², m/s²) and `inertial` τ (N m, N) of the joints.

    Args:
        t: Tick.
    """
    joints = t.work.joints
    a = turned_back(t.work, t.work.acceleration_t)  # in energy coordinates, as J̄
    for k in range(t.model.n_arms):
        lo = t.model.arms[k].first
        hi = t.model.arms[k].end
        for j in range(lo, hi):
            joints[j].acceleration = dot6(joints[j].J_bar, a) + joints[j].offset
        for j in range(lo, hi):
            s = joints[j].h
            for i in range(lo, hi):
                s += joints[j].M[i - lo] * joints[i].acceleration
            joints[j].inertial = s


@inner
def allocate_torques(t):
    """Compute the torques of least effort for the commanded force and internal forces, not limited.

        τ = τ_0 + R⁻¹AᵀZ⁻¹(b − A τ_0),   A = [G; E],   Z = A R⁻¹Aᵀ

    They satisfy A τ = b: G (d, n) maps torques to the wrench on the object along its d free axes,
    which has to be f_S; E has rows for internal forces and for motions of single arms. τ_0 (n,) are
    torques without command: of the posture law of redundant arms, else 0. R is the metric of the
    motors' effort. A single redundant arm in a regular posture has no such rows, and τ = τ_0 + Jᵀf
    with the wrench f; only `rest`, `tau` and `n_internal` are filled then.

    Reads `f_S`, `effort`, `locked`, `n_lost`, and the terms of arms and joints. Fills `rest` (τ_0)
    and `tau` of the joints (N m, N), `n_internal` (number of rows of E for internal forces),
    `extra` (E), `weighed` (R⁻¹Eᵀ), `factor` (Cholesky factor of Z), `sides` (b, then Z⁻¹(b − A
    τ_0)), and the fields that `internal_rows` fills.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`, or `UNACTUATED` if the motors cannot satisfy the conditions.
    """
    model = t.model
    arms = model.arms
    work = t.work
    joints = work.joints
    n = model.n_joints
    d = 6 - work.locked
    sides = work.sides
    _fill_rest(t)
    if model.n_arms == 1 and work.arms[0].wide and work.n_lost == 0:
        f = _embed_free(work, work.f_S[work.locked :])
        for j in range(n):
            joints[j].tau = joints[j].rest + dot6(joints[j].J, f)
        work.n_internal = 0
        return NO_REASON
    # conditions G τ = f_S, then the rows of E for internal forces and for motions of single arms
    for i in range(d):
        sides[i] = work.f_S[work.locked + i]
    work.n_internal = internal_rows(t, d)
    if not factor_effort(t):
        return UNACTUATED
    n_internal = _append_internal(t)
    if n_internal < 0:
        return UNACTUATED
    n_rows = _append_own_motions(t, d, n_internal)
    # Z⁻¹(b − A τ_0), of which each row of A contributes its part of the torques
    cholesky_solve(work.factor, d + n_rows, sides)
    y = _embed_free(work, sides)
    for k in range(model.n_arms):
        _add_torques(t, arms[k], work.arms[k], y)
    for e in range(n_rows):
        for j in range(n):
            joints[j].tau += sides[d + e] * work.weighed[e, j]
    return NO_REASON


@leaf
def _append_internal(t):
    """Append the rows of E for internal forces, `n_internal` of them, to the factor of Z.

    If the grasps of two arms transmit no independent squeeze, f_S determines it: the row is left
    out, and `n_internal` and `commanded` become 0.

    Args:
        t: Tick after `internal_rows`.

    Returns:
        Number of rows in use; −1 if a row depends on those before it with three arms or more.
    """
    work = t.work
    for e in range(work.n_internal):
        if not add_row(t, e):
            if t.model.n_arms != 2:
                return -1
            work.n_internal = 0
            work.commanded = 0
    return work.n_internal


@leaf
def _append_own_motions(t, d, n_internal):
    """Append the rows of E for motions of single arms to the factor of Z; return all rows of E.

    A row that depends on those before it is left out, and the following ones are moved forward.

    Args:
        t: Tick.
        d: number of elements of `sides` before those of E.
        n_internal: number of rows of E for internal forces.

    Returns:
        Number of rows of E in use.
    """
    n_own = _rows_of_own_motions(t, d, n_internal)
    n_rows = n_internal
    for e in range(n_internal, n_internal + n_own):
        if e > n_rows:  # a row before it was left out
            _move_row(t, d, e, n_rows)
        if add_row(t, n_rows):
            n_rows += 1
    return n_rows


@leaf
def _fill_rest(t):
    """Fill `rest` of all joints with τ_0 (N m, N), the torques without command.

    They are those of the posture law for arms with redundant joints (`wide`), whose `tau` it
    changes, too; else 0.

    Args:
        t: Tick.
    """
    for k in range(t.model.n_arms):
        arm = t.model.arms[k]
        if t.work.arms[k].wide:
            _fill_posture_torques(t, arm, t.work.arms[k])
        else:
            for j in range(arm.first, arm.end):
                t.work.joints[j].rest = 0.0


@leaf
def _move_row(t, d, start, end):
    """Move a row of E and its element of b forward, to the place of one that was left out.

    Args:
        t: Tick, of which `extra` (E) and `sides` (b) of WORK are changed.
        d: number of elements of `sides` before those of E.
        start: index of the row of E.
        end: its new index, < `start`.
    """
    work = t.work
    work.sides[d + end] = work.sides[d + start]
    for j in range(t.model.n_joints):
        work.extra[end, j] = work.extra[start, j]


@leaf
def push_from_limits(joint, q):
    """Acceleration a_l (rad/s², m/s²) of the posture law that repels a joint from its limits.

    It is zero between `low` and `high`, and rises smoothly to `most` over `width` beyond them.

    Args:
        joint: JOINT row.
        q: its position (rad, m).
    """
    if q < joint.low:
        depth = joint.low - q
        sign = 1.0
    else:
        depth = q - joint.high
        sign = -1.0
    if not depth > 0.0:  # also if NaN
        return 0.0
    s = min(depth / joint.width, 1.0)
    return sign * joint.most * s * s * (3.0 - 2.0 * s)


@leaf
def _fill_posture_torques(t, arm, arm_work):
    """Compute the posture torques (1 − JᵀJ̄ᵀ)τ₀ of an arm with redundant joints.

        τ₀ = h + M(k_p(q₀ − q) − k_d q̇) + diag(M) a_l

    The projection, with the Jacobian J (6, n) and its inertia-weighted inverse J̄ (n, 6), leaves
    torques that do not move the object. h (n,) is the torque of velocities and gravity, M (n, n)
    the joint-space inertia, k_p and k_d the gains of the posture law towards q₀; a_l repels joints
    from their limits (`push_from_limits`). Reads h, M, J, J̄ of the joints; fills their `rest` with
    the posture torques and `tau` with τ₀ (N m, N).

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
    """
    model = t.model
    joints = t.work.joints
    lo = arm.first
    wrench = ZERO
    for j in range(lo, arm.end):
        push = push_from_limits(model.joints[j], t.input.q[j])
        torque = (
            joints[j].h + joints[j].M[j - lo] * push + retreat(t, arm, j, model.posture_damping)
        )
        joints[j].rest = torque
        joints[j].tau = torque
        wrench = add(wrench, torque, joints[j].J_bar)  # J̄ᵀτ₀
    for j in range(lo, arm.end):
        joints[j].rest -= dot6(joints[j].J, wrench)
    if arm_work.n_lost > 0:
        _retreat_from_lost(t, arm, arm_work)


@inner
def _retreat_from_lost(t, arm, arm_work):
    """Add to `rest` the posture law along joint motions that the task loses in a singular posture.

    Such a joint motion w (n,) has wᵀMw = 1, so that the torque M w c has the component c along it.
    A direction that the chain counts as locked (`gone`) gets the posture law in place of τ₀;
    another one gets it in the share of the command that is not executed. Reads `mode` (w), `gone`
    and `share` of the arm; h, M and `tau` (τ₀ of `_fill_posture_torques`) of its joints.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
    """
    joints = t.work.joints
    lo = arm.first
    hi = arm.end
    for e in range(arm_work.n_lost):
        mode = arm_work.mode[e]
        component = 0.0  # c, added along w
        for j in range(lo, hi):
            posture_torque = joints[j].h + retreat(t, arm, j, t.model.retreat_damping)
            if arm_work.gone[e] != 0.0:
                component += mode[j - lo] * (posture_torque - joints[j].tau)
            else:
                component += mode[j - lo] * (1.0 - arm_work.share[e]) * posture_torque
        for j in range(lo, hi):
            for k in range(lo, hi):
                joints[j].rest += component * joints[j].M[k - lo] * mode[k - lo]


@inner
def _rows_of_own_motions(t, d, first):
    """Append rows of E for motions of single arms that do not move the object.

    An arm without redundant joints has such motions if its grasp permits them (a SCARA on a slide,
    four joints in a plane) or in a singular posture. The posture law acts along them: νᵀτ = νᵀ(h +
    M q̈) for every joint motion ν (n,) with U J ν = 0, where U are the wrenches that the joints
    resist, J (6, n) is the Jacobian, h (n,) the torque of velocities and gravity, M (n, n) the
    joint-space inertia and q̈ the acceleration of the posture law. Fills rows of `extra` (E: ν) and
    `sides` (b: the torque along it; N m, N), and lets `_subtract_rest` change the first d of
    `sides`.

    Args:
        t: Tick.
        d: number of elements of `sides` before those of E.
        first: index of the first new row of E.

    Returns:
        Number of these rows.
    """
    model = t.model
    work = t.work
    joints = work.joints
    count = first
    for k in range(model.n_arms):
        row = work.arms[k]
        arm = model.arms[k]
        lo = arm.first
        n = arm.end - lo
        if row.wide or row.n_kept >= n:
            continue
        J = local(MAX_JOINTS, 6)
        motions = local(MAX_JOINTS, MAX_JOINTS)
        for j in range(n):
            fill(J[j], joints[lo + j].J)
        null_motions(row, J, n, motions)
        for a in range(row.n_kept, n):  # the motions that do not move the object
            side = 0.0
            for j in range(model.n_joints):
                work.extra[count, j] = 0.0
            for i in range(n):
                posture_torque = retreat(t, arm, lo + i, model.retreat_damping)
                side += motions[a, i] * (joints[lo + i].h + posture_torque)
                work.extra[count, lo + i] = motions[a, i]
            work.sides[d + count] = side
            count += 1
    if count > first or work.n_lost > 0:  # else τ_0 does not move the object
        _subtract_rest(t, d)
    return count - first


@leaf
def _subtract_rest(t, d):
    """Subtract G τ_0, the force on the object by the torques without command, from `sides`.

    G (d, n), whose columns are the rows J̄ of the joints along the free axes, has to balance it.
    Reads `rest` (τ_0; N m, N) and J̄ of the joints.

    Args:
        t: Tick.
        d: number of free axes, and of the elements of `sides` that are changed.
    """
    work = t.work
    wrench = ZERO  # J̄ᵀτ_0
    for j in range(t.model.n_joints):
        wrench = add(wrench, work.joints[j].rest, work.joints[j].J_bar)
    driven = local(6)
    fill(driven, turned(work, wrench))
    for i in range(d):
        work.sides[i] -= driven[work.locked + i]


@leaf
def _add_torques(t, arm, arm_work, y):
    """Fill `tau` of an arm's joints with τ_0 + R⁻¹J̄ y, the torques for the force on the object.

    τ_0 is `rest` (N m, N), R the metric of the motors' effort, J̄ (n, 6) the inertia-weighted
    inverse of the Jacobian J (6, n). R⁻¹ is diagonal, with `effort` τ_max² of the joints; of a
    redundant arm (`wide`) it is JᵀWJ with W (6, 6) = `effort` of the arm, so that R⁻¹J̄ y = JᵀW y.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
        y: (6,) multipliers of the condition on the force on the object, in energy coordinates.
    """
    joints = t.work.joints
    if arm_work.wide == 0:
        for j in range(arm.first, arm.end):
            joints[j].tau = joints[j].rest + t.model.joints[j].effort * dot6(joints[j].J_bar, y)
        return
    x = times6(arm_work.effort, y)
    for j in range(arm.first, arm.end):
        joints[j].tau = joints[j].rest + dot6(joints[j].J, x)


@leaf
def limit_torques(t):
    """Copy the torques of the joints to the motors, unless one exceeds its limit or is not finite.

    Reads `tau` of the joints (N m, N), and their `motor` and `tau_max` of MODEL; fills `tau` (n_a,)
    of WORK.

    Args:
        t: Tick.

    Returns:
        Whether a torque exceeds its limit, and whether all torques are finite.
    """
    table = t.model.joints
    joints = t.work.joints
    excess = False
    total = 0.0
    for j in range(t.model.n_joints):
        if table[j].motor >= 0:
            total += joints[j].tau * 0.0  # NaN if the torque is not finite
            excess = excess or abs(joints[j].tau) > table[j].tau_max
    if not isfinite(total):
        return False, False
    if not excess:
        for j in range(t.model.n_joints):
            if table[j].motor >= 0:
                t.work.tau[table[j].motor] = joints[j].tau
    return excess, True
