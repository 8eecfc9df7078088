"""World of a peg and a hole whose place is not known exactly, with sensors that err.

A Panda holds a peg above a hole in a block. The true hole is beside the modelled one, by a
displacement drawn for each seed. Sensors, joints and masses err as `World` states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.insertion import Hole, Peg
from osc_contact.control.controller import Controller
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import reach
from osc_contact.dynamics.chain_state import RigidObject
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.grasp import Grasp
from osc_contact.interface import Measurement, Robot
from osc_contact.lab.plants.joint_drives import JointDrives
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.plants.sensors import SensedPlant, SensorErrors, Sensors
from osc_contact.lab.scenarios.hardware import Clock, PlantSpec
from osc_contact.lab.tasks.solids import Solid, body_urdf
from osc_contact.sensing.joint_readings import Encoders, JointReadings, speed_limits
from osc_contact.settings.control import EstimateSpec, SafetySettings
from osc_contact.spatial import Array

PERIOD = 1e-3  #: control period (s)
ROBOT = "panda"  #: robot of example-robot-data that holds the peg
#: Positions of the locked joints of the hand (m).
FINGERS = {"panda_finger_joint1": 0.01, "panda_finger_joint2": 0.01}
WIDTH = 0.02  #: width of the peg (m)
LENGTH = 0.06  #: length of the peg (m)
DEPTH = 0.03  #: depth of the hole (m)
CLEARANCE = 2e-4  #: width of the hole less that of the peg, unless a task has its own (m)
WALL = 0.04  #: thickness of the block around the hole (m)
#: Modelled pose of the hole in the world.
BELIEVED = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.5, 0.0, 0.3]))
POSTURE = (0.0, 0.1, 0.0, -2.1, 0.0, 2.2, 0.785)  #: joint positions near the start (rad)
TCP = 0.1034  #: distance from the hand to its tip frame (m)
BASE = 0.10  #: distance from the hand to the base of the peg (m)
SECTORS = 32  #: number of boxes of which a round hole is made, a multiple of 4
#: Depth of the boxes of a round hole below those at ±x and ±y (m). A tip that slides from one box
#: to another of the same height catches on the edge of its side, as it sinks in a little.
LOWER = 5e-5


@dataclass(frozen=True)
class World:
    """Errors of sensors, joints, masses and geometry.

    Attributes:
        force_noise: standard deviation of the wrist's forces (N).
        torque_noise: standard deviation of its torques (N m).
        encoder_bits: resolution of the encoders, as bits of a turn.
        joint_friction: Coulomb friction of the joints, a share of their torque limits.
        friction: coefficient between peg and hole, unknown to the controller.
        step: time step of MuJoCo (s).
        masses: largest relative error of the masses of arm and peg.
        clearance_error: largest error of the modelled clearance (m).
        solref, solimp: softness of MuJoCo's contacts.
    """

    force_noise: float = 0.2
    torque_noise: float = 0.01
    encoder_bits: int = 18
    joint_friction: float = 0.01
    friction: float = 0.2
    step: float = 2.5e-4
    masses: float = 0.05
    clearance_error: float = 20e-6
    solref: tuple[float, float] = (0.003, 1.0)
    solimp: tuple[float, float, float] = (0.6, 0.95, 2e-4)


@dataclass(frozen=True)
class Insertion:
    """Peg and hole of one seed: the true ones, and their models.

    Attributes:
        peg: true peg.
        clearance: width of the true hole less that of the peg (m).
        seed: seed of displacement, noise and errors.
        offset: largest displacement of the hole along each axis (m).
        tilt: largest displacement of the hole about each axis (rad).
        world: errors of sensors, joints, masses and geometry.
    """

    peg: Peg
    clearance: float
    seed: int
    offset: float = 2e-3
    tilt: float = np.radians(2.0)
    world: World = field(default_factory=World)

    @cached_property
    def drawn(self) -> Array:
        """Nine numbers within ±1: displacement (6), clearance, masses of arm and of peg."""
        return np.random.default_rng([self.seed, 61]).uniform(-1.0, 1.0, 9)

    @property
    def displacement(self) -> Array:
        """Displacement (6,) of the hole, world axes at its mouth (m, rad)."""
        return self.drawn[:6] * np.repeat([self.offset, self.tilt], 3)

    @property
    def hole(self) -> Hole:
        """Hole in the controller's model: its pose, and the true width with a random error."""
        clearance = self.clearance + self.drawn[6] * self.world.clearance_error
        return Hole(self.peg.shape, self.peg.width + clearance, DEPTH, BELIEVED)

    @property
    def true_hole(self) -> Hole:
        """True hole, displaced from the modelled pose."""
        displacement = self.displacement
        rotation = pin.exp3(displacement[3:]) @ BELIEVED.rotation
        pose = pin.SE3(rotation, BELIEVED.translation + displacement[:3])
        return Hole(self.peg.shape, self.peg.width + self.clearance, DEPTH, pose)

    def chain(self, mass: float = 1.0, held: float = 1.0) -> ClosedChain:
        """Make the chain of arm and peg.

        Args:
            mass: factor of the masses of the arm.
            held: factor of the mass of the peg.
        """
        arm = Arm.from_urdf(
            robots.find_robot(ROBOT)[0],
            name=ROBOT,
            tip="panda_hand_tcp",
            wrist_sensor="panda_hand",
            locked=FINGERS,
            mass_factor=mass,
        )
        with TemporaryDirectory() as folder:
            inertia = robots.load_body(write_file(folder, "peg.urdf", peg_urdf(self.peg)))
        grasp = Grasp.rigid(pin.SE3(np.eye(3), np.array([0.0, 0.0, BASE + LENGTH - TCP])))
        return ClosedChain([arm], [grasp], RigidObject(inertia).scaled(held))

    @cached_property
    def model(self) -> ClosedChain:
        """Modelled arm and peg."""
        mass, held = 1.0 + self.world.masses * self.drawn[7:]
        return self.chain(float(mass), float(held))

    @property
    def scene(self) -> TaskScene:
        """Peg, block with the true hole, and posture."""
        return TaskScene(
            object_urdf=peg_urdf(self.peg),
            object_solids=[peg_solid(self.peg)],
            block_solids=hole_solids(self.true_hole),
            block_pose=self.true_hole.pose,
            posture=np.array(POSTURE),
        )

    def robot(self, start: pin.SE3) -> InsertionRobot:
        """Robot at rest with the peg at a pose."""
        return InsertionRobot(self, start)


