"""Contact geometry of every packaged pair, and the estimate of contact normals."""

from __future__ import annotations

from collections import namedtuple
from math import copysign, floor, sqrt

from osc_contact.law.jit import call_at, inner, leaf, local
from osc_contact.law.records import (
    COUPLE,
    EDGES,
    FACE_ON_VERTEX,
    FUNCTION,
    GIVEN,
    LEAST_SQUARES,
    POINTS,
    SCREW,
    SLIDE,
    SURFACE,
    THREAD,
)
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    add,
    add3,
    carry_motion,
    cross,
    cross_motion,
    divided3,
    dot3,
    dot6,
    fill,
    fill3,
    finiteness,
    join,
    linear,
    minus,
    minus3,
    origin,
    plus3,
    rotated,
    rotated9,
    rotated9_back,
    rotated_back,
    scaled3,
    set_identity,
    velocity_at,
)

# --- Estimation of contact normals from sliding ---------------------------------------------------
#
# If the assumed normal n of a face is wrong by ε, a point that slides along the true face at v_t
# has the speed v = εᵀv_t along n. Where a pair has a single point on a single face, n is turned
# until this speed vanishes; a speed that remains without sliding is v̄ of `commands`. Where two
# edges cross, the edge of the touched body is turned, and g (`_shown_by_edges`) takes the place of
# v_t. docs/tuning.md has the benefit of the estimate and the proof of its stability.
#
# P is the covariance of ε. The part of v that an error of n does not explain (for example the
# speed of a yielding face) is modelled as independent after 1/c; r is its mean square, computed
# after a low-pass at 4c. With ĝ along v_t,
#
#     κ = c dt σ λ,   λ = p/(p + r),   p = |v_t|² ĝᵀPĝ
#     P ← (1 − κĝĝᵀ) P (1 − κĝĝᵀ) + κ²/(c dt) r/|v_t|² ĝĝᵀ
#
# P starts from P_0 = (tilt²/4)(1 − nnᵀ), the covariance in a cone of half angle `tilt`; for crossed
# edges from (tilt²/4) nnᵀ. The share 1 − σλ of v, which does not turn n, changes v̄.

_LEAST_SQUARE = 1e-30  # (m/s)², keeps quotients finite
_FASTER = 4.0  # corner frequency of the low-pass of v, in multiples of c
_SLIDES = 0.01  #: v_1 (m/s), sliding speed at which half of v is attributed to the normal


@inner
def take_turns(t):
    """Copy v̄ and the turns of the assumed normals from MEMORY to the columns of WORK.

    Fills `drift`, `turn`, `turned` (equal to `turn`), and zeroes `slides`, `lever` and `prior`.
    """
    for j in range(t.model.n_columns):
        row = t.work.columns[j]
        last = t.memory.columns[j]
        row.drift = last.drift
        row.slides = 0.0
        row.lever = 0.0
        fill3(row.turn, last.turn)
        fill3(row.turned, last.turn)
        row.prior[:] = 0.0


