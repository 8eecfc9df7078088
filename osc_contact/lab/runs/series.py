"""Sums over the ticks of a run, piece after piece: means, rms, peaks, the worst second."""

from __future__ import annotations

import numpy as np

from osc_contact.spatial import Array


class Series:
    """Mean, root mean square and peak of m signals over the ticks, updated piece by piece.

    NaN and infinite values are excluded: they were not computed, or are not judged. The statistics
    of a signal without finite values are None.
    """

    def __init__(self) -> None:
        """Begin before the first tick."""
        # of the finite values of each signal (m,): number, sum, sum of squares, largest magnitude
        self._counts = np.zeros(1)
        self._sums = np.zeros(1)  #: sum
        self._squares = np.zeros(1)  #: sum of squares
        self._peaks = np.zeros(1)  #: largest magnitude

    def add(self, values: Array) -> None:
        """Include k further ticks.

        Args:
            values: (k,) samples of one signal, or (k, m) of m signals.
        """
        rows = np.array(values if values.ndim > 1 else values[:, None], dtype=float)
        finite = np.isfinite(rows)
        rows[~finite] = 0.0
        self._counts = self._counts + finite.sum(axis=0)
        self._sums = self._sums + rows.sum(axis=0)
        self._squares = self._squares + (rows**2).sum(axis=0)
        self._peaks = np.maximum(self._peaks, np.abs(rows).max(axis=0, initial=0.0))

    def mean(self) -> list[float | None]:
        """Mean of each signal over its finite values."""
        return self._where_counted(self._sums / np.maximum(self._counts, 1))

    def rms(self) -> list[float | None]:
        """Root mean square of each signal over its finite values."""
        return self._where_counted(np.sqrt(self._squares / np.maximum(self._counts, 1)))

    def peak(self) -> list[float | None]:
        """Largest magnitude of each signal among its finite values."""
        return self._where_counted(self._peaks)

    def _where_counted(self, values: Array) -> list[float | None]:
        """List of (m,) values, with None for signals without a finite value."""
        return [float(x) if n else None for x, n in zip(values, self._counts, strict=True)]


class WorstSecond:
    """Largest rms error within one second of a run, piece after piece.

    Squares are summed in tenths of a second; a second counts if half of its ticks are judged.
    """

    def __init__(self) -> None:
        """Begin before the first tick."""
        self._squares: list[Array] = []  #: sums of squared errors (m,) of each tenth of a second
        self._counts: list[Array] = []  #: numbers (m,) of their finite errors
        self._ticks: list[int] = []  #: numbers of their ticks

    def add(self, t: Array, error: Array) -> None:
        """Include k further ticks.

        Args:
            t: (k,) times (s).
            error: (k, r) errors of the forces (N), NaN in ticks that are not judged.
        """
        tenths = np.floor(t * 10.0 + 1e-6).astype(int)
        for tenth in np.unique(tenths):
            errors = error[tenths == tenth]
            while len(self._ticks) <= tenth:
                self._squares.append(np.zeros(error.shape[1]))
                self._counts.append(np.zeros(error.shape[1]))
                self._ticks.append(0)
            self._squares[tenth] += np.nansum(errors**2, axis=0)
            self._counts[tenth] += np.isfinite(errors).sum(axis=0)
            self._ticks[tenth] += len(errors)

    def largest(self) -> list[float | None]:
        """Largest rms error of each force within a second (N); None if no second is judged.

        Sums of squares and counts are those of tenths of a second; ten successive ones make a
        second, which is judged if at least half of its ticks are.
        """
        if not self._ticks:
            return []
        squares = _sums_of_ten(self._squares)
        counts = _sums_of_ten(self._counts)
        enough = counts > 5.0 * max(self._ticks)  # half of the ticks of ten tenths
        values = np.sqrt(np.where(enough, squares / np.maximum(counts, 1.0), 0.0).max(axis=0))
        return [
            float(value) if seconds.any() else None
            for value, seconds in zip(values, enough.T, strict=True)
        ]


def _sums_of_ten(rows: list[Array]) -> Array:
    """Sums (k, r) of ten successive rows each, the first ones of fewer, as differences of sums.

    Args:
        rows: k rows (r,).
    """
    sums = np.cumsum(np.vstack([np.zeros((10, len(rows[0]))), rows]), axis=0)
    return sums[10:] - sums[:-10]
