"""Settings of the controller: phases of contacts, limits of the robot, friction, estimates.

Each class is a group of keys of a scenario, and also an argument of a controller in programs. Keys
with the name of a field in the law's MODEL are copied to it by name. The gains are in `gains`.
"""

from __future__ import annotations

from math import inf
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    field_validator,
    model_validator,
)

from osc_contact.errors import InvalidInputError
from osc_contact.settings.quantities import (
    Acceleration,
    Angle,
    AngularAcceleration,
    Count,
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

LEAST_CEILING = 30.0  #: N, lowest ceiling that is derived from commands
Ceiling = ForceLimit | None  #: None: derived from commands, see `HEADROOM`
HEADROOM = 3.0  #: ceiling that is derived from commands, as a multiple of the largest one


class MonitorLimits(OrderedSpec):
    """Thresholds of the detection of contact, its loss, and collisions."""

    force_on: Positive[Force] = 1.0
    """force above which contact is made"""
    force_off: Positive[Force] = 0.4
    """force below which contact is lost, to which a fifth of the commanded force is added"""
    power: Annotated[PositiveNumber, "W"] = 0.05
    """magnitude of the projected power above which a new contact is a collision"""
    patience: NotNegative[Time] = 0.005
    """time for which the force must be low before contact is lost"""
    window: NotNegative[Time] = 0.02
    """time after contact is made in which a collision is detected"""
    dwell: NotNegative[Time] = 0.0
    """time for which the force must be high before contact is made (sensor noise)"""
    leaving: VelocityLimit = inf
    """speed of separation above which there is no contact at any force, because a face does not
    push on an object that moves away from it"""

    @model_validator(mode="after")
    def _has_hysteresis(self) -> Self:
        """Refuse a threshold `force_off` that is not below `force_on`: contacts would flicker."""
        if not self.force_on > self.force_off:
            raise refuse(
                f"force_on = {self.force_on:g} N, force_off = {self.force_off:g} N; give force_on "
                "above force_off"
            )
        return self


class PhaseSettings(MonitorLimits):
    """Settings of contact phases, by which contacts are opened, approached and closed one by one.

    Example:
        >>> life = osc.PhaseSettings(speed=0.02, travel=0.1)
        >>> print(life.push)  # N, against the face that is met
        4.0
    """

    speed: Positive[Velocity] = 0.01
    """speed v_a of the approach, along −N"""
    damping: Annotated[PositiveNumber, "N s/m"] = 200.0
    """gain K_a of the approach; the face is touched with the force K_a v_a"""
    travel: Positive[Length] = 0.05
    """distance at the speed of the approach after which it stops"""
    rise: Positive[Time] = 0.05
    """time from a new contact, with the force K_a v_a, to the full force"""
    least: Positive[Force] = 0.2
    """α_min, least force command of a closed contact that can only push"""
    torque_rate: Annotated[PositiveNumber, "1/s"] = 20.0
    """largest rate of the motor torques after a change of phase, as a multiple of their limits"""
    share: PositiveNumber = 0.2
    """share of the commanded force below which a closed contact is lost"""
    lag: Positive[Time] = 0.006
    """time constant of the low-pass before the monitor"""
    force_on: Positive[Force] = 0.6
    """force above which contact is made"""
    force_off: Positive[Force] = 0.3
    """force below which contact is lost, to which `share` of the commanded force is added"""
    power: Annotated[PositiveNumber, "W"] = 0.004
    """projected power above which a new contact is a collision"""
    dwell: NotNegative[Time] = 0.002
    """time for which the force must be high before contact is made (sensor noise)"""
    leaving: VelocityLimit = 0.03
    """speed of separation above which there is no contact at any force"""
    return_speed: Positive[Velocity] = 0.1
    """largest speed of the return to where contact was lost"""
    friction_bound: NotNegativeNumber = 0.5
    """largest coefficient of friction assumed at closed contacts when an approached contact is
    detected: only force that this friction cannot explain counts"""

    @property
    def push(self) -> float:
        """Force K_a v_a (N) with which an approach touches its face."""
        return self.damping * self.speed

    @model_validator(mode="after")
    def _pushes_enough(self) -> Self:
        """Refuse an approach whose force on impact is not above `force_on`."""
        if not self.push > self.force_on:
            raise refuse(
                f"an approach at {self.speed:g} m/s with {self.damping:g} N s/m pushes with "
                f"{self.push:g} N, which does not count as contact below force_on = "
                f"{self.force_on:g} N; raise speed or damping, or lower force_on"
            )
        return self


class SafetySettings(OrderedSpec):
    """Limits of the robot in addition to its motors', and handling of ticks not computed.

    Example:
        >>> safety = osc.SafetySettings(contact_force=50.0, contact_loss_time=0.1)
        >>> print(safety.replaced(contact_power=5.0).contact_force)
        50.0
    """

    repeats: Count = 2
    """largest number of consecutive ticks not computed for which the last torques are repeated;
    further ones [hold the posture](reliability.md)"""
    stop_after: Positive[int] = 20
    """excess of ticks not computed over computed ones that stops the arms: 20 in sequence, or more
    than half of the ticks for a longer time"""
    missed_share: Annotated[Limit, "–"] = 0.4
    """share of ticks not computed in about the last second (low-passed with 0.5 s) above which the
    arms are stopped: if every second tick fails within 1 s, if every third fails never"""
    hop_share: Annotated[Limit, "–"] = 0.3
    """share of about the last second (low-passed with 1 s) with less than a fifth of the command,
    from which on a contact is called [hopping](reliability.md#hopping-contacts), if `hop_rate` is
    reached, too"""
    hop_rate: Annotated[Limit, "1/s"] = 4.0
    """falls of a force below a fifth of its command per second, low-passed likewise"""
    hop_stops: bool = False
    """whether a hopping contact stops the arms; if not, ticks end `HOPPING`"""
    overspeed_time: TimeLimit = 0.02
    """time of a motorised joint above its speed limit that stops the arms; time below the limit is
    subtracted"""
    hold_rate: Annotated[PositiveNumber, "1/s"] = 20.0
    """rate ω of q̈ = −2ω q̇ − ω²(q − q_hold) in a hold and a stop"""
    torque_rate: Annotated[Limit, "1/s"] = 200.0
    """largest rate of the motor torques, as a multiple of their limits"""
    brake_time: NotNegative[Time] = 0.1
    """time in which joints can be braked from their speed limits, so that they are stopped before
    the ends of their ranges; 0: ends are not monitored"""
    contact_power: Annotated[Limit, "W"] = 20.0
    """power into the contacts above which the arms are stopped"""
    contact_force: ForceLimit = LEAST_CEILING
    """measured force of a contact that stops the arms if it is also larger than three times its
    command, after `overforce_time`"""
    overforce_time: TimeLimit = 0.15
    """time above `contact_force` that stops the arms"""
    contact_loss_time: TimeLimit = 0.2
    """time of a contact below a fifth of its command that stops the arms, unless `control.life`
    handles losses"""
    regain_time: TimeLimit = 1.0
    """time after a loss of contact in which it must be regained, else the arms are stopped"""
    integral_force: ForceLimit = 15.0
    """largest magnitude of the force integral, or 1.5 times the command if that is larger"""
    integral_motion: Annotated[Limit, "m/s², rad/s²"] = 50.0
    """largest magnitude of the acceleration that the motion integral commands"""
    force_range: ForceLimit = 1000.0
    """force above which wrist readings are rejected; at least three times the object's weight"""
    torque_range: Annotated[Limit, "N m"] = 200.0
    """torque above which wrist readings are rejected; at least three times the object's weight on a
    lever of 1 m"""
    load_error: ForceLimit = 2.0
    """difference between wrist readings and the weight of the load before any contact is made,
    above which the controller does not start (for torques, this force on a lever of 0.2 m or of the
    tool's length)"""
    plausible_speed: Limit = 3.0
    """speed above which readings of a joint are rejected, and positions that jump accordingly, as a
    multiple of its speed limit"""
    wrench_timeout: TimeLimit = 0.02
    """time for which ticks continue with the last wrenches, and for which time stamps may be
    constant"""
    stuck_speed: Limit = 0.1
    """speed that a joint may be commanded to gain, by more torque than friction, while its encoder
    repeats one reading, as a share of its speed limit; more stops the arms"""
    frozen_time: TimeLimit = 0.25
    """time of identical readings of a wrist in contact, of one of its forces or torques, or of all
    noisy sensors, that stops the arms"""
    speed_error: Limit = 0.1
    """difference between speeds and changes of the positions, low-passed with 20 ms, that stops the
    arms, as a share of a joint's speed limit"""
    position_drift: Annotated[Limit, "rad, m"] = 0.02
    """drift between positions and the integral of the speeds within half a second that stops the
    arms; a quarter of it, in any time, where a position is constant and speeds exceed 2 mrad/s
    (mm/s)"""
    wrist_error: Limit = 0.05
    """deviation of the unexplained motor torque from its long-term mean that stops the arms, as a
    share of a motor's torque limit (twice as much for the torque itself): a wrist sensor may be
    mirrored, scaled, offset or that of another arm"""
    closure_error: LengthLimit = 0.02
    """distance between the places of the held object by the encoders of several arms that stops
    the arms, also if it will be reached by the present speed within the
    [horizon](reliability.md#sensor-fault-detection) of gaps"""
    contact_ceiling: Ceiling = None
    """measured force of a contact that stops the arms after `ceiling_time` for any command; a
    larger command is refused before the start; null: three times the largest command (of a contact
    or `squeeze`), at least 30 N ([ceilings](reliability.md#ceilings))"""
    wrist_ceiling: Ceiling = None
    """force on a wrist, without weight and inertia, that stops the arms after `ceiling_time`; null:
    three times the largest sum of all commands, at least 30 N"""
    speed_ceiling: VelocityLimit = 0.5
    """speed of a tip that stops the arms after `ceiling_time`"""
    ceiling_time: TimeLimit = 0.02
    """time above a ceiling that stops the arms"""

    def for_commands(self, largest: float, total: float) -> Self:
        """Copy the settings with ceilings derived from commands that are known in advance.

        A ceiling that is set remains.

        Args:
            largest: largest command of a contact or squeeze (N).
            total: largest sum of all commands (N).
        """
        commands = {"contact_ceiling": largest, "wrist_ceiling": total}
        derived_limits = {
            key: max(LEAST_CEILING, HEADROOM * command)
            for key, command in commands.items()
            if getattr(self, key) is None
        }
        return self.replaced(**derived_limits)

    @classmethod
    def motors_only(cls, **keys: Any) -> SafetySettings:
        """Make settings without limits except those of the motors.

        They are for ticks that are not successive states of a motion, as in tests of random states.

        Args:
            **keys: limits that apply nevertheless, by their names.
        """
        unlimited = {key: inf for key, field in cls.model_fields.items() if may_be_infinite(field)}
        return cls(**{"brake_time": 0.0, **unlimited, **keys})

    @model_validator(mode="after")
    def _stops_after_repeats(self) -> Self:
        """Refuse `repeats` that are not below `stop_after`."""
        if self.repeats >= self.stop_after:
            raise refuse(
                f"repeats = {self.repeats}, stop_after = {self.stop_after}; give repeats < "
                "stop_after"
            )
        return self


def require_below_ceilings(safety: SafetySettings, force: float, contacts: int) -> None:
    """Refuse force commands that may exceed the ceilings at which the arms are stopped.

    Args:
        safety: settings of the controller.
        force: largest command of a contact (N).
        contacts: number of forces that may be commanded together.

    Raises:
        InvalidInputError: a ceiling that is set is below the force, or below the sum of all.
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
    """the Coulomb coefficient, the same at all contacts, for example 0.1"""
    slip: Positive[Velocity] = 0.002
    """slip speed v_0 below which the modelled friction is reduced, because its direction is
    uncertain"""
    learning: Annotated[NotNegativeNumber, "1/s"] = 8.0
    """rate at which μ follows the friction measured by `least_squares` while contacts slide; 0: μ
    is constant, as with `filter`"""


class JointFriction(OrderedSpec):
    """Compensation of joint friction, and its identification from the model's values on.

    Example:
        >>> print(osc.JointFriction(learning=False).share)
        0.7
    """

    learning: bool = True
    """whether Coulomb and viscous friction of each joint are identified from motors and wrists,
    beginning with the values of the model; if not, the latter are compensated"""
    share: Annotated[Number, Field(ge=0, lt=1)] = 0.7
    """share g of the friction not identified (stiction, Stribeck) that an observer compensates;
    with 1 joints would be frictionless at rest, and contact forces would oscillate (hunting)"""
    errors: bool | None = None
    """whether the observer also compensates errors of the links' masses, up to 0.3 times their
    modelled torque; null: if there is a `tare`"""
    smoothing: Annotated[PositiveNumber, "1/s"] = 70.0
    """rate K_d of that observer"""
    brake_ratio: NotNegativeNumber = 4.0
    """largest ratio κ/K_i to which K_i may be reduced where
    [friction of the joints can excite contacts](tuning.md#why); 0: K_i stays"""
    most: Annotated[Number, Field(gt=0, le=1)] = 0.3
    """largest friction that is identified and compensated, as a share of a motor's torque limit"""


class PostureTask(OrderedSpec):
    """Posture task of redundant arms, in the null space of the object's motion."""

    stiffness: Annotated[NotNegativeNumber, "1/s²"] = 25.0
    """stiffness of the attraction to the posture"""
    damping: Annotated[NotNegativeNumber, "1/s"] = 10.0
    """damping of joint motions in the null space"""
    retreat_damping: Annotated[NotNegativeNumber, "1/s"] = 50.0
    """damping, in place of `damping`, of joint motions that the task loses in a singular posture"""
    limit_stiffness: Annotated[NotNegativeNumber, "1/s²"] = 400.0
    """stiffness of the repulsion from joint limits; 0: none"""
    limit_margin: Annotated[Number, Field(gt=0, lt=0.5)] = 0.05
    """distance from a limit at which the repulsion begins, as a share of the joint's range"""


class JointTorqueSpec(Spec):
    """Joint torque loop: rate (Hz), gain and damping ratio."""

    rate: Positive[Frequency]
    """rate of the loop, a whole multiple of `control.rate`, for example 4 kHz"""
    gain: PositiveNumber = 60.0
    """gain k_p, which reduces errors of motor and spring by the factor 1 + gain"""
    damping_ratio: PositiveNumber = 0.7
    """damping ratio of the closed loop"""


class ForceReadingSpec(Spec):
    """Method of computing contact forces from wrist readings; null: chosen by `Controller`."""

    reading: Literal["filter", "least_squares"] | None = None
    """`filter` (fig. 5) or `least_squares`; null: the latter if a contact pushes at a known
    point"""


class EstimateSpec(Spec):
    """Unmodelled accelerations assumed by the estimates of velocities: joints, tracked bodies."""

    joint_angular: Positive[AngularAcceleration] = 0.8
    """unmodelled acceleration of revolute joints"""
    joint_linear: Positive[Acceleration] = 0.5
    """unmodelled acceleration of prismatic joints"""
    body_angular: Positive[AngularAcceleration] = 0.1
    """unmodelled angular acceleration of tracked bodies"""
    body_linear: Positive[Acceleration] = 0.05
    """unmodelled acceleration of tracked bodies"""
    measured_forces: bool | None = None
    """whether accelerations of the joints by measured contact forces are included, for coarse
    encoders and elastic walls; velocities are estimated less accurately if the object is struck;
    null: where the brake needs it ([estimated velocities](tuning.md#estimated-velocities))"""
    stiffest_wall: Annotated[NotNegativeNumber, "N/m"] = 0.0
    """largest stiffness of elastic walls, beside declared carts, for which `measured_forces` is
    chosen; 0: only encoders that are too coarse for every wall count"""


class Dither(Spec):
    """Sinusoidal motion along the line between two points of contact that reveals their normals.

    It begins when contacts engage, and its amplitude decays to zero."""

    amplitude: Positive[Length] = 4e-3
    """amplitude of the motion along the line, as far as arms and contacts permit it"""
    frequency: Positive[Frequency] = 2.0
    """frequency of the motion"""
    duration: Positive[Time] = 2.5
    """time after which the motion has decayed"""


class ControlSpec(Spec):
    """Settings of the controller: rate, metric B of eq. 24, contacts, friction, limits."""

    rate: Positive[Frequency]
    """the tick rate, for example 1 kHz"""
    metric: Literal["object", "chain"] = "object"
    """metric B of eq. 24: `object` (Λ_o⁻¹) or `chain` ((ΣΛ_i + Λ_o)⁻¹)"""
    contacts: Literal["declared", "detected"] = "declared"
    """source of the contacts; `detected`: from the collision geometry during the motion"""
    joint_torque: JointTorqueSpec | None = None
    """the joint torque loop; needs `plant.flexible_joints`"""
    force: ForceReadingSpec = ForceReadingSpec()
    """[method of computing contact forces from wrist readings](friction.md)"""
    friction: Friction | None = None
    """friction at the contacts that the controller takes into account"""
    joint_friction: JointFriction | None = JointFriction()
    """compensation and identification of [joint friction](joint_friction.md); `off`: neither"""
    life: PhaseSettings | None = PhaseSettings()
    """[contact phases](contact_phases.md): contacts are opened, approached and closed one by one,
    as their desired forces are > 0 or not; `off`: all at once, after a `tare` (the default of
    several forces with one)"""
    in_contact: bool = True
    """whether contacts that push are closed at the start; `false`: they are
    [open](contact_phases.md#active-sets)"""
    dither: Dither | None = None
    """motion that [reveals the normals of two points](friction.md#all-errors-at-once)"""
    safety: SafetySettings = SafetySettings()
    """[limits of the robot](reliability.md#limits-of-the-robot) and
    [safety states](reliability.md); `.inf`: no limit"""
    estimate: EstimateSpec = EstimateSpec()
    """unmodelled accelerations assumed by the velocity estimates"""

    @field_validator("life", "joint_friction", mode="before")
    @classmethod
    def _may_be_off(cls, value: object) -> object:
        """Replace false and "off" by None; any other value is validated as a group."""
        return None if value is False or value == "off" else value


class ModelErrorSpec(Spec):
    """Errors of the controller's model: masses, friction and faces."""

    object_mass: PositiveNumber = 1.0
    """factor on the controller's object mass and inertia"""
    arm_mass: PositiveNumber = 1.0
    """factor on the controller's link masses and inertias"""
    hidden_mass: NotNegative[Mass] = 0.0
    """an unmodelled mass in the object, at the point where the first arm grasps it"""
    joint_friction: NotNegativeNumber = 1.0
    """factor on the joint friction and damping of the controller's model"""
    armature: NotNegativeNumber = 1.0
    """factor on the rotor inertias of the controller's model"""
    environment: Literal["known", "yielding", "ignored"] = "known"
    """model of the touched bodies; `ignored`: every face is assumed to be unyielding and
    unaccelerated (Φ_e = 0, b_e = 0); `yielding`: the same, except that carts on springs yield
    ([soft faces](tuning.md#soft-faces))"""
    face_offset: Length = 0.0
    """distance by which each touched body is modelled too near, along its first line of force"""
    face_tilt: Angle = 0.0
    """angle by which each touched body is modelled turned, about the point where that line meets
    it"""
    face_tilt_about: Angle = 0.0
    """direction of the axis of that turn: the horizontal direction across the line, turned about
    the line by this angle"""


class TareSpec(Spec):
    """Zeroing of the wrist sensors in free space before contact is made."""

    duration: Positive[Time] = 0.4
    """time at rest away from the faces, before the motion; the last third is averaged"""
    standoff: Positive[Length] = 0.01
    """gap during that time"""
    approach: Positive[Time] = 0.3
    """time from there to contact, by default longer where a joint would need more than half of its
    speed limit; with contact phases, contacts are approached at their own speed. The motion begins
    when contacts engage (with phases, when the approach begins), and follows its signals fully
    after three times as long"""


class VerdictSpec(Spec):
    """Limits of a run's verdict, beyond which its task has failed."""

    force_rms: PositiveNumber = 0.1
    """largest rms error of a force, over the run and within any second, as a share of its mean
    command"""
    force_peak: PositiveNumber = 2.0
    """largest force of a closed contact, as a multiple of its command (of 1 N at least)"""
    path: Positive[Length] = 5e-3
    """largest distance of the object from its reference along the free directions while no contact
    is approached or lands"""
    limit_cycle: PositiveNumber = 0.05
    """largest amplitude of a [limit cycle](metrics.md#limit-cycles), as a share of the mean
    command"""
    open_share: NotNegativeNumber = 0.01
    """largest share of the evaluated time for which a contact is open"""
    lost_time: Positive[Time] = 0.05
    """longest time for which a contact is open while it is closed for the controller"""
    distance: Positive[Length] = 0.1
    """largest distance of the object from its reference, along the free directions"""
    angle: Positive[Angle] = 0.3
    """largest angle of the object from its reference, along the free directions"""
    held_share: NotNegativeNumber = 0.01
    """largest share of ticks that could not be computed"""
