"""Detection of contacts from collision geometry, at one pose or tracked over time."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import coal
import numpy as np
import pinocchio as pin
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.detection.features import (
    CollisionShape,
    Feature,
    Nearest,
    Solid,
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
# The argument of each gap function is the pose of the object in the environment frame.

_STEP = 0.02
"""Step of the differences over the inclination of a rim; the gap has a kink at zero inclination."""


def face_on_edge(
    point: Array, normal: Array, edge: Array, radius: float, name: str
) -> GapFunctions:
    """Pair of a plane of the object on two points of a line of the environment, r = 2.

    gⱼ = n·(eⱼ − p) − radius with n out of the object.

    Args:
        point: (3,) point of the plane in the object's frame (m).
        normal: (3,) outward normal of the plane in the object's frame.
        edge: (2, 3) points of the line in the environment's frame (m).
        radius: radius around the line (m).
        name: name of the pair.
    """

    def gap(X: SE3) -> Array:
        """Gaps (2,) (m) of the two points, at the pose X of the object in the environment."""
        return (edge - X.act(point)) @ (X.rotation @ normal) - radius

    return GapFunctions(gap, length=norm(edge[1] - edge[0]), name=name)


def rim_on_face(
    rim: Feature, point: Array, normal: Array, n: Array, name: str, swapped: bool = False
) -> GapFunctions:
    """Pair of the rim of a disc of the object on a plane of the environment, r = 1.

    g = n·(c − p) − R |n × a|: the disc with centre c, axis a and radius R extends R sin∠(n, a)
    below its centre; p is a point of the plane, n its normal. Rolling is free.

    Args:
        rim: rim in the frame of its body.
        point: (3,) point of the plane in the frame of its body (m).
        normal: (3,) outward normal of the plane in the frame of its body.
        n: (3,) normal at the contact in the rim's frame; ∠(n, a) determines the step of the
            differences.
        name: name of the pair.
        swapped: True if the rim is that of the environment, and the plane that of the object.
    """
    # `_STEP` times the inclination keeps the differences on one side of the kink
    centre = rim.centre
    axis = rim.axis
    assert centre is not None and axis is not None
    radius = norm(rim.points[0] - centre)
    step = min(1e-2, _STEP * norm(cross(axis, n)))

    def gap(X: SE3) -> Array:
        """Gap (1,) (m) at the pose X of the object in the environment."""
        if swapped:  # X is to map from the body of the rim to that of the plane
            X = X.inverse()
        reach = radius * norm(cross(normal, X.rotation @ axis))
        return np.array([normal @ (X.act(centre) - point) - reach])

    return GapFunctions(gap, length=radius, step=step, name=name)


def between_round(a: Feature, e: Feature, name: str) -> GapFunctions:
    """Pair of points or straight lines with radii, with one force along their distance (r = 1).

    The gap (1,) is the distance of the points or lines less both radii (m), such as of two
    cylinders that cross, or of a ball and an edge.

    Args:
        a: feature of the object, a point or a line with a radius.
        e: feature of the environment, a point or a line with a radius.
        name: name of the pair.

    Raises:
        ContactError: one of the features is a rim.
    """
    if "rim" in (a.name, e.name):
        raise ContactError(
            f"{name}: no contact pair describes the rim of a cylinder on anything but a face; "
            "declare it with GapFunctions"
        )
    reach = a.radius + e.radius

    def gap(X: SE3) -> Array:
        """Compute the gap (1,; m): distance of two points or lines, less both radii.

        Two lines are apart along their common normal; of a point and a line the distance vector
        counts across the line, of two points as a whole.

        Args:
            X: pose of the object.
        """
        distance_vector = X.act(a.points[0]) - e.points[0]
        lines = [e.direction] if e.dimension == 1 else []
        if a.dimension == 1:
            lines.append(X.rotation @ a.direction)
        if len(lines) == 2:  # along the common normal
            common_normal = cross(*lines)
            return np.array([abs(common_normal @ distance_vector) / norm(common_normal) - reach])
        for axis in lines:  # across the line, if there is one
            distance_vector = distance_vector - (distance_vector @ axis) * axis
        return np.array([norm(distance_vector) - reach])

    return GapFunctions(gap, length=reach, name=name)


# --- One contact found ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Detected:
    """Detected contact: two shapes, the features that touch, and the contact patch.

    Attributes:
        object_shape, environment_shape: names of the two shapes.
        kind: "<object's feature> on <environment's feature>", such as "vertex on face", "face on
            vertex", "edge on edge", "edge on face", "face on edge", "face on face"; rounded
            features are "sphere on plane", "cylinder on plane", "rim on face", ...
        r: degree of motion constraint, 1 … 3.
        points: (k, 3) contact patch on the environment, world (m): its corners (r = 3), its two
            ends (r = 2) or its point (r = 1).
        normal, object_normal, environment_normal: (3,) unit normal out of the environment towards
            the object, in the axes of the world and of the two bodies.
        distance: distance of the shapes (m), negative in an overlap.
        object_feature, environment_feature: features that touch, each in the frame of its body.
        object_point, environment_point: (3,) point of each feature in the middle of the patch, in
            the frame of its body (m); for a rounded feature its centre.
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
        """Name of the contact: "<object's shape> on <environment's shape>"."""
        return f"{self.object_shape} on {self.environment_shape}"

    def pair(self) -> ContactPair:
        """Contact pair that describes this contact while both bodies move.

        The points of a line are the ends of its patch, those of a face are as far apart as the
        patch is wide. Vertices and edges on faces become spheres and cylinders with radius zero.

        Raises:
            ContactError: no pair describes the contact: the rim of a cylinder on an edge, or two
                parallel lines that are not on a face.
        """
        if self.environment_feature.normal is not None:
            return self._on_face(self.environment_feature.normal)
        if self.object_feature.normal is not None:
            return self._under_face(self.object_feature.normal)
        return self._of_lines()

    def _on_face(self, normal: Array) -> ContactPair:
        """Pair of the object's feature on a face of the environment.

        Args:
            normal: (3,) outward unit normal of the face, in the axes of the environment's body.
        """
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
        """Pair of a face of the object on the environment's feature, which is no face.

        Args:
            normal: (3,) outward unit normal of the face, in the axes of the object.
        """
        e = self.environment_feature
        face = self.object_point
        name = self.name
        if e.axis is not None:
            return rim_on_face(e, face, normal, self.environment_normal, name, swapped=True)
        if e.dimension == 1:
            return face_on_edge(face, normal, e.points, e.radius, name)
        return FaceOnVertex(face, normal, self.environment_point, e.radius, name)

    def _of_lines(self) -> ContactPair:
        """Pair of two features neither of which is a face: points, lines, spheres or cylinders.

        Raises:
            ContactError: the features touch along a line, or one of them is a rim.
        """
        a = self.object_feature
        e = self.environment_feature
        if self.r > 1:
            raise ContactError(
                f"{self.name}: no contact pair describes {self.kind} along a line; declare it with "
                "GapFunctions"
            )
        # a point or ball on a ball or on the side of a cylinder
        if a.name in ("vertex", "sphere") and e.name in ("sphere", "cylinder"):
            if e.name == "cylinder":
                surface = Surface.cylinder(e.radius)
                tangent, _, axis = triad(e.direction).T
            else:
                surface = Surface.sphere(e.radius)
                tangent, _, axis = triad(self.environment_normal).T
            return SphereOnSurface(
                a.points[0],
                a.radius,
                surface,
                surface_point=e.points[0],
                surface_axis=axis,
                surface_x=tangent,
                name=self.name,
            )
        # other round features, and a vertex on a vertex or an edge: only their distance counts
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


