"""The patch two features share, seen along the contact normal: point, line piece or polygon."""

from __future__ import annotations

import numpy as np

from osc_contact.contacts.detection.features import Feature, plane_axes
from osc_contact.spatial import Array

__all__ = ["shared_patch"]


def shared_patch(
    a: Feature, e: Feature, n: Array, witness: Array, width: float, angle: float
) -> Array:
    """(k, 3) points of the patch that features a and e share along the unit normal n.

    A patch narrower than `width` counts as a line (k = 2), a line shorter as a point (k = 1).
    Heights along n mean nothing here. `witness` (3,) stands in where, a little apart, the two do
    not overlap at all.

    Args:
        a, e: features of object and environment. n: (3,) unit vector. witness: (3,) point (m).
        width: m. angle: tolerance (rad).
    """
    axes = plane_axes(n)
    flat_a, flat_e = a.points @ axes.T, e.points @ axes.T
    if a.dimension == 0:
        points = flat_a
    elif e.dimension == 0:
        points = flat_e
    elif a.dimension == e.dimension == 1:
        points = _of_lines(flat_a, flat_e, angle)
    elif e.dimension == 2:
        points = _clip(flat_a, flat_e)
    else:
        points = _clip(flat_e, flat_a)
    if len(points) == 0:
        points = axes @ witness[:, None]
        points = points.T
    reduced: Array = _reduced(points, width) @ axes
    return reduced


def _of_lines(a: Array, e: Array, angle: float) -> Array:
    """Where two line pieces cross, or the piece in which two parallel ones run side by side."""
    along_a, along_e = a[1] - a[0], e[1] - e[0]
    lengths = np.linalg.norm(along_a), np.linalg.norm(along_e)
    sine = (along_a[0] * along_e[1] - along_a[1] * along_e[0]) / (lengths[0] * lengths[1])
    if abs(sine) > angle:
        s, _ = np.linalg.solve(np.column_stack((along_a, -along_e)), e[0] - a[0])
        return (a[0] + np.clip(s, 0.0, 1.0) * along_a)[None, :]
    where = np.clip((e - a[0]) @ along_a / lengths[0] ** 2, 0.0, 1.0)
    return a[0] + np.outer((where.min(), where.max()), along_a)


def _clip(subject: Array, window: Array) -> Array:
    """The part of a convex polygon or line piece inside a convex polygon (Sutherland-Hodgman)."""
    if _area(window) < 0.0:
        window = window[::-1]
    points = [np.asarray(p) for p in subject]
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        inward = np.array((start[1] - end[1], end[0] - start[0]))
        depth = [float(inward @ (p - start)) for p in points]
        kept = []
        for i, (p, h) in enumerate(zip(points, depth, strict=True)):
            previous, before = points[i - 1], depth[i - 1]
            if (h < 0.0) != (before < 0.0):
                kept.append(previous + (p - previous) * (before / (before - h)))
            if h >= 0.0:
                kept.append(p)
        points = kept
    return np.array(points).reshape(-1, 2)


def _area(polygon: Array) -> float:
    x, y = polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _reduced(points: Array, width: float) -> Array:
    """The points themselves, the two ends of what is but a line, or the middle of what is less."""
    if len(points) == 1:
        return points
    middle = points.mean(axis=0)
    directions = np.linalg.svd(points - middle)[2]
    along, across = (points - middle) @ directions.T[:, 0], (points - middle) @ directions.T[:, 1]
    if np.ptp(along) <= width:
        return middle[None, :]
    if np.ptp(across) <= width:
        return middle + np.outer((along.min(), along.max()), directions[0])
    return points
