"""Named arrays and a text in one .npz file: same content, same bytes; read without surprises."""

from __future__ import annotations

import io
import mmap
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from osc_contact.errors import RecordingError
from osc_contact.files import whole_file
from osc_contact.recorder.columns import IN_MEMORY

__all__ = ["TEXT", "checksum", "read_archive", "write_archive"]

Array = npt.NDArray[Any]
TEXT = "meta"  #: the entry that holds the text
_DATE = (1980, 1, 1, 0, 0, 0)  #: of every entry: archives of the same content are the same
_MOST_UNPACKED = 256 << 20  #: bytes that packed entries may grow to
_MOST_ENTRIES = 1000
#: What reading a file that is none of ours, or damaged, ends in. zipfile answers encryption, and
#: compression that it does not know, with kinds of RuntimeError.
_UNREADABLE = (
    OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, OverflowError,
    zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip


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
                    _write_entry(archive, name, values)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise RecordingError(f"cannot write the recording {target}: {error}") from error


def _write_entry(archive: zipfile.ZipFile, name: str, values: Array) -> None:
    with archive.open(zipfile.ZipInfo(f"{name}.npy", _DATE), "w", force_zip64=True) as entry:
        npy.write_array(entry, np.asarray(values, order="C"), allow_pickle=False)


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
                array = _mapped(archive, info, file) if stays else _array(archive, info)
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
    """A number that tells archives of different content apart, from the checksums inside."""
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
    packed = sum(e.file_size for e in entries if e.compress_type != zipfile.ZIP_STORED)
    if stored > size:
        raise RecordingError(
            f"{source} is damaged: its entries claim {stored} bytes, the file has {size}"
        )
    if packed > _MOST_UNPACKED:
        raise RecordingError(
            f"{source} would unpack from {size / 1e6:.3g} MB to {packed / 1e6:.4g} MB; packed "
            f"entries are read up to {_MOST_UNPACKED / 1e6:.0f} MB. Store them without compression"
        )


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Array:
    data = archive.read(info)  # to the end, so that its checksum is verified
    dtype, shape, start, order = _header(info, io.BytesIO(data))
    return np.frombuffer(data, dtype, offset=start).reshape(shape, order=order).copy()


def _mapped(archive: zipfile.ZipFile, info: zipfile.ZipInfo, file: IO[bytes]) -> Array:
    with archive.open(info) as entry:
        dtype, shape, start, order = _header(info, entry)
        while entry.read(1 << 20):  # verifies the checksum
            pass
    if not shape or order == "F":
        return _array(archive, info)
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
