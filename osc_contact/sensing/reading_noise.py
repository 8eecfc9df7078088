"""Noise of readings, measured by their third differences: sensors noisier than expected."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from osc_contact.spatial import Array

#: Mean magnitude of third differences of unit normal noise.
_THIRD_OF_UNIT_NOISE = sqrt(2.0 / pi * 20.0)
#: s, time constant of their mean, or longer where readings come at less than 280 Hz: so long that
#: `_MOST_OF_ONE_READING` leaves differences of `_LEAST_CAP` at least
_MEAN_TIME = 0.05
#: Multiple of the expected noise above which a sensor is noisier than expected. Resolution alone,
#: expected as a uniform distribution, comes to 2 if readings alternate between two steps.
_LOUD_RATIO = 5.0
#: Largest part of the mean that comes from one wrong reading, which is in four third differences,
#: or from one jump, which is in three: a multiple of the mean at which a sensor is noisier than
#: expected. The expected noise comes to 1/5 of that, so that no single reading suffices beside it.
_MOST_OF_ONE_READING = 0.8
#: Bounds of the largest third difference in the mean, as a multiple of that of the largest expected
#: noise or of the mean so far. Noise far beyond it is found after 5 to 11 readings.
_LEAST_CAP, _MOST_CAP = 3.0, 10.0
_FIRST_MEASURE_LENGTH = (
    5  #: third differences whose mean is the first measure of a noise that has begun
)
#: rad, m, noise below which nothing is noisier than expected: an acceleration that changes by
#: 1,000 rad/s² in one sample of 1 ms, and back within the mean, comes to 0.02 mrad
_LEAST_LOUD_NOISE = 2e-4


class ReadingNoise:
    """Noise of sensors that may be noisier than expected: a worn coupling, a bad shield.

    Third differences x_k − 3x_{k−1} + 3x_{k−2} − x_{k−3} of readings with white noise σ have the
    variance 20 σ², and for normal noise the mean magnitude √(2/π) √20 σ. Motion hardly changes
    them: an acceleration that changes by Δa from sample to sample adds up to Δa T² in two of them.

    Attributes:
        expected: (k,) standard deviation of the readings (rad, m).
        is_loud: whether some sensor is noisier than expected.
        begins: whether that of some sensor has been found by its last reading.
    """

    def __init__(self, expected: Array, sample: float) -> None:
        """Begin with the expected noise.

        Args:
            expected: (k,) standard deviation of the readings (rad, m).
            sample: their period (s).
        """
        self.expected = np.array(expected, dtype=float)
        self.is_loud = self.begins = False
        #: (k,) whether a sensor was noisier than expected before the last reading
        self._was_loud = np.zeros(len(self.expected), dtype=bool)
        #: share of a reading in the mean of magnitudes
        self._low_pass_share = min(
            sample / (_MEAN_TIME + sample), _MOST_OF_ONE_READING / (4.0 * _LEAST_CAP)
        )
        #: largest magnitude that counts, as a multiple of the mean
        self._cap = min(_MOST_OF_ONE_READING / (4.0 * self._low_pass_share), _MOST_CAP)
        #: (k,) noise up to which a sensor is as expected (rad, m)
        self._largest_expected = np.maximum(_LOUD_RATIO * self.expected, _LEAST_LOUD_NOISE)
        #: (k,) mean magnitude of third differences (rad, m)
        self._mean_third = _THIRD_OF_UNIT_NOISE * self.expected
        #: (4, k) last readings, the newest last (rad, m)
        self._readings = np.full((4, len(self.expected)), np.nan)
        #: (m, k) last magnitudes of third differences (rad, m)
        self._last_thirds = np.zeros((_FIRST_MEASURE_LENGTH, len(self.expected)))

    def update(self, measured: Array) -> Array:
        """Return the noise (k,) of the sensors after a new reading, a standard deviation (rad, m).

        The measured noise is the low-passed magnitude of the readings' third differences x_k −
        3x_{k−1} + 3x_{k−2} − x_{k−3}, which motion hardly changes, divided by that of unit normal
        noise, `_THIRD_OF_UNIT_NOISE`. A sensor whose measured noise is far beyond the expected one
        (`_largest_expected`) is loud, and has the measured noise; others have the expected one.
        When a sensor begins to be loud, the low-passed magnitude still contains quiet readings:
        then it is raised to the mean of the last `_FIRST_MEASURE_LENGTH` ones.

        Args:
            measured: (k,) new readings (rad, m). Readings that are not finite are no evidence.
        """
        readings = self._readings
        readings[:-1] = readings[1:]
        readings[-1] = measured
        third = np.abs(readings[3] - readings[0] - 3.0 * (readings[2] - readings[1]))
        is_new = np.isfinite(third)
        self._last_thirds = np.where(
            is_new, np.vstack([self._last_thirds[1:], third]), self._last_thirds
        )
        most = self._cap * np.maximum(
            _THIRD_OF_UNIT_NOISE * self._largest_expected, self._mean_third
        )
        change = self._low_pass_share * (np.minimum(third, most) - self._mean_third)
        self._mean_third += np.where(is_new, change, 0.0)
        loud = self._mean_third > _THIRD_OF_UNIT_NOISE * self._largest_expected
        begins = loud & ~self._was_loud
        self.begins = bool(begins.any())
        if self.begins:
            latest = np.maximum(self._mean_third, self._last_thirds.mean(axis=0))
            self._mean_third = np.where(begins, latest, self._mean_third)
        self._was_loud = loud
        self.is_loud = bool(loud.any())
        return np.where(loud, self._mean_third / _THIRD_OF_UNIT_NOISE, self.expected)
