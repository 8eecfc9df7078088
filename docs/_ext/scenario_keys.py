"""Keys of settings from their declarations: the tables of docs/scenario*.md, the lists of docs/api.

python docs/_ext/scenario_keys.py      rewrites these pages

A table stands between `<!-- keys: SELECTION -->` and `<!-- end of keys -->`. A selection is one or
more of: a key of a scenario (`plant`); a key inside one (`control.safety`); a key without those
below another, which have a table of their own (`control -control.safety`); the keys of one kind
(`contacts=edge_on_face`); `signals`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from osc_contact.lab.scenarios.contact_keys import ContactSpec, contact_types
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.scenarios.signals import ForceSignal
from osc_contact.settings.quantities import Dimension, Spec, meaning

DOCS = Path(__file__).parents[1]
#: Pages with tables, in the order in which a group that is used twice is described.
PAGES = [
    DOCS / f"scenario{part}.md"
    for part in ("_arms", "_contacts", "_commands", "_control", "_plant", "")
]
BLOCK = re.compile(r"(?<=<!-- keys: )(.*?) -->\n.*?(?=<!-- end of keys -->)", re.S)
HEAD = "| key | unit | range | default | meaning |\n|---|---|---|---|---|\n"
LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}


def setup(app: Any) -> dict[str, bool]:
    """As an extension of Sphinx: documented settings list their keys."""
    app.connect("autodoc-process-docstring", list_keys)
    return {"parallel_read_safe": True}


def list_keys(
    _app: Any, _what: str, _name: str, kind: Any, _options: Any, lines: list[str]
) -> None:
    """Add the keys of a group of settings to its docstring."""
    if not (isinstance(kind, type) and issubclass(kind, Spec)):
        return
    if lines[:1] == (Spec.__init__.__doc__ or "").splitlines()[:1]:  # the second of two docstrings
        lines.clear()
        return
    for key, field in kind.model_fields.items():
        text = LINK.sub(r"\1", meaning(kind, key) or "").replace("`", "``").replace("\n", " ")
        value = default(field).replace("`", "")
        about = [
            unit(field),
            limits(field),
            "required" if field.is_required() else f"default {value}",
        ]
        lines += ["", f"``{key}`` ({', '.join(part for part in about if part)}):", f"    {text}"]
    lines += [""]


def updated() -> dict[Path, str]:
    """The pages with tables of what is declared now."""
    Scenario.model_rebuild()
    first: dict[type[BaseModel], str] = {}
    found = {}
    for page in PAGES:

        def table(match: re.Match[str], page: Path = page) -> str:
            words = match[1].split()
            without = {word[1:] for word in words if word[0] == "-"}
            lines = [
                one
                for word in words
                if word[0] != "-"
                for one in selected(word, first, page.name)
                if not one.startswith(tuple(f"| `{key}." for key in without))
            ]
            return f"{match[1]} -->\n\n{HEAD}{''.join(lines)}\n"

        found[page] = BLOCK.sub(table, page.read_text(encoding="utf-8"))
    return found


def selected(word: str, first: dict[type[BaseModel], str], page: str) -> Iterator[str]:
    """Lines of a table for one word of its selection, see the top.

    Args:
        word: such as plant, control.safety, contacts=edge_on_face. first: where each model is
            described. page: on which the table is.
    """
    if word == "signals":
        yield from rows({kind: kind.model_fields for kind in signals()}, "", first, page)
        return
    path, _, tag = word.partition("=")
    *above, last = path.split(".")
    kinds: list[type[BaseModel]] = [Scenario]
    for key in above:
        kinds = [model for kind in kinds for model in models_in(kind.model_fields[key].annotation)]
    prefix = "".join(f"{key}." for key in above)
    if not tag:
        fields = {kind: {last: kind.model_fields[last]} for kind in kinds}
        yield from rows(fields, prefix, first, page)
        return
    inside = [model for kind in kinds for model in models_in(kind.model_fields[last].annotation)]
    (kind,) = (model for model in inside if tag_of(model) == tag)
    own = {key: field for key, field in kind.model_fields.items() if not is_tag(field)}
    yield from rows({kind: own}, f"{path}.", first, page)


def tag_of(kind: type[BaseModel]) -> str:
    """The name of a model's kind, or nothing."""
    fields = kind.model_fields
    return next((fields[key].default for key in ("type", "kind") if is_tag(fields.get(key))), "")


