"""Settings of the controller: gains, phases of contacts, limits of the robot, friction, estimates.

Each class is a group of keys of a scenario and the value that a program gives a controller; keys
that have a field of the same name in the law's record are copied there by name.
"""

from __future__ import annotations

from math import inf, pi, radians, sqrt
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from osc_contact.errors import InvalidInputError
from osc_contact.settings.quantities import (
    Acceleration,
    Angle,
    AngularAcceleration,
    Force,
    ForceLimit,
    Frequency,
    Length,
    LengthLimit,
    Limit,
    Mass,
    NotNegative,
    NotNegativeNumber,
    Number,
    OrderedSpec,
    Positive,
    PositiveNumber,
    Spec,
    Time,
    TimeLimit,
    Velocity,
    VelocityLimit,
    may_be_infinite,
    refuse,
)

LEAST_CEILING = 30.0  #: N; no ceiling that follows from commands is lower
HEADROOM = 3.0  #: times the largest command: such a ceiling
_UNBRAKED = 6.0  #: a speed of the contact that lasts longer than this / K_i is not braked
_DERIVED: Any = Field(default=None)  #: follows from the other gains


class _GainsOfOneLoop(OrderedSpec):
    """Gains that serve every mass, or the numbers themselves; those not given follow from them."""

    serving: ClassVar[tuple[str, ...]]
    numbers: ClassVar[tuple[str, ...]]
    example: ClassVar[str]

    @model_validator(mode="before")
    @classmethod
    def _leave_out_nulls(cls, data: Any) -> Any:
        if isinstance(data, dict):
            return {key: value for key, value in data.items() if value is not None}
        return data

    @model_validator(mode="after")
    def _complete(self) -> Self:
        values = {key: getattr(self, key) for key in self.model_fields_set}
        chosen = [key for key in self.serving if key in values]
        beside = [key for key in self.numbers if key in values]
        if chosen and beside:
            raise refuse(
                f"{', '.join(chosen)} beside {', '.join(beside)}: give {', '.join(self.serving)}, "
                f"or {', '.join(self.numbers)}; to replace them with --set, set the group: "
                f"--set '{self.example}'"
            )
        self.__dict__.update(self._values(not beside, values) | values)
        return self

    def _values(self, serves_every_mass: bool, given: dict[str, float]) -> dict[str, float]:
        """All gains; those that are given may be missing."""
        raise NotImplementedError

    @model_serializer(mode="wrap")
    def _as_given(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in write(self).items() if key in self.model_fields_set}


