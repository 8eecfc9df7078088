"""What is wrong with a task before it runs: a table of rules on what can be compared beforehand.

A rule is one function that gives a quantity, under the limits from which it is doubtful and
refused, and the sentence of the finding.
"""

import logging
from collections.abc import Iterable
from copy import copy

import daqp
import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.pairs.pair import knows_where_it_slides, pushes_only
from osc_contact.control.controller import Controller
from osc_contact.control.records import choose_reading
from osc_contact.control.start_check import is_clear, judge_load
from osc_contact.control.status import SafetyState, Status
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import object_pose, reach
from osc_contact.dynamics.chain_state import modes
from osc_contact.errors import InvalidInputError, ModelError, OscContactError, ScenarioError
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.robots.model import position_limits, sliding
from osc_contact.runs import hardware, placement
from osc_contact.runs.contacts import feet, known_bodies
from osc_contact.runs.placement import rounded
from osc_contact.runs.rig import Rig, landings
from osc_contact.runs.task import Finding, Task, Values, findings, rule
from osc_contact.scenarios.bodies import CartSpec
from osc_contact.scenarios.control_schema import SafetySettings
from osc_contact.spatial import Array, norm

#: of rehearsals: the longest tick, its largest product with the gains
PERIOD_S = 4e-3
GAIN = 0.3
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
    if isinstance(task, Rig):
        of = Task.of_rig(task)
        found = findings(RIG_RULES, task) + findings((weights,), of)
    elif controller is None:
        raise InvalidInputError(
            "preflight takes the rig of a scenario, or a robot with its controller and references"
        )
    else:
        of = Task.of_robot(task, controller, references)
        found = findings(ROBOT_RULES, of)
        if any(one.refused for one in found):  # what follows from it is no news
            return tuple(found)
    motion = findings(MOTION_RULES, of) or findings((joints,), of)
    return (*found, *findings((rate,), of), *motion, *findings((motors,), of))


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


# --- a scenario ---------------------------------------------------------------------------------


@rule(
    0.0,
    0.0,
    "arm '{name}' has no wrist sensor, and contact forces are controlled by what wrist sensors "
    "read; name a frame of its URDF as wrist_sensor",
)
def sensors(rig: Rig) -> Values:
    """Arms that measure no force."""
    for arm in rig.chain.arms if rig.pairs else ():
        yield arm.wrist_sensor is None, {"name": arm.name}


