"""Motions that contacts permit: the twist next to a demand, and displacements."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from osc_contact.spatial import Array

LINEAR = np.eye(6)[:3]  #: rows of a demand: the velocity of the origin
ANGULAR = np.eye(6)[3:]  #: rows of a demand: the angular velocity

_INDEPENDENT = 1e-6  #: least singular value of independent rows of about unit length
#: Least singular value with which permitted motions meet a demand; a demand of which contacts
#: permit a smaller share is blocked. Estimated normals of the same face differ a little.
_LEAST_SHARE = 0.02
#: Least singular value with which permitted motions meet a demanded rotation (rad/m): a rotation
#: about an axis more than 2 m away counts as a translation.
_LEAST_TURN = 0.5


@dataclass
class Demand:
    """Components of the twist at O that a motion prescribes.

    Attributes:
        rows: (k, 6) components, world axes.
        values: (k,) their values (m/s, rad/s).
        finished: whether the motion has reached its end.
    """

    rows: Array
    values: Array
    finished: bool = False


def permitted_twist(N: Array, demand: Demand) -> tuple[Array, Array]:
    """Twist V (6,) with NᵀV = 0 that meets a demand S V = s, and its misfit S V − s (k,).

    Components that contacts and demand leave open are zero: first the angular velocity as far as
    possible, then the linear velocity, so that metres and radians are not added.

    Args:
        N: (6, r) directions of force of the active contacts, at O in world axes.
        demand: S and s.
    """
    at_rest = ((ANGULAR, np.zeros(3)), (LINEAR, np.zeros(3)))
    V = _solve_by_priority(N, ((demand.rows, demand.values), *at_rest))
    return V, demand.rows @ V - demand.values


def permitted_displacement(N: Array, e: Array) -> Array:
    """Displacement d (6,) with Nᵀd = 0 next to e: the angles as far as possible, then the position.

    The projection Ω_m in the metric of a small body would replace most of a displacement that the
    contacts do not permit by a rotation, because a small body is turned with little energy.

    Args:
        N: (6, r) directions of force of the active contacts.
        e: (6,) displacement at O (m, rad).
    """
    return _solve_by_priority(N, ((ANGULAR, e[3:]), (LINEAR, e[:3])))


def _solve_by_priority(N: Array, equations: Iterable[tuple[Array, Array]]) -> Array:
    """Vector V (6,) with NᵀV = 0 that meets several equations A V = b in order of priority.

    Each equation is solved by least squares with the motions that the equations before it leave
    open, whose basis is Z.

    Args:
        N: (6, r) directions of force of the active contacts.
        equations: A (k, 6) and b (k,) of each equation, the most important one first. Each A has
            rows of one unit.
    """
    V = np.zeros(6)
    Z = null_space(N.T)
    for rows, values in equations:
        if len(rows) > 0 and Z.shape[1] > 0:
            left, sizes, right = np.linalg.svd(rows @ Z)
            threshold = _LEAST_TURN if rows is ANGULAR else _LEAST_SHARE
            k = int(np.sum(sizes > threshold))
            y = left[:, :k].T @ (values - rows @ V) / sizes[:k]
            V = V + Z @ (right[:k].T @ y)
            Z = Z @ right[k:].T
    return V


def null_space(A: Array) -> Array:
    """Orthonormal basis (n, n − rank) of the null space of A (m, n), rows of about unit length."""
    if A.size == 0:
        return np.eye(A.shape[1])
    _, sizes, rows = np.linalg.svd(A)
    return rows[int(np.sum(sizes > _INDEPENDENT)) :].T
