"""Motions of a stage: along, about, turn to, to, through, spiral, raster, rock, dwell.

A motion prescribes some components of the object's twist, the rows S of S V = s, for example one
component of the velocity of its origin. `permitted_twist` adds what the contacts require,
NᵀV = 0, and leaves the rest at zero. So a peg that turns upright about two rims slides along both.

Motions are added by &: `turn_to(axis, up, 0.1) & along(down, 5e-3, yields=6.0)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import cos, hypot, inf, pi, sin, sqrt
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import InvalidInputError
from osc_contact.plan.sensed import Sensed
from osc_contact.spatial import Array, as_array, unit_vector

LINEAR_ACCELERATION = 0.1  #: m/s², with which motions begin and end
ANGULAR_ACCELERATION = 5.0  #: rad/s²
CHANGES = 2.0  #: largest acceleration of a reference, as a multiple of these
BACK = -0.5  #: share of the speed with which a motion that yields goes back
ARRIVED = 1e-5  #: m, distance from its end at which a motion has arrived
ARRIVED_ANGLE = 1e-4  #: rad, the same of a turn
Axes = Literal["world", "object"]

_LINEAR = np.eye(6)[:3]  #: rows of a demand: the velocity of the origin
_ANGULAR = np.eye(6)[3:]


@dataclass
class Demand:
    """Components of the twist at O that a motion prescribes.

    Attributes:
        rows: (k, 6) components, world axes. values: (k,) their values (m/s, rad/s).
        finished: whether the motion has reached its end.
    """

    rows: Array
    values: Array
    finished: bool = False


#: Motion under way: its demand for the signals of a tick and the control period (s).
Course = Callable[[Sensed, float], Demand]


@dataclass(frozen=True)
class Motion:
    """Motion of a stage.

    Attributes:
        begin: begins the motion where the object is.
        words: the motion in words, for reports.
    """

    begin: Callable[[Sensed], Course]
    words: str

    def __and__(self, other: Motion) -> Motion:
        """Both motions at once, which end when both have ended."""

        def begin(now: Sensed) -> Course:
            courses = (self.begin(now), other.begin(now))

            def demand(now: Sensed, dt: float) -> Demand:
                one, two = (course(now, dt) for course in courses)
                return Demand(
                    np.vstack((one.rows, two.rows)),
                    np.concatenate((one.values, two.values)),
                    one.finished and two.finished,
                )

            return demand

        return Motion(begin, f"{self.words} and {other.words}")


def dwell() -> Motion:
    """No motion.

    Example:
        >>> print(motions.dwell().words)
        dwell
    """

    def demand(now: Sensed, dt: float) -> Demand:
        return Demand(np.zeros((0, 6)), np.zeros(0), finished=True)

    return Motion(lambda now: demand, "dwell")


def along(
    direction: ArrayLike,
    speed: float,
    distance: float = inf,
    *,
    axes: Axes = "world",
    yields: float | None = None,
) -> Motion:
    """Motion of the object's origin along a direction.

    Args:
        direction: (3,) in world axes, or in the object's.
        speed: m/s.
        distance: m, at which it ends; inf: never.
        axes: of the direction.
        yields: force against the motion (N) at which it stops; above, it goes back at up to half
            the speed. None: it does not depend on forces.

    Raises:
        InvalidInputError: no direction, or a number that is not positive.
    """
    given = unit_vector("along: direction", direction)
    most = _positive("along: speed", speed)
    way = _positive("along: distance", distance)
    limit = None if yields is None else _positive("along: yields", yields)

    begin = _steady(_TRANSLATION, given, axes, most, way, limit)
    return Motion(begin, f"along {_written(given)} at {1e3 * most:g} mm/s")


def about(
    axis: ArrayLike,
    rate: float,
    angle: float = inf,
    *,
    axes: Axes = "world",
    yields: float | None = None,
) -> Motion:
    """Turn of the object about an axis through its origin.

    Args:
        axis: (3,) in world axes, or in the object's.
        rate: rad/s.
        angle: rad, at which it ends; inf: never.
        axes: of the axis.
        yields: couple against the turn (N m) at which it stops; above, it turns back. None: it does
            not depend on forces.

    Raises:
        InvalidInputError: no axis, or a number that is not positive.
    """
    given = unit_vector("about: axis", axis)
    most = _positive("about: rate", rate)
    way = _positive("about: angle", angle)
    limit = None if yields is None else _positive("about: yields", yields)

    begin = _steady(_ROTATION, given, axes, most, way, limit)
    return Motion(begin, f"about {_written(given)} at {most:g} rad/s")


def turn_to(
    axis: ArrayLike, direction: ArrayLike | Callable[[Sensed], ArrayLike], rate: float
) -> Motion:
    """Turn that brings an axis of the object to a direction of the world, the shortest way.

    The turn about the axis itself is left to the contacts.

    Args:
        axis: (3,) in the object's axes.
        direction: (3,) in world axes, or a function of the signals when the stage begins.
        rate: rad/s.

    Raises:
        InvalidInputError: no axis or direction, or a rate that is not positive.
    """
    given = unit_vector("turn_to: axis", axis)
    most = _positive("turn_to: rate", rate)
    if not callable(direction):
        unit_vector("turn_to: direction", direction)

    def begin(now: Sensed) -> Course:
        given_now = direction(now) if callable(direction) else direction
        target = unit_vector("turn_to: direction", given_now)

        def demand(now: Sensed, dt: float) -> Demand:
            a = now.aim.rotation @ given
            left = _turn_between(a, target)
            angle = float(np.linalg.norm(left))
            w = _ending(most, angle, ANGULAR_ACCELERATION, dt)
            across = _null_space(a[None]).T  # two axes at right angles to a
            values = across @ left * (w / max(angle, 1e-12))
            return Demand(across @ _ANGULAR, values, angle < ARRIVED_ANGLE)

        return demand

    return Motion(begin, f"turn {_written(given)} at {most:g} rad/s")


def to(pose: pin.SE3 | Callable[[Sensed], pin.SE3], speed: float, rate: float = 0.5) -> Motion:
    """Straight way of the object's origin to a pose, and the shortest turn meanwhile.

    Args:
        pose: pose of the object, or a function of the signals when the stage begins.
        speed: m/s.
        rate: rad/s.

    Raises:
        InvalidInputError: a number that is not positive.
    """
    fastest = _positive("to: speed", speed)
    turning = _positive("to: rate", rate)

    def begin(now: Sensed) -> Course:
        goal = pose(now) if callable(pose) else pose

        def demand(now: Sensed, dt: float) -> Demand:
            way = goal.translation - now.aim.translation
            turn = pin.log3(goal.rotation @ now.aim.rotation.T)
            far, angle = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
            v = way * (_ending(fastest, far, LINEAR_ACCELERATION, dt) / max(far, 1e-12))
            w = turn * (_ending(turning, angle, ANGULAR_ACCELERATION, dt) / max(angle, 1e-12))
            there = far < ARRIVED and angle < ARRIVED_ANGLE
            return Demand(np.eye(6), np.concatenate((v, w)), there)

        return demand

    return Motion(begin, f"to a pose at {1e3 * fastest:g} mm/s")


def through(points: ArrayLike, speed: float, *, relative: bool = False) -> Motion:
    """Way of the object's origin through points, straight from one to the next.

    The part of the way along contact normals is left to the contacts.

    Args:
        points: (k, 3) in the world (m), or relative to where the stage begins.
        speed: m/s.
        relative: whether points are relative to the place at which the stage begins.

    Raises:
        InvalidInputError: points of another shape, or a speed that is not positive.
    """
    given = as_array("through: points", points, (None, 3))
    most = _positive("through: speed", speed)

    def begin(now: Sensed) -> Course:
        path = given + (now.aim.translation if relative else 0.0)
        k = 0

        def demand(now: Sensed, dt: float) -> Demand:
            nonlocal k
            while k < len(path):
                sliding = _null_space(now.N[:3].T)
                way = sliding @ sliding.T @ (path[k] - now.aim.translation)
                far = float(np.linalg.norm(way))
                if far >= most * dt + ARRIVED:
                    left = far if k + 1 == len(path) else inf
                    return Demand(
                        _LINEAR, way * (_ending(most, left, LINEAR_ACCELERATION, dt) / far)
                    )
                k += 1
            return Demand(_LINEAR, np.zeros(3), finished=True)

        return demand

    return Motion(begin, f"through {len(given)} points at {1e3 * most:g} mm/s")


def raster(
    along: ArrayLike, across: ArrayLike, length: float, width: float, pitch: float, speed: float
) -> Motion:
    """Lines beside one another, to and fro, from where the stage begins.

    Args:
        along: (3,) direction of the lines in the world.
        across: (3,) direction from line to line.
        length: length of the lines (m).
        width: width of the area that they fill (m).
        pitch: from line to line (m).
        speed: m/s.

    Raises:
        InvalidInputError: no directions, or a number that is not positive.
    """
    a = unit_vector("raster: along", along)
    b = unit_vector("raster: across", across)
    lines = 1 + round(_positive("raster: width", width) / _positive("raster: pitch", pitch))
    ends = (0.0, _positive("raster: length", length))
    points = []
    for k in range(lines):
        for far in ends if k % 2 == 0 else ends[::-1]:
            points.append(far * a + k * pitch * b)
    return through(points, speed, relative=True)


def spiral(axis: ArrayLike, pitch: float, speed: float, radius: float) -> Motion:
    """Spiral of Archimedes of the object's origin, from where the stage begins.

    Args:
        axis: (3,) at right angles to its plane, in the world.
        pitch: distance of neighbouring turns (m).
        speed: m/s.
        radius: at which it ends (m).

    Raises:
        InvalidInputError: no axis, or a number that is not positive.
    """
    normal = unit_vector("spiral: axis", axis)
    per_angle = _positive("spiral: pitch", pitch) / (2.0 * pi)
    most = _positive("spiral: speed", speed)
    end = _positive("spiral: radius", radius)
    rows = _null_space(normal[None]).T @ _LINEAR

    def begin(now: Sensed) -> Course:
        angle = 0.0

        def demand(now: Sensed, dt: float) -> Demand:
            nonlocal angle
            r = per_angle * angle
            if r >= end:
                return Demand(rows, np.zeros(2), finished=True)
            reach = hypot(r, per_angle)
            turning = min(most / reach, sqrt(LINEAR_ACCELERATION / reach))
            angle += turning * dt
            c, s = cos(angle), sin(angle)
            outward = turning * per_angle
            values = (outward * c - turning * r * s, outward * s + turning * r * c)
            return Demand(rows, np.array(values))

        return demand

    return Motion(begin, f"spiral of {1e3 * end:g} mm at {1e3 * most:g} mm/s")


def rock(
    axis: ArrayLike, angle: float, frequency: float, cycles: float = inf, *, axes: Axes = "world"
) -> Motion:
    """Sinusoidal turn of the object to and fro about an axis through its origin.

    Its amplitude grows during the first cycle.

    Args:
        axis: (3,) in world axes, or in the object's.
        angle: amplitude (rad).
        frequency: Hz.
        cycles: after which it ends; inf: never.
        axes: of the axis.

    Raises:
        InvalidInputError: no axis, a number that is not positive, or too large an acceleration.
    """
    given = unit_vector("rock: axis", axis)
    amplitude = _positive("rock: angle", angle)
    per_second = _positive("rock: frequency", frequency)
    most = _positive("rock: cycles", cycles)
    needed = amplitude * (2.0 * pi * per_second) ** 2
    if needed > CHANGES * ANGULAR_ACCELERATION:
        raise InvalidInputError(
            f"rock: {amplitude:g} rad at {per_second:g} Hz need {needed:.3g} rad/s², more than "
            f"{CHANGES * ANGULAR_ACCELERATION:g} rad/s²; lower angle or frequency"
        )

    def begin(now: Sensed) -> Course:
        cycle = 0.0
        before = 0.0

        def demand(now: Sensed, dt: float) -> Demand:
            nonlocal cycle, before
            a = now.aim.rotation @ given if axes == "object" else given
            cycle = min(cycle + per_second * dt, most)
            turned = amplitude * min(cycle, 1.0) * sin(2.0 * pi * cycle)
            w = (turned - before) / dt
            before = turned
            return Demand((a @ _ANGULAR)[None], np.array([w]), cycle >= most)

        return demand

    return Motion(begin, f"rock about {_written(given)} by {amplitude:g} rad")


def permitted_twist(N: Array, demand: Demand) -> tuple[Array, Array]:
    """Twist V (6,) with NᵀV = 0 that meets a demand S V = s, and its misfit S V − s (k,).

    What contacts and demand leave open is zero: first the angular velocity as far as possible, then
    the linear one, so that metres and radians are not added.

    Args:
        N: (6, r) directions of force of the active contacts.
        demand: S and s.
    """
    open_ones = ((_ANGULAR, np.zeros(3)), (_LINEAR, np.zeros(3)))
    V = _permitted(N, ((demand.rows, demand.values), *open_ones))
    return V, demand.rows @ V - demand.values


def permitted_displacement(N: Array, e: Array) -> Array:
    """Displacement (6,) with Nᵀd = 0 next to e: its angles as far as possible, then its position.

    A small body is turned easily: the projection Ω_m in its own metric would make a rotation of
    most of what contacts do not permit.

    Args:
        N: (6, r) directions of force of the active contacts.
        e: (6,) displacement at O (m, rad).
    """
    return _permitted(N, ((_ANGULAR, e[3:]), (_LINEAR, e[:3])))


def _permitted(N: Array, wanted: Iterable[tuple[Array, Array]]) -> Array:
    """Vector V (6,) with NᵀV = 0 that meets A V = b, by least squares, each within those before.

    Args:
        N: (6, r).
        wanted: A (k, 6) and b (k,), the most important one first.
    """
    V = np.zeros(6)
    Z = _null_space(N.T)
    for rows, values in wanted:
        if len(rows) > 0 and Z.shape[1] > 0:
            left, sizes, right = np.linalg.svd(rows @ Z)
            least = _LEAST_TURN if rows is _ANGULAR else _LEAST_SHARE
            k = int(np.sum(sizes > least))
            y = left[:, :k].T @ (values - rows @ V) / sizes[:k]
            V = V + Z @ (right[:k].T @ y)
            Z = Z @ right[k:].T
    return V


_INDEPENDENT = 1e-6  #: least singular value of independent rows of about unit length
#: Least singular value with which permitted motions meet a demand: one of which contacts permit
#: a smaller share is blocked. Normals of one face that are estimated apart differ a little.
_LEAST_SHARE = 0.02
_LEAST_TURN = 0.5  #: rad/m, the same of turns: about an axis more than 2 m away a turn is a shift


def _null_space(A: Array) -> Array:
    """Orthonormal basis (n, n − rank) of the null space of A (m, n), rows of about unit length."""
    if A.size == 0:
        return np.eye(A.shape[1])
    _, sizes, rows = np.linalg.svd(A)
    return rows[int(np.sum(sizes > _INDEPENDENT)) :].T


def _turn_between(a: Array, b: Array) -> Array:
    """Rotation vector (3,) of the shortest turn from unit vector a to unit vector b."""
    axis = np.cross(a, b)
    size = float(np.linalg.norm(axis))
    angle = float(np.arctan2(size, a @ b))
    if size < 1e-12:
        return _null_space(a[None])[:, 0] * angle
    return axis * (angle / size)


class _Kind(NamedTuple):
    """Translation or rotation.

    Attributes:
        rows: (3, 6) of which the product with a twist is its velocity of this kind.
        deceleration: with which it ends (m/s², rad/s²).
        arrived: distance from the end at which it has ended (m, rad).
    """

    rows: Array
    deceleration: float
    arrived: float


_TRANSLATION = _Kind(_LINEAR, LINEAR_ACCELERATION, ARRIVED)
_ROTATION = _Kind(_ANGULAR, ANGULAR_ACCELERATION, ARRIVED_ANGLE)


def _steady(
    kind: _Kind, direction: Array, axes: Axes, speed: float, way: float, limit: float | None
) -> Callable[[Sensed], Course]:
    """Beginning of a motion along, or about, one direction.

    Args:
        kind: translation or rotation.
        direction: (3,) unit vector in world axes, or in the object's, as `axes` states.
        axes: axes of the direction.
        speed: largest speed (m/s, rad/s). way: distance at which it ends (m, rad).
        limit: force or couple against the motion at which it stops (N, N m); None: it never does.
    """

    def begin(now: Sensed) -> Course:
        gone = 0.0

        def demand(now: Sensed, dt: float) -> Demand:
            nonlocal gone
            row = (now.aim.rotation @ direction if axes == "object" else direction) @ kind.rows
            gone += dt * float(row @ now.V_D)
            rate = _ending(speed, way - gone, kind.deceleration, dt)
            rate *= _yielding(limit, float(row @ now.wrench))
            return Demand(row[None], np.array([rate]), way - gone < kind.arrived)

        return demand

    return begin


def _ending(speed: float, left: float, deceleration: float, dt: float) -> float:
    """Speed with which what is `left` of a way ends at rest."""
    if left <= 0.0:
        return 0.0
    return min(speed, sqrt(2.0 * deceleration * left), left / dt)


def _yielding(limit: float | None, force: float) -> float:
    """Share of the speed, between `BACK` and 1, for a force against the motion."""
    return 1.0 if limit is None else min(max(1.0 - force / limit, BACK), 1.0)


def _positive(name: str, value: float) -> float:
    """Return a number > 0 as a float.

    Raises:
        InvalidInputError: it is none.
    """
    number = float(value)
    if not number > 0.0:
        raise InvalidInputError(f"{name} = {value!r}; give a number > 0 in SI units")
    return number


def _written(direction: Array) -> str:
    """Direction (3,) for reports."""
    return "[" + ", ".join(f"{x:.2g}" for x in direction) + "]"