@inner
def follow_face(t, pair, X_WO, R_E, V_rel, V_goal):
    """Turn the assumed normal of a face by the speed along it while a point slides.

        n ← n − κ (NᵀV_rel − v̄) v_t / v_t²,   σ = v_t⁴ / (v_t⁴ + v_1⁴)

    v_t is the desired velocity of the point along the face, so neither measurement noise nor a
    point at rest turns the normal. n stays within the angle `tilt` of the declared normal, in the
    axes of the object or body that carries the face; a larger deviation changes v̄ instead. On a
    curved face n is the normal at the point touched: an error δ of a ball's position turns it by
    −δ/R everywhere.

    Fills `turned` (the normal after this tick less the declared one), `slides` (σλ, 0 … 1),
    `shown`, `lever`, `prior` and `unexplained` of the column.

    Args:
        pair: PAIR row with one column, whose N, `turn` and `drift` are filled.
        X_WO: (4, 4) pose of the object.
        R_E: (4, 4) pose of the touched body.
        V_rel: (6,) measured twist of the object relative to the body, at O.
        V_goal: (6,) desired twist of the object relative to the body, at O.
    """
    model = t.model
    shapes = model.shapes
    column = t.work.columns[pair.first]
    last = t.memory.columns[pair.first]
    N = column.N
    size = sqrt(dot3(N, N))
    v = _tangential(velocity_at(V_goal, _tracked(pair, shapes, X_WO, R_E, column)), N)
    if pair.kind == EDGES:
        v = _shown_by_edges(shapes[pair.shape_at].row, X_WO, R_E, column, v)
    column.lever = square = dot3(v, v)
    column.unexplained = (dot6(N, V_rel) - column.drift) / size
    axes = X_WO if pair.kind == FACE_ON_VERTEX else R_E
    v = rotated_back(axes, v)
    n = rotated_back(axes, scaled3(1.0 / size, N))
    fill3(column.shown, scaled3(1.0 / sqrt(max(square, _LEAST_SQUARE)), v))
    for i in range(3):
        for j in range(3):  # a face turns about axes across n, an edge changes n along n
            across = (1.0 if i == j else 0.0) - n[i] * n[j]
            share = n[i] * n[j] if pair.kind == EDGES else across
            column.prior[3 * i + j] = 0.25 * model.tilt * model.tilt * share
    expected = square * _quadratic(last.covariance, column.shown)
    column.slides = square * square / (square * square + _SLIDES**4)
    if expected > 0.0:
        column.slides *= expected / (expected + last.residual)
    gain = model.drift_share * column.slides * column.unexplained / max(square, _LEAST_SQUARE)
    n = add3(plus3(column.believed, column.turn), -gain, v)
    turn = minus3(divided3(n, sqrt(dot3(n, n))), column.believed)
    angle = sqrt(dot3(turn, turn))
    if angle > model.tilt:
        column.slides = 0.0
        turn = scaled3(model.tilt / angle, turn)
    fill3(column.turned, turn)


@leaf
def _tangential(v, N):
    """Component of a velocity v (m/s) perpendicular to the line of force N (6,)."""
    return add3(v, -dot3(N, v) / dot3(N, N), N)


@inner
def _shown_by_edges(row, X_WO, R_E, column, v):
    """Sensitivity g (m/s) of NᵀV_rel to a turn δ of the body's edge f: NᵀV_rel changes by gᵀδ.

    g = ±(v_t × e)/|e × f|, with e the edge of the object.

    Args:
        row: (16,) shape of the edges, see `_edges`.
        X_WO, R_E: (4, 4) poses of the object and the touched body.
        column: COLUMN_WORK, of which N and `turn` are read.
        v: velocity of the crossing along the face (m/s).
    """
    e = rotated(X_WO, row[3:])
    m = cross(e, _turned_edge(row, R_E, column.turn))
    return scaled3(1.0 / dot3(column.N, m), cross(v, e))


@inner
def _quadratic(P, u):
    """Quadratic form uᵀPu of a 3×3 matrix P (9 numbers, by rows) and a vector u."""
    return dot3(u, rotated9(P, u))


@leaf
def learn_normal(share, last, column):
    """Update the covariance P, `normal_std` and the mean square `residual` of an assumed normal.

    Args:
        share: c dt, the share of a tick in the estimate; 0 where it is not updated.
        last: COLUMN_MEMORY, changed.
        column: COLUMN_WORK after `follow_face`.
    """
    P = last.covariance
    u = column.shown
    if P[0] + P[4] + P[8] == 0.0:
        for i in range(9):
            P[i] = column.prior[i]
    if share == 0.0 and last.normal_std > 0.0:
        return
    square = column.lever * column.lever
    last.unexplained += _FASTER * share * (column.unexplained - last.unexplained)
    found = last.unexplained * last.unexplained - column.lever * _quadratic(P, u)
    last.residual += share * square / (square + _SLIDES**4) * (max(found, 0.0) - last.residual)
    k = share * column.slides
    w = rotated9(P, u)
    noise = last.residual / (max(column.lever, _LEAST_SQUARE) * max(share, 1e-12))
    s = k * k * (dot3(u, w) + noise)
    for i in range(3):
        for j in range(3):
            P[3 * i + j] += s * u[i] * u[j] - k * (w[i] * u[j] + u[i] * w[j])
    half = 0.5 * (P[0] + P[4] + P[8])  # largest eigenvalue of P, which has rank two
    minors = P[0] * P[4] - P[1] * P[3] + P[0] * P[8] - P[2] * P[6] + P[4] * P[8] - P[5] * P[7]
    last.normal_std = sqrt(half + sqrt(max(half * half - minors, 0.0)))


