"""A point of the program for motor limits worked out once more from the limits that hold it."""

from __future__ import annotations

from osc_contact.law.algebra import back_substitute, qr_rows
from osc_contact.law.jit import inner

_DEPENDENT = 1e-9  # of a unit row, beside the rows before it
_ROOM = 1e-7  # around the bounds, for a point worked out from its active limits


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
def add(s, a, n, out):
    """out ← out + s a.

    Args:
        s: factor. a: row. n: how many elements of it count. out: row, overwritten.
    """
    for i in range(n):
        out[i] += s * a[i]


@inner
def _reflect(u, beta, n, x):
    add(-beta * dot(u, x, n), u, n, x)


@inner
def refine(lam, w, A, bounds, rows, scratch):
    """Work out z once more from `rows`, the limits that have multipliers as equations: `point`.

    That has the root of H's condition. Returns False where another limit is broken.

    Args:
        lam: multipliers of all limits. w: columns of `rows`. A: (k, v) constraint rows.
        bounds: (2, …) lower and upper. rows: (v, w) root of the program's H. scratch: arrays.
    """
    point, y, diagonal, beta, bend, mix, t, T, normals, reduced, free = scratch
    (k, v), f, kept = A.shape, 0, 0
    for i in range(w + k):
        t[i] = 0.0
    for j in range(v):
        for i in range(w + k):
            reduced[f, i] = rows[j, i] if i < w else A[i - w, j]
        if lam[j] == 0.0:
            point[j] = 0.0
            free[f] = j
            f += 1
        else:
            point[j] = bounds[int(lam[j] > 0.0), j]
            add(point[j], reduced[f], w + k, t)
    for c in range(k):
        u = normals[kept]
        rest = reduced[kept:]
        for j in range(f - kept):
            u[j] = rest[j, w + c]
        if lam[v + c] == 0.0 or kept == f:
            continue
        mirrored = qr_rows(normals[kept:], T.shape[1], f - kept, diagonal, bend[kept:])  # one row
        if not mirrored or abs(diagonal[0]) <= _DEPENDENT:
            continue
        for i in range(w + k):
            mix[i] = 0.0
        for j in range(f - kept):
            add(bend[kept] * u[j], rest[j], w + k, mix)
        for j in range(f - kept):
            add(-u[j], mix, w + k, rest[j])
        y[kept] = (bounds[int(lam[v + c] > 0.0), v + c] - t[w + c]) / diagonal[0]
        add(y[kept], rest[0], w + k, t)
        kept += 1
    rest = reduced[kept:]
    if not qr_rows(rest, f - kept, w, diagonal, beta):
        return False
    for c in range(f - kept):
        _reflect(rest[c, c:], beta[c], w - c, t[c:])
    back_substitute(rest, f - kept, 1, diagonal, T)
    for c in range(f - kept):
        y[kept + c] = -t[c]
    for b in range(kept - 1, -1, -1):
        _reflect(normals[b], bend[b], f - b, y[b:])
    for j in range(f):
        point[free[j]] = y[j]
    for j in range(v + k):
        x = point[j] if j < v else dot(A[j - v], point, v)
        room = _ROOM * (1.0 + abs(x))
        if not bounds[0, j] - room <= x <= bounds[1, j] + room:
            return False
    return True
