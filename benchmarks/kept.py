"""Verdicts of long benchmarks in a file, so that an interrupted command can be continued."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable
from dataclasses import asdict, is_dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

ROOT = Path(__file__).parents[1]
SOURCES = ("osc_contact", "benchmarks", "urdf")  #: folders of files on which verdicts depend


class Keyed(Protocol):
    """Verdict on one run of a benchmark, which must be a dataclass."""

    @property
    def key(self) -> Hashable:
        """Identity of the run among those of its benchmark."""


V = TypeVar("V", bound=Keyed)


class Kept(Generic[V]):
    """Verdicts of runs with the present sources, in a file with one line of JSON for each.

    The name of the file is the hash of the sources, so that verdicts of other sources are not used.

    Attributes:
        found: verdicts in the file, by their keys.
    """

    def __init__(self, folder: Path, read: Callable[[dict[str, Any]], V]) -> None:
        """Read the verdicts that are in the file already.

        Args:
            folder: folder of the file, made if it does not exist.
            read: function that makes a verdict of its fields by name.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{_hash_sources()}.jsonl"  #: file of the verdicts
        self.found: dict[Hashable, V] = {}
        if self._path.exists():
            for line in self._path.read_text().splitlines(keepends=True):
                if line.endswith("\n"):  # a process that was killed leaves an incomplete line
                    verdict = read(json.loads(line))
                    self.found[verdict.key] = verdict

    def add(self, verdict: V) -> None:
        """Add a verdict to `found` and to the file.

        Args:
            verdict: verdict on a run.
        """
        assert is_dataclass(verdict) and not isinstance(verdict, type)
        self.found[verdict.key] = verdict
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(verdict)) + "\n")


def _hash_sources() -> str:
    """Hash (16 hexadecimal digits) of the contents of all files in the folders `SOURCES`."""
    digest = sha256()
    for part in SOURCES:
        for path in sorted((ROOT / part).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
