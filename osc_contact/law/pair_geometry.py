"""Geometry of every packaged pair: N and n_γ of its columns, points and permitted motions."""

from __future__ import annotations

from collections import namedtuple
from math import copysign, sqrt

from osc_contact.law.jit import inner, leaf
from osc_contact.law.records import (
    COUPLE,
    EDGES,
    FACE_ON_VERTEX,
    POINTS,
    SCREW,
    SLIDE,
    SURFACE,
    THREAD,
)
from osc_contact.law.surfaces import normal_at
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    add,
    add3,
    cross,
    cross_motion,
    divided3,
    dot3,
    dot6,
    fill,
    fill3,
    join,
    linear,
    minus3,
    origin,
    plus3,
    rotated,
    rotated_back,
    scaled3,
    velocity_at,
)

# --- N and n_γ at the operational point, in world axes, of every packaged pair --------------------
#
# A PAIR has its kind, its first column of N, the number of its columns, and the first SHAPE of its
# geometry; the docstring of each function lists the numbers of its shape. Positions are from O,
# twists at O. Matrices are read element by element, so that the same functions work on numbers and
# on arrays of numbers over time (`contacts.pairs.pair`).

PARALLEL = 1e-6  #: sine of the angle below which two edges have no common normal

#: X_WO, X_WE: (4, 4) poses of the object and of the touched body. V_O, V_E: (6,) their twists at O.
#: V_rel: (6,) twist of the object relative to the body, at O. moving: False if the body rests.
Motion = namedtuple("Motion", "X_WO V_O X_WE V_E V_rel moving")


@leaf
def fill_line(N, p, n):
    """Fill a column of N with [n; p × n], the wrench at O of a unit force.

    Args:
        N: (6,) column, filled.
        p: (3,) point on the line of the force, from O (m).
        n: (3,) unit vector along the force.
    """
    fill(N, join(n, cross(p, n)))


@inner
def place_pair(pair, shapes, columns, motion):
    """Fill N and n_γ of one pair's columns.

    N (6,) is the wrench at O of a unit contact force, n_γ (m/s², rad/s²) the normal acceleration by
    the rotation of N, both by the rule for the kind of the pair. Of SURFACE pairs `believed` is
    filled, too.

    Args:
        pair: PAIR row.
        shapes: SHAPE rows.
        columns: COLUMN_WORK rows.
        motion: `Motion`: poses X_WO, X_WE (4, 4) of object and touched body, twists V_O, V_E (6,)
            and V_rel = V_O − V_E at O, and whether motions of touched bodies are measured.

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
        motion: `Motion`: poses X_WO, X_WE (4, 4) of object and touched body, twists V_O, V_E (6,)
            and V_rel = V_O − V_E at O, and whether motions of touched bodies are measured.
        column: COLUMN_WORK, of which `turn` is read and N and `n_gamma` are filled.
    """
    p = rotated(motion.X_WO, row)
    n = plus3(row[3:], column.turn)
    if motion.moving:
        n = rotated(motion.X_WE, n)
    fill_line(column.N, p, n)
    column.n_gamma = _normal_acceleration(p, n, motion)


@inner
def _normal_acceleration(p, n, motion):
    """Normal acceleration n_γ = −ṄᵀV_rel (m/s²) of a column N = [n; p × n] of contact force.

    Ṅ is the rate of the column, V_rel the twist of the object relative to the touched body.

    Args:
        p: point of contact, fixed to the object: its position from O (m), world axes.
        n: normal into the body, fixed to the body: unit vector, world axes.
        motion: `Motion`: poses X_WO, X_WE (4, 4) of object and touched body, twists V_O, V_E (6,)
            and V_rel = V_O − V_E at O, and whether motions of touched bodies are measured.
    """
    V_rel = motion.V_rel
    s = -dot3(n, cross(V_rel[3:], velocity_at(motion.V_O, p)))
    if motion.moving:
        s -= dot3(cross(motion.V_E[3:], n), velocity_at(V_rel, p))
    return s


