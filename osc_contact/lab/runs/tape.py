"""A controller for programs without Python, with a recording of ticks to replay there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from osc_contact.control.controller import Controller
from osc_contact.control.inputs import touched_rows
from osc_contact.control.saving import controller_bytes
from osc_contact.control.without_python import write_library
from osc_contact.files import write_whole
from osc_contact.interface import Measurement, Reference
from osc_contact.lab.checks.preflight import require_ready
from osc_contact.lab.rig.references import require_known_times
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.runs.run import Taring, start
from osc_contact.law.records import Bytes
from osc_contact.loop.loop import run_loop
from osc_contact.spatial import Array

MAGIC = b"OSCTAPE4"
#: Flags of a tick, as in replay.c; bits from REPEATED on state which readings are repeated.
MEMORY, TOUCHED, WRENCH_MISSING, ESTIMATED, SQUEEZE, ACTIVE, NOISY = 1, 2, 4, 8, 16, 32, 64
REPEATED = 7


class Tape:
    """Record of a controller's ticks, each with its inputs and torques.

    Changes of MEMORY between ticks by the surrounding program (contacts engaged, a tare) are
    recorded, too.

    Attributes:
        count: number of recorded ticks.
    """

    def __init__(self, controller: Controller) -> None:
        """Replace `tick` of a controller by a function that also records inputs and torques."""
        self.count = 0
        self._encoded_ticks: list[bytes] = []  #: bytes of each tick
        self._controller = controller  #: controller whose ticks are recorded
        #: its own `tick`
        self._controller_tick: Callable[[Measurement, Reference], Array] = controller.tick
        #: bytes of MEMORY after the last tick
        self._memory_after = controller.records.memory_bytes.copy()
        controller.__dict__["tick"] = self.tick

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Run the tick of the controller and record its inputs and torques.

        Args:
            measurement: readings of the tick.
            reference: desired motion and forces.

        Returns:
            (n_a,) motor torques (N m, N).
        """
        controller = self._controller
        memory = controller.records.memory_bytes
        before = self.count
        first = memory.copy()
        changed = not np.array_equal(first, self._memory_after)
        tau = self._controller_tick(measurement, reference)
        if self.count == before:  # else the controller called this function again, and it noted
            self._append_tick(measurement, reference, first if changed else None, tau)
        self._memory_after = memory.copy()
        return tau

    def _append_tick(
        self, measurement: Measurement, reference: Reference, memory: Bytes | None, tau: Array
    ) -> None:
        """Append a tick: flags, changed memory, then inputs and torques as 64-bit numbers.

        Args:
            measurement: readings of the tick.
            reference: desired motion and forces.
            memory: bytes of MEMORY before the tick; None: as the last tick left them.
            tau: (n_a,) torques of the tick (N m, N).
        """
        controller = self._controller
        model = controller.records.model
        squeeze = np.ravel(reference.squeeze_d)
        has_squeeze = squeeze.any() and model.n_bars > 0
        is_wrench_missing = measurement.wrench_valid is not None and not measurement.wrench_valid
        # flags of the tick: which optional inputs follow
        is_set = {
            MEMORY: memory is not None,
            TOUCHED: measurement.touched is not None,
            WRENCH_MISSING: is_wrench_missing,
            ESTIMATED: measurement.estimated,
            NOISY: measurement.estimated and measurement.noisy,
            SQUEEZE: has_squeeze,
            ACTIVE: reference.active is not None,
        }
        flags = sum(flag for flag, condition in is_set.items() if condition)
        flags += controller.freshness.flags << REPEATED
        # inputs as the compiled law receives them, missing ones left out
        forces = np.zeros(model.n_columns)
        alpha = np.ravel(reference.alpha_d)
        forces[: len(alpha)] = alpha
        age = -1 if measurement.stamps is None else controller.records.memory.late
        parts: list[npt.NDArray[Any]] = [np.array([flags, controller.status, age], np.int64)]
        parts += [] if memory is None else [memory]
        numbers = [
            measurement.q,
            measurement.v,
            measurement.wrenches,
            reference.X_WD.homogeneous,
            reference.V_D,
            reference.A_D,
            forces,
            np.broadcast_to(squeeze, model.n_bars) if has_squeeze else (),
            () if measurement.touched is None else touched_rows(measurement.touched),
            () if reference.active is None else reference.active,
            tau,
        ]
        parts += [np.ascontiguousarray(x, dtype=float) for x in numbers]
        self._encoded_ticks.append(b"".join(part.tobytes() for part in parts))
        self.count += 1

    def content(self) -> bytes:
        """Bytes of the file that replay.c reads."""
        head = np.array([self.count, len(self._memory_after)], np.int64)
        return b"".join((MAGIC, head.tobytes(), *self._encoded_ticks))


def build(rig: Rig, folder: Path, ticks: int = 10_000, seed: int = 0) -> Tape:
    """Write a rig's controller, the C library, and a recording to replay into a folder.

    Args:
        rig: rig of a scenario.
        folder: folder of the files, which is created.
        ticks: length of the recording; beyond the duration of the scenario its signals continue.
        seed: seed of all random numbers.

    Returns:
        The recorded ticks.

    Raises:
        InvalidInputError: a pair, body or law can only be evaluated by Python.
        OscContactError: the law is not compiled to objects here, or the task cannot run.
        ScenarioError: the scenario has a plan.
    """
    require_known_times(rig.scenario, "a recording to replay in C")
    require_ready(rig)
    plant, controller = start(rig, seed)
    content = controller_bytes(controller)
    write_library(folder)
    tape = Tape(controller)
    taring = controller if rig.scenario.tare is None else Taring(rig, controller)
    run_loop(
        rig.robot(plant, controller), taring, rig.references.each(ticks, controller.dt), check=False
    )
    write_whole(content, folder / "controller.osc")
    write_whole(tape.content(), folder / "recording.osc")
    return tape
