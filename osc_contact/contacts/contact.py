"""One state of contact: N, T and n_γ, at the operational point in world axes (paper, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt

from osc_contact import projections
from osc_contact.errors import ContactError
from osc_contact.spatial import Array, as_array

__all__ = ["Contact"]

_RANK_TOLERANCE = 1e-10


class Contact:
    """A state of contact between the held object and its environment.

    range(N) = N ⊆ F⁶ holds every force the contact can transmit, range(T) = T ⊆ M⁶ every motion
    it permits, NᵀT = 0 (paper, section 3). The columns of N are wrenches pushed *into* the
    environment, so that a pressed contact has α > 0; they need be neither unit nor orthogonal.

    Attributes:
        N: (6, r) basis of the contact normal space (N, N m per unit magnitude).
        T: (6, 6−r) basis of the tangent space (m/s, rad/s).
        n_gamma: (r,) the normal acceleration Nᵀa_rel = −ṄᵀV_rel that keeps the contact (m/s²).
    """

    def __init__(self, N: npt.ArrayLike, n_gamma: npt.ArrayLike | None = None) -> None:
        """Take any basis N (6, r) of the contact forces, 0 ≤ r ≤ 6.

        Raises:
            InvalidInputError: wrong shapes or non-finite numbers.
            ContactError: dependent or zero columns.
        """
        self.N: Array = as_array("N", N, (6, None))
        self.n_gamma: Array = (
            np.zeros(self.r) if n_gamma is None else as_array("n_gamma", n_gamma, (self.r,))
        )
        _require_independent(self.N, "N")

    @classmethod
    def from_tangents(cls, T: npt.ArrayLike, n_gamma: npt.ArrayLike | None = None) -> Contact:
        """The contact that permits exactly the motions range(T), T (6, 6−r); N follows."""
        tangents = as_array("T", T, (6, None))
        _require_independent(tangents, "T")
        contact = cls(projections.null_space(tangents), n_gamma)
        contact.__dict__["T"] = tangents
        return contact

    @classmethod
    def stack(cls, contacts: Sequence[Contact]) -> Contact:
        """Several contacts at once: their N side by side, their n_γ one below the other.

        Raises:
            ContactError: together they are dependent (their split into magnitudes is not unique).
        """
        if not contacts:
            return cls(np.zeros((6, 0)))
        return cls(
            np.hstack([c.N for c in contacts]), np.concatenate([c.n_gamma for c in contacts])
        )

    @property
    def r(self) -> int:
        """Degree of motion constraint, 0 … 6."""
        return int(self.N.shape[1])

    @cached_property
    def T(self) -> Array:
        """(6, 6−r) a basis of the permitted motions, NᵀT = 0."""
        return projections.null_space(self.N)

    def force_projection(self, A_inv: Array) -> Array:
        """Ω_f(A), eq. 5, given A⁻¹ (6, 6)."""
        return projections.Omega_f(self.N, A_inv)

    def force_complement(self, A_inv: Array) -> Array:
        """Ω̄_f(A) = 1 − Ω_f(A), eqs. 3 and 6, given A⁻¹ (6, 6)."""
        return np.eye(6) - self.force_projection(A_inv)

    def motion_projection(self, B: Array) -> Array:
        """Ω_m(B) = 1 − Ω̄_m(B), eqs. 4 and 7, given B (6, 6)."""
        return np.eye(6) - self.motion_complement(B)

    def motion_complement(self, B: Array) -> Array:
        """Ω̄_m(B), eq. 8, given B (6, 6)."""
        return projections.Omega_m_bar(self.N, B)

    def __repr__(self) -> str:
        return f"Contact(r={self.r})"


def _require_independent(columns: Array, name: str) -> None:
    """Columns scaled to unit length; the tolerance is far below any real geometry."""
    if columns.shape[1] == 0:
        return
    if columns.shape[1] > 6:
        raise ContactError(
            f"{name}: {columns.shape[1]} columns in a 6-dimensional space are dependent; their "
            "magnitudes cannot be told apart. Keep six or fewer independent ones."
        )
    length = np.linalg.norm(columns, axis=0)
    if length.min() == 0.0:
        raise ContactError(f"{name}: column {int(length.argmin())} is zero; remove it")
    singular = np.linalg.svd(columns / length)
    if singular.S[-1] < _RANK_TOLERANCE:
        weight = np.abs(singular.Vh[-1])
        which = [int(i) for i in np.flatnonzero(weight > 1e-3 * weight.max())]
        raise ContactError(
            f"{name}: columns {which} are dependent (smallest scaled singular value "
            f"{singular.S[-1]:.2g}, limit {_RANK_TOLERANCE:g}); keep an independent subset, the "
            "split of the force among dependent contacts is not unique"
        )
