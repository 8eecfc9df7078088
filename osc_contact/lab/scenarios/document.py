"""Text of a scenario as plain data with the line of each key, and error messages with lines."""

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

_DEEPEST = 32  #: largest depth of nested values
_FAST: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  #: loader in C, ten times as fast
_FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
#: Words with a meaning in YAML, in lower case.
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
    """List of error messages, which are raised together: sorted by line, overrides last.

    Attributes:
        file: name of the file in messages.
        found: line and message of each error.
    """

    def __init__(self, file: str) -> None:
        """Begin without errors."""
        self.file = file
        self.found: list[tuple[int, str]] = []

    def at_line(self, line: int, text: str) -> None:
        """Add an error in a line of the file.

        Args:
            line: number of the line, from 1.
            text: cause and cure.
        """
        self.found.append((line, f"{self.file}:{line}: {text}"))

    def at_override(self, override: str, text: str) -> None:
        """Add an error in an override.

        Args:
            override: the override, path.to.key=value.
            text: cause and cure; a leading path of the key is removed, because the override begins
                with it.
        """
        short = text.removeprefix(f"{override.partition('=')[0].strip()}: ")
        self.found.append((1 << 60, f"override {override}: {short}"))

    def raise_any(self) -> None:
        """Raise the errors, if there are any.

        Raises:
            ScenarioError: all messages, one in each line, each once.
        """
        if self.found:
            ordered_problems = sorted(self.found, key=lambda item: item[0])
            raise ScenarioError("\n".join(dict.fromkeys(text for _, text in ordered_problems)))


def compose(text: str, problems: Problems, loader: type = _FAST) -> yaml.Node | None:
    """Parse YAML to nodes; anchors, aliases, tags and deep nesting are refused.

    Args:
        text: text of a file.
        problems: list to which errors are added.
        loader: class that reads the text; after an error the text is read again by PyYAML's, whose
            messages are better.

    Returns:
        Root of the tree of nodes; None: the text is empty.

    Raises:
        ScenarioError: the text is not valid, or has something that is refused.
    """
    try:
        _refuse_extras(text, problems, loader)
        problems.raise_any()
        return yaml.compose(text, Loader=loader)
    except (yaml.MarkedYAMLError, yaml.reader.ReaderError) as error:
        if loader is not yaml.SafeLoader:
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


def _refuse_extras(text: str, problems: Problems, loader: type) -> None:
    """Find anchors, aliases, tags and deep nesting, before nodes are made of the text.

    Args:
        text: text of a file.
        problems: list to which errors are added.
        loader: class that reads the text.
    """
    depth = 0
    for event in yaml.parse(text, Loader=loader):
        line = event.start_mark.line + 1 if event.start_mark else 1
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > _DEEPEST:
            problems.at_line(line, f"nested deeper than {_DEEPEST} levels")
            return
        anchor = getattr(event, "anchor", None)
        tag = getattr(event, "tag", None)
        if anchor is not None:
            name = f"*{anchor}" if isinstance(event, yaml.AliasEvent) else f"&{anchor}"
            problems.at_line(line, f"{name}: anchors and aliases are refused; write it out")
        if tag is not None:
            problems.at_line(line, f"{tag}: tags are refused; write a plain value")


