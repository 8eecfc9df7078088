"""The model stage of a tick: placement of the object, terms of every arm, what they lock."""

from __future__ import annotations

from osc_contact.kernels import layout as at
from osc_contact.kernels.allocation import effort_metric
from osc_contact.kernels.arm import arm_terms, passed_terms
from osc_contact.kernels.body import arm_motion
from osc_contact.kernels.closed_chain import intersect
from osc_contact.kernels.compile import compiled, cube, integers, matrix, pose_in, vector
from osc_contact.kernels.grasp import (
    add_filtered_outboard,
    effort_passed,
    find_object,
    slip,
)
from osc_contact.kernels.linalg import cross, dot6, reflect, reflect_sides
from osc_contact.kernels.white import motion_to, set_axes, white_motion, white_wrench

__all__ = ["model_stage"]


@compiled
def place(pose, head, start, R, p):
    """A frame given in a joint, head[start:] = rotation by rows and point, in the world."""
    for i in range(3):
        for j in range(3):
            R[i, j] = (
                pose[i] * head[start + j]
                + pose[3 + i] * head[start + 3 + j]
                + pose[6 + i] * head[start + 6 + j]
            )
    point_in(pose, head, start + 9, p)


@compiled
def point_in(pose, table, start, p):
    """A point given in a joint, table[start:], in the world."""
    x, y, z = table[start], table[start + 1], table[start + 2]
    for i in range(3):
        p[i] = pose[9 + i] + pose[i] * x + pose[3 + i] * y + pose[6 + i] * z


@compiled
def object_terms(axes, V, gravity, roots, squares, out):
    """out (6,) = μ_o + p_o, white, of an object with twist V (6,) at its centre of mass C.

    In its principal axes: √m (ω × v) and (ω × Iω)/√I, weight −√m g.
    """
    white_motion(axes, V, out)
    vx, vy, vz = out[0], out[1], out[2]  # √m v
    wx, wy, wz = out[3] / roots[1], out[4] / roots[2], out[5] / roots[3]
    x, y, z = cross(wx, wy, wz, vx, vy, vz)
    a, b, c = cross(wx, wy, wz, squares[1] * wx, squares[2] * wy, squares[3] * wz)
    out[3], out[4], out[5] = a / roots[1], b / roots[2], c / roots[3]
    for i in range(3):
        s = 0.0
        for j in range(3):
            s += axes[0, i, j] * gravity[j]
        out[i] = (x if i == 0 else (y if i == 1 else z)) - s


