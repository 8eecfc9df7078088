"""The report on the paper's figures: what it states, how it judges; fig. 3 and its picture."""

import json
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
from command_line import read_json
from complaints import invalid_input
from headless import Browser, near
from html_pages import Page
from matplotlib.image import imread
from PIL import Image
from rich.table import Table
from rigs import assert_near, vector
from samples import ROOT, aligned, module_fixture, names_in, parametrize
from scene_samples import read_commands

import osc_contact as osc
from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.visual import contact_colour
from osc_contact.lab.visual.browser import VARIABLE
from paper import fig3
from paper.figures import ANSWERS, FIGURES, Evidence
from paper.report import STUDIES, Reproduction, names_of, typed, write_paper_report, write_study
from paper.statements import PAPER, Answer, Verdict, judge
from paper.study import Ask, Study
from paper.variants import VARIANTS

SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {} 100"><path d="M0 0h9v9z"/></svg>'
READY = "document.querySelector('main') !== null"


@module_fixture
def evidence():
    scenario = osc.load_scenario("two_contact_rod", ["plant.type=rigid", "plant.step=1 ms"])
    return Evidence(osc.build_rig(scenario), osc.run(scenario, duration=1.2))


@module_fixture
def report(evidence, tmp_path_factory):
    """All that `reproduce all` makes, with small pictures; figs. 3 and 7 are left out."""
    folder = tmp_path_factory.mktemp("report")
    scene = write_scene_of(evidence.recording, evidence.rig, folder / "scene.html")

    def drawn(name, width=100, more=""):
        png, svg = (folder / f"{name}.{kind}" for kind in ("png", "svg"))
        svg.write_text(SVG.format(width) + more)
        Image.new("RGB", (width, 20)).save(png)
        return (png, svg)

    made = {}
    for name, width in {"fig1": 100, "fig2": 100, "fig4": 300, "fig5": 100, "fig8": 100}.items():
        answers = ANSWERS[name](evidence) if name != "fig2" else {}
        made[name] = Study({}, answers=answers, files=drawn(name, width))
    made["fig8"].answers["follow"] = Answer("<b>no</b>", False, "less & less")
    table = Table("arm & leg", "value", title="a table")
    table.add_row("left <arm>", "3 µm")
    files = (*drawn("steps", more=" " * 1_000_000)[::-1], folder / "steps.json")
    made["steps"] = Study({}, table, {"a": 1}, files=files)
    made["fig1"] = replace(made["fig1"], files=(*made["fig1"].files, scene))
    found = Reproduction(
        made, evidence.rig.scenario, evidence.recording, scene, "--plant rigid --set 'a=[1, 2]'"
    )
    return write_paper_report(found, folder / "deep" / "report.html")


def test_the_paper_has_eight_figures_and_all_that_we_make_are_among_them():
    assert [f.name for f in PAPER] == [f"fig{n}" for n in range(1, 9)]
    ours = {name for name in (*FIGURES, *STUDIES) if name.startswith("fig")}
    assert ours <= {figure.name for figure in PAPER}
    assert set(ANSWERS) == set(FIGURES), "figures that are no studies are answered here"
    paper = (ROOT / "docs/paper_map.md").read_text()
    planned = re.findall(r"^\| fig\. (\d):.*\| planned \|", paper, re.M)
    missing = {figure.name for figure in PAPER} - ours
    assert {f"fig{n}" for n in planned} == missing, "the map and the registry disagree"


def test_the_verdict():
    figure = PAPER[0]
    yes = Answer("", True)
    no = Answer("", False)
    first, *others = figure.states
    every = dict.fromkeys(figure.states, yes)
    assert judge(figure, every) is Verdict.reproduced
    assert judge(figure, every, drawn=False) is Verdict.partly
    for answers in ({}, dict.fromkeys(others, yes), {"another": yes}):
        assert judge(figure, answers) is Verdict.partly
    for answers in ({first: no}, every | {others[0]: no}):
        assert judge(figure, answers) is Verdict.contradicted


def test_the_task_answers_every_statement_about_it(evidence):
    for name, ask in ANSWERS.items():
        (figure,) = [f for f in PAPER if f.name == name]
        answers = ask(evidence)
        steps_late = {"motion"}  # a force steps at 5 s, after this run
        assert set(answers) == set(figure.states) - steps_late
        assert all(answer.holds and answer.found for answer in answers.values()), answers


def test_answers_can_fail(evidence):
    run = evidence.recording

    def holds(figure, key, meta=(), **changed):
        recording = osc.Recording(run.meta | dict(meta), run.channels | changed)
        return ANSWERS[figure](Evidence(evidence.rig, recording))[key].holds

    lost = run["closed"].copy()
    lost[-20:, 1] = False
    assert not holds("fig6", "reciprocal", closed=lost)
    assert not holds("fig6", "reciprocal", power_projected=0.1 * run["power_total"])
    off = 1.02 * run["alpha_true"]
    assert not holds("fig8", "follow", alpha_true=off)
    assert not holds("fig5", "filter", alpha_true=off)
    single = run["N"].copy()
    single[:, :, 1] = np.roll(single[:, :, 0], 1, axis=1)  # forces through one point
    single[:, 3:] = 0.0
    assert not holds("fig8", "space", N=single)
    stepped = {"force_steps_s": [1.1]}
    error = run["motion_error"].copy()
    assert holds("fig5", "motion", stepped)
    error[1110, 0] = 1e-4
    assert not holds("fig5", "motion", stepped, motion_error=error)


