"""YAML text → nodes, composed but never constructed to objects; complaints are collected."""

from __future__ import annotations

import re
from typing import Any

import yaml

from ..errors import ScenarioError

__all__ = ["Problems", "compose", "scalar"]

_DEEPEST = 32
_FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_WORDS: dict[str, Any] = {
    "": None, "~": None, "null": None, "true": True, "false": False,
    ".nan": float("nan"), ".inf": float("inf"), "+.inf": float("inf"), "-.inf": float("-inf"),
}  # fmt: skip


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


def compose(text: str, problems: Problems) -> yaml.Node | None:
    """Return the node tree; anchors, aliases, tags and deep nesting are refused."""
    try:
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            line = event.start_mark.line + 1 if event.start_mark else 1
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:
                problems.at_line(line, f"nested deeper than {_DEEPEST} levels")
                problems.raise_any()
            anchor, tag = getattr(event, "anchor", None), getattr(event, "tag", None)
            if anchor is not None:
                name = f"*{anchor}" if isinstance(event, yaml.AliasEvent) else f"&{anchor}"
                problems.at_line(line, f"{name}: anchors and aliases are refused; write it out")
            if tag is not None:
                problems.at_line(line, f"{tag}: tags are refused; write a plain value")
        problems.raise_any()
        node: yaml.Node | None = yaml.compose(text, Loader=yaml.SafeLoader)
        return node
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        why = ", ".join(part for part in (error.context, error.problem) if part)
        cure = "; indent with spaces, not tabs" if "\\t" in why else ""
        problems.at_line(mark.line + 1 if mark else 1, f"not valid YAML: {why}{cure}")
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        what = f"the character {chr(error.character)!r} is not allowed"
        problems.at_line(line, f"not valid YAML: {what}")
    problems.raise_any()
    return None


def scalar(node: yaml.Node) -> Any:
    """Return a scalar as null, true/false, number (1e-3 and 010 too) or text."""
    text = str(node.value)
    if getattr(node, "style", None) is not None:
        return text
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if re.fullmatch(r"[+-]?\d{1,15}", text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text
