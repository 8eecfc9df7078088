"""Beside each equation of docs/law.md the lines that compute it, taken from the source.

A row names functions as `osc_contact/law/reading.py::measure_magnitudes`; below each name its code
can be opened. Docstrings, local matrices and short names of records are left out.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from textwrap import dedent
from typing import Any

from docutils import nodes

PAGE = "docs/law"
NAMED = re.compile(r"(osc_contact/law/\w+\.py)::(\w+)")
#: Lines that compute nothing: `work = t.work`, `R = local(6, 6)`, `joints = work.joints`.
PREPARES = re.compile(r" *\w+ = (local\([^()]*\)|(t|work|model|memory|arm|own)(\.\w+)*)( +#.*)?")


def setup(app: Any) -> dict[str, bool]:
    app.connect("doctree-resolved", add_lines, priority=320)  # after names are linked
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def code_of(root: Path, path: str, name: str) -> str:
    """The lines of a function that compute something.

    Args:
        root: of the project. path: of its file. name: of the function.

    Raises:
        LookupError: the file has no such function.
    """
    source = (root / path).read_text(encoding="utf-8")
    for found in ast.parse(source).body:
        if isinstance(found, ast.FunctionDef) and found.name == name:
            body = found.body[1:] if ast.get_docstring(found) else found.body
            lines = source.splitlines()[body[0].lineno - 1 : found.end_lineno]
            return dedent("\n".join(line for line in lines if not PREPARES.fullmatch(line)))
    raise LookupError(f"docs/law.md names {path}::{name}, and {path} has no function {name}")


def add_lines(app: Any, tree: nodes.document, page: str) -> None:
    """Add the code of each function that a table names, to be opened, below its name."""
    if page != PAGE or app.builder.format != "html":
        return
    for entry in tree.findall(nodes.entry):
        for path, name in NAMED.findall(entry.astext()):
            code = code_of(Path(app.srcdir), path, name)
            block = nodes.literal_block(code, code, language="python")
            opened = nodes.raw("", "<details><summary>code</summary>", format="html")
            entry += [opened, block, nodes.raw("", "</details>", format="html")]
