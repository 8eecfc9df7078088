"""The control loop: a robot and its controller, tick by tick, and how signals end it."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from inspect import signature
from time import perf_counter
from typing import Any, NoReturn, Protocol, TypeVar, runtime_checkable

from osc_contact.control.controller import Controller
from osc_contact.control.status import SafetyState
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.plants.judge import Plant, Truth
from osc_contact.runs.realtime import Deadlines, LoopReport, SideWork, realtime_process
from osc_contact.runs.shadow import Shadow
from osc_contact.spatial import Array
from osc_contact.visual.live import Shows

#: What ends a program, where the system has it: signal → what is called by default.
_USUAL: dict[int, Any] = {
    getattr(signal, name): signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
}
T = TypeVar("T")
Handler = Callable[[int, Any], None]


class RaisedSignals:
    """Signals that end a block by an exception, as Ctrl-C always does, but not amid some calls.

    Attributes:
        seen: signals that came. busy: they are kept until later; the third one is not.
    """

    def __init__(self) -> None:
        """None came yet."""
        self.seen: list[int] = []
        self.busy = False

    @property
    def name(self) -> str:
        """Of the first, such as SIGTERM; empty: none came."""
        return signal.Signals(self.seen[0]).name if self.seen else ""

    def note(self, number: int, frame: Any) -> None:
        """Take a signal in: as a handler is called."""
        self.seen.append(number)
        if not self.busy or len(self.seen) > 2:
            self.end()

    def whole(self, call: Callable[..., Any], *given: Any) -> None:
        """Call something that no signal interrupts; one that came meanwhile ends the block then.

        Args:
            call, given: a function and its arguments.
        """
        self.busy = True
        call(*given)
        self.busy = False
        if self.seen:
            self.end()

    def end(self) -> NoReturn:
        """End the block.

        Raises:
            KeyboardInterrupt: by Ctrl-C.
            SystemExit: by another signal, with 128 + its number, as a shell reports it.
        """
        if self.seen[0] == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + self.seen[0])


@contextmanager
def raised_signals() -> Iterator[RaisedSignals]:
    """Let signals end a block by an exception; those kept until its end are raised then."""
    signals = RaisedSignals()
    with _handled(signals.note):
        yield signals
    if signals.seen:
        signals.end()


@contextmanager
def end_requested() -> Iterator[Callable[[], bool]]:
    """Whether a signal that ends programs came since the block began.

    The first is only noted; the second ends the program as always.
    """
    seen: list[int] = []

    def note(number: int, frame: Any) -> None:
        seen.append(number)
        _restore(note)

    with _handled(note):
        yield lambda: bool(seen)


@contextmanager
def _handled(note: Handler) -> Iterator[None]:
    """Have signals handled that would end the program."""
    if threading.current_thread() is threading.main_thread():
        for number, usual in _USUAL.items():
            if signal.getsignal(number) == usual:
                signal.signal(number, note)
    try:
        yield
    finally:
        _restore(note)


def _restore(note: Handler) -> None:
    for number, usual in _USUAL.items():
        if signal.getsignal(number) == note:
            signal.signal(number, usual)


def until(requested: Callable[[], bool], items: Iterable[T]) -> Iterator[T]:
    """Items until the end is requested."""
    for item in items:
        if requested():
            return
        yield item


_log = logging.getLogger(__name__)

NEWS = 100  #: ticks from one call of `progress` to the next
SHOWN = 33  #: ticks from one picture to the next, where another thread hands them to the viewer


class Controls(Protocol):
    """What the loop needs of a controller."""

    @property
    def dt(self) -> float:
        """The control period (s)."""

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Motor torques (n_a,) for one period."""


