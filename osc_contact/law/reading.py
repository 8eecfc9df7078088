"""Contact forces from wrist readings, by filter (fig. 5) or least squares; the force law."""

from __future__ import annotations

from math import inf, sqrt

from osc_contact.law.algebra import (
    backward,
    cholesky,
    cholesky_solve,
    dot,
    forward,
    lu_solve,
    project_onto_columns,
)
from osc_contact.law.arm_motion import place_point
from osc_contact.law.grasps import filter_reading
from osc_contact.law.jit import inner, leaf
from osc_contact.law.records import body_of, contact_of
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    add3,
    add_square,
    axis3,
    carry_wrench,
    combined,
    copy_rows,
    cross,
    divided3,
    dot3,
    dot6,
    fill,
    fill3,
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

# --- The force path of fig. 5: wrist readings to contact magnitudes, and the force law ------------

_WINDUP = 1.5  #: times the command, of the force integral
_LEAST = 0.1  #: times the command: more than that is never the least command of a contact
_NOTHING = 1e-9  #: Λ_out beside the object's inertia, below which sensors read f_c itself


@inner
def add_friction(t):
    """N_μ = N + D share of the kept columns, _e (`pushed`), D share at O (`friction_wrenches`)."""
    work = t.work
    for a in range(work.rank):
        friction = ZERO
        for j in range(work.count if work.mu else 0):
            column = work.columns[work.chosen[j]]
            friction = add(friction, column.share[a], column.friction_wrench)
        fill(work.friction_wrenches[a], friction)
        fill(work.pushed[a], plus(work.N[a], wrench_to_energy(work, friction)))


@inner
def read_wrist(reading, joint, sensor, C):
    """One wrist's reading (6,), rotated to world axes and carried to C, as a tuple.

    Args:
        reading: (6,) of the wrist. joint: JOINT_WORK row of the sensor's. sensor: (12,) rotation
            (row by row) and position of the sensor in it. C: (3,) point (m).
    """
    force = rotated(joint.R, rotated9(sensor, reading))
    couple = rotated(joint.R, rotated9(sensor, reading[3:]))
    return carry_wrench(force + couple, place_point(joint, sensor[9:]), C)


