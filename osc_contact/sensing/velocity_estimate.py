"""Velocities from positions: a steady-state Kalman filter for each channel (α-β filter).

Each channel is a double integrator driven by a known acceleration and an unknown one, which is
white noise in continuous time; positions are measured with white noise. The stationary Kalman gains
have a closed form in the tracking index λ = σ_a dt²/σ_n (Y. Bar-Shalom, X. R. Li, T. Kirubarajan,
Estimation with Applications to Tracking and Navigation, 2001):

    u = 1/3 + √(1/12 + 4/λ²),    β = 12/(6(u + √u) + 1),    α = β √u

For ever better sensors, λ → ∞, the gains tend to α = 1, β = 3 − √3 with poles at 0 and √3 − 2: the
filter is stable, and no worse than the difference of two readings. The model with an acceleration
that is constant between samples (P. R. Kalata, The tracking index, 1984) has nearly equal gains for
λ ≪ 1, but tends to β = 2 with a pole at −1: it computes the next velocity from two exact positions
and the last velocity, so that errors of velocity alternate and do not decay.

A filtered difference lags by its time constant; this filter uses the commanded acceleration and
does not lag behind commanded motions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

_SURPRISE = 6.0  #: times the rms of innovations
_MISLED = 0.1  #: s for which a known acceleration must lead ahead; pushes are over sooner
_EQUAL_NOISE = (8.0**-0.5 / 1.75) ** (1.0 / 3.0)  #: w/ω_e, see `VelocityEstimate.learning`


@dataclass
class VelocityEstimate:
    """Positions and velocities of several channels from sampled positions.

    Attributes:
        alpha, beta: (k,) gains of position and of velocity, for the period `sample`.
        dt: period of `update` (s).
        sample: period of the sensor (s); 0: dt.
        usual: (k,) largest innovations caused by noise (m, rad). A known acceleration that leads
            further ahead of the readings for 0.1 s is wrong by far more than σ_a, for example
            because friction holds the joint. It is not used until the readings lead as far for as
            long.
        x, v: (k,) last estimate (m, rad; m/s, rad/s); x is None before the first update.
    """

    alpha: Array
    beta: Array
    dt: float
    sample: float = 0.0
    gamma: Array | float = 0.0
    usual: Array | float = np.inf

    def __post_init__(self) -> None:
        self.alpha = np.atleast_1d(self.alpha)
        self.beta = np.atleast_1d(self.beta)
        self.gamma = np.zeros(len(self.alpha)) + self.gamma
        stable = (self.alpha > 0) & (self.beta > 0) & (2 * self.alpha + self.beta < 4)
        self.sample = self.sample or self.dt
        if not stable.all() or not self.dt > 0.0 or not self.sample > 0.0:
            raise InvalidInputError(
                f"velocity estimate: α = {self.alpha}, β = {self.beta}, dt = {self.dt}; a stable "
                "filter has α > 0, β > 0, 2α + β < 4, dt > 0"
            )
        self.x: Array | None = None
        self.v = np.zeros(len(self.alpha))
        self.unknown = np.zeros(len(self.alpha))
        self._misled = np.zeros(len(self.alpha), dtype=bool)
        self._ahead = np.zeros(len(self.alpha))  #: s; < 0: the readings lead

    @classmethod
    def optimal(
        cls, noise: Array, acceleration: Array, dt: float, sample: float = 0.0
    ) -> VelocityEstimate:
        """Estimate of least mean square error.

        Args:
            noise: (k,) rms noise of the readings (m, rad).
            acceleration: (k,) rms of the unknown acceleration (m/s², rad/s²); from sample to sample
                it changes the velocity by its rms times the period.
            dt: period of the estimate (s).
            sample: period of the readings (s); 0: dt.

        Raises:
            InvalidInputError: noise or acceleration is not > 0.
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
        alpha = beta * np.sqrt(u)
        return cls(alpha, beta, dt, sample, usual=_usual(noise, alpha))

    @classmethod
    def learning(
        cls, noise: Array, acceleration: Array, dt: float, sample: float = 0.0
    ) -> VelocityEstimate:
        """Estimate with the noise of `optimal` in v̂ that also learns lasting unknown accelerations.

        Three equal poles at exp(−w dt). On continuous white noise of density σ_n² dt, v̂ has the
        variance 1.75 w³ σ_n² dt, that of `optimal` ω_e³ σ_n² dt/√8, ω_e² = σ_a/σ_n: w = 0.587 ω_e
        (E. Brookner, Tracking and Kalman filtering made easy, 1998: fading-memory filter).

        Args:
            noise, acceleration, dt, sample: as of `optimal`.

        Raises:
            InvalidInputError: likewise.
        """
        cls.optimal(noise, acceleration, dt, sample)  # refuses what is not > 0
        period = max(sample, dt)
        pole = np.exp(-_EQUAL_NOISE * np.sqrt(np.divide(acceleration, noise)) * period)
        pole = np.atleast_1d(pole)
        back = 1.0 - pole
        beta = 1.5 * back**2 * (1.0 + pole)
        return cls(1.0 - pole**3, beta, dt, period, back**3)

    @property
    def noise_gain(self) -> Array:
        """(k,) rms of v̂ per rms of white noise of the readings (1/s), at rest."""
        T = self.sample
        predict = np.array([[1.0, T, 0.5 * T**2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
        found = []
        for K in np.column_stack([self.alpha, self.beta / T, self.gamma / T**2]):
            size = 3 if K[2] > 0.0 else 2
            A = (predict - np.outer(K, predict[0]))[:size, :size]
            P = np.linalg.solve(
                np.eye(size**2) - np.kron(A, A), np.outer(K, K)[:size, :size].ravel()
            )
            found.append(np.sqrt(P[size + 1]))
        return np.array(found)

    @classmethod
    def with_bandwidth(cls, bandwidth: Array, dt: float) -> VelocityEstimate:
        """Critically damped estimate with both poles at exp(−bandwidth · dt).

        Args:
            bandwidth: (k,) rad/s.
            dt: period of the estimate (s).
        """
        pole = np.exp(-np.atleast_1d(bandwidth) * dt)
        return cls(1.0 - pole**2, (1.0 - pole) ** 2, dt)

    def update(
        self, x: Array, acceleration: Array | float = 0.0, fresh: bool = True
    ) -> tuple[Array, Array]:
        """Advance the estimate by one period; return position and velocity, (k,) each.

        Args:
            x: (k,) measured positions (m, rad); channels that are not finite are only predicted.
            acceleration: (k,) known acceleration over the period that ends now (m/s², rad/s²).
            fresh: False if the reading is an old one (slower sensor, lost sample): all channels
                are only predicted.
        """
        if self.x is None:
            self.x = np.array(x, dtype=float)
            return (self.x, self.v)
        total = np.where(self._misled, 0.0, acceleration) + self.unknown
        self.x = self.x + self.dt * self.v + 0.5 * self.dt**2 * total
        self.v = self.v + self.dt * total
        if fresh:
            innovation = np.where(np.isfinite(x), x - self.x, 0.0)
            self.x = self.x + self.alpha * innovation
            self.v = self.v + self.beta / self.sample * innovation
            self.unknown = self.unknown + self.gamma / self.sample**2 * innovation
            self._judge(innovation, acceleration)
        return (self.x, self.v)

    def _judge(self, innovation: Array, acceleration: Array | float) -> None:
        """Note which channels a known acceleration misleads, see `usual`.

        Args:
            innovation: (k,) m, rad. acceleration: (k,) known one (m/s², rad/s²).
        """
        large = np.abs(innovation) > self.usual
        lead = np.where(large, -np.sign(innovation * acceleration), 0.0)
        continues = self._ahead * lead >= 0.0
        self._ahead = np.where(continues, self._ahead, 0.0) * np.abs(lead) + lead * self.sample
        lasting = np.abs(self._ahead) > _MISLED
        self._misled = np.where(lasting, lead > 0.0, self._misled)


def _usual(noise: Array, alpha: Array) -> Array:
    """(k,) largest innovations that noise brings about: their rms is σ_n/√(1 − α) (m, rad)."""
    return np.asarray(_SURPRISE * np.atleast_1d(noise) / np.sqrt(np.maximum(1.0 - alpha, 1e-9)))
