"""Control loop of a robot and its controller."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from inspect import signature
from time import perf_counter
from typing import Any

from osc_contact.errors import InvalidInputError, brief
from osc_contact.interface import Reference, Robot
from osc_contact.loop.os_signals import RaisedSignals, raised_signals
from osc_contact.loop.protocols import Controls, Leads, Records, Shows, references_of
from osc_contact.loop.realtime import LoopReport, SideWork, at_once, realtime_process
from osc_contact.loop.shadow import Shadow
from osc_contact.loop.start_rules import checked
from osc_contact.loop.stepped import Drawing, StopCalls

NEWS = 100  #: ticks from one call of `progress` to the next
SHOWN = 33  #: ticks from one picture to the next, where another thread hands them to the viewer


def run_loop(
    robot: Robot,
    controller: Controls,
    references: Iterable[Reference] | Leads,
    *,
    recorder: Records | None = None,
    viewer: Shows | None = None,
    progress: Callable[[float], None] | None = None,
    realtime: bool = False,
    shadow: bool = False,
    check: bool = True,
) -> LoopReport:
    """Measure, compute, record and command once for each reference, then stop the robot.

    The robot determines the timing: `Robot.command` returns at the end of the period.

    `Robot.stop` is called with a reason in the tick in which the controller enters `SAFE_STOP`,
    once more if the mechanical brakes become necessary later, and whenever the loop ends: after the
    last reference, by an error, by Ctrl-C, SIGTERM or SIGHUP. A signal ends the loop immediately,
    except while a tick is recorded or during the last stop, which only a third signal interrupts.
    Signals are handled in the main thread, unless the program has its own handlers; in other
    threads, end the references to end the loop.

    Args:
        robot: hardware or a plant.
        controller: a `Controller`, or an object with its `tick` and `dt`, and optionally its
            `state`, `reason` and `unbraked`.
        references: one for each tick; a generator may be infinite. Or a `Plan`: the loop ends with
            it, the reason of one that failed is that of the last stop.
        recorder: stores every tick; a `Recorder` makes a recording of them, with the truth if it
            was given a judge.
        viewer: shows the run while it lasts; requires a recorder that provides channels. A viewer
            that fails is logged once, and the run continues without it.
        progress: called with the time (s) every 100 ticks.
        realtime: request real-time priority and locked memory from the system, and stop garbage
            collection; files are written and pictures shown by a thread that runs while the loop
            waits. 20 consecutive missed deadlines end the loop.
        shadow: send gravity compensation in place of the controller's torques, while the arm is
            moved by hand, and check the model. Stops of the controller are not executed.
        check: check robot, controller and references before the first command, like `preflight`,
            in half a second at most. A sequence of references is checked as a whole (the motion of
            the joints for its first 2000 steps), of an iterator only the first one. Warnings are
            logged. Not applied with `shadow`, nor to objects other than a `Controller`.

    Returns:
        Timing of the loop, with the findings of `shadow`.

    Raises:
        InvalidInputError: a viewer without a recorder; a robot whose `stop` takes no reason;
            `shadow` with more than one arm; an error found by `check`, with cause and cure.
        PlantError: deadlines are missed, the simulation diverged, or another error of the robot. If
            its `stop` then fails, too, this is logged and added to the error as a note.
        KeyboardInterrupt, SystemExit: a signal ended the loop; the exit code of the latter is 128
            plus the number of the signal.
    """
    drawing = Drawing(viewer, recorder)
    _require_robot(robot, controller)
    report = LoopReport(controller.dt)
    stops = StopCalls(robot.stop, recorder)
    plan = references if isinstance(references, Leads) else None
    loop = _Loop(
        robot=robot,
        controller=controller,
        recorder=recorder,
        drawing=drawing,
        report=report,
        stops=stops,
        plan=plan,
        shadow=Shadow(controller) if shadow else None,
        progress=progress,
    )
    # while `busy` is true signals are deferred: the last stop of the robot is not interrupted
    with raised_signals() as signals, _process_context(realtime, recorder, report) as side:
        try:
            loop.run(loop.begin(references, check=check), signals, side)
            signals.busy = True
        except BaseException as error:  # also KeyboardInterrupt: the robot is stopped in any case
            signals.busy = True
            failure = stops.call(signals.name or f"{type(error).__name__}: {error}")
            if failure is not None:
                error.add_note(f"robot.stop() then failed, too: {failure!r}")
            raise
        reason = getattr(plan, "reason", "")
        stops.log("stop", reason=reason)
        robot.stop(reason)
    if loop.shadow is not None:
        report.shadow = loop.shadow.report()
    return report


@dataclass(kw_only=True)
class _Loop:
    """Parts of one call of `run_loop`, and its ticks.

    Attributes:
        robot, controller, recorder, progress: arguments of `run_loop`.
        drawing: pictures for the viewer.
        report: timing, updated in each tick.
        stops: calls of `Robot.stop` with their reasons.
        plan: the references if they are a plan; else None.
        shadow: torques and checks of shadow mode; None in a usual run.
    """

    robot: Robot
    controller: Controls
    recorder: Records | None
    drawing: Drawing
    report: LoopReport
    stops: StopCalls
    plan: Leads | None
    shadow: Shadow | None
    progress: Callable[[float], None] | None

    def begin(self, references: Iterable[Reference] | Leads, *, check: bool) -> Iterable[Reference]:
        """Begin a plan, and check robot, controller and references before the first command.

        Args:
            references: argument of `run_loop`.
            check: False leaves the check out; in shadow mode it is left out, too.

        Returns:
            References of the ticks.

        Raises:
            InvalidInputError: the plan or the check refuses the task.
        """
        sequence: Iterable[Reference]
        if isinstance(references, Leads):
            references.begin(self.controller, self.robot.measure(), self.stops.log)
            sequence = references_of(references)
        else:
            sequence = references
        if check and self.shadow is None:
            sequence = checked(self.robot, self.controller, sequence)
        return sequence

    def run(
        self, references: Iterable[Reference], signals: RaisedSignals, side: SideWork | None
    ) -> None:
        """Measure, compute, record and command once for each reference.

        Args:
            references: references of the ticks.
            signals: signals of the operating system, deferred while a tick is recorded.
            side: thread of a real-time loop for files and pictures; None: they are made in between.

        Raises:
            PlantError: the robot fails, or deadlines are missed in real time.
        """
        robot = self.robot
        controller = self.controller
        period = self.report.period
        for k, reference in enumerate(references):
            measurement = robot.measure()
            if self.plan is not None:
                measurement = self.plan.placed(measurement)
            start = perf_counter()
            tau = controller.tick(measurement, reference)
            seconds = perf_counter() - start
            if self.shadow is None:  # in shadow mode the controller's stops are not executed
                self.stops.follow(controller)
            if self.recorder is not None:
                signals.whole(self.recorder.append, measurement, reference, tau, seconds)
                self._draw_tick(k, side)
            if self.shadow is not None:
                tau = self.shadow.torques(measurement)
            # the robot's own measurement of the latency is preferred, if it has one
            ready = perf_counter()
            robot.command(tau, period)
            self.report.note(start, getattr(robot, "read_to_write", ready - start))
            if side is not None:
                self.report.require()
                side.give_way()
            if self.progress is not None and k % NEWS == NEWS - 1:
                self.progress((k + 1) * period)

    def _draw_tick(self, k: int, side: SideWork | None) -> None:
        """Show tick k to the viewer, if there is one, without delaying a real-time loop.

        Args:
            k: number of the tick.
            side: thread that shows every `SHOWN`-th tick while it is idle; None: every tick is
                shown at once.
        """
        if self.recorder is None or not self.drawing.wanted:
            return
        if side is None:
            self.drawing.show(self.recorder.latest())
        elif k % SHOWN == 0 and side.idle:
            side.submit(partial(self.drawing.show, self.recorder.latest()))


@contextmanager
def _process_context(
    realtime: bool, recorder: Any, report: LoopReport
) -> Iterator[SideWork | None]:
    """Context of a loop with `realtime`: the process and a thread for side work.

    On exit it waits for the side work, adds the report to the recording, and raises an error of the
    side work unless the loop has ended by another one.

    Args:
        realtime: argument of `run_loop`; False: the context changes nothing.
        recorder: recorder of the loop or None; its writes are handed to the thread, and it gets the
            report, if it has `hand_over` and `note`.
        report: timing of the loop; receives notes on requests that the system refused.

    Yields:
        The thread; None without `realtime`.
    """
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


def _require_robot(robot: Robot, controller: Controls) -> None:
    """Check that robot and controller have the required methods before the robot moves.

    Args:
        robot: object that should have `measure`, `command` and `stop`.
        controller: object that should have `tick` and `dt`.

    Raises:
        InvalidInputError: a method is missing, or `robot.stop` does not accept a reason.
    """
    required = (
        ("robot", robot, ("measure", "command", "stop")),
        ("controller", controller, ("tick", "dt")),
    )
    for name, value, methods in required:
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
