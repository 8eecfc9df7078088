"""The motion law, and how steps of desired forces enter without a jump."""

from __future__ import annotations

from math import atan2, copysign, sqrt

from osc_contact.law.contact import learn_normal
from osc_contact.law.jit import inner, leaf, local
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
    fill,
    fill3,
    join,
    linear,
    minus,
    minus3,
    origin,
    plus3,
    rotated,
    row3,
    scaled3,
)

# --- The motion law: pose error, PID, and the classical acceleration made spatial -----------------


@inner
def rotation_vector(R):
    """log₃ R (rad) as a tuple, R in the first rows and columns of a matrix."""
    v = (0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1]))
    sine = sqrt(dot3(v, v))
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = atan2(sine, cosine)
    if cosine > -0.99:
        return scaled3(angle / sine if sine > 1e-6 else 1.0 + sine * sine / 6.0, v)
    # near a half turn the axis comes from the symmetric part, (1 − cos) aaᵀ + cos 1: its longest
    # column, whose sign is known best
    k = 0
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    axis = add3(scaled3(0.5, plus3(row3(R, k), column3(R, k))), -cosine, axis3(k))
    return scaled3(copysign(angle / sqrt(dot3(axis, axis)), v[k]), axis)


@inner
def pose_error(X_WD, X_WO):
    """Pose error [p_D − p_O; log₃(R_D R_Oᵀ)] (m, rad), six numbers.

    Args:
        X_WD, X_WO: (4, 4) desired and actual pose.
    """
    R = local(3, 3)
    for i in range(3):
        fill3(R[i], rotated(X_WO, X_WD[i]))
    return join(minus3(origin(X_WD), origin(X_WO)), rotation_vector(R))


@inner
def command_motion(t):
    """a_u (6,) at O: p̈_d + K_d ė + K_p e + K_i ∫e, less ω × v."""
    V_O = t.work.V_O
    a = add(t.input.A_D, t.model.damping, minus(t.input.V_D, V_O))
    a = add(a, t.model.stiffness, t.work.error)
    a = add(a, t.model.integral, t.work.motion_next)
    fill(t.work.a_u, join(minus3(a, cross(V_O[3:], V_O)), angular(a)))


# --- Steps of desired forces, and the brake on a contact that swings ------------------------------
#
# A force that is commanded at once would set a contact swinging, with its own stiffness and the
# mass behind it, and move the others along. What a step leaves to be done is therefore taken off
# the desired force at first, and let go within the rise time T along the quintic of least jerk:
#
#     α_s = α_d − w,   w(x) = (1 − x)³(a + bx + cx²),   x = t / T
#
# a, b and c continue from w's value, slope and curvature when the next step comes. Forces that
# change more slowly pass unchanged. A contact that is new to the law starts from the force that
# is measured there, in the first tick of all from none: nothing has been measured under control
# yet. While much of a step is still to come the integral rests, which would take it for an error.
#
# Internal forces are shaped in the same way, but timed independently: a grasp that is tightened
# leaves the contact forces as they are. In the first tick of all they are what is desired, as an
# object that friction at the grasps carries must not fall.
#
# The brake commands the normal acceleration −κ(NᵀV_rel − v̄) in place of none, v̄ the part that
# lasts: an object that slides along a tilted face is not braked. In accelerations the same κ
# serves every mass, and any basis of N; the force that it takes is (NᵀΦN)⁻¹ times as much.
#
# On a face that yields, by s per unit of force, that is too little where the contact moves slowly,
# and nothing where its motion is measured. There
#
#     b = κ(u + (K_i − w) p) − s α̈_s,   u = NᵀV − v̂ − s α̇_s,   ṗ = u − w p
#
# with v̂ how the face is driven, a low pass of V_N − s α̇ where its motion is measured, else 0; w is
# the rate of v̄ and of this low pass. s is learned, from s_0 as declared: with x̃, α̃ and α̃_s the
# position of the contact, its force and the commanded one, each without what is slower than w,
#
#     s = (∫x̃ α̃_s + w_0 s_0) / (∫α̃ α̃_s + w_0)
#
# where old products are forgotten. Noise and sliding on a tilted face are not correlated with α̃_s.

_SUDDEN = 20.0  #: 1/s; a force that changes faster than its size times this makes a step
_FADES = 0.5  #: 1/s; how fast the size of a force that has gone is forgotten
_PRESSES = 0.3  #: of its desired force; with less a contact does not show the tilt of its face
_RESTS = 0.1  #: of the size; where more of a step is to come the integral rests
_YIELDS = 0.01  #: s, of the low-pass of α̈_s
_RECALLS = 2.0  #: s, in which products of s are forgotten
_PRIOR = 0.002  #: s; w_0 is so long a time of a force of its size
_SOFTEST = 20.0  #: times s_0


