"""One arm, base to tip and back: placements, Jacobian, drift, joint forces, joint-space inertia.

A recursion in world axes about one common point C, the object's centre of mass. Joints turn about,
or slide along, the z axis of their frame.
"""

from __future__ import annotations

from math import cos, sin

from osc_contact.law.jit import inner, leaf
from osc_contact.law.vectors import ZERO, add, cross, dot6, fill, plus, six


@leaf
def place_arm(t, lo, hi, q):
    """Rotation R and point p of every joint of an arm at q (n,), in the world.

    Args:
        lo, hi: first joint of the arm, and the one behind its last. q: (n,) positions
        (m, rad).
    """
    joints = t.model.joints
    work = t.work.joints
    for j in range(lo, hi):
        X = joints[j].placement
        w = work[j]
        angle = q[j]
        R = w.R
        p = w.p
        c = 1.0
        s = 0.0
        slide = angle
        if joints[j].slides == 0:
            c = cos(angle)
            s = sin(angle)
            slide = 0.0
        if j == lo:
            for i in range(3):
                R[i, 0] = X[3 * i]
                R[i, 1] = X[3 * i + 1]
                R[i, 2] = X[3 * i + 2]
                p[i] = X[9 + i]
        else:
            before = work[j - 1].R
            start = work[j - 1].p
            x0, x1, x2, x3, x4, x5 = six(X)
            x6, x7, x8, x, y, z = six(X[6:])
            for i in range(3):
                a = before[i, 0]
                b = before[i, 1]
                d = before[i, 2]
                R[i, 0] = a * x0 + b * x3 + d * x6
                R[i, 1] = a * x1 + b * x4 + d * x7
                R[i, 2] = a * x2 + b * x5 + d * x8
                p[i] = start[i] + a * x + b * y + d * z
        for i in range(3):
            a = R[i, 0]
            b = R[i, 1]
            R[i, 0] = c * a + s * b
            R[i, 1] = c * b - s * a
            p[i] += slide * R[i, 2]


@leaf
def place_point(w, table, start, out):
    """A point given in a joint, table[start:], in the world.

    Args:
        w: JOINT_WORK row. table: (…,) numbers that hold the point in the joint (m).
        start: first of three elements. out: (3,) point (m).
    """
    x = table[start]
    y = table[start + 1]
    z = table[start + 2]
    R = w.R
    p = w.p
    for i in range(3):
        out[i] = p[i] + R[i, 0] * x + R[i, 1] * y + R[i, 2] * z


@inner
def place_frame(w, X, R, p):
    """A frame given in a joint, X (12,): rotation by rows, then point; in the world: R, p.

    Args:
        w: JOINT_WORK row. X: (12,) frame in the joint. R, p: (3, 3), (3,) for it in the world.
    """
    B = w.R
    for i in range(3):
        for j in range(3):
            R[i, j] = B[i, 0] * X[j] + B[i, 1] * X[3 + j] + B[i, 2] * X[6 + j]
    place_point(w, X, 9, p)


@leaf
def _place_body(w, C, link, body):
    """A body given in a joint (mass, centre, inertia about it) in world axes about C.

    Written to `body`: mass, mass × centre (3), rotational inertia about C (xx, xy, xz, yy, yz, zz).
    """
    R = w.R
    p = w.p
    r00 = R[0, 0]
    r01 = R[0, 1]
    r02 = R[0, 2]
    r10 = R[1, 0]
    r11 = R[1, 1]
    r12 = R[1, 2]
    r20 = R[2, 0]
    r21 = R[2, 1]
    r22 = R[2, 2]
    m = link[0]
    x = link[1]
    y = link[2]
    z = link[3]
    cx = r00 * x + r01 * y + r02 * z + p[0] - C[0]
    cy = r10 * x + r11 * y + r12 * z + p[1] - C[1]
    cz = r20 * x + r21 * y + r22 * z + p[2] - C[2]
    xx = link[4]
    xy = link[5]
    xz = link[6]
    yy = link[7]
    yz = link[8]
    zz = link[9]
    a00 = r00 * xx + r01 * xy + r02 * xz
    a01 = r00 * xy + r01 * yy + r02 * yz
    a02 = r00 * xz + r01 * yz + r02 * zz
    a10 = r10 * xx + r11 * xy + r12 * xz
    a11 = r10 * xy + r11 * yy + r12 * yz
    a12 = r10 * xz + r11 * yz + r12 * zz
    a20 = r20 * xx + r21 * xy + r22 * xz
    a21 = r20 * xy + r21 * yy + r22 * yz
    a22 = r20 * xz + r21 * yz + r22 * zz
    mx = m * cx
    my = m * cy
    mz = m * cz
    body[0] = m
    body[1] = mx
    body[2] = my
    body[3] = mz
    body[4] = a00 * r00 + a01 * r01 + a02 * r02 + my * cy + mz * cz
    body[5] = a00 * r10 + a01 * r11 + a02 * r12 - mx * cy
    body[6] = a00 * r20 + a01 * r21 + a02 * r22 - mx * cz
    body[7] = a10 * r10 + a11 * r11 + a12 * r12 + mx * cx + mz * cz
    body[8] = a10 * r20 + a11 * r21 + a12 * r22 - my * cz
    body[9] = a20 * r20 + a21 * r21 + a22 * r22 + mx * cx + my * cy