def rows(
    kinds: dict[type[BaseModel], dict[str, FieldInfo]],
    prefix: str,
    first: dict[type[BaseModel], str],
    page: str,
) -> Iterator[str]:
    """Lines of a table: the keys of a group, of whatever kind it may be, and of groups inside.

    Args:
        kinds: the models that the group may be, with their keys. prefix: of the keys.
        first: where each model is described. page: on which the table is.
    """
    tagged: dict[str, list[str]] = {}
    same: dict[tuple[str, str], list[str]] = {}
    field_of = {}
    for kind, fields in kinds.items():
        tag = tag_of(kind)
        for name, field in fields.items():
            if is_tag(field) and len(kinds) > 1:
                tagged.setdefault(name, []).append(f"`{tag}`: {first_sentence(kind)}")
                continue
            text = meaning(kind, name)
            assert text, f"{kind.__name__}.{name} has no docstring"
            same.setdefault((name, " ".join(text.split())), []).append(f"`{tag}`")
            field_of[name, " ".join(text.split())] = field
    for name, kinds_of in tagged.items():
        yield line(f"{prefix}{name}", "text", "", "required", "; ".join(kinds_of))
    for (name, text), tags in same.items():
        field, path = field_of[name, text], f"{prefix}{name}"
        if 1 < len(kinds) != len(tags):
            text = f"{', '.join(tags)}: {text}"
        inside = [model for model in models_in(field.annotation) if origin(model) not in signals()]
        here = f"[`{path}`]({page})"
        known = first.get(inside[0], here) != here if inside else False
        if known:
            text += f"; keys as of {first[inside[0]]}"
        else:
            first |= dict.fromkeys(inside, here)
        yield line(path, unit(field), limits(field), default(field), text)
        if inside and not known:
            yield from rows(
                {model: model.model_fields for model in inside}, f"{path}.", first, page
            )


def line(*cells: str) -> str:
    """A line of a table; the first cell is a key."""
    shown = (f"`{cells[0]}`", *cells[1:])
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in shown)} |\n"


def first_sentence(kind: type[BaseModel]) -> str:
    """What a model's docstring begins with."""
    text = " ".join(inspect.cleandoc(origin(kind).__doc__ or "").split("\n\n")[0].split())
    return text.rstrip(".")


def is_tag(field: FieldInfo | None) -> bool:
    """Whether a key has one value only, the name of its kind."""
    return (
        field is not None
        and get_origin(field.annotation) is Literal
        and field.default
        in (get_args(field.annotation) if len(get_args(field.annotation)) == 1 else ())
    )


def models_in(kind: Any) -> list[type[BaseModel]]:
    """The models that a key's type can hold."""
    if kind is ContactSpec:
        return list(contact_types().values())
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        return models_in(inner[0])
    if get_origin(kind) in (Union, UnionType, tuple, dict):
        return [model for one in inner for model in models_in(one)]
    return []


def origin(kind: type[BaseModel]) -> type[BaseModel]:
    """The model of which `kind` is that of one quantity."""
    return kind.__pydantic_generic_metadata__["origin"] or kind


def signals() -> list[type[BaseModel]]:
    """The kinds of signals, of whatever quantity."""
    return [origin(kind) for kind in models_in(ForceSignal)]


def marks(kind: Any) -> Iterator[Any]:
    """What a type is annotated with, the outermost first."""
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        yield from inner[1:]
        yield from marks(inner[0])
    else:
        for one in inner:
            yield from marks(one)


def unit(field: FieldInfo) -> str:
    """The unit of a key, or what it is."""
    kind = field.annotation
    found = [*field.metadata, *marks(kind)]
    for mark in found:
        if isinstance(mark, str):
            return mark
    kinds = [one for one in (get_args(kind) or (kind,)) if one is not type(None)]
    if models_in(kind):
        shapes = {tuple: "list", dict: "by name"}
        return next(
            (shapes[one] for one in map(get_origin, (kind, *kinds)) if one in shapes), "group"
        )
    if "~" in str(kind):
        return "its kind"
    units = [next(iter(mark.units), "–") for mark in found if isinstance(mark, Dimension)]
    if units:
        return ", ".join(dict.fromkeys(units))
    return {bool: "true, false", int: "number"}.get(kinds[0], "text")


def limits(field: FieldInfo) -> str:
    """The range of a key."""
    found = []
    for mark in [*field.metadata, *marks(field.annotation)]:
        bounds = [m for m in getattr(mark, "metadata", [mark])]
        found += [
            f"{sign} {getattr(m, key):g}" for m in bounds for key, sign in SIGNS.items()
            if isinstance(getattr(m, key, None), int | float)
        ]  # fmt: skip
    return ", ".join(dict.fromkeys(found))


def default(field: FieldInfo) -> str:
    """The value of a key that is left out, as a file has it."""
    value = field.default
    if field.is_required():
        return "required"
    if field.default_factory is not None or value == () or value == "":
        return "none"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, BaseModel):
        return "{}"
    if isinstance(value, tuple):
        return f"[{', '.join(f'{x:g}' for x in value)}]"
    return f"`{value}`" if isinstance(value, str) else f"{value:g}"


if __name__ == "__main__":
    for path, text in updated().items():
        path.write_text(text, encoding="utf-8")
