"""Contact states as pictures, drawn from geometry in metres, world axes.

Fig. 1: body, faces, contact normals as lines of force. Fig. 2: a cone in a V groove, its two twist
axes, the lines of force on the walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from osc_contact.visual import OKABE_ITO, contact_colour
from osc_contact.visual.plots import style
from osc_contact.visual.screws import CommonPerpendicular, common_perpendicular

Array = NDArray[np.float64]
HALO = {"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8}
FACE: dict[str, Any] = {"facecolor": "#9CC5C1", "edgecolor": "#3C6E6A", "alpha": 0.45, "zorder": 2}


def draw_contact_state(
    points: Array, directions: Array, rod: Array, faces: Sequence[Array], title: str
) -> Figure:
    """Draw rod and faces, each contact normal as a long line of force, and the lines' positions.

    For every pair of lines of force the common perpendicular is drawn; the legend gives its
    length and the angle between the lines. Lines that do not meet and are not parallel are what
    no constraint frame describes.

    Args:
        points: (k, 3) contact points, m.
        directions: (k, 3) directions of the contact forces, unit, into the faces.
        rod: (2, 3) ends of the body, m.
        faces: (4, 3) arrays, the faces' corners in order, m.
        title: heading.
    """
    lines = list(zip(points, directions, strict=True))
    pairs = {
        (i, j): common_perpendicular(*lines[i], *lines[j])
        for i, j in combinations(range(len(lines)), 2)
    }
    feet = [foot for pair in pairs.values() for foot in (pair.first, pair.second)]
    cloud = np.vstack((rod, points, *faces, *feet))
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    reach = 0.62 * float(np.ptp(cloud, axis=0).max())
    with style():
        room = (0.0, 0.02, 0.94, 0.86)
        figure, ax = orthographic((7.2, 5.8), room, middle, reach, zoom=1.0)
        ax.view_init(*_widest_view(directions))
        _scales(ax, middle, reach)
        for face in faces:
            fill(ax, face[None], **FACE)
        ax.plot(*rod.T, color="#4A4F57", lw=5.0, solid_capstyle="round", zorder=4, label="body")
        for i, (point, direction) in enumerate(lines):
            colour = contact_colour(i)
            name = rf"$f_{{c{i + 1}}}$"
            ax.plot(
                *_inside(point, direction, middle, reach),
                color=colour,
                lw=1.4,
                zorder=5,
                label=f"line of force of {name}",
            )
            tail = point - 0.3 * reach * direction
            arrow(ax, tail, point, colour, 0.02 * reach)
            ax.text(
                *(tail - 0.07 * reach * direction),
                name,
                color=colour,
                size=13,
                zorder=7,
                ha="center",
                va="center",
                bbox=HALO,
            )
        for (i, j), pair in pairs.items():
            ax.plot(
                *np.array([pair.first, pair.second]).T,
                color="black",
                lw=1.6,
                ls=(0, (2, 1)),
                marker="o",
                ms=4.0,
                zorder=6,
                label=_relation(i, j, pair),
            )
        figure.suptitle(title, x=0.03, y=0.97, ha="left", size=12, weight="bold")
        ax.legend(
            loc="upper right", bbox_to_anchor=(0.995, 0.94), bbox_transform=figure.transFigure
        )
    return figure


def orthographic(
    size: tuple[float, float],
    room: tuple[float, float, float, float],
    middle: Array,
    reach: float,
    zoom: float,
) -> tuple[Figure, Any]:
    """A figure (inches) with a cube of equal scales, `reach` (m) around its `middle` (3,).

    Args:
        size: of the figure (inches).
        room: the axes' left, bottom, width and height, as shares of the figure.
        middle: (3,) of the cube (m).
        reach: half its edge (m).
        zoom: of the projection.
    """
    figure = Figure(figsize=size)
    figure.set_layout_engine("none")
    ax: Any = figure.add_axes(room, projection="3d", proj_type="ortho")
    ax.computed_zorder = False
    low = (middle - reach).tolist()
    high = (middle + reach).tolist()
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=zoom)
    return figure, ax


def fill(ax: Any, polygons: Array, **look: Any) -> None:
    """Fill polygons (k, corners, 3).

    They have equally many corners: matplotlib pads others with uninitialised memory.
    """
    ax.add_collection3d(Poly3DCollection(polygons, **look))


def arrow(ax: Any, tail: Array, tip: Array, colour: str, radius: float) -> None:
    """Thick shaft and a cone whose apex is the tip.

    Args:
        ax: axes of `orthographic`.
        tail, tip: (3,) its ends (m).
        colour: of shaft and cone.
        radius: of the shaft (m).
    """
    axis = (tip - tail) / np.linalg.norm(tip - tail)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    rim = tip - 4.0 * radius * axis
    angles = np.linspace(0.0, 2.0 * np.pi, 25)[:, None]
    ring = rim + 1.3 * radius * (np.cos(angles) * side + np.sin(angles) * np.cross(axis, side))
    cone = np.array([[a, b, end] for end in (tip, rim) for a, b in pairwise(ring)])
    ax.plot(*np.array([tail, rim]).T, color=colour, lw=3.2, solid_capstyle="butt", zorder=6)
    fill(ax, cone, facecolor=colour, edgecolor="none", zorder=6)


def _relation(i: int, j: int, pair: CommonPerpendicular) -> str:
    angle = f"{np.rad2deg(pair.angle):.1f}°"
    names = rf"$f_{{c{i + 1}}}$, $f_{{c{j + 1}}}$"
    if pair.angle < 1e-6:
        return f"{names}: parallel, {1e3 * pair.distance:.1f} mm apart"
    if pair.distance < 1e-6:
        return f"{names}: intersect, angle {angle}"
    return f"{names}: skew, {1e3 * pair.distance:.1f} mm apart, angle {angle}"


def _scales(ax: Any, middle: Array, reach: float) -> None:

    for axis, name, centre in zip((ax.xaxis, ax.yaxis, ax.zaxis), "xyz", middle, strict=True):
        axis.set_label_text(f"{name} (m)")
        axis.pane.set_visible(False)
        ticks = MaxNLocator(4).tick_values(centre - reach, centre + reach)
        axis.set_ticks(ticks[np.abs(ticks - centre) < 0.88 * reach])


def _widest_view(directions: Array) -> tuple[int, int]:
    """Elevation and azimuth (deg) from where the lines are spread widest."""
    across = [np.cross(d, e) for d, e in combinations(directions, 2)] or [np.zeros(3)]

    def spread(view: tuple[int, int]) -> float:
        elevation, azimuth = np.deg2rad(view)
        eye = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)]) * np.cos(elevation)
        plain = np.linalg.norm(np.cross(directions, eye), axis=1).min(initial=1.0)
        return float(plain + 0.5 * np.linalg.norm(np.cross(across, eye), axis=1).min())

    return max(product((18, 24, 30), range(-150, -29, 10)), key=spread)


def _inside(point: Array, direction: Array, middle: Array, reach: float) -> Array:
    """The part of a line inside the cube drawn, as (3, 2)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        hits = np.array([(middle + side * reach - point) / direction for side in (-1.0, 1.0)])
    ends = np.nanmax(hits.min(axis=0)), np.nanmin(hits.max(axis=0))
    return np.array([point + s * direction for s in ends]).T


