"""Records of one controller: views of all its bytes, and calls of the law with them."""

from __future__ import annotations

import numpy as np

from osc_contact.control.status import LostDirection
from osc_contact.law import records as at
from osc_contact.law import vectors
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.records import Bytes, Rows, views
from osc_contact.spatial import Array, norm

STILL = np.zeros((0, 28))  #: motion of the touched bodies if all of them are at rest
UNNAMED = np.zeros(0)  #: active set of a reference that does not name active contacts
_ENDED_OK = 2  #: result of the law for a single row whose tick ended OK
_WHOLE_TICK = (0, at.LOOK, at.END)  #: switches, first part and end of a whole tick
#: Fields that `TickRecords.forget` sets to zero: of the head of MEMORY, and of the rows of its
#: tables (an empty tuple: all fields of the table).
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
    "lively",
    "wrench_age",
    "old_joints",
    "old_wrists",
    "balanced",
    "apart",
    "mixed",
    "tested",
    "above",
    "missed",
    "hopping",
    "repeats",
    "fresh",
    "step_left",
    "squeeze_left",
    "motion_sum",
    "force_sum",
    "over_contact",
    "over_wrist",
    "over_free",
    "over_tip",
    "centre_rate",
    "slope",
    "integral_cut",
)
FORGOTTEN_TABLES: dict[str, tuple[str, ...]] = {
    "joints": (),
    "arms": (),
    "columns": (
        "underforce",
        "overforce",
        "time_since_loss",
        "has_desired",
        "integral",
        "pressing",
        "hop_share",
        "hop_rate",
    ),
}


