"""Active columns of N, their linear dependence, and the motion of touched bodies along them."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import backward, dot, lu_solve, orthonormalise
from osc_contact.law.jit import inner, leaf, local
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

# --- Active columns of N, an independent subset of them, the others as combinations ---------------

#: Largest part of a unit column outside the span of others with which it counts as dependent.
DEPENDENT = 3e-7
_PREFERRED_SHARE = (
    0.3  #: a column is preferred if its rest is at least this share of the longest rest
)
_MOST_INCONSISTENCY = 1e-5  #: largest relative error of n_γ of a dependent column
_ROUNDING_OF_N_GAMMA = 1e-9  #: rounding error of n_γ when the bodies hardly move (m/s², rad/s²)


@inner
def choose_columns(t):
    """List the columns of N that belong to active contacts.

    Reads `active` of the contacts in MEMORY. Fills in WORK `chosen` (indices of these columns among
    all columns of the model), `count` (their number) and `here` (for each column of the model 1 if
    it is active, else 0).

    Args:
        t: Tick.
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
    """Select independent columns of N and compute their orthonormal basis.

    Reads `chosen`, `count`, and N and n_γ of the active columns. Fills in WORK `rank` (r), `kept`
    (indices of the independent columns), their `n_gamma`, and in energy coordinates, with the
    columns of N as rows, N = `N_e` and its factors `N_e` = `N_factor` `N_basis`; for each active
    column its `energy` (N in energy coordinates), `extent` (its norm) and `share` (the wrench of
    its unit force as a combination of the kept columns). With a reason it fills what
    `_select_independent` names.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`, or the reason why dependent columns contradict each other.
    """
    work = t.work
    columns = work.columns
    count = work.count
    # all columns are kept at first, up to six
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
    # whether they are independent; more than six never are
    may_depend = count > 6
    if 1 < count <= 6:
        least_ratio = orthonormalise(work.N_e, count, 0, work.N_basis, work.N_factor)
        may_depend = not least_ratio > 10.0 * DEPENDENT  # also if NaN
    if may_depend:
        reason = _select_independent(t)
        if reason != NO_REASON:
            return reason
    for a in range(work.rank):
        column = columns[work.kept[a]]
        work.n_gamma[a] = column.n_gamma
        fill(work.N_e[a], column.energy)
    if work.rank < count or count == 1:  # else the basis is known already
        orthonormalise(work.N_e, work.rank, 0, work.N_basis, work.N_factor)
    return NO_REASON


@inner
def _select_independent(t):
    """Select a well-conditioned, independent subset of the active columns of N.

    Each step selects the first column whose part outside the span of the selected ones is at least
    `_PREFERRED_SHARE` times the largest such part; it ends when all these parts are below
    `DEPENDENT`. Reads `energy` and `extent` of the columns. Fills `rank`, `kept` (in ascending
    order), and `rest` (6,; the part outside the span) and `share` (r,; the wrench of a unit force
    as a combination of the kept columns) of the columns, and what `_n_gamma_is_consistent` and
    `_require_same_body` name.

    Args:
        t: Tick.

    Returns:
        `NO_REASON`; `CONTRADICTION` if n_γ of a dependent column does not follow from those of the
        selected ones; or the reason of `_require_same_body`.
    """
    work = t.work
    columns = work.columns
    # parts outside the span of the selected columns, of columns with the length 1
    rank = 0
    for j in range(work.count):
        column = columns[work.chosen[j]]
        fill(column.rest, scaled(1.0 / column.extent, column.energy))
    while rank < work.count:
        longest = _longest_rest(t)
        if sqrt(longest) <= DEPENDENT or rank == 6:
            break
        first = work.chosen[0]
        for j in range(work.count - 1, -1, -1):  # from the last one: the first one remains
            remainder = columns[work.chosen[j]].rest
            if dot6(remainder, remainder) >= _PREFERRED_SHARE * _PREFERRED_SHARE * longest:
                first = work.chosen[j]
        _insert_index(work.kept, rank, first)
        rank += 1
        _remove_direction(t, first)
    work.rank = rank
    if rank == work.count:
        return NO_REASON
    _express_columns(t)
    if not _n_gamma_is_consistent(t):
        return CONTRADICTION
    return _require_same_body(t)


@leaf
def _longest_rest(t):
    """Largest square of the norm of `rest`, over the active columns (energy coordinates).

    `rest` (6,) is the part of a column of N outside the span of the selected columns.

    Args:
        t: Tick.
    """
    longest = 0.0
    for j in range(t.work.count):
        remainder = t.work.columns[t.work.chosen[j]].rest
        longest = max(longest, dot6(remainder, remainder))
    return longest


@leaf
def _insert_index(indices, count, index):
    """Insert an index in a list of indices in ascending order.

    Args:
        indices: (count + 1,) or longer, of which the first `count` are in ascending order; changed.
        count: number of indices before the insertion.
        index: index that is inserted.
    """
    place = count
    while place > 0 and indices[place - 1] > index:
        indices[place] = indices[place - 1]
        place -= 1
    indices[place] = index