@dataclass(frozen=True)
class TaskScene:
    """Object, block and arms of a task, for MuJoCo and for pictures.

    Attributes:
        object_urdf: text of the URDF of the held object.
        object_solids: shapes of the held object.
        block_solids: shapes of the block with its holes.
        block_pose: true pose of the block in the world.
        posture: (n,) joint positions near the start (rad).
    """

    object_urdf: str
    object_solids: Sequence[Solid]
    block_solids: Sequence[Solid]
    block_pose: pin.SE3
    posture: Array


class Task(Protocol):
    """Task of arms `ROBOT` that hold an object above a block with holes.

    Attributes:
        seed: seed of noise and errors.
        world: errors of sensors, joints, masses and geometry.
    """

    @property
    def seed(self) -> int:
        """Seed of noise and errors."""

    @property
    def world(self) -> World:
        """Errors of sensors, joints, masses and geometry."""

    @property
    def scene(self) -> TaskScene:
        """Object, block and posture of the arms."""

    def chain(self) -> ClosedChain:
        """Make the true chain of arms and object."""


class TaskRobot:
    """Simulated arms with an object, with sensors that err, and the judge of a task.

    Args:
        task: arms, object, block and errors.
        start: pose of the object in the world at the start.

    Attributes:
        chain: true arms and object.
        plant: MuJoCo, without errors of sensors.
        sensed: this plant with errors of encoders and wrists, without speeds.
        q_start: (n,) joint positions at the start (rad).
        controller: controller of the task; None: none of the package.
        largest_sum: largest norm of the sum of contact forces so far (N).
        largest_single: largest force of a single contact so far (N).
    """

    def __init__(self, task: Task, start: pin.SE3) -> None:
        """Make plant, sensors and velocity estimate; the arms hold the object at rest.

        Args:
            task: task with the true scene and the properties of the world.
            start: pose of the object in the world at the start.
        """
        world = task.world
        scene = task.scene
        # plant: MuJoCo reads object and block from files, which it needs during construction only
        self.chain = chain = task.chain()
        block = body_urdf("block", scene.block_solids)
        with TemporaryDirectory() as folder:
            self.plant = MujocoPlant(
                chain,
                [robots.find_robot(ROBOT)[0]] * len(chain.arms),
                write_file(folder, "object.urdf", scene.object_urdf),
                [],
                [(write_file(folder, "block.urdf", block), scene.block_pose)],
                options=PlantSpec(
                    step=world.step,
                    solref=world.solref,
                    solimp=world.solimp,
                ),
                drives=JointDrives(friction=world.joint_friction * chain.tau_max),
            )
        self._set_friction(world.friction)

        # sensors: encoders with quantisation, wrists with noise (N, N m)
        clock = Clock(rate=1.0 / PERIOD)
        resolution = 2.0 * pi / 2**world.encoder_bits
        noise = np.repeat([world.force_noise, world.torque_noise], 3)
        sensors = Sensors(
            encoders=(clock, SensorErrors(resolution=resolution)),
            wrists=(clock, SensorErrors(noise=noise)),
        )
        sensed = SensedPlant(self.plant, sensors, task.seed)

        # start at rest: motors carry the weight before the first tick
        self.q_start = reach(chain, scene.posture, start)
        sensed.reset(self.q_start)
        model = chain.model
        weight = pin.computeGeneralizedGravity(model, model.createData(), self.q_start)
        sensed.hold(weight[chain.actuated])
        self.sensed: Robot = sensed

        safety = SafetySettings()
        encoders = Encoders(
            noise=np.zeros(chain.nq),
            resolution=np.full(chain.nq, resolution),
            unknown=np.full(chain.nq, EstimateSpec().joint_angular),
            sample=PERIOD,
        )
        #: checks and estimates of the joints' readings
        self._joints = JointReadings(
            encoders, safety.plausible_speed * speed_limits(chain), safety.hold_rate, PERIOD
        )
        self.controller: Controller | None = None
        self.largest_sum = 0.0
        self.largest_single = 0.0
        self._total = 0.0  # sum of the norms whose mean is `mean_sum` (N)
        self._touching_ticks = 0  # number of these norms

    @property
    def mean_sum(self) -> float:
        """Mean norm of the sum of contact forces while anything touched (N); 0: nothing did."""
        return self._total / max(self._touching_ticks, 1)

    def measure(self) -> Measurement:
        """Read encoders and wrists; readings are checked, and velocities estimated from them."""
        released_for = 0.0 if self.controller is None else self.controller.released_for
        return self._joints.complete(self.sensed.measure(), released_for=released_for)

    def command(self, tau: Array, duration: float) -> None:
        """Apply torques for a period, and note the true forces at its end.

        Args:
            tau: (n_a,) motor torques (N m, N).
            duration: period (s).
        """
        self.sensed.command(tau, duration)
        forces = self.contact_forces()
        size = float(np.linalg.norm(forces.sum(axis=0)))
        self.largest_sum = max(self.largest_sum, size)
        if size > 0.0:
            self._total += size
            self._touching_ticks += 1
        single = np.linalg.norm(forces, axis=1).max(initial=0.0)
        self.largest_single = max(self.largest_single, float(single))

    def stop(self, reason: str = "") -> None:
        """Do nothing: it is a simulation."""

    def _set_friction(self, friction: float) -> None:
        """Set the coefficient of sliding friction of all bodies that touch, with MuJoCo's own cone.

        The friction of `PlantSpec` is made for contacts that slide; with it a peg that is wedged
        between two walls oscillates with the period of the time steps.

        Args:
            friction: coefficient of friction; friction against turning and rolling is 0.
        """
        model = self.plant.model
        touching = model.geom_contype != 0
        model.geom_condim[touching] = 3
        model.geom_friction[touching] = [friction, 0.0, 0.0]

    def contact_forces(self) -> Array:
        """True forces (k, 3) of the k contacts of object and block, in world axes (N).

        MuJoCo has each force in the frame of its contact, whose axes are the rows of `frame`.
        """
        import mujoco

        model = self.plant.model
        data = self.plant.data
        forces = np.zeros((data.ncon, 3))
        wrench = np.zeros(6)
        for k in range(data.ncon):
            mujoco.mj_contactForce(model, data, k, wrench)
            forces[k] = data.contact[k].frame.reshape(3, 3).T @ wrench[:3]
        return forces

    def speed(self) -> float:
        """True speed of the object's origin (m/s)."""
        return float(np.linalg.norm(self.plant.truth().V_O[:3]))

    def pose(self) -> pin.SE3:
        """True pose of the object in the world."""
        return pin.SE3(self.plant.poses()[0])


