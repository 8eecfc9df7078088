"""Pydantic's complaints → key and text as the reader of a scenario file needs them."""

from __future__ import annotations

import ast
import inspect
import reprlib
import textwrap
import types
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from .checks import Problem, did_you_mean, sound_problems
from .contact_types import CONTACT_TYPES, ContactSpec
from .document import Key

__all__ = ["complaints"]

_SHAPES = {
    "tuple_type": "a list", "list_type": "a list", "string_type": "text",
    "model_type": "a group of keys", "dict_type": "a group of keys",
    "model_attributes_type": "a group of keys",
}  # fmt: skip
_SIGNS = {
    "greater_than": (">", "gt"), "greater_than_equal": (">=", "ge"), "less_than": ("<", "lt"),
}  # fmt: skip
_TAGS = (
    "constant, step, sine, minimum_jerk, jerk_limited or points for a signal; linear or angular "
    "for a move; for a contact "
)


def complaints(error: ValidationError, data: Any, root: type[BaseModel]) -> Iterator[Problem]:
    """Yield key and text of every complaint; checks across keys run on what is sound.

    Args:
        error: pydantic's. data: what was validated. root: model of the whole file.
    """
    for item in error.errors(include_url=False):
        place, owner = _locate(item["loc"], root)
        context = item.get("ctx", {})
        if item["type"] == "too_short" and len(item["input"]) >= context["min_length"]:
            continue  # long enough but for items that are refused themselves
        if item["type"] == "missing" and isinstance(place[-1], int):
            yield place[:-1], f"the list is too short: its item {place[-1]} is missing"
        elif item["type"] == "missing":
            hint = told_of(owner, str(place[-1])) if owner else None
            yield place[:-1], f"the key {place[-1]!r} is missing" + (f": {hint}" if hint else "")
        elif item["type"] == "extra_forbidden":
            known = owner.model_fields if owner else {}
            yield place, f"unknown key; {did_you_mean(str(place[-1]), known)}"
        elif item["type"] == "union_tag_not_found":
            yield (
                place,
                f"the key {context['discriminator']} is missing: {_TAGS}"
                + ", ".join(CONTACT_TYPES),
            )
        elif item["type"] == "union_tag_invalid":
            tag = context["discriminator"].strip("'")
            wanted = context["expected_tags"]
            yield (*place, tag), f"expected one of {wanted}; got {context['tag']!r}"
        else:
            yield place, _wording(item["type"], item["msg"], item["input"], context)
    yield from sound_problems(data)


def told_of(owner: type, key: str) -> str | None:
    """The docstring of a model's key, read from its source when it is asked for."""
    for base in owner.__mro__:
        if key not in inspect.get_annotations(base):
            continue
        try:
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        except (OSError, TypeError, SyntaxError):
            continue  # made without a file, or for a quantity: an ancestor has the source
        for line, after in pairwise(getattr(tree, "body", [])):
            named = isinstance(line, ast.AnnAssign) and getattr(line.target, "id", None) == key
            if named and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                return inspect.cleandoc(str(after.value.value))
    return None


def _wording(kind: str, message: str, value: Any, context: Mapping[str, Any]) -> str:
    """Return our wording of one of pydantic's complaints."""
    got = f"got {reprlib.repr(value)}"
    if kind in _SHAPES:
        return f"expected {_SHAPES[kind]}; {got}"
    if kind in _SIGNS:
        sign, limit = _SIGNS[kind]
        return f"must be {sign} {context[limit]:g}; {got}"
    if kind == "literal_error":
        return f"expected {context['expected']}; {got}"
    if kind == "string_pattern_mismatch":
        return f"expected a name of letters, digits, _ and -, beginning with a letter or _; {got}"
    if kind in ("too_short", "too_long", "string_too_short"):
        least, most = context.get("min_length"), context.get("max_length")
        unit = "characters" if kind.startswith("string") else "items"
        return f"expected at {f'least {least}' if most is None else f'most {most}'} {unit}; {got}"
    return message


def _locate(loc: Iterable[str | int], root: type[BaseModel]) -> tuple[Key, type[BaseModel] | None]:
    """Return a pydantic location without its union tags, and the model that owns its last key."""
    place: Key = ()
    owner: type[BaseModel] | None = None
    options: list[Any] = [root]
    for part in loc:
        tagged = [kind for kind in options if len(options) > 1 and part == _tag(kind)]
        if tagged:
            options = tagged
            continue
        only = options[0] if len(options) == 1 else None
        owner = only if _is_model(only) else None
        place = (*place, part)
        options = [inner for kind in options for inner in _inside(kind, part)]
    return place, owner


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _tag(kind: Any) -> Any:
    fields = kind.model_fields if _is_model(kind) else {}
    return next((fields[name].default for name in ("type", "kind") if name in fields), None)


def _inside(kind: Any, part: str | int) -> list[Any]:
    """Return the types that the item or key `part` of `kind` may have."""
    if _is_model(kind):
        return _options(kind.model_fields[part].annotation) if part in kind.model_fields else []
    origin, inner = get_origin(kind), get_args(kind)
    if origin is tuple and isinstance(part, int):
        return _options(inner[0] if Ellipsis in inner else inner[min(part, len(inner) - 1)])
    return _options(inner[1]) if origin is dict else []


def _options(kind: Any) -> list[Any]:
    """Return the members of a union (without None), or the type itself, without annotations."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _options(inner[0])
    if origin in (Union, types.UnionType):
        return [member for one in inner if one is not type(None) for member in _options(one)]
    return list(CONTACT_TYPES.values()) if kind is ContactSpec else [kind]
