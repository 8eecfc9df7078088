"""Two pins into two holes by other laws: the stages of our plan, with their speeds and forces.

    python -m benchmarks.two_pin_rivals [--count 5] [--seed 3000] [--only NAME]

Impedance, admittance and position control are those of `benchmarks.guided_laws`, which know no
contacts. Each tip is led along the direction in which our contact presses, as fast as this contact
is approached, and stops where the measured force is ours. The force at a tip is that of the bar, or
where both tips press along one direction, its part at this tip by the law of the lever.

A selection matrix is compared in the two stages that no frame describes. Of the stages of the plan
of `two_pins`, a frame describes the contacts of all but "left rim" and "turn": there the left pin
presses on its rim and the right one on the face, along skew lines 240 mm apart. In these two stages
each of these rivals has, in place of both contacts, the axes of one frame of the modelled block.
Stages, forces and gains are ours, and so are the approaches of all other stages. A selection of
axes cannot be approached, made or lost: "left rim" ends when the bar rests, "turn" when the tip has
dropped, and forces of either sign are commanded.

* `couple`: the frame at the left rim; force along y, couple about y by which the right tip presses.
* `face only`: the frame at the right tip; force along z, the left pin is held by motion.
* `rim only`: the frame at the left rim; force along y, the right tip is held by motion.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin
import typer

import osc_contact as osc
from benchmarks.assembly import compare
from benchmarks.guided_laws import LAWS, MADE, SPEED, controlled_by, release
from osc_contact.lab.tasks import two_pin_plan
from osc_contact.lab.tasks.insertion import BELIEVED
from osc_contact.lab.tasks.pegs import Inserted, controller_for, resting
from osc_contact.lab.tasks.two_pin_plan import (
    INTO,
    LEFT_POINT,
    LEFT_RIM,
    POINTS,
    RIGHT_POINT,
    RIGHT_RIM,
    SIDEWAYS,
)
from osc_contact.lab.tasks.two_pins import HALF, WIDTH, TwoPins
from osc_contact.plan.ends import End, when
from osc_contact.plan.motions import Course, Motion, along
from osc_contact.plan.permitted import Demand
from osc_contact.plan.plan import Plan
from osc_contact.plan.sensed import Sensed
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


# --- selection of axes ----------------------------------------------------------------------------


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


# --- laws without contacts ------------------------------------------------------------------------


@dataclass(frozen=True)
class Press:
    """Force with which a tip presses.

    Attributes:
        tip: name of the pin.
        direction: (3,) direction of the force, world axes.
        force: force (N).
        alone: whether the other tip does not press along this direction.
    """

    tip: str
    direction: Array
    force: float
    alone: bool

    def measured(self, now: Sensed) -> float:
        """Measured force at the tip along the direction n (N).

        With both tips at p_i beside O, the wrench (f, m) at O has the forces f_i along n, whose sum
        is nᵀf; their difference d follows from the couple about the middle c of both tips,
        m − c × f = d/2 (p_1 − p_0) × n, by least squares.

        Args:
            now: signals after the last tick.
        """
        f, m = now.wrench[:3], now.wrench[3:]
        total = float(self.direction @ f)
        if self.alone:
            return total
        left, right = (now.X.rotation @ point for point in POINTS.values())
        lever = np.cross(right - left, self.direction)
        couple = m - np.cross(0.5 * (left + right), f)
        difference = 2.0 * float(couple @ lever) / float(lever @ lever)
        return 0.5 * (total + (difference if self.tip == "right" else -difference))

    def motion(self) -> Motion:
        """Motion of the tip along the direction, which yields to the measured force at the tip.

        It is that of `along`, with the velocity of the tip in place of that of the origin.
        """
        motion = along(self.direction, SPEED, yields=self.force)

        def begin(now: Sensed) -> Course:
            """Begin the motion of the tip.

            Args:
                now: signals when the stage begins.
            """
            course = motion.begin(now)

            def demand(now: Sensed, dt: float) -> Demand:
                """Demand the velocity of the tip.

                Args:
                    now: signals after the last tick.
                    dt: control period (s).
                """
                at_tip = np.concatenate((self.measured(now) * self.direction, np.zeros(3)))
                of_origin = course(replace(now, wrench=at_tip), dt)
                place = now.X.rotation @ POINTS[self.tip]
                row = np.concatenate((self.direction, np.cross(place, self.direction)))
                return Demand(row[None], of_origin.values)

            return demand

        return Motion(begin, f"{self.tip} tip, {motion.words}")


_TIPS = {
    LEFT_POINT: ("left", INTO),
    RIGHT_POINT: ("right", INTO),
    LEFT_RIM: ("left", SIDEWAYS),
    RIGHT_RIM: ("right", SIDEWAYS),
}  #: tip and direction (3,) of the force of each contact


def presses_of(stage: osc.Stage) -> list[Press]:
    """Forces of the tips in place of the contacts of a stage of our plan.

    Args:
        stage: stage of our plan.
    """
    presses = []
    for name, force in stage.forces.items():
        tip, direction = _TIPS[name]
        alone = not any(_TIPS[other][1] is direction for other in stage.forces if other != name)
        presses.append(Press(tip, direction, float(np.sum(force)), alone))
    return presses


def reached(*presses: Press) -> End:
    """Condition that each of some forces is half of what is desired, or more.

    Args:
        presses: desired forces.
    """
    return when(lambda now: all(one.measured(now) >= MADE * one.force for one in presses), "force")


def guided_plan(task: TwoPins) -> Plan:
    """Plan without contacts: each force is that against a motion which yields.

    Args:
        task: modelled pins and holes.
    """
    ours = two_pin_plan.two_pin_plan(task)
    stages = []
    for stage in ours.stages:
        if stage.name == "insert":
            stages.append(release())
        if stage.name in ("insert", "done"):
            stage = replace(stage, forces={}, places={})
        elif stage.forces:
            presses = presses_of(stage)
            ends: dict[str, End] = {
                "find": reached(*presses).lasting(0.15),
                "slide": two_pin_plan.sunk("left"),
                "left rim": reached(presses[0]).lasting(0.2) | resting(),
                "turn": two_pin_plan.sunk("right"),
                "corner": reached(*presses).lasting(0.3) | resting(),
                "upright": two_pin_plan.has_turned(task),
            }
            motion = stage.motion
            for press in presses:
                motion = motion & press.motion()
            until = ends[stage.name]
            stage = replace(stage, forces={}, motion=motion, until=until, unless=None, places={})
        stages.append(stage)
    return Plan(stages, largest=ours.largest, tries=ours.tries)


def insert_guided(laws: Callable[[], osc.Laws], seed: int) -> Inserted:
    """Result of the plan without contacts by a law.

    Args:
        laws: function that makes the law.
        seed: seed of everything random.
    """
    task = TwoPins(seed)
    plan = guided_plan(task)
    robot = task.robot(two_pin_plan.bar_start(task))
    controller = controlled_by(laws(), controller_for(task.model, {}, plan, robot))
    osc.run_loop(robot, controller, plan, check=False)
    return two_pin_plan.judged(task, robot, plan)


def main(count: int = 5, seed: int = 3000, only: str = "") -> None:
    """Print one row for each law and seed, and a summary of each law.

    Args:
        count: number of seeds.
        seed: first seed.
        only: laws whose name contains this.
    """
    selections = {"ours": None, **RIVALS}
    inserts = {name: partial(insert_by, rival) for name, rival in selections.items()}
    guided = {name: partial(insert_guided, laws) for name, laws in LAWS.items()}
    compare({**inserts, **guided}, count, seed, only)


if __name__ == "__main__":
    typer.run(main)
