"""What passes between a robot and its controller: measurements, references, torques."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import InvalidInputError, brief
from osc_contact.spatial import Array, as_array, as_pose

_DOUBLE = np.dtype(np.float64)
#: alpha_d of every reference without forces: read-only, as nothing written to it could count.
_NO_FORCES: Array = np.zeros(0)
_NO_FORCES.flags.writeable = False


def _doubles(value: ArrayLike) -> Array:
    """`value` itself where the compiled law can read it, else a new array of its numbers.

    The law reads aligned, contiguous, writeable arrays of doubles. Numbers need not be finite.

    Raises:
        Exception: of any kind, where `value` holds no numbers.
    """
    if value.__class__ is np.ndarray and value.dtype == _DOUBLE and value.flags.carray:
        return value
    if value is None:  # NumPy makes it a NaN
        raise TypeError("no numbers")
    return np.array(value, dtype=np.float64, order="C")


def _readable(value: ArrayLike) -> ArrayLike:
    """`_doubles` of a reading; `value` as it is where it holds no numbers: its tick is held."""
    try:
        return _doubles(value)
    except Exception:  # numbers too large, or warnings made errors, among others
        return value


@dataclass(frozen=True)
class Stamps:
    """When each kind of reading was sampled (s); all of them at one instant if no sensor lags."""

    encoders: float = 0.0
    joint_torques: float = 0.0
    wrists: float = 0.0
    vision: float = 0.0


@dataclass(frozen=True)
class Touched:
    """Motion of the body at each contact, from its encoders or from a tracker.

    Attributes:
        X_WE: (contacts, 4, 4) pose of its frame E in the world; the pair's geometry is given in E.
        V_E: (contacts, 6) its twist at E's origin, world axes.
        A_E: (contacts, 6) [p̈; ω̇] of E, what is known of it: the acceleration a drive is commanded
            to make. Zero for bodies that follow the contact force.
    """

    X_WE: Array
    V_E: Array
    A_E: Array


@dataclass(frozen=True)
class Seen:
    """What an overhead camera sees besides the touched bodies, in the same frame as those.

    Attributes:
        object: (4, 4) pose of the held object. tips: (arms, 4, 4) of the arms' tips.
    """

    object: Array
    tips: Array


@dataclass(frozen=True, init=False)
class Measurement:
    """What the sensors of the rig deliver at one tick; nothing a real rig would not have.

    Lists and arrays of other types become arrays of doubles. What holds no numbers is kept as it
    is: the tick that it comes to is held, see `Controller.tick`.

    Attributes:
        q, v: (n,) joint positions and velocities of all arms, passive joints included. v is NaN
            where encoders give no velocities: they must be estimated first.
        wrenches: (arms, 6) wrench that each arm exerts on its gripper, at the sensor's origin and
            in the sensor's axes (N, N m). Rows of arms without a sensor are zero.
        touched: how the bodies at the contacts move; None: all of them rest in the world. Poses
            that a camera gave are in its frame: its idea of where the world is.
        joint_torques: (n_a,) what the joint torque sensors read (N m, N); None: there are none.
        stamps: when each was sampled; None: all of them now.
        seen: object and arms as a camera sees them; None: there is none.
        wrench_valid: False: this tick has no new wrenches, whatever stands in them; the controller
            continues with the last ones for a while. None: they are as good as they look.
        sequence: number of the packet. One that came before is a reading of a known age, which is
            used for `wrench_timeout`; one older than the last is not used. None: packets have none.
        estimated: whether v was estimated from q: then it is no second reading of the joints, with
            which faults of encoders could be found.

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
    ) -> None:
        """Take the readings; see the class for shapes and units."""
        self.__dict__.update(
            q=_readable(q),
            v=_readable(v),
            wrenches=_readable(wrenches),
            touched=touched,
            joint_torques=joint_torques,
            stamps=stamps,
            seen=seen,
            wrench_valid=wrench_valid,
            sequence=sequence,
            estimated=estimated,
        )


class Scene(Protocol):
    """Surroundings of a robot at one instant, with which a controller's model is compared.

    Attributes:
        moved_mass: of all links that the joints move (kg).
        carried_mass: beyond the wrist sensors (kg); 0: there are none.
        tool_touches: whether any shape of the tool can touch any of the surroundings.
        loose: mass (kg) beyond each joint that no motor of the controller moves and nothing holds,
            by the joint's name.
    """

    moved_mass: float
    carried_mass: float
    tool_touches: bool
    loose: Mapping[str, float]

    def distance(self, point: Array) -> tuple[float, str]:
        """Distance (m) of a point of the world (3,) from the nearest shape, and that one's name.

        It is negative within the shape.
        """

    def clearance(self) -> tuple[float, str]:
        """Distance (m) of the tool from the nearest shape, negative in an overlap, and its name."""

    def require_period(self, duration: float) -> None:
        """Refuse a control period (s) that the robot cannot keep.

        Raises:
            PlantError: with the periods that it can.
        """


class Robot(Protocol):
    """Methods that the control loop needs of a robot: hardware, or a plant that simulates one.

    A robot may also have a method `scene()`, which returns its `Scene` as it is now: the checks
    before a run compare the controller's contacts, tool and masses with it.

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
        """What the robot's sensors read now."""

    def command(self, tau: Array, duration: float) -> None:
        """Hold motor torques for one control period; return when it is over.

        A plant simulates the period. Hardware sends the torques and waits for the next deadline,
        or for the next reading of its sensors.

        Args:
            tau: (n_a,) motor torques, within the limits (N m, N).
            duration: s, the control period.
        """

    def stop(self, reason: str = "") -> None:
        """Come to a safe stop, by brakes if there are any, and return soon. Plants do nothing.

        Called in the tick in which the controller enters `SAFE_STOP`; once more if no sound
        reading of a joint is left later, so that it needs its mechanical brake, as the reason says;
        and however the loop ends: further calls must be safe. After the first one the controller's
        braking torques still come by `command`; a driver that has engaged its brakes ignores them.

        Args:
            reason: why, in a sentence: the controller's, an error, or the name of a signal; empty
                where the references have ended.
        """


