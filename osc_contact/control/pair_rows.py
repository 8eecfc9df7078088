"""Contact pairs as rows of numbers for `law.contact`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from osc_contact.contacts.pairs import (
    ConeInGroove,
    ContactPair,
    EdgeOnEdge,
    FaceOnVertex,
    Fixed,
    Free,
    Prismatic,
    Revolute,
    Screw,
    VertexOnFace,
)
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.contacts.pairs.tangent_pair import TangentPair
from osc_contact.law.tables import EDGES, FACE_ON_VERTEX, GIVEN, POINTS, TANGENTS
from osc_contact.spatial import Array

__all__ = ["PairRows"]

_TURN, _SLIDE, _SCREW = range(3)
_FORCE, _COUPLE, _THREAD = range(3)
#: what the friction of a vertex rests on; a pair that has its own is evaluated by Python
_OF_VERTEX = {
    name: getattr(VertexOnFace, name) for name in ("direction", "point_on_face", "_face")
}  # fmt: skip


class PairRows:
    """The pairs of a controller as arrays.

    Attributes:
        table: kind, first column, columns, first shape, freedoms, whether its friction is known, of
            each pair. shapes: (16,) each. owners: (r_all,) pair of each column of N. r_all: their
            number. given: columns of the pairs that only Python can evaluate, by number.
        elsewhere: (pair, its first column) where only Python code can evaluate the pair.
    """

    def __init__(self, pairs: Sequence[ContactPair], columns: Mapping[int, int]) -> None:
        """Pack them; `columns`: of the pairs evaluated elsewhere, by number, unknown: 0."""
        table: list[tuple[int, ...]] = []
        shapes: list[Array] = []
        owners: list[int] = []
        self.elsewhere: list[tuple[int, ContactPair, int]] = []
        for number, pair in enumerate(pairs):
            kind, rows, freedoms = _read(pair)
            r = len(rows) - freedoms
            if kind == GIVEN:
                r = columns.get(number, 0)
                self.elsewhere.append((number, pair, len(owners)))
            drags = int(kind == POINTS and isinstance(pair, VertexOnFace))
            table.append((kind, len(owners), r, len(shapes), freedoms, drags))
            shapes.extend(rows)
            owners.extend([number] * r)
        self.table, self.shapes, self.owners = table, shapes, owners
        self.given = dict(columns)
        self.r_all = len(owners)


def _read(pair: ContactPair) -> tuple[int, list[Array], int]:
    """Kind, shape rows, and how many of them, at the end, are freedoms."""
    if isinstance(pair, PointsOnPlanes) and type(pair).contact is PointsOnPlanes.contact:
        points, directions = pair._points.T, pair._into.T
        if isinstance(pair, VertexOnFace):
            if any(getattr(type(pair), name) is not own for name, own in _OF_VERTEX.items()):
                return GIVEN, [], 0
            return POINTS, [_row(points[0], directions[0], directions[0] @ pair.point)], 0
        return POINTS, [_row(p, n) for p, n in zip(points, directions, strict=True)], 0
    if type(pair) is FaceOnVertex:
        return FACE_ON_VERTEX, [_row(pair.normal, pair.vertex)], 0
    if type(pair) is EdgeOnEdge:
        side = (0.0, pair.side) if np.ndim(pair.side) else (pair.side, np.zeros(3))
        lines = pair.point_A, pair.direction_A, pair.point_E, pair.direction_E
        return EDGES, [_row(*lines, *side)], 0
    if isinstance(pair, TangentPair):
        freedoms = _freedoms(pair)
        if freedoms is not None:
            return TANGENTS, [*_columns(pair), *freedoms], len(freedoms)
    return GIVEN, [], 0


def _columns(pair: TangentPair) -> list[Array]:
    forces = [
        _row(p, n, _FORCE) for p, n in zip(pair._points.T, pair._into.T, strict=True)
    ]  # fmt: skip
    couples = [
        _row(a, u, _COUPLE) for a, u in zip(pair._arms.T, pair._marks.T, strict=True)
    ]  # fmt: skip
    thread = []
    if isinstance(pair, Screw):
        thread = [_row(pair.point, pair._seat[:, 2], _THREAD, pair.axis, pair.pitch)]
    return [*forces, *couples, *thread]


def _freedoms(pair: TangentPair) -> list[Array] | None:
    """The permitted motions of the packaged pairs; None: a pair of the user's own."""
    if type(pair) is Revolute:
        return [_row(pair.point, pair.axis, _TURN)]
    if type(pair) is Prismatic:
        return [_row(pair.point, pair.assembled.rotation @ pair.axis, _SLIDE)]
    if type(pair) is Screw:
        return [_row(pair.point, pair.axis, _SCREW, pair._seat[:, 2], pair.pitch)]
    if type(pair) is ConeInGroove:
        slide = _row(pair.apex, pair.groove_direction, _SLIDE)
        return [_row(pair.apex, pair.axis, _TURN), slide]
    return [] if type(pair) in (Fixed, Free) else None


def _row(*parts: Array | float) -> Array:
    row = np.zeros(16)
    flat = np.concatenate([np.atleast_1d(part) for part in parts])
    row[: len(flat)] = flat
    return row
