"""State of contact with N, T and n_γ, at the operational point in world axes (paper, section 3)."""

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
    """State of contact between the held object and its environment.

    range(N) = N ⊆ F⁶ consists of all forces that the contact can transmit, range(T) = T ⊆ M⁶ of all
    motions that it permits, NᵀT = 0 (paper, section 3). The columns of N are wrenches that push
    *into* the environment, so that a pressed contact has α > 0; they need be neither unit vectors
    nor orthogonal.

    Attributes:
        N: (6, r) basis of the contact normal space (N, N m per unit of α).
        T: (6, 6−r) basis of the tangent space (m/s, rad/s).
        n_gamma: (r,) normal acceleration Nᵀa_rel = −ṄᵀV_rel that maintains the contact (m/s²).
        R: (r, r_all) coordinates of all stacked columns in N, N_all = N R; the identity unless
            `stack` has left dependent columns out of N.
        name: name for messages.

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
        """Make a contact from any basis N (6, r) of the contact forces, 0 ≤ r ≤ 6.

        Args:
            N: (6, r) basis of the contact forces at O, world axes.
            n_gamma: (r,) normal acceleration (m/s²); None: zero.
            T: (6, 6−r) basis of the permitted motions; None: it is computed from N.
            name: name for messages.

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
        """Make a contact that permits exactly the motions range(T), with N computed from T.

        The basis N of the forces is arbitrary, so `n_gamma` can be given only if it is zero or
        belongs to the N that this function returns. In motion, give `T_dot_beta` = Ṫβ with
        V_rel = Tβ, the relative spatial acceleration of the bodies at constant β: then
        n_γ = Nᵀ Ṫβ. For an axis tⱼ that is fixed to a body of twist V, ṫⱼ = V × tⱼ
        (`spatial.cross_twist`).

        Args:
            T: (6, 6−r) permitted motions, at O in world axes (m/s, rad/s).
            n_gamma: (r,) normal acceleration for the N of the result (m/s²).
            T_dot_beta: (6,) spatial acceleration Ṫβ (m/s², rad/s²), in place of n_gamma.

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
        """Make a contact from a frame and a selection of its axes (Raibert and Craig).

        The columns of N are the selected forces, then the couples.

        Args:
            frame: pose of the selection's axes, world axes, translation from O (m).
            forces, couples: (3,) True for axes along or about which the contact transmits.
        """
        return cls(selection_columns(frame, forces, couples))

    @classmethod
    def stack(cls, contacts: Sequence[Contact], Phi_ref: Array | None = None) -> Contact:
        """Join several contacts to one, with all their columns of N and elements of n_γ.

        Dependent contacts (a table on four legs) are reduced to a subset of independent columns.
        `R` gives all columns, N_all = N R; `magnitudes` distributes a force among
        them.

        Args:
            contacts: contacts with r_all columns together.
            Phi_ref: (6, 6) inverse inertia of the held object at O, for a decision of the rank by
                NᵀΦ_ref N scaled to unit diagonal, independent of frame, origin and unit. None:
                by columns scaled to unit length in N and N m about O.

        Raises:
            ContactError: the columns are dependent but n_γ is not, n_γ,all ≠ Rᵀn_γ: the contacts
                are singular at this instant (no acceleration maintains all of them).
            InvalidInputError: Phi_ref is not symmetric positive definite.
        """
        if not contacts:
            return cls(np.zeros((6, 0)))
        N = np.hstack([c.N for c in contacts])
        n_gamma = np.concatenate([c.n_gamma for c in contacts])
        # with Φ = L Lᵀ, lengths of the columns of LᵀN are √(nᵀΦn), independent of frame and unit
        metric_columns = N if Phi_ref is None else _scaled_cholesky(Phi_ref).T @ N
        unit_columns, size = projections.scaled_columns(metric_columns)
        R = None
        if not projections.independent(unit_columns):
            keep, R = select_columns(unit_columns, size)
            owners = [c.name or f"contact {i}" for i, c in enumerate(contacts) for _ in range(c.r)]
            require_consistent(n_gamma, keep, R, size, owners)
            N = N[:, keep]
            n_gamma = n_gamma[keep]
        # contacts that were stacked before have coordinates R of their own
        if not all(c.split_is_unique for c in contacts):
            R_of_contacts = block_diagonal([c.R for c in contacts])
            R = R_of_contacts if R is None else R @ R_of_contacts
        return cls.judged(N, n_gamma, R)  # independence was decided above, with Phi_ref

    @classmethod
    def judged(cls, N: Array, n_gamma: Array, R: Array | None = None) -> Contact:
        """Make a contact of columns that are known to be independent, without checks.

        Args:
            N: (6, r) independent columns.
            n_gamma: (r,) normal acceleration (m/s²).
            R: (r, r_all) coordinates of all stacked columns in N; None: the identity.
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
        """Basis (6, 6−r) of the permitted motions, NᵀT = 0."""
        return projections.null_space(self.N)

    @cached_property
    def R(self) -> Array:
        """Coordinates (r, r_all) of all stacked columns in the independent ones, N_all = N R."""
        return np.eye(self.r)

    @property
    def split_is_unique(self) -> bool:
        """True if a force in N has a unique distribution among the stacked contacts, r_all = r."""
        return self.R.shape[1] == self.r

    def magnitudes(self, alpha: npt.ArrayLike) -> Array:
        """Distribute the force N α among stacked contacts: magnitudes (r_all,), N_all m = N α.

        If `split_is_unique` is false, this is the distribution with the smallest sum of squared
        magnitudes (N; a couple of 1 N m counts as 1 N), *one* of many: it is not a measurement, and
        magnitudes may be negative. The inverse: commanded magnitudes (r_all,) give α = R times
        them.

        Args:
            alpha: (r,) magnitudes of the columns of N (N, N m).
        """
        given_alpha = as_array("alpha", alpha, (self.r,))
        # pseudo-inverse of R, which has full row rank; the squares of magnitudes may be summed
        return self.R.T @ np.linalg.solve(self.R @ self.R.T, given_alpha)

    def as_raibert_craig(
        self, size: float = 1.0, tolerance: float = 1e-9, centre: npt.ArrayLike | None = None
    ) -> RaibertCraig:
        """Find the constraint frame and selection that describe this contact, or the nearest ones.

        See `contacts.raibert_craig.as_raibert_craig`.

        Args:
            size: length of the held object, by which the residual compares moments with forces (m).
            tolerance: largest residual of a frame that describes the contact.
            centre: (3,) point about which the residual takes moments, from O (m); None: O.
        """
        return as_raibert_craig(self.N, size, tolerance, centre)

    def force_projection(self, A_inv: Array) -> Array:
        """Projection Ω_f(A) (6, 6), eq. 5, for the inverse inertia A⁻¹ (6, 6)."""
        return projections.Omega_f(self.N, A_inv)

    def motion_projection(self, B: Array) -> Array:
        """Projection Ω_m(B) = 1 − Ω̄_m(B) (6, 6), eqs. 4 and 7, for the mobility B (6, 6)."""
        return np.eye(6) - projections.Omega_m_bar(self.N, B)

    def __repr__(self) -> str:
        """Class and number of independent forces."""
        return f"Contact(r={self.r})"


