"""N, n_γ and friction wrenches of all contacts."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.jit import call_at, inner, local
from osc_contact.law.normals import follow_face, tangential_part, turn_given
from osc_contact.law.pair_geometry import PARALLEL, Motion, fill_line, place_pair, point_of_contact
from osc_contact.law.records import (
    FUNCTION,
    GIVEN,
    LEAST_SQUARES,
)
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    add,
    carry_motion,
    dot3,
    fill,
    fill3,
    finiteness,
    minus,
    origin,
    scaled3,
    set_identity,
    unpack_pose,
    velocity_at,
)

AHEAD = 2.0  #: control periods from a measurement to the latest effect of its torque


@inner
def place_contacts(t):
    """Fill N, n_γ and friction wrenches of the columns of all contacts, at O in world axes.

    N, n_γ and points of GIVEN pairs were filled by Python before the tick; those of FUNCTION pairs
    are computed by the user's compiled function. The friction wrench is predicted for the time at
    which the torques of this tick act, since friction reverses within milliseconds with the motion.
    Reads `X_WO`, `V_O`, `V_D`, `A_D`, `mu`, and `touched` of INPUT; fills, too, the estimates of
    `follow_face`.

    Args:
        t: Tick.

    Returns:
        False if a pair is degenerate, such as two parallel edges, or a user's function is not
        finite.
    """
    model = t.model
    shapes = model.shapes
    columns = t.work.columns
    X_WO = t.work.X_WO
    V_O = t.work.V_O
    moving = t.work.moving
    work = t.work
    X_WE = local(4, 4)
    V_E = local(6)
    V_rel = local(6)
    V_goal = local(6)
    evaluated = local(6, 11)  # N, n_γ, gap and point of each column of a FUNCTION pair
    evaluated[:] = 0.0
    set_identity(X_WE)
    fill(V_E, ZERO)
    fill(V_rel, V_O)
    for c in range(model.n_contacts):
        pair = model.pairs[c]
        if moving:
            E = t.input.touched[c]
            unpack_pose(E, X_WE)
            fill(V_E, carry_motion(E[16:], origin(X_WE), origin(X_WO)))
            fill(V_rel, minus(V_O, V_E))
        has_one_point = pair.count == 1 and pair.has_friction != 0
        is_filled = pair.kind == GIVEN or pair.kind == FUNCTION
        if pair.kind == FUNCTION:
            row = shapes[pair.shape_at].row
            call_at(pair.address, X_WO, V_O, X_WE, V_E, row, evaluated)
            if not _take_evaluated(columns, pair.first, pair.count, evaluated):
                return False
        if not is_filled:
            motion = Motion(X_WO, V_O, X_WE, V_E, V_rel, moving)
            if not place_pair(pair, shapes, columns, motion) >= PARALLEL:  # also if NaN
                return False
        elif has_one_point:
            turn_given(columns[pair.first], X_WE)
        if has_one_point and model.tilt > 0.0:
            fill(V_goal, minus(work.V_D, V_E))
            follow_face(t, pair, X_WO, X_WE, V_rel, V_goal)
        _predict_friction(t, pair, X_WE, V_rel)
    return True


@inner
def _predict_friction(t, pair, X_WE, V_rel):
    """Fill point, slip and friction wrench of the columns of a pair.

    Args:
        t: Tick. pair: row of MODEL. X_WE: (4, 4) pose of the touched body.
        V_rel: (6,) twist of the object relative to the face (m/s, rad/s).
    """
    model = t.model
    work = t.work
    columns = work.columns
    V = local(6)
    has_points = pair.has_friction != 0
    if not has_points and model.reading == LEAST_SQUARES:
        for j in range(pair.count):
            fill3(columns[pair.first + j].slip, ZERO_3)
            fill(columns[pair.first + j].friction_wrench, ZERO)
    if has_points and (work.mu > 0.0 or model.reading == LEAST_SQUARES):
        fill(V, add(V_rel, AHEAD * model.period, work.A_D))
        for j in range(pair.count):
            column = columns[pair.first + j]
            if pair.kind != GIVEN and pair.kind != FUNCTION:
                row = model.shapes[pair.shape_at + j].row
                point = point_of_contact(pair.kind, row, work.X_WO, X_WE, column.N)
                fill3(column.point, point)
            _slide(V, work.mu, model.slip, column)


@inner
def _take_evaluated(columns, first, count, evaluated):
    """Copy the results of a FUNCTION pair to its columns; return whether they are finite.

    Args:
        columns: COLUMN_WORK rows, of which N, `n_gamma` and `point` are filled.
        first, count: first column of the pair and their number.
        evaluated: (6, 11) rows [N; n_γ; gap; point], one for each column.
    """
    zero = 0.0  # NaN where a number is not finite
    for j in range(count):
        column = columns[first + j]
        row = evaluated[j]
        fill(column.N, row)
        column.n_gamma = row[6]
        fill3(column.point, row[8:])
        zero += finiteness(row, 7) + finiteness(row[8:], 3)
    return zero == 0.0


@inner
def _slide(V_rel, mu, slip, column):
    """Fill `slip`, s = v_t / √(v_t² + v_0²), and `friction_wrench`, μ [s; p × s], of a column.

    v_t is the tangential velocity at the point of contact p. Both wrench and point are at O, in
    world axes.

    Args:
        V_rel: (6,) twist of the object relative to the body, at O (m/s, rad/s). mu: coefficient of
            friction μ. slip: v_0 (m/s), below which friction is regularised.
        column: COLUMN_WORK, of which N and `point` are read.
    """
    v = tangential_part(velocity_at(V_rel, column.point), column.N)
    s = scaled3(1.0 / sqrt(dot3(v, v) + slip * slip), v)
    fill3(column.slip, s)
    fill_line(column.friction_wrench, column.point, scaled3(mu, s))
