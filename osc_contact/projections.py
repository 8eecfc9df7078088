"""Projections onto contact forces and free motions, equations 3 to 12 of the paper, on arrays.

Where the paper writes Ω_f(A) with an inertia A, the functions here take the *inverse* of A: Ω_f(A)
and Ω̄_m(B) need only A⁻¹ and B, which exist (positive semidefinite) also for arms with fewer than
six joints and in singular postures, where Λ does not exist.

Identities 9–12, with the bars that are missing in the printed paper (see docs/paper_map.md):

    Ω_f(A₁) Ω_f(A₂) = Ω_f(A₂)      Ω̄_f(A₁) Ω_f(A₂) = 0      Ω̄_f(A₁) Ω̄_f(A₂) = Ω̄_f(A₁)
    Ω_m(B₁) Ω_m(B₂) = Ω_m(B₂)      Ω̄_m(B₁) Ω_m(B₂) = 0      Ω̄_m(B₁) Ω̄_m(B₂) = Ω̄_m(B₁)
"""

from typing import NoReturn

import numpy as np

from osc_contact.errors import ContactError, OscContactError
from osc_contact.spatial import Array, norm


def Omega_f(N: Array, A_inv: Array) -> Array:
    """Projection Ω_f(A) = N (NᵀA⁻¹N)⁻¹ NᵀA⁻¹ (6, 6), eq. 5: the part of a force in range(N).

    Args:
        N: (6, r) basis of the contact forces.
        A_inv: (6, 6) inverse of the inertia A, positive semidefinite.

    Raises:
        ContactError: columns are zero or dependent, or the metric is singular along one of them.
    """
    return _onto_range(N, A_inv, "Ω_f")


def Omega_f_bar(T: Array, A: Array) -> Array:
    """Projection Ω̄_f(A) = A T (TᵀAT)⁻¹ Tᵀ (6, 6), eq. 6: the part of a force outside range(N).

    Args:
        T: (6, 6−r) basis of the free motions.
        A: (6, 6) inertia, positive semidefinite.

    Raises:
        ContactError: columns are zero or dependent, or the metric is singular along one of them.
    """
    return _onto_range(T, A, "Ω̄_f").T


def Omega_m(T: Array, B_inv: Array) -> Array:
    """Projection Ω_m(B) = T (TᵀB⁻¹T)⁻¹ TᵀB⁻¹ (6, 6), eq. 7: the part of a motion in range(T).

    Args:
        T: (6, 6−r) basis of the free motions.
        B_inv: (6, 6) inverse of the mobility B, positive semidefinite.

    Raises:
        ContactError: columns are zero or dependent, or the metric is singular along one of them.
    """
    return _onto_range(T, B_inv, "Ω_m")


def Omega_m_bar(N: Array, B: Array) -> Array:
    """Projection Ω̄_m(B) = B N (NᵀBN)⁻¹ Nᵀ (6, 6), eq. 8: the part of a motion outside range(T).

    Args:
        N: (6, r) basis of the contact forces.
        B: (6, 6) mobility, positive semidefinite.

    Raises:
        ContactError: columns are zero or dependent, or the metric is singular along one of them.
    """
    return _onto_range(N, B, "Ω̄_m").T


def _onto_range(columns: Array, metric: Array, subject: str) -> Array:
    """Compute the projection N (NᵀΦN)⁻¹ NᵀΦ (n, n) onto the range of N.

    Args:
        columns: N (n, k).
        metric: Φ (n, n), positive semidefinite.
        subject: name of the result, for messages.

    Raises:
        ContactError: columns are zero or dependent, or the metric is singular along one of them.
    """
    E, W, _ = orthonormal(columns, metric, subject)
    return E @ W.T


def Omega_f_bar_from_complement(N_prime: Array, T: Array) -> Array:
    """Projection Ω̄_f = N′ (TᵀN′)⁻¹ Tᵀ (6, 6), eq. 3, for any complement N′ of N.

    Args:
        N_prime: (6, 6−r) basis N′ of a complement of range(N).
        T: (6, 6−r) basis of the free motions.

    Raises:
        ContactError: N′ meets N, so that TᵀN′ is singular.
    """
    return _along_range(N_prime, T, "N′", "N")


