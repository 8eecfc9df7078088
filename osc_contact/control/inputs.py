"""Input of a tick: checks of sizes and types, detection of repeated readings."""

from collections.abc import Iterator
from numbers import Real

import numpy as np

from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import STILL, UNNAMED, TickRecords
from osc_contact.errors import InvalidInputError, brief, require_kind
from osc_contact.interface import Measurement, Reference, Stamps, Touched, as_numbers
from osc_contact.law import tick as law
from osc_contact.law.records import ESTIMATED, JOINTS, NOISY, OUTDATED, WRISTS
from osc_contact.spatial import Array, as_array

#: alpha_d for the law if a reference has no forces; the reference's own empty array is read-only.
NO_FORCES: Array = np.zeros(0)

_NEVER = float("-inf")  #: stamp and number before the first ones
#: Flags of the readings that a stamp or a packet number refers to.
_READINGS = {"encoders": JOINTS, "wrists": WRISTS, "packet": JOINTS | WRISTS}


def _required_arrays(
    measurement: object, reference: object, settings: Settings
) -> Iterator[tuple[str, object, tuple[int, ...]]]:
    """Yield name, value and required shape of each array that every tick needs.

    Args:
        measurement, reference: inputs of the tick, perhaps without some attributes; the value of a
            missing attribute is None.
        settings: settings of the controller, which determine the shapes.
    """
    n = settings.chain.nq
    k = len(settings.chain.arms)
    for name, shape in {"q": (n,), "v": (n,), "wrenches": (k, 6)}.items():
        yield name, getattr(measurement, name, None), shape
    for name in ("V_D", "A_D"):
        yield name, getattr(reference, name, None), (6,)


def require_sizes(measurement: Measurement, reference: Reference, settings: Settings) -> None:
    """Refuse inputs of wrong sizes, or with numbers that are not finite or out of range.

    Args:
        measurement, reference: inputs of the tick.
        settings: settings of the controller.

    Raises:
        InvalidInputError: with the name of the first such input, its value and the expected one.
    """
    k = len(settings.chain.arms)
    c = len(settings.contacts)
    for name, value, shape in _required_arrays(measurement, reference, settings):
        as_array(name, value, shape)
    require_stamps(measurement)
    touched = measurement.touched
    if touched is not None:
        require_kind("touched", touched, Touched, "osc_contact.interface.Touched(X_WE, V_E, A_E)")
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
    """Refuse desired forces above 1e6 N in magnitude.

    Args:
        name: name of the field of the reference, for the message.
        forces: a force or several (N).

    Raises:
        InvalidInputError: a force is larger.
    """
    if np.abs(forces).max(initial=0.0) > 1e6:
        raise InvalidInputError(f"reference {name}: {forces} N; no robot presses with 1e6 N")


def require_stamps(measurement: Measurement) -> None:
    """Refuse stamps and packet numbers that cannot be compared with earlier ones.

    Args:
        measurement: readings whose `stamps` and `sequence` are checked.

    Raises:
        InvalidInputError: `stamps` is no `Stamps` of numbers, or `sequence` is no number.
    """
    stamps = measurement.stamps
    number = measurement.sequence
    if stamps is not None:
        times = (stamps.encoders, stamps.wrists) if isinstance(stamps, Stamps) else (None,)
        if not all(isinstance(time, Real) for time in times):
            raise InvalidInputError(
                f"stamps is {brief(stamps)}; give osc.Stamps(encoders=t, wrists=t), the times of "
                "the readings in s by the clock of the robot"
            )
    if number is not None and not isinstance(number, Real):
        raise InvalidInputError(f"sequence is {brief(number)}; give the number of the packet")


def require_shapes(measurement: object, reference: object, settings: Settings) -> None:
    """Refuse numeric arrays of a wrong shape, which are an error of the program, not of a sensor.

    Args:
        measurement, reference: inputs of the tick.
        settings: settings of the controller.

    Raises:
        InvalidInputError: with the expected shape and that of the array.
    """
    for name, value, shape in _required_arrays(measurement, reference, settings):
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.shape != shape:
            raise InvalidInputError(f"{name}: expected shape {shape}, got {value.shape}")