# --- Removal of repeated contacts -----------------------------------------------------------------

_INSIDE_DISTANCE = 1e-6
"""Largest distance outside another shape of its body of a point that counts as inside (m)."""


def merged(
    contacts: Sequence[Detected],
    object_geometry: Sequence[CollisionShape],
    X_WO: SE3,
    margin: float,
    angle: float,
) -> list[Detected]:
    """Contacts without those that repeat another one.

    A contact repeats another one with the same tangent plane if its patch is on the other's plane,
    line or point, or if the touching part of the object's shape is inside the other's shape (the
    rim of a cylinder inside the ball that rounds its end). Faces are kept before lines, lines
    before points, rounded points before others, and nearer points before others.

    Args:
        contacts: all contacts.
        object_geometry: shapes of the object.
        X_WO: pose of the object.
        margin: largest difference of equal heights (m).
        angle: largest angle between equal directions (rad).
    """
    shapes = {shape.name: shape for shape in object_geometry}
    distinct: list[Detected] = []
    by_priority = sorted(contacts, key=lambda c: (-c.r, c.object_feature.radius == 0.0, c.distance))
    for contact in by_priority:
        if not any(
            _same_plane(contact, other, margin, angle)
            and (
                _lie_in_touching_space(contact.points, other, margin)
                or _is_inside_shape(contact, shapes[other.object_shape], X_WO)
            )
            for other in distinct
        ):
            distinct.append(contact)
    return [contact for contact in contacts if contact in distinct]


