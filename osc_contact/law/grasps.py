"""Grasps that permit motions: what they pass on, how the object slips, the wrists' filters."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, cross, one_sided_jacobi
from osc_contact.law.arm_motion import place_frame
from osc_contact.law.energy import (
    carry_motion,
    carry_wrench,
    energy_motion,
    energy_wrench,
    world_motion,
    world_wrench,
)
from osc_contact.law.jit import inner
from osc_contact.law.six import ZERO, add, dot6, fill

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
