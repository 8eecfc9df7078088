"""Interface between a robot and its controller: measurements, references, torques."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import InvalidInputError, brief
from osc_contact.spatial import Array, as_array, as_pose

_DOUBLE = np.dtype(np.float64)
#: alpha_d of every reference without forces; read-only, because all of them share it.
_NO_FORCES: Array = np.zeros(0)
_NO_FORCES.flags.writeable = False


def _as_doubles(value: ArrayLike) -> Array:
    """Return `value` itself if the compiled law can read it, else an array of its numbers.

    The law reads aligned, contiguous, writeable arrays of doubles. Numbers need not be finite.

    Raises:
        Exception: `value` cannot be converted to numbers; its "__array__" may raise any error.
    """
    if value.__class__ is np.ndarray and value.dtype == _DOUBLE and value.flags.carray:
        return value
    if value is None:  # NumPy makes it a NaN
        raise TypeError("no numbers")
    return np.array(value, dtype=np.float64, order="C")


def _reading_as_doubles(value: ArrayLike) -> ArrayLike:
    """Return a reading as doubles, or unchanged if it cannot be converted: its tick is held."""
    try:
        return _as_doubles(value)
    except Exception:  # for instance numbers too large, or warnings turned into errors
        return value


@dataclass(frozen=True)
class Stamps:
    """Sampling times of the readings (s), by kind; they are equal if no sensor lags.

    Attributes:
        encoders, joint_torques, wrists, vision: time of the last sample of that kind.

    Example:
        >>> stamps = osc.Stamps(encoders=12.004, wrists=12.003)
        >>> print(f"the wrists are {1e3 * (stamps.encoders - stamps.wrists):.0f} ms late")
        the wrists are 1 ms late
    """

    encoders: float = 0.0
    joint_torques: float = 0.0
    wrists: float = 0.0
    vision: float = 0.0


@dataclass(frozen=True)
class Touched:
    """Motion of the touched body at each contact, from its encoders or from a tracker.

    Attributes:
        X_WE: (contacts, 4, 4) pose of the body's frame E in the world; the geometry of a pair is
            given in E.
        V_E: (contacts, 6) twist of the body at E's origin, world axes (m/s, rad/s).
        A_E: (contacts, 6) known part of the classical acceleration [p̈; ω̇] of E, the commanded one
            of a drive (m/s², rad/s²). Zero for bodies that follow the contact force.
    """

    X_WE: Array
    V_E: Array
    A_E: Array


@dataclass(frozen=True)
class Seen:
    """Poses of the object and the arms' tips from a camera, in the frame of the touched bodies.

    Attributes:
        object: (4, 4) pose of the held object.
        tips: (arms, 4, 4) poses of the arms' tips.
    """

    object: Array
    tips: Array


@dataclass(frozen=True, init=False)
class Measurement:
    """Sensor readings of one tick, limited to quantities that a real robot can measure.

    Lists and arrays of other types are converted to arrays of doubles. A value that cannot be
    converted is kept: its tick is held, see `Controller.tick`.

    Attributes:
        q, v: (n,) positions (rad, m) and velocities (rad/s, m/s) of the joints of all arms, passive
            joints included. v is NaN if the encoders give no velocities, which must be estimated
            before a tick.
        wrenches: (arms, 6) wrench that each arm exerts on its gripper, at the sensor's origin and
            in the sensor's axes (N, N m). Rows of arms without a sensor are zero.
        touched: motion of the bodies at the contacts; None: all of them are at rest in the world.
            Poses from a camera are in the camera's estimate of the world frame.
        joint_torques: (n_a,) readings of the joint torque sensors (N m, N); None: no such sensors.
        stamps: sampling times; None: all readings are of this instant.
        seen: object and tips as seen by a camera; None: no camera.
        wrench_valid: False: `wrenches` is not a new reading; the controller continues with the
            last one for at most `wrench_timeout`. None: valid unless the checks find otherwise.
        sequence: number of the packet. A repeated number is a reading of known age, which is used
            for at most `wrench_timeout`; a number below the last one is not used. None: packets
            are not numbered.
        estimated: True if v was estimated from q, so that comparing the two cannot reveal faults
            of encoders.
        noisy: True if v was estimated from encoders that are found to be far noisier than expected:
            the arms are stopped. It requires `estimated`.

    Example:
        >>> reading = osc.Measurement(q=[0.1, 0.2], v=[0, 0], wrenches=[[0, 0, 9.81, 0, 0, 0]])
        >>> print(reading.q.dtype, reading.wrenches.shape)
        float64 (1, 6)
    """

    q: Array
    v: Array
    wrenches: Array
    touched: Touched | None = None
    joint_torques: Array | None = None
    stamps: Stamps | None = None
    seen: Seen | None = None
    wrench_valid: bool | None = None
    sequence: int | None = None
    estimated: bool = False
    noisy: bool = False

    def __init__(
        self,
        q: ArrayLike,
        v: ArrayLike,
        wrenches: ArrayLike,
        touched: Touched | None = None,
        joint_torques: Array | None = None,
        stamps: Stamps | None = None,
        seen: Seen | None = None,
        wrench_valid: bool | None = None,
        sequence: int | None = None,
        estimated: bool = False,
        noisy: bool = False,
    ) -> None:
        """Convert and store the readings of one tick.

        Args:
            q, v: (n,) joint positions (rad, m) and velocities (rad/s, m/s).
            wrenches: (arms, 6) of the wrist sensors (N, N m).
            touched: motion of the bodies at the contacts; None: they are at rest.
            joint_torques: (n_a,) readings of joint torque sensors (N m, N); None: no such sensors.
            stamps: sampling times; None: all readings are of this instant.
            seen: object and tips as seen by a camera; None: no camera.
            wrench_valid: False: `wrenches` is not a new reading; None: valid unless checks find
                otherwise.
            sequence: number of the packet; None: packets are not numbered.
            estimated: True if v was estimated from q.
            noisy: True if encoders are found to be far noisier than v was estimated for.

        Raises:
            InvalidInputError: `noisy` without `estimated`.
        """
        if noisy and not estimated:
            raise InvalidInputError(
                "noisy = True needs estimated = True: it states that speeds v were estimated from "
                "encoders that are too noisy; v that was read does not depend on them. Set "
                "estimated = True if v was estimated from q, else leave noisy out"
            )
        self.__dict__.update(
            q=_reading_as_doubles(q),
            v=_reading_as_doubles(v),
            wrenches=_reading_as_doubles(wrenches),
            touched=touched,
            joint_torques=joint_torques,
            stamps=stamps,
            seen=seen,
            wrench_valid=wrench_valid,
            sequence=sequence,
            estimated=estimated,
            noisy=noisy,
        )


def with_readings(measurement: Measurement, **readings: Any) -> Measurement:
    """Copy of a measurement with other readings, as `dataclasses.replace` makes it, but faster.

    Args:
        measurement: measurement to be copied.
        **readings: new values by the names of their fields; arrays have to be of doubles.
    """
    copy = object.__new__(Measurement)
    copy.__dict__.update(measurement.__dict__, **readings)
    return copy


class Scene(Protocol):
    """Masses and shapes of a robot and its surroundings at one instant, to check a model against.

    Attributes:
        moved_mass: mass of all links that the joints move (kg).
        carried_mass: mass beyond the wrist sensors (kg); 0 without wrist sensors.
        tool_touches: True if collisions between the tool and its surroundings are enabled.
        loose: by the name of each joint that the controller cannot move and nothing else holds, the
            mass beyond it (kg).
    """

    moved_mass: float
    carried_mass: float
    tool_touches: bool
    loose: Mapping[str, float]

    def distance(self, point: Array) -> tuple[float, str]:
        """Distance of a point from the nearest shape (m), and the name of that shape.

        Args:
            point: (3,) in the world (m). Within the shape the distance is negative.
        """

    def clearance(self) -> tuple[float, str]:
        """Distance of the tool from the nearest shape (m), and the name of that shape.

        The distance is negative if the two overlap.
        """

    def require_period(self, duration: float) -> None:
        """Refuse a control period `duration` (s) that the robot cannot keep.

        Raises:
            PlantError: the message names possible periods.
        """


class Robot(Protocol):
    """Methods that the control loop needs of a robot: hardware, or a plant that simulates one.

    A robot may also have a method `scene()` that returns its current `Scene`: the checks before a
    run compare the controller's contacts, tool and masses with it.

    Example:
        >>> class Still:  # a robot of one joint, whose wrist reads nothing
        ...     def measure(self) -> osc.Measurement:
        ...         return osc.Measurement([0.0], [0.0], np.zeros((1, 6)))
        ...     def command(self, tau: np.ndarray, duration: float) -> None:
        ...         pass
        ...     def stop(self, reason: str = "") -> None:
        ...         pass
        >>> robot: osc.Robot = Still()
    """

    def measure(self) -> Measurement:
        """Read the robot's sensors."""

    def command(self, tau: Array, duration: float) -> None:
        """Apply motor torques for one control period and return at its end.

        A plant simulates the period. A driver sends the torques and waits for the next deadline,
        or for the next reading of its sensors.

        Args:
            tau: (n_a,) motor torques, within the limits (N m, N).
            duration: control period (s).
        """

    def stop(self, reason: str = "") -> None:
        """Start a safe stop, by brakes if the robot has any, and return soon. Plants do nothing.

        The loop calls this in the tick in which the controller enters `SAFE_STOP`; again if later
        no valid reading of a joint is left, so that this joint needs its mechanical brake; and at
        its end, however it ends. Repeated calls must be safe. After the first call the controller
        still sends braking torques by `command`; a driver that has engaged its brakes ignores them.

        Args:
            reason: sentence of the controller, message of an error, or name of a signal; empty
                after the last reference.
        """