def _same_plane(a: Detected, b: Detected, margin: float, angle: float) -> bool:
    """Return whether two contacts have the same tangent plane.

    Args:
        a, b: detected contacts.
        margin: largest distance of the patch of a from the plane of b (m).
        angle: largest angle between the normals (rad).
    """
    sine = norm(cross(a.normal, b.normal))  # of a small angle, the angle itself (rad)
    if sine > angle or a.normal @ b.normal < 0.0:
        return False
    return bool(np.abs((a.points - b.points[0]) @ b.normal).max() <= margin)


def _lie_in_touching_space(points: Array, other: Detected, margin: float) -> bool:
    """Return whether points are on the plane, line or point in which another contact touches.

    Args:
        points: (k, 3) points in the tangent plane of `other`, world (m).
        other: the other contact.
        margin: largest distance of the points from its line or point (m).
    """
    offsets = points - other.points[0]
    if other.r == 3:  # a plane: the points are in it, see Args
        return True
    if other.r == 2:  # a line: only the offsets across it count
        axis = other.points[-1] - other.points[0]
        axis = axis / norm(axis)
        offsets = offsets - np.outer(offsets @ axis, axis)
    return bool(np.linalg.norm(offsets, axis=1).max() <= margin)


def _is_inside_shape(contact: Detected, shape: CollisionShape, X_WO: SE3) -> bool:
    """Return whether the touching point of the object is inside another of its shapes.

    Args:
        contact: the contact; lines and planes (r > 1) count as outside.
        shape: shape of the object; the touching one counts as outside.
        X_WO: pose of the object in the world.
    """
    if contact.object_shape == shape.name or contact.r > 1:
        return False
    # the touching point is one radius from the centre of a rounded feature, against the normal
    surface = X_WO.act(contact.object_point) - contact.object_feature.radius * contact.normal
    point = SE3(np.eye(3), surface)
    return (
        nearest(coal.Sphere(0.0), point, shape.shape, X_WO * shape.placement).distance
        <= _INSIDE_DISTANCE
    )


# --- Detection ------------------------------------------------------------------------------------

_EXACT_DISTANCE = 1e-9
"""Largest difference of the distance along the normal of a plane face from the distance (m)."""


def detect(
    object_geometry: Sequence[CollisionShape],
    X_WO: SE3,
    environment_geometry: Sequence[CollisionShape],
    X_WE: SE3 | None = None,
    *,
    margin: float = 1e-3,
    angle: float = 1e-3,
) -> list[Detected]:
    """Contacts between the held object and one body of the environment.

    Every pair of convex shapes gives at most one contact; a contact that repeats another one is
    left out. Overlaps of any depth count as contact; their normal is the direction of the shortest
    separation. All contacts at different places are listed, even if they are dependent.

    Args:
        object_geometry, environment_geometry: shapes of the two bodies.
        X_WO, X_WE: poses of the two bodies (default of X_WE: the world's frame).
        margin: largest distance of shapes that touch; narrower patches are lines or points (m).
        angle: largest inclination of faces and edges that touch as a whole (rad).

    Raises:
        InvalidInputError: margin or angle out of range.
    """
    if not (np.isfinite(margin) and margin > 0.0):
        raise InvalidInputError(f"margin = {margin}; give a length > 0 m")
    if not 0.0 < angle < 0.1:
        raise InvalidInputError(f"angle = {angle}; give an angle between 0 and 0.1 rad")
    if X_WE is None:
        X_WE = SE3.Identity()
    candidates = (
        _contact_of_shapes(a, X_WO, e, X_WE, margin, angle)
        for a, e in product(object_geometry, environment_geometry)
    )
    contacts = [contact for contact in candidates if contact is not None]
    return merged(contacts, object_geometry, X_WO, margin, angle)


