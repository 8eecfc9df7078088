"""Rotation, angular velocity and acceleration of a moving rotation vector."""

from __future__ import annotations

import math

import numpy as np

from osc_contact.spatial import Array, cross, skew

__all__ = ["rotation_of"]


def rotation_of(w: Array, w_dot: Array, w_ddot: Array) -> tuple[Array, Array, Array]:
    """R (3, 3), ω and ω̇ (3,) in world axes of the rotation exp[w]× with moving w (3,).

    ω = A ẇ with A = a + b [w]× + c w wᵀ, a = sin θ/θ, b = (1 − cos θ)/θ², c = (θ − sin θ)/θ³;
    ω̇ = A ẅ + Ȧ ẇ.

    Args:
        w, w_dot, w_ddot: (3,) rotation vector and derivatives (rad, rad/s, rad/s²).
    """
    square = float(w @ w)
    a, b, c, a1, b1, c1 = _functions_of_angle(square)
    along, across = float(w @ w_dot), cross(w, w_dot)
    omega = a * w_dot + b * across + (c * along) * w
    rate = a1 * along * w_dot + b1 * along * across + (c1 * along**2) * w  # ȧ = a₁ wᵀẇ, …
    turning = c * (along * w_dot + float(w_dot @ w_dot) * w)
    omega_dot = a * w_ddot + b * cross(w, w_ddot) + (c * float(w @ w_ddot)) * w + rate + turning
    W = skew(w)
    return np.eye(3) + a * W + b * (W @ W), omega, omega_dot


_EVEN = np.arange(8)
#: (3, 8) coefficients of (θ²)ᵏ in a, b, c of `rotation_of`: (−1)ᵏ/(2k + 1)!, /(2k + 2)!, /(2k + 3)!
_SERIES = np.array(
    [[(-1) ** k / math.factorial(2 * k + first) for k in range(8)] for first in (1, 2, 3)]
)
_SLOPES = _SERIES[:, 1:] * 2 * _EVEN[1:]


def _functions_of_angle(square: float) -> tuple[float, float, float, float, float, float]:
    """a, b, c of `rotation_of` at θ² and their derivatives by θ, divided by θ."""
    if square < 0.1:
        powers = square**_EVEN
        a, b, c, *slopes = map(float, (*(_SERIES @ powers), *(_SLOPES @ powers[:-1])))
        return a, b, c, slopes[0], slopes[1], slopes[2]
    angle = math.sqrt(square)
    a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    c = (1.0 - a) / square
    return a, b, c, (math.cos(angle) - a) / square, (a - 2 * b) / square, (b - 3 * c) / square
