"""Faults of sensors, motors, references and the world in closed loop, at random moments.

    python -m benchmarks.fault_injection [--seed N] [--only TEXT] [--count N] [--workers 2]

Every kind of fault (`faults`) begins at a moment drawn from the whole run of every packaged
scenario and from some phases of a run: with no tick lost beside it and with every third one, a
quarter of the kinds with every second and every tenth one, too. Readings change before speeds are
estimated from them. A run goes on for 5 s after the fault, and for 15 s after a stop. Printed is,
for each kind, how the runs ended and the largest contact force; the exit code is 1 where

* a torque was not finite or beyond its limit or its rate;
* a joint stayed beyond its speed limit or outside its range for 0.3 s without a stop;
* the true contact force went beyond three times its command (or 30 N, whichever is more), or the
  command and what the torque that a faulty motor does not give presses on rigid contacts, and what
  the impact presses with which an arm that such a motor moves, or no longer holds, meets a face or
  the side behind it; beside the pushes of the scenario, what an obstacle adds until a force is
  seen, and what a force that reads mirrored gains until its ceiling stops the arms;
* a contact that was commanded and made was open for 0.3 s, and the controller took it as closed;
* stopped arms whose motors are sound moved faster than 0.1 rad/s (m/s) later than 0.5 s after the
  stop, and 0.3 s after each push of the scenario, or 0.1 rad (m) further than braking took; not
  judged of arms whose motors cannot bear the object off the faces, or one that hangs on it alone;
* the mechanical brakes were requested although encoders or speeds were sound, and the motors;
  speeds that are estimated from positions are as sound as these, and a joint that the object has
  left, faster than its readings are believed, has no sound one;
* the run ended in a state that its kind is not to end in.

Brakes are not simulated: what follows the request for them is not judged. Verdicts are kept in
out/fault_injection by the hash of the sources, so that the same command goes on where it was
interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache
from hashlib import sha256
from math import ceil
from typing import Any

import mujoco
import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import linprog

import osc_contact as osc
from benchmarks.fault_judge import (
    REST_AFTER,
    REST_SPEED,
    ContactWatch,
    FaultySensors,
    JointWatch,
    disturb,
    growth_to,
    is_beyond_limits,
    may_brake,
    obstacle_force,
    read,
)
from benchmarks.faults import FAULTS, HOLD, NAN, SAFE_STOP, Fault, Trial
from benchmarks.kept import ROOT, Kept
from benchmarks.measuring import side_by_side
from osc_contact.control.status import Phase, SafetyState
from osc_contact.interface import Reference
from osc_contact.lab.rig.hardware import ObservedRobot
from osc_contact.lab.runs.run import Taring, start
from osc_contact.spatial import Array
from paper.study import table_of

KEPT = ROOT / "out/fault_injection"
UNNOTICED = 0.3  #: s that a contact may be open and taken as closed
FAULT_FOR = 5.0  #: s from the beginning of a fault that a run goes on
STOPPED_FOR = 15.0  #: s from a stop
#: rad or m since the stop, beside what braking from the speed at the stop takes
REST_TRAVEL = 0.1
#: s from the beginning of a push in which it moves a stopped arm: it lasts 0.08 s, and a hold that
#: is critically damped at ω = 20/s leaves (ωt − 1) e^(−ωt) = 4 % of its speed after 0.22 s more
PUSHED_FOR = 0.3
TRUTH_EVERY = 3  #: ticks from one look at true forces to the next: contacts take 10 ms to form
SEEDED = {"ur5_wipe": 3, "two_contact_rod": 3, "panda_edge": 3}  #: moments drawn; others have one

#: s between which a fault begins (None: the scenario's end), and changes of the scenario
PHASES: dict[str, tuple[float, float | None, dict[str, Any]]] = {
    "run": (0.005, None, {}),  # a first tick has nothing to be compared with
    "start": (0.005, 0.005, {}),
    "approach": (0.4, 1.0, {"scenario": "approach_and_slide"}),
    "saturated": (1.9, 2.2, {"scenario": "limited_rod"}),
    "near singular": (1.3, 1.8, {"outward": 0.2205}),  # m; their reach ends at 0.2185 m
    "after a hold": (0.3, 3.0, {"hold": True}),
}


@dataclass(frozen=True)
class Case:
    """A place for faults: a phase of a run, a scenario, which ticks are lost, a seed."""

    phase: str = "run"
    scenario: str = "two_contact_rod"
    every: int = 0
    seed: int = 0

    def __str__(self) -> str:
        lost = f", every {self.every}th tick lost" if self.every else ""
        return f"{self.phase}, {self.scenario}{lost}, seed {self.seed}"

    def rng(self, fault: str) -> np.random.Generator:
        """Generator of the moment of a fault, and of the joint or wrist that it concerns."""
        words = f"{fault} / {self}".encode()
        return np.random.default_rng([*sha256(words).digest()])


@dataclass
class Verdict:
    """Findings on a run with a fault.

    Attributes:
        began: s, the moment of the fault.
        state: state of the controller at the end.
        stopped: s from the fault to a stop.
        force: largest true contact force since (N).
        rate: largest rate of torques (1/s, in torque limits).
        rest_speed: largest later than 0.5 s after a stop.
        travel: beyond the braking distance.
        open_s: longest time that an open contact was taken as closed.
        unbraked: whether brakes were requested.
        wrong: sentences; none if all was as it should be.
        reason: reason of the stop.
    """

    fault: str
    case: Case
    began: float = 0.0
    state: SafetyState = SafetyState.RUN
    stopped: float | None = None
    force: float = 0.0
    rate: float = 0.0
    rest_speed: float = 0.0
    travel: float = 0.0
    open_s: float = 0.0
    unbraked: bool = False
    wrong: list[str] = field(default_factory=list)
    reason: str = ""

    @property
    def key(self) -> tuple[str, Case]:
        """The run that it is of."""
        return self.fault, self.case


# --- One run --------------------------------------------------------------------------------------


class Run:
    """One run, tick by tick: up to the fault, then with it.

    Attributes:
        references: references of the ticks to come.
        true: the plant behind its sensors.
        k: ticks done.
        act: joints with motors.
        fastest: speed limits of these joints.
        first: tick at which the fault begins.
        lost: (n_a,) the most that each motor has not given of its torque (N m, N).
        received: number of the last packet that came; None: it had none.
        estimated: whether speeds are estimated from positions, and end with them.
        diverged: whether the simulation has, which ends the run.
    """

    def __init__(
        self,
        case: Case,
        fault: str = "no fault",
        begin: float | None = None,
        scenario: osc.Scenario | None = None,
    ) -> None:
        """Build the rig of a case, at the start of its task.

        Args:
            case: case of the run.
            fault: name of the fault.
            begin: s, the moment; None: it is drawn.
            scenario: scenario in place of the case's own; None: that.
        """
        earliest, latest, how = PHASES[case.phase]
        self.case = case
        self.hold = "hold" in how
        if scenario is None:
            scenario = _scenario(how.get("scenario", case.scenario), how.get("outward"))
        rig = self.rig = osc.build_rig(scenario)
        self.plant, self.controller = start(rig, case.seed)
        if case.every == 2:  # a share that stops them within a second
            safety = self.controller.settings.safety.replaced(missed_share=np.inf)
            self.controller = self.controller.with_safety(safety)
        self.robot = rig.robot(self.plant, self.controller)
        self._sensors = None
        if isinstance(self.robot, ObservedRobot):
            self._sensors = self.robot.robot = FaultySensors(self.robot.robot)
        untared = rig.scenario.tare is None
        self.tick = (self.controller if untared else Taring(rig, self.controller)).tick
        self.dt = self.controller.dt
        self.references = rig.references.each(sys.maxsize, self.dt)
        self.true: Any = self.plant
        while hasattr(self.true, "plant"):
            self.true = self.true.plant
        self.act = np.array(rig.model.actuated)
        self.fastest = rig.model.model.velocityLimit[self.act]
        self.limit = rig.model.tau_max
        ticked = self.controller.records.memory.ticked
        self.before = self.controller.last_torques() if ticked else None
        self.lost = np.zeros(len(self.act))
        self.received: int | None = None
        self.estimated = self.diverged = False
        rng = case.rng(fault)
        moment = rng.uniform(earliest, scenario.duration if latest is None else latest)
        self.trial = Trial(rng, rig.model, self.dt)
        self.first = round((moment if begin is None else begin) / self.dt)
        self.k = 0

    def step(self, verdict: Verdict, fault: Fault | None = None) -> Reference:
        """One tick; returns its reference.

        Args:
            verdict: takes what is wrong.
            fault: fault that lasts now, or None.
        """
        k = self.k
        case = self.case
        trial = self.trial
        trial.k = k - self.first
        reference = next(self.references)
        measurement, reference = read(self.robot, self._sensors, trial, reference, fault)
        self.estimated = measurement.estimated
        if self.hold and 8 < self.first - k <= 16:
            measurement = replace(measurement, wrenches=np.full_like(measurement.wrenches, NAN))
        if case.every and k % case.every == case.every - 1 and self.controller.engaged:
            m = measurement  # no packet came: neither its readings nor its number
            measurement = replace(m, q=m.q * NAN, v=m.v * NAN, wrenches=m.wrenches * NAN)
            measurement = replace(measurement, sequence=self.received)
        self.received = measurement.sequence
        tau = self.tick(measurement, reference)
        if is_beyond_limits(tau, self.limit):
            verdict.wrong.append(f"tick {k}: torques {tau}")
        if self.before is not None:
            change = float((np.abs(tau - self.before) / self.limit).max() / self.dt)
            verdict.rate = max(verdict.rate, change)
        self.before = tau
        sent = disturb(fault, trial, tau, self.true)
        self.lost = np.maximum(self.lost, np.abs(tau - sent))
        try:
            self.robot.command(sent, self.dt)
        except osc.PlantError as error:
            self.diverged = True
            if not verdict.unbraked:  # else the brakes, which are not simulated, hold the arms
                verdict.wrong.append(f"tick {k}: {error}"[:90])
        self.k += 1
        return reference

    def judge(
        self, name: str, fault_for: float = FAULT_FOR, stopped_for: float = STOPPED_FOR
    ) -> Verdict:
        """The run with the fault, from where it begins.

        Args:
            name: name of the fault.
            fault_for, stopped_for: s that the run goes on after the fault and after a stop.
        """
        fault = FAULTS[name]
        verdict = Verdict(name, self.case, began=self.first * self.dt)
        last = self.first + round(min(fault.lasts, 1e6) / self.dt)
        end = self.first + round(fault_for / self.dt)
        watch = Watch(self, verdict, fault.hangs)
        response = contact_response(self)
        while self.k < end and not (verdict.wrong or self.diverged):
            stopped = verdict.stopped
            reference = self.step(verdict, fault if self.k <= last else None)
            watch.look(reference)
            if verdict.stopped is not None and stopped is None:
                end = max(end, self.k + round(stopped_for / self.dt))
        watch.contacts.evaluate()
        verdict.force, verdict.open_s = watch.contacts.force, watch.contacts.open_s
        verdict.state = self.controller.state
        verdict.reason = verdict.reason or self.controller.reason
        pushes = self.rig.scenario.plant.pushes
        lost = np.abs(response) @ self.lost
        if "tau" in fault.unsound:
            lost = lost + watch.contacts.impacts
        most = max(watch.highest + float(lost.max(initial=0.0)), 3.0 * watch.highest)
        most += sum(float(np.linalg.norm(push.force)) for push in pushes)
        most += obstacle_force(fault, self.trial)
        if fault.mirrors:
            most = self._grown(most, watch.highest)
        if fault.grows:  # for the time above the ceiling as in the same time before
            looks = ceil(self._above_ceiling() / (TRUTH_EVERY * self.dt))
            most += growth_to(most, watch.contacts.forces, looks)
        self._judge_end(verdict, fault, most, fault.hangs and watch.too_fast)
        return verdict

    def _grown(self, force: float, commanded: float) -> float:
        """The force (N) to which one that reads mirrored grows before the ceiling stops the arms.

        The integral of the force loop then drives it away: with ḟ = K_I (f + f_d) it is
        (f + f_d) exp(K_I T) − f_d after the time T of `_above_ceiling`.

        Args:
            force: N, the ceiling.
            commanded: N.
        """
        growth = float(np.exp(self.controller.gains.force.integral * self._above_ceiling()))
        return (force + commanded) * growth - commanded

    def _above_ceiling(self) -> float:
        """Longest time that a force is above its ceiling until torques fall (s).

        It is `ceiling_time` and two ticks, and a lost one if ticks are lost.
        """
        ticks = 3 if self.case.every else 2
        return float(self.controller.settings.safety.ceiling_time + ticks * self.dt)

    def _judge_end(self, verdict: Verdict, fault: Fault, most: float, too_fast: bool) -> None:
        """Add what is wrong.

        Args:
            verdict: verdict on the run, changed.
            fault: fault of the run.
            most: N, limit of the contact force.
            too_fast: whether a joint that the object has left was too fast for its readings.
        """
        wrong = verdict.wrong
        if fault.limited and verdict.force > most:
            wrong.append(f"contact force {verdict.force:.1f} N, at most {most:.1f} N are allowed")
        if verdict.rate > self.controller.settings.safety.torque_rate * (1 + 1e-6):
            wrong.append(f"torque rate {verdict.rate:.0f} 1/s")
        if verdict.open_s > UNNOTICED:
            wrong.append(f"a contact was open for {verdict.open_s:.2f} s and taken as closed")
        ends = fault.ends
        if self.case.every:  # the last tick may be a lost one
            ends += (HOLD,) if verdict.fault == "no fault" else (HOLD, SAFE_STOP)
        if verdict.state not in ends:
            wrong.append(f"ended in {verdict.state.name}: {verdict.reason[:60]}")
        if verdict.unbraked:
            if not (may_brake(fault, self.estimated) or too_fast):
                wrong.append(f"brakes requested with sound sensors: {verdict.reason[:60]}")
            return
        if "tau" in fault.unsound:  # without its torque, gravity or a spring moves the joint
            return
        if verdict.rest_speed > REST_SPEED:
            wrong.append(f"{verdict.rest_speed:.2f} rad/s (m/s) later than {REST_AFTER:g} s")
        if verdict.travel > REST_TRAVEL and not fault.pulls:
            wrong.append(f"moved by {verdict.travel:.2f} rad (m) since the stop")


class Watch:
    """Looks at the true robot from the beginning of a fault on.

    Attributes:
        highest: N, the largest force commanded, 10 at least.
        contacts: true contacts, judged together.
        too_fast: whether a joint was faster than its readings are believed.
    """

    def __init__(self, run: Run, verdict: Verdict, hangs: bool) -> None:
        self._run = run
        self._verdict = verdict
        bear_all = np.full(len(run.act), least_load(run.rig) <= 1.0)
        self._bears = _bearing(run) if hangs else bear_all
        self._stop_q = self._braking = np.zeros(0)
        self._stop_k = 0
        self._joints = JointWatch(run.rig.model, run.dt)
        self.contacts = ContactWatch(run.rig, run.plant, TRUTH_EVERY * run.dt)
        self.highest = 10.0
        self.too_fast = False

    def look(self, reference: Reference) -> None:
        """After a tick.

        Args:
            reference: reference of the tick.
        """
        run = self._run
        verdict = self._verdict
        control = run.controller
        true = run.true.measure()
        self.highest = max(self.highest, *map(abs, reference.alpha_d), 0.0)
        stopped = control.state is SAFE_STOP
        self._look_at_joints(true.q[run.act], np.abs(true.v[run.act]), stopped)
        verdict.unbraked |= control.unbraked is not None
        if run.k % TRUTH_EVERY == 0 and not verdict.unbraked:  # else the driver's brakes hold it
            is_believed = not stopped and control.engaged and control.faults == 0
            taken = is_believed & (np.asarray(control.phases()) == Phase.CLOSED)
            self.contacts.look(np.abs(reference.alpha_d), taken)

    def _look_at_joints(self, q: np.ndarray, speeds: np.ndarray, stopped: bool) -> None:
        run = self._run
        verdict = self._verdict
        if stopped and verdict.stopped is None:
            verdict.stopped = (run.k - 1 - run.first) * run.dt
            self._stop_k = run.k
            self._stop_q = q
            verdict.reason = run.controller.reason
            self._braking = speeds * run.controller.records.model.reaction
        if verdict.stopped is not None:
            travel = (np.abs(q - self._stop_q) - self._braking)[self._bears]
            verdict.travel = max(verdict.travel, float(travel.max(initial=0.0)))
            if (run.k - self._stop_k) * run.dt > REST_AFTER and not _is_pushed(run):
                fastest = float(speeds[self._bears].max(initial=0.0))
                verdict.rest_speed = max(verdict.rest_speed, fastest)
        self._joints.look(q, speeds)
        believed = run.controller.settings.safety.plausible_speed * run.fastest
        self.too_fast |= bool((speeds > believed).any())
        if not stopped and self._joints.needs_stop:
            verdict.wrong.append(f"tick {run.k - 1}: joints beyond their limits and no stop")


def _bearing(run: Run) -> NDArray[np.bool_]:
    """(n_a,) joints of arms whose motors bear all that hangs on the arm; of the first, the object.

    Others sink until something stops them, whatever is commanded.
    """
    plant = run.true
    at_rest = copy(plant.data)
    at_rest.qvel[:] = 0.0
    mujoco.mj_fwdPosition(plant.model, at_rest)
    mujoco.mj_fwdVelocity(plant.model, at_rest)
    names = [run.rig.model.joint_names[i] for i in run.act]
    weights = np.abs([at_rest.qfrc_bias[plant.model.joint(name).dofadr[0]] for name in names])
    arms = [name.split("/")[0] for name in names]
    overloaded = {arm for arm, w, most in zip(arms, weights, run.limit, strict=True) if w > most}
    return np.array([arm not in overloaded for arm in arms])


def least_load(rig: osc.Rig) -> float:
    """Least share x of the motors' limits that bears arms and object without contacts.

    The smallest x with |τ| ≤ x τ_max and G τ = Sᵀp, at rest in the start pose. Above 1 the arms
    sink until something stops them, whatever is commanded.
    """
    state = rig.state
    weight = state.S.T @ state.p
    limits = rig.model.tau_max
    n_a = len(limits)
    at_most = np.vstack([np.eye(n_a), -np.eye(n_a)])
    found = linprog(
        np.eye(n_a + 1)[-1],
        A_ub=np.column_stack([at_most, -np.concatenate([limits, limits])]),
        b_ub=np.zeros(2 * n_a),
        A_eq=np.column_stack([state.G, np.zeros(len(weight))]),
        b_eq=weight,
        bounds=[(None, None)] * (n_a + 1),
    )
    return float(found.x[-1])


def contact_response(run: Run) -> Array:
    """(r, n_a) change of contact forces with motor torques (N/(N m), N/N), of rigid contacts.

    They keep Nᵀa: with Sᵀ(Λ a + N α) = G τ and a = S η̇ it is (NᵀΦ₀N)⁻¹ NᵀS Λ_S⁻¹ G. Of the start
    pose where no contact is in N.
    """
    if not run.rig.pairs:
        return np.zeros((0, len(run.act)))
    signals = run.controller.signals if run.controller.engaged else None
    if signals is not None and signals.rank:
        state, N = signals.state, signals.contact.N
    else:
        state, N = run.rig.state, run.rig.contact.N
    accelerations = N.T @ state.S @ np.linalg.solve(state.Lambda_S, state.G)
    return np.asarray(np.linalg.pinv(N.T @ state.Phi @ N) @ accelerations)


def _is_pushed(run: Run) -> bool:
    """Test whether a push of the scenario acts on an arm, or began less than `PUSHED_FOR` ago."""
    now = run.k * run.dt
    since = [
        (now - push.start) % push.every if push.every > 0.0 else now - push.start
        for push in run.rig.scenario.plant.pushes
        if now >= push.start
    ]
    return min(since, default=np.inf) < PUSHED_FOR


def _scenario(name: str, outward: float | None) -> osc.Scenario:
    """Load a packaged scenario, or make one of it in which arms reach the edge of their workspace.

    Args:
        name: name of the packaged scenario.
        outward: distance (m) of a motion without contacts, to that edge; None: as packaged.
    """
    scenario = osc.load_scenario(name)
    if outward is None:
        return scenario
    away = {"type": "minimum_jerk", "value": outward, "start": 0.1, "duration": 1.6}
    motion = {"kind": "linear", "direction": [0, 1, 0], "signals": [away]}
    safety = {"overspeed_time": 0.1}  # joints pass their speed limits there
    control = scenario.control.model_dump() | {"safety": safety}
    return scenario.replaced(
        contacts=[], force={}, environment=[], motion=[motion], control=control
    )


def try_fault(name: str, case: Case, begin: float | None = None, **how: float) -> Verdict:
    """Run the scenario of a case up to the fault, then with it; judge it.

    Args:
        name: name of the fault.
        case: case of the run.
        begin: s, its moment; None: it is drawn.
        how: durations of `Run.judge`.
    """
    run = Run(case, name, begin)
    seen = Verdict("no fault", case)
    while run.k < run.first and not seen.wrong:
        run.step(seen)
    if seen.wrong:
        return replace(seen, fault=name)
    return run.judge(name, **how)


# --- All of them ----------------------------------------------------------------------------------


def runs(seed: int) -> list[tuple[str, Case]]:
    """Every fault in every packaged scenario and phase in which it can occur.

    Args:
        seed: of moments, and of the quarter of the kinds that is tried with more lost ticks.
    """
    rng = np.random.default_rng(seed)
    names = list(FAULTS)
    more = set(rng.choice(names, len(names) // 4, replace=False).tolist())
    found = []
    for name, fault in FAULTS.items():
        for every in (0, 2, 3, 10) if name in more else (0, 3):
            for case in _places(seed, every):
                if _can_occur(fault, case):
                    found.append((name, case))
    return found


def _places(seed: int, every: int) -> Iterator[Case]:
    for phase in PHASES:
        if phase != "run":
            yield Case(phase, every=every, seed=seed)
    for scenario in _scenarios():
        for more in range(SEEDED.get(scenario, 1)):
            yield Case("run", scenario, every, seed + more)


@cache
def _scenarios() -> tuple[str, ...]:
    """Names of the packaged scenarios, whose files are read once."""
    return tuple(osc.list_scenarios())


def _can_occur(fault: Fault, case: Case) -> bool:
    """Test whether the scenario of a case has the arms, and a world, that a fault changes."""
    plant, arms = _plant_and_arms(PHASES[case.phase][2].get("scenario", case.scenario))
    return (fault.world is None or plant == "mujoco") and arms >= fault.arms


@cache
def _plant_and_arms(name: str) -> tuple[str, int]:
    """Type of the plant of a packaged scenario, and the number of its arms."""
    scenario = osc.load_scenario(name)
    return scenario.plant.type, len(scenario.arms)


def read_verdict(row: dict[str, Any]) -> Verdict:
    """A verdict from the fields that it was kept with."""
    case = Case(**row.pop("case"))
    return Verdict(**{**row, "case": case, "state": SafetyState(row["state"])})


def table(verdicts: Sequence[Verdict]) -> Table:
    """One line for each kind."""
    rows = []
    for name in FAULTS:
        mine = [v for v in verdicts if v.fault == name]
        if not mine:
            continue
        forces = [v.force for v in mine]
        states = (sum(v.state is state for v in mine) for state in SafetyState)
        wrong = sum(bool(v.wrong) for v in mine)
        rows.append((name, len(mine), *states, f"{max(forces):.1f}", wrong))
    return table_of("", "fault; runs; RUN; DEGRADED; HOLD; SAFE_STOP; force (N); wrong", rows)


def main(only: str = "", seed: int | None = None, count: int = 0, workers: int = 2) -> None:
    """Run them all; exit with 1 if anything was wrong.

    Args:
        only: runs whose name contains this.
        seed: seed of the moments; None: drawn and printed.
        count: number of runs drawn from all; 0: all.
        workers: processes.
    """
    if seed is None:
        seed = int(np.random.default_rng().integers(1 << 31))
    print(f"--seed {seed}", flush=True)
    wanted = [run for run in runs(seed) if only in "{} / {}".format(*run)]
    if not wanted:
        raise typer.BadParameter(f"no run has {only!r} in its name")
    if 0 < count < len(wanted):
        drawn = np.random.default_rng(seed).choice(len(wanted), count, replace=False)
        wanted = [wanted[i] for i in sorted(drawn)]
    kept = Kept(KEPT, read_verdict)
    verdicts = [kept.found[run] for run in wanted if run in kept.found]
    missing = [run for run in wanted if run not in kept.found]
    for verdict in side_by_side(try_fault, missing, workers):
        kept.add(verdict)
        verdicts.append(verdict)
    for verdict in verdicts:
        if verdict.wrong:
            print(
                f"{verdict.fault} / {verdict.case}, at {verdict.began:.3f} s: "
                f"{'; '.join(verdict.wrong)}"
            )
    Console(width=200).print(table(verdicts))
    wrong = sum(bool(v.wrong) for v in verdicts)
    print(f"{len(verdicts)} runs, {wrong} of them wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    typer.run(main)