# Selection of independent columns of N, and coordinates of the others in them.
#
# Columns are scaled before their rank is decided: to unit length or, if the held object's inverse
# inertia Φ is known, to unit √(nᵀΦn), so that the result does not depend on frame, origin or unit
# of length. With the factor Φ = LLᵀ the singular values of LᵀN are the roots of the eigenvalues
# of NᵀΦN; forming NᵀΦN would lose half of their digits.


_PIVOT = 0.3  #: least length of a pivot column's independent part, relative to the largest one
_MOST_RELATIVE_POWER = 1e-9  #: largest power NᵀT, relative to the sum of its absolute summands
#: Largest difference of n_γ from its value by dependent columns, relative to its summands.
_MOST_DIFFERENCE = 1e-6
#: Rounding error of n_γ of bodies that hardly move (m/s², rad/s²).
_ROUNDING_OF_N_GAMMA = 1e-9


def require_reciprocal(N: Array, T: Array) -> None:
    """Refuse NᵀT ≠ 0, relative to the absolute summands.

    Args:
        N: (6, r) contact forces.
        T: (6, 6−r) permitted motions.

    Raises:
        ContactError: the message names the columns and their power.
    """
    power = np.abs(N.T @ T)
    excess = power - _MOST_RELATIVE_POWER * (np.abs(N).T @ np.abs(T))
    if (excess > 0.0).any():
        i, j = (int(k) for k in np.unravel_index(excess.argmax(), excess.shape))
        raise ContactError(
            f"NᵀT ≠ 0: column {i} of N does the power {power[i, j]:.3g} on column {j} of T; a "
            "contact force does no work on a permitted motion"
        )