@dataclass(frozen=True, init=False)
class Reference:
    """Commanded motion and forces of one tick; omitted commands are zero.

    Accelerations are *classical*, the time derivative of V_D, as trajectory generators and
    `pin.getFrameClassicalAcceleration(..., LOCAL_WORLD_ALIGNED)` give them. The controller converts
    them to spatial ones in its motion law.

    Attributes:
        X_WD: desired pose of the object.
        V_D: (6,) desired twist at the object's origin, world axes (m/s, rad/s).
        A_D: (6,) desired classical acceleration, [second derivative of the origin's position; ω̇]
            (m/s², rad/s²).
        alpha_d: (r,) desired contact force magnitudes (N); empty and read-only if r = 0.
        squeeze_d: desired internal force along the grasp line, > 0 compresses (N). With k ≥ 3 arms:
            the force in each line between two grasps, (k(k − 1)/2,) in the order (1, 2), (1, 3), …,
            (k − 1, k), see `law.grasps`, or a number for all of them; the number 0 leaves the
            internal forces to the torques of least effort. Steps are smoothed like those of
            alpha_d, see `ForceGains`.
        active: (contacts,) 1 for contacts that are active in this tick, else 0. An active one is
            part of N, also where its desired force is 0: with phases a contact that pushes is
            approached until it is made. One that is not active is free motion, whether it holds or
            pushes. None: with phases a contact that pushes is active while a force is desired of
            it; all others always are.

    Example:
        >>> goal = osc.Reference(pin.SE3.Identity(), V_D=[0.1, 0, 0, 0, 0, 0], alpha_d=[5.0])
        >>> print(goal.A_D, goal.alpha_d)
        [0. 0. 0. 0. 0. 0.] [5.]
    """

    X_WD: pin.SE3
    V_D: Array
    A_D: Array
    alpha_d: Array
    squeeze_d: float | Array
    active: Array | None = None

    def __init__(
        self,
        X_WD: pin.SE3 | ArrayLike,
        V_D: ArrayLike | None = None,
        A_D: ArrayLike | None = None,
        alpha_d: ArrayLike = (),
        squeeze_d: float | ArrayLike = 0.0,
        active: ArrayLike | None = None,
    ) -> None:
        """Convert lists and arrays of other types to arrays of doubles, and a number for alpha_d.

        Numbers need not be finite: a tick with a NaN or inf is held, see `Controller.tick`.

        Args:
            X_WD: `pin.SE3`, or its homogeneous matrix (4, 4).
            V_D: (6,) desired twist (m/s, rad/s); None: zero.
            A_D: (6,) desired classical acceleration (m/s², rad/s²); None: zero.
            alpha_d: (r,) desired contact forces (N); a number if r = 1.
            squeeze_d: desired internal force (N), a number or (k(k − 1)/2,).
            active: (contacts,) flags of active contacts, or None.

        Raises:
            InvalidInputError: wrong shapes, no numbers, or a matrix that is not a pose.
        """
        if squeeze_d.__class__ is not float:  # the usual case, a float, needs no conversion
            squeeze_d = _number_or_command("squeeze_d", squeeze_d)
        self.__dict__.update(
            X_WD=X_WD if isinstance(X_WD, pin.SE3) else _pose_of(X_WD),
            V_D=np.zeros(6) if V_D is None else _command_as_doubles("V_D", V_D, (6,)),
            A_D=np.zeros(6) if A_D is None else _command_as_doubles("A_D", A_D, (6,)),
            alpha_d=_forces_as_doubles(alpha_d),
            squeeze_d=squeeze_d,
            active=None if active is None else _command_as_doubles("active", active, None),
        )