class MotionGains(_GainsOfOneLoop):
    """Gains of the motion law p̈_u = p̈_d + K_d ė + K_p e + K_i ∫e.

    Scalars, the same for positions and angles, so that no metre meets a radian. They are gains of
    accelerations: the model's inertia makes forces of them, so they serve every mass.

    Example:
        >>> gains = osc.MotionGains(frequency=3.0, damping_ratio=0.7)
        >>> print(f"{gains.stiffness:.0f} 1/s², {gains.damping:.1f} 1/s")
        355 1/s², 26.4 1/s
        >>> print(osc.MotionGains(stiffness=400.0, damping=40.0).damping_ratio)
        1.0
    """

    serving = ("frequency", "damping_ratio", "integral_time")
    numbers = ("stiffness", "damping", "integral")
    example = "gains.motion={frequency: 5 Hz}"

    stiffness: Annotated[NotNegativeNumber, "1/s²"] = _DERIVED
    """K_p = (2π `frequency`)²; 400 1/s² if no gain of the loop is given"""
    damping: Annotated[NotNegativeNumber, "1/s"] = _DERIVED
    """K_d = 4π `frequency` `damping_ratio`; beside `stiffness`"""
    integral: Annotated[NotNegativeNumber, "1/s³"] = _DERIVED
    """K_i = K_p / `integral_time`; beside `stiffness`, below `stiffness` × `damping`"""
    frequency: Positive[Frequency] = _DERIVED
    """natural frequency of the motion loop, the same for positions and angles; 3.2 Hz"""
    damping_ratio: NotNegativeNumber = _DERIVED
    """of the motion loop; 1"""
    integral_time: Positive[Time] = _DERIVED
    """time in which the integral does as much as the stiffness; no integral, 0.2 s with a tare"""

    @model_validator(mode="after")
    def _is_stable(self) -> Self:
        if self.integral > 0.0 and self.integral >= self.stiffness * self.damping:
            raise refuse(
                f"integral = {self.integral:g} 1/s³ is not below stiffness × damping = "
                f"{self.stiffness * self.damping:g}: the loop would be unstable (Routh); lower it, "
                "or raise integral_time"
            )
        return self

    def _values(self, serves_every_mass: bool, given: dict[str, float]) -> dict[str, float]:
        if serves_every_mass:
            omega = 2.0 * pi * given.get("frequency", 10.0 / pi)
            K = omega**2
            D = 2.0 * omega * given.get("damping_ratio", 1.0)
            K_i = K / given.get("integral_time", inf)
        elif {"stiffness", "damping"} <= given.keys():
            K = given["stiffness"]
            D = given["damping"]
            K_i = given.get("integral", 0.0)
        else:
            raise refuse("give stiffness (1/s²) and damping (1/s) together, or frequency (Hz)")
        return {
            "stiffness": K,
            "damping": D,
            "integral": K_i,
            "frequency": sqrt(K) / (2.0 * pi),
            "damping_ratio": D / (2.0 * sqrt(K)) if K > 0.0 else 0.0,
            "integral_time": K / K_i if K_i > 0.0 else inf,
        }


class ForceGains(_GainsOfOneLoop):
    """Gains of the force law α_u = α_s + K_i ∫(α_s − α_meas) dt − K_v NᵀV_rel (fig. 5).

    There is no proportional gain: a rigid contact answers a command within the same instant, so a
    proportional loop with gain ≥ 1 is unstable in discrete time at any rate.

    Example:
        >>> gains = osc.ForceGains(bandwidth=5.0, rise=0.1)
        >>> print(f"{gains.integral:.1f} 1/s, {gains.brake:.1f} 1/s")
        31.4 1/s, 44.0 1/s
    """

    serving = ("bandwidth", "damping_ratio")
    numbers = ("integral", "damping", "brake")
    example = "gains.force={bandwidth: 5 Hz}"

    integral: Annotated[NotNegativeNumber, "1/s"] = _DERIVED
    """K_i = 2π `bandwidth`, at which errors of the force fade; below 1 / period"""
    damping: Annotated[NotNegativeNumber, "N s/m"] = _DERIVED
    """K_v of the normal velocity, for one mass; beside `integral`, 0"""
    bandwidth: Positive[Frequency] = _DERIVED
    """at which errors of the force fade; 5 Hz if no gain of the loop is given"""
    damping_ratio: NotNegativeNumber = _DERIVED
    """brakes a contact that swings, by the mass behind it; 0.7; above ½ none swings up"""
    rise: NotNegative[Time] = _DERIVED
    """time that a step of a desired force or squeeze takes; 0.25 s, 0 beside `integral`"""
    tilt: Annotated[Angle, Field(ge=0, le=0.8)] = _DERIVED
    """a face on which one point slides is taken to be turned to the measured motion, by so much at
    most ([tuning](tuning.md#why)); 10 deg, 0 beside `integral`"""
    brake: Annotated[NotNegativeNumber, "1/s"] = _DERIVED
    """κ = 2 `damping_ratio` K_i of the normal velocity, a force of κ(NᵀΦN)⁻¹; beside `integral`"""

    @property
    def drift(self) -> float:
        """1/s; a normal velocity that changes more slowly belongs to a tilted face: no brake."""
        return self.integral / _UNBRAKED

    def _values(self, serves_every_mass: bool, given: dict[str, float]) -> dict[str, float]:
        K_i = 2.0 * pi * given.get("bandwidth", 5.0)
        brake = 2.0 * given.get("damping_ratio", 0.7) * K_i
        if not serves_every_mass:
            if "integral" not in given:
                raise refuse(
                    "damping (N s/m) goes with integral (1/s); give both, or damping_ratio"
                )
            K_i = given["integral"]
            brake = given.get("brake", 0.0)
        return {
            "integral": K_i,
            "damping": 0.0,
            "bandwidth": K_i / (2.0 * pi),
            "damping_ratio": brake / (2.0 * K_i) if K_i > 0.0 else 0.0,
            "rise": 0.25 * serves_every_mass,
            "tilt": radians(10.0) * serves_every_mass,
            "brake": brake,
        }


