"""Recordings for other programs: CSV for tables, MCAP for viewers of robot logs."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.writer import Writer

from osc_contact.errors import RecordingError
from osc_contact.files import whole_file

__all__ = ["write_csv", "write_mcap"]

Array = npt.NDArray[Any]
Piece = dict[str, Array]


def write_csv(pieces: Iterable[Piece], path: str | os.PathLike[str]) -> Path:
    """One line per tick, one column per number: t, q.0, q.1, …, N.0.0, N.0.1, …

    Args:
        pieces: of a recording, in order: channels with equally long first axes. path: of the file.

    Raises:
        RecordingError: the file cannot be written.
    """
    target = Path(path)
    try:
        with whole_file(target) as unfinished, open(unfinished, "x", encoding="ascii") as file:
            for number, piece in enumerate(pieces):
                if number == 0:
                    file.write(",".join(c for n, x in piece.items() for c in _columns(n, x)) + "\n")
                flat = [x.reshape(len(x), -1).astype(float) for x in piece.values()]
                np.savetxt(file, np.hstack(flat), fmt="%.17g", delimiter=",")
    except OSError as error:
        raise RecordingError(f"cannot write {target}: {error}") from error
    return target


def _columns(name: str, values: Array) -> Iterator[str]:
    for place in np.ndindex(values.shape[1:]):
        yield ".".join((name, *map(str, place)))


def write_mcap(
    pieces: Iterable[Piece], path: str | os.PathLike[str], meta: Mapping[str, Any], names: list[str]
) -> Path:
    """One JSON message per tick on the topic "tick", at its time in the run; the meta beside it.

    Args:
        pieces, path: as in `write_csv`. meta: of the recording. names: of its channels.

    Raises:
        RecordingError: the file cannot be written.
    """
    target = Path(path)
    shapes = {name: {"type": ["number", "boolean", "array", "null"]} for name in names}
    schema = {"type": "object", "properties": shapes}
    try:
        with whole_file(target) as unfinished, open(unfinished, "xb") as file:
            writer = Writer(file)
            writer.start("", "osc_contact")
            writer.add_metadata("recording", {"meta": json.dumps(meta)})
            kind = writer.register_schema("tick", "jsonschema", json.dumps(schema).encode())
            channel = writer.register_channel("tick", "json", kind)
            number = 0
            for piece in pieces:
                times = piece["t"] if "t" in piece else np.arange(number, number + _length(piece))
                for k, t in enumerate(times):
                    values = {name: _plain(series[k]) for name, series in piece.items()}
                    at = round(float(t) * 1e9)
                    writer.add_message(channel, at, json.dumps(values).encode(), at, number)
                    number += 1
            writer.finish()  # type: ignore[no-untyped-call]
    except OSError as error:
        raise RecordingError(f"cannot write {target}: {error}") from error
    return target


def _length(piece: Piece) -> int:
    return len(next(iter(piece.values()), ()))


def _plain(value: Any) -> Any:
    """Numbers and lists of them; JSON has no NaN."""
    array: Array = np.asarray(value)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        known = np.isfinite(array)
        array = array.astype(object)
        array[~known] = None
    return array.tolist()
