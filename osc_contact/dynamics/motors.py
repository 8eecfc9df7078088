"""What the motors of a model can do at most."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.spatial import Array

__all__ = ["effort_limits", "effort_scale"]

_UNLIMITED = 1e12  # N m or N: an effort limit that is none


def effort_limits(model: pin.Model, actuated: Array) -> Array:
    """(n_a,) effort limits (N m, N), inf where there is none: models built in code leave DBL_MAX.

    Raises:
        ModelError: a limit that is not positive.
    """
    given = np.array(model.upperEffortLimit)[actuated]
    for j, limit in zip(actuated, given, strict=True):
        if not limit > 0.0:
            name = model.names[int(j) + 1]
            raise ModelError(
                f"joint '{name}' has an effort limit of {limit:g}: such a motor does "
                "nothing. Give its largest torque (N m) or force (N), or list it among the passive "
                "joints"
            )
    return np.where(given < _UNLIMITED, given, np.inf)


def effort_scale(tau_max: Array) -> Array:
    """(n_a,) what torques are measured by: τ_max, for motors without limit the largest of them."""
    finite = np.isfinite(tau_max)
    return np.where(finite, tau_max, tau_max[finite].max() if finite.any() else 1.0)
