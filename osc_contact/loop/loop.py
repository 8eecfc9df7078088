"""The control loop: a robot and its controller, tick by tick, and how signals end it."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from inspect import signature
from math import inf
from time import perf_counter, sleep
from typing import Any, NoReturn, Protocol

import numpy as np

from osc_contact.control.status import SafetyState
from osc_contact.errors import InvalidInputError, PlantError, brief
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.loop.shadow import Shadow, ShadowReport
from osc_contact.loop.start_rules import checked
from osc_contact.spatial import Array

#: What ends a program, where the system has it: signal → what is called by default.
_USUAL: dict[int, Any] = {
    getattr(signal, name): signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
}


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
    if threading.current_thread() is threading.main_thread():
        for number, usual in _USUAL.items():
            if signal.getsignal(number) == usual:
                signal.signal(number, signals.note)
    try:
        yield signals
    finally:
        for number, usual in _USUAL.items():
            if signal.getsignal(number) == signals.note:
                signal.signal(number, usual)
    if signals.seen:
        signals.end()


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

    def log(self, event: str, **facts: Any) -> None:
        """Note an event of the loop, such as "stop" with its reason; by default nothing is done."""


class Shows(Protocol):
    """What the loop needs of a viewer."""

    def show(self, tick: Mapping[str, Any]) -> None:
        """Take the channels of one tick; returns at once. An error ends the view, not the run."""


def at_once(call: Callable[[], object]) -> None:
    """Do something at once: what a recorder does where no thread does it."""
    call()


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
    check: bool = True,
) -> LoopReport:
    """Measure, compute, record, command: once for each reference, then stop the robot.

    The robot keeps the time: `Robot.command` returns when the period is over.

    `Robot.stop` is called with a reason in the very tick in which the controller enters
    `SAFE_STOP`, once more if it comes to need the mechanical brakes later, and however the loop
    ends: with its references, by an error, by Ctrl-C, SIGTERM or SIGHUP. A signal ends the loop at
    once, but never amid a tick's record or amid this last stop, unless it is the third. That is so
    in the main thread, which signals come to, where the program has no handler yet; elsewhere end
    the references to end the loop.

    Args:
        robot: hardware, or a plant.
        controller: a `Controller`, or anything with its `tick` and `dt`; its `state`, `reason` and
            `unbraked` are looked at if there are any.
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
        check: compare robot, controller and references before the first command, as `preflight`
            does, in half a second at most. A sequence of references is compared as a whole (what
            the joints do on the way, for its first 2000 steps), of an iterator the first one only.
            Doubts are logged. Not with `shadow`, nor for controllers that are no `Controller`.

    Returns:
        How the loop ran, with the findings of `shadow`.

    Raises:
        InvalidInputError: a viewer without a recorder; a robot whose `stop` takes no reason;
            `shadow` with more than one arm; what `check` refuses, with cause and cure.
        PlantError: deadlines are missed, the simulation diverged, or what else the robot raises. If
            its `stop` then fails, too, that is a note of the error, and logged.
        KeyboardInterrupt, SystemExit: a signal ended it; the latter has the code 128 + its number.
    """
    if viewer is not None and recorder is None:
        raise InvalidInputError("a viewer shows what is recorded; give the loop a recorder, too")
    _require_robot(robot, controller)
    period = controller.dt
    report = LoopReport(period)
    judge = Shadow(controller) if shadow else None
    stopped = braked = False

    log = getattr(recorder, "log", _log_nothing)

    def stop(reason: str) -> Exception | None:
        failure = _stop(robot, reason)
        log("stop", reason=reason, **({} if failure is None else {"failure": repr(failure)}))
        return failure

    def draw(tick: Mapping[str, Any]) -> None:
        nonlocal viewer
        try:
            if viewer is not None:
                viewer.show(tick)
        except Exception:
            _log.exception("the viewer failed; the run continues without it")
            viewer = None

    with raised_signals() as signals, _process(realtime, recorder, report) as side:
        try:
            if check and not shadow:
                references = checked(robot, controller, references)
            for k, reference in enumerate(references):
                measurement = robot.measure()
                start = perf_counter()
                tau = controller.tick(measurement, reference)
                seconds = perf_counter() - start
                before = stopped, braked
                stopped = getattr(controller, "state", None) is SafetyState.SAFE_STOP
                braked = stopped and (braked or bool(getattr(controller, "unbraked", None)))
                if stopped and before != (stopped, braked) and not shadow:
                    stop(getattr(controller, "reason", ""))
                if recorder is not None:
                    signals.whole(recorder.append, measurement, reference, tau, seconds)
                    if viewer is not None:
                        if side is None:
                            draw(recorder.latest())
                        elif k % SHOWN == 0 and side.idle:
                            side.submit(partial(draw, recorder.latest()))
                if judge is not None:
                    tau = judge.torques(measurement)
                ready = perf_counter()
                robot.command(tau, period)
                report.note(start, getattr(robot, "read_to_write", ready - start))
                if side is not None:
                    report.require()
                    side.give_way()
                if progress is not None and k % NEWS == NEWS - 1:
                    progress((k + 1) * period)
            signals.busy = True
        except BaseException as error:
            signals.busy = True
            failure = stop(signals.name or f"{type(error).__name__}: {error}")
            if failure is not None:
                error.add_note(f"robot.stop() then failed, too: {failure!r}")
            raise
        log("stop", reason="")
        robot.stop("")
    if judge is not None:
        report.shadow = judge.report()
    return report


@contextmanager
def _process(realtime: bool, recorder: Any, report: LoopReport) -> Iterator[SideWork | None]:
    """The process made for the loop, and the thread beside it; None: nothing is changed."""
    if not realtime:
        yield None
        return
    with realtime_process() as report.notes:
        side = SideWork(report.period)
        hands_over = hasattr(recorder, "hand_over") and hasattr(recorder, "note")
        if hands_over:
            recorder.hand_over = side.submit
        try:
            yield side
        finally:
            side.close()
            if hands_over:
                recorder.hand_over = at_once
                recorder.note({"loop": report.as_dict()})
        if side.failure is not None:  # the robot has been stopped
            raise side.failure


def _log_nothing(event: str, **facts: Any) -> None:
    """Drop an event: there is no recorder, or it keeps no events."""


def _stop(robot: Robot, reason: str) -> Exception | None:
    """Stop it where there is more to do; returns why that failed, which is logged."""
    try:
        robot.stop(reason)
    except Exception as error:
        _log.exception("robot.stop(%r) failed", reason)
        return error
    return None


def _require_robot(robot: Robot, controller: Controls) -> None:
    """Refuse what has not the methods of a robot and of a controller, before it moves.

    And a robot that cannot be stopped with a reason.
    """
    for name, value, methods in (
        ("robot", robot, ("measure", "command", "stop")),
        ("controller", controller, ("tick", "dt")),
    ):
        lacking = [method for method in methods if not hasattr(value, method)]
        if lacking:
            raise InvalidInputError(
                f"{name} is {brief(value)}, which has no {' and no '.join(lacking)}; the order is "
                "run_loop(robot, controller, references)"
            )
    try:
        signature(robot.stop).bind("why")
    except TypeError as error:
        raise InvalidInputError(
            f"stop() of {type(robot).__name__} takes no reason ({error}); "
            'define it as stop(self, reason="")'
        ) from error
    except ValueError:  # the signature of compiled drivers is not known
        pass


# A process made for the control loop: its priority and memory, its deadlines, its side work.


PRIORITY = 80  #: of SCHED_FIFO; network interrupts of real-time kernels have 50
SWITCH_S = 5e-5  #: after which Python's other threads give way to the loop
BIN_S = 5e-6  #: width of the histogram's bins; longer times than 2 ms share the last
BINS = 400
LATE_SHARE = 0.5  #: of the period from reading to writing; a robot needs the rest
LATE_CYCLES = 1.5  #: periods from one reading to the next
MOST_MISSED = 20  #: deadlines in a row
SLACK_SHARE = 0.1  #: of the period, after the torques are sent, that is left to side work
_LOCK_ALL = 3  # MCL_CURRENT | MCL_FUTURE


@dataclass
class LoopReport:
    """How a loop ran.

    A deadline is missed where torques come later than half a period after their measurement, or a
    measurement later than one and a half periods after the last one.

    Attributes:
        period: of the loop (s).
        ticks: computed. missed: deadlines. in_a_row: those missed last.
        histogram: counts of the time from a measurement to its torques, in bins of 5 µs.
        largest: of these times (s).
        notes: what the system did not permit, a sentence each.
        shadow: what a run with `shadow=True` found; else None.
    """

    period: float
    ticks: int = 0
    missed: int = 0
    in_a_row: int = 0
    histogram: list[int] = field(default_factory=lambda: [0] * (BINS + 1), repr=False)
    largest: float = 0.0
    notes: list[str] = field(default_factory=list)
    shadow: ShadowReport | None = None
    _last: float = inf

    def note(self, read: float, seconds: float) -> None:
        """One tick.

        Args:
            read: s, when it was measured. seconds: from then until its torques were sent.
        """
        self.histogram[min(int(seconds / BIN_S), BINS)] += 1
        self.largest = max(self.largest, seconds)
        late = seconds > LATE_SHARE * self.period or read - self._last > LATE_CYCLES * self.period
        self._last = read
        self.ticks += 1
        self.missed += late
        self.in_a_row = self.in_a_row + 1 if late else 0

    def require(self) -> None:
        """Refuse to continue once too many deadlines in a row were missed.

        Raises:
            PlantError: 20 were.
        """
        if self.in_a_row >= MOST_MISSED:
            raise PlantError(
                f"{self.in_a_row} deadlines in a row were missed, {self.missed} of {self.ticks} in "
                f"all: torques took up to {1e3 * self.largest:.3g} ms, a period is "
                f"{1e3 * self.period:g} ms. Free the machine of other work, permit real-time "
                "priority, or raise the period"
            )

    @property
    def read_to_write_us(self) -> dict[str, float]:
        """ "p50", "p99", "p99_9", "max" of the time from a measurement to its torques, to 5 µs."""
        shares = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
        counts = np.cumsum(self.histogram)
        bins = {name: np.searchsorted(counts, x * self.ticks) for name, x in shares.items()}
        times = {name: 1e6 * BIN_S * (int(k) + 1) for name, k in bins.items()}
        return {**times, "max": 1e6 * self.largest}

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form, which recordings carry."""
        names = ("ticks", "missed", "read_to_write_us", "histogram", "notes")
        return {name: getattr(self, name) for name in names}


