"""Protocol of every contact pair, its questions, and the two bodies at one instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.spatial import Array, carry_twist, cross, norm

_WORLD = SE3.Identity()
AT_REST = np.zeros(6)  #: twist of a body at rest


@runtime_checkable
class ContactPair(Protocol):
    """A feature of the held object A against a feature of the environment body E.

    `gaps` are the r signed errors that the contact keeps at zero; each shrinks as the object moves
    along its column of N: d gaps/dt = −NᵀV_rel. n_γ is the Nᵀa_rel that keeps them at zero.

    A pair may have more, else the value in brackets counts:

    * pushes: whether every magnitude is a force that must not become negative (False);
    * axes_are_chosen: whether the directions of its columns are one choice of several that span the
      same space, made anew from axes that are turned (False: N turns with both bodies);
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


def axes_are_chosen(pair: ContactPair) -> bool:
    """Whether the columns of N are one choice of several with the same span.

    Two pairs of equal geometry, one given in axes that are turned against those of the other, then
    have columns of equal span that are not equal, and magnitudes of other directions.
    """
    return bool(getattr(pair, "axes_are_chosen", False))


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
        V_O: Array = AT_REST,
        X_WE: SE3 | None = None,
        V_E: Array | None = None,
    ) -> Bodies:
        """The arguments of `ContactPair.contact`, E's twist carried to O.

        Args:
            X_WO, X_WE: poses of object and environment; X_WE None: the world's.
            V_O: (6,) twist of the object at O. V_E: (6,) of the environment at its origin.
        """
        X_E = X_WE or _WORLD
        V = AT_REST if V_E is None else carry_twist(V_E, X_E.translation, X_WO.translation)
        return cls(X_WO, X_E, V_O, V)

    @property
    def V_rel(self) -> Array:
        """(6,) twist of A relative to E, at O."""
        return self.V_A - self.V_E


def triad(z: Array) -> Array:
    """(3, 3) right-handed axes whose third column is the unit vector z; the same z, the same axes.

    The first column is horizontal for every z but ±y.
    """
    x = cross(np.array([0.0, 1.0, 0.0]), z)
    if norm(x) < 1e-3:
        x = cross(np.array([0.0, 0.0, 1.0]), z)
    x = x / norm(x)
    return np.column_stack((x, cross(z, x), z))
