"""A slide between object and environment."""

from __future__ import annotations

from dataclasses import dataclass, field

import pinocchio as pin

from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.contacts.pairs.tangent_pair import TangentPair, held_axes, read_joint, slide
from osc_contact.spatial import Array

__all__ = ["Prismatic"]


@register_pair()
@dataclass(frozen=True, eq=False)
class Prismatic(TangentPair):
    """A slide: the object moves along an axis of the environment and does not turn (r = 5).

    Gaps: two distances of the point from the line, three angles.

    Attributes:
        point: (3,) a point of the line in the object frame (m).
        axis: (3,) in the object frame; normalised on entry.
        assembled: a pose of the object in the environment frame at which the slide is closed.
        name: used in messages and recordings.
    """

    point: Array
    axis: Array
    assembled: pin.SE3 = field(default_factory=pin.SE3.Identity)
    name: str = "prismatic"

    def __post_init__(self) -> None:
        read_joint(self)
        seat = self.assembled.rotation @ self.axis
        turns = held_axes(self.assembled.rotation)
        freedoms = (slide(self.point, seat),)
        on_line = self.assembled.act(self.point)
        self._hold_tangents(self.point, triad(seat)[:, :2], on_line, turns, freedoms)
