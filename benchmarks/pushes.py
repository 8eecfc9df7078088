"""Pushes on the arms of every packaged scenario: do they come back into contact, or stop?

    python benchmarks/pushes.py [--scenario NAME] [--workers 2]

A push is a half sine of force on the wrist of the first arm, off the faces, into or along them,
a second after all contacts were made. One row for each is printed; the exit code is 1
where the forces did not come back within 2 s though the controller did not stop, where an arm still
moved a second later, or where a joint was above its speed limit later than 50 ms after the push.
Arms whose motors cannot bear them off their faces (limited_rod: 48.0 N for a weight of 48.07 N)
sink back onto these when they are stopped, and a free cart may lean on them (moving_face): that is
reported, and not wrong below a tenth of their speed limits.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import typer
from rich.console import Console

import osc_contact as osc
from benchmarks.fault_injection import least_load
from benchmarks.measuring import side_by_side, table_from
from osc_contact.lab.scenarios.hardware import Push
from osc_contact.lab.sweeps.rows import without_logged_doubts
from paper.study import Data

FORCES = (5.0, 20.0, 60.0, 120.0, 200.0)  #: N
DURATIONS = (0.05, 0.1)  #: s
DIRECTIONS = ("off", "into", "along")
BACK_WITHIN = 2.0
SLOW_WITHIN = 0.05  #: s after the push
_STEADY = 0.1  #: s that forces have to be back for
_NEAR = 0.3  #: share of its command that a force is near that without a push; or `_LEAST` N
_LEAST = 1.5
_SETTLING = 1.0  #: s between contact and push
_BRAKED = 1.0  #: s after which arms that were stopped rest: they are held half a second after it
_REST = 0.02
_SINKING = 0.1  #: shares of their speed limits below which joints rest, or sink
LEANING = {"moving_face"}  #: scenarios with a free cart, which may lean on stopped arms


def push_arm(
    name: str, direction: str, force: float, duration: float, changes: Sequence[str] = ()
) -> Data:
    """Push once, at rest in contact; look at the seconds behind it.

    Args:
        changes: overrides of the scenario, as `load_scenario` takes them.

    Returns:
        A row of the table: what is wrong; when all forces were back to stay, and when a joint was
        last above its speed limit (s after the push); the largest speed (share of its limit) and
        force (N).
    """
    rig, begin, calm = _in_contact(name, tuple(changes))
    arm = next(a.name for a in rig.model.arms if a.wrist_sensor is not None)
    push = Push(
        arm=arm, force=(force * _direction(rig, direction)).tolist(), start=begin, duration=duration
    )
    row: Data = {"scenario": name, "direction": direction, "N": force, "s": duration, "wrong": ""}
    try:
        recording = _run(rig, begin + duration + BACK_WITHIN + _STEADY + _BRAKED, push)
    except osc.PlantError as error:
        return row | {"wrong": str(error)}
    since = recording["t"] - begin - duration
    joints = rig.model.actuated
    fastest = rig.model.model.velocityLimit[joints]
    speeds = (np.abs(recording["v"][:, joints]) / fastest).max(axis=1) * (since > -duration)
    late = since[speeds > 1.0].max(initial=0.0)
    true = recording["alpha_true"]
    commanded = recording["alpha_cmd"]
    off = np.abs(true - calm[: len(true)]) > np.maximum(_NEAR * np.abs(commanded), _LEAST)
    pressed = (commanded > _LEAST).any(axis=1)  # else the task has taken the forces away
    back = since[off.any(axis=1) & pressed & (since < BACK_WITHIN + _STEADY)].max(initial=0.0)
    stopped = recording.meta["end_state"] == "SAFE_STOP"
    if late > SLOW_WITHIN:
        row["wrong"] = f"a joint above its speed limit {late:.3f} s after the push"
    elif back >= BACK_WITHIN and not stopped:
        row["wrong"] = "not back"
    elif stopped and speeds[-1] > (_SINKING if name in LEANING or least_load(rig) > 1.0 else _REST):
        row["wrong"] = f"stopped, but a joint moves at {speeds[-1]:.2f} of its speed limit"
    return row | {
        "back": back if back < BACK_WITHIN else None,
        "stopped": stopped,
        "late": late,
        "speed": speeds.max(),
        "force": np.abs(true[since > -duration]).max(initial=0.0),
    }


@cache
def _in_contact(name: str, changes: tuple[str, ...]) -> tuple[osc.Rig, float, np.ndarray]:
    """A scenario's rig, when all contacts are made for a second (s), forces without a push."""
    scenario = osc.load_scenario(name, list(changes))
    if scenario.plant.exact:  # nothing there is pushed: on MuJoCo it is
        scenario = osc.load_scenario(name, [*changes, "plant.type=mujoco", "plant.step=0.25 ms"])
    rig = osc.build_rig(scenario)
    calm = _run(rig, scenario.duration + 5.0)  # s, longer than any push is looked at
    made = osc.metrics(calm)["first_contact_s"].values()
    return (rig, max(made, default=0.0) + _SETTLING, calm["alpha_true"])


@without_logged_doubts()
def _run(rig: osc.Rig, duration: float, *pushes: Push) -> osc.Recording:
    """Run a rig with pushes in place of those that its scenario repeats.

    Args:
        rig: rig with its scenario.
        duration: duration of the run (s).
        *pushes: pushes on the arms.
    """
    plant = rig.scenario.plant
    once = [push for push in plant.pushes if push.every == 0.0]
    plant = plant.model_copy(update={"pushes": (*once, *pushes)})
    scenario = rig.scenario.model_copy(update={"plant": plant, "duration": duration})
    return osc.run(scenario, build=lambda one: replace(rig, scenario=one))


def _direction(rig: osc.Rig, word: str) -> np.ndarray:
    """Unit vector (3,) of a push, in world axes.

    Args:
        rig: rig with its contacts.
        word: "into" the faces (down without contacts), "off" them, or "along" them.
    """
    into = rig.contact.N[:3].sum(axis=1) if rig.pairs else np.zeros(3)
    if not np.linalg.norm(into) > 0.1:
        into = np.array([0.0, 0.0, -1.0])
    lines = {"into": into, "off": -into, "along": np.cross(into, [0.3, 0.9, 0.4])}
    return lines[word] / np.linalg.norm(lines[word])


def main(scenario: list[str] | None = None, workers: int = 2) -> None:
    """Push them all; exit with 1 if anything was wrong."""
    pushes = [*product(scenario or osc.list_scenarios(), DIRECTIONS, FORCES, DURATIONS)]
    rows = [*side_by_side(push_arm, pushes, workers)]
    Console(width=200).print(table_from("pushes", rows))
    wrong = sum(bool(row["wrong"]) for row in rows)
    print(f"{len(rows)} pushes, {wrong} of them wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    typer.run(main)
