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

# Base classes of groups of settings: keys of a file with units and bounds, objects in Python.


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
    """Piece of source code, which `help` prints without quotes."""

    def __repr__(self) -> str:
        """Text without quotes."""
        return str(self)


class _Written:
    """Descriptor of the signature of a group of settings, with types as the source has them.

    Types are shown without bounds and units, a default that is a group by its class.
    """

    def __get__(self, group: object, owner: type[BaseModel]) -> inspect.Signature:
        """Make the signature of a class of settings from its annotations, as they are written.

        Args:
            group: instance of the class, which is not used; None for an access at the class.
            owner: class of settings, a Pydantic model.
        """
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
            # Annotated[Number, …] is shown as Number
            match ast.parse(text := str(texts[key]), mode="eval").body:
                case ast.Subscript(ast.Name("Annotated"), ast.Tuple([shown, *_])):
                    text = ast.unparse(shown)
            kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
            parameters.append(
                inspect.Parameter(key, kind, default=default, annotation=_Source(text))
            )
        return inspect.Signature(parameters, __validate_parameters__=False)


class Spec(BaseModel):
    """Base class of groups of settings: immutable, finite numbers, no unknown keys.

    The same class is read from a file and made in Python, by keys or by position, in SI or as text
    with a unit: `SafetySettings(overforce_time="150 ms")`. The docstring of a key is its row in
    docs/scenario.md, and the hint in the message on a file without a required key. Validators are
    built when the class is first used.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    __signature__ = _Written()

    @classmethod
    def __pydantic_on_complete__(cls) -> None:
        """Restore the signature, which pydantic replaces by a signature with full types."""
        cls.__signature__ = _Written()

    def __init__(self, *values: Any, **keys: Any) -> None:
        """Validate values, which are given in the order of the keys, or by their names.

        Args:
            *values: values of the first keys.
            **keys: values by the names of their keys.

        Raises:
            InvalidInputError: with a sentence for each invalid value.
        """
        names = list(type(self).model_fields)[: len(values)]
        try:
            super().__init__(**dict(zip(names, values, strict=True)), **keys)
        except ValidationError as error:
            sentences = []
            for item in error.errors(include_url=False):
                place = item["loc"]
                text = sentence(item, type(self) if len(place) == 1 else None)
                sentences.append(f"{'.'.join(map(str, place))}: {text}".removeprefix(": "))
            raise InvalidInputError(f"{type(self).__name__}: {'; '.join(sentences)}") from error

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # files need no call of it

    def replaced(self, **keys: object) -> Self:
        """Copy the group with other values of some keys; all values are validated.

        Keys that were never set are derived or have their defaults again.

        Args:
            **keys: new values by the names of their keys.

        Raises:
            InvalidInputError: the values do not fit together.
        """
        set_values = {key: getattr(self, key) for key in self.model_fields_set}
        return type(self)(**set_values | keys)


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass

    @dataclass_transform(field_specifiers=(Field,))
    class _ByPosition(ModelMetaclass):
        """Metaclass that lets type checkers accept keys by position; pydantic's wants names."""

else:
    _ByPosition = type(BaseModel)


class OrderedSpec(Spec, metaclass=_ByPosition):
    """Base class of groups that programs make by position, too; keys without a default come first.

    Type checkers accept values by position for it, as numbers in SI.
    """


def one_of(known: Mapping[str, object]) -> AfterValidator:
    """Make a validator of names.

    Args:
        known: mapping whose keys are the permitted names, as registered when a value is checked.
    """

    def check(value: str) -> str:
        """Return a permitted name; refuse any other one."""
        if value not in known:
            *names, last = map(repr, known)
            raise refuse(f"expected {', '.join(names)} or {last}; got {value!r}")
        return value

    return AfterValidator(check)


def refuse(text: str) -> PydanticCustomError:
    """Make the error for an invalid value, from a sentence on the mistake and its cure."""
    return PydanticCustomError("refused", "{text}", {"text": text})


def meaning(owner: type, key: str) -> str | None:
    """Docstring of a key of a group in one line, or its description; None: it has neither.

    Docstrings are read from the source; keys of models made at run time have descriptions.

    Args:
        owner: class of the group.
        key: name of the key.
    """
    for base in (*owner.__mro__, getattr(owner, "describes", object)):
        if key in inspect.get_annotations(base) and key in (texts := _docstrings_of_keys(base)):
            return texts[key]
    field = owner.model_fields.get(key) if issubclass(owner, BaseModel) else None
    return field.description if field else None