def scalar(node: yaml.Node) -> Any:
    """Convert a scalar node to None, a truth value, a number (1e-3 and 010, too) or text.

    Quoted scalars are text.
    """
    text = str(node.value)
    if getattr(node, "style", None):  # it is quoted
        return text
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if re.fullmatch(r"[+-]?\d{1,15}", text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text


# --- Data with the line, or the override, of every key --------------------------------------------

Key = tuple[str | int, ...]  #: path of a value: keys of mappings and indices of lists


class ScenarioDocument:
    """Plain data of one YAML text with the origin of each key.

    Attributes:
        problems: errors of the text.
        data: dictionaries, lists and scalars of the text.
        origins: line of the file, or override, by the path of each key.
    """

    def __init__(self, text: str, problems: Problems) -> None:
        """Read a YAML text.

        Args:
            text: text of a file.
            problems: list to which errors are added.

        Raises:
            ScenarioError: the text is not valid YAML.
        """
        self.problems = problems
        self.origins: dict[Key, int | str] = {}
        node = compose(text, problems)
        self.data: Any = None if node is None else self._read(node, ())
        self.origins.setdefault((), 1)

    def _read(self, node: yaml.Node, key: Key) -> Any:
        """Convert a YAML node to plain values; store the line of each key in `origins`.

        Args:
            node: node of the document.
            key: path of the node.

        Returns:
            Dictionary, list, or scalar; keys that are given twice are left out, with an error.
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
                self.problems.at_line(line, f"{_path_text(key)}a key must be plain text")
                continue
            name = str(name_node.value)
            place = (*key, name)
            if name in group:
                first = self.origins[place]
                text = f"{_path_text(place, '')}: given twice, first in line {first}; keep one"
                self.problems.at_line(line, text)
                continue
            self.origins[place] = line
            group[name] = self._read(value_node, place)
        return group

    def override(self, path: str, value: str) -> None:
        """Set the value of a key; errors are added to `problems`.

        Args:
            path: keys, list indices or names of items, joined by dots.
            value: YAML text.
        """
        override = f"{path}={value}"
        try:
            own_problems = Problems("its value")
            document = ScenarioDocument(value, own_problems)
            own_problems.raise_any()
            if not value.strip():
                raise ScenarioError("no value is given; write null to clear a key")
            parent, key = self._create_parents(path, override)
        except ScenarioError as error:
            self.problems.at_override(override, str(error))
            return
        # the key and all keys below it come from the override now, not from lines of the file
        self.origins = {
            path_in_file: line
            for path_in_file, line in self.origins.items()
            if path_in_file[: len(key)] != key
        }
        self.origins[key] = override
        parent[key[-1]] = document.data

    def value(self, path: str) -> Any:
        """Value of a key; None if it is not given.

        Args:
            path: keys, list indices or names of items, joined by dots.

        Raises:
            ScenarioError: no such path.
        """
        parent, key = self._create_parents(path, path)
        return _child(parent, key[-1])

    def _create_parents(self, path: str, override: str) -> tuple[Any, Key]:
        """Find the mapping or list that has a value, and create mappings that are missing.

        Args:
            path: keys, list indices or names of items, joined by dots.
            override: origin of the mappings that are created.

        Returns:
            Mapping or list, and path of the value with indices in place of names.

        Raises:
            ScenarioError: there is no such path.
        """
        key: Key = ()
        parent = self.data
        parents: list[str] = []
        remaining = path.split(".")
        while remaining:
            part = remaining.pop(0)
            if isinstance(parent, dict) and part not in parent and remaining:
                path_text = f"{part}.{remaining[0]}"  # a force magnitude, such as pad.1
                if path_text in parent:
                    part = path_text
                    del remaining[0]
            where = ".".join(parents) or "the scenario"
            if not part:
                raise ScenarioError("the path has an empty part; write path.to.key=value")
            step: str | int = part
            if isinstance(parent, list):
                step = _item(parent, part, where)
            elif not isinstance(parent, dict):
                raise ScenarioError(f"{where} is {parent!r} and has no keys or items")
            key = (*key, step)
            parents.append(part)
            if remaining:
                if _child(parent, step) is None:
                    parent[step] = {}
                    self.origins[key] = override
                parent = parent[step]
        return parent, key

    def report(self, key: Key, text: str) -> None:
        """Add an error about a key, at the line or override that it comes from.

        If the text names another key that an override has set, the override is stated.

        Args:
            key: path of the key; for a key without an origin that of its nearest parent is stated.
            text: cause and cure.
        """
        origin = self._origin(key)
        for word in re.findall(r"[a-z_]+(?:\.[a-z_]+)+", text):  # e.g. control.rate
            if isinstance(origin, int) and isinstance(other := self._origin(word.split(".")), str):
                origin = other  # the override of the other key is to blame, not the line
        text_with_key = f"{_path_text(self._path_with_names(key), '')}: {text}" if key else text
        if isinstance(origin, str):
            self.problems.at_override(origin, text_with_key)
        else:
            self.problems.at_line(origin, text_with_key)

    def _origin(self, key: Sequence[str | int]) -> int | str:
        """Line or override of a key, or of its nearest parent that has one.

        Args:
            key: path of the key.
        """
        for length in range(len(key), 0, -1):
            parent = tuple(key[:length])
            if parent in self.origins:
                return self.origins[parent]
        return self.origins[()]

    def _path_with_names(self, key: Key) -> Key:
        """Path in which indices of items are replaced by their names.

        Args:
            key: path of a value.
        """
        parts: list[str | int] = []
        value = self.data
        for part in key:
            value = _child(value, part)
            name = value.get("name") if isinstance(value, dict) else None
            parts.append(name if isinstance(part, int) and isinstance(name, str) else part)
        return tuple(parts)


def _item(items: Sequence[Any], part: str, where: str) -> int:
    """Index of an item in a list, by its name or number.

    Args:
        items: the list.
        part: name or number.
        where: path of the list, for messages.

    Raises:
        ScenarioError: no such item.
    """
    names = [item.get("name") if isinstance(item, dict) else None for item in items]
    if part in names:
        return names.index(part)
    if re.fullmatch(r"\d{1,6}", part) and int(part) < len(items):
        return int(part)
    item_names = [str(name) for name in names if name is not None]
    hint = did_you_mean(part, item_names) if item_names else f"items are 0 to {len(items) - 1}"
    raise ScenarioError(f"{where} has no item {part!r}; {hint if items else 'it is empty'}")


def _path_text(key: Key, end: str = ": ") -> str:
    """Write a path with dots; empty for the root.

    Args:
        key: path of a value.
        end: text after a path that is not empty.
    """
    return ".".join(map(str, key)) + (end if key else "")


def _child(parent: Any, part: str | int) -> Any:
    """Value of a key of a mapping, or item of a list; None if it does not exist.

    Args:
        parent: mapping, list or scalar.
        part: key or index.
    """
    if isinstance(parent, dict):
        return parent.get(str(part))
    if isinstance(parent, list) and isinstance(part, int) and part < len(parent):
        return parent[part]
    return None


# --- Errors of pydantic as sentences --------------------------------------------------------------

#: Values of the keys `type` and `kind`, for messages.
_TAGS = (
    "constant, step, sine, minimum_jerk, jerk_limited or points for a signal; linear or angular "
    "for a move; for a contact "
)


def complaints(error: ValidationError, data: Any, root: type[BaseModel]) -> Iterator[Problem]:
    """Yield path and message of every error; checks across keys are made of keys that are valid.

    Args:
        error: errors of pydantic.
        data: data that were validated.
        root: model of the whole file.
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
    """Convert a location of pydantic to a path, and find the model that owns its last key.

    Args:
        loc: location in an error of pydantic, which has tags of unions between the keys.
        root: model of the whole file.

    Returns:
        Path without the tags; model with the last key, or None if it is not unique.
    """
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
        children: list[Any] = []
        for kind in options:
            children += _inside(kind, part)
        options = children
    return place, owner


def _is_model(kind: object) -> bool:
    """Return whether a type is a model of pydantic."""
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _tag(kind: Any) -> Any:
    """Value of the key `type` or `kind` that tells models of a union apart; None: no such key."""
    fields = kind.model_fields if _is_model(kind) else {}
    return next((fields[name].default for name in ("type", "kind") if name in fields), None)


def _inside(kind: Any, part: str | int) -> list[Any]:
    """Types that a key or item of a type may have; none if it has no such key.

    Args:
        kind: model, tuple or dict type.
        part: key, or index of an item.
    """
    if _is_model(kind):
        return _options(kind.model_fields[part].annotation) if part in kind.model_fields else []
    origin = get_origin(kind)
    inner_types = get_args(kind)
    if origin is tuple and isinstance(part, int):
        return _options(
            inner_types[0]
            if Ellipsis in inner_types
            else inner_types[min(part, len(inner_types) - 1)]
        )
    return _options(inner_types[1]) if origin is dict else []


def _options(kind: object) -> list[Any]:
    """Members of a union without None, or the type itself in a list; annotations are removed.

    `ContactSpec` stands for the models of all registered contact pairs.

    Args:
        kind: annotation of a field.
    """
    origin = get_origin(kind)
    inner_types = get_args(kind)
    if origin is Annotated:
        return _options(inner_types[0])
    if origin in (Union, types.UnionType):
        members: list[Any] = []
        for member in inner_types:
            if member is not type(None):
                members += _options(member)
        return members
    return list(contact_types().values()) if kind is ContactSpec else [kind]
