"""What is wrong with a task before it runs: a table of rules on what can be compared beforehand.

A rule is one function that gives a quantity, under the limits from which it is doubtful and
refused, and the sentence of the finding. A task is given by a file, or in Python.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any

import coal
import daqp
import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.detection.features import collision_shapes, nearest
from osc_contact.contacts.pairs.pair import ContactPair, knows_where_it_slides, pushes_only
from osc_contact.control.controller import Controller
from osc_contact.control.records import choose_reading
from osc_contact.control.start_check import is_clear, judge_load, outboard_mass
from osc_contact.control.status import SafetyState, Status
from osc_contact.dynamics.arm import stretched_length
from osc_contact.dynamics.assembly import object_pose, reach
from osc_contact.dynamics.chain_state import ChainState, modes
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import (
    InvalidInputError,
    ModelError,
    OscContactError,
    PlantError,
    ScenarioError,
)
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.plants.own_mujoco import MujocoRobot, SceneProbe
from osc_contact.recorder.recording import column_names
from osc_contact.robots.model import position_limits
from osc_contact.runs import hardware
from osc_contact.runs.contacts import contact_at, feet, force_owners, known_bodies, urdf_of
from osc_contact.runs.rig import Rig, landings
from osc_contact.scenarios.bodies import CartSpec
from osc_contact.scenarios.control_schema import Gains, SafetySettings
from osc_contact.spatial import Array, norm

MOST_TICKS = 100_000  #: references that are looked at
_LOOKS = 400  #: of them, at which places and forces are compared
BESIDE_M = 0.005  #: a contact further than this beside body or object is refused
PROBE_M = 0.002  #: how far in front of and behind a contact geometry is looked for
NEAR_M = 0.02  #: contacts that begin further away are not compared with the scene
SCENE_PROBE_M = 1e-3  #: how far before and behind a face geometry of a scene is looked for
PLACE_DOUBTFUL, PLACE_REFUSED = 0.002, 0.005  #: m; of contacts, tool and geometry of a scene
OUTWARD = {"body": ("face_normal", "edge_outward"), "object": ("normal", "edge_outward")}
#: of rehearsals: the longest tick, its largest product with the gains
PERIOD_S = 4e-3
GAIN = 0.3
_logger = logging.getLogger("osc_contact.preflight")

Values = Iterator[tuple[float, dict[str, Any]]]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or doubtful.

    Attributes:
        refused: whether it cannot run; else it is doubtful.
        text: a sentence with the numbers and the cure.
    """

    refused: bool
    text: str


@dataclass(frozen=True)
class Rule:
    """A quantity that is doubtful above one limit, and refused above another.

    Attributes:
        quantity: gives values, each with the words of the sentence.
        doubtful, refused: limits, in the quantity's unit.
        sentence: format of the finding's text; {value} is the quantity, {mm} a thousand times that.
    """

    quantity: Callable[[Any], Values]
    doubtful: float
    refused: float
    sentence: str

    def findings(self, task: Any) -> Iterator[Finding]:
        """What is above a limit; a quantity that is not a number is refused.

        Args:
            task: the `Task`, or the `Rig`, that the quantity is of.
        """
        for value, words in self.quantity(task):
            refused = not value <= self.refused
            if refused or value > self.doubtful:
                yield Finding(refused, self.sentence.format(value=value, mm=1e3 * value, **words))


def rule(
    sentence: str, doubtful: float = 0.0, refused: float | None = None
) -> Callable[[Callable[[Any], Values]], Rule]:
    """Function decorator: makes a quantity a rule.

    Args:
        sentence, doubtful, refused: see `Rule`; a refused of None is doubtful's limit.
    """
    limit = doubtful if refused is None else refused
    return lambda quantity: Rule(quantity, doubtful, limit, sentence)


doubt = partial(rule, refused=np.inf)  #: a rule that refuses nothing