@compiled
def add_arm(bound, sizes, k, v, row):
    """Arm k's share in everything that is summed over the arms; returns what it locks, or −1.

    The vectors of arms 0 and 1 that the squeeze needs are kept apart (OWN_0, OWN_1, …).

    Args:
        bound: see `layout`. sizes: row SIZES of it. v: (n,). row: first free row of LOCKED.
    """
    rows, squares = matrix(bound, at.ROWS), cube(bound, at.SQUARES)
    arms, kinds = integers(bound, at.ARMS_I), integers(bound, at.JOINTS_I)
    head, axes = vector(bound, at.HEAD), cube(bound, at.AXES)
    lo, hi = arms[k, 0], arms[k, 1]
    parts, locked = cube(bound, at.JOINT_ROWS), matrix(bound, at.LOCKED)
    white, bar, outboard = parts[1], parts[2], parts[4]
    vectors = matrix(bound, at.JOINT_VECTORS)
    h, left = vectors[0], vectors[2]
    joints, X = matrix(bound, at.JOINTS), matrix(bound, at.HOUSEHOLDER)
    side = min(k, 1)
    grasps, passed = integers(bound, at.GRASPS_I), cube(bound, at.PASSED)
    slipping, rigid, m = sizes[at.SLIPPING] != 0, True, 6
    V, bias_links = rows[at.SCRATCH], rows[at.BIAS_LINKS]
    if slipping:
        m = grasps[k, 0]
        rigid = m == 6
        if grasps[k, 2] != 0:
            bias_links = rows[at.TOTAL]
            bias_links[:] = 0.0
    elif k == 0:
        V = rows[at.V]
    arm_motion(
        lo, hi, v, matrix(bound, at.J), matrix(bound, at.POSE), joints, kinds,
        rows[at.CENTRE], head[:3], parts[0], parts[3], outboard, matrix(bound, at.LINKS), h,
        V, rows[at.DRIFT], bias_links,
    )  # fmt: skip
    if not rigid:  # N is carried by the tip while the object slips
        U, a = rows[at.V], rows[at.DRIFT]
        x, y, z = cross(V[3], V[4], V[5], U[0], U[1], U[2])
        i, j, l = cross(V[0], V[1], V[2], U[3], U[4], U[5])
        a[0], a[1], a[2] = a[0] + x + i, a[1] + y + j, a[2] + z + l
        x, y, z = cross(V[3], V[4], V[5], U[3], U[4], U[5])
        a[3], a[4], a[5] = a[3] + x, a[4] + y, a[5] + z
    for j in range(lo, hi):
        white_motion(axes, parts[0, j], white[j])
    gamma = rows[at.GAMMA]
    white_motion(axes, rows[at.DRIFT], gamma)
    Lambda, effort = squares[at.ARM], cube(bound, at.ARM_SQUARES)[k]
    M, K, Z = matrix(bound, at.M), matrix(bound, at.TRIANGLE), matrix(bound, at.Q_FACTOR)
    if rigid:
        count = arm_terms(
            lo, hi - lo, M, white, head[at.TOLERANCE], bar, Lambda, locked, row, K, X, Z,
            rows[at.DIAGONAL], rows[at.BETA],
        )  # fmt: skip
    else:
        count = passed_terms(
            lo, hi - lo, M, white, passed[k], m, head[at.TOLERANCE], bar, Lambda, locked, row,
            K, X, Z,
        )  # fmt: skip
        if count > 0 and hi - lo > m - count:
            return -1  # which joints move the object is not plain
    if count < 0 or fading(count if rigid else 0, Lambda, matrix(bound, at.ARMS)[k], head):
        return -1
    if not rigid and hi - lo > m:
        if not effort_passed(
            lo, hi - lo, white, joints, passed[k], m, squares[at.GRAM], squares[at.GRAM_L], X,
            effort,
        ):  # fmt: skip
            return -1
    elif not effort_metric(lo, hi - lo, white, bar, joints, squares[at.WORK], X, effort):
        return -1
    for a in range(row, row + count):
        locked[a, 6] = dot6(locked[a], gamma)
    for j in range(lo, hi):
        left[j] = -dot6(bar[j], gamma)
    _sum_up(rows, squares, side, lo, hi, h, bar, Lambda, effort)
    if arms[k, 3] >= 0 and slipping and grasps[k, 2] != 0:
        if not add_filtered_outboard(
            lo, hi, axes, bar, white, outboard, gamma, bias_links, passed[k], m, squares,
            cube(bound, at.FILTERS)[k], rows[at.BIAS_WHITE],
        ):  # fmt: skip
            return -1
    elif arms[k, 3] >= 0:
        _add_outboard(
            lo, hi, axes, kinds, bar, outboard, gamma, squares[at.OUT_T], rows[at.BIAS_WHITE]
        )
    return count


@compiled
def fading(count, Lambda, arm, head):
    """Whether the arm may be near a singular posture, where the readable path must decide.

    ΣΣ Λ_ij²/(Λ_ii Λ_jj)_ref ≥ 1/χ⁴, white: Λ_ref is diagonal there (`dynamics.singular`).

    Args:
        count: directions it locks. arm: its row of ARMS. head: row HEAD.
    """
    if count > 6 - arm[16]:
        return True
    s = 0.0
    for i in range(6):
        own = head[at.PRINCIPAL + max(i - 2, 0)]
        x = own / (own + arm[15] * (1.0 if i < 3 else head[at.GYRATION]))
        for j in range(6):
            own = head[at.PRINCIPAL + max(j - 2, 0)]
            y = own / (own + arm[15] * (1.0 if j < 3 else head[at.GYRATION]))
            s += Lambda[i, j] * Lambda[i, j] * x * y
    return s >= head[at.FADING]


@compiled
def _sum_up(rows, squares, side, lo, hi, h, bar, Lambda, effort):
    """ΣΛ_i, ΣQ_i, Σ(J̄ᵀh − Λγ), and the arm's own part of them along the grasp line."""
    line, own, gamma = rows[at.LINE], rows[at.OWN_0 + side], rows[at.GAMMA]
    for i in range(6):
        s = 0.0
        for j in range(lo, hi):
            s += bar[j, i] * h[j]
        own[i] = s - dot6(Lambda[i], gamma)
        rows[at.ALONG_0 + side, i] = dot6(Lambda[i], line)
        rows[at.EFFORT_0 + side, i] = dot6(effort[i], line)
        rows[at.CHAIN, i] += own[i]
        for j in range(6):
            squares[at.LAMBDA, i, j] += Lambda[i, j]
            squares[at.EFFORT, i, j] += effort[i, j]


