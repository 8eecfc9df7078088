"""Rows of a running program, appended to a file that stays readable after a kill.

The file is MCAP, an open container for logs of robots (mcap.dev): a header, then chunks, each with
its own checksum. A chunk holds one message, some rows with their layout, so that it can be read
without the others. A chunk is handed to the operating system as a whole, before the next begins.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import numpy.typing as npt
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, McapRecord, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from osc_contact.errors import RecordingError

Array = npt.NDArray[Any]
#: MCAP channels
_ABOUT_CHANNEL = 1
_ROWS_CHANNEL = 2
_CHANNELS = {
    _ABOUT_CHANNEL: Channel(_ABOUT_CHANNEL, "about", "json", {}, 0),
    _ROWS_CHANNEL: Channel(_ROWS_CHANNEL, "rows", "numpy", {}, 0),
}
_LARGEST_RECORD = 1 << 28  #: largest size of a record (bytes); a larger one is damaged
#: errors of reading damaged records
_DAMAGE_ERRORS = (
    McapError,
    ValueError,
    KeyError,
    TypeError,
    OverflowError,
    MemoryError,
    struct.error,
)


class JournalFile:
    """Journal that is open for writing.

    Attributes:
        path: the file; None: an unnamed temporary one.
        error: error of a full or failing disk that ended the writing, else None; rows that were
            written before stay readable.
    """

    def __init__(self, path: Path | None, about: Mapping[str, Any]) -> None:
        """Begin a file.

        Args:
            path: the file, which is replaced; None: an unnamed temporary one.
            about: description of the rows, JSON data.

        Raises:
            RecordingError: the file cannot be created.
        """
        self.path = path
        self.error: RecordingError | None = None
        #: size of the file up to its last complete record, size before its end; number of rows
        self._complete_bytes = self._bytes_before_end = self._row_count = 0
        self._ended = False  #: whether the end of the file is written
        try:
            if path is None:
                with tempfile.TemporaryFile(buffering=0) as file:
                    self._descriptor = os.dup(file.fileno())  #: descriptor of the open file
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)  # the older file stays open for its readers
                self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise RecordingError(f"cannot begin the recording {path}: {error}") from error
        text = json.dumps(dict(about), allow_nan=False).encode()
        head = MCAP0_MAGIC + _record_bytes(Header("osc_contact", "osc_contact"))
        # twice: nothing is read without it
        self._write(head + 2 * _chunk_bytes(_ABOUT_CHANNEL, 0, text))

    def append(self, first: int, rows: Array) -> None:
        """Write rows as a chunk; errors of the file do not raise, see `error`.

        A file that was closed is continued.

        Args:
            first: number of the first row.
            rows: (k,) structured array.
        """
        if self._ended:
            self._ended = False
            self._complete_bytes = self._bytes_before_end
        if self.error is None:
            layout = {"first": first, "rows": len(rows), "dtype": rows.dtype.descr}
            self._write(
                _chunk_bytes(
                    _ROWS_CHANNEL, first, json.dumps(layout).encode() + b"\n" + rows.tobytes()
                )
            )
            self._row_count = first + len(rows)

    def read(self) -> Journal:
        """Open the journal for reading; more rows may be appended meanwhile."""
        return Journal(self._descriptor)

    def close(self) -> None:
        """Write the end of the file, which marks it as complete."""
        if self.error is None and not self._ended:
            self._ended = True
            self._bytes_before_end = self._complete_bytes
            self._write(_record_bytes(DataEnd(0)) + _record_bytes(Footer(0, 0, 0)) + MCAP0_MAGIC)

    def _write(self, data: bytes) -> None:
        """Append bytes to the file, all of them or none.

        An error is stored in `error`, and a part that was written is cut off.

        Args:
            data: bytes to append.
        """
        remainder = memoryview(data)
        position = self._complete_bytes
        try:
            while remainder:
                count = os.pwrite(self._descriptor, remainder, position)
                remainder = remainder[count:]
                position = position + count
            self._complete_bytes = position
        except OSError as error:
            self.error = RecordingError(
                f"recording stops after {self._row_count} ticks: {self.path or 'temporary file'}: "
                f"{error.strerror or error}"
            )
            # the part of the chunk that was written before the disk was full is cut off
            os.ftruncate(self._descriptor, self._complete_bytes)

    def __del__(self) -> None:
        """Close the file."""
        if hasattr(self, "_descriptor"):
            os.close(self._descriptor)


class Journal:
    """Journal that is open for reading, complete or cut short.

    Attributes:
        about: description of the rows, see `JournalFile`.
        missing: sentences on missing and damaged parts, filled while `rows` reads the file.
    """

    def __init__(self, source: Path | int) -> None:
        """Open a journal.

        Args:
            source: a file, or the descriptor of an open file.

        Raises:
            RecordingError: there is no such file, or its beginning cannot be read.
        """
        self.missing: list[str] = []
        #: name of the file in messages
        self._shown_name = "the recording" if isinstance(source, int) else str(source)
        try:
            with open(source, "rb", closefd=isinstance(source, Path)) as file:
                size = os.fstat(file.fileno()).st_size
                if size:
                    #: bytes of the file
                    self._file = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
                else:  # an empty file cannot be mapped: a zero byte in its place
                    self._file = mmap.mmap(-1, 1, access=mmap.ACCESS_READ)
        except OSError as error:
            raise RecordingError(f"no recording {source}: {error.strerror}") from error
        about = next(
            (data for channel, data in self._messages() if channel == _ABOUT_CHANNEL), None
        )
        if about is None:
            raise RecordingError(
                f"{self._shown_name} is no recording, or is damaged where it begins"
            )
        self.about: dict[str, Any] = json.loads(about)

    def rows(self) -> Iterator[tuple[int, Array]]:
        """Yield the rows of all complete chunks in order, each row once.

        Yields:
            Number of the first row, and rows (k,) as a structured array.

        Raises:
            RecordingError: rows of an unknown layout, for example of another version.
        """
        self.missing = []
        following = 0  # number of the row that is expected next
        for channel, data in self._messages():
            if channel != _ROWS_CHANNEL:
                continue
            text, _, numbers = data.partition(b"\n")
            try:
                layout = json.loads(text)
                fields = [(name, code, *map(tuple, size)) for name, code, *size in layout["dtype"]]
                first = int(layout["first"])
                rows = np.frombuffer(numbers, np.dtype(fields))
            except _DAMAGE_ERRORS as error:
                raise RecordingError(
                    f"{self._shown_name} has rows of an unknown kind: {error}"
                ) from error
            if first > following:
                self.missing.append(f"ticks {following} to {first - 1} are missing")
            repeated = max(0, min(following - first, len(rows)))
            if repeated:
                last = first + repeated - 1
                self.missing.append(f"ticks {first} to {last} come again, and are left out there")
            if repeated < len(rows):
                following = first + len(rows)
                yield (first + repeated, rows[repeated:])

    def _messages(self) -> Iterator[tuple[int, bytes]]:
        """Yield the messages of all complete chunks.

        Reading continues with the next chunk after a damaged one. A file without an end is noted in
        `missing`.

        Yields:
            MCAP channel of the message, and its data.
        """
        file = self._file
        position = damage = 0
        while 0 <= position < len(file):
            file.seek(position)
            records = StreamReader(
                cast(IO[bytes], file),
                skip_magic=position > 0,
                emit_chunks=True,
                record_size_limit=_LARGEST_RECORD,
            ).records
            try:
                for record in records:
                    if isinstance(record, Chunk):
                        if record.compression or zlib.crc32(record.data) != record.uncompressed_crc:
                            break
                        for part in breakup_chunk(record):
                            if isinstance(part, Message):
                                yield (part.channel_id, part.data)
                    position = file.tell()
                    file.madvise(mmap.MADV_DONTNEED)  # pages that were read need no memory
                else:
                    return  # a footer was read
            except _DAMAGE_ERRORS:
                pass
            damage = position
            # beginning of the first chunk after the damage; −1 if there is none
            position = max(file.find(_ROWS_MARK, position + 1 + _MARK_OFFSET) - _MARK_OFFSET, -1)
        size = len(file) - damage
        words = f"; its last {size} bytes are no whole chunk" if size else ""
        self.missing.append(f"the run was cut short, the file has no end{words}")


def _record_bytes(record: McapRecord) -> bytes:
    """Serialise an MCAP record, with its type and length in front."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _chunk_bytes(channel: int, number: int, data: bytes) -> bytes:
    """Bytes of a chunk with one message and its MCAP channel, readable without other chunks.

    Args:
        channel: MCAP channel of the message.
        number: sequence number of the message, used as its time, too.
        data: content of the message.
    """
    inside = _record_bytes(_CHANNELS[channel]) + _record_bytes(
        Message(channel, number, data, number, number)
    )
    return _record_bytes(Chunk("", inside, number, number, zlib.crc32(inside), len(inside)))


_ROWS_MARK = _record_bytes(_CHANNELS[_ROWS_CHANNEL])  #: bytes that every chunk of rows contains
#: Offset of those bytes in a chunk.
_MARK_OFFSET = _chunk_bytes(_ROWS_CHANNEL, 0, b"").index(_ROWS_MARK)