@inner
def _tracked(pair, shapes, X_WO, R_E, column):
    """Return the point (m, from O) that slides on the face of a pair with one column.

    Fills `believed` of the column with the declared normal, in the axes of the object or body that
    carries the face. The normals of a SURFACE, a GIVEN and a FUNCTION pair are filled elsewhere.
    """
    if pair.kind == GIVEN or pair.kind == FUNCTION:
        return linear(column.point)
    row = shapes[pair.shape_at].row
    if pair.kind == FACE_ON_VERTEX:
        fill3(column.believed, row)
        return _vertex(row, X_WO, R_E)
    if pair.kind == EDGES:
        fill3(column.believed, row[9:])
        return _crossing(row, X_WO, R_E, _turned_edge(row, R_E, column.turn))[0]
    if pair.kind != SURFACE:
        fill3(column.believed, row[3:])
    return rotated(X_WO, row)


@inner
def _turn_given(column, R_E):
    """Turn the N of a GIVEN or FUNCTION pair with one column by the estimate of its normal.

    The point of contact stays where it is. Fills `believed` with the normal before the turn.

    Args:
        column: COLUMN_WORK with N, `point` and `turn`; N is changed.
        R_E: (4, 4) pose of the touched body.
    """
    N = column.N
    turn = column.turn
    size = sqrt(dot3(N, N))
    n = rotated_back(R_E, divided3(N, size))
    fill3(column.believed, n)
    if turn[0] == 0.0 and turn[1] == 0.0 and turn[2] == 0.0:
        return
    n = plus3(n, turn)
    _line(N, column.point, rotated(R_E, scaled3(size / sqrt(dot3(n, n)), n)))


# --- N and n_γ at the operational point, in world axes, of every packaged pair --------------------
#
# A PAIR has its kind, its first column of N, the number of its columns, and the first SHAPE of its
# geometry; the docstring of each function lists the numbers of its shape. Positions are from O,
# twists at O. Matrices are read element by element, so that the same functions work on numbers and
# on arrays of numbers over time (`contacts.pairs.pair`).

PARALLEL = 1e-6  #: sine of the angle below which two edges have no common normal
AHEAD = 2.0  #: control periods from a measurement to the latest effect of its torque

#: X_WO, R_E: (4, 4) poses of the object and of the touched body. V_O, V_E: (6,) their twists at O.
#: V_rel: (6,) twist of the object relative to the body, at O. moving: False if the body rests.
Motion = namedtuple("Motion", "X_WO V_O R_E V_E V_rel moving")


@leaf
def _line(N, p, n):
    """Fill N (6,) with [n; p × n], the wrench at O of a unit force along n through p."""
    fill(N, join(n, cross(p, n)))


