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
from osc_contact.control.torque_limits import MotorLimits, apply_least_loss
from osc_contact.dynamics.assembly import object_pose
from osc_contact.errors import InvalidInputError, ModelError, SolverError
from osc_contact.law import records as law_records
from osc_contact.law import tick as law
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.records import Rows
from osc_contact.spatial import Array


class BatchController:
    """B controllers of one structure in one call; each row is bit-equal to a single controller.

    The structure comprises the numbers of arms, joints, motors, contacts and columns of N, and the
    kinds of grasps. Masses, gains, contacts, friction, limits and memory may differ between rows.

    Attributes:
        rows: B, number of controllers.
        threads: number of threads that share a tick.
        status: (B,) `Status` of the last tick of each row.

    Example:
        >>> rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
        >>> batch = osc.BatchController([rig.controller()] * 4)
        >>> q, X = np.tile(rig.q_start, (4, 1)), np.tile(rig.state.X_WO.homogeneous, (4, 1, 1))
        >>> batch.tick(q, np.zeros_like(q), np.zeros((4, 2, 6)), X).shape
        (4, 8)
    """

    def __init__(self, controllers: Sequence[Controller], threads: int = 1) -> None:
        """Copy models and memories of the controllers, which are not changed afterwards.

        Args:
            controllers: a controller for each row; the same controller may occur several times.
            threads: number of threads, each of which computes a part of the rows.

        Raises:
            InvalidInputError: no controller, no thread, different structures, or pairs, bodies or
                laws that only Python can evaluate.
        """
        if not controllers or threads < 1:
            raise InvalidInputError(f"{len(controllers)} controllers, {threads} threads: give ≥ 1")
        first = controllers[0]
        #: numbers of arms, joints, … that all rows have, by name
        self._structure = _structure_of(first)
        for i, controller in enumerate(controllers):
            self._require_fitting(i, controller)
        self.rows = len(controllers)
        self.threads = threads
        #: settings of the controller of each row
        self._settings = [c.settings for c in controllers]
        #: MODEL and MEMORY of all rows, WORK and INPUT of each thread
        self._records = Rows(
            np.stack([c.records.model_bytes for c in controllers]),
            np.stack([c.records.memory_bytes for c in controllers]),
            threads,
        )
        #: (B, size) bytes of MEMORY to which `reset` returns
        self._start_memory = self._records.memory.copy()
        self._make_views()
        self._statuses[:] = Status.OK
        #: programs for torques at the motors' limits, by the number of the row
        self._limits: dict[int, MotorLimits] = {}
        self._pool = ThreadPoolExecutor(threads)  #: threads of the ticks

    def _require_fitting(self, i: int, controller: Controller) -> None:
        """Refuse a controller that cannot be a row of the batch.

        Args:
            i: number of the row.
            controller: controller of this row.

        Raises:
            InvalidInputError: its structure differs from that of row 0, or it needs Python in the
                tick.
        """
        structure = _structure_of(controller)
        differing = [name for name, size in self._structure.items() if structure[name] != size]
        if differing:
            raise InvalidInputError(
                f"row {i} differs from row 0 in {', '.join(differing)}; a batch has one "
                "structure: make one batch for each"
            )
        if controller.needs_python:
            raise InvalidInputError(
                f"row {i} has pairs, bodies or laws that only Python can evaluate; a batch "
                "runs the packaged ones"
            )

    def _make_views(self) -> None:
        """Make views of the bytes in `_records`: of MEMORY of all rows, and of JOB of each thread.

        Sets `_memories` (B,), the heads of the MEMORY records, `_statuses` (B,), their status, and
        `_columns`, `_torques` and `_squeeze`, the tables of these names with B rows.
        """
        memory = self._records.memory
        first = law_records.MEMORY.view(memory[0])
        starts = dict(zip(law_records.MEMORY.tables, first.layout.tolist(), strict=False))

        def view_table(name: str) -> Array:
            """View (B, …) of a table of MEMORY, which is at the same place in all rows."""
            rows = getattr(first, name)
            return memory[:, starts[name] :][:, : rows.nbytes].view(rows.dtype)

        #: (B,) heads of the MEMORY records
        self._memories = memory[:, : law_records.MEMORY.dtype.itemsize].view(
            law_records.MEMORY.dtype
        )[:, 0]
        self._statuses = self._memories["status"]  #: (B,) status of the last tick
        self._columns = view_table("columns")  #: (B, r) states of the columns of N
        self._torques = view_table("torques")  #: (B, n_a) motor torques (N m, N)
        self._squeeze = view_table("squeeze")  #: (B, bars) desired internal forces (N)
        #: JOB of each thread
        self._jobs = [law_records.JOB.view(raw) for raw in self._records.jobs]

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
        """Compute the motor torques (B, n_a) of all rows for one control period (N m, N).

        A row has the result of `Controller.tick` with its inputs.

        Args:
            q, v: (B, n) measured joint positions and velocities (rad, m; rad/s, m/s).
            wrenches: (B, arms, 6) readings of the wrists (N, N m).
            X_WD: (B, 4, 4) desired pose.
            V_D, A_D: (B, 6) desired twist (m/s, rad/s) and classical acceleration (m/s², rad/s²) of
                the object; None: 0.
            alpha_d: (B, r) desired contact forces (N); None: 0.
            squeeze_d: (B,) desired internal force (N), or (B, bars) with three arms or more; None:
                0, and with three arms or more the bar forces of least effort.
            touched: (B, contacts, 28) X_WE by rows, V_E, A_E of the touched bodies; None: at rest.
            active: (B, contacts) active contacts, see `Reference`; None: they are not named.
            wrench_valid: (B,) False where the previous wrenches are used; None: all are new.

        Raises:
            InvalidInputError: a wrong shape. A row with a number that is not finite ends HELD.
        """
        # inputs of all rows as contiguous tables, in the order of the compiled function's arguments
        B = self.rows
        n, k, r, c = (
            self._structure[name] for name in ("n_joints", "n_arms", "n_columns", "n_contacts")
        )
        flags = self._command_squeeze(squeeze_d)
        if touched is not None:
            flags |= law.MOVING
        joints = _input_table("q", q, (B, n))
        args = (
            joints,
            _input_table("v", v, (B, n)),
            _input_table("wrenches", wrenches, (B, k, 6)),
            _input_table("X_WD", X_WD, (B, 4, 4)),
            _input_table("V_D", V_D, (B, 6)),
            _input_table("A_D", A_D, (B, 6)),
            _input_table("alpha_d", alpha_d, (B, r)),
            STILL if touched is None else _input_table("touched", touched, (B, c, 28)),
            UNNAMED if active is None else _input_table("active", active, (B, c)).ravel(),
        )
        if wrench_valid is not None:
            self._memories["wrench_missing"][:] = np.broadcast_to(wrench_valid, (B,)) == 0
        # rows are computed in parallel; each thread writes the torques of its rows
        self._locate_objects(joints.reshape(B, n))
        self._run_threads(flags, args)
        return np.array(self._torques)

    def _command_squeeze(self, squeeze_d: npt.ArrayLike | None) -> int:
        """Write the desired internal forces to MEMORY of the rows.

        Args:
            squeeze_d: (B,) or (B, bars) desired internal forces (N); None: zeros.

        Returns:
            Switch of the law: `COMMANDED` if more than two arms have commanded bar forces, else 0.
        """
        self._squeeze[:] = 0.0
        if squeeze_d is None:
            return 0
        self._squeeze[:] = np.reshape(np.asarray(squeeze_d, dtype=float), (self.rows, -1))
        return law.COMMANDED if self._structure["n_arms"] > 2 else 0

    def _run_threads(self, flags: int, args: tuple[Array, ...]) -> None:
        """Run the ticks of all rows, a part of them in each thread, the first part in this one.

        Args:
            flags: sum of the law's switches: MOVING (motions of touched bodies are measured),
                COMMANDED (internal forces are commanded), OWN_FORCE and OWN_MOTION (custom laws),
                PARTIAL; 0: none.
            args: arrays of inputs of all rows.

        Raises:
            Exception: raised in one of the threads, after all of them have ended.
        """
        ends = np.linspace(0, self.rows, self.threads + 1).astype(int).tolist()
        parts = [
            self._pool.submit(self._run_rows, i, ends[i], ends[i + 1], flags, args)
            for i in range(1, self.threads)
        ]
        try:
            self._run_rows(0, 0, ends[1], flags, args)
        finally:
            wait(parts)
        for part in parts:
            part.result()

    def _run_rows(
        self, thread: int, first: int, end: int, flags: int, args: tuple[Array, ...]
    ) -> None:
        """Run the ticks of some rows in one thread; rows that saturate are completed in Python.

        Args:
            thread: number of the thread.
            first, end: first row, and the row after the last one.
            flags: sum of the law's switches: MOVING (motions of touched bodies are measured),
                COMMANDED (internal forces are commanded), OWN_FORCE and OWN_MOTION (custom laws),
                PARTIAL; 0: none.
            args: arrays of inputs of all rows.
        """
        job = self._jobs[thread]
        start = self._records.starts[thread]
        while first < end:
            job.switches = flags
            job.first = first
            job.last = end
            # the law stops after a row that saturates and returns twice the number of the next row,
            # plus 1 if some row is not OK
            first = law_rows()(self._records.raw, start, args) >> 1
            if self._statuses[first - 1] == Status.SATURATED:
                self._limit_torques(first - 1, thread, args)

    def _limit_torques(self, i: int, thread: int, args: tuple[Array, ...]) -> None:
        """Compute torques within the motor limits for a row whose tick ended SATURATED.

        If the quadratic program has no solution, the row's tick is run again with switch MISFIT, by
        which the law ends it HELD instead of SATURATED.

        Args:
            i: number of the row.
            thread: number of its thread.
            args: arrays of inputs of all rows.
        """
        rows = TickRecords(self._records, i, thread)
        if i not in self._limits:
            self._limits[i] = MotorLimits(self._settings[i], rows.model)
        try:
            apply_least_loss(self._limits[i].program, rows)
        except SolverError:
            self._run_rows(thread, i, i + 1, int(self._jobs[thread].switches) | law.MISFIT, args)

    def _locate_objects(self, q: Array) -> None:
        """Compute the objects' initial poses from the joints, if no arm holds its object rigidly.

        Rows whose pose cannot be found keep `located` = 0; the law then ends their tick HELD.

        Args:
            q: (B, n) joint positions (rad, m).
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
        """Restore the memory with which rows began.

        Args:
            mask: (B,) True for the rows to reset; None: all of them.

        Raises:
            InvalidInputError: the mask has another shape.
        """
        is_reset = np.ones(self.rows, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        if is_reset.shape != (self.rows,):
            raise InvalidInputError(f"mask: expected ({self.rows},), got {is_reset.shape}")
        self._records.memory[is_reset] = self._start_memory[is_reset]
        self._statuses[is_reset] = Status.OK

    def replace(self, row: int, controller: Controller) -> None:
        """Replace the controller of a row by another one, which continues with its own memory.

        Args:
            row: number of the row, 0 … B − 1.
            controller: controller of the batch's structure, which is copied.

        Raises:
            InvalidInputError: another structure, or no such row.
        """
        if not 0 <= row < self.rows:
            raise InvalidInputError(f"row {row}; the batch has rows 0 … {self.rows - 1}")
        self._require_fitting(row, controller)
        records = controller.records
        model = self._records.model
        if model.flags.writeable:
            model[row] = records.model_bytes
        elif (model[row] != records.model_bytes).any():
            model = model.copy()
            model[row] = records.model_bytes
            self._records = Rows(model, self._records.memory, self.threads)
            self._make_views()
        for memory in (self._records.memory, self._start_memory):
            memory[row] = records.memory_bytes
        self._settings[row] = controller.settings
        self._limits.pop(row, None)
        self._statuses[row] = Status.OK

    @property
    def status(self) -> Array:
        """Status (B,) of the last tick of each row, as integers of `Status`."""
        return self._statuses.copy()

    @property
    def state(self) -> Array:
        """State (B,) of each row, as integers of `SafetyState`: running, holding or stopped."""
        return np.array(self._memories["state"])

    @property
    def alpha_meas(self) -> Array:
        """Measured contact forces (B, r) of the last computed tick (N); 0 for inactive columns."""
        return np.array(self._columns["alpha"])

    @property
    def normal_speed(self) -> Array:
        """Speeds NᵀV_rel (B, r) of the last computed tick (m/s); 0 for inactive columns."""
        return np.array(self._columns["speed"])

    def __getstate__(self) -> dict[str, Any]:
        """State for `pickle`: the attributes without threads and views, and bytes of the records.

        `__setstate__` makes threads and views again.
        """
        rebuilt = ("_pool", "_memories", "_statuses", "_columns", "_torques", "_squeeze", "_jobs")
        attributes = {name: value for name, value in self.__dict__.items() if name not in rebuilt}
        return {**attributes, "_records": (self._records.model, self._records.memory)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a batch from its pickle: its records, views of them, and its threads."""
        self.__dict__.update(state)
        model, memory = state["_records"]
        self._records = Rows(model, memory, self.threads)
        self._make_views()
        self._pool = ThreadPoolExecutor(self.threads)


def _structure_of(controller: Controller) -> dict[str, int]:
    """Sizes and switches of a controller's model that must be equal in all rows of a batch."""
    head = controller.records.model
    names = (
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
    return {name: int(head[name]) for name in names}


def _input_table(name: str, x: npt.ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Input of a batch as an array in which the values of all rows follow each other.

    Args:
        name: name of the input, for messages.
        x: numbers, which need not be finite; None: zeros.
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
