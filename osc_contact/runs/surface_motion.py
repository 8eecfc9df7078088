"""The tool follows a surface: references for a ball that moves on it, turned with its normal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Reference
from osc_contact.scenarios.schema import SurfaceMove
from osc_contact.spatial import Array, as_array, cross, rotated

__all__ = ["SurfaceMotion", "surface_references"]

# Fourth-order central differences at the steps −2 … 2.
_STEPS = np.arange(-2.0, 3.0)
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
_STEP = 2e-3  #: s


class SurfaceMotion:
    """Where the object is while its ball moves on a surface that rests.

    From the start pose the object is turned by the shortest way from the normal there to the normal
    at the foot; its ball touches.

    Attributes:
        axes: (3, 2) of the plane that touches the surface at the start, world.
    """

    def __init__(self, pair: SphereOnSurface, X_start: pin.SE3, direction: npt.ArrayLike) -> None:
        """Take the start.

        Args:
            pair: the contact, its environment frame where the world's is.
            X_start: pose of the object in contact. direction: (3,) roughly the first axis.

        Raises:
            InvalidInputError: the direction is along the normal.
        """
        self._pair = pair
        self._X = X_start
        self._ball = X_start.act(pair.centre)
        _, _, n = pair.nearest(self._ball[:, None])
        self._n = n[:, 0]
        along = as_array("direction", direction, (3,))
        first = along - (along @ self._n) * self._n
        size = float(np.linalg.norm(first))
        if size < 1e-3 * float(np.linalg.norm(along)) or size == 0.0:
            raise InvalidInputError(
                f"direction = {along} is along the normal of the surface, {self._n.round(4)}; give "
                "one across it"
            )
        self.axes = np.column_stack((first / size, cross(self._n, first / size)))

    def over(self, u: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """Of the object's origin (3, 3, k) position, velocity, acceleration; of its turn from the

        start R (3, 3, k), ω and ω̇ (3, k). Derivatives are differences along the path itself.

        Args:
            u: (3, 2, k) displacement along the axes, velocity and acceleration (m, s).
        """
        k = u.shape[2]
        s = _STEP * _STEPS[:, None, None]
        path = u[0] + s * u[1] + 0.5 * s * s * u[2]
        path = np.einsum("ij,sjk->isk", self.axes, path).reshape(3, -1)
        _, foot, n = self._pair.nearest(self._ball[:, None] + path)
        R = _shortest(self._n, n)
        arm = self._ball - self._X.translation
        origin = foot + self._pair.radius * n - np.einsum("ijk,j->ik", R, arm)
        place = _derivatives(origin.reshape(3, 5, k))
        turn, first, second = _derivatives(R.reshape(3, 3, 5, k))
        return place, (turn, _odd(first, turn), _odd(second, turn))


def surface_references(
    pair: SphereOnSurface,
    X_start: pin.SE3,
    period: float,
    *,
    direction: npt.ArrayLike,
    force: float | npt.ArrayLike,
    duration: float | None = None,
    **path: Any,
) -> Iterator[Reference]:
    """References for `run_loop`: one each period, the tool following a surface that rests.

    Args:
        pair, X_start: see `SurfaceMotion`. period: of the references (s).
        direction: (3,) roughly the first axis of the path's plane, world.
        force: desired (N), or one for each reference.
        duration: s; default: until the path ends.
        path: keys of a move of kind `surface`: points, raster, signals, feed, dwell, …

    Raises:
        ValueError: keys of the path that do not fit. InvalidInputError: see `SurfaceMotion`.
    """
    motion = SurfaceMotion(pair, X_start, direction)
    move = SurfaceMove(contact=pair.name, direction=direction, **path)
    t = np.arange(0.0, move.duration if duration is None else duration, period)
    place, (R, omega, omega_dot) = motion.over(move.over(t))
    alpha = np.broadcast_to(np.asarray(force, dtype=float), t.shape)
    R = rotated(R, np.repeat(X_start.rotation[:, :, None], len(t), axis=2))
    for i in range(len(t)):
        V = np.concatenate((place[1, :, i], omega[:, i]))
        A = np.concatenate((place[2, :, i], omega_dot[:, i]))
        yield Reference(pin.SE3(R[:, :, i], place[0, :, i]), V, A, alpha[i : i + 1])


def _derivatives(x: Array) -> Array:
    """(3, …, k) values, first and second derivatives from (…, 5, k) values at the steps."""
    first = np.einsum("s,...sk->...k", _FIRST, x) / _STEP
    second = np.einsum("s,...sk->...k", _SECOND, x) / _STEP**2
    return np.array([x[..., 2, :], first, second])


def _odd(rate: Array, R: Array) -> Array:
    """(3, k) the vector of the odd part of rate Rᵀ: ω of Ṙ, ω̇ of R̈."""
    A = np.einsum("ijk,ljk->ilk", rate, R)
    return 0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])


def _shortest(start: Array, n: Array) -> Array:
    """(3, 3, k) the shortest turns from a unit vector (3,) to others (3, k)."""
    a = cross(start[:, None], n)
    c = start @ n
    R = np.einsum("ik,jk->ijk", a, a) / (1.0 + c) + c * np.eye(3)[:, :, None]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        R[i, j] -= a[k]
        R[j, i] += a[k]
    return np.asarray(R)
