"""Pydantic's complaints → key and text as the reader of a scenario file needs them."""

from __future__ import annotations

import types
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from .checks import Problem, sound_problems
from .contact_types import CONTACT_TYPES, ContactSpec
from .document import Key
from .spec import sentence

__all__ = ["complaints"]

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
        if item["type"] == "union_tag_not_found":
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
            yield place[:-1] if item["type"] == "missing" else place, sentence(item, owner)
    yield from sound_problems(data)


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
