"""Gains of a controller."""

from __future__ import annotations

from dataclasses import dataclass, field

from osc_contact.control.force import ForceGains
from osc_contact.control.motion import MotionGains

__all__ = ["Gains"]


@dataclass(frozen=True)
class Gains:
    """Gains of the two loops."""

    motion: MotionGains = field(default_factory=MotionGains)
    force: ForceGains = field(default_factory=ForceGains)
