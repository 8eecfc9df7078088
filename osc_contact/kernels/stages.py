"""The stages behind the model, in the order of fig. 4."""

from __future__ import annotations

from math import isfinite

from osc_contact.kernels import layout as at
from osc_contact.kernels.allocation import arm_torques, hold_posture, multipliers
from osc_contact.kernels.command_filter import filter_motion, permitted, reachable
from osc_contact.kernels.compile import compiled, cube, integers, matrix, pose_in, vector
from osc_contact.kernels.contact import contact_columns
from osc_contact.kernels.environment import along_normals
from osc_contact.kernels.force import (
    add_wrist_reading,
    contact_magnitudes,
    contact_terms,
    force_command,
    pushing_columns,
)
from osc_contact.kernels.grasp import filter_reading
from osc_contact.kernels.linalg import dot6, reflect, reflect_back, reflect_sides
from osc_contact.kernels.motion import motion_command, pose_error
from osc_contact.kernels.stack import stack
from osc_contact.kernels.white import (
    motion_from_white,
    motion_to,
    white_motion,
    white_wrench,
    wrench_from_white,
    wrench_to,
)

__all__ = ["contact_stage", "force_stage", "motion_stage", "structure_stage", "torque_stage"]


@compiled
def contact_stage(bound, sizes, count, moving):
    """N, n_γ and what the touched bodies do along N; returns the number r of columns, or −1.

    Of all columns of N, `count` are in force (`inputs.choose`).
    """
    columns = matrix(bound, at.COLUMNS)
    squares, rows = cube(bound, at.SQUARES), matrix(bound, at.ROWS)
    Phi_N, Phi_mu, head = squares[at.PHI_N], squares[at.PHI_MU], vector(bound, at.HEAD)
    signals = vector(bound, at.SIGNALS)
    signals[at.RANK] = 0.0
    if count == 0:
        return 0
    N, owners = matrix(bound, at.N_O), integers(bound, at.COLUMNS_I)
    touched, bodies = matrix(bound, at.TOUCHED), integers(bound, at.BODIES_I)
    sets = cube(bound, at.CONTACT_ROWS)
    share = matrix(bound, at.SHARE)
    O, C = rows[at.O], rows[at.CENTRE]
    X_WO = pose_in(signals, at.X_WO)
    n_gamma, scratch = columns[at.N_GAMMA], sets[at.SOLVED]
    if not contact_columns(
        integers(bound, at.PAIRS_I), sizes[at.N_PAIRS], matrix(bound, at.SHAPES), X_WO,
        signals[at.V_O : at.V_O + 6], touched, moving, head[at.FRICTION],
        head[at.SLIP], N, n_gamma, sets[at.DRAGS], scratch,
    ):  # fmt: skip
        return -1
    axes, white = cube(bound, at.AXES), sets[at.ALL]
    keep = integers(bound, at.KEEP)
    for j in range(count):
        wrench_to(N[keep[j, 1]], O, C, rows[at.SCRATCH])
        white_wrench(axes, rows[at.SCRATCH], white[j])
        n_gamma[j] = n_gamma[keep[j, 1]]
    r = stack(
        white, count, n_gamma, columns[at.SIZE], sets[at.REST], keep[:, 0], share,
        matrix(bound, at.HOUSEHOLDER), matrix(bound, at.STACK_Q), rows[at.X], rows[at.Y],
    )  # fmt: skip
    if r < 0:
        return -1
    signals[at.RANK] = r
    for a in range(r):
        for i in range(6):
            sets[at.KEPT, a, i] = white[keep[a, 0], i]
            sets[at.TURNED, a, i] = white[keep[a, 0], i]
            Phi_N[a, i] = Phi_mu[a, i] = 0.0
        n_gamma[a] = n_gamma[keep[a, 0]]
        keep[a, 0] = keep[keep[a, 0], 1]  # now among all columns
        rows[at.B_N, a] = 0.0
        rows[at.V_N, a] = 0.0
    pushing_columns(head, sets, axes, keep, r, count, share, O, C, rows[at.SCRATCH])
    if moving:
        if r < count:  # dependent columns of different bodies are refused
            for c in range(1, sizes[at.N_CONTACTS]):
                if bodies[c, 1] != bodies[0, 1]:
                    return -1
        along_normals(
            N, keep[:, 0], r, sets[at.DRAG], owners[:, 0], bodies[:, 0], bodies[:, 1],
            matrix(bound, at.BODIES), touched, sizes[at.N_CONTACTS], O,
            matrix(bound, at.ANSWERS), rows[at.SCRATCH], Phi_N, Phi_mu, rows[at.B_N], rows[at.V_N],
        )  # fmt: skip
    return r


