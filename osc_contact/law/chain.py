"""The closed chain: where the object is, what all arms together make of it, what they lock."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import one_sided_jacobi
from osc_contact.law.arm_motion import move_arm, place_arm, place_frame
from osc_contact.law.contact import AHEAD
from osc_contact.law.grasps import add_slip, centre_object, filter_outboard, find_object, find_twist
from osc_contact.law.jit import inner, leaf
from osc_contact.law.joint_friction import believed_friction
from osc_contact.law.operational import arm_terms, effort_metric, find_lost, may_be_singular
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    GIVEN_POSE,
    GIVEN_TWIST,
)
from osc_contact.law.vectors import (
    ZERO,
    add,
    carry_motion,
    carry_wrench,
    dot6,
    energy_motion,
    energy_wrench,
    fill,
    plus,
    qr6,
    reflect,
    reflect_sides,
    set_axes,
    six,
    world_wrench,
)

OBJECT_UNKNOWN = declare_reason(
    "OBJECT_UNKNOWN",
    2,
    "the joints do not determine where the object is: its grasps let it move while every arm "
    "stands still. Grasp it so that this is blocked",
)
BAD_INERTIA = declare_reason(
    "BAD_INERTIA",
    3,
    "the joint-space inertia of an arm is not positive definite; check the masses and inertias "
    "of its links",
)
UNACTUATED = declare_reason(
    "UNACTUATED",
    4,
    "the motors cannot drive every motion of the object. Add a motor, or grasp so that the "
    "motion is blocked",
)


@inner
def solve_chain(t):
    """The closed chain at (q, v), as `dynamics.closed_chain.ClosedChain.state`; a reason."""
    model = t.model
    arms = model.arms
    memory = t.memory
    work = t.work
    arm_work = t.work.arms
    for k in range(model.n_arms):
        place_arm(t, arms[k].first, arms[k].end, t.input.q)
    if model.leader >= 0:
        tip = t.work.joints[arms[model.leader].tip_joint]
        place_frame(tip, model.X_LO, work.X_WO, work.O)
        for i in range(3):
            work.X_WO[i, 3] = work.O[i]
            work.X_WO[3, i] = 0.0
        work.X_WO[3, 3] = 1.0
        place_frame(tip, model.X_LP, work.R, work.C)
        set_axes(work.R, model.roots, work.axes)
    else:
        for i in range(4):
            for j in range(4):
                work.X_WO[i, j] = memory.X_WO[i, j]
        if memory.given >= GIVEN_POSE:
            centre_object(t, work.X_WO)
        elif not find_object(t, work.X_WO):
            return OBJECT_UNKNOWN
    for k in range(model.n_arms):
        arm = arms[k]
        own = arm_work[k]
        fill(own.bias, ZERO)
        move_arm(
            t,
            arm,
            t.input.v,
            work.C,
            own.V,
            own.drift,
            own.bias,
        )
    given = memory.given >= GIVEN_TWIST
    if model.slipping != 0:
        if not find_twist(t, given):
            return OBJECT_UNKNOWN
    else:
        fill(work.V_C, arm_work[0].V)
    if given:
        carry_motion(memory.V_O, work.O, work.C, work.V_C)
    carry_motion(work.V_C, work.C, work.O, work.V_O)
    for i in range(6):
        work.bias_links[i] = work.bias_e[i] = work.chain_bias[i] = 0.0
        fill(work.Lambda[i], ZERO)
        fill(work.effort[i], ZERO)
        fill(work.out_T[i], ZERO)
    count = 0
    work.n_lost = 0
    for k in range(model.n_arms):
        reason, found = _add_arm(t, arms[k], arm_work[k], count)
        if reason != NO_REASON:
            return reason
        count += found
    _add_object(t)
    work.locked = _intersect(t, count)
    if work.locked > 0:
        Z = work.reflectors
        beta = work.beta
        m = work.locked
        reflect_sides(Z, beta, m, work.Lambda)
        reflect_sides(Z, beta, m, work.effort)
        reflect(Z, beta, m, work.chain_bias)
        reflect(Z, beta, m, work.sigma)
    return NO_REASON


@inner
def _add_arm(t, arm, own, row):
    """One arm's share in everything that is summed over the arms; a reason and what it locks."""
    model = t.model
    work = t.work
    joints = t.work.joints
    locked = t.work.locked_rows
    lo = arm.first
    n = arm.end - arm.first
    m = arm.m
    rigid = arm.m == 6
    if not rigid:  # N is carried by the tip while the object slips
        add_slip(own.V, work.V_C, own.drift)
    for j in range(lo, arm.end):
        energy_motion(work.axes, joints[j].column, joints[j].J)
    energy_motion(work.axes, own.drift, own.gamma)
    own.wide = 1 if n > m else 0
    own.n_lost = 0
    count = arm_terms(t, lo, n, m, rigid, own, row)
    if count < 0:
        return BAD_INERTIA, 0
    if may_be_singular(t, arm, own):
        find_lost(t, arm, own)
    shared = model.n_arms > 1 or own.wide == 0 or own.n_lost > 0  # else there is nothing to share
    if model.n_motors > 0 and shared and not effort_metric(t, lo, n, m, own, own.effort):
        return UNACTUATED, 0
    for k in range(row, row + count):
        locked[k, 6] = dot6(locked[k], own.gamma)
        fill(own.resisted[k - row], locked[k])
    if model.rubs != 0:
        _add_friction(t, arm)
    for j in range(lo, arm.end):
        joints[j].offset = -dot6(joints[j].J_bar, own.gamma)
    bias = six(work.chain_bias)
    for j in range(lo, arm.end):
        bias = add(bias, joints[j].h, joints[j].J_bar)
    for i in range(6):
        bias = add(bias, -own.gamma[i], own.Lambda[i])
        fill(work.Lambda[i], add(six(work.Lambda[i]), 1.0, own.Lambda[i]))
        fill(work.effort[i], add(six(work.effort[i]), 1.0, own.effort[i]))
    fill(work.chain_bias, bias)
    if arm.sensor_joint >= 0 and arm.outer_joint >= 0:
        if arm.filtered != 0:
            filter_outboard(t, arm, own, own.bias)
        else:
            _add_outboard(t, arm, own)
    return NO_REASON, count


