"""Small dense algebra: verbs for matrices whose sizes are arguments.

Matrices are larger than the part that counts, whose size is given. Vectors of the operational space
are rows of six: X (n, 6) holds n of them. Results go to an array `out` that the caller makes
(`jit.local`), which is no operand unless this is stated. Where an operation can fail it returns
False or 0.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.jit import inner, leaf
from osc_contact.law.vectors import accumulate, add, dot6, fill, reflector, scaled, six

_SINGULAR = 1e-10
_NOTHING = 1e-280  #: below, numbers have fewer digits soon


@inner
def dot(a, b, n):
    """Σ aᵢbᵢ.

    Args:
        a, b: rows. n: how many elements of them count.
    """
    s = 0.0
    for i in range(n):
        s += a[i] * b[i]
    return s


@inner
def add_scaled(s, a, n, out):
    """out ← out + s a.

    Args:
        s: factor. a: row. n: how many elements of it count. out: row, overwritten.
    """
    for i in range(n):
        out[i] += s * a[i]


@leaf
def gram(X, n, Y, m, out):
    """out ← X Yᵀ, the products of each two rows of six.

    Args:
        X: (n, 6). n: rows of X. Y: (m, 6). m: rows of Y. out: (n, m).
    """
    for i in range(n):
        for j in range(m):
            out[i, j] = dot6(X[i], Y[j])


@leaf
def transpose(A, n, m, out):
    """out ← Aᵀ.

    Args:
        A: (n, m). n, m: its size. out: (m, n).
    """
    for i in range(n):
        for j in range(m):
            out[j, i] = A[i, j]


@inner
def cholesky(A, first, n, L):
    """Lower factor L (n, n) of the block of A that begins at `first`; the pivots' least share.

    Returns the smallest pivot relative to its diagonal element, ≤ 0 if A is not positive definite.
    Only the lower triangle of A is read. L carries the inverse pivots on its diagonal.

    Args:
        A: symmetric. first: row and column at which the block begins. n: its size.
        L: (n, n) scratch for the factor.
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


@leaf
def forward_rows(L, n, X):
    """Overwrite the rows X[:n, :6] with L⁻¹X.

    Args:
        L: (n, n) factor. n: its size. X: rows of six, overwritten.
    """
    for i in range(n):
        x = six(X[i])
        for k in range(i):
            x = add(x, -L[i, k], X[k])
        fill(X[i], scaled(L[i, i], x))


