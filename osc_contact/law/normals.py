"""Estimate of contact normals from sliding."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.jit import inner, leaf
from osc_contact.law.pair_geometry import crossing, fill_line, turned_edge, vertex
from osc_contact.law.records import (
    EDGES,
    FACE_ON_VERTEX,
    FUNCTION,
    GIVEN,
    SURFACE,
)
from osc_contact.law.vectors import (
    add3,
    cross,
    divided3,
    dot3,
    dot6,
    fill3,
    linear,
    minus3,
    plus3,
    rotated,
    rotated9,
    rotated_back,
    scaled3,
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
_CORNER_RATIO = 4.0  # corner frequency of the low-pass of v, in multiples of c
_HALF_SLIDING_SPEED = (
    0.01  #: v_1 (m/s), sliding speed at which half of v is attributed to the normal
)


@inner
def load_normal_estimates(t):
    """Copy lasting speeds and turns of the assumed normals from MEMORY to the columns of WORK.

    Fills `drift` (m/s), `turn` and `turned` (equal to `turn`: no change yet), and zeroes `slides`,
    `lever` and `prior`, which `follow_face` fills.

    Args:
        t: Tick.
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
def follow_face(t, pair, X_WO, X_WE, V_rel, V_goal):
    """Turn the assumed normal n of a face by the speed along it while a point slides.

        n ← n − κ (NᵀV_rel − v̄)/|N| g/|g|²,   κ = c dt σ λ,   σ = |g|⁴ / (|g|⁴ + v_1⁴)

    NᵀV_rel (m/s) is the measured speed along the normal, v̄ its lasting part, which an error of the
    normal does not explain, |N| the length of the column's force. g (3,; m/s) is v_t, the desired
    velocity of the point along the face; of crossed EDGES the sensitivity of `_shown_by_edges`. κ
    is the gain of this tick: c dt = `drift_share`, λ (0 … 1) is the share of the speed that an
    error of the normal explains, and v_1 = `_HALF_SLIDING_SPEED`. So a point at rest does not turn
    the normal, and the direction in which it is turned has no measurement noise; noise of NᵀV_rel
    enters with the gain κ. n stays within the angle `tilt` of the declared normal, in the axes of
    the object or body that carries the face; a larger deviation changes v̄ instead (`slides` = 0).
    On a curved face n is the normal at the point touched: an error δ of a ball's position turns it
    by −δ/R everywhere.

    Fills of the column `turned` (the normal after this tick less the declared one, `believed`),
    `slides` (σλ, 0 … 1: share of the speed that turns the normal), `shown` (g/|g|, in axes of the
    body that carries the face), `lever` (|g|²; m²/s²), `prior` (3, 3; rad²: covariance of an
    unknown normal) and `unexplained` ((NᵀV_rel − v̄)/|N|, m/s). Reads `drift_share` and `tilt` of
    MODEL, and `covariance` and `residual` of the column in MEMORY.

    Args:
        t: Tick.
        pair: PAIR row with one column, whose N, `turn` and `drift` are filled.
        X_WO, X_WE: (4, 4) poses of the object and of the touched body.
        V_rel: (6,) measured twist of the object relative to the body, at O.
        V_goal: (6,) desired twist of the object relative to the body, at O.
    """
    model = t.model
    shapes = model.shapes
    column = t.work.columns[pair.first]
    last = t.memory.columns[pair.first]
    N = column.N
    length = sqrt(dot3(N, N))
    # desired velocity v_t along the face, and the unexplained speed NᵀV_rel − v̄ per unit of N
    v = tangential_part(velocity_at(V_goal, _tracked(pair, shapes, X_WO, X_WE, column)), N)
    if pair.kind == EDGES:
        v = _shown_by_edges(shapes[pair.shape_at].row, X_WO, X_WE, column, v)
    column.lever = square = dot3(v, v)
    column.unexplained = (dot6(N, V_rel) - column.drift) / length
    # both in axes of the body that carries the face, with the prior covariance of the normal
    axes = X_WO if pair.kind == FACE_ON_VERTEX else X_WE
    v = rotated_back(axes, v)
    normal = rotated_back(axes, scaled3(1.0 / length, N))
    fill3(column.shown, scaled3(1.0 / sqrt(max(square, _LEAST_SQUARE)), v))
    for i in range(3):
        for j in range(3):  # a face turns about axes across n, an edge changes n along n
            tangential = (1.0 if i == j else 0.0) - normal[i] * normal[j]
            share = normal[i] * normal[j] if pair.kind == EDGES else tangential
            column.prior[3 * i + j] = 0.25 * model.tilt * model.tilt * share
    # σ, reduced by λ: the share of the speed that an error of the normal explains
    expected = square * _quadratic(last.covariance, column.shown)
    column.slides = square * square / (square * square + _HALF_SLIDING_SPEED**4)
    if expected > 0.0:  # else λ = 1: no estimate yet
        column.slides *= expected / (expected + last.residual)
    # the turned normal, within `tilt` of the declared one
    gain = model.drift_share * column.slides * column.unexplained / max(square, _LEAST_SQUARE)
    normal = add3(plus3(column.believed, column.turn), -gain, v)
    turn = minus3(divided3(normal, sqrt(dot3(normal, normal))), column.believed)
    angle = sqrt(dot3(turn, turn))
    if angle > model.tilt:  # at the bound the whole speed changes v̄
        column.slides = 0.0
        turn = scaled3(model.tilt / angle, turn)
    fill3(column.turned, turn)


