"""The log of a run whose ticks may be compiled: the same rows, filled without Python."""

from __future__ import annotations

import numpy as np

from osc_contact.interface import Measurement
from osc_contact.plants.mujoco_truth import MujocoTruth
from osc_contact.runs.log import Log
from osc_contact.spatial import Array

__all__ = ["DrivenLog"]


class DrivenLog(Log):
    """A `Log` into whose tables compiled code can write.

    Attributes:
        table: (BLOCK, …) rows. filled: how many of them hold ticks.
    """

    @property
    def table(self) -> Array:
        """(BLOCK, …) rows of numbers, see `Log`."""
        return self._rows

    @property
    def filled(self) -> int:
        """How many rows hold ticks that were not flushed."""
        return self._k

    def filled_to(self, row: int) -> None:
        """Take over rows that were filled from outside."""
        self.count += row - self._k
        self._k = row
        assert isinstance(self.truth, MujocoTruth)
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
