"""What makes a rig real: flexible joints, imperfect motors, sensors and their errors."""

from __future__ import annotations

from typing import Annotated, Generic, TypeVar

from pydantic import Field, model_validator

from .quantities import (
    Angle,
    Force,
    Frequency,
    Length,
    NotNegative,
    Number,
    OfQuantity,
    Positive,
    Spec,
    Time,
    Torque,
    Velocity,
    refuse,
)

__all__ = [
    "EncoderSpec",
    "EstimateSpec",
    "FlexibleJointsSpec",
    "FrictionSpec",
    "JointTorqueSpec",
    "MotorsSpec",
    "SensorsSpec",
    "TorqueSensorSpec",
    "VisionSpec",
    "WristSpec",
]

Q = TypeVar("Q", bound=float)
Probability = Annotated[Number, Field(ge=0, lt=1)]
PerMotor = Annotated[tuple[Positive, ...], Field(min_length=1)]


class FlexibleJointsSpec(Spec):
    """Springs between motors and links, by the rig's first mode or by number."""

    frequency: Annotated[Frequency, Field(gt=0)] | None = None
    """the first mode of the rig with its motors held, such as 5 Hz"""
    stiffness: dict[str, PerMotor] | None = None
    """by arm, one number for each motor (N m/rad, N/m)"""
    damping_ratio: NotNegative = 0.02
    motor_inertia: Positive | dict[str, PerMotor] = 0.5
    """a share of each joint's own inertia, or by arm one number for each motor (kg m², kg)"""

    @model_validator(mode="after")
    def _one_of_two(self) -> FlexibleJointsSpec:
        if (self.frequency is None) == (self.stiffness is None):
            raise refuse(
                "expected either frequency, such as 5 Hz, or stiffness, by arm and motor; "
                + ("got neither" if self.frequency is None else "got both")
            )
        return self


class MotorsSpec(Spec):
    """Errors of the motors as shares of each one's limit; signs and phases are drawn."""

    bias: NotNegative = 0.0
    ripple: NotNegative = 0.0


class JointTorqueSpec(Spec):
    """The joint torque loop: its rate (Hz), gain and damping ratio."""

    rate: Annotated[Frequency, Field(gt=0)]
    """the rate of the loop, such as 4 kHz"""
    gain: Positive = 60.0
    damping_ratio: Positive = 0.7


class FrictionSpec(Spec):
    """What the controller believes of the contacts' friction, and from which slip speed on."""

    mu: NotNegative
    """the Coulomb coefficient, such as 0.1"""
    slip: Annotated[Velocity, Field(gt=0)] = 0.002
    learning: NotNegative = 5.0


class EstimateSpec(Spec):
    """Accelerations that the estimates of velocities do not know of: joints, tracked bodies."""

    joint_angular: Positive = 2.0
    joint_linear: Positive = 0.5
    body_angular: Positive = 0.1
    body_linear: Positive = 0.05


class _Clock(Spec):
    """When a sensor samples and how its readings arrive."""

    rate: Annotated[Frequency, Field(gt=0)]
    """samples per second, such as 1 kHz"""
    delay: Annotated[Time, Field(ge=0)] = 0.0
    dropout: Probability = 0.0


class Errors(OfQuantity[Q], Generic[Q]):
    """Errors of a measured quantity."""

    noise: Annotated[Q, Field(ge=0)] = 0.0  # type: ignore[assignment]
    bias: Annotated[Q, Field(ge=0)] = 0.0  # type: ignore[assignment]
    resolution: Annotated[Q, Field(ge=0)] = 0.0  # type: ignore[assignment]


class EncoderSpec(_Clock):
    """Joint positions; an encoder gives no velocity."""

    angle: Errors[Angle] = Errors[Angle]()
    length: Errors[Length] = Errors[Length]()


class TorqueSensorSpec(_Clock):
    """Joint torques; errors are shares of each motor's limit."""

    noise: NotNegative = 0.0
    bias: NotNegative = 0.0
    resolution: NotNegative = 0.0


class WristSpec(_Clock):
    """Wrist forces and torques."""

    force: Errors[Force] = Errors[Force]()
    torque: Errors[Torque] = Errors[Torque]()


class VisionSpec(_Clock):
    """Overhead vision: poses of faces, object and arms, in the camera's frame."""

    position: Errors[Length] = Errors[Length]()
    orientation: Errors[Angle] = Errors[Angle]()
    frame_position: Annotated[Length, Field(ge=0)] = 0.0
    frame_orientation: Annotated[Angle, Field(ge=0)] = 0.0


class SensorsSpec(Spec):
    """The sensors; one that is left out is ideal. Biases are drawn once, uniform within ±bias."""

    encoder: EncoderSpec | None = None
    joint_torque: TorqueSensorSpec | None = None
    wrist: WristSpec | None = None
    vision: VisionSpec | None = None

    @property
    def ideal(self) -> bool:
        """Whether every sensor reads what is."""
        return all(value is None for _, value in self)
