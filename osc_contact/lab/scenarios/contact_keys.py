"""Kinds of contact: the keys of each, made from the fields of its contact pair.

The keys that are marked `OfBody` belong to the body the contact is on and are given in that body's
frame; all others belong to the held object and are given in its frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from copyreg import __newobj__  # type: ignore[attr-defined]
from dataclasses import MISSING, fields
from functools import cache, lru_cache, reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_type_hints

import numpy as np
import pinocchio as pin
from pydantic import (
    Field,
    PlainSerializer,
    PlainValidator,
    SerializeAsAny,
    TypeAdapter,
    create_model,
    model_validator,
)

from osc_contact.contacts.pairs import load_pairs
from osc_contact.contacts.pairs.keys import OF_FACE, OfBody, declared_geometry
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.register import NAMED
from osc_contact.contacts.surface import Surface
from osc_contact.lab.scenarios.bodies import FaceSpec, Name
from osc_contact.settings.quantities import Length, Spec, refuse

load_pairs()  # a scenario may name each of them


class ContactSpec(Spec):
    """One contact. A kind adds its keys, `type: Literal[...]` and the number of its forces.

    Attributes:
        describes: class of the pair, whose fields are the keys.
    """

    forces: ClassVar[int]
    describes: ClassVar[Any]
    name: Name
    """a name of letters, digits, _ and -, such as tip"""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the class of the pair, from which another process makes the keys again."""
        made = getattr(type(self), "describes", None)
        if made is None:
            return __newobj__, (type(self),), self.__getstate__()
        return _blank, (made, self.forces), self.__getstate__()


class OnFaceSpec(ContactSpec):
    """A contact that brings its own plate."""

    face: FaceSpec
    """the face with its urdf, point and normal"""


class OnBodySpec(ContactSpec):
    """A contact on a body of `environment`."""

    body: Name
    """the name of a body of environment"""


