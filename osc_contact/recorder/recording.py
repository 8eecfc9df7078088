"""Time series of a run, and their files."""

from __future__ import annotations

import json
import mmap
import os
import struct
import tempfile
import zipfile
import zlib
from collections import UserDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from math import prod
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import numpy.typing as npt
from mcap.writer import Writer
from numpy.lib import format as npy

from osc_contact.errors import RecordingError
from osc_contact.files import Json, StrPath, whole_file
from osc_contact.recorder.events import events_beside, to_line

# Named arrays and a text in one .npz file: equal content makes equal bytes; loaded without pickle.
#
# Arrays of long recordings stay in a file, which is mapped into memory to read them.


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
def _completed_file(target: Path) -> Iterator[IO[bytes]]:
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
    with _completed_file(target) as file:
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


_FORMAT = 1
_RESERVED = frozenset({TEXT, "file", "allow_pickle"})
#: channels and meta data that clocks measured: all that differs between two runs of the same seed
_CLOCK_CHANNELS = ("tick_s",)
_CLOCK_META = ("wall_s", "cpu_s", "date")
_TICKS_OF_PIECE = 1 << 14  #: ticks of a piece, see `Recording.pieces`
#: Ticks of a piece of a recording that stays on disk, to save memory.
_TICKS_OF_DISK_PIECE = 1 << 11


class Channels(UserDict[str, Array]):
    """Channels by name; a channel that stays on disk is read as a whole at each access."""

    def __getitem__(self, name: str) -> Array:
        """Read a channel; its first axis is the tick."""
        return read_column(self.data[name])


class Meta(dict[str, Any]):
    """Meta data of a recording; access to a missing key raises a `RecordingError`."""

    def __missing__(self, key: str) -> Any:
        """Raise a `RecordingError` that lists the keys that exist."""
        names = ", ".join(self) or "nothing"
        raise RecordingError(
            f"the recording's meta has no {key!r}, but {names}; "
            "take recordings that osc.run or osc.Recorder made, with their meta"
        )


