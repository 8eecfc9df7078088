"""Self-contained meshcat pages: drawing commands in, one HTML file out; no server, no socket.

meshcat's own ``static_html()`` asks a server process for the page. Here the `CommandSink` stands
in for the viewer window and keeps the commands itself, and `write_page` puts them, in the order in
which they were given, beside meshcat's JavaScript into one file. The page's content security
policy forbids every network address, so a page that opens offline opens the same online.
"""

from __future__ import annotations

import base64
import html
import json
import re
import warnings
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from osc_contact.errors import InvalidInputError
from osc_contact.files import whole_file

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = [
    "EMPTY", "POLICY", "CommandSink", "asset", "filled", "packed", "page_text", "set_background",
    "set_camera", "unfolded", "write_page", "write_whole",
]  # fmt: skip

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; worker-src blob:; connect-src data: blob:"
)

_SLOT = re.compile(r"\{\{(\w+)\}\}")
_DRAW = re.compile(r'^unfold\("([A-Za-z0-9+/=]*)"\)\..*;$', re.MULTILINE)
_COLOUR = re.compile(r"^#[0-9A-Fa-f]{6}$")


EMPTY: dict[str, Any] = {
    "live": False, "legend": [], "labels": [], "panels": [], "curves": {"t": [], "y": []},
    "begin": 0.0, "length": 0.0, "window": 0.0, "still": None, "aspect": 1.5,
    "cameras": [],
}  # fmt: skip
"""Configuration of a page without legend, labels and plots; aspect: width over height that the
camera was placed for, a narrower window shows everything smaller."""


class CommandSink:
    """Stands in for meshcat's ``ViewerWindow``: keeps the lowered commands in order.

    Attributes:
        commands: what was sent, as the plain dictionaries that meshcat's viewer understands.
    """

    def __init__(self) -> None:
        self.commands: list[dict[str, Any]] = []

    def send(self, command: Any) -> None:
        """Lower one meshcat command and keep it."""
        self.commands.append(command.lower())

    def visualizer(self) -> Visualizer:
        """A ``meshcat.Visualizer`` that draws into this sink."""
        return _meshcat().Visualizer(window=self)


def set_camera(
    scene: Visualizer, target: ArrayLike, offset: ArrayLike, field_of_view: float
) -> None:
    """Look at the target (m, world) from target + offset (m, world), field of view in degrees.

    meshcat 0.3.2 has no camera methods and its orbit controls always turn about the viewer's
    origin: the whole scene is moved so that the target lies there, and the camera sits at the
    offset in three.js axes (y up).

    Args:
        scene: of the page.
        target: (3,) what is looked at (m, world).
        offset: (3,) from there to the camera (m, world).
        field_of_view: vertical (degrees).
    """
    x, y, z = np.asarray(offset, dtype=float).tolist()
    shift = (-np.asarray(target, dtype=float)).tolist()
    scene.set_transform(_meshcat().transformations.translation_matrix(shift))
    camera = scene["/Cameras/default/rotated/<object>"]
    camera.set_property("position", [x, z, -y])
    camera.set_property("fov", field_of_view)


def set_background(scene: Visualizer, top: Sequence[float], bottom: Sequence[float]) -> None:
    """Background from the top to the bottom colour (r, g, b in 0..1), without grid and axes.

    Args:
        scene: of the page.
        top, bottom: colours (r, g, b in 0..1).
    """
    scene["/Background"].set_property("top_color", list(top))
    scene["/Background"].set_property("bottom_color", list(bottom))
    for helper in ("/Grid", "/Axes"):
        scene[helper].set_property("visible", False)


def page_text(sink: CommandSink, title: str, config: dict[str, Any]) -> str:
    """The page that draws the sink's commands, with everything it needs inside.

    Args:
        sink: the drawing commands.
        title: heading of the page.
        config: what the page's scripts want to know (see `Scene.config`); JSON-able.

    Raises:
        InvalidInputError: a colour is not of the form ``#RRGGBB``.
    """
    for place in ("legend", "labels"):
        for entry in config[place]:
            if not _COLOUR.match(entry["colour"]):
                raise InvalidInputError(
                    f"{place} entry {entry['text']!r} has the colour {entry['colour']!r}: write "
                    "it as #RRGGBB"
                )
    viewer = Path(_meshcat().viewer_assets_path()) / "dist" / "main.min.js"
    scripts = ("plot.js", "flat.js", "player.js", *(("live.js",) if config["live"] else ()))
    parts = {
        "policy": POLICY + (" 'self'" if config["live"] else ""),
        "title": html.escape(title),
        "style": asset("page.css"),
        "viewer": viewer.read_text(encoding="utf-8"),
        "config": json.dumps(config, allow_nan=False).replace("<", "\\u003c"),
        "scripts": "\n".join(asset(name).replace('"use strict";\n', "", 1) for name in scripts),
        "commands": _folded(sink.commands),
    }
    return filled("page.html", parts)


def write_page(
    sink: CommandSink, path: str | Path, title: str, config: dict[str, Any] = EMPTY
) -> Path:
    """Write `page_text` to a file, which appears complete or not at all; returns its path.

    Args:
        sink: what has been drawn.
        path: to write.
        title: of the page.
        config: what the page's scripts need.

    Raises:
        InvalidInputError: as `page_text`.
    """
    return write_whole(page_text(sink, title, config), path)


def write_whole(page: str, path: str | Path) -> Path:
    """Write a text file, which appears complete or not at all; returns its path."""
    with whole_file(path) as unfinished:
        unfinished.write_text(page, encoding="utf-8")
    return Path(path)


def _folded(commands: Sequence[dict[str, Any]]) -> str:
    """All commands, each after its length (4 bytes, little end first), zlib and base64."""
    parts = [packed(command) for command in commands]
    whole = b"".join(len(part).to_bytes(4, "little") + part for part in parts)
    return base64.b64encode(zlib.compress(whole, 9)).decode("ascii")


def packed(command: dict[str, Any]) -> bytes:
    """One command as meshcat's viewer reads it; numbers in single precision, as it keeps them."""
    import umsgpack

    return bytes(umsgpack.packb(command, force_float_precision="single"))


def unfolded(page: str) -> str:
    """The same page with its commands uncompressed, drawn before it counts as loaded.

    For renderers with a clock of their own, which a stream may stall (`write_png`).

    Raises:
        InvalidInputError: the page holds no drawing commands.
    """
    found = _DRAW.search(page)
    if not found:
        raise InvalidInputError("holds no drawing commands: it was not made by write_page")
    commands = base64.b64encode(zlib.decompress(base64.b64decode(found[1]))).decode("ascii")
    return _DRAW.sub(lambda _: f'drawAll(bytesOf("{commands}")); start();', page)


def filled(template: str, parts: Mapping[str, str]) -> str:
    """A template of the package's assets with its slots ``{{name}}`` filled."""
    return _SLOT.sub(lambda slot: parts[slot[1]], asset(template))


def asset(name: str) -> str:
    """Text of one of the package's page parts."""
    return (Path(__file__).parent / "assets" / name).read_text(encoding="utf-8")


def _meshcat() -> Any:
    """The meshcat package, without its first import's complaint about its own event loop."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    return meshcat
