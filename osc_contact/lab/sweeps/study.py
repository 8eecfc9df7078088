"""Study of a scenario: keys that vary, and the values that each run has.

A key of the scenario may vary by a distribution, written as text such as `uniform(5 mm, 10 mm)`. A
distribution maps numbers between 0 and 1 to values, for grids, random and quasi-random points.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from functools import cached_property
from hashlib import sha256
from math import prod
from pathlib import Path
from statistics import NormalDist
from typing import Any, Literal, get_args

import numpy as np

from osc_contact.errors import InvalidInputError, ScenarioError
from osc_contact.files import Json
from osc_contact.lab.scenarios.loader import Template, read_text
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.spatial import Array, norm

# --- Distributions ------------------------------------------------------------------------------

_CALL_PATTERN = re.compile(r"\s*([a-z]+)\s*\((.*)\)\s*")
_NUMBER_PATTERN = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")

Cell = str | int | float  #: value of a column of the table
#: Value of a distribution: text of an override, and values of the table's columns by suffix.
Drawn = tuple[str, dict[str, Cell]]


@dataclass(frozen=True)
class Distribution:
    """Distribution of the values of one key.

    Attributes:
        dims: number of coordinates between 0 and 1 that determine a value.
        draw: function of the coordinates (dims,) and, if `relative`, of the scenario's own value of
            the key, that returns the value.
        levels: number of different values; 0: infinitely many.
        ends: True if a grid contains both ends; False: the middles of equal intervals.
        relative: True if values depend on the scenario's own value.
    """

    dims: int
    draw: Callable[[Array, Any], Drawn]
    levels: int = 0
    ends: bool = False
    relative: bool = False


Make = Callable[[Sequence[str]], Distribution]  #: function of the parts between the commas


def parse_distribution(text: str) -> Distribution:
    """Make the distribution of a text such as "uniform(5 mm, 10 mm)"; `WORDS` lists all.

    Args:
        text: word and, in brackets, its values.

    Raises:
        InvalidInputError: an unknown word, or unsuitable numbers.
    """
    match = _CALL_PATTERN.fullmatch(text)
    if match is None or match[1] not in WORDS:
        raise InvalidInputError(
            f"{text!r} is no distribution; write one of {', '.join(WORDS)} with its values, such "
            "as uniform(5 mm, 10 mm) or choice(filter, least_squares)"
        )
    make, syntax = WORDS[match[1]]
    try:
        return make(_split(match[2]))
    except (ValueError, IndexError) as error:
        raise InvalidInputError(f"{text!r}: {error}; it is written {syntax}") from error


def _split(text: str) -> list[str]:
    """Split a text at the commas that are outside of brackets.

    Args:
        text: values of a distribution, such as "[0, 1], [1, 0]".
    """
    parts = [""]
    depth = 0
    for letter in text:
        if letter in "[{(":
            depth += 1
        elif letter in "]})":
            depth -= 1
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


def _quantities(parts: Sequence[str], count: int) -> tuple[list[float], str]:
    """Read numbers with a common unit from texts.

    Args:
        parts: texts such as "0.2", "5 mm" or "3 deg".
        count: required number of texts.

    Returns:
        The numbers, and their unit, "" without a unit.

    Raises:
        ValueError: another count, texts that are not numbers, or different units.
    """
    if len(parts) != count:
        raise ValueError(f"{len(parts)} values given, {count} needed")
    values = []
    units = set()
    for part in parts:
        match = _NUMBER_PATTERN.fullmatch(part)
        if match is None:
            raise ValueError(f"{part!r} is no number with or without a unit")
        values.append(float(match[1]))
        units.add(match[2])
    if len(units) > 1:
        raise ValueError(f"the units {sorted(units)} differ")
    return (values, units.pop())


def _scalar(at: Callable[[float, float, float], float]) -> Make:
    """Function that makes distributions of two numbers with a common unit.

    Args:
        at: function of a coordinate between 0 and 1 and the two numbers that returns the value.
    """

    def make(parts: Sequence[str]) -> Distribution:
        """Make the distribution of two numbers, each with the same unit or none.

        Its value at a coordinate u in 0 … 1 is at(u, first number, second number), with the
        function `at` of the enclosing call.

        Args:
            parts: two texts, numbers with or without a unit.
        """
        (first, second), unit = _quantities(parts, 2)
        at(0.5, first, second)  # refuses unsuitable numbers
        suffix = f" [{unit}]" if unit else ""

        def draw(u: Array, _: Any) -> Drawn:
            """Value at the coordinate u (1,) as a number with its unit."""
            x = at(float(u[0]), first, second)
            return (f"{x!r} {unit}".strip(), {suffix: x})

        return Distribution(1, draw, ends=at is not _normal)

    return make


def _uniform(u: float, low: float, high: float) -> float:
    """Value at u of the uniform distribution between two numbers."""
    if low >= high:
        raise ValueError("the first number must be below the second")
    return low + u * (high - low)


def _loguniform(u: float, low: float, high: float) -> float:
    """Value at u of the distribution with a uniform logarithm between two numbers."""
    if not 0.0 < low < high:
        raise ValueError("both ends must be positive, the lower one first")
    return low * (high / low) ** u


def _normal(u: float, mean: float, spread: float) -> float:
    """Value at u of the normal distribution; `spread` is its standard deviation."""
    if spread <= 0.0:
        raise ValueError("the standard deviation must be positive")
    return NormalDist(mean, spread).inv_cdf(min(max(u, 1e-9), 1 - 1e-9))


def _factor(parts: Sequence[str]) -> Distribution:
    """Distribution of the scenario's own value times a uniform factor.

    Args:
        parts: texts of the lowest and the highest factor.
    """
    uniform = _scalar(_uniform)(parts)
    if _quantities(parts, 2)[1]:
        raise ValueError("give two factors without a unit")

    def draw(u: Array, value: Any) -> Drawn:
        """The scenario's value times the factor at the coordinate u (1,)."""
        x = float(uniform.draw(u, None)[0])
        return (_times(value, x), {" [factor]": x})

    return Distribution(1, draw, ends=True, relative=True)


