"""6-vectors as values, energy coordinates of the held object, and the way back to world axes."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.law.jit import inner, leaf

# --- Rows of six numbers, and points, as values: lengths that a compiler keeps in registers -------
#
# The operational space has six dimensions, so most matrices of the law are rows of six. Reflectors
# 1 − β v vᵀ are rows v with zeros before the diagonal.

ZERO = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@leaf
def cross(ax, ay, az, bx, by, bz):
    """a × b.

    Args:
        ax, ay, az: of a. bx, by, bz: of b.
    """
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@leaf
def dot6(a, b):
    """aᵀb of 6-vectors."""
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])


@leaf
def six(x):
    """A row as a tuple."""
    return x[0], x[1], x[2], x[3], x[4], x[5]


@leaf
def fill(x, t):
    """x ← t."""
    x[0] = t[0]
    x[1] = t[1]
    x[2] = t[2]
    x[3] = t[3]
    x[4] = t[4]
    x[5] = t[5]


@leaf
def add(t, s, x):
    """t + s x, as a tuple.

    Args:
        t: six numbers. s: factor. x: six numbers.
    """
    return (
        t[0] + s * x[0],
        t[1] + s * x[1],
        t[2] + s * x[2],
        t[3] + s * x[3],
        t[4] + s * x[4],
        t[5] + s * x[5],
    )


@leaf
def plus(x, y):
    """x + y, as a tuple."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2], x[3] + y[3], x[4] + y[4], x[5] + y[5]


