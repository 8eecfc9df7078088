"""From a scenario to what makes its rig real: drives and sensors for the plant, and what the
controller needs in front of it because of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.control.accelerations import expected_acceleration
from osc_contact.control.controller import Controller
from osc_contact.control.joint_torque import JointTorqueLoop
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.chain_state import ChainState, joint_inertias, stiffness_for
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import ScenarioError
from osc_contact.interface import Measurement, Robot
from osc_contact.lab.plants.joint_drives import FlexibleJoints, JointDrives, Motors
from osc_contact.lab.plants.sensors import SensorErrors, Sensors
from osc_contact.lab.scenarios.hardware import Clock, EncoderSpec, SensorsSpec
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.loop.judge import Plant
from osc_contact.robots.model import sliding
from osc_contact.sensing.dead_encoders import DeadEncoders
from osc_contact.sensing.velocity_estimate import VelocityEstimate
from osc_contact.sensing.vision_fusion import Registration, VisionFusion
from osc_contact.spatial import Array

_NOISE = 0.02  #: rad, m; encoders may jump by as much


def flexible_joints(
    scenario: Scenario, chain: ClosedChain, state: ChainState
) -> FlexibleJoints | None:
    """The springs of a scenario, at the state from which its first mode is counted.

    Args:
        scenario: scenario with `arms`. chain: model of the arms. state: at the start.

    Raises:
        ScenarioError: numbers for an arm that is not there, or not one for each motor.
    """
    spec = scenario.plant.flexible_joints
    if spec is None:
        return None
    if chain.model.armature[chain.actuated].any():
        raise ScenarioError(
            "the rotors of joints with springs are plant.flexible_joints.motor_inertia; set "
            "arms.armature to 0, or leave plant.flexible_joints out"
        )
    own = joint_inertias(state, chain.actuated)
    rotors = spec.motor_inertia
    J = _per_motor(chain, "motor_inertia", rotors) if isinstance(rotors, dict) else rotors * own
    if spec.frequency is None:
        K = _per_motor(chain, "stiffness", spec.stiffness or {})
    else:
        K = stiffness_for(state, chain.actuated, spec.frequency)
    # motor and link swing against each other with the reduced inertia
    return FlexibleJoints(K, 2.0 * spec.damping_ratio * np.sqrt(K * J * own / (J + own)), J)


def drives(
    scenario: Scenario, chain: ClosedChain, springs: FlexibleJoints | None, seed: int
) -> JointDrives:
    """Springs, motor errors and friction of every motor joint.

    Args:
        scenario, chain: as of `flexible_joints`. springs: springs of it. seed: seed of the motors'
            errors.
    """
    spec = scenario.plant
    motors = None
    if spec.motors is not None:
        slides = sliding(chain.model)[chain.actuated]
        rng = np.random.default_rng([seed, 2])
        motors = Motors.drawn(chain.tau_max, slides, spec.motors.bias, spec.motors.ripple, rng)
    friction = spec.joint_friction * chain.tau_max if spec.joint_friction else None
    return JointDrives(springs, motors, friction)


def _per_motor(chain: ClosedChain, key: str, given: Mapping[str, Sequence[float]]) -> Array:
    """(n_a,) numbers of all arms, in the order of the motors."""
    names = [arm.name for arm in chain.arms]
    if extra := sorted(set(given) - set(names)):
        raise ScenarioError(f"plant.flexible_joints.{key}: no arm {extra}; there are {names}")
    numbers = [list(given.get(name, ())) for name in names]
    for arm, own in zip(chain.arms, numbers, strict=True):
        motors = arm.model.nv - len(arm.passive_joints)
        if len(own) != motors:
            raise ScenarioError(
                f"plant.flexible_joints.{key}: give {motors} numbers for arm '{arm.name}', one for "
                f"each motor; got {own}"
            )
    return np.concatenate(numbers)


def sensors(spec: SensorsSpec, chain: ClosedChain, markers: Array) -> Sensors:
    """The plant's sensors with the errors of a scenario.

    Args:
        spec: `plant.sensors`. chain: model of the arms.
        markers: (contacts, 4, 4) frames of the bodies that cameras track in E, the world at the
            start.
    """

    def six(wrist: Any, error: Any) -> Array:
        return np.repeat([error(wrist.force), error(wrist.torque)], 3)

    return Sensors(
        encoders=_sensor(spec.encoder, partial(_joint_errors, chain)),
        joint_torques=_sensor(spec.joint_torque, lambda torque, e: e(torque) * chain.tau_max),
        wrists=_sensor(spec.wrist, six),
        vision=spec.vision,
        markers=markers,
    )


def _sensor(
    clock: Clock | None, size: Callable[[Any, Any], Array]
) -> tuple[Clock, SensorErrors] | None:
    """A clock, and `size` of noise, bias and resolution."""
    if clock is None:
        return None
    errors = map(attrgetter, ("noise", "bias", "resolution"))
    return clock, SensorErrors(*[size(clock, error) for error in errors])


def _joint_errors(chain: ClosedChain, spec: EncoderSpec, error: Callable[[Any], float]) -> Array:
    """(n,) an error of the encoders, by whether the joint turns or slides."""
    return np.where(sliding(chain.model), error(spec.length), error(spec.angle))


def torque_loop(
    scenario: Scenario, chain: ClosedChain, joints: FlexibleJoints | None
) -> JointTorqueLoop | None:
    """The joint torque loop of a scenario, or None.

    Args:
        scenario, chain: as of `flexible_joints`. joints: the springs; None: stiff joints.
    """
    spec = scenario.control.joint_torque
    if spec is None or joints is None:
        return None
    return JointTorqueLoop(joints.stiffness, joints.motor_inertia, chain.tau_max, spec)


def joint_estimate(scenario: Scenario, chain: ClosedChain) -> tuple[VelocityEstimate, Array]:
    """What estimates the velocities of joints, and (n,) the rms error of their readings (rad, m).

    Args:
        scenario: scenario with encoders. chain: model of the arms.
    """
    spec = scenario.sensors.encoder
    assert spec is not None
    estimate = scenario.control.estimate
    noise, step = (_joint_errors(chain, spec, attrgetter(e)) for e in ("noise", "resolution"))
    error = np.maximum(np.hypot(noise, step / np.sqrt(12.0)), 1e-9)
    unknown = np.where(sliding(chain.model), estimate.joint_linear, estimate.joint_angular)
    dt = 1.0 / scenario.control.rate
    made = VelocityEstimate.optimal
    if estimate.measured_forces:
        made = VelocityEstimate.learning
    return made(error, unknown, dt, 1.0 / spec.rate), error


class TorqueLoopRobot:
    """A plant behind its joint torque loop, which makes the joints carry what is commanded."""

    def __init__(self, plant: Plant, loop: JointTorqueLoop) -> None:
        self.plant = plant
        self.loop = loop
        self.measure = plant.measure
        self.stop = plant.stop
        self._sampled = -1.0

    def command(self, tau: Array, duration: float) -> None:
        """The loop's periods within one of the controller."""
        for _ in range(round(duration / self.loop.dt)):
            read = self.plant.measure()
            assert read.joint_torques is not None  # the MuJoCo plant has them
            sampled = self.plant.time if read.stamps is None else read.stamps.joint_torques
            u = self.loop.command(tau, read.joint_torques, fresh=sampled > self._sampled)
            self._sampled = sampled
            self.plant.command(u, self.loop.dt)


