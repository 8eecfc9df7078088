"""Control loop that the caller steps once for each control period."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from time import perf_counter
from types import TracebackType
from typing import Any, Generic, NamedTuple, Self, TypeVar

from osc_contact.control.status import SafetyState
from osc_contact.errors import InvalidInputError, brief
from osc_contact.interface import Measurement, Reference, Scene
from osc_contact.loop.protocols import Controls, Leads, Records, Shows
from osc_contact.loop.start_rules import checked
from osc_contact.spatial import Array

_log = logging.getLogger(__name__)

Law = TypeVar("Law", bound=Controls)  #: class of the controller


class StopCalls:
    """Calls of a robot's `stop`, each with its reason, and their entries in the event log.

    Args:
        stop: `Robot.stop`, called with the reason.
        recorder: its `log`, if it has one, receives every call.

    Attributes:
        log: records an event of the loop.
    """

    def __init__(self, stop: Callable[[str], object], recorder: Records | None) -> None:
        """Set the robot's `stop` and the recorder, see the class; nothing is called yet."""
        self._stop = stop  #: function that stops the robot
        self._stopped = False  #: whether it was called for the present stop
        self._needs_brakes = False  #: whether a joint needs its mechanical brakes
        self.log: Callable[..., None] = getattr(recorder, "log", _ignore_event)

    def follow(self, controller: Controls) -> None:
        """Call `stop` when the controller enters a safe stop, and again if brakes become necessary.

        Mechanical brakes are necessary once the controller names a joint in `unbraked`.

        Args:
            controller: its attributes `state`, `reason` and `unbraked` are read if it has them.
        """
        was_stopped = self._stopped
        needed_brakes = self._needs_brakes
        self._stopped = getattr(controller, "state", None) is SafetyState.SAFE_STOP
        if not self._stopped:  # the usual tick reads nothing else
            self._needs_brakes = False
            return
        has_unbraked_joint = bool(getattr(controller, "unbraked", None))
        self._needs_brakes = needed_brakes or has_unbraked_joint
        if not was_stopped or self._needs_brakes != needed_brakes:
            self.call(getattr(controller, "reason", ""))

    def call(self, reason: str) -> Exception | None:
        """Call the robot's `stop` and log the call.

        Args:
            reason: sentence that is passed to `stop`.

        Returns:
            The error that `stop` raised, which is logged, too; None if it succeeded.
        """
        facts = {"reason": reason}
        failure = None
        try:
            self._stop(reason)
        except Exception as error:
            _log.exception("robot.stop(%r) failed", reason)
            failure = error
            facts["failure"] = repr(error)
        self.log("stop", **facts)
        return failure


class Drawing:
    """Pictures of a run, which never end it: a viewer that fails is logged once, and dropped.

    Args:
        viewer: draws the ticks; None: nothing is drawn.
        recorder: provides the channels of a tick.

    Raises:
        InvalidInputError: a viewer without a recorder.
    """

    def __init__(self, viewer: Shows | None, recorder: Records | None) -> None:
        """Set viewer and recorder; a viewer needs a recorder (`InvalidInputError`)."""
        if viewer is not None and recorder is None:
            raise InvalidInputError(
                "a viewer shows what is recorded; give the loop a recorder, too"
            )
        self._viewer = viewer  #: viewer of the ticks; None: none

    @property
    def wanted(self) -> bool:
        """Whether there is a viewer that has not failed."""
        return self._viewer is not None

    def show(self, tick: Mapping[str, Any]) -> None:
        """Draw the channels of one tick.

        Args:
            tick: channels by name; nothing is drawn if there is no viewer or it has failed.
        """
        if self._viewer is None:
            return
        try:
            self._viewer.show(tick)
        except Exception:
            _log.exception("the viewer failed; the run continues without it")
            self._viewer = None


def _ignore_event(event: str, **facts: Any) -> None:
    """Drop an event: there is no recorder, or it records no events."""


