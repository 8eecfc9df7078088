"""Contacts found twice: those that constrain nothing another contact does not, and buried ones."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from osc_contact.contacts.detection.detected import Detected
from osc_contact.contacts.detection.shapes import CollisionShape
from osc_contact.spatial import Array, cross

__all__ = ["merged"]

_BURIED = 1e-6
"""How far outside another shape of its body a point may lie and still count as inside (m)."""


def merged(
    contacts: Sequence[Detected],
    object_geometry: Sequence[CollisionShape],
    X_WO: pin.SE3,
    margin: float,
    angle: float,
) -> list[Detected]:
    """`contacts` without those that repeat another: faces stay first, then lines, then points.

    A contact repeats another of the same tangent plane if its patch lies on the other's plane,
    line or point, or if it touches with a part of the object's shape that is inside the other's
    shape (the rim of a cylinder inside the ball that rounds its end). Among points the rounded
    stays, then the nearer.

    Args:
        contacts: all contacts. object_geometry: shapes of the object. X_WO: its pose.
        margin: heights that count as equal (m). angle: directions that count as equal (rad).
    """
    shapes = {shape.name: shape for shape in object_geometry}
    kept: list[Detected] = []
    for contact in sorted(contacts, key=_rank):
        if not any(
            _same_plane(contact, other, margin, angle)
            and (
                _spanned(contact.points, other, margin)
                or _buried(contact, shapes[other.object_shape], X_WO)
            )
            for other in kept
        ):
            kept.append(contact)
    return [contact for contact in contacts if any(contact is other for other in kept)]


def _rank(contact: Detected) -> tuple[int, bool, float]:
    return -contact.r, contact.object_feature.radius == 0.0, contact.distance


def _same_plane(a: Detected, b: Detected, margin: float, angle: float) -> bool:
    inclined = float(np.linalg.norm(cross(a.normal, b.normal)))
    if inclined > angle or a.normal @ b.normal < 0.0:
        return False
    return bool(np.abs((a.points - b.points[0]) @ b.normal).max() <= margin)


def _spanned(points: Array, other: Detected, margin: float) -> bool:
    """Whether points of its tangent plane lie on the plane, line or point of the other's patch."""
    away = points - other.points[0]
    if other.r == 3:
        return True
    if other.r == 2:
        along = other.points[-1] - other.points[0]
        along = along / np.linalg.norm(along)
        away = away - np.outer(away @ along, along)
    return bool(np.linalg.norm(away, axis=1).max() <= margin)


def _buried(contact: Detected, shape: CollisionShape, X_WO: pin.SE3) -> bool:
    """Whether the touching part of the object lies inside another of its shapes."""
    if contact.object_shape == shape.name or contact.r > 1:
        return False
    surface = X_WO.act(contact.object_point) - contact.object_feature.radius * contact.normal
    X = X_WO * shape.placement
    depth = coal.distance(
        coal.Sphere(0.0), coal.Transform3s(np.eye(3), surface),
        shape.shape, coal.Transform3s(X.rotation, X.translation),
        coal.DistanceRequest(), coal.DistanceResult(),
    )  # fmt: skip
    return bool(depth <= _BURIED)
