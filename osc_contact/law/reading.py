"""Contact forces from wrist readings, by filter (fig. 5) or least squares; the force law."""

from __future__ import annotations

from math import inf, sqrt

from osc_contact.law.algebra import (
    cholesky,
    cholesky_solve,
    lu_solve,
    project_onto_constraint,
    solve_lower,
    solve_lower_transposed,
)
from osc_contact.law.arm_motion import place_point
from osc_contact.law.grasps import filter_reading
from osc_contact.law.jit import inner, leaf
from osc_contact.law.vectors import (
    ZERO,
    add,
    carry_motion,
    carry_wrench,
    cross,
    dot6,
    energy_motion,
    energy_wrench,
    fill,
    minus,
    plus,
    reflect,
    reflect_back,
    scaled,
    six,
)

# --- The force path of fig. 5: wrist readings to contact magnitudes, and the force law ------------

_WINDUP = 1.5  #: times the command, of the force integral
_LEAST = 0.1  #: times the command: more than that is never the least command of a contact
_NOTHING = 1e-9  #: Λ_out beside the object's inertia, below which sensors read f_c itself


@inner
def add_friction(t):
    """N_μ = N + D share of the kept columns, _e (`pushed`), D share at O (`friction_wrenches`)."""
    columns = t.work.columns
    work = t.work
    r = work.rank
    count = work.count
    for a in range(r):
        friction_wrenches = work.friction_wrenches[a]
        pushed = work.pushed[a]
        fill(friction_wrenches, ZERO)
        fill(pushed, work.N[a])
        if work.mu == 0.0:
            continue
        for j in range(count):
            s = columns[j].share[a] if r < count else (1.0 if j == a else 0.0)
            fill(
                friction_wrenches,
                add(friction_wrenches, s, columns[columns[j].chosen].friction_wrench),
            )
        carry_wrench(friction_wrenches, work.O, work.C, work.u)
        energy_wrench(work.axes, work.u, work.u)
        fill(pushed, plus(pushed, work.u))


@inner
def add_reading(reading, joint, sensor, C, scratch, total):
    """Add one wrist's reading (6,), rotated to world axes and carried to C.

    Args:
        reading: (6,) of the wrist. joint: JOINT_WORK record of the sensor's. sensor: (12,) rotation
            (row by row) and position of the sensor in it. C: (3,) point (m). scratch: (≥ 9,).
        total: (6,) wrench at C, added to.
    """
    point = scratch[6:9]
    world = scratch[:6]
    R = joint.R
    place_point(joint, sensor, 9, point)
    for half in range(2):
        x = reading[3 * half]
        y = reading[3 * half + 1]
        z = reading[3 * half + 2]
        a = sensor[0] * x + sensor[1] * y + sensor[2] * z
        b = sensor[3] * x + sensor[4] * y + sensor[5] * z
        c = sensor[6] * x + sensor[7] * y + sensor[8] * z
        for i in range(3):
            world[3 * half + i] = R[i, 0] * a + R[i, 1] * b + R[i, 2] * c
    carry_wrench(world, point, C, world)
    fill(total, plus(total, world))


@inner
def sum_readings(t):
    """f_meas (6,) = Σ wrist readings less tare, at O; `reading_e`: the same less bias, energy."""
    work = t.work
    wrenches = t.input.wrenches
    total = work.reading_e
    own = work.y
    fill(total, ZERO)
    for k in range(t.model.n_arms):
        arm = t.model.arms[k]
        if arm.sensor_joint < 0:
            continue
        joint = t.work.joints[arm.sensor_joint]
        if arm.filtered != 0:
            fill(own, ZERO)
            add_reading(wrenches[k], joint, arm.sensor, work.C, work.s, own)
            filter_reading(work.axes, t.work.arms[k].filter, own, work.u)
            fill(total, plus(total, own))
        else:
            add_reading(wrenches[k], joint, arm.sensor, work.C, work.s, total)
    f_meas = work.f_meas
    carry_wrench(total, work.C, work.O, f_meas)
    fill(f_meas, minus(f_meas, t.memory.f_tare))
    carry_wrench(f_meas, work.O, work.C, total)
    energy_wrench(work.axes, total, total)
    fill(total, minus(total, work.bias_e))