@compiled
def force_stage(bound, sizes, r, count, wrenches, alpha_d):
    """Wrist readings to contact magnitudes, and the force command."""
    rows, arms = matrix(bound, at.ROWS), integers(bound, at.ARMS_I)
    signals, state, head = (
        vector(bound, at.SIGNALS),
        vector(bound, at.STATE),
        vector(bound, at.HEAD),
    )
    pose, tips = matrix(bound, at.POSE), matrix(bound, at.ARMS)
    axes, squares = cube(bound, at.AXES), cube(bound, at.SQUARES)
    columns = matrix(bound, at.COLUMNS)
    sets = cube(bound, at.CONTACT_ROWS)
    N, keep = matrix(bound, at.N_O), integers(bound, at.KEEP)
    C, O, total, scratch = rows[at.CENTRE], rows[at.O], rows[at.TOTAL], vector(bound, at.WIDE)
    f_meas = signals[at.F_MEAS : at.F_MEAS + 6]
    total[:] = 0.0
    for k in range(sizes[at.N_ARMS]):
        if arms[k, 3] < 0:
            continue
        if sizes[at.SLIPPING] and integers(bound, at.GRASPS_I)[k, 2] != 0:
            own = rows[at.Y]
            own[:] = 0.0
            add_wrist_reading(wrenches[k], pose[arms[k, 3]], tips[k, 3:], C, scratch, own)
            filter_reading(axes, cube(bound, at.FILTERS)[k], own, rows[at.SCRATCH])
            for i in range(6):
                total[i] += own[i]
        else:
            add_wrist_reading(wrenches[k], pose[arms[k, 3]], tips[k, 3:], C, scratch, total)
    wrench_to(total, C, O, f_meas)
    for i in range(6):
        f_meas[i] -= state[at.TARE + i]
    bias_out = signals[at.BIAS_OUT : at.BIAS_OUT + 6]
    wrench_from_white(axes, rows[at.BIAS_WHITE], bias_out)
    wrench_to(bias_out, C, O, bias_out)
    f_c = signals[at.F_C : at.F_C + 6]
    f_c[:] = 0.0
    if r == 0:
        return True
    wrench_to(f_meas, O, C, total)
    white_wrench(axes, total, rows[at.Y])
    for i in range(6):
        rows[at.Y, i] -= rows[at.BIAS_WHITE, i]
    if not contact_magnitudes(
        squares[at.OUT_T], sets[at.KEPT], sets[at.PUSHED], r, rows[at.Y], columns[at.N_GAMMA],
        rows[at.B_N], squares[at.PHI_MU], sets[at.SOLVED], squares[at.WORK], squares[at.MOBILITY],
        rows[at.ALPHA : at.ALPHA + 1],
    ):  # fmt: skip
        return False
    V_O = signals[at.V_O : at.V_O + 6]
    share = matrix(bound, at.SHARE)
    for a in range(r):
        n = N[keep[a, 0]]
        alpha = rows[at.ALPHA, a]
        columns[at.ALPHA_MEAS, a] = alpha
        for i in range(6):
            f_c[i] += alpha * n[i]
        columns[at.SPEED, a] = dot6(n, V_O) - rows[at.V_N, a]
        if r == count:
            columns[at.ALPHA_D, a] = alpha_d[keep[a, 0]]
        else:
            s = 0.0
            for j in range(count):
                s += share[a, j] * alpha_d[keep[j, 1]]
            columns[at.ALPHA_D, a] = s
    integral = rows[at.SCRATCH]
    for a in range(r):  # another number of columns: start again
        integral[a] = state[at.FORCE_SUM + a] if state[at.FORCE_RANK] == r else 0.0
    contact_terms(
        matrix(bound, at.TERMS), integers(bound, at.COLUMNS_I)[:, 0], keep[:, 1], count,
        keep[:, 0], r, columns[at.GAIN], columns[at.DAMP], columns[at.LEAST_U],
    )  # fmt: skip
    force_command(
        r, columns[at.ALPHA_D], columns[at.ALPHA_MEAS], columns[at.SPEED], integral,
        columns[at.GAIN], columns[at.DAMP], columns[at.LEAST_U], head[at.PERIOD],
        signals[at.FORCE_SUM_NEXT :], columns[at.ALPHA_U],
    )  # fmt: skip
    return True


