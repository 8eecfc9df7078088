"""Gains of the motion law, p̈_u = p̈_d + K_d ė + K_p e + K_i ∫e."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, pi, sqrt

from osc_contact.errors import InvalidInputError

__all__ = ["MotionGains"]


@dataclass(frozen=True, init=False)
class MotionGains:
    """Natural frequency and damping ratio, or the gains themselves: those of a mass-free spring.

    Scalars, the same for positions and angles, so that no metre meets a radian. They are gains of
    accelerations: the model's inertia makes forces of them, so they serve every mass.

    Attributes:
        stiffness: K_p = (2π frequency)² (1/s²). damping: K_d = 4π frequency damping_ratio (1/s).
        integral: K_i = K_p / integral_time (1/s³).
    """

    stiffness: float
    damping: float
    integral: float

    def __init__(
        self,
        stiffness: float | None = None,
        damping: float | None = None,
        integral: float | None = None,
        *,
        frequency: float | None = None,
        damping_ratio: float | None = None,
        integral_time: float | None = None,
    ) -> None:
        """Take one kind of gains or the other; `MotionGains()` is 400 1/s², 40 1/s: 3.2 Hz.

        Args:
            stiffness: 1/s², default 400. damping: 1/s, default 40. integral: 1/s³, default 0.
            frequency: Hz, in place of stiffness. damping_ratio: in place of damping, default 1.
            integral_time: s, in place of integral; None: no integral.

        Raises:
            InvalidInputError: gains of both kinds, one that is negative or not finite, or an
                integral gain that would make the loop unstable.
        """
        words = {
            "frequency": frequency,
            "damping_ratio": damping_ratio,
            "integral_time": integral_time,
        }
        plain = {"stiffness": stiffness, "damping": damping, "integral": integral}
        chosen = [key for key, value in words.items() if value is not None]
        beside = [key for key, value in plain.items() if value is not None]
        if chosen and beside:
            raise InvalidInputError(
                f"motion gains {', '.join(chosen)} beside {', '.join(beside)}: give frequency "
                "(Hz), damping_ratio and integral_time (s), or stiffness, damping and integral"
            )
        for key in chosen:
            _require(key, words[key], least=0.0 if key == "damping_ratio" else None)
        if chosen:
            omega = 20.0 if frequency is None else 2.0 * pi * frequency
            stiffness = omega**2
            damping = 2.0 * omega * (1.0 if damping_ratio is None else damping_ratio)
            integral = 0.0 if integral_time is None else stiffness / integral_time
        for key, value, default in (
            ("stiffness", stiffness, 400.0), ("damping", damping, 40.0), ("integral", integral, 0.0)
        ):  # fmt: skip
            value = default if value is None else value
            _require(key, value, least=0.0)
            object.__setattr__(self, key, value)
        if self.integral > 0.0 and self.integral >= self.stiffness * self.damping:
            raise InvalidInputError(
                f"motion gain integral = {self.integral:g} 1/s³ is not below stiffness × damping = "
                f"{self.stiffness * self.damping:g}: the loop would be unstable (Routh). Lower it, "
                "or raise integral_time."
            )

    @property
    def frequency(self) -> float:
        """√K_p / 2π (Hz)."""
        return sqrt(self.stiffness) / (2.0 * pi)

    @property
    def damping_ratio(self) -> float:
        """K_d / 2√K_p."""
        return self.damping / (2.0 * sqrt(self.stiffness)) if self.stiffness > 0.0 else 0.0


def _require(key: str, value: float | None, least: float | None) -> None:
    """Refuse what is not finite, or below `least` (None: not above zero)."""
    assert value is not None
    if not isfinite(value) or (value <= 0.0 if least is None else value < least):
        bound = "> 0" if least is None else f"≥ {least:g}"
        raise InvalidInputError(f"motion gain {key} = {value}; give a finite number {bound}")
