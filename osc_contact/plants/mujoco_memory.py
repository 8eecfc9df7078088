"""Where MuJoCo keeps what a compiled loop must read: found on a small scene, and checked there.

Compiled code calls `mj_step` without Python. The count of contacts, the contacts themselves and the
constraint forces have no address that stays, so their places in `mjData` are looked up once.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.spatial import Array

__all__ = ["Places", "find_places"]

_TWO_BALLS = """<mujoco><option cone="elliptic"/><worldbody>
  <geom type="plane" size="1 1 1"/>
  <body pos="0 0 .09"><freejoint/><geom size=".1"/></body>
  <body pos="1 0 .09"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
_WORDS = 250  #: of mjData behind `ncon` that hold the pointers; it has more


@dataclass(frozen=True)
class Places:
    """Bytes from the beginning of `mjData`, and within one of its contacts.

    Attributes:
        ncon: an int32, the number of contacts. contact, efc_force: pointers.
        stride: from one contact to the next. geom, efc_address, pos, frame: in a contact.
    """

    ncon: int
    contact: int
    efc_force: int
    stride: int
    geom: int
    efc_address: int
    pos: int
    frame: int


@cache
def find_places() -> Places | None:
    """The places, once in a process; None where this MuJoCo cannot be called from compiled code."""
    try:
        import mujoco

        model = mujoco.MjModel.from_xml_string(_TWO_BALLS)
        data = mujoco.MjData(model)
        for _ in range(2):
            mujoco.mj_step(model, data)
        places = _look(data)
        _make_callable(Path(mujoco.__file__).parent)
    except (ImportError, AttributeError, OSError, RuntimeError, StopIteration):
        return None
    return places


def _look(data: Any) -> Places:
    start = int(data._address)
    clock = np.asarray(data.timer.duration)  # the timers end where the counts begin
    counts = _address(clock) + len(clock) * clock.strides[0]
    counted = [data.ncon, data.ne, data.nf, data.nl, data.nefc]
    if counted[0] != 2 or list((ctypes.c_int * 5).from_address(counts)) != counted:
        raise RuntimeError("the counts are elsewhere")
    contact = data.contact
    fields = [_address(getattr(contact, f)) for f in ("geom", "efc_address", "pos", "frame")]
    words = list((ctypes.c_size_t * _WORDS).from_address(counts & ~7))

    def slot(value: int) -> int:
        return (counts & ~7) + 8 * next(i for i, word in enumerate(words) if word == value) - start

    stride = int(contact.pos.strides[0])
    first = min(fields)  # a contact may begin with other fields
    begin = next(word for word in words if 0 <= first - word < stride)
    geom, efc_address, pos, frame = (at - begin for at in fields)
    force = slot(_address(data.efc_force))
    return Places(counts - start, slot(begin), force, stride, geom, efc_address, pos, frame)


def _make_callable(folder: Path) -> None:
    """Let compiled code find `mj_step` by its name."""
    from llvmlite import binding

    library = next(
        iter(sorted(folder.glob("libmujoco.so*")) + sorted(folder.glob("*mujoco*.d*l*")))
    )
    binding.load_library_permanently(str(library))
    if not binding.address_of_symbol("mj_step"):
        raise RuntimeError("mj_step is not found")


def _address(x: Array) -> int:
    return int(x.__array_interface__["data"][0])
