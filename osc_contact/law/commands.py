"""Motion law; shaping of steps of desired forces; brake on oscillating contacts."""

from __future__ import annotations

from math import atan2, copysign, sqrt

from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.normals import learn_normal
from osc_contact.law.phases import APPROACHING, predict_force
from osc_contact.law.records import SATURATED, YIELDING, body_of, contact_of
from osc_contact.law.vectors import (
    add,
    add3,
    angular,
    axis3,
    column3,
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
    origin,
    plus3,
    rotated,
    row3,
    scaled,
    scaled3,
)

# --- The motion law: pose error, PID, and the classical acceleration made spatial -----------------

#: Least room of a joint for the feedback below its largest speed, as a share of the latter.
_LEAST_ROOM = 0.02
#: Acceleration by which the feedback may drive a joint, over K_d times its room below the largest
#: speed. It bounds what a joint at rest gets, too: contact friction may need more than K_d v_max.
_STEEPNESS = 2.0
#: Speed of the object by the feedback (m/s, rad/s) that brings no joint near its limit: only in
#: singular postures do joints move a hundred times as fast.
_SLOW = 1e-3


@inner
def rotation_vector(R):
    """Rotation vector log₃ R (rad, three numbers) of a rotation matrix: axis times angle.

    Args:
        R: matrix, at least 3×3, with the rotation in its first three rows and columns.
    """
    v = (0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1]))
    sine = sqrt(dot3(v, v))
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = atan2(sine, cosine)
    if cosine > -0.99:
        return scaled3(angle / sine if sine > 1e-6 else 1.0 + sine * sine / 6.0, v)
    # Near a half turn the axis a is taken from the symmetric part (1 − cos) aaᵀ + cos 1, from its
    # longest column: the largest component of a has the most reliable sign.
    k = 0
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    axis = add3(scaled3(0.5, plus3(row3(R, k), column3(R, k))), -cosine, axis3(k))
    return scaled3(copysign(angle / sqrt(dot3(axis, axis)), v[k]), axis)


@inner
def pose_error(X_WD, X_WO):
    """Compute the pose error [p_D − p_O; log₃(R_D R_Oᵀ)] (m, rad), six numbers in world axes.

    p and R are position and rotation of the desired pose (D) and of the object (O); log₃ is the
    rotation vector.

    Args:
        X_WD, X_WO: (4, 4) desired and actual pose.
    """
    R = local(3, 3)
    for i in range(3):  # row i of R_D R_Oᵀ: R_O times row i of R_D
        fill3(R[i], rotated(X_WO, X_WD[i]))
    return join(minus3(origin(X_WD), origin(X_WO)), rotation_vector(R))


@leaf
def feedback_share(t):
    """Share φ of the motion feedback that keeps all joints within their speed limits.

    Against the damping K_d(V_D − V) the feedback x = K_p e + K_i ∫Ω_m e dt brings the speed v of a
    joint to J̄x/K_d. Where friction has held a joint, or an object was held or pushed, e and its
    integral are large, and this speed is beyond the limits of joints. φ keeps the acceleration φ J̄x
    below `_STEEPNESS` K_d (v_max − |v|) for each joint that x drives, so that it stays below v_max,
    `fastest` times its limit. φ is 1 for small errors, without a damping gain, and in singular
    postures: there J̄ grows without bound, and `reduce_motion` limits the command. In between the
    excess of 1/φ over 1 counts by the least share of a lost direction.

    Args:
        t: Tick, of which `free_error` (the part of e that contacts and arms permit), `motion_sum`,
            `share` of the lost directions of the arms, J̄ and speed v of the joints with motors,
            and their limits `speed_max` (rad/s, m/s) are read.
    """
    model = t.model
    work = t.work
    if not model.damping > 0.0:
        return 1.0
    x = scaled(model.stiffness / model.damping, work.free_error)
    x = add(x, model.integral / model.damping, t.memory.motion_sum)
    largest = 0.0
    for i in range(6):
        largest = max(largest, abs(x[i]))
    if largest < _SLOW:
        return 1.0
    x = motion_to_energy(work, x)
    ratio = 1.0
    for j in range(model.n_joints):
        change = dot6(work.joints[j].J_bar, x)
        limit = model.fastest * model.joints[j].speed_max
        v = work.joints[j].v
        room = max(limit - abs(v), _LEAST_ROOM * limit) if v * change > 0.0 else limit
        if abs(change) > ratio * _STEEPNESS * room:
            ratio = abs(change) / (_STEEPNESS * room)
    least_share = 1.0
    if work.n_lost > 0:
        for k in range(model.n_arms):
            for e in range(work.arms[k].n_lost):
                least_share = min(least_share, work.arms[k].share[e])
    return 1.0 / (1.0 + least_share * (ratio - 1.0))


