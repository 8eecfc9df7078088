"""Driver of a Franka arm by its maker's client library, a robot for `run_loop` (extra `franka`).

The robot adds torques against the weight of its model and of its load to the commanded ones, but
no Coriolis torques. Therefore gravity is subtracted from the controller's torques. The wrench that
the robot estimates lacks the weight beyond the wrist, which is added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, PlantError, missing
from osc_contact.interface import Measurement, Stamps
from osc_contact.spatial import Array, as_array, norm

if TYPE_CHECKING:
    from pylibfranka import ActiveControlBase, Robot, RobotState

TORQUE_STEP = 0.99  #: largest change of a torque in a period (N m); the robot refuses 1 N m
SPEED_SHARE = 0.9  #: share of a joint's speed limit beyond which braking torques are added
TIP_ERROR = (2e-3, 0.01)  #: largest difference of tip and end effector (m, rad)
_PERIOD = 1e-3  #: control period of the robot (s)


class FrankaRobot:
    """Franka arm, torque-controlled at 1 kHz by `run_loop`.

    `measure` waits for the robot's next state, `command` sends torques at once. The motion begins
    with the first command and ends with `stop`, after which the robot holds its posture by itself.

    Attributes:
        chain: model of the arm.
        state: last state of the robot, an object of the client library.
        read_to_write: time from the arrival of the last state until its torques were sent (s).
        success_rate: share of the last 100 commands that reached the robot in time.
        least_success_rate: lowest success rate of all ticks.
    """

    def __init__(
        self,
        host: str,
        chain: ClosedChain,
        *,
        wrench: Callable[[], ArrayLike | None] | None = None,
        end_effector: pin.SE3 | None = None,
        collision: tuple[float, float, float] = (40.0, 60.0, 20.0),
        recover: bool = False,
    ) -> None:
        """Connect, set load, end effector and collision limits, and compare the tip with the model.

        Args:
            host: address of the robot.
            chain: model of one arm, whose tip is the robot's end effector, with a wrist sensor:
                any frame beyond the last joint, such as the tip. The held object becomes the
                robot's load.
            wrench: function that reads a mounted force-torque sensor: (6,) in the convention of
                `Measurement`, None without a new reading; default: the robot's own estimate.
            end_effector: pose to be set in the nominal end effector; None: it is not changed.
            collision: joint torques (N m), forces (N) and moments (N m) of a contact at which the
                robot stops by a reflex.
            recover: reset a reflex or error by which the robot has stopped.

        Raises:
            PlantError: no client library, no robot at this address, a robot that has stopped, or
                an end effector that differs from the model's tip.
            InvalidInputError: a chain of other joints, or without a wrist sensor.
        """
        try:
            import pylibfranka
        except ImportError as error:
            raise PlantError(f"{missing(error)} (Linux, Python 3.11 or 3.12)") from error
        self._lib = pylibfranka  #: module `pylibfranka`
        self.host = host
        self.chain = chain
        #: function that reads a wrist sensor; None: the robot's estimate is used
        self._wrench = wrench
        self._prepare_model(chain)
        #: running torque control; None before the first command and after a stop
        self._control: ActiveControlBase | None = None
        self._stopped = False  #: whether the arm was stopped, so that commands are ignored
        self.read_to_write = 0.0
        self.success_rate = self.least_success_rate = 1.0
        with self._errors_reported("cannot be prepared"):
            self._robot: Robot = pylibfranka.Robot(host, pylibfranka.RealtimeConfig.kIgnore)
            if recover:
                self._robot.automatic_error_recovery()
            self._read_state()
            self._require_idle()
            self._set_up(end_effector, collision)
        self._require_tip()

    def _prepare_model(self, chain: ClosedChain) -> None:
        """Copy the chain's model with the held object in its last link; set limits and weights.

        Sets `_load`, `_lift_force`, `_brake_speed`, `_brake` and the frames of base, tip and
        sensor.

        Raises:
            InvalidInputError: a chain of other joints, or without a wrist sensor.
        """
        if len(chain.arms) != 1 or chain.nq != 7 or chain.n_a != 7 or chain.sensors[0] is None:
            raise InvalidInputError(
                f"a Franka has one arm of 7 motors and a wrist sensor, the chain has "
                f"{len(chain.arms)} with {chain.nq} joints: {chain.joint_names}; give the arm a "
                "frame beyond the last joint as wrist_sensor, and lock the fingers"
            )
        self._sensor = int(chain.sensors[0])  #: frame of the wrist sensor in the model
        self._tip = int(chain.tips[0])  #: frame of the tip in the model
        model = self._model = chain.model.copy()  #: copy of the model of the arm
        last = model.njoints - 1
        sensor = model.frames[self._sensor]
        if sensor.parentJoint != last:
            raise InvalidInputError(
                f"the wrist sensor '{sensor.name}' of a Franka sits beyond its last joint"
            )
        # inertia of all that the wrist sensor carries: links beyond it, and the held object
        hangs = pin.Inertia.Zero()
        for link in chain.outboard[0]:
            hangs = hangs + link.inertia
        if chain.payload is not None:
            X_object = model.frames[self._tip].placement * chain.grasps[0].X_TO
            load = X_object.act(chain.payload.inertia)
            model.inertias[last] += load
            hangs = hangs + load
        self._load = sensor.placement.actInv(hangs)  # in axes of the sensor
        # force against its weight, in world axes
        #: force that carries the weight of `_load`, in world axes (N)
        self._lift_force = pin.Force(-self._load.mass * model.gravity.linear, np.zeros(3))
        self._data = model.createData()  #: results of `_model`
        self._translation = pin.SE3.Identity()  #: buffer of translations of wrenches
        self._brake_speed = SPEED_SHARE * np.array(model.upperVelocityLimit)
        self._tau_max = np.array(chain.tau_max)  #: (7,) torque limits (N m)
        # the braking torque rises from 0 at `_brake_speed` to the motor's limit at the speed limit
        #: (7,) gain of the braking torques (N m s/rad)
        self._brake = self._tau_max / (np.array(model.upperVelocityLimit) - self._brake_speed)
        self._base = chain.arms[0].base  #: pose of the arm's base in the world
        #: rotation of the base, as a pose at the origin
        self._base_rotation = pin.SE3(self._base.rotation, np.zeros(3))

    def _set_up(self, end_effector: pin.SE3 | None, collision: tuple[float, float, float]) -> None:
        """Set collision limits, end effector and load of the robot.

        Args:
            end_effector: pose in the nominal end effector; None: it is not changed.
            collision: joint torques (N m), forces (N) and moments (N m) of a reflex.
        """
        torque, force, moment = collision
        robot = self._robot
        wrenches = [force] * 3 + [moment] * 3
        robot.set_collision_behavior([torque] * 7, [torque] * 7, wrenches, wrenches)
        if end_effector is not None:
            robot.set_EE(end_effector.homogeneous.ravel(order="F").tolist())
        payload = self.chain.payload
        load = pin.Inertia.Zero()
        if payload is not None:
            flange_to_tip = _pose_of_columns(self.state.F_T_EE)
            load = (flange_to_tip * self.chain.grasps[0].X_TO).act(payload.inertia)
        robot.set_load(
            float(load.mass), load.lever.tolist(), load.inertia.ravel(order="F").tolist()
        )
        self._read_state()
        # the position is the last column of the 4×4 matrix, given column by column
        self._K_in_EE = np.append(self.state.EE_T_K[12:15], 1.0)

    def _read_state(self) -> None:
        """Read the present state of the robot; two are read, as the first may be an older one."""
        for _ in range(2):
            self.state = self._robot.read_once()

    def _require_idle(self) -> None:
        """Refuse a robot that cannot move.

        Raises:
            PlantError: it was stopped by a reflex, by an error, or by its stop button.
        """
        state = self.state
        modes = self._lib.RobotMode
        if state.robot_mode in (modes.Reflex, modes.UserStopped, modes.Other):
            raise PlantError(
                f"the robot at {self.host} is stopped ({state.robot_mode}, "
                f"{str(state.last_motion_errors) or 'no error'}); see why, release its stop "
                "button, then connect with recover=True"
            )

    def _require_tip(self) -> None:
        """Refuse a model whose tip differs from the robot's end effector.

        Raises:
            PlantError: they differ by more than TIP_ERROR.
        """
        self._update_placements(np.array(self.state.q))
        model = pin.updateFramePlacement(self._model, self._data, self._tip)
        robot = self._base * _pose_of_columns(self.state.O_T_EE)
        distance = norm(model.translation - robot.translation)
        angle = norm(pin.log3(model.rotation.T @ robot.rotation))
        if distance > TIP_ERROR[0] or angle > TIP_ERROR[1]:
            raise PlantError(
                f"the model's tip '{self.chain.arms[0].tip}' is {1e3 * distance:.3g} mm and "
                f"{angle:.3g} rad from the robot's end effector: {_position_text(model)} m, not "
                f"{_position_text(robot)} m; choose another tip, or give end_effector="
            )

    def measure(self) -> Measurement:
        """Wait for the robot's next state and return the readings of its sensors.

        Raises:
            PlantError: the robot ended the motion, or does not answer.
        """
        # before the first command the state is read without control; then each read ends a period
        with self._errors_reported("ended the motion"):
            if self._control is None:
                state = self._robot.read_once()
            else:
                state = self._control.readOnce()[0]
        self._read_at = perf_counter()  #: clock at the last reading (s)
        self.state = state
        self.success_rate = float(state.control_command_success_rate)
        if self._control is not None:
            self.least_success_rate = min(self.least_success_rate, self.success_rate)
        self._q = np.array(state.q)  #: (7,) last joint positions (rad)
        self._v = np.array(state.dq)  #: (7,) last joint velocities (rad/s)
        self._update_placements(self._q)
        reading = self._estimate_wrench(state) if self._wrench is None else self._wrench()
        # without a valid reading the controller continues with the previous wrench; zeros are not
        # used
        is_valid = reading is not None and bool(np.isfinite(reading).all())
        t = state.time.to_sec()
        return Measurement(
            q=self._q.copy(),
            v=self._v.copy(),
            wrenches=np.array(reading, dtype=float).reshape(1, 6) if is_valid else np.zeros((1, 6)),
            joint_torques=np.array(state.tau_J),
            stamps=Stamps(encoders=t, joint_torques=t, wrists=t, vision=t),
            wrench_valid=is_valid,
            sequence=round(t / _PERIOD),
        )

    def _update_placements(self, q: Array) -> None:
        """Compute the placements of the joints and of the wrist sensor at q (7,) (rad)."""
        pin.forwardKinematics(self._model, self._data, q)
        pin.updateFramePlacement(self._model, self._data, self._sensor)

    def _estimate_wrench(self, state: RobotState) -> Array:
        """Compute the wrench (6,) that a wrist sensor would read, in its axes (N, N m).

        It is the sum of the robot's estimate, without the load's weight, and of the force against
        this weight. Both are moved to the origin of the world, in world axes, and the sum to the
        sensor.

        Args:
            state: state of the robot; its estimate is the wrench on its surroundings at K, the
                origin of the stiffness frame, in axes of the robot's base.
        """
        sensor = self._data.oMf[self._sensor]
        K = np.reshape(state.O_T_EE, (4, 4), order="F") @ self._K_in_EE  # in the base, homogeneous
        to_origin = self._translation  # translation, reused
        to_origin.translation = self._base.act(K[:3])
        total = to_origin.act(self._base_rotation.act(pin.Force(np.array(state.O_F_ext_hat_K))))
        to_origin.translation = sensor.act(self._load.lever)  # the load's centre of mass
        total += to_origin.act(self._lift_force)
        return sensor.actInv(total).vector

    def command(self, tau: Array, duration: float) -> None:
        """Send torques to the robot; the next `measure` waits for the end of the period.

        Gravity is subtracted. The rest is cut off at the motors' limits and at the change per
        period that the robot permits, and brakes joints beyond nine tenths of their speed limit.
        After a stop nothing is sent.

        Args:
            tau: (7,) torques (N m), gravity and Coriolis torques included.
            duration: control period, 1 ms (s).

        Raises:
            InvalidInputError: torques that are not seven finite numbers, or another period.
            PlantError: the robot ended the motion, or does not answer.
        """
        tau = as_array("tau", tau, (7,))
        if abs(duration - _PERIOD) > 1e-9:
            raise InvalidInputError(
                f"a Franka takes torques each {1e3 * _PERIOD:g} ms, not each {1e3 * duration:g} "
                "ms; give the controller dt=0.001"
            )
        if self._stopped:
            return
        with self._errors_reported("ended the motion"):
            if self._control is None:
                self._control = self._robot.start_torque_control()
                self.state = self._control.readOnce()[0]
                self._read_at = perf_counter()
            target = tau - pin.computeGeneralizedGravity(self._model, self._data, self._q)
            excess_speed = np.maximum(np.abs(self._v) - self._brake_speed, 0.0)
            target -= self._brake * np.sign(self._v) * excess_speed
            # the change from the torques that the robot applied last is limited, in all joints by
            # one factor, so that its direction is kept
            last = np.array(self.state.tau_J_d)
            step = np.clip(target, -self._tau_max, self._tau_max) - last
            step *= min(1.0, TORQUE_STEP / max(np.abs(step).max(), TORQUE_STEP))
            #: torques that were sent last, in libfranka's type
            self._sent_torques = self._lib.Torques((last + step).tolist())
            self._control.writeOnce(self._sent_torques)
            self.read_to_write = perf_counter() - self._read_at

    def stop(self, reason: str = "") -> None:
        """End the motion in order: the robot brakes and holds its posture by itself.

        Args:
            reason: sentence that is not used.

        Raises:
            PlantError: the robot does not answer.
        """
        self._stopped = True
        control = self._control
        self._control = None
        if control is None:
            return
        self._sent_torques.motion_finished = True
        with self._errors_reported("did not end the motion in order"):
            control.writeOnce(self._sent_torques)

    def recover(self) -> None:
        """Reset a reflex or an error and permit a new motion.

        Raises:
            PlantError: the robot does not recover, for example while its stop button is pressed.
        """
        with self._errors_reported("does not recover"):
            self._robot.automatic_error_recovery()
            self._read_state()
        self._require_idle()
        self._stopped = False
        self.least_success_rate = 1.0

    def mass_matrix(self) -> Array:
        """Mass matrix (7, 7) of the robot's model at its last state, with hand and load (kg m²).

        Raises:
            PlantError: the robot does not answer.
        """
        with self._errors_reported("gives no model"):
            return np.reshape(self._robot.load_model().mass(self.state), (7, 7))

    def close(self) -> None:
        """End the motion and the connection: a robot serves one client."""
        self.stop()
        self._robot = None  # type: ignore[assignment]  # its destructor disconnects

    @contextmanager
    def _errors_reported(self, failure: str) -> Iterator[None]:
        """Turn errors of the client library into a `PlantError` with cause and cure.

        Args:
            failure: predicate of the message, such as "does not recover".
        """
        try:
            yield
        except (RuntimeError, self._lib.FrankaException) as error:
            self._control = None
            raise PlantError(
                f"the robot at {self.host} {failure}: {error}. Look at the robot and its Desk; it "
                "moves again after recover(), or after connecting with recover=True"
            ) from error


def _pose_of_columns(numbers: ArrayLike) -> pin.SE3:
    """Convert a homogeneous matrix, given as 16 numbers column by column, to a pose."""
    X = np.reshape(numbers, (4, 4), order="F")
    return pin.SE3(pin.Quaternion(X[:3, :3]).normalized(), X[:3, 3])


def _position_text(X: pin.SE3) -> list[float]:
    """Position of a pose (m), rounded for messages."""
    return np.round(X.translation, 4).tolist()
