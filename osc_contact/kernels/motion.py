"""The motion law: pose error, PID, and the classical acceleration made spatial."""

from __future__ import annotations

from math import atan2, copysign, sqrt

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.linalg import cross

__all__ = ["motion_command", "pose_error"]


@compiled
def pose_error(X_WD, X_WO, out):
    """[p_D − p_O; log₃(R_D R_Oᵀ)] of two (4, 4) poses."""
    for i in range(3):
        out[i] = X_WD[i, 3] - X_WO[i, 3]
    r00 = X_WD[0, 0] * X_WO[0, 0] + X_WD[0, 1] * X_WO[0, 1] + X_WD[0, 2] * X_WO[0, 2]
    r01 = X_WD[0, 0] * X_WO[1, 0] + X_WD[0, 1] * X_WO[1, 1] + X_WD[0, 2] * X_WO[1, 2]
    r02 = X_WD[0, 0] * X_WO[2, 0] + X_WD[0, 1] * X_WO[2, 1] + X_WD[0, 2] * X_WO[2, 2]
    r10 = X_WD[1, 0] * X_WO[0, 0] + X_WD[1, 1] * X_WO[0, 1] + X_WD[1, 2] * X_WO[0, 2]
    r11 = X_WD[1, 0] * X_WO[1, 0] + X_WD[1, 1] * X_WO[1, 1] + X_WD[1, 2] * X_WO[1, 2]
    r12 = X_WD[1, 0] * X_WO[2, 0] + X_WD[1, 1] * X_WO[2, 1] + X_WD[1, 2] * X_WO[2, 2]
    r20 = X_WD[2, 0] * X_WO[0, 0] + X_WD[2, 1] * X_WO[0, 1] + X_WD[2, 2] * X_WO[0, 2]
    r21 = X_WD[2, 0] * X_WO[1, 0] + X_WD[2, 1] * X_WO[1, 1] + X_WD[2, 2] * X_WO[1, 2]
    r22 = X_WD[2, 0] * X_WO[2, 0] + X_WD[2, 1] * X_WO[2, 1] + X_WD[2, 2] * X_WO[2, 2]
    x, y, z = 0.5 * (r21 - r12), 0.5 * (r02 - r20), 0.5 * (r10 - r01)
    sine = sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (r00 + r11 + r22 - 1.0)
    angle = atan2(sine, cosine)
    if cosine > -0.99:
        scale = angle / sine if sine > 1e-6 else 1.0 + sine * sine / 6.0
        out[3], out[4], out[5] = scale * x, scale * y, scale * z
        return
    # near a half turn the axis comes from the symmetric part, (1 − cos) aaᵀ + cos 1
    share = 1.0 / (1.0 - cosine)
    out[3] = copysign(angle * sqrt(max((r00 - cosine) * share, 0.0)), x)
    out[4] = copysign(angle * sqrt(max((r11 - cosine) * share, 0.0)), y)
    out[5] = copysign(angle * sqrt(max((r22 - cosine) * share, 0.0)), z)


@compiled
def motion_command(error, integral, V_D, A_D, V_O, stiffness, damping, gain, a_u):
    """a_u (6,) at O: p̈_d + K_d ė + K_p e + K_i ∫e, less ω × v."""
    for i in range(6):
        a_u[i] = A_D[i] + damping * (V_D[i] - V_O[i]) + stiffness * error[i] + gain * integral[i]
    x, y, z = cross(V_O[3], V_O[4], V_O[5], V_O[0], V_O[1], V_O[2])
    a_u[0] -= x
    a_u[1] -= y
    a_u[2] -= z