def _choice(parts: Sequence[str], values: Sequence[Cell] = ()) -> Distribution:
    """Distribution of some texts with equal probability.

    Args:
        parts: the texts.
        values: their values in the table; by default numbers, if all texts are numbers.
    """
    if not all(parts):
        raise ValueError("a value is missing")
    if not values:
        try:
            values = [float(part) for part in parts]
        except ValueError:
            values = parts

    def draw(u: Array, _: Any) -> Drawn:
        """Text at the coordinate u (1,), which is divided into equal intervals."""
        i = min(int(u[0] * len(parts)), len(parts) - 1)
        return (parts[i], {"": values[i]})

    return Distribution(1, draw, len(parts))


def _integers(parts: Sequence[str]) -> Distribution:
    """Distribution of the integers between two numbers, both included.

    Args:
        parts: two texts, whole numbers.

    Raises:
        ValueError: the first number is above the second.
    """
    low, high = map(int, parts)
    if low > high:
        raise ValueError(f"{low} is above {high}")
    values = range(low, high + 1)
    return _choice([str(value) for value in values], values)


def _times(value: Any, factor: float) -> str:
    """Text of a number, a quantity or a list of them, times a factor.

    Args:
        value: number, text with a number and a unit, or list of these.
        factor: factor of each.

    Raises:
        InvalidInputError: a value is not a number.
    """
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_times(item, factor) for item in value) + "]"
    match = None if isinstance(value, bool) else _NUMBER_PATTERN.fullmatch(str(value))
    if match is None:
        raise InvalidInputError(f"factor(…) multiplies a number; the scenario has {value!r}")
    return f"{float(match[1]) * factor!r} {match[2]}".strip()


