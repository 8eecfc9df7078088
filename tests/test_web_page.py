"""A task as a web page: what it is made of, and the page in a real Chromium."""

import json

import numpy as np
from headless import Browser
from pytest import approx, mark, raises
from rigs import rig_of
from samples import module_fixture, parametrize
from web_tasks import made_page, opened

import osc_contact as osc
from benchmarks.web_pages import (
    EXTENSION,
    REPORTED,
    next_picture,
    post,
    run_ticks,
    served,
    set_slider,
)
from osc_contact.lab.reports.web_page import folded, playable, write_web_page
from osc_contact.law.jit import HAS_LIBRARY

pytestmark = mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
TASK = "two_contact_rod"


@module_fixture
def folder(tmp_path_factory):
    return made_page(tmp_path_factory, TASK)


@module_fixture
def address(folder):
    """Address of the folder that holds the pages; each is made when a test first needs it."""
    with served(folder.parent) as found:
        yield found


@module_fixture
def page():
    with Browser("about:blank", ready="true") as browser:
        yield browser


@module_fixture
def rod(address, folder):
    return f"{address}{folder.name}/index.html"


# --- What it is made of ---------------------------------------------------------------------------


def test_a_table_of_references_is_folded_and_unfolded(folder):
    t = np.arange(1000) * 1e-3
    table = np.column_stack((np.sin(t), np.full(1000, 3.0), 12.5 * (t > 0.3), 1e-3 * t**2))
    about, content = folded(table)
    assert [column["index"] for column in about["columns"]] == [0, 2, 3]
    whole = np.frombuffer(content, "<i4").reshape(3, 1000).cumsum(1).cumsum(1).cumsum(1)
    for column, values in zip(about["columns"], whole, strict=True):
        wanted = table[:, column["index"]]
        assert np.abs(column["unit"] * values - wanted).max() <= 1e-8 * np.abs(wanted).max()


@parametrize(
    "name, without, words",
    [
        ("workcell", (), "a tare"),
        ("workcell", ("tare",), "errors of sensors"),
        ("moving_face", (), "bodies that move"),
        (TASK, ("gravity",), "names nothing that can be left out"),
    ],
)
def test_what_python_computes_step_by_step_is_refused(name, without, words):
    with raises(osc.InvalidInputError, match=words):
        playable(osc.load_scenario(name), without)


# --- In Chromium ----------------------------------------------------------------------------------


@parametrize("name", list(EXTENSION["TASKS"]))
def test_forces_are_those_of_the_native_run(page, address, name, tmp_path_factory):
    """True ones; measured ones where several share a wall."""
    opened(page, f"{address}{made_page(tmp_path_factory, name).name}/index.html")
    ticks = 2000
    found = run_ticks(page, ticks, note=True, anew=True)
    force, commanded = np.reshape(found["truths"], (ticks, 2, -1)).swapaxes(0, 1)
    native = osc.run(osc.load_scenario(name), duration=ticks * 1e-3)
    alone = page.run("CONFIG.task.forces.every((force) => force.wall >= 0)")
    expected = native["alpha_true" if alone else "alpha_meas"]
    assert commanded == approx(native["alpha_cmd"], abs=1e-6)
    judged = native["t"] > 0.5
    errors = [(x - native["alpha_cmd"])[judged] for x in (force, expected)]
    rms, expected_rms = (np.sqrt((error**2).mean(axis=0)) for error in errors)
    assert rms == approx(expected_rms, rel=0.01)
    assert found["statuses"] == {"0": ticks}
    assert page.errors == []


def test_a_slider_sets_the_true_force(page, rod):
    opened(page, rod)
    set_slider(page, "force left end", 20)
    run_ticks(page, 2500)
    picture = next_picture(page)
    assert picture["commanded"][0] == 20.0
    assert picture["true"][0] == approx(20.0, abs=0.05)


def test_contact_is_kept_on_a_wall_that_was_turned(page, rod):
    opened(page, rod)
    set_slider(page, "face left end: turned by", 4)
    for _ in range(5):
        run_ticks(page, 500)
        picture = next_picture(page)
        assert min(picture["true"]) > 1.0
        assert picture["state"] == 0
    assert picture["walls"][0] == approx(np.deg2rad(4.0), abs=1e-4)


def test_the_motion_turns_round_at_the_ends_of_its_table_and_the_heaps_do_not_grow(page, rod):
    opened(page, rod)
    before = run_ticks(page, 5000, anew=True)
    after = run_ticks(page, 20_000)
    assert before["statuses"] == {"0": 5000} and after["statuses"] == {"0": 20_000}
    assert after["heaps"] == before["heaps"]