@inner
def point_of_contact(kind, row, X_WO, X_WE, N):
    """Point of contact (m, from O, world axes) of a column of a pair with unilateral contact.

    It is, by the kind of the pair, with numbers of `row` in brackets:

    * POINTS: the projection of a point of the object (0:3) on the plane of the touched body with
      the normal (3:6) and the offset (6) in axes of the body;
    * SURFACE: the point of a ball, of centre (0:3) and distance to its surface (3);
    * FACE_ON_VERTEX: the vertex of the body, less its radius (6);
    * EDGES: the point of the object's edge next to the body's edge of direction (9:12).

    Args:
        kind: kind of the pair (`records.POINTS`, `records.FACE_ON_VERTEX`, `records.EDGES` or
            `records.SURFACE`).
        row: (16,) SHAPE of the column.
        X_WO, X_WE: (4, 4) poses of the object and the touched body.
        N: (6,) column [n; p × n] at O, in world axes; n is read.
    """
    if kind == FACE_ON_VERTEX:
        return add3(vertex(row, X_WO, X_WE), -row[6], N)
    if kind == EDGES:
        return crossing(row, X_WO, X_WE, rotated(X_WE, row[9:]))[0]
    p = rotated(X_WO, row)
    ahead = row[3]
    if kind == POINTS:  # to the assumed plane
        x, y, z = minus3(minus3(origin(X_WE), origin(X_WO)), p)
        a, b, c = rotated(X_WE, row[3:])
        ahead = row[6] + a * x + (b * y + c * z)
    return add3(p, ahead, N)


@inner
def _rate(p, n, p_dot, n_dot):
    """Time derivative of a line of force N = [n; p × n]: Ṅ = [ṅ; ṗ × n + p × ṅ], six numbers.

    Args:
        p: (3,) point from O (m).
        n: (3,) unit vector.
        p_dot: (3,) ṗ (m/s).
        n_dot: (3,) ṅ (1/s).
    """
    return join(n_dot, plus3(cross(p_dot, n), cross(p, n_dot)))


@inner
def _on_surface(shapes, at, motion, column):
    """Fill N and n_γ of a ball of the object on a curved surface of the body; return |∇F|.

    n (3,), the unit normal at the nearest point of the surface, rotates with the body and changes
    along the surface with the velocity of the ball. The estimated turn of the normal (`turn` of the
    column) is subtracted, and n normalised again.

    Args:
        shapes: SHAPE rows.
        at: index of the first SHAPE row of this surface, see `surfaces`.
        motion: `Motion`: poses X_WO, X_WE (4, 4) of object and touched body, twists V_O, V_E (6,)
            and V_rel = V_O − V_E at O, and whether motions of touched bodies are measured.
        column: COLUMN_WORK, of which `turn` is read and N, `n_gamma` and `believed`, the declared
            normal in the axes of the body, are filled.
    """
    X_WO, _, X_WE, _, V_rel, _ = motion
    p = rotated(X_WO, shapes[at].row)
    p_E = rotated_back(X_WE, minus3(plus3(p, origin(X_WO)), origin(X_WE)))  # in the body's frame
    v = velocity_at(V_rel, p)
    size, n, n_dot = normal_at(shapes, at, p_E, rotated_back(X_WE, v))
    fill3(column.believed, scaled3(-1.0, n))
    n = rotated(X_WE, minus3(column.turn, n))
    s = 1.0 / sqrt(dot3(n, n))
    n = scaled3(s, n)
    fill_line(column.N, p, n)
    # normal acceleration by the curvature, with the velocity v − (n·v) n along the surface
    bend = dot3(rotated(X_WE, scaled3(s, n_dot)), add3(v, -dot3(n, v), n))
    column.n_gamma = _normal_acceleration(p, n, motion) + bend
    return size


@leaf
def vertex(row, X_WO, X_WE):
    """Position of a vertex of the touched body from O (m, world axes).

    Args:
        row: (16,) shape with the vertex in 3:6 (m, in the body's frame).
        X_WO: (4, 4) pose of the object.
        X_WE: (4, 4) pose of the touched body.
    """
    return minus3(plus3(origin(X_WE), rotated(X_WE, row[3:])), origin(X_WO))