@leaf
def tangential_part(v, N):
    """Component of a velocity v (3,; m/s) perpendicular to the line of force of a column N (6,)."""
    return add3(v, -dot3(N, v) / dot3(N, N), N)


@inner
def _shown_by_edges(row, X_WO, X_WE, column, v):
    """Sensitivity g (three numbers, m/s) of a contact's speed to a turn of the body's edge.

    The speed NᵀV_rel along the column N changes by gᵀδ if the direction f of the body's edge
    changes by δ: g = ±(v_t × e)/|e × f|, with the direction e of the object's edge and the velocity
    v_t along the face.

    Args:
        row: (16,) shape of the edges, with the direction of the object's edge in 3:6 (object's
            axes) and that of the body's edge in 9:12 (body's axes).
        X_WO, X_WE: (4, 4) poses of the object and the touched body.
        column: COLUMN_WORK, of which N and `turn` are read.
        v: (3,) v_t, velocity of the crossing along the face (m/s).
    """
    e = rotated(X_WO, row[3:])
    m = cross(e, turned_edge(row, X_WE, column.turn))
    return scaled3(1.0 / dot3(column.N, m), cross(v, e))


@inner
def _quadratic(P, u):
    """Quadratic form uᵀPu of a 3×3 matrix P (9 numbers, by rows) and a vector u."""
    return dot3(u, rotated9(P, u))


@leaf
def learn_normal(share, last, column):
    """Update the estimate of an assumed normal: its covariance, deviation and unexplained speed.

        P ← (1 − κ ĝĝᵀ) P (1 − κ ĝĝᵀ) + κ²/(c dt) r/|g|² ĝĝᵀ

    P (3, 3; rad²) is the covariance of the turn of the normal, ĝ the unit vector `shown` along
    which sliding shows an error and |g|² = `lever` (m²/s²) the square of the sliding speed, κ = c
    dt times `slides` the gain, r = `residual` (m²/s²) the mean square of the speed along the normal
    that an error of it does not explain. Updates `covariance` (P), `unexplained`, `residual` and
    `normal_std`, the largest standard deviation (rad).

    Args:
        share: c dt, the share of a tick in the estimate; 0: it is not updated.
        last: COLUMN_MEMORY, changed.
        column: COLUMN_WORK after `follow_face`, of which `shown`, `lever`, `slides`, `unexplained`
            and `prior` are read.
    """
    P = last.covariance
    u = column.shown
    if P[0] + P[4] + P[8] == 0.0:  # a new estimate begins with the prior
        for i in range(9):
            P[i] = column.prior[i]
    if share == 0.0 and last.normal_std > 0.0:
        return
    # r: low-passed excess of the unexplained speed's square over |g|² ĝᵀPĝ, while the point slides
    square = column.lever * column.lever
    last.unexplained += _CORNER_RATIO * share * (column.unexplained - last.unexplained)
    unexplained_square = last.unexplained * last.unexplained - column.lever * _quadratic(P, u)
    last.residual += (
        share
        * square
        / (square + _HALF_SLIDING_SPEED**4)
        * (max(unexplained_square, 0.0) - last.residual)
    )
    # P, multiplied out with w = Pĝ
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
def _tracked(pair, shapes, X_WO, X_WE, column):
    """Position (m, from O, world axes) of the point that slides on the face of a one-column pair.

    Fills `believed` of the column with the declared normal, in the axes of the object or body that
    carries the face. The normals of a SURFACE, a GIVEN and a FUNCTION pair are filled elsewhere.

    Args:
        pair: PAIR row.
        shapes: SHAPE rows of the model.
        X_WO, X_WE: (4, 4) poses of the object and the touched body.
        column: COLUMN_WORK, changed.
    """
    if pair.kind == GIVEN or pair.kind == FUNCTION:
        return linear(column.point)
    row = shapes[pair.shape_at].row
    if pair.kind == FACE_ON_VERTEX:
        fill3(column.believed, row)
        return vertex(row, X_WO, X_WE)
    if pair.kind == EDGES:
        fill3(column.believed, row[9:])
        return crossing(row, X_WO, X_WE, turned_edge(row, X_WE, column.turn))[0]
    if pair.kind != SURFACE:
        fill3(column.believed, row[3:])
    return rotated(X_WO, row)


@inner
def turn_given(column, X_WE):
    """Turn the N of a GIVEN or FUNCTION pair with one column by the estimate of its normal.

    The point of contact stays where it is. Fills `believed` with the normal before the turn.

    Args:
        column: COLUMN_WORK with N, `point` and `turn`; N is changed.
        X_WE: (4, 4) pose of the touched body.
    """
    N = column.N
    turn = column.turn
    size = sqrt(dot3(N, N))
    n = rotated_back(X_WE, divided3(N, size))
    fill3(column.believed, n)
    if turn[0] == 0.0 and turn[1] == 0.0 and turn[2] == 0.0:
        return
    n = plus3(n, turn)
    fill_line(N, column.point, rotated(X_WE, scaled3(size / sqrt(dot3(n, n)), n)))
