"""Time-optimal motions within limits on velocity, acceleration and jerk, by ruckig.

L. Berscheid, T. Kröger: Jerk-limited Real-time Trajectory Generation with Arbitrary Target States,
RSS 2021. Only its local solver is used: its own way points are solved by a server elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InvalidInputError, OscContactError, SolverError

__all__ = ["Bounds", "JerkLimits", "Trajectory", "solve"]

Array = NDArray[np.float64]
Bounds = tuple[list[float], list[float], list[float]]
"""Of velocity, acceleration and jerk, one for each coordinate."""


@dataclass(frozen=True)
class JerkLimits:
    """Bounds on the first three derivatives of coordinates, the same in both directions.

    Attributes:
        velocity, acceleration, jerk: finite and > 0; one for all coordinates, or one for each.

    Raises:
        InvalidInputError: a bound is not finite or not positive.
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
        bounds: list[list[float]] = []
        for key, value in vars(self).items():
            bound = np.asarray(value, dtype=np.float64)
            if bound.shape not in ((), (1,), (n,)):
                raise InvalidInputError(
                    f"{key} limit of shape {bound.shape} for {n} coordinates; give one number, or "
                    "one for each"
                )
            bounds.append(np.broadcast_to(bound, (n,)).tolist())
        return bounds[0], bounds[1], bounds[2]


def solve(
    x: Sequence[float],
    v: Sequence[float],
    a: Sequence[float],
    goal: Sequence[float],
    limits: Bounds,
) -> Any:
    """ruckig's trajectory from the state (x, v, a) to rest at `goal`, all coordinates together.

    On a straight line where the state permits it; all coordinates arrive at once in any case. A
    state beyond a limit is brought back within it first.

    Args:
        x, v, a: state of each coordinate. goal: where to rest.
        limits: velocity, acceleration and jerk of each coordinate, in its units.

    Raises:
        SolverError: ruckig finds none.
        OscContactError: ruckig is not installed.
    """
    try:
        import ruckig
    except ImportError as error:
        raise OscContactError(
            "jerk-limited references need the package 'ruckig': pip install osc_contact[sim]"
        ) from error
    n = len(x)
    wanted, trajectory = ruckig.InputParameter(n), ruckig.Trajectory(n)
    wanted.current_position, wanted.current_velocity = x, v
    wanted.current_acceleration, wanted.target_position = a, goal
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = limits
    wanted.synchronization = ruckig.Synchronization.Phase
    try:
        result = ruckig.Ruckig(n).calculate(wanted, trajectory)
    except ruckig.RuckigError as error:
        raise SolverError(f"no jerk-limited way from {list(x)} to {list(goal)}: {error}") from error
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise SolverError(f"no jerk-limited way from {list(x)} to {list(goal)}: {result}")
    return trajectory


class Trajectory:
    """From a state of n coordinates to rest at a goal; time is counted from its beginning.

    Solved from 0 in units in which each coordinate's greatest velocity is 1/s.
    """

    def __init__(self, x: Array, v: Array, a: Array, goal: Array, bounds: Bounds) -> None:
        self.goal = goal
        self._origin, self._unit = x, np.array(bounds[0])
        begin = [(each / self._unit).tolist() for each in (0.0 * x, v, a)]
        limits = [(np.array(each) / self._unit).tolist() for each in bounds]
        self._trajectory = solve(
            begin[0], begin[1], begin[2], ((goal - x) / self._unit).tolist(),
            (limits[0], limits[1], limits[2]),
        )  # fmt: skip
        self._duration = float(self._trajectory.duration)
        self._t = 0.0

    @classmethod
    def rest(cls, x: Array, bounds: Bounds) -> Trajectory:
        """No way at all: at rest at x."""
        return cls(x, 0.0 * x, 0.0 * x, x, bounds)

    def advance(self, dt: float) -> None:
        """Let time pass (s)."""
        self._t += dt

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """(x, v, a) now, new arrays; at the end exactly the goal, at rest."""
        if self._t >= self._duration:
            return self.goal.copy(), np.zeros(len(self.goal)), np.zeros(len(self.goal))
        x, v, a = np.array(self._trajectory.at_time(self._t)) * self._unit
        return self._origin + x, v, a

    @property
    def remaining(self) -> float:
        """Time left (s)."""
        return max(0.0, self._duration - self._t)
