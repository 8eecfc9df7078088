"""Faults of sensors, actuators and references in closed loop: what the controller makes of them.

    python benchmarks/fault_injection.py [--ticks 1000000] [--workers 2] [--kept FILE]

Every kind of fault is tried in every phase of a run, with other seeds until there are enough ticks.
Printed is, for each kind, how the runs ended and the largest of all figures; the exit code is 1 if
a torque was not finite or beyond its limit or its rate, if a joint stayed beyond its speed limit or
outside its range for 0.3 s without a stop, if the true contact force went beyond three times its
command (or 30 N, whichever is more) where a sensor lied, or if a state is not one that the kind is
to end in. With `--kept` each run is a line of that file, and the same command goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import osc_contact as osc
from osc_contact.control.safety import SafetyState
from osc_contact.errors import PlantError
from osc_contact.interface import Measurement, Reference, Stamps
from osc_contact.runs.run import Taring, start

__all__ = ["FAULTS", "PHASES", "Fault", "Trial", "Verdict", "try_fault"]

RUN, DEGRADED, HOLD, SAFE_STOP = SafetyState
STOP_WITHIN = 0.3  #: s
FAULT_FOR = 0.6  #: s that a lasting fault is looked at
NAN = float("nan")

Change = Callable[["Trial", Measurement, Reference], tuple[Measurement, Reference]]


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes:
        change: what becomes of a measurement and a reference while it lasts; or None.
        lasts: s; inf: to the end. ends: states that a run may end in.
        lies: whether a sensor lies, so that contact forces are judged.
        torque: what becomes of the torques on their way to the motors; or None.
    """

    change: Change | None
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
        return int(self.kept.setdefault(f"pick{n}", int(self.rng.integers(n))))


# --- what goes wrong ------------------------------------------------------------------------------


