"""Dense linear algebra for small matrices whose sizes are arguments.

Arrays may be larger than the matrix in them, whose size is an argument. Vectors of the operational
space are rows of six numbers; X (n, 6) contains n of them. Results are written to an array `out` of
the caller (`jit.local`), which must not be an operand unless the docstring permits it. An operation
that can fail returns False or 0.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.jit import inner, leaf
from osc_contact.law.vectors import accumulate, add, dot6, fill, reflector, scaled, six

_SINGULAR = 1e-10  #: relative pivot below which a matrix is singular
_SUBNORMAL_SQUARE = 1e-280  #: squares below it lose digits (subnormal numbers)


@inner
def dot(a, b, n):
    """Inner product Σ aᵢbᵢ of two rows.

    Args:
        a: (n,) or longer.
        b: (n,) or longer.
        n: number of elements that are multiplied.
    """
    s = 0.0
    for i in range(n):
        s += a[i] * b[i]
    return s


@inner
def add_scaled(s, a, n, out):
    """Add s a[:n] to out[:n].

    Args:
        s: factor.
        a: (n,) or longer.
        n: number of elements that are added.
        out: (n,) or longer, changed.
    """
    for i in range(n):
        out[i] += s * a[i]


@leaf
def gram(X, n, Y, m, out):
    """Compute X Yᵀ, the inner products of rows of six numbers.

    Args:
        X: (n, 6).
        n: number of rows of X.
        Y: (m, 6).
        m: number of rows of Y.
        out: (n, m), filled.
    """
    for i in range(n):
        for j in range(m):
            out[i, j] = dot6(X[i], Y[j])


@leaf
def transpose(A, n, m, out):
    """Write the transpose of a matrix to `out`.

    Args:
        A: (n, m).
        n: number of rows of A.
        m: number of columns of A.
        out: (m, n), filled.
    """
    for i in range(n):
        for j in range(m):
            out[j, i] = A[i, j]


@inner
def cholesky(A, first, n, L):
    """Compute the Cholesky factor L (n, n) of a symmetric diagonal block B of A, B = LLᵀ.

    Only the lower triangle of A is read. L has the reciprocals of its diagonal elements in place of
    them, so that later substitutions multiply instead of dividing.

    Args:
        A: symmetric matrix, at least (first + n, first + n).
        first: row and column at which the block begins.
        n: size of the block.
        L: (n, n), of which the lower triangle is filled.

    Returns:
        The smallest ratio of a pivot to its diagonal element of A; ≤ 0 if A is not positive
        definite.
    """
    least_ratio = 1.0
    for i in range(n):
        for j in range(i + 1):
            s = A[first + i, first + j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                diagonal = A[first + i, first + i]
                if not s > 0.0:  # also if NaN
                    return 0.0
                least_ratio = min(least_ratio, s / diagonal)
                L[i, i] = 1.0 / sqrt(s)
            else:
                L[i, j] = s * L[j, j]
    return least_ratio


@leaf
def forward_rows(L, n, X):
    """Overwrite the rows X[:n, :6] with L⁻¹X.

    Args:
        L: (n, n) factor from `cholesky`, reciprocals on its diagonal.
        n: its size.
        X: (n, 6), overwritten.
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
        L: (n, n) factor, reciprocals on its diagonal.
        n: its size.
        x: right-hand side, overwritten with the solution.
    """
    for i in range(n):
        s = x[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s * L[i, i]


@leaf
def forward_each(L, n, X, m):
    """Multiply each of the rows X[:m, :n] by L⁻¹: X ← X L⁻ᵀ.

    Args:
        L: (n, n) factor from `cholesky`, reciprocals on its diagonal.
        n: its size.
        X: (m, n), overwritten.
        m: number of rows.
    """
    for i in range(m):
        forward(L, n, X[i])


@leaf
def transposed_factor_times(L, n, x):
    """Overwrite x[:n] with Lᵀx.

    Args:
        L: (n, n) factor from `cholesky`, reciprocals on its diagonal.
        n: its size.
        x: operand, overwritten with the product.
    """
    for i in range(n):
        s = x[i] / L[i, i]
        for k in range(i + 1, n):
            s += L[k, i] * x[k]
        x[i] = s


@leaf
def factor_times(L, n, B, m, out):
    """Compute the product L B, L from `cholesky` or `orthonormalise`.

    Args:
        L: (n, n) factor, reciprocals on its diagonal.
        n: its size.
        B: (n, m).
        m: number of columns of B.
        out: (n, m), filled.
    """
    for i in range(n):
        for j in range(m):
            s = B[i, j] / L[i, i]  # L[i, i] is the reciprocal of the diagonal element
            for k in range(i):
                s += L[i, k] * B[k, j]
            out[i, j] = s


@inner
def backward(L, n, x):
    """Overwrite x[:n] with L⁻ᵀx, L from `cholesky`.

    Args:
        L: (n, n) factor, reciprocals on its diagonal.
        n: its size.
        x: right-hand side, overwritten with the solution.
    """
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s * L[i, i]


@inner
def cholesky_solve(L, n, x):
    """Overwrite x[:n] with (LLᵀ)⁻¹x, L from `cholesky`.

    Args:
        L: (n, n) factor, reciprocals on its diagonal.
        n: its size.
        x: right-hand side, overwritten with the solution.
    """
    forward(L, n, x)
    backward(L, n, x)


@inner
def lu_solve(A, n, B, columns):
    """Solve A x = b for each row b of B by Gaussian elimination with partial pivoting.

    The reciprocal of each pivot is stored in place of the pivot.

    Args:
        A: (n, n), destroyed.
        n: its size.
        B: (columns, n) right-hand sides as rows, overwritten with the solutions.
        columns: number of right-hand sides.

    Returns:
        False if a pivot is at most _SINGULAR times the largest one.
    """
    largest = 0.0
    for k in range(n):
        p = k  # row of the pivot
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[p, k]):
                p = i
        largest = max(largest, abs(A[p, k]))
        if not abs(A[p, k]) > _SINGULAR * largest:  # also if NaN
            return False
        if p != k:
            for j in range(n):
                A[k, j], A[p, j] = A[p, j], A[k, j]
            for c in range(columns):
                B[c, k], B[c, p] = B[c, p], B[c, k]
        inverse = 1.0 / A[k, k]
        for i in range(k + 1, n):
            f = A[i, k] * inverse
            if n == 6:  # whole rows at once; elements before k are not read any more
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
    """Compute the Householder QR of a matrix whose *columns* are the rows X[:rows, :length].

    Reflector k is 1 − β_k v_k v_kᵀ; its vector v_k is left in X[k, k:], element (k, j) of R with k
    < j in X[j, k], and the diagonal of R in `diagonal`.

    Args:
        X: (rows, length) columns of the matrix, overwritten.
        rows: number of columns.
        length: length of each column.
        diagonal: (rows,), filled with the diagonal of R.
        beta: (rows,), filled with β of the reflectors.

    Returns:
        False if a column depends on those before it.
    """
    for k in range(rows):
        v = X[k, k:]
        n_remaining = length - k
        square = dot(v, v, n_remaining)
        if not square > 0.0:  # also if NaN
            return False
        diagonal[k], beta[k] = reflector(square, v[0])
        v[0] -= diagonal[k]
        for j in range(k + 1, rows):
            reflect(v, beta[k], n_remaining, X[j, k:])
    return True


@inner
def reflect(v, beta, n, x):
    """Apply the reflector 1 − β v vᵀ to x[:n].

    Args:
        v: (n,) vector of the reflector.
        beta: β.
        n: number of elements.
        x: (n,) or longer, overwritten.
    """
    add_scaled(-beta * dot(v, x, n), v, n, x)


@inner
def form_q(X, rows, length, beta, count, Q):
    """Form the first `count` columns of the orthogonal factor Q, as rows Q[:count, :length].

    Args:
        X: (rows, length) from `qr_rows`, with the vectors v_k of the reflectors.
        rows: number of reflectors.
        length: length of each column of Q.
        beta: (rows,) β of the reflectors 1 − β v vᵀ.
        count: number of columns of Q.
        Q: (count, length), filled.
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
        X: (rows, …) from `qr_rows`: element (k, j) of R, k < j, is X[j, k].
        rows: size of R.
        diagonal: (rows,) diagonal of R.
        length: number of elements of each row of Z.
        Z: (rows, length) right-hand sides, overwritten with the solutions.
    """
    for k in range(rows - 1, -1, -1):
        for j in range(k + 1, rows):
            add_scaled(-X[j, k], Z[j], length, Z[k])
        for i in range(length):
            Z[k, i] /= diagonal[k]


@inner
def one_sided_jacobi(X, count, length, carried):
    """Rotate the rows of X among each other until their leading elements are orthogonal.

    It is the singular value decomposition U X[:count, :length] = ΣYᵀ: the norms of the leading
    parts of the resulting rows are the singular values. The next `carried` elements of each row are
    rotated with it, so that an appended identity becomes U.

    Args:
        X: (count, length + carried) or larger, overwritten.
        count: number of rows.
        length: number of leading elements of each row that become orthogonal.
        carried: number of elements behind them that are rotated, too.
    """
    for _ in range(30):  # sweeps; convergence is quadratic, so that few are needed
        has_rotated = False
        for p in range(count - 1):
            a = dot(X[p], X[p], length)
            for q in range(p + 1, count):
                b = c = 0.0  # squares a, b of both rows, and their product c
                for i in range(length):
                    b += X[q, i] * X[q, i]
                    c += X[p, i] * X[q, i]
                if abs(c) <= 2e-16 * max(a, b):
                    continue
                d = b - a  # tan 2φ = 2c/d of the rotation by φ that makes c zero
                h = d * d + 4.0 * c * c
                if h < _SUBNORMAL_SQUARE:  # two zero rows, whose squares have lost digits
                    continue
                h = sqrt(h)
                has_rotated = True
                t = 2.0 * c / (d + h if d >= 0.0 else d - h)  # tan φ, |φ| ≤ 45°
                cosine = sqrt(0.5 + 0.5 * abs(d) / h)
                sine = cosine * t
                a -= t * c  # the square of the rotated row p
                for i in range(length + carried):
                    x = X[p, i]
                    y = X[q, i]
                    X[p, i] = cosine * x - sine * y
                    X[q, i] = sine * x + cosine * y
        if not has_rotated:
            return


@inner
def orthonormalise(X, r, m, Q, L):
    """Factorise X = L Q over the elements m … 5 of its rows, by modified Gram–Schmidt.

    Q (r, 6) has orthonormal rows whose first m elements are zero; L (r, r) is lower triangular,
    with the reciprocals of its diagonal in place of the diagonal, as in `cholesky`.

    Args:
        X: (r, 6) matrix that is factorised.
        r: number of rows.
        m: index of the first element in use.
        Q: (r, 6), filled; it may be X.
        L: (r, r), filled.

    Returns:
        The smallest |L_aa| relative to the norm of row a of X; 0 if a row is zero.
    """
    least_ratio = 1.0
    for a in range(r):
        fill(Q[a], X[a])
        for i in range(m):
            Q[a, i] = 0.0
        x = six(Q[a])
        total = dot6(x, x)
        for b in range(a):
            L[a, b] = 0.0
        for _ in range(2):  # twice: the first pass leaves rounding errors
            for b in range(a):
                component = dot6(x, Q[b])
                L[a, b] += component
                x = add(x, -component, Q[b])
        square = dot6(x, x)
        if not square > 0.0:  # also if NaN
            return 0.0
        L[a, a] = 1.0 / sqrt(square)
        fill(Q[a], scaled(L[a, a], x))
        least_ratio = min(least_ratio, sqrt(square / total))
    return least_ratio


@inner
def project_onto_constraint(Q, r, x, target):
    """Replace x by the nearest vector with Q x = target.

    Args:
        Q: (r, 6) with orthonormal rows.
        r: number of rows.
        x: (6,), overwritten.
        target: (r,) required Q x.
    """
    y = six(x)
    for _ in range(2):  # twice: the first pass leaves rounding errors
        for a in range(r):
            y = add(y, target[a] - dot6(Q[a], y), Q[a])
    fill(x, y)


@inner
def project_onto_columns(L, Q, r, x, target):
    """Replace x by the nearest vector with L Q x = target.

    Args:
        L: (r, r) lower triangular factor from `orthonormalise`.
        Q: (r, 6) orthonormal rows from `orthonormalise`.
        r: number of rows.
        x: (6,), overwritten.
        target: (r,) required L Q x, overwritten.
    """
    forward(L, r, target)
    project_onto_constraint(Q, r, x, target)
