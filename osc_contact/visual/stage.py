"""The stage of a scene: floor, background, and a camera that sees the forces from the side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.visual.page import set_background, set_camera
from osc_contact.visual.primitives import material

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["set_stage"]

BACKGROUND = ([1.0, 1.0, 1.0], [0.88, 0.91, 0.95])
FLOOR_COLOUR = "#C9CDD2"
FIELD_OF_VIEW_DEG = 35.0
ELEVATION = np.deg2rad(26.0)
Array = NDArray[np.float64]


def set_stage(scene: Visualizer, points: Array, bases: Array, directions: Array | None) -> None:
    """Floor below everything; a camera on the object's side that sees the forces from the side.

    Args:
        scene: where to draw.
        points: (k, 3) what the camera shall see, m.
        bases: (arms, 3) where the arms stand, m.
        directions: (T, contacts, 3) of the contact forces, or None.
    """
    from meshcat.geometry import Box

    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    floor = float(np.min(bases[:, 2], initial=0.0))
    floor = floor if low[2] > floor - 0.05 else float(low[2]) - 0.1
    scene["floor"].set_object(Box([3.0, 3.0, 0.02]), material(FLOOR_COLOUR))
    scene["floor"].set_transform(
        pin.SE3(np.eye(3), np.array([middle[0], middle[1], floor - 0.0125])).homogeneous
    )
    away = middle[:2] if not len(bases) else middle[:2] - bases[:, :2].mean(axis=0)
    front = np.arctan2(away[1], away[0]) if np.linalg.norm(away) > 0.02 else -np.pi / 3
    pushes = np.zeros((1, 3))
    if directions is not None and directions.size:
        pushes = np.nan_to_num(directions[0])
    best = max(
        np.deg2rad([0, 15, -15, 30, -30, 45, -45, 60, -60]),
        key=lambda turn: -round(np.abs(pushes @ _view(front + turn)).max(), 1),
    )
    reach = 0.42 * float(np.linalg.norm(high - low)) + 0.05
    eye = reach / np.sin(np.deg2rad(0.5 * FIELD_OF_VIEW_DEG)) * _view(front + best)
    set_camera(scene, middle, eye, FIELD_OF_VIEW_DEG)
    set_background(scene, *BACKGROUND)


def _view(heading: float) -> Array:
    """Unit vector from what is looked at to the eye."""
    return np.array(
        [
            np.cos(ELEVATION) * np.cos(heading),
            np.cos(ELEVATION) * np.sin(heading),
            np.sin(ELEVATION),
        ]
    )
