"""What crosses the border between controller and plant: measurements and references."""

from __future__ import annotations

from dataclasses import dataclass

import pinocchio as pin

from osc_contact.spatial import Array

__all__ = ["Measurement", "Reference"]


@dataclass(frozen=True)
class Measurement:
    """What the sensors of the rig deliver at one tick; nothing a real rig would not have.

    Attributes:
        q, v: (n,) joint positions and velocities of all arms, passive joints included.
        wrenches: (arms, 6) wrench that each arm exerts on its gripper, at the sensor's origin and
            in the sensor's axes (N, N m). Rows of arms without a sensor are zero.
        joint_torques: (n_a,) what the joint torque sensors read (N m, N); None: there are none.
    """

    q: Array
    v: Array
    wrenches: Array
    joint_torques: Array | None = None


@dataclass(frozen=True)
class Reference:
    """What the user wants at one tick.

    Attributes:
        X_WD: desired pose of the object.
        V_D: (6,) its twist at its own origin, world axes.
        A_D: (6,) its *classical* acceleration (second derivatives of position and rotation).
        alpha_d: (r,) desired contact force magnitudes (N).
        squeeze_d: desired internal force along the grasp line, > 0 compresses (N).
    """

    X_WD: pin.SE3
    V_D: Array
    A_D: Array
    alpha_d: Array
    squeeze_d: float = 0.0
