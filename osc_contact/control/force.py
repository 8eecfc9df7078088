"""Gains of the force law, α_u = α_s + K_i ∫(α_s − α_meas) dt − K_v NᵀV_rel (fig. 5)."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, pi, radians
from typing import Any

from osc_contact.errors import InvalidInputError

__all__ = ["ForceGains"]

_LASTS = 6.0  #: a speed of the contact that lasts longer than this / K_i is not braked


@dataclass(frozen=True, init=False)
class ForceGains:
    """Bandwidth, damping ratio and rise time; or integral gain and damping for one mass.

    There is no proportional gain: a rigid contact answers a command within the same instant, so a
    proportional loop with gain ≥ 1 is unstable in discrete time at any rate.

    Attributes:
        integral: K_i = 2π bandwidth (1/s), at which errors of the force fade.
        brake: κ = 2 damping_ratio K_i (1/s), of the normal velocity: a force of κ(NᵀΦN)⁻¹.
        rise: T (s) that a step of a desired force takes; 0: none.
        damping: K_v (N s/m) of the normal velocity, whatever the mass behind the contact.
        tilt: rad; a face on which one point slides is believed to be turned by as much as the
            motion shows, up to this angle. 0: never.
    """

    integral: float
    damping: float
    brake: float
    rise: float
    tilt: float

    def __init__(
        self,
        integral: float | None = None,
        damping: float | None = None,
        *,
        bandwidth: float | None = None,
        damping_ratio: float | None = None,
        rise: float | None = None,
        tilt: float | None = None,
        brake: float | None = None,
    ) -> None:
        """Scaled by mass unless `integral` or `damping` is given, the gains for one mass.

        Args:
            integral: 1/s, default 30. damping: N s/m, default 0.
            bandwidth: Hz, default 5. damping_ratio: default 0.7. rise: s, default 0.25; 0 beside
                `integral` or `damping`. tilt: rad, default 10°; 0 beside `integral` or `damping`.
            brake: 1/s, in place of a damping ratio.

        Raises:
            InvalidInputError: gains of both kinds, or one that is negative or not finite.
        """
        given = {"bandwidth": bandwidth, "damping_ratio": damping_ratio}
        scaled = [key for key, value in given.items() if value is not None]
        plain = [
            key
            for key, value in {"integral": integral, "damping": damping, "brake": brake}.items()
            if value is not None
        ]
        if scaled and plain:
            raise InvalidInputError(
                f"force gains {', '.join(scaled)} beside {', '.join(plain)}: give bandwidth (Hz) "
                "and damping_ratio, which serve every mass, or integral (1/s) and damping (N s/m)"
            )
        for key, value in given.items():
            _require(key, 0.0 if value is None else value)
        if not plain:
            integral = 2.0 * pi * (5.0 if bandwidth is None else bandwidth)
            brake = 2.0 * (0.7 if damping_ratio is None else damping_ratio) * integral
            rise = 0.25 if rise is None else rise
            tilt = radians(10.0) if tilt is None else tilt
        self._set(
            integral=30.0 if integral is None else integral, damping=damping or 0.0,
            brake=brake or 0.0, rise=rise or 0.0, tilt=tilt or 0.0,
        )  # fmt: skip

    def _set(self, **values: Any) -> None:
        for key, value in values.items():
            _require(key, value)
            object.__setattr__(self, key, float(value))

    @property
    def bandwidth(self) -> float:
        """K_i / 2π (Hz)."""
        return self.integral / (2.0 * pi)

    @property
    def damping_ratio(self) -> float:
        """κ / 2K_i; above ½ no contact swings up, however stiff or heavy."""
        return self.brake / (2.0 * self.integral) if self.integral > 0.0 else 0.0

    @property
    def drift(self) -> float:
        """1/s; a normal velocity that changes more slowly belongs to a tilted face: no brake."""
        return self.integral / _LASTS


def _require(key: str, value: float) -> None:
    if not (isfinite(value) and value >= 0.0):
        raise InvalidInputError(f"force gain {key} = {value}; give a finite number ≥ 0")