@inner
def place_contacts(t):
    """Fill N, n_γ and friction wrenches of all columns; return False where a pair is degenerate.

    N, n_γ and points of GIVEN pairs were filled by Python before the tick; those of FUNCTION pairs
    are computed by the user's compiled function. The friction wrench is predicted for the time at
    which the torques of this tick act, since friction reverses within milliseconds with the motion.
    """
    model = t.model
    shapes = model.shapes
    columns = t.work.columns
    X_WO = t.work.X_WO
    V_O = t.work.V_O
    moving = t.work.moving
    work = t.work
    R_E = local(4, 4)
    V_E = local(6)
    V_rel = local(6)
    V = local(6)
    evaluated = local(6, 11)  # N, n_γ, gap and point of each column of a FUNCTION pair
    evaluated[:] = 0.0
    set_identity(R_E)
    fill(V_E, ZERO)
    fill(V_rel, V_O)
    for c in range(model.n_contacts):
        pair = model.pairs[c]
        if moving:
            E = t.input.touched[c]
            for i in range(3):
                for j in range(4):
                    R_E[i, j] = E[4 * i + j]
            fill(V_E, carry_motion(E[16:], origin(R_E), origin(X_WO)))
            fill(V_rel, minus(V_O, V_E))
        alone = pair.count == 1 and pair.has_friction != 0
        given = pair.kind == GIVEN or pair.kind == FUNCTION
        if pair.kind == FUNCTION:
            row = shapes[pair.shape_at].row
            call_at(pair.address, X_WO, V_O, R_E, V_E, row, evaluated)
            if not _take_evaluated(columns, pair.first, pair.count, evaluated):
                return False
        if not given:
            motion = Motion(X_WO, V_O, R_E, V_E, V_rel, moving)
            if not place_pair(pair, shapes, columns, motion) >= PARALLEL:
                return False
        elif alone:
            _turn_given(columns[pair.first], R_E)
        if alone and model.tilt > 0.0:
            fill(V, minus(work.V_D, V_E))
            follow_face(t, pair, X_WO, R_E, V_rel, V)
        known = pair.has_friction != 0
        if not known and model.reading == LEAST_SQUARES:
            for j in range(pair.count):
                fill3(columns[pair.first + j].slip, ZERO_3)
                fill(columns[pair.first + j].friction_wrench, ZERO)
        if known and (work.mu > 0.0 or model.reading == LEAST_SQUARES):
            fill(V, add(V_rel, AHEAD * model.period, work.A_D))
            for j in range(pair.count):
                column = columns[pair.first + j]
                if not given:
                    row = shapes[pair.shape_at + j].row
                    fill3(column.point, point_of_contact(pair.kind, row, X_WO, R_E, column.N))
                _slide(V, work.mu, model.slip, column)
    return True


@inner
def _take_evaluated(columns, first, count, evaluated):
    """Copy the results of a FUNCTION pair to its columns; return whether they are finite.

    Args:
        columns: COLUMN_WORK rows, of which N, `n_gamma` and `point` are filled.
        first, count: first column of the pair and their number.
        evaluated: (6, 11) rows [N; n_γ; gap; point], one for each column.
    """
    zero = 0.0
    for j in range(count):
        column = columns[first + j]
        given = evaluated[j]
        fill(column.N, given)
        column.n_gamma = given[6]
        fill3(column.point, given[8:])
        zero += finiteness(given, 7) + finiteness(given[8:], 3)
    return zero == 0.0


@inner
def place_pair(pair, shapes, columns, motion):
    """Fill N and n_γ of one pair's columns.

    Args:
        pair: PAIR row. shapes: SHAPE rows. columns: COLUMN_WORK rows.
        motion: `Motion` of the object and the touched body.

    Returns:
        A number that is near zero where N does not exist: the sine of the angle between two edges,
        the magnitude of the gradient of a surface, 1 for all other pairs.
    """
    first = pair.first
    shape = pair.shape_at
    if pair.kind == POINTS:
        for j in range(pair.count):
            _point_on_plane(shapes[shape + j].row, motion, columns[first + j])
    elif pair.kind == FACE_ON_VERTEX:
        _face_on_vertex(shapes[shape].row, motion, columns[first])
    elif pair.kind == SURFACE:
        return _on_surface(shapes, shape, motion, columns[first])
    elif pair.kind == EDGES:
        return _edges(shapes[shape].row, motion, columns[first])
    else:
        _tangents(pair, shapes, motion, columns)
    return 1.0


@inner
def _point_on_plane(row, motion, column):
    """Fill N and n_γ of a point of the object on a plane of the touched body.

    Args:
        row: (16,) point in the object's axes (0:3), unit vector into the plane in the body's axes
            (3:6), distance of the plane from the body's origin along it (6).
        motion: `Motion`.
        column: COLUMN_WORK, filled.
    """
    p = rotated(motion.X_WO, row)
    n = plus3(row[3:], column.turn)
    if motion.moving:
        n = rotated(motion.R_E, n)
    _line(column.N, p, n)
    column.n_gamma = _carried(p, n, motion)