@inner
def command_motion(t, share):
    """Fill `a_u` (6,), the commanded spatial acceleration of the object at O (m/s², rad/s²).

        a_u = a_D + K_d(V_D − V) + φ (K_p e + K_i ∫φ Ω_m e dt) − [ω × v; 0]

    a_D and V_D are the desired acceleration and twist, V = (v, ω) the measured twist, e the pose
    error, ∫Ω_m e dt the integral of its part that contacts permit, and K_p (1/s²), K_d (1/s), K_i
    (1/s³) the gains. The last summand converts the classical acceleration to the spatial one. Reads
    `error` (e) and `motion_next` (the integral), `V_O`, and `V_D` and `A_D`.

    Args:
        t: Tick.
        share: φ of `feedback_share`.
    """
    V_O = t.work.V_O
    a = add(t.input.A_D, t.model.damping, minus(t.input.V_D, V_O))
    a = add(a, share * t.model.stiffness, t.work.error)
    a = add(a, share * t.model.integral, t.work.motion_next)
    fill(t.work.a_u, join(minus3(a, cross(V_O[3:], V_O)), angular(a)))


# --- Steps of desired forces, and the brake on oscillating contacts -------------------------------
#
# A step of the commanded force would excite an oscillation of the contact (its stiffness with the
# mass behind it) and, through it, of the other contacts. Therefore the remainder w of a step is
# subtracted from the desired force; w vanishes within the rise time T along the minimum-jerk
# quintic:
#
#     α_s = α_d − w,   w(x) = (1 − x)³(a + bx + cx²),   x = t / T
#
# When another step follows before T has passed, a, b and c continue the value, slope and curvature
# of w. Slow changes of α_d pass unchanged. A contact that becomes active starts from its measured
# force; in the very first tick it starts from zero, because no force has been measured under
# control yet. While |w| is a large part of the force the integral is slowed, then paused: it would
# treat w as an error. It goes on while a contact is unloaded that leaves the active set, and while
# the force of a new one rises, because the forces of those that stay are wanted as before.
#
# Internal forces are shaped in the same way with a timer of their own, so that tightening a grasp
# leaves the contact forces unchanged. In the very first tick they equal the desired ones, because
# an object held by friction at the grasps must not fall.
#
# The brake commands the normal acceleration −κ(NᵀV_rel − v̄) instead of zero. v̄ is the lasting part
# of the speed, so an object that slides along a tilted face is not braked. As an acceleration the
# same κ suits every mass and every basis of N; the force is larger by the factor (NᵀΦN)⁻¹.
#
# On a face that yields by s per unit of force, this brake is too weak where the contact moves
# slowly, and zero where the motion of the face is measured. There the brake is
#
#     b = κ(u + (K_i − w) p) − s α̈_s,   u = NᵀV − v̂ − s α̇_s,   ṗ = u − w p
#
# v̂ is the speed at which the face is driven: a low-pass of V_N − s α̇ where its motion is measured,
# else 0. w is the rate of v̄ and of this low-pass. s is estimated from its declared value s_0: with
# x̃, α̃ and α̃_s the position of the contact, its force and the commanded force, each after a
# high-pass with the rate w,
#
#     s = (∫x̃ α̃_s + w_0 s_0) / (∫α̃ α̃_s + w_0)
#
# with exponential forgetting. Noise and sliding on a tilted face are not correlated with α̃_s.

