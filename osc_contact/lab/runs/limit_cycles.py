"""Limit cycles of contact forces: lasting oscillations that were not commanded.

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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from osc_contact.recorder import Recording
from osc_contact.recorder.judged import Flags, stretches
from osc_contact.spatial import Array

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
    """An oscillation of a force: amplitude (N), frequency (Hz), amplitude over mean command.

    compliance: travel of the contact along its normal over the amplitude (m/N); None: not recorded.
    """

    amplitude: float
    frequency: float
    relative: float
    compliance: float | None


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
    line = _levelled(error)
    power = np.abs(np.fft.rfft(line * np.hanning(n))) ** 2
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
    analytic = np.fft.ifft(np.where(bands[0] & free, 2.0 * np.fft.rfft(line), 0.0), n)
    envelope = np.abs(analytic)[n // 10 : n - n // 10]
    if not envelope.all():
        return None
    log = np.log(envelope)
    x = np.linspace(-0.5, 0.5, len(envelope))
    slope, _ = np.polyfit(x, log, 1)
    if slope < np.log(1.0 - _FALL) or np.std(log - slope * x) > _SCATTER:
        return None
    return float(np.median(envelope)), peak / (n * dt)


def _commanded(
    n: int,
    dt: float,
    commands: Sequence[Array],
    driven_Hz: Sequence[float],
    along: Array | None,
    across: Array | None,
) -> Flags:
    """(n/2 + 1,) the bins that hold a line of a command, or a low harmonic of one."""
    lines = np.zeros(n // 2 + 1, dtype=bool)
    for command in commands:
        lines |= _lines(command, 1e-6 * np.abs(command).max(initial=1e-3))
    if along is not None and across is not None:
        inward = _spectrum(across)
        for speed in along.T:
            lines |= _lines(speed, _SLOW) & (_spectrum(speed) > _ALONG * inward)
    for frequency in driven_Hz:
        centre = round(frequency * n * dt)
        lines[max(centre - 2, 0) : centre + 3] = True
    bins = np.arange(len(lines))
    harmonics = [lines[np.round(bins / m).astype(int)] for m in (1, 2, 3)]
    return np.any(harmonics, axis=0)


def _lines(signal: Array, least: float) -> Flags:
    """Bins in which a signal has a line of at least an amplitude."""
    spectrum = _spectrum(signal)
    return spectrum > max(_LINE * spectrum.max(), least)


def _spectrum(signal: Array) -> Array:
    """(n/2 + 1,) amplitude of a signal's lines, its trend removed."""
    window = np.hanning(len(signal))
    return np.abs(np.fft.rfft(_levelled(signal) * window)) * (2.0 / window.sum())


def _levelled(signal: Array) -> Array:
    """A signal less its linear trend."""
    x = np.linspace(-1.0, 1.0, len(signal))
    level = signal - signal.mean()
    return level - x * (x @ level) / (x @ x)


def worst_cycles(recording: Recording, judged: Array, least: float) -> list[Cycle | None]:
    """Largest limit cycle of each force magnitude, or None if none is large enough.

    Args:
        recording: recording with a judge. judged: (T, r) mask of the ticks that are evaluated.
        least: least amplitude relative to the mean command.
    """
    dt = 1.0 / recording.meta["control_rate_hz"]
    driven = tuple(_frequencies(recording.meta.get("scenario", {})))
    names = ("alpha_cmd", "alpha_true", *(name for name in ("twist", "N") if name in recording))
    size = round(WINDOW_S / dt)
    worst: list[Cycle | None] = [None] * judged.shape[1]
    for j in range(len(worst)):
        for start, stop in stretches(judged[:, j]):
            while judged[start, j] and stop - start >= _SHORTEST_S / dt - 0.5:
                window = recording.rows(start, min(start + size, stop), *names)
                found = _cycle_in(window, j, dt, driven, least)
                before = worst[j]
                if found and (before is None or found.relative > before.relative):
                    worst[j] = found
                if stop - start < size:
                    break
                start += size // 2
    return worst


def _cycle_in(
    window: Mapping[str, Array], j: int, dt: float, driven_Hz: Sequence[float], least: float
) -> Cycle | None:
    """The limit cycle of force j in some ticks of a recording."""
    commands = window["alpha_cmd"]
    error = window["alpha_true"][:, j] - commands[:, j]
    mean = float(np.abs(commands[:, j]).mean())
    if not np.sqrt(2.0) * error.std() > least * mean > 0.0:
        return None
    along, across = _speeds(window, j) if "N" in window else (None, None)
    found = find_cycle(error, dt, list(commands.T), driven_Hz, along, across)
    if found is None:
        return None
    amplitude, frequency = found
    compliance = None
    if across is not None:
        speed = _spectrum(across)[round(frequency * len(error) * dt)]
        compliance = float(speed) / (2.0 * np.pi * frequency * amplitude)
    return Cycle(amplitude, frequency, amplitude / mean, compliance)


def _speeds(window: Mapping[str, Array], j: int) -> tuple[Array, Array]:
    """Speeds of the object along its contacts (k, 6), and into that of force j (k,)."""
    scale = np.array([1.0, 1.0, 1.0, _ARM, _ARM, _ARM])
    V = window["twist"] * scale
    N = window["N"] / scale[:, None]
    into = np.einsum("kij,ki->kj", N, V)
    mobility = N.transpose(0, 2, 1) @ N + 1e-9 * np.eye(N.shape[2])  # columns may depend
    return V - (N @ np.linalg.solve(mobility, into[:, :, None]))[:, :, 0], into[:, j]


def _frequencies(scenario: Any, of_faces: bool = False) -> Iterator[float]:
    """Yield the frequencies of sines by which faces and bodies are driven.

    Args:
        scenario: keys of a scenario. of_faces: whether they belong to contacts or environment.
    """
    items = scenario.items() if isinstance(scenario, Mapping) else ()
    for key, value in items:
        if of_faces and key == "frequency" and isinstance(value, float | int):
            yield float(value)
        elif of_faces or key in ("contacts", "environment"):
            yield from _frequencies(value, True)
    for value in scenario if isinstance(scenario, list | tuple) else ():
        yield from _frequencies(value, of_faces)
