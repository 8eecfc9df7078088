"""The force path of fig. 5: wrist readings to contact magnitudes, and the force law."""

from __future__ import annotations

from math import inf

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.layout import DRAG, DRAGS, FRICTION, KEPT, PUSHED
from osc_contact.kernels.linalg import dot6, lu_solve
from osc_contact.kernels.white import white_wrench, wrench_to

__all__ = [
    "add_wrist_reading",
    "contact_magnitudes",
    "contact_terms",
    "force_command",
    "pushing_columns",
]


@compiled
def add_wrist_reading(reading, pose, sensor, C, scratch, total):
    """Add one wrist's reading (6,), turned to world axes and carried to C.

    Args:
        pose: (12,) of the sensor's joint. sensor: (12,) rotation (row by row) and position of the
            sensor in it. scratch: (9,).
    """
    point = scratch[6:9]
    for i in range(3):
        point[i] = (
            pose[9 + i] + pose[i] * sensor[9] + pose[3 + i] * sensor[10] + pose[6 + i] * sensor[11]
        )
    for half in (0, 3):
        x, y, z = reading[half], reading[half + 1], reading[half + 2]
        a = sensor[0] * x + sensor[1] * y + sensor[2] * z
        b = sensor[3] * x + sensor[4] * y + sensor[5] * z
        c = sensor[6] * x + sensor[7] * y + sensor[8] * z
        for i in range(3):
            scratch[half + i] = pose[i] * a + pose[3 + i] * b + pose[6 + i] * c
    wrench_to(scratch[:6], point, C, scratch[:6])
    for i in range(6):
        total[i] += scratch[i]


@compiled
def pushing_columns(head, sets, axes, keep, r, count, share, O, C, scratch):
    """Drags of the kept columns, D Rᵀ at O, and N_μ = N + D Rᵀ in white coordinates."""
    drags, pushed = sets[DRAGS], sets[PUSHED]
    for a in range(r):
        drag = sets[DRAG, a]
        for i in range(6):
            drag[i] = 0.0
            pushed[a, i] = sets[KEPT, a, i]
        if head[FRICTION] == 0.0:
            continue
        for j in range(count):
            s = share[a, j] if r < count else (1.0 if j == a else 0.0)
            for i in range(6):
                drag[i] += s * drags[keep[j, 1], i]
        wrench_to(drag, O, C, scratch)
        white_wrench(axes, scratch, scratch)
        for i in range(6):
            pushed[a, i] += scratch[i]


@compiled
def contact_magnitudes(
    Lambda_out, white, pushed, r, f, n_gamma, b_N, Phi_mu, X, D, mobility, alpha
):
    """α (r,) = D⁻¹[NᵀΛ_out⁻¹f − n_γ − b_N], D = NᵀΛ_out⁻¹N_μ + Φ_μ (`control.force`).

    Args:
        Lambda_out: (6, 6) *transposed*, white; destroyed. white: (r, 6) columns of N,
            pushed: of N_μ.
        f: (6,) reading less bias, white. X: (r, 6), D: (6, 6) scratch.
        mobility: (6, 6) filled with D. alpha: (1, 6) filled.
    """
    for a in range(r):
        for i in range(6):
            X[a, i] = white[a, i]
    if not lu_solve(Lambda_out, 6, X, r):
        return False
    for a in range(r):
        for b in range(r):
            mobility[a, b] = D[a, b] = dot6(X[a], pushed[b]) + Phi_mu[a, b]
        alpha[0, a] = dot6(X[a], f) - n_gamma[a] - b_N[a]
    return lu_solve(D, r, alpha, 1)


@compiled
def force_command(r, alpha_d, alpha_meas, speed, integral, gain, damping, least, dt, after, out):
    """α_u = α_d + K_i ∫(α_d − α_meas) dt − K_v NᵀV_rel ≥ α_min; the new integral: `after`."""
    for a in range(r):
        after[a] = integral[a] + gain[a] * dt * (alpha_d[a] - alpha_meas[a])
        out[a] = alpha_d[a] + after[a] - damping[a] * speed[a]
        if out[a] < least[a]:
            out[a] = least[a]
            after[a] = max(after[a], integral[a])


@compiled
def contact_terms(laws, owners, chosen, count, keep, r, gain, damping, least):
    """Gain, damping and least command (r,) of the kept columns (`control.force.ContactTerms`).

    Args:
        laws: (contacts, 4) of each contact. owners: contact of each column.
        chosen: (count,) the columns in force. keep: (r,) the independent ones of them.
    """
    for a in range(r):
        law = laws[owners[keep[a]]]
        gain[a], damping[a], least[a] = law[1], law[2], law[3]
    if r == count:
        return
    for j in range(count):  # the most careful of all, for each of them
        law = laws[owners[chosen[j]]]
        for a in range(r):
            gain[a] = min(gain[a], law[1])
            damping[a] = max(damping[a], law[2])
    for a in range(1, r):
        gain[0], damping[0] = min(gain[0], gain[a]), max(damping[0], damping[a])
    for a in range(r):
        gain[a], damping[a], least[a] = gain[0], damping[0], -inf
