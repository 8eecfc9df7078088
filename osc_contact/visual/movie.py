"""Moving pictures of a page: a headless Chromium photographs it moment by moment."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from osc_contact.files import whole_file
from osc_contact.visual.devtools import Browser
from osc_contact.visual.page import unfolded

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["SIZE", "write_gif", "write_mp4"]

SIZE = (640, 540)
"""Of a moving picture, pixels."""
RATE, MOST_FRAMES, LONGEST_S = 12.0, 72, 10.0
VIDEO_RATE, LONGEST_VIDEO_S = 25, 30.0
SAMPLES = 6
LEAST_CHANGE = 10  # of 255


def moments(begin: float, end: float, most: int = MOST_FRAMES) -> tuple[list[float], int]:
    """Times (s) of at most so many frames, and how long each is shown (ms, whole centiseconds).

    Twelve frames per second in real time, or fewer; what lasts longer
    than 10 s is played faster.

    Args:
        begin, end: of the recording (s).
        most: how many frames at most.
    """
    span = max(end - begin, 1e-3)
    count = int(np.clip(np.ceil(span * RATE), 2, most))
    shown = 10 * max(round(100.0 * min(span, LONGEST_S) / count), 4)
    return np.linspace(begin, end, count, endpoint=False).tolist(), shown


def write_gif(
    page: str | Path,
    path: str | Path,
    begin: float,
    end: float,
    size: tuple[int, int] = SIZE,
    camera: str = "whole",
    most: int = MOST_FRAMES,
) -> Path:
    """Write an animated GIF of a page that plays a recording; returns its path.

    Args:
        page: file written by `write_scene`.
        path: the GIF; it appears complete or not at all.
        begin, end: of what it shows (s).
        size: of the picture, pixels.
        camera: whole, contacts, from above or other side.
        most: frames.

    Raises:
        ViewerError: no browser, or it gave no picture.
        InvalidInputError: the page holds no drawing commands.
    """
    times, shown = moments(begin, end, most)
    few = one_palette(list(photographs(page, times, size, camera)))
    with whole_file(path) as unfinished:
        few[0].save(
            unfinished, format="GIF", save_all=True, append_images=few[1:], duration=shown,
            loop=0, optimize=False, disposal=1,
        )  # fmt: skip
    return Path(path)


def write_mp4(
    page: str | Path,
    path: str | Path,
    begin: float,
    end: float,
    size: tuple[int, int] = SIZE,
    camera: str = "whole",
) -> Path:
    """Write a video (H.264) of a page that plays a recording; returns its path.

    It has 25 frames per second in real time; what lasts longer than 30 s is played faster.

    Args:
        page: file written by `write_scene`.
        path: the video; it appears complete or not at all.
        begin, end: of what it shows (s).
        size: of the picture, pixels, even numbers.
        camera: whole, contacts, from above or other side.

    Raises:
        ViewerError: no browser, or it gave no picture.
        InvalidInputError: the page holds no drawing commands.
    """
    import av

    count = max(2, round(min(end - begin, LONGEST_VIDEO_S) * VIDEO_RATE))
    times = np.linspace(begin, end, count, endpoint=False).tolist()
    with whole_file(path) as unfinished, av.open(str(unfinished), "w", format="mp4") as video:
        stream = video.add_stream("libx264", rate=VIDEO_RATE, options={"crf": "20"})
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"  # what every player shows
        for picture in photographs(page, times, size, camera):
            video.mux(
                stream.encode(av.VideoFrame.from_ndarray(np.asarray(picture), format="rgb24"))
            )
        video.mux(stream.encode())
    return Path(path)


def photographs(
    page: str | Path, times: Sequence[float], size: tuple[int, int], camera: str
) -> Iterator[Image]:
    """The page at moments of its recording, without its controls.

    Args:
        page: see `write_gif`. times: s. size: pixels. camera: see `write_gif`.
    """
    from PIL import Image

    text = unfolded(Path(page).read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory(prefix="osc_contact_", ignore_cleanup_errors=True) as folder:
        plain = Path(folder) / "page.html"
        plain.write_text(text, encoding="utf-8")
        address = f"{plain.as_uri()}#t={times[0]:g}&movie&camera={quote(camera)}"
        with Browser(address, size) as browser:
            for time in times:
                browser.run(f"player.seek({time:.6f} - origin)")
                yield Image.open(io.BytesIO(browser.png())).convert("RGB")


def one_palette(frames: Sequence[Image]) -> list[Any]:
    """The frames in the same 256 colours, without dithering: what rests compresses to nothing."""
    from PIL import Image

    chosen = [frames[i] for i in np.linspace(0, len(frames) - 1, SAMPLES).round().astype(int)]
    wide, high = chosen[0].size
    sheet = Image.new("RGB", (wide, high * SAMPLES))
    for place, frame in enumerate(chosen):
        sheet.paste(frame, (0, high * place))
    palette = sheet.quantize(256, method=Image.Quantize.MEDIANCUT)
    few = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    return quieted(frames, few)


def quieted(frames: Sequence[Image], few: Sequence[Image]) -> list[Any]:
    """Pixels that hardly change keep their colour: flicker that is not seen costs most bytes."""
    from PIL import Image

    shown = np.asarray(frames[0]).astype(int)
    colours = np.asarray(few[0]).copy()
    quiet = [few[0]]
    for frame, reduced in zip(frames[1:], few[1:], strict=True):
        true = np.asarray(frame).astype(int)
        changed = np.abs(true - shown).max(axis=2) > LEAST_CHANGE
        shown[changed] = true[changed]
        colours[changed] = np.asarray(reduced)[changed]
        picture = Image.fromarray(colours.copy())
        picture.putpalette(few[0].getpalette() or [])
        quiet.append(picture)
    return quiet
