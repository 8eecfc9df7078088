"""Geometry that the pictures of contact states, figs. 1 and 2, share, in metres and world axes."""

from typing import Any

import numpy as np

from osc_contact.lab.visual import contact_colour
from osc_contact.spatial import Array

FACE: dict[str, Any] = {"facecolor": "#9CC5C1", "edgecolor": "#3C6E6A", "alpha": 0.45}
HALO = {"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8}


def scale_equally(ax: Any, zoom: float) -> None:
    """Give all axes one scale."""
    limits = ax.get_xlim(), ax.get_ylim(), ax.get_zlim()
    ax.set_box_aspect(np.ptp(limits, axis=1), zoom=zoom)


def draw_line(ax: Any, points: Any, **look: Any) -> None:
    """A line through points (k, 3)."""
    ax.plot(*np.transpose(points), **look)


def draw_arrow(ax: Any, tail: Array, along: Array, colour: str) -> None:
    """An arrow from its tail (3,) along a vector (3,)."""
    ax.quiver(*tail, *along, color=colour, lw=3.0, arrow_length_ratio=0.25)


def draw_force(
    ax: Any, i: int, point: Array, arrow: Array, line: tuple[float, float], beside: float
) -> None:
    """The i-th contact force: its line, an arrow on it, its name.

    Args:
        ax: three-dimensional axes.
        i: number of the contact, from 0.
        point: (3,) of contact, where the arrow ends.
        arrow: (3,).
        line: its ends, beside: place of the name; in lengths of the arrow from the point.
    """
    colour = contact_colour(i)
    name = rf"$f_{{c{i + 1}}}$"
    ends = point + np.outer(line, arrow)
    draw_line(ax, ends, color=colour, lw=1.4, label=f"line of force of {name}")
    draw_arrow(ax, point - arrow, arrow, colour)
    ax.text(*(point + beside * arrow), name, color=colour, size=13, ha="center", bbox=HALO)
