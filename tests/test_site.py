"""The site and the notebooks: they build and run, links lead somewhere, nothing is fetched."""

import json
import re
import runpy
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlsplit

from headless import Browser
from html_pages import Page
from pytest import raises
from samples import ROOT, chosen, made_once, module_fixture, parametrize
from web_tasks import made_pages

import osc_contact as osc
from osc_contact.lab.visual.page import embed


def build(source, into, *options):
    """As `make docs`, without running the notebooks: tests/test_site.py runs them.

    Without collecting garbage, which costs a third of the time.
    """
    sphinx = "import gc, sys; gc.disable(); from sphinx.cmd.build import main; sys.exit(main())"
    line = f"-W --keep-going -q -b html -D run_notebooks=0 -d {into}/doctrees"
    command = [sys.executable, "-c", sphinx, *line.split(), *options, source, into / "site"]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


@module_fixture
def site(tmp_path_factory):
    def make(folder):
        pages = made_pages(tmp_path_factory)
        done = build(ROOT, folder, "-c", ROOT / "docs", "-D", f"try_pages={pages}")
        assert done.returncode == 0 and not done.stderr, done.stderr

    return made_once(tmp_path_factory, "docs", make) / "site"


def text_of(site, page):
    return (site / f"{page}.html").read_text()


@module_fixture
def pages(site):
    return {path: Page(path.read_text()) for path in sorted(site.rglob("*.html"))}


