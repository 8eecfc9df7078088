"""The square peg by other laws: the stages of our plan, with their ends, speeds and forces.

    python -m benchmarks.peg_rivals [--count 5] [--seed 5000] [--only NAME]

World and insertions are those of `benchmarks.assembly`, one row for each law and seed.

* `selection`: the axes of the modelled hole through the middle of the tip. In place of our contacts
  of each stage, force is commanded along z, or x, y and z, or x and y with no couple about z; the
  sums of forces are ours. The axes are approached and lost as our contacts are. In the hole both
  laws are the same: five axes at zero.
* impedance, admittance and position control are those of `benchmarks.guided_laws`, which know no
  contacts and press by motions that yield. The check for encoders that stand still is off.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import typer

import osc_contact as osc
from benchmarks.assembly import DEFAULTS, compare
from benchmarks.guided_laws import LAWS, MADE, SPEED, controlled_by, release
from benchmarks.two_pin_rivals import Selected
from osc_contact.contacts.insertion import SIDES
from osc_contact.lab.tasks import pegs
from osc_contact.lab.tasks.insertion import WIDTH, Insertion
from osc_contact.lab.tasks.pegs import Inserted
from osc_contact.plan.ends import End, after, lost, made, pressed
from osc_contact.plan.motions import Motion, along
from osc_contact.plan.plan import Plan
from osc_contact.plan.stage import Stage

PEG = osc.Peg("square", WIDTH)
SELECTION = "selection"  #: name of the rival with selected axes
DOWN, X, Y, TURN = "down", "x", "y", "turn"  #: selected axes of the hole


@dataclass(frozen=True)
class Rival:
    """Law in place of ours.

    Attributes:
        plan: function that makes the plan for a modelled hole.
        laws: function that makes the law of a controller; None: the law is ours, with the contacts
            that the plan names.
    """

    plan: Callable[[osc.Hole], Plan]
    laws: Callable[[], osc.Laws] | None = None

    def controller(self, ours: osc.Controller) -> osc.Controller:
        """Controller with the law of the rival.

        Args:
            ours: controller of the contacts that the plan names.
        """
        return ours if self.laws is None else controlled_by(self.laws(), ours)


# --- selection of axes ----------------------------------------------------------------------------


def selected_axes(hole: osc.Hole) -> dict[str, osc.ContactPair]:
    """Pairs of the selected axes by name.

    Args:
        hole: modelled hole.
    """
    tip = np.zeros(3)
    half = 0.5 * hole.width
    turn = Selected(tip, (False, False, False), (False, False, True), TURN)
    pairs: dict[str, osc.ContactPair] = {TURN: turn}
    for name, side in ((X, SIDES["+x"]), (Y, SIDES["+y"])):
        on = hole.pose.act(half * side)
        pairs[name] = osc.VertexOnFace(tip, on, -hole.pose.rotation @ side, name=name)
    out = -hole.pose.rotation[:, 2]
    pairs[DOWN] = osc.VertexOnFace(tip, hole.pose.translation, out, name=DOWN)
    return pairs


def _selected(stage: Stage) -> dict[str, float]:
    """Forces of the axes in place of the contacts of a stage (N), with the same sums.

    Sides press along x or y, other contacts down. Where nothing presses down while sides are
    pressed, the peg turns, and its couple about z is zero.

    Args:
        stage: stage of our plan.
    """
    forces: dict[str, float] = {}
    for name, force in stage.forces.items():
        axis = {"side +x": X, "side +y": Y}.get(name[:7], DOWN)
        forces[axis] = forces.get(axis, 0.0) + float(np.sum(force))
    return forces if DOWN in forces else {**forces, TURN: 0.0}


def selection_plan(hole: osc.Hole) -> Plan:
    """Plan with selected axes of the modelled hole in place of the contacts.

    Args:
        hole: modelled hole.
    """
    ours = pegs.peg_plan(PEG, hole)
    is_in = pegs.deeper_than(PEG, hole, 2.5e-3, "in the mouth")
    ends: dict[str, End] = {
        "find": made(DOWN, lasting=0.15),
        "drop": made(DOWN, lasting=0.15) & after(0.3),
        "corner": made(X, Y, lasting=0.3) | pegs.resting(),
        "upright": pegs.has_turned(PEG, hole) | (lost(X, Y, lasting=0.5) & is_in),
    }
    alarms = {
        "corner": lost(DOWN, lasting=0.8) & after(1.5),
        "upright": lost(X, Y, lasting=0.8),
    }
    stages = []
    for stage in ours.stages:
        if stage.name == "turn on":  # goes on with fewer contacts; the axes remain
            continue
        if stage.forces and "hole" not in stage.forces:
            stage = replace(
                stage,
                forces=_selected(stage),
                until=ends.get(stage.name, stage.until),
                unless=alarms.get(stage.name),
            )
        stages.append(stage)
    return Plan(stages, largest=ours.largest, tries=ours.tries)


# --- laws without contacts ------------------------------------------------------------------------


def guided_plan(hole: osc.Hole) -> Plan:
    """Plan without contacts: each force is that against a motion which yields.

    Args:
        hole: modelled hole.
    """
    ours = pegs.peg_plan(PEG, hole)
    rotation = hole.pose.rotation
    into = rotation[:, 2]
    outward = rotation @ (SIDES["+x"] + SIDES["+y"])  # towards both rims that are pressed

    def sums(stage: Stage) -> tuple[float, float]:
        """Forces of a stage of our plan: down, and along x (N)."""
        forces = _selected(stage)
        return forces.get(DOWN, 0.0), forces.get(X, 0.0)

    def press(stage: Stage) -> Motion:
        """Motion by which the forces of a stage of our plan are reached."""
        down, aside = sums(stage)
        parts = [along(into, SPEED, yields=down)] if down else []
        if aside:
            parts.append(along(outward, SPEED, yields=np.sqrt(2.0) * aside))
        motion = parts[0]
        for part in parts[1:]:
            motion = motion & part
        return motion

    def half(stage: Stage, direction: np.ndarray) -> End:
        """Condition that half of a stage's force is reached along a direction."""
        force = sums(stage)[0] if direction is into else np.sqrt(2.0) * sums(stage)[1]
        return pressed(MADE * force, direction)

    stages = []
    for stage in ours.stages:
        if stage.name == "turn on":
            continue
        if stage.name == "insert":
            stages.append(release())
            stage = replace(stage, forces={}, places={})
        elif stage.name == "done":  # whether it rests is judged by the truth
            stage = replace(stage, forces={}, until=after(0.5))
        elif stage.forces:
            ends: dict[str, End] = {
                "find": half(stage, into).lasting(0.15),
                "drop": half(stage, into).lasting(0.15) & after(0.3),
                "corner": half(stage, outward).lasting(0.3) | pegs.resting(),
                "upright": pegs.has_turned(PEG, hole),
            }
            motion = press(stage)
            if stage.name in ("slide", "upright"):
                motion = motion & stage.motion
            until = ends.get(stage.name, stage.until)
            stage = replace(stage, forces={}, motion=motion, until=until, unless=None, places={})
        stages.append(stage)
    return Plan(stages, largest=ours.largest, tries=ours.tries)


