"""Rows of MODEL, MEMORY and WORK as bytes: how long they are, and their records as views."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.law import tables as at
from osc_contact.law.linkage import scratch_size

__all__ = ["Bytes", "new_model", "records"]

Bytes = NDArray[np.uint8]


def records(raw: Bytes, start: int, count: int, dtype: np.dtype[Any]) -> Any:
    """Records inside bytes, as a view with attributes.

    Args:
        raw: bytes. start: offset. count: how many. dtype: of `tables`.
    """
    return raw[start : start + count * dtype.itemsize].view(dtype).view(np.recarray)


def new_model(
    arms: int, joints: int, motors: int, contacts: int = 0, shapes: int = 0, columns: int = 0
) -> Bytes:
    """A row of MODEL in which nothing stands but how many there are of everything, and where.

    Args:
        arms, joints, motors, contacts, shapes, columns: how many there are of each.
    """
    k, n, c, r = arms, joints, contacts, columns
    bars = 1 if k == 2 else k * (k - 1) // 2
    extra = max(1, bars) + 6 * k
    wide = 6 + extra
    offsets, size = at.allocate({
        "head": at.CHAIN_BYTES, "arms": k * at.ARM_BYTES, "joints": n * at.JOINT_BYTES,
        "pairs": c * at.PAIR_BYTES, "shapes": shapes * at.SHAPE_BYTES,
        "columns": r * at.COLUMN_BYTES, "bodies": c * at.BODY_BYTES,
    })  # fmt: skip
    memory, memory_size = at.allocate({
        "head": at.MEMORY_BYTES, "contact_memory": c * at.CONTACT_MEMORY_BYTES,
        "torque_memory": 8 * motors,
        "joint_memory": n * at.JOINT_MEMORY_BYTES, "arm_memory": k * at.ARM_MEMORY_BYTES,
        "estimate": 8 * 2 * n, "last_wrenches": 8 * 6 * k,
        "column_memory": r * at.COLUMN_MEMORY_BYTES,  # last: pairs in Python may change r
    })  # fmt: skip
    work, work_size = at.allocate({
        "head": at.WORK_BYTES, "arm_work": k * at.ARM_WORK_BYTES,
        "joint_work": n * at.JOINT_WORK_BYTES, "column_work": r * at.COLUMN_WORK_BYTES,
        "body_work": c * at.BODY_WORK_BYTES, "locked": 8 * 7 * 6 * k,
        "extra": 8 * (2 * extra * n + wide * wide + 2 * wide + 2 * n),
        "link": 8 * (_linkage_size(k, n, bars) if k > 2 else 0),
        "flat": 8 * (5 * r + motors), "jacobian": 8 * 6 * n,
        "bars": 8 * bars,
    })  # fmt: skip
    raw: Bytes = np.zeros(size, dtype=np.uint8)
    head = records(raw, 0, 1, at.CHAIN)[0]
    for name, offset in (offsets | memory | work).items():
        if name != "head":
            setattr(head, f"{name}_at", offset)
    head.row_bytes, head.memory_bytes, head.work_bytes = size, memory_size, work_size
    head.n_arms, head.n_joints, head.n_motors = k, n, motors
    head.n_pairs = head.n_contacts = c
    head.n_shapes, head.n_columns = shapes, r
    head.n_bars, head.n_extra = bars, extra
    return raw


def _linkage_size(k: int, n: int, bars: int) -> int:
    """Numbers that `law.allocation` cuts out for three arms and more."""
    own = 3 * k + 2 * k + 3 * n + 6 * n + n + 18 * k + 6 * k + bars * n + bars * bars
    return own + scratch_size(k, n)
