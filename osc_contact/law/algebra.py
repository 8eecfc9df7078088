"""Small dense algebra on arrays that the caller gives. What can fail returns False or 0."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.jit import inner, leaf

__all__ = [
    "back_substitute",
    "cholesky",
    "cholesky_solve",
    "cross",
    "dot6",
    "form_q",
    "invert_spd6",
    "lu_solve",
    "one_sided_jacobi",
    "qr_rows",
    "reflect",
    "reflect_back",
    "reflect_sides",
]

_SINGULAR = 1e-10


@leaf
def cross(ax, ay, az, bx, by, bz):
    """a × b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@leaf
def dot6(a, b):
    """aᵀb of 6-vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]


@inner
def cholesky(A, first, n, L):
    """Lower factor L (n, n) of the block of A that begins at `first`; the pivots' least share.

    Returns the smallest pivot relative to its diagonal element, ≤ 0 if A is not positive definite.
    Only the lower triangle of A is read. L carries the inverse pivots on its diagonal.
    """
    least = 1.0
    for i in range(n):
        for j in range(i + 1):
            s = A[first + i, first + j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                whole = A[first + i, first + i]
                if not s > 0.0:
                    return 0.0
                least = min(least, s / whole)
                L[i, i] = 1.0 / sqrt(s)
            else:
                L[i, j] = s * L[j, j]
    return least


@inner
def cholesky_solve(L, n, x, first):
    """Overwrite x[first : first + n] with (LLᵀ)⁻¹x, L from `cholesky`."""
    for i in range(n):
        s = x[first + i]
        for k in range(i):
            s -= L[i, k] * x[first + k]
        x[first + i] = s * L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[first + i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[first + k]
        x[first + i] = s * L[i, i]


@inner
def invert_spd6(A, L, out):
    """out = A⁻¹ (6, 6), through its Cholesky factor; the pivots' least share as in `cholesky`."""
    least = cholesky(A, 0, 6, L)
    if not least > 0.0:
        return 0.0
    # rows of L⁻¹, below L's diagonal's inverse pivots
    for j in range(6):
        out[j, j] = L[j, j]
        for i in range(j + 1, 6):
            s = 0.0
            for k in range(j, i):
                s -= L[i, k] * out[k, j]
            out[i, j] = s * L[i, i]
    for i in range(6):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, 6):
                s += out[k, i] * out[k, j]
            L[j, i] = s  # upper triangle as scratch; (i, i) is read no more
    for i in range(6):
        for j in range(i + 1):
            out[i, j] = L[j, i]
            out[j, i] = L[j, i]
    return least


@inner
def lu_solve(A, n, B, columns):
    """Overwrite the rows B[:columns, :n] with A⁻¹B by elimination with pivoting; A is destroyed.

    Returns False where a pivot shrinks to _SINGULAR of the largest.
    """
    largest = 0.0
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[p, k]):
                p = i
        largest = max(largest, abs(A[p, k]))
        if not abs(A[p, k]) > _SINGULAR * largest:
            return False
        if p != k:
            for j in range(n):
                A[k, j], A[p, j] = A[p, j], A[k, j]
            for c in range(columns):
                B[c, k], B[c, p] = B[c, p], B[c, k]
        inverse = 1.0 / A[k, k]
        for i in range(k + 1, n):
            f = A[i, k] * inverse
            if f != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= f * A[k, j]
                for c in range(columns):
                    B[c, i] -= f * B[c, k]
    for c in range(columns):
        for i in range(n - 1, -1, -1):
            s = B[c, i]
            for j in range(i + 1, n):
                s -= A[i, j] * B[c, j]
            B[c, i] = s / A[i, i]
    return True


@inner
def qr_rows(X, rows, length, diagonal, beta):
    """Householder QR of the (length, rows) matrix whose *columns* are X[:rows, :length].

    Column k's reflector 1 − β v vᵀ is left in X[k, k:], R in X[j, k] (k < j) and `diagonal`.
    """
    for k in range(rows):
        s = 0.0
        for i in range(k, length):
            s += X[k, i] * X[k, i]
        norm = sqrt(s)
        if not norm > 0.0:
            return False
        head = X[k, k]
        alpha = -norm if head >= 0.0 else norm
        b = 1.0 / (norm * (norm + abs(head)))
        X[k, k] = head - alpha
        diagonal[k] = alpha
        beta[k] = b
        for j in range(k + 1, rows):
            t = 0.0
            for i in range(k, length):
                t += X[k, i] * X[j, i]
            t *= b
            for i in range(k, length):
                X[j, i] -= t * X[k, i]
    return True


@inner
def form_q(X, rows, length, beta, count, Q):
    """The first `count` columns of Q, as rows Q[:count, :length]."""
    for c in range(count):
        for i in range(length):
            Q[c, i] = 0.0
        Q[c, c] = 1.0
        for k in range(min(c, rows - 1), -1, -1):
            t = 0.0
            for i in range(k, length):
                t += X[k, i] * Q[c, i]
            t *= beta[k]
            for i in range(k, length):
                Q[c, i] -= t * X[k, i]


