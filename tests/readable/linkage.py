"""Internal forces of three or more grasps as forces in the bars of a virtual linkage.

A bar joins each pair of grasp points, in the order (1, 2), (1, 3), …, (k − 1, k), and carries t,
positive where the arms compress it (Williams and Khatib, "The virtual linkage: a model for internal
forces in multi-grasp manipulation", IEEE ICRA 1993). With e the unit vector from grasp i to grasp
j, arm i adds t e to the force it exerts on the object and arm j −t e: f = E t, a field without
resultant. Back from forces, t = E⁺f; all of it is newtons, so that the least squares in E⁺ weigh no
metre. For two grasps this is ½ eᵀ(f₁ − f₂), the squeeze along the grasp line.

Bars that depend on one another (four grasps in a plane, three in a line) share what E⁺ gives them.
Moments in rigid grasps are internal too, and stay at least effort.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.spatial import Array

__all__ = ["Linkage", "bar_forces", "bars"]


def bars(arms: int) -> int:
    """Number of pairs of grasps."""
    return arms * (arms - 1) // 2


def bar_forces(arms: int, squeeze_d: float | Array) -> Array | None:
    """(bars,) forces wanted in the bars; None: fewer than three arms, or nothing is commanded.

    A number other than 0 is commanded in every bar, an array bar by bar.
    """
    if arms < 3 or (np.ndim(squeeze_d) == 0 and squeeze_d == 0.0):
        return None
    return np.asarray(squeeze_d * np.ones(bars(arms)))


@dataclass(frozen=True)
class Linkage:
    """The bars' forces t = E_t τ − e_t as the motors set them.

    Attributes:
        levers: (bars, n) E⁺J̄ᵀ: force in the bars of joint torques that accelerate nothing.
        basis: (bars, s) orthonormal: combinations of bar forces that can be set at will.
    """

    levers: Array
    basis: Array

    @classmethod
    def of(cls, state: ChainState, chain: ClosedChain) -> Linkage:
        """At this instant.

        Left out of `basis` are dependent bars, forces that the arms' structure carries whatever
        the motors do (Cᵀ), and forces that no torques in null(G) make: what hinges and balls do
        not pass on, or passive joints do not resist. Ranks are decided by `rank_tolerance`.
        """
        tolerance, k = chain.rank_tolerance, len(chain.arms)
        field = np.zeros((3 * k, bars(k)))
        for bar, (i, j) in enumerate(combinations(range(k), 2)):
            line = state.grasp_points[j] - state.grasp_points[i]
            length = float(np.linalg.norm(line))
            if length >= 1e-9:
                field[3 * i : 3 * i + 3, bar] = line / length
                field[3 * j : 3 * j + 3, bar] = -line / length
        share = np.linalg.pinv(field, rcond=tolerance)
        levers = np.zeros((bars(k), chain.nq))
        carried = [np.zeros((bars(k), 0))]
        root_mass = np.sqrt(chain.reference.inertia.mass)  # C is white: metres stay metres
        for i, (s, arm) in enumerate(zip(chain.slices, state.arms, strict=True)):
            own = share[:, 3 * i : 3 * i + 3]
            levers[:, s] = own @ arm.J_bar[:, :3].T
            carried.append(own @ arm.C[:3] / root_mass)
        basis = _column_space(field.T, tolerance)
        basis = basis @ _null_space(np.hstack(carried).T @ basis, tolerance, 1.0)
        effort = np.where(np.isfinite(chain.tau_max), chain.tau_max, 1.0)
        quiet = _null_space(state.G * effort, 1e-9)
        made = basis.T @ (levers[:, chain.actuated] * effort)
        U, size, Vh = np.linalg.svd(made, full_matrices=False)
        some = size > 1e-9 * size.max(initial=0.0)
        # by the angle to null(G): an arm near a singular posture makes some forces all too easily
        apart = _column_space(Vh[some] @ quiet, tolerance, 1.0)
        basis = basis @ np.linalg.qr((U[:, some] * size[some]) @ apart)[0]
        return cls(levers, np.eye(bars(k)) if basis.shape[1] == bars(k) else basis)

    def rows(self, state: ChainState, chain: ClosedChain, eta_dot: Array) -> tuple[Array, Array]:
        """(E_t, e_t): (bars, n_a) and (bars,), at the acceleration η̇ (d,)."""
        qdd = state.W @ eta_dot + state.w
        return self.levers[:, chain.actuated], self.levers @ (state.h + state.M @ qdd)

    def response(self, state: ChainState, chain: ClosedChain) -> tuple[Array, Array]:
        """(E, c) with δt = E δτ − c δη̇ in what can be set: (bars, n_a), (bars, d)."""
        levers = self.basis @ (self.basis.T @ self.levers)
        return levers[:, chain.actuated], levers @ state.M @ state.W


def _column_space(A: Array, tolerance: float, size: float | None = None) -> Array:
    """Orthonormal columns that span A's, as far as singular values exceed tolerance · size."""
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    whole = s.max(initial=0.0) if size is None else size
    return np.asarray(U[:, s > tolerance * whole])


def _null_space(A: Array, tolerance: float, size: float | None = None) -> Array:
    """Orthonormal columns that A takes to zero, as far as such singular values are."""
    _, s, Vh = np.linalg.svd(A, full_matrices=True)
    whole = s.max(initial=0.0) if size is None else size
    return np.asarray(Vh[np.count_nonzero(s > tolerance * whole) :].T)