@compiled
def motion_stage(bound, sizes, r, m, X_WD, V_D, A_D):
    """The motion law and its filter: rows[X] = the object's acceleration ã, turned."""
    rows, head = matrix(bound, at.ROWS), vector(bound, at.HEAD)
    signals, state = vector(bound, at.SIGNALS), vector(bound, at.STATE)
    axes, squares = cube(bound, at.AXES), cube(bound, at.SQUARES)
    columns = matrix(bound, at.COLUMNS)
    sets = cube(bound, at.CONTACT_ROWS)
    Z, K = matrix(bound, at.Q_FACTOR), matrix(bound, at.TRIANGLE)
    C, O, beta = rows[at.CENTRE], rows[at.O], rows[at.BETA]
    kept, turned, solved = sets[at.KEPT], sets[at.TURNED], sets[at.SOLVED]
    Lambda, B_inv, gram = squares[at.LAMBDA], squares[at.B_INV], squares[at.GRAM]
    L, work, weight = squares[at.GRAM_L], squares[at.WORK], rows[at.SCRATCH]
    held = 1.0 if sizes[at.HELD] else 0.0
    by_object = sizes[at.METRIC_KIND] == at.BY_OBJECT

    for a in range(r):
        reflect(Z, beta, m, turned[a])
        reflect(Z, beta, m, sets[at.PUSHED, a])
    if not by_object:
        _metric(bound, sizes, m)
    # pose error, and the part of it that the contact permits
    error = signals[at.ERROR : at.ERROR + 6]
    free, e = signals[at.FREE_ERROR : at.FREE_ERROR + 6], rows[at.Y]
    X_WO = pose_in(signals, at.X_WO)
    pose_error(X_WD, X_WO, error)
    after = signals[at.ERROR_SUM_NEXT : at.ERROR_SUM_NEXT + 6]
    if not _free_error(rows, axes, error, kept, r, True, B_inv, solved, K, gram, L, weight, free):
        return False
    step = free
    if not by_object:
        for a in range(r):
            reflect(Z, beta, m, kept[a])  # B_inv is turned
        motion_to(error, O, C, rows[at.WORLD])
        white_motion(axes, rows[at.WORLD], e)
        reflect(Z, beta, m, e)
        if not permitted(kept, r, e, False, B_inv, solved, K, gram, L, weight):
            return False
        reflect_back(Z, beta, m, e)
        motion_from_white(axes, e, rows[at.WORLD])
        motion_to(rows[at.WORLD], C, O, rows[at.WORLD])
        step = rows[at.WORLD]
    for i in range(6):
        after[i] = state[at.ERROR_SUM + i] + step[i] * head[at.PERIOD]
    a_u = signals[at.A_U : at.A_U + 6]
    motion_command(
        error, after, V_D, A_D, signals[at.V_O : at.V_O + 6], head[at.STIFFNESS], head[at.DAMPING],
        head[at.INTEGRAL], a_u,
    )  # fmt: skip
    x, rho, sigma = rows[at.X], rows[at.RHO], rows[at.SIGMA]
    motion_to(a_u, O, C, rows[at.WORLD])
    white_motion(axes, rows[at.WORLD], x)
    reflect(Z, beta, m, x)
    for i in range(6):
        x[i] -= sigma[i]
    if r > 0:
        own = columns[at.SIZE]
        for a in range(r):
            own[a] = dot6(turned[a], turned[a])
            s = columns[at.N_GAMMA, a] + rows[at.B_N, a]
            for b in range(r):
                s += squares[at.PHI_MU, a, b] * columns[at.ALPHA_U, b]
            for i in range(m):
                s -= turned[a, i] * sigma[i]
            rho[a] = s
        if not reachable(turned, r, m, Lambda, held, own, gram, L, squares[at.FACTOR], work):
            return False
    if not filter_motion(turned, r, m, L, x, rho, by_object, B_inv, solved, K, work, weight):
        return False
    for i in range(m):
        x[i] = sigma[i]
    return True