@inner
def back_substitute(X, rows, length, diagonal, Z):
    """Overwrite the rows Z[:rows, :length] with R⁻¹Z, R from `qr_rows`."""
    for k in range(rows - 1, -1, -1):
        inverse = 1.0 / diagonal[k]
        for i in range(length):
            s = Z[k, i]
            for j in range(k + 1, rows):
                s -= X[j, k] * Z[j, i]
            Z[k, i] = s * inverse


@leaf
def reflect(V, beta, m, x):
    """x ← H_m … H_1 x (6,) with the reflectors in the rows of V."""
    for k in range(m):
        t = 0.0
        for i in range(k, 6):
            t += V[k, i] * x[i]
        t *= beta[k]
        for i in range(k, 6):
            x[i] -= t * V[k, i]


@leaf
def reflect_back(V, beta, m, x):
    """x ← H_1 … H_m x, the inverse of `reflect`."""
    for k in range(m - 1, -1, -1):
        t = 0.0
        for i in range(k, 6):
            t += V[k, i] * x[i]
        t *= beta[k]
        for i in range(k, 6):
            x[i] -= t * V[k, i]


@inner
def reflect_sides(V, beta, m, A):
    """Symmetric A (6, 6) ← H A Hᵀ with H = H_m … H_1; both triangles are kept."""
    for k in range(m):
        for i in range(6):
            t = 0.0
            for j in range(k, 6):
                t += A[i, j] * V[k, j]
            t *= beta[k]
            for j in range(k, 6):
                A[i, j] -= t * V[k, j]
        for j in range(6):
            t = 0.0
            for i in range(k, 6):
                t += A[i, j] * V[k, i]
            t *= beta[k]
            for i in range(k, 6):
                A[i, j] -= t * V[k, i]


@inner
def one_sided_jacobi(X, count, length, carried):
    """Rotate the rows X[:count, :length] until they are orthogonal; their norms are the singular
    values. The next `carried` elements of each row are rotated along."""
    for _ in range(30):
        turned = False
        for p in range(count - 1):
            for q in range(p + 1, count):
                a = b = c = 0.0
                for i in range(length):
                    a += X[p, i] * X[p, i]
                    b += X[q, i] * X[q, i]
                    c += X[p, i] * X[q, i]
                if abs(c) <= 2e-16 * max(a, b):
                    continue
                turned = True
                zeta = (b - a) / (2.0 * c)
                t = 1.0 / (abs(zeta) + sqrt(1.0 + zeta * zeta))
                if zeta < 0.0:
                    t = -t
                cosine = 1.0 / sqrt(1.0 + t * t)
                sine = cosine * t
                for i in range(length + carried):
                    x, y = X[p, i], X[q, i]
                    X[p, i] = cosine * x - sine * y
                    X[q, i] = sine * x + cosine * y
        if not turned:
            return


@inner
def orthonormalise(X, r, m, Q, L):
    """X = L Q over the elements m … 5 of rows: Q (r, 6) orthonormal, L (r, r) lower triangular.

    Modified Gram–Schmidt, twice. Returns the least |L_aa| beside its row's length; 0: a zero row.
    """
    least = 1.0
    for a in range(r):
        whole = 0.0
        for i in range(m, 6):
            Q[a, i] = X[a, i]
            whole += X[a, i] * X[a, i]
        for b in range(a):
            L[a, b] = 0.0
        for _ in range(2):
            for b in range(a):
                s = 0.0
                for i in range(m, 6):
                    s += Q[a, i] * Q[b, i]
                L[a, b] += s
                for i in range(m, 6):
                    Q[a, i] -= s * Q[b, i]
        square = 0.0
        for i in range(m, 6):
            square += Q[a, i] * Q[a, i]
        if not square > 0.0:
            return 0.0
        norm = sqrt(square)
        L[a, a] = norm
        for i in range(m, 6):
            Q[a, i] /= norm
        least = min(least, norm / sqrt(whole))
    return least


@inner
def solve_lower(L, r, x):
    """x ← L⁻¹x, L (r, r) lower triangular."""
    for a in range(r):
        s = x[a]
        for b in range(a):
            s -= L[a, b] * x[b]
        x[a] = s / L[a, a]


@inner
def solve_lower_transposed(L, r, x):
    """x ← L⁻ᵀx."""
    for a in range(r - 1, -1, -1):
        s = x[a]
        for b in range(a + 1, r):
            s -= L[b, a] * x[b]
        x[a] = s / L[a, a]


@inner
def meet(Q, r, m, x, wanted):
    """x ← the nearest x with Q x = wanted in the elements m … 5, the rows of Q orthonormal."""
    for _ in range(2):
        for a in range(r):
            s = wanted[a]
            for i in range(m, 6):
                s -= Q[a, i] * x[i]
            for i in range(m, 6):
                x[i] += s * Q[a, i]
