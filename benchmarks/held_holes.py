"""A peg that a hole holds at zero force, the axis of the hole believed wrong.

    python -m benchmarks.held_holes [--count 12] [--workers 2]

A Panda holds a square peg 2 mm deep in a hole of 0.2 mm play. The controller has the hole as a
contact of five columns at zero desired force, its axis 2° and 1 mm beside the true one, each in a
direction of its own for each seed, and leads the peg along that axis to a depth of 21 mm. Wrist
noise 0.2 N and 10 mN m, encoders of 18 bits, joint friction of 1 %, masses wrong by up to 5 %,
friction 0.2, unknown. One row for each seed is printed; the exit code is 1 if a peg is not 20 mm
deep at the end, or if the sum of its contact forces has exceeded 40 N.
"""

import sys
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
import typer
from rich.console import Console

import osc_contact as osc
from benchmarks.measuring import side_by_side, table_from
from osc_contact.jerk_limits import rise
from osc_contact.lab.tasks.insertion import PERIOD, WIDTH, Insertion
from osc_contact.lab.tasks.pegs import METRIC
from osc_contact.spatial import Array
from paper.study import Data

CLEARANCE = 2e-4  #: m
OFFSET, TILT = 1e-3, np.radians(2.0)  #: m, rad, of the believed axis
BEGIN, END = 2e-3, 20e-3  #: m, depths at the start and wanted
GOAL = 21e-3  #: m, depth to which the peg is led; friction keeps it up to 0.6 mm behind
LARGEST = 40.0  #: N
BEGINNING_S, MOVING_S, ENDING_S = 0.3, 4.0, 0.7  #: s at rest, in motion, at rest


@dataclass(frozen=True)
class Beside(Insertion):
    """Peg and hole, the hole displaced by a given size in directions drawn for the seed."""

    @cached_property
    def displacement(self) -> Array:
        """Displacement (6,) of the hole, world axes at its mouth (m, rad)."""
        place, turn = np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, 2)
        d = np.zeros(6)
        d[:2] = OFFSET * np.array([np.cos(place), np.sin(place)])
        d[3:5] = TILT * np.array([np.cos(turn), np.sin(turn)])
        return d


def insert(seed: int, gains: osc.ForceGains | None = None) -> Data:
    """A row of the table.

    Args:
        seed: seed of directions, noise and masses.
        gains: gains of the force loop; None: the default ones.
    """
    task = Beside(osc.Peg("square", WIDTH), CLEARANCE, seed)
    start = task.true_hole.pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, BEGIN]))
    robot = task.robot(start)
    controller = osc.Controller(
        task.model,
        [osc.pairs_between(task.peg, task.hole)["hole"]],
        osc.Gains(force=gains or osc.ForceGains()),
        B=METRIC,
        posture=robot.q_start,
        reading="filter",
        life=osc.PhaseSettings(),
        joint_friction=osc.JointFriction(errors=True),
        safety=osc.SafetySettings(contact_ceiling=60.0, wrist_ceiling=60.0),
    )
    axis = task.hole.pose.rotation[:, 2]
    X = controller.chain.state(robot.measure().q).X_WO
    count = round((BEGINNING_S + MOVING_S + ENDING_S) / PERIOD)
    for t in np.arange(count) * PERIOD:
        s, speed, acceleration = (
            (GOAL - BEGIN) * float(x) for x in np.ravel(rise(np.array([t]), BEGINNING_S, MOVING_S))
        )
        goal = pin.SE3(X.rotation, X.translation + s * axis)
        V_D, A_D = (np.append(x * axis, np.zeros(3)) for x in (speed, acceleration))
        reference = osc.Reference(goal, V_D, A_D, alpha_d=np.zeros(5))
        robot.command(controller.tick(robot.measure(), reference), PERIOD)
        if controller.state is osc.SafetyState.SAFE_STOP:
            break
    return {
        "seed": seed,
        "depth (mm)": 1e3 * float(robot.in_hole().translation[2]),
        "largest force (N)": robot.largest_sum,
        "reason": controller.reason,
    }


def misses(row: Data) -> bool:
    """Test whether a peg is not inserted, or was pressed too hard, by its row."""
    return row["depth (mm)"] < 1e3 * END or row["largest force (N)"] > LARGEST


def main(count: int = 12, workers: int = 2) -> None:
    """Print the table."""
    rows = list(side_by_side(insert, [(seed,) for seed in range(count)], workers))
    Console(width=150).print(table_from("Pegs in holes whose axis is wrong", rows))
    sys.exit(any(map(misses, rows)))


if __name__ == "__main__":
    typer.run(main)