def _set(name: str, make: Callable[[Trial, np.ndarray], np.ndarray]) -> Change:
    def change(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
        return replace(m, **{name: make(t, np.array(getattr(m, name)))}), r

    return change


def _one(name: str, value: Callable[[Trial, float], float]) -> Change:
    """One number of an array, the same all the time."""

    def make(t: Trial, x: np.ndarray) -> np.ndarray:
        i = t.pick(x.size)
        x.flat[i] = value(t, x.flat[i])
        return x

    return _set(name, make)


def _motor(name: str, value: Callable[[Trial, float], float]) -> Change:
    """The same of one motor joint."""

    def make(t: Trial, x: np.ndarray) -> np.ndarray:
        i = t.chain.actuated[t.pick(len(t.chain.actuated))]
        x[i] = value(t, x[i])
        return x

    return _set(name, make)


def _goal(**what: Callable[[Trial, Any], Any]) -> Change:
    def change(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
        return m, replace(r, **{key: make(t, getattr(r, key)) for key, make in what.items()})

    return change


def _both(*changes: Change) -> Change:
    def change(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
        for one in changes:
            m, r = one(t, m, r)
        return m, r

    return change


def _repeat(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
    return t.first("packet", m), r


def _wrong_turn(t: Trial, X: pin.SE3) -> pin.SE3:
    bad = X.copy()
    bad.rotation = 1.5 * X.rotation
    return bad


def _mirror(t: Trial, X: pin.SE3) -> pin.SE3:
    bad = X.copy()
    bad.rotation = X.rotation @ np.diag([1.0, 1.0, -1.0])
    return bad


def _stale(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
    return replace(m, sequence=7), r


def _reordered(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
    return replace(m, sequence=t.k + (3 if t.k % 2 else -3)), r


def _clock_stands(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
    return replace(m, stamps=Stamps(1.0, 1.0, 1.0, 1.0)), r


def _no_wrench(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
    return replace(m, wrenches=np.full_like(m.wrenches, NAN), wrench_valid=False), r


def _arm(scale: float) -> Callable[[Trial, np.ndarray], np.ndarray]:
    """The wrist of one arm times a number."""

    def make(t: Trial, w: np.ndarray) -> np.ndarray:
        w[t.pick(len(w))] *= scale
        return w

    return make


def _held_row(t: Trial, w: np.ndarray) -> np.ndarray:
    i = t.pick(len(w))
    w[i] = t.first("row", w[i].copy())
    return w


def _weaken(share: float) -> Callable[[Trial, np.ndarray], np.ndarray]:
    """One motor gives a share of what it is told to."""

    def make(t: Trial, tau: np.ndarray) -> np.ndarray:
        tau[t.pick(len(tau))] *= share
        return tau

    return make


def _delay(t: Trial, tau: np.ndarray) -> np.ndarray:
    before = t.kept.get("last", tau)
    t.kept["last"] = tau
    return before


_STOPS = (SAFE_STOP,)
_ON = (RUN, DEGRADED)
_TICK = 1e-9  #: of a fault that lasts one tick

FAULTS: dict[str, Fault] = {
    "no fault": Fault(None, 0.0, _ON),
    # encoders
    "encoder NaN once": Fault(_one("q", lambda t, x: NAN), _TICK, _ON),
    "encoder NaN for ever": Fault(_one("q", lambda t, x: NAN), ends=_STOPS),
    "encoders NaN, 15 ticks": Fault(_set("q", lambda t, x: x * NAN), 0.014, _ON),
    "encoder spike of 1 rad, one tick": Fault(_motor("q", lambda t, x: x + 1.0), _TICK, _ON),
    "encoder jumps by 1 rad": Fault(_motor("q", lambda t, x: x + 1.0), ends=_STOPS),
    "encoder 1e200": Fault(_motor("q", lambda t, x: 1e200), ends=_STOPS),
    "encoder stuck": Fault(_motor("q", lambda t, x: t.first("q", x))),
    "encoders stuck, speeds too": Fault(
        _both(
            _set("q", lambda t, x: t.first("q", x)),
            _set("v", lambda t, x: t.first("v", x)),
        ), ends=_STOPS,
    ),
    "encoders stuck, speeds zero": Fault(
        _both(_set("q", lambda t, x: t.first("q", x)), _set("v", lambda t, x: 0.0 * x))
    ),
    "encoder mirrored": Fault(_motor("q", lambda t, x: -x)),
    "encoder drifts by 0.2 rad/s": Fault(_motor("q", lambda t, x: x + 2e-4 * t.k)),
    "encoder noise of 5 mrad": Fault(
        _set("q", lambda t, x: x + 5e-3 * t.rng.normal(size=x.shape))
    ),
    # speeds
    "speed NaN once": Fault(_one("v", lambda t, x: NAN), _TICK, _ON),
    "speed inf for ever": Fault(_one("v", lambda t, x: np.inf), ends=_STOPS),
    "speed spike, one tick": Fault(_motor("v", lambda t, x: 100.0), _TICK, _ON),
    "speeds zero": Fault(_set("v", lambda t, x: 0.0 * x)),
    "speeds mirrored": Fault(_set("v", lambda t, x: -x)),
    "speed noise of 0.05 rad/s": Fault(
        _set("v", lambda t, x: x + 0.05 * t.rng.normal(size=x.shape))
    ),
    # wrists
    "wrench NaN once": Fault(_one("wrenches", lambda t, x: NAN), _TICK, _ON),
    "wrench NaN, 19 ticks": Fault(_one("wrenches", lambda t, x: NAN), 0.018, _ON),
    "wrench NaN for ever": Fault(_one("wrenches", lambda t, x: NAN), ends=_STOPS),
    "wrench 100 kN once": Fault(_one("wrenches", lambda t, x: 1e5), _TICK, _ON),
    "wrench 900 N once": Fault(_one("wrenches", lambda t, x: 900.0), _TICK, _ON),
    "wrench 100 kN for ever": Fault(_one("wrenches", lambda t, x: 1e5), ends=_STOPS),
    "wrists read zero": Fault(_set("wrenches", lambda t, x: 0.0 * x)),
    "one wrist reads zero": Fault(_set("wrenches", _arm(0.0))),
    "one wrist stuck": Fault(_set("wrenches", _held_row)),
    "wrists mirrored": Fault(_set("wrenches", lambda t, x: -x)),
    "one wrist mirrored": Fault(_set("wrenches", _arm(-1.0))),
    "wrist offset of 20 N": Fault(_one("wrenches", lambda t, x: x + 20.0)),
    "wrists times 0.3": Fault(_set("wrenches", lambda t, x: 0.3 * x)),
    "wrist noise of 5 N": Fault(
        _set("wrenches", lambda t, x: x + 5.0 * t.rng.normal(size=x.shape))
    ),
    "no wrench for 15 ticks": Fault(_no_wrench, 0.014, _ON),
    "no wrench for ever": Fault(_no_wrench, ends=_STOPS),
    # packets
    "packet repeats for ever": Fault(_repeat, ends=_STOPS),
    "same sequence number": Fault(_stale, ends=_STOPS),
    "packets out of order": Fault(_reordered, 0.2),
    "clock stands still": Fault(_clock_stands, ends=_STOPS),
    # references
    "X_WD no rotation": Fault(_goal(X_WD=_wrong_turn), ends=_STOPS),
    "X_WD mirrored": Fault(_goal(X_WD=_mirror), ends=_STOPS),
    "reference NaN once": Fault(_goal(V_D=lambda t, x: x * NAN), _TICK, _ON),
    "reference jumps by 5 cm": Fault(
        _goal(X_WD=lambda t, X: pin.SE3(X.rotation, X.translation + [0.05, 0.0, 0.0])), lies=False
    ),
    "reference accelerates by 50 m/s²": Fault(
        _goal(A_D=lambda t, x: x + [50.0, 0, 0, 0, 0, 0]), 0.1, lies=False
    ),
    # motors
    "a motor is dead": Fault(None, lies=False, torque=_weaken(0.0)),
    "a motor is weak": Fault(None, lies=False, torque=_weaken(0.7)),
    "torques are late by a tick": Fault(None, lies=False, torque=_delay),
}  # fmt: skip

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


@dataclass
class Verdict:
    """What a run showed. `wrong`: sentences; none if all was as it should be."""

    fault: str
    phase: str
    ticks: int
    state: SafetyState
    stopped: float | None
    force: float
    speed: float
    rate: float
    wrong: list[str]
    reason: str = ""
    seed: int = 0


def try_fault(name: str, phase: str, seed: int = 0, scenario: str = "two_contact_rod") -> Verdict:
    """Run a scenario up to a phase, then with the fault; judge it."""
    begin, how = PHASES[phase]
    fault = FAULTS[name]
    scenario = how.get("scenario", scenario)
    rig = osc.build_rig(_scenario(scenario, how.get("outward")))
    plant, controller = start(rig, seed)
    robot = rig.robot(plant, controller)
    tick = controller.tick if rig.scenario.tare is None else Taring(rig, controller).tick
    chain, dt = rig.model, controller.dt
    act = np.array(chain.actuated)
    limit, rate = chain.tau_max, controller.settings.safety.torque_rate
    low, high = chain.model.lowerPositionLimit[act], chain.model.upperPositionLimit[act]
    fastest = chain.model.velocityLimit[act]
    trial = Trial(np.random.default_rng([seed, len(name)]), chain)
    begin += 0.003 * seed  # another moment for each seed
    first, last = round(begin / dt), round(min(begin + fault.lasts, 1e6) / dt)
    ticks = first + round(FAULT_FOR / dt)
    seen = {"force": 0.0, "speed": 0.0, "rate": 0.0}
    wrong: list[str] = []
    stopped: float | None = None
    beyond = outside = 0
    before = controller.last_torques() if controller._records.ticked[0] else None
    highest = 0.0
    for k in range(ticks):
        reference = rig.references.at(k * dt)
        measurement = robot.measure()
        if how.get("hold") and 8 < first - k <= 16:
            measurement = replace(measurement, wrenches=np.full_like(measurement.wrenches, NAN))
        if first <= k <= last:
            trial.k = k - first
            if fault.change is not None:
                measurement, reference = fault.change(trial, measurement, reference)
        tau = tick(measurement, reference)
        if not np.isfinite(tau).all() or (np.abs(tau) > limit * (1 + 1e-9)).any():
            wrong.append(f"tick {k}: torques {tau}")
            break
        if before is not None:
            seen["rate"] = max(seen["rate"], float((np.abs(tau - before) / limit).max() / dt))
        before = tau
        sent = tau
        if fault.torque is not None and first <= k <= last:
            sent = fault.torque(trial, tau.copy())
        try:
            robot.command(sent, dt)
        except PlantError as error:
            wrong.append(f"tick {k}: {error}"[:90])
            break
        if k < first:
            continue
        if stopped is None and controller.state is SAFE_STOP:
            stopped = (k - first) * dt
        true, truth = _inside(plant).measure(), plant.truth()
        speeds = np.abs(true.v[act]) / fastest
        seen["speed"] = max(seen["speed"], float(speeds.max()))
        beyond = beyond + 1 if (speeds > 1.0).any() else 0
        out = (true.q[act] < low) | (true.q[act] > high)
        outside = outside + 1 if out.any() else 0
        command = float(np.max(np.abs(reference.alpha_d), initial=0.0))
        highest = max(highest, command)
        force = float(np.max(np.abs(truth.alpha), initial=0.0))
        seen["force"] = max(seen["force"], force)
        if controller.state is not SAFE_STOP and max(beyond, outside) * dt > STOP_WITHIN:
            wrong.append(f"tick {k}: joints beyond their limits and no stop")
            break
    most = max(3.0 * highest, 30.0)
    if fault.lies and seen["force"] > most:
        wrong.append(f"contact force {seen['force']:.1f} N, at most {most:.1f} N are allowed")
    if seen["rate"] > rate * (1 + 1e-6):
        wrong.append(f"torque rate {seen['rate']:.0f} 1/s")
    if controller.state not in fault.ends:
        wrong.append(f"ended in {controller.state.name}: {controller.reason[:60]}")
    return Verdict(name, phase, ticks, controller.state, stopped, **seen, wrong=wrong,
                   reason=controller.reason, seed=seed)  # fmt: skip


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


def _inside(plant: Any) -> Any:
    """The plant behind its sensors."""
    while hasattr(plant, "plant"):
        plant = plant.plant
    return plant


# --- all of them ----------------------------------------------------------------------------------


def _jobs(ticks: int, faults: list[str], phases: list[str]) -> Iterator[tuple[str, str, int]]:
    """(fault, phase, seed) until that many ticks are run."""
    left, seed = ticks, 0
    while left > 0:
        for name in faults:
            for phase in phases:
                if left > 0:
                    yield name, phase, seed
                left -= round(1000 * (PHASES[phase][0] + FAULT_FOR + 0.003 * seed))
        seed += 1


def _work(job: tuple[str, str, int]) -> Verdict:
    return try_fault(*job)


def _read(kept: Path | None) -> list[Verdict]:
    """The runs of a file; a last line that is not whole is taken out of it."""
    if kept is None or not kept.exists():
        return []
    lines = [line for line in kept.read_text().splitlines(True) if line.endswith("\n")]
    kept.write_text("".join(lines))
    return [Verdict(**row | {"state": SafetyState[row["state"]]}) for row in map(json.loads, lines)]


def _keep(verdict: Verdict, kept: Path | None) -> Verdict:
    if kept is not None:
        with kept.open("a") as file:
            file.write(json.dumps(asdict(verdict) | {"state": verdict.state.name}) + "\n")
    return verdict


def table(verdicts: list[Verdict]) -> str:
    """One line for each kind."""
    head = ("fault", "runs", "ticks", "RUN", "DEGR", "HOLD", "STOP", "latest stop s", "force N",
            "speed", "rate 1/s", "wrong")  # fmt: skip
    rows = [head]
    for name in FAULTS:
        mine = [v for v in verdicts if v.fault == name]
        if not mine:
            continue
        states = [sum(v.state is s for v in mine) for s in SafetyState]
        stops = [v.stopped for v in mine if v.stopped is not None]
        rows.append((
            name, str(len(mine)), str(sum(v.ticks for v in mine)), *map(str, states),
            f"{max(stops):.3f}" if stops else "-", f"{max(v.force for v in mine):.1f}",
            f"{max(v.speed for v in mine):.2f}", f"{max(v.rate for v in mine):.0f}",
            str(sum(bool(v.wrong) for v in mine)),
        ))  # fmt: skip
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    return "\n".join(
        "  ".join(
            x.ljust(w) if i == 0 else x.rjust(w)
            for i, (x, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    )


def main(argv: list[str] | None = None) -> int:
    """Run them all; 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--ticks", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--fault", action="append", choices=list(FAULTS))
    parser.add_argument("--phase", action="append", choices=list(PHASES))
    parser.add_argument("--kept", type=Path, help="a file of runs, gone on with")
    given = parser.parse_args(argv)
    jobs = list(_jobs(given.ticks, given.fault or list(FAULTS), given.phase or list(PHASES)))
    wanted = set(jobs)
    verdicts = [v for v in _read(given.kept) if (v.fault, v.phase, v.seed) in wanted]
    done = {(v.fault, v.phase, v.seed) for v in verdicts}
    jobs = [job for job in jobs if job not in done]
    if given.workers == 1:
        verdicts += [_keep(v, given.kept) for v in map(_work, jobs)]
    else:
        with ProcessPoolExecutor(given.workers) as pool:
            found = pool.map(_work, jobs, chunksize=4)
            verdicts += [_keep(v, given.kept) for v in found]
    print(table(verdicts))
    wrong = [v for v in verdicts if v.wrong]
    for v in wrong[:60]:
        print(f"{v.fault} / {v.phase}: {'; '.join(v.wrong)}")
    total = sum(v.ticks for v in verdicts)
    print(f"{len(FAULTS)} kinds, {len(verdicts)} runs, {total} ticks, {len(wrong)} of them wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
