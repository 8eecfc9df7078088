"""Signals made of polynomials: through given points, and jerk-limited from rest to rest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationInfo, field_validator

from osc_contact.jerk_limits import follow, from_rest_to_rest
from osc_contact.scenarios.quantities import OfQuantity, Time
from osc_contact.scenarios.spec import refuse

__all__ = ["JerkLimited", "Polynomials", "Points", "Values", "jerk_limited", "least_jerk"]

Array = npt.NDArray[np.float64]
Values = tuple[Any, Any, Any]  #: value, first and second derivative, each a number or (k,)
Q = TypeVar("Q", bound=float)
V = TypeVar("V", bound=float)
A = TypeVar("A", bound=float)
J = TypeVar("J", bound=float)


@dataclass(frozen=True)
class Polynomials:
    """Polynomials of the time since the last knot; outside the knots the curve is at rest.

    Attributes:
        knots: (k + 1,) times (s), increasing. coefficients: (degree + 1, k), rising powers.
        last: the value from the last knot on.
    """

    knots: Array
    coefficients: Array
    last: float

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative at the time or times t (s)."""
        if np.ndim(t) == 0:
            return tuple(float(x[0]) for x in self.at(np.array([t])))  # type: ignore[return-value]
        first = self.knots[0]
        end = self.knots[-1]
        i = np.clip(np.searchsorted(self.knots, t, side="right") - 1, 0, len(self.knots) - 2)
        s = np.clip(t, first, end) - self.knots[i]
        c = self.coefficients[:, i]
        x, x_dot, x_ddot = np.zeros((3, len(t)))
        for row in c[::-1]:  # Horner's scheme, differentiated twice
            x_ddot = x_ddot * s + 2.0 * x_dot
            x_dot = x_dot * s + x
            x = x * s + row
        moves = (t > first) & (t < end)
        return np.where(t >= end, self.last, x), x_dot * moves, x_ddot * moves


class JerkLimited(OfQuantity[Q], Generic[Q, V, A, J]):
    """0 → via → value as fast as the limits permit, at rest at each of them; then held."""

    type: Literal["jerk_limited"] = "jerk_limited"
    value: Q
    """the final value, with its unit"""
    via: tuple[Q, ...] = ()
    """way points before `value`, at rest at each"""
    start: Time = 0.0
    """when it begins, at 0"""
    velocity: Annotated[V, Field(gt=0)]
    """the greatest rate, such as 0.1 m/s"""
    acceleration: Annotated[A, Field(gt=0)]
    """the greatest second derivative, such as 1 m/s²"""
    jerk: Annotated[J, Field(gt=0)]
    """the greatest third derivative, such as 20 m/s³"""

    @property
    def duration(self) -> float:
        """How long it takes from `start` on (s)."""
        knots = self._pieces().knots
        return float(knots[-1] - knots[0])

    def at(self, t: Any) -> Values:
        """Return value and its exact derivatives."""
        return self._pieces().at(t)

    def _pieces(self) -> Polynomials:
        points = (0.0, *map(float, self.via), float(self.value))
        limits = float(self.velocity), float(self.acceleration), float(self.jerk)
        return jerk_limited(points, float(self.start), *limits)


class Points(OfQuantity[Q], Generic[Q]):
    """Through [time, value] points by the curve of least ∫ jerk² dt, at rest before and after.

    A value given twice in a row is held in between."""

    type: Literal["points"] = "points"
    points: Annotated[tuple[tuple[Time, Q], ...], Field(min_length=2, max_length=500)]
    """a list of [time, value], such as [[0 s, 0 mm], [1 s, 20 mm]], or the name of a CSV file
    beside the scenario with a line `time, value` for each, in SI"""

    @field_validator("points", mode="before")
    @classmethod
    def _from_file(cls, points: Any, info: ValidationInfo) -> Any:
        if not isinstance(points, str):
            return points
        file = ((info.context or {}).get("folder") or Path()) / points
        try:
            return np.loadtxt(file, delimiter=",", ndmin=2).tolist()
        except (OSError, ValueError) as error:
            raise refuse(f"expected a CSV file with lines 'time, value'; {error}") from error

    @field_validator("points")
    @classmethod
    def _spaced_well(cls, points: tuple[tuple[float, Q], ...]) -> Any:
        for (before, _), (after, _) in pairwise(points):
            if not after - before >= 1e-6:
                raise refuse(
                    f"times must increase, by 1 µs at least; {after:.9g} s is after {before:.9g} s"
                )
        t = [time for time, _ in points]
        for i in set(range(len(t))) - _stops([float(x) for _, x in points]):
            ratio = (t[i + 1] - t[i]) / (t[i] - t[i - 1])
            if max(ratio, 1.0 / ratio) > 10.0 + 1e-9:
                raise refuse(
                    f"between the points before and after {t[i]:.9g} s the curve would swing far "
                    f"out: one is {max(ratio, 1.0 / ratio):.3g} times as far away as the other, 10 "
                    "at most; add points, or stop by giving a value twice"
                )
        return points

    def at(self, t: Any) -> Values:
        """Return value and its exact derivatives."""
        return least_jerk(self.points).at(t)


