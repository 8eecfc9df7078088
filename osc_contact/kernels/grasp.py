"""Hinge and ball grasps: where the object is, what the grasps pass on, the wrists' filters.

Tables (k arms): GRASPS_I: rows m of N, kind, whether the wrist reading is filtered. GRASPS: tip in
its joint (0:12, rotation by rows, point), the m rows of N and 6 − m of T in the tip (12:48), point
and axis of the grasp in the object (48:51, 51:54), axis in the tip (54:57).
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

from osc_contact.kernels import layout as at
from osc_contact.kernels.compile import compiled, cube, integers, matrix, pose_in, vector
from osc_contact.kernels.linalg import cholesky, cholesky_solve, cross, dot6
from osc_contact.kernels.white import (
    motion_from_white,
    motion_to,
    set_axes,
    white_motion,
    white_wrench,
    wrench_to,
)

__all__ = ["add_filtered_outboard", "effort_passed", "filter_reading", "find_object", "slip"]

_TOLD = 1e-5  #: least share of a pivot at which the grasps tell the object's pose beyond doubt


@compiled
def _tip(pose, table, tip):
    """tip (4, 3): rotation by rows, then the point."""
    for i in range(3):
        tip[3, i] = pose[9 + i]
        for a in range(3):
            tip[3, i] += pose[3 * a + i] * table[9 + a]
            tip[i, a] = 0.0
            for b in range(3):
                tip[i, a] += pose[3 * b + i] * table[3 * b + a]


@compiled
def _rows(tip, table, m, C, axes, out):
    """N and T of a grasp in white coordinates at C, as the rows of out (6, 6)."""
    for a in range(6):
        row = out[a]
        for i in range(3):
            f = t = 0.0
            for j in range(3):
                f += tip[i, j] * table[12 + 6 * a + j]
                t += tip[i, j] * table[15 + 6 * a + j]
            row[i], row[3 + i] = f, t
        if a < m:
            wrench_to(row, tip[3], C, row)
            white_wrench(axes, row, row)
        else:
            motion_to(row, tip[3], C, row)
            white_motion(axes, row, row)


@compiled
def _orthonormalise(rows, first, last, r):
    """Rows [first, last) made orthonormal; r (…,), one number for each row, goes along."""
    for a in range(first, last):
        for _ in range(2):
            for b in range(first, a):
                s = dot6(rows[a], rows[b])
                r[a] -= s * r[b]
                for i in range(6):
                    rows[a, i] -= s * rows[b, i]
        norm = sqrt(dot6(rows[a], rows[a]))
        if not norm > 0.0:
            return False
        r[a] /= norm
        for i in range(6):
            rows[a, i] /= norm
    return True


@compiled
def _miss(kind, tip, table, X, out):
    """How far the object at X (4, 4) is from where the grasp can hold it, along N's rows."""
    for i in range(3):
        out[i] = 0.0
    for a in range(3):
        d = X[a, 3] - tip[3, a]
        for b in range(3):
            d += X[a, b] * table[48 + b]
        for i in range(3):
            out[i] += tip[a, i] * d
    if kind == at.BALL:
        return
    ux = uy = uz = 0.0  # the object's axis as the tip sees it
    for a in range(3):
        d = X[a, 0] * table[51] + X[a, 1] * table[52] + X[a, 2] * table[53]
        ux += tip[a, 0] * d
        uy += tip[a, 1] * d
        uz += tip[a, 2] * d
    ax, ay, az = table[54], table[55], table[56]
    x, y, z = cross(ax, ay, az, ux, uy, uz)
    s = sqrt(x * x + y * y + z * z)
    f = 1.0
    if s > 1e-12:
        f = atan2(s, ax * ux + ay * uy + az * uz) / s
    for b in range(3, 5):
        row = 15 + 6 * b
        out[b] = f * (table[row] * x + table[row + 1] * y + table[row + 2] * z)


@compiled
def _turn(X, wx, wy, wz):
    """The rotation in X (4, 4) turned by a vector (rad, world axes)."""
    angle = sqrt(wx * wx + wy * wy + wz * wz)
    a, b = 1.0, 0.5
    if angle > 1e-6:
        a, b = sin(angle) / angle, (1.0 - cos(angle)) / (angle * angle)
    for j in range(3):
        x, y, z = cross(wx, wy, wz, X[0, j], X[1, j], X[2, j])
        k, l, n = cross(wx, wy, wz, x, y, z)
        X[0, j] += a * x + b * k
        X[1, j] += a * y + b * l
        X[2, j] += a * z + b * n


