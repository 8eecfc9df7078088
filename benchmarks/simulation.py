"""How much faster than real time a whole run is, and where its time goes."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from time import perf_counter
from typing import Any
from unittest.mock import patch

import osc_contact as osc
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.runs import recorder
from osc_contact.runs import run as runs
from osc_contact.runs.references import References
from paper.study import Data

SCENARIO = "two_contact_rod"
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
        with ExitStack() as stack:
            for label, owner, name in calls:
                timed = self.timed(label, getattr(owner, name))
                stack.enter_context(patch.object(owner, name, timed))
            yield


def measure(ticks: int) -> Data:
    """{"parts": rows, "simulated_s", "wall_s", "cpu_s", "real_time_factor", "watched_wall_s"}.

    `two_contact_rod` on MuJoCo as packaged: 0.25 ms steps, 1 kHz control, recording on. Run for the
    real-time factor, then with its calls timed for the shares; of three runs each the fastest.

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
        ("plant: MuJoCo's steps", MujocoPlant, "command"),
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
            tick_s = float(recording["tick_s"].sum())
            watched.append((recording.meta["wall_s"], ledger.spent | {"tick": tick_s}))
    timed, spent = min(watched, key=lambda run: run[0])
    spent["the rest"] = timed - sum(spent.values())
    parts = [
        {"part": name, "µs per tick": 1e6 * time / ticks, "share": time / timed}
        for name, time in spent.items()
    ]
    return {
        "parts": parts,
        "simulated_s": duration,
        "wall_s": wall,
        "cpu_s": cpu,
        "real_time_factor": duration / wall,
        "watched_wall_s": timed,
    }
