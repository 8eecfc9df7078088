"""One run: plant and controller, tick by tick, into a recording."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter, process_time

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.errors import PlantError
from osc_contact.recorder import Recording
from osc_contact.runs.channels import Tick, channels, monitored
from osc_contact.runs.log import Log
from osc_contact.runs.references import Plan, force_owners, force_steps
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array
from osc_contact.visual.live import Shows

__all__ = ["run"]

Progress = Callable[[float], None]
Install = Callable[[Controller], Controller]


def run(
    scenario: Scenario,
    *,
    plant: str | None = None,
    duration: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    viewer: Shows | None = None,
    install: Install | None = None,
) -> Recording:
    """Run a scenario and record it.

    Args:
        scenario: from `load_scenario`.
        plant: "mujoco" or "rigid" instead of the scenario's own.
        duration: s, instead of the scenario's own.
        seed: of everything random in the run (sensors and plants without noise use none).
        progress: called with the simulated time now and then.
        viewer: shows the run while it goes on (see `open_viewer`); it cannot hold the loop up.
        install: puts another control law into each controller of the run.

    Returns:
        The recording; `metrics(recording)` judges it.

    Raises:
        PlantError: the simulation diverged; `error.recording` holds what came before.
    """
    changes = scenario.as_dict()
    if plant is not None:
        changes["plant"]["type"] = plant
    if duration is not None:
        changes["duration"] = duration
    scenario = Scenario.model_validate(changes).with_source(scenario.source)
    return _loop(build_rig(scenario), seed, progress, install, viewer)


def _loop(
    rig: Rig,
    seed: int,
    progress: Progress | None,
    install: Install | None,
    viewer: Shows | None,
) -> Recording:
    scenario = rig.scenario
    period = 1.0 / scenario.control.rate
    ticks = round(scenario.duration * scenario.control.rate)
    plant, controller, first = rig.plant(seed), rig.controller(), rig.controller()
    if install is not None:
        controller, first = install(controller), install(first)
    # the rig starts under the torques that hold it, not limp
    plant.hold(first.tick(rig.at_start(plant.measure()), rig.references.at(0.0)))
    drive, observer, tare = rig.drive(plant), rig.observer(), _Tare(rig, controller)
    acceleration = None
    began = perf_counter(), process_time()
    plan = rig.references.over(np.arange(ticks) * period)
    log = Log(rig, plant, ticks)
    try:
        for k, reference in enumerate(plan):
            measurement = observer.complete(plant.measure(), acceleration)
            start = perf_counter()
            tau = controller.tick(measurement, reference)
            spent = perf_counter() - start
            if observer.estimates:
                acceleration = controller.joint_acceleration()
            if not controller.engaged:
                tare.watch(k * period)
            log.note(controller, measurement, tau, spent)
            if viewer is not None:
                viewer.show(Tick(partial(channels, rig, log, plan, k, k + 1)))
            drive.step(tau)
            if progress is not None and k % 100 == 99:
                progress((k + 1) * period)
    except PlantError as error:
        error.recording = _recording(rig, log, plan, seed, began)
        raise
    return _recording(rig, log, plan, seed, began)


def _recording(rig: Rig, log: Log, plan: Plan, seed: int, began: tuple[float, float]) -> Recording:
    """What the run is remembered by; working it out counts as part of the run."""
    values = channels(rig, log, plan, 0, log.count) | monitored(rig, log)
    recording = Recording(_meta(rig, seed), values)
    recording.meta["wall_s"] = perf_counter() - began[0]
    recording.meta["cpu_s"] = process_time() - began[1]
    return recording


class _Tare:
    """Averages the wrist sensors at rest off the contacts, then lets the controller engage."""

    def __init__(self, rig: Rig, controller: Controller) -> None:
        self.spec = rig.scenario.tare
        self.controller = controller
        self.engage_at = rig.references.engage_at
        self.samples: list[Array] = []

    def watch(self, t: float) -> None:
        if self.spec is None:
            return
        if 2 * self.spec.duration / 3 <= t < self.spec.duration:  # once the start has settled
            self.samples.append(self.controller.residual_wrench())
        elif self.samples and t >= self.spec.duration:
            self.controller.f_tare = np.mean(self.samples, axis=0)
            self.samples = []
        if t >= self.engage_at:
            self.controller.engage()


def _meta(rig: Rig, seed: int) -> dict[str, object]:
    scenario = rig.scenario
    return {
        "scenario": scenario.as_dict(),
        "source": None if scenario.source is None else scenario.source.name,
        "plant": scenario.plant.type,
        "seed": seed,
        "arm_names": [arm.name for arm in rig.chain.arms],
        "joint_names": rig.chain.joint_names,
        "effort_limits": {
            rig.chain.joint_names[j]: float(limit) if np.isfinite(limit) else None
            for j, limit in zip(rig.chain.actuated, rig.chain.tau_max, strict=True)
        },
        "contact_names": [pair.name for pair in rig.pairs],
        "columns": list(force_owners(scenario)),
        "control_rate_hz": scenario.control.rate,
        "force_steps_s": force_steps(scenario),
    }