def test_every_page_is_there(site):
    sources = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/api/*.rst")]
    for source in [*sources, *ROOT.glob("notebooks/*.py")]:
        assert (site / source.relative_to(ROOT)).with_suffix(".html").is_file(), source.name
    assert "docs/index.html" in text_of(site, "index")


def test_every_link_leads_to_a_page_and_an_anchor(site, pages):
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme:
                assert parts.scheme in ("https", "http", "mailto"), f"{path.name}: {link}"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.is_file(), f"{path.relative_to(site)}: {link} leads nowhere"
            if parts.fragment and target in pages:
                known = pages[target].anchors | {"", "top"}
                assert unquote(parts.fragment) in known, f"{path.relative_to(site)}: {link}"


def test_nothing_is_fetched_from_elsewhere(site, pages):
    for path, page in pages.items():
        assert page.loads or path.name == "index.html"
        for load in page.loads:
            local = load.startswith("data:") or not (urlsplit(load).scheme or load[:2] == "//")
            assert local, f"{path.relative_to(site)} loads {load}"
    for sheet in site.rglob("*.css"):
        for address in re.findall(r"(?:url\(|@import)\s*['\"]?([^'\")\s]+)", sheet.read_text()):
            assert not re.match(r"(https?:)?//", address), f"{sheet.name} loads {address}"
    scripts = " ".join(script.name for script in site.rglob("*.js")).lower()
    assert "mathjax" not in scripts and "mermaid" not in scripts


def test_every_public_name_has_its_place_in_reading_order():
    order = re.findall(r"^api/\w+$", (ROOT / "docs/index.md").read_text(), re.M)
    text = "".join((ROOT / "docs" / f"{page}.rst").read_text() for page in order)
    pairs = [f".. autoclass:: {name}" for name in osc.__all__ if name in osc.PAIRS]
    text = text.replace(".. contact-pairs::", "\n".join(pairs))
    listed = re.findall(r"^\.\. auto(?:class|function|exception):: (\w+)$", text, re.M)
    assert listed == osc.__all__, "a public name needs a line in docs/api/"


def test_docstrings_reach_the_pages(site):
    text = text_of(site, "docs/api/response")
    assert "α = D⁻¹[NᵀSΛ_S⁻¹(f_S − b_S)" in text and "TypeAlias" not in text
    assert "neither the chain nor the environment yields" in text  # Raises:


def test_notebooks_are_pages(site):
    text = text_of(site, "notebooks/03_two_contact_task")
    assert "no constraint frame" in text and "build_rig" in text
    assert "matplotlib</span> <span" not in text and "fmt: skip" not in text


def test_the_manual_s_command_makes_a_notebook_that_can_be_opened(tmp_path, monkeypatch):
    text = (ROOT / "docs/commands.md").read_text()
    (line,) = re.findall(r"^\$ jupytext (.*)$", text, re.M)
    (tmp_path / "notebooks").mkdir()
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "notebooks" / "01_one_arm.py", "notebooks")
    subprocess.run(
        [sys.executable, "-m", "jupytext", *line.split()], check=True, capture_output=True
    )
    cells = json.loads(Path("notebooks/01_one_arm.ipynb").read_text())["cells"]
    assert {cell["cell_type"] for cell in cells} == {"markdown", "code"} and len(cells) > 4


def test_a_link_that_leads_nowhere_stops_the_build(tmp_path):
    (tmp_path / "index.md").write_text("# A page\n\n[no](nowhere.md)\n")
    done = build(tmp_path, tmp_path, "-C", "-D", "extensions=myst_parser")
    assert done.returncode != 0 and "nowhere.md" in done.stderr


def test_equations_are_drawn_without_a_script(site):
    text = text_of(site, "docs/theory")
    assert text.count("<math ") >= 20 and "<mtable" in text
    assert "$$" not in text and "&=" not in text and "\\tag" not in text and "<mi>&<" not in text
    assert '<span class="number">(24)</span>' in text
    assert "n<sub>γ</sub>" in text and "V<sub>rel</sub>" in text


def test_first_uses_of_symbols_lead_to_the_glossary(site):
    """Each once on a page, in its text; not in tables of keys, where N is a newton."""
    expected = {
        "theory": "N T r d S C G O n_γ α_u η̇ Ψ Φ Ω_f",
        "inspect": "d r C N T",
        "scenario_contacts": "r",
    }
    for page, names in expected.items():
        text = text_of(site, f"docs/{page}")
        links = re.findall(r'<a class="term [^>]*>(.*?)</a>', text)
        linked = [re.sub("</?sub>", "", link.replace("<sub>", "_")) for link in links]
        assert len(linked) == len(set(linked)), page
        assert set(names.split()) <= set(linked), page
        assert '<td><p><a class="term' not in text, page


def test_names_in_tables_break_after_their_parts_only(site):
    text = text_of(site, "docs/scenario_contacts")
    assert "contacts.<wbr>face.<wbr>urdf<" in re.sub(r"</?span[^>]*>", "", text)


@parametrize(
    "page, words",
    {
        "impedance_admittance": "impedance admittance",
        "glossary": "hybrid force position polishing peg hole guarded wrench frame compensation",
    },
)
def test_words_of_the_field_are_found(pages, site, page, words):
    """Sphinx's search leads to pages that have all words."""
    text = pages[site / f"docs/{page}.html"].text.lower()
    assert [word for word in words.split() if word not in text] == []


# Every notebook runs from top to bottom in a fresh kernel, as its text stands here.


NOTEBOOKS = sorted(ROOT.glob("notebooks/*.py"))


def test_notebooks_are_numbered():
    assert [path.stem[:3] for path in NOTEBOOKS] == ["01_", "02_", "03_", "04_", "05_", "06_"]


def test_a_page_is_embedded_whole(tmp_path):
    page = '<!DOCTYPE html>\n<p title="a & b">it\'s "here"</p>\n'
    (tmp_path / "page.html").write_text(page)
    shown = embed(tmp_path / "page.html", height=321)
    assert Page(shown._repr_html_()).loads == [page]
    assert "321px" in shown._repr_html_() and len(repr(shown)) < 100


@parametrize("path", chosen(NOTEBOOKS, NOTEBOOKS[1]), ids=lambda path: getattr(path, "stem", None))
def test_notebook_runs(path, tmp_path):
    """All cells in a new kernel, which raises on the first error."""
    import jupytext
    import nbclient

    how = {"timeout": 300, "kernel_name": "python3", "resources": {"metadata": {"path": tmp_path}}}
    notebook = nbclient.NotebookClient(jupytext.read(path), **how).execute()
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert code and all(cell.execution_count for cell in code)
    outputs = [output for cell in code for output in cell.outputs]
    assert not [one.text for one in outputs if one.get("name") == "stderr"]
    pictures = ["image/png" in one.get("data", {}) for one in outputs]
    assert sum(pictures) >= path.read_text().count("plots.contact_forces(")
    shown = [one.get("data", {}).get("text/html", "") for one in outputs]
    assert sum("MeshCat" in page and page.startswith("<iframe") for page in shown) == 1


def test_pictures_of_doors_reach_their_edges_on_phones(site):
    with Browser((site / "docs/index.html").as_uri(), ready="true") as browser:
        browser.visit((site / "docs/index.html").as_uri(), 400, 1600, ready="true")
        assert browser.run("document.documentElement.scrollWidth") == 400
        cut = browser.run(
            "[...document.querySelectorAll('.door img')].map((one) => {"
            "  const door = one.closest('.door').getBoundingClientRect();"
            "  const box = one.getBoundingClientRect();"
            "  const clips = getComputedStyle(one.parentElement).overflowX !== 'visible';"
            "  return Math.abs(box.left - door.left) + Math.abs(box.right - door.right)"
            "    + 100 * clips;"
            "})"
        )
        assert len(cut) == 4 and max(cut) < 4.0, cut


def test_each_equation_of_the_law_has_its_lines_beside_it(site):
    """Taken from the source when the site is built; a function that is missing is an error."""
    code_of = runpy.run_path(str(ROOT / "docs/_ext/law_lines.py"))["code_of"]
    shown = unescape(re.sub(r"<[^>]+>", "", text_of(site, "docs/law")))
    named = re.findall(r"(osc_contact/law/\w+\.py)::(\w+)", (ROOT / "docs/law.md").read_text())
    assert len(named) > 40
    for path, name in named:
        code = code_of(ROOT, path, name)
        assert code and "local(" not in code and code in shown, name
    assert "gram(response, r, work.pushed, r, D)" in code_of(
        ROOT, "osc_contact/law/reading.py", "_solve_magnitudes"
    )
    with raises(LookupError, match="no function measure_nothing"):
        code_of(ROOT, "osc_contact/law/reading.py", "measure_nothing")
