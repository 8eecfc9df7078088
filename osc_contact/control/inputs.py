"""What comes in each tick: sizes, types, and whether readings are new."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from osc_contact.control.records import Settings
from osc_contact.errors import InvalidInputError, SensorTimeout
from osc_contact.interface import Measurement, Reference, Touched, as_squeeze
from osc_contact.law.records import JOINTS, WRISTS
from osc_contact.spatial import Array, as_array

_double = partial(np.array, dtype=float, order="C")
_NEVER = float("-inf")
_READINGS = {"encoders": JOINTS, "wrists": WRISTS, "packet": JOINTS | WRISTS}


def _arrays(
    measurement: Any, reference: Any, settings: Settings
) -> Iterator[tuple[str, Any, tuple[int, ...]]]:
    """Names, values and shapes of the arrays that every tick takes."""
    n = settings.chain.nq
    k = len(settings.chain.arms)
    yield "q", getattr(measurement, "q", None), (n,)
    yield "v", getattr(measurement, "v", None), (n,)
    yield "wrenches", getattr(measurement, "wrenches", None), (k, 6)
    yield "V_D", getattr(reference, "V_D", None), (6,)
    yield "A_D", getattr(reference, "A_D", None), (6,)


def require_sizes(measurement: Measurement, reference: Reference, settings: Settings) -> None:
    """Refuse what no tick can take in.

    Args:
        measurement, reference: of the tick. settings: of the controller.

    Raises:
        InvalidInputError: with what is wrong.
    """
    k = len(settings.chain.arms)
    c = len(settings.contacts)
    for name, value, shape in _arrays(measurement, reference, settings):
        as_array(name, value, shape)
    touched = measurement.touched
    if touched is not None:
        as_array("touched X_WE", touched.X_WE, (c, 4, 4))
        as_array("touched V_E", touched.V_E, (c, 6))
        as_array("touched A_E", touched.A_E, (c, 6))
    alpha_d = as_array("reference alpha_d", reference.alpha_d, (None,))
    if np.abs(alpha_d).max(initial=0.0) > 1e6:  # the law takes in no more than 1.8e6
        raise InvalidInputError(f"reference alpha_d: {alpha_d} N; no robot presses with 1e6 N")
    if k < 3 and np.ndim(reference.squeeze_d):
        raise InvalidInputError(f"reference squeeze_d: {k} arms take a number, got an array")
    as_squeeze("reference squeeze_d", reference.squeeze_d, k * (k - 1) // 2)
    as_array("reference X_WD", reference.X_WD.homogeneous, (4, 4))


def require_shapes(measurement: Any, reference: Any, settings: Settings) -> None:
    """Refuse arrays of numbers that no tick of this controller will ever take.

    Args:
        measurement, reference: of the tick. settings: of the controller.

    Raises:
        InvalidInputError: with both shapes.
    """
    for name, value, shape in _arrays(measurement, reference, settings):
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.shape != shape:
            raise InvalidInputError(f"{name}: expected shape {shape}, got {value.shape}")


def convert_arrays(measurement: Measurement, reference: Reference) -> tuple[Measurement, Reference]:
    """Both with new arrays, contiguous and of double precision."""
    touched = measurement.touched
    if touched is not None:
        touched = Touched(_double(touched.X_WE), _double(touched.V_E), _double(touched.A_E))
    return (
        replace(
            measurement,
            q=_double(measurement.q),
            v=_double(measurement.v),
            wrenches=_double(measurement.wrenches),
            touched=touched,
        ),
        replace(
            reference,
            V_D=_double(reference.V_D),
            A_D=_double(reference.A_D),
            alpha_d=_double(reference.alpha_d, ndmin=1),
        ),
    )


def read_joints(x: Any, n: int) -> Array:
    """(n,) numbers, as far as x has them; else all of them NaN."""
    try:
        array = np.array(x, dtype=float)
    except Exception:  # numbers too large, or warnings made errors, among others
        array = np.zeros(0)
    return array if array.shape == (n,) else np.full(n, np.nan)


class Freshness:
    """The newest packet and stamps so far, of one controller.

    Attributes:
        repeated: ticks in a row, up to the last one, that repeated readings.
    """

    def __init__(self, dt: float, patience: float) -> None:
        """Judge packets that come every dt (s); readings may be repeated for `patience` (s)."""
        self.dt = dt
        self.patience = patience
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
        stamps = measurement.stamps
        number = measurement.sequence
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
