"""Both laws on the nonlinear arm, from one and the same small error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, pose_error
from paper.kinematic_stability.arms import HybridArm
from paper.kinematic_stability.laws import classic_torque, our_torque
from paper.kinematic_stability.search import WorstPosture

__all__ = ["LEFT", "Histories", "simulate"]

#: rad: a joint this far off has left the posture; what the arm does from there on is not judged.
LEFT = 0.5

Law = Callable[[HybridArm, Array, Array, pin.SE3], Array]


@dataclass(frozen=True)
class Histories:
    """Joint errors (k, n) over time t (k,), rad from the posture; NaN once a joint has `LEFT`."""

    t: Array
    classic: Array
    ours: Array

    def left_after(self) -> float | None:
        """When the classic scheme had left the posture (s); None: it did not."""
        gone = np.isnan(self.classic[:, 0])
        return float(self.t[gone.argmax()]) if gone.any() else None


def simulate(
    worst: WorstPosture, duration: float = 1.0, error: float = 1e-3, step: float = 2e-3
) -> Histories:
    """Both closed loops from rest, `error` (m, rad) off in every position-controlled coordinate.

    Continuous-time control, forward dynamics by `pin.aba`, fourth-order Runge–Kutta.

    Args:
        worst: arm and posture.
        duration: of both runs (s).
        error: at the start (m, rad).
        step: of the integration (s).

    Raises:
        InvalidInputError: error, duration or step not positive.
    """
    for name, value in (("error", error), ("duration", duration), ("step", step)):
        if not (np.isfinite(value) and value > 0.0):
            raise InvalidInputError(f"{name} = {value}; give a number > 0")
    t = np.arange(round(duration / step) + 1) * step
    goal = worst.arm.terms(worst.q)[2]
    start = _reached(worst, error * worst.arm.selection, goal)
    return Histories(
        t,
        _integrate(worst, classic_torque, goal, start, t),
        _integrate(worst, our_torque, goal, start, t),
    )


def _integrate(worst: WorstPosture, law: Law, goal: pin.SE3, start: Array, t: Array) -> Array:
    arm, n, h = worst.arm, len(start), t[1] - t[0]
    data = arm.plant.createData()

    def rate(state: Array) -> Array:
        q, v = state[:n], state[n:]
        return np.concatenate((v, pin.aba(arm.plant, data, q, v, law(arm, q, v, goal))))

    state = np.concatenate((start, np.zeros(n)))
    out = np.full((len(t), n), np.nan)
    for k in range(len(t)):
        if np.abs(state[:n] - worst.q).max() > LEFT:
            break
        out[k] = state[:n] - worst.q
        a = rate(state)
        b = rate(state + 0.5 * h * a)
        c = rate(state + 0.5 * h * b)
        state = state + h / 6 * (a + 2 * b + 2 * c + rate(state + h * c))
    return out


def _reached(worst: WorstPosture, offset: Array, goal: pin.SE3) -> Array:
    """(n,) joint positions whose task coordinates are exactly `offset` from the posture's."""
    rows, q = list(worst.arm.rows), worst.q
    for _ in range(10):
        _, J, tip = worst.arm.terms(q)
        q = q + np.linalg.solve(J[rows], offset + pose_error(goal, tip)[rows])
    return q
