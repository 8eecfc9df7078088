"""Motions that an arm is about to lose near a singular posture.

The reference inertia Λ_ref is that of the object and of a ball at its centre of mass that is as
heavy as the heaviest arm. With Λ_ref = LLᵀ and M = KKᵀ

    LᵀJK⁻ᵀ = U diag(χ) Vᵀ

is dimensionless, and 1/χ² is the apparent inertia of the arm in the direction u relative to Λ_ref.
In energy coordinates Λ_ref is diagonal.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import add_scaled, backward, dot, one_sided_jacobi, orthonormalise
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.operational import multiply_rows, weigh_joints
from osc_contact.law.records import JOINTS_AND_SIX, MAX_JOINTS

NONE_LEFT = 0.05  #: χ up to which a command is zero
FULL = 0.3  #: χ from which on a command is not reduced
_LEAST_CHI = 1e-9  #: χ below which a direction does not determine a motion of the joints


@leaf
def may_be_singular(t, arm, arm_work):
    """Test whether an arm may be near a singular posture, by a conservative bound.

    χ is the distance of a direction from its singular posture. For the least one, Σ_ij
    Λ_ij²/(Λ_ref,ii Λ_ref,jj) ≥ 1/χ⁴ in energy coordinates, where the reference inertia Λ_ref is
    diagonal.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.

    Returns:
        False if no χ of the arm is below `FULL`.
    """
    if arm_work.n_kept < arm.full_rank:
        return True
    s = 0.0
    for i in range(6):
        row = 0.0
        for j in range(6):
            row += arm_work.Lambda[i, j] * arm_work.Lambda[i, j] * t.model.lightness[j]
        s += row * t.model.lightness[i]
    return s * FULL * FULL * FULL * FULL >= 1.0


@inner
def find_lost(t, arm, arm_work):
    """Find all directions of an arm along which it is about to lose its motion.

    With Λ_ref = LLᵀ the reference inertia, M = KKᵀ and the Jacobian J (6, n), LᵀJK⁻ᵀ = U diag(χ)
    Vᵀ; a direction u with χ below `FULL` is about to be lost. Reads `passed`, `n_kept`, and J and M
    of the joints. Fills `n_lost` of the arm and, for each direction, `chi` (χ, dimensionless),
    `share` (the share of the command that is executed), `gone` (1 if the chain counts the direction
    as locked), `lost` (its wrench Lu) and `mode` (its joint motion K⁻ᵀv); adds to `n_lost` of WORK.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
    """
    work = t.work
    n = arm.end - arm.first
    m = arm.m
    K = local(MAX_JOINTS, MAX_JOINTS)
    weighed = local(MAX_JOINTS, 6)
    wrenches = local(6, 6)  # wrenches that the grasp transmits, weighted by Λ_ref
    factor = local(6, 6)
    root = local(6)
    X = local(6, JOINTS_AND_SIX)
    if not weigh_joints(work.joints, arm.first, n, K, weighed):
        return
    # J and the wrenches of the grasp, scaled by L (diagonal), then LᵀJK⁻ᵀ along these wrenches
    for i in range(6):
        root[i] = sqrt(t.model.reference[i])
        for a in range(m):
            wrenches[a, i] = arm_work.passed[a, i] / root[i]
        for j in range(n):
            weighed[j, i] *= root[i]
    orthonormalise(wrenches, m, 0, wrenches, factor)
    multiply_rows(wrenches, m, weighed, n, X)
    one_sided_jacobi(X, m, n, 6)
    _sort_rows(X, m, n)
    # the singular values χ, of which those below `FULL` are noted
    for k in range(arm.full_rank):
        chi = sqrt(dot(X[k], X[k], n))
        _unit_row(X, k, n, chi)  # vᵀ, behind it uᵀ times the wrenches
        if chi >= FULL:
            continue
        at = arm_work.n_lost
        arm_work.chi[at] = chi
        s = max((chi - NONE_LEFT) / (FULL - NONE_LEFT), 0.0)  # 0 … 1, shaped by a smooth step
        arm_work.share[at] = s * s * (3.0 - 2.0 * s)  # 0 at χ ≤ NONE_LEFT, 1 at FULL
        arm_work.gone[at] = k >= arm_work.n_kept
        for i in range(6):
            arm_work.lost[at, i] = root[i] * X[k, n + i]
        for j in range(n):
            arm_work.mode[at, j] = X[k, j]
        backward(K, n, arm_work.mode[at])
        arm_work.n_lost += 1
        work.n_lost += 1


@inner
def _sort_rows(X, m, n):
    """Sort the rows of a matrix by descending norm of their first n elements.

    Args:
        X: (m, n + 6), whose rows are exchanged as a whole.
        m: number of rows.
        n: number of leading elements of a row whose norm counts.
    """
    for a in range(m):
        selected = a
        largest_square = -1.0
        for b in range(a, m):
            square = dot(X[b], X[b], n)
            if square > largest_square:
                selected = b
                largest_square = square
        if selected != a:
            for j in range(n + 6):
                X[a, j], X[selected, j] = X[selected, j], X[a, j]


@inner
def _unit_row(X, k, n, chi):
    """Normalise the row X[k, :n]; replace a zero row by a unit vector orthogonal to those before.

    Args:
        X: matrix.
        k: index of the row.
        n: number of elements that are normalised.
        chi: norm of these elements.
    """
    norm = chi
    if not chi > _LEAST_CHI:  # also if NaN
        axis = 0
        largest = -1.0
        for e in range(n):  # axis with the largest part outside the span of the former rows
            remainder = 1.0
            for b in range(k):
                remainder -= X[b, e] * X[b, e]
            if remainder > largest:
                axis = e
                largest = remainder
        for j in range(n):
            X[k, j] = 1.0 if j == axis else 0.0
        for _ in range(2):  # twice: the first pass leaves rounding errors
            for b in range(k):
                add_scaled(-dot(X[b], X[k], n), X[b], n, X[k])
        norm = sqrt(dot(X[k], X[k], n))
    for j in range(n):
        X[k, j] /= norm