def latency(loop: Mapping[str, Any]) -> str:
    """For people: times from a measurement to its torques, and missed deadlines.

    Args:
        loop: `LoopReport.as_dict`, as recordings carry it.
    """
    times = loop["read_to_write_us"]
    return (
        f"p50 {times['p50']:.0f} µs, p99.9 {times['p99_9']:.0f} µs, max {times['max']:.0f} µs; "
        f"{loop['missed']} of {loop['ticks']} deadlines missed"
    )


@contextmanager
def realtime_process() -> Iterator[list[str]]:
    """Real-time priority, locked memory, no garbage collection; what is not permitted, as notes."""
    notes: list[str] = []
    before = None
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        notes.append(
            f"no real-time priority ({error}): other processes delay ticks; permit it by "
            "'rtprio 99' in /etc/security/limits.conf"
        )
    system = ctypes.CDLL(None, use_errno=True)
    if not hasattr(system, "mlockall") or system.mlockall(_LOCK_ALL):
        notes.append(
            f"memory is not locked ({os.strerror(ctypes.get_errno())}): a page that is fetched "
            "delays a tick; permit it by 'memlock unlimited' in /etc/security/limits.conf"
        )
    interval = sys.getswitchinterval()
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    for note in notes:
        _log.warning(note)
    try:
        yield notes
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if collecting:
            gc.enable()
        if hasattr(system, "munlockall"):
            system.munlockall()
        if before is not None:
            os.sched_setscheduler(0, *before)


