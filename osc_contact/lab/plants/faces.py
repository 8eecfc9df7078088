"""Motion of the bodies in a plant's environment: at rest, driven, or free on a slide or hinge."""

from collections.abc import Callable, Sequence
from functools import partial
from math import nan
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.environment import Rail
from osc_contact.interface import Touched
from osc_contact.spatial import Array, classical_to_spatial


class TouchedLater(Touched):
    """Readings that are worked out when one of them is read; a copy of it is a plain `Touched`.

    They are those of the instant at which it was made: nothing that changes later is in them.
    """

    @classmethod
    def of(cls, work_out: Callable[[], Touched]) -> Touched:
        """Readings that a function gives, which is called once or not at all."""
        made = cls.__new__(cls)
        made.__dict__["_work_out"] = work_out
        return made

    def __getattr__(self, name: str) -> Any:
        """A reading, where none was read before."""
        if name not in Touched.__dataclass_fields__ or "_work_out" not in self.__dict__:
            raise AttributeError(name)
        self.__dict__.update(vars(self.__dict__.pop("_work_out")()))
        return self.__dict__[name]

    def __reduce__(self) -> tuple[type[Touched], tuple[Array, Array, Array]]:
        return Touched, (self.X_WE, self.V_E, self.A_E)


class Faces:
    """The bodies of an environment, where they are on their rails, and what touches them.

    Attributes:
        rails: rail of each body. on: the body of each contact.
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
            rails: rail of each body; default: all rest. on: the body of each contact; default: each
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
        self._driven = list(self.driven)
        self._forget()

    def _forget(self) -> None:
        """Reset the stored motion of driven bodies: time, and (3, driven, 2) position and rates."""
        self._commanded: tuple[float, Array] = nan, np.zeros((3, len(self._driven), 2))

    def reset(self) -> None:
        """Every body in its assembled pose, the driven ones where their motions begin."""
        for x in (self.s, self.rates, self.second):
            x[:] = 0.0
        self._forget()
        self.drive(0.0)

    def drive(self, t: float) -> None:
        """Put the driven bodies where their motions are at time t (s).

        The motions are evaluated once an instant, however often that is.
        """
        if not self.driven:
            return
        if t != self._commanded[0]:
            motions = [motion(t) for motion in self.driven.values()]
            self._commanded = t, np.array(motions).swapaxes(0, 1)
        bodies = self._driven
        self.s[bodies], self.rates[bodies], self.second[bodies] = self._commanded[1]

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

    def gaps(
        self, contacts: Sequence[ContactPair], X_WO: pin.SE3
    ) -> tuple[Array, Callable[[], Array]]:
        """(r,) gaps (m) of the contacts with the object at X_WO, and what gives their N (6, r)."""
        pairs = zip(contacts, self.poses(), strict=True)
        gaps = [np.zeros(0), *(pair.gaps(X_WO, X_E) for pair, X_E in pairs)]
        return np.concatenate(gaps), partial(self.normals, contacts, X_WO)

    def normals(self, contacts: Sequence[ContactPair], X_WO: pin.SE3) -> Array:
        """N (6, r) of all contacts with the object at X_WO."""
        return stacked(self.parts(contacts, X_WO, np.zeros(6)))[0]

    def touched(self) -> Touched | None:
        """Readings of encoders on the rails and drives; None where nothing can move."""
        if not self.moving:
            return None
        s, rates, second = np.array((self.s, self.rates, self.second))
        return TouchedLater.of(partial(self._work_out, s, rates, second))

    def _work_out(self, s: Array, rates: Array, second: Array) -> Touched:
        """The readings at given coordinates and derivatives, (bodies, 2) each."""
        motion = {}
        for body in set(self.on):
            rail = self.rails[body]
            X_WE = rail.pose(s[body])
            A_E = np.zeros(6)
            if body in self.driven:
                A_E = rail.acceleration(s[body], rates[body], second[body], X_WE.translation)
            motion[body] = X_WE.homogeneous, rail.twist(s[body], rates[body], X_WE.translation), A_E
        shapes = (-1, 4, 4), (-1, 6), (-1, 6)
        each = ([motion[body][k] for body in self.on] for k in range(3))
        return Touched(*(np.reshape(x, shape) for x, shape in zip(each, shapes, strict=True)))

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
