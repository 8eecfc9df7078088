"""What happened in a run, with wall-clock times: lines of JSON in a file beside the recording.

Unlike rows, events are few, and each is written at once: what came before a kill is there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from osc_contact.errors import RecordingError
from osc_contact.files import Json

MOST = 10_000  #: events that are kept; of later ones those of `ALWAYS` only
ALWAYS = frozenset({"start", "stop", "brakes", "reset", "end", "setting", "settings"})


def events_beside(path: Path) -> Path:
    """The file of the events of a recording, or of its rows."""
    return path.with_name(f"{path.stem}.events.jsonl")


def to_line(event: Json) -> str:
    """An event as a line of a file; numbers that JSON has not become text."""
    return json.dumps(_plain(event), ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return str(value)
    return value


class EventLog:
    """Notes events, and writes each to a file as it comes.

    Attributes:
        events: noted so far, with `time` (UTC, ISO 8601), `t` (s of the run) and `event`.
        omitted: number of those that were too many.
        error: why no more events are written, or None; what was written stays.
    """

    def __init__(self, path: Path | None) -> None:
        """Begin a file; None: events are kept in memory only.

        Raises:
            RecordingError: it cannot be created.
        """
        self.events: list[Json] = []
        self.omitted = 0
        self.error: RecordingError | None = None
        self._number = -1
        self._path = path
        if path is not None:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)
                how = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
                self._number = os.open(path, how, 0o644)
            except OSError as error:
                raise RecordingError(f"cannot begin the event log {path}: {error}") from error

    def note(
        self, t: float, event: str, facts: Json, later: Callable[[Callable[[], object]], None]
    ) -> None:
        """Note an event; never raises, see `error`.

        Args:
            t: time in the run (s). event: its kind. facts: JSON-able, what belongs to it.
            later: calls what writes, at once or from another thread.
        """
        if len(self.events) >= MOST and event not in ALWAYS and facts.get("to") != "SAFE_STOP":
            self.omitted += 1
            return
        now = datetime.now(UTC).isoformat(timespec="microseconds")
        made = {"time": now, "t": t, "event": event, **facts}
        self.events.append(made)
        if self._number >= 0 and self.error is None:
            later(partial(self._write, to_line(made).encode()))

    def _write(self, line: bytes) -> None:
        try:
            os.write(self._number, line)
        except OSError as error:
            self.error = RecordingError(f"no more events are written to {self._path}: {error}")

    def __del__(self) -> None:
        if getattr(self, "_number", -1) >= 0:
            os.close(self._number)
