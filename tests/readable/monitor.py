"""Contact or no contact in NumPy: what `law.phases.monitor` is held to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.control.monitor import MonitorLimits
from osc_contact.spatial import Array

__all__ = ["MonitorState", "watched"]


@dataclass(frozen=True)
class MonitorState:
    """What is remembered of each contact, (r,) each.

    Attributes:
        closed: whether contact is held to be made.
        low_for, high_for: s since the force went low; since it went high.
        burst: W; the largest power since then, or since contact was made.
        armed_for: s in which a collision may still be told.
        collision: whether one began at this tick.
    """

    closed: Array
    low_for: Array
    high_for: Array
    burst: Array
    armed_for: Array
    collision: Array

    @classmethod
    def of(cls, closed: Array) -> MonitorState:
        """At the start: contacts (r,) made or not."""
        closed = np.asarray(closed, dtype=bool)
        zero = np.zeros(len(closed))
        return cls(closed, zero, zero, zero, zero, np.zeros(len(closed), dtype=bool))


def watched(
    state: MonitorState,
    alpha: Array,
    speed: Array,
    dt: float,
    limits: MonitorLimits,
    more: Array | float = 0.0,
    dwell: Array | float | None = None,
) -> MonitorState:
    """The state one tick later.

    Args:
        state: before. alpha: (r,) measured magnitudes (N), from the wrist filter.
        speed: (r,) NᵀV_rel (m/s). dt: the tick (s). limits: thresholds.
        more: (r,) N above force_off below which contact is lost already.
        dwell: (r,) s; None: that of `limits`.
    """
    away = speed < -limits.leaving
    low_for = np.where(away | (alpha < limits.force_off + more), state.low_for + dt, 0.0)
    high_for = np.where(~away & (alpha > limits.force_on), state.high_for + dt, 0.0)
    dwell = limits.dwell if dwell is None else dwell
    lost = state.closed & (low_for > limits.patience)
    closed = (state.closed | (high_for > dwell)) & ~lost
    armed_for = np.where(state.closed, np.maximum(state.armed_for - dt, 0.0), limits.window)
    burst = np.where(closed | (high_for > 0.0), np.maximum(state.burst, np.abs(alpha * speed)), 0.0)
    collision = closed & (armed_for > 0.0) & (burst > limits.power)
    armed_for = np.where(collision, 0.0, armed_for)
    return MonitorState(closed, low_for, high_for, burst, armed_for, collision)
