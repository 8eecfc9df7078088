"""Symbols and words of the glossary: their first use in the text of a page leads there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from urllib.parse import quote

from docutils import nodes

PAGE = "docs/glossary"
TABLE = re.compile(r"^\| (?:symbol|word) .*\n\|[-|]+\n((?:\|.*\n)+)", re.MULTILINE)  # no code
ROW = re.compile(r"^\| ([^|]+) \|", re.MULTILINE)
OFTEN_OTHERS = "a f h n p q v V judge"  # that stand for other things as well
NEVER = (  # text within these is no running text
    nodes.literal, nodes.literal_block, nodes.math, nodes.math_block, nodes.reference,
    nodes.title, nodes.raw,
)  # fmt: skip


def setup(app: Any) -> dict[str, bool]:
    app.connect("doctree-resolved", mark_rows, priority=300)  # before indices are lowered
    app.connect("doctree-resolved", link_first_uses, priority=310)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def names_of(cell: str) -> list[str]:
    """The symbols or words of a first cell: "J, J̄, γ" are three, "Ω_f(A)" is Ω_f."""
    names = [re.sub(r"\(.*?\)|…", "", name).strip() for name in cell.split(",")]
    return [name for name in names if name and name not in OFTEN_OTHERS.split()]


def rows(source: Path) -> dict[str, str]:
    """Symbol or word → the first one of its row, which names the row's anchor."""
    tables = TABLE.findall(source.read_text(encoding="utf-8"))
    cells = [names_of(cell) for cell in ROW.findall("".join(tables))]
    return {name: names[0] for names in cells if names for name in names}


def mark_rows(app: Any, tree: nodes.document, page: str) -> None:
    """Give every row of symbols or words in the glossary an anchor."""
    if page != PAGE:
        return
    anchors = set(rows(Path(app.srcdir) / f"{PAGE}.md").values())
    for row in tree.findall(nodes.row):
        names = names_of(row[0].astext())
        if names and names[0] in anchors and isinstance(row.parent, nodes.tbody):
            row["ids"] = [f"term-{names[0]}"]


def link_first_uses(app: Any, tree: nodes.document, page: str) -> None:
    """Turn the first use of each symbol or word into a link."""
    if app.builder.format != "html" or not re.fullmatch(r"docs/(?!glossary$)\w+", page):
        return
    left = rows(Path(app.srcdir) / f"{PAGE}.md")
    address = app.builder.get_relative_uri(page, PAGE)
    never = NEVER if page == "docs/law" else (*NEVER, nodes.entry)  # others: keys, units
    texts = [t for t in tree.findall(nodes.Text) if not _within(t, never)]
    for text in texts:
        parts: list[nodes.Node] = []
        words, done = text.astext(), 0
        for found in _pattern(left).finditer(words) if left else ():
            if found[1] not in left:
                continue
            link = nodes.reference(
                "", found[0], internal=True, classes=["term"],
                refuri=f"{address}#term-{quote(left.pop(found[1]))}",
            )  # fmt: skip
            parts += [nodes.Text(words[done : found.start()]), link]
            done = found.end()
        if parts:
            text.parent.replace(text, [*parts, nodes.Text(words[done:])])


def _pattern(names: dict[str, str]) -> re.Pattern[str]:
    """The names as whole words: α_u is an α, η̇ an η; a letter after a number is a unit."""
    longest = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    return re.compile(
        rf"(?<![\w.’'/-])(?<!\d\s)(?<!per\s)(?<!in\s)({longest})(?:(?<=[αη])\u0307?(?:_\w+)?)?"
        r"(?![\w+/’'\u0300-\u036f-]|\s(?:m|s|gaps)\b|\.\w|\(N|\sv\s)"
    )


def _within(node: nodes.Node, kinds: tuple[type, ...]) -> bool:
    parent = node.parent
    while parent is not None:
        if isinstance(parent, kinds):
            return True
        parent = parent.parent
    return False