class TickRecords:
    """Views of MODEL, MEMORY and WORK of one controller.

    Attributes:
        rows: bytes of all records.
        index: row of the controller.
        at: offset of the JOB (bytes).
        model, memory, work: views of the records, see `law.records`.
        model_bytes, memory_bytes, work_bytes: bytes of the records.
        torques, squeeze: (n_a,) last torques (N m, N) and (bars,) desired internal forces (N), in
            MEMORY.
    """

    def __init__(self, rows: Rows | Bytes, index: int = 0, thread: int = 0) -> None:
        """Make views of a row of `rows`, or of new records with the bytes of a MODEL.

        Args:
            rows: records of controllers, or bytes of a MODEL.
            index: row.
            thread: thread whose WORK is used.
        """
        self.rows = rows = rows if isinstance(rows, Rows) else Rows(rows)
        self.index = index
        self.at = rows.starts[thread]
        self.model_bytes: Bytes = rows.model[index]
        self.memory_bytes: Bytes = rows.memory[index]
        self.work_bytes: Bytes = rows.work[thread]
        #: JOB of the thread as 64-bit words, of which the first are `switches`, `begin` and `stop`
        self._job = rows.jobs[thread].view(np.int64)
        self.model, self.memory, self.work, _ = views(rows, index, thread)
        self.torques: Array = self.memory.torques
        self.squeeze: Array = self.memory.squeeze

    def run(
        self, inputs: tuple[Array, ...], flags: int = 0, begin: int = at.LOOK, stop: int = at.END
    ) -> int:
        """Run parts of a tick.

        Args:
            inputs: q, v (n,), wrenches (arms, 6), X_WD (4, 4), V_D, A_D (6,), alpha_d (r,), touched
                (contacts, 28), and active (contacts,), which is empty unless active contacts are
                named.
            flags: sum of the law's switches: MOVING (motions of touched bodies are measured),
                COMMANDED (internal forces are commanded), OWN_FORCE and OWN_MOTION (custom laws),
                PARTIAL; 0: none.
            begin, stop: first part, and the part before which to stop.

        Returns:
            Twice the number of the next row, plus 1 if the row did not end OK: 2 for one that ended
            OK.
        """
        self._job[:3] = flags, begin, stop
        try:
            return int(law_rows()(self.rows.raw, 0, inputs))
        finally:
            self._job[:3] = _WHOLE_TICK

    def tick(self, inputs: tuple[Array, ...], switches: int = 0) -> bool:
        """Compute a whole tick of one row; return True if it ended OK.

        Args:
            inputs: q, v (n,), wrenches (arms, 6), X_WD (4, 4), V_D, A_D (6,), alpha_d (r,), touched
                (contacts, 28), and active (contacts,), which is empty unless active contacts are
                named.
            switches: sum of the law's switches, such as MOVING; 0: none.
        """
        if switches:
            return self.run(inputs, switches) == _ENDED_OK
        return bool(law_rows()(self.rows.raw, 0, inputs) == _ENDED_OK)

    def forget(self) -> None:
        """Zero integrals, counters and histories; keep tare, bias, phases and learned values.

        `FORGOTTEN` names fields of the head of MEMORY, `FORGOTTEN_TABLES` fields of the rows of its
        tables; without names all fields of the rows are zeroed.
        """
        for name in FORGOTTEN:
            self.memory.head[name] = 0
        for table, names in FORGOTTEN_TABLES.items():
            rows = getattr(self.memory, table).view(np.ndarray)
            if not names:
                rows[:] = np.zeros(1, rows.dtype)
            for name in names:
                rows[name] = 0

    def hold(self, q: Array, v: Array, reading: float = np.nan, begin: int = at.LOOK) -> None:
        """Run a tick, or one part of it, without a reference.

        Args:
            q, v: (n,) joint positions and velocities (rad, m; rad/s, m/s).
            reading: value of all wrist readings; with NaN the tick ends HELD.
            begin: first part.
        """
        wrenches = np.full((len(self.model.arms), 6), reading)
        zeros = np.zeros(6)
        inputs = (q, v, wrenches, np.eye(4), zeros, zeros, np.zeros(0), STILL, UNNAMED)
        self.run(inputs, begin=begin)

    def places(self, *parts: Array) -> Array:
        """Compute the indices (k,) in `rows.numbers` of the elements of some views, in sequence.

        Args:
            parts: arrays of eight-byte elements that share the memory of `rows`.
        """
        numbering = np.arange(len(self.rows.numbers))  # each element is its own index
        start = self.rows.raw.ctypes.data
        # views of the numbering with the offset, shape and strides of each part
        indices = [
            np.ndarray(
                part.shape, numbering.dtype, numbering, part.ctypes.data - start, part.strides
            )
            for part in parts
        ]
        return np.concatenate([index.ravel() for index in indices])

    def copy(self) -> TickRecords:
        """Copy of the records in separate bytes."""
        other = TickRecords(self.model_bytes)
        other.memory_bytes[:] = self.memory_bytes
        other.work_bytes[:] = self.work_bytes
        return other

    # --- energy coordinates, turned, and back ----------------------------------------------------

    def reflection(self) -> Array:
        """Matrix (6, 6) from energy coordinates to locked axes."""
        return vectors.reflection(self.work)

    def motions(self) -> Array:
        """Matrix (6, 6) from energy coordinates to motions at O in world axes."""
        return vectors.motions(self.work)

    def acceleration(self) -> Array:
        """Commanded spatial acceleration (6,) of the object at O (m/s², rad/s²)."""
        return self.motions() @ (self.reflection().T @ self.work.acceleration_t)

    def kept(self) -> Array:
        """Indices (r,) of the independent columns of N among all columns."""
        return self.work.kept[: int(self.work.rank)]

    def shares(self) -> Array:
        """Coordinates R (r, count) of the active columns of N in the independent ones."""
        chosen = self.work.chosen[: int(self.work.count)]
        return self.work.columns.share[chosen, : int(self.work.rank)].T.copy()

    def lost_directions(self, names: list[str]) -> tuple[LostDirection, ...]:
        """List the directions of motion that arms lose near singular postures.

        Each has the arm's name, the share of the command that is executed along it, the ratio 1/χ²
        of the arm's inertia there to the reference inertia, and the twist (6,) at O in world axes,
        scaled to a speed of 1 m/s, or to 1 rad/s where O is at rest. χ is the distance from the
        singular posture.

        Args:
            names: names of the arms, in the order of the chain.
        """
        if not self.work.n_lost:
            return ()
        # `lost` of an arm is a wrench; divided by the reference inertia it is a motion
        to_motion = self.motions() / self.model.reference
        directions = []
        for name, arm in zip(names, self.work.arms, strict=True):
            for e in range(int(arm.n_lost)):
                twist = to_motion @ arm.lost[e]
                size = norm(twist[:3]) or norm(twist[3:])  # turns without a speed of O: 1 rad/s
                ratio = 1.0 / max(float(arm.chi[e]), 1e-12) ** 2
                directions.append(LostDirection(name, float(arm.share[e]), ratio, twist / size))
        return tuple(directions)
