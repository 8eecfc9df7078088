"""The bytes of one controller: how many of everything there are, and its records as views."""

from __future__ import annotations

from typing import Any

import numpy as np

from osc_contact.law import tables as at
from osc_contact.law.jit import leaf
from osc_contact.law.linkage import scratch_size
from osc_contact.law.nested import Bytes
from osc_contact.law.tables import Tick

__all__ = ["Bytes", "Rows", "new_model", "row_of", "views"]

_job, _model, _memory, _work, _input = (
    kind.at for kind in (at.JOB, at.MODEL, at.MEMORY, at.WORK, at.INPUT)
)


@leaf
def row_of(raw, at, i):
    """The records of a row.

    Args:
        raw: bytes of `Rows`. at: where the JOB of a thread is. i: which row.
    """
    job = _job(raw, at)
    model = _model(raw, job.model + i * job.model_step)
    memory = _memory(raw, job.memory + i * model.memory_bytes)
    return Tick(model, memory, _work(raw, job.work), _input(raw, job.input))


def _counts(k: int, n: int, a: int, c: int, s: int, r: int) -> dict[str, int]:
    """Sizes of all tables: arms, joints, motors, contacts, shapes, columns; and what follows."""
    bars = 1 if k == 2 else k * (k - 1) // 2
    extra = max(1, bars) + 6 * k
    three = k > 2
    return {
        "k": k,
        "n": n,
        "a": a,
        "c": c,
        "s": s,
        "r": r,
        "6k": 6 * k,
        "e": extra,
        "6e": 6 + extra,
        "bars": bars,
        "squeezes": max(1, bars),
        "k3": k * three,
        "6k3": 6 * k * three,
        "n3": n * three,
        "bars3": bars * three,
        "scratch": scratch_size(k, n) * three,
    }


def new_model(
    arms: int, joints: int, motors: int, contacts: int = 0, shapes: int = 0, columns: int = 0
) -> Bytes:
    """A row of MODEL in which nothing stands but how many there are of everything.

    Args:
        arms, joints, motors, contacts, shapes, columns: how many there are of each.
    """
    counts = _counts(arms, joints, motors, contacts, shapes, columns)
    raw = at.MODEL.new(counts)
    head = at.MODEL.view(raw)
    head.n_arms = arms
    head.n_joints = joints
    head.n_motors = motors
    head.n_pairs = head.n_contacts = contacts
    head.n_shapes = shapes
    head.n_columns = columns
    head.n_bars = counts["bars"]
    head.n_extra = counts["e"]
    head.row_bytes = len(raw)
    head.memory_bytes = len(at.MEMORY.new(counts))
    return raw


class Rows:
    """Controllers of one structure in one run of bytes, which `tick.rows` works on.

    Attributes:
        numbers, raw: all of it, as numbers and as bytes.
        model, memory: (rows, size) MODEL and MEMORY of each row.
        jobs, work, input: (threads, size) JOB, WORK and INPUT of each thread.
        starts: where the JOB of each thread is.
        job: JOB of the first thread.
    """

    def __init__(self, model: Bytes, memory: Bytes | None = None, threads: int = 1) -> None:
        """Copy models and memories.

        Args:
            model, memory: (rows, size) bytes; memory None: as new. threads: that share them.
        """
        model = np.atleast_2d(model)
        head = at.MODEL.view(model[0])
        counts = _counts(
            int(head.n_arms),
            int(head.n_joints),
            int(head.n_motors),
            int(head.n_contacts),
            int(head.n_shapes),
            int(head.n_columns),
        )
        if memory is None:
            memory = np.tile(at.MEMORY.new(counts), (len(model), 1))
        parts = {
            "jobs": np.tile(at.JOB.new(counts), (threads, 1)),
            "model": model,
            "memory": np.atleast_2d(memory),
            "work": np.tile(at.WORK.new(counts), (threads, 1)),
            "input": np.tile(at.INPUT.new(counts), (threads, 1)),
        }
        self.numbers = np.zeros(sum(part.size for part in parts.values()) // 8)
        self.raw: Bytes = self.numbers.view(np.uint8)
        starts, end = {}, 0
        for name, part in parts.items():
            starts[name] = end
            here = self.raw[end : end + part.size].reshape(part.shape)
            here[:] = part
            setattr(self, name, here)
            end += part.size
        self.starts = [i * self.jobs.shape[1] for i in range(threads)]
        for i in range(threads):
            job = at.JOB.view(self.jobs[i])
            job.stop = at.END
            job.last = job.count = len(model)
            job.model = starts["model"]
            job.model_step = model.shape[1]
            job.memory = starts["memory"]
            job.work = starts["work"] + i * self.work.shape[1]
            job.input = starts["input"] + i * self.input.shape[1]
        self.job = at.JOB.view(self.jobs[0])

    jobs: Bytes
    model: Bytes
    memory: Bytes
    work: Bytes
    input: Bytes


def views(rows: Rows, i: int = 0, thread: int = 0) -> Any:
    """The records of a row, as the law's parts take them.

    Args:
        rows: controllers. i: which. thread: whose WORK and INPUT.
    """
    return at.Tick(
        at.MODEL.view(rows.model[i]),
        at.MEMORY.view(rows.memory[i]),
        at.WORK.view(rows.work[thread]),
        at.INPUT.view(rows.input[thread]),
    )