def _command_as_doubles(name: str, value: ArrayLike, shape: tuple[int, ...] | None) -> Array:
    """Return a field of a reference as an array of doubles.

    Args:
        name: name of the field, for messages.
        value: numbers as NumPy reads them.
        shape: expected shape; None: a vector of any length, or a number, which becomes (1,).

    Raises:
        InvalidInputError: another shape, or no numbers.
    """
    try:
        array = _as_doubles(value)
    except Exception as error:  # conversion of foreign objects to numbers may raise any error
        expected = "a list of numbers" if shape is None else f"numbers of shape {shape}"
        raise InvalidInputError(
            f"reference {name}: expected {expected}, got {brief(value)} ({error})"
        ) from error
    if shape is None:
        if array.ndim == 0:
            return array.reshape(1)
        if array.ndim != 1:
            raise InvalidInputError(
                f"reference {name}: expected shape (r,), got {array.shape}; give one number for "
                "each degree of constraint, contact after contact"
            )
    elif array.shape != shape:
        raise InvalidInputError(
            f"reference {name}: expected shape {shape}, got {array.shape}; give the linear part, "
            "then the angular part"
        )
    return array


def _forces_as_doubles(alpha_d: ArrayLike) -> Array:
    """Return alpha_d as doubles (r,), or the shared read-only array if it is empty.

    Args:
        alpha_d: desired contact forces (N).

    Raises:
        InvalidInputError: alpha_d is no vector of numbers.
    """
    array = _command_as_doubles("alpha_d", alpha_d, None)
    return array if array.size else _NO_FORCES


