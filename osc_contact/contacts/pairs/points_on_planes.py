"""Pairs made of points of the object, each held on a plane of the environment."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.law_pair import LawPair, PairRow, shape
from osc_contact.contacts.pairs.pair import Bodies, store
from osc_contact.law.records import POINTS
from osc_contact.spatial import Array

__all__ = ["PointsOnPlanes", "ends"]


class PointsOnPlanes(LawPair):
    """r points pⱼ of A at the distance ρ from r planes of E with unit directions nⱼ into them.

    Nⱼ = [nⱼ; (pⱼ − O) × nⱼ]. nⱼ is fixed in the environment, pⱼ in the object: ṅ = ω_E × n,
    ṗ = v_O(p), so Ṅ = [ṅ; ṗ × n + (p − O) × ṅ] and n_γ = −ṄᵀV_rel
    = −ṅ · v_rel(p) − n · (ω_rel × ṗ). The gaps are the distances minus ρ. All this holds with open
    gaps too.

    A sphere or cylinder touches where its surface meets the plane, but its line of force passes
    through the centre or axis: `points` are there and only the gap contains the radius ρ.
    """

    _points: Array
    _into: Array
    _reach: Array
    _heights: Array

    def _hold_points(
        self, points: Array, into: Array, on_plane: Array, radius: float = 0.0
    ) -> None:
        """Take points (3, r) of A, unit directions (3, r) and points of the planes (3, 1 or r)."""
        heights = (into * on_plane).sum(axis=0)
        store(self, _points=points, _into=into, _reach=heights - radius, _heights=heights)
        shapes = (shape(*one) for one in zip(points.T, into.T, heights, strict=True))
        self._hold(PairRow(POINTS, tuple(shapes)), on_plane[:, 0])

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(r,) signed distances (m), negative where the two overlap."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        p = b.point_A(self._points)
        n = b.rotate_E(self._into)
        return self._reach + b.origin_E @ n - np.einsum("ij,ij->j", p, n)


def ends(point: Array, direction: Array, length: float) -> Array:
    """(3, 2) the two ends of a segment whose middle is `point`.

    Args:
        point, direction: (3,) middle (m) and unit vector. length: m.
    """
    half = 0.5 * length * direction
    return np.column_stack((point - half, point + half))