@compiled
def _free_error(rows, axes, error, kept, r, by_object, B_inv, solved, K, gram, L, weight, out):
    """out (6,) = Ω_m(Λ_o⁻¹) error, both at O in world axes."""
    C, O, e, world = rows[at.CENTRE], rows[at.O], rows[at.Y], rows[at.WORLD]
    motion_to(error, O, C, world)
    white_motion(axes, world, e)
    if not permitted(kept, r, e, by_object, B_inv, solved, K, gram, L, weight):
        return False
    motion_from_white(axes, e, world)
    motion_to(world, C, O, out)
    return True


@compiled
def _metric(bound, sizes, m):
    """B⁻¹ of the motion filter, white and turned."""
    squares, rows = cube(bound, at.SQUARES), matrix(bound, at.ROWS)
    B_inv = squares[at.B_INV]
    if sizes[at.METRIC_KIND] == at.BY_CHAIN:
        for i in range(6):
            for j in range(6):
                B_inv[i, j] = squares[at.LAMBDA, i, j]
            B_inv[i, i] += 1.0
        return
    given, axes, work = matrix(bound, at.METRIC), cube(bound, at.AXES), squares[at.WORK]
    for half in range(2):  # the map from wrenches to white ones, from both sides
        for i in range(6):
            row = given[i] if half == 0 else work[i]
            wrench_to(row, rows[at.O], rows[at.CENTRE], rows[at.WORLD])
            white_wrench(axes, rows[at.WORLD], rows[at.SCRATCH])
            for j in range(6):
                B_inv[i, j] = rows[at.SCRATCH, j]
        for i in range(6):
            for j in range(6):
                work[i, j] = B_inv[j, i]
    reflect_sides(matrix(bound, at.Q_FACTOR), rows[at.BETA], m, B_inv)


@compiled
def structure_stage(bound, sizes, r, m, squeeze):
    """The dynamic control structure, eq. 21, and the multipliers of the torque allocation."""
    rows, squares = matrix(bound, at.ROWS), cube(bound, at.SQUARES)
    axes, state = cube(bound, at.AXES), vector(bound, at.STATE)
    columns = matrix(bound, at.COLUMNS)
    pushed = cube(bound, at.CONTACT_ROWS)[at.PUSHED]
    Z, beta = matrix(bound, at.Q_FACTOR), rows[at.BETA]
    x, f_S, bias, line = rows[at.X], rows[at.F_S], rows[at.Y], rows[at.TOTAL]
    held = 1.0 if sizes[at.HELD] else 0.0
    wrench_to(state[at.BIAS : at.BIAS + 6], rows[at.O], rows[at.CENTRE], rows[at.WORLD])
    white_wrench(axes, rows[at.WORLD], bias)
    reflect(Z, beta, m, bias)
    for i in range(6):
        s = rows[at.CHAIN, i] + bias[i] + held * x[i] + dot6(squares[at.LAMBDA, i], x)
        for a in range(r):
            s += pushed[a, i] * columns[at.ALPHA_U, a]
        f_S[i] = s
    two = sizes[at.N_ARMS] == 2 and dot6(rows[at.LINE], rows[at.LINE]) > 0.0
    skewed, own, e0 = rows[at.WORLD], 0.0, 0.0
    if two:
        for i in range(6):
            line[i] = rows[at.LINE, i]
        reflect(Z, beta, m, line)
        for i in range(6):
            first, second = rows[at.EFFORT_0, i], rows[at.EFFORT_1, i]
            skewed[i] = 0.5 * (first - second)
            own += 0.25 * line[i] * (first + second)
            e0 += 0.5 * line[i] * (rows[at.OWN_0, i] - rows[at.OWN_1, i])
            e0 += 0.5 * x[i] * (rows[at.ALONG_0, i] - rows[at.ALONG_1, i])
    return multipliers(
        squares[at.EFFORT], m, two, skewed, own, f_S, squeeze + e0,
        matrix(bound, at.TRIANGLE), matrix(bound, at.HOUSEHOLDER), rows[at.Z],
    )  # fmt: skip


