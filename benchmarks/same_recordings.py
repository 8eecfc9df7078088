"""Whether a change of the code leaves the recordings of the packaged scenarios what they were.

    python benchmarks/same_recordings.py keep FOLDER [NAME ...]       # before the change
    python benchmarks/same_recordings.py compare FOLDER [NAME ...]    # after it

Compared are all channels but the tick's time. A difference is the largest of a channel, over the
largest magnitude that the channel has (or 1e-9, whichever is more). The exit code of `compare` is 1
where a difference is above 1e-12, or where a channel, a state or the verdict of a run is another.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

import osc_contact as osc

DURATION = 1.5  #: s of each run; a longer one amplifies rounding wherever contacts open
TOLERANCE = 1e-12


def record(name: str) -> dict[str, Any]:
    """Channels of a run, and the verdict of it."""
    recording = osc.run(osc.load_scenario(name), duration=DURATION, seed=1)
    channels = {key: np.asarray(recording[key]) for key in recording.channels if key != "tick_s"}
    return {**channels, "task": np.array(osc.metrics(recording)["task"]["word"])}


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """The largest difference over the largest magnitude; inf where they cannot be compared."""
    if one.shape != other.shape or one.dtype.kind != other.dtype.kind:
        return np.inf
    if one.dtype.kind not in "fc":
        return 0.0 if np.array_equal(one, other) else np.inf
    if not np.array_equal(np.isfinite(one), np.isfinite(other)):
        return np.inf
    known = np.isfinite(one)
    size = np.abs(one[known]).max(initial=1e-9)
    return float(np.abs(one[known] - other[known]).max(initial=0.0) / size)


def compare(kept: Path, name: str) -> bool:
    """Print how far a run is from the one that was kept; whether it is the same."""
    now = record(name)
    with np.load(kept / f"{name}.npz") as before:
        one_sided = sorted(set(now) ^ set(before))
        found = {key: difference(before[key], now[key]) for key in set(now) & set(before)}
    worst = max(found, key=lambda key: found[key])
    same = not one_sided and found[worst] <= TOLERANCE
    others = f"; only on one side: {', '.join(one_sided)}" if one_sided else ""
    print(
        f"{'same' if same else 'DIFFERS':8}{name}: {found[worst]:.1e} ({worst}){others}", flush=True
    )
    return same


def main(
    what: Literal["keep", "compare"],
    folder: Path,
    names: Annotated[list[str] | None, typer.Argument()] = None,
) -> None:
    """Keep recordings, or compare others with them."""
    folder.mkdir(parents=True, exist_ok=True)
    same = True
    for name in names or osc.list_scenarios():
        if what == "keep":
            np.savez(folder / f"{name}.npz", **record(name))
            print(f"kept    {name}", flush=True)
        else:
            same &= compare(folder, name)
    raise typer.Exit(not same)


if __name__ == "__main__":
    typer.run(main)
