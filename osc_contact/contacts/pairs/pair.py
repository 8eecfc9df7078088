"""What every contact pair offers, and the bookkeeping they share: two bodies seen from O.

The geometry of most pairs is a few rows of numbers: N and n_γ come from `law.contact`. The tick
runs these functions compiled, `LawPair` runs the same source as Python: on floats at one instant,
on arrays at many.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Protocol,
    TypeAlias,
    TypeVar,
    dataclass_transform,
    get_args,
    get_type_hints,
    runtime_checkable,
)

import numpy as np
from numpy.typing import ArrayLike
from pinocchio import SE3
from pydantic import Field, create_model

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.surface import OF_ARRAYS, Shapes
from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.law import contact as law
from osc_contact.law.jit import as_python
from osc_contact.law.records import EDGES, FACE_ON_VERTEX, SURFACE, TANGENTS
from osc_contact.scenarios import bodies
from osc_contact.scenarios.bodies import ContactSpec, OfBody, OnBodySpec, register_contact
from osc_contact.scenarios.quantities import Length, NotNegative, Positive, UnitVec3, Vec3
from osc_contact.spatial import (
    Array,
    Coordinates,
    Poses,
    as_array,
    carry_twist,
    cross,
    geometry,
    norm,
    unit_vector,
)

_WORLD = SE3.Identity()
_AT_REST = np.zeros(6)


@runtime_checkable
class ContactPair(Protocol):
    """A feature of the held object A against a feature of the environment body E.

    `gaps` are the r signed errors that the contact keeps at zero; each shrinks as the object moves
    along its column of N: d gaps/dt = −NᵀV_rel. n_γ is the Nᵀa_rel that keeps them at zero.

    A pair may have more, else the value in brackets counts:

    * pushes: whether every magnitude is a force that must not become negative (False);
    * points_of_contact(X_WO, X_WE): (3, r) where each magnitude of a pair that pushes acts, world
      (m); there it slides, with friction (None: its friction is not known);
    * surface_point: (3,) a point of the environment's feature, in its frame (m), and
      surface_radius: of that feature if it is round (m). Contact points are drawn where the lines
      of force come nearest to it (to O; 0);
    * row(): what it is to the compiled law, see `PairRow` (None: Python evaluates the pair
      between the parts of each tick).

    Example:
        >>> pair: osc.ContactPair = osc.VertexOnFace([0, 0, 0], [0, 0, 0.5], [0, 0, 1])
        >>> contact = pair.contact(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5])), np.zeros(6))
        >>> print(contact.N.T + 0.0, pair.gaps(pin.SE3.Identity()))
        [[ 0.  0. -1.  0.  0.  0.]] [-0.5]
    """

    @property
    def name(self) -> str:
        """Used in messages and recordings."""

    def contact(
        self,
        X_WO: SE3,
        V_O: Array,
        X_WE: SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r) and n_γ (r,) at O, world axes.

        Args:
            X_WO: pose of the object; its origin is the operational point.
            V_O: (6,) its twist at O, world axes (m/s, rad/s).
            X_WE: pose of the environment body (default: the world).
            V_E: (6,) its twist at its own origin, world axes (default: at rest). Without X_WE
                that origin is the world's.
        """

    def gaps(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """(r,) signed errors (m, or rad where the column of N is a couple), 0 in contact."""


def count_forces(pair: ContactPair) -> int:
    """r, how many force magnitudes a pair has: one for each of its gaps."""
    if (row := getattr(pair, "row", None)) is None:
        return len(pair.gaps(SE3.Identity()))
    shown = row()  # true in every pose; gaps of edges that are parallel do not exist
    return len(shown.shapes) - int(shown.freedoms)


def pushes_only(pair: ContactPair) -> bool:
    """Whether every magnitude of the pair is a force that must not become negative.

    Those of pairs given by T (hinges, holes, grooves) and of gap functions have either sign.
    """
    return bool(getattr(pair, "pushes", False))


def has_place(pair: ContactPair) -> bool:
    """Whether a contact touches at points that are known."""
    return getattr(pair, "surface_point", None) is not None


def knows_where_it_slides(pair: ContactPair) -> bool:
    """Whether friction at the pair is known: it pushes at known points.

    Forces of either sign (hinges, holes, grooves) act somewhere in a gap.
    """
    return pushes_only(pair) and hasattr(pair, "points_of_contact")


@dataclass(frozen=True, slots=True)
class Bodies:
    """Object A and environment E at one instant: poses, and twists at O, world axes."""

    X_A: SE3
    X_E: SE3
    V_A: Array
    V_E: Array

    @classmethod
    def at_O(
        cls,
        X_WO: SE3,
        V_O: Array = _AT_REST,
        X_WE: SE3 | None = None,
        V_E: Array | None = None,
    ) -> Bodies:
        """The arguments of `ContactPair.contact`, E's twist carried to O.

        Args:
            X_WO, X_WE: poses of object and environment; X_WE None: the world's.
            V_O: (6,) twist of the object at O. V_E: (6,) of the environment at its origin.
        """
        X_E = X_WE or _WORLD
        V = _AT_REST if V_E is None else carry_twist(V_E, X_E.translation, X_WO.translation)
        return cls(X_WO, X_E, V_O, V)

    @property
    def V_rel(self) -> Array:
        """(6,) twist of A relative to E, at O."""
        return self.V_A - self.V_E


class PackagedPair:
    """A pair whose `contact` and `gaps` are evaluated on `Bodies`; see `ContactPair`."""

    name: str

    def __post_init__(self) -> None:
        check_geometry(self)
        self._make()

    def _make(self) -> None:
        """Check and keep what else there is of the geometry."""

    def contact(
        self,
        X_WO: SE3,
        V_O: Array,
        X_WE: SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r) and n_γ (r,) at O, world axes (see `ContactPair.contact`).

        Args:
            X_WO, V_O, X_WE, V_E: as of `ContactPair.contact`.

        Raises:
            ContactError: there is no N in these poses, such as that of two parallel edges.
        """
        return self._contact(Bodies.at_O(X_WO, V_O, X_WE, V_E))

    def gaps(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """(r,) signed errors (m or rad), 0 in contact; distances are negative in an overlap."""
        return self._gaps(X_WO if X_WE is None else X_WE.actInv(X_WO))

    def _contact(self, b: Bodies) -> Contact:
        raise NotImplementedError

    def _gaps(self, X_EA: SE3) -> Array:
        """At a pose of the object in the environment frame."""
        raise NotImplementedError


def triad(z: Array) -> Array:
    """(3, 3) right-handed axes whose third column is the unit vector z; the same z, the same axes.

    The first column is horizontal for every z but ±y.
    """
    x = cross(np.array([0.0, 1.0, 0.0]), z)
    if norm(x) < 1e-3:
        x = cross(np.array([0.0, 0.0, 1.0]), z)
    x = x / norm(x)
    return np.column_stack((x, cross(z, x), z))


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
    #: What a number of a pair's geometry is, and as a key of a scenario; `check_geometry` and
    #: `register_pair` read both from the field's annotation.
    Point = Annotated[Array, "point", Vec3]
    Direction = Annotated[Array, "direction", UnitVec3]
    BodyPoint = Annotated[Array, "point", bodies.BodyPoint]
    BodyDirection = Annotated[Array, "direction", bodies.BodyDirection]
    #: Of a face that a contact brings: keys of `face`.
    FacePoint = Annotated[Array, "point"]
    FaceDirection = Annotated[Array, "direction"]
    #: Out of a body at its edge: a direction, or a sign.
    Outward = Annotated[float | Array, "", bodies.BodyDirection]
Radius = Annotated[float, "≥", Annotated[NotNegative[Length], Field(default=0.0)]]
Extent = Annotated[float, ">", Positive[Length]]


@cache
def _geometry(pair: type) -> dict[str, tuple[Any, ...]]:
    """Of each field whose annotation states them, its kind and what it is as a key."""
    hints = get_type_hints(pair, include_extras=True).items()
    return {key: hint.__metadata__ for key, hint in hints if hasattr(hint, "__metadata__")}


def check_geometry(pair: Any) -> None:
    """Check the geometry of a frozen pair that is being made; copy points, normalise directions.

    Raises:
        InvalidInputError: wrong shape, not finite, a direction that is zero, a length < 0 (≤ 0).
    """
    made: Any = type(pair)
    for key, (kind, *_) in _geometry(made).items():
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
    for key, (kind, *keys) in _geometry(type(pair)).items():
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


# The register of contact pairs: each enters it where it is written, with its keys in YAML.


Pair = TypeVar("Pair", bound=type)

#: Every registered pair by the name of its class.
PAIRS: dict[str, type[ContactPair]] = {}


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(field,))
def register_pair(
    forces: int | None = None, on: type[ContactSpec] = OnBodySpec
) -> Callable[[Pair], Pair]:
    """Class decorator: enter a pair in the register; a packaged one becomes a frozen dataclass.

    Args:
        forces: r, of a pair that scenarios may name, as its `name` is by default; its keys are the
            fields that are annotated as keys, such as `Point`, with their docstrings. None: it is
            made in Python only.
        on: what else such a contact has.
    """

    def enter(pair: Pair) -> Pair:
        if issubclass(pair, PackagedPair) and "__dataclass_fields__" not in vars(pair):
            geometry(pair)
            _show_plain_types(pair)
        PAIRS[pair.__name__] = pair
        if forces is not None:
            register_contact(_keys_of(pair, forces, on))
        return pair

    return enter


def _show_plain_types(pair: Any) -> None:
    """Let help and API pages show the types of fields without what they are as keys."""
    shown = signature(pair)
    hints = get_type_hints(pair)
    arguments = []
    for one in shown.parameters.values():
        hint = hints[one.name]
        plain = "ArrayLike" if Array in (hint, *get_args(hint)) else hint
        # no class: as it is written, since unions and callables spell out all that they are made of
        kept = plain if isinstance(plain, str | type) else one.annotation
        arguments.append(one.replace(annotation=kept))
    pair.__signature__ = shown.replace(parameters=arguments)


def _keys_of(pair: Any, forces: int, on: type[ContactSpec]) -> type[ContactSpec]:
    """The keys of a contact that is such a pair."""
    kind: Any = pair.name
    keys: dict[str, Any] = {"type": (Literal[kind], kind)}
    geometry = _geometry(pair)
    for one in fields(pair):
        for key in geometry.get(one.name, ())[1:]:
            keys[one.name] = key if one.default is MISSING else (key, one.default)
    name = f"{pair.__name__}Spec"
    spec = create_model(name, __base__=on, __module__=pair.__module__, __doc__=pair.__doc__, **keys)
    spec.forces = forces
    spec.describes = pair
    spec.__qualname__ = f"{pair.__name__}.Keys"
    pair.Keys = spec
    return spec


def make_pair(spec: ContactSpec, X_WB: SE3, folder: Path | None = None) -> ContactPair:
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


_place = as_python(law.place_pair, **OF_ARRAYS)
_motion = as_python(law.permitted_motion)
_point = as_python(law.point_of_contact)

#: Elements of a matrix as the law reads them, M[i, j]: a dictionary is faster than an array.
_Elements = dict[tuple[int, int], Any]
_IDENTITY = {(i, j): float(i == j) for i in range(3) for j in range(4)}
#: Methods that determine a row; a class that replaces one of them differs from its row.
_GIVEN_BY_ROW = ("contact", "points_of_contact")


class PairRow(NamedTuple):
    """A pair as the compiled law reads it.

    Attributes:
        kind: POINTS, FACE_ON_VERTEX, EDGES, TANGENTS, SURFACE or FUNCTION of `law.records`.
        shapes: (16,) each, see the functions of `law.contact`: the columns of N, then the permitted
            motions.
        freedoms: number of the latter.
        address: of the C function of a pair that is a function.
    """

    kind: int
    shapes: tuple[Array, ...]
    freedoms: int = 0
    address: int = 0


def shape(*parts: Array | float) -> Array:
    """(16,) numbers of one column or one permitted motion, zeros behind them."""
    row = np.zeros(16)
    flat = np.concatenate([np.atleast_1d(part) for part in parts])
    row[: len(flat)] = flat
    return row


def law_row(pair: ContactPair) -> PairRow | None:
    """What a pair is to the compiled law; None: nothing, or a subclass changes what it does."""
    row = getattr(pair, "row", None)
    if row is None:
        return None
    kinds = type(pair).__mro__
    declared_by = next(kind for kind in kinds if "row" in vars(kind))
    newer = kinds[: kinds.index(declared_by)]
    changed = any(name in vars(kind) for kind in newer for name in _GIVEN_BY_ROW)
    return None if changed else row()


class LawPair(PackagedPair):
    """A pair that the law evaluates.

    Attributes:
        pushes, surface_point, surface_radius: see `ContactPair`.
    """

    pushes: ClassVar[bool] = False
    surface_point: Array
    surface_radius: float = 0.0
    _row: PairRow
    _numbers: tuple[Any, Shapes]

    def _hold(self, surface_point: Array, *given: Any) -> None:
        """Take the geometry of a pair that is being made; `given`: kind, shapes … of its row."""
        row = PairRow(*given)
        head = SimpleNamespace(**row._asdict(), first=0, shape_at=0)
        head.count = len(row.shapes) - row.freedoms
        store(self, _row=row, _numbers=(head, Shapes(row.shapes)), surface_point=surface_point)

    def row(self) -> PairRow:
        """The pair as the compiled law reads it."""
        return self._row

    def _contact(self, b: Bodies) -> Contact:
        """And T (6, 6−r), if the pair is given by it."""
        A = _elements(b.X_A)
        E = _elements(b.X_E)
        columns = self._columns(A, E, b.V_A, b.V_E)
        N = np.array([column.N for column in columns]).reshape(-1, 6).T
        n_gamma = np.array([column.n_gamma for column in columns])
        T = None
        if self._row.kind == TANGENTS and len(self._row.shapes) == 6:
            freedoms = self._numbers[1][N.shape[1] :]
            T = np.array([_motion(one.row, A, E) for one in freedoms]).reshape(-1, 6).T
        return Contact(N, n_gamma, T=T, name=self.name)

    def points_of_contact(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """(3, r) where each magnitude of a pair that pushes acts, world (m)."""
        A = _elements(X_WO)
        E = _IDENTITY if X_WE is None else _elements(X_WE)
        each = zip(self._numbers[1], self._columns(A, E), strict=False)
        points = [_point(self._row.kind, one.row, A, E, column.N) for one, column in each]
        return X_WO.translation[:, None] + np.array(points).T

    def normals(self, X_WO: Poses, X_WE: Poses | None = None) -> Array:
        """(6, r, k) N at k instants; see `normals_over`."""
        A = _elements_over(X_WO)
        E = _IDENTITY if X_WE is None else _elements_over(X_WE)
        columns = self._columns(A, E)
        N = np.empty((6, len(columns), X_WO.p.shape[-1]))
        for j, column in enumerate(columns):
            for i in range(6):
                N[i, j] = column.N[i]
        return N

    def _columns(
        self, A: _Elements, E: _Elements, V_O: Array = _AT_REST, V_E: Array = _AT_REST
    ) -> list[Any]:
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
        except ZeroDivisionError:
            sine = 0.0
        least = np.min(sine)
        if least >= law.PARALLEL:
            return columns
        if self._row.kind == SURFACE:
            raise ContactError(
                f"{self.name}: the ball's centre is where no one place of the surface is nearest; "
                "start with it on the outer side, nearer than the least radius of curvature"
            )
        raise ContactError(
            f"{self.name}: the edges are parallel (sine of their angle {least:.2g}), so their "
            "common normal is undefined; model this contact as an edge on a face"
        )


def normals_over(pair: ContactPair, X_WO: Poses, X_WE: Poses | None = None) -> Array:
    """(6, r, k) what `pair.contact` gives as N at each of k instants, at O in world axes.

    Args:
        pair: of any kind; one unknown to the law is evaluated instant by instant.
        X_WO: k poses of the object. X_WE: k poses (or 1) of the environment body; None: the world.
    """
    if isinstance(pair, LawPair) and law_row(pair) is not None:
        return pair.normals(X_WO, X_WE)
    parts = [
        pair.contact(X_WO[i], _AT_REST, None if X_WE is None else X_WE[i]).N
        for i in range(X_WO.p.shape[-1])
    ]
    return np.stack(parts, axis=-1)


def _elements(X: SE3) -> _Elements:
    rows = X.homogeneous.tolist()
    return {(i, j): rows[i][j] for i in range(3) for j in range(4)}


def _elements_over(X: Poses) -> _Elements:
    return {(i, j): X.p[i] if j == 3 else X.R[i, j] for i in range(3) for j in range(4)}


# A face of the object on a vertex of the environment.


@register_pair(forces=1)
class FaceOnVertex(LawPair):
    """A face of the object on a (rounded) vertex of the environment, r = 1.

    N = [n; (p − O) × n] with n the *outward* normal of the object's face, which points into the
    environment, and p the vertex. Now the object carries n and the environment p: ṅ = ω_O × n,
    ṗ = v_E(p).

    Example:
        >>> tip = osc.FaceOnVertex([0, 0, -0.1], [0, 0, -1], body_vertex=[0, 0, 0.3], radius=0.01)
        >>> print(tip.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.45]))).round(6))
        [0.04]
    """

    point: Point
    """a point of the object's face [x, y, z] in the object frame"""
    normal: Direction
    """the outward normal of the object's face [x, y, z] in the object frame"""
    body_vertex: BodyPoint
    """the centre of the rounded vertex [x, y, z] in the body frame"""
    radius: Radius = 0.0
    """of the rounding"""
    name: str = "face_on_vertex"
    pushes = True

    def _make(self) -> None:
        row = shape(self.normal, self.body_vertex, self.radius)
        self._hold(self.body_vertex, FACE_ON_VERTEX, (row,))
        store(self, surface_radius=self.radius)

    def _gaps(self, X_EA: SE3) -> Array:
        """(1,) distance between face and vertex surface (m), negative when they overlap."""
        R = X_EA.rotation
        apart = self.body_vertex - X_EA.translation - R @ self.point
        return np.array([R @ self.normal @ apart - self.radius])


