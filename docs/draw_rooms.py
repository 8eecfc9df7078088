"""The rooms in docs/design.md: `python docs/draw_rooms.py` writes docs/images/rooms.svg.

A room is a folder or a module of the package; a line leads from it down to a room that it imports.
A line is left out where others lead the same way. `errors` and `files`, which most rooms import,
are not drawn.
"""

from __future__ import annotations

import textwrap
from functools import cache
from html import escape
from pathlib import Path

import grimp

PICTURE = Path(__file__).parent / "images" / "rooms.svg"
ROOMS = {  # column and duty
    "benchmarks": (2.2, "times of tick, peers and runs"),
    "paper": (2.2, "figures, studies and their report"),
    "cli": (2.2, "commands and their tables"),
    "sweeps": (2.2, "many runs, tuning, environments"),
    "runs": (2.2, "rig, loop, preflight, verdict"),
    "visual": (0.5, "plots, scenes, live view"),
    "plants": (2.2, "MuJoCo, and rigid contacts"),
    "control": (4.8, "Controller: settings, reports"),
    "recorder": (0.0, "recordings and their files"),
    "response": (4.4, "contact forces and motion, eqs. 17–20"),
    "sensing": (5.3, "estimates from sensors"),
    "dynamics": (1.7, "arms, grasps, closed chain"),
    "contacts": (2.7, "contact pairs: N, T and n_γ"),
    "interface": (4.3, "measurement and reference"),
    "robots": (0.7, "URDF and MJCF, checked"),
    "law": (2.2, "one tick: wrenches to torques"),
    "projections": (3.15, "of forces and motions, eqs. 3–12"),
    "scenarios": (5.3, "declarations of the YAML keys"),
    "spans": (1.0, "orthonormal bases in a metric"),
    "jerk_limits": (5.3, "set points in time"),
    "spatial": (2.6, "conventions of 6-vectors"),
}
COLUMN, ROW, WIDTH, HEIGHT = 162, 104, 140, 66


def room_of(module: str) -> str:
    """The room of a module; the modules of the command line are one."""
    top, _, rest = module.partition(".")
    name = rest.partition(".")[0] if top == "osc_contact" else top
    return "cli" if name.startswith("cli_") or name in ("console", "__main__") else name


def imports() -> dict[str, set[str]]:
    """The rooms that each room imports."""
    graph = grimp.build_graph("osc_contact", "paper", "benchmarks", cache_dir=None)
    found: dict[str, set[str]] = {room: set() for room in ROOMS}
    for module in graph.modules:
        room = room_of(module)
        below = map(room_of, graph.find_modules_directly_imported_by(module))
        found.get(room, set()).update(ROOMS.keys() & set(below) - {room})
    return found


def drawing() -> str:
    """The picture, as SVG."""
    below = imports()

    @cache
    def reach(room: str) -> frozenset[str]:
        return frozenset(below[room]).union(*map(reach, below[room]))

    @cache
    def floor(room: str) -> int:
        return max((1 + floor(above) for above in ROOMS if room in below[above]), default=0)

    def place(room: str) -> tuple[float, int]:
        return (80 + COLUMN * ROOMS[room][0], 40 + ROW * floor(room))

    lines, boxes = [], []
    for room, (_, duty) in ROOMS.items():
        x, y = place(room)
        for other in sorted(below[room]):
            if not any(other in reach(between) for between in below[room]):
                end, bottom = place(other)
                middle = (y + bottom) / 2
                curve = f"M{x:g} {y} C{x:g} {middle:g} {end:g} {middle:g} {end:g} {bottom}"
                lines.append(f'<path d="{curve}"/>')
        corner = f'x="{x - WIDTH / 2:g}" y="{y - HEIGHT / 2:g}"'
        boxes.append(f'<rect {corner} width="{WIDTH}" height="{HEIGHT}" rx="6"/>')
        boxes.append(f'<text x="{x:g}" y="{y - 13}" class="name">{room}</text>')
        for i, text in enumerate(textwrap.wrap(duty, 20)):
            boxes.append(f'<text x="{x:g}" y="{y + 5 + 17 * i}">{escape(text)}</text>')
    style = (
        "text{font:14px sans-serif;text-anchor:middle;fill:#333}.name{font-weight:bold}"
        "rect{fill:#eef3f8;stroke:#4a6b8a}path{fill:none;stroke:#8aa0b5;stroke-width:1.5}"
    )
    right, bottom = (max(place(room)[i] for room in ROOMS) for i in (0, 1))
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {right + 80:g} {bottom + 40:g}">'
    ground = '<rect width="100%" height="100%" style="fill:#fff;stroke:none"/>'
    return "\n".join([head, f"<style>{style}</style>", ground, *lines, *boxes, "</svg>\n"])


if __name__ == "__main__":
    PICTURE.write_text(drawing(), encoding="utf-8")
