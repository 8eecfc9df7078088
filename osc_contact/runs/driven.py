"""A run on MuJoCo in which nothing needs Python: compiled, but for ticks out of the ordinary."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import astuple
from time import perf_counter
from typing import TypeGuard

import numpy as np
import pinocchio as pin

from osc_contact.control.controller import Controller
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.judge import Plant
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.plants.mujoco_memory import find_places
from osc_contact.plants.mujoco_truth import MujocoTruth
from osc_contact.runs.compiled_loop import DIVERGED, ODD, ROOM, compiled_loop
from osc_contact.runs.loop import NEWS
from osc_contact.runs.recorder import Recorder
from osc_contact.runs.references import Plan
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array

__all__ = ["Drive", "is_plain", "run_compiled"]

_MOST = 0.01  #: s in compiled code without a look at what else there is to do


def is_plain(plant: Plant, controller: Controller, scenario: Scenario) -> TypeGuard[MujocoPlant]:
    """Whether nothing but compiled code and MuJoCo has a part in most ticks.

    That is: MuJoCo, ideal sensors, faces at rest, packaged pairs and laws, no tare, no joint torque
    loop, no motor errors, no pushes.

    Args:
        plant, controller: at their start. scenario: of the run.
    """
    return (
        type(plant) is MujocoPlant
        and type(controller) is Controller
        and compiled_loop() is not None
        and scenario.tare is None
        and scenario.control.joint_torque is None
        and not controller._outside.needed
        and plant.memory(controller.dt) is not None
    )


def run_compiled(
    plant: MujocoPlant,
    controller: Controller,
    plans: Iterable[Plan],
    recorder: Recorder,
    asked: Callable[[], bool],
    progress: Callable[[float], None] | None = None,
) -> None:
    """What `run_loop` does, with the same numbers.

    Args:
        plant, controller: see `is_plain`.
        plans: the references, some hundred at a time.
        recorder: notes every tick.
        asked: whether the run is to end, looked at every 10 ms or so.
        progress: see `run_loop`.

    Raises:
        PlantError: the simulation diverged.
    """
    drive = Drive(plant, controller, recorder)
    done = 0
    for plan in plans:
        drive.follow(plan)
        k = 0
        while k < len(plan):
            if asked():
                return
            news = len(plan) if progress is None else k + NEWS - (done + k) % NEWS
            k = drive.go_on(k, min(len(plan), news))
            if progress is not None and (done + k) % NEWS == 0:
                progress((done + k) * controller.dt)
        done += len(plan)


class Drive:
    """The compiled loop with all that it works on."""

    def __init__(self, plant: MujocoPlant, controller: Controller, recorder: Recorder) -> None:
        self.plant, self.controller, self.recorder = plant, controller, recorder
        memory, places = plant.memory(controller.dt), find_places()
        assert memory is not None and places is not None
        self.memory, self.places = memory, np.array(astuple(places), dtype=np.int64)
        self.tau = np.zeros(len(memory[3]))
        self.r = len(recorder.log.of.owners)
        self.sources: Array | None = None  # of what is noted; None: no tick ended well yet
        self.tail = np.zeros(0), np.zeros((0, 2), dtype=np.int64)

    def follow(self, plan: Plan) -> None:
        """Take references."""
        controller, own, r = self.controller, self.controller._records, self.r
        poses = np.array([pin.XYZQUATToSE3(x).homogeneous for x in plan.X_WD]).reshape(-1, 4, 4)
        self.plan, self.wishes = plan, (poses, plan.V_D, plan.A_D, plan.alpha_d)
        squeeze = np.full(len(controller._squeeze), plan.squeeze_d)
        flags = 0 if plan.squeeze_d == 0.0 or len(controller.chain.arms) < 3 else 2
        self.tables = (
            own.row.raw, own.memory_bytes, own.work_bytes, controller._codes, own.rank, squeeze,
            controller._still, flags, r, self.tau,
        )  # fmt: skip

    def go_on(self, k: int, last: int) -> int:
        """Ticks k … last − 1 of the plan, or some of them; returns the next."""
        log = self.recorder.log
        assert isinstance(log.truth, MujocoTruth)
        if self.sources is None:
            self._by_hand(k)
            if self._ended_well():
                self.sources, self.tail = log.sources(self.plant.measure()), log.tail()
            return k + 1
        log.make_room()
        self.recorder.tell()
        loop, begun = compiled_loop(), k
        k, row, why, seconds = loop(
            self.tables, self.wishes, self.memory, self.places, log.truth.tables(), log.table,
            self.sources, *self.tail, k, last, log.filled, _MOST,
        )  # fmt: skip
        log.filled_to(row)
        self.plant.time += (k - begun) * self.memory[13] * self.plant.model.opt.timestep
        if why == DIVERGED:
            self.plant.require_calm()
        elif why == ROOM:
            self._by_hand(k)
        elif why == ODD:
            self._end(self.plan[k], seconds)
            if self._ended_well():  # contact phases have changed
                self.tail = log.tail()
        return k + (why in (ROOM, ODD))

    def _ended_well(self) -> bool:
        own = self.controller._records
        return bool(self.controller._codes[0] == 0 and own.rank[0] == self.r)

    def _by_hand(self, k: int) -> None:
        """A tick as `run_loop` does it."""
        measurement, asked = self.plant.measure(), self.plan[k]
        start = perf_counter()
        tau = self.controller.tick(measurement, asked)
        self._done(measurement, asked, tau, perf_counter() - start)

    def _end(self, asked: Reference, seconds: float) -> None:
        """What is left of a tick that the law has computed, in so many seconds."""
        measurement, start, tau = self.plant.measure(), perf_counter(), self.tau
        if self.controller._codes[0]:
            tau = self.controller._end(tau.copy(), measurement, asked)
        self._done(measurement, asked, tau, seconds + perf_counter() - start)

    def _done(self, measurement: Measurement, asked: Reference, tau: Array, seconds: float) -> None:
        self.recorder.append(measurement, asked, tau, seconds)
        self.plant.command(tau, self.controller.dt)
