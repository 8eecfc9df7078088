"""A hinge between object and environment."""

from __future__ import annotations

from dataclasses import dataclass, field

import pinocchio as pin

from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.contacts.pairs.tangent_pair import TangentPair, held_axis, read_joint, rotation
from osc_contact.spatial import Array

__all__ = ["Revolute"]


@register_pair()
@dataclass(frozen=True, eq=False)
class Revolute(TangentPair):
    """A hinge: the object turns about an axis of the environment (r = 5).

    Gaps: three distances of the point, two angles of the axis.

    Attributes:
        point: (3,) a point of the axis in the object frame (m).
        axis: (3,) in the object frame; normalised on entry.
        assembled: a pose of the object in the environment frame at which the hinge is closed.
        name: used in messages and recordings.
    """

    point: Array
    axis: Array
    assembled: pin.SE3 = field(default_factory=pin.SE3.Identity)
    name: str = "revolute"

    def __post_init__(self) -> None:
        read_joint(self)
        seat = self.assembled.rotation @ self.axis
        tilts = held_axis(self.axis, seat)
        freedoms = (rotation(self.point, self.axis),)
        on_axis = self.assembled.act(self.point)
        self._hold_tangents(self.point, triad(seat), on_axis, tilts, freedoms)
