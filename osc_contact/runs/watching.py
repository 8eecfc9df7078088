"""The contact monitor over a whole series of ticks."""

from __future__ import annotations

import numpy as np

from osc_contact.control.monitor import ContactMonitor
from osc_contact.spatial import Array

__all__ = ["watch_series"]


def watch_series(monitor: ContactMonitor, alpha: Array, speed: Array) -> tuple[Array, Array]:
    """What the monitor would have told tick by tick: closed and collision (k, r).

    As long as all contacts hold, nothing is armed and no force goes low, it has nothing new to
    tell: such ticks are passed over.

    Args:
        monitor: its state moves on. alpha: (k, r) as for `ContactMonitor.update`. speed: (k, r).
    """
    closed, collision = np.ones(alpha.shape, dtype=bool), np.zeros(alpha.shape, dtype=bool)
    low = np.flatnonzero((alpha < monitor.limits.force_off).any(axis=1))
    k = 0
    while k < len(alpha):
        state = monitor.update(alpha[k], speed[k])
        closed[k], collision[k] = state.closed, state.collision
        k += 1
        if state.closed.all() and not (state.armed_for.any() or state.low_for.any()):
            coming = np.searchsorted(low, k)
            k = int(low[coming]) if coming < len(low) else len(alpha)
    return closed, collision
