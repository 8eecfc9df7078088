"""The operational-space terms of one arm, and motions lost near a singular posture."""

from __future__ import annotations

from math import isfinite, sqrt

from osc_contact.law.algebra import (
    add_scaled,
    backward,
    cholesky,
    dot,
    form_q,
    forward_rows,
    one_sided_jacobi,
    orthonormalise,
    qr_rows,
)
from osc_contact.law.arm_motion import move_arm, place_arm, place_point, weight_on_joint
from osc_contact.law.jit import entry, inner, leaf
from osc_contact.law.records import row_of
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    add_square,
    combined,
    cross,
    dot6,
    fill,
    fill3,
    finiteness,
    plus3,
    reflector,
    scaled,
    set_identity,
    six,
)

# --- J̄ and Λ of one arm in energy coordinates, what it locks, its effort -------------------------

_DEFINITE = 1e-12  #: least share of a pivot of an effort metric


@inner
def arm_terms(t, lo, n, m, arm, row):
    """J̄, Λ and the locked wrenches of one arm; returns their number, or −1 if M is not definite.

    With M = KKᵀ and N J K⁻ᵀ = U Σ Vᵀ arm and object together have the inertia 1 + 1/σ²: directions
    with σ²(1 + σ_max²) ≤ tolerance² σ_max² count as locked, whatever the object weighs. The QR
    below decides where 1/λ_max(Λ), the least σ² of all, is above that beyond doubt.

    Args:
        lo, n: its first joint, its number of joints. m: wrenches that its grasp passes on.
        arm: ARM_WORK row; Lambda, kept, n_kept, n_locked filled. row: of `locked_rows`, from which
            on the wrenches that it locks are put.
    """
    if m == 6:  # all wrenches: the axes themselves are orthonormal
        set_identity(arm.passed)
        if _decompose(t, lo, n, arm, row):
            trace = 0.0
            for i in range(6):
                trace += arm.Lambda[i, i]
            if trace * t.model.rank_tolerance * t.model.rank_tolerance < 1.0:
                return arm.n_locked
    return arm.n_locked if _separate(t, lo, n, m, arm, row) else -1


@leaf
def _weigh_inverse(work, lo, n, Lambda):
    """From the rows of A⁺ in J̄: Λ = A⁺ᵀA⁺, J̄ = K⁻ᵀA⁺."""
    joints = work.joints
    K = work.K
    Lambda[:] = 0.0
    for j in range(n - 1, -1, -1):
        bar = joints[lo + j].J_bar
        x = six(bar)
        add_square(1.0, x, Lambda)
        for k in range(j + 1, n):
            x = add(x, -K[k, j], joints[lo + k].J_bar)
        fill(bar, scaled(K[j, j], x))


@leaf
def weigh_joints(work, lo, n):
    """Z[:n, :6] = K⁻¹Jᵀ, M = KKᵀ with K as from `cholesky`; False: M is not definite.

    Args:
        work: K and Z are filled. lo: first joint of the arm. n: how many.
    """
    K = work.K
    for i in range(n):
        joint = work.joints[lo + i]
        fill(work.Z[i], joint.J)
        for j in range(i + 1):
            K[i, j] = joint.M[j]
    if not cholesky(K, 0, n, K) > 0.0:
        return False
    forward_rows(K, n, work.Z)
    return True


