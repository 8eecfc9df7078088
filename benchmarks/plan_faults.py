"""Faults in random stages of the plan that inserts a square peg.

    python -m benchmarks.plan_faults [--seed N] [--only TEXT] [--count N]

Every kind of fault of `benchmarks.faults` that can occur with one arm begins in a stage of the plan
that is drawn for it, at a moment of this stage, in an insertion that is drawn, too. If the stage is
over before this moment, the same insertion begins again with a moment that is drawn within the
duration that the stage had. Readings change before speeds are estimated from them. The run goes on
until the plan has ended, for 5 s after the fault and 3 s after a stop at most. Printed is, for each
kind, the stage, the end, and the largest force of a single contact since; the exit code is 1 where

* a torque was not finite, or beyond its limit;
* a joint stayed beyond its speed limit or outside its range for 0.3 s without a stop;
* a single contact pressed with more than the ceiling of 100 N, or three times that where a force
  reads mirrored, and what an obstacle adds until it is seen; after a fault of a motor also with
  more than it did before a ceiling could stop the arm, because the impact of a joint that nothing
  drives is over by then;
* stopped arms whose motors and encoders are sound moved faster than 0.1 rad/s later than 0.5 s
  after the stop;
* mechanical brakes were requested although encoders and motors were sound;
* the run ended in a state that its kind is not to end in, or a stop is without the name of a stage
  in the reason of the plan.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np
import typer
from rich.console import Console

from benchmarks import fault_judge
from benchmarks.faults import FAULTS, Trial
from benchmarks.measuring import without_log
from osc_contact.contacts.insertion import Peg
from osc_contact.control.status import SafetyState
from osc_contact.lab.tasks import pegs
from osc_contact.lab.tasks.insertion import CLEARANCE, PERIOD, WIDTH, Insertion
from osc_contact.plan.plan import Outcome
from osc_contact.spatial import Array

FAULT_FOR = 5.0  #: time from the beginning of a fault that a run goes on (s)
STOPPED_FOR = 3.0  #: time from a stop that a run goes on (s)
LATEST = 1.0  #: largest time from the beginning of a stage to that of a fault (s)
LAST_STAGES = ("back", "return", "done")  #: stages that no fault is drawn for


@dataclass
class Verdict:
    """Findings on a run with a fault.

    Attributes:
        fault: name of the fault.
        seed: seed of the insertion.
        stage: stage in which the fault began; empty: the plan ended before.
        state: state of the controller at the end.
        outcome: outcome of the plan at the end.
        stopped: time from the fault to a stop (s); None: there was none.
        reason: reason of the plan.
        force: largest true force of a single contact since the fault (N).
        unbraked: whether brakes were requested.
        rest_speed: largest speed of a joint later than 0.5 s after a stop (rad/s).
        wrong: sentences; none if all was as it should be. A fault that did not begin is wrong, too:
            it was not tried.
    """

    fault: str
    seed: int
    stage: str = ""
    state: SafetyState = SafetyState.RUN
    outcome: Outcome = Outcome.NEW
    stopped: float | None = None
    reason: str = ""
    force: float = 0.0
    unbraked: bool = False
    rest_speed: float = 0.0
    wrong: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        end = self.outcome.value if self.stopped is None else f"stop after {self.stopped:.2f} s"
        words = "; ".join(self.wrong) or "as it should be"
        return (
            f"{self.fault}, in {self.stage!r} of {self.seed}: {end}, {self.state.name}, "
            f"{self.force:.0f} N, {words} [{self.reason}]"
        )


class Run:
    """Insertion with a fault in one of its stages.

    Attributes:
        verdict: findings so far.
    """

    def __init__(self, name: str, seed: int, rng: np.random.Generator) -> None:
        """Prepare an insertion, and draw stage and moment of the fault.

        Args:
            name: name of the fault.
            seed: seed of the insertion.
            rng: generator of stage, moment and place of the fault.
        """
        self._task = Insertion(Peg("square", WIDTH), CLEARANCE, seed)
        self._fault = FAULTS[name]
        self._rng = rng
        self.verdict = Verdict(name, seed)
        self._prepare()
        stages = [one.name for one in self._plan.stages if one.name not in LAST_STAGES]
        self._stage = stages[int(rng.integers(len(stages)))]
        self._moment = float(rng.uniform(0.0, LATEST))  # from the beginning of the stage (s)

    def _prepare(self) -> None:
        """Put the robot at its start, with plan, controller and sound sensors."""
        self._robot, self._plan, self._controller = pegs.prepared(self._task)
        self._sensors = fault_judge.FaultySensors(self._robot.sensed)
        self._robot.sensed = self._sensors
        self._trial = Trial(self._rng, self._task.model, PERIOD)
        self._joints = fault_judge.JointWatch(self._robot.chain, PERIOD)
        self._began: int | None = None  # tick at which the fault began
        self._stopped: int | None = None  # tick of the stop
        self._before_stops = 0.0  # N, largest force before a ceiling can stop the arm
        self._k = 0

    def judge(self) -> Verdict:
        """Run the insertion, and judge it from the beginning of the fault on."""
        self._plan.begin(self._controller, self._robot.measure())
        while not self._is_over():
            if self._began is None:
                self._redraw()
                self._begin()
            self._tick()
            self._k += 1
        self._judge_end()
        return self.verdict

    def _redraw(self) -> None:
        """Begin again if the stage was shorter than the moment, which is drawn within it."""
        lasted = [one.duration for one in self._plan.verdicts if one.name == self._stage]
        if lasted and self._moment > lasted[0]:
            self._moment = float(self._rng.uniform(0.0, lasted[0] - 2.0 * PERIOD))
            self._prepare()
            self._plan.begin(self._controller, self._robot.measure())

    def _is_over(self) -> bool:
        """Test whether the run can end: it is wrong, or it has lasted after its stop or fault."""
        if self.verdict.wrong:
            return True
        if self._stopped is not None:
            return (self._k - self._stopped) * PERIOD > STOPPED_FOR
        if self._began is not None and (self._k - self._began) * PERIOD > FAULT_FOR:
            return True
        return self._plan.ended

    def _begin(self) -> None:
        """Begin the fault at its moment in its stage."""
        since = self._k * PERIOD - sum(one.duration for one in self._plan.verdicts)
        if self._plan.stage.name == self._stage and since >= self._moment:
            self._began = self._k
            self.verdict.stage = self._stage
            self._robot.largest_single = 0.0

    def _tick(self) -> None:
        """One tick of sensors, plan, controller and motors, with the fault if it lasts."""
        fault = None
        if self._began is not None:
            self._trial.k = self._k - self._began
            fault = self._fault if self._trial.k * PERIOD <= self._fault.lasts else None
        reference = self._plan.step()
        measurement, reference = fault_judge.read(
            self._robot, self._sensors, self._trial, reference, fault
        )
        tau = self._controller.tick(self._plan.placed(measurement), reference)
        sent = fault_judge.disturb(fault, self._trial, tau, self._robot.plant)
        self._robot.command(sent, PERIOD)
        if self._began is not None:
            self._look(tau)

    def _look(self, tau: Array) -> None:
        """Compare torques, joints and forces with their limits after a tick.

        Args:
            tau: (n_a,) commanded torques (N m).
        """
        verdict = self.verdict
        if fault_judge.is_beyond_limits(tau, self._robot.chain.tau_max):
            verdict.wrong.append(f"torques {tau}")
        verdict.force = self._robot.largest_single
        assert self._began is not None
        if (self._k - self._began - 2) * PERIOD <= self._controller.settings.safety.ceiling_time:
            self._before_stops = verdict.force
        verdict.unbraked |= self._controller.unbraked is not None
        true = self._robot.plant.measure()
        motors = self._robot.chain.actuated
        self._joints.look(true.q[motors], np.abs(true.v[motors]))
        if self._controller.state is not SafetyState.SAFE_STOP:
            if self._joints.needs_stop:
                verdict.wrong.append("joints beyond their limits, and no stop")
            return
        if self._stopped is None:
            self._stopped = self._k
            verdict.stopped = (self._k - self._began) * PERIOD
        if (self._k - self._stopped) * PERIOD > fault_judge.REST_AFTER:
            verdict.rest_speed = max(verdict.rest_speed, float(np.abs(true.v).max()))

    def _judge_end(self) -> None:
        """Add what is wrong at the end of a run."""
        verdict, fault = self.verdict, self._fault
        verdict.state = self._controller.state
        verdict.outcome = self._plan.outcome
        verdict.reason = self._plan.reason
        if self._began is None:
            verdict.wrong.append(f"not tried: stage {self._stage!r} was not reached")
            return
        most = pegs.LARGEST * (3.0 if fault.mirrors else 1.0)
        if "tau" in fault.unsound:  # no stop prevents the impact of a joint that nothing drives
            most = max(most, self._before_stops)
        most += fault_judge.obstacle_force(fault, self._trial)
        if fault.limited and not verdict.unbraked and verdict.force > most:
            verdict.wrong.append(f"contact force {verdict.force:.0f} N, at most {most:.0f} N")
        if verdict.state not in fault.ends:
            verdict.wrong.append(f"ended in {verdict.state.name}")
        named = any(f"stage {one.name!r}" in verdict.reason for one in self._plan.stages)
        if verdict.stopped is not None and not named:
            verdict.wrong.append("no stage in the reason of the plan")
        if verdict.unbraked:
            if not fault_judge.may_brake(fault, estimated=True):
                verdict.wrong.append("brakes requested with sound sensors")
        elif (
            verdict.rest_speed > fault_judge.REST_SPEED
            and "tau" not in fault.unsound
            and not fault.pulls
        ):
            verdict.wrong.append(f"{verdict.rest_speed:.2f} rad/s after the stop")


def possible() -> list[str]:
    """Names of the faults that one arm can have, but for "no fault"."""
    return [name for name, fault in FAULTS.items() if fault.arms == 1 and name != "no fault"]


@without_log()
def main(seed: int | None = None, only: str = "", count: int = 0) -> None:
    """Run the faults; exit with 1 if anything was wrong.

    Args:
        seed: seed of insertions, stages and moments; None: drawn and printed.
        only: faults whose name contains this.
        count: number of faults that are drawn from all; 0: all.
    """
    if seed is None:
        seed = int(np.random.default_rng().integers(100_000))
    names = [name for name in possible() if only in name]
    if not names:
        raise typer.BadParameter(f"no fault has {only!r} in its name", param_hint="--only")
    if 0 < count < len(names):
        drawn = np.random.default_rng(seed).choice(len(names), count, replace=False)
        names = [names[i] for i in sorted(drawn.tolist())]
    console = Console(width=180, highlight=False)
    console.print(f"--seed {seed}")
    verdicts: list[Verdict] = []
    for name in names:
        rng = np.random.default_rng([seed, *sha256(name.encode()).digest()])
        verdicts.append(Run(name, seed + len(verdicts), rng).judge())
        console.print(str(verdicts[-1]), soft_wrap=True, markup=False)
    wrong = sum(bool(one.wrong) for one in verdicts)
    stops = [one.stopped for one in verdicts if one.stopped is not None]
    console.print(f"{len(verdicts)} faults, {len(stops)} stops, {wrong} wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    typer.run(main)
