"""Recursive kinematics and dynamics of one arm: Jacobian, drift, joint forces and inertia.

All quantities are in world axes about one common point C, the object's centre of mass. Joints
rotate about, or slide along, the z axis of their frame.
"""

from __future__ import annotations

from math import cos, sin

from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.records import FAULTY_SPEED
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    add3,
    angular,
    cross,
    cross_motion,
    dot3,
    dot6,
    fill,
    fill3,
    join,
    linear,
    minus3,
    plus,
    plus3,
    rotated,
    rotated9,
    rotated9_back,
    scaled,
    scaled3,
    six,
    transformed,
)


@leaf
def place_point(joint, x):
    """World position (three numbers, m) of a point x (m) in the frame of a joint (JOINT_WORK)."""
    return transformed(joint.p, joint.R, x)


@inner
def place_frame(joint, X, R, p):
    """Transform a frame that is fixed to a joint to the world.

    Args:
        joint: JOINT_WORK row.
        X: (12,) frame in the joint: rotation by rows, then origin (m).
        R: (3, 3), filled with the frame's axes in the world.
        p: (3,), filled with its origin (m).
    """
    turn_axes(joint.R, X, R)
    fill3(p, place_point(joint, X[9:]))


@inner
def place_pose(joint, X, pose):
    """Transform a frame that is fixed to a joint to the world, as a pose.

    Args:
        joint: JOINT_WORK row.
        X: (12,) frame in the joint: rotation by rows, then origin (m).
        pose: (4, 4), filled with the pose of the frame in the world: axes as columns of its first
            3×3 block, origin (m) in the last column, and a last row of 0, 0, 0, 1.
    """
    p = local(3)
    place_frame(joint, X, pose, p)
    for i in range(3):
        pose[i, 3] = p[i]
        pose[3, i] = 0.0
    pose[3, 3] = 1.0


@leaf
def turn_axes(R, rotation, out):
    """Multiply two rotations, the second given by rows, and write the product to `out`.

    Args:
        R: rotation matrix or pose, at least 3×3.
        rotation: rotation by rows in its first nine elements.
        out: at least 3×3, filled.
    """
    turn = join(six(rotation), linear(rotation[6:]))
    for i in range(3):
        fill3(out[i], rotated9_back(turn, (R[i, 0], R[i, 1], R[i, 2])))


@leaf
def place_arm(t, arm, q):
    """Fill axes R (3, 3) and origin p (3,; m, world) of every joint of an arm, from its base on.

    The frame of a joint is `placement` in the frame of the joint before it (of the first joint in
    the world), then turned about its own z axis by the joint's angle or, of a prismatic joint,
    shifted along it.

    Args:
        t: Tick.
        arm: ARM row.
        q: positions (m, rad) of the joints of all arms.
    """
    joints = t.model.joints
    work = t.work.joints
    for j in range(arm.first, arm.end):
        X = joints[j].placement
        R = work[j].R
        p = work[j].p
        if j == arm.first:
            for i in range(3):
                fill3(R[i], X[3 * i :])
            fill3(p, X[9:])
        else:
            place_frame(work[j - 1], X, R, p)
        angle = 0.0 if joints[j].slides else q[j]
        c = cos(angle)
        s = sin(angle)
        for i in range(3):  # columns x and y of R, turned about z by the angle
            a = R[i, 0]
            b = R[i, 1]
            R[i, 0] = c * a + s * b
            R[i, 1] = c * b - s * a
            p[i] += (q[j] - angle) * R[i, 2]  # 0 for a revolute joint, whose angle is q


@leaf
def _place_body(w, C, link, body):
    """Transform the inertia of a body that is fixed to a joint to world axes about C.

    Args:
        w: JOINT_WORK row, of which axes R and origin p in the world are read.
        C: (3,) point (m).
        link: (13,) mass (kg), centre in the joint (m), rotational inertia about the centre by rows
            (kg m²).
        body: (13,), filled with mass, mass × centre from C, rotational inertia about C by rows.
    """
    R = w.R
    m = link[0]
    c = minus3(place_point(w, link[1:]), C)
    body[0] = m
    fill3(body[1:], scaled3(m, c))
    for i in range(3):
        row = rotated(R, rotated9(link[4:], R[i]))  # row i of R I Rᵀ
        # parallel axes: R I Rᵀ − m c cᵀ + m cᵀc 1, by rows behind the first four elements
        fill3(body[4 + 3 * i :], add3(row, -body[1 + i], c))
        body[4 + 4 * i] += m * dot3(c, c)


@leaf
def _times(b, x):
    """Multiply the inertia of a body with a motion x.

    The result is the momentum of a twist, or the wrench that causes an acceleration.

    Args:
        b: (13,) mass (kg), mass × centre of mass (kg m), inertia about C by rows (kg m²).
        x: (6,) motion at C, in world axes.

    Returns:
        Six numbers at C, in world axes.
    """
    force = plus3(scaled3(b[0], x), cross(x[3:], b[1:]))
    return join(force, plus3(rotated9(b[4:], x[3:]), cross(b[1:], x)))


