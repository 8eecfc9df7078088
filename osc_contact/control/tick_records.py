"""One controller's records: bytes, their views, and what stands in them after a tick."""

from __future__ import annotations

from typing import Any

import numpy as np

from osc_contact.control.model_row import ModelRow
from osc_contact.control.reports import LostDirection
from osc_contact.law import frames
from osc_contact.law import tables as at
from osc_contact.law.layout import Bytes, Rows, views
from osc_contact.spatial import Array

__all__ = ["TickRecords"]


def _cell(raw: Bytes, dtype: np.dtype[Any], name: str) -> Array:
    """(1,) an integer of a head: read every tick, so faster than by its attribute."""
    start = int(dtype.fields[name][1])  # type: ignore[index]
    return raw[start : start + 8].view(np.int64)


class TickRecords:
    """MODEL, MEMORY and WORK of one controller, in one run of bytes.

    Attributes:
        row: MODEL. rows: the bytes; index, thread: which row of them, whose WORK. at: of its JOB.
        memory, contacts, column_memory, torques, joint_memory, arm_memory, squeeze: of MEMORY.
        work, arms, joints, columns, bodies, jacobian, bars: of WORK.
        job: words of JOB, `switches`, `begin` and `stop` first.
        given_columns: N (r_all, 6), n_γ and N_μ − N, where pairs in Python put them.
        floats: WORK as numbers; what recordings keep are slices of it.
        status, rank, engaged, ticked, state: (1,) of MEMORY and WORK. X_WO, V_O: of WORK.
        active, phase: (contacts,), closed, collision: (r_all,) of MEMORY.
    """

    def __init__(
        self, row: ModelRow, rows: Rows | None = None, index: int = 0, thread: int = 0
    ) -> None:
        """Views of a row of `rows`; None: of new bytes, which begin as `row`."""
        self.rows = rows = Rows(row.raw) if rows is None else rows
        self.index, self.at = index, rows.starts[thread]
        self.row = row.within(rows.model[index])
        self.memory_bytes: Bytes = rows.memory[index]
        self.work_bytes: Bytes = rows.work[thread]
        self.floats: Array = self.work_bytes.view(np.float64)
        _, self.memory, self.work, _ = views(rows, index, thread)
        self.job = rows.jobs[thread].view(np.int64)
        memory, work = self.memory, self.work
        self.contacts, self.column_memory = memory.contacts, memory.columns
        self.joint_memory, self.arm_memory = memory.joints, memory.arms
        self.torques: Array = memory.torques
        self.squeeze: Array = memory.squeeze
        self.rank = _cell(self.work_bytes, at.WORK.dtype, "rank")
        self.status, self.engaged, self.ticked, self.state = (
            _cell(self.memory_bytes, at.MEMORY.dtype, name)
            for name in ("status", "engaged", "ticked", "state")
        )
        self.X_WO, self.V_O = self.field("X_WO"), self.field("V_O")
        self.active: Array = self.contacts["active"]
        self.phase: Array = self.contacts["phase"]
        self.closed: Array = self.column_memory["closed"]
        self.collision: Array = self.column_memory["collision"]
        self.arms, self.joints, self.columns = work.arms, work.joints, work.columns
        self.bodies = work.bodies
        self.given_columns = tuple(
            self.columns[name] for name in ("N", "n_gamma_all", "friction_wrench")
        )
        self.jacobian: Array = work.J_world
        self.bars: Array = work.bars

    def copy(self) -> TickRecords:
        """The same in separate bytes."""
        other = TickRecords(self.row)
        other.memory_bytes[:] = self.memory_bytes
        other.work_bytes[:] = self.work_bytes
        return other

    def field(self, name: str) -> Array:
        """A field of WORK's head, as a slice of `floats`."""
        kind, offset = at.WORK.dtype.fields[name][:2]
        out = self.floats[offset // 8 : (offset + kind.itemsize) // 8]
        return out.reshape(kind.shape) if kind.shape else out

    def bar_basis(self) -> Array:
        """(bars, bars) whose first columns are the settable bar forces, see `law.linkage`."""
        return np.asarray(self.work.basis)

    # --- energy coordinates, turned, and back ----------------------------------------------------

    def reflection(self) -> Array:
        """(6, 6) that turns energy coordinates so that the first axes are the locked ones."""
        return frames.reflection(self.work)

    def motions(self) -> Array:
        """(6, 6) from energy coordinates to motions at O in world axes."""
        return frames.motions(self.work)

    def acceleration(self) -> Array:
        """(6,) of the object at O as commanded, spatial."""
        return np.asarray(self.motions() @ (self.reflection().T @ self.work.x))

    def kept(self) -> Array:
        """(r,) which columns of N were kept, of all."""
        return self.columns.chosen[self.work.keep[: int(self.work.rank)].astype(int)]

    def shares(self) -> Array:
        """R (r, columns in force): every column in force from the kept ones."""
        r, count = int(self.work.rank), int(self.work.count)
        return np.eye(r) if r == count else self.columns.share[:count, :r].T.copy()

    def spread(self) -> tuple[Array, Array]:
        """Measured magnitudes and speeds (r_all,), 0 where the contact was out of N.

        Where columns depend on others this is one split of many, see `Contact.magnitudes`.
        """
        r, count = int(self.work.rank), int(self.work.count)
        out = np.zeros((2, len(self.columns)))
        if r:
            R, chosen = self.shares(), self.columns.chosen[:count]
            alpha, speed = self.work.alpha_meas[:r], self.work.speed[:r]
            out[0, chosen] = alpha if r == count else R.T @ np.linalg.solve(R @ R.T, alpha)
            out[1, chosen] = speed @ R
        return out[0], out[1]

    def lost_directions(self, names: list[str]) -> tuple[LostDirection, ...]:
        """What arms near singular postures are losing, in words and units."""
        if not self.work.n_lost:
            return ()
        to_motion, out = self.motions() / self.row.head.reference, []
        for name, arm in zip(names, self.arms, strict=True):
            for e in range(int(arm.n_lost)):
                twist = to_motion @ arm.lost[e]
                size = np.linalg.norm(twist[:3]) or np.linalg.norm(twist[3:])
                ratio = 1.0 / max(float(arm.chi[e]), 1e-12) ** 2
                out.append(LostDirection(name, float(arm.share[e]), ratio, twist / size))
        return tuple(out)
