"""Who takes part and where: poses, arms, grasps, the object, faces and contacts."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .quantities import AngleVec3, Force, JointValue, Length, Mass, Number, Spec, UnitVec3, Vec3
from .signals import LengthSignal

__all__ = [
    "ArmSpec",
    "CartSpec",
    "ContactSpec",
    "ConveyorSpec",
    "FaceSpec",
    "GraspSpec",
    "Name",
    "ObjectSpec",
    "PoseSpec",
    "Text",
]

Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$")]
Text = Annotated[str, Field(min_length=1)]


class PoseSpec(Spec):
    """A pose: translation (m) and roll-pitch-yaw (rad) about fixed axes; default identity."""

    xyz: Vec3 = (0.0, 0.0, 0.0)
    rpy: AngleVec3 = (0.0, 0.0, 0.0)


class GraspSpec(PoseSpec):
    """X_TO: pose of the object in the tip frame of the arm that holds it."""


class ArmSpec(Spec):
    """One arm: where its model comes from, where it stands and how it begins."""

    name: Name
    """a name of letters, digits, _ and -, such as left"""
    urdf: Text
    """a packaged URDF, a path beside the scenario file, or example-robot-data:NAME"""
    base: PoseSpec = PoseSpec()
    tip: Text
    """the frame of the URDF that holds the object"""
    wrist_sensor: Text | None = None
    passive_joints: tuple[Text, ...] = ()
    posture: Annotated[tuple[JointValue, ...], Field(min_length=1)]
    """the start guess of all joints in model order, such as [30 deg, 0.1 m]"""


class ObjectSpec(Spec):
    """The held object; the frame of its single link is the operational point."""

    urdf: Text
    """the URDF of one link"""
    pose: PoseSpec = PoseSpec()


class ConveyorSpec(Spec):
    """A face driven along a fixed direction, whatever presses on it; signals in metres, summed."""

    type: Literal["conveyor"] = "conveyor"
    direction: UnitVec3
    """the direction of travel [x, y, z] in world"""
    signals: Annotated[tuple[LengthSignal, ...], Field(min_length=1)]
    """a list of signals in lengths, 0 at the start"""


class CartSpec(Spec):
    """A face on a cart that slides freely on a straight rail and feels its own weight."""

    type: Literal["cart"] = "cart"
    direction: UnitVec3
    """the direction of the rail [x, y, z] in world"""
    mass: Annotated[Mass, Field(gt=0)]
    """the mass of the cart, such as 3 kg"""
    stiffness: Annotated[Number, Field(ge=0)] = 0.0
    damping: Annotated[Number, Field(ge=0)] = 0.0
    preload: Force = 0.0


FaceMotion = Annotated[ConveyorSpec | CartSpec, Field(discriminator="type")]


class FaceSpec(Spec):
    """A face of the environment: a point on it (m) and its outward unit normal, in world."""

    urdf: Text
    """the URDF of the face"""
    point: Vec3
    """a point of the surface [x, y, z] in world"""
    normal: UnitVec3
    """the outward normal [x, y, z] in world"""
    motion: FaceMotion | None = None


class ContactSpec(Spec):
    """A rounded vertex of the object on a face of the environment."""

    name: Name
    """a name of letters, digits, _ and -, such as left_end"""
    type: Literal["vertex_on_face"]
    """vertex_on_face"""
    vertex: Vec3
    """the centre of the rounded vertex [x, y, z] in the object frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0
    face: FaceSpec
    """the face with its urdf, point and normal"""
