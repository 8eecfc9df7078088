"""Faults of sensors, actuators and references in closed loop: what the controller makes of them.

    python benchmarks/fault_injection.py [--only "/ contact, ur5_wipe"] [--seeds 1] [--workers 2]

Every kind of fault is tried in every phase of a run and in every packaged scenario, with no tick
lost beside it and with every 2nd, 3rd and 10th one.
Printed is, for each kind, how the runs ended and the largest contact force; the exit code is 1 if
a torque was not finite or beyond its limit or its rate, if a joint stayed beyond its speed limit or
outside its range for 0.3 s without a stop, if the true contact force went beyond three times its
command (or 30 N, whichever is more), and the pushes of the scenario, where a sensor was faulty, if
arms that were stopped are not at rest 0.5 s later, or if a state is not one that the kind is to end
in. Arms with `Controller.unbraked` are left to the brakes of the driver, which are not simulated.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import typer
from rich.console import Console
from rich.table import Table

import osc_contact as osc
from benchmarks.measuring import side_by_side
from osc_contact.control.status import SafetyState
from osc_contact.interface import Measurement, Reference, Stamps
from osc_contact.runs.run import Taring, start
from paper.study import table_of

RUN, DEGRADED, HOLD, SAFE_STOP = SafetyState
STOP_WITHIN = 0.3  #: s
FAULT_FOR = 0.6  #: s that a lasting fault is looked at
REST_AFTER = 0.5  #: s after a stop, when the arms are at rest
#: rad/s or m/s; rad or m since the stop, beside what braking from the speed at the stop takes
REST_SPEED = 0.1
REST_TRAVEL = 0.1
TRUTH_EVERY = 3  #: ticks from one look at true forces to the next: contacts take 10 ms to form
LOSSES = (0, 2, 3, 10)  #: every so many-th tick is lost; 0: none
NAN = float("nan")

Change = Callable[["Trial", Measurement, Reference], tuple[Measurement, Reference]]


class Fault(NamedTuple):
    """One kind of fault.

    Attributes:
        change: what becomes of a measurement and a reference while it lasts; or None.
        lasts: s; inf: to the end. ends: states that a run may end in.
        lies: whether a sensor is faulty, so that contact forces are judged.
        torque: what becomes of the torques on their way to the motors; or None.
    """

    change: Change | None = None
    lasts: float = np.inf
    ends: tuple[SafetyState, ...] = (RUN, DEGRADED, HOLD, SAFE_STOP)
    lies: bool = True
    torque: Callable[[Trial, np.ndarray], np.ndarray] | None = None


@dataclass
class Trial:
    """One run with a fault in it.

    Attributes:
        kept: what the fault remembers. rng: its own. k: ticks since it began.
    """

    rng: np.random.Generator
    chain: osc.ClosedChain
    k: int = 0
    kept: dict[str, Any] = field(default_factory=dict)

    def first(self, name: str, value: Any) -> Any:
        """The value when the fault began."""
        return self.kept.setdefault(name, value)

    def pick(self, n: int) -> int:
        """One of n, the same all the time."""
        return int(self.first(f"pick{n}", self.rng.integers(n)))


# --- what goes wrong ------------------------------------------------------------------------------


def _all(t: Trial, x: np.ndarray) -> Any:
    return ...


def _one(t: Trial, x: np.ndarray) -> Any:
    """One number, the same all the time."""
    return np.unravel_index(t.pick(x.size), x.shape)


def _row(t: Trial, x: np.ndarray) -> Any:
    """The wrist of one arm."""
    return t.pick(len(x))


def _motor(t: Trial, x: np.ndarray) -> Any:
    """The joint of one motor, the same all the time."""
    joints = t.chain.actuated
    return joints[t.pick(len(joints))]


def _reading(
    name: str,
    where: Callable[[Trial, np.ndarray], Any] = _all,
    gain: float = 1.0,
    offset: float = 0.0,
    drift: float = 0.0,
    noise: float = 0.0,
    stuck: bool = False,
) -> Change:
    """Numbers of an array of the measurement become others.

    Args:
        name: of the array. where: index of the numbers. gain, offset, drift (in each tick), noise,
            stuck: what becomes of them.
    """

    def change(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
        x = np.array(getattr(m, name))
        i = where(t, x)
        if stuck:
            x[i] = t.first(name, x[i].copy())
        else:
            x[i] = gain * x[i] + offset + drift * t.k + noise * t.rng.normal(size=x[i].shape)
        changes: dict[str, Any] = {name: x}
        return replace(m, **changes), r

    return change


def _packet(make: Callable[[Trial, Measurement], Measurement]) -> Change:
    return lambda t, m, r: (make(t, m), r)


def _goal(name: str, make: Callable[[Any], Any]) -> Change:
    return lambda t, m, r: (m, replace(r, **{name: make(getattr(r, name))}))


def _turned(scale: Any) -> Change:
    """A goal whose rotation, with its columns scaled, is another matrix."""

    def bad(X: pin.SE3) -> pin.SE3:
        bad = X.copy()
        bad.rotation = X.rotation * scale
        return bad

    return _goal("X_WD", bad)


def _weaken(share: float) -> Callable[[Trial, np.ndarray], np.ndarray]:
    """One motor gives a share of its command."""

    def make(t: Trial, tau: np.ndarray) -> np.ndarray:
        tau[t.pick(len(tau))] *= share
        return tau

    return make


def _delay(t: Trial, tau: np.ndarray) -> np.ndarray:
    before = t.kept.get("last", tau)
    t.kept["last"] = tau
    return before


_angles, _speeds, _wrists = (partial(_reading, name) for name in ("q", "v", "wrenches"))
_STOPS = (SAFE_STOP,)
_ON = (RUN, DEGRADED)
_TICK = 1e-9  #: of a fault that lasts one tick
_NO_WRENCH = _packet(lambda t, m: replace(m, wrenches=NAN * m.wrenches, wrench_valid=False))
_JUMP = np.array([0.05, 0.0, 0.0])

FAULTS: dict[str, Fault] = {
    "no fault": Fault(None, 0.0, _ON),
    # encoders
    "encoder NaN once": Fault(_angles(_one, NAN), _TICK, _ON),
    "encoder NaN for ever": Fault(_angles(_one, NAN), ends=_STOPS),
    "encoders NaN, 15 ticks": Fault(_angles(gain=NAN), 0.014, _ON),
    "encoder spike of 1 rad, one tick": Fault(_angles(_motor, offset=1.0), _TICK, _ON),
    "encoder jumps by 1 rad": Fault(_angles(_motor, offset=1.0), ends=_STOPS),
    "encoder 1e200": Fault(_angles(_motor, 0.0, 1e200), ends=_STOPS),
    "encoder stuck": Fault(_angles(_motor, stuck=True)),
    "encoders stuck, speeds too": Fault(
        _packet(lambda t, m: replace(m, q=t.first("q", m.q), v=t.first("v", m.v))), ends=_STOPS
    ),
    "encoders stuck, speeds zero": Fault(
        _packet(lambda t, m: replace(m, q=t.first("q", m.q), v=0.0 * m.v))
    ),
    "encoder mirrored": Fault(_angles(_motor, -1.0)),
    "encoder drifts by 0.2 rad/s": Fault(_angles(_motor, drift=2e-4)),
    "encoder noise of 5 mrad": Fault(_angles(noise=5e-3)),
    # speeds
    "speed NaN once": Fault(_speeds(_one, NAN), _TICK, _ON),
    "speed inf for ever": Fault(_speeds(_one, offset=np.inf), ends=_STOPS),
    "speed spike, one tick": Fault(_speeds(_motor, 0.0, 100.0), _TICK, _ON),
    "speeds zero": Fault(_speeds(gain=0.0)),
    "speeds mirrored": Fault(_speeds(gain=-1.0)),
    "speed noise of 0.05 rad/s": Fault(_speeds(noise=0.05)),
    # wrists
    "wrench NaN once": Fault(_wrists(_one, NAN), _TICK, _ON),
    "wrench NaN, 19 ticks": Fault(_wrists(_one, NAN), 0.018, _ON),
    "wrench NaN for ever": Fault(_wrists(_one, NAN), ends=_STOPS),
    "wrench 100 kN once": Fault(_wrists(_one, 0.0, 1e5), _TICK, _ON),
    "wrench 900 N once": Fault(_wrists(_one, 0.0, 900.0), _TICK, _ON),
    "wrench 100 kN for ever": Fault(_wrists(_one, 0.0, 1e5), ends=_STOPS),
    "wrists read zero": Fault(_wrists(gain=0.0)),
    "one wrist reads zero": Fault(_wrists(_row, 0.0)),
    "one wrist stuck": Fault(_wrists(_row, stuck=True)),
    "wrists mirrored": Fault(_wrists(gain=-1.0)),
    "one wrist mirrored": Fault(_wrists(_row, -1.0)),
    "wrist offset of 20 N": Fault(_wrists(_one, offset=20.0)),
    "wrists times 0.3": Fault(_wrists(gain=0.3)),
    "wrist noise of 5 N": Fault(_wrists(noise=5.0)),
    "no wrench for 15 ticks": Fault(_NO_WRENCH, 0.014, _ON),
    "no wrench for ever": Fault(_NO_WRENCH, ends=_STOPS),
    # packets
    "packet repeats for ever": Fault(_packet(lambda t, m: t.first("packet", m)), ends=_STOPS),
    "same sequence number": Fault(_packet(lambda t, m: replace(m, sequence=7)), ends=_STOPS),
    "packets out of order": Fault(
        _packet(lambda t, m: replace(m, sequence=t.k + (3 if t.k % 2 else -3))), 0.2
    ),
    "clock stands still": Fault(
        _packet(lambda t, m: replace(m, stamps=Stamps(1.0, 1.0, 1.0, 1.0))), ends=_STOPS
    ),
    # references
    "X_WD no rotation": Fault(_turned(1.5), ends=_STOPS),
    "X_WD mirrored": Fault(_turned([1.0, 1.0, -1.0]), ends=_STOPS),
    "reference NaN once": Fault(_goal("V_D", lambda V: V * NAN), _TICK, _ON),
    "reference jumps by 5 cm": Fault(
        _goal("X_WD", lambda X: pin.SE3(X.rotation, X.translation + _JUMP)), lies=False
    ),
    "reference accelerates by 50 m/s²": Fault(
        _goal("A_D", lambda A: A + [50.0, 0, 0, 0, 0, 0]), 0.1, lies=False
    ),
    # motors
    "a motor is dead": Fault(lies=False, torque=_weaken(0.0)),
    "a motor is weak": Fault(lies=False, torque=_weaken(0.7)),
    "torques are late by a tick": Fault(lies=False, torque=_delay),
}

#: s at which the fault begins, and what of the scenario is changed
PHASES: dict[str, tuple[float, dict[str, Any]]] = {
    "start": (0.005, {}),  # a first tick has nothing to be compared with
    "approach": (0.6, {"scenario": "approach_and_slide"}),  # from 0.4 s on
    "contact": (0.8, {}),
    "saturated": (2.05, {"scenario": "limited_rod"}),
    "near singular": (1.5, {"outward": 0.2205}),  # m; their reach ends at 0.2185 m
    "after a hold": (0.5, {"hold": True}),
}


# --- one run --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Where faults are put: a phase of a run, a scenario, which ticks are lost, a seed."""

    phase: str = "contact"
    scenario: str = "two_contact_rod"
    every: int = 0
    seed: int = 0

    @property
    def begin(self) -> float:
        """When the fault begins (s): another moment for each seed."""
        return PHASES[self.phase][0] + 0.003 * self.seed

    def __str__(self) -> str:
        lost = f", every {self.every}th tick lost" if self.every else ""
        return f"{self.phase}, {self.scenario}{lost}"


