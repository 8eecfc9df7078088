"""Motions that an arm is about to lose near a singular posture; commands along them are reduced.

An arm is measured against Λ_ref, the object and, at its centre of mass, a ball as heavy as the
heaviest arm. With Λ_ref = LLᵀ and M = KKᵀ

    LᵀJK⁻ᵀ = U diag(χ) Vᵀ

is free of units, and 1/χ² is the arm's apparent inertia in the direction u beside that of Λ_ref.
In energy coordinates Λ_ref is diagonal.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import (
    cholesky,
    one_sided_jacobi,
    orthonormalise,
    project_onto_constraint,
)
from osc_contact.law.arm_terms import factor_inertia
from osc_contact.law.jit import inner, leaf
from osc_contact.law.six import fill, reflect, reflect_back

#: Commands are reduced where χ is below FULL and are zero at NONE_LEFT.
NONE_LEFT, FULL = 0.05, 0.3
_HARD = 1e-8  # shares below it are as good as 0
_GONE = 1e-6  # of the mobility that Λ_ref has along any direction, 1
_SMALL = 1e-9  # χ below it tells no motion of the joints


@leaf
def may_be_singular(t, arm, own):
    """Whether some χ may be below FULL: a bound that never misses one.

    ΣΣ Λ_ij²/(Λ_ii Λ_jj)_ref ≥ 1/χ⁴, in energy coordinates.

    Args:
        arm: ARM row. own: its ARM_WORK.
    """
    if own.n_kept < arm.full_rank:
        return True
    s = 0.0
    for i in range(6):
        row = 0.0
        for j in range(6):
            row += own.Lambda[i, j] * own.Lambda[i, j] * t.model.lightness[j]
        s += row * t.model.lightness[i]
    return s * FULL * FULL * FULL * FULL >= 1.0


@inner
def find_lost(t, arm, own):
    """Every direction of an arm whose χ is below FULL: its χ, share, wrench and joint motion.

    Fills n_lost, chi, share, gone, lost (6, 6) wrenches Lu, mode (6, n) joint motions K⁻ᵀv.

    Args:
        arm: ARM row. own: its ARM_WORK.
    """
    joints = t.work.joints
    work = t.work
    lo = arm.first
    n = arm.end - arm.first
    m = arm.m
    X = work.X
    Z = work.Z
    K = work.K
    root = work.u
    if not factor_inertia(lo, n, joints, K):
        return
    for i in range(6):
        root[i] = sqrt(t.model.reference[i])
    for j in range(n):  # Z = K⁻¹Jᵀ
        for i in range(6):
            s = joints[lo + j].J[i]
            for k in range(j):
                s -= K[j, k] * Z[k, i]
            Z[j, i] = s * K[j, j]
    if m == 6:  # all wrenches: the axes themselves are orthonormal
        for a in range(6):
            for j in range(n):
                X[a, j] = root[a] * Z[j, a]
            for i in range(6):
                X[a, n + i] = 1.0 if i == a else 0.0
    else:
        _passed_rows(t, own, Z, root, m, n)
    one_sided_jacobi(X, m, n, 6)
    _sort_rows(X, m, n)
    for k in range(arm.full_rank):
        square = 0.0
        for j in range(n):
            square += X[k, j] * X[k, j]
        chi = sqrt(square)
        _unit_row(X, k, n, chi)
        if chi >= FULL:
            continue
        at = own.n_lost
        own.chi[at], own.share[at] = chi, _share_left(chi)
        own.gone[at] = 1.0 if k >= own.n_kept else 0.0
        for i in range(6):
            own.lost[at, i] = root[i] * X[k, n + i]
        mode = own.mode[at]
        for j in range(n - 1, -1, -1):
            s = X[k, j]
            for l in range(j + 1, n):
                s -= K[l, j] * mode[l]
            mode[j] = s * K[j, j]
        own.n_lost += 1
        work.n_lost += 1


@inner
def _passed_rows(t, own, Z, root, m, n):
    """Rows of X for the wrenches that a grasp passes on, orthonormal in Λ_ref."""
    work = t.work
    X = work.X
    for a in range(m):
        for i in range(6):
            work.A[a, i] = own.passed[a, i] / root[i]
    orthonormalise(work.A, m, 0, work.B, work.D)
    for a in range(m):
        for j in range(n):
            s = 0.0
            for i in range(6):
                s += work.B[a, i] * root[i] * Z[j, i]
            X[a, j] = s
        for i in range(6):
            X[a, n + i] = work.B[a, i]


@inner
def _sort_rows(X, m, n):
    """Rows by falling length of their first n elements."""
    for a in range(m):
        best = a
        longest = -1.0
        for b in range(a, m):
            square = 0.0
            for j in range(n):
                square += X[b, j] * X[b, j]
            if square > longest:
                best = b
                longest = square
        if best != a:
            for j in range(n + 6):
                X[a, j], X[best, j] = X[best, j], X[a, j]


@inner
def _unit_row(X, k, n, chi):
    """Row k made a unit vector v; where it is too short to tell, any that is new to the others."""
    if chi > _SMALL:
        for j in range(n):
            X[k, j] /= chi
        return
    best = 0
    largest = -1.0
    for e in range(n):  # the unit vector that sticks out most
        left = 1.0
        for b in range(k):
            left -= X[b, e] * X[b, e]
        if left > largest:
            best = e
            largest = left
    for j in range(n):
        X[k, j] = 1.0 if j == best else 0.0
    for _ in range(2):
        for b in range(k):
            s = 0.0
            for j in range(n):
                s += X[b, j] * X[k, j]
            for j in range(n):
                X[k, j] -= s * X[b, j]
    s = 0.0
    for j in range(n):
        s += X[k, j] * X[k, j]
    for j in range(n):
        X[k, j] /= sqrt(s)


@inner
def _share_left(chi):
    """1 at χ ≥ FULL, 0 at χ ≤ NONE_LEFT, 3s² − 2s³ between."""
    s = min(max((chi - NONE_LEFT) / (FULL - NONE_LEFT), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@inner
def retreat(t, joint, q, v):
    """q̈ = −k_r q̇ + k_p (q₀ − q) of a joint whose motion a singular posture takes from the task.

    Args:
        joint: JOINT row. q, v: its position (m, rad) and speed.
    """
    return t.model.posture_stiffness * (joint.posture - q) - t.model.retreat_damping * v


@inner
def reduce_motion(t, r):
    """The motion command with the arms' lost directions left to their posture task.

    What an arm's joints must do along a lost direction u is (uᵀ(a − γ))/χ: it grows without bound
    while it does ever less. Share φ of it is kept; the rest is replaced by the posture's own
    acceleration there, with the least change Δ of the command in Λ_o that the contacts permit:

        min ΔᵀΔ + Σ (1 − φ)/φ (uᵀΔ − t)²/|u|²,   NΔ = 0,   t = χ vᵀKᵀq̈_posture − uᵀ(a − γ)

    Args:
        r: columns of N.
    """
    arms = t.model.arms
    work = t.work
    m = work.locked
    x = work.x
    H = work.A
    L = work.B
    step = work.y
    a = work.u
    row = work.w
    for i in range(6):
        a[i] = x[i]
        step[i] = 0.0
        for j in range(6):
            H[i, j] = 1.0 if i == j else 0.0
    reflect_back(work.reflectors, work.beta, m, a)
    for k in range(t.model.n_arms):
        own = t.work.arms[k]
        lo = arms[k].first
        hi = arms[k].end
        for e in range(own.n_lost):
            mode = own.mode[e]
            target = 0.0
            for i in range(lo, hi):
                s = 0.0
                for j in range(lo, hi):
                    s += t.work.joints[i].M[j - lo] * retreat(
                        t, t.model.joints[j], t.input.q[j], t.input.v[j]
                    )
                target += mode[i - lo] * s
            target *= own.chi[e]
            for i in range(6):
                target -= own.lost[e, i] * (a[i] - own.gamma[i])
                row[i] = own.lost[e, i]
            reflect(work.reflectors, work.beta, m, row)
            size = 0.0
            for i in range(m, 6):
                size += row[i] * row[i]
            if own.gone[e] != 0.0 or size < _GONE:  # no motion of the chain's any more
                continue
            weight = (1.0 - own.share[e]) / (max(own.share[e], _HARD) * size)
            for i in range(m, 6):
                step[i] += weight * target * row[i]
                for j in range(m, 6):
                    H[i, j] += weight * row[i] * row[j]
    # in coordinates K⁻ᵀ… where H is the identity: y = K⁻¹ step, N K⁻ᵀ
    d = 6 - m
    cholesky(H, m, d, L)
    _forward(L, d, step, m)
    for b in range(r):
        fill(work.D[b], work.N_t[b])
        _forward(L, d, work.D[b], m)
        work.s[b] = 0.0
    orthonormalise(work.D, r, m, work.E, work.A)
    project_onto_constraint(work.E, r, step, work.s)
    for i in range(d - 1, -1, -1):
        s = step[m + i]
        for k in range(i + 1, d):
            s -= L[k, i] * step[m + k]
        step[m + i] = s * L[i, i]
    for i in range(m, 6):
        x[i] += step[i]


@inner
def _forward(L, d, x, m):
    """x[m:] ← L⁻¹x[m:], L from `cholesky`."""
    for i in range(d):
        s = x[m + i]
        for k in range(i):
            s -= L[i, k] * x[m + k]
        x[m + i] = s * L[i, i]
