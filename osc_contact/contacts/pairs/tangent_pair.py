"""The computation behind the pairs given by T: N annihilates T by construction, n_γ = NᵀṪβ."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import Bodies, lines_of_force, store, triad
from osc_contact.spatial import Array, cross, cross_twist

__all__ = ["Freedom", "TangentPair", "turn", "slide", "held_axis", "held_axes"]

#: (t, reader, carrier): a permitted motion, the wrench that reads its rate β from V_rel, and the
#: twist of the body that carries its axis.
Freedom = tuple[Array, Array, Array]


def turn(p: Array, axis: Array, carrier: Array) -> Freedom:
    """Rotation about a unit axis through p (from O)."""
    couple = np.concatenate((np.zeros(3), axis))
    return np.concatenate((cross(p, axis), axis)), couple, carrier


def slide(p: Array, direction: Array, carrier: Array) -> Freedom:
    """Translation along a unit direction, its rate read at the point p (from O) of the object."""
    return np.concatenate((direction, np.zeros(3))), lines_of_force(p, direction), carrier


class TangentPair(ABC):
    """A pair whose T = [t₁ …] is known: n_γ = NᵀṪβ, V_rel = Tβ, ṫⱼ = V_b(j) × tⱼ (paper, sec. 3).

    b(j) is the body that carries the axis of tⱼ. N has explicit columns, smooth in the pose, that
    annihilate T and are the gradients of the gaps:

    * points pⱼ of A on planes of E with directions nⱼ: column [n; p × n], gap −n·(p − q);
    * directions aⱼ of A at right angles to directions uⱼ of E: column [0; a × u], gap −a·u.

    Unlike a magnitude of a face, these have either sign.
    """

    name: str
    _points: Array
    _into: Array
    _reach: Array
    _arms: Array
    _marks: Array

    def _hold(self, point: Array, into: Array, on_plane: Array, arms: Array, marks: Array) -> None:
        """One point (3,) of A, unit directions (3, k) and a plane point (3,) of E; arms (3, m) in
        A at right angles to marks (3, m) in E."""
        store(
            self,
            _points=np.tile(point[:, None], into.shape[1]),
            _into=into,
            _reach=on_plane @ into,
            _arms=arms,
            _marks=marks,
        )

    @abstractmethod
    def _freedoms(self, b: Bodies) -> list[Freedom]:
        """The 6 − r permitted motions."""

    def _normals(self, b: Bodies) -> Array:
        """N (6, r)."""
        forces = lines_of_force(b.point_A(self._points), b.turn_E(self._into))
        couples = cross(b.R_A @ self._arms, b.turn_E(self._marks))
        return np.hstack((forces, np.vstack((np.zeros_like(couples), couples))))

    def contact(
        self,
        X_WO: pin.SE3,
        V_O: Array,
        X_WE: pin.SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r), T (6, 6−r) and n_γ (r,) at O, world axes (see `ContactPair.contact`)."""
        b = Bodies.at_O(X_WO, V_O, X_WE, V_E)
        N, V_rel = self._normals(b), b.V_rel
        T, T_dot_beta = np.zeros((6, 6 - N.shape[1])), np.zeros(6)
        for j, (t, reader, carrier) in enumerate(self._freedoms(b)):
            T[:, j] = t
            T_dot_beta += cross_twist(carrier, t) * (reader @ V_rel)
        return Contact(N, T_dot_beta @ N, T=T, name=self.name)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(r,) signed errors: m for the points, rad (to first order) for the directions."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        p, n = b.point_A(self._points), b.turn_E(self._into)
        distances = self._reach + b.origin_E @ n - np.einsum("ij,ij->j", p, n)
        angles = -np.einsum("ij,ij->j", b.R_A @ self._arms, b.turn_E(self._marks))
        return np.concatenate((distances, angles))


def held_axis(axis: Array, seat: Array) -> tuple[Array, Array]:
    """Arms and marks (3, 2) that keep `axis` of A along `seat` of E; couples along triad(seat)."""
    x, y, _ = triad(seat).T
    return np.column_stack((axis, axis)), np.column_stack((-y, x))


def held_axes(R_EA: Array) -> tuple[Array, Array]:
    """Arms and marks (3, 3) that keep A's orientation in E at R_EA; couples along E's axes."""
    return R_EA.T[:, [1, 2, 0]], np.eye(3)[:, [2, 0, 1]]
