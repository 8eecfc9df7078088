"""Hardware of a rig: plant, flexible joints, imperfect motors, sensors and their errors."""

import math
from typing import Annotated, Generic, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from osc_contact.settings.quantities import (
    Angle,
    Force,
    ForceVec3,
    Frequency,
    Length,
    NotEmpty,
    NotNegative,
    NotNegativeNumber,
    Number,
    OfQuantity,
    Positive,
    PositiveNumber,
    Q,
    Spec,
    Time,
    Torque,
    Velocity,
    one_of,
    refuse,
)

#: Values of `plant.type`, each with whether the plant is exact: ideal joints, and contacts that
#: cannot open and whose faces are unbounded. `lab.rig.rig.register_plant` adds values.
PLANT_TYPES: dict[str, bool] = {"mujoco": False, "rigid": True, "drake": False}

Fraction = Annotated[Number, Field(gt=0, lt=1)]
Probability = Annotated[Number, Field(ge=0, lt=1)]
PerMotor = NotEmpty[PositiveNumber]


class FlexibleJointsSpec(Spec):
    """Springs between motors and links, by the rig's first mode or by number."""

    frequency: Positive[Frequency] | None = None
    """first mode of the rig out of contact, motors held, loops closed, such as 5 Hz; springs are
    proportional to the joints' inertias"""
    stiffness: Annotated[dict[str, PerMotor], "N m/rad, N/m"] | None = None
    """instead: by arm name, one number for each motor"""
    damping_ratio: NotNegativeNumber = 0.02
    """of motor against link"""
    motor_inertia: Annotated[PositiveNumber | dict[str, PerMotor], "–, kg m², kg"] = 0.5
    """a share of each joint's own inertia, or by arm name one number for each motor"""

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        """Refuse both or neither of `frequency` and `stiffness`."""
        if (self.frequency is None) == (self.stiffness is None):
            raise refuse(
                "expected either frequency, such as 5 Hz, or stiffness, by arm and motor; "
                + ("got neither" if self.frequency is None else "got both")
            )
        return self


class MotorsSpec(Spec):
    """Errors of the motors as shares of each one's limit; signs and phases are drawn."""

    bias: NotNegativeNumber = 0.0
    """share of each motor's limit"""
    ripple: NotNegativeNumber = 0.0
    """amplitude, share of each motor's limit: a sine of motor travel, 24 per rad or one in 10 mm"""


class Push(Spec):
    """A half sine of force from outside on an arm, where its wrist sensor is fastened.

    The force comes from the arm's side: the sensor feels what it does, not the force itself.
    """

    arm: str
    """the name of an arm with a wrist sensor, which does not feel the force"""
    force: ForceVec3
    """its peak [x, y, z] in world"""
    start: NotNegative[Time] = 0.0
    """when it first acts"""
    duration: Positive[Time]
    """how long it acts, such as 20 ms"""
    every: NotNegative[Time] = 0.0
    """after which it comes again, longer than `duration`; 0: never"""

    @model_validator(mode="after")
    def _ends_before_the_next(self) -> Self:
        """Refuse a repeated disturbance that lasts longer than its period."""
        if 0.0 < self.every <= self.duration:
            raise refuse(
                f"duration = {self.duration:g} s, every = {self.every:g} s; give every longer than "
                "the duration, or 0"
            )
        return self

    def at(self, t: float) -> npt.NDArray[np.float64]:
        """Force (3,) at time t (s), in world axes (N)."""
        since = t - self.start
        if self.every > 0.0 and since >= 0.0:
            since %= self.every
        share = 0.0
        if 0.0 <= since < self.duration:
            share = math.sin(math.pi * since / self.duration)
        return np.array(self.force) * share


