"""A ball or vertex of the object on a curved surface of the environment."""

from __future__ import annotations

from dataclasses import field

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.pairs.keys import BodyDirection, BodyPoint, Point, Radius, store
from osc_contact.contacts.pairs.law_pair import LawPair
from osc_contact.contacts.pairs.register import register_pair
from osc_contact.contacts.surface import Surface, distance_and_normal
from osc_contact.errors import InvalidInputError
from osc_contact.law.records import SURFACE
from osc_contact.spatial import Array, Poses, cross, norm


@register_pair(forces=1)
class SphereOnSurface(LawPair):
    """A ball or vertex of the object on a curved surface of the environment, r = 1.

    N = [−n; (p − O) × −n], p the centre of the ball, n the normal at the point of the surface
    nearest to p. n is the gradient of the signed distance φ of p, ṅ = ω_E × n + ∇²φ v_rel(p), so
    n_γ is that of a plane plus v_rel(p)ᵀ∇²φ v_rel(p). The gap is φ − ρ. The formulas hold with open
    gaps, too, as long as the nearest point of the surface is unique: where the surface is concave,
    its radius of curvature must exceed the ball's radius plus the misplacement of the surface.

    Example:
        >>> dome = osc.SphereOnSurface([0, 0, 0], radius=0.01, surface=osc.Surface.sphere(0.3))
        >>> print(dome.gaps(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.32]))).round(6))
        [0.01]
    """

    centre: Point
    """the centre of the ball [x, y, z] in the object frame"""
    radius: Radius
    """of the ball"""
    surface: Surface
    """the [surface](polish_curved_part.md#the-surface), outside which the ball is"""
    surface_point: BodyPoint = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    """the origin of the surface's axes [x, y, z] in the body frame"""
    surface_axis: BodyDirection = (0.0, 0.0, 1.0)  # type: ignore[assignment]
    """their z axis [x, y, z] in the body frame"""
    surface_x: BodyDirection = (1.0, 0.0, 0.0)  # type: ignore[assignment]
    """roughly their x axis [x, y, z] in the body frame"""
    name: str = "sphere_on_surface"
    pushes = True
    X_ES: SE3 = field(init=False, repr=False)

    def _make(self) -> None:
        """Compute the pose of the surface in its body, and make the pair's rows of the law.

        Raises:
            InvalidInputError: the x axis of the surface is along its z axis.
        """
        y = cross(self.surface_axis, self.surface_x)
        sine = norm(y)
        if sine < 1e-6:
            raise InvalidInputError(
                f"{self.name}: the x axis of the surface is {sine:.2g} rad off its z axis; give "
                "one across it"
            )
        y = y / sine
        seat = SE3(
            np.column_stack((cross(y, self.surface_axis), y, self.surface_axis)), self.surface_point
        )
        shapes = self.surface.rows(self.centre, self.radius, seat)
        store(self, X_ES=seat)
        self._store_geometry(self.surface_point, SURFACE, shapes, len(shapes) - 1)

    def nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """Signed distances (k,) (m), feet (3, k) on the surface and outward normals (3, k) there.

        They are computed in the surface's frame by the law's function, from the SHAPE rows in
        `_numbers`.

        Args:
            points: (3, k) points in the environment frame (m).
        """
        R = self.X_ES.rotation
        distances, n = distance_and_normal(
            self._numbers[1], R.T @ (points - self.surface_point[:, None])
        )
        n = R @ n
        return (distances, points - distances * n, n)

    def _gaps(self, X_EA: SE3) -> Array:
        """Signed distance (1,) of the ball (m), negative in an overlap."""
        return self.nearest(X_EA.act(self.centre)[:, None])[0] - self.radius

    def feet(self, X_WO: Poses, X_WE: Poses | None = None) -> Array:
        """Points (3, 1, k) of the surface nearest to the ball at k instants, world (m).

        Args:
            X_WO: k poses of the object in the world.
            X_WE: k poses of the touched body in the world; None: the world's frame.
        """
        p = X_WO.act(self.centre[:, None])
        if X_WE is None:
            return self.nearest(p)[1][:, None]
        return X_WE.act(self.nearest(X_WE.rotate_back(p - X_WE.p))[1])[:, None]