@inner
def _carried(p, n, motion):
    """Normal acceleration n_γ = −ṄᵀV_rel of a point p fixed to the object, n fixed to the body.

    Args:
        p: point of contact from O (m), world axes. n: unit vector, world axes. motion: `Motion`.
    """
    V_rel = motion.V_rel
    s = -dot3(n, cross(V_rel[3:], velocity_at(motion.V_O, p)))
    if motion.moving:
        s -= dot3(cross(motion.V_E[3:], n), velocity_at(V_rel, p))
    return s


@inner
def point_of_contact(kind, row, X_WO, R_E, N):
    """Point of contact (m, from O, world axes) of a column of a pair with unilateral contact.

    It is the projection of a point on its plane, the point of a ball on its face, the vertex (less
    its radius) or the point of the object's edge.

    Args:
        kind: of the pair. row: (16,) SHAPE of the column. X_WO, R_E: (4, 4) poses of the object
            and the touched body. N: (6,) line of force at O.
    """
    if kind == FACE_ON_VERTEX:
        return add3(_vertex(row, X_WO, R_E), -row[6], N)
    if kind == EDGES:
        return _crossing(row, X_WO, R_E, rotated(R_E, row[9:]))[0]
    p = rotated(X_WO, row)
    ahead = row[3]
    if kind == POINTS:  # to the assumed plane
        x, y, z = minus3(minus3(origin(R_E), origin(X_WO)), p)
        a, b, c = rotated(R_E, row[3:])
        ahead = row[6] + a * x + (b * y + c * z)
    return add3(p, ahead, N)


@inner
def _slide(V_rel, mu, slip, column):
    """Fill `slip`, s = v_t / √(v_t² + v_0²), and `friction_wrench`, μ [s; p × s], of a column.

    Args:
        V_rel: (6,) twist relative to the body, at O. mu: coefficient of friction μ. slip: v_0
            (m/s), below which friction is regularised. column: COLUMN_WORK with N and `point`.
    """
    v = _tangential(velocity_at(V_rel, column.point), column.N)
    s = scaled3(1.0 / sqrt(dot3(v, v) + slip * slip), v)
    fill3(column.slip, s)
    _line(column.friction_wrench, column.point, scaled3(mu, s))


@inner
def _rate(p, n, p_dot, n_dot):
    """Rate of a line of force [n; p × n]: [ṅ; ṗ × n + p × ṅ], six numbers."""
    return join(n_dot, plus3(cross(p_dot, n), cross(p, n_dot)))


@inner
def _on_surface(shapes, at, motion, column):
    """Fill N and n_γ of a ball of the object on a curved surface of the body; return |∇F|.

    n rotates with the body and changes along the surface with the velocity of the ball.

    Args:
        shapes: SHAPE rows. at: the first one of this surface, see below. motion: `Motion`.
        column: COLUMN_WORK, filled (`believed`, too).
    """
    X_WO, _, R_E, _, V_rel, _ = motion
    p = rotated(X_WO, shapes[at].row)
    p_E = rotated_back(R_E, minus3(plus3(p, origin(X_WO)), origin(R_E)))
    v = velocity_at(V_rel, p)
    size, n, n_dot = normal_at(shapes, at, p_E, rotated_back(R_E, v))
    fill3(column.believed, scaled3(-1.0, n))
    n = rotated(R_E, minus3(column.turn, n))
    s = 1.0 / sqrt(dot3(n, n))
    n = scaled3(s, n)
    _line(column.N, p, n)
    bend = dot3(rotated(R_E, scaled3(s, n_dot)), add3(v, -dot3(n, v), n))
    column.n_gamma = _carried(p, n, motion) + bend
    return size


@leaf
def _vertex(row, X_WO, R_E):
    """Position of a vertex of the touched body from O (m, world axes); `row` has it in 3:6."""
    return minus3(plus3(origin(R_E), rotated(R_E, row[3:])), origin(X_WO))