@inner
def forward(L, n, x):
    """Overwrite x[:n] with L⁻¹x, L from `cholesky`.

    Args:
        L: (n, n) factor. n: its size. x: right side, then solution.
    """
    for i in range(n):
        s = x[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s * L[i, i]


@leaf
def forward_each(L, n, X, m):
    """Overwrite each of the rows X[:m, :n] with L⁻¹ times it: X ← X L⁻ᵀ.

    Args:
        L: (n, n) factor. n: its size. X: (m, n). m: number of rows.
    """
    for i in range(m):
        forward(L, n, X[i])


@leaf
def transposed_factor_times(L, n, x):
    """Overwrite x[:n] with Lᵀx.

    Args:
        L: (n, n) factor from `cholesky`. n: its size. x: operand, then product.
    """
    for i in range(n):
        s = x[i] / L[i, i]
        for k in range(i + 1, n):
            s += L[k, i] * x[k]
        x[i] = s


@leaf
def factor_times(L, n, B, m, out):
    """out ← L B, L from `cholesky` or `orthonormalise`.

    Args:
        L: (n, n) factor. n: its size. B, out: (n, m). m: columns of B.
    """
    for i in range(n):
        for j in range(m):
            s = B[i, j] / L[i, i]
            for k in range(i):
                s += L[i, k] * B[k, j]
            out[i, j] = s


@inner
def backward(L, n, x):
    """Overwrite x[:n] with L⁻ᵀx.

    Args:
        L, n, x: as of `forward`.
    """
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s * L[i, i]


@inner
def cholesky_solve(L, n, x):
    """Overwrite x[:n] with (LLᵀ)⁻¹x.

    Args:
        L, n, x: as of `forward`.
    """
    forward(L, n, x)
    backward(L, n, x)


@inner
def lu_solve(A, n, B, columns):
    """Overwrite the rows B[:columns, :n] with A⁻¹B by elimination with pivoting; A is destroyed.

    Returns False where a pivot shrinks to _SINGULAR of the largest.

    Args:
        A: (n, n). n: its size. B: right sides as rows. columns: how many.
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
            if n == 6:
                accumulate(A[i], -f, A[k])
            else:
                for j in range(k + 1, n):
                    A[i, j] -= f * A[k, j]
            for c in range(columns):
                B[c, i] -= f * B[c, k]
        A[k, k] = inverse
    for c in range(columns):
        for i in range(n - 1, -1, -1):
            s = B[c, i]
            for j in range(i + 1, n):
                s -= A[i, j] * B[c, j]
            B[c, i] = s * A[i, i]
    return True


@inner
def qr_rows(X, rows, length, diagonal, beta):
    """Householder QR of the (length, rows) matrix whose *columns* are X[:rows, :length].

    Column k's reflector 1 − β v vᵀ is left in X[k, k:], R in X[j, k] (k < j) and `diagonal`.

    Args:
        X: columns of the matrix, as rows. rows: how many. length: of each.
        diagonal, beta: (rows,) of R, and of the reflectors.
    """
    for k in range(rows):
        v = X[k, k:]
        rest = length - k
        square = dot(v, v, rest)
        if not square > 0.0:
            return False
        diagonal[k], beta[k] = reflector(square, v[0])
        v[0] -= diagonal[k]
        for j in range(k + 1, rows):
            reflect(v, beta[k], rest, X[j, k:])
    return True


@inner
def reflect(v, beta, n, x):
    """x ← (1 − β v vᵀ) x.

    Args:
        v: reflector. beta: its factor. n: how many elements count. x: row, overwritten.
    """
    add_scaled(-beta * dot(v, x, n), v, n, x)


@inner
def form_q(X, rows, length, beta, count, Q):
    """The first `count` columns of Q, as rows Q[:count, :length].

    Args:
        X, rows, length, beta: from `qr_rows`. count: columns of Q. Q: for them, as rows.
    """
    for c in range(count):
        for i in range(length):
            Q[c, i] = 0.0
        Q[c, c] = 1.0
        for k in range(min(c, rows - 1), -1, -1):
            reflect(X[k, k:], beta[k], length - k, Q[c, k:])


@inner
def back_substitute(X, rows, length, diagonal, Z):
    """Overwrite the rows Z[:rows, :length] with R⁻¹Z, R from `qr_rows`.

    Args:
        X, rows, diagonal: from `qr_rows`. length: of each row of Z. Z: right sides, then solutions.
    """
    for k in range(rows - 1, -1, -1):
        for j in range(k + 1, rows):
            add_scaled(-X[j, k], Z[j], length, Z[k])
        for i in range(length):
            Z[k, i] /= diagonal[k]


@inner
def one_sided_jacobi(X, count, length, carried):
    """Rotate the rows X[:count, :length] until they are orthogonal; their norms are the singular
    values. The next `carried` elements of each row are rotated along.

    Args:
        X: rows, overwritten. count: how many. length: elements that become orthogonal.
        carried: elements behind them.
    """
    for _ in range(30):
        turned = False
        for p in range(count - 1):
            a = dot(X[p], X[p], length)
            for q in range(p + 1, count):
                b = c = 0.0
                for i in range(length):
                    b += X[q, i] * X[q, i]
                    c += X[p, i] * X[q, i]
                if abs(c) <= 2e-16 * max(a, b):
                    continue
                d = b - a
                h = d * d + 4.0 * c * c
                if h < _NOTHING:  # rows that are zero: their squares have lost digits
                    continue
                h = sqrt(h)
                turned = True
                t = 2.0 * c / (d + h if d >= 0.0 else d - h)
                cosine = sqrt(0.5 + 0.5 * abs(d) / h)
                sine = cosine * t
                a -= t * c
                for i in range(length + carried):
                    x = X[p, i]
                    y = X[q, i]
                    X[p, i] = cosine * x - sine * y
                    X[q, i] = sine * x + cosine * y
        if not turned:
            return


@inner
def orthonormalise(X, r, m, Q, L):
    """X = L Q over the elements m … 5 of rows: Q (r, 6) orthonormal, L (r, r) lower triangular.

    The first m elements of Q are zero. Modified Gram–Schmidt, twice. L carries the inverse of its
    diagonal there, as in `cholesky`. Returns the least |L_aa| beside its row's length; 0: a zero
    row.

    Args:
        X: rows. r: how many. m: first element that counts. Q, L: for the factors; Q may be X.
    """
    least = 1.0
    for a in range(r):
        fill(Q[a], X[a])
        for i in range(m):
            Q[a, i] = 0.0
        x = six(Q[a])
        whole = dot6(x, x)
        for b in range(a):
            L[a, b] = 0.0
        for _ in range(2 if a > 0 else 0):
            for b in range(a):
                t = dot6(x, Q[b])
                L[a, b] += t
                x = add(x, -t, Q[b])
        square = dot6(x, x)
        if not square > 0.0:
            return 0.0
        L[a, a] = 1.0 / sqrt(square)
        fill(Q[a], scaled(L[a, a], x))
        least = min(least, sqrt(square / whole))
    return least


@inner
def project_onto_constraint(Q, r, x, target):
    """x ← the nearest x (6,) with Q x = target, the rows of Q (r, 6) orthonormal.

    Args:
        Q: (r, 6). r: how many rows. x: (6,), overwritten. target: (r,) what Q x shall be.
    """
    y = six(x)
    for _ in range(2):
        for a in range(r):
            y = add(y, target[a] - dot6(Q[a], y), Q[a])
    fill(x, y)


@inner
def project_onto_columns(L, Q, r, x, target):
    """x ← the nearest x (6,) with L Q x = target.

    Args:
        L, Q: (r, r) and (r, 6) from `orthonormalise`. r: number of rows. x: (6,), target: (r,),
            both overwritten.
    """
    forward(L, r, target)
    project_onto_constraint(Q, r, x, target)
