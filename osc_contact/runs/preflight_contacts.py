"""Where the contacts of a task are: faces, bodies and object compared before anything runs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.detection import CollisionShape, collision_shapes
from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.runs.contacts import feet
from osc_contact.runs.finding import Finding
from osc_contact.runs.rig import Rig
from osc_contact.runs.task import Task
from osc_contact.spatial import Array

__all__ = ["beside", "inside", "inverted", "lifted", "normals", "start"]

MOVED_M, MISPLACED_M = 0.02, 0.1  #: start pose that moved: doubtful, refused
BESIDE_M = 0.005  #: a contact further than this beside body or object is refused
LIFTED_M = 0.005  #: a motion that opens or closes a gap by more is doubtful
INSIDE_M = 0.005  #: an object that starts deeper in a body is refused
PROBE_M = 0.002  #: how far in front of and behind a contact geometry is looked for
OUTWARD = {"body": ("face_normal", "edge_outward"), "object": ("normal", "edge_outward")}


def normals(rig: Rig) -> Iterator[Finding]:
    """Faces that bring a plate of their own and look away from the robot."""
    X = rig.state().X_WO
    pin.forwardKinematics(rig.chain.model, rig.chain.data, rig.q_contact)
    tips = [tip.translation for tip in rig.chain.tip_poses()]
    for i, (pair, spec) in enumerate(zip(rig.pairs, rig.scenario.contacts, strict=True)):
        face = getattr(spec, "face", None)
        if face is None:
            continue
        point, normal = np.array(face.point), np.array(face.normal)
        heights = [float(normal @ (p - point)) for p in (X.translation, *tips)]
        if max(heights) < 0.0:
            yield Finding(
                True,
                f"the normal of the face of contact '{pair.name}' looks away from the robot: the "
                f"object and all arm tips lie {-1e3 * max(heights):.0f} mm or more behind it; the "
                f"normal points out of the face, towards the object: reverse "
                f"contacts.{rig.scenario.contacts[i].name}.face.normal",
            )


def start(rig: Rig) -> Iterator[Finding]:
    """A start pose that moved, at the object's origin or at a contact."""
    asked, now = rig.X_asked, rig.state().X_WO
    points = [now.translation]
    for pair in rig.pairs:
        if getattr(pair, "surface_point", None) is not None:
            points.extend(feet(pair, now)[0])
    moved = [float(np.linalg.norm(p - asked.act(now.actInv(p)))) for p in points]
    if max(moved) > MOVED_M:
        where = np.round(now.translation, 4).tolist()
        turned = np.rad2deg(np.linalg.norm(pin.log3(asked.rotation.T @ now.rotation)))
        yield Finding(
            max(moved) > MISPLACED_M,
            f"to touch its contacts the object starts {1e3 * max(moved):.0f} mm away from "
            f"object.pose, at {where} m, turned by {turned:.1f} deg, instead of "
            f"{np.round(asked.translation, 4).tolist()} m; move the faces to the object, or "
            "object.pose and posture to the faces",
        )


@dataclass(frozen=True)
class _Solid:
    """A body with its collision shapes, for distances to points of the world."""

    name: str
    urdf: Path
    placement: pin.SE3

    @cached_property
    def shapes(self) -> list[CollisionShape]:
        """Of its file; none where they are not convex, or not there."""
        try:
            return collision_shapes(self.urdf)
        except (InvalidInputError, ModelError):
            return []

    def distance(self, point: Array) -> float:
        """Of a point of the world, not positive inside."""
        at, ball = pin.SE3(np.eye(3), point), coal.Sphere(1e-6)
        return min(
            _distance(one.shape, self.placement * one.placement, ball, at) for one in self.shapes
        )


def _solids(rig: Rig) -> Iterator[tuple[int, ContactPair, dict[str, _Solid]]]:
    """Number and pair of each contact that has a place, with the body and the object it is on."""
    urdf = robots.resolve_urdf(rig.scenario.object.urdf, rig.scenario.folder)[0]
    held = _Solid("the object", urdf, rig.state().X_WO)
    bodies = [_Solid(f"'{body.name}'", body.urdf[0], body.placement) for body in rig.bodies]
    for i, pair in enumerate(rig.pairs):
        if getattr(pair, "surface_point", None) is not None:
            yield i, pair, {"body": bodies[rig.on[i]], "object": held}