@functools.cache  # a class's source is found by parsing its whole file
def _docstrings_of_keys(model: type) -> Mapping[str, str]:
    """Docstring below each annotated name of a class, in one line; empty without a source.

    Args:
        model: class of a group of settings.
    """
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
    """Sentence on a validation error of pydantic, in the wording of this package.

    Args:
        item: the error.
        owner: class of the group that has the last key of the error's place; None: unknown.
    """
    kind = item["type"]
    context = item.get("ctx", {})
    got = f"got {reprlib.repr(item['input'])}"
    # keys that are missing or unknown
    if kind in ("missing", "extra_forbidden"):
        key = item["loc"][-1]
        if kind == "extra_forbidden":
            return f"unknown key; {did_you_mean(str(key), owner.model_fields if owner else {})}"
        if isinstance(key, int):
            return f"the list is too short: its item {key} is missing"
        hint = meaning(owner, key) if owner else None
        return f"the key {key!r} is missing" + (f": {hint}" if hint else "")
    # values of a wrong kind, sign, choice or length
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
        minimum = context.get("min_length")
        maximum = context.get("max_length")
        unit = "characters" if kind.startswith("string") else "items"
        bound = f"least {minimum}" if maximum is None else f"most {maximum}"
        return f"expected at {bound} {unit}; {got}"
    # errors of this package's own checks have their sentence already
    return item["msg"]


_SPELLINGS = re.compile(r"(μ|u)[ms]\b.*|.*s(\^?[23])")  # Greek mu, ASCII beside µ and s²
_NO_LIMIT = ".inf"  #: text of an infinite limit, as YAML has it
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


Q = TypeVar("Q", bound=float)


class OfQuantity(Spec):
    """Base class of generic groups that are named after their quantity: `Step[a force]`."""

    @classmethod
    def model_parametrized_name(cls, params: tuple[Any, ...]) -> str:
        """Name of the class with a quantity as its parameter; pydantic calls this method."""
        for mark in getattr(params[0], "__metadata__", ()):
            if isinstance(mark, Dimension):
                return f"{cls.__name__}[{mark.kind}]"
        return super().model_parametrized_name(params)


