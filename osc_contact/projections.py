"""Equations 3 to 12 of the paper: every projection that respects a contact, on plain arrays.

Wherever the paper writes Ω_f(A) with an
inertia A, pass its *inverse* here: Ω_f(A) and Ω̄_m(B) need only A⁻¹ and B, which exist (positive
semidefinite) for arms with fewer than six joints and in singular postures, where Λ does not.

Identities 9–12, with the bars that print or scan of the paper lost (see docs/paper_map.md):

    Ω_f(A₁) Ω_f(A₂) = Ω_f(A₂)      Ω̄_f(A₁) Ω_f(A₂) = 0      Ω̄_f(A₁) Ω̄_f(A₂) = Ω̄_f(A₁)
    Ω_m(B₁) Ω_m(B₂) = Ω_m(B₂)      Ω̄_m(B₁) Ω_m(B₂) = 0      Ω̄_m(B₁) Ω̄_m(B₂) = Ω̄_m(B₁)
"""

from typing import NoReturn

import numpy as np

from osc_contact.errors import ContactError, OscContactError
from osc_contact.spatial import Array, norm


def Omega_f(N: Array, A_inv: Array) -> Array:
    """Ω_f(A) = N (NᵀA⁻¹N)⁻¹ NᵀA⁻¹, eq. 5: the part of a force in N. N (6, r), A_inv (6, 6)."""
    return _onto(N, A_inv, "Ω_f")


def Omega_f_bar(T: Array, A: Array) -> Array:
    """Ω̄_f(A) = A T (TᵀAT)⁻¹ Tᵀ, eq. 6: the part of a force outside N. T (6, 6−r), A (6, 6)."""
    return _onto(T, A, "Ω̄_f").T


def Omega_m(T: Array, B_inv: Array) -> Array:
    """Ω_m(B) = T (TᵀB⁻¹T)⁻¹ TᵀB⁻¹, eq. 7: the part of a motion in T. T (6, 6−r), B_inv (6, 6)."""
    return _onto(T, B_inv, "Ω_m")


def Omega_m_bar(N: Array, B: Array) -> Array:
    """Ω̄_m(B) = B N (NᵀBN)⁻¹ Nᵀ, eq. 8: the part of a motion outside T. N (6, r), B (6, 6)."""
    return _onto(N, B, "Ω̄_m").T


def _onto(columns: Array, metric: Array, what: str) -> Array:
    """N (NᵀΦN)⁻¹ NᵀΦ."""
    E, W, _ = orthonormal(columns, metric, what)
    return E @ W.T


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
    rows, U, _ = span(columns)
    return U[:, columns.shape[1] :] / rows


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


# Bases that rounding cannot spoil: of a space, of what it does no work on, and by a metric.
#
# N and Φ come from outside: columns may be 1e-6 apart, Φ may be singular. Whatever divides by
# NᵀΦN goes through `orthonormal`, which judges both. No verdict depends on units: linear and
# angular rows are scaled by the largest of their kind, columns to unit length.


# Limits, each decades above what rounding leaves and decades below any real geometry.
#: Least singular value of unit columns. Dependent ones come out with 1e-17 … 1e-14.
DEPENDENT = 1e-12
#: The same for the columns of a contact; far below any real geometry.
INDEPENDENT = 1e-10
#: Share of a direction within a metric, or a dual space: 1e-6 … 1; outside of it, 1e-17 … 1e-10.
BLOCKED = 1e-8
#: The direction that columns hardly span is known to 1e-16 by that singular value.
BLURRED = 1e-13
#: Eigenvalue of a scaled metric, by the largest. Zero comes out as 1e-17 … 1e-14.
_NO_MOBILITY = 1e-12
_ASYMMETRIC = 1e-9


def scaled_columns(columns: Array, name: str = "N") -> tuple[Array, Array]:
    """Columns (n, k) scaled to unit length, and their lengths (k,); `name` is that of the matrix.

    Raises:
        ContactError: a column is zero.
    """
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not size.all():
        raise ContactError(f"{name}: column {int(size.argmin())} is zero; remove it")
    return (columns / size, size)


