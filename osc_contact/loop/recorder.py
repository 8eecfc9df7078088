"""Recorder of the control loop."""

from __future__ import annotations

import logging
from collections import UserDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, cached_property, partial
from importlib.metadata import version
from math import inf
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from osc_contact.contacts.feet import force_owners
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.control.changes import Changes, changed_settings
from osc_contact.control.controller import Controller
from osc_contact.control.signals import TickResult, internal_forces
from osc_contact.control.status import SafetyState, Status
from osc_contact.errors import InvalidInputError, RecordingError
from osc_contact.files import Json
from osc_contact.interface import Measurement, Reference
from osc_contact.law.library import law_hash
from osc_contact.loop.channels import Subject, add_stages, channels, recording_of
from osc_contact.loop.judge import Judge, Pictured
from osc_contact.loop.realtime import at_once
from osc_contact.recorder import Recording
from osc_contact.recorder.events import EventLog, events_beside
from osc_contact.recorder.journal import JournalFile
from osc_contact.robots.summary import joint_losses
from osc_contact.spatial import Array


class Tick(UserDict[str, Any]):
    """Channels of one tick, computed when they are first read."""

    def __init__(self, compute_channels: Callable[[], dict[str, Array]]) -> None:
        """Store a function that computes channels with one row each."""
        #: function that computes the channels, with one row each
        self._compute_channels = compute_channels

    @cached_property
    def data(self) -> dict[str, Any]:  # type: ignore[override]
        """Channels of the row, without its axis."""
        return {name: rows[0] for name, rows in self._compute_channels().items()}


_logger = logging.getLogger("osc_contact.recorder")
_ROWS_OF_BLOCK = 500  #: largest number of rows that are written to the journal at once
_WRITE_EVERY_S = 0.08  #: s, longest time between writes to a named journal
#: Attributes of `TickResult` that are stored, with their numbers of elements.
_RESULTS = {
    "f_meas": 6,
    "bias_out": 6,
    "V_O": 6,
    "X_WO": 16,
    "f_c": 6,
    "error": 6,
    "free_error": 6,
}


