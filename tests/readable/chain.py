"""The closed chain in NumPy: every term of `ClosedChain.state` without the law.

Singular values decide ranks, Pinocchio gives M, h, J and placements. `state` is what
`osc_contact.law.chain` is held to.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.chain_state import ArmTerms, ChainState, SingularDirection
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.outboard import columns_at
from osc_contact.dynamics.payload import ObjectTerms
from osc_contact.spatial import Array, cross_twist
from readable.drift import drift
from readable.wrists import grasp_filter, outboard_terms

__all__ = ["NONE_LEFT", "FULL", "arm_terms", "mobility", "share_left", "state"]

#: Commands begin to fade where χ falls below FULL and are gone at NONE_LEFT.
NONE_LEFT, FULL = 0.05, 0.3
GYRATION = 0.1  #: m, of the ball
_NOTHING = ObjectTerms(np.zeros((6, 6)), np.zeros(6), np.zeros(6))


def state(
    chain: ClosedChain,
    q: Array,
    v: Array,
    X_WO: pin.SE3 | None = None,
    V_O: Array | None = None,
) -> ChainState:
    """`ClosedChain.state`, for chains whose motions are all driven or that allow others."""
    model, data = chain.model, chain.model.createData()
    pin.computeAllTerms(model, data, q, v)
    gravity = model.gravity.linear
    tips = chain.tip_poses(data)
    if X_WO is None:
        X_WO = chain.object_pose(data)
    O = X_WO.translation  # noqa: E741 - the operational point
    J = columns_at(data.J, O)
    twists = [J[:, s] @ v[s] for s in chain.slices]
    if V_O is None:
        V_O = _twist(chain, twists, X_WO, tips)
    reference = chain.reference.terms(X_WO, V_O, gravity)
    payload = reference if chain.payload is not None else _NOTHING
    L = np.linalg.cholesky(reference.Lambda)
    terms, passed = [], []
    for s, grasp, tip, V in zip(chain.slices, chain.grasps, tips, twists, strict=True):
        gamma, N = drift(J[:, s], v[s]), None
        if not grasp.is_rigid:  # the object slips by V_O − V while the tip carries N along
            gamma, N = gamma + cross_twist(V, V_O), grasp.wrenches_at(tip, O)
        passed.append(N)
        terms.append(
            arm_terms(
                J[:, s], gamma, data.M[s, s], data.nle[s], data.g[s], L, chain.rank_tolerance, N
            )
        )
    S, C, sigma = _intersect(terms, L, chain.rank_tolerance)
    W = np.vstack([t.J_bar @ S for t in terms])
    w = np.concatenate([t.J_bar @ (sigma - t.gamma) for t in terms])
    M, h, g = np.array(data.M), np.array(data.nle), np.array(data.g)
    Lambda = W.T @ M @ W + S.T @ payload.Lambda @ S
    G = W.T[:, chain.actuated]
    filters, Lambda_out, bias_out = _wrist_terms(chain, terms, passed, J, v, payload, O, L, data)
    centre = X_WO.rotation @ chain.reference.inertia.lever
    weighed = reference_inertia(reference.Lambda, chain.arm_mass, centre)
    return ChainState(
        X_WO=X_WO,
        V_O=V_O,
        S=S,
        C=C,
        Lambda_S=Lambda,
        Phi=S @ np.linalg.solve(Lambda, S.T),
        mu_S=W.T @ (h - g + M @ w) + S.T @ (payload.mu + payload.Lambda @ sigma),
        p_S=W.T @ g + S.T @ payload.p,
        sigma=sigma,
        G=G,
        W=W,
        w=w,
        h=h,
        M=M,
        arms=tuple(terms),
        payload=payload,
        metric=reference.Lambda,
        grasp_points=np.array([t.translation for t in tips]),
        sensors=chain.sensor_poses(data),
        filters=filters,
        Lambda_out=Lambda_out,
        bias_out=bias_out,
        unactuated=chain.unactuated_motions(G, S),
        reference=weighed,
        full_ranks=chain.full_ranks,
        singular_directions=tuple(fading_of(terms, chain.full_ranks, weighed)),
    )


def arm_terms(
    J: Array,
    gamma: Array,
    M: Array,
    h: Array,
    g: Array,
    L: Array,
    tolerance: float,
    N: Array | None = None,
) -> ArmTerms:
    """Φ, Λ, J̄, μ, p and C of one arm from what Pinocchio supplies (eq. 13).

    J is made dimensionless in the kinetic-energy metrics of joints (M) and object (LLᵀ), so that
    its singular values do not depend on units, frame or operational point.

    Args:
        J: (6, n) tip Jacobian carried to the operational point.
        gamma: (6,) spatial drift there, that of the object's slip in the grasp included.
        M, h, g: (n, n), (n,), (n,) joint inertia, nonlinear effects C v + g, gravity.
        L: (6, 6) lower Cholesky factor of the object's inertia.
        tolerance: a direction counts as locked when the arm's apparent inertia in it exceeds the
            object's by 1/tolerance².
        N: (6, m) wrenches that the grasp passes on; None: all.
    """
    K = np.linalg.cholesky(M)
    A = L.T @ np.linalg.solve(K, J.T).T
    if N is None:
        U, s, Vh = np.linalg.svd(A, full_matrices=True)
    else:
        passed, _ = np.linalg.qr(np.linalg.solve(L, N))
        U, s, Vh = np.linalg.svd(passed.T @ A, full_matrices=True)
        U = passed @ U
    rank = int(np.count_nonzero(s > tolerance))
    # J̄ = M⁻¹JᵀΛ = K⁻ᵀ A⁺ Lᵀ
    J_bar = np.linalg.solve(K.T, (Vh[:rank].T / s[:rank]) @ (L @ U[:, :rank]).T)
    Lambda = J_bar.T @ M @ J_bar
    LA = np.linalg.solve(L.T, A)
    return ArmTerms(
        J=J,
        gamma=gamma,
        M=M,
        Phi=LA @ LA.T,
        Lambda=Lambda,
        J_bar=J_bar,
        mu=J_bar.T @ (h - g) - Lambda @ gamma,
        p=J_bar.T @ g,
        C=L @ U[:, rank:],
        N=np.eye(6) if N is None else L @ U[:, :rank],
        rank=rank,
    )


def mobility(arm: ArmTerms, metric: Array) -> Array:
    """Singular values of √(object inertia / arm inertia), descending; metric (6, 6): the object."""
    L, K = np.linalg.cholesky(metric), np.linalg.cholesky(arm.M)
    A = L.T @ np.linalg.solve(K, arm.J.T).T
    if arm.N.shape[1] < 6:
        A = np.linalg.qr(np.linalg.solve(L, arm.N))[0].T @ A
    return np.linalg.svd(A, compute_uv=False)


def _intersect(terms: Sequence[ArmTerms], L: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """S = ∩ range(J_i), C with CᵀS = 0, and σ with C_iᵀσ = C_iᵀγ_i.

    Done in coordinates where the object's inertia is the identity (x̃ = Lᵀx, f = L f̃), so
    that the rank decision and the choice of σ do not depend on units or frame.
    """
    C_white = np.linalg.solve(L, np.hstack([t.C for t in terms]))
    c = np.concatenate([t.C.T @ t.gamma for t in terms])
    U, s, Vh = np.linalg.svd(C_white, full_matrices=True)
    rank = int(np.count_nonzero(s > tolerance))
    sigma_white = U[:, :rank] @ ((Vh[:rank] @ c) / s[:rank])
    S = np.linalg.solve(L.T, U[:, rank:])
    return S, L @ U[:, :rank], np.linalg.solve(L.T, sigma_white)


def _twist(
    chain: ClosedChain, twists: Sequence[Array], X_WO: pin.SE3, tips: Sequence[pin.SE3]
) -> Array:
    """V_O (6,) with N_iᵀ(V_O − V_i) = 0 for every grasp; if they differ, nearest in energy."""
    if chain.leader is not None:
        return twists[chain.leader]
    L, O = np.linalg.cholesky(chain.reference_inertia(X_WO)), X_WO.translation  # noqa: E741
    rows, right = [], []
    for grasp, tip, V in zip(chain.grasps, tips, twists, strict=True):
        N = grasp.wrenches_at(tip, O)
        Q, R = np.linalg.qr(np.linalg.solve(L, N))
        rows.append(Q.T)
        right.append(np.linalg.solve(R.T, N.T @ V))
    whitened = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    return np.linalg.solve(L.T, whitened)


def _wrist_terms(
    chain: ClosedChain,
    terms: Sequence[ArmTerms],
    passed: Sequence[Array | None],
    J: Array,
    v: Array,
    payload: ObjectTerms,
    O: Array,  # noqa: E741
    L: Array,
    data: pin.Data,
) -> tuple[tuple[Array | None, ...], Array, Array]:
    Lambda, bias = payload.Lambda.copy(), payload.mu + payload.p
    placements, filters = list(data.oMi), list[Array | None]()
    gravity = chain.model.gravity.linear
    columns = {j: j - s.start for s in chain.slices for j in range(s.start + 1, s.stop + 1)}
    for i, (links, s, t) in enumerate(zip(chain.outboard, chain.slices, terms, strict=True)):
        inertia, wrench, P = outboard_terms(
            links, placements, J[:, s], v[s], columns, t.J_bar, t.gamma, O, gravity
        )
        N = passed[i]
        filters.append(None if N is None else grasp_filter(J[:, s], N, P, L))
        if (F := filters[i]) is not None:
            inertia, wrench = F @ inertia, F @ wrench
        Lambda += inertia
        bias += wrench
    return tuple(filters), Lambda, bias


def reference_inertia(metric: Array, mass: float, centre: Array) -> Array:
    """Λ_ref (6, 6) at O.

    Args:
        metric: (6, 6) Λ_o. mass: of the arms (kg). centre: (3,) of the object's mass, from O.
    """
    x, y, z = centre
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    ball = np.block([[np.eye(3), -cross], [cross, GYRATION**2 * np.eye(3) - cross @ cross]])
    return metric + mass * ball


def share_left(chi: float) -> float:
    """1 at χ ≥ FULL, 0 at χ ≤ NONE_LEFT, 3s² − 2s³ between."""
    s = min(max((chi - NONE_LEFT) / (FULL - NONE_LEFT), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def fading_of(
    arms: Sequence[ArmTerms], full_ranks: Sequence[int], reference: Array
) -> Iterator[SingularDirection]:
    """Every direction whose χ is below FULL.

    Args:
        arms: of the chain. full_ranks: motions their tips can make in ordinary postures.
        reference: (6, 6) Λ_ref.
    """
    L = np.linalg.cholesky(reference)
    for i, arm in enumerate(arms):
        K = np.linalg.cholesky(arm.M)
        A = L.T @ np.linalg.solve(K, arm.J.T).T
        if arm.N.shape[1] < 6:
            passed, _ = np.linalg.qr(np.linalg.solve(L, arm.N))
            U, chis, Vh = np.linalg.svd(passed.T @ A, full_matrices=False)
            U = passed @ U
        else:
            U, chis, Vh = np.linalg.svd(A, full_matrices=False)
        for k in np.flatnonzero(chis[: full_ranks[i]] < FULL):
            u = U[:, k]
            yield SingularDirection(
                i, float(chis[k]), share_left(float(chis[k])), L @ u, np.linalg.solve(L.T, u),
                np.linalg.solve(K.T, Vh[k]), bool(k >= arm.rank),
            )  # fmt: skip
