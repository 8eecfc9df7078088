"""Contact states as pictures, drawn from geometry in metres, world axes.

`draw_contact_state` is fig. 1: body, faces, contact normals as lines of force. The other functions
are what it shares with fig. 2, which `paper.cone_in_groove` draws.
"""

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from osc_contact.spatial import Array
from osc_contact.visual import contact_colour
from osc_contact.visual.plots import style
from osc_contact.visual.screws import CommonPerpendicular, common_perpendicular

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
    lines = list(enumerate(zip(points, directions, strict=True)))
    pairs = {
        (i, j): common_perpendicular(*one, *other)
        for (i, one), (j, other) in combinations(lines, 2)
    }
    cloud = np.vstack((rod, points, *faces, *(pair[:2] for pair in pairs.values())))
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    reach = 0.62 * float(np.ptp(cloud, axis=0).max())
    with style():
        figure, ax = orthographic((7.2, 5.8), (0.0, 0.02, 0.94, 0.86), middle, reach, zoom=1.0)
        ax.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
        ax.locator_params(nbins=5)
        for face in faces:
            fill(ax, face[None], **FACE)
        draw_line(ax, rod, color="#4A4F57", lw=5.0, solid_capstyle="round", zorder=4, label="body")
        for i, (point, direction) in lines:
            line = point + reach * np.outer((-1.6, 0.7), direction)
            tail = point - 0.3 * reach * direction
            draw_force(
                ax, i, line, 1.4, (tail, point), 0.02 * reach, tail - 0.07 * reach * direction
            )
        for (i, j), pair in pairs.items():
            look = {"ls": (0, (2, 1)), "marker": "o", "ms": 4.0, "label": _relation(i, j, pair)}
            draw_line(ax, pair[:2], color="black", lw=1.6, zorder=6, **look)
        figure.suptitle(title, x=0.03, y=0.97, ha="left", size=12, weight="bold")
        place = {"bbox_to_anchor": (0.995, 0.94), "bbox_transform": figure.transFigure}
        ax.legend(loc="upper right", **place)
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
    xlim, ylim, zlim = np.transpose([middle - reach, middle + reach]).tolist()
    ax.set(xlim=xlim, ylim=ylim, zlim=zlim)
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=zoom)
    return figure, ax


def draw_line(ax: Any, points: Any, **look: Any) -> None:
    """A line through points (k, 3)."""
    ax.plot(*np.transpose(points), **look)


def fill(ax: Any, polygons: Array, **look: Any) -> None:
    """Fill polygons (k, corners, 3).

    They have equally many corners: matplotlib pads others with uninitialised memory.
    """
    ax.add_collection3d(Poly3DCollection(polygons, **look))


def write(ax: Any, place: Array, text: str, colour: str, size: float, **look: Any) -> None:
    """A text whose middle is at a place (3,)."""
    centred = {"zorder": 8, "ha": "center", "va": "center"}
    ax.text(*place, text, color=colour, size=size, **centred | look)


def circle(x: Array, y: Array, angles: Array) -> Array:
    """(k, 3) points at angles (k,) of the circle with the radii x and y (3,) at 0 and π/2."""
    return np.outer(np.cos(angles), x) + np.outer(np.sin(angles), y)


def across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors (3,) square to a unit vector and to one another."""
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)


def draw_arrow(ax: Any, tail: Array, tip: Array, colour: str, radius: float) -> None:
    """Thick shaft and a cone whose apex is the tip.

    Args:
        ax: axes of `orthographic`.
        tail, tip: (3,) its ends (m).
        colour: of shaft and cone.
        radius: of the shaft (m).
    """
    axis = (tip - tail) / np.linalg.norm(tip - tail)
    rim = tip - 4.0 * radius * axis
    ring = rim + 1.3 * radius * circle(*across(axis), np.linspace(0.0, 2.0 * np.pi, 25))
    cone = np.array([[a, b, end] for end in (tip, rim) for a, b in pairwise(ring)])
    draw_line(ax, (tail, rim), color=colour, lw=3.2, solid_capstyle="butt", zorder=6)
    fill(ax, cone, facecolor=colour, edgecolor="none", zorder=6)


def draw_force(
    ax: Any, i: int, line: Any, lw: float, arrow: tuple[Array, Array], radius: float, place: Array
) -> None:
    """The i-th contact force: its line, an arrow on it, its name.

    Args:
        ax: axes of `orthographic`. i: from 0.
        line: (2, 3) ends of the line of force; lw: its width.
        arrow: (2, 3) its tail and tip; radius: of its shaft.
        place: (3,) of the name.
    """
    colour = contact_colour(i)
    name = rf"$f_{{c{i + 1}}}$"
    draw_line(ax, line, color=colour, lw=lw, zorder=5, label=f"line of force of {name}")
    draw_arrow(ax, *arrow, colour, radius)
    write(ax, place, name, colour, 13, bbox=HALO)


def _relation(i: int, j: int, pair: CommonPerpendicular) -> str:
    angle = np.rad2deg(pair.angle)
    apart = f"{1e3 * pair.distance:.1f} mm apart"
    if pair.angle < 1e-6:
        how = f"parallel, {apart}"
    elif pair.distance < 1e-6:
        how = f"intersect, angle {angle:.1f}°"
    else:
        how = f"skew, {apart}, angle {angle:.1f}°"
    return rf"$f_{{c{i + 1}}}$, $f_{{c{j + 1}}}$: {how}"
