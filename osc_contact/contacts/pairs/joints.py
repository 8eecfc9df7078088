"""Pairs given by T: lower pairs of mechanism theory, from the clamp to no contact at all."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import Bodies, lines_of_force, read_geometry, store, triad
from osc_contact.contacts.pairs.tangent_pair import (
    Freedom,
    TangentPair,
    held_axes,
    held_axis,
    slide,
    turn,
)
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["Revolute", "Prismatic", "Screw", "Fixed", "Free"]

_ORIGIN = np.zeros(3)
_NONE = np.zeros((3, 0))


@dataclass(frozen=True, eq=False)
class Revolute(TangentPair):
    """A hinge: the object turns about an axis of the environment (r = 5).

    Gaps: three distances of the point, two angles of the axis.

    Attributes:
        point: (3,) a point of the axis in the object frame (m).
        axis: (3,) in the object frame; normalised on entry.
        assembled: a pose of the object in the environment frame at which the hinge is closed.
        name: used in messages and recordings.
    """

    point: Array
    axis: Array
    assembled: pin.SE3 = field(default_factory=pin.SE3.Identity)
    name: str = "revolute"

    def __post_init__(self) -> None:
        _read_joint(self)
        seat = self.assembled.rotation @ self.axis
        tilts = held_axis(self.axis, seat)
        self._hold(self.point, triad(seat), self.assembled.act(self.point), *tilts)

    def _freedoms(self, b: Bodies) -> list[Freedom]:
        return [turn(b.point_A(self.point), b.R_A @ self.axis, b.V_A)]


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
        _read_joint(self)
        seat = self.assembled.rotation @ self.axis
        turns = held_axes(self.assembled.rotation)
        self._hold(self.point, triad(seat)[:, :2], self.assembled.act(self.point), *turns)

    def _freedoms(self, b: Bodies) -> list[Freedom]:
        axis = b.turn_E(self.assembled.rotation @ self.axis)
        return [slide(b.point_A(self.point), axis, b.V_E)]


@dataclass(frozen=True, eq=False)
class Screw(TangentPair):
    """A screw: the object turns about an axis of the environment and advances with it (r = 5).

    Gaps: two distances of the point from the axis, two angles of the axis, and the advance that
    the angle does not account for, to the nearest turn of the thread (m). Their gradient is −N in
    the assembled screw; N annihilates T in any pose.

    Attributes:
        point: (3,) a point of the axis in the object frame (m).
        axis: (3,) in the object frame; normalised on entry.
        pitch: advance along the axis (m/rad, not per turn); negative: left-handed.
        assembled: a pose of the object in the environment frame at which the screw is closed.
        name: used in messages and recordings.
    """

    point: Array
    axis: Array
    pitch: float
    assembled: pin.SE3 = field(default_factory=pin.SE3.Identity)
    name: str = "screw"
    _seat: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _read_joint(self)
        if not np.isfinite(self.pitch) or self.pitch == 0.0:
            raise InvalidInputError(
                f"{self.name}.pitch = {self.pitch}; give m/rad other than 0 (else: Revolute)"
            )
        store(self, _seat=triad(self.assembled.rotation @ self.axis))
        tilts = held_axis(self.axis, self._seat[:, 2])
        on_axis = self.assembled.act(self.point)
        self._hold(self.point, self._seat[:, :2], on_axis, *tilts)

    def _normals(self, b: Bodies) -> Array:
        d = b.turn_E(self._seat[:, 2])
        thread = lines_of_force(b.point_A(self.point), d)
        thread[3:] -= self.pitch / (d @ (b.R_A @ self.axis)) * d
        return np.column_stack((super()._normals(b), thread))

    def _freedoms(self, b: Bodies) -> list[Freedom]:
        axis, d = b.R_A @ self.axis, b.turn_E(self._seat[:, 2])
        t, reader, carrier = turn(b.point_A(self.point), axis, b.V_A)
        t[:3] += self.pitch * d
        return [(t, reader, carrier)]

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(5,) signed errors, the last one wrapped to ±π |pitch|."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        x, y, d = b.turn_E(self._seat).T
        spoke = b.R_A @ (self.assembled.rotation.T @ self._seat[:, 0])  # along x when assembled
        angle = np.arctan2(y @ spoke, x @ spoke)
        on_axis = b.point_E(self.assembled.act(self.point))
        ahead = d @ (b.point_A(self.point) - on_axis) / self.pitch - angle
        thread = -self.pitch * np.remainder(ahead + np.pi, 2 * np.pi) + self.pitch * np.pi
        return np.append(super().gaps(X_WO, X_WE), thread)


@dataclass(frozen=True, eq=False)
class Fixed(TangentPair):
    """The object clamped to the environment (r = 6): three distances of its origin, three angles.

    Attributes:
        assembled: the pose of the object in the environment frame.
        name: used in messages and recordings.
    """

    assembled: pin.SE3 = field(default_factory=pin.SE3.Identity)
    name: str = "fixed"

    def __post_init__(self) -> None:
        pose = self.assembled
        self._hold(_ORIGIN, np.eye(3), pose.translation, *held_axes(pose.rotation))

    def _freedoms(self, b: Bodies) -> list[Freedom]:
        return []


@dataclass(frozen=True, eq=False)
class Free(TangentPair):
    """No contact (r = 0)."""

    name: str = "free"

    def __post_init__(self) -> None:
        self._hold(_ORIGIN, _NONE, _ORIGIN, _NONE, _NONE)

    def _freedoms(self, b: Bodies) -> list[Freedom]:
        return [(t, t, b.V_E) for t in np.eye(6)]


def _read_joint(pair: Revolute | Prismatic | Screw) -> None:
    read_geometry(pair, "point", axis="axis of the joint")
    store(pair, assembled=pin.SE3(pair.assembled))
