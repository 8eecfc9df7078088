"""Equations 3 to 12 of the paper: every projection that respects a contact, on plain arrays.

Wherever the paper writes Ω_f(A) with an
inertia A, pass its *inverse* here: Ω_f(A) and Ω̄_m(B) need only A⁻¹ and B, which exist (positive
semidefinite) for arms with fewer than six joints and in singular postures, where Λ does not.

Identities 9–12, with the bars that print or scan of the paper lost (see docs/paper_map.md):

    Ω_f(A₁) Ω_f(A₂) = Ω_f(A₂)      Ω̄_f(A₁) Ω_f(A₂) = 0      Ω̄_f(A₁) Ω̄_f(A₂) = Ω̄_f(A₁)
    Ω_m(B₁) Ω_m(B₂) = Ω_m(B₂)      Ω̄_m(B₁) Ω_m(B₂) = 0      Ω̄_m(B₁) Ω̄_m(B₂) = Ω̄_m(B₁)
"""

from __future__ import annotations

import numpy as np

from osc_contact.errors import ContactError
from osc_contact.spans import BLOCKED, BLURRED, DEPENDENT, least, orthonormal, span
from osc_contact.spatial import Array

__all__ = [
    "Omega_f",
    "Omega_f_bar",
    "Omega_m",
    "Omega_m_bar",
    "Omega_f_bar_from_complement",
    "Omega_m_bar_from_complement",
    "null_space",
]


def Omega_f(N: Array, A_inv: Array) -> Array:
    """Ω_f(A) = N (NᵀA⁻¹N)⁻¹ NᵀA⁻¹, eq. 5: the part of a force in N. N (6, r), A_inv (6, 6)."""
    E, W, _ = orthonormal(N, A_inv, "Ω_f")
    return E @ W.T


def Omega_f_bar(T: Array, A: Array) -> Array:
    """Ω̄_f(A) = A T (TᵀAT)⁻¹ Tᵀ, eq. 6: the part of a force outside N. T (6, 6−r), A (6, 6)."""
    E, W, _ = orthonormal(T, A, "Ω̄_f")
    return W @ E.T


def Omega_m(T: Array, B_inv: Array) -> Array:
    """Ω_m(B) = T (TᵀB⁻¹T)⁻¹ TᵀB⁻¹, eq. 7: the part of a motion in T. T (6, 6−r), B_inv (6, 6)."""
    E, W, _ = orthonormal(T, B_inv, "Ω_m")
    return E @ W.T


def Omega_m_bar(N: Array, B: Array) -> Array:
    """Ω̄_m(B) = B N (NᵀBN)⁻¹ Nᵀ, eq. 8: the part of a motion outside T. N (6, r), B (6, 6)."""
    E, W, _ = orthonormal(N, B, "Ω̄_m")
    return W @ E.T


def Omega_f_bar_from_complement(N_prime: Array, T: Array) -> Array:
    """Ω̄_f = N′ (TᵀN′)⁻¹ Tᵀ, eq. 3: for any complement N′ (6, 6−r) of N.

    Raises:
        ContactError: N′ meets N, so that TᵀN′ is singular.
    """
    return _along(N_prime, T, "N′", "N")


def Omega_m_bar_from_complement(T_prime: Array, N: Array) -> Array:
    """Ω̄_m = T′ (NᵀT′)⁻¹ Nᵀ, eq. 4: for any complement T′ (6, r) of T.

    Raises:
        ContactError: T′ meets T, so that NᵀT′ is singular.
    """
    return _along(T_prime, N, "T′", "T")


def null_space(columns: Array) -> Array:
    """A basis (6, 6−k) of {x : columnsᵀ x = 0} for independent `columns` (6, k).

    Which basis is arbitrary; the space it spans is not, so no metric is implied. Columns and
    rows are equilibrated first, so that the digits do not depend on metres or millimetres.
    """
    k = columns.shape[1]
    if k == 0:
        return np.eye(6)
    rows, U, _ = span(columns)
    return np.asarray(U[:, k:] / rows)


def _along(complement: Array, dual: Array, prime: str, space: str) -> Array:
    """complement (dualᵀ complement)⁻¹ dualᵀ, with a well-conditioned basis in place of both."""
    k = dual.shape[1]
    if k == 0:
        return np.zeros((6, 6))
    rows, U, C = span(dual)
    rows_c, U_c, C_c = span(complement)
    D = rows * U[:, :k]
    K = rows_c * U_c[:, :k]
    power = D.T @ K
    summands = (np.abs(D).T @ np.abs(K)).max()
    common = np.linalg.svd(power, compute_uv=False)[-1] / (summands or 1.0)
    independent = min(least(C)[0], least(C_c)[0])
    if independent < DEPENDENT or common < max(BLOCKED, BLURRED / independent):
        raise ContactError(
            f"{prime} is not a complement of {space}: least singular value of unit columns "
            f"{independent:.2g} (limit {DEPENDENT:g}), of their power {common:.2g} (limit "
            f"{BLOCKED:g}). Choose {prime} without a vector in common with {space}."
        )
    return K @ np.linalg.solve(power, D.T)
