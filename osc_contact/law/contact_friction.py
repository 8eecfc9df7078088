"""Friction of contacts: identification of its coefficient, and reaction to tangential forces.

Both use the part of the wrist readings that the least squares of `reading` leave unexplained.
"""

from __future__ import annotations

from osc_contact.law.algebra import cholesky, cholesky_solve, dot, lu_solve
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.records import body_of
from osc_contact.law.tangents import across, has_point, reading_of_force
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    cross,
    dot3,
    dot6,
    fill,
    fill3,
    join,
    linear,
    plus,
    scaled3,
    turned,
    wrench_to_energy,
)

ALONG_SLIP = 0.3  #: typical error of the coefficient of friction along the slip
#: Typical coefficient of friction across the slip; also the tangent of an error of the normal.
ACROSS_SLIP = 0.1
_LEAST_FORCE = 1.0  #: N, least typical force of a contact, see `likely_force`
_TANGENTIAL_LAG = 0.005  #: s, time constant of the low-pass of tangential forces
_MOST_REACTION = 0.5  #: largest reaction to tangential forces, as a share of the desired force
_FIRST = 0.005  #: T_1 (s), weight of the assumed coefficient, as a time of sliding
_MOST_FRICTION = 2.0  #: largest coefficient of friction that is identified


@inner
def learn_friction(t):
    """Update the coefficient of friction μ by the tangential forces measured along the slip.

        dμ/dt = k e,   e = Σw_j s_jᵀβ_j / Σw_j²,   with the sums of `_sum_friction_errors`

    e is the error of μ by which the measured tangential forces β_j differ from the modelled ones,
    with the slip s_j and the desired forces w_j of the contacts j as weights. The rate k (1/s) is
    `learning` of MODEL, or 1/(`_FIRST` + `slid`) in the beginning, when this is more, so that μ is
    the mean of all readings; `slid` (s) is the time of sliding under the desired forces. This
    faster start is not used while normals are estimated, because a tilted face initially causes the
    same forces as friction, nor while columns of N are dependent, because the force of a single
    contact is unknown then.

    Reads `rank`, `count`, `dt` and the fields that `_sum_friction_errors` reads. Updates
    `more_friction`, which is μ less the assumed coefficient, and `slid`.

    Args:
        t: Tick.
    """
    model = t.model
    work = t.work
    if model.learning == 0.0:
        return
    columns_depend = work.rank < work.count
    (errors, sliding, weights, normal_variance) = _sum_friction_errors(t, columns_depend)
    if not weights > 0.0:  # also if NaN
        return
    k = model.learning
    if not normal_variance > 0.0 and not columns_depend:  # also if NaN
        k = max(k, 1.0 / (_FIRST + work.slid))
        work.slid += work.dt * sliding / weights
    excess = work.more_friction + min(k * work.dt, 1.0) * errors / weights
    work.more_friction = min(max(excess, -model.mu), _MOST_FRICTION - model.mu)


