"""A robot follows a curved ramp with a commanded force, as on a test bench with published figures.

    python -m benchmarks.ramp [--only "35 N"] [--workers 2]

The ramp, its speeds, forces and figures are those of Gadringer, Gattringer and Müller (Mechanical
Sciences, 2022), who measured a UR10e and an active flange; `MEASURED` cites their summary. Here a
UR10 carries a flange of the same mass with a ball at its end, approaches, lands, stands and, 4 s
after the start, follows the ramp with default gains at 500 Hz. Unknown to the controller are a
joint friction of 1 % of the limits and a coefficient of 0.1 at the ramp. The wrist has the noise of
a force sensor. The judge is MuJoCo with a plane that each step puts where the exact ramp is nearest
to the ball.
"""

import tempfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer
from rich.console import Console

import osc_contact as osc
from benchmarks.curved_faces import TangentPlane
from benchmarks.measuring import side_by_side, table_from
from osc_contact.lab.rig.rig import PLANTS
from osc_contact.lab.sweeps.rows import without_logged_doubts
from osc_contact.spatial import Array
from paper.study import Data

FORCES = (15.0, 35.0, 55.0)  #: N
SPEEDS = (0.10, 0.25)  #: m/s, along the ramp
BAND = 0.05  #: of the command; the force has settled where it stays within
STANDS = 4.0  #: s, from the start, with approach and landing, to the beginning of the path
RESTS = 0.5  #: s, after the path's end
ACCELERATION = 0.7  #: m/s², along the path
BALL = 0.012  #: m, radius
FLANGE = 6.86  #: kg
START = np.array(
    [0.7, 0.25, 0.2]
)  #: origin of the ramp's profile in world, which runs along −y (m)
LENGTH = 0.475  #: m, of the path, seen from above; it begins at 10 mm
BEGIN = 0.01
CREST = 0.39  #: m; from there on the tool is upright
BLEND = 0.03  #: m, along the path
EARLY = 0.1  #: s, in which the splines of the motions begin before the path does; part of the path
SPACING = 0.03  #: s, about, between the points of a motion
PLANT = "ramp"
#: Slope at the end (deg) and radius (m, > 0: hollow) of each arc, one after the other.
ARCS = ((-37.67, -0.2), (0.0, 0.25), (28.36, 0.1), (0.0, -0.1), (-28.36, -0.1), (0.0, 0.1))
FLAT = (-0.06, 0.02)  #: m, the level part before them
BEHIND = 0.1  #: m, level part after them
#: By speed (m/s) and force (N), UR force mode with gain scaling 1, then the flange: settling time
#: (s), largest and mean deviation on the path (N); None: aborted.
MEASURED: dict[tuple[float, float], tuple[tuple[float, float, float] | None, ...]] = {
    (0.10, 15.0): ((1.10, 221.0, 5.51), (0.24, 64.0, 2.60)),
    (0.10, 35.0): ((0.44, 173.0, 6.04), (0.22, 77.0, 3.29)),
    (0.10, 55.0): ((0.53, 153.0, 6.90), (0.21, 91.0, 4.10)),
    (0.25, 15.0): ((1.00, 382.0, 14.1), (0.22, 411.0, 5.73)),
    (0.25, 35.0): ((0.57, 432.0, 14.8), (0.29, 216.0, 5.33)),
    (0.25, 55.0): (None, (0.18, 262.0, 5.82)),
}
TOOL = f"""<robot name="flange"><link name="flange">
<inertial><origin xyz="0 0 0.12"/><mass value="{FLANGE}"/>
<inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.012"/></inertial>
<visual><origin xyz="0 0 0.12"/>
<geometry><cylinder radius="0.05" length="0.16"/></geometry></visual>
<collision><geometry><sphere radius="{BALL}"/></geometry></collision></link></robot>"""
RAMP = """<robot name="ramp"><link name="ramp">
<visual><geometry><box size="1 1 0.001"/></geometry></visual>
<collision><geometry><box size="1 1 0.001"/></geometry></collision></link></robot>"""