@inner
def measure_magnitudes(t):
    """α (r,) = D⁻¹[NᵀΛ_out⁻¹f − n_γ − b_N], D = NᵀΛ_out⁻¹N_μ + Φ_μ: the filter Ω_f(Λ_out).

    f is the reading less bias. Solved in the orthonormal basis Q of the rows of N = L Q, so that
    nearly dependent columns cost no digits of the force Nα. Where nothing is held see
    `_measure_at_tip`. False: Λ_out is singular.
    """
    work = t.work
    r = work.rank
    work.weightless = 0
    for a in range(r):
        work.z[a] = 0.0
        fill(work.solved[a], six(work.Q[a]))
    if t.model.held == 0:
        return _measure_at_tip(t)
    for i in range(6):
        fill(work.B[i], six(work.out_T[i]))
    if not lu_solve(work.B, 6, work.solved, r):  # rows: Λ_out⁻ᵀ q
        return False
    return _solve_magnitudes(t, 1.0)


@inner
def _solve_magnitudes(t, inertial):
    """The rest of it: `solved` holds Λ_out⁻ᵀ q for each row q of Q, `z` qᵀσ.

    inertial: 1; 0 where nothing between sensor and contact has inertia: then N α = f.
    """
    work = t.work
    r = work.rank
    D = work.D
    E = work.E
    L = work.L
    f = work.reading_e
    for a in range(r):
        for b in range(r):
            D[a, b] = dot6(work.solved[a], work.pushed[b])
            E[b, a] = inertial * work.Phi_mu[a, b]
        work.w[a] = inertial * (work.n_gamma[a] + work.b_N[a])
    solve_lower(L, r, work.w)
    for b in range(r):  # columns of L⁻¹Φ_μ
        solve_lower(L, r, E[b])
        for a in range(r):
            D[a, b] += E[b, a]
    for a in range(r):
        for b in range(r):
            s = 0.0
            for c in range(a + 1):
                s += L[a, c] * D[c, b]
            work.mobility[a, b] = s
    alpha = work.A
    for a in range(r):
        alpha[0, a] = dot6(work.solved[a], f) + work.z[a] - work.w[a]
        solve_lower(L, r, D[a])  # a row of D L⁻ᵀ
    if not lu_solve(D, r, alpha, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = alpha[0, a]
    solve_lower_transposed(L, r, work.alpha_meas)
    return True


@inner
def _measure_at_tip(t):
    """Where nothing is held: sensors see the tip in its own motions S only, or f_c itself.

    S(SᵀΛ_outS)⁻¹Sᵀ takes the place of Λ_out⁻¹, and a = Sη̇ + σ has a further part.
    """
    work = t.work
    r = work.rank
    m = work.locked
    f = work.reading_e
    A = work.B
    trace = 0.0
    for i in range(6):
        fill(A[i], work.out_T[i])
        trace += abs(A[i, i])
    if trace < _NOTHING:
        work.weightless = 1
        return _solve_magnitudes(t, 0.0)
    reflectors = work.reflectors
    beta = work.beta
    for j in range(6):  # A = Λ_outᵀ, turned from both sides
        for i in range(6):
            work.u[i] = A[i, j]
        reflect(reflectors, beta, m, work.u)
        for i in range(6):
            A[i, j] = work.u[i]
    for i in range(6):
        reflect(reflectors, beta, m, A[i])
    reflect(reflectors, beta, m, f)
    for i in range(6):  # f less Λ_out σ
        for j in range(6):
            f[i] -= A[j, i] * work.sigma[j]
    for a in range(r):
        reflect(reflectors, beta, m, work.pushed[a])
        reflect(reflectors, beta, m, work.solved[a])
        work.z[a] = dot6(work.solved[a], work.sigma)
        for i in range(6 - m):
            work.E[a, i] = work.solved[a, m + i]
    for i in range(6 - m):
        for j in range(6 - m):
            work.D[i, j] = A[m + i, m + j]
    if not lu_solve(work.D, 6 - m, work.E, r):
        return False
    for a in range(r):
        for i in range(6):
            work.solved[a, i] = work.E[a, i - m] if i >= m else 0.0
    done = _solve_magnitudes(t, 1.0)
    for a in range(r):
        reflect_back(reflectors, beta, m, work.pushed[a])
    return done


@leaf
def integral_room(most, desired):
    """N; the force integral stays within ± that."""
    return max(_WINDUP * abs(desired), most)


@inner
def command_force(t):
    """α_u = α_d + K_i ∫(α_d − α_meas) dt − K_v NᵀV_rel ≥ min(α_min, α_d/10); `force_next`.

    The integral stays within `integral_force` (N), or `_WINDUP` times the command where that is
    more. A force that rises begins with less than its floor.
    """
    work = t.work
    for a in range(work.rank):
        desired = work.alpha_d[a]
        before = work.w[a]
        room = integral_room(t.model.integral_force, desired)
        after = before + work.gain[a] * work.dt * (desired - work.felt[a])
        after = min(max(after, -room), room)
        force = desired + after - work.damping[a] * work.speed[a]
        floor = min(work.least[a], _LEAST * desired)
        if force < floor:
            force = floor
            after = max(after, before)
        work.alpha_u[a] = force
        work.force_next[a] = after


@inner
def contact_laws(t):
    """Gain, damping, brake κ and least command (r,) of the kept columns, from their contacts.

    Where columns depend on one another the most careful of all hold for each of them.
    """
    table = t.model.columns
    contacts = t.memory.contacts
    columns = t.work.columns
    work = t.work
    r = work.rank
    count = work.count
    for a in range(r):
        law = contacts[table[columns[int(work.keep[a])].chosen].contact]
        work.gain[a] = law.gain
        work.damping[a] = law.damping
        work.least[a] = law.least
        work.brake[a] = law.brake
    if r == count:
        return
    gain = inf
    damping = -inf
    brake = -inf
    for j in range(count):
        law = contacts[table[columns[j].chosen].contact]
        gain = min(gain, law.gain)
        damping = max(damping, law.damping)
        brake = max(brake, law.brake)
    for a in range(r):
        work.gain[a] = gain
        work.damping[a] = damping
        work.least[a] = -inf
        work.brake[a] = brake


# --- Contact forces by least squares, independent of friction and misplaced normals ---------------
#
# The filter of fig. 5 takes whatever pushes on the object at a contact for N_μα. Here each point of
# contact may push along its tangents, too, by an unknown β, and the object may depart by δ from the
# acceleration a desired of it:
#
#     f_meas − bias_out − Λ_out a = N_μα + Σ T_jβ_j + Λ_out δ,   Nᵀδ = 0
#
# Of all α, β and δ that explain the reading those are taken that make the sum of squares least,
# each in the scale in which it is likely: β_j in w_j times a coefficient of friction, w_j the
# desired force of the contact; δ, by the kinetic energy of the object, in σ_a. With f all that is
# read but N_μα,
#
#     R = ΣT_jC_jT_jᵀ + σ_a²m Λ_outPΛ_outᵀ,    α = (N_μᵀR⁻¹N_μ)⁻¹N_μᵀR⁻¹f,
#
# P the motions that N permits. As σ_a → 0 the object's acceleration is known, and where N is
# independent of the tangents α follows uniquely; as β → 0 it is the filter. All scales are physical
# quantities: no norm of newtons and newton metres is taken.

_ALONG = 0.3  #: coefficient of friction along the slip, beyond what is assumed
_ACROSS = 0.1  #: and across it; the tangent of an error of the normal
_DEPARTURE = 0.1  #: σ_a (m/s²)
_LEAST_FORCE = 1.0  #: least w_j (N)
_MOST_FRICTION = 2.0  #: coefficient that is learned at most
_NOISE = 0.01  #: of a wrist's force (N), in the metric of the object's inertia


@inner
def weigh_magnitudes(t):
    """Fill `alpha_meas` (r,); False where the weights are not positive definite."""
    work = t.work
    r = work.rank
    R = work.B
    H = work.D
    x = work.u
    f = work.reading_e
    _subtract_motion(t, f)
    _weigh_departure(t, t.model.principal[0], R)
    largest = _weigh_tangents(t, R)
    for a in range(r):
        fill(H[a], work.pushed[a])
        if work.moving != 0:
            for b in range(r):
                work.s[b] = work.Phi_mu[b, a]
            _add_yield(t, H[a])
        fill(x, scaled(largest, H[a]))
        _add_square(1.0, x, R)
    if not cholesky(R, 0, 6, work.A) > 0.0:
        return False
    gram = work.E
    right = work.K
    for a in range(r):
        y = work.solved[a]
        fill(y, H[a])
        cholesky_solve(work.A, 6, y, 0)
        right[0, a] = dot6(y, f)
        for b in range(r):
            gram[a, b] = dot6(y, H[b])
    work.weightless = 0
    if t.model.phased != 0:
        _find_mobility(t)
    if not lu_solve(gram, r, right, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = right[0, a]
        fill(f, add(f, -right[0, a], H[a]))
    return True


@inner
def _find_mobility(t):
    """`mobility` (r, r): normal acceleration for each newton that it makes these forces read.

    What is in flight accelerates by x = d(NᵀV_rel)/dt beside what contacts permit. That adds
    Λ_outN⁺x to the reading, N⁺ the motion of least kinetic energy, and (HᵀR⁻¹H)⁻¹HᵀR⁻¹Λ_outN⁺x to
    α: H and HᵀR⁻¹ are in `solved` and `E`.
    """
    work = t.work
    r = work.rank
    A = work.B
    seen = work.z
    for b in range(r):
        fill(seen, ZERO)
        for a in range(r):
            work.s[a] = 1.0 if a == b else 0.0
        _add_yield(t, seen)
        for a in range(r):
            A[a, b] = dot6(work.solved[a], seen)
    for a in range(r):  # columns of the Gram matrix, as rows
        for b in range(r):
            work.mobility[a, b] = work.E[b, a]
    if not lu_solve(A, r, work.mobility, r):
        work.weightless = 1
    for a in range(r):
        for b in range(a):
            work.mobility[a, b], work.mobility[b, a] = work.mobility[b, a], work.mobility[a, b]


@inner
def learn_friction(t):
    """Take the coefficient of friction after the tangential forces found along the slip.

    dμ/dt = k Σw_j s_jᵀβ_j / Σw_j², β_j = C_jT_jᵀR⁻¹(f − N_μα): where contacts slide, to one that
    explains them best; where they rest, s_j = 0, nothing is learned. The factor of R and the
    residual are those that `weigh_magnitudes` left.
    """
    model = t.model
    columns = t.work.columns
    work = t.work
    if model.learning == 0.0:
        return
    y = work.reading_e
    f = work.z
    cholesky_solve(work.A, 6, y, 0)
    found = whole = 0.0
    for j in range(work.count):
        chosen = columns[j].chosen
        p = columns[chosen].point
        s = columns[chosen].slip
        w = max(abs(t.work.goal[chosen]), _LEAST_FORCE)
        for i in range(3):
            f[i] = s[i]
        f[3], f[4], f[5] = cross(p[0], p[1], p[2], s[0], s[1], s[2])
        _push_on(t, f, chosen)
        square = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
        share = (_ALONG**2 - _ACROSS**2) * square + _ACROSS**2
        found += w * w * w * share * dot6(f, y)
        whole += w * w
    more = work.more_friction + model.learning * work.dt * found / whole
    work.more_friction = min(max(more, -model.mu), _MOST_FRICTION - model.mu)


@inner
def _outboard(t, x, out):
    """out = Λ_out x, energy coordinates."""
    y = scaled(x[0], t.work.out_T[0])
    for j in range(1, 6):
        y = add(y, x[j], t.work.out_T[j])
    fill(out, y)


@inner
def _subtract_motion(t, f):
    """f less Λ_out a, a the desired acceleration as far as the contacts permit it."""
    work = t.work
    a = work.y
    V = work.V_O
    r = work.rank
    fill(a, work.A_D)
    x, y, z = cross(V[3], V[4], V[5], V[0], V[1], V[2])
    a[0], a[1], a[2] = a[0] - x, a[1] - y, a[2] - z
    carry_motion(a, work.O, work.C, a)
    energy_motion(work.axes, a, a)
    for b in range(r):
        work.s[b] = work.n_gamma[b] + work.b_N[b]
    solve_lower(work.L, r, work.s)
    project_onto_constraint(work.Q, r, a, work.s)
    _outboard(t, a, work.z)
    fill(f, minus(f, work.z))


@inner
def _weigh_departure(t, mass, R):
    """R = σ_a²m Λ_out(1 − QᵀQ)Λ_outᵀ and the noise of the wrists."""
    work = t.work
    share = _DEPARTURE * _DEPARTURE * mass
    L = work.out_T
    x = work.z
    for i in range(6):
        y = scaled(L[0, i], L[0])
        for k in range(1, 6):
            y = add(y, L[k, i], L[k])
        fill(R[i], scaled(share, y))
        R[i, i] += _NOISE * _NOISE / mass
    for a in range(work.rank):
        _outboard(t, work.Q[a], x)
        _add_square(-share, x, R)


@inner
def _weigh_tangents(t, R):
    """Add ΣT_jC_jT_jᵀ to R; returns the largest w_j.

    C_j = w_j²(σ_t²(1 − nnᵀ) + (σ_s² − σ_t²) ssᵀ), s the direction of slip, shorter than 1 where
    the contact hardly slides.
    """
    columns = t.work.columns
    work = t.work
    f = work.z
    n = work.w
    largest = 0.0
    more = sqrt(_ALONG * _ALONG - _ACROSS * _ACROSS)
    for j in range(work.count):
        chosen = columns[j].chosen
        column = columns[chosen]
        w = max(abs(t.work.goal[chosen]), _LEAST_FORCE)
        largest = max(largest, w)
        N = column.N
        size = sqrt(N[0] * N[0] + N[1] * N[1] + N[2] * N[2])
        for i in range(3):
            n[i] = N[i] / size
        for k in range(4):
            scale = w * (_ACROSS if k < 3 else more)
            for i in range(3):
                f[i] = scale * ((1.0 if i == k else 0.0) - n[k] * n[i] if k < 3 else column.slip[i])
            p = column.point
            f[3], f[4], f[5] = cross(p[0], p[1], p[2], f[0], f[1], f[2])
            _push_on(t, f, chosen)
            _add_square(1.0, f, R)
    return largest


@inner
def _push_on(t, f, chosen):
    """A wrench f at O of one contact into energy coordinates, with what its body yields to it."""
    work = t.work
    if work.moving != 0:
        _yield_to(t, f, t.model.bodies[t.model.columns[chosen].contact].same)
    carry_wrench(f, work.O, work.C, f)
    energy_wrench(work.axes, f, f)
    if work.moving != 0:
        _add_yield(t, f)


@inner
def _yield_to(t, f, body):
    """s (r,) = NᵀΦ_e f of a wrench at O on one body."""
    work = t.work
    for a in range(work.rank):
        other = t.work.columns[int(work.keep[a])].chosen
        work.s[a] = 0.0
        if t.model.bodies[t.model.columns[other].contact].same == body:
            work.s[a] = dot6(work.yields[a], f)


@inner
def _add_yield(t, f):
    """f more Λ_out times the least motion with the normal acceleration s (r,): a body yields."""
    work = t.work
    a = work.y
    out = work.x
    solve_lower(work.L, work.rank, work.s)
    for i in range(6):
        a[i] = 0.0
        for b in range(work.rank):
            a[i] += work.Q[b, i] * work.s[b]
    _outboard(t, a, out)
    fill(f, plus(f, out))


@leaf
def _add_square(scale, x, R):
    """R + scale x xᵀ."""
    y = six(x)
    fill(R[0], add(six(R[0]), scale * y[0], y))
    fill(R[1], add(six(R[1]), scale * y[1], y))
    fill(R[2], add(six(R[2]), scale * y[2], y))
    fill(R[3], add(six(R[3]), scale * y[3], y))
    fill(R[4], add(six(R[4]), scale * y[4], y))
    fill(R[5], add(six(R[5]), scale * y[5], y))
