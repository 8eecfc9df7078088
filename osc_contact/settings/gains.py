"""Gains of the controller's two loops: motion and contact force, as design values or as gains."""

from __future__ import annotations

from abc import abstractmethod
from math import inf, pi, radians, sqrt
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from osc_contact.settings.quantities import (
    Angle,
    Frequency,
    NotNegative,
    NotNegativeNumber,
    OrderedSpec,
    Positive,
    Time,
    refuse,
)

_HELD = 12.0  #: least ratio of brake and integral gain of contacts that hold at zero force
_UNBRAKED = 6.0  #: a contact speed that lasts longer than this divided by K_i is not braked
_DERIVED: Any = Field(default=None)  #: default of a gain that is derived from the others


class _GainsOfOneLoop(OrderedSpec):
    """Gains of a control loop, given as design values or as gains.

    Design values, such as a bandwidth, suit every mass; they are not mixed with gains.

    Attributes:
        serving: names of the design values.
        numbers: names of the gains.
        example: argument of --set that replaces the group.
    """

    serving: ClassVar[tuple[str, ...]]
    numbers: ClassVar[tuple[str, ...]]
    example: ClassVar[str]

    @model_validator(mode="before")
    @classmethod
    def _leave_out_nulls(cls, data: Any) -> Any:
        """Drop keys with the value null from the input of the group: they count as not given."""
        if isinstance(data, dict):
            return {key: value for key, value in data.items() if value is not None}
        return data

    @model_validator(mode="after")
    def _derive_missing(self) -> Self:
        """Derive the values that are not given; refuse design values together with gains.

        `serving` names the design values, such as bandwidth and damping ratio, `numbers` the gains
        that follow from them; without both the default design values apply.
        """
        values = {key: getattr(self, key) for key in self.model_fields_set}
        design = [key for key in self.serving if key in values]
        gains = [key for key in self.numbers if key in values]
        if design and gains:
            raise refuse(
                f"{', '.join(design)} beside {', '.join(gains)}: give {', '.join(self.serving)}, "
                f"or {', '.join(self.numbers)}; to replace them with --set, set the group: "
                f"--set '{self.example}'"
            )
        self.__dict__.update(self._derive_gains(not gains, values) | values)
        return self

    @abstractmethod
    def _derive_gains(self, serves_every_mass: bool, values: dict[str, float]) -> dict[str, float]:
        """Derive gains from design values, or design values from gains.

        Args:
            serves_every_mass: True if design values determine the gains.
            values: values given by the user, by key.

        Returns:
            Values of all keys of the group, in SI.
        """

    @model_serializer(mode="wrap")
    def _as_given(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Serialise only the keys that were given, since derived values exclude these in a file."""
        return {key: value for key, value in write(self).items() if key in self.model_fields_set}


class MotionGains(_GainsOfOneLoop):
    """Gains of the motion law p̈_u = p̈_d + K_d ė + K_p e + K_i ∫e.

    Gains are scalars, the same for positions and angles, so that metres and radians are not added.
    They are gains of accelerations, which the model's inertia converts to forces, so that they suit
    every mass.

    Example:
        >>> gains = osc.MotionGains(frequency=3.0, damping_ratio=0.7)
        >>> print(f"{gains.stiffness:.0f} 1/s², {gains.damping:.1f} 1/s")
        355 1/s², 26.4 1/s
        >>> print(osc.MotionGains(stiffness=400.0, damping=40.0).damping_ratio)
        1.0
    """

    serving = ("frequency", "damping_ratio", "integral_time")
    numbers = ("stiffness", "damping", "integral")
    example = "gains.motion={frequency: 5 Hz}"

    stiffness: Annotated[NotNegativeNumber, "1/s²"] = _DERIVED
    """K_p = (2π `frequency`)²; 400 1/s² if no gain of the loop is given"""
    damping: Annotated[NotNegativeNumber, "1/s"] = _DERIVED
    """K_d = 4π `frequency` `damping_ratio`; required with `stiffness`"""
    integral: Annotated[NotNegativeNumber, "1/s³"] = _DERIVED
    """K_i = K_p / `integral_time`; may be given with `stiffness`; below `stiffness` × `damping`"""
    frequency: Positive[Frequency] = _DERIVED
    """natural frequency of the motion loop, the same for positions and angles; 3.2 Hz,
    4 Hz with a tare"""
    damping_ratio: NotNegativeNumber = _DERIVED
    """damping ratio of the motion loop; 1"""
    integral_time: Positive[Time] = _DERIVED
    """time in which the integral of a constant error commands as much as the stiffness; no
    integral, 0.2 s with a tare"""

    @model_validator(mode="after")
    def _is_stable(self) -> Self:
        """Refuse gains whose third-order error dynamics are unstable (Routh)."""
        if self.integral > 0.0 and self.integral >= self.stiffness * self.damping:
            raise refuse(
                f"integral = {self.integral:g} 1/s³ is not below stiffness × damping = "
                f"{self.stiffness * self.damping:g}: the loop would be unstable (Routh); lower it, "
                "or raise integral_time"
            )
        return self

    def _derive_gains(self, serves_every_mass: bool, values: dict[str, float]) -> dict[str, float]:
        """Derive K_p, K_d, K_i from frequency, damping ratio and integral time, or the reverse.

        Args:
            serves_every_mass: True if frequency, damping ratio and integral time are given.
            values: values given by the user, by key.

        Returns:
            Values of all keys: K_p (1/s²), K_d (1/s), K_i (1/s³), frequency (Hz), damping ratio,
            integral time (s).
        """
        if serves_every_mass:
            omega = 2.0 * pi * values.get("frequency", 10.0 / pi)
            K = omega**2
            D = 2.0 * omega * values.get("damping_ratio", 1.0)
            K_i = K / values.get("integral_time", inf)
        elif {"stiffness", "damping"} <= values.keys():
            K = values["stiffness"]
            D = values["damping"]
            K_i = values.get("integral", 0.0)
        else:
            raise refuse("give stiffness (1/s²) and damping (1/s) together, or frequency (Hz)")
        return {
            "stiffness": K,
            "damping": D,
            "integral": K_i,
            "frequency": sqrt(K) / (2.0 * pi),
            "damping_ratio": D / (2.0 * sqrt(K)) if K > 0.0 else 0.0,
            "integral_time": K / K_i if K_i > 0.0 else inf,
        }


class ForceGains(_GainsOfOneLoop):
    """Gains of the force law α_u = α_s + K_i ∫(α_s − α_meas) dt − K_v NᵀV_rel (fig. 5).

    There is no proportional gain: a rigid contact responds to a command without delay, so a
    proportional loop with gain ≥ 1 is unstable in discrete time at any rate.

    Example:
        >>> gains = osc.ForceGains(bandwidth=5.0, rise=0.1)
        >>> print(f"{gains.integral:.1f} 1/s, {gains.brake:.1f} 1/s")
        31.4 1/s, 44.0 1/s
    """

    serving = ("bandwidth", "damping_ratio")
    numbers = ("integral", "damping", "brake")
    example = "gains.force={bandwidth: 5 Hz}"

    integral: Annotated[NotNegativeNumber, "1/s"] = _DERIVED
    """K_i = 2π `bandwidth`, the rate at which errors of the force decay; below 1 / period"""
    damping: Annotated[NotNegativeNumber, "N s/m"] = _DERIVED
    """gain K_v of the normal velocity, for a particular mass; may be given with `integral`; 0"""
    bandwidth: Positive[Frequency] = _DERIVED
    """frequency at which errors of the force decay; 5 Hz if no gain of the loop is given, 2 Hz
    with a tare"""
    damping_ratio: NotNegativeNumber = _DERIVED
    """damping ratio of a contact that oscillates with the mass behind it; above ½ no oscillation
    grows; 0.7, 1.5 with a tare if no gain of the loop is given"""
    rise: NotNegative[Time] = _DERIVED
    """duration of a step of a desired force or squeeze; 0.25 s, 0 with `integral`"""
    tilt: Annotated[Angle, Field(ge=0, le=0.8)] = _DERIVED
    """largest angle by which the assumed normal of a face is turned when the motion of a sliding
    point shows an error ([tuning](tuning.md#why)); 10 deg, 0 with `integral`"""
    brake: Annotated[NotNegativeNumber, "1/s"] = _DERIVED
    """gain κ = 2 `damping_ratio` K_i of the normal velocity, a force of κ(NᵀΦN)⁻¹ per velocity; may
    be given with `integral`"""

    @property
    def drift(self) -> float:
        """Rate (1/s) below which normal velocities are attributed to a tilted face, not braked."""
        return self.integral / _UNBRAKED

    @property
    def hold_brake(self) -> float:
        """Brake (1/s) of contacts that hold at zero desired force: κ ≥ 2 K_i; 0 without κ."""
        return max(self.brake, 2.0 * self.integral) if self.brake > 0.0 else 0.0

    @property
    def hold_integral(self) -> float:
        """Integral gain (1/s) of such contacts: K_i, at most a twelfth of their brake."""
        return min(self.integral, self.hold_brake / _HELD) if self.brake > 0.0 else self.integral

    def _derive_gains(self, serves_every_mass: bool, values: dict[str, float]) -> dict[str, float]:
        """Derive K_i and κ from bandwidth and damping ratio, or the reverse.

        Args:
            serves_every_mass: True if bandwidth and damping ratio determine the gains.
            values: values given by the user, by key.

        Returns:
            Values of all keys: K_i (1/s), K_v (N s/m), bandwidth (Hz), damping ratio, rise (s),
            tilt (rad), κ (1/s).
        """
        K_i = 2.0 * pi * values.get("bandwidth", 5.0)
        brake = 2.0 * values.get("damping_ratio", 0.7) * K_i
        if not serves_every_mass:
            if "integral" not in values:
                raise refuse(
                    "damping (N s/m) goes with integral (1/s); give both, or damping_ratio"
                )
            K_i = values["integral"]
            brake = values.get("brake", 0.0)
        return {
            "integral": K_i,
            "damping": 0.0,
            "bandwidth": K_i / (2.0 * pi),
            "damping_ratio": brake / (2.0 * K_i) if K_i > 0.0 else 0.0,
            "rise": 0.25 if serves_every_mass else 0.0,
            "tilt": radians(10.0) if serves_every_mass else 0.0,
            "brake": brake,
        }


class Gains(OrderedSpec):
    """Gains of the two loops; the default gains suit every mass ([tuning](tuning.md)).

    Example:
        >>> gains = osc.Gains(osc.MotionGains(frequency=3.0), osc.ForceGains(bandwidth=8.0))
        >>> print(gains.replaced(force=osc.ForceGains(bandwidth=2.0)).motion.frequency)
        3.0
    """

    motion: MotionGains = MotionGains()
    """the motion loop: `frequency` and `damping_ratio`, or `stiffness` and `damping`"""
    force: ForceGains = ForceGains()
    """the force loop: `bandwidth`, `damping_ratio` and `rise`, or `integral` and `damping`"""
