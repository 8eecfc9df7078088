"""Impedance and admittance control as `Laws`: for contacts that no model describes.

Neither splits forces from motions: both make the object answer all wrenches like a mass, a damper
and a spring, so the force on a surface depends on where that surface is. They take the place of the
motion filter and the control structure (eqs. 24 and 21); references, contact phases, wrist
readings, torque allocation and limits stay. Contacts serve to know where a desired force points.

Wrenches and motions are at O in world axes; inside, in the law's energy coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.control.custom_laws import Laws
from osc_contact.control.records import TickRecords
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, as_array, classical_to_spatial, pose_error

__all__ = ["admittance", "impedance"]


def impedance(stiffness: npt.ArrayLike = (1000.0, 100.0), damping_ratio: float = 0.7) -> Laws:
    """Impedance control with the arms' own inertia, without feedback of forces.

        F = Λ A_d + μ + p + D (V_d − V) + K e + N α_d

    so that Λ ë + D ė + K e = f_c − N α_d, e = x_d − x: a surface that stands where the reference
    is meets the force α_d, one that stands δ nearer K δ more. N α_d does what a set point K⁻¹N α_d
    inside the surface does. D = 2ζ L (L⁻¹ K L⁻ᵀ)^½ Lᵀ with Λ = L Lᵀ gives every mode the damping
    ratio ζ in every posture.

    Args:
        stiffness: K, of positions (N/m) and angles (N m/rad), or (6,) along and about the world's
            axes; ≥ 0. damping_ratio: ζ ≥ 0.

    Raises:
        InvalidInputError: another number of values, or one out of bounds.

    Source: N. Hogan, Impedance control: an approach to manipulation, ASME J. Dynamic Systems,
    Measurement, and Control 107, 1985. C. Ott, Cartesian Impedance Control of Redundant and
    Flexible-Joint Robots, Springer, 2008 (own inertia). A. Albu-Schäffer, C. Ott, U. Frese,
    G. Hirzinger, Cartesian impedance control of redundant robots, ICRA 2003 (D).
    """
    K = _on_axes("stiffness", stiffness)
    ratio = _on_axes("damping_ratio", (damping_ratio, damping_ratio))[0]
    return Laws(structure=_Impedance(K, float(ratio)))


def admittance(
    mass: npt.ArrayLike = (5.0, 0.1),
    damping: npt.ArrayLike = (400.0, 8.0),
    stiffness: npt.ArrayLike = (1000.0, 100.0),
    frequency: float = 10.0,
) -> Laws:
    """Admittance control: measured forces move the set point of a position controller.

        M c̈ + D ċ + K c = N α_d − f,   x_r = x_d + c
        F = Λ (A_r + 2ω (V_r − V) + ω² (x_r − x)) + μ + p + f

    f is the wrist reading without weight and velocity terms. On a surface of stiffness k_e,
    D = 1.4 √(k_e M) would damp the contact by 0.7 if x followed x_r at once. With K > 0 the force
    depends on where the surface is, by K; with K = 0 it settles at α_d anywhere, and where
    nothing touches the object drifts at α_d / D.

    It has a memory: give it as ``laws=lambda: osc.admittance(...)``, one for each controller.

    Args:
        mass: M > 0 (kg; kg m²). damping: D ≥ 0 (N s/m; N m s/rad). stiffness: K ≥ 0 (N/m;
            N m/rad). Each of positions and angles, or (6,) along and about the world's axes.
        frequency: ω/2π > 0 (Hz) of the position controller.

    Raises:
        InvalidInputError: another number of values, or one out of bounds.

    Source: L. Villani, J. De Schutter, Force control, in: Springer Handbook of Robotics, 2nd ed.,
    2016, chapter 9.2.
    """
    M = _on_axes("mass", mass, positive=True)
    D = _on_axes("damping", damping)
    K = _on_axes("stiffness", stiffness)
    rate = _on_axes("frequency", (frequency, frequency), positive=True)[0]
    return Laws(structure=_Admittance(M, D, K, 2.0 * np.pi * float(rate)))


def _on_axes(name: str, given: npt.ArrayLike, positive: bool = False) -> Array:
    """(6,) of a linear and an angular value, or of all six.

    Raises:
        InvalidInputError: another number of them, or one out of bounds.
    """
    values = as_array(name, given, (None,))
    if len(values) == 2:
        values = np.repeat(values, 3)
    values = as_array(name, values, (6,))
    if values.min() < 0.0 or (positive and not values.all()):
        raise InvalidInputError(
            f"{name} = {values.tolist()}; give numbers {'> 0' if positive else '≥ 0'}"
        )
    return values


class _Structure:
    """A commanded acceleration and wrench in the place of motion filter and control structure."""

    def __call__(self, signals: Any) -> Any:
        """Not called: `fill` does the same without signals."""

    def fill(self, records: TickRecords) -> None:
        """Write x, the acceleration to be expected, and f_S of WORK.

        Args:
            records: of the tick.
        """
        work = records.work
        m = int(work.locked)
        turn = records.reflection() @ records.motions().T  # of wrenches
        Lambda = work.Lambda + float(records.model.held != 0) * np.eye(6)
        columns = work.columns[work.columns.chosen[: int(work.count)]]
        reading = work.f_meas - work.bias_out
        A, f = self.command(work, columns.alpha_d @ columns.N, reading)
        f = turn @ (f + records.memory.f_bias)
        rate = np.linalg.solve(turn.T, work.V_D - work.V_O)
        f[m:] += self.damp(Lambda[m:, m:], turn[m:], rate[m:])
        x = np.linalg.solve(turn.T, classical_to_spatial(A, work.V_O))
        x[:m] = work.sigma[:m]
        work.f_S[:] = Lambda @ x + work.chain_bias + f
        x[m:] += np.linalg.solve(Lambda[m:, m:], (f - turn @ reading)[m:])
        work.x[:] = x
        work.force_next[:] = 0.0  # the integrals of the laws that are replaced rest
        work.motion_next[:] = 0.0

    def command(self, work: Any, desired: Array, reading: Array) -> tuple[Array, Array]:
        """Classical acceleration (6,), and a wrench (6,) beside what that takes.

        Args:
            work: WORK of the tick. desired: (6,) N α_d. reading: (6,) of the wrists.
        """
        raise NotImplementedError

    def damp(self, Lambda: Array, turn: Array, rate: Array) -> Array:
        """(d,) a wrench against ė, in the turned energy coordinates of the motions.

        Args:
            Lambda: (d, d) inertia. turn: (d, 6) of wrenches. rate: (d,) ė.
        """
        return np.zeros(len(rate))


@dataclass(eq=False)
class _Impedance(_Structure):
    K: Array
    ratio: float

    def command(self, work: Any, desired: Array, reading: Array) -> tuple[Array, Array]:
        return work.A_D, self.K * work.error + desired

    def damp(self, Lambda: Array, turn: Array, rate: Array) -> Array:
        L = np.linalg.cholesky(Lambda)
        half = np.linalg.solve(L, turn * np.sqrt(self.K))  # half halfᵀ = L⁻¹ K L⁻ᵀ
        squares, U = np.linalg.eigh(half @ half.T)
        U = L @ U
        return 2.0 * self.ratio * U @ (np.sqrt(np.maximum(squares, 0.0)) * (U.T @ rate))


@dataclass(eq=False)
class _Admittance(_Structure):
    M: Array
    D: Array
    K: Array
    omega: float
    c: Array = field(default_factory=lambda: np.zeros(6))
    rate: Array = field(default_factory=lambda: np.zeros(6))

    def command(self, work: Any, desired: Array, reading: Array) -> tuple[Array, Array]:
        dt = float(work.dt)
        before = self.rate
        pushed = self.M * before + dt * (desired - reading - self.K * self.c)
        self.rate = pushed / (self.M + dt * (self.D + dt * self.K))  # implicit Euler: stable
        self.c = self.c + dt * self.rate
        R_c = pin.exp3(self.c[3:]) @ work.X_WD[:3, :3]
        X_WC = pin.SE3(R_c, work.X_WD[:3, 3] + self.c[:3])
        e = pose_error(X_WC, pin.SE3(work.X_WO.copy()))
        e_dot = work.V_D + self.rate - work.V_O
        A = work.A_D + (self.rate - before) / dt
        return A + 2.0 * self.omega * e_dot + self.omega**2 * e, reading