@lru_cache(maxsize=64)
def jerk_limited(
    points: tuple[float, ...], start: float, velocity: float, acceleration: float, jerk: float
) -> Polynomials:
    """The fastest way from rest at each of `points` to rest at the next one, from `start` on.

    Args:
        points: to rest at. start: where it begins.
        velocity, acceleration, jerk: limits, in units of the points per s, s², s³.
    """
    knots = [start]
    columns = []
    now = points[0]
    for here, there in pairwise(points):
        if (way := there - here) == 0.0:
            continue
        state = here, 0.0, 0.0
        sign = 1.0 if way > 0.0 else -1.0
        for duration, size in from_rest_to_rest(abs(way), velocity, acceleration, jerk):
            if knots[-1] + duration > knots[-1]:
                x, v, a = state
                columns.append((x, v, a / 2.0, sign * size / 6.0))
                knots.append(knots[-1] + duration)
                state = follow(((duration, sign * size),), duration, x, v, a)
        now = there
    if not columns:  # nowhere to go
        knots = [start, start + 1.0]
        columns = [(now, 0.0, 0.0, 0.0)]
    return Polynomials(np.array(knots), np.array(columns).T, now)


@lru_cache(maxsize=64)
def least_jerk(points: tuple[tuple[float, float], ...]) -> Polynomials:
    """The curve through (time, value) `points` that makes ∫ jerk² dt least, at rest at its stops.

    A quintic spline: between points the sixth derivative vanishes, at points the third and fourth
    are continuous (Euler–Lagrange with free velocities and accelerations there).
    """
    t, x = np.array(points).T
    unit = (t[-1] - t[0]) / (len(t) - 1)  # so that the unknowns are of one size
    h: Array = np.diff(t) / unit
    dx = np.diff(x)
    count = len(t)
    # unknowns: v, a of each point
    A = np.zeros((2 * count, 2 * count))
    b = np.zeros(2 * count)
    stops = _stops(x.tolist())
    for i in range(count):
        if i in stops:
            A[2 * i, 2 * i] = A[2 * i + 1, 2 * i + 1] = 1.0
            continue
        before = h[i - 1]
        after = h[i]
        left, here, right = (slice(2 * k, 2 * k + 2) for k in (i - 1, i, i + 1))
        # end of the piece before = begin of the piece after
        jerk = 2 * i
        snap = 2 * i + 1
        A[jerk, left] = -8 / before**2, -1 / before
        A[jerk, here] = -12 / before**2 + 12 / after**2, 3 / before + 3 / after
        A[jerk, right] = 8 / after**2, -1 / after
        b[jerk] = 20 * (dx[i] / after**3 - dx[i - 1] / before**3)
        A[snap, left] = -14 / before**3, -2 / before**2
        A[snap, here] = -16 / before**3 - 16 / after**3, 3 / before**2 - 3 / after**2
        A[snap, right] = -14 / after**3, 2 / after**2
        b[snap] = -30 * (dx[i] / after**4 + dx[i - 1] / before**4)
    v, a = np.asarray(np.linalg.solve(A, b), dtype=np.float64).reshape(count, 2).T
    return Polynomials(t, _quintics(x, v, a, h) / unit ** np.arange(6.0)[:, None], float(x[-1]))


def _stops(values: list[float]) -> set[int]:
    """The points at which a curve rests: both ends, and where a value is given twice in a row."""
    twice = [i for i, (x, y) in enumerate(pairwise(values)) if x == y]
    return {0, len(values) - 1, *twice, *(i + 1 for i in twice)}


def _quintics(x: Array, v: Array, a: Array, h: Array) -> Array:
    """(6, k) coefficients between points with values, velocities and accelerations (k + 1,)."""
    dx = np.diff(x)
    dv = np.diff(v)
    rest = dx - h * v[:-1] - h**2 * a[:-1] / 2
    slope = dv - h * a[:-1]
    bend = np.diff(a)
    third = (10 * rest - 4 * h * slope + h**2 * bend / 2) / h**3
    fourth = (-15 * rest + 7 * h * slope - h**2 * bend) / h**4
    fifth = (6 * rest - 3 * h * slope + h**2 * bend / 2) / h**5
    return np.array([x[:-1], v[:-1], a[:-1] / 2, third, fourth, fifth])
