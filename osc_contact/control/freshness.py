"""Whether a packet is a new one: its sequence number and its stamps, where they are given."""

from __future__ import annotations

from osc_contact.errors import SensorTimeout
from osc_contact.interface import Measurement, Stamps

__all__ = ["Freshness"]

_NEVER = float("-inf")


class Freshness:
    """What was newest so far, of one controller."""

    def __init__(self, dt: float, patience: float) -> None:
        """Judge packets that come every dt (s); stamps may stand still for `patience` (s)."""
        self.dt, self.patience = dt, patience
        self.forget()

    def forget(self) -> None:
        """Begin again."""
        self._sequence: int | None = None
        self._stamps = {"encoders": _NEVER, "wrists": _NEVER}
        self._ages = {"encoders": 0.0, "wrists": 0.0}

    def require(self, measurement: Measurement) -> None:
        """Refuse a packet that is none or no newer than the last, and readings that are too old.

        Raises:
            SensorTimeout: with what was repeated, and how old it is.
        """
        if measurement.stamps is not None:
            self._require_stamps(measurement.stamps)
        number, last = measurement.sequence, self._sequence
        if number is None:
            return
        if last is not None and number <= last:
            what = "came twice" if number == last else f"came after packet {last}"
            raise SensorTimeout(f"packet {number} {what}; nothing new was read")
        self._sequence = number

    def _require_stamps(self, stamps: Stamps) -> None:
        for name, newest in self._stamps.items():
            stamp = getattr(stamps, name)
            if stamp > newest:
                self._stamps[name], self._ages[name] = stamp, 0.0
            else:
                self._ages[name] += self.dt
        for name, age in self._ages.items():
            if age > self.patience * (1.0 + 1e-9):
                raise SensorTimeout(
                    f"{name}: the newest reading is of {self._stamps[name]:g} s and {age:.4g} s "
                    f"old; more than wrench_timeout = {self.patience:g} s is not run on"
                )
