"""Contact geometry: N and n_γ at the operational point, in world axes, of every packaged pair.

A pair is one row of `pairs` (integers): its kind, its first column of N, its number of columns, the
first row of its geometry. The geometry rows (floats) are given with each function. Positions are
taken from O, motions at O.
"""

from __future__ import annotations

from math import copysign, sqrt

from osc_contact.kernels.compile import compiled, pose_in
from osc_contact.kernels.layout import EDGES, FACE_ON_VERTEX, GIVEN, POINTS
from osc_contact.kernels.linalg import cross, dot6

__all__ = ["contact_columns"]


@compiled
def turn(R, x, y, z):
    """R (x, y, z), R the rotation in the first rows and columns of a matrix."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@compiled
def carried(V, start, end, out):
    """A twist carried from point to point (positions), as `spatial.carry_twist`."""
    x, y, z = cross(V[3], V[4], V[5], end[0] - start[0], end[1] - start[1], end[2] - start[2])
    out[0], out[1], out[2] = V[0] + x, V[1] + y, V[2] + z
    out[3], out[4], out[5] = V[3], V[4], V[5]


@compiled
def _velocity(V, x, y, z):
    a, b, c = cross(V[3], V[4], V[5], x, y, z)
    return V[0] + a, V[1] + b, V[2] + c


@compiled
def _line(N, x, y, z, a, b, c):
    """N = W(n, p) = [n; p × n], the line of force along n = (a, b, c) through p = (x, y, z)."""
    N[0], N[1], N[2] = a, b, c
    N[3], N[4], N[5] = cross(x, y, z, a, b, c)


@compiled
def contact_columns(
    pairs, count, shapes, X_WO, V_O, bodies, moving, mu, slip, N, n_gamma, drags, scratch
):
    """Fill N (r_all, 6) and n_γ (r_all,); returns False where a pair is degenerate.

    Args:
        pairs: (…, 6) integers, `count` of them: kind, first column, columns, first shape row, body,
            number of freedoms.
        shapes: (…, 16) geometry.
        X_WO: (4, 4) pose of the object. V_O: (6,) its twist at O.
        bodies: (contacts, 28) of each touched body: X_WE (16), V_E (6), A_E (6).
        moving: whether `bodies` counts; False: they rest in the world.
        mu, slip: of friction; with mu > 0, vertices on faces only, `drags` (r_all, 6) is filled.
        N, n_gamma: columns of pairs evaluated elsewhere (GIVEN) are left as they are.
        scratch: (4, 6).
    """
    O, V_E, V_rel = scratch[0], scratch[1], scratch[2]
    for i in range(3):
        O[i] = X_WO[i, 3]
    for k in range(count):
        kind, first = pairs[k, 0], pairs[k, 1]
        if kind == GIVEN:
            continue
        E = bodies[pairs[k, 4]]
        R_E = pose_in(E, 0)
        if moving:
            x, y, z = cross(
                E[19], E[20], E[21], O[0] - R_E[0, 3], O[1] - R_E[1, 3], O[2] - R_E[2, 3]
            )
            V_E[0], V_E[1], V_E[2] = E[16] + x, E[17] + y, E[18] + z
            V_E[3], V_E[4], V_E[5] = E[19], E[20], E[21]
        else:
            for i in range(6):
                V_E[i] = 0.0
        for i in range(6):
            V_rel[i] = V_O[i] - V_E[i]
        rows = shapes[pairs[k, 3] :]
        if kind == POINTS:
            _points(
                pairs[k, 2], rows, X_WO, V_O, R_E, V_E, V_rel, moving, N[first:], n_gamma[first:]
            )
            if mu > 0.0:
                _drag(rows, X_WO, R_E, V_rel, mu, slip, N[first], drags[first])
        elif kind == FACE_ON_VERTEX:
            _face_on_vertex(rows, X_WO, V_O, R_E, V_E, V_rel, N[first], n_gamma[first:], scratch[3])
        elif kind == EDGES:
            if not _edges(rows, X_WO, V_O, R_E, V_E, V_rel, N[first], n_gamma[first:], scratch[3]):
                return False
        else:
            _tangents(
                pairs[k], rows, X_WO, V_O, R_E, V_E, V_rel, N[first:], n_gamma[first:], scratch[3]
            )
    return True


@compiled
def _points(r, rows, X_WO, V_O, R_E, V_E, V_rel, moving, N, n_gamma):
    """Points of A (row 0:3) on planes of E with directions into it (3:6), distance (6) along."""
    for j in range(r):
        x, y, z = turn(X_WO, rows[j, 0], rows[j, 1], rows[j, 2])
        if moving:
            a, b, c = turn(R_E, rows[j, 3], rows[j, 4], rows[j, 5])
        else:
            a, b, c = rows[j, 3], rows[j, 4], rows[j, 5]
        _line(N[j], x, y, z, a, b, c)
        u, v, w = _velocity(V_O, x, y, z)
        u, v, w = cross(V_rel[3], V_rel[4], V_rel[5], u, v, w)
        s = -(a * u + b * v + c * w)
        if moving:
            a, b, c = cross(V_E[3], V_E[4], V_E[5], a, b, c)
            u, v, w = _velocity(V_rel, x, y, z)
            s -= a * u + b * v + c * w
        n_gamma[j] = s


@compiled
def _drag(rows, X_WO, R_E, V_rel, mu, slip, N, drag):
    """μ [s; p × s], s = v_t / √(v_t² + v_0²), of a vertex over p on the face (`control.friction`).

    N: (6,) of the contact. drag: (6,) filled.
    """
    a, b, c = N[0], N[1], N[2]
    x, y, z = turn(X_WO, rows[0, 0], rows[0, 1], rows[0, 2])
    gap = rows[0, 6] + a * (R_E[0, 3] - X_WO[0, 3] - x)
    gap += b * (R_E[1, 3] - X_WO[1, 3] - y) + c * (R_E[2, 3] - X_WO[2, 3] - z)
    x, y, z = x + gap * a, y + gap * b, z + gap * c
    u, v, w = _velocity(V_rel, x, y, z)
    s = a * u + b * v + c * w
    u, v, w = u - s * a, v - s * b, w - s * c
    s = mu / sqrt(u * u + v * v + w * w + slip * slip)
    _line(drag, x, y, z, s * u, s * v, s * w)


@compiled
def _rate(p, n, p_dot, n_dot, out):
    """Ẇ(n, p) = [ṅ; ṗ × n + p × ṅ]."""
    x, y, z = cross(p_dot[0], p_dot[1], p_dot[2], n[0], n[1], n[2])
    a, b, c = cross(p[0], p[1], p[2], n_dot[0], n_dot[1], n_dot[2])
    out[0], out[1], out[2] = n_dot[0], n_dot[1], n_dot[2]
    out[3], out[4], out[5] = x + a, y + b, z + c


@compiled
def _face_on_vertex(rows, X_WO, V_O, R_E, V_E, V_rel, N, n_gamma, rate):
    """Row: normal of A's face (0:3), vertex of E (3:6)."""
    n = turn(X_WO, rows[0, 0], rows[0, 1], rows[0, 2])
    x, y, z = turn(R_E, rows[0, 3], rows[0, 4], rows[0, 5])
    p = (x + R_E[0, 3] - X_WO[0, 3], y + R_E[1, 3] - X_WO[1, 3], z + R_E[2, 3] - X_WO[2, 3])
    _line(N, p[0], p[1], p[2], n[0], n[1], n[2])
    n_dot = cross(V_O[3], V_O[4], V_O[5], n[0], n[1], n[2])
    _rate(p, n, _velocity(V_E, p[0], p[1], p[2]), n_dot, rate)
    n_gamma[0] = -dot6(rate, V_rel)


