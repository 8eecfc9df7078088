"""Drives and sensors of a rig, made from a scenario, and the robot between plant and controller."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from osc_contact.control.accelerations import expected_acceleration
from osc_contact.control.controller import Controller
from osc_contact.control.joint_torque import JointTorqueLoop
from osc_contact.dynamics.arm import with_joints
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.chain_state import ChainState, joint_inertias, stiffness_for
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import ScenarioError
from osc_contact.interface import Measurement, Robot, with_readings
from osc_contact.lab.plants.joint_drives import FlexibleJoints, JointDrives, Motors
from osc_contact.lab.plants.sensors import SensorErrors, Sensors
from osc_contact.lab.scenarios.hardware import Clock, EncoderSpec, SensorsSpec
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.loop.judge import Plant
from osc_contact.robots.model import joint_names, sliding
from osc_contact.sensing.joint_readings import Encoders, JointReadings, speed_limits
from osc_contact.sensing.vision_fusion import Registration, VisionFusion
from osc_contact.spatial import Array

#: Function that reads one error (noise, bias or resolution) from the description of a quantity.
ReadsError = Callable[[Any], float]


def flexible_joints(
    scenario: Scenario, chain: ClosedChain, state: ChainState
) -> FlexibleJoints | None:
    """Springs of flexible joints of a scenario, from its numbers or its first natural frequency.

    Args:
        scenario: scenario with `arms`.
        chain: model of the arms.
        state: state in which the joint inertias and the natural frequency are taken.

    Returns:
        Stiffness, damping and motor inertia of each motor joint; None: the joints are stiff.

    Raises:
        ScenarioError: numbers are given for an unknown arm, or not one for each motor, or rotors
            are given twice.
    """
    spec = scenario.plant.flexible_joints
    if spec is None:
        return None
    if chain.model.armature[chain.actuated].any():
        raise ScenarioError(
            "the rotors of joints with springs are plant.flexible_joints.motor_inertia; set "
            "arms.armature to 0, or leave plant.flexible_joints out"
        )
    link_inertia = joint_inertias(state, chain.actuated)
    rotors = spec.motor_inertia
    if isinstance(rotors, dict):
        motor_inertia = _per_motor(chain, "motor_inertia", rotors)
    else:  # a multiple of the links' inertia
        motor_inertia = rotors * link_inertia
    if spec.frequency is None:
        stiffness = _per_motor(chain, "stiffness", spec.stiffness or {})
    else:
        stiffness = stiffness_for(state, chain.actuated, spec.frequency)
    # motor and link swing against each other with the reduced inertia J_m J_l / (J_m + J_l)
    root = np.sqrt(stiffness * motor_inertia * link_inertia / (motor_inertia + link_inertia))
    return FlexibleJoints(stiffness, 2.0 * spec.damping_ratio * root, motor_inertia)


def drives(
    scenario: Scenario, chain: ClosedChain, springs: FlexibleJoints | None, seed: int
) -> JointDrives:
    """Make the drives of all motor joints: springs, errors of the motors, and friction.

    Args:
        scenario: scenario with `plant`.
        chain: model of the arms.
        springs: springs of flexible joints; None: stiff joints.
        seed: seed of the motors' errors.
    """
    spec = scenario.plant
    motors = None
    if spec.motors is not None:
        slides = sliding(chain.model)[chain.actuated]
        rng = np.random.default_rng([seed, 2])
        motors = Motors.drawn(chain.tau_max, slides, spec.motors.bias, spec.motors.ripple, rng)
    friction = spec.joint_friction * chain.tau_max if spec.joint_friction else None
    return JointDrives(springs, motors, friction)


def _per_motor(chain: ClosedChain, key: str, by_arm: Mapping[str, Sequence[float]]) -> Array:
    """Concatenate the numbers of all arms to (n_a,), in the order of the motors.

    Args:
        chain: model of the arms.
        key: key of `plant.flexible_joints`, for messages.
        by_arm: numbers of each arm's motors, by the arm's name.

    Raises:
        ScenarioError: numbers are given for an unknown arm, or not one for each motor.
    """
    names = [arm.name for arm in chain.arms]
    if unknown := sorted(set(by_arm) - set(names)):
        raise ScenarioError(f"plant.flexible_joints.{key}: no arm {unknown}; there are {names}")
    numbers = [list(by_arm.get(name, ())) for name in names]
    for arm, arm_numbers in zip(chain.arms, numbers, strict=True):
        motors = arm.model.nv - len(arm.passive_joints)
        if len(arm_numbers) != motors:
            raise ScenarioError(
                f"plant.flexible_joints.{key}: give {motors} numbers for arm '{arm.name}', one for "
                f"each motor; got {arm_numbers}"
            )
    return np.concatenate(numbers)


def sensors(spec: SensorsSpec, chain: ClosedChain, markers: Array) -> Sensors:
    """Make the plant's sensors with the errors of a scenario.

    Args:
        spec: sensors of the scenario.
        chain: model of the arms.
        markers: (contacts, 4, 4) frames of the bodies that cameras track, in E, which is the world
            at the start.
    """

    def joint_torque_errors(torque: Any, error: ReadsError) -> Array:
        """Errors (n_a,) of the joint torque sensors (N m, N), given as shares of the limits."""
        return error(torque) * chain.tau_max

    def wrist_errors(wrist: Any, error: ReadsError) -> Array:
        """Errors (6,) of a wrist sensor: three of the force (N), three of the torque (N m)."""
        return np.repeat([error(wrist.force), error(wrist.torque)], 3)

    return Sensors(
        encoders=_clock_and_errors(spec.encoder, partial(_joint_errors, chain)),
        joint_torques=_clock_and_errors(spec.joint_torque, joint_torque_errors),
        wrists=_clock_and_errors(spec.wrist, wrist_errors),
        vision=spec.vision,
        markers=markers,
    )


def _clock_and_errors(
    spec: Clock | None, sizes: Callable[[Any, ReadsError], Array]
) -> tuple[Clock, SensorErrors] | None:
    """Clock and errors of one kind of sensor; None: the sensor is ideal.

    Args:
        spec: rate, delay and errors of the sensor in the scenario.
        sizes: function that returns the sizes of an error of all channels, from the description and
            a function that reads this error from a part of it.
    """
    if spec is None:
        return None
    noise, bias, resolution = (
        sizes(spec, attrgetter(error)) for error in ("noise", "bias", "resolution")
    )
    return spec, SensorErrors(noise, bias, resolution)


def _joint_errors(chain: ClosedChain, spec: EncoderSpec, error: ReadsError) -> Array:
    """Sizes (n,) of an error of the encoders: a length for sliding joints (m), else an angle (rad).

    Args:
        chain: model of the arms.
        spec: encoders of the scenario.
        error: function that reads the error from `spec.length` or `spec.angle`.
    """
    return np.where(sliding(chain.model), error(spec.length), error(spec.angle))


def torque_loop(
    scenario: Scenario, chain: ClosedChain, joints: FlexibleJoints | None
) -> JointTorqueLoop | None:
    """Make the joint torque loop of a scenario; None without one, or with stiff joints.

    Args:
        scenario: scenario with `control.joint_torque`.
        chain: model of the arms.
        joints: springs of flexible joints; None: stiff joints.
    """
    spec = scenario.control.joint_torque
    if spec is None or joints is None:
        return None
    return JointTorqueLoop(joints.stiffness, joints.motor_inertia, chain.tau_max, spec)


def behind_torque_loop(scenario: Scenario, chain: ClosedChain) -> ClosedChain:
    """Chain as it behaves behind the joint torque loop of a scenario; itself without such a loop.

    The loop reduces the friction of motors by the factor 1 + gain, so that friction of the full
    size would be compensated twice. Friction of passive joints, which have no loop, stays.

    Args:
        scenario: scenario whose `control.joint_torque` acts on `plant.flexible_joints`.
        chain: the arms with the friction of their drives.
    """
    loop = scenario.control.joint_torque
    has_friction = chain.model.damping.any() or chain.model.upperDryFrictionLimit.any()
    if loop is None or scenario.plant.flexible_joints is None or not has_friction:
        return chain
    arms = []
    for arm in chain.arms:
        is_passive = np.isin(joint_names(arm.model), arm.passive_joints)
        share = np.where(is_passive, 1.0, 1.0 / (1.0 + loop.gain))
        losses = {
            "damping": share * arm.model.damping,
            "friction": share * arm.model.upperDryFrictionLimit,
        }
        arms.append(replace(arm, model=with_joints(arm.model, losses, 1.0)))
    return ClosedChain(arms, chain.grasps, chain.payload)


def encoders(scenario: Scenario, chain: ClosedChain) -> Encoders:
    """Encoders of a scenario that has them, and unmodelled accelerations of its joints.

    Args:
        scenario: scenario with encoders.
        chain: model of the arms.
    """
    spec = scenario.sensors.encoder
    assert spec is not None
    estimate = scenario.control.estimate
    return Encoders(
        noise=_joint_errors(chain, spec, attrgetter("noise")),
        resolution=_joint_errors(chain, spec, attrgetter("resolution")),
        unknown=np.where(sliding(chain.model), estimate.joint_linear, estimate.joint_angular),
        sample=1.0 / spec.rate,
        delay=spec.delay,
    )


def encoder_bandwidth(scenario: Scenario, chain: ClosedChain) -> float:
    """Smallest bandwidth (rad/s) of velocities that are estimated from encoders alone.

    It is √(σ_a/σ_n) of the coarsest joint, and at most the rate at which encoders are sampled.

    Args:
        scenario: scenario with encoders.
        chain: model of the arms.
    """
    spec = scenario.sensors.encoder
    assert spec is not None
    known = encoders(scenario, chain)
    rate = min(spec.rate, scenario.control.rate)
    return float(min(np.sqrt(known.unknown / known.error).min(), rate))


class TorqueLoopRobot:
    """Plant behind its joint torque loop, which controls the torques behind the joints' springs.

    Attributes:
        plant: plant with flexible joints.
        loop: controller of the motors, at its own rate.
    """

    def __init__(self, plant: Plant, loop: JointTorqueLoop) -> None:
        """Put a joint torque loop between controller and plant; sensors and `stop` are the plant's.

        Args:
            plant: plant whose torques the loop computes.
            loop: the joint torque loop.
        """
        self.plant = plant
        self.loop = loop
        self.measure = plant.measure
        self.stop = plant.stop
        self._torque_stamp = -1.0  #: time at which torque sensors were sampled last (s)
        #: function that returns time and reading of the torque sensors
        self._read_torques = getattr(plant, "torque_reading", self._measured_torques)

    def _measured_torques(self) -> tuple[float, Array | None]:
        """Time (s) and reading (n_a,) of the joint torque sensors in the plant's measurement."""
        measurement = self.plant.measure()
        stamps = measurement.stamps
        sampled = self.plant.time if stamps is None else stamps.joint_torques
        return sampled, measurement.joint_torques

    def command(self, tau: Array, duration: float) -> None:
        """Run the loop for one period of the controller.

        Args:
            tau: (n_a,) desired torques of the joints (N m, N).
            duration: period (s), a whole number of the loop's periods.
        """
        for _ in range(round(duration / self.loop.dt)):
            sampled, torques = self._read_torques()
            assert torques is not None  # the MuJoCo plant has them
            motor_torques = self.loop.command(tau, torques, fresh=sampled > self._torque_stamp)
            self._torque_stamp = sampled
            self.plant.command(motor_torques, self.loop.dt)