def beside(rig: Rig) -> Iterator[Finding]:
    """Contacts beside their bodies or the object; those of the exact plant have no ends."""
    if rig.scenario.plant.exact:
        return
    X = rig.state().X_WO
    for _, pair, solids in _solids(rig):
        for solid in solids.values():
            for point in feet(pair, X)[0] if solid.shapes else ():
                away = solid.distance(point)
                if away > BESIDE_M:
                    yield Finding(
                        True,
                        f"contact '{pair.name}' would touch at {np.round(point, 3).tolist()} m, "
                        f"{1e3 * away:.0f} mm beside {solid.name}, whose collision geometry ends "
                        "before; move the face, or the contact's place on the object",
                    )
                    break


def inverted(rig: Rig) -> Iterator[Finding]:
    """Normals that are reversed: the force would push out of the body, or out of the object."""
    X = rig.state().X_WO
    for i, pair, solids in _solids(rig):
        if not pushes_only(pair):
            continue
        spec = rig.scenario.contacts[i]
        points, directions = feet(pair, X)
        for kind, solid in solids.items():
            if not solid.shapes:
                continue
            into = 1.0 if kind == "body" else -1.0
            step = PROBE_M * into * directions
            rise = [
                solid.distance(p + d) - solid.distance(p - d)
                for p, d in zip(points, step, strict=True)
            ]
            near = max(map(solid.distance, points)) < BESIDE_M
            key = next((key for key in OUTWARD[kind] if hasattr(spec, key)), None)
            if key is not None and near and min(rise) > PROBE_M:
                yield Finding(
                    True,
                    f"the force of contact '{pair.name}' would push out of {solid.name}, whose "
                    f"collision geometry lies on the side that {key} points to; it must point out "
                    f"of it: reverse contacts.{spec.name}.{key}",
                )
                break


def inside(rig: Rig) -> Iterator[Finding]:
    """An object that begins in a body, for another cause than those above."""
    if rig.scenario.plant.exact:
        return
    deepest: dict[str, float] = {}
    for _, _, solids in _solids(rig):
        body, held = solids["body"], solids["object"]
        depths = [
            -_distance(a.shape, body.placement * a.placement, b.shape, held.placement * b.placement)
            for a in body.shapes
            for b in held.shapes
        ]
        deepest[body.name] = max(depths, default=0.0)
    deep = {name: depth for name, depth in deepest.items() if depth > INSIDE_M}
    if deep and any(True for _ in (*normals(rig), *inverted(rig))):
        return
    for name, depth in deep.items():
        yield Finding(
            True,
            f"the object starts {1e3 * depth:.0f} mm inside {name}, with its contacts just "
            "touching: a normal is reversed, or the collision geometry is larger than the "
            "contacts say; reverse the normals of its contacts, or mend the geometry",
        )


def _distance(first: Any, X_first: pin.SE3, second: Any, X_second: pin.SE3) -> float:
    """Between two convex shapes of coal, negative where they overlap (m)."""
    at = [coal.Transform3s(X.rotation, X.translation) for X in (X_first, X_second)]
    answer = coal.DistanceResult()
    return float(coal.distance(first, at[0], second, at[1], coal.DistanceRequest(), answer))


def lifted(task: Task) -> Iterator[Finding]:
    """Motions along a normal, while the contact is to be kept."""
    plan = task.plan
    kept = np.flatnonzero(task.times >= task.kept_from)
    kept = kept[:: max(1, len(kept) // 100)]
    poses = [pin.XYZQUATToSE3(x) for x in plan.X_WD[kept]]
    for i, pair in enumerate(task.pairs):
        if not task.rests[i]:
            continue
        forces = np.flatnonzero(task.owners == i)
        pressed = plan.alpha_d[np.ix_(kept, forces)].max(axis=1, initial=0.0) > 0.0
        gaps = np.array([
            pair.gaps(X) for X, wanted in zip(poses, pressed, strict=True)
            if wanted or task.bound  # which opens it when its force ends
        ])  # fmt: skip
        worst = float(np.abs(gaps).max(initial=0.0))
        if worst > LIFTED_M:
            way = "into" if np.abs(gaps.min()) >= gaps.max() else "off"
            yield Finding(
                False,
                f"the motion asks the object to go {1e3 * worst:.0f} mm {way} the surface of "
                f"contact '{pair.name}', which does not permit it: that part is not followed; give "
                "a direction along the surface, such as common_tangent, and press with force",
            )
