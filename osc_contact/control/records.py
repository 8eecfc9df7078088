"""One controller's records: views of all its bytes, and the law's calls on them."""

from __future__ import annotations

import numpy as np

from osc_contact.control.status import LostDirection
from osc_contact.law import records as at
from osc_contact.law import vectors
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.records import Bytes, Rows, views
from osc_contact.spatial import Array, norm

STILL = np.zeros((0, 28))  #: motion of the touched bodies where all of them rest
UNNAMED = np.zeros(0)  #: the active set of a reference that names none
_ENDED_OK = 2  #: what the law returns for one row whose tick ended OK
_WHOLE_TICK = 0, at.LOOK, at.END
#: What `TickRecords.forget` sets to zero: fields of MEMORY, and of the rows of its tables (all of
#: their fields where none is named).
FORGOTTEN = (
    "age",
    "faults",
    "lost",
    "overspeed",
    "powered",
    "ending",
    "compared",
    "frozen",
    "still",
    "wrench_age",
    "old_joints",
    "old_wrists",
    "balanced",
    "apart",
    "mixed",
    "tested",
    "above",
    "missed",
    "repeats",
    "fresh",
    "step_left",
    "squeeze_left",
    "motion_sum",
    "force_sum",
    "over_contact",
    "over_wrist",
    "over_tip",
    "centre_rate",
)
FORGOTTEN_TABLES: dict[str, tuple[str, ...]] = {
    "joints": (),
    "arms": (),
    "columns": ("underforce", "overforce", "time_since_loss", "has_desired", "integral"),
}


class TickRecords:
    """MODEL, MEMORY and WORK of one controller, in one run of bytes.

    Attributes:
        rows: the bytes; index, thread: which row of them, whose WORK. at: of its JOB.
        model, memory, work: views, see `law.records`; model_bytes, memory_bytes, work_bytes.
        torques, squeeze: (n_a,) and (bars,) of MEMORY.
    """

    def __init__(self, rows: Rows | Bytes, index: int = 0, thread: int = 0) -> None:
        """Views of a row of `rows`; bytes: of new ones, which begin as this MODEL."""
        self.rows = rows = rows if isinstance(rows, Rows) else Rows(rows)
        self.index = index
        self.at = rows.starts[thread]
        self.model_bytes: Bytes = rows.model[index]
        self.memory_bytes: Bytes = rows.memory[index]
        self.work_bytes: Bytes = rows.work[thread]
        self._job = rows.jobs[thread].view(np.int64)  # `switches`, `begin` and `stop` first
        self.model, self.memory, self.work, _ = views(rows, index, thread)
        self.torques: Array = self.memory.torques
        self.squeeze: Array = self.memory.squeeze

    def run(
        self, given: tuple[Array, ...], flags: int = 0, begin: int = at.LOOK, stop: int = at.END
    ) -> int:
        """Parts of a tick; what the law's call returns, of one row 2 where it ended OK.

        Args:
            given: q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched, active.
            flags: switches of `law.tick`.
            begin, stop: first part, and the one before which it ends.
        """
        self._job[:3] = flags, begin, stop
        try:
            return int(law_rows()(self.rows.raw, 0, given))
        finally:
            self._job[:3] = _WHOLE_TICK

    def tick(self, given: tuple[Array, ...], switches: int = 0) -> bool:
        """Compute a whole tick of one row; returns whether it ended OK.

        Args:
            given, switches: see `run`.
        """
        if switches:
            return self.run(given, switches) == _ENDED_OK
        return bool(law_rows()(self.rows.raw, 0, given) == _ENDED_OK)

    def forget(self) -> None:
        """Zero what ticks have gathered, but for tare, bias, phases and learned values."""
        for name in FORGOTTEN:
            self.memory.head[name] = 0
        for table, names in FORGOTTEN_TABLES.items():
            rows = getattr(self.memory, table).view(np.ndarray)
            if not names:
                rows[:] = np.zeros(1, rows.dtype)
            for name in names:
                rows[name] = 0

    def hold(self, q: Array, v: Array, reading: float = np.nan, begin: int = at.LOOK) -> None:
        """Run a tick, or its part `begin`, that has no reference.

        Args:
            q, v: (n,). reading: of all wrists; NaN: the tick cannot be computed.
            begin: as in `run`.
        """
        wrenches = np.full((len(self.model.arms), 6), reading)
        six = np.zeros(6)
        self.run((q, v, wrenches, np.eye(4), six, six, np.zeros(0), STILL, UNNAMED), begin=begin)

    def places(self, *parts: Array) -> Array:
        """(k,) where in `rows.numbers` the numbers of some views stand, one after the other.

        Args:
            parts: arrays that share the memory of `rows`, each element of eight bytes.
        """
        every = np.arange(len(self.rows.numbers))
        start = self.rows.raw.ctypes.data
        own = (
            np.ndarray(part.shape, every.dtype, every, part.ctypes.data - start, part.strides)
            for part in parts
        )
        return np.concatenate([one.ravel() for one in own])

    def copy(self) -> TickRecords:
        """The same in separate bytes."""
        other = TickRecords(self.model_bytes)
        other.memory_bytes[:] = self.memory_bytes
        other.work_bytes[:] = self.work_bytes
        return other

    # --- energy coordinates, turned, and back ----------------------------------------------------

    def reflection(self) -> Array:
        """(6, 6) that turns energy coordinates so that the first axes are the locked ones."""
        return vectors.reflection(self.work)

    def motions(self) -> Array:
        """(6, 6) from energy coordinates to motions at O in world axes."""
        return vectors.motions(self.work)

    def acceleration(self) -> Array:
        """(6,) of the object at O as commanded, spatial."""
        return self.motions() @ (self.reflection().T @ self.work.acceleration_t)

    def kept(self) -> Array:
        """(r,) which columns of N were kept, of all."""
        return self.work.kept[: int(self.work.rank)]

    def shares(self) -> Array:
        """R (r, columns in force): every column in force from the kept ones."""
        chosen = self.work.chosen[: int(self.work.count)]
        return self.work.columns.share[chosen, : int(self.work.rank)].T.copy()

    def lost_directions(self, names: list[str]) -> tuple[LostDirection, ...]:
        """What arms near singular postures are losing, in words and units."""
        if not self.work.n_lost:
            return ()
        to_motion = self.motions() / self.model.reference
        out = []
        for name, arm in zip(names, self.work.arms, strict=True):
            for e in range(int(arm.n_lost)):
                twist = to_motion @ arm.lost[e]
                size = norm(twist[:3]) or norm(twist[3:])
                ratio = 1.0 / max(float(arm.chi[e]), 1e-12) ** 2
                out.append(LostDirection(name, float(arm.share[e]), ratio, twist / size))
        return tuple(out)
