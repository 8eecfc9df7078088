"""Quantities of a scenario file: a number in SI or a string with a unit that must fit."""

import ast
import functools
import inspect
import math
import re
import reprlib
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from itertools import pairwise
from numbers import Real
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar, dataclass_transform, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError, core_schema

from osc_contact.errors import InvalidInputError, did_you_mean

# What every group of settings is: keys of a file with units and bounds, and a value in Python.


_SHAPES = {
    "tuple_type": "a list",
    "list_type": "a list",
    "string_type": "text",
    "model_type": "a group of keys",
    "dict_type": "a group of keys",
    "model_attributes_type": "a group of keys",
}
_SIGNS = {
    "greater_than": ">",
    "greater_than_equal": ">=",
    "less_than": "<",
    "less_than_equal": "<=",
}


class _Source(str):
    """A piece of source as `help` prints it: without quotes."""

    def __repr__(self) -> str:
        return str(self)


class _Written:
    """Descriptor of a group's class: its signature with the types and groups as they are written.

    Types are shown without bounds and units, a default that is a group by its class.
    """

    def __get__(self, group: object, owner: type[BaseModel]) -> inspect.Signature:
        texts: dict[str, object] = {}
        for base in reversed(owner.__mro__):
            texts |= inspect.get_annotations(base)
        parameters = []
        for key, item in owner.model_fields.items():
            default: object = inspect.Parameter.empty
            if not item.is_required():
                value = item.get_default(call_default_factory=True)
                name = type(value).__name__
                default = _Source(f"{name}()") if isinstance(value, BaseModel) else value
            match ast.parse(text := str(texts[key]), mode="eval").body:
                case ast.Subscript(ast.Name("Annotated"), ast.Tuple([shown, *_])):
                    text = ast.unparse(shown)
            kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
            parameters.append(
                inspect.Parameter(key, kind, default=default, annotation=_Source(text))
            )
        return inspect.Signature(parameters, __validate_parameters__=False)


class Spec(BaseModel):
    """A group of settings: frozen, finite, no unknown keys, built when first used.

    The same class is read from a file and made in Python, by keys or by position, in SI or as text
    with a unit: `SafetySettings(overforce_time="150 ms")`. The docstring of a key is its row in
    docs/scenario.md, and the hint where a file leaves out a key that it must give.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    __signature__ = _Written()

    @classmethod
    def __pydantic_on_complete__(cls) -> None:
        """Keep the signature: pydantic replaces it by one that spells out the types of all keys."""
        cls.__signature__ = _Written()

    def __init__(self, *values: Any, **keys: Any) -> None:
        """Take values in the order of the keys, or by their names.

        Raises:
            InvalidInputError: with all complaints.
        """
        names = list(type(self).model_fields)[: len(values)]
        try:
            super().__init__(**dict(zip(names, values, strict=True)), **keys)
        except ValidationError as error:
            found = []
            for item in error.errors(include_url=False):
                place = item["loc"]
                text = sentence(item, type(self) if len(place) == 1 else None)
                found.append(f"{'.'.join(map(str, place))}: {text}".removeprefix(": "))
            raise InvalidInputError(f"{type(self).__name__}: {'; '.join(found)}") from error

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # files need no call of it

    def replaced(self, **keys: object) -> Self:
        """Copy with other values of some keys, which are checked.

        Raises:
            InvalidInputError: the values do not fit together.
        """
        given = {key: getattr(self, key) for key in self.model_fields_set}
        return type(self)(**given | keys)


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass

    @dataclass_transform(field_specifiers=(Field,))
    class _ByPosition(ModelMetaclass):
        """Metaclass that lets type checkers accept keys by position; pydantic's wants names."""

else:
    _ByPosition = type(BaseModel)


class OrderedSpec(Spec, metaclass=_ByPosition):
    """A group that programs make: keys without a default come first.

    Type checkers let it be made by position, too, of numbers in SI.
    """


def one_of(known: Mapping[str, object]) -> AfterValidator:
    """Accepts the names that are registered in `known` by then."""

    def check(value: str) -> str:
        if value not in known:
            *names, last = map(repr, known)
            raise refuse(f"expected {', '.join(names)} or {last}; got {value!r}")
        return value

    return AfterValidator(check)


def refuse(text: str) -> PydanticCustomError:
    """Build the error of a refused value; `text`: the mistake and its cure."""
    return PydanticCustomError("refused", "{text}", {"text": text})


def meaning(owner: type, key: str) -> str | None:
    """The docstring of a model's key in one line, read from its source when it is needed."""
    for base in (*owner.__mro__, getattr(owner, "describes", object)):
        if key in inspect.get_annotations(base) and key in (texts := _docstrings_of_keys(base)):
            return texts[key]
    return None  # made without a file, or for a quantity, and no ancestor has the source


