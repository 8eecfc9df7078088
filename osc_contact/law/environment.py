"""What the touched bodies do along N: Φ_μ = NᵀΦ_eN_μ, b_N = Nᵀb_e, V_N = NᵀV_e."""

from __future__ import annotations

from osc_contact.law.energy import carry_motion
from osc_contact.law.jit import inner
from osc_contact.law.six import dot6
from osc_contact.law.tables import CART, CONVEYOR, ELSEWHERE


@inner
def _answer(kind, parameters, E, O, answer, start):
    """answer (48,) = Φ_e (36), b_e and V_e (6) of one body at O.

    `parameters` of a cart: direction (0:3), mass, stiffness, damping, preload, u·g (7).
    """
    Phi = answer[:36]
    b = answer[36:42]
    V = answer[42:48]
    for i in range(36):
        Phi[i] = 0.0
    if kind == CART:
        ux = parameters[0]
        uy = parameters[1]
        uz = parameters[2]
        mass = parameters[3]
        travel = ux * E[3] + uy * E[7] + uz * E[11]
        speed = ux * E[16] + uy * E[17] + uz * E[18]
        force = parameters[6] - parameters[4] * travel - parameters[5] * speed
        rate = parameters[7] + force / mass
        for i in range(3):
            for j in range(3):
                Phi[6 * i + j] = parameters[i] * parameters[j] / mass
            b[i] = parameters[i] * rate
            b[3 + i] = 0.0
            V[i] = parameters[i] * speed
            V[3 + i] = 0.0
        return
    start[0], start[1], start[2] = E[3], E[7], E[11]
    for i in range(6):
        V[i] = E[16 + i]
        b[i] = E[22 + i] if kind == CONVEYOR else 0.0
    # the classical acceleration of E's origin made spatial
    b[0] -= V[4] * V[2] - V[5] * V[1]
    b[1] -= V[5] * V[0] - V[3] * V[2]
    b[2] -= V[3] * V[1] - V[4] * V[0]
    carry_motion(V, start, O, V)
    carry_motion(b, start, O, b)


@inner
def answer_bodies(t):
    """Φ_e, b_e and V_e at O (3,) of every touched body."""
    table = t.model.bodies
    for c in range(t.model.n_contacts):
        if table[c].same == c and table[c].kind != ELSEWHERE:
            _answer(
                table[c].kind,
                table[c].parameters,
                t.input.touched[c],
                t.work.O,
                t.work.bodies[c].answer,
                t.work.u,
            )


@inner
def still_bodies(t):
    """The same for bodies that rest in the world."""
    work = t.work
    for a in range(work.rank):
        work.b_N[a] = work.V_N[a] = 0.0
        for b in range(work.rank):
            work.Phi_mu[a, b] = 0.0


@inner
def project_bodies(t):
    """Fill Φ_μ (r, r), b_N and V_N (r,) for the kept columns."""
    columns = t.work.columns
    table = t.model.columns
    bodies = t.model.bodies
    work = t.work
    given = work.y
    for a in range(work.rank):
        mine = columns[int(work.keep[a])].chosen
        N = columns[mine].N
        body = bodies[table[mine].contact].same
        answer = t.work.bodies[body].answer
        work.b_N[a] = dot6(N, answer[36:42])
        work.V_N[a] = dot6(N, answer[42:48])
        for j in range(6):
            s = 0.0
            for i in range(6):
                s += N[i] * answer[6 * i + j]
            given[j] = work.yields[a, j] = s
        for b in range(work.rank):
            work.Phi_mu[a, b] = 0.0
            other = columns[int(work.keep[b])].chosen
            if bodies[table[other].contact].same == body:
                for i in range(6):
                    work.Phi_mu[a, b] += given[i] * (
                        columns[other].N[i] + work.friction_wrenches[b, i]
                    )
