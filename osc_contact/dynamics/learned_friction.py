"""Friction of an arm's joints as it was learned, in a file with the identity of its robot."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.arm import Arm, with_joints
from osc_contact.errors import InvalidInputError
from osc_contact.files import StrPath, write_whole
from osc_contact.robots.model import joint_names, rotors

_DIGITS = 9  #: of each number of a model that its identity is made of


def robot_identity(model: pin.Model) -> str:
    """SHA-256 of a robot's joints, links and torque limits, without what is learned of it.

    The same model read on another machine has the same identity. Friction and rotor inertia are
    left out: they are what values are learned for.

    Args:
        model: of the joints between base and tip.
    """
    found = sha256()
    limits = np.array(model.upperEffortLimit)
    for j, name in enumerate(joint_names(model)):
        joint = model.joints[j + 1]
        X = model.jointPlacements[j + 1]
        link = model.inertias[j + 1]
        numbers = [X.homogeneous, link.mass, link.lever, link.inertia, limits[j]]
        words = (f"{x + 0.0:.{_DIGITS}g}" for x in np.hstack([np.ravel(x) for x in numbers]))
        found.update(" ".join((name, joint.shortname(), *words, "\n")).encode())
    return found.hexdigest()


@dataclass(frozen=True)
class LearnedFriction:
    """Friction of the joints of one arm, as learned by a controller.

    Attributes:
        robot: identity of the arm, see `robot_identity`. joints: names.
        friction: (n,) Coulomb friction (N m; N). damping: (n,) viscous (N m s/rad; N s/m).
        missing_inertia: (n,) of the rotors, that the model lacks (kg m²; kg).

    Example:
        >>> learned = osc.LearnedFriction("…", ("joint1",), (2.0,), (0.1,), (0.0,))
        >>> learned.friction
        (2.0,)
    """

    robot: str
    joints: tuple[str, ...]
    friction: tuple[float, ...]
    damping: tuple[float, ...]
    missing_inertia: tuple[float, ...]

    def save(self, path: StrPath) -> Path:
        """Write a JSON file, which appears complete or not at all; returns its path."""
        return write_whole(json.dumps(asdict(self), indent=1, allow_nan=False) + "\n", path)

    @classmethod
    def load(cls, path: StrPath) -> Self:
        """Read a file written by `save`.

        Raises:
            InvalidInputError: no such file, or not one of learned friction.
        """
        try:
            content: Any = json.loads(Path(path).read_text("utf-8"))
            numbers = ("friction", "damping", "missing_inertia")
            found = cls(
                robot=str(content["robot"]),
                joints=tuple(map(str, content["joints"])),
                **{name: tuple(map(float, content[name])) for name in numbers},
            )
        except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise InvalidInputError(
                f"{path} holds no learned friction ({type(error).__name__}: {error}); give a file "
                "that LearnedFriction.save has written"
            ) from error
        sizes = {len(getattr(found, name)) for name in ("joints", *numbers)}
        values = np.array([getattr(found, name) for name in numbers]) if len(sizes) == 1 else None
        if values is None or not np.isfinite(values).all() or not (values[:2] >= 0.0).all():
            raise InvalidInputError(
                f"{path}: give one number for each of {len(found.joints)} joints, friction and "
                "damping not below 0"
            )
        return found

    def put_on(self, arm: Arm) -> Arm:
        """The arm with these values in its model, to start with.

        Raises:
            InvalidInputError: they were learned of another robot.
        """
        own = robot_identity(arm.model)
        if self.robot != own:
            raise InvalidInputError(
                f"this friction was learned of another robot than arm '{arm.name}': joints "
                f"{', '.join(self.joints)}, model {self.robot[:12]} instead of {own[:12]} (links, "
                "loads, torque limits). Learn it with this robot: run a motion in which each joint "
                "turns both ways, and save controller.learned_friction again"
            )
        armature = np.maximum(rotors(arm.model) + np.array(self.missing_inertia), 0.0)
        given = {"friction": self.friction, "damping": self.damping, "armature": armature}
        return replace(arm, model=with_joints(arm.model, given, 1.0))
