"""Plain data of a scenario text that remembers the line, or the override, of every key."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import yaml

from ..errors import ScenarioError
from .spec import did_you_mean
from .yaml_nodes import Problems, compose, scalar

__all__ = ["ScenarioDocument", "Key"]

Key = tuple[str | int, ...]


class ScenarioDocument:
    """Plain data of one YAML text with the origin (line or override) of each key."""

    def __init__(self, text: str, problems: Problems) -> None:
        self.problems = problems
        self.origins: dict[Key, int | str] = {}
        self.data: Any = None
        node = compose(text, problems)
        if node is not None:
            self.data = self._read(node, ())
        self.origins[()] = node.start_mark.line + 1 if node is not None else 1

    def copy(self, problems: Problems) -> ScenarioDocument:
        """The same data, to be changed; complaints go to `problems`."""
        other = ScenarioDocument.__new__(ScenarioDocument)
        other.problems, other.origins = problems, dict(self.origins)
        other.data = deepcopy(self.data)
        return other

    def _read(self, node: yaml.Node, key: Key) -> Any:
        self.origins.setdefault(key, node.start_mark.line + 1)
        if isinstance(node, yaml.SequenceNode):
            return [self._read(item, (*key, index)) for index, item in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode):
            return scalar(node)
        group: dict[str, Any] = {}
        for name_node, value_node in node.value:
            line = name_node.start_mark.line + 1
            if not isinstance(name_node, yaml.ScalarNode):
                self.problems.at_line(line, f"{_dotted(key)}a key must be plain text")
                continue
            name = str(name_node.value)
            if name in group:
                first = self.origins[(*key, name)]
                text = f"{_dotted((*key, name), '')}: given twice, first in line {first}; keep one"
                self.problems.at_line(line, text)
                continue
            self.origins[(*key, name)] = line
            group[name] = self._read(value_node, (*key, name))
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
            key = self._create_parents(path, override)
        except ScenarioError as error:
            self.problems.at_override(override, str(error))
            return
        for old in [old for old in self.origins if old[: len(key)] == key]:
            del self.origins[old]
        self.origins[key] = override
        holder = self.data
        for part in key[:-1]:
            holder = holder[part]
        holder[key[-1]] = inner.data

    def value(self, path: str) -> Any:
        """What stands at `path`; None: nothing.

        Raises:
            ScenarioError: no such path."""
        *way, last = self._create_parents(path, path)
        holder = self.data
        for part in way:
            holder = holder[part]
        return holder.get(last) if isinstance(holder, dict) else holder[last]

    def _create_parents(self, path: str, override: str) -> Key:
        """Return the key of `path`; groups that the file leaves out are begun."""
        key: Key = ()
        holder = self.data
        parts = path.split(".")
        depth = -1
        while (depth := depth + 1) < len(parts):
            part = parts[depth]
            if isinstance(holder, dict) and part not in holder and depth + 1 < len(parts):
                dotted = f"{part}.{parts[depth + 1]}"  # a force magnitude, such as pad.1
                if dotted in holder:
                    parts[depth : depth + 2] = [part := dotted]
            where = ".".join(parts[:depth]) or "the scenario"
            if not part:
                raise ScenarioError("the path has an empty part; write path.to.key=value")
            if isinstance(holder, list):
                step: str | int = _item(holder, part, where)
            elif isinstance(holder, dict):
                step = part
                if depth < len(parts) - 1 and holder.get(part) is None:
                    holder[part] = {}
                    self.origins[(*key, part)] = override
            else:
                raise ScenarioError(f"{where} is {holder!r} and has no keys or items")
            key = (*key, step)
            if depth < len(parts) - 1:
                holder = holder[step]
        return key

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
        shown: list[str | int] = []
        holder = self.data
        for part in key:
            holder = _child(holder, part)
            name = holder.get("name") if isinstance(holder, dict) else None
            shown.append(name if isinstance(part, int) and isinstance(name, str) else part)
        return tuple(shown)


def _item(items: Sequence[Any], part: str, where: str) -> int:
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
    if isinstance(holder, dict):
        return holder.get(str(part))
    if isinstance(holder, list) and isinstance(part, int) and part < len(holder):
        return holder[part]
    return None
