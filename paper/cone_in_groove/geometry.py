"""A cone in a V groove: shapes, contact, and the forces with which it presses on the walls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ConeInGroove
from osc_contact.spatial import Array, cross

__all__ = ["Cone", "Groove", "Seat", "seated_cone"]

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Groove:
    """Two walls that meet in a horizontal line, opening upwards.

    Attributes:
        point: (3,) of the line, world (m). yaw: of the line, about the vertical (rad).
        half_angle: between each wall and the vertical plane through the line (rad).
    """

    point: Array
    yaw: float
    half_angle: float

    @property
    def direction(self) -> Array:
        """(3,) unit, along the line."""
        return np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])

    def normals(self) -> tuple[Array, Array]:
        """Unit normals (3,) of the walls, out of the material."""
        side = cross(_UP, self.direction)
        s, c = np.sin(self.half_angle), np.cos(self.half_angle)
        return s * _UP + c * side, s * _UP - c * side


@dataclass(frozen=True)
class Cone:
    """A cone in the object's frame; its inertia stands in `cone.urdf`.

    Attributes:
        apex, axis: (3,) m, and unit from apex to base.
        height: m.
    """

    apex: Array
    axis: Array
    height: float


@dataclass(frozen=True, eq=False)
class Seat:
    """A cone lying in a groove, its apex on the groove's line.

    A cone whose axis is inclined by φ to the line touches both walls, of half angle β, along a
    generator each if its own half angle θ has sin θ = sin φ sin β.

    Attributes:
        groove, cone: the shapes. inclination: φ (rad).
        R_start: (3, 3) orientation of the object at the start.
    """

    groove: Groove
    cone: Cone
    inclination: float
    R_start: Array

    @property
    def half_angle(self) -> float:
        """θ of the cone (rad)."""
        return float(np.arcsin(np.sin(self.inclination) * np.sin(self.groove.half_angle)))

    @property
    def axis(self) -> Array:
        """(3,) direction of the cone's axis in the world."""
        return np.cos(self.inclination) * self.groove.direction + np.sin(self.inclination) * _UP

    @property
    def X_start(self) -> pin.SE3:
        """Pose of the object with the apex in the middle of the groove."""
        return pin.SE3(self.R_start, self.groove.point - self.R_start @ self.cone.apex)

    @cached_property
    def pair(self) -> ConeInGroove:
        """The contact, r = 4."""
        cone, groove = self.cone, self.groove
        return ConeInGroove(
            cone.apex, cone.axis, groove.point, groove.direction, self.axis, name="cone"
        )

    def contact(self) -> Contact:
        """N, T and n_γ at the start."""
        return self.pair.contact(self.X_start, np.zeros(6))

    def generators(self) -> tuple[Array, Array]:
        """Unit directions (3,) from the apex along which the cone touches the two walls."""
        sin, cos = np.sin(self.half_angle), np.cos(self.half_angle)
        first, second = ((self.axis - sin * n) / cos for n in self.groove.normals())
        return first, second

    def wall_forces(self, X_WO: pin.SE3) -> tuple[Array, Array]:
        """Where (3, 4) and along which directions (3, 4) the cone presses on the walls.

        The lines of contact end where the cone has 35 % and 100 % of its height. Pushes on the two
        ends of both lines are another basis of N, in which a real groove can only push (≥ 0).
        """
        length = self.cone.height / np.cos(self.half_angle)
        apex = X_WO.act(self.cone.apex)
        points, directions = [], []
        for along, normal in zip(self.generators(), self.groove.normals(), strict=True):
            points += [apex + 0.35 * length * along, apex + length * along]
            directions += [-normal, -normal]
        return np.column_stack(points), np.column_stack(directions)

    @cached_property
    def from_wall_forces(self) -> Array:
        """R (4, 4): the pair's magnitudes from those at the ends of the lines of contact.

        N R is the same space of forces seen through another basis. The groove carries both, so R
        is constant.
        """
        points, directions = self.wall_forces(self.X_start)
        arms = points - self.X_start.translation[:, None]
        R, *_ = np.linalg.lstsq(
            self.contact().N, np.vstack((directions, cross(arms, directions))), rcond=None
        )
        return np.asarray(R)

    def motion(self, X_WO: pin.SE3) -> Array:
        """(2,) how far the cone has turned about its axis (rad) and slid along the groove (m)."""
        turned = pin.log3(X_WO.rotation @ self.R_start.T) @ self.axis
        slid = (X_WO.act(self.cone.apex) - self.groove.point) @ self.groove.direction
        return np.array([turned, slid])


def seated_cone() -> Seat:
    """The cone gripped off its axis and obliquely, so that turning it moves the whole arm."""
    yaw, inclination, grip = np.deg2rad([155.0, 32.0, 38.0])
    groove = Groove(np.array([0.50, 0.05, 0.15]), float(yaw), float(np.deg2rad(60.0)))
    axis = np.array([np.sin(grip), 0.0, -np.cos(grip)])
    back = inclination + grip  # of the hand above the groove's line
    x = np.sin(back) * groove.direction - np.cos(back) * _UP
    z = -np.cos(back) * groove.direction - np.sin(back) * _UP
    R = np.column_stack((x, cross(z, x), z))
    return Seat(groove, Cone(np.array([0.02, 0.015, 0.12]), axis, 0.10), float(inclination), R)
