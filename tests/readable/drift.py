"""Acceleration of a serial chain without joint acceleration, from its Jacobian columns."""

from __future__ import annotations

import numpy as np

from osc_contact.spatial import Array, cross

__all__ = ["drift"]


def drift(J: Array, qd: Array) -> Array:
    """Spatial acceleration γ = Σ_i V_{i−1} × J_i q̇_i (6,) of a serial chain at q̈ = 0.

    The columns J (6, n) may be written at any one point: the sum is a spatial vector there.
    """
    S = J * qd
    V = np.cumsum(S, axis=1) - S  # twist of the link before each joint
    linear = cross(V[3:], S[:3]) + cross(V[:3], S[3:])
    angular = cross(V[3:], S[3:])
    return np.concatenate((linear.sum(axis=1), angular.sum(axis=1)))
