"""The contact state as a picture (figs. 1, 2): body, faces, contact normals as lines of force."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise, product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.visual import OKABE_ITO, contact_colour
from osc_contact.visual.style import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "HALO", "CommonPerpendicular", "arrow", "common_perpendicular", "draw_contact_state"
]  # fmt: skip

Array = NDArray[np.float64]


class CommonPerpendicular(NamedTuple):
    """Shortest connection of two lines: foot points (3,), distance (m), angle (rad, 0..π/2)."""

    first: Array
    second: Array
    distance: float
    angle: float


def common_perpendicular(
    p: ArrayLike, d: ArrayLike, q: ArrayLike, e: ArrayLike
) -> CommonPerpendicular:
    """Shortest connection of the lines p + s d and q + t e (parallel lines: the one through q)."""
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    d, e = _unit(d), _unit(e)
    cosine, sine = float(d @ e), float(np.linalg.norm(np.cross(d, e)))
    t = 0.0 if sine < 1e-9 else float(((d @ (q - p)) * cosine - e @ (q - p)) / sine**2)
    second = q + t * e
    first = p + (d @ (second - p)) * d
    distance = float(np.linalg.norm(second - first))
    return CommonPerpendicular(first, second, distance, float(np.arctan2(sine, abs(cosine))))


def draw_contact_state(
    points: ArrayLike,
    directions: ArrayLike,
    object_segments: Sequence[ArrayLike],
    faces: Sequence[ArrayLike],
    title: str,
    axes: Sequence[tuple[ArrayLike, ArrayLike, str]] = (),
) -> Figure:
    """Draw body and faces, each contact normal as a long line of force, and how the lines lie.

    For every pair of lines of force the common perpendicular is drawn; the legend gives its
    length and the angle between the lines. Lines that do not meet and are not parallel are what
    no constraint frame describes (fig. 1).

    Args:
        points: (k,3) contact points, m.
        directions: (k,3) directions of the contact forces, into the faces.
        object_segments: (2,3) arrays, the body's straight parts, m.
        faces: (4,3) arrays, the faces' corners in order, m.
        title: heading.
        axes: twist axes (point, direction, label), drawn as dashed lines (fig. 2).

    Raises:
        InvalidInputError: shapes do not fit, a number is not finite, a direction is zero.
    """
    contacts = _rows(points, "points"), _rows(directions, "directions")
    if contacts[0].shape != contacts[1].shape:
        raise InvalidInputError(
            f"{len(contacts[0])} points but {len(contacts[1])} directions: give one for each"
        )
    segments = [_rows(segment, "object_segments") for segment in object_segments]
    plates = [_rows(face, "faces") for face in faces]
    twists = [(_rows(p, "axes")[0], _unit(d), label) for p, d, label in axes]
    lines = [(p, _unit(d)) for p, d in zip(*contacts, strict=True)]
    seen = [*segments, *plates, contacts[0], *(point[None] for point, _, _ in twists)]
    if not sum(len(part) for part in seen):
        raise InvalidInputError("nothing to draw: give points, segments, faces or axes")
    pairs = {
        (i, j): common_perpendicular(*lines[i], *lines[j])
        for i, j in combinations(range(len(lines)), 2)
    }
    seen += [np.array([pair.first, pair.second]) for pair in pairs.values()]
    cloud = np.vstack(seen)
    middle, reach = _ball(cloud)
    with style():
        figure, ax = _axes3d(middle, reach, [d for _, d in lines] + [d for _, d, _ in twists])
        for plate in plates:
            _fill(ax, plate)
        for k, segment in enumerate(segments):
            ax.plot(*segment.T, color="#4A4F57", lw=5.0, solid_capstyle="round", zorder=4,
                    label="body" if k == 0 else None)  # fmt: skip
        for i, (point, direction) in enumerate(lines):
            colour, name = contact_colour(i), rf"$f_{{c{i + 1}}}$"
            ax.plot(*_inside(point, direction, middle, reach), color=colour, lw=1.4, zorder=5,
                    label=f"line of force of {name}")  # fmt: skip
            tail = point - 0.3 * reach * direction
            arrow(ax, tail, point, colour, 0.02 * reach)
            ax.text(*(tail - 0.07 * reach * direction), name, color=colour, size=13, zorder=7,
                    ha="center", va="center", bbox=HALO)  # fmt: skip
        for (i, j), pair in pairs.items():
            ax.plot(*np.array([pair.first, pair.second]).T, color="black", lw=1.6, ls=(0, (2, 1)),
                    marker="o", ms=4.0, zorder=6, label=_relation(i, j, pair))  # fmt: skip
        for k, (point, direction, label) in enumerate(twists):
            colour, dash = _TWISTS[k % len(_TWISTS)]
            ax.plot(*_inside(point, direction, middle, reach), color=colour, lw=2.0, ls=dash,
                    zorder=5, label=label)  # fmt: skip
        for (_, d, first), (_, e, second) in combinations(twists, 2):
            angle = common_perpendicular(middle, d, middle, e).angle
            names = " and ".join(label.partition(":")[0] for label in (first, second))
            ax.plot([], [], " ", label=f"angle between {names}: {np.rad2deg(angle):.1f}°")
        figure.suptitle(title, x=0.03, y=0.97, ha="left", size=12, weight="bold")
        ax.legend(loc="upper left", bbox_to_anchor=(0.98, 0.92))
    return figure


_TWISTS = (
    (OKABE_ITO["purple"], (0, (6, 3))),
    (OKABE_ITO["green"], (0, (6, 2, 1, 2))),
    (OKABE_ITO["orange"], (0, (2, 1.5))),
)
HALO = {"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8}


def _relation(i: int, j: int, pair: CommonPerpendicular) -> str:
    angle = f"{np.rad2deg(pair.angle):.1f}°"
    names = rf"$f_{{c{i + 1}}}$, $f_{{c{j + 1}}}$"
    if pair.angle < 1e-6:
        return f"{names}: parallel, {1e3 * pair.distance:.1f} mm apart"
    if pair.distance < 1e-6:
        return f"{names}: intersect, angle {angle}"
    return f"{names}: skew, {1e3 * pair.distance:.1f} mm apart, angle {angle}"


def _axes3d(middle: Array, reach: float, directions: Sequence[Array]) -> tuple[Figure, Any]:
    """Orthographic cube of equal scales, seen from where the lines are spread widest."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(9.0, 6.0))
    figure.set_layout_engine("none")
    FigureCanvasAgg(figure)
    ax: Any = figure.add_axes((-0.03, 0.0, 0.72, 0.96), projection="3d", proj_type="ortho")
    ax.computed_zorder = False
    for name, centre in zip("xyz", middle, strict=True):
        getattr(ax, f"set_{name}lim")(centre - reach, centre + reach)
        getattr(ax, f"set_{name}label")(f"{name} (m)")
        axis = getattr(ax, f"{name}axis")
        axis.pane.set_visible(False)
        ticks = MaxNLocator(4).tick_values(centre - reach, centre + reach)
        axis.set_ticks(ticks[np.abs(ticks - centre) < 0.88 * reach])
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=0.93)
    across = [np.cross(d, e) for d, e in combinations(directions, 2)] or [np.zeros(3)]

    def spread(view: tuple[int, int]) -> float:
        elevation, azimuth = np.deg2rad(view)
        eye = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)]) * np.cos(elevation)
        plain = min([float(np.linalg.norm(np.cross(d, eye))) for d in directions], default=1.0)
        return plain + 0.5 * min(float(np.linalg.norm(np.cross(c, eye))) for c in across)

    elevation, azimuth = max(product((18, 24, 30), range(-150, -29, 10)), key=spread)
    ax.view_init(elev=elevation, azim=azimuth)
    return figure, ax