_SUDDEN_RATE = 20.0  #: 1/s; a desired force that changes faster than this times its size is a step
_FADING_RATE = 0.5  #: 1/s; rate at which the size of a former force is forgotten
#: Share of its desired force from which on a contact shows the tilt of its face.
_PRESSING_SHARE = 0.3
#: Share of a force's size; with a larger remainder of a step the integral pauses, with a smaller
#: one it is slowed in proportion.
_PAUSING_SHARE = 0.1
_RATE_LAG = 0.01  #: s, time constant of the low-pass of α̈_s
_COMPLIANCE_MEMORY = 2.0  #: s, time constant of forgetting in the estimate of s
_PRIOR_TIME = 0.002  #: s; w_0 is this time multiplied by the squared size of the force
_MOST_COMPLIANCE = 20.0  #: largest estimate of s, as a multiple of s_0


@inner
def shape_steps(t, is_custom):
    """Shape steps of desired forces: fill `goal` of the active columns with α_s = α_d − w (N).

    α_d is the desired force and w (N) the part of a step that is still to come, a quintic that
    falls to zero in the rise time (s). Where a desired force changes suddenly, the steps of all
    columns begin anew with the rise time `step_time` of MODEL; else the steps of MEMORY continue.

    Fills of the columns `goal` (N), `scale` (size of the force, N), `shaped`, `to_come` (a, b, c of
    w, N); of WORK `step_left` (remaining share of the rise time), `step_time` (s), and
    `integral_scale` (0 … 1), the factor of the integral gain. It is 1 − x/`_PAUSING_SHARE`, at
    least 0, with the largest |w| as a share x of the size of its force. Contacts that unload, or
    that the user has just made active, do not count.

    Args:
        t: Tick.
        is_custom: whether the force law is the user's own, for which steps are not shaped.
    """
    memory = t.memory
    work = t.work
    dt = work.dt
    last_time = memory.step_time
    rise_time = 0.0 if is_custom else t.model.step_time
    remaining = 0.0 if is_custom else memory.step_left  # share 1 − x of the rise time
    if remaining > 0.0:
        remaining = max(remaining - dt / last_time, 0.0)
    is_shaped = remaining > 0.0 or rise_time > 0.0
    # size of the step of each column in this tick, and whether one is sudden
    is_sudden = False
    for i in range(work.count):
        j = work.chosen[i]
        row = work.columns[j]
        goal = row.goal = work.goal[j]
        faded = memory.columns[j].scale * (1.0 - _FADING_RATE * dt)
        row.scale = max(abs(goal), faded) if is_shaped else 0.0
        is_approached = is_shaped and contact_of(t, j).phase == APPROACHING
        row.shaped = 0 if is_custom or is_approached else 1
        step = goal - _start_of_step(t, j)
        row.to_come[0] = step  # for the second loop
        is_sudden = is_sudden or (row.shaped and abs(step) > _SUDDEN_RATE * dt * row.scale)
    is_sudden = is_sudden and rise_time > 0.0
    # new steps are added to those that are still to come
    stretch = rise_time / last_time if remaining > 0.0 else 1.0
    largest = 0.0  # w as a share of the size of the force
    for i in range(work.count):
        j = work.chosen[i]
        row = work.columns[j]
        step = row.to_come[0] if row.shaped else 0.0
        to_come = (0.0, 0.0, 0.0)
        if is_shaped and row.shaped and memory.columns[j].has_desired:
            to_come = linear(memory.columns[j].to_come)
        if is_sudden:
            to_come = _add_step_to_remainder(to_come, step, remaining, stretch)
        fill3(row.to_come, to_come)
        w = _still_to_come(to_come, 1.0 if is_sudden else remaining)
        row.goal -= w
        contact = contact_of(t, j)
        is_new = memory.chosen_set and contact.since < rise_time
        if row.scale > 0.0 and contact.unloading == 0.0 and not is_new:
            largest = max(largest, abs(w) / row.scale)
    work.step_left = 1.0 if is_sudden else remaining
    work.step_time = rise_time if is_sudden else last_time
    work.integral_scale = max(1.0 - largest / _PAUSING_SHARE, 0.0)


