"""Signed distance, normal and curvature of a smooth surface, at the foot of any point."""

from __future__ import annotations

from math import floor, sqrt

from osc_contact.law.jit import inner, leaf

# F(x) = ½(q₁x² + q₂y² + q₃z²) + b z + c − h(x, y) is zero on the surface, in its own axes S; h is
# bicubic in each cell of a grid, or zero. The foot f of a point p solves p = f + λ∇F(f), F(f) = 0:
# then n = ∇F/|∇F| is the normal there, λ|∇F| the signed distance of p, n its gradient. Where p
# moves by v, f moves by df = (1 + λH)⁻¹(v − dλ ∇F) with ∇Fᵀdf = 0, and n by (1 − nnᵀ)H df/|∇F|.
#
# Shapes: a ball's centre in A (0:3) and radius (3), q (4:7), b, c (7, 8), corner of the grid
# (9, 10), cells per metre (11, 12) and their numbers (13, 14), 0: no h; then R_ES by rows and the
# origin of S in E; then h of each cell, 4 p + q the factor of uᵖvᵠ, u, v = 0 … 1 along x, y.

_ITERATIONS = 25
_EXACT = 1e-28  #: m²; of Newton's last step


@leaf
def is_near(x, y, z):
    """Whether a step is Newton's last.

    Args:
        x, y, z: of the step (m).
    """
    return x * x + y * y + z * z < _EXACT


@leaf
def _cell(x, count):
    """Number of the cell where x is, and where in it; the outermost cells have no end."""
    i = int(min(max(floor(x), 0.0), count - 1.0))
    return i, x - i


@inner
def _height(shapes, at, x, y):
    """h and its derivatives by x, y, xx, xy, yy."""
    row = shapes[at].row
    if row[13] == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    i, u = _cell((x - row[9]) * row[11], row[13])
    j, v = _cell((y - row[10]) * row[12], row[14])
    a = shapes[at + 2 + i * int(row[14]) + j].row
    h = h_u = h_uu = h_v = h_uv = h_vv = 0.0
    for k in range(3, -1, -1):  # Horner's scheme, differentiated
        f = ((a[4 * k + 3] * v + a[4 * k + 2]) * v + a[4 * k + 1]) * v + a[4 * k]
        f_v = (3.0 * a[4 * k + 3] * v + 2.0 * a[4 * k + 2]) * v + a[4 * k + 1]
        f_vv = 6.0 * a[4 * k + 3] * v + 2.0 * a[4 * k + 2]
        h_uu = h_uu * u + 2.0 * h_u
        h_u = h_u * u + h
        h = h * u + f
        h_uv = h_uv * u + h_v
        h_v = h_v * u + f_v
        h_vv = h_vv * u + f_vv
    s = row[11]
    r = row[12]
    return h, s * h_u, r * h_v, s * s * h_uu, s * r * h_uv, r * r * h_vv


@inner
def nearest(shapes, at, x, y, z):
    """The surface nearest to a point of S.

    Args:
        shapes: SHAPE rows. at: the first of the surface's. x, y, z: of the point (m).

    Returns:
        λ; ∇F at the foot; H there: xx, xy, yy, zz; M = (1 + λH)⁻¹: xx, xy, yy, zz.
    """
    row = shapes[at].row
    a, b, c = x, y, z
    s = 0.0
    for _ in range(_ITERATIONS):
        h, h_x, h_y, h_xx, h_xy, h_yy = _height(shapes, at, a, b)
        g = (row[4] * a - h_x, row[5] * b - h_y, row[6] * c + row[7])
        F = 0.5 * (row[4] * a * a + row[5] * b * b + row[6] * c * c) + row[7] * c + row[8] - h
        H = (row[4] - h_xx, -h_xy, row[5] - h_yy, row[6])
        xx = 1.0 + s * H[0]
        xy = s * H[1]
        yy = 1.0 + s * H[2]
        det = xx * yy - xy * xy
        M = (yy / det, -xy / det, xx / det, 1.0 / (1.0 + s * H[3]))
        m = _times(M, g[0], g[1], g[2])
        u, v, w = x - a - s * g[0], y - b - s * g[1], z - c - s * g[2]
        ds = m[0] * u + m[1] * v + m[2] * w + F
        ds = ds / (m[0] * g[0] + m[1] * g[1] + m[2] * g[2])
        u, v, w = _times(M, u - ds * g[0], v - ds * g[1], w - ds * g[2])
        a = a + u
        b = b + v
        c = c + w
        s = s + ds
        if is_near(u, v, w):
            break
    return s, g, H, M


@leaf
def _times(M, x, y, z):
    """A symmetric matrix xx, xy, yy, zz times a vector."""
    return M[0] * x + M[1] * y, M[1] * x + M[2] * y, M[3] * z


@leaf
def _into_surface(row, x, y, z):
    """A vector of E along the axes of S; row: R_ES by rows."""
    return (
        row[0] * x + row[3] * y + row[6] * z,
        row[1] * x + row[4] * y + row[7] * z,
        row[2] * x + row[5] * y + row[8] * z,
    )


@leaf
def _out_of_surface(row, x, y, z):
    """A vector of S along the axes of E."""
    return (
        row[0] * x + row[1] * y + row[2] * z,
        row[3] * x + row[4] * y + row[5] * z,
        row[6] * x + row[7] * y + row[8] * z,
    )


@inner
def normal_at(shapes, at, p, v):
    """|∇F|, n and dn/dt at the foot of a point p of E that moves by v, all along the axes of E.

    Args:
        shapes: SHAPE rows. at: the first of the surface's. p, v: three numbers each (m, m/s).
    """
    seat = shapes[at + 1].row
    a, b, c = _into_surface(seat, p[0] - seat[9], p[1] - seat[10], p[2] - seat[11])
    _, g, H, M = nearest(shapes, at, a, b, c)
    size = sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    a, b, c = _into_surface(seat, v[0], v[1], v[2])
    a, b, c = _times(M, a, b, c)
    m = _times(M, g[0], g[1], g[2])
    s = g[0] * a + g[1] * b + g[2] * c
    s = s / (m[0] * g[0] + m[1] * g[1] + m[2] * g[2])
    a, b, c = _times(H, a - s * m[0], b - s * m[1], c - s * m[2])
    s = (g[0] * a + g[1] * b + g[2] * c) / (size * size)
    a, b, c = (a - s * g[0]) / size, (b - s * g[1]) / size, (c - s * g[2]) / size
    n = _out_of_surface(seat, g[0] / size, g[1] / size, g[2] / size)
    return size, n, _out_of_surface(seat, a, b, c)
