"""What the object presses on: a_e = Φ_e f_c + b_e (eq. 14)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, as_array

__all__ = ["Environment"]


@dataclass(frozen=True)
class Environment:
    """The environment at one instant, at the operational point in world axes (eq. 14).

    Attributes:
        Phi_e: (6, 6) inverse inertia, positive semidefinite: acceleration per contact force.
        b_e: (6,) spatial acceleration it would have without contact.
        V_e: (6,) its twist.

    Raises:
        InvalidInputError: wrong shapes, or Φ_e not symmetric positive semidefinite.
    """

    Phi_e: Array = field(default_factory=lambda: np.zeros((6, 6)))
    b_e: Array = field(default_factory=lambda: np.zeros(6))
    V_e: Array = field(default_factory=lambda: np.zeros(6))

    def __post_init__(self) -> None:
        object.__setattr__(self, "Phi_e", as_array("Phi_e", self.Phi_e, (6, 6)))
        object.__setattr__(self, "b_e", as_array("b_e", self.b_e, (6,)))
        object.__setattr__(self, "V_e", as_array("V_e", self.V_e, (6,)))
        scaled = self.Phi_e / _scales(self.Phi_e)
        if np.abs(scaled - scaled.T).max() > 1e-9:
            raise InvalidInputError("Phi_e is not symmetric; an inverse inertia is")
        smallest = np.linalg.eigvalsh(scaled)[0]
        if smallest < -1e-9:
            raise InvalidInputError(
                f"Phi_e is not positive semidefinite (scaled eigenvalue {smallest:.3g}); "
                "no passive body accelerates against the force on it"
            )

    @classmethod
    def fixed(cls) -> Environment:
        """Does not move and does not yield: Φ_e = 0, b_e = 0."""
        return cls()


def _scales(Phi: Array) -> Array:
    """(6, 6) what the elements of Φ_e are measured against: its most mobile axis of each kind.

    One scale for the linear and one for the angular axes, so that rounding errors in a locked
    direction (of an inverse inertia carried from another point, say) are not blown up. An axis
    through O leaves linear noise only: mobilities below 1 mm/rad count as noise too.
    """
    largest = np.sqrt(np.diag(Phi).reshape(2, 3).max(axis=1, initial=0.0))
    largest = np.maximum(largest, 1e-3 * largest[::-1])
    largest[largest == 0.0] = 1.0
    scale = np.repeat(largest, 3)
    return np.outer(scale, scale)
