"""Encoders that are dead: their readings repeat although noise would change them."""

from __future__ import annotations

from math import erf, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray

from osc_contact.spatial import Array

_BY_CHANCE = 1e-12  #: probability of an unlikely repetition: once in years at 1 kHz


class DeadEncoders:
    """Detection of encoders of known noise that read the very same number for too long.

    Of a joint at rest, normal noise of deviation σ lets a reading of resolution δ be any given
    number with the probability p ≤ erf(δ/(√8 σ)); in motion p is smaller. The same number n times
    in a row after a first reading is unlikely from n = ln 10⁻¹²/ln p on. Encoders without noise
    repeat themselves at rest: they are never called dead.

    A speed estimated from such an encoder tends to zero together with its position, and filters
    conceal the repetition: readings have to be checked before velocities are estimated from them.

    Attributes:
        most: (k,) number of repetitions that is unlikely; inf: any number is likely.
    """

    def __init__(self, noise: Array, resolution: Array) -> None:
        """Compute how many equal readings in succession prove that each of k encoders is dead.

        Args:
            noise: (k,) standard deviation of the readings (rad, m); 0: ideal.
            resolution: (k,) of the readings (rad, m); 0: no two readings with noise are the same.
        """
        pairs = zip(np.atleast_1d(noise), np.atleast_1d(resolution), strict=True)
        self.most = np.array([_unlikely_repetitions(*pair) for pair in pairs])
        self._last_reading = np.full(len(self.most), np.nan)
        self._repetitions = np.zeros(len(self.most))

    def update(self, measured: Array, fresh: bool = True) -> NDArray[np.bool_]:
        """Return which encoders (k,) are dead after a new reading.

        Compares it with `_last_reading` (k,) and counts equal ones in succession in `_repetitions`
        (k,); a number above `most` is dead.

        Args:
            measured: (k,) positions (rad, m).
            fresh: False if it is an old reading, which is no evidence (slower sensor, lost sample).
        """
        if fresh:
            is_same = measured == self._last_reading
            self._repetitions = np.where(is_same, self._repetitions + 1.0, 0.0)
            self._last_reading = np.array(measured, dtype=float)
        return self._repetitions > self.most


def _unlikely_repetitions(noise: float, resolution: float) -> float:
    """Compute how many repetitions of a reading prove that an encoder at rest is dead.

    The probability of one repetition is p = erf(resolution/(√8 noise)); n repetitions are unlikely
    from pⁿ = `_BY_CHANCE` on.

    Args:
        noise: standard deviation of a reading (rad, m).
        resolution: step of a reading (rad, m).

    Returns:
        Number n; inf without noise, for which repetitions prove nothing.
    """
    if not noise > 0.0:
        return inf
    probability = erf(resolution / (sqrt(8.0) * noise))
    if probability >= 1.0:
        return inf
    return log(_BY_CHANCE) / log(probability) if probability > 0.0 else 1.0
