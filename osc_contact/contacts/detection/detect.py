"""From collision geometry to the list of contacts, at one pose or followed over time."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.detection.features import (
    CollisionShape,
    Feature,
    best_direction,
    exact_normal,
    foremost,
    nearest,
    separation,
    shared_patch,
)
from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.functions import GapFunctions
from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.pairs.points_on_planes import CylinderOnPlane, FaceOnFace, SphereOnPlane
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.contacts.pairs.vertex_and_edge import EdgeOnEdge, FaceOnVertex
from osc_contact.contacts.surface import Surface
from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.spatial import Array, cross, norm

# --- Gaps between faces, edges and rims -----------------------------------------------------------
#
# Each function here takes the pose of the object in the environment frame.

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

    def gap(X: SE3) -> Array:
        return (edge - X.act(point)) @ (X.rotation @ normal) - radius

    return GapFunctions(gap, length=norm(edge[1] - edge[0]), name=name)


def rim_on_face(
    rim: Feature, point: Array, normal: Array, n: Array, name: str, turned: bool = False
) -> GapFunctions:
    """The rim of a disc of the object on a plane of the environment, r = 1; rolling is free.

    g = n·(c − p) − R |n × a|: the disc with centre c and axis a reaches R sin∠(n, a) down.

    Args:
        rim: of the object, in its frame. point, normal: (3,) of the plane.
        n: (3,) normal at the contact, in the rim's frame: ∠(n, a) sets the step of the differences.
        name: of the pair. turned: the plane is the object's, the rim the environment's.
    """
    centre: Any = rim.centre
    axis: Any = rim.axis
    radius = norm(rim.points[0] - centre)
    step = min(1e-2, _STEP * norm(cross(axis, n)))

    def gap(X: SE3) -> Array:
        X = X.inverse() if turned else X
        reach = radius * norm(cross(normal, X.rotation @ axis))
        return np.array([normal @ (X.act(centre) - point) - reach])

    return GapFunctions(gap, length=radius, step=step, name=name)


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

    def gap(X: SE3) -> Array:
        apart = X.act(a.points[0]) - e.points[0]
        lines = [e.direction] if e.dimension == 1 else []
        if a.dimension == 1:
            lines.append(X.rotation @ a.direction)
        if len(lines) == 2:
            across = cross(*lines)
            return np.array([abs(across @ apart) / norm(across) - reach])
        for along in lines:
            apart = apart - (apart @ along) * along
        return np.array([norm(apart) - reach])

    return GapFunctions(gap, length=reach, name=name)


# --- One contact found ----------------------------------------------------------------------------


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
        Vertices and edges on faces are spheres and cylinders without a radius.

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
        a = self.object_feature
        point = self.object_point
        face = self.environment_point
        name = self.name
        if a.axis is not None:
            return rim_on_face(a, face, normal, self.object_normal, name)
        if a.normal is not None:
            size = float(np.linalg.norm(self.points - self.points.mean(axis=0), axis=1).max())
            return FaceOnFace(point, a.normal, face, normal, size, name)
        if a.dimension == 1:
            length = norm(self.points[1] - self.points[0])
            return CylinderOnPlane(point, a.direction, a.radius, face, normal, length, name)
        return SphereOnPlane(point, a.radius, face, normal, name)

    def _under_face(self, normal: Array) -> ContactPair:
        e = self.environment_feature
        face = self.object_point
        name = self.name
        if e.axis is not None:
            return rim_on_face(e, face, normal, self.environment_normal, name, turned=True)
        if e.dimension == 1:
            return face_on_edge(face, normal, e.points, e.radius, name)
        return FaceOnVertex(face, normal, self.environment_point, e.radius, name)

    def _of_lines(self) -> ContactPair:
        a = self.object_feature
        e = self.environment_feature
        if self.r > 1:
            raise ContactError(
                f"{self.name}: no contact pair describes {self.kind} along a line; declare it with "
                "GapFunctions"
            )
        if a.name in ("vertex", "sphere") and e.name in ("sphere", "cylinder"):
            surface = Surface.cylinder if e.dimension else Surface.sphere
            along, _, axis = triad(e.direction if e.dimension else self.environment_normal).T
            place = (e.points[0], axis, along)
            return SphereOnSurface(a.points[0], a.radius, surface(e.radius), *place, self.name)
        if a.radius > 0.0 or e.radius > 0.0 or a.dimension + e.dimension < 2:
            return between_round(a, e, self.name)
        return EdgeOnEdge(
            self.object_point,
            a.direction,
            self.environment_point,
            e.direction,
            self.environment_normal,
            self.name,
        )


# --- Contacts of one pair that are one ------------------------------------------------------------

_BURIED = 1e-6
"""How far outside another shape of its body a point may lie and still count as inside (m)."""


def merged(
    contacts: Sequence[Detected],
    object_geometry: Sequence[CollisionShape],
    X_WO: SE3,
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
    ranked = sorted(contacts, key=lambda c: (-c.r, c.object_feature.radius == 0.0, c.distance))
    for contact in ranked:
        if not any(
            _same_plane(contact, other, margin, angle)
            and (
                _spanned(contact.points, other, margin)
                or _buried(contact, shapes[other.object_shape], X_WO)
            )
            for other in kept
        ):
            kept.append(contact)
    return [contact for contact in contacts if contact in kept]


def _same_plane(a: Detected, b: Detected, margin: float, angle: float) -> bool:
    inclined = norm(cross(a.normal, b.normal))
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
        along = along / norm(along)
        away = away - np.outer(away @ along, along)
    return bool(np.linalg.norm(away, axis=1).max() <= margin)


def _buried(contact: Detected, shape: CollisionShape, X_WO: SE3) -> bool:
    """Whether the touching part of the object lies inside another of its shapes."""
    if contact.object_shape == shape.name or contact.r > 1:
        return False
    surface = X_WO.act(contact.object_point) - contact.object_feature.radius * contact.normal
    point = SE3(np.eye(3), surface)
    return nearest(coal.Sphere(0.0), point, shape.shape, X_WO * shape.placement).distance <= _BURIED


# --- Detection ------------------------------------------------------------------------------------

_EXACT = 1e-9
"""A plane face that explains the distance this well is the contact's; else it is round (m)."""


