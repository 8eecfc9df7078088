"""Gap functions of the contacts without a pair: rims, balls at edges, and others.

Each function here takes the pose of the object in the environment frame.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.contacts.detection.features import Feature
from osc_contact.contacts.pairs import GapFunctions
from osc_contact.errors import ContactError
from osc_contact.spatial import Array, cross

__all__ = ["between_round", "face_on_edge", "face_on_rim", "rim_on_face"]

_STEP = 0.02
"""Of the differences, relative to the inclination of a rim: at zero inclination lies a kink."""


def face_on_edge(
    point: Array, normal: Array, edge: Array, radius: float, name: str
) -> GapFunctions:
    """A plane of the object (its frame) on two points (2, 3) of a line of the environment, r = 2.

    gⱼ = n·(eⱼ − p) − radius with n out of the object.

    Args:
        point, normal: (3,) of the plane, in the object's frame. edge: (2, 3) points (m).
        radius: of the line (m). name: of the pair.
    """

    def gap(X: pin.SE3) -> Array:
        gaps: Array = (edge - X.act(point)) @ (X.rotation @ normal) - radius
        return gaps

    return GapFunctions(gap, length=float(np.linalg.norm(edge[1] - edge[0])), name=name)


def rim_on_face(rim: Feature, point: Array, normal: Array, sine: float, name: str) -> GapFunctions:
    """The rim of a disc of the object on a plane of the environment, r = 1; rolling is free.

    g = n·(c − p) − R |n × a|: the disc with centre c and axis a reaches R sin∠(n, a) down.
    `sine` is that sine at the contact, for the step of the differences.

    Args:
        rim: of the object, in its frame. point, normal: (3,) of the plane. sine: of ∠(n, a).
        name: of the pair.
    """
    centre, axis, radius = rim.disc

    def gap(X: pin.SE3) -> Array:
        reach = radius * np.linalg.norm(cross(normal, X.rotation @ axis))
        return np.array([normal @ (X.act(centre) - point) - reach])

    return GapFunctions(gap, length=radius, step=min(1e-2, _STEP * sine), name=name)


def face_on_rim(point: Array, normal: Array, rim: Feature, sine: float, name: str) -> GapFunctions:
    """A plane of the object on the rim of a disc of the environment, r = 1; see rim_on_face.

    Args:
        point, normal: (3,) of the plane, in the object's frame. rim: of the environment.
        sine: of ∠(n, a). name: of the pair.
    """
    centre, axis, radius = rim.disc

    def gap(X: pin.SE3) -> Array:
        n = X.rotation @ normal
        return np.array([n @ (centre - X.act(point)) - radius * np.linalg.norm(cross(n, axis))])

    return GapFunctions(gap, length=radius, step=min(1e-2, _STEP * sine), name=name)


def between_round(a: Feature, e: Feature, name: str) -> GapFunctions:
    """Points or straight lines, at least one with a radius: g = their distance − both radii, r = 1.

    Args:
        a, e: features of object and environment, with their radii (m). name: of the pair.

    Raises:
        ContactError: a rim is one of the two.
    """
    if "rim" in (a.name, e.name):
        raise ContactError(
            f"{name}: no contact pair describes the rim of a cylinder on anything but a face; "
            "declare it with GapFunctions"
        )
    reach = a.radius + e.radius

    def gap(X: pin.SE3) -> Array:
        apart = X.act(a.points[0]) - e.points[0]
        lines = [e.direction] if e.dimension == 1 else []
        if a.dimension == 1:
            lines.append(X.rotation @ a.direction)
        if len(lines) == 2:
            across = cross(lines[0], lines[1])
            return np.array([abs(across @ apart) / np.linalg.norm(across) - reach])
        for along in lines:
            apart = apart - (apart @ along) * along
        return np.array([np.linalg.norm(apart) - reach])

    return GapFunctions(gap, length=reach, name=name)
