"""Types of the arguments of motions and conditions, with the quantities of these in files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

from numpy.typing import ArrayLike

from osc_contact.settings.quantities import UnitVec3, Vec3

if TYPE_CHECKING:
    Direction: TypeAlias = ArrayLike
    Place: TypeAlias = ArrayLike
    Points: TypeAlias = ArrayLike
else:
    Direction = Annotated[ArrayLike, UnitVec3]  #: direction (3,), of any length in Python
    Place = Annotated[ArrayLike, Vec3]  #: point (3,) (m)
    Points = Annotated[ArrayLike, tuple[Vec3, ...]]  #: points (k, 3) (m)
