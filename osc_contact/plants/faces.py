"""How the bodies of a plant's environment move: at rest, driven, or free on a slide or a hinge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.interface import Touched
from osc_contact.spatial import Array, Poses, classical_to_spatial, cross, rotated, rotations

__all__ = [
    "Motion",
    "Rail",
    "along_rails",
    "drift_of_faces",
    "driven_accelerations",
    "force_on_rail",
    "free_rails",
    "poses",
    "touched",
]

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
        return Poses(R, c + self.direction[:, None] * travel - rotated(R, c))

    def twist(self, s: Array, rates: Array, point: Array) -> Array:
        """(6,) of the body at a point (3,) of the world, world axes; linear in the rates (2,).

        Args:
            s, rates: (2,) coordinates and rates. point: (3,) m.
        """
        arm = point - self.through - self.direction * s[0]
        spin = self.axis * rates[1]
        return np.concatenate((self.direction * rates[0] + cross(spin, arm), spin))

    def acceleration(self, s: Array, rates: Array, second: Array, point: Array) -> Array:
        """(6,) classical, of the body's point that is at `point` now; second: (2,) s̈.

        Args:
            s, rates, second: (2,) coordinates and derivatives. point: (3,) m.
        """
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
    """Readings of encoders on the rails and drives; None where nothing can move.

    Args:
        rails: one for each body, None: fixed.
        on: the body of each contact.
        s, rates, second: (bodies, 2) along each rail; of `second` that of drives counts.
    """
    if not any(rails):
        return None
    X = np.tile(np.eye(4), (len(on), 1, 1))
    V = np.zeros((len(on), 6))
    A = np.zeros((len(on), 6))
    for i, body in enumerate(on):
        rail = rails[body]
        if rail is None:
            continue
        pose = rail.pose(s[body])
        X[i] = pose.homogeneous
        p = pose.translation
        V[i] = rail.twist(s[body], rates[body], p)
        if rail.motion is not None:
            A[i] = rail.acceleration(s[body], rates[body], second[body], p)
    return Touched(X, V, A)


def driven_accelerations(rails: Sequence[Rail | None], time: float) -> Array:
    """(bodies, 2) accelerations of the driven ones; 0 for others."""
    return np.array(
        [np.zeros(2) if r is None or r.motion is None else r.motion(time)[2] for r in rails]
    ).reshape(-1, 2)


def along_rails(
    rails: Sequence[Rail | None], on: Sequence[int], s: Array, parts: list[Contact], point: Array
) -> Array:
    """(r, bodies, 2) Nᵀ × the twists per unit rate: how fast each gap closes with them.

    Args:
        rails: of the bodies. on: the body of each contact. s: (bodies, 2) travel and angle.
        parts: the contacts. point: (3,) where their columns are given.
    """
    out = np.zeros((sum(c.r for c in parts), len(rails), 2))
    row = 0
    for part, body in zip(parts, on, strict=True):
        rail = rails[body]
        if rail is not None:
            for k, rate in enumerate(np.eye(2)):
                twist = rail.twist(s[body], rate, point)
                out[row : row + part.r, body, k] = part.N.T @ twist
        row += part.r
    return out


def drift_of_faces(
    rails: Sequence[Rail | None],
    on: Sequence[int],
    s: Array,
    rates: Array,
    parts: list[Contact],
    point: Array,
) -> Array:
    """(r,) Nᵀ × the spatial acceleration at the point of bodies at s̈ = 0; as `along_rails`.

    Args:
        rails, on, s, parts, point: as there. rates: (bodies, 2) of s.
    """
    out = [np.zeros(0)]
    for part, body in zip(parts, on, strict=True):
        rail = rails[body]
        drift = np.zeros(6)
        if rail is not None:
            drift = rail.acceleration(s[body], rates[body], np.zeros(2), point)
            drift = classical_to_spatial(drift, rail.twist(s[body], rates[body], point))
        out.append(part.N.T @ drift)
    return np.concatenate(out)


def free_rails(rails: Sequence[Rail | None]) -> dict[int, Rail]:
    """The bodies that follow the contact force."""
    return {i: r for i, r in enumerate(rails) if r is not None and r.motion is None}


def force_on_rail(rail: Rail, s: Array, rates: Array, gravity: Array) -> float:
    """Force along a free body's joint besides the contact's (N, N m); hinges are balanced.

    Args:
        rail: of the body. s, rates: (2,) coordinates and rates. gravity: (3,) m/s².
    """
    k = rail.joints[0]
    weight = rail.inertia * float(rail.direction @ gravity)
    spring = rail.stiffness * s[k] + rail.damping * rates[k]
    return float(weight + rail.preload - spring)
