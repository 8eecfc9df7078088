"""Rigid bodies at a common point, and the recursion that gives an arm's joint forces."""

from __future__ import annotations

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.linalg import cross, dot6

__all__ = ["arm_motion"]


@compiled
def _place(pose, joint, C, table, row, start, body):
    """Body `table[row, start:]` (mass, lever, inertia at its centre; joint axes) in the world at C.

    Written to `body`: mass, mass × centre (3), rotational inertia about C (xx, xy, xz, yy, yz, zz).
    """
    r00, r10, r20 = pose[joint, 0], pose[joint, 1], pose[joint, 2]
    r01, r11, r21 = pose[joint, 3], pose[joint, 4], pose[joint, 5]
    r02, r12, r22 = pose[joint, 6], pose[joint, 7], pose[joint, 8]
    m = table[row, start]
    x, y, z = table[row, start + 1], table[row, start + 2], table[row, start + 3]
    cx = r00 * x + r01 * y + r02 * z + pose[joint, 9] - C[0]
    cy = r10 * x + r11 * y + r12 * z + pose[joint, 10] - C[1]
    cz = r20 * x + r21 * y + r22 * z + pose[joint, 11] - C[2]
    xx, xy, xz = table[row, start + 4], table[row, start + 5], table[row, start + 6]
    yy, yz, zz = table[row, start + 7], table[row, start + 8], table[row, start + 9]
    a00 = r00 * xx + r01 * xy + r02 * xz
    a01 = r00 * xy + r01 * yy + r02 * yz
    a02 = r00 * xz + r01 * yz + r02 * zz
    a10 = r10 * xx + r11 * xy + r12 * xz
    a11 = r10 * xy + r11 * yy + r12 * yz
    a12 = r10 * xz + r11 * yz + r12 * zz
    a20 = r20 * xx + r21 * xy + r22 * xz
    a21 = r20 * xy + r21 * yy + r22 * yz
    a22 = r20 * xz + r21 * yz + r22 * zz
    mx, my, mz = m * cx, m * cy, m * cz
    body[0], body[1], body[2], body[3] = m, mx, my, mz
    body[4] = a00 * r00 + a01 * r01 + a02 * r02 + my * cy + mz * cz
    body[5] = a00 * r10 + a01 * r11 + a02 * r12 - mx * cy
    body[6] = a00 * r20 + a01 * r21 + a02 * r22 - mx * cz
    body[7] = a10 * r10 + a11 * r11 + a12 * r12 + mx * cx + mz * cz
    body[8] = a10 * r20 + a11 * r21 + a12 * r22 - my * cz
    body[9] = a20 * r20 + a21 * r21 + a22 * r22 + mx * cx + my * cy


@compiled
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


@compiled
def _force_on(b, V, a, gravity, out):
    """out = I(a − g) + V ×* IV, what moves body b with twist V and spatial acceleration a."""
    fx, fy, fz, tx, ty, tz = _times(
        b, a[0] - gravity[0], a[1] - gravity[1], a[2] - gravity[2], a[3], a[4], a[5]
    )
    px, py, pz, lx, ly, lz = _times(b, V[0], V[1], V[2], V[3], V[4], V[5])
    x, y, z = cross(V[3], V[4], V[5], px, py, pz)
    out[0], out[1], out[2] = fx + x, fy + y, fz + z
    x, y, z = cross(V[3], V[4], V[5], lx, ly, lz)
    i, j, k = cross(V[0], V[1], V[2], px, py, pz)
    out[3], out[4], out[5] = tx + x + i, ty + y + j, tz + z + k


@compiled
def arm_motion(
    lo, hi, v, J, pose, joints, kinds, C, gravity,
    columns, forces, outboard, bodies, h, V, gamma, bias_out,
):  # fmt: skip
    """One arm, base to tip and back: Jacobian, drift, joint forces, what is outboard of the wrist.

    Args:
        lo, hi: the arm's joints. v: (n,) velocities. J: (n, 6) columns at the world origin.
        pose: (n + 1, 12) joint placements, rotation column by column, then position.
        joints: (n, 20…) bodies: the whole link, then its part outboard of the wrist sensor.
        kinds: (n, …) 0: nothing of the link is outboard, 1: all of it, 2: the second body.
        C: (3,) common point. gravity: (3,).
        columns, forces, outboard: (n, 6) filled: J at C, force on each link, outboard inertia
            times J column. bodies: (n + 1, 10) scratch. h: (n,) filled: nonlinear effects C v + g.
        V, gamma: (6,) filled: twist and drift of the tip at C.
        bias_out: (6,) added to: wrench that the outboard bodies need at q̈ = 0, at C.
    """
    for i in range(6):
        V[i] = 0.0
        gamma[i] = 0.0
    for j in range(lo, hi):
        wx, wy, wz = J[j, 3], J[j, 4], J[j, 5]
        x, y, z = cross(wx, wy, wz, C[0], C[1], C[2])
        vx, vy, vz = J[j, 0] + x, J[j, 1] + y, J[j, 2] + z
        columns[j, 0], columns[j, 1], columns[j, 2] = vx, vy, vz
        columns[j, 3], columns[j, 4], columns[j, 5] = wx, wy, wz
        s = v[j]
        vx, vy, vz, wx, wy, wz = s * vx, s * vy, s * vz, s * wx, s * wy, s * wz
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
        _place(pose, j + 1, C, joints, j, 0, bodies[j])
        _force_on(bodies[j], V, gamma, gravity, forces[j])
        if kinds[j, 0] == 1:
            for i in range(6):
                bias_out[i] += forces[j, i]
        elif kinds[j, 0] == 2:
            part = bodies[bodies.shape[0] - 1]
            _place(pose, j + 1, C, joints, j, 10, part)
            _force_on(part, V, gamma, gravity, outboard[j])
            for i in range(6):
                bias_out[i] += outboard[j, i]
    _joint_forces(lo, hi, kinds, columns, forces, outboard, bodies, h)


@compiled
def _joint_forces(lo, hi, kinds, columns, forces, outboard, bodies, h):
    """h_j = J_jᵀ Σ forces beyond joint j, and the same sum of outboard inertias times J_j."""
    last = bodies.shape[0] - 1
    for j in range(hi - 2, lo - 1, -1):
        for i in range(6):
            forces[j, i] += forces[j + 1, i]
    beyond = False
    for j in range(hi - 1, lo - 1, -1):
        h[j] = dot6(columns[j], forces[j])
        if kinds[j, 0] == 2:  # the part is in the last row: of all joints only one has a part
            for i in range(10):
                bodies[j, i] = bodies[last, i]
        if kinds[j, 0] != 0 and beyond:
            for i in range(10):
                bodies[j, i] += bodies[j + 1, i]
        elif beyond:
            for i in range(10):
                bodies[j, i] = bodies[j + 1, i]
        beyond = beyond or kinds[j, 0] != 0
        if beyond:
            c = columns[j]
            (
                outboard[j, 0],
                outboard[j, 1],
                outboard[j, 2],
                outboard[j, 3],
                outboard[j, 4],
                outboard[j, 5],
            ) = _times(bodies[j], c[0], c[1], c[2], c[3], c[4], c[5])