@inner
def _add_friction(t, arm):
    """h += D v + F s/√(s² + s_0²), with the desired speeds s = v + J̄ (V_D + t_a A_D − V).

    They turn round when the joints do, or a little before: torques act from this tick on. They are
    without the noise of v, of which only what does not move the object is in them. Where friction
    is learned, motors compensate it themselves, see `joint_friction`.
    """
    joints = t.work.joints
    work = t.work
    learned = t.model.friction_learning != 0
    lag = work.y
    ahead = AHEAD * t.model.period
    for i in range(6):
        lag[i] = work.V_D[i] + ahead * work.A_D[i] - work.V_O[i]
    carry_motion(lag, work.O, work.C, lag)
    energy_motion(work.axes, lag, lag)
    for j in range(arm.first, arm.end):
        row = t.model.joints[j]
        if not learned:
            v = joints[j].v
            s = v + dot6(joints[j].J_bar, lag)
            joints[j].h += row.viscous * v + row.dry * s / sqrt(s * s + row.slip * row.slip)
        elif row.motor < 0:
            joints[j].h += believed_friction(t, j)


@leaf
def _add_outboard(t, arm, own):
    """Λ_out += I J J̄ (transposed), bias −= I J J̄ γ of the bodies beyond the wrist sensor."""
    joints = t.work.joints
    work = t.work
    fill(work.bias_links, plus(work.bias_links, own.bias))
    for j in range(arm.first, arm.end):
        P = joints[j].outboard
        bar = joints[j].J_bar
        energy_wrench(work.axes, P, P)
        fill(work.bias_e, add(six(work.bias_e), -dot6(bar, own.gamma), P))
        for b in range(6):
            fill(work.out_T[b], add(six(work.out_T[b]), bar[b], P))


@inner
def _add_object(t):
    """μ_o + p_o of the object in its principal axes: √m (ω × v − g), (ω × Iω)/√I; and Λ_o = 1."""
    model = t.model
    work = t.work
    roots = model.roots
    squares = model.principal
    f = work.u
    energy_motion(work.axes, work.V_C, f)
    vx = f[0]
    vy = f[1]
    vz = f[2]  # √m v
    wx = f[3] / roots[1]
    wy = f[4] / roots[2]
    wz = f[5] / roots[3]
    x = f[0]
    y = f[1]
    z = f[2]
    f[0] = wy * vz - wz * vy
    f[1] = wz * vx - wx * vz
    f[2] = wx * vy - wy * vx
    x = squares[1] * wx
    y = squares[2] * wy
    z = squares[3] * wz
    f[3] = (wy * z - wz * y) / roots[1]
    f[4] = (wz * x - wx * z) / roots[2]
    f[5] = (wx * y - wy * x) / roots[3]
    for i in range(3):
        for j in range(3):
            f[i] -= work.axes[0, i, j] * model.gravity[j]
    held = 1.0 if model.held != 0 else 0.0
    links = work.w
    energy_wrench(work.axes, work.bias_links, links)
    for i in range(6):
        work.out_T[i, i] += held
        work.chain_bias[i] += held * f[i]
        work.bias_e[i] += held * f[i] + links[i]
    world_wrench(work.axes, work.bias_e, work.bias_out)
    carry_wrench(work.bias_out, work.C, work.O, work.bias_out)


@inner
def _intersect(t, count):
    """`reflectors` whose first m axes span what the arms lock together, σ along them; m.

    Args:
        count: number of rows.
    """
    locked = t.work.locked_rows
    work = t.work
    sigma = work.sigma
    V = work.reflectors
    fill(sigma, ZERO)
    if count == 0:
        return 0
    one_sided_jacobi(locked, count, 6, 1)
    m = 0
    for k in range(count):
        square = 0.0
        for i in range(6):
            square += locked[k, i] * locked[k, i]
        if sqrt(square) > t.model.angle_tolerance and m < 6:
            for i in range(6):
                sigma[i] += locked[k, i] * locked[k, 6] / square
                V[m, i] = locked[k, i]
            m += 1
    qr6(V, m, work.K, work.pivots, work.beta)
    return m