# An edge of the object across an edge of the environment.


@register_pair(forces=1)
class EdgeOnEdge(LawPair):
    """An edge of the object across an edge of the environment, r = 1.

    N = [n; (p − O) × n], n = ± e_A × e_E / |e_A × e_E| into the environment, p the crossing point,
    which neither body carries: it slides along both edges, ṗ = v_A(p) + ṡ e_A. With e_A, e_E unit,
    ṅ = ± (1 − nnᵀ)(ė_A × e_E + e_A × ė_E) / |e_A × e_E|. With the gap g open, p is the
    point of the object's edge nearest to the other one and
    ṫ e_E − ṡ e_A = v_A(p) − v_E(p + g n) + g ṅ in the plane ⟂ n, so N and n_γ stay exact.

    Example:
        >>> point, along, across, up = [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]
        >>> edges = osc.EdgeOnEdge(point, along, point, across, edge_outward=up)
        >>> print(edges.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.02]))).round(6))
        [0.02]
    """

    point: Point
    """a point of the object's edge [x, y, z] in the object frame"""
    direction: Direction
    """along the object's edge [x, y, z] in the object frame"""
    edge_point: BodyPoint
    """a point of the body's edge [x, y, z] in the body frame"""
    edge_direction: BodyDirection
    """along the body's edge [x, y, z] in the body frame"""
    edge_outward: Outward
    """roughly out of the body at its edge [x, y, z] in the body frame; its component along
    direction × edge_direction decides. In Python also +1 or −1 times that"""
    name: str = "edge_on_edge"
    pushes = True

    def _make(self) -> None:
        out = self.edge_outward
        if np.ndim(out) > 0:
            out = unit_vector(f"{self.name}.edge_outward", out)
        elif out not in (1, -1):
            raise InvalidInputError(
                f"{self.name}.edge_outward = {out}; give +1 or −1 (times e_A × e_E), or a vector "
                "that points out of the environment, towards the object"
            )
        side = (0.0, out) if np.ndim(out) else (out, np.zeros(3))
        lines = (self.point, self.direction, self.edge_point, self.edge_direction)
        self._hold(self.edge_point, EDGES, (shape(*lines, *side),))

    def _gaps(self, X_EA: SE3) -> Array:
        """(1,) distance between the two lines (m), negative when they have passed each other."""
        n = self.contact(X_EA, _AT_REST).N[:3, 0]
        return np.array([n @ (self.edge_point - X_EA.act(self.point))])
