"""Fig. 2 of the paper: a Panda presses a cone into a V groove, turns it and slides it, all at once.

T = [t₁ t₂] is known by inspection and no constraint frame describes it: the axes of t₁ and t₂ are
neither parallel nor perpendicular. Four pushes on the walls and two motions are controlled, on the
rigid plant.
"""

from __future__ import annotations

from paper.cone_in_groove.geometry import Cone, Groove, Seat, seated_cone
from paper.cone_in_groove.run import ConeResult, couplings, run
from paper.cone_in_groove.scenario import cone_scenario

__all__ = [
    "Cone",
    "ConeResult",
    "Groove",
    "Seat",
    "cone_scenario",
    "couplings",
    "run",
    "seated_cone",
]
