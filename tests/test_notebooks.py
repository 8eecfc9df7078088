"""Every notebook runs from top to bottom in a fresh kernel, as its text stands here."""

from html.parser import HTMLParser
from pathlib import Path

import jupytext
import nbclient
from pytest import mark, raises
from samples import chosen

from osc_contact.visual.page import embed

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))


def execute(notebook, folder):
    """Run all cells in a new kernel whose working folder is `folder`; raises on the first error."""
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    return client.execute()


def printed(notebook):
    return "".join(
        output.text
        for cell in notebook.cells
        for output in cell.get("outputs", ())
        if output.output_type == "stream" and output.name == "stdout"
    )


def test_notebooks_are_numbered():
    assert [path.stem[:3] for path in NOTEBOOKS] == ["01_", "02_", "03_", "04_", "05_", "06_"]


def test_a_page_is_embedded_whole(tmp_path):
    page = '<!DOCTYPE html>\n<p title="a & b">it\'s "here"</p>\n'
    (tmp_path / "page.html").write_text(page)
    shown = embed(tmp_path / "page.html", height=321)
    found: dict[str, str | None] = {}

    class Reader(HTMLParser):
        def handle_starttag(self, tag, attrs):
            found[tag] = dict(attrs).get("srcdoc")

    Reader().feed(shown._repr_html_())
    assert found == {"iframe": page}
    assert "321px" in shown._repr_html_() and len(repr(shown)) < 100


@mark.parametrize(
    "path", chosen(NOTEBOOKS, NOTEBOOKS[1]), ids=lambda path: getattr(path, "stem", None)
)
def test_notebook_runs(path, tmp_path):
    notebook = execute(jupytext.read(path), tmp_path)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert code and all(cell.execution_count for cell in code)
    complaints = [
        output.text
        for cell in code
        for output in cell.outputs
        if output.output_type == "stream" and output.name == "stderr"
    ]
    assert not complaints
    pictures = [
        output for cell in code for output in cell.outputs if "image/png" in output.get("data", {})
    ]
    assert len(pictures) >= path.read_text().count("plots.contact_forces(")
    shown = [
        output.data.get("text/html", "")
        for cell in code
        for output in cell.outputs[-1:]
        if "data" in output
    ]
    assert sum("MeshCat" in page and page.startswith("<iframe") for page in shown) == 1


def test_an_error_in_a_cell_fails(tmp_path):
    notebook = jupytext.reads("# %%\nprint('before')\n\n# %%\n1 / 0\n", fmt="py:percent")
    with raises(nbclient.exceptions.CellExecutionError, match="ZeroDivisionError"):
        execute(notebook, tmp_path)
    assert printed(notebook) == "before\n"
