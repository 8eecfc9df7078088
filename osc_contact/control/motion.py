"""Gains of the motion law, p̈_u = p̈_d + K_d ė + K_p e + K_i ∫e."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError

__all__ = ["MotionGains"]


@dataclass(frozen=True)
class MotionGains:
    """Scalar gains, the same for positions and angles, so that no metre meets a radian.

    Attributes:
        stiffness: 1/s². damping: 1/s. integral: 1/s³.
    """

    stiffness: float = 400.0
    damping: float = 40.0
    integral: float = 0.0

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise InvalidInputError(f"motion gain {key} = {value}; give a finite number ≥ 0")
        if self.integral > 0.0 and self.integral >= self.stiffness * self.damping:
            raise InvalidInputError(
                f"motion gain integral = {self.integral:g} 1/s³ is not below stiffness × damping = "
                f"{self.stiffness * self.damping:g}: the loop would be unstable (Routh). Lower it."
            )