def select_columns(unit_columns: Array, size: Array) -> tuple[list[int], Array]:
    """Select independent columns, and compute the coordinates of all columns in these.

    Columns are selected one after the other. The next one is the first whose part outside the span
    of those selected so far is at least `_PIVOT` times the largest such part. The selection is
    therefore well-conditioned, and rounding does not change it if several columns are equally
    suitable.

    Args:
        unit_columns: (6, k) columns N_all, each divided by its length.
        size: (k,) lengths of the columns.

    Returns:
        Indices of the selected columns in ascending order, as many as the rank of `unit_columns`,
        and R (rank, k) with N_all = N_all[:, indices] R.
    """
    singular_values = np.linalg.svd(unit_columns, compute_uv=False)
    rank = int((singular_values >= projections.INDEPENDENT).sum())
    remainder = unit_columns.copy()  # parts of the columns outside the span of the selected ones
    keep: list[int] = []
    for _ in range(rank):
        length = np.linalg.norm(remainder, axis=0)
        length[keep] = 0.0
        pivot = int((length >= _PIVOT * length.max()).argmax())
        keep.append(pivot)
        q = remainder[:, pivot] / length[pivot]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            remainder -= np.outer(q, q @ remainder)
    keep.sort()
    R = np.linalg.lstsq(unit_columns[:, keep], unit_columns, rcond=None)[0]
    R[:, keep] = np.eye(rank)  # exact, in place of rounding errors
    return (keep, R * size / size[keep][:, None])  # for the columns with their own lengths


def require_consistent(
    n_gamma: Array, keep: list[int], R: Array, size: Array, owners: Sequence[str]
) -> None:
    """Refuse n_γ of dependent columns that contradicts that of the independent ones, n_γ ≠ Rᵀn_γ.

    Args:
        n_gamma: (k,) normal acceleration of all columns (m/s²).
        keep: indices of the independent columns.
        R: (rank, k) coordinates of all columns in the independent ones.
        size: (k,) lengths of the columns.
        owners: name of the contact of each column.

    Raises:
        ContactError: the message names the contacts that disagree.
    """
    # error of each column, compared with rounding errors: a share of the summands, both per length
    independent = n_gamma[keep]
    violation = np.abs(n_gamma - independent @ R)
    summands = (np.abs(n_gamma) + np.abs(independent) @ np.abs(R)) / size
    worst_column = int((violation / size).argmax())
    if violation[worst_column] <= max(
        _ROUNDING_OF_N_GAMMA, _MOST_DIFFERENCE * size[worst_column] * float(summands.max())
    ):
        return

    # the worst column disagrees with the contacts of the columns of which it consists
    share = np.abs(R[:, worst_column]) * size[keep]
    partners = [keep[i] for i in np.flatnonzero(share > 1e-3 * share.max())]
    names = ", ".join(dict.fromkeys(owners[i] for i in sorted([worst_column, *partners])))
    raise ContactError(
        f"{names}: singular at this instant. Their forces are dependent, but the accelerations "
        f"that keep them are not: column {worst_column} needs n_γ = {n_gamma[worst_column]:.6g}, "
        f"the others imply {independent @ R[:, worst_column]:.6g}. Drop one of these contacts, or "
        "move through this pose slower or with the others released"
    )


def _scaled_cholesky(Phi: Array) -> Array:
    """Compute the Cholesky factor L (6, 6) of Φ = LLᵀ after scaling Φ to unit diagonal.

    Args:
        Phi: (6, 6) inverse inertia of the held object at O, the argument Phi_ref of `stack`.

    Raises:
        InvalidInputError: Φ is not symmetric positive definite.
    """
    array = as_array("Phi_ref", Phi, (6, 6))
    expected = "the inverse inertia (6, 6) of the held object at O"
    unit_diagonal_Phi, size = projections.unit_diagonal(
        array, "Phi_ref", expected, InvalidInputError
    )
    return size[:, None] * np.linalg.cholesky(unit_diagonal_Phi)
