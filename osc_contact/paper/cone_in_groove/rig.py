"""A Panda that holds a cone in a V groove: geometry, arm, contact and the forces of the walls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ConeInGroove
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import close, reach
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.dynamics.payload import RigidObject
from osc_contact.spatial import Array, cross

__all__ = ["Cone", "ConeRig", "Groove", "build_cone_rig"]

_POSTURE = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78])


@dataclass(frozen=True)
class Groove:
    """Two walls that meet in a line, opening upwards.

    Attributes:
        point: (3,) of the line, world (m). direction: (3,) unit, along it, horizontal.
        half_angle: between each wall and the vertical plane through the line (rad).
    """

    point: Array
    direction: Array
    half_angle: float

    def normals(self) -> tuple[Array, Array]:
        """Unit normals (3,) of the walls, out of the material."""
        up = np.array([0.0, 0.0, 1.0])
        side = cross(up, self.direction)
        s, c = np.sin(self.half_angle), np.cos(self.half_angle)
        return s * up + c * side, s * up - c * side


@dataclass(frozen=True)
class Cone:
    """A solid cone lying in a groove, its apex on the groove's line.

    A cone whose axis is inclined by φ to the line touches both walls, of half angle β, along a
    generator each if its own half angle θ has sin θ = sin φ sin β.

    Attributes:
        apex, axis: (3,) in the object frame: m, and unit from apex to base.
        height: m. mass: kg. inclination: φ (rad).
    """

    apex: Array
    axis: Array
    height: float
    mass: float
    inclination: float

    def half_angle(self, groove: Groove) -> float:
        """θ (rad)."""
        return float(np.arcsin(np.sin(self.inclination) * np.sin(groove.half_angle)))

    def seat(self, groove: Groove) -> Array:
        """Direction (3,) of the axis in the world."""
        up = np.array([0.0, 0.0, 1.0])
        return np.cos(self.inclination) * groove.direction + np.sin(self.inclination) * up

    def generators(self, groove: Groove) -> tuple[Array, Array]:
        """Unit directions (3,) from the apex along which the cone touches the two walls."""
        seat, theta = self.seat(groove), self.half_angle(groove)
        first, second = (
            (seat - np.sin(theta) * normal) / np.cos(theta) for normal in groove.normals()
        )
        return first, second

    def inertia(self, groove: Groove) -> pin.Inertia:
        """Of the solid cone, in the object frame."""
        radius, m = self.height * np.tan(self.half_angle(groove)), self.mass
        about, across = 0.3 * m * radius**2, 3 / 80 * m * (4 * radius**2 + self.height**2)
        a = self.axis[:, None]
        centre = self.apex + 0.75 * self.height * self.axis
        return pin.Inertia(m, centre, about * a @ a.T + across * (np.eye(3) - a @ a.T))


@dataclass(frozen=True, eq=False)
class ConeRig:
    """Everything one run needs.

    Attributes:
        chain: the Panda and the cone. groove, cone: the geometry. pair: their contact (r = 4).
        q_start: (7,) joint positions with the cone seated.
    """

    chain: ClosedChain
    groove: Groove
    cone: Cone
    pair: ConeInGroove
    q_start: Array

    @cached_property
    def state(self) -> ChainState:
        """At rest at the start."""
        return self.chain.state(self.q_start, np.zeros(self.chain.nq))

    def contact(self) -> Contact:
        """N, T and n_γ there."""
        return self.pair.contact(self.state.X_WO, np.zeros(6))

    def wall_forces(self, X_WO: pin.SE3) -> tuple[Array, Array]:
        """Where (3, 4) and along which directions (3, 4) the cone presses on the walls.

        The lines of contact end where the cone has 35 % and 100 % of its height. Pushes on the two
        ends of both lines are another basis of N, in which a real groove can only push (≥ 0).
        """
        length = self.cone.height / np.cos(self.cone.half_angle(self.groove))
        apex = X_WO.act(self.cone.apex)
        points, directions = [], []
        for along, normal in zip(
            self.cone.generators(self.groove), self.groove.normals(), strict=True
        ):
            points += [apex + 0.35 * length * along, apex + length * along]
            directions += [-normal, -normal]
        return np.column_stack(points), np.column_stack(directions)

    @cached_property
    def from_wall_forces(self) -> Array:
        """R (4, 4): the pair's magnitudes from those at the ends of the lines of contact.

        N R is the same space of forces seen through another basis. The groove carries both, so R
        is constant.
        """
        X = self.state.X_WO
        points, directions = self.wall_forces(X)
        lines = np.vstack((directions, cross(points - X.translation[:, None], directions)))
        R, *_ = np.linalg.lstsq(self.contact().N, lines, rcond=None)
        return np.asarray(R)


def build_cone_rig() -> ConeRig:
    """The cone gripped off its axis and obliquely, so that turning it moves the whole arm."""
    yaw, inclination, grip = np.deg2rad([155.0, 32.0, 38.0])
    groove = Groove(
        np.array([0.50, 0.05, 0.15]),
        np.array([np.cos(yaw), np.sin(yaw), 0.0]),
        np.deg2rad(60.0),
    )
    axis = np.array([np.sin(grip), 0.0, -np.cos(grip)])
    cone = Cone(np.array([0.02, 0.015, 0.12]), axis, 0.10, 0.6, inclination)
    arm = Arm.from_urdf(
        robots.find_robot("panda")[0], name="panda", tip="panda_hand_tcp", wrist_sensor="panda_hand"
    )
    chain = ClosedChain([arm], payload=RigidObject(cone.inertia(groove)))
    pair = ConeInGroove(
        cone.apex, cone.axis, groove.point, groove.direction, cone.seat(groove), name="cone"
    )
    back = inclination + grip  # of the hand above the groove's line
    e, up = groove.direction, np.array([0.0, 0.0, 1.0])
    x, z = np.sin(back) * e - np.cos(back) * up, -np.cos(back) * e - np.sin(back) * up
    R = np.column_stack((x, cross(z, x), z))
    start = pin.SE3(R, groove.point - R @ cone.apex)

    def gaps(X: pin.SE3) -> tuple[Array, Array]:
        return pair.gaps(X), pair.contact(X, np.zeros(6)).N

    return ConeRig(chain, groove, cone, pair, close(chain, reach(chain, _POSTURE, start), gaps))
