"""How words are set: names in tables, and long ones, break after parts only; indices stand low."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes

INDEX = re.compile(
    r"(?:(?<![A-Za-z0-9_])|(?<=_[a-z]))((?:bias|[A-Za-zΑ-Ωα-ω])[\u0300-\u036f]*)_([a-z0-9]+|[A-Z]+|[γμητω])(?![a-z]*_)"
)
LONG = 24  # letters
PLACES = re.compile(r"(?<=[._/])(?=\w)(?!py\b)")


def setup(app: Any) -> dict[str, bool]:
    app.connect("doctree-resolved", allow)
    app.connect("doctree-resolved", lower_indices)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def allow(app: Any, tree: nodes.document, _page: str) -> None:
    """Put a place to break after each part of a name, in the text of long ones."""
    if app.builder.format != "html":
        return
    cells = [one for entry in tree.findall(nodes.entry) for one in entry.findall(nodes.literal)]
    for literal in list(tree.findall(nodes.literal)):
        if literal in cells or len(literal.astext()) > LONG:
            parts = PLACES.split(literal.astext())
            broken: list[nodes.Node] = [nodes.Text(parts[0])]
            for part in parts[1:]:
                broken += [nodes.raw("", "<wbr>", format="html"), nodes.Text(part)]
            literal.children = []
            literal.extend(broken)


def lower_indices(app: Any, tree: nodes.document, page: str) -> None:
    """Set n_γ in the running text as n with a low γ."""
    if app.builder.format != "html" or page.startswith("docs/api/"):
        return
    for text in list(tree.findall(nodes.Text)):
        if isinstance(
            text.parent, nodes.literal | nodes.literal_block | nodes.math_block | nodes.raw
        ):
            continue
        parts = INDEX.split(text.astext())
        if len(parts) > 1:
            text.parent.replace(text, list(_with_indices(parts)))


def _with_indices(parts: list[str]) -> list[nodes.Node]:
    """Nodes of text, letter, index, text, …"""
    found: list[nodes.Node] = []
    for before, letter, index in zip(parts[0::3], parts[1::3], parts[2::3], strict=False):
        found += [nodes.Text(before + letter), nodes.subscript("", index)]
    return [*found, nodes.Text(parts[-1])]