@inner
def _face_on_vertex(row, motion, column):
    """Fill N and n_γ of a face of the object on a vertex of the touched body.

    Args:
        row: (16,) unit normal of the face in the object's axes (0:3), vertex in the body's frame
            (3:6, m), its radius (6, m).
        motion: `Motion`.
        column: COLUMN_WORK, filled.
    """
    X_WO, V_O, R_E, V_E, V_rel, _ = motion
    n = rotated(X_WO, plus3(row, column.turn))
    p = _vertex(row, X_WO, R_E)
    _line(column.N, p, n)
    rate = _rate(p, n, velocity_at(V_E, p), cross(V_O[3:], n))
    column.n_gamma = -dot6(rate, V_rel)


@inner
def _along_first(a, e, m, mm):
    """Solve s e_A − t e_E = a for s, in the plane perpendicular to m = e_A × e_E.

    Args:
        a: vector (m or m/s). e: direction e_E. m: e_A × e_E. mm: m · m.
    """
    return dot3(cross(a, e), m) / mm


@inner
def _turned_edge(row, R_E, turn):
    """Direction of the body's edge with its estimated turn: a unit vector in world axes."""
    f = plus3(row[9:], turn)
    return rotated(R_E, divided3(f, sqrt(dot3(f, f))))


@inner
def _crossing(row, X_WO, R_E, f):
    """Nearest points of two edges.

    Args:
        row: (16,) shape, see `_edges`. X_WO, R_E: (4, 4) poses of object and body. f: direction of
            the body's edge, in world axes.

    Returns:
        The point of the object's edge that is nearest to the body's edge (m, from O), and the
        vector from the declared point of the object's edge to that of the body's (m).
    """
    e = rotated(X_WO, row[3:])
    m = cross(e, f)
    q = rotated(X_WO, row)
    p = plus3(origin(R_E), rotated(R_E, row[6:]))
    apart = minus3(minus3(p, origin(X_WO)), q)
    return add3(q, _along_first(apart, f, m, dot3(m, m)), e), apart


@inner
def _edges(row, motion, column):
    """Fill N and n_γ of crossed edges; return the sine of the angle between them.

    Where the sine is near zero the column is not finite.

    Args:
        row: (16,) point and direction of the object's edge (0:3, 3:6), of the body's edge (6:9,
            9:12), side (12), outward normal of the body (13:16). A side of ±1 gives the sign of
            n = ±e × f; with 0 the outward normal determines it.
        motion: `Motion`.
        column: COLUMN_WORK, filled.
    """
    X_WO, V_O, R_E, V_E, V_rel, _ = motion
    e = rotated(X_WO, row[3:])
    f = _turned_edge(row, R_E, column.turn)
    m = cross(e, f)
    mm = dot3(m, m)
    sine = sqrt(mm)
    side = row[12]
    if side == 0.0:
        side = -dot3(rotated(R_E, row[13:]), m)
    n = scaled3(copysign(1.0 / sine, side), m)
    p, apart = _crossing(row, X_WO, R_E, f)
    gap = dot3(n, apart)
    m_dot = plus3(cross(cross(V_O[3:], e), f), cross(e, cross(V_E[3:], f)))
    n_dot = divided3(add3(m_dot, -dot3(n, m_dot), n), dot3(n, m))
    v_A = velocity_at(V_O, p)
    apart_dot = minus3(v_A, velocity_at(V_E, add3(p, gap, n)))
    s_dot = _along_first(add3(apart_dot, gap, n_dot), f, m, mm)
    _line(column.N, p, n)
    column.n_gamma = -dot6(_rate(p, n, add3(v_A, -s_dot, e), n_dot), V_rel)
    return sine


