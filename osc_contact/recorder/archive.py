"""Named arrays and a text in one .npz file: equal content makes equal bytes; read without pickle.

Arrays of long recordings stay in a file, which is mapped into memory to read them.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from osc_contact.errors import RecordingError
from osc_contact.files import whole_file

Array = npt.NDArray[Any]
IN_MEMORY = 32 << 20  #: bytes; recordings up to this size are kept in memory
_ALIGNMENT = 64  #: bytes; offsets of columns in a file are multiples of it


def is_mapped(column: Array) -> bool:
    """Return whether a column is mapped from a file, so that it is read-only."""
    return not column.flags.writeable


def read_column(column: Array, start: int = 0, stop: int | None = None) -> Array:
    """Read rows of a column; those of a mapped file are copied, and its pages are released.

    Args:
        column: column of a recording.
        start, stop: first row, and the row after the last one; None: to the end.
    """
    if not is_mapped(column):
        return column[start:stop]
    rows = np.array(column[start:stop])
    base: object = column
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, mmap.mmap):
        base.madvise(mmap.MADV_DONTNEED)
    return rows


def gather(ticks: int, parts: Iterable[Mapping[str, Array]]) -> dict[str, Array]:
    """Concatenate columns that come in parts, in memory or, if they are large, in a file.

    Args:
        ticks: number of rows of all parts together.
        parts: columns of successive rows, with equal names in each part.

    Returns:
        Columns by name, each with `ticks` rows; those in a file are read-only.

    Raises:
        RecordingError: the disk is full, or fails.
    """
    offsets: dict[str, int] = {}
    part: Mapping[str, Array] = {}
    size = start = 0
    try:
        with tempfile.SpooledTemporaryFile(max_size=IN_MEMORY) as file:
            for part in parts:
                for name, values in part.items():
                    row = values[0].nbytes
                    if name not in offsets:
                        offsets[name] = -(-size // _ALIGNMENT) * _ALIGNMENT  # rounded up
                        size = offsets[name] + ticks * row
                    file.seek(offsets[name] + start * row)
                    file.write(values.tobytes())
                start += len(values)
            file.write(bytes(size - file.seek(0, os.SEEK_END)))  # channels without numbers
            file.seek(0)
            content: mmap.mmap | bytearray
            if size > IN_MEMORY:
                file.flush()
                content = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
            else:
                content = bytearray(file.read())
    except OSError as error:
        raise RecordingError(f"no room for a recording's channels: {error}") from error
    return {
        name: np.ndarray((ticks, *values.shape[1:]), values.dtype, content, offsets[name])
        for name, values in part.items()
    }


TEXT = "meta"  #: name of the entry with the text
_MOST_UNPACKED = 256 << 20  #: largest size of packed entries after unpacking (bytes)
_MOST_ENTRIES = 1000
#: Errors of reading a damaged file, or one that is not a recording. zipfile raises RuntimeError for
#: encryption, and NotImplementedError for unknown compression.
_UNREADABLE_ERRORS = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    EOFError,
    RuntimeError,
    MemoryError,
    OverflowError,
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
)


@contextmanager
def completed_file(target: Path) -> Iterator[IO[bytes]]:
    """Open a file that gets its final name only when it is complete; else an older one is kept.

    Args:
        target: path of the finished file.

    Raises:
        RecordingError: the file cannot be written.
    """
    try:
        with whole_file(target) as unfinished, open(unfinished, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise RecordingError(f"cannot write the recording {target}: {error}") from error


def write_archive(target: Path, text: str, arrays: Mapping[str, Any]) -> None:
    """Write an .npz file of arrays and a text.

    Args:
        target: the file.
        text: meta data as JSON.
        arrays: arrays by name.

    Raises:
        RecordingError: the file cannot be written.
    """
    with completed_file(target) as file:
        np.savez(file, **arrays, meta=np.array(text))


def read_archive(source: Path) -> tuple[str, dict[str, Array]]:
    """Read the text and the arrays of an .npz file; large arrays stay in the file until used.

    Sizes are checked by the headers before anything is unpacked; all checksums are verified.

    Args:
        source: path of the file.

    Raises:
        RecordingError: there is no such file, or it is damaged or not a recording.
    """
    if not source.is_file():
        raise RecordingError(f"no recording {source}: there is no such file")
    try:
        with open(source, "rb") as file, zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            _require_size(source, entries, os.fstat(file.fileno()).st_size)
            large = sum(info.file_size for info in entries) > IN_MEMORY
            arrays: dict[str, Array] = {}
            for info in entries:
                stays = large and info.compress_type == zipfile.ZIP_STORED
                name = info.filename.removesuffix(".npy")
                arrays[name] = _verified_array(archive, info, file if stays else None)
        return (str(arrays.pop(TEXT)[()]), arrays)
    except zipfile.BadZipFile as error:
        name = str(error).partition("'")[2].rstrip("'")
        damage = f"the checksum of {name} is wrong" if "CRC" in str(error) else str(error)
        raise RecordingError(f"{source} is damaged or no recording: {damage}") from error
    except _UNREADABLE_ERRORS as error:
        raise RecordingError(
            f"{source} is not a recording, or is damaged: {type(error).__name__}: {error}"
        ) from error


def checksum(path: Path) -> int:
    """Checksum of an archive's content, computed from the names and checksums of its entries.

    Args:
        path: an .npz file.
    """
    with zipfile.ZipFile(path) as archive:
        words = "".join(f"{info.filename}:{info.CRC};" for info in archive.infolist())
    return zlib.crc32(words.encode())


def _require_size(source: Path, entries: list[zipfile.ZipInfo], size: int) -> None:
    """Refuse an archive whose entries would become larger than those of any recording.

    Args:
        source: the file, for messages.
        entries: entries of the archive.
        size: size of the file (bytes).

    Raises:
        RecordingError: too many or too large entries, or more than the file can contain.
    """
    if len(entries) > _MOST_ENTRIES:
        raise RecordingError(
            f"{source} has {len(entries)} entries; at most {_MOST_ENTRIES} are read"
        )
    stored = sum(info.file_size for info in entries if info.compress_type == zipfile.ZIP_STORED)
    packed = sum(info.file_size for info in entries) - stored
    if stored > size:
        raise RecordingError(
            f"{source} is damaged: its entries claim {stored} bytes, the file has {size}"
        )
    if packed > _MOST_UNPACKED:
        raise RecordingError(
            f"{source} would unpack from {size / 1e6:.3g} MB to {packed / 1e6:.4g} MB; packed "
            f"entries are read up to {_MOST_UNPACKED / 1e6:.0f} MB. Store them without compression"
        )


def _verified_array(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, file: IO[bytes] | None
) -> Array:
    """Read the array of an entry, or map it from the file, and verify its checksum.

    Args:
        archive: the archive.
        info: entry of the archive.
        file: the open archive, to map the array from it; None: the array is read.

    Raises:
        ValueError: the entry has Python objects or another size than its header states.
        BadZipFile: the checksum is wrong.
    """
    with archive.open(info) as entry:
        dtype, shape, start, order = _array_header(info, entry)
        if file is None or not shape or order == "F":
            return np.frombuffer(entry.read(), dtype).reshape(shape, order=order).copy()
        while entry.read(1 << 20):  # reading to the end verifies the checksum
            pass
    content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    # a ZIP entry has 30 bytes, of which the last four are the lengths of two names that follow
    names = struct.unpack_from("<HH", content, info.header_offset + 26)
    return np.ndarray(shape, dtype, content, info.header_offset + 30 + sum(names) + start)


def _array_header(
    info: zipfile.ZipInfo, entry: IO[bytes]
) -> tuple[np.dtype[Any], tuple[int, ...], int, Literal["C", "F"]]:
    """Read the header of an array, and check that its numbers fill the entry.

    Args:
        info: entry of the archive, for its size and name.
        entry: the entry, opened at its first byte.

    Returns:
        Type and shape of the array, offset of its first number in the entry (bytes), and order:
        "F" by columns, "C" by rows.

    Raises:
        ValueError: Python objects, or a size that differs from that of the entry.
    """
    version = npy.read_magic(entry)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, in_columns, dtype = read_header(entry)
    start = int(entry.tell())
    if dtype.hasobject:
        raise ValueError(f"{info.filename} holds Python objects, which are not read")
    if min(shape, default=0) < 0 or prod(shape) * dtype.itemsize != info.file_size - start:
        raise ValueError(f"{info.filename} has {info.file_size - start} bytes for shape {shape}")
    return (dtype, shape, start, "F" if in_columns else "C")
