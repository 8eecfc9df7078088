"""Eqs. 21 and 24 in energy coordinates turned so that the first m axes are the locked ones.

Coordinates η̇ are elements m … 5 of a 6-vector; SᵀΛ_oS is the identity there. Columns of N are rows.
All projections go through an orthonormal basis: columns that nearly depend on one another cost no
digits (normal equations would square their condition).
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import (
    backward,
    cholesky,
    dot,
    forward,
    orthonormalise,
    project_onto_columns,
    project_onto_constraint,
)
from osc_contact.law.jit import inner
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import BY_CHAIN, BY_OBJECT
from osc_contact.law.vectors import (
    dot6,
    fill,
    minus,
    motion_to_energy,
    motion_to_world,
    reflect_sides,
    turned,
    turned_back,
    wrench_to_energy,
)

UNREACHABLE = declare_reason(
    "UNREACHABLE",
    8,
    "the arms cannot push on contact column {kept} ({kept_contact}): its mobility is "
    "{amount:.2g} of the free object's. The structure carries this force; leave the contact "
    "out of N.",
)
INSEPARABLE = declare_reason(
    "INSEPARABLE",
    9,
    "as seen through the arms, some contact columns are dependent: their forces cannot be "
    "separated. Keep an independent subset",
)
BAD_METRIC = declare_reason(
    "BAD_METRIC", 10, "the metric B of eq. 24 is singular in the motions that the arms permit"
)

_REACH = 1e-9  #: least mobility along a column, beside that of the free object
_APART = 1e-10  #: least part of a column outside the others, as seen through the arms


@inner
def reflect_columns(t):
    """Columns of N and N_μ in the turned coordinates."""
    work = t.work
    for a in range(work.rank):
        fill(work.N_t[a], turned(work, work.N[a]))
        fill(work.pushed_t[a], turned(work, work.pushed[a]))


@inner
def require_reachable(t):
    """Whether the arms can push on every column (`response.require_reachable`); a reason.

    With Λ_S = ΣΛ_i + 1 between 1 and its trace, NᵀΦ₀N lies between NᵀN / trace and NᵀN: most
    contacts are judged on N alone. Fills Q_t, L_t: N_t = L_t Q_t over the elements m … 5.
    """
    work = t.work
    r = work.rank
    m = work.locked
    if r == 0:
        return NO_REASON
    least = orthonormalise(work.N_t, r, m, work.Q_t, work.L_t)
    trace = 0.0
    for i in range(m, 6):
        trace += work.Lambda[i, i] + 1.0
    reach = 1.0
    for a in range(r):
        N = work.N_t[a]
        reach = min(reach, dot(N[m:], N[m:], 6 - m) / dot6(N, N))
    if t.model.held != 0 and reach > 2.0 * _REACH * trace and least > 2.0 * _APART * sqrt(trace):
        return NO_REASON
    return _judge_reach(t)


@inner
def _judge_reach(t):
    """The same on NᵀΦ₀N itself, Φ₀ = Λ_S⁻¹."""
    work = t.work
    r = work.rank
    m = work.locked
    d = 6 - m
    if d == 0:
        work.where = 0
        work.amount = 0.0
        return UNREACHABLE
    for i in range(6):
        fill(work.A[i], work.Lambda[i])
        work.A[i, i] += 1.0 if t.model.held != 0 else 0.0
    if not cholesky(work.A, m, d, work.B) > 0.0:
        return BAD_METRIC
    for a in range(r):
        N = work.N_t[a]
        fill(work.D[a], N)
        forward(work.B, d, work.D[a], m)
        work.amount = dot(work.D[a, m:], work.D[a, m:], d) / dot6(N, N)
        if not work.amount > _REACH:
            work.where = a
            return UNREACHABLE
    work.amount = orthonormalise(work.D, r, m, work.E, work.A)
    if not work.amount > _APART:
        return INSEPARABLE
    return NO_REASON


@inner
def permit_error(t, error, out, by_object):
    """out (6,) = Ω_m(B) error, eq. 4, at O: with all six axes, locked or not.

    Args:
        error, out: (6,) at O. by_object: B is the object's inverse inertia, else that of `B_inv_t`.
    """
    work = t.work
    e = work.y
    r = work.rank
    for a in range(r):
        work.s[a] = 0.0
    fill(e, motion_to_energy(work, error))
    if by_object:
        project_onto_constraint(work.Q, r, e, work.s)
    else:
        fill(e, turned(work, e))
        if not _meet_weighed(t, 0, e):
            return False
        fill(e, turned_back(work, e))
    fill(out, motion_to_world(work, e))
    return True


@inner
def _meet_weighed(t, m, x):
    """x ← the x nearest in B⁻¹ with N x = s, over the elements m … 5; False: B⁻¹ not definite."""
    work = t.work
    r = work.rank
    d = 6 - m
    K = work.B
    if not cholesky(work.B_inv_t, m, d, K) > 0.0:  # B⁻¹ = KKᵀ, y = Kᵀx
        return False
    for i in range(d):
        s = x[m + i] / K[i, i]
        for k in range(i + 1, d):
            s += K[k, i] * x[m + k]
        x[m + i] = s
    for a in range(r):
        fill(work.D[a], work.N_t[a])
        forward(K, d, work.D[a], m)
    orthonormalise(work.D, r, m, work.E, work.A)
    for a in range(r):
        work.u[a] = work.s[a]
    project_onto_columns(work.A, work.E, r, x, work.u)
    backward(K, d, x, m)
    return True


@inner
def set_metric(t):
    """B⁻¹ of the motion filter in turned coordinates (`B_inv_t`); nothing for the object's own."""
    if t.model.metric == BY_OBJECT:
        return
    work = t.work
    out = work.B_inv_t
    if t.model.metric == BY_CHAIN:
        for i in range(6):
            fill(out[i], work.Lambda[i])
            out[i, i] += 1.0
        return
    for i in range(6):
        fill(out[i], t.model.B_inv[i])
    for _ in range(2):  # the map from wrenches to energy coordinates, from both sides
        for i in range(6):
            f = wrench_to_energy(work, out[i])
            for j in range(6):
                work.A[j, i] = f[j]
        for i in range(6):
            fill(out[i], work.A[i])
    reflect_sides(work, out)