@compiled
def _along_first(a, e, m, mm):
    """s with s e_A − t e_E = a in the plane ⟂ m = e_A × e_E."""
    x, y, z = cross(a[0], a[1], a[2], e[0], e[1], e[2])
    return (x * m[0] + y * m[1] + z * m[2]) / mm


@compiled
def _edges(rows, X_WO, V_O, R_E, V_E, V_rel, N, n_gamma, rate):
    """Row: point, direction of A's edge (0:3, 3:6), of E's (6:9, 9:12), side (12), normal (13:16).

    The side is ±1, or 0 where the environment's outward normal tells it.
    """
    e = turn(X_WO, rows[0, 3], rows[0, 4], rows[0, 5])
    f = turn(R_E, rows[0, 9], rows[0, 10], rows[0, 11])
    m = cross(e[0], e[1], e[2], f[0], f[1], f[2])
    mm = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    sine = sqrt(mm)
    if not sine >= 1e-6:
        return False
    side = rows[0, 12]
    if side == 0.0:
        o = turn(R_E, rows[0, 13], rows[0, 14], rows[0, 15])
        side = -(o[0] * m[0] + o[1] * m[1] + o[2] * m[2])
    scale = copysign(1.0 / sine, side)
    n = (scale * m[0], scale * m[1], scale * m[2])
    q = turn(X_WO, rows[0, 0], rows[0, 1], rows[0, 2])
    x, y, z = turn(R_E, rows[0, 6], rows[0, 7], rows[0, 8])
    apart = (
        x + R_E[0, 3] - X_WO[0, 3] - q[0],
        y + R_E[1, 3] - X_WO[1, 3] - q[1],
        z + R_E[2, 3] - X_WO[2, 3] - q[2],
    )
    s = _along_first(apart, f, m, mm)
    p = (q[0] + s * e[0], q[1] + s * e[1], q[2] + s * e[2])
    gap = n[0] * apart[0] + n[1] * apart[1] + n[2] * apart[2]
    a = cross(V_O[3], V_O[4], V_O[5], e[0], e[1], e[2])
    a = cross(a[0], a[1], a[2], f[0], f[1], f[2])
    b = cross(V_E[3], V_E[4], V_E[5], f[0], f[1], f[2])
    b = cross(e[0], e[1], e[2], b[0], b[1], b[2])
    w = (a[0] + b[0], a[1] + b[1], a[2] + b[2])
    along = n[0] * w[0] + n[1] * w[1] + n[2] * w[2]
    size = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
    n_dot = (
        (w[0] - along * n[0]) / size,
        (w[1] - along * n[1]) / size,
        (w[2] - along * n[2]) / size,
    )
    u = _velocity(V_O, p[0], p[1], p[2])
    v = _velocity(V_E, p[0] + gap * n[0], p[1] + gap * n[1], p[2] + gap * n[2])
    slip = (
        u[0] - v[0] + gap * n_dot[0],
        u[1] - v[1] + gap * n_dot[1],
        u[2] - v[2] + gap * n_dot[2],
    )
    s = _along_first(slip, f, m, mm)
    _line(N, p[0], p[1], p[2], n[0], n[1], n[2])
    _rate(p, n, (u[0] - s * e[0], u[1] - s * e[1], u[2] - s * e[2]), n_dot, rate)
    n_gamma[0] = -dot6(rate, V_rel)
    return True


