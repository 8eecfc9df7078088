"""Motor torques for a wanted object force and a wanted squeeze: what to do with null(G)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from osc_contact.control.joint_limits import JointLimitAvoidance
from osc_contact.dynamics.chain_state import ArmTerms
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.dynamics.motors import effort_scale
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.spatial import Array
from readable.linkage import Linkage, bar_forces

__all__ = ["Allocation", "squeeze_response", "squeeze_rows"]


def squeeze_rows(state: ChainState, chain: ClosedChain, eta_dot: Array) -> tuple[Array, Array]:
    """(E, e0) with squeeze = E τ − e0, the internal force along the grasp line.

    Squeeze = ½ eᵀ(λ₁ − λ₂) with λ_i the wrench arm i exerts on the object and e the unit
    translation from grasp 1 to grasp 2: positive compresses. eᵀλ_i is the same for every
    generalised inverse, because e lies in range(J_i).

    Returns:
        E (1, n_a) and e0 (1,) for two arms, empty (0, n_a) and (0,) otherwise.
    """
    n_a = chain.n_a
    if len(chain.arms) != 2:
        return np.zeros((0, n_a)), np.zeros(0)
    e = _grasp_line(state)
    if not e.any():
        return np.zeros((0, n_a)), np.zeros(0)
    qdd = state.W @ eta_dot + state.w
    E = np.zeros(chain.nq)
    offset = 0.0
    for sign, s, arm in zip((0.5, -0.5), chain.slices, state.arms, strict=True):
        lever = sign * (arm.J_bar @ e)
        E[s] = lever
        offset += lever @ (state.h[s] + arm.M @ qdd[s])
    return E[None, chain.actuated], np.array([offset])


def squeeze_response(
    state: ChainState, chain: ClosedChain, squeeze_d: float | Array = 0.0
) -> tuple[Array, Array]:
    """(E, c) with δsqueeze = E δτ − c δη̇: (s, n_a) as in `squeeze_rows`, (s, d).

    With three arms or more: of the bars of the virtual linkage, if `squeeze_d` commands them.
    """
    if bar_forces(len(chain.arms), squeeze_d) is not None:
        return Linkage.of(state, chain).response(state, chain)
    E, _ = squeeze_rows(state, chain, np.zeros(state.d))
    lever = np.zeros((len(E), chain.nq))
    if len(E):
        e = _grasp_line(state)
        for sign, s, arm in zip((0.5, -0.5), chain.slices, state.arms, strict=True):
            lever[0, s] = sign * (arm.J_bar @ e)
    return E, lever @ state.M @ state.W


def _grasp_line(state: ChainState) -> Array:
    """(6,) unit translation from the first grasp to the second; zero if they coincide."""
    line = state.grasp_points[1] - state.grasp_points[0]
    length = float(np.linalg.norm(line))
    return np.concatenate((line / length, np.zeros(3))) if length >= 1e-9 else np.zeros(6)


def own_motions(arm: ArmTerms) -> Array:
    """(n − rank, n) accelerations of an arm's joints that leave the object alone, as rows."""
    return _modes(arm)[:, arm.rank :].T


def _moving(arm: ArmTerms) -> Array:
    """(n, rank) those that move it."""
    return _modes(arm)[:, : arm.rank]


def _modes(arm: ArmTerms) -> Array:
    """(n, n) K⁻ᵀV: orthonormal in M, those that move the object first."""
    K = np.linalg.cholesky(arm.M)
    _, _, Vh = np.linalg.svd((K.T @ arm.J_bar).T)
    return np.linalg.solve(K.T, Vh.T)


