"""Input of a tick: checks of sizes and types, detection of repeated readings."""

from collections.abc import Iterator

import numpy as np

from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import STILL, UNNAMED, TickRecords
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference, Touched, as_numbers
from osc_contact.law import tick as law
from osc_contact.law.records import JOINTS, OUTDATED, WRISTS
from osc_contact.spatial import Array, as_array

#: What the law takes for alpha_d where a reference has none: its own array is read-only.
NO_FORCES: Array = np.zeros(0)

_NEVER = float("-inf")
_READINGS = {"encoders": JOINTS, "wrists": WRISTS, "packet": JOINTS | WRISTS}


def _arrays(
    measurement: object, reference: object, settings: Settings
) -> Iterator[tuple[str, object, tuple[int, ...]]]:
    """Names, values and shapes of the arrays that every tick takes."""
    n = settings.chain.nq
    k = len(settings.chain.arms)
    for name, shape in {"q": (n,), "v": (n,), "wrenches": (k, 6), "V_D": (6,), "A_D": (6,)}.items():
        yield name, getattr(measurement, name, getattr(reference, name, None)), shape


def require_sizes(measurement: Measurement, reference: Reference, settings: Settings) -> None:
    """Refuse what no tick can take in.

    Args:
        measurement, reference: inputs of the tick. settings: settings of the controller.

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
    _require_force("alpha_d", as_array("reference alpha_d", reference.alpha_d, (None,)))
    if k < 3 and np.ndim(reference.squeeze_d):
        raise InvalidInputError(f"reference squeeze_d: {k} arms take a number, got an array")
    squeeze = as_numbers("reference squeeze_d", reference.squeeze_d, k * (k - 1) // 2)
    _require_force("squeeze_d", squeeze)
    if reference.active is not None:
        as_array("reference active", reference.active, (c,))
    as_array("reference X_WD", reference.X_WD.homogeneous, (4, 4))


def _require_force(name: str, forces: float | Array) -> None:
    """Refuse forces (N) that the law does not take in: more than 1.8e6 in size."""
    if np.abs(forces).max(initial=0.0) > 1e6:
        raise InvalidInputError(f"reference {name}: {forces} N; no robot presses with 1e6 N")


def require_shapes(measurement: object, reference: object, settings: Settings) -> None:
    """Refuse arrays of numbers that no tick of this controller will ever take.

    Args:
        measurement, reference: inputs of the tick. settings: settings of the controller.

    Raises:
        InvalidInputError: with both shapes.
    """
    for name, value, shape in _arrays(measurement, reference, settings):
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.shape != shape:
            raise InvalidInputError(f"{name}: expected shape {shape}, got {value.shape}")


def touched_rows(touched: Touched) -> Array:
    """(contacts, 28) X_WE by rows, V_E, A_E."""
    count = len(touched.X_WE)
    if len(touched.V_E) != count or len(touched.A_E) != count:
        raise InvalidInputError(f"touched: {count} poses, but other numbers of motions")
    table = np.empty((count, 28))
    table[:, :16] = np.reshape(touched.X_WE, (count, 16))
    table[:, 16:22] = touched.V_E
    table[:, 22:] = touched.A_E
    return table


def read_tick(
    records: TickRecords, measurement: Measurement, reference: Reference
) -> tuple[tuple[Array, ...], int]:
    """Arguments of the law's call in a tick, and its switches; the marks of readings go to MEMORY.

    Args:
        records: records of the controller. measurement, reference: input of the tick.
    """
    if measurement.estimated:
        records.memory.derived = 1
    if measurement.wrench_valid is not None and not measurement.wrench_valid:
        records.memory.wrench_missing = 1
    flags = 0
    squeeze = reference.squeeze_d
    if type(squeeze) is float:
        records.squeeze.fill(squeeze)  # costs a quarter of an assignment to a slice
    else:
        records.squeeze[:] = squeeze
    # with three arms and more, the number 0 leaves internal forces at least effort
    if len(records.squeeze) > 1 and not (np.ndim(squeeze) == 0 and squeeze == 0.0):
        flags = law.COMMANDED
    table = STILL
    if measurement.touched is not None:
        table = touched_rows(measurement.touched)
        flags |= law.MOVING
    alpha_d = reference.alpha_d
    given = (
        measurement.q,
        measurement.v,
        measurement.wrenches,
        reference.X_WD.homogeneous,
        reference.V_D,
        reference.A_D,
        alpha_d if alpha_d.size else NO_FORCES,
        table,
        UNNAMED if reference.active is None else reference.active,
    )
    return given, flags


def read_joints(x: object, n: int) -> Array:
    """(n,) numbers, as far as x has them; else all of them NaN."""
    try:
        array = np.array(x, dtype=float)
    except Exception:  # numbers too large, or warnings made errors, among others
        array = np.zeros(0)
    return array if array.shape == (n,) else np.full(n, np.nan)


class Freshness:
    """The newest packet and stamps so far, of one controller.

    Attributes:
        flags: which readings of the last tick were not new: JOINTS, WRISTS, OUTDATED.
        repeated: ticks in a row, up to the last one, with readings that were not new.
    """

    def __init__(self) -> None:
        """Nothing was read yet."""
        self.forget()

    def forget(self) -> None:
        """Begin again."""
        self._newest = dict.fromkeys(_READINGS, _NEVER)
        self.repeated = self.flags = 0

    def look(self, measurement: Measurement) -> int:
        """Compare a measurement with those before it; returns `flags`."""
        stamps = measurement.stamps
        number = measurement.sequence
        given = {} if stamps is None else {"encoders": stamps.encoders, "wrists": stamps.wrists}
        if number is not None:
            given["packet"] = number
        self.flags = 0
        for name, stamp in given.items():
            if stamp > self._newest[name]:
                self._newest[name] = stamp
                continue
            self.flags |= _READINGS[name]
            if name == "packet" and stamp < self._newest[name]:
                self.flags |= OUTDATED
        self.repeated = self.repeated + 1 if self.flags else 0
        return self.flags