@inner
def permitted_motion(row, X_WO, R_E):
    """Twist at O (six numbers) of one freedom of a pair that is declared by its permitted motions.

    Args:
        row: point of the object (0:3), axis (3:6), kind (6): TURN about an axis of the object;
            SLIDE along an axis of the body; SCREW, a turn about the object's axis with a
            translation by the pitch (10, m/rad) along the body's axis 7:10.
        X_WO: (4, 4) pose of the object. R_E: (4, 4) pose of the touched body.
    """
    if row[6] == SLIDE:
        return join(rotated(R_E, row[3:]), ZERO_3)
    w = rotated(X_WO, row[3:])
    v = cross(rotated(X_WO, row), w)
    if row[6] == SCREW:
        v = add3(v, row[10], rotated(R_E, row[7:]))
    return join(v, w)


@inner
def _tangents(pair, shapes, motion, columns):
    """Fill N and n_γ = NᵀṪβ of a pair that is declared by its permitted motions T.

    Args:
        pair: PAIR row. Its shapes are those of the columns of N, then those of its freedoms (see
            `permitted_motion`).
        shapes: SHAPE rows. That of a column of N has a point of the object (0:3), a direction of
            the body (3:6) and a kind (6): FORCE along the direction through the point; COUPLE
            about the cross product of an arm of the object (0:3) and a direction of the body;
            THREAD, a force along the direction with a couple −pitch / cos about it, where 7:10
            is the object's axis, 10 the pitch (m/rad) and cos the cosine between both axes.
        motion: `Motion`.
        columns: COLUMN_WORK rows, filled.
    """
    X_WO, V_O, R_E, V_E, V_rel, _ = motion
    Tdot_beta = ZERO
    for k in range(pair.count, pair.count + pair.freedoms):
        row = shapes[pair.shape_at + k].row
        t = permitted_motion(row, X_WO, R_E)
        if row[6] == SLIDE:
            rate = dot3(t, velocity_at(V_rel, rotated(X_WO, row)))
            Tdot_beta = add(Tdot_beta, rate, cross_motion(V_E, t))
        else:
            Tdot_beta = add(Tdot_beta, dot3(t[3:], V_rel[3:]), cross_motion(V_O, t))
    for j in range(pair.count):
        row = shapes[pair.shape_at + j].row
        column = columns[pair.first + j]
        N = column.N
        p = rotated(X_WO, row)
        d = rotated(R_E, row[3:])
        if row[6] == COUPLE:
            fill(N, join(ZERO_3, cross(p, d)))
        else:
            _line(N, p, d)
        if row[6] == THREAD:
            f = row[10] / dot3(d, rotated(X_WO, row[7:]))
            fill(N, join(linear(N), add3(N[3:], -f, d)))
        column.n_gamma = dot6(N, Tdot_beta)


# --- Smooth surfaces: signed distance, normal and curvature at the foot of any point ------------
#
# A surface is F(x) = ½(q₁x² + q₂y² + q₃z²) + b z + c − h(x, y) = 0 in its own axes S; h is bicubic
# in each cell of a grid, or zero. The foot f of a point p solves p = f + λ∇F(f), F(f) = 0. There
# n = ∇F/|∇F| is the normal, and λ|∇F| the signed distance of p, whose gradient is n. Where p moves
# by v, f moves by df = (1 + λH)⁻¹(v − dλ ∇F) with ∇Fᵀdf = 0, and n by (1 − nnᵀ)H df/|∇F|.
#
# Its SHAPE rows are, in this order: 1. centre of the ball in the object (0:3), its radius (3), q
# (4:7), b, c (7, 8), corner of the grid (9, 10), cells per metre (11, 12), numbers of cells (13,
# 14; 0 without h); 2. R_ES by rows (0:9) and the origin of S in the body (9:12); 3. one row for
# each cell, in which 4 p + q holds the factor of uᵖvᵠ of h, with u, v = 0 … 1 along x, y.

_ITERATIONS = 25
_EXACT = 1e-28  #: m²; square of a Newton step that ends the iteration


@leaf
def is_near(step):
    """Whether a Newton step (three numbers, m) is small enough to end the iteration."""
    return dot3(step, step) < _EXACT


@leaf
def _cell(x, count):
    """Index of the grid cell that contains x, and the coordinate in it (0 … 1).

    The outermost cells extend to infinity, so that the coordinate may be beyond 0 … 1 there.

    Args:
        x: coordinate in cells. count: number of cells.
    """
    i = int(min(max(floor(x), 0.0), count - 1.0))
    return i, x - i


