"""Whether a change of the code leaves the recordings of the packaged scenarios what they were.

    python benchmarks/same_recordings.py keep FOLDER [NAME ...]       # before the change
    python benchmarks/same_recordings.py compare FOLDER [NAME ...]    # after it

Compared are the word of the verdict and all channels but the tick's time. A difference is the
largest of a channel, over the largest magnitude that the channel had (or 1e-9, whichever is more).
The exit code of `compare` is 1 where one is above 1e-12, or where channels, their shapes, what is
not finite in them, or the word are others.
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
    channels = {key: np.asarray(recording[key], float) for key in recording.channels}
    del channels["tick_s"]
    return {**channels, "task": np.array(osc.metrics(recording)["task"]["word"])}


def difference(before: np.ndarray, now: np.ndarray) -> float:
    """The largest difference over the largest magnitude; inf where they cannot be compared."""
    if before.shape != now.shape or before.dtype.kind == "U":
        return 0.0 if np.array_equal(before, now) else np.inf
    apart = np.where((before == now) | (np.isnan(before) & np.isnan(now)), 0.0, before - now)
    size = np.abs(before).max(initial=1e-9, where=np.isfinite(before))
    return float(np.nan_to_num(np.abs(apart), nan=np.inf).max(initial=0.0) / size)


def main(
    what: Literal["keep", "compare"],
    folder: Path,
    names: Annotated[list[str] | None, typer.Argument()] = None,
) -> None:
    """Keep recordings, or compare others with them."""
    folder.mkdir(parents=True, exist_ok=True)
    same = True
    for name in names or osc.list_scenarios():
        file = folder / f"{name}.npz"
        now = record(name)
        if what == "keep":
            np.savez(file, **now)
            continue
        with np.load(file) as kept:
            found = {key: difference(kept[key], now[key]) for key in set(kept) & set(now)}
            found |= dict.fromkeys(set(kept) ^ set(now), np.inf)
        worst = max(found, key=lambda key: found[key])
        same &= found[worst] <= TOLERANCE
        print(f"{name}: {found[worst]:.1e} ({worst})", flush=True)
    raise typer.Exit(not same)


if __name__ == "__main__":
    typer.run(main)
