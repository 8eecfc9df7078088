"""Detection: what is near comes from coal, the exact normal and the features from the shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.detection.detected import Detected
from osc_contact.contacts.detection.features import Feature, foremost
from osc_contact.contacts.detection.merge import merged
from osc_contact.contacts.detection.normals import best_direction, exact_normal, separation
from osc_contact.contacts.detection.patch import shared_patch
from osc_contact.contacts.detection.shapes import CollisionShape, Solid
from osc_contact.contacts.detection.solver import Nearest, nearest
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["detect"]

_EXACT = 1e-9
"""A plane face that explains the distance this well is the contact's; else it is round (m)."""


def detect(
    object_geometry: Sequence[CollisionShape],
    X_WO: pin.SE3,
    environment_geometry: Sequence[CollisionShape],
    X_WE: pin.SE3 | None = None,
    *,
    margin: float = 1e-3,
    angle: float = 1e-3,
) -> list[Detected]:
    """The contacts between the held object and one body of the environment.

    Every pair of convex shapes gives at most one contact; contacts that add nothing to another
    are merged into it. Overlaps count as contact, however deep; the normal is the direction in
    which the shapes come apart soonest. Contacts at different places are all listed, even where
    together they are dependent.

    Args:
        object_geometry, environment_geometry: shapes of the two bodies.
        X_WO, X_WE: poses of the two bodies (default of X_WE: the world's frame).
        margin: shapes nearer than this touch; patches narrower are lines or points (m).
        angle: faces and edges inclined by less touch all over (rad).

    Raises:
        InvalidInputError: margin or angle out of range.
    """
    if not (np.isfinite(margin) and margin > 0.0):
        raise InvalidInputError(f"margin = {margin}; give a length > 0 m")
    if not 0.0 < angle < 0.1:
        raise InvalidInputError(f"angle = {angle}; give an angle between 0 and 0.1 rad")
    X_WE = pin.SE3.Identity() if X_WE is None else X_WE
    placed = [(e, e.solid.moved(X_WE), X_WE * e.placement) for e in environment_geometry]
    contacts = []
    for a in object_geometry:
        solid, X_A = a.solid.moved(X_WO), X_WO * a.placement
        for e, solid_e, X_E in placed:
            near = nearest(a.shape, X_A, e.shape, X_E)
            if near.distance > margin:
                continue
            n = best_direction(solid, solid_e)
            round_one = solid.radius + solid_e.radius > 0.0
            if round_one and separation(solid, solid_e, n) < near.distance - _EXACT:
                n = best_direction(solid, solid_e, near.normal)
            contact = _classified(a, solid, X_WO, e, solid_e, X_WE, n, near, margin, angle)
            if contact is not None:
                contacts.append(contact)
    return merged(contacts, object_geometry, X_WO, margin, angle)


def _classified(
    a: CollisionShape,
    solid_a: Solid,
    X_WO: pin.SE3,
    e: CollisionShape,
    solid_e: Solid,
    X_WE: pin.SE3,
    n: Array,
    near: Nearest,
    margin: float,
    angle: float,
) -> Detected | None:
    """The contact of two shapes; None where they turn out to be apart after all."""
    f_a, f_e = foremost(solid_a, -n, margin, angle), foremost(solid_e, n, margin, angle)
    distance = separation(solid_a, solid_e, n)
    n = exact_normal(f_a, f_e, n, angle)
    distance = max(distance, separation(solid_a, solid_e, n))
    if distance > margin:
        return None
    patch = shared_patch(f_a, f_e, n, near.witness, margin, angle)
    if f_e.normal is not None:
        f_a = f_a.lowered(_lifted(f_a, patch, n))
    elif f_a.normal is not None:
        f_e = f_e.lowered(_lifted(f_e, patch, n))
    middle = patch.mean(axis=0)
    return Detected(
        object_shape=a.name,
        environment_shape=e.name,
        kind=_kind(f_a, f_e),
        r=min(len(patch), 3),
        points=_lifted(f_e, patch, n) + f_e.radius * n,
        normal=n,
        distance=distance,
        object_feature=f_a.moved(X_WO.inverse()),
        environment_feature=f_e.moved(X_WE.inverse()),
        object_point=X_WO.actInv(f_a.lift(middle, n)),
        environment_point=X_WE.actInv(f_e.lift(middle, n)),
        object_normal=X_WO.rotation.T @ n,
        environment_normal=X_WE.rotation.T @ n,
    )


def _kind(a: Feature, e: Feature) -> str:
    """As the field calls it: a face under something round is a plane."""
    name_a, name_e = a.name, e.name
    if name_e == "face" and a.radius > 0.0:
        name_e = "plane"
    if name_a == "face" and e.radius > 0.0:
        name_a = "plane"
    return f"{name_a} on {name_e}"


def _lifted(feature: Feature, patch: Array, n: Array) -> Array:
    return np.array([feature.lift(point, n) for point in patch])
