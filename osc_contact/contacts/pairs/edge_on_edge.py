"""An edge of the object across an edge of the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.law_pair import LawPair, PairRow, shape
from osc_contact.contacts.pairs.pair import Bodies, read_geometry
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.errors import InvalidInputError
from osc_contact.law.records import EDGES
from osc_contact.scenarios.bodies import BodyDirection, BodyPoint, OnBodySpec
from osc_contact.scenarios.quantities import UnitVec3, Vec3
from osc_contact.spatial import Array

__all__ = ["EdgeOnEdge"]


class EdgeOnEdgeSpec(OnBodySpec):
    """An edge of the object across an edge of a body, r = 1."""

    forces: ClassVar[int] = 1
    type: Literal["edge_on_edge"] = "edge_on_edge"
    point: Vec3
    """a point of the object's edge [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the object's edge [x, y, z] in the object frame"""
    edge_point: BodyPoint
    """a point of the body's edge [x, y, z] in the body frame"""
    edge_direction: BodyDirection
    """along the body's edge [x, y, z] in the body frame"""
    edge_outward: BodyDirection
    """roughly out of the body at its edge [x, y, z] in the body frame"""


@register_pair(
    EdgeOnEdgeSpec,
    point="point_A",
    direction="direction_A",
    edge_point="point_E",
    edge_direction="direction_E",
    edge_outward="side",
)
@dataclass(frozen=True, eq=False)
class EdgeOnEdge(LawPair):
    """An edge of the held object across an edge of the environment (r = 1).

    N = [n; (p − O) × n], n = ± e_A × e_E / |e_A × e_E| into the environment, p the crossing point,
    which neither body carries: it slides along both edges, ṗ = v_A(p) + ṡ e_A. With e_A, e_E unit,
    ṅ = ± (1 − nnᵀ)(ė_A × e_E + e_A × ė_E) / |e_A × e_E|. With the gap g open, p is the
    point of the object's edge nearest to the other one and
    ṫ e_E − ṡ e_A = v_A(p) − v_E(p + g n) + g ṅ in the plane ⟂ n, so N and n_γ stay exact.

    Attributes:
        point_A: (3,) a point of the object's edge, in the object frame (m).
        direction_A: (3,) along that edge; normalised on entry.
        point_E: (3,) a point of the environment's edge, in the environment frame (m).
        direction_E: (3,) along that edge; normalised on entry.
        side: which way n points: +1 along e_A × e_E, −1 against it, or an outward normal (3,) of
            the environment at its edge, in the environment frame; roughly is enough, its component
            along e_A × e_E decides.
        name: used in messages and recordings.
    """

    point_A: Array
    direction_A: Array
    point_E: Array
    direction_E: Array
    side: float | Array = 1.0
    name: str = "edge_on_edge"
    pushes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        edge = "direction of the edge"
        read_geometry(self, "point_A", "point_E", direction_A=edge, direction_E=edge)
        if np.ndim(self.side) > 0:
            read_geometry(self, side="environment's outward normal")
        elif self.side not in (1, -1):
            raise InvalidInputError(
                f"{self.name}.side = {self.side}; give +1 or −1 (times e_A × e_E), or a vector "
                "that points out of the environment, towards the object"
            )
        side = (0.0, self.side) if np.ndim(self.side) else (self.side, np.zeros(3))
        lines = self.point_A, self.direction_A, self.point_E, self.direction_E
        self._hold(PairRow(EDGES, (shape(*lines, *side),)), self.point_E)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(1,) distance between the two lines (m), negative when they have passed each other."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        n = self.contact(X_WO, np.zeros(6), X_WE).N[:3, 0]
        return (n @ (b.point_E(self.point_E) - b.point_A(self.point_A)))[None]
