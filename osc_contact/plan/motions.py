"""Motions of a stage: along, about, turn to, to, through, spiral, raster, rock, dwell.

A motion prescribes some components of the object's twist, the rows S of S V = s, for example one
component of the velocity of its origin. `permitted_twist` adds what the contacts require,
NᵀV = 0, and leaves the rest at zero. So a peg that turns upright about two rims slides along both.

Motions are added by &: `turn_to(axis, up, 0.1) & along(down, 5e-3, yields=6.0)`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, hypot, inf, pi, sin, sqrt
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import InvalidInputError
from osc_contact.plan.arguments import Direction, Points
from osc_contact.plan.permitted import ANGULAR, LINEAR, Demand, null_space
from osc_contact.plan.sensed import Sensed
from osc_contact.settings.quantities import (
    Angle,
    AngularVelocity,
    Force,
    Frequency,
    Length,
    Number,
    Torque,
    Velocity,
)
from osc_contact.spatial import Array, as_array, unit_vector

LINEAR_ACCELERATION = 0.1  #: m/s², with which motions begin and end
ANGULAR_ACCELERATION = 5.0  #: rad/s²
CHANGES = 2.0  #: largest acceleration of a reference, as a multiple of these
BACK = -0.5  #: share of the speed with which a motion that yields goes back
ARRIVED = 1e-5  #: m, distance from its end at which a motion has arrived
ARRIVED_ANGLE = 1e-4  #: rad, the same of a turn
Axes = Literal["world", "object"]


#: Motion under way: its demand for the signals of a tick and the control period (s).
Course = Callable[[Sensed, float], Demand]


@dataclass(frozen=True)
class Motion:
    """Motion of a stage.

    Attributes:
        begin: function that begins the motion when the stage begins, where the object is; returns
            a function of each tick's signals and the control period (s), which returns the demand.
        words: the motion in words, for reports.
    """

    begin: Callable[[Sensed], Course]
    words: str

    def __and__(self, other: Motion) -> Motion:
        """Combine two motions, which are made at once; the motion ends when both have ended.

        The prescribed components of the twist are those of both: rows S of S V = s below one
        another.

        Args:
            other: motion that is added to this one.
        """

        def begin(signals: Sensed) -> Course:
            """Begin this motion (`self`) and the other one.

            Args:
                signals: signals when the stage begins.
            """
            own_course = self.begin(signals)
            other_course = other.begin(signals)

            def demand(signals: Sensed, dt: float) -> Demand:
                """Stack the demands of both motions in a tick.

                Args:
                    signals: signals after the last tick.
                    dt: control period (s).
                """
                first_demand = own_course(signals, dt)
                second_demand = other_course(signals, dt)
                return Demand(
                    np.vstack((first_demand.rows, second_demand.rows)),
                    np.concatenate((first_demand.values, second_demand.values)),
                    first_demand.finished and second_demand.finished,
                )

            return demand

        return Motion(begin, f"{self.words} and {other.words}")


def dwell() -> Motion:
    """Rest: a motion that demands nothing, and is finished at once.

    Example:
        >>> print(motions.dwell().words)
        dwell
    """

    def demand(signals: Sensed, dt: float) -> Demand:
        """Demand no component of the twist."""
        return Demand(np.zeros((0, 6)), np.zeros(0), finished=True)

    return Motion(lambda signals: demand, "dwell")


def along(
    direction: Direction,
    speed: Velocity,
    distance: Length = inf,
    *,
    axes: Axes = "world",
    yields: Force | None = None,
) -> Motion:
    """Motion of the object's origin along a direction.

    Args:
        direction: (3,) direction in world axes or in the object's, as `axes` states.
        speed: largest speed (m/s).
        distance: distance at which the motion ends (m); inf: it does not end.
        axes: axes of the direction.
        yields: force against the motion (N) at which it stops; above this force it goes back at up
            to half the speed. None: the motion does not depend on forces.

    Raises:
        InvalidInputError: the direction is zero, or a number is not positive.
    """
    unit = unit_vector("along: direction", direction)
    largest_speed = _require_positive("along: speed", speed)
    length = _require_positive("along: distance", distance)
    limit = None if yields is None else _require_positive("along: yields", yields)

    begin = _begin_steady_motion(_TRANSLATION, unit, axes, largest_speed, length, limit)
    return Motion(begin, f"along {_direction_text(unit)} at {1e3 * largest_speed:g} mm/s")


def about(
    axis: Direction,
    rate: AngularVelocity,
    angle: Angle = inf,
    *,
    axes: Axes = "world",
    yields: Torque | None = None,
) -> Motion:
    """Rotation of the object about an axis through its origin.

    Args:
        axis: (3,) axis in world axes or in the object's, as `axes` states.
        rate: largest angular speed (rad/s).
        angle: angle at which the motion ends (rad); inf: it does not end.
        axes: axes in which `axis` is given.
        yields: couple against the rotation (N m) at which it stops; above this couple it turns
            back at up to half the speed. None: the motion does not depend on forces.

    Raises:
        InvalidInputError: the axis is zero, or a number is not positive.
    """
    unit = unit_vector("about: axis", axis)
    largest_rate = _require_positive("about: rate", rate)
    largest_angle = _require_positive("about: angle", angle)
    limit = None if yields is None else _require_positive("about: yields", yields)

    begin = _begin_steady_motion(_ROTATION, unit, axes, largest_rate, largest_angle, limit)
    return Motion(begin, f"about {_direction_text(unit)} at {largest_rate:g} rad/s")


def turn_to(
    axis: Direction,
    direction: Direction | Callable[[Sensed], ArrayLike],
    rate: AngularVelocity,
) -> Motion:
    """Rotation that brings an axis of the object to a direction of the world, the shortest way.

    The rotation about the axis itself is left to the contacts.

    Args:
        axis: (3,) axis in the object's axes.
        direction: (3,) direction in world axes, or a function of the signals when the stage begins.
        rate: largest angular speed (rad/s).

    Raises:
        InvalidInputError: axis or direction is zero, or the rate is not positive.
    """
    object_axis = unit_vector("turn_to: axis", axis)
    largest_rate = _require_positive("turn_to: rate", rate)
    if not callable(direction):
        unit_vector("turn_to: direction", direction)

    def begin(signals: Sensed) -> Course:
        """Begin the rotation to `target`, the direction in world axes at present.

        Args:
            signals: signals when the stage begins.
        """
        goal = direction(signals) if callable(direction) else direction
        target = unit_vector("turn_to: direction", goal)

        def demand(signals: Sensed, dt: float) -> Demand:
            """Demand the angular velocity across the axis that turns it to `target`.

            `object_axis` (3,) is in the object's axes, `target` (3,) in world axes. The speed w is
            at most `largest_rate` (rad/s), and lower towards the end; the rotation about the axis
            is not prescribed.

            Args:
                signals: signals after the last tick.
                dt: control period (s).
            """
            a = signals.aim.rotation @ object_axis
            rotation = _turn_between(a, target)
            angle = float(np.linalg.norm(rotation))
            w = _speed_to_stop(largest_rate, angle, ANGULAR_ACCELERATION, dt)
            normal_axes = null_space(a[None]).T  # two axes at right angles to a
            values = normal_axes @ rotation * (w / max(angle, 1e-12))
            return Demand(normal_axes @ ANGULAR, values, angle < ARRIVED_ANGLE)

        return demand

    return Motion(begin, f"turn {_direction_text(object_axis)} at {largest_rate:g} rad/s")


def to(
    pose: pin.SE3 | Callable[[Sensed], pin.SE3], speed: Velocity, rate: AngularVelocity = 0.5
) -> Motion:
    """Straight way of the object's origin to a pose, and the shortest rotation meanwhile.

    Args:
        pose: pose of the object in the world, or a function of the signals when the stage begins.
        speed: largest speed of the origin (m/s).
        rate: largest angular speed (rad/s).

    Raises:
        InvalidInputError: a number is not positive.
    """
    largest_speed = _require_positive("to: speed", speed)
    largest_rate = _require_positive("to: rate", rate)

    def begin(signals: Sensed) -> Course:
        """Begin the motion to `goal`, the pose in the world that `pose` gives at present.

        Args:
            signals: signals when the stage begins.
        """
        goal = pose(signals) if callable(pose) else pose

        def demand(signals: Sensed, dt: float) -> Demand:
            """Demand the whole twist (6,), which moves the object straight towards `goal`.

            Speeds are at most `largest_speed` (m/s) and `largest_rate` (rad/s), and lower towards
            the end.

            Args:
                signals: signals after the last tick.
                dt: control period (s).
            """
            offset = goal.translation - signals.aim.translation
            rotation = pin.log3(goal.rotation @ signals.aim.rotation.T)
            distance = float(np.linalg.norm(offset))
            angle = float(np.linalg.norm(rotation))
            v = _speed_to_stop(largest_speed, distance, LINEAR_ACCELERATION, dt)
            w = _speed_to_stop(largest_rate, angle, ANGULAR_ACCELERATION, dt)
            linear = offset * (v / max(distance, 1e-12))
            angular = rotation * (w / max(angle, 1e-12))
            arrived = distance < ARRIVED and angle < ARRIVED_ANGLE
            return Demand(np.eye(6), np.concatenate((linear, angular)), arrived)

        return demand

    return Motion(begin, f"to a pose at {1e3 * largest_speed:g} mm/s")


def through(points: Points, speed: Velocity, *, relative: bool = False) -> Motion:
    """Way of the object's origin through points, straight from one to the next.

    The part of the way along contact normals is left to the contacts.

    Args:
        points: (k, 3) points in the world, or relative to the beginning of the stage (m).
        speed: largest speed (m/s).
        relative: True: points are relative to the commanded place of the origin when the stage
            begins.

    Raises:
        InvalidInputError: points have another shape, or the speed is not positive.
    """
    positions = as_array("through: points", points, (None, 3))
    largest_speed = _require_positive("through: speed", speed)

    def begin(signals: Sensed) -> Course:
        """Begin the motion along `path`, the (k, 3) points in the world (m).

        Args:
            signals: signals when the stage begins.
        """
        path = positions + (signals.aim.translation if relative else 0.0)
        k = 0  # index of the next point

        def demand(signals: Sensed, dt: float) -> Demand:
            """Demand the velocity of the origin towards point k of `path`, the next one.

            Distances (m) count across contact normals only. The speed, at most `largest_speed`
            (m/s), falls to zero at the last point only.

            Args:
                signals: signals after the last tick.
                dt: control period (s).
            """
            nonlocal k
            while k < len(path):
                tangents = null_space(signals.N[:3].T)  # directions across all contact forces
                offset = tangents @ tangents.T @ (path[k] - signals.aim.translation)
                distance = float(np.linalg.norm(offset))
                if distance >= largest_speed * dt + ARRIVED:
                    is_last = k + 1 == len(path)
                    to_stop = distance if is_last else inf  # the motion stops only at the last one
                    v = _speed_to_stop(largest_speed, to_stop, LINEAR_ACCELERATION, dt)
                    return Demand(LINEAR, offset * (v / distance))
                k += 1
            return Demand(LINEAR, np.zeros(3), finished=True)

        return demand

    return Motion(begin, f"through {len(positions)} points at {1e3 * largest_speed:g} mm/s")


def raster(
    along: Direction,
    across: Direction,
    length: Length,
    width: Length,
    pitch: Length,
    speed: Velocity,
) -> Motion:
    """Parallel lines, to and fro, from where the stage begins.

    Args:
        along: (3,) direction of the lines in world axes.
        across: (3,) direction from line to line in world axes.
        length: length of the lines (m).
        width: width of the area that the lines fill (m).
        pitch: distance of neighbouring lines (m).
        speed: largest speed (m/s).

    Raises:
        InvalidInputError: a direction is zero, or a number is not positive.
    """
    line = unit_vector("raster: along", along)
    step = unit_vector("raster: across", across)
    lines = 1 + round(
        _require_positive("raster: width", width) / _require_positive("raster: pitch", pitch)
    )
    far_end = _require_positive("raster: length", length)
    points = []
    for k in range(lines):
        forwards = k % 2 == 0
        for distance in (0.0, far_end) if forwards else (far_end, 0.0):
            points.append(distance * line + k * pitch * step)
    return through(points, speed, relative=True)


def spiral(axis: Direction, pitch: Length, speed: Velocity, radius: Length) -> Motion:
    """Spiral of Archimedes of the object's origin, from where the stage begins.

    Args:
        axis: (3,) normal of the plane of the spiral, in world axes.
        pitch: distance of neighbouring turns (m).
        speed: largest speed (m/s).
        radius: radius at which the spiral ends (m).

    Raises:
        InvalidInputError: the axis is zero, or a number is not positive.
    """
    normal = unit_vector("spiral: axis", axis)
    per_angle = _require_positive("spiral: pitch", pitch) / (2.0 * pi)
    largest_speed = _require_positive("spiral: speed", speed)
    end = _require_positive("spiral: radius", radius)
    rows = null_space(normal[None]).T @ LINEAR

    def begin(signals: Sensed) -> Course:
        """Begin at the centre of the spiral, whose radius is r = pitch/(2π) × angle (m).

        Args:
            signals: signals when the stage begins.
        """
        angle = 0.0

        def demand(signals: Sensed, dt: float) -> Demand:
            """Demand the velocity along the spiral, in the two axes `rows` of its plane.

            Its radius is r = `per_angle` × angle, up to `end` (m). The angular speed w (rad/s)
            follows from `largest_speed` (m/s) and from the acceleration.

            Args:
                signals: signals after the last tick.
                dt: control period (s).
            """
            nonlocal angle
            r = per_angle * angle
            if r >= end:
                return Demand(rows, np.zeros(2), finished=True)
            path_per_angle = hypot(r, per_angle)
            # limits of the speed and of the centripetal acceleration
            w = min(largest_speed / path_per_angle, sqrt(LINEAR_ACCELERATION / path_per_angle))
            angle += w * dt
            c = cos(angle)
            s = sin(angle)
            outward = w * per_angle
            values = (outward * c - w * r * s, outward * s + w * r * c)
            return Demand(rows, np.array(values))

        return demand

    return Motion(begin, f"spiral of {1e3 * end:g} mm at {1e3 * largest_speed:g} mm/s")


def rock(
    axis: Direction,
    angle: Angle,
    frequency: Frequency,
    cycles: Number = inf,
    *,
    axes: Axes = "world",
) -> Motion:
    """Sinusoidal rotation of the object to and fro about an axis through its origin.

    Its amplitude grows during the first cycle.

    Args:
        axis: (3,) axis in world axes or in the object's, as `axes` states.
        angle: amplitude (rad).
        frequency: frequency of the oscillation (Hz).
        cycles: number of cycles after which it ends; inf: it does not end.
        axes: axes in which `axis` is given.

    Raises:
        InvalidInputError: zero axis, a number that is not positive, or a too large acceleration.
    """
    rock_axis = unit_vector("rock: axis", axis)
    amplitude = _require_positive("rock: angle", angle)
    frequency_Hz = _require_positive("rock: frequency", frequency)
    n_cycles = _require_positive("rock: cycles", cycles)
    _require_followed(amplitude, frequency_Hz)

    def begin(signals: Sensed) -> Course:
        """Begin with an angle of zero, in the first cycle.

        Args:
            signals: signals when the stage begins.
        """
        cycle = 0.0
        last_angle = 0.0

        def demand(signals: Sensed, dt: float) -> Demand:
            """Demand the angular velocity about `rock_axis`, given in the axes `axes`.

            The angle is a sine that rises in its first cycle, with `amplitude` (rad) and
            `frequency_Hz`, for `n_cycles` cycles.

            Args:
                signals: signals after the last tick.
                dt: control period (s).
            """
            nonlocal cycle, last_angle
            a = signals.aim.rotation @ rock_axis if axes == "object" else rock_axis
            cycle = min(cycle + frequency_Hz * dt, n_cycles)
            new_angle = amplitude * min(cycle, 1.0) * sin(2.0 * pi * cycle)
            w = (new_angle - last_angle) / dt
            last_angle = new_angle
            return Demand((a @ ANGULAR)[None], np.array([w]), cycle >= n_cycles)

        return demand

    return Motion(begin, f"rock about {_direction_text(rock_axis)} by {amplitude:g} rad")


def _require_followed(amplitude: float, frequency_Hz: float) -> None:
    """Refuse an oscillation with a larger acceleration than that of a plan's references.

    Args:
        amplitude: amplitude A of the angle (rad).
        frequency_Hz: frequency f; the largest acceleration is A (2πf)².

    Raises:
        InvalidInputError: it is more than `CHANGES` times `ANGULAR_ACCELERATION`.
    """
    largest = amplitude * (2.0 * pi * frequency_Hz) ** 2
    if largest > CHANGES * ANGULAR_ACCELERATION:
        raise InvalidInputError(
            f"rock: {amplitude:g} rad at {frequency_Hz:g} Hz need {largest:.3g} rad/s², more than "
            f"{CHANGES * ANGULAR_ACCELERATION:g} rad/s²; lower angle or frequency"
        )


def _turn_between(a: Array, b: Array) -> Array:
    """Rotation vector (3,) of the shortest rotation from a unit vector to another one (rad).

    If b = −a, the axis is any one at right angles to a.

    Args:
        a: (3,) unit vector before the rotation.
        b: (3,) unit vector after the rotation, in the same axes.
    """
    axis = np.cross(a, b)
    size = float(np.linalg.norm(axis))
    angle = float(np.arctan2(size, a @ b))
    if size < 1e-12:
        return null_space(a[None])[:, 0] * angle
    return axis * (angle / size)


class _KindOfMotion(NamedTuple):
    """Kind of a motion, translation or rotation, with its limits.

    Attributes:
        rows: (3, 6) matrix whose product with a twist is the linear or the angular velocity.
        deceleration: deceleration with which the motion ends (m/s², rad/s²).
        arrived: distance from the end at which the motion has ended (m, rad).
    """

    rows: Array
    deceleration: float
    arrived: float


_TRANSLATION = _KindOfMotion(LINEAR, LINEAR_ACCELERATION, ARRIVED)
_ROTATION = _KindOfMotion(ANGULAR, ANGULAR_ACCELERATION, ARRIVED_ANGLE)


def _begin_steady_motion(
    kind: _KindOfMotion,
    direction: Array,
    axes: Axes,
    speed: float,
    length: float,
    limit: float | None,
) -> Callable[[Sensed], Course]:
    """Make the function `begin` of a motion along, or about, one direction.

    Args:
        kind: translation or rotation.
        direction: (3,) unit vector in world axes, or in the object's, as `axes` states.
        axes: axes of the direction.
        speed: largest speed (m/s, rad/s).
        length: distance at which the motion ends (m, rad).
        limit: force or couple against the motion at which it stops (N, N m); None: it never does.
    """

    def begin(signals: Sensed) -> Course:
        """Begin the motion with a covered length of zero (m, rad).

        Args:
            signals: signals when the stage begins.
        """
        covered = 0.0

        def demand(signals: Sensed, dt: float) -> Demand:
            """Demand the speed along `direction`, lower towards the end and against a force.

            `direction` (3,) is in the axes `axes`; `kind.rows` are the rows of the velocity of O
            (translation) or of the angular velocity (rotation). The speed (m/s, rad/s) is at most
            `speed`, falls towards the covered `length` (m, rad), and as the force or couple comes
            near `limit` (N, N m).

            Args:
                signals: signals after the last tick.
                dt: control period (s).
            """
            nonlocal covered
            axis = signals.aim.rotation @ direction if axes == "object" else direction
            row = axis @ kind.rows
            covered += dt * float(row @ signals.V_D)
            rate = _speed_to_stop(speed, length - covered, kind.deceleration, dt)
            rate *= _share_against_force(limit, float(row @ signals.wrench))
            return Demand(row[None], np.array([rate]), length - covered < kind.arrived)

        return demand

    return begin


def _speed_to_stop(speed: float, distance: float, deceleration: float, dt: float) -> float:
    """Largest speed from which the rest of a way ends at rest (m/s, rad/s).

    Args:
        speed: largest speed of the motion (m/s, rad/s).
        distance: rest of the way (m, rad); from zero on the speed is zero.
        deceleration: deceleration at the end (m/s², rad/s²).
        dt: control period (s), in which the motion must not pass the end.
    """
    if distance <= 0.0:
        return 0.0
    return min(speed, sqrt(2.0 * deceleration * distance), distance / dt)


def _share_against_force(limit: float | None, force: float) -> float:
    """Share of the speed, between `BACK` and 1, for a force against the motion.

    Args:
        limit: force or couple at which the share is zero (N, N m); None: it is always 1.
        force: measured force or couple of the object on its environment along the motion (N, N m).
    """
    return 1.0 if limit is None else min(max(1.0 - force / limit, BACK), 1.0)


def _require_positive(name: str, value: float) -> float:
    """Return a number > 0 as a float.

    Args:
        name: function and argument, for the message.
        value: number in SI units.

    Raises:
        InvalidInputError: the number is zero, negative or NaN.
    """
    number = float(value)
    if not number > 0.0:
        raise InvalidInputError(f"{name} = {value!r}; give a number > 0 in SI units")
    return number


def _direction_text(direction: Array) -> str:
    """Write a direction (3,) with two digits, for reports."""
    return "[" + ", ".join(f"{x:.2g}" for x in direction) + "]"