def _number_or_command(name: str, value: float | ArrayLike) -> float | Array:
    """Convert a number to a float, several numbers to an array of doubles.

    Args:
        name: name of the field of the reference, for messages.
        value: a number, or several.

    Raises:
        InvalidInputError: the value is neither a number nor a vector of numbers.
    """
    array = _command_as_doubles(name, value, None)
    return float(array[0]) if np.ndim(value) == 0 else array


def _pose_of(matrix: ArrayLike) -> pin.SE3:
    """Convert a homogeneous matrix (4, 4) to a pose; its numbers need not be finite.

    Raises:
        InvalidInputError: another shape, a last row other than 0, 0, 0, 1, or R not a rotation.
    """
    try:
        X = _as_doubles(matrix)
    except Exception:  # conversion of foreign objects to numbers may raise any error
        X = np.zeros(())
    if X.shape != (4, 4):
        got = f"shape {X.shape}" if X.ndim else brief(matrix)
        raise InvalidInputError(
            f"reference X_WD: expected a pin.SE3 or its matrix (4, 4), got {got}; give "
            "pin.SE3(R, p), pin.XYZQUATToSE3([x, y, z, qx, qy, qz, qw]), or chain.state(q).X_WO "
            "to stay where the object is"
        )
    if not np.isfinite(X).all():
        return pin.SE3(X)
    if np.abs(X[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        raise InvalidInputError(
            f"reference X_WD: the last row is {X[3].tolist()}, expected [0, 0, 0, 1]; give the "
            "matrix with R in its first three rows and columns, p in its last column"
        )
    return as_pose("reference X_WD", X[:3, 3], X[:3, :3])


def pose_reference(
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    acceleration: ArrayLike = (0.0, 0.0, 0.0),
    angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
    angular_acceleration: ArrayLike = (0.0, 0.0, 0.0),
    alpha_d: ArrayLike = (),
    squeeze_d: float | ArrayLike = 0.0,
) -> Reference:
    """Make a reference from p, R, ṗ, p̈, ω, ω̇ of the object's origin, all in world axes.

    Args:
        position: (3,) p (m).
        rotation: (3, 3) R; None: the object's axes are the world's.
        velocity: (3,) time derivative of p (m/s).
        acceleration: (3,) second time derivative of p (m/s²).
        angular_velocity: (3,) ω (rad/s).
        angular_acceleration: (3,) time derivative of ω (rad/s²).
        alpha_d, squeeze_d: forces as in `Reference`.

    Raises:
        InvalidInputError: wrong shapes, a NaN/inf, or R not a rotation matrix.
    """
    v = as_array("velocity", velocity, (3,))
    omega = as_array("angular_velocity", angular_velocity, (3,))
    a = as_array("acceleration", acceleration, (3,))
    omega_dot = as_array("angular_acceleration", angular_acceleration, (3,))
    return Reference(
        X_WD=as_pose("reference", position, np.eye(3) if rotation is None else rotation),
        V_D=np.concatenate((v, omega)),
        A_D=np.concatenate((a, omega_dot)),
        alpha_d=as_array("alpha_d", alpha_d, (None,)),
        squeeze_d=as_numbers("squeeze_d", squeeze_d),
    )


def as_numbers(name: str, value: ArrayLike, count: int | None = None) -> float | Array:
    """Return a finite number as a float, several finite numbers as an array (count,).

    Args:
        name: name of the argument, for messages.
        value: a number, or a list, tuple or array.
        count: expected number of elements of several; None: any.

    Raises:
        InvalidInputError: no numbers, a NaN/inf, or another count.
    """
    several = isinstance(value, list | tuple)
    if several or (isinstance(value, np.ndarray) and value.ndim):
        return as_array(name, value, (count,))
    return float(as_array(name, value, ()))
