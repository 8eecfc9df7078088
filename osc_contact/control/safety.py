"""When a controller holds the posture or stops.

`law.safety` and `law.watch` do it.
"""

from __future__ import annotations

from enum import IntEnum

__all__ = ["SafetyState"]


class SafetyState(IntEnum):
    """What the controller does."""

    RUN = 0  #: the last tick was computed and nothing was lost
    DEGRADED = 1  #: motors at their limits, near a singular posture, or a tick or two not computed
    HOLD = 2  #: not computed: gravity compensation and damping at the last posture that was read
    SAFE_STOP = 3  #: braked to rest and held, until `Controller.reset`
