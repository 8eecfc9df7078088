"""The contact normal, exactly.

Near touch an iterative solver finds the normal to 1e-5 rad at best, far too coarse for N. So the
normal is chosen among those the geometry has exactly: of every direction n the reach of the two
shapes gives a lower bound of their signed distance, and the contact normal is the direction of the
largest bound. Faces' normals and cross products of edges are tried (the environment's faces come
first where two are as good); the solver's own normal only serves where round shapes are involved.
"""

from __future__ import annotations

import numpy as np

from osc_contact.contacts.detection.features import Feature
from osc_contact.contacts.detection.shapes import Solid
from osc_contact.spatial import Array, cross

__all__ = ["best_direction", "exact_normal", "separation"]

_TIE = 1e-9
"""Directions whose bounds differ by less are as good (m)."""


def separation(a: Solid, e: Solid, n: Array) -> float:
    """Gap between a and e along the unit vector n out of e: never more than their distance (m).

    Args:
        a, e: shapes of object and environment in world axes. n: (3,) unit vector out of e.
    """
    return float(_separations(a, e, n[None, :])[0])


def best_direction(a: Solid, e: Solid, guess: Array | None = None) -> Array:
    """(3,) the outward normal of e, or the guess, along which a and e are farthest apart.

    Args:
        a, e: shapes of object and environment in world axes.
        guess: (3,) tried besides the normals and the directions across two edges.
    """
    crosses = cross(a.edges.T[:, :, None], e.edges.T[:, None, :]).reshape(3, -1).T
    length = np.linalg.norm(crosses, axis=1)
    crosses = crosses[length > 1e-6] / length[length > 1e-6, None]
    directions = np.vstack((e.normals, -a.normals, crosses, -crosses))
    if guess is not None and np.linalg.norm(guess) > 0.5:
        directions = np.vstack((directions, guess / np.linalg.norm(guess)))
    if len(directions) == 0:
        directions = np.eye(3)[2:]
    apart = _separations(a, e, directions)
    best: Array = directions[int(np.flatnonzero(apart >= apart.max() - _TIE)[0])]
    return best


def _separations(a: Solid, e: Solid, directions: Array) -> Array:
    return -a.support(-directions) - e.support(directions)


def exact_normal(a: Feature, e: Feature, n: Array, angle: float) -> Array:
    """n as the two features fix it: the face's, else across both edges, else between centres.

    Args:
        a, e: features of object and environment. n: (3,) unit vector near the normal.
        angle: tolerance (rad).
    """
    if e.normal is not None:
        return e.normal
    if a.normal is not None:
        return -a.normal
    if a.dimension == e.dimension == 1:
        across = cross(a.direction, e.direction)
        if np.linalg.norm(across) <= angle:
            return n
    elif a.axis is not None or e.axis is not None:
        return n  # of a rim: the solver's
    else:
        across = _nearest(a, e) - _nearest(e, a)
    across = across / np.linalg.norm(across)
    return across if across @ n > 0.0 else -across


def _nearest(a: Feature, e: Feature) -> Array:
    """The point of a nearest to e, where one of the two is a point."""
    if a.dimension == 0:
        return a.points[0]
    along = a.direction
    return a.points[0] + along * (along @ (e.points[0] - a.points[0]))
