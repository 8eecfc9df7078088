"""MJCF arms that nobody here wrote: 10 N on a tilted wall, in a circle, with default gains.

    python -m benchmarks.mjcf_arms --folder robosuite/models/assets/robots

For each arm of a checkout or wheel of robosuite (not a dependency), with the rotor inertia of its
file, without and with 0.5 kg m² in every joint: rms force error, overshoot of the first contact,
contact, verdict. Where the wall stands follows from the posture that `osc-contact new` takes.
"""

from __future__ import annotations

import argparse
import logging
import tempfile
from pathlib import Path

import numpy as np

import osc_contact as osc
from osc_contact.contacts.pairs.pair import triad
from osc_contact.runs.drafts import Press, draft

#: Folder of each arm → its tip.
ARMS = dict.fromkeys(
    ("iiwa", "jaco", "kinova3", "panda", "sawyer", "spot_arm", "ur5e", "xarm7"), "right_hand"
)
CIRCLE_MM = 20.0


def scenario_of(file: Path, tip: str, folder: Path) -> Path:
    """The file of a scenario in which an arm presses 10 N and draws a circle, 0.5 Hz.

    Args:
        file: MJCF of the arm. tip: its body or site. folder: where the scenario goes.
    """
    arm = osc.Arm.from_mjcf(file, name="arm", tip=tip)
    target = folder / f"{file.parent.name}.yaml"
    target.write_text(draft(str(file), arm, Press.parse("Z=10"), None, target))
    return target


def _circle(path: Path) -> list[str]:
    """Changes of a drafted scenario: 10 N at once, and a circle in the wall's plane."""
    normal = np.array(osc.load_scenario(path).contacts[0].face.normal)
    moves = ", ".join(
        f"{{kind: linear, direction: [{x}, {y}, {z}], signals: [{{type: sine, ramp: 1 s, "
        f"amplitude: {CIRCLE_MM} mm, frequency: 0.5 Hz, phase: {phase} deg}}]}}"
        for (x, y, z), phase in zip(triad(normal)[:, :2].T, (0, 90), strict=True)
    )
    return [f"motion=[{moves}]", "force.ball=[{type: constant, value: 10 N}]", "gains={}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--arms", nargs="+", default=list(ARMS))
    given = parser.parse_args()
    logging.disable(logging.WARNING)
    print(f"{'arm':10} armature  force error, rms  overshoot  closed  verdict")
    with tempfile.TemporaryDirectory() as folder:
        for name in given.arms:
            try:
                path = scenario_of(given.folder / name / "robot.xml", ARMS[name], Path(folder))
                for rotors in (None, 0.0, 0.5):
                    changes = [*_circle(path), "duration=3 s"]
                    if rotors is not None:
                        changes.append(f"arms.arm.armature={rotors}")
                    verdict = osc.metrics(osc.run(osc.load_scenario(path, changes)))
                    (force,) = verdict["force"].values()
                    first = verdict["steps"][0]
                    print(
                        f"{name:10} {'file' if rotors is None else rotors!s:8}  "
                        f"{force['rms_error_rel']:16.4%}  {first['overshoot_rel']:9.1%}  "
                        f"{min(verdict['contact_fraction'].values()):6.1%}  "
                        f"{verdict['task']['word']}",
                        flush=True,
                    )
            except osc.OscContactError as error:
                print(f"{name:10} {error}", flush=True)


if __name__ == "__main__":
    main()
