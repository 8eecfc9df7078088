"""MJCF arms that nobody here wrote: 10 N on a tilted wall, in a circle, with default gains.

    python -m benchmarks.mjcf_arms --folder robosuite/models/assets/robots

For each arm of a checkout or wheel of robosuite (not a dependency), with the rotor inertia of its
file, without and with 0.5 kg m² in every joint: rms force error, overshoot of the first contact,
contact, verdict. Where the wall stands follows from the posture that `osc-contact new` takes.
"""

import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import osc_contact as osc
from osc_contact.contacts.pairs.pair import triad
from osc_contact.runs.poses import Press, draft
from osc_contact.sweeps.sweep import without_logged_doubts

ARMS = ["iiwa", "jaco", "kinova3", "panda", "sawyer", "spot_arm", "ur5e", "xarm7"]  #: folders


def draft_press(robot: str, arm: osc.Arm, target: Path) -> str:
    """Write a scenario in which an arm presses 10 N; the name of its file."""
    target.write_text(draft(robot, arm, Press.parse("Z=10"), None, target))
    return str(target)


def move_on_wall(file: str, frequency: float = 0.5, moves: int = 2) -> list[str]:
    """Changes of a drafted scenario: 10 N at once, and a circle (or a line) in the wall's plane.

    Args:
        file: of the scenario. frequency: Hz. moves: 1: to and fro; 2: a circle.
    """
    contact: Any = osc.load_scenario(file).contacts[0]
    axes = zip(triad(np.array(contact.face.normal)).T[:moves], (0, 90), strict=False)
    signals = ", ".join(
        f"{{kind: linear, direction: [{x}, {y}, {z}], signals: [{{type: sine, ramp: 1 s, "
        f"amplitude: 20 mm, frequency: {frequency} Hz, phase: {phase} deg}}]}}"
        for (x, y, z), phase in axes
    )
    return [f"motion=[{signals}]", "force.ball=[{type: constant, value: 10 N}]", "gains={}"]


@without_logged_doubts()
def judge(file: Path, folder: str) -> None:
    """Print a line for each inertia of the rotors of an arm (MJCF file)."""
    name = file.parent.name
    arm = osc.Arm.from_mjcf(file, name="arm", tip="right_hand")
    path = draft_press(str(file), arm, Path(folder) / f"{name}.yaml")
    for rotors in ("file", "0.0", "0.5"):
        changes = [*move_on_wall(path), "duration=3 s"]
        changes += [] if rotors == "file" else [f"arms.arm.armature={rotors}"]
        verdict = osc.metrics(osc.run(osc.load_scenario(path, changes)))
        (force,) = verdict["force"].values()
        print(
            f"{name:10} {rotors:8}  {force['rms_error_rel']:16.4%}  "
            f"{verdict['steps'][0]['overshoot_rel']:9.1%}  "
            f"{min(verdict['contact_fraction'].values()):6.1%}  {verdict['task']['word']}",
            flush=True,
        )


def main(folder: Annotated[Path, typer.Option()]) -> None:
    """Print the table."""
    print(f"{'arm':10} armature  force error, rms  overshoot  closed  verdict")
    with tempfile.TemporaryDirectory() as drafts:
        for name in ARMS:
            try:
                judge(folder / name / "robot.xml", drafts)
            except osc.OscContactError as error:
                print(f"{name:10} {error}", flush=True)


if __name__ == "__main__":
    typer.run(main)
