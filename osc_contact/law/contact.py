"""Contact geometry of every packaged pair, and the estimate of contact normals."""

from __future__ import annotations

from collections import namedtuple
from math import copysign, sqrt

from osc_contact.law.jit import call_at, inner, leaf
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
from osc_contact.law.surface import normal_at
from osc_contact.law.vectors import (
    ZERO,
    add,
    cross,
    dot6,
    fill,
    minus,
    rotated,
    rotated_back,
    velocity_at,
)

# --- Estimation of contact normals from sliding ---------------------------------------------------
#
# A point that slides at v_t along a face whose normal n is wrong by ε leaves the face that is
# believed in at v = εᵀv_t. Where one point touches one face, n is turned until it does not; what is
# left, where nothing slides, is v̄ of `steps`. Where edges cross, that of the body is turned: its
# part g along n shows. docs/tuning.md: what it brings, and why it is stable.
#
# The covariance P of the error goes with the estimate. What n does not explain, such as a face that
# yields, is new every 1/c; r is its mean square, without what is faster than 4c. With ĝ along v_t,
#
#     κ = c dt σ λ,   λ = p/(p + r),   p = |v_t|² ĝᵀPĝ
#     P ← (1 − κĝĝᵀ) P (1 − κĝĝᵀ) + κ²/(c dt) r/|v_t|² ĝĝᵀ
#
# from P_0 of a cone of the half angle `tilt`, its square over 4 in each direction. What n has no
# share in, 1 − σλ, v̄ takes.

_LEAST_SQUARE = 1e-30  # (m/s)²
_FASTER = 4.0  # c, of the low-pass
_SLIDES = 0.01  #: v_1 (m/s): faster than that a point shows the tilt of its face


@inner
def take_turns(t):
    """v̄ and the turns of assumed normals, as the last tick left them."""
    for j in range(t.model.n_columns):
        row = t.work.columns[j]
        last = t.memory.columns[j]
        row.drift = last.drift
        row.slides = 0.0
        row.lever = 0.0
        for i in range(3):
            row.turn[i] = row.turned[i] = last.turn[i]
        for i in range(9):
            row.prior[i] = 0.0


@inner
def follow_face(t, pair, X_WO, R_E, V_rel, V_goal):
    """Fill `turned` and `slides` (0 … 1): the face turned to what is seen to slide on it.

        n ← n − κ (NᵀV_rel − v̄) v_t / v_t²,   σ = v_t⁴ / (v_t⁴ + v_1⁴)

    v_t is the velocity desired of the point along the face: noise turns nothing, nor does
    what stands still. n stays within `tilt` of what is assumed, in the axes that carry the face;
    what is beyond v̄ takes. Where the face is curved n is that of the place where it is touched: a
    ball that is misplaced by δ is so turned by −δ/R everywhere.

    Args:
        pair: of one column, its N, `turn` and `drift` known. X_WO: of the object. R_E: of the body.
        V_rel, V_goal: (6,) at O, measured and desired, against the body.
    """
    model = t.model
    column = t.work.columns[pair.first]
    N = column.N
    turn = column.turn
    turned = column.turned
    believed = column.believed
    kind = pair.kind
    x, y, z = _tracked(pair, model.shapes, X_WO, R_E, column)
    size = N[0] * N[0] + N[1] * N[1] + N[2] * N[2]
    a, b, c = velocity_at(V_goal, x, y, z)
    s = (N[0] * a + N[1] * b + N[2] * c) / size
    a = a - s * N[0]
    b = b - s * N[1]
    c = c - s * N[2]
    if kind == EDGES:
        a, b, c = _shown_by_edges(pair, model.shapes, X_WO, R_E, column, (a, b, c))
    square = a * a + b * b + c * c
    column.lever = square
    column.unexplained = (dot6(N, V_rel) - column.drift) / sqrt(size)
    s = 1.0 / sqrt(size)
    n = (s * N[0], s * N[1], s * N[2])
    if kind == FACE_ON_VERTEX:
        turned[0], turned[1], turned[2] = rotated_back(X_WO, a, b, c)
        n = rotated_back(X_WO, n[0], n[1], n[2])
    else:
        turned[0], turned[1], turned[2] = rotated_back(R_E, a, b, c)
        n = rotated_back(R_E, n[0], n[1], n[2])
    s = 1.0 / sqrt(max(square, _LEAST_SQUARE))
    for i in range(3):
        column.shown[i] = s * turned[i]
        for j in range(3):  # of the turn of a face across n, of an edge along n
            across = (1.0 if i == j else 0.0) - n[i] * n[j]
            share = n[i] * n[j] if kind == EDGES else across
            column.prior[3 * i + j] = 0.25 * model.tilt * model.tilt * share
    last = t.memory.columns[pair.first]
    expected = square * _quadratic(last.covariance, column.shown)
    column.slides = square * square / (square * square + _SLIDES**4)
    if expected > 0.0:
        column.slides *= expected / (expected + last.residual)
    gain = model.drift_share * column.slides * column.unexplained / max(square, _LEAST_SQUARE)
    size = off = 0.0
    for i in range(3):
        turned[i] = believed[i] + turn[i] - gain * turned[i]
        size += turned[i] * turned[i]
    size = sqrt(size)
    for i in range(3):
        turned[i] = turned[i] / size - believed[i]
        off += turned[i] * turned[i]
    off = sqrt(off)
    if off > model.tilt:
        column.slides = 0.0
        for i in range(3):
            turned[i] *= model.tilt / off


