"""Random tasks on random arms with everything wrong at once: how well are forces held?

    python -m benchmarks.cobots [--count 60] [--seed N] [--only TEXT] [--workers 2] [--why]
    python -m benchmarks.cobots --seed N --case I

The tasks are those of `random_tasks`: 8 s, default gains and settings, a tare. Judged is the true
contact force from one second after each contact was made: rms error over the mean command, of the
worst contact. A task has

* *failed* where the verdict says so (STOPPED, LOST, RUN AWAY, POOR, HELD);
* ended *wrong OK* where the verdict does not, and yet the rms error within any second was above
  10 %, the force above twice its command later than 0.35 s after contact was made, a contact open
  for more than 1 % of the time, or the object more than 5 mm off its path.

What `preflight` refuses or doubts is run all the same, to count how much of it would have been
below 5 %. With `--why` each task that failed, ended wrong OK or above 5 % runs again without one
group of errors after the other: those without which it is as wanted are its causes. Verdicts are
kept in out/cobots by the hash of the sources, so that the same command goes on where it was
interrupted.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import typer

import osc_contact as osc
from benchmarks.measuring import side_by_side
from benchmarks.random_tasks import GROUPS, RandomTask, draw
from osc_contact.lab.checks.preflight import preflight
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.sweeps.rows import without_logged_doubts
from osc_contact.recorder.judged import LANDING_S, judged_ticks
from osc_contact.spatial import Array

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "out/cobots"
WANTED = 0.05  #: rms error of what is as wanted
SETTLED_S = 1.0  #: after contact is made, from when on rms errors are judged
WINDOW_S = 1.0
#: What a verdict that does not say so is wrong about: rms within a window, peak over command,
#: share of the time that a contact is open, m off the path.
MOST_RMS = 0.1
MOST_PEAK = 2.0
MOST_OPEN = 0.01
MOST_OFF = 0.005


@dataclass
class Outcome:
    """Result of one drawn task.

    Attributes:
        seed: seed of the task.
        number: number of the task among those of the seed.
        without: group of errors that was left out; empty: none.
        name: name of the arm or scenario.
        words: drawn properties of the task, in words by kind.
        refused: sentences of `preflight` that refuse the task.
        doubted: warnings of `preflight`.
        word: word of the verdict.
        why: reasons of the verdict.
        failed: whether the run failed by its verdict.
        rms: rms force error of the worst contact, as a share of its command; None: not judged.
        window: largest rms force error within a second, as a share.
        peak: largest true force over the commanded one, later than 0.35 s after contact was made.
        landing: largest true force over the commanded one until then.
        opened: share of the time in which a commanded contact was open.
        off: largest distance from the path (m).
    """

    seed: int
    number: int
    without: str
    name: str
    words: dict[str, str]
    refused: list[str]
    doubted: list[str]
    word: str = "REFUSED"
    why: str = ""
    failed: bool = True
    rms: float | None = None
    window: float = 0.0
    peak: float = 0.0
    landing: float = 0.0
    opened: float = 0.0
    off: float = 0.0

    @property
    def noticed(self) -> bool:
        """True if the task was refused or doubted before it ran."""
        return bool(self.refused or self.doubted)

    @property
    def wrong_ok(self) -> str:
        """Faults of a run that its verdict leaves out; empty if it leaves out none."""
        if self.failed:
            return ""
        found = {
            f"{100 * self.window:.0f} % within a second": self.window > MOST_RMS,
            f"peak {self.peak:.1f} times its command": self.peak > MOST_PEAK,
            f"open for {100 * self.opened:.1f} %": self.opened > MOST_OPEN,
            f"{1e3 * self.off:.0f} mm off": self.off > MOST_OFF,
        }
        return ", ".join(words for words, is_so in found.items() if is_so)

    @property
    def wanted(self) -> bool:
        """True if the run neither failed nor was wrongly OK, with an rms error below `WANTED`."""
        return not self.failed and not self.wrong_ok and self.rms is not None and self.rms < WANTED


# --- One task -------------------------------------------------------------------------------------


@without_logged_doubts()
def judge(seed: int, number: int, without: str = "") -> Outcome:
    """Run a task regardless of the findings of `preflight`.

    Args:
        seed, number: seed and number of the task.
        without: a group of errors that is left out; "": none.
    """
    task = draw(seed, number)
    if without:
        task = task.without(without)
    found = Outcome(seed, number, without, task.name, task.words, [], [])
    try:
        scenario = task.load()
        _judge_recording(found, osc.run(scenario, seed=number, check=_noting(found)))
    except osc.PlantError as error:  # the simulation diverged
        found.word, found.why = "STOPPED", str(error)
    except osc.OscContactError as error:
        found.refused.append(str(error))
    return found


def _noting(found: Outcome) -> Callable[[Rig], list[str]]:
    def check(rig: Rig) -> list[str]:
        for one in preflight(rig):
            (found.refused if one.refused else found.doubted).append(one.text)
        return []

    return check


def _judge_recording(found: Outcome, recording: osc.Recording) -> None:
    """Fill the numbers of an outcome.

    Args:
        found: the outcome.
        recording: recording of the run.
    """
    verdict = osc.metrics(recording)["task"]
    found.word = verdict["word"]
    found.failed = verdict["failed"]
    found.why = verdict["why"][0] if verdict["why"] else ""
    t = recording["t"]
    owners = recording.meta.get("columns", range(recording["alpha_true"].shape[1]))
    judged, _ = judged_ticks(recording)
    off = np.linalg.norm(recording["motion_error"][:, :3], axis=1)
    errors = []
    for i, owner in enumerate(owners):
        closed = recording["closed"][:, owner].astype(bool)
        if not closed.any():
            continue
        since = t - t[np.argmax(closed)]
        command = recording["alpha_cmd"][:, i]
        force = recording["alpha_true"][:, i]
        here = judged[:, i] & (since >= SETTLED_S)
        mean = np.abs(command[here]).mean() if here.any() else np.nan
        error = np.where(here, (force - command) / mean, 0.0)
        errors.append(np.sqrt(np.mean(error[here] ** 2)) if here.any() else np.nan)
        found.window = max(found.window, window_error(error, here, 1.0 / (t[1] - t[0])))
        over = force / np.maximum(np.abs(command), 1.0)
        later = since >= LANDING_S
        found.peak = max(found.peak, over[later].max(initial=0.0))
        found.landing = max(found.landing, over[(since >= 0.0) & ~later].max(initial=0.0))
        found.opened = max(found.opened, float(np.mean(~closed[here])) if here.any() else 1.0)
        found.off = max(found.off, off[later].max(initial=0.0))
    if errors and np.isfinite(errors).any():
        found.rms = float(np.nanmax(errors))


def window_error(error: Array, here: Array, rate: float) -> float:
    """Largest rms error within a window of which at least half is judged."""
    width = round(WINDOW_S * rate)
    sums = np.cumsum(np.concatenate([[0.0], error**2]))
    counts = np.cumsum(np.concatenate([[0], here]))
    if len(sums) <= width:
        return 0.0
    squares = sums[width:] - sums[:-width]
    judged = counts[width:] - counts[:-width]
    enough = judged > 0.5 * width
    return float(np.sqrt(np.max(squares[enough] / judged[enough], initial=0.0)))


# --- All of them ----------------------------------------------------------------------------------


class Kept:
    """Outcomes by task, in a file of these sources."""

    def __init__(self, folder: Path = KEPT) -> None:
        """Read those that are there."""
        digest = sha256()
        files = [path for part in ("osc_contact", "urdf") for path in (ROOT / part).rglob("*")]
        files += [ROOT / "benchmarks/random_tasks.py", Path(__file__)]
        for path in sorted(files):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.read_bytes())
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{digest.hexdigest()[:16]}.jsonl"
        self.found: dict[tuple[int, int, str], Outcome] = {}
        if self._path.exists():
            for line in self._path.read_text().splitlines(keepends=True):
                if line.endswith("\n"):  # others were cut by a kill
                    self._note(Outcome(**json.loads(line)))

    def _note(self, one: Outcome) -> None:
        self.found[one.seed, one.number, one.without] = one

    def add(self, one: Outcome) -> None:
        """Keep one."""
        self._note(one)
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(one), default=float) + "\n")

    def outcomes(self, jobs: Sequence[tuple[int, int, str]], workers: int) -> list[Outcome]:
        """Those of some tasks, run where they are not there."""
        missing = [job for job in jobs if job not in self.found]
        for one in side_by_side(judge, missing, workers) if missing else ():
            self.add(one)
        return [self.found[job] for job in jobs]


def causes(task: RandomTask, kept: Kept) -> str:
    """The groups of errors without which a task is as wanted."""
    ends = {group: kept.found.get((task.seed, task.number, group)) for group in task.wrong}
    found = [group for group, one in ends.items() if one is not None and one.wanted]
    return ", ".join(found) or "several at once"


def summary(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Counts and quantiles."""
    sound = [one for one in outcomes if not one.noticed]
    noticed = [one for one in outcomes if one.noticed]
    rms = [one.rms for one in sound if one.rms is not None]
    middle, most = np.quantile(rms, [0.5, 0.9]) if rms else (np.nan, np.nan)
    return {
        "tasks": len(outcomes),
        "refused": sum(bool(one.refused) for one in outcomes),
        "doubted": sum(bool(one.doubted and not one.refused) for one in outcomes),
        "of these below 5 % all the same": sum(one.wanted for one in noticed),
        "others": len(sound),
        "median rms (%)": round(100 * float(middle), 2),
        "90 % quantile (%)": round(100 * float(most), 2),
        "failed": sum(one.failed for one in sound),
        "wrong OK": sum(bool(one.wrong_ok) for one in sound),
    }


