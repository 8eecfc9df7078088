"""Insertions of a square peg with the true contacts of each millisecond, recorded once per seed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.contacts.insertion import Peg
from osc_contact.control.controller import Controller
from osc_contact.interface import Measurement, Reference
from osc_contact.lab.tasks.insertion import WIDTH, Insertion, InsertionRobot
from osc_contact.lab.tasks.pegs import Inserted, judged, prepared
from osc_contact.loop.loop import run_loop
from osc_contact.loop.protocols import Records
from osc_contact.plan.plan import Plan
from osc_contact.spatial import Array

CLEARANCE = 2e-4  #: of the hole (m)
MOST = 12  #: largest number of contacts of a millisecond that is stored


@dataclass
class InsertionRecorder(Records):
    """Recorder of what a recogniser reads, and of the truth that judges it.

    Attributes:
        robot: simulated robot with the true contacts.
        controller: controller of the run.
        plan: plan that is run.
        rows: values of each tick by name.
    """

    robot: InsertionRobot
    controller: Controller
    plan: Plan
    rows: dict[str, list[Any]] = field(default_factory=dict)

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Store pose, twist and wrench as measured, the stage, and the true contacts."""
        result = self.controller.result()
        values: dict[str, Any] = {
            "X_WO": np.array(result.X_WO),
            "V_O": np.array(result.V_O),
            "wrench": np.array(result.f_meas - result.bias_out),
            "stage": [stage.name for stage in self.plan.stages].index(self.plan.stage.name),
            "contacts": self._contacts(),
        }
        for name, value in values.items():
            self.rows.setdefault(name, []).append(value)

    def log(self, event: str, **facts: Any) -> None:
        """Ignore an event of the loop."""
        return

    def _contacts(self) -> Array:
        """True contacts (`MOST`, 9): point (m), outward normal of the hole, force on it (N)."""
        data = self.robot.plant.data
        found = np.full((MOST, 9), np.nan)
        forces = self.robot.contact_forces()
        for k in range(min(data.ncon, MOST)):
            contact = data.contact[k]
            found[k] = np.concatenate((contact.pos, contact.frame[:3], forces[k]))
        return found


def recorded(seed: int, folder: Path, clearance: float = CLEARANCE) -> dict[str, Array]:
    """Columns of the insertion of a seed, from its file, or from a run that makes it.

    Args:
        seed: seed of the task.
        folder: folder of the files.
        clearance: width of the hole less that of the peg (m).
    """
    path = folder / f"insertion-{seed}-{1e6 * clearance:.0f}um.npz"
    if not path.exists():
        task = Insertion(Peg("square", WIDTH), clearance, seed)
        robot, plan, controller = prepared(task)
        recorder = InsertionRecorder(robot, controller, plan)
        run_loop(robot, controller, plan, recorder=recorder)
        columns = {name: np.array(rows) for name, rows in recorder.rows.items()}
        columns["contacts"] = columns["contacts"].astype(np.float32)
        result = asdict(judged(task, robot, plan))
        columns["result"] = np.array(json.dumps(result, default=bool))  # NumPy has its own bool
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **columns)  # type: ignore[arg-type]
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def result_in(rows: dict[str, Array]) -> Inserted:
    """Result of a recorded insertion.

    Args:
        rows: columns of the recording.
    """
    return Inserted(**json.loads(str(rows["result"])))
