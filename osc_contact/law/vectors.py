"""Vectors of three and six numbers as tuples; energy coordinates of the held object."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from osc_contact.law.jit import inner, leaf
from osc_contact.law.nested import View

# --- Vectors of three and six numbers as tuples, which a compiler keeps in registers --------------
#
# The operational space has six dimensions, so most matrices of the law are rows of six numbers.
# Functions return tuples and accept tuples or arrays.

ZERO = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ZERO_3 = (0.0, 0.0, 0.0)


@leaf
def join(a, b):
    """Concatenate two tuples: (*a, *b). Sums of vectors are `plus`, `plus3`, `add` and `add3`."""
    return a + b


@leaf
def clamped(x, most):
    """Clamp a number x to the range −most … most.

    Args:
        x: number.
        most: bound, ≥ 0.
    """
    return min(max(x, -most), most)


@leaf
def cross(a, b):
    """Cross product a × b of vectors of three numbers."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@leaf
def dot3(a, b):
    """Inner product aᵀb of vectors of three numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf
def add3(y, s, x):
    """Sum y + s x of vectors of three numbers.

    Args:
        y, x: (3,).
        s: factor.
    """
    return (y[0] + s * x[0], y[1] + s * x[1], y[2] + s * x[2])


@leaf
def plus3(x, y):
    """Sum x + y of vectors of three numbers."""
    return (x[0] + y[0], x[1] + y[1], x[2] + y[2])


@leaf
def minus3(x, y):
    """Difference x − y of vectors of three numbers."""
    return (x[0] - y[0], x[1] - y[1], x[2] - y[2])


@leaf
def scaled3(s, x):
    """Product s x of a factor and a vector of three numbers."""
    return (s * x[0], s * x[1], s * x[2])


@leaf
def divided3(x, s):
    """Quotient x / s of a vector of three numbers and a number."""
    return (x[0] / s, x[1] / s, x[2] / s)


@leaf
def linear(x):
    """Return the linear part of a motion or wrench: its first three numbers.

    Args:
        x: (6,), or at least its first three numbers.
    """
    return (x[0], x[1], x[2])


@leaf
def angular(x):
    """Return the angular part of a motion or wrench: its last three numbers.

    Args:
        x: (6,).
    """
    return (x[3], x[4], x[5])


@leaf
def axis3(k):
    """Unit vector (three numbers) along axis k = 0, 1, 2."""
    return (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)


@leaf
def fill3(x, y):
    """Copy three numbers y to the front of an array x."""
    x[0] = y[0]
    x[1] = y[1]
    x[2] = y[2]


@leaf
def dot6(a, b):
    """Inner product aᵀb of vectors of six numbers."""
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])


@leaf
def six(x):
    """Copy the first six elements of an array to a tuple."""
    return (x[0], x[1], x[2], x[3], x[4], x[5])


@leaf
def fill(x, y):
    """Copy six numbers y to the front of an array x."""
    x[0] = y[0]
    x[1] = y[1]
    x[2] = y[2]
    x[3] = y[3]
    x[4] = y[4]
    x[5] = y[5]


@leaf
def add(y, s, x):
    """Sum y + s x of vectors of six numbers.

    Args:
        y, x: (6,).
        s: factor.
    """
    return join(add3(y, s, x), add3(angular(y), s, angular(x)))


@leaf
def accumulate(x, s, y):
    """Add s y to an array x of six numbers.

    Args:
        x: (6,), changed.
        s: factor.
        y: (6,).
    """
    fill(x, add(x, s, y))


@leaf
def add_square(s, x, A):
    """Add s x xᵀ to a matrix A.

    Args:
        s: factor.
        x: (6,).
        A: (6, 6), changed.
    """
    for i in range(6):
        accumulate(A[i], s * x[i], x)


@leaf
def combined(s, X, n):
    """Linear combination Σ s_k X_k of n rows of six numbers.

    Args:
        s: (n,) factors.
        X: (n, 6).
        n: number of rows.
    """
    x = ZERO
    for k in range(n):
        x = add(x, s[k], X[k])
    return x


@leaf
def set_identity(A):
    """Fill a square matrix A with the identity."""
    A[:] = 0.0
    for i in range(len(A)):
        A[i, i] = 1.0


@leaf
def unpack_pose(packed, X):
    """Fill the upper 3×4 part of a pose X (4, 4) from its elements by rows.

    Args:
        packed: numbers that begin with the 16 of the pose, such as a row of `touched` of INPUT.
        X: (4, 4), whose last row is already [0 0 0 1].
    """
    for i in range(3):
        for j in range(4):
            X[i, j] = packed[4 * i + j]


@leaf
def plus(x, y):
    """Sum x + y of vectors of six numbers."""
    return join(plus3(x, y), plus3(angular(x), angular(y)))


@leaf
def minus(x, y):
    """Difference x − y of vectors of six numbers."""
    return join(minus3(x, y), minus3(angular(x), angular(y)))


@leaf
def scaled(s, x):
    """Product s x of a factor and a vector of six numbers."""
    return join(scaled3(s, x), scaled3(s, angular(x)))


@leaf
def times6(A, x):
    """Product A x (six numbers) of a (6, 6) matrix and a vector."""
    upper = (dot6(A[0], x), dot6(A[1], x), dot6(A[2], x))
    return join(upper, (dot6(A[3], x), dot6(A[4], x), dot6(A[5], x)))


@leaf
def reflector(square, head):
    """Return α and β of the reflection 1 − β v vᵀ that maps a vector x to α e, v = x − α e.

    Args:
        square: xᵀx > 0.
        head: eᵀx, the component of x along the unit vector e.
    """
    norm = sqrt(square)
    return (-norm if head >= 0.0 else norm, 1.0 / (norm * (norm + abs(head))))


@leaf
def finiteness(x, n):
    """Return 0 if all of x[:n] are finite, else NaN, since 0 · x is NaN for infinity and NaN.

    Args:
        x: array of numbers.
        n: number of elements that are checked.
    """
    s = 0.0
    for i in range(n):
        s += 0.0 * x[i]
    return s


@leaf
def copy_rows(X, out):
    """Copy the upper left block of X to `out`, which determines the size of the block."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = X[i, j]


