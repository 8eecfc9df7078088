"""The conventions: how motions and forces are written everywhere in this package.

* Order: linear first, then angular, as in Pinocchio (`pin.Motion`, `pin.Force`).
  Featherstone's book orders them the other way round; the 1999 paper lists forces before
  couples and linear before angular motions, which is the order used here.
* Motions live in M⁶ (m/s, rad/s), forces in F⁶ (N, N m). The only product between them is the
  power fᵀv. No inner product exists inside either space, so nothing here takes one.
* A twist is written at a *point*, in world axes: `V_O` = [velocity of the body-fixed point now
  at O; ω]. A wrench is written at a point as [force; moment about that point]. The usual point
  is the operational point O, the origin of the held object's frame; Pinocchio calls this
  LOCAL_WORLD_ALIGNED of the object frame. (The alternative not taken: WORLD, whose moments and
  velocities refer to a far-away origin and lose digits.)
* Accelerations are *spatial* (Featherstone): the derivative of the twist in coordinates that
  stay at a fixed point. They are vectors: they carry from point to point like twists, and
  accelerations of two bodies can be subtracted. Classical (what an accelerometer measures)
  = spatial + [ω × v; 0]; the conversion happens once, where references enter.
* Poses are `pin.SE3`, named `X_WO`: "pose of O in W", maps O-coordinates to W-coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pinocchio import SE3

from osc_contact.errors import InvalidInputError

Array = NDArray[Any]

if TYPE_CHECKING:

    class Coordinates:
        """A field of a `geometry` as type checkers see it: numbers of any kind in, an array out."""

        def __get__(self, owner: object, kind: type | None = None) -> Array: ...
        def __set__(self, owner: object, value: ArrayLike) -> None: ...

else:
    Coordinates = Array

Kind = TypeVar("Kind", bound=type)


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(field,))
def geometry(kind: Kind) -> Kind:
    """Make a class a frozen dataclass, whose fields of type `Coordinates` accept array-likes.

    A decorator. Type checkers see array-likes (lists, tuples, arrays) as arguments of the
    constructor and arrays as attributes; the class has to convert them in `__post_init__`.
    Instances are compared by identity.

    Args:
        kind: class with annotated fields.
    """
    dataclass(frozen=True, eq=False)(kind)
    return kind


def as_array(name: str, value: object, shape: tuple[int | None, ...]) -> Array:
    """Return `value` as a finite float64 array of `shape` (None: any size along that axis).

    Where `shape` is (None,), a plain number becomes a vector of one element.

    Args:
        name: name of the argument, for messages.
        value: numbers as NumPy reads them, such as a list or an array.
        shape: expected shape.

    Raises:
        InvalidInputError: wrong number of axes, wrong size or a NaN/inf, with what was found.
    """
    try:
        array = np.array(value, dtype=np.float64, ndmin=shape == (None,))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{name}: expected numbers of shape {shape}: {error}") from error
    fits = array.ndim == len(shape) and all(
        n is None or n == got for n, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        expected = ", ".join("any" if n is None else str(n) for n in shape)
        raise InvalidInputError(f"{name}: expected shape ({expected}), got {array.shape}")
    if not isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
        where = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
        raise InvalidInputError(f"{name}: element {where} is {array[where]}; give a finite number")
    return array


def as_pose(name: str, position: object, rotation: object) -> SE3:
    """Return the pose of `position` (3,) and rotation matrix `rotation` (3, 3).

    Args:
        name: name of the argument, for messages.
        position: p (m).
        rotation: R, whose columns are the axes.

    Raises:
        InvalidInputError: wrong shapes, a NaN/inf, or a matrix that is not a rotation: RᵀR differs
            from 1 by more than 1e-6, or det R < 0.
    """
    p = as_array(f"{name} position", position, (3,))
    R = as_array(f"{name} rotation", rotation, (3, 3))
    off = np.abs(R.T @ R - np.eye(3)).max()
    if off > 1e-6 or np.linalg.det(R) < 0.0:
        raise InvalidInputError(
            f"{name} rotation: RᵀR differs from 1 by {off:.3g} and det R = {np.linalg.det(R):.3g}; "
            "give a rotation matrix, such as pin.rpy.rpyToMatrix(roll, pitch, yaw)"
        )
    return SE3(R, p)


def unit_vector(name: str, value: object) -> Array:
    """Return `value` (3,) scaled to unit length.

    Args:
        name: name of the argument, for messages.
        value: three numbers as NumPy reads them.

    Raises:
        InvalidInputError: wrong shape, not finite or zero.
    """
    vector = as_array(name, value, (3,))
    length = norm(vector)
    if length < 1e-9:
        raise InvalidInputError(f"{name} is zero; give a direction")
    return vector / length


def norm(x: Array) -> float:
    """Euclidean length √(xᵀx)."""
    return float(np.linalg.norm(x))


def cross(x: Array, y: Array) -> Array:
    """Cross products x × y of 3-vectors along the first axis: (3,), (3, k), …"""
    return np.array(
        (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    )


def skew(x: Array) -> Array:
    """Matrix [x]× (3, 3) with [x]× y = x × y, for x (3,)."""
    return pin.skew(x)


def axial(A: Array) -> Array:
    """Vector x (3,) with [x]× = A − Aᵀ for A (3, 3), or (3, k) for A (3, 3, k) at k times."""
    return np.array((A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]))


def columns_of(J: Array) -> Array:
    """Jacobian of Pinocchio as a matrix (6, n); for one joint Pinocchio's has the shape (6,)."""
    return np.reshape(J, (6, -1))


