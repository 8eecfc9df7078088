"""Contact pairs and bodies of the environment, made from a scenario.

Every pair is built in the world's coordinates at the start: its environment frame E coincides with
the world while the body it is on stands where it began.
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
from osc_contact.lab.scenarios.signals import total
from osc_contact.spatial import Array, norm

_STEP = 1e-6  #: m, rad; by so much an object is moved to see its gaps change


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


def urdf_of(scenario: Scenario, part: Any) -> Path:
    """The file of an arm, or of the object, of a scenario."""
    return robots.resolve_urdf(part.urdf, scenario.folder)[0]


def pose_of(spec: PoseSpec) -> pin.SE3:
    """The pose that a scenario gives."""
    return pin.SE3(pin.rpy.rpyToMatrix(*spec.rpy), np.array(spec.xyz))


def build_pairs(scenario: Scenario) -> tuple[ContactPair, ...]:
    """The contact pairs of a scenario, in its order."""
    poses = _body_poses(scenario)
    world = pin.SE3.Identity()
    return tuple(
        spec.pair
        if isinstance(spec, OwnContactSpec)
        else make_pair(spec, poses.get(getattr(spec, "body", ""), world), scenario.folder)
        for spec in scenario.contacts
    )


def require_own_pairs(scenario: Scenario, X_WO: pin.SE3) -> None:
    """Refuse pairs given as objects whose N does not go with their gaps: d gaps/dt = −NᵀV.

    Args:
        scenario: scenario with its contacts. X_WO: pose near which they are to touch.

    Raises:
        ScenarioError: with the gaps' rates, and the cure.
    """
    for spec in scenario.contacts:
        if not isinstance(spec, OwnContactSpec):
            continue
        N = np.asarray(spec.pair.contact(X_WO, np.zeros(6)).N)
        before = np.asarray(spec.pair.gaps(X_WO), dtype=float)
        if N.shape != (6, len(before)):
            raise ScenarioError(
                f"contact '{spec.name}': N has shape {N.shape}, and gaps gives {len(before)} "
                "numbers; there is one column of N (6,) for each gap"
            )
        for j, column in enumerate(N.T):
            V = _STEP * column / max(norm(column), 1e-12)
            rate = (spec.pair.gaps(moved(X_WO, V))[j] - before[j]) / _STEP
            expected = -column @ V / _STEP
            if abs(rate - expected) > 0.5 * abs(expected):
                raise ScenarioError(
                    f"contact '{spec.name}': along column {j + 1} of its N the gap changes by "
                    f"{rate:.3g} m per metre instead of {expected:.3g}: N points into the "
                    "environment and gaps shrink along it; "
                    + (
                        "reverse the sign of N or of gaps"
                        if rate * expected < 0.0
                        else "check both"
                    )
                )


def misplaced(
    scenario: Scenario,
    pairs: tuple[ContactPair, ...],
    bodies: Sequence[EnvironmentBody],
    X_WO: pin.SE3,
) -> tuple[ContactPair, ...]:
    """The pairs in the controller's model, each body displaced by the scenario's error.

    A body is modelled `face_offset` nearer to the object along the first line of force at
    it, and turned by `face_tilt` about an axis across that line, through where it meets the body.

    Args:
        scenario: scenario with its `model_error`. pairs: where they are. bodies: that they are on.
        X_WO: pose of the object in contact.
    """
    error = scenario.model_error
    if error.face_offset == 0.0 and error.face_tilt == 0.0:
        return pairs
    found = list(pairs)
    for body in bodies:
        if not body.contacts:
            continue
        (foot, *_), (inward, *_) = feet(pairs[body.contacts[0]], X_WO)
        outward = -inward
        across = np.cross([0.0, 0.0, 1.0], outward)
        size = norm(across)
        across = triad(outward)[:, 0] if size < 1e-3 else across / size
        about = pin.exp3(error.face_tilt_about * outward) @ across
        turn = pin.SE3(pin.exp3(error.face_tilt * about), foot + error.face_offset * outward)
        for i in body.contacts:
            found[i] = _displaced(scenario, i, turn * pin.SE3(np.eye(3), -foot))
    return tuple(found)


def _displaced(scenario: Scenario, i: int, X: pin.SE3) -> ContactPair:
    """Contact i with the body that it is on displaced by X in the world."""
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
    return {body.name: pose_of(body.pose) for body in scenario.environment}


def environment_bodies(scenario: Scenario) -> tuple[EnvironmentBody, ...]:
    """The bodies of a scenario: those that bring one face for one contact, then the shared ones.

    Raises:
        ModelError: a URDF is not found.
    """
    bodies: list[Any] = []
    for i, spec in enumerate(scenario.contacts):
        if isinstance(spec, OnFaceSpec):
            placement = pin.SE3(triad(np.array(spec.face.normal)), np.array(spec.face.point))
            bodies.append((f"face_{spec.name}", spec.face, placement, [i]))
    for body in scenario.environment:
        on = [i for i, c in enumerate(scenario.contacts) if getattr(c, "body", None) == body.name]
        bodies.append((body.name, body, pose_of(body.pose), on))
    return tuple(
        EnvironmentBody(
            name, robots.resolve_urdf(spec.urdf, scenario.folder), X_WB, spec.motion, tuple(on)
        )
        for name, spec, X_WB, on in bodies
    )


def touched_bodies(bodies: Sequence[EnvironmentBody], count: int) -> tuple[int, ...]:
    """The body of each contact, a number of `bodies`.

    Args:
        bodies: bodies of the environment. count: number of contacts.
    """
    of = {i: k for k, body in enumerate(bodies) for i in body.contacts}
    return tuple(of[i] for i in range(count))


def placements_of(bodies: Sequence[EnvironmentBody], on: Sequence[int]) -> Array:
    """(contacts, 4, 4) X_WB at the start, of the body of each contact.

    Args:
        bodies: bodies of the environment. on: the body of each contact.
    """
    return np.reshape([bodies[i].placement.homogeneous for i in on], (-1, 4, 4))


@dataclass(frozen=True)
class OwnMotion:
    """Motion of a body of the environment as objects, for `motion` in a scenario made in Python.

    Attributes:
        rail: how the plants move it; driven by any function of time, or free.
        body: its answer to forces in the controller's model; None: like a face at rest.

    Example:
        >>> slope = osc.Rail(direction=[1, 0, -1], inertia=20.0, stiffness=5e3, damping=50.0)
        >>> motion = osc.OwnMotion(slope)  # a cart; the controller takes it for a face at rest
    """

    rail: Rail
    body: Body | None = None


def _own_motion(motion: FaceMotion | OwnMotion) -> OwnMotion:
    """Convert the description of a body's motion in a scenario to objects."""
    if isinstance(motion, OwnMotion):
        return motion
    if isinstance(motion, ConveyorSpec):
        turn = motion.turn
        axis, through = np.zeros((2, 3)) if turn is None else np.array((turn.axis, turn.through))
        driven = partial(_commanded, motion)
        return OwnMotion(Rail(np.array(motion.direction), axis, through, driven), Conveyor())
    given = motion.model_dump(exclude={"type", "mass"})
    if isinstance(motion, CartSpec):
        given["inertia"] = motion.mass
    rail = Rail(**given)
    return OwnMotion(rail, Guided(rail))


