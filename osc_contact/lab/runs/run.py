"""Run of a scenario: plant and controller, tick by tick, into a recording."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from functools import partial
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
from osc_contact.lab.rig.dither import known_to
from osc_contact.lab.rig.references import force_steps
from osc_contact.lab.rig.rig import Rig, build_rig
from osc_contact.lab.scenarios.named import as_scenario
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.loop.judge import Plant
from osc_contact.loop.loop import run_loop
from osc_contact.loop.protocols import Shows
from osc_contact.loop.recorder import Recorder
from osc_contact.plan.plan import Plan
from osc_contact.recorder import Recording
from osc_contact.spatial import Array

Progress = Callable[[float], None]  #: function that is called with the simulated time (s)
Install = Callable[[Controller], Controller]  #: function that replaces laws of a controller


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

    Memory does not grow with the duration: rows are written to a file during the run, and the
    channels of a long recording stay on disk. Warnings of the check are logged, and stored in
    `meta["doubts"]`.

    Args:
        scenario: name or path as for `load_scenario`, or a scenario.
        plant: "mujoco", "rigid" or "drake" in place of the scenario's plant.
        duration: duration (s) in place of the scenario's.
        seed: seed of all random numbers of sensors and motors.
        progress: function that is called with the simulated time (s) every 100 ticks.
        viewer: viewer that shows the run while it lasts (see `open_viewer`); it does not delay the
            loop.
        install: function that puts another control law into each controller of the run.
        journal: file of the rows during the run, for example unfinished.mcap, for `recover` if the
            process is killed; None: a temporary file.
        build: function that makes the rig of the scenario.
        check: function that refuses the rig, or returns warnings.

    Returns:
        The recording; `metrics(recording)` judges it.

    Raises:
        ScenarioError: the scenario cannot be read, or cannot run, see `preflight`.
        PlantError: the simulation diverged; `error.recording` has the ticks until then.
        Interrupted: Ctrl-C, SIGTERM or SIGHUP ended the run; `error.recording` has the ticks until
            then.
    """
    scenario = as_scenario(scenario)
    if duration is not None:
        scenario = scenario.replaced(duration=duration)
    if plant is not None:
        scenario = scenario.replaced(plant={**dict(scenario.plant), "type": plant})
    rig = build(scenario)
    doubts = check(rig)
    # the recorder writes rows to the journal during the run, and reads them again at its end
    plant_of_run, controller = start(rig, seed, install)
    ticks = round(scenario.duration * scenario.control.rate)
    recorder = Recorder(
        controller,
        plant_of_run,
        subject=rig.subject(controller),
        journal=journal,
        meta=_describe(rig, seed, doubts),
    )
    robot = rig.robot(plant_of_run, controller)
    run_to_end = partial(run_loop, robot, recorder=recorder, viewer=viewer, check=False)
    with _recorded_to_the_end(recorder, ticks, controller.dt):
        if scenario.plan is not None:  # its stages tare by themselves
            plan = scenario.plan.made()
            run_to_end(controller, plan, progress=_aborting(plan, scenario.duration, progress))
            return recorder.recording({"plan": plan.as_dict()})
        taring = controller if scenario.tare is None else Taring(rig, controller)
        run_to_end(taring, rig.references.each(ticks, controller.dt), progress=progress)
    return recorder.recording()


def _aborting(plan: Plan, duration: float, progress: Progress | None) -> Progress:
    """Make a function of the simulated time that aborts a plan at the end of the duration.

    Args:
        plan: plan of the run.
        duration: longest time of the run (s).
        progress: function that is called with the simulated time, too; None: none.
    """

    def note(t: float) -> None:
        """Abort the plan if the time (s) is over."""
        if t >= duration:
            plan.abort(f"duration = {duration:g} s is over; give a longer one, or faster motions")
        if progress is not None:
            progress(t)

    return note


@contextmanager
def _recorded_to_the_end(recorder: Recorder, ticks: int, period: float) -> Iterator[None]:
    """Add the recording so far to an error that ends a loop before its last tick.

    Args:
        recorder: recorder of the loop.
        ticks: number of the loop's ticks.
        period: control period (s).

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
            end_time = recorder.count * period
            interrupted = Interrupted(f"ended on request at t = {end_time:g} s")
            interrupted.recording = recorder.recording({"ended_s": end_time})
            raise interrupted from error


def _describe(rig: Rig, seed: int, doubts: list[str]) -> Json:
    """Entries of a recording's `meta` that are known before the run.

    Args:
        rig: rig of the scenario.
        seed: seed of all random numbers of the run.
        doubts: warnings of the checks before the run.
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
    """Make plant and controller of a rig at its start, and apply the torques that hold the arms.

    The torques are those of the first tick, computed by a second controller, so that the returned
    one begins without a memory.

    Args:
        rig: rig of a scenario.
        seed: seed of all random numbers.
        install: function that puts another control law into each controller; None: none.
    """
    plant = rig.plant(seed)
    controller = rig.controller()
    # laws of the user's own may have a memory: each controller needs its own laws
    trial = rig.controller() if callable(rig.scenario.laws) else copy(controller)
    if install is not None:
        controller = _apply_install(install, controller)
        trial = _apply_install(install, trial)
    plant.hold(trial.tick(rig.at_start(plant.measure()), rig.references.at(0.0)))
    return plant, controller


def _apply_install(install: Install, controller: Controller) -> Controller:
    """Apply `install` to a controller; return the resulting controller.

    Raises:
        InvalidInputError: `install` does not take or return a controller.
    """
    how = "install= takes a function of a controller that returns one, such as lambda c: c"
    if not callable(install):
        raise InvalidInputError(f"{how}; got {install!r}")
    try:
        replacement = install(controller)
    except TypeError as error:
        trace = error.__traceback__
        is_of_call = trace is not None and trace.tb_next is None  # not raised inside the function
        if is_of_call:
            raise InvalidInputError(f"{how}; calling {install!r} with one: {error}") from error
        raise
    if not hasattr(replacement, "tick"):
        raise InvalidInputError(f"{how}; {install!r} returned {replacement!r}, which has no tick")
    return replacement


class Taring:
    """Controller that averages its wrist readings off the contacts, then engages the contacts.

    Attributes:
        duration: time of the tare (s).
        engage_at: time at which contacts engage (s).
        controller: controller of the arms.
        dt: control period (s).
        samples: residual wrenches (6,) of the ticks so far that are averaged (N, N m).
        ticks: number of ticks.
    """

    def __init__(self, rig: Rig, controller: Controller) -> None:
        """Set the times of the tare from a rig whose scenario has one."""
        assert rig.scenario.tare is not None
        self.duration = rig.scenario.tare.duration
        self.engage_at = rig.references.engage_at
        self.controller = controller
        self.dt = controller.dt
        self.samples: list[Array] = []
        self.ticks = 0

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Compute motor torques (n_a,) as `Controller.tick`, and take the tare by its time.

        Args:
            measurement: readings of the tick.
            reference: desired motion and forces.
        """
        tau = self.controller.tick(measurement, reference)
        t = self.ticks * self.dt
        self.ticks += 1
        if self.controller.engaged:
            return tau
        if 2 * self.duration / 3 <= t < self.duration:  # transients of the start have settled
            self.samples.append(self.controller.residual_wrench())
        elif self.samples and t >= self.duration:
            self.controller.f_tare = np.mean(self.samples, axis=0)
            self.samples = []
        if t >= self.engage_at:
            self.controller.engage()
        return tau
