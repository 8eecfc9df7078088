"""Rules on robot, controller and references, which `run_loop` checks before the first command."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from functools import partial
from itertools import chain as joined
from itertools import islice
from typing import Any

import daqp
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.contacts.feet import contact_at, force_owners
from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.control.controller import Controller
from osc_contact.control.start_check import is_clear, judge_load
from osc_contact.control.status import SafetyState, Status
from osc_contact.dynamics.arm import stretched_length
from osc_contact.dynamics.assembly import object_pose, reach
from osc_contact.errors import InvalidInputError, ModelError, OscContactError, brief
from osc_contact.interface import Measurement, Reference
from osc_contact.loop.protocols import Measures
from osc_contact.loop.rules import Finding, Task, Values, doubt, findings, rounded, rule
from osc_contact.loop.scene_rules import SCENE_RULES
from osc_contact.recorder.recording import column_names
from osc_contact.robots.model import position_limits
from osc_contact.settings.control import JointFriction, SafetySettings
from osc_contact.spatial import Array, norm

LOOKS = 400  #: number of evenly spaced references that are checked, in addition to extreme ones
PERIOD_S = 4e-3  #: s, longest tick of a rehearsal
GAIN = 0.3  #: largest product of that tick and the gains
REHEARSED = 2000  #: largest number of ticks of a rehearsal in `run_loop`
READINGS = 10  #: number of measurements to wait for one that can be computed (late sensors)
MOST_COMPARED = 50_000  #: largest number of references whose poses and forces are searched
LAG_DOUBTFUL, LAG_REFUSED = 1e-3, 0.02  #: m, rad, limits of the deviation of an object from X_WD
SAME_RATE = 0.2  #: largest relative remainder of the rate of X_WD after subtracting s V_D
WEAK_DOUBTFUL = 5e-3  #: m, rad, limit of that deviation because of saturated motors
JUMPS = 2  #: number of checked references at which X_WD may jump
SPACING_DOUBTFUL, SPACING_REFUSED = 0.1, 0.4  #: limits of |ln| of the references' period over dt
ROUNDING = 1e-6  #: m, excess of a distance that counts as rounding
#: Relations of V_D and the rate of X_WD: V_D is zero, the rate is s V_D, or neither.
_LEFT_OUT, _A_FACTOR, _ANOTHER = "left out", "a factor", "another motion"
_logger = logging.getLogger("osc_contact.preflight")


def checked(
    robot: Measures, controller: object, references: Iterable[Reference]
) -> Iterable[Reference]:
    """Check robot, controller and references of a loop by all rules; return the references.

    A sequence is checked as a whole. Of an iterator only the first reference is checked, which is
    logged; the result begins with this reference. Warnings are logged.

    Args:
        robot: robot at rest at the start of the loop; it is measured, but not commanded.
        controller: a `Controller`, which is not changed; with another object nothing is checked.
        references: references of the loop, one for each tick.

    Raises:
        InvalidInputError: a rule refuses the task; the message has all findings.
    """
    if not isinstance(controller, Controller):
        return references
    given = references
    if not isinstance(given, Sequence):
        try:
            rest = iter(given)
        except TypeError as error:
            raise InvalidInputError(
                f"references is {brief(given)}; give one for each tick, such as a list of "
                "osc.Reference, or itertools.repeat(reference, ticks)"
            ) from error
        given = list(islice(rest, 1))
        references = joined(given, rest)
        _logger.info(
            "the references are an iterator: only the first of them is checked before the start; "
            "a list is checked as a whole"
        )
    found = judge_robot(task_of_robot(robot, controller, given, REHEARSED))
    refused = [one.text for one in found if one.refused]
    if refused:
        raise InvalidInputError(
            "\n".join(refused) + "\n(these are compared before the first command; "
            "check=False leaves it out)"
        )
    for one in found:
        _logger.warning("doubtful: %s", one.text)
    return references


def judge_robot(task: Task) -> tuple[Finding, ...]:
    """Findings on a robot with its controller and references."""
    found = findings(ROBOT_RULES, task)
    if task.scene is not None:
        found += findings(SCENE_RULES, task)
    if any(one.refused for one in found):  # further findings would be consequences
        return tuple(found)
    return (*found, *judge_motion(task))


def judge_motion(task: Task) -> tuple[Finding, ...]:
    """Findings on the motions and forces of a task."""
    motion = findings(MOTION_RULES, task) or findings((joints,), task)
    return (*findings((rate, *CEILINGS), task), *motion, *findings((motors,), task))


def task_of_robot(
    robot: Any, controller: Controller, given: Sequence[Reference], rehearsed: int | None = None
) -> Task:
    """Make the task of a robot at rest at the start of its loop; the robot is measured.

    Args:
        robot: a `Robot`, optionally with a method `scene`. controller: its controller.
        given: references, one for each tick, from the first on. rehearsed: largest number of ticks
            of a rehearsal; None: the whole motion.

    Raises:
        InvalidInputError: no references, not all of them have a force for each column, or the
            robot has other joints.
    """
    settings = controller.settings
    pairs = settings.contacts
    chain = settings.chain
    dt = settings.dt
    assert settings.posture is not None  # settings choose the neutral one
    owners = force_owners(pairs)
    _require_forces(given, len(owners))
    measured = _reading(robot, controller, given[0])
    q = np.asarray(measured.q, dtype=float)
    if chain.nq != len(q):
        raise InvalidInputError(f"the robot measures {len(q)} joints of {chain.nq}")
    state = chain.state(q)
    looks = _looks(given)
    active = _active_contacts([given[k] for k in looks], len(pairs))
    forces = np.array([given[k].alpha_d for k in looks])
    following = looks[looks < len(given) - 1]
    names = column_names([pair.name for pair in pairs], owners.tolist())
    return Task(
        chain=chain,
        pairs=pairs,
        gains=settings.gains,
        dt=dt,
        posture=settings.posture,
        safety=settings.safety,
        q=q,
        q_contact=q,
        state=state,
        contact=contact_at(pairs, state.X_WO),
        times=looks * dt,
        poses=np.array([pin.SE3ToXYZQUAT(given[k].X_WD) for k in looks]),
        forces=forces if active is None else forces * active[:, owners],
        active=active,
        trial=partial(_engaged_copy, controller, measured),
        rates=_rows_of_six([_displacement(given[k], given[k + 1]) / dt for k in following]),
        twists=_rows_of_six([0.5 * (given[k].V_D + given[k + 1].V_D) for k in following]),
        squeezes=np.array([np.abs(given[k].squeeze_d).sum() for k in looks]),
        commanded=np.array([given[k].V_D for k in looks]),
        every=lambda period: iter(given[:: max(1, round(period / dt))]),
        force_names=[f"alpha_d of {name}" for name in names],
        owners=owners,
        rests=[body is None for body in settings.bodies],
        bound=settings.life is None,
        rehearsed=rehearsed,
        controller=controller,
        measured=measured,
        scene=robot.scene() if hasattr(robot, "scene") else None,
    )


def _active_contacts(given: Sequence[Reference], contacts: int) -> Array | None:
    """Active contacts (k, contacts) of references, 1 or 0; None if none of them names any."""
    if all(one.active is None for one in given):
        return None
    every = np.ones(contacts)
    return np.array([every if one.active is None else one.active != 0 for one in given], float)


def _engaged_copy(controller: Controller, measured: Measurement) -> tuple[Controller, Measurement]:
    """Copy of a controller with its contacts engaged, and the measurement."""
    trial = copy(controller)
    trial.engaged = True
    return trial, measured


def _rows_of_six(twists: Sequence[Array]) -> Array:
    """Stack twists (6,) as the rows of an array (k, 6), also where there are none."""
    return np.array(twists, dtype=float).reshape(-1, 6)


def _require_forces(given: Sequence[Reference], r: int) -> None:
    """Refuse references of another class, or without r desired forces."""
    if not len(given):
        raise InvalidInputError(
            "there are no references; give one for each tick (a generator gives its own only once)"
        )
    for k, one in enumerate(given):
        if not isinstance(one, Reference):
            raise InvalidInputError(
                f"reference {k} is {brief(one)}; give osc.Reference(X_WD, V_D, A_D, alpha_d)"
            )
        if len(one.alpha_d) != r:
            raise InvalidInputError(
                f"reference {k}: alpha_d has shape {one.alpha_d.shape}, and the contacts have {r} "
                "columns of N; give one force for each (N)"
            )


def _reading(robot: Measures, controller: Controller, first: Reference) -> Measurement:
    """Measure the robot until a tick can be computed, up to `READINGS` times."""
    for _ in range(READINGS):
        measured = robot.measure()
        trial = copy(controller)
        trial.tick(measured, first)
        if trial.status is not Status.HELD:
            break
    return measured


def _looks(given: Sequence[Reference]) -> Array:
    """Indices of references that are checked: evenly spaced, extreme, with new active contacts."""
    step = -(-len(given) // MOST_COMPARED)
    places = np.array([one.X_WD.translation for one in given[::step]])
    forces = np.array([one.alpha_d for one in given[::step]])
    numbers = np.hstack((places, forces.reshape(len(places), -1)))
    extreme = step * np.append(numbers.argmin(axis=0), numbers.argmax(axis=0))
    even = np.linspace(0, len(given) - 1, LOOKS).astype(int)
    sets = [None if one.active is None else one.active.tobytes() for one in given[::step]]
    new = [step * k for k in range(1, len(sets)) if sets[k] != sets[k - 1]]
    return np.unique(np.concatenate((even, extreme, np.array(new, dtype=int))))


def _displacement(before: Reference, after: Reference) -> Array:
    """Displacement (6,) of X_WD from one reference to the next (m, rad), world axes."""
    X = before.X_WD
    turned = pin.log3(after.X_WD.rotation @ X.rotation.T)
    return np.concatenate((after.X_WD.translation - X.translation, turned))


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
    ROUNDING,
)
def stretched(task: Task) -> Values:
    """Excess (m) of the object's distance from the base of an arm over the stretched length."""
    for arm, grasp in zip(task.chain.arms, task.chain.grasps, strict=True):
        most = stretched_length(arm) + norm(grasp.X_TO.translation)
        far = np.linalg.norm(task.poses[:, :3] - arm.base.translation, axis=1)
        k = far.argmax()
        words = {"far": far[k], "name": arm.name, "t": task.times[k], "most": most}
        yield far[k] - most, words


