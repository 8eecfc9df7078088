"""How an arm holds the object: rigidly, by a hinge, by a ball, or leaving any other lower pair.

A grasp is a contact state between tip and object: it permits the motions T of the object against
the tip and passes on the wrenches N, NᵀT = 0. It has no mass, no motor and no encoder. N and T are
carried by the tip, and by the object too, for the motions that a grasp permits form a group.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.errors import InvalidInputError
from osc_contact.scenarios.geometry import GRASP_TYPES
from osc_contact.spatial import Array, as_array, carry_twist, carry_wrench, cross_twist

__all__ = ["GRASPS", "Grasp", "register_grasp"]

_SAME = 1e-9  #: columns of unit size nearer to dependence than this are dependent


@dataclass(frozen=True, eq=False)
class Grasp:
    """X_TO, pose of the object in the tip frame, and the motions T it keeps (default: none).

    Attributes:
        X_TO: pose of the object where the permitted motion is zero.
        T: (6, k) basis of the permitted motions of the object against the tip, in tip axes at the
            tip's origin (m/s, rad/s).
        N: (6, 6−k) basis of the wrenches it passes on, in the same axes at the same point.

    Raises:
        InvalidInputError: T is not a basis, or its motions do not stay the same while they are
            made (they are no group: take a hinge, a ball, a slide, a cylinder, a screw, a plane).
    """

    X_TO: pin.SE3
    T: Array = field(default_factory=lambda: np.zeros((6, 0)))
    N: Array = field(init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.X_TO, pin.SE3):
            raise InvalidInputError(f"X_TO: expected a pin.SE3, got {type(self.X_TO).__name__}")
        T = as_array("T of the grasp", self.T, (6, None))
        size = np.linalg.norm(T, axis=0)
        if T.shape[1] and not size.min() > 0.0:
            raise InvalidInputError("T of the grasp: a column is zero; leave it out")
        values = np.linalg.svd(T / size, compute_uv=False)
        if T.shape[1] > 6 or values.min(initial=1.0) < _SAME:
            raise InvalidInputError(
                f"T of the grasp: its {T.shape[1]} columns are dependent (smallest singular value "
                f"{values.min():.2g}); give a basis"
            )
        object.__setattr__(self, "T", T)
        object.__setattr__(self, "N", _wrenches(T))
        for i, j in combinations(range(T.shape[1]), 2):
            turned = cross_twist(T[:, i], T[:, j])
            if np.abs(self.N.T @ turned).max(initial=0.0) > _SAME * size[i] * size[j]:
                raise InvalidInputError(
                    f"T of the grasp: after motion {i} motion {j} is another one (their bracket "
                    f"{np.round(turned, 6)} is not in T). A grasp permits a group of motions: "
                    "hinge, ball, slide, cylinder, screw, plane; put other joints into the URDF."
                )

    @classmethod
    def rigid(cls, X_TO: pin.SE3) -> Grasp:
        """The object does not move against the tip."""
        return cls(X_TO)

    @classmethod
    def hinge(cls, X_TO: pin.SE3, axis: npt.ArrayLike) -> Grasp:
        """The object turns about an axis (3,) through the tip's origin, in tip axes."""
        direction = as_array("axis of the hinge", axis, (3,))
        length = float(np.linalg.norm(direction))
        if not length > 1e-12:
            raise InvalidInputError(f"axis of the hinge: {direction} has no direction")
        return cls(X_TO, np.concatenate((np.zeros(3), direction / length))[:, None])

    @classmethod
    def ball(cls, X_TO: pin.SE3) -> Grasp:
        """The object turns freely about the tip's origin."""
        return cls(X_TO, np.vstack((np.zeros((3, 3)), np.eye(3))))

    @property
    def is_rigid(self) -> bool:
        """Whether it permits nothing."""
        return self.N.shape[1] == 6

    @property
    def kind(self) -> str:
        """rigid, hinge, ball, or other."""
        T = self.T
        if self.is_rigid:
            return "rigid"
        if T[:3].any() or T.shape[1] == 2:
            return "other"
        return "hinge" if T.shape[1] == 1 else "ball"

    def wrenches_at(self, X_WT: pin.SE3, O: Array) -> Array:  # noqa: E741 - operational point
        """N (6, 6−k) in world axes at O, the tip standing at X_WT."""
        R = X_WT.rotation
        return carry_wrench(np.vstack((R @ self.N[:3], R @ self.N[3:])), X_WT.translation, O)

    def motions_at(self, X_WT: pin.SE3, O: Array) -> Array:  # noqa: E741
        """T (6, k) in world axes at O, the tip standing at X_WT."""
        R = X_WT.rotation
        return carry_twist(np.vstack((R @ self.T[:3], R @ self.T[3:])), X_WT.translation, O)

    def miss(self, X_WT: pin.SE3, X_WO: pin.SE3) -> Array:
        """How far the object is from where the grasp can hold it, (6−k,) along N (m, rad).

        Its rate is N(O)ᵀ(V_O − V_tip), exactly where it vanishes: the permitted part of the
        displacement from tip to object is taken off first.
        """
        away = X_WT.actInv(X_WO * self.X_TO.inverse())  # zero motion: identity
        T = self.T
        left = self._displacement(away)
        for _ in range(50 if T.shape[1] else 0):
            part = np.linalg.lstsq(T, left, rcond=None)[0]
            away = away * pin.exp6(pin.Motion(T @ part)).inverse()
            left = self._displacement(away)
            if np.abs(part).max() < 1e-14:
                break
        return np.asarray(self.N.T @ left)

    def _displacement(self, X: pin.SE3) -> Array:
        """(6,) of a relative pose: point and rotation by themselves, where T only turns."""
        if self.T[:3].any():
            return np.asarray(pin.log6(X).vector)
        return np.concatenate((X.translation, pin.log3(X.rotation)))


def _wrenches(T: Array) -> Array:
    """N with NᵀT = 0: forces first, then couples, where T turns only."""
    if T.shape[1] == 0:
        return np.eye(6)
    if T[:3].any():
        U, _, _ = np.linalg.svd(T / np.linalg.norm(T, axis=0), full_matrices=True)
        return U[:, T.shape[1] :]
    U, _, _ = np.linalg.svd(T[3:], full_matrices=True)
    N = np.zeros((6, 6 - T.shape[1]))
    N[:3, :3] = np.eye(3)
    N[3:, 3:] = U[:, T.shape[1] :]
    return N


#: What a scenario's `type` makes of X_TO and, if it has one, an axis (3,) in the tip frame.
GRASPS: dict[str, Callable[..., Grasp]] = {}


def register_grasp(name: str, make: Callable[..., Grasp], *, axis: bool) -> None:
    """Let scenarios name a grasp.

    Args:
        name: its `type`. make: X_TO, and an axis (3,) if it has one → Grasp.
        axis: whether it has one.
    """
    GRASPS[name], GRASP_TYPES[name] = make, axis


register_grasp("rigid", Grasp.rigid, axis=False)
register_grasp("hinge", Grasp.hinge, axis=True)
register_grasp("ball", Grasp.ball, axis=False)
