"""Controllers as files: all numbers of one, with a checksum and the law that it was made for."""

from __future__ import annotations

import os
import zlib
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np

from osc_contact.control.records import TickRecords
from osc_contact.control.status import SafetyState, Status
from osc_contact.control.torque_limits import MotorLimits
from osc_contact.errors import InvalidInputError, SolverError
from osc_contact.files import whole_file
from osc_contact.interface import Measurement, Reference
from osc_contact.law import limits, records, tick
from osc_contact.law.compiled import rows
from osc_contact.law.library import law_hash
from osc_contact.law.limits import TorqueLimits
from osc_contact.law.nested import Bytes, Nested
from osc_contact.spatial import Array

__all__ = ["SavedController", "controller_bytes", "save_controller", "touched_rows"]

MAGIC = b"OSCCTRL1"
FORMAT = 1
HEAD = 96  #: bytes: magic, format (u32), 0 (u32), law (64), sizes of the two parts (u64)


def controller_bytes(controller: Any) -> bytes:
    """A controller as it is, as the content of a file.

    Raises:
        InvalidInputError: pairs, bodies or laws that only Python can evaluate, or pairs whose
            function is at an address of this process.
    """
    if controller._custom.needed:
        raise InvalidInputError(
            "this controller has pairs, bodies or laws that only Python can evaluate, so it cannot "
            "run without: use the packaged ones"
        )
    own = controller._records
    if (own.model.pairs.kind == records.FUNCTION).any():
        raise InvalidInputError(
            "this controller calls a function of this process (CompiledPair), which a file cannot "
            "hold: use the packaged pairs"
        )
    program = MotorLimits(controller.settings, own.model).program
    parts = [own.rows.raw.tobytes(), program.raw.tobytes()]
    head = b"".join(
        (
            MAGIC,
            FORMAT.to_bytes(4, "little"),
            bytes(4),
            law_hash().encode(),
            *(len(part).to_bytes(8, "little") for part in parts),
        )
    )
    content = b"".join((head, *parts))
    return content + zlib.crc32(content).to_bytes(4, "little")


def save_controller(controller: Any, path: str | os.PathLike[str]) -> None:
    """Write a controller with all that it remembers to a file, see `SavedController.load`.

    Raises:
        InvalidInputError: see `controller_bytes`.
    """
    with whole_file(path) as unfinished:
        unfinished.write_bytes(controller_bytes(controller))


class SavedController:
    """A controller out of a file: ticks as the one that was saved did, and as C programs do.

    It knows numbers only: no names, no reasons in words.

    Attributes:
        dt: control period (s).
    """

    def __init__(self, content: bytes) -> None:
        """Take the content of a file.

        Raises:
            InvalidInputError: it is damaged, no controller, or of another format or law.
        """
        raw, program = _parts(content)
        if not _is_whole(raw, program):
            raise InvalidInputError("the file is damaged: records do not lie as their sizes say")
        self._call = rows()
        model = raw[int(records.JOB.view(raw).model) :]
        self._records = TickRecords(model[: records.MODEL.view(model).row_bytes])
        self._records.rows.raw[:] = raw
        self._limits = TorqueLimits.__new__(TorqueLimits)
        self._limits.__setstate__(program)
        self.dt = float(self._records.model.period)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file that `save_controller` wrote.

        Raises:
            InvalidInputError: see above; with both versions where they differ.
        """
        try:
            return cls(Path(path).read_bytes())
        except InvalidInputError as error:
            raise InvalidInputError(f"{path}: {error}") from error

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Motor torques (n_a,) for one control period, see `Controller.tick`."""
        memory = self._records.memory
        squeeze = reference.squeeze_d
        flags = 0
        touched = np.zeros((0, 28))
        memory.squeeze[:] = squeeze
        if len(self._records.model.arms) > 2 and not (np.ndim(squeeze) == 0 and squeeze == 0.0):
            flags |= tick.COMMANDED
        if measurement.touched is not None:
            touched = touched_rows(measurement.touched)
            flags |= tick.MOVING
        if measurement.estimated:
            memory.derived = 1
        if measurement.wrench_valid is not None and not measurement.wrench_valid:
            memory.wrench_missing = 1
        given = [
            np.ascontiguousarray(x, dtype=float)
            for x in (
                measurement.q,
                measurement.v,
                measurement.wrenches,
                reference.X_WD.homogeneous,
                reference.V_D,
                reference.A_D,
                reference.alpha_d,
            )
        ]
        self._run(given, touched, flags)
        if self.status is Status.SATURATED:
            place = (self._records.rows.raw, 0, 0, self._limits.raw)
            try:
                limits.fill_program(*place)
                self._limits.solve(*self._limits.counts.tolist())
                limits.settle(*place)
            except SolverError:
                given[3] = np.full((4, 4), np.nan)
                self._run(given, np.zeros((0, 28)), 0)
        return np.array(memory.torques)

    def _run(self, given: list[Array], touched: Array, flags: int) -> None:
        job = self._records.job
        job[0] = flags
        self._call(self._records.rows.raw, 0, *given, touched)
        job[0] = 0

    @property
    def status(self) -> Status:
        """How the last tick ended."""
        return Status(int(self._records.memory.status))

    @property
    def state(self) -> SafetyState:
        """Whether it runs, holds a posture or has stopped."""
        return SafetyState(int(self._records.memory.state))


