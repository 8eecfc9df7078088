"""What is wrong with a task before it runs: where faces and robot are, what is asked of both."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from itertools import chain

import daqp
import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.pairs.pair import knows_where_it_slides
from osc_contact.control.controller import Controller
from osc_contact.control.reading import choose_reading
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import object_pose, reach
from osc_contact.dynamics.joint_modes import modes
from osc_contact.errors import InvalidInputError, ModelError, OscContactError, ScenarioError
from osc_contact.interface import Reference, Robot
from osc_contact.runs import faces, hardware
from osc_contact.runs import preflight_contacts as at
from osc_contact.runs.contacts import feet
from osc_contact.runs.finding import Finding
from osc_contact.runs.preflight_joints import JOINT_RULES
from osc_contact.runs.preflight_robot import ROBOT_RULES, SCENE_RULES
from osc_contact.runs.rig import Rig
from osc_contact.runs.task import Task, findings
from osc_contact.scenarios.contact_schema import CartSpec
from osc_contact.spatial import Array

__all__ = ["Finding", "preflight", "require_ready"]

CART_M = 0.2  #: a free cart that runs further is doubtful
SLOW, TOO_SLOW = 0.7, 2.0  #: gain × control period: doubtful, refused (a sampled loop diverges)
SOFT_HZ = 100.0  #: joints whose springs swing slower want a joint torque loop
OVERLOAD = 3.0  #: forces that ever need more than so many times the motors' limits are refused
FAR_M = 0.02  #: m; a motion that misses more, for want of a posture, is doubtful
_logger = logging.getLogger("osc_contact.preflight")


def preflight(
    task: Rig | Robot,
    controller: Controller | None = None,
    references: Iterable[Reference] = (),
) -> tuple[Finding, ...]:
    """Everything that is wrong or doubtful about a task, before it runs.

    Of every task are compared: motions with the contacts, the arms' reach, the joints' ranges and
    speeds, forces and weights with the motors, the control rate with the gains. Of a scenario, too:
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
    if not isinstance(task, Rig):
        return _preflight_robot(task, controller, references)
    rig, of = task, Task.of_rig(task)
    checks: tuple[Iterator[Finding], ...] = (
        _sensors(of), _tare(rig), _rate(of), _springs(rig), at.normals(rig), at.inverted(rig),
        at.inside(rig), at.start(rig), at.beside(rig), _motion(of), _reading(rig), _motors(of),
        _carts(rig),
    )  # fmt: skip
    return tuple(chain.from_iterable(checks))


def _preflight_robot(
    robot: Robot, controller: Controller | None, references: Iterable[Reference]
) -> tuple[Finding, ...]:
    if controller is None:
        raise InvalidInputError(
            "preflight takes the rig of a scenario, or a robot with its controller and references"
        )
    of = Task.of_robot(robot, controller, references)
    if of.chain.nq != len(of.q):
        raise InvalidInputError(f"the robot measures {len(of.q)} joints of {of.chain.nq}")
    found = list(findings((*ROBOT_RULES, *SCENE_RULES), of))
    if any(one.refused for one in found):  # what follows from it is no news
        return tuple(found)
    return (*found, *_rate(of), *_motion(of), *_motors(of))


def require_ready(rig: Rig) -> list[str]:
    """The doubts about a task, which are logged too.

    Raises:
        ScenarioError: it cannot run; with everything that `preflight` refuses.
    """
    found = preflight(rig)
    refused = [one.text for one in found if one.refused]
    if refused:
        raise ScenarioError("\n".join(refused))
    for one in found:
        _logger.warning("doubtful: %s", one.text)
    return [one.text for one in found]


def _sensors(task: Task) -> Iterator[Finding]:
    for arm in task.chain.arms if task.pairs else ():
        if arm.wrist_sensor is None:
            yield Finding(
                True,
                f"arm '{arm.name}' has no wrist sensor, and contact forces are controlled by what "
                "wrist sensors read; name a frame of its URDF as wrist_sensor",
            )


def _tare(rig: Rig) -> Iterator[Finding]:
    """Weights that the wrists read and the model does not know; the exact plant has no tare."""
    scenario = rig.scenario
    if not rig.pairs or scenario.tare is not None or scenario.plant.exact:
        return
    error, wrist = scenario.model_error, scenario.sensors.wrist
    wrong = [
        f"model_error.{key} is {value:g}"
        for key, value, right in (
            ("object_mass", error.object_mass, 1.0),
            ("arm_mass", error.arm_mass, 1.0),
            ("hidden_mass", error.hidden_mass, 0.0),
        )
        if value != right
    ]
    if wrist is not None:
        wrong += [
            f"sensors.wrist.{key} has a bias of {of.bias:g} {unit}"
            for key, of, unit in (("force", wrist.force, "N"), ("torque", wrist.torque, "N m"))
            if of.bias > 0.0
        ]
    if wrong:
        yield Finding(
            False,
            f"{' and '.join(wrong)}, and nothing zeroes the wrist sensors: what they read wrongly "
            "is taken for contact force; set tare={} to zero them in free space before contact",
        )


