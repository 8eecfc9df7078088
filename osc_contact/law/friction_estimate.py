"""Friction, rotor inertia and mass error of a joint by recursive least squares.

The residual r of a joint, see `joint_friction`, is explained by

    r ≈ φᵀθ,   φ = (sign s, q̇, q̈, 1, m),   θ = (F, D, A, bias, μ),

with Coulomb and viscous friction F and D, the inertia A of the rotor that the model lacks, a bias,
and the error μ of the masses by their torque m. s is the speed of the joint that the contacts
permit.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import add_scaled, dot
from osc_contact.law.jit import inner, leaf, local

_EVIDENCE = 0.15  #: s for which residuals must exceed rounding until identification begins
_STANDS = 0.01  #: s of rest until stiction is identified; knocks move the joint sooner
_HOLDS = 0.1  #: s of rest, or stuck, until a joint is certain to have friction
_FORGET = 2.0  #: s, time constant of forgetting
_SCATTER = 0.5  #: s, time constant of R, the variance of the residuals that θ does not explain
_QUIET = 0.1  #: least √R, as a share of the noise assumed at the start
_SEEN = 3.0  #: multiple of the noise that an element of φ must cause for its past to be forgotten
_MASSES = 0.05  #: deviation of the bias by errors of masses, as a share of gravity's torque
_LEAST = 0.3  #: least friction torque, as a share of the noise, for a model without friction
_SIZE = 5  #: length of θ

#: State of θ: not initialised; the model's; the model's, while an estimate runs; identified.
UNKNOWN, MODEL_ONLY, SUSPECTED, LEARNED = range(4)
#: Columns of `PAST`, and elements of `means` (RATE and INERTIAL are not low-passed).
TORQUE, SIGN, SPEED, V, FRICTION, WEIGHT, RATE, INERTIAL = range(8)
ACCELERATION = FRICTION  #: element of `smooth`, which has the acceleration in place of friction


@inner
def begin_estimate(t, j, missing, dt):
    """Update the state of a joint's friction estimate θ until its identification begins.

    θ = (F, D, A, bias, μ) has Coulomb and viscous friction, inertia of the rotor, bias and relative
    error of the masses. It has two values: `theta` is compensated, `estimate` is identified.
    UNKNOWN becomes MODEL_ONLY, where both are those of the model, and the covariance P (5, 5) is
    that of the prior. MODEL_ONLY ends once residuals have exceeded rounding for `_EVIDENCE`; at
    once if errors of the masses are compensated, too. It becomes SUSPECTED if `estimate` has to
    differ from the model by `sure` standard deviations before it is used, else (`sure` = 0)
    LEARNED.

    Reads of PRIOR `noise` and `rounding` (N m, N: standard deviation of the residual, and its
    largest value with an exact model) and `doubt` (5,; standard deviations of θ at the start), and
    `h` of the joint. Fills at the start `noise` (variance of the residual), `theta`, `estimate` and
    `P` of FRICTION; updates its `evidence` (s of residuals above rounding, less s below).

    Args:
        t: Tick.
        j: index of the joint.
        missing: residual less compensated friction (N m, N).
        dt: time since the last computed tick (s).

    Returns:
        The new state, which is stored in `friction_known` of MEMORY.
    """
    prior = t.model.priors[j]
    friction_row = t.memory.friction[j]
    state = t.memory.friction_known[j]
    if state == UNKNOWN:
        state = MODEL_ONLY
        friction_row.noise = prior.noise * prior.noise
        friction_row.P[:] = 0.0
        for i in range(_SIZE):
            friction_row.theta[i] = friction_row.estimate[i] = t.model.joints[j].theta[i]
            friction_row.P[i, i] = prior.doubt[i] * prior.doubt[i]
        deviation = _MASSES * t.work.joints[j].h
        friction_row.P[3, 3] += deviation * deviation  # the bias takes errors of the masses, too
    if state == MODEL_ONLY:
        change = dt if abs(missing) > prior.rounding else -dt
        friction_row.evidence = max(friction_row.evidence + change, 0.0)
        if friction_row.evidence > (0.0 if t.model.friction_errors else _EVIDENCE):
            state = SUSPECTED if prior.sure > 0.0 else LEARNED
    t.memory.friction_known[j] = state
    return state


@leaf
def update_estimate(t, j, moves, k, dt):
    """Update θ of a joint that moves, or that rests although it is commanded to move.

    θ = (F, D, A, bias, μ) has Coulomb and viscous friction, inertia of the rotor, bias and error of
    the masses. The residual of a resting joint is compared with `estimate`, not with `theta`, which
    attributes the residual to the bias as long as the joint may be frictionless. A joint that rests
    for long is certain to have friction; one standard deviation of the residual shows how much,
    where it is commanded to move fast.

    Reads of FRICTION `smooth` (low-passed residual and regressors), `noise` and `jitter` (variance
    of the residual, see `_variance`), `P` (covariance of θ), `rested` (s at rest) and `stuck` (s at
    rest although commanded to move fast); of PRIOR the upper bounds `high` of θ; and the permitted
    `speed` of the joint. Changes `estimate`, `theta`, `P`, `noise`, and the state `friction_known`
    to LEARNED.

    Args:
        t: Tick.
        j: index of the joint.
        moves: whether it moves.
        k: share of this update in the low-passed residual.
        dt: time since the last update (s).
    """
    prior = t.model.priors[j]
    friction_row = t.memory.friction[j]
    states = t.memory.friction_known
    smooth = friction_row.smooth
    a = smooth[ACCELERATION]
    estimate = friction_row.estimate  # F, D, A, bias, μ
    # residual that rotor, bias and masses do not explain, less the friction expected so far
    friction = smooth[TORQUE] - estimate[2] * a - estimate[3] - estimate[4] * smooth[WEIGHT]
    expected = max(estimate[0], 0.0) + max(estimate[1], 0.0) * abs(t.memory.joints[j].speed)
    excess = friction * smooth[SIGN] - expected
    deviation = sqrt(_variance(prior, friction_row) + friction_row.P[2, 2] * a * a)
    is_stuck = friction_row.stuck > _HOLDS
    sticks = is_stuck and excess > deviation
    sticks = sticks or (friction_row.rested > _STANDS and excess > _SEEN * deviation)
    holds = is_stuck or friction_row.rested > _HOLDS
    holds = holds and friction * smooth[SIGN] > _SEEN * deviation
    if not (moves or sticks or holds):
        return
    phi = (smooth[SIGN], smooth[V], a, 1.0, smooth[WEIGHT])
    if sticks:  # gives a lower bound of F, so the covariance stays
        estimate[0] += min(excess, max(prior.high[0] - estimate[0], 0.0))
    elif moves:
        _regress(prior, friction_row, phi, smooth[TORQUE], k, dt)
    C = local(_SIZE, _SIZE)
    _keep_bounds(prior, friction_row, C)
    if states[j] == SUSPECTED and (
        sticks
        or holds
        or _test_and_reset_friction(prior, t.model.joints[j].theta, friction_row, phi, C)
    ):
        states[j] = LEARNED
        _keep_bounds(prior, friction_row, C)


@leaf
def _variance(prior, friction_row):
    """Compute the variance R of a residual that θ does not explain (N² m², N²).

    It is the mean square of r − φᵀθ so far (`noise`), but not less than the part of it that the
    noise of the wrist causes now (`jitter`), which is known before the joint has moved for long.

    Args:
        prior: PRIOR of a joint.
        friction_row: its FRICTION.
    """
    least = _QUIET * prior.noise
    return max(friction_row.noise, friction_row.jitter, least * least)


@leaf
def _regress(prior, friction_row, phi, r, k, dt):
    """Update the estimate of θ of a joint and its covariance P by recursive least squares.

        θ ← θ + g(r − φᵀθ),   g = Pφ/(R/k + φᵀPφ),   P ← (1 − g φᵀ)P

    θ (5,) has F, D, A, bias and μ, φ (5,) their regressors in the residual r (N m, N), and R is the
    variance of r that θ does not explain (`_variance`). It follows the mean square of r − φᵀθ; it
    is increased for outliers beyond `_SEEN` standard deviations. Old residuals are forgotten with
    the time constant `_FORGET`, for those elements of θ that now affect r by more than `_SEEN`
    times its noise, and whose standard deviation is below `spread` of the prior.

    Args:
        prior: PRIOR of a joint.
        friction_row: its FRICTION, of which `estimate`, `P` and `noise` are changed.
        phi: (5,) regressors φ: sign, speed, acceleration, 1, load.
        r: residual (N m, N).
        k: weight (0 … 1) of the latest residual in the low-pass that gives r. Successive r are
            correlated, so an update counts as a measurement with the variance R/k.
        dt: time since the last update (s).
    """
    gain = local(_SIZE)
    growth = local(_SIZE)
    estimate = friction_row.estimate
    P = friction_row.P
    miss = r - dot(estimate, phi, _SIZE)
    noise = prior.noise
    bound = 10.0 * noise
    bounded = min(max(miss, -bound), bound)
    square = bounded * bounded
    friction_row.noise += dt / (_SCATTER + dt) * (square - friction_row.noise)
    R = _variance(prior, friction_row)
    for i in range(_SIZE):
        gain[i] = dot(P[i], phi, _SIZE)
    variance = dot(gain, phi, _SIZE)  # φᵀPφ
    total = R / k + variance
    total *= max(miss * miss / (_SEEN * _SEEN * (R + variance)), 1.0)  # outliers count less
    for i in range(_SIZE):
        estimate[i] += gain[i] * miss / total
        forgetting = 1.0 + 0.5 * dt / _FORGET  # of a standard deviation: half that of P
        deviation = forgetting * sqrt(max(P[i, i] - gain[i] * gain[i] / total, 0.0))
        # an element without effect is not measured now, and would only be forgotten
        has_effect = abs(phi[i]) * prior.spread[i] > _SEEN * noise
        growth[i] = forgetting if has_effect and deviation < prior.spread[i] else 1.0
    for i in range(_SIZE):
        for j in range(i + 1):
            P[i, j] = growth[i] * growth[j] * (P[i, j] - gain[i] * gain[j] / total)
            P[j, i] = P[i, j]


@leaf
def _keep_bounds(prior, friction_row, C):
    """Fill `theta` with friction parameters within their bounds, nearly the most likely ones.

    `estimate` (5,) has friction, rotor inertia, bias and error of masses without bounds, with the
    covariance P (5, 5). Elements beyond a bound are fixed there, one after the other, and the
    others are conditioned on them. A fixed element is not freed again, so that strongly correlated
    ones may both end at their bounds. `estimate` is not changed, since it would drift otherwise.

    Args:
        prior: PRIOR of a joint, of which the bounds `low` and `high` are read.
        friction_row: its FRICTION, of which `theta` is filled.
        C: (5, 5), filled with the covariance of θ.
    """
    theta = friction_row.theta
    for i in range(_SIZE):
        theta[i] = friction_row.estimate[i]
        for j in range(_SIZE):
            C[i, j] = friction_row.P[i, j]
    for step in range(2 * _SIZE):  # each element twice: conditioning on a later one may move it
        i = step % _SIZE
        bound = min(max(theta[i], prior.low[i]), prior.high[i])
        if theta[i] != bound and C[i, i] > 0.0:
            _condition(theta, C, i, bound)
    for i in range(_SIZE):
        theta[i] = min(max(theta[i], prior.low[i]), prior.high[i])


@leaf
def _test_and_reset_friction(prior, model_theta, friction_row, phi, C):
    """Test friction and rotor of a joint against the model's values, and reset them to these.

    χ² = Σ (θ_i − known_i)²/C_ii over i = F, D, A (Coulomb and viscous friction, inertia of the
    rotor), with the model's values `known` and the covariance C, where each term is conditioned on
    those before it. After the test F, D and A of `theta` are the model's, and the bias and μ are
    conditioned on them; the caller restores `theta` where the test shows friction.

    Args:
        prior: PRIOR of a joint.
        model_theta: (5,) θ of its model.
        friction_row: its FRICTION; `theta` changed.
        phi: (5,) regressor.
        C: (5, 5) covariance of `theta`, overwritten.

    Returns:
        True if χ² exceeds the prior's bound and φᵀ(θ − known) is large enough to matter.
    """
    theta = friction_row.theta
    torque = 0.0
    distance = 0.0
    for i in range(3):
        torque += phi[i] * (theta[i] - model_theta[i])
    for i in range(3):
        if C[i, i] > 0.0:
            difference = theta[i] - model_theta[i]
            distance += difference * difference / C[i, i]
            _condition(theta, C, i, model_theta[i])
        theta[i] = model_theta[i]
    return distance > prior.sure * prior.sure and abs(torque) > _LEAST * prior.noise


@leaf
def _condition(theta, C, i, value):
    """Condition a Gaussian with mean θ and covariance C on θ_i = value.

        θ ← θ − C_i (θ_i − value)/C_ii,   C ← C − C_i C_iᵀ/C_ii

    C_i (5,) is column i of C.

    Args:
        theta: (5,) mean, changed.
        C: (5, 5) covariance, changed; row and column i become zero.
        i: index of the element that becomes certain.
        value: value that it takes.
    """
    change = (theta[i] - value) / C[i, i]
    add_scaled(-change, C[i], _SIZE, theta)
    theta[i] = value
    for j in range(_SIZE):
        if j != i:
            add_scaled(-C[j, i] / C[i, i], C[i], _SIZE, C[j])
    for j in range(_SIZE):
        C[i, j] = C[j, i] = 0.0
