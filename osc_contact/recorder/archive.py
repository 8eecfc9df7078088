"""Named arrays and a text in one .npz file: same content, same bytes; read without surprises.

Arrays of long recordings stay in a file, mapped into memory where they are read.
"""

import mmap
import os
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Mapping
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


TEXT = "meta"  #: the entry that holds the text
_DATE = (1980, 1, 1, 0, 0, 0)  #: of every entry: archives of the same content are the same
_MOST_UNPACKED = 256 << 20  #: bytes that packed entries may grow to
_MOST_ENTRIES = 1000
#: What reading a file that is none of ours, or damaged, ends in. zipfile answers encryption, and
#: compression that it does not know, with kinds of RuntimeError.
_UNREADABLE = (
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


def write_archive(target: Path, text: str, arrays: Mapping[str, Array]) -> None:
    """Write one .npz file: complete under its final name, or not there at all.

    Args:
        target: file. text: JSON of the meta data. arrays: by name.

    Raises:
        RecordingError: the file cannot be written; an older file of the name is kept.
    """
    try:
        with whole_file(target) as unfinished, open(unfinished, "xb") as file:
            with zipfile.ZipFile(file, "w") as archive:
                for name, values in {**arrays, TEXT: np.array(text)}.items():
                    info = zipfile.ZipInfo(f"{name}.npy", _DATE)
                    with archive.open(info, "w", force_zip64=True) as entry:
                        numbers = np.asarray(values, order="C")
                        npy.write_array(entry, numbers, allow_pickle=False)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise RecordingError(f"cannot write the recording {target}: {error}") from error


def read_archive(source: Path) -> tuple[str, dict[str, Array]]:
    """The text and the arrays of an .npz file; large arrays stay in the file until they are read.

    Sizes are judged by the headers before anything is unpacked; all checksums are verified.

    Raises:
        RecordingError: no such file, damaged, or none of ours.
    """
    if not source.is_file():
        raise RecordingError(f"no recording {source}: there is no such file")
    try:
        with open(source, "rb") as file, zipfile.ZipFile(file) as archive:
            entries = {info.filename: info for info in archive.infolist()}
            _require_size(source, list(entries.values()), os.fstat(file.fileno()).st_size)
            large = sum(info.file_size for info in entries.values()) > IN_MEMORY
            arrays: dict[str, Array] = {}
            for name, info in entries.items():
                stays = large and info.compress_type == zipfile.ZIP_STORED
                array = _array(archive, info, file if stays else None)
                arrays[name.removesuffix(".npy")] = array
        text = arrays.pop(TEXT)
        return str(np.asarray(text)[()]), arrays
    except zipfile.BadZipFile as error:
        name = str(error).partition("'")[2].rstrip("'")
        damage = f"the checksum of {name} is wrong" if "CRC" in str(error) else str(error)
        raise RecordingError(f"{source} is damaged or no recording: {damage}") from error
    except _UNREADABLE as error:
        raise RecordingError(
            f"{source} is not a recording, or is damaged: {type(error).__name__}: {error}"
        ) from error


def checksum(path: Path) -> int:
    """A number that differs between archives of different content, from the checksums inside."""
    with zipfile.ZipFile(path) as archive:
        words = "".join(f"{info.filename}:{info.CRC};" for info in archive.infolist())
    return zlib.crc32(words.encode())


def _require_size(source: Path, entries: list[zipfile.ZipInfo], size: int) -> None:
    """Refuse what would unpack to more than a recording could hold."""
    if len(entries) > _MOST_ENTRIES:
        raise RecordingError(
            f"{source} has {len(entries)} entries; at most {_MOST_ENTRIES} are read"
        )
    stored = sum(e.file_size for e in entries if e.compress_type == zipfile.ZIP_STORED)
    packed = sum(e.file_size for e in entries) - stored
    if stored > size:
        raise RecordingError(
            f"{source} is damaged: its entries claim {stored} bytes, the file has {size}"
        )
    if packed > _MOST_UNPACKED:
        raise RecordingError(
            f"{source} would unpack from {size / 1e6:.3g} MB to {packed / 1e6:.4g} MB; packed "
            f"entries are read up to {_MOST_UNPACKED / 1e6:.0f} MB. Store them without compression"
        )


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo, file: IO[bytes] | None) -> Array:
    """The numbers of an entry, mapped where there is a file; its checksum is verified."""
    with archive.open(info) as entry:
        dtype, shape, start, order = _header(info, entry)
        if file is None or not shape or order == "F":
            return np.frombuffer(entry.read(), dtype).reshape(shape, order=order).copy()
        while entry.read(1 << 20):
            pass
    whole = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    names = struct.unpack_from("<HH", whole, info.header_offset + 26)
    return np.ndarray(shape, dtype, whole, info.header_offset + 30 + sum(names) + start)


def _header(
    info: zipfile.ZipInfo, entry: Any
) -> tuple[np.dtype[Any], tuple[int, ...], int, Literal["C", "F"]]:
    """Type, shape, first byte and order of an entry's numbers, which must fill it exactly."""
    version = npy.read_magic(entry)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, in_columns, dtype = read(entry)
    start = int(entry.tell())
    if dtype.hasobject:
        raise ValueError(f"{info.filename} holds Python objects, which are not read")
    if min(shape, default=0) < 0 or prod(shape) * dtype.itemsize != info.file_size - start:
        raise ValueError(f"{info.filename} has {info.file_size - start} bytes for shape {shape}")
    return dtype, shape, start, "F" if in_columns else "C"
