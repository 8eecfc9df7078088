"""A push away from joint position limits, for the posture task of redundant arms."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pinocchio as pin

from osc_contact.law.allocation import push_from_limits
from osc_contact.law.jit import as_python
from osc_contact.spatial import Array

__all__ = ["JointLimitAvoidance"]

_push = as_python(push_from_limits)  # in Python, joint by joint
_WHOLE = np.pi  #: rad or m; a larger range, or one that is open, counts as this much


@dataclass(frozen=True)
class JointLimitAvoidance:
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
    def of(cls, model: pin.Model, stiffness: float, margin: float) -> JointLimitAvoidance:
        """From the model's position limits; margin: share of a joint's range, at each end of it.

        A range counts as π (rad or m) at most.

        Args:
            model: of all arms. stiffness: N m/rad, N/m. margin: share of a joint's range.
        """
        lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
        with np.errstate(over="ignore"):  # limits of ±1.8e308 stand for none
            width = margin * np.minimum(upper - lower, _WHOLE)
        return cls(lower + width, upper - width, width, stiffness * width)

    def push(self, q: Array) -> Array:
        """(n,) acceleration at joint positions q (n,)."""
        rows = zip(self.low, self.high, self.width, self.most, strict=True)
        joints = [SimpleNamespace(low=a, high=b, width=w, most=k) for a, b, w, k in rows]
        return np.array([_push(joint, x) for joint, x in zip(joints, q, strict=True)])
