"""The closed chain: where the object is, what all arms together make of it, what they lock."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import one_sided_jacobi
from osc_contact.law.arm_motion import move_arm, place_arm, place_frame
from osc_contact.law.arm_terms import arm_terms, effort_metric
from osc_contact.law.contact import AHEAD
from osc_contact.law.energy import (
    carry_motion,
    carry_wrench,
    energy_motion,
    energy_wrench,
    set_axes,
    world_wrench,
)
from osc_contact.law.grasps import add_slip, filter_outboard, find_twist
from osc_contact.law.held_object import centre_object, find_object
from osc_contact.law.jit import inner, leaf
from osc_contact.law.singular import find_lost, may_be_singular
from osc_contact.law.six import add, dot6, fill, qr6, reflect, reflect_sides, six
from osc_contact.law.tables import (
    BAD_INERTIA,
    GIVEN_POSE,
    GIVEN_TWIST,
    NO_REASON,
    OBJECT_UNKNOWN,
    UNACTUATED,
)

__all__ = ["solve_chain"]


@inner
def solve_chain(chain, arms, table, memory, work, arm_work, joints, locked, q, v):
    """The closed chain at (q, v), as `dynamics.closed_chain.ClosedChain.state`; returns a reason.

    Args:
        chain, arms, table: CHAIN record, ARM and JOINT rows. memory: MEMORY record.
        work, arm_work, joints: WORK record, ARM_WORK and JOINT_WORK rows, filled.
        locked: (…, 7) scratch. q, v: (n,) joint positions and velocities.
    """
    for k in range(chain.n_arms):
        place_arm(table, joints, arms[k].first, arms[k].end, q)
    if chain.leader >= 0:
        tip = joints[arms[chain.leader].tip_joint]
        place_frame(tip, chain.X_LO, work.X_WO, work.O)
        for i in range(3):
            work.X_WO[i, 3] = work.O[i]
            work.X_WO[3, i] = 0.0
        work.X_WO[3, 3] = 1.0
        place_frame(tip, chain.X_LP, work.R, work.C)
        set_axes(work.R, chain.roots, work.axes)
    else:
        for i in range(4):
            for j in range(4):
                work.X_WO[i, j] = memory.X_WO[i, j]
        if memory.given >= GIVEN_POSE:
            centre_object(work.X_WO, chain, work)
        elif not find_object(chain, arms, work, arm_work, joints, work.X_WO):
            return OBJECT_UNKNOWN
    for k in range(chain.n_arms):
        arm, own = arms[k], arm_work[k]
        for i in range(6):
            own.bias[i] = 0.0
        move_arm(
            arm, table, joints, v, work.C, chain.gravity, work.s, work.t, own.V, own.drift,
            own.bias,
        )  # fmt: skip
    given = memory.given >= GIVEN_TWIST
    if chain.slipping != 0:
        if not find_twist(chain, arms, work, arm_work, joints, given):
            return OBJECT_UNKNOWN
    else:
        for i in range(6):
            work.V_C[i] = arm_work[0].V[i]
    if given:
        carry_motion(memory.V_O, work.O, work.C, work.V_C)
    carry_motion(work.V_C, work.C, work.O, work.V_O)
    for i in range(6):
        work.bias_links[i] = work.bias_e[i] = work.chain_bias[i] = 0.0
        for j in range(6):
            work.Lambda[i, j] = work.effort[i, j] = 0.0
            work.out_T[i, j] = 0.0
    count = 0
    work.n_lost = 0
    for k in range(chain.n_arms):
        reason, found = _add_arm(chain, arms[k], table, work, arm_work[k], joints, locked, count)
        if reason != NO_REASON:
            return reason
        count += found
    _add_object(chain, work)
    work.locked = _intersect(locked, count, chain.tolerance, work)
    if work.locked > 0:
        Z, beta, m = work.reflectors, work.beta, work.locked
        reflect_sides(Z, beta, m, work.Lambda)
        reflect_sides(Z, beta, m, work.effort)
        reflect(Z, beta, m, work.chain_bias)
        reflect(Z, beta, m, work.sigma)
    return NO_REASON


@inner
def _add_arm(chain, arm, table, work, own, joints, locked, row):
    """One arm's share in everything that is summed over the arms; a reason and what it locks."""
    lo, n, m, rigid = arm.first, arm.end - arm.first, arm.m, arm.m == 6
    if not rigid:  # N is carried by the tip while the object slips
        add_slip(own.V, work.V_C, own.drift)
    for j in range(lo, arm.end):
        energy_motion(work.axes, joints[j].column, joints[j].J)
    energy_motion(work.axes, own.drift, own.gamma)
    own.wide = 1 if n > m else 0
    own.n_lost = 0
    count = arm_terms(lo, n, m, rigid, chain.tolerance, joints, own, work, locked, row)
    if count < 0:
        return BAD_INERTIA, 0
    if may_be_singular(chain, arm, own):
        find_lost(chain, arm, own, joints, work)
    shared = chain.n_arms > 1 or own.wide == 0 or own.n_lost > 0  # else there is nothing to share
    if (
        chain.n_motors > 0
        and shared
        and not effort_metric(lo, n, m, joints, table, own, work, own.effort)
    ):
        return UNACTUATED, 0
    for k in range(row, row + count):
        locked[k, 6] = dot6(locked[k], own.gamma)
        for i in range(6):
            own.resisted[k - row, i] = locked[k, i]
    if chain.rubs != 0:
        _add_friction(chain, arm, table, joints, work)
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
            filter_outboard(arm, own, joints, work, own.bias)
        else:
            _add_outboard(arm, own, joints, work)
    return NO_REASON, count