@inner
def sum_readings(t):
    """f_meas (6,) = Σ wrist readings less tare, at O; `reading_e`: the same less bias, energy."""
    work = t.work
    total = ZERO
    for k in range(t.model.n_arms):
        arm = t.model.arms[k]
        if arm.sensor_joint < 0:
            continue
        joint = work.joints[arm.sensor_joint]
        wrench = read_wrist(t.input.wrenches[k], joint, arm.sensor, work.C)
        if arm.filtered:
            wrench = filter_reading(work.axes, work.arms[k].filter, wrench)
        total = plus(total, wrench)
    fill(work.f_meas, minus(carry_wrench(total, work.C, work.O), t.memory.f_tare))
    fill(work.reading_e, minus(wrench_to_energy(work, work.f_meas), work.bias_e))


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
        fill(work.solved[a], work.Q[a])
    if not t.model.held:
        return _measure_at_tip(t)
    copy_rows(work.out_T, work.B)
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
    forward(L, r, work.w)
    for b in range(r):  # columns of L⁻¹Φ_μ
        forward(L, r, E[b])
        for a in range(r):
            D[a, b] += E[b, a]
    for a in range(r):
        for b in range(r):
            s = D[a, b] / L[a, a]
            for c in range(a):
                s += L[a, c] * D[c, b]
            work.mobility[a, b] = s
    alpha = work.A
    for a in range(r):
        alpha[0, a] = dot6(work.solved[a], f) + work.z[a] - work.w[a]
        forward(L, r, D[a])  # a row of D L⁻ᵀ
    if not lu_solve(D, r, alpha, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = alpha[0, a]
    backward(L, r, work.alpha_meas)
    return True


@inner
def _measure_at_tip(t):
    """Where nothing is held: sensors see the tip in its own motions S only, or f_c itself.

    S(SᵀΛ_outS)⁻¹Sᵀ takes the place of Λ_out⁻¹, and a = Sη̇ + σ has a further part.
    """
    work = t.work
    d = 6 - work.locked
    f = work.reading_e
    S = work.A
    trace = 0.0
    for i in range(6):
        trace += abs(work.out_T[i, i])
    if trace < _NOTHING:
        work.weightless = 1
        return _solve_magnitudes(t, 0.0)
    sigma = turned_back(work, work.sigma)
    fill(f, minus(f, _outboard(work, sigma)))
    for i in range(d):
        fill(work.u, ZERO)
        work.u[work.locked + i] = 1.0
        fill(S[i], turned_back(work, work.u))
    for i in range(d):
        inertia = _outboard(work, S[i])
        for j in range(d):
            work.D[i, j] = dot6(inertia, S[j])
    for a in range(work.rank):
        work.z[a] = dot6(work.Q[a], sigma)
        for i in range(d):
            work.E[a, i] = dot6(work.Q[a], S[i])
    if not lu_solve(work.D, d, work.E, work.rank):
        return False
    for a in range(work.rank):
        fill(work.solved[a], combined(work.E[a], S, d))
    return _solve_magnitudes(t, 1.0)


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
    work = t.work
    dependent = work.rank < work.count
    for a in range(work.rank):
        law = contact_of(t, work.kept[a])
        gain = law.gain
        damping = law.damping
        brake = law.brake
        for j in range(work.count if dependent else 0):
            other = contact_of(t, work.chosen[j])
            gain = min(gain, other.gain)
            damping = max(damping, other.damping)
            brake = max(brake, other.brake)
        work.gain[a] = gain
        work.damping[a] = damping
        work.brake[a] = brake
        work.least[a] = -inf if dependent else law.least


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
_LAG = 0.005  #: s, of the low-pass of tangential forces
_REACTION = 0.5  #: times the desired force, of what they may add
_FIRST = 0.005  #: T_1 (s), of sliding that the coefficient assumed at first is worth
_MOST_FRICTION = 2.0  #: coefficient that is learned at most
_NOISE = 0.01  #: of a wrist's force (N), in the metric of the object's inertia


@inner
def weigh_magnitudes(t):
    """Fill `alpha_meas` (r,) and `reading_e`, R⁻¹(f − N_μα); False where R is not definite."""
    work = t.work
    r = work.rank
    R = work.B
    H = work.D
    f = work.reading_e
    _subtract_motion(t, f)
    largest = _weigh_likely(t, R)
    for a in range(r):
        h = six(work.pushed[a])
        if work.moving:
            for b in range(r):
                work.s[b] = work.Phi_mu[b, a]
            h = _add_yield(work, h)
        fill(H[a], h)
        add_square(1.0, scaled(largest, h), R)
    if not cholesky(R, 0, 6, work.A) > 0.0:
        return False
    gram = work.E
    right = work.K
    for a in range(r):
        y = work.solved[a]
        fill(y, H[a])
        cholesky_solve(work.A, 6, y)
        right[0, a] = dot6(y, f)
        for b in range(r):
            gram[a, b] = dot6(y, H[b])
    work.weightless = 0
    if t.model.phased:
        _find_mobility(t)
    if not lu_solve(gram, r, right, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = right[0, a]
        accumulate(f, -right[0, a], H[a])
    cholesky_solve(work.A, 6, f)
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
    for b in range(r):
        for a in range(r):
            work.s[a] = 1.0 if a == b else 0.0
        seen = _add_yield(work, ZERO)
        for a in range(r):
            A[a, b] = dot6(work.solved[a], seen)
    copy_rows(work.E, work.mobility)  # columns of the Gram matrix, which is symmetric, as rows
    if not lu_solve(A, r, work.mobility, r):
        work.weightless = 1
    for a in range(r):
        for b in range(a):
            work.mobility[a, b], work.mobility[b, a] = work.mobility[b, a], work.mobility[a, b]


@inner
def learn_friction(t):
    """Take the coefficient of friction after the tangential forces found along the slip.

    dμ/dt = k Σw_j s_jᵀβ_j / Σw_j², β_j = C_jT_jᵀR⁻¹(f − N_μα): where contacts slide, to one that
    explains them best; where they rest, s_j = 0, nothing is learned. At first μ is the mean of all
    readings, k = 1/(T_1 + T) > `learning`, T = ∫Σw_jα_j|s_j|²/Σw_j² dt the time of sliding under
    the desired forces: the first contact is made with friction that it shows itself. Not where
    normals are estimated, too: a tilted face shows the same at first. R⁻¹(f − N_μα) is what
    `weigh_magnitudes` left.
    """
    model = t.model
    work = t.work
    if model.learning == 0.0:
        return
    dependent = work.rank < work.count
    found = slid = whole = uncertain = 0.0
    for j in range(work.count):
        chosen = work.chosen[j]
        column = work.columns[chosen]
        s = column.slip
        w = max(abs(work.goal[chosen]), _LEAST_FORCE)
        along = dot3(s, s)
        share = (_ALONG**2 - _ACROSS**2) * along + _ACROSS**2
        found += w * w * w * share * dot6(_push_on(t, linear(s), chosen), work.reading_e)
        pressed = 0.0 if dependent else min(max(work.alpha_meas[j], 0.0), w)
        slid += w * pressed * along
        whole += w * w
        uncertain += column.prior[0] + column.prior[4] + column.prior[8]
    k = model.learning
    if not uncertain > 0.0 and not dependent:
        k = max(k, 1.0 / (_FIRST + work.slid))
        work.slid += work.dt * slid / whole
    more = work.more_friction + min(k * work.dt, 1.0) * found / whole
    work.more_friction = min(max(more, -model.mu), _MOST_FRICTION - model.mu)


@inner
def oppose_friction(t):
    """`reaction` (r,) = D⁻¹Nᵀ(Φ_0 + Φ_e)f_t, D = Nᵀ(Φ_0 + Φ_e)N_μ: what f_t takes off α.

    f_t = Σ(1 − |s_j|²) T_jβ_j are the tangential forces of contacts that stick or hardly slide, and
    that μ does not explain: β_j = C_jT_jᵀR⁻¹(f − N_μα) as read up to the last tick, low-passed.
    They themselves are not opposed: that would push on what sticks. At most half of the desired
    force.
    """
    work = t.work
    m = work.locked
    d = 6 - m
    r = work.rank
    x = work.K[0]
    for a in range(r):
        x[a] = 0.0
    total = ZERO
    for j in range(t.model.n_columns):
        fill3(work.columns[j].tangential, ZERO)
    for j in range(work.count):
        chosen = work.chosen[j]
        column = work.columns[chosen]
        past = t.memory.columns[chosen].tangential
        resting = scaled3(1.0 - dot3(column.slip, column.slip), past)
        f = resting + cross(column.point, resting)
        total = plus(total, turned(work, wrench_to_energy(work, f)))
        for a in range(r if work.moving else 0):
            if body_of(t, work.kept[a]).same == body_of(t, chosen).same:
                x[a] += dot6(work.yields[a], f)
        _find_tangential(t, column, chosen, past)
    fill(work.u, total)
    solvable = d > 0 and cholesky(work.Lambda, m, d, work.B) > 0.0
    for a in range(r if solvable else 0):
        fill(work.z, work.N_t[a])
        cholesky_solve(work.B, d, work.z[m:])
        x[a] += dot(work.z[m:], work.u[m:], d)
        for b in range(r):
            work.D[a, b] = work.Phi_mu[a, b] + dot(work.z[m:], work.pushed_t[b, m:], d)
    solvable = solvable and lu_solve(work.D, r, work.K, 1)
    for a in range(r):
        most = _REACTION * abs(work.alpha_d[a])
        work.reaction[a] = min(max(x[a], -most), most) if solvable else 0.0


@inner
def _find_tangential(t, column, chosen, past):
    """`tangential` of a column: β_j of this tick, low-passed."""
    work = t.work
    for k in range(3):
        work.w[k] = dot6(_push_on(t, _across(column.N, k), chosen), work.reading_e)
    w = max(abs(work.goal[chosen]), _LEAST_FORCE)
    along = (_ALONG**2 - _ACROSS**2) * dot3(column.slip, work.w)
    k = work.dt / (_LAG + work.dt)
    for i in range(3):
        found = w * w * (_ACROSS**2 * work.w[i] + along * column.slip[i])
        column.tangential[i] = past[i] + k * (found - past[i])


@inner
def _outboard(work, x):
    """Λ_out x, energy coordinates."""
    return combined(x, work.out_T, 6)


@inner
def _subtract_motion(t, f):
    """f less Λ_out a, a the desired acceleration as far as the contacts permit it."""
    work = t.work
    a = work.y
    V = work.V_O
    fill(a, work.A_D)
    fill3(a, minus3(a, cross(V[3:], V)))
    fill(a, motion_to_energy(work, a))
    for b in range(work.rank):
        work.s[b] = work.n_gamma[b] + work.b_N[b]
    project_onto_columns(work.L, work.Q, work.rank, a, work.s)
    fill(f, minus(f, _outboard(work, a)))


@inner
def _weigh_likely(t, R):
    """R = σ_a²m Λ_out(1 − QᵀQ)Λ_outᵀ + ΣT_jC_jT_jᵀ and the wrists' noise; the largest w_j.

    C_j = w_j²(σ_t²(1 − nnᵀ) + (σ_s² − σ_t²) ssᵀ), s the direction of slip, shorter than 1 where
    the contact hardly slides.
    """
    work = t.work
    mass = t.model.principal[0]
    share = _DEPARTURE * _DEPARTURE * mass
    largest = 0.0
    for i in range(6):
        fill(R[i], scaled(share, _outboard(work, work.out_T[:, i])))
        R[i, i] += _NOISE * _NOISE / mass
    for a in range(work.rank):
        add_square(-share, _outboard(work, work.Q[a]), R)
    for j in range(work.count):
        chosen = work.chosen[j]
        column = work.columns[chosen]
        w = max(abs(work.goal[chosen]), _LEAST_FORCE)
        largest = max(largest, w)
        for k in range(3):
            across = scaled3(w * _ACROSS, _across(column.N, k))
            add_square(1.0, _push_on(t, across, chosen), R)
        along = scaled3(w * sqrt(_ALONG**2 - _ACROSS**2), column.slip)
        add_square(1.0, _push_on(t, along, chosen), R)
    return largest


@inner
def _across(N, k):
    """Column k of 1 − nnᵀ, n the direction of a column of N, as a tuple."""
    n = divided3(N, sqrt(dot3(N, N)))
    return add3(axis3(k), -n[k], n)


@inner
def _push_on(t, force, chosen):
    """A force at one contact in energy coordinates, with what its body yields to it."""
    work = t.work
    f = force + cross(work.columns[chosen].point, force)
    g = wrench_to_energy(work, f)
    if not work.moving:
        return g
    body = body_of(t, chosen).same
    for a in range(work.rank):  # s = NᵀΦ_e f
        here = body_of(t, work.kept[a]).same == body
        work.s[a] = dot6(work.yields[a], f) if here else 0.0
    return _add_yield(work, g)


@inner
def _add_yield(work, f):
    """f more Λ_out times the least motion with the normal acceleration s (r,): a body yields."""
    forward(work.L, work.rank, work.s)
    return plus(f, _outboard(work, combined(work.s, work.Q, work.rank)))
