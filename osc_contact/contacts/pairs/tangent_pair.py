"""Pairs defined by the permitted motions T, with explicit N, NᵀT = 0, and n_γ = NᵀṪβ.

A is the object, E the touched body, each with its frame. Each pair states its geometry in `_make`,
which is called at the end of its construction, by `_hold_tangents`: a point of A that is held in
some directions of E (forces), directions of A that are held at right angles to directions of E
(couples), and the motions that remain free. `shape` makes of each column or motion a row of numbers
for the law, whose kind is FORCE, COUPLE or THREAD (columns), TURN, SLIDE or SCREW (motions).
`triad(d)` (3, 3) has three perpendicular unit vectors as columns, the last one along d;
`held_axis(axis, seat)` are the directions that keep an axis of A parallel to a direction of E, its
seat.
"""

from __future__ import annotations

from dataclasses import field
from typing import Protocol

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.pairs.keys import Direction, Point, store
from osc_contact.contacts.pairs.law_pair import shape
from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.contacts.pairs.register import register_pair
from osc_contact.errors import InvalidInputError
from osc_contact.law.records import COUPLE, FORCE, SCREW, SLIDE, TANGENTS, THREAD, TURN
from osc_contact.spatial import Array

_NO_VECTORS = np.zeros((3, 0))


class TangentPair(PointsOnPlanes):
    """Pair with known T = [t₁ …]: n_γ = NᵀṪβ, V_rel = Tβ, ṫⱼ = V_b(j) × tⱼ (paper, section 3).

    b(j) is the body to which the axis of tⱼ is fixed. N has explicit columns, smooth in the pose,
    that annihilate T and are the gradients of the gaps:

    * points pⱼ of A on planes of E with directions nⱼ: column [n; p × n], gap −n·(p − q);
    * directions aⱼ of A at right angles to directions uⱼ of E: column [0; a × u], gap −a·u.

    Unlike the magnitude of a face, their magnitudes have either sign.
    """

    _arms: Array
    _marks: Array

    def _hold_tangents(
        self,
        point: Array,
        directions: Array,
        on_plane: Array,
        right_angles: tuple[Array, Array] = (_NO_VECTORS, _NO_VECTORS),
        freedoms: tuple[Array, ...] = (),
        threads: tuple[Array, ...] = (),
    ) -> None:
        """Set the columns of N and the permitted motions.

        Args:
            point: (3,) point of A (m) on the planes.
            directions: (3, k) unit directions of E into the planes.
            on_plane: (3,) point of E in all planes (m).
            right_angles: directions a (3, m) of A and u (3, m) of E that are perpendicular.
            freedoms: shapes of TURN about an axis of A through a point of A; of SLIDE along an
                axis of E, with the rate at a point of A; of SCREW, a turn and pitch (m/rad) times
                its rate along an axis of E.
            threads: shapes of columns that couple the advance of a SCREW to its turn.
        """
        points = np.tile(point[:, None], directions.shape[1])
        arms, marks = right_angles
        store(
            self,
            _points=points,
            _into=directions,
            _reach=on_plane @ directions,
            _arms=arms,
            _marks=marks,
        )
        forces = (shape(point, n, FORCE) for n in directions.T)
        couples = (shape(a, u, COUPLE) for a, u in zip(arms.T, marks.T, strict=True))
        shapes = (*forces, *couples, *threads, *freedoms)
        self._store_geometry(on_plane, TANGENTS, shapes, len(freedoms))

    def _gaps(self, X_EA: SE3) -> Array:
        """Signed errors (r,): of the points (m), of the directions (rad, to first order).

        A direction of the object (`_arms`, (3, k) in its frame) must stay at right angles to one of
        the body (`_marks`, (3, k)); their product is the error.

        Args:
            X_EA: pose of the object in the frame of the environment's body.
        """
        angles = -((X_EA.rotation @ self._arms) * self._marks).sum(axis=0)
        return np.concatenate((super()._gaps(X_EA), angles))


def held_axis(axis: Array, seat: Array) -> tuple[Array, Array]:
    """Directions a (3, 2) of A and u (3, 2) of E that keep an axis of A along a direction of E.

    The couples are along the first two columns of triad(seat).

    Args:
        axis: (3,) unit vector of A.
        seat: (3,) unit vector of E.
    """
    x, y, _ = triad(seat).T
    return (np.column_stack((axis, axis)), np.column_stack((-y, x)))


def held_axes(R_EA: Array) -> tuple[Array, Array]:
    """Directions a (3, 3) of A and u (3, 3) of E that keep A's orientation in E at R_EA (3, 3).

    The couples are along E's axes.
    """
    return (R_EA.T[:, [1, 2, 0]], np.eye(3)[:, [2, 0, 1]])


