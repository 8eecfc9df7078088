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

A joint does not always have the known acceleration a: with a rotor that the model lacks it has a
share c of it, and if friction holds the joint c = 0. The estimate is linear in c. Let x_c and v_c
be its derivatives by c, which a drives through the same filter. Then innovations are white noise of
variance σ_n²/(1 − α) plus x_c times the error of c, from which c is estimated as a random walk, and
x̂, v̂ are corrected by x_c, v_c times the change of c (B. Friedland, Treatment of bias in recursive
filtering, IEEE Trans. Automatic Control 14, 1969).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

#: Standard deviation of the share c at the start, which is also the largest one.
_SHARE_DEVIATION = 0.5
#: Time in which c may change by `_SHARE_DEVIATION` (s), for example if a joint begins to stick.
_SHARE_CHANGE_TIME = 1.0
_LARGEST_SHARE = 1.5  #: largest share c, of a joint whose links or rotors are modelled too heavy
#: Time of the last readings that are estimated again when their noise is found to be another (s).
_REPLAYED_TIME = 0.02
_BANDWIDTH_RATIO = (8.0**-0.5 / 1.75) ** (1.0 / 3.0)  #: w/ω_e, see `VelocityEstimate.learning`


#: Function that returns the gains α, β, γ (k,) for the noise (k,) of the readings.
Design = Callable[[Array], tuple[Array, Array, Array]]


def smallest_bandwidth(brake: float, integral: float, mode: float) -> float:
    """Compute the bandwidth ω_e (rad/s) with which the brake still balances the force integral.

    A contact that oscillates at ω grows at ½[K_i − κ Re H(jω)] where the filter of `optimal` knows
    the commanded acceleration alone, H = ω_e²/(s² + (√2 ω_e + κ)s + ω_e² + √2 ω_e κ). With
    ρ = κ/K_i > 1, κ Re H ≥ K_i is

        (ρ − 1)ω_e⁴ + √2 κ(ρ − 2)ω_e³ − (ρω² + 2κ²)ω_e² − ω²(ω² + κ²) ≥ 0,

    whose coefficients change sign once, so that it has one positive root (Descartes); for ω → 0 it
    is √2 κ/(ρ − 1).

    Args:
        brake: κ (1/s).
        integral: K_i (1/s).
        mode: ω (rad/s).

    Returns:
        ω_e (rad/s); infinite where κ ≤ K_i, with which no bandwidth suffices.
    """
    if brake <= integral:
        return np.inf
    ratio = brake / integral
    squared = mode**2
    roots = np.roots(
        [
            ratio - 1.0,
            np.sqrt(2.0) * brake * (ratio - 2.0),
            -(ratio * squared + 2.0 * brake**2),
            0.0,
            -squared * (squared + brake**2),
        ]
    )
    return float(roots[np.abs(roots.imag) <= 1e-6 * np.abs(roots)].real.max())