@doubt(
    "at t = {t:.3g} s the motion leads the object to where no posture near the start puts it "
    "({where} m){left}; command a smaller motion, or begin in another posture",
    0.02,
)
def postures(task: Task) -> Values:
    """Distance (m) of the object from extreme poses that no posture near the start reaches."""
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
        except ModelError:  # the iteration does not converge for a pose out of reach
            pass
        else:
            away = norm(object_pose(chain, q).translation - X.translation)
            ends = np.flatnonzero(np.minimum(q - low, high - q) < 1e-6)
            names = ", ".join(chain.joint_names[j] for j in ends)
            left = f": {1e3 * away:.0f} mm are left"
            if names:
                left += f" with {names} at the end stop"
        yield away, {"t": task.times[k], "where": rounded(X.translation, 3), "left": left}
        if away > postures.doubtful:
            return


@rule(
    "at t = {at:.3g} s the motion would {why}; command a smaller or slower motion, or begin in "
    "another posture",
    WEAK_DOUBTFUL,
    LAG_REFUSED,
)
def joints(task: Task) -> Values:
    """Deviation (m, rad) of the object from X_WD by motor limits; inf if joint limits stop it.

    The motion is simulated without contacts: the joints follow the commanded accelerations without
    errors. The loss of an acceleration a causes the deviation a / K_p, averaged as rms over time.
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
    lost = np.zeros(2)  # sums of the squares of linear and angular accelerations
    first = ""
    began = 0.0
    ticks = 0
    try:
        # The model's friction only: from wrists that read zero, more of it would be identified.
        controller = Controller(
            chain,
            (),
            task.gains,
            dt=dt,
            posture=task.posture,
            safety=safety,
            joint_friction=JointFriction(learning=False, share=0.0, errors=False),
        )
        for desired in islice(task.every(dt), task.rehearsed):
            motion = Reference(desired.X_WD, desired.V_D, desired.A_D)
            controller.tick(Measurement(q.copy(), v.copy(), still), motion)
            at = ticks * dt
            ticks += 1
            if controller.state is SafetyState.SAFE_STOP:
                why = controller.reason.removesuffix(". See why, then call reset()")
                yield np.inf, {"at": at, "why": f"end in a stop: {why}"}
                return
            given_up = controller.given_up
            if given_up is not None:
                lost += np.square(given_up.acceleration).reshape(2, 3).sum(axis=1)
                began, first = (began, first) if first else (at, str(given_up))
            v = v + _acceleration(controller) * dt
            q = q + v * dt
    except OscContactError:  # the motion cannot be simulated without contacts
        return
    if first and task.gains.motion.stiffness > 0.0:
        off = float(np.sqrt(lost.max() / ticks)) / task.gains.motion.stiffness
        why = (
            f"need more than the motors give ({first}) and put the object {off:.2g} m or rad (rms) "
            "off X_WD"
        )
        yield off, {"at": began, "why": why}


def _acceleration(controller: Controller) -> Array:
    """Joint accelerations (n,) by the last tick, including null-space motions of redundant arms.

    q̈ = J̄a + offset + (1 − J̄J)M⁻¹(τ₀ − h), where τ₀ are the posture torques. Without the last
    summand the posture would drift until a joint comes near its limit.
    """
    chain = controller.settings.chain
    joints = controller.records.work.joints
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
    """Smallest peak torque, over the limits, for forces and weight, with any internal forces."""
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
    # a peak slightly above the limits only saturates for some time
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
    """Smallest max |x| of all x with A x = b, to 0.2 %, from min t² + ε|x|² with |x| ≤ t.

    If A x = b has no solution, max |x| of the least-squares solution is returned.

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
    """Find a first tick that cannot be computed, or wrist readings that differ from the load.

    The tick is computed by a copy of the controller. The value is 1 for an error, 0.5 for a warning
    (the controller may still be tared).
    """
    assert task.controller is not None and task.measured is not None
    trial = copy(task.controller)
    trial.tick(task.measured, next(task.every(task.dt)))
    if trial.status is Status.HELD:
        yield 1.0, {"why": trial.reason}
    elif task.pairs and is_clear(trial.settings, trial.records):
        error = trial.residual_wrench() - trial.f_tare
        most = trial.settings.safety.load_error
        why = judge_load(trial.chain, most, error, trial.result().bias_out)
        if why:
            may_change = not trial.engaged or not np.any(task.measured.wrenches)
            yield 0.5 if may_change else 1.0, {"why": why}


