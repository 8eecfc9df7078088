"""A second contact, commanded in the air: when it is closed, and what the first one does.

    python -m benchmarks.handovers [--seconds 6] [--seed 0]

A Panda presses a rounded nose on a floor with 6 N; the friction of the floor is unknown to the
controller. From 1.5 s on another tip of the tool, 15 mm in front of a wall, is commanded to press
on it with 2 N. Lines of force that pass 30 mm apart, and lines that meet where the nose touches:
these also with 6 N, more than friction of the nose may explain. Wrist noise 0.2 N and 10 mN m,
encoders of 18 bits, joint friction of 1 %, default safety. One row for each case is printed, with
the times from 1 N, and from 1 N more than friction of the nose may be where lines meet, until the
contact is closed (negative: before that force); the exit code is 1 where a contact is closed in
the air.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console

import osc_contact as osc
from osc_contact.control.status import Phase
from osc_contact.settings.control import PhaseSettings
from osc_contact.spatial import Array
from paper.study import PANDA, table_of

FOLDER = Path(__file__).parent
RADIUS = 0.01  #: m, of the tips
NOSE = np.array([0.45, 0.0, 0.3])  #: where the middle of the nose starts
PRESSED = 6.0  #: N, of the nose
SIDE = 2.0  #: N, of the other tip
CERTAIN_SIDE = 6.0  #: N, of the other tip where friction of the nose cannot explain its force
COMMANDED_AT = 1.5  #: s
MADE_AT = 1.0  #: N that friction cannot explain, from which on a contact is to be closed
#: N, the same where all friction that is permitted may explain the force.
CERTAIN_AT = PhaseSettings().friction_bound * PRESSED + MADE_AT
FRICTION = (0.0, 0.2, 0.5)
SENSORS = {
    "encoder": {"rate": 1000.0, "angle": {"resolution": 2.0 * np.pi / 2**18}},
    "wrist": {"rate": 1000.0, "force": {"noise": 0.2}, "torque": {"noise": 0.01}},
}
JOINT_FRICTION = 0.01
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
POSTURE = (0.0, 0.2, 0.0, -2.2, 0.0, 2.4, 0.78)


@dataclass(frozen=True)
class Tip:
    """The second tip: its middle in the tool (m), and the direction into its wall in the world."""

    name: str
    middle: tuple[float, float, float]
    into: tuple[float, float, float]


APART = Tip("pass 30 mm apart", (0.04, 0.03, -0.02), (1.0, 0.0, 0.0))
_LENGTH = float(np.hypot(0.1, 0.03))
MEETING = Tip("meet at the nose", (0.1, 0.0, -0.02), (0.1 / _LENGTH, 0.0, 0.03 / _LENGTH))


def scenario_of(
    tip: Tip,
    friction: float,
    gap: float = 0.015,
    seconds: float = 6.0,
    side: float = SIDE,
    **control: Any,
) -> osc.Scenario:
    """Nose on the floor; the other tip moves so far from its wall before its contact is commanded.

    Args:
        tip: the second tip.
        friction: coefficient of floor and wall.
        gap: distance of the second tip from its wall as its contact is commanded (m).
        seconds: duration of the run (s).
        side: force commanded of the second tip (N).
        control: keys of the scenario's control.
    """
    into = np.array(tip.into)
    x, y, z = tip.middle
    touched = NOSE + (x, -y, -z) + RADIUS * into
    pitch = float(np.arctan2(-into[0], -into[2]))  # of the wall's z axis, out of it
    wall = str(FOLDER / "wall.urdf")
    floor = {"xyz": (NOSE - (0, 0, RADIUS)).tolist(), "rpy": [0, 0, 0]}
    away = {"type": "minimum_jerk", "value": gap / into[0], "start": 0.3, "duration": 0.8}
    contact = {"type": "sphere_on_plane", "radius": RADIUS}
    face = {"face_point": [0, 0, 0], "face_normal": [0, 0, 1]}
    data: dict[str, Any] = {
        "name": "two_tips",
        "arms": [PANDA | {"locked_joints": dict.fromkeys(FINGERS, 0.01), "posture": POSTURE}],
        "object": {
            "urdf": str(FOLDER / "two_tips.urdf"),
            "pose": {"xyz": NOSE.tolist(), "rpy": [np.pi, 0, 0]},
        },
        "grasps": {"panda": {"xyz": [0.0, 0.0, 0.1]}},
        "environment": [
            {"name": "floor", "urdf": wall, "pose": floor},
            {"name": "wall", "urdf": wall, "pose": {"xyz": touched.tolist(), "rpy": [0, pitch, 0]}},
        ],
        "contacts": [
            contact | face | {"name": "nose", "body": "floor", "centre": [0, 0, 0]},
            contact | face | {"name": "side", "body": "wall", "centre": [x, y, z]},
        ],
        "force": {
            "nose": [{"type": "constant", "value": PRESSED}],
            "side": [{"type": "constant", "value": side}],
        },
        "active": {"side": [[COMMANDED_AT, seconds + 1.0]]},
        "motion": [{"kind": "linear", "direction": [-1, 0, 0], "signals": [away]}],
        "control": {"rate": 1000.0} | control,
        "sensors": SENSORS,
        "plant": {
            "type": "mujoco",
            "step": 2.5e-4,
            "friction": friction,
            "joint_friction": JOINT_FRICTION,
        },
        "duration": seconds,
    }
    return osc.Scenario.from_dict(data)


@dataclass
class Handover:
    """Time series of a run, from the command of the second contact on.

    Attributes:
        t: (n,) time of each tick (s).
        closed: (n,) whether the second contact was reported closed.
        forces: (n, 2) true forces of both contacts (N).
        read: (n, 2) forces of both contacts as read by the controller (N).
    """

    t: Array
    closed: Array
    forces: Array
    read: Array

    @classmethod
    def of(cls, recording: osc.Recording) -> "Handover":
        t = recording["t"]
        since = t >= COMMANDED_AT
        closed = recording["contact_phase"][:, 1] == Phase.CLOSED
        given = (t, closed, recording["alpha_true"], recording["alpha_meas"])
        return cls(*(channel[since] for channel in given))

    @property
    def touched(self) -> int:
        """The tick in which the second tip first presses; after the last one if it never does."""
        return _first(self.forces[:, 1] > 0.0)

    @property
    def closed_in_the_air(self) -> float:
        """s."""
        return 1e-3 * float(np.count_nonzero(self.closed[: self.touched]))

    def delay(self, made_at: float = MADE_AT) -> float:
        """Time from a force of the second tip until its contact is closed (s).

        Args:
            made_at: the force (N).

        Returns:
            NaN if there was no such force, or the contact was never closed.
        """
        pressed = _first(self.forces[:, 1] >= made_at)
        if len(self.t) in (pressed, _first(self.closed)):
            return float("nan")
        return 1e-3 * (_first(self.closed) - pressed)

    @property
    def closed_at(self) -> float:
        """True force (N) with which the second contact was closed; NaN: it was not."""
        k = _first(self.closed)
        return float(self.forces[k, 1]) if k < len(self.t) else float("nan")

    @property
    def off(self) -> tuple[float, float]:
        """The largest error of the nose's force before the other tip touches, and later (N)."""
        error = np.abs(self.forces[:, 0] - PRESSED)
        return (float(error[: self.touched].max()), float(error[self.touched :].max(initial=0.0)))

    @property
    def share(self) -> float:
        """rms that the missing contact reads, of what the nose does."""
        read = self.read[: self.touched]
        return float(np.sqrt(np.mean(read[:, 1] ** 2) / np.mean(read[:, 0] ** 2)))