class AssembledJoint(Protocol):
    """Pair with an axis that is known in an assembled pose.

    Attributes:
        point: (3,) point of the axis in the object frame (m).
        axis: (3,) unit vector in the object frame.
        assembled: pose of the object in the environment frame in which the joint is closed.
    """

    @property
    def point(self) -> Array: ...
    @property
    def axis(self) -> Array: ...
    @property
    def assembled(self) -> SE3: ...


def assembled_axis(joint: AssembledJoint) -> tuple[Array, Array]:
    """Axis (3,) of a joint in E, and a point (3,) of it, in the assembled pose.

    The pose is replaced by a copy, as users may change the one that they gave.
    """
    X = SE3(joint.assembled)
    store(joint, assembled=X)
    return (X.rotation @ joint.axis, X.act(joint.point))


# The object clamped to the environment, and no contact at all.


_ORIGIN = np.zeros(3)


@register_pair()
class Fixed(TangentPair):
    """The object clamped to the environment (r = 6): three distances of its origin, three angles.

    Attributes:
        assembled: the pose of the object in the environment frame.
        name: name in messages and recordings.

    Example:
        >>> clamp = osc.Fixed(assembled=pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.2])))
        >>> clamp.contact(pin.SE3.Identity(), np.zeros(6)).r
        6
    """

    assembled: SE3 = field(default_factory=SE3.Identity)
    name: str = "fixed"

    def _make(self) -> None:
        """Hold the origin in three directions, and the orientation, at the assembled pose."""
        pose = self.assembled
        self._hold_tangents(_ORIGIN, np.eye(3), pose.translation, held_axes(pose.rotation))


@register_pair()
class Free(TangentPair):
    """No contact (r = 0).

    Example:
        >>> osc.Free().contact(pin.SE3.Identity(), np.zeros(6)).r
        0
    """

    name: str = "free"

    def _make(self) -> None:
        """Hold nothing: no forces, no gaps."""
        self._hold_tangents(_ORIGIN, np.zeros((3, 0)), _ORIGIN)


# A slide between object and environment.


@register_pair()
class Prismatic(TangentPair):
    """A slide: the object moves along an axis of the environment and does not turn (r = 5).

    Gaps: two distances of the point from the line, three angles.

    Attributes:
        point: (3,) a point of the line in the object frame (m).
        axis: (3,) direction of the line in the object frame; normalised on entry.
        assembled: a pose of the object in the environment frame at which the slide is closed.
        name: name in messages and recordings.

    Example:
        >>> slide = osc.Prismatic([0, 0, 0], axis=[1, 0, 0])
        >>> print(slide.contact(pin.SE3.Identity(), np.zeros(6)).T.T)
        [[1. 0. 0. 0. 0. 0.]]
    """

    point: Point
    axis: Direction
    assembled: SE3 = field(default_factory=SE3.Identity)
    name: str = "prismatic"

    def _make(self) -> None:
        """Hold the point in two directions across the line, and the orientation."""
        seat, on_line = assembled_axis(self)
        turns = held_axes(self.assembled.rotation)
        freedom = shape(self.point, seat, SLIDE)
        self._hold_tangents(self.point, triad(seat)[:, :2], on_line, turns, (freedom,))


# A hinge between object and environment.


@register_pair()
class Revolute(TangentPair):
    """A hinge: the object turns about an axis of the environment (r = 5).

    Gaps: three distances of the point, two angles of the axis.

    Attributes:
        point: (3,) a point of the axis in the object frame (m).
        axis: (3,) direction of the axis in the object frame; normalised on entry.
        assembled: a pose of the object in the environment frame at which the hinge is closed.
        name: name in messages and recordings.

    Example:
        >>> hinge = osc.Revolute([0, 0, 0], axis=[0, 0, 1])
        >>> print(hinge.contact(pin.SE3.Identity(), np.zeros(6)).T.T)
        [[0. 0. 0. 0. 0. 1.]]
    """

    point: Point
    axis: Direction
    assembled: SE3 = field(default_factory=SE3.Identity)
    name: str = "revolute"

    def _make(self) -> None:
        """Hold the point in three directions, and the direction of the axis."""
        seat, on_axis = assembled_axis(self)
        freedom = shape(self.point, self.axis, TURN)
        tilts = held_axis(self.axis, seat)
        self._hold_tangents(self.point, triad(seat), on_axis, tilts, (freedom,))


# A screw between object and environment.