@inner
def _height(shapes, at, x, y):
    """Height h (m) of a gridded surface at (x, y), and its derivatives by x, y, xx, xy, yy."""
    row = shapes[at].row
    if row[13] == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    i, u = _cell((x - row[9]) * row[11], row[13])
    j, v = _cell((y - row[10]) * row[12], row[14])
    a = shapes[at + 2 + i * int(row[14]) + j].row
    h = h_u = h_uu = h_v = h_uv = h_vv = 0.0
    for k in range(3, -1, -1):  # Horner's scheme, differentiated
        f = ((a[4 * k + 3] * v + a[4 * k + 2]) * v + a[4 * k + 1]) * v + a[4 * k]
        f_v = (3.0 * a[4 * k + 3] * v + 2.0 * a[4 * k + 2]) * v + a[4 * k + 1]
        f_vv = 6.0 * a[4 * k + 3] * v + 2.0 * a[4 * k + 2]
        h_uu = h_uu * u + 2.0 * h_u
        h_u = h_u * u + h
        h = h * u + f
        h_uv = h_uv * u + h_v
        h_v = h_v * u + f_v
        h_vv = h_vv * u + f_vv
    s = row[11]
    r = row[12]
    return h, s * h_u, r * h_v, s * s * h_uu, s * r * h_uv, r * r * h_vv


@inner
def nearest(shapes, at, p):
    """Foot of a point on a surface, found by Newton's method.

    Args:
        shapes: SHAPE rows. at: the first one of the surface. p: point in the surface's axes S (m).

    Returns:
        λ, with p = foot + λ∇F; ∇F at the foot; the Hessian H there, as (xx, xy, yy, zz);
        (1 + λH)⁻¹, as (xx, xy, yy, zz).
    """
    row = shapes[at].row
    foot = p
    s = 0.0
    for _ in range(_ITERATIONS):
        x, y, z = foot
        h, h_x, h_y, h_xx, h_xy, h_yy = _height(shapes, at, x, y)
        g = (row[4] * x - h_x, row[5] * y - h_y, row[6] * z + row[7])
        F = 0.5 * (row[4] * x * x + row[5] * y * y + row[6] * z * z) + row[7] * z + row[8] - h
        H = (row[4] - h_xx, -h_xy, row[5] - h_yy, row[6])
        xx = 1.0 + s * H[0]
        xy = s * H[1]
        yy = 1.0 + s * H[2]
        det = xx * yy - xy * xy
        M = (yy / det, -xy / det, xx / det, 1.0 / (1.0 + s * H[3]))
        m = _times(M, g)
        off = add3(minus3(p, foot), -s, g)
        ds = (dot3(m, off) + F) / dot3(m, g)
        step = _times(M, add3(off, -ds, g))
        foot = plus3(foot, step)
        s = s + ds
        if is_near(step):
            break
    return s, g, H, M


@leaf
def _times(M, v):
    """Product of a symmetric matrix, given as (xx, xy, yy, zz), and a vector."""
    return M[0] * v[0] + M[1] * v[1], M[1] * v[0] + M[2] * v[1], M[3] * v[2]


@inner
def normal_at(shapes, at, p, v):
    """Gradient magnitude |∇F|, normal n and its rate dn/dt at the foot of a moving point.

    All vectors are in the axes of the touched body.

    Args:
        shapes: SHAPE rows. at: the first one of the surface. p: the point (m). v: its velocity
            (m/s).
    """
    seat = shapes[at + 1].row
    _, g, H, M = nearest(shapes, at, rotated9_back(seat, minus3(p, seat[9:])))
    size = sqrt(dot3(g, g))
    v_foot = _times(M, rotated9_back(seat, v))
    m = _times(M, g)
    bend = _times(H, add3(v_foot, -dot3(g, v_foot) / dot3(m, g), m))
    n_dot = divided3(add3(bend, -dot3(g, bend) / (size * size), g), size)
    return size, rotated9(seat, divided3(g, size)), rotated9(seat, n_dot)
