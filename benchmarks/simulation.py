"""How much faster than real time a whole run is, and where its time goes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from time import perf_counter
from typing import Any

import osc_contact as osc
from benchmarks.measuring import Report
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.runs import recorder
from osc_contact.runs import run as runs
from osc_contact.runs.references import References
from paper.study import table_of

SCENARIO = "two_contact_rod"
STEPS = "plant: MuJoCo's steps"
REST = "the rest"
RUNS = 3  #: the least disturbed of so many counts


class Ledger:
    """Time spent in some calls, on a clock; a call inside another counts for itself only."""

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self.spent: dict[str, float] = {}
        self._inner: list[float] = []

    def begin(self, controller: Any = None) -> Any:
        """Count from zero; as the law that is installed: when a run gets its controller."""
        self.spent = dict.fromkeys(self.spent, 0.0)
        return controller

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, which writes its time down."""
        self.spent.setdefault(name, 0.0)

        @wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            start = self._clock()
            try:
                return function(*args, **kwargs)
            finally:
                whole = self._clock() - start
                self.spent[name] += whole - self._inner.pop()
                if self._inner:
                    self._inner[-1] += whole

        return call

    @contextmanager
    def watching(self, calls: list[tuple[str, Any, str]]) -> Iterator[None]:
        """Time attributes (label, owner, name) as long as the block lasts."""
        before = [(owner, name, getattr(owner, name)) for _, owner, name in calls]
        try:
            for label, owner, name in calls:
                setattr(owner, name, self.timed(label, getattr(owner, name)))
            yield
        finally:
            for owner, name, function in before:
                setattr(owner, name, function)


def measure(ticks: int) -> Report:
    """{"real_time_factor", "simulated_s", "wall_s", "cpu_s", "us_per_tick": {part: …}, …}.

    `two_contact_rod` on MuJoCo as packaged: 0.25 ms steps, 1 kHz control, recording on. Run for the
    real-time factor, then with its calls timed for the shares; of three runs each the fastest. What
    MuJoCo's steps take is measured once more by themselves.

    Args:
        ticks: control ticks to simulate.

    Raises:
        PlantError: MuJoCo is missing.
    """
    scenario = osc.load_scenario(SCENARIO)
    duration = ticks / scenario.control.rate
    runs.run(scenario, duration=10 / scenario.control.rate)  # everything loaded
    metas = [runs.run(scenario, duration=duration).meta for _ in range(RUNS)]
    wall, cpu = min((meta["wall_s"], meta["cpu_s"]) for meta in metas)
    calls = [
        (STEPS, MujocoPlant, "command"),
        ("plant: measurement", MujocoPlant, "measure"),
        ("references", References, "over"),
        ("recorder: a row of numbers", osc.Recorder, "append"),
        ("recorder: rows to the file", osc.Recorder, "flush"),
        ("recorder: channels, at the end", recorder, "recording_of"),
    ]
    watched = []
    for _ in range(RUNS):
        ledger = Ledger()
        with ledger.watching(calls):
            recording = runs.run(scenario, duration=duration, install=ledger.begin)
            watched.append((recording.meta["wall_s"], ledger.spent, recording))
    timed, spent, recording = min(watched, key=lambda run: run[0])
    spent["tick"] = float(recording["tick_s"].sum())
    steps = min(_stepped(scenario, recording) for _ in range(RUNS))
    parts = {name: time / ticks * 1e6 for name, time in spent.items()}
    parts[REST] = timed / ticks * 1e6 - sum(parts.values())
    shares = {name: time * ticks / 1e6 / timed for name, time in parts.items()}
    lines = (f"{name}; {time:.1f}; {100 * shares[name]:.1f} %" for name, time in parts.items())
    title = f"{SCENARIO}, {duration:g} s in {wall:.2f} s: {duration / wall:.1f} × real time"
    table = table_of(title, "part; µs per tick; share", lines)
    table.caption = (
        f"shares from other runs, {timed / wall:.2f} × as long, with its calls timed"
        f"; MuJoCo's steps by themselves {steps / ticks * 1e6:.1f} µs"
    )
    if cpu < 0.9 * wall:
        table.caption += (
            f"; busy machine: a processor worked {cpu:.2f} s, {duration / cpu:.1f} × real time"
        )
    data = {
        "scenario": SCENARIO,
        "step_s": scenario.plant.step,
        "rate_hz": scenario.control.rate,
        "ticks": ticks,
        "simulated_s": duration,
        "wall_s": wall,
        "real_time_factor": duration / wall,
        "cpu_s": cpu,
        "watched_wall_s": timed,
        "us_per_tick": parts,
        "steps_us_per_tick": steps / ticks * 1e6,
        "shares": shares,
    }
    return Report(data, [table])


def _stepped(scenario: osc.Scenario, recording: osc.Recording) -> float:
    """What MuJoCo alone takes for the steps of a run (s): the same torques once more."""
    ledger = Ledger()
    plant, controller = runs.start(osc.build_rig(scenario))
    assert isinstance(plant, MujocoPlant)
    with ledger.watching([("steps", plant._mj, "mj_step")]):
        for tau in recording["tau"]:
            plant.command(tau, controller.dt)
    return ledger.spent["steps"]
