"""Many controllers at once: the rows of one batch, each with a separate model and memory."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.control.controller import Controller
from osc_contact.control.records import TickRecords
from osc_contact.control.status import Status
from osc_contact.control.torque_limits import MotorLimits
from osc_contact.errors import InvalidInputError, ModelError, SolverError
from osc_contact.law import records as at
from osc_contact.law import tick as law
from osc_contact.law.compiled import rows
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
            np.stack([c._records.model_bytes for c in controllers]),
            np.stack([c._records.memory_bytes for c in controllers]),
            threads,
        )
        self._start = self._bytes.memory.copy()
        self._call = first._rows
        head = first._records.model
        B = self.rows
        self._n = int(head.n_joints)
        self._k = int(head.n_arms)
        self._r = int(head.n_columns)
        self._c = int(head.n_contacts)
        self._still = np.zeros((0, 28))
        self._zeros = np.zeros((B, 6))
        self._look()
        self._codes[:] = Status.OK
        self._limits: dict[int, MotorLimits] = {}
        self._pool = _pool(threads)

    def _require_fitting(self, i: int, one: Controller) -> None:
        found = _structure_of(one)
        differing = [name for name, size in self._structure.items() if found[name] != size]
        if differing:
            raise InvalidInputError(
                f"row {i} differs from row 0 in {', '.join(differing)}; a batch has one "
                "structure: make one batch for each"
            )
        if one._custom.needed:
            raise InvalidInputError(
                f"row {i} has pairs, bodies or laws that only Python can evaluate; a batch "
                "runs the packaged ones"
            )

    def _look(self) -> None:
        """Heads of all memories, (B, …) their columns, torques and squeezes; JOB of each thread."""
        memory = self._bytes.memory
        begin = int(self._bytes.job.memory)

        def table(start: int, dtype: np.dtype[Any], shape: tuple[int, ...]) -> Any:
            strides = (memory.strides[0], *np.zeros(shape, dtype).strides)
            return np.ndarray((self.rows, *shape), dtype, self._bytes.raw, begin + start, strides)

        one = at.MEMORY.view(memory[0])
        starts = dict(zip(at.MEMORY.tables, one.layout.tolist(), strict=False))
        self._memories = table(0, at.MEMORY.dtype, ())
        self._codes = self._memories["status"]
        self._columns, self._torques, self._squeeze = (
            table(starts[name], getattr(one, name).dtype, getattr(one, name).shape)
            for name in ("columns", "torques", "squeeze")
        )
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
            wrench_valid: (B,) whether wrenches are new ones; rows without it use their last.

        Raises:
            InvalidInputError: wrong shapes. Numbers that are not finite end their row HELD.
        """
        B = self.rows
        zeros = self._zeros
        flags = 0
        motion = self._still
        if touched is not None:
            motion = _table("touched", touched, (B, self._c, 28)).reshape(B * self._c, 28)
            flags |= law.MOVING
        self._squeeze[:] = 0.0
        if squeeze_d is not None:
            self._squeeze[:] = np.reshape(np.asarray(squeeze_d, dtype=float), (B, -1))
            flags |= law.COMMANDED if self._k > 2 else 0
        desired = np.zeros((B, self._r)) if alpha_d is None else alpha_d
        args = (
            _table("q", q, (B, self._n)).ravel(),
            _table("v", v, (B, self._n)).ravel(),
            _table("wrenches", wrenches, (B, self._k, 6)).reshape(B * self._k, 6),
            _table("X_WD", X_WD, (B, 4, 4)).reshape(4 * B, 4),
            _table("V_D", zeros if V_D is None else V_D, (B, 6)).ravel(),
            _table("A_D", zeros if A_D is None else A_D, (B, 6)).ravel(),
            _table("alpha_d", desired, (B, self._r)).ravel(),
            motion,
        )
        if wrench_valid is not None:
            self._memories["wrench_missing"][:] = np.broadcast_to(wrench_valid, (B,)) == 0
        self._locate(args[0].reshape(B, self._n))
        ends = np.linspace(0, B, self.threads + 1).astype(int).tolist()
        others = (
            []
            if self._pool is None
            else [
                self._pool.submit(self._run, i, ends[i], ends[i + 1], flags, args)
                for i in range(1, self.threads)
            ]
        )
        try:
            self._run(0, 0, ends[1], flags, args)
        finally:
            wait(others)
        for part in others:
            part.result()
        return np.array(self._torques)

    def _run(self, thread: int, lo: int, hi: int, flags: int, args: tuple[Any, ...]) -> None:
        job = self._jobs[thread]
        start = self._bytes.starts[thread]
        job.switches = flags
        job.last = hi
        while lo < hi:
            job.first = lo
            lo = self._call(self._bytes.raw, start, *args) >> 1
            if self._codes[lo - 1] == Status.SATURATED:
                self._relieve(lo - 1, thread, args)

    def _relieve(self, i: int, thread: int, args: tuple[Any, ...]) -> None:
        """Torques within the limits for a row that has just ended SATURATED."""
        rows = TickRecords(self._bytes, i, thread)
        if i not in self._limits:
            self._limits[i] = MotorLimits(self._settings[i], rows.model)
        try:
            self._limits[i].relieve(rows)
        except SolverError:
            job = self._jobs[thread]
            flags = job.switches
            last = job.last
            job.switches = flags | law.MISFIT
            job.first = i
            job.last = i + 1
            self._call(self._bytes.raw, rows.at, *args)
            job.switches = flags
            job.last = last

    def _locate(self, q: Array) -> None:
        """Where no arm holds the object rigidly: find it once, from the joints alone."""
        if self._settings[0].chain.leader is not None:
            return
        for i in np.flatnonzero(self._memories["located"] == 0):
            chain = self._settings[i].chain
            data = chain.model.createData()
            pin.forwardKinematics(chain.model, data, q[i])
            try:
                X_WO = chain.object_pose(data).homogeneous
            except ModelError:
                continue
            self._memories["X_WO"][i] = X_WO
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
            row: its number. controller: of the batch's structure; it is not touched afterwards.

        Raises:
            InvalidInputError: another structure, or no such row.
        """
        if not 0 <= row < self.rows:
            raise InvalidInputError(f"row {row}; the batch has rows 0 … {self.rows - 1}")
        self._require_fitting(row, controller)
        records = controller._records
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
        """(B,) how each row's last tick ended, see `Status`."""
        return self._codes.copy()

    @property
    def state(self) -> Array:
        """(B,) whether each row runs, holds a posture or has stopped; see `SafetyState`."""
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
        gone = ["_pool", "_call", "_memories", "_codes", "_columns", "_torques", "_squeeze"]
        own = {name: x for name, x in self.__dict__.items() if name not in [*gone, "_jobs"]}
        return {**own, "_bytes": (self._bytes.model, self._bytes.memory)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _call=rows())
        model, memory = state["_bytes"]
        self._bytes = Rows(model, memory, self.threads)
        self._look()
        self._pool = _pool(self.threads)


def _pool(threads: int) -> ThreadPoolExecutor | None:
    """Of the threads beside the one that calls."""
    return ThreadPoolExecutor(threads - 1) if threads > 1 else None


def _structure_of(controller: Controller) -> dict[str, int]:
    head = controller._records.model
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


def _table(name: str, x: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    """x as a contiguous array of numbers of this shape; numbers need not be finite."""
    array = np.ascontiguousarray(x, dtype=float)
    if array.shape != shape:
        raise InvalidInputError(f"{name}: expected shape {shape}, got {array.shape}")
    return array