@inner
def _remove_direction(t, first):
    """Remove the direction of one column from `rest` of all others, and zero its own `rest`.

    `rest` (6,) is the part of a column of N outside the span of the selected columns, in energy
    coordinates. The projection is done twice, for accuracy.

    Args:
        t: Tick.
        first: index of the column among all columns of the model.
    """
    columns = t.work.columns
    direction = columns[first].rest
    length = sqrt(dot6(direction, direction))
    for i in range(t.work.count):
        j = t.work.chosen[i]
        x = columns[j].rest
        if j != first:
            for _ in range(2):
                accumulate(x, -(dot6(direction, x) / (length * length)), direction)
    fill(direction, ZERO)


@inner
def _express_columns(t):
    """Express each active column of N as a combination of the kept ones, `energy` = Σ share_a N_a.

    `share` (r,) are the coefficients: magnitudes of the r kept columns N_a whose wrenches add up to
    that of a unit force of the column. Reads `rank`, `kept`, and `energy` and `extent` of the
    columns; fills `share` of each.

    Args:
        t: Tick.
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
    # with the kept columns of length 1, `unit` = L Q: share = L⁻ᵀQ energy, divided by their lengths
    orthonormalise(unit, rank, 0, basis, factor)
    for j in range(work.count):
        column = columns[work.chosen[j]]
        for a in range(rank):
            column.share[a] = dot6(basis[a], column.energy)
        backward(factor, rank, column.share)
        for a in range(rank):
            column.share[a] /= columns[work.kept[a]].extent
    for a in range(rank):  # of the kept columns exactly, without rounding errors
        share = columns[work.kept[a]].share
        fill(share, ZERO)
        share[a] = 1.0


@inner
def _n_gamma_is_consistent(t):
    """Determine whether n_γ of every active column follows from the kept ones, except for rounding.

    n_γ is the normal acceleration (m/s², rad/s²) that keeps the contact. A column that is the sum Σ
    share_a N_a of kept columns needs Σ share_a n_γa. Reads `n_gamma`, `share`, `extent` (norm in
    energy coordinates) of the columns. The tolerance of a column is in proportion to its `extent`,
    as its n_γ is, times the largest of the sums |n_γ| + Σ |share_a n_γa| per extent: the size of
    what is subtracted, of which rounding leaves a share. If one does not agree, fills `where`
    (index of the column among all) and `reason_amount` (n_γ of this column as implied by the
    others).

    Args:
        t: Tick.
    """
    work = t.work
    columns = work.columns
    # size of the summands per extent, relative to which rounding errors are judged
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
        if abs(column.n_gamma - implied) > max(
            _ROUNDING_OF_N_GAMMA, _MOST_INCONSISTENCY * column.extent * largest
        ):
            work.where = work.chosen[j]
            work.reason_amount = implied
            return False
    return True


@inner
def _require_same_body(t):
    """Require that dependent columns are on one body, or on unyielding bodies that move in unison.

    Bodies are in unison if their inverse inertia Φ_e is zero and their bias and twist are equal;
    then the distribution of a force among them does not matter. Reads `answer` of the bodies: Φ_e
    by rows (36), bias b_e (6), twist V_e (6).

    Args:
        t: Tick.

    Returns:
        `NO_REASON` or `DIFFERENT_BODIES`.
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
            if a != b or (i < 36 and a != 0.0):  # the first 36 are Φ_e
                return DIFFERENT_BODIES
    return NO_REASON


