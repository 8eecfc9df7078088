"""Keys of plans in scenarios, made from the declarations of stages, motions and conditions.

A motion or a condition is written as the name of its function with the arguments below it,
`along: {direction: [0, 1, 0], speed: 6 mm/s}`. A value alone is the first argument, `after: 0.3 s`;
a name alone has none, `finished`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from functools import reduce
from operator import and_, or_
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, create_model, model_validator

from osc_contact.errors import InvalidInputError
from osc_contact.lab.scenarios.bodies import PoseSpec
from osc_contact.plan import ends, motions
from osc_contact.plan.ends import End
from osc_contact.plan.motions import Motion
from osc_contact.plan.plan import Plan
from osc_contact.plan.stage import Stage
from osc_contact.settings.quantities import Force, NotEmpty, Positive, Spec, Time, refuse

MOTIONS: tuple[Callable[..., Motion], ...] = (
    motions.along,
    motions.about,
    motions.turn_to,
    motions.to,
    motions.through,
    motions.spiral,
    motions.raster,
    motions.rock,
    motions.dwell,
)
#: Conditions that files may name: all that depend on neither a function nor a recogniser.
CONDITIONS: tuple[Callable[..., End], ...] = (
    ends.made,
    ends.lost,
    ends.moved,
    ends.pressed,
    ends.at_rest,
    ends.after,
    ends.finished,
)
#: Fields of a stage that depend on a function or a recogniser, and are left to Python.
LEFT_TO_PYTHON = ("places", "may_touch")


class CallKeys(Spec):
    """Arguments of a function that makes a motion or a condition, by their names.

    Attributes:
        describes: the function.
    """

    describes: ClassVar[Any]

    @model_validator(mode="before")
    @classmethod
    def _first(cls, value: Any) -> Any:
        """Take a value that is not a group of keys as the first argument; None: no arguments."""
        if value is None:
            return {}
        if isinstance(value, Mapping | CallKeys):
            return value
        first = next(iter(cls.model_fields), None)
        if first is None:
            raise refuse(f"{cls.describes.__name__} has no arguments; got {value!r}")
        return {first: value}

    @model_validator(mode="after")
    def _call_once(self) -> CallKeys:
        """Refuse what the function refuses, with its own message."""
        try:
            self.made()
        except InvalidInputError as error:
            raise refuse(str(error)) from error
        return self

    def made(self) -> Any:
        """Call the function that the keys describe, with their values as arguments.

        Keys without a value are left out, so that the function's defaults apply; poses become
        `pin.SE3`.

        Returns:
            A motion or a condition of a stage.
        """
        values: list[Any] = []
        named: dict[str, Any] = {}
        for name, parameter in inspect.signature(self.describes).parameters.items():
            value = getattr(self, name)
            if value is None:
                continue
            if isinstance(value, PoseSpec):
                value = pin.SE3(pin.rpy.rpyToMatrix(*value.rpy), np.array(value.xyz))
            if parameter.kind is parameter.VAR_POSITIONAL:
                values.extend(value)
            else:
                named[name] = value
        return self.describes(*values, **named)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the name of the function, because models made at run time have no module."""
        return _blank, (self.describes.__name__,), self.__getstate__()


def _key_type(hint: Any) -> Any:
    """Type of a key from that of an argument; functions of the signals are left to Python.

    Args:
        hint: type of the argument, with its quantity as an annotation.
    """
    members = get_args(hint)
    if get_origin(hint) is Annotated and members[0] == ArrayLike:
        return members[1]
    if get_origin(hint) in (Union, UnionType):
        kept = [_key_type(member) for member in members if get_origin(member) is not _FUNCTION]
        return reduce(or_, kept)
    return PoseSpec if hint is pin.SE3 else hint


_FUNCTION = get_origin(Callable[[], None])  #: origin of the types of functions


def _listed(value: Any) -> Any:
    """Make a list of a value alone."""
    return value if isinstance(value, list | tuple) else [value]


def _listed_type(kind: Any, least: int = 1) -> Any:
    """Type of a list, or of an item alone.

    Args:
        kind: type of an item.
        least: least number of items.
    """
    items: Any = tuple[kind, ...]
    return Annotated[items, Field(min_length=least), BeforeValidator(_listed)]