class ObservedRobot:
    """Robot whose measurements are completed by estimates for its controller.

    Joint velocities are estimated from encoders, the motion of bodies from vision. Readings are
    extrapolated over the sensors' known delay. Ideal readings pass unchanged. Positions and
    velocities of dead encoders are NaN. Velocities from encoders that are far noisier than the
    scenario says are estimated with the gains for their measured noise, or those with which a
    stopped arm can still be held; the controller stops then.

    Attributes:
        robot: robot that measures.
        controller: controller of the loop.
        vision: fusion of the camera's pictures with the encoders; None: no vision.
    """

    def __init__(
        self,
        robot: Robot,
        controller: Controller,
        scenario: Scenario,
        markers: Array,
        measured_forces: bool,
    ) -> None:
        """Make the estimators from the sensor errors of the scenario.

        Args:
            robot: robot that measures.
            controller: its controller.
            scenario: scenario with the sensors.
            markers: (contacts, 4, 4) frames of the bodies that cameras track, in E.
            measured_forces: whether estimated velocities of the joints include what measured
                contact forces accelerate.
        """
        self.robot = robot
        self.controller = controller
        self.stop = robot.stop
        chain = controller.chain
        #: accelerations of the joints that the last command causes (rad/s², m/s²)
        self._acceleration = np.zeros(chain.nq)
        self.dt = 1.0 / scenario.control.rate
        self._ticks = 0  #: number of measurements so far
        spec = scenario.sensors
        estimate = scenario.control.estimate
        #: whether estimates include what contact forces accelerate
        self._measured_forces = measured_forces
        #: checks and estimates of the joints' readings; None: they are ideal
        self._joints: JointReadings | None = None
        if spec.encoder is not None:
            safety = scenario.control.safety
            self._joints = JointReadings(
                encoders(scenario, chain),
                safety.plausible_speed * speed_limits(chain),
                safety.hold_rate,
                self.dt,
                learning=measured_forces,
            )
        self.vision: VisionFusion | None = None
        if (camera := spec.vision) is not None:
            self.vision = VisionFusion(
                lambda q: [object_pose(chain, q), *chain.tip_poses()],
                Registration(max(camera.position.noise, 1e-9), max(camera.orientation.noise, 1e-9)),
                (estimate.body_linear, estimate.body_angular),
                dt=self.dt,
                period=1.0 / camera.rate,
                delay=camera.delay,
                markers=markers,
            )

    def measure(self) -> Measurement:
        """Measurement for a controller, with estimates of the velocities that are not measured.

        Joint velocities (rad/s, m/s) are estimated from the encoders' positions and the
        accelerations of the last command; positions are extrapolated over the delay of the
        encoders. An implausible reading and that of a dead encoder become NaN. With a camera,
        motions of the touched bodies are estimated from its poses. A measurement without time
        stamps is returned unchanged.
        """
        measurement = self.robot.measure()
        stamps = measurement.stamps
        if stamps is None:
            return measurement
        if self._joints is not None:
            completed = self._joints.complete(
                measurement, self._acceleration, self.controller.released_for
            )
            if completed is measurement:  # the estimate has not begun
                return measurement
            measurement = completed
        if self.vision is not None and measurement.touched is not None:
            touched = self.vision.update(
                self._ticks * self.dt,
                measurement.q,
                stamps.vision,
                measurement.seen,
                measurement.touched,
            )
            measurement = with_readings(measurement, touched=touched)
        self._ticks += 1
        return measurement

    def command(self, tau: Array, duration: float) -> None:
        """Command the robot, and store the joint accelerations that the next estimate expects.

        Args:
            tau: (n_a,) motor torques (N m, N).
            duration: control period (s).
        """
        if self._joints is not None:
            if self._measured_forces:
                self._acceleration = expected_acceleration(self.controller)
            else:
                self._acceleration = self.controller.joint_acceleration()
        self.robot.command(tau, duration)