def _row(one: Outcome, cause: str) -> str:
    rms = "–" if one.rms is None else f"{100 * one.rms:.2f}"
    marks = "refused" if one.refused else "doubted" if one.doubted else ""
    marks += "" if not one.wrong_ok else f" WRONG OK: {one.wrong_ok}"
    words = ", ".join(f"{key} {value}" for key, value in one.words.items())
    row = f"{one.number:4} {one.name:16} {rms:>7} {one.landing:5.2f}  {one.word:9} {marks}"
    notes = [words]
    if cause:
        notes.append(f"without: {cause}")
    if not one.wanted:
        notes.append((one.refused + one.doubted + [one.why])[0])
    return "\n".join([row, *(f"       {note}" for note in notes if note)])


def main(
    count: int = 60,
    seed: int | None = None,
    only: str = "",
    workers: int = 2,
    why: bool = False,
    case: int | None = None,
) -> None:
    """Run the tasks and print the table.

    Args:
        count: number of tasks.
        seed: seed of the tasks; None: drawn and printed.
        only: tasks whose name contains this.
        workers: processes.
        why: run those that are not as wanted without one group of errors after the other.
        case: number of the one task to run; None: all of them.
    """
    if seed is None:
        seed = int(np.random.default_rng().integers(1 << 31))
    print(f"--seed {seed}", flush=True)
    tasks = [draw(seed, number) for number in (range(count) if case is None else [case])]
    tasks = [task for task in tasks if only in task.name]
    kept = Kept()
    outcomes = kept.outcomes([(seed, task.number, "") for task in tasks], workers)
    bad = [task for task, one in zip(tasks, outcomes, strict=True) if not one.wanted]
    if why:
        jobs = [
            (seed, task.number, group) for task in bad for group in GROUPS if group in task.wrong
        ]
        kept.outcomes(jobs, workers)
    print("task  of                  rms % landing  verdict")
    reasons: Counter[str] = Counter()
    for task, one in zip(tasks, outcomes, strict=True):
        cause = causes(task, kept) if why and task in bad else ""
        reasons.update([cause] if cause else [])
        print(_row(one, cause))
    for key, value in summary(outcomes).items():
        print(f"{key}: {value}")
    for cause, times in reasons.most_common():
        print(f"not as wanted, but without {cause}: {times}")


if __name__ == "__main__":
    typer.run(main)
