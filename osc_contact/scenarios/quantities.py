"""Quantities of a scenario file: a number in SI or a string with a unit that must fit."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from numbers import Real
from typing import Annotated, Any, Generic, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
)
from pydantic_core import CoreSchema, core_schema

from osc_contact.scenarios.spec import Spec, refuse

__all__ = [
    "Acceleration",
    "Angle",
    "AngularAcceleration",
    "AngularJerk",
    "AngularVelocity",
    "AngleVec3",
    "Dimension",
    "Force",
    "ForceRate",
    "ForceRate2",
    "ForceLimit",
    "ForceRate3",
    "Frequency",
    "Jerk",
    "JointForce",
    "JointValue",
    "Length",
    "LengthLimit",
    "Limit",
    "Mass",
    "NotNegative",
    "Number",
    "OfQuantity",
    "Positive",
    "Time",
    "TimeLimit",
    "Torque",
    "UnitVec3",
    "Vec3",
    "Velocity",
    "VelocityLimit",
    "unit_vector",
]

_SPELLINGS = re.compile(r"(μ|u)[ms]\b.*|.*s(\^?[23])")  # Greek mu, ASCII beside µ and s²
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


Q = TypeVar("Q", bound=float)


class OfQuantity(Spec, Generic[Q]):
    """Base that names a parametrised model after its quantity: `Step[a force]`."""

    @classmethod
    def model_parametrized_name(cls, params: tuple[Any, ...]) -> str:
        for mark in getattr(params[0], "__metadata__", ()):
            if isinstance(mark, Dimension):
                return f"{cls.__name__}[{mark.kind}]"
        return super().model_parametrized_name(params)


@dataclass(frozen=True)
class Dimension:
    """One physical dimension: its article and name, and its units with their size in SI.

    Used as ``Annotated[float, Dimension(...)]``: accepts a finite number or "50 mm"."""

    kind: str
    units: dict[str, Decimal]
    open: bool = False  #: whether it may be infinite: no limit

    def __hash__(self) -> int:
        return hash(self.kind)

    @property
    def expected(self) -> str:
        """What a reader should write, as in "a length in m, mm, cm, µm"."""
        shown = [unit for unit in self.units if not _SPELLINGS.fullmatch(unit)]
        return f"{self.kind} in {', '.join(shown)}" if shown else self.kind

    def parse(self, value: Any) -> float:
        """Return `value` in SI.

        Raises:
            PydanticCustomError: not a number, not finite, or a unit of another dimension."""
        if isinstance(value, str):
            number = self._parse_text(value)
        elif isinstance(value, Real) and not isinstance(value, bool):
            try:
                number = float(value)
            except OverflowError:
                number = math.inf
        else:
            raise refuse(f"expected {self.expected}; got {value!r}")
        if not (math.isfinite(number) or (self.open and number == math.inf)):
            raise refuse(f"expected {self.expected}; got {value!r}, which is not finite")
        return number

    def _parse_text(self, text: str) -> float:
        match = _QUANTITY.fullmatch(text)
        if match is None:
            raise refuse(f"expected {self.expected}; got {text!r}, which is no number")
        digits, unit = match.groups()
        if not unit:
            return float(digits)
        if unit not in self.units:
            kinds = [other.kind for other in _DIMENSIONS if unit in other.units]
            why = f"which is {kinds[0]}" if kinds else f"and {unit!r} is not a known unit"
            raise refuse(f"expected {self.expected}; got {text!r}, {why}")
        try:
            return float(Decimal(digits) * self.units[unit])
        except ArithmeticError:
            return math.inf

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        number = core_schema.float_schema(allow_inf_nan=self.open)
        return core_schema.no_info_before_validator_function(self.parse, number)


def _units(sizes: str) -> dict[str, Decimal]:
    pairs = (item.split("=") for item in sizes.split())
    return {unit: Decimal(size) for unit, size in pairs}


_LENGTH = Dimension("a length", _units("m=1 mm=1e-3 cm=1e-2 µm=1e-6 μm=1e-6 um=1e-6"))
_ANGLE = Dimension("an angle", _units("rad=1 mrad=1e-3") | {"deg": Decimal(math.pi) / 180})
_TIME = Dimension("a time", _units("s=1 ms=1e-3 µs=1e-6 μs=1e-6 us=1e-6 min=60"))
_FREQUENCY = Dimension("a frequency", _units("Hz=1 kHz=1e3"))
_FORCE = Dimension("a force", _units("N=1 mN=1e-3 kN=1e3"))
_TORQUE = Dimension("a torque", _units("Nm=1 mNm=1e-3"))
_MASS = Dimension("a mass", _units("kg=1 g=1e-3"))
_NUMBER = Dimension("a plain number", {})
_JOINT_FORCE = Dimension("a joint force (torque or force)", _TORQUE.units | _FORCE.units)
_JOINT_VALUE = Dimension("a joint value (length or angle)", _LENGTH.units | _ANGLE.units)


def _rates(of: Dimension) -> tuple[Dimension, Dimension, Dimension]:
    """The first three time derivatives of a quantity: mm/s, mm/s², mm/s³ (or s^2, s2)."""

    def rate(power: str, *spellings: str) -> Dimension:
        per = (power, *spellings)
        units = {f"{u}/s{p}": size for p in per for u, size in of.units.items()}
        return Dimension(f"{of.kind} per s{power}", units)

    return rate(""), rate("²", "^2", "2"), rate("³", "^3", "3")


_LENGTH_RATES, _ANGLE_RATES, _FORCE_RATES = map(_rates, (_LENGTH, _ANGLE, _FORCE))
_DIMENSIONS = (
    _LENGTH,
    _ANGLE,
    _TIME,
    _FREQUENCY,
    _FORCE,
    _TORQUE,
    _MASS,
    *_LENGTH_RATES,
    *_ANGLE_RATES,
    *_FORCE_RATES,
)

Length = Annotated[float, _LENGTH]
Angle = Annotated[float, _ANGLE]
Time = Annotated[float, _TIME]
Frequency = Annotated[float, _FREQUENCY]
Force = Annotated[float, _FORCE]
Torque = Annotated[float, _TORQUE]
Mass = Annotated[float, _MASS]
Velocity = Annotated[float, _LENGTH_RATES[0]]
Acceleration = Annotated[float, _LENGTH_RATES[1]]
Jerk = Annotated[float, _LENGTH_RATES[2]]
AngularVelocity = Annotated[float, _ANGLE_RATES[0]]
AngularAcceleration = Annotated[float, _ANGLE_RATES[1]]
AngularJerk = Annotated[float, _ANGLE_RATES[2]]
ForceRate = Annotated[float, _FORCE_RATES[0]]
ForceRate2 = Annotated[float, _FORCE_RATES[1]]
ForceRate3 = Annotated[float, _FORCE_RATES[2]]
Number = Annotated[float, _NUMBER]
JointForce = Annotated[float, _JOINT_FORCE, "N m, N"]
JointValue = Annotated[float, _JOINT_VALUE, "m, rad"]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]

# What is limited up to there; .inf in a file: no limit.
_LIMIT = Field(gt=0)
Limit = Annotated[float, replace(_NUMBER, open=True), _LIMIT]
ForceLimit = Annotated[float, replace(_FORCE, open=True), _LIMIT]
LengthLimit = Annotated[float, replace(_LENGTH, open=True), _LIMIT]
TimeLimit = Annotated[float, replace(_TIME, open=True), _LIMIT]
VelocityLimit = Annotated[float, replace(_LENGTH_RATES[0], open=True), _LIMIT]


def _three(what: str) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:
        if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 3:
            raise refuse(f"expected {what}; got {value!r}")
        return value

    return check


def unit_vector(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return v/|v|; a vector already of unit length comes back bit by bit.

    Raises:
        PydanticCustomError: |v| is zero (below 1e-12)."""
    norm = math.hypot(*value)
    if not 1e-12 < norm < math.inf:
        raise refuse(f"expected a direction [x, y, z]; got {list(value)}, whose length is {norm:g}")
    if abs(norm - 1.0) <= 4e-16:
        return value
    return (value[0] / norm, value[1] / norm, value[2] / norm)


Vec3 = Annotated[tuple[Length, Length, Length], BeforeValidator(_three("three lengths [x, y, z]"))]
ForceVec3 = Annotated[tuple[Force, Force, Force], BeforeValidator(_three("three forces [x, y, z]"))]
AngleVec3 = Annotated[
    tuple[Angle, Angle, Angle], BeforeValidator(_three("three angles [roll, pitch, yaw]"))
]
UnitVec3 = Annotated[
    tuple[Number, Number, Number],
    BeforeValidator(_three("a direction of three numbers [x, y, z]")),
    AfterValidator(unit_vector),
]
