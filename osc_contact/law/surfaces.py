"""Smooth surfaces: signed distance, normal and curvature at the foot of any point."""

from __future__ import annotations

from math import floor, sqrt

from osc_contact.law.jit import inner, leaf
from osc_contact.law.vectors import (
    add3,
    divided3,
    dot3,
    minus3,
    plus3,
    rotated9,
    rotated9_back,
)

# --- Smooth surfaces: signed distance, normal and curvature at the foot of any point ------------
#
# A surface is F(x) = ½(q₁x² + q₂y² + q₃z²) + b z + c − h(x, y) = 0 in its own axes S; h is bicubic
# in each cell of a grid, or zero. The foot f of a point p solves p = f + λ∇F(f), F(f) = 0. There
# n = ∇F/|∇F| is the normal, and λ|∇F| the signed distance of p, whose gradient is n. Where p moves
# by v, f moves by df = (1 + λH)⁻¹(v − dλ ∇F) with ∇Fᵀdf = 0, and n by (1 − nnᵀ)H df/|∇F|.
#
# Its SHAPE rows are, in this order: 1. centre of the ball in the object (0:3), its radius (3), q
# (4:7), b, c (7, 8), corner of the grid (9, 10), cells per metre (11, 12), numbers of cells (13,
# 14; 0 without h); 2. R_ES by rows (0:9) and the origin of S in the body (9:12); 3. one row for
# each cell, in which 4 p + q holds the factor of uᵖvᵠ of h, with u, v = 0 … 1 along x, y.

_MOST_ITERATIONS = 25
_EXACT = 1e-28  #: m²; square of a Newton step that ends the iteration


@leaf
def is_near(step):
    """Determine whether a Newton step (three numbers, m) is small enough to end the iteration."""
    return dot3(step, step) < _EXACT


@leaf
def _grid_cell(x, count):
    """Index of the grid cell that contains x, and the coordinate in it (0 … 1).

    The outermost cells extend to infinity, so that the coordinate may be beyond 0 … 1 there.

    Args:
        x: coordinate in cells.
        count: number of cells.
    """
    i = int(min(max(floor(x), 0.0), count - 1.0))
    return i, x - i


@inner
def _height_and_derivatives(shapes, at, x, y):
    """Height of a gridded surface and its derivatives at a place, by bicubic interpolation.

        h(u, v) = Σ a_kl u^k v^l   in each cell, with its coordinates u, v (0 … 1)

    The row at `at` has the corner of the grid (9:11; m), the reciprocal lengths of a cell along x
    and y (11:13; 1/m) and the numbers of cells (13:15); the coefficients a (4, 4) of the cells
    follow from `at` + 2 on, one row for each cell.

    Args:
        shapes: SHAPE rows.
        at: index of the first row of the surface.
        x, y: place in the axes of the surface (m).

    Returns:
        h (m), its derivatives by x and y (dimensionless), and by xx, xy and yy (1/m); zeros for a
        surface without a grid.
    """
    row = shapes[at].row
    if row[13] == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    i, u = _grid_cell((x - row[9]) * row[11], row[13])
    j, v = _grid_cell((y - row[10]) * row[12], row[14])
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
    s = row[11]  # du/dx and dv/dy (1/m)
    r = row[12]
    return h, s * h_u, r * h_v, s * s * h_uu, s * r * h_uv, r * r * h_vv


@inner
def nearest(shapes, at, p):
    """Foot of a point p on a surface F = 0, found by Newton's method.

    The foot solves p = foot + λ∇F(foot), F(foot) = 0.

    Args:
        shapes: SHAPE rows.
        at: index of the first row of the surface.
        p: (3,) the point in the surface's axes S (m).

    Returns:
        λ, with p = foot + λ∇F; ∇F at the foot; the Hessian H there, as (xx, xy, yy, zz); (1 +
        λH)⁻¹, as (xx, xy, yy, zz).
    """
    row = shapes[at].row
    foot = p
    scale = 0.0  # λ
    for _ in range(_MOST_ITERATIONS):
        x, y, z = foot
        h, h_x, h_y, h_xx, h_xy, h_yy = _height_and_derivatives(shapes, at, x, y)
        gradient = (row[4] * x - h_x, row[5] * y - h_y, row[6] * z + row[7])
        F = 0.5 * (row[4] * x * x + row[5] * y * y + row[6] * z * z) + row[7] * z + row[8] - h
        H = (row[4] - h_xx, -h_xy, row[5] - h_yy, row[6])
        # (1 + λH)⁻¹, whose z axis is not coupled to x and y
        xx = 1.0 + scale * H[0]
        xy = scale * H[1]
        yy = 1.0 + scale * H[2]
        det = xx * yy - xy * xy
        inverse = (yy / det, -xy / det, xx / det, 1.0 / (1.0 + scale * H[3]))
        inverse_gradient = _times_uncoupled(inverse, gradient)
        # Newton's step for foot + λ∇F = p, F(foot) = 0: its rows are missed by `miss` and by F
        miss = add3(minus3(p, foot), -scale, gradient)
        change = (dot3(inverse_gradient, miss) + F) / dot3(inverse_gradient, gradient)
        step = _times_uncoupled(inverse, add3(miss, -change, gradient))
        foot = plus3(foot, step)
        scale = scale + change
        if is_near(step):
            break
    return scale, gradient, H, inverse


@leaf
def _times_uncoupled(M, v):
    """Multiply a symmetric matrix with a vector whose z axis is not coupled to x and y.

    Args:
        M: four elements (xx, xy, yy, zz) of the matrix; xz and yz are zero.
        v: (3,).

    Returns:
        Three numbers.
    """
    return M[0] * v[0] + M[1] * v[1], M[1] * v[0] + M[2] * v[1], M[3] * v[2]


@inner
def normal_at(shapes, at, p, v):
    """Gradient magnitude |∇F|, normal n and its rate dn/dt at the foot of a moving point.

    The foot is the nearest point of the surface F = 0. With g = ∇F, λ and the Hessian H (3, 3) of F
    from `nearest`, the foot moves with (1 + λH)⁻¹(v − λ̇g), where λ̇ keeps it on the surface, and
    dn/dt = (1 − nnᵀ) Hv_foot/|g|. All vectors are in the axes of the touched body.

    Args:
        shapes: SHAPE rows.
        at: index of the first row of the surface.
        p: (3,) the point (m).
        v: (3,) its velocity (m/s).

    Returns:
        |∇F|; n (three numbers); dn/dt (three numbers, 1/s).
    """
    seat = shapes[at + 1].row
    _, g, H, inverse = nearest(shapes, at, rotated9_back(seat, minus3(p, seat[9:])))
    size = sqrt(dot3(g, g))
    v_foot = _times_uncoupled(inverse, rotated9_back(seat, v))
    inverse_g = _times_uncoupled(inverse, g)
    g_dot = _times_uncoupled(H, add3(v_foot, -dot3(g, v_foot) / dot3(inverse_g, g), inverse_g))
    n_dot = divided3(add3(g_dot, -dot3(g, g_dot) / (size * size), g), size)
    return size, rotated9(seat, divided3(g, size)), rotated9(seat, n_dot)
