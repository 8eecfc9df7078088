"""Grasps that permit motions: what they transmit, and where the object is that they hold."""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, one_sided_jacobi
from osc_contact.law.arm_motion import place_frame
from osc_contact.law.commands import rotation_vector
from osc_contact.law.jit import inner
from osc_contact.law.records import BALL, HINGE
from osc_contact.law.vectors import (
    ZERO,
    add,
    carry_motion,
    carry_wrench,
    cross,
    dot6,
    energy_motion,
    energy_wrench,
    fill,
    set_axes,
    world_motion,
    world_wrench,
)

# --- Grasps that permit motions: what they transmit, how the object slips, wrist filters ----------

KNOWN = 1e-6  #: least share of a pivot at which the grasps fix the object beyond doubt
_MOVES = 1e-7  #: of the outboard links' wrench, below which their own motion is none


@inner
def grasp_rows(arm, work, C, axes, out):
    """N and T of a grasp in energy coordinates, the rows of out (6, 6); the tip stands in `tip`.

    Args:
        arm: ARM row. work: its ARM_WORK. C: (3,) centre of mass (m). axes: from `energy.set_axes`.
        out: (6, 6), the rows of N first.
    """
    tip = work.tip
    for a in range(6):
        row = out[a]
        for i in range(3):
            f = t = 0.0
            for j in range(3):
                f += tip[i, j] * arm.grasp[a, j]
                t += tip[i, j] * arm.grasp[a, 3 + j]
            row[i] = f
            row[3 + i] = t
        if a < arm.m:
            carry_wrench(row, tip[3], C, row)
            energy_wrench(axes, row, row)
        else:
            carry_motion(row, tip[3], C, row)
            energy_motion(axes, row, row)


@inner
def orthonormalise_with(rows, first, last, r):
    """Rows [first, last) made orthonormal; r (…,), one number for each row, goes along.

    Args:
        rows: overwritten. first, last: of them. r: numbers that go along, overwritten.
    """
    for a in range(first, last):
        for _ in range(2):
            for b in range(first, a):
                s = dot6(rows[a], rows[b])
                r[a] -= s * r[b]
                fill(rows[a], add(rows[a], -s, rows[b]))
        norm = sqrt(dot6(rows[a], rows[a]))
        if not norm > 0.0:
            return False
        r[a] /= norm
        for i in range(6):
            rows[a, i] /= norm
    return True


@inner
def find_twist(t, given):
    """N and T of every grasp, orthonormal, and the object's twist at C (V_C); False: not fixed.

    With a leader the object moves with its tip; with none it is what all the grasps leave. Where it
    is given V_C stays as it is.

    Args:
        given: whether the twist is given.
    """
    model = t.model
    work = t.work
    arm_work = t.work.arms
    A = work.A
    L = work.B
    x = work.x
    r = work.y
    twist = work.w
    for i in range(6):
        x[i] = 0.0
        fill(A[i], ZERO)
    for k in range(model.n_arms):
        arm = model.arms[k]
        own = arm_work[k]
        if arm.m == 6:
            continue
        place_frame(t.work.joints[arm.tip_joint], arm.tip, own.tip, own.tip[3])
        grasp_rows(arm, own, work.C, work.axes, own.passed)
        if not orthonormalise_with(own.passed, 0, arm.m, r):
            return False
        if not orthonormalise_with(own.passed, arm.m, 6, r):
            return False
        if model.leader < 0 and not given:
            energy_motion(work.axes, own.V, twist)
            for a in range(arm.m):
                along = dot6(own.passed[a], twist)
                for i in range(6):
                    x[i] += own.passed[a, i] * along
                    for j in range(i + 1):
                        A[i, j] += own.passed[a, i] * own.passed[a, j]
    if given:
        return True
    if model.leader >= 0:
        fill(work.V_C, arm_work[model.leader].V)
        return True
    if not cholesky(A, 0, 6, L) > KNOWN:
        return False
    cholesky_solve(L, 6, x, 0)
    world_motion(work.axes, x, work.V_C)
    return True


