"""Whether readings are new: a packet's sequence number and its stamps, where they are given."""

from __future__ import annotations

from osc_contact.errors import SensorTimeout
from osc_contact.interface import Measurement
from osc_contact.law.tables import JOINTS, WRISTS

__all__ = ["Freshness"]

_NEVER = float("-inf")
_READINGS = {"encoders": JOINTS, "wrists": WRISTS, "packet": JOINTS | WRISTS}


class Freshness:
    """The newest packet and stamps so far, of one controller.

    Attributes:
        repeated: ticks in a row, up to the last one, that repeated readings.
    """

    def __init__(self, dt: float, patience: float) -> None:
        """Judge packets that come every dt (s); readings may be repeated for `patience` (s)."""
        self.dt, self.patience = dt, patience
        self.forget()

    def forget(self) -> None:
        """Begin again."""
        self._newest = dict.fromkeys(_READINGS, _NEVER)
        self._ages = dict.fromkeys(_READINGS, 0.0)
        self.repeated = 0

    def require(self, measurement: Measurement) -> int:
        """Which readings are repeated, as flags JOINTS, WRISTS.

        Raises:
            SensorTimeout: readings that are too old, or a packet older than one read before.
        """
        stamps, number = measurement.stamps, measurement.sequence
        given: dict[str, float] = {}
        if stamps is not None:
            given = {"encoders": stamps.encoders, "wrists": stamps.wrists}
        if number is not None:
            given["packet"] = number
        flags = 0
        for name, stamp in given.items():
            if stamp > self._newest[name]:
                self._newest[name] = stamp
                self._ages[name] = 0.0
            elif name == "packet" and stamp < self._newest[name]:
                raise SensorTimeout(
                    f"packet {number} came after packet {self._newest[name]:.0f}; it is not used"
                )
            else:
                self._ages[name] += self.dt
                flags |= _READINGS[name]
        self.repeated = self.repeated + 1 if flags else 0
        for name, age in self._ages.items():
            if age > self.patience * (1.0 + 1e-9):
                newest = self._newest[name]
                which = f"packet {newest:.0f}" if name == "packet" else f"{name} of {newest:g} s"
                raise SensorTimeout(
                    f"nothing newer than {which} was read for {age:.4g} s; more than "
                    f"wrench_timeout = {self.patience:g} s is not run on"
                )
        return flags
