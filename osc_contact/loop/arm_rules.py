"""Rules on abilities of controller and arms: rate, reach, joint limits, motors, load at rest."""

from __future__ import annotations

from copy import copy
from itertools import islice

import daqp
import numpy as np
import pinocchio as pin

from osc_contact.control.controller import Controller
from osc_contact.control.start_check import is_clear, judge_load
from osc_contact.control.status import SafetyState, Status
from osc_contact.dynamics.arm import stretched_length
from osc_contact.dynamics.assembly import object_pose, reach
from osc_contact.errors import ModelError, OscContactError
from osc_contact.interface import Measurement, Reference
from osc_contact.loop.reference_rules import LAG_REFUSED
from osc_contact.loop.rules import Task, Values, doubt, rounded, rule
from osc_contact.robots.model import position_limits
from osc_contact.settings.control import JointFriction, SafetySettings
from osc_contact.spatial import Array, norm

PERIOD_S = 4e-3  #: longest tick of a simulated motion (s)
GAIN = 0.3  #: largest product of that tick and the gains
WEAK_DOUBTFUL = 5e-3  #: m, rad, limit of the deviation from X_WD because of saturated motors
ROUNDING = 1e-6  #: m, excess of a distance that counts as rounding


@rule(
    "control.rate {rate:g} Hz is too slow for gains.{name} {gain:g} 1/s: their ratio is "
    "{value:.2g}, and a sampled loop diverges from 2 on; raise the rate to {enough:.0f} Hz, or "
    "lower the gain",
    0.7,
    2.0,
)
def rate(task: Task) -> Values:
    """Products of gains (1/s) and control period (s); a sampled loop diverges from 2 on.

    A gain that follows from a frequency or bandwidth is named together with it in the finding.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    motion = task.gains.motion
    force = task.gains.force
    is_own_setting = "damping" in motion.model_fields_set
    name = "motion." if is_own_setting else f"motion.frequency {motion.frequency:g} Hz, "
    gains = {f"{name}damping": motion.damping}
    if task.pairs:
        is_own_setting = "integral" in force.model_fields_set
        name = "force." if is_own_setting else f"force.bandwidth {force.bandwidth:g} Hz, "
        gains |= {f"{name}integral": force.integral, f"{name}brake": force.brake}
    for name, gain in gains.items():
        words = {"name": name, "gain": gain, "rate": 1.0 / task.dt, "enough": 10 * gain}
        yield gain * task.dt, words


@rule(
    "the motion leads the object to {far:.3g} m from the base of arm '{name}' at t = {t:.3g} s, "
    "and the stretched arm reaches {most:.3g} m; command a smaller motion (are its signals in the "
    "right unit?)",
    ROUNDING,
)
def stretched(task: Task) -> Values:
    """Excess (m) of the object's distance from the base of an arm over the stretched length.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    for arm, grasp in zip(task.chain.arms, task.chain.grasps, strict=True):
        largest = stretched_length(arm) + norm(grasp.X_TO.translation)
        distances = np.linalg.norm(task.poses[:, :3] - arm.base.translation, axis=1)
        k = distances.argmax()
        words = {"far": distances[k], "name": arm.name, "t": task.times[k], "most": largest}
        yield distances[k] - largest, words


