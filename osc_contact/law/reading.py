"""Contact forces from wrist readings, by filter (fig. 5) or least squares."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import (
    backward,
    cholesky,
    cholesky_solve,
    dot,
    factor_times,
    forward,
    forward_each,
    gram,
    lu_solve,
    project_onto_columns,
    transpose,
)
from osc_contact.law.arm_motion import place_point
from osc_contact.law.grasps import filter_reading
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.records import body_of
from osc_contact.law.tangents import (
    across,
    add_yield,
    has_point,
    outboard_times,
    reading_of_force,
    rub_along,
)
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    accumulate,
    add,
    add_square,
    carry_wrench,
    combined,
    copy_rows,
    cross,
    dot3,
    dot6,
    fill,
    fill3,
    join,
    linear,
    minus,
    minus3,
    motion_to_energy,
    plus,
    rotated,
    rotated9,
    scaled,
    scaled3,
    six,
    turned,
    turned_back,
    wrench_to_energy,
)

# --- The force path of fig. 5: contact forces from wrist readings ---------------------------------

_NOTHING = 1e-9  #: Λ_out relative to the reference inertia that counts as zero


@inner
def add_friction(t):
    """Add friction to the kept columns, N_μ = N + (friction wrenches of all columns) share.

    Reads `N_e`, and `share` and `friction_wrench` of the active columns. Fills `friction_wrenches`
    (r, 6; at O, in world axes) and `pushed`, N_μ in energy coordinates (r, 6).

    Args:
        t: Tick.
    """
    work = t.work
    for a in range(work.rank):
        friction = ZERO
        if work.mu != 0.0:
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
    """Wrench (six numbers) at the object's centre of mass, in world axes, of a wrist's reading.

    Args:
        t: Tick. k: number of an arm with a wrist sensor. reading: (6,) in the axes and at the
            origin of the sensor (N, N m).
    """
    work = t.work
    arm = t.model.arms[k]
    wrench = read_wrist(reading, work.joints[arm.sensor_joint], arm.sensor, work.p_C)
    if arm.filtered:
        wrench = filter_reading(work.axes, work.arms[k].filter, wrench)
    return wrench


@inner
def sum_readings(t):
    """Sum the readings of all wrists, and subtract tare and bias: f_meas − bias_out.

    Reads `wrenches` of INPUT, `filter` of the arms and `bias_e`. Fills `f_meas` (the sum less tare,
    at O, in world axes) and `reading_e`, f_meas − bias_out in energy coordinates.

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
    """Compute α by the filter Ω_f(Λ_out): α = D⁻¹[NᵀΛ_out⁻¹f − n_γ − b_N], D = NᵀΛ_out⁻¹N_μ + Φ_μ.

    f is the reading less bias. Reads `N_basis` and `N_factor` of N, `out_T`, `reading_e`, `pushed`,
    `Phi_mu`, `n_gamma`, `b_N`. Fills `alpha_meas` (r,), `mobility` (D) and `weightless`, which is 1
    if no inertia is between sensors and contacts. An arm without an object is handled by
    `_measure_at_tip`.

    Args:
        t: Tick.

    Returns:
        False if Λ_out is singular.
    """
    work = t.work
    r = work.rank
    work.weightless = 0
    if not t.model.held:
        return _measure_at_tip(t)
    out_T = local(6, 6)
    response = local(6, 6)
    copy_rows(work.out_T, out_T)
    for a in range(r):
        fill(response[a], work.N_basis[a])
    if not lu_solve(out_T, 6, response, r):
        return False
    bias_acceleration = local(6)
    bias_acceleration[:] = 0.0
    return _solve_magnitudes(t, response, six(work.reading_e), bias_acceleration, 1.0)