class OwnContactSpec(OnBodySpec):
    """A contact whose pair is an object, in scenarios made in Python; its frame E is where the
    world's is while the body stands where it began."""

    pair: Annotated[Any, PlainSerializer(lambda pair: type(pair).__name__)]

    @model_validator(mode="before")
    @classmethod
    def _named_as_the_pair(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Check the methods of a custom pair, and take its name."""
        pair = data["pair"]
        missing = [key for key in ("name", "contact", "gaps") if not hasattr(pair, key)]
        if missing:
            raise refuse(
                f"a {type(pair).__name__} has no {' and no '.join(missing)}; a custom pair "
                "has name, contact(X_WO, V_O, X_WE, V_E) and gaps(X_WO, X_WE)"
            )
        return {"name": pair.name, **data}

    @property
    def forces(self) -> int:  # type: ignore[override]
        """r: one for each gap of the pair."""
        return len(self.pair.gaps(pin.SE3.Identity()))


# Keys of a curved surface.


class SphereSpec(Spec):
    """A sphere about `surface_point`; a radius < 0: a bowl."""

    type: Literal["sphere"] = "sphere"
    radius: Length
    """of the sphere, < 0 seen from inside"""

    def made(self, folder: Path | None) -> Surface:
        """The surface."""
        return Surface.sphere(self.radius)


class CylinderSpec(SphereSpec):
    """A cylinder about `surface_axis`; a radius < 0: a pipe."""

    type: Literal["cylinder"] = "cylinder"  # type: ignore[assignment]

    def made(self, folder: Path | None) -> Surface:
        """The surface."""
        return Surface.cylinder(self.radius)


class SaddleSpec(Spec):
    """z = x²/(2R₁) + y²/(2R₂), z along `surface_axis` and x along `surface_x`."""

    type: Literal["saddle"] = "saddle"
    radii: tuple[Length, Length]
    """R₁ and R₂, of curvature at the origin; > 0: hollow"""

    def made(self, folder: Path | None) -> Surface:
        """The surface."""
        return Surface.saddle(*self.radii)


class MeshSpec(Spec):
    """A spline through the corners of a mesh, as a height along `surface_axis`."""

    type: Literal["mesh"] = "mesh"
    file: Annotated[str, Field(min_length=1)]
    """an STL or OBJ file beside the scenario, in metres"""
    cells: tuple[Annotated[int, Field(ge=1, le=64)], Annotated[int, Field(ge=1, le=64)]] = (8, 8)
    """how many pieces the spline has along x and y"""

    def made(self, folder: Path | None) -> Surface:
        """The surface; its points' distances from it are `rms` and `worst`."""
        return Surface.of_mesh((folder or Path()) / self.file, self.cells)


SurfaceSpec = Annotated[
    SphereSpec | CylinderSpec | SaddleSpec | MeshSpec, Field(discriminator="type")
]

#: Keys of a field whose type is no quantity but an object.
_KEYS_OF: dict[Any, Any] = {Surface: SurfaceSpec}


# From pairs to kinds, and back.


@cache
def keys_of(pair: Any, forces: int) -> type[ContactSpec]:
    """The model of a contact that is such a pair: its fields are the keys.

    Args:
        pair: a class that `register_pair` entered. forces: r, number of its force magnitudes.
    """
    kind: Any = pair.name
    keys: dict[str, Any] = {"type": (Literal[kind], kind)}
    geometry = declared_geometry(pair)
    types = get_type_hints(pair)
    base: type[ContactSpec] = OnBodySpec
    for one in fields(pair):
        declared = geometry.get(one.name, ())[1:]
        if types[one.name] in _KEYS_OF:
            declared = (_KEYS_OF[types[one.name]],)
        for key in declared:
            if key == OF_FACE:
                base = OnFaceSpec
            else:
                keys[one.name] = key if one.default is MISSING else (key, one.default)
    name = f"{pair.__name__}Spec"
    spec = create_model(name, __base__=base, __module__=__name__, __doc__=pair.__doc__, **keys)
    spec.forces = forces
    spec.describes = pair
    return spec


def _blank(pair: Any, forces: int) -> ContactSpec:
    """A contact of the kind without values, which unpickling sets."""
    kind = keys_of(pair, forces)
    return kind.__new__(kind)


def contact_types() -> dict[str, type[ContactSpec]]:
    """The kinds of contact that scenarios may name, by their `type`."""
    return {kind: keys_of(*NAMED[kind]) for kind in sorted(NAMED)}


def make_pair(spec: ContactSpec, X_WB: pin.SE3, folder: Path | None = None) -> ContactPair:
    """The pair that a scenario describes, its environment frame E where the world's is.

    Args:
        spec: of a registered kind. X_WB: pose of the body that the contact is on.
        folder: where files are that it names.
    """
    given: dict[str, Any] = {}
    for key, info in type(spec).model_fields.items():
        value = getattr(spec, key)
        if OfBody.POINT in info.metadata:
            value = X_WB.act(np.array(value))
        elif OfBody.DIRECTION in info.metadata:
            value = X_WB.rotation @ np.array(value)
        elif hasattr(value, "made"):
            value = value.made(folder)
        if key == "face":
            given |= {"point": value.point, "normal": value.normal}
        elif key not in ("type", "body"):
            given[key] = value
    made: ContactPair = type(spec).describes(**given)
    return made


def _validate(value: Any) -> Any:
    """Validate the entry of a contact: a mapping by its `type`, or a custom pair made in Python."""
    if isinstance(value, OwnContactSpec):
        return value
    if isinstance(value, dict) and hasattr(value.get("pair"), "contact"):
        return OwnContactSpec.model_validate(value)
    contact = _reader(tuple(contact_types().values())).validate_python(value)
    type(contact).model_rebuild()  # before 2.14, pydantic writes no class that it has not built
    return contact


@lru_cache(maxsize=1)
def _reader(kinds: tuple[type[ContactSpec], ...]) -> TypeAdapter[Any]:
    union: Any = reduce(or_, kinds)
    return TypeAdapter(Annotated[union, Field(discriminator="type")])


#: A contact of any registered kind.
AnyContact = Annotated[SerializeAsAny[ContactSpec], PlainValidator(_validate)]


def magnitude_names(contacts: Mapping[str, int]) -> list[str]:
    """Names of all force magnitudes: ``tip`` for one, ``pad.1``, ``pad.2``, … for several.

    Args:
        contacts: name → r.
    """
    return [name if r == 1 else f"{name}.{k + 1}" for name, r in contacts.items() for k in range(r)]
