"""From a scenario's contacts to contact pairs and the bodies of the environment they are on.

Every pair is built in the world's coordinates at the start: its environment frame E coincides with
the world while the body it is on stands where it began.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts import pairs as kinds
from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.over_time import normals_over
from osc_contact.scenarios.geometry import PoseSpec
from osc_contact.scenarios.schema import Scenario
from osc_contact.scenarios.touching import FaceMotion, VertexOnFaceSpec
from osc_contact.spatial import Array, Poses, cross

__all__ = ["EnvironmentBody", "build_pairs", "environment_bodies", "feet", "feet_over", "pose_of"]

#: What a contact's type builds; the scenario's keys are its arguments where not renamed below.
_KINDS: dict[str, Callable[..., ContactPair]] = {
    "vertex_on_face": kinds.VertexOnFace,
    "sphere_on_plane": kinds.SphereOnPlane,
    "face_on_vertex": kinds.FaceOnVertex,
    "edge_on_edge": kinds.EdgeOnEdge,
    "edge_on_face": kinds.EdgeOnFace,
    "cylinder_on_plane": kinds.CylinderOnPlane,
    "face_on_face": kinds.FaceOnFace,
    "cylinder_in_hole": kinds.CylinderInHole,
}
_RENAMED = {
    "sphere_on_plane": {"face_point": "point", "face_normal": "normal"},
    "face_on_vertex": {"body_vertex": "vertex"},
    "edge_on_edge": {
        "point": "point_A",
        "direction": "direction_A",
        "edge_point": "point_E",
        "edge_direction": "direction_E",
        "edge_outward": "side",
    },
}
_POINTS = {"face_point", "edge_point", "hole_point", "body_vertex"}
_DIRECTIONS = {"face_normal", "edge_direction", "edge_outward", "hole_direction"}


@dataclass(frozen=True)
class EnvironmentBody:
    """A body of the environment.

    Attributes:
        name: in pictures.
        urdf: its file and package folders.
        placement: X_WB, pose of its frame in the world at the start.
        motion: how it slides, None: not at all.
        contacts: (k,) numbers of the contacts that are on it.
    """

    name: str
    urdf: tuple[Path, tuple[Path, ...]]
    placement: pin.SE3
    motion: FaceMotion | None
    contacts: tuple[int, ...]


def pose_of(spec: PoseSpec) -> pin.SE3:
    """The pose that a scenario gives."""
    return pin.SE3(pin.rpy.rpyToMatrix(*spec.rpy), np.array(spec.xyz))


def build_pairs(scenario: Scenario) -> tuple[ContactPair, ...]:
    """The contact pairs of a scenario, in its order."""
    poses = {body.name: pose_of(body.pose) for body in scenario.environment}
    pairs: list[ContactPair] = []
    for spec in scenario.contacts:
        if isinstance(spec, VertexOnFaceSpec):
            point, normal = np.array(spec.face.point), np.array(spec.face.normal)
            vertex, radius = np.array(spec.vertex), float(spec.radius)
            pairs.append(kinds.VertexOnFace(vertex, point, normal, radius, spec.name))
            continue
        X, renamed = poses[spec.body], _RENAMED.get(spec.type, {})
        given = {}
        for key, value in spec.model_dump(exclude={"type", "body"}).items():
            if key in _POINTS:
                value = X.act(np.array(value))
            elif key in _DIRECTIONS:
                value = X.rotation @ np.array(value)
            given[renamed.get(key, key)] = value
        pairs.append(_KINDS[spec.type](**given))
    return tuple(pairs)


def environment_bodies(
    scenario: Scenario, pairs: tuple[ContactPair, ...]
) -> tuple[EnvironmentBody, ...]:
    """The bodies of a scenario: those that bring one face for one contact, then the shared ones.

    Raises:
        ModelError: a URDF is not found.
    """
    source = None if scenario.source is None else scenario.source.parent
    found = []
    for i, (spec, pair) in enumerate(zip(scenario.contacts, pairs, strict=True)):
        if isinstance(spec, VertexOnFaceSpec) and isinstance(pair, kinds.VertexOnFace):
            urdf = robots.resolve_urdf(spec.face.urdf, source)
            placement, name = pair.face_placement(), f"face_{spec.name}"
            found.append(EnvironmentBody(name, urdf, placement, spec.face.motion, (i,)))
    for body in scenario.environment:
        on = [i for i, c in enumerate(scenario.contacts) if getattr(c, "body", None) == body.name]
        urdf = robots.resolve_urdf(body.urdf, source)
        found.append(EnvironmentBody(body.name, urdf, pose_of(body.pose), body.motion, tuple(on)))
    return tuple(found)


def feet(pair: ContactPair, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> tuple[Array, Array]:
    """Where the lines of force meet the touched surface (r, 3), and their directions (r, 3).

    World axes, directions into the environment. The pair must transmit forces, not pure couples.
    """
    E = None if X_WE is None else Poses(X_WE.rotation[:, :, None], X_WE.translation[:, None])
    O = Poses(X_WO.rotation[:, :, None], X_WO.translation[:, None])  # noqa: E741
    points, directions = feet_over(pair, normals_over(pair, O, E), O, E)
    return points[:, :, 0].T, directions[:, :, 0].T


def feet_over(
    pair: ContactPair, N: Array, X_WO: Poses, X_WE: Poses | None = None
) -> tuple[Array, Array]:
    """The same (3, r, k) each at k instants, given the pair's N (6, r, k) there."""
    size = np.sqrt((N[:3] * N[:3]).sum(axis=0))
    directions, moments = N[:3] / size, N[3:] / size
    surface = _on_surface(pair)[:, None]
    surface = surface if X_WE is None else X_WE.p + X_WE.turn(surface)
    height = (directions * (surface - X_WO.p)[:, None]).sum(axis=0)  # along each line, from O
    if isinstance(pair, kinds.FaceOnVertex):
        height = height - pair.radius
    return X_WO.p[:, None] + cross(directions, moments) + height * directions, directions


def _on_surface(pair: ContactPair) -> Array:
    """(3,) a point of the environment's feature, in E."""
    if isinstance(pair, kinds.EdgeOnEdge):
        return pair.point_E
    if isinstance(pair, kinds.FaceOnVertex):
        return pair.vertex
    if isinstance(pair, kinds.CylinderInHole):
        return pair.hole_point
    if isinstance(pair, (kinds.VertexOnFace, kinds.SphereOnPlane)):
        return pair.point
    assert isinstance(pair, (kinds.EdgeOnFace, kinds.CylinderOnPlane, kinds.FaceOnFace))
    return pair.face_point
