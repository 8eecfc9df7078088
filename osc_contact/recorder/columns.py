"""Arrays that stay on disk: read in pieces, written in pieces."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from osc_contact.errors import RecordingError

__all__ = ["IN_MEMORY", "Column", "ColumnFile", "OpenFile", "gather", "pieces"]

Array = npt.NDArray[Any]
IN_MEMORY = 32 << 20  #: bytes; recordings up to this size are kept in memory
_PIECE = 4096  #: ticks that are read or written at once


class OpenFile:
    """A file that stays open as long as it is read from."""

    def __init__(self, descriptor: int) -> None:
        """Keep a file open of its own; the descriptor given may be closed."""
        self.number = os.dup(descriptor)

    def __del__(self) -> None:
        os.close(self.number)


@dataclass(frozen=True)
class Column:
    """An array in a file, of which any stretch of its first axis can be read.

    Attributes:
        file: several columns may share it.
        offset: bytes before its first number. dtype, shape: of the array, in C order.
    """

    file: OpenFile
    offset: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def nbytes(self) -> int:
        """Bytes of the whole array."""
        return prod(self.shape) * self.dtype.itemsize

    def read(self, start: int = 0, stop: int | None = None) -> Array:
        """The rows start to stop − 1, as an array of their own.

        Raises:
            RecordingError: the file cannot be read, or ends too early.
        """
        start, stop, _ = slice(start, stop).indices(len(self))
        out = np.empty((max(0, stop - start), *self.shape[1:]), self.dtype)
        if not out.size:
            return out
        left = out.reshape(-1).data.cast("B")
        at = self.offset + start * (self.nbytes // len(self))
        try:
            while left:
                count = os.preadv(self.file.number, [left[: 1 << 30]], at)
                if not count:
                    raise RecordingError(f"a recording ends at byte {at}, within its numbers")
                left, at = left[count:], at + count
        except OSError as error:
            raise RecordingError(f"a recording cannot be read: {error}") from error
        return out


class ColumnFile:
    """Columns of one length in one unnamed file, which goes with the last of them."""

    def __init__(self, ticks: int, like: Mapping[str, Array], folder: Path | None = None) -> None:
        """Make room, without writing.

        Args:
            ticks: length of every column.
            like: rows of each, for names, types and shapes.
            folder: where the file is; None: among the system's temporary files.

        Raises:
            RecordingError: there can be no file.
        """
        try:
            with tempfile.TemporaryFile(dir=folder, buffering=0) as made:
                file = OpenFile(made.fileno())
        except OSError as error:
            raise RecordingError(f"no room for a recording's channels: {error}") from error
        self.columns: dict[str, Column] = {}
        at = 0
        for name, rows in like.items():
            column = Column(file, at, rows.dtype, (ticks, *rows.shape[1:]))
            self.columns[name], at = column, at + column.nbytes

    def put(self, start: int, rows: Mapping[str, Array]) -> None:
        """Write rows of every column, from `start` on.

        Raises:
            RecordingError: the disk is full, or fails.
        """
        for name, values in rows.items():
            column = self.columns[name]
            left = memoryview(np.ascontiguousarray(values).tobytes())
            at = column.offset + start * (column.nbytes // max(1, len(column)))
            try:
                while left:
                    count = os.pwrite(column.file.number, left, at)
                    left, at = left[count:], at + count
            except OSError as error:
                raise RecordingError(f"cannot write channel {name!r}: {error}") from error


def pieces(values: Array | Column) -> Iterator[Array]:
    """The whole of a column, some thousand rows at a time."""
    for start in range(0, len(values), _PIECE):
        stop = start + _PIECE
        yield values.read(start, stop) if isinstance(values, Column) else values[start:stop]


def gather(
    ticks: int, parts: Iterable[Mapping[str, Array]], folder: Path | None = None
) -> dict[str, Array | Column]:
    """Columns of rows that come part after part: in memory, or in a file if they are large.

    Args:
        ticks: of all parts together. parts: the same names in each.
        folder: where the file would be; None: among the system's temporary files.

    Raises:
        RecordingError: the disk is full, or fails.
    """
    arrays: dict[str, Array] = {}
    file, start = None, 0
    for part in parts:
        stop = start + len(next(iter(part.values())))
        if not arrays and file is None:
            width = sum(values.nbytes // max(1, len(values)) for values in part.values())
            if ticks * width > IN_MEMORY:
                file = ColumnFile(ticks, part, folder)
            else:
                arrays = {
                    name: np.empty((ticks, *values.shape[1:]), values.dtype)
                    for name, values in part.items()
                }
        if file is not None:
            file.put(start, part)
        for name, values in arrays.items():
            values[start:stop] = part[name]
        start = stop
    return {**arrays} if file is None else {**file.columns}
