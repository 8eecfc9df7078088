"""Pairs with a face of the object on a vertex of the environment, and with two crossed edges.

Each pair states its geometry in `_make`, which is called at the end of its construction: a row of
numbers by `shape`, which is stored with its kind by `_store_geometry` and read by the law's
function for this kind.
"""

from __future__ import annotations

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.pairs.keys import (
    BodyDirection,
    BodyPoint,
    Direction,
    Outward,
    Point,
    Radius,
    store,
)
from osc_contact.contacts.pairs.law_pair import LawPair, shape
from osc_contact.contacts.pairs.pair import AT_REST
from osc_contact.contacts.pairs.register import register_pair
from osc_contact.errors import InvalidInputError
from osc_contact.law.records import EDGES, FACE_ON_VERTEX
from osc_contact.spatial import Array, unit_vector

# A face of the object on a vertex of the environment.


@register_pair(forces=1)
class FaceOnVertex(LawPair):
    """A face of the object on a (rounded) vertex of the environment, r = 1.

    N = [n; (p − O) × n] with n the *outward* normal of the object's face, which points into the
    environment, and p the vertex. n is fixed to the object and p to the environment: ṅ = ω_O × n,
    ṗ = v_E(p).

    Example:
        >>> tip = osc.FaceOnVertex([0, 0, -0.1], [0, 0, -1], body_vertex=[0, 0, 0.3], radius=0.01)
        >>> print(tip.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.45]))).round(6))
        [0.04]
    """

    point: Point
    """a point of the object's face [x, y, z] in the object frame"""
    normal: Direction
    """the outward normal of the object's face [x, y, z] in the object frame"""
    body_vertex: BodyPoint
    """the centre of the rounded vertex [x, y, z] in the body frame"""
    radius: Radius = 0.0
    """the radius of the rounding"""
    name: str = "face_on_vertex"
    pushes = True

    def _make(self) -> None:
        """Make the pair's row of the law."""
        row = shape(self.normal, self.body_vertex, self.radius)
        self._store_geometry(self.body_vertex, FACE_ON_VERTEX, (row,))
        store(self, surface_radius=self.radius)

    def _gaps(self, X_EA: SE3) -> Array:
        """Distance (1,) between face and vertex surface (m), negative when they overlap.

        Args:
            X_EA: pose of the object in the frame of the environment's body.
        """
        R = X_EA.rotation
        distance_vector = self.body_vertex - X_EA.translation - R @ self.point
        return np.array([R @ self.normal @ distance_vector - self.radius])


# An edge of the object across an edge of the environment.


@register_pair(forces=1)
class EdgeOnEdge(LawPair):
    """An edge of the object across an edge of the environment, r = 1.

    N = [n; (p − O) × n] with n = ± e_A × e_E / |e_A × e_E| into the environment, e_A and e_E unit
    vectors, and p the crossing point. p is fixed to neither body, but slides along both edges,
    ṗ = v_A(p) + ṡ e_A, and ṅ = ± (1 − nnᵀ)(ė_A × e_E + e_A × ė_E) / |e_A × e_E|. With an open gap
    g, p is the point of the object's edge that is nearest to the other edge, and
    ṫ e_E − ṡ e_A = v_A(p) − v_E(p + g n) + g ṅ in the plane perpendicular to n, so that N and n_γ
    are exact for open gaps, too.

    Example:
        >>> point, along, across, up = [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]
        >>> edges = osc.EdgeOnEdge(point, along, point, across, edge_outward=up)
        >>> print(edges.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.02]))).round(6))
        [0.02]
    """

    point: Point
    """a point of the object's edge [x, y, z] in the object frame"""
    direction: Direction
    """the direction of the object's edge [x, y, z] in the object frame"""
    edge_point: BodyPoint
    """a point of the body's edge [x, y, z] in the body frame"""
    edge_direction: BodyDirection
    """the direction of the body's edge [x, y, z] in the body frame"""
    edge_outward: Outward
    """a direction roughly out of the body at its edge [x, y, z] in the body frame; the sign of its
    component along direction × edge_direction determines the side. In Python also this sign, +1 or
    −1"""
    name: str = "edge_on_edge"
    pushes = True

    def _make(self) -> None:
        """Validate `edge_outward`, ±1 or a vector, and make the pair's row of the law.

        Raises:
            InvalidInputError: `edge_outward` is another number, or a vector of zero length.
        """
        out = self.edge_outward
        if np.ndim(out) > 0:
            out = unit_vector(f"{self.name}.edge_outward", out)
        elif out not in (1, -1):
            raise InvalidInputError(
                f"{self.name}.edge_outward = {out}; give +1 or −1 (times e_A × e_E), or a vector "
                "that points out of the environment, towards the object"
            )
        side = (0.0, out) if np.ndim(out) else (out, np.zeros(3))
        lines = (self.point, self.direction, self.edge_point, self.edge_direction)
        self._store_geometry(self.edge_point, EDGES, (shape(*lines, *side),))

    def _gaps(self, X_EA: SE3) -> Array:
        """Distance (1,) between the two edges (m), negative when they have passed each other."""
        n = self.contact(X_EA, AT_REST).N[:3, 0]
        return np.array([n @ (self.edge_point - X_EA.act(self.point))])
