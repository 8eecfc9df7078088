"""Motor torques for a commanded object force and internal forces: what to do with null(G)."""

from __future__ import annotations

from math import isfinite, sqrt

from osc_contact.law.algebra import (
    add_scaled,
    backward,
    cholesky,
    cholesky_solve,
    dot,
    form_q,
    forward,
    qr_rows,
)
from osc_contact.law.bars import internal_rows
from osc_contact.law.chain import UNACTUATED
from osc_contact.law.jit import inner, leaf
from osc_contact.law.operational import retreat
from osc_contact.law.reasons import NO_REASON
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
# A row of E that the rows before it decide (a squeeze that the grasps do not pass on) has a pivot
# of zero. Elimination leaves rounding errors there, as large as eps times the condition number of
# Z, and near a singular posture no threshold separates them from a pivot. So what is left of a
# doubtful row is projected a second time, in the joints, as in Gram-Schmidt with
# reorthogonalisation (Björck, Numerical Methods for Least Squares Problems, 1996, section 2.4.5).

_DRIVEN = 1e-12  #: least share of a pivot of Z
_DOUBTFUL = 1e-6  #: pivots of less share than this are computed twice


@inner
def factor_effort(t):
    """Factor of the block G R⁻¹Gᵀ, into Z; False: motors do not drive all motions."""
    work = t.work
    Z = t.work.factor
    d = 6 - work.locked
    for i in range(d):
        for j in range(i + 1):
            Z[i, j] = work.effort[work.locked + i, work.locked + j]
    return cholesky(Z, 0, d, Z) > _DRIVEN


@inner
def add_row(t, e):
    """Factor of Z with one row more; False: the rows before it decide what E[e]τ is.

    Args:
        e: the row of E.
    """
    work = t.work
    a = work.extra[e]
    size = 6 - work.locked + e
    row = work.factor[size]
    _weigh(t, a, work.weighed[e])
    _multiply(t, work.weighed[e], e, row)
    whole = row[size] = dot(work.weighed[e], a, t.model.n_joints)
    forward(work.factor, size, row, 0)
    left = whole - dot(row, row, size)
    if left < _DOUBTFUL * whole:
        left = _project_again(t, e)
    if not left > _DRIVEN * whole:
        return False
    row[size] = 1.0 / sqrt(left)
    return True


@inner
def _multiply(t, weighed, e, out):
    """out = A R⁻¹a, the products of a weighed row with G and with E[:e]."""
    work = t.work
    m = work.locked
    x = ZERO
    for j in range(t.model.n_joints):
        x = add(x, weighed[j], work.joints[j].J_bar)
    fill(work.u, turned(work, x))
    for i in range(6 - m):
        out[i] = work.u[m + i]
    for c in range(e):
        out[6 - m + c] = dot(weighed, work.extra[c], t.model.n_joints)


@inner
def _project_again(t, e):
    """The pivot of row e, from what is left of it in the joints; mends its row of the factor."""
    work = t.work
    Z = work.factor
    n = t.model.n_joints
    m = work.locked
    size = 6 - m + e
    left = work.left
    x = work.products
    for i in range(size):
        x[i] = Z[size, i]
    backward(Z, size, x, 0)  # multipliers of the rows before
    y = _from_free(work, x)
    for j in range(n):
        left[j] = work.extra[e, j] - dot6(work.joints[j].J_bar, y)
    for c in range(e):
        add_scaled(-x[6 - m + c], work.extra[c], n, left)
    _weigh(t, left, work.left_weighed)
    _multiply(t, work.left_weighed, e, x)
    forward(Z, size, x, 0)
    add_scaled(1.0, x, size, Z[size])
    return dot(work.left_weighed, left, n) - dot(x, x, size)


@leaf
def _from_free(work, x):
    """A vector (6,) in energy coordinates, from its part (d,) along the free axes."""
    for i in range(6):
        work.u[i] = x[i - work.locked] if i >= work.locked else 0.0
    return turned_back(work, work.u)


@inner
def _weigh(t, row, out):
    """out = R⁻¹ row."""
    joints = t.work.joints
    for k in range(t.model.n_arms):
        own = t.work.arms[k]
        lo = t.model.arms[k].first
        hi = t.model.arms[k].end
        if own.wide == 0:
            for j in range(lo, hi):
                out[j] = t.model.joints[j].effort * row[j]
            continue
        x = ZERO
        for j in range(lo, hi):
            x = add(x, row[j], joints[j].J)
        x = times6(own.effort, x)
        for j in range(lo, hi):
            out[j] = dot6(joints[j].J, x)


