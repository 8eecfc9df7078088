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
ZERO_3 = (0.0, 0.0, 0.0)


@leaf
def join(a, b):
    """The elements of two tuples, one behind the other: (*a, *b). Sums have names of their own."""
    return a + b


@leaf
def clamped(x, most):
    """x within ±most."""
    return min(max(x, -most), most)


@leaf
def cross(a, b):
    """a × b of 3-vectors."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@leaf
def dot3(a, b):
    """aᵀb of 3-vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf
def add3(y, s, x):
    """y + s x, as a tuple.

    Args:
        y, x: (3,). s: factor.
    """
    return (y[0] + s * x[0], y[1] + s * x[1], y[2] + s * x[2])


@leaf
def plus3(x, y):
    """x + y of 3-vectors, as a tuple."""
    return (x[0] + y[0], x[1] + y[1], x[2] + y[2])


@leaf
def minus3(x, y):
    """x − y of 3-vectors, as a tuple."""
    return (x[0] - y[0], x[1] - y[1], x[2] - y[2])


@leaf
def scaled3(s, x):
    """s x of a 3-vector, as a tuple."""
    return (s * x[0], s * x[1], s * x[2])


@leaf
def divided3(x, s):
    """x / s of a 3-vector, as a tuple."""
    return (x[0] / s, x[1] / s, x[2] / s)


@leaf
def linear(x):
    """The first three of six, as a tuple."""
    return (x[0], x[1], x[2])


@leaf
def angular(x):
    """The last three of six, as a tuple."""
    return (x[3], x[4], x[5])


@leaf
def axis3(k):
    """The unit vector along axis k, as a tuple."""
    return (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)


@leaf
def fill3(x, t):
    """x ← t, 3-vectors."""
    x[0] = t[0]
    x[1] = t[1]
    x[2] = t[2]


@leaf
def dot6(a, b):
    """aᵀb of 6-vectors."""
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])


@leaf
def six(x):
    """A row as a tuple."""
    return (x[0], x[1], x[2], x[3], x[4], x[5])


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
    return join(add3(t, s, x), add3(angular(t), s, angular(x)))


@leaf
def accumulate(x, s, y):
    """x ← x + s y.

    Args:
        x, y: (6,). s: factor.
    """
    fill(x, add(x, s, y))


@leaf
def add_square(s, x, A):
    """A ← A + s x xᵀ.

    Args:
        s: factor. x: (6,). A: (6, 6), overwritten.
    """
    for i in range(6):
        accumulate(A[i], s * x[i], x)


@leaf
def combined(s, X, n):
    """Σ s_k X_k of n rows of six, as a tuple.

    Args:
        s: (n,) factors. X: rows. n: how many of them count.
    """
    x = ZERO
    for k in range(n):
        x = add(x, s[k], X[k])
    return x


@leaf
def set_identity(A):
    """A ← 1."""
    A[:] = 0.0
    for i in range(len(A)):
        A[i, i] = 1.0


@leaf
def plus(x, y):
    """x + y, as a tuple."""
    return join(plus3(x, y), plus3(angular(x), angular(y)))


@leaf
def minus(x, y):
    """x − y, as a tuple."""
    return join(minus3(x, y), minus3(angular(x), angular(y)))


@leaf
def scaled(s, x):
    """s x, as a tuple."""
    return join(scaled3(s, x), scaled3(s, angular(x)))


@leaf
def times6(A, x):
    """A x of a (6, 6) matrix, as a tuple."""
    upper = (dot6(A[0], x), dot6(A[1], x), dot6(A[2], x))
    return join(upper, (dot6(A[3], x), dot6(A[4], x), dot6(A[5], x)))


@leaf
def reflector(square, head):
    """α and β of the reflection 1 − β v vᵀ that takes a vector x to α e: v = x − α e.

    Args:
        square: xᵀx > 0. head: the element of x that is left, eᵀx.
    """
    norm = sqrt(square)
    return (-norm if head >= 0.0 else norm, 1.0 / (norm * (norm + abs(head))))


@leaf
def finiteness(x, n):
    """0, or NaN where one of x[:n] is not finite."""
    s = 0.0
    for i in range(n):
        s += 0.0 * x[i]
    return s


@leaf
def copy_rows(X, out):
    """out ← the first rows of X, as many and as long as there are in out.

    Args:
        X: rows. out: (rows, length), overwritten.
    """
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = X[i, j]


@inner
def reflect_sides(work, A):
    """Symmetric A (6, 6) ← H A Hᵀ, H as in `turned`; both triangles are kept.

    (1 − β v vᵀ) A (1 − β v vᵀ) = A − v wᵀ − w vᵀ,  w = p − ½β(vᵀp) v,  p = β A v.
    """
    for k in range(work.locked):
        v = six(work.reflectors[k])
        b = work.beta[k]
        p = scaled(b, times6(A, v))
        w = add(p, -0.5 * b * dot6(v, p), v)
        for i in range(6):
            fill(A[i], add(add(A[i], -v[i], w), -w[i], v))


@leaf
def row3(R, i):
    """The first three of row i, as a tuple."""
    return (R[i, 0], R[i, 1], R[i, 2])


@leaf
def column3(R, i):
    """The first three of column i, as a tuple."""
    return (R[0, i], R[1, i], R[2, i])


@leaf
def rotated(R, x):
    """R x, as a tuple; the rotation stands in the first rows and columns of R."""
    return (dot3(row3(R, 0), x), dot3(row3(R, 1), x), dot3(row3(R, 2), x))


@leaf
def rotated_back(R, x):
    """Rᵀ x, as a tuple."""
    return (dot3(column3(R, 0), x), dot3(column3(R, 1), x), dot3(column3(R, 2), x))


