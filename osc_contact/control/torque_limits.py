"""Torques of a saturated tick within the motors' limits, and what that costs."""

from __future__ import annotations

import numpy as np

from osc_contact.control.model_row import ModelRow
from osc_contact.control.reports import GivenUp
from osc_contact.control.settings import Settings
from osc_contact.control.tick_records import TickRecords, fill
from osc_contact.law.limits import TorqueLimits
from osc_contact.spatial import Array

__all__ = ["MotorLimits"]


class MotorLimits:
    """The quadratic program of one controller, its arrays made once."""

    def __init__(self, settings: Settings, row: ModelRow) -> None:
        head, chain = row.head, settings.chain
        self.chain, self.settings = chain, settings
        self._program = TorqueLimits(chain.n_a, max(1, int(head.n_columns)), int(head.n_extra))
        self._program.mass = chain.reference.inertia.mass
        self._sizes = np.zeros(4, dtype=np.int64)
        self._fill = fill()

    def relieve(self, rows: TickRecords, tau: Array) -> GivenUp:
        """Torques within the limits that lose least, in tau (n_a,); the force integral follows.

        Raises:
            SolverError: none were found.
        """
        program, sizes, chain = self._program, self._sizes, self.chain
        self._fill(rows.row.raw, rows.work_bytes, program._given, sizes)
        d, r, k, s = sizes.tolist()
        short = program.solve(d, r, k, s)
        work, memory, life = rows.work, rows.memory, self.settings.phases
        tau[:] = program.tau
        if life is not None and memory.ticked:
            step = life.torque_rate * self.settings.dt * chain.tau_max
            change = tau - rows.torques
            tau[:] = rows.torques + change / max(1.0, float(np.max(np.abs(change) / step)))
        rows.torques[:] = tau
        lost = program.lost_force[:r]
        memory.force_sum[:r] = work.force_next[:r] - work.gain[:r] * self.settings.dt * lost
        memory.force_rank = r
        squeeze = program.lost_squeeze[:s].copy()
        if len(rows.bars) > 1:
            squeeze = rows.bar_basis()[:, :s] @ squeeze
            rows.bars[:] -= squeeze
        elif s:
            work.internal[0] -= squeeze[0]
        motors = np.flatnonzero(program.at_limit)
        R = rows.shares()
        force = lost.copy() if r == int(work.count) else R.T @ np.linalg.solve(R @ R.T, lost)
        names = chain.joint_names
        motion = rows.motions() @ (rows.reflection().T @ _free(program.lost_motion, d))
        return GivenUp(
            tuple(names[chain.actuated[i]] for i in motors), program.wanted[motors],
            chain.tau_max[motors], force, motion, squeeze, short,
        )  # fmt: skip


def _free(motion: Array, d: int) -> Array:
    out = motion.copy()
    out[: 6 - d] = 0.0
    return out