@inner
def shape_steps(t, own):
    """Fill `goal` of the columns in force with α_s (N); `integral_scale`: how far it integrates.

    Args:
        own: whether the force law is the user's: its steps are not smoothed.
    """
    memory = t.memory
    work = t.work
    dt = work.dt
    T = memory.step_time
    time = 0.0 if own else t.model.step_time
    left = 0.0 if own else memory.step_left
    if left > 0.0:
        left = max(left - dt / T, 0.0)
    smooth = left > 0.0 or time > 0.0
    sudden = False
    for i in range(work.count):
        j = work.chosen[i]
        row = work.columns[j]
        last = memory.columns[j]
        goal = work.goal[j]
        row.goal = goal
        row.scale = max(abs(goal), last.scale * (1.0 - _FADES * dt)) if smooth else 0.0
        approached = smooth and contact_of(t, j).phase == APPROACHING
        row.shaped = 0 if own or approached else 1
        before = work.alpha[j] if memory.ticked else 0.0
        if last.has_desired:
            before = last.desired
        elif t.model.phased and goal > 0.0:
            before = min(before, goal)  # an impact is not held
            if body_of(t, j).pushes:
                before = max(before, 0.0)  # no face pulls
        row.to_come[0] = goal - before  # the step, for now
        sudden = sudden or (row.shaped and abs(row.to_come[0]) > _SUDDEN * dt * row.scale)
    sudden = sudden and time > 0.0
    largest = 0.0
    for i in range(work.count):
        j = work.chosen[i]
        row = work.columns[j]
        step = row.to_come[0] if row.shaped else 0.0
        to_come = (0.0, 0.0, 0.0)
        if smooth and row.shaped and memory.columns[j].has_desired:
            to_come = linear(memory.columns[j].to_come)
        if sudden:
            to_come = _add_step(to_come, step, left, time / T if left > 0.0 else 1.0)
        fill3(row.to_come, to_come)
        w = _still_to_come(to_come, 1.0 if sudden else left)
        row.goal -= w
        if row.scale > 0.0:
            largest = max(largest, abs(w) / row.scale)
    work.step_left = 1.0 if sudden else left
    work.step_time = time if sudden else T
    work.integral_scale = max(1.0 - largest / _RESTS, 0.0)


@inner
def shape_squeeze(t):
    """Fill `goal` of the internal forces (N) from `squeeze`, whose steps are shaped.

    Forces that three arms and more leave at least effort count as none: a step from there begins
    with none, one to there ends with none before they are left at least effort.
    """
    memory = t.memory
    work = t.work
    dt = work.dt
    T = memory.squeeze_time
    time = t.model.step_time
    left = memory.squeeze_left
    if left > 0.0:
        left = max(left - dt / T, 0.0)
    sudden = False
    for c in range(t.model.n_bars):
        own = work.internal[c]
        last = memory.internal[c]
        desired = memory.squeeze[c]
        before = last.desired
        if memory.ticked == 0:
            before = desired
        own.goal = desired - before  # the step, for now
        own.scale = max(abs(desired), last.scale * (1.0 - _FADES * dt))
        sudden = sudden or abs(own.goal) > _SUDDEN * dt * own.scale
    sudden = sudden and time > 0.0
    for c in range(t.model.n_bars):
        own = work.internal[c]
        to_come = (0.0, 0.0, 0.0)
        if left > 0.0:
            to_come = linear(memory.internal[c].to_come)
        if sudden:
            to_come = _add_step(to_come, own.goal, left, time / T if left > 0.0 else 1.0)
        fill3(own.to_come, to_come)
        own.goal = memory.squeeze[c] - _still_to_come(to_come, 1.0 if sudden else left)
    work.squeeze_left = 1.0 if sudden else left
    work.squeeze_time = time if sudden else T
    if work.squeeze_left > 0.0:
        work.commanded = 1


@leaf
def _still_to_come(to_come, left):
    """w of a step (N), a share `left` of whose time is left."""
    a, b, c = to_come
    x = 1.0 - left
    return left * left * left * (a + x * (b + x * c))


@inner
def _add_step(to_come, step, left, stretch):
    """a, b, c of what is to come of a former step and a new one (N), from x = 0 on.

    Args:
        to_come: of the former step. step: the new one (N). left: share of the former one's time.
        stretch: times as long as the former one takes.
    """
    return add3(_continue(to_come, left, stretch), step, (1.0, 3.0, 6.0))


@inner
def _continue(to_come, left, stretch):
    """a, b, c of the quintic that continues at x = 1 − left, and takes `stretch` times as long."""
    a, b, c = to_come
    x = 1.0 - left
    P = a + x * (b + x * c)
    slope = b + 2.0 * x * c
    bend = 2.0 * c
    w = left * left * left * P
    w_1 = stretch * (left * left) * (left * slope - 3.0 * P)
    w_2 = (stretch * stretch) * left * (6.0 * P - 6.0 * left * slope + left * left * bend)
    return w, w_1 + 3.0 * w, 0.5 * w_2 + 3.0 * w_1 + 6.0 * w


