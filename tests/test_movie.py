"""Moving pictures: frames of a page at given times, and the page's cameras."""

import av
import numpy as np
from complaints import viewer_error
from headless import Browser, near, pixels_of
from numpy.linalg import norm
from numpy.testing import assert_allclose
from PIL import Image, ImageSequence
from pytest import approx
from samples import module_fixture
from scene_samples import ENDS, write

from osc_contact.visual import contact_colour
from osc_contact.visual.browser import FRAMES, moments, write_gif, write_mp4
from osc_contact.visual.marks import T_COLOUR

SIZE = (320, 300)


@module_fixture
def page(tmp_path_factory):
    return write(tmp_path_factory.mktemp("m"), fps=30)


@module_fixture
def gif(page):
    path = write_gif(page, page.with_suffix(".gif"), 0.0, 1.0, SIZE, most=6)
    with Image.open(path) as picture:
        assert picture.format == "GIF" and picture.info["loop"] == 0
        assert picture.info["duration"] == 170  # ms: six frames of one second
        return [pixels_of(frame) for frame in ImageSequence.Iterator(picture)]


def test_frames_are_of_equal_steps_and_play_in_real_time():
    times, shown = moments(2.0, 4.0)
    assert len(times) == 24 and shown == 80
    assert_allclose(times, 2.0 + np.arange(24) / 12.0)
    times, shown = moments(0.0, 60.0)
    assert len(times) * shown == approx(10_000, rel=0.1), "faster, in 10 s"


def test_a_gif_shows_arm_arrows_curves_and_the_marker_at_its_times(gif):
    assert len(gif) == 6 and gif[0].shape == (300, 320, 3)
    for number, frame in enumerate(gif):
        dock = frame[210:260]
        marker = np.flatnonzero((dock.max(axis=2) < 110).sum(axis=0) > 35)
        assert abs(marker.mean() - (58 + number / 6 * (320 - 58 - 18))) < 3
    blue = [near(frame[:180], contact_colour(0), 40) for frame in gif]
    assert blue[1] > 20 and near(gif[0][:180], T_COLOUR) < 20, "arrows, and no twist axes"
    moved = np.abs(gif[0][:180] - gif[-1][:180]).max(axis=2) > 40
    assert moved.sum() > 500, "the arm has moved"


def test_a_video_decodes_to_the_frames_of_the_gif(page, gif):
    path = write_mp4(page, page.with_suffix(".mp4"), 0.0, 1.0, SIZE)
    with av.open(str(path)) as video:
        (stream,) = video.streams
        assert (stream.codec.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, stream.average_rate) == (*SIZE, 25)
        assert float(stream.duration * stream.time_base) == approx(1.0)
        frames = [f.to_ndarray(format="rgb24").astype(int) for f in video.decode(stream)]
    assert len(frames) == 25
    off = [np.abs(frame - gif[3]).mean() for frame in frames]  # at 0.5 s
    assert np.argmin(off) in (12, 13) and min(off) < 8
    assert near(frames[12][:180], contact_colour(0), 40) > 20, "its colours"


EYE = "[...viewer.camera.position.toArray(), ...nodeAt('').object.position.toArray()]"


def test_a_page_opens_with_the_camera_of_its_address(page):
    with Browser(f"{page.as_uri()}#t=0.5&camera=from%20above", SIZE) as browser:
        assert browser.run("element('camera').value") == "from above"


def test_cameras_look_from_where_they_say(page):
    with Browser(f"{page.as_uri()}#t=0.5") as browser:
        names = browser.run("[...element('camera').options].map(o => o.textContent)")
        assert names == ["whole", "contacts", "from above", "other side"]
        drawn = browser.run(EYE)  # placed by drawing commands, not by the page's list
        browser.run("element('camera').dispatchEvent(new Event('change'))")
        assert_allclose(browser.run(EYE), drawn, atol=1e-5)
        eyes = {}
        for place, name in enumerate(names):
            browser.run(
                f"element('camera').selectedIndex = {place};"
                "element('camera').dispatchEvent(new Event('change'))"
            )
            browser.run(FRAMES)
            eyes[name] = np.array(browser.run("viewer.camera.position.toArray()"))
            for end in ENDS:
                x, y, _ = browser.run(
                    f"nodeAt('contacts/{end}').object.getWorldPosition(new MeshCat.THREE.Vector3())"
                    ".project(viewer.camera).toArray()"
                )
                assert max(abs(x), abs(y)) < 1, f"{name} sees both contacts"
        assert browser.errors == []
    high = {name: eye[1] / norm(eye) for name, eye in eyes.items()}
    assert high["from above"] > 0.99 and high["whole"] == approx(np.sin(np.deg2rad(28)))
    assert norm(eyes["contacts"]) < norm(eyes["whole"])
    flat = [eyes[name][[0, 2]] / norm(eyes[name][[0, 2]]) for name in names]
    assert_allclose(flat[3], -flat[0], atol=1e-6)


def test_a_page_whose_script_fails_gives_no_gif(page, tmp_path):
    broken = tmp_path / "broken.html"
    text = page.read_text()
    broken.write_text(
        text.replace("function seek(time) {", "function seek(time) { if (player.ready) throw 1;")
    )
    with viewer_error("a script of the page failed"):
        write_gif(broken, tmp_path / "x.gif", 0.0, 1.0, SIZE, most=2)
    assert [p.name for p in tmp_path.iterdir()] == ["broken.html"]
