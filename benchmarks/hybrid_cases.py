"""Hybrid motion and force on walls: the cases of a learning framework's controller tests, rebuilt.

The goals, walls and stiffnesses are those of "test_franka_hybrid_decoupled_motion",
"test_franka_hybrid_variable_kp_impedance" and "test_franka_taskframe_hybrid" of Isaac Lab's
operational-space controller (isaac-sim/IsaacLab, source/isaaclab/test/controllers): the finger of a
Panda presses on a wall and goes from goal to goal along it.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

import osc_contact as osc
from osc_contact.lab.sweeps.rows import record_sample, without_logged_doubts
from osc_contact.lab.sweeps.study import SweepStudy
from osc_contact.spatial import Array
from paper.study import PANDA, table_of

FOLDER = Path(__file__).parent
UNKNOWN = (
    "model_error.arm_mass=uniform(0.9, 1.1)",
    "model_error.object_mass=uniform(0.8, 1.2)",
    "plant.friction=uniform(0, 0.3)",
)
RADIUS = 0.01  #: m, of the finger tip
MUJOCO: Any = {"type": "mujoco", "step": 2.5e-4}
STAY_S = 0.5  #: at each goal; theirs: 2.5 s or 7.5 s with the way


class Goal(NamedTuple):
    """Desired position and force of the finger.

    Attributes:
        point: (3,) in the robot's base (m); what counts is where it is along the wall.
        turn: about the world's y axis, from the hand pointing along the wall's normal (rad).
        force: N.
    """

    point: tuple[float, float, float]
    force: float
    turn: float = 0.0


class Case(NamedTuple):
    """One test.

    Attributes:
        name: name of the case in the other software.
        wall: a point of its front.
        normal: out of it, towards the robot.
        goals: one after the other.
        stiffness: 1/s². damping_ratio.
        posture: (7,) rad, near which the arm reaches all goals away from its joints' limits.
        move_s: time from goal to goal (s).
    """

    name: str
    wall: Array
    normal: Array
    goals: tuple[Goal, ...]
    stiffness: float
    damping_ratio: float
    posture: tuple[float, ...]
    move_s: float = 2.0

    @property
    def damping(self) -> float:
        """1/s."""
        return 2.0 * self.damping_ratio * self.stiffness**0.5


_S = float(np.sqrt(0.5))
_WALL = np.array([0.645, 0.0, 0.7])
_TILTED_WALL = np.array([0.685 - 0.005 * _S, 0.0, 0.3 + 0.005 * _S])
_BACK = np.array([-1.0, 0.0, 0.0])
_UPRIGHT = (
    Goal((0.6, 0.2, 0.5), 10.0),
    Goal((0.6, -0.29, 0.6), 10.0),
    Goal((0.6, 0.1, 0.8), 4.0, turn=-0.3398),  # the quaternion (0.5774, 0, 0.8165, 0), xyzw
)
_TILTED = tuple(Goal(p, 10.0) for p in ((0.6, 0.15, 0.3), (0.6, -0.3, 0.3), (0.8, 0.0, 0.5)))
_FORWARD = (-1.379, -1.426, 1.348, -2.041, 2.524, 2.806, -0.38)
_DOWN = (1.663, 0.918, -1.432, -2.164, 1.646, 2.707, 0.0)
CASES = (
    Case("decoupled_motion", _WALL, _BACK, _UPRIGHT, 300.0, 1.0, _FORWARD),
    Case("variable_kp", _WALL, _BACK, _UPRIGHT, 160.0, 0.8, _FORWARD),
    Case("task_frame", _TILTED_WALL, np.array([-_S, 0.0, _S]), _TILTED, 400.0, 1.0, _DOWN),
)


def scenario_of(case: Case, **changes: Any) -> osc.Scenario:
    """A Panda whose finger starts in contact at the first goal and moves on to the others.

    Args:
        case: one of `CASES`.
        changes: other keys.
    """
    times = goal_times(case)
    pitch = float(np.arctan2(-case.normal[0], -case.normal[2]))  # of the hand's z axis, about y
    motion = []
    force = [{"type": "constant", "value": case.goals[0].force}]
    for start, (one, two) in zip(times, pairwise(case.goals), strict=False):
        rise = {"type": "minimum_jerk", "start": start, "duration": case.move_s}
        way = _on_wall(case, two) - _on_wall(case, one)
        moves = (
            ("linear", way, float(np.linalg.norm(way))),
            ("angular", [0, 1, 0], two.turn - one.turn),
        )
        for kind, direction, value in moves:
            signals = [rise | {"value": value}]
            motion.append({"kind": kind, "direction": direction, "signals": signals})
        force.append(rise | {"value": two.force - one.force})
    locked = {"panda_finger_joint1": 0.01, "panda_finger_joint2": 0.01}
    first = {"xyz": _on_wall(case, case.goals[0]), "rpy": [0.0, -pitch, np.pi]}
    wall = {"xyz": case.wall, "rpy": [0.0, pitch + np.pi, 0.0]}
    contact = {
        "name": "finger",
        "type": "sphere_on_plane",
        "body": "wall",
        "centre": [0, 0, 0],
        "radius": RADIUS,
        "face_point": [0, 0, 0],
        "face_normal": [0, 0, 1],
    }
    data = {
        "name": f"hybrid_{case.name}",
        "arms": [PANDA | {"locked_joints": locked, "posture": case.posture}],
        "object": {"urdf": str(FOLDER / "finger.urdf"), "pose": first},
        "grasps": {"panda": {"xyz": [0.0, 0.0, 0.02]}},
        "environment": [{"name": "wall", "urdf": str(FOLDER / "wall.urdf"), "pose": wall}],
        "contacts": [contact],
        "force": {"finger": force},
        "motion": motion,
        "gains": {
            "motion": {"stiffness": case.stiffness, "damping": case.damping},
            "force": {"integral": 30.0, "damping": 400.0},
        },
        "control": {"rate": 1000.0},
        "plant": MUJOCO,
        "duration": times[-1],
    }
    return osc.Scenario.from_dict(data | changes)


def goal_times(case: Case) -> list[float]:
    """Times at which the object has to be at rest at each goal (s)."""
    return [(i + 1) * STAY_S + i * case.move_s for i in range(len(case.goals))]


def judge(case: Case, recording: osc.Recording) -> Array:
    """(goals, 3) errors at the end of each: force (N), place along the wall (m), turn (rad)."""
    rate = float(recording.meta["control_rate_hz"])
    n = case.normal
    out = []
    for t, goal in zip(goal_times(case), case.goals, strict=True):
        k = min(round(t * rate), len(recording)) - 1
        off = recording["pose"][k, :3] - _on_wall(case, goal)
        place = np.linalg.norm(off - n * (n @ off))
        turn = np.linalg.norm(recording["motion_error"][k, 3:])
        out.append((abs(recording["alpha_true"][k, 0] - goal.force), place, turn))
    return np.array(out)


def judge_samples(case: Case, count: int) -> Array:
    """(count, goals, 3) the same of runs in which masses and friction are not what is believed."""
    study = SweepStudy.of(scenario_of(case), UNKNOWN, count)
    with without_logged_doubts():
        return np.array([judge(case, record_sample(study, study.sample(i))) for i in range(count)])


def _on_wall(case: Case, goal: Goal) -> Array:
    """(3,) where the middle of the finger tip is when it touches."""
    n = case.normal
    return goal.point + n * (RADIUS - n @ (goal.point - case.wall))


# --- Errors at the goals of all cases: `python -m benchmarks.hybrid_cases` ---


SAMPLES = 16


def main() -> None:
    """Run every case, alone and with what is not known; print the errors."""
    titles = {1: "exact model, no friction", SAMPLES: f"largest of {SAMPLES}: masses, friction"}
    for count, title in titles.items():
        rows = []
        for case in CASES:
            if count == 1:
                found = judge(case, osc.run(scenario_of(case)))
            else:
                found = judge_samples(case, count).max(axis=0)
            for i, (force, place, turn) in enumerate(found):
                rows.append(
                    f"{case.name}; {i + 1}; {case.goals[i].force:g} N; {force:.2f} N; "
                    f"{1e3 * place:.1f} mm; {1e3 * turn:.1f} mrad"
                )
        heads = "case; goal; force; error; along the wall; turn"
        Console().print(table_of(title, heads, rows))


if __name__ == "__main__":
    main()