@inner
def filter_motion(t):
    """x (6,) ← the object's acceleration S η̇_c + σ, turned, from the command `a_u` at O: eq. 24.

        ρ = n_γ − κ(NᵀV_rel − v̄) + Nᵀ(b_e − σ + Φ_eN_μα_u)
        η̇_c = η̇_u − B_S N_S (N_SᵀB_S N_S)⁻¹ (N_Sᵀη̇_u − ρ),   N_S = SᵀN

    Returns a reason.
    """
    work = t.work
    r = work.rank
    m = work.locked
    x = work.x
    sigma = work.sigma
    fill(x, minus(turned(work, motion_to_energy(work, work.a_u)), sigma))
    for a in range(r):
        s = work.n_gamma[a] + work.b_N[a] - work.brake[a]
        for b in range(r):
            s += work.Phi_mu[a, b] * work.alpha_u[b]
        for i in range(m):  # σ has no part along the other axes
            s -= work.N_t[a, i] * sigma[i]
        work.rho[a] = s
    weighed = t.model.metric != BY_OBJECT
    if weighed and m > 0:  # what contacts see of a motion outside the chain's is not rounded away
        for a in range(r):
            work.s[a] = dot6(work.N_t[a], x)
        project_onto_columns(work.L_t, work.Q_t, r, x, work.s)
    for a in range(r):
        work.s[a] = work.rho[a]
    if not weighed:
        project_onto_columns(work.L_t, work.Q_t, r, x, work.s)
    elif r > 0 and not _meet_weighed(t, m, x):
        return BAD_METRIC
    for i in range(m):
        x[i] = sigma[i]
    return NO_REASON