@inner
def reflect_sides(work, A):
    """Transform a symmetric matrix A to H A Hᵀ, with the reflections H of `turned`.

    Both triangles are filled. Each reflector 1 − β v vᵀ in H, with a vector v (6,), changes A to (1
    − β v vᵀ) A (1 − β v vᵀ) = A − v wᵀ − w vᵀ, w = p − ½β(vᵀp) v, p = β A v.

    Args:
        work: WORK, of which `locked`, `reflectors` and `beta` are read.
        A: (6, 6) in energy coordinates, overwritten.
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
    """Return the first three numbers of row i of a matrix.

    Args:
        R: at least (i + 1, 3), such as a rotation matrix or a pose.
        i: index of the row.
    """
    return (R[i, 0], R[i, 1], R[i, 2])


@leaf
def column3(R, i):
    """Return the first three numbers of column i of a matrix.

    Args:
        R: at least (3, i + 1), such as a rotation matrix or a pose.
        i: index of the column.
    """
    return (R[0, i], R[1, i], R[2, i])


@leaf
def rotated(R, x):
    """Product R x of a rotation and a vector; the first 3×3 block of R is the rotation matrix."""
    return (dot3(row3(R, 0), x), dot3(row3(R, 1), x), dot3(row3(R, 2), x))


@leaf
def rotated_back(R, x):
    """Product Rᵀ x with the inverse rotation; the first 3×3 block of R is the rotation matrix."""
    return (dot3(column3(R, 0), x), dot3(column3(R, 1), x), dot3(column3(R, 2), x))


@leaf
def rotated9(R, x):
    """Product R x of a rotation, given by rows as nine numbers, and a vector.

    Args:
        R: array with the nine elements at its front.
        x: (3,).
    """
    return (dot3(R, x), dot3(R[3:], x), dot3(R[6:], x))


@leaf
def rotated9_back(R, x):
    """Product Rᵀ x with the inverse of a rotation that is given by rows as nine numbers.

    Args:
        R: array with the nine elements at its front.
        x: (3,).
    """
    return add3(add3(scaled3(x[0], R), x[1], R[3:]), x[2], R[6:])


@leaf
def origin(X):
    """Origin (three numbers) of a pose X (4, 4)."""
    return column3(X, 3)


@leaf
def transformed(p, R, x):
    """Position p + R x of a point that is given in a frame.

    Args:
        p: (3,) origin of the frame.
        R: (3, 3) its axes.
        x: (3,) point in the frame.
    """
    sum_xy = add3(add3(p, x[0], column3(R, 0)), x[1], column3(R, 1))
    return add3(sum_xy, x[2], column3(R, 2))


@leaf
def velocity_at(V, p):
    """Velocity (three numbers) of a point of a body, V_linear + ω × p.

    Args:
        V: (6,) twist of the body at a reference point.
        p: (3,) point from the reference point (m).
    """
    return plus3(V, cross(V[3:], p))


@leaf
def cross_motion(V, x):
    """Spatial cross product V × x (six numbers): rate of a motion vector x that moves with a body.

    Args:
        V: (6,) twist of the body.
        x: (6,) motion vector that is constant in its axes; both at one point.
    """
    return join(plus3(cross(V[3:], x), cross(V, x[3:])), cross(V[3:], x[3:]))


# --- Energy coordinates of the held object, in which its inertia is the identity ------------------
#
# `axes` (4, 3, 3) contains the four maps from world axes at C: √m Rᵀ and √I Rᵀ for motions, Rᵀ/√m
# and Rᵀ/√I for wrenches, where R are the principal axes of the object and I its principal moments.


@inner
def set_axes(R, roots, axes):
    """Fill the four maps between world axes at C and energy coordinates.

    axes[0] = √m Rᵀ and axes[1] = √I Rᵀ convert the linear and angular part of a motion; axes[2] =
    Rᵀ/√m and axes[3] = Rᵀ/√I convert force and moment of a wrench.

    Args:
        R: (3, 3) principal axes of the object in the world, as columns.
        roots: (4,) √m (√kg) and √I₁, √I₂, √I₃ of the principal moments (m √kg).
        axes: (4, 3, 3), filled.
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
    """Convert a motion x (6,) at C in world axes to energy coordinates, x̃ = Lᵀx."""
    return join(rotated(axes[0], x), rotated(axes[1], x[3:]))