@dataclass
class Verdict:
    """What a run showed. `wrong`: sentences; none if all was as it should be."""

    fault: str
    case: Case
    state: SafetyState = RUN
    stopped: float | None = None
    force: float = 0.0
    rate: float = 0.0
    rest_speed: float = 0.0
    travel: float = 0.0
    unbraked: bool = False
    wrong: list[str] = field(default_factory=list)
    reason: str = ""


class Run:
    """One run, tick by tick: up to the fault, then with it.

    Attributes:
        references: of the ticks to come. true: the plant behind its sensors. k: ticks done.
        act: joints with motors; fastest: their speed limits. first: tick at which the fault begins.
    """

    def __init__(self, case: Case, scenario: osc.Scenario | None = None) -> None:
        """Build the rig of a case, at the start of its task; `scenario`: in place of its own."""
        how = PHASES[case.phase][1]
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
        ticked = self.controller._records.memory.ticked
        self.before = self.controller.last_torques() if ticked else None
        self.first = round(case.begin / self.dt)
        self.k = 0

    def step(
        self, verdict: Verdict, trial: Trial | None = None, fault: Fault = FAULTS["no fault"]
    ) -> Reference:
        """One tick; what was desired in it.

        Args:
            verdict: what is seen and wrong is noted there. trial: of a fault that lasts now.
        """
        k = self.k
        case = self.case
        reference = next(self.references)
        measurement = self.robot.measure()
        if self.hold and 8 < self.first - k <= 16:
            measurement = replace(measurement, wrenches=np.full_like(measurement.wrenches, NAN))
        if trial is not None:
            trial.k = k - self.first
            if fault.change is not None:
                measurement, reference = fault.change(trial, measurement, reference)
        if case.every and k % case.every == case.every - 1 and self.controller.engaged:
            m = measurement  # no packet came
            measurement = replace(m, q=m.q * NAN, v=m.v * NAN, wrenches=m.wrenches * NAN)
        tau = self.tick(measurement, reference)
        if not np.isfinite(tau).all() or (np.abs(tau) > self.limit * (1 + 1e-9)).any():
            verdict.wrong.append(f"tick {k}: torques {tau}")
        if self.before is not None:
            change = float((np.abs(tau - self.before) / self.limit).max() / self.dt)
            verdict.rate = max(verdict.rate, change)
        self.before = tau
        sent = tau
        if fault.torque is not None and trial is not None:
            sent = fault.torque(trial, tau.copy())
        try:
            self.robot.command(sent, self.dt)
        except osc.PlantError as error:
            verdict.wrong.append(f"tick {k}: {error}"[:90])
        self.k += 1
        return reference

    def judge(self, name: str) -> Verdict:
        """The run with the fault, from where it begins."""
        fault = FAULTS[name]
        case = self.case
        act = self.act
        verdict = Verdict(name, case)
        trial = Trial(np.random.default_rng([case.seed, len(name)]), self.rig.model)
        last = round(min(case.begin + fault.lasts, 1e6) / self.dt)
        model = self.rig.model.model
        beyond = outside = 0
        highest = 10.0
        end = self.first + round(FAULT_FOR / self.dt)
        stop_q = braking = np.zeros(0)
        while self.k < end and not verdict.wrong:
            k = self.k
            reference = self.step(verdict, trial if k <= last else None, fault)
            control = self.controller
            true = self.true.measure()
            q = true.q[act]
            speeds = np.abs(true.v[act])
            stopped = control.state is SAFE_STOP
            if stopped and verdict.stopped is None:
                verdict.stopped = (k - self.first) * self.dt
                stop_q = q
                verdict.reason = control.reason
                braking = speeds * control._records.model.reaction
                end = max(end, k + round(REST_AFTER / self.dt))
            verdict.unbraked |= control.unbraked is not None
            verdict.rest_speed = float(speeds.max())
            if verdict.stopped is not None:
                verdict.travel = float((np.abs(q - stop_q) - braking).max())
            beyond = beyond + 1 if (speeds > self.fastest).any() else 0
            inside = (q >= model.lowerPositionLimit[act]) & (q <= model.upperPositionLimit[act])
            outside = 0 if inside.all() else outside + 1
            highest = max(highest, *map(abs, reference.alpha_d), 0.0)
            if k % TRUTH_EVERY == 0 and not verdict.unbraked:  # else the driver's brakes hold it
                verdict.force = max(verdict.force, *np.abs(self.plant.truth().alpha).tolist(), 0.0)
            if not stopped and max(beyond, outside) * self.dt > STOP_WITHIN:
                verdict.wrong.append(f"tick {k}: joints beyond their limits and no stop")
        verdict.state = self.controller.state
        verdict.reason = verdict.reason or self.controller.reason
        pushes = self.rig.scenario.plant.pushes
        most = 3.0 * highest + sum(float(np.linalg.norm(push.force)) for push in pushes)
        self._judge_end(verdict, fault, most)
        return verdict

    def _judge_end(self, verdict: Verdict, fault: Fault, most: float) -> None:
        """Add what is wrong. most: N of force."""
        wrong = verdict.wrong
        if fault.lies and verdict.force > most:
            wrong.append(f"contact force {verdict.force:.1f} N, at most {most:.1f} N are allowed")
        if verdict.rate > self.controller.settings.safety.torque_rate * (1 + 1e-6):
            wrong.append(f"torque rate {verdict.rate:.0f} 1/s")
        ends = fault.ends
        if self.case.every:  # the last tick may be a lost one
            ends += (HOLD,) if verdict.fault == "no fault" else (HOLD, SAFE_STOP)
        if verdict.state not in ends:
            wrong.append(f"ended in {verdict.state.name}: {verdict.reason[:60]}")
        if verdict.stopped is None or verdict.unbraked or not fault.lies:
            return
        if verdict.rest_speed > REST_SPEED:
            wrong.append(f"{verdict.rest_speed:.2f} rad/s (m/s) {REST_AFTER:g} s after the stop")
        if verdict.travel > REST_TRAVEL:
            wrong.append(f"moved by {verdict.travel:.2f} rad (m) since the stop")