class SteppedLoop(Generic[Law]):
    """Control loop for a simulation, a learning environment or a driver that owns the time.

    The caller reads the sensors, calls `step` once for each control period and applies the torques.
    Everything else is as in `run_loop`: the checks before the first torques, the stop with its
    reason, the recorder and the viewer. As a context manager the loop ends with its block, and an
    error in the block stops the robot.

    Args:
        controller: a `Controller`, or any object with its `tick` and `dt`.
        stop: called with the reason in the tick in which the controller enters `SAFE_STOP`, again
            if the arms come to need their mechanical brakes, and when the loop ends, with the error
            that ends the block or an empty reason. None: only the torques stop the arms.
        recorder: records every tick.
        viewer: draws every tick; needs a recorder that provides channels.
        check: True: the first call of `step` compares controller, measurement and reference, as
            `run_loop` does before its first command, within half a second. Doubts are logged.
        scene: returns masses and shapes around the robot, which the checks then compare with the
            model, for example `MujocoArm.scene`; None: they are not compared.
        plan: a `Plan` that gives the references, in place of the caller. After its end the object
            is held, until the caller ends the loop.

    Raises:
        InvalidInputError: a viewer without a recorder, or a controller without `tick` and `dt`.

    Example:
        >>> from osc_contact import robots
        >>> urdf = robots.find_robot("panda")[0]
        >>> arm = osc.Arm.from_urdf(urdf, name="panda", tip="panda_hand_tcp")
        >>> chain = osc.ClosedChain([arm])
        >>> q = np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, 0.8])
        >>> X = chain.state(q).X_WO
        >>> loop = osc.SteppedLoop(osc.Controller(chain, [], posture=q))
        >>> reading = osc.Measurement(q, np.zeros(7), np.zeros((1, 6)))
        >>> tau = loop.step(reading, osc.pose_reference(X.translation, X.rotation))
        >>> print(tau.shape, loop.controller.status.name)
        (7,) OK
    """

    def __init__(
        self,
        controller: Law,
        *,
        stop: Callable[[str], object] | None = None,
        recorder: Records | None = None,
        viewer: Shows | None = None,
        check: bool = True,
        scene: Callable[[], Scene] | None = None,
        plan: Leads | None = None,
    ) -> None:
        """Set the parts of the loop, see the class; nothing is called before the first `step`.

        Raises:
            InvalidInputError: a controller without `tick` or `dt`, or a viewer without a recorder.
        """
        lacking = [name for name in ("tick", "dt") if not hasattr(controller, name)]
        if lacking:
            raise InvalidInputError(
                f"controller is {brief(controller)}, which has no {' and no '.join(lacking)}; give "
                "an osc.Controller"
            )
        self._drawing = Drawing(viewer, recorder)  #: drawing of the ticks
        self.controller: Law = controller
        self._recorder = recorder  #: recorder of the ticks; None: none
        self._checks_next = check  #: whether the next step checks robot and reference
        self._scene = scene  #: scene with which the contacts are compared before the first step
        self._plan = plan  #: plan that gives the references; None: the caller does
        self._plan_begun = False  #: whether the plan has begun
        #: calls of the robot's `stop`
        self._stops = StopCalls(_ignore_stop if stop is None else stop, recorder)
        self._ended = False  #: whether the loop has ended

    def step(self, measurement: Measurement, reference: Reference | None = None) -> Array:
        """Compute and record one control period.

        Args:
            measurement: readings at the beginning of the period.
            reference: desired motion and forces of the period; None: that of the plan.

        Returns:
            (n_a,) motor torques for the period (N m, N): safe ones where `controller.status` is not
            OK, braking ones after a stop.

        Raises:
            InvalidInputError: the checks before the first torques refuse something, the loop has
                ended, or it has both a plan and a reference, or neither.
        """
        if self._ended:
            raise InvalidInputError(
                "the loop has ended; make a new SteppedLoop, with a new controller or one that was "
                "reset"
            )
        measurement, reference = self._input_of_tick(measurement, reference)
        if self._checks_next:
            checked(_RestingRobot(measurement, self._scene), self.controller, [reference])
            self._checks_next = False
        start = perf_counter()
        tau = self.controller.tick(measurement, reference)
        seconds = perf_counter() - start
        self._stops.follow(self.controller)
        if self._recorder is not None:
            self._recorder.append(measurement, reference, tau, seconds)
            if self._drawing.wanted:
                self._drawing.show(self._recorder.latest())
        return tau

    def _input_of_tick(
        self, measurement: Measurement, reference: Reference | None
    ) -> tuple[Measurement, Reference]:
        """Measurement and reference of a tick; with a plan, its reference and placed bodies.

        Args:
            measurement: readings at the beginning of the period.
            reference: the caller's reference; None with a plan, which begins in the first call.

        Raises:
            InvalidInputError: there are a plan and a reference, or neither; or the plan is refused.
        """
        plan = self._plan
        if (plan is None) == (reference is None):
            raise InvalidInputError(
                "the loop has no plan and step was given no reference; give one of them"
                if plan is None
                else "the loop has a plan, which gives the references; call step(measurement)"
            )
        if plan is None or reference is not None:
            assert reference is not None
            return measurement, reference
        if not self._plan_begun:
            plan.begin(self.controller, measurement, self._stops.log)
            self._plan_begun = True
        return plan.placed(measurement), plan.step()

    def end(self, reason: str = "") -> None:
        """End the loop: call the robot's `stop`, and record the event; later calls do nothing.

        Args:
            reason: sentence on the cause, which `stop` receives; empty if the task is done.
        """
        if not self._ended:
            self._ended = True
            self._stops.call(reason)

    def __enter__(self) -> Self:
        """Return the loop itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the loop; an error of the block becomes the reason of the stop."""
        self.end("" if error is None else f"{type(error).__name__}: {error}")


def _ignore_stop(reason: str) -> None:
    """Leave the stop to the torques: the caller gave no `stop`."""


class _RestingRobot(NamedTuple):
    """Robot at rest, as the checks before the first torques read it.

    Attributes:
        measurement: reading of the robot at rest.
        look_around: returns the robot's scene; None: unknown.
    """

    measurement: Measurement
    look_around: Callable[[], Scene] | None

    def measure(self) -> Measurement:
        """Return the reading of the robot at rest."""
        return self.measurement

    def scene(self) -> Scene | None:
        """Return masses and shapes around the robot; None: unknown."""
        return None if self.look_around is None else self.look_around()
