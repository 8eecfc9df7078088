"""The operational-space terms of one arm, and motions lost near a singular posture."""

from __future__ import annotations

from math import isfinite, sqrt

from osc_contact.law.algebra import (
    add_scaled,
    backward,
    cholesky,
    cholesky_solve,
    dot,
    forward,
    invert_spd6,
    one_sided_jacobi,
    orthonormalise,
    project_onto_constraint,
    square_lower,
)
from osc_contact.law.arm_motion import move_arm, place_arm, place_point, weight_on_joint
from osc_contact.law.jit import entry, inner, leaf
from osc_contact.law.records import row_of
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    cross,
    dot6,
    fill,
    fill3,
    finiteness,
    form_q6,
    mirror,
    plus,
    plus3,
    qr6,
    reflector,
    scaled,
    six,
    turned,
    turned_back,
)

# --- J̄ and Λ of one arm in energy coordinates, what it locks, its effort -------------------------

_DEFINITE = 1e-12  #: least share of a pivot of an effort metric


@inner
def arm_terms(t, lo, n, m, arm, row):
    """J̄, Λ and the locked wrenches of one arm; returns their number, or −1 if M is not definite.

    With M = KKᵀ and J K⁻ᵀ = U Σ Vᵀ arm and object together have the inertia 1 + 1/σ²: directions
    with σ²(1 + σ_max²) ≤ tolerance² σ_max² count as locked, whatever the object weighs. The QR
    below decides where 1/λ_max(Λ), the least σ² of all, is above that beyond doubt.

    Args:
        lo, n: its first joint, its number of joints. m: wrenches that its grasp passes on.
        arm: ARM_WORK row; Lambda, kept, n_kept, n_locked filled. row: of `locked_rows`, from which
            on the wrenches that it locks are put.
    """
    work = t.work
    joints = work.joints
    X = work.X
    Z = work.Z
    count = -1
    if m == 6 and n > 6:
        if _invert_wide(t, lo, n, arm.Lambda):
            count = 0
    elif m == 6:
        for j in range(n):
            fill(X[j], joints[lo + j].J)
        if qr6(X, n, work.K, work.s, work.t):
            form_q6(X, n, work.t, Z)
            for j in range(n - 1, -1, -1):
                x = six(Z[j])
                for k in range(j + 1, n):
                    x = add(x, -work.K[j, k], joints[lo + k].J_bar)
                fill(joints[lo + j].J_bar, scaled(1.0 / work.s[j], x))
            for k in range(6 - n):
                fill(work.locked_rows[row + k], Z[n + k])
            count = 6 - n
            _apply_inertia(lo, n, joints, X, arm.Lambda)
    trace = 0.0
    for i in range(6):
        trace += arm.Lambda[i, i]
    if count < 0 or not trace * t.model.rank_tolerance * t.model.rank_tolerance < 1.0:
        return _separate(t, lo, n, m, arm, row)
    arm.n_locked = count
    arm.n_kept = 6 - count
    return count


@leaf
def _apply_inertia(lo, n, joints, X, Lambda):
    """Λ = J̄ᵀ M J̄."""
    for j in range(n):
        x = ZERO
        for k in range(n):
            x = add(x, joints[lo + j].M[k], joints[lo + k].J_bar)
        fill(X[j], x)
    for a in range(6):
        x = ZERO
        for j in range(n):
            x = add(x, joints[lo + j].J_bar[a], X[j])
        fill(Lambda[a], x)
    mirror(Lambda)


@leaf
def factor_inertia(lo, n, joints, K):
    """K (n, n) with M = KKᵀ, its inverse pivots on the diagonal as in `cholesky`.

    Args:
        lo: first joint of the arm. n: how many. joints: JOINT_WORK rows. K: (n, n) for the factor.
    """
    for i in range(n):
        M = joints[lo + i].M
        for j in range(i + 1):
            K[i, j] = M[j]
    return cholesky(K, 0, n, K) > 0.0


@leaf
def weigh_joints(lo, n, joints, K, Z):
    """Z[:n, :6] = K⁻¹Jᵀ, K as in `factor_inertia`; False: M is not definite.

    Args:
        lo: first joint of the arm. n: how many. joints: JOINT_WORK rows. K: for the factor.
        Z: rows of six.
    """
    if not factor_inertia(lo, n, joints, K):
        return False
    for j in range(n):
        x = six(joints[lo + j].J)
        for k in range(j):
            x = add(x, -K[j, k], Z[k])
        fill(Z[j], scaled(K[j, j], x))
    return True


