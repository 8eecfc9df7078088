"""Joint friction: observed in motor residuals, identified, compensated along permitted speeds.

For any contact beyond its wrist sensor, the joints of an arm up to the sensor need the torques

    τ = h + M q̈ + Jᵀ(w − w_out) + τ_f,

with w the reading of the sensor, w_out the wrench that moves the bodies beyond it, and τ_f the
friction of the joints. Hence the residual r = LP_K(τ − h − M q̈ − Jᵀ(w − w_out)) equals LP_K(τ_f)
and contains no contact force (`docs/theory.md`, *Joint friction*). From r, recursive least squares
identify for each joint the Coulomb and viscous friction F and D, and the rotor inertia A that the
model lacks:

    r ≈ φᵀθ,   φ = LP_K[sign s, q̇, q̈, 1, m],   θ = (F, D, A, bias, μ).

Both sides pass a second low-pass against noise. m = h + M q̈ − Jᵀ w_out: the regressor μ absorbs
masses that are 1 + μ times those of the model, which would otherwise appear as friction. If the
model has no friction, F, D and A keep the model's values until the estimate differs significantly
from them, or until a joint rests for long although it is commanded to move with the speed s. The
friction of such a joint is at least |r|, so F is increased by the excess of r over F + D |s|.

The certain part of A is added to M (`rotor`), because gains of forces and motions are
accelerations, and f compensates the rest of it.

Friction is identified at the measured speed of a joint, and compensated at the speed s that the
contacts permit, J̄ P V_D with P = Ω_m(Λ_o⁻¹) of eq. 4, which contains neither measurement noise nor
the motion of the posture task. sign s is s/√(s² + s_0²), averaged over the tick, so that the
compensation reverses in the same tick as the joint. Before the torques are limited

    f + g clip(e),   f = F sign s + D s + A ṡ,   ė = K_d(r − LP_K f − e)

is added to them. f is a feedforward term. It differs from the friction of the model by at most the
bound of e plus the friction that has been identified for a long time; the identified part is
discarded when residuals contradict it for 50 ms. e, with g < 1 and |e| ≤ F + D |s|, is the friction
that is not identified yet; when f reverses, a part of e along the new f is dropped. An error of the
wrist sensor enters e, too, so e is zero as long as no friction is modelled or identified. With
`friction_errors` the bound is wider by 0.3 |h|, so that e also covers errors of the links' masses;
and, if friction is learned, by the prior's deviation of F as long as it is not identified.

Where the sum drives a joint that is faster than commanded it is reduced, since residuals then show
acceleration in place of friction (`_without_excess`): all of it once residuals have contradicted
the model's friction, before only e.

A delayed wrench is compared with signals of the instant at which it was measured. Without
`friction_learning` θ is the model's; if `friction_errors` is 0, too, residuals change nothing, and
e = 0. Friction of passive joints is added to h, because they have no motor to compensate it.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import project_onto_columns
from osc_contact.law.friction_estimate import (
    FRICTION,
    INERTIAL,
    LEARNED,
    MODEL_ONLY,
    RATE,
    SIGN,
    SPEED,
    SUSPECTED,
    TORQUE,
    UNKNOWN,
    WEIGHT,
    V,
    begin_estimate,
    update_estimate,
)
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.phases import APPROACHING
from osc_contact.law.reading import read_wrist
from osc_contact.law.records import HISTORY, WRISTS, contact_of
from osc_contact.law.vectors import (
    ZERO,
    add,
    add3,
    clamped,
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

LAG = 0.01  #: s, time constant 1/K of the residual's low-pass
_SMOOTH = 0.015  #: s, time constant of the second low-pass
_SETTLED = 0.15  #: s after the first tick during which nothing is identified
_JITTER = 0.1  #: s, time constant of the variance of a wrist's noise
_OUTLIER = 2.0  #: largest residual of one tick, as a multiple of the motor's torque limit
_MOVES = 0.01  #: rad/s; a slower joint does not contribute to the estimate
SLIDES = 0.2  #: m/rad, converts speed thresholds of revolute joints to those of prismatic ones
_RESTS = 0.2  #: share of `_MOVES` below which a joint is at rest
_FOLLOWS = 0.09  #: share of the permitted speed that a joint must reach to contribute
_FULL = 0.7  #: |sign s| from which on friction is identified, away from reversals
_LESS = 0.5  #: share of the friction identified beyond the model whose absence contradicts it
_BIAS = 0.1  #: largest bias by wrong masses that does not contradict friction, as a share of |h|
_CONTRADICTED = 0.05  #: s of this contradiction after which the identified friction is discarded
_RISE = 0.1  #: s in which identified friction is phased in; integrals have balanced it before
_APPROACH = 0.006  #: s, time constant of the low-pass of an approach's speed
_TURNS = 4  #: each joint is updated every fourth tick, for speed; residuals change more slowly
_FASTEST = 1e6  #: rad/s, m/s; speed limit of joints without one, so that squares are finite
_CERTAIN = 2.0  #: standard deviations of A that M leaves out
#: Largest standard deviation of A, as a share of the prior's, at which motion and not the prior has
#: determined A. Above it, errors of the model of friction made A wrong by 3.5 deviations.
_MEASURED = 0.1
_ROTOR_LAG = 0.1  #: s, time constant with which the rotor in M follows A
_SUDDEN = 0.05  #: s; the rate of s is bounded by the speed limit divided by this

_LINKS = 0.3  #: largest torque error by wrong masses, as a share of |h|
#: Excess of a joint's speed over the commanded one at which compensation begins to be reduced: a
#: share of the permitted speed, and rad/s, beyond the noise of estimated speeds.
_EXCESS_SHARE = 0.5
_EXCESS = 0.05


@inner
def observe_arm(t, arm, arm_work, sound, dt):
    """Update `residual` of the motors from the base to the wrist sensor of an arm.

    The residual (N m, N) is the torque of a motor that neither the model nor the reading of the
    wrist explains, low-passed. All terms pass the same low-pass, with the time constant `LAG`.
    Loads are averaged over this tick and the last one, because the motor torques were held constant
    between them. The bodies beyond the sensor are those that the joint `outer_joint` and the joints
    behind it carry (−1: none); if `filtered` is 1, they can move by themselves.

    Reads h, M, `column`, `outboard` and `offset` of the joints in WORK, `reading` and `bias` of the
    arm, and `balanced` of MEMORY, the number of ticks so far in which wrists were compared with
    motors. Fills `net` of the arm, its reading less weight and inertia of the bodies beyond the
    wrist (at C, world axes), and of the joints in MEMORY `rate` (acceleration, low-passed; rad/s²,
    m/s²), `past_v` and the fields of `_observe_joint`; updates the estimate of friction if it is
    enabled (`_learn`).

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
        sound: whether the arm's wrist sensor is not suspected of a fault.
        dt: time since the last computed tick (s).
    """
    work = t.work
    joints = work.joints
    memory_rows = t.memory.joints
    begins = t.memory.balanced <= 1  # without a last tick
    k = 0.0 if begins else max(dt / (LAG + dt), 1.0 / (t.memory.balanced - 1))  # first plain means
    # wrenches that carry (at q̈ = 0) and accelerate the bodies beyond the wrist, the first negative
    bias = scaled(-1.0, arm_work.bias)
    inertia_force = ZERO
    for j in range(arm.first, arm.end):
        v = joints[j].v
        memory_rows[j].rate += k * ((v - memory_rows[j].past_v) / dt - memory_rows[j].rate)
        memory_rows[j].past_v = v
        if arm.outer_joint >= 0:  # in energy coordinates
            inertia_force = add(inertia_force, memory_rows[j].rate, joints[j].outboard)
            if arm.filtered:
                bias = add(bias, joints[j].offset, joints[j].outboard)
    inertia_force = world_wrench(work.axes, inertia_force)
    if arm.outer_joint >= 0 and arm.filtered:
        bias = world_wrench(work.axes, bias)
    wrench = read_wrist(arm_work.reading, joints[arm.sensor_joint], arm.sensor, work.p_C)
    fill(arm_work.net, minus(plus(wrench, bias), inertia_force))
    for j in range(arm.first, arm.sensor_joint + 1):
        if t.model.joints[j].motor < 0:
            continue
        rate, inertial = _observe_joint(t, arm, j, wrench, bias, inertia_force, k, dt)
        if (t.model.friction_learning or t.model.friction_errors) and not begins:
            _learn(t, j, sound, rate, inertial, dt)


@inner
def _observe_joint(t, arm, j, wrench, bias, inertia_force, k, dt):
    """Update the low-passed signals `means`, `load` and `residual` of a joint with a motor.

    `means` are the signals TORQUE … INERTIAL, low-passed, `load` is the torque of the wrist's
    wrench in this tick. A single wrong reading changes the residual by no more than `_OUTLIER`
    torque limits. Reads h, M and `column` of the joint in WORK, of MEMORY the rates of the arm's
    joints and the motor's torque, and the joint's former signals if wrenches have time stamps
    (`stamped`). Updates `past_weight`, too (torque of h less that of the bias, of the last tick),
    with time stamps `history` of PAST, and with each new reading `jitter` of FRICTION.

    Args:
        t: Tick.
        arm: ARM row.
        j: index of the joint.
        wrench: reading of the arm's wrist.
        bias: negative of the wrench that moves the bodies beyond the wrist at q̈ = 0.
        inertia_force: wrench that accelerates them by q̈. All three are at C in world axes (six
            numbers; N, N m).
        k: share of one step in the low-pass.
        dt: time since the last computed tick (s).

    Returns:
        Acceleration of the joint (rad/s², m/s²) and torque M q̈ − Jᵀ w_out (N m, N), of the instant
        of the wrench.
    """
    memory_rows = t.memory.joints
    row = memory_rows[j]
    joint_work = t.work.joints[j]
    joint = t.model.joints[j]
    inertial = -dot6(joint_work.column, inertia_force)
    for i in range(arm.first, arm.end):
        inertial += joint_work.M[i - arm.first] * memory_rows[i].rate
    weight = joint_work.h + dot6(joint_work.column, bias)
    if t.memory.balanced <= 1:  # without a last tick
        row.past_weight = weight
    mean_weight = 0.5 * (weight + row.past_weight)
    row.past_weight = weight
    torque = t.memory.torques[joint.motor] - mean_weight
    # in the order of the constants TORQUE … INERTIAL
    signals = (
        torque,
        row.sign,
        row.speed,
        row.past_v,
        row.friction,
        mean_weight,
        row.rate,
        inertial,
    )
    if t.memory.stamped:
        signals = _align(t, t.memory.past[j], signals, int(dt / t.model.period + 0.5))
    torque = signals[TORQUE]
    bound = _OUTLIER * joint.tau_max
    load = min(max(dot6(joint_work.column, wrench), torque - bound), torque + bound)
    row.means[TORQUE] += k * (torque - 0.5 * (load + row.load) - row.means[TORQUE])
    if t.memory.balanced > 1 and t.memory.repeated & WRISTS == 0:
        elapsed = dt + t.memory.old_wrists * t.model.period
        _note_jitter(t.memory.friction[j], load - row.load, elapsed)
    row.load = load
    for i in range(SIGN, RATE):
        row.means[i] += k * (signals[i] - row.means[i])
    row.residual = row.means[TORQUE] - signals[INERTIAL]
    return signals[RATE], signals[INERTIAL]


@leaf
def _note_jitter(friction_row, change, elapsed):
    """Update the variance of the smoothed residual that the noise of the wrist causes.

    Successive readings with white noise of variance σ² differ with the variance 2σ². Both
    low-passes with the time constants T = `LAG` and T' = `_SMOOTH` leave σ² Δt/(2(T + T')) of it,
    where Δt is the time between readings.

    Args:
        friction_row: FRICTION of a joint, of which `jitter` is changed (N² m², N²).
        change: of the torque of the wrist's reading since the last one (N m, N).
        elapsed: Δt (s).
    """
    variance = 0.25 * change * change * elapsed / (LAG + _SMOOTH)
    friction_row.jitter += elapsed / (_JITTER + elapsed) * (variance - friction_row.jitter)


@leaf
def _align(t, row, signals, ticks):
    """Store the signals of this tick; return those of the instant at which the wrench was measured.

    The wrench is `late` ticks older than the readings of the joints, by its time stamps. The
    history has the signals of the last `HISTORY` ticks, but none of ticks before torques and wrists
    were compared (`balanced`) or before the wrench had stamps (`stamped`); instead of those the
    oldest signals are returned that are stored. `instant` of MEMORY is the number of this tick.

    Args:
        t: Tick.
        row: PAST of the joint, changed: the signals are stored for lost ticks, too.
        signals: eight signals of this tick, from TORQUE to INERTIAL.
        ticks: ticks since the signals were last stored.

    Returns:
        Eight signals in the same order.
    """
    memory = t.memory
    for i in range(min(ticks, HISTORY)):
        at = (memory.instant - i) % HISTORY
        for kind in range(len(signals)):
            row.history[at, kind] = signals[kind]
    oldest = min(memory.balanced - 1, memory.instant - memory.stamped, HISTORY - 1)
    x = row.history[(memory.instant - min(memory.late, oldest)) % HISTORY]
    return join(six(x), (x[RATE], x[INERTIAL]))


@leaf
def _learn(t, j, sound, rate, inertial, dt):
    """Update the estimates of a joint's friction: the unidentified part and, every few ticks, θ.

    θ = (F, D, A, bias, μ) has Coulomb and viscous friction, inertia of the rotor, bias and error of
    the masses; `unlearned` is the friction that θ does not explain yet. With `friction_errors` both
    begin at once, else when residuals have exceeded rounding for some time, so that an exact model
    remains unchanged. A model without friction keeps F = D = 0 until friction is detected.
    Contradicted friction is discarded.

    Reads of the joint in MEMORY `residual` and the low-passed friction in `means` (N m, N),
    `speed`, and `unbalanced` (s for which motor torques contradict the wrist), and `balanced` of
    MEMORY. Changes `unlearned` (N m, N), `rotor` (kg m², kg), the state `friction_known`, and of
    FRICTION `applied` (share of θ that is compensated; 0 after a contradiction, as are `evidence`
    and `unlearned`), `smooth` (regressors) and the fields of the functions called here.

    Args:
        t: Tick.
        j: index of the joint.
        sound: whether the arm's wrist sensor is not suspected of a fault.
        rate: acceleration of the joint (rad/s², m/s²).
        inertial: M q̈ − Jᵀ w_out (N m, N); both of the instant of the wrench.
        dt: time since the last computed tick (s).
    """
    row = t.memory.joints[j]
    friction_row = t.memory.friction[j]
    missing = row.residual - row.means[FRICTION]
    state = begin_estimate(t, j, missing, dt)
    if state == LEARNED and friction_row.applied < 1.0:
        friction_row.applied = min(
            friction_row.applied + (dt / _RISE if _none_approaching(t) else 1.0), 1.0
        )
    if state == LEARNED or (state == SUSPECTED and t.model.friction_errors):
        aim = missing if row.unbalanced == 0.0 else 0.0  # an error of the wrist sensor is suspected
        row.unlearned += min(t.model.friction_smoothing * dt, 1.0) * (aim - row.unlearned)
    _update_rotor(row, friction_row, t.model.priors[j], state == LEARNED, dt)
    k = dt / (_SMOOTH + dt)
    _smooth_regressors(row, friction_row, rate, inertial, k)
    threshold = _MOVES * (SLIDES if t.model.joints[j].slides else 1.0)
    moves = _note_rest(friction_row, row.speed, threshold, state == LEARNED, dt)
    if t.model.friction_errors:  # what errors of the masses explain is no lack of friction
        masses = friction_row.theta[3] + friction_row.theta[4] * friction_row.smooth[WEIGHT]
        missing -= clamped(masses, _BIAS * abs(t.work.joints[j].h))
    if state == LEARNED and _is_contradicted(t, j, missing, moves, dt):
        t.memory.friction_known[j] = UNKNOWN
        friction_row.evidence = friction_row.applied = row.unlearned = 0.0
        return
    if (t.memory.balanced + j) % _TURNS or state == MODEL_ONLY or not sound:
        return
    is_settled = t.memory.balanced * dt > _SETTLED
    if t.model.friction_learning and is_settled and abs(friction_row.smooth[SIGN]) > _FULL:
        update_estimate(t, j, moves, min(_TURNS * k, 1.0), _TURNS * dt)


@inner
def _note_rest(friction_row, permitted_now, threshold, is_learned, dt):
    """Update the times for which a joint rests or is stuck, and determine whether it moves.

    A joint rests while it is slower than `_RESTS` times the threshold and slower than the share
    `_FOLLOWS` of the speed that is permitted; without identified friction the permitted speed must
    exceed the threshold, too. It is stuck while this share exceeds the threshold, and the joint is
    slower than the threshold: so much slower than commanded that noise of its speed, which
    interrupts a rest, does not matter. It moves if the permitted speed exceeds the threshold, and
    it has more than the share `_FOLLOWS` of it, in the same direction.

    Args:
        friction_row: FRICTION of the joint, of which `smooth` (low-passed residual and regressors)
            is read and `rested` and `stuck` (s without interruption) are changed.
        permitted_now: permitted speed of this tick (rad/s, m/s), not low-passed.
        threshold: speed below which a joint does not contribute to the estimate (rad/s, m/s).
        is_learned: whether friction of the joint has been identified.
        dt: time since the last computed tick (s).

    Returns:
        Whether the joint moves.
    """
    v = friction_row.smooth[V]
    permitted = friction_row.smooth[SPEED]
    least = _FOLLOWS * abs(permitted)
    rests = abs(v) < min(least, _RESTS * threshold) and (abs(permitted) > threshold or is_learned)
    friction_row.rested = friction_row.rested + dt if rests else 0.0
    friction_row.stuck = friction_row.stuck + dt if abs(v) < threshold < least else 0.0
    is_commanded = min(abs(permitted_now), abs(permitted)) > threshold
    return is_commanded and v * permitted > least * abs(permitted)


@inner
def _smooth_regressors(row, friction_row, rate, inertial, k):
    """Pass residual and regressors of a joint through the second low-pass, to `smooth`.

    The torque of `rotor`, the inertia of the rotor that M has beside the model's, is added to the
    residual and subtracted from the load, so that the estimate of A is that of the whole rotor.

    Args:
        row: JOINT_MEMORY, of which `residual`, `rotor` and `means` are read.
        friction_row: its FRICTION, of which `smooth` is changed.
        rate: acceleration (rad/s², m/s²).
        inertial: M q̈ − Jᵀ w_out (N m, N).
        k: share of one step in the low-pass.
    """
    means = row.means
    smooth = friction_row.smooth
    rotor = row.rotor * rate
    torque = row.residual + rotor
    load = means[WEIGHT] + inertial - rotor
    signals = (torque, means[SIGN], means[SPEED], means[V], rate, load)
    for i in range(len(signals)):
        smooth[i] += k * (signals[i] - smooth[i])


@leaf
def _update_rotor(row, friction_row, prior, is_learned, dt):
    """Update `rotor`, the inertia of a joint's rotor that is in M beside the model's.

    M is the joint-space inertia. `rotor` (kg m², kg) follows the certain part of the identified
    inertia A, with the time constant `_ROTOR_LAG`. Gains of forces and motions are accelerations: a
    rotor that M lacks reduces the effect of them all, and makes the brake of a contact weaker than
    its integral needs. The certain part is A less `_CERTAIN` standard deviations (√P_AA); it is 0
    until the standard deviation is at most `_MEASURED` times that of the prior (`doubt`). A is
    `theta[2]`, times the share `applied`, 0 to 1, that is phased in already.

    Args:
        row: JOINT_MEMORY.
        friction_row: its FRICTION.
        prior: its PRIOR.
        is_learned: whether its estimate is in use.
        dt: time since the last computed tick (s).
    """
    certain = 0.0
    deviation = sqrt(max(friction_row.P[2, 2], 0.0))
    if is_learned and deviation <= _MEASURED * prior.doubt[2]:
        A = friction_row.applied * friction_row.theta[2]
        doubt = _CERTAIN * deviation
        certain = A - min(max(A, -doubt), doubt)  # 0 within ±doubt, else nearer to 0 by it
    row.rotor += dt / (_ROTOR_LAG + dt) * (certain - row.rotor)


@leaf
def _is_contradicted(t, j, missing, moves, dt):
    """Test whether residuals have long shown less than half of the friction beyond the model's.

    The friction beyond the model is `friction` of the joint less that of the model's parameters F,
    D, A. It is compensated in this tick, unless the joint is faster than commanded. Friction of a
    joint is permanent, but an object that drags at the arm may be released: then the caller
    discards the whole estimate. Updates `contradicted` (s) of FRICTION, the time of contradiction
    less that without.

    Args:
        t: Tick.
        j: index of the joint.
        missing: residual less compensated friction (N m, N), of one instant; with `friction_errors`
            less what errors of the masses explain, too.
        moves: whether the joint moves; a joint at rest may need less than Coulomb friction F.
        dt: time since the last computed tick (s).

    Returns:
        True if the contradiction has lasted for `_CONTRADICTED`; the time then begins again.
    """
    friction_row = t.memory.friction[j]
    row = t.memory.joints[j]
    excess = row.friction - _friction_along(row, t.model.joints[j].theta)  # beyond the model
    is_clear = moves and abs(excess) > t.model.priors[j].noise and abs(row.sign) > _FULL
    contradicts = is_clear and missing * excess < -_LESS * excess * excess
    friction_row.contradicted = max(friction_row.contradicted + (dt if contradicts else -dt), 0.0)
    if friction_row.contradicted <= _CONTRADICTED:
        return False
    friction_row.contradicted = 0.0
    return True


@leaf
def _none_approaching(t):
    """Determine whether no contact is being approached: a step of friction would disturb it.

    Args:
        t: Tick, of which `phase` of the contacts in MEMORY is read.
    """
    none_approaching = True
    for c in range(t.model.n_contacts):
        none_approaching = none_approaching and t.memory.contacts[c].phase != APPROACHING
    return none_approaching


@inner
def permit_speeds(t):
    """Compute the permitted speeds s = J̄ P V_D of the joints (rad/s, m/s).

    V_D is the desired twist of the object, P the projection on the motions that the contacts
    permit, J̄ (n, 6) maps motions of the object to those of the joints. Along N, the columns of
    contact forces, the speed is that of the touched face, plus the speed of the approach for
    contacts that are being approached. The latter follows measured speeds and forces, so it is
    low-passed: the torque A ṡ of a rotor would return their noise to them. A_D is not added,
    because a step of it would change contact forces at once.

    Reads the desired twist `V_D`, the speeds `V_N` of the faces (m/s), `alpha_d` (N) and `damping`
    (N s/m), whose quotient is the speed of an approach, the factors `N_factor_t` and `N_basis_t` of
    N, and J̄ of the joints; `phase` of the contacts; `rated` (speed limit) and `slip` (s_0) of the
    joints. Fills in MEMORY of each joint `speed` s, its rate `turn` since the last tick, and its
    mean sign `sign`; of each kept column `approach`, the low-passed speed of its approach (m/s).

    Args:
        t: Tick.
    """
    work = t.work
    x = local(6)
    normal = local(6)  # NᵀV
    fill_free(x, work, motion_to_energy(work, work.V_D))
    for a in range(work.rank):
        column = t.memory.columns[work.kept[a]]
        is_approached = contact_of(t, work.kept[a]).phase == APPROACHING
        if is_approached and work.damping[a] > 0.0:
            change = work.alpha_d[a] / work.damping[a] - column.approach
            column.approach += work.dt / (_APPROACH + work.dt) * change
        else:
            column.approach = 0.0
        normal[a] = work.V_N[a] + column.approach
    if work.rank > 0:
        project_onto_columns(work.N_factor_t, work.N_basis_t, work.rank, x, normal)
    fill(x, turned_back(work, x))
    for j in range(t.model.n_joints):
        joint = t.model.joints[j]
        limit = min(joint.rated, _FASTEST)
        row = t.memory.joints[j]
        slip = joint.slip
        s = dot6(work.joints[j].J_bar, x)
        s = min(max(s, -limit), limit) if s == s else 0.0  # NaN where the command overflows
        last_s = row.speed if t.memory.ticked else s
        rate_limit = limit / _SUDDEN
        row.speed = s
        row.turn = min(max((s - last_s) / work.dt, -rate_limit), rate_limit)
        # mean of s/√(s² + s_0²) while s goes to s_1: (√(s_1² + s_0²) − √(s² + s_0²))/(s_1 − s)
        next_s = s + t.model.period * row.turn
        roots = sqrt(s * s + slip * slip) + sqrt(next_s * next_s + slip * slip)
        # = (s + s_1)/(√(s_1² + s_0²) + √(s² + s_0²)), which has no quotient 0/0 at s_1 = s
        row.sign = (s + next_s) / roots


@inner
def compensate_friction(t):
    """Add the compensated friction of `_compensation` (N m, N) to `tau` of the joints with motors.

    Fills `friction` of these joints, and the fields of `permit_speeds` and `_compensation`, among
    them `speed`, `turn` and `sign` of all joints in MEMORY.

    Args:
        t: Tick, with the torques of `allocate_torques` in `tau` of the joints.
    """
    permit_speeds(t)
    for j in range(t.model.n_joints):
        joint_work = t.work.joints[j]
        if t.model.joints[j].motor >= 0:
            joint_work.friction = _compensation(t, j)
            joint_work.tau += joint_work.friction


@leaf
def _compensation(t, j):
    """Compute the compensated friction f + g clip(e) of one joint.

    f is the friction that is identified or modelled (`believed_friction`), e = `unlearned` the
    friction that is not identified yet, g = `friction_share` its compensated share, and clip the
    limit to F + D |s| (Coulomb and viscous friction at the permitted speed s), and to `wrist_error`
    times the torque limit. With `friction_errors` the limit is wider by `_LINKS` |h|, and, where
    friction is learned and until it is identified, by the deviation of F that the prior assumes: a
    joint whose friction and rotor are unknown would follow no command else, where its links are
    light. A sticking joint keeps e while s reverses. If e then has the sign of the new f, it is set
    to zero, because more than F would act on the joint. With `friction_errors` it is kept, as it
    contains errors of the links' masses. Changes `friction` f and `unlearned` e of the joint in
    MEMORY.

    Args:
        t: Tick.
        j: index of the joint.

    Returns:
        Torque or force (N m, N).
    """
    row = t.memory.joints[j]
    last_friction = row.friction
    row.friction = believed_friction(t, j)
    F, D, _ = compensated_theta(t, j)
    bound = F + D * abs(row.speed)
    if t.model.friction_errors:
        bound += _LINKS * abs(t.work.joints[j].h)
        if t.model.friction_learning:
            bound += (1.0 - t.memory.friction[j].applied) * t.model.priors[j].doubt[0]
    elif last_friction * row.friction < 0.0 and row.friction * row.unlearned > 0.0:
        row.unlearned = 0.0
    bound = min(bound, t.model.wrist_error * t.model.joints[j].tau_max)
    remainder = t.model.friction_share * min(max(row.unlearned, -bound), bound)
    if t.memory.friction_known[j] == LEARNED:  # residuals have contradicted the model
        return _without_excess(t, j, row.friction + remainder)
    return row.friction + _without_excess(t, j, remainder)


@leaf
def _without_excess(t, j, torque):
    """Reduce a compensation that follows from residuals, of a joint that is faster than commanded.

    At a constant acceleration residuals do not distinguish friction from the inertia A q̈ of a
    rotor that the model lacks: whatever is compensated equals the residual, and is learned. Such a
    joint is accelerated beyond its command, and gains of accelerations brake it little where its
    inertia is mostly rotor. So its friction has to brake it.

    The command of a joint of speed v is q̈_c = ṡ + K_d (v_c − v) with the damping K_d of the motion
    gains, where v_c is the permitted speed s and what removes errors of the position. Where q̈_c
    brakes the joint, and the torque drives it, the torque is multiplied by 2 − (v − v_c)/x, at
    least 0 and at most 1, with the excess x of `_EXCESS` and `_EXCESS_SHARE` of |s|. With K_d = 0
    it stays. A motion law of the user's counts as one with the gains' K_d.

    Reads of the joint `acceleration` q̈_c (rad/s², m/s²), `speed` s and `turn` ṡ, and its
    low-passed measured speed in `means`.

    Args:
        t: Tick.
        j: index of the joint.
        torque: compensation (N m, N).

    Returns:
        Torque or force (N m, N).
    """
    row = t.memory.joints[j]
    acceleration = t.work.joints[j].acceleration
    deceleration = row.turn - acceleration
    v = row.means[V]
    drives = torque * v > 0.0 and abs(v) > _MOVES * (SLIDES if t.model.joints[j].slides else 1.0)
    # both: a step of s is in ṡ for one tick, and would count as an excess
    is_braked = torque * acceleration < 0.0 and torque * deceleration > 0.0
    if not (drives and is_braked):
        return torque
    excess = _EXCESS * (SLIDES if t.model.joints[j].slides else 1.0)
    excess = t.model.damping * (excess + _EXCESS_SHARE * abs(row.speed))
    if not 0.0 < excess < abs(deceleration):
        return torque
    return torque * max(2.0 - abs(deceleration) / excess, 0.0)


@leaf
def compensated_theta(t, j):
    """Return F, D and A of a joint: the identified ones, as far as phased in, or the model's.

    F is Coulomb friction, D viscous friction, A the inertia of the rotor beyond the model's; the
    part of A that is in the joint-space inertia already (`rotor`) is subtracted.

    Args:
        t: Tick.
        j: index of the joint.

    Returns:
        F (N m, N), D (N m s/rad, N s/m) and A (kg m², kg).
    """
    model_theta = t.model.joints[j].theta
    theta = linear(model_theta)
    if t.memory.friction_known[j] == LEARNED:
        friction_row = t.memory.friction[j]
        theta = add3(theta, friction_row.applied, minus3(friction_row.theta, model_theta))
    return theta[0], theta[1], theta[2] - t.memory.joints[j].rotor


@leaf
def _friction_along(row, theta):
    """Compute the friction F sign s + D s + A ṡ of a joint in this tick (N m, N).

    F is Coulomb friction, D viscous friction, A the rotor inertia that the model lacks, s the speed
    of the joint that the contacts permit.

    Args:
        row: JOINT_MEMORY, of which `sign` (of s, averaged), `speed` s (rad/s, m/s) and `turn` ṡ are
            read.
        theta: F (N m, N), D (N m s/rad, N s/m), A (kg m², kg).
    """
    return theta[0] * row.sign + theta[1] * row.speed + theta[2] * row.turn


@leaf
def believed_friction(t, j):
    """Compute the friction of one joint in this tick (N m, N), identified or modelled.

    The identified friction may differ from the model's by `wrist_error` times the torque limit plus
    the friction that has been identified for a long time (`trusted`). A larger difference may be an
    object that drags at the arm or an error of the wrist sensor.

    Args:
        t: Tick, with `speed`, `sign` and `turn` of the joint in MEMORY.
        j: index of the joint.
    """
    row = t.memory.joints[j]
    friction = model_friction = _friction_along(row, t.model.joints[j].theta)
    if t.memory.friction_known[j] == LEARNED:
        friction = _friction_along(row, compensated_theta(t, j))
        trusted = row.trusted[0] + row.trusted[1] * abs(row.speed) + row.trusted[2] * abs(row.turn)
        bound = t.model.wrist_error * t.model.joints[j].tau_max + trusted
        friction = min(max(friction, model_friction - bound), model_friction + bound)
    return friction
