"""Two pins into two holes with a selection matrix in the two stages that no frame describes.

    python -m benchmarks.two_pin_rivals [--count 5] [--seed 3000] [--only NAME]

Of the stages of the plan of `two_pins`, a frame describes the contacts of all but "left rim" and
"turn": there the left pin presses on its rim and the right one on the face, along skew lines 240 mm
apart. In these two stages each rival has, in place of both contacts, the axes of one frame of the
modelled block. Stages, forces and gains are ours, and so are the approaches of all other stages. A
selection of axes cannot be approached, made or lost: "left rim" ends when the bar rests, "turn"
when the tip has dropped, and forces of either sign are commanded.

* `couple`: the frame at the left rim; force along y, couple about y by which the right tip presses.
* `face only`: the frame at the right tip; force along z, the left pin is held by motion.
* `rim only`: the frame at the left rim; force along y, the right tip is held by motion.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin
import typer

import osc_contact as osc
from benchmarks.assembly import compare
from osc_contact.lab.tasks import two_pin_plan
from osc_contact.lab.tasks.insertion import BELIEVED
from osc_contact.lab.tasks.pegs import Inserted, controller_for, resting
from osc_contact.lab.tasks.two_pin_plan import LEFT_RIM, RIGHT_POINT
from osc_contact.lab.tasks.two_pins import HALF, WIDTH, TwoPins
from osc_contact.plan.plan import Plan
from osc_contact.spatial import Array

SKEW = ("left rim", "turn")  #: stages whose contacts no frame describes
SELECTION = "selection"  #: name of the pair that replaces them
RIM, FACE = 5.0, 6.0  #: forces on the left rim and at the right tip in these stages (N)


@dataclass(frozen=True)
class Selected:
    """Force and couple axes of one frame of the modelled block.

    Attributes:
        origin: (3,) origin of the frame in the block (m).
        force_axes, couple_axes: (3,) whether force, or couple, is commanded along the axis.
        name: name of the pair.
    """

    origin: Array
    force_axes: tuple[bool, bool, bool]
    couple_axes: tuple[bool, bool, bool]
    name: str = SELECTION
    pushes = False

    def contact(
        self,
        X_WO: pin.SE3,
        V_O: Array,
        X_WE: pin.SE3 | None = None,
        V_E: Array | None = None,
    ) -> osc.Contact:
        """Contact of the selected axes.

        Args:
            X_WO: pose of the object.
            V_O: (6,) its twist.
            X_WE, V_E: not used; the frame does not move.
        """
        at = BELIEVED.act(self.origin) - X_WO.translation
        frame = pin.SE3(BELIEVED.rotation, at)
        return osc.Contact.from_selection(frame, self.force_axes, self.couple_axes)

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """Zeros: a selection has no geometry to be wrong about.

        Args:
            X_WO, X_WE: not used.
        """
        return np.zeros(sum(self.force_axes) + sum(self.couple_axes))


@dataclass(frozen=True)
class Rival:
    """Selection in place of both contacts.

    Attributes:
        pair: selected axes.
        forces: desired forces (N) and couples (N m) along them.
    """

    pair: Selected
    forces: list[float]


_LEFT = np.array([-HALF, 0.5 * WIDTH, 0.0])
_RIGHT = np.array([HALF, 0.5 * WIDTH, 0.0])
_NONE = (False, False, False)
#: Rivals by name. A force of 6 N along z at the right tip has the couple −2 HALF · 6 N m about y at
#: the left rim; with the couple alone, motion along z holds the left pin.
RIVALS = {
    "couple": Rival(
        Selected(_LEFT, (False, True, False), (False, True, False)), [RIM, -2.0 * HALF * FACE]
    ),
    "face only": Rival(Selected(_RIGHT, (False, False, True), _NONE), [FACE]),
    "rim only": Rival(Selected(_LEFT, (False, True, False), _NONE), [RIM]),
}


def insert_by(rival: Rival | None, seed: int) -> Inserted:
    """Result of the plan with a rival's selection; None: ours.

    Args:
        rival: selection of the stages in `SKEW`.
        seed: seed of everything random.
    """
    task = TwoPins(seed)
    plan = two_pin_plan.two_pin_plan(task)
    pairs: Mapping[str, osc.ContactPair] = two_pin_plan.pairs_of(task)
    if rival is not None:
        stages = [_replaced(stage, rival) for stage in plan.stages]
        plan = Plan(stages, largest=plan.largest, tries=plan.tries)
        pairs = {**pairs, SELECTION: rival.pair}
    robot = task.robot(two_pin_plan.bar_start(task))
    controller = controller_for(task.model, pairs, plan, robot)
    osc.run_loop(robot, controller, plan, check=False)
    return two_pin_plan.judged(task, robot, plan)


def _replaced(stage: osc.Stage, rival: Rival) -> osc.Stage:
    """Stage with the selection in place of its contacts, if it is one of `SKEW`.

    A selection cannot be lost or made: "left rim" ends at rest, "turn" when the tip has dropped.

    Args:
        stage: stage of our plan.
        rival: selection.
    """
    if stage.name not in SKEW:
        return stage
    if set(stage.forces) != {LEFT_RIM, RIGHT_POINT}:
        raise osc.InvalidInputError(f"stage {stage.name!r} has other contacts: {stage.forces}")
    until = resting() if stage.name == "left rim" else two_pin_plan.sunk("right")
    return replace(stage, forces={SELECTION: rival.forces}, until=until)


def main(count: int = 5, seed: int = 3000, only: str = "") -> None:
    """Print one row for each law and seed, and a summary of each law.

    Args:
        count: number of seeds.
        seed: first seed.
        only: laws whose name contains this.
    """
    rivals = {"ours": None, **RIVALS}
    compare({name: partial(insert_by, rival) for name, rival in rivals.items()}, count, seed, only)


if __name__ == "__main__":
    typer.run(main)
