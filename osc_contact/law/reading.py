"""Contact forces from wrist readings, by filter (fig. 5) or least squares."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import (
    backward,
    cholesky,
    cholesky_solve,
    factor_times,
    forward,
    forward_each,
    gram,
    lu_solve,
    project_onto_columns,
    transpose,
)
from osc_contact.law.arm_motion import place_point
from osc_contact.law.contact_friction import ACROSS_SLIP, ALONG_SLIP, likely_force
from osc_contact.law.grasps import filter_reading
from osc_contact.law.jit import inner, local
from osc_contact.law.tangents import (
    across,
    add_rubbing,
    add_yield,
    has_point,
    outboard_times,
    reading_of_force,
)
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    add_square,
    carry_wrench,
    combined,
    copy_rows,
    cross,
    dot6,
    fill,
    fill3,
    join,
    minus,
    minus3,
    motion_to_energy,
    plus,
    rotated,
    rotated9,
    scaled,
    scaled3,
    six,
    turned_back,
    wrench_to_energy,
)

# --- The force path of fig. 5: contact forces from wrist readings ---------------------------------

_ZERO_INERTIA = 1e-9  #: Λ_out relative to the reference inertia that counts as zero


@inner
def add_friction(t):
    """Add friction to the r kept columns of N, the wrenches of unit contact forces: N_μ.

    Column a of N_μ is that of N plus Σ_j share_ja F_j, where F_j is the friction wrench of a unit
    force of the active column j, and share_ja the coefficient of the kept column a in the wrench of
    j. Reads `N_e`, and `share` and `friction_wrench` of the active columns. Fills
    `friction_wrenches` (r, 6; at O, in world axes) and `pushed`, N_μ in energy coordinates (r, 6).

    Args:
        t: Tick.
    """
    work = t.work
    for a in range(work.rank):
        friction = ZERO
        if work.mu != 0.0:  # else there is no friction
            for j in range(work.count):
                column = work.columns[work.chosen[j]]
                friction = add(friction, column.share[a], column.friction_wrench)
        fill(work.friction_wrenches[a], friction)
        fill(work.pushed[a], plus(work.N_e[a], wrench_to_energy(work, friction)))


@inner
def read_wrist(reading, joint, sensor, C):
    """Transform a wrist reading to world axes at the point C; return six numbers (N, N m).

    Args:
        reading: (6,) in the axes and at the origin of the sensor (N, N m).
        joint: JOINT_WORK row of the joint that carries the sensor.
        sensor: (12,) frame of the sensor in that joint: rotation by rows, then origin (m).
        C: (3,) point (m).
    """
    force = rotated(joint.R, rotated9(sensor, reading))
    couple = rotated(joint.R, rotated9(sensor, reading[3:]))
    return carry_wrench(join(force, couple), place_point(joint, sensor[9:]), C)


@inner
def object_wrench(t, k, reading):
    """Wrench (six numbers) of a wrist's reading at the object's centre of mass, in world axes.

    Args:
        t: Tick.
        k: number of an arm with a wrist sensor.
        reading: (6,) in the axes and at the origin of the sensor (N, N m).
    """
    work = t.work
    arm = t.model.arms[k]
    wrench = read_wrist(reading, work.joints[arm.sensor_joint], arm.sensor, work.p_C)
    if arm.filtered:  # the gripper can move by itself, which the reading contains (`filter`)
        wrench = filter_reading(work.axes, work.arms[k].filter, wrench)
    return wrench


@inner
def sum_readings(t):
    """Sum the wrenches that all wrists read, and subtract tare and bias.

    The bias is the wrench that moves the bodies beyond the sensors at a = 0 of the object
    (`bias_out` of `records`). Reads `wrenches` of INPUT, `f_tare` of MEMORY, `filter` of the arms,
    `axes`, `p_C`, `p_O` and `bias_e`. Fills `f_meas` (the sum less tare, at O, in world axes; N, N
    m) and `reading_e`, f_meas less bias in energy coordinates.

    Args:
        t: Tick.
    """
    work = t.work
    total = ZERO
    for k in range(t.model.n_arms):
        if t.model.arms[k].sensor_joint >= 0:
            total = plus(total, object_wrench(t, k, t.input.wrenches[k]))
    fill(work.f_meas, minus(carry_wrench(total, work.p_C, work.p_O), t.memory.f_tare))
    fill(work.reading_e, minus(wrench_to_energy(work, work.f_meas), work.bias_e))


@inner
def measure_magnitudes(t):
    """Compute the contact forces α by the filter of fig. 5, which subtracts inertial forces.

        α = D⁻¹[NᵀΛ_out⁻¹f − n_γ − b_N],   D = NᵀΛ_out⁻¹N_μ + Φ_μ

    f (6,) is the wrench of the wrist sensors less bias, Λ_out (6, 6) the inertia of the bodies
    beyond them, N and N_μ (6, r) the wrenches of unit contact forces without and with friction, Φ_μ
    (r, r) = NᵀΦ_eN_μ the mobility of the touched bodies, n_γ and b_N (r,; m/s²) the normal
    accelerations by the shape of the surfaces and by the motion of the touched bodies. Reads
    `N_basis` and `N_factor` of N, `out_T`, `reading_e`, `pushed`, `Phi_mu`, `n_gamma`, `b_N`. Fills
    `alpha_meas` (r,), `mobility` (D) and `weightless`, which is 1 if no inertia is between sensors
    and contacts. An arm without an object is handled by `_measure_at_tip`.

    Args:
        t: Tick.

    Returns:
        False if Λ_out or D is singular.
    """
    work = t.work
    r = work.rank
    work.weightless = 0
    if not t.model.held:
        return _measure_at_tip(t)
    out_T = local(6, 6)
    response = local(6, 6)
    copy_rows(work.out_T, out_T)  # overwritten by `lu_solve`
    for a in range(r):
        fill(response[a], work.N_basis[a])
    # x = Λ_out⁻ᵀq for each row q of the basis Q: the rows of QᵀΛ_out⁻¹
    if not lu_solve(out_T, 6, response, r):
        return False
    bias_acceleration = local(6)  # Qᵀσ, zero of a held object
    bias_acceleration[:] = 0.0
    # 1.0: bodies beyond the sensors have inertia
    return _solve_magnitudes(t, response, six(work.reading_e), bias_acceleration, 1.0)


@inner
def _solve_magnitudes(t, response, f, bias_acceleration, inertial):
    """Solve for α (r,; N) along an orthonormal basis Q (6, r) of the contact forces, N = Q Lᵀ.

    With Q, nearly dependent columns of N do not reduce the accuracy of the force N α:

        D_Q = QᵀΛ_out⁻¹N_μ + L⁻¹Φ_μ,   D = L D_Q,
        (D_Q L⁻ᵀ) Lᵀα = QᵀΛ_out⁻¹f + Qᵀσ − L⁻¹(n_γ + b_N)

    L (r, r) is the triangular factor, Λ_out the inertia beyond the sensors, N_μ (6, r) is N with
    friction, Φ_μ (r, r) the mobility of the touched bodies, n_γ + b_N (r,; m/s²) the normal
    acceleration at α = 0 that the contacts require. Reads `N_factor`, `pushed`, `Phi_mu`, `n_gamma`
    and `b_N`; fills `alpha_meas` and `mobility`.

    Args:
        t: Tick.
        response: (r, 6) rows of QᵀΛ_out⁻¹.
        f: wrench, six numbers.
        bias_acceleration: (r,) Qᵀσ, the acceleration along Q that does not depend on f. All are in
            energy coordinates.
        inertial: 1, or 0 if no inertia is between sensors and contacts, so that N α = f.

    Returns:
        False if D is singular.
    """
    work = t.work
    r = work.rank
    L = work.N_factor
    D = local(6, 6)
    yielding = local(6, 6)
    required = local(6)
    alpha = local(1, 6)
    for a in range(r):
        # Without inertia `inertial` = 0 leaves out the terms of accelerations.
        required[a] = inertial * (work.n_gamma[a] + work.b_N[a])
        for b in range(r):
            yielding[b, a] = inertial * work.Phi_mu[a, b]
    forward(L, r, required)  # L⁻¹(n_γ + b_N)
    forward_each(L, r, yielding, r)  # L⁻¹Φ_μ
    gram(response, r, work.pushed, r, D)
    for a in range(r):
        for b in range(r):
            D[a, b] += yielding[b, a]
    factor_times(L, r, D, r, work.mobility)
    # right side, then the unknown Lᵀα, then α
    for a in range(r):
        alpha[0, a] = dot6(response[a], f) + bias_acceleration[a] - required[a]
    forward_each(L, r, D, r)
    if not lu_solve(D, r, alpha, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = alpha[0, a]
    backward(L, r, work.alpha_meas)
    return True


@inner
def _measure_at_tip(t):
    """Compute α (r,; N) of an arm that holds no object, from the motions S of its tip alone.

    The tip accelerates by a = Sη̇ + σ, where S (6, d) are its free motions and σ (6,) the
    acceleration by the rotation of S. With the inertia Λ_out beyond the sensor and the reading f
    less bias, `_solve_magnitudes` is called with S(SᵀΛ_outS)⁻¹Sᵀ in place of Λ_out⁻¹, f − Λ_outσ in
    place of f, and Qᵀσ, where Q (6, r) is the basis of the contact forces. Without inertia beyond
    the sensor the reading is the contact wrench. Reads `sigma` and `locked`, and the fields that
    `measure_magnitudes` reads; fills the same fields, of which the caller has set `weightless` to
    0.

    Args:
        t: Tick.

    Returns:
        False if SᵀΛ_outS is singular, or the mobility D of `_solve_magnitudes` is.
    """
    work = t.work
    r = work.rank
    d = 6 - work.locked
    response = local(6, 6)
    bias_acceleration = local(6)
    trace = 0.0
    for i in range(6):
        trace += abs(work.out_T[i, i])
    if trace < _ZERO_INERTIA:
        work.weightless = 1
        for a in range(r):
            bias_acceleration[a] = 0.0
            fill(response[a], work.N_basis[a])
        # 0.0: without inertia accelerations do not matter
        return _solve_magnitudes(t, response, six(work.reading_e), bias_acceleration, 0.0)
    # S by rows, the inertia SᵀΛ_outS, and QᵀS(SᵀΛ_outS)⁻¹ with the basis Q of the contact forces
    S = local(6, 6)
    inertia = local(6, 6)
    response_S = local(6, 6)
    axis = local(6)
    sigma = turned_back(work, work.sigma)
    f = minus(work.reading_e, outboard_times(work, sigma))
    for i in range(d):
        fill(axis, ZERO)
        axis[work.locked + i] = 1.0
        fill(S[i], turned_back(work, axis))
    for i in range(d):
        inertial_force = outboard_times(work, S[i])
        for j in range(d):
            inertia[i, j] = dot6(inertial_force, S[j])
    gram(work.N_basis, r, S, d, response_S)
    if not lu_solve(inertia, d, response_S, r):
        return False
    for a in range(r):
        bias_acceleration[a] = dot6(work.N_basis[a], sigma)
        fill(response[a], combined(response_S[a], S, d))
    return _solve_magnitudes(t, response, f, bias_acceleration, 1.0)


# --- Contact forces by least squares, independent of friction and misplaced normals ---------------
#
# The filter of fig. 5 attributes every contact force to N_μα. Here a force with unknown components
# β may act along the tangents T_j of each point of contact, too, and the acceleration of the object
# may deviate by δ from the desired one a:
#
#     f_meas − bias_out − Λ_out a = N_μα + Σ T_jβ_j + Λ_out δ,   Nᵀδ = 0
#
# This equation has many solutions α, β, δ. The one with the least sum of squares is taken, each
# unknown divided by its typical size: β_j by a coefficient of friction times w_j, the desired force
# of the contact; δ, in the metric of the object's kinetic energy, by σ_a. With f the left-hand
# side,
#
#     R = ΣT_jC_jT_jᵀ + σ_a²m Λ_outPΛ_outᵀ,    α = (N_μᵀR⁻¹N_μ)⁻¹N_μᵀR⁻¹f,
#
# where P projects on the motions that N permits. For σ_a → 0 the acceleration of the object is
# assumed to be known, and α is unique if N is independent of the tangents; for β → 0 the result is
# that of the filter. All weights are physical quantities: no norm adds newtons and newton metres.

_DEPARTURE = 0.1  #: σ_a (m/s²)
_WRIST_NOISE = 0.01  #: noise of a wrist's force (N), in the metric of the object's inertia


@inner
def weigh_magnitudes(t):
    """Compute the contact forces α by least squares, α = (HᵀR⁻¹H)⁻¹HᵀR⁻¹f.

    f (6,) is the reading less bias and less the inertial force Λ_out a of the permitted
    acceleration. H = N_μ + Λ_outN⁺Φ_μ (6, r) is the reading of unit contact forces: N_μ with
    friction, and the inertial force of an object that moves with a yielding body, where Φ_μ (r, r)
    is the mobility of the touched bodies and N⁺ (6, r) the motion of least kinetic energy with a
    unit normal acceleration. R (6, 6) is the covariance of the errors of f. All are in energy
    coordinates. Reads `reading_e`, `pushed` (N_μ), `Phi_mu`, and for Λ_out a and R those that
    `desired_inertia_force` and `_likely_errors` name. Fills `alpha_meas` α (r,; N), `reading_rest`
    R⁻¹(f − Hα) (6,), and, with contact phases, `mobility` (r, r; (m/s²)/N) and `weightless` (1 if
    it does not exist, else 0).

    Args:
        t: Tick.

    Returns:
        False if R is not positive definite, or if columns of H are dependent.
    """
    work = t.work
    r = work.rank
    R = local(6, 6)
    R_factor = local(6, 6)
    H = local(6, 6)
    weighed = local(6, 6)
    normal = local(6, 6)
    alpha = local(1, 6)
    yields = local(6)
    remainder = local(6)
    fill(remainder, minus(work.reading_e, desired_inertia_force(t)))
    largest = _likely_errors(t, R)  # N, largest size of a contact force
    # H, and with it the errors in proportion to the contact forces
    for a in range(r):
        h = six(work.pushed[a])
        if work.moving:
            for b in range(r):
                yields[b] = work.Phi_mu[b, a]
            h = add_yield(work, h, yields)
        fill(H[a], h)
        add_square(1.0, scaled(largest, h), R)
    if not cholesky(R, 0, 6, R_factor) > 0.0:  # also if NaN
        return False
    for a in range(r):  # HᵀR⁻¹
        fill(weighed[a], H[a])
        cholesky_solve(R_factor, 6, weighed[a])
        alpha[0, a] = dot6(weighed[a], remainder)
    gram(weighed, r, H, r, normal)  # HᵀR⁻¹H
    work.weightless = 0
    if t.model.phased:
        _find_mobility(t, weighed, normal)
    if not lu_solve(normal, r, alpha, 1):
        return False
    # f − Hα, then R⁻¹ times it
    for a in range(r):
        work.alpha_meas[a] = alpha[0, a]
        accumulate(remainder, -alpha[0, a], H[a])
    cholesky_solve(R_factor, 6, remainder)
    fill(work.reading_rest, remainder)
    return True


@inner
def _find_mobility(t, weighed, normal):
    """Compute the `mobility` D of least squares: normal acceleration per force that it simulates.

    A normal acceleration x = d(NᵀV_rel)/dt (r,; m/s²) of an object in free flight adds the inertial
    force Λ_outN⁺x to the reading, and therefore D⁻¹x = (HᵀR⁻¹H)⁻¹HᵀR⁻¹Λ_outN⁺x to α. N (6, r) are
    the columns of contact forces, V_rel the twist relative to the touched bodies, N⁺x the motion of
    least kinetic energy with Nᵀa = x, Λ_out the inertia beyond the sensors, H (6, r) the reading of
    unit contact forces and R (6, 6) the covariance of the reading's errors. Reads `N_basis`,
    `N_factor`, `out_T`. Fills `mobility` (r, r; (m/s²)/N); sets `weightless` to 1 if D does not
    exist.

    Args:
        t: Tick.
        weighed: (r, 6) rows of HᵀR⁻¹.
        normal: (r, r) HᵀR⁻¹H.
    """
    work = t.work
    r = work.rank
    A = local(6, 6)
    columns = local(6, 6)
    unit = local(6)
    # D = A⁻¹(HᵀR⁻¹H), A = HᵀR⁻¹Λ_outN⁺; `columns` has the columns of HᵀR⁻¹H as rows
    for b in range(r):
        for a in range(r):
            unit[a] = 1.0 if a == b else 0.0
        reading = add_yield(work, ZERO, unit)
        for a in range(r):
            A[a, b] = dot6(weighed[a], reading)
            columns[b, a] = normal[b, a]
    if not lu_solve(A, r, columns, r):
        work.weightless = 1
    transpose(columns, r, r, work.mobility)


@inner
def desired_inertia_force(t):
    """Inertial force Λ_out a (six numbers, energy coordinates) of the permitted acceleration a.

    Λ_out (6, 6) is the inertia of the bodies beyond the wrist sensors. a is the desired
    acceleration `A_D`, made spatial and projected on the motions with Nᵀa = n_γ + b_N that the
    contacts permit. Reads `A_D`, `V_O`, `n_gamma`, `b_N`, `N_factor`, `N_basis`, `out_T`.

    Args:
        t: Tick.
    """
    work = t.work
    a = local(6)
    required = local(6)
    V = work.V_O
    fill(a, work.A_D)
    fill3(a, minus3(a, cross(V[3:], V)))  # from the classical to the spatial acceleration
    fill(a, motion_to_energy(work, a))
    for b in range(work.rank):
        required[b] = work.n_gamma[b] + work.b_N[b]
    project_onto_columns(work.N_factor, work.N_basis, work.rank, a, required)
    return outboard_times(work, a)


@inner
def _likely_errors(t, R):
    """Fill R with the covariance of the reading's errors; return the largest w_j (N).

        R = σ_a²m Λ_out(1 − QᵀQ)Λ_outᵀ + Σ_j T_jC_jT_jᵀ + the noise of the wrists,
        C_j = w_j²(σ_t²(1 − n nᵀ) + (σ_s² − σ_t²) s sᵀ)

    The first summand is the inertial force by a deviation from the desired acceleration: σ_a =
    `_DEPARTURE` (m/s²) is its typical size, m the object's mass, Λ_out (6, 6) the inertia beyond
    the sensors, and the rows of Q (r, 6) an orthonormal basis of the contact forces. The second has
    the tangential forces of the contacts j: T_j (6, 3) is the reading of a force there, C_j (3, 3;
    N²) its covariance, w_j its typical size (N), n (3,) the normal, and s (3,) the direction of
    slip, shorter than 1 where the contact hardly slides; σ_s = `ALONG_SLIP` and σ_t =
    `ACROSS_SLIP` are typical coefficients of friction along the slip and across it. A pair without
    known points of contact adds `add_rubbing`. Reads `out_T`, `N_basis` (Q), `goal`, and `N`,
    `slip`, `point` of the active columns.

    Args:
        t: Tick.
        R: (6, 6) in energy coordinates, filled.
    """
    work = t.work
    mass = t.model.principal[0]
    variance = _DEPARTURE * _DEPARTURE * mass  # σ_a²m, of the acceleration in energy coordinates
    largest = 0.0
    for i in range(6):  # σ_a²m Λ_outΛ_outᵀ by rows; column i of `out_T` is row i of Λ_out
        fill(R[i], scaled(variance, outboard_times(work, work.out_T[:, i])))
        R[i, i] += _WRIST_NOISE * _WRIST_NOISE / mass
    for a in range(work.rank):  # less the motions that the contacts prevent
        add_square(-variance, outboard_times(work, work.N_basis[a]), R)
    for j in range(work.count):
        index = work.chosen[j]
        column = work.columns[index]
        w = likely_force(work, index)
        largest = max(largest, w)
        if not has_point(t, index):
            add_rubbing(t, index, w * ALONG_SLIP, R)
            continue
        for k in range(3):
            sideways = scaled3(w * ACROSS_SLIP, across(column.N, k))
            add_square(1.0, reading_of_force(t, sideways, index), R)
        along_slip = scaled3(w * sqrt(ALONG_SLIP**2 - ACROSS_SLIP**2), column.slip)
        add_square(1.0, reading_of_force(t, along_slip, index), R)
    return largest