def _keys_of(function: Callable[..., Any]) -> type[CallKeys]:
    """Make the model of the keys that are the arguments of a function of a plan.

    Each argument becomes a key of the same name, with type, default and description of the
    function.

    Args:
        function: function of `MOTIONS` or `CONDITIONS`, its arguments annotated with quantities.
    """
    hints = get_type_hints(function, include_extras=True)
    keys: dict[str, Any] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        kind = _key_type(hints[name])
        value = parameter.default
        if parameter.kind is parameter.VAR_POSITIONAL:
            kind = _listed_type(kind)
        if isinstance(value, np.ndarray):
            value = tuple(value.tolist())
        text = described(function, name)
        if value is parameter.empty:
            keys[name] = (kind, Field(description=text))
        else:
            keys[name] = _optional(kind, value, text)
    name = f"{function.__name__.title().replace('_', '')}Keys"
    model = create_model(
        name, __base__=CallKeys, __module__=__name__, __doc__=function.__doc__, **keys
    )
    model.describes = staticmethod(function)
    return model


def described(documented: Any, name: str) -> str:
    """Text on an argument or attribute in a docstring, or the first sentence of the docstring.

    Functions of the signals are left out, which only Python has; no value is null in files.

    Args:
        documented: function or class.
        name: argument or attribute.
    """
    text = re.sub(
        r",? or a function of the signals[ a-z]*", "", inspect.cleandoc(documented.__doc__)
    )
    text = re.sub(r"\b(None|inf):", "null:", text)
    entry = re.search(rf"^    {name}: (.*(?:\n {{8}}.*)*)", text, re.M)
    return " ".join((entry[1] if entry else text.split("\n\n")[0]).split()).rstrip(".")


def _optional(kind: Any, default: Any, text: str) -> tuple[Any, Any]:
    """Type and default of an optional key; JSON has no infinity, which becomes null.

    Args:
        kind: type of the key.
        default: default in Python.
        text: what the key means.
    """
    if default is None or default == np.inf:
        return kind | None, Field(None, description=text)
    return kind, Field(default, description=text)


_MODELS = {function.__name__: _keys_of(function) for function in (*MOTIONS, *CONDITIONS)}


def _blank(function: str) -> CallKeys:
    """Make the arguments of a function without values, which unpickling sets."""
    model = _MODELS[function]
    return model.__new__(model)


class ChoiceKeys(Spec):
    """One of several functions with its arguments."""

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        """Take a name alone as a function without arguments."""
        return {value: {}} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _one(self) -> ChoiceKeys:
        """Refuse none or several functions."""
        if len(self.chosen) != 1:
            known = ", ".join(key for key in type(self).model_fields if key != "lasting")
            found = " and ".join(self.chosen) or "none"
            raise refuse(f"expected one of {known}; got {found}")
        return self

    @property
    def chosen(self) -> list[str]:
        """Names of the functions that are given."""
        names = [name for name in type(self).model_fields if name != "lasting"]
        return [name for name in names if getattr(self, name) not in (None, ())]


def _choices(functions: tuple[Callable[..., Any], ...]) -> dict[str, Any]:
    """Keys of a choice between functions, each without a value.

    Args:
        functions: functions by whose names the keys are called.
    """
    return {
        function.__name__: _optional(_MODELS[function.__name__], None, described(function, ""))
        for function in functions
    }


def _made(name: str, base: type[Spec], text: str, keys: dict[str, Any]) -> Any:
    """Make a model of this module at run time.

    Args:
        name: name of the model in this module, by which it is pickled.
        base: base class.
        text: docstring.
        keys: type and default of each key.
    """
    return create_model(name, __base__=base, __module__=__name__, __doc__=text, **keys)


MotionKeys = _made(
    "MotionKeys",
    ChoiceKeys,
    "A motion of a stage: a function of `osc_contact.plan.motions` with its arguments.",
    _choices(MOTIONS),
)
_CONDITIONS_TYPE: Any = "tuple[ConditionKeys, ...]"
ConditionKeys = _made(
    "ConditionKeys",
    ChoiceKeys,
    "A condition: a function of `osc_contact.plan.ends`, or several joined by all or any.",
    {
        **_choices(CONDITIONS),
        "all": (_CONDITIONS_TYPE, Field((), description="conditions that are met together")),
        "any": (_CONDITIONS_TYPE, Field((), description="conditions one of which is met")),
        "lasting": _optional(Positive[Time], None, described(End.lasting, "seconds")),
    },
)
ConditionKeys.model_rebuild(_types_namespace={"ConditionKeys": ConditionKeys})


