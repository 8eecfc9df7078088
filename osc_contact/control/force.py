"""Gains of the force law, α_u = α_d + K_i ∫(α_d − α_meas) dt − K_v NᵀV_rel (fig. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError

__all__ = ["ForceGains"]


@dataclass(frozen=True)
class ForceGains:
    """Integral gain (1/s) and damping of the normal velocity (N s/m).

    There is no proportional gain: a rigid contact answers a command within the same instant, so a
    proportional loop with gain ≥ 1 is unstable in discrete time at any rate.
    """

    integral: float = 30.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise InvalidInputError(f"force gain {key} = {value}; give a finite number ≥ 0")
