"""Parts of a run, made from a scenario: true chain, controller's model, contacts, plant, start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.contact import Contact
from osc_contact.contacts.feet import contact_at, feet, force_owners
from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.control.controller import Controller
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import close, object_pose, outside_limits, reach
from osc_contact.dynamics.chain_state import ChainState, RigidObject
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.grasp import GRASPS, Grasp
from osc_contact.errors import ModelError, ScenarioError
from osc_contact.interface import Measurement, Robot
from osc_contact.lab.plants.drake import DrakePlant
from osc_contact.lab.plants.faces import Faces
from osc_contact.lab.plants.joint_drives import FlexibleJoints
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.plants.noted_wrenches import NotedWrenches
from osc_contact.lab.plants.rigid import RigidPlant
from osc_contact.lab.plants.sensors import SensedPlant
from osc_contact.lab.rig import hardware
from osc_contact.lab.rig.contacts import (
    EnvironmentBody,
    build_pairs,
    environment_bodies,
    known_bodies,
    misplaced,
    placements_of,
    pose_of,
    rails,
    require_own_pairs,
    touched_bodies,
    tracked,
    urdf_of,
)
from osc_contact.lab.rig.dither import least_motion, showing_twist
from osc_contact.lab.rig.drake_rules import require_bodies_at_rest, require_closed_slip
from osc_contact.lab.rig.references import References, force_names
from osc_contact.lab.rig.standoff import within_speed_limits
from osc_contact.lab.scenarios.bodies import CartSpec, GraspSpec
from osc_contact.lab.scenarios.hardware import PLANT_TYPES
from osc_contact.lab.scenarios.named import as_scenario
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.loop.channels import Subject
from osc_contact.loop.judge import NotedTruths, Plant, ReadsTruth
from osc_contact.loop.recorder import subject_of
from osc_contact.response import require_reachable
from osc_contact.sensing.velocity_estimate import smallest_bandwidth
from osc_contact.settings.control import (
    JointFriction,
    ModelErrorSpec,
    PhaseSettings,
    SafetySettings,
)
from osc_contact.settings.gains import Gains
from osc_contact.spatial import Array

FAR_M = 0.02  #: m, gap from which on a contact is named in an error about the start


def posture_of(scenario: Scenario, chain: ClosedChain) -> Array:
    """Postures of all arms in a scenario, as joint positions (n,) (m, rad).

    Args:
        scenario: scenario with its arms.
        chain: chain of these arms.

    Raises:
        ScenarioError: the number of positions differs from that of the joints.
    """
    q = np.concatenate([arm.posture for arm in scenario.arms])
    if len(q) != chain.nq:
        counts = ", ".join(f"{arm.name} {arm.model.nv}" for arm in chain.arms)
        raise ScenarioError(
            f"posture: {len(q)} joint positions given; on the way to their tips the arms "
            f"have: {counts}"
        )
    return q


def given_pose(scenario: Scenario, chain: ClosedChain, posture: Array) -> pin.SE3:
    """Pose of the object from `object.pose`, or from the posture of an arm with a rigid grasp.

    Args:
        scenario: scenario with or without `object.pose`.
        chain: arms and grasps.
        posture: (n,) joint positions (m, rad).

    Raises:
        ModelError: `object.pose` is not given, and the joints do not determine the pose.
    """
    pose = scenario.object.pose
    return object_pose(chain, posture) if pose is None else pose_of(pose)


def touching(chain: ClosedChain, pairs: Sequence[ContactPair], q: Array, X_WO: pin.SE3) -> Array:
    """Joint positions (n,) near q at which all contacts touch (m, rad).

    Args:
        chain: arms and grasps.
        pairs: pairs that are to touch.
        q: (n,) joint positions from which the search starts (m, rad).
        X_WO: pose of the object from which the search starts.

    Raises:
        ModelError: no joint positions satisfy grasps and contacts.
        ScenarioError: such positions are outside the joints' limits only. Both messages name the
            contact that is furthest away.
    """

    faces = Faces(None, None, len(pairs))  # at rest

    q_near = reach(chain, q, X_WO)
    try:
        q_contact = close(chain, q_near, partial(faces.gaps, pairs))
        if outside := outside_limits(chain, q_contact):
            raise ScenarioError(
                f"the contacts touch where {outside[0]}; move object, faces or base, or change the "
                "posture"
            )
    except (ModelError, ScenarioError) as error:
        raise type(error)(f"{error}{_furthest_contact(pairs, X_WO)}") from error
    return q_contact


def _furthest_contact(pairs: Sequence[ContactPair], X_WO: pin.SE3) -> str:
    """Sentence on the contact that is furthest from its face at a pose; empty if it is near.

    Args:
        pairs: contacts.
        X_WO: pose of the object.
    """
    gaps = [(np.abs(pair.gaps(X_WO)).max(initial=0.0), pair.name) for pair in pairs]
    gap, name = max(gaps, default=(0.0, ""))
    if gap < FAR_M:
        return ""
    return (
        f". At object.pose contact '{name}' is {1e3 * gap:.0f} mm away from what it touches: "
        "move that to the object, or object.pose and posture to it"
    )


MakesChain = Callable[[Scenario, ModelErrorSpec], ClosedChain]  #: type of `build_chain`
#: Defaults of the motion loop in a scenario with a tare: Hz, s.
TARE_MOTION = {"frequency": 4.0, "integral_time": 0.2}
#: Defaults of the force loop in a scenario with a tare (Hz), which belong together.
TARE_FORCE = {"bandwidth": 2.0, "damping_ratio": 1.5}


@dataclass(frozen=True)
class Rig:
    """Parts of a run, made from a scenario.

    Attributes:
        scenario: the scenario.
        chain: the true arms and object.
        model: the controller's model of them.
        pairs: the contacts.
        bodies: bodies of the environment.
        q_contact: (n,) joint positions with closed loops and touching contacts (m, rad).
        q_start: (n,) joint positions at the start: `q_contact`, or off the contacts for a tare.
        references: references of the run.
        X_given: pose of the object in the scenario.
        state: the true chain at rest in contact.

    Example:
        >>> rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
        >>> robot, controller = rig.plant(), rig.controller()
        >>> tau = controller.tick(robot.measure(), rig.references.at(0.0))
    """

    scenario: Scenario
    chain: ClosedChain
    model: ClosedChain
    pairs: tuple[ContactPair, ...]
    bodies: tuple[EnvironmentBody, ...]
    q_contact: Array
    q_start: Array
    references: References
    X_given: pin.SE3
    state: ChainState

    def with_error(self, scenario: Scenario, chains: MakesChain) -> Rig:
        """Copy with another error of the controller's model.

        Args:
            scenario: scenario that differs only in `model_error` (except `hidden_mass`) and
                `verdict`.
            chains: function that makes the chains, see `build_rig`.
        """
        scenario = scenario.replaced(tare=self.scenario.tare)  # its approach may be longer
        return replace(self, scenario=scenario, model=_modelled_chain(scenario, self.chain, chains))

    def plant(self, seed: int = 0) -> Plant:
        """Make the plant of the scenario with its sensors, at the start of the run.

        Args:
            seed: seed of all random numbers of sensors and motors.

        Raises:
            ScenarioError: a tare on an exact plant, whose contacts cannot open.
        """
        scenario = self.scenario
        kind = scenario.plant.type
        if scenario.plant.exact and scenario.tare is not None:
            raise ScenarioError(
                f"a tare needs contacts that open; the {kind} plant's are bilateral. "
                "Use plant.type=mujoco, or set tare: null"
            )
        plant = PLANTS[kind](self, seed)
        plant.reset(self.q_start)
        if scenario.sensors.ideal:
            return plant
        sensors = hardware.sensors(scenario.sensors, self.chain, self.placements)
        return SensedPlant(plant, sensors, seed)

    def at_start(self, measurement: Measurement) -> Measurement:
        """Replace positions and speeds of a measurement by those of ideal sensors at the start.

        Args:
            measurement: reading of the plant at the start; it is not changed.
        """
        touched = measurement.touched
        if touched is not None:
            at_rest = np.zeros_like(touched.V_E)
            measurement = replace(measurement, touched=replace(touched, V_E=at_rest))
        return replace(measurement, q=self.q_start, v=np.zeros(self.chain.nq))

    def file_hashes(self) -> dict[str, str]:
        """Hashes (SHA-256) of the URDFs of arms, object and environment, by their keys."""
        scenario = self.scenario
        files = {f"arms.{arm.name}": urdf_of(scenario, arm) for arm in scenario.arms}
        files["object"] = urdf_of(scenario, scenario.object)
        files |= {f"environment.{body.name}": body.urdf[0] for body in self.bodies}
        return {name: sha256(path.read_bytes()).hexdigest() for name, path in files.items()}

    def robot(self, plant: Plant, controller: Controller) -> Robot:
        """Robot for the control loop: the plant with joint torque loop and velocity estimates.

        The joint torque loop is added if the scenario has one, the estimates of velocities unless
        its sensors are ideal.

        Args:
            plant: plant of the rig.
            controller: controller of the loop, whose accelerations the estimates use.
        """
        robot: Robot = plant
        loop = hardware.torque_loop(self.scenario, self.chain, self.springs)
        if loop is not None:
            robot = hardware.TorqueLoopRobot(plant, loop)
        if not self.scenario.sensors.ideal:
            robot = hardware.ObservedRobot(
                robot, controller, self.scenario, self.placements, self.measured_forces
            )
        return robot

    @cached_property
    def fastest_mode(self) -> float:
        """Largest frequency √(k/m) (rad/s) of a contact that pushes on an elastic wall, or 0.

        k is `control.estimate.stiffest_wall`, or the stiffness of the contact's cart if that is
        larger; 1/m = NᵀΦN is the mobility of the object along one line of force, at the start.
        """
        fastest = 0.0
        X_WO = self.state.X_WO
        for pair, body in zip(self.pairs, self.on, strict=True):
            if not pushes_only(pair):
                continue
            stiffness = self.scenario.control.estimate.stiffest_wall
            cart = self.bodies[body].motion
            if isinstance(cart, CartSpec):
                stiffness = max(stiffness, cart.stiffness)
            for point, line in zip(*feet(pair, X_WO), strict=True):
                N = np.concatenate([line, np.cross(point - X_WO.translation, line)])
                fastest = max(fastest, float(np.sqrt(stiffness * (N @ self.state.Phi @ N))))
        return fastest

    @property
    def needed_bandwidth(self) -> float:
        """Bandwidth (rad/s) with which encoders alone let the brake damp the `fastest_mode`."""
        force = self.gains.force
        return smallest_bandwidth(force.brake, force.integral, self.fastest_mode)

    @cached_property
    def measured_forces(self) -> bool:
        """Whether velocities are estimated with the accelerations by measured contact forces.

        By default they are where the encoders alone are too coarse, or too slow, for the brake to
        damp the `fastest_mode`.
        """
        own_setting = self.scenario.control.estimate.measured_forces
        if own_setting is not None:
            return own_setting
        brakes = self.gains.force.brake > 0.0 and any(map(pushes_only, self.pairs))
        if self.scenario.sensors.encoder is None or not brakes:
            return False
        return hardware.encoder_bandwidth(self.scenario, self.chain) < self.needed_bandwidth

    @cached_property
    def springs(self) -> FlexibleJoints | None:
        """Springs of flexible joints, or None.

        Raises:
            ScenarioError: a joint cannot be flexible.
        """
        return hardware.flexible_joints(self.scenario, self.chain, self.state)

    def subject(self, controller: Controller) -> Subject:
        """Description of the system for recordings of this rig."""
        return subject_of(controller, self.pairs, self.placements, self.owners)

    @property
    def gains(self) -> Gains:
        """Gains of the scenario, which has other defaults of both loops where it has a tare.

        A tare is for weights and friction that the model does not know. Away from the contacts only
        the motion integral balances errors of the weight, so it is on by default; and the loop is
        faster, because unknown friction keeps slow ones off their path. The same friction excites
        contacts on walls that yield; these decay at half of the excess of brake over integral, so
        the force loop has a slower integral and more damping.
        """
        gains = self.scenario.gains
        if self.scenario.tare is None:
            return gains
        motion, force = gains.motion, gains.force
        if "stiffness" not in motion.model_fields_set:
            missing = TARE_MOTION.keys() - motion.model_fields_set
            motion = motion.replaced(**{key: TARE_MOTION[key] for key in missing})
        if force.model_fields_set.isdisjoint({*TARE_FORCE, "integral"}):
            force = force.replaced(**TARE_FORCE)
        return gains.replaced(motion=motion, force=force)

    @property
    def joint_friction(self) -> JointFriction | None:
        """Settings of joint friction; by default a tare enables compensation of mass errors."""
        friction = self.scenario.control.joint_friction
        if friction is None or friction.errors is not None:
            return friction
        return friction.replaced(errors=self.scenario.tare is not None)

    def controller(self) -> Controller:
        """Make the controller of the scenario from `model`.

        In a scenario with a `tare` it begins without its contacts, as in `osc.run`: a program with
        its own loop averages `residual_wrench()` to `f_tare`, and then calls `engage()`.
        """
        scenario = self.scenario
        control = scenario.control
        return Controller(
            self.model,
            self.controlled_pairs(),
            self.gains,
            dt=1.0 / control.rate,
            B=control.metric,
            bodies=known_bodies(self.bodies, len(self.pairs), scenario.model_error.environment),
            posture=self.q_contact,
            engaged=scenario.tare is None,
            in_contact=control.in_contact or self.life is None,
            friction=control.friction,
            reading=control.force.reading,
            life=self.life,
            safety=self.safety,
            laws=scenario.laws() if callable(scenario.laws) else scenario.laws,
            joint_friction=self.joint_friction or False,
        )

    @cached_property
    def safety(self) -> SafetySettings:
        """Safety settings, in which ceilings that are not given follow from the commands."""
        return self.scenario.control.safety.for_commands(*self.references.largest_commands)

    @property
    def life(self) -> PhaseSettings | None:
        """Settings of contact phases; None without phases, and for exact plants."""
        return life_of(self.scenario)

    def controlled_pairs(self) -> tuple[ContactPair, ...]:
        """Contacts of the controller: the declared ones, or those detected from the geometry."""
        if self.scenario.control.contacts == "declared":
            return misplaced(self.scenario, self.pairs, self.bodies, self.state.X_WO)
        return tracked(self.pairs, urdf_of(self.scenario, self.scenario.object), self.bodies)

    @cached_property
    def on(self) -> tuple[int, ...]:
        """Index in `bodies` of the body of each contact."""
        return touched_bodies(self.bodies, len(self.pairs))

    @cached_property
    def placements(self) -> Array:
        """Initial pose X_WB of the body of each contact, (contacts, 4, 4)."""
        return placements_of(self.bodies, self.on)

    @cached_property
    def owners(self) -> Array:
        """Index (r,) of the contact of each force magnitude."""
        return force_owners(self.pairs)

    @property
    def force_names(self) -> list[str]:
        """Names of the force magnitudes: ``tip``, ``pad.1``, ``pad.2``, …"""
        return force_names(self.scenario)

    @cached_property
    def contact(self) -> Contact:
        """State of contact of the chain at rest in contact."""
        return contact_at(self.pairs, self.state.X_WO)


def life_of(scenario: Scenario) -> PhaseSettings | None:
    """Settings of contact phases of a scenario; None without phases, and for exact plants."""
    return None if scenario.plant.exact else scenario.control.life


MakesPlant = Callable[[Rig, int], Plant]  #: function that makes a plant from a rig and a seed
#: Function that makes the reader of a plant's log, from a scenario and its contact pairs.
MakesTruths = Callable[[Scenario, Sequence[ContactPair]], ReadsTruth]
#: Functions that make the registered plants from a rig and a seed, by their names in scenarios.
PLANTS: dict[str, MakesPlant] = {}
#: Readers of the logs of registered plants that can be read without the plant.
TRUTHS: dict[str, MakesTruths] = {}


def register_plant(
    name: str, *, exact: bool = False, truths: MakesTruths | None = None
) -> Callable[[MakesPlant], MakesPlant]:
    """Function decorator that registers a plant for `plant.type` of scenarios.

    The function makes the plant from a `Rig` and a seed of random numbers.

    Args:
        name: name in scenarios.
        exact: whether its joints are ideal and its contacts bilateral and unbounded, so that tares,
            motor errors, pushes and edges of faces are not possible.
        truths: function that makes the reader of the plant's log, from a scenario and its pairs;
            None: `recover` makes the plant for it.
    """

    def enter(make: MakesPlant) -> MakesPlant:
        """Register a function that makes a plant, under the name given to the decorator.

        Args:
            make: function that makes the plant.
        """
        PLANTS[name] = make
        if truths is not None:
            TRUTHS[name] = truths
        PLANT_TYPES[name] = exact
        return make

    return enter


def _noted_by_rigid(scenario: Scenario, pairs: Sequence[ContactPair]) -> ReadsTruth:
    """Make the reader of rows that the rigid plant of a scenario recorded.

    Args:
        scenario: scenario of the run, which is not needed.
        pairs: its contacts.
    """
    return NotedTruths(pairs)


@register_plant("rigid", exact=True, truths=_noted_by_rigid)
def _rigid_plant(rig: Rig, seed: int) -> Plant:
    """Make the rigid plant of a rig, which uses no random numbers."""
    return RigidPlant(rig.chain, rig.pairs, rig.scenario.plant.step, rails(rig.bodies), rig.on)


def _noted_wrenches(scenario: Scenario, pairs: Sequence[ContactPair]) -> ReadsTruth:
    """Make the reader of rows of wrenches that a plant of a scenario recorded.

    The reader needs the rails of the faces and, in its own frame, the inertia of the object: a
    wrench is distributed over the columns of the contacts by least squares in the accelerations
    that they would cause of the free object. The inertia is that of the plant, which of all model
    errors has only the hidden mass.

    Args:
        scenario: scenario of the run.
        pairs: its contacts.
    """
    bodies = environment_bodies(scenario)
    faces = Faces(rails(bodies), touched_bodies(bodies, len(pairs)), len(pairs))
    true_object = held_object(scenario, _error_of_true_chain(scenario.model_error))
    inertia = true_object.terms(pin.SE3.Identity(), np.zeros(6), np.zeros(3)).Lambda
    return NotedWrenches(pairs, faces, inertia)


@register_plant("mujoco", truths=_noted_wrenches)
def _mujoco_plant(rig: Rig, seed: int) -> Plant:
    """Make the MuJoCo plant of a rig; the seed determines the errors of its motors."""
    scenario = rig.scenario
    return MujocoPlant(
        rig.chain,
        [urdf_of(scenario, arm) for arm in scenario.arms],
        urdf_of(scenario, scenario.object),
        rig.pairs,
        [(body.urdf[0], body.placement) for body in rig.bodies],
        options=scenario.plant,
        rails=rails(rig.bodies),
        on=rig.on,
        drives=hardware.drives(scenario, rig.chain, rig.springs, seed),
    )


@register_plant("drake", truths=_noted_wrenches)
def _drake_plant(rig: Rig, seed: int) -> Plant:
    """Make the Drake plant of a rig, which uses no random numbers.

    Args:
        rig: rig of the scenario.
        seed: unused; makers of plants have equal arguments.

    Raises:
        ScenarioError: a body of the environment moves, or the approximation `sap` would open a
            contact by itself.
    """
    scenario = rig.scenario
    require_bodies_at_rest(rig.bodies)
    require_closed_slip(rig.pairs, rig.references, rig.owners, scenario.plant)
    return DrakePlant(
        rig.chain,
        [urdf_of(scenario, arm) for arm in scenario.arms],
        urdf_of(scenario, scenario.object),
        rig.pairs,
        [(body.urdf[0], body.placement) for body in rig.bodies],
        options=scenario.plant,
        on=rig.on,
    )


def build_rig(scenario: str | Path | Scenario, chains: MakesChain | None = None) -> Rig:
    """Load the parts of a scenario, close the kinematic loops, and find the start in contact.

    Args:
        scenario: a scenario, or its name or path as for `load_scenario`.
        chains: function that makes the chains in place of `build_chain`, for example with a cache.

    Returns:
        Rig of the scenario: true chain and the controller's model of it, pairs and bodies, joint
        positions in contact and at the start, references, and the state in contact.

    Raises:
        ScenarioError, ModelError, ContactError: parts of the scenario do not fit together.
    """
    scenario = as_scenario(scenario)
    make = chains or build_chain
    # the true arms, and the model of them that the controller has
    chain = make(scenario, _error_of_true_chain(scenario.model_error))
    model = _modelled_chain(scenario, chain, make)
    pairs = build_pairs(scenario)
    posture = posture_of(scenario, chain)
    X_given = given_pose(scenario, chain, posture)
    require_own_pairs(scenario, X_given)
    # joint positions at which the contacts close, and the contact there
    q_contact = touching(chain, pairs, posture, X_given)
    state = chain.state(q_contact)
    contact = contact_at(pairs, state.X_WO)
    require_reachable(state, contact)
    # references, which begin off the contacts if the wrist sensors are tared there
    tare = scenario.tare
    standoff = np.zeros(6)
    if tare is not None:  # gaps open against N
        standoff = least_motion(state, contact.N, np.full(contact.r, -tare.standoff))
    showing = showing_twist(pairs, state, contact.N)
    references = References.of(scenario, state.X_WO, pairs, standoff, showing)
    q_start = q_contact
    if tare is not None:
        q_start = close(chain, reach(chain, q_contact, references.at(0.0).X_WD))
        limits = chain.model.velocityLimit
        scenario = within_speed_limits(scenario, q_contact - q_start, limits)
        references = replace(references, scenario=scenario)
    bodies = environment_bodies(scenario)
    return Rig(
        scenario, chain, model, pairs, bodies, q_contact, q_start, references, X_given, state
    )


def _error_of_true_chain(error: ModelErrorSpec) -> ModelErrorSpec:
    """Model error of the true chain, which has only the hidden mass."""
    return ModelErrorSpec(hidden_mass=error.hidden_mass)


def _modelled_chain(scenario: Scenario, chain: ClosedChain, make: MakesChain) -> ClosedChain:
    """Controller's model of arms and object.

    Without model errors, and without a joint torque loop, it is the true chain.

    Args:
        scenario: scenario with its `model_error`.
        chain: the true chain.
        make: function that makes chains.
    """
    error = scenario.model_error
    keys = ("arm_mass", "object_mass", "joint_friction", "armature")
    modelled = ModelErrorSpec(**{key: getattr(error, key) for key in keys})
    model = chain if modelled == _error_of_true_chain(error) else make(scenario, modelled)
    return hardware.behind_torque_loop(scenario, model)


def build_chain(scenario: Scenario, error: ModelErrorSpec | None = None) -> ClosedChain:
    """Make the chain of arms and object of a scenario, with the factors of a model error.

    Args:
        scenario: scenario with arms, grasps and object.
        error: factors of masses, friction and rotors, and a hidden mass; None: no error.
    """
    error = error or ModelErrorSpec()
    arms = [
        Arm.from_urdf(
            urdf_of(scenario, spec),
            name=spec.name,
            tip=spec.tip,
            base=pose_of(spec.base),
            passive_joints=spec.passive_joints,
            locked=spec.locked_joints,
            wrist_sensor=spec.wrist_sensor,
            mass_factor=error.arm_mass,
            effort_factor=spec.effort_factor,
            armature=_per_joint(spec.armature),
            damping=_per_joint(spec.damping),
            friction=_per_joint(spec.friction),
            friction_factor=error.joint_friction,
        )
        for spec in scenario.arms
    ]
    # rotor inertias by both of Pinocchio's fields are scaled
    for arm in arms:
        arm.model.armature = error.armature * arm.model.armature
        arm.model.rotorInertia = error.armature * arm.model.rotorInertia
    grasps = [_make_grasp(scenario.grasps[arm.name]) for arm in scenario.arms]
    return ClosedChain(arms, grasps, held_object(scenario, error))


def held_object(scenario: Scenario, error: ModelErrorSpec) -> RigidObject:
    """Make the object of a scenario, with the mass factor and the hidden mass of a model error.

    Args:
        scenario: scenario with arms, grasps and object.
        error: factor of the mass, and a hidden point mass where the first arm grasps the object.
    """
    body = RigidObject(robots.load_body(urdf_of(scenario, scenario.object)))
    body = body.scaled(error.object_mass)
    if error.hidden_mass > 0.0:
        X_TO = pose_of(scenario.grasps[scenario.arms[0].name])
        at_grasp = X_TO.inverse().translation
        point = pin.Inertia(error.hidden_mass, at_grasp, np.zeros((3, 3)))
        body = RigidObject(body.inertia + point)
    return body


def _per_joint(numbers: Sequence[float] | None) -> float | Sequence[float] | None:
    """Replace a list of one number, which is valid for all joints, by the number.

    Args:
        numbers: one number for all joints or for each of them; None: not given.
    """
    return numbers[0] if numbers is not None and len(numbers) == 1 else numbers


def _make_grasp(spec: GraspSpec) -> Grasp:
    """Make a grasp of the type and pose in a scenario, with its axis if the type has one."""
    axis = () if spec.axis is None else (spec.axis,)
    return GRASPS[spec.type].make(pose_of(spec), *axis)
