"""A study: one scenario, what varies in it, and which numbers each of its runs has."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from hashlib import sha256
from math import prod
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from osc_contact.errors import InvalidInputError, ScenarioError
from osc_contact.scenarios.loader import Template, read_text
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array
from osc_contact.sweeps.distributions import Distribution, parse_distribution

__all__ = ["SEED", "Design", "Sample", "SweepStudy"]

Design = Literal["halton", "sobol", "latin", "random", "grid", "saltelli"]
SEED = "seed"  #: a path that is no key of the scenario: the seed of a run
_BLOCK = 1024  #: points that are made at once


@dataclass(frozen=True)
class Sample:
    """The numbers of one run.

    Attributes:
        number: of the row. seed: of everything random. overrides: {path: value} of the scenario.
        shown: what varies, as the table shows it.
    """

    number: int
    seed: int
    overrides: dict[str, str]
    shown: dict[str, Any]


@dataclass(frozen=True)
class SweepStudy:
    """What a sweep runs; row i depends on nothing but this and i.

    Attributes:
        text, source: of the scenario. overrides: (path=value, …) of all runs.
        name: what `osc-contact run` calls the scenario; None: it was made in Python.
        vary: (path=distribution, …). samples: how many points; on a grid, how many values of each
            key that can have any; "saltelli" has two more runs of each than keys.
        design: where the points lie. seed: of the points, and of the runs if it does not vary.
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
        """A study of a packaged scenario, a file, or a scenario made in Python.

        Args:
            scenario: name, path, or a scenario made in Python.
            vary: "path.to.key=DISTRIBUTION", or a mapping of the same.
            samples: how many points; on a grid: values of each key that can have any.
            design: where the points lie.
            seed: of the points and of the runs.
            overrides: "path.to.key=value" of all runs.

        Raises:
            ScenarioError: it cannot be read; a path that cannot be set.
            InvalidInputError: no distribution, or one that is not understood.
        """
        if isinstance(scenario, Scenario):
            if scenario.laws is not None or any(
                getattr(one, "pair", None) is not None for one in scenario.contacts
            ):
                raise InvalidInputError(
                    "laws and pairs written in Python cannot be handed to other processes; run "
                    "such a scenario with osc.run, one by one"
                )
            text = json.dumps(scenario.as_dict(), indent=1)
            source = None if scenario.source is None else str(scenario.source.resolve())
            name = None
        else:
            text, path = read_text(scenario)
            source, name = str(path.resolve()), str(scenario)
        pairs = [f"{k}={v}" for k, v in vary.items()] if isinstance(vary, Mapping) else list(vary)
        study = cls(text, source, tuple(pairs), samples, design, seed, tuple(overrides), name)
        study.require_sound()
        return study

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, one.name) for one in fields(self))

    def require_sound(self) -> None:
        """Whether all of it can be understood, as far as the first row tells.

        Raises:
            InvalidInputError, ScenarioError: with what is wrong.
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
            self.template.make([*self.overrides, *_texts(sample.overrides)])
        except ScenarioError as error:
            raise ScenarioError(f"the first of the runs cannot be made:\n{error}") from error

    @cached_property
    def variations(self) -> tuple[tuple[str, Distribution], ...]:
        """(path, distribution) of each key that varies."""
        found = []
        for text in self.vary:
            path, equals, words = text.partition("=")
            if not equals:
                raise InvalidInputError(f"{text!r}: write path.to.key=distribution")
            found.append((path.strip(), parse_distribution(words)))
        return tuple(found)

    @cached_property
    def template(self) -> Template:
        """The scenario's text, read."""
        return Template(self.text, self.source)

    @cached_property
    def fingerprint(self) -> str:
        """What tells this study from others; how many samples it has does not."""
        content = asdict(self) | {"samples": self.samples if self.design in _WHOLE else None}
        del content["name"]
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    @cached_property
    def rows(self) -> int:
        """How many runs there are."""
        if self.design == "saltelli":
            return self.samples * (len(self.variations) + 2)
        return prod(self._levels) if self.design == "grid" else self.samples

    @cached_property
    def _levels(self) -> list[int]:
        return [d.levels or self.samples for _, d in self.variations for _ in range(d.dims)]

    @cached_property
    def _points(self) -> dict[int, Array]:
        return {}

    def sample(self, number: int) -> Sample:
        """The numbers of one run."""
        overrides: dict[str, str] = {}
        shown: dict[str, Any] = {}
        for path, text, values in self._drawn(self._point(number)):
            shown.update({path + suffix: value for suffix, value in values.items()})
            overrides[path] = text
        seed = int(overrides.pop(SEED, self.seed))
        return Sample(number, seed, overrides, shown)

    def values_at(self, u: Array) -> dict[str, str]:
        """{path: value} at a point: numbers (dims,) between 0 and 1."""
        return {path: text for path, text, _ in self._drawn(u)}

    def _drawn(self, u: Array) -> Iterator[tuple[str, str, dict[str, Any]]]:
        end = 0
        for path, distribution in self.variations:
            begin, end = end, end + distribution.dims
            text, values = distribution.draw(u[begin:end], self._said.get(path))
            yield path, text, values

    def command(self, number: int) -> str | None:
        """The line of a shell that runs one sample by itself; None: it was made in Python."""
        if self.name is None:
            return None
        sample = self.sample(number)
        words = ["osc-contact", "run", self.name]
        for change in (*self.overrides, *_texts(sample.overrides)):
            words += ["--set", change]
        return shlex.join([*words, "--seed", str(sample.seed)])

    @cached_property
    def _said(self) -> dict[str, Any]:
        """What the scenario says of the keys that vary."""
        return {
            path: self.template.value(path, self.overrides)
            for path, words in self.variations
            if path != SEED and words.text.startswith(("factor", "tilt"))
        }

    def _point(self, number: int) -> Array:
        """(dims,) numbers between 0 and 1."""
        if self.design == "grid":
            place = np.unravel_index(number, self._levels)
            ends = [d.ends for _, d in self.variations for _ in range(d.dims)]
            return np.array([
                int(i) / (n - 1) if end and n > 1 else (int(i) + 0.5) / n
                for i, n, end in zip(place, self._levels, ends, strict=True)
            ])  # fmt: skip
        if self.design == "saltelli":
            return self._exchanged(*divmod(number, len(self.variations) + 2))
        return self._in_block(number)

    def _exchanged(self, number: int, turn: int) -> Array:
        """Points A, B, and A with the numbers of one key from B after the other."""
        A, B = np.split(self._in_block(number), 2)
        if turn < 2:
            return B if turn else A
        ends = np.cumsum([distribution.dims for _, distribution in self.variations])
        key = np.searchsorted(ends, np.arange(len(A)), side="right")
        return np.where(key == turn - 2, B, A)

    def _in_block(self, number: int) -> Array:
        block = 0 if self.design in _WHOLE else number // _BLOCK
        if block not in self._points:
            self._points[block] = self._block(block)
        return self._points[block][number - block * _BLOCK]

    def _block(self, block: int) -> Array:
        dims = sum(distribution.dims for _, distribution in self.variations)
        if not dims or self.design == "random":
            return np.random.default_rng([self.seed, block]).random((_BLOCK, dims))
        from scipy.stats import qmc

        if self.design == "latin":
            return np.asarray(qmc.LatinHypercube(dims, rng=self.seed).random(self.samples))
        if self.design == "saltelli":
            dims *= 2
        kind = qmc.Halton if self.design == "halton" else qmc.Sobol
        points = kind(dims, scramble=True, rng=self.seed)
        if block:
            points.fast_forward(block * _BLOCK)
        return np.asarray(points.random(_BLOCK))


_WHOLE = ("latin", "grid")  #: designs whose points depend on how many there are


def _texts(overrides: Mapping[str, str]) -> list[str]:
    return [f"{path}={value}" for path, value in overrides.items()]