@inner
def spread_magnitudes(t):
    """Distribute forces and speeds of the kept columns to all columns; inactive ones get zero.

    R (r, count) has the `share` of each active column as a column: its wrench as a combination of
    the r kept columns. Of the forces α_all with R α_all = α, those with the least sum of squares
    are α_all = Rᵀ(RRᵀ)⁻¹α; the speeds are Rᵀ times those of the kept columns. Reads `alpha_meas`
    (α), `speed` and `share`; fills `alpha` (N) and `speeds` (m/s) for all columns.

    Args:
        t: Tick.
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
    lu_solve(RR, r, x, 1)  # (RRᵀ)⁻¹α
    for i in range(work.count):
        j = work.chosen[i]
        share = work.columns[j].share
        work.alpha[j] = dot(share, x[0], r)
        work.speeds[j] = dot(share, work.speed, r)


@inner
def square_shares(work, out):
    """Compute RRᵀ (r, r), where R (r, count) has the shares of the active columns.

    The share of one of the `count` active columns is the wrench of its unit force as a combination
    of the r kept columns of N.

    Args:
        work: WORK, of which `rank` r, `count`, `chosen` and `share` of the columns are read.
        out: (6, 6), filled; zero beyond r.
    """
    out[:] = 0.0
    for j in range(work.count):
        share = work.columns[work.chosen[j]].share
        for a in range(work.rank):
            for b in range(work.rank):
                out[a, b] += share[a] * share[b]


# --- Motion of the touched bodies along N: Φ_μ = NᵀΦ_eN_μ, b_N = Nᵀb_e, V_N = NᵀV_e ---------------


@inner
def _body_response(kind, parameters, E, O, answer):
    """Fill inverse inertia, bias and twist of one touched body at O, in world axes.

    The acceleration of the body is Φ_e f + b_e with the wrench f on it: Φ_e (6, 6) is its inverse
    inertia, b_e (6,) its bias, the acceleration without contact; V_e (6,) is its twist.

    Args:
        kind: CART, CONVEYOR or another kind of body.
        parameters: (8,) of a cart, which moves along one axis on a spring and damper: direction u
            (0:3), mass (kg), stiffness (N/m), damping (N s/m), preload of the spring (N), and u·g,
            the part of gravity along u (m/s²). Not read for other kinds.
        E: (28,) X_WE (4, 4) by rows, V_E (6,) and A_E (6,) of the body.
        O: (3,) operational point, to which the reference points are moved (m).
        answer: (48,), filled: Φ_e by rows (36), b_e (6), V_e (6).
    """
    Phi = answer[:36]
    b = answer[36:42]
    V = answer[42:48]
    start = (E[3], E[7], E[11])  # origin of X_WE
    V_E = E[16:22]
    A_E = E[22:28]
    Phi[:] = 0.0
    if kind == CART:
        u = linear(parameters)
        mass = parameters[3]
        stiffness = parameters[4]
        damping = parameters[5]
        preload = parameters[6]
        gravity = parameters[7]
        speed = dot3(u, V_E)
        force = preload - stiffness * dot3(u, start) - damping * speed
        rate = gravity + force / mass  # acceleration along u without contact
        for i in range(3):  # Φ_e = u uᵀ/mass for forces
            for j in range(3):
                Phi[6 * i + j] = parameters[i] * parameters[j] / mass
        fill(b, join(scaled3(rate, u), ZERO_3))
        fill(V, join(scaled3(speed, u), ZERO_3))
        return
    fill(V, V_E)
    fill(b, ZERO)
    if kind == CONVEYOR:
        fill(b, A_E)
    fill3(b, minus3(b, cross(V[3:], V)))  # the classical acceleration of E's origin made spatial
    fill(V, carry_motion(V, start, O))
    fill(b, carry_motion(b, start, O))


@inner
def compute_body_responses(t):
    """Compute inverse inertia Φ_e, bias b_e and twist V_e at O of every touched body.

    The acceleration of a body is Φ_e f + b_e with the wrench f on it. Bodies that several contacts
    touch are computed once, in the row of the first contact. Reads `kind` and `same` of BODY,
    `p_O`, and `touched` of INPUT (pose, twist and acceleration of each body); fills `answer` of the
    bodies: Φ_e by rows (36), b_e (6), V_e (6), in world axes.

    Args:
        t: Tick.
    """
    for c in range(t.model.n_contacts):
        body = t.model.bodies[c]
        if body.same == c and body.kind != ELSEWHERE:
            answer = t.work.bodies[c].answer
            _body_response(body.kind, body.parameters, t.input.touched[c], t.work.p_O, answer)


@inner
def project_bodies(t):
    """Project inverse inertia, bias and twist of the touched bodies on the kept columns of N.

    Φ_e (6, 6) is the acceleration of a body at O per wrench on it, b_e (6,) its acceleration
    without contact, V_e (6,) its twist; N (6, r) are the kept columns, N_μ the same with friction.
    A force on one body does not move another one. Reads `answer` of the bodies and
    `friction_wrenches`. Fills `Phi_mu` = NᵀΦ_eN_μ (r, r), `b_N` = Nᵀb_e (r,; m/s²), `V_N` = NᵀV_e
    (r,; m/s) and `yields` = NᵀΦ_e (r, 6) at O. Without measured motions of bodies (`moving` = 0)
    the first three are zero, and `yields` is not filled.

    Args:
        t: Tick.
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
        answer = work.bodies[body].answer  # Φ_e by rows (36), b_e (6), V_e (6)
        work.b_N[a] = dot6(N, answer[36:])
        work.V_N[a] = dot6(N, answer[42:])
        yield_row = ZERO  # row of NᵀΦ_e
        for i in range(6):
            yield_row = add(yield_row, N[i], answer[6 * i :])
        fill(work.yields[a], yield_row)
        for b in range(work.rank):  # row of NᵀΦ_eN_μ, of columns on the same body
            other = work.kept[b]
            if body_of(t, other).same == body:
                pushed = plus(work.columns[other].N, work.friction_wrenches[b])
                for i in range(6):
                    work.Phi_mu[a, b] += yield_row[i] * pushed[i]
