"""Columns of N in force, their dependence, and how the touched bodies answer along them."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import dot, lu_solve, orthonormalise, solve_lower_transposed
from osc_contact.law.jit import inner
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import CART, CONVEYOR, ELSEWHERE, body_of, column_of, contact_of
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    carry_motion,
    cross,
    dot3,
    dot6,
    fill,
    fill3,
    linear,
    minus3,
    plus,
    scaled3,
    wrench_to_energy,
)

CONTRADICTION = declare_reason(
    "CONTRADICTION",
    6,
    "{column_contact}: singular at this instant. Its force depends on those of other contacts, "
    "but the acceleration that keeps it does not: column {column} needs n_γ = {n_gamma:.6g}, "
    "the others imply {amount:.6g}. Drop one of these contacts, or move through this pose "
    "slower or with the others released",
)
DIFFERENT_BODIES = declare_reason(
    "DIFFERENT_BODIES",
    7,
    "dependent contacts on different bodies: how their force is split decides how the bodies "
    "move, and no equation determines the split. Put them on one body, or drop one of them",
)

# --- Which columns of N count, which are independent, how the others follow -----------------------

#: A column of unit size with less than this outside the others depends on them.
DEPENDENT = 3e-7
_PIVOT = 0.3
_CONSISTENT = 1e-5
_STILL = 1e-9  # rounding error of n_γ when the bodies hardly move (m/s², rad/s²)


@inner
def choose_columns(t):
    """List the columns of N whose contacts are in force; their number goes to `count`."""
    t.work.count = 0
    for j in range(t.model.n_columns):
        if contact_of(t, j).active != 0:
            t.work.columns[t.work.count].chosen = j
            t.work.count += 1


@inner
def keep_columns(t):
    """N (r, 6) of the independent columns in energy coordinates, N_μ, n_γ; returns a reason.

    Fills rank, keep, N, pushed, friction_wrenches, n_gamma; `share` of each column in force where
    r < count.
    """
    work = t.work
    columns = work.columns
    count = work.count
    for j in range(count):
        column = columns[j]
        whole = columns[column.chosen]
        fill(column.energy, wrench_to_energy(work, whole.N))
        column.n_gamma = whole.n_gamma_all
        column.extent = sqrt(dot6(column.energy, column.energy))
        if j < 6:
            fill(work.N[j], column.energy)
            work.keep[j] = float(j)
    work.rank = count
    if count > 6 or (
        count > 1 and not orthonormalise(work.N, count, 0, work.Q, work.L) > 10.0 * DEPENDENT
    ):
        reason = _reduce(t)
        if reason != NO_REASON:
            return reason
    for a in range(work.rank):
        column = columns[int(work.keep[a])]
        work.n_gamma[a] = column.n_gamma
        fill(work.N[a], column.energy)
    if work.rank < count or count == 1:
        orthonormalise(work.N, work.rank, 0, work.Q, work.L)
    return NO_REASON


@inner
def _reduce(t):
    """Keep a well-conditioned subset: the first column whose rest is not much below the largest."""
    work = t.work
    columns = work.columns
    rank = 0
    for j in range(work.count):
        for i in range(6):
            columns[j].rest[i] = columns[j].energy[i] / columns[j].extent
    while rank < work.count:
        longest = 0.0
        for j in range(work.count):
            longest = max(longest, dot6(columns[j].rest, columns[j].rest))
        if sqrt(longest) <= DEPENDENT or rank == 6:
            break
        first = 0
        while not dot6(columns[first].rest, columns[first].rest) >= _PIVOT * _PIVOT * longest:
            first += 1
        at = rank
        while at > 0 and work.keep[at - 1] > first:
            work.keep[at] = work.keep[at - 1]
            at -= 1
        work.keep[at] = float(first)
        rank += 1
        _remove(t, first)
    work.rank = rank
    if rank == work.count:
        return NO_REASON
    _express(t)
    if not _consistent(t):
        return CONTRADICTION
    return _same_body(t)


@inner
def _remove(t, first):
    """Take the direction of column `first` out of every rest, twice."""
    columns = t.work.columns
    q = columns[first].rest
    length = sqrt(dot6(q, q))
    for j in range(t.work.count):
        x = columns[j].rest
        for _ in range(2 if j != first else 0):
            accumulate(x, -(dot6(q, x) / (length * length)), q)
    fill(q, ZERO)


@inner
def _express(t):
    """share (rank,) of every column in force: N_all = N share."""
    work = t.work
    columns = work.columns
    rank = work.rank
    for a in range(rank):
        column = columns[int(work.keep[a])]
        for i in range(6):
            work.A[a, i] = column.energy[i] / column.extent
    orthonormalise(work.A, rank, 0, work.Q, work.L)
    for j in range(work.count):
        column = columns[j]
        for a in range(rank):
            column.share[a] = dot6(work.Q[a], column.energy)
        solve_lower_transposed(work.L, rank, column.share)
        for a in range(rank):
            column.share[a] /= columns[int(work.keep[a])].extent
    for a in range(rank):
        share = columns[int(work.keep[a])].share
        fill(share, ZERO)
        share[a] = 1.0


@inner
def _consistent(t):
    """n_γ of every column follows from the kept ones as the column does, but for rounding."""
    work = t.work
    columns = work.columns
    largest = 0.0
    for j in range(work.count):
        column = columns[j]
        summands = abs(column.n_gamma)
        for a in range(work.rank):
            summands += abs(columns[int(work.keep[a])].n_gamma * column.share[a])
        largest = max(largest, summands / column.extent)
    for j in range(work.count):
        column = columns[j]
        implied = 0.0
        for a in range(work.rank):
            implied += columns[int(work.keep[a])].n_gamma * column.share[a]
        if abs(column.n_gamma - implied) > max(_STILL, _CONSISTENT * column.extent * largest):
            work.where = column.chosen
            work.amount = implied
            return False
    return True


@inner
def _same_body(t):
    """Dependent columns must be on one body, or on bodies that move as one and do not yield."""
    work = t.work
    first = body_of(t, work.columns[0].chosen).same
    for j in range(1, work.count):
        other = body_of(t, work.columns[j].chosen).same
        for i in range(48 if other != first else 0):
            a = work.bodies[first].answer[i]
            b = work.bodies[other].answer[i]
            if a != b or (i < 36 and a != 0.0):
                return DIFFERENT_BODIES
    return NO_REASON


@inner
def spread_magnitudes(t, alpha, speed):
    """Measured magnitudes and speeds of the kept columns, to all columns in force.

    Where columns depend on others that is the split with the least sum of squares.

    Args:
        alpha, speed: (r_all,) for all columns (N, m/s).
    """
    work = t.work
    columns = work.columns
    r = work.rank
    G = work.D
    x = work.E
    dependent = r < work.count
    if dependent:  # α_all = Rᵀ(RRᵀ)⁻¹α and Rᵀ speed, R the shares
        square_shares(work, G)
        for a in range(r):
            x[0, a] = work.alpha_meas[a]
        lu_solve(G, r, x, 1)
    for j in range(work.count):
        own = columns[j]
        alpha[own.chosen] = dot(own.share, x[0], r) if dependent else work.alpha_meas[j]
        speed[own.chosen] = dot(own.share, work.speed, r) if dependent else work.speed[j]


@inner
def square_shares(work, out):
    """RRᵀ (r, r) of the shares R that columns in force have in the kept ones.

    Args:
        out: (6, 6) to be filled.
    """
    out[:] = 0.0
    for j in range(work.count):
        share = work.columns[j].share
        for a in range(work.rank):
            for b in range(work.rank):
                out[a, b] += share[a] * share[b]


# --- What the touched bodies do along N: Φ_μ = NᵀΦ_eN_μ, b_N = Nᵀb_e, V_N = NᵀV_e -----------------


@inner
def _answer(kind, parameters, E, O, answer):
    """answer (48,) = Φ_e (36), b_e and V_e (6) of one body at O.

    `parameters` of a cart: direction (0:3), mass, stiffness, damping, preload, u·g (7).
    """
    Phi = answer[:36]
    b = answer[36:42]
    V = answer[42:48]
    start = (E[3], E[7], E[11])
    Phi[:] = 0.0
    if kind == CART:
        u = linear(parameters)
        mass = parameters[3]
        speed = dot3(u, E[16:])
        force = parameters[6] - parameters[4] * dot3(u, start) - parameters[5] * speed
        rate = parameters[7] + force / mass
        for i in range(3):
            for j in range(3):
                Phi[6 * i + j] = parameters[i] * parameters[j] / mass
        fill(b, scaled3(rate, u) + (0.0, 0.0, 0.0))
        fill(V, scaled3(speed, u) + (0.0, 0.0, 0.0))
        return
    fill(V, E[16:])
    fill(b, ZERO)
    if kind == CONVEYOR:
        fill(b, E[22:])
    fill3(b, minus3(b, cross(V[3:], V)))  # the classical acceleration of E's origin made spatial
    fill(V, carry_motion(V, start, O))
    fill(b, carry_motion(b, start, O))


@inner
def answer_bodies(t):
    """Φ_e, b_e and V_e at O (3,) of every touched body."""
    for c in range(t.model.n_contacts):
        body = t.model.bodies[c]
        if body.same == c and body.kind != ELSEWHERE:
            answer = t.work.bodies[c].answer
            _answer(body.kind, body.parameters, t.input.touched[c], t.work.O, answer)


@inner
def project_bodies(t):
    """Fill Φ_μ (r, r), b_N and V_N (r,) for the kept columns: zero where bodies rest."""
    work = t.work
    work.b_N[:] = 0.0
    work.V_N[:] = 0.0
    work.Phi_mu[:] = 0.0
    for a in range(work.rank if work.moving != 0 else 0):
        N = work.columns[column_of(work, a)].N
        body = body_of(t, column_of(work, a)).same
        answer = work.bodies[body].answer
        work.b_N[a] = dot6(N, answer[36:])
        work.V_N[a] = dot6(N, answer[42:])
        given = ZERO
        for i in range(6):
            given = add(given, N[i], answer[6 * i :])
        fill(work.yields[a], given)
        for b in range(work.rank):
            other = column_of(work, b)
            if body_of(t, other).same == body:
                pushed = plus(work.columns[other].N, work.friction_wrenches[b])
                for i in range(6):
                    work.Phi_mu[a, b] += given[i] * pushed[i]
