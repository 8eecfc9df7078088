"""Motor torques for a commanded object force and internal forces: what to do with null(G)."""

from __future__ import annotations

from math import isfinite, sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, form_q, qr_rows
from osc_contact.law.bars import internal_rows
from osc_contact.law.chain import UNACTUATED
from osc_contact.law.jit import inner, leaf
from osc_contact.law.limits import dot
from osc_contact.law.operational import retreat
from osc_contact.law.reasons import NO_REASON
from osc_contact.law.vectors import add, dot6, fill, reflect, reflect_back, scaled, six, times6

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
    E = t.work.extra
    weighed = t.work.weighed
    Z = t.work.factor
    size = 6 - t.work.locked + e
    row = Z[size]
    for k in range(t.model.n_arms):
        _weigh(t, t.model.arms[k], t.work.arms[k], E[e], weighed[e])
    _multiply(t, weighed[e], e, row)
    whole = row[size] = dot(weighed[e], E[e], t.model.n_joints)
    left = whole - _eliminate(Z, size, row)
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
    joints = t.work.joints
    m = work.locked
    x = scaled(weighed[0], joints[0].J_bar)
    for j in range(1, t.model.n_joints):
        x = add(x, weighed[j], joints[j].J_bar)
    fill(work.u, x)
    reflect(work.reflectors, work.beta, m, work.u)
    for i in range(6 - m):
        out[i] = work.u[m + i]
    for c in range(e):
        out[6 - m + c] = dot(weighed, t.work.extra[c], t.model.n_joints)


@inner
def _eliminate(Z, size, x):
    """x[:size] = L⁻¹x, L the factor in Z; returns its square."""
    square = 0.0
    for i in range(size):
        s = x[i]
        for k in range(i):
            s -= Z[i, k] * x[k]
        x[i] = s * Z[i, i]
        square += x[i] * x[i]
    return square


@inner
def _project_again(t, e):
    """The pivot of row e, from what is left of it in the joints; mends its row of the factor."""
    work = t.work
    E = t.work.extra
    Z = t.work.factor
    n = t.model.n_joints
    m = work.locked
    size = 6 - m + e
    left = work.left
    weighed = work.left_weighed
    x = work.products
    for i in range(size - 1, -1, -1):  # multipliers of the rows before: L⁻ᵀ
        s = Z[size, i]
        for k in range(i + 1, size):
            s -= Z[k, i] * x[k]
        x[i] = s * Z[i, i]
    for i in range(6):
        work.u[i] = x[i - m] if i >= m else 0.0
    reflect_back(work.reflectors, work.beta, m, work.u)
    for j in range(n):
        s = E[e, j] - dot6(t.work.joints[j].J_bar, work.u)
        for c in range(e):
            s -= x[6 - m + c] * E[c, j]
        left[j] = s
    for k in range(t.model.n_arms):
        _weigh(t, t.model.arms[k], t.work.arms[k], left, weighed)
    _multiply(t, weighed, e, x)
    pivot = dot(weighed, left, n) - _eliminate(Z, size, x)
    for i in range(size):
        Z[size, i] += x[i]
    return pivot


@inner
def _weigh(t, arm, own, row, out):
    """out = R⁻¹ row, over one arm's joints."""
    joints = t.work.joints
    lo = arm.first
    hi = arm.end
    if own.wide == 0:
        for j in range(lo, hi):
            out[j] = t.model.joints[j].effort * row[j]
        return
    x = scaled(row[lo], joints[lo].J)
    for j in range(lo + 1, hi):
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
    r = work.rank
    m = work.locked
    x = work.x
    bias = work.u
    held = 1.0 if t.model.held != 0 else 0.0
    _energy_of(t, t.memory.f_bias, bias)
    reflect(work.reflectors, work.beta, m, bias)
    for i in range(6):
        s = work.chain_bias[i] + bias[i] + held * x[i] + dot6(work.Lambda[i], x)
        for a in range(r):
            s += work.pushed_t[a, i] * work.alpha_u[a]
        work.f_S[i] = s


@inner
def _energy_of(t, f, out):
    """A wrench at O in energy coordinates."""
    work = t.work
    x = work.C[0] - work.O[0]
    y = work.C[1] - work.O[1]
    z = work.C[2] - work.O[2]
    a = f[3] - (y * f[2] - z * f[1])
    b = f[4] - (z * f[0] - x * f[2])
    c = f[5] - (x * f[1] - y * f[0])
    axes = work.axes
    for i in range(3):
        out[i] = axes[2, i, 0] * f[0] + axes[2, i, 1] * f[1] + axes[2, i, 2] * f[2]
        out[3 + i] = axes[3, i, 0] * a + axes[3, i, 1] * b + axes[3, i, 2] * c