def _contact_of_shapes(
    a: CollisionShape, X_WO: SE3, e: CollisionShape, X_WE: SE3, margin: float, angle: float
) -> Detected | None:
    """Contact of two convex shapes: the features that touch, their normal and their patch.

    Args:
        a: shape of the object.
        X_WO: pose of the object in the world.
        e: shape of a body of the environment.
        X_WE: pose of that body in the world.
        margin: largest distance at which shapes count as touching (m).
        angle: largest inclination at which edges and faces count as touching along them (rad).

    Returns:
        The contact; None if the shapes do not touch.
    """
    closest = nearest(a.shape, X_WO * a.placement, e.shape, X_WE * e.placement)
    if closest.distance > margin:
        return None

    # features that touch, in world coordinates, and the unit normal n (3,) out of e towards a
    solid_a = a.solid.moved(X_WO)
    solid_e = e.solid.moved(X_WE)
    direction = _contact_direction(solid_a, solid_e, closest)
    feature_a = foremost(solid_a, -direction, margin, angle)
    feature_e = foremost(solid_e, direction, margin, angle)
    n = exact_normal(feature_a, feature_e, direction, angle)

    # The gap along any direction is a lower bound of the distance, so the larger gap is the better
    # value. It is compared with the margin again, because the solver's distance is inexact.
    gaps = (separation(solid_a, solid_e, direction), separation(solid_a, solid_e, n))
    distance = float(max(gaps))
    if distance > margin:
        return None

    # A face remains a face: it determines the normal of the pair. The feature opposite to it is
    # reduced to the part within the patch (an edge that ends on the face touches at a point).
    patch = shared_patch(feature_a, feature_e, n, closest.witness, margin, angle)
    if feature_e.normal is not None:
        feature_a = feature_a.lowered(_lift_points(feature_a, patch, n))
    elif feature_a.normal is not None:
        feature_e = feature_e.lowered(_lift_points(feature_e, patch, n))

    middle = patch.mean(axis=0)
    return Detected(
        object_shape=a.name,
        environment_shape=e.name,
        kind=_pair_type(feature_a, feature_e),
        r=min(len(patch), 3),
        # points of a rounded feature are centres; its surface is one radius farther along n
        points=_lift_points(feature_e, patch, n) + feature_e.radius * n,
        normal=n,
        distance=distance,
        object_feature=feature_a.moved(X_WO.inverse()),
        environment_feature=feature_e.moved(X_WE.inverse()),
        object_point=X_WO.actInv(feature_a.lift(middle, n)),
        environment_point=X_WE.actInv(feature_e.lift(middle, n)),
        object_normal=X_WO.rotation.T @ n,
        environment_normal=X_WE.rotation.T @ n,
    )


def _contact_direction(a: Solid, e: Solid, closest: Nearest) -> Array:
    """Unit vector (3,) out of e towards a, along which the gap between a and e is largest.

    The exact candidates are the normals of faces and the directions across two edges. The normal of
    the iterative solver has an error of about 1e-2. It is therefore a candidate only if a shape is
    round and the gap along the best exact candidate is less than the distance: then the shapes
    touch between a round surface and an edge, a corner or another round surface.

    Args:
        a, e: solids of object and environment in world coordinates, as is the result.
        closest: distance and normal of the two by the solver.
    """
    direction = best_direction(a, e)
    has_round_surface = a.radius + e.radius > 0.0
    if has_round_surface and separation(a, e, direction) < closest.distance - _EXACT_DISTANCE:
        direction = best_direction(a, e, closest.normal)
    return direction


def _pair_type(a: Feature, e: Feature) -> str:
    """Conventional name of a contact, such as "sphere on plane" for a sphere on a face.

    Args:
        a: feature of the object.
        e: feature of the environment.
    """
    of_object = "plane" if a.name == "face" and e.radius > 0.0 else a.name
    of_environment = "plane" if e.name == "face" and a.radius > 0.0 else e.name
    return f"{of_object} on {of_environment}"