class Gains(OrderedSpec):
    """Gains of the two loops; left out, they serve every mass ([tuning](tuning.md)).

    Example:
        >>> gains = osc.Gains(osc.MotionGains(frequency=3.0), osc.ForceGains(bandwidth=8.0))
        >>> print(gains.replaced(force=osc.ForceGains(bandwidth=2.0)).motion.frequency)
        3.0
    """

    motion: MotionGains = MotionGains()
    """the motion loop: `frequency` and `damping_ratio`, or `stiffness` and `damping`"""
    force: ForceGains = ForceGains()
    """the force loop: `bandwidth`, `damping_ratio` and `rise`, or `integral` and `damping`"""


class MonitorLimits(OrderedSpec):
    """When contact counts as made, as lost, and as a collision."""

    force_on: Positive[Force] = 1.0
    """contact is made above that force"""
    force_off: Positive[Force] = 0.4
    """and lost below that, plus a fifth of the force commanded"""
    power: Annotated[PositiveNumber, "W"] = 0.05
    """a contact made with more projected power (in size) is a collision"""
    patience: NotNegative[Time] = 0.005
    """the force must stay low for so long before contact counts as lost"""
    window: NotNegative[Time] = 0.02
    """after contact is made, in which a collision is detected"""
    dwell: NotNegative[Time] = 0.0
    """the force must stay high for so long before contact counts as made (sensor noise)"""
    leaving: VelocityLimit = inf
    """an object that leaves its face faster has no contact, whatever the force: a face does not
    push on what moves away from it"""

    @model_validator(mode="after")
    def _has_hysteresis(self) -> Self:
        if not self.force_on > self.force_off:
            raise refuse(
                f"force_on = {self.force_on:g} N, force_off = {self.force_off:g} N; give force_on "
                "above force_off"
            )
        return self


class PhaseSettings(MonitorLimits):
    """How contacts are made and kept: opened, approached and closed one by one.

    Example:
        >>> life = osc.PhaseSettings(speed=0.02, travel=0.1)
        >>> print(life.push)  # N, against the face that is met
        4.0
    """

    speed: Positive[Velocity] = 0.01
    """v_a of the approach, along −N"""
    damping: Annotated[PositiveNumber, "N s/m"] = 200.0
    """K_a of the approach; K_a v_a is the force with which it meets the face"""
    travel: Positive[Length] = 0.05
    """an approach that has covered more at its speed stands still"""
    rise: Positive[Time] = 0.05
    """from contact made, with K_a v_a, to the full force"""
    least: Positive[Force] = 0.2
    """α_min, least force command of a closed contact that can only push"""
    torque_rate: Annotated[PositiveNumber, "1/s"] = 20.0
    """after a change of phase no motor torque changes faster than its limit times this"""
    share: PositiveNumber = 0.2
    """of the desired force; a closed contact with less is lost"""
    lag: Positive[Time] = 0.006
    """of the low-pass before the monitor"""
    force_on: Positive[Force] = 0.6
    """contact is made above that force"""
    force_off: Positive[Force] = 0.3
    """and lost below that, plus `share` of the force commanded"""
    power: Annotated[PositiveNumber, "W"] = 0.004
    """a contact made with more projected power is a collision"""
    dwell: NotNegative[Time] = 0.002
    """the force must stay high for so long before contact counts as made (sensor noise)"""
    leaving: VelocityLimit = 0.03
    """an object that leaves its face faster has no contact, whatever the force"""
    friction_bound: NotNegative[float] = 0.5
    """an approached contact is made by what friction of the closed ones cannot explain, their
    coefficient at most that"""

    @property
    def push(self) -> float:
        """K_a v_a (N)."""
        return self.damping * self.speed

    @model_validator(mode="after")
    def _pushes_enough(self) -> Self:
        if not self.push > self.force_on:
            raise refuse(
                f"an approach at {self.speed:g} m/s with {self.damping:g} N s/m pushes with "
                f"{self.push:g} N, which does not count as contact below force_on = "
                f"{self.force_on:g} N; raise speed or damping, or lower force_on"
            )
        return self