@compiled
def _square_up(X):
    """The columns of the rotation in X made orthonormal again."""
    for j in range(2):
        for b in range(j):
            s = X[0, j] * X[0, b] + X[1, j] * X[1, b] + X[2, j] * X[2, b]
            for i in range(3):
                X[i, j] -= s * X[i, b]
        norm = sqrt(X[0, j] * X[0, j] + X[1, j] * X[1, j] + X[2, j] * X[2, j])
        for i in range(3):
            X[i, j] /= norm
    X[0, 2], X[1, 2], X[2, 2] = cross(X[0, 0], X[1, 0], X[2, 0], X[0, 1], X[1, 1], X[2, 1])


@compiled
def _centre(X, head, R, C, axes):
    """Centre of mass and principal axes of the object at X, and white coordinates there."""
    for i in range(3):
        C[i] = X[i, 3]
        for a in range(3):
            C[i] += X[i, a] * head[at.X_JP + 9 + a]
            R[i, a] = 0.0
            for b in range(3):
                R[i, a] += X[i, b] * head[at.X_JP + 3 * b + a]
    set_axes(R, head[at.ROOTS : at.ROOTS + 4], axes)


@compiled
def find_object(bound, sizes):
    """X_WO at which all grasps fit the tips, from where it was: `dynamics.held_object.locate`."""
    head, rows = vector(bound, at.HEAD), matrix(bound, at.ROWS)
    kinds, tables = integers(bound, at.GRASPS_I), matrix(bound, at.GRASPS)
    pose, arms, tips = matrix(bound, at.POSE), integers(bound, at.ARMS_I), cube(bound, at.TIPS)
    axes, passed = cube(bound, at.AXES), cube(bound, at.PASSED)
    A, L = cube(bound, at.SQUARES)[at.GRAM], cube(bound, at.SQUARES)[at.GRAM_L]
    signals = vector(bound, at.SIGNALS)
    X = pose_in(signals, at.X_WO)
    R, C, O = rows[at.R_0 : at.R_2 + 1], rows[at.CENTRE], rows[at.O]
    x, step, r = rows[at.X], rows[at.WORLD], rows[at.Y]
    for k in range(sizes[at.N_ARMS]):
        _tip(pose[arms[k, 2]], tables[k], tips[k])
    _square_up(X)
    size = 1.0
    for _ in range(30):
        _centre(X, head, R, C, axes)
        for i in range(6):
            x[i] = 0.0
            for j in range(6):
                A[i, j] = 0.0
        for k in range(sizes[at.N_ARMS]):
            m = kinds[k, 0]
            _miss(kinds[k, 1], tips[k], tables[k], X, r)
            _rows(tips[k], tables[k], m, C, axes, passed[k])
            if not _orthonormalise(passed[k], 0, m, r):
                return False
            for a in range(m):
                for i in range(6):
                    x[i] -= passed[k, a, i] * r[a]
                    for j in range(i + 1):
                        A[i, j] += passed[k, a, i] * passed[k, a, j]
        if not cholesky(A, 0, 6, L) > _TOLD:
            return False
        cholesky_solve(L, 6, x, 0)
        motion_from_white(axes, x, step)
        for i in range(3):
            O[i] = X[i, 3]
        motion_to(step, C, O, step)
        _turn(X, step[3], step[4], step[5])
        size = 0.0
        for i in range(6):
            size = max(size, abs(step[i]))
            if i < 3:
                X[i, 3] += step[i]
        if not size > 1e-15:
            break
    _centre(X, head, R, C, axes)
    for i in range(3):
        O[i] = X[i, 3]
    return size < 1e-13


@compiled
def slip(bound, sizes, v):
    """N and T of every grasp, white and orthonormal, and the object's twist at C (rows[V])."""
    rows, J = matrix(bound, at.ROWS), matrix(bound, at.J)
    kinds, tables = integers(bound, at.GRASPS_I), matrix(bound, at.GRASPS)
    pose, arms, tips = matrix(bound, at.POSE), integers(bound, at.ARMS_I), cube(bound, at.TIPS)
    axes, passed = cube(bound, at.AXES), cube(bound, at.PASSED)
    A, L = cube(bound, at.SQUARES)[at.GRAM], cube(bound, at.SQUARES)[at.GRAM_L]
    C, V, twist, x, r = rows[at.CENTRE], rows[at.V], rows[at.SCRATCH], rows[at.X], rows[at.Y]
    zero = rows[at.WORLD]
    for i in range(6):
        zero[i] = 0.0
        x[i] = 0.0
        for j in range(6):
            A[i, j] = 0.0
    lead = sizes[at.LEADER]
    for k in range(sizes[at.N_ARMS]):
        m = kinds[k, 0]
        for i in range(6):
            twist[i] = 0.0
            for j in range(arms[k, 0], arms[k, 1]):
                twist[i] += J[j, i] * v[j]
        motion_to(twist, zero, C, twist)
        if k == lead:
            for i in range(6):
                V[i] = twist[i]
        if m == 6:
            continue
        _tip(pose[arms[k, 2]], tables[k], tips[k])
        _rows(tips[k], tables[k], m, C, axes, passed[k])
        if not _orthonormalise(passed[k], 0, m, r):
            return False
        if not _orthonormalise(passed[k], m, 6, r):
            return False
        if lead < 0:
            white_motion(axes, twist, twist)
            for a in range(m):
                along = dot6(passed[k, a], twist)
                for i in range(6):
                    x[i] += passed[k, a, i] * along
                    for j in range(i + 1):
                        A[i, j] += passed[k, a, i] * passed[k, a, j]
    if lead < 0:
        if not cholesky(A, 0, 6, L) > _TOLD:
            return False
        cholesky_solve(L, 6, x, 0)
        motion_from_white(axes, x, V)
    return True