def motion_of(keys: Any) -> Motion:
    """Motion of `MotionKeys`."""
    (name,) = keys.chosen
    motion: Motion = getattr(keys, name).made()
    return motion


def condition_of(keys: Any) -> End:
    """Make the condition that ends a stage from its keys.

    Args:
        keys: `ConditionKeys`: one condition, or `all` or `any` of several, and `lasting` (s; None:
            the condition holds at once).
    """
    (name,) = keys.chosen
    value = getattr(keys, name)
    if name in ("all", "any"):
        end = reduce(and_ if name == "all" else or_, map(condition_of, value))
    else:
        end = value.made()
    return end if keys.lasting is None else end.lasting(keys.lasting)


#: Types of the keys of a stage whose fields hold objects of Python.
_STAGE_TYPES: dict[str, Any] = {
    "forces": dict[str, _listed_type(Force)],  # type: ignore[misc]  # made at run time
    "motion": _listed_type(MotionKeys, least=0),
    "until": ConditionKeys,
    "unless": ConditionKeys,
}


def _stage_keys() -> dict[str, Any]:
    """Make the keys of a stage from the fields of `Stage`: types, defaults and descriptions.

    Returns:
        Arguments for pydantic's `create_model`, by key. Fields in `LEFT_TO_PYTHON` have no keys.
    """
    hints = get_type_hints(Stage, include_extras=True)
    keys: dict[str, Any] = {}
    for item in fields(Stage):
        if item.name in LEFT_TO_PYTHON:
            continue
        kind = _STAGE_TYPES.get(item.name, hints[item.name])
        text = described(Stage, item.name)
        if item.name == "forces":
            keys[item.name] = (kind, Field(default_factory=dict, description=text))
        elif item.name == "motion":
            keys[item.name] = (kind, Field((), description=text))
        elif item.default is MISSING:
            keys[item.name] = (kind, Field(description=text))
        else:
            keys[item.name] = _optional(kind, item.default, text)
    return keys


class _StageKeys(Spec):
    """Base of the keys of a stage."""

    describes: ClassVar[Any] = Stage

    def made(self) -> Stage:
        """Make the stage from its keys.

        Forces of one number become numbers; several motions are combined; without a motion the
        stage rests.

        Raises:
            InvalidInputError: the stage refuses a value.
        """
        values = {
            name: value
            for name in type(self).model_fields
            if (value := getattr(self, name)) is not None
        }
        forces = {
            name: force[0] if len(force) == 1 else force for name, force in values["forces"].items()
        }
        objects = {
            "forces": forces,
            "motion": reduce(and_, map(motion_of, values["motion"] or (MotionKeys(dwell={}),))),
            "until": condition_of(values["until"]),
        }
        if "unless" in values:
            objects["unless"] = condition_of(values["unless"])
        return Stage(**values | objects)


if TYPE_CHECKING:
    StageKeys = _StageKeys
else:
    StageKeys = _made("StageKeys", _StageKeys, "A stage of a plan.", _stage_keys())


class PlanKeys(Spec):
    """A plan as data, with the words of `Plan`, `Stage`, and the motions and conditions.

    Example:
        >>> from osc_contact.lab.scenarios.plan_keys import PlanKeys
        >>> press = {"name": "press", "forces": {"edge": "10 N"}, "until": {"after": "0.2 s"}}
        >>> plan = PlanKeys(stages=[press | {"within": "1 s"}]).made()
        >>> print(plan.contacts, plan.stages[0].until.words)
        ('edge',) after 0.2 s
    """

    stages: NotEmpty[StageKeys]
    """the stages in their order"""
    largest: Positive[Force] | None = None
    """measured force of the object on its environment above which a stage has failed; null: none"""
    tries: Annotated[int, Field(ge=1)] = 3
    """number of failures that end the plan"""

    @model_validator(mode="after")
    def _make_once(self) -> PlanKeys:
        """Refuse what stages and plan refuse, with their own messages."""
        try:
            self.made()
        except InvalidInputError as error:
            raise refuse(str(error)) from error
        return self

    def made(self) -> Plan:
        """Make a new plan."""
        stages = [stage.made() for stage in self.stages]
        if self.largest is None:
            return Plan(stages, tries=self.tries)
        return Plan(stages, largest=self.largest, tries=self.tries)