def detect(
    object_geometry: Sequence[CollisionShape],
    X_WO: SE3,
    environment_geometry: Sequence[CollisionShape],
    X_WE: SE3 | None = None,
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
    X_WE = X_WE or SE3.Identity()
    each = (
        _classified(a, X_WO, e, X_WE, margin, angle)
        for a, e in product(object_geometry, environment_geometry)
    )
    contacts = [contact for contact in each if contact is not None]
    return merged(contacts, object_geometry, X_WO, margin, angle)


def _classified(
    a: CollisionShape, X_WO: SE3, e: CollisionShape, X_WE: SE3, margin: float, angle: float
) -> Detected | None:
    """The contact of two shapes, their bodies at these poses; None where they are apart."""
    near = nearest(a.shape, X_WO * a.placement, e.shape, X_WE * e.placement)
    if near.distance > margin:
        return None
    solid_a = a.solid.moved(X_WO)
    solid_e = e.solid.moved(X_WE)
    n = best_direction(solid_a, solid_e)
    round_one = solid_a.radius + solid_e.radius > 0.0
    if round_one and separation(solid_a, solid_e, n) < near.distance - _EXACT:
        n = best_direction(solid_a, solid_e, near.normal)
    f_a = foremost(solid_a, -n, margin, angle)
    f_e = foremost(solid_e, n, margin, angle)
    distance = separation(solid_a, solid_e, n)
    n = exact_normal(f_a, f_e, n, angle)
    distance = float(max(distance, separation(solid_a, solid_e, n)))
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
    names = (
        "plane" if one.name == "face" and other.radius > 0.0 else one.name
        for one, other in ((a, e), (e, a))
    )
    return " on ".join(names)


def _lifted(feature: Feature, patch: Array, n: Array) -> Array:
    return np.array([feature.lift(point, n) for point in patch])


# --- Contacts followed over time ------------------------------------------------------------------


MARGIN_M = 2e-3  #: of a `TrackedContact`, see `detect`
#: ways after which it detects anew
TRAVEL_M = 2e-3
TURN_RAD = 5e-3


class TrackedContact:
    """Whatever touches between the held object and one body, as a `ContactPair`.

    What touches what is looked up by `detect` when the bodies have moved by more than 2 mm or
    5 mrad relative to one another since the last time. In between, N and n_γ come from the pairs
    found, at the poses and twists of each call. Where nothing is within the margin any more, the
    contacts found last stay in force: geometry does not detect a lost contact.

    Attributes:
        name: used in messages and recordings.
        pairs: in force now; empty before the first call.
        lookups: number of detections.
    """

    def __init__(
        self,
        object_geometry: Sequence[CollisionShape],
        environment_geometry: Sequence[CollisionShape],
        name: str = "detected",
    ) -> None:
        """Take the collision shapes of both bodies, in the frames O and E.

        Args:
            object_geometry, environment_geometry: see `collision_shapes`.
            name: of the contact.
        """
        self.name = name
        self.pairs: tuple[ContactPair, ...] = ()
        self.lookups = 0
        self._shapes = (object_geometry, environment_geometry)
        self._X_EO = SE3.Identity()

    def contact(
        self,
        X_WO: SE3,
        V_O: Array,
        X_WE: SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, r) and n_γ (r,) of all that touches (see `ContactPair.contact`).

        Args:
            X_WO, V_O, X_WE, V_E: as of `ContactPair.contact`.

        Raises:
            ContactError: nothing touches, and nothing ever has.
        """
        pairs = self._touching(X_WO, X_WE)
        parts = [pair.contact(X_WO, V_O, X_WE, V_E) for pair in pairs]
        return parts[0] if len(parts) == 1 else Contact.stack(parts)

    def gaps(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """Gaps of the pairs found, one below the other (m, rad)."""
        return np.concatenate([pair.gaps(X_WO, X_WE) for pair in self._touching(X_WO, X_WE)])

    def _touching(self, X_WO: SE3, X_WE: SE3 | None) -> tuple[ContactPair, ...]:
        X_EO = X_WO if X_WE is None else X_WE.actInv(X_WO)
        moved = self._X_EO.actInv(X_EO)
        far = norm(moved.translation) > TRAVEL_M or norm(pin.log3(moved.rotation)) > TURN_RAD
        if self.pairs and not far:
            return self.pairs
        shapes, bodies = self._shapes
        detected = detect(shapes, X_WO, bodies, X_WE, margin=MARGIN_M)
        self.lookups += 1
        if detected:
            self.pairs = tuple(contact.pair() for contact in detected)
        self._X_EO = X_EO.copy()
        if not self.pairs:
            raise ContactError(
                f"{self.name}: nothing touches within {MARGIN_M * 1e3:g} mm at the pose of the "
                f"object {np.round(X_WO.translation, 4)} m; bring it nearer before engaging"
            )
        return self.pairs