class Piece(NamedTuple):
    """Arc or level part of the profile.

    Attributes:
        first, last: ends of the path along the ramp (m).
        centre: (2,) along the ramp and up (m); of a level part its first end.
        radius: m, > 0: hollow, < 0: a crest, inf: level.
    """

    first: float
    last: float
    centre: Array
    radius: float

    def foot(self, p: Array) -> Array:
        """Point (2,) of the whole circle, or line, nearest to p (2,) (m)."""
        if np.isinf(self.radius):
            return np.array([p[0], self.centre[1]])
        away = p - self.centre
        return self.centre + abs(self.radius) * away / float(np.hypot(*away))


def _pieces() -> list[Piece]:
    """Pieces of the profile, whose slopes agree where they meet."""
    out = [Piece(*FLAT, np.array([FLAT[0], 0.0]), np.inf)]
    place, slope = np.array([FLAT[1], 0.0]), 0.0
    for degrees, radius in ARCS:
        centre = place + radius * np.array([-np.sin(slope), np.cos(slope)])
        slope = np.deg2rad(degrees)
        end = centre - radius * np.array([-np.sin(slope), np.cos(slope)])
        out.append(Piece(place[0], end[0], centre, radius))
        place = end
    return [*out, Piece(place[0], place[0] + BEHIND, place, np.inf)]


PIECES = _pieces()


def height(s: float) -> float:
    """Height (m) of the ramp at s along it (m)."""
    for piece in PIECES:
        if piece.first <= s <= piece.last:
            rise = piece.radius**2 - (s - piece.centre[0]) ** 2
            level = np.isinf(piece.radius)
            return float(piece.centre[1] - (0.0 if level else np.sign(piece.radius) * rise**0.5))
    raise ValueError(f"{s} m is beyond the ramp")


def foot_on_ramp(p: Array) -> tuple[Array, Array]:
    """Point (2,) of the ramp nearest to p (2,), along the ramp and up, and the normal (2,) there.

    Args:
        p: m; above the ramp and nearer to it than the centres of its hollow arcs.
    """
    for piece in PIECES:
        foot = piece.foot(p)
        if piece.first <= foot[0] <= piece.last:
            if np.isinf(piece.radius):
                return (foot, np.array([0.0, 1.0]))
            return (foot, (piece.centre - foot) / piece.radius)
    raise ValueError(f"{p} m is beyond the ramp")


class RampPlant(TangentPlane):
    """MujocoPlant whose one face is put, before each step, where the ramp is nearest."""

    def _put(self) -> None:
        """Put the face, whose upper side is 0.5 mm above its origin."""
        self._mj.mj_kinematics(self.model, self.data)
        _, y, z = self.data.xpos[self.object_body] - START
        foot, normal = foot_on_ramp(np.array([-y, z]))
        n = np.array([0.0, -normal[0], normal[1]])
        face = self.model.body("face0/root").id
        self.model.body_pos[face] = START + [0.0, -foot[0], foot[1]] - 0.0005 * n
        half = np.array([1.0 + n[2], -n[1], n[0], 0.0])  # from z to n the shortest way
        self.model.body_quat[face] = half / np.linalg.norm(half)


def ramp_plant(rig: Any, seed: int) -> RampPlant:
    """Plant of the ramp; register it as `PLANT`."""
    plant: Any = PLANTS["mujoco"](rig, seed)
    plant.__class__ = RampPlant  # which keeps nothing of its own
    found: RampPlant = plant
    return found


def _mesh(path: Path) -> None:
    """Write the ramp as an OBJ, 60 mm wide, its x along the ramp."""
    along = np.linspace(-0.055, 0.55, 606)
    across = (-0.03, -0.01, 0.01, 0.03)
    lines = [f"v {s:.9g} {w:.9g} {height(s):.9g}" for s in along for w in across]
    n = len(across)
    first = [n * i + k for i in range(len(along) - 1) for k in range(1, n)]
    lines += [f"f {k} {k + n} {k + n + 1} {k + 1}" for k in first]
    path.write_text("\n".join(lines))


