"""Joint friction: observed by the motors' residual, learned, compensated along permitted speeds.

Inboard of its wrist sensor an arm needs, whatever is in contact beyond it,

    τ = h + M q̈ + Jᵀ(w − w_out) + τ_f,

with w the wrist's reading, w_out what moves the bodies beyond it, and τ_f the friction of the
joints. The residual r = LP_K(τ − h − M q̈ − Jᵀ(w − w_out)) therefore is LP_K(τ_f): it contains no
contact force (`docs/theory.md`, *Joint friction*). From it each joint learns Coulomb and viscous
friction F and D by recursive least squares,

    r ≈ φᵀθ,   φ = LP_K[s/√(s² + s_0²), s, 1],   θ = (F, D, bias),

where s is the speed that the contacts permit: J̄ P V_D, P = Ω_m(Λ_o⁻¹) of eq. 4. It has neither the
noise of measured speeds nor the speeds of the posture task in it. The sign s/√(s² + s_0²) is its
mean over the tick, so that friction reverses within the tick in which the joint does. Torques get

    f + g clip(e),   f = F s/√(s² + s_0²) + D s,   ė = K_d(r − LP_K f − e),

before they are limited: f is not a feedback, and e, with g < 1, is what of the friction is not
learned. Passive joints have no motors: what is known of their friction goes into h instead.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import project_onto_constraint, solve_lower
from osc_contact.law.jit import inner, leaf
from osc_contact.law.phases import APPROACHING
from osc_contact.law.reading import add_reading
from osc_contact.law.vectors import (
    add,
    carry_motion,
    dot6,
    energy_motion,
    fill,
    reflect,
    reflect_back,
    scaled,
    world_wrench,
)

_LAG = 0.01  #: s, 1/K of the residual
_SLOW = 0.05  #: s, where it is only judged
_SETTLED = 0.05  #: s from the first tick on in which nothing is learned
_OUTLIER = 2.0  #: times the motor's torque; no more of a residual counts in one tick
_MOVES = 0.01  #: rad/s; slower joints learn nothing
_SLIDES = 0.2  #: m/rad: speeds of sliding joints, where those of turning ones are constants
_FOLLOWS = 0.09  #: of the permitted speed; a joint that moves with less of it learns nothing
_FULL = 0.7  #: of dry friction; near a reversal nothing is learned
_NOISE = 0.003  #: of the torque limit: residuals that are no friction
_FORGET = 2.0  #: s
_UNLIMITED = 100.0  #: N m, N: stands for the torque limit of motors that have none
_VISCOUS = 20.0  #: s/rad, s/m; D is at most this times the most friction that is assumed
_BIAS = 0.02  #: of the most friction that is assumed


@inner
def observe_arm(t, arm, own, dt):
    """`residual` of the motors from the base to the wrist sensor of an arm.

    All terms pass the same low-pass. Loads are means of this tick's and the last one's, as the
    torques held between them are.

    Args:
        arm: ARM. own: its ARM_WORK. dt: s since the last tick that was computed.
    """
    work = t.work
    joints = t.work.joints
    known = t.memory.joints
    begins = t.memory.balanced <= 1  # there is no last tick yet
    learns = t.model.friction_learning != 0
    lag = _LAG if learns else _SLOW
    k = 0.0 if begins else max(dt / (lag + dt), 1.0 / (t.memory.balanced - 1))  # first plain means
    weight = scaled(-1.0, own.bias)
    moving = scaled(0.0, own.bias)
    for j in range(arm.first, arm.end):
        v = joints[j].v
        known[j].rate += k * ((v - known[j].past_v) / dt - known[j].rate)
        known[j].past_v = v
        if arm.outer_joint >= 0:  # of what is beyond the wrist, in energy coordinates
            moving = add(moving, known[j].rate, joints[j].outboard)
            if arm.filtered != 0:
                weight = add(weight, joints[j].offset, joints[j].outboard)
    load = work.y
    moved = work.z
    fill(load, weight)
    fill(moved, moving)
    world_wrench(work.axes, moved, moved)
    if arm.outer_joint >= 0 and arm.filtered != 0:
        world_wrench(work.axes, load, load)
    add_reading(own.reading, joints[arm.sensor_joint], arm.sensor, work.C, work.s, load)
    for j in range(arm.first, arm.sensor_joint + 1):
        row = known[j]
        motor = t.model.joints[j].motor
        if motor < 0:
            continue
        torque = t.memory.torques[motor]
        bound = _OUTLIER * t.model.joints[j].tau_max
        needed = joints[j].h + dot6(joints[j].column, load)
        needed = min(max(needed, torque - bound), torque + bound)  # counts in two means
        row.excess += k * (torque - 0.5 * (needed + row.needed) - row.excess)
        row.needed = needed
        inertial = -dot6(joints[j].column, moved)
        for i in range(arm.first, arm.end):
            inertial += joints[j].M[i - arm.first] * known[i].rate
        row.residual = row.excess - inertial
        if learns and not begins:
            _learn(t, t.model.joints[j], row, t.memory.friction[j], k, dt)


@leaf
def _learn(t, joint, row, learned, k, dt):
    """Regressors of this tick, one step of the recursive least squares, and e.

    Args:
        joint: JOINT. row: its JOINT_MEMORY. learned: its FRICTION. k: share of one tick in
        low-passes. dt: s.
    """
    speed = row.speed
    row.mean_sign += k * (row.sign - row.mean_sign)
    row.mean_permitted += k * (speed - row.mean_permitted)
    row.mean_speed += k * (row.past_v - row.mean_speed)
    row.mean_friction += k * (row.friction - row.mean_friction)
    missing = row.residual - row.mean_friction
    row.unlearned += min(t.model.friction_smoothing * dt, 1.0) * (missing - row.unlearned)
    most = t.model.friction_most * min(joint.tau_max, _UNLIMITED)
    if learned.known == 0:
        _begin(joint, learned, most)
    least = _MOVES * (_SLIDES if joint.slides != 0 else 1.0)
    y = row.mean_permitted
    if (
        t.memory.balanced * dt > _SETTLED
        and min(abs(speed), abs(y)) > least
        and row.mean_speed * y > _FOLLOWS * y * y
        and abs(row.mean_sign) > _FULL
    ):
        noise = _NOISE * most / t.model.friction_most
        _regress(learned, row.mean_sign, y, row.residual, noise * noise / k, dt, most)


@leaf
def _begin(joint, learned, most):
    """θ and its covariance before anything was learned: what the model says."""
    learned.known = 1
    learned.dry = joint.dry
    learned.viscous = joint.viscous
    own = 0.5 * joint.dry + 0.07 * most
    learned.P00 = own * own
    own = 0.5 * joint.viscous + 0.07 * most
    learned.P11 = own * own
    learned.P22 = (0.017 * most) ** 2


@leaf
def _regress(learned, x, y, r, noise, dt, most):
    """θ ← θ + k(r − φᵀθ), k = Pφ/(R + φᵀPφ), P ← (1 − kφᵀ)P, for φ = (x, y, 1).

    Old residuals are forgotten, as far as P stays below its bound.

    Args:
        learned: FRICTION. x, y: of φ. r: residual (N m, N). noise: R. dt: s.
        most: bound of F and, per rad/s, of D (N m, N).
    """
    a = learned.P00 * x + learned.P01 * y + learned.P02
    b = learned.P01 * x + learned.P11 * y + learned.P12
    c = learned.P02 * x + learned.P12 * y + learned.P22
    whole = noise + a * x + b * y + c
    miss = (r - learned.dry * x - learned.viscous * y - learned.bias) / whole
    F = learned.dry + a * miss
    D = learned.viscous + b * miss
    bias = learned.bias + c * miss
    u = _grown(learned.P00 - a * a / whole, 0.5 * most, dt)
    v = _grown(learned.P11 - b * b / whole, 0.5 * most, dt)
    w = _grown(learned.P22 - c * c / whole, 0.1 * most, dt)
    learned.P01 = u * v * (learned.P01 - a * b / whole)
    learned.P02 = u * w * (learned.P02 - a * c / whole)
    learned.P12 = v * w * (learned.P12 - b * c / whole)
    learned.P00 = u * u * (learned.P00 - a * a / whole)
    learned.P11 = v * v * (learned.P11 - b * b / whole)
    learned.P22 = w * w * (learned.P22 - c * c / whole)
    # at a bound the others are what is likeliest with it, or they would drift without end
    beyond = F - min(max(F, 0.0), most)
    D -= beyond * learned.P01 / learned.P00
    bias -= beyond * learned.P02 / learned.P00
    F -= beyond
    beyond = D - min(max(D, 0.0), _VISCOUS * most)
    F -= beyond * learned.P01 / learned.P11
    bias -= beyond * learned.P12 / learned.P11
    D -= beyond
    beyond = bias - min(max(bias, -_BIAS * most), _BIAS * most)
    F -= beyond * learned.P02 / learned.P22
    D -= beyond * learned.P12 / learned.P22
    learned.bias = bias - beyond
    learned.dry = min(max(F, 0.0), most)
    learned.viscous = min(max(D, 0.0), _VISCOUS * most)


@leaf
def _grown(variance, bound, dt):
    """By what forgetting makes a standard deviation grow in one tick; 1 at its bound."""
    growth = 1.0 + 0.5 * dt / _FORGET
    return growth if variance * growth * growth < bound * bound else 1.0


@inner
def permit_speeds(t):
    """`permitted` (n,) = J̄ P(V_D + Δt A_D) at the end of this tick; mean `speed` and `sign` in it.

    Faces move: NᵀV = v̄_n, and contacts that are approached at the speed of the approach.
    """
    work = t.work
    x = work.y
    m = work.locked
    for i in range(6):
        x[i] = work.V_D[i] + t.model.period * work.A_D[i]
    carry_motion(x, work.O, work.C, x)
    energy_motion(work.axes, x, x)
    reflect(work.reflectors, work.beta, m, x)
    for i in range(m):
        x[i] = 0.0
    for a in range(work.rank):
        work.s[a] = work.V_N[a]
        column = t.work.columns[int(work.keep[a])].chosen
        contact = t.memory.contacts[t.model.columns[column].contact]
        if contact.phase == APPROACHING and work.damping[a] > 0.0:
            work.s[a] += work.alpha_d[a] / work.damping[a]
    if work.rank > 0:
        solve_lower(work.L_t, work.rank, work.s)
        project_onto_constraint(work.Q_t, work.rank, x, work.s)
    reflect_back(work.reflectors, work.beta, m, x)
    for j in range(t.model.n_joints):
        most = t.model.joints[j].rated
        row = t.memory.joints[j]
        before = row.permitted
        s = min(max(dot6(t.work.joints[j].J_bar, x), -most), most)
        row.permitted = s
        row.speed = 0.5 * (s + before)
        row.sign = _mean_sign(before, s, t.model.joints[j].slip)


@leaf
def _mean_sign(a, b, slip):
    """Mean of s/√(s² + s_0²) while s goes from a to b: (√(b² + s_0²) − √(a² + s_0²))/(b − a)."""
    return (a + b) / (sqrt(a * a + slip * slip) + sqrt(b * b + slip * slip))


@inner
def compensate_friction(t):
    """Add f + g clip(e) to the torques of the motors."""
    permit_speeds(t)
    for j in range(t.model.n_joints):
        joint = t.model.joints[j]
        own = t.work.joints[j]
        if joint.motor < 0:
            continue
        row = t.memory.joints[j]
        row.friction = believed_friction(t, j)
        most = t.model.friction_most * min(joint.tau_max, _UNLIMITED)
        rest = min(max(row.unlearned, -most), most)
        own.friction = row.friction + t.model.friction_share * rest
        own.tau += own.friction


@leaf
def believed_friction(t, j):
    """F s/√(s² + s_0²) + D s of joint j in this tick, as learned so far."""
    joint = t.model.joints[j]
    learned = t.memory.friction[j]
    row = t.memory.joints[j]
    F = learned.dry if learned.known != 0 else joint.dry
    D = learned.viscous if learned.known != 0 else joint.viscous
    return F * row.sign + D * row.speed
