"""What is wrong with a task before it runs: a table of rules on what can be compared beforehand.

A rule is one function that gives a quantity, under the limits from which it is doubtful and
refused, and the sentence of the finding. A task is given by a file, or in Python.
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
    has_place,
    knows_where_it_slides,
    pushes_only,
)
from osc_contact.control.controller import Controller
from osc_contact.control.controller_settings import choose_reading
from osc_contact.dynamics.chain_state import modes
from osc_contact.errors import InvalidInputError, ModelError, OscContactError, ScenarioError
from osc_contact.interface import Measurement, Reference, Robot, Touched
from osc_contact.lab.rig import hardware
from osc_contact.lab.rig.contacts import urdf_of
from osc_contact.lab.rig.rig import Rig, landings
from osc_contact.lab.scenarios.bodies import CartSpec
from osc_contact.loop.arm_rules import weights
from osc_contact.loop.reference_rules import pulls
from osc_contact.loop.robot_task import task_of_robot
from osc_contact.loop.rules import Finding, Task, Values, doubt, findings, rounded, rule
from osc_contact.loop.start_rules import judge_motion, judge_robot
from osc_contact.spatial import Array, norm

MOST_TICKS = 100_000  #: references that are taken from an iterator
NOISY = 0.05  #: of a mean command; more of it by the noise of encoders is doubtful
BESIDE_M = 0.005  #: a contact further than this beside body or object is refused
PROBE_M = 0.002  #: how far in front of and behind a contact geometry is looked for
OUTWARD = {"body": ("face_normal", "edge_outward"), "object": ("normal", "edge_outward")}
_logger = logging.getLogger("osc_contact.preflight")


def task_of_rig(rig: Rig) -> Task:
    """The task of a scenario: its plan, and the chain and contacts of its plant."""
    scenario = rig.scenario
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
        trial=partial(_trial, rig),
        squeezes=np.full(len(times), abs(plan.squeeze_d)),
        commanded=plan.V_D,
        every=lambda period: rig.references.each(int(scenario.duration / period), period),
        force_names=[f"force.{name}" for name in rig.force_names],
        owners=rig.owners,
        rests=[rig.bodies[body].motion is None for body in rig.on],
        bound=rig.life is None,
        kept_from=0.0 if tare is None else tare.duration + tare.approach,
    )


def _trial(rig: Rig) -> tuple[Controller, Measurement]:
    """Controller of a scenario with its contacts engaged, and a measurement at rest in contact."""
    controller = rig.controller()
    controller.engaged = True
    count = len(rig.pairs)
    still = np.zeros((count, 6))
    return controller, Measurement(
        rig.q_contact,
        np.zeros(rig.chain.nq),
        np.zeros((len(rig.chain.arms), 6)),
        touched=Touched(np.tile(np.eye(4), (count, 1, 1)), still, still),
    )


def preflight(
    task: Rig | Robot,
    controller: Controller | None = None,
    references: Iterable[Reference] = (),
) -> tuple[Finding, ...]:
    """Everything that is wrong or doubtful about a task, before it runs.

    Of every task are compared: motions with the contacts, the arms' reach, the joints' ranges and
    speeds, forces with the contacts, forces and weights with the motors, the control rate with the
    gains. Of a scenario, too:
    the start pose with the scenario's, faces with object and arms, contacts with the bodies they
    are on, carts, springs in the joints with their loop, masses and sensors with the tare. Of a
    robot: the wrists with the load they carry, the first reference with the pose, the rate of
    X_WD with V_D; where the robot has a `scene` (`MujocoRobot`), also contacts, tool and masses
    with that. `run_loop` makes the checks of a robot by itself.

    Args:
        task: a scenario, see `build_rig`; or a robot at rest where the run will start, which is
            measured once.
        controller: controller of the robot; it is not changed.
        references: of the run, as for `run_loop`, which needs them anew; at most the first 100,000
            are looked at.

    Raises:
        InvalidInputError: a robot without controller or references, or forces that do not fit the
            contacts.
    """
    if isinstance(task, Rig):
        return (*findings(MODEL_RULES, task), *judge_rig(task))
    if controller is None:
        raise InvalidInputError(
            "preflight takes the rig of a scenario, or a robot with its controller and references"
        )
    return judge_robot(task_of_robot(task, controller, list(islice(references, MOST_TICKS))))


def judge_rig(rig: Rig) -> tuple[Finding, ...]:
    """Findings of `preflight` that are the same whatever the controller's model has wrong."""
    of = task_of_rig(rig)
    return (*findings(RIG_RULES, rig), *findings((weights, pulls), of), *judge_motion(of))


