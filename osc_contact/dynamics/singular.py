"""Motions that an arm is about to lose near a singular posture, judged free of units.

An arm is measured against Λ_ref, the object and, at its centre of mass, a ball as heavy as the
heaviest arm (radius of gyration 0.1 m). With Λ_ref = LLᵀ and M = KKᵀ,

    LᵀJK⁻ᵀ = U diag(χ) Vᵀ

is free of units, and 1/χ² is the arm's apparent inertia in the direction u beside that of Λ_ref. At
the start of every packaged scenario χ is at least 0.5; it goes to zero in a singular posture.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.dynamics.arm import ArmTerms
from osc_contact.spatial import Array

__all__ = ["FADED", "FULL", "GYRATION", "Fading", "fading_of", "full_rank", "reference_inertia"]

#: Commands begin to fade where χ falls below FULL and are gone at FADED.
FADED, FULL = 0.05, 0.3
GYRATION = 0.1  #: m, of the ball


@dataclass(frozen=True)
class Fading:
    """One direction an arm is losing: q̈ = mode moves the object by χ L⁻ᵀu.

    Attributes:
        arm: its number. chi: see the module. share: of the command that is left, 1 … 0.
        wrench: (6,) L u at O, world axes: wrenchᵀ(a − γ) is the acceleration it sees.
        twist: (6,) L⁻ᵀu: the motion that is lost, its scale that of 1 J of Λ_ref.
        mode: (n,) K⁻ᵀv of the arm's joints, of unit kinetic energy (times two).
        locked: the chain counts the direction as lost (`ClosedChain.rank_tolerance`).
    """

    arm: int
    chi: float
    share: float
    wrench: Array
    twist: Array
    mode: Array
    locked: bool


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
    """1 at χ ≥ FULL, 0 at χ ≤ FADED, 3s² − 2s³ between."""
    s = min(max((chi - FADED) / (FULL - FADED), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def full_rank(model: pin.Model, tip: str) -> int:
    """Motions the tip can make in ordinary postures: the largest rank of J in a few random ones."""
    rng, data = np.random.default_rng(0), model.createData()
    frame = robots.frame_id(model, tip)
    ranks = []
    for _ in range(4):
        q = rng.uniform(-1.0, 1.0, model.nq)
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        ranks.append(int(np.linalg.matrix_rank(J, tol=1e-6)))
    return max(ranks)


def fading_of(
    arms: Sequence[ArmTerms], full_ranks: Sequence[int], reference: Array
) -> Iterator[Fading]:
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
            yield Fading(
                i, float(chis[k]), share_left(float(chis[k])), L @ u, np.linalg.solve(L.T, u),
                np.linalg.solve(K.T, Vh[k]), bool(k >= arm.rank),
            )  # fmt: skip