def carry_twist(V: Array, start: Array, end: Array) -> Array:
    """Twists (6,) or (6, k) carried from point to point: v_end = v_start + ω × (end − start).

    Args:
        V: (6,) or (6, k), linear first. start, end: (3,) points (m).
    """
    out = np.array(V, dtype=np.float64)
    out[:3] -= skew(end - start) @ V[3:]
    return out


def carry_wrench(F: Array, start: Array, end: Array) -> Array:
    """Wrenches (6,) or (6, k) carried from point to point: m_end = m_start + (start − end) × f.

    Args:
        F: (6,) or (6, k), force first. start, end: (3,) points (m).
    """
    out = np.array(F, dtype=np.float64)
    out[3:] += skew(start - end) @ F[:3]
    return out


def cross_twist(V: Array, U: Array) -> Array:
    """Rate V × U (6,) of a motion U (6,) that is fixed to a body of twist V (6,)."""
    return pin.Motion(V).cross(pin.Motion(U)).vector


def cross_wrench(V: Array, F: Array) -> Array:
    """Rate V ×* F (6,) of a wrench F (6,) that is fixed to a body of twist V (6,)."""
    return pin.Motion(V).cross(pin.Force(F)).vector


def classical_to_spatial(a_classical: Array, V: Array) -> Array:
    """Spatial acceleration a − [ω × v; 0] from the classical acceleration a of the same point.

    Args:
        a_classical: (6,) m/s², rad/s².
        V: (6,) twist at that point, m/s, rad/s.
    """
    out = np.array(a_classical, dtype=np.float64)
    out[:3] -= cross(V[3:], V[:3])
    return out


def pose_error(X_WD: SE3, X_WO: SE3) -> Array:
    """Displacement (6,) from O to D, world axes at O: [p_D − p_O; log₃(R_D R_Oᵀ)] (m, rad)."""
    rotation = pin.log3(X_WD.rotation @ X_WO.rotation.T)
    return np.concatenate((X_WD.translation - X_WO.translation, rotation))


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Block-diagonal matrix of the given matrices, which need not be square."""
    corners = np.cumsum([(0, 0), *(block.shape for block in blocks)], axis=0)
    out = np.zeros(tuple(corners[-1]))
    for block, (i, j) in zip(blocks, corners, strict=False):
        out[i : i + block.shape[0], j : j + block.shape[1]] = block
    return out


@dataclass(frozen=True)
class Poses:
    """Poses at k times along the last axis: R (3, 3, k) and p (3, k) (m), as in `pin.SE3`.

    A rotation or position that is constant may have a last axis of length 1.
    """

    R: Array
    p: Array

    def __getitem__(self, i: int) -> SE3:
        R = self.R[..., min(i, self.R.shape[-1] - 1)]
        p = self.p[..., min(i, self.p.shape[-1] - 1)]
        return SE3(R, p)

    def rotate(self, x: Array) -> Array:
        """Vectors in world axes, from x (3, k) or (3, m, k) in body axes."""
        return rotated(self.R, x)

    def act(self, x: Array) -> Array:
        """Points in world coordinates, from x (3, k) or (3, m, k) in body coordinates."""
        return self.p + self.rotate(x)

    def rotate_back(self, x: Array) -> Array:
        """Vectors in body axes, from x (3, k) or (3, m, k) in world axes."""
        return rotated(self.R.transpose(1, 0, 2), x)

    def coordinates(self, k: int) -> Array:
        """Position and quaternion x, y, z, w (k, 7), in the order of `pin.SE3ToXYZQUAT`."""
        out = np.empty((k, 7))
        out[:, :3] = self.p.T
        out[:, 3:] = _quaternions(self.R)
        return out


def rotated(R: Array, x: Array) -> Array:
    """Products R x at k times.

    Args:
        R: (3, 3, k) rotations; a last axis of length 1 stands for a constant one.
        x: (3, k), or (3, m, k) for m vectors at each time.
    """
    if x.ndim == 3:
        R = R[:, :, None]
    out = R[:, 0] * x[0]
    out += R[:, 1] * x[1]
    out += R[:, 2] * x[2]
    return out


def rotations(w: Array) -> Array:
    """Rotations exp([w]×) = 1 + a [w]× + b [w]×² (3, 3, k) for w (3, k), by Rodrigues' formula."""
    angle = np.sqrt((w * w).sum(axis=0))
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    unit = np.eye(3)[:, :, None]
    once = cross(w[:, None], unit)
    twice = cross(w[:, None], once)
    return unit + a * once + b * twice


def moved(X: Array, d: Array) -> Array:
    """Poses (k, B, 4, 4) after displacements from X (B, 4, 4), in world axes.

    Args:
        X: (B, 4, 4) homogeneous matrices.
        d: (k, B, 6) shift of the origin, then rotation vector (m, rad).
    """
    k, B = d.shape[:2]
    E = rotations(d[..., 3:].reshape(k * B, 3).T).transpose(2, 0, 1).reshape(k, B, 3, 3)
    out = np.tile(X, (k, 1, 1, 1))
    out[..., :3, :3] = E @ X[:, :3, :3]
    out[..., :3, 3] += d[..., :3]
    return out


def _quaternions(R: Array) -> Array:
    """Unit quaternions x, y, z, w (k, 4) of rotations R (3, 3, k).

    Rotations by at most 120° are given with w ≥ 0; Eigen converts the larger ones.
    """
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    size = np.sqrt(np.maximum(trace, 0.0) + 1.0)
    vector = axial(R) * (0.5 / size)
    out = np.column_stack((vector.T, 0.5 * size))
    for i in np.flatnonzero(trace <= 0.0):
        out[i] = pin.Quaternion(R[:, :, i].copy()).coeffs()
    return out
