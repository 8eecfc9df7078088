"""Distances and witness points of two placed shapes, from coal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array

__all__ = ["Nearest", "nearest"]


@dataclass(frozen=True)
class Nearest:
    """Where two shapes are nearest.

    Attributes:
        distance: m, negative when they overlap; 0 where the solver fails.
        normal: (3,) from the second to the first, to about 1e-2 near touch; zero where it fails.
        witness: (3,) the nearest point of the second (m).
    """

    distance: float
    normal: Array
    witness: Array


def nearest(a: Any, X_A: pin.SE3, e: Any, X_E: pin.SE3) -> Nearest:
    """Of two coal shapes at these poses.

    Args:
        a, e: coal shapes. X_A, X_E: their poses in the world.
    """
    result = coal.DistanceResult()
    distance = coal.distance(a, _placed(X_A), e, _placed(X_E), coal.DistanceRequest(), result)
    normal, witness = -np.array(result.normal), np.array(result.getNearestPoint2())
    if not (abs(distance) < 1e6 and np.isfinite(normal).all() and np.isfinite(witness).all()):
        return Nearest(0.0, np.zeros(3), X_E.translation)
    return Nearest(float(distance), normal, witness)


def _placed(X: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(X.rotation, X.translation)