@inner
def solve_inertia_transposed(lo, n, K, joints):
    """J̄ ← K⁻ᵀJ̄.

    Args:
        lo: first joint of the arm. n: how many. K: from `factor_inertia`. joints: JOINT_WORK rows.
    """
    for j in range(n - 1, -1, -1):
        x = six(joints[lo + j].J_bar)
        for k in range(j + 1, n):
            x = add(x, -K[k, j], joints[lo + k].J_bar)
        fill(joints[lo + j].J_bar, scaled(K[j, j], x))


@leaf
def _invert_wide(t, lo, n, Lambda):
    """More joints than directions: A = J K⁻ᵀ, J̄ = K⁻ᵀA⁺, Λ = A⁺ᵀA⁺; False: rank below six."""
    joints = t.work.joints
    work = t.work
    K = work.K
    X = work.X
    Z = work.Z
    if not weigh_joints(lo, n, joints, K, Z):
        return False
    if not _qr_tall(Z, n, X, work.A, work.t, work.u):  # Aᵀ = QR
        return False
    T = work.A  # R, then R⁻ᵀ: A⁺ = Q R⁻ᵀ
    B = work.B
    for d in range(6):
        x = ZERO
        for c in range(d):
            x = add(x, -T[c, d], B[c])
        fill(B[d], x)
        B[d, d] += 1.0
        fill(B[d], scaled(1.0 / T[d, d], B[d]))
    square_lower(B, Lambda)
    for j in range(n):
        x = ZERO
        for d in range(6):
            x = add(x, X[j, d], B[d])
        fill(joints[lo + j].J_bar, x)
    solve_inertia_transposed(lo, n, K, joints)
    return True


@inner
def _qr_tall(A, n, Q, R, beta, scratch):
    """A = QR of n > 6 rows of six, by Householder reflections; A is destroyed.

    Returns False where a column depends on those before it to the last digit.
    """
    for k in range(6):
        t = scaled(A[k, k], A[k])
        for i in range(k + 1, n):
            t = add(t, A[i, k], A[i])
        fill(scratch, t)  # of the column itself: its square, and its products with the others
        if not scratch[k] > 0.0:
            return False
        alpha, b = reflector(scratch[k], A[k, k])
        fill(scratch, scaled(b, add(t, -alpha, A[k])))
        for c in range(k + 1):
            scratch[c] = 0.0
        A[k, k] -= alpha
        beta[k] = b
        t = six(scratch)
        for i in range(k, n):
            accumulate(A[i], -A[i, k], t)
        fill(R[k], A[k])
        R[k, k] = alpha
    for i in range(n):
        fill(Q[i], ZERO)
        if i < 6:
            Q[i, i] = 1.0
    for k in range(5, -1, -1):
        t = ZERO
        for i in range(k, n):
            t = add(t, A[i, k], Q[i])
        t = scaled(beta[k], t)
        for i in range(k, n):
            accumulate(Q[i], -A[i, k], t)
    return True


@inner
def _separate(t, lo, n, m, arm, row):
    """The same for any rank and any grasp, by singular values: A = N J K⁻ᵀ = UΣVᵀ."""
    work = t.work
    joints = work.joints
    X = work.X
    Z = work.Z
    if not weigh_joints(lo, n, joints, work.K, Z):
        return -1
    for i in range(m):
        for j in range(n):
            X[i, j] = Z[j, i] if m == 6 else dot6(arm.passed[i], Z[j])
        for k in range(6):
            X[i, n + k] = arm.passed[i, k] if m < 6 else (1.0 if i == k else 0.0)
    one_sided_jacobi(X, m, n, 6)
    arm.Lambda[:] = 0.0
    for j in range(n):
        fill(joints[lo + j].J_bar, ZERO)
    arm.n_locked = 0
    arm.n_kept = 0
    largest = 0.0
    for k in range(m):
        largest = max(largest, dot(X[k], X[k], n))
    least = t.model.rank_tolerance * t.model.rank_tolerance * largest / (1.0 + largest)
    for k in range(m):
        square = dot(X[k], X[k], n)
        u = X[k, n:]
        if square > least:
            for j in range(n):
                bar = joints[lo + j].J_bar
                for i in range(6):
                    bar[i] += X[k, j] * u[i] / square
            for a in range(6):
                for b in range(6):
                    arm.Lambda[a, b] += u[a] * u[b] / square
            fill(arm.kept[arm.n_kept], u)
            arm.n_kept += 1
        else:
            fill(work.locked_rows[row + arm.n_locked], u)
            arm.n_locked += 1
    solve_inertia_transposed(lo, n, work.K, joints)
    return arm.n_locked


