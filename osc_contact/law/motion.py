"""The motion law: pose error, PID, and the classical acceleration made spatial."""

from __future__ import annotations

from math import atan2, copysign, sqrt

from osc_contact.law.algebra import cross
from osc_contact.law.jit import inner, leaf


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