class Recording:
    """Time series of one run: `meta` (JSON data) and `channels` (first axis = control tick).

    Channels of long runs stay on disk: `recording[name]` reads a channel, `rows` and `pieces` read
    some ticks of several channels.

    Args:
        meta: description of the run; kept as JSON data (tuples become lists).
        channels: arrays of bool, int or float with equally long first axes.

    Attributes:
        events: events of the run, with wall-clock times; see docs/metrics.md.

    Raises:
        RecordingError: meta is not JSON-able, or the channels do not fit together.

    Example:
        >>> recording = osc.Recording({"task": "press"}, {"t": [0.0, 0.1], "force": [4.0, 5.0]})
        >>> print(len(recording), recording["force"].max())
        2 5.0
    """

    def __init__(self, meta: Mapping[str, Any], channels: Mapping[str, npt.ArrayLike]) -> None:
        """Check names, types and lengths of the channels.

        Args:
            meta: facts on the run, of JSON's types.
            channels: arrays by name, the tick as first axis.

        Raises:
            RecordingError: a name, type or length is not valid, or `meta` is not JSON.
        """
        try:
            self.meta: Json = Meta(json.loads(json.dumps(dict(meta), allow_nan=False)))
        except (TypeError, ValueError) as error:
            raise RecordingError(
                f"meta must be JSON-able (finite numbers, text): {error}"
            ) from error
        self.events: list[Json] = []
        self.channels = Channels()
        for name, values in channels.items():
            array = np.asarray(values)
            if not name.isidentifier() or name in _RESERVED:
                raise RecordingError(
                    f"{name!r} cannot name a channel; use an identifier, not {_RESERVED}"
                )
            if array.dtype.kind not in "biuf" or not array.shape:
                raise RecordingError(
                    f"channel {name!r} has dtype {array.dtype} and shape {array.shape}; expected "
                    "bool, int or float with the tick as first axis"
                )
            self.channels[name] = array
        # all channels have the same ticks
        lengths = {name: len(array) for name, array in self.channels.data.items()}
        if len(set(lengths.values())) > 1:
            raise RecordingError(f"channels differ in their number of ticks: {lengths}")

    def __getitem__(self, name: str) -> Array:
        """Read a channel; its first axis is the tick.

        Raises:
            RecordingError: there is no such channel.
        """
        return self.rows(0, len(self), name)[name]

    def __contains__(self, name: object) -> bool:
        """Return whether there is a channel of this name."""
        return name in self.channels

    @property
    def magnitude_names(self) -> list[str]:
        """Names of the columns of alpha, see `column_names`."""
        names = [str(name) for name in self.meta.get("contact_names", [])]
        return column_names(names, self.meta.get("columns", range(len(names))))

    def __len__(self) -> int:
        """Return the number of control ticks."""
        return len(next(iter(self.channels.data.values()), ()))

    def rows(self, start: int, stop: int, *names: str) -> dict[str, Array]:
        """Read ticks start to stop − 1 of some channels.

        Args:
            start: first tick.
            stop: tick after the last one.
            names: names of channels; none: all channels.

        Returns:
            Arrays by name, with the ticks as first axis.

        Raises:
            RecordingError: there is no such channel.
        """
        rows = {}
        for name in names or self.channels:
            if name not in self.channels:
                known = ", ".join(self.channels) or "none"
                raise RecordingError(f"no channel {name!r} in this recording; there are: {known}")
            rows[name] = read_column(self.channels.data[name], start, stop)
        return rows

    def pieces(self, *names: str) -> Iterator[dict[str, Array]]:
        """Yield some channels in pieces of some thousand ticks, so that memory stays small.

        Args:
            names: names of channels; none: all channels.

        Yields:
            Arrays by name, with successive ticks as first axis.
        """
        on_disk = any(is_mapped(column) for column in self.channels.data.values())
        size = _TICKS_OF_DISK_PIECE if on_disk else _TICKS_OF_PIECE
        for start in range(0, len(self), size):
            yield self.rows(start, start + size, *names)

    def at(self, tick: int) -> Json:
        """Values of all channels at a tick; negative ticks count from the end.

        Raises:
            IndexError: there is no such tick.
        """
        tick = range(len(self))[tick]
        return {name: values[0] for name, values in self.rows(tick, tick + 1).items()}

    def thinned(self, most: int) -> Recording:
        """Recording of every k-th tick, in memory, with the least k that leaves ≤ `most` ticks.

        Args:
            most: largest number of ticks of the result; a shorter recording is returned itself.
        """
        step = -(-len(self) // most)  # quotient, rounded up
        if step <= 1:
            return self
        parts: dict[str, list[Array]] = {name: [] for name in self.channels}
        start = 0
        for piece in self.pieces():
            first = -start % step  # first tick of the piece whose number is a multiple of step
            for name, values in piece.items():
                parts[name].append(values[first::step].copy())
            start += len(values)
        columns = {name: np.concatenate(pieces) for name, pieces in parts.items()}
        return Recording(self.meta, columns)

    def save(self, path: StrPath) -> Path:
        """Write an .npz file, which appears complete or not at all, and return its path.

        Two runs of the same seed make the same bytes. Times that were measured (`tick_s`; `wall_s`,
        `cpu_s` and `date` of the meta) are written to another file, run.times.npz for run.npz, and
        the events to run.events.jsonl. Older files of these names are removed if there is nothing
        to write to them.

        Args:
            path: path of the file, which ends in .npz.

        Raises:
            RecordingError: the file cannot be written; an older file of the name is kept.
        """
        # measured times, which differ between runs of the same seed, have a file of their own; it
        # and the events name the checksum of the recording to which they belong
        target = Path(path)
        columns = self.channels.data
        times = {name: columns[name] for name in _CLOCK_CHANNELS if name in columns}
        meta_times = {key: self.meta[key] for key in _CLOCK_META if key in self.meta}
        meta = {key: value for key, value in self.meta.items() if key not in meta_times}
        values_by_name = {name: values for name, values in columns.items() if name not in times}
        write_archive(target, _json_text(meta=meta, order=list(columns)), values_by_name)
        times_file = _times_file(target)
        if times or meta_times:
            write_archive(times_file, _json_text(meta=meta_times, of=checksum(target)), times)
        else:
            times_file.unlink(missing_ok=True)
        events = events_beside(target)
        if self.events:
            lines = [{"event": "recording", "of": checksum(target)}, *self.events]
            with _completed_file(events) as file:
                file.write("".join(map(to_line, lines)).encode())
        else:
            events.unlink(missing_ok=True)
        return target

    def export(self, path: StrPath) -> Path:
        """Write a file for other programs, in the format of its suffix, and return its path.

        Args:
            path: .npz (see `save`), .csv (a line per tick) or .mcap (a JSON message per tick).

        Raises:
            RecordingError: another suffix, or the file cannot be written.
        """
        target = Path(path)
        if target.suffix == ".npz":
            return self.save(target)
        write = {".csv": write_csv, ".mcap": write_mcap}.get(target.suffix)
        if write is None:
            raise RecordingError(
                f"cannot export to {path}: give a name that ends in .npz, .csv or .mcap"
            )
        with _completed_file(target) as file:
            write(self, file)
        return target

    @classmethod
    def load(cls, path: StrPath) -> Recording:
        """Read a file written by `save`, and those of its times and events beside it.

        Checksums are verified, nothing is unpickled; large channels stay in the file. Files of
        times and events may be missing, and are ignored if they belong to another recording; a
        damaged file of events is ignored, too.

        Args:
            path: path of the file.

        Raises:
            RecordingError: there is no such file, it is damaged or not a recording, or the file of
                its times is damaged.
        """
        source = Path(path)
        if source.suffix == ".mcap":
            raise RecordingError(
                f"{source} holds the rows of a run that did not end. Read it with "
                f"osc_contact.recover, or `osc-contact export {source} recording.npz`"
            )
        content, columns = _read(source)
        meta = content["meta"]
        # all channels in their order before `save` set those of the clock apart
        order = content.get("order", list(columns))
        times_file = _times_file(source)
        if times_file.is_file():
            times_content, times = _read(times_file)
            # else it has the times of another recording, beside which this file was copied
            if times_content.get("of") == checksum(source):
                columns |= times
                if isinstance(meta, dict):
                    # measured times only: no other entry of `meta` is replaced
                    meta_times = times_content["meta"].items()
                    meta |= {key: value for key, value in meta_times if key in _CLOCK_META}
        # `order` may name times that are missing; a later duplicate in `names` has no effect
        names = [*(name for name in order if name in columns), *columns]
        recording = cls(meta, {name: columns[name] for name in names})
        recording.events = _read_events(source)
        return recording


def _read_events(source: Path) -> list[Json]:
    """Read the events that belong to a recording from the file beside it.

    Args:
        source: file of the recording, whose checksum the file of the events must state.

    Returns:
        Events in order; none if the file is missing, damaged or of another recording.
    """
    try:
        lines = events_beside(source).read_text("utf-8").splitlines()
        first, *events = map(json.loads, lines)
        fits = first["of"] == checksum(source)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
    if not fits:
        return []
    return [event for event in events if isinstance(event, dict)]


def _times_file(path: Path) -> Path:
    """File of the measured times beside a recording: run.times.npz for run.npz."""
    return path.with_name(f"{path.stem}.times.npz")


def _json_text(**content: Json | list[str] | int) -> str:
    """Write the text of a recording's file as JSON, with the version of the format.

    Args:
        content: entries of the text, such as `meta`.
    """
    return json.dumps({"format": _FORMAT, **content}, allow_nan=False)


def _read(source: Path) -> tuple[Json, dict[str, Array]]:
    """Read the text and the arrays of a recording's file, and check the version of the format.

    Args:
        source: file written by `Recording.save`.

    Returns:
        Content of the text, which has an entry `meta`, and arrays by name.

    Raises:
        RecordingError: the file is damaged, not a recording, or of another version.
    """
    text, columns = read_archive(source)
    try:
        content = json.loads(text)
        version = content["format"]
        _ = content["meta"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RecordingError(
            f"{source} is not a recording: {type(error).__name__}: {error}"
        ) from error
    if version != _FORMAT:
        raise RecordingError(
            f"{source} has recording format {version!r}; this version reads format {_FORMAT}"
        )
    return (content, columns)


def column_names(contacts: Sequence[str], owners: Sequence[int]) -> list[str]:
    """Names of the columns of N: the contact's, or contact.1, contact.2, … if it has several.

    Args:
        contacts: names of the contacts.
        owners: index of the contact of each column.
    """
    all_owners = list(owners)
    names = []
    for column, i in enumerate(all_owners):
        if all_owners.count(i) == 1:
            names.append(contacts[i])
        else:
            number = all_owners[:column].count(i) + 1
            names.append(f"{contacts[i]}.{number}")
    return names


# Recordings for other programs: CSV for tables, MCAP for viewers of robot logs.


def write_csv(recording: Recording, file: IO[bytes]) -> None:
    """Write a line per tick, with a column per number: t, q.0, q.1, …, N.0.0, N.0.1, …

    Args:
        recording: recording to write.
        file: file that is open for writing.
    """
    for number, piece in enumerate(recording.pieces()):
        if number == 0:
            titles = [
                title for name, values in piece.items() for title in _column_titles(name, values)
            ]
            file.write(",".join(titles).encode() + b"\n")
        flat = [x.reshape(len(x), -1).astype(float) for x in piece.values()]
        np.savetxt(file, np.hstack(flat), fmt="%.17g", delimiter=",")


def _column_titles(name: str, values: Array) -> Iterator[str]:
    """Yield a title for each number of a channel in a tick: its name and indices, as in N.0.1.

    Args:
        name: name of the channel.
        values: (ticks, …) values of the channel.
    """
    for index in np.ndindex(values.shape[1:]):
        yield ".".join((name, *map(str, index)))


def write_mcap(recording: Recording, file: IO[bytes]) -> None:
    """Write a JSON message per tick on the topic "tick", stamped with its time in the run.

    The meta data of the recording become an MCAP metadata record.

    Args:
        recording: recording to write.
        file: file that is open for writing.
    """
    value_schema = {"type": ["number", "boolean", "array", "null"]}
    schema = {"type": "object", "properties": dict.fromkeys(recording.channels, value_schema)}
    writer = Writer(file)
    writer.start("", "osc_contact")
    writer.add_metadata("recording", {"meta": json.dumps(recording.meta)})
    kind = writer.register_schema("tick", "jsonschema", json.dumps(schema).encode())
    channel = writer.register_channel("tick", "json", kind)
    number = 0
    for piece in recording.pieces():
        # one message for each tick; without a channel of times the number of the tick is its time
        for t, *values in zip(piece.get("t", count(number)), *piece.values(), strict=False):
            message = dict(zip(piece, map(_none_for_nan, values), strict=True))
            nanoseconds = round(float(t) * 1e9)
            data = json.dumps(message).encode()
            writer.add_message(channel, nanoseconds, data, nanoseconds, number)
            number += 1
    writer.finish()  # type: ignore[no-untyped-call]


def _none_for_nan(value: npt.ArrayLike) -> object:
    """Number, or nested lists of numbers, with None for NaN and infinities, which JSON lacks.

    Args:
        value: number or array of a channel.
    """
    array = np.asarray(value)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        is_finite = np.isfinite(array)
        array = array.astype(object)
        array[~is_finite] = None
    return array.tolist()