def test_the_report_shows_statements_numbers_verdicts_and_commands(report):
    text = report.read_text()
    shown = Page(text).text
    sections = dict(re.findall(r'<section id="(\w+)">(.*?)</section>', text, re.S))
    expected = {"fig1": "reproduced", "fig2": "partly reproduced", "fig4": "reproduced"}
    expected |= {"fig5": "partly reproduced", "fig8": "contradicted"}
    assert [name for name in sections if name.startswith("fig")] == list(expected)
    for name, verdict in expected.items():
        (figure,) = (figure for figure in PAPER if figure.name == name)
        assert all(words in shown for words in (figure.shows, *figure.states.values()))
        assert re.findall(r'class="badge \w+">. ([\w ]+)<', sections[name]) == [verdict], name
        command = f"osc-contact reproduce {name} --plant rigid --set &#x27;a=[1, 2]&#x27;"
        assert command in sections[name] and "<img" in sections[name]
    assert "62.0° and 279.6 mm" in sections["fig1"]
    assert sections["fig2"].count("Open: this run does not answer it.") == 3
    assert "&lt;b&gt;no&lt;/b&gt;" in sections["fig8"] and "less &amp; less" in sections["fig8"]
    assert 'class="pair broad"' in sections["fig4"] and 'class="pair"' in sections["fig1"]
    assert "left &lt;arm&gt;" in sections["steps"] and "arm &amp; leg" in sections["steps"]
    assert "fig1.png, fig1.svg" in sections["fig1"]
    assert "1.2 s, 1200 ticks, seed 0" in shown


def test_the_report_fetches_nothing(report):
    text = report.read_text()
    found = Page(text)
    assert {v[:14] for v in found.loads} == {"data:image/png"} and len(found.loads) == 6
    assert "osc-contact reproduce steps --plant rigid" in text
    assert all(link.startswith("#fig") for link in found.links)
    assert "default-src 'none'" in text and "connect-src data: blob:" in text
    assert names_in(report.parent) == {"report.html"}


def test_it_fits_phones_and_desks_and_unfolds_scenes_that_are_opened(report):
    """Opened scenes keep playing, so the browser must end with the test."""
    with Browser(report.as_uri(), ready=READY) as browser:
        for width, count in ((390, 1), (1280, 2)):
            browser.visit(report.as_uri(), width, ready=READY)
            assert browser.run("document.documentElement.scrollWidth") == width
            columns = browser.run(
                "getComputedStyle(document.querySelector('#fig1 .pair')).gridTemplateColumns"
            )
            assert len(columns.split()) == count
            browser.run("document.querySelector('#fig1 img').scrollIntoView()")
            browser.until("document.querySelector('#fig1 img').naturalWidth > 0")
        browser.visit(report.as_uri(), 400, ready=READY)
        assert browser.run("document.documentElement.scrollWidth") == 400
        heights = browser.run(
            "[...document.querySelectorAll('.badge')].map((one) => one.offsetHeight)"
        )
        assert len(heights) > 5 and max(heights) < 26, "each badge in one line"
        beside = browser.run(
            "[...document.querySelectorAll('.rules li')].map((one) => "
            "one.children[1].getBoundingClientRect().left - "
            "one.children[0].getBoundingClientRect().right)"
        )
        assert len(beside) == 3 and min(beside) >= 0.0, "words beside their badge, not below"
        frames = "document.querySelectorAll('iframe').length"
        assert browser.run(frames) == 0, "costs nothing before"
        browser.run("document.querySelector('#run').scrollIntoView()")
        before = near(browser.picture(), contact_colour(0))
        browser.run("document.querySelector('#run summary').click()")
        inside = "document.querySelector('iframe')?.contentDocument?"
        browser.until(f"{inside}.querySelectorAll('#legend input').length === 6")
        browser.until(f"{inside}.querySelector('#clock').textContent.includes('1.2 s')")
        assert near(browser.picture(), contact_colour(0)) > before + 200
        for _ in range(2):
            browser.run("document.querySelector('#run summary').click()")
        assert browser.run(frames) == 1
        browser.run("document.querySelector('#fig1 summary').click()")
        browser.until("document.querySelectorAll('#fig1 iframe').length === 1")
        assert browser.errors == []


def test_names_and_options():
    names = names_of("all")
    assert set(FIGURES) <= set(names) and "workcell" not in names
    assert {name for name in STUDIES if name.startswith("fig")} <= set(names), "slow or not"
    with invalid_input("no figure 'fig9'"):
        names_of("fig9")
    assert typed(None, None, 0, ()) == ""
    assert typed("rigid", 1.05, 3, ["a=[1, 2]"]) == (
        "--plant rigid --duration 1.05 --seed 3 --set 'a=[1, 2]'"
    )


