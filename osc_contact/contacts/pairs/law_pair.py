"""Pairs whose N and n_γ are computed by the law (`law.pair_geometry`) from rows of numbers.

The tick runs compiled functions. `LawPair` runs the same source as Python, on floats for one
instant or on arrays for many instants.

A `LawPair` keeps its geometry as `_row`, the PairRow from which MODEL is packed (kind, parameters),
and as `_numbers`, the same in the form that the law's functions index: stand-ins of a PAIR row and
of its SHAPE rows.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.keys import store
from osc_contact.contacts.pairs.pair import AT_REST, Bodies, ContactPair
from osc_contact.contacts.pairs.register import PackagedPair
from osc_contact.contacts.surface import OF_ARRAYS, Shapes
from osc_contact.errors import ContactError
from osc_contact.law import pair_geometry as law
from osc_contact.law.jit import as_python
from osc_contact.law.records import SURFACE, TANGENTS
from osc_contact.spatial import Array, Poses

_place = as_python(law.place_pair, **OF_ARRAYS)
_motion = as_python(law.permitted_motion)
_point = as_python(law.point_of_contact)

#: Elements M[i, j] of a matrix; indexing a dictionary is faster than indexing an array.
_Elements = dict[tuple[int, int], Any]
_IDENTITY = {(i, j): float(i == j) for i in range(3) for j in range(4)}
#: Methods whose results follow from the row; a subclass that overrides one has no row.
_METHODS_OF_ROW = ("contact", "points_of_contact")


class PairRow(NamedTuple):
    """Description of a pair for the compiled law.

    Attributes:
        kind: POINTS, FACE_ON_VERTEX, EDGES, TANGENTS, SURFACE or FUNCTION of `law.records`.
        shapes: arrays (16,) for the columns of N, then for the permitted motions; the functions of
            `law.pair_geometry` state their contents.
        freedoms: number of permitted motions among the shapes.
        address: address of the C function of a FUNCTION pair; else 0.
    """

    kind: int
    shapes: tuple[Array, ...]
    freedoms: int = 0
    address: int = 0


def shape(*parts: Array | float) -> Array:
    """Concatenate numbers of one column or permitted motion to a row (16,), padded with zeros."""
    row = np.zeros(16)
    numbers = np.concatenate([np.atleast_1d(part) for part in parts])
    row[: len(numbers)] = numbers
    return row


def law_row(pair: ContactPair) -> PairRow | None:
    """Description of a pair for the compiled law.

    A subclass of a packaged pair may override a method, such as `contact`; then the row of its base
    class would describe another pair, so Python evaluates it. Classes before the one that declares
    `row`, in the order of method resolution, are searched for such methods (`_METHODS_OF_ROW`).

    Args:
        pair: any contact pair.

    Returns:
        The row; None if the pair has none, or if its class overrides such a method.
    """
    row = getattr(pair, "row", None)
    if row is None:
        return None
    classes = type(pair).__mro__
    declared_by = next(kind for kind in classes if "row" in vars(kind))
    newer = classes[: classes.index(declared_by)]
    is_overridden = any(name in vars(kind) for kind in newer for name in _METHODS_OF_ROW)
    return None if is_overridden else row()


class LawPair(PackagedPair):
    """Base of pairs whose N and n_γ are computed by the law.

    Attributes:
        pushes, surface_point, surface_radius: see `ContactPair`.
    """

    pushes: ClassVar[bool] = False
    surface_point: Array
    surface_radius: float = 0.0
    _row: PairRow
    _numbers: tuple[Any, Shapes]

    def _store_geometry(
        self, surface_point: Array, kind: int, shapes: tuple[Array, ...], freedoms: int = 0
    ) -> None:
        """Store the geometry of a pair during its construction.

        It is kept as a row of the law (`_row`), and as the numbers and shapes with which the law's
        functions compute gaps and N outside a tick (`_numbers`).

        Args:
            surface_point: (3,) point of the environment's feature, in its frame (m).
            kind: kind of the pair in `law.records`.
            shapes: arrays (16,) for the columns of N, then for the permitted motions.
            freedoms: number of permitted motions among the shapes.
        """
        row = PairRow(kind, shapes, freedoms)
        head = SimpleNamespace(**row._asdict(), first=0, shape_at=0)
        head.count = len(row.shapes) - row.freedoms
        store(self, _row=row, _numbers=(head, Shapes(row.shapes)), surface_point=surface_point)

    def row(self) -> PairRow:
        """Row of the pair for the compiled law."""
        return self._row

    def _contact(self, b: Bodies) -> Contact:
        """N and n_γ, and T (6, 6−r) of a pair that is defined by its permitted motions.

        Args:
            b: poses and twists of object and environment at one instant.
        """
        A = _pose_elements(b.X_A)
        E = _pose_elements(b.X_E)
        columns = self._evaluate_columns(A, E, b.V_A, b.V_E)
        N = np.array([column.N for column in columns]).reshape(-1, 6).T
        n_gamma = np.array([column.n_gamma for column in columns])
        T = None
        if self._row.kind == TANGENTS and len(self._row.shapes) == 6:
            freedoms = self._numbers[1][N.shape[1] :]
            T = np.array([_motion(freedom.row, A, E) for freedom in freedoms]).reshape(-1, 6).T
        return Contact(N, n_gamma, T=T, name=self.name)

    def points_of_contact(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """Points of application of the magnitudes of a pair that pushes.

        Args:
            X_WO: pose of the object in the world.
            X_WE: pose of the touched body in the world; None: the world's frame.

        Returns:
            (3, r) points in world coordinates (m).
        """
        A = _pose_elements(X_WO)
        E = _IDENTITY if X_WE is None else _pose_elements(X_WE)
        shapes_and_columns = zip(self._numbers[1], self._evaluate_columns(A, E), strict=False)
        points = [
            _point(self._row.kind, shape.row, A, E, column.N)
            for shape, column in shapes_and_columns
        ]
        return X_WO.translation[:, None] + np.array(points).T

    def normals(self, X_WO: Poses, X_WE: Poses | None = None) -> Array:
        """Compute N at k instants.

        Args:
            X_WO: k poses of the object in the world.
            X_WE: k poses (or one) of the touched body in the world; None: the world's frame.

        Returns:
            N (6, r, k) at O in world axes.
        """
        A = _elements_over(X_WO)
        E = _IDENTITY if X_WE is None else _elements_over(X_WE)
        columns = self._evaluate_columns(A, E)
        N = np.empty((6, len(columns), X_WO.p.shape[-1]))
        for j, column in enumerate(columns):
            for i in range(6):
                N[i, j] = column.N[i]
        return N

    def _evaluate_columns(
        self, A: _Elements, E: _Elements, V_O: Array = AT_REST, V_E: Array = AT_REST
    ) -> list[Any]:
        """Evaluate the pair by the functions of the law.

        Args:
            A, E: poses of the object and of the touched body in the world: elements of [R p] (3, 4)
                by (row, column), numbers, or arrays (k,) over time.
            V_O, V_E: (6,) twists of object and body at O (m/s, rad/s).

        Returns:
            A row for each force, with N (6,) at O and n_γ; elements are arrays for poses over time.

        Raises:
            ContactError: edges are parallel, or the nearest place of a surface is not unique.
        """
        # stand-ins of the records that the compiled function fills, with numbers or arrays
        head, shapes = self._numbers
        columns = [
            SimpleNamespace(N=[0.0] * 6, n_gamma=0.0, turn=(0.0, 0.0, 0.0), believed=[0.0] * 3)
            for _ in range(head.count)
        ]
        try:
            with np.errstate(all="ignore"):
                V_rel = (V_O - V_E).tolist()
                motion = law.Motion(A, V_O.tolist(), E, V_E.tolist(), V_rel, True)
                sine = _place(head, shapes, columns, motion)
        except ZeroDivisionError:  # numbers of one instant; arrays give inf or NaN instead
            sine = 0.0
        # sine of the angle between edges, or its counterpart of a surface; too small: undefined N
        least_sine = np.min(sine)
        if least_sine >= law.PARALLEL:
            return columns
        if self._row.kind == SURFACE:
            raise ContactError(
                f"{self.name}: the ball's centre is where no one place of the surface is nearest; "
                "start with it on the outer side, nearer than the least radius of curvature"
            )
        raise ContactError(
            f"{self.name}: the edges are parallel (sine of their angle {least_sine:.2g}), so their "
            "common normal is undefined; model this contact as an edge on a face"
        )


def normals_over(pair: ContactPair, X_WO: Poses, X_WE: Poses | None = None) -> Array:
    """N (6, r, k) of a pair at each of k instants, at O in world axes.

    Args:
        pair: pair of any kind; a pair without a row of the law is evaluated instant by instant.
        X_WO: k poses of the object.
        X_WE: k poses (or one) of the environment body; None: the world frame.
    """
    if isinstance(pair, LawPair) and law_row(pair) is not None:
        return pair.normals(X_WO, X_WE)
    parts = [
        pair.contact(X_WO[i], AT_REST, None if X_WE is None else X_WE[i]).N
        for i in range(X_WO.p.shape[-1])
    ]
    return np.stack(parts, axis=-1)


def _pose_elements(X: SE3) -> _Elements:
    """Elements of a pose as a dictionary of floats, in the form that the law's functions index.

    The law reads elements as X[i, j]. Run as Python it is much faster with a dictionary of floats
    than with an array, whose elements are numpy scalars.

    Args:
        X: pose of the object or of the touched body in the world.

    Returns:
        Floats by (row, column) of the matrix [R p] (3, 4): rotation in columns 0 … 2, position (m)
        in column 3.
    """
    rows = X.homogeneous.tolist()
    return {(i, j): rows[i][j] for i in range(3) for j in range(4)}


def _elements_over(X: Poses) -> _Elements:
    """Elements of k poses as a dictionary of arrays, in the form that the law's functions index.

    The law's functions then compute all k instants at once: each of their numbers is an array.

    Args:
        X: poses of the object or of the touched body in the world at k instants.

    Returns:
        Arrays (k,), or (1,) for constant poses, by (row, column) of the matrix [R p] (3, 4):
        rotation in columns 0 … 2, position (m) in column 3.
    """
    return {(i, j): X.p[i] if j == 3 else X.R[i, j] for i in range(3) for j in range(4)}
