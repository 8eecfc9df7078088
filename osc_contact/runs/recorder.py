"""What the control loop leaves behind: every tick noted, a recording in the end."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import count_forces
from osc_contact.control.controller import Controller
from osc_contact.errors import RecordingError
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.judge import Judge, TruthLog
from osc_contact.plants.own_mujoco import MujocoRobot
from osc_contact.recorder import Recording
from osc_contact.recorder.columns import gather
from osc_contact.recorder.journal import Journal, JournalFile
from osc_contact.recorder.memory import MemoryJournal
from osc_contact.robots.summary import joint_losses
from osc_contact.runs.channels import Tick, channels, work_out
from osc_contact.runs.log import Log, Subject
from osc_contact.spatial import Array

__all__ = ["Recorder", "describe_subject", "recording_of"]

_logger = logging.getLogger("osc_contact.recorder")


class Recorder:
    """Notes the ticks of `run_loop`; `recording` works their channels out, all at once.

    Rows of numbers go to a file while the loop runs, at least ten times per second: memory does not
    grow, and whatever ends the process leaves them there, see `recover`. Where they cannot be
    written the loop goes on; that is logged at once and said in the recording.

    With a judge, such as a plant, the recording holds the truth. Without one, as on hardware, pose,
    twist, N and whether contacts are closed are what the controller takes them for, and
    `alpha_true` is missing.

    Attributes:
        log: rows of numbers.
        error: why no more ticks are recorded, or None.
    """

    def __init__(
        self,
        controller: Controller,
        judge: Judge | None = None,
        *,
        subject: Subject | None = None,
        journal: Path | MemoryJournal | None = None,
        meta: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin.

        Args:
            controller: that the loop ticks.
            judge: what knows the truth, if anything does.
            subject: the true contacts, where they are not the controller's.
            journal: the file of the rows, such as unfinished.mcap; None: a temporary one, which
                goes with the process; or where rows are kept in memory.
            meta: what the recording is to say of itself beside names, rate and times.

        Raises:
            RecordingError: there can be no such file.
        """
        self._began = perf_counter(), process_time()
        of = _subject(controller) if subject is None else subject
        self._meta, self._told = {**describe_subject(of), **(meta or {})}, False
        if isinstance(judge, MujocoRobot):
            self._meta["picture"] = judge.picture()
        to = journal if isinstance(journal, MemoryJournal) else JournalFile(journal, self._meta)
        self.log = Log(of, judge, to)

    @property
    def error(self) -> RecordingError | None:
        """Why no more ticks are recorded, or None."""
        return self.log.journal.error

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Note a tick before its torques act.

        Args:
            measurement, reference: that went into it.
            tau: (n_a,) that came out. seconds: that it took.
        """
        self.log.note(measurement, reference, tau, seconds)
        self.tell()

    def tell(self) -> None:
        """Log, once, that no more ticks are recorded."""
        if self.error is not None and not self._told:
            self._told = True
            _logger.error("%s; the loop goes on", self.error)

    def latest(self) -> Mapping[str, Any]:
        """The channels of the last tick, worked out when they are read."""
        log, row = self.log, self.log.last()
        return Tick(partial(channels, log.of, log.truth, log.count - 1, row))

    def recording(self, meta: Mapping[str, Any] | None = None) -> Recording:
        """All ticks so far; a long recording stays on disk.

        Args:
            meta: more that the recording is to say of itself.

        Raises:
            RecordingError: there is no room for its channels.
        """
        log = self.log
        log.flush()
        log.journal.close()
        recording = recording_of(
            log.of, log.truth, log.journal.read(), {**self._meta, **(meta or {})}
        )
        if self.error is not None:
            recording.meta["missing"] = [str(self.error)]
        controller = log.of.controller
        recording.meta["end_state"] = controller.state.name
        recording.meta["end_reason"] = controller.reason
        recording.meta["first_reason"] = log.first_reason
        recording.meta["wall_s"] = perf_counter() - self._began[0]
        recording.meta["cpu_s"] = process_time() - self._began[1]
        return recording


def recording_of(
    of: Subject, log: TruthLog | None, journal: Journal | MemoryJournal, meta: Mapping[str, Any]
) -> Recording:
    """The recording of a journal's rows.

    Args:
        of, log: what was recorded and the judge's log, see `channels`.
        journal: read from its beginning. meta: of the recording.
    """
    ticks = sum(len(rows) for _, rows in journal.rows())
    return Recording(meta, gather(ticks, work_out(of, log, journal.rows())))


def _subject(controller: Controller) -> Subject:
    """What a controller by itself knows of its contacts."""
    chain, pairs = controller.chain, tuple(controller.contacts)
    owners = [i for i, pair in enumerate(pairs) for _ in range(count_forces(pair))]
    rigid = all(grasp.is_rigid for grasp in chain.grasps)
    free = rigid and min(arm.model.nv for arm in chain.arms) >= 6
    world = (pin.SE3.Identity(),) * len(pairs)
    return Subject(controller, pairs, world, np.array(owners, dtype=int), free)


def describe_subject(of: Subject) -> dict[str, Any]:
    """What a recording says of who and what is in it."""
    chain = of.controller.chain
    return {
        "arm_names": [arm.name for arm in chain.arms],
        "joint_names": chain.joint_names,
        "effort_limits": {
            chain.joint_names[j]: float(limit) if np.isfinite(limit) else None
            for j, limit in zip(chain.actuated, chain.tau_max, strict=True)
        },
        "joint_losses": [
            one for arm in chain.arms for one in joint_losses(arm.model, f"{arm.name}/")
        ],
        "contact_names": [pair.name for pair in of.pairs],
        "columns": of.owners.tolist(),
        "control_rate_hz": 1.0 / of.controller.dt,
        "force_steps_s": [],
        "force_rise_s": of.controller.gains.force.rise,
    }
