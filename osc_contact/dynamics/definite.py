"""Symmetric, definite, or neither: matrices of mixed units judged free of units."""

from __future__ import annotations

import numpy as np

from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.spatial import Array

__all__ = ["element_sizes", "inverse", "require_inverse_inertia", "symmetric"]


def symmetric(matrix: Array) -> Array:
    """½ (A + Aᵀ), without the rounding errors that make a symmetric matrix none."""
    return 0.5 * (matrix + matrix.T)


def inverse(matrix: Array, what: str) -> Array:
    """Inverse of a positive definite matrix, judged and inverted with unit diagonal.

    Raises:
        ModelError: it is none (singular up to rounding, asymmetric, not finite).
    """
    diagonal = np.diag(matrix)
    if np.isfinite(matrix).all() and diagonal.min(initial=1.0) > 0.0:
        scale = np.sqrt(np.outer(diagonal, diagonal))
        scaled = matrix / scale
        skewed = np.abs(scaled - scaled.T).max(initial=0.0)
        if skewed < 1e-9 and np.linalg.eigvalsh(scaled).min(initial=1.0) > 1e-13:
            return np.linalg.inv(symmetric(scaled)) / scale
    raise ModelError(
        f"{what} is not symmetric positive definite (diagonal {np.round(diagonal, 9)}); give every "
        "body a mass and inertia, and independent axes"
    )


def require_inverse_inertia(name: str, scaled: Array) -> None:
    """Refuse what no passive mechanism can have; `scaled` is free of units, its largest near 1."""
    if np.abs(scaled - scaled.T).max(initial=0.0) > 1e-9:
        raise InvalidInputError(f"{name} is not symmetric; an inverse inertia is")
    smallest = np.linalg.eigvalsh(scaled).min(initial=0.0)
    if smallest < -1e-9:
        raise InvalidInputError(
            f"{name} is not positive semidefinite (scaled eigenvalue {smallest:.3g}); "
            "no passive body accelerates against the force on it"
        )


def element_sizes(Phi: Array) -> Array:
    """(6, 6) what the elements of Φ_e are measured against: its most mobile axis of each kind.

    One scale for the linear and one for the angular axes, so that rounding errors in a locked
    direction (of an inverse inertia carried from another point, say) are not blown up. An axis
    through O leaves linear noise only: mobilities below 1 mm/rad count as noise too.
    """
    largest = np.sqrt(np.diag(Phi).reshape(2, 3).max(axis=1, initial=0.0))
    largest = np.maximum(largest, 1e-3 * largest[::-1])
    largest[largest == 0.0] = 1.0
    scale = np.repeat(largest, 3)
    return np.outer(scale, scale)