@leaf
def energy_wrench(axes, f):
    """Convert a wrench f (6,) at C in world axes to energy coordinates, f̃ = L⁻¹f."""
    return join(rotated(axes[2], f), rotated(axes[3], f[3:]))


@leaf
def world_motion(axes, x):
    """Convert a motion x̃ (6,) in energy coordinates to world axes at C, x = L⁻ᵀx̃."""
    return join(rotated_back(axes[2], x), rotated_back(axes[3], x[3:]))


@leaf
def world_wrench(axes, f):
    """Convert a wrench f̃ (6,) in energy coordinates to world axes at C, f = L f̃."""
    return join(rotated_back(axes[0], f), rotated_back(axes[1], f[3:]))


@leaf
def carry_motion(V, start, end):
    """Change the reference point of a motion V (6,), a twist or an acceleration.

    Args:
        V: (6,) at `start`.
        start, end: old and new reference point (m).
    """
    return join(velocity_at(V, minus3(end, start)), angular(V))


@leaf
def carry_wrench(f, start, end):
    """Change the reference point of a wrench f (6,).

    Args:
        f: (6,) at `start`.
        start, end: old and new reference point (m).
    """
    return join(linear(f), plus3(f[3:], cross(minus3(start, end), f)))


@leaf
def motion_to_energy(work, x):
    """Convert a motion at O in world axes to energy coordinates.

    Args:
        work: WORK, of which `axes`, `p_O` and `p_C` are read.
        x: (6,) motion.

    Returns:
        Six numbers.
    """
    return energy_motion(work.axes, carry_motion(x, work.p_O, work.p_C))


@leaf
def wrench_to_energy(work, f):
    """Convert a wrench at O in world axes to energy coordinates.

    Args:
        work: WORK, of which `axes`, `p_O` and `p_C` are read.
        f: (6,) wrench (N, N m).

    Returns:
        Six numbers.
    """
    return energy_wrench(work.axes, carry_wrench(f, work.p_O, work.p_C))


@leaf
def motion_to_world(work, x):
    """Convert a motion in energy coordinates to world axes at O.

    Args:
        work: WORK, of which `axes`, `p_O` and `p_C` are read.
        x: (6,) motion.

    Returns:
        Six numbers.
    """
    return carry_motion(world_motion(work.axes, x), work.p_C, work.p_O)