@inner
def brake_contacts(t):
    """`brake` (r,) ← κ(NᵀV_rel − v̄), in m/s² for columns that are forces; of yielding faces b."""
    work = t.work
    for a in range(work.rank):
        j = work.kept[a]
        if body_of(t, j).kind != YIELDING:
            work.brake[a] *= work.speed[a] - t.memory.columns[j].drift
            continue
        u, p, _, rate = _deflection(t, a, j)
        work.brake[a] *= u + (t.model.force_gain - _washout(t)) * p
        acceleration = (rate - t.memory.columns[j].eased_rate) / _YIELDS
        work.brake[a] -= _compliance(t, j) * acceleration
        column = work.columns[j]
        if work.V_N[a] == 0.0:  # its yield would seem to be a tilt
            column.slides = 0.0
            fill3(column.turned, column.turn)


@leaf
def _washout(t):
    """w (1/s)."""
    return t.model.drift_share / t.model.period


@leaf
def _compliance(t, j):
    """s (m/N) of the face of column j, as learned so far."""
    row = t.memory.columns[j]
    s = body_of(t, j).parameters[0]
    weight = _PRIOR * row.scale * row.scale
    if weight == 0.0:
        return s
    learned = (row.correlation + weight * s) / (max(row.excitation, 0.0) + weight)
    return min(max(learned, 0.0), _SOFTEST * s)


@leaf
def _deflection(t, a, j):
    """u (m/s), p (m), v̂ (m/s) and α̇_s of column j, kept as a; NᵀV_e = 0 is not measured."""
    work = t.work
    column = work.columns[j]
    last = t.memory.columns[j]
    s = _compliance(t, j)
    face = work.V_N[a]
    if column.shaped == 0:  # not in contact yet
        return work.speed[a], 0.0, face, last.eased_rate
    yielding = _washout(t) * s * (work.alpha_meas[a] - last.alpha_mean)
    driven = last.driven - yielding if face != 0.0 else 0.0
    rate = (column.goal - last.eased) / work.dt if last.has_desired else 0.0
    return work.speed[a] + face - driven - s * rate, last.deflection, driven, rate


@leaf
def _keep_deflections(t):
    """What v̂, p, α̇_s and s of yielding faces are made of, for the next tick."""
    work = t.work
    dt = work.dt
    w = _washout(t)
    for a in range(work.rank):
        j = work.kept[a]
        if body_of(t, j).kind != YIELDING:
            continue
        u, p, _, rate = _deflection(t, a, j)
        column = work.columns[j]
        row = t.memory.columns[j]
        row.driven += w * dt * (work.V_N[a] - row.driven)
        row.deflection = p + dt * (u - w * p)
        row.eased = column.goal
        row.eased_rate += dt / (_YIELDS + dt) * (rate - row.eased_rate)
        if column.shaped == 0:
            continue
        row.yielded += dt * (work.speed[a] + work.V_N[a] - w * row.yielded)
        row.alpha_mean += w * dt * (work.alpha_meas[a] - row.alpha_mean)
        row.eased_mean += w * dt * (row.eased - row.eased_mean)
        change = dt * (row.eased - row.eased_mean)
        kept = 1.0 - dt / _RECALLS
        row.correlation = kept * row.correlation + change * row.yielded
        row.excitation = kept * row.excitation + change * (work.alpha_meas[a] - row.alpha_mean)


@leaf
def _keep_squeeze(t):
    """Keep the steps of the internal forces for the next tick."""
    memory = t.memory
    work = t.work
    memory.squeeze_left = work.squeeze_left
    memory.squeeze_time = work.squeeze_time
    for c in range(t.model.n_bars):
        row = memory.internal[c]
        own = work.internal[c]
        row.desired = memory.squeeze[c]
        row.scale = own.scale
        fill3(row.to_come, own.to_come)


@inner
def keep_steps(t):
    """What the next tick must know of the desired forces, v̄ and the turn of each column."""
    work = t.work
    _keep_deflections(t)  # before what they begin from is overwritten
    t.memory.step_left = work.step_left
    t.memory.step_time = work.step_time
    _keep_squeeze(t)
    for j in range(t.model.n_columns):
        row = t.memory.columns[j]
        own = work.columns[j]
        if work.here[j] == 0.0:
            row.has_desired = 0
            row.desired = row.scale = row.predicted = 0.0
            row.drift = row.driven = row.deflection = row.eased = row.eased_rate = 0.0
            row.yielded = row.alpha_mean = row.eased_mean = row.correlation = row.excitation = 0.0
            row.to_come[:] = 0.0
            if t.input.chosen_set:  # a face that is known is met again
                continue
            row.unexplained = row.residual = row.normal_std = 0.0
            row.turn[:] = 0.0
            row.covariance[:] = 0.0
            continue
        predict_force(t, row, own.goal, work.status == SATURATED, work.dt)
        row.has_desired = own.shaped
        row.desired = work.goal[j]
        row.scale = own.scale
        presses = own.shaped != 0 and work.alpha[j] > _PRESSES * work.goal[j] > 0.0
        lasting = work.speeds[j] * (1.0 - own.slides if presses else 1.0)
        row.drift += work.integral_scale * t.model.drift_share * (lasting - row.drift)
        learn_normal(work.integral_scale * t.model.drift_share if presses else 0.0, row, own)
        fill3(row.to_come, own.to_come)
        if presses:
            fill3(row.turn, add3(row.turn, work.integral_scale, minus3(own.turned, row.turn)))
