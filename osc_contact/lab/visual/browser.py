"""Still and moving pictures of pages, rendered by a Chromium without window and network.

`python -m osc_contact.lab.visual.browser` prints the path of the browser, or how to install one. It
needs no packages, so that a browser can be installed at the same time as the packages.

Attributes of the browser: `folder`, its profile; `process`; `commands` and `answers`, descriptors
of the pipes to and from it; `number`, of the last request; `received`, bytes after the last whole
message; `session`, identifier of the page in requests; `errors`, messages of errors in the page.
"""

from __future__ import annotations

import base64
import io
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from osc_contact.errors import InvalidInputError, ViewerError
from osc_contact.files import Json, whole_file, write_whole

if TYPE_CHECKING:
    from PIL.Image import Image


NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
VARIABLE = "OSC_CONTACT_BROWSER"
FLAGS = (
    "--headless",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-rasterization",
    "--disable-accelerated-2d-canvas",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
"""Software rendering is chosen by name, as Chromium will no longer fall back to it. Pages without
three-dimensional scenes are drawn without it, in less time."""
READY = "typeof player === 'object' && player.ready"
"""True once a page of `write_page` has drawn its first picture."""
FRAMES = "new Promise(d => requestAnimationFrame(() => requestAnimationFrame(() => d(1))))"
ANSWER_S = 60.0
OPEN_S = 120.0


def find_browser() -> str:
    """Path of the browser: the one named by OSC_CONTACT_BROWSER, or the first found on PATH.

    Raises:
        ViewerError: there is none, with the cure.
    """
    configured = os.environ.get(VARIABLE)
    browser = next(filter(None, map(shutil.which, (configured,) if configured else NAMES)), None)
    if browser is None:
        where = f"{VARIABLE}={configured}" if configured else ", ".join(NAMES) + " on PATH"
        raise ViewerError(
            f"no browser to render pictures with (looked for {where}). Install Chromium "
            f"(Debian, Ubuntu: apt-get install chromium), or name one: {VARIABLE}=/path/to/chrome"
        )
    return browser


class Browser:
    """Page in a Chromium that is controlled by its DevTools protocol over pipes, without a port.

    `with Browser(address) as page: page.run("1 + 1")`.

    Args:
        address: address of the page, such as ``file:///…#t=1``.
        size: width and height of the window (CSS pixels).
        ready: JavaScript expression that is true when the page can be used.
        density: picture pixels per CSS pixel.

    Attributes:
        errors: errors of scripts and of the console.

    Raises:
        ViewerError: no browser, or it does not answer.
    """

    def __init__(
        self,
        address: str,
        size: tuple[int, int] = (1280, 860),
        ready: str = READY,
        density: float = 1.0,
    ) -> None:
        """Start a browser without a window, and wait until its page is ready.

        Args:
            address: URL of the page.
            size: width and height of the page (CSS pixels).
            ready: JavaScript expression that is true once the page can be used.
            density: pixels of a picture per CSS pixel.
        """
        program = find_browser()
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.number = 0
        self.received = b""
        self.session: dict[str, str] = {}
        self.errors: list[str] = []
        width, height = size
        flags = [*FLAGS, f"--user-data-dir={self.folder.name}", f"--window-size={width},{height}"]
        if os.geteuid() == 0:  # as in many containers: Chromium refuses its sandbox
            flags.append("--no-sandbox")
        commands, self.commands = os.pipe()
        self.answers, answers = os.pipe()
        pipes = f"3</dev/fd/{commands} 4>/dev/fd/{answers}"  # where Chromium expects them
        self.process = subprocess.Popen(
            ["/bin/sh", "-c", f'exec "$0" "$@" {pipes}', program, *flags, "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(commands, answers),
            start_new_session=True,
        )
        os.close(commands)
        os.close(answers)
        try:
            targets = self.request("Target.getTargets")["targetInfos"]
            (target,) = [t["targetId"] for t in targets if t["type"] == "page"]
            attached = self.request("Target.attachToTarget", targetId=target, flatten=True)
            self.session = {"sessionId": attached["sessionId"]}
            screen = {"width": width, "height": height, "deviceScaleFactor": density}
            self.request("Emulation.setDeviceMetricsOverride", mobile=False, **screen)
            for domain in ("Page", "Runtime", "Log"):
                self.request(f"{domain}.enable")
            self.request("Page.navigate", url=address)
            self.until(f"document.readyState === 'complete' && {ready}", OPEN_S)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Browser:
        """Return the browser itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the browser."""
        self.close()

    def close(self) -> None:
        """End the browser and remove its profile."""
        self.process.kill()
        self.process.wait()
        os.close(self.commands)
        os.close(self.answers)
        self.folder.cleanup()

    def request(self, method: str, **params: Any) -> Json:
        """Send a command, wait for its answer; complaints of the page go to `errors`.

        Args:
            method: name of the command in the DevTools protocol.
            params: parameters of the command.

        Raises:
            ViewerError: a refusal, no answer within a minute, or the browser has ended.
        """
        self.number += 1
        message = {"id": self.number, "method": method, "params": params} | self.session
        answer: Json = {}
        try:
            os.write(self.commands, json.dumps(message).encode() + b"\0")
            while answer.get("id") != self.number:
                answer = self._next_answer()
        except OSError as error:
            raise ViewerError(f"the browser gave no answer to {method}: {error}") from error
        if "error" in answer:
            raise ViewerError(f"the browser refused {method}: {answer['error']}")
        return answer["result"]

    def _next_answer(self) -> Json:
        """Read the next message of the browser; errors of the page are kept.

        Raises:
            OSError: no message within ANSWER_S, or the browser has ended.
        """
        while b"\0" not in self.received:
            if not select.select([self.answers], [], [], ANSWER_S)[0]:
                raise TimeoutError(f"nothing within {ANSWER_S:g} s")
            part = os.read(self.answers, 1 << 16)
            if not part:
                raise BrokenPipeError("it has ended")
            self.received += part
        text, self.received = self.received.split(b"\0", 1)
        answer = json.loads(text)
        params = answer.get("params", {})
        # of messages that answer no request only errors of the page are kept
        if answer.get("method") == "Runtime.exceptionThrown":
            self.errors.append(str(params["exceptionDetails"]))
        if answer.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        return answer

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression in the page, or the value to which a promise resolves.

        Raises:
            ViewerError: the script threw.
        """
        answer = self.request(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise ViewerError(f"a script of the page failed: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def until(self, script: str, timeout: float = 30.0) -> None:
        """Wait until a JavaScript expression is true.

        Raises:
            ViewerError: it is not within `timeout` (s).
        """
        deadline = time.monotonic() + timeout
        while not self.run(script):
            if time.monotonic() >= deadline:
                raise ViewerError(f"the page is not there after {timeout:g} s: {script}")
            time.sleep(0.05)

    def png(self) -> bytes:
        """Picture of the page as a PNG, after two further frames."""
        self.run(FRAMES)
        return base64.b64decode(self.request("Page.captureScreenshot", format="png")["data"])


def _address(page: str | Path, time: float, options: str) -> str:
    """Address of a page at a time (s) of its recording.

    Args:
        page: file written by `write_page`.
        time: s.
        options: further parts of the address's fragment, such as "&bare".

    Raises:
        InvalidInputError: the page holds no drawing commands.
    """
    path = Path(page).resolve()
    if b'unfold("' not in path.read_bytes():
        raise InvalidInputError(f"{page} holds no drawing commands: it was not made by write_page")
    return f"{path.as_uri()}#t={time:g}{options}"


# --- Still pictures -----------------------------------------------------------------------------


def write_png(
    page: str | Path,
    path: str | Path,
    time: float = 0.0,
    size: tuple[int, int] = (1280, 860),
    *,
    bare: bool = False,
    density: float = 1.0,
) -> Path:
    """Render a page at a time (s) of its recording; returns the path of the PNG.

    Args:
        page: file written by `write_page`.
        path: the PNG; it appears complete or not at all.
        time: s.
        size: size of the window, CSS pixels.
        bare: the scene and its labels alone.
        density: picture pixels per CSS pixel.

    Raises:
        ViewerError: no browser, or it gave no picture.
        InvalidInputError: the page holds no drawing commands.
    """
    address = _address(page, time, "&bare" if bare else "")
    with Browser(address, size, density=density) as browser:
        return write_whole(browser.png(), path)


# --- Moving pictures ----------------------------------------------------------------------------

SIZE = (640, 540)
"""Of a moving picture, pixels."""
RATE = 12.0
MOST_FRAMES = 72
LONGEST_S = 10.0
VIDEO_RATE = 25
LONGEST_VIDEO_S = 30.0
SAMPLES = 6
LEAST_CHANGE = 10  # of 255


def moments(begin: float, end: float, most: int = MOST_FRAMES) -> tuple[list[float], int]:
    """Times of the frames of a moving picture (s), and the duration of each frame (ms).

    There are twelve frames per second in real time, or fewer; a recording longer than 10 s is
    played faster. The duration is a multiple of 10 ms.

    Args:
        begin, end: beginning and end of the recording (s).
        most: largest number of frames.
    """
    import numpy as np

    span = max(end - begin, 1e-3)
    count = int(np.clip(np.ceil(span * RATE), 2, most))
    frame_ms = 10 * max(round(100.0 * min(span, LONGEST_S) / count), 4)
    return (np.linspace(begin, end, count, endpoint=False).tolist(), frame_ms)


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
        begin, end: first and last time of the recording to show (s).
        size: width and height of the picture (pixels).
        camera: view: "whole", "contacts", "from above" or "other side".
        most: largest number of frames.

    Raises:
        ViewerError: no browser, or it gave no picture.
        InvalidInputError: the page holds no drawing commands.
    """
    times, frame_ms = moments(begin, end, most)
    first, *further = one_palette(list(photographs(page, times, size, camera)))
    how = {
        "append_images": further,
        "duration": frame_ms,
        "loop": 0,
        "optimize": False,
        "disposal": 1,
    }
    with whole_file(path) as unfinished:
        first.save(unfinished, format="GIF", save_all=True, **how)
    return Path(path)


def write_mp4(
    page: str | Path,
    path: str | Path,
    begin: float,
    end: float,
    size: tuple[int, int] = SIZE,
) -> Path:
    """Write a video (H.264, 25 frames per second) of a page that plays a recording.

    It plays in real time; an interval longer than 30 s is played faster, within 30 s.

    Args:
        page: HTML file written by `write_scene`.
        path: file of the video; it appears when it is complete.
        begin, end: first and last time of the recording to show (s).
        size: width and height of the picture (pixels, even numbers).

    Returns:
        Path of the video.

    Raises:
        ViewerError: no browser, or it gave no picture.
        InvalidInputError: the page holds no drawing commands.
    """
    import av
    import numpy as np

    count = max(2, round(min(end - begin, LONGEST_VIDEO_S) * VIDEO_RATE))
    times = np.linspace(begin, end, count, endpoint=False).tolist()
    with whole_file(path) as unfinished, av.open(str(unfinished), "w", format="mp4") as video:
        stream = video.add_stream("libx264", rate=VIDEO_RATE, options={"crf": "20"})
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"  # the format that every player shows
        for picture in photographs(page, times, size):
            frame = av.VideoFrame.from_ndarray(np.asarray(picture), format="rgb24")
            video.mux(stream.encode(frame))
        video.mux(stream.encode())
    return Path(path)


def photographs(
    page: str | Path, times: Sequence[float], size: tuple[int, int], camera: str = "whole"
) -> Iterator[Image]:
    """Pictures of a page at times of its recording, without its controls.

    Args:
        page: file of the page.
        size: width and height of the pictures (pixels).
        camera: name of one of the page's cameras.
        times: times of the recording (s).
    """
    from PIL import Image

    address = _address(page, times[0], f"&movie&camera={quote(camera)}")
    with Browser(address, size) as browser:
        for time in times:
            browser.run(f"player.seek({time:.6f} - origin)")
            yield Image.open(io.BytesIO(browser.png())).convert("RGB")


def one_palette(frames: Sequence[Image]) -> list[Image]:
    """Frames in common 256 colours, without dithering, so that static pixels compress well.

    Pixels that hardly change keep their colour, as invisible flicker would need most of the bytes.

    Args:
        frames: pictures of equal size.
    """
    import numpy as np
    from PIL import Image

    pixels = np.array([np.asarray(frame) for frame in frames])
    for before, after in pairwise(pixels):
        still = np.abs(after.astype(int) - before).max(axis=2) <= LEAST_CHANGE
        after[still] = before[still]
    selected = np.linspace(0, len(frames) - 1, SAMPLES).round().astype(int)
    sheet = Image.fromarray(np.vstack(pixels[selected]))
    palette = sheet.quantize(256, method=Image.Quantize.MEDIANCUT)
    return [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in pixels
    ]


if __name__ == "__main__":  # `make browser`, `make demo`
    try:
        print(find_browser())
    except ViewerError as error:
        sys.exit(str(error))
