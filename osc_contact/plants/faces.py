"""How the bodies of a plant's environment move: at rest, driven along a direction, or as carts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from osc_contact.interface import Touched
from osc_contact.spatial import Array

__all__ = ["Rail", "touched"]

Motion = Callable[[float], tuple[float, float, float]]


@dataclass(frozen=True)
class Rail:
    """A body that slides along a fixed direction u; s is its travel from the assembled pose.

    Attributes:
        direction: (3,) u, unit, world.
        motion: t → (s, ṡ, s̈) of a driven body; None: it is a cart with the numbers below,
            m s̈ = u·(f + m g) + preload − k s − c ṡ.
        mass: m (kg). stiffness: k (N/m). damping: c (N s/m). preload: (N).
    """

    direction: Array
    motion: Motion | None = None
    mass: float = 1.0
    stiffness: float = 0.0
    damping: float = 0.0
    preload: float = 0.0


def touched(
    rails: Sequence[Rail | None],
    on: Sequence[int],
    travel: Array,
    speed: Array,
    acceleration: Array,
) -> Touched | None:
    """What encoders on the rails and the drives tell; None where nothing can move.

    Args:
        rails: one for each body, None: fixed.
        on: the body of each contact.
        travel, speed, acceleration: (bodies,) along each rail; accelerations of drives only.
    """
    if not any(rails):
        return None
    X = np.tile(np.eye(4), (len(on), 1, 1))
    V, A = np.zeros((len(on), 6)), np.zeros((len(on), 6))
    for i, body in enumerate(on):
        rail = rails[body]
        if rail is not None:
            X[i, :3, 3] = rail.direction * travel[body]
            V[i, :3] = rail.direction * speed[body]
            if rail.motion is not None:
                A[i, :3] = rail.direction * acceleration[body]
    return Touched(X, V, A)
