"""Least weighted torque that gives the object force and the squeeze (`control.allocation`)."""

from __future__ import annotations

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.linalg import cholesky, cholesky_solve, dot6, invert_spd6

__all__ = ["arm_torques", "effort_metric", "hold_posture", "multipliers"]

_DRIVEN = 1e-13


@compiled
def effort_metric(lo, n, J, bar, joints, L, X, out):
    """(6, 6) least effort per wrench: J̄ᵀ τ_max² J̄, or (J τ_max⁻² Jᵀ)⁻¹ for more than six joints."""
    if n <= 6:
        for a in range(6):
            for b in range(a + 1):
                s = 0.0
                for j in range(lo, lo + n):
                    s += joints[j, 20] * bar[j, a] * bar[j, b]
                out[a, b] = s
                out[b, a] = s
        return True
    for a in range(6):
        for b in range(a + 1):
            s = 0.0
            for j in range(lo, lo + n):
                s += joints[j, 21] * J[j, a] * J[j, b]
            X[a, b] = s
    return invert_spd6(X, L, out) > 1e-14


@compiled
def multipliers(effort, m, two, skewed, own, f_S, e0, gram, L, z):
    """Solve for z: elements m … 5 belong to f_S, element 6 to the squeeze.

    Args:
        effort: (6, 6) sum over the arms, turned. two: a squeeze row exists.
        skewed: (6,) ½(Q₁ − Q₂) line (the grasp line, white, turned). own: ¼ lineᵀ(Q₁ + Q₂) line.
        f_S: (6,). e0: squeeze wanted and offset. gram, L: (7, 7) scratch. z: (7,) filled.
    """
    d = 6 - m
    size = d
    for i in range(d):
        for j in range(i + 1):
            gram[i, j] = effort[m + i, m + j]
        z[m + i] = f_S[m + i]
    if two:
        for j in range(d):
            gram[d, j] = skewed[m + j]
        gram[d, d] = own
        z[6] = e0
        size = d + 1
    if not cholesky(gram, 0, size, L) > _DRIVEN:
        return False
    cholesky_solve(L, size, z, m)  # elements m … 6 lie side by side
    return True


@compiled
def arm_torques(lo, n, wide, J, bar, joints, effort, y, scratch, tau):
    """τ += what the arm must do for the wrench-like y (6,), white: R⁻¹ J̄ y."""
    if not wide:
        for j in range(lo, lo + n):
            tau[j] += joints[j, 20] * dot6(bar[j], y)
        return
    for i in range(6):
        scratch[i] = dot6(effort[i], y)
    for j in range(lo, lo + n):
        tau[j] += dot6(J[j], scratch)


@compiled
def _push(joint, q):
    """Acceleration away from joint limits, see `control.joint_limits`."""
    low, high, width, most = joint[23], joint[24], joint[25], joint[26]
    depth, sign = (low - q, 1.0) if q < low else (q - high, -1.0)
    if not depth > 0.0:
        return 0.0
    s = min(depth / width, 1.0)
    return sign * most * s * s * (3.0 - 2.0 * s)


@compiled
def hold_posture(lo, n, M, J, bar, joints, h, q, v, stiffness, damping, scratch, tau):
    """τ = (1 − JᵀJ̄ᵀ)τ₀, τ₀ = h + M(−k_d q̇ + k_p(q₀ − q)) + diag(M) a_l(q)."""
    for i in range(6):
        scratch[i] = 0.0
    for j in range(lo, lo + n):
        s = h[j] + M[j, j] * _push(joints[j], q[j])
        for k in range(lo, lo + n):
            s += M[j, k] * (stiffness * (joints[k, 22] - q[k]) - damping * v[k])
        tau[j] = s
        for i in range(6):
            scratch[i] += bar[j, i] * s
    for j in range(lo, lo + n):
        tau[j] -= dot6(J[j], scratch)
