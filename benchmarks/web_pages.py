"""Tasks in a browser: size, start, pace and the answers to the questions of docs/try_it.md.

    python -m benchmarks.web_pages [--hour]

The pages of docs/try_it.md are written to a temporary folder, served from this machine and played
by a headless Chromium, whose pictures are drawn by software. One row for each page is printed, then
the figures of the answers. On an idle machine: browser and task need one core each.
"""

import functools
import http.server
import io
import json
import runpy
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from osc_contact.lab.visual.browser import FRAMES, Browser
from osc_contact.spatial import Array
from paper.study import table_of

EXTENSION = runpy.run_path(str(Path(__file__).parents[1] / "docs/_ext/try_it.py"))
TASKS: dict[str, bool] = EXTENSION["TASKS"]  #: pages, and whether a selection law runs beside
REPORTED = "typeof measured === 'object' && measured"  #: measurements of a page, once it has some
PACED_S = 20.0  #: time on the clock in which the pace with pictures is measured
HOUR = 60  #: blocks of a minute of simulated time
JUMP_N = 0.1  #: change of a desired force from tick to tick that counts as a jump (N)
SETTLED = 200  #: ticks after a jump whose errors are not counted


# --- A page and its task --------------------------------------------------------------------------


class StaticFiles(http.server.SimpleHTTPRequestHandler):
    """Server of a folder's static files that writes no log."""

    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    policy = ""  #: Content-Security-Policy of the scripts; empty: none

    def end_headers(self) -> None:
        """Add the policy to the headers of a script."""
        if self.policy and self.path.endswith(".mjs"):
            self.send_header("Content-Security-Policy", self.policy)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Write nothing."""


@contextmanager
def served(folder: Path, policy: str = "") -> Iterator[str]:
    """Address of a folder's static files, whose scripts have a Content-Security-Policy."""
    kind = type("Handler", (StaticFiles,), {"policy": policy})
    handler = functools.partial(kind, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def post(page: Browser, **order: Any) -> None:
    """Send an order to the task of a page, such as kind="run", on=False."""
    page.run(f"task.postMessage({json.dumps(order)})")


def run_ticks(page: Browser, ticks: int, **more: Any) -> dict[str, Any]:
    """Result of a number of ticks without pictures; `more` belongs to the order."""
    order = json.dumps(more | {"kind": "flat", "ticks": ticks})
    page.run(f"delete measured.flat; task.postMessage({order})")
    page.until(f"{REPORTED}.flat", 300.0)
    found: dict[str, Any] = json.loads(page.run("JSON.stringify(measured.flat)"))
    return found


def next_picture(page: Browser) -> dict[str, Any]:
    """Numbers of the picture after one more tick of a task, which is stopped."""
    post(page, kind="run", on=False)
    run_ticks(page, 0)  # pictures of earlier orders have arrived ...
    page.run(FRAMES)  # ... and are drawn
    before = page.run("measured.pictures")
    post(page, kind="step", ticks=1)
    page.until(f"measured.pictures > {before}")
    found: dict[str, Any] = json.loads(page.run("JSON.stringify(measured.newest)"))
    return found


def set_slider(page: Browser, name: str, value: float) -> None:
    """Move a slider of a page."""
    page.run(
        f"(() => {{ const x = document.querySelector('input[name={json.dumps(name)}]'); "
        f"x.value = {value}; x.dispatchEvent(new Event('input')); }})()"
    )


# --- Figures --------------------------------------------------------------------------------------


def zipped_mb(folder: Path) -> float:
    """Size of a folder over the wire, each file zipped (MB)."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for file in sorted(folder.rglob("*")):
            archive.write(file, file.relative_to(folder))
    return content.tell() / 1e6


def paced(page: Browser) -> tuple[float, float]:
    """Simulated seconds per second on the clock with pictures, and pictures per second."""

    def state() -> tuple[float, float, float]:
        t, pictures = page.run("[measured.newest.t, measured.pictures]")
        return time.perf_counter(), t, pictures

    began = state()
    time.sleep(PACED_S)
    seconds, simulated, pictures = np.subtract(state(), began)
    return float(simulated / seconds), float(pictures / seconds)


def errors_in(page: Browser, ticks: int) -> Array:
    """Error of each true force (N) in each of the next ticks: (ticks, forces).

    NaN in the SETTLED ticks after a jump of a desired force: they are not counted.
    """
    found = run_ticks(page, ticks, note=True)
    true, commanded = np.reshape(found["truths"], (ticks, 2, -1)).swapaxes(0, 1)
    error: Array = true - commanded
    jumps = np.abs(np.diff(commanded, axis=0)).max(axis=1) > JUMP_N
    for k in np.flatnonzero(jumps):
        error[k + 1 : k + 1 + SETTLED] = np.nan
    return error


def errors_of(page: Browser, ticks: int) -> tuple[Array, Array]:
    """rms and largest error of each true force (N) in the next ticks, see `errors_in`."""
    error = errors_in(page, ticks)
    return np.sqrt(np.nanmean(error**2, axis=0)), np.nanmax(np.abs(error), axis=0)


def press_harder(page: Browser) -> str:
    """Answer of two_contact_rod: error of the right force, beside that of the selection law."""
    post(page, kind="compare", on=True)
    run_ticks(page, 1000)
    set_slider(page, "force left end", 15)
    run_ticks(page, 4000)
    picture = next_picture(page)
    rms = [
        1e3 * np.sqrt(errors["squares"][1] / errors["count"])
        for errors in (picture["errors"], picture["beside"]["errors"])
    ]
    return f"right force: {rms[0]:.1f} mN rms, under the selection law {rms[1]:.0f} mN"


def turn_the_table(page: Browser) -> str:
    """Answer of panda_edge: errors before and after the edge of the table turns by 4°."""
    run_ticks(page, 5000)
    before, _ = errors_of(page, 3000)
    set_slider(page, page.run("CONFIG.task.walls[0].name") + ": turned by", 4)
    run_ticks(page, 5000)
    after, _ = errors_of(page, 3000)
    return f"force: {1e3 * before.max():.1f} mN rms before, {1e3 * after.max():.1f} after"


def roughen(page: Browser) -> str:
    """Answer of ur5_wipe: errors with a friction of 0.3 that is not in the law's model.

    The motion turns round at the end of its table at about 7.4 s: friction reverses there.
    """
    set_slider(page, "friction of the contacts", 0.3)
    run_ticks(page, 2000)
    wiping, _ = errors_of(page, 5000)
    turning = np.abs(errors_in(page, 1000)).max(axis=1)
    return (
        f"forces: {1e3 * wiping.max():.0f} mN rms while it wipes; where the motion turns round "
        f"{np.nanmax(turning):.1f} N at most, above 1 N for {(turning > 1.0).sum()} ms"
    )


def move_the_posts(page: Browser) -> str:
    """Answer of three_arm_plate: errors while the posts move by 2 mm, and afterwards."""
    run_ticks(page, 5000)
    set_slider(page, page.run("CONFIG.task.walls[0].name") + ": moved by", 2)
    _, moving = errors_of(page, 2000)
    _, rest = errors_of(page, 2000)
    return f"forces: {moving.max():.2f} N at most while the posts move, {rest.max():.3f} N after"


ANSWERS = {
    "two_contact_rod": press_harder,
    "panda_edge": turn_the_table,
    "ur5_wipe": roughen,
    "three_arm_plate": move_the_posts,
}


def play_an_hour(page: Browser) -> str:
    """Sizes of the heaps before and after an hour of simulated time."""
    before = run_ticks(page, 5000)["heaps"]
    for _ in range(HOUR):
        found = run_ticks(page, 60_000)
    return f"heaps before an hour: {before}, after it: {found['heaps']}"


def main(
    hour: Annotated[bool, typer.Option(help="also play the first page for an hour")] = False,
) -> None:
    """Print a row for each page, then the answers."""
    heads = (
        "page; zipped (MB); first tick (s); simulated seconds per second, with pictures; "
        "pictures a second"
    )
    rows: list[tuple[str, ...]] = []
    answers = []
    with TemporaryDirectory() as folder:
        EXTENSION["write_pages"](Path(folder))
        with served(Path(folder)) as address:
            for name, answer in ANSWERS.items():
                ready = f"{REPORTED}.pictures > 0"
                with Browser(f"{address}{name}/index.html", ready=ready) as page:
                    first = page.run("measured.firstTick") / 1e3
                    pace = paced(page)
                    post(page, kind="run", on=False)
                    post(page, kind="restart")
                    answers.append(f"{name}: {answer(page)}")
                    if hour and not rows:
                        answers.append(f"{name}: {play_an_hour(page)}")
                numbers = (zipped_mb(Path(folder) / name), first, *pace)
                rows.append((name, *(f"{number:.2f}" for number in numbers)))
    Console(width=120).print(table_of("Tasks in a browser", heads, rows))
    for line in answers:
        print(line)


if __name__ == "__main__":
    typer.run(main)
