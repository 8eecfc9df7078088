"""Pictures of pages: a Chromium without window or network renders them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from osc_contact.errors import ViewerError
from osc_contact.files import whole_file
from osc_contact.visual.page import unfolded

__all__ = ["FLAGS", "find_browser", "write_png"]

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
VARIABLE = "OSC_CONTACT_BROWSER"
FLAGS = (
    "--headless", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-extensions",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
)  # fmt: skip
"""Software rendering, asked for by name: the fallback to it is being withdrawn from Chromium."""
TIMEOUT_S = 120.0


def find_browser() -> str:
    """Path of the browser: the one named by OSC_CONTACT_BROWSER, or the first found on PATH.

    Raises:
        ViewerError: there is none, with the cure.
    """
    wanted = os.environ.get(VARIABLE)
    found = next((path for path in map(shutil.which, (wanted,) if wanted else NAMES) if path), None)
    if found is None:
        where = f"{VARIABLE}={wanted}" if wanted else ", ".join(NAMES) + " on PATH"
        raise ViewerError(
            f"no browser to render pictures with (looked for {where}). Install Chromium "
            f"(Debian, Ubuntu: apt-get install chromium), or name one: {VARIABLE}=/path/to/chrome"
        )
    return found


def sandbox_flags() -> tuple[str, ...]:
    """Chromium refuses its sandbox when it runs as root, as in many containers."""
    return ("--no-sandbox",) if os.geteuid() == 0 else ()


def main() -> None:
    """Print the browser's path, or say how to get one and exit with 1 (`make browser`)."""
    try:
        print(find_browser())
    except ViewerError as error:
        sys.exit(str(error))


def write_png(
    page: str | Path,
    path: str | Path,
    time: float | None = None,
    size: tuple[int, int] = (1280, 860),
    *,
    bare: bool = False,
    density: float = 1.0,
) -> Path:
    """Render a page as it looks at a time (s) of its recording; returns the path of the PNG.

    Args:
        page: file written by `write_page`.
        path: the PNG; it appears complete or not at all.
        time: s, default the beginning.
        size: of the window, CSS pixels.
        bare: the scene and its labels alone.
        density: picture pixels per CSS pixel.

    Raises:
        ViewerError: no browser, or it gave no picture.
        InvalidInputError: the page holds no drawing commands.
    """
    target = Path(path).resolve()
    browser = find_browser()
    text = unfolded(Path(page).read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory(prefix="osc_contact_", ignore_cleanup_errors=True) as folder:
        picture, plain = Path(folder) / "picture.png", Path(folder) / "page.html"
        plain.write_text(text, encoding="utf-8")
        address = f"{plain.as_uri()}#t={0.0 if time is None else time:g}" + "&bare" * bare
        command = [
            browser, *FLAGS, *sandbox_flags(), f"--window-size={size[0]},{size[1]}",
            f"--force-device-scale-factor={density:g}", "--virtual-time-budget=1500",
            f"--user-data-dir={folder}/profile", f"--screenshot={picture}", address,
        ]  # fmt: skip
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=TIMEOUT_S, text=True, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ViewerError(f"{browser} gave no picture of {page}: {error}") from error
        if not picture.is_file():
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise ViewerError(
                f"{browser} gave no picture of {page} (exit code {done.returncode}): {last}"
            )
        with whole_file(target) as unfinished:
            shutil.copyfile(picture, unfinished)
    return target


if __name__ == "__main__":
    main()
