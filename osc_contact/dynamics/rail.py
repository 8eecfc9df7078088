"""Touched bodies: driven, or free to follow the contact force on a slide or about a hinge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.environment import Environment
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, as_array, cross


class Body(Protocol):
    """A body that answers contact forces; it returns how, each tick, at the operational point."""

    def environment(self, X_WE: pin.SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """Φ_e, b_e and V_e at O (3,), from the body's measured pose, twist and known acceleration
        (`interface.Touched`).

        Args:
            X_WE: pose of the body. V_E: (6,) its twist at E. A_E: (6,) its known acceleration.
            O: (3,) operational point (m).
        """


@dataclass(frozen=True, eq=False)
class Conveyor:
    """A body whose motion is prescribed and does not yield: Φ_e = 0, b_e as commanded."""

    def environment(self, X_WE: pin.SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`.

        Args:
            X_WE, V_E, A_E, O: as of `Body.environment`.
        """
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
        _take_unit(self, "cart", "direction")
        _require_possible(self, "cart", "mass")

    def environment(self, X_WE: pin.SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`; `A_E` is not used: the cart's acceleration follows from f.

        Args:
            X_WE, V_E, A_E, O: as of `Body.environment`.
        """
        u = self.direction
        travel = float(u @ X_WE.translation)
        speed = float(u @ V_E[:3])
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


@dataclass(frozen=True, eq=False)
class Hinge:
    """A balanced body on a hinge fixed in the world: I θ̈ = m_a + preload − k θ − c θ̇.

    θ is the turn of E about a since the start, at most half a turn either way; m_a the moment of
    the contact force about the axis. Φ_e has rank 1.

    Attributes:
        axis: (3,) a, world; normalised on entry. through: (3,) a point of the axis, world (m).
        inertia: I about the axis (kg m²). stiffness: k (N m/rad). damping: c (N m s/rad).
        preload: (N m).

    Raises:
        InvalidInputError: no axis, or numbers that no hinged body has.
    """

    axis: Array
    through: Array
    inertia: float
    stiffness: float = 0.0
    damping: float = 0.0
    preload: float = 0.0

    def __post_init__(self) -> None:
        _take_unit(self, "hinge", "axis")
        object.__setattr__(self, "through", as_array("hinge.through", self.through, (3,)))
        _require_possible(self, "hinge", "inertia")

    def environment(self, X_WE: pin.SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`; `A_E` is not used: the acceleration follows from f.

        Args:
            X_WE, V_E, A_E, O: as of `Body.environment`.
        """
        a = self.axis
        angle = float(a @ pin.log3(X_WE.rotation))
        rate = float(a @ V_E[3:])
        moment = self.preload - self.stiffness * angle - self.damping * rate
        return Environment.rail(
            pin.Inertia(0.0, np.zeros(3), self.inertia * np.eye(3)),
            X_WE=X_WE,
            axes=np.concatenate((cross(a, X_WE.translation - self.through), a)),
            rates=[rate],
            O=O,
            force=[moment],
        )


def _take_unit(body: object, kind: str, name: str) -> None:
    u = as_array(f"{kind}.{name}", getattr(body, name), (3,))
    length = float(np.linalg.norm(u))
    if length == 0.0:
        raise InvalidInputError(f"{kind}.{name} is zero; give a direction")
    object.__setattr__(body, name, u / length)


def _require_possible(body: object, kind: str, inertia: str) -> None:
    for name in (inertia, "stiffness", "damping", "preload"):
        value = getattr(body, name)
        least = -np.inf if name == "preload" else 0.0
        if not np.isfinite(value) or value < least or (name == inertia and value == 0.0):
            raise InvalidInputError(f"{kind}.{name} = {value}; give a number a {kind} can have")
