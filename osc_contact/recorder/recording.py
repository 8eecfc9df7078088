"""Time series of a run, and their files."""

from __future__ import annotations

import json
from collections import UserDict
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
from mcap.writer import Writer

from osc_contact.errors import RecordingError
from osc_contact.files import Json, StrPath
from osc_contact.recorder.archive import (
    TEXT,
    Array,
    checksum,
    completed_file,
    is_mapped,
    read_archive,
    read_column,
    write_archive,
)
from osc_contact.recorder.events import events_beside, to_line

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
            with completed_file(events) as file:
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
        with completed_file(target) as file:
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
