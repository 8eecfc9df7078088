"""The motion law, and how steps of desired forces enter without a jump."""

from __future__ import annotations

from math import atan2, copysign, sqrt

from osc_contact.law.contact import learn_normal
from osc_contact.law.jit import inner, leaf
from osc_contact.law.phases import APPROACHING, predict_force
from osc_contact.law.records import SATURATED, YIELDING
from osc_contact.law.vectors import cross

# --- The motion law: pose error, PID, and the classical acceleration made spatial -----------------


@inner
def rotation_vector(R, out):
    """out (3,) = log₃ R (rad), R in the first rows and columns of a matrix."""
    _rotation_vector(
        (R[0, 0], R[0, 1], R[0, 2]),
        (R[1, 0], R[1, 1], R[1, 2]),
        (R[2, 0], R[2, 1], R[2, 2]),
        out,
        0,
    )


@inner
def _rotation_vector(p, q, r, out, first):
    """out[first:] = log₃ of a rotation by its rows p, q, r."""
    x = 0.5 * (r[1] - q[2])
    y = 0.5 * (p[2] - r[0])
    z = 0.5 * (q[0] - p[1])
    sine = sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (p[0] + q[1] + r[2] - 1.0)
    angle = atan2(sine, cosine)
    if cosine > -0.99:
        scale = angle / sine if sine > 1e-6 else 1.0 + sine * sine / 6.0
        out[first] = scale * x
        out[first + 1] = scale * y
        out[first + 2] = scale * z
        return
    # near a half turn the axis comes from the symmetric part, (1 − cos) aaᵀ + cos 1: its longest
    # column, whose sign is known best
    u = p[0] - cosine
    v = q[1] - cosine
    w = r[2] - cosine
    a = 0.5 * (p[1] + q[0])
    b = 0.5 * (p[2] + r[0])
    c = 0.5 * (q[2] + r[1])
    if u >= v and u >= w:
        v = a
        w = b
        side = x
    elif v >= w:
        u = a
        w = c
        side = y
    else:
        u = b
        v = c
        side = z
    scale = copysign(angle / sqrt(u * u + v * v + w * w), side)
    out[first] = scale * u
    out[first + 1] = scale * v
    out[first + 2] = scale * w


@leaf
def _turned(D, B, i):
    """Row i of D Bᵀ."""
    return (
        D[i, 0] * B[0, 0] + D[i, 1] * B[0, 1] + D[i, 2] * B[0, 2],
        D[i, 0] * B[1, 0] + D[i, 1] * B[1, 1] + D[i, 2] * B[1, 2],
        D[i, 0] * B[2, 0] + D[i, 1] * B[2, 1] + D[i, 2] * B[2, 2],
    )


@inner
def pose_error(X_WD, X_WO, out):
    """[p_D − p_O; log₃(R_D R_Oᵀ)] of two (4, 4) poses.

    Args:
        X_WD, X_WO: (4, 4) desired and actual pose. out: (6,) for the error (m, rad).
    """
    for i in range(3):
        out[i] = X_WD[i, 3] - X_WO[i, 3]
    D = X_WD
    B = X_WO
    _rotation_vector(_turned(D, B, 0), _turned(D, B, 1), _turned(D, B, 2), out, 3)


@inner
def command_motion(t):
    """a_u (6,) at O: p̈_d + K_d ė + K_p e + K_i ∫e, less ω × v."""
    V_O = t.work.V_O
    a_u = t.work.a_u
    for i in range(6):
        a_u[i] = (
            t.input.A_D[i]
            + t.model.damping * (t.input.V_D[i] - V_O[i])
            + t.model.stiffness * t.work.error[i]
            + t.model.integral * t.work.motion_next[i]
        )
    x, y, z = cross(V_O[3], V_O[4], V_O[5], V_O[0], V_O[1], V_O[2])
    a_u[0] -= x
    a_u[1] -= y
    a_u[2] -= z


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
# The brake commands the normal acceleration −κ(NᵀV_rel − v̄) in place of none, v̄ the part that
# lasts: an object that slides along a tilted face is not braked. In accelerations the same κ
# serves every mass, and any basis of N; the force that it takes is (NᵀΦN)⁻¹ times as much.
#
# On a face that yields, by s per unit of force, that is too little where the contact moves slowly,
# and nothing where its motion is measured. There
#
#     b = κ(u + (K_i − w) p),   u = NᵀV − v̂ − s α̇_s,   ṗ = u − w p
#
# with v̂ how the face is driven, a low pass of V_N − s α̇ where its motion is measured, else 0; w is
# the rate of v̄ and of this low pass.