def findings(rules: Iterable[Rule], task: Any) -> list[Finding]:
    """Of all rules, one after the other."""
    return [one for rule in rules for one in rule.findings(task)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A chain, its contacts and what they are to do.

    Attributes:
        chain: the true one, as far as it is known. pairs: the true contacts.
        gains, dt, posture, safety: of the controller.
        q: (n,) where the run starts. q_contact: (n,) the same in contact.
        state, contact: the chain at rest there, and all contacts.
        times: (k,) s. poses, forces: (k, 7) and (k, r) the references there.
        every: references of all ticks, by the period.
        force_names: (r,) in messages. owners: (r,) the contact of each.
        rests: of each contact, whether its body does. kept_from: s, when contacts are to be kept.
        bound: whether all contacts are kept, also those whose force is zero.
        controller, robot, measured: that will run, and what it measures now; None: the scenario's
            plant, whose controller is not made yet.
    """

    chain: ClosedChain
    pairs: Sequence[ContactPair]
    gains: Gains
    dt: float
    posture: Array
    safety: SafetySettings
    q: Array
    q_contact: Array
    state: ChainState
    contact: Contact
    times: Array
    poses: Array
    forces: Array
    every: Callable[[float], Iterator[Reference]]
    force_names: Sequence[str]
    owners: Array
    rests: Sequence[bool]
    bound: bool
    kept_from: float = 0.0
    controller: Any = None
    robot: Any = None
    measured: Any = None

    @cached_property
    def probe(self) -> SceneProbe:
        """What measures distances in the scene of a `MujocoRobot`."""
        return self.robot.probe()

    @classmethod
    def of_rig(cls, rig: Rig) -> Task:
        """Of a scenario."""
        scenario = rig.scenario
        times, plan = rig.references.overview
        tare = scenario.tare
        return cls(
            chain=rig.chain,
            pairs=rig.pairs,
            gains=rig.gains,
            dt=1.0 / scenario.control.rate,
            posture=rig.q_contact,
            safety=scenario.control.safety,
            q=rig.q_start,
            q_contact=rig.q_contact,
            state=rig.state,
            contact=rig.contact,
            times=times,
            poses=plan.X_WD,
            forces=plan.alpha_d,
            every=lambda period: rig.references.each(int(scenario.duration / period), period),
            force_names=[f"force.{name}" for name in rig.force_names],
            owners=rig.owners,
            rests=[rig.bodies[body].motion is None for body in rig.on],
            bound=rig.life is None,
            kept_from=0.0 if tare is None else tare.duration + tare.approach,
        )

    @classmethod
    def of_robot(cls, robot: Any, controller: Controller, references: Iterable[Reference]) -> Task:
        """Of a robot at rest where the run will start.

        Args:
            robot: is measured once. controller: of it. references: one for each tick.

        Raises:
            InvalidInputError: no references, not all of them have a force for each column, or the
                robot has other joints.
        """
        settings = controller.settings
        measured = robot.measure()
        pairs = settings.contacts
        chain = getattr(robot, "chain", settings.chain)
        owners = force_owners(pairs)
        given = list(islice(references, MOST_TICKS))
        for k, one in enumerate(given):
            if np.shape(one.alpha_d) != (len(owners),):
                raise InvalidInputError(
                    f"reference {k}: alpha_d has shape {np.shape(one.alpha_d)}, and the contacts "
                    f"have {len(owners)} columns of N; give one force for each (N)"
                )
        if not given:
            raise InvalidInputError("there are no references; give one for each tick")
        q = np.asarray(measured.q, dtype=float)
        if chain.nq != len(q):
            raise InvalidInputError(f"the robot measures {len(q)} joints of {chain.nq}")
        state = chain.state(q)
        looks = np.unique(np.linspace(0, len(given) - 1, _LOOKS).astype(int))
        names = column_names([pair.name for pair in pairs], owners.tolist())
        return cls(
            chain=chain,
            pairs=pairs,
            gains=settings.gains,
            dt=settings.dt,
            posture=settings.posture,
            safety=settings.safety,
            q=q,
            q_contact=q,
            state=state,
            contact=contact_at(pairs, state.X_WO),
            times=looks * settings.dt,
            poses=np.array([pin.SE3ToXYZQUAT(given[k].X_WD) for k in looks]),
            forces=np.array([given[k].alpha_d for k in looks]),
            every=lambda period: iter(given[:: max(1, round(period / settings.dt))]),
            force_names=[f"alpha_d of {name}" for name in names],
            owners=owners,
            rests=[body is None for body in settings.bodies],
            bound=settings.life is None,
            controller=controller,
            robot=robot,
            measured=measured,
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
    robot: the wrists with the load they carry, the first reference with the pose; of a
    `MujocoRobot` also contacts, tool and masses with its scene.

    Args:
        task: a scenario, see `build_rig`; or a robot at rest where the run will start, which is
            measured once.
        controller: of the robot; it is not changed.
        references: of the run, as for `run_loop`, which needs them anew; at most the first 100,000
            are looked at.

    Raises:
        InvalidInputError: a robot without controller or references, or forces that do not fit the
            contacts.
    """
    if isinstance(task, Rig):
        return (*findings(MODEL_RULES, task), *judge_robot(task))
    if controller is None:
        raise InvalidInputError(
            "preflight takes the rig of a scenario, or a robot with its controller and references"
        )
    of = Task.of_robot(task, controller, references)
    found = findings(ROBOT_RULES, of)
    if isinstance(task, MujocoRobot):
        found += findings(SCENE_RULES, of)
    if any(one.refused for one in found):  # what follows from it is no news
        return tuple(found)
    return (*found, *_judge_motion(of))


def judge_robot(rig: Rig) -> tuple[Finding, ...]:
    """What of `preflight` is the same whatever the controller's model has wrong."""
    of = Task.of_rig(rig)
    return (*findings(RIG_RULES, rig), *findings((weights, pulls), of), *_judge_motion(of))


def _judge_motion(of: Task) -> list[Finding]:
    """What every task is compared with: rate, motion, motors."""
    motion = findings(MOTION_RULES, of) or findings((joints,), of)
    return findings((rate,), of) + motion + findings((motors,), of)


def require_ready(rig: Rig, robot: Sequence[Finding] | None = None) -> list[str]:
    """The doubts about a task, which are logged too.

    Args:
        rig: of the task. robot: what `judge_robot` has found, if it was called before.

    Raises:
        ScenarioError: it cannot run; with everything that `preflight` refuses.
    """
    found = [*findings(MODEL_RULES, rig), *(judge_robot(rig) if robot is None else robot)]
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
    bodies = known_bodies(rig.bodies, len(rig.pairs), "known")
    if choose_reading(control.force.reading, rig.pairs, bodies) == "filter":
        slides = all(map(knows_where_it_slides, rig.pairs))
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
    """How far free carts run (m)."""
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
            push += plan.alpha_d[:, rig.owners == i] @ along
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


# --- every task ---------------------------------------------------------------------------------


@rule(
    "control.rate {rate:g} Hz is too slow for gains.{name} {gain:g} 1/s: their ratio is "
    "{value:.2g}, and a sampled loop diverges from 2 on; raise the rate to {enough:.0f} Hz, or "
    "lower the gain",
    0.7,
    2.0,
)
def rate(task: Task) -> Values:
    """Gain × control period."""
    motion = task.gains.motion
    force = task.gains.force
    given = "damping" in motion.model_fields_set
    name = "motion." if given else f"motion.frequency {motion.frequency:g} Hz, "
    limits = {f"{name}damping": motion.damping}
    if task.pairs:
        given = "integral" in force.model_fields_set
        name = "force." if given else f"force.bandwidth {force.bandwidth:g} Hz, "
        limits |= {f"{name}integral": force.integral, f"{name}brake": force.brake}
    for name, gain in limits.items():
        yield (
            gain * task.dt,
            {"name": name, "gain": gain, "rate": 1.0 / task.dt, "enough": 10 * gain},
        )


@rule(
    "the motion leads the object to {far:.3g} m from the base of arm '{name}' at t = {t:.3g} s, "
    "and the stretched arm reaches {most:.3g} m; command a smaller motion (are its signals in the "
    "right unit?)",
    1.0,
)
def stretched(task: Task) -> Values:
    """Distance from the base, over what the stretched arm reaches."""
    for arm, grasp in zip(task.chain.arms, task.chain.grasps, strict=True):
        most = stretched_length(arm) + norm(grasp.X_TO.translation)
        far = np.linalg.norm(task.poses[:, :3] - arm.base.translation, axis=1)
        k = far.argmax()
        words = {"far": far[k], "name": arm.name, "t": task.times[k], "most": most}
        yield far[k] / most, words


@doubt(
    "at t = {t:.3g} s the motion leads the object to where no posture near the start puts it "
    "({where} m){left}; command a smaller motion, or begin in another posture",
    0.02,
)
def postures(task: Task) -> Values:
    """By how much no posture within the joints' limits, from the start on, gets there (m)."""
    if any(stretched.findings(task)):
        return
    chain = task.chain
    poses = task.poses
    low, high = position_limits(chain.model)
    ways = poses[:, :3] - poses[0, :3]
    turns = np.abs(poses[:, 3:] @ poses[0, 3:])  # cosine of half the angle
    for k in sorted({*ways.argmax(axis=0), *ways.argmin(axis=0), turns.argmin()}):
        X = pin.XYZQUATToSE3(poses[k])
        away = np.inf
        left = ""
        try:
            q = reach(chain, task.q_contact, X, 1e-3)
        except ModelError:  # it circles about a pose out of reach
            pass
        else:
            away = norm(object_pose(chain, q).translation - X.translation)
            ends = np.flatnonzero(np.minimum(q - low, high - q) < 1e-6)
            names = ", ".join(chain.joint_names[j] for j in ends)
            left = f": {1e3 * away:.0f} mm are left" + f" with {names} at the end stop" * bool(
                names
            )
        yield away, {"t": task.times[k], "where": rounded(X.translation, 3), "left": left}
        if away > postures.doubtful:
            return


@rule(
    "at t = {at:.3g} s the motion would end in a stop: {why}; command a smaller or slower motion, "
    "or begin in another posture"
)
def joints(task: Task) -> Values:
    """Whether the controller would stop for its joints' limits: the motion is gone through.

    The joints follow what the controller commands, without contacts, errors and motor limits.
    """
    chain = task.chain
    rigid = all(grasp.is_rigid for grasp in chain.grasps)
    if not rigid or not np.ptp(task.poses, axis=0).max() > 0.0:
        return  # a loose object needs its contacts
    kept = ("overspeed_time", "brake_time", "hold_rate")
    safety = SafetySettings.motors_only(**{key: getattr(task.safety, key) for key in kept})
    dt = max(task.dt, min(PERIOD_S, GAIN / max(task.gains.motion.damping, 1.0)))
    dt = task.dt * round(dt / task.dt)
    q = task.q.copy()
    v = np.zeros(chain.nq)
    still = np.zeros((len(chain.arms), 6))
    try:
        controller = Controller(chain, (), task.gains, dt=dt, posture=task.posture, safety=safety)
        for k, desired in enumerate(task.every(dt)):
            motion = Reference(desired.X_WD, desired.V_D, desired.A_D)
            controller.tick(Measurement(q.copy(), v.copy(), still), motion)
            if controller.state is SafetyState.SAFE_STOP:
                why = controller.reason.removesuffix(". See why, then call reset()")
                yield 1.0, {"at": k * dt, "why": why}
                return
            v = v + _acceleration(controller) * dt
            q = q + v * dt
    except OscContactError:  # what cannot be gone through without its contacts
        return


def _acceleration(controller: Controller) -> Array:
    """(n,) q̈ of the last tick: J̄a + offset, and what redundant arms do beside their task.

    Their torques τ₀ move them by (1 − J̄J)M⁻¹(τ₀ − h). Without it nothing holds their posture, and
    they drift until a joint comes near its limit.
    """
    chain = controller.settings.chain
    joints = controller._records.work.joints
    a = controller.joint_acceleration()
    for arm, s, grasp in zip(chain.arms, chain.slices, chain.grasps, strict=True):
        n = arm.model.nv
        if n > grasp.N.shape[1]:
            own = np.linalg.solve(joints.M[s, :n], joints.rest[s] - joints.h[s])
            a[s] += own - np.asarray(joints.J_bar[s]) @ (np.asarray(joints.J[s]).T @ own)
    return a


@rule(
    "{name} is {force:.4g} N at t = {t:.3g} s, for which motors would need {value:.2g} times "
    "their limits at least (most of all {joint}, {most:.3g} N m or N); command less force, or "
    "choose another posture",
    0.0,
    3.0,
)
def motors(task: Task) -> Values:
    """Forces that no torques within the limits make, whatever the internal forces are."""
    if not task.pairs or not task.contact.r or not task.state.d:
        return
    state = task.state
    contact = task.contact
    chain = task.chain
    limits = np.minimum(chain.tau_max, 1e12)
    needed = state.b_S[:, None] + state.S.T @ contact.N @ contact.R @ task.forces.T
    shares = np.linalg.pinv(state.G * limits) @ needed  # of each motor's limit, least squares
    order = np.argsort(np.abs(shares).max(axis=0))
    k, usual = order[[-1, len(order) // 2]]
    most = least_peak(state.G * limits, needed[:, k])
    # a peak that is a little too high saturates for a while
    if most > motors.refused or least_peak(state.G * limits, needed[:, usual]) > 1.0:
        j = task.forces[k].argmax()
        motor = np.abs(shares[:, k]).argmax()
        words = {
            "name": task.force_names[j],
            "force": task.forces[k, j],
            "t": task.times[k],
            "joint": chain.joint_names[chain.actuated[motor]],
            "most": limits[motor],
        }
        yield most, words


def least_peak(A: Array, b: Array) -> float:
    """The smallest max |x| of all x with A x = b, to 0.2 %: min t² + ε|x|² with |x| ≤ t.

    Where rows of A contradict one another, that of the least-squares solution.

    Args:
        A: (m, n). b: (m,).
    """
    m, n = A.shape
    size = np.abs(np.linalg.pinv(A) @ b).max()
    x = np.eye(n, n + 1)
    t = np.eye(1, n + 1, n)
    rows = np.vstack((t - x, t + x, np.pad(A, ((0, 0), (0, 1)))))
    lower = np.append(np.zeros(2 * n), b / max(size, 1e-300))
    upper = np.append(np.full(2 * n, 1e30), lower[2 * n :])
    sense = np.repeat([0, 5], (2 * n, m)).astype(np.int32)
    H = np.diag(np.append(np.full(n, 1e-4), 1.0))
    found, _, flag, _ = daqp.solve(H, np.zeros(n + 1), rows, upper, lower, sense)
    return size * np.abs(found[:n]).max() if flag > 0 else size


# --- a robot ------------------------------------------------------------------------------------


@rule(
    "{why}",
    0.0,
    0.9,
)
def first_tick(task: Task) -> Values:
    """A copy of the controller is given what is measured and the first reference."""
    trial = copy(task.controller)
    trial.tick(task.measured, next(task.every(task.dt)))
    if trial.status is Status.HELD:
        yield 1.0, {"why": trial.reason}
    elif task.pairs and is_clear(trial.settings, trial._records):
        error = trial.residual_wrench() - trial.f_tare
        why = judge_load(trial.settings, error, trial.result().bias_out)
        if why:  # a controller that has not engaged may still be tared
            may_change = not trial.engaged or not np.any(task.measured.wrenches)
            yield 0.5 if may_change else 1.0, {"why": why}


@rule(
    "the first reference puts the object {value:.3g} m away from where it is, at {first} m instead "
    "of {now} m; begin the motion at chain.state(q, v).X_WO",
    0.005,
    0.1,
)
def jump(task: Task) -> Values:
    """From the pose to the first reference (m)."""
    first = task.poses[0, :3]
    now = task.state.X_WO.translation
    yield norm(first - now), {"first": rounded(first), "now": rounded(now)}


@rule(
    "to hold the arm, {joint} needs {torque:.4g} N m (or N), {value:.2g} times its limit of "
    "{most:.4g}; all that moves weighs {mass:.4g} kg: are masses in kg and lengths in m?",
    0.9,
    1.0,
)
def weights(task: Task) -> Values:
    """Torques that hold the arms before contacts bear, shares of the motors' limits.

    And a single arm's object; several arms share it in any way.
    """
    chain = task.chain
    bias = pin.computeGeneralizedGravity(chain.model, chain.model.createData(), task.q)
    if chain.payload is not None and len(chain.arms) == 1 and chain.grasps[0].is_rigid:
        state = task.state
        load = chain.payload.terms(state.X_WO, np.zeros(6), chain.model.gravity.linear).p
        bias = bias + state.arms[0].J.T @ load
    bias = bias[chain.actuated]
    share = np.abs(bias) / np.minimum(chain.tau_max, 1e12)
    worst = share.argmax()
    words = {
        "joint": chain.joint_names[chain.actuated[worst]],
        "torque": bias[worst],
        "most": chain.tau_max[worst],
        "mass": moved_mass(chain),
    }
    yield share[worst], words


@rule("{name} is −{value:.3g} N at t = {t:.3g} s; this contact cannot pull: give forces ≥ 0")
def pulls(task: Task) -> Values:
    """Forces below zero (−N)."""
    for name, owner, force in zip(task.force_names, task.owners, task.forces.T, strict=True):
        if pushes_only(task.pairs[owner]):
            least = force.argmin()
            yield -force[least], {"name": name, "t": task.times[least]}


@rule(
    "{name} is {force:.4g} N at t = {t:.3g} s, and readings beyond safety.force_range = "
    "{range:.4g} N are rejected; command less force, or raise force_range to what the wrist "
    "sensor measures",
    1.0,
)
def measured_range(task: Task) -> Values:
    """Forces, over what a wrist sensor may read."""
    most = task.safety.force_range
    for name, force in zip(task.force_names, np.abs(task.forces).T, strict=True):
        k = force.argmax()
        words = {"name": name, "t": task.times[k], "force": force[k], "range": most}
        yield force[k] / most, words


def rounded(x: Array, digits: int = 4) -> list[float]:
    """Of a vector, for messages."""
    return np.round(x, digits).tolist()


def has_place(pair: ContactPair) -> bool:
    """Whether a contact touches at points that are known."""
    return getattr(pair, "surface_point", None) is not None


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
        """Of its file, with their poses; none where they are not convex, or not there."""
        try:
            return [(s.shape, self.placement * s.placement) for s in collision_shapes(self.urdf)]
        except (InvalidInputError, ModelError):
            return []

    def distance(self, point: Array) -> float:
        """Of a point of the world, not positive inside."""
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


# --- every task ---------------------------------------------------------------------------------


@doubt(
    "the motion leads the object {mm:.0f} mm {way} the surface of contact '{name}', which "
    "does not permit it: that part is not followed; give a direction along the surface, such as "
    "common_tangent, and press with force",
    0.005,
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
            yield worst, {"way": way, "name": pair.name}


# --- places: a robot in a MuJoCo scene ------------------------------------------------------------


def moved_mass(chain: ClosedChain) -> float:
    """Of all that moves (kg)."""
    held = 0.0 if chain.payload is None else chain.payload.inertia.mass
    return held + sum(inertia.mass for inertia in list(chain.model.inertias)[1:])


def _faces(task: Task) -> Iterator[tuple[ContactPair, Array, Array, float, str]]:
    """Each point of contact near the tool: pair, place, outward normal, distance to which geom."""
    X = task.state.X_WO
    for pair in task.pairs if task.probe.pairs else ():
        if has_place(pair) and pushes_only(pair) and np.abs(pair.gaps(X)).max() < NEAR_M:
            for point, inward in zip(*feet(pair, X), strict=True):
                yield pair, point, -inward, *task.probe.distance(point)


@rule("{why}")
def period(task: Task) -> Values:
    """A control period that is no whole number of the scene's steps."""
    try:
        task.robot.require_steps(task.dt)
    except PlantError as error:
        yield 1.0, {"why": error}


@rule(
    "there are contacts, and no geom of the tool can touch the scene: give both contype and "
    "conaffinity, and take the body of the sensor, or of the tip, for the tool"
)
def touchable(task: Task) -> Values:
    """Whether the tool is a ghost."""
    if task.pairs and not task.probe.pairs:
        yield 1.0, {}


@rule(
    "{what} weighs {modelled:.4g} kg in the controller's model, {true:.4g} kg in the scene; give "
    "the controller robot.chain, or correct masses (kg) and payload",
    0.1,
    0.7,
)
def masses(task: Task) -> Values:
    """Logarithm of the ratio of masses."""
    kinds = {"all that moves": moved_mass, "what the wrist carries": outboard_mass}
    for what, mass in kinds.items():
        modelled = mass(task.controller.chain)
        true = mass(task.chain)
        if true > 0.0 and modelled > 0.0:
            ratio = abs(np.log(modelled / true))
            yield ratio, {"what": what, "modelled": modelled, "true": true}


@rule(
    "contact '{name}' is modelled to touch at {point} m, and that is {mm:.3g} mm {side} the "
    "nearest geom, '{geom}'; move the contact's face to the scene's, or the scene's geom",
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
)
def place(task: Task) -> Values:
    """Distance of a face from the geometry of the scene (m)."""
    for pair, point, _, away, geom in _faces(task):
        side = "before" if away > 0.0 else "inside"
        words = {"name": pair.name, "point": rounded(point), "side": side, "geom": geom}
        yield abs(away), words


@rule(
    "the normal of contact '{name}', {normal} out of the face, is {value:.3g} deg away from that "
    "of '{geom}', {own}; it points out of the body, towards the tool: turn it",
    3.0,
    30.0,
)
def turn(task: Task) -> Values:
    """Angle (deg) between the modelled normal and the direction in which the scene recedes."""
    for pair, point, normal, away, geom in _faces(task):
        if abs(away) > PLACE_REFUSED:
            continue
        distance = task.probe.distance
        steps = SCENE_PROBE_M * np.eye(3)
        rise = np.array([distance(point + e)[0] - distance(point - e)[0] for e in steps])
        own = rise / max(norm(rise), 1e-12)
        plane = getattr(pair, "normal", None)
        # at edges and corners geometry recedes in many directions
        if (plane is not None and np.allclose(plane, normal)) or normal @ own <= 0.0:
            angle = float(np.degrees(np.arccos(np.clip(normal @ own, -1.0, 1.0))))
            words = {"normal": rounded(normal, 3), "own": rounded(own, 3), "geom": geom}
            yield angle, {"name": pair.name, **words}


@rule(
    "the tool starts {value:.3g} m inside '{geom}'; begin further away, or correct the tool's "
    "geometry and the contact's radius",
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
)
def penetration(task: Task) -> Values:
    """Depth of the tool in the scene (m)."""
    if task.probe.pairs:
        away, geom = task.probe.clearance()
        yield -away, {"geom": geom}


@rule(
    "the tool is {away:.3g} mm away from '{geom}', and by the contacts {gap:.3g} mm; correct the "
    "contact's vertex and radius, or the tip",
    PLACE_DOUBTFUL,
    PLACE_REFUSED,
)
def tool(task: Task) -> Values:
    """Distance of the tool, less the least gap that the contacts name (m)."""
    faces = list(_faces(task))
    if faces and max(abs(away) for *_, away, _ in faces) <= PLACE_DOUBTFUL:
        X = task.state.X_WO
        gap = min(np.min(pair.gaps(X)) for pair in task.pairs if pushes_only(pair))
        away, geom = task.probe.clearance()
        words = {"geom": geom, "gap": round(1e3 * gap, 3) + 0.0, "away": 1e3 * away}
        yield abs(away - gap), words


PLACE_RULES = (normals, inverted, inside, start, beside)
SCENE_RULES = (period, touchable, masses, place, turn, penetration, tool)
#: What a task has to follow; a new rule is entered in one of these rows. `joints` go through a
#: motion that none of `MOTION_RULES` finds fault with.
RIG_RULES = (sensors, springs, swinging, *PLACE_RULES, friction, carts, landing)
MODEL_RULES = (tare,)  #: of a scenario; they look at what the controller's model has wrong
ROBOT_RULES = (first_tick, jump, weights, pulls, measured_range)
MOTION_RULES = (stretched, postures, lifted)
