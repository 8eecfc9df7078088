"""The one computation behind most pairs: points of the object, each held on a plane of E."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import (
    Bodies,
    lines_of_force,
    store,
    velocity,
)
from osc_contact.spatial import Array, skew

__all__ = ["PointsOnPlanes"]


class PointsOnPlanes:
    """r points pⱼ of A at the distance ρ from r planes of E with unit directions nⱼ into them.

    Nⱼ = [nⱼ; (pⱼ − O) × nⱼ]. nⱼ is fixed in the environment, pⱼ in the object: ṅ = ω_E × n,
    ṗ = v_O(p), so Ṅ = [ṅ; ṗ × n + (p − O) × ṅ] and n_γ = −ṄᵀV_rel
    = −ṅ · v_rel(p) − n · (ω_rel × ṗ). The gaps are the distances minus ρ. All this holds with open
    gaps too.

    A sphere or cylinder touches where its surface meets the plane, but its line of force passes
    through the centre or axis: `points` lie there and only the gap knows the radius ρ.
    """

    name: str
    _points: Array
    _into: Array
    _reach: Array

    def _hold(self, points: Array, into: Array, on_plane: Array, radius: float = 0.0) -> None:
        """Columns: points (3, r) in A, directions (3, r) and points of the planes (3, 1 or r) in E.

        The directions must be unit vectors.
        """
        store(self, _points=points, _into=into, _reach=(into * on_plane).sum(axis=0) - radius)

    def contact(
        self,
        X_WO: pin.SE3,
        V_O: Array,
        X_WE: pin.SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r) and n_γ (r,) at O, world axes (see `ContactPair.contact`)."""
        b = Bodies.at_O(X_WO, V_O, X_WE, V_E)
        n, p = b.turn_E(self._into), b.point_A(self._points)
        V_rel = b.V_rel
        turning = skew(V_rel[3:])
        n_gamma = -(n * (turning @ velocity(b.V_A, p))).sum(axis=0)
        if V_E is not None:
            n_dot = skew(b.V_E[3:]) @ n
            n_gamma -= (n_dot * (V_rel[:3, None] + turning @ p)).sum(axis=0)
        return Contact(lines_of_force(p, n), n_gamma, name=self.name)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(r,) signed distances (m), negative where the two overlap."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        p, n = b.point_A(self._points), b.turn_E(self._into)
        return self._reach + b.origin_E @ n - np.einsum("ij,ij->j", p, n)
