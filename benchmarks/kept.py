"""Verdicts of long benchmarks that are kept, so that the same command goes on where it was cut."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable
from dataclasses import asdict, is_dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

ROOT = Path(__file__).parents[1]
SOURCES = ("osc_contact", "benchmarks", "urdf")


class Keyed(Protocol):
    """A verdict: a dataclass with the key of the run that it is of."""

    @property
    def key(self) -> Hashable:
        """Identity of the run among those of its benchmark."""


V = TypeVar("V", bound=Keyed)


class Kept(Generic[V]):
    """Verdicts in a file of these sources, by their keys.

    Attributes:
        found: those that are there.
    """

    def __init__(self, folder: Path, read: Callable[[dict[str, Any]], V]) -> None:
        """Read those that are there.

        Args:
            folder: of the file. read: makes a verdict of the fields that it was kept with.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{_hash_sources()}.jsonl"
        self.found: dict[Hashable, V] = {}
        if self._path.exists():
            for line in self._path.read_text().splitlines(keepends=True):
                if line.endswith("\n"):  # others were cut by a kill
                    verdict = read(json.loads(line))
                    self.found[verdict.key] = verdict

    def add(self, verdict: V) -> None:
        """Keep one."""
        assert is_dataclass(verdict) and not isinstance(verdict, type)
        self.found[verdict.key] = verdict
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(verdict)) + "\n")


def _hash_sources() -> str:
    """Hash of all files that a verdict depends on."""
    digest = sha256()
    for part in SOURCES:
        for path in sorted((ROOT / part).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
