"""What the motors of a model can do at most, and what they carry with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.robots.model import rotors, slides
from osc_contact.spatial import Array

__all__ = [
    "PerJoint",
    "effort_limits",
    "effort_scale",
    "heaviest_rotor",
    "rotor_inertia",
    "with_joints",
]

PerJoint = float | Sequence[float] | Array  #: a number for all joints, or one for each

_UNLIMITED = 1e12  # N m or N: an effort limit that is none


def effort_limits(model: pin.Model, actuated: Array) -> Array:
    """(n_a,) effort limits (N m, N), inf where there is none: models built in code leave DBL_MAX.

    Raises:
        ModelError: a limit that is not positive.
    """
    given = np.array(model.upperEffortLimit)[actuated]
    for j, limit in zip(actuated, given, strict=True):
        if not limit > 0.0:
            name = model.names[int(j) + 1]
            raise ModelError(
                f"joint '{name}' has an effort limit of {limit:g}: such a motor does "
                "nothing. Give its largest torque (N m) or force (N), or list it among the passive "
                "joints"
            )
    return np.where(given < _UNLIMITED, given, np.inf)


def effort_scale(tau_max: Array) -> Array:
    """(n_a,) what torques are measured by: τ_max, for motors without limit the largest of them."""
    finite = np.isfinite(tau_max)
    return np.where(finite, tau_max, tau_max[finite].max() if finite.any() else 1.0)


def rotor_inertia(model: pin.Model) -> Array:
    """(n,) rotor inertia as felt at each joint (kg m²; kg of a sliding one), added to M's diagonal.

    The model's armature; where that is zero, its rotorInertia · rotorGearRatio².

    Raises:
        ModelError: one that is negative or not finite.
    """
    inertia = rotors(model)
    for name, value in zip(list(model.names)[1:], inertia, strict=True):
        if not 0.0 <= value < np.inf:
            raise ModelError(
                f"joint '{name}' has a rotor inertia of {value:g}; give armature (kg m², kg) ≥ 0"
            )
    return np.asarray(inertia)


def heaviest_rotor(model: pin.Model, gyration: float) -> float:
    """Mass (kg) that has, at the radius `gyration` (m), the largest rotor inertia of the joints."""
    sliding = np.array([slides(model, j) for j in range(1, model.njoints)])
    masses = rotor_inertia(model) / np.where(sliding, 1.0, gyration**2)
    return float(masses.max(initial=0.0))


def with_joints(
    model: pin.Model, given: Mapping[str, PerJoint], friction_factor: float = 1.0
) -> pin.Model:
    """The model with other numbers of its joints; itself if there are none.

    Args:
        model: of one arm. given: "armature", "damping" and "friction", see `Arm.from_urdf`.
        friction_factor: on damping and friction, given or not.

    Raises:
        ModelError: not one number for each joint, or one that is negative or not finite.
    """
    if not given and friction_factor == 1.0:
        return model
    model = model.copy()
    for key, value in given.items():
        numbers = np.asarray(value, dtype=float)
        if numbers.shape not in ((), (model.nv,)):
            raise ModelError(
                f"{key}: {numbers.size} numbers for {model.nv} joints {list(model.names)[1:]}; "
                "give one for each, or a single one for all"
            )
        if not (np.isfinite(numbers).all() and (numbers >= 0.0).all()):
            raise ModelError(f"{key} = {numbers.tolist()}; give finite numbers ≥ 0")
        every = np.full(model.nv, numbers)
        if key == "armature":
            model.armature, model.rotorInertia = every, np.zeros(model.nv)
        elif key == "damping":
            model.damping = every
        else:
            model.upperDryFrictionLimit = every
    model.damping = model.damping * friction_factor
    model.upperDryFrictionLimit = model.upperDryFrictionLimit * friction_factor
    model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
    return model
