"""Equations as MathML, which browsers draw themselves: no script and no font is fetched."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

TAG = re.compile(r"\\tag\{([^}]*)\}")


def setup(app: Any) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def inline(self: Any, node: nodes.math) -> None:
    """An equation within a line."""
    self.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block(self: Any, node: nodes.math_block) -> None:
    """A displayed equation, with its number at the right."""
    text = node.astext()
    number = TAG.search(text)
    label = f'<span class="number">({number[1]})</span>' if number else ""
    text = TAG.sub("", text).replace("{aligned}", "{align*}")  # the converter knows this name
    drawn = convert(text, display="block")
    self.body.append(f'<div class="equation">{drawn}{label}</div>\n')
    raise nodes.SkipNode
