"""One controller's records: bytes, their views, and what stands in them after a tick."""

from __future__ import annotations

from typing import Any

import numpy as np

from osc_contact.control.model_row import ModelRow
from osc_contact.control.reports import LostDirection
from osc_contact.law import frames
from osc_contact.law import tables as at
from osc_contact.law.layout import Bytes, records
from osc_contact.spatial import Array

__all__ = ["TickRecords"]


def _cell(raw: Bytes, dtype: np.dtype[Any], name: str) -> Array:
    """(1,) an integer of a head: read every tick, so faster than by its attribute."""
    start = int(dtype.fields[name][1])  # type: ignore[index]
    return raw[start : start + 8].view(np.int64)


class TickRecords:
    """MODEL, MEMORY and WORK of one controller.

    Attributes:
        row: MODEL. memory_bytes, work_bytes: the others. memory, contacts, column_memory, torques,
            joint_memory, arm_memory: views of MEMORY.
        work, arms, joints, columns, bodies: views of WORK.
        given_columns: N (r_all, 6), n_γ and N_μ − N, where pairs in Python put them.
        floats: WORK as numbers; what recordings keep are slices of it.
        rank, engaged, ticked, state: (1,) of WORK and MEMORY. X_WO, V_O: of WORK.
        active, phase: (contacts,), closed, collision: (r_all,) of MEMORY.
    """

    def __init__(
        self, row: ModelRow, memory: Bytes | None = None, floats: Array | None = None
    ) -> None:
        """Views for a MODEL row; `memory`, `floats`: MEMORY and WORK to look at (default: new)."""
        head = row.head
        self.row = row
        size, work_size = int(head.memory_bytes), int(head.work_bytes)
        self.memory_bytes: Bytes = np.zeros(size, np.uint8) if memory is None else memory
        self.floats: Array = np.zeros(work_size // 8) if floats is None else floats
        self.work_bytes: Bytes = self.floats.view(np.uint8)
        raw, c, r = self.memory_bytes, int(head.n_contacts), int(head.n_columns)
        self.memory = records(raw, 0, 1, at.MEMORY)[0]
        self.contacts = records(raw, int(head.contact_memory_at), c, at.CONTACT_MEMORY)
        self.column_memory = records(raw, int(head.column_memory_at), r, at.COLUMN_MEMORY)
        start = int(head.torque_memory_at)
        self.torques: Array = raw[start : start + 8 * int(head.n_motors)].view(np.float64)
        n = int(head.n_joints)
        self.joint_memory = records(raw, int(head.joint_memory_at), n, at.JOINT_MEMORY)
        self.arm_memory = records(raw, int(head.arm_memory_at), int(head.n_arms), at.ARM_MEMORY)
        raw = self.work_bytes
        self.work = records(raw, 0, 1, at.WORK)[0]
        self.rank = _cell(raw, at.WORK, "rank")
        self.X_WO, self.V_O = self.field("X_WO"), self.field("V_O")
        self.active: Array = self.contacts["active"]
        self.phase: Array = self.contacts["phase"]
        self.closed: Array = self.column_memory["closed"]
        self.collision: Array = self.column_memory["collision"]
        self.engaged, self.ticked, self.state = (
            _cell(self.memory_bytes, at.MEMORY, name) for name in ("engaged", "ticked", "state")
        )
        self.arms = records(raw, int(head.arm_work_at), int(head.n_arms), at.ARM_WORK)
        self.joints = records(raw, int(head.joint_work_at), n, at.JOINT_WORK)
        self.columns = records(raw, int(head.column_work_at), r, at.COLUMN_WORK)
        self.given_columns = tuple(
            self.columns[name] for name in ("N", "n_gamma_all", "friction_wrench")
        )
        self.bodies = records(raw, int(head.body_work_at), c, at.BODY_WORK)
        start = int(head.jacobian_at) // 8
        self.jacobian: Array = self.floats[start : start + 6 * n].reshape(n, 6)
        start = int(head.bars_at) // 8
        self.bars: Array = self.floats[start : start + int(head.n_bars)]

    def field(self, name: str) -> Array:
        """A field of WORK's head, as a slice of `floats`."""
        kind, offset = at.WORK.fields[name][:2]  # type: ignore[index]
        out = self.floats[offset // 8 : (offset + kind.itemsize) // 8]
        return out.reshape(kind.shape) if kind.shape else out

    def bar_basis(self) -> Array:
        """(bars, bars) whose first columns are the settable bar forces, see `law.linkage`."""
        head = self.row.head
        k, n, bars = int(head.n_arms), int(head.n_joints), int(head.n_bars)
        start = int(head.link_at) // 8 + 29 * k + 10 * n + bars * n
        return self.floats[start : start + bars * bars].reshape(bars, bars)

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
