"""The two loops of a live controller: gains to read, integrals to read and set."""

from __future__ import annotations

from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.scenarios.control_schema import ForceGains, MotionGains
from osc_contact.spatial import Array, as_array

__all__ = ["ForceLoop", "MotionLoop", "refuse"]


def refuse(owner: str, name: str, settable: tuple[str, ...]) -> InvalidInputError:
    """The error for assigning to what a controller has taken at construction.

    Args:
        owner: class of the object. name: of the attribute. settable: attributes that may be set.
    """
    return InvalidInputError(
        f"{owner}.{name} is taken when a controller is made, and would be ignored afterwards. "
        "controller.with_gains(...) and controller.with_laws(...) make another one that goes on "
        f"without a jump; a live one lets you set {', '.join(settable)}"
    )


class MotionLoop:
    """Of the motion law. gains: as given. integral: (6,) ∫e dt (m s, rad s)."""

    def __init__(self, gains: MotionGains, dt: float, memory: Any) -> None:
        self.__dict__.update(gains=gains, dt=dt, _memory=memory)

    gains: MotionGains
    dt: float
    _memory: Any

    @property
    def integral(self) -> Array:
        """(6,) ∫e dt (m s, rad s)."""
        return np.array(self._memory.motion_sum)

    @integral.setter
    def integral(self, value: Array) -> None:
        self._memory.motion_sum[:] = as_array("motion integral", value, (6,))

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in ("integral", "_memory"):
            raise refuse("motion_law", name, ("motion_law.integral",))
        object.__setattr__(self, name, value)


class ForceLoop:
    """Of the force law. gains: as given. integral: (r,) K_i ∫(α_d − α_meas) dt (N)."""

    def __init__(self, gains: ForceGains, dt: float, memory: Any) -> None:
        self.__dict__.update(gains=gains, dt=dt, _memory=memory)

    gains: ForceGains
    dt: float
    _memory: Any

    @property
    def integral(self) -> Array:
        """(r,) K_i ∫(α_d − α_meas) dt (N)."""
        return np.array(self._memory.force_sum[: int(self._memory.force_rank)])

    @integral.setter
    def integral(self, value: Array) -> None:
        memory, value = self._memory, as_array("force integral", value, (None,))
        if len(value) > 6:
            raise InvalidInputError(f"force integral: {len(value)} values; N has 6 columns at most")
        memory.force_sum[: len(value)], memory.force_rank = value, len(value)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in ("integral", "_memory"):
            raise refuse("force_law", name, ("force_law.integral",))
        object.__setattr__(self, name, value)