@parametrize("file, words", {"": "damaged: its checksum", "panda_edge": "of another robot or task"})
def test_another_controller_is_refused_in_words(page, rod, folder, tmp_path, file, words):
    path = tmp_path / "own.osc"
    if not file:
        content = bytearray((folder / "controller.osc").read_bytes())
        content[5000] ^= 1
        path.write_bytes(content)
    else:
        rig_of(file).controller().save(path)
    opened(page, rod)
    content = list(path.read_bytes())
    page.run(
        f"task.postMessage({{ kind: 'restart', file: new Uint8Array({json.dumps(content)}) }})"
    )
    page.until("measured.error")
    assert words in page.run("document.getElementById('says').textContent")
    assert next_picture(page)["state"] == 0  # the one before goes on


@mark.slow
def test_an_hour_of_simulated_time_leaves_the_heaps_as_they_are(page, rod):
    opened(page, rod)
    before = run_ticks(page, 5000)["heaps"]
    for _ in range(60):
        found = run_ticks(page, 60_000)
        assert set(found["statuses"]) == {"0"}
        assert found["heaps"] == before


def test_a_selection_law_errs_ten_times_as_much_at_the_same_step(page, rod):
    opened(page, rod)
    post(page, kind="compare", on=True)
    run_ticks(page, 1000)
    set_slider(page, "force left end", 15)
    run_ticks(page, 3000)
    picture = next_picture(page)
    assert picture["beside"]["state"] == picture["state"] == 0

    def rms(errors):
        return np.sqrt(np.array(errors["squares"]) / errors["count"])

    assert rms(picture["beside"]["errors"])[1] >= 10.0 * rms(picture["errors"])[1]
    assert np.abs(picture["selection"]).max() > 10.0 > np.abs(picture["error"]).max()  # mN
    words = page.run("document.getElementById('status-beside').textContent")
    assert words == "selection law: RUN, tick OK"
    post(page, kind="compare", on=False)
    assert next_picture(page)["beside"] is None


def test_friction_of_contacts_and_joints_is_the_plants_alone(page, rod):
    """Without friction again the forces are those of before, to the last digit."""
    opened(page, rod)
    first = run_ticks(page, 300, note=True, anew=True)["truths"]
    errors = {}
    for name, value in {"friction of the contacts": 0.2, "friction of the joints": 1.0}.items():
        set_slider(page, name, value)
        found = run_ticks(page, 1500, note=True, anew=True)
        true, commanded = np.reshape(found["truths"], (1500, 2, 2)).swapaxes(0, 1)
        errors[name] = np.abs(true - commanded)[500:].max()
        assert found["truths"][:600] != first[:600]
        assert set(found["statuses"]) == {"0"}
        set_slider(page, name, 0)
    assert max(errors.values()) < 2.0
    assert run_ticks(page, 300, note=True, anew=True)["truths"] == first


def test_keys_and_a_push_by_the_pointer(page, rod):
    opened(page, rod, width=400)
    page.run("document.activeElement.blur()")
    run_ticks(page, 3000)
    late = next_picture(page)["t"]
    assert late > 3.0
    page.request("Input.dispatchKeyEvent", type="keyDown", key="r", text="r")
    page.until(f"measured.newest.t < {late} && element('pause').textContent === 'Pause'")
    page.request("Input.dispatchKeyEvent", type="keyDown", key=" ", text=" ")
    page.until("element('pause').textContent === 'Run'")
    before = next_picture(page)["t"]
    page.request("Input.dispatchKeyEvent", type="keyDown", key=".", text=".")
    page.until(f"measured.newest.t > {before}")
    page.run("element('push').click()")
    touch = [{"x": 200, "y": 120}]
    page.request("Input.dispatchTouchEvent", type="touchStart", touchPoints=touch)
    page.request("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": 260, "y": 120}])
    page.until("element('says').textContent.startsWith('pushed by')")
    page.request("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    page.until("element('says').textContent === ''")
    assert page.errors == []


def test_a_policy_without_unsafe_eval_is_named(page, folder):
    """The policy stands in the header of the host, which a worker of the page obeys, too."""
    with served(folder, "script-src 'self' 'wasm-unsafe-eval'") as strict:
        page.visit(f"{strict}index.html", ready=f"{REPORTED}.error")
        words = page.run("document.getElementById('says').textContent")
    assert "add 'unsafe-eval' to script-src" in words
    page.errors.clear()


def test_one_file_opens_from_disk(tmp_path):
    sizes = write_web_page(osc.load_scenario(TASK), tmp_path, one_file=True)
    assert list(sizes) == ["index.html"] and sizes["index.html"] < 6e6
    with Browser((tmp_path / "index.html").as_uri(), ready=f"{REPORTED}.pictures > 1") as page:
        post(page, kind="run", on=False)
        assert set(run_ticks(page, 500)["statuses"]) == {"0"}
        assert page.errors == []


def test_licences_of_all_that_runs_are_in_the_folder(folder):
    text = (folder / "licences.txt").read_text()
    for name in ("MuJoCo", "meshcat", "DAQP", "wasi-libc", "Three.js", "musl"):
        assert name in text, name
    assert text.count("Permission is hereby granted") >= 3 and "Apache License" in text
