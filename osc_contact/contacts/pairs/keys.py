"""Declarations of a pair's geometry: kind, quantity and bound of each field.

`check_geometry` checks the values of a new pair against them. The keys of a contact in scenarios
are made from the same declarations.
"""

from __future__ import annotations

from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_type_hints

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.errors import InvalidInputError
from osc_contact.settings.quantities import Length, NotNegative, Positive, UnitVec3, Vec3
from osc_contact.spatial import Array, Coordinates, as_array, norm, unit_vector


class OfBody(Enum):
    """Mark of a key whose value is given in the frame of the touched body.

    Values of keys without this mark are given in the frame of the held object.
    """

    POINT = "point"
    DIRECTION = "direction"


#: Mark of a field whose value is taken from the `face` of a contact, a separate key.
OF_FACE = "of a face"


def store(pair: object, **values: object) -> None:
    """Set attributes of a frozen dataclass during its construction."""
    for key, value in values.items():
        object.__setattr__(pair, key, value)


if TYPE_CHECKING:

    class Outward:
        """Field that contains a number or an array, and accepts any ArrayLike."""

        def __get__(self, pair: object, owner: type | None = None) -> float | Array: ...
        def __set__(self, pair: object, value: ArrayLike) -> None: ...

    Point: TypeAlias = Coordinates
    Direction: TypeAlias = Coordinates
    BodyPoint: TypeAlias = Coordinates
    BodyDirection: TypeAlias = Coordinates
    FacePoint: TypeAlias = Coordinates
    FaceDirection: TypeAlias = Coordinates
else:
    #: Annotation of a field of a pair: type, kind of geometry for `check_geometry`, and quantity
    #: for the key of a scenario.
    Point = Annotated[Array, "point", Vec3]
    Direction = Annotated[Array, "direction", UnitVec3]
    BodyPoint = Annotated[Array, "point", Annotated[Vec3, OfBody.POINT]]
    BodyDirection = Annotated[Array, "direction", Annotated[UnitVec3, OfBody.DIRECTION]]
    #: Fields of the face of a contact, from the keys of `face`.
    FacePoint = Annotated[Array, "point", OF_FACE]
    FaceDirection = Annotated[Array, "direction", OF_FACE]
    #: Outward direction of a body at its edge, or a sign.
    Outward = Annotated[float | Array, "", Annotated[UnitVec3, OfBody.DIRECTION]]
Radius = Annotated[float, "≥", Annotated[NotNegative[Length], Field(default=0.0)]]
Extent = Annotated[float, ">", Positive[Length]]


@cache
def declared_geometry(pair: type) -> dict[str, tuple[Any, ...]]:
    """Map each annotated field of a pair to its kind of geometry and its types as a key of YAML."""
    hints = get_type_hints(pair, include_extras=True).items()
    return {key: hint.__metadata__ for key, hint in hints if hasattr(hint, "__metadata__")}


def check_geometry(pair: Any) -> None:
    """Check the geometry of a frozen pair during construction; copy points, normalise directions.

    Raises:
        InvalidInputError: wrong shape, a number that is not finite, a zero direction, or a length
            < 0 (≤ 0 for lengths that must be positive).
    """
    pair_class: Any = type(pair)
    for key, (kind, *_) in declared_geometry(pair_class).items():
        name = f"{pair.name}.{key}"
        value = getattr(pair, key)
        if kind == "point":
            store(pair, **{key: as_array(name, value, (3,))})
        elif kind == "direction":
            store(pair, **{key: unit_vector(name, value)})
        elif kind and not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and kind == "≥"))):
            raise InvalidInputError(f"{name} = {value}; give a length {kind} 0 m")


#: Largest length of a held object, in multiples of the stretched arm; more suggests wrong units.
LARGEST_OBJECT = 2.0


def object_sizes(pair: ContactPair) -> dict[str, float]:
    """Lengths (m) of the held object in a packaged pair: its radii, extents and points by key.

    The length of a point is its distance from the object's origin. Points of the environment are
    excluded, because the point of an infinite plane may be anywhere.
    """
    sizes = {}
    for key, (kind, *keys) in declared_geometry(type(pair)).items():
        if kind == "point" and Vec3 not in keys:
            continue
        if kind and kind != "direction":  # a surface has neither
            sizes[key] = norm(np.atleast_1d(getattr(pair, key)))
    return sizes


def require_object_fits(pair: ContactPair, longest: float) -> None:
    """Refuse a held object that is too large for the arms, which suggests lengths in mm.

    Args:
        pair: pair of the contact.
        longest: stretched length of the longest arm (m).

    Raises:
        InvalidInputError: a length exceeds `LARGEST_OBJECT` times `longest`.
    """
    for key, length in object_sizes(pair).items():
        if length > LARGEST_OBJECT * longest:
            raise InvalidInputError(
                f"contact '{pair.name}': {key} is {length:.4g} m in size or from the object's "
                f"origin, and the stretched arm is {longest:.3g} m long; give lengths in m: "
                f"{1e-3 * length:.4g} for {length:.4g} mm"
            )
