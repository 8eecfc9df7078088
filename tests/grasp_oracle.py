"""Full systems of equations for arms that hold an object by any grasp.

Every joint and the object have accelerations of their own, in classical terms; grasps are written
as points and directions that stay together, differentiated twice by hand. Nothing here knows
N, T, spatial drift or generalised inverses of the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.linalg import lstsq
from rigs import largest, unit

LWA = pin.LOCAL_WORLD_ALIGNED
PITCH = 0.1  # of screws (m/rad)


@dataclass
class Solution:
    qdd: np.ndarray
    a_object: np.ndarray  # spatial, at O
    alpha: np.ndarray
    loops: np.ndarray  # (arms, 6) wrench of each arm on the object, at O; split not unique
    residual: float


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
        data = model.createData()
        n = model.nv
        self.n = n
        pin.computeAllTerms(model, data, q, v)
        self.M = np.array(data.M)
        self.h = np.array(data.nle)
        pin.forwardKinematics(model, data, q, v, np.zeros(n))
        pin.updateFramePlacements(model, data)
        self.V = V_O
        p = X_WO.translation
        R = X_WO.rotation
        w = V_O[3:]
        c = R @ body.lever
        cx = pin.skew(c)
        m = body.mass
        I_O = R @ body.inertia @ R.T - m * cx @ cx
        self.I = np.block([[m * np.eye(3), -m * cx], [m * cx, I_O]])
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
        pairs = {
            "rigid": [(E[i], E[j]) for i, j in ((0, 1), (1, 2), (2, 0))],
            "slide": [(E[i], E[j]) for i, j in ((0, 1), (1, 2), (2, 0))],
            "hinge": [] if axis is None else [(s, axis) for s in across(axis)],
            "cylinder": [] if axis is None else [(s, axis) for s in across(axis)],
            "screw": [] if axis is None else [(s, axis) for s in across(axis)],
            "plane": [] if axis is None else [(s, axis) for s in across(axis)],
            "ball": [],
        }[kind]
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

    def velocities(self, N, rng):
        """A random [v; V_O] that keeps the grasps and contacts, by the rows' null space."""
        A = np.vstack([row.coefficients for row in self.rows])
        A = np.vstack((A, np.hstack((np.zeros((N.shape[1], self.n)), N.T))))
        _, s, Vh = np.linalg.svd(A)
        free = Vh[np.count_nonzero(s > 1e-9 * s[0]) :]
        return free.T @ (free @ rng.standard_normal(self.n + 6))

    def solve(self, force, N, n_gamma):
        """Accelerations and contact forces under joint forces (n,)."""
        n = self.n
        k = len(self.rows)
        M = np.zeros((n + 6, n + 6))
        M[:n, :n] = self.M
        M[n:, n:] = self.I
        product = np.concatenate((np.cross(self.V[3:], self.V[:3]), np.zeros(3)))
        A = np.zeros((k + N.shape[1], n + 6))
        A[:k] = [row.coefficients for row in self.rows]
        A[k:, n:] = -N.T
        right = np.append([row.right for row in self.rows], -n_gamma - N.T @ product)
        K = np.block([[M, -A.T], [A, np.zeros((len(A), len(A)))]])
        x, residual = solve(K, np.concatenate((force - self.h, self.pull, right)))
        pulls = A[:k, n:] * x[n + 6 : n + 6 + k, None]
        loops = [pulls[a:b].sum(axis=0) for a, b in pairwise(self.ends)]
        spatial = x[n : n + 6] - product
        return Solution(x[:n], spatial, x[n + 6 + k :], np.array(loops), residual)


def solve(K, y):
    """Least squares, equilibrated and refined (loops may be redundant); and what is left."""
    scale = 1.0 / np.sqrt(np.abs(K).max(axis=1))
    Ks = K * np.outer(scale, scale)
    x = scale * lstsq(Ks, scale * y, rcond=1e-13)[0]
    for _ in range(3):
        x += scale * lstsq(Ks, scale * (y - K @ x), rcond=1e-13)[0]
    return x, float(largest(scale * (K @ x - y)))


def across(axis):
    """Two unit vectors perpendicular to an axis (3,)."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first = unit(first)
    return first, np.cross(unit(axis), first)


def kkt(chain, q, v, tau, N=None, n_gamma=None):
    """Arms that hold the object rigidly; its state is that of the first arm's tip."""
    model = chain.model
    data = model.createData()
    tips = [f"{arm.name}/{arm.tip}" for arm in chain.arms]
    pin.forwardKinematics(model, data, q, v)
    X_WT = pin.updateFramePlacement(model, data, model.getFrameId(tips[0]))
    X_WO = X_WT * chain.grasps[0].X_TO
    V = pin.getFrameVelocity(model, data, model.getFrameId(tips[0]), LWA).vector
    shift = np.cross(V[3:], X_WO.translation - X_WT.translation)
    grasps = [("rigid", grasp.X_TO, None) for grasp in chain.grasps]
    V_O = np.concatenate((V[:3] + shift, V[3:]))
    system = System(model, tips, grasps, chain.payload.inertia, q=q, v=v, X_WO=X_WO, V_O=V_O)
    force = -model.damping * v
    force[chain.actuated] += tau
    N = np.zeros((6, 0)) if N is None else N
    return system.solve(force, N, np.zeros(N.shape[1]) if n_gamma is None else n_gamma)


class ClosedLoop:
    """Pinocchio's own: arms, a free-flying object, and welds (or points, of balls) between them."""

    def __init__(self, chain):
        self.chain = chain
        model = chain.model.copy()
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
        model.appendBodyToJoint(joint, chain.payload.inertia, pin.SE3.Identity())
        self.model = model
        self.data = model.createData()
        self.ties = []
        for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
            tip = model.frames[model.getFrameId(f"{arm.name}/{arm.tip}")]
            rows = pin.ContactType.CONTACT_6D if grasp.is_rigid else pin.ContactType.CONTACT_3D
            ends = (tip.parentJoint, tip.placement, joint, grasp.X_TO.inverse())
            self.ties.append(pin.RigidConstraintModel(rows, model, *ends, pin.LOCAL))
        self.tie_data = [tie.createData() for tie in self.ties]
        pin.initConstraintDynamics(model, self.data, self.ties, self.tie_data)
        self.settings = pin.ProximalSettings(1e-13, 1e-10, 50)

    def acceleration(self, q, v, X_WO, V_O, tau, wrench=None):
        """Spatial acceleration (6,) of the object at O, world axes; wrench (6,) on it there."""
        n = self.chain.nq
        R = X_WO.rotation

        def own(x):  # in the object's axes
            return np.concatenate((R.T @ x[:3], R.T @ x[3:]))

        Q = np.concatenate((q, pin.SE3ToXYZQUAT(X_WO)))
        force = np.concatenate((np.zeros(n), np.zeros(6) if wrench is None else own(wrench)))
        force[self.chain.actuated] = tau
        U = np.concatenate((v, own(V_O)))
        ties = (self.ties, self.tie_data)
        a = pin.constraintDynamics(self.model, self.data, Q, U, force, *ties, self.settings)
        return np.concatenate((R @ a[n : n + 3], R @ a[n + 3 :]))
