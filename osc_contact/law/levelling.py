"""Push of an approached contact with several columns, distributed so that the object does not turn.

In the air a force accelerates the object instead of pressing it. Equal forces in all columns of an
edge or a face turn it, unless the centre of the apparent inertia of object and arms is in their
middle: it would land on a corner. The columns accelerate alike under the forces

    α = s D⁻¹(1, …, 1)ᵀ,   D = NᵀΛ⁻¹N,

with Λ the inertia of object and arms at O. Their sum is that of the equal forces.
"""

from __future__ import annotations

from osc_contact.law.algebra import cholesky, cholesky_solve, dot, lu_solve
from osc_contact.law.jit import inner, local
from osc_contact.law.phases import APPROACHING
from osc_contact.law.records import contact_of
from osc_contact.law.vectors import fill

_TOUCHED = 0.5  #: share of `force_on` of net force at which a contact counts as touching


@inner
def level_approaches(t):
    """Distribute the force command of each approached contact so that its columns approach alike.

    The mean of the commands is kept; shares are such that all columns get the same acceleration.
    While a column begins to touch, the commands return to equal ones, because each column then has
    to press by itself. Nothing is changed while the active columns are dependent. Reads `N_t`,
    `Lambda`, `phase` of the contacts, and `net` of the columns in MEMORY. Changes `alpha_u` of
    contacts with two columns or more, all of which are kept.

    Args:
        t: Tick.
    """
    work = t.work
    m = work.locked
    d = 6 - m
    if work.rank != work.count or d == 0:
        return
    factor = local(6, 6)
    has_factor = False
    for a in range(work.rank):
        j = work.kept[a]
        contact = t.model.columns[j].contact
        # the first column of an approached contact begins a run of its columns, a … end − 1
        is_first = a == 0 or t.model.columns[work.kept[a - 1]].contact != contact
        if not is_first or contact_of(t, j).phase != APPROACHING:
            continue
        end = a + 1
        while end < work.rank and t.model.columns[work.kept[end]].contact == contact:
            end += 1
        if end - a < 2:
            continue
        if not has_factor:
            has_factor = cholesky(work.Lambda, m, d, factor) > 0.0
        if has_factor:
            _level_columns(t, factor, a, end)


@inner
def _level_columns(t, factor, first, end):
    """Distribute the mean force command of one contact so that its columns move alike.

    Columns with the mobility D (n, n; acceleration along each per unit force of each) accelerate
    alike if their forces are in the ratios D⁻¹[1 … 1]ᵀ. While a column begins to touch, its force
    approaches `_TOUCHED` times `force_on`, and the commands return to equal ones. Reads `N_t` and
    `net` of MEMORY; changes `alpha_u` (N).

    Args:
        t: Tick.
        factor: (6, 6) Cholesky factor of the inertia Λ along the free axes.
        first: index of the contact's first column among the kept ones.
        end: index behind its last one.
    """
    work = t.work
    m = work.locked
    d = 6 - m
    n = end - first
    D = local(6, 6)
    share = local(1, 6)
    response = local(6)
    mean = 0.0  # N, mean command of the columns
    touch_force = 0.0  # N, largest force that a column bears already
    # D = NᵀΛ⁻¹N along the free axes
    for a in range(n):
        share[0, a] = 1.0
        mean += work.alpha_u[first + a] / n
        touch_force = max(touch_force, t.memory.columns[work.kept[first + a]].net)
        fill(response, work.N_t[first + a])
        cholesky_solve(factor, d, response[m:])
        for b in range(n):
            D[a, b] = dot(response[m:], work.N_t[first + b, m:], d)
    untouched_share = 1.0 - touch_force / (_TOUCHED * t.model.force_on)
    if untouched_share <= 0.0 or not lu_solve(D, n, share, 1):
        return
    # the mean stays; the ratios are those of D⁻¹[1 … 1]ᵀ, as far as no column bears a force
    total = 0.0
    for a in range(n):
        total += share[0, a]
    for a in range(n):
        work.alpha_u[first + a] += (
            min(untouched_share, 1.0) * mean * (n * share[0, a] / total - 1.0)
        )
