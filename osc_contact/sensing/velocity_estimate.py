"""Velocities from positions: a steady-state Kalman filter for each channel (α-β filter).

Each channel is a double integrator driven by a known acceleration and an unknown one,
white in continuous time, seen through white noise. Its stationary Kalman gains have a closed form
in the tracking index λ = σ_a dt²/σ_n (Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with
Applications to Tracking and Navigation, 2001):

    u = 1/3 + √(1/12 + 4/λ²),    β = 12/(6(u + √u) + 1),    α = β √u

The better the sensor, the larger λ, and the gains end at α = 1, β = 3 − √3, poles at 0 and √3 − 2:
stable, and no worse than the difference of two readings. An acceleration that is constant over the
sample (P. R. Kalata, The tracking index, 1984) has nearly the same gains while λ ≪ 1, but ends at
β = 2 with a pole at −1: it assumes that two exact positions and the last velocity give the next
one, so that errors of velocity alternate for ever.

A filtered difference would lag by its time constant; with the commanded acceleration, this one
does not lag along the command.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array


@dataclass
class VelocityEstimate:
    """Positions and velocities of several channels from sampled positions.

    Attributes:
        alpha, beta: (k,) gains of position and of velocity.
        dt: period of `update` (s). sample: period of the sensor (s), which the gains are for.
        x, v: (k,) last estimate; x None: there was none.
    """

    alpha: Array
    beta: Array
    dt: float
    sample: float = 0.0  #: 0: the same

    def __post_init__(self) -> None:
        self.alpha = np.atleast_1d(self.alpha)
        self.beta = np.atleast_1d(self.beta)
        stable = (self.alpha > 0) & (self.beta > 0) & (2 * self.alpha + self.beta < 4)
        self.sample = self.sample or self.dt
        if not stable.all() or not self.dt > 0.0 or not self.sample > 0.0:
            raise InvalidInputError(
                f"velocity estimate: α = {self.alpha}, β = {self.beta}, dt = {self.dt}; a stable "
                "filter has α > 0, β > 0, 2α + β < 4, dt > 0"
            )
        self.x: Array | None = None
        self.v = np.zeros(len(self.alpha))

    @classmethod
    def optimal(
        cls, noise: Array, acceleration: Array, dt: float, sample: float = 0.0
    ) -> VelocityEstimate:
        """Least mean square error under noise (k,) and unknown acceleration (k,), both rms.

        The unknown acceleration changes the velocity by its rms times the period from sample to
        sample.

        Args:
            noise: (k,) rms of the readings (m, rad). acceleration: (k,) rms (m/s², rad/s²).
            dt: period of the estimate (s). sample: period of the readings (s); 0: dt.

        Raises:
            InvalidInputError: one of them is not > 0.
        """
        noise = np.atleast_1d(noise)
        acceleration = np.atleast_1d(acceleration)
        if not (noise.min() > 0.0 and acceleration.min() > 0.0):
            raise InvalidInputError(
                f"velocity estimate: noise {noise} and unknown acceleration {acceleration} must "
                "both be > 0; without noise take the resolution of the sensor"
            )
        index = acceleration * (sample or dt) ** 2 / noise
        u = 1.0 / 3.0 + np.sqrt(1.0 / 12.0 + 4.0 / index**2)
        beta = 12.0 / (6.0 * (u + np.sqrt(u)) + 1.0)
        return cls(beta * np.sqrt(u), beta, dt, sample)

    @classmethod
    def with_bandwidth(cls, bandwidth: Array, dt: float) -> VelocityEstimate:
        """Critically damped: both poles at exp(−bandwidth · dt), bandwidth (k,) in rad/s."""
        pole = np.exp(-np.atleast_1d(bandwidth) * dt)
        return cls(1.0 - pole**2, (1.0 - pole) ** 2, dt)

    def update(
        self, x: Array, acceleration: Array | float = 0.0, fresh: bool = True
    ) -> tuple[Array, Array]:
        """(x̂, v̂), each (k,), after one period and one reading.

        Args:
            x: (k,) positions read; channels that are not finite are predicted only.
            acceleration: (k,) known over the period that ends now.
            fresh: False when the reading is an old one (slower sensor, lost sample): the state is
                only predicted.
        """
        if self.x is None:
            self.x = np.array(x, dtype=float)
            return (self.x, self.v)
        self.x = self.x + self.dt * self.v + 0.5 * self.dt**2 * acceleration
        self.v = self.v + self.dt * acceleration
        if fresh:
            innovation = np.where(np.isfinite(x), x - self.x, 0.0)
            self.x = self.x + self.alpha * innovation
            self.v = self.v + self.beta / self.sample * innovation
        return (self.x, self.v)
