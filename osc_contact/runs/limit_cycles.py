"""Limit cycles of contact forces: oscillations that last and that nobody commanded.

The error of a force, true minus commanded, is looked at through windows of `WINDOW_S` that overlap
by half, with a Hann window and the Fourier transform. An oscillation is a limit cycle if

* it dominates: a band of ±20 % about its frequency, with its second and third harmonic, holds half
  of the power of all that is not correlated with the command;
* it lasts: over the window the logarithm of its envelope falls by less than 30 % and scatters by
  less than 0.35 about a straight line. What rings down, or is struck again and again, does not,
  and neither does noise: the logarithm of the envelope of narrow-band noise scatters by 0.64;
* it is not correlated with the command: lines of the commanded forces, of the object's motion
  along its contacts, of faces driven by a sine, and the second and third harmonics of all these
  (friction, centripetal forces) are left out before.

A period must fit six times into a window.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from osc_contact.recorder.judged import stretches
from osc_contact.spatial import Array

__all__ = ["Cycle", "CycleSearch", "WINDOW_S", "find_cycle"]

WINDOW_S = 4.0
_SHORTEST_S = 1.0  #: of judged time that is looked at
_PERIODS = 6  #: that fit into a window, at least
_BAND = 0.2  #: half width of the band about a frequency, of that frequency
_DOMINANT = 0.5  #: of the power that is not correlated with the command
_FALL, _SCATTER = 0.3, 0.35  #: of the envelope over a window; of its logarithm about a line
_LINE = 0.05  #: of a command's largest line: smaller ones are not commanded
_SLOW = 1e-3  #: m/s; an object that moves along its contacts more slowly stands
_ALONG = 3.0  #: times as fast as into the contact: motion along it
_ARM = 0.1  #: m; a rotation counts as the motion of a point so far away


@dataclass(frozen=True)
class Cycle:
    """An oscillation of a force: amplitude (N), frequency (Hz), amplitude over mean command."""

    amplitude: float
    frequency: float
    relative: float


def find_cycle(
    error: Array,
    dt: float,
    commands: Sequence[Array] = (),
    driven_Hz: Sequence[float] = (),
    along: Array | None = None,
    across: Array | None = None,
) -> tuple[float, float] | None:
    """The limit cycle in one window of a force's error; None: there is none.

    Args:
        error: (n,) true minus commanded force (N), dt (s) apart.
        dt: s.
        commands: (n,) each, desired forces; their lines are no limit cycles.
        driven_Hz: frequencies at which faces are driven.
        along: (n, m) speeds of the object along its contacts (m/s). across: (n,) into this one.

    Returns:
        Amplitude (N) and frequency (Hz).
    """
    n = len(error)
    line, spectrum = _levelled(error), np.hanning(n)
    power = np.abs(np.fft.rfft(line * spectrum)) ** 2
    bins = np.arange(len(power))
    free = ~_commanded(n, dt, commands, driven_Hz, along, across)
    free &= (bins >= _PERIODS) & (bins <= n // 4)
    if not free.any() or not power[free].any():
        return None
    peak = int(np.argmax(np.where(free, power, 0.0)))
    reach = max(_BAND * peak, 3.0)
    bands = [np.abs(bins - m * peak) <= reach for m in (1, 2, 3)]
    if power[free & np.any(bands, axis=0)].sum() < _DOMINANT * power[free].sum():
        return None
    transform = np.where(bands[0] & free, np.fft.rfft(line), 0.0)
    analytic = np.zeros(n, dtype=complex)
    analytic[: len(transform)] = 2.0 * transform
    envelope = np.abs(np.fft.ifft(analytic))[n // 10 : n - n // 10]
    if not envelope.all():
        return None
    log, x = np.log(envelope), np.linspace(-0.5, 0.5, len(envelope))
    slope, level = np.polyfit(x, log, 1)
    if slope < np.log(1.0 - _FALL) or np.std(log - slope * x - level) > _SCATTER:
        return None
    return float(np.median(envelope)), peak / (n * dt)


def _commanded(
    n: int,
    dt: float,
    commands: Sequence[Array],
    driven_Hz: Sequence[float],
    along: Array | None,
    across: Array | None,
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(n/2 + 1,) the bins that hold a line of a command, or a low harmonic of one."""
    lines = np.zeros(n // 2 + 1, dtype=bool)
    for command in commands:
        lines |= _lines(command, 1e-6 * float(np.abs(command).max(initial=1e-3)))
    if along is not None and across is not None:
        inward = _spectrum(across)
        for speed in along.T:
            lines |= _lines(speed, _SLOW) & (_spectrum(speed) > _ALONG * inward)
    for frequency in driven_Hz:
        centre = round(frequency * n * dt)
        lines[max(centre - 2, 0) : centre + 3] = True
    bins = np.arange(len(lines))
    found = lines.copy()
    for harmonic in (2, 3):
        found |= lines[np.round(bins / harmonic).astype(int)]
    return found


def _lines(signal: Array, least: float) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Bins in which a signal has a line of at least an amplitude."""
    spectrum = _spectrum(signal)
    return spectrum > max(_LINE * float(spectrum.max()), least)


def _spectrum(signal: Array) -> Array:
    """(n/2 + 1,) amplitude of a signal's lines, its trend removed."""
    window = np.hanning(len(signal))
    found: Array = np.abs(np.fft.rfft(_levelled(signal) * window)) * (2.0 / window.sum())
    return found


def _levelled(signal: Array) -> Array:
    """A signal less its linear trend."""
    x = np.linspace(-1.0, 1.0, len(signal))
    level = signal - signal.mean()
    left: Array = level - x * (x @ level) / (x @ x)
    return left


class CycleSearch:
    """Looks for limit cycles in a recording's forces, piece after piece.

    Attributes:
        worst: of each force magnitude, the largest cycle so far; None: none large enough.
    """

    def __init__(self, meta: Mapping[str, Any], columns: Array, least: float) -> None:
        """Begin before the first tick.

        Args:
            meta: of the recording. columns: (r,) the contact of each force magnitude.
            least: amplitude over mean command, below which nothing is looked for.
        """
        self._dt, self._least = 1.0 / float(meta["control_rate_hz"]), least
        self._driven = tuple(_frequencies(meta.get("scenario", {})))
        self.worst: list[Cycle | None] = [None] * len(columns)
        self._kept: list[list[Array]] = [[] for _ in columns]

    def add(self, piece: Mapping[str, Array], judged: Array) -> None:
        """Ticks that follow those before.

        Args:
            piece: `alpha_cmd`, `alpha_true`, and where there are such `twist` and `N`.
            judged: (k, r) which of them count.
        """
        command, moving = piece["alpha_cmd"], None
        error = piece["alpha_true"] - command
        for j in range(len(self.worst)):
            counts = judged[:, j] & np.isfinite(error[:, j])
            level = 0.5 * self._least * np.abs(command[counts, j]).mean() if counts.any() else 0.0
            if not (np.abs(error[counts, j]) > level).any():  # no cycle reaches into this piece
                self._end(j)
                continue
            moving = _speeds(piece) if moving is None else moving
            rows = np.column_stack((error[:, j], command[:, j], command, moving))
            counts &= np.isfinite(rows).all(axis=1)
            for start, stop in stretches(counts):
                if counts[start]:
                    self._extend(j, rows[start:stop])
                else:
                    self._end(j)

    def finish(self) -> None:
        """What is left after the last tick is looked at, too."""
        for j in range(len(self.worst)):
            self._end(j)

    def _extend(self, j: int, rows: Array) -> None:
        """More rows of force j in the same stretch of judged ticks."""
        kept = np.concatenate([*self._kept[j], rows]) if self._kept[j] else rows
        size = round(WINDOW_S / self._dt)
        while len(kept) >= size:
            self._look(j, kept[:size])
            kept = kept[size // 2 :]
        self._kept[j] = [kept]

    def _end(self, j: int) -> None:
        for kept in self._kept[j]:
            if len(kept) >= _SHORTEST_S / self._dt - 0.5:
                self._look(j, kept)
        self._kept[j] = []

    def _look(self, j: int, rows: Array) -> None:
        """One window of force j: error, command, commands, speeds along, speeds across."""
        r, error, mean = len(self.worst), rows[:, 0], float(np.abs(rows[:, 1]).mean())
        if not np.sqrt(2.0) * error.std() > self._least * mean > 0.0:
            return
        speeds = rows[:, 2 + r :]
        along, across = (speeds[:, :6], speeds[:, 6 + j]) if speeds.size else (None, None)
        commands = list(rows[:, 2 : 2 + r].T)
        found = find_cycle(error, self._dt, commands, self._driven, along, across)
        before = self.worst[j]
        if found and (before is None or found[0] / mean > before.relative):
            self.worst[j] = Cycle(*found, found[0] / mean)


def _speeds(piece: Mapping[str, Array]) -> Array:
    """(k, 6 + r) speeds of the object along its contacts and into each; (k, 0): not recorded."""
    if "twist" not in piece or "N" not in piece:
        return np.zeros((len(piece["alpha_cmd"]), 0))
    scale = np.array([1.0, 1.0, 1.0, _ARM, _ARM, _ARM])
    V = piece["twist"] * scale
    N = piece["N"] / scale[:, None]
    into = np.einsum("kij,ki->kj", N, V)
    mobility = N.transpose(0, 2, 1) @ N + 1e-9 * np.eye(N.shape[2])  # columns may depend
    along = V - (N @ np.linalg.solve(mobility, into[:, :, None]))[:, :, 0]
    return np.column_stack((along, into))


def _frequencies(scenario: Any) -> Iterator[float]:
    """Of the sines that faces and bodies are driven by."""
    if not isinstance(scenario, Mapping):
        return
    for key in ("contacts", "environment"):
        yield from _named(scenario.get(key), "frequency")


def _named(data: Any, name: str) -> Iterator[float]:
    if isinstance(data, Mapping):
        for key, value in data.items():
            if key == name and isinstance(value, float | int):
                yield float(value)
            else:
                yield from _named(value, name)
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _named(value, name)
