"""Contact phases: which contacts are open, approached or closed; `law.phases` runs them."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["Phase"]


class Phase(IntEnum):
    """Of one contact."""

    OPEN = 0  #: out of N: free motion
    APPROACHING = 1  #: in N, dragged towards the face at a set speed
    CLOSED = 2  #: in N, under force control