@leaf
def minus(x, y):
    """x − y, as a tuple."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2], x[3] - y[3], x[4] - y[4], x[5] - y[5]


@leaf
def scaled(s, x):
    """s x, as a tuple."""
    return s * x[0], s * x[1], s * x[2], s * x[3], s * x[4], s * x[5]


@leaf
def times6(A, x):
    """A x of a (6, 6) matrix, as a tuple."""
    return dot6(A[0], x), dot6(A[1], x), dot6(A[2], x), dot6(A[3], x), dot6(A[4], x), dot6(A[5], x)


@leaf
def reflector(square, head):
    """α and β of the reflection 1 − β v vᵀ that takes a vector x to α e: v = x − α e.

    Args:
        square: xᵀx > 0. head: the element of x that is left, eᵀx.
    """
    norm = sqrt(square)
    return -norm if head >= 0.0 else norm, 1.0 / (norm * (norm + abs(head)))


@inner
def qr6(X, rows, R, diagonal, beta):
    """Householder QR of the (6, rows) matrix whose *columns* are X[:rows, :6].

    The reflectors are left in the rows of X, the part of R beyond its diagonal in R[k, j], k < j.
    Returns False where a column depends on those before it to the last digit.

    Args:
        X: columns of the matrix, as rows of six. rows: how many. R: for the factor.
        diagonal, beta: (rows,) of R, and of the reflectors.
    """
    for k in range(rows):
        for i in range(k):
            R[i, k] = X[k, i]
            X[k, i] = 0.0
        square = dot6(X[k], X[k])
        if not square > 0.0:
            return False
        diagonal[k], beta[k] = reflector(square, X[k, k])
        X[k, k] -= diagonal[k]
        b = beta[k]
        v = six(X[k])
        for j in range(k + 1, rows):
            x = six(X[j])
            fill(X[j], add(x, -b * dot6(v, x), v))
    return True


@inner
def form_q6(V, rows, beta, Q):
    """The columns of H_1 … H_rows, as rows Q[:6, :6].

    Args:
        V, beta: reflectors and their factors, of `qr6`. rows: how many. Q: for the columns.
    """
    for c in range(6):
        for i in range(6):
            Q[c, i] = 0.0
        Q[c, c] = 1.0
        reflect_back(V, beta, min(c + 1, rows), Q[c])


@leaf
def reflect(V, beta, m, x):
    """x ← H_m … H_1 x (6,) with the reflectors in the rows of V.

    Args:
        V: reflectors. beta: (m,) their factors. m: how many. x: six numbers.
    """
    if m > 0:
        y = six(x)
        for k in range(m):
            y = add(y, -beta[k] * dot6(V[k], y), V[k])
        fill(x, y)


@leaf
def reflect_back(V, beta, m, x):
    """x ← H_1 … H_m x, the inverse of `reflect`.

    Args:
        V, beta, m, x: as of `reflect`.
    """
    if m > 0:
        y = six(x)
        for k in range(m - 1, -1, -1):
            y = add(y, -beta[k] * dot6(V[k], y), V[k])
        fill(x, y)


@inner
def reflect_sides(V, beta, m, A):
    """Symmetric A (6, 6) ← H A Hᵀ with H = H_m … H_1; both triangles are kept.

    (1 − β v vᵀ) A (1 − β v vᵀ) = A − v wᵀ − w vᵀ,  w = p − ½β(vᵀp) v,  p = β A v.

    Args:
        V, beta, m: as of `reflect`. A: (6, 6), overwritten.
    """
    for k in range(m):
        v = six(V[k])
        b = beta[k]
        p = scaled(b, times6(A, v))
        w = add(p, -0.5 * b * dot6(v, p), v)
        fill(A[0], add(add(six(A[0]), -v[0], w), -w[0], v))
        fill(A[1], add(add(six(A[1]), -v[1], w), -w[1], v))
        fill(A[2], add(add(six(A[2]), -v[2], w), -w[2], v))
        fill(A[3], add(add(six(A[3]), -v[3], w), -w[3], v))
        fill(A[4], add(add(six(A[4]), -v[4], w), -w[4], v))
        fill(A[5], add(add(six(A[5]), -v[5], w), -w[5], v))


@leaf
def mirror(A):
    """Copy what is below the diagonal of A (6, 6) above it."""
    for i in range(1, 6):
        for j in range(i):
            A[j, i] = A[i, j]


@leaf
def rotated(R, x, y, z):
    """R (x, y, z).

    Args:
        R: matrix, the rotation in its first rows and columns. x, y, z: of a vector.
    """
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@leaf
def rotated_back(R, x, y, z):
    """Rᵀ (x, y, z).

    Args:
        R, x, y, z: as of `rotated`.
    """
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@leaf
def velocity_at(V, x, y, z):
    """Of a point of a body.

    Args:
        V: (6,) twist of the body. x, y, z: of the point, from where V is at.
    """
    return (
        V[0] + (V[4] * z - V[5] * y),
        V[1] + (V[5] * x - V[3] * z),
        V[2] + (V[3] * y - V[4] * x),
    )


# --- Energy coordinates of the held object: its inertia is the identity there ---------------------
#
# `axes` (4, 3, 3) holds the four maps from world axes at C: √m Rᵀ and √I Rᵀ for motions, Rᵀ/√m
# and Rᵀ/√I for wrenches, R the principal axes of the object, I its principal moments there.


@inner
def set_axes(R, roots, axes):
    """Fill `axes` from R (3, 3) and roots = [√m, √I₁, √I₂, √I₃].

    Args:
        R: (3, 3) principal axes. roots: (4,). axes: of WORK.
    """
    for i in range(3):
        root = roots[1 + i]
        for j in range(3):
            r = R[j, i]
            axes[0, i, j] = roots[0] * r
            axes[1, i, j] = root * r
            axes[2, i, j] = r / roots[0]
            axes[3, i, j] = r / root


@leaf
def _apply(axes, k, x, first, out):
    """out[first : first + 3] = axes[k] x[first : first + 3]."""
    a = x[first]
    b = x[first + 1]
    c = x[first + 2]
    for i in range(3):  # x may be out
        out[first + i] = axes[k, i, 0] * a + axes[k, i, 1] * b + axes[k, i, 2] * c


@leaf
def energy_motion(axes, x, out):
    """x̃ = Lᵀx of a motion x (6,) at C.

    Args:
        axes: from `set_axes`. x: (6,) motion. out: (6,).
    """
    _apply(axes, 0, x, 0, out)
    _apply(axes, 1, x, 3, out)


@leaf
def energy_wrench(axes, f, out):
    """f̃ = L⁻¹f of a wrench f (6,) at C.

    Args:
        axes: from `set_axes`. f: (6,) wrench. out: (6,).
    """
    _apply(axes, 2, f, 0, out)
    _apply(axes, 3, f, 3, out)


@leaf
def _apply_transposed(axes, k, x, first, out):
    a = x[first]
    b = x[first + 1]
    c = x[first + 2]
    for i in range(3):
        out[first + i] = axes[k, 0, i] * a + axes[k, 1, i] * b + axes[k, 2, i] * c


@leaf
def world_motion(axes, x, out):
    """x = L⁻ᵀx̃ at C; out may be x.

    Args:
        axes: from `set_axes`. x: (6,) in energy coordinates. out: (6,).
    """
    _apply_transposed(axes, 2, x, 0, out)
    _apply_transposed(axes, 3, x, 3, out)


@leaf
def world_wrench(axes, f, out):
    """f = L f̃ at C; out may be f.

    Args:
        axes: from `set_axes`. f: (6,) in energy coordinates. out: (6,).
    """
    _apply_transposed(axes, 0, f, 0, out)
    _apply_transposed(axes, 1, f, 3, out)


@leaf
def carry_motion(V, start, end, out):
    """A motion carried from point to point, in place or not.

    Args:
        V: (6,) motion. start, end: (3,) points (m). out: (6,).
    """
    x, y, z = cross(V[3], V[4], V[5], end[0] - start[0], end[1] - start[1], end[2] - start[2])
    out[0] = V[0] + x
    out[1] = V[1] + y
    out[2] = V[2] + z
    out[3] = V[3]
    out[4] = V[4]
    out[5] = V[5]


@leaf
def carry_wrench(f, start, end, out):
    """A wrench carried from point to point, in place or not.

    Args:
        f: (6,) wrench. start, end: (3,) points (m). out: (6,).
    """
    x, y, z = cross(start[0] - end[0], start[1] - end[1], start[2] - end[2], f[0], f[1], f[2])
    out[3] = f[3] + x
    out[4] = f[4] + y
    out[5] = f[5] + z
    out[0] = f[0]
    out[1] = f[1]
    out[2] = f[2]


# --- From energy coordinates to world axes at O, as matrices --------------------------------------
#
# `work` is a WORK record after a tick, or after its first part. See `energy` for the coordinates;
# `chain` turns them so that the first axes are those that the arms lock.


def motions(work: Any) -> NDArray[np.float64]:
    """(6, 6) L⁻ᵀ, from energy coordinates to motions at O in world axes."""
    out = np.zeros((6, 6))
    axes = work["axes"]
    out[:3, :3] = axes[2].T
    out[3:, 3:] = axes[3].T
    out[:3, 3:] = _lever(work) @ axes[3].T
    return out


def wrenches(work: Any) -> NDArray[np.float64]:
    """(6, 6) L, from energy coordinates to wrenches at O in world axes."""
    out = np.zeros((6, 6))
    axes = work["axes"]
    out[:3, :3] = axes[0].T
    out[3:, 3:] = axes[1].T
    out[3:, :3] = _lever(work) @ axes[0].T
    return out


def reflection(work: Any) -> NDArray[np.float64]:
    """(6, 6) that turns energy coordinates so that the first axes are the locked ones."""
    reflection = np.eye(6)
    for k in range(int(work["locked"])):
        v = work["reflectors"][k].copy()
        v[:k] = 0.0
        reflection -= np.outer(work["beta"][k] * v, v @ reflection)
    return reflection


def _lever(work: Any) -> NDArray[np.float64]:
    """(3, 3) [C − O]×."""
    x, y, z = (work["C"] - work["O"]).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