class SafetySettings(OrderedSpec):
    """Ticks that cannot be computed, and limits of the robot beside its motors'.

    Example:
        >>> safety = osc.SafetySettings(contact_force=50.0, contact_loss_time=0.1)
        >>> print(safety.replaced(contact_power=5.0).contact_force)
        50.0
    """

    repeats: NotNegative[int] = 2
    """ticks in a row that cannot be computed and repeat the last torques; later ones
    [hold the posture](reliability.md)"""
    stop_after: Positive[int] = 20
    """how many more such ticks than computed ones stop the controller: 20 in a row, or more than
    half of them for longer"""
    missed_share: Annotated[Limit, "–"] = 0.4
    """more of the ticks of the last second that cannot be computed (their share, low-passed with
    0.5 s) stop it: every second one for good, within 1 s, not every third"""
    overspeed_time: TimeLimit = 0.02
    """a motor joint above its speed limit for longer stops the controller; time below it is taken
    off"""
    hold_rate: Annotated[PositiveNumber, "1/s"] = 20.0
    """ω of q̈ = −2ω q̇ − ω²(q − q_hold) in a hold and a stop"""
    torque_rate: Annotated[Limit, "1/s"] = 200.0
    """no motor torque changes faster than its limit times this"""
    brake_time: NotNegative[Time] = 0.1
    """in which joints can be braked from their speed limit: they are stopped before their ends; 0:
    ends are not watched"""
    contact_power: Annotated[Limit, "W"] = 20.0
    """more power into the contacts stops the controller"""
    contact_force: ForceLimit = LEAST_CEILING
    """a contact that reads more, and more than three times its command, for `overforce_time` stops
    it"""
    overforce_time: TimeLimit = 0.15
    """see `contact_force`"""
    contact_loss_time: TimeLimit = 0.2
    """a contact that reads less than a fifth of its command for longer stops it, unless
    `control.life` handles losses"""
    regain_time: TimeLimit = 1.0
    """so does one that was lost and is not held again for longer"""
    integral_force: ForceLimit = 15.0
    """the force integral stays within that, or within 1.5 times the command where that is more"""
    integral_motion: Annotated[Limit, "m/s², rad/s²"] = 50.0
    """what the motion integral commands stays within that"""
    force_range: ForceLimit = 1000.0
    """wrist readings beyond that, and beyond three times the object's weight, are rejected"""
    torque_range: Annotated[Limit, "N m"] = 200.0
    """the same of torques, the weight on a lever of 1 m"""
    load_error: ForceLimit = 2.0
    """before any contact is made, wrists that read more than that beside the weight they carry stop
    the controller (with that force on a lever of 0.2 m, or of the tool's length, as a torque)"""
    plausible_speed: Limit = 3.0
    """times a joint's speed limit: faster ones, and positions that jump further, are rejected"""
    wrench_timeout: TimeLimit = 0.02
    """ticks continue with the last wrenches for so long; stamps may stand still for so long"""
    stuck_speed: Limit = 0.1
    """times a joint's speed limit: a joint that is commanded to gain more while its encoder repeats
    one reading stops the controller, as far as more torque drives it than friction takes"""
    frozen_time: TimeLimit = 0.25
    """a wrist in contact, or a whole packet of noisy readings, that repeats itself for longer stops
    it"""
    speed_error: Limit = 0.1
    """times a joint's speed limit: speeds that differ from those of the positions by more, for
    20 ms or so, stop it"""
    position_drift: Annotated[Limit, "rad, m"] = 0.02
    """positions that drift by more from the integral of the speeds, within half a second, stop
    it"""
    wrist_error: Limit = 0.05
    """times a motor's torque limit: torques that the model and the wrist's reading leave
    unexplained by more than is usual, or by twice that in all, stop the arms: a wrist that is
    mirrored, scaled, offset or of another arm"""
    closure_error: LengthLimit = 0.02
    """arms whose encoders place the object they hold further apart stop"""
    contact_ceiling: ForceLimit | None = None
    """a contact that reads more for `ceiling_time` stops the arms, whatever is commanded, and a
    larger command is refused before the start; null: three times the largest command (of a contact
    or `squeeze`), at least 30 N ([ceilings](reliability.md#ceilings))"""
    wrist_ceiling: ForceLimit | None = None
    """the same of the force that a wrist bears beside weight and inertia; null: three times the
    largest sum of all commands, at least 30 N"""
    speed_ceiling: VelocityLimit = 0.5
    """the same of the speed of a tip"""
    ceiling_time: TimeLimit = 0.02
    """see `contact_ceiling`"""

    def for_commands(self, largest: float, total: float) -> Self:
        """The same with ceilings for commands that are all known beforehand; given ones stay.

        Args:
            largest: command of one contact, or squeeze (N). total: largest sum of all of them (N).
        """
        commands = {"contact_ceiling": largest, "wrist_ceiling": total}
        derived = {
            key: max(LEAST_CEILING, HEADROOM * command)
            for key, command in commands.items()
            if getattr(self, key) is None
        }
        return self.replaced(**derived)

    @classmethod
    def motors_only(cls, **keys: Any) -> SafetySettings:
        """No limits but those of the motors and of `keys`: for ticks that are not one motion."""
        unlimited = {key: inf for key, field in cls.model_fields.items() if may_be_infinite(field)}
        return cls(**{"brake_time": 0.0, **unlimited, **keys})

    @model_validator(mode="after")
    def _stops_after_repeats(self) -> Self:
        if self.repeats >= self.stop_after:
            raise refuse(
                f"repeats = {self.repeats}, stop_after = {self.stop_after}; give repeats < "
                "stop_after"
            )
        return self