@inner
def _face_on_vertex(row, motion, column):
    """Fill N and n_γ of a face of the object on a vertex of the touched body.

    The outward normal n of the object's face points into the body: the force of the object acts
    along it. N = [n; p × n] through the centre p of a rounded vertex is the same line as through
    the point of contact, which lies on it, before p by the radius.

    Args:
        row: (16,) outward unit normal of the face in the object's axes (0:3), centre of the rounded
            vertex in the body's frame (3:6, m), its radius (6, m; not read here).
        motion: `Motion`: poses X_WO, X_WE (4, 4) of object and touched body, twists V_O, V_E (6,)
            and V_rel = V_O − V_E at O, and whether motions of touched bodies are measured.
        column: COLUMN_WORK, of which `turn` is read and N and `n_gamma` are filled.
    """
    X_WO, V_O, X_WE, V_E, V_rel, _ = motion
    n = rotated(X_WO, plus3(row, column.turn))  # outward of the object: into the body
    p = vertex(row, X_WO, X_WE)
    fill_line(column.N, p, n)
    rate = _rate(p, n, velocity_at(V_E, p), cross(V_O[3:], n))
    column.n_gamma = -dot6(rate, V_rel)


@inner
def _along_first(a, e, m, mm):
    """Solve s e_A − t e_E = a for s, in the plane perpendicular to m = e_A × e_E.

    e_A and e_E are the directions of two edges, s and t the distances along them.

    Args:
        a: (3,) vector (m or m/s).
        e: (3,) unit vector e_E.
        m: (3,) e_A × e_E.
        mm: m · m.

    Returns:
        s (m or m/s).
    """
    return dot3(cross(a, e), m) / mm


@inner
def turned_edge(row, X_WE, turn):
    """Direction of the body's edge with its estimated turn: a unit vector in world axes.

    Args:
        row: (16,) shape with the direction of the edge from 9 on, in the body's frame.
        X_WE: (4, 4) pose of the touched body.
        turn: (3,) estimated change of the direction, in the body's frame.
    """
    f = plus3(row[9:], turn)
    return rotated(X_WE, divided3(f, sqrt(dot3(f, f))))


@inner
def crossing(row, X_WO, X_WE, f):
    """Nearest points of two edges.

    Args:
        row: (16,) SHAPE with a point and the direction of the object's edge (0:3, 3:6) and a point
            of the body's edge (6:9).
        X_WO, X_WE: (4, 4) poses of object and body.
        f: direction of the body's edge, in world axes.

    Returns:
        The point of the object's edge that is nearest to the body's edge (m, from O), and the
        vector from the declared point of the object's edge to that of the body's (m).
    """
    e = rotated(X_WO, row[3:])
    m = cross(e, f)
    q = rotated(X_WO, row)
    p = plus3(origin(X_WE), rotated(X_WE, row[6:]))
    distance_vector = minus3(minus3(p, origin(X_WO)), q)
    return add3(q, _along_first(distance_vector, f, m, dot3(m, m)), e), distance_vector


