"""A ball or vertex of the object on a curved surface of the environment."""

from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pinocchio import SE3
from pydantic import Field

from osc_contact.contacts.pairs.pair import (
    Bodies,
    Direction,
    LawPair,
    PairRow,
    Point,
    Radius,
    RadiusKey,
    register_pair,
    store,
)
from osc_contact.contacts.surface import Surface, distance_and_normal
from osc_contact.errors import InvalidInputError
from osc_contact.law.records import SURFACE
from osc_contact.scenarios.bodies import BodyDirection, BodyPoint, OnBodySpec
from osc_contact.scenarios.quantities import Length, Spec, Vec3
from osc_contact.spatial import Array, Poses, cross, norm


class SphereSpec(Spec):
    """A sphere about `surface_point`; a radius < 0: a bowl."""

    type: Literal["sphere"] = "sphere"
    radius: Length
    """of the sphere, < 0 seen from inside"""

    def made(self, folder: Path | None) -> Surface:
        """The surface."""
        return Surface.sphere(self.radius)


class CylinderSpec(SphereSpec):
    """A cylinder about `surface_axis`; a radius < 0: a pipe."""

    type: Literal["cylinder"] = "cylinder"  # type: ignore[assignment]

    def made(self, folder: Path | None) -> Surface:
        """The surface."""
        return Surface.cylinder(self.radius)


class SaddleSpec(Spec):
    """z = x²/(2R₁) + y²/(2R₂), z along `surface_axis` and x along `surface_x`."""

    type: Literal["saddle"] = "saddle"
    radii: tuple[Length, Length]
    """R₁ and R₂, of curvature at the origin; > 0: hollow"""

    def made(self, folder: Path | None) -> Surface:
        """The surface."""
        return Surface.saddle(*self.radii)


class MeshSpec(Spec):
    """A spline through the corners of a mesh, as a height along `surface_axis`."""

    type: Literal["mesh"] = "mesh"
    file: Annotated[str, Field(min_length=1)]
    """an STL or OBJ file beside the scenario, in metres"""
    cells: tuple[Annotated[int, Field(ge=1, le=64)], Annotated[int, Field(ge=1, le=64)]] = (8, 8)
    """how many pieces the spline has along x and y"""

    def made(self, folder: Path | None) -> Surface:
        """The surface; its points' distances from it are `rms` and `worst`."""
        return Surface.of_mesh((folder or Path()) / self.file, self.cells)


class SphereOnSurfaceSpec(OnBodySpec):
    """A ball or vertex of the object on a curved surface of a body, r = 1."""

    forces = 1
    type: Literal["sphere_on_surface"] = "sphere_on_surface"
    centre: Vec3
    """the centre of the ball [x, y, z] in the object frame"""
    radius: RadiusKey = 0.0
    """of the ball"""
    surface: Annotated[
        SphereSpec | CylinderSpec | SaddleSpec | MeshSpec, Field(discriminator="type")
    ]
    """the [surface](polish_curved_part.md#the-surface), outside which the ball is"""
    surface_point: BodyPoint = (0.0, 0.0, 0.0)
    """the origin of the surface's axes [x, y, z] in the body frame"""
    surface_axis: BodyDirection = (0.0, 0.0, 1.0)
    """their z axis [x, y, z] in the body frame"""
    surface_x: BodyDirection = (1.0, 0.0, 0.0)
    """roughly their x axis [x, y, z] in the body frame"""


@register_pair(SphereOnSurfaceSpec, surface_point="origin", surface_axis="axis", surface_x="along")
class SphereOnSurface(LawPair):
    """A ball of the held object on a smooth surface of the environment (r = 1).

    N = [−n; (p − O) × −n], p the centre of the ball, n the normal at the point of the surface
    nearest to p. n is the gradient of the signed distance φ of p, ṅ = ω_E × n + ∇²φ v_rel(p), so
    n_γ is that of a plane, and v_rel(p)ᵀ∇²φ v_rel(p) more. The gap is φ − ρ. All this holds with
    open gaps too, as far as one point of the surface is the nearest: the ball's radius and the
    misplacement of the surface together stay below its radius of curvature where it is hollow.

    Attributes:
        centre: (3,) of the ball in the object frame (m).
        radius: ρ, of the ball (m); 0: a vertex.
        surface: in its own axes.
        origin: (3,) of these axes in the environment frame (m).
        axis, along: (3,) their z axis and, roughly, their x axis; normalised on entry.
        name: used in messages and recordings.
    """

    centre: Point
    radius: Radius
    surface: Surface
    origin: Point = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    axis: Direction = (0.0, 0.0, 1.0)  # type: ignore[assignment]
    along: Direction = (1.0, 0.0, 0.0)  # type: ignore[assignment]
    name: str = "sphere_on_surface"
    pushes = True
    X_ES: SE3 = field(init=False, repr=False)

    def _make(self) -> None:
        y = cross(self.axis, self.along)
        sine = norm(y)
        if sine < 1e-6:
            raise InvalidInputError(
                f"{self.name}: the x axis of the surface is {sine:.2g} rad off its z axis; give "
                "one across it"
            )
        y = y / sine
        seat = SE3(np.column_stack((cross(y, self.axis), y, self.axis)), self.origin)
        shapes = self.surface.rows(self.centre, self.radius, seat)
        store(self, X_ES=seat)
        self._hold(PairRow(SURFACE, shapes, len(shapes) - 1), self.origin)

    def nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """Signed distances (k,), feet (3, k) on the surface and outward normals (3, k) there.

        Args:
            points: (3, k) in the environment frame (m).
        """
        R = self.X_ES.rotation
        away, n = distance_and_normal(self._numbers[1], R.T @ (points - self.origin[:, None]))
        n = R @ n
        return away, points - away * n, n

    def _gaps(self, b: Bodies) -> Array:
        """(1,) signed distance of the ball (m), negative where it overlaps."""
        p = b.X_E.actInv(b.X_A.act(self.centre))
        return self.nearest(p[:, None])[0] - self.radius

    def feet(self, X_WO: Poses, X_WE: Poses | None = None) -> Array:
        """(3, 1, k) of k instants the point of the surface nearest to the ball, world (m)."""
        p = X_WO.act(self.centre[:, None])
        if X_WE is None:
            return self.nearest(p)[1][:, None]
        return X_WE.act(self.nearest(X_WE.rotate_back(p - X_WE.p))[1])[:, None]
