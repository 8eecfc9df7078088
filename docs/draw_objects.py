"""The picture in docs/objects.md: `python docs/draw_objects.py` writes docs/images/objects.svg.

A box is an object with the line that makes it; an arrow leads from an object to one that uses it.
"""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import NamedTuple

PICTURE = Path(__file__).parent / "images" / "objects.svg"
WIDTH, HEIGHT = 1080, 700


class Box(NamedTuple):
    """An object: its centre and size, its kind (a style), its name and the lines below it."""

    x: int
    y: int
    width: int
    height: int
    kind: str
    name: str
    lines: tuple[str, ...]


BOXES = {
    "scenario": Box(
        290, 60, 400, 76, "lab", "Scenario",
        ("a whole experiment, from a YAML file", 'osc.load_scenario("two_contact_rod")'),
    ),
    "rig": Box(
        790, 60, 400, 76, "lab", "Rig",
        ("makes plant, controller and references of it", "osc.build_rig(scenario)"),
    ),
    "arm": Box(
        160, 205, 280, 76, "part", "Arm",
        ("a robot's model, one per arm", 'osc.Arm.from_urdf(FILE, tip="…")'),
    ),
    "object": Box(
        540, 205, 300, 76, "part", "RigidObject",
        ("what the arms hold", "osc.RigidObject(inertia)"),
    ),
    "pair": Box(
        920, 205, 280, 76, "part", "a pair, VertexOnFace",
        ("two touching features, one per contact", "osc.VertexOnFace(vertex, …)"),
    ),
    "chain": Box(
        270, 325, 300, 76, "part", "ClosedChain",
        ("arms and object as one mechanism", "osc.ClosedChain([arm], payload=ball)"),
    ),
    "contact": Box(
        920, 325, 280, 76, "data", "Contact",
        ("the pair's N, T and n_γ in one pose", "pair.contact(X_WO, V_O)"),
    ),
    "robot": Box(
        160, 490, 260, 96, "loop", "Robot",
        ("hardware, or a Plant: a simulated", "one that also has the truth",
         "RigidPlant(chain, [table], step)"),
    ),
    "controller": Box(
        540, 490, 270, 96, "loop", "Controller",
        ("motor torques of one tick, and a", "status where they are not the law's",
         "osc.Controller(chain, [table], …)"),
    ),
    "reference": Box(
        920, 490, 280, 96, "data", "Reference",
        ("what is desired in one tick: pose, twist,", "acceleration, forces",
         "osc.Reference(X_WD, alpha_d=[10])"),
    ),
    "recorder": Box(
        330, 630, 280, 76, "loop", "Recorder",
        ("notes each tick", "osc.Recorder(controller, robot)"),
    ),
    "recording": Box(
        790, 630, 340, 76, "data", "Recording",
        ("time series to save, draw and judge", "recorder.recording()"),
    ),
}  # fmt: skip
ARROWS = (  # path, label, place of the label
    ("M490 60 H586", "", (0, 0)),
    ("M200 243 V285", "", (0, 0)),
    ("M440 243 L390 285", "", (0, 0)),
    ("M920 243 V285", "", (0, 0)),
    ("M420 340 L490 440", "", (0, 0)),
    ("M780 240 L600 440", "", (0, 0)),
    ("M290 478 H401", "Measurement", (347, 468)),
    ("M405 502 H294", "torques", (349, 522)),
    ("M780 490 H679", "", (0, 0)),
    ("M440 538 L400 590", "", (0, 0)),
    ("M470 630 H616", "", (0, 0)),
)
STYLE = (
    "text{font:13.5px sans-serif;text-anchor:middle;fill:#333}"
    ".name{font-weight:bold;font-size:15px}"
    ".code{font-family:monospace;font-size:12px;fill:#234}"
    "rect{stroke-width:1.5}.part{fill:#eef3f8;stroke:#4a6b8a}.loop{fill:#fdf1e3;stroke:#b8741a}"
    ".data{fill:#eef7ee;stroke:#4b8a4f}.lab{fill:#f4f4f4;stroke:#777}"
    "path{fill:none;stroke:#5d6b78;stroke-width:1.6}.frame{stroke-dasharray:6 5;stroke:#b8741a}"
    ".level{stroke-dasharray:2 5;stroke:#999}.left{text-anchor:start}"
)


def drawing() -> str:
    """The picture, as SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}">',
        f"<style>{STYLE}</style>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 L8 4 L0 8 Z" '
        'style="fill:#5d6b78;stroke:none"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{HEIGHT}" style="fill:#fff;stroke:none"/>',
        f'<path class="level" d="M0 130 H{WIDTH}"/>',
        '<text x="14" y="122" class="left">a scenario makes all below</text>',
        '<text x="14" y="150" class="left">a program makes them itself</text>',
        '<path class="frame" d="M14 405 H1066 V552 H14 Z"/>',
        '<text x="1056" y="572" style="text-anchor:end">'
        '<tspan class="code">osc.run_loop(robot, controller, references, recorder=recorder)</tspan>'
        "</text>",
    ]
    for path, label, (x, y) in ARROWS:
        parts.append(f'<path d="{path}" marker-end="url(#tip)"/>')
        if label:
            parts.append(f'<text x="{x}" y="{y}">{label}</text>')
    for box in BOXES.values():
        left, top = box.x - box.width / 2, box.y - box.height / 2
        parts.append(
            f'<rect class="{box.kind}" x="{left:g}" y="{top:g}" width="{box.width}" '
            f'height="{box.height}" rx="6"/>'
        )
        parts.append(f'<text x="{box.x}" y="{top + 21:g}" class="name">{escape(box.name)}</text>')
        for i, line in enumerate(box.lines):
            kind = ' class="code"' if i == len(box.lines) - 1 else ""
            parts.append(f'<text x="{box.x}" y="{top + 42 + 20 * i:g}"{kind}>{escape(line)}</text>')
    return "\n".join([*parts, "</svg>\n"])


if __name__ == "__main__":
    PICTURE.write_text(drawing(), encoding="utf-8")