@inner
def add_slip(V, V_C, gamma):
    """γ += V × V_C: the tip carries the wrenches of the grasp while the object slips in it.

    Args:
        V: (6,) twist of the tip. V_C: (6,) of the object. gamma: (6,) drift, overwritten.
    """
    x, y, z = cross(V[3], V[4], V[5], V_C[0], V_C[1], V_C[2])
    i, j, l = cross(V[0], V[1], V[2], V_C[3], V_C[4], V_C[5])
    gamma[0], gamma[1], gamma[2] = gamma[0] + x + i, gamma[1] + y + j, gamma[2] + z + l
    x, y, z = cross(V[3], V[4], V[5], V_C[3], V_C[4], V_C[5])
    gamma[3], gamma[4], gamma[5] = gamma[3] + x, gamma[4] + y, gamma[5] + z


@inner
def filter_outboard(t, arm, own, bias):
    """Λ_out (transposed) and bias of a gripper that can move without the object.

    F = 1 − E(T E)⁺T, E = P(1 − J̄J) what the joints' motion without the object puts into the
    reading, takes that out of it (`dynamics.outboard.grasp_filter`).

    Args:
        arm, own: its records; filter (6, 6) of `own` is filled. bias: (6,) wrench of
        the outboard bodies at q̈ = 0, at C.
    """
    joints = t.work.joints
    work = t.work
    H = work.A
    E = work.B
    F = own.filter
    N = own.passed
    m = arm.m
    lo = arm.first
    n = arm.end - arm.first
    count = 6 - arm.m
    X = work.X
    G = work.Z
    for a in range(6):
        fill(H[a], ZERO)
    energy_wrench(work.axes, bias, bias)
    for j in range(lo, lo + n):
        P = joints[j].outboard
        bar = joints[j].J_bar
        energy_wrench(work.axes, P, P)
        s = dot6(bar, own.gamma)
        for a in range(6):
            bias[a] -= s * P[a]
            fill(H[a], add(H[a], P[a], bar))
    largest = 0.0
    for j in range(n):
        P = joints[lo + j].outboard
        J = joints[lo + j].J
        for a in range(6):
            G[j, a] = P[a] - dot6(H[a], J)
            largest = max(largest, abs(P[a]))
    for a in range(count):
        for j in range(n):
            s = 0.0
            for i in range(6):
                s += N[m + a, i] * G[j, i]
            X[a, j] = s
        for b in range(count):
            X[a, n + b] = 1.0 if a == b else 0.0
    one_sided_jacobi(X, count, n, count)
    for a in range(6):
        for b in range(6):
            F[a, b] = 1.0 if a == b else 0.0
    for k in range(count):
        square = 0.0
        for j in range(n):
            square += X[k, j] * X[k, j]
        if not sqrt(square) > _MOVES * largest:
            continue
        for a in range(6):
            s = 0.0
            for j in range(n):
                s += G[j, a] * X[k, j]
            E[0, a] = s / square
            E[1, a] = 0.0
            for b in range(count):
                E[1, a] += X[k, n + b] * N[m + b, a]
        for a in range(6):
            fill(F[a], add(F[a], -E[0, a], E[1]))
    for a in range(6):
        work.bias_e[a] += dot6(F[a], bias)
        for b in range(6):
            s = 0.0
            for c in range(6):
                s += F[a, c] * H[c, b]
            work.out_T[b, a] += s


@inner
def filter_reading(axes, F, reading, energy):
    """reading (6,) at C ← F reading; energy: (6,) scratch.

    Args:
        axes: from `energy.set_axes`. F: (6, 6) of the grasp. reading: (6,), overwritten.
        energy: (6,) scratch.
    """
    energy_wrench(axes, reading, energy)
    for a in range(6):
        reading[a] = dot6(F[a], energy)
    world_wrench(axes, reading, reading)


# --- Pose of an object that no arm holds rigidly: the one that fits all grasps --------------------


