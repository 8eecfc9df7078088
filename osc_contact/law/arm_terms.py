"""The operational-space terms of one arm in energy coordinates: J̄, Λ, what it locks, its effort."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, invert_spd6, one_sided_jacobi
from osc_contact.law.jit import inner, leaf
from osc_contact.law.six import ZERO, add, dot6, fill, form_q6, mirror, qr6, reflector, scaled, six

_DEFINITE = 1e-12  #: least share of a pivot of an effort metric


@inner
def arm_terms(t, lo, n, m, rigid, arm, row):
    """J̄, Λ and the locked wrenches of one arm; returns their number, or −1 if M is not definite.

    With M = KKᵀ and J K⁻ᵀ = U Σ Vᵀ directions with σ ≤ tolerance count as locked; the QR below
    decides where 1/λ_max(Λ), the least σ² of all, is above it beyond doubt.

    Args:
        lo, n: its first joint, its number of joints. m: wrenches that its grasp passes on.
        rigid: whether these are all six. arm: ARM_WORK row; Lambda, kept, n_kept, n_locked filled.
        row: of `locked_rows`, from which on the wrenches that it locks are put.
    """
    tolerance = t.model.tolerance
    joints = t.work.joints
    work = t.work
    X = work.X
    Z = work.Z
    Lambda = arm.Lambda
    count = -1
    if rigid and n > 6:
        if _invert_wide(t, lo, n, Lambda):
            count = 0
    elif rigid:
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
                fill(t.work.locked_rows[row + k], Z[n + k])
            count = 6 - n
            _apply_inertia(lo, n, joints, X, Lambda)
    if count >= 0:
        trace = 0.0
        for i in range(6):
            trace += Lambda[i, i]
        if trace * tolerance * tolerance < 1.0:
            arm.n_locked = count
            arm.n_kept = 6 - count
            return count
    count = _separate(t, lo, n, m, rigid, arm, row)
    arm.n_locked = count
    return count


@leaf
def _apply_inertia(lo, n, joints, X, Lambda):
    """Λ = J̄ᵀ M J̄."""
    for j in range(n):
        M = joints[lo + j].M
        x = scaled(M[0], joints[lo].J_bar)
        for k in range(1, n):
            x = add(x, M[k], joints[lo + k].J_bar)
        fill(X[j], x)
    for a in range(6):
        x = scaled(joints[lo].J_bar[a], X[0])
        for j in range(1, n):
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
def _weigh_joints(lo, n, joints, K, Z):
    """Z[:n, :6] = K⁻¹Jᵀ."""
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
    if not _weigh_joints(lo, n, joints, K, Z):
        return False
    if not _qr_tall(Z, n, X, work.A, work.t, work.u):  # Aᵀ = QR
        return False
    T = work.A  # R, then R⁻ᵀ: A⁺ = Q R⁻ᵀ
    for d in range(6):
        x = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for c in range(d):
            x = add(x, -T[c, d], work.B[c])
        fill(work.B[d], x)
        work.B[d, d] += 1.0
        fill(work.B[d], scaled(1.0 / T[d, d], work.B[d]))
    for a in range(6):
        x = scaled(work.B[a, a], work.B[a])
        for d in range(a + 1, 6):
            x = add(x, work.B[d, a], work.B[d])
        fill(Lambda[a], x)
    for j in range(n):
        x = scaled(X[j, 0], work.B[0])
        for d in range(1, 6):
            x = add(x, X[j, d], work.B[d])
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
            fill(A[i], add(six(A[i]), -A[i, k], t))
        fill(R[k], six(A[k]))
        R[k, k] = alpha
    for i in range(n):
        fill(Q[i], (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        if i < 6:
            Q[i, i] = 1.0
    for k in range(5, -1, -1):
        t = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for i in range(k, n):
            t = add(t, A[i, k], Q[i])
        t = scaled(beta[k], t)
        for i in range(k, n):
            fill(Q[i], add(six(Q[i]), -A[i, k], t))
    return True


@inner
def _separate(t, lo, n, m, rigid, arm, row):
    """The same for any rank and any grasp, by singular values: A = N J K⁻ᵀ = UΣVᵀ."""
    joints = t.work.joints
    work = t.work
    K = work.K
    X = work.X
    Z = work.Z
    Lambda = arm.Lambda
    kept = arm.kept
    if not _weigh_joints(lo, n, joints, K, Z):
        return -1
    for i in range(m):
        for j in range(n):
            X[i, j] = Z[j, i] if rigid else dot6(arm.passed[i], Z[j])
        for k in range(6):
            X[i, n + k] = arm.passed[i, k] if not rigid else (1.0 if i == k else 0.0)
    one_sided_jacobi(X, m, n, 6)
    for a in range(6):
        fill(Lambda[a], ZERO)
        for j in range(n):
            joints[lo + j].J_bar[a] = 0.0
    count = 0
    left = 0
    for k in range(m):
        square = 0.0
        for j in range(n):
            square += X[k, j] * X[k, j]
        if sqrt(square) > t.model.tolerance:
            for j in range(n):
                bar = joints[lo + j].J_bar
                for i in range(6):
                    bar[i] += X[k, j] * X[k, n + i] / square
            for a in range(6):
                kept[left, a] = X[k, n + a]
                for b in range(6):
                    Lambda[a, b] += X[k, n + a] * X[k, n + b] / square
            left += 1
        else:
            for i in range(6):
                t.work.locked_rows[row + count, i] = X[k, n + i]
            count += 1
    arm.n_kept = left
    solve_inertia_transposed(lo, n, K, joints)
    return count


@leaf
def effort_metric(t, lo, n, m, arm, out):
    """(6, 6) least effort per wrench, Σ τ²/τ_max², of an arm; False: its motors cannot make all.

    J̄ᵀ τ_max² J̄ where every torque is needed; for arms with more joints than m wrenches
    Uᵀ(U J τ_max⁻² JᵀUᵀ)⁻¹U, the rows of U the wrenches that they can make.

    Args:
        arm: ARM row. lo: first joint of the arm. n: how many. m: wrenches that the arm
        can make. out: (6, 6) for the metric.
    """
    joints = t.work.joints
    table = t.model.joints
    work = t.work
    if n <= m:
        for a in range(6):
            x = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            for j in range(lo, lo + n):
                x = add(x, table[j].effort * joints[j].J_bar[a], joints[j].J_bar)
            fill(out[a], x)
        mirror(out)
        return True
    if arm.n_kept == 6:
        for a in range(6):
            x = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            for j in range(lo, lo + n):
                x = add(x, table[j].ease * joints[j].J[a], joints[j].J)
            fill(work.A[a], x)
        return invert_spd6(work.A, work.B, out) > _DEFINITE
    return _effort_of_kept(t, lo, n, arm, out)


@inner
def _effort_of_kept(t, lo, n, arm, out):
    work = t.work
    count = arm.n_kept
    U = arm.kept
    A = work.A
    x = work.u
    for a in range(6):
        fill(A[a], ZERO)
        fill(out[a], ZERO)
    for j in range(lo, lo + n):
        for a in range(count):
            x[a] = dot6(U[a], t.work.joints[j].J)
            for b in range(a + 1):
                A[a, b] += x[a] * x[b] * t.model.joints[j].ease
    if count == 0:
        return True
    if not cholesky(A, 0, count, work.B) > _DEFINITE:
        return False
    for i in range(6):
        for a in range(count):
            x[a] = U[a, i]
        cholesky_solve(work.B, count, x, 0)
        for j in range(6):
            s = 0.0
            for a in range(count):
                s += U[a, j] * x[a]
            out[j, i] = s
    return True