def independent(scaled: Array) -> bool:
    """Whether scaled columns (6, k) are independent."""
    k = scaled.shape[1]
    if k < 2:
        return True
    return k <= 6 and bool(np.linalg.svd(scaled, compute_uv=False)[-1] >= INDEPENDENT)


def require_independent(columns: Array, name: str) -> None:
    """Refuse zero and dependent columns (6, k), naming them.

    Raises:
        ContactError: with the columns involved.
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
    """rows (n, 1), U (n, n) and C (k, k) with N = (rows U[:, :k]) C; U orthogonal.

    N (n, k), k ≤ n, has the well-conditioned basis rows U[:, :k], the same for whatever metric
    follows, and exactly this basis does no work on U[:, k:] / rows. Six rows are three linear and
    three angular ones; any other number is taken to be of one kind.
    """
    n = len(columns)
    rows = np.ones((n, 1))
    if n == 6:
        largest = np.abs(columns).reshape(2, -1).max(axis=1, initial=0.0)
        rows = np.repeat(np.where(largest > 0.0, largest, 1.0), 3)[:, None]
    unit, length = _unit(columns / rows)
    U, S, Vt = np.linalg.svd(unit)
    return (rows, U, S[:, None] * Vt * length)


def unit_diagonal(
    matrix: Array, what: str, cure: str, refusal: type[OscContactError]
) -> tuple[Array, Array]:
    """A positive definite matrix (n, n) scaled to unit diagonal, and (n,) roots of the latter.

    Args:
        matrix: to be judged. what: it is, and cure: what to give, for the message.
        refusal: kind of the error.

    Raises:
        OscContactError: it is singular up to rounding, asymmetric, or not finite.
    """
    diagonal = np.diag(matrix)
    if np.isfinite(matrix).all() and diagonal.min(initial=1.0) > 0.0:
        size = np.sqrt(diagonal)
        scaled = matrix / np.outer(size, size)
        skewed = np.abs(scaled - scaled.T).max(initial=0.0)
        if skewed <= _ASYMMETRIC and np.linalg.eigvalsh(scaled).min(initial=1.0) > _NO_MOBILITY:
            return (scaled, size)
    raise refusal(
        f"{what} is not symmetric positive definite (diagonal {np.round(diagonal, 9)}); give {cure}"
    )


def least(columns: Array) -> tuple[float, list[int]]:
    """The least singular value of unit columns (n, k), k ≤ n, and which columns it is made of."""
    _, S, Vt = np.linalg.svd(_unit(columns)[0], full_matrices=False)
    return (float(S[-1]), _large(Vt[-1]))


def orthonormal(columns: Array, metric: Array, what: str) -> tuple[Array, Array, Array]:
    """E, W (n, k) and G (k, k) with E = NG, EᵀΦE = 1, W = ΦE: range(N) made orthonormal by Φ.

    Every law with (NᵀΦN)⁻¹ = GGᵀ follows. NᵀΦN itself is never formed, which would square the
    condition: of columns 1e-6 apart four digits would be left. With the sizes s of Φ's rows and
    Φ = sFFᵀs: sN = QM, FᵀQ = PΣZᵀ, E = s⁻¹QZΣ⁻¹, W = sFP, G = M⁻¹ZΣ⁻¹.

    Args:
        columns: N (n, k).
        metric: Φ (n, n), symmetric positive semidefinite, of any rank.
        what: is being made, for messages.

    Raises:
        ContactError: Φ is not symmetric or has a negative eigenvalue; the columns are dependent;
            Φ cannot push (or move) along one of them or along a combination.
    """
    n, k = columns.shape
    if k == 0:
        return (np.zeros((n, 0)), np.zeros((n, 0)), np.zeros((0, 0)))
    if k > n:
        raise ContactError(f"{what}: {k} columns of {n} numbers are dependent. Remove some.")
    sizes, F = _factor(metric, what)
    rows, U, C = span(columns)
    Q, M = np.linalg.qr(sizes * rows * U[:, :k])
    M = M @ C
    independent = np.linalg.svd(_unit(M)[0], compute_uv=False)[-1]
    P, Sigma, Zt = np.linalg.svd(F.T @ Q, full_matrices=False)
    if independent < DEPENDENT or Sigma[-1] < max(BLOCKED, BLURRED / independent):
        _refuse(M, F.T @ Q, Zt[-1], what)
    Z = Zt.T / Sigma
    return (Q @ Z / sizes, sizes * (F @ P), np.linalg.solve(M, Z))


def left_inverse(columns: Array, metric: Array, what: str) -> Array:
    """(NᵀΦN)⁻¹NᵀΦ (k, n), the left inverse of N (n, k) that Φ (n, n) makes; see `orthonormal`.

    Args:
        columns: (n, k), independent. metric: (n, n). what: they are, for the message.
    """
    _, W, G = orthonormal(columns, metric, what)
    return G @ W.T


def _refuse(M: Array, X: Array, unseen: Array, what: str) -> NoReturn:
    """Say why: one column, dependent columns, or a combination (k,) of those that M maps to."""
    unit, length = _unit(M)
    seen = np.linalg.norm(X @ unit, axis=0)
    column = seen.argmin()
    independent, which = least(M)
    if seen[column] < BLOCKED:
        raise ContactError(
            f"{what}: column {column} has nᵀΦn = {(seen * length)[column] ** 2:.3g}, its root "
            f"{seen[column]:.2g} of what it may be (limit {BLOCKED:g}); the metric cannot move "
            "along it. Drop that contact, or pass a metric that is definite on N."
        )
    if independent < DEPENDENT:
        raise ContactError(
            f"{what}: columns {which} are dependent (least singular value of unit columns "
            f"{independent:.2g}, limit {DEPENDENT:g}). Remove the redundant ones."
        )
    share = norm(X @ unseen)
    which = _large(np.linalg.solve(unit, unseen))
    raise ContactError(
        f"{what}: columns {which} are dependent in the metric (least singular value "
        f"{share:.2g}, limit {max(BLOCKED, BLURRED / independent):.2g}); it cannot move along one "
        "combination of them. Drop a contact, or pass a metric that is definite on N."
    )


def _unit(columns: Array) -> tuple[Array, Array]:
    """Columns of unit length, and the length that each had; one without any stays zero."""
    length = np.linalg.norm(columns, axis=0)
    length[length == 0.0] = 1.0
    return (columns / length, length)


def _large(weights: Array) -> list[int]:
    """Which of them are not next to nothing."""
    size = np.abs(weights)
    return np.flatnonzero(size > 1e-3 * size.max()).tolist()


def _factor(metric: Array, what: str) -> tuple[Array, Array]:
    """sizes (n, 1) and F (n, n) of norm 1 with metric = (sizes F)(sizes F)ᵀ.

    Sizes are those of the largest diagonal element of a kind: linear and angular in six
    dimensions, each its own kind otherwise. Eigenvalues that are rounding errors, of either sign,
    become zero: their roots would be 1e-8.

    Raises:
        ContactError: not symmetric, or a negative eigenvalue.
    """
    diagonal = np.maximum(np.diag(metric), 0.0)
    if len(diagonal) == 6:
        diagonal = np.repeat(diagonal.reshape(2, 3).max(axis=1), 3)
    sizes = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))[:, None]
    scaled = metric / sizes / sizes.T
    skew = np.abs(scaled - scaled.T).max()
    if skew > _ASYMMETRIC:
        raise ContactError(
            f"{what}: the metric is not symmetric (relative difference {skew:.3g}); "
            "inertias and inverse inertias are"
        )
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    if values[0] < -_ASYMMETRIC:
        raise ContactError(
            f"{what}: the scaled metric has smallest eigenvalue {values[0]:.3g}; that of an "
            "inertia or inverse inertia is not negative. Pass a positive semidefinite metric."
        )
    values[values < _NO_MOBILITY * values[-1]] = 0.0
    root = np.sqrt(values[-1]) if values[-1] > 0.0 else 1.0
    return (sizes * root, vectors * np.sqrt(np.maximum(values, 0.0)) / root)