@inner
def _shown_by_edges(pair, shapes, X_WO, R_E, column, v):
    """g = ±(v_t × e)/|e × f|: turning E's edge f by δ turns n so that NᵀV_rel changes by gᵀδ."""
    row = shapes[pair.shape_at].row
    N = column.N
    e = rotated(X_WO, row[3], row[4], row[5])
    f = _turned_edge(row, R_E, column.turn)
    m = cross(e[0], e[1], e[2], f[0], f[1], f[2])
    s = 1.0 / (N[0] * m[0] + N[1] * m[1] + N[2] * m[2])
    a, b, c = cross(v[0], v[1], v[2], e[0], e[1], e[2])
    return s * a, s * b, s * c


@inner
def _quadratic(P, u):
    """uᵀPu."""
    s = 0.0
    for i in range(3):
        s += u[i] * (P[3 * i] * u[0] + P[3 * i + 1] * u[1] + P[3 * i + 2] * u[2])
    return s


@leaf
def learn_normal(share, last, column):
    """Covariance, largest standard deviation and residual after a tick.

    Args:
        share: c dt of the estimate. last: COLUMN_MEMORY, changed. column: COLUMN_WORK.
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
    x = P[0] * u[0] + P[1] * u[1] + P[2] * u[2]
    y = P[3] * u[0] + P[4] * u[1] + P[5] * u[2]
    z = P[6] * u[0] + P[7] * u[1] + P[8] * u[2]
    w = (x, y, z)
    noise = last.residual / (max(column.lever, _LEAST_SQUARE) * max(share, 1e-12))
    s = k * k * (u[0] * x + u[1] * y + u[2] * z + noise)
    for i in range(3):
        for j in range(3):
            P[3 * i + j] += s * u[i] * u[j] - k * (w[i] * u[j] + u[i] * w[j])
    half = 0.5 * (P[0] + P[4] + P[8])  # of a matrix of rank two
    minors = P[0] * P[4] - P[1] * P[3] + P[0] * P[8] - P[2] * P[6] + P[4] * P[8] - P[5] * P[7]
    last.normal_std = sqrt(half + sqrt(max(half * half - minors, 0.0)))


@inner
def _tracked(pair, shapes, X_WO, R_E, column):
    """The point whose motion shows how its face is turned, from O; `believed` ← that normal."""
    if pair.kind == GIVEN or pair.kind == FUNCTION:
        return column.point[0], column.point[1], column.point[2]
    row = shapes[pair.shape_at].row
    if pair.kind != SURFACE:
        first = 0 if pair.kind == FACE_ON_VERTEX else 9 if pair.kind == EDGES else 3
        for i in range(3):
            column.believed[i] = row[first + i]
    if pair.kind == FACE_ON_VERTEX:
        return _vertex(row, X_WO, R_E)
    if pair.kind == EDGES:
        return _crossing(row, X_WO, R_E, _turned_edge(row, R_E, column.turn))[0]
    return rotated(X_WO, row[0], row[1], row[2])


@inner
def _turn_given(column, R_E):
    """N of one column that Python gave, turned with its normal about where it acts."""
    N = column.N
    turn = column.turn
    size = sqrt(N[0] * N[0] + N[1] * N[1] + N[2] * N[2])
    a, b, c = rotated_back(R_E, N[0] / size, N[1] / size, N[2] / size)
    column.believed[0] = a
    column.believed[1] = b
    column.believed[2] = c
    if turn[0] == 0.0 and turn[1] == 0.0 and turn[2] == 0.0:
        return
    a = a + turn[0]
    b = b + turn[1]
    c = c + turn[2]
    size = size / sqrt(a * a + b * b + c * c)
    a, b, c = rotated(R_E, size * a, size * b, size * c)
    _line(N, column.point[0], column.point[1], column.point[2], a, b, c)


# --- N and n_γ at the operational point, in world axes, of every packaged pair --------------------
#
# A PAIR names its kind, its first column of N, their number, and the first SHAPE of its geometry;
# what the numbers of a shape are is given with each function. Positions are from O, motions at O.
# Matrices are read element by element, so the functions run as they are on numbers and on arrays of
# numbers over time (`contacts.pairs.law_pair`).

PARALLEL = 1e-6  #: sine of the angle below which two edges have no common normal
AHEAD = 2.0  #: control periods after its measurement at which a torque acts at the latest

#: X_WO: (4, 4) pose of the object. R_E: the same of the touched body. V_O, V_E, V_rel: (6,) twists
#: at O of the object, of the body, of one against the other. moving: False: the body rests in the
#: world.
Motion = namedtuple("Motion", "X_WO V_O R_E V_E V_rel moving")


@leaf
def _line(N, x, y, z, a, b, c):
    """N = W(n, p) = [n; p × n], the line of force along n = (a, b, c) through p = (x, y, z)."""
    N[0] = a
    N[1] = b
    N[2] = c
    N[3], N[4], N[5] = cross(x, y, z, a, b, c)


@inner
def place_contacts(t):
    """Fill N, n_γ and friction wrenches of all columns; False where a pair is degenerate.

    Of pairs that Python evaluates (GIVEN) N, n_γ and points are there, those of FUNCTION pairs come
    from the user's compiled function. Friction is that of the slip to come, when the torques of
    this tick act: where a motion turns back it changes its sign within milliseconds.
    """
    model = t.model
    shapes = model.shapes
    columns = t.work.columns
    X_WO = t.work.X_WO
    V_O = t.work.V_O
    moving = t.work.moving
    work = t.work
    R_E = work.X_WE
    V_E = work.u
    V_rel = work.w
    for i in range(4):
        for j in range(4):
            R_E[i, j] = 1.0 if i == j else 0.0
    fill(V_E, ZERO)
    fill(V_rel, V_O)
    for c in range(model.n_pairs):
        pair = model.pairs[c]
        if moving:
            E = t.input.touched[c]
            for i in range(3):
                for j in range(4):
                    R_E[i, j] = E[4 * i + j]
            x, y, z = cross(
                E[19], E[20], E[21], X_WO[0, 3] - E[3], X_WO[1, 3] - E[7], X_WO[2, 3] - E[11]
            )
            V_E[0] = E[16] + x
            V_E[1] = E[17] + y
            V_E[2] = E[18] + z
            V_E[3] = E[19]
            V_E[4] = E[20]
            V_E[5] = E[21]
            fill(V_rel, minus(V_O, V_E))
        alone = pair.count == 1 and pair.has_friction != 0
        given = pair.kind == GIVEN or pair.kind == FUNCTION
        if pair.kind == FUNCTION:
            row = shapes[pair.shape_at].row
            call_at(pair.address, X_WO, V_O, R_E, V_E, row, work.evaluated)
            if not _take_evaluated(columns, pair.first, pair.count, work.evaluated):
                return False
        if not given:
            motion = Motion(work.X_WO, work.V_O, R_E, V_E, V_rel, moving)
            sine = place_pair(pair, shapes, columns, motion, work.y)
            if not sine >= PARALLEL:
                return False
        elif alone:
            _turn_given(columns[pair.first], R_E)
        if alone and model.tilt > 0.0:
            fill(work.z, minus(work.V_D, V_E))
            follow_face(t, pair, X_WO, R_E, V_rel, work.z)
        if pair.has_friction != 0 and (work.mu > 0.0 or model.reading == LEAST_SQUARES):
            fill(work.z, add(V_rel, AHEAD * model.period, work.A_D))
            for j in range(pair.count):
                column = columns[pair.first + j]
                x, y, z = column.point[0], column.point[1], column.point[2]
                if not given:
                    row = shapes[pair.shape_at + j].row
                    x, y, z = point_of_contact(pair.kind, row, X_WO, R_E, column.N)
                _slide((x, y, z), work.z, work.mu, model.slip, column)
    return True


@inner
def _take_evaluated(columns, first, count, evaluated):
    """N, n_γ and points of contact as a FUNCTION pair returned them; whether they are finite."""
    zero = 0.0
    for j in range(count):
        column = columns[first + j]
        given = evaluated[j]
        for i in range(6):
            column.N[i] = given[i]
            zero += 0.0 * given[i]
        column.n_gamma_all = given[6]
        zero += 0.0 * given[6]
        for i in range(3):
            column.point[i] = given[8 + i]
            zero += 0.0 * given[8 + i]
    return zero == 0.0


@inner
def place_pair(pair, shapes, columns, motion, scratch):
    """Fill N and n_γ of one pair's columns.

    Args:
        pair: PAIR row. shapes: SHAPE rows. columns: COLUMN_WORK rows. motion: of object and body.
        scratch: (6,).

    Returns:
        What decides whether N exists: the sine of the angle between two edges, the gradient of a
        surface; else 1.
    """
    first = pair.first
    shape = pair.shape_at
    if pair.kind == POINTS:
        for j in range(pair.count):
            _point_on_plane(shapes[shape + j].row, motion, columns[first + j])
    elif pair.kind == FACE_ON_VERTEX:
        _face_on_vertex(shapes[shape].row, motion, columns[first], scratch)
    elif pair.kind == SURFACE:
        return _on_surface(shapes, shape, motion, columns[first])
    elif pair.kind == EDGES:
        return _edges(shapes[shape].row, motion, columns[first], scratch)
    else:
        _tangents(pair, shapes, motion, columns, scratch)
    return 1.0


@inner
def _point_on_plane(row, motion, column):
    """A point of A (0:3) on a plane of E with direction into it (3:6), distance (6) along."""
    X_WO, _, R_E, _, _, moving = motion
    x, y, z = rotated(X_WO, row[0], row[1], row[2])
    turn = column.turn
    a = row[3] + turn[0]
    b = row[4] + turn[1]
    c = row[5] + turn[2]
    if moving:
        a, b, c = rotated(R_E, a, b, c)
    _line(column.N, x, y, z, a, b, c)
    column.n_gamma_all = _carried((x, y, z), (a, b, c), motion)


@inner
def _carried(p, n, motion):
    """−ṄᵀV_rel where A carries p and E carries n, both in world axes, p from O."""
    _, V_O, _, V_E, V_rel, moving = motion
    u, v, w = velocity_at(V_O, p[0], p[1], p[2])
    u, v, w = cross(V_rel[3], V_rel[4], V_rel[5], u, v, w)
    s = -(n[0] * u + n[1] * v + n[2] * w)
    if moving:
        a, b, c = cross(V_E[3], V_E[4], V_E[5], n[0], n[1], n[2])
        u, v, w = velocity_at(V_rel, p[0], p[1], p[2])
        s -= a * u + b * v + c * w
    return s


@inner
def point_of_contact(kind, row, X_WO, R_E, N):
    """Where a magnitude of a pair that pushes acts, from O: plane, ball, vertex or object's edge.

    Args:
        kind: of the pair. row: (16,) of the column. X_WO: of the object. R_E: axes of the body.
        N: (6,) line of force at O.
    """
    if kind == POINTS:
        x, y, z = rotated(X_WO, row[0], row[1], row[2])
        a, b, c = rotated(R_E, row[3], row[4], row[5])  # of the assumed plane
        ahead = row[6] + a * (R_E[0, 3] - X_WO[0, 3] - x)
        ahead += b * (R_E[1, 3] - X_WO[1, 3] - y) + c * (R_E[2, 3] - X_WO[2, 3] - z)
        return x + ahead * N[0], y + ahead * N[1], z + ahead * N[2]
    if kind == SURFACE:
        x, y, z = rotated(X_WO, row[0], row[1], row[2])
        return x + row[3] * N[0], y + row[3] * N[1], z + row[3] * N[2]
    if kind == FACE_ON_VERTEX:
        x, y, z = _vertex(row, X_WO, R_E)
        return x - row[6] * N[0], y - row[6] * N[1], z - row[6] * N[2]
    return _crossing(row, X_WO, R_E, rotated(R_E, row[9], row[10], row[11]))[0]


@inner
def _slide(point, V_rel, mu, slip, column):
    """s = v_t / √(v_t² + v_0²) at the point of contact p, and friction μ [s; p × s] there."""
    N = column.N
    a = N[0]
    b = N[1]
    c = N[2]
    x, y, z = point
    u, v, w = velocity_at(V_rel, x, y, z)
    s = (a * u + b * v + c * w) / (a * a + b * b + c * c)
    u = u - s * a
    v = v - s * b
    w = w - s * c
    s = 1.0 / sqrt(u * u + v * v + w * w + slip * slip)
    u = s * u
    v = s * v
    w = s * w
    column.point[0] = x
    column.point[1] = y
    column.point[2] = z
    column.slip[0] = u
    column.slip[1] = v
    column.slip[2] = w
    _line(column.friction_wrench, x, y, z, mu * u, mu * v, mu * w)


@inner
def _rate(p, n, p_dot, n_dot, out):
    """Ẇ(n, p) = [ṅ; ṗ × n + p × ṅ]."""
    x, y, z = cross(p_dot[0], p_dot[1], p_dot[2], n[0], n[1], n[2])
    a, b, c = cross(p[0], p[1], p[2], n_dot[0], n_dot[1], n_dot[2])
    out[0] = n_dot[0]
    out[1] = n_dot[1]
    out[2] = n_dot[2]
    out[3] = x + a
    out[4] = y + b
    out[5] = z + c


@inner
def _on_surface(shapes, at, motion, column):
    """A ball of A on a surface of E (see `surface`); returns |∇F|.

    ṅ = ω_E × n, as on a plane, and what n changes by along the surface.
    """
    X_WO, _, R_E, _, V_rel, _ = motion
    ball = shapes[at].row
    turn = column.turn
    believed = column.believed
    x, y, z = rotated(X_WO, ball[0], ball[1], ball[2])
    p = rotated_back(
        R_E,
        x + X_WO[0, 3] - R_E[0, 3],
        y + X_WO[1, 3] - R_E[1, 3],
        z + X_WO[2, 3] - R_E[2, 3],
    )
    u, v, w = velocity_at(V_rel, x, y, z)
    size, n, n_dot = normal_at(shapes, at, p, rotated_back(R_E, u, v, w))
    for i in range(3):
        believed[i] = -n[i]
    a, b, c = rotated(R_E, turn[0] - n[0], turn[1] - n[1], turn[2] - n[2])
    s = 1.0 / sqrt(a * a + b * b + c * c)
    a, b, c = s * a, s * b, s * c
    d, e, f = rotated(R_E, s * n_dot[0], s * n_dot[1], s * n_dot[2])
    _line(column.N, x, y, z, a, b, c)
    s = a * u + b * v + c * w
    bend = d * (u - s * a) + e * (v - s * b) + f * (w - s * c)
    column.n_gamma_all = _carried((x, y, z), (a, b, c), motion) + bend
    return size


@leaf
def _vertex(row, X_WO, R_E):
    """A vertex of E (3:6 of a shape), from O."""
    x, y, z = rotated(R_E, row[3], row[4], row[5])
    return x + R_E[0, 3] - X_WO[0, 3], y + R_E[1, 3] - X_WO[1, 3], z + R_E[2, 3] - X_WO[2, 3]


@inner
def _face_on_vertex(row, motion, column, rate):
    """Row: normal of A's face (0:3), vertex of E (3:6), its radius (6)."""
    X_WO, V_O, R_E, V_E, V_rel, _ = motion
    turn = column.turn
    n = rotated(X_WO, row[0] + turn[0], row[1] + turn[1], row[2] + turn[2])
    p = _vertex(row, X_WO, R_E)
    _line(column.N, p[0], p[1], p[2], n[0], n[1], n[2])
    n_dot = cross(V_O[3], V_O[4], V_O[5], n[0], n[1], n[2])
    _rate(p, n, velocity_at(V_E, p[0], p[1], p[2]), n_dot, rate)
    column.n_gamma_all = -dot6(rate, V_rel)