@doubt(
    "at t = {t:.3g} s the motion leads the object to where no posture near the start puts it "
    "({where} m){left}; command a smaller motion, or begin in another posture",
    0.02,
)
def postures(task: Task) -> Values:
    """Distance (m) of the object from extreme poses that no posture near the start reaches.

    Extreme are the poses with the largest displacements along each axis and the largest rotation
    from the first pose. The first pose that is not reached ends the search.

    Args:
        task: task to be checked.
    """
    if any(stretched.findings(task)):
        return
    chain = task.chain
    poses = task.poses
    low, high = position_limits(chain.model)
    displacements = poses[:, :3] - poses[0, :3]
    half_cosines = np.abs(poses[:, 3:] @ poses[0, 3:])  # cosine of half the angle of rotation
    extremes = {
        *displacements.argmax(axis=0),
        *displacements.argmin(axis=0),
        half_cosines.argmin(),
    }
    for k in sorted(extremes):
        X = pin.XYZQUATToSE3(poses[k])
        distance = np.inf
        remainder = ""
        try:
            q = reach(chain, task.q_contact, X, 1e-3)
        except ModelError:  # the iteration does not converge for a pose out of reach
            pass
        else:
            distance = norm(object_pose(chain, q).translation - X.translation)
            at_end_stops = np.flatnonzero(np.minimum(q - low, high - q) < 1e-6)
            names = ", ".join(chain.joint_names[j] for j in at_end_stops)
            remainder = f": {1e3 * distance:.0f} mm are left"
            if names:
                remainder += f" with {names} at the end stop"
        place = rounded(X.translation, 3)
        yield distance, {"t": task.times[k], "where": place, "left": remainder}
        if distance > postures.doubtful:
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

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    chain = task.chain
    rigid = all(grasp.is_rigid for grasp in chain.grasps)
    if not rigid or not np.ptp(task.poses, axis=0).max() > 0.0:
        return  # a loose object needs its contacts
    # period of the simulation: whole control periods, short enough for the motion gains
    dt = max(task.dt, min(PERIOD_S, GAIN / max(task.gains.motion.damping, 1.0)))
    dt = task.dt * round(dt / task.dt)
    q = task.q.copy()
    v = np.zeros(chain.nq)
    still = np.zeros((len(chain.arms), 6))
    losses = np.zeros(2)  # sums of the squares of linear and angular accelerations given up
    first_loss = ""
    first_time = 0.0
    ticks = 0
    try:
        controller = _motion_controller(task, dt)
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
                losses += np.square(given_up.acceleration).reshape(2, 3).sum(axis=1)
                if not first_loss:
                    first_time = at
                    first_loss = str(given_up)
            v = v + _acceleration(controller) * dt
            q = q + v * dt
    except OscContactError:  # the motion cannot be simulated without contacts
        return
    # deviation a/K_p by the acceleration a that is given up, rms over all ticks
    if first_loss and task.gains.motion.stiffness > 0.0:
        deviation = float(np.sqrt(losses.max() / ticks)) / task.gains.motion.stiffness
        why = (
            f"need more than the motors give ({first_loss}) and put the object {deviation:.2g} m "
            "or rad (rms) off X_WD"
        )
        yield deviation, {"at": first_time, "why": why}


def _motion_controller(task: Task, dt: float) -> Controller:
    """Make the controller of a simulated motion: the task's motion without its contacts.

    Of the safety rules only those of motors and joint limits apply. Friction is that of the model:
    from wrist readings of zero, further friction would be identified.

    Args:
        task: task whose chain, gains, posture and limits are taken.
        dt: period of the simulation (s).

    Raises:
        OscContactError: the motion has no controller without contacts.
    """
    keys = ("overspeed_time", "brake_time", "hold_rate")
    return Controller(
        task.chain,
        (),
        task.gains,
        dt=dt,
        posture=task.posture,
        safety=SafetySettings.motors_only(**{key: getattr(task.safety, key) for key in keys}),
        joint_friction=JointFriction(learning=False, share=0.0, errors=False),
    )


def _acceleration(controller: Controller) -> Array:
    """Joint accelerations (n,) by the last tick, including null-space motions of redundant arms.

    q̈ = J̄a + offset + (1 − J̄J)M⁻¹(τ₀ − h), where τ₀ are the posture torques. Without the last
    summand the posture would drift until a joint comes near its limit.

    Args:
        controller: controller without contacts whose last tick has been computed.

    Returns:
        Accelerations of the joints of all arms, in the chain's order (rad/s², m/s²).
    """
    chain = controller.settings.chain
    joints = controller.records.work.joints
    a = controller.joint_acceleration()
    for arm, s, grasp in zip(chain.arms, chain.slices, chain.grasps, strict=True):
        n = arm.model.nv
        if n > grasp.N.shape[1]:
            arm_acceleration = np.linalg.solve(joints.M[s, :n], joints.rest[s] - joints.h[s])
            a[s] += arm_acceleration - np.asarray(joints.J_bar[s]) @ (
                np.asarray(joints.J[s]).T @ arm_acceleration
            )
    return a


