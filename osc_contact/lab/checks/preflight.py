"""Checks of a task before it runs: rules on the scenario, its contacts, plant and sensors.

A rule is a function that yields a quantity, with a limit for a warning, a limit for refusal, and
the sentence of the finding. A task is given by a file, or in Python.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from osc_contact.contacts.detection.features import collision_shapes, nearest
from osc_contact.contacts.feet import feet
from osc_contact.contacts.pairs.pair import (
    ContactPair,
    has_known_points,
    has_place,
    pushes_only,
)
from osc_contact.control.controller import Controller
from osc_contact.control.controller_settings import choose_reading
from osc_contact.errors import InvalidInputError, ModelError, OscContactError, ScenarioError
from osc_contact.interface import Reference, Robot
from osc_contact.lab.checks.joint_rules import JOINT_RULES
from osc_contact.lab.checks.spring_poles import trial_controller
from osc_contact.lab.rig.contacts import urdf_of
from osc_contact.lab.rig.landings import landings
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.scenarios.bodies import CartSpec
from osc_contact.loop.arm_rules import weights
from osc_contact.loop.reference_rules import pulls
from osc_contact.loop.robot_task import task_of_robot
from osc_contact.loop.rules import Finding, Task, Values, doubt, findings, rounded, rule
from osc_contact.loop.start_rules import judge_motion, judge_robot
from osc_contact.plan.checks import require_plan
from osc_contact.spatial import Array, norm

MOST_TICKS = 100_000  #: largest number of references that are taken from an iterator
BESIDE_M = 0.005  #: largest distance of a contact from the geometry of body and object (m)
PROBE_M = 0.002  #: distance before and behind a contact at which geometry is probed (m)
#: Keys of contacts whose vectors point out of the body, or out of the object.
OUTWARD = {"body": ("face_normal", "edge_outward"), "object": ("normal", "edge_outward")}
_logger = logging.getLogger("osc_contact.preflight")


def task_of_rig(rig: Rig) -> Task:
    """Make the task of a scenario: references, and the true chain and contacts of its plant.

    The rules of `osc_contact/loop/` compare these before a run. References are those of 2000
    instants, which takes less time than those of all ticks.

    Args:
        rig: rig of the scenario.
    """
    scenario = rig.scenario
    # desired poses, twists and forces at some instants, without running the references
    times, plan = rig.references.overview
    tare = scenario.tare
    return Task(
        chain=rig.chain,
        pairs=rig.pairs,
        gains=rig.gains,
        dt=1.0 / scenario.control.rate,
        posture=rig.q_contact,
        safety=rig.safety,
        q=rig.q_start,
        q_contact=rig.q_contact,
        state=rig.state,
        contact=rig.contact,
        times=times,
        poses=plan.X_WD,
        forces=plan.commands,
        active=plan.active,
        trial=partial(trial_controller, rig),
        squeezes=np.full(len(times), abs(plan.squeeze_d)),
        commanded=plan.V_D,
        every=lambda period: rig.references.each(int(scenario.duration / period), period),
        force_names=[f"force.{name}" for name in rig.force_names],
        owners=rig.owners,
        rests=[rig.bodies[body].motion is None for body in rig.on],
        bound=rig.life is None,
        kept_from=0.0 if tare is None else tare.duration + tare.approach,
    )


def preflight(
    task: Rig | Robot,
    controller: Controller | None = None,
    references: Iterable[Reference] = (),
) -> tuple[Finding, ...]:
    """Errors and warnings on a task, found before it runs.

    For every task: motions are compared with the contacts, the reach of the arms, ranges and speeds
    of the joints; forces with the contacts; forces and weights with the motors; the control rate
    with the gains. For a scenario also: the start pose with the given one; faces with object and
    arms; contacts with the touched bodies; carts; flexible joints with the joint torque loop;
    masses and sensors with the tare. For a robot: the wrist readings with the load; the first
    reference with the pose; the rate of X_WD with V_D; contacts, tool and masses with the `scene`
    of the robot, if it has one (`MujocoRobot`). `run_loop` checks a robot by itself.

    Args:
        task: rig of a scenario, see `build_rig`; or a robot at rest where the run will start, which
            is measured.
        controller: controller of the robot; it is not changed.
        references: references of the run, one for each tick; at most the first 100,000 are checked.
            Of an iterator these are consumed: give `run_loop` a new one.

    Raises:
        InvalidInputError: a robot without controller or references, or with another number of
            desired forces than the contacts have.
    """
    if isinstance(task, Rig):
        return (*findings(MODEL_RULES, task), *judge_rig(task))
    if controller is None:
        raise InvalidInputError(
            "preflight takes the rig of a scenario, or a robot with its controller and references"
        )
    return judge_robot(task_of_robot(task, controller, list(islice(references, MOST_TICKS))))


def judge_rig(rig: Rig) -> tuple[Finding, ...]:
    """Findings of `preflight` that do not depend on the errors of the controller's model.

    They can be shared by rigs that differ in `model_error` only.

    Args:
        rig: rig of a scenario.
    """
    task = task_of_rig(rig)
    return (*findings(RIG_RULES, rig), *findings((weights, pulls), task), *judge_motion(task))


def require_ready(rig: Rig, robot: Sequence[Finding] | None = None) -> list[str]:
    """Refuse a rig that cannot run; log warnings and return their sentences.

    Args:
        rig: rig of the task.
        robot: findings of `judge_rig`, if it was called before; None: it is called.

    Raises:
        ScenarioError: the task cannot run; the message has all errors that `preflight` finds.
    """
    all_findings = [*findings(MODEL_RULES, rig), *(judge_rig(rig) if robot is None else robot)]
    refusals = [finding.text for finding in all_findings if finding.refused]
    if refusals:
        raise ScenarioError("\n".join(refusals))
    for finding in all_findings:
        _logger.warning("doubtful: %s", finding.text)
    return [finding.text for finding in all_findings]


# --- a scenario ---------------------------------------------------------------------------------


@rule(
    "arm '{name}' has no wrist sensor, and contact forces are controlled by what wrist sensors "
    "read; name a frame of its URDF as wrist_sensor"
)
def sensors(rig: Rig) -> Values:
    """Find arms without a wrist sensor in a task with contacts; the value is 1 for such an arm."""
    for arm in rig.chain.arms if rig.pairs else ():
        yield arm.wrist_sensor is None, {"name": arm.name}


@doubt(
    "{wrong}, and nothing zeroes the wrist sensors: their errors are taken for contact "
    "force; set tare={{}} to zero them in free space before contact"
)
def tare(rig: Rig) -> Values:
    """Number of known errors of masses and wrist sensors that no tare removes.

    Exact plants have no tare.

    Args:
        rig: rig of the scenario.
    """
    scenario = rig.scenario
    if not rig.pairs or scenario.tare is not None or scenario.plant.exact:
        return
    error = scenario.model_error
    wrist = scenario.sensors.wrist
    errors = [
        f"model_error.{key} is {getattr(error, key):g}"
        for key in ("object_mass", "arm_mass", "hidden_mass")
        if getattr(error, key) != type(error).model_fields[key].default
    ]
    if wrist is not None:
        for key, unit in (("force", "N"), ("torque", "N m")):
            bias = getattr(wrist, key).bias
            if bias > 0.0:
                errors.append(f"sensors.wrist.{key} has a bias of {bias:g} {unit}")
    yield len(errors), {"wrong": " and ".join(errors)}


@doubt(
    "plant.friction is {value:g}, the controller's model has none, and the filter that reads "
    "forces takes it for normal force; {other}give control.friction={{mu: …}}"
)
def friction(rig: Rig) -> Values:
    """Friction coefficient of the plant that the filter of fig. 5 attributes to normal forces.

    Args:
        rig: rig of the scenario.
    """
    control = rig.scenario.control
    if rig.scenario.plant.exact or control.friction is not None or not rig.pairs:
        return
    if choose_reading(control.force.reading, rig.pairs) == "filter":
        slides = any(map(has_known_points, rig.pairs))
        other = "set control.force.reading=least_squares, or " if slides else ""
        yield rig.scenario.plant.friction, {"other": other}


@rule("plan: {why}")
def planned(rig: Rig) -> Values:
    """Find stages of a plan that the controller cannot carry out; the value is 1 for such a one."""
    if rig.scenario.plan is None:
        return
    plan = rig.scenario.plan.made()
    try:
        require_plan(plan.stages, plan.largest, rig.controller(), rig.state.X_WO)
    except OscContactError as error:
        yield 1.0, {"why": error}


@doubt(
    "nothing balances the cart of '{name}': weight, preload and contact forces leave {left:.3g} N "
    "along its rail at the end, which moves it by {value:.3g} m in {duration:g} s; give it a "
    "preload of {preload:.3g} N, or a stiffness",
    0.2,
)
def carts(rig: Rig) -> Values:
    """Largest travel (m) of carts on their rails under the commanded forces, weight and preload.

    The motion m s̈ + c ṡ + k s = force of each cart (position s on its rail, m) is integrated over
    the run with 2000 steps.

    Args:
        rig: rig of the scenario.

    Yields:
        Largest |s| of each cart, with the words of the finding.
    """
    t, plan = rig.references.overview
    dt = t[1] - t[0]
    for body in rig.bodies:
        cart = body.motion
        if not isinstance(cart, CartSpec):
            continue
        m = cart.mass
        c = cart.damping
        k = cart.stiffness
        u = np.array(cart.direction)
        forces = np.full(len(t), cart.preload - 9.81 * m * u[2])
        for i in body.contacts:
            _, directions = feet(rig.pairs[i], rig.state.X_WO)
            forces += plan.commands[:, rig.owners == i] @ (directions @ u)
        s = 0.0
        speed = 0.0
        largest = 0.0
        for force in forces:  # implicit in spring and damper: stable for any of them
            speed = (m * speed + dt * (force - k * s)) / (m + dt * c + dt**2 * k)
            s += dt * speed
            largest = max(largest, abs(s))
        words = {
            "name": body.name,
            "left": forces[-1],
            "duration": rig.scenario.duration,
            "preload": cart.preload - forces.mean(),
        }
        yield largest, words


@doubt("{sentence}, {value:.2g} times its command; lower control.life.speed", 2.0)
def landing(rig: Rig) -> Values:
    """Expected peak forces of contacts that are open at the start, over their commands."""
    for expected in landings(rig):
        if expected.free and expected.command > 0.0:
            yield expected.peak / expected.command, {"sentence": expected.sentence}


# --- places: a scenario ---------------------------------------------------------------------------


@rule(
    "the normal of the face of contact '{name}' looks away from the robot: the object and all arm "
    "tips are {mm:.0f} mm or more behind it; the normal points out of the face, towards the "
    "object: reverse contacts.{name}.face.normal"
)
def normals(rig: Rig) -> Values:
    """Least distance (m) by which object and arm tips are behind a contact's own face.

    Args:
        rig: rig of the scenario.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    points = np.array([rig.state.X_WO.translation, *rig.state.grasp_points])
    for spec in rig.scenario.contacts:
        face = getattr(spec, "face", None)
        if face is not None:
            depth = np.min((np.array(face.point) - points) @ face.normal)
            yield depth, {"name": spec.name}