@leaf
def effort_metric(t, lo, n, m, arm, out):
    """(6, 6) least effort per wrench, Σ τ²/τ_max², of an arm; False: its motors cannot make all.

    J̄ᵀ τ_max² J̄ where every torque is needed; for arms with more joints than m wrenches
    Uᵀ(U J τ_max⁻² JᵀUᵀ)⁻¹U, the rows of U the wrenches that they can make.

    Args:
        lo: first joint of the arm. n: how many. m: wrenches that the arm can make.
        arm: ARM_WORK row. out: (6, 6) for the metric.
    """
    joints = t.work.joints
    table = t.model.joints
    if n <= m:
        for a in range(6):
            x = ZERO
            for j in range(lo, lo + n):
                x = add(x, table[j].effort * joints[j].J_bar[a], joints[j].J_bar)
            fill(out[a], x)
        mirror(out)
        return True
    if arm.n_kept == 6:
        for a in range(6):
            x = ZERO
            for j in range(lo, lo + n):
                x = add(x, table[j].ease * joints[j].J[a], joints[j].J)
            fill(t.work.A[a], x)
        return invert_spd6(t.work.A, t.work.B, out) > _DEFINITE
    return _effort_of_kept(t, lo, n, arm, out)


@inner
def _effort_of_kept(t, lo, n, arm, out):
    """The same where the arm makes fewer than six wrenches, the rows of `kept`."""
    count = arm.n_kept
    U = arm.kept
    A = t.work.A
    B = t.work.B
    x = t.work.u
    A[:] = 0.0
    out[:] = 0.0
    for j in range(lo, lo + n):
        for a in range(count):
            x[a] = dot6(U[a], t.work.joints[j].J)
            for b in range(a + 1):
                A[a, b] += x[a] * x[b] * t.model.joints[j].ease
    if count > 0 and not cholesky(A, 0, count, B) > _DEFINITE:
        return False
    for i in range(6):
        for a in range(count):
            x[a] = U[a, i]
        cholesky_solve(B, count, x, 0)
        for a in range(count):
            for j in range(6):
                out[j, i] += U[a, j] * x[a]
    return True


# --- Motions that an arm is about to lose near a singular posture ---------------------------------
#
# An arm is measured against Λ_ref, the object and, at its centre of mass, a ball as heavy as the
# heaviest arm. With Λ_ref = LLᵀ and M = KKᵀ
#
#     LᵀJK⁻ᵀ = U diag(χ) Vᵀ
#
# is free of units, and 1/χ² is the arm's apparent inertia in the direction u beside that of Λ_ref.
# In energy coordinates Λ_ref is diagonal.

#: Commands are reduced where χ is below FULL and are zero at NONE_LEFT.
NONE_LEFT = 0.05
FULL = 0.3
_HARD = 1e-8  # shares below it are as good as 0
_GONE = 1e-6  # of the mobility that Λ_ref has along any direction, 1
_SMALL = 1e-9  # χ below it determines no motion of the joints


@leaf
def may_be_singular(t, arm, own):
    """Whether some χ may be below FULL: a bound that never misses one.

    ΣΣ Λ_ij²/(Λ_ii Λ_jj)_ref ≥ 1/χ⁴, in energy coordinates.

    Args:
        arm: ARM row. own: its ARM_WORK.
    """
    if own.n_kept < arm.full_rank:
        return True
    s = 0.0
    for i in range(6):
        row = 0.0
        for j in range(6):
            row += own.Lambda[i, j] * own.Lambda[i, j] * t.model.lightness[j]
        s += row * t.model.lightness[i]
    return s * FULL * FULL * FULL * FULL >= 1.0