@inner
def rotate(X, wx, wy, wz):
    """The rotation in X (≥ 3, ≥ 3) rotated further by a vector (rad, world axes).

    Args:
        X: rotation or pose, overwritten. wx, wy, wz: of the vector (rad).
    """
    angle = sqrt(wx * wx + wy * wy + wz * wz)
    a = 1.0
    b = 0.5
    if angle > 1e-6:
        a = sin(angle) / angle
        b = (1.0 - cos(angle)) / (angle * angle)
    for j in range(3):
        x, y, z = cross(wx, wy, wz, X[0, j], X[1, j], X[2, j])
        k, l, n = cross(wx, wy, wz, x, y, z)
        X[0, j] += a * x + b * k
        X[1, j] += a * y + b * l
        X[2, j] += a * z + b * n


@inner
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


@inner
def _miss(arm, tip, X, out):
    """How far the object at X (4, 4) is from where a hinge or a ball holds it, along N's rows."""
    for i in range(3):
        out[i] = 0.0
    for a in range(3):
        d = X[a, 3] - tip[3, a]
        for b in range(3):
            d += X[a, b] * arm.point[b]
        for i in range(3):
            out[i] += tip[a, i] * d
    if arm.kind == BALL:
        return
    ux = uy = uz = 0.0  # the object's axis as the tip sees it
    for a in range(3):
        d = X[a, 0] * arm.axis[0] + X[a, 1] * arm.axis[1] + X[a, 2] * arm.axis[2]
        ux += tip[a, 0] * d
        uy += tip[a, 1] * d
        uz += tip[a, 2] * d
    ax = arm.tip_axis[0]
    ay = arm.tip_axis[1]
    az = arm.tip_axis[2]
    x, y, z = cross(ax, ay, az, ux, uy, uz)
    s = sqrt(x * x + y * y + z * z)
    f = 1.0
    if s > 1e-12:
        f = atan2(s, ax * ux + ay * uy + az * uz) / s
    for b in range(3, 5):
        n = arm.grasp[b]
        out[b] = f * (n[3] * x + n[4] * y + n[5] * z)


@inner
def _miss_of_group(arm, tip, X, A, B, p, out):
    """The same for any other group of motions T: the permitted part is taken off step by step.

    `arm.grasp[m:]` are T's rows, orthonormal in the tip's own units, which only say what is tried
    first: where the grasp fits, nothing is left whatever the units.

    Args:
        A, B: (6, 6) scratch. p: (6,) scratch. out: (6,) filled along N's rows.
    """
    R = A
    m = arm.m
    for i in range(3):  # the object's grasp frame in the tip: A rotation, p point
        for j in range(3):
            s = 0.0
            for a in range(3):
                s += tip[a, i] * X[a, j]
            B[i, j] = s
        s = 0.0
        for a in range(3):
            s += tip[a, i] * (X[a, 3] - tip[3, a])
        p[i] = s
    for i in range(3):
        for j in range(3):
            R[i, j] = 0.0
            for a in range(3):
                R[i, j] += B[i, a] * arm.X_TO[3 * j + a]  # R X_TOᵀ
    for i in range(3):
        for a in range(3):
            p[i] -= R[i, a] * arm.X_TO[9 + a]
    for _ in range(30):
        rotation_vector(R, out)
        _remaining(p, out, B)
        size = 0.0
        fill(B[1], ZERO)
        for a in range(m, 6):
            s = 0.0
            for i in range(6):
                s += arm.grasp[a, i] * B[0, i]
            fill(B[1], add(B[1], s, arm.grasp[a]))
            size = max(size, abs(s))
        if size < 1e-14:
            break
        _take_off(R, p, B)
    rotation_vector(R, out)
    _remaining(p, out, B)
    for a in range(m):
        s = 0.0
        for i in range(6):
            s += arm.grasp[a, i] * B[0, i]
        out[a] = s


@inner
def _remaining(p, w, B):
    """B[0] = log of a motion (rotation vector w (3,), point p), a twist about the tip's origin."""
    wx = w[0]
    wy = w[1]
    wz = w[2]
    square = wx * wx + wy * wy + wz * wz
    c = 1.0 / 12.0 + square / 720.0
    if square > 1e-4:
        angle = sqrt(square)
        c = (1.0 - 0.5 * angle * sin(angle) / (1.0 - cos(angle))) / square
    x, y, z = cross(wx, wy, wz, p[0], p[1], p[2])
    k, l, n = cross(wx, wy, wz, x, y, z)
    B[0, 0] = p[0] - 0.5 * x + c * k
    B[0, 1] = p[1] - 0.5 * y + c * l
    B[0, 2] = p[2] - 0.5 * z + c * n
    B[0, 3] = wx
    B[0, 4] = wy
    B[0, 5] = wz


