"""What the control loop leaves behind: every tick noted, a recording in the end."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from time import perf_counter, process_time
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import count_forces
from osc_contact.control.controller import Controller
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.judge import Judge
from osc_contact.recorder import Recording
from osc_contact.runs.channels import Tick, channels, monitored
from osc_contact.runs.log import Log, Subject
from osc_contact.spatial import Array

__all__ = ["Recorder"]


class Recorder:
    """Notes the ticks of `run_loop`; `recording` works their channels out, all at once.

    With a judge, such as a plant, the recording holds the truth. Without one, as on hardware, pose,
    twist, N and whether contacts are closed are what the controller takes them for, and
    `alpha_true` is missing.

    Attributes:
        log: rows of numbers.
    """

    def __init__(
        self,
        controller: Controller,
        judge: Judge | None = None,
        *,
        ticks: int = 10_000,
        subject: Subject | None = None,
    ) -> None:
        """Make room.

        Args:
            controller: that the loop ticks.
            judge: what knows the truth, if anything does.
            ticks: how many there is room for; a run of more makes room on its way.
            subject: the true contacts, where they are not the controller's.
        """
        self._began = perf_counter(), process_time()
        self.log = Log(_subject(controller) if subject is None else subject, judge, ticks)

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Note a tick before its torques act.

        Args:
            measurement, reference: that went into it.
            tau: (n_a,) that came out. seconds: that it took.
        """
        self.log.note(measurement, reference, tau, seconds)

    def latest(self) -> Mapping[str, Any]:
        """The channels of the last tick, worked out when somebody reads them."""
        k = self.log.count
        return Tick(partial(channels, self.log, k - 1, k))

    def recording(self, meta: Mapping[str, Any] | None = None) -> Recording:
        """All ticks so far.

        Args:
            meta: what the recording is to say of itself beside names, rate and times.
        """
        values = channels(self.log, 0, self.log.count) | monitored(self.log)
        recording = Recording({**_about(self.log.of), **(meta or {})}, values)
        recording.meta["wall_s"] = perf_counter() - self._began[0]
        recording.meta["cpu_s"] = process_time() - self._began[1]
        return recording


def _subject(controller: Controller) -> Subject:
    """What a controller by itself knows of its contacts."""
    chain, pairs = controller.chain, tuple(controller.contacts)
    owners = [i for i, pair in enumerate(pairs) for _ in range(count_forces(pair))]
    rigid = all(grasp.is_rigid for grasp in chain.grasps)
    free = rigid and min(arm.model.nv for arm in chain.arms) >= 6
    world = (pin.SE3.Identity(),) * len(pairs)
    return Subject(controller, pairs, world, np.array(owners, dtype=int), free)


def _about(of: Subject) -> dict[str, Any]:
    chain = of.controller.chain
    return {
        "arm_names": [arm.name for arm in chain.arms],
        "joint_names": chain.joint_names,
        "effort_limits": {
            chain.joint_names[j]: float(limit) if np.isfinite(limit) else None
            for j, limit in zip(chain.actuated, chain.tau_max, strict=True)
        },
        "contact_names": [pair.name for pair in of.pairs],
        "columns": of.owners.tolist(),
        "control_rate_hz": 1.0 / of.controller.dt,
        "force_steps_s": [],
    }
