"""Time-optimal motions within limits on velocity, acceleration and jerk.

Motions from rest to rest have a closed form. From other states ruckig computes them:
L. Berscheid, T. Kröger: Jerk-limited Real-time Trajectory Generation with Arbitrary Target States,
RSS 2021. Only ruckig's local solver is used, not its way points, which a remote server solves.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cbrt, sqrt
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InvalidInputError, OscContactError, SolverError

Array = NDArray[np.float64]
Bounds = tuple[list[float], ...]
"""Limits on velocity, acceleration and jerk, in this order: a number for each coordinate."""
Pieces = tuple[tuple[float, float], ...]
"""Duration (s) and jerk of each phase of constant jerk, in the order of time."""

#: Shares of the limits with which ruckig is tried, one after the other.
_TRIED_SHARES = (1.0, 1.0 - 1e-9, 1.0 - 1e-6, 0.999)
#: Largest error at the end of ruckig's trajectory, relative to its length plus 1 s at full speed.
_MOST_END_ERROR = 1e-7
_LEAST_SHARE = 1e-300  #: coordinates with a smaller share of a straight line do not move


@dataclass(frozen=True)
class JerkLimits:
    """Limits on the first three derivatives of coordinates, equal in both directions.

    Attributes:
        velocity, acceleration, jerk: finite numbers > 0, (n,) or one for all coordinates (m or rad,
            over s, s², s³).

    Raises:
        InvalidInputError: a bound is not finite or not positive.

    Example:
        >>> limits = osc.JerkLimits(velocity=0.3, acceleration=2.0, jerk=40.0)  # m/s, m/s², m/s³
    """

    velocity: ArrayLike
    acceleration: ArrayLike
    jerk: ArrayLike

    def __post_init__(self) -> None:
        """Refuse limits that are not finite and positive (`InvalidInputError`)."""
        for key, value in vars(self).items():
            try:
                bound = np.asarray(value, dtype=np.float64)
                is_valid = bound.size > 0 and bool((np.isfinite(bound) & (bound > 0.0)).all())
            except (TypeError, ValueError):
                is_valid = False
            if not is_valid:
                raise InvalidInputError(f"{key} limit {value}; give finite numbers > 0")

    def each(self, n: int) -> Bounds:
        """Limits for each of n coordinates; a limit with one number holds for all of them.

        Args:
            n: number of coordinates.

        Returns:
            Three lists of n numbers: limits of velocity, acceleration and jerk, in this order (m or
            rad, over s, s², s³).

        Raises:
            InvalidInputError: a limit has neither one nor n numbers.
        """
        bounds = []
        for key, value in vars(self).items():  # in the order of the fields of this class
            bound = np.asarray(value, dtype=np.float64)
            if bound.shape not in ((), (1,), (n,)):
                raise InvalidInputError(
                    f"{key} limit of shape {bound.shape} for {n} coordinates; give one number, or "
                    "one for each"
                )
            bounds.append(np.broadcast_to(bound, (n,)).tolist())
        return tuple(bounds)


def from_rest_to_rest(distance: float, v: float, a: float, j: float) -> Pieces:
    """Time-optimal motion over a distance, at rest at both ends.

    It has at most seven pieces: the acceleration rises, stays at its limit and falls; the speed
    stays at its limit; the deceleration rises, stays and falls.

    Args:
        distance: length of the path, ≥ 0 (m or rad).
        v, a, j: limits of velocity, acceleration and jerk along the path, > 0.

    Returns:
        Durations (s) and jerks of the pieces; no pieces if the distance is zero.
    """
    # `rise` is the time for which the acceleration rises: each limit and the distance bounds it
    rise = min(cbrt(0.5 * distance / j), sqrt(v / j), a / j)
    stay = 0.0
    if rise == a / j:  # the acceleration reaches its limit
        fastest = min(v, 0.5 * a * (sqrt(rise * rise + 4.0 * distance / a) - rise))
        stay = max(0.0, fastest / a - rise)
    peak = j * rise * (rise + stay)
    if peak == 0.0:  # the distance is zero, or so short that the speed underflows
        return ()
    cruise = max(0.0, distance / peak - 2.0 * rise - stay)
    speed_up = ((rise, j), (stay, 0.0), (rise, -j))
    slow_down = ((rise, -j), (stay, 0.0), (rise, j))
    return (*speed_up, (cruise, 0.0), *slow_down)


def _to_rest(v0: float, a0: float, a: float, j: float) -> Pieces:
    """Time-optimal motion from velocity v0 and acceleration a0 to rest, at any position.

    Args:
        v0, a0: velocity and acceleration at the beginning (m/s and m/s², or rad/s and rad/s²).
        a, j: limits of acceleration and jerk, > 0.

    Returns:
        Durations (s) and jerks of three pieces.
    """
    # velocity at the time at which the acceleration has been brought to zero with the largest jerk;
    # if it is negative, the mirrored motion is computed, so that below the motion must slow down
    velocity_at_no_acceleration = v0 + a0 * abs(a0) / (2.0 * j)
    if velocity_at_no_acceleration < 0.0:
        return tuple((duration, -jerk) for duration, jerk in _to_rest(-v0, -a0, a, j))
    # three pieces: the acceleration changes from a0 to −deceleration, stays there if that is its
    # limit, and rises to zero
    deceleration = min(a, sqrt(max(0.0, j * v0 + 0.5 * a0 * a0)))
    first_duration = abs(a0 + deceleration) / j
    stay = 0.0
    if deceleration == a:
        stay = max(0.0, (v0 + 0.5 * first_duration * (a0 - a)) / a - 0.5 * a / j)
    first_jerk = -j if a0 > -deceleration else j
    return ((first_duration, first_jerk), (stay, 0.0), (deceleration / j, j))


def follow(
    pieces: Pieces, t: float, x: float = 0.0, v: float = 0.0, a: float = 0.0
) -> tuple[float, float, float]:
    """Compute the state of a coordinate at the time t of a motion with pieces of constant jerk.

    Args:
        pieces: duration (s) and jerk of each phase.
        t: time since the beginning of the first phase (s).
        x, v, a: position, velocity and acceleration at the beginning (m or rad, over s, s²).

    Returns:
        Position, velocity and acceleration at the time t.
    """
    for duration, jerk in pieces:
        h = min(t, duration)  # time within this piece; 0 in pieces after t
        x += h * (v + h * (a / 2.0 + h * jerk / 6.0))
        v += h * (a + h * jerk / 2.0)
        a += h * jerk
        t -= h
    return (x, v, a)


def rise(t: Any, start: float, duration: float) -> tuple[Any, Any, Any]:
    """Compute the minimum-jerk rise 10s³ − 15s⁴ + 6s⁵ from 0 to 1, s = (t − start)/duration.

    A rise of zero duration is a step whose derivatives are zero.

    Args:
        t: time (s), or several times (k,).
        start, duration: beginning and duration of the rise (s).

    Returns:
        Value, first derivative (1/s) and second derivative (1/s²), each a number or (k,).
    """
    if isinstance(t, np.ndarray):
        s = np.where(t >= start + duration, 1.0, np.maximum(t - start, 0.0) / (duration or 1.0))
    elif t < start:
        return 0.0, 0.0, 0.0
    elif t >= start + duration:
        return 1.0, 0.0, 0.0
    else:
        s = (t - start) / duration
    duration = duration or 1.0  # avoids a division by zero; s is 0 or 1 in this case
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s * s),
        30.0 * s * s * (1.0 - s) ** 2 / duration,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2,
    )


def _total_duration(pieces: Pieces) -> float:
    """Duration of all phases (s)."""
    return sum(duration for duration, _ in pieces)


class _StopAndGo:
    """Trajectory that brings each coordinate to rest as fast as possible, then moves straight.

    It is a closed form for any state and any goal; from rest it is time-optimal.

    Attributes:
        duration: duration of both parts (s).
        _start_state: position, velocity and acceleration (n,) at the beginning.
        _stop_pieces, _stop_times: pieces of constant jerk that stop each coordinate, and the times
            at which it rests (s).
        _all_stopped: time at which all coordinates rest (s).
        _line_start, _line_direction: (n,) position there, and direction of the line to the goal,
            whose largest component is 1.
        _line_pieces: pieces of constant jerk along the line.
    """

    def __init__(self, x: Array, v: Array, a: Array, goal: Array, limits: Array) -> None:
        """Compute a trajectory that stops first, and then goes along a straight line to the goal.

        Each of the n coordinates is brought to rest independently, as fast as its limits permit.
        From where all of them rest, the line is followed with one speed profile, whose limits are
        those of the coordinate that would reach its own first.

        Args:
            x, v, a: (n,) position, velocity and acceleration at the beginning.
            goal: (n,) position at the end.
            limits: (3, n) largest velocity, acceleration and jerk of each coordinate.
        """
        # first part: every coordinate is brought to rest independently, the last one at
        # `_all_stopped`
        self._start_state = (x, v, a)
        _, most_acceleration, most_jerk = limits
        self._stop_pieces = [
            _to_rest(v0, a0, a_max, j_max)
            for v0, a0, a_max, j_max in zip(v, a, most_acceleration, most_jerk, strict=True)
        ]
        self._stop_times = [_total_duration(stop) for stop in self._stop_pieces]
        self._all_stopped = max(self._stop_times)

        # second part: a straight line to the goal; s is the distance of the coordinate with the
        # longest way, and the limits along s are those of the coordinate that reaches them first
        self._line_start = self._state_while_stopping(self._all_stopped)[0]
        line = np.nan_to_num(goal - self._line_start)
        length = float(np.abs(line).max())
        self._line_direction = line / length if length > 0.0 else line
        is_moved = np.abs(self._line_direction) > _LEAST_SHARE
        along_line = (limits[:, is_moved] / np.abs(self._line_direction[is_moved])).min(
            axis=1, initial=np.inf
        )
        v_max, a_max, j_max = along_line.tolist() if is_moved.any() else (1.0, 1.0, 1.0)
        self._line_pieces = from_rest_to_rest(length, v_max, a_max, j_max)
        self.duration = self._all_stopped + _total_duration(self._line_pieces)

    def _state_while_stopping(self, t: float) -> Array:
        """State (3, n) at the time t (s) of the first part, in which coordinates are stopped.

        Its rows are position, velocity and acceleration. A coordinate that has stopped is at rest.
        """
        states = np.array(
            [
                follow(pieces, time, x, v, a)
                for pieces, time, x, v, a in zip(
                    self._stop_pieces,
                    np.minimum(t, self._stop_times),
                    *self._start_state,
                    strict=True,
                )
            ]
        ).T
        states[1:, t >= np.array(self._stop_times)] = 0.0
        return states

    def at_time(self, t: float) -> Array:
        """Position, velocity and acceleration (3, n) at a time.

        Until `_all_stopped` (s) the initial velocity is braked. Then the straight line from
        `_line_start` (n,) along `_line_direction` (n,) is followed, of which `_line_pieces` gives
        distance, speed and acceleration.

        Args:
            t: time since the beginning (s). Units of the rest are those of x, v and a.
        """
        if t < self._all_stopped:
            return self._state_while_stopping(t)
        s, v, a = follow(self._line_pieces, t - self._all_stopped)
        along = self._line_direction
        return np.array((self._line_start + along * s, along * v, along * a))


class _Fastest:
    """Time-optimal trajectory by ruckig, from the origin, with velocity limits scaled to 1/s.

    Attributes:
        duration: duration of the trajectory (s).
    """

    def __init__(self, x: Array, v: Array, a: Array, goal: Array, limits: Array) -> None:
        """Compute the trajectory.

        Args:
            x, v, a: (n,) position, velocity and acceleration at the beginning.
            goal: (n,) position at the end.
            limits: (3, n) of velocity, acceleration and jerk.

        Raises:
            SolverError: ruckig finds no trajectory, as happens at the borders between its cases.
        """
        ruckig = _ruckig_module()
        n = len(x)
        # from the origin and in units of the velocity limits, ruckig's tolerances suit any motion
        unit = limits[0]
        self._origin = x  #: (n,) position at the beginning, which is 0 for ruckig
        self._unit = unit  #: (n,) velocity limits, which are ruckig's units
        request = ruckig.InputParameter(n)
        self._trajectory = ruckig.Trajectory(n)  #: ruckig's trajectory
        request.current_position = np.zeros(n)
        request.current_velocity = v / unit
        request.current_acceleration = a / unit
        request.target_position = (goal - x) / unit
        request.max_velocity, request.max_acceleration, request.max_jerk = limits / unit
        request.synchronization = ruckig.Synchronization.Phase
        try:
            result = ruckig.Ruckig(n).calculate(request, self._trajectory)
        except (ruckig.RuckigError, ValueError) as error:  # ValueError: a result without a name
            raise SolverError(str(error)) from error
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise SolverError(str(result))
        self.duration = float(self._trajectory.duration)
        distance = np.abs(self.at_time(self.duration)[0] - goal)
        if not (distance <= _MOST_END_ERROR * (unit + np.abs(goal - x))).all():
            raise SolverError(f"ruckig's trajectory ends {distance} from the goal")

    def at_time(self, t: float) -> Array:
        """Position, velocity and acceleration (3, n) at the time t (s)."""
        states = np.array(self._trajectory.at_time(t)) * self._unit
        states[0] += self._origin
        return states


def _ruckig_module() -> ModuleType:
    """Module `ruckig`, which an extra installs.

    Raises:
        OscContactError: ruckig is not installed.
    """
    try:
        import ruckig
    except ImportError as error:
        raise OscContactError(
            "jerk-limited references need the package 'ruckig': pip install osc_contact[sim]"
        ) from error
    return ruckig


class Trajectory:
    """Trajectory of n coordinates from any state to rest at a goal, with its own clock.

    From rest it is a straight line; in any case all coordinates arrive at the same time. A state
    beyond a limit is brought back within it first. A trajectory exists for every state and goal:
    where ruckig finds none, slightly lower limits are tried, then a trajectory that stops between.

    Attributes:
        goal: (n,) position at the end.
        _motion: the trajectory as a function of the time since its beginning.
        _clock: this time (s).
    """

    def __init__(self, x: Array, v: Array, a: Array, goal: Array, bounds: Bounds) -> None:
        """Compute the fastest trajectory to rest at the goal, and set its clock to zero.

        Args:
            x, v, a: (n,) position, velocity and acceleration at the beginning (m or rad, over s,
                s²).
            goal: (n,) position at the end, where the coordinates come to rest (m or rad).
            bounds: limits of velocity, acceleration and jerk, n numbers each (m or rad, over s, s²,
                s³).
        """
        self.goal = goal
        self._motion = _fastest_trajectory(x, v, a, goal, np.array(bounds))
        self._clock = 0.0

    @classmethod
    def rest(cls, x: Array, bounds: Bounds) -> Trajectory:
        """Make a trajectory without motion, at rest at x.

        Args:
            x: (n,) position (m or rad).
            bounds: limits of velocity, acceleration and jerk, n numbers each.

        Raises:
            OscContactError: ruckig is not installed; it is needed for later trajectories.
        """
        _ruckig_module()
        return cls(x, 0.0 * x, 0.0 * x, x, bounds)

    def advance(self, dt: float) -> None:
        """Advance the clock of the trajectory by dt (s)."""
        self._clock += dt

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration (n,) at the clock's time, as new arrays.

        From the end of the trajectory on it is the goal, at rest.
        """
        if self._clock >= self._motion.duration:
            return (self.goal.copy(), np.zeros(len(self.goal)), np.zeros(len(self.goal)))
        x, v, a = self._motion.at_time(self._clock)
        return (x, v, a)

    @property
    def remaining(self) -> float:
        """Time to the end of the trajectory (s)."""
        return max(0.0, self._motion.duration - self._clock)


def _fastest_trajectory(
    x: Array, v: Array, a: Array, goal: Array, limits: Array
) -> _Fastest | _StopAndGo:
    """Compute the fastest trajectory: by ruckig with ever lower limits, else in closed form.

    From rest the closed form is the fastest one. From other states ruckig is tried; at the borders
    between its cases it fails, but succeeds with limits that are lower by rounding errors.

    Args:
        x, v, a: (n,) position, velocity and acceleration at the beginning.
        goal: (n,) position at the end.
        limits: (3, n) limits of velocity, acceleration and jerk.
    """
    if v.any() or a.any():
        for share in _TRIED_SHARES:
            try:
                return _Fastest(x, v, a, goal, share * limits)
            except SolverError:
                pass
    return _StopAndGo(x, v, a, goal, limits)