def _reading(rig: Rig) -> Iterator[Finding]:
    """Friction that the filter of fig. 5 takes for normal force."""
    control, mu = rig.scenario.control, rig.scenario.plant.friction
    if rig.scenario.plant.exact or mu == 0.0 or control.friction is not None or not rig.pairs:
        return
    of = faces.known_bodies(rig.bodies, len(rig.pairs), False)
    if choose_reading(control.force.reading, rig.pairs, of) == "filter":
        cure = "give control.friction={mu: …}"
        if all(map(knows_where_it_slides, rig.pairs)):
            cure = f"set control.force.reading=least_squares, or {cure}"
        yield Finding(
            False,
            f"plant.friction is {mu:g}, the controller knows of none, and the filter that reads "
            f"forces takes it for normal force; {cure}",
        )


def _springs(rig: Rig) -> Iterator[Finding]:
    try:
        joints = hardware.flexible_joints(rig.scenario, rig.chain, rig.state())
        hardware.torque_loop(rig.scenario, rig.chain, joints)
    except OscContactError as error:
        yield Finding(True, str(error))
        return
    if joints is None or rig.scenario.control.joint_torque is not None:
        return
    swing = modes(rig.state(), rig.chain.actuated, joints.stiffness)
    first = float(swing[swing > 0.0].min(initial=np.inf))
    if first < SOFT_HZ:
        yield Finding(
            False,
            f"the springs in the joints swing at {first:.3g} Hz (first mode, motors held), and no "
            f"joint torque loop makes them carry what is commanded: below {SOFT_HZ:g} Hz contact "
            f"is lost; set control.joint_torque={{rate: {1e-3 / rig.scenario.plant.step:g} kHz}}",
        )


def _rate(task: Task) -> Iterator[Finding]:
    rate, motion, force = task.rate, task.gains.motion, task.gains.force
    name = "motion.damping"
    if "damping" not in motion.model_fields_set:
        name = f"motion.frequency {motion.frequency:g} Hz, damping"
    limits = [(name, motion.damping)]
    if task.pairs:
        name = "force.integral"
        if "integral" not in force.model_fields_set:
            name = f"force.bandwidth {force.bandwidth:g} Hz, integral"
        limits += [(name, force.integral), (name.replace("integral", "brake"), force.brake)]
    for name, gain in limits:
        if gain / rate >= SLOW:
            refused = gain / rate >= TOO_SLOW
            yield Finding(
                refused,
                f"control.rate {rate:g} Hz is too slow for gains.{name} {gain:g} 1/s: their ratio "
                f"is {gain / rate:.2g}, and a sampled loop diverges from {TOO_SLOW:g} on; raise "
                f"the rate to {10 * gain:.0f} Hz, or lower the gain",
            )


def _motion(task: Task) -> Iterator[Finding]:
    """What is wrong with the motion; one that is possible is gone through."""
    found = [*_reach(task), *_postures(task), *at.lifted(task)]
    yield from found or findings(JOINT_RULES, task)


def _reach(task: Task) -> Iterator[Finding]:
    times, plan = task.times, task.plan
    poses = plan.X_WD[:, :3]
    for arm, grasp in zip(task.chain.arms, task.chain.grasps, strict=True):
        most = _length(arm) + float(np.linalg.norm(grasp.X_TO.translation))
        far = np.linalg.norm(poses - arm.base.translation, axis=1)
        if far.max() > most:
            k = int(far.argmax())
            yield Finding(
                True,
                f"the motion leads the object to {far[k]:.3g} m from the base of arm "
                f"'{arm.name}' at t = {times[k]:.3g} s, and the stretched arm reaches "
                f"{most:.3g} m; ask for a smaller motion (are its signals in the right unit?)",
            )


def _postures(task: Task) -> Iterator[Finding]:
    """Places to which no posture within the joints' limits leads, from the start on."""
    if any(True for _ in _reach(task)):
        return
    chain, times, plan = task.chain, task.times, task.plan
    poses = plan.X_WD
    ways = poses[:, :3] - poses[0, :3]
    turns = np.abs(poses[:, 3:] @ poses[0, 3:])  # cosine of half the angle
    ends = {int(k) for k in (*ways.argmax(axis=0), *ways.argmin(axis=0), turns.argmin())}
    for k in sorted(ends):
        X = pin.XYZQUATToSE3(poses[k])
        try:
            q = reach(chain, task.q_contact, X, 1e-3)
            left = float(np.linalg.norm(object_pose(chain, q).translation - X.translation))
        except ModelError:  # it circles about a pose out of reach
            q, left = task.q_contact, np.inf
        if left > FAR_M:
            at = [
                name for name, x, low, high in zip(
                    chain.joint_names, q, chain.model.lowerPositionLimit,
                    chain.model.upperPositionLimit, strict=True,
                ) if min(x - low, high - x) < 1e-6
            ]  # fmt: skip
            yield Finding(
                False,
                f"at t = {times[k]:.3g} s the motion wants the object where no posture near the "
                f"start puts it ({np.round(X.translation, 3).tolist()} m)"
                + (f": {1e3 * left:.0f} mm are left" if np.isfinite(left) else "")
                + (f" with {', '.join(at)} at the end stop" if at else "")
                + "; ask for a smaller motion, or begin in another posture",
            )
            return