@inner
def _sum_friction_errors(t, columns_depend):
    """Sum over the active contacts j the forces by which the coefficient of friction is corrected.

    The slip s_j (3,) is the direction of sliding, shorter than 1 where the contact hardly slides;
    with s_j = 0 it does not change μ. w_j is the typical force of the contact (N). The tangential
    force beyond the modelled friction is β_j = C_jT_jᵀR⁻¹(f − Hα) (3,; N) with the covariance C_j
    (3, 3; N²) of tangential forces, the map T_j (6, 3) from a force at the contact to the reading,
    and R⁻¹(f − Hα) (6,) in `reading_rest`, the weighted part of the reading that contact forces α
    with their modelled friction do not explain. As n_jᵀs_j = 0 for the normal n_j, C_j of
    `_likely_errors` gives

        s_jᵀC_j = w_j² variance_j s_jᵀ,   variance_j = σ_t² + (σ_s² − σ_t²)|s_j|²

    with the typical coefficients of friction σ_s = `ALONG_SLIP` along the slip and σ_t =
    `ACROSS_SLIP` across it. Reads `chosen`, `goal`, `alpha_meas`, `reading_rest`, and `slip`,
    `rests` and `prior` of the columns.

    Args:
        t: Tick.
        columns_depend: whether active columns of N are dependent, so that `alpha_meas` is not in
            the order of `chosen`.

    Returns:
        Σw_j s_jᵀβ_j (N²); Σw_j α_j(1 − ρ_j) (N²) with ρ_j = `rests` and α_j between 0 and w_j, 0
        with dependent columns; Σw_j² (N²); and the sum of the variances of the contact normals
        before any sliding (rad²).
    """
    work = t.work
    errors = sliding = weights = normal_variance = 0.0
    for j in range(work.count):
        index = work.chosen[j]
        if not has_point(t, index):
            continue
        column = work.columns[index]
        s = column.slip
        w = likely_force(work, index)
        slip_square = dot3(s, s)
        variance = (ALONG_SLIP**2 - ACROSS_SLIP**2) * slip_square + ACROSS_SLIP**2
        multiplier = dot6(reading_of_force(t, linear(s), index), work.reading_rest)  # sᵀTᵀR⁻¹(…)
        errors += w * w * w * variance * multiplier  # w sᵀβ = w³ variance sᵀTᵀR⁻¹(…)
        pressing = 0.0 if columns_depend else min(max(work.alpha_meas[j], 0.0), w)
        sliding += w * pressing * (1.0 - column.rests)
        weights += w * w
        # Trace of the covariance (3, 3) of the turn of the normal, which is stored by rows.
        normal_variance += column.prior[0] + column.prior[4] + column.prior[8]
    return errors, sliding, weights, normal_variance


@leaf
def likely_force(work, index):
    """Typical size w_j (N) of the force of a column of N: its desired force, at least 1 N.

    It is the unit in which friction forces of the contact are weighted in least squares.

    Args:
        work: WORK, of which `goal` is read.
        index: index of the column among all columns of the model.
    """
    return max(abs(work.goal[index]), _LEAST_FORCE)


@inner
def oppose_friction(t):
    """Compute `reaction`, the contact force that tangential forces f_t cause through the chain.

        reaction = D⁻¹Nᵀ(Φ_0 + Φ_e) f_t,   D = Nᵀ(Φ_0 + Φ_e)N_μ

    N and N_μ (6, r) are the wrenches of unit contact forces without and with friction, Φ_0 = Λ⁻¹
    along the free axes and Φ_e the inverse inertias of chain and touched bodies, f_t (6,) the
    wrench of the tangential forces (`_sum_tangential`). f_t itself is not compensated, because that
    would push on contacts that stick. The reaction is limited to half of the desired force.

    Reads `N_t`, `pushed_t` (rows of N and N_μ), `Lambda`, `Phi_mu` (NᵀΦ_e N_μ), `alpha_d` (N), and
    `tangential` (3,; N) of the columns in MEMORY, which make f_t. Fills `reaction` (r,) in N, and
    `tangential` of the columns for the next tick.

    Args:
        t: Tick.
    """
    work = t.work
    m = work.locked
    d = 6 - m
    r = work.rank
    x = local(1, 6)  # NᵀΦ_e f_t, then Nᵀ(Φ_0 + Φ_e) f_t, then the reaction
    tangential_wrench = local(6)  # f_t
    _sum_tangential(t, tangential_wrench, x)
    # tangential forces for the next tick, zero for columns without a point of contact
    for j in range(t.model.n_columns):
        fill3(work.columns[j].tangential, ZERO_3)
    for j in range(work.count):
        index = work.chosen[j]
        if has_point(t, index):
            last_force = t.memory.columns[index].tangential
            _find_tangential(t, work.columns[index], index, last_force)
    # the reaction, from the accelerations along the columns and the response D to forces there
    factor = local(6, 6)
    D = local(6, 6)
    response = local(6)  # Φ_0 times a column of N
    solvable = d > 0 and cholesky(work.Lambda, m, d, factor) > 0.0
    if solvable:
        for a in range(r):
            fill(response, work.N_t[a])
            cholesky_solve(factor, d, response[m:])
            x[0, a] += dot(response[m:], tangential_wrench[m:], d)
            for b in range(r):
                D[a, b] = work.Phi_mu[a, b] + dot(response[m:], work.pushed_t[b, m:], d)
        solvable = lu_solve(D, r, x, 1)
    for a in range(r):
        limit = _MOST_REACTION * abs(work.alpha_d[a])
        work.reaction[a] = min(max(x[0, a], -limit), limit) if solvable else 0.0