def _commanded(motion: ConveyorSpec, t: float) -> tuple[Array, Array, Array]:
    """Travel (m) and angle (rad) of a driven body at time t, (2,), with their first two rates."""
    turn = () if motion.turn is None else motion.turn.signals
    s, rates, second = np.array((total(motion.signals, t), total(turn, t))).T
    return s, rates, second


def rails(bodies: Sequence[EnvironmentBody]) -> list[Rail]:
    """Rail of each body in the plant, by which it moves.

    Raises:
        ScenarioError: a driven body does not start where the contacts touch.
    """
    found = [Rail() if body.motion is None else _own_motion(body.motion).rail for body in bodies]
    for body, rail in zip(bodies, found, strict=True):
        if rail.motion is not None:
            (travel, angle), (speed, rate), _ = rail.motion(0.0)
            if max(map(abs, (travel, angle, speed, rate))) > 1e-9:
                raise ScenarioError(
                    f"the motion of '{body.name}' starts at {travel:g} m with {speed:g} m/s and "
                    f"{angle:g} rad with {rate:g} rad/s, away from where the contacts touch; give "
                    "sines a ramp, or use minimum_jerk"
                )
    return found


def known_bodies(bodies: Sequence[EnvironmentBody], contacts: int, how: str) -> list[Body | None]:
    """Touched body at each contact in the controller's model; None for an unyielding body at rest.

    Args:
        bodies: bodies of the environment. contacts: number of contacts.
        how: value of `model_error.environment`.
    """
    known: list[Body | None] = [None] * contacts
    for body in bodies:
        answer = None
        if body.motion is not None and how != "ignored":
            answer = _own_motion(body.motion).body
        if how == "yielding":
            rail = answer.rail if isinstance(answer, Guided) else Rail()
            sprung = rail.joints == [0] and rail.stiffness > 0.0
            answer = Yielding() if sprung else None
        for i in body.contacts:
            known[i] = answer
    return known


def tracked(
    pairs: Sequence[ContactPair], object_urdf: Path, bodies: Sequence[EnvironmentBody]
) -> tuple[TrackedContact, ...]:
    """Contacts detected from the collision geometry, with the names of the declared contacts.

    Args:
        pairs: declared contacts. object_urdf: file of the object. bodies: bodies of the
            environment.

    Raises:
        ScenarioError: several contacts are on one body, so that they cannot be distinguished.
    """
    held = collision_shapes(object_urdf)
    found = {}
    for body in bodies:
        if len(body.contacts) > 1:
            names = ", ".join(pairs[i].name for i in body.contacts)
            raise ScenarioError(
                f"control.contacts: detected finds all that touches '{body.name}' as one contact, "
                f"but {names} are on it; declare one contact for each body, or use declared"
            )
        shapes = collision_shapes(body.urdf[0])
        face = [CollisionShape(s.name, s.shape, body.placement * s.placement) for s in shapes]
        for i in body.contacts:
            found[i] = TrackedContact(held, face, pairs[i].name)
    return tuple(found[i] for i in range(len(pairs)))