@register_pair()
class Screw(TangentPair):
    """A screw: the object turns about an axis of the environment and advances with it (r = 5).

    Gaps: two distances of the point from the axis, two angles of the axis, and the difference of
    the advance from pitch times angle, modulo whole turns (m). Their gradient is −N in the
    assembled pose; N annihilates T in any pose.

    Attributes:
        point: (3,) a point of the axis in the object frame (m).
        axis: (3,) direction of the axis in the object frame; normalised on entry.
        pitch: advance along the axis (m/rad, not per turn); negative: left-handed.
        assembled: a pose of the object in the environment frame at which the screw is closed.
        name: name in messages and recordings.

    Example:
        >>> bolt = osc.Screw([0, 0, 0], axis=[0, 0, 1], pitch=1e-3 / (2 * np.pi))  # 1 mm a turn
        >>> bolt.contact(pin.SE3.Identity(), np.zeros(6)).r
        5
    """

    point: Point
    axis: Direction
    pitch: float
    assembled: SE3 = field(default_factory=SE3.Identity)
    name: str = "screw"
    _seat: Array = field(init=False, repr=False)

    def _make(self) -> None:
        """Compute the rows of the law: forces across the axis, parallel axes, advance by the pitch.

        The pair keeps the point of the object on the axis of the thread (two forces across it), the
        axes parallel (couples), and the advance along the axis at `pitch` times the angle (m/rad;
        the force of the thread's flank). Permitted is the turn with this advance.

        Raises:
            InvalidInputError: the pitch is zero or not finite.
        """
        if not np.isfinite(self.pitch) or self.pitch == 0.0:
            raise InvalidInputError(
                f"{self.name}.pitch = {self.pitch}; give m/rad other than 0 (else: Revolute)"
            )
        seat, on_axis = assembled_axis(self)
        axes = triad(seat)
        store(self, _seat=axes)
        freedom = shape(self.point, self.axis, SCREW, seat, self.pitch)
        thread = shape(self.point, seat, THREAD, self.axis, self.pitch)
        tilts = held_axis(self.axis, seat)
        self._hold_tangents(self.point, axes[:, :2], on_axis, tilts, (freedom,), (thread,))

    def _gaps(self, X_EA: SE3) -> Array:
        """Signed errors (5,) (m, rad), the last one within ±π |pitch|.

        The last one is the travel along the axis less that of the thread at the angle of the
        object. `_seat` (3, 3) has two axes across the screw's axis and this axis, as columns. The
        angle is known up to whole turns, so the error is too.

        Args:
            X_EA: pose of the object in the frame of the environment's body.
        """
        x, y, d = self._seat.T
        spoke = X_EA.rotation @ self.assembled.rotation.T @ x  # along x when assembled
        angle = np.arctan2(y @ spoke, x @ spoke)
        distance_vector = X_EA.act(self.point) - self.assembled.act(self.point)
        ahead = d @ distance_vector / self.pitch - angle
        wrapped = -self.pitch * np.remainder(ahead + np.pi, 2 * np.pi) + self.pitch * np.pi
        return np.append(super()._gaps(X_EA), wrapped)


# The cone in its groove (fig. 2 of the paper): a pair given by T that no constraint frame fits.


@register_pair()
class ConeInGroove(TangentPair):
    """Fig. 2 of the paper: a cone turns about its axis and slides along a groove (r = 4).

    T = [rotation about the cone's axis, carried by the object | translation along the groove,
    carried by the environment]. The gaps: two distances of the apex from the groove's line, two
    angles of the axis from its seat. No constraint frame describes it unless seat and groove are
    parallel or perpendicular.

    Attributes:
        apex: (3,) apex of the cone in the object frame (m).
        axis: (3,) axis of the cone in the object frame; normalised on entry.
        groove_point: (3,) a point of the line on which the apex slides, environment frame (m).
        groove_direction: (3,) direction of that line, environment frame; normalised on entry.
        seat: (3,) direction of the cone's axis in the environment frame; normalised on entry.
        name: name in messages and recordings.

    Example:
        >>> point, along, up = [0, 0, 0], [1, 0, 0], [0, 0, 1]
        >>> cone = osc.ConeInGroove(point, up, point, groove_direction=along, seat=up)
        >>> cone.contact(pin.SE3.Identity(), np.zeros(6)).r
        4
    """

    apex: Point
    axis: Direction
    groove_point: Point
    groove_direction: Direction
    seat: Direction
    name: str = "cone_in_groove"

    def _make(self) -> None:
        """Hold the apex in two directions across the groove, and the axis in its seat."""
        axes = triad(self.groove_direction)[:, :2]
        turn = shape(self.apex, self.axis, TURN)
        freedoms = (turn, shape(self.apex, self.groove_direction, SLIDE))
        tilts = held_axis(self.axis, self.seat)
        self._hold_tangents(self.apex, axes, self.groove_point, tilts, freedoms)