class Recorder:
    """Recorder of the ticks of `run_loop`; `recording` computes their channels.

    A tick is stored as one row of raw numbers, with a single copy. Rows are written to a file while
    the loop runs, so that memory does not grow. A named file is written at least ten times per
    second and survives any end of the process (see `recover`); a temporary file is written block by
    block, or continuously in real time. If writing fails the loop continues; the failure is logged
    immediately and stated in the recording.

    With a judge (for example a plant) the recording contains the truth. Without one (on hardware)
    pose, twist, N and the state of contacts are estimates of the controller, and `alpha_true` is
    missing.

    Attributes:
        of: description of the recorded system.
        count: number of ticks stored.
        truth: log of the judge for the same ticks; None without a judge.
        journal: file of the rows.

    Example:
        >>> rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
        >>> robot, controller = rig.plant(), rig.controller()
        >>> recorder = osc.Recorder(controller, robot)
        >>> references = [rig.references.at(0.0)] * 5
        >>> report = osc.run_loop(robot, controller, references, recorder=recorder)
        >>> print(recorder.recording()["alpha_true"].shape)
        (5, 2)
    """

    def __init__(
        self,
        controller: Controller,
        judge: Judge | None = None,
        *,
        subject: Subject | None = None,
        journal: Path | None = None,
        meta: Mapping[str, Any] | None = None,
    ) -> None:
        """Open the journal and log the start.

        Args:
            controller: controller of the loop.
            judge: source of the truth, or None.
            subject: the true contacts, if they differ from the controller's.
            journal: file of the rows, for example unfinished.mcap; None: a temporary file, which is
                deleted at the end of the process.
            meta: meta data to be added to names, rate and times.

        Raises:
            RecordingError: the file cannot be created.
        """
        #: wall clock and processor time at the start (s)
        self._start_times = perf_counter(), process_time()
        self._controller = controller  #: controller of the loop
        self.of = of = own_subject(controller) if subject is None else subject
        #: meta data of the recording
        self._meta = {**describe_subject(of, controller), **(meta or {})}
        self._meta["date"] = datetime.now(UTC).isoformat(timespec="seconds")
        if isinstance(judge, Pictured):
            self._meta["picture"] = judge.picture()
        self.journal = JournalFile(journal, self._meta)
        #: log of events
        self._events = EventLog(None if journal is None else events_beside(journal))
        self._changes = Changes(controller)  #: watch on the controller, for events
        self.truth = None if judge is None else judge.log()
        self.count = 0
        self._first_reason = ""  #: why the first tick that failed could not be computed
        self._error_logged = False  #: whether the failure of the journal has been logged
        self._pending = 0  #: rows that are not in the journal yet
        #: whether the journal is a named file, which survives the process
        self._survives = journal is not None
        self._flushed = perf_counter()  #: clock at the last write (s)
        self._located_result: TickResult | None = None  #: result for which `_positions` were found
        #: writes rows; `run_loop(…, realtime=True)` has another thread do it
        self.hand_over: Callable[[Callable[[], object]], None] = at_once
        self._lay_out(of)
        about = {key: self._meta[key] for key in ("version", "law_hash")}
        self.log("start", state=controller.state.name, **about)

    def _lay_out(self, subject: Subject) -> None:
        """Lay out the fields of a row: first those that are NaN for a tick without a result.

        Allocates the buffers that `append` fills, so that a tick allocates little.

        Args:
            subject: description of the recorded system.
        """
        chain = self._controller.chain
        contacts = len(subject.pairs)
        r = len(subject.owners)
        squeezes = internal_forces(len(chain.arms))
        results = {**_RESULTS, "squeeze": squeezes, "friction": chain.nq}
        unknown = {"q": chain.nq, "v": chain.nq, "alpha_d": r, "alpha": r, "speed": r, **results}
        if self.truth is None:
            unknown["X_WE"] = 16 * contacts
        numbers = {
            "tick_s": 1,
            "status": 1,
            "squeeze_d": squeezes,
            "given_up": r,
            "named": contacts,
        }
        integers = {"active": contacts}
        if subject.phased:
            integers |= {"phase": contacts, "closed": r, "collision": r}
        sizes = {**unknown, "tau": chain.n_a, **numbers, "normal_std": r, **integers}
        self._result_names = tuple(results)  #: names of the results of a tick in a row
        #: names, types and shapes of the fields of a row
        self._fields = [(name, "<f8", (size,)) for name, size in sizes.items()]
        self._rows = np.zeros((_ROWS_OF_BLOCK, sum(sizes.values())))  #: rows since the last write
        #: poses of touched bodies that are not measured, as one row
        self._rest_poses = np.tile(np.eye(4), (contacts, 1, 1)).ravel()
        #: NaN for all fields of a tick without a result
        self._blank = np.full(sum(unknown.values()), np.nan)
        #: fields that every tick has, filled by `_note_numbers`
        self._numbers = np.zeros(sum(numbers.values()))
        parts = np.split(self._numbers[2:], [squeezes, squeezes + r])
        #: views of `_numbers`: desired internal forces (N), forces given up (N), named contacts
        self._squeezes, self._given_up, self._named = parts
        self._noted_squeeze: float | None = None  #: of the last tick, if `_squeezes` still has it
        results_end = 2 * r + sum(results.values())
        #: words copied from the records: α, speeds, results, normal_std, then integers
        self._words = np.zeros(results_end + r + sum(integers.values()), np.int64)
        #: views of `_words`: α, speeds and results
        self._results = self._words[:results_end].view(np.float64)
        #: standard deviations of the normals (rad)
        self._normal_std = self._words[results_end : results_end + r].view(np.float64)
        self._integers = self._words[
            results_end + r :
        ]  #: activity and phases of contacts, flags of columns

    @property
    def _write_interval(self) -> float:
        """Longest time between writes (s); finite for named files and in real time."""
        return _WRITE_EVERY_S if self._survives or self.hand_over is not at_once else inf

    @property
    def error(self) -> RecordingError | None:
        """Error because of which no more ticks are recorded, or None."""
        return self.journal.error

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Store a tick before its torques act.

        A tick without a result, or with input of wrong sizes, has NaN in the fields that depend on
        them. Rows are written when the buffer is full or `_write_interval` has passed.

        Args:
            measurement, reference: input of the tick.
            tau: (n_a,) its motor torques (N m, N).
            seconds: computing time (s).
        """
        if self._pending == _ROWS_OF_BLOCK or perf_counter() - self._flushed > self._write_interval:
            self.flush()
        status = self._controller.status
        self._note_numbers(reference, seconds, status)
        values = (tau, self._numbers, self._normal_std, self._integers)
        row = self._rows[self._pending]
        try:
            self._read_records()
            parts: tuple[np.ndarray[Any, Any], ...]
            command = reference.alpha_d
            if reference.active is not None:  # there is no command for contacts that are not named
                command = command * self._named[self.of.owners]
            parts = (measurement.q, measurement.v, command, self._results)
            if self.truth is None:
                touched = measurement.touched
                parts += (self._rest_poses if touched is None else np.ravel(touched.X_WE),)
            np.concatenate(parts + values, out=row)
        except (InvalidInputError, TypeError, ValueError, IndexError):  # no result, or misshapen
            np.concatenate((self._blank, *values), out=row)
        if self.truth is not None:
            self.truth.note()
        stopped = self._controller.state is SafetyState.SAFE_STOP
        if (stopped or status is Status.HELD) and not self._first_reason:
            t = self.count * self._controller.dt
            self._first_reason = f"at {t:.3f} s: {self._controller.reason}"
        for event, facts in self._changes.look():
            self.log(event, **facts)
        self._pending += 1
        self.count += 1

    def _note_numbers(self, reference: Reference, seconds: float, status: Status) -> None:
        """Set the numbers of a row that are known for every tick, also for one without a result.

        These are computing time, status, named contacts, desired internal forces and forces that
        were given up; the latter two are written only when they may have changed.

        Args:
            reference: input of the tick.
            seconds: computing time (s).
            status: status of the tick.
        """
        self._numbers[0] = seconds
        self._numbers[1] = status
        self._named[:] = 1.0  # all, if none are named
        if reference.active is not None:
            with suppress(TypeError, ValueError):  # misshapen: the tick has no result
                np.not_equal(reference.active, 0, out=self._named, casting="unsafe")
        squeeze = reference.squeeze_d
        if status is Status.OK and squeeze is self._noted_squeeze:
            return
        self._noted_squeeze = squeeze if status is Status.OK and type(squeeze) is float else None
        # NaN after a single internal force distinguishes it from several equal ones
        self._squeezes[:] = np.nan
        with suppress(TypeError, ValueError):  # the tick was held: the reference is not valid
            self._squeezes[: np.size(squeeze)] = squeeze
        loss = self._controller.given_up if status is Status.SATURATED else None
        self._given_up[:] = 0.0
        if loss is not None and len(loss.force) == len(self._given_up):
            self._given_up[:] = loss.force

    def log(self, event: str, **facts: Any) -> None:
        """Store an event with the wall-clock time, in the recording and in a file beside its rows.

        Args:
            event: kind of the event, for example "stop".
            facts: its values, for JSON.
        """
        self._events.note(self.count * self._controller.dt, event, facts, self.hand_over)

    def switch(self, controller: Controller) -> None:
        """Record the ticks of another controller from now on; log the settings that differ.

        Args:
            controller: controller that continues, for example from `with_gains` or `with_safety`.
        """
        changed = changed_settings(self._controller.settings, controller.settings)
        self._controller = controller
        self.of = replace(self.of, dt=controller.dt, phased=controller.life is not None)
        self._changes = Changes(controller)
        self.log("settings", changed=changed)

    def _read_records(self) -> None:
        """Copy the results of the last tick from the controller's records.

        Raises:
            InvalidInputError: no tick has been computed.
        """
        result = self._controller.result()
        if result is not self._located_result:
            self._located_result = result
            self._locate_numbers(result)
        self._record_words.take(self._positions, out=self._words, mode="clip")

    def _locate_numbers(self, result: TickResult) -> None:
        """Find the position of each stored number in the controller's records.

        Args:
            result: results of a tick, which refer to the records.
        """
        records = result.records
        columns = records.memory.columns
        contacts = records.memory.contacts
        results = [getattr(result, name) for name in self._result_names]
        integers = [contacts.active]
        if self.of.phased:
            integers += [contacts.phase, columns.closed, columns.collision]
        #: bytes of all records as 64-bit words
        self._record_words = records.rows.raw.view(np.int64)
        #: indices of the copied words among these
        self._positions = records.places(
            columns.alpha, columns.speed, *results, columns.normal_std, *integers
        )

    def flush(self) -> None:
        """Append the rows stored since the last call to the journal."""
        if self._pending:
            rows = self._rows_since(0).copy()
            self.hand_over(partial(self.journal.append, self.count - self._pending, rows))
            self._pending = 0
            if self.truth is not None:
                self.truth.clear()
        if self.error is not None and not self._error_logged:
            self._error_logged = True
            _logger.error("%s; the loop continues", self.error)
        self._flushed = perf_counter()

    def _rows_since(self, start: int) -> Array:
        """Rows (k,) that are not in the journal yet, with named fields.

        With a judge each row has a field `truth` with the judge's numbers.

        Args:
            start: index of the first row returned.
        """
        rows = self._rows[start : self._pending]
        fields = self._fields
        if self.truth is not None:
            truth = self.truth.noted(start)
            rows = np.concatenate((rows, truth), axis=1)
            fields = [*fields, ("truth", "<f8", (truth.shape[1],))]
        return np.ndarray(len(rows), np.dtype(fields), np.ascontiguousarray(rows))

    def latest(self) -> Mapping[str, Any]:
        """Channels of the last tick, computed when they are first read."""
        row = self._rows_since(self._pending - 1).copy()
        return Tick(partial(channels, self.of, self.truth, self.count - 1, row))

    def note(self, meta: Mapping[str, Any]) -> None:
        """Add entries to the meta data of the recording.

        Args:
            meta: JSON data; later entries replace earlier ones of the same key.
        """
        self._meta |= meta

    def recording(self, meta: Mapping[str, Any] | None = None) -> Recording:
        """Recording of all ticks so far; a long recording remains on disk.

        Args:
            meta: meta data to be added.

        Raises:
            RecordingError: there is no space for its channels.
        """
        self.flush()
        self.journal.close()
        about = {**self._meta, **(meta or {})}
        recording = recording_of(self.of, self.truth, self.journal.read(), about)
        if self.error is not None:
            recording.meta["missing"] = [str(self.error)]
        controller = self._controller
        learns = getattr(controller.settings.joint_friction, "learning", False)
        self.log("end", state=controller.state.name, reason=controller.reason)
        recording.events = list(self._events.events)
        add_stages(recording)
        recording.meta |= {
            "end_state": controller.state.name,
            "end_reason": controller.reason,
            "first_reason": self._first_reason,
            "joint_friction": controller.joint_friction.tolist() if learns else [],
            "missing_inertia": controller.missing_inertia.tolist(),
            "normal_std": [std or None for std in controller.normal_std.tolist()],
            "wall_s": perf_counter() - self._start_times[0],
            "cpu_s": process_time() - self._start_times[1],
        }
        return recording


def subject_of(
    controller: Controller, pairs: Sequence[ContactPair], placements: Array, owners: Array
) -> Subject:
    """Description of the system that a controller controls, with its true contacts.

    Args:
        controller: the controller.
        pairs: the true contacts.
        placements: (contacts, 4, 4) initial poses of the touched bodies.
        owners: (r,) index of the contact of each force magnitude.
    """
    return Subject(
        pairs=tuple(pairs),
        placements=placements,
        owners=owners,
        dt=controller.dt,
        arms=len(controller.chain.arms),
        phased=controller.life is not None,
    )


def own_subject(controller: Controller) -> Subject:
    """Description of a system whose true contacts are those of the controller's model.

    Args:
        controller: the controller; touched bodies are placed at the world's origin.
    """
    pairs = tuple(controller.contacts)
    world = np.tile(np.eye(4), (len(pairs), 1, 1))
    return subject_of(controller, pairs, world, force_owners(pairs))


@cache
def _package_version() -> str:
    """Version of the installed package, from its files; they are read once."""
    return version("osc-contact")


def describe_subject(subject: Subject, controller: Controller) -> Json:
    """Meta data of a recording: names, limits, losses, rate and versions.

    Args:
        subject: description of the recorded system.
        controller: controller of the loop.

    Returns:
        JSON data by key; the limit of a motor without a limit is None.
    """
    chain = controller.chain
    limits = [limit if limit < np.inf else None for limit in chain.tau_max.tolist()]
    motors = [chain.joint_names[j] for j in chain.actuated]
    losses = []
    for arm in chain.arms:
        losses += joint_losses(arm.model, f"{arm.name}/")
    return {
        "version": _package_version(),
        "law_hash": law_hash(),
        "arm_names": [arm.name for arm in chain.arms],
        "joint_names": chain.joint_names,
        "effort_limits": dict(zip(motors, limits, strict=True)),
        "joint_losses": losses,
        "contact_names": [pair.name for pair in subject.pairs],
        "columns": subject.owners.tolist(),
        "control_rate_hz": 1.0 / controller.dt,
        "force_steps_s": [],
        "force_rise_s": controller.gains.force.rise,
    }
