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
)
from osc_contact.plan.permitted import permitted_displacement, permitted_twist
from osc_contact.plan.sensed import Sensed, Senses, forces_of
from osc_contact.plan.stage import Stage, StageVerdict
from osc_contact.recognition.recogniser import Recogniser
from osc_contact.spatial import Array, pose_error

if TYPE_CHECKING:
    from osc_contact.control.controller import Controller

SETTLED = 0.1  #: time at the beginning of a stage that tares, whose readings are left out (s)
RELIEF = 0.5  #: time within which the force that failed a stage goes back in the next one (s)
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


#: States that a plan does not leave.
_FINAL_OUTCOMES = (
    Outcome.DONE,
    Outcome.FAILED,
    Outcome.ABORTED,
)


class Plan:
    """Sequence of stages, in place of the references of `run_loop` or of a `SteppedLoop`.

    The reference follows the object in directions that contacts do not permit, so that contacts can
    be released without a jump. After a failure, an abort and a stop the object is held
    where it is, without contacts; after the last stage its forces remain.

    Args:
        stages: stages in their order.
        largest: measured force of the object on its environment above which a stage has failed (N);
            the stage that follows then has 0.5 s to take it back.
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
        self._stage_index = 0  #: index of the present stage
        #: poses in which stages have placed touched bodies, by name of the contact
        self._places: dict[str, pin.SE3] = {}
        self._failures = 0  #: number of failed stages
        self._time = 0.0  #: time since the plan began (s)
        #: time until which a force that has failed a stage may go back (s)
        self._relieved_until = 0.0
        self._ended_for = 0.0  #: time since the plan ended or was stopped (s)

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
        self._controller = controller  #: controller of the run
        self._names = [pair.name for pair in contacts]  #: names of the contacts
        self._owners = force_owners(contacts)  #: (r,) index of the contact of each column of N
        self._log = log  #: function that logs events; None: none
        self._senses = Senses(controller, X)  #: signals of the ticks
        self._senses.signals.recogniser = self.recogniser
        self._ticks_to_instant = 0  #: ticks until the next instant of the recogniser
        self._aim = X  #: commanded pose of the object
        self._V_D = np.zeros(6)  #: (6,) commanded twist at O (m/s, rad/s)
        self.outcome = Outcome.RUNNING
        self._enter_stage(self._stage_index)

    def step(self) -> Reference:
        """Reference of the next tick, from the controller's results in the last tick.

        Signals and recogniser are updated. While the plan runs, the conditions of the stage are
        judged, and the next stage begins when one is met; a stop of the controller stops the plan.
        """
        dt = self._controller.dt
        signals = self._senses.read()
        self._move_aim_to_object()
        signals.aim = self._aim
        signals.V_D = self._V_D
        self._time += dt
        if self.recogniser is not None:
            self._recognise_state(signals, self.recogniser)
        if self._controller.state is SafetyState.SAFE_STOP and self.outcome not in _FINAL_OUTCOMES:
            self._stop_plan(self._controller.reason)
        if self.outcome is Outcome.RUNNING:
            self._judge_stage(signals)
        if self.outcome is not Outcome.RUNNING:
            self._ended_for += dt
        return self._next_reference(signals)

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
            return self._ended_for > BRAKED
        return self.outcome in _FINAL_OUTCOMES

    @property
    def contacts(self) -> tuple[str, ...]:
        """Names of all contacts of the stages, each once."""
        return tuple(dict.fromkeys(name for stage in self.stages for name in stage.forces))

    @property
    def stage(self) -> Stage:
        """Stage that the plan is in, or was in when it ended."""
        return self.stages[self._stage_index]

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
            self._log_event("plan", outcome=self.outcome.value, reason="")

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
            self._log_event("plan", outcome=self.outcome.value, reason="")
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
        entered = [
            self._stage_number(verdict.name) for verdict in self.verdicts
        ]  # in order of time
        candidates = [k for k in entered if self.stages[k].reentry]
        if not candidates:
            raise InvalidInputError(
                "no stage that was entered may begin again; give one of them reentry=True, or make "
                "a new plan"
            )
        self.outcome = Outcome.RUNNING
        self.reason = ""
        self._ended_for = 0.0
        self._enter_stage(candidates[-1])

    def abort(self, reason: str = "aborted by the user") -> None:
        """End the plan; the object is held where it is, without contacts.

        Args:
            reason: reason for reports.
        """
        if self.outcome not in _FINAL_OUTCOMES:
            self._end_stage(reason, failed=True)
            self._finish_plan(Outcome.ABORTED, reason)

    # --- within a tick --------------------------------------------------------------------------

    def _enter_stage(self, k: int) -> None:
        """Begin stage k at the present pose of the object.

        Takes the stage's forces (N) and active contacts, places its touched bodies, begins its
        motion and its conditions, and opens a verdict on it, with all sums of force errors and tare
        at zero.

        Args:
            k: index of the stage.
        """
        self._stage_index = k
        stage = self.stages[k]
        signals = self._senses.signals
        signals.t = 0.0
        signals.finished = False
        signals.unexpected = ""
        signals.start = signals.X
        signals.aim = self._aim
        #: (r,) desired forces (N), and (contacts,) which contacts are active
        self._alpha_d, self._active = forces_of(stage.forces, self._names, self._owners)
        for name, place in stage.places.items():
            self._places[name] = pin.SE3(place(signals) if callable(place) else place)
        #: demand of the stage's motion by signals and period
        self._course: Course = stage.motion.begin(signals)
        until = stage.until
        assert isinstance(until, End)  # the stage made it one
        self._until_watch: Watch = until.begin(signals)  #: condition that ends the stage
        self._unless_watch: Watch | None = None  #: condition by which the stage fails; None: none
        if isinstance(stage.unless, End):
            self._unless_watch = stage.unless.begin(signals)
        self._squared_force_errors = 0.0  #: sum over the ticks of the stage (N²)
        self._ticks = 0  #: number of ticks of the stage
        self._residual_sum = np.zeros(6)  #: (6,) sum of the residual wrenches of the tare (N, N m)
        self._residual_ticks = 0  #: number of its summands
        self._verdict = StageVerdict(stage.name, self._time)  #: verdict on the present stage
        self._log_event("stage", name=stage.name, number=k)

    def _recognise_state(self, signals: Sensed, recogniser: Recogniser) -> None:
        """Update the contact state once in its period, and note one that is unexpected.

        Args:
            signals: signals after the last tick; `unexpected` is updated.
            recogniser: the plan's.
        """
        if self._ticks_to_instant == 0:
            recogniser.update(signals.X, signals.wrench)
            self._ticks_to_instant = max(1, round(recogniser.period / self._controller.dt))
            assumed = {*self.stage.forces, *self.stage.may_touch}
            before = signals.unexpected
            signals.unexpected = recogniser.unexpected(assumed)
            if signals.unexpected and not before:
                verdict = self._verdict
                verdict.unexpected = verdict.unexpected or signals.unexpected
                self._log_event("unexpected", state=signals.unexpected, stage=self.stage.name)
        self._ticks_to_instant -= 1

    def _move_aim_to_object(self) -> None:
        """Move the aim to the object in the directions that contacts do not permit.

        Of the pose error from object to aim only the part remains that the contacts permit, of its
        angles as much as possible: the rest would act as a jump when a contact is released. Nothing
        moves before the first computed tick and in a held one, where the pose is not new.
        """
        if self._controller.records.memory.ticked and self._controller.status is not Status.HELD:
            X = self._senses.signals.X
            e = permitted_displacement(self._senses.signals.N, pose_error(self._aim, X))
            self._aim = pin.SE3(pin.exp3(e[3:]) @ X.rotation, X.translation + e[:3])

    def _judge_stage(self, signals: Sensed) -> None:
        """Update the verdict by the last tick; end the stage if a condition is met.

        Args:
            signals: signals after the last tick.
        """
        stage = self.stage
        dt = self._controller.dt
        signals.t += dt
        verdict = self._verdict
        force = float(np.linalg.norm(signals.wrench[:3]))
        verdict.peak = max(verdict.peak, force)
        self._ticks += 1
        if self._controller.records.memory.ticked:
            self._squared_force_errors += self._senses.force_error(self._alpha_d)
        # the tare is the mean of the residual wrenches after motion of the stage's start has
        # decayed
        if stage.tare and signals.t > SETTLED:
            self._residual_sum += self._controller.residual_wrench()
            self._residual_ticks += 1
        # a large force is judged first, since it is dangerous, but not while the stage takes back
        # the one that failed the stage before; then the alarm of the stage, its end, and its time,
        # so that a stage that ends in its last tick has not failed
        most = min(stage.largest, self.largest)
        until = stage.until
        assert isinstance(until, End)
        is_alarm = self._unless_watch is not None and self._unless_watch(signals, dt)
        if force <= most:
            self._relieved_until = 0.0
        if force > most and self._time > self._relieved_until:
            self._relieved_until = self._time + RELIEF
            self._fail_stage(f"{force:.1f} N, more than {most:g} N")
        elif is_alarm:
            assert isinstance(stage.unless, End)
            self._fail_stage(stage.unless.words)
        elif self._until_watch(signals, dt):
            self._end_stage(until.words, failed=False)
            self._leave_stage(signals)
        elif signals.t > stage.within:
            self._fail_stage(f"{stage.within:g} s without: {until.words}")

    def _leave_stage(self, signals: Sensed) -> None:
        """Tare if the stage does so, store its last pose, and begin the next stage or finish.

        Args:
            signals: signals after the last tick of the stage.
        """
        stage = self.stage
        if self._residual_ticks:
            self._controller.f_tare = self._residual_sum / self._residual_ticks
        signals.passed[stage.name] = signals.X
        following = self._stage_index + 1 if stage.then is None else self._stage_number(stage.then)
        if following == len(self.stages):
            self._finish_plan(Outcome.DONE, "")
        else:
            self._enter_stage(following)

    def _fail_stage(self, why: str) -> None:
        """Continue with the stage that follows a failure, or end the plan.

        Args:
            why: reason for the verdict on the stage.
        """
        stage = self.stage
        self._end_stage(why, failed=True)
        self._failures += 1
        if stage.fails is None:
            self._finish_plan(Outcome.FAILED, f"stage {stage.name!r}: {why}")
        elif self._failures >= self.tries:
            tries = f"{self._failures} tries" if self._failures > 1 else "1 try"
            self._finish_plan(Outcome.FAILED, f"stage {stage.name!r}: {why} ({tries})")
        else:
            self._enter_stage(self._stage_number(stage.fails))

    def _stop_plan(self, reason: str) -> None:
        """Stop the plan because the controller has stopped; further calls change nothing.

        Args:
            reason: reason of the controller.
        """
        if self.outcome is not Outcome.STOPPED:
            self._end_stage(reason, failed=True)
            self._finish_plan(Outcome.STOPPED, f"stage {self.stage.name!r}: {reason}")

    def _end_stage(self, why: str, *, failed: bool) -> None:
        """Complete the verdict on the present stage, and append it to `verdicts`.

        Args:
            why: condition that ended the stage, or why it failed.
            failed: whether it failed.
        """
        verdict = self._verdict
        verdict.duration = self._time - verdict.begin
        verdict.rms = sqrt(self._squared_force_errors / max(self._ticks, 1))
        verdict.ended_by = why
        verdict.failed = failed
        self.verdicts.append(verdict)

    def _finish_plan(self, outcome: Outcome, reason: str) -> None:
        """End the plan, or stop it; only after its last stage the contact forces remain.

        Args:
            outcome: state of the plan from now on.
            reason: reason for reports; empty if it is done.
        """
        self.outcome = outcome
        self.reason = reason
        self._ended_for = 0.0
        if outcome is not Outcome.DONE:
            self._alpha_d, self._active = forces_of({}, self._names, self._owners)
        self._log_event("plan", outcome=outcome.value, reason=reason)

    def _stage_number(self, name: str) -> int:
        """Index of the stage of a name in `stages`."""
        return [stage.name for stage in self.stages].index(name)

    def _next_reference(self, signals: Sensed) -> Reference:
        """Reference of the next tick; the aim moves as far as contacts and accelerations permit.

        The twist V (6,) of the stage's motion that the contacts permit is approached with limited
        accelerations; the aim, the commanded pose, moves by it in a control period. Where the arms
        are stopped, the aim is the measured pose, at rest.

        Args:
            signals: signals after the last tick; `finished` is updated.
        """
        dt = self._controller.dt
        V = np.zeros(6)
        if self.outcome is Outcome.RUNNING:
            demand = self._course(signals, dt)
            signals.finished = demand.finished
            V, _ = permitted_twist(signals.N, demand)
        last = self._V_D
        self._V_D = _next_twist(last, V, dt)
        A = (self._V_D - last) / dt
        rotation = pin.exp3(self._V_D[3:] * dt) @ self._aim.rotation
        self._aim = pin.SE3(rotation, self._aim.translation + self._V_D[:3] * dt)
        if self.outcome is Outcome.STOPPED:  # the arms are braked
            self._aim = signals.X
            self._V_D = np.zeros(6)
            A = np.zeros(6)
        return Reference(self._aim, self._V_D, A, alpha_d=self._alpha_d, active=self._active)

    def _log_event(self, event: str, **facts: Any) -> None:
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