class ObservedRobot:
    """A robot whose measurements are completed for its controller.

    Joint velocities are estimated from encoders, the motion of bodies from vision. Readings are
    brought up to date by the sensors' known delay. Ideal readings pass unchanged. Positions and
    velocities of encoders that are dead are NaN.

    Attributes:
        vision: what fuses the camera's pictures with the encoders; None: no vision.
    """

    def __init__(
        self,
        robot: Robot,
        controller: Controller,
        scenario: Scenario,
        markers: Array,
    ) -> None:
        """Set up the estimates from the errors the scenario gives the sensors.

        Args:
            robot: that measures. controller: controller of it. scenario: scenario with the sensors.
            markers: as of `sensors`.
        """
        self.robot = robot
        self.controller = controller
        self.stop = robot.stop
        chain = controller.chain
        self._acceleration = np.zeros(chain.nq)  #: of the joints, as expected since the last tick
        self.dt = 1.0 / scenario.control.rate
        self._read = -1.0  #: when encoders were sampled last
        self._ticks = 0
        spec = scenario.sensors
        estimate = scenario.control.estimate
        self._measured_forces = estimate.measured_forces
        self._joints: VelocityEstimate | None = None
        if spec.encoder is not None:
            limit = chain.model.velocityLimit
            limit = np.where(limit > 0.0, limit, np.inf)
            period = max(self.dt, 1.0 / spec.encoder.rate)
            self._reach = scenario.control.safety.plausible_speed * limit * period
            self._delay = spec.encoder.delay
            self._accepted = np.full(chain.nq, np.nan)
            self._missed = np.zeros(chain.nq)
            self._joints, _ = joint_estimate(scenario, chain)
            noise, step = (
                _joint_errors(chain, spec.encoder, attrgetter(e)) for e in ("noise", "resolution")
            )
            self._dead = DeadEncoders(noise, step)
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

    def _implausible(self, q: Array) -> NDArray[np.bool_]:
        """(n,) which joints are not finite, or moved faster than they can since they were read."""
        far = np.abs(q - self._accepted) > _NOISE + self._reach * (1.0 + self._missed)
        bad = ~np.isfinite(q) | far
        self._missed = np.where(bad, self._missed + 1.0, 0.0)
        self._accepted = np.where(bad, self._accepted, q)
        return bad

    def measure(self) -> Measurement:
        """Measurement for a controller, with estimates of the velocities that are not measured."""
        measurement = self.robot.measure()
        stamps = measurement.stamps
        if stamps is None:
            return measurement
        if self._joints is not None:
            bad = self._implausible(measurement.q)
            if bad.any() and self._joints.x is None:
                return measurement
            fresh = stamps.encoders > self._read
            q = np.where(bad, np.nan, measurement.q)
            dead = self._dead.update(measurement.q, fresh)
            q, v = self._joints.update(np.where(dead, np.nan, q), self._acceleration, fresh)
            q = np.where(bad | dead, np.nan, q + self._delay * v)
            v = np.where(dead, np.nan, v)  # only predicted
            measurement = replace(measurement, q=q, v=v, estimated=True)
        if self.vision is not None and measurement.touched is not None:
            touched = self.vision.update(
                self._ticks * self.dt,
                measurement.q,
                stamps.vision,
                measurement.seen,
                measurement.touched,
            )
            measurement = replace(measurement, touched=touched)
        self._ticks += 1
        self._read = stamps.encoders
        return measurement

    def command(self, tau: Array, duration: float) -> None:
        """See `Robot.command`."""
        if self._joints is not None:  # accelerations are of use
            self._acceleration = self.controller.joint_acceleration()
            if self._measured_forces:
                self._acceleration = expected_acceleration(self.controller)
        self.robot.command(tau, duration)
