"""`.. contact-pairs::` documents every registered contact pair."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

import osc_contact as osc


def setup(app: Any) -> dict[str, bool]:
    app.add_directive("contact-pairs", ContactPairs)
    return {"parallel_read_safe": True}


class ContactPairs(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        lines, place = StringList(), self.get_source_info()[0]
        for name in (name for name in osc.__all__ if name in osc.PAIRS):
            lines.append(f".. autoclass:: {name}", place)
            lines.append("   :exclude-members: contact, gaps, row", place)
            lines.append("", place)
        found = nodes.Element()
        self.state.nested_parse(lines, self.content_offset, found)
        return list(found.children)
