"""Coulomb friction at the contacts, known to some extent: N_μ, what a sliding contact pushes.

A contact that slides pulls the environment along: with the force α it applies N_μ α instead of N α,

    N_μ = N + μ [s; p × s],    s = v_t / √(v_t² + v_0²),

v_t the slip velocity of the object at the contact point p, in the tangent plane. N_μ stands where
a force acts (on the right of the wrist filter's solve, in the feed-forward of the force command);
N stays where the contact's constraint is tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.pair import (
    Bodies,
    knows_where_it_slides,
    lines_of_force,
    velocity,
)
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Touched
from osc_contact.scenarios.control_schema import Friction
from osc_contact.spatial import Array

__all__ = ["friction_wrenches", "require_known_points"]


def require_known_points(pairs: Sequence[ContactPair]) -> None:
    """Refuse contacts that do not know where they touch.

    Raises:
        InvalidInputError: with the contact's name.
    """
    for pair in pairs:
        if not knows_where_it_slides(pair):
            raise InvalidInputError(
                f"contact '{pair.name}' is a {type(pair).__name__}, which has no points of "
                "contact, so its friction is not known. Leave control.friction out, or give the "
                "pair a method points_of_contact(X_WO, X_WE)"
            )


def friction_wrenches(
    friction: Friction,
    pairs: Sequence[ContactPair],
    X_WO: pin.SE3,
    V_O: Array,
    touched: Touched | None,
) -> Array:
    """N_μ − N (6, r) at O, world axes: friction wrench of each column of N.

    Args:
        friction: μ and slip speed. pairs: the contacts.
        X_WO, V_O: pose and twist (6,) of the object.
        touched: motion of the bodies touched; None: at rest.
    """
    columns = [np.zeros((6, 0))]
    for i, pair in enumerate(pairs):
        X_WE = None if touched is None else pin.SE3(touched.X_WE[i])
        V_E = None if touched is None else touched.V_E[i]
        points = cast(Any, pair).points_of_contact(X_WO, X_WE) - X_WO.translation[:, None]
        normals = pair.contact(X_WO, V_O, X_WE, V_E).N[:3]
        v = velocity(Bodies.at_O(X_WO, V_O, X_WE, V_E).V_rel, points)
        v = v - normals * (normals * v).sum(axis=0)
        slides = v / np.sqrt((v * v).sum(axis=0) + friction.slip**2)
        columns.append(friction.mu * lines_of_force(points, slides))
    return np.hstack(columns)
