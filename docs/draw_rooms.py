"""The rooms in docs/design.md: `python docs/draw_rooms.py` writes docs/images/rooms.svg.

A room is a folder or a module of the package; a line leads from it down to a room that it imports.
A line is left out where others lead the same way. `errors` and `files`, which most rooms import,
are not drawn. Rooms of the lab stand above those of the core.
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
    "sweeps": (1.0, "many runs, tuning, environments"),
    "reports": (3.4, "tables, scenes, live view"),
    "runs": (2.2, "a run, its verdict, recovery"),
    "checks": (2.2, "preflight, inspection"),
    "rig": (2.2, "a scenario as objects"),
    "plants": (3.4, "MuJoCo, and rigid contacts"),
    "visual": (0.4, "plots, scenes and their page"),
    "scenarios": (2.2, "YAML keys and their checks"),
    "loop": (3.4, "run_loop, recorder, start checks"),
    "control": (3.8, "Controller: settings, reports"),
    "drivers": (5.2, "robots by their makers' protocols"),
    "recorder": (0.0, "recordings and their files"),
    "response": (1.8, "contact forces and motion, eqs. 17–20"),
    "sensing": (5.2, "estimates from sensors"),
    "dynamics": (2.9, "arms, grasps, closed chain"),
    "contacts": (1.8, "contact pairs: N, T and n_γ"),
    "interface": (5.2, "measurement and reference"),
    "robots": (0.7, "URDF and MJCF, checked"),
    "settings": (2.0, "quantities, gains, limits"),
    "projections": (4.1, "of forces and motions, eqs. 3–12"),
    "law": (3.0, "one tick: wrenches to torques"),
    "jerk_limits": (4.05, "set points in time"),
    "spatial": (4.1, "conventions of 6-vectors"),
}
COLUMN, ROW, WIDTH, HEIGHT = 162, 92, 140, 66
LAB = "osc_contact.lab"
OUTSIDE = {"benchmarks", "paper"}


def room_of(module: str) -> str:
    """The room of a module: its folder, in the lab the folder there."""
    top, name, inner = (*module.split("."), "", "")[:3]
    if top != "osc_contact":
        return top
    return inner if name == "lab" else name


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
    lab = {room_of(name) for name in grimp.build_graph("osc_contact").find_children(LAB)}

    @cache
    def reach(room: str) -> frozenset[str]:
        return frozenset(below[room]).union(*map(reach, below[room]))

    @cache
    def floor(room: str) -> int:
        least = max((1 + floor(above) for above in ROOMS if room in below[above]), default=0)
        return least if room in OUTSIDE | lab else max(least, ground)

    ground = 1 + max(map(floor, sorted(lab & ROOMS.keys())))

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
    paper = '<rect width="100%" height="100%" style="fill:#fff;stroke:none"/>'
    first = min(place(room)[1] for room in lab & ROOMS.keys()) - ROW / 2
    middle = 40 + ROW * (ground - 0.5)
    for name, begin, end in (("lab", first, middle), ("core", middle, bottom + 40)):
        lines.append(f'<path d="M0 {begin:g} H{right + 80:g}" style="stroke-dasharray:6 6"/>')
        lines.append(
            f'<text x="{right + 40:g}" y="{(begin + end) / 2:g}" class="name">{name}</text>'
        )
    return "\n".join([head, f"<style>{style}</style>", paper, *lines, *boxes, "</svg>\n"])


if __name__ == "__main__":
    PICTURE.write_text(drawing(), encoding="utf-8")