@rule(
    "to touch its contacts the object starts {mm:.0f} mm away from object.pose, at {where} m, "
    "turned by {turned:.1f} deg, instead of {given} m; move the faces to the object, or "
    "object.pose and posture to the faces",
    0.02,
    0.1,
)
def start(rig: Rig) -> Values:
    """Distance (m) between the given start pose and the pose in contact.

    The largest distance of the object's origin and its contact points counts.

    Args:
        rig: rig of the scenario.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    X_given = rig.X_given
    X = rig.state.X_WO
    points = [X.translation]
    for pair in rig.pairs:
        if has_place(pair):
            points.extend(feet(pair, X)[0])
    distance = max(norm(p - X_given.act(X.actInv(p))) for p in points)
    words = {
        "where": rounded(X.translation),
        "turned": np.rad2deg(norm(pin.log3(X_given.rotation.T @ X.rotation))),
        "given": rounded(X_given.translation),
    }
    yield distance, words


@dataclass(frozen=True)
class _Solid:
    """Body with its collision shapes, for distances from points of the world.

    Attributes:
        name: name of the body in messages, in quotation marks.
        urdf: file of its shapes.
        placement: pose of the body in the world.
    """

    name: str
    urdf: Path
    placement: pin.SE3

    @cached_property
    def shapes(self) -> list[tuple[Any, pin.SE3]]:
        """Collision shapes (coal) of the body's file with their poses in the world.

        It is empty where the file cannot be read, or has a shape that is not convex: the check of
        clearances leaves this body out.
        """
        try:
            parts = collision_shapes(self.urdf)
            return [(part.shape, self.placement * part.placement) for part in parts]
        except (InvalidInputError, ModelError):
            return []

    def distance(self, point: Array) -> float:
        """Distance (m) of a point (3,) in the world from the body; not positive inside."""
        ball = coal.Sphere(1e-6)
        X_ball = pin.SE3(np.eye(3), point)
        return min(nearest(shape, X, ball, X_ball).distance for shape, X in self.shapes)


def _placed_contacts(rig: Rig) -> Iterator[tuple[int, ContactPair, dict[str, _Solid]]]:
    """Yield the contacts that have a place, with the solids that they are between.

    Args:
        rig: rig of the scenario.

    Yields:
        Index of the contact; pair; solids by kind, "body" and "object".
    """
    solid_object = _Solid("the object", urdf_of(rig.scenario, rig.scenario.object), rig.state.X_WO)
    bodies = [_Solid(f"'{body.name}'", body.urdf[0], body.placement) for body in rig.bodies]
    for i, pair in enumerate(rig.pairs):
        if has_place(pair):
            yield i, pair, {"body": bodies[rig.on[i]], "object": solid_object}


@rule(
    "contact '{name}' would touch at {point} m, {mm:.0f} mm beside {solid.name}, whose collision "
    "geometry ends before; move the face, or the contact's place on the object",
    BESIDE_M,
)
def beside(rig: Rig) -> Values:
    """Distance (m) of contact points from the geometry of body and object.

    Faces of exact plants are unbounded, so that nothing is compared. One finding for each contact
    and solid is enough.

    Args:
        rig: rig of the scenario.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    if rig.scenario.plant.exact:
        return
    for _, pair, solids in _placed_contacts(rig):
        points, _ = feet(pair, rig.state.X_WO)
        for solid in solids.values():
            for point in points if solid.shapes else ():
                distance = solid.distance(point)
                yield distance, {"name": pair.name, "point": rounded(point, 3), "solid": solid}
                if distance > BESIDE_M:
                    break


