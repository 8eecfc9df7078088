"""N of a pair at many instants at once."""

from __future__ import annotations

import numpy as np

from osc_contact.contacts.pairs.lines import PARALLEL, EdgeOnEdge
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.points import FaceOnVertex
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.spatial import Array, Poses, cross

__all__ = ["normals_over"]


def normals_over(pair: ContactPair, X_WO: Poses, X_WE: Poses | None = None) -> Array:
    """(6, r, k) what `pair.contact` gives as N at each of k instants, at O in world axes.

    Args:
        pair: of any kind; others than points on planes, a face on a vertex and crossed edges are
            asked instant by instant.
        X_WO: k poses of the object. X_WE: k poses (or 1) of the environment body; None: the world.
    """
    k = X_WO.p.shape[-1]
    line = _line(pair, X_WO, X_WE)
    if line is None:
        X_E = [None] * k if X_WE is None else [X_WE[i] for i in range(k)]
        parts = [pair.contact(X_WO[i], np.zeros(6), X_E[i]).N for i in range(k)]
        return np.stack(parts, axis=-1)
    p, n = line
    found = np.empty((6, n.shape[1], k))
    found[:3], found[3:] = n, cross(p, n)
    return found


def _line(pair: ContactPair, A: Poses, E: Poses | None) -> tuple[Array, Array] | None:
    """Points, from O, and unit directions (3, r, k or 1) of the forces; None: not known here."""

    def turn_E(x: Array) -> Array:
        x = x.reshape(3, -1, 1)
        return x if E is None else E.turn(x)

    def point_E(x: Array) -> Array:
        origin = -A.p if E is None else E.p - A.p
        return origin[:, None] + turn_E(x)

    def point_A(x: Array) -> Array:
        return A.turn(x.reshape(3, -1, 1))

    if isinstance(pair, PointsOnPlanes) and type(pair).contact is PointsOnPlanes.contact:
        return point_A(pair._points), turn_E(pair._into)
    if type(pair) is FaceOnVertex:
        return point_E(pair.vertex), point_A(pair.normal)
    if type(pair) is EdgeOnEdge:
        e_A, e_E, first = point_A(pair.direction_A), turn_E(pair.direction_E), point_A(pair.point_A)
        m = cross(e_A, e_E)
        square = (m * m).sum(axis=0)
        if (square < PARALLEL**2).any():
            return None  # `contact` says what is wrong
        side = pair.side if np.ndim(pair.side) == 0 else -(turn_E(np.asarray(pair.side)) * m).sum(0)
        apart = point_E(pair.point_E) - first
        s = (cross(apart, e_E) * m).sum(axis=0) / square
        return first + s * e_A, np.copysign(1.0 / np.sqrt(square), side) * m
    return None
