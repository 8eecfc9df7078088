"""Conventions of this package: vectors of motions and forces, poses, and operations on them.

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
  accelerations of two bodies can be subtracted. Classical (as of an accelerometer)
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
        """Type of a field of a `geometry` for type checkers: set as array-like, read as array.

        At run time it is `Array`.
        """

        def __get__(self, owner: object, kind: type | None = None) -> Array:
            """Read the field of `owner`."""

        def __set__(self, owner: object, value: ArrayLike) -> None:
            """Set the field of `owner`."""

else:
    Coordinates = Array

Kind = TypeVar("Kind", bound=type)


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(field,))
def geometry(kind: Kind) -> Kind:
    """Make a class a frozen dataclass, whose fields of type `Coordinates` accept array-likes.

    It is a decorator. For type checkers, arguments of the constructor are array-likes (lists,
    tuples, arrays) and attributes are arrays; the class has to convert them in `__post_init__`.
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
        InvalidInputError: wrong number of axes, wrong size, or a NaN/inf, whose place is named.
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
    difference = np.abs(R.T @ R - np.eye(3)).max()
    if difference > 1e-6 or np.linalg.det(R) < 0.0:
        raise InvalidInputError(
            f"{name} rotation: RᵀR differs from 1 by {difference:.3g} and det R = "
            f"{np.linalg.det(R):.3g}; give a rotation matrix, such as "
            "pin.rpy.rpyToMatrix(roll, pitch, yaw)"
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
    """Euclidean length √(xᵀx) of a vector (n,) whose elements have one unit."""
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
    """Move twists from a reference point to another one: v_end = v_start + ω × (end − start).

    Args:
        V: (6,) or (6, k) twists at `start` (m/s, rad/s).
        start, end: (3,) points (m).

    Returns:
        Twists at `end`, of the shape of V.
    """
    V_end = np.array(V, dtype=np.float64)
    V_end[:3] -= skew(end - start) @ V[3:]
    return V_end


def carry_wrench(F: Array, start: Array, end: Array) -> Array:
    """Move wrenches from a reference point to another one: m_end = m_start + (start − end) × f.

    Args:
        F: (6,) or (6, k) wrenches at `start` (N, N m).
        start, end: (3,) points (m).

    Returns:
        Wrenches at `end`, of the shape of F.
    """
    F_end = np.array(F, dtype=np.float64)
    F_end[3:] += skew(start - end) @ F[:3]
    return F_end


def cross_twist(V: Array, U: Array) -> Array:
    """Rate V × U (6,) of a motion U (6,) that is fixed to a body of twist V (6,)."""
    return pin.Motion(V).cross(pin.Motion(U)).vector


def cross_wrench(V: Array, F: Array) -> Array:
    """Rate V ×* F (6,) of a wrench F (6,) that is fixed to a body of twist V (6,)."""
    return pin.Motion(V).cross(pin.Force(F)).vector


def classical_to_spatial(a_classical: Array, V: Array) -> Array:
    """Convert the classical acceleration a (6,) of a point to the spatial one, a − [ω × v; 0].

    Args:
        a_classical: (6,) classical acceleration [p̈; ω̇] of the point (m/s², rad/s²).
        V: (6,) twist at the point (m/s, rad/s).
    """
    a_spatial = np.array(a_classical, dtype=np.float64)
    a_spatial[:3] -= cross(V[3:], V[:3])
    return a_spatial


def pose_error(X_WD: SE3, X_WO: SE3) -> Array:
    """Displacement (6,) from the pose of O to that of D: [p_D − p_O; log₃(R_D R_Oᵀ)] (m, rad).

    It is in world axes, at O.

    Args:
        X_WD, X_WO: desired pose and pose of the object in the world.
    """
    rotation = pin.log3(X_WD.rotation @ X_WO.rotation.T)
    return np.concatenate((X_WD.translation - X_WO.translation, rotation))


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Block-diagonal matrix of several matrices, which need not be square.

    Args:
        blocks: matrices of any shapes.
    """
    corners = np.cumsum([(0, 0), *(block.shape for block in blocks)], axis=0)
    matrix = np.zeros(tuple(corners[-1]))
    for block, (i, j) in zip(blocks, corners, strict=False):
        matrix[i : i + block.shape[0], j : j + block.shape[1]] = block
    return matrix


@dataclass(frozen=True)
class Poses:
    """Poses at k instants.

    Attributes:
        R: (3, 3, k) rotation matrices, or (3, 3, 1) if the rotation is constant.
        p: (3, k) positions (m), or (3, 1) if the position is constant.
    """

    R: Array
    p: Array

    def __getitem__(self, i: int) -> SE3:
        """Pose at the instant with the index i."""
        R = self.R[..., min(i, self.R.shape[-1] - 1)]
        p = self.p[..., min(i, self.p.shape[-1] - 1)]
        return SE3(R, p)

    def rotate(self, x: Array) -> Array:
        """Convert vectors x (3, k) or (3, m, k) from body axes to world axes."""
        return rotated(self.R, x)

    def act(self, x: Array) -> Array:
        """Convert points x (3, k) or (3, m, k) from body coordinates to world coordinates (m)."""
        return self.p + self.rotate(x)

    def rotate_back(self, x: Array) -> Array:
        """Convert vectors x (3, k) or (3, m, k) from world axes to body axes."""
        return rotated(self.R.transpose(1, 0, 2), x)

    def coordinates(self, k: int) -> Array:
        """Position and quaternion x, y, z, w (k, 7), in the order of `pin.SE3ToXYZQUAT`."""
        rows = np.empty((k, 7))
        rows[:, :3] = self.p.T
        rows[:, 3:] = _quaternions_of(self.R)
        return rows


def rotated(R: Array, x: Array) -> Array:
    """Compute the products R x at k instants, of the shape of x.

    Args:
        R: (3, 3, k) rotation matrices, or (3, 3, 1) for a constant rotation.
        x: (3, k), or (3, m, k) for m vectors at each instant.
    """
    if x.ndim == 3:
        R = R[:, :, None]
    products = R[:, 0] * x[0]  # three sums of arrays: faster than einsum for small matrices
    products += R[:, 1] * x[1]
    products += R[:, 2] * x[2]
    return products


def rotations(w: Array) -> Array:
    """Rotations exp([w]×) = 1 + a [w]× + b [w]×² (3, 3, k) for w (3, k), by Rodrigues' formula."""
    angle = np.sqrt((w * w).sum(axis=0))
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    unit = np.eye(3)[:, :, None]
    first_cross = cross(w[:, None], unit)
    second_cross = cross(w[:, None], first_cross)
    return unit + a * first_cross + b * second_cross


def moved(X: Array, d: Array) -> Array:
    """Displace B poses in world axes k times; return homogeneous matrices (k, B, 4, 4).

    Args:
        X: (B, 4, 4) homogeneous matrices of the poses.
        d: (k, B, 6) displacements from X: shift of the origin, then rotation vector (m, rad).
    """
    k, B = d.shape[:2]
    E = rotations(d[..., 3:].reshape(k * B, 3).T).transpose(2, 0, 1).reshape(k, B, 3, 3)
    poses = np.tile(X, (k, 1, 1, 1))
    poses[..., :3, :3] = E @ X[:, :3, :3]
    poses[..., :3, 3] += d[..., :3]
    return poses


def _quaternions_of(R: Array) -> Array:
    """Unit quaternions x, y, z, w (k, 4) of rotations R (3, 3, k).

    Rotations by at most 120° are given with w ≥ 0; Eigen converts the larger ones.
    """
    # with w = size/2 the vector part is that of (R − Rᵀ)/(4 w); for a small w the division is
    # inaccurate, hence the other method below
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    size = np.sqrt(np.maximum(trace, 0.0) + 1.0)
    vector = axial(R) * (0.5 / size)
    quaternions = np.column_stack((vector.T, 0.5 * size))
    for i in np.flatnonzero(trace <= 0.0):
        quaternions[i] = pin.Quaternion(R[:, :, i].copy()).coeffs()
    return quaternions