# --- Fig. 2: a cone in a groove -----------------------------------------------------------------

_TURN = OKABE_ITO["black"]
_SLIDE = "#5B3A8E"


def draw_cone_in_groove(
    *,
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
    h = height
    up = np.array([0.0, 0.0, 1.0])
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
            colour = contact_colour(i)
            name = rf"$f_{{c{i + 1}}}$"
            if i % 2 == 0:
                ax.plot(
                    *np.array([apex, points[:, i + 1]]).T,
                    color="#22262B",
                    lw=3.0,
                    zorder=4,
                    label="lines of contact" if i == 0 else None,
                )
            ax.plot(
                *np.array([p - 0.48 * h * d, p + 0.26 * h * d]).T,
                color=colour,
                lw=1.2,
                zorder=5,
                label=f"line of force of {name}",
            )
            arrow(ax, p - 0.36 * h * d, p, colour, 0.018 * h)
            ax.text(
                *(p + 0.34 * h * d),
                name,
                color=colour,
                size=13,
                zorder=8,
                ha="center",
                va="center",
                bbox=HALO,
            )
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
    ax.text(
        *(apex + 2.2 * h * groove),
        "$t_2$",
        color=_SLIDE,
        size=15,
        zorder=8,
        ha="center",
        va="center",
    )
    across = axis - (axis @ groove) * groove
    across /= np.linalg.norm(across)
    angle = float(np.arccos(axis @ groove))
    arc = np.linspace(0.0, angle, 30)[:, None]
    bow = apex + 1.28 * h * (np.cos(arc) * groove + np.sin(arc) * across)
    ax.plot(*bow.T, color="#555555", lw=1.3, zorder=6)
    ax.text(
        *(apex + 1.43 * h * (np.cos(angle / 2) * groove + np.sin(angle / 2) * across)),
        f"{np.rad2deg(angle):.0f}°",
        color="#333333",
        size=11,
        zorder=8,
        ha="center",
        va="center",
        bbox=HALO,
    )


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