@inner
def _decompose(t, lo, n, arm, row):
    """J̄ and Λ of full rank by QR; False: a column depends on those before it to the last digit.

    Up to six joints J = QR, J̄ᵀ = QR⁻ᵀ and Λ = J̄ᵀMJ̄, whose digits do not depend on M's condition;
    else A = J K⁻ᵀ, Aᵀ = QR and A⁺ = QR⁻ᵀ.
    """
    work = t.work
    joints = work.joints
    A = work.Z
    Q = work.X
    L = work.A  # Rᵀ
    B = work.B  # R⁻ᵀ
    wide = n > 6
    columns = min(n, 6)
    if wide and not weigh_joints(work, lo, n):
        return False
    for i in range(0 if wide else 6):
        fill(A[i], ZERO)
        for j in range(n):
            A[i, j] = joints[lo + j].J[i]
    if not _qr_tall(A, max(n, 6), columns, Q, L, work.t, work.u):
        return False
    arm.n_kept = columns
    arm.n_locked = 6 - columns
    for k in range(6):
        for i in range(6):
            if k >= n:
                work.locked_rows[row + k - n, i] = Q[i, k]
            else:
                arm.kept[k, i] = arm.passed[k, i] if wide else Q[i, k]
    set_identity(B)
    forward_rows(L, columns, B)
    for i in range(max(n, 6)):
        x = combined(Q[i], B, columns)
        if wide:
            fill(joints[lo + i].J_bar, x)
        else:
            fill(work.u, x)
            for j in range(n):
                joints[lo + j].J_bar[i] = work.u[j]
    if wide:
        _weigh_inverse(work, lo, n, arm.Lambda)
        return True
    arm.Lambda[:] = 0.0
    for j in range(n):
        bar = joints[lo + j].J_bar
        x = ZERO
        for k in range(n):
            x = add(x, joints[lo + j].M[k], joints[lo + k].J_bar)
        for i in range(6):
            accumulate(arm.Lambda[i], bar[i], x)
    for i in range(1, 6):  # symmetric but for rounding errors
        for j in range(i):
            arm.Lambda[j, i] = arm.Lambda[i, j]
    return True


@inner
def _qr_tall(A, rows, columns, Q, L, beta, scratch):
    """A = QLᵀ of at least six rows of six, of which `columns` count, by Householder reflections.

    A is destroyed; Q gets six columns; L, lower triangular, carries the inverse of its diagonal
    there, as in `cholesky`. Returns False where a column depends on those before it to
    the last digit.
    """
    for k in range(columns):
        t = scaled(A[k, k], A[k])
        for i in range(k + 1, rows):
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
        for i in range(k, rows):
            accumulate(A[i], -A[i, k], t)
        for c in range(k + 1, columns):
            L[c, k] = A[k, c]
        L[k, k] = 1.0 / alpha
    for i in range(rows):
        fill(Q[i], ZERO)
        if i < 6:
            Q[i, i] = 1.0
    for k in range(columns - 1, -1, -1):
        t = ZERO
        for i in range(k, rows):
            t = add(t, A[i, k], Q[i])
        t = scaled(beta[k], t)
        for i in range(k, rows):
            accumulate(Q[i], -A[i, k], t)
    return True


@inner
def _separate(t, lo, n, m, arm, row):
    """The same of any rank and for any grasp, by singular values: A = N J K⁻ᵀ = UΣVᵀ."""
    work = t.work
    joints = work.joints
    X = work.X
    if not weigh_joints(work, lo, n):
        return False
    _multiply_rows(arm.passed, m, work, n)
    one_sided_jacobi(X, m, n, 6)
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
                accumulate(joints[lo + j].J_bar, X[k, j] / square, u)
            fill(arm.kept[arm.n_kept], u)
            arm.n_kept += 1
        else:
            fill(work.locked_rows[row + arm.n_locked], u)
            arm.n_locked += 1
    _weigh_inverse(work, lo, n, arm.Lambda)
    return True


@inner
def _multiply_rows(rows, count, work, n):
    """X[:count] ← the products of rows of six with Z[:n], and behind them these rows themselves.

    Args:
        rows: (≥ count, 6). count: how many. work: its Z holds n rows of six; X is filled.
    """
    for a in range(count):
        for j in range(n):
            work.X[a, j] = dot6(rows[a], work.Z[j])
        fill(work.X[a, n:], rows[a])


