"""Checks of a robot's driver on the robot itself: units, signs, gravity, time.

`check_robot` needs no controller. It moves each joint by some milliradians; see the page
"Your own driver" of the documentation for the contract that it checks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.control.inputs import Freshness, require_stamps
from osc_contact.control.start_check import judge_load, require_start
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, PlantError
from osc_contact.interface import Measurement, Robot
from osc_contact.law.records import OUTDATED
from osc_contact.settings.control import SafetySettings
from osc_contact.spatial import Array, as_array, norm

HOLD = 50  #: ticks for which the model's weight holds the arm
PULSE = 30  #: ticks of a torque, and as many of its opposite
SHARES = (0.02, 0.05, 0.1, 0.2, 0.35)  #: shares of a motor's limit, tried until the joint moves
SPEED = 0.3  #: largest speed that a pulse adds by the model's prediction (rad/s, m/s)
MOVED = 0.01  #: least change of speed that counts as motion (rad/s, m/s)
ALONE = 0.3  #: least change of speed of the joint with the torque, over that of the fastest joint
FALLING = 0.3  #: acceleration, over that of an arm without torques, that means a wrong weight
FAR = 0.3  #: distance from the start at which the check ends (rad, m)
FAST = 2.0  #: speed at which the check ends (rad/s, m/s)
MEAN = 20  #: ticks over which a wrench is averaged
MOST_REPEATED = 5  #: largest number of ticks in a row with the same stamps


def check_robot(
    robot: Robot,
    chain: ClosedChain | None = None,
    *,
    dt: float = 1e-3,
    nudge: ArrayLike | None = None,
    patience: float = 10.0,
) -> list[str]:
    """Check that a driver keeps the contract of `Robot`, and end with `Robot.stop`.

    The arm must be at rest in free space, with room of 0.1 rad about each joint, and somebody at
    the stop button. It is held by the model's weight for 50 ms, then each joint gets a torque of
    rising size, for 30 ms in each direction.

    Args:
        robot: driver of the robot.
        chain: model of the robot, all joints with motors; None: `robot.chain`.
        dt: control period of the robot (s).
        nudge: (3,) direction in world axes in which somebody pushes the tip while the check waits
            for the push; None: no push, and the sign of the wrench is judged by the weight.
        patience: time to wait for the push (s).

    Returns:
        Sentences on properties that could not be checked.

    Raises:
        PlantError: a violated rule: readings of other sizes, degrees in place of radians, stamps
            that do not advance, weight missing or doubled in the torques, joints in another order
            or reversed, wrenches that are reversed, without gravity or of another frame, a `stop`
            that fails.
        InvalidInputError: there is no model, or it has joints without motors.
    """
    chain = require_model(robot, chain)
    check = _Check(robot, chain, dt)
    try:
        return list(check.run(nudge, patience))
    finally:
        check.stop()


def require_model(robot: Robot, chain: ClosedChain | None) -> ClosedChain:
    """Return the model by which a robot is checked and held.

    Args:
        robot: driver of the robot.
        chain: model of the robot, all joints with motors; None: `robot.chain`.

    Raises:
        InvalidInputError: there is no model, or it has joints without motors.
    """
    chain = getattr(robot, "chain", None) if chain is None else chain
    if chain is None:
        raise InvalidInputError(
            f"{type(robot).__name__} has no attribute `chain`, and the check needs a model of the "
            'robot: check_robot(robot, osc.ClosedChain([osc.Arm.from_urdf("arm.urdf", name="arm", '
            'tip="…", wrist_sensor="…")]))'
        )
    if chain.n_a != chain.nq:
        motorless = sorted(set(chain.joint_names) - {chain.joint_names[j] for j in chain.actuated})
        raise InvalidInputError(
            f"the check turns every joint by its motor, and {', '.join(motorless)} has none: give "
            "a chain of the arm alone, without what it holds"
        )
    return chain


class HeldRobot:
    """Robot that is read, and held by its model in the posture of its first measurement.

    Attributes:
        robot: driver of the robot.
        chain: model of the robot.
        dt: control period (s).
        last: last measurement.
        rest: first measurement, of the arm at rest.
    """

    def __init__(self, robot: Robot, chain: ClosedChain, dt: float) -> None:
        """Read the robot for the first time.

        Args:
            robot: driver of the robot.
            chain: model of the robot.
            dt: control period (s).

        Raises:
            PlantError: the measurement has wrong sizes.
        """
        self.robot = robot
        self.chain = chain
        self.dt = dt
        self.model = chain.model
        self.data = chain.model.createData()
        self.names = chain.joint_names
        self.fresh = Freshness()
        self.last = self.rest = self.read()

    def read(self) -> Measurement:
        """Read the next measurement.

        Raises:
            PlantError: wrong sizes, numbers that are not finite, stamps of other types, or stamps
                that do not advance.
        """
        measurement = self.robot.measure()
        n = self.chain.nq
        arms = len(self.chain.arms)
        for name, shape in (("q", (n,)), ("v", (n,)), ("wrenches", (arms, 6))):
            values = np.asarray(getattr(measurement, name))
            if values.shape != shape or not np.isfinite(values).all():
                raise PlantError(f"measure(): {name} is {values.tolist()}; give {shape} numbers")
        try:
            require_stamps(measurement)
        except InvalidInputError as error:
            raise PlantError(f"measure(): {error}") from error
        if self.fresh.compare(measurement) & OUTDATED or self.fresh.repeated > MOST_REPEATED:
            raise PlantError(
                f"measure(): stamps ({measurement.stamps}) or sequence ({measurement.sequence}) do "
                "not advance; give the time of each reading, by the clock of the robot"
            )
        return measurement

    def step(self, tau: Array) -> None:
        """Command torques (n,), cut off at the motors' limits, for a period, and read the robot."""
        self.robot.command(np.clip(tau, -self.chain.tau_max, self.chain.tau_max), self.dt)
        self.last = self.read()

    def weight(self, q: Array) -> Array:
        """Torques (n,) that balance the model's weight at q (n,)."""
        return pin.computeGeneralizedGravity(self.model, self.data, q).copy()

    def mass(self, q: Array) -> Array:
        """Mass matrix (n, n) of the model at q (n,)."""
        return np.array(pin.crba(self.model, self.data, q))

    def settle(self, ticks: int) -> None:
        """Brake the joints and return them slowly to the start, for some ticks.

        The desired acceleration −20 v − 25 (q − q_start) returns them without overshoot: nearly
        critical damping at a natural frequency of 5 rad/s, slow enough for any arm.

        Args:
            ticks: number of control periods.

        Raises:
            PlantError: a joint moves away.
        """
        for _ in range(ticks):
            q = self.last.q
            v = self.last.v
            desired = -20.0 * v - 25.0 * (q - self.rest.q)
            self.step(self.weight(q) + self.mass(q) @ desired)
            distances = np.abs(q - self.rest.q)
            if distances.max() > FAR or np.abs(v).max() > FAST:
                j = distances.argmax()
                raise PlantError(
                    f"joint '{self.names[j]}' leaves its place though it is braked: "
                    f"{distances[j]:.3g} rad away at {v[j]:.3g} rad/s; are speeds or "
                    "torques reversed, or is the unit of one another?"
                )