@dataclass(frozen=True)
class Dimension:
    """Physical dimension of a key: ``Annotated[float, Dimension(...)]`` accepts 0.05 and "50 mm".

    Attributes:
        kind: name with article, such as "a length".
        units: size of each unit in SI, by its symbol.
        open: True if the number may be infinite, which means no limit.
    """

    kind: str
    units: dict[str, Decimal] = field(hash=False)
    open: bool = False

    @property
    def expected(self) -> str:
        """Description of a valid value for messages, for example "a length in m, mm, cm, µm"."""
        names = [unit for unit in self.units if not _SPELLINGS.fullmatch(unit)]
        return f"{self.kind} in {', '.join(names)}" if names else self.kind

    def parse(self, value: object) -> float:
        """Convert a value of a key to SI.

        Args:
            value: a number in SI, or text with a number and a unit.

        Raises:
            PydanticCustomError: not a number, not finite, or a unit of another dimension.
        """
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
        """Convert text with a number and a unit, such as "5 mm", to SI.

        Raises:
            PydanticCustomError: no number, or a unit of another dimension.
        """
        if text == _NO_LIMIT:
            return math.inf
        match = _QUANTITY.fullmatch(text)
        if match is None:
            raise refuse(f"expected {self.expected}; got {text!r}, which is no number")
        digits, unit = match.groups()
        if not unit:
            return float(digits)
        if unit not in self.units:
            other_kinds = [other.kind for other in _DIMENSIONS if unit in other.units]
            clause = (
                f"which is {other_kinds[0]}" if other_kinds else f"and {unit!r} is not a known unit"
            )
            raise refuse(f"expected {self.expected}; got {text!r}, {clause}")
        try:
            return float(Decimal(digits) * self.units[unit])
        except ArithmeticError:
            return math.inf

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Schema of pydantic for a key of this dimension: `parse`, then bounds.

        JSON has no infinite numbers: it gets the text of a file.
        """
        number = core_schema.float_schema(allow_inf_nan=self.open)
        as_json = core_schema.plain_serializer_function_ser_schema(
            lambda x: _NO_LIMIT if x == math.inf else x, when_used="json"
        )
        return core_schema.no_info_before_validator_function(
            self.parse, number, serialization=as_json if self.open else None
        )


def _parse_units(sizes: str) -> dict[str, Decimal]:
    """Parse the sizes of units in SI from text such as "m=1 mm=1e-3"."""
    pairs = (item.split("=") for item in sizes.split())
    return {unit: Decimal(size) for unit, size in pairs}


_LENGTH = Dimension("a length", _parse_units("m=1 mm=1e-3 cm=1e-2 µm=1e-6 μm=1e-6 um=1e-6"))
_ANGLE = Dimension("an angle", _parse_units("rad=1 mrad=1e-3") | {"deg": Decimal(math.pi) / 180})
_TIME = Dimension("a time", _parse_units("s=1 ms=1e-3 µs=1e-6 μs=1e-6 us=1e-6 min=60"))
_FREQUENCY = Dimension("a frequency", _parse_units("Hz=1 kHz=1e3"))
_FORCE = Dimension("a force", _parse_units("N=1 mN=1e-3 kN=1e3"))
_TORQUE = Dimension("a torque", _parse_units("Nm=1 mNm=1e-3"))
_MASS = Dimension("a mass", _parse_units("kg=1 g=1e-3"))
_NUMBER = Dimension("a plain number", {})
_JOINT_FORCE = Dimension("a joint force (torque or force)", _TORQUE.units | _FORCE.units)
_JOINT_VALUE = Dimension("a joint value (length or angle)", _LENGTH.units | _ANGLE.units)


def _rate_dimensions(quantity: Dimension) -> tuple[Dimension, Dimension, Dimension]:
    """Dimensions of the first three time derivatives of a quantity.

    Units are for example mm/s, mm/s² (also mm/s^2 and mm/s2) and mm/s³.
    """

    def rate(power: str, *spellings: str) -> Dimension:
        """Dimension of a derivative, with "²" or "³" as `power` and other spellings of it."""
        units = {}
        for exponent in (power, *spellings):
            for unit, size in quantity.units.items():
                units[f"{unit}/s{exponent}"] = size
        return Dimension(f"{quantity.kind} per s{power}", units)

    return rate(""), rate("²", "^2", "2"), rate("³", "^3", "3")


_LENGTH_RATES, _ANGLE_RATES, _FORCE_RATES = map(_rate_dimensions, (_LENGTH, _ANGLE, _FORCE))
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
Count = NotNegative[int]

# Limits, which may be infinite (.inf in a file): no limit, see `may_be_infinite`.
Limit = Positive[Annotated[float, replace(_NUMBER, open=True)]]
ForceLimit = Positive[Annotated[float, replace(_FORCE, open=True)]]
LengthLimit = Positive[Annotated[float, replace(_LENGTH, open=True)]]
TimeLimit = Positive[Annotated[float, replace(_TIME, open=True)]]
VelocityLimit = Positive[Annotated[float, replace(_LENGTH_RATES[0], open=True)]]


def may_be_infinite(field: FieldInfo) -> bool:
    """True if a key, given by its declaration, is a limit that may be infinite (.inf in a file).

    Args:
        field: field of a group of settings.
    """
    parts = (field.annotation, *get_args(field.annotation))
    marks = [*field.metadata, *(mark for part in parts for mark in get_args(part)[1:])]
    return any(getattr(mark, "open", False) for mark in marks)


def _require_three(expected: str) -> BeforeValidator:
    """Make a validator that refuses values other than sequences of three items.

    Args:
        expected: description of a valid value, for the message.
    """

    def check(value: object) -> object:
        """Return a sequence of three items; refuse any other value."""
        if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 3:
            raise refuse(f"expected {expected}; got {value!r}")
        return value

    return BeforeValidator(check)


def unit_vector(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Normalise a direction; a vector of unit length is returned unchanged, bit by bit.

    Args:
        value: three numbers.

    Raises:
        PydanticCustomError: its length is zero (below 1e-12) or infinite.
    """
    norm = math.hypot(*value)
    if not 1e-12 < norm < math.inf:
        raise refuse(f"expected a direction [x, y, z]; got {list(value)}, whose length is {norm:g}")
    if abs(norm - 1.0) <= 4e-16:
        return value
    return (value[0] / norm, value[1] / norm, value[2] / norm)


Vec3 = Annotated[tuple[Length, Length, Length], _require_three("three lengths [x, y, z]")]
ForceVec3 = Annotated[tuple[Force, Force, Force], _require_three("three forces [x, y, z]")]
AngleVec3 = Annotated[tuple[Angle, Angle, Angle], _require_three("three angles [roll, pitch, yaw]")]
UnitVec3 = Annotated[
    tuple[Number, Number, Number],
    _require_three("a direction of three numbers [x, y, z]"),
    AfterValidator(unit_vector),
]
