"""Drive between a torque command and a joint: imperfect motor, spring, friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.errors import PlantError
from osc_contact.spatial import Array, as_array

if TYPE_CHECKING:
    from mujoco import MjsJoint, MjSpec

SPRING = "spring"  #: suffix of the second joint that the plant puts behind a motor


@dataclass(frozen=True)
class FlexibleJoints:
    """Spring and damper between each motor and its link (Spong's model of a flexible joint).

        J_m θ̈ = u − τ,    τ = K(θ − q) + D(θ̇ − q̇),    M q̈ + h = τ + …

    Attributes:
        stiffness: (n_a,) K (N m/rad; N/m of a sliding joint).
        damping: (n_a,) D (N m s/rad; N s/m).
        motor_inertia: (n_a,) J_m as felt at the joint (kg m²; kg).

    Source: M. W. Spong, Modeling and control of elastic joint robots, 1987.
    """

    stiffness: Array
    damping: Array
    motor_inertia: Array

    def __post_init__(self) -> None:
        """Convert stiffness, damping and motor inertia to arrays with one number for each motor.

        Raises:
            PlantError: wrong number of values, negative damping, or another value that is not
                positive.
        """
        for name in ("stiffness", "damping", "motor_inertia"):
            value = as_array(name, getattr(self, name), np.asarray(self.stiffness).shape)
            least = 0.0 if name == "damping" else 1e-9
            if value.min(initial=least) < least:
                raise PlantError(
                    f"flexible joints: {name} = {value}; give {'≥ 0' if least == 0 else '> 0'} "
                    "for every motor"
                )
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Motors:
    """Motors that are not ideal torque sources: u = τ + bias + ripple sin(cycles · θ + phase).

    Attributes:
        bias, ripple: (n_a,) N m (N of a sliding joint).
        cycles: (n_a,) 1/rad (1/m) of motor travel, as felt at the joint. phase: (n_a,) rad.
    """

    bias: Array
    ripple: Array
    cycles: Array
    phase: Array

    @classmethod
    def drawn(
        cls, tau_max: Array, sliding: Array, bias: float, ripple: float, rng: np.random.Generator
    ) -> Motors:
        """Errors of a given size, relative to each motor's limit, with random sign and phase.

        Args:
            tau_max: (n_a,) limits. sliding: (n_a,) bool, joints that move along their axis.
            bias, ripple: amplitudes as fractions of the limits.
            rng: draws signs and phases.
        """
        n = len(tau_max)
        return cls(
            bias=bias * tau_max * rng.choice([-1.0, 1.0], n),
            ripple=ripple * tau_max,
            cycles=np.where(sliding, 2 * np.pi / 0.01, 24.0),  # one in 10 mm; 24 poles
            phase=rng.uniform(0.0, 2 * np.pi, n),
        )

    def torque(self, tau: Array, theta: Array) -> Array:
        """(n_a,) torques delivered for commanded tau at motor positions theta."""
        return tau + self.bias + self.ripple * np.sin(self.cycles * theta + self.phase)


@dataclass(frozen=True)
class JointDrives:
    """Everything between command and link; the default is an ideal, stiff, frictionless drive.

    Attributes:
        flexible: springs, or None. motors: their errors, or None.
        friction: (n_a,) Coulomb friction at the motor's side of the spring (N m, N), or None.
    """

    flexible: FlexibleJoints | None = None
    motors: Motors | None = None
    friction: Array | None = None


_IMPEDANCE = 0.9999  #: the most that MuJoCo permits


def set_dry_friction(joint: MjsJoint, friction: float, step: float) -> None:
    """Let a joint have Coulomb friction, also when it is light.

    In MuJoCo a torque τ below the friction moves a joint of inertia I by (1 − d) T τ/(2 I). With
    its defaults, an impedance d of 0.9 and a time T of 20 ms, light wrists would have viscous
    friction that turns round 10 ms before they do.

    Args:
        joint: joint of a scene. friction: N m, N. step: of the engine (s).
    """
    joint.frictionloss = friction
    joint.solref_friction = [2 * step, 1.0]
    joint.solimp_friction = [_IMPEDANCE, _IMPEDANCE, 1.0, 0.5, 1.0]  # the width does not matter


def add_drives(spec: MjSpec, names: Sequence[str], drives: JointDrives) -> None:
    """Put springs, motor inertias and friction into a MuJoCo scene.

    The named joint keeps its name, its limits and its motor and becomes the motor's; a second,
    sprung joint about the same axis follows it in the same body.

    Args:
        spec: the scene. names: names of the driven joints. drives: what to add.
    """
    for i, name in enumerate(names):
        joint = spec.joint(name)
        if drives.friction is not None:
            joint.frictionloss += drives.friction[i]
        if drives.flexible is None:
            continue
        joint.armature = drives.flexible.motor_inertia[i]
        joint.parent.add_joint(
            name=f"{name}/{SPRING}",
            type=joint.type,
            pos=joint.pos,
            axis=joint.axis,
            limited=0,
            stiffness=drives.flexible.stiffness[i],
            damping=drives.flexible.damping[i],
        )
