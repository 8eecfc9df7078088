"""Coulomb friction at the contacts, known to some extent: N_μ, what a sliding contact pushes.

A contact that slides pulls the environment along: with the force α it applies N_μ α instead of N α,

    N_μ = N + μ [s; p × s],    s = v_t / √(v_t² + v_0²),

v_t the slip velocity of the object at the contact point p, in the tangent plane. N_μ stands where
a force acts (on the right of the wrist filter's solve, in the feed-forward of the force command);
N stays where the contact's constraint is tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
from osc_contact.spatial import Array

__all__ = ["Friction"]


@dataclass(frozen=True)
class Friction:
    """What the controller believes of the friction at its contacts.

    Attributes:
        mu: Coulomb coefficient, the same at all contacts.
        slip: v_0, the slip speed (m/s) from which on friction counts as fully developed. Below it
            the direction is not known well enough to push against.
        learning: 1/s, how fast the coefficient follows what least squares read of tangential
            forces while the contacts slide; 0: it stays. The filter learns nothing.
    """

    mu: float
    slip: float = 0.002
    learning: float = 5.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mu) and self.mu >= 0.0 and self.slip > 0.0):
            raise InvalidInputError(
                f"friction: mu = {self.mu}, slip = {self.slip} m/s; give mu ≥ 0 and slip > 0"
            )
        if not 0.0 <= self.learning < np.inf:
            raise InvalidInputError(f"friction: learning = {self.learning} 1/s; give a number ≥ 0")

    def require_known_points(self, pairs: Sequence[ContactPair]) -> None:
        """Refuse contacts that do not know where they touch.

        Raises:
            InvalidInputError: with the contact's name.
        """
        for pair in pairs:
            if not knows_where_it_slides(pair):
                raise InvalidInputError(
                    f"contact '{pair.name}' is a {type(pair).__name__}, which does not tell where "
                    "it touches, so its friction is not known. Leave control.friction out, or give "
                    "the pair a method points_of_contact(X_WO, X_WE)"
                )

    def wrench(self, normal: Array, point: Array, V_rel: Array) -> Array:
        """(6,) friction wrench at O for one newton of normal force, world axes.

        Args:
            normal: (3,) unit, into the environment. point: (3,) of contact, from O (m).
            V_rel: (6,) twist of the object relative to the environment, at O (m/s, rad/s).
        """
        v = velocity(V_rel, point)
        v = v - (normal @ v) * normal
        return self.mu * lines_of_force(point, v / np.sqrt(v @ v + self.slip**2))

    def wrenches(
        self, pairs: Sequence[ContactPair], X_WO: pin.SE3, V_O: Array, touched: Touched | None
    ) -> Array:
        """N_μ − N (6, r): friction wrench of each column of N at poses and twists.

        Args:
            pairs: the contacts. X_WO, V_O: pose and twist (6,) of the object.
            touched: motion of the bodies touched; None: at rest.
        """
        columns = [np.zeros((6, 0))]
        for i, pair in enumerate(pairs):
            X_WE = None if touched is None else pin.SE3(touched.X_WE[i])
            V_E = None if touched is None else touched.V_E[i]
            points = cast(Any, pair).points_of_contact(X_WO, X_WE) - X_WO.translation[:, None]
            normals = pair.contact(X_WO, V_O, X_WE, V_E).N[:3]
            V_rel = Bodies.at_O(X_WO, V_O, X_WE, V_E).V_rel
            for normal, point in zip(normals.T, points.T, strict=True):
                columns.append(self.wrench(normal, point, V_rel)[:, None])
        return np.hstack(columns)