@rule(
    "{name} is {force:.4g} N at t = {t:.3g} s, for which motors would need {value:.2g} times "
    "their limits at least (most of all {joint}, {most:.3g} N m or N); command less force, or "
    "choose another posture",
    0.0,
    3.0,
)
def motors(task: Task) -> Values:
    """Smallest peak torque, over the limits, for forces and weight, with any internal forces.

    Evaluated in the posture in contact, at rest, for the desired forces α (r,) with the largest
    torques: G τ = b_S + SᵀNα (21). The largest |τ_i|/τ_max,i of the motors is made as small as
    internal forces permit. If the median of the desired forces needs more than the limits, too, the
    same value is a finding although it is not above the limit for refusal.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    if not task.pairs or not task.contact.r or not task.state.d:
        return
    state = task.state
    contact = task.contact
    chain = task.chain
    limits = np.minimum(chain.tau_max, 1e12)
    required = state.b_S[:, None] + state.S.T @ contact.N @ contact.R @ task.forces.T
    shares = np.linalg.pinv(state.G * limits) @ required  # of each motor's limit, least squares
    order = np.argsort(np.abs(shares).max(axis=0))
    hardest = order[-1]
    median = order[len(order) // 2]
    peak = least_peak(state.G * limits, required[:, hardest])
    # a peak slightly above the limits only saturates for some time
    if peak > motors.refused or least_peak(state.G * limits, required[:, median]) > 1.0:
        column = task.forces[hardest].argmax()
        motor = np.abs(shares[:, hardest]).argmax()
        words = {
            "name": task.force_names[column],
            "force": task.forces[hardest, column],
            "t": task.times[hardest],
            "joint": chain.joint_names[chain.actuated[motor]],
            "most": limits[motor],
        }
        yield peak, words


def least_peak(A: Array, b: Array) -> float:
    """Smallest max |x| of all x with A x = b, to 0.2 %, from min t² + ε|x|² with |x| ≤ t.

    If A x = b has no solution, max |x| of the least-squares solution is returned.

    Args:
        A: (m, n), such as G times the motors' limits.
        b: (m,), such as the generalised force that the motors must give.

    Returns:
        max |x|, here the largest share of a motor's limit.
    """
    m, n = A.shape
    size = np.abs(np.linalg.pinv(A) @ b).max()
    x = np.eye(n, n + 1)  # selects x of the unknowns (x, t), divided by size
    t = np.eye(1, n + 1, n)  # selects t
    rows = np.vstack((t - x, t + x, np.pad(A, ((0, 0), (0, 1)))))
    lower = np.append(np.zeros(2 * n), b / max(size, 1e-300))
    upper = np.append(np.full(2 * n, 1e30), lower[2 * n :])
    sense = np.repeat([0, 5], (2 * n, m)).astype(np.int32)  # 5 marks an equation
    H = np.diag(np.append(np.full(n, 1e-4), 1.0))
    solution, _, flag, _ = daqp.solve(H, np.zeros(n + 1), rows, upper, lower, sense)
    return size * np.abs(solution[:n]).max() if flag > 0 else size


@rule(
    "{why}",
    0.0,
    0.9,
)
def first_tick(task: Task) -> Values:
    """Find a first tick that cannot be computed, or wrist readings that differ from the load.

    The tick is computed by a copy of the controller. The value is 1 for an error, 0.5 for a warning
    (the controller may still be tared).

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    assert task.controller is not None and task.measured is not None
    trial = copy(task.controller)
    trial.tick(task.measured, next(task.every(task.dt)))
    if trial.status is Status.HELD:
        yield 1.0, {"why": trial.reason}
    elif task.pairs and is_clear(trial.settings, trial.records):
        error = trial.residual_wrench() - trial.f_tare
        limit = trial.settings.safety.load_error
        why = judge_load(trial.chain, limit, error, trial.result().bias_out)
        if why:
            may_change = not trial.engaged or not np.any(task.measured.wrenches)
            yield 0.5 if may_change else 1.0, {"why": why}


@rule(
    "to hold the arm, {joint} needs {torque:.4g} N m (or N), {value:.2g} times its limit of "
    "{most:.4g}; all that moves weighs {mass:.4g} kg: are masses in kg and lengths in m?",
    0.9,
    1.0,
)
def weights(task: Task) -> Values:
    """Torques that hold the arms without contact forces, as shares of the motors' limits.

    The value is the share of the motor that needs most. The weight of the object is included for a
    single arm; several arms may share it in any way.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    chain = task.chain
    bias = pin.computeGeneralizedGravity(chain.model, chain.model.createData(), task.q)
    if chain.payload is not None and len(chain.arms) == 1 and chain.grasps[0].is_rigid:
        state = task.state
        load = chain.payload.terms(state.X_WO, np.zeros(6), chain.model.gravity.linear).p
        bias = bias + state.arms[0].J.T @ load
    bias = bias[chain.actuated]
    shares = np.abs(bias) / np.minimum(chain.tau_max, 1e12)
    j = shares.argmax()
    words = {
        "joint": chain.joint_names[chain.actuated[j]],
        "torque": bias[j],
        "most": chain.tau_max[j],
        "mass": chain.moved_mass,
    }
    yield shares[j], words