def Omega_m_bar_from_complement(T_prime: Array, N: Array) -> Array:
    """Projection Ω̄_m = T′ (NᵀT′)⁻¹ Nᵀ (6, 6), eq. 4, for any complement T′ of T.

    Args:
        T_prime: (6, r) basis T′ of a complement of range(T).
        N: (6, r) basis of the contact forces.

    Raises:
        ContactError: T′ meets T, so that NᵀT′ is singular.
    """
    return _along_range(T_prime, N, "T′", "T")


def null_space(columns: Array) -> Array:
    """Basis (6, 6−k) of {x : columnsᵀ x = 0} for independent `columns` (6, k).

    The space is unique, its basis is not: no metric is implied. Rows and columns are scaled first,
    so that the number of correct digits does not depend on the unit of length.
    """
    rows, U, _ = span(columns)
    return U[:, columns.shape[1] :] / rows


def _along_range(complement: Array, dual: Array, prime: str, space: str) -> Array:
    """Projection C (DᵀC)⁻¹ Dᵀ (6, 6), computed with well-conditioned bases of the two ranges.

    Args:
        complement: C (6, k).
        dual: D (6, k).
        prime: name of C, for messages.
        space: name of the space of which range(C) is to be a complement.

    Raises:
        ContactError: DᵀC is singular.
    """
    k = dual.shape[1]
    if k == 0:
        return np.zeros((6, 6))
    # well-conditioned bases D and K of both ranges, with the powers DᵀK of their columns
    rows, U, C = span(dual)
    rows_c, U_c, C_c = span(complement)
    D = rows * U[:, :k]
    K = rows_c * U_c[:, :k]
    power = D.T @ K
    # least singular values: of the powers, relative to the sums of magnitudes, and of unit columns
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


# Numerically robust bases of a space, of its annihilator, and orthonormal by a metric.
#
# N and Φ are given by users: columns may differ by 1e-6, and Φ may be singular. Every formula with
# (NᵀΦN)⁻¹ is evaluated by `orthonormal`, which checks both. No check depends on units: linear and
# angular rows are scaled by the largest number of their kind, columns to unit length.


# Limits, decades above rounding errors and decades below the figures of any real geometry.
#: Least singular value of unit columns that count as independent; dependent ones: 1e-17 … 1e-14.
DEPENDENT = 1e-12
#: Least singular value of the unit columns of a contact that count as independent.
INDEPENDENT = 1e-10
#: Least share of a direction in a metric or dual space: 1e-6 … 1 within it, 1e-17 … 1e-10 outside.
BLOCKED = 1e-8
#: Error of the direction that unit columns hardly span, times their least singular value.
BLURRED = 1e-13
#: Least eigenvalue of a scaled metric relative to the largest; rounding turns 0 into 1e-17 … 1e-14.
_LEAST_MOBILITY = 1e-12
#: Largest difference from symmetry of a scaled metric.
_MOST_ASYMMETRY = 1e-9


def scaled_columns(columns: Array, name: str = "N") -> tuple[Array, Array]:
    """Scale columns (n, k) to unit length; return them and their lengths (k,).

    Args:
        columns: (n, k).
        name: name of the matrix, for messages.

    Raises:
        ContactError: a column is zero.
    """
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not size.all():
        raise ContactError(f"{name}: column {int(size.argmin())} is zero; remove it")
    return (columns / size, size)


def independent(scaled: Array) -> bool:
    """True if columns (6, k) of unit length are independent."""
    k = scaled.shape[1]
    if k < 2:
        return True
    return k <= 6 and bool(np.linalg.svd(scaled, compute_uv=False)[-1] >= INDEPENDENT)


def require_independent(columns: Array, name: str) -> None:
    """Refuse zero and dependent columns.

    Args:
        columns: (6, k).
        name: name of the matrix, for messages.

    Raises:
        ContactError: a column is zero, or columns are dependent; the message names them.
    """
    if columns.shape[1] > 6:
        raise ContactError(
            f"{name}: {columns.shape[1]} columns in a 6-dimensional space are dependent; their "
            "magnitudes cannot be distinguished. Keep six or fewer independent ones."
        )
    scaled, _ = scaled_columns(columns, name)
    if independent(scaled):
        return
    smallest, which = least(scaled)
    raise ContactError(
        f"{name}: columns {which} are dependent (smallest scaled singular value "
        f"{smallest:.2g}, limit {INDEPENDENT:g}); keep an independent subset, the "
        "split of the force among dependent contacts is not unique"
    )


