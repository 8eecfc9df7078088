"""Misplacement of a hole, learned from the contacts that were recognised during insertions.

    python -m benchmarks.learned_places [--count 5] [--seed 7000] [--folder out/insertions]

The insertions, the recogniser and what it believes are those of `benchmarks.recognition`. Gaps of
the pairs of the recognised state that carry more than friction explains are used while this state
has a probability of 95 %, until the peg is in the hole. For each parameter: how often it was
reported as learned, and the rms error where it was, before and after.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import typer
from rich.console import Console

from benchmarks.measuring import without_log
from benchmarks.recognition import (
    ERRORS,
    EVERY,
    INSIDE,
    OTHER,
    Truth,
    seen_forces,
    smoothed,
    states_of,
    true_forces,
)
from benchmarks.recognition import SEARCH as CONTACTS
from benchmarks.recorded_insertions import CLEARANCE, recorded
from osc_contact.contacts.insertion import Peg
from osc_contact.lab.tasks.insertion import WIDTH, Insertion
from osc_contact.lab.tasks.pegs import peg_plan
from osc_contact.recognition.place import PARAMETERS, LearnedPlace
from osc_contact.recognition.recogniser import SURE, Recogniser
from osc_contact.spatial import Array

GAP = 1e-4  #: standard deviation of a gap by encoders, clearance and softness (m)
LASTING = 25.0  #: instants for which these errors last
UNITS = np.repeat([1e3, np.degrees(1.0)], 3)  #: of the printed figures (mm, degrees)


def learn(seed: int, folder: Path) -> tuple[LearnedPlace, Array]:
    """Learn the place of the hole in one insertion; return it, and the true displacement (6,).

    Args:
        seed: seed of the insertion.
        folder: folder of the recordings.
    """
    rows = recorded(seed, folder)
    task = Insertion(Peg("square", WIDTH), CLEARANCE, seed)
    states = states_of(task.peg, task.hole)
    stages = [stage.name for stage in peg_plan(task.peg, task.hole).stages]
    recogniser = Recogniser(states, 1e-3 * EVERY)
    wrenches = smoothed(rows["wrench"])
    place = LearnedPlace(
        task.hole.pose.translation,
        position=ERRORS.position,
        angle=ERRORS.angle,
        gap=GAP,
        lasting=LASTING,
    )
    for k in range(0, len(wrenches), EVERY):
        if stages[rows["stage"][k]] == "weigh":
            continue
        if set(true_forces(rows["contacts"][k], task.true_hole)) & {INSIDE, OTHER}:
            break
        X = pin.SE3(rows["X_WO"][k])
        recogniser.update(X, wrenches[k])
        if recogniser.probability(recogniser.state) < SURE:
            continue
        forces = recogniser.forces
        names = []
        for name in Truth(seen_forces(recogniser)).beyond(0.0):
            names.append(max(CONTACTS[name], key=lambda pair: forces[pair]))
        place.update([states.pairs[name] for name in names], X)
    return place, task.displacement


@without_log()
def main(count: int = 5, seed: int = 7000, folder: Path = Path("out/insertions")) -> None:
    """Print what was learned over some insertions."""
    console = Console(width=140, highlight=False)
    found = [learn(k, folder) for k in range(seed, seed + count)]
    errors = np.array([true - place.displacement() for place, true in found]) * UNITS
    before = np.array([true for _, true in found]) * UNITS
    learned = np.array([[name in place.learned() for name in PARAMETERS] for place, _ in found])
    for j, name in enumerate(PARAMETERS):
        unit = "mm" if j < 3 else "degrees"
        rows = learned[:, j]
        rms = [
            np.sqrt(np.mean(one[rows, j] ** 2)) if rows.any() else np.nan
            for one in (before, errors)
        ]
        console.print(
            f"{name}: learned in {rows.sum()} of {count}, "
            f"rms {rms[0]:.2f}, then {rms[1]:.2f} {unit}"
        )
    wanted = learned[:, :2].any(axis=1) & learned[:, 2] & learned[:, 3:].any(axis=1)
    console.print(f"one of x and y, z, and a rotation: in {wanted.sum()} of {count}")
    squares = [place.squares(true) / 6.0 for place, true in found]
    console.print(f"χ²/6: median {np.median(squares):.1f}, mean {np.mean(squares):.1f}")


if __name__ == "__main__":
    typer.run(main)
