"""Limit cycles of contact forces: lasting oscillations that were not commanded.

The error of a force, true minus commanded, is looked at through windows of `WINDOW_S` that overlap
by half, with a Hann window and the Fourier transform. An oscillation is a limit cycle if

* it dominates: a band of ±20 % about its frequency, with its second and third harmonic, holds half
  of the power of all that is not correlated with the command;
* it lasts: over the window the logarithm of its envelope falls by less than 30 % and scatters by
  less than 0.35 about a straight line. A decaying oscillation, or one that is struck again and
  again, does not, and neither does noise: the logarithm of the envelope of narrow-band noise
  scatters by 0.64;
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

WINDOW_S = 4.0  #: duration of a window (s)
_SHORTEST_S = 1.0  #: least duration of judged time that is searched (s)
_LEAST_PERIODS = 6  #: least number of periods in a window
_BAND_HALF_WIDTH = 0.2  #: half width of the band about a frequency, over that frequency
_LEAST_POWER_SHARE = (
    0.5  #: least share of the band in the power that is not correlated with the command
)
_MOST_FALL = 0.3  #: largest relative fall of the envelope over a window
_MOST_SCATTER = (
    0.35  #: largest standard deviation of the envelope's logarithm about a straight line
)
_LINE = 0.05  #: least amplitude of a line of a command, over the command's largest line
_LEAST_SPEED = 1e-3  #: least speed along a contact that counts as motion (m/s)
_LEAST_SPEED_RATIO = (
    3.0  #: least ratio of the speeds along and into a contact for a motion along it
)
_ARM = 0.1  #: lever by which angular velocities are converted to speeds (m)


@dataclass(frozen=True)
class Cycle:
    """Limit cycle of a force.

    Attributes:
        amplitude: amplitude of the oscillation (N).
        frequency: its frequency (Hz).
        relative: amplitude over the mean command.
        compliance: travel of the contact along its normal over the amplitude (m/N); None: not
            recorded.
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
    """Find the limit cycle in one window of a force's error.

    Args:
        error: (n,) true minus commanded force (N).
        dt: time between samples (s).
        commands: desired forces (n,) (N), whose lines are not limit cycles.
        driven_Hz: frequencies at which faces are driven (Hz).
        along: (n, m) speeds of the object along its contacts (m/s).
        across: (n,) speed into the contact of this force (m/s); None: not recorded.

    Returns:
        Amplitude (N) and frequency (Hz); None: there is no limit cycle.
    """
    n = len(error)
    oscillation = _remove_trend(error)
    power = np.abs(np.fft.rfft(oscillation * np.hanning(n))) ** 2
    bins = np.arange(len(power))
    is_free = ~_command_bins(n, dt, commands, driven_Hz, along, across)
    is_free &= (bins >= _LEAST_PERIODS) & (bins <= n // 4)
    if not is_free.any() or not power[is_free].any():
        return None
    peak = int(np.argmax(np.where(is_free, power, 0.0)))
    half_width = max(_BAND_HALF_WIDTH * peak, 3.0)
    bands = [np.abs(bins - harmonic * peak) <= half_width for harmonic in (1, 2, 3)]
    in_bands = np.any(bands, axis=0)
    if power[is_free & in_bands].sum() < _LEAST_POWER_SHARE * power[is_free].sum():
        return None
    positive = np.where(bands[0] & is_free, 2.0 * np.fft.rfft(oscillation), 0.0)
    analytic_signal = np.fft.ifft(positive, n)  # its magnitude is the envelope
    envelope = np.abs(analytic_signal)[n // 10 : n - n // 10]  # without the ends of the window
    if not envelope.all():
        return None
    logarithm = np.log(envelope)
    x = np.linspace(-0.5, 0.5, len(envelope))
    slope, _ = np.polyfit(x, logarithm, 1)
    if slope < np.log(1.0 - _MOST_FALL) or np.std(logarithm - slope * x) > _MOST_SCATTER:
        return None
    return float(np.median(envelope)), peak / (n * dt)


def _command_bins(
    n: int,
    dt: float,
    commands: Sequence[Array],
    driven_Hz: Sequence[float],
    tangent_speeds: Array | None,
    normal_speed: Array | None,
) -> Flags:
    """Mask (n/2 + 1,) of the frequency bins with a line of a command or its low harmonics.

    Args:
        n: number of samples.
        dt: time between samples (s).
        commands: desired forces (n,) (N).
        driven_Hz: frequencies at which faces are driven (Hz).
        tangent_speeds: (n, m) speeds along the contacts (m/s).
        normal_speed: (n,) speed into the contact (m/s); None: not recorded.
    """
    lines = np.zeros(n // 2 + 1, dtype=bool)
    for command in commands:
        lines |= _lines(command, 1e-6 * np.abs(command).max(initial=1e-3))
    if tangent_speeds is not None and normal_speed is not None:
        inward = _spectrum(normal_speed)
        for speed in tangent_speeds.T:
            lines |= _lines(speed, _LEAST_SPEED) & (_spectrum(speed) > _LEAST_SPEED_RATIO * inward)
    for frequency in driven_Hz:
        centre = round(frequency * n * dt)
        lines[max(centre - 2, 0) : centre + 3] = True
    bins = np.arange(len(lines))
    # bin b belongs to harmonic h of the line in bin b/h
    harmonics = [lines[np.round(bins / harmonic).astype(int)] for harmonic in (1, 2, 3)]
    return np.any(harmonics, axis=0)


def _lines(signal: Array, least: float) -> Flags:
    """Mask (n/2 + 1,) of the frequency bins in which a signal has a line.

    Args:
        signal: (n,) samples.
        least: least amplitude of a line, in the unit of the signal; lines below the share `_LINE`
            of the largest line are left out, too.
    """
    spectrum = _spectrum(signal)
    return spectrum > max(_LINE * spectrum.max(), least)


def _spectrum(signal: Array) -> Array:
    """Amplitudes (n/2 + 1,) of a signal (n,) in each frequency bin, without its linear trend."""
    window = np.hanning(len(signal))
    return np.abs(np.fft.rfft(_remove_trend(signal) * window)) * (2.0 / window.sum())


def _remove_trend(signal: Array) -> Array:
    """Signal (n,) without its mean and linear trend.

    Args:
        signal: (n,) samples at equal intervals.
    """
    x = np.linspace(-1.0, 1.0, len(signal))
    level = signal - signal.mean()
    return level - x * (x @ level) / (x @ x)


def worst_cycles(recording: Recording, judged: Array, least: float) -> list[Cycle | None]:
    """Find the largest limit cycle of each force magnitude, relative to the mean command.

    Args:
        recording: recording with a judge.
        judged: (T, r) mask of the ticks that are evaluated.
        least: least amplitude relative to the mean command.

    Returns:
        Limit cycle of each force; None for a force without a limit cycle that is large enough.
    """
    dt = 1.0 / recording.meta["control_rate_hz"]
    driven = tuple(_frequencies(recording.meta.get("scenario", {})))
    names = ("alpha_cmd", "alpha_true", *(name for name in ("twist", "N") if name in recording))
    size = round(WINDOW_S / dt)
    cycles: list[Cycle | None] = [None] * judged.shape[1]
    for j in range(len(cycles)):
        for start, stop in stretches(judged[:, j]):
            while judged[start, j] and stop - start >= _SHORTEST_S / dt - 0.5:
                window = recording.rows(start, min(start + size, stop), *names)
                cycle = _cycle_in(window, j, dt, driven, least)
                largest = cycles[j]
                if cycle and (largest is None or cycle.relative > largest.relative):
                    cycles[j] = cycle
                if stop - start < size:
                    break
                start += size // 2
    return cycles


def _cycle_in(
    window: Mapping[str, Array], j: int, dt: float, driven_Hz: Sequence[float], least_share: float
) -> Cycle | None:
    """Find the limit cycle of force j in some ticks of a recording; None if there is none.

    Its amplitude is compared with the mean command; oscillations at the frequencies of commands and
    of driven faces do not count. Its compliance (m/N) is the amplitude of the motion along the
    normal, speed/(2π f), over that of the force.

    Args:
        window: channels of the ticks.
        j: index of the force.
        dt: control period (s).
        driven_Hz: frequencies at which faces are driven (Hz).
        least_share: least amplitude relative to the mean command.
    """
    commands = window["alpha_cmd"]
    error = window["alpha_true"][:, j] - commands[:, j]
    mean = float(np.abs(commands[:, j]).mean())
    amplitude_of_a_sine = np.sqrt(2.0) * error.std()
    if not amplitude_of_a_sine > least_share * mean > 0.0:
        return None
    tangent_speeds, normal_speed = _speeds(window, j) if "N" in window else (None, None)
    oscillation = find_cycle(error, dt, list(commands.T), driven_Hz, tangent_speeds, normal_speed)
    if oscillation is None:
        return None
    amplitude, frequency = oscillation
    compliance = None
    if normal_speed is not None:
        speed = _spectrum(normal_speed)[round(frequency * len(error) * dt)]
        compliance = float(speed) / (2.0 * np.pi * frequency * amplitude)
    return Cycle(amplitude, frequency, amplitude / mean, compliance)


def _speeds(window: Mapping[str, Array], j: int) -> tuple[Array, Array]:
    """Speeds of the object along its contacts (k, 6), and into the contact of force j (k,) (m/s).

    Angular velocities are converted to speeds by the lever `_ARM`, for a threshold only.

    Args:
        window: channels `twist` and `N` of k ticks.
        j: index of the force.
    """
    scale = np.array([1.0, 1.0, 1.0, _ARM, _ARM, _ARM])
    V = window["twist"] * scale
    N = window["N"] / scale[:, None]
    inward = np.einsum("kij,ki->kj", N, V)
    gram = N.transpose(0, 2, 1) @ N + 1e-9 * np.eye(N.shape[2])  # columns may depend
    normal_part = (N @ np.linalg.solve(gram, inward[:, :, None]))[:, :, 0]
    return V - normal_part, inward[:, j]


def _frequencies(scenario: Any, of_faces: bool = False) -> Iterator[float]:
    """Yield the frequencies of sines by which faces and bodies are driven.

    Args:
        scenario: a scenario as JSON data, or a part of it.
        of_faces: whether the part belongs to contacts or environment.
    """
    items = scenario.items() if isinstance(scenario, Mapping) else ()
    for key, value in items:
        if of_faces and key == "frequency" and isinstance(value, float | int):
            yield float(value)
        elif of_faces or key in ("contacts", "environment"):
            yield from _frequencies(value, True)
    for value in scenario if isinstance(scenario, list | tuple) else ():
        yield from _frequencies(value, of_faces)
