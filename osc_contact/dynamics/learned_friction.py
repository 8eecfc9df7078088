"""Learned friction of an arm's joints, and its file with the identity of the robot."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Self

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.arm import Arm, with_joints
from osc_contact.errors import InvalidInputError
from osc_contact.files import StrPath, write_whole
from osc_contact.robots.model import joint_names, rotors

_SIGNIFICANT_DIGITS = 9  #: significant digits of a model's numbers that enter its identity


def robot_identity(model: pin.Model) -> str:
    """Compute the SHA-256 of a robot's joints, links and torque limits, in hexadecimal.

    Equal models have equal identities on all machines. Friction and rotor inertia, which are
    learned, are not included.

    Args:
        model: model of the joints between base and tip.
    """
    digest = sha256()
    limits = np.array(model.upperEffortLimit)
    for j, name in enumerate(joint_names(model)):
        joint = model.joints[j + 1]
        X = model.jointPlacements[j + 1]
        link = model.inertias[j + 1]
        numbers = [X.homogeneous, link.mass, link.lever, link.inertia, limits[j]]
        flat = np.hstack([np.ravel(part) for part in numbers])
        words = (f"{x + 0.0:.{_SIGNIFICANT_DIGITS}g}" for x in flat)  # + 0.0: −0.0 is 0.0
        digest.update(" ".join((name, joint.shortname(), *words, "\n")).encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class LearnedFriction:
    """Friction of the joints of one arm, as learned by a controller.

    Attributes:
        robot: identity of the arm, see `robot_identity`.
        joints: names of the joints.
        friction: (n,) Coulomb friction (N m; N).
        damping: (n,) viscous friction (N m s/rad; N s/m).
        missing_inertia: (n,) rotor inertia that the model lacks (kg m²; kg).

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
        """Write a JSON file that appears complete or not at all, and return its path."""
        return write_whole(json.dumps(asdict(self), indent=1, allow_nan=False) + "\n", path)

    @classmethod
    def load(cls, path: StrPath) -> Self:
        """Read a file written by `save`.

        Args:
            path: path of the file.

        Raises:
            InvalidInputError: the file does not exist or has no learned friction.
        """
        try:
            content = json.loads(Path(path).read_text("utf-8"))
            friction = cls(
                robot=str(content["robot"]),
                joints=tuple(map(str, content["joints"])),
                friction=tuple(map(float, content["friction"])),
                damping=tuple(map(float, content["damping"])),
                missing_inertia=tuple(map(float, content["missing_inertia"])),
            )
        except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise InvalidInputError(
                f"{path} holds no learned friction ({type(error).__name__}: {error}); give a file "
                "that LearnedFriction.save has written"
            ) from error
        # one finite number for each joint; friction and damping cannot be negative
        columns = (friction.friction, friction.damping, friction.missing_inertia)
        is_valid = all(len(column) == len(friction.joints) for column in columns)
        is_valid = is_valid and bool(np.isfinite(columns).all())
        is_valid = is_valid and min((*friction.friction, *friction.damping), default=0.0) >= 0.0
        if not is_valid:
            raise InvalidInputError(
                f"{path}: give one number for each of {len(friction.joints)} joints, friction and "
                "damping not below 0"
            )
        return friction

    def put_on(self, arm: Arm) -> Arm:
        """Copy an arm with these values in its model, from which a controller continues to learn.

        Args:
            arm: arm of the robot whose friction was learned.

        Raises:
            InvalidInputError: the values were learned of another robot.
        """
        identity = robot_identity(arm.model)
        if self.robot != identity:
            raise InvalidInputError(
                f"this friction was learned of another robot than arm '{arm.name}': joints "
                f"{', '.join(self.joints)}, model {self.robot[:12]} instead of {identity[:12]} "
                "(links, loads, torque limits). Learn it with this robot: run a motion in which "
                "each joint turns both ways, and save controller.learned_friction again"
            )
        armature = np.maximum(rotors(arm.model) + np.array(self.missing_inertia), 0.0)
        values = {"friction": self.friction, "damping": self.damping, "armature": armature}
        return replace(arm, model=with_joints(arm.model, values, 1.0))
