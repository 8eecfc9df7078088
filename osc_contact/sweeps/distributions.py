"""What a key of a scenario may be in a study: words such as `uniform(5 mm, 10 mm)`.

Every word maps numbers between 0 and 1 to values, so that grids, random and quasi-random points
are all the same to it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["WORDS", "Distribution", "parse_distribution"]

_CALL = re.compile(r"\s*([a-z]+)\s*\((.*)\)\s*")
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")

Drawn = tuple[str, dict[str, Any]]  #: the text of an override; what stands in the table, by suffix


@dataclass(frozen=True)
class Distribution:
    """Values of one key.

    Attributes:
        text: as it was written. dims: how many numbers between 0 and 1 make a value.
        draw: (numbers (dims,), what the scenario says of the key) → value.
        levels: how many different values there are; 0: any number.
        ends: whether a grid takes both ends of it; else it takes the middles of equal parts.
    """

    text: str
    dims: int
    draw: Callable[[Array, Any], Drawn]
    levels: int = 0
    ends: bool = False


def parse_distribution(text: str) -> Distribution:
    """A distribution from its words, see `WORDS`.

    Raises:
        InvalidInputError: unknown words, or numbers that do not fit them.
    """
    match = _CALL.fullmatch(text)
    if match is None or match[1] not in WORDS:
        raise InvalidInputError(
            f"{text!r} is no distribution; write one of {', '.join(WORDS)} with its values, such "
            "as uniform(5 mm, 10 mm) or choice(filter, least_squares)"
        )
    make, shown = WORDS[match[1]]
    parts = _split(match[2])
    try:
        return make(text.strip(), parts)
    except (ValueError, IndexError) as error:
        raise InvalidInputError(f"{text!r}: {error}; it is written {shown}") from error


def _split(text: str) -> list[str]:
    """Parts between the commas that stand outside of brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "[{(") - (letter in "]})")
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


def _quantities(parts: Sequence[str], count: int) -> tuple[list[float], str]:
    """So many numbers with one unit."""
    if len(parts) != count:
        raise ValueError(f"{len(parts)} values given, {count} wanted")
    found = [_NUMBER.fullmatch(part) for part in parts]
    if None in found:
        raise ValueError(f"{parts[found.index(None)]!r} is no number with or without a unit")
    units = {match[2] for match in found if match}
    if len(units) > 1:
        raise ValueError(f"the units {sorted(units)} differ")
    return [float(match[1]) for match in found if match], units.pop()


def _with_unit(value: float, unit: str) -> Drawn:
    return f"{value!r} {unit}".strip(), {f" [{unit}]" if unit else "": value}


def _uniform(text: str, parts: list[str]) -> Distribution:
    (low, high), unit = _quantities(parts, 2)
    if not low < high:
        raise ValueError(f"{low:g} is not below {high:g}")

    def draw(u: Array, _: Any) -> Drawn:
        return _with_unit(low + float(u[0]) * (high - low), unit)

    return Distribution(text, 1, draw, ends=True)


def _loguniform(text: str, parts: list[str]) -> Distribution:
    (low, high), unit = _quantities(parts, 2)
    if not 0.0 < low < high:
        raise ValueError("both ends must be positive, the lower one first")

    def draw(u: Array, _: Any) -> Drawn:
        return _with_unit(low * (high / low) ** float(u[0]), unit)

    return Distribution(text, 1, draw, ends=True)


def _normal(text: str, parts: list[str]) -> Distribution:
    (mean, spread), unit = _quantities(parts, 2)
    if not spread > 0.0:
        raise ValueError("the standard deviation must be positive")
    law = NormalDist(mean, spread)

    def draw(u: Array, _: Any) -> Drawn:
        return _with_unit(law.inv_cdf(min(max(float(u[0]), 1e-9), 1.0 - 1e-9)), unit)

    return Distribution(text, 1, draw)


def _choice(text: str, parts: list[str]) -> Distribution:
    if not all(parts):
        raise ValueError("a value is missing")
    found = [_NUMBER.fullmatch(part) for part in parts]
    numbers = [float(match[1]) for match in found if match and not match[2]]
    shown = numbers if len(numbers) == len(parts) else parts

    def draw(u: Array, _: Any) -> Drawn:
        i = min(int(u[0] * len(parts)), len(parts) - 1)
        return parts[i], {"": shown[i]}

    return Distribution(text, 1, draw, len(parts))


def _integers(text: str, parts: list[str]) -> Distribution:
    low, high = (int(part) for part in parts)
    if not low <= high:
        raise ValueError(f"{low} is above {high}")
    count = high - low + 1

    def draw(u: Array, _: Any) -> Drawn:
        value = low + min(int(u[0] * count), count - 1)
        return str(value), {"": value}

    return Distribution(text, 1, draw, count)


def _factor(text: str, parts: list[str]) -> Distribution:
    (low, high), unit = _quantities(parts, 2)
    if unit or not low < high:
        raise ValueError("give two factors without a unit, the smaller one first")

    def draw(u: Array, said: Any) -> Drawn:
        value = low + float(u[0]) * (high - low)
        return _times(said, value), {" [factor]": value}

    return Distribution(text, 1, draw, ends=True)


def _times(said: Any, factor: float) -> str:
    """The text of a number, a quantity or a list of them, times a factor."""
    if isinstance(said, list | tuple):
        return "[" + ", ".join(_times(one, factor) for one in said) + "]"
    match = None if isinstance(said, bool) else _NUMBER.fullmatch(str(said))
    if match is None:
        raise InvalidInputError(f"factor(…) multiplies a number; the scenario says {said!r}")
    return f"{float(match[1]) * factor!r} {match[2]}".strip()


def _tilt(text: str, parts: list[str]) -> Distribution:
    (most,), unit = _quantities(parts, 1)
    most = np.deg2rad(most) if unit == "deg" else most
    if unit not in ("deg", "rad", "") or not 0.0 < most <= np.pi:
        raise ValueError("give the largest angle in deg or rad, at most 180 deg")

    def draw(u: Array, said: Any) -> Drawn:
        n = np.array(said, dtype=float)
        n /= np.linalg.norm(n)
        angle = float(np.arccos(1.0 - float(u[0]) * (1.0 - np.cos(most))))
        heading = 2.0 * np.pi * float(u[1])
        a = np.cross(np.eye(3)[int(np.abs(n).argmin())], n)
        a /= np.linalg.norm(a)
        side = np.cos(heading) * a + np.sin(heading) * np.cross(n, a)
        tilted = np.cos(angle) * n + np.sin(angle) * side
        shown = ", ".join(repr(float(x)) for x in tilted)
        return f"[{shown}]", {".tilt [rad]": angle, ".heading [rad]": heading}

    return Distribution(text, 2, draw)


#: Words, what makes distributions of them, and how they are written.
WORDS: dict[str, tuple[Callable[[str, list[str]], Distribution], str]] = {
    "uniform": (_uniform, "uniform(LOW, HIGH), in one unit"),
    "loguniform": (_loguniform, "loguniform(LOW, HIGH), both positive, in one unit"),
    "normal": (_normal, "normal(MEAN, STANDARD DEVIATION), in one unit"),
    "factor": (_factor, "factor(LOW, HIGH) of what the scenario says"),
    "tilt": (_tilt, "tilt(ANGLE): a direction of the scenario turned by at most so much"),
    "choice": (_choice, "choice(A, B, …), any values"),
    "integers": (_integers, "integers(LOW, HIGH), both included"),
}