class SideWork:
    """A thread for what may take long: files, viewers.

    It runs while the loop waits, one priority below it, and gives way within 50 µs.

    Attributes:
        failure: the first error of a call; the calls after it are made all the same.
    """

    def __init__(self, period: float) -> None:
        """Begin; the loop leaves a tenth of its period (s) to it where there is work."""
        self._slack = SLACK_SHARE * period
        self._thread = ThreadPoolExecutor(1, "side work", _lower_priority)
        self.failure: Exception | None = None
        self._last: Future[None] = self._thread.submit(self._make, int)  # begins the thread now
        self._last.result()

    @property
    def idle(self) -> bool:
        """Whether nothing is left to do."""
        return self._last.done()

    def submit(self, call: Callable[[], object]) -> None:
        """Have something done soon; an error of it is logged, and kept as `failure`."""
        self._last = self._thread.submit(self._make, call)

    def give_way(self) -> None:
        """Called by the loop when its torques are sent."""
        if not self.idle:
            sleep(self._slack)

    def close(self) -> None:
        """Wait until everything is done."""
        self._thread.shutdown()

    def _make(self, call: Callable[[], object]) -> None:
        try:
            call()
        except Exception as error:
            _log.exception("side work of the control loop failed")
            self.failure = self.failure or error


def _lower_priority() -> None:
    if hasattr(os, "SCHED_FIFO") and os.sched_getscheduler(0) == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY - 1))