def _fill(ax: Any, plate: Array) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    ax.add_collection3d(
        Poly3DCollection([plate], facecolor="#9CC5C1", edgecolor="#3C6E6A", alpha=0.45, zorder=2)
    )


def arrow(ax: Any, tail: Array, tip: Array, colour: str, radius: float) -> None:
    """Thick shaft and a cone whose apex is the tip."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axis = _unit(tip - tail)
    side = _unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
    rim = tip - 4.0 * radius * axis
    angles = np.linspace(0.0, 2.0 * np.pi, 25)[:, None]
    ring = rim + 1.3 * radius * (np.cos(angles) * side + np.sin(angles) * np.cross(axis, side))
    # triangles only: matplotlib pads unequal polygons with uninitialised memory and projects it
    cone = np.array([[a, b, end] for end in (tip, rim) for a, b in pairwise(ring)])
    ax.plot(*np.array([tail, rim]).T, color=colour, lw=3.2, solid_capstyle="butt", zorder=6)
    ax.add_collection3d(Poly3DCollection(cone, facecolor=colour, edgecolor="none", zorder=6))


def _ball(cloud: Array) -> tuple[Array, float]:
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    return middle, max(0.62 * float(np.ptp(cloud, axis=0).max()), 1e-3)


def _inside(point: Array, direction: Array, middle: Array, reach: float) -> Array:
    """The part of a line inside the cube drawn, as (3,2)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        hits = np.array([(middle + side * reach - point) / direction for side in (-1.0, 1.0)])
    ends = np.nanmax(hits.min(axis=0)), np.nanmin(hits.max(axis=0))
    return np.array([point + s * direction for s in ends]).T


def _unit(direction: ArrayLike) -> Array:
    vector = np.asarray(direction, dtype=float)
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise InvalidInputError(f"direction {vector.tolist()} must be 3 finite numbers, not zero")
    return np.asarray(vector / length)


def _rows(values: ArrayLike, name: str) -> Array:
    rows = np.asarray(values, dtype=float)
    rows = np.atleast_2d(rows) if rows.size else rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        raise InvalidInputError(f"{name} must be finite rows of 3 numbers, got shape {rows.shape}")
    return rows