@parametrize(
    "name, exact, costly, limit",
    [
        ("moving_face", "free cart, full law", "free cart, no Φ_e, b_e", 0.01),
        ("workcell", "ideal", "… no torque loop", 0.002),
    ],
)
def test_variants_keep_the_forces_or_show_what_they_cost(
    name, exact, costly, limit, tmp_path, monkeypatch
):
    variants = VARIANTS[name]
    for variant in variants.values():
        assert osc.load_scenario(name, variant.changes).name == name
    monkeypatch.setitem(VARIANTS, name, {key: variants[key] for key in (exact, costly)})
    made = write_study(name, tmp_path, Ask(duration=2.0))
    assert made.drawn and {path.stem for path in made.files} == {name}
    found = read_json(tmp_path / f"{name}.json")
    assert found[exact]["force_rms_rel"] < limit <= found[exact]["limit"]
    assert found[exact]["contact_fraction"] == 1.0 and found[costly]["limit"] is None
    assert found[costly]["force_rms_rel"] > 10 * found[exact]["force_rms_rel"]
    assert f"{found[costly]['force_rms_rel']:.3%}" in str(list(made.table.columns[2].cells))


# Fig. 3: what the picture of the workcell shows, where, and that it is rendered.


SOON = [
    f"contacts.{side}_end.face.motion.{kind}{key}=0.{what} s"
    for side in ("left", "right")
    for kind in ("signals.0.", "turn.signals.0.")
    for key, what in (("start", "6"), ("duration", "8"))
]


@module_fixture
def cell():
    return fig3.run(1.45, changes=SOON)


def test_the_camera_sees_rod_grippers_and_faces_where_they_moved_to(cell):
    corners = cell.seen
    low = corners.min(axis=0)[:2]
    high = corners.max(axis=0)[:2]
    seen = [X.translation for X in cell.faces]
    chain = cell.rig.chain
    pin.framesForwardKinematics(chain.model, chain.data, cell.sample["q"])
    seen += [X.translation for X in chain.tip_poses()]
    rod = pin.XYZQUATToSE3(cell.sample["pose"])
    seen += [rod.act(vector(x, 0.0, 0.0)) for x in (-0.3, 0.3)]
    for point in seen:
        assert (low < point[:2]).all() and (point[:2] < high).all()
        assert point[2] < fig3.EYE[2]
    turned = [X.rotation.T @ b.placement.rotation for X, b in aligned(cell.faces, cell.rig.bodies)]
    assert_near([np.linalg.norm(pin.log3(R)) for R in turned], np.deg2rad(5.0), atol=1e-3)


def test_every_label_hangs_on_a_node_and_agrees_with_the_scenario(cell, tmp_path):
    words = []
    for k, shot in enumerate(cell.shots()):
        page = cell.page(shot, tmp_path / f"{k}.html")
        drawn = {c["path"] for c in read_commands(page)}
        text = page.read_text()
        for i, callout in enumerate(shot.callouts):
            assert f"/meshcat/callouts/{i}/label" in drawn
            assert json.dumps(callout.text) in text
        words += [callout.text for callout in shot.callouts]
        assert ("/meshcat/vision/view/rim0" in drawn) == shot.whole
        assert "/meshcat/sensors/wrist/left" in drawn and "/meshcat/bodies/object" in str(drawn)
    shown = " ".join(words)
    for part in (
        "60 Hz, 30 ms old, ±1 mm, ±5 mrad",
        "left arm",
        "right arm",
        "rod",
        "joint torque sensors",
        "wrist force/torque sensor",
        "hinge",
    ):
        assert part in shown
    force = cell.sample["alpha_true"][0]
    assert force > 1.0 and f"left end: {force:.1f} N" in shown


def test_reproduce_fig3_renders_it(cell, tmp_path, monkeypatch):
    monkeypatch.setattr(fig3, "run", lambda *_: cell)
    made = write_study("fig3", tmp_path, Ask())
    assert {path.name for path in made.files} >= {"fig3.png", "fig3.html", "fig3.json"}
    picture = imread(tmp_path / "fig3.png")[..., :3]
    assert picture.shape[1] > 1500 and picture.std(axis=(0, 1)).min() > 0.05
    view = vector(0x2B, 0x7C, 0xAE) / 255  # edges of what the camera sees, on the left half
    near = np.abs(picture[:, : picture.shape[1] // 2] - view).max(axis=2) < 0.1
    assert near.sum() > 500
    parts = read_json(tmp_path / "fig3.json")
    assert "60 Hz" in parts["vision"] and "[4, 4] driven joints" in parts["arms"]


def test_without_a_browser_there_is_the_page_and_a_word(cell, tmp_path, monkeypatch):
    monkeypatch.setattr(fig3, "run", lambda *_: cell)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "none"))
    made = write_study("fig3", tmp_path, Ask())
    assert {path.name for path in made.files} == {"fig3.html", "fig3.json"}
    assert "not rendered: no browser" in str(list(made.table.columns[1].cells))