def _tilt(parts: Sequence[str]) -> Distribution:
    """Distribution of the scenario's own direction, tilted by at most an angle, uniform in area.

    Args:
        parts: text of the largest angle, in deg or rad.
    """
    (largest,), unit = _quantities(parts, 1)
    largest = np.deg2rad(largest) if unit == "deg" else largest
    if unit not in ("deg", "rad", "") or not 0.0 < largest <= np.pi:
        raise ValueError("give the largest angle in deg or rad, at most 180 deg")

    def draw(u: Array, value: Any) -> Drawn:
        """Tilt a direction by an angle, at most `largest`, about a random axis across it.

        Args:
            u: (2,) point in [0, 1)²: cosine of the angle, heading of the tilt.
            value: (3,) direction of the scenario.
        """
        n = np.array(value, dtype=float)
        n /= norm(n)
        angle = float(np.arccos(1.0 - u[0] * (1.0 - np.cos(largest))))
        heading = 2.0 * np.pi * float(u[1])
        a = np.cross(np.eye(3)[np.abs(n).argmin()], n)  # across n, by the axis furthest from it
        a /= norm(a)
        side = np.cos(heading) * a + np.sin(heading) * np.cross(n, a)
        tilted = np.cos(angle) * n + np.sin(angle) * side
        return (str(tilted.tolist()), {".tilt [rad]": angle, ".heading [rad]": heading})

    return Distribution(2, draw, relative=True)


#: By word, the function that makes its distributions, and its syntax.
WORDS: dict[str, tuple[Make, str]] = {
    "uniform": (_scalar(_uniform), "uniform(LOW, HIGH), in one unit"),
    "loguniform": (_scalar(_loguniform), "loguniform(LOW, HIGH), both positive, in one unit"),
    "normal": (_scalar(_normal), "normal(MEAN, STANDARD DEVIATION), in one unit"),
    "factor": (_factor, "factor(LOW, HIGH) of the scenario's value, without a unit"),
    "tilt": (_tilt, "tilt(ANGLE): a direction of the scenario turned by at most so much"),
    "choice": (_choice, "choice(A, B, …), any values"),
    "integers": (_integers, "integers(LOW, HIGH), both included"),
}


# --- Samples ------------------------------------------------------------------------------------

Design = Literal["halton", "sobol", "random", "grid", "saltelli"]
SEED = "seed"  #: path of the seed of a run, which is not a key of the scenario
_BLOCK = 1024  #: points that are computed together


@dataclass(frozen=True)
class Sample:
    """Values of one run.

    Attributes:
        number: number of the row.
        seed: seed of everything random.
        overrides: values of keys of the scenario by path.
        shown: columns of the table with the values that vary.
    """

    number: int
    seed: int
    overrides: dict[str, str]
    shown: dict[str, Cell]


