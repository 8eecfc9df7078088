"""Faces that are believed to be tilted, turned to what is seen to slide on them.

A point that slides at v_t along a face whose normal n is wrong by ε leaves the face that is
believed in at v = εᵀv_t. Where one point touches one face, n is turned until it does not; what is
left, where nothing slides, is v̄ of `steps`. docs/tuning.md: what it brings, and why it is stable.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.jit import inner
from osc_contact.law.six import dot6, rotated, rotated_back, velocity_at
from osc_contact.law.tables import FACE_ON_VERTEX

_SLIDES = 0.01  #: v_1 (m/s): faster than that a point tells how its face is tilted


@inner
def take_turns(t):
    """v̄ and the turns of believed normals, as the last tick left them."""
    for j in range(t.model.n_columns):
        row = t.work.columns[j]
        last = t.memory.columns[j]
        row.drift = last.drift
        row.slides = 0.0
        for i in range(3):
            row.turn[i] = row.turned[i] = last.turn[i]


@inner
def follow_face(t, kind, row, X_WO, R_E, V_rel, V_goal, column):
    """Fill `turned` and `slides` (0 … 1): the face turned to what is seen to slide on it.

        n ← n − c dt σ (NᵀV_rel − v̄) v_t / v_t²,   σ = v_t⁴ / (v_t⁴ + v_1⁴)

    v_t is the velocity that is wanted of the point along the face: noise turns nothing, nor does
    what stands still. n stays within `tilt` of what is believed, in the axes that carry the face;
    what is beyond v̄ takes.

    Args:
        kind: POINTS or FACE_ON_VERTEX. row: (16,) of the column. X_WO: of the object.
        R_E: of the body. V_rel, V_goal: (6,) at O, that is and that is wanted against
        the body. column: its N, `turn` and `drift` known.
    """
    model = t.model
    N = column.N
    turn = column.turn
    turned = column.turned
    if kind == FACE_ON_VERTEX:
        x, y, z = rotated(R_E, row[3], row[4], row[5])
        x = x + R_E[0, 3] - X_WO[0, 3]
        y = y + R_E[1, 3] - X_WO[1, 3]
        z = z + R_E[2, 3] - X_WO[2, 3]
    else:
        x, y, z = rotated(X_WO, row[0], row[1], row[2])
    a, b, c = velocity_at(V_goal, x, y, z)
    s = N[0] * a + N[1] * b + N[2] * c
    a = a - s * N[0]
    b = b - s * N[1]
    c = c - s * N[2]
    square = a * a + b * b + c * c
    weight = square / (square * square + _SLIDES**4)
    column.slides = weight * square
    gain = model.drift_share * weight * (dot6(N, V_rel) - column.drift)
    if kind == FACE_ON_VERTEX:
        turned[0], turned[1], turned[2] = rotated_back(X_WO, a, b, c)
    else:
        turned[0], turned[1], turned[2] = rotated_back(R_E, a, b, c)
    first = 0 if kind == FACE_ON_VERTEX else 3
    size = off = 0.0
    for i in range(3):
        turned[i] = row[first + i] + turn[i] - gain * turned[i]
        size += turned[i] * turned[i]
    size = sqrt(size)
    for i in range(3):
        turned[i] = turned[i] / size - row[first + i]
        off += turned[i] * turned[i]
    off = sqrt(off)
    if off > model.tilt:
        column.slides = 0.0
        for i in range(3):
            turned[i] *= model.tilt / off
