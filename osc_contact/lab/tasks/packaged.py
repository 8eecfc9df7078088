"""Packaged tasks by name: an insertion of a seed, recorded, drawn and judged.

Their plans depend on functions of the signals and on places that are found, which scenario files
cannot have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.insertion import Peg
from osc_contact.control.controller import Controller
from osc_contact.errors import RecordingError, did_you_mean
from osc_contact.files import Json
from osc_contact.lab.tasks import pegs, two_pin_plan
from osc_contact.lab.tasks.insertion import (
    CLEARANCE,
    FINGERS,
    ROBOT,
    WIDTH,
    Insertion,
    Task,
    TaskRobot,
)
from osc_contact.lab.tasks.pegs import Inserted
from osc_contact.lab.tasks.solids import picture
from osc_contact.lab.tasks.two_pins import TwoPins
from osc_contact.lab.visual.parts import Content, Visual
from osc_contact.loop.loop import run_loop
from osc_contact.loop.recorder import Recorder
from osc_contact.plan.plan import Outcome, Plan
from osc_contact.recorder import Recording

PEG_COLOUR = (0.85, 0.55, 0.2, 1.0)  #: red, green, blue, opacity
BLOCK_COLOUR = (0.55, 0.65, 0.75, 0.35)  #: the peg is seen through the block


@dataclass(frozen=True)
class PreparedTask:
    """Task of a seed that is ready to run.

    Attributes:
        robot: simulated arms at their start.
        plan: plan of the task.
        controller: controller of the contacts that the plan names.
        judged: function that returns the result after the run, from the truth.
    """

    robot: TaskRobot
    plan: Plan
    controller: Controller
    judged: Callable[[], Inserted]


@dataclass(frozen=True)
class PackagedTask:
    """Task of the command line: an object that arms insert.

    Attributes:
        name: name of the task.
        description: sentence for lists.
        world: function that draws the task of a seed, with the errors of `World`.
        prepare: function that makes robot, plan and controller of a seed.
    """

    name: str
    description: str
    world: Callable[[int], Task]
    prepare: Callable[[int], PreparedTask]


def _peg_world(shape: Literal["square", "round"], seed: int) -> Insertion:
    """Peg and hole of a seed, with the default misplacement.

    Args:
        shape: shape of the peg.
        seed: seed of everything random.
    """
    return Insertion(Peg(shape, WIDTH), CLEARANCE, seed)


def _prepare_peg(shape: Literal["square", "round"], seed: int) -> PreparedTask:
    """Robot, plan and controller of a peg.

    Args:
        shape: shape of the peg.
        seed: seed of everything random.
    """
    world = _peg_world(shape, seed)
    robot, plan, controller = pegs.prepared(world)
    return PreparedTask(robot, plan, controller, partial(pegs.judged, world, robot, plan))


def _prepare_two_pins(seed: int) -> PreparedTask:
    """Robot, plan and controller of a bar with two pins.

    Args:
        seed: seed of everything random.
    """
    world = TwoPins(seed)
    robot, plan, controller = two_pin_plan.prepared(world)
    return PreparedTask(robot, plan, controller, partial(two_pin_plan.judged, world, robot, plan))


_TASKS = (
    PackagedTask(
        "round_peg",
        "a Panda inserts a round peg into a misplaced hole",
        partial(_peg_world, "round"),
        partial(_prepare_peg, "round"),
    ),
    PackagedTask(
        "square_peg",
        "a Panda inserts a square peg into a misplaced hole",
        partial(_peg_world, "square"),
        partial(_prepare_peg, "square"),
    ),
    PackagedTask(
        "two_pins",
        "two Pandas insert both pins of a bar into two misplaced holes at once",
        TwoPins,
        _prepare_two_pins,
    ),
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
    ready = task.prepare(seed)
    plan = ready.plan
    meta = {"packaged_task": task.name, "seed": seed}
    recorder = Recorder(ready.controller, journal=journal, meta=meta)
    # not checked: the checks before a run take the sides of a peg above its hole for endless faces,
    # which press into rims. The plan is checked in any case.
    run_loop(ready.robot, ready.controller, plan, recorder=recorder, progress=progress, check=False)
    return recorder.recording({"plan": plan.as_dict(), "inserted": asdict(ready.judged())})


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
    """Content of pictures of a task's recording: arms, object, and the block with its true holes.

    Args:
        recording: recording by `run_task`.
    """
    meta = recording.meta
    task = task_of(meta)
    world = task.world(int(meta["seed"]))
    scene = world.scene
    file, folder = robots.find_robot(ROBOT)
    arms = []
    joints = 0
    for arm in world.chain().arms:
        positions = slice(joints, joints + arm.model.nq)
        base = arm.base or pin.SE3.Identity()
        arms.append(Visual(arm.name, file, (folder,), base, positions, FINGERS))
        joints = positions.stop
    bodies = [
        Visual("object", picture(scene.object_solids, PEG_COLOUR), (), None),
        Visual("block", picture(scene.block_solids, BLOCK_COLOUR), (), scene.block_pose),
    ]
    title = task.name.replace("_", " ")
    return Content(title, arms, bodies, meta["contact_names"], meta["columns"], joints)
