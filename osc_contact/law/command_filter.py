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
    cholesky_solve,
    dot,
    forward,
    orthonormalise,
    project_onto_columns,
    project_onto_constraint,
    transposed_factor_times,
)
from osc_contact.law.jit import inner, local
from osc_contact.law.operational import retreat
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import BY_CHAIN, BY_OBJECT
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add_square,
    copy_rows,
    dot6,
    fill,
    fill_free,
    minus,
    motion_to_energy,
    motion_to_world,
    plus,
    reflect_sides,
    set_identity,
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
_HARD = 1e-8  #: shares of motion below it are as good as 0
_GONE = 1e-6  #: of the mobility that Λ_ref has along any direction, 1


@inner
def reflect_columns(t):
    """Columns of N and N_μ in the turned coordinates: `N_t`, `pushed_t` from `N`, `pushed`."""
    work = t.work
    for a in range(work.rank):
        fill(work.N_t[a], turned(work, work.N_e[a]))
        fill(work.pushed_t[a], turned(work, work.pushed[a]))


@inner
def require_reachable(t):
    """Whether the arms can push on every column (`response.require_reachable`); returns a reason.

    With Λ_S between 1 and its trace, NᵀΦ₀N lies between NᵀN / trace and NᵀN: most
    contacts are judged on N alone. Reads `N_t`, `locked` (m), `Lambda`. Fills `N_factor_t` and
    `N_basis_t` of N_t, over the elements m … 5.
    """
    work = t.work
    r = work.rank
    m = work.locked
    if r == 0:
        return NO_REASON
    least = orthonormalise(work.N_t, r, m, work.N_basis_t, work.N_factor_t)
    trace = 0.0
    for i in range(m, 6):
        trace += work.Lambda[i, i]
    reach = 1.0
    for a in range(r):
        N = work.N_t[a]
        reach = min(reach, dot(N[m:], N[m:], 6 - m) / dot6(N, N))
    if t.model.held and reach > 2.0 * _REACH * trace and least > 2.0 * _APART * sqrt(trace):
        return NO_REASON
    return _judge_reach(t)


@inner
def _judge_reach(t):
    """Whether the arms can push on every column, judged on NᵀΦ₀N, Φ₀ = Λ_S⁻¹; returns a reason.

    Reads `N_t`, `locked`, `Lambda`. Fills `where` (the column) and `reason_amount`.
    """
    work = t.work
    r = work.rank
    m = work.locked
    d = 6 - m
    if d == 0:
        work.where = 0
        work.reason_amount = 0.0
        return UNREACHABLE
    factor = local(6, 6)
    seen = local(6, 6)  # rows: columns of N as seen through the arms
    basis = local(6, 6)
    if not cholesky(work.Lambda, m, d, factor) > 0.0:
        return BAD_METRIC
    for a in range(r):
        N = work.N_t[a]
        fill(seen[a], N)
        forward(factor, d, seen[a, m:])
        work.reason_amount = dot(seen[a, m:], seen[a, m:], d) / dot6(N, N)
        if not work.reason_amount > _REACH:
            work.where = a
            return UNREACHABLE
    work.reason_amount = orthonormalise(seen, r, m, basis, factor)
    if not work.reason_amount > _APART:
        return INSEPARABLE
    return NO_REASON


@inner
def permit_error(t):
    """The part of the pose error at O that the contacts permit; returns a reason.

    Reads `error`, the factors of `N` and `N_t`, and `B_inv_t`. Fills `motion_next`, Ω_m(B) of the
    error (4) with all six axes, locked or not; and `free_error`, the part that the arms can make,
    too, cut in the object's metric: Ω_m would answer the yielding of a contact, a displacement
    along N, with motions that they cannot make.
    """
    work = t.work
    r = work.rank
    e = local(6)
    none = local(6)
    fill(none, ZERO)
    fill_free(e, work, motion_to_energy(work, work.error))
    project_onto_constraint(work.N_basis_t, r, e, none)
    fill(work.free_error, motion_to_world(work, turned_back(work, e)))
    fill(e, motion_to_energy(work, work.error))
    if t.model.metric == BY_OBJECT:
        project_onto_constraint(work.N_basis, r, e, none)
    else:
        fill(e, turned(work, e))
        if not _meet_weighed(t, work.B_inv_t, 0, e, none):
            return BAD_METRIC
        fill(e, turned_back(work, e))
    fill(work.motion_next, motion_to_world(work, e))
    return NO_REASON


@inner
def _meet_weighed(t, B_inv, m, x, target):
    """x ← the x nearest in B⁻¹ with N x = target; False: B⁻¹ is not definite.

    With B⁻¹ = KKᵀ and y = Kᵀx that is the y nearest with (N K⁻ᵀ) y = target. Reads `N_t`.

    Args:
        B_inv: (6, 6) metric. m: first element that counts of all six. x: (6,), target: (r,), both
            overwritten.
    """
    work = t.work
    r = work.rank
    d = 6 - m
    K = local(6, 6)
    weighed = local(6, 6)
    factor = local(6, 6)
    basis = local(6, 6)
    if not cholesky(B_inv, m, d, K) > 0.0:
        return False
    transposed_factor_times(K, d, x[m:])
    for a in range(r):
        fill(weighed[a], work.N_t[a])
        forward(K, d, weighed[a, m:])
    orthonormalise(weighed, r, m, basis, factor)
    project_onto_columns(factor, basis, r, x, target)
    backward(K, d, x[m:])
    return True


