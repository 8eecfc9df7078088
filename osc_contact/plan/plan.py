"""Plan: a sequence of stages that gives the reference of each tick, and follows what happens."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from enum import Enum
from math import inf, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import force_owners
from osc_contact.control.status import SafetyState, Status
from osc_contact.errors import InvalidInputError
from osc_contact.files import Json
from osc_contact.interface import Measurement, Reference, Touched
from osc_contact.plan.checks import require_plan, require_stages, require_states
from osc_contact.plan.ends import End, Watch
from osc_contact.plan.motions import (
    ANGULAR_ACCELERATION,
    CHANGES,
    LINEAR_ACCELERATION,
    Course,
    permitted_displacement,
    permitted_twist,
)
from osc_contact.plan.sensed import Sensed, Senses, forces_of
from osc_contact.plan.stage import Stage, StageVerdict
from osc_contact.recognition.recogniser import Recogniser
from osc_contact.spatial import Array, pose_error

if TYPE_CHECKING:
    from osc_contact.control.controller import Controller

SETTLED = 0.1  #: time at the beginning of a stage that tares, whose readings are left out (s)
BRAKED = 1.0  #: time after a stop for which a plan gives references while the arms are braked (s)


class Outcome(Enum):
    """State of a plan."""

    NEW = "new"
    RUNNING = "running"
    PAUSED = "paused"
    STOPPED = "stopped"  #: by the controller; `Plan.resume` continues
    DONE = "done"
    FAILED = "failed"
    ABORTED = "aborted"


_OVER = (Outcome.DONE, Outcome.FAILED, Outcome.ABORTED)  #: states that a plan does not leave


class Plan:
    """Sequence of stages, in place of the references of `run_loop` or of a `SteppedLoop`.

    The reference follows the object in directions that contacts do not permit, so that contacts can
    be released without a jump. After a failure, an abort and a stop the object is held
    where it is, without contacts; after the last stage its forces remain.

    Args:
        stages: stages in their order.
        largest: measured force of the object on its environment above which a stage has failed (N).
        tries: number of failures that end the plan, also if a stage follows a failure.
        recogniser: recogniser of the contact state, which follows the low-passed wrench at its own
            period; the touched bodies are where their pairs have them. A state is unexpected
            if its probability, together with other such states, is above 95 % and it has pairs
            that are neither among the forces of the stage nor in its `may_touch`.

    Attributes:
        outcome: state of the plan.
        reason: why it failed, was aborted or stopped.
        verdicts: verdict on each stage that was passed, in order; a stage that was entered several
            times has several.

    Raises:
        InvalidInputError: no stages, equal names, or a stage that follows and does not exist.

    Example:
        >>> from osc_contact.plan import ends, motions
        >>> rig = osc.build_rig("panda_edge")
        >>> controller = rig.controller()
        >>> press = osc.Stage("press", {"edge": 10.0}, until=ends.after(0.2), within=1.0)
        >>> slide = osc.Stage(
        ...     "slide", {"edge": 10.0}, motions.along([0, 1, 0], speed=0.02, distance=2e-3),
        ...     until=ends.finished(), within=1.0,
        ... )
        >>> plan = osc.Plan([press, slide])
        >>> report = osc.run_loop(rig.plant(), controller, plan)
        >>> print(plan.outcome.value, [verdict.name for verdict in plan.verdicts])
        done ['press', 'slide']
    """

    def __init__(
        self,
        stages: Sequence[Stage],
        *,
        largest: float = inf,
        tries: int = 3,
        recogniser: Recogniser | None = None,
    ) -> None:
        """Check that the stages make a plan, and set its arguments; the plan has not begun.

        Args:
            stages: stages, the first of which begins.
            largest: force (N) above which every stage fails.
            tries: number of failures after which the plan fails.
            recogniser: recogniser of contact states, if stages depend on them.

        Raises:
            InvalidInputError: stages that do not make a plan.
        """
        require_stages(stages)
        self.stages = tuple(stages)
        self.largest = largest
        self.tries = tries
        self.recogniser = recogniser
        self.outcome = Outcome.NEW
        self.reason = ""
        self.verdicts: list[StageVerdict] = []
        self._k = 0
        self._places: dict[str, pin.SE3] = {}
        self._failures = 0
        self._time = 0.0
        self._over_for = 0.0

    # --- the loop's side ------------------------------------------------------------------------

    def begin(
        self,
        controller: Controller,
        measurement: Measurement,
        log: Callable[..., None] | None = None,
    ) -> None:
        """Check the plan, and begin with the first stage, or with that of `resume`.

        Args:
            controller: controller of the run, with the contacts that the stages name.
            measurement: reading of the robot at rest.
            log: function that is called with "stage" and facts at the beginning of each stage, and
                with "plan" and the outcome at the end; None: no calls.

        Raises:
            InvalidInputError: the plan has ended, or `require_plan` refuses it.
        """
        if self.outcome not in (Outcome.NEW, Outcome.RUNNING):
            raise InvalidInputError(
                f"the plan is {self.outcome.value}{': ' if self.reason else ''}{self.reason}; "
                "make a new one, or call plan.resume() after a stop"
            )
        X = controller.settings.chain.state(np.asarray(measurement.q, dtype=float)).X_WO
        if self.outcome is Outcome.NEW:
            require_plan(self.stages, self.largest, controller, X)
            require_states(self.stages, self.recogniser)
        contacts = controller.settings.contacts
        self._controller = controller
        self._names = [pair.name for pair in contacts]
        self._owners = force_owners(contacts)
        self._log = log
        self._senses = Senses(controller, X)
        self._senses.now.recogniser = self.recogniser
        self._ticks_to_instant = 0
        self._aim = X
        self._V = np.zeros(6)
        self.outcome = Outcome.RUNNING
        self._enter(self._k)

    def step(self) -> Reference:
        """Reference of the next tick, from the controller's results in the last tick.

        Signals and recogniser are updated. While the plan runs, the conditions of the stage are
        judged, and the next stage begins when one is met; a stop of the controller stops the plan.
        """
        dt = self._controller.dt
        now = self._senses.read()
        self._follow()
        now.aim = self._aim
        now.V_D = self._V
        self._time += dt
        if self.recogniser is not None:
            self._recognise(now, self.recogniser)
        if self._controller.state is SafetyState.SAFE_STOP and self.outcome not in _OVER:
            self._stop(self._controller.reason)
        if self.outcome is Outcome.RUNNING:
            self._judge(now)
        if self.outcome is not Outcome.RUNNING:
            self._over_for += dt
        return self._reference(now)

    def placed(self, measurement: Measurement) -> Measurement:
        """Measurement with the poses of touched bodies that the stages have placed.

        Args:
            measurement: reading of the robot, which is not changed.
        """
        if not self._places:
            return measurement
        count = len(self._names)
        touched = measurement.touched
        if touched is None:
            at_rest = np.zeros((count, 6))
            touched = Touched(np.tile(np.eye(4), (count, 1, 1)), at_rest, at_rest)
        X_WE = np.array(touched.X_WE)
        for name, X in self._places.items():
            X_WE[self._names.index(name)] = X.homogeneous
        return replace(measurement, touched=replace(touched, X_WE=X_WE))

    @property
    def ended(self) -> bool:
        """Whether there are no more references: the plan is over, or was stopped a second ago."""
        if self.outcome is Outcome.STOPPED:
            return self._over_for > BRAKED
        return self.outcome in _OVER

    @property
    def contacts(self) -> tuple[str, ...]:
        """Names of all contacts of the stages, each once."""
        return tuple(dict.fromkeys(name for stage in self.stages for name in stage.forces))

    @property
    def stage(self) -> Stage:
        """Stage that the plan is in, or was in when it ended."""
        return self.stages[self._k]

    def as_dict(self) -> Json:
        """Outcome, reason, and the fields of each verdict under `stages`, as data for JSON."""
        return {
            "outcome": self.outcome.value,
            "reason": self.reason,
            "stages": [asdict(verdict) for verdict in self.verdicts],
        }

    # --- a person's side ------------------------------------------------------------------------

    def pause(self) -> None:
        """Stop the motion and the clock of the stage; its forces remain."""
        if self.outcome is Outcome.RUNNING:
            self.outcome = Outcome.PAUSED
            self._note("plan", outcome=self.outcome.value, reason="")

    def resume(self) -> None:
        """Continue after a pause; after a stop, begin with a stage that may be entered again.

        It is the one of these that was entered last in time, also where stages were repeated. After
        a stop call `Controller.reset` first.

        Raises:
            InvalidInputError: the plan is neither paused nor stopped, the controller is still
                stopped, or no stage that was entered may be re-entered.
        """
        if self.outcome is Outcome.PAUSED:
            self.outcome = Outcome.RUNNING
            self._note("plan", outcome=self.outcome.value, reason="")
            return
        if self.outcome is not Outcome.STOPPED:
            raise InvalidInputError(
                f"the plan is {self.outcome.value}; only one that is paused or stopped is resumed"
            )
        if self._controller.state is SafetyState.SAFE_STOP:
            raise InvalidInputError(
                f"the controller is stopped: {self.reason}; remove the cause and call "
                "controller.reset() before plan.resume()"
            )
        entered = [self._number(verdict.name) for verdict in self.verdicts]  # in order of time
        candidates = [k for k in entered if self.stages[k].reentry]
        if not candidates:
            raise InvalidInputError(
                "no stage that was entered may begin again; give one of them reentry=True, or make "
                "a new plan"
            )
        self.outcome = Outcome.RUNNING
        self.reason = ""
        self._over_for = 0.0
        self._enter(candidates[-1])

    def abort(self, reason: str = "aborted by the user") -> None:
        """End the plan; the object is held where it is, without contacts.

        Args:
            reason: reason for reports.
        """
        if self.outcome not in _OVER:
            self._end_stage(reason, failed=True)
            self._finish(Outcome.ABORTED, reason)

    # --- within a tick --------------------------------------------------------------------------

    def _enter(self, k: int) -> None:
        """Begin stage k at the present pose of the object.

        Takes the stage's forces (N) and active contacts, places its touched bodies, begins its
        motion and its conditions, and opens a verdict on it, with all sums of force errors and tare
        at zero.

        Args:
            k: index of the stage.
        """
        self._k = k
        stage = self.stages[k]
        now = self._senses.now
        now.t = 0.0
        now.finished = False
        now.unexpected = ""
        now.start = now.X
        now.aim = self._aim
        self._alpha_d, self._active = forces_of(stage.forces, self._names, self._owners)
        for name, place in stage.places.items():
            self._places[name] = pin.SE3(place(now) if callable(place) else place)
        self._course: Course = stage.motion.begin(now)
        until = stage.until
        assert isinstance(until, End)  # the stage made it one
        self._watch: Watch = until.begin(now)
        self._alarm: Watch | None = None
        if isinstance(stage.unless, End):
            self._alarm = stage.unless.begin(now)
        self._squares = 0.0  # sum of the squared force errors (N²) of `_ticks` ticks
        self._ticks = 0
        self._residual = np.zeros(6)  # sum of the residual wrenches of `_weighed` ticks
        self._weighed = 0
        self._verdict = StageVerdict(stage.name, self._time)
        self._note("stage", name=stage.name, number=k)

    def _recognise(self, now: Sensed, recogniser: Recogniser) -> None:
        """Update the contact state once in its period, and note one that is unexpected.

        Args:
            now: signals after the last tick; `unexpected` is updated.
            recogniser: the plan's.
        """
        if self._ticks_to_instant == 0:
            recogniser.update(now.X, now.wrench)
            self._ticks_to_instant = max(1, round(recogniser.period / self._controller.dt))
            assumed = {*self.stage.forces, *self.stage.may_touch}
            before = now.unexpected
            now.unexpected = recogniser.unexpected(assumed)
            if now.unexpected and not before:
                verdict = self._verdict
                verdict.unexpected = verdict.unexpected or now.unexpected
                self._note("unexpected", state=now.unexpected, stage=self.stage.name)
        self._ticks_to_instant -= 1

    def _follow(self) -> None:
        """Move the aim to the object in the directions that contacts do not permit.

        The deviation of the aim from the object keeps its permitted part, of its angles as much as
        possible, so that a released contact causes no jump.
        """
        if self._controller.records.memory.ticked and self._controller.status is not Status.HELD:
            X = self._senses.now.X
            e = permitted_displacement(self._senses.now.N, pose_error(self._aim, X))
            self._aim = pin.SE3(pin.exp3(e[3:]) @ X.rotation, X.translation + e[:3])

    def _judge(self, now: Sensed) -> None:
        """Update the verdict by the last tick; end the stage if a condition is met.

        Args:
            now: signals after the last tick.
        """
        stage = self.stage
        dt = self._controller.dt
        now.t += dt
        verdict = self._verdict
        force = float(np.linalg.norm(now.wrench[:3]))
        verdict.peak = max(verdict.peak, force)
        self._ticks += 1
        if self._controller.records.memory.ticked:
            self._squares += self._senses.force_error(self._alpha_d)
        # the tare is the mean of the residual wrenches after motion of the stage's start has
        # decayed
        if stage.tare and now.t > SETTLED:
            self._residual += self._controller.residual_wrench()
            self._weighed += 1
        # exactly one of: failure by a large force, by `unless`, by the time; or the stage's end
        most = min(stage.largest, self.largest)
        until = stage.until
        assert isinstance(until, End)
        is_alarm = self._alarm is not None and self._alarm(now, dt)
        if force > most:
            self._fail(f"{force:.1f} N, more than {most:g} N")
        elif is_alarm:
            assert isinstance(stage.unless, End)
            self._fail(stage.unless.words)
        elif self._watch(now, dt):
            self._end_stage(until.words, failed=False)
            self._leave(now)
        elif now.t > stage.within:
            self._fail(f"{stage.within:g} s without: {until.words}")

    def _leave(self, now: Sensed) -> None:
        """Tare if the stage does so, store its last pose, and begin the next stage or finish.

        Args:
            now: signals after the last tick of the stage.
        """
        stage = self.stage
        if self._weighed:
            self._controller.f_tare = self._residual / self._weighed
        now.passed[stage.name] = now.X
        following = self._k + 1 if stage.then is None else self._number(stage.then)
        if following == len(self.stages):
            self._finish(Outcome.DONE, "")
        else:
            self._enter(following)

    def _fail(self, why: str) -> None:
        """Continue with the stage that follows a failure, or end the plan.

        Args:
            why: reason for the verdict on the stage.
        """
        stage = self.stage
        self._end_stage(why, failed=True)
        self._failures += 1
        if stage.fails is None:
            self._finish(Outcome.FAILED, f"stage {stage.name!r}: {why}")
        elif self._failures >= self.tries:
            tries = f"{self._failures} tries" if self._failures > 1 else "1 try"
            self._finish(Outcome.FAILED, f"stage {stage.name!r}: {why} ({tries})")
        else:
            self._enter(self._number(stage.fails))

    def _stop(self, reason: str) -> None:
        """Stop the plan because the controller has stopped; further calls change nothing.

        Args:
            reason: reason of the controller.
        """
        if self.outcome is not Outcome.STOPPED:
            self._end_stage(reason, failed=True)
            self._finish(Outcome.STOPPED, f"stage {self.stage.name!r}: {reason}")

    def _end_stage(self, why: str, *, failed: bool) -> None:
        """Complete the verdict on the present stage, and append it to `verdicts`.

        Args:
            why: condition that ended the stage, or why it failed.
            failed: whether it failed.
        """
        verdict = self._verdict
        verdict.duration = self._time - verdict.begin
        verdict.rms = sqrt(self._squares / max(self._ticks, 1))
        verdict.ended_by = why
        verdict.failed = failed
        self.verdicts.append(verdict)

    def _finish(self, outcome: Outcome, reason: str) -> None:
        """End the plan, or stop it; only after its last stage the contact forces remain.

        Args:
            outcome: state of the plan from now on.
            reason: reason for reports; empty if it is done.
        """
        self.outcome = outcome
        self.reason = reason
        self._over_for = 0.0
        if outcome is not Outcome.DONE:
            self._alpha_d, self._active = forces_of({}, self._names, self._owners)
        self._note("plan", outcome=outcome.value, reason=reason)

    def _number(self, name: str) -> int:
        """Index of the stage of a name in `stages`."""
        return [stage.name for stage in self.stages].index(name)

    def _reference(self, now: Sensed) -> Reference:
        """Reference of the next tick; the aim moves as far as contacts and accelerations permit.

        The twist V (6,) of the stage's motion that the contacts permit is approached with limited
        accelerations; the aim, the commanded pose, moves by it in a control period. Where the arms
        are stopped, the aim is the measured pose, at rest.

        Args:
            now: signals after the last tick; `finished` is updated.
        """
        dt = self._controller.dt
        V = np.zeros(6)
        if self.outcome is Outcome.RUNNING:
            demand = self._course(now, dt)
            now.finished = demand.finished
            V, _ = permitted_twist(now.N, demand)
        last = self._V
        self._V = _next_twist(last, V, dt)
        A = (self._V - last) / dt
        rotation = pin.exp3(self._V[3:] * dt) @ self._aim.rotation
        self._aim = pin.SE3(rotation, self._aim.translation + self._V[:3] * dt)
        if self.outcome is Outcome.STOPPED:  # the arms are braked
            self._aim = now.X
            self._V = np.zeros(6)
            A = np.zeros(6)
        return Reference(self._aim, self._V, A, alpha_d=self._alpha_d, active=self._active)

    def _note(self, event: str, **facts: Any) -> None:
        """Log an event of the plan with its facts, if `begin` was given a log."""
        if self._log is not None:
            self._log(event, **facts)


def _next_twist(V: Array, goal: Array, dt: float) -> Array:
    """Twist (6,) one tick later, on the straight way to a goal, with limited acceleration.

    Linear and angular part reach the goal together.

    Args:
        V: (6,) present twist.
        goal: (6,) desired twist (m/s, rad/s).
        dt: control period (s).
    """
    step = goal - V
    most = CHANGES * dt
    ticks = max(
        float(np.linalg.norm(step[:3])) / (most * LINEAR_ACCELERATION),
        float(np.linalg.norm(step[3:])) / (most * ANGULAR_ACCELERATION),
        1.0,
    )
    return V + step / ticks
