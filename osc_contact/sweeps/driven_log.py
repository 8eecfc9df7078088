"""The log of a run whose ticks are compiled: the same rows, filled without Python."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from osc_contact.interface import Measurement
from osc_contact.plants.judge import Judge
from osc_contact.plants.mujoco_truth import MujocoTruth
from osc_contact.runs.log import BLOCK, Log, Subject
from osc_contact.spatial import Array

__all__ = ["DrivenLog", "MemoryJournal"]


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


class DrivenLog(Log):
    """A `Log` into whose tables compiled code writes.

    Attributes:
        table: (BLOCK, …) rows. filled: how many of them hold ticks.
    """

    truth: MujocoTruth

    def __init__(self, of: Subject, judge: Judge) -> None:
        """Lay out the rows of a MuJoCo plant's run."""
        super().__init__(of, judge, MemoryJournal())  # type: ignore[arg-type]

    @property
    def table(self) -> Array:
        """(BLOCK, …) rows of numbers, see `Log`."""
        return self._rows

    @property
    def filled(self) -> int:
        """How many rows hold ticks that were not flushed."""
        return self._k

    def make_room(self) -> None:
        """Flush full tables."""
        if self._k == BLOCK:
            self.flush()

    def filled_to(self, row: int) -> None:
        """Take over rows that were filled from outside."""
        self.count += row - self._k
        self._k = row
        self.truth.noted_to(row)

    def sources(self, measurement: Measurement) -> Array:
        """(m, 2) address and count of the numbers that follow q, v, τ, α_d in each row."""
        parts = [part for part in self._last_result(measurement) if part.size]
        return np.array([(_address(part), part.size) for part in parts], dtype=np.int64)

    def tail(self) -> tuple[Array, Array]:
        """The numbers behind those, the same after every tick that ended well.

        Returns:
            The numbers, all that is timed 0; and (m, 2) address and value of the flags of contact
            phases with which they are the same.
        """
        tail = self._rows[self._k - 1, self._copied :].copy()
        tail[0] = 0.0
        if self.of.controller.life is None:
            return tail, np.zeros((0, 2), dtype=np.int64)
        rows = self.of.controller._records
        of_contacts = [rows.contacts.active, rows.contacts.phase]
        of_columns = [rows.column_memory.closed, rows.column_memory.collision]
        flags = [
            (int(x.__array_interface__["data"][0]) + i * x.strides[0], x[i])
            for x in (*of_contacts, *of_columns)
            for i in range(len(x))
        ]
        return tail, np.array(flags, dtype=np.int64).reshape(-1, 2)


def _address(x: Array) -> int:
    if not x.flags.c_contiguous or x.dtype != float:
        raise TypeError("a part of a row does not lie in one piece")
    return int(x.__array_interface__["data"][0])
