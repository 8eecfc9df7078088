"""Commands over time: each signal gives its value and its first two time derivatives."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationInfo, field_validator

from osc_contact.jerk_limits import follow, from_rest_to_rest, rise
from osc_contact.settings.quantities import (
    Acceleration,
    Angle,
    AngularAcceleration,
    AngularJerk,
    AngularVelocity,
    Force,
    ForceRate,
    ForceRate2,
    ForceRate3,
    Frequency,
    Jerk,
    Length,
    NotNegative,
    OfQuantity,
    Positive,
    Q,
    Time,
    Velocity,
    refuse,
)

Array = npt.NDArray[np.float64]
#: Value, first and second derivative, each a number or (k,).
Values = tuple[Any, Any, Any] | npt.NDArray[np.float64]
V = TypeVar("V", bound=float)
A = TypeVar("A", bound=float)
J = TypeVar("J", bound=float)


@dataclass(frozen=True)
class Polynomials:
    """Polynomials of the time since the last knot; outside the knots the curve is at rest.

    Attributes:
        curve: polynomials between the knots, a `PPoly` of SciPy.
        last: value from the last knot on.
    """

    curve: Any
    last: float

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative of the curve at the time or times t (s).

        Before the first knot and after the last one the value is that of the knot, and derivatives
        are zero.
        """
        first, end = self.curve.x[[0, -1]]
        s = np.clip(t, first, end)
        is_between = (t > first) & (t < end)  # outside the derivatives are zero
        value = np.where(t >= end, self.last, self.curve(s))
        return value[()], self.curve(s, 1) * is_between, self.curve(s, 2) * is_between


class JerkLimited(OfQuantity, Generic[Q, V, A, J]):
    """0 → via → value as fast as the limits permit, at rest at each of them; then held."""

    type: Literal["jerk_limited"] = "jerk_limited"
    value: Q
    """the final value, with its unit"""
    via: tuple[Q, ...] = ()
    """way points before `value`, at rest at each"""
    start: Time = 0.0
    """when it begins, at 0"""
    velocity: Positive[V]
    """the greatest rate, such as 0.1 m/s"""
    acceleration: Positive[A]
    """the greatest second derivative, such as 1 m/s²"""
    jerk: Positive[J]
    """the greatest third derivative, such as 20 m/s³"""

    @property
    def duration(self) -> float:
        """Duration of the signal from `start` on (s)."""
        first, end = self._pieces().curve.x[[0, -1]].tolist()
        return end - first

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative, exactly, at the time or times t (s)."""
        return self._pieces().at(t)

    def _pieces(self) -> Polynomials:
        """Compute the polynomials of the signal, or take them from a cache."""
        points = (0.0, *self.via, self.value)
        return jerk_limited(points, self.start, self.velocity, self.acceleration, self.jerk)


class Points(OfQuantity, Generic[Q]):
    """Through [time, value] points by the curve of least ∫ jerk² dt, at rest before and after.

    A value given twice in a row is held in between."""

    type: Literal["points"] = "points"
    points: Annotated[tuple[tuple[Time, Q], ...], Field(min_length=2, max_length=500)]
    """a list of [time, value], such as [[0 s, 0 mm], [1 s, 20 mm]], or the name of a CSV file
    beside the scenario with a line `time, value` for each, in SI"""

    @field_validator("points", mode="before")
    @classmethod
    def _from_file(cls, points: Any, info: ValidationInfo) -> Any:
        """Read points from a CSV file if its name is given; return other values as they are.

        Args:
            points: list of [time, value], or name of a file with such lines, in SI units.
            info: its context has `folder`, relative to which the name is resolved.
        """
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
        """Refuse times that do not increase, and neighbouring intervals of very different length.

        Intervals on both sides of a point without a stop may differ by a factor of 10 at most.

        Args:
            points: (time in s, value) of each point.
        """
        t, values = zip(*points, strict=True)
        for before, after in pairwise(t):
            if not after - before >= 1e-6:
                raise refuse(
                    f"times must increase, by 1 µs at least; {after:.9g} s is after {before:.9g} s"
                )
        for i in set(range(len(t))) - _stops(values):
            ratio = (t[i + 1] - t[i]) / (t[i] - t[i - 1])
            times = max(ratio, 1.0 / ratio)
            if times > 10.0 + 1e-9:
                raise refuse(
                    f"between the points before and after {t[i]:.9g} s the curve would swing far "
                    f"out: one is {times:.3g} times as far away as the other, 10 "
                    "at most; add points, or stop by giving a value twice"
                )
        return points

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative, exactly, at the time or times t (s)."""
        return least_jerk(self.points).at(t)


