"""Joint positions and velocities from encoders of known errors, with checks of every reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.interface import Measurement, with_readings
from osc_contact.sensing.dead_encoders import DeadEncoders
from osc_contact.sensing.dead_packets import DeadPackets
from osc_contact.sensing.reading_noise import ReadingNoise
from osc_contact.sensing.velocity_estimate import VelocityEstimate
from osc_contact.spatial import Array

_FAR = 8.0  #: multiple of its standard deviation that noise does not reach
_QUIET_JUMP = 0.02  #: jump of an encoder's reading that counts as plausible without motion (rad, m)
_PAUSE = 1.5  #: multiple of the period of the readings from which on one was missing


@dataclass(frozen=True)
class Encoders:
    """Encoders of n joints, and what is known of the motion of these.

    Attributes:
        noise: (n,) standard deviation of the readings (rad, m).
        resolution: (n,) step of the readings (rad, m).
        unknown: (n,) rms unmodelled acceleration of the joints (rad/s², m/s²).
        sample: period of the readings (s).
        delay: age of a reading when it arrives (s).
    """

    noise: Array
    resolution: Array
    unknown: Array
    sample: float
    delay: float = 0.0

    @property
    def error(self) -> Array:
        """Rms error (n,) of a reading (rad, m): noise, and resolution uniformly distributed."""
        return np.maximum(np.hypot(self.noise, self.resolution / np.sqrt(12.0)), 1e-9)

    def estimate(self, dt: float, learning: bool = False) -> VelocityEstimate:
        """Make the estimator of the joint velocities.

        Args:
            dt: control period (s).
            learning: whether it estimates lasting unknown accelerations, too.
        """
        make = VelocityEstimate.learning if learning else VelocityEstimate.optimal
        return make(self.error, self.unknown, dt, self.sample)


def speed_limits(chain: ClosedChain) -> Array:
    """Speed limits (n,) of the joints (rad/s, m/s); inf: the model has none.

    Args:
        chain: model of the arms.
    """
    limit = chain.model.velocityLimit
    return np.where(limit > 0.0, limit, np.inf)


class JointReadings:
    """Joint positions and velocities for a controller, from encoders alone.

    Velocities are estimated. Positions are extrapolated over the encoders' delay. Readings that are
    implausible, and those of dead encoders or packets, become NaN. Velocities from encoders that
    are far noisier than expected are estimated with the gains for their measured noise, or with
    those with which a stopped arm can still be held; the controller stops then.

    A reading farther from the estimate than the joint can move, from which the next one continues
    as the joint moved before, was displaced: the velocity that it seemed to show is taken back.
    """

    def __init__(
        self,
        encoders: Encoders,
        largest_speed: Array,
        hold_rate: float,
        dt: float,
        learning: bool = False,
    ) -> None:
        """Begin without a reading.

        Args:
            encoders: encoders with their errors.
            largest_speed: (n,) speed above which a reading is not believed (rad/s, m/s); inf: none.
            hold_rate: rate with which a stopped arm is held (1/s).
            dt: control period (s).
            learning: whether lasting unknown accelerations are estimated, too.
        """
        n = len(encoders.error)
        self._delay = encoders.delay  #: delay of the encoders (s)
        #: (n,) largest plausible change of a reading in a period (rad, m)
        self._largest_change = largest_speed * max(dt, encoders.sample)
        self._last_plausible = np.full(n, np.nan)  #: (n,) last plausible readings (rad, m)
        self._implausible_ticks = np.zeros(n)  #: (n,) periods since these readings
        #: (n,) whether the last readings were farther from the estimate than joints can move
        self._far = np.zeros(n, dtype=bool)
        self._onward = np.zeros(n)  #: (n,) positions that are expected after these (rad, m)
        #: (n,) largest change of a reading by noise and acceleration alone (rad, m)
        self._slight = _FAR * (encoders.error + encoders.unknown * encoders.sample**2)
        self._period = max(dt, encoders.sample)  #: period of the readings (s)
        #: estimate of the joint velocities
        self._estimate = encoders.estimate(dt, learning)
        #: largest noise whose estimate is as fast as the hold of a stopped arm: √(σ_a/σ_n) = ω
        self._largest_noise = np.maximum(encoders.unknown / hold_rate**2, encoders.error)
        #: measured noise of the encoders
        self._noise_measure = ReadingNoise(encoders.error, encoders.sample)
        #: detection of encoders without noise
        self._dead_encoders = DeadEncoders(encoders.noise, encoders.resolution)
        #: detection of packets that repeat themselves after a stop
        self._dead_packets = DeadPackets(encoders.sample)
        self._is_dead = False  #: whether the last packet was dead
        self._stamp = -1.0  #: time at which encoders were sampled last (s)

    def complete(
        self,
        measurement: Measurement,
        acceleration: Array | float = 0.0,
        released_for: float = 0.0,
    ) -> Measurement:
        """Measurement with estimated velocities and checked positions.

        It is the measurement itself until the encoders of all joints have had a plausible reading.

        Args:
            measurement: measurement with the readings of the encoders and time stamps.
            acceleration: (n,) known acceleration over the period that ends now (rad/s², m/s²); it
                must not be changed later.
            released_for: `Controller.released_for` of the controller (s).
        """
        assert measurement.stamps is not None
        implausible = self._implausible(measurement.q)
        if implausible.any() and self._estimate.x is None:  # the estimate has not begun
            return measurement
        interval = measurement.stamps.encoders - self._stamp
        fresh = interval > 0.0
        self._stamp = measurement.stamps.encoders
        q = np.where(implausible, np.nan, measurement.q)
        dead = self._dead_encoders.update(measurement.q, fresh)
        if fresh:
            self._is_dead = self._dead_packets.update(measurement.q, released_for)
            self._expect_noise(q)
            self._take_back_jumps(q, interval)
        dead = dead | self._is_dead
        q, v = self._estimate.update(np.where(dead, np.nan, q), acceleration, fresh)
        q = np.where(implausible | dead, np.nan, q + self._delay * v)
        v = np.where(dead, np.nan, v)  # only predicted
        noisy = self._noise_measure.is_loud
        return with_readings(measurement, q=q, v=v, estimated=True, noisy=noisy)

    def _implausible(self, q: Array) -> NDArray[np.bool_]:
        """Mask (n,) of readings that are not finite or changed faster than the joint can move.

        A plausible reading becomes the one that later readings are compared with.

        Args:
            q: (n,) readings of the encoders (rad, m).
        """
        largest_change = _QUIET_JUMP + self._largest_change * (1.0 + self._implausible_ticks)
        implausible = ~np.isfinite(q) | (np.abs(q - self._last_plausible) > largest_change)
        self._implausible_ticks = np.where(implausible, self._implausible_ticks + 1.0, 0.0)
        self._last_plausible = np.where(implausible, self._last_plausible, q)
        return implausible

    def _take_back_jumps(self, q: Array, interval: float) -> None:
        """Repeat the last update by readings if they had jumped, which these show; note new jumps.

        Args:
            q: (n,) new readings (rad, m); NaN: implausible.
            interval: time since the readings before (s): after a pause nothing is found.
        """
        jumped = self._far & (np.abs(q - self._onward) < self._slight)
        is_regular = interval < _PAUSE * self._period
        if is_regular and jumped.any() and not self._noise_measure.is_loud:
            self._estimate.repeat_last(jumped)
        if self._estimate.x is not None:
            self._far = np.abs(q - self._estimate.x) > self._largest_change + self._slight
            self._onward = q + self._period * self._estimate.v

    def _expect_noise(self, q: Array) -> None:
        """Change the gains of the estimated velocities while encoders are noisier than expected.

        When this is found of an encoder, its last readings were noisy, too. Estimates are not
        slower than the hold of a stopped arm, which would oscillate.

        Args:
            q: (n,) new readings (rad, m); NaN: implausible.
        """
        was_loud = self._noise_measure.is_loud
        noise = self._noise_measure.update(q)
        if was_loud or self._noise_measure.is_loud:
            self._estimate.expect_noise(
                np.minimum(noise, self._largest_noise), revises=self._noise_measure.begins
            )
