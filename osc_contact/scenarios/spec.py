"""What every group of settings is: keys of a file with units and bounds, and a value in Python."""

from __future__ import annotations

import ast
import inspect
import reprlib
import textwrap
from collections.abc import Iterable
from difflib import get_close_matches
from itertools import pairwise
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from osc_contact.errors import InvalidInputError

__all__ = ["Spec", "did_you_mean", "meaning", "refuse", "sentence"]

_SHAPES = {
    "tuple_type": "a list",
    "list_type": "a list",
    "string_type": "text",
    "model_type": "a group of keys",
    "dict_type": "a group of keys",
    "model_attributes_type": "a group of keys",
}
_SIGNS = {
    "greater_than": (">", "gt"),
    "greater_than_equal": (">=", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("<=", "le"),
}
MANY = 8  #: names beside a guess
SHOWN = 12  #: names without one


class Spec(BaseModel):
    """A group of settings: frozen, finite, no unknown keys, built when first used.

    The same class is read from a file and made in Python, by keys or by position, in SI or as text
    with a unit: `SafetySettings(overforce_time="150 ms")`. The docstring of a key is its row in
    docs/scenario.md, and the hint where a file leaves out a key that it must give.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

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

    def replaced(self, **keys: Any) -> Self:
        """The same with other values of some keys, checked anew.

        Raises:
            InvalidInputError: they do not fit together.
        """
        given = {key: getattr(self, key) for key in self.model_fields_set}
        return type(self)(**given | keys)


def refuse(text: str) -> PydanticCustomError:
    """Build the error of a refused value; `text`: the mistake and its cure."""
    return PydanticCustomError("refused", "{text}", {"text": text})


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'? known: ..." for a word that is not among `known`.

    Long lists are left out where there is a guess, and cut where there is none.
    """
    names = list(known)
    near = get_close_matches(word, names, n=2, cutoff=0.6)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else ""
    if near and len(names) > MANY:
        return hint
    more = f", … ({len(names)} in all)" if len(names) > SHOWN else ""
    listed = ", ".join(names[:SHOWN]) or "none"
    return f"{hint} known: {listed}{more}".lstrip()


def meaning(owner: type, key: str) -> str | None:
    """The docstring of a model's key, read from its source when it is needed."""
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
        sign, limit = _SIGNS[kind]
        return f"must be {sign} {context[limit]:g}; {got}"
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
