"""What touches what: bodies of the environment, faces, and the contacts of every kind.

The keys of a contact that begin with ``face_``, ``edge_``, ``hole_`` or ``body_`` belong to the
body it is on and are given in that body's frame; all other lengths and directions belong to the
held object and are given in its frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from .geometry import Name, PoseSpec, Text
from .quantities import Force, Length, Mass, Number, Spec, Torque, UnitVec3, Vec3
from .signals import AngleSignal, LengthSignal

__all__ = [
    "BodySpec",
    "CartSpec",
    "ContactSpec",
    "ConveyorSpec",
    "FaceMotion",
    "FaceSpec",
    "HingeSpec",
    "MAGNITUDES",
    "TurnSpec",
    "VertexOnFaceSpec",
    "magnitude_names",
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


class CartSpec(Spec):
    """A body on a cart that slides freely on a straight rail and feels its own weight."""

    type: Literal["cart"] = "cart"
    direction: UnitVec3
    """the direction of the rail [x, y, z] in world"""
    mass: Annotated[Mass, Field(gt=0)]
    """the mass of the cart, such as 3 kg"""
    stiffness: Annotated[Number, Field(ge=0)] = 0.0
    damping: Annotated[Number, Field(ge=0)] = 0.0
    preload: Force = 0.0


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
    damping: Annotated[Number, Field(ge=0)] = 0.0
    preload: Torque = 0.0


FaceMotion = Annotated[ConveyorSpec | CartSpec | HingeSpec, Field(discriminator="type")]


class BodySpec(Spec):
    """A body of the environment that contacts are on."""

    name: Name
    """a name of letters, digits, _ and -, such as table"""
    urdf: Text
    """the URDF of one rigid body, with visual and collision geometry"""
    pose: PoseSpec = PoseSpec()
    motion: FaceMotion | None = None


class FaceSpec(Spec):
    """A plate of its own for one contact: a point on it (m) and its outward normal, in world."""

    urdf: Text
    """the URDF of the face"""
    point: Vec3
    """a point of the surface [x, y, z] in world"""
    normal: UnitVec3
    """the outward normal [x, y, z] in world"""
    motion: FaceMotion | None = None


class VertexOnFaceSpec(Spec):
    """A rounded vertex of the object on a face of the environment."""

    name: Name
    """a name of letters, digits, _ and -, such as left_end"""
    type: Literal["vertex_on_face"] = "vertex_on_face"
    vertex: Vec3
    """the centre of the rounded vertex [x, y, z] in the object frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0
    face: FaceSpec
    """the face with its urdf, point and normal"""


class _OnBody(Spec):
    """What contacts on a body of `environment` have in common."""

    name: Name
    """a name of letters, digits, _ and -, such as tip"""
    body: Name
    """the name of a body of environment"""


class _OnPlane(_OnBody):
    face_point: Vec3
    """a point of the body's face [x, y, z] in the body frame"""
    face_normal: UnitVec3
    """the outward normal of that face [x, y, z] in the body frame"""


class SphereOnPlaneSpec(_OnPlane):
    """A sphere (or rounded vertex) of the object on a face of a body, r = 1."""

    type: Literal["sphere_on_plane"] = "sphere_on_plane"
    centre: Vec3
    """the centre of the sphere [x, y, z] in the object frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0


class FaceOnVertexSpec(_OnBody):
    """A face of the object on a (rounded) vertex of a body, r = 1."""

    type: Literal["face_on_vertex"] = "face_on_vertex"
    point: Vec3
    """a point of the object's face [x, y, z] in the object frame"""
    normal: UnitVec3
    """the outward normal of the object's face [x, y, z] in the object frame"""
    body_vertex: Vec3
    """the centre of the rounded vertex [x, y, z] in the body frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0


class EdgeOnEdgeSpec(_OnBody):
    """An edge of the object across an edge of a body, r = 1."""

    type: Literal["edge_on_edge"] = "edge_on_edge"
    point: Vec3
    """a point of the object's edge [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the object's edge [x, y, z] in the object frame"""
    edge_point: Vec3
    """a point of the body's edge [x, y, z] in the body frame"""
    edge_direction: UnitVec3
    """along the body's edge [x, y, z] in the body frame"""
    edge_outward: UnitVec3
    """roughly out of the body at its edge [x, y, z] in the body frame"""


