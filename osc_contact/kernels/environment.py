"""What the touched bodies do along N: Φ_N = NᵀΦ_eN, Φ_μ = NᵀΦ_eN_μ, b_N = Nᵀb_e, V_N = NᵀV_e."""

from __future__ import annotations

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.layout import CART, CONVEYOR, ELSEWHERE
from osc_contact.kernels.linalg import dot6
from osc_contact.kernels.white import motion_to

__all__ = ["along_normals"]


@compiled
def _answer(kind, parameters, E, O, Phi, b, V):
    """Φ_e (36,), b_e and V_e (6,) of one body at O.

    `parameters` of a cart: direction (0:3), mass, stiffness, damping, preload, u·g (7).
    """
    for i in range(36):
        Phi[i] = 0.0
    if kind == CART:
        ux, uy, uz, mass = parameters[0], parameters[1], parameters[2], parameters[3]
        travel = ux * E[3] + uy * E[7] + uz * E[11]
        speed = ux * E[16] + uy * E[17] + uz * E[18]
        force = parameters[6] - parameters[4] * travel - parameters[5] * speed
        rate = parameters[7] + force / mass
        for i in range(3):
            for j in range(3):
                Phi[6 * i + j] = parameters[i] * parameters[j] / mass
            b[i], b[3 + i] = parameters[i] * rate, 0.0
            V[i], V[3 + i] = parameters[i] * speed, 0.0
        return
    start = E[3], E[7], E[11]
    for i in range(6):
        V[i] = E[16 + i]
        b[i] = E[22 + i] if kind == CONVEYOR else 0.0
    # the classical acceleration of E's origin made spatial
    b[0] -= V[4] * V[2] - V[5] * V[1]
    b[1] -= V[5] * V[0] - V[3] * V[2]
    b[2] -= V[3] * V[1] - V[4] * V[0]
    motion_to(V, start, O, V)
    motion_to(b, start, O, b)


@compiled
def along_normals(
    N, keep, r, drag, owners, kinds, same, parameters, bodies, contacts, O, answers, given,
    Phi_N, Phi_mu, b_N, V_N,
):  # fmt: skip
    """Fill Φ_N, Φ_μ (6, 6), b_N and V_N (6,) for the kept columns.

    Args:
        N: (r_all, 6) at O. keep: (r,). drag: (r, 6) N_μ − N at O.
        owners: (r_all,) contact of each column.
        kinds: (contacts,) of the bodies. same: (contacts,) the first
            contact on the same body, whose motion counts.
        parameters: (contacts, 48), see `_answer`; ELSEWHERE: Φ_e (36), b_e, V_e at O.
        bodies: (contacts, 28) X_WE, V_E, A_E. O: (3,).
        answers: (contacts, 48), given: (6,) scratch.
    """
    for c in range(contacts):
        if same[c] != c:
            continue
        if kinds[c] == ELSEWHERE:
            for i in range(48):
                answers[c, i] = parameters[c, i]
        else:
            a = answers[c]
            _answer(kinds[c], parameters[c], bodies[c], O, a[:36], a[36:42], a[42:48])
    for a in range(r):
        n, mine = N[keep[a]], same[owners[keep[a]]]
        b_N[a] = dot6(n, answers[mine, 36:42])
        V_N[a] = dot6(n, answers[mine, 42:48])
        for j in range(6):
            s = 0.0
            for i in range(6):
                s += n[i] * answers[mine, 6 * i + j]
            given[j] = s
        for b in range(r):
            Phi_N[a, b] = Phi_mu[a, b] = 0.0
            if same[owners[keep[b]]] == mine:
                Phi_N[a, b] = dot6(given, N[keep[b]])
                Phi_mu[a, b] = Phi_N[a, b] + dot6(given, drag[b])