def path_points(speed: float) -> Array:
    """Times (s), places along the ramp and up (m), and slopes (rad) of a path.

    The places are those of the ball's middle from the path's beginning, at a constant speed of the
    contact along the ramp. The tool is turned by the slopes: means over `BLEND`, 0 behind `CREST`.

    Returns:
        (k, 4), one row for each time.
    """
    s = np.linspace(BEGIN, BEGIN + LENGTH, 2000)
    z = np.array([height(x) for x in s])
    arc = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(s), np.diff(z)))))
    rise = speed / ACCELERATION
    lasts = arc[-1] / speed + rise
    t = np.linspace(0.0, lasts, int(np.ceil(lasts / SPACING)) + 1)
    begun = 0.5 * ACCELERATION * np.minimum(t, rise) ** 2
    ended = 0.5 * ACCELERATION * np.maximum(t - (lasts - rise), 0.0) ** 2
    way = begun + speed * np.maximum(t - rise, 0.0) - ended
    slope = np.where(s < CREST, np.gradient(z, s), 0.0)
    edge = np.concatenate(([0.0], np.cumsum(np.arctan(slope[1:]) * np.diff(arc))))
    lo, hi = np.maximum(way - BLEND / 2, 0.0), np.minimum(way + BLEND / 2, arc[-1])
    turn = (np.interp(hi, arc, edge) - np.interp(lo, arc, edge)) / (hi - lo)
    out = []
    for time, at, slope_here in zip(t, np.interp(way, arc, s), turn, strict=True):
        foot, normal = foot_on_ramp(np.array([at, height(at)]))
        middle = foot + BALL * normal - [BEGIN, BALL]
        out.append([time, *middle, slope_here])
    return np.array(out)


def _moves(speed: float) -> list[Data]:
    """Motions of a scenario: along the ramp, up, and about the axis across it."""
    rows = path_points(speed)
    still = np.zeros((round(STANDS / SPACING), 4))
    still[:, 0] = np.linspace(0.0, STANDS, len(still), endpoint=False)
    rows[:, 0] += STANDS
    rows = np.vstack((still, rows))
    axes = {"linear": ([0, -1, 0], [0, 0, 1]), "angular": ([-1, 0, 0],)}
    lines = [(kind, line) for kind, some in axes.items() for line in some]
    return [
        {
            "kind": kind,
            "direction": line,
            "signals": [{"type": "points", "points": rows[:, [0, i]].tolist()}],
        }
        for i, (kind, line) in enumerate(lines, start=1)
    ]


def scenario(folder: Path, force: float, speed: float) -> osc.Scenario:
    """The task.

    Args:
        folder: folder of its files.
        force: N.
        speed: m/s.
    """
    (folder / "flange.urdf").write_text(TOOL)
    (folder / "ramp.urdf").write_text(RAMP)
    _mesh(folder / "ramp.obj")
    begin = (START + [0.0, -BEGIN, BALL]).tolist()
    ramp = START.tolist()
    data: Data = {
        "name": "ramp",
        "description": f"{force:g} N, {speed:g} m/s",
        "arms": [
            {
                "name": "ur10",
                "urdf": "example-robot-data:ur10",
                "tip": "tool0",
                "wrist_sensor": "tool0",
                "posture": [0.2, -1.4, 1.9, -2.1, -1.57, 0.3],
            }
        ],
        "object": {"urdf": "flange.urdf", "pose": {"xyz": begin}},
        "grasps": {"ur10": {"xyz": [0, 0, 0.2], "rpy": ["180 deg", 0, 0]}},
        "environment": [{"name": "ramp", "urdf": "ramp.urdf", "pose": {"xyz": ramp}}],
        "contacts": [
            {
                "name": "ball",
                "type": "sphere_on_surface",
                "body": "ramp",
                "centre": [0, 0, 0],
                "radius": BALL,
                "surface": {"type": "mesh", "file": "ramp.obj", "cells": [64, 1]},
                "surface_x": [0, -1, 0],
            }
        ],
        "force": {"ball": [{"type": "constant", "value": force}]},
        "motion": _moves(speed),
        "tare": {},
        "control": {"rate": "500 Hz", "safety": {"speed_ceiling": 1.5}},
        "plant": {"type": PLANT, "step": "0.25 ms", "friction": 0.1, "joint_friction": 0.01},
        "sensors": {
            "wrist": {"rate": "500 Hz", "force": {"noise": 0.1}, "torque": {"noise": 0.005}}
        },
        "duration": STANDS + float(path_points(speed)[-1, 0]) + RESTS,
    }
    return osc.Scenario.from_dict(data, folder / "task.yaml")


