"""Full systems of equations for arms that hold an object by any grasp.

Every joint and the object have accelerations of their own, in classical terms; grasps are written
as points and directions that stay together, differentiated twice by hand. Nothing here knows
N, T, spatial drift or generalised inverses of the package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.linalg import lstsq
from rigs import LWA, largest, terms_at, unit

PITCH = 0.1  # of screws (m/rad)


@dataclass
class Row:
    """coefficients · [q̈; p̈; ω̇] = right; the same coefficients times [v; ṗ; ω] vanish."""

    coefficients: np.ndarray
    right: float


class System:
    """Mass matrix, forces and grasp rows at a position, velocity and object state.

    grasps: (kind, X_TO, axis in tip frame) for each arm.
    """

    def __init__(self, model, tips, grasps, body, *, q, v, X_WO, V_O):
        data = terms_at(model, q, v)
        self.M = np.array(data.M)
        self.h = np.array(data.nle)
        self.V = V_O
        p = X_WO.translation
        R = X_WO.rotation
        w = V_O[3:]
        c = R @ body.lever
        m = body.mass
        self.I = pin.SE3(R, np.zeros(3)).act(body).matrix()
        I_O = self.I[3:, 3:]
        g = np.array(model.gravity.linear)
        self.pull = np.concatenate(
            (m * g - m * np.cross(w, np.cross(w, c)), m * np.cross(c, g) - np.cross(w, I_O @ w))
        )
        self.rows = []
        self.ends = [0]
        for tip, (kind, X_TO, axis) in zip(tips, grasps, strict=True):
            f = model.getFrameId(tip)
            X = data.oMf[f]
            J = pin.getFrameJacobian(model, data, f, LWA)
            u = pin.getFrameVelocity(model, data, f, LWA).vector
            a = pin.getFrameClassicalAcceleration(model, data, f, LWA).vector
            held = R @ X_TO.inverse().translation  # from O to the grasp's point of the object
            tip = X, J, u, a
            self._grasp(kind, axis, tip, p, held, w, R @ X_TO.rotation.T)
            self.ends.append(len(self.rows))

    def _grasp(self, kind, axis, tip, p, held, w, R_OT):
        """`held`: O to the point G of the object that the grasp holds; R_OT: its axes there."""
        X, J, u, a = tip
        E = np.eye(3)
        zero = np.zeros(3)
        wt = u[3:]
        at = a[3:]
        r = p + held - X.translation
        rdot = self.V[:3] + np.cross(w, held) - u[:3]
        # r̈ = p̈ + ω̇×held + ω×(ω×held) − (tip's)
        r_bias = np.cross(w, np.cross(w, held)) - a[:3]
        r_rows = np.hstack((-J[:3], E, -pin.skew(held)))
        if kind in ("rigid", "hinge", "ball"):
            for k in range(3):
                self.rows.append(Row(r_rows[k], -r_bias[k]))
        else:  # slide, cylinder, screw: r stays on an axis of the tip; plane: across it
            a = X.rotation @ axis
            for s in {"plane": (a,), "screw": (*across(a), a)}.get(kind, across(a)):
                sdot = np.cross(wt, s)
                bias = (np.cross(at, s) + np.cross(wt, sdot)) @ r + 2 * sdot @ rdot + s @ r_bias
                # ω̇_tip appears in s̈·r: (ω̇×s)·r = ω̇·(s×r)
                c = s @ r_rows
                c[: J.shape[1]] += np.cross(s, r) @ J[3:]
                if s is a and kind == "screw":  # … = pitch d/dt[(ω − ω_tip)·a]
                    c[: J.shape[1]] += PITCH * a @ J[3:]
                    c[-3:] -= PITCH * a
                    bias -= PITCH * ((w - wt) @ np.cross(wt, a) - at @ a)
                self.rows.append(Row(c, -bias))
        pairs = []
        if kind in ("rigid", "slide"):
            pairs = [(E[i], E[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
        elif kind != "ball":
            pairs = [(s, axis) for s in across(axis)]
        for of_tip, of_object in pairs:  # stay perpendicular
            s = X.rotation @ of_tip
            b = R_OT @ of_object
            sdot = np.cross(wt, s)
            bdot = np.cross(w, b)
            bias = (
                (np.cross(at, s) + np.cross(wt, sdot)) @ b + 2 * sdot @ bdot + s @ np.cross(w, bdot)
            )
            c = np.concatenate((np.cross(s, b) @ J[3:], zero, np.cross(b, s)))
            self.rows.append(Row(c, -bias))


def solve(K, y):
    """Least squares, equilibrated and refined (loops may be redundant); and what is left."""
    scale = 1.0 / np.sqrt(np.abs(K).max(axis=1))
    Ks = K * np.outer(scale, scale)
    x = scale * lstsq(Ks, scale * y, rcond=1e-13)[0]
    for _ in range(3):
        x += scale * lstsq(Ks, scale * (y - K @ x), rcond=1e-13)[0]
    return x, largest(scale * (K @ x - y))


def across(axis):
    """Two unit vectors perpendicular to an axis (3,)."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first = unit(first)
    return first, np.cross(unit(axis), first)