@dataclass
class VelocityEstimate:
    """Positions and velocities of several channels from sampled positions.

    Attributes:
        alpha, beta: (k,) gains of position and of velocity, for the period `sample`.
        dt: period of `update` (s).
        sample: period of the sensor (s); 0: dt.
        gamma: (k,) gain of the unknown acceleration; 0: it is not estimated.
        scatter: (k,) rms of innovations by noise (m, rad); infinite: c remains 1.
        x, v: (k,) last estimate (m, rad; m/s, rad/s); x is None before the first update.
        unknown: (k,) estimate of the unknown acceleration (m/s², rad/s²).
        share: (k,) c, the share of the known acceleration that channels have.
    """

    alpha: Array
    beta: Array
    dt: float
    sample: float = 0.0
    gamma: Array | float = 0.0
    scatter: Array | float = np.inf

    def __post_init__(self) -> None:
        """Convert the gains to arrays with a number for each channel, and reset the states.

        Raises:
            InvalidInputError: the filter is unstable, or a period is not positive.
        """
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
        self.share = np.ones(len(self.alpha))
        #: (k,) variance of the share, and (3, k) derivatives of x, v and unknown by it
        self._share_variance = np.full(len(self.alpha), _SHARE_DEVIATION**2)
        #: (3, k) derivatives of x, v and the unknown acceleration by the share
        self._share_derivatives = np.zeros((3, len(self.alpha)))
        self._gains = self._scaled_gains()  #: gains of the filter, scaled to the period
        #: function that designs α, β and γ for a noise; None: they were given
        self._design: Design | None = None
        #: states before each of the last updates, and the arguments of these
        self._replayable: deque[tuple[tuple[Any, ...], tuple[Any, ...]]] = deque(
            maxlen=max(round(_REPLAYED_TIME / self.dt), 1)
        )
        #: whether the share of the known acceleration is estimated
        self._learns_share = bool(np.isfinite(self.scatter).all())

    @classmethod
    def optimal(
        cls, noise: Array, acceleration: Array, dt: float, sample: float = 0.0
    ) -> VelocityEstimate:
        """Make an estimate of least mean square error.

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
        design = partial(_optimal_gains, acceleration=acceleration, period=sample or dt)
        return cls._with_design(design, noise, dt, sample)

    @classmethod
    def learning(
        cls, noise: Array, acceleration: Array, dt: float, sample: float = 0.0
    ) -> VelocityEstimate:
        """Make an estimate that also estimates lasting unknown accelerations.

        The noise of v̂ is that of `optimal`. The filter has three equal poles at exp(−w dt). On
        continuous white noise of density σ_n² dt, v̂ has the variance 1.75 w³ σ_n² dt, that of
        `optimal` ω_e³ σ_n² dt/√8, ω_e² = σ_a/σ_n: w = 0.587 ω_e (E. Brookner, Tracking and Kalman
        filtering made easy, 1998: fading-memory filter).

        Args:
            noise: (k,) rms noise of the readings (m, rad).
            acceleration: (k,) rms of the unknown acceleration (m/s², rad/s²).
            dt: period of the estimate (s).
            sample: period of the readings (s); 0: dt.

        Raises:
            InvalidInputError: noise or acceleration is not > 0.
        """
        cls.optimal(noise, acceleration, dt, sample)  # raises for numbers that are not > 0
        period = max(sample, dt)
        design = partial(_learning_gains, acceleration=np.asarray(acceleration), period=period)
        return cls._with_design(design, np.atleast_1d(noise), dt, period)

    @classmethod
    def _with_design(
        cls, design: Design, noise: Array, dt: float, sample: float
    ) -> VelocityEstimate:
        """Make an estimate with the gains of a design for the noise of the readings.

        Args:
            design: function that returns gains.
            noise: (k,) rms noise (m, rad).
            dt: period of the estimate (s).
            sample: period of the readings (s); 0: dt.
        """
        alpha, beta, gamma = design(noise)
        estimate = cls(alpha, beta, dt, sample, gamma, _rms_of_innovations(noise, alpha))
        estimate._design = design
        return estimate

    def expect_noise(self, noise: Array, revises: bool = False) -> None:
        """Change the gains to those that `optimal` or `learning` have for another noise.

        Position, velocity, unknown acceleration and share continue without a jump, unless the last
        readings have had this noise already: the speeds that larger gains had made of it would
        decay with the time constant of the new ones. These readings are estimated again then.

        Args:
            noise: (k,) rms noise of the readings (m, rad).
            revises: whether readings of the last `_REPLAYED_TIME` are estimated again.

        Raises:
            InvalidInputError: the estimate was made from gains.
        """
        if self._design is None:
            raise InvalidInputError(
                "velocity estimate: it was made from gains; make it from the noise of the readings "
                "by VelocityEstimate.optimal or .learning"
            )
        self.alpha, self.beta, self.gamma = self._design(noise)
        self.scatter = _rms_of_innovations(noise, self.alpha)
        self._gains = self._scaled_gains()
        if revises and self._replayable:
            past = list(self._replayable)
            self._replayable.clear()
            self._restore(past[0][0])
            for _, arguments in past:
                self.update(*arguments)

    def repeat_last(self, displaced: NDArray[np.bool_]) -> None:
        """Repeat the last update by a reading, of which some turn out to have been displaced.

        The predictions since are repeated after it.

        Args:
            displaced: (k,) whether something else than motion displaced the last reading.
        """
        since: list[tuple[Any, ...]] = []  # arguments, the last ones first
        is_reading = False
        while self._replayable and not is_reading:
            state, arguments = self._replayable.pop()
            is_reading = arguments[2]
            since.append(arguments)
        if since:
            self._restore(state)
        for measured, acceleration, fresh in reversed(since):
            self.update(measured, acceleration, fresh, displaced if fresh else None)

    def _snapshot(self) -> tuple[Any, ...]:
        """Everything that an update changes."""
        return (
            self.x,
            self.v,
            self.unknown,
            self.share,
            self._share_variance,
            self._share_derivatives,
        )

    def _restore(self, state: tuple[Any, ...]) -> None:
        """Return to a state of `_snapshot`."""
        self.x, self.v, self.unknown, self.share, self._share_variance, self._share_derivatives = (
            state
        )

    def _scaled_gains(self) -> Array:
        """Gains (3, k) of position, velocity (1/s) and unknown acceleration (1/s²)."""
        return np.array([self.alpha, self.beta / self.sample, self.gamma / self.sample**2])

    @property
    def noise_gain(self) -> Array:
        """Ratio (k,) of the rms of v̂ to the rms of white noise of the readings, at rest (1/s).

        The covariance P of the estimate solves P = A P Aᵀ + K Kᵀ.
        """
        T = self.sample
        predict = np.array([[1.0, T, 0.5 * T**2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
        gains = []
        for K in np.column_stack([self.alpha, self.beta / T, self.gamma / T**2]):
            size = 3 if K[2] > 0.0 else 2
            A = (predict - np.outer(K, predict[0]))[:size, :size]
            P = np.linalg.solve(
                np.eye(size**2) - np.kron(A, A), np.outer(K, K)[:size, :size].ravel()
            )
            gains.append(np.sqrt(P[size + 1]))  # element (1, 1) of P
        return np.array(gains)

    @classmethod
    def with_bandwidth(cls, bandwidth: Array, dt: float) -> VelocityEstimate:
        """Make a critically damped estimate with both poles at exp(−bandwidth · dt).

        Args:
            bandwidth: (k,) bandwidth of each channel (rad/s).
            dt: period of the estimate (s).
        """
        pole = np.exp(-np.atleast_1d(bandwidth) * dt)
        return cls(1.0 - pole**2, (1.0 - pole) ** 2, dt)

    def update(
        self,
        measured: Array,
        acceleration: Array | float = 0.0,
        fresh: bool = True,
        displaced: NDArray[np.bool_] | None = None,
    ) -> tuple[Array, Array]:
        """Advance the estimate by one period; return position and velocity, (k,) each.

        Args:
            measured: (k,) positions (m, rad); channels that are not finite are only predicted. It
                must not be changed later.
            acceleration: (k,) known acceleration over the period that ends now (m/s², rad/s²); it
                must not be changed later.
            fresh: False if the reading is an old one (slower sensor, lost sample): all channels
                are only predicted.
            displaced: (k,) whether the reading was displaced by something else than motion: then
                the position is, too, and the velocity continues; None: none was. An update that
                `expect_noise` repeats takes all for motion and noise.
        """
        if self.x is None:
            self.x = np.array(measured, dtype=float)
            return (self.x, self.v)
        if self._design is not None:
            self._replayable.append((self._snapshot(), (measured, acceleration, fresh)))
        # prediction by the known share of the acceleration and the unknown one
        dt = self.dt
        half = 0.5 * dt**2
        total = self.share * acceleration + self.unknown
        self.x = self.x + dt * self.v + half * total
        self.v = self.v + dt * total
        # the same of the derivatives by the share
        if self._learns_share:
            x_c, v_c, unknown_c = self._share_derivatives
            total = acceleration + unknown_c
            self._share_derivatives = np.array(
                (x_c + dt * v_c + half * total, v_c + dt * total, unknown_c)
            )
        # correction by a new reading
        if fresh:
            innovation = np.where(np.isfinite(measured), measured - self.x, 0.0)
            if displaced is not None:
                self.x = self.x + np.where(displaced, innovation, 0.0)
                innovation = np.where(displaced, 0.0, innovation)
            self._correct_states(self._gains * innovation)
            if self._learns_share:
                self._learn_share(innovation)
        return (self.x, self.v)

    def _correct_states(self, change: Array) -> None:
        """Add the rows of `change` (3, k) to x, v and the unknown acceleration."""
        self.x = self.x + change[0]
        self.v = self.v + change[1]
        self.unknown = self.unknown + change[2]

    def _learn_share(self, innovation: Array) -> None:
        """Update the share c, and with it the estimate, by Friedland's filter.

        c (k,) is the share of the commanded acceleration that a channel really has.
        `_share_derivatives` (3, k) are the derivatives of position, velocity and unknown
        acceleration by c. A scalar Kalman filter for each channel, with the innovation x_c c of the
        readings, gives the change of c, by which the estimate is corrected along these derivatives.

        Args:
            innovation: (k,) reading minus prediction (m, rad).
        """
        x_c = self._share_derivatives[0]
        self._share_derivatives = self._share_derivatives - self._gains * x_c
        predicted = self._share_variance + _SHARE_DEVIATION**2 * self.sample / _SHARE_CHANGE_TIME
        variance = np.minimum(predicted, _SHARE_DEVIATION**2)
        gain = variance * x_c / (self.scatter**2 + variance * x_c**2)
        self._share_variance = variance * (1.0 - gain * x_c)
        share = np.clip(self.share + gain * innovation, 0.0, _LARGEST_SHARE)
        self._correct_states(self._share_derivatives * (share - self.share))
        self.share = share


def _optimal_gains(noise: Array, acceleration: Array, period: float) -> tuple[Array, Array, Array]:
    """Compute the stationary Kalman gains α and β (k,) of position and velocity; γ is zero.

    Args:
        noise: (k,) rms noise of the readings (m, rad).
        acceleration: (k,) rms of the unknown acceleration (m/s², rad/s²).
        period: of the readings (s).
    """
    index = acceleration * period**2 / noise
    u = 1.0 / 3.0 + np.sqrt(1.0 / 12.0 + 4.0 / index**2)
    beta = 12.0 / (6.0 * (u + np.sqrt(u)) + 1.0)
    return beta * np.sqrt(u), beta, np.zeros(len(beta))


def _learning_gains(noise: Array, acceleration: Array, period: float) -> tuple[Array, Array, Array]:
    """Compute the gains α, β and γ (k,) of `VelocityEstimate.learning`.

    Args:
        noise: (k,) rms noise of the readings (m, rad).
        acceleration: (k,) rms of the unknown acceleration (m/s², rad/s²).
        period: of the readings (s).
    """
    pole = np.exp(-_BANDWIDTH_RATIO * np.sqrt(np.divide(acceleration, noise)) * period)
    pole = np.atleast_1d(pole)
    decay = 1.0 - pole
    return 1.0 - pole**3, 1.5 * decay**2 * (1.0 + pole), decay**3


def _rms_of_innovations(noise: Array, alpha: Array) -> Array:
    """Compute the rms (k,) of innovations by noise, σ_n/√(1 − α) (m, rad).

    Args:
        noise: (k,) rms noise σ_n of the readings (m, rad).
        alpha: (k,) gain of position.
    """
    return np.asarray(np.atleast_1d(noise) / np.sqrt(np.maximum(1.0 - alpha, 1e-9)))
