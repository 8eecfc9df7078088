"""Protocol of contact pairs, properties of a pair, and the two bodies at one instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeGuard, runtime_checkable

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.spatial import Array, carry_twist, cross, norm

_WORLD = SE3.Identity()
AT_REST = np.zeros(6)  #: twist of a body at rest


@runtime_checkable
class ContactPair(Protocol):
    """Contact of a feature of the held object A with a feature of the environment body E.

    `gaps` are the r signed errors that the contact keeps at zero; each decreases as the object
    moves along its column of N: d gaps/dt = −NᵀV_rel. n_γ is the Nᵀa_rel that keeps them at zero.

    A pair may have further attributes; the default is in brackets:

    * pushes: True if every magnitude is a force that must not become negative (False);
    * axes_are_chosen: True if the directions of its columns are one of several choices that span
      the same space, so that turned geometry may lead to another choice (False: N turns with both
      bodies);
    * points_of_contact(X_WO, X_WE): points of application (3, r) of the magnitudes of a pair that
      pushes, world (m), at which it slides with friction (None: friction is unknown);
    * surface_point: (3,) a point of the environment's feature, in its frame (m), and
      surface_radius: the radius of a round feature (m). Contact points are drawn where the lines
      of force come nearest to it (O; 0);
    * row(): its `PairRow` for the compiled law (None: Python evaluates the pair between the parts
      of each tick).

    Example:
        >>> pair: osc.ContactPair = osc.VertexOnFace([0, 0, 0], [0, 0, 0.5], [0, 0, 1])
        >>> contact = pair.contact(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5])), np.zeros(6))
        >>> print(contact.N.T + 0.0, pair.gaps(pin.SE3.Identity()))
        [[ 0.  0. -1.  0.  0.  0.]] [-0.5]
    """

    @property
    def name(self) -> str:
        """Name in messages and recordings."""

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
            X_WE: pose of the environment body; None: the world frame.
            V_E: (6,) its twist at its own origin, world axes; None: at rest. Without X_WE this
                origin is the world's.
        """

    def gaps(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """Signed errors (r,) (m, or rad where the column of N is a couple), 0 in contact."""


def count_forces(pair: ContactPair) -> int:
    """Number r of the force magnitudes of a pair, one for each of its gaps."""
    if (row := getattr(pair, "row", None)) is None:
        return len(pair.gaps(SE3.Identity()))
    law_row = row()  # valid in every pose; gaps of parallel edges do not exist
    return len(law_row.shapes) - int(law_row.freedoms)


def pushes_only(pair: ContactPair) -> bool:
    """Whether every magnitude of the pair is a force that must not become negative.

    Magnitudes of pairs defined by T (hinges, holes, grooves) and of gap functions have either sign.
    """
    return bool(getattr(pair, "pushes", False))


def presses_flat(pair: ContactPair) -> bool:
    """Whether several magnitudes of the pair push in one direction, as those of a face or an edge.

    Args:
        pair: any contact pair.
    """
    into = getattr(pair, "into", None)
    if into is None or not pushes_only(pair) or into.shape[1] < 2:
        return False
    return bool(np.all(into == into[:, :1]))


def axes_are_chosen(pair: ContactPair) -> bool:
    """Whether the columns of N are one of several choices with the same span.

    Then two pairs with the same geometry, given in axes that are turned relative to each other, may
    have different columns with the same span, and magnitudes along different directions.
    """
    return bool(getattr(pair, "axes_are_chosen", False))


def has_place(pair: ContactPair) -> bool:
    """Whether the points at which a pair touches are known."""
    return getattr(pair, "surface_point", None) is not None


class SlidingPair(ContactPair, Protocol):
    """Contact pair that pushes at known points."""

    def points_of_contact(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """Points (3, r) at which the magnitudes of force act, in world axes (m).

        Args:
            X_WO: pose of the object.
            X_WE: pose of the touched body; None: that of the world.
        """


def has_known_points(pair: ContactPair) -> TypeGuard[SlidingPair]:
    """True if the points at which the pair pushes are known, so that its friction can be computed.

    Forces of either sign (hinges, holes, grooves) act at unknown points within the play of a joint.

    Args:
        pair: any contact pair.
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
        """Bodies from the arguments of `ContactPair.contact`, with E's twist carried to O.

        Args:
            X_WO: pose of the object.
            V_O: (6,) its twist at O, world axes (m/s, rad/s).
            X_WE: pose of the environment body; None: the world frame.
            V_E: (6,) its twist at its own origin, world axes; None: at rest.
        """
        X_E = X_WE or _WORLD
        V = AT_REST if V_E is None else carry_twist(V_E, X_E.translation, X_WO.translation)
        return cls(X_WO, X_E, V_O, V)

    @property
    def V_rel(self) -> Array:
        """Twist (6,) of A relative to E, at O, world axes."""
        return self.V_A - self.V_E


def triad(z: Array) -> Array:
    """Right-handed axes (3, 3) whose third column is the unit vector z, a function of z alone.

    The first column is horizontal unless z is ±y.
    """
    x = cross(np.array([0.0, 1.0, 0.0]), z)
    if norm(x) < 1e-3:
        x = cross(np.array([0.0, 0.0, 1.0]), z)
    x = x / norm(x)
    return np.column_stack((x, cross(z, x), z))
