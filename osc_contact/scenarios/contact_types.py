"""The kinds of contact that a scenario may name.

A kind is a model of its keys, written in the file of its contact pair and registered from there:
this module only keeps them, so that a scenario stays data that is read without any mechanics.

The keys that are marked `BodyPoint` or `BodyDirection` belong to the body the contact is on and are
given in that body's frame; all others belong to the held object and are given in its frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from functools import lru_cache, reduce
from operator import or_
from typing import Annotated, Any, ClassVar

import pinocchio as pin
from pydantic import (
    Field,
    PlainSerializer,
    PlainValidator,
    SerializeAsAny,
    TypeAdapter,
    model_validator,
)

from .contact_schema import FaceSpec
from .geometry import Name
from .quantities import UnitVec3, Vec3
from .spec import Spec, refuse

__all__ = [
    "CONTACT_TYPES",
    "AnyContact",
    "BodyDirection",
    "BodyPoint",
    "ContactSpec",
    "OfBody",
    "OnBodySpec",
    "OnFaceSpec",
    "OnPlaneSpec",
    "OwnContactSpec",
    "forces_of",
    "magnitude_names",
    "raw_magnitudes",
    "register_contact",
]


class OfBody(Enum):
    """Marks a key that is given in the frame of the body a contact is on."""

    POINT = "point"
    DIRECTION = "direction"


BodyPoint = Annotated[Vec3, OfBody.POINT]
BodyDirection = Annotated[UnitVec3, OfBody.DIRECTION]


class ContactSpec(Spec):
    """One contact. A kind adds its keys, `type: Literal[...]` and the number of its forces."""

    forces: ClassVar[int]
    name: Name
    """a name of letters, digits, _ and -, such as tip"""


class OnFaceSpec(ContactSpec):
    """A contact that brings its own plate."""

    face: FaceSpec
    """the face with its urdf, point and normal"""


class OnBodySpec(ContactSpec):
    """A contact on a body of `environment`."""

    body: Name
    """the name of a body of environment"""


class OnPlaneSpec(OnBodySpec):
    """A contact on a face of such a body."""

    face_point: BodyPoint
    """a point of the body's face [x, y, z] in the body frame"""
    face_normal: BodyDirection
    """the outward normal of that face [x, y, z] in the body frame"""


class OwnContactSpec(OnBodySpec):
    """A contact whose pair is an object, in scenarios made in Python; its frame E is where the
    world's is while the body stands where it began."""

    pair: Annotated[Any, PlainSerializer(lambda pair: type(pair).__name__)]

    @model_validator(mode="before")
    @classmethod
    def _named_as_the_pair(cls, data: Any) -> Any:
        pair = data.get("pair") if isinstance(data, dict) else None
        missing = [key for key in ("name", "contact", "gaps") if not hasattr(pair, key)]
        if pair is not None and missing:
            raise refuse(
                f"a {type(pair).__name__} has no {' and no '.join(missing)}; a pair of your own "
                "has name, contact(X_WO, V_O, X_WE, V_E) and gaps(X_WO, X_WE)"
            )
        return {"name": data["pair"].name, **data} if isinstance(data, dict) else data

    @property
    def forces(self) -> int:  # type: ignore[override]
        """r: one for each gap of the pair."""
        return len(self.pair.gaps(pin.SE3.Identity()))


#: The registered kinds by what `type` calls them.
CONTACT_TYPES: dict[str, type[ContactSpec]] = {}


def register_contact(kind: type[ContactSpec]) -> None:
    """Let scenarios name a kind of contact."""
    CONTACT_TYPES[kind.model_fields["type"].default] = kind


def _validate(value: Any) -> Any:
    if isinstance(value, OwnContactSpec):
        return value
    if isinstance(value, dict) and hasattr(value.get("pair"), "contact"):
        return OwnContactSpec.model_validate(value)
    return _reader(tuple(CONTACT_TYPES.values())).validate_python(value)


@lru_cache(maxsize=1)
def _reader(kinds: tuple[type[ContactSpec], ...]) -> TypeAdapter[Any]:
    union: Any = reduce(or_, kinds)
    return TypeAdapter(Annotated[union, Field(discriminator="type")])


#: A contact of any registered kind.
AnyContact = Annotated[SerializeAsAny[ContactSpec], PlainValidator(_validate)]


def forces_of(contacts: tuple[ContactSpec, ...]) -> dict[str, int]:
    """Name → number of independent forces r of each contact."""
    return {contact.name: contact.forces for contact in contacts}


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
    magnitudes = {}
    for item in contacts:
        name, kind = (item.get("name"), item.get("type")) if isinstance(item, dict) else (0, 0)
        if not isinstance(name, str) or not name or kind not in CONTACT_TYPES:
            return None
        magnitudes[name] = CONTACT_TYPES[str(kind)].forces
    return magnitudes
