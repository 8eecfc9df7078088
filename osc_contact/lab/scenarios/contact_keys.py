"""Keys of each kind of contact in scenarios, made from the fields of its contact pair.

Keys that are marked `OfBody` describe the touched body, in the frame of that body; all others
describe the held object, in the object's frame.
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

load_pairs()  # registers the pairs, each of which a scenario may name


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
        """Pickle by the class of the pair, from which another process makes the model again.

        Models of pairs are made at run time, so that pickle cannot import them by name.
        """
        pair = getattr(type(self), "describes", None)
        if pair is None:
            return __newobj__, (type(self),), self.__getstate__()
        return _blank, (pair, self.forces), self.__getstate__()


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
        """Check the methods of a custom pair, and take its name.

        Args:
            data: keys of a contact in the file.
        """
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
        """Number r of force magnitudes: one for each gap of the pair."""
        return len(self.pair.gaps(pin.SE3.Identity()))


# Keys of a curved surface.


class SphereSpec(Spec):
    """A sphere about `surface_point`; a radius < 0: a bowl."""

    type: Literal["sphere"] = "sphere"
    radius: Length
    """of the sphere, < 0 seen from inside"""

    def made(self, folder: Path | None) -> Surface:
        """Make the surface.

        Args:
            folder: folder of files that the keys name; not needed here.
        """
        return Surface.sphere(self.radius)


class CylinderSpec(SphereSpec):
    """A cylinder about `surface_axis`; a radius < 0: a pipe."""

    type: Literal["cylinder"] = "cylinder"  # type: ignore[assignment]

    def made(self, folder: Path | None) -> Surface:
        """Make the surface.

        Args:
            folder: folder of files that the keys name; not needed here.
        """
        return Surface.cylinder(self.radius)


class SaddleSpec(Spec):
    """z = x²/(2R₁) + y²/(2R₂), z along `surface_axis` and x along `surface_x`."""

    type: Literal["saddle"] = "saddle"
    radii: tuple[Length, Length]
    """R₁ and R₂, of curvature at the origin; > 0: hollow"""

    def made(self, folder: Path | None) -> Surface:
        """Make the surface.

        Args:
            folder: folder of files that the keys name; not needed here.
        """
        return Surface.saddle(*self.radii)


class MeshSpec(Spec):
    """A spline through the corners of a mesh, as a height along `surface_axis`."""

    type: Literal["mesh"] = "mesh"
    file: Annotated[str, Field(min_length=1)]
    """an STL or OBJ file beside the scenario, in metres"""
    cells: tuple[Annotated[int, Field(ge=1, le=64)], Annotated[int, Field(ge=1, le=64)]] = (8, 8)
    """how many pieces the spline has along x and y"""

    def made(self, folder: Path | None) -> Surface:
        """Make the surface; `rms` and `worst` of it are distances of the mesh's corners (m).

        Args:
            folder: folder of the scenario, relative to which the file is named.
        """
        return Surface.of_mesh((folder or Path()) / self.file, self.cells)


SurfaceSpec = Annotated[
    SphereSpec | CylinderSpec | SaddleSpec | MeshSpec, Field(discriminator="type")
]

#: Models of the keys of fields whose type is a class and not a quantity.
_KEYS_OF: dict[Any, Any] = {Surface: SurfaceSpec}


# From pairs to kinds, and back.


@cache
def keys_of(pair: Any, forces: int) -> type[ContactSpec]:
    """Make the model of a contact whose keys are the fields of a pair.

    A field becomes keys by its annotation, which states the kind of its geometry and its YAML type,
    or by its Python type; points and normals of a face come from the key `face` instead. Defaults
    are the pair's.

    Args:
        pair: class that `register_pair` has registered.
        forces: number r of its force magnitudes.
    """
    kind: Any = pair.name
    keys: dict[str, Any] = {"type": (Literal[kind], kind)}
    geometry = declared_geometry(pair)
    types = get_type_hints(pair)
    base: type[ContactSpec] = OnBodySpec
    for pair_field in fields(pair):
        name = pair_field.name
        declared = geometry.get(name, ())[1:]
        if types[name] in _KEYS_OF:
            declared = (_KEYS_OF[types[name]],)
        for key in declared:
            if key == OF_FACE:  # the pair takes point and normal from the key `face`
                base = OnFaceSpec
            elif pair_field.default is MISSING:
                keys[name] = key
            else:
                keys[name] = (key, pair_field.default)
    spec = create_model(
        f"{pair.__name__}Spec", __base__=base, __module__=__name__, __doc__=pair.__doc__, **keys
    )
    spec.forces = forces
    spec.describes = pair
    return spec


def _blank(pair: Any, forces: int) -> ContactSpec:
    """Make a contact without values, which unpickling sets.

    Args:
        pair: class of the pair.
        forces: number r of its force magnitudes.
    """
    kind = keys_of(pair, forces)
    return kind.__new__(kind)


def contact_types() -> dict[str, type[ContactSpec]]:
    """Models of all contacts that scenarios may name, by the value of their key `type`."""
    return {kind: keys_of(*NAMED[kind]) for kind in sorted(NAMED)}


def make_pair(spec: ContactSpec, X_WB: pin.SE3, folder: Path | None = None) -> ContactPair:
    """Make the pair that a scenario describes; its environment frame E coincides with the world.

    Points and directions of the touched body are converted from the body's frame to the world.

    Args:
        spec: contact of a registered kind.
        X_WB: initial pose of the touched body.
        folder: folder of the files that the contact names.
    """
    arguments: dict[str, Any] = {}
    for key, info in type(spec).model_fields.items():
        value = getattr(spec, key)
        if OfBody.POINT in info.metadata:
            value = X_WB.act(np.array(value))
        elif OfBody.DIRECTION in info.metadata:
            value = X_WB.rotation @ np.array(value)
        elif hasattr(value, "made"):
            value = value.made(folder)
        if key == "face":
            arguments |= {"point": value.point, "normal": value.normal}
        elif key not in ("type", "body"):
            arguments[key] = value
    pair: ContactPair = type(spec).describes(**arguments)
    return pair


def _validate(value: Any) -> Any:
    """Validate the entry of a contact: a mapping by its `type`, or a custom pair made in Python.

    Args:
        value: value of the key in the file.
    """
    if isinstance(value, OwnContactSpec):
        return value
    if isinstance(value, dict) and hasattr(value.get("pair"), "contact"):
        return OwnContactSpec.model_validate(value)
    contact = _reader(tuple(contact_types().values())).validate_python(value)
    type(contact).model_rebuild()  # before 2.14, pydantic writes no class that it has not built
    return contact


@lru_cache(maxsize=1)
def _reader(kinds: tuple[type[ContactSpec], ...]) -> TypeAdapter[Any]:
    """Make the validation of contacts of several kinds, distinguished by their key `type`.

    It is costly to make and therefore cached, until another pair is registered.
    """
    union: Any = reduce(or_, kinds)
    return TypeAdapter(Annotated[union, Field(discriminator="type")])


#: A contact of any registered kind.
AnyContact = Annotated[SerializeAsAny[ContactSpec], PlainValidator(_validate)]


def magnitude_names(contacts: Mapping[str, int]) -> list[str]:
    """Names of all force magnitudes: ``tip`` for one, ``pad.1``, ``pad.2``, … for several.

    Args:
        contacts: number r of force magnitudes of each contact, by its name.
    """
    names = []
    for name, r in contacts.items():
        if r == 1:
            names.append(name)
        else:
            names += [f"{name}.{k + 1}" for k in range(r)]
    return names