# --- Motor torques for a commanded object force and internal forces -------------------------------
#
# The least torque in the weight 1/τ_max² (R below) with G τ = f_S and E τ = e:
#
#     τ = τ_0 + R⁻¹AᵀZ⁻¹(b − A τ_0),   A = [G; E],   Z = A R⁻¹Aᵀ
#
# E holds the squeeze of two arms, the settable bar forces of three and more (`linkage`), and the
# motions that only single arms have, because their grasp or their posture leaves them
# idle, as far as the motors drive them. Arms with more joints than they need hold their posture
# in the dynamically consistent null space, τ_0 = (1 − JᵀJ̄ᵀ)(h + M(−k_d q̇ + k_p(q₀ − q)) +
# diag(M) a_l(q)); passive joints have no torque.


@inner
def command_object(t):
    """f_S (6,) = Λ_S η̇_c + b_S + Sᵀ(N_μ α_u + f_bias): eq. 21, turned."""
    work = t.work
    bias = turned(work, wrench_to_energy(work, t.memory.f_bias))
    held = 1.0 if t.model.held != 0 else 0.0
    f_S = add(plus(work.chain_bias, bias), held, work.x)
    f_S = plus(f_S, times6(work.Lambda, work.x))
    for a in range(work.rank):
        f_S = add(f_S, work.alpha_u[a], work.pushed_t[a])
    fill(work.f_S, f_S)


@leaf
def predict_joints(t):
    """q̈ = J̄a + offset, and the torque h + Mq̈ that it takes; a is the object's acceleration `x`."""
    joints = t.work.joints
    a = turned_back(t.work, t.work.x)
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
    """Torques of all joints (`tau`), not yet limited; returns a reason."""
    model = t.model
    arms = model.arms
    work = t.work
    joints = work.joints
    n = model.n_joints
    d = 6 - work.locked
    b = work.sides
    for k in range(model.n_arms):
        if work.arms[k].wide != 0:
            _hold_posture(t, arms[k], work.arms[k])
        else:
            for j in range(arms[k].first, arms[k].end):
                joints[j].rest = 0.0
    if model.n_arms == 1 and work.arms[0].wide != 0 and work.n_lost == 0:
        f = _from_free(work, work.f_S[work.locked :])  # τ = τ_0 + Jᵀf: no other arm has a share
        for j in range(n):
            joints[j].tau = joints[j].rest + dot6(joints[j].J, f)
        work.n_internal = 0
        return NO_REASON
    for i in range(d):
        b[i] = work.f_S[work.locked + i]
    count = 0
    if model.n_bars > 0:
        count = internal_rows(t, d)
    work.n_internal = count
    if not factor_effort(t):
        return UNACTUATED
    for e in range(count):
        if not add_row(t, e):
            if model.n_arms != 2:
                return UNACTUATED
            count = 0  # the grasps pass on no separate squeeze: f_S decides it
            work.n_internal = 0
            work.internal[0] = 0.0
    size = d + count
    own = _own_motions(t, d, count)
    for e in range(count, count + own):
        if e > size - d:  # one before it was left out
            b[size] = b[d + e]
            for j in range(n):
                work.extra[size - d, j] = work.extra[e, j]
        if add_row(t, size - d):
            size += 1
    cholesky_solve(work.factor, size, b, 0)
    y = _from_free(work, b)
    for k in range(model.n_arms):
        _add_torques(t, arms[k], work.arms[k], y)
    for e in range(size - d):
        for j in range(n):
            joints[j].tau += b[d + e] * work.weighed[e, j]
    return NO_REASON


@leaf
def push_from_limits(joint, q):
    """Acceleration away from joint limits, see `control.joint_limits`."""
    depth, sign = (joint.low - q, 1.0) if q < joint.low else (q - joint.high, -1.0)
    if not depth > 0.0:
        return 0.0
    s = min(depth / joint.width, 1.0)
    return sign * joint.most * s * s * (3.0 - 2.0 * s)


