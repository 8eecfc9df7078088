"""Forces of the closed contacts while another contact lands beside them.

The law commands α_u of an approached contact k, but in the air its force is 0, and while it lands
the force is that of the impact, v √(k m), whatever is commanded. Both act on the object beside the
closed contacts C, whose columns N_C are the only constraints then:

    α_C = α_u,C − D_CC⁻¹ D_Ck (α_k − α_u,k),   D = Nᵀ(Φ_0 + Φ_e)N_μ

D_CC⁻¹ D_Ck is 0.3 to 0.6 for the packaged objects. Therefore D_CC⁻¹ D_Ck (α_k − α_u,k), with the
measured force α_k, is added to the commands of the closed contacts, until the force of the new
contact is the commanded one. This changes neither the motion nor α_k: the closed contacts bear what
is added.
"""

from __future__ import annotations

from osc_contact.law.algebra import cholesky, cholesky_solve, dot, lu_solve
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.phases import APPROACHING
from osc_contact.law.records import contact_of
from osc_contact.law.vectors import fill

_OPPOSED = 0.5  #: largest addition to a command, as a share of the desired force
_LANDED = 3.0  #: time since contact was made after which it has landed, as a multiple of `rise`


@inner
def oppose_landings(t):
    """Add to `reaction` of the closed contacts the forces that landing contacts take from them.

    The error α_k − α_u,k (N) of the measured force of a landing contact k changes the force of the
    closed contacts by D_CC⁻¹D_Ck times it, where D_ab (1/kg) is the normal acceleration at the
    column a per unit force of the column b, through the chain and the touched bodies. Nothing is
    added where columns are dependent, or without an approached or new contact beside a closed one.
    Reads `N_t`, `pushed_t`, `Lambda`, `Phi_mu`, `alpha_meas`, `alpha_u`, `alpha_d`; changes
    `reaction` (r,) in N, at most by `_OPPOSED` times the desired force.

    Args:
        t: Tick.
    """
    work = t.work
    m = work.locked
    d = 6 - m
    r = work.rank
    lands = False
    for a in range(r):
        lands = lands or _landing_share(t, a) > 0.0
    if not lands or r != work.count or d == 0:
        return
    factor = local(6, 6)
    D = local(6, 6)
    x = local(1, 6)
    response = local(6)
    if not cholesky(work.Lambda, m, d, factor) > 0.0:  # also if NaN
        return
    n = 0  # number of columns of closed contacts
    for a in range(r):
        if _landing_share(t, a) > 0.0:
            continue
        fill(response, work.N_t[a])
        cholesky_solve(factor, d, response[m:])
        x[0, n] = 0.0
        column = 0  # index of b among the closed ones
        for b in range(r):
            D_ab = work.Phi_mu[a, b] + dot(response[m:], work.pushed_t[b, m:], d)
            share = _landing_share(t, b)
            if share > 0.0:
                x[0, n] += share * D_ab * (work.alpha_meas[b] - work.alpha_u[b])
            else:
                D[n, column] = D_ab
                column += 1
        n += 1
    if n == 0 or not lu_solve(D, n, x, 1):
        return
    n = 0
    for a in range(r):
        if _landing_share(t, a) > 0.0:
            continue
        limit = _OPPOSED * abs(work.alpha_d[a])
        work.reaction[a] += min(max(x[0, n], -limit), limit)
        n += 1


@leaf
def _landing_share(t, a):
    """Share (0 … 1) of a contact's force error that is opposed: 1 until it has touched for `rise`.

    It is 0 for contacts that were closed from the start, and for those that have landed.

    Args:
        t: Tick.
        a: index of a column of the contact among the kept ones.
    """
    contact = contact_of(t, t.work.kept[a])
    if contact.phase == APPROACHING:
        return 1.0
    rise = t.model.rise
    return min(max((_LANDED * rise - contact.since) / ((_LANDED - 1.0) * rise), 0.0), 1.0)
