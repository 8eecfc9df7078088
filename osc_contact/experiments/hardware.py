"""From a scenario to what makes its rig real: drives and sensors for the plant, and what the
controller needs in front of it because of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from osc_contact.control.joint_torque import JointTorqueLoop
from osc_contact.control.velocity_estimate import VelocityEstimate
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.dynamics.joint_modes import joint_inertias, stiffness_for
from osc_contact.errors import ScenarioError
from osc_contact.interface import Measurement, Stamps, Touched
from osc_contact.plants.joint_drives import FlexibleJoints, JointDrives, Motors
from osc_contact.plants.plant import Plant
from osc_contact.plants.sensors import Clock, Errors, Sensors
from osc_contact.scenarios.hardware import EncoderSpec, SensorsSpec
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array

__all__ = ["Drive", "Observer", "drives", "flexible_joints", "sensors", "torque_loop"]


def flexible_joints(
    scenario: Scenario, chain: ClosedChain, state: ChainState
) -> FlexibleJoints | None:
    """The springs of a scenario, at the state from which its first mode is counted.

    Raises:
        ScenarioError: numbers for an arm that is not there, or not one for each motor.
    """
    spec = scenario.plant.flexible_joints
    if spec is None:
        return None
    own = joint_inertias(state, chain.actuated)
    if spec.frequency is not None:
        K = stiffness_for(state, chain.actuated, float(spec.frequency))
    else:
        K = _per_motor(chain, "stiffness", spec.stiffness or {})
    if isinstance(spec.motor_inertia, dict):
        J = _per_motor(chain, "motor_inertia", spec.motor_inertia)
    else:
        J = float(spec.motor_inertia) * own
    # motor and link swing against each other with the reduced inertia
    D = 2.0 * float(spec.damping_ratio) * np.sqrt(K * J * own / (J + own))
    return FlexibleJoints(K, D, J)


def drives(scenario: Scenario, chain: ClosedChain, state: ChainState, seed: int) -> JointDrives:
    """Springs, motor errors and friction of every motor joint."""
    spec, motors = scenario.plant, None
    if spec.motors is not None:
        sliding = _sliding(chain)[chain.actuated]
        errors = float(spec.motors.bias), float(spec.motors.ripple)
        motors = Motors.drawn(chain.tau_max, sliding, *errors, np.random.default_rng([seed, 2]))
    friction = float(spec.joint_friction) * chain.tau_max if spec.joint_friction else None
    return JointDrives(flexible_joints(scenario, chain, state), motors, friction)


def _per_motor(chain: ClosedChain, key: str, given: Mapping[str, Sequence[float]]) -> Array:
    """(n_a,) numbers of all arms, in the order of the motors."""
    names = [arm.name for arm in chain.arms]
    found: list[float] = []
    for arm in chain.arms:
        motors = arm.model.nv - len(arm.passive_joints)
        if arm.name not in given or len(given[arm.name]) != motors:
            raise ScenarioError(
                f"plant.flexible_joints.{key}: give {motors} numbers for arm '{arm.name}', one for "
                f"each motor; got {list(given.get(arm.name, ()))}"
            )
        found.extend(given[arm.name])
    extra = sorted(set(given) - set(names))
    if extra:
        raise ScenarioError(f"plant.flexible_joints.{key}: no arm {extra}; there are {names}")
    return np.array(found, dtype=float)


def sensors(spec: SensorsSpec, chain: ClosedChain) -> Sensors:
    """The plant's sensors with the errors of a scenario."""
    made = Sensors()
    if (encoder := spec.encoder) is not None:
        noise, bias, resolution = (_joint_errors(encoder, chain, key) for key in _ERRORS)
        made = replace(made, encoders=(_clock(encoder), Errors(noise, bias, resolution)))
    if (torque := spec.joint_torque) is not None:
        share = [float(getattr(torque, key)) * chain.tau_max for key in _ERRORS]
        made = replace(made, joint_torques=(_clock(torque), Errors(*share)))
    if (wrist := spec.wrist) is not None:
        both = [
            np.repeat([getattr(wrist.force, key), getattr(wrist.torque, key)], 3) for key in _ERRORS
        ]
        made = replace(made, wrists=(_clock(wrist), Errors(*both)))
    if (eyes := spec.vision) is not None:
        position = Errors(*[float(getattr(eyes.position, key)) for key in _ERRORS])
        orientation = Errors(*[float(getattr(eyes.orientation, key)) for key in _ERRORS])
        made = replace(made, vision=(_clock(eyes), position, orientation))
    return made


_ERRORS = ("noise", "bias", "resolution")


def _clock(spec: object) -> Clock:
    return Clock(*[float(getattr(spec, key)) for key in ("rate", "delay", "dropout")])


def _joint_errors(spec: EncoderSpec, chain: ClosedChain, key: str) -> Array:
    """(n,) an error of the encoders, by whether the joint turns or slides."""
    return np.where(
        _sliding(chain), float(getattr(spec.length, key)), float(getattr(spec.angle, key))
    )


def _sliding(chain: ClosedChain) -> Array:
    """(n,) which joints move along their axis."""
    kinds = [joint.shortname() for joint in list(chain.model.joints)[1:]]
    return np.array([kind.startswith("JointModelP") for kind in kinds])


