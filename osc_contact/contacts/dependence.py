"""Which columns of N are independent, and how the others follow from them.

Columns are scaled before any verdict: to unit length, or, where the held object's inverse inertia
Φ is known, to unit √(nᵀΦn), so that the result does not depend on frame, origin or unit of length.
With the factor Φ = LLᵀ the singular values of LᵀN are the roots of the eigenvalues of NᵀΦN, without
the digits that forming NᵀΦN would lose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.spatial import Array, as_array

__all__ = [
    "block_diagonal",
    "independent",
    "reduce",
    "require_consistent",
    "require_independent",
    "require_reciprocal",
    "scaled_columns",
]

#: Smallest singular value of scaled columns; far below any real geometry.
_RANK_TOLERANCE = 1e-10
_PIVOT = 0.3
_RECIPROCAL = 1e-9
_CONSISTENT = 1e-6
#: Rounding error of n_γ when the bodies hardly move (m/s², rad/s²).
_STILL = 1e-9


def scaled_columns(columns: Array, Phi_ref: Array | None, name: str = "N") -> tuple[Array, Array]:
    """Columns (6, k) scaled to unit size, and their sizes (k,).

    Args:
        columns: (6, k). Phi_ref: (6, 6) metric of their size; None: the Euclidean one.
        name: of the matrix, for messages.

    Raises:
        ContactError: a column is zero.
        InvalidInputError: Phi_ref is not symmetric positive definite.
    """
    if Phi_ref is not None:
        columns = _factor(Phi_ref).T @ columns
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not size.all():
        raise ContactError(f"{name}: column {int(size.argmin())} is zero; remove it")
    return columns / size, size


def independent(scaled: Array) -> bool:
    """Whether scaled columns (6, k) are independent."""
    k = scaled.shape[1]
    if k < 2:
        return True
    return k <= 6 and bool(np.linalg.svd(scaled, compute_uv=False)[-1] >= _RANK_TOLERANCE)


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
    scaled, _ = scaled_columns(columns, None, name)
    if independent(scaled):
        return
    singular = np.linalg.svd(scaled)
    weight = np.abs(singular.Vh[-1])
    which = [int(i) for i in np.flatnonzero(weight > 1e-3 * weight.max())]
    raise ContactError(
        f"{name}: columns {which} are dependent (smallest scaled singular value "
        f"{singular.S[-1]:.2g}, limit {_RANK_TOLERANCE:g}); keep an independent subset, the "
        "split of the force among dependent contacts is not unique"
    )


def require_reciprocal(N: Array, T: Array) -> None:
    """Refuse NᵀT ≠ 0, against the size of the summands.

    Raises:
        ContactError: with the columns and the number.
    """
    power = np.abs(N.T @ T)
    excess = power - _RECIPROCAL * (np.abs(N).T @ np.abs(T))
    if (excess > 0.0).any():
        i, j = (int(k) for k in np.unravel_index(excess.argmax(), excess.shape))
        raise ContactError(
            f"NᵀT ≠ 0: column {i} of N does the power {power[i, j]:.3g} on column {j} of T; a "
            "contact force does no work on a permitted motion"
        )


def reduce(scaled: Array, size: Array) -> tuple[list[int], Array]:
    """Columns to keep, and R (rank, k) with columns = columns[:, keep] R; scaled columns (6, k).

    The rank is that of the scaled columns. Kept is the first column whose part outside the span of
    those kept before is not much smaller than the largest one: well-conditioned, and no toss-up
    between columns that are equally good.
    """
    rank = int((np.linalg.svd(scaled, compute_uv=False) >= _RANK_TOLERANCE).sum())
    rest = scaled.copy()
    keep: list[int] = []
    for _ in range(rank):
        length = np.linalg.norm(rest, axis=0)
        length[keep] = 0.0
        first = int((length >= _PIVOT * length.max()).argmax())
        keep.append(first)
        q = rest[:, first] / length[first]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            rest -= np.outer(q, q @ rest)
    keep.sort()
    R = np.linalg.lstsq(scaled[:, keep], scaled, rcond=None)[0]
    R[:, keep] = np.eye(rank)
    return keep, R * size / size[keep][:, None]


def require_consistent(
    n_gamma: Array, keep: list[int], R: Array, size: Array, owners: Sequence[str]
) -> None:
    """Refuse n_γ (k,) that does not follow from its kept part as the columns do, n_γ ≠ Rᵀn_γ,keep.

    Args:
        n_gamma: (k,) of all columns. keep: indices of the kept ones.
        R: (k_kept, k) all columns in terms of the kept ones. size: (k,) of the columns.
        owners: contact of each column.

    Raises:
        ContactError: naming the contacts (`owners`, one per column) that disagree.
    """
    kept = n_gamma[keep]
    violation = np.abs(n_gamma - kept @ R)
    summands = (np.abs(n_gamma) + np.abs(kept) @ np.abs(R)) / size
    bad = int((violation / size).argmax())
    if violation[bad] <= max(_STILL, _CONSISTENT * size[bad] * float(summands.max())):
        return
    part = np.abs(R[:, bad]) * size[keep]
    with_them = [keep[i] for i in np.flatnonzero(part > 1e-3 * part.max())]
    names = ", ".join(dict.fromkeys(owners[i] for i in sorted([bad, *with_them])))
    raise ContactError(
        f"{names}: singular at this instant. Their forces are dependent, but the accelerations "
        f"that keep them are not: column {bad} needs n_γ = {n_gamma[bad]:.6g}, the others imply "
        f"{kept @ R[:, bad]:.6g}. Drop one of these contacts, or move through this pose slower "
        "or with the others released"
    )


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """The blocks along the diagonal of a matrix of zeros."""
    rows, columns = (np.cumsum([0, *(b.shape[i] for b in blocks)]) for i in (0, 1))
    out = np.zeros((rows[-1], columns[-1]))
    for block, i, j in zip(blocks, rows, columns, strict=False):
        out[i : i + block.shape[0], j : j + block.shape[1]] = block
    return out


def _factor(Phi: Array) -> Array:
    """L with Φ = LLᵀ, found in units that make the diagonal 1."""
    Phi = as_array("Phi_ref", Phi, (6, 6))
    root = np.sqrt(np.abs(np.diag(Phi)))
    cross_size = np.outer(root, root)
    trouble = "a diagonal element is not positive"
    if np.diag(Phi).min() > 0.0:
        trouble = "it is not symmetric"
        if (np.abs(Phi - Phi.T) <= 1e-9 * cross_size).all():
            try:
                return root[:, None] * np.linalg.cholesky(Phi / cross_size)
            except np.linalg.LinAlgError as error:
                trouble = str(error)
    raise InvalidInputError(
        f"Phi_ref must be symmetric positive definite: {trouble}; give the inverse inertia (6, 6) "
        "of the held object at O"
    )
