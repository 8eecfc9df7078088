"""Comparison of recordings of the packaged scenarios before and after a change of the code.

    python -m benchmarks.same_recordings keep FOLDER [NAME ...]       # before the change
    python -m benchmarks.same_recordings compare FOLDER [NAME ...]    # after it

Scenarios run for their whole duration, several side by side. Compared are all channels but the
tick's time: names, types, shapes, every number of every row, NaN at the same places; and the meta
data but for times. The exit code of `compare` is 1 where anything differs.

A change that rounds otherwise is compared with `--duration 1.5 --tolerance 1e-12`, given to both
commands: longer runs amplify rounding wherever contacts open. The tolerance is of the largest
magnitude that a channel had (or 1e-9, whichever is more); of the meta data only the word of the
verdict is compared then.
"""

from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

import osc_contact as osc
from osc_contact.lab.sweeps.workers import available_cores
from osc_contact.spatial import Array

SEED = 1
#: channels and meta data that a clock measured, and that are of the sources themselves
TIMES = ("tick_s", "wall_s", "cpu_s", "date", "law_hash")


def record(name: str, duration: float | None) -> osc.Recording:
    """A run of a packaged scenario, with the word of its verdict in the meta data."""
    recording = osc.run(osc.load_scenario(name), duration=duration, seed=SEED)
    recording.meta["task"] = osc.metrics(recording)["task"]["word"]
    return recording


def difference(before: Array, now: Array) -> float:
    """The largest difference over the largest magnitude; inf where they cannot be compared."""
    if before.shape != now.shape or before.dtype != now.dtype:
        return np.inf
    if np.array_equal(before, now, equal_nan=True):
        return 0.0
    known = np.isfinite(before) & np.isfinite(now)
    if not np.array_equal(before[~known], now[~known], equal_nan=True):
        return np.inf
    apart = np.abs(before[known].astype(float) - now[known].astype(float))
    size = np.abs(before[known].astype(float)).max(initial=1e-9)
    return float(apart.max(initial=0.0) / size)


def differences(before: osc.Recording, now: osc.Recording, exact: bool) -> dict[str, float]:
    """Differences of channels and of meta data by name, where there are any.

    Args:
        before, now: recordings of the same scenario.
        exact: all the meta data, not only the verdict.
    """
    found = dict.fromkeys(set(before.channels) ^ set(now.channels), np.inf)
    for name in set(before.channels) & set(now.channels):
        found[name] = difference(before[name], now[name])
    for key in set(before.meta) | set(now.meta) if exact else {"task"}:
        same = before.meta.get(key) == now.meta.get(key)
        found[f"meta.{key}"] = 0.0 if same else np.inf
    return {
        name: worst
        for name, worst in sorted(found.items())
        if worst > 0.0 and name.removeprefix("meta.") not in TIMES
    }


def keep(name: str, file: Path, duration: float | None, exact: bool) -> dict[str, float]:
    """Run a scenario and write its recording; nothing is compared."""
    record(name, duration).save(file)
    return {}


def compare(name: str, file: Path, duration: float | None, exact: bool) -> dict[str, float]:
    """Run a scenario; see `differences`."""
    return differences(osc.Recording.load(file), record(name, duration), exact)


def main(
    what: Literal["keep", "compare"],
    folder: Path,
    names: Annotated[list[str] | None, typer.Argument()] = None,
    duration: Annotated[float | None, typer.Option(help="of each run (s)")] = None,
    tolerance: Annotated[float, typer.Option(help="of a channel's largest magnitude")] = 0.0,
    workers: Annotated[int | None, typer.Option(help="runs side by side")] = None,
) -> None:
    """Keep recordings, or compare others with them."""
    folder.mkdir(parents=True, exist_ok=True)
    scenarios = {name: osc.load_scenario(name) for name in names or osc.list_scenarios()}
    # the longest first, so that none of them is left alone on a core at the end
    order = sorted(scenarios, key=lambda name: scenarios[name].duration, reverse=True)
    task = keep if what == "keep" else compare
    exact = tolerance == 0.0
    same = True
    with ProcessPoolExecutor(workers or available_cores(), get_context("spawn")) as pool:
        runs = {
            pool.submit(task, name, folder / f"{name}.npz", duration, exact): name for name in order
        }
        for count, run in enumerate(as_completed(runs), start=1):
            found = run.result()
            same &= all(worst <= tolerance for worst in found.values())
            words = ", ".join(f"{channel} {worst:.1e}" for channel, worst in found.items())
            report = "kept" if what == "keep" else words or "the same"
            print(f"{count}/{len(runs)} {runs[run]}: {report}", flush=True)
    raise typer.Exit(not same)


if __name__ == "__main__":
    typer.run(main)
