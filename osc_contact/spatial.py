"""THE conventions page: how motions and forces are written everywhere in this package.

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

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError

Array = NDArray[Any]

__all__ = [
    "Array",
    "as_array",
    "cross",
    "skew",
    "carry_twist",
    "carry_wrench",
    "cross_twist",
    "cross_wrench",
    "classical_to_spatial",
    "pose_error",
]


def as_array(name: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """Return `value` as a finite float64 array of `shape` (None: any size along that axis).

    Raises:
        InvalidInputError: wrong number of axes, wrong size or a NaN/inf, with what was found.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{name}: expected numbers of shape {shape}: {error}") from error
    fits = array.ndim == len(shape) and all(
        want is None or want == got for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise InvalidInputError(f"{name}: expected shape {wanted}, got {array.shape}")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InvalidInputError(f"{name}: element {where} is {array[where]}; give a finite number")
    return array


def cross(x: Array, y: Array) -> Array:
    """x × y of 3-vectors (3,) or of columns (3, k)."""
    return np.array(
        (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    )


def skew(x: Array) -> Array:
    """The matrix [x]× with [x]× y = x × y; x (3,)."""
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def carry_twist(V: Array, start: Array, end: Array) -> Array:
    """Twists (6,) or (6, k) carried from point to point: v_end = v_start + ω × (end − start)."""
    out = np.array(V, dtype=np.float64)
    out[:3] -= skew(end - start) @ V[3:]
    return out


def carry_wrench(F: Array, start: Array, end: Array) -> Array:
    """Wrenches (6,) or (6, k) carried from point to point: m_end = m_start + (start − end) × f."""
    out = np.array(F, dtype=np.float64)
    out[3:] += skew(start - end) @ F[:3]
    return out


def cross_twist(V: Array, U: Array) -> Array:
    """V × U (6,), the rate of a motion U carried along by a body of twist V."""
    return np.concatenate((cross(V[3:], U[:3]) + cross(V[:3], U[3:]), cross(V[3:], U[3:])))


def cross_wrench(V: Array, F: Array) -> Array:
    """V ×* F (6,), the rate of a wrench F carried along by a body of twist V."""
    return np.concatenate((cross(V[3:], F[:3]), cross(V[3:], F[3:]) + cross(V[:3], F[:3])))


def classical_to_spatial(a_classical: Array, V: Array) -> Array:
    """Spatial acceleration from the classical one of the same point: a − [ω × v; 0]."""
    out = np.array(a_classical, dtype=np.float64)
    out[:3] -= cross(V[3:], V[:3])
    return out


def pose_error(X_WD: pin.SE3, X_WO: pin.SE3) -> Array:
    """Displacement (6,) from O to D, world axes at O: [p_D − p_O; log₃(R_D R_Oᵀ)] (m, rad)."""
    rotation: Array = pin.log3(X_WD.rotation @ X_WO.rotation.T)
    return np.concatenate((X_WD.translation - X_WO.translation, rotation))
