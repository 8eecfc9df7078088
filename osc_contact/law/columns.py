"""Columns of N in force, their dependence, and how the touched bodies answer along them."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import lu_solve, orthonormalise, solve_lower_transposed
from osc_contact.law.jit import inner
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import (
    CART,
    CONVEYOR,
    ELSEWHERE,
)
from osc_contact.law.vectors import (
    ZERO,
    add,
    carry_motion,
    carry_wrench,
    dot6,
    energy_wrench,
    fill,
    six,
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
    count = 0
    for j in range(t.model.n_columns):
        if t.memory.contacts[t.model.columns[j].contact].active != 0:
            t.work.columns[count].chosen = j
            count += 1
    t.work.count = count


@inner
def keep_columns(t):
    """N (r, 6) of the independent columns in energy coordinates, N_μ, n_γ; returns a reason.

    Fills rank, keep, N, pushed, friction_wrenches, n_gamma; `share` of each column in force where
    r < count.
    """
    columns = t.work.columns
    work = t.work
    count = work.count
    for j in range(count):
        column = columns[j]
        whole = columns[column.chosen]
        carry_wrench(whole.N, work.O, work.C, column.energy)
        energy_wrench(work.axes, column.energy, column.energy)
        column.n_gamma = whole.n_gamma_all
        column.extent = sqrt(dot6(column.energy, column.energy))
        fill(column.rest, six(column.energy))
    for a in range(min(count, 6)):
        fill(work.N[a], six(columns[a].energy))
        work.keep[a] = float(a)
    work.rank = count
    if count > 6 or (
        count > 1 and not orthonormalise(work.N, count, 0, work.Q, work.L) > 10.0 * DEPENDENT
    ):
        reason = _reduce(t)
        if reason != NO_REASON:
            return reason
    r = work.rank
    for a in range(r):
        column = columns[int(work.keep[a])]
        work.n_gamma[a] = column.n_gamma
        fill(work.N[a], six(column.energy))
    if r < count or count == 1:
        orthonormalise(work.N, r, 0, work.Q, work.L)
    return NO_REASON


@inner
def _reduce(t):
    """Keep a well-conditioned subset: the first column whose rest is not much below the largest."""
    columns = t.work.columns
    work = t.work
    count = work.count
    rank = 0
    for j in range(count):
        for i in range(6):
            columns[j].rest[i] /= columns[j].extent
    while rank < count:
        longest = 0.0
        for j in range(count):
            longest = max(longest, dot6(columns[j].rest, columns[j].rest))
        if sqrt(longest) <= DEPENDENT or rank == 6:
            break
        first = -1
        for j in range(count):
            square = dot6(columns[j].rest, columns[j].rest)
            if first < 0 and square >= _PIVOT * _PIVOT * longest:
                first = j
        work.keep[rank] = float(first)
        rank += 1
        _remove(t, count, first)
    work.rank = rank
    for a in range(1, rank):
        for b in range(a, 0, -1):
            if work.keep[b] < work.keep[b - 1]:
                work.keep[b], work.keep[b - 1] = work.keep[b - 1], work.keep[b]
    if rank == count:
        return NO_REASON
    _express(t, count, rank)
    if not _consistent(t, count, rank):
        return CONTRADICTION
    return _same_body(t, count)


@inner
def _remove(t, count, first):
    """Take the direction of column `first` out of every rest, twice."""
    columns = t.work.columns
    length = sqrt(dot6(columns[first].rest, columns[first].rest))
    q = columns[first].rest
    for j in range(count):
        if j == first:
            continue
        x = columns[j].rest
        for _ in range(2):
            along = dot6(q, x) / (length * length)
            fill(x, add(x, -along, q))
    fill(q, ZERO)


@inner
def _express(t, count, rank):
    """share (rank,) of every column in force: N_all = N share."""
    columns = t.work.columns
    work = t.work
    for a in range(rank):
        column = columns[int(work.keep[a])]
        for i in range(6):
            work.A[a, i] = column.energy[i] / column.extent
    orthonormalise(work.A, rank, 0, work.Q, work.L)
    for j in range(count):
        column = columns[j]
        for a in range(rank):
            work.u[a] = dot6(work.Q[a], column.energy)
        solve_lower_transposed(work.L, rank, work.u)
        for a in range(rank):
            column.share[a] = work.u[a] / columns[int(work.keep[a])].extent
    for a in range(rank):
        column = columns[int(work.keep[a])]
        for b in range(rank):
            column.share[b] = 1.0 if a == b else 0.0


@inner
def _consistent(t, count, rank):
    """n_γ of every column follows from the kept ones as the column does, but for rounding."""
    columns = t.work.columns
    work = t.work
    largest = 0.0
    for j in range(count):
        column = columns[j]
        summands = abs(column.n_gamma)
        for a in range(rank):
            summands += abs(columns[int(work.keep[a])].n_gamma * column.share[a])
        largest = max(largest, summands / column.extent)
    for j in range(count):
        column = columns[j]
        implied = 0.0
        for a in range(rank):
            implied += columns[int(work.keep[a])].n_gamma * column.share[a]
        if abs(column.n_gamma - implied) > max(_STILL, _CONSISTENT * column.extent * largest):
            work.where = column.chosen
            work.amount = implied
            return False
    return True


@inner
def _same_body(t, count):
    """Dependent columns must be on one body, or on bodies that move as one and do not yield."""
    table = t.model.columns
    bodies = t.model.bodies
    columns = t.work.columns
    body_work = t.work.bodies
    first = bodies[table[columns[0].chosen].contact].same
    for j in range(1, count):
        other = bodies[table[columns[j].chosen].contact].same
        if other != first:
            for i in range(48):
                a = body_work[first].answer[i]
                b = body_work[other].answer[i]
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
    columns = t.work.columns
    r = work.rank
    count = work.count
    if r == count:
        for j in range(count):
            alpha[columns[j].chosen] = work.alpha_meas[j]
            speed[columns[j].chosen] = work.speed[j]
        return
    _spread_dependent(t, alpha, speed)


@inner
def _spread_dependent(t, alpha, speed):
    """α_all = Rᵀ(RRᵀ)⁻¹α and Rᵀ speed, R the shares."""
    work = t.work
    columns = t.work.columns
    r = work.rank
    count = work.count
    G = work.D
    x = work.E
    for a in range(r):
        x[0, a] = work.alpha_meas[a]
        for b in range(r):
            G[a, b] = 0.0
            for j in range(count):
                G[a, b] += columns[j].share[a] * columns[j].share[b]
    lu_solve(G, r, x, 1)
    for j in range(count):
        force = rate = 0.0
        for a in range(r):
            force += columns[j].share[a] * x[0, a]
            rate += columns[j].share[a] * work.speed[a]
        alpha[columns[j].chosen] = force
        speed[columns[j].chosen] = rate


# --- What the touched bodies do along N: Φ_μ = NᵀΦ_eN_μ, b_N = Nᵀb_e, V_N = NᵀV_e -----------------


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
    start[0] = E[3]
    start[1] = E[7]
    start[2] = E[11]
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
