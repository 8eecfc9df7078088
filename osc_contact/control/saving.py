"""File of a controller: all its numbers, the hash of the law that it needs, and a checksum."""

import zlib
from struct import Struct

from osc_contact.control.controller_state import ControllerState
from osc_contact.control.record_ranges import require_ranges
from osc_contact.control.torque_limits import MotorLimits
from osc_contact.errors import InvalidInputError
from osc_contact.law.library import law_hash
from osc_contact.law.records import FUNCTION

MAGIC = b"OSCCTRL1"
FORMAT = 1
_HEAD = Struct("<8sI4x64s2Q")  #: magic, format, law, sizes of the two parts
HEAD = _HEAD.size


def controller_bytes(controller: ControllerState) -> bytes:
    """Content of a file with the present records of a controller.

    It has a head (`_HEAD`), the records JOB, MODEL, MEMORY, WORK and INPUT, PROGRAM of the motor
    limits, and the CRC-32 of all of these.

    Raises:
        InvalidInputError: pairs, bodies or laws that only Python can evaluate, pairs whose function
            is at an address of this process, or a number out of its range (`record_ranges`).
    """
    if controller.needs_python:
        raise InvalidInputError(
            "this controller has pairs, bodies or laws that only Python can evaluate, so it cannot "
            "run without: use the packaged ones"
        )
    own_records = controller.records
    if (own_records.model.pairs.kind == FUNCTION).any():
        raise InvalidInputError(
            "this controller calls a function of this process (CompiledPair), which a file cannot "
            "hold: use the packaged pairs"
        )
    program = MotorLimits(controller.settings, own_records.model).program
    require_ranges(own_records.rows.raw, program.raw)
    parts = [own_records.rows.raw.tobytes(), program.raw.tobytes()]
    head = _HEAD.pack(MAGIC, FORMAT, law_hash().encode(), *map(len, parts))
    content = b"".join((head, *parts))
    return content + zlib.crc32(content).to_bytes(4, "little")