def require_ready(rig: Rig, robot: Sequence[Finding] | None = None) -> list[str]:
    """The doubts about a task, which are logged too.

    Args:
        rig: rig of the task. robot: what `judge_rig` has found, if it was called before.

    Raises:
        ScenarioError: it cannot run; with everything that `preflight` refuses.
    """
    found = [*findings(MODEL_RULES, rig), *(judge_rig(rig) if robot is None else robot)]
    refused = [one.text for one in found if one.refused]
    if refused:
        raise ScenarioError("\n".join(refused))
    for one in found:
        _logger.warning("doubtful: %s", one.text)
    return [one.text for one in found]


# --- a scenario ---------------------------------------------------------------------------------


@rule(
    "arm '{name}' has no wrist sensor, and contact forces are controlled by what wrist sensors "
    "read; name a frame of its URDF as wrist_sensor"
)
def sensors(rig: Rig) -> Values:
    """Arms that measure no force."""
    for arm in rig.chain.arms if rig.pairs else ():
        yield arm.wrist_sensor is None, {"name": arm.name}


@doubt(
    "{wrong}, and nothing zeroes the wrist sensors: their errors are taken for contact "
    "force; set tare={{}} to zero them in free space before contact"
)
def tare(rig: Rig) -> Values:
    """Weights that the wrists read and the model does not know; the exact plant has no tare."""
    scenario = rig.scenario
    if not rig.pairs or scenario.tare is not None or scenario.plant.exact:
        return
    error = scenario.model_error
    wrist = scenario.sensors.wrist
    wrong = [
        f"model_error.{key} is {getattr(error, key):g}"
        for key in ("object_mass", "arm_mass", "hidden_mass")
        if getattr(error, key) != type(error).model_fields[key].default
    ]
    for key, unit in {} if wrist is None else {"force": "N", "torque": "N m"}.items():
        bias = getattr(wrist, key).bias
        if bias > 0.0:
            wrong.append(f"sensors.wrist.{key} has a bias of {bias:g} {unit}")
    yield len(wrong), {"wrong": " and ".join(wrong)}


@doubt(
    "plant.friction is {value:g}, the controller's model has none, and the filter that reads "
    "forces takes it for normal force; {other}give control.friction={{mu: …}}"
)
def friction(rig: Rig) -> Values:
    """Friction that the filter of fig. 5 takes for normal force."""
    control = rig.scenario.control
    if rig.scenario.plant.exact or control.friction is not None or not rig.pairs:
        return
    if choose_reading(control.force.reading, rig.pairs) == "filter":
        slides = any(map(knows_where_it_slides, rig.pairs))
        other = "set control.force.reading=least_squares, or " if slides else ""
        yield rig.scenario.plant.friction, {"other": other}


@rule("{why}")
def springs(rig: Rig) -> Values:
    """Springs, or a joint torque loop, that cannot be."""
    try:
        hardware.torque_loop(rig.scenario, rig.chain, rig.springs)
    except OscContactError as error:
        yield 1.0, {"why": error}


@doubt(
    "the joint springs oscillate at {first:.3g} Hz (first mode, motors held), and no joint "
    "torque loop produces the commanded torques: below 100 Hz contact is lost; set "
    "control.joint_torque={{rate: {rate:g} kHz}}",
    -100.0,
)
def swinging(rig: Rig) -> Values:
    """Frequency of joints without a torque loop (−Hz)."""
    if any(springs.findings(rig)) or rig.scenario.control.joint_torque is not None:
        return
    if rig.springs is not None:
        found = modes(rig.state, rig.chain.actuated, rig.springs.stiffness)
        first = found[found > 0.0].min(initial=np.inf)
        yield -first, {"first": first, "rate": 1e-3 / rig.scenario.plant.step}