@leaf
def _force_on(b, V, a, gravity):
    """Compute the wrench I(a − g) + V ×* IV (six numbers, at C) that moves a body.

    I (6, 6) is its inertia about C, and V ×* the spatial cross product for wrenches.

    Args:
        b: (13,) mass (kg), mass × centre of mass (kg m), inertia about C by rows (kg m²).
        V: (6,) twist at C (m/s, rad/s).
        a: (6,) spatial acceleration at C (m/s², rad/s²).
        gravity: (3,) g (m/s²).
    """
    f = _times(b, join(minus3(a, gravity), angular(a)))
    p = _times(b, V)  # momentum
    force = plus3(f, cross(V[3:], p))
    return join(force, plus3(plus3(f[3:], cross(V[3:], p[3:])), cross(V, p)))


@leaf
def move_arm(t, arm, v, C, V, gamma, bias_out):
    """Compute Jacobian, drift, bias torques and inertia of an arm, and its outboard wrenches.

    Outboard are the bodies beyond the wrist sensor: a part of the link `outer_joint` (`outer`), and
    all links beyond it.

    Reads R and p of the joints. Fills of each joint `column` (its column of the Jacobian J at C,
    world axes), `h` (C v + g: torque of velocities and gravity; N m, N), `M` (its row of the
    joint-space inertia), `force` and `body` (wrench at q̈ = 0 and inertia of all links that it
    carries, at C), and `outboard`, the wrench at C of the outboard bodies per unit of the joint's
    acceleration.

    Args:
        t: Tick.
        arm: ARM row.
        v: velocities (rad/s, m/s) of the joints of all arms.
        C: (3,) common point (m).
        V: (6,), filled with the twist of the tip at C.
        gamma: (6,), filled with its drift γ, the acceleration at q̈ = 0, at C (m/s², rad/s²).
        bias_out: (6,), to which the wrench of the outboard bodies at q̈ = 0 is added, at C.
    """
    joints = t.model.joints
    gravity = t.model.gravity
    work = t.work.joints
    outer_body = local(13)
    fill(V, ZERO)
    fill(gamma, ZERO)
    # from the base: Jacobian, twist and drift, and the wrench that moves each link at q̈ = 0
    for j in range(arm.first, arm.end):
        w = work[j]
        axis = (w.R[0, 2], w.R[1, 2], w.R[2, 2])  # z axis of the joint
        turning = join(cross(minus3(w.p, C), axis), axis)
        column = join(axis, ZERO_3) if joints[j].slides else turning
        fill(w.column, column)
        motion = scaled(v[j], column)  # part of the twist by this joint
        fill(gamma, plus(gamma, cross_motion(V, motion)))
        fill(V, plus(V, motion))
        _place_body(w, C, joints[j].link, w.body)
        fill(w.force, _force_on(w.body, V, gamma, gravity))
        if j == arm.outer_joint:
            _place_body(w, C, arm.outer, outer_body)
            fill(bias_out, plus(bias_out, _force_on(outer_body, V, gamma, gravity)))
    _sum_from_tip(t, arm, outer_body, bias_out)


@leaf
def _sum_from_tip(t, arm, outer_body, bias_out):
    """Sum wrenches and inertias of the links from the tip of an arm; fill h, M and `outboard`.

        h_j = column_jᵀ force_j,   M_jk = column_kᵀ I_j column_j

    force_j (6,) is the wrench that moves all links that joint j carries at q̈ = 0, and I_j their
    inertia, at the common point C. Fills of the joints `force` and `body` (these sums), `h` (N m,
    N), `M` (with the inertia of rotors on its diagonal), and `outboard`, the wrench of the bodies
    beyond the wrist sensor per unit of the joint's acceleration. M is without the identified rotor
    of a joint whose speed is faulty: the gain of its brake must not be too large for the speed that
    is estimated from positions in place of it.

    Args:
        t: Tick, with `column`, and `force` and `body` of its own link in each joint.
        arm: ARM row.
        outer_body: (13,) inertia of the part of the link `outer_joint` beyond the sensor; becomes
            that of all bodies beyond it.
        bias_out: (6,), to which the wrench of the links beyond `outer_joint` is added.
    """
    joints = t.model.joints
    work = t.work.joints
    for j in range(arm.end - 1, arm.first - 1, -1):
        w = work[j]
        if j < arm.end - 1:
            next_joint = work[j + 1]
            if j == arm.outer_joint:
                fill(bias_out, plus(bias_out, next_joint.force))
                for i in range(13):
                    outer_body[i] += next_joint.body[i]
            fill(w.force, plus(w.force, next_joint.force))
            for i in range(13):
                w.body[i] += next_joint.body[i]
        w.h = dot6(w.column, w.force)
        momentum = _times(w.body, w.column)
        for k in range(arm.first, j + 1):
            m = dot6(work[k].column, momentum)
            w.M[k - arm.first] = m
            work[k].M[j - arm.first] = m
        memory_row = t.memory.joints[j]
        is_sound = memory_row.faulty & FAULTY_SPEED == 0
        w.M[j - arm.first] += joints[j].armature + (memory_row.rotor if is_sound else 0.0)
        if j <= arm.outer_joint:  # it moves all outboard bodies, else only those beyond itself
            momentum = _times(outer_body, w.column)
        fill(w.outboard, momentum)


@leaf
def weight_on_joint(w, gravity):
    """Force or torque (N, N m) at a joint by gravity on the bodies beyond it.

    Args:
        w: JOINT_WORK row after `move_arm`.
        gravity: (3,) m/s².
    """
    return dot6(w.column, _times(w.body, join(scaled3(-1.0, gravity), ZERO_3)))