def require_below_ceilings(safety: SafetySettings, force: float, contacts: int) -> None:
    """Refuse commands that could be above the ceilings that are given.

    Args:
        safety: of the controller. force: the largest command of a contact (N). contacts: number
            of forces that may be commanded so at once.

    Raises:
        InvalidInputError: a ceiling is lower, with the cure.
    """
    for key, command in (("contact_ceiling", force), ("wrist_ceiling", contacts * force)):
        ceiling = getattr(safety, key)
        if ceiling is not None and command > ceiling:
            raise InvalidInputError(
                f"forces of up to {force:g} N in {contacts} contacts may be commanded, above "
                f"safety.{key} = {ceiling:g} N, at which the arms are stopped; lower most_force, "
                f"or raise control.safety.{key}"
            )


class Friction(OrderedSpec):
    """Friction at the contacts that the controller takes into account.

    Example:
        >>> print(osc.Friction(mu=0.2))
        mu=0.2 slip=0.002 learning=8.0
    """

    mu: NotNegativeNumber
    """the Coulomb coefficient, the same at all contacts, such as 0.1"""
    slip: Positive[Velocity] = 0.002
    """v_0, the slip speed from which on friction counts as fully developed; below it the direction
    is not known well enough to push against"""
    learning: Annotated[NotNegativeNumber, "1/s"] = 8.0
    """how fast μ follows what `least_squares` reads while contacts slide; 0: not at all; `filter`
    learns nothing"""


