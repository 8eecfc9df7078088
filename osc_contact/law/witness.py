"""Contact made, beside others: what the friction of contacts that are closed cannot explain.

While contacts are closed, an approach to another one pushes on their stiction, and the wrists read
what holds it. With n one of the approached columns, the reading

    f_meas − bias_out − Λ_out a = N α + Σ T_jβ_j + noise,   |β_j| ≤ μ_b α_j over the closed contacts

is weighed by R = Σ(μ_b α_j)² T_jT_jᵀ + noise: α_n = gᵀf, g the row of (NᵀR⁻¹N)⁻¹NᵀR⁻¹ of n.
Friction adds at most e = μ_b Σα_j‖gᵀT_j‖ to it. Where the lines of action do not meet, g is nearly
blind to friction and e is small; where they meet, g cannot be, and e is μ_b times the force of the
closed contact. Contact is made where α_n − e, low-passed, is above `force_on`.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, gram, lu_solve
from osc_contact.law.jit import inner, local
from osc_contact.law.phases import APPROACHING, CLOSED
from osc_contact.law.reading import across, desired_inertia_force, push_on
from osc_contact.law.records import contact_of
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
    """What each approached column reads, and how much of it friction of closed contacts explains.

    Reads `alpha_meas`, `reading_e`, `N`, `pushed` and what `desired_inertia_force` and `push_on`
    read. Fills `touch` and `explained` (N) of the columns in force, both 0 where no contact is
    closed beside an approached one, or columns depend on one another.
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
    """Fill `touch` and `explained` of approached columns; see the module."""
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
            most = t.model.friction_bound * max(work.alpha_meas[a], 0.0)
            for k in range(3):
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
                most = t.model.friction_bound * max(work.alpha_meas[b], 0.0)
                square = 0.0
                for k in range(3):
                    part = dot6(g, _friction(t, other, k, most))
                    square += part * part
                own.explained += sqrt(square)


@inner
def _friction(t, column, k, most):
    """Reading (six numbers) of friction of that size (N) at a contact, along an axis of its face.

    Args:
        column: of N. k: axis. most: N.
    """
    return push_on(t, scaled3(most, across(t.work.columns[column].N, k)), column)
