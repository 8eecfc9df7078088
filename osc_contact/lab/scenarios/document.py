"""A scenario text as data that remember their lines, and complaints about them."""

import re
import types
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Any, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from osc_contact.errors import ScenarioError, did_you_mean
from osc_contact.lab.scenarios.checks import Problem, problems_across
from osc_contact.lab.scenarios.contact_keys import ContactSpec, contact_types
from osc_contact.settings.quantities import sentence

# --- YAML text to nodes ---------------------------------------------------------------------------

_DEEPEST = 32
_FAST: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  #: in C: ten times as fast
_FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_WORDS: dict[str, Any] = {
    "": None,
    "~": None,
    "null": None,
    "true": True,
    "false": False,
    ".nan": float("nan"),
    ".inf": float("inf"),
    "+.inf": float("inf"),
    "-.inf": float("-inf"),
}


class Problems:
    """Collects complaints; raises them together, sorted by line, overrides last."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.found: list[tuple[int, str]] = []

    def at_line(self, line: int, text: str) -> None:
        """Keep a complaint about a line of the file."""
        self.found.append((line, f"{self.file}:{line}: {text}"))

    def at_override(self, override: str, text: str) -> None:
        """Keep a complaint about an override, `path.to.key=value`."""
        short = text.removeprefix(f"{override.partition('=')[0].strip()}: ")  # the key once
        self.found.append((1 << 60, f"override {override}: {short}"))

    def raise_any(self) -> None:
        """Return if nothing was found.

        Raises:
            ScenarioError: all complaints, one a line, each once."""
        if self.found:
            ordered = sorted(self.found, key=lambda item: item[0])
            raise ScenarioError("\n".join(dict.fromkeys(text for _, text in ordered)))


def compose(text: str, problems: Problems, loader: Any = _FAST) -> yaml.Node | None:
    """Return the node tree; anchors, aliases, tags and deep nesting are refused.

    Args:
        text: text of a file. problems: its errors. loader: loader of YAML's events.
    """
    try:
        depth = 0
        for event in yaml.parse(text, Loader=loader):
            line = event.start_mark.line + 1 if event.start_mark else 1
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:
                problems.at_line(line, f"nested deeper than {_DEEPEST} levels")
                break
            anchor = getattr(event, "anchor", None)
            tag = getattr(event, "tag", None)
            if anchor is not None:
                name = f"*{anchor}" if isinstance(event, yaml.AliasEvent) else f"&{anchor}"
                problems.at_line(line, f"{name}: anchors and aliases are refused; write it out")
            if tag is not None:
                problems.at_line(line, f"{tag}: tags are refused; write a plain value")
        problems.raise_any()
        return yaml.compose(text, Loader=loader)
    except (yaml.MarkedYAMLError, yaml.reader.ReaderError) as error:
        if loader is not yaml.SafeLoader:  # which names better what is wrong, and where
            return compose(text, problems, yaml.SafeLoader)
        if isinstance(error, yaml.reader.ReaderError):
            line = text.count("\n", 0, error.position) + 1
            why = f"the character {chr(error.character)!r} is not allowed"
        else:
            mark = error.problem_mark or error.context_mark
            line = mark.line + 1 if mark else 1
            why = ", ".join(part for part in (error.context, error.problem) if part)
            why += "; indent with spaces, not tabs" if "\\t" in why else ""
        problems.at_line(line, f"not valid YAML: {why}")
    problems.raise_any()
    return None


def scalar(node: yaml.Node) -> Any:
    """Return a scalar as null, true/false, number (1e-3 and 010 too) or text."""
    text = str(node.value)
    if getattr(node, "style", None):  # it is quoted
        return text
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if re.fullmatch(r"[+-]?\d{1,15}", text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text


# --- Data with the line, or the override, of every key --------------------------------------------

Key = tuple[str | int, ...]


class ScenarioDocument:
    """Plain data of one YAML text with the origin (line or override) of each key."""

    def __init__(self, text: str, problems: Problems) -> None:
        self.problems = problems
        self.origins: dict[Key, int | str] = {}
        node = compose(text, problems)
        self.data: Any = None if node is None else self._read(node, ())
        self.origins.setdefault((), 1)

    def _read(self, node: yaml.Node, key: Key) -> Any:
        """Convert a YAML node to plain values; record the line of each key in `origins`.

        Args:
            node: node of the document. key: path of the node.
        """
        self.origins.setdefault(key, node.start_mark.line + 1)
        if isinstance(node, yaml.SequenceNode):
            return [self._read(item, (*key, index)) for index, item in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode):
            return scalar(node)
        group = {}
        for name_node, value_node in node.value:
            line = name_node.start_mark.line + 1
            if not isinstance(name_node, yaml.ScalarNode):
                self.problems.at_line(line, f"{_dotted(key)}a key must be plain text")
                continue
            name = str(name_node.value)
            place = (*key, name)
            if name in group:
                first = self.origins[place]
                text = f"{_dotted(place, '')}: given twice, first in line {first}; keep one"
                self.problems.at_line(line, text)
                continue
            self.origins[place] = line
            group[name] = self._read(value_node, place)
        return group

    def override(self, path: str, value: str) -> None:
        """Set the value at `path` (keys, list indices or item names, joined by dots)."""
        override = f"{path}={value}"
        try:
            quiet = Problems("its value")
            inner = ScenarioDocument(value, quiet)
            quiet.raise_any()
            if not value.strip():
                raise ScenarioError("no value is given; write null to clear a key")
            holder, key = self._create_parents(path, override)
        except ScenarioError as error:
            self.problems.at_override(override, str(error))
            return
        self.origins = {old: line for old, line in self.origins.items() if old[: len(key)] != key}
        self.origins[key] = override
        holder[key[-1]] = inner.data

    def value(self, path: str) -> Any:
        """Value at a path; None if there is none.

        Raises:
            ScenarioError: no such path."""
        holder, key = self._create_parents(path, path)
        return _child(holder, key[-1])

    def _create_parents(self, path: str, override: str) -> tuple[Any, Key]:
        """Return what holds the value at `path`, and its key; groups left out are begun."""
        key: Key = ()
        holder = self.data
        done: list[str] = []
        rest = path.split(".")
        while rest:
            part = rest.pop(0)
            if isinstance(holder, dict) and part not in holder and rest:
                dotted = f"{part}.{rest[0]}"  # a force magnitude, such as pad.1
                if dotted in holder:
                    part = dotted
                    del rest[0]
            where = ".".join(done) or "the scenario"
            if not part:
                raise ScenarioError("the path has an empty part; write path.to.key=value")
            step: str | int = part
            if isinstance(holder, list):
                step = _item(holder, part, where)
            elif not isinstance(holder, dict):
                raise ScenarioError(f"{where} is {holder!r} and has no keys or items")
            key = (*key, step)
            done.append(part)
            if rest:
                if _child(holder, step) is None:
                    holder[step] = {}
                    self.origins[key] = override
                holder = holder[step]
        return holder, key

    def report(self, key: Key, text: str) -> None:
        """Complain about `key`, or about the nearest parent that has an origin."""
        origin = self._origin(key)
        for word in re.findall(r"[a-z_]+(?:\.[a-z_]+)+", text):  # e.g. control.rate
            if isinstance(origin, int) and isinstance(other := self._origin(word.split(".")), str):
                origin = other  # the override of the other key is to blame, not the line
        shown = f"{_dotted(self._named(key), '')}: {text}" if key else text
        if isinstance(origin, str):
            self.problems.at_override(origin, shown)
        else:
            self.problems.at_line(origin, shown)

    def _origin(self, key: Sequence[str | int]) -> int | str:
        parents = (tuple(key[:n]) for n in range(len(key), -1, -1))
        return self.origins[next(parent for parent in parents if parent in self.origins)]

    def _named(self, key: Key) -> Key:
        """Path in which numbers of items are replaced by their names."""
        shown: list[str | int] = []
        holder = self.data
        for part in key:
            holder = _child(holder, part)
            name = holder.get("name") if isinstance(holder, dict) else None
            shown.append(name if isinstance(part, int) and isinstance(name, str) else part)
        return tuple(shown)


def _item(items: Sequence[Any], part: str, where: str) -> int:
    """Index of an item in a list, by its name or number.

    Args:
        items: the list. part: name or number. where: path of the list, for messages.

    Raises:
        ScenarioError: no such item.
    """
    names = [item.get("name") if isinstance(item, dict) else None for item in items]
    if part in names:
        return names.index(part)
    if re.fullmatch(r"\d{1,6}", part) and int(part) < len(items):
        return int(part)
    known = [str(name) for name in names if name is not None]
    hint = did_you_mean(part, known) if known else f"items are 0 to {len(items) - 1}"
    raise ScenarioError(f"{where} has no item {part!r}; {hint if items else 'it is empty'}")


def _dotted(key: Key, end: str = ": ") -> str:
    return ".".join(map(str, key)) + (end if key else "")


def _child(holder: Any, part: str | int) -> Any:
    """Value of a key of a mapping or item of a list; None if it does not exist."""
    if isinstance(holder, dict):
        return holder.get(str(part))
    if isinstance(holder, list) and isinstance(part, int) and part < len(holder):
        return holder[part]
    return None


# --- Complaints of pydantic as sentences ----------------------------------------------------------

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
        kind = item["type"]
        context = item.get("ctx", {})
        if kind == "too_short" and len(item["input"]) >= context["min_length"]:
            continue  # long enough but for items that are refused themselves
        if kind == "union_tag_not_found":
            yield (
                place,
                f"the key {context['discriminator']} is missing: {_TAGS}"
                + ", ".join(contact_types()),
            )
        elif kind == "union_tag_invalid":
            tag = context["discriminator"].strip("'")
            expected = context["expected_tags"]
            yield (*place, tag), f"expected one of {expected}; got {context['tag']!r}"
        else:
            yield place[:-1] if kind == "missing" else place, sentence(item, owner)
    yield from problems_across(data)


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
        owner = options[0] if len(options) == 1 and _is_model(options[0]) else None
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
    origin = get_origin(kind)
    inner = get_args(kind)
    if origin is tuple and isinstance(part, int):
        return _options(inner[0] if Ellipsis in inner else inner[min(part, len(inner) - 1)])
    return _options(inner[1]) if origin is dict else []


def _options(kind: Any) -> list[Any]:
    """Return the members of a union (without None), or the type itself, without annotations."""
    origin = get_origin(kind)
    inner = get_args(kind)
    if origin is Annotated:
        return _options(inner[0])
    if origin in (Union, types.UnionType):
        return [member for one in inner if one is not type(None) for member in _options(one)]
    return list(contact_types().values()) if kind is ContactSpec else [kind]
