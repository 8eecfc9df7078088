"""Poses of the touched bodies in the robots' frame, from delayed pictures of bodies and robots.

A camera measures the touched bodies, the held object and the arms in its own frame, which differs
from the robots' frame by some millimetres and milliradians, the errors of calibration of cameras
and bases. For contact, only motion relative to the robots matters. The encoders give the poses of
object and arms at the time of the picture; a Kalman filter estimates the constant displacement
between both, which is applied to the bodies. Errors of camera and bases cancel.
"""
# A `VisionFusion` has `_known`, function of the joint positions that returns poses of object and
# tips; `_delay`, time from a picture to its arrival (s); `_markers`, poses of the markers in the
# bodies (None: the bodies' frames); `_channels`, function that makes an estimate of six channels;
# `_bodies`, estimates of the bodies, empty before the first picture; `_stamp`, time of the last
# picture (s).
# A `History` has `_samples`, times (s) and values (n,), the oldest first.

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pinocchio as pin
from pinocchio import SE3

from osc_contact.errors import InvalidInputError
from osc_contact.interface import Seen, Touched
from osc_contact.sensing.velocity_estimate import VelocityEstimate
from osc_contact.spatial import Array, carry_twist, pose_error, skew

_UPDATE_ITERATIONS = 4  #: iterations of an update, which is nonlinear in large rotations


class History:
    """Recent values of a signal, to be interpolated."""

    def __init__(self, span: float) -> None:
        """Make an empty history.

        Args:
            span: time for which values are kept (s).
        """
        self.span = span
        #: times (s) and values, the oldest first
        self._samples: deque[tuple[float, Array]] = deque()

    @property
    def is_empty(self) -> bool:
        """Whether no value has been added."""
        return not self._samples

    def add(self, t: float, x: Array) -> None:
        """Append the value x (n,) at the time t (s), which is later than all before.

        Values older than the span are dropped, except the last of these, for interpolation.
        """
        self._samples.append((t, np.array(x, dtype=float)))
        while len(self._samples) > 2 and self._samples[1][0] <= t - self.span:
            self._samples.popleft()

    def at(self, t: float) -> Array:
        """Value (n,) at the time t (s), interpolated; before and after all values, the nearest one.

        Raises:
            InvalidInputError: the history is empty.
        """
        if self.is_empty:
            raise InvalidInputError("the history is empty; add a value before asking for one")
        times, values = zip(*self._samples, strict=True)
        return np.array([np.interp(t, times, x) for x in np.transpose(values)])


@dataclass
class Registration:
    """Estimate of X_WC, the camera's frame in the robots' frame, from bodies known in both.

    It is a Kalman filter for ξ = [δ; θ], the displacement (world axes, at the world's origin) by
    which X_WC has to be corrected: a body that the camera measures at (p̃, R̃) is at
    p = p̂ + δ + θ × p̂, R = exp(θ) R̂ with p̂ = X_WC p̃, R̂ = R_WC R̃.

    Attributes:
        position, orientation: standard deviations of a pose measured by the camera (m, rad).
        prior: standard deviations of the displacement before the first picture (m, rad).
        drift: growth of the displacement's standard deviations (m/√s, rad/√s), by which older
            pictures lose weight.
        X: X_WC.
        P: (6, 6) covariance of ξ.

    Raises:
        InvalidInputError: a standard deviation that is not > 0 (drift: ≥ 0).
    """

    position: float
    orientation: float
    prior: tuple[float, float] = (0.02, 0.05)
    drift: tuple[float, float] = (2e-5, 2e-5)
    X: SE3 = field(default_factory=SE3.Identity)

    def __post_init__(self) -> None:
        """Set the covariance to the prior's.

        Raises:
            InvalidInputError: noise or prior not positive, or drift negative.
        """
        sizes = (self.position, self.orientation, *self.prior)
        if not (min(sizes) > 0.0 and min(self.drift) >= 0.0 and np.isfinite(sizes).all()):
            raise InvalidInputError(
                f"registration: noise {self.position} m, {self.orientation} rad, prior "
                f"{self.prior}, drift {self.drift}; give numbers > 0 (drift ≥ 0)"
            )
        self.P = np.diag(np.repeat(self.prior, 3)) ** 2

    def update(self, known: Sequence[SE3], seen: Sequence[SE3], elapsed: float = 0.0) -> SE3:
        """Correct X_WC by a picture and return it; the covariance P is updated, too.

        Args:
            known: poses of bodies in the robots' frame at the time of the picture.
            seen: poses of these bodies in the camera's frame.
            elapsed: time since the last picture (s).
        """
        prior = np.linalg.inv(self.P + elapsed * np.diag(np.repeat(self.drift, 3)) ** 2)
        weights = np.repeat((self.position, self.orientation), 3) ** -2.0
        start = self.X
        for _ in range(
            _UPDATE_ITERATIONS
        ):  # information form, which is regular with exact poses, too
            # prior: X_WC as before the picture
            information = prior.copy()
            correction = pose_error(self.X * start.inverse(), SE3.Identity())
            gradient = -prior @ correction
            # each body: pose error y ≈ H ξ
            for X_W, X_C in zip(known, seen, strict=True):
                predicted = self.X * X_C
                y = pose_error(X_W, predicted)
                H = np.eye(6)
                H[:3, 3:] = -skew(predicted.translation)
                information += H.T @ (weights[:, None] * H)
                gradient += H.T @ (weights * y)
            xi = np.linalg.solve(information, gradient)
            self.X = SE3(pin.exp3(xi[3:]), xi[:3]) * self.X
        self.P = np.linalg.inv(information)
        return self.X


