"""Rows of numbers, appended to a file while they come: what is written survives a kill.

The file is MCAP, an open container for logs of robots (mcap.dev): a header, then chunks, each with
its own checksum. Every chunk holds one message, some rows and what they are made of, so that it can
be read by itself. A chunk goes to the operating system whole, before the next begins.
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
from typing import Any

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
_ABOUT = 1
_ROWS = 2
_CHANNELS = {
    _ABOUT: Channel(_ABOUT, "about", "json", {}, 0),
    _ROWS: Channel(_ROWS, "rows", "numpy", {}, 0),
}
_MOST = 1 << 28  #: bytes of a record; more is damage
#: What damaged records end in.
_DAMAGED = (McapError, ValueError, KeyError, TypeError, OverflowError, MemoryError, struct.error)


class JournalFile:
    """Writes a journal.

    Attributes:
        path: of the file; None: an unnamed temporary one.
        error: why nothing more is written, once the disk is full or fails; what was written before
            stays readable.
    """

    def __init__(self, path: Path | None, about: Mapping[str, Any]) -> None:
        """Begin a file.

        Args:
            path: where; an older file there is replaced.
            about: what the rows belong to, JSON-able.

        Raises:
            RecordingError: it cannot be created.
        """
        self.path = path
        self.error: RecordingError | None = None
        self._whole = self._before_end = self._count = 0
        self._ended = False
        try:
            if path is None:
                with tempfile.TemporaryFile(buffering=0) as made:
                    self._number = os.dup(made.fileno())
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)  # the older file stays open for its readers
                self._number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise RecordingError(f"cannot begin the recording {path}: {error}") from error
        text = json.dumps(dict(about), allow_nan=False).encode()
        head = MCAP0_MAGIC + _bytes(Header("osc_contact", "osc_contact"))
        self._write(head + 2 * _chunk(_ABOUT, 0, text))  # twice: nothing is read without it

    def append(self, first: int, rows: Array) -> None:
        """Write rows, a structured array, as a chunk; never raises, see `error`.

        After `close` the file is open again.

        Args:
            first: number of the first row.
            rows: (k,) with named fields.
        """
        if self._ended:
            self._ended = False
            self._whole = self._before_end
        if self.error is None:
            layout = {"first": first, "rows": len(rows), "dtype": rows.dtype.descr}
            self._write(_chunk(_ROWS, first, json.dumps(layout).encode() + b"\n" + rows.tobytes()))
            self._count = first + len(rows)

    def read(self) -> Journal:
        """What was written so far, to be read; more may be appended meanwhile."""
        return Journal(self._number)

    def close(self) -> None:
        """Write the end of the file: it is whole."""
        if self.error is None and not self._ended:
            self._ended = True
            self._before_end = self._whole
            self._write(_bytes(DataEnd(0)) + _bytes(Footer(0, 0, 0)) + MCAP0_MAGIC)

    def _write(self, data: bytes) -> None:
        left = memoryview(data)
        at = self._whole
        try:
            while left:
                count = os.pwrite(self._number, left, at)
                left = left[count:]
                at = at + count
            self._whole = at
        except OSError as error:
            self.error = RecordingError(
                f"recording stops after {self._count} ticks: {self.path or 'temporary file'}: "
                f"{error.strerror or error}"
            )
            os.ftruncate(self._number, self._whole)  # the part of a chunk that had room

    def __del__(self) -> None:
        if hasattr(self, "_number"):
            os.close(self._number)


class Journal:
    """Reads a journal, whole or not: every chunk that is, and what is missing.

    Attributes:
        about: as given when it was begun.
        missing: sentences on what damage was found; complete once all rows were read.
    """

    def __init__(self, source: Path | int) -> None:
        """Open a journal.

        Args:
            source: a file, or the descriptor of an open one.

        Raises:
            RecordingError: no such file, or nothing in it that can be read.
        """
        self.missing: list[str] = []
        self._name = "the recording" if isinstance(source, int) else str(source)
        try:
            with open(source, "rb", closefd=isinstance(source, Path)) as file:
                size = os.fstat(file.fileno()).st_size
                where = file.fileno() if size else -1  # an empty file: one zero
                self._file: Any = mmap.mmap(where, size or 1, access=mmap.ACCESS_READ)
        except OSError as error:
            raise RecordingError(f"no recording {source}: {error.strerror}") from error
        found = next((data for channel, data in self._messages() if channel == _ABOUT), None)
        if found is None:
            raise RecordingError(f"{self._name} is no recording, or is damaged where it begins")
        self.about: dict[str, Any] = json.loads(found)

    def rows(self) -> Iterator[tuple[int, Array]]:
        """(number of the first row, rows) of every whole chunk, each row once, in order.

        Raises:
            RecordingError: the file cannot be read, or another version wrote it.
        """
        self.missing = []
        after = 0
        for channel, data in self._messages():
            if channel != _ROWS:
                continue
            text, _, numbers = data.partition(b"\n")
            try:
                layout = json.loads(text)
                fields = [(name, code, *map(tuple, size)) for name, code, *size in layout["dtype"]]
                first = int(layout["first"])
                rows = np.frombuffer(numbers, np.dtype(fields))
            except _DAMAGED as error:
                raise RecordingError(
                    f"{self._name} has rows of an unknown kind: {error}"
                ) from error
            if first > after:
                self.missing.append(f"ticks {after} to {first - 1} are missing")
            again = max(0, min(after - first, len(rows)))
            if again:
                last = first + again - 1
                self.missing.append(f"ticks {first} to {last} come again, and are left out there")
            if again < len(rows):
                after = first + len(rows)
                yield (first + again, rows[again:])

    def _messages(self) -> Iterator[tuple[int, bytes]]:
        """(MCAP channel, data) of the messages in all whole chunks; after damage, from the next."""
        file = self._file
        at = lost = 0
        while 0 <= at < len(file):
            file.seek(at)
            records = StreamReader(file, at > 0, True, record_size_limit=_MOST).records
            try:
                for record in records:
                    if isinstance(record, Chunk):
                        if record.compression or zlib.crc32(record.data) != record.uncompressed_crc:
                            break
                        for one in breakup_chunk(record):
                            if isinstance(one, Message):
                                yield (one.channel_id, one.data)
                    at = file.tell()
                    file.madvise(mmap.MADV_DONTNEED)  # what was read needs no memory
                else:
                    return  # a footer was read
            except _DAMAGED:
                pass
            lost = at
            # where the first chunk that begins later does; none: −1
            at = max(file.find(_SIGN, at + 1 + _INSIDE) - _INSIDE, -1)
        left = len(file) - lost
        words = f"; its last {left} bytes are no whole chunk" if left else ""
        self.missing.append(f"the run was cut short, the file has no end{words}")


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _chunk(channel: int, number: int, data: bytes) -> bytes:
    """A chunk that can be read by itself: the MCAP channel it needs, and one message."""
    inside = _bytes(_CHANNELS[channel]) + _bytes(Message(channel, number, data, number, number))
    return _bytes(Chunk("", inside, number, number, zlib.crc32(inside), len(inside)))


_SIGN = _bytes(_CHANNELS[_ROWS])  #: what every chunk of rows holds
_INSIDE = _chunk(_ROWS, 0, b"").index(_SIGN)  #: bytes of a chunk before it
