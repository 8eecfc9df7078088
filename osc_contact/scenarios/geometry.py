"""Who takes part and where: poses, arms, grasps, the object."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, field_validator, model_validator

from .quantities import AngleVec3, JointForce, JointValue, Number, UnitVec3, Vec3
from .spec import Spec, refuse

__all__ = [
    "GRASP_TYPES",
    "ArmSpec",
    "GraspSpec",
    "Name",
    "ObjectSpec",
    "PoseSpec",
    "Text",
]

Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$")]
Text = Annotated[str, Field(min_length=1)]


def _listed(value: Any) -> Any:
    """A single value for all joints as a list of one."""
    return value if isinstance(value, list | tuple) else (value,)


PerJoint = Annotated[
    tuple[Annotated[Number, Field(ge=0)], ...], BeforeValidator(_listed), Field(min_length=1)
]
ForcePerJoint = Annotated[
    tuple[Annotated[JointForce, Field(ge=0)], ...], BeforeValidator(_listed), Field(min_length=1)
]


class PoseSpec(Spec):
    """A pose: translation (m) and roll-pitch-yaw (rad) about fixed axes; default identity."""

    xyz: Vec3 = (0.0, 0.0, 0.0)
    """translation [x, y, z]"""
    rpy: AngleVec3 = (0.0, 0.0, 0.0)
    """roll, pitch and yaw about fixed axes"""


#: Grasps that a scenario may name, and whether they have an axis; `dynamics.grasp` fills it.
GRASP_TYPES: dict[str, bool] = {}


class GraspSpec(PoseSpec):
    """X_TO: pose of the object in the tip frame of the arm that holds it, and how it does so."""

    type: str = "rigid"
    """`rigid`; `hinge`: the object also turns about an axis of the tip frame; `ball`: about its
    origin"""
    axis: UnitVec3 | None = None
    """the axis of a hinge [x, y, z], in the tip frame, through its origin"""

    @field_validator("type")
    @classmethod
    def _is_registered(cls, value: str) -> str:
        if value not in GRASP_TYPES:
            *names, last = map(repr, GRASP_TYPES)
            raise refuse(f"expected {', '.join(names)} or {last}; got {value!r}")
        return value

    @model_validator(mode="after")
    def _has_its_axis(self) -> GraspSpec:
        if GRASP_TYPES[self.type] and self.axis is None:
            kind = self.type
            raise refuse(f"a {kind} needs an axis [x, y, z] in the tip frame; add axis: [0, 1, 0]")
        if not GRASP_TYPES[self.type] and self.axis is not None:
            raise refuse(f"a {self.type} grasp has no axis; leave it out, or set type: hinge")
        return self


class ArmSpec(Spec):
    """One arm: where its model comes from, where it stands and how it begins."""

    name: Name
    """a name of letters, digits, _ and -, such as left"""
    urdf: Text
    """a packaged URDF, a path beside the file (URDF or MJCF), or example-robot-data:NAME"""
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
    effort_factor: Annotated[Number, Field(gt=0)] = 1.0
    """multiplies the effort limits of the URDF: weaker or stronger motors"""
    armature: PerJoint | None = None
    """rotor inertia as felt at the joints (kg m², kg), one for all or one for each"""
    damping: PerJoint | None = None
    """viscous friction (N m s/rad, N s/m), one for all joints or one for each"""
    friction: ForcePerJoint | None = None
    """dry friction such as 0.4 Nm, one for all joints or one for each"""
    posture: Annotated[tuple[JointValue, ...], Field(min_length=1)]
    """the start guess of all joints in model order, such as [30 deg, 0.1 m]"""


class ObjectSpec(Spec):
    """The held object; the frame of its single link is the operational point."""

    urdf: Text
    """the URDF of one link"""
    pose: PoseSpec | None = None
    """the start guess in the world; null: where posture puts what the first arm holds"""