_SUDDEN = 20.0  #: 1/s; a force that changes faster than its size times this makes a step
_FADES = 0.5  #: 1/s; how fast the size of a force that has gone is forgotten
_PRESSES = 0.3  #: of its desired force; with less a contact does not show the tilt of its face
_RESTS = 0.1  #: of the size; where more of a step is to come the integral rests


@inner
def shape_steps(t):
    """Fill `goal` of the columns in force with α_s (N); `integral_scale`: how far it integrates."""
    memory = t.memory
    column_memory = t.memory.columns
    columns = t.work.columns
    work = t.work
    goal = t.work.goal
    dt = work.dt
    largest = 0.0
    sudden = False
    left = memory.step_left
    T = memory.step_time
    time = t.model.step_time
    if left > 0.0:
        left = max(left - dt / T, 0.0)
    work.integral_scale = 1.0
    if left == 0.0 and time == 0.0:
        work.step_left = 0.0
        for i in range(work.count):
            row = columns[columns[i].chosen]
            row.goal = goal[columns[i].chosen]
            row.scale = 0.0
            row.shaped = 1
            row.to_come[0] = row.to_come[1] = row.to_come[2] = 0.0
        return
    x = 1.0 - left
    for i in range(work.count):
        j = columns[i].chosen
        row = columns[j]
        last = column_memory[j]
        row.shaped = 0 if t.memory.contacts[t.model.columns[j].contact].phase == APPROACHING else 1
        row.goal = goal[j]
        row.scale = max(abs(goal[j]), last.scale * (1.0 - _FADES * dt))
        before = (
            last.desired
            if last.has_desired != 0
            else t.work.alpha[j]
            if memory.ticked != 0
            else 0.0
        )
        if last.has_desired == 0 and t.model.phased != 0 and goal[j] > 0.0:
            before = min(before, goal[j])  # an impact is not held
            if t.model.bodies[t.model.columns[j].contact].pushes != 0:
                before = max(before, 0.0)  # no face pulls
        row.to_come[0] = goal[j] - before  # the step, for now
        sudden = sudden or (row.shaped and abs(row.to_come[0]) > _SUDDEN * dt * row.scale)
    sudden = sudden and time > 0.0
    for i in range(work.count):
        j = columns[i].chosen
        row = columns[j]
        last = column_memory[j]
        step = row.to_come[0]
        known = last.has_desired != 0
        a, b, c = (last.to_come[0], last.to_come[1], last.to_come[2]) if known else (0.0, 0.0, 0.0)
        if row.shaped == 0:
            a = b = c = step = 0.0
        if sudden:
            a, b, c = _go_on(a, b, c, left, time / T if left > 0.0 else 1.0)
            a += step
            b += 3.0 * step
            c += 6.0 * step
        row.to_come[0] = a
        row.to_come[1] = b
        row.to_come[2] = c
        w = a if sudden else left * left * left * (a + x * (b + x * c))
        row.goal -= w
        if row.scale > 0.0:
            largest = max(largest, abs(w) / row.scale)
    work.step_left, work.step_time = (1.0, time) if sudden else (left, T)
    work.integral_scale = max(1.0 - largest / _RESTS, 0.0)