@rule(
    "the force of contact '{name}' would push out of {solid.name}, whose collision geometry is "
    "on the side that {key} points to; it must point out of it: reverse contacts.{name}.{key}",
    PROBE_M,
)
def inverted(rig: Rig) -> Values:
    """Increase (m) of the distance from a solid along the direction into it: reversed normals.

    The distance from the body decreases along the direction of force, that from the object against
    it, unless a normal is reversed.

    Args:
        rig: rig of the scenario.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    for i, pair, solids in _placed_contacts(rig):
        if not pushes_only(pair):
            continue
        points, directions = feet(pair, rig.state.X_WO)
        spec = rig.scenario.contacts[i]
        for kind, solid in solids.items():
            key = next((key for key in OUTWARD[kind] if hasattr(spec, key)), None)
            if key is None or not solid.shapes:
                continue
            if max(solid.distance(point) for point in points) >= BESIDE_M:
                continue
            inward = PROBE_M * directions * (1.0 if kind == "body" else -1.0)
            increase = min(
                solid.distance(point + step) - solid.distance(point - step)
                for point, step in zip(points, inward, strict=True)
            )
            yield increase, {"name": pair.name, "solid": solid, "key": key}
            if increase > PROBE_M:
                break


@rule(
    "the object starts {mm:.0f} mm inside {name}, with its contacts just touching: a normal is "
    "reversed, or the collision geometry is larger than the contacts state; reverse the normals of "
    "its contacts, or mend the geometry",
    0.005,
)
def inside(rig: Rig) -> Values:
    """Penetration (m) of the object into a body that reversed normals do not explain.

    Args:
        rig: rig of the scenario.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    if rig.scenario.plant.exact or any(normals.findings(rig)) or any(inverted.findings(rig)):
        return
    touched = {solids["body"].name: solids for _, _, solids in _placed_contacts(rig)}
    for name, solids in touched.items():
        object_shapes = solids["object"].shapes
        for shape, X in solids["body"].shapes if object_shapes else ():
            depth = max(
                -nearest(shape, X, own_shape, X_own).distance for own_shape, X_own in object_shapes
            )
            yield depth, {"name": name}


PLACE_RULES = (normals, inverted, inside, start, beside)  #: rules on the places of contacts
#: All rules on a scenario; a new rule is added to this list. The rules on every task and on a robot
#: are listed in `osc_contact.loop.start_rules`.
RIG_RULES = (sensors, planned, *JOINT_RULES, *PLACE_RULES, friction, carts, landing)
MODEL_RULES = (tare,)  #: rules on a scenario that depend on the errors of the controller's model