class JointFriction(OrderedSpec):
    """Friction of the joints: as the controller's model has it, or learned from there on.

    Example:
        >>> print(osc.JointFriction(learning=False).share)
        0.7
    """

    learning: bool = True
    """whether Coulomb and viscous friction of each joint are learned from motors and wrists,
    beginning with the values of the model; else these are compensated as they are"""
    share: Annotated[Number, Field(ge=0, lt=1)] = 0.7
    """g: of the friction that is not learned (stiction, Stribeck), which an observer compensates;
    with 1 joints would seem frictionless at rest, and contacts hunt"""
    errors: bool | None = None
    """whether the observer compensates wrong masses of the links, too, up to 0.3 of the torque that
    they are modelled to take; null: if there is a `tare`"""
    smoothing: Annotated[PositiveNumber, "1/s"] = 70.0
    """K_d, of that observer"""
    most: Annotated[Number, Field(gt=0, le=1)] = 0.3
    """times a motor's torque limit: more friction is neither assumed nor compensated"""


class PostureTask(OrderedSpec):
    """What redundant arms do with joints they do not need."""

    stiffness: Annotated[NotNegativeNumber, "1/s²"] = 25.0
    """of the pull towards the posture"""
    damping: Annotated[NotNegativeNumber, "1/s"] = 10.0
    """of joint motions beside the task"""
    retreat_damping: Annotated[NotNegativeNumber, "1/s"] = 50.0
    """instead of `damping`, of joint motions that a singular posture takes from the task"""
    limit_stiffness: Annotated[NotNegativeNumber, "1/s²"] = 400.0
    """of the push away from joint limits; 0: none"""
    limit_margin: Annotated[Number, Field(gt=0, lt=0.5)] = 0.05
    """where that push begins, as a share of the joint's range"""


class JointTorqueSpec(Spec):
    """The joint torque loop: its rate (Hz), gain and damping ratio."""

    rate: Positive[Frequency]
    """the rate of the loop, a whole multiple of `control.rate`, such as 4 kHz"""
    gain: PositiveNumber = 60.0
    """k_p: errors of motor and spring seem 1 + gain times smaller"""
    damping_ratio: PositiveNumber = 0.7
    """of the closed loop"""


class ForceReadingSpec(Spec):
    """How contact forces are read off the wrists; null: as `Controller` chooses."""

    reading: Literal["filter", "least_squares"] | None = None
    """`filter` (fig. 5) or `least_squares`; null: the latter where its answer is unique"""


class EstimateSpec(Spec):
    """Accelerations that the estimates of velocities do not know of: joints, tracked bodies."""

    joint_angular: Positive[AngularAcceleration] = 0.8
    """of turning joints"""
    joint_linear: Positive[Acceleration] = 0.5
    """of sliding joints"""
    body_angular: Positive[AngularAcceleration] = 0.1
    """of tracked bodies"""
    body_linear: Positive[Acceleration] = 0.05
    """of tracked bodies"""
    measured_forces: bool = False
    """whether measured contact forces give accelerations of the joints: for coarse encoders on
    walls that spring; where the object is struck, velocities are then estimated worse"""


class Dither(Spec):
    """A bounded sine along the line between two points of contact, so that they show their normals.

    It begins when contacts engage, and fades."""

    amplitude: Positive[Length] = 4e-3
    """of the motion along the line, as far as arms and contacts permit it"""
    frequency: Positive[Frequency] = 2.0
    """its frequency"""
    duration: Positive[Time] = 2.5
    """after which it has faded"""