RIVALS = {
    "ours": Rival(lambda hole: pegs.peg_plan(PEG, hole)),
    SELECTION: Rival(selection_plan),
    **{name: Rival(guided_plan, laws) for name, laws in LAWS.items()},
}


def insert_by(rival: Rival, seed: int) -> Inserted:
    """Result of an insertion of a square peg by a law.

    Args:
        rival: plan and law.
        seed: seed of everything random.
    """
    clearance, offset, tilt = DEFAULTS["square"]
    task = Insertion(PEG, 1e-3 * clearance, seed, 1e-3 * offset, float(np.radians(tilt)))
    plan = rival.plan(task.hole)
    pairs = {**osc.pairs_between(task.peg, task.hole), **selected_axes(task.hole)}
    robot = task.robot(pegs.peg_start(task.peg, task.hole))
    controller = rival.controller(pegs.controller_for(task.model, pairs, plan, robot))
    osc.run_loop(robot, controller, plan, check=False)
    return pegs.judged(task, robot, plan)


def main(count: int = 5, seed: int = 5000, only: str = "") -> None:
    """Print one row for each law and seed, and a summary of each law.

    Args:
        count: number of seeds.
        seed: first seed.
        only: laws whose name contains this.
    """
    compare({name: partial(insert_by, rival) for name, rival in RIVALS.items()}, count, seed, only)


if __name__ == "__main__":
    typer.run(main)