@leaf
def _sum_tangential(t, f_t, accelerations):
    """Sum the wrenches f_t of the tangential forces on the object that friction does not explain.

    f_t (6,) is the sum over the contacts of ρ = `rests` (0 … 1; 0 where a contact slides) times the
    wrench of β (3,; N) = `tangential` of the last tick, the low-passed tangential force that the
    identified friction does not explain. A force on one body does not move another.

    Args:
        t: Tick, of which `rests` and `point` of the columns, `yields` (NᵀΦ_e), and `tangential` of
            MEMORY are read.
        f_t: (6,), filled with the sum in turned energy coordinates.
        accelerations: (1, r), filled with NᵀΦ_e f_t, the accelerations of the touched bodies by
            these forces along the kept columns (m/s²).
    """
    work = t.work
    wrench = ZERO
    for a in range(work.rank):
        accelerations[0, a] = 0.0
    for j in range(work.count):
        index = work.chosen[j]
        if not has_point(t, index):
            continue
        column = work.columns[index]
        resting = scaled3(column.rests, t.memory.columns[index].tangential)
        f = join(resting, cross(column.point, resting))
        wrench = plus(wrench, turned(work, wrench_to_energy(work, f)))
        if work.moving:
            for a in range(work.rank):
                if body_of(t, work.kept[a]).same == body_of(t, index).same:
                    accelerations[0, a] += dot6(work.yields[a], f)
    fill(f_t, wrench)


@inner
def _find_tangential(t, column, index, last_force):
    """Low-pass the tangential force β (3,; N) of a contact beyond the friction assumed in α.

        β = C TᵀR⁻¹(f − Hα),   C = w²(σ_t²(1 − n nᵀ) + (σ_s² − σ_t²) s sᵀ)

    `tangential` follows β with the time constant `_TANGENTIAL_LAG`. R⁻¹(f − Hα) (6,) =
    `reading_rest` is the weighted part of the wrist readings that the measured contact forces α do
    not explain, each of which acts with its friction by the identified coefficient. T (6, 3) is the
    reading of a force at the contact, C (3, 3; N²) the covariance of tangential forces, with the
    typical force w (N), normal n and direction of slip s (3,), and typical coefficients of friction
    σ_s = `ALONG_SLIP` along the slip and σ_t = `ACROSS_SLIP` across it. Reads `goal`,
    `reading_rest` and `dt`; fills `tangential` of the column (3,; N, world axes).

    Args:
        t: Tick.
        column: COLUMN_WORK, of which N and `slip` are read.
        index: index of the column among all columns of the model.
        last_force: (3,) `tangential` of the last tick (N).
    """
    work = t.work
    multiplier = local(3)  # (1 − n nᵀ)TᵀR⁻¹(f − Hα)
    for k in range(3):
        multiplier[k] = dot6(reading_of_force(t, across(column.N, k), index), work.reading_rest)
    w = likely_force(work, index)
    along_slip = (ALONG_SLIP**2 - ACROSS_SLIP**2) * dot3(column.slip, multiplier)
    k = work.dt / (_TANGENTIAL_LAG + work.dt)
    for i in range(3):
        force = w * w * (ACROSS_SLIP**2 * multiplier[i] + along_slip * column.slip[i])
        column.tangential[i] = last_force[i] + k * (force - last_force[i])
