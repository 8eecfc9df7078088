"""World of two arms that insert both pins of a bar into two holes at once.

Two Pandas hold a bar at both ends. Its pins stand on the holes of one block, which is beside the
modelled one by a displacement drawn for each seed; sensors, joints and masses err as `World`
states.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import pi
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.insertion import Hole, Peg
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.chain_state import RigidObject
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.grasp import Grasp
from osc_contact.lab.tasks.insertion import (
    BELIEVED,
    DEPTH,
    FINGERS,
    LENGTH,
    POSTURE,
    ROBOT,
    TaskRobot,
    TaskScene,
    World,
    hole_solids,
    write_file,
)
from osc_contact.lab.tasks.solids import Solid, body_urdf
from osc_contact.spatial import Array

NAMES = ("left", "right")  #: arms, and the pins below them
REACH = 0.45  #: distance of each base from its hand (m)
CLEARANCE = 3e-4  #: width of the holes less that of the pins, unless a task has its own (m)
WIDTH = 0.02  #: diameter of the pins (m)
HALF = 0.12  #: distance of each pin from the middle of the bar (m)
BAR = (0.30, 0.02, 0.02)  #: edges of the bar (m)
BAR_MASS = 0.4  #: mass of the bar without its pins (kg)
PIN_MASS = 0.1  #: mass of each pin (kg)
ABOVE = LENGTH + 0.5 * BAR[2]  #: height of the bar's axis above the tips of the pins (m)


@dataclass(frozen=True)
class TwoPins:
    """Bar and block of one seed: the true ones, and their models.

    Attributes:
        seed: seed of displacement, noise and errors.
        clearance: width of the true holes less that of the pins (m).
        offset: largest displacement of the block along each axis (m).
        tilt: largest displacement of the block about each axis, through its middle (rad).
        world: errors of sensors, joints, masses and geometry.
    """

    seed: int
    clearance: float = CLEARANCE
    offset: float = 1e-3
    tilt: float = np.radians(1.0)
    world: World = field(default_factory=World)

    @cached_property
    def drawn(self) -> Array:
        """Ten numbers within ±1: displacement (6), clearance, masses of both arms and the bar."""
        return np.random.default_rng([self.seed, 62]).uniform(-1.0, 1.0, 10)

    @property
    def displacement(self) -> Array:
        """Displacement (6,) of the block, world axes at its middle (m, rad)."""
        return self.drawn[:6] * np.repeat([self.offset, self.tilt], 3)

    @property
    def pegs(self) -> dict[str, Peg]:
        """Pins by name, at their places in the bar."""
        return {name: Peg("round", WIDTH, _beside(k)) for k, name in enumerate(NAMES)}

    @property
    def holes(self) -> dict[str, Hole]:
        """Holes in the controller's model by name; their width has a random error."""
        clearance = self.clearance + self.drawn[6] * self.world.clearance_error
        return self._holes(BELIEVED, clearance)

    @property
    def true_block(self) -> pin.SE3:
        """True pose of the block's middle, displaced from the modelled one."""
        displacement = self.displacement
        rotation = pin.exp3(displacement[3:]) @ BELIEVED.rotation
        return pin.SE3(rotation, BELIEVED.translation + displacement[:3])

    @property
    def true_holes(self) -> dict[str, Hole]:
        """True holes by name."""
        return self._holes(self.true_block, self.clearance)

    def _holes(self, block: pin.SE3, clearance: float) -> dict[str, Hole]:
        """Holes of a block by name.

        Args:
            block: pose of its middle in the world.
            clearance: width of the holes less that of the pins (m).
        """
        return {
            name: Hole("round", WIDTH + clearance, DEPTH, block * _beside(k))
            for k, name in enumerate(NAMES)
        }

    def chain(self, masses: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> ClosedChain:
        """Make the chain of both arms and the bar.

        Args:
            masses: factors of the masses of the left arm, the right arm and the bar.
        """
        arms, grasps = [], []
        for k, name in enumerate(NAMES):
            away = 1.0 if k == 0 else -1.0
            turn = pin.exp3(np.array([0.0, 0.0, 0.0 if k == 0 else pi]))
            hand = BELIEVED.translation[0] - away * HALF
            base = pin.SE3(turn, np.array([hand - away * REACH, 0.0, 0.0]))
            arms.append(
                Arm.from_urdf(
                    robots.find_robot(ROBOT)[0],
                    name=name,
                    base=base,
                    tip="panda_hand_tcp",
                    wrist_sensor="panda_hand",
                    locked=FINGERS,
                    mass_factor=masses[k],
                )
            )
            grasps.append(Grasp.rigid(pin.SE3(turn.T, np.array([HALF, 0.0, ABOVE]))))
        with TemporaryDirectory() as folder:
            inertia = robots.load_body(write_file(folder, "bar.urdf", bar_urdf()))
        return ClosedChain(arms, grasps, RigidObject(inertia).scaled(masses[2]))

    @cached_property
    def model(self) -> ClosedChain:
        """Modelled arms and bar."""
        left, right, bar = (1.0 + self.world.masses * self.drawn[7:]).tolist()
        return self.chain((left, right, bar))

    @property
    def scene(self) -> TaskScene:
        """Bar, block with the true holes, and posture of both arms."""
        boxes = hole_solids(self.true_holes["left"])
        return TaskScene(
            object_urdf=bar_urdf(),
            object_solids=bar_solids(),
            block_solids=[box.beside(x) for x in (-HALF, HALF) for box in boxes],
            block_pose=self.true_block,
            posture=np.array(POSTURE * 2),
        )

    def robot(self, start: pin.SE3) -> TaskRobot:
        """Robot at rest with the bar at a pose."""
        return TaskRobot(self, start)


def _beside(k: int) -> pin.SE3:
    """Pose of pin or hole k beside the middle of bar or block."""
    return pin.SE3(np.eye(3), np.array([(-HALF, HALF)[k], 0.0, 0.0]))


def bar_solids() -> list[Solid]:
    """Bar and both pins, in the frame of the bar.

    Its origin is in the middle between both tips, x is from the left to the right one, and z out of
    them.
    """
    pin_edges = np.array([WIDTH, WIDTH, LENGTH])
    pins = [
        Solid(np.array([x, 0.0, -0.5 * LENGTH]), pin_edges, is_cylinder=True) for x in (-HALF, HALF)
    ]
    return [Solid(np.array([0.0, 0.0, -ABOVE]), np.array(BAR)), *pins]


def bar_urdf() -> str:
    """URDF of the bar, with the masses of bar and pins."""
    inertia = pin.Inertia.Zero()
    for solid in bar_solids():
        edges = solid.edges.tolist()
        if solid.is_cylinder:
            own = pin.Inertia.FromCylinder(PIN_MASS, 0.5 * edges[0], edges[2])
        else:
            own = pin.Inertia.FromBox(BAR_MASS, *edges)
        inertia = inertia + own.se3Action(pin.SE3(np.eye(3), solid.centre))
    moments = inertia.inertia  # (3, 3) at the centre of mass, axes of the bar
    entries = " ".join(
        f'i{"xyz"[i]}{"xyz"[k]}="{moments[i, k]}"' for i in range(3) for k in range(i, 3)
    )
    inertial = (
        f'<inertial><origin xyz="{" ".join(map(str, inertia.lever))}"/>'
        f'<mass value="{inertia.mass}"/><inertia {entries}/></inertial>'
    )
    return body_urdf("bar", bar_solids(), inertial)