@leaf
def _times(b, vx, vy, vz, wx, wy, wz):
    """Inertia b times a motion: momentum, or force for an acceleration."""
    x, y, z = cross(wx, wy, wz, b[1], b[2], b[3])
    k, l, n = cross(b[1], b[2], b[3], vx, vy, vz)
    return (
        b[0] * vx + x,
        b[0] * vy + y,
        b[0] * vz + z,
        b[4] * wx + b[5] * wy + b[6] * wz + k,
        b[5] * wx + b[7] * wy + b[8] * wz + l,
        b[6] * wx + b[8] * wy + b[9] * wz + n,
    )


@leaf
def _force_on(b, V, a, gravity, out):
    """out = I(a − g) + V ×* IV, what moves body b with twist V and spatial acceleration a."""
    fx, fy, fz, tx, ty, tz = _times(
        b, a[0] - gravity[0], a[1] - gravity[1], a[2] - gravity[2], a[3], a[4], a[5]
    )
    px, py, pz, lx, ly, lz = _times(b, V[0], V[1], V[2], V[3], V[4], V[5])
    x, y, z = cross(V[3], V[4], V[5], px, py, pz)
    out[0] = fx + x
    out[1] = fy + y
    out[2] = fz + z
    x, y, z = cross(V[3], V[4], V[5], lx, ly, lz)
    i, j, k = cross(V[0], V[1], V[2], px, py, pz)
    out[3] = tx + x + i
    out[4] = ty + y + j
    out[5] = tz + z + k


@leaf
def move_arm(t, arm, v, C, V, gamma, bias_out):
    """Columns of J at C, drift γ, h = C v + g, M, and what is beyond the wrist sensor.

    Args:
        arm: ARM record. v: (n,) velocities. C: (3,) common point. V, gamma: (6,)
        filled: twist and drift of the tip at C. bias_out: (6,) added to: wrench that
        the outboard bodies need at q̈ = 0, at C.
    """
    joints = t.model.joints
    work = t.work.joints
    gravity = t.model.gravity
    outer = t.work.s
    force = t.work.t
    lo = arm.first
    hi = arm.end
    sensed = arm.outer_joint
    fill(V, ZERO)
    fill(gamma, ZERO)
    for j in range(lo, hi):
        w = work[j]
        column = work[j].column
        ax = w.R[0, 2]
        ay = w.R[1, 2]
        az = w.R[2, 2]
        if joints[j].slides != 0:
            vx = ax
            vy = ay
            vz = az
            wx = 0.0
            wy = 0.0
            wz = 0.0
        else:
            vx, vy, vz = cross(w.p[0] - C[0], w.p[1] - C[1], w.p[2] - C[2], ax, ay, az)
            wx = ax
            wy = ay
            wz = az
        column[0] = vx
        column[1] = vy
        column[2] = vz
        column[3] = wx
        column[4] = wy
        column[5] = wz
        s = v[j]
        vx = s * vx
        vy = s * vy
        vz = s * vz
        wx = s * wx
        wy = s * wy
        wz = s * wz
        x, y, z = cross(V[3], V[4], V[5], vx, vy, vz)
        a, b, c = cross(V[0], V[1], V[2], wx, wy, wz)
        gamma[0] += x + a
        gamma[1] += y + b
        gamma[2] += z + c
        x, y, z = cross(V[3], V[4], V[5], wx, wy, wz)
        gamma[3] += x
        gamma[4] += y
        gamma[5] += z
        V[0] += vx
        V[1] += vy
        V[2] += vz
        V[3] += wx
        V[4] += wy
        V[5] += wz
        _place_body(w, C, joints[j].link, w.body)
        _force_on(w.body, V, gamma, gravity, w.force)
        if j == sensed:
            _place_body(w, C, arm.outer, outer)
            _force_on(outer, V, gamma, gravity, force)
            fill(bias_out, plus(bias_out, force))
    _sum_back(t, lo, hi, sensed, bias_out)


@leaf
def weight_on_joint(w, gravity):
    """Force or torque g of gravity at a joint, from what it carries, after `move_arm` (N, N m).

    Args:
        w: JOINT_WORK row. gravity: (3,) m/s².
    """
    return dot6(w.column, _times(w.body, -gravity[0], -gravity[1], -gravity[2], 0.0, 0.0, 0.0))


@leaf
def _sum_back(t, lo, hi, sensed, bias_out):
    """Forces and composite inertias from the tip back: h, M, outboard inertia times J."""
    work = t.work.joints
    outer = t.work.s
    for j in range(hi - 1, lo - 1, -1):
        w = work[j]
        if j < hi - 1:
            beyond = work[j + 1]
            if j == sensed:
                fill(bias_out, plus(bias_out, beyond.force))
                for i in range(10):
                    outer[i] += beyond.body[i]
            fill(w.force, add(six(w.force), 1.0, beyond.force))
            for i in range(10):
                w.body[i] += beyond.body[i]
        c = w.column
        w.h = dot6(c, w.force)
        momentum = _times(w.body, c[0], c[1], c[2], c[3], c[4], c[5])
        for k in range(lo, j + 1):
            m = dot6(work[k].column, momentum)
            w.M[k - lo] = m
            work[k].M[j - lo] = m
        w.M[j - lo] += t.model.joints[j].armature
        if j <= sensed:
            momentum = _times(outer, c[0], c[1], c[2], c[3], c[4], c[5])
        fill(w.outboard, momentum)
