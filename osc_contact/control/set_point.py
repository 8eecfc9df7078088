"""Set points whose goals may change at any time: one state within the limits each period."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pinocchio import SE3

from osc_contact.errors import InvalidInputError
from osc_contact.interface import Reference, as_numbers
from osc_contact.jerk_limits import JerkLimits, Trajectory
from osc_contact.spatial import Array, as_array, as_pose, cross, skew


class SetPointState(NamedTuple):
    """State of a set point: value, velocity and acceleration, arrays of the shape of its start.

    Example:
        >>> x = osc.SetPoint([0.0, 0.0], osc.JerkLimits(1.0, 5.0, 50.0), dt=0.01)
        >>> value, velocity, acceleration = x.step([0.3, 0.0])
        >>> print(value.shape)
        (2,)
    """

    value: Array
    velocity: Array
    acceleration: Array


class SetPoint:
    """Set point of one or several coordinates, moved to goals that may change on the way.

    The coordinates arrive together, as fast as the limits of each of them permit. From rest the
    path is a straight line.

    Args:
        start: initial value, at rest: a number, or (n,).
        limits: limits of velocity, acceleration and jerk.
        dt: period of `step` (s).

    Raises:
        InvalidInputError: start, limits or dt are not finite, of wrong shape or out of range.

    Example:
        >>> limits = osc.JerkLimits(velocity=50.0, acceleration=500.0, jerk=1e4)  # N/s, …
        >>> force = osc.SetPoint(0.0, limits, dt=0.01)
        >>> way = [float(force.step(goal=10.0).value) for tick in range(40)]
        >>> print(f"{way[-1]:.3f} N, {force.remaining:.2f} s left")
        10.000 N, 0.00 s left
    """

    def __init__(self, start: ArrayLike, limits: JerkLimits, dt: float) -> None:
        """Begin at rest.

        Args:
            start: initial value, a number or (n,).
            limits: limits of each coordinate.
            dt: period (s).

        Raises:
            InvalidInputError: `start` is empty or not finite, or the period is not positive.
        """
        self._dt = _checked_period(dt)  #: period (s)
        numbers = np.asarray(as_numbers("start", start))
        if numbers.size == 0:
            raise InvalidInputError("start is empty; give a number, or one for each coordinate")
        self._shape = numbers.shape  #: shape of the values
        #: limits of velocity, acceleration and jerk of each number
        self._bounds = limits.each(numbers.size)
        self.reset(start)

    def reset(self, value: ArrayLike) -> None:
        """Set the state to rest at `value` (a number or (n,)), which is the goal, too."""
        #: trajectory from the last state to the goal
        self._trajectory = Trajectory.rest(self._flattened("start", value), self._bounds)

    def step(self, goal: ArrayLike | None = None) -> SetPointState:
        """Advance by one period on the way to the goal; return the new state.

        Args:
            goal: new goal, a number or (n,); None: the former goal.

        Raises:
            InvalidInputError: the goal is not finite or of the wrong shape; the former one is kept
                and no time passed.
        """
        if goal is not None:
            target = self._flattened("goal", goal)
            if not np.array_equal(target, self._trajectory.goal):
                self._trajectory = Trajectory(*self._trajectory.state, target, self._bounds)
        self._trajectory.advance(self._dt)
        return SetPointState(*(x.reshape(self._shape) for x in self._trajectory.state))

    @property
    def remaining(self) -> float:
        """Time until the set point rests at its goal (s); 0 at the goal."""
        return self._trajectory.remaining

    def _flattened(self, name: str, value: ArrayLike) -> Array:
        """Check a value or goal and flatten it to (n,).

        Raises:
            InvalidInputError: a number is not finite, or the shape is not that of the start; `name`
                is in the message.
        """
        return as_array(name, value, self._shape).reshape(-1)


class PoseSetPoint:
    """Set point of the object's pose, moved to goals that may change on the way, as references.

    The position moves like a `SetPoint` in world axes. The orientation is exp[w]× R_0, with R_0 the
    orientation when the goal last changed and w (3,) a set point in world axes; so each goal is
    reached by at most half a turn. Position and w arrive together. From rest, w is on a straight
    line, which is a turn about a fixed axis, and the angular limits of w are limits of ω. If the
    axis changes on the way, |ω| ≤ |ẇ| holds, and ω̇ differs from ẅ by terms of the order |ω|²|w|.

    Args:
        start: initial pose, at rest.
        linear: limits along each world axis (m/s, m/s², m/s³).
        angular: limits about each world axis (rad/s, rad/s², rad/s³).
        dt: period of `step` (s), the controller's.

    Raises:
        InvalidInputError: start, limits or dt are not finite, of wrong shape or out of range.

    Example:
        >>> limits = osc.JerkLimits(velocity=0.2, acceleration=1.0, jerk=20.0)
        >>> set_point = osc.PoseSetPoint(pin.SE3.Identity(), limits, limits, dt=1e-3)
        >>> goal = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
        >>> reference = set_point.step(goal, alpha_d=[5.0])
    """

    def __init__(self, start: SE3, linear: JerkLimits, angular: JerkLimits, dt: float) -> None:
        """Begin at rest.

        Args:
            start: initial pose.
            linear, angular: limits (m/s …, rad/s …).
            dt: period (s).

        Raises:
            InvalidInputError: the pose or the period is not valid.
        """
        self._dt = _checked_period(dt)  #: period (s)
        bounds = zip(linear.each(3), angular.each(3), strict=True)
        #: limits of velocity, acceleration and jerk of each coordinate
        self._bounds = tuple(position + rotation for position, rotation in bounds)
        self.reset(start)

    def reset(self, X: SE3) -> None:
        """Set the state to rest at the pose X, such as at the start or after a hold of the arm."""
        self._goal = _checked_pose("start", X)  #: pose at the end of the trajectory
        #: rotation at which the rotation vector of the trajectory is 0
        self._R_0: Array = self._goal.rotation
        #: trajectory of position (m) and rotation vector (rad)
        self._trajectory = Trajectory.rest(
            np.append(self._goal.translation, np.zeros(3)), self._bounds
        )

    def step(
        self,
        goal: SE3 | None = None,
        alpha_d: ArrayLike = (),
        squeeze_d: float | Array = 0.0,
    ) -> Reference:
        """Advance by one period on the way to the goal; return the new reference.

        Args:
            goal: new goal, a pose of the object; None: the former goal.
            alpha_d, squeeze_d: desired forces of the reference (N), see `Reference`. Without them
                alpha_d of the reference is empty and read-only.

        Raises:
            InvalidInputError: goal or forces are not finite, of the wrong shape, or no pose; the
                former goal is kept and no time passed.
        """
        forces = as_array("alpha_d", alpha_d, (None,))
        squeeze = as_numbers("squeeze_d", squeeze_d)
        if goal is not None and not (isinstance(goal, SE3) and goal == self._goal):
            self._plan_trajectory(_checked_pose("goal", goal))
        self._trajectory.advance(self._dt)
        x, v, a = self._trajectory.state
        R, omega, omega_dot = rotation_of(x[3:], v[3:], a[3:])
        return Reference(
            SE3(R @ self._R_0, x[:3]),
            np.concatenate((v[:3], omega)),
            np.concatenate((a[:3], omega_dot)),
            forces,
            squeeze,
        )

    def _plan_trajectory(self, goal: SE3) -> None:
        """Plan a trajectory from the present state to a new goal.

        The rotation vector w begins at zero again, where ẇ = ω and ẅ = ω̇.

        Args:
            goal: pose of the object.
        """
        # position and rotation vector with their derivatives; those of w become ω and ω̇
        x, v, a = self._trajectory.state
        R, v[3:], a[3:] = rotation_of(x[3:], v[3:], a[3:])
        # normalised, so that rounding errors do not accumulate over many goals
        base = pin.Quaternion(R @ self._R_0).normalized().toRotationMatrix()
        x[3:] = 0.0
        w = pin.log3(goal.rotation @ base.T)
        trajectory = Trajectory(x, v, a, np.append(goal.translation, w), self._bounds)
        self._goal = goal
        self._R_0 = base
        self._trajectory = trajectory

    @property
    def remaining(self) -> float:
        """Time until the set point rests at its goal (s); 0 at the goal."""
        return self._trajectory.remaining


def _checked_period(dt: float) -> float:
    """Check the period dt (s) of a set point.

    Raises:
        InvalidInputError: it is not finite or not positive.
    """
    period = float(as_array("dt", dt, ()))
    if period <= 0.0:
        raise InvalidInputError(f"dt = {period:g}; give the period of step in seconds, > 0")
    return period


def _checked_pose(name: str, X: SE3) -> SE3:
    """Check the pose of a start or goal; return it as a new `pin.SE3`.

    Raises:
        InvalidInputError: X is no `pin.SE3`, a number is not finite, or its 3×3 part is not a
            rotation matrix; `name` is in the message.
    """
    if not isinstance(X, SE3):
        raise InvalidInputError(f"{name}: expected a pin.SE3, got {type(X).__name__}")
    return as_pose(name, X.translation, X.rotation)


def rotation_of(w: Array, w_dot: Array, w_ddot: Array) -> tuple[Array, Array, Array]:
    """Compute R (3, 3), ω and ω̇ (3,) in world axes of the rotation exp[w]× with moving w (3,).

    ω = A ẇ with A = a + b [w]× + c w wᵀ, a = sin θ/θ, b = (1 − cos θ)/θ², c = (θ − sin θ)/θ³;
    ω̇ = A ẅ + Ȧ ẇ.

    Args:
        w, w_dot, w_ddot: (3,) rotation vector and derivatives (rad, rad/s, rad/s²).
    """
    square = float(w @ w)
    a, b, c, a1, b1, c1 = _functions_of_angle(square)
    projection = float(w @ w_dot)
    normal = cross(w, w_dot)
    omega = a * w_dot + b * normal + (c * projection) * w
    # ȧ = a₁ wᵀẇ, …
    rate = a1 * projection * w_dot + b1 * projection * normal + (c1 * projection**2) * w
    turning = c * (projection * w_dot + float(w_dot @ w_dot) * w)
    omega_dot = a * w_ddot + b * cross(w, w_ddot) + (c * float(w @ w_ddot)) * w + rate + turning
    W = skew(w)
    return np.eye(3) + a * W + b * (W @ W), omega, omega_dot


_EVEN = np.arange(8)  #: k, exponents of θ² in the series
#: (3, 8) coefficients of (θ²)ᵏ in a, b, c of `rotation_of`: (−1)ᵏ/(2k + 1)!, /(2k + 2)!, /(2k + 3)!
_SERIES = np.array(
    [[(-1) ** k / math.factorial(2 * k + first) for k in range(8)] for first in (1, 2, 3)]
)
#: (3, 7) coefficients of (θ²)ᵏ in the derivatives of a, b, c by θ, divided by θ.
_SLOPES = _SERIES[:, 1:] * 2 * _EVEN[1:]


def _functions_of_angle(square: float) -> tuple[float, ...]:
    """Compute a, b, c of `rotation_of` and (da/dθ)/θ, (db/dθ)/θ, (dc/dθ)/θ.

    Below θ² = 0.1 they are summed as series, since the closed forms cancel.

    Args:
        square: θ², squared angle of the rotation (rad²).
    """
    if square < 0.1:
        powers = square**_EVEN
        return *(_SERIES @ powers).tolist(), *(_SLOPES @ powers[:-1]).tolist()
    angle = math.sqrt(square)
    a = math.sin(angle) / angle
    b = (1.0 - math.cos(angle)) / square
    c = (1.0 - a) / square
    return a, b, c, (math.cos(angle) - a) / square, (a - 2 * b) / square, (b - 3 * c) / square