@leaf
def _start_of_step(t, j):
    """Force (N) from which a change of a column's desired force begins.

    It is the last desired force, if one was desired in the last tick; else the measured force, 0 in
    the very first tick. With contact phases a measured force is limited to the range from 0 (of a
    pair that only pushes) to the desired force, as that of an impact is not to be maintained.

    Args:
        t: Tick, of which `alpha` (measured force, N) and `goal` (N) of WORK, and `ticked`,
            `has_desired` and `desired` (N) of MEMORY are read.
        j: index of the column among all columns of the model.
    """
    goal = t.work.goal[j]
    last = t.memory.columns[j]
    start = t.work.alpha[j] if t.memory.ticked else 0.0
    if last.has_desired:
        start = last.desired
    elif t.model.phased and goal > 0.0:
        start = min(start, goal)  # the force of an impact is not maintained
        if body_of(t, j).pushes:
            start = max(start, 0.0)  # a face does not pull
    return start


@inner
def shape_squeeze(t):
    """Fill `goal` of the internal forces (N) from the desired `squeeze`, with shaped steps.

    α_s = α_d − w as in `shape_steps`, with the desired force α_d = `squeeze` of MEMORY (N) of each
    bar, and the part w of a step that is still to come, a quintic with the coefficients a, b, c. In
    the very first tick the desired force acts at once. With three or more arms, internal forces
    that are not commanded follow from least effort. A step from there begins at zero force, and a
    step to there reaches zero before least effort takes over.

    Fills of `internal` of WORK `goal` (α_s, N), `scale` (size of the force, N) and `to_come` (a, b,
    c; N), of WORK `squeeze_left` (remaining share of the rise time) and `squeeze_time` (rise time,
    s); sets `commanded` while a step lasts.

    Args:
        t: Tick.
    """
    memory = t.memory
    work = t.work
    dt = work.dt
    last_time = memory.squeeze_time
    rise_time = t.model.step_time
    remaining = memory.squeeze_left  # share 1 − x of the rise time
    if remaining > 0.0:
        remaining = max(remaining - dt / last_time, 0.0)
    # size of each step in this tick, and whether one is sudden
    is_sudden = False
    for bar in range(t.model.n_bars):
        row = work.internal[bar]
        last = memory.internal[bar]
        desired = memory.squeeze[bar]
        start = last.desired if memory.ticked else desired
        row.goal = desired - start  # the step, for the second loop
        row.scale = max(abs(desired), last.scale * (1.0 - _FADING_RATE * dt))
        is_sudden = is_sudden or abs(row.goal) > _SUDDEN_RATE * dt * row.scale
    is_sudden = is_sudden and rise_time > 0.0
    # new steps are added to those that are still to come
    stretch = rise_time / last_time if remaining > 0.0 else 1.0
    for bar in range(t.model.n_bars):
        row = work.internal[bar]
        to_come = (0.0, 0.0, 0.0)
        if remaining > 0.0:
            to_come = linear(memory.internal[bar].to_come)
        if is_sudden:
            to_come = _add_step_to_remainder(to_come, row.goal, remaining, stretch)
        fill3(row.to_come, to_come)
        row.goal = memory.squeeze[bar] - _still_to_come(to_come, 1.0 if is_sudden else remaining)
    work.squeeze_left = 1.0 if is_sudden else remaining
    work.squeeze_time = rise_time if is_sudden else last_time
    if work.squeeze_left > 0.0:
        work.commanded = 1


