"""Trails: where the object's origin and the contact points have been."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from osc_contact.visual import contact_colour
from osc_contact.visual.parts import LegendEntry, Sample
from osc_contact.visual.primitives import plain, tube

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["TRAIL_COLOUR", "Trails"]

Array = NDArray[np.float64]
TRAIL_COLOUR = "#5A6270"
LONGEST = 240
STEP = 5e-4
RADIUS = 0.004


class Trails:
    """Grows sample by sample; a path longer than 240 points is thinned to every other one."""

    def __init__(self, contacts: Sequence[str]) -> None:
        self.contacts = contacts
        self.names = {"object": TRAIL_COLOUR} | {
            name: contact_colour(i) for i, name in enumerate(contacts)
        }
        self.points: dict[str, list[Array]] = {name: [] for name in self.names}
        self.drawn: dict[str, int] = {}

    def extend(self, sample: Sample) -> None:
        """Take one tick in; a step of less than 0.5 mm is left out."""
        if "pose" in sample:
            self._add("object", np.asarray(sample["pose"], dtype=float)[:3])
        if "contact_point" in sample:
            points = np.asarray(sample["contact_point"], dtype=float).reshape(-1, 3)
            for name, point in zip(self.contacts, points, strict=False):
                self._add(name, point)

    def _add(self, name: str, point: Array) -> None:
        path = self.points[name]
        if not np.isfinite(point).all():
            return
        if path and float(np.linalg.norm(point - path[-1])) < STEP:
            return
        path.append(point.copy())
        if len(path) > LONGEST:
            path[:-1] = path[:-1:2]

    def draw(self, scene: Visualizer) -> None:
        """(Re)draw what has grown since the last call."""
        for name, colour in self.names.items():
            path = self.points[name]
            if len(path) > 1 and self.drawn.get(name) != len(path):
                paint = plain(colour, 0.9)
                scene[f"trails/{name}"].set_object(tube(path, RADIUS, sides=5), paint)
                self.drawn[name] = len(path)

    def legend(self) -> list[LegendEntry]:
        """One entry."""
        paths = tuple(f"trails/{name}" for name in self.names)
        return [LegendEntry(TRAIL_COLOUR, "trails of object and contacts", "trail", paths)]
