"""Detection of a new contact while others are closed: force that their friction cannot explain.

While contacts are closed, an approach to another one pushes against their static friction, and the
wrists measure this reaction. With n one of the approached columns, the reading

    f_meas − bias_out − Λ_out V̇_O = N α + Σ T_jβ_j + ν,   |β_j| ≤ μ_b α_j over the closed contacts

is weighted by the inverse of R = Σ(μ_b α_j)² T_jT_jᵀ + 3² cov ν: α_n = gᵀf, where gᵀ is the row n
of (NᵀR⁻¹N)⁻¹NᵀR⁻¹. V̇_O is measured: a tool that sticks and slips accelerates by more than is
desired. Reading and derivative pass the same low-pass, so that V̇_O = (V_O − V_f)/`lag` with the
low-passed twist V_f. ν is the noise of the wrists, at the sensors and reduced by the low-pass, and
the moment of the closed contacts' forces about points that are known to `_POINT` only. Friction
changes α_n by at most e = μ_b Σα_j‖gᵀT_j‖, and ν by more than 3σ, σ² = gᵀ(cov ν)g, hardly ever. If
the lines of action do not meet, g is nearly orthogonal to the friction forces and e is small; if
they meet, e is μ_b times the force of the closed contact. Contact is made when α_n − e, low-passed,
exceeds both `force_on`, the threshold of an ordinary contact, and 3σ, with Λ_out V̇_O and without
it: estimated speeds lag, so that V̇_O of a tool that sticks and slips may have the wrong sign.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, gram, lu_solve
from osc_contact.law.jit import inner, local
from osc_contact.law.phases import APPROACHING, CLOSED
from osc_contact.law.reading import object_wrench
from osc_contact.law.records import body_of, contact_of
from osc_contact.law.tangents import across, has_point, outboard_times, reading_of_force, rub_along
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    add_square,
    axis3,
    combined,
    cross,
    dot6,
    energy_wrench,
    fill,
    fill3,
    join,
    linear,
    minus,
    minus3,
    motion_to_energy,
    scaled,
    scaled3,
    wrench_to_energy,
)

_FORCE_NOISE = 0.2  #: N, of one reading of the wrists
_COUPLE_NOISE = 0.01  #: N m
_POINT = 5e-4  #: m, error of the points at which closed contacts press
_SURE_DEVIATIONS = 3.0  #: standard deviations of α_n that noise hardly ever exceeds


@inner
def measure_approached_forces(t):
    """Compute the measured force of each approached column, and the part that other forces explain.

    Reads `phase` of the contacts, `alpha_meas`, `reading_e`, `N`, `pushed`, `V_O`, `out_T`,
    `filtered_twist`, and the fields that `reading_of_force` reads. Fills the fields of
    `_estimate_approached_forces` (N) of the active columns: `touch`, the force by the reading
    alone; `touch_inertia`, the inertial force in it; and `explained`, the part that friction of
    other contacts or noise may cause. All are 0 unless one contact is approached while friction may
    act at another one, and all columns are independent.

    Args:
        t: Tick.
    """
    work = t.work
    is_needed = False
    for i in range(work.count):
        column = work.chosen[i]
        is_needed = is_needed or (
            contact_of(t, column).phase == APPROACHING and _has_other_contact(t, column)
        )
        work.columns[column].touch = 0.0
        work.columns[column].touch_inertia = 0.0
        work.columns[column].explained = 0.0
    if is_needed and work.rank == work.count and t.model.friction_bound > 0.0:
        _estimate_approached_forces(t)


@inner
def _has_other_contact(t, column):
    """Determine whether friction may act at an active contact other than that of a column of N.

    Args:
        t: Tick.
        column: index of the column among all columns of the model.
    """
    may_rub = False
    for i in range(t.work.count):
        other = t.work.chosen[i]
        same_contact = t.model.columns[other].contact == t.model.columns[column].contact
        may_rub = may_rub or (not same_contact and _may_rub(t, other))
    return may_rub


@inner
def _estimate_approached_forces(t):
    """Estimate the forces of approached columns from a reading, while other contacts rub.

    The force is gᵀ(reading), a weighted least-squares estimate: gᵀ is the column's row of
    (NᵀR⁻¹N)⁻¹NᵀR⁻¹, with N (6, r) the wrenches of unit forces with their friction, and R (6, 6) the
    covariance of the other contacts' friction and of `_SURE_DEVIATIONS` times the noise. Fills, for
    approached columns beside which another contact may rub, `touch` (N), gᵀ times the reading less
    bias, and `touch_inertia` (N), the part of it that the measured acceleration of the object
    causes. Adds to `explained` (N) the part that needs no new contact: the largest contribution of
    friction (`_bound_friction`), and `_SURE_DEVIATIONS` standard deviations of the noise as far as
    they are above `force_on`.

    Args:
        t: Tick.
    """
    work = t.work
    r = work.rank
    R = local(6, 6)
    noise = local(6, 6)
    factor = local(6, 6)
    N = local(6, 6)
    matrix_of_equations = local(6, 6)
    weighed = local(6, 6)
    normal = local(6, 6)
    row_of_inverse = local(1, 6)
    inertia = local(6)
    g = local(6)
    fill(inertia, _measured_inertia_force(t))
    _add_noise(t, noise)
    _add_friction(t, noise, R)
    if not cholesky(R, 0, 6, factor) > 0.0:  # also if NaN
        return
    for a in range(r):  # N by rows; `weighed` becomes NᵀR⁻¹, `normal` NᵀR⁻¹N
        fill(N[a], work.pushed[a])
        fill(weighed[a], N[a])
        cholesky_solve(factor, 6, weighed[a])
    gram(N, r, weighed, r, normal)
    for a in range(r):
        column = work.chosen[a]
        if contact_of(t, column).phase != APPROACHING or not _has_other_contact(t, column):
            continue
        for b in range(r):  # a copy of `normal`, since `lu_solve` overwrites it
            row_of_inverse[0, b] = 1.0 if a == b else 0.0
            for c in range(r):
                matrix_of_equations[b, c] = normal[b, c]
        if not lu_solve(matrix_of_equations, r, row_of_inverse, 1):
            return
        fill(g, combined(row_of_inverse[0], weighed, r))  # row a of (NᵀR⁻¹N)⁻¹NᵀR⁻¹
        row = work.columns[column]
        row.touch = dot6(g, work.reading_e)
        row.touch_inertia = dot6(g, inertia)
        row.explained += _bound_friction(t, a, g)
        spread = _SURE_DEVIATIONS * sqrt(max(dot6(g, combined(g, noise, 6)), 0.0))
        row.explained += max(spread - t.model.force_on, 0.0)  # `force_on` covers so much of it


@inner
def _add_friction(t, noise, R):
    """Fill the covariance of the errors of a reading by noise and by friction of closed contacts.

        R = Σ_j (μ_b α_j)² T_jT_jᵀ + 3² cov ν

    μ_b = `friction_bound` is a bound of the coefficient of friction, α_j the measured force of a
    contact j (N), T_j (6, 3) the readings of unit tangential forces there, ν the noise of a
    reading.

    Args:
        t: Tick, of which `alpha_meas` is read.
        noise: (6, 6) covariance of ν.
        R: (6, 6), filled; as `noise` in energy coordinates.
    """
    work = t.work
    for i in range(6):
        fill(R[i], scaled(_SURE_DEVIATIONS * _SURE_DEVIATIONS, noise[i]))
    for a in range(work.rank):
        column = work.chosen[a]
        if _may_rub(t, column):
            size = t.model.friction_bound * _pressing_force(t, a)
            for k in range(_friction_directions(t, column)):
                add_square(1.0, _friction_reading(t, column, k, size), R)


@inner
def _bound_friction(t, a, g):
    """Bound the part of an approached column's force that friction of other contacts may cause (N).

    The bound is μ_b Σ_j α_j‖gᵀT_j‖ over the other contacts j, with μ_b = `friction_bound`, their
    measured forces α_j (N), and the readings T_j (6, 3) of unit tangential forces.

    Args:
        t: Tick, of which `alpha_meas` is read.
        a: index of the approached column n among the kept ones.
        g: (6,) row of (NᵀR⁻¹N)⁻¹NᵀR⁻¹ for this column, in energy coordinates.
    """
    work = t.work
    bound = 0.0
    for b in range(work.rank):
        column = work.chosen[b]
        if b != a and _may_rub(t, column):
            size = t.model.friction_bound * _pressing_force(t, b)
            square = 0.0
            for k in range(_friction_directions(t, column)):
                component = dot6(g, _friction_reading(t, column, k, size))
                square += component * component
            bound += sqrt(square)
    return bound


@inner
def _measured_inertia_force(t):
    """Compute the inertial force Λ_out a of the measured, low-passed acceleration of the object.

        a = (V_O − LP V_O)/(T + dt) − [ω × v; 0]

    LP V_O = `filtered_twist` is the twist V_O = (v, ω) of the object after a first-order low-pass
    with the time constant T = `lag`, so that the quotient is the low-passed rate of V_O; the last
    summand makes it spatial. Λ_out (6, 6) is the inertia beyond the wrist sensors. Reads `V_O` and
    `out_T` of WORK, and `filtered_twist` of MEMORY.

    Args:
        t: Tick.

    Returns:
        Six numbers in energy coordinates.
    """
    work = t.work
    V = work.V_O
    a = local(6)
    fill(a, scaled(1.0 / (t.model.lag + work.dt), minus(V, t.memory.filtered_twist)))
    fill3(a, minus3(a, cross(V[3:], V)))  # spatial acceleration
    return outboard_times(work, motion_to_energy(work, a))


@inner
def _add_noise(t, noise):
    """Fill the covariance of the errors of a reading by sensors and by misplaced points of contact.

    Wrists have the standard deviations `_FORCE_NOISE` (N) and `_COUPLE_NOISE` (N m); points of
    closed contacts are known to `_POINT` (m), and the measured force α there has the moment α times
    this error.

    Args:
        t: Tick.
        noise: (6, 6) in energy coordinates, filled; of a reading that is low-passed with the time
            constant `lag`.
    """
    work = t.work
    f = local(6)
    # A low-pass leaves the share dt/(2 lag) of the variance of white noise.
    averaging = sqrt(min(0.5 * work.dt / t.model.lag, 1.0)) if t.model.lag > 0.0 else 1.0
    for i in range(6):
        fill(noise[i], ZERO)
    for k in range(t.model.n_arms):
        for i in range(6 if t.model.arms[k].sensor_joint >= 0 else 0):
            fill(f, ZERO)
            f[i] = averaging * (_FORCE_NOISE if i < 3 else _COUPLE_NOISE)
            add_square(1.0, energy_wrench(work.axes, object_wrench(t, k, f)), noise)
    for a in range(work.rank):
        column = work.chosen[a]
        if _may_rub(t, column) and has_point(t, column):
            N = work.columns[column].N
            size = _POINT * _pressing_force(t, a)
            for k in range(3):  # moments of the force about a point beside the one that is known
                couple = join(ZERO_3, scaled3(size, cross(axis3(k), linear(N))))
                add_square(1.0, wrench_to_energy(work, couple), noise)


@inner
def _may_rub(t, column):
    """Determine whether friction of a contact may act: it is closed, or returns after its loss.

    Args:
        t: Tick.
        column: index of a column of N of the contact.
    """
    phase = contact_of(t, column).phase
    is_lost = t.memory.columns[column].time_since_loss > 0.0
    return phase == CLOSED or (phase == APPROACHING and is_lost)


@inner
def _friction_directions(t, column):
    """Number of directions in which friction of a contact may act.

    It is 3, the axes of the world projected on the face, at a point of contact; else the number of
    motions that the pair permits.

    Args:
        t: Tick.
        column: index of a column of N of the contact.
    """
    if has_point(t, column):
        return 3
    return t.model.pairs[t.model.columns[column].contact].freedoms


@inner
def _friction_reading(t, column, k, size):
    """Reading (six numbers, energy coordinates) of a friction force at a contact.

    Args:
        t: Tick.
        column: column of N of the contact.
        k: axis of the world, along whose projection on the face the force acts; of a pair without
            points of contact, number of its freedom.
        size: magnitude of the force before projection (N).
    """
    if has_point(t, column):
        return reading_of_force(t, scaled3(size, across(t.work.columns[column].N, k)), column)
    return rub_along(t, size, k, t.model.columns[column].contact)


@inner
def _pressing_force(t, a):
    """Measured force (N) of a kept column, as a magnitude; 0 if it can only push and reads below 0.

    Args:
        t: Tick, of which `alpha_meas` is read.
        a: index of the column among the kept ones.
    """
    alpha = t.work.alpha_meas[a]
    return max(alpha, 0.0) if body_of(t, t.work.chosen[a]).pushes else abs(alpha)
