"""Controllers as files: all numbers of one, with a checksum and the law that it was made for."""

import os
import zlib
from itertools import pairwise
from pathlib import Path
from struct import Struct
from typing import Any, Self

import numpy as np

from osc_contact.control.inputs import convert_arrays, read_tick
from osc_contact.control.records import TickRecords
from osc_contact.control.status import SafetyState, Status
from osc_contact.control.torque_limits import MotorLimits, relieve
from osc_contact.errors import InvalidInputError, SolverError
from osc_contact.files import write_whole
from osc_contact.interface import Measurement, Reference
from osc_contact.law import limits, records
from osc_contact.law.library import law_hash
from osc_contact.law.limits import TorqueLimits
from osc_contact.law.nested import Bytes, Nested
from osc_contact.spatial import Array

MAGIC = b"OSCCTRL1"
FORMAT = 1
_HEAD = Struct("<8sI4x64s2Q")  #: magic, format, law, sizes of the two parts
HEAD = _HEAD.size


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
    head = _HEAD.pack(MAGIC, FORMAT, law_hash().encode(), *map(len, parts))
    content = b"".join((head, *parts))
    return content + zlib.crc32(content).to_bytes(4, "little")


def save_controller(controller: Any, path: str | os.PathLike[str]) -> None:
    """Write a controller with all that it remembers to a file, see `SavedController.load`.

    Raises:
        InvalidInputError: see `controller_bytes`.
    """
    write_whole(controller_bytes(controller), path)


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
        given, flags = read_tick(self._records, *convert_arrays(measurement, reference))
        self._records.run(given, flags)
        if self.status is Status.SATURATED:
            try:
                relieve(self._limits, self._records)
            except SolverError:
                self._records.hold(*given[:2])
        return np.array(self._records.memory.torques)

    @property
    def status(self) -> Status:
        """How the last tick ended."""
        return Status(int(self._records.memory.status))

    @property
    def state(self) -> SafetyState:
        """Whether it runs, holds a posture or has stopped."""
        return SafetyState(int(self._records.memory.state))


def _parts(content: bytes) -> list[Any]:
    """The two parts of a file, checked."""
    if len(content) < HEAD + 4 or content[:8] != MAGIC:
        raise InvalidInputError("no controller: such a file begins with OSCCTRL1")
    _, form, law, *sizes = _HEAD.unpack(content[:HEAD])
    if form != FORMAT:
        raise InvalidInputError(f"a controller of format {form}; this version reads {FORMAT}")
    if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
        raise InvalidInputError("the file is damaged: its checksum does not fit")
    if law.decode() != law_hash():
        raise InvalidInputError(
            f"written with the law {law.decode()[:12]}, but this one is {law_hash()[:12]}: the "
            "records may differ. Save the controller again with this version"
        )
    if sum(sizes) + HEAD + 4 != len(content):
        raise InvalidInputError("the file is damaged: its sizes do not fit")
    numbers = np.frombuffer(content, np.uint8)
    ends = np.cumsum([HEAD, *sizes])
    return [numbers[a:b].copy() for a, b in pairwise(ends)]


def _is_whole(raw: Bytes, program: Bytes) -> bool:
    """Whether records and tables are where those of new ones with the same counts are."""
    sizes = ("n_arms", "n_joints", "n_motors", "n_contacts", "n_shapes", "n_columns")
    derived = ("n_bars", "n_extra", "row_bytes", "memory_bytes")
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
