"""Rules on a controller and the scene of its robot: places, normals, sizes and masses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import feet
from osc_contact.contacts.pairs.pair import ContactPair, has_place, pushes_only
from osc_contact.errors import PlantError
from osc_contact.interface import Scene
from osc_contact.loop.rules import Task, Values, rounded, rule
from osc_contact.spatial import Array, norm

NEAR_M = 0.02  #: m, largest gap at the start of contacts that are compared with the scene
_ROUNDING_M = 1e-9  #: m; a gap of exactly `NEAR_M` counts on every processor
SCENE_PROBE_M = 1e-3  #: m, step of the differences that give a normal of the scene
PLACE_DOUBTFUL, PLACE_REFUSED = 0.002, 0.005  #: m, limits for positions of contacts and tool


def _scene_of(task: Task) -> Scene:
    """Return the scene of a task; the rules of this module are for tasks with a scene."""
    assert task.scene is not None
    return task.scene


def _near_contact_points(task: Task) -> Iterator[tuple[ContactPair, Array, Array, float, str]]:
    """Yield the contact points that are near the tool in the pose at the start.

    Args:
        task: task to be checked.

    Yields:
        Pair; point (3,) and outward normal (3,) of its face, in world axes (m); distance of the
        point from the nearest geom of the scene (m); name of that geom.
    """
    scene = _scene_of(task)
    if not scene.tool_touches:
        return
    X = task.state.X_WO
    for pair in task.pairs:
        if has_place(pair) and pushes_only(pair) and _is_near(pair, X):
            for point, inward in zip(*feet(pair, X), strict=True):
                distance, geom = scene.distance(point)
                yield pair, point, -inward, distance, geom


def _is_near(pair: ContactPair, X: pin.SE3) -> bool:
    """Whether the gaps of a pair are at most `NEAR_M` at the pose X of the object."""
    return bool(np.abs(pair.gaps(X)).max() <= NEAR_M + _ROUNDING_M)


@rule("{why}")
def period(task: Task) -> Values:
    """Yield 1 if the control period is not a whole number of the scene's steps.

    Args:
        task: task, of which the period `dt` (s) is read.
    """
    try:
        _scene_of(task).require_period(task.dt)
    except PlantError as error:
        yield 1.0, {"why": error}  # above 0, the limit of this rule: the task is refused


@rule(
    "there are contacts, and no geom of the tool can touch the scene: give both contype and "
    "conaffinity, and take the body of the sensor, or of the tip, for the tool"
)
def touchable(task: Task) -> Values:
    """Find a tool that cannot touch the scene although the task has contacts."""
    if task.pairs and not _scene_of(task).tool_touches:
        yield 1.0, {}


@rule(
    "{what} weighs {modelled:.4g} kg in the controller's model, {true:.4g} kg in the scene; give "
    "the controller robot.chain, or correct masses (kg) and payload",
    0.1,
    0.7,
)
def masses(task: Task) -> Values:
    """Logarithm of the ratio of modelled and true masses, of all that moves and of the load.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    chain = task.chain
    compared = {
        "all that moves": (chain.moved_mass, _scene_of(task).moved_mass),
        "what the wrist carries": (chain.outboard_mass, _scene_of(task).carried_mass),
    }
    for name, (modelled, true) in compared.items():
        if true > 0.0 and modelled > 0.0:
            ratio = abs(np.log(modelled / true))
            yield ratio, {"what": name, "modelled": modelled, "true": true}


@rule(
    "joint '{joint}' moves {mass:.3g} kg beyond the tip, {value:.0%} of what the arm moves, and "
    "no motor of the controller and no servo of the scene holds it: is the tip on an inner body? "
    "Take the outermost body or a site on it for the tip, or give the joint a position servo",
    0.01,
    0.1,
)
def loose(task: Task) -> Values:
    """Mass beyond joints without motor and servo, as a share of all moving mass."""
    for joint, mass in _scene_of(task).loose.items():
        yield mass / max(_scene_of(task).moved_mass, 1e-12), {"joint": joint, "mass": mass}


@rule(
    "contact '{name}' is modelled to touch at {point} m, and that is {mm:.3g} mm {side} the "
    "nearest geom, '{geom}'; move the contact's face to the scene's, or the scene's geom",
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
)
def place(task: Task) -> Values:
    """Distance of a face from the geometry of the scene (m)."""
    for pair, point, _, distance, geom in _near_contact_points(task):
        side = "before" if distance > 0.0 else "inside"
        words = {"name": pair.name, "point": rounded(point), "side": side, "geom": geom}
        yield abs(distance), words


@rule(
    "the normal of contact '{name}', {normal} out of the face, is {value:.3g} deg away from that "
    "of '{geom}', {own}; it points out of the body, towards the tool: turn it",
    3.0,
    30.0,
)
def turn(task: Task) -> Values:
    """Angle (deg) between the modelled normal and the direction in which the scene recedes.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    scene = _scene_of(task)
    for pair, point, normal, distance, geom in _near_contact_points(task):
        if abs(distance) > PLACE_REFUSED:
            continue
        scene_normal = _distance_gradient(scene, point)
        plane_normal = getattr(pair, "normal", None)
        is_plane = plane_normal is not None and np.allclose(plane_normal, normal)
        # at edges and corners geometry recedes in many directions
        if is_plane or normal @ scene_normal <= 0.0:
            angle = float(np.degrees(np.arccos(np.clip(normal @ scene_normal, -1.0, 1.0))))
            words = {"normal": rounded(normal, 3), "own": rounded(scene_normal, 3), "geom": geom}
            yield angle, {"name": pair.name, **words}


def _distance_gradient(scene: Scene, point: Array) -> Array:
    """Unit vector (3,) along which the distance from a scene increases most, by differences.

    Args:
        scene: bodies around a robot.
        point: (3,) point in the world (m).
    """
    steps = SCENE_PROBE_M * np.eye(3)
    increase = np.array(
        [scene.distance(point + step)[0] - scene.distance(point - step)[0] for step in steps]
    )
    return increase / max(norm(increase), 1e-12)


@rule(
    "the tool starts {value:.3g} m inside '{geom}'; begin further away, or correct the tool's "
    "geometry and the contact's radius",
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
)
def penetration(task: Task) -> Values:
    """Penetration of the tool into the scene (m)."""
    if _scene_of(task).tool_touches:
        distance, geom = _scene_of(task).clearance()
        yield -distance, {"geom": geom}


@rule(
    "the tool is {away:.3g} mm away from '{geom}', and by the contacts {gap:.3g} mm; correct the "
    "contact's vertex and radius, or the tip",
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
)
def tool(task: Task) -> Values:
    """Difference between the tool's distance from the scene and the least gap of contacts (m).

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    distances = [abs(distance) for _, _, _, distance, _ in _near_contact_points(task)]
    if distances and max(distances) <= PLACE_DOUBTFUL:
        X = task.state.X_WO
        gap = min(np.min(pair.gaps(X)) for pair in task.pairs if pushes_only(pair))
        clearance, geom = _scene_of(task).clearance()
        gap_mm = round(1e3 * gap, 3) + 0.0  # + 0.0 turns −0.0 into 0.0
        yield abs(clearance - gap), {"geom": geom, "gap": gap_mm, "away": 1e3 * clearance}


#: All rules on a robot's scene; a new rule is added to this list.
SCENE_RULES = (period, touchable, loose, masses, place, turn, penetration, tool)
