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
    """Readings of touched bodies that are computed when one of them is read.

    Most ticks do not read them, and they are costly. They are the readings of the instant at which
    the object is made. A copy of the object is a plain `Touched`.
    """

    @classmethod
    def of(cls, compute: Callable[[], Touched]) -> Touched:
        """Make readings from a function that computes them; it is called at most once.

        Args:
            compute: function that computes the motion of the touched bodies.
        """
        readings = cls.__new__(cls)
        readings.__dict__["_compute"] = compute
        return readings

    def __getattr__(self, name: str) -> Any:
        """Compute all readings at the first access to one, which is not an attribute yet.

        Raises:
            AttributeError: there is no such reading.
        """
        if name not in Touched.__dataclass_fields__ or "_compute" not in self.__dict__:
            raise AttributeError(name)
        self.__dict__.update(vars(self.__dict__.pop("_compute")()))
        return self.__dict__[name]

    def __reduce__(self) -> tuple[type[Touched], tuple[Array, Array, Array]]:
        """Return the parts of a copy, which is a plain `Touched`."""
        return Touched, (self.X_WE, self.V_E, self.A_E)


class Faces:
    """Bodies of an environment, with their states on their rails and the contacts on them.

    Attributes:
        rails: rail of each body.
        on: index of the body of each contact.
        s: (bodies, 2) travel (m) and angle (rad) of each body.
        rates: (bodies, 2) their first derivatives.
        second: (bodies, 2) second derivatives of driven bodies; zero for others.
        state: (3, bodies, 2) array of which `s`, `rates` and `second` are views.
        driven: function of time that prescribes the motion, by the index of a driven body.
        moving: whether any body has a joint, driven or free.
        free: indices of the bodies that follow the contact forces, and of the joint of each (0
            travel, 1 angle).
    """

    def __init__(
        self,
        rails: Sequence[Rail] | None,
        on: Sequence[int] | None,
        contacts: int = 0,
    ) -> None:
        """Set rails and contacts, with every body at rest in its initial pose.

        Args:
            rails: rail of each body; None: all bodies are at rest.
            on: index of the body of each contact; None: each contact has its own body.
            contacts: number of contacts, needed if `on` is None.
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
        #: pose of each body without a joint, which never changes; None: the body can move
        self._fixed = [None if rail.joints else rail.pose(np.zeros(2)) for rail in self.rails]
        self.state = np.zeros((3, len(self.rails), 2))
        self.s, self.rates, self.second = self.state
        are_all = len(self.driven) == len(self.rails)
        #: indices of the driven bodies
        self._driven = slice(None) if are_all else list(self.driven)
        self._reset_driven()

    def _reset_driven(self) -> None:
        """Reset the stored motion of driven bodies: time, and (3, driven, 2) position and rates."""
        self._commanded: tuple[float, Array] = nan, np.zeros((3, len(self.driven), 2))

    def reset(self) -> None:
        """Put all bodies in their initial pose, driven ones at the beginning of their motion."""
        self.state[:] = 0.0
        self._reset_driven()
        self.drive(0.0)

    def drive(self, t: float) -> None:
        """Set the state of the driven bodies at time t (s).

        The motions are evaluated once for each time, also if this is called repeatedly:
        `_commanded` has the last time and (3, driven, 2) displacements (m, rad), rates and
        accelerations along and about the rails; `_driven` the indices of the bodies.
        """
        if not self.driven:
            return
        if t != self._commanded[0]:
            motions = [motion(t) for motion in self.driven.values()]
            self._commanded = t, np.array(motions).swapaxes(0, 1)
        self.state[:, self._driven] = self._commanded[1]

    def pulls(self, gravity: Array) -> list[float]:
        """Force along each free joint without contact forces: weight, preload, spring (N, N m).

        Hinges are balanced: their weight has no moment.

        Args:
            gravity: (3,) acceleration of gravity, world axes (m/s²).
        """
        forces = []
        for i, k in zip(*self.free, strict=True):
            rail = self.rails[i]
            weight = rail.inertia * (rail.direction @ gravity)
            spring = rail.stiffness * self.s[i, k] + rail.damping * self.rates[i, k]
            forces.append(float(weight + rail.preload - spring))
        return forces

    def poses(self) -> list[pin.SE3]:
        """Pose X_WE of the frame of each contact's face."""
        return [self._fixed[body] or self.rails[body].pose(self.s[body]) for body in self.on]

    def twists(self, X_WE: Sequence[pin.SE3]) -> list[Array]:
        """Twist V_E (6,) of each contact's body, at the origin of its pose, world axes.

        Args:
            X_WE: poses by `poses`.
        """
        return [
            np.zeros(6)
            if self._fixed[body]
            else self.rails[body].twist(self.s[body], self.rates[body], X.translation)
            for body, X in zip(self.on, X_WE, strict=True)
        ]

    def parts(self, contacts: Sequence[ContactPair], X_WO: pin.SE3, V_O: Array) -> list[Contact]:
        """N and n_γ of each contact, for a state of the object and the present state of the bodies.

        Args:
            contacts: contact pairs.
            X_WO: pose of the object.
            V_O: (6,) its twist at O, world axes.
        """
        X_WE = self.poses()
        pairs = zip(contacts, X_WE, self.twists(X_WE), strict=True)
        return [pair.contact(X_WO, V_O, X_E, V_E) for pair, X_E, V_E in pairs]

    def gaps(
        self, contacts: Sequence[ContactPair], X_WO: pin.SE3
    ) -> tuple[Array, Callable[[], Array]]:
        """Gaps (r,) of the contacts (m), and a function that computes their N (6, r).

        Args:
            contacts: contact pairs.
            X_WO: pose of the object.
        """
        pairs = zip(contacts, self.poses(), strict=True)
        gaps = [np.zeros(0), *(pair.gaps(X_WO, X_E) for pair, X_E in pairs)]
        return np.concatenate(gaps), partial(self.normals, contacts, X_WO)

    def normals(self, contacts: Sequence[ContactPair], X_WO: pin.SE3) -> Array:
        """Directions of force N (6, r) of all contacts with the object at X_WO, world axes."""
        return stacked(self.parts(contacts, X_WO, np.zeros(6)))[0]

    def touched(self) -> Touched | None:
        """Readings of encoders on rails and drives at present; None if no body can move."""
        if not self.moving:
            return None
        s, rates, second = self.state.copy()
        return TouchedLater.of(partial(self._body_motions, s, rates, second))

    def _body_motions(self, s: Array, rates: Array, second: Array) -> Touched:
        """Poses, twists and known accelerations of the bodies of all contacts.

        Only driven bodies have known accelerations; those of others are zero.

        Args:
            s, rates, second: (bodies, 2) coordinates of the rails with first and second derivatives
                (m, rad, s).
        """
        poses = {}
        twists = {}
        accelerations = {}
        for body in set(self.on):
            rail = self.rails[body]
            X_WE = rail.pose(s[body])
            origin = X_WE.translation
            poses[body] = X_WE.homogeneous
            twists[body] = rail.twist(s[body], rates[body], origin)
            accelerations[body] = np.zeros(6)
            if body in self.driven:
                accelerations[body] = rail.acceleration(s[body], rates[body], second[body], origin)
        return Touched(
            np.reshape([poses[body] for body in self.on], (-1, 4, 4)),
            np.reshape([twists[body] for body in self.on], (-1, 6)),
            np.reshape([accelerations[body] for body in self.on], (-1, 6)),
        )

    def closing(self, parts: Sequence[Contact], point: Array) -> tuple[Array, Array]:
        """Rates at which the motion of the bodies changes the gaps: Nᵀ times their motion.

        Args:
            parts: contacts with N.
            point: (3,) point to which the columns of N refer (m).

        Returns:
            (r, bodies, 2) NᵀV for a unit rate of each joint; (r,) Nᵀa for the spatial acceleration
            a by present rates and drives.
        """
        r = sum(part.r for part in parts)
        by_rate = np.zeros((r, len(self.rails), 2))
        drift = np.zeros(r)
        end = 0
        for part, body in zip(parts, self.on, strict=True):
            rows = slice(end, end + part.r)
            end = rows.stop
            if self._fixed[body]:
                continue
            rail = self.rails[body]
            s = self.s[body]
            rates = self.rates[body]
            for k, unit_rate in enumerate(np.eye(2)):
                by_rate[rows, body, k] = part.N.T @ rail.twist(s, unit_rate, point)
            a = rail.acceleration(s, rates, self.second[body], point)
            drift[rows] = part.N.T @ classical_to_spatial(a, rail.twist(s, rates, point))
        return by_rate, drift


def stacked(parts: Sequence[Contact]) -> tuple[Array, Array]:
    """Concatenate N (6, r) and n_γ (r,) of all contacts, in their order."""
    N = np.hstack([np.zeros((6, 0)), *(part.N for part in parts)])
    return N, np.concatenate([np.zeros(0), *(part.n_gamma for part in parts)])