def span(columns: Array) -> tuple[Array, Array, Array]:
    """Factors rows (n, 1), U (n, n) and C (k, k) of N = (rows U[:, :k]) C; U is orthogonal.

    rows U[:, :k] is a well-conditioned basis of range(N); U[:, k:] / rows is a basis of its
    annihilator. `rows` scales the units: six rows are three linear and three angular ones, any
    other number of rows is of one kind.

    Args:
        columns: N (n, k), k ≤ n.
    """
    n = len(columns)
    rows = np.ones((n, 1))
    if n == 6:
        largest = np.abs(columns).reshape(2, -1).max(axis=1, initial=0.0)
        rows = np.repeat(np.where(largest > 0.0, largest, 1.0), 3)[:, None]
    unit, length = _unit_columns(columns / rows)
    U, S, Vt = np.linalg.svd(unit)
    return (rows, U, S[:, None] * Vt * length)


def unit_diagonal(
    matrix: Array, name: str, cure: str, refusal: type[OscContactError]
) -> tuple[Array, Array]:
    """Scale a positive definite matrix to unit diagonal.

    Args:
        matrix: (n, n).
        name: name of the matrix, for messages.
        cure: description of a valid matrix, for messages.
        refusal: class of the error.

    Returns:
        The scaled matrix, and the roots (n,) of the diagonal elements of `matrix`.

    Raises:
        OscContactError: the matrix is singular up to rounding, asymmetric, or not finite.
    """
    diagonal = np.diag(matrix)
    if np.isfinite(matrix).all() and diagonal.min(initial=1.0) > 0.0:
        size = np.sqrt(diagonal)
        scaled = matrix / np.outer(size, size)
        asymmetry = np.abs(scaled - scaled.T).max(initial=0.0)
        if (
            asymmetry <= _MOST_ASYMMETRY
            and np.linalg.eigvalsh(scaled).min(initial=1.0) > _LEAST_MOBILITY
        ):
            return (scaled, size)
    raise refusal(
        f"{name} is not symmetric positive definite (diagonal {np.round(diagonal, 9)}); give {cure}"
    )


def least(columns: Array) -> tuple[float, list[int]]:
    """Compute the least singular value of columns (n, k), k ≤ n, scaled to unit length.

    Returns:
        The singular value, and the indices of the columns that take part in its singular vector.
    """
    _, S, Vt = np.linalg.svd(_unit_columns(columns)[0], full_matrices=False)
    return (float(S[-1]), _large_weights(Vt[-1]))


def orthonormal(columns: Array, metric: Array, subject: str) -> tuple[Array, Array, Array]:
    """Basis E of range(N) that is orthonormal in the metric Φ: E = NG, EᵀΦE = 1, W = ΦE.

    Formulas with (NᵀΦN)⁻¹ = GGᵀ follow from E, W and G. NᵀΦN itself is not formed, as that would
    square the condition number: four digits would be left for columns that differ by 1e-6. With
    the sizes s of the rows of Φ and Φ = sFFᵀs: sN = QM, FᵀQ = PΣZᵀ, E = s⁻¹QZΣ⁻¹, W = sFP,
    G = M⁻¹ZΣ⁻¹.

    Args:
        columns: N (n, k).
        metric: Φ (n, n), symmetric positive semidefinite, of any rank.
        subject: name of the result that is computed, for messages.

    Returns:
        E (n, k), W (n, k) and G (k, k).

    Raises:
        ContactError: Φ is not symmetric or has a negative eigenvalue; the columns are dependent;
            Φ cannot push (or move) along one of them or along a combination.
    """
    n, k = columns.shape
    if k == 0:
        return (np.zeros((n, 0)), np.zeros((n, 0)), np.zeros((0, 0)))
    if k > n:
        raise ContactError(f"{subject}: {k} columns of {n} numbers are dependent. Remove some.")
    sizes, F = _scaled_factors(metric, subject)
    rows, U, C = span(columns)
    Q, M = np.linalg.qr(sizes * rows * U[:, :k])
    M = M @ C
    independent = np.linalg.svd(_unit_columns(M)[0], compute_uv=False)[-1]
    P, Sigma, Zt = np.linalg.svd(F.T @ Q, full_matrices=False)
    if independent < DEPENDENT or Sigma[-1] < max(BLOCKED, BLURRED / independent):
        _raise_refusal(M, F.T @ Q, Zt[-1], subject)
    Z = Zt.T / Sigma
    return (Q @ Z / sizes, sizes * (F @ P), np.linalg.solve(M, Z))