@leaf
def rotated9(R, x):
    """R x of a rotation (≥ 9,) by rows, as a tuple."""
    return (dot3(R, x), dot3(R[3:], x), dot3(R[6:], x))


@leaf
def rotated9_back(R, x):
    """Rᵀ x of a rotation (≥ 9,) by rows, as a tuple."""
    return add3(add3(scaled3(x[0], R), x[1], R[3:]), x[2], R[6:])


@leaf
def origin(X):
    """The point of a pose X (≥ 3, 4), as a tuple."""
    return column3(X, 3)


@leaf
def transformed(p, R, x):
    """p + R x, as a tuple.

    Args:
        p, x: (3,). R: (3, 3).
    """
    sum_xy = add3(add3(p, x[0], column3(R, 0)), x[1], column3(R, 1))
    return add3(sum_xy, x[2], column3(R, 2))


@leaf
def velocity_at(V, p):
    """Velocity of the point p (3,) of a body with twist V (6,), p from the point of V; a tuple."""
    return plus3(V, cross(V[3:], p))


@leaf
def cross_motion(V, x):
    """V × x: the rate of a motion x that a body of twist V carries."""
    return join(plus3(cross(V[3:], x), cross(V, x[3:])), cross(V[3:], x[3:]))


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
def energy_motion(axes, x):
    """x̃ = Lᵀx of a motion x (6,) at C, as a tuple; `axes` from `set_axes`."""
    return join(rotated(axes[0], x), rotated(axes[1], x[3:]))


@leaf
def energy_wrench(axes, f):
    """f̃ = L⁻¹f of a wrench f (6,) at C."""
    return join(rotated(axes[2], f), rotated(axes[3], f[3:]))


@leaf
def world_motion(axes, x):
    """x = L⁻ᵀx̃ at C."""
    return join(rotated_back(axes[2], x), rotated_back(axes[3], x[3:]))


@leaf
def world_wrench(axes, f):
    """f = L f̃ at C."""
    return join(rotated_back(axes[0], f), rotated_back(axes[1], f[3:]))


@leaf
def carry_motion(V, start, end):
    """A motion V (6,) carried from point to point (m), as a tuple.

    Args:
        V: (6,) at start. start, end: points (m).
    """
    return join(velocity_at(V, minus3(end, start)), angular(V))


@leaf
def carry_wrench(f, start, end):
    """A wrench f (6,) carried from point to point (m), as a tuple.

    Args:
        f: (6,) at start. start, end: points (m).
    """
    return join(linear(f), plus3(f[3:], cross(minus3(start, end), f)))


@leaf
def motion_to_energy(work, x):
    """A motion at O in world axes, in energy coordinates."""
    return energy_motion(work.axes, carry_motion(x, work.p_O, work.p_C))


@leaf
def wrench_to_energy(work, f):
    """A wrench at O in world axes, in energy coordinates."""
    return energy_wrench(work.axes, carry_wrench(f, work.p_O, work.p_C))


@leaf
def motion_to_world(work, x):
    """A motion in energy coordinates, at O in world axes."""
    return carry_motion(world_motion(work.axes, x), work.p_C, work.p_O)


@leaf
def wrench_to_world(work, f):
    """A wrench in energy coordinates, at O in world axes."""
    return carry_wrench(world_wrench(work.axes, f), work.p_C, work.p_O)


@leaf
def turned(work, x):
    """x (6,) turned so that the first m energy axes are those that the arms lock, as a tuple.

    H x with H = H_m … H_1, the reflectors.
    """
    y = six(x)
    for k in range(work.locked):
        v = work.reflectors[k]
        y = add(y, -work.beta[k] * dot6(v, y), v)
    return y


@leaf
def fill_free(x, work, y):
    """x ← y turned, as far as the arms do not lock it.

    Args:
        x: (6,) is written. work: WORK. y: (6,) energy coordinates.
    """
    fill(x, turned(work, y))
    for i in range(work.locked):
        x[i] = 0.0


@leaf
def turned_back(work, x):
    """The inverse of `turned`."""
    y = six(x)
    for k in range(work.locked - 1, -1, -1):
        v = work.reflectors[k]
        y = add(y, -work.beta[k] * dot6(v, y), v)
    return y


# --- From energy coordinates to world axes at O, as matrices --------------------------------------
#
# `work` is a WORK record after a tick, or after its first part. See above for the coordinates;
# `chain` turns them so that the first axes are those that the arms lock.


def motions(work: Any) -> NDArray[np.float64]:
    """(6, 6) L⁻ᵀ, from energy coordinates to motions at O in world axes."""
    out = _blocks(work, 2)
    out[:3, 3:] = _lever(work) @ out[3:, 3:]
    return out


def wrenches(work: Any) -> NDArray[np.float64]:
    """(6, 6) L, from energy coordinates to wrenches at O in world axes."""
    out = _blocks(work, 0)
    out[3:, :3] = _lever(work) @ out[:3, :3]
    return out


def _blocks(work: Any, k: int) -> NDArray[np.float64]:
    out = np.zeros((6, 6))
    out[:3, :3] = work["axes"][k].T
    out[3:, 3:] = work["axes"][k + 1].T
    return out


def reflection(work: Any) -> NDArray[np.float64]:
    """(6, 6) that turns energy coordinates so that the first axes are the locked ones."""
    reflection = np.eye(6)
    for k in range(int(work["locked"])):
        v = work["reflectors"][k]
        reflection -= np.outer(work["beta"][k] * v, v @ reflection)
    return reflection


def _lever(work: Any) -> NDArray[np.float64]:
    """(3, 3) [C − O]×."""
    x, y, z = (work["p_C"] - work["p_O"]).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