def torque_loop(
    scenario: Scenario, chain: ClosedChain, joints: FlexibleJoints | None
) -> JointTorqueLoop | None:
    """The joint torque loop of a scenario, or None."""
    spec = scenario.control.joint_torque
    if spec is None or joints is None:
        return None
    return JointTorqueLoop(
        joints.stiffness,
        joints.motor_inertia,
        chain.tau_max,
        dt=1.0 / float(spec.rate),
        gain=float(spec.gain),
        damping_ratio=float(spec.damping_ratio),
    )


@dataclass
class Drive:
    """Carries the controller's torques to the plant: through the joint torque loop, if any."""

    plant: Plant
    loop: JointTorqueLoop | None
    period: float  #: of the controller (s)
    _sampled: float = -1.0

    def step(self, tau: Array) -> None:
        """One control period."""
        if self.loop is None:
            self.plant.step(tau, self.period)
            return
        for _ in range(round(self.period / self.loop.dt)):
            read = self.plant.measure()
            assert read.joint_torques is not None  # the MuJoCo plant has them
            sampled = self.plant.time if read.stamps is None else read.stamps.joint_torques
            u = self.loop.command(tau, read.joint_torques, fresh=sampled > self._sampled)
            self._sampled = sampled
            self.plant.step(u, self.loop.dt)


class Observer:
    """Completes measurements: joint velocities from encoders, twists of bodies from vision.

    Readings are brought up to date by the sensors' known delay. Ideal readings pass unchanged.
    """

    def __init__(self, scenario: Scenario, chain: ClosedChain) -> None:
        """Set up the estimates from the errors the scenario gives the sensors."""
        self.dt = 1.0 / float(scenario.control.rate)
        self._seen = Stamps(-1.0, -1.0, -1.0, -1.0)
        spec, believed = scenario.sensors, scenario.control.estimate
        self._joints: VelocityEstimate | None = None
        self._spec = spec
        if spec.encoder is not None:
            noise = np.hypot(
                _joint_errors(spec.encoder, chain, "noise"),
                _joint_errors(spec.encoder, chain, "resolution") / np.sqrt(12.0),
            )
            unknown = np.where(
                _sliding(chain), float(believed.joint_linear), float(believed.joint_angular)
            )
            self._joints = VelocityEstimate.optimal(
                np.maximum(noise, 1e-9), unknown, self.dt, 1.0 / float(spec.encoder.rate)
            )
        self._bodies: list[_BodyEstimate] = []
        self._unknown = np.repeat([float(believed.body_linear), float(believed.body_angular)], 3)

    @property
    def estimates(self) -> bool:
        """Whether joint velocities are estimated here, and accelerations of use."""
        return self._joints is not None

    def complete(self, measurement: Measurement, acceleration: Array | None) -> Measurement:
        """The measurement with everything a controller needs.

        Args:
            measurement: as read. acceleration: (n,) of the joints, as commanded since the last
                call; None: unknown.
        """
        stamps = measurement.stamps
        if stamps is None:
            return measurement
        if self._joints is not None and self._spec.encoder is not None:
            known = np.zeros(len(measurement.q)) if acceleration is None else acceleration
            fresh = stamps.encoders > self._seen.encoders
            q, v = self._joints.update(measurement.q, known, fresh)
            measurement = replace(measurement, q=q + float(self._spec.encoder.delay) * v, v=v)
        if self._spec.vision is not None and measurement.touched is not None:
            fresh = stamps.touched > self._seen.touched
            measurement = replace(measurement, touched=self._tracked(measurement.touched, fresh))
        self._seen = stamps
        return measurement

    def _tracked(self, seen: Touched, fresh: bool) -> Touched:
        eyes = self._spec.vision
        assert eyes is not None
        if not self._bodies:
            noise = np.repeat([float(eyes.position.noise), float(eyes.orientation.noise)], 3)
            period = 1.0 / float(eyes.rate)
            self._bodies = [
                _BodyEstimate(
                    VelocityEstimate.optimal(
                        np.maximum(noise, 1e-9), self._unknown, self.dt, period
                    ),
                    X[:3, :3].copy(),
                )
                for X in seen.X_WE
            ]
        found = [
            body.update(X, fresh, float(eyes.delay))
            for body, X in zip(self._bodies, seen.X_WE, strict=True)
        ]
        return Touched(np.array([X for X, _ in found]), np.array([V for _, V in found]), seen.A_E)


@dataclass
class _BodyEstimate:
    """Position and rotation vector of a tracked body, from its first orientation on."""

    channels: VelocityEstimate
    R_first: Array

    def update(self, X: Array, fresh: bool, delay: float) -> tuple[Array, Array]:
        """(X_WE (4, 4), V_E (6,)) now, from a pose that is `delay` old."""
        turned = pin.log3(X[:3, :3] @ self.R_first.T)
        x, rate = self.channels.update(np.concatenate((X[:3, 3], turned)), fresh=fresh)
        x = x + delay * rate
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = pin.exp3(x[3:]) @ self.R_first, x[:3]
        return pose, np.concatenate((rate[:3], pin.Jexp3(-x[3:]) @ rate[3:]))
