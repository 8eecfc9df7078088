"""The real pages in a headless Chromium: what is on the screen, the slider, moving pictures."""

from itertools import combinations

import av
import numpy as np
from complaints import viewer_error
from headless import Browser, near, pixels_of
from numpy.linalg import norm
from PIL import Image, ImageSequence
from pytest import approx
from rigs import assert_near, largest, vector
from samples import module_fixture, names_in, parametrize
from scene_samples import BASE, ENDS, RECORDING, links, write

from osc_contact.lab.visual import browser as pages
from osc_contact.lab.visual import contact_colour
from osc_contact.lab.visual.browser import FRAMES, moments, write_gif, write_mp4, write_png
from osc_contact.lab.visual.marks import T_COLOUR

BLUE = contact_colour(0)
VERMILLION = contact_colour(1)
LABELS = "[...document.querySelectorAll('#labels div')].filter(d => d.style.display !== 'none')"
PLACE = "nodeAt('{}').object.getWorldPosition(new MeshCat.THREE.Vector3()).toArray()"


@module_fixture
def page(tmp_path_factory):
    return write(tmp_path_factory.mktemp("scene"), fps=20)


@module_fixture
def browser(page):
    with Browser(f"{page.as_uri()}#t=1") as opened:
        yield opened
        assert opened.errors == []


def slide(browser, time):
    """Move the time slider as a hand does; the picture then."""
    browser.run(
        f"element('time').value = {time}; "
        "element('time').dispatchEvent(new Event('input', {bubbles: true}))"
    )
    return browser.picture()


def switch_tangents(browser):
    """Show or hide them."""
    browser.run("document.querySelector('#legend input[name^=\"T:\"]').click()")


def place_in(browser, path):
    """Position of a node relative to the base of the arm, in world axes (m)."""
    here, base = (browser.run(PLACE.format(p)) for p in (path, "arms/left/base"))
    x, y, z = np.array(here) - np.array(base)  # three.js has y up
    return vector(x, -z, y)


def marker(picture, row):
    """Column of the time marker of a plot of which 20 rows begin there."""
    column = np.flatnonzero((picture[row : row + 20].max(axis=2) < 60).all(axis=0))
    assert len(column) in (1, 2), "one time marker"
    return column.mean()


def hinge(tick):
    """Motion of the hinge, computed by Pinocchio."""
    return links(RECORDING["q"][tick])["hinge"].translation - BASE.translation


def test_the_page_is_not_blank_and_has_the_named_colours(browser):
    picture = slide(browser, 1.0)
    scene = picture[:600]
    dock = picture[640:]
    assert scene.std() > 20 and len(np.unique(scene.reshape(-1, 3), axis=0)) > 300
    for colour in (BLUE, VERMILLION, T_COLOUR):
        assert near(scene, colour) > 200, colour
    assert near(dock, BLUE) > 100 and near(dock, VERMILLION) > 100, "curves"
    assert browser.run("document.querySelectorAll('#legend input').length") == 6


def test_the_slider_moves_arms_arrows_marker_and_clock(browser):
    seen = {}
    for time, tick in ((0.2, 20), (0.9, 90)):
        picture = slide(browser, time)
        assert_near(place_in(browser, "arms/left/hinge"), hinge(tick), atol=2e-3)
        assert abs(marker(picture, 700) - (58 + time * (1280 - 58 - 18))) < 3
        assert browser.run("element('clock').textContent").startswith(f"{time:.2f}")
        scale = browser.run("nodeAt('contacts/left_end/true/shaft').object.scale.y")
        assert scale == approx(max(0.12 * time - 0.035, 1e-6), abs=2e-3)
        label = browser.run("document.querySelector('#labels div').textContent")
        assert label == f"left end {12 * time:.2f} N"
        seen[time] = picture[:600]
    moved = np.abs(seen[0.2] - seen[0.9]).max(axis=2) > 40
    assert moved.sum() > 5000, "the arm has moved on the screen"
    assert near(seen[0.9], VERMILLION) > near(seen[0.2], VERMILLION) + 100, "longer arrows"


@module_fixture
def other():
    """A browser for one page after another."""
    with Browser("about:blank", ready="true") as opened:
        yield opened
        assert opened.errors == []


def test_on_a_phone_the_legend_is_folded_and_the_whole_scene_is_seen(other, page):
    other.visit(f"{page.as_uri()}#t=1", 390, 844)
    assert other.run("document.documentElement.scrollWidth") == 390
    assert other.run("element('legend').clientHeight") == 0
    labels = other.run(f"{LABELS}.map(d => d.textContent)")
    assert {"left end 12.00 N", "right end 9.00 N"} <= set(labels)
    scene = other.picture()[: int(other.run("element('scene').clientHeight"))]
    assert near(scene, BLUE) > 30 and near(scene, VERMILLION) > 30
    other.run("document.querySelector('#caption h1').click()")
    assert other.run("element('legend').clientHeight") > 100


