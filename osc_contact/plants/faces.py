"""How the bodies of a plant's environment move: at rest, driven, or free on a slide or a hinge."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.environment import Rail
from osc_contact.interface import Touched
from osc_contact.spatial import Array, classical_to_spatial


class Faces:
    """The bodies of an environment, where they are on their rails, and what touches them.

    Attributes:
        rails: of each body. on: the body of each contact.
        s, rates, second: (bodies, 2) coordinates and derivatives; of `second` that of drives.
        driven: motions by body. moving: whether any body has a joint, driven or free.
        free: numbers of the bodies that follow the contact force, and of the joint of each.
    """

    def __init__(
        self,
        rails: Sequence[Rail] | None,
        on: Sequence[int] | None,
        contacts: int = 0,
    ) -> None:
        """Every body in its assembled pose.

        Args:
            rails: of each body; default: all rest. on: the body of each contact; default: each
                has its own. contacts: their number.
        """
        self.on = tuple(range(contacts) if on is None else on)
        self.rails = tuple(rails or [Rail()] * (max(self.on, default=-1) + 1))
        self.moving = any(rail.joints for rail in self.rails)
        self.driven = {i: rail.motion for i, rail in enumerate(self.rails) if rail.motion}
        free = [
            (i, rail.joints[0])
            for i, rail in enumerate(self.rails)
            if rail.joints and rail.motion is None
        ]
        self.free = tuple(np.array(free, dtype=int).reshape(-1, 2).T)
        self.s, self.rates, self.second = np.zeros((3, len(self.rails), 2))

    def drive(self, t: float) -> None:
        """Put the driven bodies where their motions are at time t (s)."""
        for i, motion in self.driven.items():
            self.s[i], self.rates[i], self.second[i] = motion(t)

    def pulls(self, gravity: Array) -> list[float]:
        """Force along each free joint besides the contacts' (N, N m); hinges are balanced.

        Args:
            gravity: (3,) m/s².
        """
        forces = []
        for i, k in zip(*self.free, strict=True):
            rail = self.rails[i]
            weight = rail.inertia * (rail.direction @ gravity)
            spring = rail.stiffness * self.s[i, k] + rail.damping * self.rates[i, k]
            forces.append(float(weight + rail.preload - spring))
        return forces

    def poses(self) -> list[pin.SE3]:
        """X_WE of the body at each contact."""
        return [self.rails[body].pose(self.s[body]) for body in self.on]

    def twists(self, X_WE: Sequence[pin.SE3]) -> list[Array]:
        """V_E, (6,) each, of the bodies at the contacts, at the origins of their poses."""
        return [
            self.rails[body].twist(self.s[body], self.rates[body], X.translation)
            for body, X in zip(self.on, X_WE, strict=True)
        ]

    def parts(self, contacts: Sequence[ContactPair], X_WO: pin.SE3, V_O: Array) -> list[Contact]:
        """N and n_γ of every contact with the object at X_WO, V_O (6,) and the bodies as they are.

        Args:
            contacts: the pairs. X_WO: pose of the object. V_O: its twist.
        """
        X_WE = self.poses()
        pairs = zip(contacts, X_WE, self.twists(X_WE), strict=True)
        return [pair.contact(X_WO, V_O, X_E, V_E) for pair, X_E, V_E in pairs]

    def gaps(self, contacts: Sequence[ContactPair], X_WO: pin.SE3) -> tuple[Array, Array]:
        """(r,) gaps (m) of the contacts with the object at X_WO, and their N (6, r)."""
        pairs = zip(contacts, self.poses(), strict=True)
        gaps = [np.zeros(0), *(pair.gaps(X_WO, X_E) for pair, X_E in pairs)]
        return np.concatenate(gaps), stacked(self.parts(contacts, X_WO, np.zeros(6)))[0]

    def touched(self) -> Touched | None:
        """Readings of encoders on the rails and drives; None where nothing can move."""
        if not self.moving:
            return None
        X_WE = self.poses()
        A = np.zeros((len(self.on), 6))
        for i, body in enumerate(self.on):
            if body in self.driven:
                along = self.s[body], self.rates[body], self.second[body]
                A[i] = self.rails[body].acceleration(*along, X_WE[i].translation)
        X = np.array([X.homogeneous for X in X_WE]).reshape(-1, 4, 4)
        return Touched(X, np.reshape(self.twists(X_WE), (-1, 6)), A)

    def closing(self, parts: Sequence[Contact], point: Array) -> tuple[Array, Array]:
        """Nᵀ × the motion of the bodies: how fast each gap closes with them.

        Args:
            parts: the contacts. point: (3,) where their columns are given.

        Returns:
            (r, bodies, 2) for the twist per unit rate; (r,) for the spatial acceleration that the
            rates and the drives make.
        """
        r = sum(part.r for part in parts)
        along = np.zeros((r, len(self.rails), 2))
        drift = np.zeros(r)
        end = 0
        for part, body in zip(parts, self.on, strict=True):
            rows = slice(end, end + part.r)
            end = rows.stop
            rail = self.rails[body]
            s = self.s[body]
            rates = self.rates[body]
            for k, rate in enumerate(np.eye(2)):
                along[rows, body, k] = part.N.T @ rail.twist(s, rate, point)
            a = rail.acceleration(s, rates, self.second[body], point)
            drift[rows] = part.N.T @ classical_to_spatial(a, rail.twist(s, rates, point))
        return along, drift


def stacked(parts: Sequence[Contact]) -> tuple[Array, Array]:
    """N (6, r) and n_γ (r,) of all contacts side by side."""
    N = np.hstack([np.zeros((6, 0)), *(c.N for c in parts)])
    return N, np.concatenate([np.zeros(0), *(c.n_gamma for c in parts)])