def touched_rows(touched: Any) -> Array:
    """(contacts, 28) X_WE by rows, V_E, A_E."""
    count = len(touched.X_WE)
    return np.hstack([np.reshape(touched.X_WE, (count, 16)), touched.V_E, touched.A_E])


def _parts(content: bytes) -> list[Any]:
    """The two parts of a file, checked."""
    if len(content) < HEAD + 4 or content[:8] != MAGIC:
        raise InvalidInputError("no controller: such a file begins with OSCCTRL1")
    form = int.from_bytes(content[8:12], "little")
    if form != FORMAT:
        raise InvalidInputError(f"a controller of format {form}; this version reads {FORMAT}")
    if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
        raise InvalidInputError("the file is damaged: its checksum does not fit")
    law = content[16:80].decode()
    if law != law_hash():
        raise InvalidInputError(
            f"written with the law {law[:12]}, but this one is {law_hash()[:12]}: the records may "
            "differ. Save the controller again with this version"
        )
    sizes = [int.from_bytes(content[at : at + 8], "little") for at in (80, 88)]
    if sum(sizes) + HEAD + 4 != len(content):
        raise InvalidInputError("the file is damaged: its sizes do not fit")
    numbers = np.frombuffer(content, np.uint8)
    ends = np.cumsum([HEAD, *sizes])
    return [numbers[a:b].copy() for a, b in pairwise(ends)]


def _is_whole(raw: Bytes, program: Bytes) -> bool:
    """Whether records and tables are where those of new ones with the same counts are."""
    sizes = ("n_arms", "n_joints", "n_motors", "n_contacts", "n_shapes", "n_columns")
    derived = ("n_pairs", "n_bars", "n_extra", "row_bytes", "memory_bytes")
    try:
        at = int(records.JOB.view(raw).model)
        (head,) = raw[at:][: records.MODEL.dtype.itemsize].view(records.MODEL.dtype)
        new = records.Rows(records.new_model(*(int(head[name]) for name in sizes)))
        layout = program.view(np.int64)
        solver = limits.new_program(*(int(layout[limits.PROGRAM.slot(one)]) for one in "aksp"))
    except (ValueError, IndexError, MemoryError, OverflowError):
        return False
    if len(new.raw) != len(raw) or len(solver) != len(program):
        return False
    job = records.JOB.view(new.raw)
    model = records.MODEL.view(new.model[0])
    layouts = [(new.raw, raw, 0, records.JOB.dtype.itemsize)]
    for name in ("model", "memory", "work", "input"):
        kind = getattr(records, name.upper())
        layouts.append((new.raw, raw, int(getattr(job, name)), _layout_bytes(kind)))
    layouts.append((solver, program, 0, _layout_bytes(limits.PROGRAM)))
    same = all((a[at : at + n] == b[at : at + n]).all() for a, b, at, n in layouts)
    return same and all(head[name] == getattr(model, name) for name in derived)


def _layout_bytes(kind: Nested) -> int:
    return 8 * (len(kind.tables) + len(kind.counts))