@inner
def _edges(row, motion, column):
    """Fill N and n_γ of crossed edges; return the sine of the angle between them.

    N = [n; p × n] with n = ±m/|m|, m = e × f, where e and f are the directions of the object's and
    of the body's edge in world axes, and p the point of the object's edge next to the other one;
    n_γ = −ṄᵀV_rel (m/s²). Where the sine is near zero the column is not finite.

    Args:
        row: (16,) point and direction of the object's edge (0:3, 3:6), of the body's edge (6:9,
            9:12), side (12), outward normal of the body (13:16). A side of ±1 gives the sign of n =
            ±e × f; with 0 the outward normal determines it.
        motion: `Motion`: poses X_WO, X_WE (4, 4) of object and touched body, twists V_O, V_E (6,)
            and V_rel = V_O − V_E at O, and whether motions of touched bodies are measured.
        column: COLUMN_WORK, of which `turn` is read and N and `n_gamma` are filled.
    """
    X_WO, V_O, X_WE, V_E, V_rel, _ = motion
    e = rotated(X_WO, row[3:])
    f = turned_edge(row, X_WE, column.turn)
    m = cross(e, f)
    mm = dot3(m, m)
    sine = sqrt(mm)
    side = row[12]
    if side == 0.0:
        side = -dot3(rotated(X_WE, row[13:]), m)
    n = scaled3(copysign(1.0 / sine, side), m)
    p, distance_vector = crossing(row, X_WO, X_WE, f)
    gap = dot3(n, distance_vector)
    # rates: ṁ of m = e × f, ṅ, and ṡ of the point along the object's edge (which turns with V_O)
    m_dot = plus3(cross(cross(V_O[3:], e), f), cross(e, cross(V_E[3:], f)))
    n_dot = divided3(add3(m_dot, -dot3(n, m_dot), n), dot3(n, m))
    v_A = velocity_at(V_O, p)
    apart_dot = minus3(v_A, velocity_at(V_E, add3(p, gap, n)))
    s_dot = _along_first(add3(apart_dot, gap, n_dot), f, m, mm)
    fill_line(column.N, p, n)
    column.n_gamma = -dot6(_rate(p, n, add3(v_A, -s_dot, e), n_dot), V_rel)
    return sine


@inner
def permitted_motion(row, X_WO, X_WE):
    """Twist at O (six numbers) of one freedom of a pair that is declared by its permitted motions.

    Args:
        row: point of the object (0:3), axis (3:6), kind (6): TURN about an axis of the object;
            SLIDE along an axis of the body; SCREW, a turn about the object's axis with a
            translation by the pitch (10, m/rad) along the body's axis 7:10.
        X_WO: (4, 4) pose of the object.
        X_WE: (4, 4) pose of the touched body.
    """
    if row[6] == SLIDE:
        return join(rotated(X_WE, row[3:]), ZERO_3)
    w = rotated(X_WO, row[3:])
    v = cross(rotated(X_WO, row), w)
    if row[6] == SCREW:
        v = add3(v, row[10], rotated(X_WE, row[7:]))
    return join(v, w)


@inner
def _tangents(pair, shapes, motion, columns):
    """Fill N and n_γ of a pair that is declared by its permitted motions T.

    N (6, count) are the columns of contact forces, T (6, freedoms) the permitted motions with the
    speeds β of the object along them; n_γ = NᵀṪβ is the normal acceleration by the rotation of T.

    Args:
        pair: PAIR row. Its shapes are those of the columns of N, then those of its freedoms (see
            `permitted_motion`).
        shapes: SHAPE rows. That of a column of N has a point of the object (0:3), a direction of
            the body (3:6) and a kind (6): FORCE along the direction through the point; COUPLE about
            the cross product of an arm of the object (0:3) and a direction of the body; THREAD, a
            force along the direction with a couple −pitch / cos about it, where 7:10 is the
            object's axis, 10 the pitch (m/rad) and cos the cosine between both axes.
        motion: `Motion`: poses X_WO, X_WE (4, 4) of object and touched body, twists V_O, V_E (6,)
            and V_rel = V_O − V_E at O, and whether motions of touched bodies are measured.
        columns: COLUMN_WORK rows, of which N and `n_gamma` are filled.
    """
    X_WO, V_O, X_WE, V_E, V_rel, _ = motion
    # Ṫβ: slides turn with the body, axes of rotation with the object
    Tdot_beta = ZERO
    for k in range(pair.count, pair.count + pair.freedoms):
        row = shapes[pair.shape_at + k].row
        t = permitted_motion(row, X_WO, X_WE)
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
        d = rotated(X_WE, row[3:])
        if row[6] == COUPLE:
            fill(N, join(ZERO_3, cross(p, d)))
        else:
            fill_line(N, p, d)
        if row[6] == THREAD:  # the force along the thread's flank turns the object, too
            f = row[10] / dot3(d, rotated(X_WO, row[7:]))
            fill(N, join(linear(N), add3(N[3:], -f, d)))
        column.n_gamma = dot6(N, Tdot_beta)
