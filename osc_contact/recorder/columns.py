"""Arrays of long recordings: in a file, mapped into memory where they are read."""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from osc_contact.errors import RecordingError

__all__ = ["IN_MEMORY", "gather", "is_mapped", "read_column"]

Array = npt.NDArray[Any]
IN_MEMORY = 32 << 20  #: bytes; recordings up to this size are kept in memory
_ALIGNED = 64  #: bytes between which columns begin


def is_mapped(column: Array) -> bool:
    """Whether a column is that of a file, which nothing can be written to."""
    return not column.flags.writeable


def read_column(column: Array, start: int = 0, stop: int | None = None) -> Array:
    """Rows of a column: of a mapped file a copy, and its pages are given back.

    Args:
        column: of a recording. start, stop: the rows start to stop − 1.
    """
    if not is_mapped(column):
        return column[start:stop]
    rows = np.array(column[start:stop])
    base: Any = column
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, mmap.mmap):
        base.madvise(mmap.MADV_DONTNEED)
    return rows


def gather(ticks: int, parts: Iterable[Mapping[str, Array]]) -> dict[str, Array]:
    """Columns of rows that come part after part: in memory, or in a file if they are large.

    Args:
        ticks: of all parts together. parts: the same names in each.

    Raises:
        RecordingError: the disk is full, or fails.
    """
    offsets: dict[str, int] = {}
    part: Mapping[str, Array] = {}
    size = start = 0
    try:
        with tempfile.SpooledTemporaryFile(max_size=IN_MEMORY) as file:
            for part in parts:
                if not offsets:
                    for name, values in part.items():
                        offsets[name] = -(-size // _ALIGNED) * _ALIGNED
                        size = offsets[name] + ticks * values[0].nbytes
                for name, values in part.items():
                    file.seek(offsets[name] + start * values[0].nbytes)
                    file.write(values.tobytes())
                start += len(values)
            file.write(bytes(size - file.seek(0, os.SEEK_END)))  # channels without numbers
            file.seek(0)
            whole: Any = bytearray()
            if size > IN_MEMORY:
                file.flush()
                whole = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
            else:
                whole = bytearray(file.read())
    except OSError as error:
        raise RecordingError(f"no room for a recording's channels: {error}") from error
    return {
        name: np.ndarray((ticks, *values.shape[1:]), values.dtype, whole, offsets[name])
        for name, values in part.items()
    }
