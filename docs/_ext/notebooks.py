"""Pages from notebooks/*.py: the cells as text, with what they print and draw."""

from __future__ import annotations

import tempfile
from typing import Any

import jupytext
from docutils import nodes
from myst_parser.parsers.sphinx_ import MystParser
from nbclient import NotebookClient


def setup(app: Any) -> dict[str, bool]:
    app.add_config_value("run_notebooks", True, "env", types=[bool])
    app.add_source_suffix(".py", "notebook")
    app.add_source_parser(NotebookParser)
    return {"parallel_read_safe": True}


class NotebookParser(MystParser):
    """A notebook in the percent format, run and read as Markdown."""

    supported = ("notebook",)

    def parse(self, inputstring: str, document: nodes.document) -> None:
        notebook = jupytext.reads(inputstring, fmt="py:percent")
        if document.settings.env.config.run_notebooks:
            with tempfile.TemporaryDirectory() as folder:
                resources = {"metadata": {"path": folder}}
                NotebookClient(notebook, timeout=300, resources=resources).execute()
        super().parse("\n\n".join(map(as_markdown, notebook.cells)), document)


def as_markdown(cell: Any) -> str:
    if cell.cell_type != "code":
        return str(cell.source)
    lines = [line for line in cell.source.splitlines() if not line.startswith("%")]
    shown = "\n".join(line.removesuffix("  # fmt: skip") for line in lines)
    return "\n\n".join([fenced("python", shown), *map(output, joined(cell.outputs))])


def joined(outputs: Any) -> list[Any]:
    """What was printed in pieces as one output."""
    found: list[Any] = []
    for one in outputs:
        if found and one.output_type == found[-1].output_type == "stream":
            found[-1] = found[-1].copy()
            found[-1].text += one.text
        else:
            found.append(one)
    return found


def output(of_cell: Any) -> str:
    """What a cell printed, drew or returned."""
    if of_cell.output_type == "stream":
        return fenced("text", of_cell.text)
    data = of_cell.data
    if "text/html" in data:
        return raw(data["text/html"])
    if "image/png" in data:
        return raw(f'<img alt="figure" src="data:image/png;base64,{data["image/png"].strip()}">')
    return fenced("text", data["text/plain"])


def fenced(language: str, text: str) -> str:
    return f"```{language}\n{text.rstrip()}\n```"


def raw(html: str) -> str:
    return f"```{{raw}} html\n{html}\n```"