@inner
def _go_on(a, b, c, left, stretch):
    """a, b, c of the quintic that continues at x = 1 − left, and takes `stretch` times as long."""
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
        j = t.work.columns[int(work.keep[a])].chosen
        if not _yields(t, j):
            work.brake[a] *= work.speed[a] - t.memory.columns[j].drift
            continue
        u, p, _ = _deflection(t, a, j)
        work.brake[a] *= u + (t.model.force_gain - _washout(t)) * p
        column = t.work.columns[j]
        if work.V_N[a] == 0.0:  # its yield would seem to be a tilt
            column.slides = 0.0
            for i in range(3):
                column.turned[i] = column.turn[i]


@leaf
def _yields(t, j):
    """Whether column j is of a body that yields by an unknown support."""
    return t.model.bodies[t.model.columns[j].contact].kind == YIELDING


@leaf
def _washout(t):
    """w (1/s)."""
    return t.model.drift_share / t.model.period


@leaf
def _deflection(t, a, j):
    """u (m/s), p (m) and v̂ (m/s) of column j, kept as a; NᵀV_e = 0 is a motion not measured."""
    work = t.work
    column = t.work.columns[j]
    last = t.memory.columns[j]
    s = t.model.bodies[t.model.columns[j].contact].parameters[0]
    face = work.V_N[a]
    if column.shaped == 0:  # not in contact yet
        return work.speed[a], 0.0, face
    driven = last.driven - _washout(t) * s * work.alpha_meas[a] if face != 0.0 else 0.0
    commanded = s * (column.goal - last.eased) / work.dt if last.has_desired != 0 else 0.0
    return work.speed[a] + face - driven - commanded, last.deflection, driven


@leaf
def _keep_deflections(t):
    """v̂ + w s α, p and α_s of yielding faces for the next tick."""
    work = t.work
    w = _washout(t)
    for a in range(work.rank):
        j = t.work.columns[int(work.keep[a])].chosen
        if not _yields(t, j):
            continue
        u, p, driven = _deflection(t, a, j)
        s = t.model.bodies[t.model.columns[j].contact].parameters[0]
        row = t.memory.columns[j]
        row.driven = driven + w * (s * work.alpha_meas[a] + work.dt * (work.V_N[a] - driven))
        row.deflection = p + work.dt * (u - w * p)
        row.eased = t.work.columns[j].goal


@inner
def keep_steps(t):
    """What the next tick must know of the desired forces, v̄ and the turn of each column."""
    columns = t.work.columns
    work = t.work
    goal = t.work.goal
    _keep_deflections(t)  # before what they begin from is overwritten
    t.memory.step_left = work.step_left
    t.memory.step_time = work.step_time
    for j in range(t.model.n_columns):
        row = t.memory.columns[j]
        if t.work.here[j] == 0.0:
            row.has_desired = 0
            row.desired = 0.0
            row.scale = 0.0
            row.drift = row.driven = row.deflection = row.eased = 0.0
            row.to_come[0] = row.to_come[1] = row.to_come[2] = row.predicted = 0.0
            row.turn[0] = row.turn[1] = row.turn[2] = row.unexplained = 0.0
            row.residual = row.normal_std = 0.0
            for i in range(9):
                row.covariance[i] = 0.0
            continue
        predict_force(t, row, columns[j].goal, work.status == SATURATED, work.dt)
        row.has_desired = columns[j].shaped
        row.desired = goal[j]
        row.scale = columns[j].scale
        presses = columns[j].shaped != 0 and t.work.alpha[j] > _PRESSES * goal[j] > 0.0
        lasting = t.work.speeds[j] * (1.0 - columns[j].slides if presses else 1.0)
        row.drift += work.integral_scale * t.model.drift_share * (lasting - row.drift)
        share = work.integral_scale * t.model.drift_share if presses else 0.0
        learn_normal(share, row, columns[j])
        for i in range(3):
            row.to_come[i] = columns[j].to_come[i]
            if presses:
                row.turn[i] += work.integral_scale * (columns[j].turned[i] - row.turn[i])