@compiled
def effort_passed(lo, n, J, joints, N, m, A, L, X, out):
    """(6, 6) Nᵀ(NJ τ_max⁻² JᵀNᵀ)⁻¹N of an arm with more joints than its grasp has rows."""
    for a in range(m):
        for b in range(a + 1):
            A[a, b] = 0.0
    for j in range(lo, lo + n):
        for a in range(m):
            X[0, a] = dot6(N[a], J[j])
            for b in range(a + 1):
                A[a, b] += joints[j, 21] * X[0, a] * X[0, b]
    if not cholesky(A, 0, m, L) > 1e-12:
        return False
    for i in range(6):
        for a in range(m):
            X[0, a] = N[a, i]
        cholesky_solve(L, m, X[0], 0)
        for j in range(6):
            s = 0.0
            for a in range(m):
                s += N[a, j] * X[0, a]
            out[j, i] = s
    return True


@compiled
def add_filtered_outboard(lo, hi, axes, bar, J, outboard, gamma, own, N, m, squares, F, out):
    """Λ_out (transposed, squares[OUT_T]) and bias of a gripper that can move without the object.

    F = 1 − EEᵀTᵀ(T EEᵀTᵀ)⁻¹T, the rows of T from m on in N; E = P(1 − J̄J) is what the joints'
    motion without the object puts into the reading (`dynamics.outboard.grasp_filter`).

    Args:
        outboard: (n, 6) P, at C.
        own: (6,) wrench of the outboard bodies at q̈ = 0, at C. out: (6,) bias, white, added to.
    """
    work, G, L = squares[at.WORK], squares[at.GRAM], squares[at.GRAM_L]
    for a in range(6):
        for b in range(6):
            work[a, b] = 0.0
            G[a, b] = 0.0
    white_wrench(axes, own, own)
    for j in range(lo, hi):
        white_wrench(axes, outboard[j], outboard[j])
        s = dot6(bar[j], gamma)
        for a in range(6):
            own[a] -= s * outboard[j, a]
            for b in range(6):
                work[a, b] += outboard[j, a] * bar[j, b]
    for j in range(lo, hi):
        for a in range(6):
            F[0, a] = outboard[j, a] - dot6(work[a], J[j])
        for a in range(6):
            for b in range(a + 1):
                G[a, b] += F[0, a] * F[0, b]
                G[b, a] = G[a, b]
    count = 6 - m
    TG, S = squares[at.MORE], squares[at.LEAST]
    for a in range(count):
        for i in range(6):
            TG[a, i] = dot6(G[i], N[m + a])
        for b in range(a + 1):
            S[a, b] = dot6(TG[a], N[m + b])
    if not cholesky(S, 0, count, L) > 1e-10:
        return False
    for i in range(6):  # column i of F
        for a in range(count):
            S[5, a] = N[m + a, i]
        cholesky_solve(L, count, S[5], 0)
        for b in range(6):
            s = 1.0 if b == i else 0.0
            for a in range(count):
                s -= TG[a, b] * S[5, a]
            F[b, i] = s
    for a in range(6):
        out[a] += dot6(F[a], own)
        for b in range(6):
            s = 0.0
            for c in range(6):
                s += F[a, c] * work[c, b]
            squares[at.OUT_T, b, a] += s
    return True


@compiled
def filter_reading(axes, F, reading, white):
    """reading (6,) at C ← F reading, F white."""
    white_wrench(axes, reading, white)
    for i in range(3):
        reading[i] = reading[3 + i] = 0.0
    for a in range(6):
        s = dot6(F[a], white)
        half = 0 if a < 3 else 3
        for i in range(3):  # f = L f̃
            reading[half + i] += axes[0 if a < 3 else 1, a - half, i] * s