class ControlSpec(Spec):
    """Tick rate (Hz), the metric B of eq. 24, where N comes from, how contacts live."""

    rate: Positive[Frequency]
    """the tick rate, such as 1 kHz"""
    metric: Literal["object", "chain"] = "object"
    """B of eq. 24: `object` (Λ_o⁻¹) or `chain` ((ΣΛ_i + Λ_o)⁻¹)"""
    contacts: Literal["declared", "detected"] = "declared"
    """`detected`: the controller finds them from the collision geometry as it moves"""
    joint_torque: JointTorqueSpec | None = None
    """the joint torque loop; needs `plant.flexible_joints`"""
    force: ForceReadingSpec = ForceReadingSpec()
    """[how contact forces are read off the wrists](friction.md)"""
    friction: Friction | None = None
    """friction at the contacts that the controller takes into account"""
    joint_friction: JointFriction | None = JointFriction()
    """[friction of the joints](joint_friction.md), compensated and learned; `off`: neither"""
    life: PhaseSettings | None = PhaseSettings()
    """[contacts opened, approached and closed](contact_phases.md) one by one, as their forces are
    > 0 or not; `off`: all at once, by `tare` (and the default beside one)"""
    dither: Dither | None = None
    """a motion by which [two points show their normals](friction.md#all-errors-at-once)"""
    safety: SafetySettings = SafetySettings()
    """ticks that cannot be computed, [limits of the robot](reliability.md#limits-of-the-robot):
    [safety states](reliability.md); `.inf`: no limit"""
    estimate: EstimateSpec = EstimateSpec()
    """accelerations that the velocity estimates do not know of"""

    @field_validator("life", "joint_friction", mode="before")
    @classmethod
    def _may_be_off(cls, value: object) -> object:
        return None if value is False or value == "off" else value


class ModelErrorSpec(Spec):
    """What the controller's model has wrong: masses, friction and faces."""

    object_mass: PositiveNumber = 1.0
    """factor on the controller's object mass and inertia"""
    arm_mass: PositiveNumber = 1.0
    """factor on the controller's link masses and inertias"""
    hidden_mass: NotNegative[Mass] = 0.0
    """a mass that the controller does not know of, in the object where the first arm grasps it"""
    joint_friction: NotNegativeNumber = 1.0
    """factor on the joint friction and damping of the controller's model"""
    armature: NotNegativeNumber = 1.0
    """factor on the rotor inertias of the controller's model"""
    environment: Literal["known", "yielding", "ignored"] = "known"
    """`ignored`: the law takes every face as unyielding and unaccelerated (Φ_e = 0, b_e = 0);
    `yielding`: but that carts on springs yield ([soft faces](tuning.md#soft-faces))"""
    face_offset: Length = 0.0
    """the controller takes each body touched to stand so much nearer, along its first line of
    force"""
    face_tilt: Angle = 0.0
    """and to be turned by this angle, about where that line meets it"""
    face_tilt_about: Angle = 0.0
    """the axis of that turn: the horizontal direction across the line, turned about the line by
    this angle"""


class TareSpec(Spec):
    """Zeroing of the wrist sensors in free space before contact is made."""

    duration: Positive[Time] = 0.4
    """at rest off the faces, without the motion; the last third is averaged"""
    standoff: Positive[Length] = 0.01
    """gap during that time"""
    approach: Positive[Time] = 0.3
    """time from there to contact; where contacts have phases these meet it at their own speed. The
    motion begins once contacts engage, where they have phases with the approach, and is that of
    its signals after three times as long"""


class VerdictSpec(Spec):
    """Beyond these limits a run's task has failed (`verdict`), see `lab.runs.verdict`."""

    force_rms: PositiveNumber = 0.1
    """rms error of a force, of its mean command"""
    limit_cycle: PositiveNumber = 0.05
    """amplitude of a [limit cycle](metrics.md#limit-cycles), of the mean command"""
    open_share: NotNegativeNumber = 0.01
    """of its judged time that a contact is open"""
    lost_time: Positive[Time] = 0.05
    """that a contact is open in a row while the controller takes it as closed"""
    distance: Positive[Length] = 0.1
    """of the object from its reference, along the free directions"""
    angle: Positive[Angle] = 0.3
    """of the object from its reference, along the free directions"""
    held_share: NotNegativeNumber = 0.01
    """of the ticks that could not be computed"""
