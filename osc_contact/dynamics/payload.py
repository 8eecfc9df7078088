"""The held object: its inertia, and its equation of motion at the operational point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.spatial import Array, cross_wrench


@dataclass(frozen=True)
class ObjectTerms:
    """Λ_o a + μ_o + p_o = wrench on the object, at O in world axes (eq. 13 for the bare object)."""

    Lambda: Array  #: (6, 6) spatial inertia
    mu: Array  #: (6,) velocity-product wrench V ×* Λ_o V
    p: Array  #: (6,) gravity wrench


@dataclass(frozen=True)
class RigidObject:
    """A rigid body held by the arms; the origin of its frame is the operational point.

    Attributes:
        inertia: spatial inertia in the object frame (kg, m).

    Raises:
        ModelError: mass or rotational inertia not positive, or not finite.
    """

    inertia: pin.Inertia

    def __post_init__(self) -> None:
        matrix = self.inertia.matrix()
        if not np.isfinite(matrix).all():
            raise ModelError("object inertia holds a NaN or inf; check mass, lever and inertia")
        principal = np.linalg.eigvalsh(self.inertia.inertia)
        if self.inertia.mass <= 0.0 or principal[0] <= 1e-12 * principal[2]:  # 0 up to rounding
            raise ModelError(
                f"object of mass {self.inertia.mass:g} kg, principal inertias {principal} kg m²: "
                "all must be positive; give a real body, however light"
            )
        if principal[2] > (principal[0] + principal[1]) * (1 + 1e-9):
            raise ModelError(
                f"object with principal inertias {principal} kg m² cannot exist: the largest must "
                "not exceed the sum of the other two"
            )

    def terms(self, X_WO: pin.SE3, V_O: Array, gravity: Array) -> ObjectTerms:
        """Inertia, velocity and gravity wrenches at O; gravity (3,) in m/s².

        Args:
            X_WO: pose of the object. V_O: (6,) its twist at O. gravity: (3,) m/s².
        """
        at_O = pin.SE3(X_WO.rotation, np.zeros(3))
        Lambda: Array = at_O.act(self.inertia).matrix()
        mu = cross_wrench(V_O, Lambda @ V_O)
        p = -Lambda[:, :3] @ gravity
        return ObjectTerms(Lambda, mu, p)

    def scaled(self, factor: float) -> RigidObject:
        """The same body with mass and inertia times `factor` (to study model error).

        Raises:
            ModelError: the factor is not a positive number.
        """
        if not (np.isfinite(factor) and factor > 0.0):
            raise ModelError(
                f"object mass factor {factor}: give a positive number, 1 = as modelled"
            )
        I = self.inertia  # noqa: E741 - the field's letter
        return RigidObject(pin.Inertia(I.mass * factor, I.lever, I.inertia * factor))
