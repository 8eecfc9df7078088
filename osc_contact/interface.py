"""What crosses the border between controller and plant: measurements and references."""

from __future__ import annotations

from dataclasses import dataclass

import pinocchio as pin

from osc_contact.spatial import Array

__all__ = ["Measurement", "Reference", "Seen", "Stamps", "Touched"]


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
    """

    q: Array
    v: Array
    wrenches: Array
    touched: Touched | None = None
    joint_torques: Array | None = None
    stamps: Stamps | None = None
    seen: Seen | None = None


@dataclass(frozen=True)
class Reference:
    """What the user wants at one tick.

    Attributes:
        X_WD: desired pose of the object.
        V_D: (6,) its twist at its own origin, world axes.
        A_D: (6,) its *classical* acceleration (second derivatives of position and rotation).
        alpha_d: (r,) desired contact force magnitudes (N).
        squeeze_d: desired internal force along the grasp line, > 0 compresses (N). With k ≥ 3 arms:
            in each line between two grasps, in the order (1, 2), (1, 3), …, (k − 1, k), see
            `control.linkage`: (k(k − 1)/2,), or a number for all of them; the number 0 leaves
            them at least effort.
    """

    X_WD: pin.SE3
    V_D: Array
    A_D: Array
    alpha_d: Array
    squeeze_d: float | Array = 0.0