@inner
def _add_friction(chain, arm, table, joints, work):
    """h += D v + F s/√(s² + s_0²), with the wanted speeds s = v + J̄ (V_D + t_a A_D − V).

    They turn round when the joints do, or a little before: torques act from this tick on. They are
    without the noise of v, of which only what does not move the object is in them.
    """
    lag, ahead = work.y, AHEAD * chain.period
    for i in range(6):
        lag[i] = work.V_D[i] + ahead * work.A_D[i] - work.V_O[i]
    carry_motion(lag, work.O, work.C, lag)
    energy_motion(work.axes, lag, lag)
    for j in range(arm.first, arm.end):
        row, v = table[j], joints[j].v
        s = v + dot6(joints[j].J_bar, lag)
        joints[j].h += row.viscous * v + row.dry * s / sqrt(s * s + row.slip * row.slip)


@leaf
def _add_outboard(arm, own, joints, work):
    """Λ_out += I J J̄ (transposed), bias −= I J J̄ γ of the bodies beyond the wrist sensor."""
    for i in range(6):
        work.bias_links[i] += own.bias[i]
    for j in range(arm.first, arm.end):
        P, bar = joints[j].outboard, joints[j].J_bar
        energy_wrench(work.axes, P, P)
        fill(work.bias_e, add(six(work.bias_e), -dot6(bar, own.gamma), P))
        for b in range(6):
            fill(work.out_T[b], add(six(work.out_T[b]), bar[b], P))


@inner
def _add_object(chain, work):
    """μ_o + p_o of the object in its principal axes: √m (ω × v − g), (ω × Iω)/√I; and Λ_o = 1."""
    roots, squares, f = chain.roots, chain.principal, work.u
    energy_motion(work.axes, work.V_C, f)
    vx, vy, vz = f[0], f[1], f[2]  # √m v
    wx, wy, wz = f[3] / roots[1], f[4] / roots[2], f[5] / roots[3]
    x, y, z = f[0], f[1], f[2]
    f[0] = wy * vz - wz * vy
    f[1] = wz * vx - wx * vz
    f[2] = wx * vy - wy * vx
    x, y, z = squares[1] * wx, squares[2] * wy, squares[3] * wz
    f[3] = (wy * z - wz * y) / roots[1]
    f[4] = (wz * x - wx * z) / roots[2]
    f[5] = (wx * y - wy * x) / roots[3]
    for i in range(3):
        for j in range(3):
            f[i] -= work.axes[0, i, j] * chain.gravity[j]
    held = 1.0 if chain.held != 0 else 0.0
    links = work.w
    energy_wrench(work.axes, work.bias_links, links)
    for i in range(6):
        work.out_T[i, i] += held
        work.chain_bias[i] += held * f[i]
        work.bias_e[i] += held * f[i] + links[i]
    world_wrench(work.axes, work.bias_e, work.bias_out)
    carry_wrench(work.bias_out, work.C, work.O, work.bias_out)


@inner
def _intersect(locked, count, tolerance, work):
    """`reflectors` whose first m axes span what the arms lock together, σ along them; m.

    Args:
        locked: (…, 7) of all arms: a unit wrench and its rate uᵀγ. Destroyed.
        count: number of rows.
        tolerance: two directions this near to one another (rad) count as the same.
        work: reflectors, beta, sigma (before any reflection: Σ u c over singular ones) filled.
    """
    sigma, V = work.sigma, work.reflectors
    for i in range(6):
        sigma[i] = 0.0
    if count == 0:
        return 0
    one_sided_jacobi(locked, count, 6, 1)
    m = 0
    for k in range(count):
        square = 0.0
        for i in range(6):
            square += locked[k, i] * locked[k, i]
        if sqrt(square) > tolerance and m < 6:
            for i in range(6):
                sigma[i] += locked[k, i] * locked[k, 6] / square
                V[m, i] = locked[k, i]
            m += 1
    qr6(V, m, work.K, work.pivots, work.beta)
    return m
