"""Rules of preflight on places: faces, bodies, object and tool compared before anything runs."""

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
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, ModelError, PlantError
from osc_contact.plants.own_mujoco import MujocoRobot
from osc_contact.runs.contacts import feet
from osc_contact.runs.rig import Rig
from osc_contact.runs.task import Task, Values, rule
from osc_contact.spatial import Array, norm

BESIDE_M = 0.005  #: a contact further than this beside body or object is refused
PROBE_M = 0.002  #: how far in front of and behind a contact geometry is looked for
NEAR_M = 0.02  #: contacts that begin further away are not compared with the scene
SCENE_PROBE_M = 1e-3  #: how far before and behind a face geometry of a scene is looked for
PLACE_DOUBTFUL, PLACE_REFUSED = 0.002, 0.005  #: m; of contacts, tool and geometry of a scene
OUTWARD = {"body": ("face_normal", "edge_outward"), "object": ("normal", "edge_outward")}


def rounded(x: Array, digits: int = 4) -> list[float]:
    """Of a vector, for messages."""
    return list(np.round(x, digits).tolist())


def has_place(pair: ContactPair) -> bool:
    """Whether a contact touches at points that are known."""
    return getattr(pair, "surface_point", None) is not None


# --- a scenario ---------------------------------------------------------------------------------


@rule(
    0.0,
    0.0,
    "the normal of the face of contact '{name}' looks away from the robot: the object and all arm "
    "tips are {mm:.0f} mm or more behind it; the normal points out of the face, towards the "
    "object: reverse contacts.{name}.face.normal",
)
def normals(rig: Rig) -> Values:
    """Faces that bring their own plate and face away from the robot."""
    pin.forwardKinematics(rig.chain.model, rig.chain.data, rig.q_contact)
    points = np.array([X.translation for X in (rig.state().X_WO, *rig.chain.tip_poses())])
    for spec in rig.scenario.contacts:
        face = getattr(spec, "face", None)
        if face is not None:
            behind = np.min((np.array(face.point) - points) @ face.normal)
            yield behind, {"name": spec.name, "mm": 1e3 * behind}


@rule(
    0.02,
    0.1,
    "to touch its contacts the object starts {mm:.0f} mm away from object.pose, at {where} m, "
    "turned by {turned:.1f} deg, instead of {given} m; move the faces to the object, or "
    "object.pose and posture to the faces",
)
def start(rig: Rig) -> Values:
    """A start pose that moved, at the object's origin or at a contact (m)."""
    given = rig.X_given
    now = rig.state().X_WO
    points = [now.translation]
    for pair in filter(has_place, rig.pairs):
        points.extend(feet(pair, now)[0])
    moved = max(norm(p - given.act(now.actInv(p))) for p in points)
    words = {
        "mm": 1e3 * moved,
        "where": rounded(now.translation),
        "turned": np.rad2deg(norm(pin.log3(given.rotation.T @ now.rotation))),
        "given": rounded(given.translation),
    }
    yield moved, words


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
        ball = CollisionShape("point", coal.Sphere(1e-6), pin.SE3(np.eye(3), point))
        return min(_distance(one, self.placement, ball, pin.SE3.Identity()) for one in self.shapes)


def _distance(
    first: CollisionShape, X_first: pin.SE3, second: CollisionShape, X_second: pin.SE3
) -> float:
    """Between two convex shapes of bodies at X, negative where they overlap (m)."""
    arguments: list[Any] = []
    for one, X in ((first, X_first * first.placement), (second, X_second * second.placement)):
        arguments += [one.shape, coal.Transform3s(X.rotation, X.translation)]
    return float(coal.distance(*arguments, coal.DistanceRequest(), coal.DistanceResult()))


def _solids(rig: Rig) -> Iterator[tuple[int, ContactPair, dict[str, _Solid]]]:
    """Number and pair of each contact that has a place, with the body and the object it is on."""
    urdf = robots.resolve_urdf(rig.scenario.object.urdf, rig.scenario.folder)[0]
    held = _Solid("the object", urdf, rig.state().X_WO)
    bodies = [_Solid(f"'{body.name}'", body.urdf[0], body.placement) for body in rig.bodies]
    for i, pair in enumerate(rig.pairs):
        if has_place(pair):
            yield i, pair, {"body": bodies[rig.on[i]], "object": held}