class Records(Protocol):
    """What the loop needs of a recorder."""

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Keep a tick before its torques act: what went in, what came out, what it took (s).

        Args:
            measurement, reference: of the tick. tau: (n_a,) its torques. seconds: spent on it.
        """

    def latest(self) -> Mapping[str, Any]:
        """The channels of the last tick, for a viewer; by default none."""
        return {}


def at_once(call: Callable[[], object]) -> None:
    """Do something at once: what a recorder does where no thread does it."""
    call()


@runtime_checkable
class HandsOver(Protocol):
    """A recorder whose files another thread may write, and that takes notes of the loop."""

    hand_over: Callable[[Callable[[], object]], None]

    def note(self, meta: Mapping[str, Any]) -> None:
        """Add to the meta data of the recording."""


class Witness(Records):
    """Keeps of every tick the truth just after its torques have changed.

    Rigid contacts answer torques at once; a `Recorder` notes what was true just before.

    Attributes:
        truths, status: of each tick.
    """

    def __init__(self, plant: Plant, controller: Controller) -> None:
        """Watch a plant and its controller."""
        self.plant = plant
        self.controller = controller
        self.truths: list[Truth] = []
        self.status: list[int] = []

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """See `Records.append`.

        Args:
            measurement, reference, tau, seconds: as of `Records.append`.
        """
        self.plant.hold(tau)
        self.truths.append(self.plant.truth())
        self.status.append(int(self.controller.status))


def run_loop(
    robot: Robot,
    controller: Controls,
    references: Iterable[Reference],
    *,
    recorder: Records | None = None,
    viewer: Shows | None = None,
    progress: Callable[[float], None] | None = None,
    realtime: bool = False,
    shadow: bool = False,
) -> LoopReport:
    """Measure, compute, record, command: once for each reference, then stop the robot.

    The robot keeps the time: `Robot.command` returns when the period is over.

    `Robot.stop` is called with a reason in the very tick in which the controller enters
    `SAFE_STOP`, and however the loop ends: with its references, by an error, by Ctrl-C, SIGTERM or
    SIGHUP. A signal ends the loop at once, but never amid a tick's record or amid this last stop,
    unless it is the third. That is so in the main thread, which signals come to, where the program
    has no handler yet; elsewhere end the references to end the loop.

    Args:
        robot: hardware, or a plant.
        controller: a `Controller`, or anything with its `tick` and `dt`; its `state` and `reason`
            are looked at if there are any.
        references: one for each tick, of any length; a generator may have no end.
        recorder: notes every tick; a `Recorder` makes a recording of them, with the truth if it
            was given a judge.
        viewer: shows the run while it lasts; needs a recorder that gives it channels. One that
            fails is logged once, and the run continues without it.
        progress: called with the time (s) now and then.
        realtime: make the process one for the loop, as far as the system permits: real-time
            priority, locked memory, no garbage collection; files are written and pictures shown by
            a thread that runs while the loop waits. 20 missed deadlines in a row end the loop.
        shadow: send the model's weight in place of the controller's torques, while somebody moves
            the arm by hand, and judge the model. The controller's stops are not carried out.

    Returns:
        How the loop ran, with the findings of `shadow`.

    Raises:
        InvalidInputError: a viewer without a recorder; a robot whose `stop` takes no reason;
            `shadow` with more than one arm.
        PlantError: deadlines are missed, the simulation diverged, or what else the robot raises. If
            its `stop` then fails, too, that is a note of the error, and logged.
        KeyboardInterrupt, SystemExit: a signal ended it; the latter has the code 128 + its number.
    """
    if viewer is not None and recorder is None:
        raise InvalidInputError("a viewer shows what is recorded; give the loop a recorder, too")
    _require_stop(robot)
    deadlines = Deadlines(controller.dt)
    watch = Shadow(controller) if shadow else None
    with raised_signals() as signals, _process(realtime, recorder, controller.dt) as (notes, side):
        course = _Course(robot, controller, recorder, viewer, signals, deadlines, side, watch)
        try:
            course.run(references, progress)
            signals.busy = True
        except BaseException as error:
            signals.busy = True
            failure = _stop(robot, signals.name or f"{type(error).__name__}: {error}")
            if failure is not None:
                error.add_note(f"robot.stop() then failed, too: {failure!r}")
            raise
        finally:
            report = deadlines.report(notes)
            if realtime and isinstance(recorder, HandsOver):
                recorder.note({"loop": report.as_dict()})
        robot.stop("")
    if watch is not None:
        report.shadow = watch.report()
    return report


@contextmanager
def _process(
    realtime: bool, recorder: Records | None, period: float
) -> Iterator[tuple[list[str], SideWork | None]]:
    """The process made for the loop, and the thread beside it."""
    if not realtime:
        yield [], None
        return
    with realtime_process() as notes:
        side = SideWork(period)
        if isinstance(recorder, HandsOver):
            recorder.hand_over = side.submit
        try:
            yield notes, side
        finally:
            side.close()
            if isinstance(recorder, HandsOver):
                recorder.hand_over = at_once
        if side.failure is not None:  # the robot has been stopped
            raise side.failure


@dataclass
class _Course:
    """The ticks of one loop, and what goes with them."""

    robot: Robot
    controller: Controls
    recorder: Records | None
    viewer: Shows | None
    signals: RaisedSignals
    deadlines: Deadlines
    side: SideWork | None
    shadow: Shadow | None

    def run(
        self, references: Iterable[Reference], progress: Callable[[float], None] | None
    ) -> None:
        """All ticks."""
        robot = self.robot
        controller = self.controller
        side = self.side
        shadow = self.shadow
        period = controller.dt
        stopped = False
        for k, reference in enumerate(references):
            measurement = robot.measure()
            start = perf_counter()
            tau = controller.tick(measurement, reference)
            seconds = perf_counter() - start
            entered = not stopped
            stopped = getattr(controller, "state", None) is SafetyState.SAFE_STOP
            if stopped and entered and shadow is None:
                _stop(robot, getattr(controller, "reason", ""))
            if self.recorder is not None:
                self.signals.whole(self.recorder.append, measurement, reference, tau, seconds)
                if self.viewer is not None:
                    self._show(self.recorder, self.viewer, k)
            if shadow is not None:
                tau = shadow.torques(measurement)
            ready = perf_counter()
            robot.command(tau, period)
            self.deadlines.note(start, getattr(robot, "read_to_write", ready - start))
            if side is not None:
                self.deadlines.require()
                side.give_way()
            if progress is not None and k % NEWS == NEWS - 1:
                progress((k + 1) * period)

    def _show(self, recorder: Records, viewer: Shows, k: int) -> None:
        if self.side is None:
            self._draw(viewer, recorder.latest())
        elif k % SHOWN == 0 and self.side.idle:
            self.side.submit(partial(self._draw, viewer, recorder.latest()))

    def _draw(self, viewer: Shows, tick: Mapping[str, Any]) -> None:
        """Show a tick; a viewer that fails is reported once and left out of the rest of the run."""
        try:
            viewer.show(tick)
        except Exception:
            _log.exception("the viewer failed; the run continues without it")
            self.viewer = None


def _stop(robot: Robot, reason: str) -> Exception | None:
    """Stop it where there is more to do; returns why that failed, which is logged."""
    try:
        robot.stop(reason)
    except Exception as error:
        _log.exception("robot.stop(%r) failed", reason)
        return error
    return None


def _require_stop(robot: Robot) -> None:
    """Refuse a robot that cannot be stopped with a reason, before it moves."""
    try:
        signature(robot.stop).bind("why")
    except TypeError as error:
        raise InvalidInputError(
            f"stop() of {type(robot).__name__} takes no reason ({error}); "
            'define it as stop(self, reason="")'
        ) from error
    except ValueError:  # the signature of compiled drivers is not known
        pass
