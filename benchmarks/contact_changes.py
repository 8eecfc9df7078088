"""Contacts released and activated again: steps of torques, dips of the contacts that stay.

    python -m benchmarks.contact_changes [--only TEXT] [--joint-friction 0.01] [--seed N]

Contacts of packaged scenarios leave the active set at 2 s, one and two at a time, and come back at
3 s, while the scenario goes on. The plate on three posts moves along its own face there, and is led
off posts that are released, by 1 mm, and back once they are made again: its horizontal motion would
press it onto them by up to 5 mm as soon as they are no longer active. Wrist noise 0.2 N and
10 mN m, encoders of 18 bits, joint friction of 1 %, default safety. From each change until 0.3 s
after the last contact has left or landed: the largest change of a motor torque from one tick to the
next, as a share of its limit, and how far the force of a contact that stays falls below its
command, beside the same without a change of contacts. `--joint-friction 0` shows what is left
without it. The exit code is 1 where a limit is missed.
"""

import sys
from itertools import combinations

import numpy as np
import typer
from rich.console import Console

import osc_contact as osc
from benchmarks.measuring import side_by_side, table_from
from osc_contact.contacts.feet import feet
from osc_contact.spatial import Array, norm
from paper.study import Data

SCENARIOS = ("two_contact_rod", "panda_edge", "ur5_wipe", "three_arm_plate", "scara_peg")
RELEASED_S = 2.0
BACK_S = 3.0
WINDOW_S = 0.3
LONGEST_S = 0.7  #: s after a change, in which contacts leave or land
RATE = 1000.0  #: ticks per second
END_S = 4.0
STEP = 0.01  #: of a motor's limit
DIP = 0.5  #: N
LED = "three_arm_plate"  #: scenario whose object is led off contacts that are released
LIFT = 1e-3  #: m
LIFTED_S = 0.5  #: s, duration of that motion
LOWERED_S = 0.5  #: s after `BACK_S`, when it is led back
_TURN = 2.0 * np.pi / 2**18
ERRORS = (
    "sensors.wrist={rate: 1 kHz, force: {noise: 0.2 N}, torque: {noise: 0.01 Nm}}",
    f"sensors.encoder={{rate: 1 kHz, angle: {{resolution: {_TURN} rad}}, "
    f"length: {{resolution: {0.5**18} m}}}}",
)
JOINT_FRICTION = 0.01  #: of each motor's torque limit


def cases(only: str = "") -> list[tuple[str, tuple[str, ...]]]:
    """(scenario, contacts that leave): each alone, each two, none."""
    found: list[tuple[str, tuple[str, ...]]] = []
    for name in SCENARIOS:
        if only in name:
            contacts = [contact.name for contact in osc.load_scenario(name).contacts]
            leaving = [some for k in (1, 2) for some in combinations(contacts, k)]
            found += [(name, some) for some in [(), *leaving]]
    return found


def along_its_face(scenario: osc.Scenario) -> osc.Scenario:
    """The scenario with its motion along the face of its first contact, and about its normal."""
    rig = osc.build_rig(scenario)
    normal = feet(rig.pairs[0], rig.state.X_WO)[1][0]
    motion = []
    for move in scenario.motion:
        d = np.array(move.direction)
        along = d - (d @ normal) * normal if move.kind == "linear" else normal * np.sign(d @ normal)
        motion.append(move.replaced(direction=(along / norm(along)).tolist()))
    return scenario.replaced(motion=motion)


def lifts(scenario: osc.Scenario, leaving: tuple[str, ...]) -> Data:
    """Motion that turns the object off the contacts that leave, about those that stay.

    Args:
        scenario: scenario with three contacts.
        leaving: one or two of them.
    """
    rig = osc.build_rig(scenario)
    points = {pair.name: feet(pair, rig.state.X_WO)[0][0] for pair in rig.pairs}
    normals = {pair.name: -feet(pair, rig.state.X_WO)[1][0] for pair in rig.pairs}
    gone = [points[name] for name in leaving]
    stays = [points[name] for name in points if name not in leaving]
    line = gone if len(gone) == 2 else stays
    axis = (line[1] - line[0]) / norm(line[1] - line[0])
    lever = np.mean(gone, axis=0) - stays[0]
    height = float(np.cross(axis, lever) @ normals[leaving[0]])  # m by which a radian lifts
    angle = LIFT / height
    ways = ((angle, RELEASED_S, LIFTED_S), (-angle, BACK_S + LOWERED_S, 0.3))
    keys = ("value", "start", "duration")
    return {
        "kind": "angular",
        "direction": axis.tolist(),
        "through": stays[0].tolist(),
        "signals": [{"type": "minimum_jerk", **dict(zip(keys, way, strict=True))} for way in ways],
    }


