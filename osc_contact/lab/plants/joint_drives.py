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

SPRING = "spring"  #: suffix of the name of the second joint, the spring between motor and link


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
            minimum = 0.0 if name == "damping" else 1e-9
            if value.min(initial=minimum) < minimum:
                raise PlantError(
                    f"flexible joints: {name} = {value}; give {'≥ 0' if minimum == 0 else '> 0'} "
                    "for every motor"
                )
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Motors:
    """Motors with torque errors: u = τ + bias + ripple sin(cycles · θ + phase).

    Attributes:
        bias, ripple: (n_a,) constant error and amplitude of the ripple (N m; N of a sliding joint).
        cycles: (n_a,) angular frequency of the ripple over the motor's travel (rad/rad; rad/m).
        phase: (n_a,) phase of the ripple (rad).
    """

    bias: Array
    ripple: Array
    cycles: Array
    phase: Array

    @classmethod
    def drawn(
        cls, tau_max: Array, sliding: Array, bias: float, ripple: float, rng: np.random.Generator
    ) -> Motors:
        """Make errors of a given size, relative to each motor's limit, with random sign and phase.

        Args:
            tau_max: (n_a,) limits of the motors (N m, N).
            sliding: (n_a,) True for joints that move along their axis.
            bias, ripple: amplitudes over the limits.
            rng: random generator of signs and phases.
        """
        n = len(tau_max)
        return cls(
            bias=bias * tau_max * rng.choice([-1.0, 1.0], n),
            ripple=ripple * tau_max,
            cycles=np.where(sliding, 2 * np.pi / 0.01, 24.0),  # one in 10 mm; 24 poles
            phase=rng.uniform(0.0, 2 * np.pi, n),
        )

    def torque(self, tau: Array, theta: Array) -> Array:
        """Delivered torques (n_a,) (N m, N).

        Args:
            tau: (n_a,) commanded torques (N m, N).
            theta: (n_a,) motor positions at the joint (rad, m).
        """
        return tau + self.bias + self.ripple * np.sin(self.cycles * theta + self.phase)


@dataclass(frozen=True)
class JointDrives:
    """Drives between command and link; the default is an ideal, stiff, frictionless drive.

    Attributes:
        flexible: springs between motors and links; None: stiff joints.
        motors: errors of the motors; None: ideal ones.
        friction: (n_a,) Coulomb friction at the motor's side of the spring (N m, N); None: none.
    """

    flexible: FlexibleJoints | None = None
    motors: Motors | None = None
    friction: Array | None = None


_LARGEST_IMPEDANCE = 0.9999  #: largest impedance that MuJoCo permits


def set_dry_friction(joint: MjsJoint, friction: float, step: float) -> None:
    """Set Coulomb friction of a joint so that it holds light links, too.

    In MuJoCo a torque τ below the friction moves a joint of inertia I at the speed
    (1 − d) T τ/(2 I). With its defaults, an impedance d of 0.9 and a time T of 20 ms, the friction
    of light wrists would be viscous, and change its sign 10 ms before their velocity does.

    Args:
        joint: joint of a scene, changed.
        friction: Coulomb friction (N m, N).
        step: time step of the engine (s).
    """
    joint.frictionloss = friction
    joint.solref_friction = [2 * step, 1.0]
    joint.solimp_friction = [
        _LARGEST_IMPEDANCE,
        _LARGEST_IMPEDANCE,
        1.0,
        0.5,
        1.0,
    ]  # the width does not matter


def add_drives(spec: MjSpec, names: Sequence[str], drives: JointDrives) -> None:
    """Add springs, motor inertias and friction to a MuJoCo scene.

    With springs, the named joint with its limits and its actuator becomes that of the motor; a
    second joint about the same axis, with the spring, follows in the same body.

    Args:
        spec: scene, changed.
        names: names of the driven joints.
        drives: drives of these joints.
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
