"""One run: plant and controller, tick by tick, into a recording."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import lines_of_force
from osc_contact.control.controller import Controller
from osc_contact.control.living import measured, phases
from osc_contact.control.monitor import ContactMonitor
from osc_contact.errors import PlantError
from osc_contact.experiments.contacts import feet
from osc_contact.experiments.free_motion import free_part
from osc_contact.experiments.references import force_names, force_owners, force_steps
from osc_contact.experiments.rig import Rig, build_rig
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.plant import Truth
from osc_contact.recorder import Recorder, Recording
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
    recorder = Recorder(ticks, _meta(rig, seed))
    plant, controller, first = rig.plant(seed), rig.controller(), rig.controller()
    if install is not None:
        controller, first = install(controller), install(first)
    # the rig starts under the torques that hold it, not limp
    plant.hold(first.tick(rig.at_start(plant.measure()), rig.references.at(0.0)))
    drive, observer = rig.drive(plant), rig.observer()
    acceleration = None
    tare, monitor = _Tare(rig, controller), ContactMonitor(len(force_names(scenario)), period)
    began = perf_counter()
    try:
        for k in range(ticks):
            t = k * period
            reference = rig.references.at(t)
            measurement = observer.complete(plant.measure(), acceleration)
            truth = plant.truth()
            start = perf_counter()
            tau = controller.tick(measurement, reference)
            spent = perf_counter() - start
            if observer.estimates:
                acceleration = controller.joint_acceleration()
            tare.watch(t)
            channels = {
                "t": t,
                "q": measurement.q,
                "v": measurement.v,
                "tau": tau,
                "tick_s": spent,
                **_watched(rig, controller, monitor),
                **_channels(rig, controller, reference, truth, measurement),
            }
            recorder.append(**channels)
            if viewer is not None:
                viewer.show(channels)
            drive.step(tau)
            if progress is not None and k % 100 == 99:
                progress(t + period)
    except PlantError as error:
        error.recording = _finished(recorder, began)
        raise
    return _finished(recorder, began)


def _finished(recorder: Recorder, began: float) -> Recording:
    recording = recorder.recording()
    recording.meta["wall_s"] = perf_counter() - began
    return recording


class _Tare:
    """Averages the wrist sensors at rest off the contacts, then lets the controller engage."""

    def __init__(self, rig: Rig, controller: Controller) -> None:
        self.spec = rig.scenario.tare
        self.controller = controller
        self.engage_at = rig.references.engage_at
        self.samples: list[Array] = []

    def watch(self, t: float) -> None:
        if self.spec is None or self.controller.engaged:
            return
        if 2 * self.spec.duration / 3 <= t < self.spec.duration:  # once the start has settled
            self.samples.append(self.controller.residual_wrench())
        elif self.samples and t >= self.spec.duration:
            self.controller.f_tare = np.mean(self.samples, axis=0)
            self.samples = []
        if t >= self.engage_at:
            self.controller.engage()


def _watched(rig: Rig, controller: Controller, monitor: ContactMonitor) -> dict[str, Array]:
    """What the contact monitor tells of each magnitude, from projected force and power.

    Where a magnitude may have either sign its size counts.
    """
    if controller.life is not None:
        seen = controller.life.state.seen
    else:
        alpha, speed = measured(controller, rig.owners)
        seen = monitor.update(np.where(rig.pushing, alpha, np.abs(alpha)), speed)
    return {"contact_seen": seen.closed, "collision_seen": seen.collision}


def _channels(
    rig: Rig, controller: Controller, reference: Reference, truth: Truth, read: Measurement
) -> dict[str, Any]:
    """What the recording keeps of a tick besides joints and torques."""
    found, k = controller.found(), len(rig.pairs)
    wrench = found.f_meas - found.bias_out
    projected = float(found.normal_speed @ found.alpha_meas)  # V_relᵀNα, whatever the faces do
    alpha = measured(controller, rig.owners)[0]
    X = truth.X_WO
    moved = truth.X_WE or (pin.SE3.Identity(),) * k
    lines = [feet(pair, X, E) for pair, E in zip(rig.pairs, moved, strict=True)]
    N = np.hstack(
        [np.zeros((6, 0)), *(lines_of_force((p - X.translation).T, d.T) for p, d in lines)]
    )
    free_error = found.free_error
    if rig.d < 6:
        held = N[:, controller.terms.active[rig.owners]]
        free_error = free_part(rig.model, read.q, pin.SE3(found.X_WO), held, found.error)
    bodies = [rig.bodies[i].placement for i in rig.on]
    return {
        "pose": pin.SE3ToXYZQUAT(X),
        "twist": truth.V_O,
        "alpha_cmd": reference.alpha_d,
        "alpha_meas": alpha,
        "alpha_true": truth.alpha,
        "closed": truth.closed,
        "N": N,
        "contact_point": np.array([points.mean(axis=0) for points, _ in lines]).reshape(k, 3),
        "contact_direction": np.array([directions[0] for _, directions in lines]).reshape(k, 3),
        "face_pose": np.array(
            [pin.SE3ToXYZQUAT(E * body) for body, E in zip(bodies, moved, strict=True)]
        ).reshape(k, 7),
        "wrench_meas": wrench,
        "power_total": float(found.V_O @ (wrench - found.f_c)) + projected,
        "power_projected": projected,
        "motion_error": free_error,
        "squeeze_cmd": reference.squeeze_d,
        "squeeze": float(found.squeeze[0]),
        "alpha_given_up": _given_up(controller, len(rig.owners)),
        "status": int(controller.status),
        "contact_phase": phases(controller),
    }


def _given_up(controller: Controller, r: int) -> Array:
    """(r,) contact forces that the motor limits cost in this tick."""
    cost = controller.given_up
    return cost.force if cost is not None and len(cost.force) == r else np.zeros(r)


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