class DrakeSpec(Spec):
    """Contacts of the Drake plant."""

    contact: Literal["lagged", "tamsi", "similar", "sap"] = "lagged"
    """Drake's approximation of contacts; `tamsi` knows no loops and is for one arm; `similar` and
    `sap` lift a body that slides, and are refused where this would open a contact"""
    stiffness: Annotated[PositiveNumber, "N/m"] = 1e5
    """of a contact point; of rigs like the packaged ones Drake itself makes about as much"""
    area_stiffness: Annotated[PositiveNumber, "N/m"] = 1e6
    """of the whole area of a contact with several forces"""
    dissipation: Annotated[NotNegativeNumber, "s/m"] = 10.0
    """Hunt and Crossley's: at depth x the force is k x (1 + dissipation dx/dt); not of `sap`"""
    stiction: Positive[Velocity] = 1e-4
    """slip speed up to which contacts stick"""
    relaxation: NotNegative[Time] = 0.1
    """`sap`: relaxation time of each of the two materials"""

    def stiffness_of(self, forces: int) -> float:
        """Stiffness (N/m) of a contact with a number of forces: of a point, or of an area."""
        return self.stiffness if forces == 1 else self.area_stiffness

    def lift(self, friction: float, slip_speed: float, step: float) -> float:
        """Height (m) by which a sliding body is lifted; 0 for `lagged` and `tamsi`.

        δt μ v of `similar`, (τ₁ + τ₂ + δt) μ v of `sap`, with the relaxation times τ, the step δt
        and the slip speed v (Drake's documentation of its convex approximations; Castro et al.,
        arXiv 2110.10107).

        Args:
            friction: Coulomb coefficient μ.
            slip_speed: v (m/s).
            step: δt (s).
        """
        return self._lifting_time(step) * friction * slip_speed

    def depth(self, force: float, stiffness: float, friction: float, slip_speed: float) -> float:
        """Depth (m) at which a sliding contact carries a force, without the lift.

        F/k; of `similar` F/(k (1 + c μ v)) with the dissipation c, as it takes v_n − μ v for the
        normal velocity v_n.

        Args:
            force: F (N).
            stiffness: k (N/m).
            friction: Coulomb coefficient μ.
            slip_speed: v (m/s).
        """
        return force / (stiffness * (1.0 + self._slip_dissipation * friction * slip_speed))

    def largest_friction(
        self, force: float, stiffness: float, slip_speed: float, step: float
    ) -> float:
        """Friction coefficient at which the lift of a sliding contact is its depth; ∞: none is.

        Args:
            force: force of the contact (N).
            stiffness: its stiffness (N/m).
            slip_speed: its slip speed (m/s).
            step: step of the simulation (s).
        """
        time = self._lifting_time(step)
        if time * slip_speed == 0.0:
            return math.inf
        # the positive root of time μ v (1 + c μ v) = F/k
        ratio = max(force, 0.0) / (stiffness * time)
        root = math.sqrt(1.0 + 4.0 * self._slip_dissipation * ratio)
        return 2.0 * ratio / (1.0 + root) / slip_speed

    def _lifting_time(self, step: float) -> float:
        """Time (s) by which μ times the slip speed is multiplied to give the lift.

        Args:
            step: step of the simulation (s).
        """
        times = {"similar": step, "sap": 2.0 * self.relaxation + step}
        return times.get(self.contact, 0.0)

    @property
    def _slip_dissipation(self) -> float:
        """Dissipation (s/m) that acts on μ times the slip speed."""
        return self.dissipation if self.contact == "similar" else 0.0