@dataclass
class BodyEstimate:
    """Estimate of the pose and twist of a tracked body.

    Attributes:
        channels: estimate of position and rotation vector, six channels.
        start: pose at the origin with the body's first orientation, from which it is measured.
    """

    channels: VelocityEstimate
    start: SE3

    def update(self, X: SE3, fresh: bool, delay: float) -> tuple[SE3, Array]:
        """Estimate the present pose and twist of the body from a delayed measurement.

        Args:
            X: measured pose, in the camera's frame.
            fresh: False if the measurement was used before.
            delay: age of the measurement (s).

        Returns:
            Pose, and twist (6,) at its origin (m/s, rad/s), in the camera's frame.
        """
        x, rate = self.channels.update(pose_error(X, self.start), fresh=fresh)
        x = x + delay * rate
        pose = SE3(pin.exp3(x[3:]) @ self.start.rotation, x[:3])
        return (pose, np.concatenate((rate[:3], pin.Jexp3(-x[3:]) @ rate[3:])))


class VisionFusion:
    """Estimate of present poses and twists of the touched bodies in the robots' frame.

    Attributes:
        registration: estimate of the camera's frame.
        history: recent joint positions.
    """

    def __init__(
        self,
        known: Callable[[Array], Sequence[SE3]],
        registration: Registration,
        acceleration: tuple[float, float],
        *,
        dt: float,
        period: float,
        delay: float,
        markers: Array | None = None,
    ) -> None:
        """Prepare the estimates.

        Args:
            known: function of the joint positions (n,) that returns the poses of the object and of
                the arms' tips.
            registration: estimate of the camera's frame, with the noise of the camera.
            acceleration: rms of the bodies' unknown accelerations (m/s², rad/s²).
            dt: period of `update` (s).
            period: period of the pictures (s).
            delay: time from a picture to its arrival (s).
            markers: (contacts, 4, 4) pose of the marker of each body in E; None: E itself.
        """
        self.registration = registration
        self.history = History(2.0 * (delay + period))
        #: function that returns the poses of object and tips at joint positions
        self._known = known
        self._delay = delay  #: time from a picture to its arrival (s)
        #: pose of the marker of each body in its frame; None: the frame itself
        self._markers = None if markers is None else [SE3(np.array(X)) for X in markers]
        noise = np.repeat((registration.position, registration.orientation), 3)
        #: function that makes the filter of a body
        self._channels = partial(
            VelocityEstimate.optimal, noise, np.repeat(acceleration, 3), dt, period
        )
        self._bodies: list[BodyEstimate] = []  #: estimate of each body
        #: time of the last picture (s); None before the first one
        self._stamp: float | None = None

    def update(
        self, now: float, q: Array, stamp: float, seen: Seen | None, touched: Touched
    ) -> Touched:
        """Estimate the present motion of the touched bodies in the robots' frame.

        Args:
            now: present time (s).
            q: (n,) present joint positions (rad, m); not finite: not read, and left out.
            stamp: time of the last picture (s).
            seen: object and tips in the picture; None: the camera's frame is the robots' frame.
            touched: bodies in the picture, in the camera's frame; `A_E` is passed on.
        """
        if np.isfinite(q).all():
            self.history.add(now, q)
        fresh = self._stamp is None or stamp > self._stamp
        if fresh:
            elapsed = 0.0 if self._stamp is None else stamp - self._stamp
            self._stamp = stamp
            if seen is not None and not self.history.is_empty:
                poses = [SE3(np.array(X)) for X in (seen.object, *seen.tips)]
                self.registration.update(self._known(self.history.at(stamp)), poses, elapsed)
        frames = [SE3(np.array(X)) for X in touched.X_WE]
        markers = self._markers or [SE3.Identity()] * len(frames)
        if not self._bodies:
            self._bodies = [
                BodyEstimate(self._channels(), SE3((X * M).rotation, np.zeros(3)))
                for X, M in zip(frames, markers, strict=True)
            ]
        X_WC = self.registration.X
        X_WE = []
        V_E = []
        for body, X_CE, M in zip(self._bodies, frames, markers, strict=True):
            X_CM, V_C = body.update(X_CE * M, fresh, self._delay)  # filtered at the marker
            X_WM = X_WC * X_CM
            X = X_WM * M.inverse()
            V_W = (X_WC.rotation @ V_C.reshape(2, 3, 1)).ravel()
            X_WE.append(X.homogeneous)
            V_E.append(carry_twist(V_W, X_WM.translation, X.translation))
        return Touched(np.array(X_WE), np.array(V_E), touched.A_E)
