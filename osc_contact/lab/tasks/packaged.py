"""Packaged tasks by name: an insertion of a seed, recorded, drawn and judged.

Their plans depend on functions of the signals and on places that are found, which scenario files
cannot have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.insertion import Peg, Shape
from osc_contact.errors import RecordingError, did_you_mean
from osc_contact.files import Json
from osc_contact.lab.tasks.insertion import (
    CLEARANCE,
    FINGERS,
    LENGTH,
    ROBOT,
    WIDTH,
    Insertion,
    hole_boxes,
)
from osc_contact.lab.tasks.pegs import Inserted, judged, prepared
from osc_contact.lab.visual.parts import Content, Visual
from osc_contact.loop.loop import run_loop
from osc_contact.loop.recorder import Recorder
from osc_contact.plan.plan import Outcome
from osc_contact.recorder import Recording
from osc_contact.spatial import Array

PEG_COLOUR = (0.85, 0.55, 0.2, 1.0)  #: red, green, blue, opacity
BLOCK_COLOUR = (0.55, 0.65, 0.75, 0.35)  #: the peg is seen through the block
_CYLINDER, _BOX = 5, 6  #: numbers of shapes in pictures, see `robots.pictures`


@dataclass(frozen=True)
class PackagedTask:
    """Task of the command line: a peg of some shape that a Panda inserts.

    Attributes:
        name: name of the task.
        description: sentence for lists.
        shape: shape of the peg.
    """

    name: str
    description: str
    shape: Shape

    def insertion(self, seed: int) -> Insertion:
        """Peg and hole of a seed, with the errors of `World` and the default misplacement."""
        return Insertion(Peg(self.shape, WIDTH), CLEARANCE, seed)


_TASKS = (
    PackagedTask("round_peg", "a Panda inserts a round peg into a misplaced hole", "round"),
    PackagedTask("square_peg", "a Panda inserts a square peg into a misplaced hole", "square"),
)
TASKS = {task.name: task for task in _TASKS}  #: packaged tasks by name


def run_task(
    task: PackagedTask,
    seed: int = 0,
    *,
    journal: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Run a task and record it; `task_verdict` judges the recording.

    Args:
        task: packaged task.
        seed: seed of misplacement, clearance, masses and noise.
        journal: file of the rows during the run; None: a temporary file.
        progress: function that is called with the simulated time (s) every 100 ticks.
    """
    insertion = task.insertion(seed)
    robot, plan, controller = prepared(insertion)
    meta = {"packaged_task": task.name, "seed": seed}
    recorder = Recorder(controller, journal=journal, meta=meta)
    # not checked: the checks before a run take the sides of a peg above its hole for endless faces,
    # which press into rims. The plan is checked in any case.
    run_loop(robot, controller, plan, recorder=recorder, progress=progress, check=False)
    inserted = judged(insertion, robot, plan)
    return recorder.recording({"plan": plan.as_dict(), "inserted": asdict(inserted)})


def task_of(meta: Mapping[str, Any]) -> PackagedTask:
    """Packaged task of a recording.

    Args:
        meta: meta data of the recording.

    Raises:
        RecordingError: this version has no task of that name.
    """
    name = str(meta.get("packaged_task"))
    if name not in TASKS:
        raise RecordingError(f"no packaged task {name!r}; {did_you_mean(name, TASKS)}")
    return TASKS[name]


def task_verdict(recording: Recording) -> Json:
    """Judge the recording of a task by the true pose of the peg and the true forces.

    Keys of the result: scenario, seed, duration_s; task {word, failed, why}; plan, as
    `Plan.as_dict`; inserted, the fields of `Inserted`.

    Args:
        recording: recording by `run_task`.
    """
    meta = recording.meta
    plan = meta["plan"]
    inserted = Inserted(**meta["inserted"])
    word, why = "OK", []
    if not inserted.success:
        word = "NOT DONE"
        if plan["outcome"] == Outcome.DONE.value:
            why = [
                f"the peg is {1e3 * inserted.depth:.1f} mm deep, tilted by "
                f"{np.degrees(inserted.tilt):.2f} degrees"
            ]
        else:
            why = [f"the plan is {plan['outcome']}: {inserted.reason}"]
    return {
        "scenario": task_of(meta).name,
        "seed": meta["seed"],
        "duration_s": len(recording) / meta["control_rate_hz"],
        "task": {"word": word, "failed": not inserted.success, "why": why},
        "plan": plan,
        "inserted": meta["inserted"],
    }


def task_content(recording: Recording) -> Content:
    """Content of pictures of a task's recording: arm, peg, and the block with the true hole.

    Args:
        recording: recording by `run_task`.
    """
    meta = recording.meta
    task = task_of(meta)
    insertion = task.insertion(int(meta["seed"]))
    joints = len(meta["joint_names"])
    file, folder = robots.find_robot(ROBOT)
    at_rest = pin.SE3.Identity()
    arm = Visual(ROBOT, file, (folder,), at_rest, slice(0, joints), FINGERS)
    block = [_box(*box) for box in hole_boxes(insertion.true_hole)]
    bodies = [
        Visual("object", _picture([_peg_shape(insertion.peg)], PEG_COLOUR), (), None),
        Visual("block", _picture(block, BLOCK_COLOUR), (), insertion.true_hole.pose),
    ]
    title = task.name.replace("_", " ")
    return Content(title, [arm], bodies, meta["contact_names"], meta["columns"], joints)


def _picture(shapes: Sequence[Json], colour: Sequence[float]) -> Json:
    """Picture of shapes of one body, see `robots.pictures`.

    Args:
        shapes: shapes with their places.
        colour: red, green, blue and opacity of all.
    """
    return {"joints": [], "shapes": [{"joint": 0, "rgba": list(colour), **one} for one in shapes]}


def _box(centre: Array, edges: Array, turn: float) -> Json:
    """Box in a picture.

    Args:
        centre: (3,) its centre (m).
        edges: (3,) lengths of its edges (m).
        turn: its turn about z (rad).
    """
    place = pin.SE3(pin.exp3(np.array([0.0, 0.0, turn])), centre)
    return {
        "kind": _BOX,
        "size": (0.5 * edges).tolist(),
        "place": pin.SE3ToXYZQUAT(place).tolist(),
    }


def _peg_shape(peg: Peg) -> Json:
    """Box or cylinder of a peg in a picture, along −z of its frame."""
    half = 0.5 * LENGTH
    centre = np.array([0.0, 0.0, -half])
    if peg.shape == "square":
        return _box(centre, np.array([peg.width, peg.width, LENGTH]), 0.0)
    size = [0.5 * peg.width, half, 0.0]
    return {"kind": _CYLINDER, "size": size, "place": [*centre.tolist(), 0.0, 0.0, 0.0, 1.0]}
