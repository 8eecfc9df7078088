"""Motion filter (24) and reachability of contacts, in turned energy coordinates.

Energy coordinates are turned so that the first m axes are the locked ones. The coordinates η̇ are
elements m … 5 of a 6-vector, and SᵀΛ_oS is the identity. Columns of N are stored as rows. All
projections use an orthonormal basis, so that nearly dependent columns do not reduce the accuracy
(normal equations would square the condition number).
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

_LEAST_MOBILITY = 1e-9  #: least mobility along a column, relative to that of the free object
_LEAST_SEPARATE_PART = (
    1e-10  #: least part of a column outside the span of the others, weighted by Λ_S
)
_LEAST_SHARE = 1e-8  #: least share of a command that is distinguished from 0
_LEAST_CHAIN_MOBILITY = (
    1e-6  #: least mobility of the chain along a lost direction, relative to that of Λ_ref
)


@inner
def reflect_columns(t):
    """Turn the kept columns of N, and those with friction, so that the locked axes come first.

    Reads `N_e` and `pushed` (r, 6; energy coordinates); fills `N_t` and `pushed_t`.

    Args:
        t: Tick.
    """
    work = t.work
    for a in range(work.rank):
        fill(work.N_t[a], turned(work, work.N_e[a]))
        fill(work.pushed_t[a], turned(work, work.pushed[a]))


@inner
def require_reachable(t):
    """Require that the arms can push along every column of N, and that none depends on others.

    The mobility is NᵀΦ₀N, with the columns N (6, r) along the free axes and the inverse inertia Φ₀
    = Λ_S⁻¹ of the chain there. With an object 1 ≤ Λ_S ≤ trace(Λ_S) in energy coordinates, so the
    mobility is between NᵀN / trace and NᵀN, and for most contacts N alone is sufficient. Reads
    `N_t`, `locked` (m), `Lambda`. Fills `N_factor_t` and `N_basis_t` of N_t, over the elements m …
    5, and the fields of `_judge_reach` where N alone is not sufficient.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`; `UNREACHABLE` if a column has hardly any mobility, `INSEPARABLE` if columns are
        dependent as seen through the arms, `BAD_METRIC` if Λ_S is not positive definite.
    """
    work = t.work
    r = work.rank
    m = work.locked
    if r == 0:
        return NO_REASON
    least_ratio = orthonormalise(work.N_t, r, m, work.N_basis_t, work.N_factor_t)
    trace = 0.0
    for i in range(m, 6):
        trace += work.Lambda[i, i]
    reach = 1.0
    for a in range(r):
        N = work.N_t[a]
        reach = min(reach, dot(N[m:], N[m:], 6 - m) / dot6(N, N))
    # far above both bounds N alone is sufficient
    if (
        t.model.held
        and reach > 2.0 * _LEAST_MOBILITY * trace
        and least_ratio > 2.0 * _LEAST_SEPARATE_PART * sqrt(trace)
    ):
        return NO_REASON
    return _judge_reach(t)


@inner
def _judge_reach(t):
    """Determine from the mobility NᵀΦ₀N whether the arms can push along every column of N.

    N (6, r) are the columns, Φ₀ = Λ_S⁻¹ is the inverse inertia of the chain along its free axes.
    Reads `N_t`, `locked`, `Lambda`. Fills `reason_amount`, the mobility of the last column that was
    judged, relative to that of the free object, or the least part of a column outside the span of
    the others; with UNREACHABLE `where`, the index of the column among the kept ones.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`; `UNREACHABLE` if a column has hardly any mobility; `INSEPARABLE` if columns are
        dependent as seen through the arms; `BAD_METRIC` if Λ_S is not positive definite.
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
    weighed = local(6, 6)  # rows: columns of N, weighted by the inertia of the chain
    basis = local(6, 6)
    if not cholesky(work.Lambda, m, d, factor) > 0.0:  # also if NaN
        return BAD_METRIC
    # mobility NᵀΛ_S⁻¹N of each column, as the square of its weighted free part
    for a in range(r):
        N = work.N_t[a]
        fill(weighed[a], N)
        forward(factor, d, weighed[a, m:])
        work.reason_amount = dot(weighed[a, m:], weighed[a, m:], d) / dot6(N, N)
        if not work.reason_amount > _LEAST_MOBILITY:  # also if NaN
            work.where = a
            return UNREACHABLE
    # least part of a weighted column outside the span of the others
    work.reason_amount = orthonormalise(weighed, r, m, basis, factor)
    if not work.reason_amount > _LEAST_SEPARATE_PART:  # also if NaN
        return INSEPARABLE
    return NO_REASON


