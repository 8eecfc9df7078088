"""Equations 3 to 12 of the paper: every projection that respects a contact, on plain arrays.

This is the one place where a metric meets N and T. Wherever the paper writes Ω_f(A) with an
inertia A, pass its *inverse* here: Ω_f(A) and Ω̄_m(B) need only A⁻¹ and B, which exist (positive
semidefinite) for arms with fewer than six joints and in singular postures, where Λ does not.

Identities 9–12, with the bars that print or scan of the paper lost (see docs/paper_map.md):

    Ω_f(A₁) Ω_f(A₂) = Ω_f(A₂)      Ω̄_f(A₁) Ω_f(A₂) = 0      Ω̄_f(A₁) Ω̄_f(A₂) = Ω̄_f(A₁)
    Ω_m(B₁) Ω_m(B₂) = Ω_m(B₂)      Ω̄_m(B₁) Ω_m(B₂) = 0      Ω̄_m(B₁) Ω̄_m(B₂) = Ω̄_m(B₁)
"""

from __future__ import annotations

import numpy as np

from osc_contact.errors import ContactError
from osc_contact.spatial import Array

__all__ = [
    "Omega_f",
    "Omega_f_bar",
    "Omega_m",
    "Omega_m_bar",
    "Omega_f_bar_from_complement",
    "Omega_m_bar_from_complement",
    "null_space",
    "gram",
]

#: A sum this small against its own summands is zero in double precision.
_ROUNDING = 1e-12


def gram(columns: Array, metric: Array, what: str) -> Array:
    """columnsᵀ metric columns, checked to be safely invertible after scaling to unit diagonal.

    Scaled this way the verdict depends neither on units nor on the frame. A diagonal element that
    is nothing but the rounding error of its own sum counts as zero.

    Raises:
        ContactError: the metric cannot push (or move) along every column.
    """
    D = columns.T @ metric @ columns
    size = np.abs(columns)
    summands = np.einsum("ij,ij->j", size, np.abs(metric) @ size)
    skew = np.abs(D - D.T) / np.sqrt(np.outer(summands, summands) + np.finfo(float).tiny)
    if skew.max(initial=0.0) > 1e-9:
        raise ContactError(
            f"{what}: the metric is not symmetric (relative difference {skew.max():.3g}); "
            "inertias and inverse inertias are"
        )
    D = 0.5 * (D + D.T)
    diagonal = np.diag(D)
    blocked = np.flatnonzero(diagonal <= _ROUNDING * summands)
    if blocked.size:
        column = int(blocked[0])
        raise ContactError(
            f"{what}: column {column} has nᵀΦn = {diagonal[column]:.3g} (summands of size "
            f"{summands[column]:.3g}); the metric cannot move along it. Drop that contact, or pass "
            "a metric that is definite on N."
        )
    scaled = D / np.sqrt(np.outer(diagonal, diagonal))
    smallest = np.linalg.eigvalsh(scaled)[0] if D.size else 1.0
    if smallest < 1e-14:
        raise ContactError(
            f"{what}: the scaled {D.shape[0]}×{D.shape[0]} matrix has smallest eigenvalue "
            f"{smallest:.3g}; the columns are dependent. Remove the redundant ones."
        )
    return D


def Omega_f(N: Array, A_inv: Array) -> Array:
    """Ω_f(A) = N (NᵀA⁻¹N)⁻¹ NᵀA⁻¹, eq. 5: the part of a force in N. N (6, r), A_inv (6, 6)."""
    return N @ np.linalg.solve(gram(N, A_inv, "Ω_f"), N.T @ A_inv)


def Omega_f_bar(T: Array, A: Array) -> Array:
    """Ω̄_f(A) = A T (TᵀAT)⁻¹ Tᵀ, eq. 6: the part of a force outside N. T (6, 6−r), A (6, 6)."""
    return A @ T @ np.linalg.solve(gram(T, A, "Ω̄_f"), T.T)


def Omega_m(T: Array, B_inv: Array) -> Array:
    """Ω_m(B) = T (TᵀB⁻¹T)⁻¹ TᵀB⁻¹, eq. 7: the part of a motion in T. T (6, 6−r), B_inv (6, 6)."""
    return T @ np.linalg.solve(gram(T, B_inv, "Ω_m"), T.T @ B_inv)


def Omega_m_bar(N: Array, B: Array) -> Array:
    """Ω̄_m(B) = B N (NᵀBN)⁻¹ Nᵀ, eq. 8: the part of a motion outside T. N (6, r), B (6, 6)."""
    return B @ N @ np.linalg.solve(gram(N, B, "Ω̄_m"), N.T)


def Omega_f_bar_from_complement(N_prime: Array, T: Array) -> Array:
    """Ω̄_f = N′ (TᵀN′)⁻¹ Tᵀ, eq. 3: for any complement N′ (6, 6−r) of N.

    Raises:
        ContactError: N′ meets N, so that TᵀN′ is singular.
    """
    return N_prime @ _solve_complement(T, N_prime, "N′", "N")


def Omega_m_bar_from_complement(T_prime: Array, N: Array) -> Array:
    """Ω̄_m = T′ (NᵀT′)⁻¹ Nᵀ, eq. 4: for any complement T′ (6, r) of T.

    Raises:
        ContactError: T′ meets T, so that NᵀT′ is singular.
    """
    return T_prime @ _solve_complement(N, T_prime, "T′", "T")


def _solve_complement(dual: Array, complement: Array, prime: str, space: str) -> Array:
    """(dualᵀ complement)⁻¹ dualᵀ, its rows and columns scaled by the size of their summands."""
    square = dual.T @ complement
    size = np.abs(dual).T @ np.abs(complement)
    rows = size.max(axis=1, initial=0.0)
    rows[rows == 0.0] = 1.0
    columns = (size / rows[:, None]).max(axis=0, initial=0.0)
    columns[columns == 0.0] = 1.0
    scaled = square / np.outer(rows, columns)
    smallest = np.linalg.svd(scaled, compute_uv=False)[-1] if square.size else 1.0
    if smallest < _ROUNDING:
        raise ContactError(
            f"{prime} is not a complement of {space}: the scaled product has smallest singular "
            f"value {smallest:.3g}. Choose {prime} without a vector in common with {space}."
        )
    return np.linalg.solve(square, dual.T)


def null_space(columns: Array) -> Array:
    """A basis (6, 6−k) of {x : columnsᵀ x = 0} for independent `columns` (6, k).

    Which basis is arbitrary; the space it spans is not, so no metric is implied. Columns and
    rows are equilibrated first, so that the digits do not depend on metres or millimetres.
    """
    k = columns.shape[1]
    if k == 0:
        return np.eye(6)
    rows = np.array(
        [np.abs(columns[:3]).max(initial=0.0)] * 3 + [np.abs(columns[3:]).max(initial=0.0)] * 3
    )
    rows[rows == 0.0] = 1.0
    scaled = columns / rows[:, None]
    scaled = scaled / np.linalg.norm(scaled, axis=0)
    U = np.linalg.svd(scaled, full_matrices=True)[0]
    return np.asarray(U[:, k:] / rows[:, None])