@inner
def reduce_motion(t):
    """The motion command with the arms' lost directions left to their posture task.

    What an arm's joints must do along a lost direction u is (uᵀ(a − γ))/χ: it grows without bound
    while it does ever less. Share φ of it is kept; the rest is replaced by the posture's own
    acceleration there, with the least change Δ of the command in Λ_o that the contacts permit:

        min ΔᵀΔ + Σ (1 − φ)/φ (uᵀΔ − t)²/|u|²,   NΔ = 0,   t = χ vᵀKᵀq̈_posture − uᵀ(a − γ)

    Reads the lost directions of the arms (`mode`, `chi`, `lost`, `share`, `gone`), their `gamma`,
    and `N_t`. Updates `acceleration_t` (a).
    """
    work = t.work
    m = work.locked
    H = local(6, 6)
    factor = local(6, 6)
    step = local(6)
    row = local(6)
    none = local(6)
    fill(step, ZERO)
    set_identity(H)
    a = turned_back(work, work.acceleration_t)
    for k in range(t.model.n_arms):
        own = work.arms[k]
        arm = t.model.arms[k]
        for e in range(own.n_lost):
            target = 0.0
            for i in range(arm.first, arm.end):
                target += own.mode[e, i - arm.first] * retreat(t, arm, i, t.model.retreat_damping)
            target *= own.chi[e]
            for i in range(6):
                target -= own.lost[e, i] * (a[i] - own.gamma[i])
            fill_free(row, work, own.lost[e])
            size = dot(row, row, 6)
            if own.gone[e] != 0.0 or size < _GONE:  # no motion of the chain's any more
                continue
            weight = (1.0 - own.share[e]) / (max(own.share[e], _HARD) * size)
            accumulate(step, weight * target, row)
            add_square(weight, row, H)
    fill(none, ZERO)
    cholesky(H, m, 6 - m, factor)
    cholesky_solve(factor, 6 - m, step[m:])
    _meet_weighed(t, H, m, step, none)
    fill(work.acceleration_t, plus(work.acceleration_t, step))


@inner
def set_metric(t):
    """B⁻¹ of the motion filter in turned coordinates.

    Reads `Lambda`, or B⁻¹ of MODEL. Fills `B_inv_t`, but not where B⁻¹ is the object's inertia.
    """
    if t.model.metric == BY_OBJECT:
        return
    work = t.work
    out = work.B_inv_t
    if t.model.metric == BY_CHAIN:
        copy_rows(work.Lambda, out)
        return
    copy_rows(t.model.B_inv, out)
    half = local(6, 6)
    for _ in range(2):  # the map from wrenches to energy coordinates, from both sides
        for i in range(6):
            f = wrench_to_energy(work, out[i])
            for j in range(6):
                half[j, i] = f[j]
        copy_rows(half, out)
    reflect_sides(work, out)


@inner
def filter_motion(t):
    """The object's acceleration S η̇_c + σ, turned, from the command a_u at O: eq. 24.

        ρ = n_γ − κ(NᵀV_rel − v̄) + Nᵀ(b_e − σ + Φ_eN_μα_u)
        η̇_c = η̇_u − B_S N_S (N_SᵀB_S N_S)⁻¹ (N_Sᵀη̇_u − ρ),   N_S = SᵀN

    Reads `a_u`, `sigma`, `alpha_u`, `brake`, `n_gamma`, `b_N`, `Phi_mu`, `N_t` and its factors,
    `B_inv_t`. Fills `acceleration_t`; returns a reason.
    """
    work = t.work
    r = work.rank
    m = work.locked
    rho = local(6)
    x = work.acceleration_t
    sigma = work.sigma
    fill(x, minus(turned(work, motion_to_energy(work, work.a_u)), sigma))
    for a in range(r):
        s = work.n_gamma[a] + work.b_N[a] - work.brake[a]
        for b in range(r):
            s += work.Phi_mu[a, b] * work.alpha_u[b]
        for i in range(m):  # σ has no part along the other axes
            s -= work.N_t[a, i] * sigma[i]
        rho[a] = s
    weighed = t.model.metric != BY_OBJECT
    if weighed and m > 0:  # what contacts see of a motion outside the chain's is not rounded away
        kept = local(6)
        for a in range(r):
            kept[a] = dot6(work.N_t[a], x)
        project_onto_columns(work.N_factor_t, work.N_basis_t, r, x, kept)
    if not weighed:
        project_onto_columns(work.N_factor_t, work.N_basis_t, r, x, rho)
    elif r > 0 and not _meet_weighed(t, work.B_inv_t, m, x, rho):
        return BAD_METRIC
    for i in range(m):
        x[i] = sigma[i]
    return NO_REASON
