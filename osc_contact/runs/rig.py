"""From a scenario to the parts of a run: true chain, controller's chain, contacts, plant, start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact import robots
from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.control.controller import Controller
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import close, reach
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.dynamics.grasp import GRASPS, Grasp
from osc_contact.dynamics.payload import RigidObject
from osc_contact.interface import Measurement, Robot
from osc_contact.plants.judge import Plant
from osc_contact.plants.sensors import SensedPlant
from osc_contact.response import require_reachable
from osc_contact.runs import faces, hardware
from osc_contact.runs.channels import Subject
from osc_contact.runs.contacts import (
    EnvironmentBody,
    build_pairs,
    environment_bodies,
    misplaced,
    pose_of,
    require_own_pairs,
)
from osc_contact.runs.plants import Parts, make_plant
from osc_contact.runs.references import References, force_owners
from osc_contact.runs.start import asked_pose, posture_of, standoff_of, touching
from osc_contact.scenarios.control_schema import Gains, PhaseSettings
from osc_contact.scenarios.geometry import GraspSpec
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array

__all__ = ["MakesChains", "Rig", "build_chain", "build_rig"]

TARE_INTEGRAL_S = 0.2  #: integral_time of the motion where there is a tare


class MakesChains(Protocol):
    """What `build_chain` does."""

    def __call__(
        self,
        scenario: Scenario,
        arm_mass: float = 1.0,
        object_mass: float = 1.0,
        joint_friction: float = 1.0,
        hidden_mass: float = 0.0,
    ) -> ClosedChain:
        """Arms and object of a scenario, see `build_chain`."""


@dataclass(frozen=True)
class Rig:
    """Everything one run needs.

    Attributes:
        scenario: as loaded.
        chain: the true arms and object. model: the controller's idea of them.
        pairs: the contacts. bodies: what they are on.
        q_contact: (n,) joint positions with loops closed and contacts touching.
        q_start: (n,) where the run starts: the same, or off the contacts if it begins with a tare.
        references: of the run.
        X_asked: the pose of the object that the scenario asks for.
    """

    scenario: Scenario
    chain: ClosedChain
    model: ClosedChain
    pairs: tuple[ContactPair, ...]
    bodies: tuple[EnvironmentBody, ...]
    q_contact: Array
    q_start: Array
    references: References
    X_asked: pin.SE3

    def plant(self, seed: int = 0) -> Plant:
        """The plant the scenario names, at its start, seen through its sensors.

        Args:
            seed: of everything random in sensors and motors.

        Raises:
            ScenarioError: a tare on an exact plant, whose contacts cannot open.
        """
        plant = make_plant(
            Parts(self.scenario, self.chain, self.pairs, self.bodies, self.on, self.state(), seed)
        )
        plant.reset(self.q_start)
        if self.scenario.sensors.ideal:
            return plant
        return SensedPlant(
            plant, hardware.sensors(self.scenario.sensors, self.chain, self.bodies), seed
        )

    def at_start(self, read: Measurement) -> Measurement:
        """What ideal encoders and trackers would have read at the start, where all is at rest."""
        if read.touched is not None:
            still = np.zeros_like(read.touched.V_E)
            read = replace(read, touched=replace(read.touched, V_E=still))
        return replace(read, q=self.q_start, v=np.zeros(self.chain.nq))

    def robot(self, plant: Plant, controller: Controller) -> Robot:
        """The plant as the control loop meets it: behind the joint torque loop, if any, and what
        estimates the velocities that its sensors do not give."""
        robot: Robot = plant
        joints = hardware.flexible_joints(self.scenario, self.chain, self.state())
        if (loop := hardware.torque_loop(self.scenario, self.chain, joints)) is not None:
            robot = hardware.TorqueLoopRobot(plant, loop)
        if not self.scenario.sensors.ideal:
            robot = hardware.ObservedRobot(robot, self.observer(), controller)
        return robot

    def observer(self) -> hardware.Observer:
        """What estimates the velocities that the sensors do not give."""
        return hardware.Observer(self.scenario, self.model, self.bodies)

    def subject(self, controller: Controller) -> Subject:
        """What a recording of this rig is of."""
        on = tuple(self.bodies[body].placement for body in self.on)
        return Subject(controller, self.pairs, on, self.owners, self.d == 6)

    @property
    def gains(self) -> Gains:
        """Those of the scenario, as the controller takes them.

        Off the contacts nothing but the motion integral holds what the model takes wrongly for
        weight, so a tare brings one unless the scenario gives the law's own gains.
        """
        gains = self.scenario.gains
        given = gains.motion.model_fields_set
        if self.scenario.tare is None or {"stiffness", "integral_time"} & given:
            return gains
        return gains.replaced(motion=gains.motion.replaced(integral_time=TARE_INTEGRAL_S))

    def controller(self) -> Controller:
        """The controller with the scenario's gains, knowing only `model`."""
        return Controller(
            self.model,
            self.controlled_pairs(),
            self.gains,
            dt=1.0 / self.scenario.control.rate,
            B=self.scenario.control.metric,
            bodies=faces.known_bodies(
                self.bodies, len(self.pairs), self.scenario.model_error.environment == "ignored"
            ),
            posture=self.q_contact,
            engaged=self.scenario.tare is None,
            friction=self.scenario.control.friction,
            reading=self.scenario.control.force.reading,
            life=self.life,
            safety=self.scenario.control.safety,
            laws=self.scenario.laws() if callable(self.scenario.laws) else self.scenario.laws,
            joint_friction=self.scenario.control.joint_friction,
        )

    @property
    def life(self) -> PhaseSettings | None:
        """How contacts are made and kept; None: they do not open, or cannot on an exact plant."""
        return None if self.scenario.plant.exact else self.scenario.control.life

    def controlled_pairs(self) -> tuple[ContactPair, ...]:
        """The controller's contacts: as declared, or read off the geometry while it moves."""
        if self.scenario.control.contacts == "declared":
            return misplaced(self.scenario, self.pairs, self.bodies, self.state().X_WO)
        urdf = robots.resolve_urdf(self.scenario.object.urdf, self.scenario.folder)[0]
        return faces.tracked(self.pairs, urdf, self.bodies)

    @cached_property
    def on(self) -> tuple[int, ...]:
        """The body of each contact, a number of `bodies`."""
        of = {i: k for k, body in enumerate(self.bodies) for i in body.contacts}
        return tuple(of[i] for i in range(len(self.pairs)))

    @cached_property
    def owners(self) -> Array:
        """(r,) the contact of each force magnitude."""
        return np.array(force_owners(self.scenario), dtype=int)

    @cached_property
    def pushing(self) -> NDArray[np.bool_]:
        """(r,) whether each force magnitude must not become negative."""
        return np.array([pushes_only(self.pairs[i]) for i in self.owners], dtype=bool)

    @cached_property
    def d(self) -> int:
        """Motions the object can make at the start."""
        return self.state().d

    def state(self) -> ChainState:
        """The true chain at rest in contact."""
        return self._state

    @cached_property
    def _state(self) -> ChainState:
        return self.chain.state(self.q_contact, np.zeros(self.chain.nq))

    def contact(self) -> Contact:
        """The contact state there."""
        state = self.state()
        return Contact.stack([pair.contact(state.X_WO, state.V_O) for pair in self.pairs])