@doubt(
    "nothing balances the cart of '{name}': weight, preload and contact forces leave {left:.3g} N "
    "along its rail at the end, which moves it by {value:.3g} m in {duration:g} s; give it a "
    "preload of {preload:.3g} N, or a stiffness",
    0.2,
)
def carts(rig: Rig) -> Values:
    """Largest travel (m) of carts under the commanded forces."""
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
        push = np.full(len(t), cart.preload - 9.81 * m * u[2])
        for i in body.contacts:
            along = feet(rig.pairs[i], rig.state.X_WO)[1] @ u
            push += plan.commands[:, rig.owners == i] @ along
        s = speed = most = 0.0
        for force in push:  # implicit in spring and damper: stable for any of them
            speed = (m * speed + dt * (force - k * s)) / (m + dt * c + dt**2 * k)
            s += dt * speed
            most = max(most, abs(s))
        words = {
            "name": body.name,
            "left": push[-1],
            "duration": rig.scenario.duration,
            "preload": cart.preload - push.mean(),
        }
        yield most, words


@doubt("{sentence}, {value:.2g} times its command; lower control.life.speed", 2.0)
def landing(rig: Rig) -> Values:
    """Expected peaks of contacts that are still to be made, over their commands."""
    for one in landings(rig):
        if one.free and one.command > 0.0:
            yield one.peak / one.command, {"sentence": one.sentence}


# --- places: a scenario ---------------------------------------------------------------------------


@rule(
    "the normal of the face of contact '{name}' looks away from the robot: the object and all arm "
    "tips are {mm:.0f} mm or more behind it; the normal points out of the face, towards the "
    "object: reverse contacts.{name}.face.normal"
)
def normals(rig: Rig) -> Values:
    """Faces that bring their own plate and face away from the robot."""
    points = np.array([rig.state.X_WO.translation, *rig.state.grasp_points])
    for spec in rig.scenario.contacts:
        face = getattr(spec, "face", None)
        if face is not None:
            behind = np.min((np.array(face.point) - points) @ face.normal)
            yield behind, {"name": spec.name}


@rule(
    "to touch its contacts the object starts {mm:.0f} mm away from object.pose, at {where} m, "
    "turned by {turned:.1f} deg, instead of {given} m; move the faces to the object, or "
    "object.pose and posture to the faces",
    0.02,
    0.1,
)
def start(rig: Rig) -> Values:
    """A start pose that moved, at the object's origin or at a contact (m)."""
    given = rig.X_given
    now = rig.state.X_WO
    points = [now.translation]
    for pair in filter(has_place, rig.pairs):
        points.extend(feet(pair, now)[0])
    moved = max(norm(p - given.act(now.actInv(p))) for p in points)
    words = {
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
    def shapes(self) -> list[tuple[Any, pin.SE3]]:
        """Collision shapes of the body's file with their poses; empty unless all are convex."""
        try:
            return [(s.shape, self.placement * s.placement) for s in collision_shapes(self.urdf)]
        except (InvalidInputError, ModelError):
            return []

    def distance(self, point: Array) -> float:
        """Distance (m) of a point (3,) in the world from the body; not positive inside."""
        ball = coal.Sphere(1e-6), pin.SE3(np.eye(3), point)
        return min(nearest(*one, *ball).distance for one in self.shapes)


def _solids(rig: Rig) -> Iterator[tuple[int, ContactPair, dict[str, _Solid]]]:
    """Number and pair of each contact that has a place, with the body and the object it is on."""
    held = _Solid("the object", urdf_of(rig.scenario, rig.scenario.object), rig.state.X_WO)
    bodies = [_Solid(f"'{body.name}'", body.urdf[0], body.placement) for body in rig.bodies]
    for i, pair in enumerate(rig.pairs):
        if has_place(pair):
            yield i, pair, {"body": bodies[rig.on[i]], "object": held}


@rule(
    "contact '{name}' would touch at {point} m, {mm:.0f} mm beside {solid.name}, whose collision "
    "geometry ends before; move the face, or the contact's place on the object",
    BESIDE_M,
)
def beside(rig: Rig) -> Values:
    """Contacts beside their bodies or the object; those of the exact plant have no ends."""
    for _, pair, solids in () if rig.scenario.plant.exact else _solids(rig):
        for solid in solids.values():
            for point in feet(pair, rig.state.X_WO)[0] if solid.shapes else ():
                away = solid.distance(point)
                yield away, {"name": pair.name, "point": rounded(point, 3), "solid": solid}
                if away > BESIDE_M:
                    break


@rule(
    "the force of contact '{name}' would push out of {solid.name}, whose collision geometry is "
    "on the side that {key} points to; it must point out of it: reverse contacts.{name}.{key}",
    PROBE_M,
)
def inverted(rig: Rig) -> Values:
    """Normals that are reversed: the force would push out of the body, or out of the object."""
    for i, pair, solids in _solids(rig):
        points, directions = feet(pair, rig.state.X_WO)
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
    "the object starts {mm:.0f} mm inside {name}, with its contacts just touching: a normal is "
    "reversed, or the collision geometry is larger than the contacts state; reverse the normals of "
    "its contacts, or mend the geometry",
    0.005,
)
def inside(rig: Rig) -> Values:
    """Depth of the object in a body, for another cause than those above (m)."""
    if rig.scenario.plant.exact or any(normals.findings(rig)) or any(inverted.findings(rig)):
        return
    pairs = {solids["body"].name: solids.values() for _, _, solids in _solids(rig)}
    for name, (body, held) in pairs.items():
        for a in body.shapes if held.shapes else ():
            depth = max(-nearest(*a, *b).distance for b in held.shapes)
            yield depth, {"name": name}