@inner
def permit_error(t):
    """Project the pose error at O on the motions that the contacts permit (4).

    Reads `error`, the factors of `N_e` (`N_basis`) and of `N_t` (`N_basis_t`), and `B_inv_t`. Fills
    `motion_next`, the error over all six axes projected by Ω_m(B), the projection on the motions
    without normal components that changes least in the metric B⁻¹ (m, rad); and `free_error`, the
    part that both contacts and arms permit, projected in the metric of the object. For `free_error`
    the locked axes are removed first, because Ω_m would turn a displacement along N (a yielding
    contact) into motions that the arms cannot execute.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`, or `BAD_METRIC` if the metric B⁻¹ is not positive definite.
    """
    work = t.work
    r = work.rank
    e = local(6)
    zero = local(6)
    fill(zero, ZERO)
    # The permitted part: without locked axes, in the metric of the object.
    fill_free(e, work, motion_to_energy(work, work.error))
    project_onto_constraint(work.N_basis_t, r, e, zero)
    fill(work.free_error, motion_to_world(work, turned_back(work, e)))
    # Ω_m(B) times the error, over all six axes.
    fill(e, motion_to_energy(work, work.error))
    if t.model.metric == BY_OBJECT:
        project_onto_constraint(work.N_basis, r, e, zero)
    else:
        fill(e, turned(work, e))
        if not _project_weighted(t, work.B_inv_t, 0, e, zero):
            return BAD_METRIC
        fill(e, turned_back(work, e))
    fill(work.motion_next, motion_to_world(work, e))
    return NO_REASON


@inner
def _project_weighted(t, B_inv, m, x, target):
    """Replace x by the vector with Nᵀx = target that is nearest in the metric B⁻¹.

    With the Cholesky factor K (d, d) of B⁻¹ = KKᵀ and y = Kᵀx this is the orthogonal projection of
    y on (K⁻¹N)ᵀy = target. N (6, r) has the kept columns, the rows of `N_t`; x and N are in turned
    energy coordinates.

    Args:
        t: Tick.
        B_inv: (6, 6) metric B⁻¹, symmetric.
        m: index of the first element in use; the elements before it are excluded.
        x: (6,), overwritten.
        target: (r,), overwritten.

    Returns:
        False if B⁻¹ is not positive definite.
    """
    work = t.work
    r = work.rank
    d = 6 - m
    K = local(6, 6)
    weighed = local(6, 6)
    factor = local(6, 6)
    basis = local(6, 6)
    if not cholesky(B_inv, m, d, K) > 0.0:  # also if NaN
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
    """Reduce the motion command along lost directions of the arms, in favour of the posture task.

    The joint acceleration of an arm along a lost direction u is uᵀ(a − γ)/χ, unbounded as χ → 0; a
    (6,) is the command, γ (6,) the drift of the tip, χ the distance from the singular posture. A
    share φ of it is executed; the rest is replaced by the acceleration q̈ of the posture task, with
    the least change Δ (6,) of the command (in the metric of the object) that the contacts permit:

        min ΔᵀΔ + Σ (1 − φ)/φ (uᵀΔ − y)²/|u|²,   NᵀΔ = 0,   y = χ vᵀKᵀq̈ − uᵀ(a − γ)

    The sum is over the lost directions of all arms; N (6, r) are the kept columns, v (n,) is the
    direction's motion of the joints, weighted with the factor K of M = KKᵀ: `mode` is K⁻ᵀv. Reads
    the lost directions of the arms (`mode`, `chi`, `lost`, `share`, `gone`), their `gamma`, and
    `N_t`. Updates `acceleration_t` (a).

    Args:
        t: Tick.
    """
    work = t.work
    m = work.locked
    H = local(6, 6)
    factor = local(6, 6)
    step = local(6)
    row = local(6)
    zero = local(6)
    # H = 1 + Σ w u uᵀ and the right side Σ w y u (in `step`) of the unconstrained minimum, with the
    # weights w = (1 − φ)/(φ |u|²)
    fill(step, ZERO)
    set_identity(H)
    a = turned_back(work, work.acceleration_t)
    for k in range(t.model.n_arms):
        arm_work = work.arms[k]
        arm = t.model.arms[k]
        for e in range(arm_work.n_lost):
            target = 0.0  # y; M q̈ of the posture task is `retreat`, and vᵀKᵀq̈ = (K⁻ᵀv)ᵀM q̈
            for i in range(arm.first, arm.end):
                posture_torque = retreat(t, arm, i, t.model.retreat_damping)
                target += arm_work.mode[e, i - arm.first] * posture_torque
            target *= arm_work.chi[e]
            for i in range(6):
                target -= arm_work.lost[e, i] * (a[i] - arm_work.gamma[i])
            fill_free(row, work, arm_work.lost[e])
            size = dot(row, row, 6)
            if arm_work.gone[e] != 0.0 or size < _LEAST_CHAIN_MOBILITY:  # locked in the chain
                continue
            weight = (1.0 - arm_work.share[e]) / (max(arm_work.share[e], _LEAST_SHARE) * size)
            accumulate(step, weight * target, row)
            add_square(weight, row, H)
    # Δ = H⁻¹ Σ w y u, then its projection to NᵀΔ = 0
    fill(zero, ZERO)
    cholesky(H, m, 6 - m, factor)
    cholesky_solve(factor, 6 - m, step[m:])
    _project_weighted(t, H, m, step, zero)
    fill(work.acceleration_t, plus(work.acceleration_t, step))