class InsertionRobot(TaskRobot):
    """Simulated Panda with a peg, with sensors that err, and its judge.

    Args:
        task: peg, hole and errors.
        start: pose of the peg in the world at the start.

    Attributes:
        task: peg, hole and errors.
    """

    def __init__(self, task: Insertion, start: pin.SE3) -> None:
        """Make plant, sensors and velocity estimate; the arm holds the peg at rest.

        Args:
            task: task with the true hole, the peg and the properties of the world.
            start: pose of the peg in the world at the start.
        """
        super().__init__(task, start)
        self.task = task

    def in_hole(self) -> pin.SE3:
        """True pose of the peg in the frame of the true hole."""
        return self.task.true_hole.pose.actInv(self.pose())


def write_file(folder: str, name: str, text: str) -> Path:
    """Path of a new file with a text.

    Args:
        folder: folder of the file.
        name: name of the file.
        text: content of the file.
    """
    path = Path(folder) / name
    path.write_text(text)
    return path


def peg_solid(peg: Peg) -> Solid:
    """Box or cylinder of a peg, along −z of its frame."""
    edges = np.array([peg.width, peg.width, LENGTH])
    return Solid(np.array([0.0, 0.0, -0.5 * LENGTH]), edges, is_cylinder=peg.shape == "round")