class EdgeOnFaceSpec(_OnPlane):
    """A straight edge of the object on a face of a body: forces at two of its points, r = 2."""

    type: Literal["edge_on_face"] = "edge_on_face"
    point: Vec3
    """the middle of the edge [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the edge [x, y, z] in the object frame"""
    length: Annotated[Length, Field(gt=0)] = 0.1


class CylinderOnPlaneSpec(_OnPlane):
    """A cylinder of the object lying on a face of a body: forces at two of its points, r = 2."""

    type: Literal["cylinder_on_plane"] = "cylinder_on_plane"
    point: Vec3
    """the middle of the axis [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the axis [x, y, z] in the object frame"""
    radius: Annotated[Length, Field(ge=0)] = 0.0
    length: Annotated[Length, Field(gt=0)] = 0.1


class FaceOnFaceSpec(_OnPlane):
    """A face of the object on a face of a body: forces at three corners of a triangle, r = 3."""

    type: Literal["face_on_face"] = "face_on_face"
    point: Vec3
    """the middle of the triangle [x, y, z] in the object frame"""
    normal: UnitVec3
    """the outward normal of the object's face [x, y, z] in the object frame"""
    size: Annotated[Length, Field(gt=0)] = 0.1


class CylinderInHoleSpec(_OnBody):
    """A cylinder of the object in a hole without play: two cross forces at two points, r = 4."""

    type: Literal["cylinder_in_hole"] = "cylinder_in_hole"
    point: Vec3
    """the middle of the cylinder's axis [x, y, z] in the object frame"""
    direction: UnitVec3
    """along the cylinder's axis [x, y, z] in the object frame"""
    hole_point: Vec3
    """a point of the hole's axis [x, y, z] in the body frame"""
    hole_direction: UnitVec3
    """along the hole's axis [x, y, z] in the body frame"""
    length: Annotated[Length, Field(gt=0)] = 0.1


ContactSpec = Annotated[
    VertexOnFaceSpec
    | SphereOnPlaneSpec
    | FaceOnVertexSpec
    | EdgeOnEdgeSpec
    | EdgeOnFaceSpec
    | CylinderOnPlaneSpec
    | FaceOnFaceSpec
    | CylinderInHoleSpec,
    Field(discriminator="type"),
]

#: Independent forces r of each kind of contact.
MAGNITUDES = {
    "vertex_on_face": 1,
    "sphere_on_plane": 1,
    "face_on_vertex": 1,
    "edge_on_edge": 1,
    "edge_on_face": 2,
    "cylinder_on_plane": 2,
    "face_on_face": 3,
    "cylinder_in_hole": 4,
}


def magnitude_names(contacts: Mapping[str, int]) -> list[str]:
    """Names of all force magnitudes: ``tip`` for one, ``pad.1``, ``pad.2``, … for several.

    Args:
        contacts: name → r.
    """
    return [name if r == 1 else f"{name}.{k + 1}" for name, r in contacts.items() for k in range(r)]


def raw_magnitudes(contacts: Any) -> dict[str, int] | None:
    """Name → r of contacts as a file has them; None where names or types are not sound."""
    if not isinstance(contacts, list):
        return None
    found = {}
    for item in contacts:
        name, kind = (item.get("name"), item.get("type")) if isinstance(item, dict) else (0, 0)
        if not isinstance(name, str) or not name or kind not in MAGNITUDES:
            return None
        found[name] = MAGNITUDES[str(kind)]
    return found
