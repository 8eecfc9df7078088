"""Noise of readings, measured by their third differences: sensors noisier than expected."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from osc_contact.spatial import Array

_THIRD = sqrt(2.0 / pi * 20.0)  #: mean magnitude of third differences of unit normal noise
_AVERAGED = 0.05  #: s, time constant of their mean
#: Multiple of the expected noise above which a sensor is noisier than expected. Resolution alone,
#: expected as a uniform distribution, comes to 2 if readings alternate between two steps.
_LOUD = 5.0
#: rad, m, noise below which nothing is noisier than expected: an acceleration that changes by
#: 1,000 rad/s² in one sample of 1 ms, and back within the mean, comes to 0.02 mrad
_LEAST = 2e-4


class ReadingNoise:
    """Noise of sensors that may be noisier than expected: a worn coupling, a bad shield.

    Third differences x_k − 3x_{k−1} + 3x_{k−2} − x_{k−3} of readings with white noise σ have the
    variance 20 σ², and for normal noise the mean magnitude √(2/π) √20 σ. Motion hardly changes
    them: an acceleration that changes by Δa from sample to sample adds up to Δa T² in two of them.

    Attributes:
        expected: (k,) standard deviation of the readings (rad, m).
        is_loud: whether some sensor is noisier than expected.
    """

    def __init__(self, expected: Array, sample: float) -> None:
        """Begin with the expected noise.

        Args:
            expected: (k,) standard deviation of the readings (rad, m).
            sample: their period (s).
        """
        self.expected = np.array(expected, dtype=float)
        self.is_loud = False
        self._share = sample / (_AVERAGED + sample)
        self._largest_expected = np.maximum(_LOUD * self.expected, _LEAST)
        self._mean = _THIRD * self.expected
        self._readings = np.full((4, len(self.expected)), np.nan)

    def update(self, measured: Array) -> Array:
        """Return the noise (k,) of the sensors after a new reading, a standard deviation (rad, m).

        It is the measured one where this is far beyond the expected one, else the expected one.
        Measured is the mean magnitude of the readings' third differences x_k − 3x_{k−1} + 3x_{k−2}
        − x_{k−3}, low-passed and divided by that of unit normal noise, `_THIRD`. Motion hardly
        changes third differences.

        Args:
            measured: (k,) new readings (rad, m). Readings that are not finite are no evidence.
        """
        readings = self._readings
        readings[:-1] = readings[1:]
        readings[-1] = measured
        third = np.abs(readings[3] - readings[0] - 3.0 * (readings[2] - readings[1]))
        change = self._share * (third - self._mean)
        self._mean += np.where(np.isfinite(change), change, 0.0)
        noise = self._mean / _THIRD
        loud = noise > self._largest_expected
        self.is_loud = bool(loud.any())
        return np.where(loud, noise, self.expected)