@doubt(
    "noise and steps of the encoders ({step:.2g} rad rms) let force {name} vary by {percent:.2g} % "
    "of {command:.3g} N, by the velocities that its brake is of; {enough:.2g} rad would do, or set "
    "control.estimate.joint_angular={angular:.2g} rad/s²",
    NOISY,
)
def encoders(rig: Rig) -> Values:
    """Rms force that the brake makes of the encoders' noise, of the mean command.

    The contacts answer by δα = (NᵀΦN)⁻¹κ NᵀδV on faces that do not yield, δV the mean of the arms'.
    """
    brake = getattr(rig.gains.force, "brake", 0.0)
    if rig.scenario.sensors.encoder is None or not rig.pairs or not brake:
        return
    estimate, error = hardware.joint_estimate(rig.scenario, rig.chain)
    N = rig.contact.N
    if N.shape[1] != len(rig.force_names):  # dependent contacts share their forces
        return
    M = np.linalg.inv(N.T @ rig.state.Phi @ N)
    speeds = estimate.noise_gain * error
    arms = zip(rig.state.arms, rig.chain.slices, strict=True)
    made = np.hstack([M @ N.T @ arm.J * speeds[own] for arm, own in arms])
    forces = brake * np.sqrt((made**2).sum(axis=1)) / len(rig.chain.arms)
    commands = np.abs(rig.references.overview[1].commands).mean(axis=0)
    for name, force, command in zip(rig.force_names, forces, commands, strict=True):
        value = force / command if command > 0.0 else 0.0
        less = min(NOISY / value, 1.0) if value > 0.0 else 1.0
        yield (
            value,
            {
                "name": name,
                "step": error.max(),
                "percent": 100.0 * value,
                "command": command,
                "enough": error.max() * less**4,  # speeds are as (error σ_a³)^¼
                "angular": rig.scenario.control.estimate.joint_angular * less ** (4.0 / 3.0),
            },
        )


PLACE_RULES = (normals, inverted, inside, start, beside)
#: What a scenario has to follow; a new rule is entered here. For those of every task and of a
#: robot see `osc_contact.loop.start_rules`.
RIG_RULES = (sensors, springs, swinging, *PLACE_RULES, friction, encoders, carts, landing)
MODEL_RULES = (tare,)  #: of a scenario; they look at what the controller's model has wrong