@dataclass(frozen=True, init=False)
class Reference:
    """The user's commands at one tick; what is left out is zero.

    Accelerations are *classical*, d/dt of V_D: what trajectory generators and
    `pin.getFrameClassicalAcceleration(..., LOCAL_WORLD_ALIGNED)` give. The controller makes them
    spatial, once, in its motion law.

    Attributes:
        X_WD: desired pose of the object.
        V_D: (6,) its twist at its own origin, world axes.
        A_D: (6,) its classical acceleration: [second derivative of the origin's position; ω̇].
        alpha_d: (r,) desired contact force magnitudes (N); without any it is empty and read-only.
        squeeze_d: desired internal force along the grasp line, > 0 compresses (N). With k ≥ 3 arms:
            in each line between two grasps, in the order (1, 2), (1, 3), …, (k − 1, k), see
            `law.grasps`: (k(k − 1)/2,), or a number for all of them; the number 0 leaves
            them at least effort. Its steps are smoothed as those of alpha_d are, see `ForceGains`.

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

    def __init__(
        self,
        X_WD: pin.SE3 | ArrayLike,
        V_D: ArrayLike | None = None,
        A_D: ArrayLike | None = None,
        alpha_d: ArrayLike = (),
        squeeze_d: float | ArrayLike = 0.0,
    ) -> None:
        """Take the commands, and convert lists, arrays of other types and a plain number alpha_d.

        Numbers need not be finite: the tick that they come to is held, see `Controller.tick`.

        Args:
            X_WD: `pin.SE3`, or its homogeneous matrix (4, 4).
            V_D, A_D: (6,) m/s, rad/s; m/s², rad/s². None: zero.
            alpha_d: (r,) N; a number where r = 1.
            squeeze_d: a number, or an array (k(k − 1)/2,) (N).

        Raises:
            InvalidInputError: wrong shapes, no numbers, or a matrix that is no pose.
        """
        self.__dict__.update(
            X_WD=X_WD if isinstance(X_WD, pin.SE3) else _pose_of(X_WD),
            V_D=np.zeros(6) if V_D is None else _command("V_D", V_D, (6,)),
            A_D=np.zeros(6) if A_D is None else _command("A_D", A_D, (6,)),
            alpha_d=_forces(alpha_d),
            squeeze_d=squeeze_d
            if squeeze_d.__class__ is float
            else _number_or_command("squeeze_d", squeeze_d),
        )


def _command(name: str, value: ArrayLike, shape: tuple[int, ...] | None) -> Array:
    """(…) doubles of a reference's field; shape None: (any number,), or a number as one of one.

    Raises:
        InvalidInputError: see `Reference`.
    """
    try:
        array = _doubles(value)
    except Exception as error:  # of all kinds: whatever conversion to numbers raises
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


def _forces(alpha_d: ArrayLike) -> Array:
    """(r,) doubles of alpha_d; see `_command`."""
    array = _command("alpha_d", alpha_d, None)
    return array if array.size else _NO_FORCES


def _number_or_command(name: str, value: float | ArrayLike) -> float | Array:
    """A plain number, or (…,) of them; see `_command`."""
    array = _command(name, value, None)
    return float(array[0]) if np.ndim(value) == 0 else array


def _pose_of(matrix: ArrayLike) -> pin.SE3:
    """The pose that a homogeneous matrix (4, 4) gives; one with a NaN gives one with a NaN.

    Raises:
        InvalidInputError: another shape, or no pose.
    """
    try:
        X = _doubles(matrix)
    except Exception:  # of all kinds: whatever conversion to numbers raises
        X = np.zeros(())
    if X.shape != (4, 4):
        got = f"shape {X.shape}" if X.ndim else f"{brief(matrix)}"
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
    """A reference from p, R, ṗ, p̈, ω, ω̇ of the object's origin, all in world axes.

    Args:
        position: (3,) p (m). rotation: (3, 3) R; None: the object's axes are the world's.
        velocity, acceleration: (3,) plain time derivatives of p (m/s, m/s²).
        angular_velocity, angular_acceleration: (3,) ω and its time derivative (rad/s, rad/s²).
        alpha_d, squeeze_d: as in `Reference`.

    Raises:
        InvalidInputError: wrong shapes, a NaN/inf, or no rotation matrix.
    """
    V_D, A_D = (
        np.concatenate((as_array(name, x, (3,)), as_array(f"angular_{name}", w, (3,))))
        for name, x, w in (
            ("velocity", velocity, angular_velocity),
            ("acceleration", acceleration, angular_acceleration),
        )
    )
    X_WD = as_pose("reference", position, np.eye(3) if rotation is None else rotation)
    return Reference(
        X_WD, V_D, A_D, as_array("alpha_d", alpha_d, (None,)), as_numbers("squeeze_d", squeeze_d)
    )


def as_numbers(name: str, value: ArrayLike, count: int | None = None) -> float | Array:
    """A finite number, or an array (count,) of them.

    Args:
        name: of the argument. value: a number, or several. count: None: any number of them.

    Raises:
        InvalidInputError: it is neither.
    """
    several = isinstance(value, list | tuple)
    if several or (isinstance(value, np.ndarray) and value.ndim):
        return as_array(name, value, (count,))
    return float(as_array(name, value, ()))
