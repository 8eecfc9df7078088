"""All contacts of an object together: which force belongs to which, and where each of them acts."""

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
    """All contacts of an object at rest at X_WO."""
    return Contact.stack([pair.contact(X_WO, np.zeros(6)) for pair in pairs])


def force_owners(pairs: Sequence[ContactPair]) -> NDArray[np.intp]:
    """(r,) the contact of each force magnitude."""
    return np.repeat(np.arange(len(pairs)), [count_forces(pair) for pair in pairs])


def feet(pair: ContactPair, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> tuple[Array, Array]:
    """Where the lines of force meet the touched surface (r, 3), and their directions (r, 3).

    World axes, directions into the environment. A couple acts at O, about its direction.

    Args:
        pair: of the contact. X_WO, X_WE: poses of object and body; None: the world's.
    """
    E = None if X_WE is None else Poses(X_WE.rotation[:, :, None], X_WE.translation[:, None])
    O = Poses(X_WO.rotation[:, :, None], X_WO.translation[:, None])  # noqa: E741
    points, directions = feet_over(pair, normals_over(pair, O, E), O, E)
    return (points[:, :, 0].T, directions[:, :, 0].T)


def feet_over(
    pair: ContactPair, N: Array, X_WO: Poses, X_WE: Poses | None = None
) -> tuple[Array, Array]:
    """The same (3, r, k) each at k instants, given the pair's N (6, r, k) there.

    Args:
        pair: of the contact. N: (6, r, k) at O. X_WO, X_WE: k poses of object and body.
    """
    force = np.linalg.norm(N[:3], axis=0)
    size = np.where(force > 0.0, force, np.linalg.norm(N[3:], axis=0))  # else: a couple
    directions = N[:3] / size
    moments = N[3:] / size
    points = X_WO.p[:, None] + cross(directions, moments)
    surface = getattr(pair, "surface_point", None)
    if isinstance(pair, SphereOnSurface):
        points = pair.feet(X_WO, X_WE)
    elif surface is not None:
        surface = surface[:, None] if X_WE is None else X_WE.act(surface[:, None])
        height = (directions * (surface - X_WO.p)[:, None]).sum(axis=0)  # along each line, from O
        points = points + (height - getattr(pair, "surface_radius", 0.0)) * directions
    return (points, np.where(force > 0.0, directions, moments))