@inner
def _along_first(a, e, m, mm):
    """s with s e_A − t e_E = a in the plane ⟂ m = e_A × e_E."""
    x, y, z = cross(a[0], a[1], a[2], e[0], e[1], e[2])
    return (x * m[0] + y * m[1] + z * m[2]) / mm


@inner
def _turned_edge(row, R_E, turn):
    """The direction of E's edge, a unit vector, as it is taken to be."""
    a = row[9] + turn[0]
    b = row[10] + turn[1]
    c = row[11] + turn[2]
    size = sqrt(a * a + b * b + c * c)
    return rotated(R_E, a / size, b / size, c / size)


@inner
def _crossing(row, X_WO, R_E, f):
    """Where A's edge comes nearest to E's, f, from O, and a point of E's edge from one of A's."""
    e = rotated(X_WO, row[3], row[4], row[5])
    m = cross(e[0], e[1], e[2], f[0], f[1], f[2])
    q = rotated(X_WO, row[0], row[1], row[2])
    x, y, z = rotated(R_E, row[6], row[7], row[8])
    apart = (
        x + R_E[0, 3] - X_WO[0, 3] - q[0],
        y + R_E[1, 3] - X_WO[1, 3] - q[1],
        z + R_E[2, 3] - X_WO[2, 3] - q[2],
    )
    s = _along_first(apart, f, m, m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
    return (q[0] + s * e[0], q[1] + s * e[1], q[2] + s * e[2]), apart


@inner
def _edges(row, motion, column, rate):
    """Row: point, direction of A's edge (0:3, 3:6), of E's (6:9, 9:12), side (12), normal (13:16).

    The side is ±1, or 0 where the environment's outward normal determines it. Returns the sine of
    the edges' angle; near zero the column is not a number.
    """
    X_WO, V_O, R_E, V_E, V_rel, _ = motion
    e = rotated(X_WO, row[3], row[4], row[5])
    f = _turned_edge(row, R_E, column.turn)
    m = cross(e[0], e[1], e[2], f[0], f[1], f[2])
    mm = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    sine = sqrt(mm)
    side = row[12]
    if side == 0.0:
        o = rotated(R_E, row[13], row[14], row[15])
        side = -(o[0] * m[0] + o[1] * m[1] + o[2] * m[2])
    scale = copysign(1.0 / sine, side)
    n = (scale * m[0], scale * m[1], scale * m[2])
    p, apart = _crossing(row, X_WO, R_E, f)
    gap = n[0] * apart[0] + n[1] * apart[1] + n[2] * apart[2]
    a = cross(V_O[3], V_O[4], V_O[5], e[0], e[1], e[2])
    a = cross(a[0], a[1], a[2], f[0], f[1], f[2])
    b = cross(V_E[3], V_E[4], V_E[5], f[0], f[1], f[2])
    b = cross(e[0], e[1], e[2], b[0], b[1], b[2])
    w = (a[0] + b[0], a[1] + b[1], a[2] + b[2])
    along = n[0] * w[0] + n[1] * w[1] + n[2] * w[2]
    size = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
    n_dot = (
        (w[0] - along * n[0]) / size,
        (w[1] - along * n[1]) / size,
        (w[2] - along * n[2]) / size,
    )
    u = velocity_at(V_O, p[0], p[1], p[2])
    v = velocity_at(V_E, p[0] + gap * n[0], p[1] + gap * n[1], p[2] + gap * n[2])
    slip = (
        u[0] - v[0] + gap * n_dot[0],
        u[1] - v[1] + gap * n_dot[1],
        u[2] - v[2] + gap * n_dot[2],
    )
    s = _along_first(slip, f, m, mm)
    _line(column.N, p[0], p[1], p[2], n[0], n[1], n[2])
    _rate(p, n, (u[0] - s * e[0], u[1] - s * e[1], u[2] - s * e[2]), n_dot, rate)
    column.n_gamma_all = -dot6(rate, V_rel)
    return sine


@inner
def permitted_motion(row, X_WO, R_E):
    """A motion t (6 numbers) that a pair given by T permits.

    Args:
        row: point of A (0:3), axis (3:6), kind (6): TURN about A's axis, carried by A; SLIDE along
            E's axis, carried by E; SCREW, the turn and a slide of pitch (10) along 7:10 of E.
        X_WO: pose of the object. R_E: axes of the body.
    """
    p = rotated(X_WO, row[0], row[1], row[2])
    if row[6] == SLIDE:
        d = rotated(R_E, row[3], row[4], row[5])
        return d[0], d[1], d[2], 0.0, 0.0, 0.0
    w = rotated(X_WO, row[3], row[4], row[5])
    t = cross(p[0], p[1], p[2], w[0], w[1], w[2])
    if row[6] == SCREW:
        d = rotated(R_E, row[7], row[8], row[9])
        t = (t[0] + row[10] * d[0], t[1] + row[10] * d[1], t[2] + row[10] * d[2])
    return t[0], t[1], t[2], w[0], w[1], w[2]


@inner
def _add_carried(V, t, rate, out):
    """out (6,) ← out + V × t · rate: what a motion gains that a body of twist V carries."""
    a = cross(V[3], V[4], V[5], t[0], t[1], t[2])
    b = cross(V[0], V[1], V[2], t[3], t[4], t[5])
    c = cross(V[3], V[4], V[5], t[3], t[4], t[5])
    for i in range(3):
        out[i] += rate * (a[i] + b[i])
        out[3 + i] += rate * c[i]


@inner
def _tangents(pair, shapes, motion, columns, Tdot_beta):
    """The pairs given by T: n_γ = NᵀṪβ.

    Shapes of the columns of N first, then those of its freedoms (`permitted_motion`). Row of a
    column: point of A (0:3), direction of E (3:6), kind (6): FORCE along the direction through the
    point; COUPLE about (arm of A × mark of E); THREAD of a screw, a force along the direction and a
    couple −pitch / cos about it; axis of A (7:10), pitch (10).
    """
    X_WO, V_O, R_E, V_E, V_rel, _ = motion
    r = pair.count
    freedoms = pair.freedoms
    fill(Tdot_beta, ZERO)
    for k in range(r, r + freedoms):
        row = shapes[pair.shape_at + k].row
        t = permitted_motion(row, X_WO, R_E)
        if row[6] == SLIDE:
            p = rotated(X_WO, row[0], row[1], row[2])
            v = velocity_at(V_rel, p[0], p[1], p[2])
            _add_carried(V_E, t, t[0] * v[0] + t[1] * v[1] + t[2] * v[2], Tdot_beta)
        else:
            rate = t[3] * V_rel[3] + t[4] * V_rel[4] + t[5] * V_rel[5]
            _add_carried(V_O, t, rate, Tdot_beta)
    for j in range(r):
        row = shapes[pair.shape_at + j].row
        N = columns[pair.first + j].N
        p = rotated(X_WO, row[0], row[1], row[2])
        d = rotated(R_E, row[3], row[4], row[5])
        if row[6] == COUPLE:
            m = cross(p[0], p[1], p[2], d[0], d[1], d[2])
            for i in range(3):
                N[i] = 0.0
                N[3 + i] = m[i]
        else:
            _line(N, p[0], p[1], p[2], d[0], d[1], d[2])
            if row[6] == THREAD:
                w = rotated(X_WO, row[7], row[8], row[9])
                f = row[10] / (d[0] * w[0] + d[1] * w[1] + d[2] * w[2])
                for i in range(3):
                    N[3 + i] -= f * d[i]
        columns[pair.first + j].n_gamma_all = dot6(N, Tdot_beta)