@compiled
def _add_outboard(lo, hi, axes, kinds, bar, outboard, gamma, out_T, bias_out):
    """Λ_out += I J J̄ (transposed), bias −= I J J̄ γ of the bodies beyond the wrist sensor, white."""
    first = hi
    for j in range(lo, hi):
        if kinds[j, 0] != 0:
            first = j
            break
    if first == hi:
        return
    for j in range(lo, hi):
        white_wrench(axes, outboard[j], outboard[j])
        s = dot6(bar[j], gamma)
        for a in range(6):
            bias_out[a] -= s * outboard[j, a]
            for b in range(6):
                out_T[b, a] += outboard[j, a] * bar[j, b]


@compiled
def model_stage(bound, sizes, v):
    """The closed chain; returns the number of directions it locks, or −1."""
    head, rows = vector(bound, at.HEAD), matrix(bound, at.ROWS)
    squares, arms = cube(bound, at.SQUARES), integers(bound, at.ARMS_I)
    pose, tips = matrix(bound, at.POSE), matrix(bound, at.ARMS)
    axes, signals = cube(bound, at.AXES), vector(bound, at.SIGNALS)
    locked, Z = matrix(bound, at.LOCKED), matrix(bound, at.Q_FACTOR)

    C, O, line = rows[at.CENTRE], rows[at.O], rows[at.LINE]
    if sizes[at.LEADER] >= 0:
        first = pose[arms[sizes[at.LEADER], 2]]
        X_WO = pose_in(signals, at.X_WO)
        place(first, head, at.X_JO, X_WO, O)
        for i in range(3):
            X_WO[i, 3] = O[i]
        R = rows[at.R_0 : at.R_2 + 1]
        place(first, head, at.X_JP, R, C)
        set_axes(R, head[at.ROOTS : at.ROOTS + 4], axes)
    elif not find_object(bound, sizes):
        return -1
    if sizes[at.SLIPPING] and not slip(bound, sizes, v):
        return -1
    two = sizes[at.N_ARMS] == 2 and _grasp_line(pose, arms, tips, rows, C, axes)

    for k in range(at.B_INV):
        squares[k] = 0.0
    held = 1.0 if sizes[at.HELD] else 0.0
    rows[at.BIAS_LINKS] = 0.0
    rows[at.BIAS_WHITE] = 0.0
    rows[at.CHAIN] = 0.0
    if not two:
        line[:] = 0.0
    count = 0 * sizes[at.N_ARMS]
    for k in range(sizes[at.N_ARMS]):
        found = add_arm(bound, sizes, k, v, count)
        if found < 0:
            return -1
        count += found
    motion_to(rows[at.V], C, O, signals[at.V_O : at.V_O + 6])
    object_terms(
        axes, rows[at.V], head[:3], head[at.ROOTS : at.ROOTS + 4], head[at.PRINCIPAL :],
        rows[at.WEIGHT],
    )  # fmt: skip
    white_wrench(axes, rows[at.BIAS_LINKS], rows[at.SCRATCH])
    for i in range(6):
        squares[at.OUT_T, i, i] += held
        weight = held * rows[at.WEIGHT, i]
        rows[at.CHAIN, i] += weight
        rows[at.BIAS_WHITE, i] += weight + rows[at.SCRATCH, i]
    m = intersect(
        locked, count, head[at.TOLERANCE], Z, rows[at.BETA], rows[at.DIAGONAL], rows[at.SIGMA]
    )
    if m > 0:
        beta = rows[at.BETA]
        for k in (at.LAMBDA, at.EFFORT):
            reflect_sides(Z, beta, m, squares[k])
        for k in (at.CHAIN, at.SIGMA, at.OWN_0, at.OWN_1):
            reflect(Z, beta, m, rows[k])
        if two:
            for k in (at.ALONG_0, at.ALONG_1, at.EFFORT_0, at.EFFORT_1):
                reflect(Z, beta, m, rows[k])
    return m


@compiled
def _grasp_line(pose, arms, tips, rows, C, axes):
    """The unit translation from the first grasp to the second, white; False if they coincide."""
    p, s = rows[at.POINT], rows[at.SCRATCH]
    point_in(pose[arms[0, 2]], tips[0], 0, p)
    point_in(pose[arms[1, 2]], tips[1], 0, s)
    square = 0.0
    for i in range(3):
        p[i] = s[i] - p[i]
        square += p[i] * p[i]
        p[3 + i] = 0.0
    if square < 1e-18:
        return False
    for i in range(3):
        p[i] /= square**0.5
    white_motion(axes, p, rows[at.LINE])
    return True