@lru_cache(maxsize=64)
def jerk_limited(
    points: tuple[float, ...], start: float, velocity: float, acceleration: float, jerk: float
) -> Polynomials:
    """Fastest motion with limited jerk that starts at rest and rests at each point in turn.

    Args:
        points: value at the start, then the values at which it rests.
        start: time of the start (s).
        velocity, acceleration, jerk: limits, in units of the points per s, s², s³.
    """
    from scipy.interpolate import PPoly

    knots = [start]
    columns = []
    last = points[0]
    for begin, end in pairwise(points):
        if (displacement := end - begin) == 0.0:
            continue
        state = (begin, 0.0, 0.0)
        sign = math.copysign(1.0, displacement)
        for duration, size in from_rest_to_rest(abs(displacement), velocity, acceleration, jerk):
            if knots[-1] + duration > knots[-1]:  # shorter phases vanish by rounding
                x, v, a = state
                columns.append((sign * size / 6.0, a / 2.0, v, x))
                knots.append(knots[-1] + duration)
                state = follow(((duration, sign * size),), duration, x, v, a)
        last = end
    if not columns:  # all points are equal
        knots = [start, start + 1.0]
        columns = [(0.0, 0.0, 0.0, last)]
    return Polynomials(PPoly(np.array(columns).T, knots), last)


@lru_cache(maxsize=64)
def least_jerk(points: tuple[tuple[float, float], ...]) -> Polynomials:
    """Curve of least ∫ jerk² dt through points, at rest at its ends and where a value is repeated.

    Between stops it is the quintic spline at rest at both: between points the sixth derivative
    vanishes, at points the third and fourth are continuous (Euler–Lagrange with free velocities
    and accelerations at the points).

    Args:
        points: (time in s, value) of each point, in order of time.
    """
    from scipy.interpolate import PPoly, make_interp_spline

    t, x = np.array(points).T
    unit = (t[-1] - t[0]) / (len(t) - 1)  # time unit in which the unknowns have similar sizes
    at_rest = [(1, 0.0), (2, 0.0)]
    pieces = []
    for begin, end in pairwise(sorted(_stops(x.tolist()))):
        between_stops = slice(begin, end + 1)
        spline = make_interp_spline(
            t[between_stops] / unit, x[between_stops], k=5, bc_type=(at_rest, at_rest)
        )
        pieces.append(PPoly.from_spline(spline).c[:, 5:-5])  # without empty intervals at the ends
    coefficients = np.hstack(pieces) / unit ** np.arange(5.0, -1.0, -1.0)[:, None]
    coefficients[-1] = x[:-1]  # the curve meets the points without rounding errors
    return Polynomials(PPoly(coefficients, t), float(x[-1]))


def _stops(values: Sequence[float]) -> set[int]:
    """Indices of the points at which a curve rests: both ends, and points with the same value.

    Args:
        values: values of the signal at the way points.
    """
    stops = {0, len(values) - 1}
    for i, (value, following) in enumerate(pairwise(values)):
        if value == following:
            stops |= {i, i + 1}
    return stops