@rule(
    BESIDE_M,
    BESIDE_M,
    "contact '{name}' would touch at {point} m, {mm:.0f} mm beside {solid.name}, whose collision "
    "geometry ends before; move the face, or the contact's place on the object",
)
def beside(rig: Rig) -> Values:
    """Contacts beside their bodies or the object; those of the exact plant have no ends."""
    for _, pair, solids in () if rig.scenario.plant.exact else _solids(rig):
        for solid in solids.values():
            for point in feet(pair, rig.state().X_WO)[0] if solid.shapes else ():
                away = solid.distance(point)
                where = rounded(point, 3)
                yield away, {"name": pair.name, "point": where, "mm": 1e3 * away, "solid": solid}
                if away > BESIDE_M:
                    break


@rule(
    PROBE_M,
    PROBE_M,
    "the force of contact '{name}' would push out of {solid.name}, whose collision geometry is "
    "on the side that {key} points to; it must point out of it: reverse contacts.{name}.{key}",
)
def inverted(rig: Rig) -> Values:
    """Normals that are reversed: the force would push out of the body, or out of the object."""
    for i, pair, solids in _solids(rig):
        points, directions = feet(pair, rig.state().X_WO)
        spec = rig.scenario.contacts[i]
        for kind, solid in solids.items() if pushes_only(pair) else ():
            key = next((key for key in OUTWARD[kind] if hasattr(spec, key)), None)
            if key is None or not solid.shapes or max(map(solid.distance, points)) >= BESIDE_M:
                continue
            steps = PROBE_M * directions * (1.0 if kind == "body" else -1.0)
            rise = min(
                solid.distance(p + d) - solid.distance(p - d)
                for p, d in zip(points, steps, strict=True)
            )
            yield rise, {"name": pair.name, "solid": solid, "key": key}
            if rise > PROBE_M:
                break


@rule(
    0.005,
    0.005,
    "the object starts {mm:.0f} mm inside {name}, with its contacts just touching: a normal is "
    "reversed, or the collision geometry is larger than the contacts state; reverse the normals of "
    "its contacts, or mend the geometry",
)
def inside(rig: Rig) -> Values:
    """Depth of the object in a body, for another cause than those above (m)."""
    if rig.scenario.plant.exact or any(normals.findings(rig)) or any(inverted.findings(rig)):
        return
    pairs = {solids["body"].name: solids.values() for _, _, solids in _solids(rig)}
    for name, (body, held) in pairs.items():
        for a in body.shapes if held.shapes else ():
            depth = max(-_distance(a, body.placement, b, held.placement) for b in held.shapes)
            yield depth, {"name": name, "mm": 1e3 * depth}


# --- every task ---------------------------------------------------------------------------------


