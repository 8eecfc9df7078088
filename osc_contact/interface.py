"""What passes between a robot and its controller: measurements, references, torques."""

from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.spatial import Array, as_array, as_pose


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


@dataclass(frozen=True)
class Measurement:
    """What the sensors of the rig deliver at one tick; nothing a real rig would not have.

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


class Robot(Protocol):
    """Methods that the control loop needs of a robot: hardware, or a plant that simulates one."""

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


@dataclass(frozen=True)
class Reference:
    """The user's commands at one tick; what is left out is zero.

    Accelerations are *classical*, d/dt of V_D: what trajectory generators and
    `pin.getFrameClassicalAcceleration(..., LOCAL_WORLD_ALIGNED)` give. The controller makes them
    spatial, once, in its motion law.

    Attributes:
        X_WD: desired pose of the object.
        V_D: (6,) its twist at its own origin, world axes.
        A_D: (6,) its classical acceleration: [second derivative of the origin's position; ω̇].
        alpha_d: (r,) desired contact force magnitudes (N).
        squeeze_d: desired internal force along the grasp line, > 0 compresses (N). With k ≥ 3 arms:
            in each line between two grasps, in the order (1, 2), (1, 3), …, (k − 1, k), see
            `law.linkage`: (k(k − 1)/2,), or a number for all of them; the number 0 leaves
            them at least effort.
    """

    X_WD: pin.SE3
    V_D: Array = field(default_factory=partial(np.zeros, 6))
    A_D: Array = field(default_factory=partial(np.zeros, 6))
    alpha_d: Array = field(default_factory=partial(np.zeros, 0))
    squeeze_d: float | Array = 0.0


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
