"""The stage of a scene: floor, background, and a camera that sees the forces from the side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.visual.page import EMPTY, set_background, set_camera
from osc_contact.visual.primitives import plain, rgb

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["set_stage", "set_view"]

BACKGROUND = ([0.93, 0.945, 0.96], [0.93, 0.945, 0.96])
FLOOR_COLOUR, GRID_COLOUR = "#E3E7EC", "#C9D0D9"
HALF_FLOOR, GRID_STEP, GRID_LINES = 8.0, 0.25, 16
FIELD_OF_VIEW_DEG = 30.0
ELEVATION = np.deg2rad(28.0)
ASPECT = float(EMPTY["aspect"])
"""Width / height that the scene is fitted to; a wider window shows more floor."""
FILLED = 0.9
Array = NDArray[np.float64]


def set_stage(
    scene: Visualizer,
    points: Array,
    bases: Array,
    directions: NDArray[Any] | None,
    middle_points: Array | None = None,
) -> list[dict[str, Any]]:
    """Floor below everything; a camera on the object's side that sees the forces from the side.

    Args:
        scene: where to draw.
        points: (k, 3) what the camera shall see, m.
        bases: (arms, 3) where the arms stand, m.
        directions: (contacts, 3) of the contact forces, or None.
        middle_points: (k, 3) what the nearer cameras shall see, m; default the same.

    Returns:
        The cameras that the page offers, the first of which is set: name, where it looks and from
        where, seen from there (m, world).
    """
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    floor = float(np.min(bases[:, 2], initial=0.0))
    floor = floor if low[2] > floor - 0.05 else float(low[2]) - 0.1
    _floor(scene["floor"], np.array([middle[0], middle[1], floor - 0.0025]))
    away = middle[:2] if not len(bases) else middle[:2] - bases[:, :2].mean(axis=0)
    front = np.arctan2(away[1], away[0]) if np.linalg.norm(away) > 0.02 else -np.pi / 3
    pushes = np.zeros((1, 3))
    if directions is not None and directions.size:
        pushes = np.nan_to_num(np.asarray(directions, dtype=float))
    best = max(
        np.deg2rad([0, 15, -15, 30, -30, 45, -45, 60, -60]),
        key=lambda turn: -round(np.abs(pushes @ _view(front + turn)).max(), 1),
    )
    near = points if middle_points is None or not len(middle_points) else middle_points
    sides = {
        "whole": (points, _view(front + best)),
        "contacts": (near, _view(front + best)),
        "from above": (near, _view(front, np.deg2rad(85.0))),
        "other side": (points, _view(front + best + np.pi)),
    }
    cameras = []
    for name, (seen, view) in sides.items():
        target, distance = _fitted(seen, view)
        cameras.append(
            {"name": name, "target": target.tolist(), "offset": (distance * view).tolist()}
        )
    set_camera(scene, cameras[0]["target"], cameras[0]["offset"], FIELD_OF_VIEW_DEG)
    set_background(scene, *BACKGROUND)
    return cameras


def set_view(
    scene: Visualizer,
    points: Array,
    heading: float,
    elevation: float = ELEVATION,
    aspect: float = ASPECT,
    floor: float = 0.0,
) -> Array:
    """The same stage, seen from a side of one's own.

    Args:
        scene: where to draw. points: (k, 3) what fills the picture, m.
        heading, elevation: from what is looked at to the eye (rad), heading from x about z.
        aspect: width / height of the picture. floor: its height (m).

    Returns:
        (2, 3) what is to the right and up in the picture.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    _floor(scene["floor"], np.array([middle[0], middle[1], floor - 0.0025]))
    view = _view(heading, elevation)
    target, distance = _fitted(points, view, aspect)
    set_camera(scene, target, distance * view, FIELD_OF_VIEW_DEG)
    set_background(scene, *BACKGROUND)
    return _picture_axes(view)


def _floor(node: Visualizer, centre: Array) -> None:
    """A plane with lines every 0.25 m, which give the scale."""
    from meshcat.geometry import Box, LineBasicMaterial, LineSegments, PointsGeometry

    node["plane"].set_object(Box([2 * HALF_FLOOR, 2 * HALF_FLOOR, 0.01]), plain(FLOOR_COLOUR))
    node["plane"].set_transform(pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.007])).homogeneous)
    steps = np.arange(-GRID_LINES, GRID_LINES + 1) * GRID_STEP
    end = steps[-1]
    lines = [[(s, -end, 0.0), (s, end, 0.0), (-end, s, 0.0), (end, s, 0.0)] for s in steps]
    ends = np.array(lines, dtype=np.float32).reshape(-1, 3).T
    node["grid"].set_object(
        LineSegments(PointsGeometry(ends), LineBasicMaterial(color=rgb(GRID_COLOUR)))
    )
    node.set_transform(pin.SE3(np.eye(3), centre).homogeneous)


def _fitted(points: Array, view: Array, aspect: float = ASPECT) -> tuple[Array, float]:
    """Where to look (m) and from how far away, so that the points fill the picture."""
    axes = np.vstack((_picture_axes(view), view))
    half = np.tan(np.deg2rad(0.5 * FIELD_OF_VIEW_DEG)) * np.array([aspect, 1.0]) * FILLED
    target = axes.T @ (0.5 * (points @ axes.T).min(axis=0) + 0.5 * (points @ axes.T).max(axis=0))
    for _ in range(20):  # perspective: centre the picture at the distance that just fits
        seen = (points - target) @ axes.T
        distance = float((np.abs(seen[:, :2]) / half + seen[:, 2:]).max()) + 0.05
        image = seen[:, :2] / (distance - seen[:, 2:])
        shift = 0.5 * (image.min(axis=0) + image.max(axis=0)) * distance
        target = target + axes[:2].T @ shift
    return target, max(distance, 0.3)


def _picture_axes(view: Array) -> Array:
    """(2, 3) right and up of a picture that is looked at against the view."""
    right = np.cross([0.0, 0.0, 1.0], view)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(view, right)])


def _view(heading: float, elevation: float = ELEVATION) -> Array:
    """Unit vector from what is looked at to the eye."""
    return np.array(
        [
            np.cos(elevation) * np.cos(heading),
            np.cos(elevation) * np.sin(heading),
            np.sin(elevation),
        ]
    )