@inner
def _take_off(R, p, B):
    """(R, p) ← (R, p) exp(−twist), the twist in B[1]."""
    vx = -B[1, 0]
    vy = -B[1, 1]
    vz = -B[1, 2]
    wx = -B[1, 3]
    wy = -B[1, 4]
    wz = -B[1, 5]
    square = wx * wx + wy * wy + wz * wz
    b = 0.5 - square / 24.0
    c = 1.0 / 6.0 - square / 120.0
    if square > 1e-4:
        angle = sqrt(square)
        b = (1.0 - cos(angle)) / square
        c = (angle - sin(angle)) / (angle * square)
    x, y, z = cross(wx, wy, wz, vx, vy, vz)
    k, l, n = cross(wx, wy, wz, x, y, z)
    tx = vx + b * x + c * k
    ty = vy + b * y + c * l
    tz = vz + b * z + c * n
    for i in range(3):
        p[i] += R[i, 0] * tx + R[i, 1] * ty + R[i, 2] * tz
    x = R[0, 0] * wx + R[0, 1] * wy + R[0, 2] * wz
    y = R[1, 0] * wx + R[1, 1] * wy + R[1, 2] * wz
    z = R[2, 0] * wx + R[2, 1] * wy + R[2, 2] * wz
    rotate(R, x, y, z)  # R exp[w] = exp[R w] R


@inner
def centre_object(t, X):
    """Centre of mass C, principal axes and energy coordinates of the object at X.

    Args:
        X: (4, 4) pose of the object.
    """
    model = t.model
    work = t.work
    for i in range(3):
        work.C[i] = X[i, 3]
        work.O[i] = X[i, 3]
        for a in range(3):
            work.C[i] += X[i, a] * model.X_LP[9 + a]
            work.R[i, a] = 0.0
            for b in range(3):
                work.R[i, a] += X[i, b] * model.X_LP[3 * b + a]
    set_axes(work.R, model.roots, work.axes)


@inner
def find_object(t, X):
    """X (4, 4) at which all grasps fit the tips, from where it was: Gauss–Newton in the energy.

    Returns False where the grasps do not fix it.

    Args:
        X: (4, 4) pose of the object, overwritten.
    """
    arms = t.model.arms
    work = t.work
    arm_work = t.work.arms
    A = work.A
    L = work.B
    x = work.x
    step = work.w
    r = work.y
    for k in range(t.model.n_arms):
        own = arm_work[k]
        place_frame(t.work.joints[arms[k].tip_joint], arms[k].tip, own.tip, own.tip[3])
    _square_up(X)
    size = 1.0
    for _ in range(50):
        centre_object(t, X)
        for i in range(6):
            x[i] = 0.0
            fill(A[i], ZERO)
        for k in range(t.model.n_arms):
            arm = arms[k]
            own = arm_work[k]
            if arm.kind == BALL or arm.kind == HINGE:
                _miss(arm, own.tip, X, r)
            else:
                _miss_of_group(arm, own.tip, X, work.D, work.E, work.z, r)
            grasp_rows(arm, own, work.C, work.axes, own.passed)
            if not orthonormalise_with(own.passed, 0, arm.m, r):
                return False
            for a in range(arm.m):
                for i in range(6):
                    x[i] -= own.passed[a, i] * r[a]
                    for j in range(i + 1):
                        A[i, j] += own.passed[a, i] * own.passed[a, j]
        if not cholesky(A, 0, 6, L) > KNOWN:
            return False
        cholesky_solve(L, 6, x, 0)
        world_motion(work.axes, x, step)
        carry_motion(step, work.C, work.O, step)
        rotate(X, step[3], step[4], step[5])
        size = 0.0
        for i in range(6):
            size = max(size, abs(step[i]))
            if i < 3:
                X[i, 3] += step[i]
        if not size > 1e-15:
            break
    centre_object(t, X)
    return size < 1e-12
