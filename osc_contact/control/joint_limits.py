"""A push away from joint position limits, for the posture task of redundant arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array

__all__ = ["JointLimits"]

_WHOLE = np.pi  #: rad or m; a larger range, or one that is open, counts as this much


@dataclass(frozen=True)
class JointLimits:
    """Accelerations that keep joints off their limits: 0 outside a margin, bounded inside it.

    At depth s of the margin w (0 where it begins, 1 at the limit and beyond it) a joint is pushed
    back by a = k w (3s² − 2s³), the slope of a potential of k w² (s³ − s⁴/2): continuous with its
    first derivative, and never above k w (a potential field after Khatib, 1986).

    Attributes:
        low, high: (n,) where the margins begin; −inf, inf at ends without limit.
        width: (n,) of the margins, w. most: (n,) k w.
    """

    low: Array
    high: Array
    width: Array
    most: Array

    @classmethod
    def of(cls, model: pin.Model, stiffness: float, margin: float) -> JointLimits:
        """From the model's position limits; margin: share of a joint's range, at each end of it.

        A range counts as π (rad or m) at most.
        """
        lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
        with np.errstate(over="ignore"):  # limits of ±1.8e308 stand for none
            width = margin * np.minimum(upper - lower, _WHOLE)
        return cls(lower + width, upper - width, width, stiffness * width)

    def push(self, q: Array) -> Array:
        """(n,) acceleration at joint positions q (n,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(q < self.low, self.low - q, np.maximum(q - self.high, 0.0))
            s = np.where(depth > 0.0, np.minimum(depth / self.width, 1.0), 0.0)
        return np.asarray(np.where(q < self.low, 1.0, -1.0) * self.most * s * s * (3.0 - 2.0 * s))
