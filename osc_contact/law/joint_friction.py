"""Joint friction: observed by the motors' residual, learned, compensated along permitted speeds.

Inboard of its wrist sensor an arm needs, whatever is in contact beyond it,

    τ = h + M q̈ + Jᵀ(w − w_out) + τ_f,

with w the wrist's reading, w_out what moves the bodies beyond it, and τ_f the friction of the
joints. The residual r = LP_K(τ − h − M q̈ − Jᵀ(w − w_out)) therefore is LP_K(τ_f): it contains no
contact force (`docs/theory.md`, *Joint friction*). From it each joint learns Coulomb and viscous
friction F and D, and the inertia A of its rotor that the model lacks, by recursive least squares,

    r ≈ φᵀθ,   φ = LP_K[sign s, q̇, q̈, 1, m],   θ = (F, D, A, bias, μ),

both low-passed once more against noise, with m = h + M q̈ − Jᵀ w_out, so that links that weigh 1 +
μ times as much as in the model are not taken for friction. Where the model has no friction, F, D
and A keep its values until the estimate surely differs, or a joint rests for long although s
commands it. A joint that rests so has at least the friction that it shows: what of r exceeds F + D
|s| is learned as F. Friction is learned of the speed that the joint has, and compensated along the
speed s that the contacts permit: J̄ P V_D, P = Ω_m(Λ_o⁻¹) of eq. 4. This has neither the noise of
measured speeds nor the speeds of the posture task in it. The sign of s is s/√(s² + s_0²), its mean
over the tick, so that friction reverses within the tick in which the joint does. Torques get

    f + g clip(e),   f = F sign s + D s + A ṡ,   ė = K_d(r − LP_K f − e),

before they are limited; f differs from the model by the bound of e at most, and by what has been
learned for long, and what residuals contradict for 50 ms is forgotten. f is not a feedback, and e,
with g < 1 and |e| ≤ F + D |s|, is what of the friction is not learned; where f reverses, e along
the new f is dropped. A wrist that is wrong feeds e, too: where no friction is known or learned, e
is zero. With `errors` the bound is wider by 0.3 |h|, so that e also is what masses of the links are
wrong by. What is compared with a wrench that comes late is of the instant at which it was read.
Without learning θ is the model's, and without `errors` e = 0. Passive joints have no motors: what
is known of their friction goes into h instead.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import add_scaled, dot, project_onto_columns
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.phases import APPROACHING
from osc_contact.law.reading import read_wrist
from osc_contact.law.records import HISTORY, contact_of
from osc_contact.law.vectors import (
    ZERO,
    add,
    add3,
    dot6,
    fill,
    fill_free,
    join,
    linear,
    minus,
    minus3,
    motion_to_energy,
    plus,
    scaled,
    six,
    turned_back,
    world_wrench,
)

LAG = 0.01  #: s, 1/K of the residual
_SMOOTH = 0.015  #: s, of the second low-pass, of what is learned from
_SETTLED = 0.15  #: s from the first tick on in which nothing is learned
_OUTLIER = 2.0  #: times the motor's torque; no more of a residual counts in one tick
_MOVES = 0.01  #: rad/s; slower joints learn nothing
SLIDES = 0.2  #: m/rad: speeds of sliding joints, where those of turning ones are constants
_RESTS = 0.2  #: of that speed; slower joints rest
_STANDS = 0.01  #: s for which a joint must rest until it shows stiction; knocks turn it faster
_HOLDS = 0.1  #: s likewise, until it surely has friction, as much as has been learned
_FOLLOWS = 0.09  #: of the permitted speed; a joint that moves with less of it learns nothing
_FULL = 0.7  #: of dry friction; near a reversal nothing is learned
_FORGET = 2.0  #: s
_LESS = 0.5  #: share of what is learned beyond the model; if that is missing, nothing was friction
_CONTRADICTED = 0.05  #: s for which it must be missing
_RISE = 0.1  #: s in which what is learned comes to be applied: integrals have held it before
_TURNS = 4  #: ticks in which each joint learns once, for speed: residuals change more slowly
_EVIDENCE = 0.15  #: s for which residuals must exceed rounding until anything is learned
_SCATTER = 0.5  #: s, in which R follows the residuals that θ does not explain
_QUIET = 0.1  #: of the noise assumed at first; R is not less
_SEEN = 3.0  #: times the noise; what is in φ with less of θ at its spread is not forgotten
_FASTEST = 1e6  #: rad/s, m/s; of joints without limit, so that squares are finite
_SUDDEN = 0.05  #: s; speeds that change by their limit within less are steps

_SIZE = 5  #: of θ
_MASSES = 0.05  #: of gravity's torque at the start: what masses add to the bias that are wrong
#: otherwise than by one factor
_LEAST = 0.3  #: of the noise: less friction than this is none, where the model has none
_LINKS = 0.3  #: of the torque of gravity and speeds: what wrong masses are taken to cost at most

#: What θ is: nothing yet; as of the model; likewise, but estimated; learned.
UNKNOWN, MODEL_ONLY, SUSPECTED, LEARNED = range(4)
#: What `PAST` keeps of each tick, and `means` the low-passes of.
TORQUE, SIGN, SPEED, V, FRICTION, WEIGHT, RATE, INERTIAL = range(8)
_ACCELERATION = FRICTION  #: of `smooth`, in place of it


@inner
def observe_arm(t, arm, own, sound, dt):
    """`residual` of the motors from the base to the wrist sensor of an arm.

    All terms pass the same low-pass. Loads are means of this tick's and the last one's, as the
    torques held between them are.

    Args:
        arm: ARM. own: its ARM_WORK. sound: whether its wrist is, as far as can be seen. dt: s since
            the last tick that was computed.
    """
    work = t.work
    joints = work.joints
    known = t.memory.joints
    begins = t.memory.balanced <= 1  # there is no last tick yet
    k = 0.0 if begins else max(dt / (LAG + dt), 1.0 / (t.memory.balanced - 1))  # first plain means
    beyond = scaled(-1.0, own.bias)
    moved = ZERO
    for j in range(arm.first, arm.end):
        v = joints[j].v
        known[j].rate += k * ((v - known[j].past_v) / dt - known[j].rate)
        known[j].past_v = v
        if arm.outer_joint >= 0:  # of what is beyond the wrist, in energy coordinates
            moved = add(moved, known[j].rate, joints[j].outboard)
            if arm.filtered:
                beyond = add(beyond, joints[j].offset, joints[j].outboard)
    moved = world_wrench(work.axes, moved)
    if arm.outer_joint >= 0 and arm.filtered:
        beyond = world_wrench(work.axes, beyond)
    wrench = read_wrist(own.reading, joints[arm.sensor_joint], arm.sensor, work.p_C)
    fill(own.net, minus(plus(wrench, beyond), moved))
    for j in range(arm.first, arm.sensor_joint + 1):
        row = known[j]
        joint = t.model.joints[j]
        if joint.motor < 0:
            continue
        inertial = -dot6(joints[j].column, moved)
        for i in range(arm.first, arm.end):
            inertial += joints[j].M[i - arm.first] * known[i].rate
        weight = joints[j].h + dot6(joints[j].column, beyond)
        held = 0.5 * (weight + row.past_weight)
        row.past_weight = weight
        torque = t.memory.torques[joint.motor] - held
        then = (torque, row.sign, row.speed, row.past_v, row.friction, held, row.rate, inertial)
        if t.memory.stamped:
            then = _align(t, t.memory.past[j], then, int(dt / t.model.period + 0.5))
        torque = then[TORQUE]
        bound = _OUTLIER * joint.tau_max
        needed = min(max(dot6(joints[j].column, wrench), torque - bound), torque + bound)
        row.means[TORQUE] += k * (torque - 0.5 * (needed + row.load) - row.means[TORQUE])
        row.load = needed
        for i in range(SIGN, RATE):
            row.means[i] += k * (then[i] - row.means[i])
        row.residual = row.means[TORQUE] - then[INERTIAL]
        if (t.model.friction_learning or t.model.friction_errors) and not begins:
            _learn(t, j, sound, then[RATE], then[INERTIAL], dt)


@leaf
def _align(t, row, now, ticks):
    """What belongs to the wrench's instant; that of this tick is kept, for lost ones, too.

    Args:
        row: PAST of the joint. now: what belongs to this tick. ticks: since the last one kept.
    """
    memory = t.memory
    for i in range(min(ticks, HISTORY)):
        at = (memory.instant - i) % HISTORY
        for kind in range(len(now)):
            row.history[at, kind] = now[kind]
    kept = min(memory.balanced - 1, memory.instant - memory.stamped, HISTORY - 1)
    x = row.history[(memory.instant - min(memory.late, kept)) % HISTORY]
    return join(six(x), (x[RATE], x[INERTIAL]))


@leaf
def _learn(t, j, sound, rate, inertial, dt):
    """e, and every few ticks a step of the recursive least squares.

    Both begin when residuals have exceeded rounding for some time, with `errors` at once: a model
    without errors stays as it is. So does one without friction until some is shown.

    Args:
        j: joint. sound: whether the arm's wrist is. rate, inertial: of its speed, M q̈ − Jᵀ w_out,
            as old as the wrench. dt: s.
    """
    joint = t.model.joints[j]
    prior = t.model.priors[j]
    row = t.memory.joints[j]
    learned = t.memory.friction[j]
    state = t.memory.friction_known[j]
    means = row.means
    missing = row.residual - means[FRICTION]
    if state == UNKNOWN:
        state = MODEL_ONLY
        learned.noise = prior.noise * prior.noise
        learned.P[:] = 0.0
        for i in range(_SIZE):
            learned.theta[i] = learned.estimate[i] = joint.theta[i]
            learned.P[i, i] = prior.doubt[i] * prior.doubt[i]
        weight = _MASSES * t.work.joints[j].h
        learned.P[3, 3] += weight * weight
    if state == MODEL_ONLY:
        seen = dt if abs(missing) > prior.rounding else -dt
        learned.evidence = max(learned.evidence + seen, 0.0)
        if learned.evidence > (0.0 if t.model.friction_errors else _EVIDENCE):
            state = SUSPECTED if prior.sure > 0.0 else LEARNED
    t.memory.friction_known[j] = state
    if state == LEARNED and learned.applied < 1.0:
        learned.applied = min(learned.applied + (dt / _RISE if _all_closed(t) else 1.0), 1.0)
    if state == LEARNED or (state == SUSPECTED and t.model.friction_errors):
        aim = missing if row.unbalanced == 0.0 else 0.0  # else the wrist may be wrong
        row.unlearned += min(t.model.friction_smoothing * dt, 1.0) * (aim - row.unlearned)
    k = dt / (_SMOOTH + dt)
    smooth = learned.smooth
    shown = (row.residual, means[SIGN], means[SPEED], means[V], rate, means[WEIGHT] + inertial)
    for i in range(len(shown)):
        smooth[i] += k * (shown[i] - smooth[i])
    least = _MOVES * (SLIDES if joint.slides else 1.0)
    y = smooth[SPEED]
    moves = min(abs(row.speed), abs(y)) > least and smooth[V] * y > _FOLLOWS * y * y
    rests = abs(smooth[V]) < min(_FOLLOWS * abs(y), _RESTS * least)
    rests = rests and (abs(y) > least or state == LEARNED)
    learned.rested = learned.rested + dt if rests else 0.0
    if state == LEARNED and _is_contradicted(t, j, missing, moves, dt):
        t.memory.friction_known[j] = UNKNOWN
        learned.evidence = learned.applied = row.unlearned = 0.0
        return
    if (t.memory.balanced + j) % _TURNS or state == MODEL_ONLY or not sound:
        return
    settled = t.memory.balanced * dt > _SETTLED
    if t.model.friction_learning and settled and abs(smooth[SIGN]) > _FULL:
        _estimate(t, j, moves, min(_TURNS * k, 1.0), _TURNS * dt)


@leaf
def _is_contradicted(t, j, missing, moves, dt):
    """Whether residuals have shown for long that more than half of what was learned is not there.

    Friction stays; what drags at an arm may let go of it. All that was learned is forgotten then.

    Args:
        j: joint. missing: residual less friction compensated (N m, N), of one instant.
        moves: whether the joint does; one that sticks may need less than F. dt: s.
    """
    learned = t.memory.friction[j]
    row = t.memory.joints[j]
    more = row.friction - _friction_along(row, t.model.joints[j].theta)
    above = moves and abs(more) > t.model.priors[j].noise
    above = above and abs(row.sign) > _FULL
    less = above and missing * more < -_LESS * more * more
    learned.contradicted = max(learned.contradicted + (dt if less else -dt), 0.0)
    if learned.contradicted <= _CONTRADICTED:
        return False
    learned.contradicted = 0.0
    return True


@leaf
def _all_closed(t):
    """Whether no contact is approached: a step of friction would be one of contact forces then."""
    closed = True
    for c in range(t.model.n_contacts):
        closed = closed and t.memory.contacts[c].phase != APPROACHING
    return closed


@leaf
def _estimate(t, j, moves, k, dt):
    """θ of a joint after one step, if it moves, or rests although it is commanded to move.

    What a resting joint shows is compared with the estimate: in θ all of it is bias as long
    as the joint may be without friction. One that rests for long has friction.

    Args:
        j: joint. moves: whether it does. k: share of this step in the residual. dt: s.
    """
    prior = t.model.priors[j]
    learned = t.memory.friction[j]
    known = t.memory.friction_known
    smooth = learned.smooth
    a = smooth[_ACCELERATION]
    likely = learned.estimate
    dry = smooth[TORQUE] - likely[2] * a - likely[3] - likely[4] * smooth[WEIGHT]
    most = max(likely[0], 0.0) + max(likely[1], 0.0) * abs(t.memory.joints[j].speed)
    excess = dry * smooth[SIGN] - most
    unsure = _SEEN * sqrt(learned.noise + learned.P[2, 2] * a * a)
    sticks = learned.rested > _STANDS and excess > unsure
    holds = learned.rested > _HOLDS and dry * smooth[SIGN] > unsure
    if not (moves or sticks or holds):
        return
    phi = (smooth[SIGN], smooth[V], a, 1.0, smooth[WEIGHT])
    if sticks:  # F is at least this, and as uncertain as before
        likely[0] += min(excess, max(prior.high[0] - likely[0], 0.0))
    elif moves:
        _regress(prior, learned, phi, smooth[TORQUE], k, dt)
    C = local(_SIZE, _SIZE)
    _keep_bounds(prior, learned, C)
    if known[j] == SUSPECTED and (
        sticks or holds or _shows_friction(prior, t.model.joints[j].theta, learned, phi, C)
    ):
        known[j] = LEARNED
        _keep_bounds(prior, learned, C)


@leaf
def _regress(prior, learned, phi, r, k, dt):
    """θ ← θ + k(r − φᵀθ), k = Pφ/(R + φᵀPφ), P ← (1 − kφᵀ)P.

    R follows the square of what θ does not explain; it is larger where that is more than three
    standard deviations. Old residuals are forgotten, as far as P stays below its bound.

    Args:
        prior: PRIOR of a joint. learned: its FRICTION. phi: (5,). r: residual (N m, N).
        k: share of one tick in r. dt: s.
    """
    gain = local(_SIZE)
    growth = local(_SIZE)
    estimate = learned.estimate
    P = learned.P
    miss = r - dot(estimate, phi, _SIZE)
    noise = prior.noise
    bound = 10.0 * noise
    bounded = min(max(miss, -bound), bound)
    square = bounded * bounded
    learned.noise += dt / (_SCATTER + dt) * (square - learned.noise)
    R = max(learned.noise, (_QUIET * noise) * (_QUIET * noise))
    for i in range(_SIZE):
        gain[i] = dot(P[i], phi, _SIZE)
    unsure = dot(gain, phi, _SIZE)
    whole = R / k + unsure
    whole *= max(miss * miss / (_SEEN * _SEEN * (R + unsure)), 1.0)  # outliers count less
    for i in range(_SIZE):
        estimate[i] += gain[i] * miss / whole
        grown = 1.0 + 0.5 * dt / _FORGET
        deviation = grown * sqrt(max(P[i, i] - gain[i] * gain[i] / whole, 0.0))
        shows = abs(phi[i]) * prior.spread[i] > _SEEN * noise
        growth[i] = grown if shows and deviation < prior.spread[i] else 1.0
    for i in range(_SIZE):
        for j in range(i + 1):
            P[i, j] = growth[i] * growth[j] * (P[i, j] - gain[i] * gain[j] / whole)
            P[j, i] = P[i, j]


@leaf
def _keep_bounds(prior, learned, C):
    """θ: the estimate within its bounds; the others are what is likeliest with those at a bound.

    The estimate stays as it is, or it would drift.

    Args:
        prior: PRIOR of a joint. learned: its FRICTION. C: (5, 5), filled: covariance of θ.
    """
    theta = learned.theta
    for i in range(_SIZE):
        theta[i] = learned.estimate[i]
        for j in range(_SIZE):
            C[i, j] = learned.P[i, j]
    for turn in range(2 * _SIZE):  # twice: a condition may bring one before it to its bound
        i = turn % _SIZE
        bound = min(max(theta[i], prior.low[i]), prior.high[i])
        if theta[i] != bound and C[i, i] > 0.0:
            _condition(theta, C, i, bound)
    for i in range(_SIZE):
        theta[i] = min(max(theta[i], prior.low[i]), prior.high[i])


@leaf
def _shows_friction(prior, known, learned, phi, C):
    """Whether F, D and A surely are not as of the model, and matter; else θ is what they are then.

    Their distance from the model is χ² = Σ (θ_i − known_i)²/C_ii, each given those before it.

    Args:
        prior: PRIOR of a joint. known: (5,) θ of its model. learned: its FRICTION, θ of it with
            the covariance C (5, 5), overwritten. phi: (5,).
    """
    theta = learned.theta
    torque = 0.0
    distance = 0.0
    for i in range(3):
        torque += phi[i] * (theta[i] - known[i])
    for i in range(3):
        if C[i, i] > 0.0:
            apart = theta[i] - known[i]
            distance += apart * apart / C[i, i]
            _condition(theta, C, i, known[i])
        theta[i] = known[i]
    return distance > prior.sure * prior.sure and abs(torque) > _LEAST * prior.noise


@leaf
def _condition(theta, C, i, value):
    """Mean and covariance of a Gaussian given θ_i: θ − C_i (θ_i − value)/C_ii, C − C_i C_iᵀ/C_ii.

    Args:
        theta: (5,). C: (5, 5). i: which. value: θ_i.
    """
    beyond = (theta[i] - value) / C[i, i]
    add_scaled(-beyond, C[i], _SIZE, theta)
    theta[i] = value
    for j in range(_SIZE):
        if j != i:
            add_scaled(-C[j, i] / C[i, i], C[i], _SIZE, C[j])
    for j in range(_SIZE):
        C[i, j] = C[j, i] = 0.0


@inner
def permit_speeds(t):
    """Permitted speeds of the joints, J̄ P V_D.

    Reads `V_D`, `V_N`, `alpha_d`, `damping`, the factors of `N_t`, and J̄ of the joints. Fills in
    MEMORY of each joint `speed`, its rate `turn` since the last tick, and `sign`, its mean sign.

    A_D is left out: a step of it would press on contacts at once. Faces move: NᵀV = v̄_n, and
    contacts that are approached at the speed of the approach.
    """
    work = t.work
    x = local(6)
    normal = local(6)  # NᵀV
    fill_free(x, work, motion_to_energy(work, work.V_D))
    for a in range(work.rank):
        normal[a] = work.V_N[a]
        approached = contact_of(t, work.kept[a]).phase == APPROACHING
        if approached and work.damping[a] > 0.0:
            normal[a] += work.alpha_d[a] / work.damping[a]
    if work.rank > 0:
        project_onto_columns(work.N_factor_t, work.N_basis_t, work.rank, x, normal)
    fill(x, turned_back(work, x))
    for j in range(t.model.n_joints):
        joint = t.model.joints[j]
        most = min(joint.rated, _FASTEST)
        row = t.memory.joints[j]
        slip = joint.slip
        s = dot6(work.joints[j].J_bar, x)
        s = min(max(s, -most), most) if s == s else 0.0  # NaN where what is commanded overflows
        before = row.speed if t.memory.ticked else s
        most /= _SUDDEN
        row.speed = s
        row.turn = min(max((s - before) / work.dt, -most), most)
        # mean of s/√(s² + s_0²) while s goes to s_1: (√(s_1² + s_0²) − √(s² + s_0²))/(s_1 − s)
        then = s + t.model.period * row.turn
        row.sign = (s + then) / (sqrt(s * s + slip * slip) + sqrt(then * then + slip * slip))


@inner
def compensate_friction(t):
    """Add f + g clip(e) to the torques of the motors."""
    permit_speeds(t)
    for j in range(t.model.n_joints):
        own = t.work.joints[j]
        if t.model.joints[j].motor >= 0:
            own.friction = _compensation(t, j)
            own.tau += own.friction


@leaf
def _compensation(t, j):
    """f + g clip(e) of joint j.

    A joint that sticks keeps its e while s reverses: what of it would then be along f is dropped,
    or the joint would be set in motion by more than F. With `errors` e is of the links, too.
    """
    row = t.memory.joints[j]
    before = row.friction
    row.friction = believed_friction(t, j)
    F, D, _ = _theta(t, j)
    most = F + D * abs(row.speed)
    if t.model.friction_errors:
        most += _LINKS * abs(t.work.joints[j].h)
    elif before * row.friction < 0.0 and row.friction * row.unlearned > 0.0:
        row.unlearned = 0.0
    most = min(most, t.model.wrist_error * t.model.joints[j].tau_max)
    rest = min(max(row.unlearned, -most), most)
    return row.friction + t.model.friction_share * rest


@leaf
def _theta(t, j):
    """F, D and A of joint j: as learned so far, or as of the model."""
    known = t.model.joints[j].theta
    theta = linear(known)
    if t.memory.friction_known[j] == LEARNED:  # else they are the model's
        learned = t.memory.friction[j]
        theta = add3(theta, learned.applied, minus3(learned.theta, known))
    return theta


@leaf
def _friction_along(row, theta):
    """F s/√(s² + s_0²) + D s + A ṡ of a joint in this tick (N m, N).

    Args:
        row: its JOINT_MEMORY. theta: F, D, A.
    """
    return theta[0] * row.sign + theta[1] * row.speed + theta[2] * row.turn


@leaf
def believed_friction(t, j):
    """Friction of joint j in this tick (N m, N), as learned so far.

    What is learned differs from the model by `wrist_error` at most, as e does, and by what has been
    learned for long: more may be something that drags at the arm, or a wrist that is wrong.
    """
    row = t.memory.joints[j]
    friction = modelled = _friction_along(row, t.model.joints[j].theta)
    if t.memory.friction_known[j] == LEARNED:
        friction = _friction_along(row, _theta(t, j))
        trusted = row.trusted[0] + row.trusted[1] * abs(row.speed) + row.trusted[2] * abs(row.turn)
        most = t.model.wrist_error * t.model.joints[j].tau_max + trusted
        friction = min(max(friction, modelled - most), modelled + most)
    return friction
