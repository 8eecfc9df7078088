"""Rows of a run that goes with its process."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy.typing as npt

__all__ = ["MemoryJournal"]

Array = npt.NDArray[Any]


class MemoryJournal:
    """Rows kept in memory, for runs that are short and need not survive a kill.

    Attributes:
        error: None, memory does not fail.
    """

    error = None

    def __init__(self) -> None:
        """Begin with no rows."""
        self._kept: list[tuple[int, Array]] = []

    def append(self, first: int, rows: Array) -> None:
        """Keep rows, of which the first has this number."""
        self._kept.append((first, rows.copy()))

    def rows(self) -> Iterator[tuple[int, Array]]:
        """(number of the first row, rows), in order."""
        return iter(self._kept)

    def close(self) -> None:
        """Nothing to do."""

    def read(self) -> MemoryJournal:
        """The rows are in memory: the journal itself."""
        return self
