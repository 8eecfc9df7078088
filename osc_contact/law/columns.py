"""Columns of N in force, their dependence, and how the touched bodies answer along them."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import backward, dot, lu_solve, orthonormalise
from osc_contact.law.jit import inner, local
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import CART, CONVEYOR, ELSEWHERE, body_of, contact_of
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    accumulate,
    add,
    carry_motion,
    cross,
    dot3,
    dot6,
    fill,
    fill3,
    join,
    linear,
    minus3,
    plus,
    scaled,
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
    """The columns of N whose contacts are in force.

    Fills `chosen` (numbers of these columns), `count` (how many) and `here` (1 for each, else 0).
    """
    work = t.work
    work.count = 0
    for j in range(t.model.n_columns):
        work.here[j] = 0.0
        if contact_of(t, j).active:
            work.here[j] = 1.0
            work.chosen[work.count] = j
            work.count += 1


@inner
def keep_columns(t):
    """N (r, 6) of the independent columns as rows, and n_γ of these; returns a reason.

    Reads `chosen`, `count` and N, n_γ of the columns in force. Fills `rank`, `kept`, `n_gamma`, in
    energy coordinates `N`, `N_factor`, `N_basis`; `energy`, `extent`, `share` of the columns.
    """
    work = t.work
    columns = work.columns
    count = work.count
    for j in range(count):
        column = columns[work.chosen[j]]
        fill(column.energy, wrench_to_energy(work, column.N))
        fill(column.share, ZERO)
        column.extent = sqrt(dot6(column.energy, column.energy))
        if j < 6:
            column.share[j] = 1.0
            fill(work.N_e[j], column.energy)
            work.kept[j] = work.chosen[j]
    work.rank = count
    dependent = count > 6
    if 1 < count <= 6:
        least = orthonormalise(work.N_e, count, 0, work.N_basis, work.N_factor)
        dependent = not least > 10.0 * DEPENDENT
    if dependent:
        reason = _reduce(t)
        if reason != NO_REASON:
            return reason
    for a in range(work.rank):
        column = columns[work.kept[a]]
        work.n_gamma[a] = column.n_gamma
        fill(work.N_e[a], column.energy)
    if work.rank < count or count == 1:
        orthonormalise(work.N_e, work.rank, 0, work.N_basis, work.N_factor)
    return NO_REASON


@inner
def _reduce(t):
    """A well-conditioned subset of the columns in force; returns a reason.

    Kept is, again and again, the first column of which not much less lies outside the kept ones
    than of any other. Reads `energy` and `extent` of the columns. Fills `rank`, `kept`, and `rest`
    and `share` of the columns.
    """
    work = t.work
    columns = work.columns
    rank = 0
    for j in range(work.count):
        column = columns[work.chosen[j]]
        fill(column.rest, scaled(1.0 / column.extent, column.energy))
    while rank < work.count:
        longest = 0.0
        for j in range(work.count):
            rest = columns[work.chosen[j]].rest
            longest = max(longest, dot6(rest, rest))
        if sqrt(longest) <= DEPENDENT or rank == 6:
            break
        first = work.chosen[0]
        for j in range(work.count - 1, -1, -1):
            rest = columns[work.chosen[j]].rest
            if dot6(rest, rest) >= _PIVOT * _PIVOT * longest:
                first = work.chosen[j]
        at = rank
        while at > 0 and work.kept[at - 1] > first:
            work.kept[at] = work.kept[at - 1]
            at -= 1
        work.kept[at] = first
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
    """Remove the direction of column `first` from `rest` of every column, twice."""
    columns = t.work.columns
    q = columns[first].rest
    length = sqrt(dot6(q, q))
    for i in range(t.work.count):
        j = t.work.chosen[i]
        x = columns[j].rest
        if j != first:
            for _ in range(2):
                accumulate(x, -(dot6(q, x) / (length * length)), q)
    fill(q, ZERO)


@inner
def _express(t):
    """Each column in force as a combination of the kept ones, N_all = N share.

    Reads `rank`, `kept`, and `energy` and `extent` of the columns; fills `share` (rank,) of each.
    """
    work = t.work
    columns = work.columns
    rank = work.rank
    unit = local(6, 6)
    factor = local(6, 6)
    basis = local(6, 6)
    for a in range(rank):
        column = columns[work.kept[a]]
        fill(unit[a], scaled(1.0 / column.extent, column.energy))
    orthonormalise(unit, rank, 0, basis, factor)
    for j in range(work.count):
        column = columns[work.chosen[j]]
        for a in range(rank):
            column.share[a] = dot6(basis[a], column.energy)
        backward(factor, rank, column.share)
        for a in range(rank):
            column.share[a] /= columns[work.kept[a]].extent
    for a in range(rank):
        share = columns[work.kept[a]].share
        fill(share, ZERO)
        share[a] = 1.0


@inner
def _consistent(t):
    """Whether n_γ of every column in force follows from the kept ones, but for rounding.

    Reads `n_gamma`, `share`, `extent` of the columns. Where it does not, fills `where` (the column)
    and `reason_amount` (its n_γ as the others imply it).
    """
    work = t.work
    columns = work.columns
    largest = 0.0
    for j in range(work.count):
        column = columns[work.chosen[j]]
        summands = abs(column.n_gamma)
        for a in range(work.rank):
            summands += abs(columns[work.kept[a]].n_gamma * column.share[a])
        largest = max(largest, summands / column.extent)
    for j in range(work.count):
        column = columns[work.chosen[j]]
        implied = 0.0
        for a in range(work.rank):
            implied += columns[work.kept[a]].n_gamma * column.share[a]
        if abs(column.n_gamma - implied) > max(_STILL, _CONSISTENT * column.extent * largest):
            work.where = work.chosen[j]
            work.reason_amount = implied
            return False
    return True


@inner
def _same_body(t):
    """Reason unless all columns in force are on one body, or on bodies that move as one.

    The latter must not yield. Reads `answer` of the bodies.
    """
    work = t.work
    first = body_of(t, work.chosen[0]).same
    for j in range(1, work.count):
        other = body_of(t, work.chosen[j]).same
        if other == first:
            continue
        for i in range(48):
            a = work.bodies[first].answer[i]
            b = work.bodies[other].answer[i]
            if a != b or (i < 36 and a != 0.0):
                return DIFFERENT_BODIES
    return NO_REASON


@inner
def spread_magnitudes(t):
    """Magnitudes and speeds of all columns, from those of the kept ones; 0 of columns not in force.

    Where columns depend on others that is the split with the least sum of squares:
    α_all = Rᵀ(RRᵀ)⁻¹α, and Rᵀ speed, R the shares. Reads `alpha_meas`, `speed` and `share`; fills
    `alpha` (N) and `speeds` (m/s).
    """
    work = t.work
    r = work.rank
    RR = local(6, 6)
    x = local(1, 6)
    work.alpha[:] = 0.0
    work.speeds[:] = 0.0
    square_shares(work, RR)
    for a in range(r):
        x[0, a] = work.alpha_meas[a]
    lu_solve(RR, r, x, 1)
    for i in range(work.count):
        j = work.chosen[i]
        share = work.columns[j].share
        work.alpha[j] = dot(share, x[0], r)
        work.speeds[j] = dot(share, work.speed, r)


@inner
def square_shares(work, out):
    """out ← RRᵀ (r, r), R (r, count) the shares of the columns in force.

    Args:
        work: WORK, of which `share` is read. out: (6, 6).
    """
    out[:] = 0.0
    for j in range(work.count):
        share = work.columns[work.chosen[j]].share
        for a in range(work.rank):
            for b in range(work.rank):
                out[a, b] += share[a] * share[b]


# --- What the touched bodies do along N: Φ_μ = NᵀΦ_eN_μ, b_N = Nᵀb_e, V_N = NᵀV_e -----------------


@inner
def _answer(kind, parameters, E, O, answer):
    """Inverse inertia Φ_e, bias b_e and twist V_e of one body at O, in world axes.

    Args:
        kind: of the body. parameters: (8,) of a cart: direction u (0:3), mass, stiffness, damping,
            preload, u·g. E: (28,) its pose by rows, twist and acceleration. O: (3,) point (m).
        answer: (48,), filled: Φ_e by rows (36), b_e (6), V_e (6).
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
        fill(b, join(scaled3(rate, u), ZERO_3))
        fill(V, join(scaled3(speed, u), ZERO_3))
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
    """Φ_e, b_e and V_e at O of every touched body, from its measured motion.

    Reads `p_O` and `touched` of INPUT; fills `answer` of the bodies.
    """
    for c in range(t.model.n_contacts):
        body = t.model.bodies[c]
        if body.same == c and body.kind != ELSEWHERE:
            answer = t.work.bodies[c].answer
            _answer(body.kind, body.parameters, t.input.touched[c], t.work.p_O, answer)


@inner
def project_bodies(t):
    """The touched bodies along the kept columns; all zero where bodies rest.

    Reads `answer` of the bodies and `friction_wrenches`. Fills `Phi_mu` = NᵀΦ_eN_μ (r, r), `b_N` =
    Nᵀb_e (r,), `V_N` = NᵀV_e (r,) and `yields` = NᵀΦ_e (r, 6) at O.
    """
    work = t.work
    work.b_N[:] = 0.0
    work.V_N[:] = 0.0
    work.Phi_mu[:] = 0.0
    if not work.moving:
        return
    for a in range(work.rank):
        N = work.columns[work.kept[a]].N
        body = body_of(t, work.kept[a]).same
        answer = work.bodies[body].answer
        work.b_N[a] = dot6(N, answer[36:])
        work.V_N[a] = dot6(N, answer[42:])
        given = ZERO
        for i in range(6):
            given = add(given, N[i], answer[6 * i :])
        fill(work.yields[a], given)
        for b in range(work.rank):
            other = work.kept[b]
            if body_of(t, other).same == body:
                pushed = plus(work.columns[other].N, work.friction_wrenches[b])
                for i in range(6):
                    work.Phi_mu[a, b] += given[i] * pushed[i]
