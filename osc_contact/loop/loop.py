"""The control loop: a robot and its controller, tick by tick."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from inspect import signature
from time import perf_counter
from typing import Any, Protocol

from osc_contact.control.status import SafetyState
from osc_contact.errors import InvalidInputError, brief
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.loop.os_signals import raised_signals
from osc_contact.loop.realtime import LoopReport, SideWork, at_once, realtime_process
from osc_contact.loop.shadow import Shadow
from osc_contact.loop.start_rules import checked
from osc_contact.spatial import Array

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