@leaf
def _still_to_come(to_come, remaining):
    """Compute the remainder of a step (N), w = (1 − x)³(a + b x + c x²).

    x is the elapsed share of its rise time.

    Args:
        to_come: (3,) a, b, c of the quintic (N).
        remaining: remaining share 1 − x of the rise time.
    """
    a, b, c = to_come
    x = 1.0 - remaining
    return remaining * remaining * remaining * (a + x * (b + x * c))


@inner
def _add_step_to_remainder(to_come, step, remaining, stretch):
    """Compute the quintic of a step's remainder after another step is added.

    The remainder of a step is w = (1 − x)³(a + b x + c x²) (N) at the elapsed share x of its rise
    time. A new step of size 1 has a = 1, b = 3, c = 6: slope and curvature of w are zero at x = 0.

    Args:
        to_come: (3,) a, b, c of the remainder of the former step (N).
        step: size of the new step (N).
        remaining: remaining share 1 − x of the former step's rise time.
        stretch: ratio of the new rise time to the former one.

    Returns:
        Coefficients a, b, c (N) of the sum, whose rise time begins now.
    """
    return add3(_continue_remainder(to_come, remaining, stretch), step, (1.0, 3.0, 6.0))


@inner
def _continue_remainder(to_come, remaining, stretch):
    """Compute the quintic that continues the remainder of a step with a new rise time.

    The remainder is w = (1 − x)³(a + b x + c x²) (N) at the elapsed share x of the rise time.
    Value, slope and curvature of w are continuous.

    Args:
        to_come: (3,) a, b, c of the former remainder (N).
        remaining: its remaining share 1 − x.
        stretch: ratio of the new rise time to the former one.

    Returns:
        Coefficients a, b, c (N) of the new remainder, whose rise time begins now.
    """
    a, b, c = to_come
    x = 1.0 - remaining
    P = a + x * (b + x * c)  # w = (1 − x)³ P(x)
    slope = b + 2.0 * x * c
    bend = 2.0 * c
    # w and its derivatives by the new x, whose unit is longer by the factor `stretch`
    w = remaining * remaining * remaining * P
    w_1 = stretch * (remaining * remaining) * (remaining * slope - 3.0 * P)
    w_2 = (
        (stretch * stretch)
        * remaining
        * (6.0 * P - 6.0 * remaining * slope + remaining * remaining * bend)
    )
    # at x = 0 the new quintic has the value a, the slope b − 3a, the curvature 2c − 6b + 6a
    return w, w_1 + 3.0 * w, 0.5 * w_2 + 3.0 * w_1 + 6.0 * w


@leaf
def holds_at_zero(t, j):
    """Return whether column j is of a contact that can also pull, without a desired force.

    No force is desired of any column of this contact. Reads `pushes` of the bodies in MODEL (1: the
    contact can only push), and `alpha_d` (N) of the columns.

    Args:
        t: Tick.
        j: index of the column among all columns of the model.
    """
    if body_of(t, j).pushes:
        return False
    contact = t.model.columns[j].contact
    for k in range(t.model.n_columns):
        if t.model.columns[k].contact == contact and t.work.columns[k].alpha_d != 0.0:
            return False
    return True