@compiled
def torque_stage(bound, sizes, r, m, q, v, squeeze):
    """Motor torques; those beyond a limit are left where they are."""
    rows, head = matrix(bound, at.ROWS), vector(bound, at.HEAD)
    n = sizes[at.N_JOINTS]
    vectors, joint_rows = matrix(bound, at.JOINT_VECTORS), cube(bound, at.JOINT_ROWS)
    arms, joints = integers(bound, at.ARMS_I), matrix(bound, at.JOINTS)
    motors, tau_max = integers(bound, at.JOINTS_I), vector(bound, at.TAU_MAX)
    effort, M = cube(bound, at.ARM_SQUARES), matrix(bound, at.M)
    tau, out = vectors[1], vector(bound, at.TAU)
    h, white, bar, y, z = vectors[0], joint_rows[1], joint_rows[2], rows[at.Y], rows[at.Z]
    signals = vector(bound, at.SIGNALS)
    two = sizes[at.N_ARMS] == 2 and dot6(rows[at.LINE], rows[at.LINE]) > 0.0
    whole = rows[at.WORLD]
    for i in range(6):
        whole[i] = z[i] if i >= m else 0.0
    reflect_back(matrix(bound, at.Q_FACTOR), rows[at.BETA], m, whole)
    for k in range(sizes[at.N_ARMS]):
        lo, count = arms[k, 0], arms[k, 1] - arms[k, 0]
        for i in range(6):
            y[i] = whole[i]
            if two:
                y[i] += (0.5 if k == 0 else -0.5) * z[6] * rows[at.LINE, i]
        wide = count > 6
        if sizes[at.SLIPPING]:
            wide = count > integers(bound, at.GRASPS_I)[k, 0]
        if wide:
            hold_posture(
                lo, count, M, white, bar, joints, h, q, v, head[at.POSTURE_STIFFNESS],
                head[at.POSTURE_DAMPING], rows[at.SCRATCH], tau,
            )  # fmt: skip
        else:
            for j in range(lo, lo + count):
                tau[j] = 0.0
        arm_torques(lo, count, wide, white, bar, joints, effort[k], y, rows[at.SCRATCH], tau)
    excess, s = False, 0.0
    for j in range(n):
        i = motors[j, 1]
        if i >= 0:
            s += tau[j] * 0.0
            excess = excess or abs(tau[j]) > tau_max[i]
    for i in range(6):
        s += 0.0 * signals[at.ERROR_SUM_NEXT + i]
    for a in range(r):
        s += 0.0 * signals[at.FORCE_SUM_NEXT + a]
    if not isfinite(s):
        return at.ASK
    signals[at.LOCKED_AXES] = m
    signals[at.SQUEEZE] = squeeze if two else 0.0
    for i in range(6):  # the object's acceleration, white; no x beside σ in the locked directions
        whole[i] = rows[at.X, i]
    reflect_back(matrix(bound, at.Q_FACTOR), rows[at.BETA], m, whole)
    for j in range(n):
        vectors[3, j] = dot6(bar[j], whole) + vectors[2, j]
    if excess:
        return at.SATURATED
    for j in range(n):
        if motors[j, 1] >= 0:
            out[motors[j, 1]] = tau[j]
    return at.OK
