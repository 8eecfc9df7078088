"""How the bodies of a plant's environment move: at rest, driven, or free on a slide or a hinge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from osc_contact.interface import Touched
from osc_contact.spatial import Array, Poses, cross, rotations, turned

__all__ = ["Motion", "Rail", "poses", "touched"]

Motion = Callable[[float], tuple[Array, Array, Array]]


@dataclass(frozen=True)
class Rail:
    """A slide along u, and on it a hinge about a; either may be missing.

    s = (travel (m), angle (rad)) from the assembled pose. A point that was at x is at
    c + u s₁ + R(a, s₂)(x − c); the hinge's axis keeps its direction.

    Attributes:
        direction: (3,) u, unit, world; zero: no slide.
        axis: (3,) a, unit, world; zero: no hinge. through: (3,) c, where the hinge is at s = 0.
        motion: t → (s, ṡ, s̈), each (2,), of a driven body. None: it is free along its one joint,
            I s̈ = (force or moment along it) + preload − k s − c ṡ.
        inertia: I of a free body, kg on a slide, kg m² about a hinge.
        stiffness, damping, preload: of a free body, per m and N or per rad and N m.
    """

    direction: Array = field(default_factory=lambda: np.zeros(3))
    axis: Array = field(default_factory=lambda: np.zeros(3))
    through: Array = field(default_factory=lambda: np.zeros(3))
    motion: Motion | None = None
    inertia: float = 1.0
    stiffness: float = 0.0
    damping: float = 0.0
    preload: float = 0.0

    @property
    def joints(self) -> list[int]:
        """Which of travel (0) and angle (1) there are."""
        return [k for k, u in enumerate((self.direction, self.axis)) if u.any()]

    def pose(self, s: Array) -> pin.SE3:
        """X_WE: identity at s = 0."""
        R = pin.exp3(self.axis * s[1])
        return pin.SE3(R, self.through + self.direction * s[0] - R @ self.through)

    def over(self, travel: Array, angle: Array) -> Poses:
        """`pose` at k times; travel and angle (k,)."""
        R = rotations(self.axis[:, None] * angle)
        c = np.repeat(self.through[:, None], len(travel), axis=1)
        return Poses(R, c + self.direction[:, None] * travel - turned(R, c))

    def twist(self, s: Array, rates: Array, point: Array) -> Array:
        """(6,) of the body at a point (3,) of the world, world axes; linear in the rates (2,)."""
        arm = point - self.through - self.direction * s[0]
        spin = self.axis * rates[1]
        return np.concatenate((self.direction * rates[0] + cross(spin, arm), spin))

    def acceleration(self, s: Array, rates: Array, second: Array, point: Array) -> Array:
        """(6,) classical, of the body's point that is at `point` now; second: (2,) s̈."""
        out = self.twist(s, second, point)
        spin = self.axis * rates[1]
        arm = point - self.through - self.direction * s[0]
        out[:3] += cross(spin, cross(spin, arm))
        return out


def poses(rails: Sequence[Rail | None], s: Array) -> list[pin.SE3]:
    """X_WE of every body; s (bodies, 2)."""
    return [
        pin.SE3.Identity() if rail is None else rail.pose(row)
        for rail, row in zip(rails, s, strict=True)
    ]


def touched(
    rails: Sequence[Rail | None], on: Sequence[int], s: Array, rates: Array, second: Array
) -> Touched | None:
    """What encoders on the rails and the drives tell; None where nothing can move.

    Args:
        rails: one for each body, None: fixed.
        on: the body of each contact.
        s, rates, second: (bodies, 2) along each rail; of `second` that of drives counts.
    """
    if not any(rails):
        return None
    X = np.tile(np.eye(4), (len(on), 1, 1))
    V, A = np.zeros((len(on), 6)), np.zeros((len(on), 6))
    for i, body in enumerate(on):
        rail = rails[body]
        if rail is None:
            continue
        pose = rail.pose(s[body])
        X[i], p = pose.homogeneous, pose.translation
        V[i] = rail.twist(s[body], rates[body], p)
        if rail.motion is not None:
            A[i] = rail.acceleration(s[body], rates[body], second[body], p)
    return Touched(X, V, A)
