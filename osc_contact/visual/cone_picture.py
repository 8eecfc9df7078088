"""Fig. 2 as a picture: a cone in a V groove, its two twist axes, the lines of force on the walls.

Everything is drawn from geometry given in metres, world axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from osc_contact.visual import OKABE_ITO, contact_colour
from osc_contact.visual.contact_picture import FACE, HALO, arrow, fill, orthographic
from osc_contact.visual.style import style

__all__ = ["draw_cone_in_groove"]

Array = NDArray[np.float64]
_TURN, _SLIDE = OKABE_ITO["black"], "#5B3A8E"


def draw_cone_in_groove(
    apex: Array,
    axis: Array,
    height: float,
    half_angle: float,
    groove: Array,
    normals: Sequence[Array],
    points: Array,
    directions: Array,
    title: str,
    words: Sequence[str],
) -> Figure:
    """Draw the cone, the groove, t₁ and t₂ with the angle between them, and lines of force.

    Args:
        apex: (3,) m. axis: (3,) unit, from apex to base. height: m. half_angle: rad.
        groove: (3,) unit, along the groove's line, which passes through the apex.
        normals: of the two walls, (3,) unit, out of the material.
        points: (3, 4) where the cone presses, along the first wall and then along the second (m).
        directions: (3, 4) unit, into the walls.
        title: heading. words: lines of text beside the picture.
    """
    h, up = height, np.array([0.0, 0.0, 1.0])
    with style():
        room = (-0.02, -0.06, 0.68, 1.0)
        figure, ax = orthographic((10.5, 6.2), room, apex + 0.85 * h * axis, 1.25 * h, zoom=1.5)
        ax.set_axis_off()
        ax.view_init(33.0, np.rad2deg(np.arctan2(groove[1], groove[0])) + 180.0 + 29.0)
        for normal in normals:
            down = np.cross(normal, groove)
            out = down if down @ up > 0.0 else -down
            corners = [(-0.5, 0.0), (1.5, 0.0), (1.5, 0.95), (-0.5, 0.95)]
            wall = np.array([apex + h * (u * groove + v * out) for u, v in corners])
            fill(ax, wall[None], **FACE)
        side, base = _cone(apex, axis, h, half_angle)
        seamless: dict[str, Any] = {"edgecolor": "none", "antialiaseds": False, "zorder": 3}
        fill(ax, side, facecolor="#B9BEC6", alpha=0.22, **seamless)
        fill(ax, base[None], facecolor="#9AA1AB", alpha=0.25, **seamless)
        ax.plot(*base.T, color="#4A4F57", lw=1.3, zorder=4)
        for silhouette in _silhouette(ax, apex, axis, h, half_angle):
            ax.plot(*np.array([apex, silhouette]).T, color="#4A4F57", lw=1.3, zorder=4)
        for i, (p, d) in enumerate(zip(points.T, directions.T, strict=True)):
            colour, name = contact_colour(i), rf"$f_{{c{i + 1}}}$"
            if i % 2 == 0:
                ax.plot(*np.array([apex, points[:, i + 1]]).T, color="#22262B", lw=3.0, zorder=4,
                        label="lines of contact" if i == 0 else None)  # fmt: skip
            ax.plot(*np.array([p - 0.48 * h * d, p + 0.26 * h * d]).T, color=colour, lw=1.2,
                    zorder=5, label=f"line of force of {name}")  # fmt: skip
            arrow(ax, p - 0.36 * h * d, p, colour, 0.018 * h)
            ax.text(*(p + 0.34 * h * d), name, color=colour, size=13, zorder=8, ha="center",
                    va="center", bbox=HALO)  # fmt: skip
        _axes(ax, apex, axis, groove, h)
        figure.suptitle(title, x=0.03, y=0.97, ha="left", size=12, weight="bold")
        figure.legend(loc="upper left", bbox_to_anchor=(0.65, 0.88))
        figure.text(0.66, 0.55, "\n".join(words), size=9, va="top", linespacing=1.5)
    return figure


def _axes(ax: Any, apex: Array, axis: Array, groove: Array, h: float) -> None:
    """t₁ with a round arrow, t₂ with a straight one, and the angle between them."""
    for direction, colour, ends in ((axis, _TURN, (-0.25, 2.0)), (groove, _SLIDE, (-0.7, 2.05))):
        line = np.array([apex + s * h * direction for s in ends])
        ax.plot(*line.T, color=colour, lw=1.8, ls=(0, (7, 2, 1.5, 2)), zorder=6)
    x = np.cross(axis, groove)
    x /= np.linalg.norm(x)
    angles = np.linspace(0.35, 2.0 * np.pi - 0.55, 60)[:, None]
    centre = apex + 1.62 * h * axis
    ring = centre + 0.2 * h * (np.cos(angles) * x + np.sin(angles) * np.cross(axis, x))
    ax.plot(*ring.T, color=_TURN, lw=2.2, zorder=6)
    arrow(ax, ring[-1], ring[-1] + 1.1 * (ring[-1] - ring[-4]), _TURN, 0.016 * h)
    ax.text(*(apex + 2.1 * h * axis), "$t_1$", color=_TURN, size=15, zorder=8, ha="center")
    start = apex + 1.6 * h * groove
    arrow(ax, start, start + 0.42 * h * groove, _SLIDE, 0.02 * h)
    ax.text(*(apex + 2.2 * h * groove), "$t_2$", color=_SLIDE, size=15, zorder=8, ha="center",
            va="center")  # fmt: skip
    across = axis - (axis @ groove) * groove
    across /= np.linalg.norm(across)
    angle = float(np.arccos(axis @ groove))
    arc = np.linspace(0.0, angle, 30)[:, None]
    bow = apex + 1.28 * h * (np.cos(arc) * groove + np.sin(arc) * across)
    ax.plot(*bow.T, color="#555555", lw=1.3, zorder=6)
    ax.text(*(apex + 1.43 * h * (np.cos(angle / 2) * groove + np.sin(angle / 2) * across)),
            f"{np.rad2deg(angle):.0f}°", color="#333333", size=11, zorder=8, ha="center",
            va="center", bbox=HALO)  # fmt: skip


def _cone(apex: Array, axis: Array, h: float, half_angle: float) -> tuple[Array, Array]:
    """Triangles (k, 3, 3) of the side, and the rim (k, 3) of the base."""
    x = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    x /= np.linalg.norm(x)
    angles = np.linspace(0.0, 2.0 * np.pi, 121)[:, None]
    rim = np.cos(angles) * x + np.sin(angles) * np.cross(axis, x)
    rim = apex + h * axis + h * np.tan(half_angle) * rim
    return np.array([[apex, a, b] for a, b in pairwise(rim)]), rim


def _silhouette(ax: Any, apex: Array, axis: Array, h: float, half_angle: float) -> list[Array]:
    """Ends (3,) on the rim of the two generators that the eye sees as the cone's outline."""
    e, a = np.deg2rad([ax.elev, ax.azim])
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    x = eye - (eye @ axis) * axis
    across = np.linalg.norm(x)
    cosine = np.tan(half_angle) * (eye @ axis) / across
    if abs(cosine) >= 1.0:
        return []
    x, y = x / across, np.cross(axis, x / across)
    sine = np.sqrt(1.0 - cosine**2)
    rim = apex + h * axis
    return [rim + h * np.tan(half_angle) * (cosine * x + s * sine * y) for s in (-1.0, 1.0)]
