"""Declarations of a pair's geometry: kind, quantity and bound of each field, checked as it is made.

A scenario's keys of a contact are made from the same declarations.
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
    """Mark of a key that is given in the frame of the body a contact is on.

    Keys without it belong to the held object and are given in its frame.
    """

    POINT = "point"
    DIRECTION = "direction"


#: Marks a field whose value comes from the contact's face, which has a key of its own.
OF_FACE = "of a face"


def store(pair: object, **values: object) -> None:
    """Set attributes of a frozen dataclass while it is being made."""
    for key, value in values.items():
        object.__setattr__(pair, key, value)


if TYPE_CHECKING:

    class Outward:
        """A field that is a number or an array, and takes either as numbers of any kind."""

        def __get__(self, pair: object, owner: type | None = None) -> float | Array: ...
        def __set__(self, pair: object, value: ArrayLike) -> None: ...

    Point: TypeAlias = Coordinates
    Direction: TypeAlias = Coordinates
    BodyPoint: TypeAlias = Coordinates
    BodyDirection: TypeAlias = Coordinates
    FacePoint: TypeAlias = Coordinates
    FaceDirection: TypeAlias = Coordinates
else:
    #: Kind of a number of a pair's geometry, then its quantity; `check_geometry` reads the first
    #: from the annotation of the field, the keys of a scenario are made from the second.
    Point = Annotated[Array, "point", Vec3]
    Direction = Annotated[Array, "direction", UnitVec3]
    BodyPoint = Annotated[Array, "point", Annotated[Vec3, OfBody.POINT]]
    BodyDirection = Annotated[Array, "direction", Annotated[UnitVec3, OfBody.DIRECTION]]
    #: Of a face that a contact brings: keys of `face`.
    FacePoint = Annotated[Array, "point", OF_FACE]
    FaceDirection = Annotated[Array, "direction", OF_FACE]
    #: Out of a body at its edge: a direction, or a sign.
    Outward = Annotated[float | Array, "", Annotated[UnitVec3, OfBody.DIRECTION]]
Radius = Annotated[float, "≥", Annotated[NotNegative[Length], Field(default=0.0)]]
Extent = Annotated[float, ">", Positive[Length]]


@cache
def declared_geometry(pair: type) -> dict[str, tuple[Any, ...]]:
    """Map each annotated field of a pair to its kind of geometry and its types as a key of YAML."""
    hints = get_type_hints(pair, include_extras=True).items()
    return {key: hint.__metadata__ for key, hint in hints if hasattr(hint, "__metadata__")}


def check_geometry(pair: Any) -> None:
    """Check the geometry of a frozen pair that is being made; copy points, normalise directions.

    Raises:
        InvalidInputError: wrong shape, not finite, a direction that is zero, a length < 0 (≤ 0).
    """
    made: Any = type(pair)
    for key, (kind, *_) in declared_geometry(made).items():
        name = f"{pair.name}.{key}"
        value = getattr(pair, key)
        if kind == "point":
            store(pair, **{key: as_array(name, value, (3,))})
        elif kind == "direction":
            store(pair, **{key: unit_vector(name, value)})
        elif kind and not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and kind == "≥"))):
            raise InvalidInputError(f"{name} = {value}; give a length {kind} 0 m")


#: Lengths of the held object above this many times the arms' stretched length are in other units.
LARGEST_OBJECT = 2.0


def object_sizes(pair: ContactPair) -> dict[str, float]:
    """Lengths (m) that a packaged pair states of the held object: of radii, extents and points.

    A point counts by its distance from the object's origin. Points of the environment are left
    out: those of an endless plane may lie anywhere.
    """
    found = {}
    for key, (kind, *keys) in declared_geometry(type(pair)).items():
        if kind == "point" and Vec3 not in keys:
            continue
        if kind and kind != "direction":  # a surface has neither
            found[key] = norm(np.atleast_1d(getattr(pair, key)))
    return found


def require_object_fits(pair: ContactPair, longest: float) -> None:
    """Refuse lengths of the held object that no arm of this size can hold.

    Args:
        pair: of the contact. longest: stretched length of the longest arm (m).

    Raises:
        InvalidInputError: with the length in m and in mm.
    """
    for key, length in object_sizes(pair).items():
        if length > LARGEST_OBJECT * longest:
            raise InvalidInputError(
                f"contact '{pair.name}': {key} is {length:.4g} m in size or from the object's "
                f"origin, and the stretched arm is {longest:.3g} m long; give lengths in m: "
                f"{1e-3 * length:.4g} for {length:.4g} mm"
            )
