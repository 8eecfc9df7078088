"""How it is controlled and simulated: gains, tick, model error, tare and plant."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from .hardware import (
    EstimateSpec,
    FlexibleJointsSpec,
    FrictionSpec,
    JointTorqueSpec,
    MotorsSpec,
)
from .quantities import (
    Force,
    ForceVec3,
    Frequency,
    Length,
    NotNegative,
    Number,
    Positive,
    Spec,
    Time,
    refuse,
)

__all__ = [
    "PLANT_TYPES",
    "ControlSpec",
    "ForceGains",
    "ForceReadingSpec",
    "GainsSpec",
    "PhasesSpec",
    "ModelErrorSpec",
    "MotionGains",
    "PlantSpec",
    "PushSpec",
    "SafetySpec",
    "TareSpec",
]

#: What `plant.type` may be, and whether that plant is exact: ideal joints, contacts that neither
#: open nor end. `runs.plants.register_plant` adds to it.
PLANT_TYPES: dict[str, bool] = {"mujoco": False, "rigid": True}

Fraction = Annotated[Number, Field(gt=0, lt=1)]


class MotionGains(Spec):
    """Gains of the motion loop: stiffness 1/s², damping 1/s, integral 1/s³."""

    stiffness: NotNegative
    """a number in 1/s²"""
    damping: NotNegative
    """a number in 1/s"""
    integral: NotNegative = 0.0


class ForceGains(Spec):
    """Gains of the force loop (fig. 5): integral 1/s, damping N s/m."""

    integral: NotNegative
    """a number in 1/s"""
    damping: NotNegative = 0.0


class GainsSpec(Spec):
    """Gains of both loops."""

    motion: MotionGains
    """stiffness, damping and integral of the motion loop"""
    force: ForceGains
    """integral and damping of the force loop"""


class PhasesSpec(Spec):
    """Contacts opened, approached and closed one by one (`control.life`)."""

    speed: Positive = 0.01
    damping: Positive = 200.0
    travel: Annotated[Length, Field(gt=0)] = 0.05
    rise: Annotated[Time, Field(gt=0)] = 0.05
    least: Annotated[Force, Field(gt=0)] = 0.2
    torque_rate: Positive = 20.0
    force_on: Annotated[Force, Field(gt=0)] = 0.6
    force_off: Annotated[Force, Field(gt=0)] = 0.3
    power: Positive = 0.004


class SafetySpec(Spec):
    """What happens to ticks that cannot be computed, and to joints too fast (`control.safety`)."""

    repeats: Annotated[int, Field(ge=0)] = 2
    stop_after: Annotated[int, Field(gt=0)] = 20
    too_fast_for: Annotated[Time, Field(gt=0)] = 0.02
    hold_rate: Positive = 20.0
    torque_rate: Positive = 200.0
    brake_time: Annotated[Time, Field(ge=0)] = 0.1
    contact_power: Positive = 20.0
    contact_force: Annotated[Force, Field(gt=0)] = 30.0
    pressed_for: Annotated[Time, Field(gt=0)] = 0.15
    unfelt_for: Annotated[Time, Field(gt=0)] = 0.2
    integral_force: Annotated[Force, Field(gt=0)] = 15.0
    integral_motion: Positive = 50.0


class ForceReadingSpec(Spec):
    """How contact forces are read off the wrists; null: as `Controller` chooses."""

    reading: Literal["filter", "least_squares"] | None = None


class ControlSpec(Spec):
    """Tick rate (Hz), the metric B of eq. 24, where N comes from, how contacts live."""

    rate: Annotated[Frequency, Field(gt=0)]
    """the tick rate, such as 1 kHz"""
    metric: Literal["object", "chain"] = "object"
    contacts: Literal["declared", "detected"] = "declared"
    joint_torque: JointTorqueSpec | None = None
    force: ForceReadingSpec = ForceReadingSpec()
    friction: FrictionSpec | None = None
    joint_friction: bool = True
    life: PhasesSpec | None = None
    safety: SafetySpec = SafetySpec()
    estimate: EstimateSpec = EstimateSpec()


class ModelErrorSpec(Spec):
    """What the controller believes wrongly: factors on masses and inertias, faces that yield."""

    object_mass: Positive = 1.0
    arm_mass: Positive = 1.0
    joint_friction: NotNegative = 1.0
    environment: Literal["known", "ignored"] = "known"


class TareSpec(Spec):
    """Zeroing of the wrist sensors in free space before contact is made."""

    duration: Annotated[Time, Field(gt=0)] = 0.3
    standoff: Annotated[Length, Field(gt=0)] = 0.003
    approach: Annotated[Time, Field(gt=0)] = 0.3


class PushSpec(Spec):
    """A half sine of force on the wrist of an arm from outside, once or again and again."""

    arm: str
    """the name of an arm with a wrist sensor"""
    force: ForceVec3
    """its peak [x, y, z] in world"""
    start: Annotated[Time, Field(ge=0)] = 0.0
    duration: Annotated[Time, Field(gt=0)]
    """how long it acts, such as 20 ms"""
    every: Annotated[Time, Field(ge=0)] = 0.0


class PlantSpec(Spec):
    """The simulated workcell: step (s) and the contact parameters of the MuJoCo plant."""

    type: str = "mujoco"
    step: Annotated[Time, Field(gt=0)]
    """the simulation step, such as 0.25 ms"""
    solref: tuple[Positive, Positive] = (0.01, 1.0)
    solimp: tuple[Fraction, Fraction, Positive] = (0.2, 0.9, 0.0005)
    friction: NotNegative = 0.0
    friction_solref: tuple[Positive, Positive] | None = None
    flexible_joints: FlexibleJointsSpec | None = None
    motors: MotorsSpec | None = None
    joint_friction: NotNegative = 0.0
    pushes: tuple[PushSpec, ...] = ()

    @field_validator("type")
    @classmethod
    def _is_registered(cls, value: str) -> str:
        if value not in PLANT_TYPES:
            *names, last = map(repr, PLANT_TYPES)
            raise refuse(f"expected {', '.join(names)} or {last}; got {value!r}")
        return value

    @property
    def exact(self) -> bool:
        """Whether joints are ideal and contacts bilateral, without ends: see `PLANT_TYPES`."""
        return PLANT_TYPES[self.type]