@leaf
def _hold_posture(t, arm, own):
    """rest = (1 − JᵀJ̄ᵀ)τ₀, τ₀ = h + M(−k_d q̇ + k_p(q₀ − q)) + diag(M) a_l(q), of a wide arm."""
    model = t.model
    joints = t.work.joints
    q = t.input.q
    lo = arm.first
    moved = ZERO
    for j in range(lo, arm.end):
        M = joints[j].M
        s = joints[j].h + M[j - lo] * push_from_limits(model.joints[j], q[j])
        for k in range(lo, arm.end):
            back = model.posture_stiffness * (model.joints[k].posture - q[k])
            s += M[k - lo] * (back - model.posture_damping * t.input.v[k])
        joints[j].rest = s
        joints[j].tau = s  # τ₀ itself
        moved = add(moved, s, joints[j].J_bar)
    for j in range(lo, arm.end):
        joints[j].rest -= dot6(joints[j].J, moved)
    if own.n_lost > 0:
        _retreat_from_lost(t, arm, own)


@inner
def _retreat_from_lost(t, arm, own):
    """In joint motions that a singular posture takes from the task the posture law has its way."""
    joints = t.work.joints
    lo = arm.first
    hi = arm.end
    for e in range(own.n_lost):
        mode = own.mode[e]
        along = 0.0
        for j in range(lo, hi):
            back = retreat(t, lo, hi, j, joints[j].h)
            if own.gone[e] != 0.0:
                along += mode[j - lo] * (back - joints[j].tau)
            else:
                along += mode[j - lo] * (1.0 - own.share[e]) * back
        for j in range(lo, hi):
            for k in range(lo, hi):
                joints[j].rest += along * joints[j].M[k - lo] * mode[k - lo]


@inner
def _own_motions(t, d, first):
    """Rows E[first:] that keep the posture in motions of narrow arms alone; how many.

    Such an arm can move without the object where its grasp leaves it idle motions (a SCARA on a
    slide, four joints in a plane) or in a singular posture: νᵀτ = νᵀ(h + M q̈_posture) for every
    joint motion ν with U J ν = 0. Takes from b what τ_0 of the others does to the object.
    """
    model = t.model
    work = t.work
    joints = work.joints
    X = work.X
    Q = work.Z
    count = first
    for k in range(model.n_arms):
        own = work.arms[k]
        lo = model.arms[k].first
        n = model.arms[k].end - lo
        if own.wide != 0 or own.n_kept >= n:
            continue
        for a in range(own.n_kept):
            for j in range(n):
                X[a, j] = dot6(own.kept[a], joints[lo + j].J)
        qr_rows(X, own.n_kept, n, work.s, work.t)
        form_q(X, own.n_kept, n, work.t, n, Q)
        for a in range(own.n_kept, n):
            side = 0.0
            for j in range(model.n_joints):
                work.extra[count, j] = 0.0
            for i in range(n):
                side += Q[a, i] * retreat(t, lo, lo + n, lo + i, joints[lo + i].h)
                work.extra[count, lo + i] = Q[a, i]
            work.sides[d + count] = side
            count += 1
    if count > first or work.n_lost > 0:
        x = ZERO
        for j in range(model.n_joints):
            x = add(x, joints[j].rest, joints[j].J_bar)
        fill(work.u, turned(work, x))
        for i in range(d):
            work.sides[i] -= work.u[work.locked + i]
    return count - first


@leaf
def _add_torques(t, arm, own, y):
    """τ = τ_0 + R⁻¹J̄ y, y (6,) multipliers of f_S in energy coordinates."""
    joints = t.work.joints
    if own.wide == 0:
        for j in range(arm.first, arm.end):
            joints[j].tau = joints[j].rest + t.model.joints[j].effort * dot6(joints[j].J_bar, y)
        return
    x = times6(own.effort, y)
    for j in range(arm.first, arm.end):
        joints[j].tau = joints[j].rest + dot6(joints[j].J, x)


@leaf
def limit_torques(t):
    """Motor torques to tau[first:]; whether one exceeds its limit, and whether all are finite."""
    table = t.model.joints
    joints = t.work.joints
    excess = False
    total = 0.0
    for j in range(t.model.n_joints):
        if table[j].motor >= 0:
            total += joints[j].tau * 0.0
            excess = excess or abs(joints[j].tau) > table[j].tau_max
    if not isfinite(total):
        return False, False
    for j in range(0 if excess else t.model.n_joints):
        if table[j].motor >= 0:
            t.work.tau[table[j].motor] = joints[j].tau
    return excess, True