@inner
def brake_contacts(t):
    """Replace the gains `brake` κ (1/s) of the kept columns by the decelerations of the brake.

    The deceleration, in m/s² for columns that are forces, is κ(NᵀV_rel − v̄): the speed of the
    contact less its lasting part v̄ (`_lasting_speed`). Of contacts that hold without a desired
    force the whole speed is braked. On a yielding face it is κ(u + (K_i − w) p) − s α̈_s, with the
    unexplained speed u (m/s) and its integral p (m) from `_deflection`, the force gain K_i and the
    rate w of `_washout_rate` (1/s), the compliance s (m/N) and the second derivative of the
    commanded force α_s. On a yielding face whose motion is not measured (`V_N` = 0), the normal is
    not turned in this tick: `slides` becomes 0 and `turned` equal to `turn`. Reads `speed`, `V_N`,
    and in MEMORY `drift` (v̄) and `eased_rate` (low-passed α̇_s) of the columns, and the fields that
    `_deflection`, `_compliance` and `holds_at_zero` read.

    Args:
        t: Tick.
    """
    work = t.work
    for a in range(work.rank):
        j = work.kept[a]
        if body_of(t, j).kind != YIELDING:
            drift = 0.0 if holds_at_zero(t, j) else _lasting_speed(t, j)
            work.brake[a] *= work.speed[a] - drift
            continue
        u, p, _, rate = _deflection(t, a, j)
        work.brake[a] *= u + (t.model.force_gain - _washout_rate(t)) * p
        acceleration = (rate - t.memory.columns[j].eased_rate) / _RATE_LAG
        work.brake[a] -= _compliance(t, j) * acceleration
        column = work.columns[j]
        if work.V_N[a] == 0.0:  # an unmeasured yield would be mistaken for a tilt of the face
            column.slides = 0.0
            fill3(column.turned, column.turn)


@leaf
def _lasting_speed(t, j):
    """Compute the lasting speed v̄ of a column (m/s); of a face or an edge the mean of its columns.

    A flat face slides along a tilted one with the same speed at all corners. Differences between
    them are its rotation against the other face, which ends when it lies flat and is braked.

    Args:
        t: Tick, with `drift` (v̄ of each column, m/s) in MEMORY.
        j: index of the column among all columns of the model.
    """
    c = t.model.columns[j].contact
    if t.model.bodies[c].face == 0:
        return t.memory.columns[j].drift
    total = 0.0
    n = 0
    for i in range(t.model.n_columns):
        if t.model.columns[i].contact == c:
            total += t.memory.columns[i].drift
            n += 1
    return total / n


@leaf
def _washout_rate(t):
    """Compute the rate w (1/s) with which lasting signals of a contact are forgotten.

    It is the rate of the low-pass of v̄, the lasting part of a contact's speed, and of the
    high-passes in the estimate of a face's compliance; `drift_share` is the share of one period in
    them.

    Args:
        t: Tick.
    """
    return t.model.drift_share / t.model.period


@leaf
def _compliance(t, j):
    """Estimate the compliance s (m/N) of the yielding face that a column presses on.

        s = (∫x̃ α̃_s dt + w_0 s_0) / (∫α̃ α̃_s dt + w_0),   0 ≤ s ≤ `_MOST_COMPLIANCE` s_0

    x̃ (m), α̃ and α̃_s (N) are position, force and commanded force after a high-pass, s_0 is the
    declared compliance, and w_0 (N² s) its weight in the estimate.

    Args:
        t: Tick, with `correlation`, `excitation` and `scale` of the column in MEMORY.
        j: index of the column among all columns of the model.
    """
    row = t.memory.columns[j]
    s = body_of(t, j).parameters[0]
    weight = _PRIOR_TIME * row.scale * row.scale
    if weight == 0.0:
        return s
    estimate = (row.correlation + weight * s) / (max(row.excitation, 0.0) + weight)
    return min(max(estimate, 0.0), _MOST_COMPLIANCE * s)