class _Check(HeldRobot):
    """Course of a check: the robot, its model, and the readings now and at the start."""

    def run(self, nudge: ArrayLike | None, patience: float) -> Iterator[str]:
        """Check readings, weight, wrenches and torques of the robot; it is not stopped.

        Args:
            nudge: (3,) direction of a push of the tip in world axes; None: no push.
            patience: time to wait for the push (s).

        Raises:
            PlantError: a rule of the contract is violated, see `check_robot`.

        Yields:
            Sentences on properties that could not be checked.
        """
        self.require_range()
        self.hold()
        yield from self.weigh()
        for joint in range(self.chain.nq):
            self.pulse(joint)
        if nudge is not None:
            require_nudge(self.outside, as_array("nudge", nudge, (3,)), patience, self.dt)

    # --- checks ----------------------------------------------------------------------------------

    def require_range(self) -> None:
        """Check that positions are within the joints' limits.

        Raises:
            PlantError: a position is beyond a limit.
        """
        try:
            require_start(self.chain, self.last.q)
        except InvalidInputError as error:
            raise PlantError(f"{error}; or are joints in another order?") from error

    def hold(self) -> None:
        """Check that torques that balance the model's weight hold the arm.

        The measured accelerations are compared with those of each likely cause: weight missing,
        weight twice, or two joints swapped.

        Raises:
            PlantError: joints accelerate; the message names the likeliest cause.
        """
        q = self.last.q
        v = self.last.v
        for _ in range(HOLD):
            self.step(self.weight(self.last.q))
        accelerations = (self.last.v - v) / (HOLD * self.dt)
        lift = np.linalg.solve(self.mass(q), self.weight(q))  # by the weight's torques alone
        # the arm is held if it moves much less than it would fall, or by less than 0.2 rad/s²
        if np.abs(accelerations).max() < max(FALLING * np.abs(lift).max(), 0.2):
            return
        missing = "their weight seems to be missing: the robot does not add it, and command() must"
        doubled = "their weight seems to come twice: the robot adds it, and command() must not"
        causes = {missing: -lift, doubled: lift}
        for i, j in combinations(range(len(q)), 2):
            order = np.arange(len(q))
            order[[i, j]] = (j, i)
            torques = self.weight(q) - self.weight(q[order])
            cause = f"joints '{self.names[i]}' and '{self.names[j]}' seem to be swapped"
            causes[cause] = np.linalg.solve(self.mass(q[order]), torques)[order]
        likeliest = min(causes, key=lambda cause: norm(causes[cause] - accelerations))
        worst = np.abs(accelerations).argmax()
        raise PlantError(
            f"torques that balance the arm's weight speed up joint '{self.names[worst]}' by "
            f"{accelerations[worst]:.3g} rad/s²; {likeliest}"
        )

    def weigh(self) -> Iterator[str]:
        """Check that the wrists read the weight beyond them.

        Yields:
            Sentences on properties that could not be checked.

        Raises:
            PlantError: the readings differ from the weight.
        """
        chain = self.chain
        if None in chain.sensors:
            yield "wrenches are not checked: an arm of the model has no wrist sensor"
            return
        state = chain.state(self.last.q)
        limit = SafetySettings().load_error
        error = self.outside() - state.bias_out
        why = judge_load(chain, limit, error, state.bias_out, stepped=True)
        if why:
            raise PlantError(why)
        weight = 9.81 * chain.outboard_mass
        if weight < 2.0 * limit:
            yield (
                f"the sign of the wrench is not checked by {weight:.2g} N, which hang on the "
                "sensor; push the tip, and give the direction as nudge="
            )

    def outside(self) -> Array:
        """Mean wrench (6,) of the wrists while the arm is held, in world axes at O (N, N m)."""

        def read() -> Measurement:
            """Hold the arm for a period; return the measurement after it."""
            self.settle(1)
            return self.last

        return mean_outside(self.chain, read)

    def pulse(self, joint: int) -> None:
        """Check that torques of both signs move this joint, as the model predicts, and no other.

        Torques rise until the joint moves, because its friction is unknown.

        Args:
            joint: index of the joint in `names`.

        Raises:
            PlantError: no joint or another joint moves, or this one moves in another way.
        """
        # larger and larger pulses until a joint moves; after each the arm comes to rest
        name = self.names[joint]
        for share in SHARES:
            inertia = self.mass(self.last.q)[joint, joint]
            torque = self.torque_of(joint, share)
            changes, displacement, summed_speeds = self.push(joint, torque)
            self.settle(2 * PULSE)
            if np.abs(changes).max() > MOVED:
                break
        # the other joints were to stay at rest, and this one to move as the model predicts
        fastest = np.abs(changes).argmax()
        predicted_change = torque / inertia * PULSE * self.dt
        if np.abs(changes).max() <= MOVED:
            raise PlantError(
                f"joint '{name}' does not move with {torque:.3g} N m; are torques in another unit "
                "or order, or brakes engaged?"
            )
        if abs(changes[joint]) < ALONE * abs(changes[fastest]):
            raise PlantError(
                f"the torque of joint '{name}' moves joint '{self.names[fastest]}'; positions, "
                "speeds or torques have the joints in another order than the model"
            )
        if changes[joint] < 0.0:
            raise PlantError(f"joint '{name}' moves against its torque; one of them is reversed")
        if not 0.5 < displacement / summed_speeds < 2.0:
            raise PlantError(
                f"the positions of joint '{name}' change by {displacement:.3g} where its speeds "
                f"add up to {summed_speeds:.3g}; give both in rad (m) and seconds, not in degrees"
            )
        if changes[joint] > 5.0 * predicted_change:
            raise PlantError(
                f"joint '{name}' gains {changes[joint]:.3g} rad/s where the model predicts "
                f"{predicted_change:.3g}; are positions and speeds in degrees, or masses too large?"
            )

    def torque_of(self, joint: int, share: float) -> float:
        """Torque of a pulse (N m, N), at most a share of the motor's limit.

        The torque is lower where the model predicts a speed above `SPEED`, but not at the higher
        shares, which are tried after the joint did not move.

        Args:
            joint: index of the joint in `names`.
            share: largest torque over the motor's limit, one of `SHARES`.
        """
        inertia = self.mass(self.last.q)[joint, joint]
        largest = share * float(self.chain.tau_max[joint])
        torque = inertia * min(largest / inertia, SPEED / (PULSE * self.dt))
        return max(torque, largest) if share > SHARES[1] else torque

    def push(self, joint: int, torque: float) -> tuple[Array, float, float]:
        """Apply a pulse of torque to a joint, then its opposite, in addition to the weight.

        A pulse ends early if the joint becomes faster than `SPEED`.

        Args:
            joint: index of the joint.
            torque: torque of the pulse (N m, N).

        Returns:
            Mean change of speed of all joints (n,) along the pulse (rad/s, m/s); displacement of
            the joint by its positions; displacement by the sum of its speeds (rad, m).
        """
        M = self.mass(self.last.q)
        tau = M[:, joint] * torque / M[joint, joint]  # the other joints do not accelerate
        changes = np.zeros(self.chain.nq)
        displacement = 0.0
        summed_speeds = 0.0
        for sign in (1.0, -1.0):
            before = self.last
            for _ in range(PULSE):
                self.step(self.weight(self.last.q) + sign * tau)
                summed_speeds += sign * self.last.v[joint] * self.dt
                if abs(self.last.v[joint]) > SPEED:
                    break
            changes += 0.5 * sign * (self.last.v - before.v)
            displacement += sign * (self.last.q[joint] - before.q[joint])
        return (changes, displacement, summed_speeds)

    def stop(self) -> None:
        """Stop the robot twice: the contract permits repeated calls."""
        for reason in ("the check has ended", ""):
            self.robot.stop(reason)


