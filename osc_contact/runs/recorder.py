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
from osc_contact.control.reports import Status
from osc_contact.control.result import TickResult, internal_forces
from osc_contact.errors import InvalidInputError, RecordingError
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.judge import Judge, TruthLog
from osc_contact.plants.own_mujoco import MujocoRobot
from osc_contact.recorder import Recording
from osc_contact.recorder.columns import gather
from osc_contact.recorder.journal import Journal, JournalFile
from osc_contact.recorder.memory import MemoryJournal
from osc_contact.robots.summary import joint_losses
from osc_contact.runs.channels import Subject, Tick, channels, work_out
from osc_contact.spatial import Array

__all__ = ["Recorder", "describe_subject", "recording_of"]

_logger = logging.getLogger("osc_contact.recorder")
_BLOCK = 500  #: rows that the journal is handed at once, at most
_EVERY = 0.08  #: s; the journal is not left behind any longer
#: What of `TickResult` is kept, and how many numbers that is.
_FOUND = {"f_meas": 6, "bias_out": 6, "V_O": 6, "X_WO": 16, "f_c": 6, "error": 6, "free_error": 6}


class Recorder:
    """Notes the ticks of `run_loop`; `recording` works their channels out, all at once.

    A tick is one row of raw numbers, written by one copy. Rows go to a file while the loop runs, at
    least ten times per second: memory does not grow, and whatever ends the process leaves them
    there, see `recover`. Where they cannot be written the loop continues; that is logged at once
    and stated in the recording.

    With a judge, such as a plant, the recording holds the truth. Without one, as on hardware, pose,
    twist, N and whether contacts are closed are what the controller takes them for, and
    `alpha_true` is missing.

    Attributes:
        of: what is recorded. count: ticks noted.
        truth: the judge's own log of the same ticks; None: there is no judge.
        journal: where the rows go.
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
        self.of = of = _subject(controller) if subject is None else subject
        self._meta = {**describe_subject(of), **(meta or {})}
        if isinstance(judge, MujocoRobot):
            self._meta["picture"] = judge.picture()
        self.journal = (
            journal if isinstance(journal, MemoryJournal) else JournalFile(journal, self._meta)
        )
        self.truth = None if judge is None else judge.log()
        self.count = 0
        self._first_reason = ""  #: why the first tick that failed could not be computed
        self._logged = False
        self._k = 0  #: rows that are not in the journal yet
        self._flushed = perf_counter()
        self._last: TickResult | None = None
        self._lay_out(of)

    def _lay_out(self, of: Subject) -> None:
        """Name the numbers of a row: what is NaN where a tick has no result, and the others."""
        chain = self.of.controller.chain
        contacts, r = len(of.pairs), len(of.owners)
        squeezes = internal_forces(len(chain.arms))
        found = {**_FOUND, "squeeze": squeezes}
        if not of.free:  # what the arms can make of an error is recorded
            found["J"] = 6 * chain.nq
        sizes = {"q": chain.nq, "v": chain.nq, "alpha_d": r, "alpha": r, "speed": r, **found}
        if self.truth is None:
            sizes["X_WE"] = 16 * contacts
        self._names = tuple(found)
        self._still = np.tile(np.eye(4), (contacts, 1, 1)).ravel()
        self._unknown = np.full(sum(sizes.values()), np.nan)
        sizes |= {"tau": chain.n_a, "tick_s": 1, "status": 1, "squeeze_d": squeezes}
        sizes |= {"given_up": r, "engaged": 1}
        if of.controller.life is not None:
            sizes |= {"phase": contacts, "active": contacts, "closed": r, "collision": r}
        self._fields = [(name, "<f8", (size,)) for name, size in sizes.items()]
        self._rows = np.zeros((_BLOCK, sum(sizes.values())))
        self._numbers = np.zeros(2 + squeezes + r)  #: from tick_s to given_up
        self._squeezes, self._given_up = np.split(self._numbers[2:], [squeezes])
        self._squeeze: float | None = None  #: commanded in the last tick, if nothing else changed
        rest = self._rows.shape[1] - len(self._unknown) - chain.n_a - len(self._numbers)
        self._flags: list[Array] = [np.zeros(rest)]  #: from engaged on

    @property
    def error(self) -> RecordingError | None:
        """Why no more ticks are recorded, or None."""
        return self.journal.error

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Note a tick before its torques act.

        Args:
            measurement, reference: that went into it.
            tau: (n_a,) that came out. seconds: that it took.
        """
        if self._k == _BLOCK or perf_counter() - self._flushed > _EVERY:
            self.flush()
        row, status = self._rows[self._k], self.of.controller.status
        numbers = self._numbers
        numbers[0] = seconds
        numbers[1] = status
        if status is not Status.OK or reference.squeeze_d is not self._squeeze:
            self._note_numbers(status, reference.squeeze_d)
        try:
            found = self._found(measurement)
            parts = (measurement.q, measurement.v, reference.alpha_d, *found)
            np.concatenate((*parts, tau, numbers, *self._flags), out=row)
        except (InvalidInputError, TypeError, ValueError):  # held: no result, or misshapen
            np.concatenate((self._unknown, tau, numbers, *self._flags), out=row)
        if self.truth is not None:
            self.truth.note()
        if status is Status.HELD and not self._first_reason:
            at = self.count * self.of.controller.dt
            self._first_reason = f"at {at:.3f} s: {self.of.controller.reason}"
        self._k += 1
        self.count += 1

    def _note_numbers(self, status: Status, squeeze: float | Array) -> None:
        """Commanded squeeze, and what motor limits cost: seldom another than in the last tick.

        A single squeeze is followed by NaNs: that distinguishes it from several.
        """
        self._squeezes[:] = np.nan
        try:
            self._squeezes[: np.size(squeeze)] = squeeze
        except (TypeError, ValueError):  # the tick was held
            self._squeezes[:] = np.nan
        self._given_up[:] = 0.0
        if status is Status.SATURATED:
            cost = self.of.controller.given_up
            if cost is not None and len(cost.force) == len(self._given_up):
                self._given_up[:] = cost.force
        self._squeeze = None
        if status is Status.OK and isinstance(squeeze, float):
            self._squeeze = squeeze

    def _found(self, measurement: Measurement) -> list[Array]:
        """What the last tick found: views of the controller's records."""
        result, r = self.of.controller.result(), len(self.of.owners)
        if result is not self._last:
            self._last = result
            self._parts = [np.ravel(getattr(result, name)) for name in self._names]
            records = result.records
            self._flags = [records.engaged]
            if self.of.controller.life is not None:
                self._flags += [records.phase, records.active, records.closed, records.collision]
            self._parts[:0] = [result.magnitudes[:r], result.speeds[:r]]
        parts = self._parts
        if result.rank != r:
            parts = [*result.records.spread(), *parts[2:]]
        if self.truth is None:
            touched = measurement.touched
            return [*parts, self._still if touched is None else np.ravel(touched.X_WE)]
        return parts

    def flush(self) -> None:
        """Append to the journal what was noted since the last time."""
        if self._k:
            self.journal.append(self.count - self._k, self._noted(0))
            self._k = 0
            if self.truth is not None:
                self.truth.clear()
        if self.error is not None and not self._logged:
            self._logged = True
            _logger.error("%s; the loop continues", self.error)
        self._flushed = perf_counter()

    def _noted(self, start: int) -> Array:
        """Rows with names, and with what the judge noted beside them."""
        rows, fields = self._rows[start : self._k], self._fields
        if self.truth is not None:
            truth = self.truth.noted(start)
            rows = np.concatenate((rows, truth), axis=1)
            fields = [*fields, ("truth", "<f8", (truth.shape[1],))]
        return np.ndarray(len(rows), np.dtype(fields), np.ascontiguousarray(rows))

    def latest(self) -> Mapping[str, Any]:
        """The channels of the last tick, worked out when they are read."""
        row = self._noted(self._k - 1)
        return Tick(partial(channels, self.of, self.truth, self.count - 1, row))

    def recording(self, meta: Mapping[str, Any] | None = None) -> Recording:
        """All ticks so far; a long recording stays on disk.

        Args:
            meta: more that the recording is to say of itself.

        Raises:
            RecordingError: there is no room for its channels.
        """
        self.flush()
        self.journal.close()
        about = {**self._meta, **(meta or {})}
        recording = recording_of(self.of, self.truth, self.journal.read(), about)
        if self.error is not None:
            recording.meta["missing"] = [str(self.error)]
        controller = self.of.controller
        recording.meta["end_state"] = controller.state.name
        recording.meta["end_reason"] = controller.reason
        recording.meta["first_reason"] = self._first_reason
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
