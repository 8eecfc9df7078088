"""A touched body that slides on a straight rail: driven, or free to follow the contact force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.environment import Environment
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, as_array

__all__ = ["Body", "Cart", "Conveyor"]


class Body(Protocol):
    """Anything that answers contact forces: it says how, each tick, at the operational point."""

    def environment(self, X_WE: pin.SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """Φ_e, b_e and V_e at O (3,), from the body's measured pose, twist and known acceleration
        (`interface.Touched`)."""


@dataclass(frozen=True, eq=False)
class Conveyor:
    """A body whose motion is prescribed and does not yield: Φ_e = 0, b_e as commanded."""

    def environment(self, X_WE: pin.SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`."""
        return Environment.moving(X_WE=X_WE, V_E=V_E, A_E=A_E, O=O)


@dataclass(frozen=True, eq=False)
class Cart:
    """A body of mass m on a straight rail: m s̈ = u·(f + m g) + preload − k s − c ṡ.

    s is how far E has travelled along u from the world's origin; Φ_e = u uᵀ/m has rank 1.

    Attributes:
        direction: (3,) u along the rail, world; normalised on entry.
        mass: m (kg). stiffness: k (N/m). damping: c (N s/m). preload: (N), along u at s = 0.
        gravity: (3,) g (m/s²).

    Raises:
        InvalidInputError: no direction, or numbers that no cart has.
    """

    direction: Array
    mass: float
    stiffness: float = 0.0
    damping: float = 0.0
    preload: float = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    def __post_init__(self) -> None:
        u = as_array("direction", self.direction, (3,))
        length = float(np.linalg.norm(u))
        if length == 0.0:
            raise InvalidInputError("cart.direction is zero; give the direction of its rail")
        object.__setattr__(self, "direction", u / length)
        for name in ("mass", "stiffness", "damping", "preload"):
            value = getattr(self, name)
            least = -np.inf if name == "preload" else 0.0
            if not np.isfinite(value) or value < least or (name == "mass" and value == 0.0):
                raise InvalidInputError(f"cart.{name} = {value}; give a number a cart can have")

    def environment(self, X_WE: pin.SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`; `A_E` is not used: the cart's acceleration follows from f."""
        u = self.direction
        travel, speed = float(u @ X_WE.translation), float(u @ V_E[:3])
        force = self.preload - self.stiffness * travel - self.damping * speed
        axis = np.concatenate((u, np.zeros(3)))
        return Environment.rail(
            pin.Inertia(self.mass, np.zeros(3), np.zeros((3, 3))),
            X_WE=X_WE,
            axes=axis,
            rates=[speed],
            O=O,
            gravity=self.gravity,
            force=[force],
        )
