"""Dry friction, damping and rotor inertia of joints, as numbers and in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

__all__ = ["UNITS", "joint_losses", "loss_words", "losses_by_arm", "rotors", "slides"]

#: Units of a turning and of a sliding joint.
UNITS = {
    "friction": ("N m", "N"),
    "damping": ("N m s/rad", "N s/m"),
    "armature": ("kg m²", "kg"),
}


def slides(model: pin.Model, joint: int) -> bool:
    """Whether a joint of a model is a sliding one."""
    return bool(model.joints[joint].shortname().startswith("JointModelP"))


def rotors(model: pin.Model) -> npt.NDArray[np.float64]:
    """(n,) rotor inertia as felt at each joint: armature; where it is 0 rotorInertia · ratio²."""
    given, ratio = np.array(model.armature), np.array(model.rotorGearRatio)
    return np.where(given != 0.0, given, np.array(model.rotorInertia) * ratio**2)


def joint_losses(model: pin.Model, prefix: str = "") -> list[dict[str, Any]]:
    """What each joint of a model loses and carries.

    Args:
        model: of one arm, or of a robot. prefix: of the joints' names.

    Returns:
        Of each joint its name, friction (N m, N), damping (N m s/rad, N s/m), armature (kg m²,
        kg), and whether it slides.
    """
    dry, damping, armature = np.array(model.upperDryFrictionLimit), model.damping, rotors(model)
    found = []
    for j in range(1, model.njoints):
        v = model.joints[j].idx_v
        found.append(
            {
                "joint": f"{prefix}{model.names[j]}",
                "friction": float(dry[v]),
                "damping": float(damping[v]),
                "armature": float(armature[v]),
                "slides": slides(model, j),
            }
        )
    return found


def losses_by_arm(losses: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Each arm's name and its joints in words.

    Args:
        losses: of `joint_losses`, their names ARM/JOINT.
    """
    arms: dict[str, list[Mapping[str, Any]]] = {}
    for values in losses:
        arm, _, joint = values["joint"].rpartition("/")
        arms.setdefault(arm, []).append({**values, "joint": joint})
    for arm, joints in arms.items():
        yield arm, loss_words(joints)


def loss_words(joints: Sequence[Mapping[str, Any]]) -> str:
    """Friction, damping and armature of some joints, those that are not zero, in one line."""
    words = []
    for key, units in UNITS.items():
        groups: dict[tuple[float, str], list[str]] = {}
        for values in joints:
            if values[key]:
                group = (values[key], units[values["slides"]])
                groups.setdefault(group, []).append(values["joint"])
        parts = []
        for (value, unit), names in groups.items():
            where = "every joint" if len(names) == len(joints) else ", ".join(names)
            parts.append(f"{value:.3g} {unit} ({where})")
        words.append(f"{key} {', '.join(parts)}" if parts else f"no {key}")
    return "; ".join(words)