@dataclass(frozen=True)
class Verdict:
    """Metrics of a run on the ramp.

    Attributes:
        settling: time from the first contact until the force stays within `BAND`, while the tool
            stands (s); nan: it does not.
        largest, mean: deviation of the true contact force from its command on the path (N).
        closed: share of the path in contact.
    """

    settling: float
    largest: float
    mean: float
    closed: float


def judged(t: Array, force: Array, command: float, begin: float, end: float) -> Verdict:
    """Judge a contact force.

    Args:
        t: (k,) times (s).
        force: (k,) true force (N); 0: no contact.
        command: N.
        begin, end: times at which the path begins and ends (s).
    """
    error = np.abs(force - command)
    stands = t < begin
    touched = np.flatnonzero(force > 0.0)
    settling = np.nan
    if len(touched) and stands[touched[0]]:
        outside = np.flatnonzero(stands & (error > BAND * command))
        last = outside[-1] + 1 if len(outside) else touched[0]
        if last < len(t) and stands[last]:
            settling = float(max(t[last] - t[touched[0]], 0.0))
    path = (t >= begin) & (t <= end)
    return Verdict(
        settling,
        float(error[path].max()),
        float(error[path].mean()),
        float(np.mean(force[path] > 0.0)),
    )


@without_logged_doubts()
def run(force: float, speed: float) -> tuple[Verdict, str]:
    """Verdict and last word of a run.

    Args:
        force: N.
        speed: m/s.
    """
    osc.register_plant(PLANT)(ramp_plant)  # at run time: importing leaves the register as it is
    with tempfile.TemporaryDirectory() as folder:
        task = scenario(Path(folder), force, speed)
        recording = osc.run(task)
        word = osc.metrics(recording)["task"]["word"]
    end = STANDS + float(path_points(speed)[-1, 0])
    found = judged(recording["t"], recording["alpha_true"][:, 0], force, STANDS - EARLY, end)
    return (found, word)


def row(speed: float, force: float, found: Verdict, word: str) -> Data:
    """Line of the table: simulated, then measured.

    Args:
        speed: m/s.
        force: N.
        found: results of the simulation.
        word: word of its verdict.
    """

    def text(numbers: tuple[float, float, float] | None) -> str:
        return "aborted" if numbers is None else "{:.2f}; {:.0f}, {:.2f}".format(*numbers)

    force_mode, flange = MEASURED[speed, force]
    return {
        "v (m/s)": f"{speed:.2f}",
        "F (N)": f"{force:g}",
        "simulated, UR10": f"{found.settling:.2f}; {found.largest:.1f}, {found.mean:.2f}",
        "in contact": f"{found.closed:.3f}",
        "end": word,
        "measured, force mode": text(force_mode),
        "measured, flange": text(flange),
    }


def main(only: str = "", workers: int = 2) -> None:
    """Print the table.

    Args:
        only: cases, such as "35 N, 0.1 m/s", whose name contains this.
        workers: processes.
    """
    cases = [(f, v) for v, f in product(SPEEDS, FORCES) if only in f"{f:g} N, {v:g} m/s"]
    found = side_by_side(run, cases, workers)
    rows = [row(v, f, *one) for (f, v), one in zip(cases, found, strict=True)]
    title = "Settling time (s); largest, mean deviation on the path (N)"
    Console().print(table_from(title, rows))


if __name__ == "__main__":
    typer.run(main)
