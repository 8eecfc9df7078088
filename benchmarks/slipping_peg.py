"""A square peg that slips in its gripper in a random stage of the plan.

    python -m benchmarks.slipping_peg [--count 5] [--seed 6000] [--slip 1.0]

The insertions are those of `benchmarks.assembly`. In a stage that is drawn for each seed, once the
hole has pressed on the peg with 3 N, the peg slips relative to the gripper by `slip` (mm) at
10 mm/s, along the force on it. No sensor reads this; the controller and its plan are not told. One
row for each seed: what is printed by `benchmarks.assembly`, the stage, the slip along the axis of
the peg and across it, and the error of the modelled pose of the tip at the end, along the axis of
the true hole. A peg on which no such force acts from this stage on does not slip; it is counted
apart, and not in the shares of the last line.
"""

from __future__ import annotations

import numpy as np
import typer
from rich.console import Console

import osc_contact as osc
from benchmarks.assembly import row_of, summary
from benchmarks.measuring import without_log
from osc_contact.interface import Measurement
from osc_contact.lab.tasks import pegs
from osc_contact.lab.tasks.insertion import CLEARANCE, WIDTH, Insertion, InsertionRobot
from osc_contact.lab.tasks.pegs import Inserted
from osc_contact.plan.plan import Plan
from osc_contact.spatial import Array

STAGES = ("slide", "drop", "two points", "corner", "upright", "insert")  #: of which one is drawn
LEAST = 3.0  #: force at which the peg slips (N)
SPEED = 0.01  #: of the slip (m/s)


class SlippingPeg:
    """Robot whose peg slips once in its gripper.

    Attributes:
        slipped: (3,) displacement of the peg so far, in the axes of the gripper's tip (m).
        slipped_in: name of the stage in which the peg began to slip; empty: it has not.
    """

    def __init__(self, robot: InsertionRobot, plan: Plan, stage: str, slip: float) -> None:
        """Take a robot with its peg at rest.

        Args:
            robot: robot that holds the peg.
            plan: plan of the insertion.
            stage: name of the stage in which the peg slips, or after which.
            slip: distance (m).
        """
        self._robot = robot
        self._plan = plan
        self._slip = slip
        self._body = robot.plant.model.body("object/root").id
        self._along: Array | None = None
        self._is_due = False
        self._stage = stage
        self.slipped_in = ""
        self.slipped = np.zeros(3)
        self.measure = robot.measure
        self.stop = robot.stop

    def command(self, tau: Array, duration: float) -> None:
        """Displace the peg by the slip of a period, and apply torques.

        Args:
            tau: (n_a,) motor torques (N m).
            duration: period (s).
        """
        self._is_due |= self._plan.stage.name == self._stage
        plant = self._robot.plant
        if self._is_due and self._along is None:
            force = -self._robot.contact_forces().sum(axis=0)  # on the peg
            size = float(np.linalg.norm(force))
            if size > LEAST:
                tip = plant.data.xmat[plant.model.body_parentid[self._body]].reshape(3, 3)
                self._along = tip.T @ force / size
                self.slipped_in = self._plan.stage.name
        if self._along is not None and np.linalg.norm(self.slipped) < self._slip:
            step = SPEED * duration * self._along
            self.slipped = self.slipped + step
            plant.model.body_pos[self._body] += step
        self._robot.command(tau, duration)


def insert_slipping(seed: int, slip: float) -> tuple[Inserted, SlippingPeg, float]:
    """Result of an insertion, the peg that has slipped, and the error of its modelled depth (m).

    Args:
        seed: seed of everything random.
        slip: distance by which the peg slips (m).
    """
    task = Insertion(osc.Peg("square", WIDTH), CLEARANCE, seed)
    robot, plan, controller = pegs.prepared(task)
    stage = STAGES[int(np.random.default_rng([seed, 63]).integers(len(STAGES)))]
    slipping = SlippingPeg(robot, plan, stage, slip)
    osc.run_loop(slipping, controller, plan)
    measurement: Measurement = robot.measure()
    modelled = task.true_hole.pose.actInv(task.model.state(measurement.q).X_WO)
    result = pegs.judged(task, robot, plan)
    return result, slipping, float(modelled.translation[2]) - result.depth


@without_log()
def main(count: int = 5, seed: int = 6000, slip: float = 1.0) -> None:
    """Print one row for each seed, and a summary; the slip is in mm."""
    console = Console(width=160, highlight=False)
    results = []
    for k in range(seed, seed + count):
        result, peg, error = insert_slipping(k, 1e-3 * slip)
        if has_slipped(peg, 1e-3 * slip):
            results.append(result)
            axial, across = 1e3 * peg.slipped[2], 1e3 * float(np.hypot(*peg.slipped[:2]))
            words = f"slipped in {peg.slipped_in!r} by {axial:.2f} mm along, {across:.2f} mm across"
        else:
            words = "did not slip" if not peg.slipped_in else "slipped by a part only"
        console.print(
            f"{row_of(k, result)}; {words}; modelled {1e3 * error:.2f} mm too deep", soft_wrap=True
        )
    not_slipped = f"{count - len(results)} of {count} did not slip by {slip:g} mm"
    console.print(f"{not_slipped}; of the others {summary(results)}", soft_wrap=True)


def has_slipped(peg: SlippingPeg, slip: float) -> bool:
    """Test whether a peg has slipped by the whole distance, within a hundredth.

    Args:
        peg: peg after its run.
        slip: distance (m).
    """
    return float(np.linalg.norm(peg.slipped)) > 0.99 * slip


if __name__ == "__main__":
    typer.run(main)
