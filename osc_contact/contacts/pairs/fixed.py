"""The object clamped to the environment, and no contact at all."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.contacts.pairs.tangent_pair import TangentPair, held_axes

__all__ = ["Fixed", "Free"]

_ORIGIN = np.zeros(3)


@register_pair()
@dataclass(frozen=True, eq=False)
class Fixed(TangentPair):
    """The object clamped to the environment (r = 6): three distances of its origin, three angles.

    Attributes:
        assembled: the pose of the object in the environment frame.
        name: used in messages and recordings.
    """

    assembled: pin.SE3 = field(default_factory=pin.SE3.Identity)
    name: str = "fixed"

    def __post_init__(self) -> None:
        pose = self.assembled
        self._hold_tangents(_ORIGIN, np.eye(3), pose.translation, held_axes(pose.rotation))


@register_pair()
@dataclass(frozen=True, eq=False)
class Free(TangentPair):
    """No contact (r = 0)."""

    name: str = "free"

    def __post_init__(self) -> None:
        self._hold_tangents(_ORIGIN, np.zeros((3, 0)), _ORIGIN)
