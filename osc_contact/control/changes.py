"""Changes of a controller from one tick to the next, as events for a log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from osc_contact.control.controller_settings import Settings
from osc_contact.control.controller_state import ControllerState
from osc_contact.control.reasons import hopping_contact
from osc_contact.control.status import SafetyState
from osc_contact.law import records as law_records

Event = tuple[str, dict[str, Any]]  #: kind of the event, and its values by name

RISE = 1.1  #: times the ceiling that was noted last; smaller rises are no event
_STATES = tuple(SafetyState)
#: Kinds of force ceilings, and the field of MEMORY with the largest command of each.
_CEILINGS = {"contact": "largest_force", "wrist": "largest_sum"}
#: Fields of MEMORY whose change is an event, or may be a part of one. The last ones, the commands,
#: change often.
_WATCHED_FIELDS = (
    "state",
    "engaged",
    "unbraked",
    "hopping",
    "f_tare",
    "f_bias",
    *_CEILINGS.values(),
)


def _field_slices() -> dict[str, slice]:
    """Compute the place of each watched field in the concatenated bytes of all watched fields."""
    sizes = [law_records.MEMORY.dtype[name].itemsize for name in _WATCHED_FIELDS]
    ends = np.cumsum(sizes).tolist()
    return {
        name: slice(end - size, end)
        for name, size, end in zip(_WATCHED_FIELDS, sizes, ends, strict=True)
    }


_BYTES_OF_FIELD = _field_slices()
_COMMANDS_BEGIN = _BYTES_OF_FIELD[
    next(iter(_CEILINGS.values()))
].start  #: where the bytes of commands begin


def _field_numbers(watched: bytes, name: str) -> np.ndarray[Any, Any]:
    """Numbers of a watched field, as an array of the field's type.

    Args:
        watched: bytes of all watched fields, one after the other.
        name: name of the field.
    """
    return np.frombuffer(watched[_BYTES_OF_FIELD[name]], law_records.MEMORY.dtype[name].base)


class Changes:
    """Watch on a controller: changes of state, contacts, tare and ceilings between two looks.

    `look` is called after each tick; without a change it only compares some bytes.
    """

    def __init__(self, controller: ControllerState) -> None:
        """Store the present state of the controller; only later changes are events."""
        self._controller = controller  #: controller that is watched
        self._locate_fields()
        self._noted_ceilings: dict[str, float] = {}  #: ceilings of the last event, by key (N)
        #: name of the joint without a sound reading, of the last event
        self._noted_joint: str | None = None

    def _locate_fields(self) -> None:
        """Locate the watched fields in the controller's records, and read the ceilings' settings.

        It is called again after the controller has replaced its records by others of another size.
        """
        records = self._controller.records
        head = records.memory_bytes[: law_records.MEMORY.dtype.itemsize].view(
            law_records.MEMORY.dtype
        )
        self._records = records  #: records in which the fields were located
        self._words = records.rows.raw.view(np.int64)  #: bytes of all records as 64-bit words
        #: indices of the watched fields in `_words`
        self._word_indices = records.places(*(head[name] for name in _WATCHED_FIELDS))
        #: ceilings as multiples of the largest command, by key
        self._headroom = {key: float(records.model[f"{key}_headroom"]) for key in _CEILINGS}
        #: ceilings that are set, by key (N)
        self._set_ceilings = {key: float(records.model[f"{key}_ceiling"]) for key in _CEILINGS}
        #: watched words of the last reading
        self._buffer = np.zeros(len(self._word_indices), np.int64)
        #: view of the largest commands in `_buffer` (N)
        self._largest_commands = self._buffer[_COMMANDS_BEGIN // 8 :].view(np.float64)
        self._last_bytes = self._read()  #: watched bytes at the last look

    def _read(self) -> bytes:
        """Copy the bytes of the watched fields, one field after the other."""
        self._words.take(self._word_indices, out=self._buffer, mode="clip")
        return self._buffer.tobytes()

    def look(self) -> Sequence[Event]:
        """Compare the controller with its state at the previous look; return the events between.

        Compared are the bytes of the watched fields of MEMORY; the first look at new records has no
        events.
        """
        if self._controller.records is not self._records:
            self._locate_fields()
            return ()
        after = self._read()
        before = self._last_bytes
        if after == before:
            return ()
        self._last_bytes = after
        if after[:_COMMANDS_BEGIN] == before[:_COMMANDS_BEGIN]:  # often: a command grows
            return tuple(self._raised_ceilings())
        changes = {name for name, part in _BYTES_OF_FIELD.items() if after[part] != before[part]}
        return tuple(self._events(changes, before, after))

    def _events(self, changed: set[str], before: bytes, after: bytes) -> Iterator[Event]:
        """Yield the events that follow from changed fields.

        Args:
            changed: names of the changed fields.
            before, after: bytes of all watched fields, at the last look and at this one.
        """
        controller = self._controller
        if "engaged" in changed:
            yield "setting", {"name": "engaged", "value": bool(_field_numbers(after, "engaged")[0])}
        for name in ("f_tare", "f_bias"):
            if name in changed:
                yield "setting", {"name": name, "value": _field_numbers(after, name).tolist()}
        if "state" in changed:
            old = _STATES[int(_field_numbers(before, "state")[0])]
            new = _STATES[int(_field_numbers(after, "state")[0])]
            kind = "reset" if old is SafetyState.SAFE_STOP else "state"
            reason = controller.reason if new is not SafetyState.RUN else ""
            yield kind, {"from": old.name, "to": new.name, "reason": reason}
        if changed & {"unbraked", "state"}:  # `unbraked` is a name only while the arms are stopped
            joint = controller.unbraked
            if joint is not None and joint != self._noted_joint:
                yield "brakes", {"joint": joint, "reason": controller.reason}
            self._noted_joint = joint
        if "hopping" in changed and _field_numbers(after, "hopping")[0]:
            yield "hopping", {"reason": hopping_contact(controller.records, controller.settings)}
        yield from self._raised_ceilings()

    def _raised_ceilings(self) -> Iterator[Event]:
        """Yield an event for each force ceiling (N) that has risen by the factor `RISE`.

        A ceiling is the one that is set or headroom × largest command, whichever is larger; the
        event is only for the latter, while it is the larger one.
        """
        for key, command in zip(_CEILINGS, self._largest_commands.tolist(), strict=True):
            ceiling = self._headroom[key] * command
            if ceiling > max(RISE * self._noted_ceilings.get(key, 0.0), self._set_ceilings[key]):
                self._noted_ceilings[key] = ceiling
                yield "ceiling", {"name": f"{key}_ceiling", "value": ceiling}


def changed_settings(before: Settings, after: Settings) -> dict[str, list[Any]]:
    """List the settings that differ between two controllers.

    Args:
        before, after: settings of the earlier and of the later controller.

    Returns:
        For each differing key [earlier value, later value], such as
        {"safety.contact_force": [30.0, 50.0]}.
    """
    differences: dict[str, list[Any]] = {}
    for group in ("gains", "safety", "friction", "life", "posture_task", "joint_friction"):
        old = _flat_settings(group, getattr(before, group))
        new = _flat_settings(group, getattr(after, group))
        for key in {**old, **new}:
            if old.get(key) != new.get(key):
                differences[key] = [old.get(key), new.get(key)]
    return differences


def _flat_settings(path: str, value: Any) -> dict[str, Any]:
    """Map the path of each key in a group of settings, nested groups included, to its value.

    Args:
        path: path of the group, such as "gains".
        value: a group of settings, or a single value.
    """
    fields = getattr(type(value), "model_fields", None)
    if fields is None:
        return {path: value}
    values: dict[str, Any] = {}
    for key in fields:
        values |= _flat_settings(f"{path}.{key}", getattr(value, key))
    return values