def time_of(recording: osc.Recording, at: float) -> Array:
    """Mask (n,) of the ticks from a change of contacts until `WINDOW_S` after the last phase began.

    Args:
        recording: recording of a run.
        at: time of the change (s).
    """
    t = recording["t"]
    phase = recording["contact_phase"]
    begins = np.any(np.diff(phase, axis=0, prepend=phase[:1]), axis=1)
    begins &= (t >= at) & (t < at + LONGEST_S)
    last = t[begins].max(initial=at)
    window: Array = (t >= at) & (t < last + WINDOW_S)
    return window


def change(
    name: str, leaving: tuple[str, ...], seed: int = 0, joint_friction: float = JOINT_FRICTION
) -> Data:
    """A row of the table.

    Args:
        name: name of the scenario.
        leaving: contacts.
        seed: seed of the noise.
        joint_friction: friction of the plant's joints, as a share of each torque limit.
    """
    intervals = f"[[0 s, {RELEASED_S} s], [{BACK_S} s, {END_S + 1.0} s]]"
    changes = [*ERRORS, f"plant.joint_friction={joint_friction}", f"duration={END_S} s"]
    changes += [f"active.{contact}={intervals}" for contact in leaving]
    scenario = osc.load_scenario(name, changes)
    if name == LED:
        scenario = along_its_face(scenario)
    if name == LED and leaving:
        motion = (*scenario.motion, lifts(scenario, leaving))
        scenario = scenario.replaced(motion=motion)
    recording = osc.run(scenario, seed=seed)
    owners = osc.build_rig(osc.load_scenario(name)).owners
    names = recording.meta["contact_names"]
    stays = np.array([names[owner] not in leaving for owner in owners])
    limits = np.array(list(recording.meta["effort_limits"].values()))
    steps = np.abs(np.diff(recording["tau"], axis=0, prepend=recording["tau"][:1])) / limits
    dips = (recording["alpha_cmd"] - recording["alpha_true"])[:, stays]
    row: Data = {"scenario": name, "leaving": ", ".join(leaving) or "–"}
    for word, at in (("released", RELEASED_S), ("back", BACK_S)):
        window = time_of(recording, at)
        row[f"time, {word} (s)"] = float(np.count_nonzero(window)) / RATE
        row[f"step, {word} (%)"] = 100.0 * float(steps[window].max())
        row[f"dip, {word} (N)"] = float(dips[window].max()) if stays.any() else None
    row["end"] = recording.meta.get("end_reason", "")
    return row


def misses(row: Data) -> bool:
    """Test whether a step (share) or a dip (N) of the forces that remain is above its limit.

    Args:
        row: row of `change`; rows in which no contact leaves are not judged.
    """
    judged = ("step", "dip")
    numbers = {key: row[key] for key in row if key.startswith(judged) and row[key] is not None}
    limits = {key: 100.0 * STEP if key.startswith("step") else DIP for key in numbers}
    return row["leaving"] != "–" and any(numbers[key] > limits[key] for key in numbers)


def main(
    only: str = "", seed: int = 0, workers: int = 2, joint_friction: float = JOINT_FRICTION
) -> None:
    """Print the table."""
    jobs = [(*case, seed, joint_friction) for case in cases(only)]
    rows = list(side_by_side(change, jobs, workers))
    Console(width=150).print(table_from("Contacts that leave and come back", rows))
    sys.exit(any(map(misses, rows)))


if __name__ == "__main__":
    typer.run(main)
