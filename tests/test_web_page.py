"""A task as a web page: what it is made of, and the page in a real Chromium."""

import functools
import http.server
import json
import threading
from pathlib import Path

import numpy as np
from headless import Browser
from pytest import approx, mark, raises
from rigs import rig_of
from samples import made_once, module_fixture, parametrize

import osc_contact as osc
from osc_contact.lab.reports.web_page import folded, playable, write_web_page
from osc_contact.law.jit import HAS_LIBRARY

pytestmark = mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
TASK = "two_contact_rod"
TOLD = "typeof measured === 'object' && measured"


class Silent(http.server.SimpleHTTPRequestHandler):
    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    def log_message(self, *words):
        pass


@module_fixture
def folder(tmp_path_factory):
    def make(place):
        write_web_page(osc.load_scenario(TASK), place / "page")

    return made_once(tmp_path_factory, "web_page", make) / "page"


@module_fixture
def address(folder):
    handler = functools.partial(Silent, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@module_fixture
def page(address):
    with Browser("about:blank", ready="true") as browser:
        yield browser


def opened(page, address, **how):
    page.visit(address + "index.html", ready=f"{TOLD}.pictures > 0", **how)
    page.run("task.postMessage({ kind: 'run', on: false })")


def flat(page, ticks, **more):
    """Result of a number of ticks without pictures."""
    order = json.dumps(more | {"kind": "flat", "ticks": ticks})
    page.run(f"delete measured.flat; task.postMessage({order})")
    page.until(f"{TOLD}.flat", 300.0)
    return json.loads(page.run("JSON.stringify(measured.flat)"))


def tell(page, **order):
    page.run(f"task.postMessage({json.dumps(order)})")


def newest(page):
    """The picture after one more tick."""
    before = page.run("measured.pictures")
    tell(page, kind="step", ticks=1)
    page.until(f"measured.pictures > {before}")
    return json.loads(page.run("JSON.stringify(measured.newest)"))


def set_slider(page, name, value):
    page.run(
        f"(() => {{ const x = document.querySelector('input[name={json.dumps(name)}]'); "
        f"x.value = {value}; x.dispatchEvent(new Event('input')); }})()"
    )


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


def test_true_forces_are_those_of_the_native_run(page, address):
    opened(page, address)
    ticks = 2000
    found = flat(page, ticks, note=True, anew=True)
    true, commanded = np.reshape(found["truths"], (ticks, 2, 2)).swapaxes(0, 1)
    native = osc.run(osc.load_scenario(TASK), duration=ticks * 1e-3)
    judged = native["t"] > 0.5
    assert commanded == approx(native["alpha_cmd"], abs=1e-6)
    rms = np.sqrt(((true - commanded)[judged] ** 2).mean(axis=0))
    expected = np.sqrt(((native["alpha_true"] - native["alpha_cmd"])[judged] ** 2).mean(axis=0))
    assert rms == approx(expected, rel=0.01)
    assert found["statuses"] == {"0": ticks}
    assert page.errors == []


def test_a_slider_sets_the_true_force(page, address):
    opened(page, address)
    set_slider(page, "force left end", 20)
    flat(page, 2500)
    picture = newest(page)
    assert picture["commanded"][0] == 20.0
    assert picture["true"][0] == approx(20.0, abs=0.05)


def test_contact_is_kept_on_a_wall_that_was_turned(page, address):
    opened(page, address)
    set_slider(page, "face left end: turned by", 4)
    for _ in range(5):
        flat(page, 500)
        picture = newest(page)
        assert min(picture["true"]) > 1.0
        assert picture["state"] == 0
    assert picture["walls"][0] == approx(np.deg2rad(4.0), abs=1e-4)


def test_the_motion_turns_round_at_the_ends_of_its_table(page, address):
    opened(page, address)
    found = flat(page, 25_000, anew=True)
    assert sum(found["statuses"].values()) == 25_000
    assert set(found["statuses"]) == {"0"}


@parametrize("file, words", {"": "damaged: its checksum", "panda_edge": "of another robot or task"})
def test_another_controller_is_refused_in_words(page, address, folder, tmp_path, file, words):
    path = tmp_path / "own.osc"
    if not file:
        content = bytearray((folder / "controller.osc").read_bytes())
        content[5000] ^= 1
        path.write_bytes(content)
    else:
        rig_of(file).controller().save(path)
    opened(page, address)
    content = list(path.read_bytes())
    page.run(
        f"task.postMessage({{ kind: 'restart', file: new Uint8Array({json.dumps(content)}) }})"
    )
    page.until("measured.error")
    assert words in page.run("document.getElementById('says').textContent")
    assert newest(page)["state"] == 0  # the one before goes on


def test_heaps_do_not_grow(page, address):
    opened(page, address)
    before = flat(page, 5000)["heaps"]
    assert flat(page, 20_000)["heaps"] == before


def test_a_policy_without_unsafe_eval_is_named(page, address):
    error = "new EvalError(\"Refused: 'unsafe-eval' is not an allowed source of script\")"
    worker = (Path(osc.__file__).parent / "lab/visual/assets/web_worker.mjs").read_text()
    sentence = worker[worker.index("function sentence") :]
    words = page.run(f"(() => {{ {sentence}; return sentence({error}); }})()")
    assert "add 'unsafe-eval' to script-src" in words
