"""Detection of a new contact while others are closed: force that their friction cannot explain.

While contacts are closed, an approach to another one pushes against their static friction, and the
wrists measure this reaction. With n one of the approached columns, the reading

    f_meas − bias_out − Λ_out a = N α + Σ T_jβ_j + noise,   |β_j| ≤ μ_b α_j over the closed contacts

is weighted by the inverse of R = Σ(μ_b α_j)² T_jT_jᵀ + noise: α_n = gᵀf, where gᵀ is the row n of
(NᵀR⁻¹N)⁻¹NᵀR⁻¹. Friction changes α_n by at most e = μ_b Σα_j‖gᵀT_j‖. If the lines of action do not
meet, g is nearly orthogonal to the friction forces and e is small; if they meet, e is μ_b times the
force of the closed contact. Contact is made when α_n − e, low-passed, exceeds `force_on`.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, gram, lu_solve
from osc_contact.law.jit import inner, local
from osc_contact.law.phases import APPROACHING, CLOSED
from osc_contact.law.reading import desired_inertia_force
from osc_contact.law.records import body_of, contact_of
from osc_contact.law.tangents import across, has_point, push_on, rub_along
from osc_contact.law.vectors import (
    ZERO,
    add_square,
    combined,
    dot6,
    fill,
    minus,
    scaled3,
    wrench_to_energy,
)

_FORCE_NOISE = 0.2  #: N, of the wrists
_COUPLE_NOISE = 0.01  #: N m


@inner
def witness_contacts(t):
    """Compute the measured force of each approached column, and the part friction may explain.

    Reads `alpha_meas`, `reading_e`, `N`, `pushed`, and the fields that `desired_inertia_force` and
    `push_on` read. Fills `touch` (α_n) and `explained` (e) of the active columns (N). Both are 0
    unless one contact is approached while another one is closed and all columns are independent.
    """
    work = t.work
    approached = False
    closed = False
    for i in range(work.count):
        phase = contact_of(t, work.chosen[i]).phase
        approached = approached or phase == APPROACHING
        closed = closed or phase == CLOSED
        work.columns[work.chosen[i]].touch = 0.0
        work.columns[work.chosen[i]].explained = 0.0
    if approached and closed and work.rank == work.count and t.model.friction_bound > 0.0:
        _explain(t)


@inner
def _explain(t):
    """Fill `touch` and `explained` (N) of approached columns while other contacts are closed.

    `touch` is α_n = gᵀf, where f is the reading less bias and inertial force, and gᵀ the row of
    (NᵀR⁻¹N)⁻¹NᵀR⁻¹ for the column; `explained` is the bound μ_b Σα_j‖gᵀT_j‖ of the contribution by
    friction of the closed contacts. R is the covariance of friction and sensor noise.
    """
    work = t.work
    r = work.rank
    R = local(6, 6)
    factor = local(6, 6)
    H = local(6, 6)
    weighed = local(6, 6)
    normal = local(6, 6)
    solved = local(1, 6)
    rest = local(6)
    g = local(6)
    fill(rest, minus(work.reading_e, desired_inertia_force(t)))
    for i in range(6):
        fill(R[i], ZERO)
    for k in range(6):
        size = _FORCE_NOISE if k < 3 else _COUPLE_NOISE
        fill(g, ZERO)
        g[k] = size
        add_square(1.0, wrench_to_energy(work, g), R)
    for a in range(r):
        column = work.chosen[a]
        if contact_of(t, column).phase == CLOSED:
            most = t.model.friction_bound * _pressed(t, a)
            for k in range(_ways(t, column)):
                add_square(1.0, _friction(t, column, k, most), R)
    if not cholesky(R, 0, 6, factor) > 0.0:
        return
    for a in range(r):
        fill(H[a], work.pushed[a])
        fill(weighed[a], H[a])
        cholesky_solve(factor, 6, weighed[a])
    gram(H, r, weighed, r, normal)
    for a in range(r):
        column = work.chosen[a]
        if contact_of(t, column).phase != APPROACHING:
            continue
        for b in range(r):
            solved[0, b] = 1.0 if a == b else 0.0
            for c in range(r):
                H[b, c] = normal[b, c]
        if not lu_solve(H, r, solved, 1):
            return
        fill(g, combined(solved[0], weighed, r))
        own = work.columns[column]
        own.touch = dot6(g, rest)
        for b in range(r):
            other = work.chosen[b]
            if contact_of(t, other).phase == CLOSED:
                most = t.model.friction_bound * _pressed(t, b)
                square = 0.0
                for k in range(_ways(t, other)):
                    part = dot6(g, _friction(t, other, k, most))
                    square += part * part
                own.explained += sqrt(square)


@inner
def _ways(t, column):
    """Number of directions in which friction of a contact may act."""
    if has_point(t, column):
        return 3
    return t.model.pairs[t.model.columns[column].contact].freedoms


@inner
def _friction(t, column, k, most):
    """Reading (six numbers, energy coordinates) of a friction force at a contact.

    Args:
        t: Tick. column: column of N of the contact. k: axis of the world, along whose projection
            on the face the force acts; of a pair without points of contact, number of its freedom.
        most: magnitude of the force before projection (N).
    """
    if has_point(t, column):
        return push_on(t, scaled3(most, across(t.work.columns[column].N, k)), column)
    return rub_along(t, most, k, t.model.columns[column].contact)


@inner
def _pressed(t, a):
    """Magnitude (N) of the force of kept column a; 0 of a pair that can only push and reads < 0."""
    alpha = t.work.alpha_meas[a]
    return max(alpha, 0.0) if body_of(t, t.work.chosen[a]).pushes else abs(alpha)
