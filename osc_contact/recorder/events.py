"""Events of a run with wall-clock times, lines of JSON in a file that belongs to the recording.

Unlike rows, events are few, and each is written at once: after a kill all of them are in the file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from osc_contact.errors import RecordingError
from osc_contact.files import Json

MOST = 10_000  #: events that are kept; later ones are kept if their kind is in `ALWAYS`
ALWAYS = frozenset({"start", "stop", "brakes", "reset", "end", "setting", "settings"})


def events_beside(path: Path) -> Path:
    """File of the events that belong to a file of a recording or of rows: NAME.events.jsonl."""
    return path.with_name(f"{path.stem}.events.jsonl")


def to_line(event: Json) -> str:
    """Event as a line of JSON; NaN and infinities, which JSON lacks, become text."""
    return json.dumps(_without_nan(event), ensure_ascii=False) + "\n"


def _without_nan(value: object) -> object:
    """Convert JSON data so that it has text in place of NaN and infinities, at any depth.

    Args:
        value: value of any type.
    """
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return str(value)
    return value


class EventLog:
    """Log of events, in memory and in a file.

    Attributes:
        events: events so far, with `time` (UTC, ISO 8601), `t` (s of the run) and `event`.
        omitted: number of events beyond `MOST` that were not kept.
        error: error that ended the writing, or None; the file keeps earlier events.
    """

    def __init__(self, path: Path | None) -> None:
        """Begin a log.

        Args:
            path: file, which is replaced; None: events are kept in memory only.

        Raises:
            RecordingError: the file cannot be created.
        """
        self.events: list[Json] = []
        self.omitted = 0
        self.error: RecordingError | None = None
        self._descriptor = -1
        self._path = path  #: file of the events; None: none
        if path is not None:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)
                flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
                self._descriptor = os.open(path, flags, 0o644)
            except OSError as error:
                raise RecordingError(f"cannot begin the event log {path}: {error}") from error

    def note(
        self, t: float, event: str, facts: Json, later: Callable[[Callable[[], object]], None]
    ) -> None:
        """Append an event; errors of the file do not raise, see `error`.

        Without a file `_descriptor` is −1, and the event is kept in `events` only. Beyond `MOST`
        events only the kinds in `ALWAYS` and changes to SAFE_STOP are kept; others are counted in
        `omitted`.

        Args:
            t: time in the run (s).
            event: kind of the event.
            facts: further JSON data of the event.
            later: function that calls its argument, which writes, at once or in another thread.
        """
        if len(self.events) >= MOST and event not in ALWAYS and facts.get("to") != "SAFE_STOP":
            self.omitted += 1
            return
        timestamp = datetime.now(UTC).isoformat(timespec="microseconds")
        entry = {"time": timestamp, "t": t, "event": event, **facts}
        self.events.append(entry)
        if self._descriptor >= 0 and self.error is None:
            later(partial(self._write_line, to_line(entry).encode()))

    def _write_line(self, line: bytes) -> None:
        """Write a line to the file; an error is stored in `error`, and ends the writing."""
        try:
            os.write(self._descriptor, line)
        except OSError as error:
            self.error = RecordingError(f"no more events are written to {self._path}: {error}")

    def __del__(self) -> None:
        """Close the file."""
        if getattr(self, "_descriptor", -1) >= 0:
            os.close(self._descriptor)