@dataclass(frozen=True)
class SweepStudy:
    """Study of a scenario; row i depends on the study and on i only.

    Attributes:
        text: text of the scenario.
        source: file of the scenario; None: none.
        vary: texts path=distribution.
        samples: number of points; of a grid, number of values of each key with infinitely many;
            with the design "saltelli" each point gives as many runs as there are keys, plus two.
        design: placement of the points.
        seed: seed of the points, and of the runs if that does not vary.
        overrides: texts path=value of all runs.
        name: name of the scenario for `osc-contact run`; None: it was made in Python.
    """

    text: str
    source: str | None
    vary: tuple[str, ...]
    samples: int
    design: Design = "halton"
    seed: int = 0
    overrides: tuple[str, ...] = ()
    name: str | None = None

    @classmethod
    def of(
        cls,
        scenario: str | Path | Scenario,
        vary: Mapping[str, str] | Sequence[str],
        samples: int,
        design: Design = "halton",
        seed: int = 0,
        overrides: Sequence[str] = (),
    ) -> SweepStudy:
        """Study of a packaged scenario, a file, or a scenario made in Python.

        Args:
            scenario: name, path, or a scenario made in Python.
            vary: texts "path.to.key=DISTRIBUTION", or distributions by path.
            samples: number of points; of a grid, number of values of each key with infinitely
                many.
            design: placement of the points.
            seed: seed of the points, and of the runs if that does not vary.
            overrides: texts "path.to.key=value" of all runs.

        Raises:
            ScenarioError: the scenario cannot be read, or a path cannot be set.
            InvalidInputError: no distribution, or a wrong one.
        """
        if isinstance(scenario, Scenario):
            has_own_pairs = any(
                getattr(contact, "pair", None) is not None for contact in scenario.contacts
            )
            if scenario.laws is not None or has_own_pairs:
                raise InvalidInputError(
                    "laws and pairs written in Python cannot be handed to other processes; run "
                    "such a scenario with osc.run, one by one"
                )
            text = json.dumps(scenario.as_dict(), indent=1)
            path = scenario.source
            name = None
        else:
            text, path = read_text(scenario)
            name = str(scenario)
        source = None if path is None else str(path.resolve())
        pairs = texts(vary) if isinstance(vary, Mapping) else vary
        study = cls(text, source, tuple(pairs), samples, design, seed, tuple(overrides), name)
        study.require_sound()
        return study

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the points: scipy.stats, which takes a second to import, is not needed."""
        return (type(self), astuple(self), {"_points": self._points})

    def require_sound(self) -> None:
        """Refuse a study that has errors; the scenario is checked with the values of the first run.

        Raises:
            InvalidInputError: wrong numbers of keys, samples or runs, or an unknown design.
            ScenarioError: the scenario of the first row has errors.
        """
        if not self.vary or self.samples < 1:
            raise InvalidInputError(
                f"{len(self.vary)} keys vary, {self.samples} samples: give at least one of both"
            )
        if self.design not in get_args(Design):
            raise InvalidInputError(f"design {self.design!r}; give one of {get_args(Design)}")
        if self.design == "saltelli" and self.samples & (self.samples - 1):
            raise InvalidInputError(
                f"{self.samples} samples: the design saltelli needs a power of two, such as "
                f"{1 << self.samples.bit_length()}"
            )
        paths = [path for path, _ in self.variations]
        if len(set(paths)) < len(paths):
            raise InvalidInputError(f"a key varies twice: {paths}")
        sample = self.sample(0)
        try:
            self.scenario(sample)
        except ScenarioError as error:
            raise ScenarioError(f"the first of the runs cannot be made:\n{error}") from error

    @cached_property
    def variations(self) -> tuple[tuple[str, Distribution], ...]:
        """Path and distribution of each key that varies.

        Raises:
            InvalidInputError: a text without "=", or a wrong distribution.
        """
        variations = []
        for text in self.vary:
            path, equals, words = text.partition("=")
            if not equals:
                raise InvalidInputError(f"{path!r}: write path.to.key=distribution")
            variations.append((path.strip(), parse_distribution(words)))
        return tuple(variations)

    @cached_property
    def template(self) -> Template:
        """Parsed text of the scenario."""
        return Template(self.text, self.source)

    @cached_property
    def fingerprint(self) -> str:
        """Identifier of the study, independent of the number of samples (unless on a grid)."""
        content = asdict(self) | {"samples": self.samples if self.design == "grid" else None}
        del content["name"]
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    @cached_property
    def rows(self) -> int:
        """Number of runs."""
        if self.design == "saltelli":
            return self.samples * (len(self.variations) + 2)
        return prod(self._levels) if self.design == "grid" else self.samples

    @cached_property
    def _levels(self) -> list[int]:
        """Number of values of a grid along each coordinate."""
        levels = []
        for _, distribution in self.variations:
            count = distribution.levels if distribution.levels else self.samples
            levels += [count] * distribution.dims
        return levels

    @cached_property
    def _points(self) -> dict[int, Array]:
        """Points that were computed, by number of their block."""
        return {}

    def sample(self, number: int) -> Sample:
        """Values of a run, by its number."""
        overrides, values = self.at(self._point(number))
        seed = int(overrides.pop(SEED, self.seed))
        return Sample(number, seed, overrides, values)

    def at(self, u: Array) -> tuple[dict[str, str], dict[str, Cell]]:
        """Values of all keys at a point.

        Args:
            u: (dims,) coordinates between 0 and 1, of all keys in order.

        Returns:
            Overrides of the scenario by path, and values of the table by column. Distributions that
            are relative to the scenario's own value get it from `_own_values`.
        """
        overrides = {}
        columns: dict[str, Cell] = {}
        remaining = u
        for path, distribution in self.variations:
            coordinates, remaining = np.split(remaining, [distribution.dims])
            overrides[path], values = distribution.draw(coordinates, self._own_values.get(path))
            columns |= {path + suffix: value for suffix, value in values.items()}
        return (overrides, columns)

    def scenario(self, sample: Sample) -> Scenario:
        """Scenario of a run."""
        return self.template.make([*self.overrides, *texts(sample.overrides)])

    def command(self, number: int) -> str | None:
        """Command line that repeats a run; None for a scenario made in Python.

        Args:
            number: number of the sample.
        """
        if self.name is None:
            return None
        sample = self.sample(number)
        words = ["osc-contact", "run", self.name]
        for change in (*self.overrides, *texts(sample.overrides)):
            words += ["--set", change]
        return shlex.join([*words, "--seed", str(sample.seed)])

    @cached_property
    def _own_values(self) -> Json:
        """Own values of the scenario, by path, of keys that vary relative to them."""
        return {
            path: self.template.value(path, self.overrides)
            for path, distribution in self.variations
            if path != SEED and distribution.relative
        }

    def _point(self, number: int) -> Array:
        """Compute the point (dims,) of a run, coordinates between 0 and 1 of all varied keys.

        On a grid the index of the run is divided into one index for each coordinate (of `_levels`
        values), spaced from
        end to end or, for distributions without ends, in the middles of equal intervals. Each
        sample of the design "saltelli" gives the points A, B, and A with one key of B. Other
        designs take the points of a sequence.

        Args:
            number: number of the run.
        """
        dims = [distribution.dims for _, distribution in self.variations]
        if self.design == "grid":
            levels = np.array(self._levels)
            indices = np.array(np.unravel_index(number, levels))
            has_ends = np.repeat([distribution.ends for _, distribution in self.variations], dims)
            middles = (indices + 0.5) / levels
            spaced = indices / np.maximum(levels - 1, 1)
            return np.where(has_ends & (levels > 1), spaced, middles)
        if self.design == "saltelli":
            sample, member = divmod(number, len(self.variations) + 2)
            A, B = np.split(self._in_block(sample), 2)
            if member == 0:
                return A
            if member == 1:
                return B
            key_of_coordinate = np.repeat(range(len(dims)), dims)
            return np.where(key_of_coordinate == member - 2, B, A)
        return self._in_block(number)

    def _in_block(self, number: int) -> Array:
        """Sample point (dims,), between 0 and 1, of a design other than the grid, by its number."""
        block, place = divmod(number, _BLOCK)
        if block not in self._points:
            self._points[block] = self._block(block)
        return self._points[block][place]

    def _block(self, block: int) -> Array:
        """Sample points of one block of the design, coordinates between 0 and 1.

        Args:
            block: index of the block; block i has the points i `_BLOCK` … (i + 1) `_BLOCK` − 1 of
                the sequence.

        Returns:
            (_BLOCK, dims) points, dims the number of varied values; for "saltelli" (_BLOCK, 2 dims)
            with the points A and B side by side.
        """
        dims = len(self._levels)
        if not dims or self.design == "random":
            return np.random.default_rng([self.seed, block]).random((_BLOCK, dims))
        from scipy.stats import qmc

        if self.design == "saltelli":
            dims *= 2
        kind = qmc.Halton if self.design == "halton" else qmc.Sobol
        points = kind(dims, scramble=True, rng=self.seed)
        if block:
            points.fast_forward(block * _BLOCK)
        return points.random(_BLOCK)


def texts(overrides: Mapping[str, str]) -> list[str]:
    """Texts path=value of overrides by path."""
    return [f"{path}={value}" for path, value in overrides.items()]