@rule(
    "the first reference puts the object {value:.3g} m away from where it is, at {first} m instead "
    "of {now} m; begin the motion at chain.state(q, v).X_WO",
    0.005,
    0.1,
)
def jump(task: Task) -> Values:
    """Distance from the present pose of the object to the first reference (m)."""
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
    """Torques that hold the arms without contact forces, as shares of the motors' limits.

    The weight of the object is included for a single arm; several arms may share it in any way.
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
        "mass": chain.moved_mass,
    }
    yield share[worst], words


@rule("{name} is −{value:.3g} N at t = {t:.3g} s; this contact cannot pull: give forces ≥ 0")
def pulls(task: Task) -> Values:
    """Negated forces (N) of contacts that cannot pull; positive values are findings."""
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
    """Desired forces divided by the range of the wrist sensors."""
    most = task.safety.force_range
    for name, force in zip(task.force_names, np.abs(task.forces).T, strict=True):
        k = force.argmax()
        words = {"name": name, "t": task.times[k], "force": force[k], "range": most}
        yield force[k] / most, words


@rule(
    "{name} is {force:.4g} N at t = {t:.3g} s, above safety.{key} = {most:.4g} N, at which the "
    "arms are stopped; command less force, or raise {key} to what task and robot permit",
    1.0,
)
def force_ceilings(task: Task) -> Values:
    """Commands of single contacts, and their sum, divided by the given ceilings."""
    forces = np.abs(task.forces)
    total = forces.sum(axis=1)
    total[: len(task.squeezes)] += task.squeezes
    compared = dict(zip(task.force_names, forces.T, strict=True))
    if len(task.squeezes) and len(task.chain.arms) == 2:
        compared["the internal force"] = task.squeezes
    all_at_once = "the sum of all commanded forces"
    for name, force in {**compared, all_at_once: total}.items():
        key = "wrist_ceiling" if name == all_at_once else "contact_ceiling"
        most = getattr(task.safety, key)
        if most is not None:
            k = force.argmax()
            words = {"name": name, "t": task.times[k], "force": force[k], "key": key}
            yield force[k] / most, words | {"most": most}


@rule(
    "the motion leads the tip of arm '{name}' at {speed:.3g} m/s at t = {t:.3g} s, above "
    "safety.speed_ceiling = {most:.3g} m/s, at which the arms are stopped; command a slower "
    "motion, or raise speed_ceiling to what task and robot permit",
    1.0,
)
def speed_ceiling(task: Task) -> Values:
    """Speeds of the arms' tips by V_D, divided by their ceiling."""
    most = task.safety.speed_ceiling
    V = task.commanded
    if not len(V) or not most < np.inf:
        return
    axis = task.poses[:, 3:6]  # of the quaternion
    for arm, grasp in zip(task.chain.arms, task.chain.grasps, strict=True):
        point = grasp.X_TO.inverse().translation  # of the tip, in the object
        across = 2.0 * np.cross(axis, point)
        lever = point + task.poses[:, 6:] * across + np.cross(axis, across)
        speeds = np.linalg.norm(V[:, :3] + np.cross(V[:, 3:], lever), axis=1)
        k = speeds.argmax()
        words = {"name": arm.name, "speed": speeds[k], "t": task.times[k], "most": most}
        yield speeds[k] / most, words