def _length(arm: Arm) -> float:
    """No point of the tip is further from the base: all links stretched out (m)."""
    model = arm.model
    links = sum(float(np.linalg.norm(X.translation)) for X in model.jointPlacements)
    frame = model.frames[robots.frame_id(model, arm.tip)]
    slides = 0.0
    for joint in list(model.joints)[1:]:
        if joint.shortname().startswith("JointModelP"):
            ends = (model.lowerPositionLimit, model.upperPositionLimit)
            slides += max(abs(float(end[joint.idx_q])) for end in ends)
    return links + float(np.linalg.norm(frame.placement.translation)) + slides


def _motors(task: Task) -> Iterator[Finding]:
    """Forces that no torques within the limits make, whatever the internal forces are."""
    if not task.pairs:
        return
    state, contact = task.state, task.contact
    if not contact.r or not state.d:
        return
    t, alpha = task.times, task.plan.alpha_d
    limits = np.minimum(task.chain.tau_max, 1e12)
    wanted = state.b_S[:, None] + state.S.T @ contact.N @ contact.R @ alpha.T
    shares = np.linalg.pinv(state.G * limits) @ wanted  # of each motor's limit, least squares
    order = np.argsort(np.abs(shares).max(axis=0))
    most, usual = (
        least_peak(state.G * limits, wanted[:, k]) for k in (order[-1], order[len(t) // 2])
    )
    if most > OVERLOAD or usual > 1.0:  # a peak that is a little too high saturates for a while
        k = int(order[-1])
        motor = int(np.abs(shares[:, k]).argmax())
        name = task.force_names[int(alpha[k].argmax())]
        yield Finding(
            most > OVERLOAD,
            f"{name} asks for {alpha[k].max():.4g} N at t = {t[k]:.3g} s, for which motors "
            f"would need {most:.2g} times their limits at least (most of all "
            f"{task.chain.joint_names[task.chain.actuated[motor]]}, {limits[motor]:.3g} N m or N); "
            "ask for less force, or choose another posture",
        )


def least_peak(A: Array, b: Array) -> float:
    """The smallest max |x| of all x with A x = b, to 1 %, by bisection on the bound.

    Args:
        A: (m, n). b: (m,).
    """
    x = np.linalg.pinv(A) @ b
    low, high = float(np.linalg.norm(x) / np.sqrt(len(x))), float(np.abs(x).max())
    scale = np.linalg.norm(A, axis=1)
    rows, right = A / scale[:, None], b / scale
    while high - low > 0.01 * high:
        bound = 0.5 * (low + high)
        box = np.full(len(x), bound)
        upper, lower = np.concatenate((box, right)), np.concatenate((-box, right))
        sense = np.concatenate((np.zeros(len(x)), np.full(len(b), 5))).astype(np.int32)
        flag = daqp.solve(np.eye(len(x)), np.zeros(len(x)), rows, upper, lower, sense)[2]
        low, high = (low, bound) if flag > 0 else (bound, high)
    return high


def _carts(rig: Rig) -> Iterator[Finding]:
    t, plan = rig.references.overview
    alpha = plan.alpha_d
    X, dt = rig.state().X_WO, t[1] - t[0]
    for body in rig.bodies:
        cart = body.motion
        if not isinstance(cart, CartSpec):
            continue
        u = np.array(cart.direction)
        push = np.zeros(len(t))
        for i in body.contacts:
            push += alpha[:, rig.owners == i] @ (feet(rig.pairs[i], X)[1] @ u)
        constant = cart.preload - 9.81 * cart.mass * u[2]
        s = speed = most = 0.0
        for force in push + constant:  # implicit in spring and damper: stable for any of them
            m, c, k = cart.mass, cart.damping, cart.stiffness
            speed = (m * speed + dt * (force - k * s)) / (m + dt * c + dt**2 * k)
            s += dt * speed
            most = max(most, abs(s))
        if most > CART_M:
            yield Finding(
                False,
                f"nothing balances the cart of '{body.name}': weight, preload and contact forces "
                f"leave {push[-1] + constant:.3g} N along its rail at the end, which moves it by "
                f"{most:.3g} m in {rig.scenario.duration:g} s; give it a preload of "
                f"{cart.preload - float(np.mean(push + constant)):.3g} N, or a stiffness",
            )