def _first(truth: Array) -> int:
    return int(np.argmax(truth)) if truth.any() else len(truth)


def row_of(tip: Tip, side: float, friction: float, seconds: float, seed: int) -> list[float]:
    """Numbers of one row of the table.

    Args:
        tip: the second tip.
        side: commanded force of this tip (N).
        friction: coefficient of floor and wall.
        seconds: duration of the run (s).
        seed: seed of the noise.
    """
    scenario = scenario_of(tip, friction, seconds=seconds, side=side)
    found = Handover.of(osc.run(scenario, seed=seed))
    return [
        side,
        friction,
        found.closed_in_the_air,
        100.0 * found.share,
        found.closed_at,
        1e3 * found.delay(),
        1e3 * found.delay(CERTAIN_AT),
        *found.off,
    ]


def main(seconds: float = 6.0, seed: int = 0) -> None:
    """Print the table."""
    heads = (
        "lines of force; commanded (N); friction; closed in the air (s); missing one reads (%); "
        f"closed at (N); after {MADE_AT:g} N (ms); after {CERTAIN_AT:g} N (ms); "
        "nose off before (N); and later (N)"
    )
    rows = []
    wrong = False
    for tip, side in ((APART, SIDE), (MEETING, SIDE), (MEETING, CERTAIN_SIDE)):
        for friction in FRICTION:
            numbers = row_of(tip, side, friction, seconds, seed)
            wrong = wrong or numbers[2] > 0.0
            cells = ("–" if np.isnan(number) else f"{number:.3g}" for number in numbers)
            rows.append((tip.name, *cells))
    Console(width=140).print(table_of("A second contact commanded in the air", heads, rows))
    sys.exit(wrong)


if __name__ == "__main__":
    typer.run(main)