@inner
def _solve_magnitudes(t, response, f, bias_acceleration, inertial):
    """Solve for α along an orthonormal basis Q of the contact forces, N = Q L.

    With Q, nearly dependent columns do not reduce the accuracy of the force N α:

        D_Q = QᵀΛ_out⁻¹N_μ + L⁻¹Φ_μ,   D = L D_Q,
        (D_Q L⁻ᵀ) Lᵀα = QᵀΛ_out⁻¹f + Qᵀσ − L⁻¹(n_γ + b_N)

    Reads `N_factor`, `pushed`, `Phi_mu`, `n_gamma` and `b_N`; fills `alpha_meas` and `mobility`.

    Args:
        t: Tick. response: (r, 6) rows of QᵀΛ_out⁻¹. f: wrench, six numbers. bias_acceleration: (r,)
            Qᵀσ, the acceleration along Q that does not depend on f. All are in energy coordinates.
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
        required[a] = inertial * (work.n_gamma[a] + work.b_N[a])
        for b in range(r):
            yielding[b, a] = inertial * work.Phi_mu[a, b]
    forward(L, r, required)
    forward_each(L, r, yielding, r)
    gram(response, r, work.pushed, r, D)
    for a in range(r):
        for b in range(r):
            D[a, b] += yielding[b, a]
    factor_times(L, r, D, r, work.mobility)
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
    """Compute α of an arm that holds no object, from the motions S of its tip alone.

    S(SᵀΛ_outS)⁻¹Sᵀ takes the place of Λ_out⁻¹, and f − Λ_outσ that of f, since a = Sη̇ + σ. Without
    inertia outboard of the sensor, the reading is the contact wrench. Reads `sigma` and `locked`,
    and the fields that `measure_magnitudes` reads; fills the same fields.

    Args:
        t: Tick.

    Returns:
        False if the outboard inertia along S, or D, is singular.
    """
    work = t.work
    r = work.rank
    d = 6 - work.locked
    response = local(6, 6)
    bias_acceleration = local(6)
    trace = 0.0
    for i in range(6):
        trace += abs(work.out_T[i, i])
    if trace < _NOTHING:
        work.weightless = 1
        for a in range(r):
            bias_acceleration[a] = 0.0
            fill(response[a], work.N_basis[a])
        return _solve_magnitudes(t, response, six(work.reading_e), bias_acceleration, 0.0)
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

_ALONG = 0.3  #: typical error of the coefficient of friction along the slip
_ACROSS = 0.1  #: typical coefficient across the slip; also the tangent of an error of the normal
_DEPARTURE = 0.1  #: σ_a (m/s²)
_LEAST_FORCE = 1.0  #: least w_j (N)
_LAG = 0.005  #: s, time constant of the low-pass of tangential forces
_REACTION = 0.5  #: largest reaction to tangential forces, as a share of the desired force
_FIRST = 0.005  #: T_1 (s), weight of the assumed coefficient, as a time of sliding
_MOST_FRICTION = 2.0  #: largest coefficient of friction that is identified
_NOISE = 0.01  #: noise of a wrist's force (N), in the metric of the object's inertia


@inner
def weigh_magnitudes(t):
    """Compute α by least squares, α = (HᵀR⁻¹H)⁻¹HᵀR⁻¹f, with H = N_μ + Λ_outN⁺Φ_μ.

    f is the reading less bias and less Λ_out a; the second summand of H is the inertial force of
    an object that moves with a yielding body. Reads `reading_e`, `pushed`, `Phi_mu`, and the fields
    that `desired_inertia_force` and `_likely_errors` read. Fills `alpha_meas` (r,), `reading_rest`
    R⁻¹(f − Hα) (6,), `weightless` and, with contact phases, `mobility`.

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
    largest = _likely_errors(t, R)
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
    gram(weighed, r, H, r, normal)
    work.weightless = 0
    if t.model.phased:
        _find_mobility(t, weighed, normal)
    if not lu_solve(normal, r, alpha, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = alpha[0, a]
        accumulate(remainder, -alpha[0, a], H[a])
    cholesky_solve(R_factor, 6, remainder)
    fill(work.reading_rest, remainder)
    return True


@inner
def _find_mobility(t, weighed, normal):
    """Compute the `mobility` D of least squares: normal acceleration per force that it simulates.

    A normal acceleration x = d(NᵀV_rel)/dt of an object in free flight adds Λ_outN⁺x to the
    reading, where N⁺x is the motion of least kinetic energy, and therefore
    D⁻¹x = (HᵀR⁻¹H)⁻¹HᵀR⁻¹Λ_outN⁺x to α. Reads `N_basis`, `N_factor`, `out_T`. Fills `mobility`
    (r, r); sets `weightless` to 1 if D does not exist.

    Args:
        t: Tick. weighed: (r, 6) rows of HᵀR⁻¹. normal: (r, r) HᵀR⁻¹H.
    """
    work = t.work
    r = work.rank
    A = local(6, 6)
    columns = local(6, 6)
    unit = local(6)
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
def learn_friction(t):
    """Update the coefficient of friction μ by the tangential forces measured along the slip.

        dμ/dt = k Σw_j s_jᵀβ_j / Σw_j²,   β_j = C_jT_jᵀR⁻¹(f − N_μα)

    Contacts at rest (s_j = 0) do not change μ. In the beginning k = 1/(T_1 + T), more than
    `learning`, so that μ is the mean of all readings; T = ∫Σw_jα_j(1 − ρ_j)/Σw_j² dt is the time of
    sliding under the desired forces, with ρ_j = `rests`. This faster start is not used while
    normals are estimated, because a tilted face initially causes the same forces as friction.

    Reads `alpha_meas`, `reading_rest` and `slip`, `rests`, `prior` of the active columns. Updates
    `more_friction` and `slid` (T).

    Args:
        t: Tick.
    """
    model = t.model
    work = t.work
    if model.learning == 0.0:
        return
    dependent = work.rank < work.count
    friction = sliding = square = normal_variance = 0.0
    for j in range(work.count):
        index = work.chosen[j]
        if not has_point(t, index):
            continue
        column = work.columns[index]
        s = column.slip
        w = _likely_force(work, index)
        slip_square = dot3(s, s)
        share = (_ALONG**2 - _ACROSS**2) * slip_square + _ACROSS**2
        multiplier = dot6(reading_of_force(t, linear(s), index), work.reading_rest)  # sᵀTᵀR⁻¹(…)
        friction += w * w * w * share * multiplier
        pressing = 0.0 if dependent else min(max(work.alpha_meas[j], 0.0), w)
        sliding += w * pressing * (1.0 - column.rests)
        square += w * w
        normal_variance += column.prior[0] + column.prior[4] + column.prior[8]
    if not square > 0.0:  # also if NaN
        return
    k = model.learning
    if not normal_variance > 0.0 and not dependent:  # also if NaN
        k = max(k, 1.0 / (_FIRST + work.slid))
        work.slid += work.dt * sliding / square
    excess = work.more_friction + min(k * work.dt, 1.0) * friction / square
    work.more_friction = min(max(excess, -model.mu), _MOST_FRICTION - model.mu)


@leaf
def _likely_force(work, index):
    """Typical size w_j (N) of the force of a column of N: its desired force, at least 1 N.

    It is the unit in which friction forces of the contact are weighted in least squares.

    Args:
        work: WORK, of which `goal` is read. index: index of the column among all columns of the
            model.
    """
    return max(abs(work.goal[index]), _LEAST_FORCE)


@inner
def oppose_friction(t):
    """Compute `reaction`, the contact force D⁻¹Nᵀ(Φ_0 + Φ_e)f_t caused by tangential forces f_t.

    D = Nᵀ(Φ_0 + Φ_e)N_μ. f_t = Σ ρ_jT_jβ_j, with ρ_j = `rests`, has the tangential forces of
    contacts that stick or hardly slide, as far as μ does not explain them:
    β_j = C_jT_jᵀR⁻¹(f − N_μα), measured up to the last tick and low-passed. f_t itself is not
    compensated, because that would push on contacts that stick. The reaction is limited to half of
    the desired force.

    Reads `N_t`, `pushed_t`, `Lambda`, `Phi_mu`, `yields`, `reading_rest`, `alpha_d`, and
    `tangential` of MEMORY. Fills `reaction` (r,) in N, and `tangential` of the columns for the next
    tick.

    Args:
        t: Tick.
    """
    work = t.work
    m = work.locked
    d = 6 - m
    r = work.rank
    x = local(1, 6)
    tangential_wrench = local(6)
    wrench = ZERO
    for a in range(r):
        x[0, a] = 0.0
    for j in range(t.model.n_columns):
        fill3(work.columns[j].tangential, ZERO_3)
    for j in range(work.count):
        index = work.chosen[j]
        if not has_point(t, index):
            continue
        column = work.columns[index]
        last_force = t.memory.columns[index].tangential
        resting = scaled3(column.rests, last_force)
        f = join(resting, cross(column.point, resting))
        wrench = plus(wrench, turned(work, wrench_to_energy(work, f)))
        if work.moving:
            for a in range(r):
                if body_of(t, work.kept[a]).same == body_of(t, index).same:
                    x[0, a] += dot6(work.yields[a], f)
        _find_tangential(t, column, index, last_force)
    fill(tangential_wrench, wrench)
    factor = local(6, 6)
    D = local(6, 6)
    response = local(6)
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
        limit = _REACTION * abs(work.alpha_d[a])
        work.reaction[a] = min(max(x[0, a], -limit), limit) if solvable else 0.0


@inner
def _find_tangential(t, column, index, last_force):
    """Low-pass the tangential force β_j of a contact.

    Reads `reading_rest`; fills `tangential` of the column (N, world axes).

    Args:
        t: Tick. column: COLUMN_WORK. index: index of the column. last_force: (3,) `tangential` of
            the last tick (N).
    """
    work = t.work
    multiplier = local(3)
    for k in range(3):
        multiplier[k] = dot6(reading_of_force(t, across(column.N, k), index), work.reading_rest)
    w = _likely_force(work, index)
    along_slip = (_ALONG**2 - _ACROSS**2) * dot3(column.slip, multiplier)
    k = work.dt / (_LAG + work.dt)
    for i in range(3):
        force = w * w * (_ACROSS**2 * multiplier[i] + along_slip * column.slip[i])
        column.tangential[i] = last_force[i] + k * (force - last_force[i])


@inner
def desired_inertia_force(t):
    """Inertial force Λ_out a (six numbers, energy coordinates) of the permitted acceleration a.

    a is the desired acceleration, projected on the motions that the contacts permit. Reads `A_D`,
    `V_O`, `n_gamma`, `b_N`, `N_factor`, `N_basis`, `out_T`.

    Args:
        t: Tick.
    """
    work = t.work
    a = local(6)
    required = local(6)
    V = work.V_O
    fill(a, work.A_D)
    fill3(a, minus3(a, cross(V[3:], V)))
    fill(a, motion_to_energy(work, a))
    for b in range(work.rank):
        required[b] = work.n_gamma[b] + work.b_N[b]
    project_onto_columns(work.N_factor, work.N_basis, work.rank, a, required)
    return outboard_times(work, a)


@inner
def _likely_errors(t, R):
    """Fill R with the covariance of the reading's errors; return the largest w_j (N).

    R = σ_a²m Λ_out(1 − QᵀQ)Λ_outᵀ + ΣT_jC_jT_jᵀ + the noise of the wrists, with
    C_j = w_j²(σ_t²(1 − nnᵀ) + (σ_s² − σ_t²) ssᵀ), where s is the direction of slip, shorter than 1
    where the contact hardly slides. Reads `out_T`, `N_basis` (Q), `goal`, and `N`, `slip`, `point`
    of the active columns.

    Args:
        t: Tick. R: (6, 6) in energy coordinates, filled.
    """
    work = t.work
    mass = t.model.principal[0]
    share = _DEPARTURE * _DEPARTURE * mass
    largest = 0.0
    for i in range(6):
        fill(R[i], scaled(share, outboard_times(work, work.out_T[:, i])))
        R[i, i] += _NOISE * _NOISE / mass
    for a in range(work.rank):
        add_square(-share, outboard_times(work, work.N_basis[a]), R)
    for j in range(work.count):
        index = work.chosen[j]
        column = work.columns[index]
        w = _likely_force(work, index)
        largest = max(largest, w)
        if not has_point(t, index):
            _add_hold(t, index, w, R)
            continue
        for k in range(3):
            sideways = scaled3(w * _ACROSS, across(column.N, k))
            add_square(1.0, reading_of_force(t, sideways, index), R)
        along_slip = scaled3(w * sqrt(_ALONG**2 - _ACROSS**2), column.slip)
        add_square(1.0, reading_of_force(t, along_slip, index), R)
    return largest


@inner
def _add_hold(t, index, w, R):
    """Add to R the likely friction along the freedoms of a pair without known points of contact.

    Args:
        t: Tick. index: index of a column of N of the pair. w: typical size of its force (N).
        R: (6, 6) covariance of wrist readings in energy coordinates, changed.
    """
    c = t.model.columns[index].contact
    for k in range(t.model.pairs[c].freedoms):
        add_square(1.0, rub_along(t, w * _ALONG, k, c), R)
