"""Contact forces less the inertia of what flies: NumPy oracle of `law.phases.low_pass`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.spatial import Array

__all__ = ["FilteredForce", "filter_force"]


@dataclass(frozen=True)
class FilteredForce:
    """Low-passed magnitudes and speeds, (r,) each, of the columns that are `known`.

    `noise`: twice the mean of what contacts seem to pull. `speed`: as it came in.
    """

    force: Array
    pace: Array
    known: Array
    noise: Array
    speed: Array

    @classmethod
    def nothing(cls, r: int) -> FilteredForce:
        """Before the first tick."""
        return cls(np.zeros(r), np.zeros(r), np.zeros(r, dtype=bool), *np.zeros((2, r)))


def filter_force(
    before: FilteredForce,
    alpha: Array,
    speed: Array,
    inertia: Array,
    here: Array,
    dt: float,
    lag: float,
) -> tuple[FilteredForce, Array]:
    """Contact forces (r,) that do not take the contact for granted.

    The filter of fig. 5 puts Nᵀa_rel = n_γ. An object that leaves its face, or flies towards it,
    has Nᵀa_rel = n_γ + d(NᵀV_rel)/dt, and shows a contact force that is none: that of the parts
    outboard of the sensors, D⁻¹ d(NᵀV_rel)/dt. It is taken away, both terms through the same first
    order low-pass, which makes the derivative one of measured speeds.

    Args:
        before: of the last tick. alpha, speed: (r,) measured magnitudes (N), NᵀV_rel (m/s).
        inertia: (r, r) D⁻¹ (kg). here: (r,) which columns are in N.
        dt: the tick (s). lag: of the low-pass (s).
    """
    k = dt / (lag + dt)
    force = np.where(before.known, before.force + k * (alpha - before.force), alpha)
    pace = np.where(before.known, before.pace + k * (speed - before.pace), speed)
    rate = np.where(before.known, pace - before.pace, 0.0) / dt
    flying = inertia @ rate
    pulls = np.where(here, np.maximum(flying - alpha, 0.0), 0.0)
    noise = before.noise + (2.0 * pulls - before.noise) / (1.0 + 0.05 / dt)
    return FilteredForce(force, pace, here, noise, speed), force - flying
