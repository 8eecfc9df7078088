"""N, n_γ and friction wrenches of all contacts."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import project_onto_columns
from osc_contact.law.jit import call_at, inner, leaf, local
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
    add3,
    carry_motion,
    dot3,
    dot6,
    fill,
    fill3,
    finiteness,
    minus,
    minus3,
    motion_to_energy,
    motion_to_world,
    origin,
    plus,
    scaled,
    scaled3,
    set_identity,
    unpack_pose,
    velocity_at,
)

AHEAD = 2.0  #: control periods from a measurement to the latest effect of its torque


@inner
def place_contacts(t):
    """Fill N, n_γ and the points of contact of all columns, at O in world axes.

    N, n_γ and points of GIVEN pairs were filled by Python before the tick; those of FUNCTION pairs
    are computed by the user's compiled function, those of the other kinds by `place_pair`. N of a
    pair with a single point of contact is turned by the estimate of its normal, which `follow_face`
    updates if `tilt` > 0.

    Reads `X_WO`, `V_O`, `V_D`, `moving`, and `touched` of INPUT. Fills of the columns `N` (6,),
    `n_gamma` (m/s²), `point` (3,; m, from O) and the fields of `follow_face`; `_place_points`
    resets friction, which `predict_friction` fills later.

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
            fill(V_E, carry_motion(E[16:], origin(X_WE), origin(X_WO)))  # twist of the body at O
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
        _place_points(t, pair, X_WE)
    return True


@inner
def _place_points(t, pair, X_WE):
    """Fill the points of contact of a pair's columns (m, from O), and reset their friction.

    Fills `point` of pairs that touch at known points (`has_friction`), except GIVEN and FUNCTION
    pairs, whose points are filled elsewhere. `rests`, `slip` and `friction_wrench` of all columns
    become 0; `predict_friction` fills them where friction acts.

    Args:
        t: Tick.
        pair: PAIR row.
        X_WE: (4, 4) pose of the touched body.
    """
    columns = t.work.columns
    for j in range(pair.count):
        column = columns[pair.first + j]
        column.rests = 0.0
        fill3(column.slip, ZERO_3)
        fill(column.friction_wrench, ZERO)
        if pair.has_friction != 0 and pair.kind != GIVEN and pair.kind != FUNCTION:
            row = t.model.shapes[pair.shape_at + j].row
            fill3(column.point, point_of_contact(pair.kind, row, t.work.X_WO, X_WE, column.N))


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


# --- Direction of slip ----------------------------------------------------------------------------
#
# At the point of contact p, v_t is the measured tangential velocity and v_c the commanded one, that
# of the desired twist as far as the contacts permit it. v_c has neither noise nor stiction, and
# reverses when it is meant to; v_t is right about motions that are not commanded. With
# e = v_c − v_t,
#
#     v = v_t + w e,   w = (v_0² + c v_c²) / (v_0² + c v_c² + e²),   s = v / √(v² + v_1²),
#     v_1 = v_0 (1 − 0.95 w)
#
# so a contact that follows its command, or sticks behind a slow one, has the direction of the
# command, and one that moves otherwise by more than v_0 and √c v_c the direction of its motion.

#: c: deviations e up to a sixth of v_c are noise or stiction. With more (1: all of v_c) friction is
#: compensated along the command where a contact oscillates on a spring, too, and adds to that.
_COMMAND_WEIGHT = 0.03
_KNOWN = 0.95  #: share of v_0 that is not needed where the sliding speed is the commanded one


@inner
def predict_friction(t):
    """Fill direction of slip, rest and friction wrench of the active columns.

    Friction is predicted for the time at which the torques of this tick act, `AHEAD` control
    periods later, since it reverses within milliseconds with the motion. Its direction follows from
    the measured twist V and the commanded one, which is the desired twist V_D projected on the
    motions that the contacts permit; both are extrapolated with the desired acceleration A_D.

    Nothing is filled if neither friction is assumed nor forces are found by least squares. Reads
    `V_O`, `V_D`, `A_D`, `mu`, `chosen`, `kept`, `N` and `point` of the columns, `N_factor`,
    `N_basis`, and `moving` and `touched`. Fills of the columns `slip` (3,; direction of sliding, at
    most 1 long), `rests` (1 at rest … 0) and `friction_wrench` (6,; per unit force, at O).

    Args:
        t: Tick.
    """
    model = t.model
    work = t.work
    if not (work.mu > 0.0 or model.reading == LEAST_SQUARES):
        return
    change = scaled(AHEAD * model.period, work.A_D)
    permitted = local(6)
    normal = local(6)
    fill(permitted, motion_to_energy(work, plus(work.V_D, change)))
    for a in range(work.rank):  # speeds of the faces along N, which the object follows
        normal[a] = dot6(work.columns[work.kept[a]].N, _face_twist(t, work.kept[a]))
    project_onto_columns(work.N_factor, work.N_basis, work.rank, permitted, normal)
    commanded = motion_to_world(work, permitted)
    measured = plus(work.V_O, change)
    for i in range(work.count):
        j = work.chosen[i]
        if model.pairs[model.columns[j].contact].has_friction != 0:
            V_E = _face_twist(t, j)
            _slide(
                minus(measured, V_E), minus(commanded, V_E), work.mu, model.slip, work.columns[j]
            )


@leaf
def _face_twist(t, j):
    """Twist of the body that column j touches, at O in world axes (six numbers; m/s, rad/s).

    Args:
        t: Tick.
        j: index of the column among all columns of the model.
    """
    if not t.work.moving:
        return ZERO
    E = t.input.touched[t.model.columns[j].contact]
    return carry_motion(E[16:], (E[3], E[7], E[11]), origin(t.work.X_WO))


@leaf
def _slide(measured, commanded, mu, slip, column):
    """Fill `slip`, the direction of slip s, and `friction_wrench`, μ [s; p × s], of a column.

        v = v_t + w e,   e = v_c − v_t,   w = c/(c + e²),   c = v_0² + k v_c²
        s = v/√(v² + v_1²),   v_1 = v_0 (1 − `_KNOWN` w)

    v_t and v_c (3,; m/s) are the measured and the commanded velocity of the point p (m, from O)
    along the face, v_0 = `slip`, k = `_COMMAND_WEIGHT`. Where both differ little (w near 1) the
    commanded one is taken, which has neither noise nor stiction. Fills also `rests` = v_0²/(v_t² +
    v_0²): 1 at rest, 0 in fast slides, as measured.

    Args:
        measured: (6,) measured twist of the object relative to the body, at O (m/s, rad/s).
        commanded: (6,) the commanded one.
        mu: coefficient of friction μ.
        slip: v_0 (m/s), below which friction is regularised.
        column: COLUMN_WORK, of which N and `point` are read.
    """
    v_t = tangential_part(velocity_at(measured, column.point), column.N)
    v_c = tangential_part(velocity_at(commanded, column.point), column.N)
    e = minus3(v_c, v_t)
    certain = slip * slip + _COMMAND_WEIGHT * dot3(v_c, v_c)
    w = certain / (certain + dot3(e, e))
    v = add3(v_t, w, e)
    v_1 = slip * (1.0 - _KNOWN * w)
    s = scaled3(1.0 / sqrt(dot3(v, v) + v_1 * v_1), v)
    column.rests = slip * slip / (dot3(v_t, v_t) + slip * slip)
    fill3(column.slip, s)
    fill_line(column.friction_wrench, column.point, scaled3(mu, s))