@doubt(
    "the motion leads the object {mm:.0f} mm {way} the surface of contact '{name}', which "
    "does not permit it: that part is not followed; give a direction along the surface, such as "
    "common_tangent, and press with force",
    0.005,
)
def lifted(task: Task) -> Values:
    """Change of a gap (m) by the motion while the contact is to be maintained.

    Of a contact that becomes active later on, the change is counted from the gap at that time.
    """
    kept = np.flatnonzero(task.times >= task.kept_from)
    kept = kept[:: max(1, len(kept) // 100)]
    for i, pair in enumerate(task.pairs):
        pressed = np.any(task.forces[kept][:, task.owners == i] > 0.0, axis=1)
        pressed = pressed | task.bound  # a contact that is not bound opens when its force ends
        if task.active is not None:
            pressed = np.asarray(task.active[kept, i] != 0.0)
        gaps = np.array([pair.gaps(pin.XYZQUATToSE3(X)) for X in task.poses[kept[pressed]]])
        if task.rests[i] and len(gaps):
            if task.active is not None:
                first = _beginnings(pressed)
                given = (first == 0) & pressed[0]  # touching at the start of the task
                gaps = np.where(given[:, None], gaps, gaps - gaps[first])
            worst = np.abs(gaps).max(initial=0.0)
            way = "into" if -np.min(gaps, initial=0.0) >= np.max(gaps, initial=0.0) else "off"
            yield worst, {"way": way, "name": pair.name}


def _beginnings(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Of each set flag, the number (among the set flags) of the first one of its stretch."""
    first = flags & ~np.append(False, flags[:-1])
    number = np.cumsum(flags)[first] - 1
    return np.asarray(number[np.cumsum(first)[flags] - 1])


@rule("{names}, active together from t = {t:.3g} s on, cannot be controlled: {why}")
def together(task: Task) -> Values:
    """Find named sets of contacts with which no tick can be computed, at the start of the task."""
    if task.active is None or task.trial is None:
        return
    _, first = np.unique(task.active, axis=0, return_index=True)
    for k in np.sort(first):
        controller, measured = task.trial()
        alpha_d = task.forces[k]
        here = Reference(task.state.X_WO, alpha_d=alpha_d, active=task.active[k])
        controller.tick(measured, here)
        if controller.status is Status.HELD:
            names = " and ".join(
                task.pairs[i].name for i in np.flatnonzero(task.active[k]).tolist()
            )
            yield (
                1.0,
                {"names": names or "no contact", "t": task.times[k], "why": controller.reason},
            )


@doubt(
    "contact '{name}' becomes active at t = {t:.3g} s, where the motion has it {mm:.0f} mm away "
    "from what it touches, and is taken as closed at once; {cure}",
    0.005,
)
def far_off(task: Task) -> Values:
    """Gap (m) of contacts that become active later on and are not approached."""
    for i, pair in enumerate(task.pairs if task.active is not None else ()):
        assert task.active is not None
        approached = not task.bound and pushes_only(pair)
        begins = np.flatnonzero(np.diff(task.active[:, i]) > 0.0) + 1
        for k in begins if task.rests[i] and not approached else ():
            away = np.abs(pair.gaps(pin.XYZQUATToSE3(task.poses[k]))).max(initial=0.0)
            cure = "lead the object there before"
            if pushes_only(pair):
                cure += ", or have it approached (control.life)"
            yield away, {"name": pair.name, "t": task.times[k], "cure": cure}


@rule(
    "X_WD moves by {share:.3g} times V_D × dt: references seem to be spaced {spacing:.3g} ms, and "
    "the controller's period is {dt:.3g} ms; space them by controller.dt, or give V_D in m/s and "
    "rad/s",
    SPACING_DOUBTFUL,
    SPACING_REFUSED,
)
def spacing(task: Task) -> Values:
    """Logarithm (absolute value) of the ratio of the rate of X_WD and V_D, if it is constant."""
    dt = 1e3 * task.dt
    for _, share in _moving_parts(task, _A_FACTOR):
        yield abs(np.log(share)), {"share": share, "spacing": share * dt, "dt": dt}


@rule(
    "V_D is up to {off:.3g} {unit} off the rate of X_WD, which reaches {speed:.3g} {unit}: "
    "it would lead the object {value:.3g} {length} off; give V_D as the time derivative of X_WD, "
    "and A_D as that of V_D",
    LAG_DOUBTFUL,
    LAG_REFUSED,
)
def contradiction(task: Task) -> Values:
    """Deviation (m, rad) of the object from X_WD by a V_D that is another motion."""
    return _leads(task, _ANOTHER)


@doubt(
    "V_D is zero while X_WD moves at up to {speed:.3g} {unit}: the object follows {value:.3g} "
    "{length} behind; give V_D as the time derivative of X_WD, and A_D as that of V_D",
    LAG_DOUBTFUL,
)
def lag(task: Task) -> Values:
    """Lag (m, rad) of the object behind X_WD if V_D is zero."""
    return _leads(task, _LEFT_OUT)


def _leads(task: Task, relation: str) -> Values:
    """Deviations K_d/K_p |rate − V_D| (m, rad) of the linear and angular parts of a relation.

    Args:
        task: the task. relation: relation of V_D and the rate of X_WD.
    """
    motion = task.gains.motion
    for part, _ in _moving_parts(task, relation):
        rates = task.rates[:, part]
        off = np.linalg.norm(rates - task.twists[:, part], axis=1)
        if motion.stiffness == 0.0 or len(off) <= JUMPS:
            continue
        most = float(np.sort(off)[-JUMPS - 1])
        speed = float(np.sort(np.linalg.norm(rates, axis=1))[-JUMPS - 1])
        units = ("m/s", "m") if part.start == 0 else ("rad/s", "rad")
        words = dict(zip(("unit", "length"), units, strict=True))
        yield most * motion.damping / motion.stiffness, words | {"off": most, "speed": speed}


def _moving_parts(task: Task, relation: str) -> Iterator[tuple[slice, float]]:
    """Yield the moving parts (linear, angular) in which V_D and the rate of X_WD have a relation.

    Each part is a slice of (6,), with the factor s of rate = s V_D by least squares over all
    checked references; s is 0 if V_D is zero.
    """
    for part in slice(0, 3), slice(3, 6):
        D = task.rates[:, part]
        V = task.twists[:, part]
        size = norm(D)
        if size <= 1e-9 * len(D) or not np.isfinite(size):
            continue
        share = float((D * V).sum() / (V * V).sum()) if V.any() else 0.0
        found = _LEFT_OUT
        if share != 0.0:
            same = share > 0.0 and norm(D - share * V) < SAME_RATE * size
            found = _A_FACTOR if same else _ANOTHER
        if found == relation:
            yield part, share


#: All rules on a task; a new rule is added to one of these lists. `joints` simulates a motion only
#: if `MOTION_RULES` have no findings.
ROBOT_RULES = (first_tick, jump, weights, pulls, measured_range, spacing, contradiction)
CEILINGS = (force_ceilings, speed_ceiling)
MOTION_RULES = (stretched, postures, lifted, together, far_off, lag)
