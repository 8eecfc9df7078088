"""Self-contained meshcat pages: drawing commands in, one HTML file out; no server, no socket.

meshcat's own ``static_html()`` requests the page from a server process. Here the `CommandSink`
stands in for the viewer window and keeps the commands itself, and `write_page` puts them, in the
order in which they were given, beside meshcat's JavaScript into one file. The page's content
security policy forbids every network address, so a page that opens offline opens the same online.
"""

from __future__ import annotations

import base64
import html
import json
import re
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from osc_contact.errors import InvalidInputError
from osc_contact.files import Json, write_whole
from osc_contact.lab.visual.messages import packed

if TYPE_CHECKING:
    from meshcat import Visualizer


POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; worker-src blob:; connect-src data: blob:"
)

_SLOT = re.compile(r"\{\{(\w+)\}\}")
_COLOUR = re.compile(r"^#[0-9A-Fa-f]{6}$")

EMPTY: Json = {
    "live": False,
    "legend": [],
    "labels": [],
    "panels": [],
    "curves": {"t": [], "y": []},
    "begin": 0.0,
    "length": 0.0,
    "window": 0.0,
    "still": None,
    "aspect": 1.5,
    "cameras": [],
}
"""Configuration of a page without legend, labels and plots; aspect: width over height that the
camera was placed for, a narrower window shows everything smaller."""


class Around(NamedTuple):
    """Additional content of a page whose scene is moved by its own script.

    Attributes:
        script: name of the asset in the place of live.js, which defines `live()`.
        style: name of an asset, added to the page's.
        panel: HTML over the scene.
        head: HTML that comes first, such as a script that begins at once.
        policy: Content-Security-Policy of the page.
    """

    script: str
    style: str
    panel: str
    head: str
    policy: str


class CommandSink:
    """Replacement of meshcat's ``ViewerWindow`` that keeps the lowered commands in order.

    Attributes:
        commands: commands as dictionaries in the form that meshcat's viewer reads.
        animation: animation that follows the commands (`Animation.message`); empty: none.
    """

    def __init__(self) -> None:
        """Begin without commands and without an animation."""
        self.commands: list[Json] = []
        self.animation = b""

    def send(self, command: Any) -> None:
        """Lower one meshcat command and keep it."""
        self.commands.append(command.lower())

    def visualizer(self) -> Visualizer:
        """A ``meshcat.Visualizer`` that draws into this sink."""
        return _meshcat().Visualizer(window=self)


def page_text(sink: CommandSink, title: str, config: Json, around: Around | None = None) -> str:
    """HTML text of a page that draws the commands of a sink; it loads no other file.

    Args:
        sink: the drawing commands.
        title: heading of the page.
        config: data for the page's scripts: legend, labels, plots; JSON-able.
        around: source of a live page's motion; default: the server of the live view.

    Raises:
        InvalidInputError: a colour is not of the form ``#RRGGBB``.
    """
    for entry in (*config["legend"], *config["labels"]):
        if not _COLOUR.match(entry["colour"]):
            raise InvalidInputError(
                f"{entry['text']!r} has the colour {entry['colour']!r}: write it as #RRGGBB"
            )
    viewer = Path(_meshcat().viewer_assets_path()) / "dist" / "main.min.js"
    mover = "live.js" if around is None else around.script
    scripts = ("plot.js", "flat.js", "player.js", *((mover,) if config["live"] else ()))
    messages = [*map(packed, sink.commands), sink.animation]
    commands = b"".join(
        len(message).to_bytes(4, "little") + message for message in messages if message
    )
    parts = {
        "policy": around.policy if around else POLICY + (" 'self'" if config["live"] else ""),
        "title": html.escape(title),
        "style": asset("page.css") + (asset(around.style) if around else ""),
        "head": around.head if around else "",
        "panel": around.panel if around else "",
        "viewer": viewer.read_text(encoding="utf-8"),
        "config": json.dumps(config, allow_nan=False).replace("<", "\\u003c"),
        "scripts": "\n".join(asset(name).replace('"use strict";\n', "", 1) for name in scripts),
        "commands": base64.b64encode(zlib.compress(commands, 9)).decode("ascii"),
    }
    return filled("page.html", parts)


def write_page(sink: CommandSink, path: str | Path, title: str, config: Json = EMPTY) -> Path:
    """Write `page_text` to a file, which appears complete or not at all; returns its path.

    Args:
        sink: commands drawn so far.
        path: file to write.
        title: title of the page.
        config: data for the page's scripts.

    Raises:
        InvalidInputError: as `page_text`.
    """
    return write_whole(page_text(sink, title, config), path)


def filled(template: str, parts: Mapping[str, str]) -> str:
    """A template of the package's assets with its slots ``{{name}}`` filled."""
    return _SLOT.sub(lambda slot: parts[slot[1]], asset(template))


def asset(name: str) -> str:
    """Text of one of the package's page parts."""
    return (Path(__file__).parent / "assets" / name).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Embedded:
    """Page that a notebook shows and contains.

    Attributes:
        page: HTML of the page.
        height: height of the view (pixels).
    """

    page: str = field(repr=False)
    height: int

    def _repr_html_(self) -> str:
        """Return the page in a frame, which notebooks show."""
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" loading="lazy" '
            f'style="width: 100%; height: {self.height}px; border: 0"></iframe>'
        )


def embed(path: str | Path, height: int = 640) -> Embedded:
    """Show a page of `write_scene` as the value of a notebook's cell.

    Args:
        path: the page, such as scene.html of a run.
        height: pixels.
    """
    return Embedded(Path(path).read_text(encoding="utf-8"), height)


def _meshcat() -> Any:
    """The meshcat package, without its first import's complaint about its own event loop."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    return meshcat
