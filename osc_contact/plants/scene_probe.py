"""Distances in a MuJoCo scene: of points, and of the tool, from what the tool can touch."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

import numpy as np

from osc_contact.spatial import Array

__all__ = ["SceneProbe"]

FAR_M = 10.0  #: m; distances are looked for up to here
_POINT_M = 1e-6  #: m, radius of the sphere that stands for a point
_SPHERE = 2  #: MuJoCo's number of the type


class SceneProbe:
    """A copy of a scene, as it is at one instant, in which one geom of the tool becomes a point."""

    def __init__(self, model: Any, data: Any, tool: Iterable[int], others: Iterable[int]) -> None:
        """Take the copy.

        Args:
            model, data: MuJoCo's. tool: its geoms. others: geoms that are not the arm's.
        """
        import mujoco

        self._mj, self._model, self._data = mujoco, model, copy.copy(data)
        pairs = [(a, b) for a in tool for b in others if _meet(model, a, b)]
        self.pairs = pairs
        self._others = sorted({b for _, b in pairs})
        if pairs:
            self._point = pairs[0][0]
            self._probe, self._at = copy.copy(model), copy.copy(data)
            self._probe.geom_type[self._point] = _SPHERE
            self._probe.geom_size[self._point] = _POINT_M
            self._probe.geom_rbound[self._point] = _POINT_M

    def distance(self, point: Array) -> tuple[float, str]:
        """Of a point of the world (3,) from the nearest geom (m), and that one's name.

        It is negative within the geom; inf where there is none within 10 m.
        """
        self._at.geom_xpos[self._point] = point
        return self._nearest(self._probe, self._at, [(self._point, b) for b in self._others])

    def clearance(self) -> tuple[float, str]:
        """The same of the tool; negative where it penetrates."""
        return self._nearest(self._model, self._data, self.pairs)

    def _nearest(self, model: Any, data: Any, pairs: list[tuple[int, int]]) -> tuple[float, str]:
        ends = np.zeros(6)
        found = [
            (float(self._mj.mj_geomDistance(model, data, a, b, FAR_M, ends)), b) for a, b in pairs
        ]
        least, geom = min(found)
        return (least if least < FAR_M else np.inf), model.geom(geom).name or f"geom {geom}"


def _meet(model: Any, a: int, b: int) -> bool:
    """Whether MuJoCo lets two geoms touch."""
    return bool(
        (model.geom_contype[a] & model.geom_conaffinity[b])
        | (model.geom_contype[b] & model.geom_conaffinity[a])
    )
