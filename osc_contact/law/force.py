"""The force path of fig. 5: wrist readings to contact magnitudes, and the force law."""

from __future__ import annotations

from math import inf

from osc_contact.law.algebra import lu_solve, solve_lower, solve_lower_transposed
from osc_contact.law.arm_motion import place_point
from osc_contact.law.energy import carry_wrench, energy_wrench
from osc_contact.law.grasps import filter_reading
from osc_contact.law.jit import inner, leaf
from osc_contact.law.six import ZERO, add, dot6, fill, minus, plus, reflect, reflect_back, six

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

    S(SᵀΛ_outS)⁻¹Sᵀ takes the place of Λ_out⁻¹, and a = Sη̇ + σ has a part of its own.
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
def integral_room(most, wanted):
    """N; the force integral stays within ± that."""
    return max(_WINDUP * abs(wanted), most)


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