def touched_rows(touched: Touched) -> Array:
    """Join the motion of the touched bodies to the table (contacts, 28) that the law reads.

    Each row has the 16 elements of X_WE by rows, V_E (6) and A_E (6).

    Args:
        touched: pose, twist (m/s, rad/s) and acceleration (m/s², rad/s²) of the body at each
            contact.

    Raises:
        InvalidInputError: different numbers of poses, twists and accelerations.
    """
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
    """Collect the arguments of the law for a tick.

    Fills `derived`, `wrench_missing` and `squeeze` of MEMORY, which are no arguments.

    Args:
        records: records of the controller.
        measurement, reference: inputs of the tick.

    Returns:
        Arrays q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched, active of `law.rows.rows`, and its
        switches.
    """
    if measurement.estimated:
        records.memory.derived = NOISY if measurement.noisy else ESTIMATED
    if measurement.wrench_valid is not None and not measurement.wrench_valid:
        records.memory.wrench_missing = 1
    flags = 0
    squeeze = reference.squeeze_d
    if type(squeeze) is float:
        records.squeeze.fill(squeeze)  # takes a quarter of the time of an assignment to a slice
    else:
        records.squeeze[:] = squeeze
    # with three arms or more, the number 0 does not command bar forces: they are of least effort
    if len(records.squeeze) > 1 and not (np.ndim(squeeze) == 0 and squeeze == 0.0):
        flags = law.COMMANDED
    table = STILL
    if measurement.touched is not None:
        table = touched_rows(measurement.touched)
        flags |= law.MOVING
    alpha_d = reference.alpha_d
    inputs = (
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
    return inputs, flags


def read_joints(x: object, n: int) -> Array:
    """Convert joint positions or velocities to an array (n,); all NaN if it is not possible.

    Args:
        x: any object, such as a list of numbers.
        n: number of joints.
    """
    try:
        array = np.array(x, dtype=float)
    except Exception:  # such as numbers too large, or warnings turned into errors
        array = np.zeros(0)
    return array if array.shape == (n,) else np.full(n, np.nan)


class Freshness:
    """Detection of repeated and outdated readings, by their stamps and packet numbers.

    Attributes:
        flags: readings of the last tick that were not new, a sum of JOINTS and WRISTS, plus
            OUTDATED if the packet was older than a previous one.
        repeated: number of consecutive ticks, up to the last one, with readings that were not new.
    """

    def __init__(self) -> None:
        """Begin without any stamp or packet number."""
        self.forget()

    def forget(self) -> None:
        """Forget all stamps and packet numbers, so that the next measurement counts as new."""
        self._newest_stamps = dict.fromkeys(_READINGS, _NEVER)
        self.repeated = self.flags = 0

    def compare(self, measurement: Measurement) -> int:
        """Compare stamps and packet number of a measurement with the newest ones; return `flags`.

        `_newest_stamps` has the newest time (s) or number by the name of its source: "encoders",
        "wrists", "packet".

        Args:
            measurement: measurement of a tick, with stamps, a packet number or both.
        """
        stamps = measurement.stamps
        marks: dict[str, float] = {}
        if stamps is not None:
            marks |= {"encoders": stamps.encoders, "wrists": stamps.wrists}
        if measurement.sequence is not None:
            marks["packet"] = measurement.sequence
        self.flags = 0
        for name, stamp in marks.items():
            if stamp > self._newest_stamps[name]:
                self._newest_stamps[name] = stamp
                continue
            self.flags |= _READINGS[name]
            if name == "packet" and stamp < self._newest_stamps[name]:
                self.flags |= OUTDATED
        self.repeated = self.repeated + 1 if self.flags else 0
        return self.flags