def _push(limits: JointLimitAvoidance, q: Array) -> Array:
    """(n,) acceleration away from joint limits at q (n,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(q < limits.low, limits.low - q, np.maximum(q - limits.high, 0.0))
        s = np.where(depth > 0.0, np.minimum(depth / limits.width, 1.0), 0.0)
    return np.asarray(np.where(q < limits.low, 1.0, -1.0) * limits.most * s * s * (3.0 - 2.0 * s))


@dataclass(frozen=True)
class Allocation:
    """Least torque, weighted by 1/τ_max², that gives G τ = f_S and the commanded squeeze.

    With three arms or more that is the forces in the bars of a virtual linkage (`Linkage`), as many
    combinations of them as can be set; a squeeze of 0 leaves them at least effort.

    Arms with more joints than they need use only torques Jᵀφ for the task; the rest holds their
    posture in the dynamically consistent null space, (1 − JᵀJ̄ᵀ)τ₀ with
    τ₀ = h + M (−k_d q̇ + k_p (q₀ − q)) + diag(M) a_l(q), a_l the push away from joint limits. This
    one acts on each joint by its own inertia, so that no other joint's push turns it around.

    Attributes:
        chain: structure and torque limits.
        posture: (n,) joint positions that redundant arms return to.
        stiffness, damping: 1/s², 1/s of that posture task. retreat_damping: 1/s, instead of
            damping, of joint motions that a singular posture takes from the task.
        limit_stiffness: 1/s², of the push away from joint limits; 0: none. limit_margin: where it
            begins, as a share of the joint's range (see `JointLimitAvoidance`).
    """

    chain: ClosedChain
    posture: Array
    stiffness: float = 25.0
    damping: float = 10.0
    retreat_damping: float = 50.0
    limit_stiffness: float = 400.0
    limit_margin: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 < self.limit_margin < 0.5 or not 0.0 <= self.limit_stiffness < np.inf:
            raise InvalidInputError(
                f"limit_margin {self.limit_margin}, limit_stiffness {self.limit_stiffness} 1/s²: "
                "expected a share of the joint's range below 0.5, and a finite number ≥ 0"
            )
        for arm, grasp in zip(self.chain.arms, self.chain.grasps, strict=True):
            if arm.model.nv > grasp.N.shape[1] and arm.passive_joints:
                raise ModelError(
                    f"arm '{arm.name}' has {arm.model.nv} joints, {len(arm.passive_joints)} of "
                    f"them passive, to move the object in {grasp.N.shape[1]} ways: posture torques "
                    "for redundant arms need a motor in every joint"
                )

    def torques(
        self,
        state: ChainState,
        q: Array,
        v: Array,
        f_S: Array,
        eta_dot: Array,
        squeeze_d: float | Array,
    ) -> Array:
        """Motor torques (n_a,), not yet limited.

        Args:
            state: of the chain. q, v: (n,) measured.
            f_S: (d,) wanted object force. eta_dot: (d,) acceleration it will cause.
            squeeze_d: wanted squeeze (N), see `Reference`.
        """
        E, side = self._internal(state, eta_dot, squeeze_d)
        free, still = self._own_motions(state, q, v)
        A = np.vstack((state.G, E, free))
        b = np.concatenate((f_S, side, still))
        rest = self._posture_torques(state, q, v)
        R_inv = self._inverse_weight(state)
        # scaled rows: force and couple rows of A differ in units
        AR = A @ R_inv
        gram = AR @ A.T
        scale = 1.0 / np.sqrt(np.diag(gram))
        gram = gram * np.outer(scale, scale)
        multipliers = np.linalg.solve(gram, scale * (b - A @ rest))
        return np.asarray(rest + AR.T @ (scale * multipliers))

    def _internal(
        self, state: ChainState, eta_dot: Array, squeeze_d: float | Array
    ) -> tuple[Array, Array]:
        """Rows (s, n_a) and right sides (s,) that give the internal forces commanded."""
        wanted = bar_forces(len(self.chain.arms), squeeze_d)
        if wanted is None:
            E, e0 = squeeze_rows(state, self.chain, eta_dot)
            return E, squeeze_d * np.ones(len(e0)) + e0
        linkage = Linkage.of(state, self.chain)
        E, e0 = linkage.rows(state, self.chain, eta_dot)
        return linkage.basis.T @ E, linkage.basis.T @ (wanted + e0)

    def _inverse_weight(self, state: ChainState) -> Array:
        """R⁻¹ (n_a, n_a): τ_max² where every torque is needed, Jᵀ(JRJᵀ)⁻¹J in redundant arms."""
        chain = self.chain
        full = np.zeros((chain.nq, chain.nq))
        limits = np.ones(chain.nq)
        limits[chain.actuated] = effort_scale(chain.tau_max)
        for s, arm, spare in zip(chain.slices, state.arms, self._spare, strict=True):
            square = np.diag(limits[s] ** 2)
            if spare:
                J = arm.N.T @ arm.J
                if arm.rank < arm.N.shape[1]:  # the rest of J would be rounding errors
                    J = (arm.M @ _moving(arm)).T
                square = J.T @ np.linalg.solve((J / limits[s] ** 2) @ J.T, J)
            full[s, s] = square
        return full[np.ix_(chain.actuated, chain.actuated)]

    @property
    def _spare(self) -> list[bool]:
        """Which arms have more joints than their grasps pass on wrenches."""
        held = zip(self.chain.arms, self.chain.grasps, strict=True)
        return [arm.model.nv > grasp.N.shape[1] for arm, grasp in held]

    @cached_property
    def limits(self) -> JointLimitAvoidance:
        """What pushes redundant arms away from joint limits."""
        return JointLimitAvoidance.of(self.chain.model, self.limit_stiffness, self.limit_margin)

    def retreat(self, q: Array, v: Array) -> Array:
        """q̈ (n,) = −k_r q̇ + k_p (q₀ − q) in motions that a singular posture takes from the task."""
        return self.stiffness * (self.posture - q) - self.retreat_damping * v

    def _own_motions(self, state: ChainState, q: Array, v: Array) -> tuple[Array, Array]:
        """Rows (k, n_a) and right sides (k,) that keep the posture in motions which arms without
        joints to spare have of their own: idle ones, and those of a singular posture."""
        chain, rows, sides = self.chain, [], []
        want = state.h + state.M @ self.retreat(q, v)
        for s, arm, spare in zip(chain.slices, state.arms, self._spare, strict=True):
            n = arm.J.shape[1]
            if arm.rank < n and not spare:
                row = np.zeros((n - arm.rank, chain.nq))
                row[:, s] = own_motions(arm)
                rows.append(row[:, chain.actuated])
                sides.append(row @ want)
        if not rows:
            return np.zeros((0, chain.n_a)), np.zeros(0)
        return np.vstack(rows), np.concatenate(sides)

    def _posture_torques(self, state: ChainState, q: Array, v: Array) -> Array:
        chain = self.chain
        full, push = np.zeros(chain.nq), _push(self.limits, q)
        for i, (s, arm) in enumerate(zip(chain.slices, state.arms, strict=True)):
            if self._spare[i]:
                pull = self.stiffness * (self.posture[s] - q[s]) - self.damping * v[s]
                tau_0 = state.h[s] + arm.M @ pull + np.diag(arm.M) * push[s]
                full[s] = tau_0 - arm.J.T @ (arm.J_bar.T @ tau_0)
                back = state.h[s] + arm.M @ self.retreat(q, v)[s]
                for lost in (one for one in state.singular_directions if one.arm == i):
                    more = back - tau_0 if lost.locked else (1.0 - lost.share) * back
                    full[s] += (lost.mode @ more) * (arm.M @ lost.mode)
        return full[chain.actuated]
