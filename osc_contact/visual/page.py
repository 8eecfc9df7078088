"""Self-contained meshcat pages: drawing commands in, one HTML file out; no server, no socket.

meshcat's own ``static_html()`` asks a server process for the page. Here the `CommandSink` stands
in for the viewer window and keeps the commands itself, and `write_page` puts them, in the order in
which they were given, beside meshcat's JavaScript into one file. The page's content security
policy forbids every network address, so a page that opens offline opens the same online.
"""

from __future__ import annotations

import base64
import html
import os
import re
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from osc_contact.errors import InvalidInputError

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["CommandSink", "set_camera", "set_background", "write_page", "read_commands"]

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; worker-src blob:; connect-src data: blob:"
)

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>{title}</title>
<style>
body {{ margin: 0; font: 14px/1.5 "Helvetica Neue", Helvetica, Arial, sans-serif; }}
#meshcat-pane {{ width: 100vw; height: 100vh; overflow: hidden; }}
#caption {{ position: absolute; left: 16px; top: 12px; color: #222; pointer-events: none; }}
#caption h1 {{ font-size: 17px; font-weight: 600; margin: 0 0 4px; }}
#caption span {{ display: inline-block; width: 18px; height: 6px; margin-right: 8px;
  vertical-align: middle; border-radius: 3px; }}
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<div id="caption"><h1>{title}</h1>
{legend}
</div>
<script>
{viewer}
</script>
<script>
const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
const draw = (text) => viewer.handle_command_bytearray(
    Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));
{commands}
// page.html#t=2.5 shows the still at 2.5 s
const still = /t=([0-9.]+)/.exec(location.hash);
if (still) {{ viewer.animator.pause(); viewer.animator.seek(Number(still[1])); }}
</script>
</body>
</html>
"""
_DRAW = re.compile(r'^draw\("([A-Za-z0-9+/=]+)"\);$', re.MULTILINE)
_COLOUR = re.compile(r"^#[0-9A-Fa-f]{6}$")


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
    scene: Visualizer, target: Sequence[float], offset: Sequence[float], field_of_view: float
) -> None:
    """Look at the target (m, world) from target + offset (m, world), field of view in degrees.

    meshcat 0.3.2 has no camera methods and its orbit controls always turn about the viewer's
    origin: the whole scene is moved so that the target lies there, and the camera sits at the
    offset in three.js axes (y up).
    """
    x, y, z = (float(number) for number in offset)
    shift = [-float(number) for number in target]
    scene.set_transform(_meshcat().transformations.translation_matrix(shift))
    camera = scene["/Cameras/default/rotated/<object>"]
    camera.set_property("position", [x, z, -y])
    camera.set_property("fov", field_of_view)


def set_background(scene: Visualizer, top: Sequence[float], bottom: Sequence[float]) -> None:
    """Background from the top to the bottom colour (r, g, b in 0..1), without grid and axes."""
    scene["/Background"].set_property("top_color", list(top))
    scene["/Background"].set_property("bottom_color", list(bottom))
    for helper in ("/Grid", "/Axes"):
        scene[helper].set_property("visible", False)


def write_page(
    sink: CommandSink, path: str | Path, title: str, legend: Sequence[tuple[str, str]] = ()
) -> Path:
    """Write the sink's commands as one HTML file that plays by itself, offline.

    Args:
        sink: the drawing commands.
        path: the file to write; it appears complete or not at all.
        title: heading of the page.
        legend: pairs (colour ``#RRGGBB``, meaning) shown below the heading.

    Returns:
        The path written.

    Raises:
        InvalidInputError: a legend colour is not of the form ``#RRGGBB``.
    """
    import umsgpack

    for colour, meaning in legend:
        if not _COLOUR.match(colour):
            raise InvalidInputError(
                f"legend entry {meaning!r} has the colour {colour!r}: write it as #RRGGBB"
            )
    script = Path(_meshcat().viewer_assets_path()) / "dist" / "main.min.js"
    page = _PAGE.format(
        policy=_POLICY,
        title=html.escape(title),
        legend="\n".join(
            f'<div><span style="background:{colour}"></span>{html.escape(meaning)}</div>'
            for colour, meaning in legend
        ),
        viewer=script.read_text(encoding="utf-8"),
        commands="\n".join(
            f'draw("{base64.b64encode(umsgpack.packb(command)).decode("ascii")}");'
            for command in sink.commands
        ),
    )
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(page)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    return path


def read_commands(path: str | Path) -> list[dict[str, Any]]:
    """Decode the drawing commands of a written page, in the order in which they are drawn.

    Raises:
        InvalidInputError: the file holds no drawing commands.
    """
    import umsgpack

    packed = _DRAW.findall(Path(path).read_text(encoding="utf-8"))
    if not packed:
        raise InvalidInputError(f"{path} holds no drawing commands: it was not made by write_page")
    return [umsgpack.unpackb(base64.b64decode(text)) for text in packed]


def _meshcat() -> Any:
    """The meshcat package, without its first import's complaint about its own event loop."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    return meshcat
