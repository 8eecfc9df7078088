"""Closed chain: pose and twist of the object; inertia, bias and locked wrenches of the chain."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve, dot, one_sided_jacobi, qr_rows
from osc_contact.law.arm_motion import move_arm, place_arm, place_frame, place_pose
from osc_contact.law.grasps import add_slip, centre_object, filter_outboard, find_object, find_twist
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.joint_friction import SLIDES, believed_friction
from osc_contact.law.operational import arm_terms, effort_metric
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    GIVEN_POSE,
    GIVEN_TWIST,
)
from osc_contact.law.singular import find_lost, may_be_singular
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    add_square,
    carry_motion,
    copy_rows,
    cross,
    dot6,
    energy_motion,
    energy_wrench,
    fill,
    fill3,
    join,
    minus,
    minus3,
    origin,
    plus,
    reflect_sides,
    rotated,
    set_axes,
    six,
    times6,
    turned,
    world_motion,
    wrench_to_world,
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


_GEOMETRY = 0.1  #: error of a twist by the arms' geometry, relative to that by joint speeds


@inner
def solve_chain(t):
    """Solve kinematics and dynamics of the closed chain of object and arms; return a reason.

    Reads q and v of INPUT, and in MEMORY `given` and, if no arm holds the object rigidly, its last
    pose `X_WO`, or twist `V_O` if that is an input. Fills of the object `X_WO`, `p_O`, `p_C`,
    `axes`, `V_C`, `V_O`; of object and arms, in energy coordinates that are turned if `locked` > 0,
    `Lambda`, `effort`, `chain_bias`, `sigma`, `reflectors`, `beta`, `locked`; of all bodies beyond
    the wrist sensors `out_T`, `bias_links`, `bias_e`, `bias_out`; `n_lost` (lost directions of all
    arms); `locked_rows`; and ARM_WORK and JOINT_WORK of all arms.

    Args:
        t: Tick.
    """
    model = t.model
    memory = t.memory
    work = t.work
    # positions, then velocities with Jacobians and bias forces
    for k in range(model.n_arms):
        place_arm(t, model.arms[k], t.input.q)
    if not _place_object(t):
        return OBJECT_UNKNOWN
    for k in range(model.n_arms):
        arm_work = work.arms[k]
        fill(arm_work.bias, ZERO)
        move_arm(t, model.arms[k], t.input.v, work.p_C, arm_work.V, arm_work.drift, arm_work.bias)
    twist_is_input = memory.given >= GIVEN_TWIST
    if not _move_object(t, twist_is_input):
        return OBJECT_UNKNOWN
    fill(work.bias_links, ZERO)
    fill(work.bias_e, ZERO)
    fill(work.chain_bias, ZERO)
    work.Lambda[:] = 0.0
    work.effort[:] = 0.0
    work.out_T[:] = 0.0
    # sums of inertia, effort and bias over the arms, then the object's
    count = 0  # locked wrenches of the arms so far
    work.n_lost = 0
    for k in range(model.n_arms):
        reason, n_rows = _add_arm(t, model.arms[k], work.arms[k], count)
        if reason != NO_REASON:
            return reason
        count += n_rows
    if model.n_arms > 1 and model.slipping == 0 and not twist_is_input:
        _combine_twists(t)
    _add_object(t)
    _intersect(t, count)
    # turned coordinates: locked axes first, free ones last
    if work.locked > 0:
        reflect_sides(work, work.Lambda)
        reflect_sides(work, work.effort)
        fill(work.chain_bias, turned(work, work.chain_bias))
        fill(work.sigma, turned(work, work.sigma))
    return NO_REASON


@inner
def _place_object(t):
    """Compute the pose of the object, its points O and C, and the axes of energy coordinates.

    With a leader (an arm that holds the object rigidly) the pose follows from the leader's last
    joint. Otherwise it is an input, or it is searched from the pose of the last tick. Reads R and p
    of the joints, and `X_WO` and `given` of MEMORY; fills `X_WO`, `p_O`, `p_C` and `axes`.

    Args:
        t: Tick after `place_arm` of all arms.

    Returns:
        False if the grasps do not determine the pose.
    """
    model = t.model
    work = t.work
    if model.leader >= 0:
        tip = work.joints[model.arms[model.leader].tip_joint]
        place_pose(tip, model.X_LO, work.X_WO)
        fill3(work.p_O, origin(work.X_WO))
        R = local(3, 3)
        place_frame(tip, model.X_LP, R, work.p_C)
        set_axes(R, model.roots, work.axes)
        return True
    copy_rows(t.memory.X_WO, work.X_WO)
    if t.memory.given >= GIVEN_POSE:
        centre_object(t, work.X_WO)
        return True
    return find_object(t, work.X_WO)


@inner
def _move_object(t, is_input):
    """Compute the twist of the object, `V_C` at C and `V_O` at O (m/s, rad/s, world axes).

    If no grasp permits motions it is that of the first arm's tip, else it follows from the velocity
    conditions of all grasps (`find_twist`). Reads V of the arms, `p_C` and `p_O`, and `V_O` of
    MEMORY if the twist is an input.

    Args:
        t: Tick after `move_arm` of all arms.
        is_input: whether the twist is an input of the tick.

    Returns:
        False if the grasps do not determine the twist.
    """
    work = t.work
    if t.model.slipping:
        if not find_twist(t, is_input):
            return False
    else:
        fill(work.V_C, work.arms[0].V)
    if is_input:
        fill(work.V_C, carry_motion(t.memory.V_O, work.p_O, work.p_C))
    fill(work.V_O, carry_motion(work.V_C, work.p_C, work.p_O))
    return True


@inner
def _combine_twists(t):
    """Combine the twists of the object by the joint speeds of all arms; rigid grasps only.

    The twist V_i = J_i q̇_i + ε of arm i has the covariance G_i = J_i S J_iᵀ + ρ_i 1
    (`_add_covariance`), with the variances S of the joint speeds and the error ε of the twist by
    that of the Jacobian J_i (6, n_i); without ε, no twist would satisfy two arms with different
    locked directions. With P (6, 6) the
    covariance of the estimate V from the former arms,

        K = P (P + G_i)⁻¹,   V ← V + K (V_i − V),   P ← P − K P

    All are in energy coordinates. Reads `axes`, `p_C`, `p_O`, V of the arms and J of the joints.
    Updates `V_C` and `V_O`.

    Args:
        t: Tick.
    """
    work = t.work
    P = local(6, 6)
    S = local(6, 6)  # P + G_i of the arm, then its Cholesky factor
    before = local(6, 6)  # P before the arm
    K = local(6, 6)
    P[:] = 0.0
    _add_covariance(t, 0, P)
    V = energy_motion(work.axes, work.V_C)
    for k in range(1, t.model.n_arms):
        copy_rows(P, S)
        _add_covariance(t, k, S)
        if not cholesky(S, 0, 6, S) > 0.0:
            return
        copy_rows(P, before)
        for i in range(6):
            fill(K[i], P[i])
            cholesky_solve(S, 6, K[i])
        V = plus(V, times6(K, minus(energy_motion(work.axes, work.arms[k].V), V)))
        for i in range(6):
            for j in range(6):
                accumulate(P[i], -K[i, j], before[j])
    fill(work.V_C, world_motion(work.axes, V))
    fill(work.V_O, carry_motion(work.V_C, work.p_C, work.p_O))


@leaf
def _add_covariance(t, k, G):
    """Add the covariance C + ρ I of the object's twist by the speeds of arm k to a matrix.

    C = J_k S J_kᵀ (6, 6), where J_k (6, n) is the Jacobian in energy coordinates and S (n, n) the
    diagonal matrix of the variances of joint speeds: 1 (rad/s)² for revolute joints, `SLIDES`²
    (m/s)² for prismatic ones. ρ = `_GEOMETRY`² tr C, in all six directions, stands for errors of
    the geometry, whose directions are not known; `_GEOMETRY` is their relative size. I is the
    identity.

    Args:
        t: Tick.
        k: index of the arm.
        G: (6, 6) in energy coordinates, changed.
    """
    rho = 0.0
    for j in range(t.model.arms[k].first, t.model.arms[k].end):
        J = t.work.joints[j].J
        variance = SLIDES * SLIDES if t.model.joints[j].slides else 1.0
        rho += _GEOMETRY * _GEOMETRY * variance * dot6(J, J)
        add_square(variance, J, G)
    for i in range(6):
        G[i, i] += rho


@inner
def _add_arm(t, arm, arm_work, row):
    """Compute the terms of one arm and add them to the sums over all arms.

    The arm adds its inertia Λ (6, 6) at the tip, the inverse metric of its effort (6, 6), and the
    wrench J̄ᵀh − Λγ (6,) of velocity and weight: J̄ (n, 6) is the inertia-weighted inverse of its
    Jacobian J (6, n), h (n,) the torque of velocities and gravity, γ (6,) the acceleration of its
    tip at q̈ = 0. All are in energy coordinates.

    Reads `axes` and `V_C`. Fills of ARM_WORK `gamma` (γ; `drift` is γ in world axes), `resisted`
    (its locked wrenches), `wide` (1 with redundant joints), `n_lost` (0 unless `find_lost` is
    called), and the fields of the functions called here; J, J̄, `offset` −J̄γ and `h` of its
    joints; `locked_rows` (each a locked wrench, then the acceleration γ along it). Adds to
    `Lambda`, `effort`, `chain_bias`, and for the bodies beyond its wrist sensor to `out_T`,
    `bias_e` and `bias_links`.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
        row: first free row of `locked_rows`.

    Returns:
        `NO_REASON`, `BAD_INERTIA` or `UNACTUATED`; and the number of wrenches that the arm locks.
    """
    model = t.model
    work = t.work
    joints = work.joints
    lo = arm.first
    n = arm.end - lo
    m = arm.m
    if m < 6:  # N is carried by the tip while the object slips
        add_slip(arm_work.V, work.V_C, arm_work.drift)
    for j in range(lo, arm.end):
        fill(joints[j].J, energy_motion(work.axes, joints[j].column))
    fill(arm_work.gamma, energy_motion(work.axes, arm_work.drift))
    arm_work.wide = n > m
    arm_work.n_lost = 0
    count = arm_terms(t, lo, n, m, arm_work, row)
    if count < 0:
        return BAD_INERTIA, 0
    if may_be_singular(t, arm, arm_work):
        find_lost(t, arm, arm_work)
    # a single redundant arm in a regular posture has unique torques, which need no metric
    shared = model.n_arms > 1 or arm_work.wide == 0 or arm_work.n_lost > 0
    if model.n_motors > 0 and shared and not effort_metric(t, lo, n, m, arm_work, arm_work.effort):
        return UNACTUATED, 0
    for k in range(count):
        locked = work.locked_rows[row + k]
        locked[6] = dot6(locked, arm_work.gamma)  # acceleration along the locked wrench
        fill(arm_work.resisted[k], locked)
    _add_to_chain(t, arm, arm_work)
    if arm.sensor_joint >= 0 and arm.outer_joint >= 0:
        if arm.filtered:
            filter_outboard(t, arm, arm_work, arm_work.bias)
        else:
            _add_outboard(t, arm, arm_work)
    return NO_REASON, count


@leaf
def _add_to_chain(t, arm, arm_work):
    """Add inertia, effort and bias of one arm to those of the chain; fill `offset` of its joints.

    The bias of an arm is J̄ᵀh − Λγ (6,), the wrench of velocity and weight at its tip; the offset of
    a joint −J̄γ, its acceleration while the object has none: J̄ (n, 6) is the inertia-weighted
    inverse of its Jacobian, h (n,) the torque of velocities and gravity, to which friction of
    passive joints is added, Λ (6, 6) its inertia, γ (6,) the drift of its tip. All are in energy
    coordinates. Changes `Lambda`, `effort` and `chain_bias`.

    Args:
        t: Tick after `arm_terms`.
        arm: ARM row.
        arm_work: its ARM_WORK.
    """
    model = t.model
    work = t.work
    joints = work.joints
    bias = six(work.chain_bias)
    for j in range(arm.first, arm.end):
        if model.rubs != 0 and model.joints[j].motor < 0:  # passive: other motors compensate it
            joints[j].h += believed_friction(t, j)
        joints[j].offset = -dot6(joints[j].J_bar, arm_work.gamma)
        bias = add(bias, joints[j].h, joints[j].J_bar)
    for i in range(6):
        bias = add(bias, -arm_work.gamma[i], arm_work.Lambda[i])
        fill(work.Lambda[i], plus(work.Lambda[i], arm_work.Lambda[i]))
        fill(work.effort[i], plus(work.effort[i], arm_work.effort[i]))
    fill(work.chain_bias, bias)


@leaf
def _add_outboard(t, arm, arm_work):
    """Add the bodies beyond an arm's wrist sensor to inertia and bias of all such bodies.

    I J (6, n) has the wrench of these bodies per acceleration of each joint: their inertia I times
    the Jacobian J. With the inertia-weighted inverse J̄ (n, 6) of the Jacobian and the drift γ (6,)
    of the tip, the inertia Λ_out increases by I J J̄, and the bias by −I J J̄ γ. Reads `axes`,
    `bias` and `gamma` of the arm, J̄ and `outboard` (I J) of its joints; I J is converted to energy
    coordinates in place. Adds to `out_T` (Λ_out transposed), `bias_links` and `bias_e`.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
    """
    work = t.work
    fill(work.bias_links, plus(work.bias_links, arm_work.bias))
    for j in range(arm.first, arm.end):
        P = work.joints[j].outboard
        bar = work.joints[j].J_bar
        fill(P, energy_wrench(work.axes, P))
        accumulate(work.bias_e, -dot6(bar, arm_work.gamma), P)
        for b in range(6):
            accumulate(work.out_T[b], bar[b], P)


@inner
def _add_object(t):
    """Add the inertia and the bias of the object to those of the chain and of the outboard bodies.

    In energy coordinates the inertia Λ_o is the identity, and the wrench that moves the object at
    the spatial acceleration a = 0 is, along its principal axes, [√m (ω × v − g); (ω × Iω)/√I] with
    its mass m, principal moments I, twist (v, ω) and gravity g. Without an object only the bias of
    the bodies beyond the wrist sensors is added. Reads `axes`, `V_C`, `bias_links`. Adds to
    `Lambda`, `chain_bias`, `out_T`, `bias_e`; fills `bias_out`.

    Args:
        t: Tick.
    """
    model = t.model
    work = t.work
    roots = model.roots
    V = energy_motion(work.axes, work.V_C)  # √m v, √I ω
    w = (V[3] / roots[1], V[4] / roots[2], V[5] / roots[3])
    Iw = (model.principal[1] * w[0], model.principal[2] * w[1], model.principal[3] * w[2])
    (x, y, z) = cross(w, Iw)
    weight = rotated(work.axes[0], model.gravity)
    force = join(minus3(cross(w, V), weight), (x / roots[1], y / roots[2], z / roots[3]))
    share = 1.0 if model.held else 0.0
    links = energy_wrench(work.axes, work.bias_links)
    accumulate(work.chain_bias, share, force)
    for i in range(6):
        work.Lambda[i, i] += share
        work.out_T[i, i] += share
    fill(work.bias_e, plus(work.bias_e, add(links, share, force)))
    fill(work.bias_out, wrench_to_world(work, work.bias_e))


@inner
def _intersect(t, count):
    """Combine the locked wrenches of all arms, and find reflections that turn them to first axes.

    The rows of all arms are rotated until they are orthogonal; those that remain longer than
    `angle_tolerance` are the locked directions. Reads `locked_rows` (a wrench and its rate in each
    row; overwritten). Fills `locked` (m), `reflectors` and `beta`, and `sigma`, the acceleration
    along the locked axes at η̇ = 0 (energy coordinates, not yet turned).

    Args:
        t: Tick.
        count: number of filled rows of `locked_rows`.
    """
    locked = t.work.locked_rows
    work = t.work
    fill(work.sigma, ZERO)
    work.locked = 0
    if count == 0:
        return
    one_sided_jacobi(locked, count, 6, 1)  # the rate behind each wrench is rotated with it
    for k in range(count):
        square = dot(locked[k], locked[k], 6)
        if sqrt(square) > t.model.angle_tolerance and work.locked < 6:
            for i in range(6):
                work.sigma[i] += locked[k, i] * locked[k, 6] / square
            fill(work.reflectors[work.locked], locked[k])
            work.locked += 1
    # reflections that map these directions to the first axes
    diagonal = local(6)
    qr_rows(work.reflectors, work.locked, 6, diagonal, work.beta)
    for k in range(work.locked):  # there `qr_rows` has left R, which is not needed
        for i in range(k):
            work.reflectors[k, i] = 0.0