def test_a_browser_without_decompression_shows_why(other, page, tmp_path):
    text = page.read_text()
    old = tmp_path / "old.html"
    old.write_text(
        text.replace("<body>", "<body><script>delete window.DecompressionStream</script>")
    )
    other.visit(old.as_uri(), ready="document.querySelector('#labels').textContent")
    shown = other.run("element('labels').textContent")
    assert "does not run in this browser" in shown and "DecompressionStream" in shown
    assert other.errors
    other.errors.clear()


def test_check_boxes_show_and_hide(browser):
    on = near(slide(browser, 1.0)[:600], T_COLOUR)
    switch_tangents(browser)
    assert near(browser.picture()[:600], T_COLOUR) < 0.2 * on
    switch_tangents(browser)
    assert near(browser.picture()[:600], T_COLOUR) == approx(on, rel=0.05)


def test_labels_and_legend_do_not_cover_each_other(browser):
    for time in (0.0, 0.3, 0.5, 0.8, 1.0):
        slide(browser, time)
        boxes = browser.run(
            LABELS + ".map(d => { const r = d.getBoundingClientRect();"
            " return [d.textContent, r.left, r.top, r.right, r.bottom]; })"
        )
        assert len(boxes) >= 5
        for (a, *p), (b, *q) in combinations(boxes, 2):
            apart = p[2] <= q[0] or q[2] <= p[0] or p[3] <= q[1] or q[3] <= p[1]
            assert apart, f"{a!r} covers {b!r} at {time} s"


@parametrize("size", [(1280, 860), (400, 700)])
def test_no_label_covers_an_arrow(page, size):
    """Points of each arrow, from its tip towards the node of its label, beyond its tail."""
    place = (
        "(path => { const v = nodeAt(path).object.getWorldPosition(new MeshCat.THREE.Vector3())"
        ".project(viewer.camera), p = element('scene');"
        " return [0.5 * (v.x + 1) * p.clientWidth, 0.5 * (1 - v.y) * p.clientHeight]; })('{}')"
    )
    with Browser(f"{page.as_uri()}#t=1", size) as opened:
        for time in (0.1, 0.3, 0.8, 1.0):
            slide(opened, time)
            boxes = opened.run(
                LABELS + ".map(d => { const r = d.getBoundingClientRect();"
                " return [d.textContent, r.left, r.top, r.right, r.bottom]; })"
            )
            assert len(boxes) >= 4
            for name in ENDS:
                path = f"contacts/{name}"
                ends = [opened.run(place.replace("{}", p)) for p in (path, f"{path}/label")]
                for x, y in np.linspace(*ends, 20)[:16]:
                    for text, left, top, right, bottom in boxes:
                        covered = left < x < right and top < y < bottom
                        assert not covered, f"{text!r} covers the force of {name} at {time} s"


def test_play_continues_and_a_click_in_a_plot_stops_there(browser):
    slide(browser, 0.0)
    browser.run("element('play').click()")
    browser.until("player.time > 0.15")
    assert browser.run("player.playing")
    x = 58 + 0.5 * (1280 - 58 - 18)
    click = {"x": x, "y": 720, "button": "left", "buttons": 1, "clickCount": 1}
    for kind in ("mousePressed", "mouseReleased"):
        browser.request("Input.dispatchMouseEvent", type=kind, **click)
    browser.until("!player.playing")
    assert browser.run("player.time") == approx(0.5, abs=0.01)


