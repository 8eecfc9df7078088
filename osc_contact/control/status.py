"""Reports of a tick in addition to its torques: status, losses, phases and state."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from osc_contact.spatial import Array, norm


class Status(IntEnum):
    """Status of a tick; torques are within the limits for any status, and `reason` has the cause.

    Example:
        >>> rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
        >>> controller = rig.controller()
        >>> tau = controller.tick(rig.plant().measure(), rig.references.at(0.0))
        >>> print(controller.status.name)
        OK
    """

    OK = 0
    SATURATED = 1  #: a motor limit was reached: `given_up` has the cost
    #: not computed, by input, posture, a limit or a sensor fault: last torques, a hold or a stop
    HELD = 2
    DEGRADED = 3  #: near a singular posture: `lost_directions` has the motions left out
    HOPPING = 4  #: computed without a loss, but a contact hops: `reason` names it


class SafetyState(IntEnum):
    """State of the controller, decided by `law.safety` and `law.sensors`.

    Example:
        >>> controller = osc.build_rig(osc.load_scenario("two_contact_rod")).controller()
        >>> print(controller.state.name)
        RUN
    """

    RUN = 0  #: the last tick was computed and nothing was lost
    #: motors at their limits, near a singular posture, without new wrenches, or a tick or two not
    #: computed, in which the last torques are repeated
    DEGRADED = 1
    HOLD = 2  #: not computed: gravity compensation and damping at the last posture that was read
    SAFE_STOP = 3  #: braked to rest and held, until `Controller.reset`


class Phase(IntEnum):
    """Phase of a contact, which `law.phases` determines."""

    OPEN = 0  #: out of N: free motion
    APPROACHING = 1  #: in N, guarded approach of the face at a set speed
    CLOSED = 2  #: in N, under force control


@dataclass(frozen=True)
class LimitLoss:
    """Losses of one tick by motor limits.

    Attributes:
        joints: names of joints whose motors are at their limits.
        desired: their desired torques (N m, N).
        limits: their limits (N m, N).
        force: (r_all,) commanded less predicted contact forces (N).
        acceleration: (6,) commanded less predicted acceleration of the object at O, in world axes
            (m/s², rad/s²).
        squeeze: (s,) commanded less predicted internal forces (N).
        short: True if no feasible torques keep all contact forces between their floors and
            commands.
    """

    joints: tuple[str, ...]
    desired: Array
    limits: Array
    force: Array
    acceleration: Array
    squeeze: Array
    short: bool

    def __str__(self) -> str:
        """Sentence with the torques beyond their limits, and the motion and forces given up."""
        motors = ", ".join(
            f"{name} {desired:.4g} of ±{limit:.4g}"
            for name, desired, limit in zip(self.joints, self.desired, self.limits, strict=True)
        )
        linear, angular = (norm(part) for part in np.split(self.acceleration, 2))
        text = f"desired torques: {motors} N m or N; "
        text += f"given up: motion {linear:.3f} m/s², {angular:.3f} rad/s²"
        if len(self.force):
            text += f", contact force {np.round(self.force, 3) + 0.0} N"
        if len(self.squeeze):
            text += f", squeeze {np.round(self.squeeze, 3) + 0.0} N"
        return text + ("; forces beyond their range" if self.short else "")


@dataclass(frozen=True)
class LostDirection:
    """Direction of motion of the object that an arm loses near a singular posture.

    Attributes:
        arm: name of the arm.
        left: remaining share of the motion command along it, 0 … 1.
        inertia_ratio: apparent inertia of the arm along it, relative to that of object and arm in a
            regular posture.
        twist: (6,) unit motion at O in world axes: 1 m/s, or 1 rad/s if O does not move.
    """

    arm: str
    left: float
    inertia_ratio: float
    twist: Array

    def __str__(self) -> str:
        """Sentence with the lost direction and the share of the command that remains along it."""
        twist = np.array2string(self.twist, precision=3, suppress_small=True)
        return (
            f"{self.arm} is near a singular posture: {100 * self.left:.0f} % left of the command "
            f"along {twist}"
        )
