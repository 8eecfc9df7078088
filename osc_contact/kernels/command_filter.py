"""Eqs. 21 and 24 in white coordinates turned so that the first m axes are locked.

Coordinates η are elements m … 5 of a 6-vector; SᵀΛ_oS is the identity there. Columns of N are rows.
"""

from __future__ import annotations

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.linalg import cholesky, cholesky_solve

__all__ = ["filter_motion", "permitted", "reachable"]

_EULER = 2.719


@compiled
def products(A, B, r, m, out):
    """out (r, r) = A Bᵀ over the elements m … 5 of the rows of A and B."""
    for a in range(r):
        for b in range(a + 1):
            s = 0.0
            for i in range(m, 6):
                s += A[a, i] * B[b, i]
            out[a, b] = s
            out[b, a] = s


@compiled
def reachable(N, r, m, Lambda, held, own, gram, L, K, Y):
    """Whether the arms can push on every column without doubt (`response.require_reachable`).

    The smallest eigenvalue of a matrix with unit diagonal is at least its determinant / e. If Λ_S
    is between 1 and its trace, so is its inverse, and NᵀΦ₀N between NᵀN / trace and NᵀN.

    Args:
        N: (r, 6) white, turned. Lambda: (6, 6) ΣΛ_i, turned. held: 1 if an object is held, else 0.
        own: (r,) squared size of each column. gram: (6, 6) filled with N_SᵀN_S. L: its factor.
        K, Y: scratch.
    """
    products(N, N, r, m, gram)
    if not cholesky(gram, 0, r, L) > 0.0:
        return False
    trace = 0.0
    for i in range(m, 6):
        trace += Lambda[i, i] + held
    determinant, reach = 1.0, 1.0
    for a in range(r):
        determinant *= 1.0 / (L[a, a] * L[a, a] * gram[a, a])
        reach = min(reach, gram[a, a] / own[a])
    if held > 0.0 and determinant > 1e-9 * trace and reach > 1e-8 * trace:
        return True
    # the same on NᵀΦ₀N itself
    for i in range(m, 6):
        for j in range(m, 6):
            Y[i, j] = Lambda[i, j] + (held if i == j else 0.0)
    if not cholesky(Y, m, 6 - m, K) > 0.0:
        return False
    for a in range(r):
        for i in range(6 - m):
            s = N[a, m + i]
            for k in range(i):
                s -= K[i, k] * Y[a, k]
            Y[a, i] = s * K[i, i]
    determinant = 1.0
    D = K  # the factor is used up
    for a in range(r):
        for b in range(a + 1):
            s = 0.0
            for i in range(6 - m):
                s += Y[a, i] * Y[b, i]
            D[a, b] = s
    for a in range(r):
        if not D[a, a] > 1.1e-9 * own[a]:
            return False
        Y[a, a] = D[a, a]
    if not cholesky(D, 0, r, D) > 0.0:
        return False
    for a in range(r):
        determinant *= 1.0 / (D[a, a] * D[a, a] * Y[a, a])
    return determinant > 1.1e-10 * _EULER


@compiled
def _right_side(N, x, rho, r, m, out):
    for a in range(r):
        s = -rho[a]
        for i in range(m, 6):
            s += N[a, i] * x[i]
        out[a] = s


@compiled
def _take(x, weight, columns, r, m):
    """x −= columns weight, in the elements m … 5."""
    for a in range(r):
        for i in range(m, 6):
            x[i] -= weight[a] * columns[a, i]


@compiled
def filter_motion(N, r, m, L, x, rho, by_object, B_inv, B_N, K, gram, weight):
    """x ← η̇_c in its elements m … 5, from x = ã_u − σ̃ (6,), white and turned: eq. 24.

    Args:
        N: (r, 6). L: (r, r) factor of N_SᵀN_S. rho: (r,).
        by_object: B is the object's inverse inertia, the identity here; otherwise
        B_inv: (6, 6) B⁻¹, turned. B_N, K, gram, weight: scratch.
    """
    if r == 0:
        return True
    if by_object:
        _right_side(N, x, rho, r, m, weight)
        cholesky_solve(L, r, weight, 0)
        _take(x, weight, N, r, m)
        return True
    if m > 0:  # what the contact sees of a motion outside the chain's is not rounded away
        for a in range(r):
            s = 0.0
            for i in range(m):
                s -= N[a, i] * x[i]
            weight[a] = s
        cholesky_solve(L, r, weight, 0)
        _take(x, weight, N, r, m)
    d = 6 - m
    if not cholesky(B_inv, m, d, K) > 0.0:
        return False
    for a in range(r):
        for i in range(6):
            B_N[a, i] = N[a, i]
        cholesky_solve(K, d, B_N[a], m)
    products(N, B_N, r, m, gram)
    if not cholesky(gram, 0, r, K) > 0.0:
        return False
    _right_side(N, x, rho, r, m, weight)
    cholesky_solve(K, r, weight, 0)
    _take(x, weight, B_N, r, m)
    return True


@compiled
def permitted(N, r, e, by_object, B_inv, B_N, K, gram, L, weight):
    """e ← Ω_m(B) e (6,), eq. 4, white: with all six axes, locked or not."""
    if r == 0:
        return True
    if by_object:
        for a in range(r):
            for i in range(6):
                B_N[a, i] = N[a, i]
    else:
        if not cholesky(B_inv, 0, 6, K) > 0.0:
            return False
        for a in range(r):
            for i in range(6):
                B_N[a, i] = N[a, i]
            cholesky_solve(K, 6, B_N[a], 0)
    products(N, B_N, r, 0, gram)
    if not cholesky(gram, 0, r, L) > 0.0:
        return False
    for a in range(r):
        s = 0.0
        for i in range(6):
            s += N[a, i] * e[i]
        weight[a] = s
    cholesky_solve(L, r, weight, 0)
    _take(e, weight, B_N, r, 0)
    return True
