"""Wrenches and twists as screws: an axis, a pitch, and a helix that shows it.

A wrench [f; m] acts along a line in space and carries a couple about it; its pitch is that couple
per unit force (m). A twist [v; ω] turns about a line and advances along it; its pitch is the
advance per radian (m/rad). Pitch 0 is a pure force or a pure rotation, an infinite pitch a pure
couple or a pure translation. Axis and pitch depend neither on units nor on the place of O
(R. S. Ball, A Treatise on the Theory of Screws, 1900).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, norm

FAR = 100.0
"""m: an axis or a pitch beyond this is drawn as infinitely far, or infinite."""


class ScrewAxis(NamedTuple):
    """A line and a pitch, or one of each for every wrench or twist.

    Attributes:
        point: (…, 3) the point of the axis nearest to where the wrench or twist is given, m.
        direction: (…, 3) unit vector along the axis.
        pitch: (…) m, or m/rad; ``inf`` for a pure couple or a pure translation.
    """

    point: Array
    direction: Array
    pitch: Array


def wrench_screw(wrench: ArrayLike, origin: ArrayLike) -> ScrewAxis:
    """Convert wrenches to screws: a force along an axis, and a couple about it.

    Args:
        wrench: (…, 6) wrenches [f; m] (N, N m), or columns of N.
        origin: (…, 3) points about which the moments m are taken (m).

    Raises:
        InvalidInputError: one is zero or not finite, or they are not (…, 6).
    """
    values = np.asarray(wrench, dtype=float)
    finite = values.shape[-1:] == (6,) and np.isfinite(values).all()
    if not finite or not values.any(axis=-1).all():
        raise InvalidInputError(f"{values.tolist()} is no screw: 6 finite numbers, not all zero")
    line, moment = np.split(values, 2, axis=-1)
    size = np.linalg.norm(line, axis=-1, keepdims=True)
    arm = np.linalg.norm(moment, axis=-1, keepdims=True)
    couple = size * FAR <= arm
    size = np.where(couple, arm, size)
    direction = np.where(couple, moment, line) / size
    offset = np.cross(direction, moment / size)  # of a couple: zero
    pitch = np.where(couple[..., 0], np.inf, np.vecdot(direction, moment) / size[..., 0])
    return ScrewAxis(np.asarray(origin, dtype=float) + offset, direction, pitch)


def twist_screw(twist: ArrayLike, origin: ArrayLike) -> ScrewAxis:
    """Convert twists to screws: a rotation about an axis, and a translation along it.

    Args:
        twist: (…, 6) twists [v; ω], or columns of T.
        origin: (…, 3) points whose velocities are v (m).

    Raises:
        InvalidInputError: one is zero or not finite, or they are not (…, 6).
    """
    return wrench_screw(np.roll(twist, 3, axis=-1), origin)  # ω is the line, v the moment


class CommonPerpendicular(NamedTuple):
    """Shortest connection of two lines: foot points (3,), distance (m), angle (rad, 0..π/2)."""

    first: Array
    second: Array
    distance: float
    angle: float


def common_perpendicular(
    p: ArrayLike, d: ArrayLike, q: ArrayLike, e: ArrayLike
) -> CommonPerpendicular:
    """Shortest connection of the lines p + s d and q + t e (parallel lines: the one through q).

    Args:
        p, q: (3,) a point of each line (m).
        d, e: (3,) their directions, of any length.
    """
    p = np.asarray(p, dtype=float)
    q = np.asarray(q, dtype=float)
    d, e = (np.asarray(line / norm(line)) for line in map(np.asarray, (d, e)))
    cosine = float(d @ e)
    sine = norm(np.cross(d, e))
    t = 0.0 if sine < 1e-9 else float(((d @ (q - p)) * cosine - e @ (q - p)) / sine**2)
    second = q + t * e
    first = p + (d @ (second - p)) * d
    distance = norm(second - first)
    return CommonPerpendicular(first, second, distance, float(np.arctan2(sine, abs(cosine))))


class Normals(NamedTuple):
    """The contact forces of F recorded ticks.

    Attributes:
        N: (F, 6, r) at O, world axes; columns that are not known are zero.
        known: (F, r) whether the contact's place was recorded at the tick.
        pressed: (F, r) whether it is also closed.
        active: (F, r) whether the controller has it in its N; True where that was not recorded.
    """

    N: Array
    known: NDArray[np.bool_]
    pressed: NDArray[np.bool_]
    active: NDArray[np.bool_]


def contact_normals(samples: Mapping[str, Array], owners: Sequence[int] = ()) -> Normals:
    """Columns of N of recorded ticks, with flags of those that are known, closed and active.

    The channel ``N`` (F, 6, r) is taken if it was recorded; otherwise each contact is a line of
    force, [d; (p − O) × d], with its channels direction d and point p. Columns that are not finite
    or zero are not known; without a channel of flags all contacts count as closed and active.

    Args:
        samples: the channels at F ticks.
        owners: (r,) the contact of each column, default one column per contact.
    """
    directions = samples["contact_direction"]
    points = samples["contact_point"]
    always = np.ones(points.shape[:2])
    is_closed, active = (
        np.asarray(samples.get(key, always), dtype=bool) for key in ("closed", "contact_phase")
    )
    arms = points - samples["pose"][:, None, :3]
    N = np.concatenate([directions, np.cross(arms, directions)], axis=2).transpose(0, 2, 1)
    owner = np.arange(points.shape[1])
    if "N" in samples:
        N = samples["N"]
        owner = np.asarray(owners or range(N.shape[2]), dtype=np.intp)
    located = np.asarray(np.isfinite(points).all(axis=2))
    is_known = located[:, owner] & np.isfinite(N).all(axis=1)
    N = np.where(is_known[:, None], N, 0.0)
    is_known &= N.any(axis=1)
    return Normals(N, is_known, is_known & is_closed[:, owner], active[:, owner])


def tangents(N: Array) -> Array:
    """A basis T (6, 6 − r) of the motions that N (6, r) permits, as simple as they come.

    Of the many bases it is the `echelon` form: translations first, then turns about the world's
    axes as far as there are any.
    """
    U, values, _ = np.linalg.svd(N)
    rank = (values > 1e-9 * values.max(initial=0.0)).sum()
    return echelon(U[:, rank:])


def echelon(basis: ArrayLike) -> Array:
    """Reduced echelon form (6, k) of a basis: translations first, then rotations.

    Gauss–Jordan elimination makes each pivot 1 and clears it in all other columns. Pivots are
    sought among rotations first, so that the remaining columns are translations where possible.

    Args:
        basis: (6, k) basis of a space of motions or forces, linear part first.
    """
    rows = np.array(basis, dtype=float).T
    size = 0.1  # m: only orders the pivots, so that translations are preferred over turns
    row = 0
    for column in (3, 4, 5, 0, 1, 2):
        if row == len(rows):
            break
        weight = size if column >= 3 else 1.0
        pivot = row + np.abs(rows[row:, column]).argmax()
        if np.abs(rows[pivot, column]) * weight < 1e-6 * np.abs(rows).max():
            continue
        rows[[row, pivot]] = rows[[pivot, row]]
        rows[row] /= rows[row, column]
        for other in range(len(rows)):
            if other != row:
                rows[other] -= rows[other, column] * rows[row]
        row += 1
    return rows[::-1].T


def helix(pitch: float, radius: float, length: float) -> Array:
    """Path (48, 3) of a point that turns about the y-axis and advances along it (m).

    It is a circular arc for pitch 0, and tends to a straight line for large pitches. Its middle is
    at y = 0.

    Args:
        pitch: advance per angle (m/rad).
        radius: distance of the point from the y-axis (m).
        length: length of the path (m).
    """
    angle = min(length / np.hypot(radius, pitch), 1.75 * np.pi)
    turn = np.linspace(-0.5 * angle, 0.5 * angle, 48)
    return np.column_stack([radius * np.sin(turn), pitch * turn, radius * np.cos(turn)])
