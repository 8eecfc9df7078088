"""Time-optimal motions within limits on velocity, acceleration and jerk.

From rest to rest they have a closed form. From other states ruckig finds them:
L. Berscheid, T. Kröger: Jerk-limited Real-time Trajectory Generation with Arbitrary Target States,
RSS 2021. Only its local solver is used: its own way points are solved by a server elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cbrt, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InvalidInputError, OscContactError, SolverError

Array = NDArray[np.float64]
Bounds = tuple[list[float], ...]
"""Of velocity, acceleration and jerk, one for each coordinate."""
Pieces = tuple[tuple[float, float], ...]
"""Durations and jerks of a motion, one piece after the other."""

_SHARES = (1.0, 1.0 - 1e-9, 1.0 - 1e-6, 0.999)  #: of the limits, tried one after the other
_END = 1e-7  #: how far off the goal a way may end, beside its length and one second's
_NO_SHARE = 1e-300  #: of a line: coordinates with less do not move


@dataclass(frozen=True)
class JerkLimits:
    """Bounds on the first three derivatives of coordinates, the same in both directions.

    Attributes:
        velocity, acceleration, jerk: finite and > 0; one for all coordinates, or one for each.

    Raises:
        InvalidInputError: a bound is not finite or not positive.

    Example:
        >>> limits = osc.JerkLimits(velocity=0.3, acceleration=2.0, jerk=40.0)  # m/s, m/s², m/s³
    """

    velocity: ArrayLike
    acceleration: ArrayLike
    jerk: ArrayLike

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            try:
                bound = np.asarray(value, dtype=np.float64)
                sound = bound.size > 0 and bool((np.isfinite(bound) & (bound > 0.0)).all())
            except (TypeError, ValueError):
                sound = False
            if not sound:
                raise InvalidInputError(f"{key} limit {value}; give finite numbers > 0")

    def each(self, n: int) -> Bounds:
        """The three bounds for `n` coordinates.

        Raises:
            InvalidInputError: neither one nor n numbers were given.
        """
        bounds = []
        for key, value in vars(self).items():
            bound = np.asarray(value, dtype=np.float64)
            if bound.shape not in ((), (1,), (n,)):
                raise InvalidInputError(
                    f"{key} limit of shape {bound.shape} for {n} coordinates; give one number, or "
                    "one for each"
                )
            bounds.append(np.broadcast_to(bound, (n,)).tolist())
        return tuple(bounds)


def from_rest_to_rest(way: float, v: float, a: float, j: float) -> Pieces:
    """The fastest way of this length ≥ 0, at rest at both ends.

    It has at most seven pieces: acceleration rises, stays at its limit, falls; the speed stays at
    its limit; the same backwards.

    Args:
        way: its length. v, a, j: limits.
    """
    rise = min(cbrt(0.5 * way / j), sqrt(v / j), a / j)
    stay = 0.0
    if rise == a / j:  # the acceleration reaches its limit
        fastest = min(v, 0.5 * a * (sqrt(rise * rise + 4.0 * way / a) - rise))
        stay = max(0.0, fastest / a - rise)
    peak = j * rise * (rise + stay)
    if peak == 0.0:  # no way, or too short a one to have any speed
        return ()
    cruise = max(0.0, way / peak - 2.0 * rise - stay)
    up = ((rise, j), (stay, 0.0), (rise, -j))
    return (*up, (cruise, 0.0), (rise, -j), (stay, 0.0), (rise, j))


def _to_rest(v0: float, a0: float, a: float, j: float) -> Pieces:
    """The fastest way from velocity v0 and acceleration a0 to rest, anywhere."""
    if v0 + a0 * abs(a0) / (2.0 * j) < 0.0:  # where it would come to with a constant velocity
        return tuple((duration, -jerk) for duration, jerk in _to_rest(-v0, -a0, a, j))
    least = min(a, sqrt(max(0.0, j * v0 + 0.5 * a0 * a0)))  # deceleration
    first = abs(a0 + least) / j
    stay = 0.0
    if least == a:
        stay = max(0.0, (v0 + 0.5 * first * (a0 - a)) / a - 0.5 * a / j)
    return ((first, -j if a0 > -least else j), (stay, 0.0), (least / j, j))


def follow(
    pieces: Pieces, t: float, x: float = 0.0, v: float = 0.0, a: float = 0.0
) -> tuple[float, float, float]:
    """The state a time t after (x, v, a).

    Args:
        pieces: durations (s) and jerks, one after the other. t: s since the first one began.
        x, v, a: position, speed and acceleration there.
    """
    for duration, jerk in pieces:
        h = min(t, duration)
        x += h * (v + h * (a / 2.0 + h * jerk / 6.0))
        v += h * (a + h * jerk / 2.0)
        a += h * jerk
        t -= h
    return (x, v, a)


def _length(pieces: Pieces) -> float:
    return sum(duration for duration, _ in pieces)


class _StopAndGo:
    """To rest first, each coordinate as fast as it can; then straight to the goal.

    Always there, in closed form, for any state and any goal. From rest no way is faster.
    """

    def __init__(self, x: Array, v: Array, a: Array, goal: Array, limits: Array) -> None:
        self._begin = (x, v, a)
        self._stops = [_to_rest(*each) for each in zip(v, a, limits[1], limits[2], strict=True)]
        self._ends = [_length(stop) for stop in self._stops]
        self._stopped = max(self._ends)
        self._corner = self._stopping(self._stopped)[0]
        way = np.nan_to_num(goal - self._corner)
        length = float(np.abs(way).max())
        self._along = way / length if length > 0.0 else way
        moved = [i for i, share in enumerate(self._along) if abs(share) > _NO_SHARE]
        least = [
            min((each[i] / abs(self._along[i]) for i in moved), default=1.0) for each in limits
        ]
        self._line = from_rest_to_rest(length, *least)
        self.duration = self._stopped + _length(self._line)

    def _stopping(self, t: float) -> Array:
        """(3, n) state while it stops; a coordinate that has stopped rests."""
        states = np.array(
            [
                follow(*each)
                for each in zip(self._stops, np.minimum(t, self._ends), *self._begin, strict=True)
            ]
        ).T
        states[1:, t >= np.array(self._ends)] = 0.0
        return states

    def at_time(self, t: float) -> Array:
        """(3, n) position, velocity and acceleration."""
        if t < self._stopped:
            return self._stopping(t)
        s, v, a = follow(self._line, t - self._stopped)
        along = self._along
        return np.array((self._corner + along * s, along * v, along * a))


class _Fastest:
    """ruckig's way, solved from 0 in units in which each coordinate's greatest velocity is 1/s."""

    def __init__(self, x: Array, v: Array, a: Array, goal: Array, limits: Array) -> None:
        """Solve it.

        Raises:
            SolverError: ruckig finds none. It does not where its cases meet.
        """
        ruckig = _ruckig()
        n = len(x)
        unit = limits[0]
        self._origin = x
        self._unit = unit
        request = ruckig.InputParameter(n)
        self._way = ruckig.Trajectory(n)
        request.current_position = np.zeros(n)
        request.current_velocity = v / unit
        request.current_acceleration = a / unit
        request.target_position = (goal - x) / unit
        request.max_velocity, request.max_acceleration, request.max_jerk = limits / unit
        request.synchronization = ruckig.Synchronization.Phase
        try:
            result = ruckig.Ruckig(n).calculate(request, self._way)
        except (ruckig.RuckigError, ValueError) as error:  # the latter: of results it cannot name
            raise SolverError(str(error)) from error
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise SolverError(str(result))
        self.duration = float(self._way.duration)
        off = np.abs(self.at_time(self.duration)[0] - goal)
        if not (off <= _END * (unit + np.abs(goal - x))).all():
            raise SolverError(f"ruckig's way ends {off} from the goal")

    def at_time(self, t: float) -> Array:
        """(3, n) position, velocity and acceleration."""
        states = np.array(self._way.at_time(t)) * self._unit
        states[0] += self._origin
        return states


def _ruckig() -> Any:
    try:
        import ruckig
    except ImportError as error:
        raise OscContactError(
            "jerk-limited references need the package 'ruckig': pip install osc_contact[sim]"
        ) from error
    return ruckig


class Trajectory:
    """From a state of n coordinates to rest at a goal; time is counted from its beginning.

    On a straight line from rest; all coordinates arrive at once in any case. A state beyond a limit
    is brought back within it first. There is a way for every state and every goal: where ruckig
    finds none, limits a little lower are tried, then one that stops on the way.
    """

    def __init__(self, x: Array, v: Array, a: Array, goal: Array, bounds: Bounds) -> None:
        self.goal = goal
        self._way = _way(x, v, a, goal, np.array(bounds))
        self._t = 0.0

    @classmethod
    def rest(cls, x: Array, bounds: Bounds) -> Trajectory:
        """No way at all: at rest at x.

        Raises:
            OscContactError: ruckig is not installed.
        """
        _ruckig()
        return cls(x, 0.0 * x, 0.0 * x, x, bounds)

    def advance(self, dt: float) -> None:
        """Let time pass (s)."""
        self._t += dt

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """(x, v, a) now, new arrays; at the end exactly the goal, at rest."""
        if self._t >= self._way.duration:
            return (self.goal.copy(), np.zeros(len(self.goal)), np.zeros(len(self.goal)))
        x, v, a = self._way.at_time(self._t)
        return (x, v, a)

    @property
    def remaining(self) -> float:
        """Time left (s)."""
        return max(0.0, self._way.duration - self._t)


def _way(x: Array, v: Array, a: Array, goal: Array, limits: Array) -> _Fastest | _StopAndGo:
    """The fastest way that is found."""
    if v.any() or a.any():
        for share in _SHARES:
            try:
                return _Fastest(x, v, a, goal, share * limits)
            except SolverError:
                pass
    return _StopAndGo(x, v, a, goal, limits)
