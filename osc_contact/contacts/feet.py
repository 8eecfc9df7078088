"""Contacts of an object together: contact of each force magnitude, and points of application."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import ContactPair, count_forces
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.spatial import Array, Poses, cross


def contact_at(pairs: Sequence[ContactPair], X_WO: pin.SE3) -> Contact:
    """Contact of all pairs together, for an object at rest at the pose X_WO."""
    return Contact.stack([pair.contact(X_WO, np.zeros(6)) for pair in pairs])


def force_owners(pairs: Sequence[ContactPair]) -> NDArray[np.intp]:
    """Index (r,) of the contact that each contact force α_k belongs to."""
    return np.repeat(np.arange(len(pairs)), [count_forces(pair) for pair in pairs])


def feet(pair: ContactPair, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> tuple[Array, Array]:
    """Compute the points at which the lines of force meet the touched surface, for drawings.

    Args:
        pair: pair of the contact.
        X_WO: pose of the object.
        X_WE: pose of the touched body; None: its frame is the world's.

    Returns:
        Points (r, 3) in the world (m), and unit directions (r, 3) into the environment, in world
        axes. A couple is at O, with the direction of its axis.
    """
    E = None if X_WE is None else Poses(X_WE.rotation[:, :, None], X_WE.translation[:, None])
    O = Poses(X_WO.rotation[:, :, None], X_WO.translation[:, None])  # noqa: E741
    points, directions = feet_over(pair, normals_over(pair, O, E), O, E)
    return (points[:, :, 0].T, directions[:, :, 0].T)


def feet_over(
    pair: ContactPair, N: Array, X_WO: Poses, X_WE: Poses | None = None
) -> tuple[Array, Array]:
    """Compute points and directions of `feet` at k instants, (3, r, k) each.

    Args:
        pair: pair of the contact.
        N: (6, r, k) columns of the pair at O, world axes.
        X_WO: k poses of the object.
        X_WE: k poses of the touched body; None: its frame is the world's.
    """
    force = np.linalg.norm(N[:3], axis=0)
    size = np.where(force > 0.0, force, np.linalg.norm(N[3:], axis=0))  # zero force: a couple
    directions = N[:3] / size
    moments = N[3:] / size
    points = X_WO.p[:, None] + cross(directions, moments)  # on each line, nearest to O
    surface = getattr(pair, "surface_point", None)
    if isinstance(pair, SphereOnSurface):
        points = pair.feet(X_WO, X_WE)
    elif surface is not None:
        surface = surface[:, None] if X_WE is None else X_WE.act(surface[:, None])
        height = (directions * (surface - X_WO.p)[:, None]).sum(axis=0)  # of the surface above O
        points = points + (height - getattr(pair, "surface_radius", 0.0)) * directions
    return (points, np.where(force > 0.0, directions, moments))
