"""One state of contact: N, T and n_γ, at the operational point in world axes (paper, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact import projections
from osc_contact.contacts.raibert_craig import RaibertCraig, as_raibert_craig, selection_columns
from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.spatial import Array, as_array, block_diagonal


class Contact:
    """A state of contact between the held object and its environment.

    range(N) = N ⊆ F⁶ holds every force the contact can transmit, range(T) = T ⊆ M⁶ every motion
    it permits, NᵀT = 0 (paper, section 3). The columns of N are wrenches pushed *into* the
    environment, so that a pressed contact has α > 0; they need be neither unit nor orthogonal.

    Attributes:
        N: (6, r) basis of the contact normal space (N, N m per unit magnitude).
        T: (6, 6−r) basis of the tangent space (m/s, rad/s).
        n_gamma: (r,) the normal acceleration Nᵀa_rel = −ṄᵀV_rel that keeps the contact (m/s²).
        R: (r, r_all) gives every stacked column, N_all = N R; the identity unless `stack` had to
            leave dependent ones out of N.
        name: used in messages.

    Example:
        >>> press = osc.Contact(np.eye(6)[:, [2]])  # forces along z, at O
        >>> print(press.r, press.T.shape)
        1 (6, 5)
    """

    def __init__(
        self,
        N: npt.ArrayLike,
        n_gamma: npt.ArrayLike | None = None,
        *,
        T: npt.ArrayLike | None = None,
        name: str = "",
    ) -> None:
        """Take any basis N (6, r) of the contact forces, 0 ≤ r ≤ 6.

        Args:
            N: (6, r).
            n_gamma: (r,), default 0.
            T: (6, 6−r) a basis of the permitted motions if it is known already.
            name: used in messages.

        Raises:
            InvalidInputError: wrong shapes or non-finite numbers.
            ContactError: dependent or zero columns, or NᵀT ≠ 0.
        """
        self.N = as_array("N", N, (6, None))
        self.n_gamma = (
            np.zeros(self.r) if n_gamma is None else as_array("n_gamma", n_gamma, (self.r,))
        )
        self.name = name
        projections.require_independent(self.N, "N")
        if T is not None:
            tangents = as_array("T", T, (6, 6 - self.r))
            projections.require_independent(tangents, "T")
            require_reciprocal(self.N, tangents)
            self.__dict__["T"] = tangents

    @classmethod
    def from_tangents(
        cls,
        T: npt.ArrayLike,
        n_gamma: npt.ArrayLike | None = None,
        *,
        T_dot_beta: npt.ArrayLike | None = None,
    ) -> Contact:
        """The contact that permits exactly the motions range(T), T (6, 6−r); N follows.

        Any basis N of the forces may be chosen here, so an `n_gamma` (r,) given
        beforehand can only be right if it is zero or if N was looked up first. In motion, pass
        the velocity product instead: `T_dot_beta` (6,) = Ṫβ with V_rel = Tβ, the spatial
        acceleration the bodies have relative to one another at constant β. Then
        n_γ = Nᵀ Ṫβ for the N chosen here. For an axis tⱼ carried by a body of twist V:
        ṫⱼ = V × tⱼ (`spatial.cross_twist`).

        Args:
            T: (6, 6−r) motions permitted, at O in world axes.
            n_gamma: (r,) acceleration terms, for the N chosen here.
            T_dot_beta: (6,) spatial acceleration Ṫβ, instead of n_gamma.

        Raises:
            InvalidInputError: wrong shapes, or both n_gamma and T_dot_beta given.
            ContactError: dependent or zero columns.
        """
        tangents = as_array("T", T, (6, None))
        projections.require_independent(tangents, "T")
        N = projections.null_space(tangents)
        if T_dot_beta is not None:
            if n_gamma is not None:
                raise InvalidInputError("give n_gamma or T_dot_beta, n_gamma = Nᵀ T_dot_beta")
            n_gamma = N.T @ as_array("T_dot_beta", T_dot_beta, (6,))
        contact = cls(N, n_gamma)
        contact.__dict__["T"] = tangents
        return contact

    @classmethod
    def from_selection(
        cls, frame: pin.SE3, forces: Sequence[bool], couples: Sequence[bool]
    ) -> Contact:
        """A Raibert–Craig task: which forces along and couples about the axes of `frame` (given at
        O, world axes) are transmitted. Columns: the forces selected, then the couples.

        Args:
            frame: X_WF of the selection's axes, its origin included (m).
            forces, couples: (3,) True where the contact transmits along or about an axis.
        """
        return cls(selection_columns(frame, forces, couples))

    @classmethod
    def stack(cls, contacts: Sequence[Contact], Phi_ref: Array | None = None) -> Contact:
        """Several contacts at once: their N side by side, their n_γ one below the other.

        Dependent contacts (a table on four legs) are reduced to independent columns, a subset of
        the given ones. `R` leads back, N_all = N R; `magnitudes` splits a force among all of them.

        Args:
            contacts: any number of them, r_all columns together.
            Phi_ref: (6, 6) the held object's inverse inertia at O. The rank is then decided on
                NᵀΦ_ref N scaled to unit diagonal, independent of frame, origin and unit. Default:
                columns scaled to unit length in N and N m about O.

        Raises:
            ContactError: the geometry is dependent but n_γ is not, n_γ,all ≠ Rᵀn_γ: the contacts
                are singular at this instant (no acceleration keeps them all).
            InvalidInputError: Phi_ref is not symmetric positive definite.
        """
        if not contacts:
            return cls(np.zeros((6, 0)))
        N = np.hstack([c.N for c in contacts])
        n_gamma = np.concatenate([c.n_gamma for c in contacts])
        weighed = N if Phi_ref is None else _factor(Phi_ref).T @ N
        scaled, size = projections.scaled_columns(weighed)
        R = None
        if not projections.independent(scaled):
            keep, R = reduce(scaled, size)
            owners = [c.name or f"contact {i}" for i, c in enumerate(contacts) for _ in range(c.r)]
            require_consistent(n_gamma, keep, R, size, owners)
            N = N[:, keep]
            n_gamma = n_gamma[keep]
        if not all(c.split_is_unique for c in contacts):
            inner = block_diagonal([c.R for c in contacts])
            R = inner if R is None else R @ inner
        return cls.judged(N, n_gamma, R)  # above, with Phi_ref

    @classmethod
    def judged(cls, N: Array, n_gamma: Array, R: Array | None = None) -> Contact:
        """A contact whose columns are known to be independent.

        Args:
            N: (6, r). n_gamma: (r,). R: (r, r_all) all columns from these; None: there are no more.
        """
        contact = cls.__new__(cls)
        contact.N = N
        contact.n_gamma = n_gamma
        contact.name = ""
        if R is not None:
            contact.__dict__["R"] = R
        return contact

    @property
    def r(self) -> int:
        """Degree of motion constraint, 0 … 6."""
        return int(self.N.shape[1])

    @cached_property
    def T(self) -> Array:
        """(6, 6−r) a basis of the permitted motions, NᵀT = 0."""
        return projections.null_space(self.N)

    @cached_property
    def R(self) -> Array:
        """(r, r_all) every stacked column from the independent ones, N_all = N R."""
        return np.eye(self.r)

    @property
    def split_is_unique(self) -> bool:
        """Whether a force in N has only one split among the contacts stacked (r_all = r)."""
        return self.R.shape[1] == self.r

    def magnitudes(self, alpha: npt.ArrayLike) -> Array:
        """A split (r_all,) of the force N α among all contacts stacked: N_all magnitudes = N α.

        Where `split_is_unique` is false this is *one* of many, the one with the smallest sum of
        squared magnitudes (N; a couple of 1 N m counts as 1 N). It is no measurement, and nothing
        keeps it positive. The other way round, magnitudes commanded one by one make α = R times
        them.
        """
        split = as_array("alpha", alpha, (self.r,))
        # by the pseudo-inverse of R: R has full row rank, and magnitudes have a norm
        return self.R.T @ np.linalg.solve(self.R @ self.R.T, split)

    def as_raibert_craig(
        self, size: float = 1.0, tolerance: float = 1e-9, centre: npt.ArrayLike | None = None
    ) -> RaibertCraig:
        """The constraint frame and selection that describe this contact, or why there is none.

        `size` (m) and `centre` (3,) of the held object serve the residual only; see
        `contacts.raibert_craig.as_raibert_craig`.

        Args:
            size: of the held object (m). tolerance: largest residual that counts as none.
            centre: (3,) point of the object about which moments are taken, from O (m); None: O.
        """
        return as_raibert_craig(self.N, size, tolerance, centre)

    def force_projection(self, A_inv: Array) -> Array:
        """Ω_f(A), eq. 5, given A⁻¹ (6, 6)."""
        return projections.Omega_f(self.N, A_inv)

    def motion_projection(self, B: Array) -> Array:
        """Ω_m(B) = 1 − Ω̄_m(B), eqs. 4 and 7, given B (6, 6)."""
        return np.eye(6) - projections.Omega_m_bar(self.N, B)

    def __repr__(self) -> str:
        return f"Contact(r={self.r})"


# Which columns of N are independent, and how the others follow from them.
#
# Columns are scaled before any verdict: to unit length, or, where the held object's inverse
# inertia Φ is known, to unit √(nᵀΦn), so that the result does not depend on frame, origin or unit
# of length. With the factor Φ = LLᵀ the singular values of LᵀN are the roots of the eigenvalues
# of NᵀΦN, without the digits that forming NᵀΦN would lose.


_PIVOT = 0.3
_RECIPROCAL = 1e-9
_CONSISTENT = 1e-6
#: Rounding error of n_γ when the bodies hardly move (m/s², rad/s²).
_STILL = 1e-9


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
    rank = int((np.linalg.svd(scaled, compute_uv=False) >= projections.INDEPENDENT).sum())
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
    return (keep, R * size / size[keep][:, None])


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


def _factor(Phi: Array) -> Array:
    """L with Φ = LLᵀ, found in units that make the diagonal 1."""
    given = as_array("Phi_ref", Phi, (6, 6))
    cure = "the inverse inertia (6, 6) of the held object at O"
    scaled, size = projections.unit_diagonal(given, "Phi_ref", cure, InvalidInputError)
    return size[:, None] * np.linalg.cholesky(scaled)