def left_inverse(columns: Array, metric: Array, subject: str) -> Array:
    """Compute the left inverse (NᵀΦN)⁻¹NᵀΦ (k, n) of N by the metric Φ.

    Args:
        columns: N (n, k), independent.
        metric: Φ (n, n), symmetric positive semidefinite.
        subject: name of the columns, for messages.

    Raises:
        ContactError: columns are zero or dependent, or the metric is singular along one of them.
    """
    _, W, G = orthonormal(columns, metric, subject)
    return G @ W.T


def _raise_refusal(M: Array, X: Array, unseen: Array, subject: str) -> NoReturn:
    """Raise the error of `orthonormal`: a zero column, dependent columns, or a blocked combination.

    Args:
        M: (k, k) coordinates of the columns in an orthonormal basis Q.
        X: (m, k) FᵀQ, whose columns are the directions of Q in the metric.
        unseen: (k,) right singular vector of X with the least singular value.
        subject: name of the result that is computed.

    Raises:
        ContactError: always.
    """
    unit, length = _unit_columns(M)
    mobility = np.linalg.norm(X @ unit, axis=0)
    column = mobility.argmin()
    independent, which = least(M)
    if mobility[column] < BLOCKED:
        raise ContactError(
            f"{subject}: column {column} has nᵀΦn = {(mobility * length)[column] ** 2:.3g}, its "
            f"root {mobility[column]:.2g} of what it may be (limit {BLOCKED:g}); the metric cannot "
            "move along it. Drop that contact, or pass a metric that is definite on N."
        )
    if independent < DEPENDENT:
        raise ContactError(
            f"{subject}: columns {which} are dependent (least singular value of unit columns "
            f"{independent:.2g}, limit {DEPENDENT:g}). Remove the redundant ones."
        )
    share = norm(X @ unseen)
    which = _large_weights(np.linalg.solve(unit, unseen))
    raise ContactError(
        f"{subject}: columns {which} are dependent in the metric (least singular value "
        f"{share:.2g}, limit {max(BLOCKED, BLURRED / independent):.2g}); it cannot move along one "
        "combination of them. Drop a contact, or pass a metric that is definite on N."
    )


def _unit_columns(columns: Array) -> tuple[Array, Array]:
    """Scale columns (n, k) to unit length; return them and divisors (k,), 1 for zero columns."""
    length = np.linalg.norm(columns, axis=0)
    length[length == 0.0] = 1.0
    return (columns / length, length)


def _large_weights(weights: Array) -> list[int]:
    """List the indices of weights (k,) whose magnitude is above 0.1 % of the largest one."""
    size = np.abs(weights)
    return np.flatnonzero(size > 1e-3 * size.max()).tolist()


def _scaled_factors(metric: Array, subject: str) -> tuple[Array, Array]:
    """Factors sizes (n, 1) and F (n, n), of norm 1, with metric = (sizes F)(sizes F)ᵀ.

    A size is the root of a diagonal element: in six dimensions that of the largest linear or
    angular one, else that of its own row. Eigenvalues within rounding errors of zero become zero,
    as their roots would be 1e-8.

    Args:
        metric: (n, n), symmetric positive semidefinite.
        subject: name of the result that is computed, for messages.

    Raises:
        ContactError: the metric is not symmetric, or has a negative eigenvalue.
    """
    diagonal = np.maximum(np.diag(metric), 0.0)
    if len(diagonal) == 6:
        diagonal = np.repeat(diagonal.reshape(2, 3).max(axis=1), 3)
    sizes = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))[:, None]
    scaled = metric / sizes / sizes.T
    skew = np.abs(scaled - scaled.T).max()
    if skew > _MOST_ASYMMETRY:
        raise ContactError(
            f"{subject}: the metric is not symmetric (relative difference {skew:.3g}); "
            "inertias and inverse inertias are"
        )
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    if values[0] < -_MOST_ASYMMETRY:
        raise ContactError(
            f"{subject}: the scaled metric has smallest eigenvalue {values[0]:.3g}; that of an "
            "inertia or inverse inertia is not negative. Pass a positive semidefinite metric."
        )
    values[values < _LEAST_MOBILITY * values[-1]] = 0.0
    root = np.sqrt(values[-1]) if values[-1] > 0.0 else 1.0
    return (sizes * root, vectors * np.sqrt(np.maximum(values, 0.0)) / root)