def _scenario(name: str, outward: float | None) -> osc.Scenario:
    """As packaged; or without contacts, both arms drawn to the edge of their reach (m)."""
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


def try_fault(name: str, case: Case) -> Verdict:
    """Run the scenario of a case up to its phase, then with the fault; judge it."""
    run = Run(case)
    seen = Verdict("no fault", case)
    while run.k < run.first and not seen.wrong:
        run.step(seen)
    return run.judge(name)


# --- all of them ----------------------------------------------------------------------------------


def cases(seeds: int) -> Iterator[Case]:
    """Every phase, then every other packaged scenario in contact; each with every loss."""
    for seed in range(seeds):
        for every in LOSSES:
            for phase in PHASES:
                yield Case(phase, every=every, seed=seed)
            for scenario in osc.list_scenarios():
                if scenario != "two_contact_rod":
                    yield Case("contact", scenario, every, seed)


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


def main(only: str = "", seeds: int = 1, workers: int = 2) -> None:
    """Run them all; exit with 1 if anything was wrong.

    Args:
        only: runs whose name contains this.
    """
    runs = [run for run in product(FAULTS, cases(seeds)) if only in "{} / {}".format(*run)]
    if not runs:
        raise typer.BadParameter(f"no run has {only!r} in its name")
    verdicts = []
    for verdict in side_by_side(try_fault, runs, workers):
        verdicts.append(verdict)
        if verdict.wrong:
            print(f"{verdict.fault} / {verdict.case}: {'; '.join(verdict.wrong)}", flush=True)
    Console(width=200).print(table(verdicts))
    wrong = sum(bool(v.wrong) for v in verdicts)
    print(f"{len(verdicts)} runs, {wrong} of them wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    typer.run(main)
