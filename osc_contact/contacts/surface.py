"""Smooth surfaces: spheres, cylinders, quadrics, and splines fitted to points or a mesh."""

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
from osc_contact.law.jit import as_python
from osc_contact.law.surfaces import is_near, nearest
from osc_contact.spatial import Array, as_array

_LEAST_NORMAL_Z = 0.5  #: least z of the unit normal of a triangle that is part of a fitted surface
_near = as_python(is_near)


def _integer_part(x: float | Array) -> int | Array:
    """Integer part of a number x or of each number of an array x, in place of `int` in the law."""
    if isinstance(x, np.ndarray) and x.ndim > 0:
        return x.astype(int)
    return int(x)


#: Replacements of functions that the law applies to numbers, by functions of arrays.
OF_ARRAYS: dict[str, Any] = {
    "sqrt": np.sqrt,
    "copysign": np.copysign,
    "floor": np.floor,
    "min": np.minimum,
    "max": np.maximum,
    "int": _integer_part,
    "is_near": lambda step: np.all(_near(step)),
}
_nearest: Any = as_python(nearest, **OF_ARRAYS)
_nearest_to_one: Any = as_python(nearest)


class Shapes(list[Any]):
    """SHAPE rows of a surface for functions of the law that run as Python.

    The item at an index has the row's 16 numbers as `row`; the item at an array of k indices has
    the (16, k) numbers of these rows.
    """

    def __init__(self, rows: tuple[Array, ...]) -> None:
        """Store the rows (16,) of a surface, see `Surface.rows`."""
        super().__init__(SimpleNamespace(row=row.tolist()) for row in rows)
        self._table = np.array(rows).T  #: (16, k) numbers of all rows

    def __getitem__(self, number: Any) -> Any:
        """Row at an index, or rows at an array of indices, as an object with the field `row`."""
        if not isinstance(number, np.ndarray):
            return super().__getitem__(number)
        return SimpleNamespace(row=self._table[:, number])


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface ½(q₁x² + q₂y² + q₃z²) + b z + c = h(x, y) in its own axes.

    The left side minus h increases out of the surface's material. h is a bicubic spline on a
    rectangle of cells, or zero. Outside the rectangle the polynomials of the outermost cells are
    continued.

    Attributes:
        bend: (3,) q (1/m).
        slope: b.
        level: c (m).
        cells: (nx, ny, 4, 4) coefficients of uᵖvᵠ in each cell (m), u, v = 0 … 1 along x and y;
            None: h = 0.
        corner: (2,) corner of the first cell (m).
        pitch: (2,) sides of a cell (m).
        rms, worst: rms and largest height of the fitted points above the surface (m).

    Example:
        >>> x, y = np.meshgrid(np.linspace(-0.1, 0.1, 12), np.linspace(-0.1, 0.1, 12))
        >>> measured = np.column_stack([x.ravel(), y.ravel(), 0.5 * x.ravel() ** 2])
        >>> surface = osc.Surface.fitted(measured, cells=(4, 4))
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
        """Sphere about the origin; a radius < 0 (m) is a bowl, with material outside the sphere."""
        return cls(np.full(3, 1.0 / _checked_radius(radius)), level=-0.5 * radius)

    @classmethod
    def cylinder(cls, radius: float) -> Surface:
        """Cylinder about the z axis; a radius < 0 (m) is a pipe, with material outside of it."""
        return cls(np.array([1.0, 1.0, 0.0]) / _checked_radius(radius), level=-0.5 * radius)

    @classmethod
    def saddle(cls, along_x: float, along_y: float) -> Surface:
        """Paraboloid z = x²/(2R₁) + y²/(2R₂), a saddle if R₁ and R₂ have different signs.

        Args:
            along_x, along_y: radii of curvature R₁, R₂ at the origin (m); > 0: concave.
        """
        bend = -1.0 / np.array([_checked_radius(along_x), _checked_radius(along_y), np.inf])
        return cls(bend, slope=1.0)

    @classmethod
    def fitted(cls, points: npt.ArrayLike, cells: tuple[int, int] = (8, 8)) -> Surface:
        """Surface z = h(x, y), the bicubic spline of least squares through scattered points.

        Args:
            points: (k, 3) points of a surface that is not steep relative to the x-y plane (m).
            cells: number of cells of their rectangle along x and y.

        Raises:
            InvalidInputError: too few points, or cells without points.
        """
        from scipy.interpolate import LSQBivariateSpline

        # grid of cells over the smallest rectangle around the points in the x-y plane
        cloud = as_array("points", points, (None, 3)).T
        low = cloud[:2].min(axis=1)
        high = cloud[:2].max(axis=1)
        edges = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, cells, strict=True)]
        box = [low[0], high[0], low[1], high[1]]

        # scipy warns if points do not determine the spline; the warning is raised as an error
        try:
            with catch_warnings(action="error"):
                inner_knots = [edge[1:-1] for edge in edges]
                spline = LSQBivariateSpline(*cloud, *inner_knots, bbox=box)
        except (UserWarning, ValueError) as error:
            raise InvalidInputError(
                f"{cloud.shape[1]} points do not determine a spline of {cells[0]} × {cells[1]} "
                "cells; give points that lie closer, or fewer cells"
            ) from error

        # polynomial coefficients of each cell, from those of the B-splines along x and along y
        pitch = (high - low) / cells
        knots_x, knots_y = spline.get_knots()
        along_x = _spline_coefficients(knots_x, edges[0], pitch[0])
        along_y = _spline_coefficients(knots_y, edges[1], pitch[1])
        factors = spline.get_coeffs().reshape(along_x.shape[2], along_y.shape[2])
        errors = cloud[2] - spline.ev(*cloud[:2])
        return cls(
            bend=np.zeros(3),
            slope=1.0,
            cells=np.einsum("pia,qjb,ab->ijpq", along_x, along_y, factors),
            corner=low,
            pitch=pitch,
            rms=float(np.sqrt(np.mean(errors**2))),
            worst=float(np.abs(errors).max()),
        )

    @classmethod
    def of_mesh(cls, file: Path | str, cells: tuple[int, int] = (8, 8)) -> Surface:
        """Fit a surface to the corners of the triangles of a mesh that face along its z axis.

        Args:
            file: mesh in a format that coal reads, such as STL and OBJ (m).
            cells: number of cells of the fitted grid along x and along y.

        Raises:
            ModelError: the mesh cannot be read.
            InvalidInputError: the corners do not suffice for the grid.
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
        faces_up = normals[:, 2] > _LEAST_NORMAL_Z * np.linalg.norm(normals, axis=1)
        return cls.fitted(np.unique(corners[np.unique(triangles[faces_up])], axis=0), cells)

    def rows(self, ball: Array, radius: float, X_ES: pin.SE3) -> tuple[Array, ...]:
        """Make the SHAPE rows (16,) that the law reads for a ball of the object on this surface.

        Row 0 has ball, radius, q, b, c and the grid of cells, row 1 the pose of the surface, and
        the further rows the coefficients of a cell each.

        Args:
            ball: (3,) centre of the ball in the object's frame O (m).
            radius: radius of the ball (m).
            X_ES: pose of the surface's axes S in the touched body's frame E.
        """
        cells = np.zeros((0, 16)) if self.cells is None else self.cells.reshape(-1, 16)
        shapes = np.vstack((np.zeros((2, 16)), cells))
        shapes[0, :9] = (*ball, radius, *self.bend, self.slope, self.level)
        shapes[1, :12] = (*X_ES.rotation.ravel(), *X_ES.translation)
        if self.cells is not None:
            shapes[0, 9:15] = (*self.corner, *1.0 / np.array(self.pitch), *self.cells.shape[:2])
        return tuple(shapes)


def distance_and_normal(shapes: Shapes, p: Array) -> tuple[Array, Array]:
    """Compute signed distances of points from a surface, and outward normals at the nearest points.

    Args:
        shapes: SHAPE rows of the surface, from `Surface.rows`: bend, slope and level of the quadric
            and the grid of cells, the pose of the surface, then the coefficients of each cell.
        p: (3,) or (3, k) points in the axes of the surface (m).

    Returns:
        Distances () or (k,) (m), > 0 outside the material, and unit normals (3,) or (3, k).
    """
    result = None
    if p.size == 3:  # Python numbers take a quarter of the time of arrays
        with suppress(ZeroDivisionError):  # a point without a nearest one: arrays give NaN
            result = _nearest_to_one(shapes, 0, tuple(p.ravel().tolist()))
    if result is None:
        result = _nearest(shapes, 0, tuple(p))
    distance, gradient, _, _ = result
    # + 0 · along makes arrays of components that are constant
    g = np.array([component + 0.0 * distance for component in gradient]).reshape(p.shape)
    size = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    return (np.reshape(distance, p.shape[1:]) * size, g / size)


def triangles_of(read: Callable[[int], Any], count: int) -> Array:
    """Indices (count, 3) of the corners of the triangles of a coal mesh.

    Args:
        read: function that returns a triangle by its number.
        count: number of triangles.
    """
    triangles = [read(number) for number in range(count)]
    return np.array([[triangle[k] for k in range(3)] for triangle in triangles])


def _spline_coefficients(knots: Array, edges: Array, side: float) -> Array:
    """Compute the coefficients (4, n, m) of u⁰ … u³ of m cubic B-splines in each of n cells.

    u = 0 … 1 is the coordinate in a cell; the coefficients are those of Taylor series at u = 0.

    Args:
        knots: (m + 4,) knots of the splines (m).
        edges: (n + 1,) edges of the cells (m).
        side: side of a cell (m).
    """
    from scipy.interpolate import BSpline

    splines = BSpline(knots, np.eye(len(knots) - 4), 3)
    return np.array([splines(edges[:-1], nu=p) * side**p / factorial(p) for p in range(4)])


def _checked_radius(radius: float) -> float:
    """Check a radius of curvature (m) and return it.

    Raises:
        InvalidInputError: the radius is zero or not finite.
    """
    if not (np.isfinite(radius) and radius != 0.0):
        raise InvalidInputError(f"radius = {radius}; give a length other than 0 m")
    return radius
