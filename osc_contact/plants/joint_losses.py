"""What friction takes from the joints of the exact plant: viscous, and dry, smooth near rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array

__all__ = ["JointLosses"]

_SLIP, _SLIDE = 1e-3, 1e-4  #: speeds by which dry friction is developed (rad/s, m/s)


@dataclass(frozen=True)
class JointLosses:
    """D v + F tanh(v / v_0) against each joint's motion.

    Attributes:
        damping: (n,) D (N m s/rad; N s/m). friction: (n,) F (N m; N). slip: (n,) v_0 (rad/s; m/s).
    """

    damping: Array
    friction: Array
    slip: Array

    @classmethod
    def of(cls, model: pin.Model) -> JointLosses:
        """The losses of the model."""
        slides = [j.shortname().startswith("JointModelP") for j in list(model.joints)[1:]]
        slip = np.where(slides, _SLIDE, _SLIP)
        return cls(np.array(model.damping), np.array(model.upperDryFrictionLimit), slip)

    def torque(self, v: Array) -> Array:
        """(n,) at joint velocities v (n,)."""
        return np.asarray(self.damping * v + self.friction * np.tanh(v / self.slip))

    def slope(self, v: Array) -> Array:
        """(n,) its derivative there, by which a step looks ahead."""
        rest = 1.0 - np.tanh(v / self.slip) ** 2
        return np.asarray(self.damping + self.friction / self.slip * rest)