def test_png_of_a_moment(page, tmp_path, monkeypatch):
    path = write_png(page, tmp_path / "deep" / "a.png", 0.9, (900, 700))
    picture = pixels_of(Image.open(path))
    assert picture.shape == (700, 900, 3)
    assert picture[:430].std() > 20 and near(picture[:430], BLUE) > 50
    assert abs(marker(picture, 540) - (58 + 0.9 * (900 - 58 - 18))) < 3
    assert names_in(path.parent) == {"a.png"}
    with viewer_error("gave no answer"):
        monkeypatch.setenv("OSC_CONTACT_BROWSER", "/bin/false")
        write_png(page, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def test_without_webgl_there_is_a_still_picture_and_a_sentence(page, monkeypatch):
    """Browsers with WebGL off, such as those of many remote desktops."""
    monkeypatch.setattr(pages, "FLAGS", (*pages.FLAGS, "--disable-3d-apis", "--disable-gpu"))
    with Browser(f"{page.as_uri()}#t=1") as browser:
        assert browser.run("document.createElement('canvas').getContext('2d') !== null")
        assert "no WebGL" in browser.run("document.body.innerText")
        picture = slide(browser, 1.0)
        assert near(picture[:600], BLUE) > 200 and near(picture[:600], VERMILLION) > 200
        assert near(picture[640:], BLUE) > 100, "curves"
        assert largest(slide(browser, 0.2)[:600] - picture[:600]) > 50, "another instant"
        assert browser.errors == []


# Moving pictures: frames of a page at given times, and the page's cameras


SIZE = (320, 300)


@module_fixture
def plain(tmp_path_factory):
    return write(tmp_path_factory.mktemp("m"), fps=30)


@module_fixture
def gif(plain):
    path = write_gif(plain, plain.with_suffix(".gif"), 0.0, 1.0, SIZE, most=6)
    with Image.open(path) as picture:
        assert picture.format == "GIF" and picture.info["loop"] == 0
        assert picture.info["duration"] == 170  # ms: six frames of one second
        return [pixels_of(frame) for frame in ImageSequence.Iterator(picture)]


def test_frames_are_of_equal_steps_and_play_in_real_time():
    times, shown = moments(2.0, 4.0)
    assert len(times) == 24 and shown == 80
    assert_near(times, 2.0 + np.arange(24) / 12.0)
    times, shown = moments(0.0, 60.0)
    assert len(times) * shown == approx(10_000, rel=0.1), "faster, in 10 s"


def test_a_gif_shows_arm_arrows_curves_and_the_marker_at_its_times(gif):
    assert len(gif) == 6 and gif[0].shape == (300, 320, 3)
    for number, frame in enumerate(gif):
        marker = np.flatnonzero((frame[210:260].max(axis=2) < 110).sum(axis=0) > 35)
        assert abs(marker.mean() - (58 + number / 6 * (320 - 58 - 18))) < 3
    blue = [near(frame[:180], contact_colour(0), 40) for frame in gif]
    assert blue[1] > 20 and near(gif[0][:180], T_COLOUR) < 20, "arrows, and no twist axes"
    moved = np.abs(gif[0][:180] - gif[-1][:180]).max(axis=2) > 40
    assert moved.sum() > 500, "the arm has moved"


def test_a_video_decodes_to_the_frames_of_the_gif(plain, gif):
    path = write_mp4(plain, plain.with_suffix(".mp4"), 0.3, 0.7, SIZE)
    with av.open(str(path)) as video:
        (stream,) = video.streams
        assert (stream.codec.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, stream.average_rate) == (*SIZE, 25)
        assert float(stream.duration * stream.time_base) == approx(0.4)
        frames = [f.to_ndarray(format="rgb24").astype(int) for f in video.decode(stream)]
    assert len(frames) == 10
    off = [np.abs(frame - gif[3]).mean() for frame in frames]  # at 0.5 s
    assert np.argmin(off) == 5 and min(off) < 8
    assert near(frames[5][:180], contact_colour(0), 40) > 20, "its colours"


EYE = "[...viewer.camera.position.toArray(), ...nodeAt('').object.position.toArray()]"


def test_cameras_look_from_where_they_say(other, plain):
    other.visit(f"{plain.as_uri()}#t=0.5&camera=from%20above")
    assert other.run("element('camera').value") == "from above"
    other.visit(f"{plain.as_uri()}#t=0.5")
    names = other.run("[...element('camera').options].map(o => o.textContent)")
    assert names == ["whole", "contacts", "from above", "other side"]
    drawn = other.run(EYE)  # placed by drawing commands, not by the page's list
    other.run("element('camera').dispatchEvent(new Event('change'))")
    assert_near(other.run(EYE), drawn, atol=1e-5)
    views = {}
    for place, name in enumerate(names):
        other.run(
            f"element('camera').selectedIndex = {place};"
            "element('camera').dispatchEvent(new Event('change'))"
        )
        other.run(FRAMES)
        views[name] = np.array(other.run("viewer.camera.position.toArray()"))
        for end in ENDS:
            x, y, _ = other.run(
                f"nodeAt('contacts/{end}').object.getWorldPosition(new MeshCat.THREE.Vector3())"
                ".project(viewer.camera).toArray()"
            )
            assert max(abs(x), abs(y)) < 1, f"{name} shows both contacts"
    high = {name: eye[1] / norm(eye) for name, eye in views.items()}
    assert high["from above"] > 0.99 and high["whole"] == approx(np.sin(np.deg2rad(28)))
    assert norm(views["contacts"]) < norm(views["whole"])
    flat = [views[name][[0, 2]] / norm(views[name][[0, 2]]) for name in names]
    assert_near(flat[3], -flat[0], atol=1e-6)


def test_a_page_whose_script_fails_gives_no_gif(plain, tmp_path):
    broken = tmp_path / "broken.html"
    text = plain.read_text()
    broken.write_text(
        text.replace("function seek(time) {", "function seek(time) { if (player.ready) throw 1;")
    )
    with viewer_error("a script of the page failed"):
        write_gif(broken, tmp_path / "x.gif", 0.0, 1.0, SIZE, most=2)
    assert names_in(tmp_path) == {"broken.html"}