@leaf
def predict_joints(t):
    """q̈ = J̄a + offset, and the torque h + Mq̈ that it takes; a is the object's acceleration `x`."""
    arms = t.model.arms
    work = t.work
    joints = t.work.joints
    fill(work.w, six(work.x))
    reflect_back(work.reflectors, work.beta, work.locked, work.w)
    a = six(work.w)
    for k in range(t.model.n_arms):
        lo = arms[k].first
        hi = arms[k].end
        for j in range(lo, hi):
            joints[j].acceleration = dot6(joints[j].J_bar, a) + joints[j].offset
        for j in range(lo, hi):
            s = joints[j].h
            M = joints[j].M
            for i in range(lo, hi):
                s += M[i - lo] * joints[i].acceleration
            joints[j].inertial = s


@inner
def allocate_torques(t):
    """Torques of all joints (`tau`), not yet limited; returns a reason."""
    model = t.model
    arms = model.arms
    work = t.work
    arm_work = t.work.arms
    joints = t.work.joints
    n = model.n_joints
    m = work.locked
    d = 6 - m
    E = work.extra
    b = work.sides
    for k in range(model.n_arms):
        arm = arms[k]
        own = arm_work[k]
        if own.wide != 0:
            _hold_posture(t, arm, own)
        else:
            for j in range(arm.first, arm.end):
                joints[j].rest = 0.0
    if model.n_arms == 1 and arm_work[0].wide != 0 and work.n_lost == 0:
        _exert(t, arms[0])
        work.n_internal = 0
        return NO_REASON
    for i in range(d):
        b[i] = work.f_S[m + i]
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
                E[size - d, j] = E[e, j]
        if add_row(t, size - d):
            size += 1
    count = size - d
    cholesky_solve(work.factor, size, b, 0)
    y = work.y
    for i in range(6):
        y[i] = b[i - m] if i >= m else 0.0
    reflect_back(work.reflectors, work.beta, m, y)
    for k in range(model.n_arms):
        _add_torques(t, arms[k], arm_work[k], y)
    for e in range(count):
        for j in range(n):
            joints[j].tau += b[d + e] * work.weighed[e, j]
    return NO_REASON


@leaf
def _exert(t, arm):
    """τ = τ_0 + Jᵀf of one arm with joints to spare: no other arm shares the object force."""
    joints = t.work.joints
    work = t.work
    f = work.y
    m = work.locked
    for i in range(6):
        f[i] = work.f_S[i] if i >= m else 0.0
    reflect_back(work.reflectors, work.beta, m, f)
    for j in range(arm.first, arm.end):
        joints[j].tau = joints[j].rest + dot6(joints[j].J, f)


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
    table = t.model.joints
    joints = t.work.joints
    q = t.input.q
    lo = arm.first
    hi = arm.end
    stiffness = t.model.posture_stiffness
    damping = t.model.posture_damping
    moved = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for j in range(lo, hi):
        M = joints[j].M
        s = joints[j].h + M[j - lo] * push_from_limits(table[j], q[j])
        for k in range(lo, hi):
            s += M[k - lo] * (stiffness * (table[k].posture - q[k]) - damping * t.input.v[k])
        joints[j].rest = s
        joints[j].tau = s  # τ₀ itself
        moved = add(moved, s, joints[j].J_bar)
    for j in range(lo, hi):
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
            back = joints[j].h
            for k in range(lo, hi):
                back += joints[j].M[k - lo] * retreat(
                    t, t.model.joints[k], t.input.q[k], t.input.v[k]
                )
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
    joints = t.work.joints
    E = t.work.extra
    b = t.work.sides
    X = work.X
    Q = work.Z
    count = first
    for k in range(model.n_arms):
        arm = model.arms[k]
        own = t.work.arms[k]
        lo = arm.first
        n = arm.end - arm.first
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
                E[count, j] = 0.0
            for i in range(n):
                s = joints[lo + i].h
                for j in range(n):
                    s += joints[lo + i].M[j] * retreat(
                        t, model.joints[lo + j], t.input.q[lo + j], t.input.v[lo + j]
                    )
                side += Q[a, i] * s
                E[count, lo + i] = Q[a, i]
            b[d + count] = side
            count += 1
    if count > first or work.n_lost > 0:
        x = scaled(joints[0].rest, joints[0].J_bar)
        for j in range(1, model.n_joints):
            x = add(x, joints[j].rest, joints[j].J_bar)
        fill(work.u, x)
        reflect(work.reflectors, work.beta, work.locked, work.u)
        for i in range(d):
            b[i] -= work.u[work.locked + i]
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
        i = table[j].motor
        if i >= 0:
            total += joints[j].tau * 0.0
            excess = excess or abs(joints[j].tau) > table[j].tau_max
    if not isfinite(total):
        return False, False
    if not excess:
        for j in range(t.model.n_joints):
            if table[j].motor >= 0:
                t.work.tau[table[j].motor] = joints[j].tau
    return excess, True