def _lift_points(feature: Feature, patch: Array, n: Array) -> Array:
    """Points (k, 3) of a feature whose projections along the normal are the points of a patch (m).

    Args:
        feature: feature of a shape, in world coordinates.
        patch: (k, 3) points of the patch in the plane through the world's origin with this normal,
            world axes (m).
        n: (3,) unit normal of the contact out of the environment, world axes.
    """
    return np.array([feature.lift(point, n) for point in patch])


# --- Contacts tracked over time -------------------------------------------------------------------


MARGIN_M = 2e-3  #: margin of a `TrackedContact`, see `detect` (m)
#: relative displacements after which a `TrackedContact` detects contacts again (m, rad)
TRAVEL_M = 2e-3
TURN_RAD = 5e-3


class TrackedContact:
    """Contact pair of all shapes that touch between the held object and one body.

    Contacts are detected (`detect`) at the first call and whenever the bodies have moved by more
    than 2 mm or 5 mrad relative to one another since the last detection. In between, N and n_γ are
    those of the detected pairs at the poses and twists of each call. If no shapes are within the
    margin, the last contacts remain: a lost contact is not detected by geometry.

    Attributes:
        name: name in messages and recordings.
        pairs: pairs of the last detection; empty before the first call.
        lookups: number of detections.
    """

    def __init__(
        self,
        object_geometry: Sequence[CollisionShape],
        environment_geometry: Sequence[CollisionShape],
        name: str = "detected",
    ) -> None:
        """Make a contact without detecting anything.

        Args:
            object_geometry: collision shapes of the object in O, see `collision_shapes`.
            environment_geometry: collision shapes of the body in E.
            name: name in messages and recordings.
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
        """Contact of all shapes that touch, with N (6, r) and n_γ (r,).

        Args:
            X_WO: pose of the object.
            V_O: (6,) its twist at O, world axes (m/s, rad/s).
            X_WE: pose of the other body; None: the world's frame.
            V_E: (6,) its twist at its own origin, world axes (m/s, rad/s); None: at rest.

        Raises:
            ContactError: no contact has been detected so far.
        """
        pairs = self._displaced_pairs(X_WO, X_WE)
        parts = [pair.contact(X_WO, V_O, X_WE, V_E) for pair in pairs]
        return parts[0] if len(parts) == 1 else Contact.stack(parts)

    def gaps(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """Gaps (r,) of the detected pairs (m, rad), for the poses of object and body."""
        return np.concatenate([pair.gaps(X_WO, X_WE) for pair in self._displaced_pairs(X_WO, X_WE)])

    def _displaced_pairs(self, X_WO: SE3, X_WE: SE3 | None) -> tuple[ContactPair, ...]:
        """Pairs of the last detection, which is repeated after a relative displacement.

        `_X_EO` is the pose of the object in the other body at the last detection, `_shapes` the
        collision shapes of object and body. Detection takes milliseconds, so small displacements
        (`TRAVEL_M`, `TURN_RAD`) do not repeat it.

        Args:
            X_WO: pose of the object in the world.
            X_WE: pose of the other body in the world; None: the world's frame.

        Raises:
            ContactError: no contact has been detected so far.
        """
        X_EO = X_WO if X_WE is None else X_WE.actInv(X_WO)
        displacement = self._X_EO.actInv(X_EO)
        has_moved = (
            norm(displacement.translation) > TRAVEL_M
            or norm(pin.log3(displacement.rotation)) > TURN_RAD
        )
        if self.pairs and not has_moved:
            return self.pairs
        object_shapes, body_shapes = self._shapes
        contacts = detect(object_shapes, X_WO, body_shapes, X_WE, margin=MARGIN_M)
        self.lookups += 1
        if contacts:  # otherwise the last pairs remain: geometry does not detect a lost contact
            self.pairs = tuple(contact.pair() for contact in contacts)
        self._X_EO = X_EO.copy()
        if not self.pairs:
            raise ContactError(
                f"{self.name}: nothing touches within {MARGIN_M * 1e3:g} mm at the pose of the "
                f"object {np.round(X_WO.translation, 4)} m; bring it nearer before engaging"
            )
        return self.pairs
