"""Kinematic stability: where the selection matrix of classic hybrid control makes an arm diverge.

The classic scheme turns the filtered position error back into joint errors, τ = K_q J⁻¹S J q_e,
with S picking the position-controlled axes of a frame. Its loop closes over M⁻¹K_q J⁻¹S J, a
definite matrix times an *oblique* projection, whose eigenvalues can have negative real parts (An
and Hollerbach, "Kinematic stability issues in force control of manipulators", 1987; Fisher and
Mujtaba, "Hybrid position/force control: a correct formulation", 1992). Filtered by Ω_m(B), eq. 7,
the error is seen through (TᵀB⁻¹T)⁻¹TᵀB⁻¹K T instead; with K = B K′, K′ symmetric positive definite
(scalar gains are K′ = k B⁻¹), its eigenvalues are real and positive in every posture.

As in those references the position part is judged alone: nothing holds the arm in the
force-controlled direction. For ours this is no restriction: the eigenvalues of Ω_m(B)K that are
not zero are those above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from osc_contact.spatial import Array
from paper.kinematic_stability.arms import HybridArm, planar_arm, ur5_arm
from paper.kinematic_stability.laws import (
    DAMPING_S,
    classic_eigenvalues,
    classic_torque,
    our_eigenvalues,
    our_torque,
    poles,
)
from paper.kinematic_stability.search import (
    PostureMap,
    WorstPosture,
    posture_map,
    search,
)
from paper.kinematic_stability.simulate import LEFT, Histories, simulate

__all__ = [
    "DAMPING_S",
    "LEFT",
    "WorstPosture",
    "Histories",
    "HybridArm",
    "PostureMap",
    "Result",
    "classic_eigenvalues",
    "classic_torque",
    "our_eigenvalues",
    "our_torque",
    "planar_arm",
    "poles",
    "posture_map",
    "run",
    "search",
    "simulate",
    "ur5_arm",
]


@dataclass(frozen=True)
class Result:
    """One arm: the posture found, the map through it and what happens there."""

    worst: WorstPosture
    map: PostureMap
    histories: Histories

    def as_dict(self) -> dict[str, Any]:
        """For JSON; eigenvalues (1/s²) and poles (1/s) as [real, imaginary]."""
        f, h = self.worst, self.histories
        return {
            "arm": f.arm.name,
            "seed": f.seed,
            "postures_drawn": f.drawn,
            "postures": f.tried,
            "classic_unstable": f.unstable,
            "ours_unstable": f.ours_unstable,
            "ours_least_eigenvalue": f.ours_least,
            "posture_rad": f.q.tolist(),
            "classic_eigenvalues": _pairs(f.classic),
            "ours_eigenvalues": _pairs(f.ours),
            "classic_poles": _pairs(poles(f.classic)),
            "ours_poles": _pairs(poles(f.ours)),
            "first_error_mrad": 1e3 * float(np.abs(h.ours[0]).max()),
            "classic_left_after_s": h.left_after(),
            "last_error_mrad": 1e3 * float(np.abs(h.ours[-1]).max()),
            "duration_s": float(h.t[-1]),
        }


def run(
    seed: int = 0,
    arms: Sequence[tuple[HybridArm, tuple[int, int]]] | None = None,
    postures: int = 2000,
    count: int = 48,
    duration: float = 1.0,
) -> list[Result]:
    """Search, map and simulate.

    Args:
        seed: of the draw of postures.
        arms: each with the two joints its map spans; default: planar arm and UR5.
        postures: drawn per arm; the more regular half of them is examined.
        count: grid points per joint of the map.
        duration: of the simulation (s).
    """
    if arms is None:
        arms = (planar_arm(), (0, 1)), (ur5_arm(), (1, 2))
    results = []
    for arm, joints in arms:
        worst = search(arm, seed, postures)
        results.append(Result(worst, posture_map(worst, joints, count), simulate(worst, duration)))
    return results


def _pairs(values: Array) -> list[list[float]]:
    return [[float(z.real), float(z.imag)] for z in values]