class Signal(Protocol):
    """Function of time with two derivatives."""

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative at time t (s), or at many times (k,)."""
        ...


def product(f: Values, g: Values) -> Array:
    """Product of two functions of time and its derivatives (3, …), by the product rule.

    Args:
        f, g: value, first and second derivative of each function, numbers or (k,).
    """
    return np.array(
        (f[0] * g[0], f[1] * g[0] + f[0] * g[1], f[2] * g[0] + 2.0 * f[1] * g[1] + f[0] * g[2])
    )


class Constant(OfQuantity, Generic[Q]):
    """Constant signal."""

    type: Literal["constant"] = "constant"
    value: Q
    """the value, with its unit"""

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative (value, 0, 0) at any time t (s)."""
        return float(self.value), 0.0, 0.0


class Step(OfQuantity, Generic[Q]):
    """0 before `start`, `value` from `start` on; both derivatives are 0."""

    type: Literal["step"] = "step"
    value: Q
    """the value after the step, with its unit"""
    start: Time
    """the time of the step, such as 5 s"""

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative at the time or times t (s)."""
        return np.where(t >= self.start, float(self.value), 0.0)[()], 0.0, 0.0


class Sine(OfQuantity, Generic[Q]):
    """amplitude · sin(2π f (t − start) + phase) · E(t), E rising 0 → 1 over `ramp`."""

    type: Literal["sine"] = "sine"
    amplitude: Q
    """the amplitude, with its unit"""
    frequency: Positive[Frequency]
    """the frequency, such as 0.5 Hz"""
    phase: Angle = 0.0
    """at `start`"""
    start: Time = 0.0
    """when it begins"""
    ramp: NotNegative[Time] = 0.0
    """time in which the amplitude rises, minimum jerk"""

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative at the time or times t (s); 0 before start."""
        omega = 2.0 * math.pi * self.frequency
        angle = omega * (t - self.start) + self.phase
        s = self.amplitude * np.sin(angle)
        wave = s, omega * self.amplitude * np.cos(angle), -omega * omega * s
        return product(rise(t, self.start, self.ramp), wave)


class MinimumJerk(OfQuantity, Generic[Q]):
    """0 → value between start and start + duration by 10s³ − 15s⁴ + 6s⁵, then held."""

    type: Literal["minimum_jerk"] = "minimum_jerk"
    value: Q
    """the final value, with its unit"""
    start: Time = 0.0
    """when it begins"""
    duration: Positive[Time]
    """the time the rise takes, such as 0.3 s"""

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative, exactly, at the time or times t (s)."""
        value, first, second = rise(t, self.start, self.duration)
        return self.value * value, self.value * first, self.value * second


LengthSignal = Annotated[
    Constant[Length]
    | Step[Length]
    | Sine[Length]
    | MinimumJerk[Length]
    | JerkLimited[Length, Velocity, Acceleration, Jerk]
    | Points[Length],
    Field(discriminator="type"),
]
AngleSignal = Annotated[
    Constant[Angle]
    | Step[Angle]
    | Sine[Angle]
    | MinimumJerk[Angle]
    | JerkLimited[Angle, AngularVelocity, AngularAcceleration, AngularJerk]
    | Points[Angle],
    Field(discriminator="type"),
]
ForceSignal = Annotated[
    Constant[Force]
    | Step[Force]
    | Sine[Force]
    | MinimumJerk[Force]
    | JerkLimited[Force, ForceRate, ForceRate2, ForceRate3]
    | Points[Force],
    Field(discriminator="type"),
]


def total(signals: Iterable[Signal], t: Any) -> Array:
    """Sum of signals with first and second derivatives, (3,) at a time or (3, k) at times.

    Args:
        signals: signals of one quantity; none: zero.
        t: time, or times (k,) (s).
    """
    return np.array(sums(signals, t))


def sums(signals: Iterable[Signal], t: Any) -> Values:
    """Sums of the values, first and second derivatives of signals, as `total`, one by one.

    Args:
        signals: signals of one quantity; none: zero.
        t: time, or times (k,) (s).
    """
    zero = np.zeros(t.shape) if isinstance(t, np.ndarray) else 0.0
    value = first = second = zero
    for signal in signals:
        signal_value, signal_first, signal_second = signal.at(t)
        value = value + signal_value
        first = first + signal_first
        second = second + signal_second
    return value, first, second
