"""Commands over time: each signal gives its value and its first two time derivatives."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, Generic, Literal, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import Field

from osc_contact.scenarios.polynomials import JerkLimited, Points, Values
from osc_contact.scenarios.quantities import (
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
    OfQuantity,
    Time,
    Velocity,
)

__all__ = [
    "AngleSignal",
    "Constant",
    "ForceSignal",
    "JerkLimited",
    "LengthSignal",
    "MinimumJerk",
    "Points",
    "Signal",
    "Sine",
    "Step",
    "Values",
    "total",
    "total_over",
    "rise",
]

Array = npt.NDArray[np.float64]
Q = TypeVar("Q", bound=float)


class Signal(Protocol):
    """Anything that can be evaluated at a time."""

    def at(self, t: Any) -> Values:
        """Return value, first and second derivative at time `t` (s), or at many times (k,)."""
        ...


def rise(t: Any, start: float, duration: float) -> Values:
    """The minimum-jerk rise 10s³ − 15s⁴ + 6s⁵ from 0 to 1, s = (t − start)/duration.

    A rise of zero duration is a step whose derivatives are zero.

    Args:
        t: s, or many times (k,). start, duration: s.

    Returns:
        The value, its first (1/s) and its second derivative (1/s²).
    """
    if isinstance(t, np.ndarray):
        s = np.where(t >= start + duration, 1.0, np.maximum(t - start, 0.0) / (duration or 1.0))
    elif t < start:
        return 0.0, 0.0, 0.0
    elif t >= start + duration:
        return 1.0, 0.0, 0.0
    else:
        s = (t - start) / duration
    duration = duration or 1.0  # s is 0 or 1 then
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s * s),
        30.0 * s * s * (1.0 - s) ** 2 / duration,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2,
    )


class Constant(OfQuantity[Q], Generic[Q]):
    """The same value at all times."""

    type: Literal["constant"] = "constant"
    value: Q
    """the value, with its unit"""

    def at(self, t: Any) -> Values:
        """Return (value, 0, 0)."""
        return float(self.value), 0.0, 0.0


class Step(OfQuantity[Q], Generic[Q]):
    """0 before `start`, `value` from `start` on; both derivatives are 0."""

    type: Literal["step"] = "step"
    value: Q
    """the value after the step, with its unit"""
    start: Time
    """the time of the step, such as 5 s"""

    def at(self, t: Any) -> Values:
        """Return (0 or value, 0, 0)."""
        return (t >= self.start) * float(self.value), 0.0, 0.0


class Sine(OfQuantity[Q], Generic[Q]):
    """amplitude · sin(2π f (t − start) + phase) · E(t), E rising 0 → 1 over `ramp`."""

    type: Literal["sine"] = "sine"
    amplitude: Q
    """the amplitude, with its unit"""
    frequency: Annotated[Frequency, Field(gt=0)]
    """the frequency, such as 0.5 Hz"""
    phase: Angle = 0.0
    """at `start`"""
    start: Time = 0.0
    """when it begins"""
    ramp: Annotated[Time, Field(ge=0)] = 0.0
    """time in which the amplitude rises, minimum jerk"""

    def at(self, t: Any) -> Values:
        """Return the enveloped sine and its exact derivatives (product rule); 0 before start."""
        e, e_dot, e_ddot = rise(t, self.start, self.ramp)
        omega = 2.0 * math.pi * self.frequency
        a = float(self.amplitude)
        angle = omega * (t - self.start) + self.phase
        s = np.sin(angle)
        s_dot = omega * np.cos(angle)
        s_ddot = -omega * omega * s
        return (
            a * s * e,
            a * (s_dot * e + s * e_dot),
            a * (s_ddot * e + 2.0 * s_dot * e_dot + s * e_ddot),
        )


class MinimumJerk(OfQuantity[Q], Generic[Q]):
    """0 → value between start and start + duration by 10s³ − 15s⁴ + 6s⁵, then held."""

    type: Literal["minimum_jerk"] = "minimum_jerk"
    value: Q
    """the final value, with its unit"""
    start: Time = 0.0
    """when it begins"""
    duration: Annotated[Time, Field(gt=0)]
    """the time the rise takes, such as 0.3 s"""

    def at(self, t: Any) -> Values:
        """Return value times the rise and its exact derivatives."""
        value = float(self.value)
        (e, e_dot, e_ddot) = rise(t, self.start, self.duration)
        return value * e, value * e_dot, value * e_ddot


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


def total(signals: Iterable[Signal], t: float) -> Values:
    """Return the sum of the signals' values and derivatives at time `t` (s); none: zeros."""
    value = rate = acceleration = 0.0
    for signal in signals:
        x, x_dot, x_ddot = signal.at(t)
        value = value + x
        rate = rate + x_dot
        acceleration = acceleration + x_ddot
    return value, rate, acceleration


def total_over(signals: Iterable[Signal], t: Array) -> Array:
    """Return (3, k) the same sums at many times `t` (k,)."""
    total = np.zeros((3, len(t)))
    for signal in signals:
        for row, x in zip(total, signal.at(t), strict=True):
            row += x
    return total
