"""What every contact pair offers, and the bookkeeping they share: two bodies seen from O."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar, get_type_hints, runtime_checkable

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.errors import InvalidInputError
from osc_contact.scenarios.bodies import ContactSpec, OfBody, register_contact
from osc_contact.scenarios.quantities import Length, NotNegative, Positive
from osc_contact.spatial import Array, as_array, carry_twist, cross, norm, skew, unit_vector

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
    * row(): what it is to the compiled law, see `law_pair.PairRow` (None: Python evaluates the pair
      between the parts of each tick).
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


def knows_where_it_slides(pair: ContactPair) -> bool:
    """Whether friction at the pair is known: it pushes at known points.

    Forces of either sign (hinges, holes, grooves) act somewhere in a gap.
    """
    return pushes_only(pair) and hasattr(pair, "points_of_contact")


@dataclass(frozen=True, slots=True)
class Bodies:
    """Object A and environment E at one instant: positions from O, motions at O, world axes."""

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
        X_E = _WORLD if X_WE is None else X_WE
        if V_E is not None:
            V_E = carry_twist(V_E, X_E.translation, X_WO.translation)
        return cls(X_WO, X_E, V_O, _AT_REST if V_E is None else V_E)

    @property
    def V_rel(self) -> Array:
        """(6,) twist of A relative to E, at O."""
        return self.V_A - self.V_E

    def rotate_E(self, direction: Array) -> Array:
        """A direction (3,), or columns (3, k), of E in world axes."""
        return self.X_E.rotation @ direction

    def point_A(self, point: Array) -> Array:
        """Points (3,) or (3, k) of A, from O."""
        return self.X_A.rotation @ point

    def point_E(self, point: Array) -> Array:
        """A point (3,) of E, from O."""
        return self.X_E.translation - self.X_A.translation + self.rotate_E(point)


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
        return self._gaps(Bodies.at_O(X_WO, X_WE=X_WE))

    def _contact(self, b: Bodies) -> Contact:
        raise NotImplementedError

    def _gaps(self, b: Bodies) -> Array:
        raise NotImplementedError


def velocity(V: Array, points: Array) -> Array:
    """Velocities of body-fixed points (3,) or (3, k), given from O, of a body with twist V at O."""
    if points.ndim == 1:
        return V[:3] + cross(V[3:], points)
    return V[:3, None] + skew(V[3:]) @ points


def lines_of_force(points: Array, directions: Array) -> Array:
    """W(n, p) = [n; p × n]: unit forces along n through p, (6,) or columns (6, k)."""
    return np.concatenate((directions, cross(points, directions)))


def lines_of_force_rate(points: Array, directions: Array, p_dot: Array, n_dot: Array) -> Array:
    """Ẇ(n, p) = [ṅ; ṗ × n + p × ṅ] with absolute ṗ: the reference point stays where O is now.

    Args:
        points: (3, r) from O (m). directions: (3, r) unit vectors. p_dot, n_dot: (3, r) rates.
    """
    return np.concatenate((n_dot, cross(p_dot, directions) + cross(points, n_dot)))


def triad(z: Array) -> Array:
    """(3, 3) right-handed axes whose third column is the unit vector z; the same z, the same axes.

    The first column is horizontal for every z but ±y.
    """
    x = cross(np.array([0.0, 1.0, 0.0]), z)
    if norm(x) < 1e-3:
        x = cross(np.array([0.0, 0.0, 1.0]), z)
    x = x / norm(x)
    return np.column_stack((x, cross(z, x), z))


def store(pair: Any, **values: Any) -> None:
    """Set attributes of a frozen dataclass while it is being made."""
    for key, value in values.items():
        object.__setattr__(pair, key, value)


#: What a number of a pair's geometry is; `check_geometry` reads it from the field's annotation.
Point = Annotated[Array, "point"]
Direction = Annotated[Array, "direction"]
Radius = Annotated[float, "≥"]
Extent = Annotated[float, ">"]
#: The latter two as keys of a scenario.
RadiusKey = NotNegative[Length]
ExtentKey = Positive[Length]


@cache
def _geometry(pair: Any) -> dict[str, str]:
    """Kind of each field whose annotation states one."""
    hints = get_type_hints(pair, include_extras=True).items()
    return {key: hint.__metadata__[0] for key, hint in hints if hasattr(hint, "__metadata__")}


def check_geometry(pair: Any) -> None:
    """Check the geometry of a frozen pair that is being made; copy points, normalise directions.

    Raises:
        InvalidInputError: wrong shape, not finite, a direction that is zero, a length < 0 (≤ 0).
    """
    made: Any = type(pair)
    for key, kind in _geometry(made).items():
        name = f"{pair.name}.{key}"
        value = getattr(pair, key)
        if kind == "point":
            store(pair, **{key: as_array(name, value, (3,))})
        elif kind == "direction":
            store(pair, **{key: unit_vector(name, value)})
        elif not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and kind == "≥"))):
            raise InvalidInputError(f"{name} = {value}; give a length {kind} 0 m")


# The register of contact pairs: each enters it where it is written, with its keys in YAML.


Pair = TypeVar("Pair", bound=type[Any])

#: Every registered pair by the name of its class.
PAIRS: dict[str, type[ContactPair]] = {}
_MADE_FROM: dict[type[ContactSpec], tuple[Callable[..., ContactPair], dict[str, str]]] = {}


def register_pair(keys: type[ContactSpec] | None = None, **renamed: str) -> Callable[[Pair], Pair]:
    """Class decorator: enter a pair in the register.

    Args:
        keys: keys of such a contact in a scenario. None: it is made in Python only.
        renamed: keys that the class calls otherwise, such as face_point="point".
    """

    def enter(pair: Pair) -> Pair:
        PAIRS[pair.__name__] = pair
        if keys is not None:
            register_contact(keys)
            _MADE_FROM[keys] = pair, renamed
        return pair

    return enter


def make_pair(spec: ContactSpec, X_WB: SE3, folder: Path | None = None) -> ContactPair:
    """The pair that a scenario describes, its environment frame E where the world's is.

    Args:
        spec: of a registered kind. X_WB: pose of the body that the contact is on.
        folder: where files are that it names.
    """
    pair, renamed = _MADE_FROM[type(spec)]
    given: dict[str, Any] = {}
    for key, field in type(spec).model_fields.items():
        value = getattr(spec, key)
        if OfBody.POINT in field.metadata:
            value = X_WB.act(np.array(value))
        elif OfBody.DIRECTION in field.metadata:
            value = X_WB.rotation @ np.array(value)
        elif hasattr(value, "made"):
            value = value.made(folder)
        if key == "face":
            given |= {"point": value.point, "normal": value.normal}
        elif key not in ("type", "body"):
            given[renamed.get(key, key)] = value
    return pair(**given)