@inner
def find_lost(t, arm, own):
    """Every direction of an arm whose χ is below FULL: its χ, share, wrench and joint motion.

    Fills n_lost, chi, share, gone, lost (6, 6) wrenches Lu, mode (6, n) joint motions K⁻ᵀv.

    Args:
        arm: ARM row. own: its ARM_WORK.
    """
    work = t.work
    n = arm.end - arm.first
    m = arm.m
    X = work.X
    Z = work.Z
    root = work.u
    if not weigh_joints(arm.first, n, work.joints, work.K, Z):
        return
    for i in range(6):
        root[i] = sqrt(t.model.reference[i])
    if m == 6:  # all wrenches: the axes themselves are orthonormal
        for a in range(6):
            for j in range(n):
                X[a, j] = root[a] * Z[j, a]
            for i in range(6):
                X[a, n + i] = 1.0 if i == a else 0.0
    else:
        _passed_rows(t, own, Z, root, m, n)
    one_sided_jacobi(X, m, n, 6)
    _sort_rows(X, m, n)
    for k in range(arm.full_rank):
        chi = sqrt(dot(X[k], X[k], n))
        _unit_row(X, k, n, chi)
        if chi >= FULL:
            continue
        at = own.n_lost
        own.chi[at] = chi
        own.share[at] = _share_left(chi)
        own.gone[at] = 1.0 if k >= own.n_kept else 0.0
        for i in range(6):
            own.lost[at, i] = root[i] * X[k, n + i]
        for j in range(n):
            own.mode[at, j] = X[k, j]
        backward(work.K, n, own.mode[at], 0)
        own.n_lost += 1
        work.n_lost += 1


@inner
def _passed_rows(t, own, Z, root, m, n):
    """Rows of X for the wrenches that a grasp passes on, orthonormal in Λ_ref."""
    work = t.work
    X = work.X
    for a in range(m):
        for i in range(6):
            work.A[a, i] = own.passed[a, i] / root[i]
    orthonormalise(work.A, m, 0, work.B, work.D)
    for a in range(m):
        for j in range(n):
            s = 0.0
            for i in range(6):
                s += work.B[a, i] * root[i] * Z[j, i]
            X[a, j] = s
        for i in range(6):
            X[a, n + i] = work.B[a, i]


@inner
def _sort_rows(X, m, n):
    """Rows by falling length of their first n elements."""
    for a in range(m):
        best = a
        longest = -1.0
        for b in range(a, m):
            square = dot(X[b], X[b], n)
            if square > longest:
                best = b
                longest = square
        if best != a:
            for j in range(n + 6):
                X[a, j], X[best, j] = X[best, j], X[a, j]


@inner
def _unit_row(X, k, n, chi):
    """Row k made a unit vector v; of a null row, any that is new to the others."""
    if chi > _SMALL:
        for j in range(n):
            X[k, j] /= chi
        return
    best = 0
    largest = -1.0
    for e in range(n):  # the unit vector that sticks out most
        left = 1.0
        for b in range(k):
            left -= X[b, e] * X[b, e]
        if left > largest:
            best = e
            largest = left
    for j in range(n):
        X[k, j] = 1.0 if j == best else 0.0
    for _ in range(2):
        for b in range(k):
            add_scaled(-dot(X[b], X[k], n), X[b], n, X[k])
    norm = sqrt(dot(X[k], X[k], n))
    for j in range(n):
        X[k, j] /= norm