@leaf
def wrench_to_world(work, f):
    """Convert a wrench in energy coordinates to world axes at O.

    Args:
        work: WORK, of which `axes`, `p_O` and `p_C` are read.
        f: (6,) wrench.

    Returns:
        Six numbers (N, N m).
    """
    return carry_wrench(world_wrench(work.axes, f), work.p_C, work.p_O)


@leaf
def turned(work, x):
    """Turn energy coordinates so that their first m axes are those that the arms lock: return H x.

    H = H_m … H_1 (6, 6) is the product of the reflectors H_k = 1 − β_k v_k v_kᵀ.

    Args:
        work: WORK, of which `locked` (m), `reflectors` (v_k) and `beta` are read.
        x: (6,) motion or wrench in energy coordinates.

    Returns:
        Six numbers.
    """
    y = six(x)
    for k in range(work.locked):
        v = work.reflectors[k]
        y = add(y, -work.beta[k] * dot6(v, y), v)
    return y


@leaf
def fill_free(x, work, y):
    """Fill x with y in turned energy coordinates, with zeros along the locked axes.

    Args:
        x: (6,), filled.
        work: WORK, of which `locked`, `reflectors` and `beta` are read.
        y: (6,) motion or wrench in energy coordinates.
    """
    fill(x, turned(work, y))
    for i in range(work.locked):
        x[i] = 0.0


@leaf
def turned_back(work, x):
    """Convert turned coordinates back to energy coordinates: return Hᵀx, the inverse of `turned`.

    Each reflector is its own inverse, so they are applied in the opposite order.

    Args:
        work: WORK, of which `locked`, `reflectors` and `beta` are read.
        x: (6,) motion or wrench.

    Returns:
        Six numbers.
    """
    y = six(x)
    for k in range(work.locked - 1, -1, -1):
        v = work.reflectors[k]
        y = add(y, -work.beta[k] * dot6(v, y), v)
    return y


# --- Maps from energy coordinates to world axes at O, as matrices, for use outside of a tick ------
#
# `work` is a WORK record after a tick, or after its first part.

# Index in `axes` of the first of two maps, whose transposes are those from energy coordinates:
_WRENCH_MAPS = 0  # √m R and R√I: the maps of motions, transposed, are those of wrenches
_MOTION_MAPS = 2  # R/√m and R/√I


def motions(work: View) -> NDArray[np.float64]:
    """Matrix L⁻ᵀ (6, 6) that maps motions in energy coordinates to motions at O in world axes.

    Args:
        work: WORK after the first part of a tick.
    """
    out = _blocks(work, _MOTION_MAPS)
    # The velocity of O is that of C plus r × ω, r from O to C.
    out[:3, 3:] = _lever(work) @ out[3:, 3:]
    return out


def wrenches(work: View) -> NDArray[np.float64]:
    """Matrix L (6, 6) that maps wrenches in energy coordinates to wrenches at O in world axes.

    Args:
        work: WORK after the first part of a tick.
    """
    out = _blocks(work, _WRENCH_MAPS)
    # A force at C has the moment r × f about O, r from O to C.
    out[3:, :3] = _lever(work) @ out[:3, :3]
    return out


def _blocks(work: View, k: int) -> NDArray[np.float64]:
    """Block-diagonal matrix (6, 6) of two transposed maps of `axes`: linear, then angular part.

    Args:
        work: WORK after the first part of a tick.
        k: index of the first of both maps in `axes`: `_WRENCH_MAPS` or `_MOTION_MAPS`.
    """
    out = np.zeros((6, 6))
    out[:3, :3] = work["axes"][k].T
    out[3:, 3:] = work["axes"][k + 1].T
    return out


def reflection(work: View) -> NDArray[np.float64]:
    """Orthogonal matrix H (6, 6) that turns energy coordinates to locked axes first (`turned`).

    Args:
        work: WORK after the first part of a tick.
    """
    reflection = np.eye(6)
    for k in range(int(work["locked"])):
        v = work["reflectors"][k]
        reflection -= np.outer(work["beta"][k] * v, v @ reflection)
    return reflection


def _lever(work: View) -> NDArray[np.float64]:
    """Cross-product matrix (3, 3) of the vector from O to C, r: [r×] y = r × y (m).

    Args:
        work: WORK after the first part of a tick.
    """
    x, y, z = (work["p_C"] - work["p_O"]).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