@rule(
    0.0,
    np.inf,
    "{wrong}, and nothing zeroes the wrist sensors: their errors are taken for contact "
    "force; set tare={{}} to zero them in free space before contact",
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


@rule(
    0.0,
    np.inf,
    "plant.friction is {value:g}, the controller's model has none, and the filter that reads "
    "forces takes it for normal force; {other}give control.friction={{mu: …}}",
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


@rule(0.0, 0.0, "{why}")
def springs(rig: Rig) -> Values:
    """Springs, or a joint torque loop, that cannot be."""
    try:
        joints = hardware.flexible_joints(rig.scenario, rig.chain, rig.state())
        hardware.torque_loop(rig.scenario, rig.chain, joints)
    except OscContactError as error:
        yield 1.0, {"why": error}


@rule(
    -100.0,
    np.inf,
    "the joint springs oscillate at {first:.3g} Hz (first mode, motors held), and no joint "
    "torque loop produces the commanded torques: below 100 Hz contact is lost; set "
    "control.joint_torque={{rate: {rate:g} kHz}}",
)
def swinging(rig: Rig) -> Values:
    """Frequency of joints without a torque loop (−Hz)."""
    if any(springs.findings(rig)) or rig.scenario.control.joint_torque is not None:
        return
    joints = hardware.flexible_joints(rig.scenario, rig.chain, rig.state())
    if joints is not None:
        found = modes(rig.state(), rig.chain.actuated, joints.stiffness)
        first = float(found[found > 0.0].min(initial=np.inf))
        yield -first, {"first": first, "rate": 1e-3 / rig.scenario.plant.step}


@rule(
    0.2,
    np.inf,
    "nothing balances the cart of '{name}': weight, preload and contact forces leave {left:.3g} N "
    "along its rail at the end, which moves it by {value:.3g} m in {duration:g} s; give it a "
    "preload of {preload:.3g} N, or a stiffness",
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
            along = feet(rig.pairs[i], rig.state().X_WO)[1] @ u
            push += plan.alpha_d[:, rig.owners == i] @ along
        s = speed = most = 0.0
        for force in push:  # implicit in spring and damper: stable for any of them
            speed = (m * speed + dt * (force - k * s)) / (m + dt * c + dt**2 * k)
            s += dt * speed
            most = max(most, abs(s))
        preload = cart.preload - push.mean()
        words = {"left": push[-1], "duration": rig.scenario.duration, "preload": preload}
        yield most, {"name": body.name, **words}


@rule(
    2.0,
    np.inf,
    "{sentence}, {value:.2g} times its command; lower control.life.speed",
)
def landing(rig: Rig) -> Values:
    """Expected peaks of contacts that are still to be made, over their commands."""
    for one in landings(rig):
        if one.free and one.command > 0.0:
            yield one.peak / one.command, {"sentence": one.sentence}


# --- every task ---------------------------------------------------------------------------------


@rule(
    0.7,
    2.0,
    "control.rate {rate:g} Hz is too slow for gains.{name} {gain:g} 1/s: their ratio is "
    "{value:.2g}, and a sampled loop diverges from 2 on; raise the rate to {enough:.0f} Hz, or "
    "lower the gain",
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
    1.0,
    1.0,
    "the motion leads the object to {far:.3g} m from the base of arm '{name}' at t = {t:.3g} s, "
    "and the stretched arm reaches {most:.3g} m; command a smaller motion (are its signals in the "
    "right unit?)",
)
def stretched(task: Task) -> Values:
    """Distance from the base, over what the stretched arm reaches."""
    for arm, grasp in zip(task.chain.arms, task.chain.grasps, strict=True):
        most = _length(arm) + norm(grasp.X_TO.translation)
        far = np.linalg.norm(task.poses[:, :3] - arm.base.translation, axis=1)
        k = far.argmax()
        words = {"far": far[k], "name": arm.name, "t": task.times[k], "most": most}
        yield far[k] / most, words


def _length(arm: Arm) -> float:
    """No point of the tip is further from the base: all links stretched out (m)."""
    model = arm.model
    frame = model.frames[robots.frame_id(model, arm.tip)]
    links = [X.translation for X in (*model.jointPlacements, frame.placement)]
    low, high = position_limits(model)
    slides = np.maximum(np.abs(low), np.abs(high))[sliding(model)]
    return float(sum(map(norm, links)) + slides.sum())


@rule(
    0.02,
    np.inf,
    "at t = {t:.3g} s the motion leads the object to where no posture near the start puts it "
    "({where} m){left}; command a smaller motion, or begin in another posture",
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
    0.0,
    0.0,
    "at t = {at:.3g} s the motion would end in a stop: {why}; command a smaller or slower motion, "
    "or begin in another posture",
)
def joints(task: Task) -> Values:
    """Whether the controller would stop for its joints' limits: the motion is gone through.

    The joints follow what the controller commands, without contacts, errors and motor limits.
    """
    chain = task.chain
    moves = np.ptp(task.poses, axis=0).max() > 0.0
    if not moves or not all(grasp.is_rigid for grasp in chain.grasps):
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
    0.0,
    3.0,
    "{name} is {force:.4g} N at t = {t:.3g} s, for which motors would need {value:.2g} times "
    "their limits at least (most of all {joint}, {most:.3g} N m or N); command less force, or "
    "choose another posture",
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
        joint = chain.joint_names[chain.actuated[motor]]
        words = {"name": task.force_names[j], "force": task.forces[k, j], "t": task.times[k]}
        yield most, {**words, "joint": joint, "most": limits[motor]}


def least_peak(A: Array, b: Array) -> float:
    """The smallest max |x| of all x with A x = b, to 0.2 %: min t² + ε|x|² with |x| ≤ t.

    Where rows of A contradict one another, that of the least-squares solution.

    Args:
        A: (m, n). b: (m,).
    """
    m, n = A.shape
    size = float(np.abs(np.linalg.pinv(A) @ b).max())
    x = np.eye(n, n + 1)
    t = np.eye(1, n + 1, n)
    rows = np.vstack((t - x, t + x, np.pad(A, ((0, 0), (0, 1)))))
    lower = np.append(np.zeros(2 * n), b / max(size, 1e-300))
    upper = np.append(np.full(2 * n, 1e30), lower[2 * n :])
    sense = np.repeat([0, 5], (2 * n, m)).astype(np.int32)
    H = np.diag(np.append(np.full(n, 1e-4), 1.0))
    found, _, flag, _ = daqp.solve(H, np.zeros(n + 1), rows, upper, lower, sense)
    return size * float(np.abs(found[:n]).max()) if flag > 0 else size


# --- a robot ------------------------------------------------------------------------------------


@rule(0.0, 0.9, "{why}")
def first_tick(task: Task) -> Values:
    """A copy of the controller is given what is measured and the first reference."""
    assert task.controller is not None and task.measured is not None
    trial = copy(task.controller)
    trial.tick(task.measured, next(task.every(task.dt)))
    if trial.status is Status.HELD:
        yield 1.0, {"why": trial.reason}
    elif task.pairs and is_clear(trial.settings, trial._records):
        error = trial.residual_wrench() - trial.f_tare
        why = judge_load(trial.settings, error, trial.result().bias_out)
        if why:  # a controller that has not engaged may still be tared
            yield 1.0 if trial.engaged else 0.5, {"why": why}


@rule(
    0.005,
    0.1,
    "the first reference puts the object {value:.3g} m away from where it is, at {first} m instead "
    "of {now} m; begin the motion at chain.state(q, v).X_WO",
)
def jump(task: Task) -> Values:
    """From the pose to the first reference (m)."""
    first = task.poses[0, :3]
    now = task.state.X_WO.translation
    yield norm(first - now), {"first": rounded(first), "now": rounded(now)}


@rule(
    0.9,
    1.0,
    "to hold the arm, {joint} needs {torque:.4g} N m (or N), {value:.2g} times its limit of "
    "{most:.4g}; all that moves weighs {mass:.4g} kg: are masses in kg and lengths in m?",
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
    joint = chain.joint_names[chain.actuated[worst]]
    words = {"torque": bias[worst], "most": chain.tau_max[worst]}
    yield share[worst], {"joint": joint, **words, "mass": placement.mass_of(chain)}


@rule(
    0.0, 0.0, "{name} is −{value:.3g} N at t = {t:.3g} s; this contact cannot pull: give forces ≥ 0"
)
def pulls(task: Task) -> Values:
    """Forces below zero (−N)."""
    for name, owner, force in zip(task.force_names, task.owners, task.forces.T, strict=True):
        if pushes_only(task.pairs[owner]):
            least = int(force.argmin())
            yield -force[least], {"name": name, "t": task.times[least]}


@rule(
    1.0,
    1.0,
    "{name} is {force:.4g} N at t = {t:.3g} s, and readings beyond safety.force_range = "
    "{range:.4g} N are rejected; command less force, or raise force_range to what the wrist "
    "sensor measures",
)
def measured_range(task: Task) -> Values:
    """Forces, over what a wrist sensor may read."""
    most = task.safety.force_range
    for name, force in zip(task.force_names, np.abs(task.forces).T, strict=True):
        k = force.argmax()
        words = {"name": name, "t": task.times[k], "force": force[k], "range": most}
        yield force[k] / most, words


#: What a task has to follow; a new rule is entered in one of these rows. `joints` go through a
#: motion that none of `MOTION_RULES` finds fault with.
RIG_RULES = (sensors, tare, springs, swinging, *placement.RIG_RULES, friction, carts, landing)
ROBOT_RULES = (first_tick, jump, weights, pulls, measured_range, *placement.SCENE_RULES)
MOTION_RULES = (stretched, postures, placement.lifted)
