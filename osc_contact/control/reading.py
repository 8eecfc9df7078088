"""How contact forces are read off the wrists: by the filter of fig. 5, or by least squares.

The filter takes all that pushes at a contact for N_μα: it is exact without friction, or with
friction known, whatever the object does. Least squares let each point of contact push along its
tangents, too (`osc_contact.law.least_squares`): they are not fooled by friction or by a wrong
normal, but reckon with the acceleration that is wanted of the object. That answer is unique where
the columns of N are independent of the tangents. Two points can always push against one another
along the line between them; so the points must lie in one plane, whose normal is that of them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from osc_contact.contacts.pairs import ContactPair, FaceOnVertex
from osc_contact.contacts.pairs.law_pair import law_row
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.dynamics.rail import Body
from osc_contact.errors import InvalidInputError

__all__ = ["Reading", "choose_reading"]

Reading = Literal["filter", "least_squares"]

_SAME = 1e-3  #: normals and planes (m) that differ by less are one


def choose_reading(
    wanted: Reading | None,
    pairs: Sequence[ContactPair],
    bodies: Sequence[Body | None],
) -> Reading:
    """What is wanted, or the better one: least squares where their answer is unique.

    Args:
        wanted: None: choose. pairs: the contacts. bodies: of each.

    Raises:
        InvalidInputError: unknown, or least squares wanted where they are not possible.
    """
    if wanted not in (None, "filter", "least_squares"):
        raise InvalidInputError(
            f"reading = '{wanted}'; give 'filter', 'least_squares' or None, which chooses"
        )
    unknown = [pair.name for pair in pairs if not _known(pair)]
    if wanted == "least_squares" and unknown:
        raise InvalidInputError(
            f"reading = 'least_squares' needs contacts that know where they touch; {unknown} do "
            "not. Give 'filter'"
        )
    if wanted is not None:
        return wanted
    unique = pairs and not unknown and _in_one_plane(pairs, bodies)
    return "least_squares" if unique else "filter"


def _known(pair: ContactPair) -> bool:
    """Whether the law itself knows where it touches."""
    row = law_row(pair)
    return row is not None and row.rubs


def _in_one_plane(pairs: Sequence[ContactPair], bodies: Sequence[Body | None]) -> bool:
    """Whether all points of contact stay in one plane, of the environment or of the object."""
    if any(body is not bodies[0] for body in bodies):
        return False
    planes: list[tuple[float, ...]] = []
    for pair in pairs:
        if isinstance(pair, PointsOnPlanes):
            columns = zip(pair._into.T, pair._heights, strict=True)
            planes.extend((*into, height, 0.0) for into, height in columns)
        elif isinstance(pair, FaceOnVertex):
            planes.append((*pair.normal, float(pair.normal @ pair.point), 1.0))
        elif len(pairs) > 1:
            return False
        else:
            planes.append((0.0,) * 5)  # one point
    return bool(np.ptp(np.array(planes), axis=0).max() < _SAME)