@inner
def set_metric(t):
    """Fill `B_inv_t`, the metric B⁻¹ (6, 6) of the motion filter in turned energy coordinates.

    B⁻¹ is, by `metric` of MODEL, the inertia of the object (BY_OBJECT), which is the identity in
    energy coordinates, so `B_inv_t` is not filled; the inertia Λ of object and arms (BY_CHAIN); or
    `B_inv` of MODEL (BY_MATRIX), given at O in world axes. It is transformed as an inertia is, by
    the map of wrenches from both sides.

    Args:
        t: Tick.
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
    for _ in range(2):  # each time the rows are transformed, and the result is transposed
        for i in range(6):
            f = wrench_to_energy(work, out[i])
            for j in range(6):
                half[j, i] = f[j]
        copy_rows(half, out)
    reflect_sides(work, out)


@inner
def filter_motion(t):
    """Filter the commanded acceleration a_u by eq. 24 to S η̇_c + σ, in turned energy coordinates.

        ρ = n_γ − κ(NᵀV_rel − v̄) + Nᵀ(b_e − σ + Φ_eN_μα_u)
        η̇_c = η̇_u − B_S N_S (N_SᵀB_S N_S)⁻¹ (N_Sᵀη̇_u − ρ),   N_S = SᵀN

    S (6, d) are the motions that the arms permit, η̇_u = Sᵀ(a_u − σ) their commanded accelerations,
    σ (6,) the acceleration at η̇ = 0. ρ (r,; m/s²) is the acceleration along the columns N that the
    contacts require: by the shape of the surfaces (n_γ), the brake, the bias b_e of the touched
    bodies and their response Φ_eN_μ to the commanded forces α_u. B_S is the inverse of the metric
    in which the change is least. Reads `a_u`, `sigma`, `alpha_u`, `brake`, `n_gamma`, `b_N`,
    `Phi_mu`, `N_t` and its factors, `B_inv_t`. Fills `acceleration_t`.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`, or `BAD_METRIC` if the metric is not positive definite.
    """
    work = t.work
    r = work.rank
    m = work.locked
    rho = local(6)
    x = work.acceleration_t
    sigma = work.sigma
    fill(x, minus(turned(work, motion_to_energy(work, work.a_u)), sigma))
    for a in range(r):  # ρ; `brake` is κ(NᵀV_rel − v̄), `Phi_mu` NᵀΦ_eN_μ, `b_N` Nᵀb_e
        s = work.n_gamma[a] + work.b_N[a] - work.brake[a]
        for b in range(r):
            s += work.Phi_mu[a, b] * work.alpha_u[b]
        for i in range(m):  # σ is zero along the free axes
            s -= work.N_t[a, i] * sigma[i]
        rho[a] = s
    weighed = t.model.metric != BY_OBJECT
    if weighed and m > 0:  # keeps Nᵀx of a locked motion exactly
        along_N = local(6)
        for a in range(r):
            along_N[a] = dot6(work.N_t[a], x)
        project_onto_columns(work.N_factor_t, work.N_basis_t, r, x, along_N)
    if not weighed:
        project_onto_columns(work.N_factor_t, work.N_basis_t, r, x, rho)
    elif r > 0 and not _project_weighted(t, work.B_inv_t, m, x, rho):
        return BAD_METRIC
    for i in range(m):  # S η̇_c + σ: along the locked axes the acceleration is σ
        x[i] = sigma[i]
    return NO_REASON
