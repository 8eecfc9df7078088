"""Smooth surfaces: sphere, cylinder, quadric, and what is fitted to the points of a mesh."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import factorial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from warnings import catch_warnings

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.law.contact import is_near, nearest
from osc_contact.law.jit import as_python
from osc_contact.spatial import Array, as_array

_UPWARD = 0.5  #: least z of a triangle's unit normal that belongs to a fitted surface
_near = as_python(is_near)


def _whole(x: Any) -> Any:
    return int(x) if np.ndim(x) == 0 else x.astype(int)


#: Functions of numbers in the law that take arrays of numbers, too.
OF_ARRAYS: dict[str, Any] = {
    "sqrt": np.sqrt,
    "copysign": np.copysign,
    "floor": np.floor,
    "min": np.minimum,
    "max": np.maximum,
    "int": _whole,
    "is_near": lambda step: np.all(_near(step)),
}
_nearest: Any = as_python(nearest, **OF_ARRAYS)
_nearest_to_one: Any = as_python(nearest)


class Shapes(list[Any]):
    """SHAPE rows as the law reads them; of many numbers at once the rows stand side by side."""

    def __init__(self, rows: tuple[Array, ...]) -> None:
        super().__init__(SimpleNamespace(row=one.tolist()) for one in rows)
        self._table = np.array(rows).T

    def __getitem__(self, number: Any) -> Any:
        if not isinstance(number, np.ndarray):
            return super().__getitem__(number)
        return SimpleNamespace(row=self._table[:, number])


@dataclass(frozen=True, eq=False)
class Surface:
    """½(q₁x² + q₂y² + q₃z²) + b z + c = h(x, y), in its own axes; outward is where the left grows.

    h is a bicubic spline, or zero. Outside its rectangle the outermost polynomials continue.

    Attributes:
        bend: (3,) q (1/m). slope: b. level: c (m).
        cells: (nx, ny, 4, 4) factors of uᵖvᵠ in each cell (m), u, v = 0 … 1 along x and y; None: no
            h. corner, pitch: (2,) where the cells begin, and their sides (m).
        rms, worst: of the heights of the points it is fitted to above it (m).

    Example:
        >>> x, y = np.meshgrid(np.linspace(-0.1, 0.1, 12), np.linspace(-0.1, 0.1, 12))
        >>> measured = np.column_stack([x.ravel(), y.ravel(), 0.5 * x.ravel() ** 2])
        >>> surface = osc.Surface.fitted(measured, cells=(4, 4))  # as of a scanner
        >>> print(surface.worst < 1e-6)  # m
        True
    """

    bend: Array
    slope: float = 0.0
    level: float = 0.0
    cells: Array | None = None
    corner: Array | tuple[float, float] = (0.0, 0.0)
    pitch: Array | tuple[float, float] = (1.0, 1.0)
    rms: float = 0.0
    worst: float = 0.0

    @classmethod
    def sphere(cls, radius: float) -> Surface:
        """About the origin; a radius < 0: seen from inside, a bowl."""
        return cls(np.full(3, 1.0 / _radius(radius)), level=-0.5 * radius)

    @classmethod
    def cylinder(cls, radius: float) -> Surface:
        """About the z axis; a radius < 0: seen from inside, a pipe."""
        return cls(np.array([1.0, 1.0, 0.0]) / _radius(radius), level=-0.5 * radius)

    @classmethod
    def saddle(cls, along_x: float, along_y: float) -> Surface:
        """z = x²/(2R₁) + y²/(2R₂): a saddle where R₁ and R₂ have different signs.

        Args:
            along_x, along_y: R₁, R₂, radii of curvature at the origin (m); > 0: hollow.
        """
        bend = -1.0 / np.array([_radius(along_x), _radius(along_y), np.inf])
        return cls(bend, slope=1.0)

    @classmethod
    def fitted(cls, points: npt.ArrayLike, cells: tuple[int, int] = (8, 8)) -> Surface:
        """z = h(x, y), the bicubic spline of least squares through scattered points.

        Args:
            points: (k, 3) of the surface, which is not to stand steeply on the x-y plane (m).
            cells: into how many cells their rectangle is divided along x and y.

        Raises:
            InvalidInputError: too few points, or not spread over all cells.
        """
        from scipy.interpolate import LSQBivariateSpline

        cloud = as_array("points", points, (None, 3)).T
        low = cloud[:2].min(axis=1)
        high = cloud[:2].max(axis=1)
        edges = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, cells, strict=True)]
        box = [low[0], high[0], low[1], high[1]]
        try:
            with catch_warnings(action="error"):
                spline = LSQBivariateSpline(*cloud, *(one[1:-1] for one in edges), bbox=box)
        except (UserWarning, ValueError) as error:
            raise InvalidInputError(
                f"{cloud.shape[1]} points do not determine a spline of {cells[0]} × {cells[1]} "
                "cells; give points that lie closer, or fewer cells"
            ) from error
        pitch = (high - low) / cells
        ways = [_taylor(*one) for one in zip(spline.get_knots(), edges, pitch, strict=True)]
        factors = spline.get_coeffs().reshape([way.shape[2] for way in ways])
        off = cloud[2] - spline.ev(*cloud[:2])
        return cls(
            np.zeros(3),
            1.0,
            cells=np.einsum("pia,qjb,ab->ijpq", *ways, factors),
            corner=low,
            pitch=pitch,
            rms=float(np.sqrt(np.mean(off**2))),
            worst=float(np.abs(off).max()),
        )

    @classmethod
    def of_mesh(cls, file: Path | str, cells: tuple[int, int] = (8, 8)) -> Surface:
        """`fitted` to the corners of the triangles of a mesh that face along its z axis.

        Args:
            file: STL, OBJ and what else coal reads (m). cells: see `fitted`.

        Raises:
            ModelError: no such mesh. InvalidInputError: see `fitted`.
        """
        import coal

        try:
            mesh = coal.MeshLoader().load(str(file), np.ones(3))
        except (RuntimeError, ValueError) as error:
            raise ModelError(f"{file}: no mesh is read: {error}") from error
        corners = np.array(mesh.vertices())
        triangles = triangles_of(mesh.tri_indices, mesh.num_tris)
        a, b, c = corners[triangles].swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        up = normals[:, 2] > _UPWARD * np.linalg.norm(normals, axis=1)
        return cls.fitted(np.unique(corners[np.unique(triangles[up])], axis=0), cells)

    def rows(self, ball: Array, radius: float, X_ES: pin.SE3) -> tuple[Array, ...]:
        """SHAPE rows of a ball on it, see `law.contact`.

        Args:
            ball: (3,) its centre in A. radius: its own (m). X_ES: pose of the surface in E.
        """
        cells = np.zeros((0, 16)) if self.cells is None else self.cells.reshape(-1, 16)
        shapes = np.vstack((np.zeros((2, 16)), cells))
        shapes[0, :9] = (*ball, radius, *self.bend, self.slope, self.level)
        shapes[1, :12] = (*X_ES.rotation.ravel(), *X_ES.translation)
        if self.cells is not None:
            shapes[0, 9:15] = (*self.corner, *1.0 / np.array(self.pitch), *self.cells.shape[:2])
        return tuple(shapes)


def distance_and_normal(shapes: Shapes, p: Array) -> tuple[Array, Array]:
    """Signed distances (m) of points (3,) or (3, k) of S, and outward normals at their feet.

    Args:
        shapes: of `Surface.rows`. p: in the axes of the surface.
    """
    found = None
    if p.size == 3:  # in numbers of Python it takes a quarter of the time
        with suppress(ZeroDivisionError):  # no foot: NaN
            found = _nearest_to_one(shapes, 0, tuple(p.ravel().tolist()))
    along, gradient, _, _ = found or _nearest(shapes, 0, tuple(p))
    g = np.array([one + 0.0 * along for one in gradient]).reshape(p.shape)
    size = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    return (np.reshape(along, p.shape[1:]) * size, g / size)


def triangles_of(read: Callable[[int], Any], count: int) -> Array:
    """(count, 3) numbers of the corners of the triangles that coal gives one by one.

    Args:
        read: gives the three of a triangle by its number. count: how many triangles there are.
    """
    return np.array([[triangle[k] for k in range(3)] for triangle in map(read, range(count))])


def _taylor(knots: Array, edges: Array, side: float) -> Array:
    """(4, n, m) of the m splines of one way the factors of u⁰ … u³ in each of n cells."""
    from scipy.interpolate import BSpline

    splines = BSpline(knots, np.eye(len(knots) - 4), 3)
    return np.array([splines(edges[:-1], nu=p) * side**p / factorial(p) for p in range(4)])


def _radius(radius: float) -> float:
    if not (np.isfinite(radius) and radius != 0.0):
        raise InvalidInputError(f"radius = {radius}; give a length other than 0 m")
    return radius
