"""Contact pairs and bodies of the environment, made from a scenario.

Every pair is built in the world's coordinates at the start: its environment frame E coincides with
the world as long as the touched body is in its initial pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.detection import CollisionShape, TrackedContact, collision_shapes
from osc_contact.contacts.feet import feet
from osc_contact.contacts.pairs.pair import ContactPair, triad
from osc_contact.dynamics.environment import Body, Conveyor, Guided, Rail, Yielding
from osc_contact.dynamics.grasp import moved
from osc_contact.errors import ScenarioError
from osc_contact.lab.scenarios.bodies import CartSpec, ConveyorSpec, FaceMotion, PoseSpec
from osc_contact.lab.scenarios.contact_keys import OnFaceSpec, OwnContactSpec, make_pair
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.scenarios.signals import sums
from osc_contact.spatial import Array, norm

_STEP = 1e-6  #: displacement of the object for the differences of gaps (m, rad)


@dataclass(frozen=True)
class EnvironmentBody:
    """Body of the environment, which contacts touch.

    Attributes:
        name: name of the body in pictures.
        urdf: file of its shape, and package folders.
        placement: X_WB, pose of its frame in the world at the start.
        motion: motion of the body in the scenario; None: it is at rest.
        contacts: (k,) indices of the contacts that touch it.
    """

    name: str
    urdf: tuple[Path, tuple[Path, ...]]
    placement: pin.SE3
    motion: FaceMotion | None
    contacts: tuple[int, ...]


def urdf_of(scenario: Scenario, part: Any) -> Path:
    """File of an arm or of the object of a scenario.

    Args:
        scenario: scenario whose folder relative paths refer to.
        part: description with a field `urdf`: an arm, or the object.

    Raises:
        ModelError: the file is not found.
    """
    return robots.resolve_urdf(part.urdf, scenario.folder)[0]


def pose_of(spec: PoseSpec) -> pin.SE3:
    """Convert a pose of a scenario, position and roll-pitch-yaw angles, to `pin.SE3`."""
    return pin.SE3(pin.rpy.rpyToMatrix(*spec.rpy), np.array(spec.xyz))


def build_pairs(scenario: Scenario) -> tuple[ContactPair, ...]:
    """Make the contact pairs of a scenario, in its order.

    Args:
        scenario: scenario whose contacts are described by keys, with their geometry in the frame of
            a body, or are pairs made in Python, which are returned as they are.
    """
    poses = _body_poses(scenario)
    world = pin.SE3.Identity()
    pairs: list[ContactPair] = []
    for spec in scenario.contacts:
        if isinstance(spec, OwnContactSpec):
            pairs.append(spec.pair)
        else:
            X_WB = poses.get(getattr(spec, "body", ""), world)
            pairs.append(make_pair(spec, X_WB, scenario.folder))
    return tuple(pairs)


def require_own_pairs(scenario: Scenario, X_WO: pin.SE3) -> None:
    """Refuse pairs given as objects whose N contradicts their gaps: d gaps/dt = −NᵀV.

    Args:
        scenario: scenario with its contacts.
        X_WO: pose of the object near the contacts.

    Raises:
        ScenarioError: a gap changes by another rate, or N has another shape than the gaps.
    """
    for spec in scenario.contacts:
        if not isinstance(spec, OwnContactSpec):
            continue
        N = np.asarray(spec.pair.contact(X_WO, np.zeros(6)).N)
        gaps = np.asarray(spec.pair.gaps(X_WO), dtype=float)
        if N.shape != (6, len(gaps)):
            raise ScenarioError(
                f"contact '{spec.name}': N has shape {N.shape}, and gaps gives {len(gaps)} "
                "numbers; there is one column of N (6,) for each gap"
            )
        for j, column in enumerate(N.T):
            displacement = _STEP * column / max(norm(column), 1e-12)
            rate = (spec.pair.gaps(moved(X_WO, displacement))[j] - gaps[j]) / _STEP
            expected = -column @ displacement / _STEP
            if abs(rate - expected) > 0.5 * abs(expected):
                is_reversed = rate * expected < 0.0
                cure = "reverse the sign of N or of gaps" if is_reversed else "check both"
                raise ScenarioError(
                    f"contact '{spec.name}': along column {j + 1} of its N the gap changes by "
                    f"{rate:.3g} m per metre instead of {expected:.3g}: N points into the "
                    f"environment and gaps shrink along it; {cure}"
                )


def misplaced(
    scenario: Scenario,
    pairs: tuple[ContactPair, ...],
    bodies: Sequence[EnvironmentBody],
    X_WO: pin.SE3,
) -> tuple[ContactPair, ...]:
    """Make the pairs of the controller's model, each body displaced by the scenario's error.

    A body is modelled `face_offset` nearer to the object along its first line of force, and rotated
    by `face_tilt` about an axis across this line, through the point where it meets the body. The
    axis is horizontal, or any if the line is vertical, and turned about the line by
    `face_tilt_about`.

    Args:
        scenario: scenario with its `model_error`.
        pairs: the true pairs.
        bodies: bodies that they touch.
        X_WO: pose of the object in contact.

    Raises:
        ScenarioError: a pair that is given as an object would be displaced.
    """
    error = scenario.model_error
    if error.face_offset == 0.0 and error.face_tilt == 0.0:
        return pairs
    modelled = list(pairs)
    for body in bodies:
        if not body.contacts:
            continue
        points, directions = feet(pairs[body.contacts[0]], X_WO)
        foot = points[0]
        outward = -directions[0]
        horizontal = np.cross([0.0, 0.0, 1.0], outward)
        size = norm(horizontal)
        tangent = triad(outward)[:, 0] if size < 1e-3 else horizontal / size
        axis = pin.exp3(error.face_tilt_about * outward) @ tangent
        tilt = pin.SE3(pin.exp3(error.face_tilt * axis), foot + error.face_offset * outward)
        for i in body.contacts:
            modelled[i] = _displace_contact(scenario, i, tilt * pin.SE3(np.eye(3), -foot))
    return tuple(modelled)


def _displace_contact(scenario: Scenario, i: int, X: pin.SE3) -> ContactPair:
    """Make contact i with its touched body displaced by X in the world.

    Args:
        scenario: scenario with the contacts.
        i: index of the contact.
        X: displacement of the body, X_WB_new = X X_WB.

    Raises:
        ScenarioError: the pair is given as an object.
    """
    spec = scenario.contacts[i]
    if isinstance(spec, OwnContactSpec):
        raise ScenarioError(
            f"model_error.face_offset and face_tilt: contact '{spec.name}' is a pair given as an "
            "object, which cannot be displaced; put another pair into the controller by install="
        )
    if isinstance(spec, OnFaceSpec):
        point = X.act(np.array(spec.face.point))
        normal = X.rotation @ np.array(spec.face.normal)
        face = spec.face.model_copy(update={"point": point, "normal": normal})
        return make_pair(spec.model_copy(update={"face": face}), X)
    X_WB = X * _body_poses(scenario)[getattr(spec, "body", "")]
    return make_pair(spec, X_WB, scenario.folder)


def _body_poses(scenario: Scenario) -> dict[str, pin.SE3]:
    """Pose X_WB of each body of `environment` in a scenario, by its name."""
    return {body.name: pose_of(body.pose) for body in scenario.environment}


def environment_bodies(scenario: Scenario) -> tuple[EnvironmentBody, ...]:
    """Make the bodies of a scenario: first the faces of single contacts, then `environment`.

    A face's frame has its origin in the given point and the normal as z axis (`triad`).

    Args:
        scenario: scenario with contacts and, perhaps, bodies of the environment.

    Raises:
        ModelError: a URDF is not found.
    """
    bodies: list[EnvironmentBody] = []

    def add(name: str, spec: Any, X_WB: pin.SE3, contacts: list[int]) -> None:
        """Append a body.

        Args:
            name: name of the body.
            spec: description with the fields `urdf` and `motion`.
            X_WB: initial pose.
            contacts: indices of the contacts that touch it.
        """
        urdf = robots.resolve_urdf(spec.urdf, scenario.folder)
        bodies.append(EnvironmentBody(name, urdf, X_WB, spec.motion, tuple(contacts)))

    for i, spec in enumerate(scenario.contacts):
        if isinstance(spec, OnFaceSpec):
            X_WB = pin.SE3(triad(np.array(spec.face.normal)), np.array(spec.face.point))
            add(f"face_{spec.name}", spec.face, X_WB, [i])
    # bodies that several contacts may touch, named in the contacts' key `body`
    for body in scenario.environment:
        contacts = [
            i
            for i, spec in enumerate(scenario.contacts)
            if getattr(spec, "body", None) == body.name
        ]
        add(body.name, body, pose_of(body.pose), contacts)
    return tuple(bodies)


def touched_bodies(bodies: Sequence[EnvironmentBody], count: int) -> tuple[int, ...]:
    """Index in `bodies` of the touched body of each contact.

    Args:
        bodies: bodies of the environment.
        count: number of contacts.
    """
    body_of_contact = {i: k for k, body in enumerate(bodies) for i in body.contacts}
    return tuple(body_of_contact[i] for i in range(count))


def placements_of(bodies: Sequence[EnvironmentBody], on: Sequence[int]) -> Array:
    """Initial pose X_WB of the touched body of each contact, (contacts, 4, 4).

    Args:
        bodies: bodies of the environment.
        on: index of the touched body of each contact.
    """
    return np.reshape([bodies[i].placement.homogeneous for i in on], (-1, 4, 4))


@dataclass(frozen=True)
class OwnMotion:
    """Motion of a body of the environment as objects, for `motion` in a scenario made in Python.

    Attributes:
        rail: motion in the plants: driven by a function of time, or free along the rail.
        body: response to forces in the controller's model; None: that of a face at rest.

    Example:
        >>> slope = osc.Rail(direction=[1, 0, -1], inertia=20.0, stiffness=5e3, damping=50.0)
        >>> motion = osc.OwnMotion(slope)  # a cart; the controller takes it for a face at rest
    """

    rail: Rail
    body: Body | None = None


def _own_motion(motion: FaceMotion | OwnMotion) -> OwnMotion:
    """Convert the description of a body's motion in a scenario to objects.

    A conveyor is driven along its rail by a prescribed motion; every other body moves along its
    rail by forces, with inertia, spring and damper.

    Args:
        motion: keys of the scenario, or objects, which are returned.

    Returns:
        Rail of the body in the plant, and the body as the controller knows it.
    """
    if isinstance(motion, OwnMotion):
        return motion
    if isinstance(motion, ConveyorSpec):
        turn = motion.turn
        axis, through = np.zeros((2, 3)) if turn is None else np.array((turn.axis, turn.through))
        driven = partial(_commanded_motion, motion)
        return OwnMotion(Rail(np.array(motion.direction), axis, through, driven), Conveyor())
    fields = motion.model_dump(exclude={"type", "mass"})
    if isinstance(motion, CartSpec):
        fields["inertia"] = motion.mass
    rail = Rail(**fields)
    return OwnMotion(rail, Guided(rail))


def _commanded_motion(motion: ConveyorSpec, t: float) -> tuple[Array, Array, Array]:
    """Travel (m) and angle (rad) of a driven body, (2,), with first and second derivatives.

    Args:
        motion: signals of the body.
        t: time (s).
    """
    rotation_signals = () if motion.turn is None else motion.turn.signals
    travel_and_angle = (sums(motion.signals, t), sums(rotation_signals, t))
    positions, rates, accelerations = np.array(travel_and_angle).T
    return positions, rates, accelerations


def rails(bodies: Sequence[EnvironmentBody]) -> list[Rail]:
    """Rail of each body in the plant, by which it moves.

    Args:
        bodies: bodies of the environment.

    Raises:
        ScenarioError: a driven body does not start where the contacts touch.
    """
    body_rails = [
        Rail() if body.motion is None else _own_motion(body.motion).rail for body in bodies
    ]
    for body, rail in zip(bodies, body_rails, strict=True):
        if rail.motion is not None:
            (travel, angle), (speed, rate), _ = rail.motion(0.0)
            if max(map(abs, (travel, angle, speed, rate))) > 1e-9:
                raise ScenarioError(
                    f"the motion of '{body.name}' starts at {travel:g} m with {speed:g} m/s and "
                    f"{angle:g} rad with {rate:g} rad/s, away from where the contacts touch; give "
                    "sines a ramp, or use minimum_jerk"
                )
    return body_rails


def known_bodies(bodies: Sequence[EnvironmentBody], contacts: int, how: str) -> list[Body | None]:
    """Touched body at each contact in the controller's model; None for an unyielding body at rest.

    Args:
        bodies: bodies of the environment.
        contacts: number of contacts.
        how: value of `model_error.environment`: "known"; "ignored", all bodies are at rest; or
            "yielding", bodies on a translation with a spring yield, and all others are at rest.
    """
    models: list[Body | None] = [None] * contacts
    for body in bodies:
        model = None
        if body.motion is not None and how != "ignored":
            model = _own_motion(body.motion).body
        if how == "yielding":
            rail = model.rail if isinstance(model, Guided) else Rail()
            is_sprung = rail.joints == [0] and rail.stiffness > 0.0  # a translation with a spring
            model = Yielding() if is_sprung else None
        for i in body.contacts:
            models[i] = model
    return models


def tracked(
    pairs: Sequence[ContactPair], object_urdf: Path, bodies: Sequence[EnvironmentBody]
) -> tuple[TrackedContact, ...]:
    """Contacts detected from the collision geometry, with the names of the declared contacts.

    Args:
        pairs: declared contacts.
        object_urdf: file of the object.
        bodies: bodies of the environment.

    Raises:
        ScenarioError: several contacts are on one body, so that they cannot be distinguished.
    """
    object_shapes = collision_shapes(object_urdf)
    contacts: dict[int, TrackedContact] = {}
    for body in bodies:
        if len(body.contacts) > 1:
            names = ", ".join(pairs[i].name for i in body.contacts)
            raise ScenarioError(
                f"control.contacts: detected finds all that touches '{body.name}' as one contact, "
                f"but {names} are on it; declare one contact for each body, or use declared"
            )
        body_shapes = [
            CollisionShape(part.name, part.shape, body.placement * part.placement)
            for part in collision_shapes(body.urdf[0])
        ]
        for i in body.contacts:
            contacts[i] = TrackedContact(object_shapes, body_shapes, pairs[i].name)
    return tuple(contacts[i] for i in range(len(pairs)))
