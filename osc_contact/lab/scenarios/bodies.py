"""Arms, grasps and object, and the bodies of the environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    WrapSerializer,
    WrapValidator,
    model_validator,
)

from osc_contact.dynamics.grasp import GRASPS
from osc_contact.lab.scenarios.signals import AngleSignal, LengthSignal
from osc_contact.settings.quantities import (
    AngleVec3,
    Force,
    JointForce,
    JointValue,
    Mass,
    NotEmpty,
    NotNegative,
    NotNegativeNumber,
    Positive,
    PositiveNumber,
    Spec,
    T,
    Torque,
    UnitVec3,
    Vec3,
    one_of,
    refuse,
)

# --- Arms, grasps, the object ---------------------------------------------------------------------

Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$")]
Text = Annotated[str, Field(min_length=1)]


def _as_tuple(value: Any) -> Any:
    """Convert a single number, which is valid for all joints, to a tuple of one number."""
    return value if isinstance(value, list | tuple) else (value,)


_PerJoint = Annotated[NotEmpty[T], BeforeValidator(_as_tuple)]
PerJoint = _PerJoint[NotNegativeNumber]
ForcePerJoint = _PerJoint[NotNegative[JointForce]]


class PoseSpec(Spec):
    """A pose: translation (m) and roll-pitch-yaw (rad) about fixed axes; default identity."""

    xyz: Vec3 = (0.0, 0.0, 0.0)
    """translation [x, y, z]"""
    rpy: AngleVec3 = (0.0, 0.0, 0.0)
    """roll, pitch and yaw about fixed axes"""


class GraspSpec(PoseSpec):
    """X_TO: pose of the object in the tip frame of the arm that holds it, and how it does so."""

    type: Annotated[str, one_of(GRASPS)] = "rigid"
    """`rigid`; `hinge`: the object also turns about an axis of the tip frame; `ball`: about its
    origin"""
    axis: UnitVec3 | None = None
    """the axis of a hinge [x, y, z], in the tip frame, through its origin"""

    @model_validator(mode="after")
    def _has_its_axis(self) -> GraspSpec:
        """Refuse a hinge without an axis, and an axis of a grasp that has none."""
        if GRASPS[self.type].has_axis and self.axis is None:
            raise refuse(
                f"a {self.type} needs an axis [x, y, z] in the tip frame; add axis: [0, 1, 0]"
            )
        if not GRASPS[self.type].has_axis and self.axis is not None:
            raise refuse(f"a {self.type} grasp has no axis; leave it out, or set type: hinge")
        return self


class ArmSpec(Spec):
    """One arm: where its model comes from, where it stands and how it begins."""

    name: Name
    """a name of letters, digits, _ and -, such as left"""
    urdf: Text
    """a packaged URDF, a path beside the file (URDF or MJCF), or a robot of example-robot-data"""
    base: PoseSpec = PoseSpec()
    """of the base in the world"""
    tip: Text
    """the frame of the URDF that holds the object"""
    wrist_sensor: Text | None = None
    """frame of the wrist force/torque sensor; the force loop needs one on every arm"""
    passive_joints: tuple[Text, ...] = ()
    """joints without a motor"""
    locked_joints: dict[str, JointValue] = Field(default_factory=dict)
    """by name, joints held where given; those that do not move the tip hold at 0 if not named"""
    effort_factor: PositiveNumber = 1.0
    """multiplies the effort limits of the URDF: weaker or stronger motors"""
    armature: PerJoint | None = None
    """rotor inertia as felt at the joints (kg m², kg), one for all or one for each"""
    damping: PerJoint | None = None
    """viscous friction (N m s/rad, N s/m), one for all joints or one for each"""
    friction: ForcePerJoint | None = None
    """dry friction such as 0.4 Nm, one for all joints or one for each"""
    posture: NotEmpty[JointValue]
    """the start guess of all joints in model order, such as [30 deg, 0.1 m]"""


class ObjectSpec(Spec):
    """The held object; the frame of its single link is the operational point."""

    urdf: Text
    """the URDF of one link"""
    pose: PoseSpec | None = None
    """the start guess in the world; null: where posture puts what the first arm holds"""


# --- Bodies of the environment and faces ----------------------------------------------------------


class TurnSpec(Spec):
    """A turn about an axis of fixed direction; signals in radians, summed."""

    axis: UnitVec3
    """the axis of the turn [x, y, z] in world"""
    through: Vec3
    """a point of the axis [x, y, z] in world at the start"""
    signals: NotEmpty[AngleSignal]
    """a list of signals in angles, 0 at the start"""


class ConveyorSpec(Spec):
    """A body driven along a fixed direction, whatever presses on it; signals in metres, summed.

    It may turn meanwhile, about an axis that travels with it."""

    type: Literal["conveyor"] = "conveyor"
    direction: UnitVec3
    """the direction of travel [x, y, z] in world"""
    signals: NotEmpty[LengthSignal]
    """a list of signals in lengths, 0 at the start"""
    turn: TurnSpec | None = None
    """turn of a conveyor while it travels; the axis travels with it"""


class CartSpec(Spec):
    """A body on a cart that slides freely on a straight rail and feels its own weight."""

    type: Literal["cart"] = "cart"
    direction: UnitVec3
    """the direction of the rail [x, y, z] in world"""
    mass: Positive[Mass]
    """the mass of the cart, such as 3 kg"""
    stiffness: NotNegativeNumber = 0.0
    """of the spring that pulls it back to its start"""
    damping: NotNegativeNumber = 0.0
    """of its motion"""
    preload: Force = 0.0
    """constant force along the direction"""


class HingeSpec(Spec):
    """A balanced body that turns freely about a fixed axis (N m, rad)."""

    type: Literal["hinge"] = "hinge"
    axis: UnitVec3
    """the axis of the hinge [x, y, z] in world"""
    through: Vec3
    """a point of the axis [x, y, z] in world"""
    inertia: PositiveNumber
    """the moment of inertia about the axis, kg m², such as 0.02"""
    stiffness: NotNegativeNumber = 0.0
    """of the spring that pulls it back to its start"""
    damping: NotNegativeNumber = 0.0
    """of its motion"""
    preload: Torque = 0.0
    """constant moment about the axis"""


def _read_custom(value: Any, read: Callable[[Any], Any]) -> Any:
    """Accept an object with a `rail`, in a scenario made in Python, as it is; validate keys.

    Args:
        value: motion of a body.
        read: pydantic's validation of keys.
    """
    return value if hasattr(value, "rail") else read(value)


def _write_custom(value: Any, write: Callable[[Any], Any]) -> Any:
    """Write an object with a `rail` as the name of its class, and keys as they are.

    Args:
        value: motion of a body.
        write: pydantic's serialisation of keys.
    """
    return type(value).__name__ if hasattr(value, "rail") else write(value)


FaceMotion = Annotated[
    ConveyorSpec | CartSpec | HingeSpec,
    Field(discriminator="type"),
    WrapValidator(_read_custom),
    WrapSerializer(_write_custom),
]
"""Or, in a scenario made in Python, an object with a `rail`."""


class BodySpec(Spec):
    """A body of the environment that contacts are on."""

    name: Name
    """a name of letters, digits, _ and -, such as table"""
    urdf: Text
    """the URDF of one rigid body, with visual and collision geometry"""
    pose: PoseSpec = PoseSpec()
    """of its frame in the world"""
    motion: FaceMotion | None = None
    """how it moves; without it the body is fixed"""


class FaceSpec(Spec):
    """A separate plate for one contact: a point on it (m) and its outward normal, in world."""

    urdf: Text
    """the URDF of the face"""
    point: Vec3
    """a point of the surface [x, y, z] in world"""
    normal: UnitVec3
    """the outward normal [x, y, z] in world"""
    motion: FaceMotion | None = None
    """how the face moves; without it the face is fixed"""
