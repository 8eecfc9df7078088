"""Changes of a controller from one tick to the next, as events for a log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from osc_contact.control.controller_settings import Settings
from osc_contact.control.controller_state import ControllerState
from osc_contact.control.status import SafetyState
from osc_contact.law import records as at

Event = tuple[str, dict[str, Any]]  #: kind, and what belongs to it

RISE = 1.1  #: times the ceiling that was noted last; smaller rises are no event
_STATES = tuple(SafetyState)
#: Of MEMORY: fields of which a change is an event, or may be a part of one.
_WATCHED = ("state", "engaged", "unbraked", "f_tare", "f_bias", "largest_force", "largest_sum")
_CEILINGS = {"contact": "largest_force", "wrist": "largest_sum"}  #: and the command of each
_COMMANDS = set(_CEILINGS.values())


def _parts() -> dict[str, slice]:
    """Place of each watched field among the bytes of all of them."""
    sizes = [at.MEMORY.dtype[name].itemsize for name in _WATCHED]
    ends = np.cumsum(sizes).tolist()
    return {
        name: slice(end - size, end) for name, size, end in zip(_WATCHED, sizes, ends, strict=True)
    }


_PARTS = _parts()


def _field(seen: bytes, name: str) -> np.ndarray[Any, Any]:
    """Numbers of a watched field.

    Args:
        seen: bytes of all watched fields.
        name: name of the field.
    """
    return np.frombuffer(seen[_PARTS[name]], at.MEMORY.dtype[name].base)


class Changes:
    """A controller's state, its contacts, tare and ceilings, compared with those at the last look.

    A look at a controller of which nothing has changed compares some bytes and returns at once.
    """

    def __init__(self, controller: ControllerState) -> None:
        """Begin with the controller as it is."""
        self._controller = controller
        self._take_records()
        self._ceilings: dict[str, float] = {}
        self._unbraked: str | None = None

    def _take_records(self) -> None:
        """Note where the watched fields stand in the records, and the limits of the ceilings."""
        records = self._controller.records
        head = records.memory_bytes[: at.MEMORY.dtype.itemsize].view(at.MEMORY.dtype)
        self._records = records
        self._words = records.rows.raw.view(np.int64)
        self._places = records.places(*(head[name] for name in _WATCHED))
        self._headroom = {key: float(records.model[f"{key}_headroom"]) for key in _CEILINGS}
        self._least = {key: float(records.model[f"{key}_ceiling"]) for key in _CEILINGS}
        self._seen = np.zeros(len(self._places), np.int64)
        self._before = self._read()

    def _read(self) -> bytes:
        """Copy the watched fields, one after the other."""
        self._words.take(self._places, out=self._seen, mode="clip")
        return self._seen.tobytes()

    def look(self) -> Sequence[Event]:
        """Events since the last look, the oldest first."""
        if self._controller.records is not self._records:
            self._take_records()
            return ()
        now = self._read()
        before = self._before
        if now == before:
            return ()
        self._before = now
        changed = {name for name, part in _PARTS.items() if now[part] != before[part]}
        if changed <= _COMMANDS:  # in every tick of a growing command
            return tuple(self._risen(now))
        return tuple(self._events(changed, before, now))

    def _events(self, changed: set[str], before: bytes, now: bytes) -> Iterator[Event]:
        """Events of the changed fields.

        Args:
            changed: names of the fields.
            before, now: all watched fields, at the last look and at this one.
        """
        controller = self._controller
        if "engaged" in changed:
            yield "setting", {"name": "engaged", "value": bool(_field(now, "engaged")[0])}
        for name in ("f_tare", "f_bias"):
            if name in changed:
                yield "setting", {"name": name, "value": _field(now, name).tolist()}
        if "state" in changed:
            old, new = (_STATES[int(_field(one, "state")[0])] for one in (before, now))
            kind = "reset" if old is SafetyState.SAFE_STOP else "state"
            reason = controller.reason if new is not SafetyState.RUN else ""
            yield kind, {"from": old.name, "to": new.name, "reason": reason}
        if changed & {"unbraked", "state"}:  # a joint is unbraked where the arms are stopped only
            joint = controller.unbraked
            if joint is not None and joint != self._unbraked:
                yield "brakes", {"joint": joint, "reason": controller.reason}
            self._unbraked = joint
        yield from self._risen(now)

    def _risen(self, now: bytes) -> Iterator[Event]:
        """Ceilings that follow the largest command so far, where they have risen."""
        for key, command in _CEILINGS.items():
            ceiling = self._headroom[key] * float(_field(now, command)[0])
            if ceiling > max(RISE * self._ceilings.get(key, 0.0), self._least[key]):
                self._ceilings[key] = ceiling
                yield "ceiling", {"name": f"{key}_ceiling", "value": ceiling}


def changed_settings(before: Settings, now: Settings) -> dict[str, list[Any]]:
    """Settings that differ between two controllers, such as safety.contact_force: [30.0, 50.0].

    Args:
        before, now: settings of the earlier and of the later controller.

    Returns:
        For each differing key [earlier value, later value].
    """
    found: dict[str, list[Any]] = {}
    for group in ("gains", "safety", "friction", "life", "posture_task", "joint_friction"):
        old, new = (_flat(group, getattr(one, group)) for one in (before, now))
        for key in {**old, **new}:
            if old.get(key) != new.get(key):
                found[key] = [old.get(key), new.get(key)]
    return found


def _flat(name: str, value: Any) -> dict[str, Any]:
    """The keys of a group of settings, and of the groups in it, with their paths."""
    fields = getattr(type(value), "model_fields", None)
    if fields is None:
        return {name: value}
    parts = [_flat(f"{name}.{key}", getattr(value, key)) for key in fields]
    return {key: one for part in parts for key, one in part.items()}
