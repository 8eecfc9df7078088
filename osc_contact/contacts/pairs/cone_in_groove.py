"""The cone in its groove (fig. 2 of the paper): a pair given by T that no constraint frame fits."""

from __future__ import annotations

from dataclasses import dataclass

from osc_contact.contacts.pairs.pair import read_geometry, triad
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.contacts.pairs.tangent_pair import TangentPair, held_axis, rotation, slide
from osc_contact.spatial import Array

__all__ = ["ConeInGroove"]


@register_pair()
@dataclass(frozen=True, eq=False)
class ConeInGroove(TangentPair):
    """Fig. 2 of the paper: a cone turns about its axis and slides along a groove (r = 4).

    T = [rotation about the cone's axis, carried by the object | translation along the groove,
    carried by the environment]. The gaps: two distances of the apex from the groove's line, two
    angles of the axis from its seat. No constraint frame describes it unless seat and groove are
    parallel or perpendicular.

    Attributes:
        apex: (3,) of the cone in the object frame (m).
        axis: (3,) of the cone in the object frame; normalised on entry.
        groove_point: (3,) a point of the line on which the apex slides, environment frame (m).
        groove_direction: (3,) along that line, environment frame; normalised on entry.
        seat: (3,) the direction the cone's axis has in the environment frame; normalised.
        name: used in messages and recordings.
    """

    apex: Array
    axis: Array
    groove_point: Array
    groove_direction: Array
    seat: Array
    name: str = "cone_in_groove"

    def __post_init__(self) -> None:
        read_geometry(
            self,
            "apex",
            "groove_point",
            axis="axis of the cone",
            groove_direction="direction of the groove",
            seat="direction of the seated cone's axis",
        )
        across = triad(self.groove_direction)[:, :2]
        freedoms = rotation(self.apex, self.axis), slide(self.apex, self.groove_direction)
        tilts = held_axis(self.axis, self.seat)
        self._hold_tangents(self.apex, across, self.groove_point, tilts, freedoms)
