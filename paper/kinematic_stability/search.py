"""Random postures judged by both eigenvalue problems, and a map through the worst one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array
from paper.kinematic_stability.arms import HybridArm
from paper.kinematic_stability.laws import classic_eigenvalues, our_eigenvalues

__all__ = ["PostureMap", "WorstPosture", "posture_map", "search"]


@dataclass(frozen=True)
class WorstPosture:
    """The posture in which the classic scheme is least stable, and both schemes there.

    Attributes:
        arm: and its posture q (n,).
        seed: of the search. drawn, tried: postures drawn, and examined.
        classic, ours: (s,) complex eigenvalues of both (1/s²).
        unstable, ours_unstable: how many had an eigenvalue with negative real part, in the classic
            scheme and in ours.
        ours_least: the smallest real part ours had in any posture examined (1/s²).
    """

    arm: HybridArm
    q: Array
    seed: int
    drawn: int
    tried: int
    classic: Array
    ours: Array
    unstable: int
    ours_unstable: int
    ours_least: float


def search(
    arm: HybridArm, seed: int = 0, postures: int = 2000, regular: float = 0.5
) -> WorstPosture:
    """Draw uniformly random postures and examine the most regular of them.

    Args:
        arm: the joints go from −π to π.
        seed: of the draw.
        postures: how many to draw.
        regular: share of them that is examined, the most regular first (`regularity`): an
            instability next to a singularity would prove little.

    Raises:
        InvalidInputError: none of them is unstable.
    """
    if postures < 2 or not 0.0 < regular <= 1.0:
        raise InvalidInputError(
            f"postures = {postures}, regular = {regular}; give at least 2 and a share in (0, 1]"
        )
    drawn = np.random.default_rng(seed).uniform(-np.pi, np.pi, (postures, arm.chain.nq))
    order = np.argsort([-regularity(arm, q) for q in drawn])
    examined = drawn[order[: round(regular * postures)]]
    values = [eigenvalues(arm, q) for q in examined]
    classic = np.array([of_classic[0].real for of_classic, _ in values])
    ours = np.array([of_ours[0].real for _, of_ours in values])
    worst = int(classic.argmin())
    if classic[worst] >= 0.0:
        raise InvalidInputError(
            f"{arm.name}: none of {len(examined)} postures examined is unstable; draw more "
            "(postures=), or control the force along another axis"
        )
    return WorstPosture(
        arm=arm,
        q=examined[worst],
        seed=seed,
        drawn=postures,
        tried=len(examined),
        classic=values[worst][0],
        ours=values[worst][1],
        unstable=int((classic < 0.0).sum()),
        ours_unstable=int((ours < 0.0).sum()),
        ours_least=float(ours.min()),
    )


def eigenvalues(arm: HybridArm, q: Array) -> tuple[Array, Array]:
    """`classic_eigenvalues` and `our_eigenvalues` in a posture (n,)."""
    M, J, tip = arm.terms(q)
    classic = classic_eigenvalues(M, J[list(arm.rows)], arm.selection, arm.K_q)
    return classic, our_eigenvalues(arm.tangents(J), arm.metric(tip), arm.K_prime)


def regularity(arm: HybridArm, q: Array) -> float:
    """Least share of the object in the inertia met at the tip, over all directions (0: singular).

    The least eigenvalue of LᵀJM⁻¹JᵀL with LLᵀ the object's inertia: no units, no frame.
    """
    M, J_tip, tip = arm.terms(q)
    rows = list(arm.rows)
    J = J_tip[rows]
    L = np.linalg.cholesky(np.linalg.inv(arm.metric(tip)[np.ix_(rows, rows)]))
    return float(np.linalg.eigvalsh(L.T @ J @ np.linalg.solve(M, J.T) @ L)[0])


@dataclass(frozen=True)
class PostureMap:
    """Least real part of both schemes' eigenvalues over two joints, the others as found.

    Attributes:
        joints: the two indices. grid: (k,) positions of each (rad).
        classic, ours: (k, k), second joint by first (1/s²); NaN where the arm is singular.
    """

    joints: tuple[int, int]
    grid: Array
    classic: Array
    ours: Array


def posture_map(
    worst: WorstPosture, joints: tuple[int, int] = (0, 1), count: int = 48
) -> PostureMap:
    """Both schemes over a plane of the posture space through the posture found.

    Args:
        worst: arm and posture.
        joints: indices of the two joints that are varied.
        count: positions of each, over the whole turn.
    """
    grid = (np.arange(count) + 0.5) / count * 2 * np.pi - np.pi  # never exactly straight
    least = np.full((2, count, count), np.nan)
    q = worst.q.copy()
    for j, second in enumerate(grid):
        for i, first in enumerate(grid):
            q[list(joints)] = first, second
            if regularity(worst.arm, q) > 1e-9:
                least[:, j, i] = [values[0].real for values in eigenvalues(worst.arm, q)]
    return PostureMap(joints, grid, *least)
