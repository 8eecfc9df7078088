"""The operational-space terms of one arm in white coordinates: J̄, Λ, and what it locks."""

from __future__ import annotations

from math import sqrt

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.linalg import (
    back_substitute,
    cholesky,
    dot6,
    form_q,
    one_sided_jacobi,
    qr_rows,
)

__all__ = ["arm_terms", "passed_terms"]


@compiled
def arm_terms(lo, n, M, J, tolerance, bar, Lambda, locked, row, K, X, Z, diagonal, beta):
    """J̄, Λ and the locked wrenches of one arm; returns their number, or −1 if M is not definite.

    Args:
        lo, n: its first joint, its number of joints. M: (n_all, n_all).
        J: (n_all, 6) Jacobian columns, white. tolerance: see `ClosedChain`.
        bar: (n_all, 6) J̄, filled. Lambda: (6, 6), filled.
        locked: (…, 7) orthonormal wrenches that the arm resists, from row `row` on.
        K, X, Z: (10, 10) scratch; diagonal, beta: (10,) scratch.
    """
    if n > 6:
        if not _wide(lo, n, M, J, bar, Lambda, K, X, Z, diagonal, beta):
            return -1
        count = 0
    else:
        for j in range(n):
            for i in range(6):
                X[j, i] = J[lo + j, i]
        count = -1
        if qr_rows(X, n, 6, diagonal, beta):
            form_q(X, n, 6, beta, 6, Z)
            back_substitute(X, n, 6, diagonal, Z)
            for j in range(n):
                for i in range(6):
                    bar[lo + j, i] = Z[j, i]
            for k in range(6 - n):
                for i in range(6):
                    locked[row + k, i] = Z[n + k, i]
            count = 6 - n
            _inertia(lo, n, M, bar, X, Lambda)
    if count >= 0:
        # 1/λ_max(Λ) is the smallest squared singular value that decides on the rank
        trace = 0.0
        for i in range(6):
            trace += Lambda[i, i]
        if trace * tolerance * tolerance < 1.0:
            return count
    return _by_singular_values(lo, n, M, J, tolerance, bar, Lambda, locked, row, K, X, Z)


@compiled
def _inertia(lo, n, M, bar, X, Lambda):
    """Λ = J̄ᵀ M J̄."""
    for j in range(n):
        for i in range(6):
            s = 0.0
            for k in range(n):
                s += M[lo + j, lo + k] * bar[lo + k, i]
            X[j, i] = s
    for a in range(6):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += bar[lo + j, a] * X[j, b]
            Lambda[a, b] = s
            Lambda[b, a] = s


@compiled
def _whiten_joints(lo, n, M, J, K, Z):
    """Z[:n, :6] = K⁻¹Jᵀ with M = KKᵀ; K with inverse pivots, as from `cholesky`."""
    if not cholesky(M, lo, n, K) > 0.0:
        return False
    for j in range(n):
        for i in range(6):
            s = J[lo + j, i]
            for k in range(j):
                s -= K[j, k] * Z[k, i]
            Z[j, i] = s * K[j, j]
    return True


@compiled
def _unwhiten(lo, n, K, bar):
    """bar ← K⁻ᵀ bar."""
    for j in range(n - 1, -1, -1):
        for i in range(6):
            s = bar[lo + j, i]
            for k in range(j + 1, n):
                s -= K[k, j] * bar[lo + k, i]
            bar[lo + j, i] = s * K[j, j]


@compiled
def _wide(lo, n, M, J, bar, Lambda, K, X, Z, diagonal, beta):
    """More joints than directions: A = J K⁻ᵀ, J̄ = K⁻ᵀA⁺, Λ = A⁺ᵀA⁺."""
    if not _whiten_joints(lo, n, M, J, K, Z):
        return False
    for i in range(6):
        for j in range(n):
            X[i, j] = Z[j, i]
    if not qr_rows(X, 6, n, diagonal, beta):
        for i in range(6):
            Lambda[i, i] = 1e300
        return True
    form_q(X, 6, n, beta, 6, Z)
    back_substitute(X, 6, n, diagonal, Z)
    for a in range(6):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += Z[a, j] * Z[b, j]
            Lambda[a, b] = s
            Lambda[b, a] = s
    for j in range(n):
        for i in range(6):
            bar[lo + j, i] = Z[i, j]
    _unwhiten(lo, n, K, bar)
    return True


@compiled
def _by_singular_values(lo, n, M, J, tolerance, bar, Lambda, locked, row, K, X, Z):
    """The same for an arm of any rank: directions with singular value ≤ tolerance are locked."""
    if not _whiten_joints(lo, n, M, J, K, Z):
        return -1
    for i in range(6):
        for j in range(n):
            X[i, j] = Z[j, i]
        for k in range(6):
            X[i, n + k] = 1.0 if i == k else 0.0
    return _from_rows(lo, n, 6, tolerance, bar, Lambda, locked, row, K, X)


@compiled
def passed_terms(lo, n, M, J, N, m, tolerance, bar, Lambda, locked, row, K, X, Z):
    """`arm_terms` of an arm whose grasp passes on the wrenches N, orthonormal rows (m, 6)."""
    if not _whiten_joints(lo, n, M, J, K, Z):
        return -1
    for i in range(m):
        for j in range(n):
            X[i, j] = dot6(N[i], Z[j])
        for k in range(6):
            X[i, n + k] = N[i, k]
    return _from_rows(lo, n, m, tolerance, bar, Lambda, locked, row, K, X)


@compiled
def _from_rows(lo, n, rows, tolerance, bar, Lambda, locked, row, K, X):
    """From X = [A, basis] of so many rows: A = UΣVᵀ, what is locked, J̄ = K⁻ᵀA⁺, Λ = A⁺ᵀA⁺."""
    one_sided_jacobi(X, rows, n, 6)
    for a in range(6):
        for b in range(6):
            Lambda[a, b] = 0.0
        for j in range(n):
            bar[lo + j, a] = 0.0
    count = 0
    for k in range(rows):
        square = 0.0
        for j in range(n):
            square += X[k, j] * X[k, j]
        if sqrt(square) > tolerance:
            for j in range(n):
                for i in range(6):
                    bar[lo + j, i] += X[k, j] * X[k, n + i] / square
            for a in range(6):
                for b in range(6):
                    Lambda[a, b] += X[k, n + a] * X[k, n + b] / square
        else:
            for i in range(6):
                locked[row + count, i] = X[k, n + i]
            count += 1
    _unwhiten(lo, n, K, bar)
    return count


@compiled
def locked_rates(locked, row, count, gamma):
    """The rates c = uᵀγ (white) that the locked wrenches u prescribe, behind each of them."""
    for k in range(row, row + count):
        locked[k, 6] = dot6(locked[k], gamma)
