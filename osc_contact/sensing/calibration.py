"""Wrist calibration: load and bias of a force sensor from readings in a few static postures.

At rest a sensor with a load of mass m (gripper included) and centre of mass c reads

    f = m u + b_f,    τ = (m c) × u + b_τ,    u = −Rᵀg,

linear in the ten unknowns m, m c, b_f, b_τ. They can be distinguished if the postures turn the
sensor relative to gravity. If it is not turned (as in a SCARA), only the sum of weight and bias is
known, and the sensor has to be tared.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.spatial import Array, as_array, skew

#: Names of the ten unknowns, for messages.
NAMES = ("m", *(f"{name}_{axis}" for name in ("m c", "b_f", "b_τ") for axis in "xyz"))


@dataclass(frozen=True)
class WristLoad:
    """Load of a wrist sensor, and its bias.

    Attributes:
        mass: mass of the load (kg).
        com: (3,) centre of mass in the sensor's axes (m).
        bias: (6,) reading of the unloaded sensor (N, N m).
        mass_error: standard error of the mass (kg).
        com_error: (3,) standard errors of the centre of mass (m).
    """

    mass: float
    com: Array
    bias: Array
    mass_error: float
    com_error: Array


def calibrate_wrist(
    rotations: Sequence[Array],
    readings: Array,
    noise: Array | float = 1.0,
) -> WristLoad:
    """Estimate load and bias of a wrist sensor by weighted least squares.

    Args:
        rotations: (3, 3) rotation of the sensor in the world for each posture.
        readings: (postures, 6) mean reading at rest in the sensor's axes: the wrench that the arm
            exerts on the gripper (N, N m).
        noise: (6,) or one number: standard deviations of those means (N, N m), which determine the
            weights and the standard errors.

    Raises:
        InvalidInputError: fewer than three postures, or shapes that do not fit.
        ModelError: the postures do not distinguish weight from bias.
    """
    k = len(rotations)
    if k < 3:
        raise InvalidInputError(f"{k} postures; mass, centre and bias need three or more")
    readings = as_array("readings", readings, (k, 6))
    deviation = np.broadcast_to(np.asarray(noise, dtype=float), (6,))
    if not (np.isfinite(deviation).all() and deviation.min() > 0.0):
        raise InvalidInputError(f"noise = {noise}; give finite numbers > 0")
    weight = 1.0 / deviation
    g = np.array([0.0, 0.0, -9.81])
    rows = np.vstack([weight[:, None] * _load_regressor(-np.asarray(R).T @ g) for R in rotations])
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    _, s, Vh = np.linalg.svd(rows / scale, full_matrices=False)
    if s[-1] < 1e-3 * s[0]:
        shares = np.abs(Vh[s < 1e-3 * s[0]]).max(axis=0)  # in combinations without an effect
        unknown = [name for name, share in zip(NAMES, shares, strict=True) if share > 0.1]
        raise ModelError(
            f"these {k} postures do not distinguish {', '.join(unknown)}: the sensor is never "
            "turned enough against gravity. Tilt it about two horizontal axes by 30 deg or more; a "
            "wrist that can only turn about the vertical has to be tared instead"
        )
    inverse = np.linalg.pinv(rows / scale) / scale[:, None]
    theta = inverse @ (readings * weight).ravel()
    error = np.linalg.norm(inverse, axis=1)
    mass = float(theta[0])
    com = theta[1:4] / theta[0]
    com_error = np.hypot(error[1:4], com * error[0]) / abs(mass)
    return WristLoad(mass, com, theta[4:], float(error[0]), com_error)


def _load_regressor(u: Array) -> Array:
    """Regressor Y(u) (6, 10) of a load at rest: reading = Y θ, θ = [m, m c, b_f, b_τ].

    Args:
        u: (3,) −Rᵀg, the direction of weight in the sensor's axes (m/s²).
    """
    Y = np.zeros((6, 10))
    Y[:3, 0] = u
    Y[3:, 1:4] = -skew(u)
    Y[:, 4:] = np.eye(6)
    return Y
