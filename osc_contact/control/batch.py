"""Many controllers at once: the rows of one batch, each with a separate model and memory."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt

from osc_contact.control.controller import Controller
from osc_contact.control.records import STILL, UNNAMED, TickRecords
from osc_contact.control.status import Status
from osc_contact.control.torque_limits import MotorLimits, relieve
from osc_contact.dynamics.assembly import object_pose
from osc_contact.errors import InvalidInputError, ModelError, SolverError
from osc_contact.law import records as at
from osc_contact.law import tick as law
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.records import Rows
from osc_contact.spatial import Array


class BatchController:
    """B controllers of one structure, ticked by one call; a row's answer is its single tick's.

    One structure: as many arms, joints, motors, contacts and columns of N, the same kinds of
    grasps. Masses, gains, contacts, friction, limits and memory are each row's own.

    Attributes:
        rows: B, how many controllers.
        threads: how many share a tick.
        status: (B,) of `Status`, of the last tick.

    Example:
        >>> rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
        >>> batch = osc.BatchController([rig.controller()] * 4)
        >>> q, X = np.tile(rig.q_start, (4, 1)), np.tile(rig.state.X_WO.homogeneous, (4, 1, 1))
        >>> batch.tick(q, np.zeros_like(q), np.zeros((4, 2, 6)), X).shape
        (4, 8)
    """

    def __init__(self, controllers: Sequence[Controller], threads: int = 1) -> None:
        """Take over models and memories; the controllers themselves are not touched afterwards.

        Args:
            controllers: one for each row (the same one again is copied).
            threads: each works on a part of the rows.

        Raises:
            InvalidInputError: none, different structures, or pairs, bodies or laws that only
                Python can evaluate.
        """
        if not controllers or threads < 1:
            raise InvalidInputError(f"{len(controllers)} controllers, {threads} threads: give ≥ 1")
        first = controllers[0]
        self._structure = _structure_of(first)
        for i, one in enumerate(controllers):
            self._require_fitting(i, one)
        self.rows = len(controllers)
        self.threads = threads
        self._settings = [c.settings for c in controllers]
        self._bytes = Rows(
            np.stack([c.records.model_bytes for c in controllers]),
            np.stack([c.records.memory_bytes for c in controllers]),
            threads,
        )
        self._start = self._bytes.memory.copy()
        self._look()
        self._codes[:] = Status.OK
        self._limits: dict[int, MotorLimits] = {}
        self._pool = ThreadPoolExecutor(threads)

    def _require_fitting(self, i: int, one: Controller) -> None:
        """Refuse a controller that cannot be a row of the batch.

        Args:
            i: number of the row. one: its controller.

        Raises:
            InvalidInputError: its structure differs from that of row 0, or it needs Python in the
                tick.
        """
        found = _structure_of(one)
        differing = [name for name, size in self._structure.items() if found[name] != size]
        if differing:
            raise InvalidInputError(
                f"row {i} differs from row 0 in {', '.join(differing)}; a batch has one "
                "structure: make one batch for each"
            )
        if one.needs_python:
            raise InvalidInputError(
                f"row {i} has pairs, bodies or laws that only Python can evaluate; a batch "
                "runs the packaged ones"
            )

    def _look(self) -> None:
        """Heads of all memories, (B, …) their columns, torques and squeezes; JOB of each thread."""
        memory = self._bytes.memory
        one = at.MEMORY.view(memory[0])
        starts = dict(zip(at.MEMORY.tables, one.layout.tolist(), strict=False))

        def table(name: str) -> Array:
            rows = getattr(one, name)
            return memory[:, starts[name] :][:, : rows.nbytes].view(rows.dtype)

        self._memories = memory[:, : at.MEMORY.dtype.itemsize].view(at.MEMORY.dtype)[:, 0]
        self._codes = self._memories["status"]
        self._columns = table("columns")
        self._torques = table("torques")
        self._squeeze = table("squeeze")
        self._jobs = [at.JOB.view(raw) for raw in self._bytes.jobs]

    def tick(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        wrenches: npt.ArrayLike,
        X_WD: npt.ArrayLike,
        *,
        V_D: npt.ArrayLike | None = None,
        A_D: npt.ArrayLike | None = None,
        alpha_d: npt.ArrayLike | None = None,
        squeeze_d: npt.ArrayLike | None = None,
        touched: npt.ArrayLike | None = None,
        active: npt.ArrayLike | None = None,
        wrench_valid: npt.ArrayLike | None = None,
    ) -> Array:
        """Motor torques (B, n_a) for one control period; rows as in `Controller.tick`.

        Args:
            q, v: (B, n) measured. wrenches: (B, arms, 6) of the wrists (N, N m).
            X_WD: (B, 4, 4) desired pose of the object. V_D, A_D: (B, 6), default 0.
            alpha_d: (B, r) desired contact forces (N), default 0.
            squeeze_d: (B,) desired internal force, or (B, bars) with three arms and more; default
                0 (None leaves bar forces at least effort).
            touched: (B, contacts, 28) X_WE by rows, V_E, A_E of the touched bodies; None: at rest.
            active: (B, contacts) which contacts are active, see `Reference`; None: as forces are
                desired.
            wrench_valid: (B,) whether wrenches are new ones; rows without it use their last.

        Raises:
            InvalidInputError: wrong shapes. Numbers that are not finite end their row HELD.
        """
        B = self.rows
        n, k, r, c = (
            self._structure[name] for name in ("n_joints", "n_arms", "n_columns", "n_contacts")
        )
        flags = self._command_squeeze(squeeze_d)
        motion = STILL
        if touched is not None:
            motion = _table("touched", touched, (B, c, 28))
            flags |= law.MOVING
        joints = _table("q", q, (B, n))
        args = (
            joints,
            _table("v", v, (B, n)),
            _table("wrenches", wrenches, (B, k, 6)),
            _table("X_WD", X_WD, (B, 4, 4)),
            _table("V_D", V_D, (B, 6)),
            _table("A_D", A_D, (B, 6)),
            _table("alpha_d", alpha_d, (B, r)),
            motion,
            UNNAMED if active is None else _table("active", active, (B, c)).ravel(),
        )
        if wrench_valid is not None:
            self._memories["wrench_missing"][:] = np.broadcast_to(wrench_valid, (B,)) == 0
        self._locate(joints.reshape(B, n))
        self._run_threads(flags, args)
        return np.array(self._torques)

    def _command_squeeze(self, squeeze_d: npt.ArrayLike | None) -> int:
        """Write the desired internal forces to the rows.

        Args:
            squeeze_d: one number for each row and bar (N); None: zeros.

        Returns:
            `COMMANDED` if more than two arms are commanded by it, else 0.
        """
        self._squeeze[:] = 0.0
        if squeeze_d is None:
            return 0
        self._squeeze[:] = np.reshape(np.asarray(squeeze_d, dtype=float), (self.rows, -1))
        return law.COMMANDED if self._structure["n_arms"] > 2 else 0

    def _run_threads(self, flags: int, args: tuple[Array, ...]) -> None:
        """Run the ticks of all rows, a part of them in each thread.

        Args:
            flags, args: switches and arguments of the law.
        """
        ends = np.linspace(0, self.rows, self.threads + 1).astype(int).tolist()
        others = [
            self._pool.submit(self._run, i, ends[i], ends[i + 1], flags, args)
            for i in range(1, self.threads)
        ]
        try:
            self._run(0, 0, ends[1], flags, args)
        finally:
            wait(others)
        for part in others:
            part.result()

    def _run(self, thread: int, lo: int, hi: int, flags: int, args: tuple[Array, ...]) -> None:
        """Run the ticks of some rows in one thread; rows that saturate are completed in Python.

        Args:
            thread: number of the thread. lo, hi: first row, and the row after the last one.
            flags: switches of the job, see `law.tick.rows`. args: arrays of inputs of all rows.
        """
        job = self._jobs[thread]
        start = self._bytes.starts[thread]
        while lo < hi:
            job.switches = flags
            job.first = lo
            job.last = hi
            lo = law_rows()(self._bytes.raw, start, args) >> 1
            if self._codes[lo - 1] == Status.SATURATED:
                self._relieve(lo - 1, thread, args)

    def _relieve(self, i: int, thread: int, args: tuple[Array, ...]) -> None:
        """Compute torques within the motor limits for a row whose tick ended SATURATED.

        If the quadratic program has no solution, the row's tick is run again with switch MISFIT.

        Args:
            i: number of the row. thread: number of its thread. args: arrays of inputs of all rows.
        """
        rows = TickRecords(self._bytes, i, thread)
        if i not in self._limits:
            self._limits[i] = MotorLimits(self._settings[i], rows.model)
        try:
            relieve(self._limits[i].program, rows)
        except SolverError:
            self._run(thread, i, i + 1, int(self._jobs[thread].switches) | law.MISFIT, args)

    def _locate(self, q: Array) -> None:
        """Find the objects' initial poses from the joints alone, if no arm holds one rigidly.

        Args:
            q: (rows, n) joint positions.
        """
        if self._settings[0].chain.leader is not None:
            return
        for i in np.flatnonzero(self._memories["located"] == 0):
            chain = self._settings[i].chain
            with suppress(ModelError):
                X_WO = object_pose(chain, q[i], chain.model.createData())
                self._memories["X_WO"][i] = X_WO.homogeneous
                self._memories["located"][i] = 1

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Rows back to the memory they began with.

        Args:
            mask: (B,) which rows; None: all of them.
        """
        mine = np.ones(self.rows, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        if mine.shape != (self.rows,):
            raise InvalidInputError(f"mask: expected ({self.rows},), got {mine.shape}")
        self._bytes.memory[mine] = self._start[mine]
        self._codes[mine] = Status.OK

    def replace(self, row: int, controller: Controller) -> None:
        """Let a row continue as another controller, from where that one is.

        Args:
            row: its number. controller: controller of the batch's structure; it is not touched
                afterwards.

        Raises:
            InvalidInputError: another structure, or no such row.
        """
        if not 0 <= row < self.rows:
            raise InvalidInputError(f"row {row}; the batch has rows 0 … {self.rows - 1}")
        self._require_fitting(row, controller)
        records = controller.records
        model = self._bytes.model
        if model.flags.writeable:
            model[row] = records.model_bytes
        elif (model[row] != records.model_bytes).any():
            model = model.copy()
            model[row] = records.model_bytes
            self._bytes = Rows(model, self._bytes.memory, self.threads)
            self._look()
        for memory in (self._bytes.memory, self._start):
            memory[row] = records.memory_bytes
        self._settings[row] = controller.settings
        self._limits.pop(row, None)
        self._codes[row] = Status.OK

    @property
    def status(self) -> Array:
        """Status (B,) of the last tick of each row, as integers of `Status`."""
        return self._codes.copy()

    @property
    def state(self) -> Array:
        """State (B,) of each row, as integers of `SafetyState`: running, holding or stopped."""
        return np.array(self._memories["state"])

    @property
    def alpha_meas(self) -> Array:
        """(B, r) measured contact magnitudes (N) of the last computed tick, 0 out of N."""
        return np.array(self._columns["alpha"])

    @property
    def normal_speed(self) -> Array:
        """(B, r) NᵀV_rel (m/s) of the last computed tick, 0 out of N."""
        return np.array(self._columns["speed"])

    def __getstate__(self) -> dict[str, Any]:
        made = "_pool", "_memories", "_codes", "_columns", "_torques", "_squeeze", "_jobs"
        own = {name: x for name, x in self.__dict__.items() if name not in made}
        return {**own, "_bytes": (self._bytes.model, self._bytes.memory)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a batch from its pickle: its records, views of them, and its threads."""
        self.__dict__.update(state)
        model, memory = state["_bytes"]
        self._bytes = Rows(model, memory, self.threads)
        self._look()
        self._pool = ThreadPoolExecutor(self.threads)


def _structure_of(controller: Controller) -> dict[str, int]:
    """Sizes and switches of a controller's model that must be equal in all rows of a batch."""
    head = controller.records.model
    shape = (
        "n_arms",
        "n_joints",
        "n_motors",
        "n_columns",
        "n_contacts",
        "row_bytes",
        "memory_bytes",
        "slipping",
        "leader",
    )
    return {name: int(head[name]) for name in shape}


def _table(name: str, x: npt.ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Input of a batch as an array in which the values of all rows follow each other.

    Args:
        name: name of the input, for messages. x: numbers, which need not be finite; None: zeros.
        shape: (rows, values of each row, …) that x must have.

    Returns:
        Array whose first two axes are joined.

    Raises:
        InvalidInputError: x has another shape.
    """
    array = np.zeros(shape) if x is None else np.ascontiguousarray(x, dtype=float)
    if array.shape != shape:
        raise InvalidInputError(f"{name}: expected shape {shape}, got {array.shape}")
    return array.reshape(-1, *shape[2:])
