"""How it is controlled and simulated: gains, tick, model error, tare and plant."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from .hardware import (
    EstimateSpec,
    FlexibleJointsSpec,
    FrictionSpec,
    JointTorqueSpec,
    MotorsSpec,
)
from .quantities import (
    Angle,
    Force,
    ForceVec3,
    Frequency,
    Length,
    Mass,
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
    "ForceGainsSpec",
    "ForceReadingSpec",
    "GainsSpec",
    "PhasesSpec",
    "ModelErrorSpec",
    "MotionGainsSpec",
    "PlantSpec",
    "PushSpec",
    "SafetySpec",
    "TareSpec",
    "VerdictSpec",
]

#: What `plant.type` may be, and whether that plant is exact: ideal joints, contacts that neither
#: open nor end. `runs.plants.register_plant` adds to it.
PLANT_TYPES: dict[str, bool] = {"mujoco": False, "rigid": True}

Fraction = Annotated[Number, Field(gt=0, lt=1)]


class MotionGainsSpec(Spec):
    """The motion loop: natural frequency (Hz) and damping ratio, or the gains themselves."""

    frequency: Annotated[Frequency, Field(gt=0)] | None = None
    damping_ratio: NotNegative | None = None
    integral_time: Annotated[Time, Field(gt=0)] | None = None
    stiffness: NotNegative | None = None
    """a number in 1/s²"""
    damping: NotNegative | None = None
    """a number in 1/s"""
    integral: NotNegative | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> MotionGainsSpec:
        _require_one_kind(
            self, ("frequency", "damping_ratio", "integral_time"),
            ("stiffness", "damping", "integral"), "gains.motion={frequency: 5 Hz}",
        )  # fmt: skip
        if (self.stiffness is None) != (self.damping is None) or (
            self.integral is not None and self.stiffness is None
        ):
            raise refuse("give stiffness (1/s²) and damping (1/s) together, or frequency (Hz)")
        return self


class ForceGainsSpec(Spec):
    """The force loop (fig. 5): bandwidth (Hz) and damping ratio, or gains for one mass."""

    bandwidth: Annotated[Frequency, Field(gt=0)] | None = None
    damping_ratio: NotNegative | None = None
    rise: Annotated[Time, Field(ge=0)] | None = None
    tilt: Annotated[Angle, Field(ge=0, le=0.8)] | None = None
    integral: NotNegative | None = None
    """a number in 1/s"""
    damping: NotNegative | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> ForceGainsSpec:
        _require_one_kind(
            self, ("bandwidth", "damping_ratio"), ("integral", "damping"),
            "gains.force={bandwidth: 5 Hz}",
        )  # fmt: skip
        if self.damping is not None and self.integral is None:
            raise refuse("damping (N s/m) goes with integral (1/s); give both, or damping_ratio")
        return self


def _require_one_kind(
    spec: Spec, words: tuple[str, ...], plain: tuple[str, ...], cure: str
) -> None:
    """Refuse gains that serve every mass beside gains that they replace."""
    chosen, beside = (
        [key for key in keys if getattr(spec, key) is not None] for keys in (words, plain)
    )
    if chosen and beside:
        raise refuse(
            f"{', '.join(chosen)} beside {', '.join(beside)}: give {', '.join(words)}, or "
            f"{', '.join(plain)}; to replace them with --set, set the group: --set '{cure}'"
        )


class GainsSpec(Spec):
    """Gains of both loops; what is left out serves every mass."""

    motion: MotionGainsSpec = MotionGainsSpec()
    """frequency and damping_ratio, or stiffness and damping, of the motion loop"""
    force: ForceGainsSpec = ForceGainsSpec()
    """bandwidth, damping_ratio and rise, or integral and damping, of the force loop"""


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
    overspeed_time: Annotated[Time, Field(gt=0)] = 0.02
    hold_rate: Positive = 20.0
    torque_rate: Positive = 200.0
    brake_time: Annotated[Time, Field(ge=0)] = 0.1
    contact_power: Positive = 20.0
    contact_force: Annotated[Force, Field(gt=0)] = 30.0
    overforce_time: Annotated[Time, Field(gt=0)] = 0.15
    contact_loss_time: Annotated[Time, Field(gt=0)] = 0.2
    regain_time: Annotated[Time, Field(gt=0)] = 1.0
    integral_force: Annotated[Force, Field(gt=0)] = 15.0
    integral_motion: Positive = 50.0
    force_range: Annotated[Force, Field(gt=0)] = 1000.0
    torque_range: Positive = 200.0
    load_error: Annotated[Force, Field(gt=0)] = 2.0
    plausible_speed: Positive = 3.0
    wrench_timeout: Annotated[Time, Field(gt=0)] = 0.02
    stuck_speed: Positive = 0.1
    frozen_time: Annotated[Time, Field(gt=0)] = 0.25
    speed_error: Positive = 0.1
    position_drift: Positive = 0.02
    wrist_error: Positive = 0.05
    closure_error: Annotated[Length, Field(gt=0)] = 0.02


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
    life: PhasesSpec | None = PhasesSpec()
    safety: SafetySpec = SafetySpec()
    estimate: EstimateSpec = EstimateSpec()

    @field_validator("life", mode="before")
    @classmethod
    def _may_be_off(cls, value: object) -> object:
        return None if value is False or value == "off" else value


class ModelErrorSpec(Spec):
    """What the controller believes wrongly of masses, friction and faces."""

    object_mass: Positive = 1.0
    arm_mass: Positive = 1.0
    hidden_mass: Annotated[Mass, Field(ge=0)] = 0.0
    joint_friction: NotNegative = 1.0
    environment: Literal["known", "ignored"] = "known"
    face_offset: Length = 0.0
    face_tilt: Angle = 0.0
    face_tilt_about: Angle = 0.0


class TareSpec(Spec):
    """Zeroing of the wrist sensors in free space before contact is made."""

    duration: Annotated[Time, Field(gt=0)] = 0.4
    standoff: Annotated[Length, Field(gt=0)] = 0.01
    approach: Annotated[Time, Field(gt=0)] = 0.3


class VerdictSpec(Spec):
    """Beyond these limits a run's task has failed (`verdict`), see `runs.outcome`."""

    force_rms: Positive = 0.1
    limit_cycle: Positive = 0.05
    open_share: NotNegative = 0.01
    lost_time: Annotated[Time, Field(gt=0)] = 0.05
    distance: Annotated[Length, Field(gt=0)] = 0.1
    angle: Annotated[Angle, Field(gt=0)] = 0.3
    held_share: NotNegative = 0.01


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