@leaf
def _deflection(t, a, j):
    """Compute the variables of the brake on a yielding face in this tick.

    u = NᵀV − v̂ − s α̇_s is the speed of the contact that neither the motion of the face nor the
    commanded force explains: NᵀV is the speed of the object along the column, v̂ the low-passed
    speed of the face, s (m/N) its compliance, α̇_s (N/s) the rate of the commanded force. p is the
    integral of u, with forgetting. While the contact is approached, u is NᵀV_rel and p is 0.

    Reads `speed` (NᵀV_rel), `V_N` (speed of the face along N, m/s) and `alpha_meas` (N), `goal`
    (α_s, N) and `shaped` (0 during an approach) of the column, and of the column in MEMORY `driven`
    (state of v̂, m/s), `deflection` (p), `has_desired`, `eased` (last α_s, N), `eased_rate` (N/s)
    and `alpha_mean` (low-passed α_meas, N).

    Args:
        t: Tick.
        a: index of the column among the kept ones, with `V_N` = 0 where the motion of the face is
            not measured.
        j: its index among all columns of the model.

    Returns:
        u (m/s), p (m), v̂ (m/s) and α̇_s (N/s).
    """
    work = t.work
    column = work.columns[j]
    last = t.memory.columns[j]
    s = _compliance(t, j)
    face = work.V_N[a]
    if column.shaped == 0:  # the contact is still approached
        return work.speed[a], 0.0, face, last.eased_rate
    yielding = _washout_rate(t) * s * (work.alpha_meas[a] - last.alpha_mean)
    driven = last.driven - yielding if face != 0.0 else 0.0
    rate = (column.goal - last.eased) / work.dt if last.has_desired else 0.0
    return work.speed[a] + face - driven - s * rate, last.deflection, driven, rate


@leaf
def _keep_deflections(t):
    """Advance the states of the brake on yielding faces, and the estimate of their compliance.

    High-passes with the rate w of `_washout_rate` give x̃ (m), α̃ and α̃_s (N) of position, force
    and commanded force; the compliance is the ratio of the forgetting integrals `correlation` ∫x̃
    α̃_s dt and `excitation` ∫α̃ α̃_s dt (`_compliance`), which are not changed during an approach.

    Reads `V_N`, `speed`, `alpha_meas`, and `goal` (commanded force α_s) and `shaped` of the
    columns. Changes of the columns in MEMORY `driven` (speed of the driven face, m/s), `deflection`
    (integral of the unexplained speed, m), `eased` (α_s, N), `eased_rate` (its rate, N/s),
    `yielded` (x̃, m), `alpha_mean`, `eased_mean` (N), `correlation` and `excitation`.

    Args:
        t: Tick.
    """
    work = t.work
    dt = work.dt
    w = _washout_rate(t)
    for a in range(work.rank):
        j = work.kept[a]
        if body_of(t, j).kind != YIELDING:
            continue
        u, p, _, rate = _deflection(t, a, j)
        column = work.columns[j]
        row = t.memory.columns[j]
        # states of the brake
        row.driven += w * dt * (work.V_N[a] - row.driven)
        row.deflection = p + dt * (u - w * p)
        row.eased = column.goal
        row.eased_rate += dt / (_RATE_LAG + dt) * (rate - row.eased_rate)
        if column.shaped == 0:
            continue
        # high-passes, then the forgetting integrals ∫x̃ α̃_s and ∫α̃ α̃_s
        row.yielded += dt * (work.speed[a] + work.V_N[a] - w * row.yielded)
        row.alpha_mean += w * dt * (work.alpha_meas[a] - row.alpha_mean)
        row.eased_mean += w * dt * (row.eased - row.eased_mean)
        change = dt * (row.eased - row.eased_mean)
        forgetting = 1.0 - dt / _COMPLIANCE_MEMORY
        alpha = work.alpha_meas[a] - row.alpha_mean
        row.correlation = forgetting * row.correlation + change * row.yielded
        row.excitation = forgetting * row.excitation + change * alpha


@leaf
def _keep_squeeze(t):
    """Store the steps of the internal forces in MEMORY for the next tick.

    Copies `squeeze_left`, `squeeze_time`, and `scale` and `to_come` of `internal` from WORK to the
    fields of the same names in MEMORY, and there `squeeze` (N) to `desired` of `internal`.

    Args:
        t: Tick.
    """
    memory = t.memory
    work = t.work
    memory.squeeze_left = work.squeeze_left
    memory.squeeze_time = work.squeeze_time
    for bar in range(t.model.n_bars):
        row = memory.internal[bar]
        bar_work = work.internal[bar]
        row.desired = memory.squeeze[bar]
        row.scale = bar_work.scale
        fill3(row.to_come, bar_work.to_come)