def mean_outside(chain: ClosedChain, read: Callable[[], Measurement]) -> Array:
    """Mean wrench (6,) of all wrists over `MEAN` ticks, in world axes at the object (N, N m).

    Args:
        chain: model of the arms.
        read: function that returns the next measurement.
    """
    sums = []
    for _ in range(MEAN):
        measurement = read()
        state = chain.state(measurement.q)
        origin = pin.SE3(np.eye(3), state.X_WO.translation)
        total = np.zeros(6)
        for X, wrench in zip(state.sensors, measurement.wrenches, strict=True):
            if X is not None:
                total = total + origin.actInv(X.act(pin.Force(wrench))).vector
        sums.append(total)
    return np.mean(sums, axis=0)


def require_nudge(
    outside: Callable[[], Array], direction: Array, patience: float, dt: float
) -> None:
    """Wait for a push of the tip by hand, and check the direction of the measured force.

    Args:
        outside: function that returns the mean wrench of some ticks, see `mean_outside`.
        direction: (3,) direction of the push in world axes.
        patience: time to wait (s).
        dt: control period (s).

    Raises:
        PlantError: no push was measured, or one in another direction.
    """
    at_rest = outside()[:3]
    direction = direction / norm(direction)
    for _ in range(round(patience / (MEAN * dt))):
        push = at_rest - outside()[:3]  # the wrist reads the arm's force, which is opposite
        if norm(push) > 2.0 * SafetySettings().load_error:
            if push @ direction < 0.7 * norm(push):
                raise PlantError(
                    f"the tip was pushed along {np.round(direction, 2).tolist()}, and the "
                    f"wrist reads {np.round(-push, 1).tolist()} N more in world axes; the sign "
                    "or the axes of the frame are others: give the wrench that the arm exerts "
                    "on the gripper, in the sensor's axes"
                )
            return
    raise PlantError(f"no push of the tip was felt within {patience:g} s")