@functools.cache  # a class's source is found by parsing its whole file
def _docstrings_of_keys(model: type) -> Mapping[str, str]:
    """The docstring below each annotated name of a class, in one line; empty without a source."""
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    except (OSError, TypeError, SyntaxError):
        return {}
    texts = {}
    for line, after in pairwise(getattr(tree, "body", [])):
        match line, after:
            case ast.AnnAssign(ast.Name(name)), ast.Expr(ast.Constant(text)):
                texts[name] = " ".join(str(text).split())
    return texts


def sentence(item: ErrorDetails, owner: type[BaseModel] | None) -> str:
    """Our wording of one of pydantic's complaints.

    Args:
        item: the complaint. owner: the model of its last key.
    """
    kind = item["type"]
    context = item.get("ctx", {})
    got = f"got {reprlib.repr(item['input'])}"
    if kind in ("missing", "extra_forbidden"):
        key = item["loc"][-1]
        if kind == "extra_forbidden":
            return f"unknown key; {did_you_mean(str(key), owner.model_fields if owner else {})}"
        if isinstance(key, int):
            return f"the list is too short: its item {key} is missing"
        hint = meaning(owner, key) if owner else None
        return f"the key {key!r} is missing" + (f": {hint}" if hint else "")
    if kind in _SHAPES:
        return f"expected {_SHAPES[kind]}; {got}"
    if kind in _SIGNS:
        (limit,) = context.values()
        return f"must be {_SIGNS[kind]} {limit:g}; {got}"
    if kind == "literal_error":
        return f"expected {context['expected']}; {got}"
    if kind == "string_pattern_mismatch":
        return f"expected a name of letters, digits, _ and -, beginning with a letter or _; {got}"
    if kind in ("too_short", "too_long", "string_too_short"):
        least = context.get("min_length")
        most = context.get("max_length")
        unit = "characters" if kind.startswith("string") else "items"
        return f"expected at {f'least {least}' if most is None else f'most {most}'} {unit}; {got}"
    return item["msg"]


_SPELLINGS = re.compile(r"(μ|u)[ms]\b.*|.*s(\^?[23])")  # Greek mu, ASCII beside µ and s²
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


Q = TypeVar("Q", bound=float)


class OfQuantity(Spec):
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
    units: dict[str, Decimal] = field(hash=False)
    open: bool = False  #: whether it may be infinite: no limit

    @property
    def expected(self) -> str:
        """Description of a valid value for messages, for example "a length in m, mm, cm, µm"."""
        shown = [unit for unit in self.units if not _SPELLINGS.fullmatch(unit)]
        return f"{self.kind} in {', '.join(shown)}" if shown else self.kind

    def parse(self, value: object) -> float:
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
        """Convert text with a number and a unit, such as "5 mm", to SI."""
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
        self, source: object, handler: GetCoreSchemaHandler
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
T = TypeVar("T")
Positive = Annotated[T, Field(gt=0)]
NotNegative = Annotated[T, Field(ge=0)]
NotEmpty = Annotated[tuple[T, ...], Field(min_length=1)]
PositiveNumber = Positive[Number]
NotNegativeNumber = NotNegative[Number]

# What is limited up to there; .inf in a file: no limit, see `may_be_infinite`.
Limit = Positive[Annotated[float, replace(_NUMBER, open=True)]]
ForceLimit = Positive[Annotated[float, replace(_FORCE, open=True)]]
LengthLimit = Positive[Annotated[float, replace(_LENGTH, open=True)]]
TimeLimit = Positive[Annotated[float, replace(_TIME, open=True)]]
VelocityLimit = Positive[Annotated[float, replace(_LENGTH_RATES[0], open=True)]]


def may_be_infinite(field: FieldInfo) -> bool:
    """Whether a key is a limit that may be left out by .inf, also one that may be null."""
    parts = (field.annotation, *get_args(field.annotation))
    marks = [*field.metadata, *(mark for part in parts for mark in get_args(part)[1:])]
    return any(getattr(mark, "open", False) for mark in marks)


def _three(what: str) -> BeforeValidator:
    """Validator that refuses values other than sequences of three items."""

    def check(value: object) -> object:
        if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 3:
            raise refuse(f"expected {what}; got {value!r}")
        return value

    return BeforeValidator(check)


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


Vec3 = Annotated[tuple[Length, Length, Length], _three("three lengths [x, y, z]")]
ForceVec3 = Annotated[tuple[Force, Force, Force], _three("three forces [x, y, z]")]
AngleVec3 = Annotated[tuple[Angle, Angle, Angle], _three("three angles [roll, pitch, yaw]")]
UnitVec3 = Annotated[
    tuple[Number, Number, Number],
    _three("a direction of three numbers [x, y, z]"),
    AfterValidator(unit_vector),
]