@rule(
    0.005,
    np.inf,
    "the motion leads the object {mm:.0f} mm {way} the surface of contact '{name}', which "
    "does not permit it: that part is not followed; give a direction along the surface, such as "
    "common_tangent, and press with force",
)
def lifted(task: Task) -> Values:
    """How far a motion opens or closes a gap while the contact is to be kept (m)."""
    kept = np.flatnonzero(task.times >= task.kept_from)
    kept = kept[:: max(1, len(kept) // 100)]
    for i, pair in enumerate(task.pairs):
        pressed = (task.forces[kept][:, task.owners == i] > 0.0).any(axis=1)
        pressed |= task.bound  # else it opens when its force ends
        gaps = [pair.gaps(pin.XYZQUATToSE3(X)) for X in task.poses[kept[pressed]]]
        if task.rests[i] and gaps:
            worst = np.abs(gaps).max(initial=0.0)
            way = "into" if -np.min(gaps, initial=0.0) >= np.max(gaps, initial=0.0) else "off"
            yield worst, {"mm": 1e3 * worst, "way": way, "name": pair.name}


# --- a robot in a MuJoCo scene ------------------------------------------------------------------


def mass_of(chain: ClosedChain) -> float:
    """Of all that moves (kg)."""
    return _held(chain) + float(sum(inertia.mass for inertia in list(chain.model.inertias)[1:]))


def _carried(chain: ClosedChain) -> float:
    """What the wrists carry (kg)."""
    return _held(chain) + float(sum(one.inertia.mass for links in chain.outboard for one in links))


def _held(chain: ClosedChain) -> float:
    return 0.0 if chain.payload is None else float(chain.payload.inertia.mass)


def _scene(task: Task) -> Any:
    """What measures distances in the scene of a `MujocoRobot`; None: another robot."""
    return task.robot.probe() if isinstance(task.robot, MujocoRobot) else None


def _faces(task: Task) -> Iterator[tuple[ContactPair, Array, Array, float, str]]:
    """Each point of contact near the tool: pair, place, outward normal, distance to which geom."""
    probe = _scene(task)
    X = task.state.X_WO
    for pair in task.pairs if probe is not None and probe.pairs else ():
        if has_place(pair) and pushes_only(pair) and np.abs(pair.gaps(X)).max() < NEAR_M:
            for point, inward in zip(*feet(pair, X), strict=True):
                yield pair, point, -inward, *probe.distance(point)


@rule(0.0, 0.0, "{why}")
def period(task: Task) -> Values:
    """A control period that is no whole number of the scene's steps."""
    if isinstance(task.robot, MujocoRobot):
        try:
            task.robot.require_steps(task.dt)
        except PlantError as error:
            yield 1.0, {"why": error}


@rule(
    0.0,
    0.0,
    "there are contacts, and no geom of the tool can touch the scene: give both contype and "
    "conaffinity, and take the body of the sensor, or of the tip, for the tool",
)
def touchable(task: Task) -> Values:
    """Whether the tool is a ghost."""
    probe = _scene(task)
    if probe is not None and task.pairs and not probe.pairs:
        yield 1.0, {}


@rule(
    0.1,
    0.7,
    "{what} weighs {believed:.4g} kg in the controller's model, {true:.4g} kg in the scene; give "
    "the controller robot.chain, or correct masses (kg) and payload",
)
def masses(task: Task) -> Values:
    """Logarithm of the ratio of masses."""
    if isinstance(task.robot, MujocoRobot) and task.controller is not None:
        for what, mass in (("all that moves", mass_of), ("what the wrist carries", _carried)):
            believed = mass(task.controller.chain)
            true = mass(task.robot.chain)
            if true > 0.0 and believed > 0.0:
                ratio = abs(np.log(believed / true))
                yield ratio, {"what": what, "believed": believed, "true": true}


@rule(
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
    "contact '{name}' is modelled to touch at {point} m, and that is {mm:.3g} mm {side} the "
    "nearest geom, '{geom}'; move the contact's face to the scene's, or the scene's geom",
)
def place(task: Task) -> Values:
    """Distance of a face from the geometry of the scene (m)."""
    for pair, point, _, away, geom in _faces(task):
        side = "before" if away > 0.0 else "inside"
        at = rounded(point)
        words = {"name": pair.name, "point": at, "mm": 1e3 * abs(away), "side": side, "geom": geom}
        yield abs(away), words


@rule(
    3.0,
    30.0,
    "the normal of contact '{name}', {normal} out of the face, is {value:.3g} deg away from that "
    "of '{geom}', {own}; it points out of the body, towards the tool: turn it",
)
def turn(task: Task) -> Values:
    """Angle (deg) between the modelled normal and the direction in which the scene recedes."""
    for pair, point, normal, away, geom in _faces(task):
        if abs(away) > PLACE_REFUSED:
            continue
        probe = _scene(task)
        steps = SCENE_PROBE_M * np.eye(3)
        rise = np.array(
            [probe.distance(point + e)[0] - probe.distance(point - e)[0] for e in steps]
        )
        own = rise / max(norm(rise), 1e-12)
        plane = getattr(pair, "normal", None)
        # at edges and corners geometry recedes in many directions
        if (plane is not None and np.allclose(plane, normal)) or normal @ own <= 0.0:
            angle = float(np.degrees(np.arccos(np.clip(normal @ own, -1.0, 1.0))))
            normals = {"normal": rounded(normal, 3), "own": rounded(own, 3)}
            yield angle, {"name": pair.name, "geom": geom, **normals}


@rule(
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
    "the tool starts {value:.3g} m inside '{geom}'; begin further away, or correct the tool's "
    "geometry and the contact's radius",
)
def penetration(task: Task) -> Values:
    """Depth of the tool in the scene (m)."""
    probe = _scene(task)
    if probe is not None and probe.pairs:
        away, geom = probe.clearance()
        yield -away, {"geom": geom}


@rule(
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
    "the tool is {away:.3g} mm away from '{geom}', and by the contacts {gap:.3g} mm; correct the "
    "contact's vertex and radius, or the tip",
)
def tool(task: Task) -> Values:
    """Distance of the tool, less the least gap that the contacts name (m)."""
    faces = list(_faces(task))
    if faces and max(abs(away) for *_, away, _ in faces) <= PLACE_DOUBTFUL:
        X = task.state.X_WO
        gap = min(np.min(pair.gaps(X)) for pair in task.pairs if pushes_only(pair))
        away, geom = _scene(task).clearance()
        words = {"geom": geom, "gap": round(1e3 * gap, 3) + 0.0, "away": 1e3 * away}
        yield abs(away - gap), words


RIG_RULES = (normals, inverted, inside, start, beside)
SCENE_RULES = (period, touchable, masses, place, turn, penetration, tool)