def peg_urdf(peg: Peg) -> str:
    """Make the URDF of a peg of 0.2 kg.

    `axial` and `bending` are the squared radii of gyration about the axis and across it (m²).
    """
    if peg.shape == "square":
        axial = peg.width**2 / 6.0
        bending = (peg.width**2 + LENGTH**2) / 12.0
    else:
        half = 0.5 * peg.width
        axial = half**2 / 2.0
        bending = (3.0 * half**2 + LENGTH**2) / 12.0
    mass = 0.2
    inertial = (
        f'<inertial><origin xyz="0 0 {-LENGTH / 2}"/>'
        f'<mass value="{mass}"/><inertia ixx="{mass * bending}" ixy="0" ixz="0" '
        f'iyy="{mass * bending}" iyz="0" izz="{mass * axial}"/></inertial>'
    )
    return body_urdf("peg", [peg_solid(peg)], inertial)


def hole_solids(hole: Hole) -> list[Solid]:
    """Boxes of a block with a hole, in the frame of the hole; the first one is the bottom.

    Args:
        hole: hole, whose pose does not matter.
    """
    half = 0.5 * hole.width
    thick = 0.5 * WALL
    boxes = [((0.0, 0.0, hole.depth + 0.005), (3.0 * WALL, 3.0 * WALL, 0.01), 0.0)]
    middle = 0.5 * hole.depth
    if hole.shape == "square":
        out = half + thick
        for x, y in ((out, 0.0), (-out, 0.0)):
            boxes.append(((x, y, middle), (WALL, 2.0 * half + 2.0 * WALL, hole.depth), 0.0))
        for x, y in ((0.0, out), (0.0, -out)):
            boxes.append(((x, y, middle), (2.0 * half, WALL, hole.depth), 0.0))
    else:
        width = 2.0 * (half + WALL) * np.tan(pi / SECTORS)
        for k in range(SECTORS):
            angle = k * (2.0 * pi / SECTORS)
            top = 0.0 if k % (SECTORS // 4) == 0 else LOWER
            x, y = ((half + thick) * np.array([np.cos(angle), np.sin(angle)])).tolist()
            edges = (WALL, width, hole.depth - top)
            boxes.append(((x, y, middle + 0.5 * top), edges, angle))
    return [Solid(np.array(centre), np.array(edges), turn) for centre, edges, turn in boxes]