@inner
def keep_steps(t):
    """Update steps of forces, lasting speed and turn of the normal of each column in MEMORY.

    Columns that are not in N are reset; where active contacts are named by the user, the turn and
    its covariance are retained for the next contact with the same face. The lasting speed v̄
    (`drift`) is a low-pass of NᵀV_rel; of a contact that presses, of the part 1 − `slides` of it
    that is not attributed to an error of the normal. The rates of v̄ and of the turn of the normal
    are multiplied by `integral_scale` and 1 − `integral_cut`, as K_i is: in the large part of a
    step neither changes.

    Reads of the columns in WORK `here` (1 if in N), `goal` (N; of the column α_s, of the table
    α_d), `scale` (size of the force, N), `shaped`, `to_come` (part of the step that is still to
    come), `alpha` (measured force, N), `speeds` (NᵀV_rel, m/s), `slides` and `turned` (see
    `follow_face`), `integral_scale`, `integral_cut` of MEMORY, and `chosen_set` of INPUT. Changes
    of the columns in MEMORY `has_desired`, `desired` and `scale` (last desired force and its size,
    N), `predicted` (force to be expected, N), `drift` (v̄, m/s), `to_come`, `turn` (of the normal),
    the fields that `learn_normal`, `_keep_deflections` and `_keep_squeeze` change, `step_left`
    (share of the rise time) and `step_time` (s).

    Args:
        t: Tick whose torques have been computed.
    """
    work = t.work
    _keep_deflections(t)  # reads `has_desired`, which is overwritten below
    t.memory.step_left = work.step_left
    t.memory.step_time = work.step_time
    _keep_squeeze(t)
    scale = work.integral_scale * (1.0 - t.memory.integral_cut)
    for j in range(t.model.n_columns):
        row = t.memory.columns[j]
        column_work = work.columns[j]
        if work.here[j] == 0.0:  # not in N: the next contact begins without a past
            _forget_forces(row)
            if t.input.chosen_set == 0:  # else the next contact is with the same face
                _forget_normal(row)
            continue
        predict_force(t, row, column_work.goal, work.status == SATURATED, work.dt)
        row.has_desired = column_work.shaped
        row.desired = work.goal[j]
        row.scale = column_work.scale
        presses = column_work.shaped != 0 and work.alpha[j] > _PRESSING_SHARE * work.goal[j] > 0.0
        # an approach shows no tilt of the face, so its whole speed counts as lasting
        lasting = work.speeds[j] * (1.0 - column_work.slides if presses else 1.0)
        row.drift += scale * t.model.drift_share * (lasting - row.drift)
        normal_share = scale * t.model.drift_share if presses else 0.0
        learn_normal(normal_share, row, column_work)
        fill3(row.to_come, column_work.to_come)
        if presses:
            change = minus3(column_work.turned, row.turn)
            fill3(row.turn, add3(row.turn, scale, change))


@leaf
def _forget_forces(row):
    """Reset the states of force, lasting speed and compliance of a column that is not in N.

    They are the last desired force and its size, the predicted force (N), the remainder of its
    step, the lasting speed v̄ and that of an approach (m/s), and the states of the brake on a
    yielding face with the estimate of its compliance.

    Args:
        row: COLUMN_MEMORY, changed.
    """
    row.has_desired = 0
    row.desired = row.scale = row.predicted = 0.0
    row.drift = row.approach = row.driven = row.deflection = row.eased = row.eased_rate = 0.0
    row.yielded = row.alpha_mean = row.eased_mean = row.correlation = row.excitation = 0.0
    row.to_come[:] = 0.0


@leaf
def _forget_normal(row):
    """Reset the estimate of the normal of a column that is not in N.

    Args:
        row: COLUMN_MEMORY, of which `turn` (of the assumed normal), its `covariance` (rad²) and
            `normal_std` (rad), and the speed that it does not explain become zero.
    """
    row.unexplained = row.residual = row.normal_std = 0.0
    row.turn[:] = 0.0
    row.covariance[:] = 0.0