@inner
def null_motions(work, own, n):
    """Orthonormal rows n_kept … n − 1 of Z: joint motions v with U Zᵀv = 0, U what the arm resists.

    Args:
        work: its Z holds n rows of six, J or K⁻¹Jᵀ. own: ARM_WORK row. n: joints of the arm.
    """
    _multiply_rows(own.kept, own.n_kept, work, n)
    qr_rows(work.X, own.n_kept, n, work.s, work.t)
    form_q(work.X, own.n_kept, n, work.t, n, work.Z)


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
    count = arm.n_kept
    A = t.work.A
    B = t.work.B
    x = t.work.u
    out[:] = 0.0
    if n <= m:
        for j in range(lo, lo + n):
            add_square(table[j].effort, joints[j].J_bar, out)
        return True
    A[:] = 0.0
    fill(x, ZERO)
    for j in range(lo, lo + n):
        for a in range(count):
            x[a] = dot6(arm.kept[a], joints[j].J)
        add_square(table[j].ease, x, A)
    if count > 0 and not cholesky(A, 0, count, B) > _DEFINITE:
        return False
    for a in range(count):
        fill(A[a], arm.kept[a])
    forward_rows(B, count, A)
    for a in range(count):
        add_square(1.0, A[a], out)
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
    if not weigh_joints(work, arm.first, n):
        return
    for i in range(6):
        root[i] = sqrt(t.model.reference[i])
        for a in range(m):
            work.A[a, i] = own.passed[a, i] / root[i]
        for j in range(n):
            Z[j, i] *= root[i]
    orthonormalise(work.A, m, 0, work.A, work.B)  # wrenches that the grasp passes on, in Λ_ref
    _multiply_rows(work.A, m, work, n)
    one_sided_jacobi(X, m, n, 6)
    _sort_rows(X, m, n)
    for k in range(arm.full_rank):
        chi = sqrt(dot(X[k], X[k], n))
        _unit_row(X, k, n, chi)
        if chi >= FULL:
            continue
        at = own.n_lost
        own.chi[at] = chi
        s = max((chi - NONE_LEFT) / (FULL - NONE_LEFT), 0.0)
        own.share[at] = s * s * (3.0 - 2.0 * s)  # 0 at χ ≤ NONE_LEFT, 1 at FULL
        own.gone[at] = k >= own.n_kept
        for i in range(6):
            own.lost[at, i] = root[i] * X[k, n + i]
        for j in range(n):
            own.mode[at, j] = X[k, j]
        backward(work.K, n, own.mode[at])
        own.n_lost += 1
        work.n_lost += 1


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
    norm = chi
    if not chi > _SMALL:
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
def retreat(t, arm, i, damping):
    """Row i of M q̈, q̈ = −k_d q̇ + k_p (q₀ − q): joints follow their posture law (N m, N).

    Args:
        arm: ARM row. i: joint. damping: k_d (1/s).
    """
    model = t.model
    s = 0.0
    for j in range(arm.first, arm.end):
        back = model.posture_stiffness * (model.joints[j].posture - t.input.q[j])
        back = back - damping * t.input.v[j]
        s += t.work.joints[i].M[j - arm.first] * back
    return s


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
    place_arm(t, arm, q)
    fill3(work.p_C, place_point(joints[arm.tip_joint], arm.tip[9:]))
    move_arm(t, arm, v, work.p_C, own.V, drift, own.bias)
    fill3(drift, plus3(drift, cross(own.V[3:], own.V)))  # the rate of J q̇, no spatial acceleration
    for i in range(6):
        root[i] = model.roots[max(i - 2, 0)]
    for j in range(n):
        for i in range(6):
            joints[j].J[i] = root[i] * joints[j].column[i]
    if arm_terms(t, 0, n, 6, own, 0) < 0:
        return False
    weigh_joints(work, 0, n)
    work.A[:] = 0.0
    for j in range(n):
        bar = joints[j].J_bar
        add_square(1.0, work.Z[j], work.A)
        for a in range(6):
            bar[a] *= root[a]
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