class PlantSpec(Spec):
    """The simulated workcell: step (s) and the contact parameters of the plants."""

    type: Annotated[str, one_of(PLANT_TYPES)] = "mujoco"
    """`mujoco`, `rigid` or [`drake`](drake.md), or the name of a plant that a program has
    registered"""
    step: Positive[Time]
    """the simulation step, such as 0.25 ms; the control period is a whole multiple"""
    solref: Annotated[tuple[PositiveNumber, PositiveNumber], "s, –"] = (0.01, 1.0)
    """MuJoCo: time constant and damping ratio of the faces"""
    solimp: Annotated[tuple[Fraction, Fraction, PositiveNumber], "–, –, m"] = (0.2, 0.9, 0.0005)
    """MuJoCo: impedance at zero depth, at width, width"""
    friction: NotNegativeNumber = 0.0
    """MuJoCo, Drake: Coulomb coefficient of the faces"""
    flexible_joints: FlexibleJointsSpec | None = None
    """MuJoCo: a spring between each motor and its link"""
    motors: MotorsSpec | None = None
    """MuJoCo: what the motors add to the torque commanded"""
    joint_friction: NotNegativeNumber = 0.0
    """MuJoCo: Coulomb friction at each motor, share of its limit, that the controller does not know
    of"""
    pushes: tuple[Push, ...] = ()
    """MuJoCo: half sines of force from outside on the wrists of arms"""
    drake: DrakeSpec = DrakeSpec()
    """Drake: contacts"""

    @property
    def exact(self) -> bool:
        """Whether joints are ideal and contacts bilateral, without ends: see `PLANT_TYPES`."""
        return PLANT_TYPES[self.type]

    def contact_stiffness(self, mass: float, forces: int) -> float:
        """Stiffness (N/m) behind a force, which in MuJoCo is proportional to the mass behind it.

        A mass m in MuJoCo's contact has m/(T ζ)²/d, with the time constant T and the damping ratio
        ζ of `solref` and the impedance d of `solimp`.

        Args:
            mass: mass behind the force (kg).
            forces: number of forces of the contact.
        """
        if self.type == "drake":
            return self.drake.stiffness_of(forces) / forces
        return mass / (self.solref[0] * self.solref[1]) ** 2 / self.solimp[1]


class Clock(Spec):
    """Sampling of a sensor, and delay and loss of its readings."""

    rate: Positive[Frequency]
    """samples per second, such as 1 kHz"""
    delay: NotNegative[Time] = 0.0
    """until a sample arrives"""
    dropout: Probability = 0.0
    """probability that a sample is lost"""


class Errors(OfQuantity, Generic[Q]):
    """Errors of a measured quantity."""

    noise: NotNegative[Q] = 0.0  # type: ignore[assignment]
    """standard deviation of a sample"""
    bias: NotNegative[Q] = 0.0  # type: ignore[assignment]
    """constant over the run, drawn uniform within ± the number given"""
    resolution: NotNegative[Q] = 0.0  # type: ignore[assignment]
    """step of the reading"""


class EncoderSpec(Clock):
    """Joint positions; an encoder gives no velocity."""

    angle: Errors[Angle] = Errors[Angle]()
    """errors of turning joints"""
    length: Errors[Length] = Errors[Length]()
    """errors of sliding joints"""


class TorqueSensorSpec(Clock, Errors[Number]):
    """Joint torques; errors are shares of each motor's limit."""


class WristSpec(Clock):
    """Wrist forces and torques."""

    force: Errors[Force] = Errors[Force]()
    """errors of each component of the force"""
    torque: Errors[Torque] = Errors[Torque]()
    """errors of each component of the torque"""


class VisionSpec(Clock):
    """Overhead vision: poses of faces, object and arms, in the camera's frame."""

    position: Errors[Length] = Errors[Length]()
    """errors of each coordinate of a pose"""
    orientation: Errors[Angle] = Errors[Angle]()
    """errors of the rotation of a pose, about each axis"""
    frame_position: NotNegative[Length] = 0.0
    """± displacement of the camera's frame against the robots', drawn once; found from the pictures
    of object and arms"""
    frame_orientation: NotNegative[Angle] = 0.0
    """± rotation of the camera's frame, likewise"""


class SensorsSpec(Spec):
    """The sensors; one that is left out is ideal. Biases are drawn once, uniform within ±bias."""

    encoder: EncoderSpec | None = None
    """joint positions; velocities are then estimated"""
    joint_torque: TorqueSensorSpec | None = None
    """joint torques; errors are shares of each motor's limit"""
    wrist: WristSpec | None = None
    """wrist wrenches"""
    vision: VisionSpec | None = None
    """poses of object, arms and the faces that move; twists are then estimated"""

    @property
    def ideal(self) -> bool:
        """Whether all sensors are ideal."""
        return all(value is None for _, value in self)