@inner
def _share_left(chi):
    """1 at χ ≥ FULL, 0 at χ ≤ NONE_LEFT, 3s² − 2s³ between."""
    s = min(max((chi - NONE_LEFT) / (FULL - NONE_LEFT), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@inner
def retreat(t, lo, hi, i, start):
    """start + row i of M q̈, q̈ = −k_r q̇ + k_p (q₀ − q): joints leave a singular posture.

    Args:
        lo, hi: first joint of the arm, and the one behind its last. i: joint. start: N m (N).
    """
    model = t.model
    for j in range(lo, hi):
        back = model.posture_stiffness * (model.joints[j].posture - t.input.q[j])
        back = back - model.retreat_damping * t.input.v[j]
        start += t.work.joints[i].M[j - lo] * back
    return start


@inner
def reduce_motion(t, r):
    """The motion command with the arms' lost directions left to their posture task.

    What an arm's joints must do along a lost direction u is (uᵀ(a − γ))/χ: it grows without bound
    while it does ever less. Share φ of it is kept; the rest is replaced by the posture's own
    acceleration there, with the least change Δ of the command in Λ_o that the contacts permit:

        min ΔᵀΔ + Σ (1 − φ)/φ (uᵀΔ − t)²/|u|²,   NΔ = 0,   t = χ vᵀKᵀq̈_posture − uᵀ(a − γ)

    Args:
        r: columns of N.
    """
    work = t.work
    m = work.locked
    H = work.A
    L = work.B
    step = work.y
    row = work.w
    fill(step, ZERO)
    H[:] = 0.0
    for i in range(6):
        H[i, i] = 1.0
    a = turned_back(work, work.x)
    for k in range(t.model.n_arms):
        own = work.arms[k]
        lo = t.model.arms[k].first
        hi = t.model.arms[k].end
        for e in range(own.n_lost):
            target = 0.0
            for i in range(lo, hi):
                target += own.mode[e, i - lo] * retreat(t, lo, hi, i, 0.0)
            target *= own.chi[e]
            for i in range(6):
                target -= own.lost[e, i] * (a[i] - own.gamma[i])
            fill(row, turned(work, own.lost[e]))
            for i in range(m):
                row[i] = 0.0
            size = dot(row, row, 6)
            if own.gone[e] != 0.0 or size < _GONE:  # no motion of the chain's any more
                continue
            weight = (1.0 - own.share[e]) / (max(own.share[e], _HARD) * size)
            accumulate(step, weight * target, row)
            for i in range(6):
                accumulate(H[i], weight * row[i], row)
    # in coordinates K⁻ᵀ… where H is the identity: y = K⁻¹ step, N K⁻ᵀ
    d = 6 - m
    cholesky(H, m, d, L)
    forward(L, d, step, m)
    for b in range(r):
        fill(work.D[b], work.N_t[b])
        forward(L, d, work.D[b], m)
        work.s[b] = 0.0
    orthonormalise(work.D, r, m, work.E, work.A)
    project_onto_constraint(work.E, r, step, work.s)
    backward(L, d, step, m)
    fill(work.x, plus(work.x, step))


# --- Λ, μ, p, J, J̄, Φ and h of one arm at its tip in world axes, without a tick around them -------


@entry
def operational_space(raw, q, v, out):
    """Fill out (rows, size); returns how many rows were done before one that cannot be.

    A row holds Λ, Φ, J, J̄, μ, p, J̇v, h and the rank one after the other, matrices by rows.

    Args:
        raw: bytes of `records.Rows` with one arm alone. q, v: (rows · n,). out: (rows, size).
    """
    t = row_of(raw, 0, 0)
    n = t.model.n_joints
    if len(q) != n * len(out) or len(v) != len(q):
        return 0
    for row in range(len(out)):
        first = row * n
        s = finiteness(q[first:], n) + finiteness(v[first:], n)
        if not isfinite(s) or not _arm_at_tip(t, n, q[first:], v[first:], out[row]):
            return row
    return len(out)


@inner
def _arm_at_tip(t, n, q, v, out):
    """One row; False: M is not definite.

    Ranks are judged in energy coordinates, as everywhere: those of the object, or of what stands
    for it, here with its principal axes along the world's.
    """
    model = t.model
    work = t.work
    joints = work.joints
    arm = model.arms[0]
    own = work.arms[0]
    drift = own.drift
    root = work.z
    mu = ZERO
    p = ZERO
    place_arm(t, 0, n, q)
    fill3(work.C, place_point(joints[arm.tip_joint], arm.tip[9:]))
    move_arm(t, arm, v, work.C, own.V, drift, own.bias)
    fill3(drift, plus3(drift, cross(own.V[3:], own.V)))  # the rate of J q̇, no spatial acceleration
    for i in range(3):
        root[i] = model.roots[0]
        root[3 + i] = model.roots[1 + i]
    for j in range(n):
        for i in range(6):
            joints[j].J[i] = root[i] * joints[j].column[i]
    if arm_terms(t, 0, n, 6, own, 0) < 0:
        return False
    weigh_joints(0, n, joints, work.K, work.Z)
    work.A[:] = 0.0
    for j in range(n):
        bar = joints[j].J_bar
        Z = work.Z[j]
        for a in range(6):
            bar[a] *= root[a]
            accumulate(work.A[a], Z[a], Z)
        g = weight_on_joint(joints[j], model.gravity)
        p = add(p, g, bar)
        mu = add(mu, joints[j].h - g, bar)
    at = 12 * n + 72  # behind all matrices
    for a in range(6):
        row = own.Lambda[a]
        for b in range(6):
            row[b] *= root[a] * root[b]
            out[6 * a + b] = row[b]
            out[36 + 6 * a + b] = work.A[a, b] / (root[a] * root[b])
        for j in range(n):
            out[72 + a * n + j] = joints[j].column[a]
            out[72 + 6 * (n + j) + a] = joints[j].J_bar[a]
        out[at + a] = mu[a] - dot6(row, drift)
        out[at + 6 + a] = p[a]
        out[at + 12 + a] = drift[a]
    for j in range(n):
        out[at + 18 + j] = joints[j].h
    out[at + 18 + n] = own.n_kept
    return True