def build_rig(scenario: Scenario, chains: MakesChains | None = None) -> Rig:
    """Load the parts, close the loops, put the object onto the faces.

    Args:
        scenario: from `load_scenario`.
        chains: makes the chains in place of `build_chain`, such as one that keeps them.

    Raises:
        ScenarioError, ModelError, ContactError: with what does not fit together.
    """
    error = scenario.model_error
    make = build_chain if chains is None else chains
    chain = make(scenario, hidden_mass=error.hidden_mass)
    factors = error.arm_mass, error.object_mass, error.joint_friction
    known = set(factors) == {1.0} and error.hidden_mass == 0.0
    model = chain if known else make(scenario, *factors)
    pairs = build_pairs(scenario)
    posture = posture_of(scenario, chain)
    X_asked = asked_pose(scenario, chain, posture)
    require_own_pairs(scenario, X_asked)
    q_contact = touching(chain, pairs, posture, X_asked)
    state = chain.state(q_contact, np.zeros(chain.nq))
    contact = Contact.stack([pair.contact(state.X_WO, np.zeros(6)) for pair in pairs])
    require_reachable(state, contact)
    standoff, q_start = np.zeros(6), q_contact
    if scenario.tare is not None:
        standoff = standoff_of(state, contact, float(scenario.tare.standoff))
    references = References.of(scenario, state.X_WO, pairs, standoff)
    if scenario.tare is not None:
        q_start = close(chain, reach(chain, q_contact, references.at(0.0).X_WD))
    bodies = environment_bodies(scenario)
    return Rig(scenario, chain, model, pairs, bodies, q_contact, q_start, references, X_asked)


def build_chain(
    scenario: Scenario,
    arm_mass: float = 1.0,
    object_mass: float = 1.0,
    joint_friction: float = 1.0,
    hidden_mass: float = 0.0,
) -> ClosedChain:
    """Arms and object of a scenario, with masses and friction times the given factors.

    Args:
        scenario: with arms, grasps and object.
        arm_mass, object_mass, joint_friction: factors of model error.
        hidden_mass: kg, a point of the object where the first arm grasps it.
    """
    source = scenario.folder
    arms = [
        Arm.from_urdf(
            robots.resolve_urdf(spec.urdf, source)[0],
            name=spec.name,
            tip=spec.tip,
            base=pose_of(spec.base),
            passive_joints=spec.passive_joints,
            locked=spec.locked_joints,
            wrist_sensor=spec.wrist_sensor,
            mass_factor=arm_mass,
            effort_factor=float(spec.effort_factor),
            armature=_per_joint(spec.armature),
            damping=_per_joint(spec.damping),
            friction=_per_joint(spec.friction),
            friction_factor=joint_friction,
        )
        for spec in scenario.arms
    ]
    body = RigidObject(robots.load_body(robots.resolve_urdf(scenario.object.urdf, source)[0]))
    grasps = [_grasp(scenario.grasps[arm.name]) for arm in scenario.arms]
    held = body.scaled(object_mass)
    if hidden_mass > 0.0:
        at_grasp = grasps[0].X_TO.inverse().translation
        held = RigidObject(held.inertia + pin.Inertia(hidden_mass, at_grasp, np.zeros((3, 3))))
    return ClosedChain(arms, grasps, held)


def _per_joint(given: Sequence[float] | None) -> float | Sequence[float] | None:
    """A list of one stands for all joints."""
    return given[0] if given is not None and len(given) == 1 else given


def _grasp(spec: GraspSpec) -> Grasp:
    axis = () if spec.axis is None else (spec.axis,)
    return GRASPS[spec.type](pose_of(spec), *axis)
