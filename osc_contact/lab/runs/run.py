"""One run: plant and controller, tick by tick, into a recording."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from pathlib import Path

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.errors import (
    Interrupted,
    InvalidInputError,
    PlantError,
)
from osc_contact.files import Json
from osc_contact.interface import Measurement, Reference
from osc_contact.lab.checks.preflight import require_ready
from osc_contact.lab.rig.references import force_steps, known_to
from osc_contact.lab.rig.rig import Rig, build_rig
from osc_contact.lab.scenarios.named import as_scenario
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.loop.judge import Plant
from osc_contact.loop.loop import run_loop
from osc_contact.loop.protocols import Shows
from osc_contact.loop.recorder import Recorder
from osc_contact.recorder import Recording
from osc_contact.spatial import Array

Progress = Callable[[float], None]
Install = Callable[[Controller], Controller]


def run(
    scenario: str | Path | Scenario,
    *,
    plant: str | None = None,
    duration: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    viewer: Shows | None = None,
    install: Install | None = None,
    journal: Path | None = None,
    build: Callable[[Scenario], Rig] = build_rig,
    check: Callable[[Rig], list[str]] = require_ready,
) -> Recording:
    """Run a scenario and record it.

    Memory does not grow with the duration: rows go to a file on the way, and the channels of a long
    recording stay on disk.

    Args:
        scenario: name or path as for `load_scenario`, or a scenario.
        plant: "mujoco" or "rigid" instead of the scenario's own.
        duration: s, instead of the scenario's own.
        seed: seed of everything random in the run (sensors and plants without noise use none).
        progress: called with the simulated time now and then.
        viewer: shows the run while it lasts (see `open_viewer`); it cannot hold the loop up.
        install: puts another control law into each controller of the run.
        journal: the file that the run's rows go to while it lasts, such as unfinished.mcap, for
            `recover` if the process is killed; None: a temporary one.
        build: makes the rig of the scenario. check: refuses it, or returns what is doubtful.

    Returns:
        The recording; `metrics(recording)` judges it.

    Raises:
        ScenarioError: it cannot be read, or cannot run, see `preflight`. What is doubtful
            is logged, and kept in `meta["doubts"]`.
        PlantError: the simulation diverged; `error.recording` holds what came before.
        Interrupted: Ctrl-C, SIGTERM or SIGHUP ended it; likewise.
    """
    scenario = as_scenario(scenario)
    if duration is not None:
        scenario = scenario.replaced(duration=duration)
    if plant is not None:
        scenario = scenario.replaced(plant={**dict(scenario.plant), "type": plant})
    rig = build(scenario)
    doubts = check(rig)
    simulated, controller = start(rig, seed, install)
    ticks = round(scenario.duration * scenario.control.rate)
    recorder = Recorder(
        controller,
        simulated,
        subject=rig.subject(controller),
        journal=journal,
        meta=_describe(rig, seed, doubts),
    )
    robot = rig.robot(simulated, controller)
    taring = controller if scenario.tare is None else Taring(rig, controller)
    plan = rig.references.each(ticks, controller.dt)
    with _recorded_to_the_end(recorder, ticks, controller.dt):
        run_loop(
            robot, taring, plan, recorder=recorder, viewer=viewer, progress=progress, check=False
        )
    return recorder.recording()


@contextmanager
def _recorded_to_the_end(recorder: Recorder, ticks: int, period: float) -> Iterator[None]:
    """Add the recording so far to an error that ends a loop before its last tick.

    Args:
        recorder: recorder of the loop. ticks: number of its ticks. period: of one (s).

    Raises:
        PlantError: the simulation diverged.
        Interrupted: a signal ended the loop.
    """
    try:
        yield
    except PlantError as error:
        error.recording = recorder.recording()
        raise
    except (KeyboardInterrupt, SystemExit) as error:  # a signal, see `run_loop`
        if recorder.count < ticks:
            ended = recorder.count * period
            interrupted = Interrupted(f"ended on request at t = {ended:g} s")
            interrupted.recording = recorder.recording({"ended_s": ended})
            raise interrupted from error


def _describe(rig: Rig, seed: int, doubts: list[str]) -> Json:
    """Entries of a recording's `meta` that are known before the run.

    Args:
        rig: rig of the scenario.
        seed: seed of everything random in the run.
        doubts: sentences of the checks before it.
    """
    scenario = rig.scenario
    return {
        "scenario": scenario.as_dict(),
        "source": scenario.source and scenario.source.name,
        "plant": scenario.plant.type,
        "seed": seed,
        "robot_files": rig.file_hashes(),
        "force_steps_s": force_steps(scenario),
        "doubts": doubts,
        "force_per_normal": known_to(rig.pairs, rig.state, 1.0),
    }


def start(rig: Rig, seed: int = 0, install: Install | None = None) -> tuple[Plant, Controller]:
    """Plant and controller of a rig at its start, under the torques that hold it, not limp.

    Args:
        rig: see `build_rig`. seed: seed of everything random.
        install: puts another control law into each controller.
    """
    plant = rig.plant(seed)
    controller = rig.controller()
    # laws of the user's own may remember their ticks: each controller has its own
    first = rig.controller() if callable(rig.scenario.laws) else copy(controller)
    if install is not None:
        controller = _installed(install, controller)
        first = _installed(install, first)
    plant.hold(first.tick(rig.at_start(plant.measure()), rig.references.at(0.0)))
    return plant, controller


def _installed(install: Install, controller: Controller) -> Controller:
    """Apply `install` to a controller; return the resulting controller.

    Raises:
        InvalidInputError: `install` does not take or return a controller.
    """
    how = "install= takes a function of a controller that returns one, such as lambda c: c"
    if not callable(install):
        raise InvalidInputError(f"{how}; got {install!r}")
    try:
        made = install(controller)
    except TypeError as error:
        own = error.__traceback__
        if own is not None and own.tb_next is None:  # raised by the call itself
            raise InvalidInputError(f"{how}; calling {install!r} with one: {error}") from error
        raise
    if not hasattr(made, "tick"):
        raise InvalidInputError(f"{how}; {install!r} returned {made!r}, which has no tick")
    return made


class Taring:
    """A controller that averages its wrist sensors at rest off the contacts, then engages."""

    def __init__(self, rig: Rig, controller: Controller) -> None:
        assert rig.scenario.tare is not None
        self.duration = rig.scenario.tare.duration
        self.engage_at = rig.references.engage_at
        self.controller = controller
        self.dt = controller.dt
        self.samples: list[Array] = []
        self.ticks = 0

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """See `Controller.tick`."""
        tau = self.controller.tick(measurement, reference)
        t = self.ticks * self.dt
        self.ticks += 1
        if self.controller.engaged:
            return tau
        if 2 * self.duration / 3 <= t < self.duration:  # once the start has settled
            self.samples.append(self.controller.residual_wrench())
        elif self.samples and t >= self.duration:
            self.controller.f_tare = np.mean(self.samples, axis=0)
            self.samples = []
        if t >= self.engage_at:
            self.controller.engage()
        return tau
