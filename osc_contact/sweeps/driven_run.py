"""One run of a sweep: the recording that `run` makes, ticks compiled where they can be."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pinocchio as pin

from osc_contact.control.controller import Controller
from osc_contact.errors import PlantError
from osc_contact.interface import Reference
from osc_contact.plants.judge import Plant
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.plants.mujoco_memory import find_places
from osc_contact.recorder import Recording
from osc_contact.runs.preflight import require_ready
from osc_contact.runs.recorder import describe_subject, recording_of
from osc_contact.runs.references import Plan
from osc_contact.runs.rig import Rig
from osc_contact.runs.run import Install, describe_run, run_rig, start
from osc_contact.sweeps.compiled_loop import DIVERGED, ODD, ROOM, compiled_loop
from osc_contact.sweeps.driven_log import DrivenLog

__all__ = ["record_run"]


def record_run(rig: Rig, seed: int = 0, install: Install | None = None) -> Recording:
    """Run a rig and record it: every number but the times of ticks is that of `run`.

    Ticks run compiled, with the plant's steps, where nothing in them is Python: MuJoCo, ideal
    sensors, faces at rest, packaged pairs and laws, no tare, no joint torque loop, no motor errors,
    no pushes. All others run as `run` does.

    Args:
        rig: see `build_rig`. seed: of everything random. install: see `run`.

    Raises:
        ScenarioError, PlantError: see `run`.
    """
    doubts = require_ready(rig)
    plant, controller = start(rig, seed, install)
    if not _is_plain(rig, plant, controller):
        return run_rig(rig, seed, doubts, plant, controller)
    assert isinstance(plant, MujocoPlant)
    of = rig.subject(controller)
    about = {**describe_subject(of), **describe_run(rig, seed, doubts)}
    log = DrivenLog(of, plant)

    def recording() -> Recording:
        log.flush()
        made = recording_of(of, log.truth, log.journal.read(), about)
        made.meta["end_state"], made.meta["end_reason"] = controller.state.name, controller.reason
        made.meta["first_reason"] = log.first_reason
        return made

    ticks = round(rig.scenario.duration * rig.scenario.control.rate)
    try:
        _drive(plant, controller, log, _plan(rig, ticks, controller.dt))
    except PlantError as error:
        error.recording = recording()
        raise
    return recording()


def _is_plain(rig: Rig, plant: Plant, controller: Controller) -> bool:
    """Whether nothing but compiled code and MuJoCo has a part in most ticks."""
    return (
        type(plant) is MujocoPlant
        and compiled_loop() is not None
        and rig.scenario.tare is None
        and rig.scenario.control.joint_torque is None
        and not controller._outside.needed
        and plant.memory(controller.dt) is not None
    )


def _plan(rig: Rig, ticks: int, period: float) -> Plan:
    return rig.references.over(np.arange(ticks) * period)


def _drive(plant: MujocoPlant, controller: Controller, log: DrivenLog, plan: Plan) -> None:
    """All ticks of a plan: compiled, and in Python those that end out of the ordinary."""
    loop, dt, r = compiled_loop(), controller.dt, len(log.of.owners)
    places = find_places()
    memory = plant.memory(dt)
    assert memory is not None and places is not None
    poses = np.array([pin.XYZQUATToSE3(x).homogeneous for x in plan.X_WD]).reshape(-1, 4, 4)
    wishes = poses, plan.V_D, plan.A_D, plan.alpha_d
    squeeze = np.full(len(controller._squeeze), plan.squeeze_d)
    flags = 0 if plan.squeeze_d == 0.0 or len(plant.chain.arms) < 3 else 2
    own = controller._records
    raw, own_memory, work = own.row.raw, own.memory_bytes, own.work_bytes
    codes, rank = controller._codes, own.rank
    tau = np.zeros(len(memory[3]))
    tables = raw, own_memory, work, codes, rank, squeeze, controller._still, flags, r, tau
    at = np.array(astuple(places), dtype=np.int64)
    sources, tail = None, (np.zeros(0), np.zeros((0, 2), dtype=np.int64))
    k, ticks = 0, len(plan)
    while k < ticks:
        if sources is None:
            _one(plant, controller, log, plan[k])
            k += 1
            if int(controller.status) == 0 and controller.result().rank == r:
                sources, tail = log.sources(plant.measure()), log.tail()
            continue
        log.make_room()
        begun = k
        k, row, why = loop(
            tables, wishes, memory, at, log.truth.tables(), log.table, sources, *tail, k, ticks,
            log.filled,
        )  # fmt: skip
        log.filled_to(row)
        plant.time += (k - begun) * memory[13] * plant.model.opt.timestep
        if why == DIVERGED:
            plant.require_calm()
        elif why == ROOM:
            _one(plant, controller, log, plan[k])
            k += 1
        elif why == ODD:
            measurement, asked = plant.measure(), plan[k]
            sent = tau if not codes[0] else controller._end(tau.copy(), measurement, asked)
            log.note(measurement, asked, sent, 0.0)
            plant.command(sent, dt)
            k += 1
            if codes[0] == 0 and rank[0] == r:  # contact phases have changed
                tail = log.tail()


def _one(plant: Plant, controller: Controller, log: DrivenLog, reference: Reference) -> None:
    measurement = plant.measure()
    tau = controller.tick(measurement, reference)
    log.note(measurement, reference, tau, 0.0)
    plant.command(tau, controller.dt)