@compiled
def _tangents(pair, rows, X_WO, V_O, R_E, V_E, V_rel, N, n_gamma, Tdot_beta):
    """The pairs given by T: n_γ = NᵀṪβ.

    Rows of N first, then `pair[5]` freedoms.
        column: point of A (0:3), direction of E (3:6), kind (6): 0 a force along the direction
        through the point, 1 a couple about (arm of A × mark of E), 2 a screw's thread: a force
        along the direction and a couple −pitch / cos about it; axis of A (7:10), pitch (10).
        freedom: point of A (0:3), axis (3:6), kind (6): 0 a turn about A's axis carried by A, 1 a
        slide along E's axis carried by E, 2 a screw: the turn and a slide of pitch (10) along E's
        direction (7:10).
    """
    r, freedoms = pair[2], pair[5]
    for i in range(6):
        Tdot_beta[i] = 0.0
    for k in range(r, r + freedoms):
        p = turn(X_WO, rows[k, 0], rows[k, 1], rows[k, 2])
        if rows[k, 6] == 1.0:
            d = turn(R_E, rows[k, 3], rows[k, 4], rows[k, 5])
            v = _velocity(V_rel, p[0], p[1], p[2])
            beta = d[0] * v[0] + d[1] * v[1] + d[2] * v[2]
            a = cross(V_E[3], V_E[4], V_E[5], d[0], d[1], d[2])
            for i in range(3):
                Tdot_beta[i] += beta * a[i]
        else:
            w = turn(X_WO, rows[k, 3], rows[k, 4], rows[k, 5])
            beta = w[0] * V_rel[3] + w[1] * V_rel[4] + w[2] * V_rel[5]
            t = cross(p[0], p[1], p[2], w[0], w[1], w[2])
            if rows[k, 6] == 2.0:
                d = turn(R_E, rows[k, 7], rows[k, 8], rows[k, 9])
                t = (
                    t[0] + rows[k, 10] * d[0],
                    t[1] + rows[k, 10] * d[1],
                    t[2] + rows[k, 10] * d[2],
                )
            a = cross(V_O[3], V_O[4], V_O[5], t[0], t[1], t[2])
            b = cross(V_O[0], V_O[1], V_O[2], w[0], w[1], w[2])
            c = cross(V_O[3], V_O[4], V_O[5], w[0], w[1], w[2])
            for i in range(3):
                Tdot_beta[i] += beta * (a[i] + b[i])
                Tdot_beta[3 + i] += beta * c[i]
    for j in range(r):
        p = turn(X_WO, rows[j, 0], rows[j, 1], rows[j, 2])
        d = turn(R_E, rows[j, 3], rows[j, 4], rows[j, 5])
        if rows[j, 6] == 1.0:
            m = cross(p[0], p[1], p[2], d[0], d[1], d[2])
            for i in range(3):
                N[j, i] = 0.0
                N[j, 3 + i] = m[i]
        else:
            _line(N[j], p[0], p[1], p[2], d[0], d[1], d[2])
            if rows[j, 6] == 2.0:
                w = turn(X_WO, rows[j, 7], rows[j, 8], rows[j, 9])
                f = rows[j, 10] / (d[0] * w[0] + d[1] * w[1] + d[2] * w[2])
                for i in range(3):
                    N[j, 3 + i] -= f * d[i]
        n_gamma[j] = dot6(N[j], Tdot_beta)
