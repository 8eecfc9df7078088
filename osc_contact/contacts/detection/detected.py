"""One contact found between two shapes, and the contact pair that models it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.contacts.detection.features import Feature
from osc_contact.contacts.detection.round_gaps import (
    between_round,
    face_on_edge,
    face_on_rim,
    rim_on_face,
)
from osc_contact.contacts.pairs import (
    ContactPair,
    CylinderOnPlane,
    EdgeOnEdge,
    EdgeOnFace,
    FaceOnFace,
    FaceOnVertex,
    SphereOnPlane,
    VertexOnFace,
)
from osc_contact.errors import ContactError
from osc_contact.spatial import Array, cross

__all__ = ["Detected"]


@dataclass(frozen=True, eq=False)
class Detected:
    """What touches what, where, and as what.

    Attributes:
        object_shape, environment_shape: names of the two shapes.
        kind: "<object's feature> on <environment's feature>", such as "vertex on face", "face on
            vertex", "edge on edge", "edge on face", "face on edge", "face on face"; rounded
            features are "sphere on plane", "cylinder on plane", "rim on face", ...
        r: degree of motion constraint, 1 … 3.
        points: (k, 3) world, the contact patch on the environment: its corners (r = 3), its two
            ends (r = 2) or the one point (r = 1) (m).
        normal, object_normal, environment_normal: (3,) unit, out of the environment towards the
            object: in the world's axes and in those of the two bodies.
        distance: between the shapes (m), negative when they overlap.
        object_feature, environment_feature: what touches, each in the frame of its body.
        object_point, environment_point: (3,) a point of each feature in the middle of the patch,
            in the frame of its body (m); of a rounded feature its centre.
    """

    object_shape: str
    environment_shape: str
    kind: str
    r: int
    points: Array
    normal: Array
    distance: float
    object_feature: Feature
    environment_feature: Feature
    object_point: Array
    environment_point: Array
    object_normal: Array
    environment_normal: Array

    @property
    def name(self) -> str:
        """Of the contact: "<object's shape> on <environment's shape>"."""
        return f"{self.object_shape} on {self.environment_shape}"

    def pair(self) -> ContactPair:
        """The contact pair that keeps this contact while both bodies move.

        The feet of a line are the ends of its patch, those of a face lie as far out as the patch.

        Raises:
            ContactError: no pair describes it: the rim of a cylinder on an edge, or two parallel
                lines of which neither is on a face.
        """
        if self.environment_feature.normal is not None:
            return self._on_face(self.environment_feature.normal)
        if self.object_feature.normal is not None:
            return self._under_face(self.object_feature.normal)
        return self._of_lines()

    def _on_face(self, normal: Array) -> ContactPair:
        a, point, face, name = (
            self.object_feature, self.object_point, self.environment_point, self.name,
        )  # fmt: skip
        if a.axis is not None:
            return rim_on_face(a, face, normal, _sine(a.axis, self.object_normal), name)
        if a.normal is not None:
            size = float(np.linalg.norm(self.points - self.points.mean(axis=0), axis=1).max())
            return FaceOnFace(point, a.normal, face, normal, size, name)
        if a.dimension == 1:
            length = float(np.linalg.norm(self.points[1] - self.points[0]))
            if a.radius > 0.0:
                return CylinderOnPlane(point, a.direction, a.radius, face, normal, length, name)
            return EdgeOnFace(point, a.direction, face, normal, length, name)
        if a.radius > 0.0:
            return SphereOnPlane(point, a.radius, face, normal, name)
        return VertexOnFace(point, face, normal, 0.0, name)

    def _under_face(self, normal: Array) -> ContactPair:
        e, face, name = self.environment_feature, self.object_point, self.name
        if e.axis is not None:
            return face_on_rim(face, normal, e, _sine(e.axis, self.environment_normal), name)
        if e.dimension == 1:
            return face_on_edge(face, normal, e.points, e.radius, name)
        return FaceOnVertex(face, normal, self.environment_point, e.radius, name)

    def _of_lines(self) -> ContactPair:
        a, e = self.object_feature, self.environment_feature
        if self.r > 1:
            raise ContactError(
                f"{self.name}: no contact pair describes {self.kind} along a line; declare it with "
                "GapFunctions"
            )
        if a.radius > 0.0 or e.radius > 0.0 or a.dimension + e.dimension < 2:
            return between_round(a, e, self.name)
        return EdgeOnEdge(
            self.object_point, a.direction, self.environment_point, e.direction,
            self.environment_normal, self.name,
        )  # fmt: skip


def _sine(x: Array, y: Array) -> float:
    return float(np.linalg.norm(cross(x, y)))
