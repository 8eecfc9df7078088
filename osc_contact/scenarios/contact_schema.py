"""What contacts are on: bodies of the environment and faces, and how these move."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field, WrapSerializer, WrapValidator

from .geometry import Name, PoseSpec, Text
from .quantities import Force, Mass, Number, Torque, UnitVec3, Vec3
from .signals import AngleSignal, LengthSignal
from .spec import Spec

__all__ = [
    "BodySpec",
    "CartSpec",
    "ConveyorSpec",
    "FaceMotion",
    "FaceSpec",
    "HingeSpec",
    "TurnSpec",
]


class TurnSpec(Spec):
    """A turn about an axis of fixed direction; signals in radians, summed."""

    axis: UnitVec3
    """the axis of the turn [x, y, z] in world"""
    through: Vec3
    """a point of the axis [x, y, z] in world at the start"""
    signals: Annotated[tuple[AngleSignal, ...], Field(min_length=1)]
    """a list of signals in angles, 0 at the start"""


class ConveyorSpec(Spec):
    """A body driven along a fixed direction, whatever presses on it; signals in metres, summed.

    It may turn meanwhile, about an axis that travels with it."""

    type: Literal["conveyor"] = "conveyor"
    direction: UnitVec3
    """the direction of travel [x, y, z] in world"""
    signals: Annotated[tuple[LengthSignal, ...], Field(min_length=1)]
    """a list of signals in lengths, 0 at the start"""
    turn: TurnSpec | None = None
    """turn of a conveyor while it travels; the axis travels with it"""


class CartSpec(Spec):
    """A body on a cart that slides freely on a straight rail and feels its own weight."""

    type: Literal["cart"] = "cart"
    direction: UnitVec3
    """the direction of the rail [x, y, z] in world"""
    mass: Annotated[Mass, Field(gt=0)]
    """the mass of the cart, such as 3 kg"""
    stiffness: Annotated[Number, Field(ge=0)] = 0.0
    """of the spring that pulls it back to its start"""
    damping: Annotated[Number, Field(ge=0)] = 0.0
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
    inertia: Annotated[Number, Field(gt=0)]
    """the moment of inertia about the axis, kg m², such as 0.02"""
    stiffness: Annotated[Number, Field(ge=0)] = 0.0
    """of the spring that pulls it back to its start"""
    damping: Annotated[Number, Field(ge=0)] = 0.0
    """of its motion"""
    preload: Torque = 0.0
    """constant moment about the axis"""


def _take_own(value: Any, read: Callable[[Any], Any]) -> Any:
    return value if hasattr(value, "rail") else read(value)


def _tell_own(value: Any, write: Callable[[Any], Any]) -> Any:
    return type(value).__name__ if hasattr(value, "rail") else write(value)


FaceMotion = Annotated[
    ConveyorSpec | CartSpec | HingeSpec,
    Field(discriminator="type"),
    WrapValidator(_take_own),
    WrapSerializer(_tell_own),
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
